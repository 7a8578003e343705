//! Exact conversions to other descriptions of the same camera.
//!
//! * Effective pinhole. Without distortion a tilted camera is an untilted pinhole that looks along the sensor normal
//!   `n`: `pixel = K_e E^T p` with `E = [sensor u, sensor v, n]`, `f_e = f cos a cos b`, `cx_e = cx - f sin b`,
//!   `cy_e = cy - aspect f sin a cos b`. So tilt, axis point and pose trade off along an exact two-dimensional null
//!   space when nothing but undistorted images is known.
//! * OpenCV `CALIB_TILTED_MODEL`: the sensor is turned by `Ry(ty) Rx(tx)`; its camera frame is rolled about the lens axis.
//! * HALCON: amount and direction of the tilt.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | f_e, cx_e, cy_e | [`EffectivePinhole`] | px | pinhole along the sensor normal |
//! | E | [`Camera::cam_from_pinhole`] | 1 | turns directions of the pinhole's frame into the camera's |
//! | tx, ty | [`OpenCvTilted`] `tau_x_rad`, `tau_y_rad` | rad | OpenCV's tilts |
//! | phi | [`OpenCvTilted`] `roll_rad` | rad | `p_in_cam = Rz(phi) p_in_opencv` |
//!
//! Valid for `pupil_ratio = 1`; OpenCV and HALCON know only [`Radial::IdealToDistorted`].

use super::{Camera, INTRINSICS, Intrinsics, Radial};
use crate::error::{Invalid, Result};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// The pinhole along the sensor normal that a tilted camera without distortion equals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectivePinhole {
    /// Distance of the projection centre from the sensor plane over the pixel pitch, px.
    pub f_px: f64,
    /// Foot of the perpendicular from the projection centre on the sensor, px.
    pub cx_px: f64,
    /// Foot of the perpendicular from the projection centre on the sensor, px.
    pub cy_px: f64,
}

/// Amount and direction of the tilt as HALCON states them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HalconTilt {
    /// Angle between lens axis and sensor normal, rad.
    pub tilt_rad: f64,
    /// Direction of the tilt axis, rad.
    pub rotation_rad: f64,
}

/// A camera in OpenCV's tilted model: `k1, k2, p1 = p2 = 0, k3, ..., tau_x, tau_y`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpenCvTilted {
    /// Focal length in u, px.
    pub fx_px: f64,
    /// Focal length in v, px.
    pub fy_px: f64,
    /// Principal point, px.
    pub cx_px: f64,
    /// Principal point, px.
    pub cy_px: f64,
    /// Radial distortion k1, k2, k3.
    pub k: [f64; 3],
    /// Tilt about x, rad.
    pub tau_x_rad: f64,
    /// Tilt about y, rad.
    pub tau_y_rad: f64,
    /// `p_in_cam = Rz(roll_rad) p_in_opencv`: OpenCV's camera frame is rolled about the lens axis.
    pub roll_rad: f64,
}

impl OpenCvTilted {
    /// The 14 distortion coefficients in OpenCV's order.
    pub fn distortion_coefficients(&self) -> [f64; 14] {
        let [k1, k2, k3] = self.k;
        [k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, self.tau_x_rad, self.tau_y_rad]
    }
    /// Rotation that turns OpenCV's camera coordinates into spivcal's.
    pub fn cam_from_opencv(&self) -> Matrix3<f64> {
        let (s, c) = self.roll_rad.sin_cos();
        Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
    }
}

fn opencv_roll(alpha_rad: f64, beta_rad: f64, tau_y_rad: f64) -> f64 {
    let ((sa, ca), (sb, cb), (sty, cty)) = (alpha_rad.sin_cos(), beta_rad.sin_cos(), tau_y_rad.sin_cos());
    (-sa * sty).atan2(cb * cty - sb * ca * sty)
}

impl Camera {
    /// The pinhole along the sensor normal that this camera equals when its distortion is left away.
    pub fn effective_pinhole(&self) -> EffectivePinhole {
        let (i, t) = (&self.intrinsics, &self.tilt);
        EffectivePinhole {
            f_px: i.f_px * t.ca * t.cb,
            cx_px: i.cx_px - i.f_px * t.sb,
            cy_px: i.cy_px - i.aspect * i.f_px * t.sa * t.cb,
        }
    }

    /// Its derivative by the intrinsics: rows f_e, cx_e, cy_e (px), columns in the order of [`super::INTRINSIC_NAMES`] (3 x 10).
    pub(crate) fn effective_pinhole_by_intrinsics(&self) -> SMatrix<f64, 3, INTRINSICS> {
        let (t, f, m) = (&self.tilt, self.intrinsics.f_px, self.intrinsics.aspect);
        let mut d = SMatrix::zeros();
        // f, aspect, cx, cy, alpha, beta.
        (d[(0, 0)], d[(0, 4)], d[(0, 5)]) = (t.ca * t.cb, -f * t.sa * t.cb, -f * t.ca * t.sb);
        (d[(1, 0)], d[(1, 2)], d[(1, 5)]) = (-t.sb, 1.0, -f * t.cb);
        (d[(2, 0)], d[(2, 1)], d[(2, 3)]) = (-m * t.sa * t.cb, -f * t.sa * t.cb, 1.0);
        (d[(2, 4)], d[(2, 5)]) = (-m * f * t.ca * t.cb, m * f * t.sa * t.sb);
        d
    }

    /// Left turn of [`Camera::cam_from_pinhole`] by changes of the two tilts (rad), to first order: `w = u d(alpha) - y d(beta)`, u the sensor's u axis.
    pub(crate) fn pinhole_turn(&self, by_alpha_rad: f64, by_beta_rad: f64) -> Vector3<f64> {
        Vector3::new(self.tilt.cb, 0.0, self.tilt.sb) * by_alpha_rad - Vector3::y() * by_beta_rad
    }

    /// Rotation E: columns are the sensor's u axis, v axis and normal in the camera frame.
    pub fn cam_from_pinhole(&self) -> Matrix3<f64> {
        let t = &self.tilt;
        Matrix3::from_columns(&[
            Vector3::new(t.cb, 0.0, t.sb),
            Vector3::new(-t.sa * t.sb, t.ca, t.sa * t.cb),
            Vector3::new(-t.ca * t.sb, -t.sa, t.ca * t.cb),
        ])
    }

    /// Tilt as HALCON states it.
    pub fn halcon_tilt(&self) -> Result<HalconTilt> {
        let o = self.to_opencv()?;
        let ((sx, cx), (sy, cy)) = (o.tau_x_rad.sin_cos(), o.tau_y_rad.sin_cos());
        Ok(HalconTilt { tilt_rad: (cx * cy).acos(), rotation_rad: (sy * cx).atan2(sx) })
    }

    /// The same camera in OpenCV's tilted model.
    ///
    /// # Errors
    /// [`Invalid::Contradiction`] for a pupil ratio other than 1 or the photogrammetric polynomial: OpenCV has neither.
    pub fn to_opencv(&self) -> Result<OpenCvTilted> {
        let (i, t) = (&self.intrinsics, &self.tilt);
        if i.pupil_ratio != 1.0 || (i.radial != Radial::IdealToDistorted && i.k != [0.0; 3]) {
            return Err(Invalid::Contradiction(
                "OpenCV's tilted model has no pupil ratio and no distorted -> ideal polynomial; \
                 calibrate with pupil_ratio = 1 and the ideal -> distorted polynomial to export"
                    .into(),
            )
            .into());
        }
        let tau_x_rad = (t.sa * t.cb).asin();
        let tau_y_rad = (-t.sb).atan2(t.ca * t.cb);
        Ok(OpenCvTilted {
            fx_px: i.f_px,
            fy_px: i.f_px * i.aspect,
            cx_px: i.cx_px,
            cy_px: i.cy_px,
            k: i.k,
            tau_x_rad,
            tau_y_rad,
            roll_rad: opencv_roll(i.alpha_rad, i.beta_rad, tau_y_rad),
        })
    }

    /// The camera of an OpenCV tilted model; `roll_rad` of the argument is ignored and follows from the tilts.
    ///
    /// # Errors
    /// [`Invalid::Value`] as for [`Camera::new`].
    pub fn from_opencv(o: &OpenCvTilted) -> Result<(Self, Matrix3<f64>)> {
        let ((sx, cx), (sy, cy)) = (o.tau_x_rad.sin_cos(), o.tau_y_rad.sin_cos());
        let mut i = Intrinsics::pinhole(o.fx_px, o.cx_px, o.cy_px);
        i.aspect = o.fy_px / o.fx_px;
        i.k = o.k;
        i.beta_rad = -(sy * cx).asin();
        i.alpha_rad = sx.atan2(cy * cx);
        let camera = Self::new(i)?;
        let rolled = OpenCvTilted { roll_rad: opencv_roll(i.alpha_rad, i.beta_rad, o.tau_y_rad), ..*o };
        Ok((camera, rolled.cam_from_opencv()))
    }
}

impl EffectivePinhole {
    /// The tilted camera without distortion that equals this pinhole and whose axis point is (cx, cy): its f and tilts.
    ///
    /// `f = sqrt(f_e^2 + du^2 + dv^2)`, `b = asin(du / f)`, `a = atan2(dv, f_e)` with
    /// `(du, dv) = (cx - cx_e, (cy - cy_e) / aspect)`.
    pub fn with_axis_point(&self, cx_px: f64, cy_px: f64, aspect: f64) -> Intrinsics {
        let (du, dv) = (cx_px - self.cx_px, (cy_px - self.cy_px) / aspect);
        let f_px = self.f_px.hypot(du).hypot(dv);
        let mut i = Intrinsics::pinhole(f_px, cx_px, cy_px);
        i.aspect = aspect;
        i.beta_rad = (du / f_px).asin();
        i.alpha_rad = dv.atan2(self.f_px);
        i
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Point;
    use crate::rigid::rotation_log;

    fn tilted() -> Camera {
        let mut i = Intrinsics::pinhole(8889.0, 520.0, 380.0);
        (i.alpha_rad, i.beta_rad, i.aspect) = (0.21, -0.33, 1.01);
        Camera::new(i).unwrap()
    }

    #[test]
    fn effective_pinhole_is_the_camera() {
        let camera = tilted();
        let e = camera.effective_pinhole();
        let p = Vector3::new(20.0, -11.0, 480.0);
        let q = camera.project(&Point::from_vector(p)).unwrap();
        let pe = camera.cam_from_pinhole().transpose() * p;
        assert!((e.cx_px + e.f_px * pe.x / pe.z - q.u_px).abs() < 1e-10);
        assert!((e.cy_px + 1.01 * e.f_px * pe.y / pe.z - q.v_px).abs() < 1e-10);
    }

    /// Pinhole and turn of its frame against central differences.
    #[test]
    fn derivatives_of_the_pinhole_are_those_of_the_camera() {
        let i = tilted().intrinsics().to_array();
        let (by, radial) = (tilted().effective_pinhole_by_intrinsics(), Radial::default());
        for k in 0..INTRINSICS {
            let h = 1e-6 * i[k].abs().max(1.0);
            let side = |sign: f64| {
                let mut p = i;
                p[k] += sign * h;
                let camera = Camera::new(Intrinsics::from_array(&p, radial)).unwrap();
                let e = camera.effective_pinhole();
                (Vector3::new(e.f_px, e.cx_px, e.cy_px), camera.cam_from_pinhole())
            };
            let ((m, m_frame), (p, p_frame)) = (side(-1.0), side(1.0));
            let numeric = (p - m) / (2.0 * h);
            assert!((numeric - by.column(k)).norm() < 1e-6 * (1.0 + numeric.norm()), "{k}: {numeric} {}", by.column(k));
            let turn = rotation_log(&(p_frame * m_frame.transpose())) / (2.0 * h);
            let wanted = tilted().pinhole_turn(f64::from(u8::from(k == 4)), f64::from(u8::from(k == 5)));
            assert!((turn - wanted).norm() < 1e-8, "{k}: {turn} {wanted}");
        }
    }

    #[test]
    fn tilt_follows_from_pinhole_and_axis_point() {
        let camera = tilted();
        let back = camera.effective_pinhole().with_axis_point(520.0, 380.0, 1.01);
        for (x, y) in back.to_array().iter().zip(camera.intrinsics().to_array()) {
            assert!((x - y).abs() < 1e-10 * (1.0 + y.abs()), "{x} {y}");
        }
    }

    #[test]
    fn opencv_and_back_is_the_same_camera() {
        let camera = tilted();
        let o = camera.to_opencv().unwrap();
        let (back, turn) = Camera::from_opencv(&o).unwrap();
        assert!((turn - o.cam_from_opencv()).norm() < 1e-14);
        for (x, y) in back.intrinsics().to_array().iter().zip(camera.intrinsics().to_array()) {
            assert!((x - y).abs() < 1e-12 * (1.0 + y.abs()), "{x} {y}");
        }
    }

    /// OpenCV's documented formula, written out: `s x''' = [R33 0 -R13; 0 R33 -R23; 0 0 1] R(tx, ty) x''`.
    #[test]
    fn opencv_projection_agrees() {
        let camera = tilted();
        let o = camera.to_opencv().unwrap();
        let p = Vector3::new(20.0, -11.0, 480.0);
        let pc = o.cam_from_opencv().transpose() * p;
        let ((sx, cx), (sy, cy)) = (o.tau_x_rad.sin_cos(), o.tau_y_rad.sin_cos());
        let r = Matrix3::new(cy, 0.0, -sy, 0.0, 1.0, 0.0, sy, 0.0, cy)
            * Matrix3::new(1.0, 0.0, 0.0, 0.0, cx, sx, 0.0, -sx, cx);
        let m = Matrix3::new(r.m33, 0.0, -r.m13, 0.0, r.m33, -r.m23, 0.0, 0.0, 1.0) * r;
        let s = m * (pc / pc.z);
        let q = camera.project(&Point::from_vector(p)).unwrap();
        assert!((o.fx_px * s.x / s.z + o.cx_px - q.u_px).abs() < 1e-9);
        assert!((o.fy_px * s.y / s.z + o.cy_px - q.v_px).abs() < 1e-9);
    }
}
