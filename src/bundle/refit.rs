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
//! What the points of a contour have in common (blur and light), the fit's residuals are whitened for as those of the contours are. Ovals of the print,
//! where contours have told them, are taken off before.
//!
//! The features depend on the lens that is sought. Repeating the adjustment with features held converges slowly: they follow
//! the lens that was assumed. Here their derivative by the lens takes part, so that a round is a Gauss-Newton step of the
//! whole and few rounds suffice:
//! ```text
//! dp/di = -J_p N^-1 sum row_i^T (n_i . dx_i/di) / s_i^2       the fit's own normal equations
//! dF/di = dq/di + dq/dx (dX/dp) (dp/di)
//! ```
//! A round ends at the minimum for its features; the last one is that whose features are found at a minimum already: the
//! Newton decrement with fresh features is below the limit.
//!
//! | symbol | identifier | shape | unit | frame | meaning |
//! |---|---|---|---|---|---|
//! | q_i, sigma_i | `edge` | 2, 1 | px | Sensor | edge point |
//! | x_i | `u`, `v` | 2 | px | ideal plane | undistorted, times f |
//! | p, C_p | `fit` | 5, 5 x 5 | px, rad | ideal plane | ellipse |
//! | dp/di | `by_lens` | 5 x 10 | per unit | - | how the ellipse follows the lens |
//! | F, dF/di | `pixels_px`, [`LensDependence::derivative`] | 28, 28 x 10 | px | Sensor | features |
//!
//! Source: method section 3. Not valid for discs that are not separated, and a crossing is left out where the lens would have to
//! be believed far outside the edge points: the eight tangency points alone carry all ten degrees of freedom of a pair.

use super::adjust::{AdjustOptions, Adjustment, adjust};
use super::model::{DiscObservation, LensDependence, Model, PairObservation, TargetShape};
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

/// A crossing is used up to this times the distance of the farthest edge point from the lens axis.
const CROSSING_REACH: f64 = 1.5;
/// Most rounds of features and adjustment; three to five are needed.
const ROUNDS: usize = 30;

/// An ellipse on the ideal plane.
struct Straight {
    fit: EllipseFit,
    by_lens: SMatrix<f64, 5, INTRINSICS>,
    /// Largest distance of an edge point from the lens axis, px.
    reach_px: f64,
}

/// The ellipse of a contour without the lens's distortion; `None` where the lens cannot be undone or nothing fits.
fn straight(camera: &Camera, seen: &DiscObservation) -> Option<Straight> {
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
    let mut rows: Vec<[f64; 5 + INTRINSICS]> = (0..n)
        .map(|i| {
            let row = frame.foot(u[i], v[i], None).row;
            // The normal is minus the derivative by the centre.
            let along = -(jets[i].dxy_dintrinsics.row(0) * row[0] + jets[i].dxy_dintrinsics.row(1) * row[1]) * f;
            std::array::from_fn(|k| if k < 5 { row[k] } else { along[k - 5] } / sigma[i])
        })
        .collect();
    seen.whiten(&mut rows);
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut by = SMatrix::<f64, 5, INTRINSICS>::zeros();
    for row in &rows {
        let own = SVector::<f64, 5>::from_fn(|k, _| row[k]);
        normal += own * own.transpose();
        by -= own * SVector::<f64, INTRINSICS>::from_fn(|k, _| row[5 + k]).transpose();
    }
    let regular = normal.cholesky()?.inverse();
    let at = to_regular(&fit.ellipse);
    if !seen.independent() {
        fit.covariance = covariance_from_regular(&at, &regular);
    }
    let by_lens = parameters_by_regular(&at, &regular) * regular * by;
    let reach_px = u.iter().zip(&v).map(|(u, v)| u.hypot(*v)).fold(0.0, f64::max);
    Some(Straight { fit, by_lens, reach_px })
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
    let ellipses = [straight(camera, discs[0])?, straight(camera, discs[1])?];
    let mut features = bitangents(&ellipses[0].fit.ellipse, &ellipses[1].fit.ellipse).ok()?;
    let mut by_lens = DMatrix::zeros(2 * POINTS, INTRINSICS);
    for (i, e) in ellipses.iter().enumerate() {
        by_lens += features.jacobian.fixed_columns::<5>(5 * i) * e.by_lens;
    }
    let reach_px = CROSSING_REACH * ellipses[0].reach_px.max(ellipses[1].reach_px);
    // The external crossing bends most and says nothing that the others do not.
    let kept: Vec<usize> = (0..POINTS)
        .filter(|&k| {
            k != EXTERNAL_CROSSING
                && features.point(k).is_some_and(|x| x.norm() <= reach_px)
                && through_lens(camera, &mut features, &mut by_lens, k).is_some()
        })
        .collect();
    for k in (0..POINTS).filter(|k| !kept.contains(k)) {
        features.jacobian.fixed_rows_mut::<2>(2 * k).fill(0.0);
    }
    let covariances = [&ellipses[0].fit.covariance, &ellipses[1].fit.covariance];
    let whitening = features.whitening(covariances, ExternalUse::Never).ok()?;
    let at = |j: usize| 2 * kept[j / 2] + j % 2;
    Some(PairObservation {
        discs: [discs[0].disc, discs[1].disc],
        pixels_px: (0..2 * kept.len()).map(|j| features.points[at(j)]).collect(),
        whitening: DMatrix::from_fn(whitening.rank, 2 * kept.len(), |i, j| whitening.matrix[(i, at(j))]),
        lens: Some(LensDependence {
            intrinsics: camera.intrinsics().to_array(),
            derivative: DMatrix::from_fn(2 * kept.len(), INTRINSICS, |i, j| by_lens[(at(i), j)]),
        }),
        kept,
    })
}

/// Brings feature `k` with its derivatives from the ideal plane to real pixels.
fn through_lens(camera: &Camera, features: &mut Bitangents, by_lens: &mut DMatrix<f64>, k: usize) -> Option<()> {
    let f = camera.intrinsics().f_px;
    let xy = features.point(k)? / f;
    let (pixel, dq_dxy, dq_dintrinsics) = camera.image_jet(&xy).ok()?;
    // The plane is scaled by the f of this moment, a constant: only U and the way back know that f moves.
    let dq_dx = dq_dxy / f;
    let own = dq_dx * features.jacobian.fixed_rows::<2>(2 * k);
    let lens = dq_dx * by_lens.fixed_rows::<2>(2 * k) + dq_dintrinsics;
    features.points.fixed_rows_mut::<2>(2 * k).copy_from(&pixel);
    features.jacobian.fixed_rows_mut::<2>(2 * k).copy_from(&own);
    by_lens.fixed_rows_mut::<2>(2 * k).copy_from(&lens);
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
fn with_features(contours: &Model, state: &State) -> (Model, Vec<[usize; 2]>) {
    let mut model = contours.clone();
    let mut left_out = vec![];
    for image in &mut model.images {
        let discs = std::mem::take(&mut image.discs);
        let of = |j: usize| discs.iter().find(|d| d.disc == j);
        let (Some(first), Some(second)) = (of(0), of(1)) else { continue };
        let camera = Camera::new(state.cameras[image.camera]).ok();
        match camera.and_then(|c| pair_features(&c, [first, second])) {
            Some(pair) => image.pairs = vec![pair],
            None => left_out.push([image.view, image.camera]),
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
    let round = contours.target.oval_sigma_mm.and_then(|_| outline::taken_off(contours, &start));
    let (contours, mut state) = (round.as_ref().unwrap_or(contours), start);
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
