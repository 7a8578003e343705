//! The sheet as the common plane of the joint adjustment.

use super::parameter::STEP_NAMES;
use super::{SheetEstimate, plane_geometry, sigmas};
use crate::bundle::NamedCovariance;
use crate::frames::{Rig, Sheet};
use crate::rigid::Motion;
use nalgebra::{DMatrix, SMatrix, Vector3};

/// The common plane with its standard deviations, all correlations with the cameras included; `second` is the name of
/// the second camera.
pub fn joint_sheet(covariance: &NamedCovariance, plane: &Motion<Rig, Sheet>, second: Option<&str>) -> SheetEstimate {
    let axis: Vector3<f64> = plane.rotation.column(2).into_owned();
    let along = axis.dot(&plane.translation_mm);
    let cam = covariance.natural.cam_from_rig.get(1).filter(|_| second.is_some());
    let center = cam.map(|m| m.inverse().translation_mm);
    let geometry = plane_geometry(axis, along, center);
    let n = geometry.estimate.normal;
    // Seven numbers (w, n . v, centre) by the named steps of plane and camera.
    let mut rows: Vec<Vec<(String, f64)>> = (0..3).map(|k| vec![(sheet_step(k), 1.0)]).collect();
    rows.push((0..3).map(|k| (sheet_step(3 + k), n[k])).collect());
    for k in 0..3 {
        // C = -R^T t: a left step moves it by -R^T v.
        let terms = cam.zip(second).map(|(m, name)| {
            (0..3).map(|j| (format!("{name}.cam_from_rig.{}", STEP_NAMES[3 + j]), -m.rotation[(j, k)])).collect()
        });
        rows.push(terms.unwrap_or_default());
    }
    let seven: DMatrix<f64> = covariance.propagate(&rows);
    let seven = SMatrix::<f64, 7, 7>::from_fn(|i, j| seven[(i, j)]);
    let all = geometry.derivative * seven * geometry.derivative.transpose();
    let mut estimate = geometry.estimate;
    estimate.sigmas = sigmas(&all);
    let known = (0..6).all(|k| covariance.sigma(&sheet_step(k)).is_some());
    if !known {
        estimate.sigmas.fill(f64::NAN);
    }
    estimate
}

fn sheet_step(k: usize) -> String {
    format!("sheet.rig_from_sheet.{}", STEP_NAMES[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every reported number against central differences of a turned and shifted plane and a moved centre.
    #[test]
    fn derivatives_are_those_of_the_numbers() {
        let n0 = Vector3::new(0.5, -0.1, 0.8).normalize();
        let (d0, c0) = (400.0, Vector3::new(600.0, 20.0, 90.0));
        let numbers = |n: Vector3<f64>, d: f64, c: Vector3<f64>| {
            let e = plane_geometry(n, d, Some(c)).estimate;
            let mut v = nalgebra::SVector::<f64, 10>::zeros();
            v[0] = e.distance_mm;
            v.fixed_rows_mut::<3>(3).copy_from(&e.abc_per_mm);
            v.fixed_rows_mut::<3>(6).copy_from_slice(&e.angles_rad);
            v[9] = e.angle_to_baseline_rad;
            v
        };
        let derivative = plane_geometry(n0, d0, Some(c0)).derivative;
        for col in 0..7 {
            let at = |h: f64| {
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
