//! Foot points of many points on one ellipse, without trigonometry.
//!
//! The eccentric angle is held as a unit vector; Newton steps on it solve the equation of [`crate::conic`]'s `closest_angle_rad`. For
//! points near the contour (within its radius of curvature) only.

use crate::conic::Ellipse;

/// An ellipse with what its pixels need, computed once.
#[derive(Debug, Default)]
pub(crate) struct Frame {
    pub(crate) u0: f64,
    pub(crate) v0: f64,
    pub(crate) a: f64,
    pub(crate) b: f64,
    pub(crate) cos: f64,
    pub(crate) sin: f64,
    pub(crate) cos2: f64,
    pub(crate) sin2: f64,
}

/// Foot point of a pixel on the ellipse.
#[derive(Default)]
pub(crate) struct Foot {
    pub(crate) distance: f64,
    /// Derivative of the distance with respect to the regular coordinates.
    pub(crate) row: [f64; 5],
}

/// A point of the contour.
pub(crate) struct OnContour {
    pub(crate) u: f64,
    pub(crate) v: f64,
    pub(crate) normal_u: f64,
    pub(crate) normal_v: f64,
    /// Normal in the frame of the axes divided by the semi-axes, 1/px.
    pub(crate) climb: [f64; 2],
    /// d(eccentric angle)/d(arc length), 1/px.
    pub(crate) turn: f64,
    /// Derivative of the distance of a fixed point there with respect to the regular coordinates.
    pub(crate) row: [f64; 5],
}

/// Foot points of several pixels.
pub(crate) struct Feet<const N: usize> {
    pub(crate) distance: [f64; N],
    pub(crate) curvature: [f64; N],
    pub(crate) cos: [f64; N],
    pub(crate) sin: [f64; N],
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

    /// Least distance from an ellipse that lies beside this one, px; not positive where they meet. To a few per cent of the smaller radius.
    pub(crate) fn least_gap_px(&self, other: &Ellipse) -> f64 {
        (0..64)
            .map(|k| other.point(f64::from(k) / 64.0 * std::f64::consts::TAU))
            .map(|p| self.foot(p.u_px, p.v_px, None).distance)
            .fold(f64::INFINITY, f64::min)
    }

    /// A pixel in the frame of the axes.
    #[inline(always)]
    pub(crate) fn inside(&self, u: f64, v: f64) -> (f64, f64) {
        let (du, dv) = (u - self.u0, v - self.v0);
        (self.cos * du + self.sin * dv, self.cos * dv - self.sin * du)
    }

    /// First and last column of row `v` inside the ellipse that is `times` as large.
    pub(crate) fn crossed(&self, v: f64, times: f64) -> Option<[f64; 2]> {
        let dv = v - self.v0;
        let (along, across) =
            ([self.cos / self.a, -self.sin / self.b], [self.sin / self.a * dv, self.cos / self.b * dv]);
        let dot = |p: [f64; 2], q: [f64; 2]| p[0] * q[0] + p[1] * q[1];
        let (square, mixed) = (dot(along, along), dot(along, across));
        let root = (mixed * mixed - square * (dot(across, across) - times * times)).sqrt();
        (root >= 0.0).then(|| [-1.0, 1.0].map(|sign| self.u0 + (sign * root - mixed) / square))
    }

    /// Closest point by Newton steps on the eccentric angle, held as a unit vector: no trigonometry in the loop. `near` is the answer
    /// for an ellipse close by.
    #[inline]
    pub(crate) fn foot(&self, u: f64, v: f64, near: Option<(f64, f64)>) -> Foot {
        let (x, y) = self.inside(u, v);
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
        let row = self.row(c, s, nx, ny, 1.0 / big_n);
        Foot { distance, row }
    }

    /// Everything about the point at the eccentric angle with cosine `c` and sine `s`.
    #[inline(always)]
    pub(crate) fn on_contour(&self, c: f64, s: f64) -> OnContour {
        let (a, b) = (self.a, self.b);
        let turn = 1.0 / (b * b * c * c + a * a * s * s).sqrt();
        let (nx, ny) = (b * c * turn, a * s * turn);
        OnContour {
            u: self.u0 + self.cos * a * c - self.sin * b * s,
            v: self.v0 + self.sin * a * c + self.cos * b * s,
            normal_u: self.cos * nx - self.sin * ny,
            normal_v: self.sin * nx + self.cos * ny,
            climb: [nx / a, ny / b],
            turn,
            row: self.row(c, s, nx, ny, turn),
        }
    }

    /// Derivative of the distance with respect to the regular coordinates, for the foot point at an eccentric angle.
    #[inline(always)]
    pub(crate) fn row_at(&self, c: f64, s: f64) -> [f64; 5] {
        let (a, b) = (self.a, self.b);
        let inverse = 1.0 / (b * b * c * c + a * a * s * s).sqrt();
        self.row(c, s, b * c * inverse, a * s * inverse, inverse)
    }

    /// `b / |t(phi)| (cos 3 phi, sin 3 phi, cos 4 phi, sin 4 phi)`, phi the eccentric angle with cosine `c` and sine `s`, `t = (-a sin phi, b cos phi)`
    /// the tangent, px; without a unit. A displacement D that is a polynomial of degree 3 of the place, as that of a lens with k1 is, moves the contour along
    /// its normal by `n . D = (b cos phi, a sin phi) . D / |t|`: harmonics up to 4 over `|t|`, of which 0 to 2 are those of the ellipse's own five numbers.
    #[inline(always)]
    pub(crate) fn bends_at(&self, c: f64, s: f64) -> [f64; 4] {
        let share = self.b / (self.b * self.b * c * c + self.a * self.a * s * s).sqrt();
        let (c2, s2) = (c * c - s * s, 2.0 * c * s);
        let (c3, s3) = (c2 * c - s2 * s, s2 * c + c2 * s);
        [c3, s3, c2 * c2 - s2 * s2, 2.0 * c2 * s2].map(|x| share * x)
    }

    /// Derivative of the distance with respect to the regular coordinates, for a foot point with normal `(nx, ny)` and `inverse = 1 / |t|`.
    #[inline(always)]
    fn row(&self, c: f64, s: f64, nx: f64, ny: f64, inverse: f64) -> [f64; 5] {
        let (da, db) = (-nx * c, -ny * s);
        let along = da - db;
        let across = -(self.a + self.b) * c * s * inverse;
        [
            -(self.cos * nx - self.sin * ny),
            -(self.sin * nx + self.cos * ny),
            da + db,
            self.cos2 * along - self.sin2 * across,
            self.sin2 * along + self.cos2 * across,
        ]
    }

    /// Foot points of `N` pixels at once, given in the frame of the axes (origin in the centre, x along the major axis, px): the same
    /// Newton steps as [`Frame::foot`], without branches.
    #[inline(always)]
    pub(crate) fn feet<const N: usize>(&self, x: &[f64; N], y: &[f64; N]) -> Feet<N> {
        let (a, b) = (self.a, self.b);
        let e2 = a * a - b * b;
        let (mut c, mut s) = ([0.0; N], [0.0; N]);
        for i in 0..N {
            let (p, q) = (x[i] * b, y[i] * a);
            let squares = p * p + q * q;
            let at_centre = squares == 0.0;
            let inverse = 1.0 / squares.sqrt();
            c[i] = if at_centre { 0.0 } else { p * inverse };
            s[i] = if at_centre { 1.0 } else { q * inverse };
        }
        for _ in 0..6 {
            let mut turned = [0.0; N];
            for i in 0..N {
                let (ax, by) = (x[i] * a, y[i] * b);
                let f = e2 * c[i] * s[i] - ax * s[i] + by * c[i];
                let df = e2 * (c[i] * c[i] - s[i] * s[i]) - ax * c[i] - by * s[i];
                let t = if df < 0.0 { -f / df } else { 0.0 };
                let t = t.clamp(-0.5, 0.5);
                // 1 / (1 + t^2)^(1/2) without a root; what the series leaves of large turns goes by a step of Newton's for the length.
                let t2 = t * t;
                let inverse = 1.0 - 0.5 * t2 * (1.0 - 0.75 * t2 * (1.0 - (5.0 / 6.0) * t2));
                let (cos, sin) = ((c[i] - t * s[i]) * inverse, (s[i] + t * c[i]) * inverse);
                let length = 1.5 - 0.5 * (cos * cos + sin * sin);
                (c[i], s[i]) = (cos * length, sin * length);
                turned[i] = t.abs();
            }
            // Not a maximum: the compiler cannot turn one into vectors.
            if !turned.iter().fold(false, |any, t| any | (*t >= 1e-3)) {
                break;
            }
        }
        let (mut distance, mut curvature) = ([0.0; N], [0.0; N]);
        for i in 0..N {
            let big_n = (b * b * c[i] * c[i] + a * a * s[i] * s[i]).sqrt();
            let inverse = 1.0 / big_n;
            distance[i] = ((x[i] - a * c[i]) * b * c[i] + (y[i] - b * s[i]) * a * s[i]) * inverse;
            curvature[i] = a * b * inverse * inverse * inverse;
        }
        Feet { distance, curvature, cos: c, sin: s }
    }
}
