//! Synthetic images with their truth: discs, bubbles, grids and plates rendered through the exact camera.
//!
//! A scene file (keys in `docs/simulate.md`) says cameras, sheet, target, views and light; from it come the images,
//! the true values in the shape of a calibration, and a rig file ready to calibrate. The same scene gives the same bits
//! on every run. The rendering and its errors are described in `render.rs`, the light in `light.rs`, the sensor in
//! `sensor.rs`, frames and the focused tilt in `setup.rs`.
//!
//! Bubbles stand here for what a laser sheet shows of soap bubbles or droplets filled with smoke: bright circles in the plane
//! of the sheet, each pair with radii and a spacing of its own.
//!
//! With a table `[particles]` the scene also gives images of particles in a sheet of finite thickness (`particles.rs`).
//!
//! Not modelled: defocus (one point spread for the whole image), refraction, occlusion by other bodies, the
//! thickness of the sheet where targets stand in it.

mod check;
mod light;
mod particles;
mod pattern;
mod preset;
mod random;
mod render;
mod rig;
mod scene;
mod sensor;
mod setup;
mod truth;

pub use preset::PRESETS;

use crate::error::{Invalid, Result, in_plain_types};
use crate::image::GrayImage;
use crate::target::TargetKind as Kind;
use check::Lines;
use light::{Smoke, Uneven};
use nalgebra::Vector2;
use particles::Particles;
use render::Figure;
use scene::{SceneFile, syntax};
use serde::Deserialize;
use setup::Setup;

/// A scene that has been read and found possible.
#[derive(Debug, Clone)]
pub struct Scene {
    file: SceneFile,
    setup: Setup,
}

/// What a scene gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// Names of the image files (PNG) and the images: 8 bit, or 9 to 16 bit in 16.
    pub images: Vec<(String, GrayImage)>,
    /// Text of `rig.toml`, ready to calibrate; its image names are those of `images`.
    pub rig_toml: String,
    /// Text of `truth.json`: the true values in the shape of a calibration, and per view the discs in every image.
    pub truth_json: String,
}

impl Scene {
    /// Read a scene from the text of its file; `file` is its name in messages.
    ///
    /// # Errors
    /// [`Invalid::Syntax`] with file and line where a key is unknown, a value has no meaning or a camera does not see a
    /// listed view; [`crate::error::Insufficient::Degenerate`] where no pose within the `[random]` ranges can be seen.
    ///
    /// ```
    /// let text = spivcal::simulate::preset_text("printed").expect("a preset");
    /// assert!(spivcal::simulate::Scene::parse(text, "printed").is_ok());
    /// let wrong = text.replace("[target]", "[target]\ncolour = 'red'");
    /// let message = spivcal::simulate::Scene::parse(&wrong, "scene.toml").unwrap_err().to_string();
    /// assert!(message.contains("scene.toml:") && message.contains("colour"));
    /// ```
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let lines = Lines::new(text, file)?;
        let refused = |at: usize, message: &str| syntax(file, check::line_at(text, at), message.trim());
        let start = |e: &toml::de::Error| e.span().map_or(0, |s| s.start);
        let reader = toml::Deserializer::parse(text).map_err(|e| refused(start(&e), e.message()))?;
        let scene = SceneFile::deserialize(reader).map_err(|mut e| {
            let at = start(&e);
            // Without its text the reader tells the key instead.
            e.set_input(None);
            let told = e.to_string();
            let (words, path) = told.split_once("\nin `").unwrap_or((&told, ""));
            let (words, path) = (in_plain_types(words), path.trim().trim_end_matches('`'));
            refused(at, &if path.is_empty() { words } else { format!("{path}: {words}") })
        })?;
        check::check(&scene, &lines)?;
        let setup = Setup::new(&scene, &lines)?;
        Ok(Self { file: scene, setup })
    }

    /// One of the [`PRESETS`].
    ///
    /// # Errors
    /// [`Invalid::Contradiction`] naming the presets where there is none of that name.
    pub fn preset(name: &str) -> Result<Self> {
        match preset_text(name) {
            Some(text) => Self::parse(text, name),
            None => {
                let names: Vec<&str> = PRESETS.iter().map(|(n, _)| *n).collect();
                let message = format!("there is no preset \"{name}\"; the presets are {}", names.join(", "));
                Err(Invalid::Contradiction(message).into())
            }
        }
    }

    /// Number of views.
    pub fn views(&self) -> usize {
        self.setup.views.len()
    }

    /// Text of `rig.toml`: what an experimenter would know, ready to calibrate the images of [`simulate`].
    pub fn rig_toml(&self) -> String {
        rig::rig_toml(&self.file, &self.setup)
    }

    /// Text of `truth.json`: the true values in the shape of a calibration.
    ///
    /// # Errors
    /// [`crate::Error::Bug`] where the record cannot be written at all.
    pub fn truth_json(&self) -> Result<String> {
        truth::truth_json(&self.file, &self.setup)
    }
}

/// Text of a preset's scene file, to be written out and changed.
pub fn preset_text(name: &str) -> Option<&'static str> {
    PRESETS.iter().find(|(n, _)| *n == name).map(|(_, text)| *text)
}

/// Render every view in every camera, and write down what is true and what is known.
///
/// # Errors
/// [`Invalid::Value`] where cameras see so much of the light that there are too many particles.
pub fn simulate(scene: &Scene) -> Result<Simulation> {
    let mut images = Vec::new();
    for view in 0..scene.setup.views.len() {
        for camera in 0..scene.setup.cameras.len() {
            let name = rig::image_name(view, &scene.setup.cameras[camera].name);
            images.push((name, image(scene, view, camera)?));
        }
    }
    images.extend(simulate_particles(scene)?);
    Ok(Simulation { images, rig_toml: scene.rig_toml(), truth_json: scene.truth_json()? })
}

/// Images of the particles alone, with their names: of every moment one per camera, or two with a flow (`a`, `b`); empty without a table `[particles]`.
///
/// # Errors
/// [`Invalid::Value`] where cameras see so much of the light that there are too many particles.
pub fn simulate_particles(scene: &Scene) -> Result<Vec<(String, GrayImage)>> {
    let Some(keys) = &scene.file.particles else { return Ok(Vec::new()) };
    let (setup, seed) = (&scene.setup, scene.file.seed);
    let mut images = Vec::new();
    for moment in 0..keys.pairs {
        let all = Particles::new(keys, &setup.cameras, &setup.bench_from_light, seed, moment)?;
        let exposures = match &keys.flow {
            None => vec![("", all)],
            Some(flow) => vec![("a", all.carried(flow, -0.5)), ("b", all.carried(flow, 0.5))],
        };
        for (e, (letter, particles)) in exposures.iter().enumerate() {
            for (i, c) in setup.cameras.iter().enumerate() {
                let grey = particles.image(c, &setup.bench_from_light, &scene.file.image);
                // The noise of a moment is apart from that of the views.
                let image = sensor::expose(&grey, c.size_px, &scene.file.image, seed, [10_000 * (e + 1) + moment, i])?;
                images.push((format!("p{:02}{letter}_{}.png", moment + 1, c.name), image));
            }
        }
    }
    Ok(images)
}

/// One image, digitised.
fn image(scene: &Scene, view: usize, camera: usize) -> Result<GrayImage> {
    let (keys, seed) = (&scene.file.image, scene.file.seed);
    let (c, v) = (&scene.setup.cameras[camera], &scene.setup.views[view]);
    let (disc, ground) = check::levels(&scene.file);
    let smoke = (scene.file.target.kind == Kind::Bubbles && !v.printed).then(|| Smoke::new(keys, seed, view));
    let uneven = Uneven::new(keys, c, seed, view, camera);
    let figure =
        Figure { camera: c, cam_from_target: c.cam_from_bench * v.bench_from_target, features: &v.pattern.features };
    let contrast = |q: &Vector2<f64>| {
        let cloud = smoke.as_ref().and_then(|s| figure.front_mm(q).map(|p| s.at(&p))).unwrap_or(1.0);
        uneven.at(q) * (disc * cloud - ground)
    };
    let mut grey = render::render(&figure, keys.blur_sigma_px, &|q| uneven.at(q) * ground, &contrast);
    light::add_glare(&mut grey, keys, c, v, [view, camera], seed);
    sensor::expose(&grey, c.size_px, keys, seed, [view, camera])
}

#[cfg(test)]
mod tests;
