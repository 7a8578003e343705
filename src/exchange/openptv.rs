//! OpenPTV: one `.ori` (pose, principal point, principal distance, glass) and one `.addpar` (distortion) per camera.
//!
//! ```text
//! p = D^T (X - X0),   x = xh - cc p_x / p_z,   y = yh - cc p_y / p_z          D: .ori's 3x3 matrix; p_z < 0 in front
//! r2 = x^2 + y^2,  g = 1 + k1 r2 + k2 r2^2 + k3 r2^3
//! x' = x g + p1 (r2 + 2 x^2) + 2 p2 x y,   y' = y g + p2 (r2 + 2 y^2) + 2 p1 x y
//! x" = sx x' - sin(s) y',   y" = cos(s) y'                                   mm on the sensor, x right, y up
//! column = x" / pitch + width / 2,  row = height / 2 - y" / pitch              centre of the first pixel: (0.5, 0.5)
//! ```
//! Source: the OpenPTV library's `imgcoord`, `trafo` and `calibration` (documentation and file format). Written for media
//! with one refractive index (air to air): the glass vector then has no effect. A camera with a tilt and distortion has
//! its distortion about the lens axis, OpenPTV about the image centre: the nearest is fitted and the loss told.

use super::distorted::{of_either_polynomial, squared_radii};
use super::refit::{Loss, ideal_of_pixel, moved, radial_steps, rays, refit_with_k3};
use super::{Cameras, Conversion, Found, ImportOptions, NamedText, WorldCamera};
use crate::camera::{Camera, Intrinsics};
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::{Motion, orthonormalised};
use nalgebra::{Matrix3, Vector2, Vector3};

/// x right and y down in the camera of this library; y up and z towards the viewer in OpenPTV's.
const FLIP: [f64; 3] = [1.0, -1.0, -1.0];

/// Interior orientation and distortion: cc, xh, yh (mm), k1 k2 k3 p1 p2, scale, shear.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Interior {
    cc_mm: f64,
    xh_mm: f64,
    yh_mm: f64,
    ap: [f64; 7],
}

/// The sensor: size (px) and pixel pitch (mm).
#[derive(Debug, Clone, Copy)]
struct Sensor {
    size_px: [usize; 2],
    pitch_mm: f64,
}

impl Interior {
    /// Image of a point in this library's camera frame (z forward), px with (0, 0) the centre of the first pixel.
    fn project(&self, p: &Vector3<f64>, sensor: Sensor) -> Option<Vector2<f64>> {
        if !(p.z > 0.0) {
            return None;
        }
        // With p = FLIP p_openptv: -cc p_x / p_z = cc X / Z and y changes its sign.
        let x = self.xh_mm + self.cc_mm * p.x / p.z;
        let y = self.yh_mm - self.cc_mm * p.y / p.z;
        let [k1, k2, k3, p1, p2, scale, shear] = self.ap;
        let r2 = x * x + y * y;
        let g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let xd = x * g + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y;
        let yd = y * g + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y;
        let (xa, ya) = (scale * xd - shear.sin() * yd, shear.cos() * yd);
        let half = sensor.size_px.map(|n| 0.5 * n as f64 - 0.5);
        Some(Vector2::new(half[0] + xa / sensor.pitch_mm, half[1] - ya / sensor.pitch_mm))
    }
}

fn interior(p: &[f64], cc_mm: f64) -> Interior {
    let ap = [p[9], p[10], p[15], p[11], p[12], p[13], p[14]];
    Interior { cc_mm: cc_mm * p[6], xh_mm: p[7], yh_mm: p[8], ap }
}

/// The nearest OpenPTV camera: interior, pose in this library's axes, loss.
fn nearest(c: &WorldCamera, sensor: Sensor) -> Result<(Interior, Motion<Cam, Sheet>, Loss)> {
    // Without distortion the camera is an untilted pinhole along its sensor normal: exact.
    let e = c.camera.effective_pinhole();
    let aspect = c.camera.intrinsics().aspect;
    let pose: Motion<Cam, Sheet> =
        Motion::<Cam, Cam>::new(c.camera.cam_from_pinhole().transpose(), Vector3::zeros()) * c.cam_from_world;
    let half = sensor.size_px.map(|n| 0.5 * n as f64 - 0.5);
    let cc_mm = e.f_px * aspect * sensor.pitch_mm;
    let (xh, yh) = (aspect * (e.cx_px - half[0]) * sensor.pitch_mm, (half[1] - e.cy_px) * sensor.pitch_mm);
    let start = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, xh, yh, 0.0, 0.0, 0.0, 0.0, 1.0 / aspect, 0.0, 0.0];
    let seen = c.seen()?;
    let [k1, k2, k3] = radial_steps(squared_radii(&pose, &seen).map(|s| s * cc_mm * cc_mm));
    let (turn, shift, mm) = (1e-6, c.center().step_mm(&pose), 1e-2 * sensor.pitch_mm);
    let steps = [turn, turn, turn, shift, shift, shift, 1e-6, mm, mm, k1, k2, 1e-6, 1e-6, 1e-6, 1e-6, k3];
    let project = |p: &[f64], x: &Vector3<f64>| interior(p, cc_mm).project(&moved(&pose, p).apply(x), sensor);
    let (p, loss) = refit_with_k3(&seen, &start, &steps, &project)
        .ok_or_else(|| Invalid::Contradiction(format!("camera \"{}\" does not see the sheet", c.name)))?;
    Ok((interior(&p, cc_mm), moved(&pose, &p), loss))
}

/// The two files of a camera.
fn files(name: &str, i: &Interior, pose: &Motion<Cam, Sheet>) -> [(String, Vec<u8>); 2] {
    let center = pose.inverse().translation_mm;
    // D: world from OpenPTV's camera.
    let d = pose.rotation.transpose() * Matrix3::from_diagonal(&Vector3::from(FLIP));
    let phi = d.m13.asin();
    let (omega, kappa) = ((-d.m23).atan2(d.m33), (-d.m12).atan2(d.m11));
    let row = |v: [f64; 3]| format!("{:.17e} {:.17e} {:.17e}\n", v[0], v[1], v[2]);
    let mut ori = row(center.into()) + &row([omega, phi, kappa]) + "\n";
    (0..3).for_each(|r| ori += &row([d[(r, 0)], d[(r, 1)], d[(r, 2)]]));
    ori += &format!("\n{:.17e} {:.17e}\n{:.17e}\n\n", i.xh_mm, i.yh_mm, i.cc_mm);
    // A pane half way to the sheet, parallel to it.
    ori += &row([0.0, 0.0, 0.5 * center.z]);
    let ap = i.ap.map(|x| format!("{x:.17e}")).join(" ") + "\n";
    [(format!("{name}.ori"), ori.into_bytes()), (format!("{name}.addpar"), ap.into_bytes())]
}

/// Two files per camera.
pub(super) fn export(rig: &Cameras) -> Result<Conversion<Vec<(String, Vec<u8>)>>> {
    let (mut result, mut losses, mut notes) = (Vec::new(), Vec::new(), rig.notes.clone());
    for (c, file_name) in rig.cameras.iter().zip(rig.file_names()) {
        let pitch_mm = c.pixel_pitch_mm.ok_or_else(|| {
            Invalid::Contradiction(format!(
                "OpenPTV measures on the sensor in mm, but the pixel pitch of camera \"{}\" is unknown; add pixel_pitch_mm \
                 to the rig file or the calibration",
                c.name
            ))
        })?;
        let sensor = Sensor { size_px: c.image_size_px, pitch_mm };
        let (interior, pose, loss) = nearest(c, sensor)?;
        result.extend(files(&file_name, &interior, &pose));
        losses.push(loss);
        notes.push(format!(
            "{}: set imx = {}, imy = {}, pix_x = pix_y = {pitch_mm} in ptv.par, and refractive indices n1 = n2 = n3 = 1",
            c.name, c.image_size_px[0], c.image_size_px[1]
        ));
    }
    Ok(Conversion::of(result, losses, notes))
}

fn numbers(file: &NamedText, expected: usize, what: &str) -> Result<Vec<f64>> {
    let mut out = Vec::new();
    for (i, line) in file.text.lines().enumerate() {
        for word in line.split_whitespace() {
            let x: f64 = word.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| Invalid::Syntax {
                file: file.name.clone(),
                line: i + 1,
                message: format!("\"{word}\" is not a finite number; expected {what}"),
            })?;
            out.push(x);
        }
    }
    if out.len() < expected {
        let message = format!("{} numbers: expected {expected} ({what})", out.len());
        return Err(Invalid::File { path: file.name.clone(), message }.into());
    }
    Ok(out)
}

fn camera(ori: &NamedText, addpar: Option<&NamedText>, sensor: Sensor) -> Result<WorldCamera> {
    let n = numbers(ori, 21, "centre, angles, 3 x 3 matrix, xh yh, cc, glass vector")?;
    let d = Matrix3::from_row_slice(&n[6..15]);
    let gap = (d * d.transpose() - Matrix3::identity()).abs().max();
    if !(gap < 1e-4) || d.determinant() < 0.0 {
        let message = format!("its 3 x 3 matrix is not a rotation: D D^T differs from 1 by {gap:.1e}");
        return Err(Invalid::Syntax { file: ori.name.clone(), line: 4, message }.into());
    }
    let mut ap = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    if let Some(file) = addpar {
        ap.copy_from_slice(&numbers(file, 7, "k1 k2 k3 p1 p2 scale shear")?[..7]);
    }
    let it = Interior { cc_mm: n[17], xh_mm: n[15], yh_mm: n[16], ap };
    let rotation = Matrix3::from_diagonal(&Vector3::from(FLIP)) * orthonormalised(&d).transpose();
    let pose: Motion<Cam, Sheet> = Motion::new(rotation, -(rotation * Vector3::new(n[0], n[1], n[2])));
    let half = sensor.size_px.map(|n| 0.5 * n as f64 - 0.5);
    let scale = it.ap[5];
    let f = it.cc_mm * scale / sensor.pitch_mm;
    let mut start =
        Intrinsics::pinhole(f, half[0] + scale * it.xh_mm / sensor.pitch_mm, half[1] - it.yh_mm / sensor.pitch_mm);
    start.aspect = 1.0 / scale;
    let plain = it.ap[..5] == [0.0; 5] && it.ap[6] == 0.0;
    let name = ori.name.rsplit(['/', '\\']).next().unwrap_or_default().trim_end_matches(".ori").to_string();
    let (camera, cam_from_world, loss) = if plain {
        (Camera::new(start)?, pose, Loss::NONE)
    } else {
        let ideal = |q: &Vector2<f64>| ideal_of_pixel(q, |xy| it.project(&xy.push(1.0), sensor));
        let seen = rays(&name, sensor.size_px, &pose, ideal)?;
        // The same polynomial, were the distortion about the axis; k in 1/mm^2, 1/mm^4, 1/mm^6 of the sensor.
        let bent = Intrinsics { k: [0, 1, 2].map(|n| it.ap[n] * it.cc_mm.powi(2 * n as i32 + 2)), ..start };
        let sees = |c: &Camera| seen.iter().all(|s| c.project_xyz(&pose.apply(&s.xyz_mm)).is_ok());
        let near = Camera::new(bent).ok().filter(sees);
        of_either_polynomial(&near.map_or_else(|| Camera::new(start), Ok)?, &pose, &seen)?
    };
    let pixel_pitch_mm = Some(sensor.pitch_mm);
    Ok(WorldCamera { name, image_size_px: sensor.size_px, pixel_pitch_mm, camera, cam_from_world, loss, points: None })
}

/// The cameras of `.ori` files, each with the `.addpar` of the same name where it is among the files.
pub(super) fn import(given: &[NamedText], options: &ImportOptions) -> Result<Found> {
    let (Some(size_px), Some(pitch_mm)) = (options.image_size_px, options.pixel_pitch_mm) else {
        return Err(Invalid::Contradiction(
            "OpenPTV keeps image size and pixel pitch in ptv.par; give them with --image-size WxH and --pixel-pitch-mm P"
                .into(),
        )
        .into());
    };
    let sensor = Sensor { size_px, pitch_mm };
    let mut cameras = Vec::new();
    for ori in given.iter().filter(|f| f.name.ends_with(".ori")) {
        let partner = ori.name.trim_end_matches("ori").to_string() + "addpar";
        cameras.push(camera(ori, given.iter().find(|f| f.name == partner), sensor)?);
    }
    if cameras.is_empty() {
        return Err(Invalid::Contradiction("no .ori file among the files given".into()).into());
    }
    let notes = vec![
        "read without glass: if ptv.par has refractive indices other than 1, these cameras see something else"
            .to_string(),
        "z = 0 of the file's world (that of the target) is taken for the laser sheet, which OpenPTV does not state; look with spivcal check \
         whether the light is there"
            .to_string(),
    ];
    Ok(Found { cameras, has_sheet: true, of_marks: false, notes, program: "openptv" })
}
