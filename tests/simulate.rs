//! What `simulate` writes is read by the rooms that read rig files and calibrations.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use spivcal::record::Record;
use spivcal::rig_file::{Length, RigDescription, Scale};
use spivcal::simulate::{PRESETS, Scene};
use spivcal::target::Target;

#[test]
fn every_preset_gives_a_rig_file_and_a_truth_that_can_be_read() {
    for (name, text) in PRESETS {
        let scene = Scene::parse(text, name).unwrap();
        let rig = RigDescription::parse(&scene.rig_toml(), "rig.toml").unwrap();
        let truth = Record::from_json(&scene.truth_json().unwrap(), "truth.json").unwrap();
        assert_eq!((rig.views.len(), truth.views.len()), (scene.views(), scene.views()), "{name}");
        assert_eq!(rig.cameras.len(), truth.cameras.len());
        for (described, view) in rig.views.iter().zip(&truth.views) {
            assert_eq!(described.sheet, view.in_sheet, "{name}");
        }
        let baseline = truth.rig.as_ref().unwrap().baseline_mm;
        assert!((baseline - 707.1).abs() < 5.0, "{name}: {baseline}");
    }
}

#[test]
fn every_way_to_set_the_scale_is_understood() {
    let bubbles = PRESETS.iter().find(|(n, _)| *n == "bubbles").unwrap().1;
    for word in ["baseline", "view-radius", "view-spacing"] {
        for sigma in ["", "scale_sigma_mm = 0.05\n"] {
            let text = bubbles.replace("scale = \"view-spacing\"\n", &format!("scale = \"{word}\"\n{sigma}"));
            let rig = Scene::parse(&text, "scene.toml").unwrap().rig_toml();
            RigDescription::parse(&rig, "rig.toml").unwrap_or_else(|e| panic!("{word}: {e}\n{rig}"));
        }
    }
    let grid = PRESETS.iter().find(|(n, _)| *n == "dot-grid").unwrap().1;
    let told = grid.replace("[rig]", "[rig]\nscale_sigma_mm = 0.002");
    let rig = RigDescription::parse(&Scene::parse(&told, "scene.toml").unwrap().rig_toml(), "rig.toml").unwrap();
    assert!(matches!(rig.scale, Scale::TargetSpacing(Length { sigma_mm: Some(0.002), .. })), "{:?}", rig.scale);
    let plate = PRESETS.iter().find(|(n, _)| *n == "two-level-plate").unwrap().1;
    let known =
        plate.replace("[rig]", "[rig]\nradii_known = true\nfocus = { tilt_sigma_deg = 0.5, distance_sigma = 0.005 }");
    let rig = RigDescription::parse(&Scene::parse(&known, "scene.toml").unwrap().rig_toml(), "rig.toml").unwrap();
    match rig.target.target {
        Target::TwoLevelPlate(p) => assert_eq!((p.radius_mm, p.step_mm, p.marks.len()), (Some(0.8), 1.2, 2)),
        other => panic!("{other:?}"),
    }
    assert!(rig.focus.is_some() && rig.views.iter().all(|v| v.plane_z_mm.is_some()));
}

/// One camera alone does not measure the sheet, and a rig file that says so would be refused.
#[test]
fn a_scene_with_one_camera_gives_a_rig_file_that_can_be_read() {
    let text = PRESETS.iter().find(|(n, _)| *n == "printed").unwrap().1;
    let (second, rest) = (text.rfind("[[camera]]").unwrap(), text.find("[sheet]").unwrap());
    let scene = Scene::parse(&format!("{}{}", &text[..second], &text[rest..]), "scene.toml").unwrap();
    let rig = RigDescription::parse(&scene.rig_toml(), "rig.toml").unwrap();
    assert!(rig.cameras.len() == 1 && rig.views.len() == scene.views() && rig.views.iter().all(|v| !v.sheet));
}
