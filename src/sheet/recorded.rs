//! A plane as the record holds it.

use super::{SheetEstimate, plane_geometry};
use crate::record::{ANGLES_CONVENTION, Pose, Sheet, SheetSigma};
use nalgebra::Vector3;

impl SheetEstimate {
    /// The plane `normal . p = distance` of the rig frame, its sigmas unknown; `second_center_mm` is the second projection
    /// centre in the rig frame.
    pub fn of_plane(normal: Vector3<f64>, distance_mm: f64, second_center_mm: Option<Vector3<f64>>) -> Self {
        let mut estimate = plane_geometry(normal, distance_mm, second_center_mm).estimate;
        estimate.sigmas.fill(f64::NAN);
        estimate
    }

    /// The part `sheet` of a record; `method` says how it was found, `views` from which views.
    pub fn to_record(&self, method: &str, views: Vec<usize>) -> Sheet {
        Sheet {
            normal_in_rig: self.normal.into(),
            distance_mm: self.distance_mm,
            abc_per_mm: self.abc_per_mm.into(),
            angles_deg: self.angles_rad.map(f64::to_degrees),
            angles_convention: ANGLES_CONVENTION.into(),
            angle_to_baseline_deg: self.angle_to_baseline_rad.to_degrees(),
            sigma: self.record_sigma(),
            rig_from_sheet: Pose::from(&self.rig_from_sheet),
            method: method.into(),
            views,
            disparity_rms_px: None,
            homography: None,
        }
    }

    /// Its standard deviations in the units of the file.
    pub fn record_sigma(&self) -> SheetSigma {
        let s = &self.sigmas;
        SheetSigma {
            distance_mm: s[0],
            normal_rad: [s[1], s[2]],
            abc_per_mm: [s[3], s[4], s[5]],
            angles_deg: [s[6], s[7], s[8]].map(f64::to_degrees),
            angle_to_baseline_deg: s[9].to_degrees(),
        }
    }
}
