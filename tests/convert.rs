//! `convert`: files of other packages, written, read, and refused.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod program;
mod real_sets;

use nalgebra::Vector3;
use program::{example, spivcal};
use spivcal::frames::{Rig, Sheet, Target};
use spivcal::record::Record;
use spivcal::rigid::Motion;
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

/// Calibrates `examples/printed` into a folder; the path of its calibration.json.
fn calibrate_printed(folder: &str) -> String {
    let rig = example("printed").join("rig.toml");
    let out = spivcal(&["calibrate", rig.to_str().unwrap(), "-o", folder]);
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    format!("{folder}/calibration.json")
}

#[test]
fn a_calibration_goes_out_and_comes_back() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    let json = calibrate_printed(&path("c"));
    for (format, file) in [("opencv", "opencv.yml"), ("opencv-xml", "opencv.xml")] {
        convert(&[&json, "--to", format, "-o", &path("out")], 0);
        convert(&["--from", "opencv", &path(&format!("out/{file}")), "-o", &path("back")], 0);
        let (a, b) = (record(Path::new(&json)), record(&scratch.path().join("back/calibration.json")));
        for (x, y) in a.cameras.iter().zip(&b.cameras) {
            assert_eq!((&x.name, x.image_size_px), (&y.name, y.image_size_px));
            assert!((x.f_px - y.f_px).abs() < 1e-8 && (x.beta_rad - y.beta_rad).abs() < 1e-12);
        }
        let out = spivcal(&["show", &path("back/calibration.json")]);
        let said = String::from_utf8_lossy(&out.stdout).into_owned();
        assert!(said.contains("as another program found them") && !said.contains("GOOD"), "{said}");
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
    let terms =
        |file: &str| std::fs::read_to_string(path(file)).unwrap().lines().filter(|l| !l.starts_with('#')).count();
    assert_eq!(terms("soloff/soloff_left.txt"), 3 + 19);
    convert(&[&json, "--to", "soloff", "--soloff-degrees", "2,1", "-o", &path("low")], 1);
    assert_eq!(terms("low/soloff_left.txt"), 3 + 9);
    let said = convert(&[&json, "--to", "soloff", "--soloff-degrees", "5,1", "-o", &path("none")], 2);
    assert!(said.contains("2 or 3 in x and y"), "{said}");
    for ignored in [["--image-size", "640x480"], ["--pixel-pitch-mm", "0.01"]] {
        let said = convert(&[&[&json, "--to", "csv", "-o", &path("none")][..], &ignored].concat(), 2);
        assert!(said.contains("are for --from") && said.contains("leave them out with --to"), "{said}");
    }
    let said = convert(&[&json, "--to", "csv", "--soloff-degrees", "2,1", "-o", &path("none")], 2);
    assert!(said.contains("--to soloff"), "{said}");
    // No tilt in MATLAB's camera: a fit, whose loss is told and flagged where it is large.
    let said = convert(&[&json, "--to", "matlab", "-o", &path("m")], 1);
    assert!(said.contains("px rms") && said.contains("warning: camera 2"), "{said}");
    convert(&["--from", "opencv", &path("tables/sheet.csv"), "-o", &path("none")], 2);
    assert!(!scratch.path().join("none").exists());
    convert(&["--from", "openptv", &path("missing.ori"), "-o", &path("none")], 2);
    convert(&[&json], 2);
    convert(&[&json, "--from", "davis", "--image-size", "12by3"], 2);
}

/// Camera names that differ in punctuation only get files of their own.
#[test]
fn files_of_cameras_with_alike_names_are_told_apart() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    let text = std::fs::read_to_string(example("printed").join("truth.json")).unwrap();
    let mut record = Record::from_json(&text, "truth").unwrap();
    let names = ["cam-1", "cam_1"];
    for (c, name) in record.cameras.iter_mut().zip(names) {
        c.name = name.into();
        c.pixel_pitch_mm = Some(0.00625);
    }
    record.views.clear();
    std::fs::write(path("c.json"), record.to_json().unwrap()).unwrap();
    for (format, files) in
        [("soloff", vec!["soloff_cam_1.txt", "soloff_cam_1_2.txt"]), ("openptv", vec!["cam_1.ori", "cam_1_2.ori"])]
    {
        let said = spivcal(&["convert", &path("c.json"), "--to", format, "-o", &path(format)]);
        assert!(said.status.code().unwrap() < 2, "{}", String::from_utf8_lossy(&said.stderr));
        for file in files {
            assert!(scratch.path().join(format).join(file).exists(), "{file}");
        }
    }
    // Tables need no plane.
    record.sheet = None;
    std::fs::write(path("c.json"), record.to_json().unwrap()).unwrap();
    convert(&[&path("c.json"), "--to", "csv", "-o", &path("tables")], 0);
    assert!(scratch.path().join("tables/cameras.csv").exists());
}

/// The two files of OpenCV's stereo sample are one calibration, without a laser sheet.
#[test]
fn the_files_of_the_stereo_sample_are_read() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    let matrix = |key: &str, rows: usize, data: &[f64]| {
        let numbers: Vec<String> = data.iter().map(|x| format!("{x:?}")).collect();
        let columns = data.len() / rows;
        format!(
            "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {} ]\n",
            numbers.join(", ")
        )
    };
    let lens = [800.0, 0.0, 320.0, 0.0, 800.0, 240.0, 0.0, 0.0, 1.0];
    let bent = [-0.2, 0.05, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let intrinsics = [matrix("M1", 3, &lens), matrix("D1", 1, &bent), matrix("M2", 3, &lens), matrix("D2", 1, &bent)];
    let extrinsics = [
        matrix("R", 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        matrix("T", 3, &[-60.0, 0.0, 0.0]),
        matrix("R1", 3, &lens),
    ];
    std::fs::write(path("intrinsics.yml"), format!("%YAML:1.0\n---\n{}", intrinsics.concat())).unwrap();
    std::fs::write(path("extrinsics.yml"), format!("%YAML:1.0\n---\n{}", extrinsics.concat())).unwrap();
    let both = [path("intrinsics.yml"), path("extrinsics.yml")];
    let given = ["--from", "opencv", &both[0], &both[1], "-o", &path("back")].map(String::from);
    let given: Vec<&str> = given.iter().map(String::as_str).collect();
    let said = convert(&given, 2);
    assert!(said.contains("image size") && said.contains("--image-size") && !said.contains(":0:"), "{said}");
    let out = spivcal(&[&["convert"], &given[..], &["--image-size", "640x480"]].concat());
    let said = String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code().unwrap() < 2 && said.contains("spivcal sheet"), "{said}");
    let r = record(&scratch.path().join("back/calibration.json"));
    assert!(r.sheet.is_none() && (r.rig.unwrap().baseline_mm - 60.0).abs() < 1e-9);
    let said = String::from_utf8_lossy(&spivcal(&["show", &path("back/calibration.json")]).stdout).into_owned();
    assert!(!said.contains("laser sheet lies"), "{said}");
    let said = convert(&["--from", "opencv", &both[0], "--image-size", "640x480", "-o", &path("none")], 2);
    assert!(said.contains("matrix R") && said.contains("give both files") && !said.contains(":0:"), "{said}");
    std::fs::write(path("extrinsics.yml"), format!("%YAML:1.0\n---\n{}", matrix("R", 3, &lens))).unwrap();
    let said = convert(&[&given[..], &["--image-size", "640x480"]].concat(), 2);
    assert!(said.contains("extrinsics.yml:3: R is not a rotation"), "{said}");
}

/// The sheet frame moved and turned in its plane: the same light and cameras, numbers along the new axes.
#[test]
fn the_sheet_frame_is_placed_and_placed_back() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    let json = calibrate_printed(&path("c"));
    // One view in the sheet is too few for the others to tell of it.
    let factors = [[1.1, 1.2, 1.3], [1.4, 1.6, 1.5], [1.8, 1.7, 1.9]];
    let mut with_views: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    with_views["mapping_uncertainty"]["by_views"] = serde_json::json!({
        "beyond_noise": true, "disparity": 2.0, "in_plane": 2.1, "in_plane_scale": 2.2, "out_of_plane_gain": 2.3, "displacement": factors,
    });
    std::fs::write(&json, format!("{with_views:#}")).unwrap();
    convert(&[&json, "--to", "spivcal", "--origin-mm", "5,-2", "--turn-deg", "90", "-o", &path("a")], 0);
    let (old, new) = (record(Path::new(&json)), record(Path::new(&path("a/calibration.json"))));
    let (s, t) = (old.sheet.as_ref().unwrap(), new.sheet.as_ref().unwrap());
    let (f, g) = (s.rig_from_sheet.motion::<Rig, Sheet>(), t.rig_from_sheet.motion::<Rig, Sheet>());
    // The new (x, y) = (1, 2) is the old (5 - 2, -2 + 1).
    let (p, q) = (g.apply(&Vector3::new(1.0, 2.0, 0.3)), f.apply(&Vector3::new(3.0, -1.0, 0.3)));
    assert!((p - q).norm() < 1e-9, "{p} {q}");
    assert!(
        (s.distance_mm - t.distance_mm).abs() < 1e-9 && (t.angles_deg[2].abs() - 90.0).abs() < 5.0,
        "{:?}",
        t.angles_deg
    );
    // A quarter turn exchanges the axes, and with them their sigmas.
    let (a, b) = (s.sigma.normal_rad, t.sigma.normal_rad);
    assert!((a[0] / b[1] - 1.0).abs() < 1e-3 && (a[1] / b[0] - 1.0).abs() < 1e-3, "{a:?} {b:?}");
    assert_eq!((s.sigma.distance_mm, old.covariance.names.len()), (t.sigma.distance_mm, new.covariance.names.len()));
    convert(&[&path("a/calibration.json"), "--to", "spivcal", "--turn-deg", "-90", "-o", &path("b")], 0);
    convert(&[&path("b/calibration.json"), "--to", "spivcal", "--origin-mm", "-5,2", "-o", &path("b2")], 0);
    let back = record(Path::new(&path("b2/calibration.json")));
    let t = back.sheet.as_ref().unwrap();
    let h = t.rig_from_sheet.motion::<Rig, Sheet>();
    assert!((h.translation_mm - f.translation_mm).norm() < 1e-9 && (h.rotation - f.rotation).norm() < 1e-12);
    for k in 0..3 {
        let (a, b) = (s.sigma.angles_deg[k], t.sigma.angles_deg[k]);
        assert!((a - b).abs() < 1e-3 * a + 1e-9, "{:?} {:?}", s.sigma, t.sigma);
    }
    // What is felt in the sheet is told at the same points of it, along the new axes.
    let middle = |r: &Record| r.mapping_uncertainty.as_ref().unwrap().middle.clone();
    let (was, turned, again) = (middle(&old), middle(&new), middle(&back));
    let place = |m: &Motion<Rig, Sheet>, p: [f64; 2]| m.apply(&Vector3::new(p[0], p[1], 0.0));
    let off = place(&g, turned.point_mm) - place(&f, was.point_mm);
    assert!(off.norm() < 0.5, "{off}: {:?} {:?}", was.point_mm, turned.point_mm);
    let alike = |a: f64, b: f64| (a / b - 1.0).abs() < 0.02;
    let (d, e) = (&was.displacement, &turned.displacement);
    assert!(alike(d[0][0], e[1][1]) && alike(d[1][1], e[0][0]) && alike(d[0][2], e[1][2]), "{d:?} {e:?}");
    assert!(alike(was.disparity_px, turned.disparity_px) && alike(d[2][2], e[2][2]), "{was:?} {turned:?}");
    // What the views say of it goes with it: of axes that were turned the larger factor.
    let by_views = |r: &Record| r.mapping_uncertainty.as_ref().unwrap().by_views.clone().unwrap();
    let told = by_views(&new);
    assert_eq!(told.displacement, [[1.6, 1.6, 1.5], [1.6, 1.6, 1.5], [1.8, 1.8, 1.9]]);
    assert_eq!((told.disparity, told.in_plane, told.beyond_noise), (2.0, 2.1, true));
    assert!((0..2).all(|k| (was.point_mm[k] - again.point_mm[k]).abs() < 1e-6), "{was:?} {again:?}");
    assert!((was.disparity_px / again.disparity_px - 1.0).abs() < 1e-3, "{was:?} {again:?}");
    convert(&[&json, "--to", "spivcal", "--origin-mm", "5,-2", "-o", &path("s")], 0);
    assert_eq!(by_views(&record(Path::new(&path("s/calibration.json")))).displacement, factors, "shifted, not turned");
    // On the target of a view: its origin has x = y = 0, its x axis y = 0.
    let said = convert(&[&json, "--to", "spivcal", "--frame-of-view", "0", "-o", &path("v")], 0);
    assert!(said.contains("calibration.json"), "{said}");
    let v = record(Path::new(&path("v/calibration.json")));
    let at = v.sheet.as_ref().unwrap().rig_from_sheet.motion::<Rig, Sheet>().inverse()
        * v.views[0].rig_from_target.unwrap().motion::<Rig, Target>();
    assert!(
        at.translation_mm.xy().norm() < 1e-9 && at.rotation[(1, 0)].abs() < 1e-12 && at.rotation[(0, 0)] > 0.0,
        "{at:?}"
    );
    for (options, words) in [
        (vec!["--frame-of-view", "77"], "view 77"),
        (vec!["--origin-mm", "5"], "two numbers"),
        (vec!["--frame-of-view", "0", "--turn-deg", "3"], "cannot be used with"),
        (vec!["--turn-deg", "inf"], "a number"),
    ] {
        let said = convert(&[&[json.as_str(), "--to", "spivcal", "-o", &path("none")][..], &options].concat(), 2);
        assert!(said.contains(words), "{said}");
    }
    let said = convert(&[&json, "--to", "spivcal", "--turn-deg", "3", "-o", &path("c")], 2);
    assert!(said.contains("would be overwritten"), "{said}");
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
