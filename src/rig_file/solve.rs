//! `[focus]` and `[solve]`.

use super::reader::{Limits, Section};
use super::{
    CameraDescription, Focus, Knowledge, Loss, Observations, Parameter, Solve, TargetDescription, ViewDescription,
};
use crate::error::Result;
use crate::target::Target;

const TILT_SIGMA_DEG: Limits = Limits::new(0.0, 90.0, "a standard deviation in degrees above 0 and below 90");
const DISTANCE_SIGMA: Limits =
    Limits::new(0.0, 1.0, "a relative standard deviation above 0 and below 1 (0.5 percent is 0.005)");

pub(super) fn read_focus(
    root: &Section<'_>,
    cameras: &[CameraDescription],
    views: &[ViewDescription],
) -> Result<Option<Focus>> {
    let Some(item) = root.find("focus") else { return Ok(None) };
    let section = item.section("[focus] (in single brackets)")?.named("[focus]");
    section.only(&["tilt_sigma_deg", "distance_sigma"], |_| None)?;
    let tilt_deg = section.number("tilt_sigma_deg", TILT_SIGMA_DEG)?.unwrap_or(Focus::DEFAULT_TILT_SIGMA_DEG);
    let distance = section.number("distance_sigma", DISTANCE_SIGMA)?;
    if !views.iter().any(|v| v.sheet) {
        return Err(
            section.refuse("ties the sheet to the cameras, but no view has sheet = true; expected at least one")
        );
    }
    if let Some(camera) = cameras.iter().find(|c| c.pixel_pitch_mm.is_none()) {
        return Err(section.refuse(format!(
            "needs the image distance in mm: camera \"{}\" has no pixel_pitch_mm, add it",
            camera.name
        )));
    }
    let lens_missing = cameras.iter().find(|c| c.focal_length_mm.is_none());
    if let (Some(camera), Some(item)) = (lens_missing, section.find("distance_sigma")) {
        return Err(item.refuse(format!(
            "needs the lens: camera \"{}\" has no focal_length_mm; add it, or remove distance_sigma",
            camera.name
        )));
    }
    let distance_sigma = lens_missing.is_none().then_some(distance.unwrap_or(Focus::DEFAULT_DISTANCE_SIGMA));
    Ok(Some(Focus { tilt_sigma_rad: tilt_deg.to_radians(), distance_sigma }))
}

pub(super) fn read(root: &Section<'_>, target: &TargetDescription, cameras: &[CameraDescription]) -> Result<Solve> {
    let mut solve = Solve::default();
    let Some(item) = root.find("solve") else { return Ok(solve) };
    let section = item.section("[solve] (in single brackets)")?.named("[solve]");
    section.only(&["observations", "loss", "estimate"], |_| None)?;
    if let Some(item) = section.find("observations") {
        let choices = [("contour", Observations::Contour), ("bitangent", Observations::Bitangent)];
        solve.observations = item.choice(&choices)?;
        let pair = matches!(target.target, Target::TwoDiscs(_) | Target::Bubbles(_));
        if solve.observations == Observations::Bitangent && !pair {
            return Err(item.refuse(
                "\"bitangent\" takes the common tangents of a pair of discs; for a grid or plate use \"contour\"",
            ));
        }
    }
    if let Some(item) = section.find("loss") {
        solve.loss = item.choice(&[("none", Loss::None), ("huber", Loss::Huber), ("cauchy", Loss::Cauchy)])?;
    }
    if section.find("estimate").is_some() {
        solve.estimate = estimate(&section, cameras)?;
    }
    Ok(solve)
}

fn estimate(section: &Section<'_>, cameras: &[CameraDescription]) -> Result<Vec<Parameter>> {
    let list = section.require("estimate", "")?.list("a list of distortion terms, such as [\"k1\"]; [] for none")?;
    let mut terms = Vec::new();
    for item in list {
        let text = item.text("a distortion term (\"k1\", \"k2\", \"k3\")")?;
        if let Some(other) =
            Parameter::ALL.iter().find(|p| p.key() == text && !DISTORTION.iter().any(|(w, _)| *w == text))
        {
            return Err(item.refuse(format!(
                "\"{}\" is no distortion term; give it under [camera.known] as {{ value, sigma }} to estimate it \
                 about a value, or {{ fixed }} to hold it",
                other.key()
            )));
        }
        let term = item.choice(&DISTORTION)?;
        if terms.contains(&term) {
            return Err(item.refuse(format!("\"{text}\" stands twice in the list")));
        }
        let fixed = |c: &&CameraDescription| matches!(c.knowledge(term), Some(Knowledge::Fixed { .. }));
        if let Some(camera) = cameras.iter().find(fixed) {
            return Err(item.refuse(format!(
                "\"{text}\" is to be estimated, but [camera.known] of \"{}\" fixes it; remove one of the two, \
                 or turn the fixed value into {{ value, sigma }}",
                camera.name
            )));
        }
        terms.push(term);
    }
    terms.sort_unstable();
    Ok(terms)
}

const DISTORTION: [(&str, Parameter); 3] = [("k1", Parameter::K1), ("k2", Parameter::K2), ("k3", Parameter::K3)];
