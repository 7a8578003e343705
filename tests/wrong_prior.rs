//! A user's rig file that is wrong about the lens is told so by the program: words and exit code 1; a right one is not.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use std::path::Path;
use std::process::Command;

/// Exit code, error output, and `calibration.json` of `examples/printed` with more said about its first camera.
fn calibrated(more: &str) -> (i32, String, serde_json::Value) {
    let folder = tempfile::tempdir().unwrap();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/printed");
    let text = std::fs::read_to_string(example.join("rig.toml")).unwrap();
    let lens = "focal_length_mm = 50.0\n";
    assert!(text.contains(lens));
    std::fs::write(folder.path().join("rig.toml"), text.replacen(lens, &format!("{lens}{more}\n"), 1)).unwrap();
    let out = folder.path().join("out");
    let arguments = [
        "calibrate",
        folder.path().join("rig.toml").to_str().unwrap(),
        "--images",
        example.to_str().unwrap(),
        "-o",
        out.to_str().unwrap(),
    ]
    .map(String::from);
    let done = Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).output().unwrap();
    let words = String::from_utf8_lossy(&done.stderr).into_owned();
    println!("{words}");
    let json = std::fs::read_to_string(out.join("calibration.json")).unwrap();
    (done.status.code().unwrap(), words, serde_json::from_str(&json).unwrap())
}

#[test]
fn a_focal_length_five_sigmas_off_is_told() {
    // The scene was made with 8877.2 px.
    let (code, words, json) = calibrated("[camera.known]\nf_px = { value = 9327, sigma = 90 }");
    assert_eq!(code, 1, "{words}");
    for word in
        ["focal length f of camera left", "9327", "images alone say", "standard deviations apart", "[camera.known]"]
    {
        assert!(words.contains(word), "{word:?} is not in: {words}");
    }
    let prior = json["fit"]["diagnosis"]["priors"].as_array().unwrap().iter().find(|p| p["conflict"] == true).unwrap();
    assert!((prior["z"].as_f64().unwrap().abs() - 5.0).abs() < 0.3, "{prior}");
    assert!((prior["images_alone"].as_f64().unwrap() - 8877.2).abs() < 30.0, "{prior}");
}

#[test]
fn a_right_focal_length_and_a_right_drawing_are_not() {
    let (code, words, _) = calibrated("[camera.known]\nf_px = { value = 8900, sigma = 90 }");
    assert_eq!(code, 0, "{words}");
    // As the scene was drawn: the sheet is nearer on the left.
    let drawing =
        "[camera.design]\nobject_distance_mm = 506.0\nviewing_angle_deg = -44.3\nf_sigma = 0.01\ntilt_sigma_deg = 0.5";
    let (code, words, json) = calibrated(drawing);
    assert_eq!(code, 0, "{words}");
    let priors = json["fit"]["diagnosis"]["priors"].as_array().unwrap();
    assert_eq!(priors.iter().filter(|p| p["stated"] == true).count(), 3);
}

#[test]
fn a_length_without_a_sigma_is_taken_as_exact() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/bubbles/rig.toml");
    let done =
        Command::new(env!("CARGO_BIN_EXE_spivcal")).arg("calibrate").arg(rig).arg("-o").arg(folder.path()).output();
    let words = String::from_utf8_lossy(&done.unwrap().stdout).into_owned();
    // Where the scale comes from, and among what was known beforehand.
    assert_eq!(words.matches("26 mm, taken as exact").count(), 2, "{words}");
}
