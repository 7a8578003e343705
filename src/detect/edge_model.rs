//! The blurred edge of one disc, fitted to the grey values around it.
//!
//! Physical picture: a disc of one brightness on a ground of another, blurred by optics and by the area of the pixels.
//! Along the outward normal, with `d` the signed distance of a pixel from the ellipse,
//!
//! ```text
//! g(d, t) = P L_in(t) + (1 - P) L_out(t) + slope terms,   P = Phi(-(d + kappa s^2 / 2) / s)
//! ```
//!
//! `Phi` is the normal distribution, `kappa` the local curvature: blur moves the half level of a curved edge inwards by
//! `kappa s^2 / 2` (heat equation in polar coordinates, first order; the second order only widens `s` by `1 + kappa^2 s^2 / 4`,
//! which the fitted `s` absorbs; the third order is `kappa^3 s^4 / 8`).
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | q | `geometry` | 5 | px | `(u0, v0, (a+b)/2, e1, e2)`, see [`crate::conic`] |
//! | s | `blur_px` | 1 | px | standard deviation of the blur, pixel area included (adds 1/12 px^2) |
//! | t | `angle` | 1 | rad | eccentric angle of the foot point |
//! | L_in, L_out | `levels` | 1, 3 or n per side | grey | constant; first harmonic; or periodic quadratic B-spline in t |
//! | slopes | `slopes` | 2 | grey/px | `P d`, `(1 - P) d`: radial gradient inside and outside |
//! | var_in, var_out | `variance` | 2 | grey^2 | noise on either side; in between it follows P (shot noise rises with level) |
//!
//! A small disc cannot tell its size from blur and radial gradient; weak priors hold what the data leave open (for discs of more than
//! some ten pixels the data outweigh them by orders of magnitude): blur within `PRIOR_BLUR_PX` of the value given, slopes within
//! `PRIOR_SLOPE` of the grey step per minor semi-axis.
//!
//! Not valid where the radius of curvature is not well above the blur, or where another edge lies within the band.

use crate::conic::{Ellipse, from_regular, to_regular};
use crate::image::GrayView;
use nalgebra::SVector;
use std::f64::consts::{FRAC_2_SQRT_PI, TAU};

/// Geometry, blur and slopes come first in the parameter vector, the levels after them.
const FIXED: usize = 8;
/// Most level coefficients on one side.
const MOST_NODES: usize = 64;

/// Standard deviation of the prior of the blur, px.
const PRIOR_BLUR_PX: f64 = 0.3;
/// Standard deviation of the prior of the slopes, grey steps per minor semi-axis.
const PRIOR_SLOPE: f64 = 0.15;

/// Pixels of the band around one ellipse, structure of arrays, reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Band {
    pub(crate) u: Vec<f64>,
    pub(crate) v: Vec<f64>,
    pub(crate) grey: Vec<f64>,
    /// Eccentric angle of the foot point when collected, rad.
    pub(crate) angle: Vec<f64>,
    /// 0 for pixels that do not count.
    pub(crate) keep: Vec<bool>,
    /// Model minus data is never kept: residual = data - model, grey levels.
    pub(crate) residual: Vec<f64>,
    /// Signed distance from the ellipse, px.
    pub(crate) distance: Vec<f64>,
    /// P.
    pub(crate) inside: Vec<f64>,
    /// d(model)/d(outward shift of the edge), grey/px.
    pub(crate) response: Vec<f64>,
}

/// How far the band reaches from the ellipse, px.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    pub(crate) inner_px: f64,
    pub(crate) outer_px: f64,
}

/// How the levels vary around the disc.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Levels {
    Constant,
    Harmonic,
    Spline(usize),
}

impl Levels {
    pub(crate) fn count(self) -> usize {
        match self {
            Levels::Constant => 1,
            Levels::Harmonic => 3,
            Levels::Spline(n) => n,
        }
    }

    /// Up to three (index, value) pairs of the basis at an angle.
    #[inline]
    fn basis(self, angle: f64, c: f64, s: f64) -> ([usize; 3], [f64; 3], usize) {
        match self {
            Levels::Constant => ([0; 3], [1.0, 0.0, 0.0], 1),
            Levels::Harmonic => ([0, 1, 2], [1.0, c, s], 3),
            Levels::Spline(n) => {
                let x = (angle / TAU).rem_euclid(1.0) * n as f64;
                let i = (x as usize).min(n - 1);
                let f = x - i as f64;
                let w = [0.5 * (1.0 - f) * (1.0 - f), 0.5 + f * (1.0 - f), 0.5 * f * f];
                ([(i + n - 1) % n, i, (i + 1) % n], w, 3)
            }
        }
    }
}

/// State of the model of one disc.
#[derive(Debug, Clone)]
pub(crate) struct EdgeModel {
    pub(crate) ellipse: Ellipse,
    geometry: SVector<f64, 5>,
    pub(crate) blur_px: f64,
    pub(crate) slopes: [f64; 2],
    pub(crate) levels: [Levels; 2],
    /// Coefficients of the inner, then the outer levels.
    pub(crate) coefficients: Vec<f64>,
    /// Noise variance inside and outside, grey^2.
    pub(crate) variance: [f64; 2],
    /// Blur expected before seeing this disc, px.
    pub(crate) expected_blur_px: f64,
    /// Standard deviation of the slopes before seeing this disc, grey/px.
    slope_prior: f64,
}

/// Dense normal equations, reused.
#[derive(Debug, Default)]
pub(crate) struct Normal {
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    trial: Vec<f64>,
    step: Vec<f64>,
}

impl EdgeModel {
    /// A model with constant levels; the first Gauss-Newton step finds them.
    pub(crate) fn new(ellipse: &Ellipse, blur_px: f64, inner: f64, outer: f64) -> Self {
        Self {
            ellipse: *ellipse,
            geometry: to_regular(ellipse),
            blur_px,
            slopes: [0.0; 2],
            levels: [Levels::Constant; 2],
            coefficients: vec![inner, outer],
            variance: [1.0; 2],
            expected_blur_px: blur_px,
            slope_prior: (PRIOR_SLOPE * (inner - outer).abs() / ellipse.semi_minor_px).max(1e-9),
        }
    }

    /// Mean level inside and outside, grey.
    pub(crate) fn mean_levels(&self) -> [f64; 2] {
        let n = self.levels[0].count();
        let mean = |kind: Levels, c: &[f64]| match kind {
            Levels::Spline(n) => c.iter().sum::<f64>() / n as f64,
            _ => c[0],
        };
        [mean(self.levels[0], &self.coefficients[..n]), mean(self.levels[1], &self.coefficients[n..])]
    }

    /// Inside minus outside, grey.
    pub(crate) fn step(&self) -> f64 {
        let [inner, outer] = self.mean_levels();
        inner - outer
    }

    /// Changes the level model, keeping the mean levels.
    pub(crate) fn set_levels(&mut self, levels: [Levels; 2]) {
        let mean = self.mean_levels();
        self.levels = levels;
        self.coefficients.clear();
        for side in 0..2 {
            let start = self.coefficients.len();
            let fill = if matches!(levels[side], Levels::Spline(_)) { mean[side] } else { 0.0 };
            self.coefficients.resize(start + levels[side].count(), fill);
            self.coefficients[start] = mean[side];
        }
    }

    fn size(&self) -> usize {
        FIXED + self.coefficients.len()
    }

    /// Largest sensible number of spline nodes for a contour of this length, px.
    pub(crate) fn nodes_for(perimeter_px: f64) -> usize {
        ((perimeter_px / 10.0) as usize).clamp(5, MOST_NODES)
    }

    /// One Levenberg-Marquardt descent; returns the last accepted step's largest move of the geometry, px.
    pub(crate) fn descend(
        &mut self,
        band: &mut Band,
        work: &mut Normal,
        rounds: usize,
        tolerance_px: f64,
    ) -> Option<f64> {
        let mut damping = 1e-4;
        let mut chi2 = self.evaluate(band, Some(work));
        let mut moved = f64::INFINITY;
        let mut proposed = f64::INFINITY;
        for _ in 0..rounds {
            let n = self.size();
            work.trial.clear();
            work.trial.extend_from_slice(&work.matrix[..n * n]);
            for i in 0..n {
                work.trial[i * n + i] = work.trial[i * n + i] * (1.0 + damping) + 1e-12;
            }
            work.step.clear();
            work.step.extend_from_slice(&work.gradient[..n]);
            if !solve_symmetric(&mut work.trial, &mut work.step, n) {
                return None;
            }
            let next = self.stepped(&work.step);
            let Some(next) = next else {
                damping = (damping * 10.0_f64).max(1e-2);
                if damping > 1e8 {
                    return None;
                }
                continue;
            };
            proposed = work.step[..5].iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let tried = next.evaluate(band, None);
            if tried <= chi2 * (1.0 + 1e-12) {
                *self = next;
                moved = proposed;
                damping = (damping * 0.1).max(1e-9);
                chi2 = self.evaluate(band, Some(work));
                if moved < tolerance_px {
                    return Some(moved);
                }
            } else {
                if proposed < tolerance_px {
                    self.evaluate(band, Some(work));
                    return Some(proposed);
                }
                damping = (damping * 10.0_f64).max(1e-2);
            }
        }
        self.evaluate(band, Some(work));
        Some(moved.min(proposed))
    }

    fn stepped(&self, step: &[f64]) -> Option<Self> {
        let mut next = self.clone();
        for i in 0..5 {
            next.geometry[i] += step[i];
        }
        next.ellipse = from_regular(&next.geometry)?;
        next.blur_px += step[5].clamp(-0.5 * self.blur_px, self.blur_px);
        next.slopes[0] += step[6];
        next.slopes[1] += step[7];
        for (c, s) in next.coefficients.iter_mut().zip(&step[FIXED..]) {
            *c += s;
        }
        (next.blur_px > 0.15 && next.blur_px < 30.0).then_some(next)
    }

    /// Fills residuals (and the normal equations where asked) and returns the weighted sum of squares.
    pub(crate) fn evaluate(&self, band: &mut Band, mut work: Option<&mut Normal>) -> f64 {
        let n = self.size();
        if let Some(w) = work.as_deref_mut() {
            w.matrix.clear();
            w.matrix.resize(n * n, 0.0);
            w.gradient.clear();
            w.gradient.resize(n, 0.0);
        }
        let frame = Frame::new(&self.ellipse);
        let outer_start = FIXED + self.levels[0].count();
        let mut chi2 = self.priors(work.as_deref_mut());
        for i in 0..band.u.len() {
            let foot = frame.foot(band.u[i], band.v[i]);
            let d = foot.distance;
            let z = (d + 0.5 * foot.curvature * self.blur_px * self.blur_px) / self.blur_px;
            let (p, density) = normal_tail(z);
            let (in_at, in_value, in_count) = self.levels[0].basis(band.angle[i], foot.cos, foot.sin);
            let (out_at, out_value, out_count) = self.levels[1].basis(band.angle[i], foot.cos, foot.sin);
            let mut inner = self.slopes[0] * d;
            for k in 0..in_count {
                inner += self.coefficients[in_at[k]] * in_value[k];
            }
            let mut outer = self.slopes[1] * d;
            for k in 0..out_count {
                outer += self.coefficients[outer_start - FIXED + out_at[k]] * out_value[k];
            }
            let step = inner - outer;
            let r = band.grey[i] - (outer + step * p);
            let response = step * density / self.blur_px;
            band.residual[i] = r;
            band.distance[i] = d;
            band.inside[i] = p;
            band.response[i] = response;
            if !band.keep[i] {
                continue;
            }
            let weight = 1.0 / self.variance_at(p);
            chi2 += weight * r * r;
            let Some(w) = work.as_deref_mut() else { continue };
            // Entries of this pixel's row of the Jacobian: 8 fixed ones and up to 6 levels.
            let mut at = [0usize; 14];
            let mut value = [0.0_f64; 14];
            let dd = -response + p * self.slopes[0] + (1.0 - p) * self.slopes[1];
            for k in 0..5 {
                at[k] = k;
                value[k] = dd * foot.row[k];
            }
            // dz/ds at fixed d: -d / s^2 + kappa / 2.
            at[5] = 5;
            value[5] = -step * density * (-d / (self.blur_px * self.blur_px) + 0.5 * foot.curvature);
            at[6] = 6;
            value[6] = p * d;
            at[7] = 7;
            value[7] = (1.0 - p) * d;
            let mut count = FIXED;
            if p > 1e-9 {
                for k in 0..in_count {
                    (at[count], value[count]) = (FIXED + in_at[k], p * in_value[k]);
                    count += 1;
                }
            }
            if p < 1.0 - 1e-9 {
                for k in 0..out_count {
                    (at[count], value[count]) = (outer_start + out_at[k], (1.0 - p) * out_value[k]);
                    count += 1;
                }
            }
            for a in 0..count {
                let wa = weight * value[a];
                w.gradient[at[a]] += wa * r;
                let row = &mut w.matrix[at[a] * n..(at[a] + 1) * n];
                for b in 0..count {
                    row[at[b]] += wa * value[b];
                }
            }
        }
        chi2
    }

    /// What the priors add to the weighted sum of squares (and to the normal equations).
    fn priors(&self, work: Option<&mut Normal>) -> f64 {
        let blur = ((self.expected_blur_px - self.blur_px) / PRIOR_BLUR_PX, 1.0 / PRIOR_BLUR_PX);
        let slope = |k: usize| (-self.slopes[k] / self.slope_prior, 1.0 / self.slope_prior);
        let rows = [blur, slope(0), slope(1)];
        if let Some(w) = work {
            let n = self.size();
            for (k, (r, h)) in rows.iter().enumerate() {
                w.matrix[(5 + k) * n + 5 + k] += h * h;
                w.gradient[5 + k] += h * r;
            }
        }
        rows.iter().map(|(r, _)| r * r).sum()
    }

    /// Noise variance of a pixel with share `p` of the disc, grey^2.
    #[inline]
    pub(crate) fn variance_at(&self, p: f64) -> f64 {
        self.variance[1] + (self.variance[0] - self.variance[1]) * p
    }

    /// Factor by which the unknown blur, slopes and levels widen the sigmas of the geometry (at least 1).
    pub(crate) fn nuisance_factor(&self, work: &mut Normal) -> f64 {
        let n = self.size();
        let mut sum = 0.0;
        for k in 0..5 {
            let mut full = work.matrix.clone();
            for i in 0..n {
                full[i * n + i] *= 1.0 + 1e-10;
            }
            let mut unit = vec![0.0; n];
            unit[k] = 1.0;
            if !solve_symmetric(&mut full, &mut unit, n) {
                return 1.0;
            }
            let mut fixed: Vec<f64> = (0..25).map(|i| work.matrix[(i / 5) * n + i % 5]).collect();
            let mut alone = vec![0.0; 5];
            alone[k] = 1.0;
            if !solve_symmetric(&mut fixed, &mut alone, 5) {
                return 1.0;
            }
            sum += unit[k] / alone[k];
        }
        (sum / 5.0).max(1.0).sqrt()
    }
}

impl Band {
    fn clear(&mut self) {
        self.u.clear();
        self.v.clear();
        self.grey.clear();
        self.angle.clear();
    }

    /// Collects the pixels within `reach` of the ellipse; false where the band leaves the image.
    pub(crate) fn collect(&mut self, view: &GrayView, ellipse: &Ellipse, reach: Reach) -> bool {
        self.clear();
        let frame = Frame::new(ellipse);
        // The parallel curve of an ellipse lies inside the ellipse with both axes grown by this much.
        let bulge = (frame.a + frame.b) / (2.0 * (frame.a * frame.b).sqrt());
        let (outer, inner) = (reach.outer_px * bulge, reach.inner_px * bulge);
        let (ao, bo) = (frame.a + outer, frame.b + outer);
        let (ai, bi) = (frame.a - inner, frame.b - inner);
        let half_height = (ao * frame.sin).hypot(bo * frame.cos);
        let (v_lo, v_hi) = ((frame.v0 - half_height).ceil(), (frame.v0 + half_height).floor());
        let (width, height) = (view.width() as f64, view.height() as f64);
        if v_lo < 0.0 || v_hi > height - 1.0 {
            return false;
        }
        for v in v_lo as usize..=v_hi as usize {
            let dv = v as f64 - frame.v0;
            let Some((lo, hi)) = frame.row_span(dv, ao, bo) else { continue };
            let (lo, hi) = ((frame.u0 + lo).ceil(), (frame.u0 + hi).floor());
            if hi < lo {
                continue;
            }
            if lo < 0.0 || hi > width - 1.0 {
                return false;
            }
            let hole = if ai > 0.0 && bi > 0.0 { frame.row_span(dv, ai, bi) } else { None };
            let (hole_lo, hole_hi) =
                hole.map_or((f64::INFINITY, f64::NEG_INFINITY), |(l, h)| (frame.u0 + l, frame.u0 + h));
            let mut u = lo as usize;
            while u <= hi as usize {
                let uf = u as f64;
                if uf > hole_lo && uf < hole_hi {
                    u = (hole_hi.ceil() as usize).max(u + 1);
                    continue;
                }
                let foot = frame.foot(uf, v as f64);
                if foot.distance >= -reach.inner_px && foot.distance <= reach.outer_px {
                    self.u.push(uf);
                    self.v.push(v as f64);
                    self.grey.push(f64::from(view.get(u, v)));
                    self.angle.push(foot.sin.atan2(foot.cos));
                }
                u += 1;
            }
        }
        let n = self.u.len();
        self.keep.clear();
        self.keep.resize(n, true);
        for list in [&mut self.residual, &mut self.distance, &mut self.inside, &mut self.response] {
            list.clear();
            list.resize(n, 0.0);
        }
        true
    }
}

/// An ellipse with what its pixels need, computed once.
struct Frame {
    u0: f64,
    v0: f64,
    a: f64,
    b: f64,
    cos: f64,
    sin: f64,
    cos2: f64,
    sin2: f64,
}

/// Foot point of a pixel on the ellipse.
struct Foot {
    distance: f64,
    curvature: f64,
    cos: f64,
    sin: f64,
    /// Derivative of the distance with respect to the regular coordinates.
    row: [f64; 5],
}

impl Frame {
    fn new(e: &Ellipse) -> Self {
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
    fn row_span(&self, dv: f64, a: f64, b: f64) -> Option<(f64, f64)> {
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

    /// Closest point by Newton steps on the eccentric angle, held as a unit vector: no trigonometry in the loop.
    #[inline]
    fn foot(&self, u: f64, v: f64) -> Foot {
        let (du, dv) = (u - self.u0, v - self.v0);
        let (x, y) = (self.cos * du + self.sin * dv, self.cos * dv - self.sin * du);
        let (a, b) = (self.a, self.b);
        let e2 = a * a - b * b;
        let (mut c, mut s) = (x * b, y * a);
        let norm = (c * c + s * s).sqrt();
        if norm > 0.0 {
            c /= norm;
            s /= norm;
        } else {
            (c, s) = (0.0, 1.0);
        }
        for _ in 0..3 {
            let f = e2 * c * s - x * a * s + y * b * c;
            let df = e2 * (c * c - s * s) - x * a * c - y * b * s;
            // Towards the minimum only: at the far side of the evolute the curvature of the square distance turns.
            let t = if df < 0.0 { (-f / df).clamp(-0.5, 0.5) } else { 0.0 };
            let (c1, s1) = (c - t * s, s + t * c);
            let inverse = 1.0 / (c1 * c1 + s1 * s1).sqrt();
            (c, s) = (c1 * inverse, s1 * inverse);
            if t.abs() < 1e-6 {
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

/// `(Phi(-z), phi(z))` of the normal distribution; Abramowitz and Stegun 7.1.26, error below 1.5e-7.
#[inline]
fn normal_tail(z: f64) -> (f64, f64) {
    let x = z.abs() * std::f64::consts::FRAC_1_SQRT_2;
    if x > 6.0 {
        return (if z > 0.0 { 0.0 } else { 1.0 }, 0.0);
    }
    let gauss = (-x * x).exp();
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * poly * gauss;
    let density = 0.5 * FRAC_2_SQRT_PI * std::f64::consts::FRAC_1_SQRT_2 * gauss;
    (if z > 0.0 { tail } else { 1.0 - tail }, density)
}

/// Solves `A x = b` in place for a symmetric positive definite `A` (n x n, row-major); false where it is not.
fn solve_symmetric(a: &mut [f64], b: &mut [f64], n: usize) -> bool {
    for j in 0..n {
        let mut diagonal = a[j * n + j];
        for k in 0..j {
            diagonal -= a[j * n + k] * a[j * n + k];
        }
        if !(diagonal > 0.0 && diagonal.is_finite()) {
            return false;
        }
        let root = diagonal.sqrt();
        a[j * n + j] = root;
        for i in j + 1..n {
            let (head, tail) = a.split_at_mut(i * n);
            let (row_j, row_i) = (&head[j * n..j * n + j], &tail[..j]);
            let dot: f64 = row_j.iter().zip(row_i).map(|(x, y)| x * y).sum();
            tail[j] = (tail[j] - dot) / root;
        }
    }
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| a[i * n + k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| a[k * n + i] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    true
}
