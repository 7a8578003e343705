//! A clean disc, fast: the model of [`crate::detect::exact`] with level and slope of the light on either side, nothing hidden, nothing beside it.
//! On large discs the light may bend: what the pixels away from the edge show of second degree is fitted with the rest, of the whole disc where all of
//! it shows the same (`bent`).
//!
//! Pixels near the edge are worked on sixteen at a time; those further away see one side only, and rows of them
//! are summed up as they are. One set of sums serves every question about the light: a slope that is not asked for is held at what other discs tell
//! ([`crate::detect::shared_light`]).
//! The first round, whose result is only a better start, takes every second to fourth row; where noise hardly moves the line that was followed, what it
//! tells of the contour (`start`) is start enough, and one round does.
//! The fit ends in questions about what is left: sectors that disagree, rows whose mean is off, residuals beyond the noise. Any yes, and
//! the disc goes the longer way through [`crate::detect::sectors`], so that what is lost here is time only.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | J^T W J | `Columns::gram` | 19 x 19 | | products of the columns `1, X, Y` inside, `1, X, Y` outside, blur, geometry, grey value less the model, then `X^2 + Y^2 - 1, X^2 - Y^2, 2 X Y` inside, outside |
//! | x | `found` | 19 | grey, px | change of light, blur and geometry, each at the place of its column |
//! | l | `light` | 12 | grey | level and slopes inside, outside, second degree inside, outside: what the model says now |
//! | - | `Run`, `Sums` | | | pixels that see one side: sums of `1, u, v`, the grey value and their products |

mod bent;
mod columns;
mod few;
mod pixels;
mod shares;
mod start;
mod told;
mod whole;

use crate::conic::{Ellipse, Frame, from_regular, to_regular};
use crate::detect::contour::Contour;
use crate::detect::correlation::Allowance;
use crate::detect::dense::{Dense, FIXED};
use crate::detect::edge_model::{LEAST_BLUR_PX, blur_weight};
use crate::detect::exact::{SLOPE, Share, on_rim};
use crate::detect::light::Side;
use crate::detect::refine::{border_px, reach_px};
use crate::detect::shape::Shape;
use crate::detect::shared_light::in_axes;
use crate::detect::shot_noise::ShotNoise;
use crate::image::GrayView;
use crate::lanes;
use bent::Bent;
use columns::{Columns, Lens, SumUp};
use few::{Few, KEPT, ORDER, SLOPES};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3, Vector6};
use pixels::{Beyond, Collect, Pixels, Rings, near_px};
use shares::ShareOut;
pub(crate) use start::contour_of;

/// Unknowns of the light.
const LIGHTS: usize = 6;
/// Unknowns.
const N: usize = LIGHTS + FIXED;
/// Columns: the unknowns and the grey value.
const M: usize = N + 1;
/// Unknowns of light that bends; their columns come last.
const BENDS: usize = 6;
/// All columns.
const ALL: usize = M + BENDS;
/// Products of two columns, of light that does not bend and of all.
const PLAIN: usize = M * (M + 1) / 2;
const PRODUCTS: usize = ALL * (ALL + 1) / 2;
/// Place of the blur in the equations.
const BLUR: usize = 2;
/// Rounds at most.
const MOST_ROUNDS: usize = 6;
/// A change below this ends the rounds, px.
const STILL_PX: f64 = 0.03;
/// The same of a short contour, px and of the blur: what is left of it is of third order, and little beside the noise of so few pixels.
const STILL_SHORT_PX: f64 = 0.05;
const STILL_SHORT: f64 = 0.06;
/// The same of a slope of the light across the disc, of its step: as much of a change of the geometry is wrong.
const STILL_LIGHT: f64 = 0.03;
/// How much further off light that bends is looked at outside, semi-minor axes; inside all of it is.
const BEYOND: f64 = 0.5;
/// Pixels near the edge that suffice for a start.
const START_PIXELS: f64 = 190.0;
/// Every so many rows at most are taken for a start.
const THINNEST: f64 = 4.0;

/// State of the fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clean {
    pub(crate) ellipse: Ellipse,
    pub(crate) blur_px: f64,
    pub(crate) expected_blur_px: f64,
    pub(crate) shape: Shape,
    pub(crate) step: f64,
    /// Gradients of the light inside and outside that other discs tell, grey/px along u and v.
    pub(crate) slopes: [[f64; 2]; 2],
    /// Whether ellipse and blur may be so near that one round does.
    pub(crate) near: bool,
    /// Noise variance inside and outside, grey^2.
    pub(crate) variance: [f64; 2],
    /// What the noise of neighbours has in common.
    pub(crate) allow: Allowance,
    /// What all discs tell of the noise inside.
    pub(crate) shot_noise: Option<ShotNoise>,
}

impl Clean {
    /// The light as other discs tell it, given the frame of the ellipse, in units of the semi-axes; levels and second degree are no one's but its own.
    fn expected_light(&self, frame: &Frame) -> [f64; LIGHTS + BENDS] {
        let mut light = [0.0; LIGHTS + BENDS];
        for (side, slopes) in in_axes(frame, self.slopes).into_iter().enumerate() {
            light[3 * side + 1..3 * side + 3].copy_from_slice(&slopes);
        }
        light
    }
}

/// Buffers reused from disc to disc, and the result.
#[derive(Debug, Default)]
pub(crate) struct Quick {
    /// The frame of the ellipse around which pixels were collected last, and the light that is expected there.
    pub(crate) frame: Frame,
    expected: [f64; LIGHTS + BENDS],
    pixels: Pixels,
    rings: Rings,
    /// Rows further off, of light that bends, and of which sides they show the same light; none before they were asked.
    beyond: Pixels,
    same_beyond: Option<[bool; 2]>,
    columns: Columns,
    gram: Gram,
    dense: Dense,
    few: Few,
    /// Unknowns of the equations that were solved last.
    solved: usize,
    found: [f64; ALL],
    light: [f64; LIGHTS + BENDS],
    /// What is known of light that bends, where it does.
    bent: Option<[Bent; 2]>,
    /// Whether the light inside rises across the disc and that outside does not.
    pub(crate) slanted_inside: bool,
    pub(crate) shares: Vec<Share>,
}

/// Whether a contour is too short to be asked for light that bends.
fn is_short(e: &Ellipse) -> bool {
    !e.is_longer_than(bent::LEAST_CONTOUR_PX)
}

/// Products of all columns, lower triangle.
#[derive(Debug)]
struct Gram([f64; PRODUCTS]);

impl Default for Gram {
    fn default() -> Self {
        Self([0.0; PRODUCTS])
    }
}

/// Columns of one side's light, in the order of [`Side::basis`].
const fn columns_of(side: usize) -> [usize; Side::MOST] {
    let (first, bends) = (3 * side, M + 3 * side);
    [first, bends, first + 1, first + 2, bends + 1, bends + 2]
}

/// Place of a column in the list of the light.
const fn of_light(column: usize) -> usize {
    if column < LIGHTS { column } else { column + LIGHTS - M }
}

/// Place of a product in the lower triangle, `a >= b`.
const fn place(a: usize, b: usize) -> usize {
    a * (a + 1) / 2 + b
}

impl Quick {
    /// Covariance of the regular coordinates.
    pub(crate) fn covariance(&self) -> &SMatrix<f64, 5, 5> {
        &self.dense.covariance
    }

    /// Change of the geometry that the last solve asks for, px.
    pub(crate) fn change(&self) -> SVector<f64, 5> {
        SVector::from_fn(|i, _| self.found[LIGHTS + 1 + i])
    }

    /// The same of the blur, px.
    pub(crate) fn change_of_blur(&self) -> f64 {
        self.found[LIGHTS]
    }

    /// Fits the disc as long as it looks clean; `outer_px` is how far it may look outwards, `floor` the least variance of the noise.
    pub(crate) fn fit(&mut self, view: &GrayView, state: &mut Clean, outer_px: f64, floor: f64) -> Option<()> {
        self.same_beyond = None;
        self.rounds(view, state, outer_px, floor)
    }

    /// The same, with what is known of the light further off.
    fn rounds(&mut self, view: &GrayView, state: &mut Clean, outer_px: f64, floor: f64) -> Option<()> {
        (self.bent, self.slanted_inside) = (None, false);
        // Light that bends is asked for in the second round.
        let at_once = state.near && is_short(&state.ellipse);
        let short_px = STILL_SHORT_PX.min(STILL_SHORT * state.blur_px);
        let still_px = if at_once { STILL_PX.max(short_px) } else { STILL_PX };
        // The geometry must have been solved for with the light that is there.
        let (mut rounds_alike, mut bends) = (0, false);
        for round in 0..MOST_ROUNDS {
            let first = round == 0;
            self.collect(view, state, outer_px, (first, first && !at_once))?;
            let bent = self.judge_noise(view, state, (outer_px, floor), round)? || bends;
            rounds_alike = if bent == bends { rounds_alike + 1 } else { 0 };
            bends = bent;
            if first {
                self.light = self.first_light(state);
            }
            self.sum_up(state);
            match (&self.bent, first && !at_once) {
                (Some(_), _) => self.solve(state, [true, true]).map(|_| ())?,
                (None, true) => self.solve_freely(state)?,
                (None, false) => self.solve_light(state)?,
            }
            let change = &self.found[LIGHTS..N];
            let largest = change.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            (0..LIGHTS).for_each(|k| self.light[k] += self.found[k]);
            (M..ALL).for_each(|k| self.light[of_light(k)] += self.found[k]);
            state.step = self.light[0] - self.light[3];
            // The step along the contour must have been that of the light.
            let settled = !first || at_once && self.slopes_found() < STILL_LIGHT * state.step.abs();
            if settled && rounds_alike > 0 && largest < still_px {
                return self.dense.geometry(self.solved).then_some(());
            }
            if round > 0 && largest > 0.5 {
                return None;
            }
            let factor = ((state.blur_px + 0.3) / largest.max(1e-12)).min(1.0);
            let mut q = to_regular(&state.ellipse);
            (0..5).for_each(|i| q[i] += factor * change[1 + i]);
            state.ellipse = from_regular(&q)?;
            state.blur_px = (state.blur_px + factor * change[0]).max(LEAST_BLUR_PX);
        }
        None
    }

    /// Collects the pixels around the ellipse, at first having them brought near, for a start fewer rows of them; none where there is not room enough.
    fn collect(&mut self, view: &GrayView, state: &Clean, outer_px: f64, (first, start): (bool, bool)) -> Option<()> {
        let e = &state.ellipse;
        let reach = reach_px(state.blur_px);
        // Long contours feel the little that the edge shows further off.
        let noise = if is_short(e) { state.variance[0].max(state.variance[1]).sqrt() } else { 0.0 };
        let near = near_px(state.blur_px, noise / state.step.abs());
        let inner = reach.min(0.85 * e.semi_minor_px);
        if on_rim(e, state.blur_px) || inner < near + 0.5 || outer_px < near + 2.0 {
            return None;
        }
        self.frame = Frame::new(e);
        self.expected = state.expected_light(&self.frame);
        let around = std::f64::consts::PI * (e.semi_major_px + e.semi_minor_px) * 2.0 * near;
        let thin = if start { (around / START_PIXELS).clamp(1.0, THINNEST) as usize } else { 1 };
        self.rings = Rings { near, inner, outer: reach.min(outer_px), thin, fetch: first };
        let whole = lanes::run(Collect { view, frame: &self.frame, rings: self.rings, out: &mut self.pixels });
        (whole && self.pixels.near.count > 3 * N).then_some(())
    }

    /// Products of all columns.
    fn sum_up(&mut self, state: &Clean) {
        let lens = Lens { blur_px: state.blur_px, shape: state.shape, variance: state.variance, light: self.light };
        let (near, frame, out) = (&self.pixels.near, &self.frame, &mut self.columns);
        if self.bent.is_some() {
            lanes::run(SumUp::<true> { near, frame, lens: &lens, out });
            self.gram.0 = self.columns.gram;
            self.add_bent_runs(state);
        } else {
            lanes::run(SumUp::<false> { near, frame, lens: &lens, out });
            self.gram.0[..PLAIN].copy_from_slice(&self.columns.gram[..PLAIN]);
            self.add_runs(state);
        }
    }

    /// Noise of either side, and whether the light of a large disc is seen to bend; none where rows differ more than pixels do.
    fn judge_noise(
        &mut self,
        view: &GrayView,
        state: &mut Clean,
        (outer_px, floor): (f64, f64),
        round: usize,
    ) -> Option<bool> {
        let found = [0, 1].map(|side| self.pixels.sums[side].noise(floor, &state.allow));
        let level = found.iter().all(Result::is_ok);
        let asked = !level || self.bent.is_some() || round == 1;
        let large = !is_short(&state.ellipse);
        let (mut found, mut seen) = (found.map(|x| x.ok().flatten()), false);
        if asked && large {
            let turn = self.turn();
            let side =
                |side: usize| Bent::new(view, &self.pixels, side, &turn, (floor, &state.allow), state.step.abs()).ok();
            let mut sides = [side(0)?, side(1)?];
            let long = state.ellipse.is_longer_than(bent::LONG_CONTOUR_PX) && sides.iter().any(Bent::rises);
            seen = !level || sides.iter().any(Bent::bends);
            // The round in which it is first seen to bend is never the last.
            if round > 0 && (self.bent.is_some() || long && !seen) {
                self.look_beyond(view, state, (outer_px, floor), &mut sides);
            }
            let mut sides = Bent::of_both(sides);
            if long {
                sides.iter_mut().for_each(Bent::loosen);
            }
            // Once bent it stays so, lest rounds take turns.
            if seen || self.bent.is_some() || sides.iter().any(Bent::bends) {
                found = [0, 1].map(|side: usize| sides[side].variance);
                self.bent = Some(sides);
            }
        } else if !level {
            return None;
        }
        let [a, b] = self.expected_noise(state, found);
        let (a, b) = (a.or(b)?, b.or(a)?);
        // As elsewhere: a clipped side has no noise at all, yet it must not outweigh the flank of the edge.
        let least = floor.max(a.max(b) / 16.0);
        state.variance = [a.max(least), b.max(least)];
        Some(seen)
    }

    /// The noise of both sides, where few pixels show that inside with what all discs tell.
    fn expected_noise(&self, state: &Clean, found: [Option<f64>; 2]) -> [Option<f64>; 2] {
        let counts = [0, 1].map(|side: usize| self.pixels.sums[side].count());
        let shown = [0, 1].map(|side| found[side].map(|variance| (variance, counts[side])));
        let expected = state.shot_noise.and_then(|x| x.fill(shown, state.step));
        expected.map_or(found, |both| both.map(Some))
    }

    /// What the pixels near the edge say of light that bends together with those further off, on the sides where both say the same.
    fn look_beyond(&mut self, view: &GrayView, state: &Clean, (outer_px, floor): (f64, f64), sides: &mut [Bent; 2]) {
        let e = &state.ellipse;
        let outer = (self.rings.outer + BEYOND * e.semi_minor_px).min(outer_px).min(border_px(view, e) - 1.0);
        self.beyond.start_beside(&self.pixels);
        lanes::run(Beyond { view, frame: &self.frame, rings: self.rings, outer, out: &mut self.beyond });
        let mut same = self.same_beyond.unwrap_or([true; 2]);
        for (k, same) in same.iter_mut().enumerate().filter(|(_, same)| **same) {
            let both = sides[k].with(view, k, [&self.pixels, &self.beyond], (floor, &state.allow));
            *same = both.is_some();
            if let Some(both) = both {
                sides[k] = both;
                self.pixels.runs[k].extend_from_slice(&self.beyond.runs[k]);
            }
        }
        self.same_beyond = Some(same);
    }

    /// The mean of either side, with slopes as expected.
    fn first_light(&self, state: &Clean) -> [f64; LIGHTS + BENDS] {
        let [inside, outside] = [0, 1].map(|side| self.pixels.sums[side].mean());
        let outside = outside.or_else(|| inside.map(|x| x - state.step)).unwrap_or(0.0);
        let inside = inside.unwrap_or(outside + state.step);
        let mut light = self.expected;
        (light[0], light[3]) = (inside, outside);
        light
    }

    /// Adds what the rows away from the edge say about the light, less what the model says.
    fn add_runs(&mut self, state: &Clean) {
        let turn = self.turn();
        for side in 0..2 {
            let sums = &self.pixels.sums[side];
            let w = 1.0 / state.variance[side];
            let (right, squares) = sums.right();
            let m = turn * sums.matrix() * turn.transpose();
            let r = turn * right;
            let l = Vector3::from_column_slice(&self.light[3 * side..3 * side + 3]);
            let left = r - m * l;
            for i in 0..3 {
                for j in 0..=i {
                    self.gram.0[place(3 * side + i, 3 * side + j)] += w * m[(i, j)];
                }
                self.gram.0[place(N, 3 * side + i)] += w * left[i];
            }
            self.gram.0[place(N, N)] += w * (squares - l.dot(&(r + left)));
        }
    }

    /// The same of light that bends.
    fn add_bent_runs(&mut self, state: &Clean) {
        for (side, bent) in self.bent.iter().flatten().enumerate() {
            let (w, fits) = (1.0 / state.variance[side], &bent.fits);
            let columns = columns_of(side);
            let l = Vector6::from(columns.map(|k| self.light[of_light(k)]));
            let left = fits.right - fits.matrix * l;
            for i in 0..Side::MOST {
                for j in 0..=i {
                    let (a, b) = (columns[i].max(columns[j]), columns[i].min(columns[j]));
                    self.gram.0[place(a, b)] += w * fits.matrix[(i, j)];
                }
                self.gram.0[place(columns[i].max(N), columns[i].min(N))] += w * left[i];
            }
            self.gram.0[place(N, N)] += w * (fits.squares - l.dot(&(fits.right + left)));
        }
    }

    /// Number of unknowns.
    fn unknowns(&self) -> usize {
        if self.bent.is_some() { N + BENDS } else { N }
    }

    /// `(1, X, Y)` in units of the semi-axes about the centre from `(1, u, v)` about the reference pixel.
    fn turn(&self) -> Matrix3<f64> {
        let Frame { u0, v0, a, b, cos, sin, .. } = &self.frame;
        let (u, v) = (u0 - self.pixels.reference.0, v0 - self.pixels.reference.1);
        Matrix3::new(
            1.0,
            0.0,
            0.0,
            -(cos * u + sin * v) / a,
            cos / a,
            sin / a,
            -(cos * v - sin * u) / b,
            -sin / b,
            cos / b,
        )
    }

    /// Solves with the slopes free or held, light that bends as it was judged; returns `chi^2`, of what holds them included.
    fn solve(&mut self, state: &Clean, free: [bool; 2]) -> Option<f64> {
        let gram = &self.gram.0;
        let n = self.unknowns();
        let bends = n - N;
        // Blur and geometry must come last.
        let column = |k: usize| if k < bends { M + k } else { k - bends };
        self.dense.clear(n);
        for i in 0..n {
            for j in 0..=i {
                let (a, b) = (column(i), column(j));
                self.dense.matrix[i * n + j] = gram[place(a.max(b), a.min(b))];
            }
            self.dense.right[i] = gram[place(column(i).max(N), column(i).min(N))];
        }
        let (weights, expected) = (self.weights_of_light(state, free), self.expected);
        for (i, w) in (0..bends + LIGHTS).map(|i| (i, weights[of_light(column(i))])) {
            self.dense.matrix[i * n + i] += w;
            let k = of_light(column(i));
            self.dense.right[i] -= w * (self.light[k] - expected[k]);
        }
        let weight = blur_weight(state.expected_blur_px);
        let blur = bends + LIGHTS;
        self.dense.matrix[blur * n + blur] += weight;
        self.dense.right[blur] += weight * (state.expected_blur_px - state.blur_px);
        if !self.dense.unknowns(n) {
            return None;
        }
        (self.solved, self.found) = (n, [0.0; ALL]);
        (0..n).for_each(|i| self.found[column(i)] = self.dense.right[i]);
        let explained: f64 = (0..N).map(|i| self.found[i] * gram[place(N, i)]).sum();
        let explained = explained + (M..M + bends).map(|i| self.found[i] * gram[place(i, N)]).sum::<f64>();
        let held = |k: usize| {
            let beside = self.light[of_light(k)] - expected[of_light(k)];
            weights[of_light(k)] * beside * (beside + self.found[k])
        };
        let held: f64 = (0..LIGHTS).map(held).sum::<f64>() + (M..M + bends).map(held).sum::<f64>();
        Some(gram[place(N, N)] - explained + held)
    }

    /// Inverse variances of the light before seeing the image.
    fn weights_of_light(&self, state: &Clean, free: [bool; 2]) -> [f64; LIGHTS + BENDS] {
        let mut weights = [0.0; LIGHTS + BENDS];
        for side in 0..2 {
            let sigma = [1e3, if free[side] { 2.0 } else { 1e-5 }].map(|x: f64| (x * state.step).powi(-2));
            weights[3 * side..3 * side + 3].copy_from_slice(&[sigma[0], sigma[1], sigma[1]]);
        }
        for (side, bent) in self.bent.iter().flatten().enumerate() {
            for (k, sigma) in columns_of(side).into_iter().zip(bent.prior_sigmas()) {
                weights[of_light(k)] = sigma.powi(-2);
            }
        }
        weights
    }

    /// Factor of the equations with all slopes free.
    fn factor(&mut self, state: &Clean) -> Option<()> {
        self.few.set(&self.gram.0);
        let (weights, expected) = (self.weights_of_light(state, [true, true]), self.expected);
        for (i, column) in ORDER.into_iter().enumerate().filter(|(_, column)| *column < LIGHTS) {
            self.few.add(i, weights[column], expected[column] - self.light[column]);
        }
        self.few.add(BLUR, blur_weight(state.expected_blur_px), state.expected_blur_px - state.blur_px);
        lanes::run(few::Factor(&mut self.few)).then_some(())
    }

    /// Largest change of a slope of the light that the last solve asks for, grey in units of the semi-axes.
    fn slopes_found(&self) -> f64 {
        ORDER[KEPT..].iter().fold(0.0, |most, column| self.found[*column].abs().max(most))
    }

    fn take(&mut self, x: [f64; N]) {
        self.found = [0.0; ALL];
        ORDER.into_iter().zip(x).for_each(|(column, x)| self.found[column] = x);
    }

    /// Solves with all slopes free, for the unknowns alone.
    fn solve_freely(&mut self, state: &Clean) -> Option<()> {
        self.factor(state)?;
        self.take(self.few.free());
        Some(())
    }

    /// Slopes as the pixels ask: a slope is worth its price, and light that rises outside rises inside as well.
    fn solve_light(&mut self, state: &Clean) -> Option<()> {
        self.slanted_inside = false;
        self.factor(state)?;
        let expected = self.expected;
        let held: [f64; SLOPES] = std::array::from_fn(|i| expected[ORDER[KEPT + i]] - self.light[ORDER[KEPT + i]]);
        if self.few.price(&held) < SLOPE {
            self.take(self.few.held(&held));
            self.few.factor_without_slopes(&mut self.dense);
            self.solved = KEPT;
            return Some(());
        }
        let both = self.solve(state, [true, true])?;
        let plain = self.solve(state, [false, false])?;
        let inside = self.solve(state, [true, false])?;
        let outside = self.solve(state, [false, true])?;
        let rises =
            [plain - inside > SLOPE || outside - both > SLOPE, plain - outside > SLOPE || inside - both > SLOPE];
        self.slanted_inside = rises[0] && !rises[1];
        self.solve(state, [rises[0] || rises[1], rises[1]]).map(|_| ())
    }

    /// What each sector leaves; the contour must be cut for the ellipse of the last round.
    pub(crate) fn share_out(&mut self, contour: &Contour) {
        self.shares.clear();
        self.shares.resize(contour.len(), Share::default());
        let count = self.pixels.near.count;
        let (columns, found, bent) = (&mut self.columns, &self.found, self.bent.is_some());
        lanes::run(ShareOut { columns, found, bent, count, contour, shares: &mut self.shares });
    }

    /// Whether rows away from the edge, and pixels near it, leave no more than noise.
    pub(crate) fn clean(&self, state: &Clean) -> bool {
        let squares: f64 = self.shares.iter().map(|s| s.squares).sum();
        let pixels: f64 = self.shares.iter().map(|s| s.pixels).sum();
        if squares > pixels * 1.15 + 5.0 * (2.0 * pixels).sqrt() {
            return false;
        }
        let like_noise =
            |(sum, count): (f64, f64), side: usize| sum < state.allow.most_of_rows(count) * state.variance[side];
        if let Some(bent) = &self.bent {
            let light = |side| Vector6::from(columns_of(side).map(|k| self.light[of_light(k)]));
            return (0..2).all(|k| like_noise(bent[k].left_by_rows(&self.pixels.runs[k], &light(k)), k));
        }
        let turn = self.turn();
        (0..2).all(|side| {
            // The light as a plane over the columns and rows of the image.
            let light = turn.transpose() * Vector3::from_column_slice(&self.light[3 * side..3 * side + 3]);
            let (mut sum, mut count) = (0.0, 0.0);
            for x in &self.pixels.runs[side] {
                let left = x.g - (light[0] + light[2] * x.v) * x.n - light[1] * x.u;
                sum += left * left / x.n;
                count += 1.0;
            }
            like_noise((sum, count), side)
        })
    }
}
