//! The sheet found alone: its sigmas, and those of displacements measured in it, against errors sampled.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;
mod scene;

use nalgebra::{DMatrix, Vector3};
use rig_scene::{Draw, Parts, Problem, Scene, band, given_sigmas, tilted_camera, together, true_stereo};
use spivcal::bundle::{NamedCovariance, adjust, named_covariance};
use spivcal::camera::Camera;
use spivcal::diagnosis::mapping_of_record;
use spivcal::frames::{Cam, Rig};
use spivcal::record::{self, Covariance, MappingTold, Record};
use spivcal::rigid::Motion;
use spivcal::sheet::{HeldCameras, Homography, PairFeatures, StereoSheet, fit_homography};

/// Calibrations drawn.
const SEEDS: u64 = 600;

fn parts() -> Parts {
    Scene::parts(31, vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)], false, true, false)
}

/// (a, b, c) of the true sheet, 1/mm.
fn true_abc(parts: &Parts) -> Vector3<f64> {
    let pose = parts.rig_from_sheet.unwrap();
    let n = -pose.rotation.column(2).into_owned();
    n / n.dot(&pose.translation_mm)
}

/// Tangency points of the two views in the sheet, as cameras that are believed in see them.
fn features(cameras: &[Camera; 2], scene: &Scene) -> Vec<PairFeatures> {
    let image = |v: usize, c: usize| scene.model.images.iter().find(|i| i.view == v && i.camera == c).unwrap();
    let of = |v: usize| {
        let contours = [0, 1].map(|c| [&image(v, c).discs[0], &image(v, c).discs[1]]);
        PairFeatures::of([&cameras[0], &cameras[1]], contours).unwrap()
    };
    [4, 5].map(of).into()
}

fn found(held: &HeldCameras, scene: &Scene, start: &Vector3<f64>) -> Homography {
    let cameras = held.cameras().map(|c| *c);
    fit_homography(held, &features(&cameras, scene), start).unwrap()
}

/// Mean of z^2 inside the band of its chi-square, all comparisons of the test together.
fn is_true(name: &str, z: &[f64], comparisons: usize) {
    let mean = z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64;
    let [low, high] = band(z.len() as f64, together(comparisons));
    println!("{name}: mean z^2 {mean:.3} of {} ({low:.3} to {high:.3})", z.len());
    assert!((low..high).contains(&mean), "{name}: {mean} outside {low} to {high}");
}

#[test]
fn with_right_cameras_the_sheet_scatters_by_its_sigmas() {
    let (parts, abc) = (parts(), true_abc(&parts()));
    let scene = parts.scene();
    let cameras = [parts.cameras[0], parts.cameras[1]];
    let held = HeldCameras::new(cameras, parts.cam_from_rig, ["left", "right"], &[], &DMatrix::zeros(0, 0));
    let exact = found(&held, &scene, &abc);
    assert!(exact.transfer_rms_px < 1e-6, "{}", exact.transfer_rms_px);
    assert!((exact.estimate.abc_per_mm - abc).norm() < 1e-9 * abc.norm());
    let mut scatters = vec![];
    let mut z = vec![vec![]; 4];
    for seed in 0..1000 {
        let sheet = found(&held, &scene.with_noise(seed), &abc);
        let e = sheet.estimate;
        scatters.push(sheet.scatter);
        z[0].push((e.distance_mm - 1.0 / abc.norm()) / e.sigmas[0]);
        (0..3).for_each(|k| z[1 + k].push((e.abc_per_mm[k] - abc[k]) / e.sigmas[3 + k]));
    }
    for (name, z) in ["distance", "a", "b", "c"].iter().zip(&z) {
        is_true(name, z, 4);
    }
    hardly_ever_scattered(&scatters);
}

/// Right sigmas are left as they are, but for three standard deviations of chance.
fn hardly_ever_scattered(scatters: &[f64]) {
    let often = scatters.iter().filter(|s| **s != 1.0).count();
    println!("{often} of {} told to scatter", scatters.len());
    assert!(often as f64 <= 0.02 * scatters.len() as f64, "{often}");
}

/// Contours that say less of their scatter than there is (a plate that is not flat) are found out by what is left in the sheet.
#[test]
fn what_scatters_more_than_is_said_makes_sigmas_larger() {
    const SAID: f64 = 1.0 / 3.0;
    let (parts, abc) = (parts(), true_abc(&parts()));
    let scene = parts.scene();
    let held = HeldCameras::new(
        [parts.cameras[0], parts.cameras[1]],
        parts.cam_from_rig,
        ["left", "right"],
        &[],
        &DMatrix::zeros(0, 0),
    );
    let (mut scatters, mut z) = (vec![], vec![vec![]; 4]);
    for seed in 0..400 {
        let mut scene = scene.with_noise(seed);
        let discs = scene.model.images.iter_mut().flat_map(|i| &mut i.discs);
        discs.flat_map(|d| &mut d.edge.sigma_px).for_each(|s| *s *= SAID);
        let sheet = found(&held, &scene, &abc);
        let e = sheet.estimate;
        scatters.push(sheet.scatter);
        z[0].push((e.distance_mm - 1.0 / abc.norm()) / e.sigmas[0]);
        (0..3).for_each(|k| z[1 + k].push((e.abc_per_mm[k] - abc[k]) / e.sigmas[3 + k]));
    }
    let square = scatters.iter().map(|s| s * s * SAID * SAID).sum::<f64>() / scatters.len() as f64;
    println!("variance over that which is there: {square:.3}");
    assert!((0.93..1.07).contains(&square), "{square}");
    for (name, z) in ["distance", "a", "b", "c"].iter().zip(&z) {
        // The scatter is itself known from few numbers: a Student t has a little more than 1, and what was said gave 9.
        let mean = z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64;
        println!("{name}: mean z^2 {mean:.3}");
        assert!((0.8..1.4).contains(&mean), "{name}: {mean}");
    }
}

/// The record of a calibration without a sheet, and its sheet found alone.
fn recorded(covariance: &NamedCovariance, held: &HeldCameras, sheet: &Homography) -> Record {
    let mut out = scene::record();
    for (c, camera) in out.cameras.iter_mut().enumerate() {
        let i = covariance.natural.cameras[c].intrinsics();
        (camera.f_px, camera.aspect, camera.cx_px, camera.cy_px) = (i.f_px, i.aspect, i.cx_px, i.cy_px);
        (camera.alpha_rad, camera.beta_rad, camera.k1) = (i.alpha_rad, i.beta_rad, i.k[0]);
        camera.cam_from_rig = record::Pose::from(&covariance.natural.cam_from_rig[c]);
    }
    out.sheet = Some(sheet.estimate.to_record("homography", vec![4, 5]));
    let m = &covariance.matrix;
    let alone = Covariance {
        names: covariance.names.clone(),
        matrix: (0..m.nrows()).map(|i| m.row(i).iter().copied().collect()).collect(),
        ..Covariance::default()
    };
    out.covariance = sheet.with_sheet(held, &alone).expect("a determined sheet");
    out
}

/// Cameras calibrated from four views beside the sheet, the sheet found from the two in it: what is measured in it is as wrong as is said,
/// though cameras and sheet are wrong together.
#[test]
fn what_is_measured_in_a_sheet_found_alone_has_true_sigmas() {
    let parts = parts();
    let (truth, abc) = (true_stereo(&parts), true_abc(&parts));
    let whole = parts.scene();
    let mut beside = parts.clone();
    beside.views.truncate(4);
    beside.rig_from_sheet = None;
    let beside = Problem::made_of("beside the sheet", beside);
    let names = ["distance", "disparity", "u per u", "v per v", "w per w", "w per u", "u per w", "gain"];
    let mut z = vec![vec![]; names.len()];
    let (mut alone_over_joint, mut scatters) = (vec![], vec![]);
    for seed in 0..SEEDS {
        let Draw { scene, .. } = beside.draw(seed);
        let out = adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true);
        let covariance = named_covariance(&out).unwrap();
        assert_eq!(covariance.nullity, 0);
        let held = HeldCameras::of(&covariance, ["left", "right"]);
        let sheet = found(&held, &whole.with_noise(10_000 + seed), &abc);
        scatters.push(sheet.scatter);
        let record = recorded(&covariance, &held, &sheet);
        let middle = mapping_of_record(&record, MappingTold::default()).expect("known").0.middle;
        let second: Motion<Cam, Rig> = covariance.natural.cam_from_rig[1];
        let stereo = StereoSheet::new(held.cameras().map(|c| *c), second, &sheet.estimate.rig_from_sheet);
        let r = stereo.response(&truth, middle.point_mm).unwrap();
        let (m, d) = (r.measured_from_true, &middle.displacement);
        z[0].push((sheet.estimate.distance_mm - 1.0 / abc.norm()) / sheet.estimate.sigmas[0]);
        z[1].push(r.disparity_px.norm() / middle.disparity_px);
        z[2].push((m.m11 - 1.0) / d[0][0]);
        z[3].push((m.m22 - 1.0) / d[1][1]);
        z[4].push((m.m33 - 1.0) / d[2][2]);
        z[5].push(m.m31 / d[2][0]);
        z[6].push(m.m13 / d[0][2]);
        z[7].push((r.relative_gain() - 1.0) / middle.out_of_plane_gain);
        // As if cameras and sheet had nothing in common.
        let mut apart = record.clone();
        let sheet_row = |n: &String| n.starts_with("sheet.");
        let c = &mut apart.covariance;
        for i in 0..c.names.len() {
            for j in 0..c.names.len() {
                if sheet_row(&c.names[i]) != sheet_row(&c.names[j]) {
                    c.matrix[i][j] = 0.0;
                }
            }
        }
        alone_over_joint.push(
            mapping_of_record(&apart, MappingTold::default()).expect("known").0.middle.displacement[2][2] / d[2][2],
        );
    }
    hardly_ever_scattered(&scatters);
    alone_over_joint.sort_by(f64::total_cmp);
    println!("w per w as if they had nothing in common: {:.1} times", alone_over_joint[alone_over_joint.len() / 2]);
    assert!(alone_over_joint[alone_over_joint.len() / 2] > 2.0, "the test says nothing about what they have in common");
    for (name, z) in names.iter().zip(&z) {
        is_true(name, z, names.len());
    }
}
