//! Circles and ellipses in the image.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | (u0, v0) | `center_px` | 2 | px | centre |
//! | a >= b > 0 | `semi_major_px`, `semi_minor_px` | 1 | px | semi-axes |
//! | phi | `angle_rad` | 1 | rad | from the u axis to the major axis, turning towards +v, in (-pi/2, pi/2] |
//! | p | [`Ellipse::parameters`] | 5 | px, px, px, px, rad | `(u0, v0, a, b, phi)`, the order of every covariance |

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
