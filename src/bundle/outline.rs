//! Printed discs are not quite round: ovals, alike in every image of the disc.
//!
//! The outline of a printed disc departs from its circle by `a cos 2 phi + b sin 2 phi`, tau (mm) the standard deviation of a and
//! b. In the image that is far more than the noise of an edge point and common to all points of a contour, so that independent
//! sigmas would let ovals turn the plate: on a real plate 5 um of ovality are 0.35 px. The residuals of one contour, over
//! their sigmas, then have the covariance
//! ```text
//! k I + tau^2 B B^T,   B_i = (mm of outline -> px) / sigma_i * (cos 2 phi_i, sin 2 phi_i)
//! ```
//! (k the variance factor of single edge points; sigmas and B after the contour was whitened for what else its points have in common) and
//! are whitened by its inverse root, up to `1 / sqrt k` (see [`CommonNoise`]). That is formed once, from the feet of the first solution, and held: the cost stays one of least squares, its derivatives
//! exact. Higher harmonics do not couple to a plate's pose. tau is estimated from all contours together by moments,
//! `tau^2 = mean of |x|^2 / 2 - k tr (B^T B)^-1 / 2` with x the least-squares (a, b) of a contour, and taken for zero where it is no
//! more than chance.

use super::assemble::{SeenImage, threaded};
use super::contour::SeenCircle;
use super::edges::Feet;
use super::model::{DiscObservation, ImageObservations, Model};
use super::state::State;
use crate::conic::CommonNoise;
use crate::threads::gathered;
use nalgebra::{Matrix2, Vector2};

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
            let (cos, sin) = (feet.direction[0][i], feet.direction[1][i]);
            let (iw, px_per_mm) = (1.0 / edge.sigma_px[i], feet.px_per_mm[i]);
            [(cos * cos - sin * sin) * px_per_mm * iw, 2.0 * sin * cos * px_per_mm * iw, feet.distance_px[i] * iw]
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

/// Estimates the ovality from the residuals and whitens every contour for it; its standard deviation tau, mm, or `None`
/// where the outlines are round as far as their noise shows (and nothing is changed).
pub(super) fn whiten(model: &mut Model, state: &State) -> Option<f64> {
    let of_image = |&(k, image): &(usize, &ImageObservations)| {
        let seen_image = SeenImage::of(model, state, image)?;
        let own = image.discs.iter().enumerate();
        let own = own.filter_map(|(d, seen)| Some((k, d, Harmonic::of(&seen_image.circle(seen.disc), seen)?)));
        Some(own.collect::<Vec<_>>())
    };
    let images: Vec<&ImageObservations> = model.images.iter().collect();
    let numbered: Vec<(usize, &ImageObservations)> = images.iter().copied().enumerate().collect();
    let all: Option<Vec<Vec<_>>> = gathered(threaded(&images), &numbered, of_image);
    let all: Vec<(usize, usize, Harmonic)> = all?.into_iter().flatten().collect();
    let chi2 = all.iter().fold([0.0, 0.0], |a, (_, _, h)| [a[0] + h.rest[0], a[1] + h.rest[1]]);
    let (n, factor) = (all.len() as f64, chi2[0] / chi2[1]);
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
