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
