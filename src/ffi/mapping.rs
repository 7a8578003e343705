//! Many points through a calibration at once, in the calling thread.

use super::abi::{SPIVCAL_ERROR_NOT_AVAILABLE, SPIVCAL_OK, SPIVCAL_WARNING_POINTS};
use super::door::{Fault, Outcome, enter};
use super::keys::*;
use super::memory::{Filled, In};
use super::results::state_of;
use super::table::Kind;
use crate::camera::Refusal;
use crate::dewarp::{NoMeeting, SheetMap};
use crate::record::PlacedCamera;
use nalgebra::{Vector2, Vector3};

/// Images of points of the rig frame.
///
/// `camera`: from 0. `x_mm`, `y_mm`, `z_mm`: `count` doubles each, mm, rig frame (that of the first camera: x right, y down, z forward).
/// `u_px`, `v_px`: receive `count` doubles each; (0, 0) is the centre of the first pixel. NaN where a point has no image.
/// `point_status`: receives `count` SPIVCAL_POINT_*; may be NULL. Arrays that are written must not overlap others.
/// SPIVCAL_OK, or SPIVCAL_WARNING_POINTS where at least one point has no image.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_project(
    calibration: u64,
    camera: u64,
    count: u64,
    x_mm: *const f64,
    y_mm: *const f64,
    z_mm: *const f64,
    u_px: *mut f64,
    v_px: *mut f64,
    point_status: *mut i32,
) -> i32 {
    on(calibration, camera, |camera| {
        // SAFETY: the contract of the header.
        let (points, images, status) = unsafe {
            (
                [In::new(x_mm, count, "x_mm")?, In::new(y_mm, count, "y_mm")?, In::new(z_mm, count, "z_mm")?],
                [Filled::new(u_px, count, "u_px")?, Filled::new(v_px, count, "v_px")?],
                status_of(point_status, count),
            )
        };
        map(count, points, images, status, |[x, y, z]| {
            camera.pixel_from_rig(&Vector3::new(x, y, z)).map(|q| [q.x, q.y]).map_err(refusal)
        })
    })
}

/// Rays of pixels.
///
/// `u_px`, `v_px`: `count` doubles each, px. `dx`, `dy`, `dz`: receive `count` doubles each: unit directions in the rig frame, away from
/// the camera. The rays begin at the projection centre: the translation of the inverse of SPIVCAL_ARRAY_CAM_FROM_RIG. Of a camera
/// behind a window they are the rays in the air, up to the glass: spivcal_calibration_sight_from_pixel says where they go on.
/// NaN, `point_status` and status as in spivcal_calibration_project.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_unproject(
    calibration: u64,
    camera: u64,
    count: u64,
    u_px: *const f64,
    v_px: *const f64,
    dx: *mut f64,
    dy: *mut f64,
    dz: *mut f64,
    point_status: *mut i32,
) -> i32 {
    on(calibration, camera, |camera| {
        // SAFETY: the contract of the header.
        let (pixels, rays, status) = unsafe {
            (
                [In::new(u_px, count, "u_px")?, In::new(v_px, count, "v_px")?],
                [Filled::new(dx, count, "dx")?, Filled::new(dy, count, "dy")?, Filled::new(dz, count, "dz")?],
                status_of(point_status, count),
            )
        };
        map(count, pixels, rays, status, |[u, v]| {
            camera.ray_in_rig(&Vector2::new(u, v)).map(|d| [d.x, d.y, d.z]).map_err(refusal)
        })
    })
}

/// Lines on which pixels see the scene, for every camera: of one behind a window those in the water.
///
/// `u_px`, `v_px`: `count` doubles each, px. `x_mm`, `y_mm`, `z_mm`: receive `count` doubles each: a point of each line, mm, rig frame: the
/// projection centre, or where the ray leaves the glass. `dx`, `dy`, `dz`: receive `count` doubles each: unit directions in the rig
/// frame, away from the camera. NaN, `point_status` and status as in spivcal_calibration_project.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_sight_from_pixel(
    calibration: u64,
    camera: u64,
    count: u64,
    u_px: *const f64,
    v_px: *const f64,
    x_mm: *mut f64,
    y_mm: *mut f64,
    z_mm: *mut f64,
    dx: *mut f64,
    dy: *mut f64,
    dz: *mut f64,
    point_status: *mut i32,
) -> i32 {
    on(calibration, camera, |camera| {
        // SAFETY: the contract of the header.
        let (pixels, lines, status) = unsafe {
            let [x, y, z] =
                [(x_mm, "x_mm"), (y_mm, "y_mm"), (z_mm, "z_mm")].map(|(p, name)| Filled::new(p, count, name));
            let [dx, dy, dz] = [(dx, "dx"), (dy, "dy"), (dz, "dz")].map(|(p, name)| Filled::new(p, count, name));
            (
                [In::new(u_px, count, "u_px")?, In::new(v_px, count, "v_px")?],
                [x?, y?, z?, dx?, dy?, dz?],
                status_of(point_status, count),
            )
        };
        map(count, pixels, lines, status, |[u, v]| {
            let (p, d) = camera.sight_in_rig(&Vector2::new(u, v)).map_err(refusal)?;
            Ok([p.x, p.y, p.z, d.x, d.y, d.z])
        })
    })
}

/// Where the rays of pixels meet the laser sheet.
///
/// `u_px`, `v_px`: `count` doubles each, px. `x_mm`, `y_mm`: receive `count` doubles each, mm, sheet frame (x right, y up as the first
/// camera sees it; SPIVCAL_ARRAY_RIG_FROM_SHEET is its pose). NaN, `point_status` and status as in spivcal_calibration_project.
/// SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_sheet_from_pixel(
    calibration: u64,
    camera: u64,
    count: u64,
    u_px: *const f64,
    v_px: *const f64,
    x_mm: *mut f64,
    y_mm: *mut f64,
    point_status: *mut i32,
) -> i32 {
    on_sheet(calibration, camera, |map_of_camera| {
        // SAFETY: the contract of the header.
        let (pixels, points, status) = unsafe {
            (
                [In::new(u_px, count, "u_px")?, In::new(v_px, count, "v_px")?],
                [Filled::new(x_mm, count, "x_mm")?, Filled::new(y_mm, count, "y_mm")?],
                status_of(point_status, count),
            )
        };
        map(count, pixels, points, status, |[u, v]| {
            map_of_camera.sheet_from_pixel(&Vector2::new(u, v), 0.0).map(|p| [p.x, p.y]).map_err(no_meeting)
        })
    })
}

/// Images of points of the laser sheet.
///
/// `x_mm`, `y_mm`: `count` doubles each, mm, sheet frame. `u_px`, `v_px`: receive `count` doubles each, px.
/// NaN, `point_status` and status as in spivcal_calibration_project. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_pixel_from_sheet(
    calibration: u64,
    camera: u64,
    count: u64,
    x_mm: *const f64,
    y_mm: *const f64,
    u_px: *mut f64,
    v_px: *mut f64,
    point_status: *mut i32,
) -> i32 {
    on_sheet(calibration, camera, |map_of_camera| {
        // SAFETY: the contract of the header.
        let (points, pixels, status) = unsafe {
            (
                [In::new(x_mm, count, "x_mm")?, In::new(y_mm, count, "y_mm")?],
                [Filled::new(u_px, count, "u_px")?, Filled::new(v_px, count, "v_px")?],
                status_of(point_status, count),
            )
        };
        map(count, points, pixels, status, |[x, y]| {
            map_of_camera.pixel_from_sheet(&Vector3::new(x, y, 0.0)).map(|q| [q.x, q.y]).map_err(refusal)
        })
    })
}

/// The one loop: NaN and a status where a point has no result.
fn map<const N: usize, const M: usize>(
    count: u64,
    from: [In<f64>; N],
    to: [Filled<f64>; M],
    status: Option<Filled<i32>>,
    each: impl Fn([f64; N]) -> Result<[f64; M], i32>,
) -> Outcome {
    let mut refused = false;
    // `In::new` has checked that the count is one of memory.
    for i in 0..count as usize {
        let (values, why) = match each(std::array::from_fn(|k| from[k].get(i))) {
            Ok(values) => (values, SPIVCAL_POINT_OK),
            Err(why) => ([f64::NAN; M], why),
        };
        refused |= why != SPIVCAL_POINT_OK;
        for k in 0..M {
            to[k].set(i, values[k]);
        }
        if let Some(status) = &status {
            status.set(i, why);
        }
    }
    Ok(if refused { SPIVCAL_WARNING_POINTS } else { SPIVCAL_OK })
}

/// # Safety
/// `to` is null or can be written for `count` elements.
unsafe fn status_of(to: *mut i32, count: u64) -> Option<Filled<i32>> {
    // SAFETY: the contract of this function.
    if to.is_null() { None } else { unsafe { Filled::new(to, count, "point_status") }.ok() }
}

fn refusal(refusal: Refusal) -> i32 {
    match refusal {
        Refusal::BehindCamera { .. } => SPIVCAL_POINT_BEHIND_CAMERA,
        Refusal::BeforeWindow { .. } => SPIVCAL_POINT_BEFORE_WINDOW,
        Refusal::OffSensor => SPIVCAL_POINT_OFF_SENSOR,
        Refusal::BeyondDistortion { .. } => SPIVCAL_POINT_BEYOND_DISTORTION,
        Refusal::NotFinite => SPIVCAL_POINT_NOT_FINITE,
    }
}

fn no_meeting(why: NoMeeting) -> i32 {
    match why {
        NoMeeting::Camera(why) => refusal(why),
        NoMeeting::OffSheet => SPIVCAL_POINT_OFF_SHEET,
    }
}

fn on(calibration: u64, camera: u64, call: impl FnOnce(&PlacedCamera) -> Outcome) -> i32 {
    // A copy that no pointer of the caller can reach: its numbers need not be read again after every result.
    enter(calibration, Kind::Calibration, |object| {
        let camera = *one(&state_of(object)?.cameras, camera)?;
        call(&camera)
    })
}

fn on_sheet(calibration: u64, camera: u64, call: impl FnOnce(&SheetMap) -> Outcome) -> i32 {
    enter(calibration, Kind::Calibration, |object| {
        let state = state_of(object)?;
        one(&state.cameras, camera)?;
        let none = "the calibration has no sheet: no view was recorded in it (sheet = true)";
        call(one(&state.maps, camera).map_err(|_| Fault::new(SPIVCAL_ERROR_NOT_AVAILABLE, none))?)
    })
}

fn one<T>(all: &[T], camera: u64) -> Result<&T, Fault> {
    usize::try_from(camera).ok().and_then(|c| all.get(c)).ok_or_else(|| Fault::index("camera", camera, all.len()))
}
