//! Dense factorisations; the only file that names faer.

use super::tiles::{FEW, InverseRoot, Take};
use crate::lanes::{self, GROUP};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Accum, MatMut, MatRef, Par, Side};
use nalgebra::{DMatrix, DVector};

fn borrowed(m: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(m.as_slice(), m.nrows(), m.ncols())
}

/// Takes `Y^T Y` from the lower triangle of `s`, n x n; `y` holds the rows of Y, n each.
pub(super) fn take_product(s: &mut DMatrix<f64>, y: &[f64]) {
    let n = s.nrows();
    let columns = MatRef::from_column_major_slice(y, n, y.len() / n.max(1));
    let out = MatMut::from_column_major_slice_mut(s.as_mut_slice(), n, n);
    let whole = BlockStructure::Rectangular;
    let (lower, rows) = (BlockStructure::TriangularLower, columns.transpose());
    triangular::matmul(out, lower, Accum::Add, columns, whole, rows, whole, -1.0, Par::Seq);
}

/// Size of the pose of a view: loops of a known length are unrolled.
const POSE: usize = 6;

/// Writes the lower Cholesky factor of the n x n matrix in `l` (column by column, its lower triangle is read) over it; false
/// where it is not positive definite.
pub(super) fn factorise(l: &mut [f64], n: usize) -> bool {
    if n == POSE { factorise_in_loops(&mut l[..POSE * POSE], POSE) } else { factorise_in_loops(l, n) }
}

#[inline(always)]
fn factorise_in_loops(l: &mut [f64], n: usize) -> bool {
    for j in 0..n {
        let (done, rest) = l.split_at_mut(j * n);
        let column = &mut rest[j..n];
        for k in 0..j {
            let left = &done[k * n + j..(k + 1) * n];
            let factor = left[0];
            column.iter_mut().zip(left).for_each(|(c, x)| *c -= factor * x);
        }
        if !(column[0] > 0.0 && column[0].is_finite()) {
            return false;
        }
        let inverse = 1.0 / column[0].sqrt();
        column.iter_mut().for_each(|c| *c *= inverse);
    }
    true
}

/// `L^-1 x` in place.
pub(super) fn forward(l: &[f64], x: &mut [f64]) {
    let n = x.len();
    for k in 0..n {
        let column = &l[k * n + k..(k + 1) * n];
        let (head, tail) = x[k..].split_at_mut(1);
        head[0] /= column[0];
        tail.iter_mut().zip(&column[1..]).for_each(|(t, c)| *t -= head[0] * c);
    }
}

/// `L^-T x` in place.
pub(super) fn backward(l: &[f64], x: &mut [f64]) {
    let n = x.len();
    for k in (0..n).rev() {
        let column = &l[k * n + k..(k + 1) * n];
        let (head, tail) = x[k..].split_at_mut(1);
        let sum: f64 = tail.iter().zip(&column[1..]).map(|(t, c)| t * c).sum();
        head[0] = (head[0] - sum) / column[0];
    }
}

/// Cholesky factor of a symmetric positive definite matrix (its lower triangle is read).
#[derive(Debug)]
pub(super) enum Cholesky {
    Small(DMatrix<f64>),
    Large(Llt<f64>),
}

impl Cholesky {
    /// `None` where the matrix is not positive definite.
    pub(super) fn of(m: &DMatrix<f64>) -> Option<Self> {
        if m.nrows() <= FEW {
            let mut l = m.clone();
            return factorise(l.as_mut_slice(), m.nrows()).then_some(Cholesky::Small(l));
        }
        Llt::new(borrowed(m), Side::Lower).ok().map(Cholesky::Large)
    }
    /// Solution of `m x = rhs` for all columns.
    pub(super) fn solve(&self, rhs: &DMatrix<f64>) -> DMatrix<f64> {
        match self {
            Cholesky::Small(l) => {
                let mut out = rhs.clone();
                let n = l.nrows().max(1);
                for x in out.as_mut_slice().chunks_exact_mut(n) {
                    forward(l.as_slice(), x);
                    backward(l.as_slice(), x);
                }
                out
            }
            Cholesky::Large(l) => {
                let x = l.solve(borrowed(rhs));
                DMatrix::from_fn(rhs.nrows(), rhs.ncols(), |i, j| x[(i, j)])
            }
        }
    }
    /// Inverse of the matrix.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        match self {
            Cholesky::Small(l) => {
                let n = l.nrows();
                let mut rows = vec![0.0; n * n.next_multiple_of(GROUP)];
                lanes::run(InverseRoot { l: l.as_slice(), rows: &mut rows, n });
                let mut out = DMatrix::zeros(n, n);
                lanes::run(Take { y: &rows, s: out.as_mut_slice(), n });
                for j in 0..n {
                    for i in j..n {
                        let x = -out[(i, j)];
                        (out[(i, j)], out[(j, i)]) = (x, x);
                    }
                }
                out
            }
            Cholesky::Large(l) => {
                let n = l.L().nrows();
                self.solve(&DMatrix::identity(n, n))
            }
        }
    }
    /// Logarithm of the determinant of the matrix.
    pub(super) fn log_determinant(&self) -> f64 {
        let root: f64 = match self {
            Cholesky::Small(l) => l.diagonal().iter().map(|x| x.ln()).sum(),
            Cholesky::Large(l) => (0..l.L().nrows()).map(|i| l.L()[(i, i)].ln()).sum(),
        };
        2.0 * root
    }
    /// `rhs^T m^-1 rhs`.
    pub(super) fn square(&self, rhs: &DVector<f64>) -> f64 {
        match self {
            Cholesky::Small(l) => {
                let mut x = rhs.clone();
                forward(l.as_slice(), x.as_mut_slice());
                x.norm_squared()
            }
            Cholesky::Large(_) => rhs.dot(&self.solve_vector(rhs)).max(0.0),
        }
    }
    /// Solution for one right-hand side.
    pub(super) fn solve_vector(&self, rhs: &DVector<f64>) -> DVector<f64> {
        let x = self.solve(&DMatrix::from_column_slice(rhs.len(), 1, rhs.as_slice()));
        x.column(0).into_owned()
    }
}

/// Eigenvalues (ascending) and orthonormal eigenvectors (columns) of a symmetric matrix.
#[derive(Debug, Clone)]
pub struct SymmetricEigen {
    /// Ascending.
    pub values: DVector<f64>,
    /// Column i belongs to value i.
    pub vectors: DMatrix<f64>,
}

/// Eigen decomposition of a symmetric matrix (its lower triangle is read); `None` where it holds NaN.
pub fn symmetric_eigen(m: &DMatrix<f64>) -> Option<SymmetricEigen> {
    let n = m.nrows();
    if n == 0 {
        return Some(SymmetricEigen { values: DVector::zeros(0), vectors: DMatrix::zeros(0, 0) });
    }
    if m.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let e = borrowed(m).self_adjoint_eigen(Side::Lower).ok()?;
    let (u, s) = (e.U(), e.S().column_vector());
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| s[a].total_cmp(&s[b]));
    Some(SymmetricEigen {
        values: DVector::from_fn(n, |i, _| s[order[i]]),
        vectors: DMatrix::from_fn(n, n, |i, j| u[(i, order[j])]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both codes on the same matrices, on either side of the border.
    #[test]
    fn plain_loops_and_faer_agree() {
        for n in [1, 2, 7, FEW, FEW + 1] {
            let root = DMatrix::from_fn(n, n, |i, j| ((i * 7 + j * 13) as f64).sin() + if i == j { 3.0 } else { 0.0 });
            let a = &root * root.transpose();
            let rhs = DMatrix::from_fn(n, 3, |i, j| (i as f64 - 0.3 * j as f64).cos());
            let faer = Llt::new(borrowed(&a), Side::Lower).ok().map(Cholesky::Large).unwrap().solve(&rhs);
            let mut l = a.clone();
            // The upper triangle is not read.
            (0..n).for_each(|j| (0..j).for_each(|i| l[(i, j)] = f64::NAN));
            assert!(factorise(l.as_mut_slice(), n));
            let plain = Cholesky::Small(l).solve(&rhs);
            assert!((&plain - &faer).norm() < 1e-11 * faer.norm(), "{n}");
            assert!((Cholesky::of(&a).unwrap().inverse() * &a - DMatrix::<f64>::identity(n, n)).norm() < 1e-10, "{n}");
            assert!((&a * Cholesky::of(&a).unwrap().solve(&rhs) - &rhs).norm() < 1e-10);
            let mut flat = a - DMatrix::identity(n, n) * 1e6;
            assert!(!factorise(flat.as_mut_slice(), n));
            flat.fill(f64::NAN);
            assert!(!factorise(flat.as_mut_slice(), n));
        }
    }

    #[test]
    fn the_product_is_taken_from_the_lower_triangle() {
        for n in [1, 5, 67] {
            let y = DMatrix::from_fn(n, 9, |i, j| ((i * 7 + j * 13) as f64).sin());
            let mut s = DMatrix::from_element(n, n, 2.0);
            take_product(&mut s, y.as_slice());
            let wanted = DMatrix::from_element(n, n, 2.0) - &y * y.transpose();
            for j in 0..n {
                (j..n).for_each(|i| assert!((s[(i, j)] - wanted[(i, j)]).abs() < 1e-13, "{i} {j}"));
            }
        }
    }

    #[test]
    fn cholesky_and_eigen_agree_with_the_matrix() {
        let a = DMatrix::from_row_slice(3, 3, &[4.0, 1.0, 0.5, 1.0, 3.0, -0.2, 0.5, -0.2, 2.0]);
        let x = Cholesky::of(&a).unwrap().solve(&DMatrix::identity(3, 3));
        assert!((&a * x - DMatrix::<f64>::identity(3, 3)).norm() < 1e-14);
        let e = symmetric_eigen(&a).unwrap();
        assert!(e.values[0] <= e.values[1] && e.values[1] <= e.values[2]);
        let back = &e.vectors * DMatrix::from_diagonal(&e.values) * e.vectors.transpose();
        assert!((back - a).norm() < 1e-14);
        assert!(Cholesky::of(&DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0])).is_none());
        assert!(symmetric_eigen(&DMatrix::from_element(2, 2, f64::NAN)).is_none());
    }
}
