//! `simulate`: synthetic images with truth, and a rig file ready to calibrate.

use super::Done;
use super::arguments::Simulate;
use super::files::{Output, read_text};
use super::progress::Bar;
use crate::error::Result;
use crate::pipeline::png_bytes;
use crate::simulate::{Scene, preset_text, simulate};
use serde_json::json;

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
    out.commit(&command.output)?;
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
