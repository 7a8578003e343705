//! Where the sheet frame stands, in the covariance.
//!
//! The frame follows from the plane and from what places it: the first camera's axis and x, points and directions held in the rig, or the target of views
//! (pose, and lengths where it stands on a disc that is not the target's origin).
//! An adjustment knows the plane, whose steps in itself mean nothing, and what places it:
//! ```text
//! F(s, d) = frame placed on the plane of exp(s) F by poses and lengths after their steps d
//! d log F = J s + K d                      J 6 x 6, K 6 x n by central differences;   rows of the frame = [J K] rows of the steps
//! on disc m = (i L, j L) of a view (R, t):  origin = foot of R m + t,   so that K has R (i, j, 0) laid into the plane in the column of the pitch L
//! ```
//! Left steps of the frame as rows of plane and views are its own standard deviations, and those of what is told in its coordinates: where the axis meets
//! the sheet is known ten times worse than where the sheet lies.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | s | `step` | 6 | rad, mm | left step of the sheet, of which the plane alone counts |
//! | d | `steps` | n | rad, mm | left steps of `rig_from_target` of the views that place the frame, and steps of lengths |
//! | [J K] | `by` | 6 x (6 + n) | mixed | left step of the frame |
//!
//! Source: the conventions of [`super`] and [`crate::rigid`]. Where a row is not determined the old ones stay: the frame is then lost as well.

use super::{Placement, plane_geometry};
use crate::bundle::SHEET;
use crate::frames::{Rig, Sheet};
use crate::record::Covariance;
use crate::rigid::{Motion, STEP_NAMES};
use nalgebra::{DMatrix, Matrix6, SVector};

/// Turn (rad) and shift (mm) of the central differences.
const STEPS: [f64; 2] = [1e-6, 1e-3];

/// How a pose places the frame: its origin and its x axis, laid into the plane along the normal.
pub(crate) fn standing_on<T>(pose: &Motion<Rig, T>) -> Placement {
    let x = pose.rotation.column(0).into_owned();
    Placement { origin_in_rig_mm: Some(pose.translation_mm), x_in_rig: Some(x), flip_x: false }
}

/// Left step of a frame by the six parts of a left step that moves it, central differences.
pub(crate) fn by_steps(frame: impl Fn(&SVector<f64, 6>) -> Motion<Rig, Sheet>) -> Matrix6<f64> {
    let mut out = Matrix6::zeros();
    for k in 0..6 {
        out.set_column(k, &by_one(STEPS[usize::from(k >= 3)], |h| frame(&SVector::ith(k, h))));
    }
    out
}

/// The same by one number.
fn by_one(h: f64, frame: impl Fn(f64) -> Motion<Rig, Sheet>) -> SVector<f64, 6> {
    frame(-h).step_to(&frame(h)) / (2.0 * h)
}

/// The frame on the plane of another one, placed anew.
pub(crate) fn on_plane_of(frame: &Motion<Rig, Sheet>, placement: &Placement) -> Motion<Rig, Sheet> {
    let axis = frame.rotation.column(2).into_owned();
    plane_geometry(axis, axis.dot(&frame.translation_mm), None, placement).estimate.rig_from_sheet
}

/// Six rows of a pose in a covariance; none where one is not there.
pub(crate) fn step_rows(covariance: &Covariance, prefix: &str) -> Option<[usize; 6]> {
    let mut rows = [0; 6];
    for (row, step) in rows.iter_mut().zip(STEP_NAMES) {
        *row = covariance.index(&format!("{prefix}{step}"))?;
    }
    Some(rows)
}

/// The same; none where one is not determined.
pub(crate) fn pose_rows(covariance: &Covariance, prefix: &str) -> Option<[usize; 6]> {
    step_rows(covariance, prefix).filter(|rows| rows.iter().all(|i| covariance.determines(*i)))
}

/// A covariance whose rows of the sheet, now those of its plane with any steps in itself, become those of the frame: `from` are the rows of the numbers
/// that place it, and `placement` says how they do after steps of theirs, in their order. None where a row is not there or not determined.
pub(crate) fn with_frame(
    covariance: &Covariance,
    frame: &Motion<Rig, Sheet>,
    from: &[usize],
    placement: impl Fn(&[f64]) -> Placement,
) -> Option<Covariance> {
    let sheet = pose_rows(covariance, SHEET)?;
    let still = vec![0.0; from.len()];
    let mut by = DMatrix::zeros(6, 6 + from.len());
    let here = placement(&still);
    by.columns_mut(0, 6).copy_from(&by_steps(|step| on_plane_of(&frame.retract(step), &here)));
    for (k, row) in from.iter().enumerate() {
        let h = STEPS[usize::from(!covariance.names.get(*row)?.ends_with("_rad"))];
        let moved = by_one(h, |h| {
            let mut steps = still.clone();
            steps[k] = h;
            on_plane_of(frame, &placement(&steps))
        });
        by.set_column(6 + k, &moved);
    }
    let all: Vec<usize> = sheet.iter().chain(from).copied().collect();
    let lost = from.iter().any(|i| !covariance.determines(*i));
    (!lost).then(|| covariance.with_rows(&sheet, &all, &by))
}

/// [`with_frame`] of a frame that stands where the first camera's axis meets the sheet, its x axis held in the rig; others stay.
pub(crate) fn with_frame_on_axis(covariance: Covariance, frame: &Motion<Rig, Sheet>) -> Covariance {
    let placement = Placement::of_frame(frame);
    if placement.origin_in_rig_mm.is_some() {
        return covariance;
    }
    with_frame(&covariance, frame, &[], |_| placement).unwrap_or(covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A plane known to 0.1 mm and 0.2 mrad, and a view that stands on it, known to 0.01 mm and 0.1 mrad against the rig.
    fn known(prefixes: [&str; 2]) -> Covariance {
        let names: Vec<String> =
            prefixes.iter().flat_map(|p| STEP_NAMES.map(|s| format!("{p}{s}"))).chain(["left.f_px".into()]).collect();
        let l = |i: usize, j: usize| {
            let size = if i == 12 {
                3.0
            } else if i % 6 < 3 {
                2e-4
            } else {
                0.1
            };
            size * (((i * 7 + j * 13) % 11) as f64 / 11.0 - 0.4) * if i < j { 0.0 } else { 1.0 }
        };
        let matrix = (0..13).map(|i| (0..13).map(|j| (0..13).map(|k| l(i, k) * l(j, k)).sum()).collect()).collect();
        Covariance { names, matrix, undetermined: vec![], null_directions: vec![] }
    }

    fn variance(c: &Covariance, row: &[(usize, f64)]) -> f64 {
        row.iter().flat_map(|(i, x)| row.iter().map(move |(j, y)| x * y * c.matrix[*i][*j])).sum()
    }

    /// The origin stays on the axis whatever the plane does, and the plane is known as it was.
    #[test]
    fn the_default_frame_keeps_its_origin_on_the_axis() {
        let c = known([SHEET, "view3.rig_from_target."]);
        let n = Vector3::new(0.6, -0.1, 0.79).normalize();
        let frame = plane_geometry(n, 400.0, None, &Placement::default()).estimate.rig_from_sheet;
        let out = with_frame_on_axis(c.clone(), &frame);
        let t = frame.translation_mm;
        // The origin moves by v + w x t: along x by w_y t_z, along y by -w_x t_z.
        for row in [[(3, 1.0), (1, t.z)], [(4, 1.0), (0, -t.z)]] {
            assert!(variance(&out, &row).abs() < 1e-9 * variance(&c, &row), "{}", variance(&out, &row));
        }
        // n . v and the turn about directions of the plane.
        let plane = [
            (3..6).map(|k| (k, n[k - 3])).collect::<Vec<_>>(),
            (0..3).map(|k| (k, frame.rotation[(k, 0)])).collect(),
            (0..3).map(|k| (k, frame.rotation[(k, 1)])).collect(),
        ];
        for row in plane {
            let (a, b) = (variance(&out, &row), variance(&c, &row));
            assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
            // And with the cameras as it was.
            let with = |c: &Covariance| row.iter().map(|(i, x)| x * c.matrix[*i][12]).sum::<f64>();
            assert!((with(&out) / with(&c) - 1.0).abs() < 1e-6);
        }
        assert_eq!(out.matrix[7][8], c.matrix[7][8]);
        assert_eq!(out.names, c.names);
    }

    /// A frame on a mark of a view moves with it: the mark stays at the origin, but for the way along the normal.
    #[test]
    fn a_frame_on_a_mark_moves_with_its_view() {
        let c = known([SHEET, "view3.rig_from_target."]);
        let n = Vector3::new(0.6, -0.1, 0.79).normalize();
        let view: Motion<Rig, Sheet> = plane_geometry(n, 400.0, None, &Placement::default()).estimate.rig_from_sheet;
        let mark = Vector3::new(12.0, -7.0, 0.0);
        let placed = |s: &[f64]| {
            let view = view.retract(&SVector::from_column_slice(s));
            Placement { origin_in_rig_mm: Some(view.apply(&mark)), ..standing_on(&view) }
        };
        let frame = on_plane_of(&view, &placed(&[0.0; 6]));
        let rows = pose_rows(&c, "view3.rig_from_target.").unwrap();
        let out = with_frame(&c, &frame, &rows, placed).unwrap();
        // Of the mark in the frame: rig displacement by the view less that by the frame, along x and y of the frame.
        let p = frame.translation_mm;
        let by = |first: usize, sign: f64, e: &Vector3<f64>| -> Vec<(usize, f64)> {
            let turn = p.cross(e);
            (0..3).flat_map(|k| [(first + k, sign * turn[k]), (first + 3 + k, sign * e[k])]).collect()
        };
        for axis in 0..2 {
            let e = frame.rotation.column(axis).into_owned();
            let row = [by(6, 1.0, &e), by(0, -1.0, &e)].concat();
            assert!(variance(&out, &row).abs() < 1e-8 * variance(&c, &row), "{axis}: {}", variance(&out, &row));
        }
        // Nothing determines the view: nothing is known of the frame.
        let lost = Covariance { undetermined: vec!["view3.rig_from_target.rx_rad".into()], ..c.clone() };
        assert!(
            pose_rows(&lost, "view3.rig_from_target.").is_none() && pose_rows(&c, "view4.rig_from_target.").is_none()
        );
    }
}
