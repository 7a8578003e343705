//! `sheet`: the plane again from the calibration's own images, and what is refused.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod program;

use program::{example, spivcal};
use spivcal::record::Record;
use std::path::Path;
use std::process::Output;

fn record(folder: &Path) -> Record {
    Record::from_json(&std::fs::read_to_string(folder.join("calibration.json")).unwrap(), "c").unwrap()
}

/// Calibrates an example into `to`.
fn calibrated(name: &str, to: &Path) {
    let out = spivcal(&["calibrate", example(name).join("rig.toml").to_str().unwrap(), "-o", to.to_str().unwrap()]);
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
}

fn sheet(rig: &Path, images: &Path, calibration: &Path, to: &Path) -> Output {
    let path = |p: &Path| p.to_str().unwrap().to_string();
    let arguments =
        ["sheet", &path(rig), "--images", &path(images), "--calibration", &path(calibration), "-o", &path(to)];
    spivcal(&arguments)
}

#[test]
fn the_sheet_of_the_calibration_is_found_again() {
    for (name, views) in [("printed", vec![6]), ("bubbles", vec![8, 9, 10])] {
        let scratch = tempfile::tempdir().unwrap();
        let (first, second) = (scratch.path().join("first"), scratch.path().join("second"));
        calibrated(name, &first);
        let out = sheet(&example(name).join("rig.toml"), &example(name), &first.join("calibration.json"), &second);
        assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
        let (old, new) = (record(&first), record(&second));
        assert_eq!(old.cameras, new.cameras);
        let (a, b) = (old.sheet.clone().unwrap(), new.sheet.clone().unwrap());
        assert_eq!((b.method.as_str(), &b.views), ("homography", &views));
        assert_eq!(new.views.len(), old.views.len() + views.len());
        for k in 0..3 {
            let apart = (a.abc_per_mm[k] - b.abc_per_mm[k]).abs();
            let (sa, sb) = (a.sigma.abc_per_mm[k], b.sigma.abc_per_mm[k]);
            println!("{name} {k}: apart {apart:.2e}, sigmas {sa:.2e} {sb:.2e}");
            assert!(apart < sb, "{name} {k}: {apart} {sb}");
            // The same images and the same cameras: what is known is about the same.
            assert!((0.5..2.0).contains(&(sb / sa)), "{name} {k}: {sa} {sb}");
        }
        assert!(b.disparity_rms_px.unwrap() < 0.1);
        assert_eq!(new.covariance.names.iter().filter(|n| n.starts_with("sheet.")).count(), 6);
        // Nor are displacements, though cameras and sheet are wrong together.
        let gain = |r: &Record| r.mapping_uncertainty.as_ref().unwrap().middle.out_of_plane_gain;
        println!("{name}: out-of-plane gain {:.2e} {:.2e}", gain(&old), gain(&new));
        assert!((0.7..1.5).contains(&(gain(&new) / gain(&old))), "{} {}", gain(&new), gain(&old));
        for file in ["report.html", &format!("overlay_{:02}_left.png", views[0])] {
            assert!(second.join(file).exists(), "{file}");
        }
        // Again, from its own result: nothing piles up.
        let third = scratch.path().join("third");
        let out = sheet(&example(name).join("rig.toml"), &example(name), &second.join("calibration.json"), &third);
        assert_eq!(out.status.code(), Some(0));
        assert_eq!(record(&third).to_json().unwrap(), new.to_json().unwrap());
    }
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let scratch = tempfile::tempdir().unwrap();
    let (good, out) = (scratch.path().join("good"), scratch.path().join("out"));
    calibrated("printed", &good);
    let calibration = good.join("calibration.json");
    let (folder, text) = (example("printed"), std::fs::read_to_string(example("printed").join("rig.toml")).unwrap());
    let rig = scratch.path().join("rig.toml");
    let refused = |rig_text: &str, calibration: &Path, code: i32, words: &[&str]| {
        std::fs::write(&rig, rig_text).unwrap();
        let output = sheet(&rig, &folder, calibration, &out);
        let said = String::from_utf8_lossy(&output.stderr).to_string();
        println!("{}", said.trim_end());
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(words.iter().all(|w| said.contains(w)), "{words:?}: {said}");
        assert!(!out.exists(), "something was written");
    };
    refused(&text.replace("sheet = true", "sheet = false"), &calibration, 2, &["sheet = true in every [[view]]"]);
    let renamed = text.replace("name = \"left\"", "name = \"west\"").replace("\nleft = ", "\nwest = ");
    refused(&renamed, &calibration, 2, &["west", "left", "name the cameras as there"]);
    refused(&text, &scratch.path().join("none.json"), 2, &["no such file"]);
    refused(&text, &rig, 2, &["rig.toml"]);
    let alone = text.replace("right = \"v06_right.png\"\n", "");
    refused(&alone, &calibration, 2, &["both cameras", "sheet = true"]);
    let json = std::fs::read_to_string(&calibration).unwrap();
    let other = scratch.path().join("other.json");
    let mut record = Record::from_json(&json, "c").unwrap();
    record.cameras[1].image_size_px = [1280, 1024];
    std::fs::write(&other, record.to_json().unwrap()).unwrap();
    refused(&text, &other, 2, &["v06_right.png", "1024 x 768", "1280 x 1024", "calibrate anew"]);
    // A camera that moved by a twentieth of a millimetre: a disagreement far below a pixel, and far above what contours explain.
    let mut record = Record::from_json(&json, "c").unwrap();
    record.cameras[1].cam_from_rig.translation_mm[1] += 0.05;
    (record.rig, record.sheet) = (None, None);
    std::fs::write(&other, record.to_json().unwrap()).unwrap();
    std::fs::write(&rig, &text).unwrap();
    let moved = scratch.path().join("moved");
    let output = sheet(&rig, &folder, &other, &moved);
    let said = String::from_utf8_lossy(&output.stderr).to_string();
    println!("{}", said.trim_end());
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("times as much as contours and cameras explain"), "{said}");
    // A camera that was turned: the discs meet nowhere near a plane, or transfer badly.
    let mut record = Record::from_json(&json, "c").unwrap();
    record.cameras[1].cam_from_rig.translation_mm[1] += 5.0;
    (record.rig, record.sheet) = (None, None);
    std::fs::write(&other, record.to_json().unwrap()).unwrap();
    std::fs::write(&rig, &text).unwrap();
    let output = sheet(&rig, &folder, &other, &out);
    let said = String::from_utf8_lossy(&output.stderr).to_string();
    println!("{}", said.trim_end());
    assert!(matches!(output.status.code(), Some(1 | 3)), "{said}");
    assert!(said.contains("disagree by") || said.contains("cannot be told") || said.contains("do not meet"), "{said}");
}
