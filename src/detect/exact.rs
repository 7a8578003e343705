//! The last word on one disc: geometry, blur and light fitted to every pixel by itself.
//!
//! What [`crate::detect::edge_model`] finds from sums over sectors is made exact here: each pixel has its own foot point, profile
//! ([`crate::detect::profile`]) and light ([`crate::detect::surface`]). Gauss-Newton in geometry and blur, exact in the light.
//!
//! Smoke is a random field: waves on a lattice of wave vectors `k` in units of the semi-axes, whose heights are
//! unknowns with a prior, variance of a height `~ amp^2 S(k l) exp(-s^2 k^2)`, of smooth light, `S = (1 + (k l)^2 / 6)^(-3)`, of turbulence cut by a
//! sheet, `S = (1 + (k l)^2)^(-4/3)`, or of waves that end with a shortest one, `S = exp(-(k l)^8) / (1 + (8 k l)^2)`; the last factor
//! is what the blur s takes. Spectrum, amplitude and length are those with the largest restricted likelihood of the image,
//!
//! ```text
//! -2 ln L = chi^2 + ln det(J^T W J + Lambda^-1) + ln det Lambda + sum ln variance - sum ln W
//! ```
//!
//! with all unknowns, geometry and blur among them, integrated out; the result is the mean over all of them, each with its
//! likelihood as weight: so the sigmas say what not knowing the smoke, nor of which kind it is, costs. Of small discs light that is
//! at most slanted is one of them, with a tenth of the weight, and no smoke fainter than 3 %, where it is known that there is smoke; in large ones there
//! is no smoke where such light says as much under louder noise. An amplitude is hardly ever more than
//! half the step (`N(0, 1/2)`), for light is nowhere negative. Noise inside is what is left over the degrees of freedom that the waves did not
//! spend, for light carries shot noise that the ground does not show. Of small discs these are few: then the mean is over the noise as
//! well, which may be four times louder where there is more light (`ln (variance / outside) ~ N(0, ln 4)`), but hardly quieter (`ln 1.3`).
//! A small bright disc is asked for smoke, which shines, where its inside is louder or less even than its ground, where its light rises and the ground does
//! not, or where more is left than noise: weak slow smoke shows no more than a slope, and its bend would draw the contour. Behind a blur any smoke may look so: a few fields are
//! asked then whether they say more (`asked.rs`). What light and edge do to each other in second order is taken off (`second.rs`).
//! Of large discs ([`is_large`]) a field is asked for where light along the contour changes slowly, and must leave no more than noise; nodes along
//! the contour ([`crate::detect::light`]) follow what is faster.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | amp, l | `Field::amplitude`, `Field::length` | 1 | grey, semi-axes | prior of the smoke |
//! | k | `Field::waves` | n | 1 | wave vectors |
//! | J^T W J | `gram` | n x n | | products of all columns, the grey values last |

mod area;
mod asked;
mod field;
mod hidden;
mod left;
mod louder;
mod products;
mod second;
mod small;
#[cfg(test)]
mod tests;
mod told;
mod waves;
pub(crate) use asked::Answer;
pub(crate) use field::Field;
pub(crate) use left::Share;

use crate::conic::{Ellipse, Frame, OnContour, from_regular, to_regular};
use crate::detect::band::{Band, LANES, Reach};
use crate::detect::contour::Contour;
use crate::detect::correlation::Allowance;
use crate::detect::dense::{Dense, FIXED};
use crate::detect::edge_model::{LEAST_BLUR_PX, blur_weight};
use crate::detect::light::Side;
use crate::detect::profile::{Lanes, Profile, Profiled};
use crate::detect::refine::{Start, reach_px};
use crate::detect::rim::Rim;
use crate::detect::shape::Shape;
use crate::detect::shared_light::in_axes;
use crate::detect::surface::{At, on_contour};
use crate::image::GrayView;
use crate::lanes;
use area::Area;
use field::{MOST_LOUD, Verdict};
pub(crate) use hidden::Hidden;
use left::Within;
use nalgebra::{SMatrix, SVector};
use products::{CHUNK, Products};
use waves::{Each, Heights, Turns, Waves};

/// Pixels that are looked at or passed over together.
const SLICE: usize = 64;
/// Rounds at most.
const MOST_ROUNDS: usize = 8;
/// Longest contour around which a field is fitted whatever the light, px: short waves in large discs are too many, and nodes along the contour do as
/// well there.
const MOST_CONTOUR_PX: f64 = 130.0;
/// Product of curvature and blur above which the local profile no longer holds.
const SMALL: f64 = 0.33;
/// How much `chi^2` must fall for a slope of the light: its two coefficients, 3.5 standard deviations, and 4 for having looked.
pub(crate) const SLOPE: f64 = 13.0;

/// State of the fit of one disc.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub(crate) ellipse: Ellipse,
    pub(crate) blur_px: f64,
    pub(crate) expected_blur_px: f64,
    pub(crate) shape: Shape,
    pub(crate) sides: [Side; 2],
    pub(crate) field: Option<Field>,
    /// Gradients of the light inside and outside that other discs tell, grey/px along u and v; coefficients are beyond them.
    pub(crate) slopes: [[f64; 2]; 2],
    /// Noise variance inside and outside, grey^2.
    pub(crate) variance: [f64; 2],
    /// Inside minus outside, grey.
    pub(crate) step: f64,
    /// Whether it is a small disc known to be full of smoke.
    pub(crate) full_of_smoke: bool,
    /// What the noise of neighbours has in common.
    pub(crate) allow: Allowance,
}

impl State {
    /// Whether the disc is so small against its blur that only the integrals along the contour hold.
    fn exact_rim(&self) -> bool {
        on_rim(&self.ellipse, self.blur_px)
    }

    /// Number of heights of waves, a cosine and a sine each.
    fn heights(&self) -> usize {
        self.field.as_ref().map_or(0, |f| 2 * f.waves.len())
    }
}

/// Buffers reused from disc to disc, and the result.
#[derive(Debug, Default)]
pub(crate) struct Exact {
    band: Band,
    rim: Rim,
    count: usize,
    columns: Vec<f64>,
    turns: Turns,
    area: Area,
    /// The slopes expected, in the axes of the ellipse.
    expected: [[f64; 2]; 2],
    /// Step of the light at each pixel, or at each node of the rim, while the light is not known; empty otherwise.
    held: Vec<f64>,
    /// Derivative of the grey value by the distance from the edge, and share of the disc, of each pixel.
    response: Vec<f64>,
    inside: Vec<f64>,
    /// Of the chunks, one in so many is looked at.
    thinned: usize,
    /// Added to the right side of blur and geometry, see `second.rs`.
    tilt: SVector<f64, FIXED>,
    /// What the unknowns follow of the grey value of each of `LANES` pixels.
    followed: Vec<Each>,
    gram: Vec<f64>,
    dense: Dense,
    /// Coefficients of the light and change of the fixed unknowns.
    found: Vec<f64>,
    /// Heights of the waves and coefficients of the sides as last solved; empty before.
    light: Vec<f64>,
    pub(crate) shares: Vec<Share>,
    /// Residual of each pixel over the noise.
    left: Vec<f64>,
    hidden: Hidden,
    /// How much of each pixel counts; empty where nothing is hidden.
    counted: Vec<f64>,
    /// Sums of residuals far from the edge: squares and number of either side.
    away: [[f64; 2]; 2],
    within: Within,
    /// What all fields together say, where there is one.
    verdict: Option<Verdict>,
    /// Products of neighbouring residuals inside and their number.
    neighbours: [f64; 2],
    chi2: f64,
}

impl Exact {
    /// Covariance of the regular coordinates.
    pub(crate) fn covariance(&self) -> SMatrix<f64, 5, 5> {
        self.verdict.map_or(self.dense.covariance, |v| v.covariance)
    }

    /// How unlikely the image is with the disc and the smoke that were found; for two fits of one image.
    pub(crate) fn unlikely(&self) -> f64 {
        self.verdict.map_or(f64::INFINITY, |v| v.value)
    }

    /// Number of unknowns of the light.
    fn lights(state: &State) -> usize {
        state.heights() + state.sides.iter().map(Side::count).sum::<usize>()
    }

    fn look(&mut self, view: &GrayView, state: &State, contour: &Contour, keep: &[bool], reach: Reach) -> bool {
        self.band.collect(view, &state.ellipse, contour, reach);
        // The same whichever sectors count and whatever is hidden: residuals of pixels that a fit left out are those of its light.
        let ground = self.band.grey.first().copied().unwrap_or(0.0);
        self.leave_out_hidden(state);
        self.count = self.band.compact(keep);
        self.count_parts(state);
        self.band.grey.iter_mut().for_each(|g| *g -= ground);
        self.count > 2 * FIXED
    }

    /// Columns of `LANES` pixels from place `i` on, each times the root of its weight, into `at` of the chunk.
    fn fill(&mut self, state: &State, frame: &Frame, i: usize, at: usize) {
        let lanes = self.profile(state, i);
        let shown = LANES.min(self.count.saturating_sub(i));
        if state.exact_rim() {
            if shown > 0 {
                self.fill_from_rim(state, frame, &lanes, (i, shown), at);
            }
        } else if shown > 0 {
            self.fill_from_profile(state, frame, &lanes, (i, shown), at);
        }
        if shown < LANES {
            (0..=Self::lights(state) + FIXED)
                .for_each(|j| self.columns[at + j * CHUNK + shown..at + j * CHUNK + LANES].fill(0.0));
        }
    }

    /// The local profile at `LANES` pixels from place `i` on.
    fn profile(&self, state: &State, i: usize) -> Lanes<LANES> {
        let (a, b) = (state.ellipse.semi_major_px, state.ellipse.semi_minor_px);
        let Band { distance, cos, sin, .. } = &self.band;
        let profile = Profile { blur_px: state.blur_px, shape: state.shape, a, b };
        lanes::run(Profiled { profile, distance: eight(distance, i), cos: eight(cos, i), sin: eight(sin, i) })
    }

    fn weight(state: &State, inside: f64) -> f64 {
        1.0 / (state.variance[0] * inside + state.variance[1] * (1.0 - inside))
    }

    /// Difference of the light of the two sides on the contour, of the polynomials alone.
    fn step_at(&self, state: &State, c: f64, s: f64) -> f64 {
        let [inside, outside] = self.expected.map(|[x, y]| x * c + y * s);
        if self.light.is_empty() {
            return state.step + inside - outside;
        }
        polynomial_step(state, c, s, |j| self.light[j]) + inside - outside
    }

    /// The columns of the polynomials of both sides, from column `j` on; returns what is expected of their slopes, grey.
    fn fill_polynomials(&mut self, state: &State, pixel: &At, root: f64, at: usize, mut j: usize) -> f64 {
        let (blurred, bare) = (pixel.polynomials(), pixel.bare());
        for (side, polynomial) in state.sides.iter().enumerate() {
            for m in 0..polynomial.count() {
                let value = if side == 0 { blurred[m] } else { bare[m] - blurred[m] };
                self.columns[at + j * CHUNK] = root * value;
                j += 1;
            }
        }
        let [inside, outside] = self.expected;
        (0..2).map(|i| inside[i] * blurred[2 + i] + outside[i] * (bare[2 + i] - blurred[2 + i])).sum()
    }

    /// Those of `shown` pixels from place `i` on.
    fn fill_from_profile(
        &mut self,
        state: &State,
        frame: &Frame,
        lanes: &Lanes<LANES>,
        (i, shown): (usize, usize),
        at: usize,
    ) {
        let (feet, pixels) = self.feet_and_pixels(state, frame, lanes, (i, shown));
        let root = self.roots(state, i, pixels.map(|pixel| pixel.inside));
        let of_waves = self.fill_waves(state, &pixels, &root, at);
        let (waves, j) = (state.heights(), Self::lights(state));
        for l in 0..shown {
            let (p, at) = (i + l, at + l);
            let (root, slope) = (root[l], pixels[l].slope);
            let held = if self.light.is_empty() { self.held.get(p).copied() } else { None };
            let on_edge = held.unwrap_or_else(|| self.step_at(state, self.band.cos[p], self.band.sin[p]));
            let response = on_edge * slope + of_waves[l];
            let expected = self.fill_polynomials(state, &pixels[l], root, at, waves);
            let step = if slope.abs() > 1e-9 { response / slope } else { state.step };
            self.columns[at + j * CHUNK] = root * step * lanes.by_blur[l];
            for (m, row) in feet[l].row.iter().enumerate() {
                self.columns[at + (j + 1 + m) * CHUNK] = root * response * row;
            }
            self.columns[at + (j + FIXED) * CHUNK] = root * (self.band.grey[p] - expected);
            self.response[p] = root * response;
            self.inside[p] = pixels[l].inside;
        }
    }

    /// Foot points and pixels of `LANES` places from `i` on; those behind the last of the `shown` pixels repeat it: nothing comes of them.
    fn feet_and_pixels(
        &self,
        state: &State,
        frame: &Frame,
        lanes: &Lanes<LANES>,
        (i, shown): (usize, usize),
    ) -> ([OnContour; LANES], [At; LANES]) {
        let place = |l: usize| l.min(shown - 1);
        let foot = |l: usize| frame.on_contour(self.band.cos[i + place(l)], self.band.sin[i + place(l)]);
        let feet: [OnContour; LANES] = std::array::from_fn(foot);
        let pixels = std::array::from_fn(|l| self.pixel(state, lanes, &feet[l], (i + place(l), place(l))));
        (feet, pixels)
    }

    /// The columns of the waves, if any; returns the derivative of their light by the distance.
    fn fill_waves(&mut self, state: &State, pixels: &[At; LANES], root: &[f64; LANES], at: usize) -> [f64; LANES] {
        let Some(field) = &state.field else { return [0.0; LANES] };
        let (heights, columns, turns) = (Heights::Common(&self.light), &mut self.columns[at..], &mut self.turns);
        lanes::run(Waves { field, pixels, root, heights, columns, turns })
    }

    /// The pixel at place `p`, whose profile is that of lane `l`, as the columns of light need it.
    fn pixel(&self, state: &State, lanes: &Lanes<LANES>, foot: &OnContour, (p, l): (usize, usize)) -> At {
        let (a, b) = (state.ellipse.semi_major_px, state.ellipse.semi_minor_px);
        let (normal, slope, curvature) = (foot.climb, lanes.slope[l], self.band.curvature[p]);
        let tangent = [-normal[1] * b / a, normal[0] * a / b];
        let (across, along) = (-slope * lanes.depth[l] / state.blur_px, curvature * slope);
        let bend = |i: usize, j: usize| across * normal[i] * normal[j] + along * tangent[i] * tangent[j];
        At {
            place: [self.band.x[p] / a, self.band.y[p] / b],
            normal,
            tangent,
            blur_px: state.blur_px,
            curvature,
            inside: lanes.inside[l],
            gradient: normal.map(|n| n * slope),
            bend: [bend(0, 0), bend(0, 1), bend(1, 1)],
            slope,
            depth: lanes.depth[l],
            density: lanes.density[l],
            distance: self.band.distance[p],
            narrow: lanes.narrow[l],
        }
    }

    /// Sets up what all pixels share.
    fn prepare(&mut self, state: &State, frame: &Frame) {
        self.expected = in_axes(frame, state.slopes);
        let n = Self::lights(state) + FIXED + 1;
        if self.columns.len() < n * CHUNK {
            self.columns.resize(n * CHUNK, 0.0);
        }
        for list in [&mut self.response, &mut self.inside] {
            list.clear();
            list.resize(self.band.len(), 0.0);
        }
        if state.exact_rim() {
            self.prepare_rim(state, frame);
        }
    }

    /// Products of all columns.
    fn sum_up(&mut self, state: &State) {
        let n = Self::lights(state) + FIXED + 1;
        let frame = Frame::new(&state.ellipse);
        self.gram.clear();
        self.gram.resize(n * n, 0.0);
        self.prepare(state, &frame);
        let (total, thinned) = (self.band.len(), self.thinned.max(1));
        let mut used = 0;
        for start in (0..total).step_by(SLICE * thinned) {
            let end = (start + SLICE).min(total);
            for i in (start..end).step_by(LANES) {
                self.fill(state, &frame, i, used);
                used += LANES;
            }
            if used + SLICE > CHUNK || start + SLICE * thinned >= total {
                lanes::run(Products { columns: &self.columns, used, n, gram: &mut self.gram });
                used = 0;
            }
        }
    }

    /// Solves with the prior of the field and the blur; returns minus twice the logarithm of the likelihood, without its constant.
    fn solve(&mut self, state: &State) -> Option<f64> {
        let lights = Self::lights(state);
        let (n, m) = (lights + FIXED, lights + FIXED + 1);
        self.dense.clear(n);
        for i in 0..n {
            self.dense.matrix[i * n..=i * n + i].copy_from_slice(&self.gram[i * m..=i * m + i]);
            self.dense.right[i] = self.gram[n * m + i];
        }
        let mut at = 0;
        let mut log_prior = 0.0;
        if let Some(field) = &state.field {
            for v in &field.variances {
                let variance = v * field.amplitude * field.amplitude;
                for _ in 0..2 {
                    self.dense.matrix[at * n + at] += 1.0 / variance;
                    log_prior += variance.ln();
                    at += 1;
                }
            }
        }
        for side in &state.sides {
            for sigma in side.prior_sigmas().into_iter().take(side.count()) {
                self.dense.matrix[at * n + at] += sigma.powi(-2);
                at += 1;
            }
        }
        let weight = blur_weight(state.expected_blur_px);
        self.dense.matrix[at * n + at] += weight;
        self.dense.right[at] += weight * (state.expected_blur_px - state.blur_px);
        for (i, t) in self.tilt.iter().enumerate() {
            self.dense.right[lights + i] += t;
        }
        if !self.dense.solve(n) {
            return None;
        }
        self.found.clear();
        self.found.extend_from_slice(&self.dense.right);
        let explained: f64 = (0..n).map(|i| self.found[i] * self.gram[n * m + i]).sum();
        self.chi2 = self.gram[n * m + n] - explained;
        let log_det: f64 = (0..n).map(|i| 2.0 * self.dense.matrix[i * n + i].ln()).sum();
        Some(self.chi2 + log_det + log_prior)
    }

    /// How far from the edge the fit looks.
    fn reach(state: &State, start: &Start) -> Reach {
        let (wanted, b) = (reach_px(state.blur_px), state.ellipse.semi_minor_px);
        let inner = wanted.min(start.inner_px).min(0.85 * b);
        let whole = state.field.is_some() || state.exact_rim() && start.inner_px > 0.89 * b;
        Reach { inner_px: if whole { 2.0 * state.ellipse.semi_major_px } else { inner }, outer_px: wanted }
    }

    /// Forgets the pixels that were hidden on the disc before.
    pub(crate) fn uncovered(&mut self) {
        self.hidden.clear();
    }

    /// The pixels that are left out.
    pub(crate) fn hidden(&self) -> &Hidden {
        &self.hidden
    }

    /// Leaves these pixels out from now on.
    pub(crate) fn hide(&mut self, hidden: Hidden) {
        self.hidden = hidden;
    }

    /// Fits with noise and light as the image asks: the poorest polynomials that explain it, or a field where `state` asks for one.
    /// Returns the sectors that counted, of the contour as it was cut last.
    pub(crate) fn settle(
        &mut self,
        view: &GrayView,
        state: &mut State,
        contour: &mut Contour,
        keep: &[bool],
        start: &Start,
        floor: f64,
    ) -> Option<Vec<bool>> {
        let reach = |state: &State| Self::reach(state, start);
        let cut = |contour: &mut Contour, e: &Ellipse| contour.cut(e, start.neighbours);
        self.verdict = None;
        let mut kept = self.fit(view, state, contour, keep, &reach, &cut)?;
        for _ in 0..4 {
            let before = (state.variance, state.sides);
            if state.field.is_none() {
                self.judge_slopes(state);
            }
            let found = self.noise_of_sides(state, start).map(|x| x.max(floor));
            let alike = |side: usize| (0.8..1.25).contains(&(found[side] / before.0[side]));
            let richer = (0..2).any(|i| state.sides[i].degree != before.1[i].degree);
            if state.field.is_some() {
                let factor = self.noise_in_field(state);
                if (0.85..1.18).contains(&factor) {
                    break;
                }
                state.variance[0] = (factor * state.variance[0]).min(field::loudest_noise(state)).max(floor);
                kept = self.fit(view, state, contour, keep, &reach, &cut)?;
                continue;
            }
            if !richer && alike(0) && alike(1) {
                break;
            }
            state.variance = found;
            kept = self.fit(view, state, contour, keep, &reach, &cut)?;
        }
        self.verdict = self.weigh_fields(state);
        Some(kept)
    }

    /// Gives either side a slope or takes it away, as the pixels ask. Light that rises outside rises inside as well.
    fn judge_slopes(&mut self, state: &mut State) {
        let (dense, found, light) = (self.dense.clone(), self.found.clone(), self.light.clone());
        let free: [bool; 2] = [0, 1].map(|i| state.sides[i].degree < 2);
        let mut chi2 = |degrees: [usize; 2]| {
            let mut tried = state.clone();
            for i in 0..2 {
                if free[i] {
                    tried.sides[i] = Side { degree: degrees[i], ..tried.sides[i] };
                }
            }
            self.light.clear();
            self.sum_up(&tried);
            self.solve(&tried).map_or(f64::INFINITY, |_| self.chi2)
        };
        let (plain, inside, outside, both) = (chi2([0, 0]), chi2([1, 0]), chi2([0, 1]), chi2([1, 1]));
        (self.dense, self.found, self.light) = (dense, found, light);
        let rises = [plain - inside, plain - outside].map(|x| x > SLOPE);
        let rises = [rises[0] || outside - both > SLOPE, rises[1] || inside - both > SLOPE];
        for i in (0..2).filter(|i| free[*i]) {
            state.sides[i].degree = usize::from(rises[i] || rises[1]);
        }
    }

    /// Fits until the geometry stands still. `keep` says which sectors of the contour count; the contour is cut anew each round.
    pub(crate) fn fit(
        &mut self,
        view: &GrayView,
        state: &mut State,
        contour: &mut Contour,
        keep: &[bool],
        reach: &dyn Fn(&State) -> Reach,
        cut: &dyn Fn(&mut Contour, &Ellipse),
    ) -> Option<Vec<bool>> {
        self.light.clear();
        let mut kept;
        let (mut round, mut chosen) = (0, 0);
        let afresh = state.field.as_ref().is_some_and(|f| f.waves.is_empty());
        self.held.clear();
        self.tilt = SVector::zeros();
        loop {
            cut(contour, &state.ellipse);
            let count = contour.len();
            kept = (0..count)
                .map(|k| keep[((2 * k + 1) * keep.len() / (2 * count)).min(keep.len() - 1)])
                .collect::<Vec<_>>();
            if !self.look(view, state, contour, &kept, reach(state)) {
                return None;
            }
            if round == 0 && state.field.is_some() {
                chosen = 1;
                // Far from the contour louder noise would explain most.
                self.choose_field(state, afresh, 0);
            }
            self.sum_up(state);
            self.solve(state)?;
            let lights = Self::lights(state);
            let change = &self.found[lights..];
            let largest = change.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let first = self.light.is_empty();
            self.light = self.found[..lights].to_vec();
            round += 1;
            if !first && (largest < 0.01 || round >= MOST_ROUNDS) {
                if state.field.is_none() || chosen == 3 {
                    break;
                }
                if chosen == 2 {
                    chosen = 3;
                    round = round.min(MOST_ROUNDS - 3);
                    self.tilt = self.second_order(state)?;
                    continue;
                }
                // The prior was chosen where the contour was first thought to be.
                chosen = 2;
                round = round.min(MOST_ROUNDS - 3);
                self.hold_steps(state);
                self.choose_field(state, afresh, MOST_LOUD);
                self.sum_up(state);
                self.solve(state)?;
                self.held.clear();
                let lights = Self::lights(state);
                self.light = self.found[..lights].to_vec();
                continue;
            }
            let limit = (0.5 * state.blur_px + 0.2) / largest.max(1e-12);
            let factor = limit.min(1.0);
            let mut q = to_regular(&state.ellipse);
            (0..5).for_each(|i| q[i] += factor * change[1 + i]);
            state.ellipse = from_regular(&q)?;
            state.blur_px = (state.blur_px + factor * change[0]).max(LEAST_BLUR_PX);
        }
        self.shares(state, contour.len());
        Some(kept)
    }

    /// The last change, applied.
    pub(crate) fn finished(&self, state: &State) -> Option<(Ellipse, SVector<f64, 5>, f64)> {
        let lights = Self::lights(state);
        let mut q = to_regular(&state.ellipse);
        let change = match &self.verdict {
            Some(v) => v.change,
            None => SVector::<f64, FIXED>::from_fn(|i, _| self.found[lights + i]),
        };
        let moved = change.fixed_rows::<5>(1).into_owned();
        q += moved;
        Some((from_regular(&q)?, moved, state.blur_px + change[0]))
    }
}

/// Whether a disc is so small against its blur that only integrals along the contour hold.
pub(crate) fn on_rim(e: &Ellipse, blur_px: f64) -> bool {
    blur_px * e.semi_major_px > SMALL * e.semi_minor_px * e.semi_minor_px
}

/// Whether a disc is fitted with a field only where the light changes slowly.
pub(crate) fn is_large(e: &Ellipse) -> bool {
    e.is_longer_than(MOST_CONTOUR_PX)
}

/// Difference of the polynomials of the two sides on the contour, at an eccentric angle, with coefficients `of` the unknowns of the light.
fn polynomial_step(state: &State, c: f64, s: f64, of: impl Fn(usize) -> f64) -> f64 {
    let first = state.heights();
    let [inner, outer] = [0, 1].map(|i| state.sides[i].count());
    let edge = on_contour(c, s);
    let sum = |from: usize, count: usize| (0..count).map(|m| of(from + m) * edge[m]).sum::<f64>();
    sum(first, inner) - sum(first + inner, outer)
}

/// `LANES` numbers of a list from place `i` on.
#[inline(always)]
fn eight(list: &[f64], i: usize) -> [f64; LANES] {
    std::array::from_fn(|l| list[i + l])
}
