//! The common tangents of a pair of discs: 14 points that survive perspective, with their covariance.
//!
//! Two separated ellipses have four common tangents: two *external* (both discs on one side of the line) and two
//! *internal* (the line passes between them). Tangent lines stay tangent under perspective, so the 8 points where
//! they touch and the 6 points where they cross are images of the same points of the plate; the centre of an
//! ellipse is not the image of the circle's centre. Source: section 3 of the paper; it speaks of fifteen points,
//! but 8 + 6 = 14.
//!
//! With the support function `h(n) = c . n + s(n)`, `s(n) = sqrt(n' M n)` of an ellipse with centre `c` and
//! `M = R diag(a^2, b^2) R'`, the line with unit normal n that has disc 0 on its negative side,
//! `n . x = h_0(n)`, also touches disc 1 where
//!
//! ```text
//! external   g(n) = (c1 - c0) . n + s1(n) - s0(n) = 0
//! internal   g(n) = (c1 - c0) . n - s1(n) - s0(n) = 0
//! touches at x_i = c_i + q_i M_i n / s_i,   q_0 = 1,  q_1 = +1 external, -1 internal
//! dn/dp      from  dt = -dg/dp / dg/dt,     dg/dt = (x_1 - x_0) . dn/dt,   n = (cos t, sin t)
//! ```
//!
//! Every normal that separates the discs (`g_internal > 0`) brackets all four roots: one of each kind within half a
//! turn to either side. No quartic is solved, so equal radii, very different radii and narrow gaps keep their digits.
//!
//! | symbol | identifier | shape | unit | frame | source |
//! |---|---|---|---|---|---|
//! | p | ellipse parameters `(u0, v0, a, b, phi)`, disc 0 first | 10 | px, rad | `Sensor` | [`crate::conic`] |
//! | n, h | [`Line`] | 2, 1 | 1, px | `Sensor` | above |
//! | x | [`Bitangents::points`] | 28 | px | `Sensor` | paper section 3 |
//! | J = dx/dp | [`Bitangents::jacobian`] | 28x10 | px per unit of p | `Sensor` | above |
//! | C = J C_p J' | [`Bitangents::covariance`] | 28x28, rank 10 | px^2 | `Sensor` | method section 3 |
//! | W, W C W' = I | [`Whitening::matrix`] | 10x28 | 1/px | `Sensor` | method section 3 |
//! | X | [`CirclePair::points_mm`] | 28 | mm | `Target` | closed form, [`circle_features`] |
//!
//! **Order**, the same in the image and on the plate whatever their rotation (decision record `tangent-order`). *Left* and
//! *right* are those of a viewer who looks along disc 0 -> disc 1 in the image (v down), or along it on the plate
//! seen from its front (y up). Lines: 0 external left, 1 external right, 2 internal left (touches disc 0 on the left,
//! disc 1 on the right), 3 internal right. Points: line `k` touches disc `i` at `2 k + i` (0 to 7); then the
//! crossings [`CROSSINGS`]: 8 = external with external, 9 = internal with internal, 10 = (0, 2), 11 = (0, 3), 12 = (1, 2),
//! 13 = (1, 3). [`SWAPPED`] is the order when the discs change places, [`FROM_BEHIND`] when a camera sees the plate from behind.
//!
//! **Where it is not valid.** Discs that touch, overlap or contain one another have fewer tangents: a typed
//! refusal. The external tangents are parallel where the discs look equally large: that crossing is then at infinity
//! ([`ExternalCrossing::AtInfinity`]) and its rows are zero. The covariance is a first-order one: the external
//! crossing leaves it when its angle is not well above its own sigma, see [`ExternalUse`]. Leaving the external
//! crossing out loses nothing: the other 26 numbers carry all ten degrees of freedom.

mod circles;
mod jacobian;
mod tangents;
mod whiten;

pub use circles::{CirclePair, circle_features};
pub use tangents::bitangents;
pub use whiten::{EXTERNAL_ANGLE_IN_SIGMAS, ExternalUse, Whitening};

use nalgebra::{SMatrix, SVector, Vector2};

/// Number of feature points of a pair of discs.
pub const POINTS: usize = 14;
/// Index of the crossing of the two external tangents.
pub const EXTERNAL_CROSSING: usize = 8;
/// Index of the crossing of the two internal tangents.
pub const INTERNAL_CROSSING: usize = 9;
/// Lines that meet in points 8 to 13.
pub const CROSSINGS: [[usize; 2]; 6] = [[0, 1], [2, 3], [0, 2], [0, 3], [1, 2], [1, 3]];
/// `points of (disc 1, disc 0)[i] = points of (disc 0, disc 1)[SWAPPED[i]]`.
///
/// Turned round, external left and right change places, internal left stays internal left.
pub const SWAPPED: [usize; POINTS] = [3, 2, 1, 0, 5, 4, 7, 6, 8, 9, 12, 13, 10, 11];
/// `points in an image from behind the plate[i] = image of points on the plate[FROM_BEHIND[i]]`: left and right change places.
pub const FROM_BEHIND: [usize; POINTS] = [2, 3, 0, 1, 6, 7, 4, 5, 8, 9, 13, 12, 11, 10];
/// Names of the points, for reports and overlays; `EL` = external left, `IR` = internal right, then the disc touched
/// or the line crossed.
pub const NAMES: [&str; POINTS] =
    ["EL0", "EL1", "ER0", "ER1", "IL0", "IL1", "IR0", "IR1", "ELxER", "ILxIR", "ELxIL", "ELxIR", "ERxIL", "ERxIR"];

/// The line `normal . x = distance`; disc 0 lies where `normal . x < distance`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Unit normal, pointing away from disc 0.
    pub normal: Vector2<f64>,
    /// Distance of the line from pixel (0, 0) along the normal, px.
    pub distance_px: f64,
}

/// Where the two external tangents meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExternalCrossing {
    /// At point 8.
    At(Vector2<f64>),
    /// Nowhere: they are parallel to rounding. The unit direction they share, from disc 0 to disc 1.
    AtInfinity(Vector2<f64>),
}

/// The four common tangents of two separated ellipses and their 14 points. See the module for the order.
#[derive(Debug, Clone, PartialEq)]
pub struct Bitangents {
    /// External left, external right, internal left, internal right.
    pub lines: [Line; 4],
    /// `(u, v)` of the 14 points one after the other, px; zero for an external crossing at infinity.
    pub points: SVector<f64, 28>,
    /// Where the external tangents meet.
    pub external: ExternalCrossing,
    /// Derivative of `points` by the parameters of disc 0, then disc 1 (five each); zero rows at infinity.
    pub jacobian: SMatrix<f64, 28, 10>,
    /// Derivative of the sine of the angle between the external tangents by the same parameters, 1 per unit of p.
    external_sine: f64,
    external_sine_jacobian: SMatrix<f64, 1, 10>,
}

impl Bitangents {
    /// Point `index` (0 to 13), px; `None` for an external crossing at infinity or an index out of range.
    pub fn point(&self, index: usize) -> Option<Vector2<f64>> {
        let at_infinity = index == EXTERNAL_CROSSING && matches!(self.external, ExternalCrossing::AtInfinity(_));
        (index < POINTS && !at_infinity).then(|| self.points.fixed_rows::<2>(2 * index).into_owned())
    }
}

#[cfg(test)]
mod tests;
