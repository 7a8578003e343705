//! The laser sheet of a calibration: jointly, and by the paper's homography beside it.

use super::calibrate::Solved;
use crate::bundle::ImageObservations;
use crate::detect::EdgePoints;
use crate::error::Result;
use crate::record::{Homography, Pose, Sheet, SheetSigma};
use crate::sheet::{PairFeatures, SheetEstimate, fit_homography, joint_sheet, transfer_residuals};

/// Most pairs of discs per view that the homography looks at: more add nothing but time.
const PAIRS_PER_VIEW: usize = 40;

/// The sheet, or `None` where no view was recorded in it.
pub(super) fn sheet_part(s: &Solved) -> Result<Option<Sheet>> {
    let views: Vec<usize> = s.job.views.iter().enumerate().filter(|(_, v)| v.sheet).map(|(i, _)| i).collect();
    let Some(plane) = s.covariance.natural.rig_from_plane.filter(|_| !views.is_empty()) else {
        return Ok(None);
    };
    let names: Vec<&str> = s.job.cameras.iter().map(|c| c.name.as_str()).collect();
    let joint = joint_sheet(s.covariance, &plane, names.get(1).copied());
    let mut sheet = Sheet {
        normal_in_rig: joint.normal.into(),
        distance_mm: joint.distance_mm,
        abc_per_mm: joint.abc_per_mm.into(),
        angles_deg: joint.angles_rad.map(f64::to_degrees),
        angles_convention: crate::record::ANGLES_CONVENTION.into(),
        angle_to_baseline_deg: joint.angle_to_baseline_rad.to_degrees(),
        sigma: sheet_sigma(&joint),
        rig_from_sheet: Pose::from(&joint.rig_from_sheet),
        method: "joint".into(),
        views: views.clone(),
        disparity_rms_px: None,
        homography: None,
    };
    if let [first, second] = names[..] {
        let features: Vec<PairFeatures> = views.iter().flat_map(|v| features_of_view(s, *v)).collect();
        if !features.is_empty() {
            let left = transfer_residuals(s.covariance, &joint.abc_per_mm, &features);
            let squares: f64 = left.iter().map(|r| r.norm_squared()).sum();
            sheet.disparity_rms_px = Some((squares / left.len().max(1) as f64).sqrt());
            sheet.homography =
                fit_homography(s.covariance, [first, second], &features, &joint.abc_per_mm).ok().map(|h| Homography {
                    abc_per_mm: h.estimate.abc_per_mm.into(),
                    distance_mm: h.estimate.distance_mm,
                    angles_deg: h.estimate.angles_rad.map(f64::to_degrees),
                    angle_to_baseline_deg: h.estimate.angle_to_baseline_rad.to_degrees(),
                    sigma: sheet_sigma(&h.estimate),
                    transfer_rms_px: h.transfer_rms_px,
                });
        }
    }
    Ok(Some(sheet))
}

/// Sigmas of a plane in the units of the file.
pub(super) fn sheet_sigma(e: &SheetEstimate) -> SheetSigma {
    let s = &e.sigmas;
    SheetSigma {
        distance_mm: s[0],
        normal_rad: [s[1], s[2]],
        abc_per_mm: [s[3], s[4], s[5]],
        angles_deg: [s[6], s[7], s[8]].map(f64::to_degrees),
        angle_to_baseline_deg: s[9].to_degrees(),
    }
}

/// Tangency points of neighbouring discs that both cameras saw in a view.
fn features_of_view(s: &Solved, view: usize) -> Vec<PairFeatures> {
    let image = |camera: usize| s.contours.images.iter().find(|i| i.view == view && i.camera == camera);
    let (Some(first), Some(second)) = (image(0), image(1)) else { return vec![] };
    let contour = |i: &ImageObservations, disc: usize| -> Option<EdgePoints> {
        i.discs.iter().find(|d| d.disc == disc).map(|d| d.edge.clone())
    };
    let mut common: Vec<usize> = first.discs.iter().map(|d| d.disc).collect();
    common.retain(|d| second.discs.iter().any(|e| e.disc == *d));
    common.sort_unstable();
    let cameras = &s.covariance.natural.cameras;
    let step = (common.len() / PAIRS_PER_VIEW).max(1);
    let pair = |p: &[usize]| {
        let (a, b) = (p[0], p[1]);
        let same_level = s.built.labels[a].level == s.built.labels[b].level;
        let left = [contour(first, a)?, contour(first, b)?];
        let right = [contour(second, a)?, contour(second, b)?];
        let contours = [[&left[0], &left[1]], [&right[0], &right[1]]];
        if same_level { PairFeatures::of([&cameras[0], &cameras[1]], contours) } else { None }
    };
    common.windows(2).step_by(step).filter_map(pair).collect()
}
