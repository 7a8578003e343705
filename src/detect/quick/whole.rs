//! Sums over rows of samples, of integer ones eight at a time.

use super::columns::EIGHT;
use crate::lanes::{self, BYTES, Lanes};
use std::ops::Range;

/// Places among eight; one for those that count, then none.
const PLACES: [f64; EIGHT] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
const COUNTED: [f64; 2 * EIGHT] = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// A place of an image, below 2^31: as a signed number it is converted at once.
#[inline(always)]
pub(super) fn number(x: usize) -> f64 {
    f64::from(x as i32)
}

/// Sums over rows of samples until they go into [`Sums`](super::pixels::Sums); of integer samples they are whole numbers, so that none is rounded.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Whole {
    /// A place for each of eight neighbours.
    pub(super) gu: [f64; EIGHT],
    pub(super) gg: [f64; EIGHT],
    pub(super) dd: [f64; EIGHT],
    /// What is summed up otherwise, to be added: `g, gu, gg, dd`.
    pub(super) more: [f64; 4],
}

/// A kind of samples.
pub(super) trait Sample: Copy + Default + Into<f64> + Into<f32> {
    /// Takes in a stretch of the samples, whose first column is `first`; returns the sum of their grey values less the `ground`.
    fn take<L: Lanes>(out: &mut Whole, samples: &[Self], stretch: Range<usize>, first: f64, ground: Self) -> f64;
}

impl Sample for u8 {
    /// `sum of (first + i) x = sum of i x + first times the sum of x`
    #[inline(always)]
    fn take<L: Lanes>(out: &mut Whole, samples: &[u8], stretch: Range<usize>, first: f64, ground: u8) -> f64 {
        if stretch.len() <= BYTES {
            return out.take_bytes::<L>(samples, stretch, (first, true), ground);
        }
        let mut all = 0.0;
        for from in stretch.clone().step_by(BYTES) {
            let (part, k) = (from..stretch.end.min(from + BYTES), from - stretch.start);
            all += out.take_bytes::<L>(samples, part, (first + number(k), k == 0), ground);
        }
        all
    }
}

impl Sample for u16 {
    #[inline(always)]
    fn take<L: Lanes>(out: &mut Whole, samples: &[u16], stretch: Range<usize>, first: f64, ground: u16) -> f64 {
        let (n, ground) = (stretch.len(), f64::from(ground));
        with_eights(samples, stretch, |all| out.take::<L, u16>([&all[..all.len() - 1], &all[1..]], n, first, ground))
    }
}

impl Sample for f32 {
    #[inline(always)]
    fn take<L: Lanes>(out: &mut Whole, samples: &[f32], stretch: Range<usize>, first: f64, ground: f32) -> f64 {
        let sums = sums_of(&samples[stretch], first, f64::from(ground));
        for k in 0..4 {
            out.more[k] += sums[k];
        }
        sums[0]
    }
}

/// Sums of the grey value, of it times its column, which begin with `first`, of its squares, and of the squared differences of neighbours.
#[inline(always)]
fn sums_of(grey: &[f32], first: f64, ground: f64) -> [f64; 4] {
    let (mut g, mut gi, mut gg, mut dd) = (0.0, 0.0, 0.0, 0.0);
    let mut before = f64::from(grey[0]) - ground;
    for i in 0..grey.len() {
        let x = f64::from(grey[i]) - ground;
        g += x;
        gi += x * i as f64;
        gg += x * x;
        let step = x - before;
        dd += step * step;
        before = x;
    }
    [g, gi + first * g, gg, dd]
}

impl Whole {
    /// A stretch of up to [`BYTES`] bytes, its first column, and whether the neighbour to the left of that does not count; returns the sum of their
    /// grey values.
    #[inline(always)]
    fn take_bytes<L: Lanes>(
        &mut self,
        samples: &[u8],
        stretch: Range<usize>,
        (first, alone): (f64, bool),
        ground: u8,
    ) -> f64 {
        let n = stretch.len();
        let sums = with_eights(samples, stretch, |bytes| L::sums_of_bytes(bytes, n, ground, alone));
        let mut own = [0.0; 4];
        for k in 0..4 {
            own[k] = f64::from(sums[k]);
        }
        for k in 0..4 {
            self.more[k] += own[k];
        }
        self.gu[0] += first * own[0];
        own[0]
    }

    /// Takes in the first `n` of the pixels `here`, which are whole eights; `before` are those to the left of them, `first` is the column of the first.
    /// Returns the sum of their grey values.
    #[inline(always)]
    fn take<L: Lanes, T: Copy + Into<f64>>(
        &mut self,
        [before, here]: [&[T]; 2],
        n: usize,
        first: f64,
        ground: f64,
    ) -> f64 {
        let mut sum = [0.0; EIGHT];
        let eights = before.as_chunks::<EIGHT>().0.iter().zip(here.as_chunks::<EIGHT>().0);
        for (k, (before, here)) in eights.enumerate() {
            let (mut grey, mut beside) = ([0.0; EIGHT], [0.0; EIGHT]);
            for i in 0..EIGHT {
                grey[i] = here[i].into();
            }
            for i in 0..EIGHT {
                beside[i] = before[i].into();
            }
            let counted = &COUNTED[EIGHT.saturating_sub(n - k * EIGHT)..][..EIGHT];
            let (column, ground) = (L::splat(first + number(k * EIGHT)), L::splat(ground));
            let mut part = 0;
            while part < EIGHT {
                let (counts, grey) = (L::load(&counted[part..]), L::load(&grey[part..]));
                let (x, step) = ((grey - ground) * counts, (grey - L::load(&beside[part..])) * counts);
                add(&mut sum[part..], x);
                add(&mut self.gu[part..], x * (column + L::load(&PLACES[part..])));
                add(&mut self.gg[part..], x * x);
                add(&mut self.dd[part..], step * step);
                part += L::N;
            }
        }
        // The first of them has no neighbour that counts.
        let step = here[0].into() - before[0].into();
        self.dd[0] -= step * step;
        lanes::sum(&sum)
    }
}

/// Does a piece of work with the samples of a stretch, in whole eights, and the one to the left of them.
#[inline(always)]
fn with_eights<S: Sample, R>(samples: &[S], stretch: Range<usize>, work: impl FnOnce(&[S]) -> R) -> R {
    let n = stretch.len().next_multiple_of(EIGHT);
    match samples.get(stretch.start - 1..stretch.start + n) {
        Some(all) => work(all),
        None => {
            // The last of the image.
            let mut last = samples[stretch.start - 1..stretch.end].to_vec();
            last.resize(n + 1, S::default());
            work(&last)
        }
    }
}

#[inline(always)]
fn add<L: Lanes>(sum: &mut [f64], x: L) {
    (L::load(sum) + x).store(sum);
}
