//! DaVis: the pinhole camera of `Calibration.xml`, and the marks of `MarkPositionTable.xml`.
//!
//! ```text
//! p = R X + t,  R = Rz(Rz) Ry(Ry) Rx(Rx);   f = FocalLengthPixel (mm, despite its name) / SensorPixelSizeMm
//! (u, v) = PrincipalPoint + f distorted(p_x / p_z, p_y / p_z),   k1 k2 radial, p1 p2 tangential as in OpenCV
//! ```
//! These conventions are published by users who reproduced the program's own fit error to 14 digits with them. Raw pixels
//! are taken with (0, 0) the centre of the first pixel. `Polynomial3rdOrder` mappings have no camera in them and are refused:
//! the marks beside them are read instead.

use super::distorted::OpenCvCamera;
use super::marks::{Marks, camera_of_marks};
use super::storage::pixels;
use super::xml::Xml;
use super::{Found, ImportOptions, NamedText, WorldCamera};
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::{Rotation3, Vector2, Vector3};
use roxmltree::Node;

/// The cameras of one file; which of the two it is follows from its content.
pub(super) fn import(files: &[NamedText], options: &ImportOptions) -> Result<Found> {
    let [file] = files else {
        return Err(Invalid::Contradiction("DaVis keeps all cameras in one file; give one".into()).into());
    };
    let xml = Xml::parse(file)?;
    let root = xml.root();
    if root.descendants().any(|n| n.has_tag_name("CoordinateMapper")) {
        return pinholes(&xml, options);
    }
    if root.descendants().any(|n| n.has_tag_name("Mark")) {
        return marks(&xml, options);
    }
    let message = "neither a <CoordinateMapper> (Calibration.xml) nor a <Mark> (MarkPositionTable.xml) is in it";
    Err(xml.fault(root, message.into()))
}

fn pinholes(xml: &Xml<'_>, options: &ImportOptions) -> Result<Found> {
    let mut cameras = Vec::new();
    for mapper in xml.root().descendants().filter(|n| n.has_tag_name("CoordinateMapper")) {
        let kind = mapper.attribute("Type").unwrap_or_default();
        if kind != "PinholeOpenCV" {
            let message = format!(
                "the mapping is of type \"{kind}\", a polynomial without a camera in it; convert the MarkPositionTable.xml \
                 beside it, or calibrate in DaVis with the pinhole model"
            );
            return Err(xml.fault(mapper, message));
        }
        let name = format!("camera{}", mapper.attribute("CameraIdentifier").unwrap_or("?"));
        cameras.push(pinhole(xml, mapper, name, options)?);
    }
    let notes =
        vec!["z = 0 of the file's world (the plate, or the sheet after DaVis's self-calibration) is the sheet".into()];
    Ok(Found { cameras, has_sheet: true, of_marks: false, notes, program: "davis" })
}

fn pinhole<'a>(xml: &Xml<'a>, mapper: Node<'_, 'a>, name: String, options: &ImportOptions) -> Result<WorldCamera> {
    let internal = xml.find(mapper, "InternalCameraParameters")?;
    let external = xml.find(mapper, "ExternalCameraParameters")?;
    let pitch_mm = xml.number(xml.find(internal, "SensorPixelSizeMm")?, "Value")?;
    let focal = xml.find(internal, "FocalLengthPixel")?;
    let fx_mm = xml.number(focal, "x")?;
    let fy_mm = if focal.attribute("y").is_some() { xml.number(focal, "y")? } else { fx_mm };
    if !(pitch_mm > 0.0 && fx_mm > 0.0 && fy_mm > 0.0) {
        let message =
            format!("pixel size {pitch_mm} mm and focal length {fx_mm}, {fy_mm} mm: expected numbers above 0");
        return Err(xml.fault(internal, message));
    }
    let center = xml.find(internal, "PrincipalPoint")?;
    let radial = xml.find(internal, "RadialDistortion")?;
    let tangential = xml.find(internal, "TangentialDistortion")?;
    let mut d = [0.0; 14];
    d[0] = xml.number(radial, "radialDistortionCoefficient1")?;
    d[1] = xml.number(radial, "radialDistortionCoefficient2")?;
    d[2] = xml.number(tangential, "tangentialDistortionCoefficient1")?;
    d[3] = xml.number(tangential, "tangentialDistortionCoefficient2")?;
    let model = OpenCvCamera {
        fx_px: fx_mm / pitch_mm,
        fy_px: fy_mm / pitch_mm,
        cx_px: xml.number(center, "x")?,
        cy_px: xml.number(center, "y")?,
        d,
    };
    let (shift, turn) = (xml.find(external, "TranslationMm")?, xml.find(external, "RotationAngles")?);
    let t = Vector3::new(xml.number(shift, "Tx")?, xml.number(shift, "Ty")?, xml.number(shift, "Tz")?);
    // nalgebra's Euler angles are Rz Ry Rx as well.
    let r = Rotation3::from_euler_angles(xml.number(turn, "Rx")?, xml.number(turn, "Ry")?, xml.number(turn, "Rz")?);
    let pose: Motion<Cam, Sheet> = Motion::new(r.into_inner(), t);
    let image_size_px = match mapper.descendants().find(|n| n.has_tag_name("OriginalImageSize")) {
        Some(n) => {
            let size = [xml.number(n, "Width")?, xml.number(n, "Height")?];
            let [Some(width), Some(height)] = size.map(pixels) else {
                let message =
                    format!("images of {} x {} px: expected numbers above 0 without a fraction", size[0], size[1]);
                return Err(xml.fault(n, message));
            };
            [width, height]
        }
        None => image_size(options)?,
    };
    let (camera, cam_from_world, loss) = model.to_scheimpflug(&name, &pose, image_size_px)?;
    Ok(WorldCamera { name, image_size_px, pixel_pitch_mm: Some(pitch_mm), camera, cam_from_world, loss, points: None })
}

fn image_size(options: &ImportOptions) -> Result<[usize; 2]> {
    options.image_size_px.ok_or_else(|| {
        Invalid::Contradiction("the file does not say how large the images are; give it with --image-size WxH".into())
            .into()
    })
}

fn marks(xml: &Xml<'_>, options: &ImportOptions) -> Result<Found> {
    let image_size_px = image_size(options)?;
    let (mut cameras, mut notes) = (Vec::new(), Vec::new());
    for camera in xml.root().descendants().filter(|n| n.has_tag_name("Camera")) {
        let name = format!("camera{}", camera.attribute("CameraNumber").unwrap_or("?"));
        let mut found = Marks::default();
        for mark in camera.descendants().filter(|n| n.has_tag_name("Mark")) {
            let (world, raw) = (xml.find(mark, "WorldPos")?, xml.find(mark, "RawPos")?);
            found.push(
                Vector3::new(xml.number(world, "x")?, xml.number(world, "y")?, xml.number(world, "z")?),
                Vector2::new(xml.number(raw, "x")?, xml.number(raw, "y")?),
            );
        }
        let (model, cam_from_world, loss) =
            camera_of_marks(&found, image_size_px).map_err(|e| xml.fault(camera, e.to_string()))?;
        notes.push(format!(
            "{name}: fitted to {} marks, {:.3} px rms, {:.3} px at most",
            found.len(),
            loss.rms_px,
            loss.max_px
        ));
        let pixel_pitch_mm = options.pixel_pitch_mm;
        cameras.push(WorldCamera {
            name,
            image_size_px,
            pixel_pitch_mm,
            camera: model,
            cam_from_world,
            loss,
            points: None,
        });
    }
    notes.push(
        "z = 0 of the marks (the plate, where it was calibrated) is taken for the laser sheet; look with spivcal check whether the light is there"
            .into(),
    );
    Ok(Found { cameras, has_sheet: true, of_marks: true, notes, program: "davis marks" })
}
