//! The four tangent lines: a bracketed Newton iteration on the angle of the normal.

use super::jacobian::{Shape, assemble};
use super::{Bitangents, Line};
use crate::conic::Ellipse;
use crate::error::{Insufficient, Invalid, Result};
use nalgebra::{Cholesky, Matrix2, Vector2};

/// Smallest gap between the discs relative to their size: below it the internal tangents coincide to rounding.
const SMALLEST_RELATIVE_GAP: f64 = 1e-10;

/// Which side of the line disc 1 is on: `q_1` of the module's formula.
const EXTERNAL: f64 = 1.0;
const INTERNAL: f64 = -1.0;

/// The common tangents of two separated ellipses, their 14 points, and the derivative of these by the ellipses.
///
/// # Errors
/// [`Invalid::Value`] where an ellipse is not finite or has no area; [`Insufficient::NotSeparated`] where the discs
/// touch, overlap or contain one another.
///
/// ```
/// use spivcal::{bitangent::bitangents, conic::Ellipse, frames::Pixel};
/// let disc = |u, r| Ellipse { center_px: Pixel::new(u, 0.0), semi_major_px: r, semi_minor_px: r, angle_rad: 0.0 };
/// let pair = bitangents(&disc(0.0, 2.0), &disc(10.0, 1.0))?;
/// // The external tangents of two circles meet where the radii would vanish: at 0 + 10 * 2 / (2 - 1).
/// assert!((pair.point(8).unwrap().x - 20.0).abs() < 1e-12);
/// assert!(bitangents(&disc(0.0, 2.0), &disc(2.5, 1.0)).is_err());
/// # Ok::<(), spivcal::Error>(())
/// ```
pub fn bitangents(disc_0: &Ellipse, disc_1: &Ellipse) -> Result<Bitangents> {
    let shapes = [Shape::new(disc_0)?, Shape::new(disc_1)?];
    let normals = tangent_normals(&shapes)?;
    let lines = normals.map(|normal| {
        let distance_px = shapes[0].center.dot(&normal) + shapes[0].support(&normal);
        Line { normal, distance_px }
    });
    Ok(assemble(&shapes, &lines))
}

/// The pair after the affine map that makes the sum of the two shape matrices the unit matrix.
///
/// There the root functions are smooth at the scale of a radian however oblique or unequal the ellipses are.
struct Rounded {
    offset: Vector2<f64>,
    shape: [Matrix2<f64>; 2],
}

impl Rounded {
    fn half_width(&self, i: usize, n: &Vector2<f64>) -> f64 {
        n.dot(&(self.shape[i] * n)).max(0.0).sqrt()
    }
    /// `g` and `dg/dt` at the normal angle `t`.
    fn g(&self, t: f64, side: f64) -> (f64, f64) {
        let (s, c) = t.sin_cos();
        let (n, dn) = (Vector2::new(c, s), Vector2::new(-s, c));
        let h = [self.half_width(0, &n), self.half_width(1, &n)];
        let slope = |i: usize| if h[i] > 0.0 { n.dot(&(self.shape[i] * dn)) / h[i] } else { 0.0 };
        (self.offset.dot(&n) + side * h[1] - h[0], self.offset.dot(&dn) + side * slope(1) - slope(0))
    }
    /// Angle of a normal that separates the discs, or the best there is.
    fn separating_angle(&self) -> f64 {
        let middle = self.offset.y.atan2(self.offset.x);
        // s0 + s1 <= sqrt(2) here, so discs further apart than that are separated by their centre line.
        if self.offset.norm() > std::f64::consts::SQRT_2 {
            return middle;
        }
        const SAMPLES: usize = 256;
        let step = std::f64::consts::PI / SAMPLES as f64;
        let angle = |k: usize| middle + (k as f64 - 0.5 * SAMPLES as f64) * step;
        let value: Vec<f64> = (0..=SAMPLES).map(|k| self.g(angle(k), INTERNAL).0).collect();
        let mut best = (f64::NEG_INFINITY, middle);
        for k in 1..SAMPLES {
            if value[k] >= value[k - 1] && value[k] >= value[k + 1] {
                let t = self.refined_maximum(angle(k - 1), angle(k + 1));
                let g = self.g(t, INTERNAL).0;
                if g > best.0 {
                    best = (g, t);
                }
            }
        }
        best.1
    }
    /// Golden-section search: the maximum may be a cusp (two needles across each other), where Newton fails.
    fn refined_maximum(&self, mut low: f64, mut high: f64) -> f64 {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        for _ in 0..60 {
            let (a, b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
            if self.g(a, INTERNAL).0 >= self.g(b, INTERNAL).0 {
                high = b;
            } else {
                low = a;
            }
        }
        0.5 * (low + high)
    }
    /// The root between `inside` (g > 0) and `outside` (g < 0).
    fn root(&self, mut inside: f64, mut outside: f64, side: f64) -> f64 {
        let mut t = 0.5 * (inside + outside);
        for _ in 0..200 {
            let (g, slope) = self.g(t, side);
            if g > 0.0 {
                inside = t;
            } else {
                outside = t;
            }
            let newton = t - g / slope;
            let (low, high) = (inside.min(outside), inside.max(outside));
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            let moved = (next - t).abs();
            t = next;
            if moved <= 2.0 * f64::EPSILON || high - low <= 2.0 * f64::EPSILON {
                break;
            }
        }
        t
    }
}

/// Unit normals of the tangents, away from disc 0, in the module's order.
fn tangent_normals(shapes: &[Shape; 2]) -> Result<[Vector2<f64>; 4]> {
    let sum = shapes[0].matrix + shapes[1].matrix;
    let Some(chol) = Cholesky::new(sum) else {
        return Err(Invalid::value("ellipse shape", sum.determinant(), "two ellipses with an area").into());
    };
    let l = chol.l();
    let Some(l_inv) = l.try_inverse() else {
        return Err(Invalid::value("ellipse shape", sum.determinant(), "two ellipses with an area").into());
    };
    let shape = [0, 1].map(|i: usize| l_inv * shapes[i].matrix * l_inv.transpose());
    let rounded = Rounded { offset: l_inv * (shapes[1].center - shapes[0].center), shape };
    let between = rounded.separating_angle();
    // Normals are covectors: they go back by the transposed inverse, which keeps left and right (det L > 0).
    let back = |t: f64| (l_inv.transpose() * Vector2::new(t.cos(), t.sin())).normalize();
    if rounded.g(between, INTERNAL).0 <= SMALLEST_RELATIVE_GAP {
        let n = back(between);
        let gap = (shapes[1].center - shapes[0].center).dot(&n) - shapes[0].support(&n) - shapes[1].support(&n);
        return Err(Insufficient::NotSeparated { gap }.into());
    }
    let half_turn = std::f64::consts::PI;
    // v runs down: the viewer's left is where the angle, counted from +u to +v, decreases.
    Ok([
        rounded.root(between, between - half_turn, EXTERNAL),
        rounded.root(between, between + half_turn, EXTERNAL),
        rounded.root(between, between - half_turn, INTERNAL),
        rounded.root(between, between + half_turn, INTERNAL),
    ]
    .map(back))
}
