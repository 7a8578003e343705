//! The laser sheet of a calibration: jointly, and by the paper's homography beside it.

use super::calibrate::Solved;
use crate::bundle::DiscObservation;
use crate::camera::Camera;
use crate::error::{Invalid, Result};
use crate::frames::{Rig, Sheet as SheetFrame, Target};
use crate::record::{Covariance, Homography, Sheet};
use crate::rig_file::SheetOrigin;
use crate::rigid::Motion;
use crate::sheet::{
    HeldCameras, PairFeatures, Placement, fit_placed_homography, placed_joint_sheet, pose_rows, transfer_residuals,
    with_frame,
};
use crate::target::DotId;
use nalgebra::{SVector, Vector3};

/// Most pairs of discs per view that the homography looks at: more add nothing but time.
const PAIRS_PER_VIEW: usize = 40;
/// Sine of the angle to the normal below which a direction does not say where the sheet's x axis goes.
const LEAST_X_AXIS: f64 = 0.05;

/// The sheet, or `None` where no view was recorded in it.
pub(super) fn sheet_part(s: &Solved) -> Result<Option<Sheet>> {
    let views: Vec<usize> = s.job.views.iter().enumerate().filter(|(_, v)| v.sheet).map(|(i, _)| i).collect();
    let Some(plane) = s.covariance.natural.rig_from_plane.filter(|_| !views.is_empty()) else {
        return Ok(None);
    };
    let names: Vec<&str> = s.job.cameras.iter().map(|c| c.name.as_str()).collect();
    let placement = placement(s, &plane)?;
    let joint = placed_joint_sheet(s.covariance, &plane, names.get(1).copied(), &placement);
    let mut sheet = joint.to_record("joint", views.clone());
    if let [first, second] = names[..] {
        let held = HeldCameras::of(s.covariance, [first, second]);
        let mut features: Vec<PairFeatures> = views.iter().flat_map(|v| features_of_view(s, &held, *v)).collect();
        if held.on_opposite_sides(&joint.abc_per_mm) {
            features.iter_mut().for_each(|f| *f = f.on_both_sides());
        }
        if !features.is_empty() {
            let all = transfer_residuals(&held, &joint.abc_per_mm, &features);
            let left: Vec<f64> = all.iter().flatten().map(|r| r.norm_squared()).collect();
            sheet.disparity_rms_px = Some((left.iter().sum::<f64>() / left.len().max(1) as f64).sqrt());
            let fitted = fit_placed_homography(&held, &features, &joint.abc_per_mm, &placement);
            sheet.homography = fitted.ok().map(|h| homography_of(&h));
        }
    }
    Ok(Some(sheet))
}

/// The sheet frame, where the rig file places it and a view was recorded in the sheet.
pub(super) fn stated_frame(s: &Solved) -> Result<Option<Motion<Rig, SheetFrame>>> {
    let Some(plane) = s.covariance.natural.rig_from_plane.filter(|_| s.job.sheet != Default::default()) else {
        return Ok(None);
    };
    let second = s.job.cameras.get(1).map(|c| c.name.as_str());
    Ok(Some(placed_joint_sheet(s.covariance, &plane, second, &placement(s, &plane)?).rig_from_sheet))
}

/// Where the rig file places the sheet frame.
fn placement(s: &Solved, plane: &Motion<Rig, SheetFrame>) -> Result<Placement> {
    let wanted = &s.job.sheet;
    let placement = placed_by(s, &|view| s.covariance.natural.rig_from_target[view], [0.0; 3]);
    let normal = plane.rotation.column(2);
    if let (Some(view), Some(x)) = (wanted.x_axis_view, &placement.x_in_rig)
        && x.cross(&normal).norm() < LEAST_X_AXIS
    {
        return Err(Invalid::File {
            path: s.job.file.clone(),
            message: format!(
                "[sheet] x_axis: the target's x axis in view {view} stands upright on the sheet; choose a view in which it lies along it"
            ),
        }
        .into());
    }
    Ok(placement)
}

/// The same with the targets of views where `pose` says, and their lengths longer by some mm.
fn placed_by(s: &Solved, pose: &dyn Fn(usize) -> Motion<Rig, Target>, longer_mm: [f64; 3]) -> Placement {
    let wanted = &s.job.sheet;
    let origin_in_rig_mm = match wanted.origin {
        SheetOrigin::FirstAxis => None,
        SheetOrigin::Point(p) => Some(Vector3::from(p)),
        SheetOrigin::Disc { view, id } => Some(pose(view).apply(&place_on_target(s, view, id, longer_mm))),
    };
    let x_in_rig: Option<Vector3<f64>> = wanted.x_axis_view.map(|v| pose(v).rotation.column(0).into_owned());
    Placement { origin_in_rig_mm, x_in_rig, flip_x: wanted.flip_x }
}

/// The covariance with rows of the sheet that are those of its frame, as the rig file places it: it moves with the views that place it, and a disc with the
/// lengths of the target (where discs are adjusted one by one, what is left of its own place is held). Where one of these is not determined they stay those of
/// the plane.
pub(super) fn of_frame(s: &Solved, covariance: Covariance, frame: &Motion<Rig, SheetFrame>) -> Covariance {
    let disc = match s.job.sheet.origin {
        SheetOrigin::Disc { view, id } => Some((view, id)),
        SheetOrigin::FirstAxis | SheetOrigin::Point(_) => None,
    };
    let mut views: Vec<usize> = disc.map(|(view, _)| view).into_iter().chain(s.job.sheet.x_axis_view).collect();
    views.dedup();
    let lengths = disc.map_or_else(Vec::new, |(view, id)| lengths_of_place(s, &covariance, view, id));
    let rows: Option<Vec<[usize; 6]>> =
        views.iter().map(|v| pose_rows(&covariance, &format!("view{v}.rig_from_target."))).collect();
    let placement = |steps: &[f64]| {
        let (poses, longer) = steps.split_at(6 * views.len());
        let mut longer_mm = [0.0; 3];
        lengths.iter().zip(longer).for_each(|((k, _), d)| longer_mm[*k] = *d);
        let pose = |view: usize| {
            let pose = s.covariance.natural.rig_from_target[view];
            let step = |k: usize| SVector::from_column_slice(&poses[6 * k..6 * (k + 1)]);
            views.iter().position(|v| *v == view).map_or(pose, |k| pose.retract(&step(k)))
        };
        placed_by(s, &pose, longer_mm)
    };
    let from = rows.map(|r| r.into_iter().flatten().chain(lengths.iter().map(|(_, row)| *row)).collect::<Vec<usize>>());
    from.and_then(|from| with_frame(&covariance, frame, &from, placement)).unwrap_or(covariance)
}

/// The lengths of the target that move a disc on it in a view: their places in the shape, and their rows in a covariance. What is held has none.
fn lengths_of_place(s: &Solved, covariance: &Covariance, view: usize, id: DotId) -> Vec<(usize, usize)> {
    let owner = if s.adjustment.model.target.per_view() { format!("view{view}") } else { "target".into() };
    let place = |k: usize, longer: f64| {
        place_on_target(s, view, id, std::array::from_fn(|j| if j == k { longer } else { 0.0 }))
    };
    let moves = |k: usize| place(k, 1.0) != place(k, 0.0);
    let named = |(k, q): (usize, &str)| Some((k, covariance.index(&format!("{owner}.{q}"))?));
    [(0, "spacing_mm"), (2, "step_mm")].into_iter().filter(|(k, _)| moves(*k)).filter_map(named).collect()
}

/// Place of a disc or mark of the target in the target's frame, mm, in a view, with lengths longer by some mm.
fn place_on_target(s: &Solved, view: usize, id: DotId, longer_mm: [f64; 3]) -> Vector3<f64> {
    let (model, state) = (&s.adjustment.model.target, &s.adjustment.state);
    let own = if model.per_view() { state.views[view].shape_mm } else { state.shape_mm };
    let shape: [f64; 3] = std::array::from_fn(|k| own[k] + longer_mm[k]);
    if let Some(j) = s.built.labels.iter().position(|l| *l == id) {
        let offset = state.offsets_mm.get(j).map_or_else(Vector3::zeros, |o| Vector3::new(o[0], o[1], o[2]));
        return model.nominal_disc(j, &shape).0 + offset;
    }
    // A mark that is no disc, or a dot that no image shows.
    let node = super::model::node(&s.job.target.target, &id);
    Vector3::new(node.x * shape[0], node.y * shape[0], -node.level * shape[2])
}

/// The paper's result as the record holds it.
pub(super) fn homography_of(h: &crate::sheet::Homography) -> Homography {
    Homography {
        abc_per_mm: h.estimate.abc_per_mm.into(),
        distance_mm: h.estimate.distance_mm,
        angles_deg: h.estimate.angles_rad.map(f64::to_degrees),
        angle_to_baseline_deg: h.estimate.angle_to_baseline_rad.to_degrees(),
        sigma: h.estimate.record_sigma(),
        transfer_rms_px: h.transfer_rms_px,
    }
}

fn features_of_view(s: &Solved, held: &HeldCameras, view: usize) -> Vec<PairFeatures> {
    let image = |camera: usize| s.contours.images.iter().find(|i| i.view == view && i.camera == camera);
    let (Some(first), Some(second)) = (image(0), image(1)) else { return vec![] };
    let seen = [first, second].map(|i| i.discs.iter().map(|d| (s.built.labels[d.disc], d)).collect::<Vec<_>>());
    let scales = [first, second].map(|image| image.sigma_scale);
    common_features(held.cameras(), [&seen[0], &seen[1]]).into_iter().map(|pair| pair.scaled(scales)).collect()
}

/// Tangency points of neighbouring discs that both cameras saw in a view, each disc in one pair alone; of a two-level plate those of the
/// front level, which alone lies in the plane.
pub(super) fn common_features(cameras: [&Camera; 2], seen: [&[(DotId, &DiscObservation)]; 2]) -> Vec<PairFeatures> {
    let contour = |c: usize, id: DotId| seen[c].iter().find(|(other, _)| *other == id).map(|(_, contour)| *contour);
    let mut common: Vec<DotId> =
        seen[0].iter().map(|(id, _)| *id).filter(|id| id.level == 0 && contour(1, *id).is_some()).collect();
    common.sort_unstable();
    let pair = |p: &[DotId; 2]| {
        let both = |c: usize| Some([contour(c, p[0])?, contour(c, p[1])?]);
        PairFeatures::of(cameras, [both(0)?, both(1)?])
    };
    let pairs = in_pairs(&common);
    pairs.iter().step_by(pairs.len().div_ceil(PAIRS_PER_VIEW).max(1)).filter_map(pair).collect()
}

/// Neighbours of one column or row, each in one pair alone; discs sorted column by column.
fn in_pairs(discs: &[DotId]) -> Vec<[DotId; 2]> {
    let (mut out, mut rest) = (vec![], discs);
    while let [a, b, beyond @ ..] = rest {
        let together = a.column == b.column || a.row == b.row;
        rest = if together { beyond } else { &rest[1..] };
        out.extend(together.then_some([*a, *b]));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns of three dots: the third of each has no neighbour left, and is no pair with the first of the next.
    #[test]
    fn no_pair_reaches_across_the_field() {
        let id = |column, row| DotId { column, row, level: 0 };
        let grid: Vec<DotId> = (0..4).flat_map(|c| (0..3).map(move |r| id(c, r))).collect();
        assert_eq!(in_pairs(&grid), (0..4).map(|c| [id(c, 0), id(c, 1)]).collect::<Vec<_>>());
        assert_eq!(in_pairs(&[id(0, 0), id(1, 0)]), [[id(0, 0), id(1, 0)]], "two discs are one row");
        assert!(in_pairs(&[id(0, 2), id(1, 0)]).is_empty() && in_pairs(&grid[..1]).is_empty());
    }
}
