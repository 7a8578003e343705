//! UVMAT: `GeometryCalib` of the XML beside the images, one file per camera.
//!
//! ```text
//! p = R X + T,   X_px = fx (p_x / p_z) g + Cx,   Y_px = fy (p_y / p_z) g + Cy,   g = 1 + kc r2
//! ```
//! Pixels count from the lower left corner of the image, so the centre of the first (upper left) pixel is
//! (0.5, height - 0.5): `u = X_px - 0.5, v = height - 0.5 - Y_px`. Lengths are in `CoordUnit` (cm where it is missing).
//! A water surface (`InterfaceCoord`) is refused. Source: UVMAT's documented functions `px_XYZ` and `phys_XYZ`.

use super::xml::Xml;
use super::{Found, ImportOptions, Loss, NamedText, WorldCamera};
use crate::camera::{Camera, Intrinsics};
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::{Motion, orthonormalised};
use nalgebra::{Matrix3, Vector3};
use roxmltree::Node;

/// The cameras of the files, one each.
pub(super) fn import(files: &[NamedText], options: &ImportOptions) -> Result<Found> {
    let size_px = options.image_size_px.ok_or_else(|| {
        Invalid::Contradiction(
            "UVMAT counts pixels from the lower edge, so the image size is needed; give it with --image-size WxH"
                .into(),
        )
    })?;
    let (mut cameras, mut notes) = (Vec::new(), Vec::new());
    let mut handed = None;
    for file in files {
        let (camera, mirrored) = camera(file, size_px, options)?;
        if *handed.get_or_insert(mirrored) != mirrored {
            let what = format!(
                "{}: its R turns axes of one hand into those of the other, that of the first file does not: the cameras do not look at one world; calibrate both \
                 with the same axes",
                file.name
            );
            return Err(Invalid::Contradiction(what).into());
        }
        if mirrored {
            notes.push(format!(
                "{}: its axes are left-handed as this library sees them; z is taken with the other sign",
                camera.name
            ));
        }
        cameras.push(camera);
    }
    Ok(Found { cameras, has_sheet: true, of_marks: false, notes, program: "uvmat" })
}

/// Numbers of an element, or of several elements of that name (rows of a matrix).
fn rows<'a>(xml: &Xml<'a>, geometry: Node<'_, 'a>, name: &str, expected: usize) -> Result<Vec<f64>> {
    let mut out = Vec::new();
    for node in geometry.children().filter(|n| n.has_tag_name(name)) {
        out.extend(xml.numbers(node)?);
    }
    if out.len() < expected {
        let message = format!("<{name}> of <GeometryCalib> has {} numbers: expected {expected}", out.len());
        return Err(xml.fault(geometry, message));
    }
    Ok(out)
}

fn unit_mm<'a>(xml: &Xml<'a>, geometry: Node<'_, 'a>) -> Result<f64> {
    let unit = geometry.children().find(|n| n.has_tag_name("CoordUnit")).and_then(|n| n.text()).map(str::trim);
    match unit {
        Some("mm") => Ok(1.0),
        Some("m") => Ok(1000.0),
        Some("cm") | None => Ok(10.0),
        Some(other) => Err(xml.fault(geometry, format!("CoordUnit \"{other}\": expected mm, cm or m"))),
    }
}

fn camera(file: &NamedText, size_px: [usize; 2], options: &ImportOptions) -> Result<(WorldCamera, bool)> {
    let xml = Xml::parse(file)?;
    let geometry = xml.find(xml.root(), "GeometryCalib")?;
    if geometry.children().any(|n| n.has_tag_name("InterfaceCoord")) {
        return Err(
            xml.fault(geometry, "it looks through a water surface (InterfaceCoord), which cannot be read".into())
        );
    }
    let scale = unit_mm(&xml, geometry)?;
    let focal = rows(&xml, geometry, "fx_fy", 2)?;
    let center = rows(&xml, geometry, "Cx_Cy", 2)?;
    let t = rows(&xml, geometry, "Tx_Ty_Tz", 3)?;
    let r = Matrix3::from_row_slice(&rows(&xml, geometry, "R", 9)?[..9]);
    let gap = (r * r.transpose() - Matrix3::identity()).abs().max();
    if !(gap < 1e-4) {
        let message = format!(
            "R is not a rotation (R R^T differs from 1 by {gap:.1e}); rescaling without a camera cannot be read"
        );
        return Err(xml.fault(geometry, message));
    }
    let kc = if geometry.children().any(|n| n.has_tag_name("kc")) { rows(&xml, geometry, "kc", 1)?[0] } else { 0.0 };
    let down = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    let mut rotation = down * r;
    let mirrored = rotation.determinant() < 0.0;
    if mirrored {
        rotation *= Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    }
    let translation = down * Vector3::new(t[0], t[1], t[2]) * scale;
    let mut i = Intrinsics::pinhole(focal[0], center[0] - 0.5, size_px[1] as f64 - 0.5 - center[1]);
    i.aspect = focal[1] / focal[0];
    i.k[0] = kc;
    let pose: Motion<Cam, Sheet> = Motion::new(orthonormalised(&rotation), translation);
    let name = file.name.rsplit(['/', '\\']).next().unwrap_or_default().trim_end_matches(".xml").to_string();
    let camera = WorldCamera {
        name,
        image_size_px: size_px,
        pixel_pitch_mm: options.pixel_pitch_mm,
        camera: Camera::new(i)?,
        cam_from_world: pose,
        loss: Loss::NONE,
        points: None,
    };
    Ok((camera, mirrored))
}
