//! Two cameras see the same light: smoke in a bubble draws both contours of a disc alike.
//!
//! What smoke hides of an edge is the same in both images, so that errors of the two contours of a disc at one moment go together. Taken for
//! independent, they let a bubble that smoke makes look oval to both cameras turn and bend these. An ellipse follows five harmonics of the rim in
//! the plane of the disc,
//! ```text
//! rim + x cos phi + y sin phi + r + a cos 2 phi + b sin 2 phi,    d = (x, y, r, a, b)
//! ```
//! With B_c the movement of the edge points of camera c by d, whitened for all that its own contour knows, `U_c = B_c (B_c^T B_c)^(-1/2)` and
//! r_c the whitened distances, the five numbers `p_c = U_c^T r_c` are what camera c says of the rim, of variance one as its image has it. What an image
//! makes of smoke may be off by some tenths, so that the variance is v; and the numbers of both cameras correlate by g, `0 <= g < 1`:
//! ```text
//! Cov (p_1, p_2) = v | 1  g |          (1 - U_c U_c^T) r_c      p_1 / sqrt v      (p_2 - g p_1) / sqrt(v (1 - g^2))
//!                    | g  1 |
//! ```
//! On the right the same in independent numbers of variance one: what is left of either contour, and the common rows. U is formed once, from the feet of the
//! first solution, and held: the cost stays one of least squares with exact derivatives. g and v are means over their likelihood with all unknowns
//! integrated out ([`crate::solve::evidence`]), one after the other; beforehand all g are alike, and `ln v` is normal about what discs in smoke show
//! ([`EXPECTED`]): where images cannot tell g is about a half and v little more than one. Bubbles take most of what both cameras have in common for their
//! own pose and size, so that `v (1 - g)` is told well, and g and v apart less so.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | B | `rim` | points x 5 | 1/mm | movement of whitened edge points by the harmonics |
//! | U | `Tie` | points x 5 | 1 | the same, orthonormal |
//! | g, v | [`Alike`] | 1 | 1 | correlation of what both cameras say, and its variance |
//! | p | `Tied` | 1 | 1 | one of the five numbers, with its derivative |
//!
//! Asked of discs that drift, in views of which nobody knows a length: these are bubbles, others may be holes in a foil. Not valid where the cameras
//! look at different moments. Tangent features count as independent.
//!
//! Source: Anderson, "An introduction to multivariate statistical analysis" (2003), section 2.5, for the conditional density; Patterson and Thompson (1971)
//! for components of variance from what unknowns leave over.

use super::adjust::Bundle;
use super::assemble::SeenImage;
use super::contour::SeenCircle;
use super::edges::Feet;
use super::facts::Fact;
use super::model::{DiscObservation, ImageObservations, Model};
use super::state::State;
use super::tie::{Alike, Tie};
use crate::solve::{Problem, SymmetricEigen, evidence, likely_mean, symmetric_eigen};
use nalgebra::{DMatrix, SMatrix, SVector};

/// Numbers that a contour says of its rim.
const NUMBERS: usize = 5;
/// Information on the one that is told least, over that on the one told most, below which a contour does not fix them.
const LEAST: f64 = 1e-6;
/// Correlations and variances that are weighed, and how often one after the other.
const TRIED: usize = 20;
const TIMES: usize = 2;
/// Mean and standard deviation of `ln v` beforehand: mean squared errors of bubbles in random rigs are 1.1 to 1.6 of their variances
/// (docs/measurements.md), in faint smoke less. And the largest weighed.
const EXPECTED: f64 = 0.1;
const UNSURE: f64 = 0.2;
const FURTHEST: f64 = 1.0;

/// What the whitened edge points of a contour say of its rim, in five numbers; `None` where they do not fix them.
fn columns(circle: &SeenCircle, seen: &DiscObservation) -> Option<Vec<[f64; NUMBERS]>> {
    let feet = Feet::of(circle, seen)?;
    let harmonics = |i: usize| {
        let (cos, sin) = (feet.direction[0][i], feet.direction[1][i]);
        let px = feet.px_per_mm[i] / seen.edge.sigma_px[i];
        [px * cos, px * sin, px, px * (cos * cos - sin * sin), px * 2.0 * sin * cos]
    };
    let mut rim: Vec<[f64; NUMBERS]> = (0..seen.edge.u_px.len()).map(harmonics).collect();
    seen.whiten(&mut rim);
    let mut normal = SMatrix::<f64, NUMBERS, NUMBERS>::zeros();
    for row in rim.iter().map(|row| SVector::from(*row)) {
        normal += row * row.transpose();
    }
    let SymmetricEigen { values, vectors } =
        symmetric_eigen(&DMatrix::from_column_slice(NUMBERS, NUMBERS, normal.as_slice()))?;
    if !(values[0] > LEAST * values[NUMBERS - 1]) {
        return None;
    }
    let root = &vectors * DMatrix::from_diagonal(&values.map(|x| x.powf(-0.5))) * vectors.transpose();
    let root = SMatrix::<f64, NUMBERS, NUMBERS>::from_column_slice(root.as_slice());
    rim.iter_mut().for_each(|row| *row = (root * SVector::from(*row)).into());
    Some(rim)
}

/// The two contours of a disc, each by image and number, and what either says.
type Pair = ([(usize, usize); 2], [Vec<[f64; NUMBERS]>; 2]);

/// Discs that two images of a view show.
fn pairs(model: &Model, state: &State, images: [usize; 2]) -> Vec<Pair> {
    let observed = images.map(|i| &model.images[i]);
    let [Some(first), Some(second)] = observed.map(|o| SeenImage::of(model, state, o)) else { return vec![] };
    let of_disc = |(d, seen): (usize, &DiscObservation)| {
        let e = observed[1].discs.iter().position(|other| other.disc == seen.disc)?;
        let own = columns(&first.circle(seen.disc), seen)?;
        let other = columns(&second.circle(seen.disc), &observed[1].discs[e])?;
        Some(([(images[0], d), (images[1], e)], [own, other]))
    };
    observed[0].discs.iter().enumerate().filter_map(of_disc).collect()
}

/// Ties the contours of bubbles that two cameras see at one moment, in place of ties from before; how, where there are any.
pub(super) fn tie(model: &mut Model, state: &State) -> Option<Alike> {
    if !model.target.per_view() || model.target.offset_sigma_mm.is_some() {
        return None;
    }
    model.images.iter_mut().flat_map(|i| &mut i.discs).for_each(|d| d.tie = None);
    let known = |v: usize| model.facts.iter().any(|f| matches!(f, Fact::Shape { view: Some(of), .. } if *of == v));
    let mut found = vec![];
    for (i, first) in model.images.iter().enumerate().filter(|(_, o)| !known(o.view)) {
        let partner = |o: &ImageObservations| o.view == first.view && o.camera > first.camera;
        let partners = model.images.iter().enumerate().filter(|(_, o)| partner(o));
        found.extend(partners.flat_map(|(j, _)| pairs(model, state, [i, j])));
    }
    for (at, columns) in &found {
        for (k, ((i, d), rows)) in at.iter().zip(columns).enumerate() {
            model.images[*i].discs[*d].tie = Some(Box::new(Tie::of_light(rows, k == 1)));
        }
    }
    let alike = if found.is_empty() { None } else { alike(model, state, (found.len() * NUMBERS) as f64) };
    for disc in model.images.iter_mut().flat_map(|i| &mut i.discs) {
        match (alike, &mut disc.tie) {
            (Some(alike), Some(tie)) => tie.set_alike(alike),
            _ => disc.tie = None,
        }
    }
    alike
}

/// Means of correlation and variance over their likelihood, for so many pairs of numbers.
fn alike(model: &Model, state: &State, pairs: f64) -> Option<Alike> {
    let bundle = Bundle::with_views(model);
    let mut images = bundle.of_each_image(state)?;
    let scales = bundle.scales(state);
    let mut value = |alike: Alike| {
        images.iter_mut().flat_map(|(_, n)| &mut n.tied).for_each(|t| t.set_alike(alike));
        let own = evidence(&bundle.summed(images.iter(), state)?, &scales)?;
        let Alike { correlation: g, variance: v } = alike;
        Some(own + pairs * (2.0 * v.ln() + (1.0 - g * g).ln()) + ((v.ln() - EXPECTED) / UNSURE).powi(2))
    };
    let mut out = Alike::UNKNOWN;
    for _ in 0..TIMES {
        let part = |k: usize| (k as f64 + 0.5) / TRIED as f64;
        let correlations: Vec<f64> = (0..TRIED).map(part).collect();
        out.correlation = likely_mean(&correlations, |correlation| value(Alike { correlation, ..out }))?;
        let variances: Vec<f64> = (0..TRIED).map(|k| (FURTHEST * (2.0 * part(k) - 1.0)).exp()).collect();
        out.variance = likely_mean(&variances, |variance| value(Alike { variance, ..out }))?;
    }
    Some(out)
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::unwrap_used)]
mod tests;
