//! MATLAB: a level 5 file of plain double matrices, and the nearest camera without tilt.
//!
//! MATLAB's camera has fx, fy, skew, a principal point, three radial and two tangential coefficients, and no tilt; pixel
//! (1, 1) is the centre of the first pixel. Tilt without distortion is an untilted pinhole exactly; with distortion the
//! nearest is fitted. Variables per camera n: `imageSize<n>` (height, width), `K<n>`, `radial<n>`, `tangential<n>`, and
//! `R<n>`, `t<n>` with `p_in_camera = R p_in_sheet + t` (mm).
//! Source of the container: "MAT-File Format", MathWorks, level 5.

use super::distorted::{OpenCvCamera, squared_radii};
use super::refit::{moved, radial_steps, refit_with_k3};
use super::{Cameras, Conversion, Loss, WorldCamera};
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::{DMatrix, Vector3};

const INT8: u32 = 1;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const DOUBLE: u32 = 9;
const MATRIX: u32 = 14;
const DOUBLE_CLASS: u32 = 6;

/// An element: type, length, bytes, padding to eight.
fn element(kind: u32, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() + 16);
    out.extend(kind.to_le_bytes());
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend(bytes);
    out.resize(out.len().div_ceil(8) * 8, 0);
    out
}

/// A named matrix of doubles, column by column.
fn variable(name: &str, m: &DMatrix<f64>) -> Vec<u8> {
    let flags: Vec<u8> = [DOUBLE_CLASS, 0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let size: Vec<u8> = [m.nrows() as i32, m.ncols() as i32].iter().flat_map(|x| x.to_le_bytes()).collect();
    let data: Vec<u8> = m.iter().flat_map(|x| x.to_le_bytes()).collect();
    let parts =
        [element(UINT32, &flags), element(INT32, &size), element(INT8, name.as_bytes()), element(DOUBLE, &data)];
    element(MATRIX, &parts.concat())
}

/// The 128 bytes before the first element.
fn header() -> Vec<u8> {
    let mut out = format!("MATLAB 5.0 MAT-file, written by spivcal {}", env!("CARGO_PKG_VERSION")).into_bytes();
    out.resize(124, b' ');
    out.extend([0x00, 0x01, b'I', b'M']);
    out
}

/// The nearest camera without tilt, its pose, the loss.
fn untilted(c: &WorldCamera) -> Result<(OpenCvCamera, Motion<Cam, Sheet>, Loss)> {
    let e = c.camera.effective_pinhole();
    let aspect = c.camera.intrinsics().aspect;
    let pose: Motion<Cam, Sheet> =
        Motion::<Cam, Cam>::new(c.camera.cam_from_pinhole().transpose(), Vector3::zeros()) * c.cam_from_world;
    let of = |p: &[f64]| {
        let mut d = [0.0; 14];
        (d[0], d[1], d[2], d[3], d[4]) = (p[10], p[11], p[12], p[13], p[14]);
        OpenCvCamera { fx_px: p[6] * e.f_px, fy_px: p[7] * e.f_px * aspect, cx_px: p[8], cy_px: p[9], d }
    };
    let start = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, e.cx_px, e.cy_px, 0.0, 0.0, 0.0, 0.0, 0.0];
    let seen = c.seen()?;
    let (turn, shift, [k1, k2, k3]) = (1e-6, c.center().step_mm(&pose), radial_steps(squared_radii(&pose, &seen)));
    let steps = [turn, turn, turn, shift, shift, shift, 1e-6, 1e-6, 0.01, 0.01, k1, k2, 1e-5, 1e-5, k3];
    let (p, loss) = refit_with_k3(&seen, &start, &steps, &|p, x| of(p).project(&moved(&pose, p).apply(x)))
        .ok_or_else(|| Invalid::Contradiction(format!("camera \"{}\" does not see the sheet", c.name)))?;
    Ok((of(&p), moved(&pose, &p), loss))
}

/// One file with all cameras.
pub(super) fn export(rig: &Cameras) -> Result<Conversion<Vec<(String, Vec<u8>)>>> {
    let (mut bytes, mut losses, mut notes) = (header(), Vec::new(), rig.notes.clone());
    for (i, c) in rig.cameras.iter().enumerate() {
        let (m, pose, loss) = untilted(c)?;
        let n = i + 1;
        let row = |x: &[f64]| DMatrix::from_row_slice(1, x.len(), x);
        let k = [m.fx_px, 0.0, m.cx_px + 1.0, 0.0, m.fy_px, m.cy_px + 1.0, 0.0, 0.0, 1.0];
        let r = &pose.rotation;
        let variables = [
            ("imageSize", row(&[c.image_size_px[1] as f64, c.image_size_px[0] as f64])),
            ("K", DMatrix::from_row_slice(3, 3, &k)),
            ("radial", row(&[m.d[0], m.d[1], m.d[4]])),
            ("tangential", row(&m.d[2..4])),
            ("R", DMatrix::from_fn(3, 3, |a, b| r[(a, b)])),
            ("t", DMatrix::from_column_slice(3, 1, pose.translation_mm.as_slice())),
        ];
        bytes.extend(variables.iter().flat_map(|(name, m)| variable(&format!("{name}{n}"), m)));
        notes.push(format!(
            "{}: intrinsics = cameraIntrinsics([K{n}(1,1) K{n}(2,2)], [K{n}(1,3) K{n}(2,3)], imageSize{n}, \
             RadialDistortion=radial{n}, TangentialDistortion=tangential{n}); pose = rigidtform3d(R{n}, t{n})",
            c.name
        ));
        losses.push(loss);
    }
    Ok(Conversion::of(vec![("cameras.mat".into(), bytes)], losses, notes))
}
