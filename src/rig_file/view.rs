//! `[[view]]`.

use super::camera::VIEW_KEYS;
use super::reader::{Item, Limits, PLACE_MM, SIGMA, Section};
use super::{CameraDescription, PlaneZ, ViewDescription};
use crate::error::Result;

pub(super) fn read_all(root: &Section<'_>, cameras: &[CameraDescription]) -> Result<Vec<ViewDescription>> {
    let missing = "no [[view]] is described; each position of the target needs [[view]] with an image per camera";
    let list = root.find("view").ok_or_else(|| root.source.refuse_line(1, missing))?;
    let items = list.list("[[view]] (in double brackets, once for each position of the target)")?;
    if items.is_empty() {
        return Err(list.refuse(missing));
    }
    let mut views: Vec<ViewDescription> = Vec::with_capacity(items.len());
    for (index, item) in items.iter().enumerate() {
        let section = item.section("a table of keys")?.named(format!("[[view]] {index}"));
        let view = read(&section, item, cameras)?;
        for image in view.images.iter().flatten() {
            let earlier = views.iter().position(|v| v.images.iter().flatten().any(|i| i == image));
            let twice = view.images.iter().flatten().filter(|i| *i == image).count() > 1;
            if let Some(other) = earlier.or(twice.then_some(index)) {
                return Err(section.refuse(format!(
                    "image \"{image}\" is used already in view {other}; an image belongs to one camera and one view"
                )));
            }
        }
        views.push(view);
    }
    let counted = |v: &ViewDescription| v.position_mm().is_some();
    let unknown = views.iter().position(|v| v.plane_z_mm == Some(PlaneZ::Unknown));
    if let Some(index) = unknown.filter(|_| !views.iter().any(counted)) {
        return Err(items[index].refuse(
            "plane_z_mm = \"unknown\" counts from the sheet or from a known position, and there is none; give at least one \
             view sheet = true or a known plane_z_mm",
        ));
    }
    if cameras.len() == 2 && !views.iter().any(|v| v.images.iter().all(Option::is_some)) {
        return Err(list.refuse(format!(
            "no view has an image of both \"{}\" and \"{}\", so nothing ties the cameras together; \
             expected at least one such view",
            cameras[0].name, cameras[1].name
        )));
    }
    Ok(views)
}

fn read(section: &Section<'_>, item: &Item<'_>, cameras: &[CameraDescription]) -> Result<ViewDescription> {
    let names: Vec<&str> = cameras.iter().map(|c| c.name.as_str()).collect();
    let keys: Vec<&str> = names.iter().copied().chain(VIEW_KEYS).collect();
    section.only(&keys, |_| None).map_err(|e| unknown_camera(e, &names))?;
    let image = |name: &&str| -> Result<Option<String>> {
        let Some(item) = section.find(name) else { return Ok(None) };
        let text = item.text("the path of an image")?;
        if text.trim().is_empty() {
            return Err(item.refuse("the path of the image is empty; leave the key out where the camera saw nothing"));
        }
        Ok(Some(text.to_string()))
    };
    let images = names.iter().map(image).collect::<Result<Vec<_>>>()?;
    if images.iter().all(Option::is_none) {
        return Err(section.refuse(format!("has no image; expected {} = \"FILE\"", names.join(" = \"FILE\" or "))));
    }
    let sheet = section.find("sheet").map_or(Ok(false), |i| i.boolean())?;
    if sheet && cameras.len() < 2 {
        return Err(section.require("sheet", "")?.refuse(
            "the sheet is measured with two cameras, but one is described; add the other camera, or remove sheet = true",
        ));
    }
    let plane_z_mm = section.find("plane_z_mm").map(|i| plane_z(&i, sheet)).transpose()?;
    Ok(ViewDescription { images, sheet, plane_z_mm, line: item.line() })
}

const PLANE_Z: Limits =
    Limits::new(-1e6, 1e6, "a finite number in mm between -1 km and 1 km, { value = ..., sigma = ... } or \"unknown\"");

fn plane_z(item: &Item<'_>, sheet: bool) -> Result<PlaneZ> {
    let place = if item.is_text() && item.text("")? == "unknown" {
        PlaneZ::Unknown
    } else if item.is_table() {
        let section = item.section("a table")?;
        section.only(&["value", "sigma"], |_| None)?;
        let z_mm = section.require("value", "expected a position in mm")?.number(PLACE_MM)?;
        PlaneZ::Known { z_mm, sigma_mm: section.number("sigma", SIGMA)? }
    } else {
        PlaneZ::Known { z_mm: item.number(PLANE_Z)?, sigma_mm: None }
    };
    if sheet && place != (PlaneZ::Known { z_mm: 0.0, sigma_mm: None }) {
        return Err(item.refuse(
            "in a view with sheet = true the target is in the laser sheet, exactly at plane_z_mm = 0; count positions along a traverse \
             from the sheet, or remove sheet = true",
        ));
    }
    Ok(place)
}

/// In a view an unknown key is most often a camera that is not described.
fn unknown_camera(error: crate::Error, names: &[&str]) -> crate::Error {
    match error {
        crate::Error::Invalid(crate::error::Invalid::Syntax { file, line, message }) => crate::error::Invalid::Syntax {
            file,
            line,
            message: format!("{message} (the cameras are called {})", super::reader::one_of(names)),
        }
        .into(),
        other => other,
    }
}
