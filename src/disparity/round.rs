//! One round of the check: windows of the dewarped images, and the plane through them.

use super::correlate::{Correlator, Dewarped};
use super::lattice::Lattice;
use super::masks::Mask;
use super::plane::{Match, PlaneFit, Seen, fit_plane, see, weighted_plane};
use super::prepare::{BACKGROUND_PX, particles};
use crate::dewarp::{Sampler, SheetGrid, SheetMap, resample};
use crate::error::{Insufficient, Invalid, Result};
use crate::record::Record;
use crate::stats::median;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// A peak must be this much higher than the second.
const RATIO: f64 = 1.25;
/// Peaks that are chance lie anywhere as far as they are looked for: half of them are further than half of that off a smooth field across the
/// direction of depth. Those of common particles stand together; half of them beyond this part of it are refused.
const ANYWHERE: f64 = 0.25;
/// Fewest windows that fix a plane with something to spare.
pub(super) const FEWEST: usize = 10;

/// Images of one moment ready to be dewarped.
pub(super) struct Moment {
    pub(super) samplers: [Sampler; 2],
}

/// Those of all moments, and what of them may be used.
pub(super) struct Series<'a> {
    pub(super) moments: Vec<Moment>,
    pub(super) masks: &'a [Option<Mask>; 2],
}

/// Windows of a sheet, and the plane through them.
pub(super) struct Round {
    pub(super) matches: Vec<Match>,
    pub(super) windows: usize,
    pub(super) fit: PlaneFit,
    pub(super) grid: SheetGrid,
    /// Median disparity in the sheet of this round, px.
    pub(super) median_px: f64,
    /// Largest disparity that the plane's step makes in the field, px.
    pub(super) step_px: f64,
}

pub(super) fn maps_of(record: &Record) -> Result<[SheetMap; 2]> {
    if record.cameras.len() != 2 {
        let what = format!("the check needs two cameras, but the calibration holds {}", record.cameras.len());
        return Err(Invalid::Contradiction(what).into());
    }
    Ok([SheetMap::from_record(record, 0)?, SheetMap::from_record(record, 1)?])
}

/// Particles of all moments in the sheet.
pub(super) fn dewarped(series: &Series, maps: [&SheetMap; 2], grid: &SheetGrid, background_px: usize) -> Vec<Dewarped> {
    // What a camera sees is the same at every moment.
    let mut seen: [Option<Vec<bool>>; 2] = [None, None];
    let mut one = |m: &Moment| {
        let levels = [0, 1].map(|c| {
            let (mut levels, valid) = resample(&m.samplers[c], maps[c], grid, 0.0);
            let seen = seen[c].get_or_insert_with(|| {
                let mut valid = valid;
                series.masks[c].iter().for_each(|mask| mask.take_off(&mut valid, maps[c], grid));
                valid
            });
            particles(&mut levels, seen, grid.width_px, background_px);
            levels
        });
        let both = seen.iter().flatten().cloned().reduce(|a, b| a.iter().zip(&b).map(|(a, b)| *a && *b).collect());
        Dewarped { levels, seen: both.unwrap_or_default() }
    };
    series.moments.iter().map(&mut one).collect()
}

/// What depth moves the second image against the first by in the middle of the field, s_2 - s_1 over the size of a pixel: px per mm, y down.
pub(super) fn depth_px(maps: [&SheetMap; 2], grid: &SheetGrid) -> Vector2<f64> {
    let [x, y] = grid.point_mm(0.5 * (grid.width_px - 1) as f64, 0.5 * (grid.height_px - 1) as f64);
    let slope = |m: &SheetMap| m.project(&Vector3::new(x, y, 0.0)).and_then(|q| m.hit(&q, 0.0)).map(|h| h.slope);
    let apart = slope(maps[1]).zip(slope(maps[0])).map_or(Vector2::zeros(), |(b, a)| b - a);
    Vector2::new(apart.x, -apart.y) / grid.mm_per_px
}

/// One round in the record's sheet. Once the plane is known (`near`), peaks far away are chance.
pub(super) fn measure(record: &Record, series: &Series, window_px: usize, near: bool) -> Result<Round> {
    let maps = maps_of(record)?;
    let maps = [&maps[0], &maps[1]];
    let grid = SheetGrid::common(&maps, None)?;
    let dewarped = dewarped(series, maps, &grid, BACKGROUND_PX);
    let lattice = Lattice::centred([grid.width_px, grid.height_px], window_px, window_px);
    let correlator = Correlator::new(window_px);
    let search = if near { (window_px / 8).max(6) } else { 2 * window_px / 5 };
    let one = |k: usize| {
        let [column, row] = lattice.corner(k);
        let map = correlator.map(correlator.window(&dewarped, grid.width_px, column, row)?.cross);
        let peak = map.peak(search)?;
        let ratio = map.ratio_near(&peak, search);
        let middle = lattice.middle(k);
        // The particle images of both lie half a shift on either side.
        let raw = |c: usize, side: f64| {
            let [x, y] = grid.point_mm(middle[0] + side * peak.shift_px.x, middle[1] + side * peak.shift_px.y);
            maps[c].project(&Vector3::new(x, y, 0.0))
        };
        let found = Match { pixels: [raw(0, -0.5)?, raw(1, 0.5)?], correlation: peak.height, ratio };
        (ratio > RATIO).then_some(found)
    };
    let found: Vec<Option<Match>> = (0..lattice.len()).into_par_iter().map(one).collect();
    let matches: Vec<Match> = found.into_iter().flatten().collect();
    let seen: Vec<Seen> = matches.iter().filter_map(|m| see(maps, m)).collect();
    let fit = if matches.len() >= FEWEST && seen.len() == matches.len() { fit_plane(&matches, &seen) } else { None };
    let fit = fit.ok_or_else(|| no_plane((window_px, &grid), lattice.len(), matches.len()))?;
    let away_px = median_across_mm(&seen).unwrap_or(0.0) / grid.mm_per_px;
    if away_px > ANYWHERE * search as f64 {
        return Err(Insufficient::Degenerate(format!(
            "no common particles: of {} windows of {window_px} px with a correlation peak half are more than {away_px:.1} px off across the direction of \
             depth, where they are looked for within {search} px, so that their peaks are chance; check that left and right images are of the same \
             moments (file names in step?) and cameras, and that they show particles",
            matches.len()
        ))
        .into());
    }
    let mut lengths: Vec<f64> = seen.iter().map(|s| s.disparity_mm.norm() / grid.mm_per_px).collect();
    let median_px = median(&mut lengths).unwrap_or(0.0);
    let step_px = furthest_mm(&fit, &grid) * depth_px(maps, &grid).norm();
    Ok(Round { windows: lattice.len(), matches, fit, grid, median_px, step_px })
}

/// Why windows of a size, so many of them and of those with a peak, fix no plane.
fn no_plane((window_px, grid): (usize, &SheetGrid), windows: usize, peaks: usize) -> Insufficient {
    Insufficient::Degenerate(if windows < FEWEST {
        let hold = |w: &usize| (grid.width_px / w) * (grid.height_px / w) >= FEWEST;
        let largest = (1..window_px / 2).map(|half| 2 * half).rev().find(hold).unwrap_or(2);
        format!(
            "the field that both cameras see holds {windows} windows of {window_px} px, {FEWEST} are needed to fix a plane; give --window-px {largest} or less"
        )
    } else if peaks < FEWEST {
        format!(
            "only {peaks} of {windows} windows of {window_px} px show a clear correlation peak, {FEWEST} are needed to fix a plane; give more image pairs, \
             or larger windows with --window-px"
        )
    } else {
        format!(
            "{peaks} of {windows} windows of {window_px} px show a clear correlation peak, but fix no plane together: what they show lies on a line, or where \
             the cameras' lines of sight do not meet; check that left and right images are of the same moments and cameras, and give more image pairs"
        )
    })
}

/// Half of the disparities across the direction of depth are further than this off a linear field, mm.
fn median_across_mm(seen: &[Seen]) -> Option<f64> {
    let across: Vec<Seen> = seen.iter().map(|s| Seen { point_mm: s.point_mm.xy().push(s.across_mm), ..*s }).collect();
    let linear = weighted_plane(&across, &vec![1.0; across.len()])?;
    let off = |s: &Seen| (s.point_mm.z - linear.dot(&Vector3::new(1.0, s.point_mm.x, s.point_mm.y))).abs();
    median(&mut across.iter().map(off).collect::<Vec<f64>>())
}

/// How far the plane goes from the sheet in the field, mm.
fn furthest_mm(fit: &PlaneFit, grid: &SheetGrid) -> f64 {
    let [x0, y0, x1, y1] = grid.extent_mm();
    let z = |x: f64, y: f64| fit.abc.dot(&Vector3::new(1.0, x, y)).abs();
    z(x0, y0).max(z(x1, y0)).max(z(x0, y1)).max(z(x1, y1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whoever has windows that are too large is told to take smaller ones, of which enough fit.
    #[test]
    fn each_reason_for_no_plane_has_words_of_its_own() {
        let grid = SheetGrid::over([0.0, 0.0, 99.9, 49.9], 0.1).unwrap();
        let [w, h] = [grid.width_px, grid.height_px];
        let large = no_plane((256, &grid), (w / 256) * (h / 256), 0).to_string();
        let largest: usize = large.rsplit(' ').nth(2).unwrap().parse().unwrap_or_else(|_| panic!("{large}"));
        assert!(large.contains("holds 3 windows of 256 px") && (w / largest) * (h / largest) >= FEWEST, "{large}");
        assert!((w / (largest + 2)) * (h / (largest + 2)) < FEWEST, "{large}");
        assert!(no_plane((32, &grid), 400, 3).to_string().contains("only 3 of 400 windows"));
        assert!(no_plane((32, &grid), 400, 30).to_string().contains("fix no plane together"));
    }
}
