//! Columns of the model at single pixels: what the light on either side contributes to a grey value.
//!
//! A light `F` (as the image shows it, blur included) that reaches up to the edge of a disc with the blurred profile `P` appears as
//!
//! ```text
//! F P + s^2 grad F . grad P + s^4/2 grad grad F : grad grad P + ...
//! ```
//!
//! (the exact product rule of the heat equation). Polynomials of the second degree end there; waves: `exact/waves.rs`.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | X, Y | `place` | 1 | place of the pixel in units of the semi-axes |
//! | n | `normal` | 1 | outward normal at the foot point, in the frame of the axes |
//! | z | `depth` | 1 | distance in units of the blur |

use crate::detect::light::Side;

/// One pixel as the columns need it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct At {
    pub(crate) place: [f64; 2],
    /// Normal and tangent, divided by the semi-axes, 1/px.
    pub(crate) normal: [f64; 2],
    pub(crate) tangent: [f64; 2],
    pub(crate) blur_px: f64,
    pub(crate) curvature: f64,
    pub(crate) inside: f64,
    /// Gradient of P in the frame of the axes, times the semi-axes.
    pub(crate) gradient: [f64; 2],
    /// Second derivatives XX, XY, YY of P, each times the semi-axes.
    pub(crate) bend: [f64; 3],
    /// dP/dd, 1/px.
    pub(crate) slope: f64,
    pub(crate) depth: f64,
    pub(crate) density: f64,
    /// Distance from the edge, px.
    pub(crate) distance: f64,
    /// Blur over the width of the profile.
    pub(crate) narrow: f64,
}

/// The polynomials of a [`Side`] on the contour, at an eccentric angle.
#[inline]
pub(crate) fn on_contour(c: f64, s: f64) -> [f64; Side::MOST] {
    [1.0, 0.0, c, s, c * c - s * s, 2.0 * c * s]
}

impl At {
    /// The polynomials of a [`Side`] times the profile.
    #[inline]
    pub(crate) fn polynomials(&self) -> [f64; Side::MOST] {
        let ([x, y], [gx, gy]) = (self.place, self.gradient);
        let s2 = self.blur_px * self.blur_px;
        let (first, second) = (s2, s2 * s2);
        let [xx, xy, yy] = self.bend;
        let p = self.inside;
        [
            p,
            (x * x + y * y - 1.0) * p + 2.0 * (x * gx + y * gy) * first + (xx + yy) * second,
            x * p + gx * first,
            y * p + gy * first,
            (x * x - y * y) * p + 2.0 * (x * gx - y * gy) * first + (xx - yy) * second,
            2.0 * x * y * p + 2.0 * (y * gx + x * gy) * first + 2.0 * xy * second,
        ]
    }

    /// The polynomials themselves.
    #[inline]
    pub(crate) fn bare(&self) -> [f64; Side::MOST] {
        let [x, y] = self.place;
        [1.0, x * x + y * y - 1.0, x, y, x * x - y * y, 2.0 * x * y]
    }
}
