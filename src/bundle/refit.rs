//! Bitangent features through the lens: undistort, refit, map back, and adjust until lens and features agree.
//!
//! The contour of a disc is an ellipse only where there is no distortion. So the edge points go back through the current lens to
//! the ideal plane, where an ellipse with its covariance is fitted and the tangents of two ellipses are drawn; the features
//! then return through the same lens to real pixels:
//! ```text
//! x_i = f U(q_i; i0)                       edge point on the ideal plane, scaled to about a pixel
//! s_i = sigma_i |A^T n|,  A = dx/dq        its deviation normal to the ellipse there
//! p   = argmin sum (d_i(p) / s_i)^2        ellipse,   C_p its covariance
//! F   = q(X(p_0, p_1); i0)                 features: tangents X on the ideal plane, back in real pixels
//! ```
//! What the points of a contour have in common (blur and light), the fit's residuals are whitened for as those of the contours are.
//!
//! The features depend on the lens that is sought. Repeating the adjustment with features held converges slowly: they follow
//! the lens that was assumed. Here their derivative by the lens takes part, so that a round is a Gauss-Newton step of the
//! whole and few rounds suffice:
//! ```text
//! dp/di = -J_p N^-1 sum row_i^T (n_i . dx_i/di) / s_i^2       the fit's own normal equations
//! dF/di = dq/di + dq/dx (dX/dp) (dp/di)
//! ```
//! In the same way they follow the ovality of printed discs where that is an unknown ([`super::outline`]): so much of it as the state has is taken off
//! the edge points before, and `dx_i/d(a, b) = -A n_i (px per mm of outline) (cos 2 phi_i, sin 2 phi_i)`.
//!
//! A round ends at the minimum for its features; the last one is that whose features are found at a minimum already: the
//! Newton decrement with fresh features is below the limit.
//!
//! | symbol | identifier | shape | unit | frame | meaning |
//! |---|---|---|---|---|---|
//! | q_i, sigma_i | `edge` | 2, 1 | px | Sensor | edge point |
//! | x_i | `u`, `v` | 2 | px | ideal plane | undistorted, times f |
//! | p, C_p | `fit` | 5, 5 x 5 | px, rad | ideal plane | ellipse |
//! | dp/di, dp/d(a, b) | `by` | 5 x 12 | per unit | - | how the ellipse follows the lens and the ovality of its disc |
//! | F, dF/di, dF/d(a, b) | `pixels_px`, [`LensDependence::derivative`], [`OvalDependence::derivative`] | 28, 28 x 10, 28 x 4 | px | Sensor | features |
//!
//! Source: method section 3. Not valid for discs that are not separated, and a crossing is left out where the lens would have to
//! be believed far outside the edge points: the eight tangency points alone carry all ten degrees of freedom of a pair.

use super::adjust::{AdjustOptions, Adjustment, adjust};
use super::assemble::SeenImage;
use super::model::{DiscObservation, LensDependence, Model, OvalDependence, PairObservation, TargetShape};
use super::outline;
use super::state::State;
use crate::bitangent::{Bitangents, EXTERNAL_CROSSING, ExternalUse, POINTS, bitangents};
use crate::camera::{Camera, INTRINSICS};
use crate::conic::{
    Ellipse, EllipseFit, Frame, covariance_from_regular, fit_direct, fit_geometric_from, from_regular,
    parameters_by_regular, to_regular,
};
use crate::error::{Invalid, Result};
use crate::solve::{Iteration, Termination};
use nalgebra::{DMatrix, SMatrix, SVector, Vector2};
use std::ops::AddAssign;

/// A crossing is used up to this times the distance of the farthest edge point from the lens axis.
const CROSSING_REACH: f64 = 1.5;
/// Most rounds of features and adjustment; three to five are needed.
const ROUNDS: usize = 30;

/// What moves the ellipse of one disc: the lens, and what is taken off as ovality.
const MOVING: usize = INTRINSICS + 2;
/// What moves the features of two.
const ALL: usize = INTRINSICS + 4;

/// An ellipse on the ideal plane.
struct Straight {
    fit: EllipseFit,
    /// By the intrinsics, then by the ovality (a, b) of the disc.
    by: SMatrix<f64, 5, MOVING>,
    /// Largest distance of an edge point from the lens axis, px.
    reach_px: f64,
}

/// The ellipse of a contour without the lens's distortion; `None` where the lens cannot be undone or nothing fits. `moves` is how its points follow
/// the ovality of the disc, px per mm of a and b; empty where nothing is known of it.
fn straight(camera: &Camera, (seen, moves): (&DiscObservation, &[[Vector2<f64>; 2]])) -> Option<Straight> {
    let edge = &seen.edge;
    let f = camera.intrinsics().f_px;
    let n = edge.u_px.len();
    let (mut u, mut v, mut jets) = (vec![], vec![], vec![]);
    for i in 0..n {
        let jet = camera.unproject_jet(&Vector2::new(edge.u_px[i], edge.v_px[i])).ok()?;
        u.push(f * jet.xy.x);
        v.push(f * jet.xy.y);
        jets.push(jet);
    }
    let start = fit_direct(&u, &v).ok()?;
    let near = Frame::new(&start);
    let sigma: Vec<f64> = (0..n)
        .map(|i| {
            let row = near.foot(u[i], v[i], None).row;
            edge.sigma_px[i] * (jets[i].dxy_dq.transpose() * Vector2::new(row[0], row[1])).norm() * f
        })
        .collect();
    let mut fit = fit_geometric_from(&start, &u, &v, &sigma).ok()?;
    fit.ellipse = polished(&fit.ellipse, &u, &v, &sigma, seen)?;
    let frame = Frame::new(&fit.ellipse);
    let mut rows: Vec<[f64; 5 + MOVING]> = (0..n)
        .map(|i| {
            let row = frame.foot(u[i], v[i], None).row;
            // The normal is minus the derivative by the centre.
            let along = |x: Vector2<f64>| -(x.x * row[0] + x.y * row[1]) * f;
            std::array::from_fn(|k| match k {
                0..5 => row[k] / sigma[i],
                k if k < 5 + INTRINSICS => along(jets[i].dxy_dintrinsics.column(k - 5).into_owned()) / sigma[i],
                k => moves.get(i).map_or(0.0, |m| along(jets[i].dxy_dq * m[k - 5 - INTRINSICS]) / sigma[i]),
            })
        })
        .collect();
    seen.whiten(&mut rows);
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut by = SMatrix::<f64, 5, MOVING>::zeros();
    for row in &rows {
        let own = SVector::<f64, 5>::from_fn(|k, _| row[k]);
        normal += own * own.transpose();
        by -= own * SVector::<f64, MOVING>::from_fn(|k, _| row[5 + k]).transpose();
    }
    let regular = normal.cholesky()?.inverse();
    let at = to_regular(&fit.ellipse);
    if !seen.independent() {
        fit.covariance = covariance_from_regular(&at, &regular);
    }
    let by = parameters_by_regular(&at, &regular) * regular * by;
    let reach_px = u.iter().zip(&v).map(|(u, v)| u.hypot(*v)).fold(0.0, f64::max);
    Some(Straight { fit, by, reach_px })
}

/// Gauss-Newton steps more: a fit ends within about 1e-6 of its sigmas, and the rounds could not end much below that; and
/// the ellipse is weighed as its contour is, by what its points have in common.
fn polished(ellipse: &Ellipse, u: &[f64], v: &[f64], sigma: &[f64], seen: &DiscObservation) -> Option<Ellipse> {
    let mut q = to_regular(ellipse);
    for _ in 0..if seen.independent() { 2 } else { 4 } {
        let frame = Frame::new(&from_regular(&q)?);
        let mut rows: Vec<[f64; 6]> = (0..u.len())
            .map(|i| {
                let foot = frame.foot(u[i], v[i], None);
                std::array::from_fn(|k| foot.row.get(k).copied().unwrap_or(foot.distance) / sigma[i])
            })
            .collect();
        seen.whiten(&mut rows);
        let (mut normal, mut gradient) = (SMatrix::<f64, 5, 5>::zeros(), SVector::<f64, 5>::zeros());
        for row in &rows {
            let own = SVector::<f64, 5>::from_fn(|k, _| row[k]);
            normal += own * own.transpose();
            gradient += own * row[5];
        }
        q -= normal.cholesky()?.solve(&gradient);
    }
    from_regular(&q)
}

/// Features of two discs in real pixels, found through this camera's lens, with their covariance and how they follow the lens;
/// `None` where a contour cannot be undistorted or the ellipses are not separated.
pub fn pair_features(camera: &Camera, discs: [&DiscObservation; 2]) -> Option<PairObservation> {
    Some(features(camera, discs.map(|d| (d, &[][..])))?.0)
}

/// The same of discs that are not quite round, as all images have them.
fn features_of_ovals(camera: &Camera, image: &SeenImage, discs: [&DiscObservation; 2]) -> Option<PairObservation> {
    let round = [outline::round(image, discs[0])?, outline::round(image, discs[1])?];
    let (mut pair, by_ovals) = features(camera, [0, 1].map(|i| (&round[i].0, &round[i].1[..])))?;
    let ovals_mm = discs.map(|d| image.oval_mm(d.disc));
    pair.ovals = Some(OvalDependence { ovals_mm, derivative: by_ovals });
    Some(pair)
}

/// Features of two contours with how their points follow ovals, and how the features do: 2 kept x 4, px/mm.
fn features(
    camera: &Camera,
    discs: [(&DiscObservation, &[[Vector2<f64>; 2]]); 2],
) -> Option<(PairObservation, DMatrix<f64>)> {
    let ellipses = [straight(camera, discs[0])?, straight(camera, discs[1])?];
    let mut features = bitangents(&ellipses[0].fit.ellipse, &ellipses[1].fit.ellipse).ok()?;
    let mut by = DMatrix::zeros(2 * POINTS, ALL);
    for (i, e) in ellipses.iter().enumerate() {
        let moved = features.jacobian.fixed_columns::<5>(5 * i) * e.by;
        let (lens, ovals) = (moved.columns(0, INTRINSICS), moved.columns(INTRINSICS, 2));
        by.columns_mut(0, INTRINSICS).add_assign(&lens);
        by.columns_mut(INTRINSICS + 2 * i, 2).add_assign(&ovals);
    }
    let reach_px = CROSSING_REACH * ellipses[0].reach_px.max(ellipses[1].reach_px);
    // The external crossing bends most and says nothing that the others do not.
    let kept: Vec<usize> = (0..POINTS)
        .filter(|&k| {
            k != EXTERNAL_CROSSING
                && features.point(k).is_some_and(|x| x.norm() <= reach_px)
                && through_lens(camera, &mut features, &mut by, k).is_some()
        })
        .collect();
    for k in (0..POINTS).filter(|k| !kept.contains(k)) {
        features.jacobian.fixed_rows_mut::<2>(2 * k).fill(0.0);
    }
    let covariances = [&ellipses[0].fit.covariance, &ellipses[1].fit.covariance];
    let whitening = features.whitening(covariances, ExternalUse::Never).ok()?;
    let at = |j: usize| 2 * kept[j / 2] + j % 2;
    let kept_rows = |first: usize, count: usize| DMatrix::from_fn(2 * kept.len(), count, |i, j| by[(at(i), first + j)]);
    let (by_lens, by_ovals) = (kept_rows(0, INTRINSICS), kept_rows(INTRINSICS, 4));
    let pair = PairObservation {
        discs: discs.map(|(d, _)| d.disc),
        pixels_px: (0..2 * kept.len()).map(|j| features.points[at(j)]).collect(),
        whitening: DMatrix::from_fn(whitening.rank, 2 * kept.len(), |i, j| whitening.matrix[(i, at(j))]),
        lens: Some(LensDependence { intrinsics: camera.intrinsics().to_array(), derivative: by_lens }),
        ovals: None,
        kept,
    };
    Some((pair, by_ovals))
}

/// Brings feature `k` with its derivatives from the ideal plane to real pixels.
fn through_lens(camera: &Camera, features: &mut Bitangents, by: &mut DMatrix<f64>, k: usize) -> Option<()> {
    let f = camera.intrinsics().f_px;
    let xy = features.point(k)? / f;
    let (pixel, dq_dxy, dq_dintrinsics) = camera.image_jet(&xy).ok()?;
    // The plane is scaled by the f of this moment, a constant: only U and the way back know that f moves.
    let dq_dx = dq_dxy / f;
    let own = dq_dx * features.jacobian.fixed_rows::<2>(2 * k);
    let mut moved = dq_dx * by.fixed_rows::<2>(2 * k);
    moved.columns_mut(0, INTRINSICS).add_assign(&dq_dintrinsics);
    features.points.fixed_rows_mut::<2>(2 * k).copy_from(&pixel);
    features.jacobian.fixed_rows_mut::<2>(2 * k).copy_from(&own);
    by.fixed_rows_mut::<2>(2 * k).copy_from(&moved);
    Some(())
}

/// Result of [`adjust_tangents`].
#[derive(Debug, Clone)]
pub struct TangentAdjustment {
    /// The adjustment; its model holds the features of the last round in place of the contours. Its decrement is that with
    /// fresh features at the estimate.
    pub adjustment: Adjustment,
    /// How often features were found.
    pub rounds: usize,
    /// Pairs of the target that are seen, but give no features (not separated once undistorted): view and camera.
    pub left_out: Vec<[usize; 2]>,
}

/// Features of every pair in every image through the cameras of `state`, in place of the contours; and the images without.
pub(super) fn with_features(contours: &Model, state: &State) -> (Model, Vec<[usize; 2]>) {
    let mut model = contours.clone();
    let mut left_out = vec![];
    for (image, of) in model.images.iter_mut().zip(&contours.images) {
        image.discs.clear();
        let disc = |j: usize| of.discs.iter().find(|d| d.disc == j);
        let (Some(first), Some(second)) = (disc(0), disc(1)) else { continue };
        let found = Camera::new(state.cameras[of.camera]).ok().and_then(|camera| match contours.target.oval_sigma_mm {
            None => pair_features(&camera, [first, second]),
            Some(_) => features_of_ovals(&camera, &SeenImage::of(contours, state, of)?, [first, second]),
        });
        match found {
            Some(pair) => image.pairs = vec![pair],
            None => left_out.push([of.view, of.camera]),
        }
    }
    (model, left_out)
}

/// Adjusts everything from a start with bitangent features in place of the contours of `contours`, whose sigma scales are kept.
///
/// # Errors
/// [`Invalid::Contradiction`] for a target of more than two discs (neighbouring pairs would share discs, and their features would
/// not be independent) or with an offset of every disc.
pub fn adjust_tangents(
    contours: &Model,
    start: State,
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<TangentAdjustment> {
    if !matches!(contours.target.shape, TargetShape::Pair { .. }) || contours.target.offset_sigma_mm.is_some() {
        return Err(Invalid::Contradiction(
            "bitangent features belong to a pair of discs: pairs of a grid share their discs and are not independent, and an offset of \
             every disc cannot be told from them; use observations = \"contour\" for grids, plates and adjust = \"points\""
                .into(),
        )
        .into());
    }
    let options = AdjustOptions { rounds: 0, ..*options };
    let mut state = start;
    if contours.target.oval_sigma_mm.is_some() {
        state.ovals_mm.resize(contours.target.disc_count(), [0.0; 2]);
    }
    let (mut rounds, mut iterations) = (0, 0);
    loop {
        let (model, left_out) = with_features(contours, &state);
        rounds += 1;
        let mut fresh = None;
        let mut adjustment = adjust(&model, state, &options, &mut |i| {
            fresh.get_or_insert(i.decrement);
            observe(&Iteration { number: iterations + i.number, ..*i })
        });
        iterations += adjustment.iterations;
        let fresh = fresh.unwrap_or(f64::INFINITY);
        let agreed = fresh < options.solve.decrement;
        if agreed || rounds == ROUNDS || adjustment.termination != Termination::Converged {
            adjustment.iterations = iterations;
            adjustment.decrement = if agreed { adjustment.decrement } else { fresh };
            if !agreed && adjustment.termination == Termination::Converged {
                adjustment.termination = Termination::IterationLimit;
            }
            return Ok(TangentAdjustment { adjustment, rounds, left_out });
        }
        state = adjustment.state;
    }
}
