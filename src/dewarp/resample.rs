//! Images resampled on a grid of the sheet; the map is computed on the way, a few pixels at a time.

use super::grid::SheetGrid;
use super::kernel::{Kernel, Source};
use super::map::SheetMap;
use super::panels::Panels;
use super::rows::{Band, Levels};
use super::sampler::Sampler;
use super::weights::Table;
use crate::error::{self, Invalid, Result};
use crate::image::{GrayImage, GrayView, Pixels, Samples};
use crate::lanes::Level;
use rayon::prelude::*;

/// Rows that one thread takes at a time.
const ROWS: usize = 8;

/// A dewarped image.
#[derive(Debug, Clone, PartialEq)]
pub struct Dewarped {
    /// Grey levels, of the depth of the original; 0 where not valid.
    pub image: GrayImage,
    /// Whether the camera sees the pixel, rows packed.
    pub valid: Vec<bool>,
}

/// The grid in the plane z = `z_mm`, as a camera sees it.
#[derive(Clone, Copy)]
struct Plane<'a> {
    map: &'a SheetMap,
    grid: &'a SheetGrid,
    z_mm: f64,
}

impl Plane<'_> {
    /// Levels and validity of every pixel, by the threads of the pool in which this is called; the bits do not depend on their number.
    fn fill<S: Level, D: Send>(
        &self,
        source: Source<'_, S>,
        pixels: &mut [D],
        valid: &mut [bool],
        levels: impl Fn(&mut [D]) -> Levels<'_> + Sync,
    ) {
        let Self { map, grid, z_mm } = *self;
        let table = matches!(source.kernel, Kernel::Lanczos | Kernel::BSpline).then(|| Table::of(source.kernel));
        let (table, panels) = (table.as_ref(), &Panels::of(grid.width_px));
        let band = ROWS * grid.width_px;
        pixels.par_chunks_mut(band).zip(valid.par_chunks_mut(band)).enumerate().for_each(|(k, (pixels, valid))| {
            Band { source, table, panels, map, grid, z_mm, first_row: k * ROWS, levels: levels(pixels), valid }.fill();
        });
    }

    fn fill_pixels<S: Level>(&self, source: Source<'_, S>, pixels: &mut Pixels, valid: &mut [bool]) {
        match pixels {
            Pixels::U8(p) => self.fill(source, p, valid, |p| Levels::U8(p)),
            Pixels::U16(p) => self.fill(source, p, valid, |p| Levels::U16(p)),
            Pixels::F32(p) => self.fill(source, p, valid, |p| Levels::F32(p)),
        }
    }
}

/// Grey levels and validity on the grid in the plane z = `z_mm`, rows packed.
pub(crate) fn resample(sampler: &Sampler, map: &SheetMap, grid: &SheetGrid, z_mm: f64) -> (Vec<f32>, Vec<bool>) {
    let n = grid.width_px * grid.height_px;
    let (mut levels, mut valid) = (vec![0.0; n], vec![false; n]);
    Plane { map, grid, z_mm }.fill(sampler.source(), &mut levels, &mut valid, |p| Levels::F32(p));
    (levels, valid)
}

/// Grey levels between those of the image, and validity, on a grid in the plane z = `z_mm` of the sheet frame, rows packed.
///
/// # Errors
/// As [`dewarp`].
pub(crate) fn dewarped_levels(
    view: &GrayView<'_>,
    map: &SheetMap,
    grid: &SheetGrid,
    kernel: Kernel,
    z_mm: f64,
) -> Result<(Vec<f32>, Vec<bool>)> {
    check(view, map, z_mm)?;
    room(grid, view.width() * view.height())?;
    Ok(resample(&Sampler::new(view, kernel), map, grid, z_mm))
}

/// That there is memory for an image that is dewarped, floats and where they are seen, and so many coefficients of the one that is read.
fn room(grid: &SheetGrid, coefficients: usize) -> Result<()> {
    let samples = grid.width_px * grid.height_px;
    let bytes = size_of::<f32>().saturating_mul(samples.saturating_add(coefficients)).saturating_add(samples);
    error::room(|| format!("a dewarped image of {} x {} px", grid.width_px, grid.height_px), bytes)
}

fn check(view: &GrayView<'_>, map: &SheetMap, z_mm: f64) -> Result<()> {
    let size_px = [view.width(), view.height()];
    if let Some(a) = (0..2).find(|a| size_px[*a] != map.size_px()[*a]) {
        let what = format!("{} px, as at the calibration", map.size_px()[a]);
        return Err(Invalid::value(["image width", "image height"][a], size_px[a] as f64, what).into());
    }
    if !z_mm.is_finite() {
        return Err(Invalid::value("z_mm", z_mm, "a finite number of mm").into());
    }
    Ok(())
}

/// An image on a grid in the plane z = `z_mm` of the sheet frame.
///
/// Depth is kept: 8 and 16 bit are rounded and kept within their limits, floats stay as they come.
///
/// # Errors
/// [`Invalid::Value`] where the image has another size than the map was made for, or z is no number; [`Invalid::Memory`].
pub fn dewarp(view: &GrayView<'_>, map: &SheetMap, grid: &SheetGrid, kernel: Kernel, z_mm: f64) -> Result<Dewarped> {
    let mut out = Dewarped { image: GrayImage::new(Pixels::U8(vec![0]), 1, 1)?, valid: vec![] };
    dewarp_into(view, map, grid, kernel, z_mm, &mut out)?;
    Ok(out)
}

/// [`dewarp`] into an image that is there already, for series: of any size and depth, but where both are those of the result its memory is used
/// again and, except for the coefficients of the B-spline, none other is asked for.
///
/// ```
/// use nalgebra::{Matrix3, Vector3};
/// use spivcal::camera::{Camera, Intrinsics};
/// use spivcal::dewarp::{Kernel, SheetGrid, SheetMap, dewarp, dewarp_into};
/// use spivcal::image::{GrayView, Samples};
/// use spivcal::rigid::Motion;
/// // A camera straight above the sheet, 10 px per mm.
/// let turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
/// let camera = Camera::new(Intrinsics::pinhole(5000.0, 49.5, 39.5))?;
/// let map = SheetMap::new(camera, Motion::new(turn, Vector3::new(0.0, 0.0, 500.0)), [100, 80]);
/// let grid = SheetGrid::over([-4.0, -3.0, 4.0, 3.0], 0.1)?;
/// let frames = [vec![7_u8; 8000], vec![9_u8; 8000]];
/// let view = |i: usize| GrayView::new(Samples::U8(&frames[i]), 100, 80, 100);
/// let mut out = dewarp(&view(0)?, &map, &grid, Kernel::Cubic, 0.0)?;
/// dewarp_into(&view(1)?, &map, &grid, Kernel::Cubic, 0.0, &mut out)?;
/// assert_eq!(out.image.view().get(40, 30), 9.0);
/// # Ok::<(), spivcal::Error>(())
/// ```
///
/// # Errors
/// As [`dewarp`]; `out` is then left as it was.
pub fn dewarp_into(
    view: &GrayView<'_>,
    map: &SheetMap,
    grid: &SheetGrid,
    kernel: Kernel,
    z_mm: f64,
    out: &mut Dewarped,
) -> Result<()> {
    check(view, map, z_mm)?;
    let size_px = [view.width(), view.height()];
    room(grid, if kernel == Kernel::BSpline { size_px[0] * size_px[1] } else { 0 })?;
    let valid = &mut out.valid;
    valid.resize(grid.width_px * grid.height_px, false);
    let pixels = out.image.renew(&view.samples(), grid.width_px, grid.height_px);
    let (plane, stride) = (Plane { map, grid, z_mm }, view.stride());
    if kernel == Kernel::BSpline {
        plane.fill_pixels(Sampler::new(view, kernel).source(), pixels, valid);
        return Ok(());
    }
    match view.samples() {
        Samples::U8(samples) => plane.fill_pixels(Source { kernel, samples, stride, size_px }, pixels, valid),
        Samples::U16(samples) => plane.fill_pixels(Source { kernel, samples, stride, size_px }, pixels, valid),
        Samples::F32(samples) => plane.fill_pixels(Source { kernel, samples, stride, size_px }, pixels, valid),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Intrinsics};
    use crate::rigid::{Motion, rotation_exp};
    use nalgebra::Vector3;

    /// As much as no machine has is an error with the size.
    #[test]
    fn memory_that_is_missing_is_no_end_of_the_process() {
        let grid = SheetGrid { origin_mm: [0.0; 2], mm_per_px: 1.0, width_px: 70, height_px: 80 };
        let error = room(&grid, 1 << 60).unwrap_err();
        let told = error.to_string();
        assert!(told.contains("70 x 80 px") && told.contains("4611686018427415904 bytes"), "{told}");
        assert_eq!(error.exit_code(), 2);
        assert!(room(&grid, 0).is_ok());
    }

    /// Memory that was there, of another size or depth, rows with a stride and threads change no bit.
    #[test]
    fn series_have_the_bits_of_single_images() {
        let (w, h, stride) = (64, 50, 71);
        let camera = Camera::new(Intrinsics::pinhole(1000.0, 31.0, 25.0)).unwrap();
        let place = Motion::new(rotation_exp(&Vector3::new(3.1, 0.05, 0.1)), Vector3::new(0.3, -0.2, 500.0));
        let map = SheetMap::new(camera, place, [w, h]);
        let grids = [0.31, 0.47].map(|step| SheetGrid::over([-17.0, -12.0, 16.0, 13.0], step).unwrap());
        let words: Vec<u16> = (0..stride * h).map(|i| (i * i * 37 % 65536) as u16).collect();
        let bytes: Vec<u8> = words.iter().map(|x| (x >> 8) as u8).collect();
        let floats: Vec<f32> = words.iter().map(|x| f32::from(*x) - 3e4).collect();
        let mut out =
            dewarp(&GrayView::new(Samples::U8(&bytes), w, h, w).unwrap(), &map, &grids[0], Kernel::Nearest, 0.0)
                .unwrap();
        for kernel in [Kernel::Nearest, Kernel::Linear, Kernel::Cubic, Kernel::Lanczos, Kernel::BSpline] {
            for samples in [Samples::U16(&words), Samples::U8(&bytes), Samples::F32(&floats)] {
                let view = GrayView::new(samples, w, h, stride).unwrap();
                let mut row = vec![];
                let rows = (0..h).flat_map(|v| {
                    view.row(v, &mut row);
                    row.clone()
                });
                let packed: Vec<f32> = rows.collect();
                let packed = GrayView::new(Samples::F32(&packed), w, h, w).unwrap();
                for grid in &grids {
                    dewarp_into(&view, &map, grid, kernel, 0.5, &mut out).unwrap();
                    assert_eq!(out, dewarp(&view, &map, grid, kernel, 0.5).unwrap());
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
                    assert_eq!(out, pool.install(|| dewarp(&view, &map, grid, kernel, 0.5)).unwrap());
                    // The same levels from floats, rounded.
                    let plain = dewarp(&packed, &map, grid, kernel, 0.5).unwrap();
                    assert_eq!(out.valid, plain.valid);
                    for j in 0..grid.height_px {
                        for i in 0..grid.width_px {
                            let level = plain.image.view().get(i, j);
                            let wanted = match view.samples() {
                                Samples::U8(_) => level.round().clamp(0.0, 255.0),
                                Samples::U16(_) => level.round().clamp(0.0, 65535.0),
                                Samples::F32(_) => level,
                            };
                            assert_eq!(out.image.view().get(i, j), wanted, "{kernel:?} {i} {j}");
                        }
                    }
                }
            }
        }
        let before = out.clone();
        let small = GrayView::new(Samples::U8(&bytes), w - 1, h, stride).unwrap();
        assert!(dewarp_into(&small, &map, &grids[0], Kernel::Cubic, 0.0, &mut out).is_err());
        assert_eq!(out, before);
    }
}
