//! Combinations of global unknowns of which the equations say less than other knowledge does, and equations without what they say of these.
//!
//! Near-flat directions carry information that is noise: a minimum along them lies anywhere, and a rank that is judged by rounding counts them as
//! determined. So they are measured by what is usual of them. With the blocks eliminated the global unknowns have the information S and the
//! right-hand side r; A holds whitened rows, each of which is one standard deviation of what is usual:
//! ```text
//! M = A S^-1 A^T = V diag(1 / j) V^T      covariance of what is usual by the equations alone; j: information on the combinations V^T A
//! open: j < 1                              the equations know less of it than is usual (share of the prior in both together 1 / (1 + j) > 1/2)
//! G = S^-1 A^T V_open                      how all global unknowns move along it
//! H_gg' = H_gg - S G (G^T S G)^-1 G^T S = H_gg - A^T V_open diag(j) V_open^T A
//! b_g'  = b_g - S G (G^T S G)^-1 G^T r  = b_g - A^T V_open diag(j) V_open^T A S^-1 r
//! ```
//! H' is the information where everything may move along G by any amount: `S' G = 0`, and nothing else is lost. The blocks follow G as they do in S,
//! so that only their global part changes. S is inverted by its eigenvalues, scaled as in [`mod@super::posterior`]; one that is nothing but rounding counts
//! as that, which makes M large and j small: both are then of no size in H'.
//!
//! | symbol | identifier | shape | meaning |
//! |---|---|---|---|
//! | A | `rows` | k x n | derivatives of what is usual by the global unknowns, whitened |
//! | j | [`OpenCombinations::information`] | k | ascending |
//! | V | [`OpenCombinations::combinations`] | k x k | columns, in the order of j |

use super::NormalEquations;
use super::factor::symmetric_eigen;
use super::flat::over_determined;
use nalgebra::{DMatrix, DVector};

/// Least share of information of a direction that is not told from rounding.
const ROUNDING: f64 = f64::EPSILON;
/// Information, that of what is usual being one, below which a combination is open.
const USUAL: f64 = 1.0;

/// What equations say of combinations of rows.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenCombinations {
    /// Information on each combination, ascending, in units of that of what is usual.
    pub information: DVector<f64>,
    /// The combinations, orthonormal columns.
    pub combinations: DMatrix<f64>,
    /// `j V^T A S^-1 r` of each combination.
    pull: DVector<f64>,
}

impl OpenCombinations {
    /// Of `rows` (k x n, whitened) by the global unknowns; `None` where there is no row, where one moves nothing, or where the equations are broken.
    pub fn of(equations: &NormalEquations, rows: &DMatrix<f64>) -> Option<Self> {
        let (s, rhs, _) = over_determined(equations)?;
        let n = s.nrows();
        let scale = equations.h_gg.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 1.0 });
        let a = DMatrix::from_fn(rows.nrows(), n, |k, i| rows[(k, i)] * scale[i]);
        if a.nrows() == 0 || a.row_iter().any(|r| r.norm_squared() == 0.0) {
            return None;
        }
        let scaled = DMatrix::from_fn(n, n, |i, j| s[(i.max(j), i.min(j))] * scale[i] * scale[j]);
        let eigen = symmetric_eigen(&scaled)?;
        // A S^-1/2: a sum of squares has no negative eigenvalue.
        let mut root = &a * &eigen.vectors;
        let least = eigen.values.map(|v| v.max(ROUNDING).sqrt());
        root.column_iter_mut().zip(least.iter()).for_each(|(mut c, l)| c /= *l);
        let own = symmetric_eigen(&(&root * root.transpose()))?;
        let k = rows.nrows();
        let descending = |i: usize| k - 1 - i;
        let information = DVector::from_fn(k, |i, _| own.values[descending(i)].max(f64::MIN_POSITIVE).recip());
        let combinations = DMatrix::from_fn(k, k, |i, j| own.vectors[(i, descending(j))]);
        let along = eigen.vectors.tr_mul(&rhs.component_mul(&scale)).component_div(&least);
        let pull = combinations.tr_mul(&(root * along)).component_mul(&information);
        Some(Self { information, combinations, pull })
    }

    /// Number of open combinations.
    pub fn open(&self) -> usize {
        self.information.iter().filter(|j| **j < USUAL).count()
    }

    /// As many rows as there are open combinations, those that move most along them, in their order.
    pub fn leading_rows(&self) -> Vec<usize> {
        let mut left = self.combinations.columns(0, self.open()).into_owned();
        let mut out = vec![];
        for _ in 0..self.open() {
            let norms: Vec<f64> = left.row_iter().map(|r| r.norm_squared()).collect();
            let Some(first) = (0..norms.len()).reduce(|a, b| if norms[b] > norms[a] { b } else { a }) else { break };
            let along = left.row(first).transpose() / norms[first].sqrt();
            left -= (&left * &along) * along.transpose();
            out.push(first);
        }
        out.sort_unstable();
        out
    }

    /// The equations without what they say of the open combinations of the same `rows`.
    pub fn taken_from(&self, equations: &NormalEquations, rows: &DMatrix<f64>) -> NormalEquations {
        let mut out = equations.clone();
        // What is known beforehand says nothing of them either.
        out.known.rows.clear();
        for k in 0..self.open() {
            let along = rows.tr_mul(&self.combinations.column(k));
            out.h_gg.ger(-self.information[k], &along, &along, 1.0);
            out.b_g.axpy(-self.pull[k], &along, 1.0);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Block, Known, posterior};
    use super::*;

    /// Unknowns: four global ones, then one block of two. The first two are hardly seen apart from the rest.
    fn observations() -> DMatrix<f64> {
        DMatrix::from_fn(40, 6, |k, i| {
            let x = k as f64 / 9.0;
            match i {
                0 => 2e-3 * (2.3 * x).sin() + (1.1 * x).cos(),
                1 => 1e-3 * (3.1 * x).cos() + 0.4 * x * x,
                2 => (1.1 * x).cos(),
                3 => 0.4 * x * x + 0.3 * (0.7 * x).sin(),
                4 => (0.7 * x).sin(),
                _ => 1.0 + 0.1 * x,
            }
        })
    }

    fn equations(j: &DMatrix<f64>, y: &DVector<f64>) -> NormalEquations {
        let (h, b) = (j.tr_mul(j), j.tr_mul(y));
        let block = Block {
            h_vv: h.view((4, 4), (2, 2)).into_owned(),
            h_vg: h.view((4, 0), (2, 4)).into_owned(),
            b_v: b.rows(4, 2).into_owned(),
        };
        let (h_gg, b_g) = (h.view((0, 0), (4, 4)).into_owned(), b.rows(0, 4).into_owned());
        NormalEquations { h_gg, b_g, blocks: vec![block], known: Known::default(), cost: 0.0 }
    }

    /// The same as observations projected on what no movement along the open combination explains.
    #[test]
    fn what_is_taken_is_what_a_free_movement_would_take() {
        let j = observations();
        let y = DVector::from_fn(40, |k, _| (1.7 * k as f64).cos());
        let e = equations(&j, &y);
        let h = j.tr_mul(&j);
        // The images alone know the first number to sigmas[0], the second to sigmas[1].
        let inverse = h.clone().try_inverse().unwrap();
        let sigmas = [0, 1].map(|i| inverse[(i, i)].sqrt());
        let mut rows = DMatrix::zeros(2, 4);
        (rows[(0, 0)], rows[(1, 1)]) = (3.0 / sigmas[0], 0.01 / sigmas[1]);
        let found = OpenCombinations::of(&e, &rows).unwrap();
        let of_rows = rows.clone().resize_horizontally(6, 0.0);
        let wanted = (&of_rows * &inverse * of_rows.transpose()).try_inverse().unwrap().symmetric_eigenvalues();
        assert_eq!(found.open(), 1);
        assert_eq!(found.leading_rows(), [0]);
        for (ours, wanted) in found.information.iter().zip([wanted.min(), wanted.max()]) {
            assert!((ours / wanted - 1.0).abs() < 1e-5, "{ours} {wanted}");
        }
        let v = found.combinations.column(0);
        let both = (&h + of_rows.tr_mul(&of_rows)).try_inverse().unwrap();
        let movement = &j * both * of_rows.tr_mul(&v);
        let along = movement.normalize();
        let project = |m: &DMatrix<f64>| m - &along * along.tr_mul(m);
        let projected = project(&j);
        let wanted = equations(&projected, &y);
        let ours = found.taken_from(&e, &rows);
        assert!((&ours.h_gg - &wanted.h_gg).amax() < 1e-9 * e.h_gg.amax());
        assert!((&ours.b_g - &wanted.b_g).amax() < 1e-9 * e.b_g.amax());
        assert_eq!(ours.blocks, e.blocks);
        assert!((&wanted.blocks[0].h_vg - &e.blocks[0].h_vg).amax() < 1e-9);
        let post = posterior(&ours);
        assert_eq!(post.nullity, 1, "{}", post.information_shares);
        let g = &inverse * of_rows.tr_mul(&v);
        let moved = post.null_movements.column(0);
        assert!((moved.normalize().dot(&g.normalize()).abs() - 1.0).abs() < 1e-6, "{moved} {g}");
    }

    /// Where the equations know more than is usual nothing is open and nothing changes.
    #[test]
    fn what_is_known_stays() {
        let e = equations(&observations(), &DVector::from_element(40, 1.0));
        let mut rows = DMatrix::zeros(1, 4);
        rows[(0, 2)] = 1e-9;
        let found = OpenCombinations::of(&e, &rows).unwrap();
        assert_eq!(found.open(), 0);
        assert!(found.leading_rows().is_empty());
        assert_eq!(found.taken_from(&e, &rows), e);
        assert!(OpenCombinations::of(&e, &DMatrix::zeros(0, 4)).is_none());
        assert!(OpenCombinations::of(&e, &DMatrix::zeros(1, 4)).is_none());
    }
}
