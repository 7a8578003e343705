//! The nearest member of a family of cameras that does not contain the one at hand, and what is lost.
//!
//! ```text
//! minimise  sum_i |q_i - project(p, X_i)|^2   over p
//! ```
//! by Levenberg-Marquardt with central differences. The points cover the whole image. A camera with a projection centre keeps it: it
//! is compared along its rays ([`rays`]), and the loss holds at every depth. Behind a window there is no such centre: the points lie
//! on the sheet and a little before and behind it (`behind.rs`), and the loss is what a user of the sheet sees.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | X | `xyz_mm` | mm | Sheet (world) | point that a pixel sees |
//! | q | `pixel` | px | Sensor | its image through the camera at hand |
//! | p | `start`, result | own | - | parameters of the family |

use crate::error::{Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::{Motion, rotation_exp};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2, Vector3};

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

/// A point and its image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub(super) xyz_mm: Vector3<f64>,
    pub(super) pixel: Vector2<f64>,
}

/// Depth of the volume compared behind a window, on each side of the sheet over the distance to it.
pub(super) const DEPTH: f64 = 0.02;

/// Columns and rows of the pixels compared.
const GRID: [usize; 2] = [17, 13];
/// Number of those pixels.
pub(super) const PIXELS: usize = GRID[0] * GRID[1];

/// Pixels over the whole image, its corners among them, each with the points (mm, world) that it sees.
pub(super) fn over_image<I: IntoIterator<Item = Vector3<f64>>>(
    size_px: [usize; 2],
    points: impl Fn(&Vector2<f64>) -> I,
) -> Vec<Seen> {
    let last = size_px.map(|n| n as f64 - 1.0);
    let mut out = Vec::new();
    for (i, j) in (0..GRID[0]).flat_map(|i| (0..GRID[1]).map(move |j| (i, j))) {
        let along = |last: f64, k: usize, n: usize| last * k as f64 / (n - 1) as f64;
        let pixel = Vector2::new(along(last[0], i, GRID[0]), along(last[1], j, GRID[1]));
        out.extend(points(&pixel).into_iter().map(|xyz_mm| Seen { xyz_mm, pixel }));
    }
    out
}

/// [`over_image`] for a camera with a projection centre: one point on the ray of each pixel, as far away as the world's origin.
///
/// `ideal` is the ideal point (X/Z, Y/Z) of a pixel.
///
/// # Errors
/// [`Invalid::Contradiction`] where a pixel of the image has no ray: a fit to the others would say nothing of it.
pub(super) fn rays(
    name: &str,
    size_px: [usize; 2],
    cam_from_world: &Motion<Cam, Sheet>,
    ideal: impl Fn(&Vector2<f64>) -> Option<Vector2<f64>>,
) -> Result<Vec<Seen>> {
    let world_from_cam = cam_from_world.inverse();
    let far = cam_from_world.translation_mm.norm().max(1.0);
    let point = |xy: Vector2<f64>| world_from_cam.apply(&(xy.push(1.0) * far));
    // A pixel without a ray gives a point that is no number.
    let nowhere = Vector2::repeat(f64::NAN);
    let out = over_image(size_px, |q| [point(ideal(q).unwrap_or(nowhere))]);
    match out.iter().find(|s| !s.xyz_mm.iter().all(|x| x.is_finite())) {
        None => Ok(out),
        Some(Seen { pixel, .. }) => {
            let [w, h] = size_px;
            let what = format!(
                "camera \"{name}\": pixel ({:.0}, {:.0}) of {w} x {h} sees nothing, because the distortion folds before it, so no other camera can \
                 be fitted over the whole image; check the image size and the order of the coefficients, or calibrate with fewer of them",
                pixel.x, pixel.y
            );
            Err(Invalid::Contradiction(what).into())
        }
    }
}

/// Parts of the way from the axis to a pixel in [`ideal_of_pixel`].
const WAY: i32 = 32;

/// Ideal point of a pixel by Newton's iteration on the way from the image of the axis: the only one without a fold between.
///
/// None where the image folds before the pixel, or never reaches it.
pub(super) fn ideal_of_pixel(
    pixel: &Vector2<f64>,
    image: impl Fn(&Vector2<f64>) -> Option<Vector2<f64>>,
) -> Option<Vector2<f64>> {
    let slope = |xy: &Vector2<f64>| -> Option<Matrix2<f64>> {
        let h = 1e-6;
        let by = |d: Vector2<f64>| Some((image(&(xy + d))? - image(&(xy - d))?) / (2.0 * h));
        Some(Matrix2::from_columns(&[by(Vector2::new(h, 0.0))?, by(Vector2::new(0.0, h))?]))
    };
    let mut xy = Vector2::zeros();
    let axis = image(&xy)?;
    let hand = slope(&xy)?.determinant();
    let folds = |xy: &Vector2<f64>| slope(xy).is_none_or(|by| !(by.determinant() * hand > 0.0));
    for part in 1..=WAY {
        let from = xy;
        let target = axis + (pixel - axis) * (f64::from(part) / f64::from(WAY));
        let mut gap = image(&xy)? - target;
        for _ in 0..20 {
            xy -= slope(&xy)?.try_inverse()? * gap;
            gap = image(&xy)? - target;
            if gap.norm() < 1e-10 {
                break;
            }
        }
        // What rounding leaves is far below, what did not arrive far above. Newton's steps may leap over a fold to where the image grows again.
        if !(gap.norm() < 1e-6) || (1..=8).any(|k| folds(&(from + (xy - from) * (f64::from(k) / 8.0)))) {
            return None;
        }
    }
    Some(xy)
}

/// Whether a fit may move the projection centre of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Center {
    /// The camera has one and keeps it.
    Held,
    /// It has none, or one that is yet to be found.
    Free,
}

impl Center {
    /// Small change of the shift in [`moved`], mm; 0 holds it.
    pub(super) fn step_mm(self, pose: &Motion<Cam, Sheet>) -> f64 {
        match self {
            Self::Held => 0.0,
            Self::Free => 1e-6 * pose.translation_mm.norm(),
        }
    }
}

/// Small changes of k1, k2, k3: a millionth of the radius, at the largest squared radius that is seen.
pub(super) fn radial_steps(squared: impl Iterator<Item = f64>) -> [f64; 3] {
    let s = squared.fold(1e-12, f64::max);
    [1e-6 / s, 1e-6 / (s * s), 1e-6 / (s * s * s)]
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

fn jacobian(seen: &[Seen], p: &[f64], free: &[usize], steps: &[f64], project: Family<'_>) -> Option<DMatrix<f64>> {
    let mut jac = DMatrix::zeros(2 * seen.len(), free.len());
    for (column, &k) in free.iter().enumerate() {
        let at = |sign: f64| {
            let mut moved = p.to_vec();
            moved[k] += sign * steps[k];
            residuals(seen, &moved, project)
        };
        jac.set_column(column, &((at(1.0)? - at(-1.0)?) / (2.0 * steps[k])));
    }
    Some(jac)
}

/// The best member of the family; `steps` are small changes of each parameter, 0 holds one. None where the start has no image of a point.
pub(super) fn refit(seen: &[Seen], start: &[f64], steps: &[f64], project: Family<'_>) -> Option<(Vec<f64>, Loss)> {
    let mut p = start.to_vec();
    let mut r = residuals(seen, &p, project)?;
    let free: Vec<usize> = (0..p.len()).filter(|k| steps[*k] != 0.0).collect();
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let Some(jac) = jacobian(seen, &p, &free, steps, project) else { break };
        let (normal, gradient) = (jac.transpose() * &jac, jac.transpose() * &r);
        let mut gain = None;
        while damping < 1e12 {
            let mut damped = normal.clone();
            for k in 0..free.len() {
                damped[(k, k)] += damping * normal[(k, k)].max(f64::MIN_POSITIVE);
            }
            let step = damped.cholesky().map(|c| c.solve(&gradient));
            let trial = step.map(|s| {
                let mut t = p.clone();
                free.iter().zip(s.iter()).for_each(|(k, d)| t[*k] -= d);
                t
            });
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

/// What a fit may leave before k3 is asked to follow, px.
const FOLLOWED_PX: f64 = 1e-3;

/// Whether a fit is so poor that k3 is to follow.
pub(super) fn asks_for_k3(loss: &Loss) -> bool {
    !(loss.max_px <= FOLLOWED_PX)
}

/// Whether k3 earns its place: it halves what is lost. Over a narrow field it says little and takes large values.
pub(super) fn earns_k3(with: &Loss, without: &Loss) -> bool {
    with.max_px < 0.5 * without.max_px
}

/// [`refit`] with the last parameter, k3, held at its start, and free where that halves what is lost; its step is the last.
pub(super) fn refit_with_k3(
    seen: &[Seen],
    start: &[f64],
    steps: &[f64],
    project: Family<'_>,
) -> Option<(Vec<f64>, Loss)> {
    let mut held = steps.to_vec();
    held.iter_mut().rev().take(1).for_each(|step| *step = 0.0);
    let (p, loss) = refit(seen, start, &held, project)?;
    let with = asks_for_k3(&loss).then(|| refit(seen, &p, steps, project)).flatten();
    Some(with.filter(|(_, with)| earns_k3(with, &loss)).unwrap_or((p, loss)))
}
