//! A plane as the record holds it.

use super::SheetEstimate;
use crate::record::{ANGLES_CONVENTION, Pose, Sheet, SheetSigma};

impl SheetEstimate {
    /// The sheet of a calibration, found by `method` from `views`.
    pub fn as_record(&self, method: &str, views: Vec<usize>) -> Sheet {
        Sheet {
            normal_in_rig: self.normal.into(),
            distance_mm: self.distance_mm,
            abc_per_mm: self.abc_per_mm.into(),
            angles_deg: self.angles_rad.map(f64::to_degrees),
            angles_convention: ANGLES_CONVENTION.into(),
            angle_to_baseline_deg: self.angle_to_baseline_rad.to_degrees(),
            sigma: self.sigma_record(),
            rig_from_sheet: Pose::from(&self.rig_from_sheet),
            method: method.into(),
            views,
            disparity_rms_px: None,
            homography: None,
        }
    }

    /// The sigmas in the units of the file.
    pub fn sigma_record(&self) -> SheetSigma {
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
