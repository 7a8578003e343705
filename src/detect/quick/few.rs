//! Normal equations of a clean disc, the slopes of its light last: one factor answers with slopes and without.
//!
//! ```text
//! A = U^T U,  U^T y = r,   in blocks (1: levels, blur, geometry; 2: slopes)   U = [U11 U12; 0 U22]
//! free:  U x = y                      held at x2 = e:  U11 x1 = y1 - U12 e,   chi^2 grows by |U22 e - y2|^2
//! ```
//!
//! `U11` alone is the factor of the equations without slopes, which gives the covariance of the geometry then.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | A, U; r, y | `rows` | 12 x 12; 12, in column 12 | | normal matrix and right side, upper triangle, then the factor and what it makes of the right side |
//! | e | `held` | 4 | grey | change of the slopes to where they are held |

use super::{M, N, place};
use crate::detect::dense::Dense;
use crate::lanes::{Kernel, Lanes};

/// Unknowns in the order of the equations, each by its column: levels, blur, geometry, slopes.
pub(super) const ORDER: [usize; N] = [0, 3, 6, 7, 8, 9, 10, 11, 1, 2, 4, 5];
/// Unknowns but for the slopes.
pub(super) const KEPT: usize = 8;
/// Slopes.
pub(super) const SLOPES: usize = N - KEPT;
/// Numbers in a row, those that only fill it included.
const WIDE: usize = 16;

/// The equations, then their factor.
#[derive(Debug, Default)]
pub(super) struct Few {
    rows: [[f64; WIDE]; N],
}

impl Few {
    /// Equations from the products of the columns.
    pub(super) fn set(&mut self, gram: &[f64]) {
        for (i, row) in self.rows.iter_mut().enumerate() {
            *row = [0.0; WIDE];
            for j in i..N {
                let (a, b) = (ORDER[i].max(ORDER[j]), ORDER[i].min(ORDER[j]));
                row[j] = gram[place(a, b)];
            }
            row[N] = gram[place(M - 1, ORDER[i])];
        }
    }

    /// Adds an observation of one unknown, by its place in the order: its weight, and where it says that the unknown is.
    pub(super) fn add(&mut self, i: usize, weight: f64, at: f64) {
        self.rows[i][i] += weight;
        self.rows[i][N] += weight * at;
    }

    /// All unknowns, in order.
    pub(super) fn free(&self) -> [f64; N] {
        let mut x = [0.0; N];
        self.substitute(N, &mut x);
        x
    }

    /// By how much `chi^2` grows where slopes are held.
    pub(super) fn price(&self, held: &[f64; SLOPES]) -> f64 {
        let left = |i: usize| {
            let row = &self.rows[KEPT + i];
            (i..SLOPES).map(|k| row[KEPT + k] * held[k]).sum::<f64>() - row[N]
        };
        (0..SLOPES).map(|i| left(i).powi(2)).sum()
    }

    /// All unknowns, in order, where slopes are held.
    pub(super) fn held(&self, held: &[f64; SLOPES]) -> [f64; N] {
        let mut x = [0.0; N];
        x[KEPT..].copy_from_slice(held);
        self.substitute(KEPT, &mut x);
        x
    }

    /// The first `n` unknowns from those behind them.
    fn substitute(&self, n: usize, x: &mut [f64; N]) {
        for i in (0..n).rev() {
            let row = &self.rows[i];
            let known: f64 = (i + 1..N).map(|k| row[k] * x[k]).sum();
            x[i] = (row[N] - known) / row[i];
        }
    }

    /// The factor without slopes, geometry last.
    pub(super) fn factor_without_slopes(&self, out: &mut Dense) {
        out.clear(KEPT);
        for i in 0..KEPT {
            for j in 0..=i {
                out.matrix[i * KEPT + j] = self.rows[j][i];
            }
        }
    }
}

/// The factor in place of the equations; false where they are not positive definite.
pub(super) struct Factor<'a>(pub(super) &'a mut Few);

impl Kernel for Factor<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let rows = &mut self.0.rows;
        let mut before = [0.0; N];
        for i in 0..N {
            before[i] = rows[i][i];
        }
        for j in 0..N {
            let diagonal = rows[j][j] + 1e-12 * before[j];
            if !(diagonal > 1e-13 * before[j] && diagonal.is_finite()) {
                return false;
            }
            let root = diagonal.sqrt();
            let inverse = L::splat(1.0 / root);
            let (head, below) = rows.split_at_mut(j + 1);
            let own = &mut head[j];
            let mut at = 0;
            while at < WIDE {
                (L::load(&own[at..]) * inverse).store(&mut own[at..]);
                at += L::N;
            }
            own[j] = root;
            for (i, row) in below.iter_mut().enumerate() {
                let factor = L::splat(-own[j + 1 + i]);
                let mut at = 0;
                while at < WIDE {
                    factor.fused(L::load(&own[at..]), L::load(&row[at..])).store(&mut row[at..]);
                    at += L::N;
                }
            }
        }
        true
    }
}

const _: () = assert!(N < WIDE && N + 1 == M, "the right side has a place in each row");

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::lanes;
    use nalgebra::{DMatrix, DVector};

    #[derive(Clone)]
    struct Made(Vec<f64>);
    impl Kernel for Made {
        type Output = Vec<u64>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<u64> {
            let mut few = Few::default();
            few.set(&self.0);
            assert!(Factor(&mut few).run::<L>());
            few.free().iter().chain(&few.rows.concat()).map(|x| x.to_bits()).collect()
        }
    }

    /// Products of columns that are as good as any.
    fn gram() -> (Vec<f64>, DMatrix<f64>) {
        let columns = DMatrix::from_fn(40, M, |i, j| ((i * 37 + j * 91) as f64 * 0.618).fract() - 0.5);
        let products = columns.transpose() * &columns;
        let lower = (0..M).flat_map(|a| (0..=a).map(move |b| (a, b))).map(|(a, b)| products[(a, b)]).collect();
        (lower, products)
    }

    /// Free and held, with an observation besides, against a library's solution of the equations written out.
    #[test]
    fn one_factor_solves_with_slopes_and_without() {
        let (lower, products) = gram();
        let mut few = Few::default();
        few.set(&lower);
        few.add(2, 0.7, -0.4);
        assert!(lanes::run(Factor(&mut few)));
        let mut matrix = DMatrix::from_fn(N, N, |i, j| products[(ORDER[i], ORDER[j])]);
        let mut right = DVector::from_fn(N, |i, _| products[(N, ORDER[i])]);
        matrix[(2, 2)] += 0.7;
        right[2] -= 0.28;
        let near = |found: &[f64], wanted: &DVector<f64>| {
            let off = (DVector::from_column_slice(found) - wanted).amax();
            assert!(off < 1e-9 * wanted.amax(), "{off}");
        };
        let free = matrix.clone().cholesky().expect("positive").solve(&right);
        near(&few.free(), &free);
        let held = [0.3, -0.2, 0.05, 0.4];
        let kept = matrix.view((0, 0), (KEPT, KEPT)).clone_owned();
        let beside = matrix.view((0, KEPT), (KEPT, SLOPES)) * DVector::from_column_slice(&held);
        let x = kept.clone().cholesky().expect("positive").solve(&(right.rows(0, KEPT) - beside));
        near(&few.held(&held)[..KEPT], &x);
        let whole = DVector::from_iterator(N, x.iter().chain(&held).copied());
        let chi2 = |x: &DVector<f64>| x.dot(&(&matrix * x)) - 2.0 * x.dot(&right);
        let price = chi2(&whole) - chi2(&free);
        assert!(price > 0.1 && (few.price(&held) / price - 1.0).abs() < 1e-9, "{price}");
        let mut dense = Dense::default();
        few.factor_without_slopes(&mut dense);
        assert!(dense.geometry(KEPT));
        let covariance = kept.try_inverse().expect("an inverse");
        let off = (dense.covariance - covariance.view((KEPT - 5, KEPT - 5), (5, 5))).amax();
        assert!(off < 1e-9 * covariance.amax(), "{off}");
    }

    #[test]
    fn all_widths_agree_and_what_is_not_positive_is_refused() {
        let (mut lower, _) = gram();
        let all = lanes::run_all(&Made(lower.clone()));
        all.iter().for_each(|one| assert_eq!(*one, all[0]));
        lower[place(7, 7)] = -1.0;
        let mut few = Few::default();
        few.set(&lower);
        assert!(!lanes::run(Factor(&mut few)));
    }
}
