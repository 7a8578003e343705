//! `rig.toml`: what an experimenter would know of the scene, ready to calibrate.
//!
//! Nothing true goes in that was not asked for: lens, pitch, kind of target, one metric fact, and which views are in the sheet.

use super::scene::{PolarityKey, ScaleKey, SceneFile};
use super::setup::Setup;
use crate::camera::Radial;
use crate::target::TargetKind as Kind;
use std::fmt::Write;

/// Name of the image file of a view and camera.
pub(super) fn image_name(view: usize, camera: &str) -> String {
    format!("v{:02}_{camera}.png", view + 1)
}

/// The text of `rig.toml`.
pub(super) fn rig_toml(scene: &SceneFile, setup: &Setup) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = cameras(&mut text, setup);
    let _ = target(&mut text, scene);
    let _ = scale(&mut text, scene, setup);
    let _ = solve(&mut text, scene);
    let _ = views(&mut text, setup);
    text
}

fn cameras(out: &mut String, setup: &Setup) -> std::fmt::Result {
    for c in &setup.cameras {
        writeln!(out, "[[camera]]\nname = \"{}\"", c.name)?;
        if let Some(pitch) = c.pixel_pitch_mm {
            writeln!(out, "pixel_pitch_mm = {pitch:?}")?;
        }
        if let Some(lens) = c.focal_length_mm {
            writeln!(out, "focal_length_mm = {lens:?}")?;
        }
        if c.camera.intrinsics().radial == Radial::DistortedToIdeal {
            writeln!(out, "radial = \"distorted-to-ideal\"")?;
        }
        // Of the camera's and the lens's data sheet: images alone hardly tell them.
        let i = c.camera.intrinsics();
        let known: Vec<_> =
            [("aspect", i.aspect), ("pupil_ratio", i.pupil_ratio)].into_iter().filter(|k| k.1 != 1.0).collect();
        if !known.is_empty() {
            writeln!(out, "\n[camera.known]")?;
        }
        for (name, value) in known {
            writeln!(out, "{name} = {{ fixed = {value:?} }}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn target(out: &mut String, scene: &SceneFile) -> std::fmt::Result {
    let t = &scene.target;
    let polarity = if t.polarity == PolarityKey::Bright { "bright" } else { "dark" };
    writeln!(out, "[target]\nkind = \"{}\"\npolarity = \"{polarity}\"", t.kind.word())?;
    let gives_scale = matches!(scene.rig.scale, None | Some(ScaleKey::Target));
    // The depth of a plate's second level is told beside its pitch.
    if let (true, Some(spacing)) = (gives_scale || t.kind == Kind::TwoLevelPlate, t.spacing_mm) {
        match scene.rig.scale_sigma_mm.filter(|_| gives_scale) {
            Some(sigma) => writeln!(out, "spacing_mm = {{ value = {spacing:?}, sigma = {sigma:?} }}")?,
            None => writeln!(out, "spacing_mm = {spacing:?}")?,
        }
    }
    if let (true, Some([a, b])) = (scene.rig.radii_known, t.radii_mm) {
        writeln!(out, "radii_mm = [{a:?}, {b:?}]")?;
    }
    if let (true, Some(r)) = (scene.rig.radii_known, t.radius_mm) {
        writeln!(out, "radii_mm = [{r:?}]")?;
    }
    if t.kind == Kind::DotGrid
        && let (Some(columns), Some(rows)) = (t.columns, t.rows)
    {
        writeln!(out, "columns = {columns}\nrows = {rows}")?;
    }
    if let Some(step) = t.step_mm {
        writeln!(out, "step_mm = {step:?}")?;
    }
    if let Some(adjust) = &scene.rig.adjust {
        writeln!(out, "adjust = \"{adjust}\"")?;
        // Without a pitch nobody knows what a hundredth of it is.
        if let (true, false, Some(spacing)) = (adjust == "points", gives_scale, t.spacing_mm)
            && t.kind == Kind::DotGrid
        {
            writeln!(out, "point_sigma_mm = {:?}", 0.01 * spacing)?;
        }
    }
    for m in &t.marks {
        writeln!(out, "\n[[target.marks]]\nkind = \"{}\"\ncolumn = {}\nrow = {}", m.kind.word(), m.column, m.row)?;
        if t.kind == Kind::TwoLevelPlate {
            writeln!(out, "level = {}", m.level)?;
        }
    }
    writeln!(out)
}

fn scale(out: &mut String, scene: &SceneFile, setup: &Setup) -> std::fmt::Result {
    let view = scene.rig.scale_view;
    let pair = setup.views.get(view).and_then(|v| match v.pair_mm {
        Some(own) => Some(own),
        None => scene.target.radii_mm.zip(scene.target.spacing_mm),
    });
    let sigma = scene.rig.scale_sigma_mm;
    let inner = sigma.map_or(String::new(), |s| format!(", sigma = {s:?}"));
    match (scene.rig.scale, pair) {
        (Some(ScaleKey::Baseline), _) => {
            let centers: Vec<_> = setup.cameras.iter().map(|c| c.cam_from_bench.inverse().translation_mm).collect();
            if let [a, b] = centers[..] {
                let baseline = (a - b).norm();
                match sigma {
                    None => writeln!(out, "[scale]\nbaseline_mm = {baseline:?}\n")?,
                    Some(s) => writeln!(out, "[scale]\nbaseline_mm = {{ value = {baseline:?}, sigma = {s:?} }}\n")?,
                }
            }
        }
        (Some(ScaleKey::ViewSpacing), Some((_, spacing))) => {
            writeln!(out, "[scale]\nspacing_mm = {{ view = {view}, value = {spacing:?}{inner} }}\n")?;
        }
        (Some(ScaleKey::ViewRadius), Some(([radius, _], _))) => {
            writeln!(out, "[scale]\nradius_mm = {{ view = {view}, disc = 0, value = {radius:?}{inner} }}\n")?;
        }
        (Some(ScaleKey::Traverse), _) => match sigma {
            None => writeln!(out, "[scale]\nplane_z_mm = true\n")?,
            Some(s) => writeln!(out, "[scale]\nplane_z_mm = {{ sigma = {s:?} }}\n")?,
        },
        _ => {}
    }
    if let Some(f) = &scene.rig.focus {
        writeln!(out, "[focus]\ntilt_sigma_deg = {:?}\ndistance_sigma = {:?}\n", f.tilt_sigma_deg, f.distance_sigma)?;
    }
    Ok(())
}

fn solve(out: &mut String, scene: &SceneFile) -> std::fmt::Result {
    let r = &scene.rig;
    if r.observations.is_none() && r.loss.is_none() && r.estimate.is_none() {
        return Ok(());
    }
    writeln!(out, "[solve]")?;
    if let Some(observations) = &r.observations {
        writeln!(out, "observations = \"{observations}\"")?;
    }
    if let Some(loss) = &r.loss {
        writeln!(out, "loss = \"{loss}\"")?;
    }
    if let Some(terms) = &r.estimate {
        let words: Vec<String> = terms.iter().map(|t| format!("\"{t}\"")).collect();
        writeln!(out, "estimate = [{}]", words.join(", "))?;
    }
    writeln!(out)
}

fn views(out: &mut String, setup: &Setup) -> std::fmt::Result {
    for (i, v) in setup.views.iter().enumerate() {
        writeln!(out, "[[view]]")?;
        for c in &setup.cameras {
            writeln!(out, "{} = \"{}\"", c.name, image_name(i, &c.name))?;
        }
        // One camera alone does not measure the sheet.
        writeln!(out, "sheet = {}", v.in_sheet && setup.cameras.len() == 2)?;
        if let Some(z) = v.plane_z_mm {
            writeln!(out, "plane_z_mm = {z:?}")?;
        }
        if i + 1 < setup.views.len() {
            writeln!(out)?;
        }
    }
    Ok(())
}
