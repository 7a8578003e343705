//! The pixels of one disc: those near its edge one by one, those beside it as sums over rows.

use super::columns::{EIGHT, Near};
use super::whole::{Sample, Whole, number};
use crate::conic::{Cut, Frame};
use crate::detect::correlation::Allowance;
use crate::detect::level::ROUND;
use crate::image::{GrayView, Samples};
use crate::lanes::{self, Greys, Kernel, Lanes};
use nalgebra::{Matrix3, Vector3};
use std::ops::{Range, RangeInclusive};

/// What memory hands out at a time, bytes; where it is more some are asked for twice.
const LINE_BYTES: usize = 64;
/// Rows whose ends are found side by side.
const ROWS: usize = 16;
/// Beyond so many blurs, at least and at most, the edge is not felt: there it shows less than this part of the noise.
const NEAR: [f64; 2] = [2.5, 3.5];
const FELT: f64 = 0.1;
/// Nearer than this, px, no pixel is spared: what is left of sharp edges is not the Gaussian's.
const SHARP_PX: f64 = 2.0;
/// Places among eight.
const PLACES: [f32; EIGHT] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// A stretch of one row on one side of the edge; places relative to the reference pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    pub(super) v: f64,
    /// Number of pixels, sum of their columns, sum of their grey values.
    pub(super) n: f64,
    pub(super) u: f64,
    pub(super) g: f64,
}

/// Sums over all stretches of one side.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    n: f64,
    u: f64,
    v: f64,
    uu: f64,
    uv: f64,
    vv: f64,
    g: f64,
    gu: f64,
    gv: f64,
    gg: f64,
    /// Squared differences of neighbours, and how many: light that varies smoothly leaves them alone.
    dd: f64,
    pairs: f64,
}

impl Sums {
    pub(super) fn add(&mut self, more: &Self) {
        self.n += more.n;
        self.u += more.u;
        self.v += more.v;
        self.uu += more.uu;
        self.uv += more.uv;
        self.vv += more.vv;
        self.g += more.g;
        self.gu += more.gu;
        self.gv += more.gv;
        self.gg += more.gg;
        self.dd += more.dd;
        self.pairs += more.pairs;
    }

    /// Sums of products of `(1, u, v)`.
    pub(super) fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.n, self.u, self.v, self.u, self.uu, self.uv, self.v, self.uv, self.vv)
    }

    /// The same with the grey value, and its squares.
    pub(super) fn right(&self) -> (Vector3<f64>, f64) {
        (Vector3::new(self.g, self.gu, self.gv), self.gg)
    }

    /// Mean grey value; none where there is no pixel.
    pub(super) fn mean(&self) -> Option<f64> {
        (self.n > 0.0).then(|| self.g / self.n)
    }

    /// Noise variance about a plane, not below `floor`: `Ok(None)` where there are too few pixels, an error where rows differ more than
    /// neighbours do.
    pub(super) fn noise(&self, floor: f64, allow: &Allowance) -> Result<Option<f64>, ()> {
        if self.n < 16.0 {
            return Ok(None);
        }
        let (right, squares) = self.right();
        let x = self.matrix().cholesky().ok_or(())?.solve(&right);
        self.noise_about((squares - right.dot(&x)).max(0.0), 3.0, floor, allow).map(Some)
    }

    /// Noise variance about a surface with so many coefficients that leaves these squares.
    pub(super) fn noise_about(
        &self,
        squares: f64,
        coefficients: f64,
        floor: f64,
        allow: &Allowance,
    ) -> Result<f64, ()> {
        // Of noise that neighbours share the coefficients explain more.
        let variance = squares / (self.n - coefficients * allow.sums).max(0.5 * self.n);
        let pairs = self.pairs.max(1.0);
        let of_neighbours = 0.5 * self.dd / pairs;
        let most = allow.over_neighbours() * (1.25 + 5.0 * (2.0 * allow.squares / pairs).sqrt());
        if variance > of_neighbours.max(floor) * most {
            return Err(());
        }
        Ok(variance)
    }

    /// Number of pixels.
    pub(super) fn count(&self) -> f64 {
        self.n
    }
}

/// The pixels of one disc, buffers reused from disc to disc.
#[derive(Debug, Default)]
pub(super) struct Pixels {
    pub(super) near: Near,
    pub(super) runs: [Vec<Run>; 2],
    pub(super) sums: [Sums; 2],
    /// The reference pixel, and its grey value, which is subtracted from all.
    pub(super) reference: (f64, f64),
    pub(super) ground: f64,
    whole: [Whole; 2],
}

/// How far from the ellipse which pixels are taken, px; every `thin`-th row only. Whether all rows are brought near first.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Rings {
    pub(super) near: f64,
    pub(super) inner: f64,
    pub(super) outer: f64,
    pub(super) thin: usize,
    pub(super) fetch: bool,
}

/// How far beside the edge it is felt, px, where the noise is this part of its step: `Phi(-z) < phi(z) / z`, which is [`FELT`] times that there.
pub(super) fn near_px(blur_px: f64, noise_over_step: f64) -> f64 {
    let [least, most] = NEAR;
    let beyond = |z: f64| (-2.0 * (FELT * noise_over_step * z * std::f64::consts::TAU.sqrt()).ln()).max(0.0).sqrt();
    let z = beyond(beyond(most).clamp(least, most)).clamp(least, most);
    (z * blur_px).max(SHARP_PX.min(most * blur_px))
}

/// Takes the pixels within `near` of the ellipse one by one, those within `inner` and `outer` of it by rows; false near the border.
pub(super) struct Collect<'a> {
    pub(super) view: &'a GrayView<'a>,
    pub(super) frame: &'a Frame,
    pub(super) rings: Rings,
    pub(super) out: &'a mut Pixels,
}

/// First columns, and those behind the last, of some rows `dv` below the centre. A plain loop, for vectors.
#[inline(always)]
fn spans(cut: &Cut, u0: f64, dv: &[f64; ROWS], out: &mut [[i32; ROWS]; 2]) {
    let [first, end] = out;
    for k in 0..ROWS {
        let square = cut.reach2 - cut.fall2 * dv[k] * dv[k];
        let (middle, half) = (u0 + cut.shear * dv[k], square.max(0.0).sqrt());
        // Within the image, and no NaN where it counts: several are converted at once.
        let whole = |x: f64| (x + ROUND).to_bits() as i32;
        let (low, high) = (whole((middle - half).ceil()), whole((middle + half).floor()) + 1);
        let none = !(square >= 0.0);
        first[k] = if none { 0 } else { low };
        end[k] = if none { 0 } else { high };
    }
}

impl Kernel for Collect<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let (frame, rings) = (self.frame, self.rings);
        let outer = rings.outer.max(rings.near * bulge(frame));
        let [half_width, half_height] = half_size(frame, outer);
        let (u_last, v_last) = (self.view.width() as f64 - 1.0, self.view.height() as f64 - 1.0);
        let (top, bottom) = (frame.v0 - half_height, frame.v0 + half_height);
        if top <= 0.0 || bottom >= v_last || frame.u0 - half_width <= 0.0 || frame.u0 + half_width >= u_last {
            return false;
        }
        let rows = top.ceil() as usize..=bottom.floor() as usize;
        let columns = (frame.u0 - half_width) as usize..(frame.u0 + half_width) as usize + 1;
        match self.view.samples() {
            Samples::U8(s) => self.collect::<L, _>(s, rows, columns),
            Samples::U16(s) => self.collect::<L, _>(s, rows, columns),
            Samples::F32(s) => self.collect::<L, _>(s, rows, columns),
        }
        true
    }
}

impl Collect<'_> {
    /// From these rows and columns of the image.
    #[inline(always)]
    fn collect<L: Lanes, S: Sample>(self, samples: &[S], rows: RangeInclusive<usize>, columns: Range<usize>) {
        let Self { view, frame, rings, out } = self;
        let stride = view.stride();
        if rings.fetch {
            fetch(samples, stride, rows.clone(), columns);
        }
        out.near.clear();
        out.clear_runs();
        out.reference = ((frame.u0 as usize) as f64, (frame.v0 as usize) as f64);
        let ground = samples[frame.v0 as usize * stride + frame.u0 as usize];
        out.ground = ground.into();
        // Outside, outside and inside of the near band, and the hole.
        let near = rings.near * bulge(frame);
        let outer = rings.outer.max(near);
        let far = Cut::new(frame, frame.a + outer, frame.b + outer);
        let band = Cut::new(frame, frame.a + near, frame.b + near);
        let core = Cut::new(frame, frame.a - near, frame.b - near);
        let hole = Cut::new(frame, frame.a - rings.inner, frame.b - rings.inner);
        let (mut first, last, thin) = (*rows.start(), *rows.end(), rings.thin);
        while first <= last {
            let spans = spans_of_rows(frame, &[far, band, core, hole], first, thin);
            for k in 0..ROWS.min((last - first) / thin + 1) {
                let (v, [far, band, core, hole]) = (first + k * thin, of_row(&spans, k));
                let row = Row { samples, at: v * stride, v };
                let [left, right] = without(band, core);
                out.take::<L, S>(&row, frame, left);
                out.take::<L, S>(&row, frame, right);
                let [[left, right], [inner_left, inner_right]] = [without(far, band), without(core, hole)];
                // A loop, that the work is there once and has registers enough.
                for (side, stretch) in [(1, left), (1, right), (0, inner_left), (0, inner_right)] {
                    out.run::<L, S>(&row, side, stretch, ground);
                }
            }
            first += ROWS * thin;
        }
        out.near.fill_up(frame.a);
        out.take_rows();
    }
}

/// Row `v` of an image, which begins `at` one of its samples.
struct Row<'a, S> {
    samples: &'a [S],
    at: usize,
    v: usize,
}

/// First columns, and those behind the last, of [`ROWS`] rows from one on, every `thin`-th, within each of the cuts.
#[inline(always)]
fn spans_of_rows<const N: usize>(frame: &Frame, cuts: &[Cut; N], first: usize, thin: usize) -> [[[i32; ROWS]; 2]; N] {
    let mut dv = [0.0; ROWS];
    for k in 0..ROWS {
        dv[k] = number(first + k * thin) - frame.v0;
    }
    let mut spans = [[[0; ROWS]; 2]; N];
    for k in 0..N {
        self::spans(&cuts[k], frame.u0, &dv, &mut spans[k]);
    }
    spans
}

/// Those of one of the rows.
#[inline(always)]
fn of_row<const N: usize>(spans: &[[[i32; ROWS]; 2]; N], k: usize) -> [(usize, usize); N] {
    let mut out = [(0, 0); N];
    for (out, [first, end]) in out.iter_mut().zip(spans) {
        *out = (first[k] as usize, end[k] as usize);
    }
    out
}

/// Sums up the rows that [`Collect`] with the same rings left: all within, and those outside up to `outer` from the ellipse, px, for which there must be room.
pub(super) struct Beyond<'a> {
    pub(super) view: &'a GrayView<'a>,
    pub(super) frame: &'a Frame,
    pub(super) rings: Rings,
    pub(super) outer: f64,
    pub(super) out: &'a mut Pixels,
}

impl Kernel for Beyond<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        match self.view.samples() {
            Samples::U8(s) => self.sum_up::<L, _>(s),
            Samples::U16(s) => self.sum_up::<L, _>(s),
            Samples::F32(s) => self.sum_up::<L, _>(s),
        }
    }
}

impl Beyond<'_> {
    #[inline(always)]
    fn sum_up<L: Lanes, S: Sample>(self, samples: &[S]) {
        let (stride, frame, rings, out) = (self.view.stride(), self.frame, self.rings, self.out);
        let ground = samples[frame.v0 as usize * stride + frame.u0 as usize];
        let taken = rings.outer.max(rings.near * bulge(frame));
        let outer = self.outer.max(taken);
        let [_, half_height] = half_size(frame, outer);
        let rows = (frame.v0 - half_height).ceil() as usize..=(frame.v0 + half_height).floor() as usize;
        let grown = |by: f64| Cut::new(frame, frame.a + by, frame.b + by);
        let cuts = [grown(outer), grown(taken), grown(-rings.inner)];
        for first in rows.clone().step_by(ROWS) {
            let spans = spans_of_rows(frame, &cuts, first, 1);
            for k in 0..ROWS.min(rows.end() - first + 1) {
                let [wide, taken, hole] = of_row(&spans, k);
                let [left, right] = without(wide, taken);
                let row = Row { samples, at: (first + k) * stride, v: first + k };
                for (side, stretch) in [(1, left), (1, right), (0, hole)] {
                    out.run::<L, S>(&row, side, stretch, ground);
                }
            }
        }
        out.take_rows();
    }
}

/// The parallel curve of an ellipse lies inside the ellipse with both axes grown by this much.
#[inline(always)]
fn bulge(frame: &Frame) -> f64 {
    (frame.a + frame.b) / (2.0 * (frame.a * frame.b).sqrt())
}

/// Half the width and height of the ellipse with both axes grown, px.
#[inline(always)]
fn half_size(frame: &Frame, by: f64) -> [f64; 2] {
    let (a, b) = (frame.a + by, frame.b + by);
    let height = ((a * frame.sin) * (a * frame.sin) + (b * frame.cos) * (b * frame.cos)).sqrt();
    let width = ((a * frame.cos) * (a * frame.cos) + (b * frame.sin) * (b * frame.sin)).sqrt();
    [width, height]
}

/// Has a rectangle of an image brought near, all rows at once: read one after the other each is waited for.
#[inline(always)]
fn fetch<S>(samples: &[S], stride: usize, rows: RangeInclusive<usize>, columns: Range<usize>) {
    let per_line = LINE_BYTES / size_of::<S>();
    for v in rows {
        let (mut at, end) = (v * stride + columns.start, v * stride + columns.end);
        while at < end {
            lanes::fetch(samples, at);
            at += per_line;
        }
        lanes::fetch(samples, end);
    }
}

/// Columns of `whole` that are not in `hole`.
#[inline(always)]
fn without(whole: (usize, usize), hole: (usize, usize)) -> [(usize, usize); 2] {
    if hole.0 < hole.1 { [(whole.0, hole.0), (hole.1, whole.1)] } else { [whole, (0, 0)] }
}

impl Pixels {
    fn clear_runs(&mut self) {
        self.runs.iter_mut().for_each(Vec::clear);
        self.sums = [Sums::default(); 2];
        self.whole = [Whole::default(); 2];
    }

    /// Empty, to be summed up about the reference pixel of `other`.
    pub(super) fn start_beside(&mut self, other: &Self) {
        self.clear_runs();
        (self.reference, self.ground) = (other.reference, other.ground);
    }

    /// Adds what the rows say, and what was summed up of whole numbers, to the other sums.
    #[inline(always)]
    fn take_rows(&mut self) {
        for (side, sums) in self.sums.iter_mut().enumerate() {
            let (whole, runs) = (&self.whole[side], &self.runs[side]);
            sums.gu = lanes::sum(&whole.gu) + whole.more[1];
            sums.gg = lanes::sum(&whole.gg) + whole.more[2];
            sums.dd = lanes::sum(&whole.dd) + whole.more[3];
            sums.uu /= 12.0;
            // By rows, times the row and its square; of whole grey values all are whole numbers.
            let mut by_row = [[0.0; 4]; 3];
            for run in runs {
                let (own, v) = ([run.n, run.u, run.g, 0.0], run.v);
                for k in 0..4 {
                    let times_v = own[k] * v;
                    by_row[0][k] += own[k];
                    by_row[1][k] += times_v;
                    by_row[2][k] += times_v * v;
                }
            }
            let [[n, u, g, _], [nv, uv, gv, _], [nvv, ..]] = by_row;
            (sums.n, sums.u, sums.g) = (n, u, g);
            (sums.v, sums.uv, sums.gv, sums.vv) = (nv, uv, gv, nvv);
            sums.pairs = n - number(runs.len());
        }
    }

    /// Sums up a stretch of one side, from a column on and up to that behind its last; what else its row tells is summed up at the end. With
    /// `2 m = first + last`
    ///
    /// ```text
    /// sum of u = n m,   sum of u^2 = n (12 m^2 + n^2 - 1) / 12
    /// ```
    #[inline(always)]
    fn run<L: Lanes, S: Sample>(&mut self, row: &Row<S>, side: usize, (from, to): (usize, usize), ground: S) {
        if from >= to {
            return;
        }
        let (n, first, v) = (number(to - from), number(from) - self.reference.0, number(row.v) - self.reference.1);
        let g = S::take::<L>(&mut self.whole[side], row.samples, row.at + from..row.at + to, first, ground);
        let two_m = 2.0 * first + (n - 1.0);
        // Twelve times as much, a whole number.
        self.sums[side].uu += n * (3.0 * two_m * two_m + (n * n - 1.0));
        self.runs[side].push(Run { v, n, u: 0.5 * n * two_m, g });
    }

    /// Takes the pixels of a stretch one by one.
    #[inline(always)]
    fn take<L: Lanes, S: Sample>(&mut self, row: &Row<S>, frame: &Frame, (from, to): (usize, usize)) {
        if from >= to {
            return;
        }
        let (du, dv) = (number(from) - frame.u0, number(row.v) - frame.v0);
        let (x, y) = (frame.cos * du + frame.sin * dv, frame.cos * dv - frame.sin * du);
        let first = self.near.make_room(to - from);
        let samples = &row.samples[row.at + from..];
        let one = |x: f64| <L::Greys as Greys>::splat(x as f32);
        let (x, y, ground) = (one(x), one(y), one(-self.ground));
        let mut place = L::Greys::load(&PLACES);
        // Eight at a time wherever the row ends.
        for from in (0..to - from).step_by(EIGHT) {
            let mut own = [S::default(); EIGHT];
            match samples[from..].first_chunk::<EIGHT>() {
                Some(eight) => own = *eight,
                // The last of the image.
                None => own[..samples.len() - from].copy_from_slice(&samples[from..]),
            }
            let mut grey = [0.0; EIGHT];
            for i in 0..EIGHT {
                grey[i] = own[i].into();
            }
            let [xs, ys, greys] = self.near.eight(first + from);
            one(frame.cos).fused(place, x).store(xs);
            one(-frame.sin).fused(place, y).store(ys);
            (L::Greys::load(&grey) + ground).store(greys);
            place = place + one(EIGHT as f64);
        }
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::Ellipse;
    use crate::detect::sectors::normal_tails;
    use crate::frames::Pixel;

    /// Further off the edge shows less than a tenth of the noise, nearer it shows more, within the least and the most that is looked at.
    #[test]
    fn the_edge_is_felt_up_to_a_tenth_of_the_noise() {
        for noise in [0.03, 0.015, 0.01, 0.005] {
            let z = near_px(0.8, noise) / 0.8;
            let (mut tail, mut density) = ([0.0; 2], [0.0; 2]);
            normal_tails(&[z, z - 0.05], &mut tail, &mut density);
            assert!(tail[0] < 0.1 * noise && 0.1 * noise < tail[1], "{noise}: {z} blurs, {tail:?}");
        }
        assert_eq!([1.0, 1e-4, 0.0].map(|noise| near_px(2.0, noise)), [5.0, 7.0, 7.0]);
        assert_eq!([0.3, 0.5, 0.6].map(|blur_px| near_px(blur_px, 0.1)), [1.05, 1.75, 2.0]);
    }

    /// Sums over rows against sums over single pixels, and each pixel within reach once.
    #[test]
    fn rows_hold_every_pixel_once() {
        let (width, height) = (90, 80);
        let grey: Vec<u16> = (0..width * height).map(|i| ((i * i) % 251) as u16).collect();
        let view = GrayView::new(Samples::U16(&grey), width, height, width).expect("an image");
        let e = Ellipse { center_px: Pixel::new(44.3, 38.8), semi_major_px: 21.0, semi_minor_px: 14.0, angle_rad: 0.6 };
        let frame = Frame::new(&e);
        let mut out = Pixels::default();
        let rings = Rings { near: 3.0, inner: 8.0, outer: 7.0, thin: 1, fetch: true };
        assert!(lanes::run(Collect { view: &view, frame: &frame, rings, out: &mut out }));
        let inside = |d: f64, u: f64, v: f64| {
            let (du, dv) = (u - frame.u0, v - frame.v0);
            let (x, y) = (frame.cos * du + frame.sin * dv, frame.cos * dv - frame.sin * du);
            (x / (frame.a + d)).powi(2) + (y / (frame.b + d)).powi(2) <= 1.0
        };
        let near = 3.0 * (frame.a + frame.b) / (2.0 * (frame.a * frame.b).sqrt());
        let (mut count, mut plain) = (0, [Sums::default(); 2]);
        for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
            let (x, y) = (u as f64, v as f64);
            let in_band = inside(near, x, y) && !inside(-near, x, y);
            count += usize::from(in_band);
            let side = if inside(7.0, x, y) && !inside(near, x, y) {
                1
            } else if inside(-near, x, y) && !inside(-8.0, x, y) {
                0
            } else {
                continue;
            };
            let (x, y) = (x - out.reference.0, y - out.reference.1);
            let g = f64::from(view.get(u, v)) - out.ground;
            let s = &mut plain[side];
            (s.n, s.u, s.v, s.uu, s.uv, s.vv) = (s.n + 1.0, s.u + x, s.v + y, s.uu + x * x, s.uv + x * y, s.vv + y * y);
            (s.g, s.gu, s.gv, s.gg) = (s.g + g, s.gu + g * x, s.gv + g * y, s.gg + g * g);
        }
        assert_eq!(out.near.count, count);
        for side in 0..2 {
            assert!(plain[side].n > 100.0);
            assert_eq!(out.sums[side].matrix(), plain[side].matrix());
            assert_eq!(out.sums[side].right(), plain[side].right());
            assert_eq!(out.runs[side].iter().map(|r| r.n).sum::<f64>(), plain[side].n);
        }
    }

    /// What is further off is taken up where the rest ends: together every pixel within the outermost ellipse once.
    #[test]
    fn rows_further_off_hold_the_rest() {
        let (width, height) = (90, 80);
        let grey: Vec<u8> = (0..width * height).map(|i| ((i * i) % 251) as u8).collect();
        let view = GrayView::new(Samples::U8(&grey), width, height, width).expect("an image");
        let e = Ellipse { center_px: Pixel::new(44.3, 38.8), semi_major_px: 21.0, semi_minor_px: 14.0, angle_rad: 0.6 };
        let frame = Frame::new(&e);
        let (mut near, mut beyond) = (Pixels::default(), Pixels::default());
        let rings = Rings { near: 3.0, inner: 8.0, outer: 7.0, thin: 1, fetch: false };
        assert!(lanes::run(Collect { view: &view, frame: &frame, rings, out: &mut near }));
        beyond.start_beside(&near);
        lanes::run(Beyond { view: &view, frame: &frame, rings, outer: 15.5, out: &mut beyond });
        let within = |by: f64, u: f64, v: f64| {
            let (x, y) = (frame.cos * u + frame.sin * v, frame.cos * v - frame.sin * u);
            (x / (frame.a + by)).powi(2) + (y / (frame.b + by)).powi(2) <= 1.0
        };
        let mut wanted = [Sums::default(); 2];
        for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
            let at = |by: f64| within(by, u as f64 - frame.u0, v as f64 - frame.v0);
            let side = match (at(-8.0), at(7.0), at(15.5)) {
                (true, ..) => 0,
                (_, false, true) => 1,
                _ => continue,
            };
            let (x, y) = (u as f64 - near.reference.0, v as f64 - near.reference.1);
            let g = f64::from(view.get(u, v)) - near.ground;
            let s = &mut wanted[side];
            (s.n, s.u, s.v, s.uv, s.g, s.gv) = (s.n + 1.0, s.u + x, s.v + y, s.uv + x * y, s.g + g, s.gv + g * y);
        }
        for side in 0..2 {
            let (found, wanted) = (&beyond.sums[side], &wanted[side]);
            assert!(wanted.n > 100.0);
            let of = |s: &Sums| [s.n, s.u, s.v, s.uv, s.g, s.gv];
            assert_eq!(of(found), of(wanted), "side {side}");
        }
    }
}
