//! Many points through a calibration at once, in the calling thread.

use super::abi::{SPIVCAL_ERROR_NOT_AVAILABLE, SPIVCAL_OK, SPIVCAL_WARNING_POINTS};
use super::door::{Fault, Outcome, enter};
use super::keys::*;
use super::memory::{Filled, length_of};
use super::results::{CalibrationState, state_of};
use super::table::Kind;
use crate::camera::Refusal;
use crate::dewarp::{NoMeeting, SheetMap};
use crate::lanes::{Column, ColumnMut};
use crate::record::PlacedCamera;
use nalgebra::{Vector2, Vector3};
use std::ops::Range;

/// Images of points of the rig frame.
///
/// `camera`: from 0. `x_mm`, `y_mm`, `z_mm`: `count` doubles each, mm, rig frame (that of the first camera: x right, y down, z forward).
/// `u_px`, `v_px`: receive `count` doubles each; (0, 0) is the centre of the first pixel. NaN where a point has no image.
/// `point_status`: receives `count` SPIVCAL_POINT_*; may be NULL. Arrays that are written must not overlap those that are read
/// (SPIVCAL_ERROR_ARGUMENT). A point has the same
/// result, to the bit, alone and among others: a call with many points is what is quick.
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
        let (points, pixels) = ([(x_mm, "x_mm"), (y_mm, "y_mm"), (z_mm, "z_mm")], [(u_px, "u_px"), (v_px, "v_px")]);
        // SAFETY: the contract of the header.
        let lists = unsafe { Lists::new(count, points, pixels, point_status) }?;
        lists.map(
            |p, q| camera.camera.images_into(&camera.cam_from_rig, p, q),
            |[x, y, z]| camera.pixel_from_rig(&Vector3::new(x, y, z)).map(|q| [q.x, q.y]).map_err(refusal),
        )
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
        let (pixels, rays) = ([(u_px, "u_px"), (v_px, "v_px")], [(dx, "dx"), (dy, "dy"), (dz, "dz")]);
        // SAFETY: the contract of the header.
        let lists = unsafe { Lists::new(count, pixels, rays, point_status) }?;
        let rig_from_cam = camera.cam_from_rig.rotation.transpose();
        lists.map(
            |q, d| camera.camera.rays_into(&rig_from_cam, q, d),
            |[u, v]| camera.ray_in_rig(&Vector2::new(u, v)).map(|d| [d.x, d.y, d.z]).map_err(refusal),
        )
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
        let pixels = [(u_px, "u_px"), (v_px, "v_px")];
        let sights = [(x_mm, "x_mm"), (y_mm, "y_mm"), (z_mm, "z_mm"), (dx, "dx"), (dy, "dy"), (dz, "dz")];
        // SAFETY: the contract of the header.
        let lists = unsafe { Lists::new(count, pixels, sights, point_status) }?;
        let (rig_from_cam, center_mm) = (camera.cam_from_rig.rotation.transpose(), camera.center_in_rig());
        lists.map(
            |q, [x, y, z, dx, dy, dz]| {
                let in_air = camera.camera.window().is_none();
                // Behind a window every line begins elsewhere.
                let begin_mm = if in_air { center_mm } else { Vector3::repeat(f64::NAN) };
                for (mut list, at) in [x, y, z].into_iter().zip(&begin_mm) {
                    list.fill(*at);
                }
                in_air && camera.camera.rays_into(&rig_from_cam, q, [dx, dy, dz])
            },
            |[u, v]| {
                let (p, d) = camera.sight_in_rig(&Vector2::new(u, v)).map_err(refusal)?;
                Ok([p.x, p.y, p.z, d.x, d.y, d.z])
            },
        )
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
    on_sheet(calibration, camera, |map| {
        let (pixels, points) = ([(u_px, "u_px"), (v_px, "v_px")], [(x_mm, "x_mm"), (y_mm, "y_mm")]);
        // SAFETY: the contract of the header.
        let lists = unsafe { Lists::new(count, pixels, points, point_status) }?;
        lists.map(
            |[u, v], p| map.hits_into([u, v, in_sheet(u.len())], p),
            |[u, v]| map.sheet_from_pixel(&Vector2::new(u, v), 0.0).map(|p| [p.x, p.y]).map_err(no_meeting),
        )
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
    on_sheet(calibration, camera, |map| {
        let (points, pixels) = ([(x_mm, "x_mm"), (y_mm, "y_mm")], [(u_px, "u_px"), (v_px, "v_px")]);
        // SAFETY: the contract of the header.
        let lists = unsafe { Lists::new(count, points, pixels, point_status) }?;
        lists.map(
            |[x, y], q| map.camera().images_into(map.cam_from_sheet(), [x, y, in_sheet(x.len())], q),
            |[x, y]| map.pixel_from_sheet(&Vector3::new(x, y, 0.0)).map(|q| [q.x, q.y]).map_err(refusal),
        )
    })
}

/// Points of a block: what was found is still in a core's own cache where a reason has to be given.
const BLOCK: usize = 4096;

/// z of points of the sheet, of a block at most.
fn in_sheet(count: usize) -> Column<'static> {
    const Z_MM: &[f64; BLOCK] = &[0.0; BLOCK];
    Z_MM[..count].into()
}

/// The caller's arrays: N that are read, M that are written, and one for the status of each point.
pub(super) struct Lists<'a, const N: usize, const M: usize> {
    count: usize,
    from: [Column<'a>; N],
    to: [ColumnMut<'a>; M],
    status: Option<Filled<i32>>,
}

/// Addresses of the bytes of an array.
fn bytes<T>(at: *const T, n: usize) -> Range<usize> {
    at.addr()..at.addr().saturating_add(n * size_of::<T>())
}

/// That what is written is none of what is read: that would be lost before.
fn apart(read: (Range<usize>, &str), written: (Range<usize>, &str)) -> Result<(), Fault> {
    if read.0.start >= written.0.end || written.0.start >= read.0.end {
        return Ok(());
    }
    Err(Fault::argument(format!(
        "{} lies in the memory of {}, which would be overwritten before it is read: results need an array of their own",
        written.1, read.1
    )))
}

impl<const N: usize, const M: usize> Lists<'_, N, M> {
    /// # Safety
    /// All that is not null can be read or written for `count` elements.
    pub(super) unsafe fn new(
        count: u64,
        from: [(*const f64, &str); N],
        to: [(*mut f64, &str); M],
        status: *mut i32,
    ) -> Result<Self, Fault> {
        let mut n = 0;
        for (list, argument) in from {
            n = length_of(list, count, argument)?;
        }
        for (list, argument) in to {
            length_of(list, count, argument)?;
        }
        for (read, argument) in from {
            let read = || (bytes(read, n), argument);
            to.into_iter().try_for_each(|(list, name)| apart(read(), (bytes(list, n), name)))?;
            if !status.is_null() {
                apart(read(), (bytes(status, n), "point_status"))?;
            }
        }
        // SAFETY: the contract of this function.
        unsafe {
            let status = if status.is_null() { None } else { Some(Filled::new(status, count, "point_status")?) };
            let from = from.map(|(list, _)| Column::new(list, n));
            Ok(Self { count: n, from, to: to.map(|(list, _)| ColumnMut::new(list, n)), status })
        }
    }

    /// Maps all points, block by block: `all` is quick, leaves what is not finite where a point has no result, and says whether there is none;
    /// `one` says why, or has the result where the two differ in rounding.
    pub(super) fn map(
        mut self,
        all: impl Fn([Column; N], [ColumnMut; M]) -> bool,
        one: impl Fn([f64; N]) -> Result<[f64; M], i32>,
    ) -> Outcome {
        let mut refused = false;
        for first in (0..self.count).step_by(BLOCK) {
            let n = BLOCK.min(self.count - first);
            let from = self.from.map(|list| list.part(first, n));
            let done = all(from, self.to.each_mut().map(|list| list.part(first, n)));
            if let Some(status) = &self.status {
                (first..first + n).for_each(|i| status.set(i, SPIVCAL_POINT_OK));
            }
            if done {
                continue;
            }
            for i in first..first + n {
                refused |= self.explain(i, &one);
            }
        }
        Ok(if refused { SPIVCAL_WARNING_POINTS } else { SPIVCAL_OK })
    }

    /// NaN and a reason where point `i` has no result; whether that is so.
    fn explain(&mut self, i: usize, one: impl Fn([f64; N]) -> Result<[f64; M], i32>) -> bool {
        if self.to.iter().all(|list| list.get(i).is_finite()) {
            return false;
        }
        let (values, why) = match one(self.from.map(|list| list.get(i))) {
            Ok(values) => (values, SPIVCAL_POINT_OK),
            Err(why) => ([f64::NAN; M], why),
        };
        for (list, value) in self.to.iter_mut().zip(values) {
            list.set(i, value);
        }
        if let Some(status) = &self.status {
            status.set(i, why);
        }
        why != SPIVCAL_POINT_OK
    }
}

pub(super) fn refusal(refusal: Refusal) -> i32 {
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
    enter(calibration, Kind::Calibration, |object| call(one(&state_of(object)?.cameras, camera)?))
}

fn on_sheet(calibration: u64, camera: u64, call: impl FnOnce(&SheetMap) -> Outcome) -> i32 {
    enter(calibration, Kind::Calibration, |object| call(map_of(state_of(object)?, camera)?))
}

/// The map of a camera on the sheet.
pub(super) fn map_of(state: &CalibrationState, camera: u64) -> Result<&SheetMap, Fault> {
    one(&state.cameras, camera)?;
    let none = "the calibration has no sheet: no view was recorded in it (sheet = true)";
    one(&state.maps, camera).map_err(|_| Fault::new(SPIVCAL_ERROR_NOT_AVAILABLE, none))
}

fn one<T>(all: &[T], camera: u64) -> Result<&T, Fault> {
    usize::try_from(camera).ok().and_then(|c| all.get(c)).ok_or_else(|| Fault::index("camera", camera, all.len()))
}
