//! Tangent residuals: the bitangent features of a pair of discs against the images of the circles' own features.
//!
//! `r = W (f + G (i - i0) - image of F(c0, r0, c1, r1))`, W the whitening of the features' rank-10 covariance, so that r has
//! unit variance; F in closed form ([`crate::bitangent::circle_features`]), its derivative by the shape of the target through
//! those of centres and radii; G how features found through the lens i0 follow another lens i ([`super::refit`]). Equal
//! radii have no external crossing: a state with them is refused where that point was kept. The robust loss sees the pair as one,
//! with a threshold grown by the root of its rank.

use super::assemble::{ImageNormal, LOCAL, SPACE, SeenImage};
use super::model::{Loss, PairObservation};
use crate::bitangent::{EXTERNAL_CROSSING, circle_features};
use crate::camera::INTRINSICS;
use nalgebra::{DMatrix, DVector, Matrix3x2, SMatrix, Vector3};

fn pair_loss(loss: Loss, rank: usize) -> Loss {
    let root = (rank as f64).sqrt();
    match loss {
        Loss::None => Loss::None,
        Loss::Huber(k) => Loss::Huber(k * root),
        Loss::Cauchy(k) => Loss::Cauchy(k * root),
    }
}

/// Derivative of `(x0, y0, r0, x1, y1, r1)` by the three shape parameters.
fn circles_by_shape(image: &SeenImage, discs: [usize; 2]) -> SMatrix<f64, 6, 3> {
    let mut out = SMatrix::zeros();
    for (n, j) in discs.into_iter().enumerate() {
        let d = image.model.target.disc_derivative(j);
        for k in 0..3 {
            out[(3 * n, k)] = d[0][k];
            out[(3 * n + 1, k)] = d[1][k];
            out[(3 * n + 2, k)] = d[3][k];
        }
    }
    out
}

/// Whitened residual, and with `derive` its negative derivative by the image's camera space.
fn residual(image: &SeenImage, pair: &PairObservation, derive: bool) -> Option<(DVector<f64>, DMatrix<f64>)> {
    // Behind a window circles have no tangents in common with their images.
    if image.camera.camera.window().is_some() {
        return None;
    }
    let ((c0, r0), (c1, r1)) = (image.disc(pair.discs[0]), image.disc(pair.discs[1]));
    let features = circle_features(c0.xy(), r0, c1.xy(), r1).ok()?;
    if pair.kept.contains(&EXTERNAL_CROSSING) && !features.external_is_finite {
        return None;
    }
    let by_shape = features.jacobian * circles_by_shape(image, pair.discs);
    let motion = &image.cam_from_target;
    let in_plane: Matrix3x2<f64> = motion.rotation.fixed_columns::<2>(0).into_owned();
    let n = pair.kept.len();
    let follow = pair.lens.as_ref().map(|lens| {
        let now = image.camera.camera.intrinsics().to_array();
        let change = DVector::from_fn(INTRINSICS, |i, _| now[i] - lens.intrinsics[i]);
        (&lens.derivative * change, &lens.derivative)
    });
    let mut gap = DVector::zeros(2 * n);
    let mut d = DMatrix::zeros(2 * n, if derive { LOCAL } else { 0 });
    for (row, &k) in pair.kept.iter().enumerate() {
        let p = motion.apply(&Vector3::new(features.points_mm[2 * k], features.points_mm[2 * k + 1], c0.z));
        let jet = image.camera.camera.project_jet(&p).ok()?;
        for s in 0..2 {
            gap[2 * row + s] = pair.pixels_px[2 * row + s] - jet.pixel[s];
            if let Some((moved, _)) = &follow {
                gap[2 * row + s] += moved[2 * row + s];
            }
            if !derive {
                continue;
            }
            let g: Vector3<f64> = jet.dq_dp.row(s).transpose();
            let turn = p.cross(&g);
            let shape = g.transpose() * in_plane * by_shape.fixed_rows::<2>(2 * k);
            for i in 0..INTRINSICS {
                d[(2 * row + s, i)] =
                    jet.dq_dintrinsics[(s, i)] - follow.as_ref().map_or(0.0, |f| f.1[(2 * row + s, i)]);
            }
            for i in 0..3 {
                d[(2 * row + s, INTRINSICS + i)] = turn[i];
                d[(2 * row + s, INTRINSICS + 3 + i)] = g[i];
                d[(2 * row + s, SPACE + i)] = shape[i];
            }
        }
    }
    let w = &pair.whitening / image.observations.sigma_scale;
    Some((&w * gap, &w * d))
}

/// Cost of one pair; `None` where it has no image.
pub(super) fn cost(image: &SeenImage, pair: &PairObservation) -> Option<f64> {
    let (r, _) = residual(image, pair, false)?;
    let rho = pair_loss(image.model.loss, r.len()).apply(r.norm_squared()).0;
    rho.is_finite().then_some(0.5 * rho)
}

/// Adds one pair to the normal equations of its image; `None` where it has no image.
pub(super) fn linearise<const L: usize>(
    image: &SeenImage,
    pair: &PairObservation,
    out: &mut ImageNormal<L>,
) -> Option<()> {
    let (r, d) = residual(image, pair, true)?;
    let (rho, weight) = pair_loss(image.model.loss, r.len()).apply(r.norm_squared());
    let h = d.tr_mul(&d) * weight;
    let b = d.tr_mul(&r) * weight;
    for i in 0..LOCAL {
        out.b[i] += b[i];
        for j in 0..LOCAL {
            out.h[(i, j)] += h[(i, j)];
        }
    }
    out.cost += 0.5 * rho;
    rho.is_finite().then_some(())
}
