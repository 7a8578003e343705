//! Rendered scenes calibrated, and all numbers of both cameras against the truth together.

#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, unreachable_pub)]

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use spivcal::camera::INTRINSIC_NAMES;
use spivcal::error::Result;
use spivcal::pipeline::{CalibrateOptions, calibrate};
use spivcal::record::Record;
use spivcal::rig_file::RigDescription;
use spivcal::simulate::{Scene, simulate};

/// A scene rendered, detected and calibrated from what an experimenter would know; and the truth.
pub fn calibrated(scene: &Scene, options: &CalibrateOptions) -> (Record, Record) {
    try_calibrated(scene, options).unwrap()
}

/// The same, or why not.
pub fn try_calibrated(scene: &Scene, options: &CalibrateOptions) -> Result<(Record, Record)> {
    let made = simulate(scene)?;
    let truth = Record::from_json(&made.truth_json, "truth.json").unwrap();
    let job = RigDescription::parse(&made.rig_toml, "rig.toml").unwrap();
    let load = |view: usize, camera: usize| {
        let name = job.views[view].images[camera].as_deref().unwrap();
        Ok(std::sync::Arc::new(made.images.iter().find(|(n, _)| n == name).unwrap().1.clone()))
    };
    Ok((calibrate(&job, &load, options, &mut |_| true)?.record, truth))
}

/// Chi-square of all that the covariance says of both cameras, correlations included, against the truth, and how many numbers that are. Poses
/// differ by steps on the left: `R' = exp(dw) R`, `t' = exp(dw) t + dv`.
pub fn joint_chi2(record: &Record, truth: &Record) -> (f64, usize) {
    let all = &record.covariance;
    let rows: Vec<usize> = (0..all.names.len())
        .filter(|i| all.names[*i].starts_with("left.") || all.names[*i].starts_with("right."))
        .collect();
    let (mut off, n) = (vec![], rows.len());
    for name in rows.iter().map(|i| all.names[*i].split('.').collect::<Vec<_>>()) {
        let camera = record.cameras.iter().position(|c| c.name == name[0]).unwrap();
        let (c, t) = (&record.cameras[camera], &truth.cameras[camera]);
        if name[1] != "cam_from_rig" {
            let k = INTRINSIC_NAMES.iter().position(|k| *k == name[1]).unwrap();
            off.push(c.intrinsics().to_array()[k] - t.intrinsics().to_array()[k]);
            continue;
        }
        let [r, r_truth] = [c, t].map(|c| Matrix3::from_fn(|i, j| c.cam_from_rig.rotation[i][j]));
        let turn = r * r_truth.transpose();
        let dw =
            Vector3::new(turn[(2, 1)] - turn[(1, 2)], turn[(0, 2)] - turn[(2, 0)], turn[(1, 0)] - turn[(0, 1)]) / 2.0;
        let [moved, t_truth] = [c, t].map(|c| Vector3::from(c.cam_from_rig.translation_mm));
        let dv = moved - turn * t_truth;
        let axis = ["x_", "y_", "z_"].iter().position(|a| name[2][1..].starts_with(a)).unwrap();
        off.push(if name[2].starts_with('r') { dw[axis] } else { dv[axis] });
    }
    let sigma: Vec<f64> = rows.iter().map(|i| all.matrix[*i][*i].sqrt()).collect();
    let correlation = DMatrix::from_fn(n, n, |i, j| all.matrix[rows[i]][rows[j]] / (sigma[i] * sigma[j]));
    let z = DVector::from_fn(n, |i, _| off[i] / sigma[i]);
    let solved = correlation.cholesky().expect("a covariance of full rank").solve(&z);
    (z.dot(&solved), n)
}
