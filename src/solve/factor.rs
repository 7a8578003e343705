//! Dense factorisations; the only file that names faer.

use faer::linalg::solvers::{Llt, Solve};
use faer::{MatRef, Side};
use nalgebra::{DMatrix, DVector};

fn borrowed(m: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(m.as_slice(), m.nrows(), m.ncols())
}

/// Cholesky factor of a symmetric positive definite matrix (its lower triangle is read).
#[derive(Debug)]
pub(super) struct Cholesky(Llt<f64>);

impl Cholesky {
    /// `None` where the matrix is not positive definite.
    pub(super) fn of(m: &DMatrix<f64>) -> Option<Self> {
        Llt::new(borrowed(m), Side::Lower).ok().map(Cholesky)
    }
    /// Solution of `m x = rhs` for all columns.
    pub(super) fn solve(&self, rhs: &DMatrix<f64>) -> DMatrix<f64> {
        let x = self.0.solve(borrowed(rhs));
        DMatrix::from_fn(rhs.nrows(), rhs.ncols(), |i, j| x[(i, j)])
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
