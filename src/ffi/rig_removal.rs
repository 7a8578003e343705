//! Rig descriptions: what was said is taken back, and views are removed, as a live job needs it.

use super::abi::SPIVCAL_OK;
use super::rig::on;

/// Takes back what spivcal_rig_set_number or spivcal_rig_set_text said, so that the default holds again. What was not said may be unset, too.
///
/// `key`: one of SPIVCAL_RIG_*. `index`: as there; of the radii of a target and of the point of an origin it takes this entry and those after it.
/// The standard deviation of a number goes with the number, column, row and level with SPIVCAL_RIG_SHEET_ORIGIN_VIEW, and a position along a traverse
/// that nobody has read with SPIVCAL_RIG_VIEW_PLANE_Z_MM, too.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_unset(rig: u64, key: i32, index: u64) -> i32 {
    on(rig, |state| state.document.unset(key, index).map(|()| SPIVCAL_OK))
}

/// Takes back what spivcal_rig_set_known said of a parameter of a camera.
///
/// `camera`: from 0. `parameter`: SPIVCAL_PARAMETER_*. A camera without any parameter of a window, and without
/// SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, looks through none.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_unset_known(rig: u64, camera: u64, parameter: i32) -> i32 {
    on(rig, |state| state.document.unset_known(camera, parameter).map(|()| SPIVCAL_OK))
}

/// Takes back what spivcal_rig_set_scale said.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_unset_scale(rig: u64) -> i32 {
    on(rig, |state| {
        state.document.unset_scale();
        Ok(SPIVCAL_OK)
    })
}

/// A camera has no image in a view, whether it came from memory or was named as a file.
///
/// `view`, `camera`: from 0.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_unset_image(rig: u64, view: u64, camera: u64) -> i32 {
    on(rig, |state| state.unset_image(view, camera).map(|()| SPIVCAL_OK))
}

/// Removes a view with its images. The views after it are counted one less from then on, also in what names a view, and in the names that images
/// from memory have; calibrations and jobs that there are keep their numbers.
///
/// `view`: from 0. SPIVCAL_ERROR_ARGUMENT where the scale, or the origin or x axis of the sheet frame, is stated in this view.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_remove_view(rig: u64, view: u64) -> i32 {
    on(rig, |state| state.remove_view(view).map(|()| SPIVCAL_OK))
}

/// Removes all marks of a grid or plate.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_remove_marks(rig: u64) -> i32 {
    on(rig, |state| {
        state.document.remove_marks();
        Ok(SPIVCAL_OK)
    })
}
