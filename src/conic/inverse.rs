//! Inverses of small symmetric positive definite matrices, thousands of them for an image, and of their factors: plain loops of a known length. `M = L L^T`
//! by Cholesky, `M^-1 = L^-T L^-1`, `L^-1` column by column by forward substitution (Golub and Van Loan, "Matrix computations", sections 3.1 and 4.2).

use nalgebra::SMatrix;

/// Of a lower triangular matrix, of which what lies above the diagonal is not looked at; none where its diagonal is not positive.
pub(crate) fn inverse_of_lower<const N: usize>(lower: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    let (l, mut out) = (lower.data.0, [[0.0; N]; N]);
    for j in 0..N {
        if !(l[j][j] > 0.0) {
            return None;
        }
        out[j][j] = 1.0 / l[j][j];
    }
    // Columns of either: below the diagonal by forward substitution.
    for j in 0..N {
        for i in j + 1..N {
            let mut sum = 0.0;
            for k in j..i {
                sum += l[k][i] * out[j][k];
            }
            out[j][i] = -sum * out[i][i];
        }
    }
    Some(SMatrix::from(out))
}

/// Of a symmetric positive definite matrix, of which the lower triangle is looked at; none where it is not.
pub(crate) fn inverse_of_positive<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    let mut l = matrix.data.0;
    for j in 0..N {
        for k in 0..j {
            for i in j..N {
                l[j][i] -= l[k][i] * l[k][j];
            }
        }
        if !(l[j][j] > 0.0) {
            return None;
        }
        let root = l[j][j].sqrt();
        for i in j..N {
            l[j][i] /= root;
        }
    }
    let root = inverse_of_lower(&SMatrix::from(l))?;
    Some(root.tr_mul(&root))
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;

    /// Times the matrix it is one; a matrix that is not positive definite, or not finite, has none.
    #[test]
    fn they_are_inverses() {
        for size in [1e-6, 1.0, 1e8] {
            let a =
                SMatrix::<f64, 5, 5>::from_fn(|i, j| size * ((i * i * (j + 2) + 3 * i * j * j + j) as f64 * 1.7).sin());
            let positive = a * a.transpose();
            let inverse = inverse_of_positive(&positive).expect("an inverse");
            let plain = positive.try_inverse().expect("an inverse");
            assert!((inverse - plain).amax() < 1e-9 * plain.amax(), "{inverse} {plain}");
            let lower = positive.cholesky().expect("a factor").l();
            let root = inverse_of_lower(&lower).expect("an inverse");
            assert!((root * lower - SMatrix::identity()).amax() < 1e-9);
            assert!(inverse_of_positive(&(positive - SMatrix::identity() * positive.trace())).is_none());
            assert!(inverse_of_positive(&(positive * f64::NAN)).is_none());
        }
    }
}
