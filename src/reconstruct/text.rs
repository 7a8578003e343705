//! The three components as CSV.

use super::VectorField;
use std::fmt::Write;

impl VectorField {
    /// One row per point, empty cells where there is no number: place, displacement, its standard deviations by the planar vectors
    /// (and by the calibration, where it was propagated), residual, flag.
    pub fn to_csv(&self) -> String {
        let calibrated = !self.calibration_sigma_mm[0].is_empty();
        let mut out = String::from("x_mm,y_mm,u_mm,v_mm,w_mm,sigma_u_mm,sigma_v_mm,sigma_w_mm");
        if calibrated {
            out.push_str(",calibration_sigma_u_mm,calibration_sigma_v_mm,calibration_sigma_w_mm");
        }
        out.push_str(",residual_px,flag\n");
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
            let _ = writeln!(out, "{}", self.flags[i]);
        }
        out
    }
}
