//! UVMAT: `GeometryCalib` of the XML beside the images, one file per camera.
//!
//! ```text
//! p = R X + T,   X_px = fx (p_x / p_z) g + Cx,   Y_px = fy (p_y / p_z) g + Cy,   g = 1 + kc r2
//! ```
//! Pixels count from the lower left corner of the image, so the centre of the first (upper left) pixel is
//! (0.5, height - 0.5): `u = X_px - 0.5, v = height - 0.5 - Y_px`. Lengths are in `CoordUnit` (cm where it is missing).
//! The laser plane is one slice: `SliceCoord` is a point of it, `SliceAngle` a rotation vector in degrees that turns z into its normal:
//! ```text
//! n = R(SliceAngle) z,   n . (X - SliceCoord) = 0
//! ```
//! The sheet's origin is where the normal through the origin of UVMAT's axes meets it, its axes are UVMAT's turned the shortest way; without
//! `SliceCoord` the plane z = 0 is taken, which is said. Several slices and a water surface (`InterfaceCoord`) are refused.
//! Source: UVMAT's documented functions `px_XYZ` and `phys_XYZ`.

use super::xml::Xml;
use super::{Found, ImportOptions, Loss, NamedText, WorldCamera};
use crate::camera::{Camera, Intrinsics};
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::{Motion, orthonormalised, rotation_exp};
use nalgebra::{Matrix3, Rotation3, Vector3};
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
    let mut slice: Option<Slice> = None;
    for file in files {
        let Read { camera, mirrored, slice: own } = camera(file, size_px, options)?;
        if *handed.get_or_insert(mirrored) != mirrored {
            let what = format!(
                "{}: its R turns axes of one hand into those of the other, that of the first file does not: the cameras do not look at one world; calibrate both \
                 with the same axes",
                file.name
            );
            return Err(Invalid::Contradiction(what).into());
        }
        if slice.zip(own).is_some_and(|(a, b)| a.differs(&b)) {
            let what = format!(
                "{}: its SliceCoord and SliceAngle state another plane than the first file's; write the laser plane of the measurement into the files \
                 of all cameras",
                file.name
            );
            return Err(Invalid::Contradiction(what).into());
        }
        slice = slice.or(own);
        if mirrored {
            notes.push(format!(
                "{}: its axes are left-handed as this library sees them; z is taken with the other sign",
                camera.name
            ));
        }
        cameras.push(camera);
    }
    match slice {
        None => notes.push(
            "the files do not say where the laser plane lies (SliceCoord): z = 0 of their axes is taken for the sheet; look with spivcal check \
             whether the light is there"
                .into(),
        ),
        Some(slice) => {
            let world_from_sheet = slice.frame();
            cameras.iter_mut().for_each(|c| c.cam_from_world = c.cam_from_world * world_from_sheet);
            let t = world_from_sheet.translation_mm;
            notes.push(format!(
                "the sheet is the slice of SliceCoord and SliceAngle; its origin lies at ({:.3}, {:.3}, {:.3}) mm of the file's axes",
                t.x,
                t.y,
                if handed == Some(true) { -t.z } else { t.z }
            ));
        }
    }
    Ok(Found { cameras, has_sheet: true, of_marks: false, notes, program: "uvmat" })
}

/// The laser plane in the file's axes, mm; z of left-handed ones turned.
#[derive(Debug, Clone, Copy)]
struct Slice {
    normal: Vector3<f64>,
    distance_mm: f64,
}

impl Slice {
    /// The one slice of a file; none where it states none.
    fn read<'a>(xml: &Xml<'a>, geometry: Node<'_, 'a>, scale: f64, mirrored: bool) -> Result<Option<Self>> {
        let numbers = |name: &str| -> Result<Vec<Vec<f64>>> {
            let all = geometry.children().filter(|n| n.tag_name().name().split("_").next() == Some(name));
            all.map(|n| xml.numbers(n)).collect()
        };
        let (places, angles) = (numbers("SliceCoord")?, numbers("SliceAngle")?);
        let stated = numbers("NbSlice")?.concat().first().copied().unwrap_or(1.0);
        if places.len() > 1 || angles.len() > 1 || stated > 1.0 || places.iter().chain(&angles).any(|x| x.len() > 3) {
            let message = "it states several slices, and a calibration here has one sheet; leave the SliceCoord and SliceAngle of the slice that is \
                           wanted, with NbSlice 1";
            return Err(xml.fault(geometry, message.into()));
        }
        let three = |name: &str, all: &[Vec<f64>]| match all {
            [] => Ok(None),
            [one] if one.len() == 3 => Ok(Some(Vector3::from_column_slice(one))),
            _ => Err(xml.fault(geometry, format!("{name} of <GeometryCalib> has not three numbers: expected x y z"))),
        };
        let (place, angle_deg) = (three("SliceCoord", &places)?, three("SliceAngle", &angles)?);
        let Some(place) = place else {
            return match angle_deg.filter(|a| a.norm() > 0.0) {
                None => Ok(None),
                Some(_) => {
                    Err(xml
                        .fault(geometry, "it has a SliceAngle but no SliceCoord, a point of that plane; add it".into()))
                }
            };
        };
        let turn = rotation_exp(&angle_deg.unwrap_or_default().map(f64::to_radians));
        let hand = Vector3::new(1.0, 1.0, if mirrored { -1.0 } else { 1.0 });
        let (mut normal, place) = (turn.column(2).component_mul(&hand), place.component_mul(&hand) * scale);
        // Either side of a plane will do; the nearer to z keeps the axes.
        if normal.z < 0.0 {
            normal = -normal;
        }
        Ok(Some(Self { normal, distance_mm: normal.dot(&place) }))
    }
    /// Whether two files mean different planes: by a thousandth of a mm or of a radian.
    fn differs(&self, other: &Self) -> bool {
        !((self.normal - other.normal).norm() < 1e-3 && (self.distance_mm - other.distance_mm).abs() < 1e-3)
    }
    /// World from sheet.
    fn frame(&self) -> Motion<Sheet, Sheet> {
        let turn = Rotation3::rotation_between(&Vector3::z(), &self.normal).unwrap_or_default();
        Motion::new(turn.into_inner(), self.normal * self.distance_mm)
    }
}

/// What a file holds: its camera, whether its axes are of the other hand, the laser plane where it states one.
struct Read {
    camera: WorldCamera,
    mirrored: bool,
    slice: Option<Slice>,
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

fn camera(file: &NamedText, size_px: [usize; 2], options: &ImportOptions) -> Result<Read> {
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
    let slice = Slice::read(&xml, geometry, scale, mirrored)?;
    Ok(Read { camera, mirrored, slice })
}
