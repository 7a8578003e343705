//! The three components as CSV.

use super::VectorField;
use std::fmt::Write;

impl VectorField {
    /// One row per point, empty cells where there is no number: place, displacement, its standard deviations by the planar vectors
    /// (and by the calibration, where it was propagated), residual, flag, covariances of its components (by both).
    pub fn to_csv(&self) -> String {
        let calibrated = !self.calibration_sigma_mm[0].is_empty();
        let mut out = String::from("x_mm,y_mm,u_mm,v_mm,w_mm,sigma_u_mm,sigma_v_mm,sigma_w_mm");
        if calibrated {
            out.push_str(",calibration_sigma_u_mm,calibration_sigma_v_mm,calibration_sigma_w_mm");
        }
        out.push_str(",residual_px,flag,cov_uv_mm2,cov_uw_mm2,cov_vw_mm2");
        if calibrated {
            out.push_str(",calibration_cov_uv_mm2,calibration_cov_uw_mm2,calibration_cov_vw_mm2");
        }
        out.push('\n');
        for i in 0..self.x_mm.len() {
            let mut numbers = vec![self.x_mm[i], self.y_mm[i], self.u_mm[i], self.v_mm[i], self.w_mm[i]];
            numbers.extend(self.sigma_mm.iter().map(|s| s[i]));
            if calibrated {
                numbers.extend(self.calibration_sigma_mm.iter().map(|s| s[i]));
            }
            numbers.push(self.residual_px[i]);
            for (k, x) in numbers.iter().enumerate() {
                // Places are exact to 1e-6 mm; seven digits of the rest are more than any measurement holds.
                let _ = match x.is_finite() {
                    true if k < 2 => write!(out, "{x:.6},"),
                    true => write!(out, "{x:.6e},"),
                    false => write!(out, ","),
                };
            }
            let _ = write!(out, "{}", self.flags[i]);
            let calibration = self.calibration_covariance_mm2.iter().filter(|_| calibrated);
            for list in self.covariance_mm2.iter().chain(calibration) {
                let _ = if list[i].is_finite() { write!(out, ",{:.6e}", list[i]) } else { write!(out, ",") };
            }
            out.push('\n');
        }
        out
    }
}
