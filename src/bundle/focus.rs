//! The focus relation: the sheet is where the cameras are focused, within the depth of focus.
//!
//! A thin lens of focal length f_l with a sensor at the distance F behind it, tilted by alpha and beta, sees sharply the plane
//! `g . p = 1` of the lens frame (Scheimpflug, Gauss):
//! ```text
//! g = (tan(beta) / F,  tan(alpha) / (F cos(beta)),  1/f_l - 1/F),   F = f pitch
//! ```
//! The sheet is `n . p = d`, so `c = n_z / d`. Its first two rows compare directions, with c of the sheet in place of
//! the third of g, so that they hold without f_l; the third compares the distance along the lens axis:
//! ```text
//! m = g / |g| with g_3 = c,   r_1 = e_x . m,   r_2 = e_y . m,   r_3 = (1/f_l - 1/F) / c - 1
//! for a turn w and shift v of the sheet:  de = w x e,  dn = w x n,  dd = n . v
//! ```
//!
//! | symbol | identifier | unit | frame | source |
//! |---|---|---|---|---|
//! | F | `image_distance_mm` | mm | Cam | f of the camera, pixel pitch of the rig file |
//! | f_l | `focal_length_mm` | mm | Cam | rig file |
//! | n, d | `n`, `d` | 1, mm | Cam | common plane |
//! | e_x, e_y | `axes` | 1 | Cam | the plane's own axes |
//! | m | `m` | 1 | Cam | normal of the plane of focus |
//!
//! Source: method section 6. Not valid for a lens whose pupils magnify (pupil ratio other than 1), nor for a sheet along the
//! lens axis.

use super::assemble::Slot;
use super::chart::{self, SolverCamera};
use super::facts::Row;
use super::layout::Places;
use super::model::Model;
use super::state::State;
use crate::camera::INTRINSICS;
use crate::frames::Cam;
use crate::rigid::Motion;
use nalgebra::{Matrix3, SVector, Vector3};

/// A camera that is focused on the common plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Focus {
    /// Camera.
    pub camera: usize,
    /// Size of a pixel along u, mm.
    pub pixel_pitch_mm: f64,
    /// Tolerance of the angle between sheet and plane of focus, rad.
    pub tilt_sigma_rad: f64,
    /// Focal length of the lens, mm, and relative tolerance of the distance, where known.
    pub distance: Option<(f64, f64)>,
}

/// Derivative of a row by intrinsics (10), turn w and shift v of the plane in the camera frame.
type ByCamera = SVector<f64, { INTRINSICS + 6 }>;

const PLANE_STEPS: [usize; 3] = [0, 1, 5];

impl Focus {
    /// Number of rows.
    pub(super) fn count(&self) -> usize {
        2 + usize::from(self.distance.is_some())
    }

    pub(super) fn rows(&self, model: &Model, places: &Places, state: &State) -> Option<Vec<Row>> {
        let c = self.camera;
        let seen = SolverCamera::of(&model.cameras[c], &state.cameras[c])?;
        let turn: Motion<Cam, Cam> = Motion::new(seen.cam_from_solver, Vector3::zeros());
        let cam_from_plane = turn * state.camera_from_first[c] * state.first_from_plane?;
        let residuals = self.residuals(&seen, &cam_from_plane.rotation, &cam_from_plane.translation_mm)?;
        let chart = chart::derivative(&model.cameras[c], &seen.camera);
        let (motion, plane) = (turn.adjoint(), cam_from_plane.adjoint());
        let row = |(residual, by): (f64, ByCamera)| {
            let pose = by.fixed_rows::<6>(INTRINSICS);
            let mut slots = vec![];
            for (k, at) in places.charts[c].iter().enumerate() {
                // The chart's last three rows are a turn.
                let value = by.fixed_rows::<13>(0).dot(&chart.column(k));
                slots.extend(at.map(|at| (Slot::Global(at), value)));
            }
            if let Some(at) = places.motions[c] {
                slots.extend((0..6).map(|k| (Slot::Global(at + k), pose.dot(&motion.column(k)))));
            }
            if let Some(at) = places.plane {
                let step = |(n, k): (usize, &usize)| (Slot::Global(at + n), pose.dot(&plane.column(*k)));
                slots.extend(PLANE_STEPS.iter().enumerate().map(step));
            }
            Row { view: 0, residual, slots }
        };
        Some(residuals.into_iter().map(row).collect())
    }

    /// Whitened residuals and their derivatives; `rotation`, `translation_mm`: camera from plane.
    fn residuals(
        &self,
        seen: &SolverCamera,
        rotation: &Matrix3<f64>,
        translation_mm: &Vector3<f64>,
    ) -> Option<Vec<(f64, ByCamera)>> {
        let i = seen.camera.intrinsics();
        let (ta, tb) = (i.alpha_rad.tan(), i.beta_rad.tan());
        let (ca, cb) = (i.alpha_rad.cos(), i.beta_rad.cos());
        let image_distance_mm = i.f_px * self.pixel_pitch_mm;
        let inverse = 1.0 / image_distance_mm;
        // The plane's z axis points towards the viewer; n away from the camera.
        let axis: Vector3<f64> = rotation.column(2).into_owned();
        let sign = axis.dot(translation_mm).signum();
        let (n, d) = (axis * sign, (axis * sign).dot(translation_mm));
        let c = n.z / d;
        if !(c > 0.0 && c.is_finite()) {
            return None;
        }
        let g = Vector3::new(tb * inverse, ta / cb * inverse, c);
        let m = g.normalize();
        let across = (Matrix3::identity() - m * m.transpose()) / g.norm();
        let mut dg = nalgebra::SMatrix::<f64, 3, { INTRINSICS + 6 }>::zeros();
        dg[(0, 0)] = -g.x / i.f_px;
        dg[(1, 0)] = -g.y / i.f_px;
        dg[(1, 4)] = inverse / (ca * ca * cb);
        dg[(0, 5)] = inverse / (cb * cb);
        dg[(1, 5)] = g.y * tb;
        // (w x n)_z = w . (n x z)
        let turned = n.cross(&Vector3::z()) / d;
        for k in 0..3 {
            dg[(2, INTRINSICS + k)] = turned[k];
            dg[(2, INTRINSICS + 3 + k)] = -c / d * n[k];
        }
        let mut out = vec![];
        for a in 0..2 {
            let e: Vector3<f64> = rotation.column(a).into_owned();
            let mut by: ByCamera = (e.transpose() * across * dg).transpose();
            // (w x e) . m = w . (e x m)
            let own = e.cross(&m);
            (0..3).for_each(|k| by[INTRINSICS + k] += own[k]);
            out.push((e.dot(&m) / self.tilt_sigma_rad, by / self.tilt_sigma_rad));
        }
        if let Some((focal_length_mm, sigma)) = self.distance {
            let focused = 1.0 / focal_length_mm - inverse;
            let mut by: ByCamera = dg.row(2).transpose() * (-focused / (c * c));
            by[0] += inverse / i.f_px / c;
            out.push(((focused / c - 1.0) / sigma, by / sigma));
        }
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::CameraModel;
    use super::*;
    use crate::camera::Intrinsics;

    const PITCH_MM: f64 = 0.00625;
    const LENS_MM: f64 = 50.0;

    /// Rows for the plane that a thin lens images onto the sensor, turned by `turn` and moved along the axis by `shift_mm`.
    /// The plane comes from the conjugates of sensor points alone: `1/Z' + 1/Z = 1/f_l` along each ray.
    fn residuals(turn: Vector3<f64>, shift_mm: f64) -> Vec<f64> {
        let mut i = Intrinsics::pinhole(8889.0, 520.0, 380.0);
        (i.alpha_rad, i.beta_rad) = (0.05, -0.11);
        let model = CameraModel { name: "c".into(), free: [true; INTRINSICS] };
        let seen = SolverCamera::of(&model, &i).unwrap();
        let conjugate = |u: f64, v: f64| {
            let xy = seen.camera.ideal_of_pixel(&nalgebra::Vector2::new(u, v)).unwrap();
            // Where the sensor is along the lens axis at that pixel, from its axes u and v.
            let (tx, ty) = ((u - i.cx_px) * PITCH_MM, (v - i.cy_px) * PITCH_MM);
            let depth = i.f_px * PITCH_MM + tx * i.beta_rad.sin() + ty * i.alpha_rad.sin() * i.beta_rad.cos();
            xy.push(1.0) / (1.0 / LENS_MM - 1.0 / depth)
        };
        let [p, q, r, s] =
            [conjugate(0.0, 0.0), conjugate(1000.0, 0.0), conjugate(0.0, 700.0), conjugate(900.0, 650.0)];
        let x = (q - p).normalize();
        let z = x.cross(&(r - p)).normalize();
        assert!(z.dot(&(s - p)).abs() < 1e-9, "the conjugates lie in one plane");
        let turned = crate::rigid::rotation_exp(&turn);
        let rotation = turned * Matrix3::from_columns(&[x, z.cross(&x), z]);
        let on_axis = Vector3::z() * (z.dot(&p) / z.z + shift_mm);
        let focus = Focus { camera: 0, pixel_pitch_mm: PITCH_MM, tilt_sigma_rad: 1.0, distance: Some((LENS_MM, 1.0)) };
        focus.residuals(&seen, &rotation, &on_axis).unwrap().into_iter().map(|r| r.0).collect()
    }

    #[test]
    fn the_plane_that_a_thin_lens_images_onto_the_sensor_is_in_focus() {
        let r = residuals(Vector3::zeros(), 0.0);
        assert!(r.iter().all(|r| r.abs() < 1e-12), "{r:?}");
    }

    #[test]
    fn departures_are_angles_and_relative_distances() {
        // A turn about the lens axis keeps the distance on it and, seen from the axis point, is no pure tilt: use x and y.
        for turn in [Vector3::new(0.01, 0.0, 0.0), Vector3::new(0.0, 0.01, 0.0)] {
            let r = residuals(turn, 0.0);
            let size = r[0].hypot(r[1]);
            assert!((0.004..0.0101).contains(&size), "{r:?}");
            assert!(r[2].abs() < 1e-12, "{r:?}");
        }
        let near = residuals(Vector3::zeros(), 5.0);
        assert!((0.005..0.02).contains(&near[2]), "{near:?}");
    }
}
