//! Sums over rows of integer samples, eight at a time.

use super::columns::EIGHT;
use crate::lanes::{self, Lanes};
use std::ops::Range;

/// Places among eight; one for those that count, then none.
pub(super) const PLACES: [f64; EIGHT] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
const COUNTED: [f64; 2 * EIGHT] = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// A place of an image, below 2^31: as a signed number it is converted at once.
#[inline(always)]
pub(super) fn number(x: usize) -> f64 {
    f64::from(x as i32)
}

/// Sums over rows of integer samples, a place for each of eight neighbours, until they go into [`Sums`]: whole numbers, so that none is rounded.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Whole {
    pub(super) gu: [f64; EIGHT],
    pub(super) gg: [f64; EIGHT],
    pub(super) dd: [f64; EIGHT],
}

impl Whole {
    /// Takes in a stretch of the samples, whose first column is `first`; returns the sum of their grey values, and nothing of what is summed up here.
    #[inline(always)]
    pub(super) fn take_of<L: Lanes, T: Copy + Default + Into<f64>>(
        &mut self,
        samples: &[T],
        stretch: Range<usize>,
        first: f64,
        ground: f64,
    ) -> [f64; 4] {
        let n = stretch.len();
        let end = stretch.start + n.next_multiple_of(EIGHT);
        let all = [samples.get(stretch.start - 1..end - 1), samples.get(stretch.start..end)];
        let g = if let [Some(before), Some(here)] = all {
            self.take::<L, T>([before, here], n, first, ground)
        } else {
            // The last of the image.
            let mut last = samples[stretch.start - 1..stretch.end].to_vec();
            last.resize(1 + n.next_multiple_of(EIGHT), T::default());
            self.take::<L, T>([&last[..last.len() - 1], &last[1..]], n, first, ground)
        };
        [g, 0.0, 0.0, 0.0]
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

#[inline(always)]
fn add<L: Lanes>(sum: &mut [f64], x: L) {
    (L::load(sum) + x).store(sum);
}
