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
//! (the first by the divergence theorem: the field `(x - p)(1 - exp)/(2 pi rho^2)` has the divergence `G`). A blur of another shape takes the place of G
//! ([`crate::detect::shape`]). The integrands are smooth and
//! periodic: sums over nodes less than a blur apart are exact to rounding.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | t | `Node::cos`, `Node::sin` | 1 | eccentric angle |
//! | n dl | `Node::normal` | px | outward normal times the length of contour of the node |
//! | - | `Seen` | | what one pixel sees of the disc |

use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::shape::Shape;
use crate::lanes::{self, splats};

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
    shape: Shape,
}

/// What [`LANES`] pixels see.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Seen {
    pub(crate) inside: [f64; LANES],
    /// Gradient, 1/px, and second derivatives xx, xy, yy, 1/px^2, in the frame of the axes.
    pub(crate) gradient: [[f64; LANES]; 2],
    pub(crate) bend: [[f64; LANES]; 3],
    /// Derivatives of the grey value, the light's difference at each node included.
    pub(crate) by_geometry: [[f64; LANES]; 5],
    pub(crate) by_blur: [f64; LANES],
}

impl Rim {
    /// Sets the nodes anew.
    pub(crate) fn set(&mut self, frame: &Frame, blur_px: f64, shape: Shape) {
        (self.blur_px, self.shape) = (blur_px, shape);
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

    /// The disc as seen by the pixels at `x`, `y` in the frame of the axes.
    pub(crate) fn seen(&self, x: &[f64; LANES], y: &[f64; LANES]) -> Seen {
        lanes::run(Looks { rim: self, x, y })
    }
}

/// [`Rim::seen`] as wide as the processor is: each lane a pixel, one node after the other.
#[derive(Clone)]
struct Looks<'a> {
    rim: &'a Rim,
    x: &'a [f64; LANES],
    y: &'a [f64; LANES],
}

impl lanes::Kernel for Looks<'_> {
    type Output = Seen;
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) -> Seen {
        let mut out = Seen::default();
        for at in (0..LANES).step_by(L::N) {
            if self.rim.shape.is_gaussian() {
                self.look::<L, false>(at, &mut out);
            } else {
                self.look::<L, true>(at, &mut out);
            }
        }
        out
    }
}

impl Looks<'_> {
    #[inline(always)]
    fn look<L: lanes::Lanes, const SHAPED: bool>(&self, at: usize, out: &mut Seen) {
        let (x, y, zero) = (L::load(&self.x[at..]), L::load(&self.y[at..]), L::splat(0.0));
        let s = self.rim.blur_px;
        let by_two_s2 = L::splat(0.5 / (s * s));
        let (mut inside, mut gradient, mut bend) = (zero, [zero; 2], [zero; 3]);
        let (mut by_geometry, mut by_blur) = ([zero; 5], zero);
        for (node, step) in self.rim.nodes.iter().zip(&self.rim.step) {
            let ([node_x, node_y], [nx, ny]) = (splats::<L, 2>(node.at), splats::<L, 2>(node.normal));
            let (dx, dy) = (node_x - x, node_y - y);
            // Above zero, so that (1 - exp(-h)) / h is there on a node as well; 1 - exp loses nothing that counts, since `across` is small too.
            let half = ((dx * dx + dy * dy) * by_two_s2).at_least(L::splat(1e-8));
            let across = dx * nx + dy * ny;
            let gauss = gaussian(half);
            inside = inside + across * (L::splat(1.0) - gauss) / half;
            // What a point sees of another, and what its gradient has in place of it.
            let (mut seen, mut rising) = (gauss, gauss);
            if SHAPED {
                inside = inside - across * (gauss * self.rim.shape.of_disc(half));
                [seen, rising] = self.rim.shape.of_point(half).map(|x| gauss * x);
            }
            let (gx, gy) = (nx * seen, ny * seen);
            gradient = [gradient[0] - gx, gradient[1] - gy];
            let (gx, gy) = (nx * rising, ny * rising);
            bend = [bend[0] - gx * dx, bend[1] - (gx * dy + gy * dx), bend[2] - gy * dy];
            let light = L::splat(*step) * seen;
            by_blur = by_blur - across * light;
            for (k, row) in node.row.iter().enumerate() {
                by_geometry[k] = by_geometry[k] - L::splat(*row) * light;
            }
        }
        let norm = 1.0 / (std::f64::consts::TAU * s * s);
        let put = |sum: L, factor: f64, out: &mut [f64; LANES]| (sum * L::splat(factor)).store(&mut out[at..]);
        put(inside, 0.5 * norm, &mut out.inside);
        put(gradient[0], norm, &mut out.gradient[0]);
        put(gradient[1], norm, &mut out.gradient[1]);
        put(bend[0], norm / (s * s), &mut out.bend[0]);
        put(bend[1], 0.5 * norm / (s * s), &mut out.bend[1]);
        put(bend[2], norm / (s * s), &mut out.bend[2]);
        put(by_blur, norm / s, &mut out.by_blur);
        for (sum, out) in by_geometry.into_iter().zip(&mut out.by_geometry) {
            put(sum, norm, out);
        }
    }
}

/// `exp(-h)` for `h >= 0`, error below 1e-11: the series of `exp(-h / 64)`, squared six times; beyond 40 as at 40.
#[inline(always)]
pub(crate) fn gaussian<L: lanes::Lanes>(h: L) -> L {
    let number = |x: f64| L::splat(x);
    let z = h.at_most(number(40.0)) * number(-1.0 / 64.0);
    let mut power = number(1.0)
        + z * (number(1.0)
            + z * (number(1.0 / 2.0)
                + z * (number(1.0 / 6.0)
                    + z * (number(1.0 / 24.0) + z * (number(1.0 / 120.0) + z * number(1.0 / 720.0))))));
    for _ in 0..6 {
        power = power * power;
    }
    power
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
        shaped(e, blur_px, Shape::GAUSSIAN)
    }

    fn shaped(e: &Ellipse, blur_px: f64, shape: Shape) -> Rim {
        let mut rim = Rim::default();
        rim.set(&Frame::new(e), blur_px, shape);
        rim.step = rim.angles().map(|_| 1.0).collect();
        rim
    }

    /// What the pixel at one place sees.
    fn seen(rim: &Rim, x: f64, y: f64) -> Seen {
        rim.seen(&[x; LANES], &[y; LANES])
    }

    fn inside(rim: &Rim, x: f64, y: f64) -> f64 {
        seen(rim, x, y).inside[0]
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
                let (found, truth) = (inside(&rim, x, y), by_strips(a, b, s, x, y));
                assert!((found - truth).abs() < 2e-6, "{a} {b} {s} at ({x}, {y}): {found} against {truth}");
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_value() {
        let (defocus, wings) = (Shape { fourth: -0.09, sixth: -0.05 }, Shape { fourth: 0.3, sixth: -0.04 });
        // With as many nodes for a blur that is a little wider or narrower.
        for (shape, s) in [(Shape::GAUSSIAN, 1.7), (defocus, 1.33), (wings, 1.33)] {
            for at in [[3.0, 2.0], [5.5, 0.4], [0.2, -3.9]] {
                derivatives_at(at, s, shape);
            }
        }
    }

    fn derivatives_at([x, y]: [f64; 2], s: f64, shape: Shape) {
        let (e, h) = (ellipse(4.8, 4.0), 1e-4);
        let value = |e: &Ellipse, s: f64, x: f64, y: f64| inside(&shaped(e, s, shape), x, y);
        let near = |what: &str, found: f64, up: f64, down: f64| {
            let truth = (up - down) / (2.0 * h);
            assert!((found - truth).abs() < 1e-6, "{what}, {shape:?} at {x}, {y}: {found} against {truth}");
        };
        let at = seen(&shaped(&e, s, shape), x, y);
        near("blur", at.by_blur[0], value(&e, s + h, x, y), value(&e, s - h, x, y));
        near("x", at.gradient[0][0], value(&e, s, x + h, y), value(&e, s, x - h, y));
        let gradient = |y: f64| seen(&shaped(&e, s, shape), x, y).gradient;
        near("x y", at.bend[1][0], gradient(y + h)[0][0], gradient(y - h)[0][0]);
        near("y y", at.bend[2][0], gradient(y + h)[1][0], gradient(y - h)[1][0]);
        for i in 0..3 {
            let moved = |d: f64| {
                let mut q = to_regular(&e);
                q[i] += d;
                let m = from_regular(&q).unwrap_or(e);
                value(&ellipse(m.semi_major_px, m.semi_minor_px), s, x - m.center_px.u_px, y - m.center_px.v_px)
            };
            near("geometry", at.by_geometry[i][0], moved(h), moved(-h));
        }
    }

    /// The local profile against the exact disc: what it leaves out grows with the fourth power of curvature times blur.
    #[test]
    fn the_local_profile_holds_up_to_a_third() {
        for (a, b, s, limit) in [(4.8, 4.0, 0.85, 5e-4), (4.8, 4.0, 1.1, 1.5e-3), (30.0, 12.0, 1.0, 2e-4)] {
            let (e, profile) = (ellipse(a, b), Profile { blur_px: s, shape: Shape::GAUSSIAN, a, b });
            let (frame, exact) = (Frame::new(&e), rim(&e, s));
            for i in 0..24 {
                let (sin, cos) = (0.26 * f64::from(i)).sin_cos();
                let foot = frame.on_contour(cos, sin);
                for z in [-1.5, -0.5, 0.0, 0.7, 2.0] {
                    let d = z * s;
                    let lanes = profile.at(&[d], &[cos], &[sin]);
                    let truth = inside(&exact, foot.u + d * foot.normal_u, foot.v + d * foot.normal_v);
                    assert!((lanes.inside[0] - truth).abs() < limit, "{a} {b} {s}, z {z}: {} {truth}", lanes.inside[0]);
                    let by = |d: f64, s: f64| {
                        Profile { blur_px: s, shape: Shape::GAUSSIAN, a, b }.at(&[d], &[cos], &[sin]).inside[0]
                    };
                    let slope = (by(d + 1e-4, s) - by(d - 1e-4, s)) / 2e-4;
                    assert!((lanes.slope[0] - slope).abs() < 1e-3);
                    let by_blur = (by(d, s + 1e-4) - by(d, s - 1e-4)) / 2e-4;
                    assert!((lanes.by_blur[0] - by_blur).abs() < 5e-3, "{} {by_blur}", lanes.by_blur[0]);
                }
            }
        }
    }

    #[test]
    fn all_widths_agree_to_the_bit_and_pixels_do_not_look_at_each_other() {
        let rim = rim(&ellipse(4.8, 4.0), 1.7);
        let x: [f64; LANES] = std::array::from_fn(|l| 1.3 * l as f64 - 4.8);
        let y: [f64; LANES] = std::array::from_fn(|l| 4.0 - 0.9 * l as f64);
        let all = lanes::run_all(&Looks { rim: &rim, x: &x, y: &y });
        assert!(all.iter().all(|seen| *seen == all[0]));
        for l in 0..LANES {
            assert_eq!(all[0].inside[l], inside(&rim, x[l], y[l]));
        }
    }

    #[test]
    fn the_exponential_is_as_good_as_it_says() {
        for k in 0..4100 {
            let h = 0.01 * f64::from(k);
            let off = (gaussian(h) - (-h).exp()).abs();
            assert!(off < 1e-11, "exp(-{h}) is off by {off}");
        }
    }
}
