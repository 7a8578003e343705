//! `simulate`: synthetic images with truth, and a rig file ready to calibrate.

use super::Done;
use super::arguments::Simulate;
use super::files::{Output, can_write, fault, read_text};
use super::progress::Bar;
use crate::error::{Error, Invalid, Result};
use crate::pipeline::png_bytes;
use crate::rig_file::RigDescription;
use crate::simulate::{PRESETS, Scene, preset_text, simulate};
use serde_json::json;
use std::path::Path;

pub(super) fn run(command: &Simulate, progress: &Bar) -> Result<Done> {
    let (scene, preset) = match (&command.scene, &command.preset) {
        (Some(path), _) => {
            let text = read_text(path, "a scene file (TOML)")?;
            (Scene::parse(&text, &path.display().to_string())?, None)
        }
        (None, name) => {
            let name = name.as_deref().unwrap_or_default();
            (Scene::preset(name)?, preset_text(name))
        }
    };
    can_be_calibrated(&scene, command.scene.as_deref())?;
    can_write(&command.output)?;
    if preset.is_some() {
        spare_scene(&command.output.join("scene.toml"))?;
    }
    progress.stage("rendering views", scene.views());
    let simulation = simulate(&scene)?;
    let mut out = Output::default();
    for (name, image) in &simulation.images {
        out.add(name, png_bytes(image)?);
    }
    out.add("rig.toml", simulation.rig_toml);
    out.add("truth.json", simulation.truth_json);
    if let Some(text) = preset {
        out.add("scene.toml", text);
    }
    let json = json!({ "output": command.output.display().to_string(), "files": out.names() });
    out.commit_beside(&command.output, &command.scene.iter().map(AsRef::as_ref).collect::<Vec<&Path>>())?;
    let rig = command.output.join("rig.toml");
    let text = format!(
        "{} images of {} views in {}\nnext: spivcal calibrate {} -o OUT\n",
        simulation.images.len(),
        scene.views(),
        command.output.display(),
        rig.display()
    );
    Ok(Done { text, json, flags: Vec::new() })
}

/// Refuses a scene whose rig file nothing can be made of.
fn can_be_calibrated(scene: &Scene, file: Option<&Path>) -> Result<()> {
    let file = file.map_or("the preset".into(), |f| f.display().to_string());
    match RigDescription::parse(&scene.rig_toml(), "rig.toml") {
        Err(Error::Invalid(Invalid::Syntax { message, .. })) => {
            let message = format!(
                "of the scene a rig.toml would come that is refused ({message}); change [rig], [target] or names and views of the scene accordingly"
            );
            Err(Invalid::File { path: file, message }.into())
        }
        other => other.map(|_| ()),
    }
}

/// Refuses to write a preset's scene over one that somebody wrote or changed.
fn spare_scene(place: &Path) -> Result<()> {
    match std::fs::read(place) {
        Ok(old) if PRESETS.iter().all(|(_, text)| text.as_bytes() != old) => Err(fault(
            place,
            "this scene, which is no preset, would be overwritten by that of the preset; name another folder with -o",
        )),
        _ => Ok(()),
    }
}
