//! Foot points of many points on one ellipse, without trigonometry.
//!
//! The eccentric angle is held as a unit vector; Newton steps on it solve the equation of [`crate::conic`]'s `closest_angle_rad`. For
//! points near the contour (within its radius of curvature) only.

use crate::conic::Ellipse;

/// An ellipse with what its pixels need, computed once.
pub(crate) struct Frame {
    pub(crate) u0: f64,
    pub(crate) v0: f64,
    pub(crate) a: f64,
    pub(crate) b: f64,
    pub(crate) cos: f64,
    pub(crate) sin: f64,
    cos2: f64,
    sin2: f64,
}

/// Foot point of a pixel on the ellipse.
#[derive(Default)]
pub(crate) struct Foot {
    pub(crate) distance: f64,
    pub(crate) curvature: f64,
    pub(crate) cos: f64,
    pub(crate) sin: f64,
    /// Derivative of the distance with respect to the regular coordinates.
    pub(crate) row: [f64; 5],
}

impl Frame {
    pub(crate) fn new(e: &Ellipse) -> Self {
        let (sin, cos) = e.angle_rad.sin_cos();
        Self {
            u0: e.center_px.u_px,
            v0: e.center_px.v_px,
            a: e.semi_major_px,
            b: e.semi_minor_px,
            cos,
            sin,
            cos2: cos * cos - sin * sin,
            sin2: 2.0 * sin * cos,
        }
    }

    /// Columns, relative to the centre, where the row `dv` cuts the ellipse with semi-axes `a`, `b`.
    pub(crate) fn row_span(&self, dv: f64, a: f64, b: f64) -> Option<(f64, f64)> {
        let (ia, ib) = (1.0 / (a * a), 1.0 / (b * b));
        let m00 = self.cos * self.cos * ia + self.sin * self.sin * ib;
        let m01 = self.cos * self.sin * (ia - ib);
        let m11 = self.sin * self.sin * ia + self.cos * self.cos * ib;
        let disc = m01 * m01 * dv * dv - m00 * (m11 * dv * dv - 1.0);
        (disc >= 0.0).then(|| {
            let root = disc.sqrt();
            ((-m01 * dv - root) / m00, (-m01 * dv + root) / m00)
        })
    }

    /// Closest point by Newton steps on the eccentric angle, held as a unit vector: no trigonometry in the loop. `near` is the answer
    /// for an ellipse close by.
    #[inline]
    pub(crate) fn foot(&self, u: f64, v: f64, near: Option<(f64, f64)>) -> Foot {
        let (du, dv) = (u - self.u0, v - self.v0);
        let (x, y) = (self.cos * du + self.sin * dv, self.cos * dv - self.sin * du);
        let (a, b) = (self.a, self.b);
        let e2 = a * a - b * b;
        let (mut c, mut s) = near.unwrap_or((1.0, 0.0));
        let mut fresh = near.is_none();
        let mut steps = 0;
        while steps < 4 {
            if fresh {
                (c, s) = (x * b, y * a);
                let norm = (c * c + s * s).sqrt();
                (c, s) = if norm > 0.0 { (c / norm, s / norm) } else { (0.0, 1.0) };
            }
            let f = e2 * c * s - x * a * s + y * b * c;
            let df = e2 * (c * c - s * s) - x * a * c - y * b * s;
            // Towards the minimum only: at the far side of the evolute the curvature of the square distance turns.
            let t = if df < 0.0 { -f / df } else { 0.0 };
            if !fresh && (df >= 0.0 || t.abs() > 0.1) {
                // The axes of a near-circle can swap from one ellipse to the next: start over.
                fresh = true;
                continue;
            }
            fresh = false;
            let t = t.clamp(-0.5, 0.5);
            let inverse =
                if t.abs() < 0.1 { 1.0 - 0.5 * t * t * (1.0 - 0.75 * t * t) } else { 1.0 / (1.0 + t * t).sqrt() };
            (c, s) = ((c - t * s) * inverse, (s + t * c) * inverse);
            steps += 1;
            if t.abs() < 1e-3 {
                break;
            }
        }
        let big_n = (b * b * c * c + a * a * s * s).sqrt();
        let (nx, ny) = (b * c / big_n, a * s / big_n);
        let distance = (x - a * c) * nx + (y - b * s) * ny;
        let (da, db) = (-nx * c, -ny * s);
        let along = da - db;
        let across = -(a + b) * c * s / big_n;
        let row = [
            -(self.cos * nx - self.sin * ny),
            -(self.sin * nx + self.cos * ny),
            da + db,
            self.cos2 * along - self.sin2 * across,
            self.sin2 * along + self.cos2 * across,
        ];
        Foot { distance, curvature: a * b / (big_n * big_n * big_n), cos: c, sin: s, row }
    }
}
