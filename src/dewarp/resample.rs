//! Images resampled on a grid of the sheet; the map is computed on the way, row by row.

use super::grid::SheetGrid;
use super::kernel::{Kernel, Sampler};
use super::map::SheetMap;
use super::rows::Row;
use crate::error::{Invalid, Result};
use crate::image::{GrayImage, GrayView, Pixels, Samples};
use crate::lanes::run;
use nalgebra::Vector2;
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

/// Images of a row of the grid; `NaN` where a point has none.
fn positions(map: &SheetMap, grid: &SheetGrid, j: usize, z_mm: f64) -> [Vec<f64>; 2] {
    let n = grid.width_px;
    let (mut x_mm, mut y_mm) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for i in 0..n {
        let [x, y] = grid.point_mm(i as f64, j as f64);
        x_mm.push(x);
        y_mm.push(y);
    }
    let mut out = [vec![0.0; n], vec![0.0; n]];
    let [u, v] = &mut out;
    map.images_into([&x_mm, &y_mm, &vec![z_mm; n]], [u, v]);
    out
}

/// Grey levels and validity on the grid in the plane z = `z_mm`, rows packed.
///
/// Rows are worked on by the threads of the pool in which this is called; the bits do not depend on their number.
pub(crate) fn resample(sampler: &Sampler, map: &SheetMap, grid: &SheetGrid, z_mm: f64) -> (Vec<f32>, Vec<bool>) {
    let n = grid.width_px * grid.height_px;
    let (mut levels, mut valid) = (vec![0.0; n], vec![false; n]);
    levels.par_chunks_mut(grid.width_px).zip(valid.par_chunks_mut(grid.width_px)).enumerate().for_each(
        |(j, (levels, valid))| {
            let [u_px, v_px] = positions(map, grid, j, z_mm);
            run(Row { sampler, u_px: &u_px, v_px: &v_px, levels, valid });
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
