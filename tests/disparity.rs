//! Rendered particles in a sheet that is off and tilted: the check finds it, within its own sigmas, and refuses what has no particles.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod particle_scene;

use nalgebra::{SVector, Vector3};
use particle_scene::{Sharpness, pairs, plane, scene, seeded, truth};
use spivcal::disparity::{CheckOptions, CheckOutput, check_sheet};
use spivcal::frames::{Cam, Rig, Sheet};
use spivcal::image::{GrayImage, Pixels};
use spivcal::record::{Pose, Record};
use spivcal::rigid::Motion;
use spivcal::simulate::simulate_particles;
use std::process::Command;

fn refined(
    seed: u64,
    offset_mm: f64,
    tilt_deg: [f64; 2],
    thickness_mm: f64,
    count: usize,
) -> (Record, Record, CheckOutput) {
    let wrong = truth(&scene(seed, 0.0, [0.0; 2], thickness_mm, count));
    let real = scene(seed, offset_mm, tilt_deg, thickness_mm, count);
    let images = simulate_particles(&real).unwrap();
    let options = CheckOptions { refine: true, ..CheckOptions::default() };
    let found = check_sheet(&wrong, &pairs(&images), &options).unwrap();
    (wrong, truth(&real), found)
}

#[test]
fn offsets_and_tilts_are_recovered_within_their_sigmas() {
    let mut sum = 0.0;
    let cases = [
        (1, 0.1, [0.0, 0.0], 0.6),
        (2, -0.6, [0.2, -0.3], 1.0),
        (3, 1.5, [-2.0, 1.0], 0.6),
        (4, -3.0, [1.0, 4.0], 0.3),
        (5, 5.0, [-3.0, -4.0], 0.8),
    ];
    for (seed, offset_mm, tilt_deg, thickness_mm) in cases {
        let (start, real, found) = refined(seed, offset_mm, tilt_deg, thickness_mm, 3);
        let (c, corrected) = (&found.check, found.record.unwrap());
        let wanted = plane(&start, &real);
        let z = [
            (c.offset_mm - wanted.x) / c.offset_sigma_mm,
            (c.tilt_deg[0] - wanted.z.atan().to_degrees()) / c.tilt_sigma_deg[0],
            (c.tilt_deg[1] - (-wanted.y).atan().to_degrees()) / c.tilt_sigma_deg[1],
        ];
        // What the corrected sheet still is off, in px of disparity over the field.
        let left = plane(&corrected, &real);
        let slopes = (42.0_f64.to_radians()).tan() + 35.0_f64.to_radians().tan();
        let left_px = [(-33.0, -25.0), (33.0, -25.0), (-33.0, 25.0), (33.0, 25.0)]
            .map(|(x, y)| left.dot(&Vector3::new(1.0, x, y)).abs() * slopes / c.mm_per_px)
            .into_iter()
            .fold(0.0, f64::max);
        let mean = c.after.as_ref().unwrap().mean_px();
        println!(
            "{offset_mm} mm, {tilt_deg:?} deg: offset {:.4} +- {:.4}, tilts {:.4?} +- {:.4?}, z {z:.2?}; disparity {:.2} -> {:.4} px, mean {mean:.4?}, \
             worst in the field {left_px:.4} px; {} rounds, significance {:.0}; thickness {:.3} of {thickness_mm} mm",
            c.offset_mm,
            c.offset_sigma_mm,
            c.tilt_deg,
            c.tilt_sigma_deg,
            c.before.median_px(),
            c.after.as_ref().unwrap().median_px(),
            c.history.len(),
            c.significance,
            c.thickness_mm
        );
        assert!(z.iter().all(|z| z.abs() < 3.5), "{z:?}");
        sum += z.iter().map(|z| z * z).sum::<f64>();
        assert!(c.converged && mean[0].hypot(mean[1]) < 0.02, "{mean:?}");
        assert!((c.thickness_mm / thickness_mm - 1.0).abs() < 0.2, "{} {thickness_mm}", c.thickness_mm);
        assert!(c.offset_sigma_mm < 0.02 && c.tilt_sigma_deg.iter().all(|s| *s < 0.1));
        corrected.check().unwrap();
        assert_eq!(corrected.sheet.unwrap().method, "self-calibration");
    }
    // Fifteen numbers: chi-square between its 0.1 % and 99.9 % points.
    println!("chi-square of 15: {sum:.1}");
    assert!((3.5..37.7).contains(&sum), "{sum}");
}

#[test]
fn without_refine_the_calibration_stays_and_the_user_is_told() {
    let real = scene(7, 1.0, [0.0, 1.0], 0.6, 2);
    let images = simulate_particles(&real).unwrap();
    let wrong = truth(&scene(7, 0.0, [0.0; 2], 0.6, 1));
    let found = check_sheet(&wrong, &pairs(&images), &CheckOptions::default()).unwrap();
    assert!(found.record.is_none() && found.check.after.is_none());
    assert!(found.check.flags.iter().any(|f| f.contains("--refine")), "{:?}", found.check.flags);
    let right = check_sheet(&truth(&real), &pairs(&images), &CheckOptions::default()).unwrap();
    println!("in place: median {:.3} px, flags {:?}", right.check.before.median_px(), right.check.flags);
    assert!(right.check.flags.is_empty());
}

#[test]
fn images_without_common_particles_are_refused() {
    let [mut a, b] = [11, 12].map(|seed| simulate_particles(&scene(seed, 0.0, [0.0; 2], 0.6, 2)).unwrap());
    // The right images of other moments.
    for i in [1, 3] {
        a[i] = b[i].clone();
    }
    let record = truth(&scene(11, 0.0, [0.0; 2], 0.6, 1));
    let message = check_sheet(&record, &pairs(&a), &CheckOptions::default()).unwrap_err();
    println!("{message}");
    assert!(message.exit_code() == 3 && message.to_string().contains("no common particles"));
    let none = check_sheet(&record, &[], &CheckOptions::default()).unwrap_err();
    assert!(none.to_string().contains("no image pair"));
}

/// The same images with other grey levels.
fn redrawn(images: &[(String, GrayImage)], level: impl Fn(f32) -> u16) -> Vec<(String, GrayImage)> {
    let redraw = |image: &GrayImage| {
        let (w, h, view) = (image.width(), image.height(), image.view());
        let levels = (0..w * h).map(|i| level(view.get(i % w, i / w))).collect();
        GrayImage::new(Pixels::U16(levels), w, h).unwrap()
    };
    images.iter().map(|(name, image)| (name.clone(), redraw(image))).collect()
}

#[test]
fn saturated_and_flat_images_are_told_with_what_to_do() {
    let images = simulate_particles(&scene(61, 0.2, [0.0; 2], 0.6, 1)).unwrap();
    let record = truth(&scene(61, 0.0, [0.0; 2], 0.6, 1));
    let check = |images: &[(String, GrayImage)]| check_sheet(&record, &pairs(images), &CheckOptions::default());
    let refused = |images: &[(String, GrayImage)], words: &[&str]| {
        let e = check(images).unwrap_err();
        println!("{e}");
        assert_eq!(e.exit_code(), 3);
        words.iter().for_each(|w| assert!(e.to_string().contains(w), "{w}: {e}"));
    };
    refused(&redrawn(&images, |_| 37), &["p01_left.png", "flat", "check the exposure and that the laser fired"]);
    refused(
        &redrawn(&images, |g| if g > 60.0 { 4095 } else { g as u16 }),
        &["saturated", "reduce laser power or aperture"],
    );
    // Particles cut off at a sixth of their height still tell the place.
    let cut = redrawn(&images, |g| (6.0 * g).min(4095.0) as u16);
    let found = check(&cut).unwrap().check;
    println!("{:?}", found.flags);
    assert!(
        found.flags.iter().any(|f| f.contains("saturated") && f.contains("reduce the exposure")),
        "{:?}",
        found.flags
    );
}

#[test]
fn the_program_writes_report_check_and_calibration() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    let real = scene(21, 0.8, [0.5, -0.7], 0.5, 2);
    for (name, image) in simulate_particles(&real).unwrap() {
        std::fs::write(at(&name), spivcal::pipeline::png_bytes(&image).unwrap()).unwrap();
    }
    std::fs::write(at("c.json"), truth(&scene(21, 0.0, [0.0; 2], 0.5, 1)).to_json().unwrap()).unwrap();
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).to_string() + &String::from_utf8_lossy(&output.stdout);
        println!("{}", said.trim_end());
        (output.status.code().unwrap(), said)
    };
    let (c, l, r, o) = (at("c.json"), at("p*_left.png"), at("p*_right.png"), at("out"));
    let (code, _) = run(&["check", &c, "--pairs", &l, &r, "-o", &o, "--refine"]);
    assert_eq!(code, 0);
    let html = std::fs::read_to_string(at("out/report.html")).unwrap();
    roxmltree::Document::parse_with_options(&html, roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() })
        .unwrap();
    for words in ["Before", "After", "thickness of the light", "Rounds"] {
        assert!(html.contains(words), "{words}");
    }
    // The corrected calibration is one like any other: checked again, nothing is left to say.
    let corrected = at("out/calibration.json");
    let (code, said) = run(&["check", &corrected, "--pairs", &l, &r, "-o", &at("again")]);
    assert!(code == 0 && !said.contains("--refine"), "{said}");
    let (code, said) = run(&["check", &c, "--pairs", &l, &r, "one_more.png", "-o", &o]);
    assert!(
        code == 2 && said.contains("\"one_more.png\" is one name too many") && said.contains("in quotes"),
        "{said}"
    );
    let (code, said) = run(&["check", &c, "--pairs", &at("q*.png"), &r, "-o", &o]);
    assert!(code == 2 && said.contains("no file matches"), "{said}");
    std::fs::remove_file(at("p02_right.png")).unwrap();
    let (code, said) = run(&["check", &c, "--pairs", &l, &r, "-o", &o]);
    assert!(code == 2 && said.contains("every moment needs one image"), "{said}");
}

/// Few particles in thick light: windows scatter in the right sheet, too, by the depth of their particles over the root of their number.
#[test]
fn windows_with_few_particles_scatter_along_depth_and_the_sheet_is_right() {
    let (thickness_mm, per_mm2) = (1.0, 0.6);
    let start = truth(&seeded(31, 0.0, [0.0; 2], thickness_mm, 2, per_mm2));
    let real = seeded(31, 0.5, [0.3, -0.2], thickness_mm, 2, per_mm2);
    let images = simulate_particles(&real).unwrap();
    let mut scatter = vec![];
    for window_px in [32, 64] {
        let options = CheckOptions { refine: true, window_px, ..CheckOptions::default() };
        let c = check_sheet(&start, &pairs(&images), &options).unwrap().check;
        let m = c.misalignment_after.unwrap();
        let wanted = plane(&start, &truth(&real));
        let z = (c.offset_mm - wanted.x) / c.offset_sigma_mm;
        println!(
            "window {window_px}: offset z {z:.2}, length {:.3} px, {m:.3?}",
            c.after.as_ref().unwrap().median_px()
        );
        assert!(z.abs() < 3.5, "{z}");
        assert!(m.smooth_px[0] < 3.0 * m.smooth_noise_px[0] && m.smooth_px[1] < 0.1, "{m:?}");
        assert!((0..2).all(|a| m.median_px[a].abs() < 4.0 * m.median_sigma_px[a] + 0.02), "{m:?}");
        assert!(m.scatter_px[1] < 0.3 * m.scatter_px[0], "{m:?}");
        assert!(c.flags.is_empty(), "{:?}", c.flags);
        let light = c.profile.unwrap();
        assert!(light.top_mm.abs() < 0.2 && light.middle_mm.abs() < 0.2, "{} {}", light.top_mm, light.middle_mm);
        scatter.push(m.scatter_px[0]);
    }
    // Four times the particles.
    assert!((1.5..2.6).contains(&(scatter[0] / scatter[1])), "{scatter:?}");
    assert!(scatter[0] > 0.5, "{scatter:?}");
}

/// 90 degrees between the cameras: light draws peaks out by 13 px per mm of its thickness, and twice that at twice the resolution.
#[test]
fn thickness_and_place_hold_for_thick_light_and_at_two_resolutions() {
    // Thickness, times the resolution, window; thickness found within; whether the window is told to be too small.
    let cases = [
        (0.2, 1, 64, 0.1, false),
        (1.0, 1, 64, 0.1, false),
        (1.0, 2, 128, 0.1, false),
        (2.0, 1, 128, 0.1, false),
        (2.0, 1, 64, 0.2, true),
    ];
    for (thickness_mm, by, window_px, within, told) in cases {
        let of = |offset_mm, tilt_deg| Sharpness::oblique(by).scene(71, offset_mm, tilt_deg, thickness_mm, 4, 3.0);
        let real = of(0.5, [0.3, -0.2]);
        let (start, images) = (truth(&of(0.0, [0.0; 2])), simulate_particles(&real).unwrap());
        let options = CheckOptions { refine: true, window_px, ..CheckOptions::default() };
        let c = check_sheet(&start, &pairs(&images), &options).unwrap().check;
        let wanted = plane(&start, &truth(&real));
        let z = [
            (c.offset_mm - wanted.x) / c.offset_sigma_mm,
            (c.tilt_deg[0] - wanted.z.atan().to_degrees()) / c.tilt_sigma_deg[0],
            (c.tilt_deg[1] - (-wanted.y).atan().to_degrees()) / c.tilt_sigma_deg[1],
        ];
        println!(
            "{thickness_mm} mm, {:.4} mm/px, windows of {window_px} px: {:.3} mm; offset +- {:.4} mm, tilts +- {:.4?} deg, z {z:.2?}; windows {:?}",
            c.mm_per_px,
            c.thickness_mm,
            c.offset_sigma_mm,
            c.tilt_sigma_deg,
            c.history.iter().map(|h| h.windows).collect::<Vec<_>>()
        );
        assert!((c.thickness_mm / thickness_mm - 1.0).abs() < within, "{} of {thickness_mm} mm", c.thickness_mm);
        assert!(z.iter().all(|z| z.abs() < 3.5), "{z:?}");
        assert!(told || c.history[1..].iter().all(|h| 2 * h.windows[0] > h.windows[1]), "{:?}", c.history);
        assert_eq!(c.flags.iter().any(|f| f.contains("light is thick for windows of 64 px")), told, "{:?}", c.flags);
    }
}

/// A record with left steps of the second camera and the sheet, and another image distance of the second camera.
fn stepped(record: &Record, f_px: f64, camera: [f64; 6], sheet: [f64; 6]) -> Record {
    let mut out = record.clone();
    let c = &mut out.cameras[1];
    c.f_px += f_px;
    let moved: Motion<Cam, Rig> = c.cam_from_rig.motion::<Cam, Rig>().retract(&SVector::from(camera));
    c.cam_from_rig = Pose::from(&moved);
    let s = out.sheet.as_mut().unwrap();
    let moved: Motion<Rig, Sheet> = s.rig_from_sheet.motion::<Rig, Sheet>().retract(&SVector::from(sheet));
    s.rig_from_sheet = Pose::from(&moved);
    out
}

/// The same images checked with calibrations moved by one sigma along each column of a factor of the covariance: the plane, its place against
/// the starting sheet, and what the new covariance says of it.
#[test]
fn sigmas_hold_the_covariance_of_the_calibration() {
    let real = scene(51, 0.3, [0.1, -0.2], 0.6, 1);
    let images = simulate_particles(&real).unwrap();
    let mut start = truth(&scene(51, 0.0, [0.0; 2], 0.6, 1));
    // Columns: image distance and place of the second camera together, its turn with the sheet, the sheet alone.
    let (mut camera, mut sheet) = ([[0.0; 6]; 3], [[0.0; 6]; 3]);
    let f_px = [3.0, 0.0, 0.0];
    (camera[0][5], camera[0][1], camera[1][1], sheet[1][5]) = (-0.3, 2e-5, 6e-5, 0.04);
    (sheet[2][5], sheet[2][0]) = (0.03, 1e-4);
    let steps = ["rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"];
    let names = |prefix: &str| steps.map(|s| format!("{prefix}.{s}"));
    start.covariance.names =
        [vec!["right.f_px".to_string()], names("right.cam_from_rig").to_vec(), names("sheet.rig_from_sheet").to_vec()]
            .concat();
    let column = |k: usize| -> Vec<f64> { [vec![f_px[k]], camera[k].to_vec(), sheet[k].to_vec()].concat() };
    let entry = |i: usize, j: usize| (0..3).map(|k| column(k)[i] * column(k)[j]).sum::<f64>();
    start.covariance.matrix = (0..13).map(|i| (0..13).map(|j| entry(i, j)).collect()).collect();
    let options = CheckOptions { refine: true, ..CheckOptions::default() };
    let check = |record: &Record| check_sheet(record, &pairs(&images), &options).unwrap();
    let found = check(&start);
    let c = &found.check;
    assert!(c.sigmas_hold_calibration);
    let mut variance = [0.0; 3];
    let (mut distance, mut with_f) = (0.0, 0.0);
    for k in 0..3 {
        let side = |sign: f64| {
            let r = check(&stepped(&start, sign * f_px[k], camera[k].map(|x| sign * x), sheet[k].map(|x| sign * x)));
            let e = [r.check.offset_mm, r.check.tilt_deg[0], r.check.tilt_deg[1]];
            (e, r.record.unwrap().sheet.unwrap().distance_mm)
        };
        let (plus, minus) = (side(1.0), side(-1.0));
        (0..3).for_each(|a| variance[a] += ((plus.0[a] - minus.0[a]) / 2.0).powi(2));
        let moved = (plus.1 - minus.1) / 2.0;
        distance += moved * moved;
        with_f += moved * f_px[k];
    }
    let told = [
        c.offset_sigma_mm.powi(2) - c.offset_sigma_windows_mm.powi(2),
        c.tilt_sigma_deg[0].powi(2) - c.tilt_sigma_windows_deg[0].powi(2),
        c.tilt_sigma_deg[1].powi(2) - c.tilt_sigma_windows_deg[1].powi(2),
    ];
    println!(
        "variance by the calibration: told {told:?}, of moved calibrations {variance:?}; windows {:.2e} mm",
        c.offset_sigma_windows_mm
    );
    for a in 0..3 {
        // Windows at the limit of being used come and go between the moved calibrations: a fifth of the windows' sigma.
        let floor = 0.04
            * [
                c.offset_sigma_windows_mm.powi(2),
                c.tilt_sigma_windows_deg[0].powi(2),
                c.tilt_sigma_windows_deg[1].powi(2),
            ][a];
        assert!((told[a] - variance[a]).abs() < 0.05 * variance[a] + floor, "{a}: {told:?} {variance:?}");
    }
    assert!(told[0] > 20.0 * c.offset_sigma_windows_mm.powi(2), "the calibration's share must show");
    let record = found.record.unwrap();
    record.check().unwrap();
    let s = record.sheet.as_ref().unwrap();
    assert!((s.sigma.distance_mm / distance.sqrt() - 1.0).abs() < 0.05, "{} {}", s.sigma.distance_mm, distance.sqrt());
    // The new sheet's rows: their part along the normal with the image distance of the second camera.
    let (cov, n) = (&record.covariance, s.normal_in_rig);
    let f = cov.index("right.f_px").unwrap();
    let across: f64 = (0..3)
        .map(|k| n[k] * cov.matrix[cov.index(&format!("sheet.rig_from_sheet.{}", steps[3 + k])).unwrap()][f])
        .sum();
    assert!((across / with_f - 1.0).abs() < 0.05, "{across} {with_f}");
}
