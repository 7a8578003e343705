//! Contour residuals: edge points against the image of their circle.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | C, R | `center`, `radius` | 3, 1 | mm | circle in the target frame, parallel to z = 0, or in a bent surface ([`super::surface`]) |
//! | phi | `phi` | 1 | rad | foot on the circle |
//! | q(phi) | `pixel` | 2 | px | its image |
//! | n | `normal` | 2 | 1 | unit normal of the imaged circle, outwards |
//! | g | `dq_dp^T n` | 3 | px/mm | moves the image along n per movement of the point in the camera frame |
//!
//! One row per edge point, `dr/dz = -n . dq/dz`: intrinsics `n . dq/di`; turn w: `p x g`; shift v: `g`; radius: `g . e(phi)`
//! with e the radial direction. A shift of the centre is a shift v turned into the camera frame.

use super::assemble::SeenImage;
use super::model::{DiscObservation, Loss};
use super::tie::Tied;
use crate::camera::{Camera, INTRINSICS, ProjectionJet, WINDOW_STEPS};
use crate::frames::{Cam, Target};
use crate::rigid::{Motion, rotation_exp};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

/// Unknowns of one edge point: intrinsics, turn, shift, radius.
pub(super) const EDGE: usize = INTRINSICS + 7;
/// The same behind a window: its turn and its layers follow.
pub(super) const EDGE_BEHIND: usize = EDGE + WINDOW_STEPS;

/// A circle of the target as one camera has it.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenCircle<'a> {
    pub(super) camera: &'a Camera,
    /// Of the target, turned about the centre where the circle lies in a surface that is bent.
    pub(super) cam_from_target: Motion<Cam, Target>,
    pub(super) center: Vector3<f64>,
    pub(super) radius: f64,
}

/// Foot of an edge point on its imaged circle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foot {
    /// Point of the circle in the camera frame, mm.
    pub(super) p_in_cam: Vector3<f64>,
    /// Radial direction at the foot, in the camera frame.
    pub(super) radial: Vector3<f64>,
    /// Unit normal in the image, outwards.
    pub(super) normal: Vector2<f64>,
    /// Signed distance of the edge point, px; positive outside.
    pub(super) distance_px: f64,
}

/// Image of the centre and the affine map from the target's plane to the image there: what starts every foot.
pub(super) struct Start {
    center_px: Vector2<f64>,
    plane_from_image: Matrix2<f64>,
}

impl Start {
    /// Image of the circle's centre, px.
    pub(super) fn center_px(&self) -> Vector2<f64> {
        self.center_px
    }

    /// Affine map from the image to the target's plane, mm per px.
    pub(super) fn plane_from_image(&self) -> &Matrix2<f64> {
        &self.plane_from_image
    }
}

impl SeenCircle<'_> {
    /// In a surface of the slopes (sx, sy) at its centre: the target turned about that by (sy, -sx, 0).
    pub(super) fn leaning(self, [sx, sy]: [f64; 2]) -> Self {
        let flat = &self.cam_from_target;
        let rotation = flat.rotation * rotation_exp(&Vector3::new(sy, -sx, 0.0));
        let translation_mm = flat.apply(&self.center) - rotation * self.center;
        Self { cam_from_target: Motion::new(rotation, translation_mm), ..self }
    }

    pub(super) fn start(&self) -> Option<Start> {
        let rotation = &self.cam_from_target.rotation;
        let p = self.cam_from_target.apply(&self.center);
        let (q, dq_dp) = self.camera.image_of_point(&p).ok()?;
        let affine = dq_dp * rotation.fixed_columns::<2>(0);
        Some(Start { center_px: q, plane_from_image: affine.try_inverse()? })
    }

    /// Nearest point of the imaged circle: Newton on `(q - q(phi)) . q'(phi) = 0` with the ellipse's own `q'' = q_c - q`.
    pub(super) fn foot(&self, start: &Start, q: &Vector2<f64>) -> Option<Foot> {
        let rotation = &self.cam_from_target.rotation;
        let (ex, ey) = (rotation.column(0), rotation.column(1));
        let c = self.cam_from_target.apply(&self.center);
        let guess = start.plane_from_image * (q - start.center_px);
        let (mut sin, mut cos) = guess.y.atan2(guess.x).sin_cos();
        for round in 0..12 {
            let radial = ex * cos + ey * sin;
            let p = c + radial * self.radius;
            let (pixel, dq_dp) = self.camera.image_of_point(&p).ok()?;
            let tangent = dq_dp * (ey * cos - ex * sin) * self.radius;
            let (gap, speed) = (q - pixel, tangent.norm_squared());
            let along = gap.dot(&tangent);
            // 1e-7 px along the curve leave 1e-15 px across it.
            if along * along <= 1e-14 * speed || round == 11 {
                let outward = Vector2::new(tangent.y, -tangent.x) / speed.sqrt();
                let normal = if outward.dot(&(pixel - start.center_px)) < 0.0 { -outward } else { outward };
                return Some(Foot { p_in_cam: p, radial, normal, distance_px: normal.dot(&gap) });
            }
            let curvature = gap.dot(&(start.center_px - pixel));
            let step = along / (speed - curvature).max(0.3 * speed);
            let (s, co) = step.clamp(-0.7, 0.7).sin_cos();
            (sin, cos) = (sin * co + cos * s, cos * co - sin * s);
        }
        None
    }
}

/// Normal equations of one disc's contour in its own unknowns.
pub(super) struct DiscNormal<const E: usize> {
    pub(super) h: SMatrix<f64, E, E>,
    pub(super) b: SVector<f64, E>,
    pub(super) cost: f64,
    /// What it has in common with others.
    pub(super) tied: Vec<Tied<SVector<f64, E>>>,
}

/// Cost of one contour; `None` where the circle has no image. What it has in common with others is added to `tied`.
pub(super) fn cost(image: &SeenImage, seen: &DiscObservation, tied: &mut Vec<Tied<()>>) -> Option<f64> {
    let (circle, scale, loss) = (image.circle(seen.disc), image.observations.sigma_scale, image.model.loss);
    let start = circle.start()?;
    let edge = &seen.edge;
    let residual = |i: usize| -> Option<f64> {
        let foot = circle.foot(&start, &Vector2::new(edge.u_px[i], edge.v_px[i]))?;
        Some(foot.distance_px / (edge.sigma_px[i] * scale))
    };
    let mut sum = 0.0;
    if seen.independent() {
        for i in 0..edge.u_px.len() {
            let r = residual(i)?;
            sum += loss.apply(r * r).0;
        }
    } else {
        let mut all: Vec<[f64; 1]> = (0..edge.u_px.len()).map(|i| Some([residual(i)?])).collect::<Option<_>>()?;
        seen.whiten(&mut all);
        if let Some(tie) = image.tie(seen) {
            tied.extend(tie.tied(image, seen.disc, tie.take(&mut all).into_iter().map(|[r]| (r, ()))));
        }
        all.iter().for_each(|[r]| sum += loss.apply(r * r).0);
    }
    sum.is_finite().then_some(0.5 * sum)
}

/// Normal equations of one contour, with what it has in common with others; `None` where the circle has no image.
pub(super) fn linearise<const E: usize>(image: &SeenImage, seen: &DiscObservation) -> Option<DiscNormal<E>> {
    let (circle, scale, loss) = (image.circle(seen.disc), image.observations.sigma_scale, image.model.loss);
    let start = circle.start()?;
    let edge = &seen.edge;
    // Row and residual of an edge point over its sigma.
    let whitened = |i: usize| -> Option<([f64; E], [f64; 1])> {
        let foot = circle.foot(&start, &Vector2::new(edge.u_px[i], edge.v_px[i]))?;
        let iw = 1.0 / (edge.sigma_px[i] * scale);
        Some((row::<E>(circle.camera, &foot)?.map(|x| x * iw), [foot.distance_px * iw]))
    };
    let mut sums = Sums { h: [[0.0; E]; E], b: [0.0; E], rho: 0.0 };
    let mut tied = vec![];
    if seen.independent() {
        for i in 0..edge.u_px.len() {
            let (row, [r]) = whitened(i)?;
            sums.add(&row, r, loss);
        }
    } else {
        let (mut rows, mut rest): (Vec<[f64; E]>, Vec<[f64; 1]>) =
            (0..edge.u_px.len()).map(whitened).collect::<Option<_>>()?;
        seen.whiten(&mut rows);
        seen.whiten(&mut rest);
        if let Some(tie) = image.tie(seen) {
            let numbers = tie.take(&mut rest).into_iter().zip(tie.take(&mut rows));
            tied.extend(tie.tied(image, seen.disc, numbers.map(|([r], row)| (r, SVector::from(row)))));
        }
        rows.iter().zip(&rest).for_each(|(row, [r])| sums.add(row, *r, loss));
    }
    sums.done(tied)
}

/// Normal equations under way, lower triangle.
struct Sums<const E: usize> {
    h: [[f64; E]; E],
    b: [f64; E],
    rho: f64,
}

impl<const E: usize> Sums<E> {
    /// The residual is (distance)/sigma and falls as the image moves outwards: J = -row / sigma.
    fn add(&mut self, w: &[f64; E], r: f64, loss: Loss) {
        let (rho, weight) = loss.apply(r * r);
        self.rho += rho;
        for m in 0..E {
            let f = weight * w[m];
            self.b[m] += f * r;
            for n in 0..=m {
                self.h[m][n] += f * w[n];
            }
        }
    }
    fn done(self, tied: Vec<Tied<SVector<f64, E>>>) -> Option<DiscNormal<E>> {
        let h = SMatrix::from_fn(|m, n| if n <= m { self.h[m][n] } else { self.h[n][m] });
        self.rho.is_finite().then(|| DiscNormal { h, b: SVector::from(self.b), cost: 0.5 * self.rho, tied })
    }
}

/// `n . dq/dz` of one edge point.
pub(super) fn row<const E: usize>(camera: &Camera, foot: &Foot) -> Option<[f64; E]> {
    let mut row = [0.0; E];
    let jet = match camera.window() {
        Some(window) => {
            let jet = camera.project_through(window, &foot.p_in_cam).ok()?;
            let (turn, layers) = (jet.dq_dturn.tr_mul(&foot.normal), jet.dq_dlayers.tr_mul(&foot.normal));
            let steps = turn.iter().chain(layers.iter());
            row.iter_mut().skip(EDGE).zip(steps).for_each(|(r, s)| *r = *s);
            ProjectionJet { pixel: jet.pixel, dq_dp: jet.dq_dp, dq_dintrinsics: jet.dq_dintrinsics }
        }
        None => camera.project_jet(&foot.p_in_cam).ok()?,
    };
    let g = jet.dq_dp.tr_mul(&foot.normal);
    let turn = foot.p_in_cam.cross(&g);
    for k in 0..INTRINSICS {
        row[k] = jet.dq_dintrinsics.column(k).dot(&foot.normal);
    }
    for k in 0..3 {
        row[INTRINSICS + k] = turn[k];
        row[INTRINSICS + 3 + k] = g[k];
    }
    row[EDGE - 1] = g.dot(&foot.radial);
    Some(row)
}

/// `sum of w row r_vv / sigma`: the part of one contour in the right-hand side of the geodesic acceleration, with
/// `r_vv = (r(+h) - 2 r + r(-h)) / h^2`; `None` where a circle has no image.
pub(super) fn bend<const E: usize>(
    circles: [&SeenCircle; 3],
    seen: &DiscObservation,
    scale: f64,
    loss: Loss,
    h: f64,
) -> Option<SVector<f64, E>> {
    let starts = [circles[0].start()?, circles[1].start()?, circles[2].start()?];
    let edge = &seen.edge;
    // Row of an edge point; residual and second derivative; all over its sigma.
    let bent = |i: usize| -> Option<([f64; E], [f64; 2])> {
        let q = Vector2::new(edge.u_px[i], edge.v_px[i]);
        let foot = |k: usize| circles[k].foot(&starts[k], &q);
        let (minus, here, plus) = (foot(0)?, foot(1)?, foot(2)?);
        let iw = 1.0 / (edge.sigma_px[i] * scale);
        let second = (plus.distance_px - 2.0 * here.distance_px + minus.distance_px) * iw / (h * h);
        Some((row::<E>(circles[1].camera, &here)?.map(|x| x * iw), [here.distance_px * iw, second]))
    };
    let (mut rows, mut rest): (Vec<[f64; E]>, Vec<[f64; 2]>) = (0..edge.u_px.len()).map(bent).collect::<Option<_>>()?;
    seen.whiten(&mut rows);
    seen.whiten(&mut rest);
    let mut b = SVector::zeros();
    for (row, [r, second]) in rows.iter().zip(&rest) {
        let factor = loss.weight(*r) * second;
        (0..E).for_each(|m| b[m] += row[m] * factor);
    }
    Some(b)
}
