//! OpenCV's whole camera, and the camera of this library nearest to it.
//!
//! ```text
//! x' = X / Z,  r2 = x'^2 + y'^2,  g = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
//! x'' = x' g + 2 p1 x' y' + p2 (r2 + 2 x'^2) + s1 r2 + s2 r2^2
//! y'' = y' g + p1 (r2 + 2 y'^2) + 2 p2 x' y' + s3 r2 + s4 r2^2
//! s (x''', y''', 1) = [R33 0 -R13; 0 R33 -R23; 0 0 1] R(tx, ty) (x'', y'', 1),   u = fx x''' + cx,  v = fy y''' + cy
//! ```
//! Source: OpenCV's documentation of `calib3d`. Exact where p, s and k4 to k6 are zero. Lenses that k1 k2 k3 do not follow in either direction
//! lose what is told, and more than a little is flagged ([`LOSS_LIMIT_PX`]).

use super::LOSS_LIMIT_PX;
use super::refit::{Center, Loss, Seen, asks_for_k3, earns_k3, ideal_of_pixel, moved, radial_steps, rays, refit};
use crate::camera::{Camera, Intrinsics, OpenCvTilted, Radial};
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::{DMatrix, DVector, Matrix3, Vector2, Vector3};

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
        let [_, _, p1, p2, _, _, _, _, s1, s2, s3, s4, tx, ty] = self.d;
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r2 = x * x + y * y;
        let g = self.gain(r2);
        let xd = x * g + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2);
        let yd = y * g + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + s4 * r2);
        let ((sx, cx), (sy, cy)) = (tx.sin_cos(), ty.sin_cos());
        let r = Matrix3::new(cy, 0.0, -sy, 0.0, 1.0, 0.0, sy, 0.0, cy)
            * Matrix3::new(1.0, 0.0, 0.0, 0.0, cx, sx, 0.0, -sx, cx);
        let m = Matrix3::new(r.m33, 0.0, -r.m13, 0.0, r.m33, -r.m23, 0.0, 0.0, 1.0) * r;
        let s = m * Vector3::new(xd, yd, 1.0);
        (s.z > 0.0).then(|| Vector2::new(self.fx_px * s.x / s.z + self.cx_px, self.fy_px * s.y / s.z + self.cy_px))
    }

    /// Radial distortion at a squared ideal radius.
    fn gain(&self, r2: f64) -> f64 {
        let [k1, k2, _, _, k3, k4, k5, k6, ..] = self.d;
        (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
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
    /// `pose` maps the world to OpenCV's camera frame. The nearest one has the projection centre of this one and is fitted to the rays of
    /// pixels over the whole image of `size_px`, so that the loss holds at every depth; `name` is for messages.
    ///
    /// # Errors
    /// As [`rays`], where this camera has no inverse within the image.
    pub(super) fn to_scheimpflug(
        self,
        name: &str,
        pose: &Motion<Cam, Sheet>,
        size_px: [usize; 2],
    ) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
        let part = self.exact_part();
        let (start, turn) = Camera::from_opencv(&part)?;
        let turned: Motion<Cam, Cam> = Motion::new(turn, Vector3::zeros());
        let own = turned * *pose;
        if self.is_exact() {
            return Ok((start, own, Loss::NONE));
        }
        let ideal = |q: &Vector2<f64>| ideal_of_pixel(q, |xy| self.project(&xy.push(1.0)));
        let seen = rays(name, size_px, pose, ideal)?;
        // The numerator alone is no lens: the start has the polynomial nearest to the whole, or none where that one folds.
        let rational = self.d[5..8] != [0.0; 3];
        let squared: Vec<f64> = squared_radii(pose, &seen).collect();
        let gains: Vec<f64> = squared.iter().map(|r2| self.gain(*r2)).collect();
        let k = if rational { polynomial(&squared, &gains) } else { part.k };
        let sees = |c: &Camera| seen.iter().all(|s| c.project_xyz(&own.apply(&s.xyz_mm)).is_ok());
        let near = Camera::from_opencv(&OpenCvTilted { k, ..part }).ok().map(|(camera, _)| camera).filter(sees);
        let start = match near {
            Some(camera) => camera,
            None => Camera::from_opencv(&OpenCvTilted { k: [0.0; 3], ..part })?.0,
        };
        of_either_polynomial(&start, &own, &seen)
    }
}

/// k1, k2, k3 of the polynomial that is nearest to given gains of the radius at squared radii, in px.
fn polynomial(squared: &[f64], gains: &[f64]) -> [f64; 3] {
    let largest = squared.iter().copied().fold(1e-12, f64::max);
    // Scaled to 1 at the edge, and weighted with the radius that it moves.
    let rows = DMatrix::from_fn(squared.len(), 3, |i, n| squared[i].sqrt() * (squared[i] / largest).powi(n as i32 + 1));
    let off = DVector::from_fn(squared.len(), |i, _| squared[i].sqrt() * (gains[i] - 1.0));
    let k = rows.svd(true, true).solve(&off, 1e-12).unwrap_or_else(|_| DVector::zeros(3));
    [k[0] / largest, k[1] / largest.powi(2), k[2] / largest.powi(3)]
}

/// [`fit_scheimpflug`] with the centre held; where the polynomial from ideal to distorted leaves more than is carried over silently, the one
/// from distorted to ideal is tried, and kept where it halves the loss: strong barrels are nearer to it.
///
/// # Errors
/// As [`fit_scheimpflug`].
pub(super) fn of_either_polynomial(
    start: &Camera,
    pose: &Motion<Cam, Sheet>,
    seen: &[Seen],
) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let first = fit_scheimpflug(start, pose, seen, Center::Held)?;
    if first.2.max_px <= LOSS_LIMIT_PX {
        return Ok(first);
    }
    let i = first.0.intrinsics();
    let gain = |r2: f64| 1.0 + r2 * (i.k[0] + r2 * (i.k[1] + r2 * i.k[2]));
    let gains: Vec<f64> = squared_radii(&first.1, seen).map(gain).collect();
    let distorted: Vec<f64> = squared_radii(&first.1, seen).zip(&gains).map(|(r2, g)| r2 * g * g).collect();
    let back: Vec<f64> = gains.iter().map(|g| 1.0 / g).collect();
    let turned = Intrinsics { radial: Radial::DistortedToIdeal, k: polynomial(&distorted, &back), ..*i };
    let other = Camera::new(turned).and_then(|c| fit_scheimpflug(&c, &first.1, seen, Center::Held)).ok();
    Ok(other.filter(|o| o.2.max_px < 0.5 * first.2.max_px).unwrap_or(first))
}

/// Squared ideal radii of points in a camera's frame.
pub(super) fn squared_radii<'a>(pose: &'a Motion<Cam, Sheet>, seen: &'a [Seen]) -> impl Iterator<Item = f64> + use<'a> {
    seen.iter().map(|s| {
        let p = pose.apply(&s.xyz_mm);
        (p.x * p.x + p.y * p.y) / (p.z * p.z)
    })
}

/// The camera of this library that sees given points at given pixels, from a start.
///
/// Fitted by parameters that are weak in different places, from the start and from where the others end; the nearest is kept. k3 is held
/// at the start's unless the centre is held, too: then nothing but the other camera is in the pixels, and it follows where that halves the loss.
pub(super) fn fit_scheimpflug(
    start: &Camera,
    pose: &Motion<Cam, Sheet>,
    seen: &[Seen],
    center: Center,
) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let first = by_both(start, pose, seen, center, false)?;
    if center == Center::Free || !asks_for_k3(&first.2) {
        return Ok(first);
    }
    let with = by_both(&first.0, &first.1, seen, center, true).ok();
    Ok(with.filter(|w| earns_k3(&w.2, &first.2)).unwrap_or(first))
}

fn by_both(
    start: &Camera,
    pose: &Motion<Cam, Sheet>,
    seen: &[Seen],
    center: Center,
    with_k3: bool,
) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let radial = radial_steps(squared_radii(pose, seen));
    let steps =
        Steps { shift_mm: center.step_mm(pose), k: [radial[0], radial[1], if with_k3 { radial[2] } else { 0.0 }] };
    let direct = along_pinhole(start, pose, seen, &steps);
    let (camera, pose, _) = along_lens_axis(start, pose, seen, &steps)?;
    let settled = along_pinhole(&camera, &pose, seen, &steps)?;
    Ok(direct.ok().filter(|d| d.2.rms_px < settled.2.rms_px).unwrap_or(settled))
}

/// Small changes of a shift and of k1, k2, k3; 0 holds.
struct Steps {
    shift_mm: f64,
    k: [f64; 3],
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
    seen: &[Seen],
    steps: &Steps,
) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let i = start.intrinsics();
    let of = |p: &[f64]| {
        let mut out = Intrinsics::pinhole(p[6] * i.f_px, p[7], p[8]);
        (out.aspect, out.alpha_rad, out.beta_rad, out.k) = (p[9], p[10], p[11], [p[12], p[13], p[14]]);
        out.radial = i.radial;
        Camera::new(out).ok()
    };
    let first = [
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        i.cx_px,
        i.cy_px,
        i.aspect,
        i.alpha_rad,
        i.beta_rad,
        i.k[0],
        i.k[1],
        i.k[2],
    ];
    let (turn, shift, [k1, k2, k3]) = (1e-6, steps.shift_mm, steps.k);
    let steps = [turn, turn, turn, shift, shift, shift, 1e-6, 0.01, 0.01, 1e-6, turn, turn, k1, k2, k3];
    let project = |p: &[f64], x: &Vector3<f64>| of(p)?.project_xyz(&moved(pose, p).apply(x)).ok();
    let (p, loss) = refit(seen, &first, &steps, &project).ok_or_else(degenerate)?;
    let camera = of(&p).ok_or_else(degenerate)?;
    Ok((camera, moved(pose, &p), loss))
}

/// [`fit_scheimpflug`] by other parameters: the pose of the effective pinhole, its (f, cx, cy), the aspect, the axis point and k1, k2. What is
/// weak, the axis point, stands alone, but moves nothing from a start without distortion; with (du, dv) = axis less effective point, dv over the aspect,
/// ```text
/// f = sqrt(f_e^2 + du^2 + dv^2),   beta = asin(du / f),   alpha = atan2(dv, f_e)
/// ```
fn along_pinhole(
    start: &Camera,
    pose: &Motion<Cam, Sheet>,
    seen: &[Seen],
    steps: &Steps,
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
        (out.k, out.radial) = ([p[12], p[13], p[14]], i.radial);
        Camera::new(out).ok()
    };
    let placed = |camera: &Camera, p: &[f64]| pinhole_from(camera).inverse() * moved(&pinhole_pose, p);
    let first =
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, e.cx_px, e.cy_px, i.aspect, i.cx_px, i.cy_px, i.k[0], i.k[1], i.k[2]];
    let (turn, shift, [k1, k2, k3]) = (1e-6, steps.shift_mm, steps.k);
    let steps = [turn, turn, turn, shift, shift, shift, 1e-6, 0.01, 0.01, 1e-6, 0.1, 0.1, k1, k2, k3];
    let project = |p: &[f64], x: &Vector3<f64>| {
        let camera = of(p)?;
        camera.project_xyz(&placed(&camera, p).apply(x)).ok()
    };
    let (p, loss) = refit(seen, &first, &steps, &project).ok_or_else(degenerate)?;
    let camera = of(&p).ok_or_else(degenerate)?;
    Ok((camera, placed(&camera, &p), loss))
}
