//! From the calibration to velocity: images on a grid of the sheet, and three components of planar displacements.

use super::abi::{SPIVCAL_ERROR_NOT_AVAILABLE, SPIVCAL_OK};
use super::detection::{context_of, image_of};
use super::door::{Fault, enter};
use super::keys::*;
use super::mapping::{Lists, map_of, refusal};
use super::memory::{Filled, Out};
use super::results::{CalibrationState, state_of};
use super::table::Kind;
use crate::dewarp::{Kernel, SheetGrid, SheetMap, dewarped_levels};
use crate::lanes::{Column, ColumnMut};
use crate::pipeline::Workers;
use crate::reconstruct::{Components, component_sigmas, three_components};
use nalgebra::Vector3;
use std::cell::RefCell;

/// Grid of dewarped images: square pixels in the sheet that cover what all cameras see.
///
/// `mm_per_px`: side of a pixel, mm; 0 takes the finest that any of the cameras has there. `x0_mm`, `y0_mm`: receive the centre of the
/// first (upper left) pixel, mm, sheet frame. `side_mm`: receives the side of a pixel s, mm: pixel (i, j), column and row counted from 0, is
/// centred on (x0 + s i, y0 - s j). `width`, `height`: receive the size, px. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no
/// sheet, SPIVCAL_ERROR_INSUFFICIENT where the cameras see nothing in common in it, SPIVCAL_ERROR_INVALID_INPUT where the side is no number,
/// negative, or so small that the grid has more than 32768 px along a side.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_sheet_grid(
    calibration: u64,
    mm_per_px: f64,
    x0_mm: *mut f64,
    y0_mm: *mut f64,
    side_mm: *mut f64,
    width: *mut u32,
    height: *mut u32,
) -> i32 {
    enter(calibration, Kind::Calibration, |object| {
        let state = state_of(object)?;
        // SAFETY: the contract of the header.
        let (x0, y0, side) =
            unsafe { (Out::new(x0_mm, "x0_mm")?, Out::new(y0_mm, "y0_mm")?, Out::new(side_mm, "side_mm")?) };
        // SAFETY: the same.
        let (w, h) = unsafe { (Out::new(width, "width")?, Out::new(height, "height")?) };
        map_of(state, 0)?;
        let maps: Vec<&SheetMap> = state.maps.iter().collect();
        let grid = SheetGrid::common(&maps, (mm_per_px != 0.0).then_some(mm_per_px))?;
        x0.set(grid.origin_mm[0]);
        y0.set(grid.origin_mm[1]);
        side.set(grid.mm_per_px);
        w.set(u32::try_from(grid.width_px).unwrap_or(u32::MAX));
        h.set(u32::try_from(grid.height_px).unwrap_or(u32::MAX));
        Ok(SPIVCAL_OK)
    })
}

/// An image of a camera as it would look from above the sheet: dewarped.
///
/// `camera`: from 0. `image`: its handle, of the size that the camera was calibrated with. `kernel`: SPIVCAL_KERNEL_*.
/// `x0_mm`, `y0_mm`, `mm_per_px`, `width`, `height`: the grid, as spivcal_calibration_sheet_grid gives it, or any other; 1 to 32768 px
/// along a side. `z_mm`: plane parallel to the sheet in which the grid lies, mm, positive towards the first camera; 0: the sheet itself.
/// `grey`: receives width x height floats, rows from top to bottom without gaps: grey levels as those of the image, not rounded; 0 where the
/// camera sees nothing. `seen`: receives width x height bytes, 1 where the camera sees the pixel, else 0; may be NULL.
/// Uses the threads of the context; the result does not depend on their number. SPIVCAL_ERROR_INVALID_INPUT where sizes do not fit,
/// SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_dewarp(
    calibration: u64,
    camera: u64,
    image: u64,
    kernel: i32,
    x0_mm: f64,
    y0_mm: f64,
    mm_per_px: f64,
    z_mm: f64,
    width: u32,
    height: u32,
    grey: *mut f32,
    seen: *mut u8,
) -> i32 {
    enter(calibration, Kind::Calibration, |object| {
        let map = map_of(state_of(object)?, camera)?;
        let image = image_of(image)?;
        let kernel = kernel_of(kernel)?;
        let grid = SheetGrid::at([x0_mm, y0_mm], mm_per_px, [width as usize, height as usize])?;
        let count = u64::from(width) * u64::from(height);
        // SAFETY: the contract of the header.
        let grey = unsafe { Filled::new(grey, count, "grey") }?;
        // SAFETY: the same.
        let seen = if seen.is_null() { None } else { Some(unsafe { Filled::new(seen, count, "seen") }?) };
        let threads = context_of(object)?.threads;
        let found = Workers::new(threads)?.install(|| dewarped_levels(&image.view(), map, &grid, kernel, z_mm));
        let (levels, valid) = found?;
        grey.fill(levels.into_iter());
        if let Some(seen) = seen {
            seen.fill(valid.into_iter().map(u8::from));
        }
        Ok(SPIVCAL_OK)
    })
}

/// Three components of displacement from the planar displacements that both cameras show at points of the sheet.
///
/// `x_mm`, `y_mm`: `count` doubles each, mm, sheet frame: the middles of the paths, as windows that are shifted symmetrically give them.
/// `dx1_mm`, `dy1_mm`, `dx2_mm`, `dy2_mm`: `count` doubles each: displacements in the dewarped images of the first and the second
/// camera along x and y (up) of the sheet frame, mm; of images whose rows run down, dy is minus the displacement along the rows. NaN
/// where a camera has none.
/// `u_mm`, `v_mm`, `w_mm`: receive `count` doubles each, mm: displacement along x, y and z of the sheet frame; w is positive towards
/// the first camera. `residual_mm`: receives `count` doubles: root of the sum of squares of what the four equations leave, one degree of
/// freedom, about the standard deviation of a planar component where all is well.
/// `sigma_u`, `sigma_v`, `sigma_w`: receive `count` doubles each: standard deviations of u, v, w for independent planar components of
/// standard deviation 1; times that of yours they are those of the vector by its noise, without the part of the calibration.
/// `point_status`: as in spivcal_calibration_project. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet or one camera.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_components(
    calibration: u64,
    count: u64,
    x_mm: *const f64,
    y_mm: *const f64,
    dx1_mm: *const f64,
    dy1_mm: *const f64,
    dx2_mm: *const f64,
    dy2_mm: *const f64,
    u_mm: *mut f64,
    v_mm: *mut f64,
    w_mm: *mut f64,
    residual_mm: *mut f64,
    sigma_u: *mut f64,
    sigma_v: *mut f64,
    sigma_w: *mut f64,
    point_status: *mut i32,
) -> i32 {
    enter(calibration, Kind::Calibration, |object| {
        let maps = both(state_of(object)?)?;
        let planar = [(dx1_mm, "dx1_mm"), (dy1_mm, "dy1_mm"), (dx2_mm, "dx2_mm"), (dy2_mm, "dy2_mm")];
        let [dx1, dy1, dx2, dy2] = planar;
        let from = [(x_mm, "x_mm"), (y_mm, "y_mm"), dx1, dy1, dx2, dy2];
        let vector = [(u_mm, "u_mm"), (v_mm, "v_mm"), (w_mm, "w_mm"), (residual_mm, "residual_mm")];
        let [u, v, w, residual] = vector;
        let to = [u, v, w, residual, (sigma_u, "sigma_u"), (sigma_v, "sigma_v"), (sigma_w, "sigma_w")];
        // SAFETY: the contract of the header.
        let lists = unsafe { Lists::new(count, from, to, point_status) }?;
        let memory = RefCell::new(Components::default());
        lists.map(one_by_one, |given| vector_at(maps, given, &mut memory.borrow_mut()))
    })
}

/// No quick way for all: every vector has its own slopes.
fn one_by_one(_: [Column<'_>; 6], to: [ColumnMut<'_>; 7]) -> bool {
    to.into_iter().for_each(|mut list| list.fill(f64::NAN));
    false
}

/// u, v, w, what is left, and the three standard deviations; or why there are none.
fn vector_at(maps: [&SheetMap; 2], given: [f64; 6], memory: &mut Components) -> Result<[f64; 7], i32> {
    let [x, y, dx1, dy1, dx2, dy2] = given;
    if given.iter().any(|g| !g.is_finite()) {
        return Err(SPIVCAL_POINT_NOT_FINITE);
    }
    let slope = |map: &SheetMap| {
        let pixel = map.pixel_from_sheet(&Vector3::new(x, y, 0.0)).map_err(refusal)?;
        map.hit(&pixel, 0.0).map(|hit| hit.slope).ok_or(SPIVCAL_POINT_OFF_SHEET)
    };
    let [s, t] = [slope(maps[0])?, slope(maps[1])?];
    let slopes = [[s.x, s.y], [t.x, t.y]];
    let ([a, b], [c, d], [e, f], [g, h]) = ([[s.x], [s.y]], [[t.x], [t.y]], [[dx1], [dy1]], [[dx2], [dy2]]);
    three_components([[&a, &b], [&c, &d]], [[&e, &f], [&g, &h]], memory).map_err(|_| SPIVCAL_POINT_NOT_FINITE)?;
    let sigmas = component_sigmas(slopes);
    let out = [memory.u[0], memory.v[0], memory.w[0], memory.residual[0], sigmas[0], sigmas[1], sigmas[2]];
    if out.iter().all(|x| x.is_finite()) { Ok(out) } else { Err(SPIVCAL_POINT_ONE_LINE) }
}

fn both(state: &CalibrationState) -> Result<[&SheetMap; 2], Fault> {
    let first = map_of(state, 0)?;
    let second = state.maps.get(1).ok_or_else(|| {
        Fault::new(SPIVCAL_ERROR_NOT_AVAILABLE, "three components need two cameras, but the calibration holds one")
    })?;
    Ok([first, second])
}

fn kernel_of(kernel: i32) -> Result<Kernel, Fault> {
    Ok(match kernel {
        SPIVCAL_KERNEL_NEAREST => Kernel::Nearest,
        SPIVCAL_KERNEL_LINEAR => Kernel::Linear,
        SPIVCAL_KERNEL_CUBIC => Kernel::Cubic,
        SPIVCAL_KERNEL_LANCZOS => Kernel::Lanczos,
        SPIVCAL_KERNEL_BSPLINE => Kernel::BSpline,
        _ => return Err(Fault::argument(format!("kernel {kernel} is none of SPIVCAL_KERNEL_* (0 to 4)"))),
    })
}
