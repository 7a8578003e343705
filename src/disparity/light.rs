//! How deep the light is, and its profile, in the sheet that was found.
//!
//! All windows that both cameras see are summed: those with a clear peak would tell the light where it is thin. The depth of the light sets the size of
//! the windows and of the background, which the first look does not know: looked at again until they hold it. The *place* of the sheet is not touched.

use super::correlate::{Correlator, Dewarped, Sums};
use super::lattice::Lattice;
use super::prepare::BACKGROUND_PX;
use super::profile::profile;
use super::round::{Series, depth_px, dewarped, maps_of};
use super::smear::Smear;
use crate::dewarp::SheetGrid;
use crate::error::Result;
use crate::record::{LightProfile, Record};
use rayon::prelude::*;

/// Looks at most; each doubles what it looks at or so.
const LOOKS: usize = 4;
/// Largest window, px.
const LARGEST_PX: usize = 512;

/// The light along the normal of the sheet.
pub(super) struct Light {
    pub(super) profile: Option<LightProfile>,
    smear: Option<Smear>,
    /// Windows of the check, and those in which the light was looked at, px.
    window_px: [usize; 2],
}

impl Light {
    /// Full width of the light at 1/e^2, mm; `NaN` where the cross-correlation is no wider than particle images.
    pub(super) fn thickness_mm(&self) -> f64 {
        self.smear.map_or(f64::NAN, |s| s.thickness_mm())
    }

    /// What must be said of windows that the light takes too much of.
    pub(super) fn flags(&self) -> Option<String> {
        let wanted = self.smear?.window_px();
        let [used, looked] = self.window_px;
        if wanted > looked {
            return Some(format!(
                "the light is thick: its depth asks for windows of {wanted} px, the field allows {looked}; its thickness may be too small"
            ));
        }
        (wanted > used).then(|| {
            format!(
                "the light is thick for windows of {used} px: its depth draws the correlation peak out over more than half of them, and the sigmas of \
                 the sheet may be too small; take --window-px {wanted}"
            )
        })
    }
}

/// Looks at the light in the record's sheet, in windows of `window_px` at least.
pub(super) fn light(record: &Record, series: &Series, window_px: usize) -> Result<Light> {
    let maps = maps_of(record)?;
    let maps = [&maps[0], &maps[1]];
    let grid = SheetGrid::common(&maps, None)?;
    let depth_px = depth_px(maps, &grid);
    let largest = LARGEST_PX.min(grid.width_px).min(grid.height_px).max(window_px);
    let (mut window, mut background) = (window_px, BACKGROUND_PX);
    let mut out = Light { profile: None, smear: None, window_px: [window_px; 2] };
    // Cameras that look along one line see no depth.
    if !(depth_px.norm() > 0.0) {
        return Ok(out);
    }
    for _ in 0..LOOKS {
        let correlator = Correlator::new(window);
        let particles = dewarped(series, maps, &grid, background);
        let lattice = Lattice::centred([grid.width_px, grid.height_px], window, window);
        let Some(sums) = summed(&correlator, &particles, grid.width_px, &lattice) else { break };
        let (cross, autos) = (correlator.map(sums.cross), sums.auto.map(|a| correlator.map(a)));
        let smear = Smear::of(&cross, &autos, depth_px);
        out = Light { profile: profile(&cross, depth_px), smear, window_px: [window_px, window] };
        let Some(smear) = smear else { break };
        let wanted = [smear.window_px().clamp(window, largest), smear.background_px().max(background)];
        if wanted == [window, background] {
            break;
        }
        [window, background] = wanted;
    }
    Ok(out)
}

/// All windows, a row of them at a time: together they would need 24 bytes per pixel of the field.
pub(super) fn summed(
    correlator: &Correlator,
    particles: &[Dewarped],
    width_px: usize,
    lattice: &Lattice,
) -> Option<Sums> {
    let one = |k: usize| {
        let [column, row] = lattice.corner(k);
        correlator.window(particles, width_px, column, row)
    };
    let mut total = None;
    for row in 0..lattice.rows {
        let windows: Vec<Option<Sums>> =
            (row * lattice.columns..(row + 1) * lattice.columns).into_par_iter().map(one).collect();
        total = total.into_iter().chain(windows.into_iter().flatten()).reduce(added);
    }
    total
}

fn added(mut total: Sums, s: Sums) -> Sums {
    let sum = |to: &mut [f64], more: &[f64]| to.iter_mut().zip(more).for_each(|(a, b)| *a += b);
    sum(&mut total.cross, &s.cross);
    (0..2).for_each(|c| sum(&mut total.auto[c], &s.auto[c]));
    total
}
