//! Damped Schur elimination of the blocks and back substitution.
//!
//! With `H_vv = L L^T` of a block: `Y = L^-1 H_vg`, `y = L^-1 b_v`, then
//! ```text
//! S -= Y^T Y,   r -= Y^T y,   step_v = L^-T (y - Y step_g),   decrement^2 = sum |y|^2 + r^T S^-1 r
//! ```
//! `H_vv^-1 H_vg = L^-T Y` itself is formed only where the covariance asks for it.

use super::factor::{Cholesky, backward, factorise, forward, take_product};
use super::flat::{DETERMINED, is_unseen};
use super::tiles::{FEW, Take};
use super::{Block, Gradient, NormalEquations, Step};
use crate::lanes::{self, GROUP, Kernel, Lanes};
use nalgebra::{DMatrix, DVector};

/// What is added to the diagonal of H.
#[derive(Debug, Clone, Copy)]
pub(super) enum Ridge<'a> {
    /// This times the diagonal itself.
    Relative(f64),
    /// `mu / scale^2`.
    Scaled {
        /// Damping.
        mu: f64,
        /// Scale of each unknown.
        scales: &'a Step,
    },
}

/// What is added to every diagonal so that an exactly flat direction does not break the factorisation.
const ROUNDING_RIDGE: f64 = 1e-14;

impl Ridge<'_> {
    fn global(&self, i: usize, h: f64) -> f64 {
        match self {
            Ridge::Relative(r) => r * h,
            Ridge::Scaled { mu, scales } => mu / scales.global[i].powi(2) + ROUNDING_RIDGE * h,
        }
    }
    fn block(&self, v: usize, i: usize, h: f64) -> f64 {
        match self {
            Ridge::Relative(r) => r * h,
            Ridge::Scaled { mu, scales } => mu / scales.blocks[v][i].powi(2) + ROUNDING_RIDGE * h,
        }
    }
}

/// `m + diag(ridge(i, m_ii))`; an unknown that nothing sees gets a unit diagonal, so that its step is zero.
pub(super) fn damped(m: &DMatrix<f64>, ridge: impl Fn(usize, f64) -> f64) -> DMatrix<f64> {
    let mut out = m.clone();
    damp(out.as_mut_slice(), m.nrows(), ridge);
    out
}

/// The same in place, column by column.
fn damp(m: &mut [f64], n: usize, ridge: impl Fn(usize, f64) -> f64) {
    for i in 0..n {
        let d = m[i * n + i];
        m[i * n + i] = if d > 0.0 { d + ridge(i, d) } else { 1.0 };
    }
}

/// Distance of the columns of Y transposed: whole groups for the tiles.
fn stride(global: usize) -> usize {
    if global <= FEW { global.next_multiple_of(GROUP) } else { global }
}

/// Forms the rows of `Y = L^-1 H_vg` of one block, `width` apart, and takes `Y^T y` from the right-hand side. Plain loops, which are compiled for
/// the processor's widest instructions.
struct Couple<'a> {
    /// d x n, by columns.
    h_vg: &'a [f64],
    l: &'a [f64],
    y: &'a mut [f64],
    own: &'a [f64],
    rhs: &'a mut [f64],
    width: usize,
}

impl Kernel for Couple<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (d, width) = (self.own.len(), self.width);
        for k in 0..d {
            let (before, rest) = self.y.split_at_mut(k * width);
            let row = &mut rest[..width];
            for (x, column) in row.iter_mut().zip(self.h_vg.chunks_exact(d)) {
                *x = column[k];
            }
            for m in 0..k {
                let (factor, other) = (self.l[m * d + k], &before[m * width..(m + 1) * width]);
                for (x, y) in row.iter_mut().zip(other) {
                    *x -= factor * y;
                }
            }
            let (inverse, y) = (1.0 / self.l[k * d + k], self.own[k]);
            for x in row.iter_mut() {
                *x *= inverse;
            }
            for (r, x) in self.rhs.iter_mut().zip(row.iter()) {
                *r -= x * y;
            }
        }
    }
}

/// The blocks, eliminated; one after the other in each vector.
pub(super) struct Eliminated {
    sizes: Vec<usize>,
    global: usize,
    /// L, d x d, by columns.
    factors: Vec<f64>,
    /// Y transposed, n x d, by columns that [`stride`] parts.
    coupled: Vec<f64>,
    /// y, d.
    own: Vec<f64>,
}

/// One block of [`Eliminated`].
pub(super) struct EliminatedBlock<'a> {
    factor: &'a [f64],
    coupled: &'a [f64],
    own: &'a [f64],
    global: usize,
}

impl Eliminated {
    pub(super) fn blocks(&self) -> impl Iterator<Item = EliminatedBlock<'_>> {
        let mut at = [0; 3];
        self.sizes.iter().map(move |&d| {
            let [f, c, o] = at;
            at = [f + d * d, c + d * stride(self.global), o + d];
            EliminatedBlock {
                factor: &self.factors[f..at[0]],
                coupled: &self.coupled[c..at[1]],
                own: &self.own[o..at[2]],
                global: self.global,
            }
        })
    }

    /// Whether a block may be flat in some directions by itself. Blocks that nothing sees at all are no question.
    pub(super) fn doubtful(&self, equations: &NormalEquations) -> bool {
        let mut x = vec![0.0; self.sizes.iter().copied().max().unwrap_or(0)];
        let mut blocks = self.blocks().zip(&equations.blocks);
        !blocks.all(|(own, block)| own.is_determined(block, &mut x) || is_unseen(block))
    }
}

impl EliminatedBlock<'_> {
    /// Whether no eigenvalue of the block scaled by its diagonal is below ten times [`super::flat::FLAT`]. These have the mean one, so that the least is at
    /// least `det / e`, which mostly tells; else the trace of the inverse does, `sum_j h_jj |L^-1 e_j|^2`. `x` for scratch.
    fn is_determined(&self, block: &Block, x: &mut [f64]) -> bool {
        let (d, l, h) = (self.own.len(), self.factor, block.h_vv.as_slice());
        let shares = (0..d).map(|k| l[k * (d + 1)].powi(2) / h[k * (d + 1)]);
        if (0..d).any(|k| !(h[k * (d + 1)] > 0.0)) {
            return false;
        }
        if shares.product::<f64>() * DETERMINED > std::f64::consts::E {
            return true;
        }
        let mut trace = 0.0;
        for j in 0..d {
            x[j..d].fill(0.0);
            x[j] = 1.0;
            let mut squares = 0.0;
            for m in j..d {
                let column = &l[m * d..(m + 1) * d];
                let own = x[m] / column[m];
                squares += own * own;
                x[m + 1..d].iter_mut().zip(&column[m + 1..]).for_each(|(x, l)| *x -= l * own);
            }
            trace += h[j * (d + 1)] * squares;
        }
        trace < DETERMINED
    }

    /// Column k of Y transposed.
    fn column(&self, k: usize) -> &[f64] {
        &self.coupled[k * stride(self.global)..][..self.global]
    }

    /// `L^-T (y - Y global)`.
    fn step(&self, y: &[f64], global: &DVector<f64>) -> DVector<f64> {
        let dot = |k: usize| -> f64 { self.column(k).iter().zip(global.iter()).map(|(a, b)| a * b).sum() };
        let mut x = DVector::from_fn(y.len(), |k, _| y[k] - dot(k));
        backward(self.factor, x.as_mut_slice());
        x
    }

    /// `H_vv^-1 H_vg`, d x n.
    pub(super) fn coupling(&self) -> DMatrix<f64> {
        let d = self.own.len();
        let mut out = DMatrix::from_fn(d, self.global, |k, j| self.column(k)[j]);
        out.as_mut_slice().chunks_exact_mut(d.max(1)).for_each(|x| backward(self.factor, x));
        out
    }

    /// `H_vv^-1`.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let d = self.own.len();
        let mut out = DMatrix::identity(d, d);
        out.as_mut_slice().chunks_exact_mut(d.max(1)).for_each(|x| {
            forward(self.factor, x);
            backward(self.factor, x);
        });
        out
    }
}

/// The factored, damped equations.
pub(super) struct Reduced<'a> {
    equations: &'a NormalEquations,
    ridge: Ridge<'a>,
    blocks: Eliminated,
    factor: Option<Cholesky>,
    rhs: DVector<f64>,
}

/// `S` (lower triangle) and the right-hand side of the reduced system, with the eliminated blocks; `None` where a block is indefinite.
pub(super) fn eliminate(
    equations: &NormalEquations,
    ridge: &Ridge,
) -> Option<(DMatrix<f64>, DVector<f64>, Eliminated)> {
    let n = equations.h_gg.nrows();
    let mut s = damped(&equations.h_gg, |i, h| ridge.global(i, h));
    let mut rhs = equations.b_g.clone();
    let sizes: Vec<usize> = equations.blocks.iter().map(|b| b.b_v.len()).collect();
    let (total, width): (usize, usize) = (sizes.iter().sum(), stride(n));
    let mut factors = Vec::with_capacity(sizes.iter().map(|d| d * d).sum());
    let mut coupled: Vec<f64> = Vec::with_capacity(total * width);
    let mut own: Vec<f64> = Vec::with_capacity(total);
    for (v, (block, &d)) in equations.blocks.iter().zip(&sizes).enumerate() {
        let (f, c, o) = (factors.len(), coupled.len(), own.len());
        factors.extend_from_slice(block.h_vv.as_slice());
        let l = &mut factors[f..];
        damp(l, d, |i, h| ridge.block(v, i, h));
        if !factorise(l, d) {
            return None;
        }
        coupled.resize(c + d * width, 0.0);
        own.extend(block.b_v.iter());
        forward(l, &mut own[o..]);
        let (h_vg, y, own) = (block.h_vg.as_slice(), &mut coupled[c..], &own[o..]);
        lanes::run(Couple { h_vg, l, y, own, rhs: rhs.as_mut_slice(), width });
    }
    if n <= FEW {
        lanes::run(Take { y: &coupled, s: s.as_mut_slice(), n });
    } else {
        // Unknowns that meet no global one, like the radius of a disc of which only the centre is seen.
        let meets = |y: &&[f64]| y.iter().any(|x| *x != 0.0);
        let meeting = coupled.chunks_exact(n).filter(meets).count();
        if meeting < total {
            let some: Vec<f64> = coupled.chunks_exact(n).filter(meets).flatten().copied().collect();
            take_product(&mut s, &some);
        } else {
            take_product(&mut s, &coupled);
        }
    }
    Some((s, rhs, Eliminated { sizes, global: n, factors, coupled, own }))
}

impl<'a> Reduced<'a> {
    /// Eliminates the blocks with a ridge; `None` where the result is not positive definite.
    pub(super) fn of(equations: &'a NormalEquations, ridge: &Ridge<'a>) -> Option<Self> {
        let (s, rhs, blocks) = eliminate(equations, ridge)?;
        let factor = if s.nrows() == 0 { None } else { Some(Cholesky::of(&s)?) };
        Some(Self { equations, ridge: *ridge, blocks, factor, rhs })
    }

    fn global(&self, rhs: &DVector<f64>) -> DVector<f64> {
        self.factor.as_ref().map_or_else(|| DVector::zeros(0), |f| f.solve_vector(rhs))
    }

    /// Solution of the damped equations.
    pub(super) fn step(&self) -> Step {
        let global = self.global(&self.rhs);
        let blocks = self.blocks.blocks().map(|b| b.step(b.own, &global)).collect();
        Step { global, blocks }
    }

    /// Solution of the damped equations for another right-hand side; `None` where it is not finite.
    pub(super) fn solve(&self, rhs: &Gradient) -> Option<Step> {
        let mut reduced = rhs.global.clone();
        let mut own = vec![];
        for (block, b) in self.blocks.blocks().zip(&rhs.blocks) {
            let mut y = b.clone();
            forward(block.factor, y.as_mut_slice());
            for (k, y) in y.iter().enumerate() {
                reduced.iter_mut().zip(block.column(k)).for_each(|(r, x)| *r -= x * y);
            }
            own.push(y);
        }
        let global = self.global(&reduced);
        let blocks: Vec<_> = self.blocks.blocks().zip(&own).map(|(b, y)| b.step(y.as_slice(), &global)).collect();
        let finite = global.iter().chain(blocks.iter().flatten()).all(|x: &f64| x.is_finite());
        finite.then_some(Step { global, blocks })
    }

    /// `sqrt(b^T (H + lambda D)^-1 b)`.
    pub(super) fn decrement(&self) -> f64 {
        let views: f64 = self.blocks.own.iter().map(|y| y * y).sum();
        (views + self.factor.as_ref().map_or(0.0, |f| f.square(&self.rhs))).sqrt()
    }

    /// `ln det (H + lambda D)`.
    pub(super) fn log_determinant(&self) -> f64 {
        let of_block = |b: EliminatedBlock<'_>| {
            let d = b.own.len();
            (0..d).map(|i| b.factor[i * d + i].ln()).sum::<f64>()
        };
        let own: f64 = self.blocks.blocks().map(of_block).sum();
        2.0 * own + self.factor.as_ref().map_or(0.0, Cholesky::log_determinant)
    }

    fn b_dot(&self, step: &Step) -> f64 {
        let views: f64 = self.equations.blocks.iter().zip(&step.blocks).map(|(b, d)| b.b_v.dot(d)).sum();
        self.equations.b_g.dot(&step.global) + views
    }

    /// Decrease of the quadratic model: `b^T d - 1/2 d^T H d = 1/2 (b^T d + d^T ridge d)`.
    pub(super) fn predicted_decrease(&self, step: &Step) -> f64 {
        let weighted = |m: &DMatrix<f64>, d: &DVector<f64>, ridge: &dyn Fn(usize, f64) -> f64| -> f64 {
            (0..d.len()).map(|i| ridge(i, m[(i, i)]) * d[i] * d[i]).sum()
        };
        let mut sum = weighted(&self.equations.h_gg, &step.global, &|i, h| self.ridge.global(i, h));
        for (v, (b, d)) in self.equations.blocks.iter().zip(&step.blocks).enumerate() {
            sum += weighted(&b.h_vv, d, &|i, h| self.ridge.block(v, i, h));
        }
        0.5 * (self.b_dot(step) + sum)
    }
}
