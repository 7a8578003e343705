//! Rendered particles in a sheet that is off and tilted: the check finds it, within its own sigmas, and refuses what has no particles.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use nalgebra::Vector3;
use spivcal::disparity::{CheckOptions, CheckOutput, ParticlePair, check_sheet};
use spivcal::frames::{Rig, Sheet};
use spivcal::image::GrayImage;
use spivcal::record::Record;
use spivcal::simulate::{Scene, simulate_particles};
use std::process::Command;

/// Two cameras, particles, and a sheet in its place.
fn scene(seed: u64, offset_mm: f64, tilt_deg: [f64; 2], thickness_mm: f64, pairs: usize) -> Scene {
    let camera = |name: &str, angle: f64| {
        format!(
            "[[camera]]\nname = \"{name}\"\nimage_size_px = [640, 512]\npixel_pitch_mm = 0.0125\nfocal_length_mm = 50.0\nscheimpflug = true\n\
             k = [-0.05, 0.0, 0.0]\naim = {{ distance_mm = 500.0, viewing_angle_deg = {angle:?} }}\n"
        )
    };
    let text = format!(
        "seed = {seed}\n{}{}[sheet]\noffset_mm = {offset_mm:?}\ntilt_deg = {tilt_deg:?}\n[target]\nkind = \"two-discs\"\npolarity = \"bright\"\n\
         radii_mm = [8.0, 6.0]\nspacing_mm = 18.0\n[image]\nbits = 12\nblur_sigma_px = 0.9\nfull_well_e = 20000.0\nread_noise_e = 20.0\n\
         [[view]]\n[particles]\npairs = {pairs}\nper_mm2 = 1.5\nthickness_mm = {thickness_mm:?}\n",
        camera("left", -42.0),
        camera("right", 35.0)
    );
    Scene::parse(&text, "scene.toml").unwrap()
}

fn truth(scene: &Scene) -> Record {
    Record::from_json(&scene.truth_json().unwrap(), "truth.json").unwrap()
}

fn pairs(images: &[(String, GrayImage)]) -> Vec<ParticlePair<'_>> {
    images
        .chunks_exact(2)
        .map(|p| ParticlePair { images: [p[0].1.view(), p[1].1.view()], names: [p[0].0.clone(), p[1].0.clone()] })
        .collect()
}

/// Where the true sheet lies in the frame of the one that was started from: `z = a + b x + c y`.
fn plane(start: &Record, now: &Record) -> Vector3<f64> {
    let pose = |r: &Record| r.sheet.as_ref().unwrap().rig_from_sheet.motion::<Rig, Sheet>();
    let m = pose(start).inverse() * pose(now);
    let n = m.rotation.column(2);
    let (b, c) = (-n.x / n.z, -n.y / n.z);
    Vector3::new(m.translation_mm.z - b * m.translation_mm.x - c * m.translation_mm.y, b, c)
}

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
    let (code, said) = run(&["check", &c, "--pairs", &at("q*.png"), &r, "-o", &o]);
    assert!(code == 2 && said.contains("no file matches"), "{said}");
    std::fs::remove_file(at("p02_right.png")).unwrap();
    let (code, said) = run(&["check", &c, "--pairs", &l, &r, "-o", &o]);
    assert!(code == 2 && said.contains("every moment needs one image"), "{said}");
}
