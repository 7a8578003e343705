//! OpenCV: `M1 D1 M2 D2 R T` of the stereo sample, the tilt in the last two of 14 coefficients, and the sheet.
//!
//! `p_in_camera2 = R p_in_camera1 + T` and `p_in_camera1 = R_sheet p_in_sheet + T_sheet`, mm, in OpenCV's camera frames, which
//! are rolled about the lens axis against those of this library (see `camera::OpenCvTilted`). A file with
//! `camera_matrix` and `distortion_coefficients` is read as one camera.

use super::distorted::{OpenCvCamera, fit_scheimpflug};
use super::storage::{self, Matrix, Node, Storage, Syntax, pixels};
use super::{Cameras, Conversion, Found, ImportOptions, Loss, NamedText, WorldCamera};
use crate::camera::{Camera, Intrinsics, OpenCvTilted};
use crate::error::{Error, Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::{Motion, orthonormalised};
use nalgebra::{Matrix3, Vector3};

/// A camera as OpenCV holds it: its model, the pose of the sheet in OpenCV's frame, what is lost.
struct Held {
    model: OpenCvTilted,
    opencv_from_sheet: Motion<Cam, Sheet>,
    loss: Loss,
}

fn held(c: &WorldCamera) -> Result<Held> {
    let (model, pose, loss) = match c.camera.to_opencv() {
        Ok(model) => (model, c.cam_from_world, c.loss),
        Err(_) => {
            // A pupil ratio or the other polynomial: the nearest camera with neither.
            let i = c.camera.intrinsics();
            let mut start = Intrinsics { pupil_ratio: 1.0, radial: Default::default(), ..*i };
            if i.radial != start.radial {
                start.k = i.k.map(|k| -k);
            }
            let (camera, pose, loss) =
                fit_scheimpflug(&Camera::new(start)?, &c.cam_from_world, &c.seen()?, c.center())?;
            (camera.to_opencv()?, pose, loss)
        }
    };
    let turn: Motion<Cam, Cam> = Motion::new(model.cam_from_opencv().transpose(), Vector3::zeros());
    Ok(Held { model, opencv_from_sheet: turn * pose, loss })
}

fn rows(m: &Matrix3<f64>) -> Matrix {
    Matrix { rows: 3, columns: 3, data: m.transpose().as_slice().to_vec() }
}

fn column(data: Vec<f64>) -> Matrix {
    Matrix { rows: data.len(), columns: 1, data }
}

/// One file with all cameras.
pub(super) fn export(rig: &Cameras, syntax: Syntax) -> Result<Conversion<Vec<(String, Vec<u8>)>>> {
    let all = rig.cameras.iter().map(held).collect::<Result<Vec<_>>>()?;
    let mut nodes = Vec::new();
    for (i, (c, h)) in rig.cameras.iter().zip(&all).enumerate() {
        let (m, n) = (&h.model, i + 1);
        nodes.push(Node::Word(format!("name{n}"), c.name.clone()));
        nodes.push(Node::Number(format!("image_width{n}"), c.image_size_px[0] as f64));
        nodes.push(Node::Number(format!("image_height{n}"), c.image_size_px[1] as f64));
        let k = Matrix3::new(m.fx_px, 0.0, m.cx_px, 0.0, m.fy_px, m.cy_px, 0.0, 0.0, 1.0);
        nodes.push(Node::Matrix(format!("M{n}"), rows(&k)));
        nodes.push(Node::Matrix(format!("D{n}"), column(m.distortion_coefficients().to_vec())));
    }
    if let [first, second] = &all[..] {
        let motion = second.opencv_from_sheet * first.opencv_from_sheet.inverse();
        nodes.push(Node::Matrix("R".into(), rows(&motion.rotation)));
        nodes.push(Node::Matrix("T".into(), column(motion.translation_mm.as_slice().to_vec())));
    }
    if let Some(first) = all.first() {
        nodes.push(Node::Matrix("R_sheet".into(), rows(&first.opencv_from_sheet.rotation)));
        nodes.push(Node::Matrix("T_sheet".into(), column(first.opencv_from_sheet.translation_mm.as_slice().to_vec())));
    }
    let name = match syntax {
        Syntax::Yaml => "opencv.yml",
        Syntax::Xml => "opencv.xml",
    };
    let mut notes = rig.notes.clone();
    notes.push(
        "project with cv::projectPoints and all 14 coefficients; OpenCV's camera frames are rolled about the lens axis \
         against those of calibration.json, and R, T, R_sheet, T_sheet are in OpenCV's"
            .into(),
    );
    let losses = all.iter().map(|h| h.loss).collect();
    Ok(Conversion::of(vec![(name.into(), storage::write(&nodes, syntax).into_bytes())], losses, notes))
}

/// One or two files, read as one.
struct Source<'a> {
    files: &'a [NamedText],
    storage: Storage,
}

impl<'a> Source<'a> {
    fn read(files: &'a [NamedText]) -> Result<Self> {
        let mut storage = Storage::default();
        for file in files {
            let more = storage::read(file)?;
            if let Some((key, _)) =
                more.matrices.iter().find(|(k, m)| storage.matrices.get(*k).is_some_and(|o| o != *m))
            {
                let what = format!(
                    "{key} is in both files, with different numbers; give the one or two files of one calibration (cameras of \
                     two files need the motion between them)"
                );
                return Err(storage::refusal(file, key, what));
            }
            storage.matrices.extend(more.matrices);
            storage.numbers.extend(more.numbers);
            storage.words.extend(more.words);
        }
        Ok(Self { files, storage })
    }
    fn matrix(&self, key: &str) -> Option<&Matrix> {
        self.storage.matrices.get(key)
    }
    fn missing(&self, what: &str) -> Error {
        let path = self.files.iter().map(|f| f.name.as_str()).collect::<Vec<_>>().join(", ");
        Invalid::File { path, message: format!("there is no {what}") }.into()
    }
    /// What is wrong with a matrix that was found.
    fn refusal(&self, key: &str, message: String) -> Error {
        let holds = |f: &&NamedText| storage::line_of(f, key).is_some();
        self.files.iter().find(holds).map_or_else(
            || Invalid::Contradiction(message.clone()).into(),
            |file| storage::refusal(file, key, message.clone()),
        )
    }
    fn matrix3(&self, key: &str) -> Result<Matrix3<f64>> {
        let m = self.matrix(key).ok_or_else(|| self.missing(&format!("matrix {key}")))?;
        if (m.rows, m.columns) != (3, 3) {
            return Err(self.refusal(key, format!("{key} is {} x {}: expected 3 x 3", m.rows, m.columns)));
        }
        Ok(Matrix3::from_row_slice(&m.data))
    }
    /// A pose of two matrices; a 3-vector in the place of the rotation is a rotation vector.
    fn pose(&self, rotation: &str, translation: &str) -> Result<Option<Motion<Cam, Sheet>>> {
        let Some(r) = self.matrix(rotation) else { return Ok(None) };
        let turn = match r.data.len() {
            3 => crate::rigid::rotation_exp(&Vector3::from_row_slice(&r.data)),
            _ => self.matrix3(rotation)?,
        };
        let gap = (turn * turn.transpose() - Matrix3::identity()).abs().max();
        if !(gap < 1e-5) || turn.determinant() < 0.0 {
            let message = format!("{rotation} is not a rotation: R R^T differs from 1 by {gap:.1e}");
            return Err(self.refusal(rotation, message));
        }
        let t = self.matrix(translation).filter(|t| t.data.len() == 3);
        let t = t.ok_or_else(|| self.missing(&format!("vector {translation} of 3 numbers")))?;
        Ok(Some(Motion::new(orthonormalised(&turn), Vector3::from_row_slice(&t.data))))
    }
    fn model(&self, camera_matrix: &str, coefficients: &str) -> Result<OpenCvCamera> {
        let k = self.matrix3(camera_matrix)?;
        if k.m12.abs() > 1e-9 * k.m11.abs() {
            let message = format!("{camera_matrix} has a skew of {}: the camera of this library has none", k.m12);
            return Err(self.refusal(camera_matrix, message));
        }
        let found = self.matrix(coefficients).ok_or_else(|| {
            let seen = self.storage.matrices.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            self.missing(&format!(
                "matrix {coefficients}, the distortion coefficients that go with {camera_matrix} (matrices found: {seen}); name it \
                 {coefficients}, or write four zeros where the lens has no distortion"
            ))
        })?;
        if ![4, 5, 8, 12, 14].contains(&found.data.len()) {
            let message =
                format!("{coefficients} has {} coefficients: OpenCV knows 4, 5, 8, 12 or 14", found.data.len());
            return Err(self.refusal(coefficients, message));
        }
        let mut d = [0.0; 14];
        d[..found.data.len()].copy_from_slice(&found.data);
        Ok(OpenCvCamera { fx_px: k.m11, fy_px: k.m22, cx_px: k.m13, cy_px: k.m23, d })
    }
    fn size(&self, n: &str, options: &ImportOptions) -> Result<[usize; 2]> {
        let numbers = &self.storage.numbers;
        let of = |key: &str| numbers.get(&format!("{key}{n}")).or(numbers.get(key)).copied().and_then(pixels);
        match (of("image_width"), of("image_height"), options.image_size_px) {
            (Some(w), Some(h), _) => Ok([w, h]),
            (_, _, Some(given)) => Ok(given),
            _ => Err(self.missing("image size (image_width, image_height); give it with --image-size WxH")),
        }
    }
}

/// The cameras of one file, or of the two that OpenCV's stereo sample writes (intrinsics and extrinsics).
pub(super) fn import(files: &[NamedText], options: &ImportOptions) -> Result<Found> {
    if files.len() > 2 {
        let what = "OpenCV keeps all cameras in one file, or in two (intrinsics and extrinsics); give one or two";
        return Err(Invalid::Contradiction(what.into()).into());
    }
    let s = Source::read(files)?;
    if s.storage.numbers.get("fisheye_model").is_some_and(|f| *f != 0.0) {
        let what = "the camera is of OpenCV's fisheye model, which this library does not have; calibrate without it (CALIB_* of calib3d)";
        return Err(s.refusal("fisheye_model", what.into()));
    }
    let keys: Vec<[&str; 3]> = if s.matrix("M1").is_some() {
        [["M1", "D1", "1"], ["M2", "D2", "2"]].into_iter().filter(|k| s.matrix(k[0]).is_some()).collect()
    } else if s.matrix("camera_matrix").is_some() {
        vec![["camera_matrix", "distortion_coefficients", ""]]
    } else {
        return Err(s.missing("camera: expected the matrices M1, D1 (and M2, D2, R, T), or camera_matrix"));
    };
    let mut notes = Vec::new();
    let known = s.pose("R_sheet", "T_sheet")?;
    let has_sheet = known.is_some();
    // Without a sheet the world is a plane that faces the first camera; nothing that is found hangs on it.
    let facing = || Motion::new(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)), Vector3::new(0.0, 0.0, 1000.0));
    let plane = known.unwrap_or_else(facing);
    if !has_sheet {
        notes.push(
            "R_sheet, T_sheet are missing, so the calibration has no laser sheet; find it with `spivcal sheet`".into(),
        );
    }
    let mut cameras = Vec::new();
    for (i, [matrix, coefficients, n]) in keys.into_iter().enumerate() {
        let opencv_from_plane = if i == 0 {
            plane
        } else {
            let what = "matrix R (second camera from first); where the motion is in a file of its own (extrinsics), give both files";
            let motion = s.pose("R", "T")?.ok_or_else(|| s.missing(what))?;
            Motion::<Cam, Cam>::new(motion.rotation, motion.translation_mm) * plane
        };
        let image_size_px = s.size(n, options)?;
        let name = s.storage.words.get(&format!("name{n}")).cloned().unwrap_or_else(|| format!("camera{}", i + 1));
        let (camera, cam_from_world, loss) =
            s.model(matrix, coefficients)?.to_scheimpflug(&name, &opencv_from_plane, image_size_px)?;
        let pixel_pitch_mm = options.pixel_pitch_mm;
        cameras.push(WorldCamera { name, image_size_px, pixel_pitch_mm, camera, cam_from_world, loss, points: None });
    }
    Ok(Found { cameras, has_sheet, of_marks: false, notes, program: "opencv" })
}
