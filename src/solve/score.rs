//! What the normal equations say without another solve: Newton predictions and Lagrange-multiplier tests.
//!
//! With the blocks eliminated the global unknowns have the information S and the right-hand side r (zero at a minimum).
//! ```text
//! prediction    dx = S^-1 r,   covariance of J x: J S^-1 J^T
//! score test    theta added to the unknowns x:  S = | S_xx  S_xt |,  r = (r_x, r_t)
//!                                                   | S_tx  S_tt |
//!   M = B^T (S_tt - S_tx S_xx^-1 S_xt) B,   g = B^T (r_t - S_tx S_xx^-1 r_x)        theta = B eta
//!   statistic = g^T M^-1 g   (chi-square, rank of M degrees of freedom, where theta = 0 is true)
//!   eta = M^-1 g with covariance M^-1,   dx = -S_xx^-1 S_xt B eta                   (one Newton step of the larger model)
//! ```
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | S, r | `information`, `rhs` | reduced matrix and right-hand side of the global unknowns |
//! | B | `basis` | columns that span what is tested |
//! | M | `own` | information on what is tested that the other unknowns leave |
//!
//! Source: Rao, "Large sample tests of statistical hypotheses concerning several parameters" (1948). Inverses are taken over the
//! determined directions. To first order only: a departure that bends the problem needs a solve of its own.

use super::factor::Cholesky;
use super::flat::{Directions, FLAT, over_determined};
use super::{Known, NormalEquations};
use nalgebra::{DMatrix, DVector};

/// Global unknowns beyond which a Cholesky factor replaces the eigenvectors, which cost twenty times more.
const LARGE: usize = 400;
/// Ridge of that factor, part of the diagonal.
const RIDGE: f64 = 1e-13;
/// Part of a function's own size that rounding leaves along an undetermined direction it does not touch.
const ROUNDING: f64 = 1e-6;
/// A direction of what is tested with less than this part of its own information left cannot be tested.
const TESTABLE: f64 = 1e-9;

/// One Newton step and covariance of linear functions of the global unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Change of each function in the step.
    pub shift: DVector<f64>,
    /// Their covariance, over the determined directions.
    pub covariance: DMatrix<f64>,
    /// False where a function moves along an undetermined direction.
    pub determined: Vec<bool>,
}

/// Prediction of `rows` (functions x global unknowns); `None` where a block is indefinite or a number is not finite.
pub fn predict(equations: &NormalEquations, rows: &DMatrix<f64>) -> Option<Prediction> {
    let (s, rhs) = reduced(equations)?;
    let n = s.nrows();
    if n > LARGE {
        let ridge = DVector::from_fn(n, |i, _| RIDGE * equations.h_gg[(i, i)].max(f64::MIN_POSITIVE));
        let factor = Cholesky::of(&(s + DMatrix::from_diagonal(&ridge)))?;
        let x = factor.solve(&rows.transpose());
        let covariance = rows * &x;
        // Held by the ridge, not by the equations.
        let held = |k: usize| x.column(k).component_mul(&x.column(k)).dot(&ridge) / covariance[(k, k)];
        let determined = (0..rows.nrows()).map(|k| held(k) < 1e-3 || covariance[(k, k)] == 0.0).collect();
        return Some(Prediction { shift: x.tr_mul(&rhs), covariance, determined });
    }
    let inverse = Inverse::of(&s, &scales(equations, &(0..n).collect::<Vec<_>>()), &equations.known, FLAT)?;
    // What nothing sees has a unit diagonal instead of a null direction.
    let unseen: Vec<usize> = (0..n).filter(|&i| equations.h_gg[(i, i)] <= 0.0).collect();
    let scale = scales(equations, &(0..n).collect::<Vec<_>>());
    let still = |k: usize| {
        let row = rows.row(k).transpose();
        let size = row.component_mul(&scale).norm();
        unseen.iter().all(|&i| row[i] == 0.0)
            && inverse.null.column_iter().all(|d| {
                let terms = row.component_mul(&d);
                terms.sum().abs() <= (1e-4 * terms.abs().sum()).max(ROUNDING * size)
            })
    };
    let x = &inverse.matrix * rows.transpose();
    Some(Prediction {
        shift: x.tr_mul(&rhs),
        covariance: rows * &x,
        determined: (0..rows.nrows()).map(still).collect(),
    })
}

fn reduced(equations: &NormalEquations) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let (s, rhs, _) = over_determined(equations)?;
    let s = DMatrix::from_fn(s.nrows(), s.nrows(), |i, j| s[(i.max(j), i.min(j))]);
    Some((s, rhs))
}

/// `1 / sqrt(H_ii)` of the unknowns listed.
fn scales(equations: &NormalEquations, at: &[usize]) -> DVector<f64> {
    DVector::from_fn(at.len(), |i, _| {
        let d = equations.h_gg[(at[i], at[i])];
        if d > 0.0 { d.sqrt().recip() } else { 1.0 }
    })
}

/// Inverse over the directions whose share of information is above a limit.
struct Inverse {
    matrix: DMatrix<f64>,
    /// The other directions, in the unknowns' own units.
    null: DMatrix<f64>,
    rank: usize,
}

impl Inverse {
    fn of(s: &DMatrix<f64>, scale: &DVector<f64>, known: &Known, limit: f64) -> Option<Self> {
        let n = s.nrows();
        let scaled = DMatrix::from_fn(n, n, |i, j| s[(i, j)] * scale[i] * scale[j]);
        let Directions { values, vectors, nullity } = Directions::of(&scaled, scale, known, limit)?;
        let mut matrix = DMatrix::zeros(n, n);
        for i in nullity..n {
            let v = vectors.column(i).component_mul(scale);
            matrix.ger(1.0 / values[i], &v, &v, 1.0);
        }
        let null = DMatrix::from_fn(n, nullity, |i, k| vectors[(i, k)] * scale[i]);
        Some(Self { matrix, null, rank: n - nullity })
    }
}

/// A model with further unknowns, ready for tests of whether they are needed.
#[derive(Debug, Clone)]
pub struct ScoreTests {
    information: DMatrix<f64>,
    rhs: DVector<f64>,
    base: Vec<usize>,
    base_inverse: DMatrix<f64>,
}

/// Result of one test.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Chi-square where nothing but the base is true.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub degrees: usize,
    /// Estimate of each column of the basis.
    pub estimate: DVector<f64>,
    /// Covariance of the estimate.
    pub covariance: DMatrix<f64>,
    /// Change of the base unknowns (in their order) when what is tested is added.
    pub shift: DVector<f64>,
}

impl ScoreTests {
    /// `equations` of the model with all further unknowns, at the minimum of the one without; `base` lists the global unknowns of
    /// the latter. `None` where the equations are broken.
    pub fn of(equations: &NormalEquations, base: Vec<usize>) -> Option<Self> {
        let (information, rhs) = reduced(equations)?;
        let s = DMatrix::from_fn(base.len(), base.len(), |i, j| information[(base[i], base[j])]);
        let inverse = Inverse::of(&s, &scales(equations, &base), &equations.known.of(&base), FLAT)?;
        Some(Self { information, rhs, base, base_inverse: inverse.matrix })
    }

    /// `(S_tt, S_tx, r_t, r_x)` of what is `tested`.
    fn parts(&self, tested: &[usize]) -> (DMatrix<f64>, DMatrix<f64>, DVector<f64>, DVector<f64>) {
        let of = |a: &[usize], b: &[usize]| DMatrix::from_fn(a.len(), b.len(), |i, j| self.information[(a[i], b[j])]);
        let rhs = |a: &[usize]| DVector::from_fn(a.len(), |i, _| self.rhs[a[i]]);
        (of(tested, tested), of(tested, &self.base), rhs(tested), rhs(&self.base))
    }

    /// M and g of what is `tested` where all of it is free (B the identity).
    pub fn left(&self, tested: &[usize]) -> (DMatrix<f64>, DVector<f64>) {
        let (s_tt, s_tx, r_t, r_x) = self.parts(tested);
        let carried = &self.base_inverse * s_tx.transpose();
        (s_tt - &s_tx * &carried, r_t - carried.tr_mul(&r_x))
    }

    /// Tests `tested = basis eta` (basis: tested x m); the remaining further unknowns stay zero. `None` where the images say nothing
    /// about it.
    pub fn test(&self, tested: &[usize], basis: &DMatrix<f64>) -> Option<Score> {
        let (s_tt, s_tx, r_t, r_x) = self.parts(tested);
        let alone = basis.tr_mul(&(s_tt * basis));
        let cross = basis.tr_mul(&s_tx);
        let carried = &self.base_inverse * cross.transpose();
        let own = &alone - &cross * &carried;
        let g = basis.tr_mul(&r_t) - carried.tr_mul(&r_x);
        let scale = alone.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 1.0 });
        let inverse = Inverse::of(&own, &scale, &Known::default(), TESTABLE)?;
        let estimate = &inverse.matrix * &g;
        (inverse.rank > 0).then(|| Score {
            statistic: g.dot(&estimate).max(0.0),
            degrees: inverse.rank,
            shift: -(carried * &estimate),
            covariance: inverse.matrix,
            estimate,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::Block;

    /// Rows of a linear problem with two global unknowns of the base, one tested, and one of a block.
    fn rows(k: usize) -> [f64; 4] {
        let x = k as f64 / 7.0;
        [1.0, x, x * x - 0.3, (3.0 * x).sin()]
    }

    fn equations(y: &[f64], used: usize) -> NormalEquations {
        let mut e = NormalEquations {
            h_gg: DMatrix::zeros(used, used),
            b_g: DVector::zeros(used),
            blocks: vec![Block { h_vv: DMatrix::zeros(1, 1), h_vg: DMatrix::zeros(1, used), b_v: DVector::zeros(1) }],
            known: Known::default(),
            cost: 0.0,
        };
        for (k, y) in y.iter().enumerate() {
            let r = rows(k);
            for i in 0..used {
                e.b_g[i] += r[i] * y;
                e.blocks[0].h_vg[(0, i)] += r[3] * r[i];
                (0..used).for_each(|j| e.h_gg[(i, j)] += r[i] * r[j]);
            }
            e.blocks[0].h_vv[(0, 0)] += r[3] * r[3];
            e.blocks[0].b_v[0] += r[3] * y;
        }
        e
    }

    /// In a linear problem the statistic is the decrease of the sum of squares, and estimate and shift are those of the larger fit.
    #[test]
    fn the_score_of_a_linear_problem_is_its_likelihood_ratio() {
        let y: Vec<f64> = (0..12).map(|k| (1.7 * k as f64).cos() + 0.2 * rows(k)[2]).collect();
        let identity = |n: usize| DMatrix::<f64>::identity(n, n);
        let small = predict(&equations(&y, 2), &identity(2)).unwrap();
        let large = predict(&equations(&y, 3), &identity(3)).unwrap();
        let squares = |x: &[f64]| {
            // The block's unknown by its own least squares.
            let left: Vec<f64> =
                y.iter().enumerate().map(|(k, y)| y - (0..x.len()).map(|i| rows(k)[i] * x[i]).sum::<f64>()).collect();
            let (num, den) =
                left.iter().enumerate().fold((0.0, 0.0), |(n, d), (k, l)| (n + rows(k)[3] * l, d + rows(k)[3].powi(2)));
            left.iter().enumerate().map(|(k, l)| (l - rows(k)[3] * num / den).powi(2)).sum::<f64>()
        };
        // The equations of the larger model where the smaller one ends: linear, so the right-hand side is not zero there.
        let tests = ScoreTests::of(&equations(&y, 3), vec![0, 1]).unwrap();
        let score = tests.test(&[2], &identity(1)).unwrap();
        let drop = squares(small.shift.as_slice()) - squares(large.shift.as_slice());
        assert_eq!(score.degrees, 1);
        assert!((score.statistic - drop).abs() < 1e-10 * drop, "{} {drop}", score.statistic);
        assert!((score.estimate[0] - large.shift[2]).abs() < 1e-10);
        assert!((score.covariance[(0, 0)] / large.covariance[(2, 2)] - 1.0).abs() < 1e-10);
        for k in 0..2 {
            assert!((small.shift[k] + score.shift[k] - large.shift[k]).abs() < 1e-10);
        }
        // The same direction twice is one degree of freedom.
        let twice = tests.test(&[2], &DMatrix::from_row_slice(1, 2, &[1.0, -2.0])).unwrap();
        assert_eq!(twice.degrees, 1);
        assert!((twice.statistic - score.statistic).abs() < 1e-9);
    }

    #[test]
    fn what_nothing_determines_is_said() {
        let mut e = equations(&[1.0, 2.0, 0.5, 0.1], 2);
        // The second unknown is the first once more.
        for j in 0..2 {
            (e.h_gg[(1, j)], e.h_gg[(j, 1)]) = (e.h_gg[(0, 0)], e.h_gg[(0, 0)]);
        }
        e.blocks[0].h_vg[(0, 1)] = e.blocks[0].h_vg[(0, 0)];
        e.b_g[1] = e.b_g[0];
        let p = predict(&e, &DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, -1.0])).unwrap();
        assert_eq!(p.determined, [true, false]);
        // An unknown that no row sees.
        let mut e = equations(&[1.0, 2.0, 0.5, 0.1], 2);
        e.h_gg[(1, 1)] = 0.0;
        (e.h_gg[(0, 1)], e.h_gg[(1, 0)], e.blocks[0].h_vg[(0, 1)], e.b_g[1]) = (0.0, 0.0, 0.0, 0.0);
        let p = predict(&e, &DMatrix::identity(2, 2)).unwrap();
        assert_eq!(p.determined, [true, false]);
    }
}
