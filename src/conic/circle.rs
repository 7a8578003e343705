//! The image of a circle under a homography.
//!
//! A circle `x^T D x = 0` of a plane, seen through `image = H plane`, is the conic `C = H^-T D H^-1`. Its centre is not the image of the
//! circle's centre. Not valid where the circle reaches the plane through the projection centre (the conic is no ellipse).

use crate::conic::Ellipse;
use crate::error::{Insufficient, Invalid, Result};
use nalgebra::{Matrix3, Vector3};

/// The ellipse seen of a circle with centre `center_mm` and radius `radius_mm` in a plane, through the 3 x 3 homography
/// `image_from_plane` (plane mm to px, any scale).
///
/// # Errors
/// [`Invalid::Value`] for a radius that is not positive; [`Insufficient::Degenerate`] where the homography is singular
/// or the circle is cut by the plane through the projection centre.
///
/// ```
/// use nalgebra::Matrix3;
/// let scale = Matrix3::new(10.0, 0.0, 100.0, 0.0, 5.0, 50.0, 0.0, 0.0, 1.0);
/// let seen = spivcal::conic::image_of_circle(&scale, [1.0, 2.0], 3.0)?;
/// assert!((seen.semi_major_px - 30.0).abs() < 1e-9 && (seen.center_px.v_px - 60.0).abs() < 1e-9);
/// # Ok::<(), spivcal::Error>(())
/// ```
pub fn image_of_circle(image_from_plane: &Matrix3<f64>, center_mm: [f64; 2], radius_mm: f64) -> Result<Ellipse> {
    if !(radius_mm > 0.0 && radius_mm.is_finite()) {
        return Err(Invalid::value("circle radius (mm)", radius_mm, "a positive length").into());
    }
    // Unit circle first: the conic is then well scaled whatever the units of the plane.
    let unit = Matrix3::new(radius_mm, 0.0, center_mm[0], 0.0, radius_mm, center_mm[1], 0.0, 0.0, 1.0);
    let h = image_from_plane * unit;
    let degenerate = |why: &str| Insufficient::Degenerate(format!("image of a circle: {why}"));
    let w = Vector3::new(h[(2, 0)], h[(2, 1)], h[(2, 2)]);
    if w[2].abs() <= w[0].hypot(w[1]) {
        return Err(degenerate("the circle reaches behind the camera").into());
    }
    let inverse = h.try_inverse().ok_or_else(|| degenerate("the plane is seen edge-on"))?;
    let d = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    let conic = inverse.transpose() * d * inverse;
    // A shift of the origin to near the ellipse keeps digits.
    let (u, v) = (h[(0, 2)] / h[(2, 2)], h[(1, 2)] / h[(2, 2)]);
    let shift = Matrix3::new(1.0, 0.0, u, 0.0, 1.0, v, 0.0, 0.0, 1.0);
    let mut ellipse = Ellipse::from_matrix(&(shift.transpose() * conic * shift))?;
    ellipse.center_px.u_px += u;
    ellipse.center_px.v_px += v;
    Ok(ellipse)
}
