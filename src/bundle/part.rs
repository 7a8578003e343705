//! A start from a part of the observations.
//!
//! Far from the minimum a part of the observations says where to go as well as all of them do: it finds a start whose distance from the minimum
//! of all is of the order of its own standard deviations, at a fraction of the price of each linearisation. What follows on all
//! observations then takes two or three linearisations, and ends where it would have ended anyway, by the same criterion.
//!
//! Whole groups of [`GROUP`] points are taken, spread evenly over the image, and of each contour (of every second, third, ... where they are many)
//! the same share of its edge points, spread evenly along it. Nothing depends on chance.

use super::model::{DiscObservation, ImageObservations, Loss, Model, PointObservations};
use crate::detect::EdgePoints;
use crate::lanes::GROUP;

/// Observations of an image that are enough for its pose and its share in what all images have in common.
const ENOUGH: usize = 100;
/// Discs of an image that are kept where there are as many.
const SEVERAL: usize = 10;
/// Part of the observations above which a start from them does not pay.
const WORTH: f64 = 0.35;

fn observed(image: &ImageObservations) -> usize {
    image.discs.iter().map(|d| d.edge.u_px.len()).sum::<usize>() + 2 * image.points.disc.len()
}

/// The model with a part of its observations; `None` where all of them are few, or where tangents are among them.
pub(super) fn part(model: &Model) -> Option<Model> {
    // Contours that are taken for round would lead away from a start that knows better.
    if model.target.oval_sigma_mm.is_some() {
        return None;
    }
    let out = with_few_observations(model)?;
    let sum = |model: &Model| model.images.iter().map(observed).sum::<usize>();
    (sum(&out) as f64 <= WORTH * sum(model) as f64).then_some(out)
}

/// The model with no more than some hundred observations of each image; `None` where tangents are among them.
pub(super) fn with_few_observations(model: &Model) -> Option<Model> {
    if model.images.iter().any(|i| !i.pairs.is_empty()) {
        return None;
    }
    // What an ovality takes from the cameras is as much with some points of a contour as with all, so that some must stand for all. Larger
    // than they are, no loss may be asked of them.
    let ovals = model.target.oval_sigma_mm.is_some();
    let images = model.images.iter().map(if ovals { standing_for_all } else { thinned }).collect();
    let Model { cameras, target, views, facts, loss, .. } = model;
    let (cameras, mut target, views) = (cameras.clone(), target.clone(), views.clone());
    // Discs stay where the start has them: few of them are seen, and views are eliminated sooner than discs.
    target.offset_sigma_mm = None;
    let loss = if ovals { Loss::None } else { *loss };
    Some(Model { cameras, target, views, facts: facts.clone(), images, loss })
}

fn share(image: &ImageObservations) -> f64 {
    ENOUGH as f64 / observed(image).max(1) as f64
}

fn thinned(image: &ImageObservations) -> ImageObservations {
    let share = share(image);
    let disc = |d: &DiscObservation| {
        // What whitens a contour holds for all its points together.
        DiscObservation::new(d.disc, some_edge(&d.edge, &evenly(d.edge.u_px.len(), share)))
    };
    ImageObservations {
        view: image.view,
        camera: image.camera,
        discs: image.discs.iter().step_by(one_of(&image.discs, share)).map(disc).collect(),
        pairs: vec![],
        points: some_points(&image.points, share),
        sigma_scale: image.sigma_scale,
    }
}

/// With some points of each contour that say as much as all of them.
fn standing_for_all(image: &ImageObservations) -> ImageObservations {
    let share = share(image);
    let disc = |d: &DiscObservation| {
        let all = d.edge.u_px.len();
        let at = evenly(all, share);
        let Some(tie) = d.tie.as_deref().map(|tie| tie.of_some(&at, all)) else { return d.clone() };
        let mut edge = some_edge(&d.edge, &at);
        let part = (at.len() as f64 / all as f64).sqrt();
        edge.sigma_px.iter_mut().for_each(|sigma| *sigma *= part);
        let [common, outline] = [&d.common, &d.outline].map(|noise| noise.of_some(&at, all));
        DiscObservation { common, outline, tie: tie.map(Box::new), ..DiscObservation::new(d.disc, edge) }
    };
    ImageObservations { discs: image.discs.iter().map(disc).collect(), pairs: vec![], ..image.clone() }
}

/// Of how many discs one is taken, since less than a group of a contour saves no time.
fn one_of(discs: &[DiscObservation], share: f64) -> usize {
    let points = discs.iter().map(|d| d.edge.u_px.len()).sum::<usize>() as f64;
    let mean = share * points / discs.len().max(1) as f64;
    // A pose needs several discs, wherever they are many.
    ((GROUP as f64 / mean) as usize).clamp(1, discs.len().div_ceil(SEVERAL).max(1))
}

/// A share of the points of a contour, spread evenly along it, one group at least.
fn evenly(all: usize, share: f64) -> Vec<usize> {
    let wanted = ((all as f64 * share).ceil() as usize).next_multiple_of(GROUP).min(all);
    (0..wanted).map(|k| k * all / wanted).collect()
}

fn some_edge(edge: &EdgePoints, at: &[usize]) -> EdgePoints {
    let pick = |x: &[f64]| at.iter().map(|i| x[*i]).collect();
    EdgePoints { u_px: pick(&edge.u_px), v_px: pick(&edge.v_px), sigma_px: pick(&edge.sigma_px) }
}

/// A share of the points in groups of neighbours.
fn some_points(points: &PointObservations, share: f64) -> PointObservations {
    let all = points.disc.len().div_ceil(GROUP);
    let wanted = ((all as f64 * share).ceil() as usize).min(all);
    let at: Vec<usize> = (0..wanted)
        .flat_map(|k| {
            // From the middle of each stretch, so that the ends do not weigh more.
            let first = (2 * k + 1) * all / (2 * wanted) * GROUP;
            first..(first + GROUP).min(points.disc.len())
        })
        .collect();
    let pick = |x: &[f64]| at.iter().map(|i| x[*i]).collect();
    PointObservations {
        disc: at.iter().map(|i| points.disc[*i]).collect(),
        u_px: pick(&points.u_px),
        v_px: pick(&points.v_px),
        sigma_px: pick(&points.sigma_px),
    }
}

#[cfg(test)]
mod tests;
