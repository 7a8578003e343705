//! The sheet as the common plane of the joint adjustment.

use super::{Placement, SheetEstimate, plane_geometry, sigmas};
use crate::bundle::{NamedCovariance, SHEET};
use crate::frames::{Rig, Sheet};
use crate::rigid::{Motion, STEP_NAMES};
use nalgebra::{DMatrix, SMatrix, Vector3};

/// The common plane with its standard deviations, all correlations with the cameras included; `second` is the name of
/// the second camera. A number that nothing determines has the sigma `NaN`; the angle to the baseline may be known where the
/// plane's angles in the lens frame are not.
pub fn joint_sheet(covariance: &NamedCovariance, plane: &Motion<Rig, Sheet>, second: Option<&str>) -> SheetEstimate {
    placed_joint_sheet(covariance, plane, second, &Placement::default())
}

/// [`joint_sheet`] with the sheet frame where `placement` says.
pub fn placed_joint_sheet(
    covariance: &NamedCovariance,
    plane: &Motion<Rig, Sheet>,
    second: Option<&str>,
    placement: &Placement,
) -> SheetEstimate {
    let axis: Vector3<f64> = plane.rotation.column(2).into_owned();
    let along = axis.dot(&plane.translation_mm);
    let cam = covariance.natural.cam_from_rig.get(1).filter(|_| second.is_some());
    let center = cam.map(|m| m.inverse().translation_mm);
    let geometry = plane_geometry(axis, along, center, placement);
    let n = geometry.estimate.normal;
    // Seven numbers (w, n . v, centre) by the named steps of plane and camera.
    let mut rows: Vec<Vec<(String, f64)>> = (0..3).map(|k| vec![(sheet_step(k), 1.0)]).collect();
    rows.push((0..3).map(|k| (sheet_step(3 + k), n[k])).collect());
    for k in 0..3 {
        let terms = cam.zip(second).map(|(m, name)| {
            let by = m.center_by_shift();
            (0..3).map(|j| (format!("{name}.cam_from_rig.{}", STEP_NAMES[3 + j]), by[(k, j)])).collect()
        });
        rows.push(terms.unwrap_or_default());
    }
    let seven: DMatrix<f64> = covariance.propagate(&rows);
    let seven = SMatrix::<f64, 7, 7>::from_fn(|i, j| seven[(i, j)]);
    let all = geometry.derivative * seven * geometry.derivative.transpose();
    let mut estimate = geometry.estimate;
    estimate.sigmas = sigmas(&all);
    for q in 0..SheetEstimate::QUANTITIES {
        let part = |(j, terms): (usize, &Vec<(String, f64)>)| -> Vec<(String, f64)> {
            terms.iter().map(|(n, c)| (n.clone(), geometry.derivative[(q, j)] * c)).collect()
        };
        let row: Vec<(String, f64)> = rows.iter().enumerate().flat_map(part).collect();
        if !covariance.is_determined(&row) {
            estimate.sigmas[q] = f64::NAN;
        }
    }
    estimate
}

fn sheet_step(k: usize) -> String {
    format!("{SHEET}{}", STEP_NAMES[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every reported number against central differences of a turned and shifted plane and a moved centre.
    #[test]
    fn derivatives_are_those_of_the_numbers() {
        let n0 = Vector3::new(0.5, -0.1, 0.8).normalize();
        let (d0, c0) = (400.0, Vector3::new(600.0, 20.0, 90.0));
        let placed =
            Placement { origin_in_rig_mm: Some(c0), x_in_rig: Some(Vector3::new(0.3, 0.8, 0.4)), flip_x: true };
        for placement in [Placement::default(), placed, Placement { flip_x: true, ..Placement::default() }] {
            let numbers = |n: Vector3<f64>, d: f64, c: Vector3<f64>| {
                let e = plane_geometry(n, d, Some(c), &placement).estimate;
                let mut v = nalgebra::SVector::<f64, 10>::zeros();
                v[0] = e.distance_mm;
                v.fixed_rows_mut::<3>(3).copy_from(&e.abc_per_mm);
                v.fixed_rows_mut::<3>(6).copy_from_slice(&e.angles_rad);
                v[9] = e.angle_to_baseline_rad;
                v
            };
            let derivative = plane_geometry(n0, d0, Some(c0), &placement).derivative;
            for col in 0..7 {
                let at = |h: f64| {
                    // Turns within the sheet: one about its normal changes nothing but a frame that hangs on it.
                    let mut w = Vector3::zeros();
                    let (mut d, mut c) = (d0, c0);
                    match col {
                        0..3 => w[col] = h,
                        3 => d += h,
                        _ => c[col - 4] += h,
                    }
                    numbers(crate::rigid::rotation_exp(&w) * n0, d, c)
                };
                let h = 1e-5;
                let numeric = (at(h) - at(-h)) / (2.0 * h);
                for row in [0, 3, 4, 5, 6, 7, 8, 9] {
                    let (a, b) = (numeric[row], derivative[(row, col)]);
                    assert!((a - b).abs() < 1e-6 * (1.0 + b.abs()), "quantity {row} by {col}: {a} {b}");
                }
            }
        }
    }

    /// The frame is right-handed in the plane, its z towards the camera, and the three angles rebuild it.
    #[test]
    fn a_placed_frame_is_what_was_asked_for() {
        let n = Vector3::new(0.5, -0.1, 0.8).normalize();
        let (p, x) = (Vector3::new(20.0, -7.0, 480.0), Vector3::new(0.1, 0.9, 0.2));
        for flip_x in [false, true] {
            let placement = Placement { origin_in_rig_mm: Some(p), x_in_rig: Some(x), flip_x };
            let e = plane_geometry(n, 400.0, None, &placement).estimate;
            let (r, t) = (e.rig_from_sheet.rotation, e.rig_from_sheet.translation_mm);
            assert!((r.determinant() - 1.0).abs() < 1e-12 && (r.column(2) + n).norm() < 1e-12);
            assert!((n.dot(&t) - 400.0).abs() < 1e-9 && n.cross(&(p - t)).norm() < 1e-9, "the foot of the point");
            let along = r.column(0).dot(&x);
            assert!(if flip_x { along < 0.0 } else { along > 0.0 }, "{along}");
            assert!(r.column(1).dot(&x).abs() < 1e-12, "x follows the direction");
            let turn = |axis: Vector3<f64>, k: usize| crate::rigid::rotation_exp(&(axis * e.angles_rad[k]));
            let half = nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
            let rebuilt = turn(Vector3::x(), 0) * turn(Vector3::y(), 1) * turn(Vector3::z(), 2) * half;
            assert!((rebuilt - r).norm() < 1e-12, "{rebuilt} {r}");
        }
    }
}
