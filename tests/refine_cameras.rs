//! Cameras and sheet corrected together by particles: calibrations moved by a draw from their own covariance come back as far as the new covariance
//! says, a camera that was knocked is told, and nothing moves where there is nothing to tell.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod particle_scene;
mod render;

use nalgebra::{DMatrix, DVector, SVector, Vector3};
use particle_scene::{pairs, scene, truth};
use render::Random;
use spivcal::disparity::{CheckOptions, CheckOutput, check_sheet};
use spivcal::frames::{Cam, Rig, Sheet};
use spivcal::image::GrayImage;
use spivcal::record::{Covariance, Pose, Record};
use spivcal::rigid::Motion;
use spivcal::simulate::simulate_particles;

const INTRINSICS: [&str; 6] = ["f_px", "cx_px", "cy_px", "alpha_rad", "beta_rad", "k1"];
const STEPS: [&str; 6] = ["rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"];
/// Typical standard deviations of these numbers.
const SIGMA: [f64; 18] =
    [4.0, 6.0, 6.0, 2e-3, 2e-3, 0.01, 4.0, 6.0, 6.0, 2e-3, 2e-3, 0.01, 5e-4, 5e-4, 5e-4, 0.2, 0.2, 0.2];

fn names() -> Vec<String> {
    let own = |camera: &str| INTRINSICS.map(|q| format!("{camera}.{q}")).to_vec();
    [own("left"), own("right"), STEPS.map(|s| format!("right.cam_from_rig.{s}")).to_vec()].concat()
}

/// A factor of a covariance with all kinds of correlations.
fn factor(scale: f64) -> DMatrix<f64> {
    let mut noise = Random(5);
    let mixed = DMatrix::from_fn(18, 18, |i, j| noise.normal() * 0.35 + if i == j { 1.0 } else { 0.0 });
    DMatrix::from_fn(18, 18, |i, j| scale * SIGMA[i] * mixed[(i, j)] / mixed.row(i).norm())
}

/// The calibration with these steps of its numbers, and a covariance.
fn stepped(record: &Record, steps: &DVector<f64>, factor: &DMatrix<f64>) -> Record {
    let mut out = record.clone();
    for (c, camera) in out.cameras.iter_mut().enumerate() {
        let s = |k: usize| steps[6 * c + k];
        camera.f_px += s(0);
        camera.cx_px += s(1);
        camera.cy_px += s(2);
        camera.alpha_rad += s(3);
        camera.beta_rad += s(4);
        camera.k1 += s(5);
    }
    let pose: Motion<Cam, Rig> = out.cameras[1].cam_from_rig.motion();
    out.cameras[1].cam_from_rig = Pose::from(&pose.retract(&SVector::<f64, 6>::from_fn(|k, _| steps[12 + k])));
    let p = factor * factor.transpose();
    out.covariance.names = names();
    out.covariance.matrix = (0..18).map(|i| (0..18).map(|j| p[(i, j)]).collect()).collect();
    out
}

/// Steps that lead from one calibration to another.
fn apart(from: &Record, to: &Record) -> DVector<f64> {
    let mut out = DVector::zeros(18);
    for c in 0..2 {
        let (a, b) = (&from.cameras[c], &to.cameras[c]);
        let all = [
            b.f_px - a.f_px,
            b.cx_px - a.cx_px,
            b.cy_px - a.cy_px,
            b.alpha_rad - a.alpha_rad,
            b.beta_rad - a.beta_rad,
            b.k1 - a.k1,
        ];
        all.iter().enumerate().for_each(|(k, x)| out[6 * c + k] = *x);
    }
    let (a, b) = (from.cameras[1].cam_from_rig.motion::<Cam, Rig>(), to.cameras[1].cam_from_rig.motion::<Cam, Rig>());
    let turn = b.rotation * a.rotation.transpose();
    let w = spivcal::rigid::rotation_log(&turn);
    let v = b.translation_mm - turn * a.translation_mm;
    (0..3).for_each(|k| (out[12 + k], out[15 + k]) = (w[k], v[k]));
    out
}

/// Disparity across the direction of depth that a calibration makes of points in the true sheet, px of 0.1 mm.
fn across(real: &Record, record: &Record) -> DVector<f64> {
    let (seen, by) = (real.placed_cameras().unwrap(), record.placed_cameras().unwrap());
    let pose = |r: &Record| r.sheet.as_ref().unwrap().rig_from_sheet.motion::<Rig, Sheet>();
    let (true_pose, back) = (pose(real), pose(record).inverse());
    let places = (0..12).map(|k| Vector3::new(-24.0 + 16.0 * f64::from(k % 4), -18.0 + 18.0 * f64::from(k / 4), 0.0));
    let one = |p: Vector3<f64>| {
        let hit = |c: usize| {
            let (from, along) = by[c].sight_in_rig(&seen[c].pixel_from_rig(&true_pose.apply(&p)).unwrap()).unwrap();
            let (from, along) = (back.apply(&from), back.rotation * along);
            let slope = along.xy() / along.z;
            (from.xy() - slope * from.z, slope)
        };
        let (a, b) = (hit(0), hit(1));
        let (d, s) = (b.0 - a.0, b.1 - a.1);
        (d.x * s.y - d.y * s.x) / s.norm() / 0.1
    };
    DVector::from_iterator(12, places.map(one))
}

fn refine(record: &Record, images: &[(String, GrayImage)]) -> CheckOutput {
    let options = CheckOptions { refine: true, refine_cameras: true, ..CheckOptions::default() };
    check_sheet(record, &pairs(images), &options).unwrap()
}

#[test]
fn cameras_moved_within_their_covariance_come_back_as_far_as_the_new_one_says() {
    // Some 1.5 px across the direction of depth: the coarse search for the plane still finds particles alike.
    let l = factor(0.3);
    let real = truth(&scene(71, 0.0, [0.0; 2], 0.6, 2));
    let (mut noise, mut z2, mut heard, mut plane, mut before, mut after) = (Random(99), 0.0, 0.0, 0.0, 0.0, 0.0);
    let (mut draws, mut chances) = (0.0, vec![]);
    for seed in 71..74 {
        let images = simulate_particles(&scene(seed, 0.0, [0.0; 2], 0.6, 2)).unwrap();
        for _ in 0..3 {
            let w = DVector::from_fn(18, |_, _| noise.normal());
            let start = stepped(&real, &(&l * w), &l);
            let found = refine(&start, &images);
            let (record, told) = (found.record.unwrap(), found.check.cameras_refined.unwrap());
            record.check().unwrap();
            let error = apart(&real, &record);
            let row = |n: &String| record.covariance.index(n).unwrap();
            let rows: Vec<usize> = names().iter().map(row).collect();
            let p = DMatrix::from_fn(18, 18, |i, j| record.covariance.matrix[rows[i]][rows[j]]);
            // On the scale of the sigmas, so that the factor is a good one.
            let scale = DVector::from_fn(18, |i, _| p[(i, i)].sqrt());
            let unit = DMatrix::from_fn(18, 18, |i, j| p[(i, j)] / (scale[i] * scale[j]));
            let e = error.component_div(&scale);
            z2 += e.dot(&unit.cholesky().unwrap().solve(&e));
            // The same in what the particles see.
            let mut by = DMatrix::zeros(12, 18);
            for k in 0..18 {
                let side = |sign: f64| {
                    let mut s = DVector::zeros(18);
                    s[k] = 0.01 * sign * scale[k];
                    across(&real, &stepped(&record, &s, &l))
                };
                by.set_column(k, &((side(1.0) - side(-1.0)) / (0.02 * scale[k])));
            }
            let variance = &by * &p * by.transpose();
            let now = across(&real, &record);
            heard += (0..12).map(|i| now[i] * now[i] / variance[(i, i)]).sum::<f64>() / 12.0;
            before += across(&real, &start).norm_squared() / 12.0;
            after += now.norm_squared() / 12.0;
            plane += (found.check.offset_mm / found.check.offset_sigma_mm).powi(2)
                + (0..2).map(|a| (found.check.tilt_deg[a] / found.check.tilt_sigma_deg[a]).powi(2)).sum::<f64>();
            println!(
                "across {:.3} -> {:.4} px; chi-square {:.1} of {}, chance {:.2}; offset {:.3} +- {:.3} mm; flags {:?}",
                (across(&real, &start).norm_squared() / 12.0).sqrt(),
                (now.norm_squared() / 12.0).sqrt(),
                told.chi2,
                told.degrees,
                told.chance,
                found.check.offset_mm,
                found.check.offset_sigma_mm,
                found.check.flags
            );
            chances.push(told.chance);
            draws += 1.0;
        }
    }
    let (z2, heard, plane) = (z2 / (18.0 * draws), heard / draws, plane / (3.0 * draws));
    let (before, after) = ((before / draws).sqrt(), (after / draws).sqrt());
    println!(
        "mean z^2: numbers {z2:.2}, disparity across {heard:.2}, plane {plane:.2}; across {before:.3} -> {after:.4} px"
    );
    // 162 squares, 27 of the plane; of the disparities some six are independent in each draw.
    assert!((0.65..1.45).contains(&z2), "{z2}");
    assert!((0.4..2.0).contains(&heard), "{heard}");
    assert!((0.35..2.1).contains(&plane), "{plane}");
    assert!(after < 0.1 * before, "{before} {after}");
    assert!(chances.iter().all(|c| *c > 1e-4), "{chances:?}");
}

#[test]
fn nothing_moves_where_the_calibration_knows_better() {
    let l = factor(1e-5);
    let real = truth(&scene(81, 0.0, [0.0; 2], 0.6, 2));
    let images = simulate_particles(&scene(81, 0.3, [0.1, -0.2], 0.6, 2)).unwrap();
    let start = stepped(&real, &DVector::zeros(18), &l);
    let found = refine(&start, &images);
    let told = found.check.cameras_refined.unwrap();
    assert!(told.numbers.iter().all(|n| n.change_sigmas.abs() < 0.05), "{:?}", told.numbers);
    assert!(told.degrees == 0 && told.chance.is_nan() && found.check.flags.is_empty(), "{:?}", found.check.flags);
    let plain = CheckOptions { refine: true, ..CheckOptions::default() };
    let held = check_sheet(&start, &pairs(&images), &plain).unwrap().check;
    assert!(held.cameras_refined.is_none());
    let z = (found.check.offset_mm - held.offset_mm) / held.offset_sigma_mm;
    println!("offset {} and {}, {z:.3} sigmas apart", found.check.offset_mm, held.offset_mm);
    assert!(z.abs() < 0.5, "{z}");
    assert!((found.check.offset_sigma_mm / held.offset_sigma_mm - 1.0).abs() < 0.3);
}

#[test]
fn a_knocked_camera_is_told_and_put_right() {
    let l = factor(0.03);
    let real = truth(&scene(91, 0.0, [0.0; 2], 0.6, 2));
    let images = simulate_particles(&scene(91, 0.0, [0.0; 2], 0.6, 2)).unwrap();
    let mut knock = DVector::zeros(18);
    // A turn of the second camera that lifts its image: across the direction of depth.
    knock[12] = 6e-4;
    let start = stepped(&real, &knock, &l);
    let found = refine(&start, &images);
    let (flags, record) = (&found.check.flags, found.record.as_ref().unwrap());
    println!("{flags:?}");
    assert!(flags.iter().any(|f| f.contains("knocked") && f.contains("calibrate again")), "{flags:?}");
    let (before, after) = (across(&real, &start).norm(), across(&real, record).norm());
    assert!(after < 0.05 * before, "{before} {after}");
}

#[test]
fn cameras_without_a_covariance_are_refused_in_words() {
    let real = truth(&scene(91, 0.0, [0.0; 2], 0.6, 1));
    let images = simulate_particles(&scene(91, 0.0, [0.0; 2], 0.6, 1)).unwrap();
    let options = CheckOptions { refine: true, refine_cameras: true, ..CheckOptions::default() };
    let mut bare = stepped(&real, &DVector::zeros(18), &factor(1.0));
    let refused = |r: &Record, o: &CheckOptions| check_sheet(r, &pairs(&images), o).unwrap_err().to_string();
    bare.covariance.undetermined = vec!["right.f_px".into()];
    let said = refused(&bare, &options);
    assert!(said.contains("does not determine right.f_px") && said.contains("--refine-cameras"), "{said}");
    bare.covariance = Covariance::default();
    assert!(refused(&bare, &options).contains("no covariance"));
    let said = refused(&bare, &CheckOptions { refine: false, ..options });
    assert!(said.contains("--refine as well"), "{said}");
}
