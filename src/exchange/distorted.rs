//! OpenCV's whole camera, and the camera of this library nearest to it.
//!
//! ```text
//! x' = X / Z,  r2 = x'^2 + y'^2,  g = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
//! x'' = x' g + 2 p1 x' y' + p2 (r2 + 2 x'^2) + s1 r2 + s2 r2^2
//! y'' = y' g + p1 (r2 + 2 y'^2) + 2 p2 x' y' + s3 r2 + s4 r2^2
//! s (x''', y''', 1) = [R33 0 -R13; 0 R33 -R23; 0 0 1] R(tx, ty) (x'', y'', 1),   u = fx x''' + cx,  v = fy y''' + cy
//! ```
//! Source: OpenCV's documentation of `calib3d`. Exact where p, s and k4 to k6 are zero.

use super::refit::{Loss, moved, refit, volume};
use crate::camera::{Camera, Intrinsics, OpenCvTilted};
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Intrinsics and the 14 coefficients in OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OpenCvCamera {
    pub(super) fx_px: f64,
    pub(super) fy_px: f64,
    pub(super) cx_px: f64,
    pub(super) cy_px: f64,
    pub(super) d: [f64; 14],
}

impl OpenCvCamera {
    /// Image of a point in OpenCV's camera frame, px.
    pub(super) fn project(&self, p: &Vector3<f64>) -> Option<Vector2<f64>> {
        if !(p.z > 0.0) {
            return None;
        }
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tx, ty] = self.d;
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r2 = x * x + y * y;
        let g = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let xd = x * g + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2);
        let yd = y * g + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + s4 * r2);
        let ((sx, cx), (sy, cy)) = (tx.sin_cos(), ty.sin_cos());
        let r = Matrix3::new(cy, 0.0, -sy, 0.0, 1.0, 0.0, sy, 0.0, cy)
            * Matrix3::new(1.0, 0.0, 0.0, 0.0, cx, sx, 0.0, -sx, cx);
        let m = Matrix3::new(r.m33, 0.0, -r.m13, 0.0, r.m33, -r.m23, 0.0, 0.0, 1.0) * r;
        let s = m * Vector3::new(xd, yd, 1.0);
        (s.z > 0.0).then(|| Vector2::new(self.fx_px * s.x / s.z + self.cx_px, self.fy_px * s.y / s.z + self.cy_px))
    }

    fn exact_part(&self) -> OpenCvTilted {
        let d = &self.d;
        OpenCvTilted {
            fx_px: self.fx_px,
            fy_px: self.fy_px,
            cx_px: self.cx_px,
            cy_px: self.cy_px,
            k: [d[0], d[1], d[4]],
            tau_x_rad: d[12],
            tau_y_rad: d[13],
            roll_rad: 0.0,
        }
    }

    fn is_exact(&self) -> bool {
        let d = &self.d;
        [2, 3, 5, 6, 7, 8, 9, 10, 11].iter().all(|&i| d[i] == 0.0)
    }

    /// This camera, or the nearest one, in the library's own frame, with what is lost.
    ///
    /// `pose` maps the world to OpenCV's camera frame; the plane z = 0 of the world is the sheet.
    pub(super) fn to_scheimpflug(
        self,
        pose: &Motion<Cam, Sheet>,
        size_px: [usize; 2],
    ) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
        let (start, turn) = Camera::from_opencv(&self.exact_part())?;
        let turned: Motion<Cam, Cam> = Motion::new(turn, Vector3::zeros());
        let own = turned * *pose;
        if self.is_exact() {
            return Ok((start, own, Loss::NONE));
        }
        let mut seen = volume(&start, &own, size_px);
        for s in &mut seen {
            s.pixel = self.project(&pose.apply(&s.xyz_mm)).unwrap_or(Vector2::repeat(f64::NAN));
        }
        seen.retain(|s| s.pixel.iter().all(|x| x.is_finite()));
        fit_scheimpflug(&start, &own, &seen)
    }
}

/// The camera of this library that sees given points at given pixels, from a start.
///
/// Fitted twice, by parameters that are weak in different places; the second fit begins where the first ends and can only be better.
pub(super) fn fit_scheimpflug(
    start: &Camera,
    pose: &Motion<Cam, Sheet>,
    seen: &[super::refit::Seen],
) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let (camera, pose, _) = along_lens_axis(start, pose, seen)?;
    along_pinhole(&camera, &pose, seen)
}

fn degenerate() -> Insufficient {
    Insufficient::Degenerate(
        "no camera of this library sees the points as the file says; check the image size and the pixel pitch".into(),
    )
}

/// [`fit_scheimpflug`] by pose, intrinsics and tilts: reaches a tilt from a start without distortion, and creeps where tilt, axis point and pose
/// move together.
fn along_lens_axis(
    start: &Camera,
    pose: &Motion<Cam, Sheet>,
    seen: &[super::refit::Seen],
) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let i = start.intrinsics();
    let of = |p: &[f64]| {
        let mut out = Intrinsics::pinhole(p[6] * i.f_px, p[7], p[8]);
        (out.aspect, out.alpha_rad, out.beta_rad, out.k) = (p[9], p[10], p[11], [p[12], p[13], i.k[2]]);
        Camera::new(out).ok()
    };
    let first =
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, i.cx_px, i.cy_px, i.aspect, i.alpha_rad, i.beta_rad, i.k[0], i.k[1]];
    let far = pose.translation_mm.norm();
    let [turn, shift] = [1e-6, 1e-6 * far];
    let steps = [turn, turn, turn, shift, shift, shift, 1e-6, 0.01, 0.01, 1e-6, turn, turn, 1e-4, 1e-2];
    let project = |p: &[f64], x: &Vector3<f64>| of(p)?.project_xyz(&moved(pose, p).apply(x)).ok();
    let (p, loss) = refit(seen, &first, &steps, &project).ok_or_else(degenerate)?;
    let camera = of(&p).ok_or_else(degenerate)?;
    Ok((camera, moved(pose, &p), loss))
}

/// [`fit_scheimpflug`] by other parameters: the pose of the effective pinhole, its (f, cx, cy), the aspect, the axis point and k1, k2. What is weak, the axis
/// point, stands alone, but moves nothing from a start without distortion; with (du, dv) = axis less effective point, dv over the aspect,
/// ```text
/// f = sqrt(f_e^2 + du^2 + dv^2),   beta = asin(du / f),   alpha = atan2(dv, f_e)
/// ```
fn along_pinhole(
    start: &Camera,
    pose: &Motion<Cam, Sheet>,
    seen: &[super::refit::Seen],
) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let (i, e) = (start.intrinsics(), start.effective_pinhole());
    let pinhole_from =
        |camera: &Camera| Motion::<Cam, Cam>::new(camera.cam_from_pinhole().transpose(), Vector3::zeros());
    let pinhole_pose = pinhole_from(start) * *pose;
    let of = |p: &[f64]| {
        let (f_e, aspect) = (p[6] * e.f_px, p[9]);
        let (du, dv) = (p[10] - p[7], (p[11] - p[8]) / aspect);
        let f_px = (f_e * f_e + du * du + dv * dv).sqrt();
        let mut out = Intrinsics::pinhole(f_px, p[10], p[11]);
        (out.aspect, out.alpha_rad, out.beta_rad) = (aspect, dv.atan2(f_e), (du / f_px).asin());
        out.k = [p[12], p[13], i.k[2]];
        Camera::new(out).ok()
    };
    let placed = |camera: &Camera, p: &[f64]| pinhole_from(camera).inverse() * moved(&pinhole_pose, p);
    let [cx, cy, k1, k2] = [i.cx_px, i.cy_px, i.k[0], i.k[1]];
    let first = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, e.cx_px, e.cy_px, i.aspect, cx, cy, k1, k2];
    let far = pose.translation_mm.norm();
    let [turn, shift] = [1e-6, 1e-6 * far];
    let steps = [turn, turn, turn, shift, shift, shift, 1e-6, 0.01, 0.01, 1e-6, 0.1, 0.1, 1e-4, 1e-2];
    let project = |p: &[f64], x: &Vector3<f64>| {
        let camera = of(p)?;
        camera.project_xyz(&placed(&camera, p).apply(x)).ok()
    };
    let (p, loss) = refit(seen, &first, &steps, &project).ok_or_else(degenerate)?;
    let camera = of(&p).ok_or_else(degenerate)?;
    Ok((camera, placed(&camera, &p), loss))
}
