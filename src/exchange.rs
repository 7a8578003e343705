//! Other people's formats: a calibration written for another package, or read from it.
//!
//! Every format states cameras in a world whose plane z = 0 is the laser sheet (mm). Where a format holds the camera of
//! this library exactly, the numbers are converted; where it does not, the nearest camera that it can hold is fitted over the whole
//! image, and the loss is stated in px. The projection centre stays where it is, so that the loss is the same at every depth.
//! A flat window is held by `csv` and within the polynomials of `soloff` only; elsewhere the nearest camera without one is fitted on the
//! sheet and [2 % of the distance](Conversion::notes) before and behind it (`behind.rs`), and the loss holds there.
//!
//! | format | written | read | conventions |
//! |---|---|---|---|
//! | `opencv` | YAML, XML | YAML, XML | `M1 D1 M2 D2 R T` as OpenCV's stereo sample writes them (two files are read as one), 14 coefficients with the tilt; pixel (0, 0) is the centre of the first pixel; camera frames rolled as OpenCV's tilt wants it; `R_sheet T_sheet`: first camera from sheet, which is unknown without them |
//! | `openptv` | `.ori`, `.addpar` | the same | mm on the sensor, y up, z towards the viewer; the centre of the first pixel is (0.5, 0.5); distortion about the image centre; no glass |
//! | `davis` | - | `Calibration.xml` (pinhole), `MarkPositionTable.xml` | focal length in mm over the sensor's pixel size, `R = Rz Ry Rx`, distortion k1 k2 p1 p2 on normalised coordinates |
//! | `uvmat` | - | XML (`GeometryCalib`) | image y up from the lower edge, pixel centres at half numbers, one radial coefficient |
//! | `matlab` | `.mat` (level 5) | - | pixel (1, 1) is the centre of the first pixel; plain matrices for `cameraIntrinsics` and `rigidtform3d`: no tilt, so the nearest camera with tangential terms is fitted. PIVlab's own calibration file holds MATLAB objects, which only MATLAB can write |
//! | `soloff` | text | - | 19 coefficients in u and v per camera over the common field, coordinates scaled to -1 to 1, fitted (`soloff.rs`); pixel (0, 0) is the centre of the first pixel |
//! | `csv` | tables | - | cameras, windows, sheet and poses of the views, with standard deviations where the record has them, and the covariance; not target, scale, baseline, fit and uncertainty of the mapping, which calibration.json holds |
//!
//! Where a format does not state the laser sheet (OpenPTV, marks of DaVis, UVMAT without a slice) z = 0 of its world is taken for it, and noted.
//! Covariances travel only in `csv`: no other format has a place for them, and a calibration read from one has none.

mod behind;
mod csv;
mod davis;
mod distorted;
mod imported;
mod marks;
mod matlab;
mod opencv;
mod openptv;
mod placed;
mod refit;
mod soloff;
mod storage;
mod uvmat;
mod xml;

use crate::camera::Camera;
use crate::dewarp::SoloffDegrees;
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Rig, Sheet};
use crate::record::Record;
use crate::rigid::Motion;
use refit::PIXELS;

pub use placed::{placed, placed_at_view};
pub use refit::Loss;

/// Formats that can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportFormat {
    /// OpenCV file storage, YAML.
    OpenCv,
    /// OpenCV file storage, XML.
    OpenCvXml,
    /// OpenPTV orientation and distortion files.
    OpenPtv,
    /// MATLAB level 5 file of plain matrices.
    Matlab,
    /// Coefficients of Soloff's polynomials, text.
    Soloff,
    /// Tables of the numbers of cameras, sheet and views, and their covariance.
    Csv,
}

/// Formats that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImportFormat {
    /// OpenCV file storage, YAML or XML.
    OpenCv,
    /// OpenPTV `.ori` files, each followed by its `.addpar` where there is one.
    OpenPtv,
    /// DaVis `Calibration.xml` or `MarkPositionTable.xml`.
    DaVis,
    /// UVMAT XML, one file per camera.
    Uvmat,
}

/// A file as text with its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NamedText {
    /// Name as the user gave it; also names the camera where the format does not.
    pub name: String,
    /// Its content.
    pub text: String,
}

/// What a format does not say itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImportOptions {
    /// Width and height of the images, px.
    pub image_size_px: Option<[usize; 2]>,
    /// Size of a pixel, mm.
    pub pixel_pitch_mm: Option<f64>,
}

/// What a conversion did.
#[derive(Debug, Clone, PartialEq)]
pub struct Conversion<T> {
    /// Files, or the record.
    pub result: T,
    /// Loss per camera, in the order of the cameras; [`Loss::NONE`] where the format holds the camera exactly.
    pub losses: Vec<Loss>,
    /// How far marks lie from where the camera that was fitted to them sees them, px, per camera; empty where cameras were not fitted to marks.
    /// It is what measured marks scatter, and no loss of the conversion.
    pub marks: Vec<Loss>,
    /// What was assumed or left away, in words.
    pub notes: Vec<String>,
}

/// A loss above this is told as a flag: it is larger than what a good calibration leaves, px.
pub const LOSS_LIMIT_PX: f64 = 0.02;

/// Marks whose residuals are larger than this, rms in px, are told as a flag: good ones leave 0.05 px, poor ones 0.2 px.
pub const MARKS_LIMIT_PX: f64 = 0.3;

/// A single mark that is further off than this is told as a flag, px: that is no scatter.
pub const MARK_LIMIT_PX: f64 = 1.5;

impl<T> Conversion<T> {
    /// A conversion of cameras that were not fitted to marks.
    fn of(result: T, losses: Vec<Loss>, notes: Vec<String>) -> Self {
        Self { result, losses, marks: Vec::new(), notes }
    }

    /// What the user must know before using the result: losses above [`LOSS_LIMIT_PX`], marks beyond [`MARKS_LIMIT_PX`] and [`MARK_LIMIT_PX`].
    pub fn flags(&self) -> Vec<String> {
        let large = self.losses.iter().enumerate().filter(|(_, l)| !(l.max_px <= LOSS_LIMIT_PX));
        let losses = large.map(|(i, l)| {
            format!(
                "camera {}: it cannot be carried over exactly; the nearest camera of the other kind differs by {:.3} px rms, {:.3} px at most; \
                 where that is too much, calibrate with a model that both packages have",
                i + 1,
                l.rms_px,
                l.max_px
            )
        });
        let off = |l: &Loss| !(l.rms_px <= MARKS_LIMIT_PX && l.max_px <= MARK_LIMIT_PX);
        let marks = self.marks.iter().enumerate().filter(|(_, l)| off(l)).map(|(i, l)| {
            format!(
                "camera {}: its marks lie {:.3} px rms, {:.3} px at most, from where the camera fitted to them sees them, which is more than \
                 measured marks scatter; look for marks of a wrong place or label, a view of another plate position, and a wrong image size",
                i + 1,
                l.rms_px,
                l.max_px
            )
        });
        losses.chain(marks).collect()
    }
}

/// Writes a calibration in another package's format: names and bytes of the files.
///
/// # Errors
/// [`Invalid::Contradiction`] where the format needs what the record does not have, or cannot hold the cameras at all.
pub fn export(record: &Record, format: ExportFormat) -> Result<Conversion<Vec<(String, Vec<u8>)>>> {
    let without_windows = || -> Result<Cameras> {
        let mut rig = Cameras::of(record)?;
        rig.lose_windows()?;
        Ok(rig)
    };
    match format {
        ExportFormat::OpenCv => opencv::export(&without_windows()?, storage::Syntax::Yaml),
        ExportFormat::OpenCvXml => opencv::export(&without_windows()?, storage::Syntax::Xml),
        ExportFormat::OpenPtv => openptv::export(&without_windows()?),
        ExportFormat::Matlab => matlab::export(&without_windows()?),
        ExportFormat::Soloff => soloff::export(&Cameras::of(record)?, SoloffDegrees::default()),
        ExportFormat::Csv => Ok(csv::export(record)),
    }
}

/// As [`export`] to [`ExportFormat::Soloff`], with polynomials of these degrees.
///
/// # Errors
/// As [`export`]; [`Invalid::Value`] for degrees other than 2 or 3 in x and y, 1 or 2 in z.
pub fn export_soloff(record: &Record, degrees: SoloffDegrees) -> Result<Conversion<Vec<(String, Vec<u8>)>>> {
    soloff::export(&Cameras::of(record)?, degrees)
}

/// Reads a calibration of another package.
///
/// The record has cameras and the sheet (the slice of UVMAT, else the plane z = 0 of the format's world; none where a format holds none), but
/// no views and no standard deviations.
///
/// # Errors
/// [`Invalid::Syntax`] or [`Invalid::File`] where the text is not of the format, or what it says cannot be a calibration;
/// [`Invalid::Contradiction`] where an option is missing or says other than the file, or the content has no meaning here.
pub fn import(files: &[NamedText], format: ImportFormat, options: &ImportOptions) -> Result<Conversion<Record>> {
    if files.is_empty() {
        return Err(Invalid::Contradiction("no file to read".into()).into());
    }
    let found = match format {
        ImportFormat::OpenCv => opencv::import(files, options)?,
        ImportFormat::OpenPtv => openptv::import(files, options)?,
        ImportFormat::DaVis => davis::import(files, options)?,
        ImportFormat::Uvmat => uvmat::import(files, options)?,
    };
    imported::refuse_contradictions(&found, options)?;
    imported::record(found, files)
}

/// One camera in a world whose plane z = 0 is the sheet.
#[derive(Debug, Clone)]
struct WorldCamera {
    name: String,
    image_size_px: [usize; 2],
    pixel_pitch_mm: Option<f64>,
    camera: Camera,
    cam_from_world: Motion<Cam, Sheet>,
    loss: Loss,
    /// The measured volume as it is seen through a window that the camera here stands for; none without one.
    points: Option<Vec<refit::Seen>>,
}

/// Cameras read from a file, and what was assumed.
struct Found {
    cameras: Vec<WorldCamera>,
    /// Whether the plane z = 0 of the world is the laser sheet; else it was only fitted about.
    has_sheet: bool,
    /// Whether the cameras were fitted to measured marks: their loss is then what these leave.
    of_marks: bool,
    notes: Vec<String>,
    program: &'static str,
}

/// The cameras of a record in the sheet's frame.
struct Cameras {
    cameras: Vec<WorldCamera>,
    notes: Vec<String>,
}

impl Cameras {
    /// A name for the files of each camera: letters and digits, and no two alike on any file system.
    fn file_names(&self) -> Vec<String> {
        let mut out: Vec<String> = Vec::new();
        for c in &self.cameras {
            let plain: String = c.name.chars().map(|x| if x.is_alphanumeric() { x } else { '_' }).collect();
            let taken = |name: &String| out.iter().any(|other| other.to_lowercase() == name.to_lowercase());
            let numbered = (2..).map(|n| format!("{plain}_{n}"));
            let free = std::iter::once(plain.clone()).chain(numbered).find(|name| !taken(name));
            out.extend(free);
        }
        out
    }
    fn of(record: &Record) -> Result<Self> {
        let sheet = record.sheet.as_ref().ok_or_else(|| {
            Invalid::Contradiction(
                "this calibration has no laser sheet, so there is no plane z = 0 to write; record a view in the sheet \
                 (sheet = true) or run `spivcal sheet` first"
                    .into(),
            )
        })?;
        let rig_from_sheet: Motion<Rig, Sheet> = sheet.rig_from_sheet.motion();
        let cameras = record.cameras.iter().map(|c| {
            let cam_from_rig: Motion<Cam, Rig> = c.cam_from_rig.motion();
            Ok(WorldCamera {
                name: c.name.clone(),
                image_size_px: c.image_size_px,
                pixel_pitch_mm: c.pixel_pitch_mm,
                camera: c.model()?,
                cam_from_world: cam_from_rig * rig_from_sheet,
                loss: Loss::NONE,
                points: None,
            })
        });
        Ok(Self { cameras: cameras.collect::<Result<_>>()?, notes: Vec::new() })
    }

    /// Cameras without windows in the place of those behind one.
    fn lose_windows(&mut self) -> Result<()> {
        let behind: Vec<WorldCamera> = std::mem::take(&mut self.cameras);
        for c in behind {
            let Some(window) = c.camera.window().copied() else {
                self.cameras.push(c);
                continue;
            };
            let near = behind::without_window(c, &window)?;
            self.notes.push(format!(
                "{}: looks through a flat window, which this format cannot hold; the nearest camera without one is written, fitted over \
                 the whole image within {:.1} mm of the sheet, and worse beyond; to keep the window, work with calibration.json, or write --to soloff",
                near.name,
                near.depth_mm()
            ));
            if near.pixels_seen() < PIXELS {
                self.notes.push(format!(
                    "{}: {} of {PIXELS} pixels over its image see that volume through the window; the loss is that of these",
                    near.name,
                    near.pixels_seen()
                ));
            }
            self.cameras.push(near);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
