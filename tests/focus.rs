//! One fixed sheet with drifting bubbles, images to calibration: without the focus relation the out-of-plane gain is not known
//! and the result says so; with it the gain is right.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use nalgebra::{DMatrix, DVector, Matrix3, Vector2, Vector3};
use spivcal::camera::Camera;
use spivcal::diagnosis::mapping_of_record;
use spivcal::frames::{Cam, Rig};
use spivcal::pipeline::{CalibrateOptions, calibrate};
use spivcal::reconstruct::perturbed_maps;
use spivcal::record::{MappingTold, Record};
use spivcal::rig_file::RigDescription;
use spivcal::simulate::{Scene, simulate};

/// Every view in the sheet, which lies a little off the plane of focus.
fn scene_text(pupil_ratio: f64) -> String {
    let camera = |name: &str, k1: f64, axis: [f64; 2], distance: f64, angle: f64, elevation: f64| {
        format!(
            "[[camera]]\nname = \"{name}\"\nimage_size_px = [640, 480]\npixel_pitch_mm = 0.01\nfocal_length_mm = 50.0\n\
             scheimpflug = true\npupil_ratio = {pupil_ratio:?}\nk = [{k1}, 0.0, 0.0]\naxis_point_px = {axis:?}\n\
             aim = {{ distance_mm = {distance:?}, viewing_angle_deg = {angle:?}, elevation_deg = {elevation:?} }}\n\n"
        )
    };
    camera("left", -0.15, [324.0, 236.0], 506.0, -44.0, 1.2)
        + &camera("right", -0.2, [316.0, 243.0], 494.0, 46.0, -0.8)
        + "[sheet]\noffset_mm = 0.6\ntilt_deg = [0.15, -0.2]\n\n\
           [target]\nkind = \"bubbles\"\npolarity = \"bright\"\n\n\
           [image]\nblur_sigma_px = 0.8\nfull_well_e = 20000\nread_noise_e = 12\n\n\
           [random]\ncount = 10\nsheet_count = 10\ntilt_deg = [0.0, 0.0]\nposition_mm = [14.0, 8.0, 0.0]\n\
           radii_mm = [[6.0, 10.0], [5.0, 8.0]]\nspacing_mm = [19.5, 23.0]\n\n\
           [rig]\nscale = \"view-spacing\"\nestimate = [\"k1\"]\n"
}

/// The scene's images calibrated by its rig file with `extra` at the end, and the truth.
fn calibrated(pupil_ratio: f64, extra: &str) -> (Record, Record) {
    let scene = Scene::parse(&scene_text(pupil_ratio), "scene.toml").unwrap();
    let simulation = simulate(&scene).unwrap();
    // The rig file states the pupil ratio, as a data sheet does.
    let rig = simulation.rig_toml.clone() + extra;
    let job = RigDescription::parse(&rig, "rig.toml").unwrap_or_else(|e| panic!("{e}\n{rig}"));
    let image = |view: usize, camera: usize| {
        let name = job.views[view].images[camera].as_ref().unwrap();
        Ok(std::sync::Arc::new(simulation.images.iter().find(|(n, _)| n == name).unwrap().1.clone()))
    };
    let out = calibrate(&job, &image, &CalibrateOptions::default(), &mut |_| true);
    (out.unwrap_or_else(|e| panic!("{e}")).record, Record::from_json(&simulation.truth_json, "truth.json").unwrap())
}

/// Images of a point of the rig in both cameras.
fn images(record: &Record, p: &Vector3<f64>) -> [Vector2<f64>; 2] {
    [0, 1].map(|c| {
        let camera = &record.cameras[c];
        Camera::new(camera.intrinsics())
            .unwrap()
            .project_xyz(&camera.cam_from_rig.motion::<Cam, Rig>().apply(p))
            .unwrap()
    })
}

/// Out-of-plane component that the calibration reconstructs from the true images of a movement of 1 along the normal.
fn gain(estimate: &Record, truth: &Record) -> f64 {
    let moved = 0.01;
    let frame = |r: &Record| {
        let pose = &r.sheet.as_ref().unwrap().rig_from_sheet;
        (Matrix3::from_fn(|i, j| pose.rotation[i][j]), Vector3::from(pose.translation_mm))
    };
    let (turn, origin) = frame(truth);
    let (a, b) = (images(truth, &origin), images(truth, &(origin + turn.column(2) * moved)));
    // The same image point of the first camera on the estimated sheet.
    let (own, own_origin) = frame(estimate);
    let camera = Camera::new(estimate.cameras[0].intrinsics()).unwrap();
    let ray = camera.ideal_of_pixel(&a[0]).unwrap().push(1.0);
    let normal: Vector3<f64> = own.column(2).into_owned();
    let p = ray * (normal.dot(&own_origin) / normal.dot(&ray));
    let columns: Vec<[Vector2<f64>; 2]> = (0..3)
        .map(|k| {
            let step = own.column(k) * moved;
            let (plus, minus) = (images(estimate, &(p + step)), images(estimate, &(p - step)));
            [(plus[0] - minus[0]) / (2.0 * moved), (plus[1] - minus[1]) / (2.0 * moved)]
        })
        .collect();
    let j = DMatrix::from_fn(4, 3, |r, k| columns[k][r / 2][r % 2]);
    let d = DVector::from_fn(4, |r, _| (b[r / 2] - a[r / 2])[r % 2]);
    j.svd(true, true).solve(&d, 1e-12).unwrap()[2] / moved
}

#[test]
fn a_fixed_sheet_is_flagged_without_the_focus_relation() {
    let (record, truth) = calibrated(1.0, "");
    println!(
        "without: gain {:.5}, nullity {}, {:#?}",
        gain(&record, &truth),
        record.fit.nullity,
        record.fit.undetermined
    );
    println!("flags: {:#?}", record.fit.flags);
    assert!(!record.fit.undetermined.is_empty(), "nothing is said to be undetermined");
    assert!(record.fit.nullity > 0 && !record.fit.flags.is_empty(), "{:?}", record.fit.flags);
    let read = Record::from_json(&record.to_json().unwrap(), "calibration.json").unwrap();
    assert_eq!(read.covariance.null_directions.len(), read.fit.nullity);
    told_truly(&read, &truth);
    // Nor does what follows make sigmas up.
    assert!(perturbed_maps(&read).unwrap().is_none(), "sigmas of three components");
    let (mapping, _) = mapping_of_record(&read, MappingTold::default()).unwrap();
    assert!(!mapping.undetermined.is_empty(), "{mapping:?}");
    assert_eq!(read.covariance.sigma("right.cam_from_rig.tx_mm"), None);
    assert!(read.covariance.sigma("target.spacing_mm").is_none_or(|s| s >= 0.0));
}

/// Every derived number that has a standard deviation lies within five of them of the truth.
fn told_truly(found: &Record, truth: &Record) {
    let (rig, true_rig) = (found.rig.as_ref().unwrap(), truth.rig.as_ref().unwrap());
    let (sheet, true_sheet) = (found.sheet.as_ref().unwrap(), truth.sheet.as_ref().unwrap());
    let mut all = vec![
        ("baseline", rig.baseline_mm, true_rig.baseline_mm, rig.sigma.baseline_mm),
        ("axes", rig.axes_angle_deg, true_rig.axes_angle_deg, rig.sigma.axes_angle_deg),
        ("distance", sheet.distance_mm, true_sheet.distance_mm, sheet.sigma.distance_mm),
        (
            "angle to the baseline",
            sheet.angle_to_baseline_deg,
            true_sheet.angle_to_baseline_deg,
            sheet.sigma.angle_to_baseline_deg,
        ),
    ];
    for k in 0..3 {
        all.push(("abc", sheet.abc_per_mm[k], true_sheet.abc_per_mm[k], sheet.sigma.abc_per_mm[k]));
    }
    for (c, t) in found.cameras.iter().zip(&truth.cameras) {
        let (e, sigma) = (c.effective, c.sigma.effective);
        all.push(("effective f", e.f_px, t.effective.f_px, sigma.f_px));
        all.push(("effective cx", e.cx_px, t.effective.cx_px, sigma.cx_px));
        all.push(("effective cy", e.cy_px, t.effective.cy_px, sigma.cy_px));
    }
    for (what, found, truth, sigma) in &all {
        println!("{what}: {found} +- {sigma}, in truth {truth}");
        assert!(sigma.is_nan() || (found - truth).abs() < 5.0 * sigma, "{what}: {found} +- {sigma}, in truth {truth}");
    }
    assert!(all.iter().filter(|x| x.3.is_nan()).count() > 4, "nothing is said to be unknown");
}

#[test]
fn the_focus_relation_gives_the_gain_of_a_fixed_sheet() {
    // 0.5 degrees and 0.5 percent leave up to 0.3 percent of the gain (method section 6); four times that here.
    for pupil_ratio in [1.0, 1.3] {
        let (record, truth) = calibrated(pupil_ratio, "\n[focus]\ntilt_sigma_deg = 0.3\ndistance_sigma = 0.003\n");
        let gain = gain(&record, &truth);
        println!(
            "pupil ratio {pupil_ratio}: gain {gain:.5}, rms {:.4} px, {:#?}",
            record.fit.rms_px, record.fit.undetermined
        );
        assert_eq!(record.fit.nullity, 0);
        assert!((gain - 1.0).abs() < 0.012, "pupil ratio {pupil_ratio}: gain {gain}");
        let (s, t) = (record.sheet.unwrap(), truth.sheet.unwrap());
        let z = (s.angle_to_baseline_deg - t.angle_to_baseline_deg) / s.sigma.angle_to_baseline_deg;
        println!("angle to the baseline: z {z:.2}, sigma {:.4} deg", s.sigma.angle_to_baseline_deg);
        assert!(z.abs() < 4.0, "angle to the baseline: {z} sigmas");
    }
}
