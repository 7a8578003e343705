//! `[[camera]]`, `[camera.known]` and `[camera.design]`; `[camera.window]` has a file of its own.

use super::reader::{FINITE, Item, LENGTH_MM, Limits, POSITIVE, Section};
use super::{CameraDescription, Design, Knowledge, Parameter, window};
use crate::camera::{Drawing, Radial};
use crate::error::Result;

const PIXEL_PITCH_MM: Limits =
    Limits::new(1e-4, 1.0, "a pixel pitch in mm between 0.0001 and 1 (6.25 micrometres are 0.00625)");
const FOCAL_LENGTH_MM: Limits = Limits::new(0.1, 1e5, "a focal length in mm between 0.1 and 100000");
const F_SIGMA: Limits = Limits::new(0.0, 1.0, "a relative standard deviation above 0 and below 1 (1 percent is 0.01)");
const TILT_SIGMA_DEG: Limits = Limits::new(0.0, 90.0, "a standard deviation in degrees above 0 and below 90");
/// Directions of the radial polynomial.
const RADIAL: [(&str, Radial); 2] =
    [("ideal-to-distorted", Radial::IdealToDistorted), ("distorted-to-ideal", Radial::DistortedToIdeal)];
const TILT_DEG: Limits = Limits::new(-89.0, 89.0, "an angle in degrees between -89 and 89");

/// Keys of a view beside the camera names; no camera may be called like them.
pub(super) const VIEW_KEYS: [&str; 2] = ["sheet", "plane_z_mm"];

pub(super) fn read_all(root: &Section<'_>) -> Result<Vec<CameraDescription>> {
    let list = root.find("camera").ok_or_else(|| {
        root.source.refuse_line(1, "no [[camera]] is described; each camera needs [[camera]] and name = \"...\"")
    })?;
    let items = list.list("[[camera]] (in double brackets, once for each camera)")?;
    if items.is_empty() {
        return Err(list.refuse("no camera is described; each camera needs [[camera]] and name = \"...\""));
    }
    if let Some(third) = items.get(2) {
        return Err(third.source.refuse(
            third.offset,
            format!("{} cameras are described; a rig has two (or one, calibrated alone without a sheet)", items.len()),
        ));
    }
    let mut cameras: Vec<CameraDescription> = Vec::with_capacity(items.len());
    for item in &items {
        let section = item.section("a table of keys")?.named("[[camera]]");
        let camera = read(&section)?;
        // Output files carry the name, and some file systems do not tell "Left" from "left".
        if cameras.iter().any(|c| c.name.to_lowercase() == camera.name.to_lowercase()) {
            return Err(section.require("name", "")?.refuse(format!(
                "both cameras are called \"{}\"; views need to tell them apart, give them different names",
                camera.name
            )));
        }
        cameras.push(camera);
    }
    Ok(cameras)
}

fn read(section: &Section<'_>) -> Result<CameraDescription> {
    section.only(&["name", "pixel_pitch_mm", "focal_length_mm", "radial", "known", "design", "window"], |key| {
        Parameter::ALL.iter().any(|p| p.key() == key).then(|| "belongs under [camera.known]".to_string())
    })?;
    let mut camera = CameraDescription {
        name: name(&section.require("name", "give the camera a name, such as name = \"left\"")?)?,
        pixel_pitch_mm: section.number("pixel_pitch_mm", PIXEL_PITCH_MM)?,
        focal_length_mm: section.number("focal_length_mm", FOCAL_LENGTH_MM)?,
        radial: section.find("radial").map_or(Ok(Radial::default()), |item| item.choice(&RADIAL))?,
        known: section.find("known").map_or(Ok(Vec::new()), |item| known(&item))?,
        design: None,
        window: section.find("window").map(|item| window::read(&item)).transpose()?,
    };
    if let Some(item) = section.find("design") {
        camera.design = Some(design(&item, &camera)?);
    }
    Ok(camera)
}

/// Focal length and tilts from the drawing; what it gives must not be stated a second time.
fn design(item: &Item<'_>, camera: &CameraDescription) -> Result<Design> {
    let section = item.section("a table of keys")?.named("[camera.design]");
    let keys = ["object_distance_mm", "viewing_angle_deg", "viewing_angle_vertical_deg", "f_sigma", "tilt_sigma_deg"];
    section.only(&keys, |key| {
        let of_camera = ["focal_length_mm", "pixel_pitch_mm"].contains(&key);
        of_camera.then(|| "stands in [[camera]] itself".to_string())
    })?;
    let missing = |key: &str| {
        item.refuse(format!("needs {key} of camera \"{}\"; add it to [[camera]], above [camera.design]", camera.name))
    };
    let focal_length_mm = camera.focal_length_mm.ok_or_else(|| missing("focal_length_mm"))?;
    let pixel_pitch_mm = camera.pixel_pitch_mm.ok_or_else(|| missing("pixel_pitch_mm"))?;
    let distance = section
        .require("object_distance_mm", "give the distance from the lens to the sheet along the lens axis, mm")?;
    let angle =
        section.require("viewing_angle_deg", "give the angle between the lens axis and the sheet's normal, degrees")?;
    let vertical_deg = section.number("viewing_angle_vertical_deg", TILT_DEG)?.unwrap_or(0.0);
    let drawing = Drawing {
        focal_length_mm,
        pixel_pitch_mm,
        object_distance_mm: distance.number(LENGTH_MM)?,
        angle_rad: angle.number(TILT_DEG)?.to_radians(),
        angle_vertical_rad: vertical_deg.to_radians(),
    };
    if drawing.object_distance_mm <= focal_length_mm {
        return Err(distance.refuse(format!(
            "expected a distance above the focal length of {focal_length_mm} mm, found {}; nothing nearer can be in focus",
            drawing.object_distance_mm
        )));
    }
    let i = drawing.intrinsics([0.0; 2])?;
    let sigmas = [("f_sigma", &[Parameter::F][..]), ("tilt_sigma_deg", &[Parameter::Alpha, Parameter::Beta])];
    for (key, parameters) in sigmas {
        let stated = parameters.iter().find(|p| camera.knowledge(**p).is_some());
        if let (Some(item), Some(parameter)) = (section.find(key), stated) {
            return Err(item.refuse(format!(
                "makes a prior of what [camera.known] already states as {}; remove one of the two",
                parameter.key()
            )));
        }
    }
    Ok(Design {
        f_px: i.f_px,
        alpha_rad: i.alpha_rad,
        beta_rad: i.beta_rad,
        f_sigma_px: section.number("f_sigma", F_SIGMA)?.map(|s| s * i.f_px),
        tilt_sigma_rad: section.number("tilt_sigma_deg", TILT_SIGMA_DEG)?.map(f64::to_radians),
    })
}

fn name(item: &Item<'_>) -> Result<String> {
    let name = item.text("a name")?;
    match name_fault(name) {
        Some(fault) => Err(item.refuse(fault)),
        None => Ok(name.to_string()),
    }
}

/// Why a word cannot be the name of a camera.
pub(crate) fn name_fault(name: &str) -> Option<String> {
    if VIEW_KEYS.contains(&name) {
        return Some(format!("\"{name}\" is a key of [[view]] and cannot be the name of a camera"));
    }
    let allowed = |c: char| c.is_alphanumeric() || c == '-' || c == '_';
    let fits = !name.is_empty() && name.len() <= 64 && name.chars().all(allowed);
    (!fits).then(|| {
        format!("\"{name}\" cannot be a name: expected letters, digits, \"-\" or \"_\", 1 to 64 bytes of them (output files are called after it)")
    })
}

fn known(item: &Item<'_>) -> Result<Vec<(Parameter, Knowledge)>> {
    let section = item.section("a table of keys")?.named("[camera.known]");
    let keys: Vec<&str> = Parameter::ALL.iter().map(|p| p.key()).collect();
    section.only(&keys, |_| None)?;
    let mut known = Vec::new();
    for parameter in Parameter::ALL {
        if let Some(item) = section.find(parameter.key()) {
            known.push((parameter, knowledge(parameter, &item)?));
        }
    }
    Ok(known)
}

const PRIOR_SIGMA: Limits = Limits::new(
    1e-12,
    f64::INFINITY,
    "a finite standard deviation above 1e-12 (for a value that is exact, { fixed = ... })",
);

fn knowledge(parameter: Parameter, item: &Item<'_>) -> Result<Knowledge> {
    if !item.is_table() {
        return Err(item.refuse(
            "expected { value = ..., sigma = ... } for a value known with a standard deviation, or { fixed = ... }",
        ));
    }
    let section = item.section("a table")?;
    section.only(&["value", "sigma", "fixed"], |_| None)?;
    let limits = limits(parameter);
    let unit = if matches!(parameter, Parameter::Alpha | Parameter::Beta) { f64::to_radians(1.0) } else { 1.0 };
    if let (Some(value), Some(item)) = (section.number("value", limits)?, section.find("sigma"))
        && item.number(FINITE).is_ok_and(|sigma| sigma == 0.0)
    {
        let key = parameter.key();
        let message = format!(
            "expected a finite standard deviation above 1e-12, found 0; for a value that is exact, write {key} = {{ fixed = {value} }}"
        );
        return Err(item.refuse(message));
    }
    match (section.number("value", limits)?, section.number("sigma", PRIOR_SIGMA)?, section.number("fixed", limits)?) {
        (Some(value), Some(sigma), None) => Ok(Knowledge::Prior { value: value * unit, sigma: sigma * unit }),
        (None, None, Some(value)) => Ok(Knowledge::Fixed { value: value * unit }),
        (_, _, Some(_)) => {
            Err(item.refuse("cannot be fixed and have a prior at once; keep either { fixed } or { value, sigma }"))
        }
        (Some(_), None, None) => Err(item.refuse(
            "a value without sigma says nothing; add sigma = ... (one standard deviation) or write { fixed = ... }",
        )),
        (None, Some(_), None) => Err(item.refuse("a sigma without a value; add value = ...")),
        (None, None, None) => Err(item.refuse("expected { value = ..., sigma = ... } or { fixed = ... }")),
    }
}

fn limits(parameter: Parameter) -> Limits {
    match parameter {
        Parameter::F | Parameter::Aspect | Parameter::PupilRatio => POSITIVE,
        Parameter::Alpha | Parameter::Beta => TILT_DEG,
        Parameter::Cx | Parameter::Cy | Parameter::K1 | Parameter::K2 | Parameter::K3 => FINITE,
    }
}
