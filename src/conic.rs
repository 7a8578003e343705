//! Circles and ellipses in the image.
//!
//! The contour of a flat disc is an ellipse in the image: a circle seen through a homography is a conic.
//!
//! Implicit form, `p = (u, v, 1)`: `p^T C p = 0` with `C` symmetric 3 x 3, scaled here so that
//! `p^T C p = (x/a)^2 + (y/b)^2 - 1`: -1 at the centre, 0 on the ellipse, positive outside.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | (u0, v0) | `center_px` | 2 | px | centre |
//! | a >= b > 0 | `semi_major_px`, `semi_minor_px` | 1 | px | semi-axes |
//! | phi | `angle_rad` | 1 | rad | from the u axis to the major axis, turning towards +v, in (-pi/2, pi/2] |
//! | p | [`Ellipse::parameters`] | 5 | px, px, px, px, rad | `(u0, v0, a, b, phi)`, the order of every covariance |
//! | e | (inside the fits) | 2 | px | `(a - b)/2 (cos 2 phi, sin 2 phi)`, which stays defined for a circle |
//! | d | [`Ellipse::distance_px`] | 1 | px | orthogonal distance, positive outside |
//!
//! Not valid: hyperbolas and parabolas (a disc cut by the plane through the camera centre) are refused by type; lens
//! distortion bends the contour off the ellipse (the fits then describe the distorted contour as well as they can);
//! the angle of a circle has no meaning, its standard deviation is reported as at most that of a uniform angle.

mod circle;
mod common;
mod cut;
mod feet;
mod fit;
mod foot;
mod geometry;
mod inverse;

pub use circle::image_of_circle;
pub use common::{CommonNoise, ContourNoise};
pub(crate) use cut::Cut;
pub(crate) use feet::Feet;
pub(crate) use fit::fit_geometric_from;
pub use fit::{EllipseFit, fit_direct, fit_geometric};
pub(crate) use foot::{Frame, OnContour};
pub(crate) use geometry::{covariance_from_regular, from_regular, parameters_by_regular, to_regular};
pub(crate) use inverse::{inverse_of_lower, inverse_of_positive};

use crate::frames::Pixel;
use nalgebra::SVector;

/// An ellipse in the image. See the module table for conventions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// Centre (not the image of the circle's centre), px.
    pub center_px: Pixel,
    /// Major semi-axis, px.
    pub semi_major_px: f64,
    /// Minor semi-axis, px.
    pub semi_minor_px: f64,
    /// Direction of the major axis, rad, from +u towards +v, in (-pi/2, pi/2].
    pub angle_rad: f64,
}

impl Ellipse {
    /// The parameter vector `(u0, v0, a, b, phi)` in px, px, px, px, rad.
    pub fn parameters(&self) -> SVector<f64, 5> {
        SVector::from([
            self.center_px.u_px,
            self.center_px.v_px,
            self.semi_major_px,
            self.semi_minor_px,
            self.angle_rad,
        ])
    }
    /// The point at eccentric angle `t_rad`.
    pub fn point(&self, t_rad: f64) -> Pixel {
        let (s, c) = self.angle_rad.sin_cos();
        let (x, y) = (self.semi_major_px * t_rad.cos(), self.semi_minor_px * t_rad.sin());
        Pixel::new(self.center_px.u_px + c * x - s * y, self.center_px.v_px + s * x + c * y)
    }
}
