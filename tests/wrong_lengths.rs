//! Two stated lengths of a target that contradict each other: told, since the one that sets the scale may be the wrong one.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod program;

use program::{example, spivcal};

#[test]
fn stated_lengths_that_contradict_each_other_are_told() {
    let scratch = tempfile::tempdir().unwrap();
    let rig = scratch.path().join("rig.toml");
    let text = std::fs::read_to_string(example("printed").join("rig.toml")).unwrap();
    // As they are; a distance that is a thirteenth too short; a radius that is a tenth too large.
    for (k, (spacing, radii, told)) in [
        ("26.0", "[12.5, 10.0]", None),
        ("24.0", "[12.5, 10.0]", Some(["radius of the first disc", "-7.7 %"])),
        ("26.0", "[12.5, 11.0]", Some(["radius of the second disc", "-9.1 %"])),
    ]
    .into_iter()
    .enumerate()
    {
        let stated = text.replace("spacing_mm = 26.0", &format!("spacing_mm = {spacing}\nradii_mm = {radii}"));
        assert_ne!(stated, text);
        std::fs::write(&rig, stated).unwrap();
        let (images, to) = (example("printed"), scratch.path().join(k.to_string()));
        let [rig, images, to] = [rig.as_path(), &images, &to].map(|p| p.to_str().unwrap());
        let out = spivcal(&["calibrate", rig, "--images", images, "-o", to]);
        let said = String::from_utf8_lossy(&out.stderr).to_string();
        println!("{spacing} {radii}: {}", said.trim_end());
        match told {
            None => assert_eq!(out.status.code(), Some(0), "{said}"),
            Some(words) => {
                assert_eq!(out.status.code(), Some(1), "{said}");
                assert!(words.iter().all(|w| said.contains(w)) && said.contains("contradict each other"), "{said}");
            }
        }
    }
}

/// Metres or inches in the place of millimetres, and the focal length of another lens: no lens images a sheet so near at that image distance.
#[test]
fn lengths_that_no_lens_agrees_with_are_told() {
    let scratch = tempfile::tempdir().unwrap();
    let rig = scratch.path().join("rig.toml");
    let text = std::fs::read_to_string(example("printed").join("rig.toml")).unwrap();
    assert!(text.contains("focal_length_mm"), "{text}");
    for (k, spacing) in ["0.026", "1.0236"].into_iter().enumerate() {
        std::fs::write(&rig, text.replace("spacing_mm = 26.0", &format!("spacing_mm = {spacing}"))).unwrap();
        let (images, to) = (example("printed"), scratch.path().join(k.to_string()));
        let [rig, images, to] = [rig.as_path(), &images, &to].map(|p| p.to_str().unwrap());
        let out = spivcal(&["calibrate", rig, "--images", images, "-o", to]);
        let said = String::from_utf8_lossy(&out.stderr).to_string();
        println!("{spacing}: {}", said.trim_end());
        assert_eq!(out.status.code(), Some(1), "{said}");
        assert!(said.contains("ask for a lens of about") && said.contains("in another unit than mm"), "{said}");
    }
}
