//! A calibration whose sheet frame stands elsewhere in the same plane.
//!
//! Only the frame moves: plane and cameras stay as they are, and so do the covariance's left steps of the sheet against the rig where the new frame hangs
//! on the old one. One that stands on the target of a view moves with it ([`placed_at_view`]). What is told along the axes of the frame is told along the new ones, with sigmas from those steps (w, v):
//! ```text
//! (a, b, c) of a step = L^T Ad^-1 (w, v)     Ad adjoint of rig_from_sheet; L: b is a turn about -y, c about x, a a shift along z
//! ```
//!
//! | symbol | identifier | shape | meaning |
//! |---|---|---|---|
//! | L^T Ad^-1 | `plane_by_step` | 3 x 6 | plane z = a + b x + c y in the new frame by a left step |
//!
//! Source: the conventions of `rigid` and `sheet`. Not for frames turned round, whose z would point away from the first camera (refused).

use crate::dewarp::Placement;
use crate::diagnosis::mapping_of_record;
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::record::Record;
use crate::rigid::{Motion, STEP_NAMES};
use crate::sheet::{SheetEstimate, pose_rows, standing_on, with_frame};
use nalgebra::{DMatrix, Matrix6, SMatrix, SVector, Vector3};

/// Covariance of (a, b, c) in a frame of the sheet and of the second projection centre; `NaN` where the record does not state it.
fn plane_and_center(record: &Record, frame: &Motion<Rig, Sheet>) -> Matrix6<f64> {
    let unknown = Matrix6::repeat(f64::NAN);
    let c = &record.covariance;
    let Some(inverse) = frame.adjoint().try_inverse() else { return unknown };
    let mut plane_by_step = SMatrix::<f64, 3, 6>::zeros();
    plane_by_step.row_mut(0).copy_from(&inverse.row(5));
    plane_by_step.row_mut(1).copy_from(&-inverse.row(1));
    plane_by_step.row_mut(2).copy_from(&inverse.row(0));
    let second = record.cameras.get(1);
    let mut names: Vec<String> = STEP_NAMES.map(|s| format!("sheet.rig_from_sheet.{s}")).to_vec();
    names.extend(second.iter().flat_map(|s| STEP_NAMES[3..].iter().map(|n| format!("{}.cam_from_rig.{n}", s.name))));
    let rows: Option<Vec<usize>> = names.iter().map(|n| c.index(n)).collect();
    let Some(rows) = rows.filter(|r| r.len() == 9) else { return unknown };
    let center = second.map(|s| s.cam_from_rig.motion::<Cam, Rig>().center_by_shift()).unwrap_or_default();
    let by = DMatrix::from_fn(6, 9, |i, j| match (i < 3, j < 6) {
        (true, true) => plane_by_step[(i, j)],
        (false, false) => center[(i - 3, j - 6)],
        _ => 0.0,
    });
    let known = DMatrix::from_fn(9, 9, |i, j| c.matrix[rows[i]][rows[j]]);
    let out = &by * known * by.transpose();
    Matrix6::from_fn(|i, j| out[(i, j)])
}

/// The calibration with its sheet frame at another place.
///
/// # Errors
/// [`Invalid`] where there is no sheet, or the frame is to be turned round.
pub fn placed(record: &Record, placement: &Placement) -> Result<Record> {
    let Some(old) = &record.sheet else {
        let what = "the calibration has no laser sheet, so there is no frame to place; record a view in the sheet (sheet = true) or run \
                    spivcal check --refine first";
        return Err(Invalid::Contradiction(what.into()).into());
    };
    if placement.turned_round {
        let what = "z of the sheet points towards the first camera; to have it point away, name the cameras in the other order";
        return Err(Invalid::Contradiction(what.into()).into());
    }
    let frame = old.rig_from_sheet.motion::<Rig, Sheet>() * placement.sheet_from_placed();
    let center = record.cameras.get(1).map(|c| c.cam_from_rig.motion::<Cam, Rig>().inverse().translation_mm);
    let covariance = plane_and_center(record, &frame);
    let estimate = SheetEstimate::from_plane(&frame, &Vector3::zeros(), &covariance, center);
    let mut sheet = estimate.to_record(&old.method, old.views.clone());
    // What does not hang on the axes is known as it was.
    let (new, was) = (&mut sheet.sigma, &old.sigma);
    (new.distance_mm, new.abc_per_mm) = (was.distance_mm, was.abc_per_mm);
    new.angle_to_baseline_deg = was.angle_to_baseline_deg;
    new.angles_deg = [was.angles_deg[0], was.angles_deg[1], new.angles_deg[2]];
    sheet.disparity_rms_px = old.disparity_rms_px;
    let turned = placement.angle_rad != 0.0;
    if !turned {
        (new.normal_rad, new.angles_deg[2]) = (was.normal_rad, was.angles_deg[2]);
        sheet.homography = old.homography.clone();
    }
    let mut out = record.clone();
    out.sheet = Some(sheet);
    // What was told at points of the former frame and along its axes is told anew.
    let told = record.told_of_mapping();
    let told = if turned { told.turned() } else { told };
    out.mapping_uncertainty = record.mapping_uncertainty.as_ref().and_then(|_| Some(mapping_of_record(&out, told)?.0));
    Ok(out)
}

/// The calibration with its sheet frame on the target of a view: its origin and x axis, laid into the sheet along the normal.
///
/// # Errors
/// As [`Placement::at_view`] and [`placed`].
pub fn placed_at_view(record: &Record, view: usize) -> Result<Record> {
    let mut out = placed(record, &Placement::at_view(record, view)?)?;
    let pose = record.views.iter().find(|v| v.index == view).and_then(|v| v.rig_from_target);
    let rows = pose_rows(&out.covariance, &format!("view{view}.rig_from_target."));
    if let (Some(pose), Some(rows), Some(placed)) = (pose, rows, &out.sheet) {
        let stands =
            |step: &[f64]| standing_on(&pose.motion::<Rig, Target>().retract(&SVector::from_column_slice(step)));
        if let Some(covariance) = with_frame(&out.covariance, &placed.rig_from_sheet.motion(), &rows, stands) {
            out.covariance = covariance;
        }
    }
    Ok(out)
}
