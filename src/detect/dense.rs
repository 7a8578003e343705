//! Normal equations of one disc: light first, blur and geometry last.
//!
//! `A x = r` by Cholesky's factor `A = L L^T`; the last block of the factor is that of the Schur complement on the geometry, so the price of not
//! knowing light and blur is at hand. Sums of products are eight running ones, as wide as the processor is.

use crate::conic::inverse_of_lower;
use crate::lanes::{self, Kernel, Lanes, dots};
use nalgebra::{SMatrix, SVector};

/// Unknowns that come last: blur and geometry.
pub(crate) const FIXED: usize = 6;
/// Rows and columns of the factor that are found, or used, side by side.
const ROWS: usize = 3;
const COLUMNS: usize = 4;

/// Dense normal equations, blur and geometry last.
#[derive(Debug, Default, Clone)]
pub(crate) struct Dense {
    /// Lower triangle, row by row; the Cholesky factor once solved.
    pub(crate) matrix: Vec<f64>,
    /// Right side; the unknowns once solved.
    pub(crate) right: Vec<f64>,
    /// Covariance of the geometry.
    pub(crate) covariance: SMatrix<f64, 5, 5>,
}

impl Dense {
    /// Zeros for `n` unknowns.
    pub(crate) fn clear(&mut self, n: usize) {
        self.matrix.clear();
        self.matrix.resize(n * n, 0.0);
        self.right.clear();
        self.right.resize(n, 0.0);
    }

    /// Adds to the equations of blur and geometry.
    pub(crate) fn add_last(&mut self, n: usize, fixed: &SMatrix<f64, FIXED, FIXED>, right: &SVector<f64, FIXED>) {
        let at = n - FIXED;
        for i in 0..FIXED {
            for j in 0..=i {
                self.matrix[(at + i) * n + at + j] += fixed[(i, j)];
            }
            self.right[at + i] += right[i];
        }
    }

    /// Solves in place (lower triangle) and says how well the geometry is known; false where the matrix is not positive definite.
    pub(crate) fn solve(&mut self, n: usize) -> bool {
        self.unknowns(n) && self.geometry(n)
    }

    /// Solves in place (lower triangle); false where the matrix is not positive definite.
    pub(crate) fn unknowns(&mut self, n: usize) -> bool {
        let positive = lanes::run(Factor { a: &mut self.matrix, n });
        if positive {
            substitute(&self.matrix, &mut self.right, n);
        }
        positive
    }

    /// Solves for several right sides at a time, in place, with the factor.
    pub(crate) fn solve_each<const K: usize>(&self, right: &mut [[f64; K]]) {
        lanes::run(SubstituteEach { factor: &self.matrix, right });
    }

    /// Cholesky's factor of the Schur complement on blur and geometry.
    pub(crate) fn fixed_factor(&self, n: usize) -> SMatrix<f64, FIXED, FIXED> {
        let at = n - FIXED;
        SMatrix::from_fn(|i, j| if j <= i { self.matrix[(at + i) * n + at + j] } else { 0.0 })
    }

    /// Variances of the first `count` of the `n` unknowns, from the factor.
    pub(crate) fn variances(&self, count: usize, n: usize) -> Vec<f64> {
        lanes::run(Inverse { factor: &self.matrix, n, count })
    }

    /// Covariance of the geometry, from the factor; false where the geometry is not fixed.
    pub(crate) fn geometry(&mut self, n: usize) -> bool {
        // Its last block is that of the Schur complement on the geometry alone.
        let lower = self.fixed_factor(n).fixed_view::<5, 5>(1, 1).into_owned();
        let Some(root) = inverse_of_lower(&lower) else { return false };
        self.covariance = root.tr_mul(&root);
        self.covariance.trace().is_finite()
    }
}

/// Diagonal of the inverse, from the factor.
struct Inverse<'a> {
    factor: &'a [f64],
    n: usize,
    count: usize,
}

impl Kernel for Inverse<'_> {
    type Output = Vec<f64>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Vec<f64> {
        let Self { factor, n, count } = self;
        let (mut column, mut out) = (vec![0.0; n], vec![0.0; count]);
        for (j, variance) in out.iter_mut().enumerate() {
            for i in j..n {
                let [[dot]] = dots::<L, 1, 1>([&column[j..i]], [&factor[i * n + j..i * n + i]]);
                column[i] = (f64::from(u8::from(i == j)) - dot) / factor[i * n + i];
                *variance += column[i] * column[i];
            }
        }
        out
    }
}

/// Solves with the factor for several right sides, in place.
struct SubstituteEach<'a, const K: usize> {
    factor: &'a [f64],
    right: &'a mut [[f64; K]],
}

impl<const K: usize> Kernel for SubstituteEach<'_, K> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { factor, right } = self;
        let n = right.len();
        (0..n).for_each(|i| forward(&factor[i * n..=i * n + i], right, i));
        let mut end = n;
        while end > 0 {
            let first = end.saturating_sub(COLUMNS);
            backward(factor, right, first, end);
            end = first;
        }
    }
}

/// Unknown `i` from those before it, by a row of the factor: four running sums, which need not wait for each other.
#[inline(always)]
fn forward<const K: usize>(row: &[f64], right: &mut [[f64; K]], i: usize) {
    let (known, rest) = right.split_at_mut(i);
    let mut sums = [[0.0; K]; COLUMNS];
    let whole = i / COLUMNS * COLUMNS;
    for at in (0..whole).step_by(COLUMNS) {
        for s in 0..COLUMNS {
            for l in 0..K {
                sums[s][l] = row[at + s].mul_add(known[at + s][l], sums[s][l]);
            }
        }
    }
    for at in whole..i {
        for l in 0..K {
            sums[0][l] = row[at].mul_add(known[at][l], sums[0][l]);
        }
    }
    for l in 0..K {
        let sum = (sums[0][l] + sums[1][l]) + (sums[2][l] + sums[3][l]);
        rest[0][l] = (rest[0][l] - sum) / row[i];
    }
}

/// Unknowns `first` to `end`, and what they take from those before them.
#[inline(always)]
fn backward<const K: usize>(factor: &[f64], right: &mut [[f64; K]], first: usize, end: usize) {
    let n = right.len();
    for i in (first..end).rev() {
        let row = &factor[i * n..=i * n + i];
        let (above, rest) = right.split_at_mut(i);
        for l in 0..K {
            rest[0][l] /= row[i];
        }
        for k in first..i {
            for l in 0..K {
                above[k][l] = (-row[k]).mul_add(rest[0][l], above[k][l]);
            }
        }
    }
    let (above, block) = right.split_at_mut(first);
    for (k, x) in above.iter_mut().enumerate() {
        for (s, found) in block[..end - first].iter().enumerate() {
            let a = factor[(first + s) * n + k];
            for l in 0..K {
                x[l] = (-a).mul_add(found[l], x[l]);
            }
        }
    }
}

/// Cholesky's factor in place of a lower triangle; false where that is not positive definite.
struct Factor<'a> {
    a: &'a mut [f64],
    n: usize,
}

impl Kernel for Factor<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(mut self) -> bool {
        let n = self.n;
        for j in (0..n).step_by(COLUMNS) {
            let end = (j + COLUMNS).min(n);
            for i in j..end {
                if !self.row_of_block::<L>(j, i) {
                    return false;
                }
            }
            let mut i = end;
            while i + ROWS <= n {
                self.rows_below::<L, ROWS>(j, i);
                i += ROWS;
            }
            for i in i..n {
                self.rows_below::<L, 1>(j, i);
            }
        }
        true
    }
}

impl Factor<'_> {
    /// Row `i` of the block of columns from `first` on, to its diagonal; false where that is not positive.
    #[inline(always)]
    fn row_of_block<L: Lanes>(&mut self, first: usize, i: usize) -> bool {
        let n = self.n;
        let (above, row) = self.a.split_at_mut(i * n);
        for j in first..i {
            let other = &above[j * n..=j * n + j];
            let [[dot]] = dots::<L, 1, 1>([&row[..j]], [&other[..j]]);
            row[j] = (row[j] - dot) / other[j];
        }
        let before = row[i];
        let [[squares]] = dots::<L, 1, 1>([&row[..i]], [&row[..i]]);
        let diagonal = before * (1.0 + 1e-12) - squares;
        row[i] = diagonal.sqrt();
        diagonal > 1e-13 * before && diagonal.is_finite()
    }

    /// The columns from `first` on of `A` rows from `i` on, which lie below the block.
    #[inline(always)]
    fn rows_below<L: Lanes, const A: usize>(&mut self, first: usize, i: usize) {
        let n = self.n;
        let (above, below) = self.a.split_at_mut(i * n);
        let (mut rows, mut own) = ([&below[..0]; A], [&above[..0]; COLUMNS]);
        for k in 0..A {
            rows[k] = &below[k * n..][..first];
        }
        for c in 0..COLUMNS {
            own[c] = &above[(first + c) * n..][..first];
        }
        let dot = dots::<L, A, COLUMNS>(rows, own);
        for k in 0..A {
            let row = &mut below[k * n + first..][..COLUMNS];
            for c in 0..COLUMNS {
                let corner = &above[(first + c) * n + first..][..=c];
                row[c] -= dot[k][c];
                for d in 0..c {
                    row[c] -= row[d] * corner[d];
                }
                row[c] /= corner[c];
            }
        }
    }
}

/// Solves with the factor, in place.
fn substitute(a: &[f64], b: &mut [f64], n: usize) {
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| a[i * n + k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let x = b[i] / a[i * n + i];
        b[i] = x;
        b[..i].iter_mut().zip(&a[i * n..i * n + i]).for_each(|(b, a)| *b -= a * x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[derive(Clone)]
    struct Made {
        a: Vec<f64>,
        n: usize,
    }
    impl Kernel for Made {
        type Output = Vec<u64>;
        #[inline(always)]
        fn run<L: Lanes>(mut self) -> Vec<u64> {
            assert!(Factor { a: &mut self.a, n: self.n }.run::<L>());
            self.a.into_iter().map(f64::to_bits).collect()
        }
    }

    fn positive(n: usize) -> (Vec<f64>, Vec<f64>) {
        let root = DMatrix::from_fn(n + 3, n, |i, j| ((i * 37 + j * 91) as f64 * 0.618).fract() - 0.5);
        let square = root.transpose() * &root + DMatrix::identity(n, n);
        (square.transpose().as_slice().to_vec(), (0..n).map(|i| (i as f64 * 0.7).sin()).collect())
    }

    #[test]
    fn unknowns_are_those_of_a_library_and_all_widths_agree() {
        for n in [6, 7, 12, 19, 41, 130] {
            let (matrix, right) = positive(n);
            let mut dense = Dense { matrix: matrix.clone(), right: right.clone(), ..Dense::default() };
            assert!(dense.solve(n));
            let full = DMatrix::from_row_slice(n, n, &matrix);
            let expected = full.clone().cholesky().unwrap().solve(&DVector::from_vec(right));
            let off = (DVector::from_vec(dense.right.clone()) - &expected).amax();
            assert!(off < 1e-9 * expected.amax(), "{n}: {off}");
            let inverse = full.try_inverse().unwrap();
            let covariance = inverse.view((n - 5, n - 5), (5, 5));
            assert!((dense.covariance - covariance).amax() < 1e-9 * covariance.amax(), "{n}");
            let mut each = [3, n - 1].map(|j| (0..n).map(|i| f64::from(u8::from(i == j))).collect::<Vec<_>>());
            let mut right: Vec<[f64; 2]> = (0..n).map(|i| [each[0][i], each[1][i]]).collect();
            dense.solve_each(&mut right);
            (0..n).for_each(|i| (each[0][i], each[1][i]) = (right[i][0], right[i][1]));
            for (column, j) in each.iter().zip([3, n - 1]) {
                let off = (DVector::from_column_slice(column) - inverse.column(j)).amax();
                assert!(off < 1e-9 * inverse.column(j).amax(), "{n}: {off}");
            }
            let variances = dense.variances(3, n);
            assert!((0..3).all(|i| (variances[i] / inverse[(i, i)] - 1.0).abs() < 1e-9), "{n}");
            let all = lanes::run_all(&Made { a: matrix, n });
            all.iter().for_each(|one| assert_eq!(*one, all[0]));
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let mut dense = Dense { matrix: vec![1.0, 0.0, 2.0, 1.0], right: vec![1.0, 1.0], ..Dense::default() };
        assert!(!dense.unknowns(2));
        dense.matrix = vec![f64::NAN, 0.0, 0.0, 1.0];
        assert!(!dense.unknowns(2));
    }
}
