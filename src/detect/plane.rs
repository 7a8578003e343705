//! Grey levels as floats, smoothed, and their difference from the local mean.
//!
//! The difference `s - m` (s: binomial blur, sigma 1 px; m: mean of `s` over 9 x 9 px) changes sign at every edge, however uneven
//! the light: its zero line is the first guess of a contour.

use crate::detect::level::Level;
use crate::error::{Invalid, Result};
use crate::image::{GrayView, Samples};
use crate::lanes::{self, Kernel, Lanes as Width};

/// Half width of the window of the local mean, px.
const MEAN_RADIUS: usize = 4;

/// A packed image of floats.
#[derive(Debug, Clone, Default)]
pub(crate) struct Plane {
    /// Row-major samples.
    pub(crate) data: Vec<f32>,
    /// Width, px.
    pub(crate) width: usize,
    /// Height, px.
    pub(crate) height: usize,
}

impl Plane {
    /// Row `v`.
    pub(crate) fn row(&self, v: usize) -> &[f32] {
        &self.data[v * self.width..(v + 1) * self.width]
    }

    /// Grey level at a pixel.
    #[inline]
    pub(crate) fn at(&self, u: usize, v: usize) -> f32 {
        self.data[v * self.width + u]
    }

    /// Every second pixel of every second row; pixel (u, v) becomes (2 u, 2 v) of the finer level.
    pub(crate) fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut data = Vec::with_capacity(width * height);
        for v in 0..height {
            data.extend(self.row(2 * v).iter().step_by(2));
        }
        Self { data, width, height }
    }
}

/// Where rows of grey levels come from.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source<'a> {
    View(&'a GrayView<'a>),
    Plane(&'a Plane),
}

impl Source<'_> {
    pub(crate) fn width(&self) -> usize {
        match self {
            Self::View(view) => view.width(),
            Self::Plane(plane) => plane.width,
        }
    }

    pub(crate) fn height(&self) -> usize {
        match self {
            Self::View(view) => view.height(),
            Self::Plane(plane) => plane.height,
        }
    }

    #[inline(always)]
    fn row(&self, v: usize, out: &mut [f32]) {
        match self {
            Self::View(view) => {
                let at = v * view.stride()..v * view.stride() + view.width();
                match view.samples() {
                    Samples::U8(s) => out.iter_mut().zip(&s[at]).for_each(|(o, x)| *o = f32::from(*x)),
                    Samples::U16(s) => out.iter_mut().zip(&s[at]).for_each(|(o, x)| *o = f32::from(*x)),
                    Samples::F32(s) => out.copy_from_slice(&s[at]),
                }
            }
            Self::Plane(plane) => out.copy_from_slice(plane.row(v)),
        }
    }
}

/// Checks that all samples of a view are finite.
///
/// # Errors
/// [`Invalid::Value`] where a sample is not.
pub(crate) fn check_finite(view: &GrayView) -> Result<()> {
    if let Samples::F32(s) = view.samples() {
        for v in 0..view.height() {
            let row = &s[v * view.stride()..v * view.stride() + view.width()];
            if let Some(bad) = row.iter().find(|x| !x.is_finite()) {
                return Err(Invalid::value("grey level", f64::from(*bad), "a finite number").into());
            }
        }
    }
    Ok(())
}

/// Standard deviation of the pixel noise, grey levels, from second differences that planes and edges leave at zero.
pub(crate) fn noise(view: &GrayView) -> f32 {
    let (width, height) = (view.width(), view.height());
    if width < 3 || height < 3 {
        return 0.0;
    }
    // A few ten thousand pixels fix the median to a per cent.
    let step = ((width * height / 40_000) as f64).sqrt().floor().max(1.0) as usize;
    if let Samples::U8(s) = view.samples() {
        return noise_of_bytes(s, view, step);
    }
    let mut seen = Vec::with_capacity(60_000);
    for v in (1..height - 1).step_by(step) {
        for u in (1..width - 1).step_by(step) {
            let at = |du: usize, dv: usize| view.get(u + du - 1, v + dv - 1);
            let corners = at(0, 0) + at(2, 0) + at(0, 2) + at(2, 2);
            let d = corners - 2.0 * (at(1, 0) + at(1, 2) + at(0, 1) + at(2, 1)) + 4.0 * at(1, 1);
            seen.push(d.abs());
        }
    }
    let middle = seen.len() / 2;
    let (_, median, _) = seen.select_nth_unstable_by(middle, f32::total_cmp);
    *median / (0.6745 * 6.0)
}

/// The same of bytes, whose differences are few enough to be counted.
fn noise_of_bytes(grey: &[u8], view: &GrayView, step: usize) -> f32 {
    let mut counts = vec![0usize; 8 * 255 + 1];
    // All differences down, for vectors, then those across that are wanted.
    let mut down = vec![0i16; view.width()];
    for v in (1..view.height() - 1).step_by(step) {
        let [a, b, c] = [v - 1, v, v + 1].map(|v| &grey[v * view.stride()..][..view.width()]);
        for (u, d) in down.iter_mut().enumerate() {
            *d = i16::from(a[u]) - 2 * i16::from(b[u]) + i16::from(c[u]);
        }
        for d in down.windows(3).step_by(step) {
            counts[usize::from((d[0] - 2 * d[1] + d[2]).unsigned_abs())] += 1;
        }
    }
    let middle = counts.iter().sum::<usize>() / 2;
    ranked(&counts, middle) as f32 / (0.6745 * 6.0)
}

/// The value that stands at a place of the sorted list, from how often each value occurs.
fn ranked(counts: &[usize], place: usize) -> usize {
    let mut sum = 0;
    let found = counts.iter().position(|count| {
        sum += count;
        sum > place
    });
    found.unwrap_or(counts.len() - 1)
}

/// Span of the grey levels without the darkest and brightest thousandth.
pub(crate) fn range(view: &GrayView) -> f32 {
    let (width, count) = (view.width(), view.width() * view.height());
    let step = (count / 100_000).max(1) | 1;
    if let Samples::U8(s) = view.samples() {
        let mut counts = vec![0; 256];
        // Every so many pixels of all rows on end.
        let mut first = 0;
        for row in s.chunks(view.stride()).take(view.height()) {
            let here = &row[..width];
            here.iter().skip(first).step_by(step).for_each(|x| counts[usize::from(*x)] += 1);
            let left = (width + step - 1).saturating_sub(first) / step;
            first = first + left * step - width;
        }
        let number: usize = counts.iter().sum();
        let cut = number / 1000;
        return (ranked(&counts, number - 1 - cut) - ranked(&counts, cut)) as f32;
    }
    let mut seen: Vec<f32> = (0..count).step_by(step).map(|i| view.get(i % width, i / width)).collect();
    let cut = seen.len() / 1000;
    let last = seen.len() - 1;
    let high = *seen.select_nth_unstable_by(last - cut, f32::total_cmp).1;
    let low = *seen.select_nth_unstable_by(cut, f32::total_cmp).1;
    high - low
}

/// An image blurred by the binomial (1 4 6 4 1)/16 in both directions, and the same minus its mean over the window around each pixel;
/// borders are repeated. One pass: each row is finished while those that it needs are at hand.
fn smooth_and_field(source: Source) -> (Plane, Plane) {
    lanes::run(SmoothAndField(source))
}

struct SmoothAndField<'a>(Source<'a>);

impl Kernel for SmoothAndField<'_> {
    type Output = (Plane, Plane);
    #[inline(always)]
    fn run<L: Width>(self) -> (Plane, Plane) {
        let source = self.0;
        let (width, height) = (source.width(), source.height());
        let (mut smooth, mut field) = (Vec::with_capacity(width * height), Vec::with_capacity(width * height));
        let mut five = Five::new(width);
        let mut box_mean = BoxMean::new(width);
        for v in 0..height + MEAN_RADIUS {
            if v < height {
                five.push(&source, v, height, &mut smooth);
            }
            box_mean.push(&smooth, v, height, &mut field);
        }
        (Plane { data: smooth, width, height }, Plane { data: field, width, height })
    }
}

/// The binomial, with the rows of the source in a ring.
struct Five {
    rows: [Vec<f32>; 5],
    /// The row of the source that comes next.
    next: usize,
    column: Vec<f32>,
}

impl Five {
    fn new(width: usize) -> Self {
        Self { rows: std::array::from_fn(|_| vec![0.0; width]), next: 0, column: vec![0.0; width + 4] }
    }

    /// Appends the row `v` of the blurred image.
    #[inline(always)]
    fn push(&mut self, source: &Source, v: usize, height: usize, out: &mut Vec<f32>) {
        let last = height - 1;
        while self.next <= (v + 2).min(last) {
            source.row(self.next, &mut self.rows[self.next % 5]);
            self.next += 1;
        }
        let n = self.column.len() - 4;
        let r = [v.saturating_sub(2), v.saturating_sub(1), v, (v + 1).min(last), (v + 2).min(last)]
            .map(|k| &self.rows[k % 5][..n]);
        for (i, c) in self.column[2..n + 2].iter_mut().enumerate() {
            *c = (r[0][i] + r[4][i]) + 4.0 * (r[1][i] + r[3][i]) + 6.0 * r[2][i];
        }
        repeat_ends(&mut self.column, 2);
        let c = &self.column;
        let (a, b, c, d, e) = (&c[..n], &c[1..=n], &c[2..n + 2], &c[3..n + 3], &c[4..n + 4]);
        let row = (0..n).map(|i| ((a[i] + e[i]) + 4.0 * (b[i] + d[i]) + 6.0 * c[i]) * (1.0 / 256.0));
        out.extend(row);
    }
}

/// The mean over nine rows and columns as three times three, with sums of three rows in a ring.
struct BoxMean {
    threes: [Vec<f32>; 8],
    column: Vec<f32>,
    across: Vec<f32>,
}

impl BoxMean {
    fn new(width: usize) -> Self {
        const R: usize = MEAN_RADIUS;
        Self {
            threes: std::array::from_fn(|_| vec![0.0; width]),
            column: vec![0.0; width + 2 * R],
            across: vec![0.0; width + 2 * R - 2],
        }
    }

    /// Takes note of row `v` of the blurred image, which is there (or beyond its end); appends the row of the field that it completes.
    #[inline(always)]
    fn push(&mut self, smooth: &[f32], v: usize, height: usize, field: &mut Vec<f32>) {
        const R: usize = MEAN_RADIUS;
        let n = self.column.len() - 2 * R;
        let row = |k: isize| {
            let k = k.clamp(0, height as isize - 1) as usize;
            &smooth[k * n..(k + 1) * n]
        };
        // Sums of three rows exist from three above the image to three below.
        let first = if v == 0 { -3 } else { v as isize - 1 };
        for middle in first..v as isize {
            let (a, b, c) = (row(middle - 1), row(middle), row(middle + 1));
            let out = &mut self.threes[middle.rem_euclid(8) as usize][..n];
            for i in 0..n {
                out[i] = a[i] + b[i] + c[i];
            }
        }
        let Some(v) = v.checked_sub(R) else { return };
        let three = |k: isize| &self.threes[(v as isize + k).rem_euclid(8) as usize][..n];
        let (a, b, c) = (three(-3), three(0), three(3));
        for (i, s) in self.column[R..R + n].iter_mut().enumerate() {
            *s = a[i] + b[i] + c[i];
        }
        repeat_ends(&mut self.column, R);
        let m = self.across.len();
        let (a, b, c) = (&self.column[..m], &self.column[1..=m], &self.column[2..m + 2]);
        for (i, s) in self.across.iter_mut().enumerate() {
            *s = a[i] + b[i] + c[i];
        }
        let (a, b, c) = (&self.across[..n], &self.across[3..n + 3], &self.across[6..n + 6]);
        let norm = 1.0 / ((2 * R + 1) * (2 * R + 1)) as f32;
        let own = &smooth[v * n..(v + 1) * n];
        field.extend((0..n).map(|i| own[i] - (a[i] + b[i] + c[i]) * norm));
    }
}

/// One level of the pyramid in floats.
#[derive(Debug, Default)]
pub(crate) struct Floats {
    smooth: Plane,
    field: Plane,
    starts: Vec<u32>,
}

impl Level for Floats {
    fn starts(&self) -> impl Iterator<Item = u32> {
        self.starts.iter().copied()
    }
    fn width(&self) -> usize {
        self.field.width
    }
    fn height(&self) -> usize {
        self.field.height
    }
    #[inline]
    fn smooth(&self, u: usize, v: usize) -> f32 {
        self.smooth.at(u, v)
    }
    #[inline]
    fn field(&self, u: usize, v: usize) -> f32 {
        self.field.at(u, v)
    }
}

impl Floats {
    /// Makes a level; lines start where the grey level changes by more than `gradient`.
    pub(crate) fn new(source: Source, gradient: f32) -> Self {
        let (smooth, field) = smooth_and_field(source);
        let (mut steep, mut starts) = (Vec::new(), Vec::new());
        for v in 0..field.height - 1 {
            // Gradients are rare, zeros of the field are everywhere: the noise crosses zero all the time.
            lanes::run(Steep { row: smooth.row(v), gradient, found: &mut steep });
            let row = field.row(v);
            let crossed = steep.iter().filter(|u| (row[**u] > 0.0) != (row[**u + 1] > 0.0));
            starts.extend(crossed.map(|u| (v * field.width + u) as u32));
        }
        Self { smooth, field, starts }
    }

    /// The smoothed image.
    pub(crate) fn smoothed(&self) -> &Plane {
        &self.smooth
    }
}

/// Finds the places of a row where the grey level changes by more than `gradient` to the next.
struct Steep<'a> {
    row: &'a [f32],
    gradient: f32,
    found: &'a mut Vec<usize>,
}

impl Kernel for Steep<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Width>(self) {
        const STRIDE: usize = 32;
        self.found.clear();
        let n = self.row.len() - 1;
        let (a, b) = (&self.row[..n], &self.row[1..]);
        for start in (0..n).step_by(STRIDE) {
            let end = (start + STRIDE).min(n);
            let (a, b) = (&a[start..end], &b[start..end]);
            let any = a.iter().zip(b).fold(false, |any, (x, y)| any | ((y - x).abs() > self.gradient));
            if any {
                let steep = a.iter().zip(b).enumerate().filter(|(_, (x, y))| (*y - *x).abs() > self.gradient);
                self.found.extend(steep.map(|(i, _)| start + i));
            }
        }
    }
}

/// Copies the first and last inner values into `pad` places at either end.
#[inline(always)]
pub(super) fn repeat_ends<T: Copy>(line: &mut [T], pad: usize) {
    let n = line.len();
    let (first, last) = (line[pad], line[n - pad - 1]);
    line[..pad].fill(first);
    line[n - pad..].fill(last);
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;

    /// Counted bytes against the sorted list of the same values as floats.
    #[test]
    fn noise_and_range_of_bytes_are_those_of_floats() {
        for (width, height, stride) in [(61, 47, 61), (301, 240, 310), (900, 700, 900)] {
            let grey: Vec<u8> = (0..stride * height).map(|i| ((i * i / 7) % 83 + 40 * (i % 5)) as u8).collect();
            let floats: Vec<f32> = grey.iter().map(|x| f32::from(*x)).collect();
            let bytes = GrayView::new(Samples::U8(&grey), width, height, stride).expect("an image");
            let floats = GrayView::new(Samples::F32(&floats), width, height, stride).expect("an image");
            assert!(noise(&bytes) > 1.0 && range(&bytes) > 50.0);
            assert_eq!(noise(&bytes), noise(&floats));
            assert_eq!(range(&bytes), range(&floats));
        }
    }

    /// The pass over rows in rings against sums written out for each pixel.
    #[test]
    fn one_pass_is_the_plain_blur_and_the_plain_mean() {
        for (width, height) in [(12, 12), (37, 15), (70, 23)] {
            let mut state = 7u32;
            let grey: Vec<u8> = (0..width * height)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state >> 24) as u8
                })
                .collect();
            let view = GrayView::new(Samples::U8(&grey), width, height, width).expect("an image");
            let (smooth, field) = smooth_and_field(Source::View(&view));
            let last = |x: isize, n: usize| x.clamp(0, n as isize - 1) as usize;
            let blurred = |u: isize, v: isize| {
                let w = [1.0, 4.0, 6.0, 4.0, 1.0];
                let mut sum = 0.0;
                for (j, wj) in w.iter().enumerate() {
                    for (i, wi) in w.iter().enumerate() {
                        let (x, y) = (last(u + i as isize - 2, width), last(v + j as isize - 2, height));
                        sum += wi * wj * f64::from(grey[y * width + x]);
                    }
                }
                sum / 256.0
            };
            for v in 0..height as isize {
                for u in 0..width as isize {
                    let mut mean = 0.0;
                    for j in -4..=4 {
                        for i in -4..=4 {
                            let (x, y) = (last(u + i, width), last(v + j, height));
                            mean += blurred(x as isize, y as isize) / 81.0;
                        }
                    }
                    let own = blurred(u, v);
                    let (s, f) = (smooth.at(u as usize, v as usize), field.at(u as usize, v as usize));
                    assert!((f64::from(s) - own).abs() < 1e-4, "({u}, {v}): {s} against {own}");
                    assert!((f64::from(f) - (own - mean)).abs() < 3e-4, "({u}, {v}): {f} against {}", own - mean);
                }
            }
        }
    }

    #[test]
    fn steep_places_are_those_of_a_plain_loop_at_any_width() {
        let row: Vec<f32> = (0..1000).map(|i| ((i * i) % 97) as f32 * if i % 300 < 40 { 1.0 } else { 0.01 }).collect();
        let plain: Vec<usize> = (0..999).filter(|i| (row[i + 1] - row[*i]).abs() > 3.0).collect();
        let mut found = vec![];
        lanes::run(Steep { row: &row, gradient: 3.0, found: &mut found });
        assert!(plain.len() > 50);
        assert_eq!(found, plain);
    }
}
