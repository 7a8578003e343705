//! A calibration as geometry: cameras at their places in the rig. What belongs to the sheet is in `dewarp`.

use super::schema::{self, Effective, Pose, Record};
use super::sigma::CameraSigma;
use crate::camera::{Camera, Refusal};
use crate::error::{Result, same_length};
use crate::frames::{Cam, Rig};
use crate::lanes::{Column, ColumnMut};
use crate::rigid::Motion;
use nalgebra::{Vector2, Vector3};

/// A camera at its place in the rig.
#[derive(Debug, Clone, Copy)]
pub struct PlacedCamera {
    /// The camera.
    pub camera: Camera,
    /// Pose: camera coordinates from rig coordinates.
    pub cam_from_rig: Motion<Cam, Rig>,
}

impl PlacedCamera {
    /// Image (px) of a point of the rig frame (mm).
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    #[inline]
    pub fn pixel_from_rig(&self, p_in_rig: &Vector3<f64>) -> std::result::Result<Vector2<f64>, Refusal> {
        self.camera.project_xyz(&self.cam_from_rig.apply(p_in_rig))
    }

    /// Ray of a pixel: unit direction in the rig frame, from [`PlacedCamera::center_in_rig`]; of a camera behind a window the ray in
    /// the air before it. Where the scene is that the pixel sees, says [`PlacedCamera::sight_in_rig`].
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches the pixel.
    #[inline]
    pub fn ray_in_rig(&self, pixel: &Vector2<f64>) -> std::result::Result<Vector3<f64>, Refusal> {
        let xy = self.camera.ideal_of_pixel(pixel)?;
        Ok((self.cam_from_rig.rotation.transpose() * Vector3::new(xy.x, xy.y, 1.0)).normalize())
    }

    /// Line of sight of a pixel in the rig frame, behind the window where there is one: a point on it (mm) and its unit direction.
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches the pixel.
    #[inline]
    pub fn sight_in_rig(&self, pixel: &Vector2<f64>) -> std::result::Result<(Vector3<f64>, Vector3<f64>), Refusal> {
        let sight = self.camera.line_of_sight(pixel)?;
        let rig_from_cam = self.cam_from_rig.inverse();
        Ok((rig_from_cam.apply(&sight.from_mm), rig_from_cam.rotation * sight.direction))
    }

    /// Images (u, v), px, of points (x, y, z) of the rig frame, mm; `NaN` where a point has none. Several at a time, in this thread;
    /// [`PlacedCamera::pixel_from_rig`] to rounding.
    ///
    /// # Errors
    /// [`crate::error::Invalid::Value`] where the lists differ in length.
    pub fn pixels_from_rig_into(&self, p_mm: [&[f64]; 3], q_px: [&mut [f64]; 2]) -> Result<()> {
        same_length("points", p_mm[0].len(), &[p_mm[1], p_mm[2], q_px[0], q_px[1]])?;
        self.camera.images_into(&self.cam_from_rig, p_mm.map(Column::from), q_px.map(ColumnMut::from));
        Ok(())
    }

    /// Rays of pixels (u, v), px: unit directions (x, y, z) in the rig frame; `NaN` where no ray reaches a pixel. Several at a time, in
    /// this thread; [`PlacedCamera::ray_in_rig`] to rounding.
    ///
    /// # Errors
    /// [`crate::error::Invalid::Value`] where the lists differ in length.
    pub fn rays_in_rig_into(&self, q_px: [&[f64]; 2], d: [&mut [f64]; 3]) -> Result<()> {
        same_length("pixels", q_px[0].len(), &[q_px[1], d[0], d[1], d[2]])?;
        let rig_from_cam = self.cam_from_rig.rotation.transpose();
        self.camera.rays_into(&rig_from_cam, q_px.map(Column::from), d.map(ColumnMut::from));
        Ok(())
    }

    /// Projection centre in the rig frame, mm.
    pub fn center_in_rig(&self) -> Vector3<f64> {
        self.cam_from_rig.inverse().translation_mm
    }

    /// Its entry in a record, with every standard deviation unknown, without a window and without observations.
    pub fn to_record(&self, name: &str, image_size_px: [usize; 2], pixel_pitch_mm: Option<f64>) -> schema::Camera {
        let i = self.camera.intrinsics();
        let e = self.camera.effective_pinhole();
        schema::Camera {
            name: name.into(),
            image_size_px,
            f_px: i.f_px,
            aspect: i.aspect,
            cx_px: i.cx_px,
            cy_px: i.cy_px,
            alpha_rad: i.alpha_rad,
            beta_rad: i.beta_rad,
            k1: i.k[0],
            k2: i.k[1],
            k3: i.k[2],
            radial: i.radial.into(),
            pupil_ratio: i.pupil_ratio,
            pixel_pitch_mm,
            effective: Effective { f_px: e.f_px, cx_px: e.cx_px, cy_px: e.cy_px },
            sigma: CameraSigma::default(),
            cam_from_rig: Pose::from(&self.cam_from_rig),
            window: None,
            rms_px: f64::NAN,
            edge_rms_px: None,
            observations: 0,
        }
    }
}

impl Record {
    /// The cameras at their places.
    ///
    /// # Errors
    /// [`crate::error::Invalid::Value`] where a parameter is none of a camera.
    pub fn placed_cameras(&self) -> Result<Vec<PlacedCamera>> {
        let placed =
            |c: &super::schema::Camera| Ok(PlacedCamera { camera: c.model()?, cam_from_rig: c.cam_from_rig.motion() });
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
        PlacedCamera {
            camera: Camera::new(i).unwrap(),
            cam_from_rig: Motion::new(rotation_exp(&Vector3::new(0.1, 0.7, -0.2)), Vector3::new(30.0, -5.0, 40.0)),
        }
    }

    #[test]
    fn a_point_on_the_ray_has_the_pixel_as_its_image() {
        let c = placed();
        let q = Vector2::new(100.0, 700.0);
        let p = c.center_in_rig() + 321.0 * c.ray_in_rig(&q).unwrap();
        assert!((c.pixel_from_rig(&p).unwrap() - q).norm() < 1e-9);
    }
}
