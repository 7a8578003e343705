//! Design values of a Scheimpflug camera from the drawing of the rig: lens, pitch, distance and direction of the sheet.
//!
//! The lens axis meets the sheet at the distance D in front of a thin lens of focal length f_l. There the sheet's normal (away from the
//! camera) is `(tan h, tan v, 1)` up to its length. Gauss gives the image distance F, Scheimpflug the tilts:
//! ```text
//! 1/F = 1/f_l - 1/D,   f = F / pitch,   tan beta = (F / D) tan h,   tan alpha = (F / D) tan v cos beta
//! ```
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | f_l | `focal_length_mm` | mm | focal length of the lens |
//! | D | `object_distance_mm` | mm | from the lens to the sheet along the lens axis |
//! | h | `angle_rad` | rad | inclination of the sheet along image x; positive: what is right in the image is nearer |
//! | v | `angle_vertical_rad` | rad | the same along image y; positive: what is low in the image is nearer |
//! | F | `image_distance_mm` | mm | from the lens to the sensor along the lens axis |
//!
//! Source: method section 6 (`a = tan(beta) / F`, `b = tan(alpha) / (F cos(beta))` with `(a, b, c) = n / d`, `c = 1/D`). The paper's 2.8
//! degrees and 8067 px for 50 mm, 500 mm, 45 degrees must be 6.34 degrees and 8889 px. For a thick lens D and F count from its principal
//! planes; not valid where the pupils magnify (the tilt then differs by the pupil ratio).

use super::Intrinsics;
use crate::error::{Invalid, Result};

/// What the drawing of a rig says about a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drawing {
    /// Focal length of the lens, mm.
    pub focal_length_mm: f64,
    /// Distance of neighbouring pixels, mm.
    pub pixel_pitch_mm: f64,
    /// Distance from the lens to the sheet along the lens axis, mm.
    pub object_distance_mm: f64,
    /// Inclination of the sheet along image x, rad; positive: what is right in the image is nearer.
    pub angle_rad: f64,
    /// Inclination of the sheet along image y, rad; positive: what is low in the image is nearer.
    pub angle_vertical_rad: f64,
}

impl Drawing {
    /// Focal length and tilts of the camera that is focused on the sheet; axis point at `axis_point_px`, no distortion.
    ///
    /// ```
    /// let drawing = spivcal::camera::Drawing {
    ///     focal_length_mm: 50.0,
    ///     pixel_pitch_mm: 0.00625,
    ///     object_distance_mm: 500.0,
    ///     angle_rad: 45_f64.to_radians(),
    ///     angle_vertical_rad: 0.0,
    /// };
    /// let camera = drawing.intrinsics([511.5, 383.5])?;
    /// assert!((camera.f_px - 8888.9).abs() < 0.1);
    /// assert!((camera.beta_rad.to_degrees() - 6.34).abs() < 0.01);
    /// # Ok::<(), spivcal::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Invalid::Value`] where a length is not positive, the sheet is not beyond the focal length, or an angle is not below 89 degrees.
    pub fn intrinsics(&self, axis_point_px: [f64; 2]) -> Result<Intrinsics> {
        let lengths = [("focal_length_mm", self.focal_length_mm), ("pixel_pitch_mm", self.pixel_pitch_mm)];
        for (name, value) in lengths {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Invalid::value(name, value, "a positive length in mm").into());
            }
        }
        let distance = self.object_distance_mm;
        if !(distance > self.focal_length_mm && distance.is_finite()) {
            let expected = format!("a distance above the focal length of {} mm", self.focal_length_mm);
            return Err(Invalid::value("object_distance_mm", distance, expected).into());
        }
        for (name, angle) in [("angle_rad", self.angle_rad), ("angle_vertical_rad", self.angle_vertical_rad)] {
            if !(angle.abs() < 89_f64.to_radians()) {
                return Err(Invalid::value(name, angle, "an angle below 89 degrees").into());
            }
        }
        let image_distance_mm = 1.0 / (1.0 / self.focal_length_mm - 1.0 / distance);
        let magnification = image_distance_mm / distance;
        let beta_rad = (magnification * self.angle_rad.tan()).atan();
        let alpha_rad = (magnification * self.angle_vertical_rad.tan() * beta_rad.cos()).atan();
        let [cx, cy] = axis_point_px;
        let pinhole = Intrinsics::pinhole(image_distance_mm / self.pixel_pitch_mm, cx, cy);
        Ok(Intrinsics { alpha_rad, beta_rad, ..pinhole })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use nalgebra::{Vector2, Vector3};

    const DRAWING: Drawing = Drawing {
        focal_length_mm: 50.0,
        pixel_pitch_mm: 0.00625,
        object_distance_mm: 500.0,
        angle_rad: std::f64::consts::FRAC_PI_4,
        angle_vertical_rad: -0.2,
    };

    /// Every pixel of the designed sensor is sharp on the sheet: the conjugate of each sensor point (Gauss along its own ray) lies in
    /// the plane of the drawing, with the side that the angle says nearer.
    #[test]
    fn the_designed_sensor_is_sharp_on_the_sheet() {
        let i = DRAWING.intrinsics([500.0, 400.0]).unwrap();
        let camera = Camera::new(i).unwrap();
        let normal = Vector3::new(DRAWING.angle_rad.tan(), DRAWING.angle_vertical_rad.tan(), 1.0);
        let conjugate = |u: f64, v: f64| {
            let xy = camera.ideal_of_pixel(&Vector2::new(u, v)).unwrap();
            let (tx, ty) = ((u - 500.0) * DRAWING.pixel_pitch_mm, (v - 400.0) * DRAWING.pixel_pitch_mm);
            let behind =
                i.f_px * DRAWING.pixel_pitch_mm + tx * i.beta_rad.sin() + ty * i.alpha_rad.sin() * i.beta_rad.cos();
            xy.push(1.0) / (1.0 / DRAWING.focal_length_mm - 1.0 / behind)
        };
        for (u, v) in [(500.0, 400.0), (0.0, 0.0), (1023.0, 100.0), (300.0, 767.0)] {
            let p = conjugate(u, v);
            assert!((normal.dot(&p) - DRAWING.object_distance_mm).abs() < 1e-9, "{p}");
        }
        assert!(conjugate(1000.0, 400.0).z < conjugate(0.0, 400.0).z, "right is nearer");
        assert!(conjugate(500.0, 700.0).z > conjugate(500.0, 0.0).z, "low is farther at a negative angle");
    }

    #[test]
    fn impossible_drawings_are_refused() {
        for wrong in [
            Drawing { object_distance_mm: 50.0, ..DRAWING },
            Drawing { focal_length_mm: f64::NAN, ..DRAWING },
            Drawing { pixel_pitch_mm: 0.0, ..DRAWING },
            Drawing { angle_rad: 1.56, ..DRAWING },
        ] {
            assert!(wrong.intrinsics([0.0; 2]).is_err(), "{wrong:?}");
        }
    }
}
