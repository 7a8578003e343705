//! Integer images in whole numbers: smoothed grey levels, their difference from the local mean near edges and the places where lines start,
//! with a quarter of the memory of [`crate::detect::plane`], which does the same for images of floats.
//!
//! ```text
//! S = binomial blur (1 4 6 4 1)^2 / 256, rounded to units;   F = 81 S - sum of S over 9 x 9 px
//! ```
//!
//! borders repeated. Units are as fine as 16 bits allow: 1/256 of a grey level for 8 bits, where `S` is exact. Of `F` the sign
//! says which side of a line a pixel is on, and the ratio of two neighbours where between them the line is: it is in units of 32,
//! held to 16 bits, beyond which no line lies between two pixels.
//!
//! Lines start at edges and run along them. `F` is kept in stretches of 32 pixels of a row, where one of them or of those above and below is
//! steep; where a line wanders off, `F` is found for each pixel that it asks for, to the same number.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | S | `Whole::smooth` | `1 / per_grey` grey | smoothed image |
//! | F | `Whole::field` | 32/81 of that | the field whose zero lines are followed |

mod binomial;
mod stretches;

use crate::detect::Detection;
use crate::detect::level::{Level, Places};
use crate::image::{GrayView, Samples};
use crate::lanes;
use crate::threads::{self, OwnMemory};
use binomial::{Blur, Smooth};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};
use stretches::{Find, Finder, Found, STRETCH, Smoothed};

/// Units that the noise must have at least.
const LEAST_NOISE: f32 = 4.0;
/// Rows that are worked on together, by one thread, and the least pixels of an image that several share.
const ROWS: usize = 32;
const SHARED: usize = 200_000;
/// Levels of the pyramid.
pub(crate) const LEVELS: usize = 3;
/// Memory that is kept of one search, bytes at most.
const KEPT: usize = 128 << 20;

/// Memory of searches for discs, to be used again by the next: what the system gives and takes back for each image costs time, most of all where
/// threads wait for each other there. Any number of threads may search with one memory; it holds what so many searches at a time needed, some 6
/// bytes per pixel, at most 128 MB for each: what was more is given back. A result that the caller has replaced may be left to it: the next search drops it.
#[derive(Debug, Default)]
pub struct DetectMemory {
    levels: Mutex<Vec<[Whole; LEVELS]>>,
    /// What a search found that nobody asks for any more, to be dropped where a thread of the next has nothing to do.
    replaced: Mutex<Option<Detection>>,
}

impl DetectMemory {
    /// Does a piece of work with the levels of an image before.
    pub(crate) fn with<R>(&self, work: impl FnOnce(&mut [Whole]) -> R) -> R {
        let spare = || self.levels.lock().unwrap_or_else(PoisonError::into_inner);
        let mut levels = spare().pop().unwrap_or_default();
        let out = work(&mut levels);
        if levels.iter().map(Whole::bytes).sum::<usize>() <= KEPT {
            spare().push(levels);
        }
        out
    }

    /// Takes what nobody asks for any more.
    pub(crate) fn take_replaced(&self, found: Detection) {
        let before = self.replaced.lock().unwrap_or_else(PoisonError::into_inner).replace(found);
        drop(before);
    }

    /// Drops it.
    pub(crate) fn drop_replaced(&self) {
        let found = self.replaced.lock().unwrap_or_else(PoisonError::into_inner).take();
        drop(found);
    }
}

/// One level of the pyramid.
#[derive(Debug, Default)]
pub(crate) struct Whole {
    smooth: Vec<u16>,
    /// Every second pixel of every second row, from which the next level is made; nothing of the last level.
    halved: Vec<u16>,
    /// Row by row, which stretches of the field are kept.
    kept: Vec<bool>,
    /// The field, row by row in whole stretches; memory of those that are not kept is not touched.
    field: Vec<i16>,
    /// Where lines start, for each band of rows.
    starts: Vec<Vec<u32>>,
    marks: Mutex<Marks>,
    width: usize,
    height: usize,
    per_grey: f32,
}

/// Bits for those who follow lines: made ready with the level, while its threads have nothing to wait for.
#[derive(Debug, Default)]
struct Marks {
    /// None of them set.
    ready: Vec<u64>,
    given_back: Vec<u64>,
}

/// Where rows come from.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Rows<'a> {
    /// Samples, times two to a power.
    Samples(&'a GrayView<'a>, u32),
    /// Every second pixel of every second row of a finer level, which must not be the last.
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
    fn starts(&self) -> impl Iterator<Item = u32> {
        self.starts.iter().flatten().copied()
    }
    fn width(&self) -> usize {
        self.width
    }
    fn height(&self) -> usize {
        self.height
    }
    #[inline]
    fn smooth(&self, u: usize, v: usize) -> f32 {
        f32::from(self.smooth[v * self.width + u]) / self.per_grey
    }
    #[inline(always)]
    fn greys<const K: usize>(&self, u_px: &[f64; K], v_px: &[f64; K], out: &mut [f64; K]) {
        let places = Places::of([u_px, v_px], [self.width, self.height]);
        // Neighbours of a row as one number: what is fetched one by one is half as much, and all are turned to floats together.
        let pair = |of: &[u16]| u32::from(of[0]) | u32::from(of[1]) << 16;
        let mut pairs = [[0_u32; K]; 2];
        for k in 0..K {
            let [u, v] = places.first(k);
            let both = &self.smooth[v * self.width + u..][..self.width + 2];
            (pairs[0][k], pairs[1][k]) = (pair(&both[..2]), pair(&both[self.width..]));
        }
        let (mut corners, unit) = ([[0.0; K]; 4], 1.0 / f64::from(self.per_grey));
        for row in 0..2 {
            for k in 0..K {
                let [left, right] = [pairs[row][k] & 0xffff, pairs[row][k] >> 16].map(|x| f64::from(x as i32) * unit);
                (corners[2 * row][k], corners[2 * row + 1][k]) = (left, right);
            }
        }
        places.blend(&corners, out);
    }
    #[inline(always)]
    fn field(&self, u: usize, v: usize) -> f32 {
        let count = self.stretches();
        f32::from(match self.kept[v * count + u / STRETCH] {
            true => self.field[v * count * STRETCH + u],
            false => self.smoothed().field(u, v),
        })
    }
    fn marks(&self) -> Vec<u64> {
        let words = (self.width * self.height).div_ceil(64);
        let ready = std::mem::take(&mut self.marks.lock().unwrap_or_else(PoisonError::into_inner).ready);
        if ready.len() == words { ready } else { vec![0; words] }
    }
    fn keep_marks(&self, marks: Vec<u64>) {
        self.marks.lock().unwrap_or_else(PoisonError::into_inner).given_back = marks;
    }
    #[inline(always)]
    fn fetch(&self, u: usize, v: usize) {
        lanes::fetch(&self.smooth, v * self.width + u);
        lanes::fetch(&self.field, v * self.stretches() * STRETCH + u);
    }
}

impl Whole {
    fn smoothed(&self) -> Smoothed<'_> {
        Smoothed { data: &self.smooth, width: self.width, height: self.height }
    }

    /// Stretches of a row.
    #[inline(always)]
    fn stretches(&self) -> usize {
        self.width.div_ceil(STRETCH)
    }

    /// Memory held, bytes.
    fn bytes(&self) -> usize {
        let starts: usize = self.starts.iter().map(Vec::capacity).sum();
        let numbers = self.smooth.capacity() + self.halved.capacity() + self.field.capacity();
        let marks = self.marks.lock().unwrap_or_else(PoisonError::into_inner);
        2 * numbers + self.kept.capacity() + 4 * starts + 8 * (marks.ready.capacity() + marks.given_back.capacity())
    }

    /// Makes a level in the memory of another, `last` where no coarser one is made from it; lines start where the grey level changes by more than
    /// `gradient`. At least 12 rows and columns. Within a pool its threads share the rows.
    pub(crate) fn remake(&mut self, rows: Rows, gradient: f32, last: bool) {
        let (width, height, per_grey) = match rows {
            Rows::Samples(view, shift) => {
                let unit = if matches!(view.samples(), Samples::U8(_)) { 256.0 } else { (1u32 << shift) as f32 };
                (view.width(), view.height(), unit)
            }
            Rows::Finer(finer) => (finer.width.div_ceil(2), finer.height.div_ceil(2), finer.per_grey),
        };
        (self.width, self.height, self.per_grey) = (width, height, per_grey);
        sized(&mut self.smooth, width * height);
        sized(&mut self.halved, if last { 0 } else { width.div_ceil(2) * height.div_ceil(2) });
        let stretches = self.stretches() * height;
        sized(&mut self.kept, stretches);
        sized(&mut self.field, stretches * STRETCH);
        self.starts.resize_with(height.div_ceil(ROWS), Vec::new);
        let marks = self.marks.get_mut().unwrap_or_else(PoisonError::into_inner);
        if marks.ready.is_empty() {
            std::mem::swap(&mut marks.ready, &mut marks.given_back);
        }
        sized(&mut marks.ready, (width * height).div_ceil(64));
        // A difference of whole numbers is above a number where it is above its whole part.
        let least = (gradient * per_grey).min(65_535.0) as u16;
        if threads::several() && width * height >= SHARED {
            self.fill_side_by_side(rows, least);
        } else {
            self.fill(rows, least);
        }
    }

    /// Band after band, each looked at once the rows below it are smoothed, while they are still near.
    fn fill(&mut self, rows: Rows, least: u16) {
        let Self { smooth, halved, kept, field, starts, marks, width, height, .. } = self;
        marks.get_mut().unwrap_or_else(PoisonError::into_inner).ready.fill(0);
        let (width, height, count) = (*width, *height, width.div_ceil(STRETCH));
        let mut halves = halved.chunks_mut(ROWS / 2 * width.div_ceil(2));
        let (mut finder, mut blur) = (Finder::new(width), Blur::new(width));
        let mut bands = kept.chunks_mut(ROWS * count).zip(field.chunks_mut(ROWS * count * STRETCH)).zip(starts);
        let mut finish = |smooth: &[u16], first: usize| {
            let on = Smoothed { data: smooth, width, height };
            let Some(((kept, field), starts)) = bands.next() else { return };
            lanes::run(Find { on, first, least, finder: &mut finder, out: Found { kept, field, starts } });
        };
        for (k, first) in (0..height).step_by(ROWS).enumerate() {
            let out = &mut smooth[first * width..(first + ROWS).min(height) * width];
            let halved = halves.next().unwrap_or_default();
            lanes::run(Smooth { rows, first, width, height, out, halved, blur: &mut blur });
            if k > 0 {
                finish(smooth, first - ROWS);
            }
        }
        finish(smooth, (height - 1) / ROWS * ROWS);
    }

    /// The same with the threads of the pool. What is carried along from row to row is there where the next band is one's own, too.
    fn fill_side_by_side(&mut self, rows: Rows, least: u16) {
        let (width, height, count) = (self.width, self.height, self.stretches());
        let mut halves = self.halved.chunks_mut(ROWS / 2 * width.div_ceil(2));
        let marks = &mut self.marks.get_mut().unwrap_or_else(PoisonError::into_inner).ready;
        let words = marks.len().div_ceil(height.div_ceil(ROWS));
        let mut marks = marks.chunks_mut(words);
        let bands = self.smooth.chunks_mut(ROWS * width).enumerate();
        let bands = bands.map(|(k, out)| (k, out, halves.next().unwrap_or_default(), marks.next().unwrap_or_default()));
        let (bands, memory) = (bands.collect::<Vec<_>>(), OwnMemory::<Option<(Blur, Finder)>>::new());
        let new = || (Blur::new(width), Finder::new(width));
        bands.into_par_iter().with_max_len(1).for_each(|(k, out, halved, marks)| {
            marks.fill(0);
            memory.with(|own| {
                let (blur, _) = own.get_or_insert_with(new);
                lanes::run(Smooth { rows, first: k * ROWS, width, height, out, halved, blur });
            });
        });
        let on = Smoothed { data: &self.smooth, width, height };
        let kept = self.kept.par_chunks_mut(ROWS * count);
        let bands = kept.zip(self.field.par_chunks_mut(ROWS * count * STRETCH)).zip(&mut self.starts);
        bands.enumerate().with_max_len(1).for_each(|(k, ((kept, field), starts))| {
            let out = Found { kept, field, starts };
            memory.with(|own| {
                let (_, finder) = own.get_or_insert_with(new);
                lanes::run(Find { on, first: k * ROWS, least, finder, out });
            });
        });
    }
}

/// As many places, of which those that were there keep what they hold.
fn sized<T: Copy + Default>(list: &mut Vec<T>, count: usize) {
    if list.capacity() < count {
        *list = vec![T::default(); count];
    } else {
        list.resize(count, T::default());
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::detect::plane::{Floats, Source};
    use crate::lanes::{Kernel, Lanes};

    fn made(rows: Rows, gradient: f32) -> Whole {
        let mut level = Whole::default();
        level.remake(rows, gradient, false);
        level
    }

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
                let whole = made(wanted, gradient);
                let floats = Floats::new(source, gradient);
                let starts: Vec<u32> = whole.starts().collect();
                let of_floats: Vec<u32> = floats.starts().collect();
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

    /// The field at a pixel, where it is kept.
    fn kept(level: &Whole, u: usize, v: usize) -> Option<i16> {
        let count = level.stretches();
        level.kept[v * count + u / STRETCH].then(|| level.field[v * count * STRETCH + u])
    }

    #[derive(Clone)]
    struct Made<'a>(&'a GrayView<'a>);
    impl Kernel for Made<'_> {
        type Output = (Vec<u16>, Vec<u32>, Vec<i16>);
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let (rows, width, height) = (Rows::Samples(self.0, 0), self.0.width(), self.0.height());
            let mut smooth = vec![0; width * height];
            Smooth { rows, first: 0, width, height, out: &mut smooth, halved: &mut [], blur: &mut Blur::new(width) }
                .run::<L>();
            let on = Smoothed { data: &smooth, width, height };
            let count = height * width.div_ceil(STRETCH);
            let (mut kept, mut field, mut starts) = (vec![false; count], vec![0; count * STRETCH], vec![]);
            let out = Found { kept: &mut kept, field: &mut field, starts: &mut starts };
            Find { on, first: 0, least: 2560, finder: &mut Finder::new(width), out }.run::<L>();
            (smooth, starts, field)
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

    /// A few steps in an even image, so that most stretches are not kept: each pixel's field is the same in a stretch and asked for alone, and
    /// threads that share the rows find what one finds.
    #[test]
    fn stretches_and_bands_are_all_one() {
        let (width, height) = (617, 371);
        let noise = greys(width * height, width, 8);
        let grey: Vec<u8> = (0..width * height)
            .map(|i| {
                let (u, v) = (i % width, i / width);
                let dark = (u / 130 + v / 95).is_multiple_of(2) && u % 130 > 60 && v % 95 > 40;
                if dark { 40 } else { 180 + (noise[i] % 4) as u8 }
            })
            .collect();
        let view = GrayView::new(Samples::U8(&grey), width, height, width).expect("an image");
        let both = || {
            let fine = made(Rows::Samples(&view, 0), 8.0);
            let coarse = made(Rows::Finer(&fine), 8.0);
            [fine, coarse]
        };
        let alone = both();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().expect("threads");
        let shared = pool.install(both);
        let per_pixel = alone.iter().map(Whole::bytes).sum::<usize>() as f64 / (width * height) as f64;
        assert!((3.0..6.0).contains(&per_pixel), "{per_pixel} bytes per pixel");
        for (a, b) in alone.iter().zip(&shared) {
            assert_eq!(a.smooth, b.smooth);
            assert!(a.starts().eq(b.starts()));
            assert!(a.starts().count() > 100, "{}", a.starts().count());
            let (mut in_stretches, mut asked) = (0, 0);
            for (u, v) in (0..a.height).flat_map(|v| (0..a.width).map(move |u| (u, v))) {
                let direct = a.smoothed().field(u, v);
                let found = kept(a, u, v);
                assert_eq!(found, kept(b, u, v), "({u}, {v})");
                match found {
                    Some(field) => {
                        in_stretches += 1;
                        assert_eq!(field, direct, "({u}, {v})");
                    }
                    None => asked += 1,
                }
                if u + 1 < a.width && v + 1 < a.height {
                    let plain = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| a.smoothed().field(u + i, v + j));
                    assert_eq!(a.corners(u, v), plain.map(f32::from), "({u}, {v})");
                }
            }
            let least = a.width * a.height / 10;
            assert!(in_stretches > least && 2 * asked > 5 * least, "{in_stretches} kept, {asked} not");
        }
    }

    /// What an image before left in the memory is of no meaning for the next, be it smaller, larger or deeper.
    #[test]
    fn memory_used_again_leaves_no_trace() {
        let mut used = Whole::default();
        for (width, height, bits) in [(190, 250, 8), (64, 50, 12), (260, 131, 8), (190, 250, 16)] {
            let grey = greys(width * height, width, bits);
            let bytes: Vec<u8> = grey.iter().map(|x| *x as u8).collect();
            let samples = if bits == 8 { Samples::U8(&bytes) } else { Samples::U16(&grey) };
            let view = GrayView::new(samples, width, height, width).expect("an image");
            let rows = rows(&view, 0.02 * ((1u32 << bits) - 1) as f32).expect("16 bits suffice");
            let gradient = (0.05 * f64::from((1u32 << bits) - 1)) as f32;
            used.remake(rows, gradient, false);
            let fresh = made(rows, gradient);
            assert_eq!((used.width, used.height, used.per_grey), (fresh.width, fresh.height, fresh.per_grey));
            assert_eq!((&used.smooth, &used.halved, &used.kept), (&fresh.smooth, &fresh.halved, &fresh.kept));
            assert!(fresh.starts().count() > 10 && used.starts().eq(fresh.starts()));
            for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
                assert_eq!(kept(&used, u, v), kept(&fresh, u, v), "({u}, {v}) of {width} x {height}");
            }
        }
    }

    /// Bits are there once for each image, and none is set, whatever was given back.
    #[test]
    fn marks_used_again_are_blank() {
        let grey = greys(700 * 320, 700, 8);
        let bytes: Vec<u8> = grey.iter().map(|x| *x as u8).collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("threads");
        let mut level = Whole::default();
        for (width, height) in [(700, 300), (650, 310), (90, 40), (700, 300)] {
            let view = GrayView::new(Samples::U8(&bytes), width, height, 700).expect("an image");
            pool.install(|| level.remake(Rows::Samples(&view, 0), 8.0, true));
            for _ in 0..2 {
                let mut marks = level.marks();
                assert_eq!(marks.len(), (width * height).div_ceil(64));
                assert!(marks.iter().all(|x| *x == 0), "{width} x {height}");
                marks.fill(u64::MAX);
                level.keep_marks(marks);
            }
        }
    }

    /// Memory is kept for the next search, one for each at a time, and given up where it is too much.
    #[test]
    fn memory_is_kept_up_to_a_limit() {
        let grey = greys(90 * 40, 90, 16);
        let view = GrayView::new(Samples::U16(&grey), 90, 40, 90).expect("an image");
        let memory = DetectMemory::default();
        let held = || memory.with(|levels| levels.iter().map(Whole::bytes).sum::<usize>());
        assert_eq!(held(), 0);
        memory.with(|levels| {
            levels[0].remake(rows(&view, 1e3).expect("16 bits suffice"), 1e3, true);
            assert_eq!(held(), 0, "a search beside it has its own");
        });
        assert!(held() >= 2 * 90 * 40, "{} bytes", held());
        memory.with(|levels| levels[1].smooth.reserve(KEPT));
        assert_eq!(held(), 0);
    }
}
