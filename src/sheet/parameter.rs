//! The named numbers of two cameras and a sheet, and what a change of one does.

use crate::camera::{Camera, INTRINSIC_NAMES, Intrinsics, WINDOW_STEP_NAMES};
use crate::rigid::Motion;
use nalgebra::SVector;

/// Row names of the sheet in a covariance.
pub(crate) const SHEET: &str = "sheet.rig_from_sheet.";
/// Ends of the names of a left step (see [`crate::rigid`]).
pub(crate) const STEP_NAMES: [&str; 6] = ["rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"];

/// One adjusted number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Parameter {
    /// Camera and index of the intrinsic.
    Intrinsic(usize, usize),
    /// Camera and step of its window, see [`WINDOW_STEP_NAMES`].
    Window(usize, usize),
    /// Part of a left step of the motion of the second camera against the rig.
    Motion(usize),
    /// Part of a left step of the sheet against the rig.
    Sheet(usize),
}

impl Parameter {
    /// The number of this name; `None` for one that belongs to neither the two cameras nor the sheet.
    pub(crate) fn of(name: &str, camera_names: [&str; 2]) -> Option<Self> {
        let step = |rest: &str| STEP_NAMES.iter().position(|n| *n == rest);
        if let Some(rest) = name.strip_prefix(SHEET) {
            return step(rest).map(Parameter::Sheet);
        }
        let c = (0..2).find(|&c| name.strip_prefix(camera_names[c]).is_some_and(|r| r.starts_with('.')))?;
        let rest = &name[camera_names[c].len() + 1..];
        if let Some(k) = INTRINSIC_NAMES.iter().position(|n| *n == rest) {
            return Some(Parameter::Intrinsic(c, k));
        }
        if let Some(rest) = rest.strip_prefix("window.") {
            return WINDOW_STEP_NAMES.iter().position(|n| *n == rest).map(|k| Parameter::Window(c, k));
        }
        step(rest.strip_prefix("cam_from_rig.").filter(|_| c == 1)?).map(Parameter::Motion)
    }
}

impl Parameter {
    /// A change small enough to be straight and large enough to be felt, for cameras with these image distances and a sheet this far away.
    pub(crate) fn step(self, f_px: [f64; 2], distance_mm: f64) -> f64 {
        match self {
            Parameter::Intrinsic(c, 0 | 2 | 3) => 1e-5 * f_px[c],
            Parameter::Intrinsic(_, 6..=8) => 1e-3,
            Parameter::Window(_, 3 | 4) => 1e-5 * distance_mm,
            Parameter::Intrinsic(..) | Parameter::Window(..) => 1e-5,
            Parameter::Motion(k) | Parameter::Sheet(k) if k < 3 => 1e-5,
            Parameter::Motion(_) | Parameter::Sheet(_) => 1e-5 * distance_mm,
        }
    }
}

/// The camera after a change of one intrinsic; `None` where there is no such camera.
pub(crate) fn stepped_camera(camera: &Camera, k: usize, h: f64) -> Option<Camera> {
    let old = camera.intrinsics();
    let mut p = old.to_array();
    p[k] += h;
    Some(Camera::new(Intrinsics::from_array(&p, old.radial)).ok()?.with_window(camera.window().copied()))
}

/// The camera after one step of its window; `None` where it has none, or there is no such window.
pub(crate) fn stepped_window(camera: &Camera, k: usize, h: f64) -> Option<Camera> {
    let (mut turn, mut layers) = ([0.0; 3], [0.0; 5]);
    if k < 3 {
        turn[k] = h;
    } else {
        layers[k - 3] = h;
    }
    let window = camera.window()?.stepped(&turn.into(), &layers).ok()?;
    Some(camera.with_window(Some(window)))
}

/// The motion after a left step of one part.
pub(crate) fn stepped_motion<A, B>(motion: &Motion<A, B>, k: usize, h: f64) -> Motion<A, B> {
    let mut d = SVector::<f64, 6>::zeros();
    d[k] = h;
    motion.retract(&d)
}
