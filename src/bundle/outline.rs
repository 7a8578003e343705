//! Printed discs are not quite round: ovals, alike in every image of the disc.
//!
//! The outline of a printed disc departs from its circle by `a cos 2 phi + b sin 2 phi`, tau (mm) the standard deviation of a and
//! b. In the image that is far more than the noise of an edge point and common to all points of a contour, so that independent
//! sigmas would let ovals turn the plate: on a real plate 5 um of ovality are 0.35 px. With k the variance factor of single edge points the residuals of
//! one contour, over their sigmas, are (sigmas and B after the contour was whitened for what else its points have in common)
//! ```text
//! r = noise + B (a, b),   Cov(noise) = k I,   B_i = (mm of outline -> px) / sigma_i * (cos 2 phi_i, sin 2 phi_i)
//! ```
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | a, b | `ovals_mm` | 2 per disc | mm | ovality of a disc, in the target frame |
//! | phi | `direction` | points | rad | foot of an edge point on its circle, from the target's x axis to its y axis |
//! | tau | `oval_sigma_mm` | 1 | mm | standard deviation of a and b |
//! | B | `rows` | points x 2 | 1/mm | movement of whitened edge points by a and b |
//!
//! B is formed once, from the feet of the first solution, and held: the cost stays one of least squares, its derivatives exact. Higher harmonics do not
//! couple to a plate's pose.
//!
//! *Two discs.* Pose and size of each view take most of an ovality to themselves, alike in all views, so that the cameras follow: it must not be taken for
//! independent from image to image (docs/measurements.md says what came of that). So (a, b) of either disc are unknowns of all images, normal about zero by tau; its square is the mean over its likelihood with everything else integrated out
//! ([`crate::solve::evidence`]), every order of magnitude alike beforehand, up to a hundredth of the radius. Where images do not exclude the largest, a
//! thousandth is taken, and that is said.
//!
//! *Grids, bubbles, discs of one size.* Where centres tell the pose, every view has discs of its own, or which disc is which may differ from view to
//! view, contours are whitened by the inverse root of `k I + tau^2 B B^T`, up to `1 / sqrt k` (see [`CommonNoise`]). tau is estimated from all contours together by moments,
//! `tau^2 = mean of |x|^2 / 2 - k tr (B^T B)^-1 / 2` with x the least-squares (a, b) of a contour, and taken for zero where it is no
//! more than chance.
//!
//! Source: components of variance with all unknowns integrated out after Patterson and Thompson (1971), as in [`crate::solve::evidence`].

use super::adjust::Bundle;
use super::assemble::{SeenImage, threaded};
use super::contour::SeenCircle;
use super::edges::Feet;
use super::layout::Places;
use super::model::{DiscObservation, ImageObservations, Model, TargetShape};
use super::state::State;
use super::tie::Tie;
use crate::conic::CommonNoise;
use crate::solve::{Problem, evidence, likely_mean};
use crate::threads::gathered;
use nalgebra::{Matrix2, Vector2};

/// tau that are weighed, as parts of a radius: from the first to the last, so many.
const LIKELY: [f64; 2] = [1e-6, 1e-2];
const WEIGHED: usize = 33;
/// What minus twice the logarithm of the likelihood falls by where ovals show: three standard deviations.
const SHOWN: f64 = 9.0;
/// Variance of what all contours of a disc say of its ovality, over that by noise, below which it may count as round.
const LEAST: f64 = 0.1;

/// Radii of two discs further apart than this tell them apart in every view.
const UNLIKE: f64 = 1.1;
/// What minus twice the logarithm of the likelihood rises by to the largest tau weighed where images contradict that: two standard deviations.
const EXCLUDED: f64 = 4.0;
/// tau that is assumed where they do not, at most, over a radius: 10 um of a disc of 20 mm.
const ASSUMED: f64 = 1e-3;

/// What is found of outlines.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Outlines {
    /// Whether the model has changed.
    pub(super) changed: bool,
    /// tau, mm, where ovals show.
    pub(super) ovality_mm: Option<f64>,
    /// tau, mm, where images do not tell how large ovals may be.
    pub(super) assumed_mm: Option<f64>,
}

/// Second harmonic of one contour.
struct Harmonic {
    /// B, whitened for what is known of the contour already.
    rows: Vec<[f64; 2]>,
    /// B^T B.
    information: Matrix2<f64>,
    /// Least-squares (a, b), mm.
    oval_mm: Vector2<f64>,
    /// Chi-square of the residuals without it, and how many numbers that are.
    rest: [f64; 2],
}

impl Harmonic {
    fn of(circle: &SeenCircle, seen: &DiscObservation) -> Option<Self> {
        let (edge, feet) = (&seen.edge, Feet::of(circle, seen)?);
        let row = |i: usize| {
            let ([a, b], iw) = (px_per_mm(&feet, i), 1.0 / edge.sigma_px[i]);
            [a * iw, b * iw, feet.distance_px[i] * iw]
        };
        let mut all: Vec<[f64; 3]> = (0..edge.u_px.len()).map(row).collect();
        seen.common.apply(&mut all);
        let (mut information, mut b, mut chi2) = (Matrix2::zeros(), Vector2::zeros(), 0.0);
        for [x, y, r] in &all {
            let row = Vector2::new(*x, *y);
            information += row * row.transpose();
            b += row * *r;
            chi2 += r * r;
        }
        let oval_mm = information.try_inverse()? * b;
        let rest = [chi2 - oval_mm.dot(&b), seen.count() as f64 - 5.0];
        let rows = all.into_iter().map(|[x, y, _]| [x, y]).collect();
        (rest[1] > 0.0 && oval_mm.iter().all(|x| x.is_finite())).then_some(Self { rows, information, oval_mm, rest })
    }

    /// What the points have in common for a given tau^2 / k.
    fn noise(&self, ratio: f64) -> CommonNoise {
        CommonNoise::of(&self.rows, &Matrix2::from_diagonal_element(ratio))
    }
}

/// Movement of an edge point along its normal by the ovality (a, b) of its disc, px per mm.
fn px_per_mm(feet: &Feet, i: usize) -> [f64; 2] {
    let (cos, sin, px) = (feet.direction[0][i], feet.direction[1][i], feet.px_per_mm[i]);
    [px * (cos * cos - sin * sin), px * 2.0 * sin * cos]
}

/// How far the ovality of a disc moves the edge points of a contour along its normal, px.
pub(super) fn moved_px(feet: &Feet, [a, b]: [f64; 2]) -> Vec<f64> {
    let each = (0..feet.px_per_mm.len()).map(|i| px_per_mm(feet, i));
    each.map(|[by_a, by_b]| a * by_a + b * by_b).collect()
}

/// Looks for ovals in the residuals and lets the model know of them; nothing is changed where outlines are round as far as their noise shows.
pub(super) fn find(model: &mut Model, state: &mut State) -> Outlines {
    let printed_pair = matches!(model.target.shape, TargetShape::Pair { per_view: false });
    let [_, r0, r1] = state.shape_mm;
    match printed_pair && model.target.offset_sigma_mm.is_none() && r0.max(r1) > UNLIKE * r0.min(r1) {
        true => of_discs(model, state).unwrap_or_default(),
        false => {
            let ovality_mm = whiten(model, state);
            Outlines { changed: ovality_mm.is_some(), ovality_mm, assumed_mm: None }
        }
    }
}

/// A contour without the ovality of its disc, and how far its points move as more of a and of b is taken off, px per mm.
pub(super) type Round = (DiscObservation, Vec<[Vector2<f64>; 2]>);

/// A contour as a round disc would have it; `None` where the circle has no image.
pub(super) fn round(image: &SeenImage, seen: &DiscObservation) -> Option<Round> {
    let feet = Feet::of(&image.circle(seen.disc), seen)?;
    let ([a, b], mut out) = (image.oval_mm(seen.disc), DiscObservation { tie: None, ..seen.clone() });
    let move_by = |i: usize| px_per_mm(&feet, i).map(|px| -px * Vector2::new(feet.normal[0][i], feet.normal[1][i]));
    let moves: Vec<[Vector2<f64>; 2]> = (0..feet.px_per_mm.len()).map(move_by).collect();
    for (i, [by_a, by_b]) in moves.iter().enumerate() {
        out.edge.u_px[i] += a * by_a.x + b * by_b.x;
        out.edge.v_px[i] += a * by_a.y + b * by_b.y;
    }
    Some((out, moves))
}

/// The harmonics of all contours, each by image and number.
fn harmonics(model: &Model, state: &State) -> Option<Vec<(usize, usize, Harmonic)>> {
    let of_image = |&(k, image): &(usize, &ImageObservations)| {
        let seen_image = SeenImage::of(model, state, image)?;
        let own = image.discs.iter().enumerate();
        let own = own.filter_map(|(d, seen)| Some((k, d, Harmonic::of(&seen_image.circle(seen.disc), seen)?)));
        Some(own.collect::<Vec<_>>())
    };
    let images: Vec<&ImageObservations> = model.images.iter().collect();
    let numbered: Vec<(usize, &ImageObservations)> = images.iter().copied().enumerate().collect();
    let all: Option<Vec<Vec<_>>> = gathered(threaded(&images), &numbered, of_image);
    Some(all?.into_iter().flatten().collect())
}

/// Variance factor of single edge points, k.
fn factor(all: &[(usize, usize, Harmonic)]) -> f64 {
    let chi2 = all.iter().fold([0.0, 0.0], |a, (_, _, h)| [a[0] + h.rest[0], a[1] + h.rest[1]]);
    chi2[0] / chi2[1]
}

/// Ovality as unknowns of two discs, which every image shares; `None` where there is none to be asked for.
fn of_discs(model: &mut Model, state: &mut State) -> Option<Outlines> {
    if model.target.oval_sigma_mm.is_some() {
        return None;
    }
    let all = harmonics(model, state)?;
    let (factor, discs) = (factor(&all).max(1.0), model.target.disc_count());
    let mut information = 0.0;
    for (k, d, h) in &all {
        information += h.information.trace() / (2 * discs) as f64 / factor;
        model.images[*k].discs[*d].tie = Tie::of_oval(&h.rows).map(Box::new);
    }
    let radius_mm = 0.5 * (state.shape_mm[1] + state.shape_mm[2]);
    model.target.oval_sigma_mm = Some(radius_mm);
    state.ovals_mm = vec![[0.0; 2]; discs];
    let found = likely(model, state, (factor, radius_mm));
    match found {
        Some(Likely { tau_mm, falls, rises }) if tau_mm * tau_mm * information > LEAST => {
            let told = rises > EXCLUDED;
            let tau_mm = if told { tau_mm } else { tau_mm.min(ASSUMED * radius_mm) };
            model.target.oval_sigma_mm = Some(tau_mm);
            model
                .images
                .iter_mut()
                .flat_map(|i| &mut i.discs)
                .filter_map(|d| d.tie.as_mut())
                .for_each(|t| t.ask_loss());
            let ovality_mm = (told && falls > SHOWN).then_some(tau_mm);
            Some(Outlines { changed: true, ovality_mm, assumed_mm: (!told).then_some(tau_mm) })
        }
        _ => {
            model.images.iter_mut().flat_map(|i| &mut i.discs).for_each(|d| d.tie = None);
            model.target.oval_sigma_mm = None;
            state.ovals_mm.clear();
            None
        }
    }
}

/// What the likelihood says of tau.
struct Likely {
    /// Root of the mean of its square.
    tau_mm: f64,
    /// By how much minus twice its logarithm falls from round discs to the likeliest, and rises from there to the largest weighed.
    falls: f64,
    rises: f64,
}

/// tau by its likelihood. The model has ovals of the standard deviation `radius_mm`.
fn likely(model: &mut Model, state: &State, (factor, radius_mm): (f64, f64)) -> Option<Likely> {
    let scaled = |model: &mut Model, by: f64| model.images.iter_mut().for_each(|i| i.sigma_scale *= by);
    scaled(model, factor.sqrt());
    let bundle = Bundle::with_views(model);
    let (equations, scales) = (bundle.linearise(state), bundle.scales(state));
    let (first, count) = (Places::of(model).ovals?, 2 * model.target.disc_count());
    scaled(model, 1.0 / factor.sqrt());
    let mut equations = equations?;
    let mut before = radius_mm.powi(-2);
    let mut value = |tau: f64| {
        let weight = tau.powi(-2);
        (first..first + count).for_each(|i| equations.h_gg[(i, i)] += weight - before);
        before = weight;
        Some(evidence(&equations, &scales)? + count as f64 * (tau * tau).ln())
    };
    let part = |k: usize| k as f64 / (WEIGHED - 1) as f64;
    let tried: Vec<f64> = (0..WEIGHED).map(|k| radius_mm * LIKELY[0] * (LIKELY[1] / LIKELY[0]).powf(part(k))).collect();
    let values: Vec<f64> = tried.iter().map(|tau| value(*tau)).collect::<Option<_>>()?;
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let mut each = values.iter().copied();
    let squares: Vec<f64> = tried.iter().map(|tau| tau * tau).collect();
    let tau_mm = likely_mean(&squares, |_| each.next())?.sqrt();
    Some(Likely { tau_mm, falls: values[0] - least, rises: values[WEIGHED - 1] - least })
}

/// Estimates the ovality from the residuals and whitens every contour for it; its standard deviation tau, mm, or `None`
/// where the outlines are round as far as their noise shows (and nothing is changed).
pub(super) fn whiten(model: &mut Model, state: &State) -> Option<f64> {
    let all = harmonics(model, state)?;
    let (n, factor) = (all.len() as f64, factor(&all));
    let half_square = all.iter().map(|(_, _, h)| 0.5 * h.oval_mm.norm_squared()).sum::<f64>() / n;
    let by_noise =
        all.iter().filter_map(|(_, _, h)| Some(0.5 * factor * h.information.try_inverse()?.trace())).sum::<f64>() / n;
    // Mean of 2 n squares: its relative standard deviation is 1 / sqrt n.
    if !(half_square > by_noise * (1.0 + 3.0 / n.sqrt())) {
        return None;
    }
    let variance = half_square - by_noise;
    for (k, d, h) in &all {
        model.images[*k].discs[*d].outline = h.noise(variance / factor);
    }
    Some(variance.sqrt())
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::unwrap_used)]
mod tests;
