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
//! | slopes | `slopes` | 2 | grey/px | `P d`, `(1 - P) d`: radial gradient inside and outside; with splines also one per node |
//! | var_in, var_out | `variance` | 2 | grey^2 | noise on either side; in between it follows P (shot noise rises with level) |
//!
//! A small disc cannot tell its size from blur and radial gradient; weak priors hold what the data leave open (for discs of more than
//! some ten pixels the data outweigh them by orders of magnitude): blur within `PRIOR_BLUR_PX` of the value given, slopes within
//! `PRIOR_SLOPE` of the grey step per minor semi-axis, and held at zero where the image shows none (a free slope costs half of what
//! the image tells about the axes).
//!
//! Not valid where the radius of curvature is not well above the blur, or where another edge lies within the band.

use crate::conic::{Ellipse, Foot, Frame, from_regular, to_regular};
use crate::detect::band::Band;
use nalgebra::SVector;
use std::f64::consts::{FRAC_2_SQRT_PI, TAU};

/// Geometry, blur and slopes come first in the parameter vector, the levels after them.
const FIXED: usize = 8;
/// Most level coefficients on one side.
const MOST_NODES: usize = 32;

/// Standard deviation of the prior of the blur, px.
const PRIOR_BLUR_PX: f64 = 0.3;
/// Standard deviation of the prior of the slopes, grey steps per minor semi-axis.
const PRIOR_SLOPE: f64 = 0.15;

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

    #[inline]
    fn basis(self, angle: f64, c: f64, s: f64) -> Basis {
        match self {
            Levels::Constant => Basis { at: [0; 3], value: [1.0, 0.0, 0.0], count: 1 },
            Levels::Harmonic => Basis { at: [0, 1, 2], value: [1.0, c, s], count: 3 },
            Levels::Spline(n) => {
                let x = turn_share(angle) * n as f64;
                let i = (x as usize).min(n - 1);
                let f = x - i as f64;
                let value = [0.5 * (1.0 - f) * (1.0 - f), 0.5 + f * (1.0 - f), 0.5 * f * f];
                Basis {
                    at: [if i == 0 { n - 1 } else { i - 1 }, i, if i + 1 == n { 0 } else { i + 1 }],
                    value,
                    count: 3,
                }
            }
        }
    }
}

/// The basis functions of the levels that are not zero at one angle.
struct Basis {
    at: [usize; 3],
    value: [f64; 3],
    count: usize,
}

impl Basis {
    #[inline]
    fn sum(&self, coefficients: &[f64]) -> f64 {
        (0..self.count).map(|k| coefficients[self.at[k]] * self.value[k]).sum()
    }
}

/// An angle in (-pi, pi] as a share of the turn from 0 to 1.
#[inline]
pub(crate) fn turn_share(angle: f64) -> f64 {
    let share = angle / TAU;
    if share < 0.0 { share + 1.0 } else { share }
}

/// One row of the Jacobian: the fixed entries in full, of the levels and local slopes only what is not zero.
#[derive(Default)]
struct Row {
    fixed: [f64; FIXED],
    at: [usize; 12],
    value: [f64; 12],
    count: usize,
}

impl Row {
    #[inline]
    fn push_basis(&mut self, start: usize, basis: &Basis, factor: f64) {
        for k in 0..basis.count {
            self.at[self.count] = start + basis.at[k];
            self.value[self.count] = factor * basis.value[k];
            self.count += 1;
        }
    }

    /// Adds `weight row^T row` to the lower triangle and `weight row^T residual` to the gradient; the fixed block is kept apart in
    /// `block` until the end of the band, where it stays in registers and cache.
    #[inline]
    fn add_to(&self, block: &mut Block, work: &mut Normal, n: usize, weight: f64, residual: f64, edge: bool) {
        let fixed = self.fixed.map(|x| weight * x);
        let from = if edge { 0 } else { FIXED - 2 };
        for a in from..FIXED {
            block.gradient[a] += fixed[a] * residual;
            for b in 0..FIXED {
                block.matrix[a][b] += fixed[a] * self.fixed[b];
            }
        }
        for a in 0..self.count {
            let wa = weight * self.value[a];
            let start = self.at[a] * n;
            work.gradient[self.at[a]] += wa * residual;
            let row = &mut work.matrix[start..start + self.at[a] + 1];
            for (r, f) in row[..FIXED].iter_mut().zip(&self.fixed) {
                *r += wa * f;
            }
            row[self.at[a]] += wa * self.value[a];
            for b in 0..a {
                let (hi, lo) =
                    if self.at[a] > self.at[b] { (self.at[a], self.at[b]) } else { (self.at[b], self.at[a]) };
                work.matrix[hi * n + lo] += wa * self.value[b];
            }
        }
    }
}

/// Normal equations of the fixed parameters alone.
#[derive(Default)]
struct Block {
    matrix: [[f64; FIXED]; FIXED],
    gradient: [f64; FIXED],
}

impl Block {
    fn flush(&self, work: &mut Normal, n: usize) {
        for a in 0..FIXED {
            work.gradient[a] += self.gradient[a];
            for b in 0..=a {
                work.matrix[a * n + b] += self.matrix[a][b];
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
    /// Coefficients of the inner, then the outer levels, then of the slopes that go with splines (same nodes, grey/px).
    pub(crate) coefficients: Vec<f64>,
    /// Standard deviation of the slope at a spline node before seeing this disc, grey/px.
    local_slope: [f64; 2],
    /// Noise variance inside and outside, grey^2.
    pub(crate) variance: [f64; 2],
    /// Blur expected before seeing this disc, px.
    pub(crate) expected_blur_px: f64,
    /// Standard deviation of the slopes before seeing this disc, grey/px.
    slope_prior: f64,
    /// Whether the image asks for a slope inside and outside.
    pub(crate) sloped: [bool; 2],
}

/// Dense normal equations, reused.
#[derive(Debug, Default)]
pub(crate) struct Normal {
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    kept_matrix: Vec<f64>,
    kept_gradient: Vec<f64>,
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
            sloped: [false; 2],
            local_slope: [0.0; 2],
        }
    }

    /// Mean level inside and outside, grey.
    pub(crate) fn mean_levels(&self) -> [f64; 2] {
        let n = self.levels[0].count();
        let mean = |kind: Levels, c: &[f64]| match kind {
            Levels::Spline(n) => c.iter().sum::<f64>() / n as f64,
            _ => c[0],
        };
        let all = n + self.levels[1].count();
        [mean(self.levels[0], &self.coefficients[..n]), mean(self.levels[1], &self.coefficients[n..all])]
    }

    /// Inside minus outside, grey.
    pub(crate) fn step(&self) -> f64 {
        let [inner, outer] = self.mean_levels();
        inner - outer
    }

    /// Changes the level model, keeping the mean levels. Where the levels are splines, the radial slope may vary from node to node
    /// too, by about `local_slope` (grey/px): smoke has no preferred direction.
    pub(crate) fn set_levels(&mut self, levels: [Levels; 2], local_slope: [f64; 2]) {
        let mean = self.mean_levels();
        self.levels = levels;
        self.local_slope = local_slope;
        self.coefficients.clear();
        for side in 0..2 {
            let start = self.coefficients.len();
            let fill = if matches!(levels[side], Levels::Spline(_)) { mean[side] } else { 0.0 };
            self.coefficients.resize(start + levels[side].count(), fill);
            self.coefficients[start] = mean[side];
        }
        let slopes = self.slope_nodes(0) + self.slope_nodes(1);
        self.coefficients.resize(self.coefficients.len() + slopes, 0.0);
    }

    /// Whether the levels of either side vary from node to node.
    pub(crate) fn has_splines(&self) -> bool {
        self.slope_nodes(0) + self.slope_nodes(1) > 0
    }

    /// Nodes of the local slope of one side.
    fn slope_nodes(&self, side: usize) -> usize {
        if let Levels::Spline(n) = self.levels[side] { n } else { 0 }
    }

    /// Where the levels and local slopes of either side start among the coefficients.
    fn starts(&self) -> ([usize; 2], [usize; 2]) {
        let inner = self.levels[0].count();
        let levels = inner + self.levels[1].count();
        ([0, inner], [levels, levels + self.slope_nodes(0)])
    }

    fn size(&self) -> usize {
        FIXED + self.coefficients.len()
    }

    /// Largest sensible number of spline nodes for a contour of this length, px.
    pub(crate) fn nodes_for(perimeter_px: f64) -> usize {
        ((perimeter_px / 10.0) as usize).clamp(5, MOST_NODES)
    }

    /// Levenberg-Marquardt descent on every `stride`-th pixel until a step moves the geometry by less than `tolerance_px`;
    /// `None` where the normal equations are singular.
    pub(crate) fn descend(
        &mut self,
        band: &mut Band,
        work: &mut Normal,
        rounds: usize,
        stride: usize,
        tolerance_px: f64,
    ) -> Option<()> {
        let mut damping = 1e-6;
        let mut chi2 = self.evaluate(band, Some(work), stride);
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
            let proposed = work.step[..5].iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let next = self.stepped(&work.step).map(|m| {
                std::mem::swap(&mut work.matrix, &mut work.kept_matrix);
                std::mem::swap(&mut work.gradient, &mut work.kept_gradient);
                let tried = m.evaluate(band, Some(work), stride);
                (m, tried)
            });
            match next {
                Some((next, tried)) if tried <= chi2 * (1.0 + 1e-9) => {
                    *self = next;
                    chi2 = tried;
                    damping = (damping * 0.1).max(1e-9);
                }
                Some(_) => {
                    std::mem::swap(&mut work.matrix, &mut work.kept_matrix);
                    std::mem::swap(&mut work.gradient, &mut work.kept_gradient);
                    damping = (damping * 10.0_f64).max(1e-2);
                }
                None => damping = (damping * 10.0_f64).max(1e-2),
            }
            if proposed < tolerance_px {
                break;
            }
        }
        Some(())
    }

    /// Solves for the levels alone, geometry and blur held, and fills the residuals: after a change of the level model a common step
    /// would move the geometry for the sake of levels that are not there yet.
    pub(crate) fn fit_levels(&mut self, band: &mut Band, work: &mut Normal, stride: usize) {
        self.evaluate(band, Some(work), stride);
        let (n, levels) = (self.size(), self.coefficients.len());
        work.trial.clear();
        for i in 0..levels {
            let row = (FIXED + i) * n + FIXED;
            work.trial.extend_from_slice(&work.matrix[row..row + levels]);
            work.trial[i * levels + i] *= 1.0 + 1e-9;
        }
        work.step.clear();
        work.step.extend_from_slice(&work.gradient[FIXED..n]);
        if solve_symmetric(&mut work.trial, &mut work.step, levels) {
            for (c, s) in self.coefficients.iter_mut().zip(&work.step) {
                *c += s;
            }
        }
        self.evaluate(band, None, 1);
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

    /// Fills residuals of every `stride`-th pixel (and the normal equations where asked, lower triangle); returns the weighted sum of
    /// squares.
    pub(crate) fn evaluate(&self, band: &mut Band, mut work: Option<&mut Normal>, stride: usize) -> f64 {
        let n = self.size();
        if let Some(w) = work.as_deref_mut() {
            w.matrix.clear();
            w.matrix.resize(n * n, 0.0);
            w.gradient.clear();
            w.gradient.resize(n, 0.0);
        }
        let frame = Frame::new(&self.ellipse);
        let mut chi2 = self.priors(work.as_deref_mut());
        let (level_at, slope_at) = self.starts();
        let local = [self.slope_nodes(0) > 0, self.slope_nodes(1) > 0];
        let inverse_blur = 1.0 / self.blur_px;
        let mut block = Block::default();
        for i in (0..band.u.len()).step_by(stride) {
            let mut foot = Foot { distance: band.distance[i], ..Foot::default() };
            let (mut p, mut density) = (if foot.distance < 0.0 { 1.0 } else { 0.0 }, 0.0);
            if !band.far[i] {
                foot = frame.foot(band.u[i], band.v[i], Some((band.foot_cos[i], band.foot_sin[i])));
                (band.foot_cos[i], band.foot_sin[i]) = (foot.cos, foot.sin);
                let z = foot.distance * inverse_blur + 0.5 * foot.curvature * self.blur_px;
                (p, density) = normal_tail(z);
            }
            let d = foot.distance;
            let basis = [0, 1].map(|side| self.levels[side].basis(band.angle[i], band.cos[i], band.sin[i]));
            let mut level = [0.0; 2];
            let mut slope = self.slopes;
            for side in 0..2 {
                if local[side] {
                    slope[side] += basis[side].sum(&self.coefficients[slope_at[side]..]);
                }
                level[side] = basis[side].sum(&self.coefficients[level_at[side]..]) + slope[side] * d;
            }
            let (outer, step) = (level[1], level[0] - level[1]);
            let r = band.grey[i] - (outer + step * p);
            let response = step * density * inverse_blur;
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
            let mut row = Row::default();
            let edge = density > 1e-8;
            if edge {
                let dd = -response + p * slope[0] + (1.0 - p) * slope[1];
                for k in 0..5 {
                    row.fixed[k] = dd * foot.row[k];
                }
                row.fixed[5] = -step * density * (0.5 * foot.curvature - d * inverse_blur * inverse_blur);
            }
            for (side, share) in [p, 1.0 - p].into_iter().enumerate() {
                if share > 1e-8 {
                    row.fixed[6 + side] = share * d;
                    row.push_basis(FIXED + level_at[side], &basis[side], share);
                    if local[side] {
                        row.push_basis(FIXED + slope_at[side], &basis[side], share * d);
                    }
                }
            }
            row.add_to(&mut block, w, n, weight, r, edge);
        }
        if let Some(w) = work {
            block.flush(w, n);
        }
        chi2
    }

    /// What the priors add to the weighted sum of squares (and to the normal equations).
    fn priors(&self, work: Option<&mut Normal>) -> f64 {
        let blur = ((self.expected_blur_px - self.blur_px) / PRIOR_BLUR_PX, 1.0 / PRIOR_BLUR_PX);
        let slope = |k: usize| {
            let sigma = if self.sloped[k] { self.slope_prior } else { 1e-4 * self.slope_prior };
            (-self.slopes[k] / sigma, 1.0 / sigma)
        };
        let rows = [blur, slope(0), slope(1)];
        let (level_at, slope_at) = self.starts();
        let (mut local, mut work) = (0.0, work);
        for side in 0..2 {
            let nodes = self.slope_nodes(side);
            let weight = self.local_slope[side].max(1e-9).powi(-2);
            for k in slope_at[side]..slope_at[side] + nodes {
                local += self.add_prior(work.as_deref_mut(), &[(k, 1.0)], weight);
            }
            // Neighbouring levels differ by less than the step of the edge: this fills stretches that are hidden.
            let weight = self.step().abs().max(1e-9).powi(-2);
            for k in 0..nodes {
                let next = if k + 1 == nodes { 0 } else { k + 1 };
                let pair = [(level_at[side] + k, 1.0), (level_at[side] + next, -1.0)];
                local += self.add_prior(work.as_deref_mut(), &pair, weight);
            }
        }
        if let Some(w) = work {
            let n = self.size();
            for (k, (r, h)) in rows.iter().enumerate() {
                w.matrix[(5 + k) * n + 5 + k] += h * h;
                w.gradient[5 + k] += h * r;
            }
        }
        rows.iter().map(|(r, _)| r * r).sum::<f64>() + local
    }

    /// A prior of zero, with its weight, on a combination of coefficients; returns its part of the weighted sum of squares.
    fn add_prior(&self, work: Option<&mut Normal>, terms: &[(usize, f64)], weight: f64) -> f64 {
        let value: f64 = terms.iter().map(|(k, x)| x * self.coefficients[*k]).sum();
        if let Some(w) = work {
            let n = self.size();
            for (i, x) in terms {
                w.gradient[FIXED + i] -= weight * x * value;
                for (j, y) in terms.iter().filter(|(j, _)| j <= i) {
                    w.matrix[(FIXED + i) * n + FIXED + j] += weight * x * y;
                }
            }
        }
        weight * value * value
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
