//! What stands still from moment to moment, in front of the light or behind it.
//!
//! A wall or a reflection is alike in both cameras at every moment, and more so the more moments are taken together: windows see it in its own plane, with
//! a small scatter. Particles of other moments are others. So the left images of all moments are correlated with right ones of other moments, and what is
//! alike there is compared with what is alike at the same moment:
//! ```text
//! part = (max C' - median C') / (max C - median C)       C' left of moment i, right of moment i + N / 2; C of the same; all windows together
//! ```
//! The median takes off what uneven light makes alike all over a window. Images can be freed of it beforehand ([`without_mean`]).

use super::check::ParticlePair;
use super::correlate::{Correlator, Dewarped};
use super::lattice::Lattice;
use super::light::summed;
use super::peak::CorrelationMap;
use super::prepare::{BACKGROUND_PX, levels};
use super::round::{Series, dewarped, maps_of};
use crate::dewarp::SheetGrid;
use crate::error::{Invalid, Result};
use crate::image::{GrayImage, Pixels};
use crate::record::Record;
use crate::stats::median;

/// So much of the likeness of one moment between different ones is told.
const MOST: f64 = 0.3;

/// Part of the likeness at one moment that different moments have as well, in the record's sheet; none of a single moment.
fn still_part(record: &Record, series: &Series, window_px: usize) -> Result<Option<f64>> {
    let count = series.moments.len();
    if count < 2 {
        return Ok(None);
    }
    let maps = maps_of(record)?;
    let maps = [&maps[0], &maps[1]];
    let grid = SheetGrid::common(&maps, None)?;
    let correlator = Correlator::new(window_px);
    let lattice = Lattice::centred([grid.width_px, grid.height_px], window_px, window_px);
    let mut moments = dewarped(series, maps, &grid, BACKGROUND_PX);
    let stands_out = |moments: &[Dewarped]| -> Option<f64> {
        let map: CorrelationMap = correlator.map(summed(&correlator, moments, grid.width_px, &lattice)?.cross);
        let top = map.values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut values = map.values;
        Some(top - median(&mut values)?)
    };
    let own = stands_out(&moments);
    let mut right: Vec<Vec<f32>> = moments.iter_mut().map(|m| std::mem::take(&mut m.levels[1])).collect();
    // Exposures of one moment that follow each other show the same particles.
    right.rotate_left(count / 2);
    moments.iter_mut().zip(right).for_each(|(m, right)| m.levels[1] = right);
    Ok(own.zip(stands_out(&moments)).filter(|(own, _)| *own > 0.0).map(|(own, other)| other / own))
}

/// What must be said of a scene that stands still.
pub(super) fn flag(record: &Record, series: &Series, window_px: usize) -> Result<Option<String>> {
    let part = still_part(record, series, window_px)?.filter(|part| *part > MOST);
    Ok(part.map(|part| {
        format!(
            "images of different moments are alike, too ({:.0} % of what those of one moment are): the sheet found may be that of a wall or of reflections, \
             which stand still (leave them out with --masks, or take them off with --subtract-mean), or particles hardly moved between the moments, and count \
             as those of one",
            100.0 * part.min(1.0)
        )
    }))
}

/// Images of both cameras less the mean of all moments of the camera, pixel by pixel.
///
/// # Errors
/// [`Invalid::Contradiction`] for a single moment.
pub(super) fn without_mean(pairs: &[ParticlePair]) -> Result<Vec<[GrayImage; 2]>> {
    if pairs.len() < 2 {
        let what = "the mean of one image is the image itself; --subtract-mean needs two image pairs at least, of different moments";
        return Err(Invalid::Contradiction(what.into()).into());
    }
    let mean = |c: usize| {
        let mut sum = vec![0.0_f32; pairs[0].images[c].width() * pairs[0].images[c].height()];
        pairs.iter().for_each(|p| sum.iter_mut().zip(levels(&p.images[c])).for_each(|(s, l)| *s += l));
        sum.iter_mut().for_each(|s| *s /= pairs.len() as f32);
        sum
    };
    let means = [mean(0), mean(1)];
    let less = |p: &ParticlePair, c: usize| -> Result<GrayImage> {
        let less: Vec<f32> = levels(&p.images[c]).iter().zip(&means[c]).map(|(l, m)| l - m).collect();
        GrayImage::new(Pixels::F32(less), p.images[c].width(), p.images[c].height())
    };
    pairs.iter().map(|p| Ok([less(p, 0)?, less(p, 1)?])).collect()
}
