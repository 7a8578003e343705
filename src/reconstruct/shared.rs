//! Errors that both cameras share.
//!
//! Both cameras see the same particles. Where these lie in the window, which of them leave it, and how their images overlap makes the same error
//! in both planar vectors, as far as both images show the same pattern: across the direction of depth they do, along it particles of different
//! depth are shifted apart by the thickness of the light. With errors of unit variance in every component,
//! ```text
//! V = [1, rho n_1 n_2^T; rho n_2 n_1^T, 1]        n_c across the direction of depth in camera c
//! D = C J^T (d - ...),   C = (J^T J)^-1,   C_D = C J^T V J C = C + rho K
//! chi^2 = (nu . r)^2,   nu = (nu_1, nu_2) |nu| = 1, nu^T J = 0,    n_1 = nu_1 / |nu_1|,  n_2 = -nu_2 / |nu_2|
//! E chi^2 = 1 - 2 rho |nu_1| |nu_2|               what they share is not left over: rho follows where the standard deviations are known
//! ```
//! So residuals of half the stated size say that three quarters of the variance is common; it is all in u or v, and residuals alone cannot tell.
//!
//! | symbol | identifier | shape | meaning |
//! |---|---|---|---|
//! | K | [`Shared::covariance`] | 3 x 3 | mm^2 for unit variance |
//! | 2 abs(nu_1) abs(nu_2) | [`Shared::hidden`] | | part of the variance that a correlation of 1 hides from the residual |
//! | rho | [`common`] | | correlation, of the whole field |
//!
//! Measured on `examples/vortex` (light of 1.2 mm, 80 degrees between the cameras): 0.42 across, 0.1 along the direction of depth. Not valid
//! for light so thin, or cameras so close, that depth moves particles by less than their images: then u and w share errors, too.

use nalgebra::{Matrix3, Matrix4, SMatrix, Vector2, Vector4};

/// Largest correlation: beyond it the residuals contradict the standard deviations.
const MOST: f64 = 0.95;

/// What a correlation of 1 would do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shared {
    pub(super) covariance: Matrix3<f64>,
    pub(super) hidden: f64,
}

impl Shared {
    /// From the whitened equations and the covariance of their solution.
    pub(super) fn of(jacobian: &SMatrix<f64, 4, 3>, covariance: &Matrix3<f64>) -> Self {
        let left = Matrix4::identity() - jacobian * covariance * jacobian.transpose();
        let k = (0..4).max_by(|a, b| left[(*a, *a)].total_cmp(&left[(*b, *b)])).unwrap_or(0);
        let nu: Vector4<f64> = left.column(k).normalize();
        let (a, b): (Vector2<f64>, Vector2<f64>) = (nu.fixed_rows::<2>(0).into(), -nu.fixed_rows::<2>(2));
        let (length_a, length_b) = (a.norm(), b.norm());
        if !(length_a > 0.0 && length_b > 0.0) {
            return Self { covariance: Matrix3::zeros(), hidden: 0.0 };
        }
        let gain = covariance * jacobian.transpose();
        let first = gain.fixed_columns::<2>(0) * (a / length_a);
        let second = gain.fixed_columns::<2>(2) * (b / length_b);
        Self { covariance: first * second.transpose() + second * first.transpose(), hidden: 2.0 * length_a * length_b }
    }
}

/// Correlation of the cameras' errors across the direction of depth, by the mean square of the whitened residuals.
pub(super) fn common<'a>(mean_square: f64, all: impl Iterator<Item = &'a Shared>) -> f64 {
    let (sum, n) = all.fold((0.0, 0.0), |(s, n), one| (s + one.hidden, n + 1.0));
    if sum > 0.0 && mean_square.is_finite() { ((1.0 - mean_square) * n / sum).clamp(0.0, MOST) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two cameras at +- 45 degrees in the x z plane: v is the mean of both, and what both share is in v alone.
    #[test]
    fn common_errors_are_in_v_and_not_in_the_residual() {
        let jacobian = SMatrix::<f64, 4, 3>::new(1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0);
        let covariance = jacobian.tr_mul(&jacobian).try_inverse().unwrap();
        let s = Shared::of(&jacobian, &covariance);
        assert!((s.hidden - 1.0).abs() < 1e-12);
        assert!((s.covariance - Matrix3::from_diagonal(&nalgebra::Vector3::new(0.0, 0.5, 0.0))).norm() < 1e-12);
        assert!((common(0.6, [s, s].iter()) - 0.4).abs() < 1e-12);
        assert_eq!(common(1.7, [s].iter()), 0.0);
    }
}
