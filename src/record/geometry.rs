//! A calibration as geometry: placed cameras and the sheet, pixel <-> sheet.
//!
//! A pixel meets the sheet where its ray does: with `(R, t) = cam_from_sheet` and the ideal point `(x, y)` of the pixel
//! the ray is `d = R^T (x, y, 1)` from the projection centre `c = -R^T t`, and `p = c - (c_z / d_z) d`.

use super::schema::Record;
use crate::camera::{Camera, Refusal};
use crate::error::Result;
use crate::frames::{Cam, Rig, Sheet};
use crate::rigid::Motion;
use nalgebra::{Vector2, Vector3};

/// A camera at its place in the rig, and against the sheet where the calibration has one.
#[derive(Debug, Clone, Copy)]
pub struct PlacedCamera {
    /// The camera.
    pub camera: Camera,
    /// Pose: camera coordinates from rig coordinates.
    pub cam_from_rig: Motion<Cam, Rig>,
    /// Pose: camera coordinates from sheet coordinates.
    pub cam_from_sheet: Option<Motion<Cam, Sheet>>,
}

/// Why a pixel and the sheet do not meet.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoMeeting {
    /// The camera refuses.
    #[error(transparent)]
    Camera(#[from] Refusal),
    /// The ray runs parallel to the sheet or away from it.
    #[error("the ray of the pixel does not meet the sheet in front of the camera")]
    OffSheet,
    /// There is no sheet in this calibration.
    #[error("the calibration has no sheet")]
    NoSheet,
}

impl PlacedCamera {
    /// Image (px) of a point of the rig frame (mm).
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    pub fn pixel_from_rig(&self, p_in_rig: &Vector3<f64>) -> std::result::Result<Vector2<f64>, Refusal> {
        self.camera.project_xyz(&self.cam_from_rig.apply(p_in_rig))
    }

    /// Ray of a pixel: unit direction in the rig frame, from [`PlacedCamera::center_in_rig`].
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches the pixel.
    pub fn ray_in_rig(&self, pixel: &Vector2<f64>) -> std::result::Result<Vector3<f64>, Refusal> {
        let xy = self.camera.ideal_of_pixel(pixel)?;
        Ok((self.cam_from_rig.rotation.transpose() * Vector3::new(xy.x, xy.y, 1.0)).normalize())
    }

    /// Projection centre in the rig frame, mm.
    pub fn center_in_rig(&self) -> Vector3<f64> {
        self.cam_from_rig.inverse().translation_mm
    }

    /// Image (px) of a point of the sheet frame (x, y, z in mm; z = 0 in the sheet).
    ///
    /// # Errors
    /// [`NoMeeting`] where the point has no image.
    pub fn pixel_from_sheet(&self, p_in_sheet: &Vector3<f64>) -> std::result::Result<Vector2<f64>, NoMeeting> {
        let cam_from_sheet = self.cam_from_sheet.as_ref().ok_or(NoMeeting::NoSheet)?;
        Ok(self.camera.project_xyz(&cam_from_sheet.apply(p_in_sheet))?)
    }

    /// Where the ray of a pixel meets the sheet: (x, y) of the sheet frame, mm.
    ///
    /// # Errors
    /// [`NoMeeting`] where it does not.
    pub fn sheet_from_pixel(&self, pixel: &Vector2<f64>) -> std::result::Result<Vector2<f64>, NoMeeting> {
        let m = self.cam_from_sheet.as_ref().ok_or(NoMeeting::NoSheet)?;
        let xy = self.camera.ideal_of_pixel(pixel)?;
        let ray = m.rotation.tr_mul(&Vector3::new(xy.x, xy.y, 1.0));
        let center = -m.rotation.tr_mul(&m.translation_mm);
        let depth = -center.z / ray.z;
        if !(depth > 0.0 && depth.is_finite()) {
            return Err(NoMeeting::OffSheet);
        }
        Ok(Vector2::new(center.x + depth * ray.x, center.y + depth * ray.y))
    }
}

impl Record {
    /// The cameras at their places.
    ///
    /// # Errors
    /// [`crate::error::Invalid::Value`] where a parameter is none of a camera.
    pub fn placed_cameras(&self) -> Result<Vec<PlacedCamera>> {
        let rig_from_sheet = self.sheet.as_ref().map(|s| s.rig_from_sheet.motion::<Rig, Sheet>());
        let placed = |c: &super::schema::Camera| {
            let cam_from_rig: Motion<Cam, Rig> = c.cam_from_rig.motion();
            let cam_from_sheet = rig_from_sheet.map(|m| cam_from_rig * m);
            Ok(PlacedCamera { camera: Camera::new(c.intrinsics())?, cam_from_rig, cam_from_sheet })
        };
        self.cameras.iter().map(placed).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::rigid::rotation_exp;

    fn placed() -> PlacedCamera {
        let mut i = Intrinsics::pinhole(8000.0, 511.5, 383.5);
        (i.alpha_rad, i.beta_rad, i.k[0]) = (0.01, 0.11, -0.2);
        let cam_from_sheet = Motion::new(rotation_exp(&Vector3::new(2.9, 0.1, -0.3)), Vector3::new(3.0, -8.0, 500.0));
        PlacedCamera {
            camera: Camera::new(i).unwrap(),
            cam_from_rig: Motion::new(rotation_exp(&Vector3::new(0.1, 0.7, -0.2)), Vector3::new(30.0, -5.0, 40.0)),
            cam_from_sheet: Some(cam_from_sheet),
        }
    }

    #[test]
    fn pixel_and_sheet_are_inverse_to_each_other() {
        let c = placed();
        for (x, y) in [(0.0, 0.0), (12.0, -7.0), (-20.0, 15.0)] {
            let q = c.pixel_from_sheet(&Vector3::new(x, y, 0.0)).unwrap();
            let p = c.sheet_from_pixel(&q).unwrap();
            assert!((p - Vector2::new(x, y)).norm() < 1e-10, "{p:?}");
        }
    }

    #[test]
    fn a_point_on_the_ray_has_the_pixel_as_its_image() {
        let c = placed();
        let q = Vector2::new(100.0, 700.0);
        let p = c.center_in_rig() + 321.0 * c.ray_in_rig(&q).unwrap();
        assert!((c.pixel_from_rig(&p).unwrap() - q).norm() < 1e-9);
    }

    #[test]
    fn a_sheet_behind_the_camera_is_not_met() {
        let mut c = placed();
        let m = c.cam_from_sheet.unwrap();
        c.cam_from_sheet = Some(Motion::new(m.rotation, -m.translation_mm));
        assert_eq!(c.sheet_from_pixel(&Vector2::new(511.5, 383.5)), Err(NoMeeting::OffSheet));
        c.cam_from_sheet = None;
        assert_eq!(c.sheet_from_pixel(&Vector2::new(511.5, 383.5)), Err(NoMeeting::NoSheet));
        assert_eq!(c.pixel_from_sheet(&Vector3::zeros()), Err(NoMeeting::NoSheet));
    }
}
