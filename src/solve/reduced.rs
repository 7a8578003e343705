//! Damped Schur elimination of the blocks and back substitution.

use super::factor::Cholesky;
use super::{Gradient, NormalEquations, Step};
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
    for i in 0..m.nrows() {
        let d = m[(i, i)];
        out[(i, i)] = if d > 0.0 { d + ridge(i, d) } else { 1.0 };
    }
    out
}

/// `H_vv^-1` applied to the block's right-hand sides.
pub(super) struct EliminatedBlock {
    /// `H_vv^-1 H_vg`.
    pub(super) coupling: DMatrix<f64>,
    /// `H_vv^-1 b_v`.
    pub(super) own: DVector<f64>,
    factor: Cholesky,
}

/// The factored, damped equations.
pub(super) struct Reduced<'a> {
    equations: &'a NormalEquations,
    ridge: Ridge<'a>,
    blocks: Vec<EliminatedBlock>,
    factor: Option<Cholesky>,
    rhs: DVector<f64>,
}

/// `S` and the right-hand side of the reduced system, with the eliminated blocks; `None` where a block is indefinite.
pub(super) fn eliminate(
    equations: &NormalEquations,
    ridge: &Ridge,
) -> Option<(DMatrix<f64>, DVector<f64>, Vec<EliminatedBlock>)> {
    let mut s = damped(&equations.h_gg, |i, h| ridge.global(i, h));
    let mut rhs = equations.b_g.clone();
    let mut blocks = Vec::with_capacity(equations.blocks.len());
    for (v, block) in equations.blocks.iter().enumerate() {
        let factor = Cholesky::of(&damped(&block.h_vv, |i, h| ridge.block(v, i, h)))?;
        let coupling = factor.solve(&block.h_vg);
        let own = factor.solve_vector(&block.b_v);
        s.gemm_tr(-1.0, &block.h_vg, &coupling, 1.0);
        rhs.gemv_tr(-1.0, &block.h_vg, &own, 1.0);
        blocks.push(EliminatedBlock { coupling, own, factor });
    }
    Some((s, rhs, blocks))
}

impl<'a> Reduced<'a> {
    /// Eliminates the blocks with a ridge; `None` where the result is not positive definite.
    pub(super) fn of(equations: &'a NormalEquations, ridge: &Ridge<'a>) -> Option<Self> {
        let (s, rhs, blocks) = eliminate(equations, ridge)?;
        let factor = if s.nrows() == 0 { None } else { Some(Cholesky::of(&s)?) };
        Some(Self { equations, ridge: *ridge, blocks, factor, rhs })
    }

    /// Solution of the damped equations.
    pub(super) fn step(&self) -> Step {
        let global = match &self.factor {
            Some(f) => f.solve_vector(&self.rhs),
            None => DVector::zeros(0),
        };
        let blocks = self.blocks.iter().map(|b| &b.own - &b.coupling * &global).collect();
        Step { global, blocks }
    }

    /// Solution of the damped equations for another right-hand side; `None` where it is not finite.
    pub(super) fn solve(&self, rhs: &Gradient) -> Option<Step> {
        let mut reduced = rhs.global.clone();
        let mut own = vec![];
        for ((block, eliminated), b) in self.equations.blocks.iter().zip(&self.blocks).zip(&rhs.blocks) {
            let x = eliminated.factor.solve_vector(b);
            reduced.gemv_tr(-1.0, &block.h_vg, &x, 1.0);
            own.push(x);
        }
        let global = self.factor.as_ref().map_or_else(|| DVector::zeros(0), |f| f.solve_vector(&reduced));
        let blocks: Vec<_> = self.blocks.iter().zip(own).map(|(e, x)| x - &e.coupling * &global).collect();
        let finite = global.iter().chain(blocks.iter().flatten()).all(|x: &f64| x.is_finite());
        finite.then_some(Step { global, blocks })
    }

    /// `sqrt(b^T (H + lambda D)^-1 b)`.
    pub(super) fn decrement(&self) -> f64 {
        self.b_dot(&self.step()).max(0.0).sqrt()
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
