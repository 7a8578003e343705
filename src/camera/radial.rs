//! Radial distortion on the untilted plane at unit distance: `out = in g(|in|^2)`, its inverse, and where it ends.
//!
//! `r g(r^2)` grows while `p(s) = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 > 0` with `s = r^2`; its first positive root is the
//! last radius at which the polynomial means a lens; where it has none, 1e3 is. Without distortion there is no last one.

use super::{Camera, Radial, Refusal};
use nalgebra::{Matrix2, Matrix2x3, Vector2};

/// Largest valid radius before the polynomial and its value behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RadialLimit {
    radius: f64,
    image: f64,
}

fn gain(k: &[f64; 3], s: f64) -> f64 {
    1.0 + s * (k[0] + s * (k[1] + s * k[2]))
}

fn gain_slope(k: &[f64; 3], s: f64) -> f64 {
    k[0] + s * (2.0 * k[1] + s * 3.0 * k[2])
}

fn growth(k: &[f64; 3], s: f64) -> f64 {
    1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * 7.0 * k[2]))
}

/// A field of view of 179.9 degrees: beyond any lens with a plane image. Far beyond, `r g` overflows and Newton's iteration
/// for its inverse no longer arrives.
const LARGEST_RADIUS: f64 = 1e3;

impl RadialLimit {
    /// The radius before the polynomial up to which it is valid.
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// What becomes of that radius.
    pub(super) fn image(&self) -> f64 {
        self.image
    }

    /// First positive root of the growth polynomial, by bisection between its extrema.
    pub(super) fn of(k: &[f64; 3]) -> Self {
        // Extrema of p: 3 k1 + 10 k2 s + 21 k3 s^2 = 0, in the cancellation-free form.
        let (a, b, c) = (21.0 * k[2], 10.0 * k[1], 3.0 * k[0]);
        let mut knots = vec![];
        let disc = b * b - 4.0 * a * c;
        if disc >= 0.0 {
            let q = -0.5 * (b + disc.sqrt().copysign(b));
            knots.extend([q / a, c / q].into_iter().filter(|s| s.is_finite() && *s > 0.0));
        }
        knots.sort_by(f64::total_cmp);
        knots.retain(|s| *s < LARGEST_RADIUS * LARGEST_RADIUS);
        knots.push(LARGEST_RADIUS * LARGEST_RADIUS);
        let mut low = 0.0;
        for high in knots {
            if growth(k, high) <= 0.0 {
                let s = bisect(k, low, high);
                let radius = s.sqrt();
                return Self { radius, image: radius * gain(k, s) };
            }
            low = high;
        }
        // A lens without distortion has nothing that could end.
        if *k == [0.0; 3] {
            return Self { radius: f64::INFINITY, image: f64::INFINITY };
        }
        Self { radius: LARGEST_RADIUS, image: LARGEST_RADIUS * gain(k, LARGEST_RADIUS * LARGEST_RADIUS) }
    }
}

/// Root of the growth polynomial in (low, high], positive at low and not at high.
fn bisect(k: &[f64; 3], mut low: f64, mut high: f64) -> f64 {
    // Newton's steps first: once they agree, a narrow interval about them leaves little to halve.
    let mut s = 0.5 * (low + high);
    for _ in 0..8 {
        let slope = 3.0 * k[0] + s * (10.0 * k[1] + s * 21.0 * k[2]);
        s -= growth(k, s) / slope;
    }
    for near in [s * (1.0 - 1e-14), s * (1.0 + 1e-14)] {
        if near > low && near < high {
            if growth(k, near) > 0.0 { low = near } else { high = near }
        }
    }
    loop {
        let mid = 0.5 * (low + high);
        if mid <= low || mid >= high {
            return low;
        }
        if growth(k, mid) > 0.0 { low = mid } else { high = mid }
    }
}

impl Camera {
    /// Ideal -> distorted.
    pub(super) fn distort(&self, xy: &Vector2<f64>) -> Result<Vector2<f64>, Refusal> {
        match self.intrinsics.radial {
            Radial::IdealToDistorted => self.polynomial(xy),
            Radial::DistortedToIdeal => self.polynomial_inverse(xy),
        }
    }

    /// Distorted -> ideal.
    pub(super) fn undistort(&self, xd: &Vector2<f64>) -> Result<Vector2<f64>, Refusal> {
        match self.intrinsics.radial {
            Radial::IdealToDistorted => self.polynomial_inverse(xd),
            Radial::DistortedToIdeal => self.polynomial(xd),
        }
    }

    /// Ideal -> distorted with derivatives by (x, y) and by (k1, k2, k3).
    pub(super) fn distort_jet(
        &self,
        xy: &Vector2<f64>,
    ) -> Result<(Vector2<f64>, Matrix2<f64>, Matrix2x3<f64>), Refusal> {
        let xd = self.distort(xy)?;
        match self.intrinsics.radial {
            Radial::IdealToDistorted => {
                let (d, dk) = self.polynomial_derivatives(xy);
                Ok((xd, d, dk))
            }
            Radial::DistortedToIdeal => {
                let (d, dk) = self.polynomial_derivatives(&xd);
                let inverse = d.try_inverse().ok_or(self.beyond(xd.norm()))?;
                Ok((xd, inverse, -(inverse * dk)))
            }
        }
    }

    fn beyond(&self, radius: f64) -> Refusal {
        Refusal::BeyondDistortion { radius, limit: self.limit.radius }
    }

    fn polynomial(&self, p: &Vector2<f64>) -> Result<Vector2<f64>, Refusal> {
        let s = p.norm_squared();
        // Written so that NaN is refused too.
        if !(s < self.limit.radius * self.limit.radius) {
            return Err(if s.is_finite() { self.beyond(s.sqrt()) } else { Refusal::NotFinite });
        }
        Ok(p * gain(&self.intrinsics.k, s))
    }

    fn polynomial_derivatives(&self, p: &Vector2<f64>) -> (Matrix2<f64>, Matrix2x3<f64>) {
        let k = &self.intrinsics.k;
        let s = p.norm_squared();
        let d = Matrix2::identity() * gain(k, s) + p * p.transpose() * (2.0 * gain_slope(k, s));
        (d, Matrix2x3::from_columns(&[p * s, p * (s * s), p * (s * s * s)]))
    }

    /// Solves `r g(r^2) = |p|` by Newton, kept between bounds that always enclose the root.
    fn polynomial_inverse(&self, p: &Vector2<f64>) -> Result<Vector2<f64>, Refusal> {
        let k = &self.intrinsics.k;
        let target = p.norm();
        // Without distortion there is no bound above either.
        if *k == [0.0; 3] || target == 0.0 {
            return if target.is_finite() { Ok(*p) } else { Err(Refusal::NotFinite) };
        }
        if !(target < self.limit.image) {
            return Err(if target.is_finite() {
                Refusal::BeyondDistortion { radius: target, limit: self.limit.image }
            } else {
                Refusal::NotFinite
            });
        }
        let (mut low, mut high) = (0.0, self.limit.radius);
        let mut r = target / gain(k, (target * target).min(high * high)).max(0.5);
        // 64 steps: Newton needs about 4; bisection alone would need 53.
        for _ in 0..64 {
            let s = r * r;
            let excess = r * gain(k, s) - target;
            if excess > 0.0 {
                high = r
            } else {
                low = r
            }
            let newton = r - excess / growth(k, s);
            // At the root Newton's step ends on a bound: asked before the bounds are, it is no reason to bisect.
            if (newton - r).abs() <= f64::EPSILON * r {
                r = newton;
                break;
            }
            r = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        }
        Ok(p * (r / target))
    }
}
