//! Integer images in whole numbers: smoothed grey levels, their difference from the local mean and the places where lines start, in one
//! pass and a third of the memory of [`crate::detect::plane`], which does the same for images of floats.
//!
//! ```text
//! S = binomial blur (1 4 6 4 1)^2 / 256, rounded to units;   F = 81 S - sum of S over 9 x 9 px
//! ```
//!
//! borders repeated. Units are as fine as 16 bits allow: 1/256 of a grey level for 8 bits, where `S` is exact. Of `F` the sign
//! says which side of a line a pixel is on, and the ratio of two neighbours where between them the line is: it is kept in units of 32,
//! held to 16 bits, beyond which no line lies between two pixels.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | S | `Whole::smooth` | `1 / per_grey` grey | smoothed image |
//! | F | `Whole::field` | 32/81 of that | the field whose zero lines are followed |

use crate::detect::level::Level;
use crate::detect::plane::repeat_ends;
use crate::image::{GrayView, Samples};
use crate::lanes::{self, Kernel, Lanes};

/// Half width of the window of the local mean, px.
const MEAN_RADIUS: usize = 4;
/// Binary digits of the field that are dropped.
const FIELD_SHIFT: i32 = 5;
/// Units that the noise must have at least.
const LEAST_NOISE: f32 = 4.0;
/// Pixels that are tested for starts together, and parts of them that are looked into.
const STRIDE: usize = 64;
const PART: usize = 8;

/// One level of the pyramid. Rows of `S` and `F` take turns in one piece of memory, in the order in which they are made: those of `F`
/// come when the four rows of `S` below are there.
#[derive(Debug, Default)]
pub(crate) struct Whole {
    data: Vec<u16>,
    width: usize,
    height: usize,
    per_grey: f32,
}

/// Where rows come from.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Rows<'a> {
    /// Samples, times two to a power.
    Samples(&'a GrayView<'a>, u32),
    /// Every second pixel of every second row of a finer level.
    Finer(&'a Whole),
}

/// The image as rows of whole numbers; none where 16 bits are too few for its noise, or it has floats.
pub(crate) fn rows<'a>(view: &'a GrayView<'a>, noise: f32) -> Option<Rows<'a>> {
    match view.samples() {
        Samples::U8(_) => Some(Rows::Samples(view, 0)),
        Samples::U16(s) => {
            let line = |v: usize| &s[v * view.stride()..][..view.width()];
            let most = (0..view.height()).map(|v| line(v).iter().fold(0, |m, x| *x.max(&m))).fold(0, u16::max);
            let shift = most.leading_zeros().min(8);
            ((1u32 << shift) as f32 * noise >= LEAST_NOISE).then_some(Rows::Samples(view, shift))
        }
        Samples::F32(_) => None,
    }
}

impl Level for Whole {
    fn width(&self) -> usize {
        self.width
    }
    fn height(&self) -> usize {
        self.height
    }
    #[inline]
    fn smooth(&self, u: usize, v: usize) -> f32 {
        f32::from(self.data[self.smooth_at(v) + u]) / self.per_grey
    }
    #[inline]
    fn square(&self, u: usize, v: usize) -> [[f64; 2]; 2] {
        let unit = 1.0 / f64::from(self.per_grey);
        let (top, bottom) = (&self.smooth_row(v)[u..u + 2], &self.smooth_row(v + 1)[u..u + 2]);
        [
            [f64::from(top[0]) * unit, f64::from(top[1]) * unit],
            [f64::from(bottom[0]) * unit, f64::from(bottom[1]) * unit],
        ]
    }
    #[inline]
    fn corners(&self, u: usize, v: usize) -> [f32; 4] {
        let row = |v: usize| &self.data[self.field_at(v) + u..][..2];
        let (top, bottom) = (row(v), row(v + 1));
        [top[0], top[1], bottom[1], bottom[0]].map(|x| f32::from(x as i16))
    }
    #[inline]
    fn field(&self, u: usize, v: usize) -> f32 {
        f32::from(self.data[self.field_at(v) + u] as i16)
    }
}

impl Whole {
    /// Where row `v` of the smoothed image starts.
    #[inline]
    fn smooth_at(&self, v: usize) -> usize {
        v.max(2 * v.max(2) - MEAN_RADIUS) * self.width
    }

    /// Where row `v` of the field starts.
    #[inline]
    fn field_at(&self, v: usize) -> usize {
        (2 * v + MEAN_RADIUS + 1).min(self.height + v) * self.width
    }

    #[inline(always)]
    fn smooth_row(&self, v: usize) -> &[u16] {
        &self.data[self.smooth_at(v)..][..self.width]
    }

    /// Makes a level; `starts` takes the places `v * width + u` where a line runs between `u` and `u + 1` and the grey level changes by more than
    /// `gradient`, row by row. At least 12 rows and columns.
    pub(crate) fn new(rows: Rows, gradient: f32, starts: &mut Vec<u32>) -> Self {
        starts.clear();
        lanes::run(Pass { rows, gradient, starts })
    }
}

struct Pass<'a> {
    rows: Rows<'a>,
    gradient: f32,
    starts: &'a mut Vec<u32>,
}

impl Kernel for Pass<'_> {
    type Output = Whole;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Whole {
        let (width, height, per_grey) = match self.rows {
            Rows::Samples(view, shift) => {
                let unit = if matches!(view.samples(), Samples::U8(_)) { 256.0 } else { (1u32 << shift) as f32 };
                (view.width(), view.height(), unit)
            }
            Rows::Finer(finer) => (finer.width.div_ceil(2), finer.height.div_ceil(2), finer.per_grey),
        };
        let mut out = Whole { data: Vec::with_capacity(2 * width * height), width, height, per_grey };
        let mut blur = Blur::new(width);
        let mut mean = Mean::new(width);
        // A difference of whole numbers is above a number where it is above its whole part.
        let least = (self.gradient * per_grey).min(65_535.0) as u16;
        for v in 0..height + MEAN_RADIUS {
            if v < height {
                blur.push(self.rows, v, height, &mut out.data);
            }
            if v >= MEAN_RADIUS {
                mean.push(&mut out, v - MEAN_RADIUS);
                find_starts(&out, v - MEAN_RADIUS, least, self.starts);
            }
        }
        out
    }
}

/// Room for another row. An iterator that appends would be compiled without vectors of the machine's width.
#[inline(always)]
fn next_row(data: &mut Vec<u16>, width: usize) -> &mut [u16] {
    let at = data.len();
    data.resize(at + width, 0);
    &mut data[at..]
}

/// The binomial.
struct Blur {
    /// Rows of a source that has to be widened, in a ring; the row that comes next.
    ring: [Vec<u16>; 5],
    next: usize,
    narrow: Vec<u16>,
    wide: Vec<u32>,
}

impl Blur {
    fn new(width: usize) -> Self {
        Self {
            ring: std::array::from_fn(|_| vec![0; width]),
            next: 0,
            narrow: vec![0; width + 4],
            wide: vec![0; width + 4],
        }
    }

    /// Appends row `v` of the blurred image.
    #[inline(always)]
    fn push(&mut self, rows: Rows, v: usize, height: usize, out: &mut Vec<u16>) {
        let last = height - 1;
        let near = [v.saturating_sub(2), v.saturating_sub(1), v, (v + 1).min(last), (v + 2).min(last)];
        match rows {
            Rows::Samples(view, shift) => match view.samples() {
                Samples::U8(s) => {
                    self.push_bytes(near.map(|k| &s[k * view.stride()..][..view.width()]), out);
                }
                Samples::U16(s) => {
                    let row = |k: usize, out: &mut [u16]| {
                        let from = &s[k * view.stride()..][..view.width()];
                        for (o, x) in out.iter_mut().zip(from) {
                            *o = *x << shift;
                        }
                    };
                    self.push_wide(row, near, out);
                }
                // `rows` makes none of these.
                Samples::F32(_) => {}
            },
            Rows::Finer(finer) => {
                let row = |k: usize, out: &mut [u16]| {
                    // Whole pairs in a plain loop, for vectors; of an odd row its last pixel besides.
                    let pairs = finer.smooth_row(2 * k).chunks_exact(2);
                    if let ([last], Some(o)) = (pairs.remainder(), out.last_mut()) {
                        *o = *last;
                    }
                    for (o, x) in out.iter_mut().zip(pairs) {
                        *o = x[0];
                    }
                };
                self.push_wide(row, near, out);
            }
        }
    }

    /// Bytes: every sum fits 16 bits, and the last one is the result in units of 1/256.
    #[inline(always)]
    fn push_bytes(&mut self, r: [&[u8]; 5], out: &mut Vec<u16>) {
        let n = self.narrow.len() - 4;
        let (r0, r1, r2, r3, r4) = (&r[0][..n], &r[1][..n], &r[2][..n], &r[3][..n], &r[4][..n]);
        for (i, c) in self.narrow[2..n + 2].iter_mut().enumerate() {
            let (outer, inner) = (u16::from(r0[i]) + u16::from(r4[i]), u16::from(r1[i]) + u16::from(r3[i]));
            *c = outer + 4 * inner + 6 * u16::from(r2[i]);
        }
        repeat_ends(&mut self.narrow, 2);
        let c = &self.narrow;
        let (a, b, c, d, e) = (&c[..n], &c[1..=n], &c[2..n + 2], &c[3..n + 3], &c[4..n + 4]);
        for (i, o) in next_row(out, n).iter_mut().enumerate() {
            *o = a[i] + e[i] + 4 * (b[i] + d[i]) + 6 * c[i];
        }
    }

    /// Sixteen bits: sums of 32, rounded.
    #[inline(always)]
    fn push_wide(&mut self, row: impl Fn(usize, &mut [u16]), near: [usize; 5], out: &mut Vec<u16>) {
        while self.next <= near[4] {
            row(self.next, &mut self.ring[self.next % 5]);
            self.next += 1;
        }
        let n = self.wide.len() - 4;
        let [r0, r1, r2, r3, r4] = near.map(|k| &self.ring[k % 5][..n]);
        for (i, c) in self.wide[2..n + 2].iter_mut().enumerate() {
            let (outer, inner) = (u32::from(r0[i]) + u32::from(r4[i]), u32::from(r1[i]) + u32::from(r3[i]));
            *c = outer + 4 * inner + 6 * u32::from(r2[i]);
        }
        repeat_ends(&mut self.wide, 2);
        let c = &self.wide;
        let (a, b, c, d, e) = (&c[..n], &c[1..=n], &c[2..n + 2], &c[3..n + 3], &c[4..n + 4]);
        for (i, o) in next_row(out, n).iter_mut().enumerate() {
            *o = ((a[i] + e[i] + 4 * (b[i] + d[i]) + 6 * c[i] + 128) >> 8) as u16;
        }
    }
}

/// Sums over nine rows and columns; those of the rows are carried along.
struct Mean {
    column: Vec<u32>,
    across: Vec<u32>,
}

impl Mean {
    fn new(width: usize) -> Self {
        const R: usize = MEAN_RADIUS;
        Self { column: vec![0; width + 2 * R], across: vec![0; width + 2 * R - 2] }
    }

    /// Appends row `v` of the field; the rows of the smoothed image down to `v + 4` are there.
    #[inline(always)]
    fn push(&mut self, level: &mut Whole, v: usize) {
        const R: usize = MEAN_RADIUS;
        let (n, last) = (level.width, level.height - 1);
        let column = &mut self.column[R..R + n];
        if v == 0 {
            for k in 0..=2 * R {
                let row = level.smooth_row(k.saturating_sub(R).min(last));
                column.iter_mut().zip(row).for_each(|(c, x)| *c += u32::from(*x));
            }
        } else {
            let (new, old) = (level.smooth_row((v + R).min(last)), level.smooth_row(v.saturating_sub(R + 1)));
            for (i, c) in column.iter_mut().enumerate() {
                *c = *c + u32::from(new[i]) - u32::from(old[i]);
            }
        }
        repeat_ends(&mut self.column, R);
        let m = self.across.len();
        let (a, b, c) = (&self.column[..m], &self.column[1..=m], &self.column[2..m + 2]);
        for (i, s) in self.across.iter_mut().enumerate() {
            *s = a[i] + b[i] + c[i];
        }
        let (a, b, c) = (&self.across[..n], &self.across[3..n + 3], &self.across[6..n + 6]);
        let (at, own_at) = (level.data.len(), level.smooth_at(v));
        level.data.resize(at + n, 0);
        let (done, field) = level.data.split_at_mut(at);
        let own = &done[own_at..][..n];
        for (i, f) in field.iter_mut().enumerate() {
            let x = 81 * i32::from(own[i]) - (a[i] + b[i] + c[i]) as i32;
            *f = ((x + (1 << (FIELD_SHIFT - 1))) >> FIELD_SHIFT).clamp(-32_768, 32_767) as i16 as u16;
        }
    }
}

/// Places of row `v` where a line starts.
#[inline(always)]
fn find_starts(level: &Whole, v: usize, least: u16, starts: &mut Vec<u32>) {
    let n = level.width - 1;
    let smooth = level.smooth_row(v);
    let field = &level.data[level.field_at(v)..][..level.width];
    if v + 1 == level.height {
        return;
    }
    for from in (0..n).step_by(STRIDE) {
        let end = (from + STRIDE).min(n);
        let m = end - from;
        let (s, t) = (&smooth[from..end], &smooth[from + 1..end + 1]);
        let (f, g) = (&field[from..end], &field[from + 1..end + 1]);
        // Plain loops, for vectors: most stretches show nothing, and of the others most parts.
        if any_start([s, t, f, g], least) == 0 {
            continue;
        }
        for part in (0..m).step_by(PART) {
            let part = part..(part + PART).min(m);
            if any_start([s, t, f, g].map(|x| &x[part.clone()]), least) != 0 {
                let found = part.filter(|i| start(s[*i], t[*i], f[*i], g[*i], least) != 0);
                starts.extend(found.map(|i| (v * level.width + from + i) as u32));
            }
        }
    }
}

/// Not zero where a line starts anywhere in a stretch.
#[inline(always)]
fn any_start([s, t, f, g]: [&[u16]; 4], least: u16) -> u16 {
    let n = s.len();
    let (t, f, g) = (&t[..n], &f[..n], &g[..n]);
    let mut any = 0;
    for i in 0..n {
        any |= start(s[i], t[i], f[i], g[i], least);
    }
    any
}

/// Not zero where two neighbours differ by more than `least` and a line runs between them.
#[inline(always)]
fn start(s: u16, t: u16, f: u16, g: u16, least: u16) -> u16 {
    let steep = (s.max(t) - s.min(t)).saturating_sub(least);
    let apart = (f as i16 > 0) != (g as i16 > 0);
    if apart { steep } else { 0 }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::detect::plane::{Floats, Source};

    /// Grey values of so many bits, of noise upon a few steps.
    fn greys(count: usize, width: usize, bits: u32) -> Vec<u16> {
        let mut state = 7u32;
        (0..count)
            .map(|i| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let step = if (i % width / 11 + i / width / 9).is_multiple_of(2) { 0.7 } else { 0.1 };
                let grey = step + 0.2 * f64::from(state >> 16) / 65_536.0;
                (grey * f64::from((1u32 << bits) - 1)) as u16
            })
            .collect()
    }

    /// Against the pass in floats, at three levels: the same numbers to rounding, the same starts.
    #[test]
    fn whole_numbers_are_the_floats() {
        for (width, height, bits) in [(49, 48, 8), (70, 61, 8), (64, 50, 12), (57, 55, 16), (130, 52, 16)] {
            let grey = greys(width * height, width, bits);
            let bytes: Vec<u8> = grey.iter().map(|x| *x as u8).collect();
            let samples = if bits == 8 { Samples::U8(&bytes) } else { Samples::U16(&grey) };
            let view = GrayView::new(samples, width, height, width).expect("an image");
            let scale = f64::from((1u32 << bits) - 1);
            let gradient = (0.05 * scale) as f32;
            let mut wanted = rows(&view, 0.02 * scale as f32).expect("16 bits suffice");
            let mut source = Source::View(&view);
            let (mut finer, mut halved);
            for level in 0..3 {
                let (mut starts, mut of_floats) = (vec![], vec![]);
                let whole = Whole::new(wanted, gradient, &mut starts);
                let floats = Floats::new(source, gradient, &mut of_floats);
                let unit = 1.0 / whole.per_grey;
                for (u, v) in (0..whole.height()).flat_map(|v| (0..whole.width()).map(move |u| (u, v))) {
                    let (s, t) = (whole.smooth(u, v), floats.smooth(u, v));
                    assert!((s - t).abs() < 1.1 * unit, "{bits} bit, level {level} ({u}, {v}): {s} {t}");
                    let f = whole.field(u, v) * 32.0 / 81.0 * unit;
                    let (f, g) = (f, floats.field(u, v).clamp(-12_945.0 * unit, 12_944.0 * unit));
                    assert!((f - g).abs() < 2.5 * unit, "{bits} bit, level {level} ({u}, {v}): {f} {g}");
                }
                // Rounding may move a start that lies upon a limit.
                let differ = starts.iter().filter(|s| !of_floats.contains(s)).count()
                    + of_floats.iter().filter(|s| !starts.contains(s)).count();
                assert!(starts.len() > 10 >> level && differ * 50 <= starts.len(), "{differ} of {}", starts.len());
                halved = floats.smoothed().halved();
                source = Source::Plane(&halved);
                finer = whole;
                wanted = Rows::Finer(&finer);
            }
        }
    }

    #[test]
    fn noise_finer_than_the_unit_is_left_to_floats() {
        let grey = vec![60_000u16; 400];
        let view = GrayView::new(Samples::U16(&grey), 20, 20, 20).expect("an image");
        assert!(rows(&view, 3.0).is_none());
        assert!(rows(&view, 5.0).is_some());
    }

    #[derive(Clone)]
    struct Made<'a>(&'a GrayView<'a>);
    impl Kernel for Made<'_> {
        type Output = (Vec<u16>, Vec<u32>);
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let mut starts = vec![];
            let pass = Pass { rows: Rows::Samples(self.0, 0), gradient: 10.0, starts: &mut starts };
            let data = pass.run::<L>().data;
            (data, starts)
        }
    }

    #[test]
    fn any_width_gives_the_same_bits() {
        let grey: Vec<u8> = greys(90 * 40, 90, 8).iter().map(|x| *x as u8).collect();
        let view = GrayView::new(Samples::U8(&grey), 90, 40, 90).expect("an image");
        let all = lanes::run_all(&Made(&view));
        assert!(all[0].1.len() > 50);
        all.iter().for_each(|one| assert_eq!(*one, all[0]));
    }
}
