//! Dots of a grid that are printed beside their places.
//!
//! Labels are given to discs that lie where the others say; one that lies a hundredth of the pitch beside that is turned down in every image, as dust is.
//! Cameras tell the two apart: a dot of the target is off by the same step on the target wherever it is seen. It is set aside as an outlier then, with
//! its label, so that tables, pictures and reasons name it.

use super::images::SeenImage;
use super::model::{Built, node};
use crate::bundle::{
    Adjustment, DiscObservation, ImageObservations, Model, Outlier, PredictedPlace, TargetShape, predicted_places,
    residuals,
};
use crate::detect::LabelledDisc;
use crate::rig_file::RigDescription;
use crate::target::{DotId, Target};
use nalgebra::Vector2;
use std::collections::{BTreeMap, BTreeSet};

/// A dot lies no further from its place than this, and no nearer, pitches; nearer ones are what print leaves.
const BESIDE: (f64, f64) = (0.005, 0.2);
/// It grows or shrinks by no more than this part of its radius.
const ALIKE: f64 = 0.2;
/// Steps that two images see are the same where they differ by no more than this part of them.
const SAME: f64 = 0.3;
/// Places that are looked at, for each dot that has a label.
const PLACES: usize = 8;

/// A disc left over beside a place that is free in its image.
struct Beside {
    image: usize,
    found: usize,
    off_mm: Vector2<f64>,
    distance_px: f64,
}

/// Gives dots that all images show beside the same place their labels, and sets them aside.
///
/// `contours` is the model of the adjustment against contours; places that nothing had been seen at are added to it and to the labels.
pub(super) fn set_aside(
    job: &RigDescription,
    built: &mut Built,
    images: &mut [SeenImage],
    contours: &mut Model,
    adjustment: &mut Adjustment,
) {
    if !matches!(contours.target.shape, TargetShape::Lattice(_)) || images.iter().all(|i| i.left_over.is_empty()) {
        return;
    }
    let mut labels = built.labels.clone();
    let two_levels = matches!(job.target.target, Target::TwoLevelPlate(_));
    labels.extend(missing(&built.labels, two_levels));
    let mut wide = contours.clone();
    let nodes = |labels: &[DotId]| TargetShape::Lattice(labels.iter().map(|l| node(&job.target.target, l)).collect());
    wide.target.shape = nodes(&labels);
    for (place, all) in beside_in_most(images, &wide, &built.problem.model.images, adjustment) {
        let known = place < built.labels.len();
        let disc = if known { place } else { built.labels.len() };
        if !known {
            built.labels.push(labels[place]);
        }
        for b in all {
            let image = &mut images[b.image];
            image.left_over.retain(|i| *i != b.found);
            image.discs.push(LabelledDisc { disc: b.found, id: labels[place] });
            let seen = DiscObservation::of(disc, &image.detection.discs[b.found]);
            built.problem.model.images[b.image].discs.push(seen);
            let (view, camera) = (image.view, image.camera);
            adjustment.outliers.push(Outlier { view, camera, disc, distance_px: b.distance_px });
        }
    }
    contours.target.shape = nodes(&built.labels);
}

/// Places beside which more images show a disc, off by the same step, than show anything else of them.
fn beside_in_most(
    images: &[SeenImage],
    model: &Model,
    labelled: &[ImageObservations],
    adjustment: &Adjustment,
) -> Vec<(usize, Vec<Beside>)> {
    let mut of_place: BTreeMap<usize, Vec<Beside>> = BTreeMap::new();
    for (k, image) in images.iter().enumerate() {
        for (place, beside) in beside_places(image, k, model, &labelled[k], adjustment) {
            of_place.entry(place).or_default().push(beside);
        }
    }
    let there = |place: usize| labelled.iter().filter(|i| i.discs.iter().any(|d| d.disc == place)).count();
    let most = |(place, all): (usize, Vec<Beside>)| {
        let others = all.len() + there(place);
        let all = same(all, adjustment.state.shape_mm[0]);
        (all.len() >= 2 && 2 * all.len() > others).then_some((place, all))
    };
    of_place.into_iter().filter_map(most).collect()
}

/// Labels between those of a grid that no image has; dots of a two-level plate alternate between its levels.
fn missing(labels: &[DotId], two_levels: bool) -> Vec<DotId> {
    let range = |of: fn(&DotId) -> i32| {
        let ends = labels.iter().map(of).min().zip(labels.iter().map(of).max());
        ends.map_or(0..0, |(low, high)| low..high.saturating_add(1))
    };
    let (columns, rows) = (range(|l| l.column), range(|l| l.row));
    if columns.len().saturating_mul(rows.len()) > PLACES * labels.len() {
        return vec![];
    }
    let odd = |x: i32| x.rem_euclid(2);
    let level = |column: i32, row: i32| match two_levels {
        true => (odd(column) == odd(row)).then_some(odd(column) as u8),
        false => Some(0),
    };
    let seen: BTreeSet<&DotId> = labels.iter().collect();
    let all = columns.flat_map(|column| rows.clone().map(move |row| (column, row)));
    let all = all.filter_map(|(column, row)| Some(DotId { column, row, level: level(column, row)? }));
    all.filter(|l| !seen.contains(l)).collect()
}

/// Discs left over in an image beside places where it shows none, the nearest of each place.
fn beside_places(
    image: &SeenImage,
    number: usize,
    model: &Model,
    labelled: &ImageObservations,
    adjustment: &Adjustment,
) -> BTreeMap<usize, Beside> {
    let mut out: BTreeMap<usize, Beside> = BTreeMap::new();
    if image.left_over.is_empty() {
        return out;
    }
    let taken: BTreeSet<usize> = labelled.discs.iter().map(|d| d.disc).collect();
    let places = predicted_places(model, &adjustment.state, labelled);
    let limit_mm = BESIDE.1 * adjustment.state.shape_mm[0];
    for found in image.left_over.iter().copied() {
        let disc = &image.detection.discs[found];
        let c = Vector2::new(disc.ellipse.center_px.u_px, disc.ellipse.center_px.v_px);
        let off_mm = |p: &PredictedPlace| (p.plane_from_image * (c - p.center_px)).norm();
        let near = places.iter().enumerate().filter(|(j, _)| !taken.contains(j));
        let near = near.filter_map(|(j, p)| p.as_ref().map(|p| (j, p, off_mm(p)))).filter(|(.., off)| *off < limit_mm);
        let Some((place, p, _)) = near.min_by(|a, b| a.2.total_cmp(&b.2)) else { continue };
        let own = ImageObservations { discs: vec![DiscObservation::of(place, disc)], ..labelled.clone() };
        let Some(residual) = residuals(model, &adjustment.state, &own).and_then(|r| r.discs.into_iter().next()) else {
            continue;
        };
        let off_mm = p.plane_from_image * residual.shift_px;
        let alike = residual.growth_px.abs() < ALIKE * disc.ellipse.mean_radius_px() && disc.mark.is_none();
        let nearer = out.get(&place).is_none_or(|b| off_mm.norm() < b.off_mm.norm());
        if alike && nearer && off_mm.norm() < limit_mm {
            out.insert(place, Beside { image: number, found, off_mm, distance_px: residual.distance_px() });
        }
    }
    out
}

/// Most of those that are off by the same step, where that is more than print leaves.
fn same(all: Vec<Beside>, pitch_mm: f64) -> Vec<Beside> {
    let near = |a: &Beside, b: &Beside| (a.off_mm - b.off_mm).norm() < SAME * a.off_mm.norm();
    let most = all.iter().enumerate().filter(|(_, a)| a.off_mm.norm() > BESIDE.0 * pitch_mm);
    let most = most.max_by_key(|(_, a)| all.iter().filter(|b| near(a, b)).count());
    let agree: Vec<bool> = most.map_or(vec![], |(k, _)| all.iter().map(|b| near(&all[k], b)).collect());
    all.into_iter().zip(agree).filter_map(|(b, agrees)| agrees.then_some(b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(column: i32, row: i32, level: u8) -> DotId {
        DotId { column, row, level }
    }

    #[test]
    fn places_between_the_labels_are_those_of_the_kind_of_target() {
        let grid: Vec<DotId> = [(0, 0), (2, 0), (0, 1), (1, 1), (2, 1)].map(|(c, r)| label(c, r, 0)).into();
        assert_eq!(missing(&grid, false), [label(1, 0, 0)]);
        let front = [(0, 0), (2, 0), (4, 0), (0, 2), (4, 2)].map(|(c, r)| label(c, r, 0));
        let back = [(1, 1)].map(|(c, r)| label(c, r, 1));
        let plate: Vec<DotId> = front.into_iter().chain(back).collect();
        assert_eq!(missing(&plate, true), [label(2, 2, 0), label(3, 1, 1)]);
        assert!(missing(&[], false).is_empty());
        // Labels far apart are no grid that says where its dots are.
        assert!(missing(&[label(0, 0, 0), label(i32::MAX, 3, 0)], false).is_empty());
    }

    #[test]
    fn a_step_is_the_same_in_most_images_or_none() {
        let off = |(x, y): (f64, f64)| Beside { image: 0, found: 0, off_mm: Vector2::new(x, y), distance_px: 0.0 };
        let agree = |steps: &[(f64, f64)]| same(steps.iter().copied().map(off).collect(), 1.0).len();
        assert_eq!(agree(&[(0.02, 0.0), (0.022, 0.003), (0.019, -0.002)]), 3);
        assert_eq!(agree(&[(0.02, 0.0), (0.022, 0.003), (-0.04, 0.1)]), 2);
        assert_eq!(agree(&[(0.02, 0.0), (-0.02, 0.0), (0.0, 0.02)]), 1);
        assert_eq!(agree(&[(0.004, 0.0), (0.004, 0.0)]), 0);
        assert_eq!(agree(&[]), 0);
    }
}
