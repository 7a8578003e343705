//! Covariance of the 14 points (rank 10) and the matrix that turns them into ten independent unit-variance numbers.

use super::{Bitangents, EXTERNAL_CROSSING, ExternalCrossing};
use crate::error::{Error, Insufficient, Result};
use nalgebra::{DMatrix, SMatrix, SVector};

/// The external crossing is used only where the angle between the external tangents exceeds this many of its sigmas.
///
/// The position goes with 1 / angle: at 20 sigmas the neglected second-order term is 1/20 of the position's sigma.
pub const EXTERNAL_ANGLE_IN_SIGMAS: f64 = 20.0;

/// Singular values below this fraction of the largest one are rounding, not information.
const RANK_TOLERANCE: f64 = 1e-9;

/// Covariance of the ten ellipse parameters: two 5x5 blocks, disc 0 first.
type Covariances<'a> = [&'a SMatrix<f64, 5, 5>; 2];

/// Whether the crossing of the external tangents takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ExternalUse {
    /// Where its angle exceeds [`EXTERNAL_ANGLE_IN_SIGMAS`].
    #[default]
    WhereMeasurable,
    /// Never: the other 13 points carry the same information.
    Never,
}

/// Turns feature residuals (28, px) into independent residuals of unit variance.
#[derive(Debug, Clone, PartialEq)]
pub struct Whitening {
    /// `W C W' = I` on the first `rank` rows; rows beyond are zero, columns 16 and 17 too where `external` is false.
    pub matrix: SMatrix<f64, 10, 28>,
    /// Number of rows that carry information: 10, fewer where an ellipse is a circle to rounding (its angle says nothing).
    pub rank: usize,
    /// Whether the external crossing takes part.
    pub external: bool,
    /// Singular values of the points' standard deviations, largest first, px; zero beyond `rank`.
    pub sigmas_px: SVector<f64, 10>,
}

impl Bitangents {
    /// Covariance of the 14 points, px^2, rank 10, from the covariances of the two ellipses.
    ///
    /// Rows and columns of an external crossing at infinity are zero.
    pub fn covariance(&self, covariances: Covariances<'_>) -> SMatrix<f64, 28, 28> {
        let mut c = SMatrix::<f64, 28, 28>::zeros();
        for i in 0..2 {
            let j = self.jacobian.fixed_columns::<5>(5 * i);
            c += j * covariances[i] * j.transpose();
        }
        c
    }

    /// Whether the angle between the external tangents is well above its sigma.
    fn external_is_measurable(&self, covariances: Covariances<'_>) -> bool {
        let j = &self.external_sine_jacobian;
        let variance: f64 = (0..2)
            .map(|i| {
                let ji = j.fixed_columns::<5>(5 * i);
                (ji * covariances[i] * ji.transpose())[(0, 0)]
            })
            .sum();
        matches!(self.external, ExternalCrossing::At(_))
            && self.external_sine.abs() > EXTERNAL_ANGLE_IN_SIGMAS * variance.sqrt()
    }

    /// The whitening matrix of the 14 points.
    ///
    /// Taken from the singular values of `J S`, `S S' = C_p` (the square roots of the eigenvalues of the covariance, but
    /// without squaring the condition number).
    ///
    /// # Errors
    /// [`Insufficient::Degenerate`] where a covariance is not positive semi-definite or not finite.
    pub fn whitening(&self, covariances: Covariances<'_>, external: ExternalUse) -> Result<Whitening> {
        let external = external == ExternalUse::WhereMeasurable && self.external_is_measurable(covariances);
        let mut spread = self.jacobian;
        for (i, c) in covariances.into_iter().enumerate() {
            let j = self.jacobian.fixed_columns::<5>(5 * i) * square_root(c, i)?;
            spread.fixed_columns_mut::<5>(5 * i).copy_from(&j);
        }
        if !external {
            spread.fixed_rows_mut::<2>(2 * EXTERNAL_CROSSING).fill(0.0);
        }
        let svd = DMatrix::from_column_slice(28, 10, spread.as_slice()).svd(true, false);
        let Some(u) = svd.u else {
            return Err(Error::Bug("singular vectors of the bitangent features are missing".into()));
        };
        let mut out = Whitening { matrix: SMatrix::zeros(), rank: 0, external, sigmas_px: SVector::zeros() };
        for (k, sigma) in svd.singular_values.iter().enumerate() {
            if *sigma > RANK_TOLERANCE * svd.singular_values[0] {
                out.matrix.row_mut(k).copy_from_slice((u.column(k) / *sigma).as_slice());
                out.sigmas_px[k] = *sigma;
                out.rank += 1;
            }
        }
        Ok(out)
    }
}

/// `S` with `S S' = C`; tolerates a semi-definite C.
fn square_root(c: &SMatrix<f64, 5, 5>, disc: usize) -> Result<SMatrix<f64, 5, 5>> {
    let refused = || {
        Insufficient::Degenerate(format!(
            "the covariance of disc {disc} is not a covariance; its contour does not determine an ellipse"
        ))
    };
    if !c.iter().all(|x| x.is_finite()) {
        return Err(refused().into());
    }
    // Positions, axes and the angle have different units: scale to correlations before looking at eigenvalues.
    let scale = c.diagonal().map(|x| x.max(0.0).sqrt());
    let unit = scale.map(|s| if s > 0.0 { 1.0 / s } else { 0.0 });
    let correlation = SMatrix::<f64, 5, 5>::from_fn(|i, j| 0.5 * (c[(i, j)] + c[(j, i)]) * unit[i] * unit[j]);
    let eigen = correlation.symmetric_eigen();
    if c.diagonal().iter().any(|x| *x < 0.0) || eigen.eigenvalues.iter().any(|x| *x < -1e-9) {
        return Err(refused().into());
    }
    let root = eigen.eigenvectors * SMatrix::from_diagonal(&eigen.eigenvalues.map(|x| x.max(0.0).sqrt()));
    Ok(SMatrix::from_diagonal(&scale) * root)
}
