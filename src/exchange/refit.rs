//! The nearest member of a family of cameras that does not contain the one at hand, and what is lost.
//!
//! ```text
//! minimise  sum_i |q_i - project(p, X_i)|^2   over p
//! ```
//! by Levenberg-Marquardt with central differences; the points cover the image and a little depth on both sides of the
//! sheet, so that the loss is what a user of the sheet sees.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | X | `xyz_mm` | mm | Sheet (world) | point of the measured volume |
//! | q | `pixel` | px | Sensor | its image through the camera at hand |
//! | p | `start`, result | own | - | parameters of the family |

use crate::camera::Camera;
use crate::frames::{Cam, Sheet};
use crate::rigid::{Motion, rotation_exp};
use nalgebra::{DMatrix, DVector, Vector2, Vector3};

/// How far two descriptions of one camera differ, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loss {
    /// Root mean square distance of the images of a point.
    pub rms_px: f64,
    /// Largest distance.
    pub max_px: f64,
}

impl Loss {
    /// Nothing is lost.
    pub const NONE: Self = Self { rms_px: 0.0, max_px: 0.0 };

    pub(super) fn of(gaps: impl Iterator<Item = f64>) -> Self {
        let (n, sum, max) = gaps.fold((0.0, 0.0, 0.0_f64), |(n, s, m), g| (n + 1.0, s + g * g, m.max(g)));
        Self { rms_px: if n > 0.0 { f64::sqrt(sum / n) } else { f64::NAN }, max_px: max }
    }
}

/// A point of the measured volume and its image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub(super) xyz_mm: Vector3<f64>,
    pub(super) pixel: Vector2<f64>,
}

/// Depth of the compared volume on each side of the sheet over the distance to it.
pub(super) const DEPTH: f64 = 0.02;

/// Pixels over the whole image at three depths about the plane z = 0 of the world.
pub(super) fn volume(camera: &Camera, cam_from_world: &Motion<Cam, Sheet>, size_px: [usize; 2]) -> Vec<Seen> {
    let world_from_cam = cam_from_world.inverse();
    let eye = world_from_cam.translation_mm;
    let depth_mm = DEPTH * eye.z.abs();
    let last = size_px.map(|n| n as f64 - 1.0);
    let mut out = Vec::with_capacity(17 * 13 * 3);
    for (i, j) in (0..17).flat_map(|i| (0..13).map(move |j| (i, j))) {
        let pixel = Vector2::new(last[0] * f64::from(i) / 16.0, last[1] * f64::from(j) / 12.0);
        let Ok(xy) = camera.ideal_of_pixel(&pixel) else { continue };
        let ray = world_from_cam.rotation * Vector3::new(xy.x, xy.y, 1.0);
        for z in [-depth_mm, 0.0, depth_mm] {
            let way = (z - eye.z) / ray.z;
            if way > 0.0 && way.is_finite() {
                out.push(Seen { xyz_mm: eye + ray * way, pixel });
            }
        }
    }
    out
}

/// The pose after the first six parameters: a turn (rad) and a shift (mm) of the camera's coordinates.
pub(super) fn moved(pose: &Motion<Cam, Sheet>, p: &[f64]) -> Motion<Cam, Sheet> {
    let turn = rotation_exp(&Vector3::new(p[0], p[1], p[2]));
    Motion::new(turn * pose.rotation, turn * pose.translation_mm + Vector3::new(p[3], p[4], p[5]))
}

/// A family of cameras: the image of a world point for given parameters.
pub(super) type Family<'a> = &'a dyn Fn(&[f64], &Vector3<f64>) -> Option<Vector2<f64>>;

const ITERATIONS: usize = 200;

fn residuals(seen: &[Seen], p: &[f64], project: Family<'_>) -> Option<DVector<f64>> {
    let mut r = DVector::zeros(2 * seen.len());
    for (i, s) in seen.iter().enumerate() {
        let q = project(p, &s.xyz_mm)?;
        (r[2 * i], r[2 * i + 1]) = (q.x - s.pixel.x, q.y - s.pixel.y);
    }
    r.iter().all(|x| x.is_finite()).then_some(r)
}

fn jacobian(seen: &[Seen], p: &[f64], steps: &[f64], project: Family<'_>) -> Option<DMatrix<f64>> {
    let mut jac = DMatrix::zeros(2 * seen.len(), p.len());
    for k in 0..p.len() {
        let at = |sign: f64| {
            let mut moved = p.to_vec();
            moved[k] += sign * steps[k];
            residuals(seen, &moved, project)
        };
        jac.set_column(k, &((at(1.0)? - at(-1.0)?) / (2.0 * steps[k])));
    }
    Some(jac)
}

/// The best member of the family; `steps` are small changes of each parameter. None where the start has no image of a point.
pub(super) fn refit(seen: &[Seen], start: &[f64], steps: &[f64], project: Family<'_>) -> Option<(Vec<f64>, Loss)> {
    let mut p = start.to_vec();
    let mut r = residuals(seen, &p, project)?;
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let Some(jac) = jacobian(seen, &p, steps, project) else { break };
        let (normal, gradient) = (jac.transpose() * &jac, jac.transpose() * &r);
        let mut gain = None;
        while damping < 1e12 {
            let mut damped = normal.clone();
            for k in 0..p.len() {
                damped[(k, k)] += damping * normal[(k, k)].max(f64::MIN_POSITIVE);
            }
            let step = damped.cholesky().map(|c| c.solve(&gradient));
            let trial: Option<Vec<f64>> = step.map(|s| p.iter().zip(s.iter()).map(|(a, b)| a - b).collect());
            let better = trial.and_then(|t| residuals(seen, &t, project).map(|r| (t, r)));
            if let Some((t, new)) = better.filter(|(_, new)| new.norm_squared() < r.norm_squared()) {
                gain = Some(1.0 - new.norm_squared() / r.norm_squared());
                (p, r) = (t, new);
                damping *= 0.1;
                break;
            }
            damping *= 10.0;
        }
        if gain.is_none_or(|g| g < 1e-9) {
            break;
        }
    }
    Some((p, Loss::of(r.as_slice().chunks_exact(2).map(|d| d[0].hypot(d[1])))))
}
