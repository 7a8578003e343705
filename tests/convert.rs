//! `convert`: files of other packages, written, read, and refused.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod program;
mod real_sets;

use program::{example, spivcal};
use spivcal::record::Record;
use std::path::Path;

fn record(path: &Path) -> Record {
    Record::from_json(&std::fs::read_to_string(path).unwrap(), "c").unwrap()
}

fn convert(arguments: &[&str], expected: i32) -> String {
    let out = spivcal(&[&["convert"], arguments].concat());
    let said = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert_eq!(out.status.code(), Some(expected), "{arguments:?}: {said}");
    said
}

#[test]
fn a_calibration_goes_out_and_comes_back() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    let rig = example("printed").join("rig.toml");
    let out = spivcal(&["calibrate", rig.to_str().unwrap(), "-o", &path("c")]);
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    let json = path("c/calibration.json");
    for (format, file) in [("opencv", "opencv.yml"), ("opencv-xml", "opencv.xml")] {
        convert(&[&json, "--to", format, "-o", &path("out")], 0);
        convert(&["--from", "opencv", &path(&format!("out/{file}")), "-o", &path("back")], 0);
        let (a, b) = (record(Path::new(&json)), record(&scratch.path().join("back/calibration.json")));
        for (x, y) in a.cameras.iter().zip(&b.cameras) {
            assert_eq!((&x.name, x.image_size_px), (&y.name, y.image_size_px));
            assert!((x.f_px - y.f_px).abs() < 1e-8 && (x.beta_rad - y.beta_rad).abs() < 1e-12);
        }
        let (a, b) = (a.sheet.unwrap(), b.sheet.unwrap());
        assert!((a.distance_mm - b.distance_mm).abs() < 1e-9);
        assert!((a.angle_to_baseline_deg - b.angle_to_baseline_deg).abs() < 1e-9);
    }
    convert(&[&json, "--to", "csv", "-o", &path("tables")], 0);
    let table = std::fs::read_to_string(path("tables/covariance.csv")).unwrap();
    assert_eq!(table.lines().count(), record(Path::new(&json)).covariance.names.len() + 1);
    // Nor does a polynomial follow the camera exactly.
    let said = convert(&[&json, "--to", "soloff", "-o", &path("soloff")], 1);
    assert!(said.contains("the polynomials hold for x"), "{said}");
    let terms = std::fs::read_to_string(path("soloff/soloff_left.txt")).unwrap();
    assert!(terms.contains("\n2 1 0 ") && terms.contains("half_mm "), "{terms}");
    // No tilt in MATLAB's camera: a fit, whose loss is told and flagged where it is large.
    let said = convert(&[&json, "--to", "matlab", "-o", &path("m")], 1);
    assert!(said.contains("px rms") && said.contains("warning: camera 2"), "{said}");
    convert(&["--from", "opencv", &path("tables/sheet.csv"), "-o", &path("none")], 2);
    assert!(!scratch.path().join("none").exists());
    convert(&["--from", "openptv", &path("missing.ori"), "-o", &path("none")], 2);
    convert(&[&json], 2);
    convert(&[&json, "--from", "davis", "--image-size", "12by3"], 2);
}

/// Files of a real four-camera rig.
#[test]
fn real_openptv_orientations_are_read() {
    let Some(folder) = real_sets::folder("openptv_cavity") else { return };
    let scratch = tempfile::tempdir().unwrap();
    let to = scratch.path().to_str().unwrap();
    let files: Vec<String> = (1..=2).map(|k| folder.join(format!("cam{k}.tif.ori")).to_str().unwrap().into()).collect();
    let options = ["--image-size", "1280x1024", "--pixel-pitch-mm", "0.012"];
    let arguments: Vec<&str> =
        ["--from", "openptv", &files[0], &files[1], "-o", to].into_iter().chain(options).collect();
    let said = convert(&arguments, 0);
    assert!(said.contains("refractive indices"), "{said}");
    let r = record(&scratch.path().join("calibration.json"));
    // 70 mm over 12 um pixels; the distance of the centres in the first lines of the two files.
    assert!((r.cameras[0].f_px - 70.0 / 0.012).abs() < 1e-9);
    assert!(
        (r.rig.unwrap().baseline_mm - 196.638_449_353).abs() < 1e-6,
        "{:?}",
        r.cameras[1].cam_from_rig.translation_mm
    );
}
