//! What errors of the calibration do to the light's plane.
//!
//! The plane (a, b, c) is a function of the matched raw pixels, which scatter (S), and of the cameras, whose numbers p have the
//! covariance P. The sheet that was started from moves with its own numbers q, which are correlated with p:
//! ```text
//! J     = d(a, b, c)/dp      matches and weights held, the cameras moved by central differences
//! C     = J P J^T + S        covariance of the plane in the rig frame
//! e     = offset and tilts of the light against the starting sheet
//! C_e   = G_p P_pp G_p^T + G_p P_pq G_q^T + ... + G S G^T,   G = de/d(a, b, c),   G_p = G J,   G_q = de/dq
//! steps of the new sheet = T (a, b, c) + S q,   T = A Ad tilt;   their covariance with any number x of the calibration: T J P_px + S P_qx
//! ```
//!
//! | symbol | identifier | shape | meaning |
//! |---|---|---|---|
//! | J | `by_number` | 3 x n | plane by the numbers of both cameras and the motion between them |
//! | G, G_q | `by_plane`, `by_start` | 3 x 3, 3 x 6 | offset (mm) and tilts (rad) by the plane and by the starting sheet |
//! | T, S | `step_by_plane`, `step_by_start` | 6 x 3, 6 x 6 | left step of the sheet's frame by the plane and by the frame that was started from |
//! | A, Ad, tilt | [`frame_by`], `adjoint`, [`tilted`] | 6 x 6, 6 x 6, 6 x 3 | left step of the frame by one of a pose in its plane; left step of the pose by one in itself; that by the plane |
//!
//! Source: method section 5 (sigmas with the cameras held are too small). Not valid along directions that the calibration leaves
//! undetermined: then there is no covariance of the plane.

use super::plane::{Match, PlaneFit, see, weighted_plane};
use crate::bundle::{Parameter, ParameterSteps, SHEET};
use crate::dewarp::SheetMap;
use crate::frames::{Cam, Rig, Sheet};
use crate::record::{Covariance, Record};
use crate::rigid::Motion;
use crate::sheet::{Placement, by_steps, determines_measurements, on_plane_of, standing_on, step_rows, with_sheet};
use nalgebra::{DMatrix, Dyn, Matrix3, Matrix6, Matrix6x3, OMatrix, SMatrix, SVector, U6, Vector3};

/// Covariances with the calibration's share in them.
pub(super) struct Propagated {
    /// Of (a, b, c) and the second projection centre in the rig frame.
    pub(super) plane_and_center: Matrix6<f64>,
    /// Of offset (mm) and tilts about x and y (rad) against the starting sheet.
    pub(super) against_start: Matrix3<f64>,
    /// The calibration's covariance with the rows of the new sheet instead of the old.
    pub(super) covariance: Covariance,
}

/// Offset at a point of the starting sheet (mm), and tilts about its x and y (rad), of another sheet.
pub(super) fn against(start: &Motion<Rig, Sheet>, now: &Motion<Rig, Sheet>, reference_mm: [f64; 2]) -> Vector3<f64> {
    let m = start.inverse() * *now;
    let n = m.rotation.column(2);
    let (b, c) = (-n.x / n.z, -n.y / n.z);
    let a = m.translation_mm.z - b * m.translation_mm.x - c * m.translation_mm.y;
    // z rises with y by a turn about x, and falls with x by one about y.
    Vector3::new(a + b * reference_mm[0] + c * reference_mm[1], c.atan(), (-b).atan())
}

/// Derivative of [`against`] by (a, b, c) of the plane in the frame `now`.
pub(super) fn against_by_plane(
    start: &Motion<Rig, Sheet>,
    now: &Motion<Rig, Sheet>,
    reference_mm: [f64; 2],
) -> Matrix3<f64> {
    let steps = Vector3::new(1e-4, 1e-6, 1e-6);
    let mut out = Matrix3::zeros();
    for k in 0..3 {
        let at = |h: f64| {
            let mut abc = Vector3::zeros();
            abc[k] = h;
            against(start, &(*now * Motion::<Sheet, Sheet>::identity().retract(&(tilted() * abc))), reference_mm)
        };
        out.set_column(k, &((at(steps[k]) - at(-steps[k])) / (2.0 * steps[k])));
    }
    out
}

/// Step of a sheet in its own frame by the plane `z = a + b x + c y` that it goes to, to first order.
pub(super) fn tilted() -> Matrix6x3<f64> {
    let mut out = Matrix6x3::zeros();
    (out[(0, 2)], out[(1, 1)], out[(5, 0)]) = (1.0, -1.0, 1.0);
    out
}

pub(super) fn sheet_pose(record: &Record) -> Option<Motion<Rig, Sheet>> {
    record.sheet.as_ref().map(|s| s.rig_from_sheet.motion())
}

/// The numbers that move the cameras, with their rows in the covariance; `None` without two cameras.
pub(super) fn camera_numbers(start: &Record) -> Option<Vec<(usize, Parameter)>> {
    let [first, second] = start.cameras.as_slice() else { return None };
    let of = |n: &String| Parameter::of(n, [first.name.as_str(), second.name.as_str()]);
    let named = start.covariance.names.iter().enumerate().filter_map(|(i, n)| Some((i, of(n)?)));
    Some(named.filter(|(_, p)| !matches!(p, Parameter::Sheet(_))).collect())
}

/// Rows of the starting sheet in the covariance, one per step; `None` where it has none.
pub(super) fn start_rows(start: &Record) -> Option<[usize; 6]> {
    let sheet = start.sheet.as_ref()?;
    let prefix = match (sheet.method.as_str(), sheet.views.as_slice()) {
        ("target plane", [view]) => format!("view{view}.rig_from_target."),
        _ => SHEET.to_string(),
    };
    step_rows(&start.covariance, &prefix)
}

/// Covariances of the plane of `now`, found from `matches`, against the sheet of `start`; `None` where the calibration states no
/// covariance or does not determine what is needed.
pub(super) fn propagate(
    start: &Record,
    now: &Record,
    matches: &[Match],
    fit: &PlaneFit,
    reference_mm: [f64; 2],
) -> Option<Propagated> {
    let numbers = camera_numbers(start)?;
    if numbers.is_empty() || !determines_measurements(start) {
        return None;
    }
    let (pose, start_pose, q) = (sheet_pose(now)?, sheet_pose(start)?, start_rows(start)?);
    let f_px = [0, 1].map(|c| now.cameras[c].f_px);
    let center = now.cameras[1].cam_from_rig.motion::<Cam, Rig>();
    let mut by_number = DMatrix::zeros(3, numbers.len());
    let mut center_by_number = DMatrix::zeros(3, numbers.len());
    for (k, (_, parameter)) in numbers.iter().enumerate() {
        let h = parameter.step(f_px, pose.translation_mm.norm());
        let at = |h: f64| -> Option<Vector3<f64>> {
            let maps = SheetMap::after_steps(now, &ParameterSteps::one(*parameter, h), &pose)?;
            let seen: Option<Vec<_>> = matches.iter().map(|m| see([&maps[0], &maps[1]], m)).collect();
            weighted_plane(&seen?, &fit.weights)
        };
        by_number.set_column(k, &((at(h)? - at(-h)?) / (2.0 * h)));
        if let Parameter::Motion(k_step @ 3..6) = parameter {
            center_by_number.set_column(k, &center.center_by_shift().column(k_step - 3));
        }
    }
    let c = &start.covariance.matrix;
    let among =
        |rows: &[usize], columns: &[usize]| DMatrix::from_fn(rows.len(), columns.len(), |i, j| c[rows[i]][columns[j]]);
    let p: Vec<usize> = numbers.iter().map(|(i, _)| *i).collect();
    let all: Vec<usize> = p.iter().chain(&q).copied().collect();
    let both = among(&all, &all);
    if both.iter().any(|v| !v.is_finite()) {
        return None;
    }
    // Plane and second centre by the numbers.
    let by: DMatrix<f64> =
        DMatrix::from_fn(6, p.len(), |i, k| if i < 3 { by_number[(i, k)] } else { center_by_number[(i - 3, k)] });
    let shared = &by * among(&p, &p) * by.transpose();
    let mut plane_and_center = Matrix6::from_fn(|i, j| shared[(i, j)]);
    for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
        plane_and_center[(i, j)] += fit.covariance[(i, j)];
    }
    let by_plane = against_by_plane(&start_pose, &pose, reference_mm);
    let by_start = against_by_start(&start_pose, &pose, reference_mm);
    let by_p = by_plane * &by_number;
    let gradient =
        DMatrix::from_fn(3, all.len(), |i, k| if k < p.len() { by_p[(i, k)] } else { by_start[(i, k - p.len())] });
    let known = &gradient * both * gradient.transpose();
    let against_start = Matrix3::from_fn(|i, j| known[(i, j)]) + by_plane * fit.covariance * by_plane.transpose();
    let [by_pose, step_by_start] = frame_by(&Placement::of_frame(&start_pose), &start_pose, &pose);
    let step_by_plane = by_pose * pose.adjoint() * tilted();
    let steps = DMatrix::from_fn(6, all.len(), |i, k| match k.checked_sub(p.len()) {
        None => (step_by_plane * by_number.column(k))[i],
        Some(k) => step_by_start[(i, k)],
    });
    let own = &steps * among(&all, &all) * steps.transpose();
    let own = Matrix6::from_fn(|i, j| own[(i, j)]) + step_by_plane * fit.covariance * step_by_plane.transpose();
    let covariance =
        with_sheet(&start.covariance, &all, &OMatrix::<f64, U6, Dyn>::from_fn(all.len(), |i, k| steps[(i, k)]), &own);
    Some(Propagated { plane_and_center, against_start, covariance })
}

/// Where a sheet's frame stands whose start was placed as `kind` says ([`Placement::of_frame`]), with the start here: its origin and its x axis over the start's,
/// laid into the plane along the normal; what `kind` leaves to the first camera's axis and x stays with them.
pub(super) fn over(kind: &Placement, start: &Motion<Rig, Sheet>) -> Placement {
    let stands = standing_on(start);
    Placement {
        origin_in_rig_mm: stands.origin_in_rig_mm.filter(|_| kind.origin_in_rig_mm.is_some()),
        x_in_rig: stands.x_in_rig.filter(|_| kind.x_in_rig.is_some()),
        flip_x: false,
    }
}

/// Left steps of that frame, A by left steps of a pose in its plane, of which the plane alone counts, and S by left steps of the start.
pub(super) fn frame_by(kind: &Placement, start: &Motion<Rig, Sheet>, pose: &Motion<Rig, Sheet>) -> [Matrix6<f64>; 2] {
    let by_plane = by_steps(|step| on_plane_of(&pose.retract(step), &over(kind, start)));
    [by_plane, by_steps(|step| on_plane_of(pose, &over(kind, &start.retract(step))))]
}

/// Derivative of [`against`] by left steps of the starting sheet.
pub(super) fn against_by_start(
    start: &Motion<Rig, Sheet>,
    now: &Motion<Rig, Sheet>,
    reference_mm: [f64; 2],
) -> SMatrix<f64, 3, 6> {
    by_left_steps(|step| against(&start.retract(step), now, reference_mm))
}

/// Derivative of [`against`] by left steps of the sheet found.
pub(super) fn against_by_sheet(
    start: &Motion<Rig, Sheet>,
    now: &Motion<Rig, Sheet>,
    reference_mm: [f64; 2],
) -> SMatrix<f64, 3, 6> {
    by_left_steps(|step| against(start, &now.retract(step), reference_mm))
}

/// Central differences by a turn (rad) and a shift (mm).
fn by_left_steps(of: impl Fn(&SVector<f64, 6>) -> Vector3<f64>) -> SMatrix<f64, 3, 6> {
    let mut out = SMatrix::<f64, 3, 6>::zeros();
    for k in 0..6 {
        let h = if k < 3 { 1e-7 } else { 1e-4 };
        let at = |h: f64| of(&SVector::<f64, 6>::ith(k, h));
        out.set_column(k, &((at(h) - at(-h)) / (2.0 * h)));
    }
    out
}
