//! One round of the check: windows of the dewarped images, and the plane through them.

use super::correlate::{Correlator, Dewarped, Sums};
use super::peak::{Peak, at_most};
use super::plane::{Match, PlaneFit, Seen, fit_plane, see};
use super::prepare::particles;
use super::smear::{Smear, depth_px};
use crate::dewarp::{Sampler, SheetGrid, SheetMap, resample};
use crate::error::{Insufficient, Invalid, Result};
use crate::record::Record;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// A peak must be this much higher than the second.
const RATIO: f64 = 1.25;
/// Fewest windows that fix a plane with something to spare.
pub(super) const FEWEST: usize = 8;
/// Half the box of the background at least, px.
const BACKGROUND_PX: usize = 8;
/// Peaks without a known width are told from others beyond four times this part of the window.
const WIDEST: f64 = 1.0 / 16.0;
/// Windows hold few particles: how far from the middle of the light a peak is looked for, standard deviations of depth.
const DEPTHS: f64 = 1.5;

/// Images ready to be dewarped.
pub(super) struct Moment {
    pub(super) samplers: [Sampler; 2],
}

/// The windows of a sheet.
pub(super) struct Windows {
    /// Those with a clear peak.
    pub(super) matches: Vec<Match>,
    pub(super) windows: usize,
    pub(super) window_px: usize,
    pub(super) grid: SheetGrid,
    pub(super) sums: Option<Sums>,
    /// s_2 - s_1 in the middle of the field, y up.
    pub(super) slope_apart: Vector2<f64>,
    /// Width of the peaks of all windows together.
    pub(super) smear: Option<Smear>,
}

/// Windows and the plane through them.
pub(super) struct Round {
    pub(super) seen_in: Windows,
    pub(super) fit: PlaneFit,
    /// Median disparity in the sheet of this round, px.
    pub(super) median_px: f64,
}

/// What a round looks for.
#[derive(Clone, Copy)]
pub(super) struct Looked<'a> {
    pub(super) window_px: usize,
    /// Once the plane is known, peaks far away are chance.
    pub(super) near: bool,
    /// Width of the peaks, where a round has told it.
    pub(super) smear: Option<&'a Smear>,
}

pub(super) fn maps_of(record: &Record) -> Result<[SheetMap; 2]> {
    if record.cameras.len() != 2 {
        let what = format!("the check needs two cameras, but the calibration holds {}", record.cameras.len());
        return Err(Invalid::Contradiction(what).into());
    }
    Ok([SheetMap::from_record(record, 0)?, SheetMap::from_record(record, 1)?])
}

/// s_2 - s_1 at a pixel of the grid, y up.
fn slope_apart(maps: [&SheetMap; 2], grid: &SheetGrid, [x, y]: [f64; 2]) -> Option<Vector2<f64>> {
    let [x, y] = grid.point_mm(x, y);
    let slope = |m: &SheetMap| m.project(&Vector3::new(x, y, 0.0)).and_then(|q| m.hit(&q, 0.0)).map(|h| h.slope);
    Some(slope(maps[1])? - slope(maps[0])?)
}

/// Particles of all moments in the sheet.
fn dewarped(moments: &[Moment], maps: [&SheetMap; 2], grid: &SheetGrid, background_px: usize) -> Vec<Dewarped> {
    let one = |m: &Moment| {
        let [(mut a, sa), (mut b, sb)] = [0, 1].map(|c| resample(&m.samplers[c], maps[c], grid, 0.0));
        particles(&mut a, grid.width_px, background_px);
        particles(&mut b, grid.width_px, background_px);
        Dewarped { levels: [a, b], seen: sa.iter().zip(&sb).map(|(a, b)| *a && *b).collect() }
    };
    moments.iter().map(one).collect()
}

/// One window's peak, and how far it stands out.
fn clear_peak(
    correlator: &Correlator,
    cross: &[f64],
    looked: &Looked<'_>,
    depth_px: Vector2<f64>,
) -> Option<(Peak, f64)> {
    let (map, window) = (correlator.map(cross.to_vec()), looked.window_px);
    let far = 2 * window / 5;
    let Some(smear) = looked.smear else {
        let peak = map.peak(far, None)?;
        let ratio = map.ratio(&peak, &at_most(&peak.shape_px2, WIDEST * window as f64));
        return Some((peak, ratio));
    };
    let depth = (DEPTHS * smear.drawn_px(depth_px).norm()).ceil() as usize;
    let search = if looked.near { (window / 8).max(6).max(depth).min(far) } else { far };
    let (map, shape) = smear.gathered(map, depth_px);
    let peak = map.peak(search, Some(&shape))?;
    Some((peak, map.ratio(&peak, &shape)))
}

/// All windows in the record's sheet.
pub(super) fn look(record: &Record, moments: &[Moment], looked: Looked<'_>) -> Result<Windows> {
    let maps = maps_of(record)?;
    let maps = [&maps[0], &maps[1]];
    let grid = SheetGrid::common(&maps, None)?;
    let window = looked.window_px;
    let middle = [0.5 * (grid.width_px - 1) as f64, 0.5 * (grid.height_px - 1) as f64];
    let in_middle = slope_apart(maps, &grid, middle).unwrap_or_else(Vector2::zeros);
    let depth = |slope: Vector2<f64>| depth_px(slope, grid.mm_per_px);
    let background = looked.smear.map_or(0, |s| s.background_px(depth(in_middle))).max(BACKGROUND_PX);
    let dewarped = dewarped(moments, maps, &grid, background);
    let [columns, rows] = [grid.width_px / window, grid.height_px / window];
    // The windows are centred in the field.
    let (left, top) = ((grid.width_px - columns * window) / 2, (grid.height_px - rows * window) / 2);
    let correlator = Correlator::new(window);
    let one = |k: usize| {
        let corner = [left + (k % columns) * window, top + (k / columns) * window];
        let sums = correlator.window(&dewarped, grid.width_px, corner[0], corner[1])?;
        let middle = corner.map(|c| c as f64 + 0.5 * (window - 1) as f64);
        let matched = || {
            let depth = depth(slope_apart(maps, &grid, middle)?);
            let (peak, ratio) = clear_peak(&correlator, &sums.cross, &looked, depth)?;
            // The particle images of both lie half a shift on either side.
            let raw = |c: usize, side: f64| {
                let [x, y] = grid.point_mm(middle[0] + side * peak.shift_px.x, middle[1] + side * peak.shift_px.y);
                maps[c].project(&Vector3::new(x, y, 0.0))
            };
            let found = Match { pixels: [raw(0, -0.5)?, raw(1, 0.5)?], correlation: peak.height, ratio };
            (ratio > RATIO).then_some(found)
        };
        Some((matched(), sums))
    };
    let found: Vec<Option<(Option<Match>, Sums)>> = (0..columns * rows).into_par_iter().map(one).collect();
    let mut sums: Option<Sums> = None;
    let mut matches = vec![];
    for (m, s) in found.into_iter().flatten() {
        // Where no width is expected yet, windows with a clear peak would tell that of narrow ones.
        if m.is_some() || looked.smear.is_none() {
            add(&mut sums, s);
        }
        matches.extend(m);
    }
    let smear = sums.as_ref().and_then(|t| Smear::of(t, window, depth(in_middle)));
    Ok(Windows { matches, windows: columns * rows, window_px: window, grid, sums, slope_apart: in_middle, smear })
}

impl Windows {
    /// Whether fewer than half of the windows have a clear peak.
    pub(super) fn few(&self) -> bool {
        2 * self.matches.len() < self.windows
    }

    /// What depth draws a peak out by per mm, px, y down.
    pub(super) fn depth_px(&self) -> Vector2<f64> {
        depth_px(self.slope_apart, self.grid.mm_per_px)
    }

    /// Side of a window against which depth is small, where this one is not, px.
    pub(super) fn too_short(&self) -> Option<usize> {
        self.smear.and_then(|s| s.too_long(self.depth_px(), self.window_px))
    }
}

/// One round in the record's sheet.
pub(super) fn measure(record: &Record, moments: &[Moment], looked: Looked<'_>) -> Result<Round> {
    fitted(record, look(record, moments, looked)?)
}

/// The plane through windows.
pub(super) fn fitted(record: &Record, seen_in: Windows) -> Result<Round> {
    let maps = maps_of(record)?;
    let matches = &seen_in.matches;
    let seen: Vec<Seen> = matches.iter().filter_map(|m| see([&maps[0], &maps[1]], m)).collect();
    let fit = if matches.len() >= FEWEST && seen.len() == matches.len() { fit_plane(matches, &seen) } else { None };
    let fit = fit.ok_or_else(|| {
        let advice = match seen_in.too_short() {
            Some(side) => format!("the light is thick for them: take --window-px {side}"),
            None if seen_in.windows < 2 * FEWEST => "take smaller windows with --window-px".into(),
            None => "give more image pairs, or larger windows with --window-px".into(),
        };
        Insufficient::Degenerate(format!(
            "only {} of {} windows of {} px show a clear correlation peak, {FEWEST} are needed to fix a plane; {advice}",
            matches.len(),
            seen_in.windows,
            seen_in.window_px
        ))
    })?;
    let mut lengths: Vec<f64> = seen.iter().map(|s| s.disparity_mm.norm() / seen_in.grid.mm_per_px).collect();
    lengths.sort_by(f64::total_cmp);
    let median_px = lengths[lengths.len() / 2];
    Ok(Round { seen_in, fit, median_px })
}

fn add(total: &mut Option<Sums>, s: Sums) {
    match total {
        None => *total = Some(s),
        Some(t) => {
            let pairs = [(&mut t.cross, &s.cross)];
            let autos = t.auto.iter_mut().zip(&s.auto);
            for (sum, more) in pairs.into_iter().chain(autos) {
                sum.iter_mut().zip(more).for_each(|(a, b)| *a += b);
            }
            t.pairs += s.pairs;
        }
    }
}

/// Largest disparity that the plane's step makes in the field, px.
pub(super) fn plane_step_px(r: &Round) -> f64 {
    let [x0, y0, x1, y1] = r.seen_in.grid.extent_mm();
    let z = |x: f64, y: f64| r.fit.abc.dot(&Vector3::new(1.0, x, y)).abs();
    let z = z(x0, y0).max(z(x1, y0)).max(z(x0, y1)).max(z(x1, y1));
    z * r.seen_in.depth_px().norm()
}
