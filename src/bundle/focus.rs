//! The focus relation: the sheet is where the cameras are focused, within the depth of focus.
//!
//! A lens of focal length f_l and pupil ratio m (exit over entrance pupil; 1 for a thin lens), tilted by alpha and beta against
//! its sensor, sees sharply the plane `g . p = 1` of the lens frame, whose origin is the entrance pupil:
//! ```text
//! g = (tan(beta) / F,  tan(alpha) / (F cos(beta)),  m (1/f_l - 1/F)),   F = f pitch
//! ```
//! Derivation: seen from the principal planes, pupils of ratio m lie at `f_l (1 - 1/m)` in front and `f_l (1 - m)` behind
//! (Gauss, magnification m). With the object Z in front of the entrance pupil and the image s behind the exit pupil, Newton's
//! `(o - f_l)(i - f_l) = f_l^2` is `(Z - f_l/m)(s - m f_l) = f_l^2`, so `1/Z = m (1/f_l - m/s)`. A sensor point lies at
//! `s = m F h` (see [`crate::camera`]), `1/h = 1 - (x tan(beta) + y tan(alpha)/cos(beta)) / m`, hence
//! `1/Z = g . (x, y, 1)`: m moves the plane of focus along the axis, but does not turn its trace.
//!
//! The sheet is `n . p = d`, so `c = n_z / d`. Its first two rows compare directions, with c of the sheet in place of
//! the third of g, so that they hold without f_l; the third compares the distance along the lens axis:
//! ```text
//! q = g / |g| with g_3 = c,   r_1 = e_x . q,   r_2 = e_y . q,   r_3 = m (1/f_l - 1/F) / c - 1
//! for a turn w and shift v of the sheet:  de = w x e,  dn = w x n,  dd = n . v
//! ```
//!
//! | symbol | identifier | unit | frame | source |
//! |---|---|---|---|---|
//! | F | `image_distance_mm` | mm | Cam | f of the camera, pixel pitch of the rig file |
//! | f_l | `focal_length_mm` | mm | Cam | rig file |
//! | n, d | `n`, `d` | 1, mm | Cam | common plane |
//! | e_x, e_y | `axes` | 1 | Cam | the plane's own axes |
//! | q | `q` | 1 | Cam | normal of the plane of focus |
//! | m | `pupil_ratio` | 1 | - | camera |
//!
//! Source: method section 6, there for m = 1. Not valid for a sheet along the lens axis.

use super::chart::{self, SolverCamera};
use super::facts::Row;
use super::image_map::Slot;
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
/// Its place among the intrinsics.
const PUPIL_RATIO: usize = 9;

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
        let q = g.normalize();
        let across = (Matrix3::identity() - q * q.transpose()) / g.norm();
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
            // (w x e) . q = w . (e x q)
            let own = e.cross(&q);
            (0..3).for_each(|k| by[INTRINSICS + k] += own[k]);
            out.push((e.dot(&q) / self.tilt_sigma_rad, by / self.tilt_sigma_rad));
        }
        if let Some((focal_length_mm, sigma)) = self.distance {
            let vergence = 1.0 / focal_length_mm - inverse;
            let focused = i.pupil_ratio * vergence;
            let mut by: ByCamera = dg.row(2).transpose() * (-focused / (c * c));
            by[0] += i.pupil_ratio * inverse / i.f_px / c;
            by[PUPIL_RATIO] += vergence / c;
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

    /// Rows for the plane that a lens of pupil ratio `m` images onto the sensor, turned by `turn` and moved along the axis by
    /// `shift_mm`. The plane comes from the conjugates of sensor points alone, seen from the principal planes:
    /// `1/o + 1/i = 1/f_l`, magnification `i/o`, pupils where their own magnification is m.
    fn residuals(m: f64, turn: Vector3<f64>, shift_mm: f64) -> Vec<f64> {
        let mut intrinsics = Intrinsics::pinhole(8889.0, 520.0, 380.0);
        (intrinsics.alpha_rad, intrinsics.beta_rad, intrinsics.pupil_ratio) = (0.05, -0.11, m);
        let model = CameraModel { name: "c".into(), free: [true; INTRINSICS], window: None, axis_frame: false };
        let seen = SolverCamera::of(&model, &intrinsics).unwrap();
        // Behind the rear principal plane: the exit pupil and the axis point of the sensor.
        let exit_pupil = LENS_MM * (1.0 - m);
        let axis_point = exit_pupil + m * intrinsics.f_px * PITCH_MM;
        // In front of the front principal plane: the entrance pupil.
        let entrance_pupil = LENS_MM * (1.0 - 1.0 / m);
        let conjugate = |u: f64, v: f64| {
            let (tx, ty) = ((u - intrinsics.cx_px) * PITCH_MM, (v - intrinsics.cy_px) * PITCH_MM);
            let ((sa, ca), (sb, cb)) = (intrinsics.alpha_rad.sin_cos(), intrinsics.beta_rad.sin_cos());
            // Where the sensor is, from its axes u and v.
            let (x, y, depth) = (tx * cb - ty * sa * sb, ty * ca, tx * sb + ty * sa * cb);
            let image = axis_point + depth;
            let object = 1.0 / (1.0 / LENS_MM - 1.0 / image);
            let p = Vector3::new(x * object / image, y * object / image, object - entrance_pupil);
            let q = seen.camera.project_xyz(&p).unwrap();
            assert!((q - nalgebra::Vector2::new(u, v)).norm() < 1e-9, "the camera is this lens: {q} for {u} {v}");
            p
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
    fn the_plane_that_a_lens_images_onto_the_sensor_is_in_focus() {
        for m in [0.6, 1.0, 1.35] {
            let r = residuals(m, Vector3::zeros(), 0.0);
            assert!(r.iter().all(|r| r.abs() < 1e-12), "{m}: {r:?}");
        }
    }

    #[test]
    fn departures_are_angles_and_relative_distances() {
        // A turn about the lens axis keeps the distance on it and, seen from the axis point, is no pure tilt: use x and y.
        for turn in [Vector3::new(0.01, 0.0, 0.0), Vector3::new(0.0, 0.01, 0.0)] {
            let r = residuals(1.2, turn, 0.0);
            let size = r[0].hypot(r[1]);
            assert!((0.004..0.0101).contains(&size), "{r:?}");
            assert!(r[2].abs() < 1e-12, "{r:?}");
        }
        let near = residuals(1.0, Vector3::zeros(), 5.0);
        assert!((0.005..0.02).contains(&near[2]), "{near:?}");
    }
}
