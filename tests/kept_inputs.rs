//! What was read stays: no command writes over its inputs, nor over a scene that somebody wrote.

#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod program;

use program::{example, spivcal};
use std::path::Path;

/// Runs the program in a folder, expects its refusal, and the file as it was.
#[track_caller]
fn kept(folder: &Path, file: &str, arguments: &[&str]) {
    let before = std::fs::read(folder.join(file)).unwrap();
    let count = || std::fs::read_dir(folder).unwrap().count();
    let files = count();
    let output =
        std::process::Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).current_dir(folder).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    println!("{}", said.trim_end());
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    assert!(said.contains(file) && said.contains("would be overwritten") && said.contains("-o"), "{said}");
    assert!(std::fs::read(folder.join(file)).unwrap() == before && count() == files, "{arguments:?}");
}

#[test]
fn a_scene_is_not_replaced() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name);
    std::fs::copy(example("printed").join("scene.toml"), at("rig.toml")).unwrap();
    kept(scratch.path(), "rig.toml", &["simulate", "rig.toml", "-o", "."]);
    std::fs::write(at("scene.toml"), "# mine\n").unwrap();
    kept(scratch.path(), "scene.toml", &["simulate", "--preset", "printed", "-o", "."]);
    // The scene of a preset is the program's own.
    let own = at("own");
    let arguments = ["simulate", "--preset", "printed", "-o", own.to_str().unwrap()];
    for _ in 0..2 {
        assert_eq!(spivcal(&arguments).status.code(), Some(0));
    }
}

#[test]
fn an_image_is_not_replaced() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let image = example("printed").join("v01_left.png");
    for name in ["calibration.png", "a.png", "a_overlay.png"] {
        std::fs::copy(&image, at(name)).unwrap();
    }
    kept(scratch.path(), "a_overlay.png", &["detect", "a.png", "a_overlay.png", "-o", "."]);
    std::fs::write(at("calibration.json"), "{ \"format\": \"spivcal-calibration\" }").unwrap();
    kept(scratch.path(), "calibration.json", &["detect", "calibration.png", "-o", "."]);
    // Results of an earlier search are replaced.
    for _ in 0..2 {
        let arguments =
            ["detect", at("a.png").to_str().unwrap(), "-o", scratch.path().to_str().unwrap()].map(String::from);
        std::fs::remove_file(at("a_overlay.png")).unwrap();
        assert_eq!(spivcal(&arguments.each_ref().map(String::as_str)).status.code(), Some(0));
    }
}

#[test]
fn the_images_of_a_rig_file_are_not_replaced() {
    let scratch = tempfile::tempdir().unwrap();
    let mut rig = std::fs::read_to_string(example("printed").join("rig.toml")).unwrap();
    for entry in std::fs::read_dir(example("printed")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if !name.ends_with(".png") {
            continue;
        }
        let number: usize = name[1..3].parse().unwrap();
        let overlay = format!("overlay_{:02}_{}", number - 1, &name[4..]);
        rig = rig.replace(name, &overlay);
        std::fs::copy(&path, scratch.path().join(overlay)).unwrap();
    }
    std::fs::write(scratch.path().join("rig.toml"), rig).unwrap();
    kept(scratch.path(), "overlay_00_left.png", &["calibrate", "rig.toml", "-o", "."]);
    let json = scratch.path().join("c");
    let rig = scratch.path().join("rig.toml");
    assert_eq!(spivcal(&["calibrate", rig.to_str().unwrap(), "-o", json.to_str().unwrap()]).status.code(), Some(0));
    // Views of `sheet` are counted after those of the calibration.
    let image = |n: usize| scratch.path().join(format!("overlay_0{n}_left.png"));
    std::fs::rename(image(5), image(6)).unwrap();
    let text = std::fs::read_to_string(&rig).unwrap();
    std::fs::write(&rig, text.replace("overlay_05_left", "overlay_06_left")).unwrap();
    let sheet = ["sheet", "rig.toml", "--calibration", "c/calibration.json", "-o", "."];
    kept(scratch.path(), "overlay_06_left.png", &sheet);
}
