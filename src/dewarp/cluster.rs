//! Sixteen windows of eight rows of eight samples that begin near each other, as those of neighbouring pixels do: one place in each
//! lane.
//!
//! ```text
//! s_i += w_(r - d) c_(r, b + i)   for each row r below the first of all windows and each tap i,   f = sum_i w_i s_i
//! ```
//! with `d` the rows and `b` the columns by which a window begins after the first. Samples of a row are held in two registers, from which each
//! lane picks its own: every sample is read once, and no window is put together.

use super::kernel::MOST_TAPS;
use super::rows::Places;
use super::weights::Table;
use crate::lanes::{Level, Picks, Raster, SINGLES, WithPicks};
use std::hint::black_box;

/// Most rows between the first and the last window.
const MOST_ROWS: usize = 4;

/// Whole numbers below are held by single precision.
const WHOLE: f32 = 16_777_152.0;

/// Places from number `first` on.
pub(super) struct Cluster<'a, S> {
    pub(super) table: &'a Table,
    pub(super) raster: &'a Raster<'a, S, 8>,
    pub(super) at: &'a Places,
    pub(super) first: usize,
}

/// Where the first of some windows begins along an axis and how much later each does; `None` where that is more than `most`.
#[inline(always)]
fn spread<P: Picks>(first: &[f32], most: usize) -> Option<(f32, usize, P)> {
    // Places lie in order nearly always; where they do not, windows are read by eights.
    let (a, b) = (first[0], first[SINGLES - 1]);
    let (low, span) = (a.min(b), (a - b).abs());
    let late = P::load(first) - P::splat(low);
    let between = P::all(P::splat(-0.5).below(late)) & P::all(late.below(P::splat(span + 0.5)));
    (between & (span <= most as f32) & (low < WHOLE)).then_some((low, span as usize, late))
}

/// Adds a row to the sums of each tap.
#[inline(always)]
fn add<P: Picks>(sums: &mut [P; MOST_TAPS], line: P::Line, index: &[P::Index; MOST_TAPS], weight: P) {
    for i in 0..MOST_TAPS {
        sums[i] = P::pick(line, index[i]).fused(weight, sums[i]);
    }
}

/// The same in windows that have that row: a sample that is no number is none times zero either.
#[inline(always)]
fn add_where<P: Picks>(
    has: P::Mask,
    sums: &mut [P; MOST_TAPS],
    line: P::Line,
    index: &[P::Index; MOST_TAPS],
    weight: P,
) {
    for i in 0..MOST_TAPS {
        sums[i] = P::select(has, P::pick(line, index[i]).fused(weight, sums[i]), sums[i]);
    }
}

impl<S: Level> WithPicks for Cluster<'_, S> {
    /// Levels; `None` where the windows are not near enough, or at the image's last samples.
    type Output = Option<[f32; SINGLES]>;
    #[inline(always)]
    fn run<P: Picks>(self) -> Self::Output {
        let (left, _, column) = spread::<P>(&self.at.first[0][self.first..], 2 * SINGLES - MOST_TAPS)?;
        let (top, depth, late) = spread::<P>(&self.at.first[1][self.first..], MOST_ROWS)?;
        let start = self.raster.sample(left, top);
        // What the next row of the result will look at, whether that lies below or above.
        self.raster.fetch(start + (MOST_TAPS + depth + 1) * self.raster.stride());
        self.raster.fetch(start.wrapping_sub(2 * self.raster.stride()));

        let down = self.table.each(P::load(&self.at.x[1][self.first..]));
        let mut index = [column.index(); MOST_TAPS];
        for i in 1..MOST_TAPS {
            index[i] = P::behind(index[0], i as i32);
        }
        let mut sums = [P::splat(0.0); MOST_TAPS];
        if depth == 0 {
            let mut lines = self.raster.lines(start, MOST_TAPS)?;
            for r in 0..MOST_TAPS {
                add(&mut sums, P::line(&lines.samples()), &index, down[r]);
            }
        } else if depth == 1 {
            let mut lines = self.raster.lines(start, MOST_TAPS + 1)?;
            let (first, second) = (late.below(P::splat(0.5)), P::splat(0.5).below(late));
            add_where(first, &mut sums, P::line(&lines.samples()), &index, down[0]);
            for r in 1..MOST_TAPS {
                add(&mut sums, P::line(&lines.samples()), &index, P::select(first, down[r], down[r - 1]));
            }
            add_where(second, &mut sums, P::line(&lines.samples()), &index, down[MOST_TAPS - 1]);
        } else {
            let mut lines = self.raster.lines(start, MOST_TAPS + depth)?;
            for r in 0..MOST_TAPS + depth {
                let mut weight = P::splat(0.0);
                for d in r.saturating_sub(MOST_TAPS - 1)..=depth.min(r) {
                    let by_d = (late - P::splat(d as f32)).size().below(P::splat(0.5));
                    weight = P::select(by_d, down[r - d], weight);
                }
                let middle = P::splat(r as f32 - 0.5 * (MOST_TAPS - 1) as f32);
                let has = (late - middle).size().below(P::splat(0.5 * MOST_TAPS as f32));
                add_where(has, &mut sums, P::line(&lines.samples()), &index, weight);
            }
        }
        // A table that the compiler does not know again: it would keep all coefficients in memory from the first time to the second.
        let across = black_box(self.table).each(P::load(&self.at.x[0][self.first..]));
        for i in 0..MOST_TAPS {
            sums[i] = sums[i] * across[i];
        }
        // The order of windows that are read by eights.
        let [a, b, c, d] = [sums[0] + sums[4], sums[1] + sums[5], sums[2] + sums[6], sums[3] + sums[7]];
        let mut out = [0.0; SINGLES];
        ((a + c) + (b + d)).store(&mut out);
        Some(out)
    }
}
