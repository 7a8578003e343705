//! Images resampled on a grid of the sheet; the map is computed on the way, row by row.

use super::grid::SheetGrid;
use super::kernel::{Kernel, Sampler};
use super::map::SheetMap;
use crate::error::{Invalid, Result};
use crate::image::{GrayImage, GrayView, Pixels, Samples};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// A dewarped image.
#[derive(Debug, Clone, PartialEq)]
pub struct Dewarped {
    /// Grey levels, of the depth of the original; 0 where not valid.
    pub image: GrayImage,
    /// Whether the camera sees the pixel, rows packed.
    pub valid: Vec<bool>,
}

/// Whether a position lies on the sensor, the outer halves of the border pixels included.
pub(super) fn inside(q: &Vector2<f64>, size_px: [usize; 2]) -> bool {
    let within = |x: f64, n: usize| x >= -0.5 && x <= n as f64 - 0.5;
    within(q.x, size_px[0]) && within(q.y, size_px[1])
}

/// Grey levels and validity on the grid in the plane z = `z_mm`, rows packed.
///
/// Rows are worked on by the threads of the pool in which this is called; the bits do not depend on their number.
pub(crate) fn resample(sampler: &Sampler, map: &SheetMap, grid: &SheetGrid, z_mm: f64) -> (Vec<f32>, Vec<bool>) {
    let n = grid.width_px * grid.height_px;
    let (mut levels, mut valid) = (vec![0.0; n], vec![false; n]);
    levels.par_chunks_mut(grid.width_px).zip(valid.par_chunks_mut(grid.width_px)).enumerate().for_each(
        |(j, (levels, valid))| {
            for i in 0..grid.width_px {
                let [x, y] = grid.point_mm(i as f64, j as f64);
                let Some(q) = map.project(&Vector3::new(x, y, z_mm)) else { continue };
                if inside(&q, sampler.size_px()) {
                    levels[i] = sampler.at(q.x, q.y);
                    valid[i] = true;
                }
            }
        },
    );
    (levels, valid)
}

/// An image on a grid in the plane z = `z_mm` of the sheet frame.
///
/// Depth is kept: 8 and 16 bit are rounded and kept within their limits, floats stay as they come.
///
/// # Errors
/// [`Invalid::Value`] where the image has another size than the map was made for.
pub fn dewarp(view: &GrayView<'_>, map: &SheetMap, grid: &SheetGrid, kernel: Kernel, z_mm: f64) -> Result<Dewarped> {
    let size = [view.width(), view.height()];
    if let Some(a) = (0..2).find(|a| size[*a] != map.size_px()[*a]) {
        let what = format!("{} px, as at the calibration", map.size_px()[a]);
        return Err(Invalid::value(["image width", "image height"][a], size[a] as f64, what).into());
    }
    let (levels, valid) = resample(&Sampler::new(view, kernel), map, grid, z_mm);
    let pixels = match view.samples() {
        Samples::U8(_) => Pixels::U8(levels.iter().map(|x| x.round() as u8).collect()),
        Samples::U16(_) => Pixels::U16(levels.iter().map(|x| x.round() as u16).collect()),
        Samples::F32(_) => Pixels::F32(levels),
    };
    Ok(Dewarped { image: GrayImage::new(pixels, grid.width_px, grid.height_px)?, valid })
}
