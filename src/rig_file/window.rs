//! `[camera.window]`: a flat window between air and water.

use super::reader::{Item, LENGTH_MM, Limits, SIGMA, Section};
use super::{CameraDescription, Observations, Solve, ViewDescription, WindowDescription};
use crate::error::Result;

const THICKNESS_MM: Limits = Limits::new(-f64::MIN_POSITIVE, 1e4, "a thickness in mm, 0 or more and below 10 m");
const INDEX: Limits = Limits::new(0.9, 3.0, "a refractive index between 0.9 and 3 (water has 1.333)");
const TILT_SIGMA_DEG: Limits = Limits::new(0.0, 45.0, "a standard deviation in degrees above 0 and below 45");

/// Standard deviation of the angle between window and sheet where the file gives none, degrees: a light sheet set up by eye.
const DEFAULT_TILT_SIGMA_DEG: f64 = 1.0;
/// Keys of the layers in the order of [`crate::camera::LAYER_NAMES`], with what they are where the file does not say.
const LAYERS: [(&str, Limits, Option<f64>); crate::camera::LAYERS] = [
    ("distance_mm", LENGTH_MM, None),
    ("thickness_mm", THICKNESS_MM, Some(0.0)),
    ("n_air", INDEX, Some(1.0)),
    ("n_glass", INDEX, Some(1.5)),
    ("n_water", INDEX, Some(1.333)),
];

pub(super) fn read(item: &Item<'_>) -> Result<WindowDescription> {
    let section = item.section("a table of keys")?.named("[camera.window]");
    let keys: Vec<&str> = LAYERS.iter().map(|l| l.0).chain(["tilt_sigma_deg"]).collect();
    section.only(&keys, |_| None)?;
    let mut layers = [(0.0, None); crate::camera::LAYERS];
    for (layer, (key, limits, usual)) in layers.iter_mut().zip(LAYERS) {
        *layer = match (section.find(key), usual) {
            (Some(item), _) => known(&item, limits)?,
            (None, Some(usual)) => (usual, None),
            (None, None) => {
                section
                    .require(key, "give the distance from the lens to the glass along the normal of the window, mm")?;
                continue;
            }
        };
    }
    let tilt_deg = section.number("tilt_sigma_deg", TILT_SIGMA_DEG)?.unwrap_or(DEFAULT_TILT_SIGMA_DEG);
    Ok(WindowDescription { layers, tilt_sigma_rad: tilt_deg.to_radians() })
}

/// A number that is known, or `{ value, sigma }` for one that is to be estimated.
fn known(item: &Item<'_>, limits: Limits) -> Result<(f64, Option<f64>)> {
    if !item.is_table() {
        return Ok((item.number(limits)?, None));
    }
    let section = item.section("a table")?;
    section.only(&["value", "sigma"], |_| None)?;
    let value = section.require("value", "write a number where it is known, or { value = ..., sigma = ... }")?;
    Ok((value.number(limits)?, section.number("sigma", SIGMA)?))
}

/// What does not go together with a window.
pub(super) fn refuse_contradictions(
    root: &Section<'_>,
    cameras: &[CameraDescription],
    views: &[ViewDescription],
    solve: &Solve,
) -> Result<()> {
    let Some(camera) = cameras.iter().find(|c| c.window.is_some()) else { return Ok(()) };
    let refuse = |key: &str, words: &str| {
        let message = format!("camera \"{}\" has a [camera.window], {words}", camera.name);
        root.find(key).map_or_else(|| root.refuse(&message), |item| item.refuse(&message))
    };
    if solve.observations == Observations::Bitangent {
        return Err(refuse(
            "solve",
            "behind which common tangents of two discs are not tangents of their images (refraction bends straight lines), so that bitangent features have \
             no place on the target; take observations = \"contour\", which goes through glass and water exactly",
        ));
    }
    if root.find("focus").is_some() {
        return Err(refuse(
            "focus",
            "and the focus relation is that of a thin lens in one medium: behind glass and water the plane in focus is not a plane, and its tilt hangs \
             on the window that is to be found; remove [focus]: the views in the sheet or along a traverse, which a window needs, tell what it would",
        ));
    }
    if !views.iter().any(|v| v.sheet || v.plane_z_mm.is_some()) {
        return Err(refuse(
            "camera",
            "whose direction is counted from the sheet; mark the views in the sheet with sheet = true, or give plane_z_mm along a traverse",
        ));
    }
    Ok(())
}
