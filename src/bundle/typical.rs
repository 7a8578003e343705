//! Changes of natural parameters that a user would call large: what movements are measured by, whatever their units.

use super::posterior::Natural;
use crate::camera::INTRINSIC_NAMES;

/// Half a percent of a length, or 5 mrad.
const PART: f64 = 0.005;

/// Length by which shifts are measured: where the rig looks, mm.
pub(crate) fn distance_mm(natural: &Natural) -> f64 {
    let plane = natural.rig_from_plane.as_ref().map(|p| p.translation_mm.norm());
    let views = natural.rig_from_target.iter().map(|v| v.translation_mm.norm());
    plane.unwrap_or_else(|| views.fold(1.0, f64::max))
}

/// A large change of the parameter of this name, in the unit at its end; `cameras` are the names of the cameras.
pub(crate) fn typical(natural: &Natural, name: &str, cameras: &[&str]) -> f64 {
    let intrinsic = |c: usize| {
        let quantity = name.strip_prefix(cameras[c])?.strip_prefix('.')?;
        Some((c, INTRINSIC_NAMES.iter().position(|n| *n == quantity)?))
    };
    match (0..cameras.len().min(natural.cameras.len())).find_map(intrinsic) {
        Some((c, k)) => {
            let i = natural.cameras[c].intrinsics();
            // The image reaches about to the mirrored axis point.
            let s = (i.cx_px.abs().max(i.cy_px.abs()) / i.f_px).powi(2).clamp(1e-4, 1.0);
            match k {
                0 | 2 | 3 => PART * i.f_px,
                6..=8 => PART / s.powi(k as i32 - 5),
                _ => PART,
            }
        }
        None if name.ends_with("_mm") => PART * distance_mm(natural),
        None => PART,
    }
}
