//! A clean disc, fast: the model of [`crate::detect::exact`] with level and slope of the light on either side, nothing hidden, nothing beside it.
//!
//! Pixels near the edge are worked on eight at a time; those further away see one side only, and rows of them
//! are summed up as they are. One set of sums serves every question about the light: a slope that is not asked for is held by its prior.
//! The fit ends in questions about what is left: sectors that disagree, rows whose mean is off, residuals beyond the noise. Any yes, and
//! the disc goes the longer way through [`crate::detect::sectors`], so that what is lost here is time only.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | J^T W J | `gram` | 13 x 13 | | products of the columns `1, X, Y` inside, `1, X, Y` outside, blur, geometry, grey value |
//! | - | `Run` | | | one row of pixels that see one side: sums of `1, u, u^2, g, g u, g^2` |

use crate::conic::{Ellipse, Frame, from_regular, to_regular};
use crate::detect::band::LANES;
use crate::detect::contour::Contour;
use crate::detect::edge_model::{Dense, PRIOR_BLUR_PX};
use crate::detect::exact::{SLOPE, SMALL, Share};
use crate::detect::profile::Profile;
use crate::detect::refine::reach_px;
use crate::image::{GrayView, Samples};
use crate::lanes::{self, Kernel, Lanes as Width};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// Pixels of a block: enough for the compiler to see loops.
const BLOCK: usize = 64;
/// Unknowns of the light.
const LIGHTS: usize = 6;
/// Blur and geometry.
const FIXED: usize = 6;
/// Unknowns.
const N: usize = LIGHTS + FIXED;
/// Columns: the unknowns and the grey value.
const M: usize = N + 1;
/// Products of two columns.
const PRODUCTS: usize = M * (M + 1) / 2;
/// Beyond this many blurs the edge is not felt.
const NEAR: f64 = 3.5;
/// Rounds at most.
const MOST_ROUNDS: usize = 6;
/// A change below this ends the rounds, px.
const STILL_PX: f64 = 0.03;

/// A stretch of one row on one side.
#[derive(Debug, Clone, Copy)]
struct Run {
    v: f64,
    n: f64,
    u: f64,
    uu: f64,
    g: f64,
    gu: f64,
    gg: f64,
    /// Sum of the squared differences of neighbours: light that varies smoothly leaves it alone.
    dd: f64,
}

/// State of the fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clean {
    pub(crate) ellipse: Ellipse,
    pub(crate) blur_px: f64,
    pub(crate) expected_blur_px: f64,
    pub(crate) step: f64,
    /// Noise variance inside and outside, grey^2.
    pub(crate) variance: [f64; 2],
}

/// Buffers reused from disc to disc, and the result.
#[derive(Debug)]
pub(crate) struct Quick {
    x: Vec<f64>,
    y: Vec<f64>,
    grey: Vec<f64>,
    cos: Vec<f64>,
    sin: Vec<f64>,
    count: usize,
    /// Columns of the pixels near the edge, block by block, each times the root of its weight.
    columns: Vec<[[f64; BLOCK]; M]>,
    response: Vec<[f64; BLOCK]>,
    runs: [Vec<Run>; 2],
    gram: [f64; PRODUCTS],
    dense: Dense,
    found: [f64; N],
    light: Option<[f64; LIGHTS]>,
    ground: f64,
    pub(crate) shares: Vec<Share>,
}

/// [`Quick::sum_up`] in the widest vectors.
struct SumUp<'a>(&'a mut Quick, &'a Clean);

impl Kernel for SumUp<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Width>(self) {
        self.0.sum_up(self.1);
    }
}

impl Default for Quick {
    fn default() -> Self {
        Self {
            x: vec![],
            y: vec![],
            grey: vec![],
            cos: vec![],
            sin: vec![],
            count: 0,
            columns: vec![],
            response: vec![],
            runs: [vec![], vec![]],
            gram: [0.0; PRODUCTS],
            dense: Dense::default(),
            found: [0.0; N],
            light: None,
            ground: 0.0,
            shares: vec![],
        }
    }
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

    pub(crate) fn widen(&self) -> f64 {
        self.dense.widen
    }

    /// Change of the geometry that the last solve asks for, px.
    pub(crate) fn change(&self) -> SVector<f64, 5> {
        SVector::from_fn(|i, _| self.found[LIGHTS + 1 + i])
    }

    /// Fits the disc as long as it looks clean; `outer_px` is how far it may look outwards, `floor` the least variance of the noise.
    pub(crate) fn fit(&mut self, view: &GrayView, state: &mut Clean, outer_px: f64, floor: f64) -> Option<()> {
        self.light = None;
        for round in 0..MOST_ROUNDS {
            let e = &state.ellipse;
            let reach = reach_px(state.blur_px);
            let near = NEAR * state.blur_px;
            let inner = reach.min(0.85 * e.semi_minor_px);
            let small = state.blur_px * e.semi_major_px > SMALL * e.semi_minor_px * e.semi_minor_px;
            if small || inner < near + 0.5 || outer_px < near + 2.0 {
                return None;
            }
            if !self.collect(view, e, near, inner, reach.min(outer_px)) {
                return None;
            }
            state.variance = self.noise(floor)?;
            lanes::run(SumUp(self, state));
            self.add_runs(state);
            self.solve_light(state)?;
            let change = &self.found[LIGHTS..];
            let largest = change.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let first = self.light.is_none();
            self.light = self.found.first_chunk().copied();
            state.step = self.found[0] - self.found[3];
            if !first && largest < STILL_PX {
                return Some(());
            }
            if round > 0 && largest > 0.5 {
                return None;
            }
            let factor = ((state.blur_px + 0.3) / largest.max(1e-12)).min(1.0);
            let mut q = to_regular(&state.ellipse);
            (0..5).for_each(|i| q[i] += factor * change[1 + i]);
            state.ellipse = from_regular(&q)?;
            state.blur_px = (state.blur_px + factor * change[0]).max(0.15);
        }
        None
    }

    /// Takes the pixels within `near` of the ellipse one by one, those within `inner` and `outer` of it by rows; false near the border.
    fn collect(&mut self, view: &GrayView, e: &Ellipse, near: f64, inner: f64, outer: f64) -> bool {
        let frame = Frame::new(e);
        for list in [&mut self.x, &mut self.y, &mut self.grey] {
            list.clear();
        }
        self.runs.iter_mut().for_each(Vec::clear);
        // The parallel curve of an ellipse lies inside the ellipse with both axes grown by this much.
        let bulge = (frame.a + frame.b) / (2.0 * (frame.a * frame.b).sqrt());
        // Outside, inside of the near band, and the hole: pairs of semi-axes.
        let axes = |d: f64| (frame.a + d, frame.b + d);
        let rings = [axes(outer.max(near * bulge)), axes(near * bulge), axes(-near * bulge), axes(-inner)];
        let half_height = (rings[0].0 * frame.sin).hypot(rings[0].1 * frame.cos);
        let half_width = (rings[0].0 * frame.cos).hypot(rings[0].1 * frame.sin);
        let (u_last, v_last) = (view.width() as f64 - 1.0, view.height() as f64 - 1.0);
        let (top, bottom) = ((frame.v0 - half_height).ceil(), (frame.v0 + half_height).floor());
        if top < 0.0 || bottom > v_last || frame.u0 - half_width < 0.0 || frame.u0 + half_width > u_last {
            return false;
        }
        self.ground = f64::from(view.get(frame.u0 as usize, frame.v0 as usize));
        for v in top as usize..=bottom as usize {
            let dv = v as f64 - frame.v0;
            let mut ends = [(0usize, 0usize); 4];
            for (end, (a, b)) in ends.iter_mut().zip(rings) {
                if a > 0.0 && b > 0.0 {
                    if let Some((lo, hi)) = frame.row_span(dv, a, b) {
                        let (lo, hi) = ((frame.u0 + lo).ceil(), (frame.u0 + hi).floor() + 1.0);
                        if hi > lo {
                            *end = (lo as usize, hi as usize);
                        }
                    }
                }
            }
            let [far, band, core, hole] = ends;
            self.run(view, 1, v, far, band);
            self.near(view, &frame, v, band, core);
            self.run(view, 0, v, core, hole);
        }
        self.count = self.grey.len();
        let n = self.count.div_ceil(BLOCK) * BLOCK;
        self.grey.resize(n, 0.0);
        self.x.resize(n, frame.a);
        self.y.resize(n, 0.0);
        self.count > 3 * N
    }

    /// Columns of `whole` without those of `hole`, as stretches of one side.
    fn run(&mut self, view: &GrayView, side: usize, v: usize, whole: (usize, usize), hole: (usize, usize)) {
        let parts = if hole.0 < hole.1 { [(whole.0, hole.0), (hole.1, whole.1)] } else { [whole, (0, 0)] };
        for (from, to) in parts {
            if from >= to {
                continue;
            }
            let at = v * view.stride();
            let (ground, first) = (self.ground, from as f64);
            let (mut g, mut gu, mut gg, mut dd, mut before) = (0.0, 0.0, 0.0, 0.0, f64::NAN);
            let mut take = |i: usize, x: f64| {
                let x = x - ground;
                g += x;
                gu += x * i as f64;
                gg += x * x;
                let step = x - before;
                dd += if i == 0 { 0.0 } else { step * step };
                before = x;
            };
            match view.samples() {
                Samples::U8(s) => s[at + from..at + to].iter().enumerate().for_each(|(i, x)| take(i, f64::from(*x))),
                Samples::U16(s) => s[at + from..at + to].iter().enumerate().for_each(|(i, x)| take(i, f64::from(*x))),
                Samples::F32(s) => s[at + from..at + to].iter().enumerate().for_each(|(i, x)| take(i, f64::from(*x))),
            }
            let n = (to - from) as f64;
            // Sums of u and u^2 about the first column, then about zero.
            let (s1, s2) = (0.5 * n * (n - 1.0), n * (n - 1.0) * (2.0 * n - 1.0) / 6.0);
            self.runs[side].push(Run {
                v: v as f64,
                n,
                u: s1 + n * first,
                uu: s2 + 2.0 * first * s1 + n * first * first,
                g,
                gu: gu + first * g,
                gg,
                dd,
            });
        }
    }

    fn near(&mut self, view: &GrayView, frame: &Frame, v: usize, whole: (usize, usize), hole: (usize, usize)) {
        let parts = if hole.0 < hole.1 { [(whole.0, hole.0), (hole.1, whole.1)] } else { [whole, (0, 0)] };
        let dv = v as f64 - frame.v0;
        let (x0, y0) = (frame.sin * dv - frame.cos * frame.u0, frame.cos * dv + frame.sin * frame.u0);
        for (from, to) in parts {
            if from >= to {
                continue;
            }
            let row = v * view.stride();
            let ground = self.ground;
            match view.samples() {
                Samples::U8(s) => self.grey.extend(s[row + from..row + to].iter().map(|x| f64::from(*x) - ground)),
                Samples::U16(s) => self.grey.extend(s[row + from..row + to].iter().map(|x| f64::from(*x) - ground)),
                Samples::F32(s) => self.grey.extend(s[row + from..row + to].iter().map(|x| f64::from(*x) - ground)),
            }
            self.x.extend((from..to).map(|u| x0 + frame.cos * u as f64));
            self.y.extend((from..to).map(|u| y0 - frame.sin * u as f64));
        }
    }

    /// Sums of `(1, du, dv)` products, and with the grey value, over the runs of one side; du, dv from the centre.
    fn plane_sums(&self, side: usize, e: &Ellipse) -> (Matrix3<f64>, Vector3<f64>, f64) {
        let (u0, v0) = (e.center_px.u_px, e.center_px.v_px);
        let (mut m, mut r, mut squares) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for x in &self.runs[side] {
            let (dv, du) = (x.v - v0, x.u - x.n * u0);
            let duu = x.uu - 2.0 * u0 * x.u + x.n * u0 * u0;
            m += Matrix3::new(x.n, du, x.n * dv, du, duu, du * dv, x.n * dv, du * dv, x.n * dv * dv);
            r += Vector3::new(x.g, x.gu - u0 * x.g, x.g * dv);
            squares += x.gg;
        }
        (m, r, squares)
    }

    /// Noise of either side about a plane; none where too few pixels see one side, or rows differ more than pixels do.
    fn noise(&self, floor: f64) -> Option<[f64; 2]> {
        let mut found = [None; 2];
        for side in 0..2 {
            let first = self.runs[side].first().copied();
            let Some(first) = first else { continue };
            let about = Ellipse {
                center_px: crate::frames::Pixel::new(first.u / first.n, first.v),
                semi_major_px: 1.0,
                semi_minor_px: 1.0,
                angle_rad: 0.0,
            };
            let (m, r, squares) = self.plane_sums(side, &about);
            if m[(0, 0)] < 16.0 {
                continue;
            }
            let x = m.cholesky()?.solve(&r);
            let about_plane = (squares - r.dot(&x)).max(0.0) / (m[(0, 0)] - 3.0);
            let (sum, pairs) = self.runs[side].iter().fold((0.0, 0.0), |(s, n), x| (s + x.dd, n + x.n - 1.0));
            let of_neighbours = 0.5 * sum / f64::max(pairs, 1.0);
            if about_plane > of_neighbours.max(floor) * (1.25 + 5.0 * (2.0 / f64::max(pairs, 1.0)).sqrt()) {
                return None;
            }
            found[side] = Some(about_plane);
        }
        let [a, b] = found;
        let (a, b) = (a.or(b)?, b.or(a)?);
        // As elsewhere: a clipped side has no noise at all, yet it must not outweigh the flank of the edge.
        let least = floor.max(a.max(b) / 16.0);
        Some([a.max(least), b.max(least)])
    }

    /// Products of the columns of the pixels near the edge.
    #[inline(always)]
    fn sum_up(&mut self, state: &Clean) {
        let frame = Frame::new(&state.ellipse);
        let (a, b) = (frame.a, frame.b);
        let profile = Profile { blur_px: state.blur_px, a, b };
        let s2 = state.blur_px * state.blur_px;
        let light = self.light.unwrap_or([state.step, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let rise = [light[0] - light[3], light[1] - light[4], light[2] - light[5]];
        let [var_in, var_out] = state.variance;
        let blocks = self.grey.len() / BLOCK;
        for list in [&mut self.cos, &mut self.sin] {
            list.resize(blocks * BLOCK, 0.0);
        }
        self.columns.resize(blocks, [[0.0; BLOCK]; M]);
        self.response.resize(blocks, [0.0; BLOCK]);
        let mut sums = [[0.0; LANES]; PRODUCTS];
        let Self { columns, response: responses, grey, count, .. } = self;
        let count = *count;
        for block in 0..blocks {
            let at = block * BLOCK;
            let (mut x, mut y) = ([0.0; BLOCK], [0.0; BLOCK]);
            x.copy_from_slice(&self.x[at..at + BLOCK]);
            y.copy_from_slice(&self.y[at..at + BLOCK]);
            let feet = frame.feet(&x, &y);
            let lanes = profile.at(&feet.distance, &feet.cos, &feet.sin);
            let mut shown = [1.0; BLOCK];
            shown[(count - at).min(BLOCK)..].fill(0.0);
            let column = &mut columns[block];
            let response = &mut responses[block];
            let grey = &grey[at..at + BLOCK];
            for l in 0..BLOCK {
                let (c, s) = (feet.cos[l], feet.sin[l]);
                let inverse = 1.0 / (b * b * c * c + a * a * s * s).sqrt();
                let (nx, ny) = (b * c * inverse, a * s * inverse);
                let (p, slope) = (lanes.inside[l], lanes.slope[l]);
                let root = shown[l] / (var_in * p + var_out * (1.0 - p)).sqrt();
                let (px, py) = (x[l] / a, y[l] / b);
                let (bx, by) = (px * p + s2 * slope * nx / a, py * p + s2 * slope * ny / b);
                let step = rise[0] + rise[1] * c + rise[2] * s;
                let h = root * step * slope;
                let (da, db) = (-nx * c, -ny * s);
                let (along, across) = (da - db, -(a + b) * c * s * inverse);
                column[0][l] = root * p;
                column[1][l] = root * bx;
                column[2][l] = root * by;
                column[3][l] = root * (1.0 - p);
                column[4][l] = root * (px - bx);
                column[5][l] = root * (py - by);
                column[6][l] = root * step * lanes.by_blur[l];
                column[7][l] = -h * (frame.cos * nx - frame.sin * ny);
                column[8][l] = -h * (frame.sin * nx + frame.cos * ny);
                column[9][l] = h * (da + db);
                column[10][l] = h * (frame.cos2 * along - frame.sin2 * across);
                column[11][l] = h * (frame.sin2 * along + frame.cos2 * across);
                column[12][l] = root * grey[l];
                response[l] = h;
            }
            self.cos[at..at + BLOCK].copy_from_slice(&feet.cos);
            self.sin[at..at + BLOCK].copy_from_slice(&feet.sin);
            let mut k = 0;
            for i in 0..M {
                for j in 0..=i {
                    let (ci, cj) = (&column[i], &column[j]);
                    let mut sum = sums[k];
                    for (x, y) in ci.chunks_exact(LANES).zip(cj.chunks_exact(LANES)) {
                        for l in 0..LANES {
                            sum[l] += x[l] * y[l];
                        }
                    }
                    sums[k] = sum;
                    k += 1;
                }
            }
        }
        for (total, lanes) in self.gram.iter_mut().zip(&sums) {
            *total = lanes.iter().sum();
        }
    }

    /// Adds what the rows away from the edge say about the light.
    fn add_runs(&mut self, state: &Clean) {
        let e = &state.ellipse;
        let (sin, cos) = e.angle_rad.sin_cos();
        let (a, b) = (e.semi_major_px, e.semi_minor_px);
        // (1, X, Y) from (1, du, dv).
        let turn = Matrix3::new(1.0, 0.0, 0.0, 0.0, cos / a, sin / a, 0.0, -sin / b, cos / b);
        for side in 0..2 {
            let (m, r, squares) = self.plane_sums(side, e);
            let w = 1.0 / state.variance[side];
            let (m, r) = (turn * m * turn.transpose() * w, turn * r * w);
            for i in 0..3 {
                for j in 0..=i {
                    self.gram[place(3 * side + i, 3 * side + j)] += m[(i, j)];
                }
                self.gram[place(N, 3 * side + i)] += r[i];
            }
            self.gram[place(N, N)] += squares * w;
        }
    }

    /// Solves with the slopes free or held; returns `chi^2`.
    fn solve(&mut self, state: &Clean, free: [bool; 2]) -> Option<f64> {
        self.dense.clear(N);
        for i in 0..N {
            for j in 0..=i {
                self.dense.matrix[i * N + j] = self.gram[place(i, j)];
            }
            self.dense.right[i] = self.gram[place(N, i)];
        }
        let at = LIGHTS + 1;
        self.dense.alone = SMatrix::from_fn(|i, j| self.gram[place(at + i.max(j), at + i.min(j))]);
        for side in 0..2 {
            let sigma = [1e3, if free[side] { 2.0 } else { 1e-5 }].map(|x: f64| (x * state.step).powi(-2));
            for (m, weight) in [sigma[0], sigma[1], sigma[1]].into_iter().enumerate() {
                let i = 3 * side + m;
                self.dense.matrix[i * N + i] += weight;
            }
        }
        let weight = PRIOR_BLUR_PX.powi(-2);
        self.dense.matrix[LIGHTS * N + LIGHTS] += weight;
        self.dense.right[LIGHTS] += weight * (state.expected_blur_px - state.blur_px);
        if !self.dense.solve(N) {
            return None;
        }
        self.found.copy_from_slice(&self.dense.right);
        Some(self.gram[place(N, N)] - (0..N).map(|i| self.found[i] * self.gram[place(N, i)]).sum::<f64>())
    }

    /// Slopes as the pixels ask: a slope is worth its price, and light that rises outside rises inside as well.
    fn solve_light(&mut self, state: &Clean) -> Option<()> {
        let both = self.solve(state, [true, true])?;
        let plain = self.solve(state, [false, false])?;
        if plain - both < SLOPE {
            return Some(());
        }
        let inside = self.solve(state, [true, false])?;
        let outside = self.solve(state, [false, true])?;
        let rises =
            [plain - inside > SLOPE || outside - both > SLOPE, plain - outside > SLOPE || inside - both > SLOPE];
        self.solve(state, [rises[0] || rises[1], rises[1]]).map(|_| ())
    }

    /// What each sector leaves; the contour must be cut for the ellipse of the last round.
    pub(crate) fn share_out(&mut self, contour: &Contour) {
        self.shares.clear();
        self.shares.resize(contour.len(), Share::default());
        for (block, column) in self.columns.iter().enumerate() {
            let mut left = column[N];
            for (x, c) in self.found.iter().zip(column) {
                for l in 0..BLOCK {
                    left[l] -= x * c[l];
                }
            }
            for l in 0..BLOCK.min(self.count - block * BLOCK) {
                let p = block * BLOCK + l;
                let k = contour.sector(self.cos[p], self.sin[p]);
                self.shares[k].push(self.response[block][l], left[l]);
            }
        }
    }

    /// Whether rows away from the edge, and pixels near it, leave no more than noise.
    pub(crate) fn clean(&self, state: &Clean) -> bool {
        let squares: f64 = self.shares.iter().map(|s| s.squares).sum();
        let pixels: f64 = self.shares.iter().map(|s| s.pixels).sum();
        if squares > pixels * 1.15 + 5.0 * (2.0 * pixels).sqrt() {
            return false;
        }
        let e = &state.ellipse;
        let (sin, cos) = e.angle_rad.sin_cos();
        (0..2).all(|side| {
            let light = &self.found[3 * side..3 * side + 3];
            let (mut sum, mut count) = (0.0, 0.0);
            for x in &self.runs[side] {
                let (du, dv) = (x.u - x.n * e.center_px.u_px, x.n * (x.v - e.center_px.v_px));
                let (sx, sy) = ((cos * du + sin * dv) / e.semi_major_px, (cos * dv - sin * du) / e.semi_minor_px);
                let left = x.g - light[0] * x.n - light[1] * sx - light[2] * sy;
                sum += left * left / (x.n * state.variance[side]);
                count += 1.0;
            }
            sum < count + 3.5 * (2.0 * count + 2.0_f64).sqrt()
        })
    }
}
