//! The blurred disc exactly, as integrals along its contour: for discs that are not large against their blur.
//!
//! With `G` the Gaussian of standard deviation `s`, `x(t) = (a cos t, b sin t)` and `n dl = (b cos t, a sin t) dt`, the share of the
//! disc in the blurred pixel `p` and its derivatives are
//!
//! ```text
//! g          = 1/(2 pi) closed integral of (x - p) . n (1 - exp(-rho^2 / 2 s^2)) / rho^2 dl,   rho = |x - p|
//! dg/dq      = closed integral of (dx/dq . n) G dl            for every parameter q of the contour
//! dg/ds      = -1/s closed integral of (x - p) . n G dl       (heat equation)
//! grad g     = - closed integral of n G dl,   grad grad g = closed integral of n (p - x)^T G dl / s^2
//! ```
//!
//! (the first by the divergence theorem: the field `(x - p)(1 - exp)/(2 pi rho^2)` has the divergence `G`). The integrands are smooth and
//! periodic: sums over nodes less than a blur apart are exact to rounding.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | t | `Node::cos`, `Node::sin` | 1 | eccentric angle |
//! | n dl | `Node::normal` | px | outward normal times the length of contour of the node |
//! | - | `Seen` | | what one pixel sees of the disc |

use crate::conic::Frame;

/// Distance of two nodes over the blur.
const SPACING: f64 = 0.8;

/// One place of the contour.
#[derive(Debug, Clone, Copy)]
struct Node {
    at: [f64; 2],
    normal: [f64; 2],
    /// `-dx/dq . n dl` over the regular coordinates: rows of distances times the length of contour, px.
    row: [f64; 5],
    cos: f64,
    sin: f64,
}

/// The contour of one disc as nodes.
#[derive(Debug, Default)]
pub(crate) struct Rim {
    nodes: Vec<Node>,
    /// Difference of the light at each node, inside minus outside.
    pub(crate) step: Vec<f64>,
    blur_px: f64,
}

/// What a pixel sees.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Seen {
    pub(crate) inside: f64,
    /// Gradient, 1/px, and second derivatives xx, xy, yy, 1/px^2, in the frame of the axes.
    pub(crate) gradient: [f64; 2],
    pub(crate) bend: [f64; 3],
    /// Derivatives of the grey value, the light's difference at each node included.
    pub(crate) by_geometry: [f64; 5],
    pub(crate) by_blur: f64,
}

impl Rim {
    /// Sets the nodes anew.
    pub(crate) fn set(&mut self, frame: &Frame, blur_px: f64) {
        self.blur_px = blur_px;
        self.nodes.clear();
        let (a, b) = (frame.a, frame.b);
        // The nodes are equal steps of the eccentric angle; the widest lie a step times `a` apart.
        let count = (std::f64::consts::TAU * a / (SPACING * blur_px)).ceil().max(16.0);
        let turn = std::f64::consts::TAU / count;
        for i in 0..count as usize {
            let (sin, cos) = (i as f64 * turn).sin_cos();
            let row = frame.on_contour(cos, sin).row;
            let length = (b * cos).hypot(a * sin) * turn;
            self.nodes.push(Node {
                at: [a * cos, b * sin],
                normal: [b * cos * turn, a * sin * turn],
                row: row.map(|r| r * length),
                cos,
                sin,
            });
        }
    }

    /// Cosine and sine of the eccentric angle of every node.
    pub(crate) fn angles(&self) -> impl Iterator<Item = (f64, f64)> {
        self.nodes.iter().map(|n| (n.cos, n.sin))
    }

    /// The disc as seen by the pixel at `(x, y)` in the frame of the axes.
    pub(crate) fn seen(&self, x: f64, y: f64) -> Seen {
        let s2 = self.blur_px * self.blur_px;
        let norm = 1.0 / (std::f64::consts::TAU * s2);
        let mut out = Seen::default();
        for (node, step) in self.nodes.iter().zip(&self.step) {
            let (dx, dy) = (node.at[0] - x, node.at[1] - y);
            let half = (dx * dx + dy * dy) / (2.0 * s2);
            let across = dx * node.normal[0] + dy * node.normal[1];
            let gauss = (-half).exp();
            // (1 - exp(-h)) / h, smooth where the pixel lies on a node.
            let fill = if half < 1e-4 { 1.0 - 0.5 * half } else { (1.0 - gauss) / half };
            out.inside += 0.5 * norm * across * fill;
            let g = norm * gauss;
            let [nx, ny] = node.normal;
            out.gradient[0] -= nx * g;
            out.gradient[1] -= ny * g;
            out.bend[0] -= nx * dx * g / s2;
            out.bend[1] -= 0.5 * (nx * dy + ny * dx) * g / s2;
            out.bend[2] -= ny * dy * g / s2;
            out.by_blur -= step * across * g / self.blur_px;
            for (sum, row) in out.by_geometry.iter_mut().zip(&node.row) {
                *sum -= step * row * g;
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conic::{Ellipse, from_regular, to_regular};
    use crate::detect::profile::Profile;
    use crate::frames::Pixel;

    fn ellipse(a: f64, b: f64) -> Ellipse {
        Ellipse { center_px: Pixel::new(0.0, 0.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.0 }
    }

    fn rim(e: &Ellipse, blur_px: f64) -> Rim {
        let mut rim = Rim::default();
        rim.set(&Frame::new(e), blur_px);
        rim.step = rim.angles().map(|_| 1.0).collect();
        rim
    }

    /// The disc cut into thin strips, each blurred as an interval.
    fn by_strips(a: f64, b: f64, s: f64, x: f64, y: f64) -> f64 {
        let n = 4000;
        // Strips of equal steps of the angle: the ends of the disc need no finer ones.
        let h = std::f64::consts::PI / f64::from(n);
        (0..n)
            .map(|i| {
                let (sin, cos) = (-std::f64::consts::FRAC_PI_2 + (f64::from(i) + 0.5) * h).sin_cos();
                let (at, half) = (b * sin, a * cos);
                let gauss = (-0.5 * ((y - at) / s).powi(2)).exp() / (s * std::f64::consts::TAU.sqrt());
                (tail((x - half) / s) - tail((x + half) / s)) * gauss * b * cos * h
            })
            .sum()
    }

    /// `Prob(N > z)` by Simpson's rule.
    fn tail(z: f64) -> f64 {
        if z < 0.0 {
            return 1.0 - tail(-z);
        }
        let n = 400;
        let h = 9.0 / f64::from(n);
        let f = |i: i32| (-0.5 * (z + h * f64::from(i)).powi(2)).exp() / std::f64::consts::TAU.sqrt();
        (0..=n).map(|i| f(i) * if i == 0 || i == n { 1.0 } else { f64::from(2 + 2 * (i % 2)) }).sum::<f64>() * h / 3.0
    }

    #[test]
    fn the_integral_along_the_contour_is_the_blurred_disc() {
        for (a, b, s) in [(4.8, 4.0, 1.7), (9.0, 3.0, 1.2), (3.0, 2.5, 2.0)] {
            let rim = rim(&ellipse(a, b), s);
            for (x, y) in [(0.0, 0.0), (1.0, 2.0), (a, 0.0), (a + 2.0, 1.0), (0.3, b), (-3.0, -b - 1.0)] {
                let (found, truth) = (rim.seen(x, y).inside, by_strips(a, b, s, x, y));
                assert!((found - truth).abs() < 2e-6, "{a} {b} {s} at ({x}, {y}): {found} against {truth}");
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_value() {
        let (e, s, h) = (ellipse(4.8, 4.0), 1.7, 1e-4);
        let value = |e: &Ellipse, s: f64, x: f64, y: f64| rim(e, s).seen(x, y).inside;
        for (x, y) in [(3.0, 2.0), (5.5, 0.4), (0.2, -3.9)] {
            let seen = rim(&e, s).seen(x, y);
            let by_blur = (value(&e, s + h, x, y) - value(&e, s - h, x, y)) / (2.0 * h);
            assert!((seen.by_blur - by_blur).abs() < 1e-6);
            let by_x = (value(&e, s, x + h, y) - value(&e, s, x - h, y)) / (2.0 * h);
            assert!((seen.gradient[0] - by_x).abs() < 1e-6);
            let bend = (rim(&e, s).seen(x, y + h).gradient[0] - rim(&e, s).seen(x, y - h).gradient[0]) / (2.0 * h);
            assert!((seen.bend[1] - bend).abs() < 1e-6);
            for i in 0..3 {
                let moved = |d: f64| {
                    let mut q = to_regular(&e);
                    q[i] += d;
                    let m = from_regular(&q).unwrap_or(e);
                    value(&ellipse(m.semi_major_px, m.semi_minor_px), s, x - m.center_px.u_px, y - m.center_px.v_px)
                };
                let truth = (moved(h) - moved(-h)) / (2.0 * h);
                assert!((seen.by_geometry[i] - truth).abs() < 1e-6, "{i}: {} against {truth}", seen.by_geometry[i]);
            }
        }
    }

    /// The local profile against the exact disc: what it leaves out grows with the fourth power of curvature times blur.
    #[test]
    fn the_local_profile_holds_up_to_a_third() {
        for (a, b, s, limit) in [(4.8, 4.0, 0.85, 5e-4), (4.8, 4.0, 1.1, 1.5e-3), (30.0, 12.0, 1.0, 2e-4)] {
            let (e, profile) = (ellipse(a, b), Profile { blur_px: s, a, b });
            let (frame, exact) = (Frame::new(&e), rim(&e, s));
            for i in 0..24 {
                let (sin, cos) = (0.26 * f64::from(i)).sin_cos();
                let foot = frame.on_contour(cos, sin);
                for z in [-1.5, -0.5, 0.0, 0.7, 2.0] {
                    let d = z * s;
                    let lanes = profile.at(&[d], &[cos], &[sin]);
                    let truth = exact.seen(foot.u + d * foot.normal_u, foot.v + d * foot.normal_v).inside;
                    assert!((lanes.inside[0] - truth).abs() < limit, "{a} {b} {s}, z {z}: {} {truth}", lanes.inside[0]);
                    let by = |d: f64, s: f64| Profile { blur_px: s, a, b }.at(&[d], &[cos], &[sin]).inside[0];
                    let slope = (by(d + 1e-4, s) - by(d - 1e-4, s)) / 2e-4;
                    assert!((lanes.slope[0] - slope).abs() < 1e-3);
                    let by_blur = (by(d, s + 1e-4) - by(d, s - 1e-4)) / 2e-4;
                    assert!((lanes.by_blur[0] - by_blur).abs() < 5e-3, "{} {by_blur}", lanes.by_blur[0]);
                }
            }
        }
    }
}
