//! An ellipse as a matrix, its distances, its lengths.
//!
//! Foot point of a point `(x, y)` in the ellipse's own axes: `(a cos t, b sin t)` with
//! `(a^2 - b^2) cos t sin t - x a sin t + y b cos t = 0`, solved by Newton steps kept inside the quadrant of the point.
//!
//! Perimeter: `2 pi (M(a^2, b^2) / M(a, b))` with the arithmetic-geometric mean `M` and Gauss' modified mean above it,
//! here by the series `2 pi / M(a, b) (a^2 - sum 2^(n-1) c_n^2)`.

use crate::conic::Ellipse;
use crate::error::{Insufficient, Invalid, Result};
use crate::frames::Pixel;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};
use std::f64::consts::{FRAC_PI_2, PI};

impl Ellipse {
    /// An ellipse from its centre, two semi-axes in any order and the angle of the first axis.
    ///
    /// # Errors
    /// [`Invalid::Value`] where an axis is not positive or a number is not finite.
    pub fn new(center_px: Pixel, semi_a_px: f64, semi_b_px: f64, angle_rad: f64) -> Result<Self> {
        let numbers = [center_px.u_px, center_px.v_px, semi_a_px, semi_b_px, angle_rad];
        if let Some(bad) = numbers.iter().find(|x| !x.is_finite()) {
            return Err(Invalid::value("ellipse", *bad, "finite numbers").into());
        }
        if semi_a_px <= 0.0 || semi_b_px <= 0.0 {
            return Err(Invalid::value("ellipse semi-axis", semi_a_px.min(semi_b_px), "a positive length in px").into());
        }
        let (a, b, phi) = if semi_a_px >= semi_b_px {
            (semi_a_px, semi_b_px, angle_rad)
        } else {
            (semi_b_px, semi_a_px, angle_rad + FRAC_PI_2)
        };
        Ok(Self { center_px, semi_major_px: a, semi_minor_px: b, angle_rad: wrap_half_turn(phi) })
    }

    /// The symmetric 3 x 3 matrix `C` with `p^T C p = (x/a)^2 + (y/b)^2 - 1` for `p = (u, v, 1)` px.
    pub fn matrix(&self) -> Matrix3<f64> {
        let (s, c) = self.angle_rad.sin_cos();
        let r = Matrix2::new(c, s, -s, c);
        let d = Matrix2::new(self.semi_major_px.powi(-2), 0.0, 0.0, self.semi_minor_px.powi(-2));
        let m = r.transpose() * d * r;
        let x0 = Vector2::new(self.center_px.u_px, self.center_px.v_px);
        let l = -(m * x0);
        let k = x0.dot(&(m * x0)) - 1.0;
        Matrix3::new(m[(0, 0)], m[(0, 1)], l[0], m[(0, 1)], m[(1, 1)], l[1], l[0], l[1], k)
    }

    /// The ellipse of a symmetric 3 x 3 matrix (any scale, either sign).
    ///
    /// # Errors
    /// [`Insufficient::Degenerate`] where the conic is no real ellipse (hyperbola, parabola, lines, a point, empty).
    pub fn from_matrix(conic: &Matrix3<f64>) -> Result<Self> {
        let m = Matrix2::new(conic[(0, 0)], conic[(0, 1)], conic[(0, 1)], conic[(1, 1)]);
        let no_ellipse =
            || Insufficient::Degenerate("the conic is no real ellipse; the disc is cut or seen edge-on".into());
        let det = m.determinant();
        let size = m.norm_squared();
        if !size.is_finite() || size <= 0.0 || det <= 1e-14 * size {
            return Err(no_ellipse().into());
        }
        let l = Vector2::new(conic[(0, 2)], conic[(1, 2)]);
        let x0 = -Vector2::new(m[(1, 1)] * l[0] - m[(0, 1)] * l[1], m[(0, 0)] * l[1] - m[(0, 1)] * l[0]) / det;
        let k = conic[(2, 2)] + l.dot(&x0);
        let n = m / -k;
        let half_trace = 0.5 * n.trace();
        let e = Vector2::new(0.5 * (n[(0, 0)] - n[(1, 1)]), n[(0, 1)]);
        let (lo, hi) = (half_trace - e.norm(), half_trace + e.norm());
        if !(lo > 0.0 && hi.is_finite()) {
            return Err(no_ellipse().into());
        }
        // The larger eigenvalue belongs to the minor axis; the major one is a quarter turn off.
        let angle = 0.5 * e[1].atan2(e[0]) + FRAC_PI_2;
        Self::new(Pixel::new(x0[0], x0[1]), lo.powf(-0.5), hi.powf(-0.5), angle)
    }

    /// `(x/a)^2 + (y/b)^2 - 1` at a pixel position: negative inside, zero on the ellipse.
    pub fn implicit(&self, p: Pixel) -> f64 {
        let (x, y) = self.own_axes(p);
        (x / self.semi_major_px).powi(2) + (y / self.semi_minor_px).powi(2) - 1.0
    }

    /// Eccentric angle, rad, of the point of the ellipse closest to `p`.
    pub fn closest_angle_rad(&self, p: Pixel) -> f64 {
        let (a, b) = (self.semi_major_px, self.semi_minor_px);
        let (x, y) = self.own_axes(p);
        // By symmetry in the first quadrant, where the foot point is unique and bracketed.
        let (ax, ay) = (x.abs(), y.abs());
        let slope = |t: f64| (a * a - b * b) * t.sin() * t.cos() - ax * a * t.sin() + ay * b * t.cos();
        let (mut lo, mut hi) = (0.0_f64, FRAC_PI_2);
        let mut t = (a * ay).atan2(b * ax);
        if ay == 0.0 {
            // On the major axis the foot leaves the vertex inside the evolute.
            let cos_t = (ax * a / (a * a - b * b)).min(1.0);
            t = if cos_t.is_finite() { cos_t.acos() } else { 0.0 };
            (lo, hi) = (t, t);
        }
        for _ in 0..60 {
            if hi - lo <= 0.0 {
                t = lo;
                break;
            }
            let f = slope(t);
            if f > 0.0 {
                lo = t;
            } else {
                hi = t;
            }
            let df = (a * a - b * b) * (2.0 * t).cos() - ax * a * t.cos() - ay * b * t.sin();
            let newton = t - f / df;
            let next = if newton > lo && newton < hi { newton } else { 0.5 * (lo + hi) };
            let step = (next - t).abs();
            t = next;
            if step < 1e-15 {
                break;
            }
        }
        match (x >= 0.0, y >= 0.0) {
            (true, true) => t,
            (true, false) => -t,
            (false, true) => PI - t,
            (false, false) => t - PI,
        }
    }

    /// Orthogonal distance of a pixel position from the ellipse, px; positive outside.
    pub fn distance_px(&self, p: Pixel) -> f64 {
        let foot = self.point(self.closest_angle_rad(p));
        let gap = (p.u_px - foot.u_px).hypot(p.v_px - foot.v_px);
        if self.implicit(p) < 0.0 { -gap } else { gap }
    }

    /// Unit normal, outwards, at eccentric angle `t_rad`.
    pub fn normal(&self, t_rad: f64) -> Vector2<f64> {
        let (st, ct) = t_rad.sin_cos();
        let (nx, ny) = (self.semi_minor_px * ct, self.semi_major_px * st);
        let n = nx.hypot(ny);
        let (s, c) = self.angle_rad.sin_cos();
        Vector2::new(c * nx - s * ny, s * nx + c * ny) / n
    }

    /// Radius of curvature at eccentric angle `t_rad`, px.
    pub fn curvature_radius_px(&self, t_rad: f64) -> f64 {
        let (a, b) = (self.semi_major_px, self.semi_minor_px);
        let (s, c) = t_rad.sin_cos();
        (a * a * s * s + b * b * c * c).powf(1.5) / (a * b)
    }

    /// Area, px^2.
    pub fn area_px2(&self) -> f64 {
        PI * self.semi_major_px * self.semi_minor_px
    }

    /// Radius of the circle of the same area, px.
    pub fn mean_radius_px(&self) -> f64 {
        (self.semi_major_px * self.semi_minor_px).sqrt()
    }

    /// Length of the contour, px.
    pub fn perimeter_px(&self) -> f64 {
        let (mut x, mut y) = (self.semi_major_px, self.semi_minor_px);
        let (mut sum, mut power) = (x * x - 0.5 * (x * x - y * y), 0.5);
        for _ in 0..40 {
            let c = 0.5 * (x - y);
            (x, y) = (0.5 * (x + y), (x * y).sqrt());
            power *= 2.0;
            sum -= power * c * c;
            if c.abs() < 1e-16 * x {
                break;
            }
        }
        2.0 * PI * sum / x
    }

    /// Whether the contour is longer than so many px: mostly what it is at least and at most decides, `pi (a + b)` and `pi (2 (a^2 + b^2))^(1/2)`.
    pub(crate) fn is_longer_than(&self, limit_px: f64) -> bool {
        // Far more than rounding.
        const MARGIN: f64 = 1e-9;
        let (a, b) = (self.semi_major_px, self.semi_minor_px);
        if PI * (a + b) * (1.0 - MARGIN) > limit_px {
            return true;
        }
        let most = 2.0 * (PI * PI) * (a * a + b * b) * (1.0 + MARGIN);
        if most < limit_px * limit_px { false } else { self.perimeter_px() > limit_px }
    }

    /// Position of `p` along the major and the minor axis, px.
    fn own_axes(&self, p: Pixel) -> (f64, f64) {
        let (s, c) = self.angle_rad.sin_cos();
        let (du, dv) = (p.u_px - self.center_px.u_px, p.v_px - self.center_px.v_px);
        (c * du + s * dv, c * dv - s * du)
    }
}

/// An angle of an undirected axis, rad, brought into (-pi/2, pi/2].
fn wrap_half_turn(angle_rad: f64) -> f64 {
    let turned = angle_rad.rem_euclid(PI);
    if turned > FRAC_PI_2 { turned - PI } else { turned }
}

/// `(u0, v0, (a + b)/2, e1, e2)`, px: coordinates without a singularity at the circle.
pub(crate) fn to_regular(ellipse: &Ellipse) -> SVector<f64, 5> {
    let e = 0.5 * (ellipse.semi_major_px - ellipse.semi_minor_px);
    let (s, c) = (2.0 * ellipse.angle_rad).sin_cos();
    SVector::from([
        ellipse.center_px.u_px,
        ellipse.center_px.v_px,
        0.5 * (ellipse.semi_major_px + ellipse.semi_minor_px),
        e * c,
        e * s,
    ])
}

/// Back from [`to_regular`]; `None` where the numbers are no ellipse.
pub(crate) fn from_regular(q: &SVector<f64, 5>) -> Option<Ellipse> {
    let e = q[3].hypot(q[4]);
    let (a, b) = (q[2] + e, q[2] - e);
    if !(b > 0.0 && a.is_finite() && q[0].is_finite() && q[1].is_finite()) {
        return None;
    }
    let angle_rad = wrap_half_turn(0.5 * q[4].atan2(q[3]));
    Some(Ellipse { center_px: Pixel::new(q[0], q[1]), semi_major_px: a, semi_minor_px: b, angle_rad })
}

/// Derivative of `(u0, v0, a, b, phi)` by the regular coordinates, whose covariance says where an angle means nothing.
pub(crate) fn parameters_by_regular(q: &SVector<f64, 5>, cov: &SMatrix<f64, 5, 5>) -> SMatrix<f64, 5, 5> {
    let e = q[3].hypot(q[4]);
    let (c, s) = if e > 0.0 { (q[3] / e, q[4] / e) } else { (1.0, 0.0) };
    let sigma_perpendicular = (s * s * cov[(3, 3)] - 2.0 * s * c * cov[(3, 4)] + c * c * cov[(4, 4)]).max(0.0).sqrt();
    // A direction found within its own noise is as good as unknown: a uniform angle has sigma pi / sqrt(12) = 0.907.
    let arm = e.max(0.5 * sigma_perpendicular / (PI / 12.0_f64.sqrt())).max(1e-12);
    let mut j = SMatrix::<f64, 5, 5>::zeros();
    j[(0, 0)] = 1.0;
    j[(1, 1)] = 1.0;
    j[(2, 2)] = 1.0;
    j[(2, 3)] = c;
    j[(2, 4)] = s;
    j[(3, 2)] = 1.0;
    j[(3, 3)] = -c;
    j[(3, 4)] = -s;
    j[(4, 3)] = -s / (2.0 * arm);
    j[(4, 4)] = c / (2.0 * arm);
    j
}

/// Covariance of `(u0, v0, a, b, phi)` from that of the regular coordinates.
pub(crate) fn covariance_from_regular(q: &SVector<f64, 5>, cov: &SMatrix<f64, 5, 5>) -> SMatrix<f64, 5, 5> {
    let j = parameters_by_regular(q, cov);
    j * cov * j.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of round and of flat ellipses, at limits far off, near and very near.
    #[test]
    fn a_contour_is_longer_than_what_is_less_than_its_length() {
        for (a, b) in [(13.0, 11.0), (20.7, 20.7), (300.0, 2.0), (5.0, 1e-4)] {
            let e = Ellipse { center_px: Pixel::new(3.0, 4.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.3 };
            let length = e.perimeter_px();
            for part in [0.0, 0.1, 0.9, 0.99, 0.9999, 1.0 - 1e-12] {
                assert!(e.is_longer_than(part * length), "{part} of {a} x {b} px");
                assert!(!e.is_longer_than((2.0 - part) * length), "2 - {part} of {a} x {b} px");
            }
            assert!(!e.is_longer_than(length) && !e.is_longer_than(f64::INFINITY));
        }
    }
}
