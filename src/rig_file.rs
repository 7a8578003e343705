//! The rig file: a TOML text becomes a description of the job that has been checked for sense.
//!
//! The text says which cameras there are, what target they saw, what sets the scale and which images belong to
//! which view. Reading it opens no file: [`RigDescription::parse`] takes the text, [`image_path`] says where an
//! image is. Whatever has no meaning is refused with file, line and what was expected: unknown keys, wrong types,
//! numbers that are not finite or outside their meaning, and statements that exclude each other.
//!
//! # Keys and defaults
//!
//! | key | unit | default | meaning |
//! |---|---|---|---|
//! | `[[camera]]` `name` | | required | letters, digits, `-`, `_`; the first camera is the rig frame; one or two cameras |
//! | `pixel_pitch_mm` | mm | unknown | distance of neighbouring pixels |
//! | `focal_length_mm` | mm | unknown | nominal focal length of the lens |
//! | `radial` | | `"ideal-to-distorted"` | direction of the distortion polynomial: Brown's, or `"distorted-to-ideal"` (photogrammetry) |
//! | `[camera.window]` | | none | a plane window between air and water; keys in `docs/window.md` |
//! | `[camera.known]` | | nothing | per parameter `{ value, sigma }` (a prior) or `{ fixed }`; see [`Parameter`] |
//! | `[target]` `kind` | | required | `two-discs`, `bubbles`, `dot-grid`, `two-level-plate` |
//! | `polarity` | | `"auto"` | `bright`, `dark`, `auto` |
//! | `spacing_mm` | mm | unknown | two discs: distance of the centres; grid: pitch; plate: pitch on one level (required) |
//! | `radii_mm` | mm | unknown | two discs: both radii; grid and plate: a list with the one radius |
//! | `adjust` | | `"shape"` | `none`, `shape` (radii, spacing ratio, step), `points` (every dot; grids and plates) |
//! | `point_sigma_mm` | mm | a hundredth of the pitch | with `adjust = "points"`: how far a dot may be from its nominal place, and its radius from the common one; what that leaves open is in their sigmas |
//! | `columns`, `rows` | | not counted | grid only: size of the full grid |
//! | `step_mm` | mm | required | plate only: depth of the back level below the front level |
//! | `marks` | | none | grid, plate: `[{ kind, column, row, level }]`, kind `ring`, `large`, `square`, `triangle`; `level` (plate) 0 |
//! | `[scale]` | | none | exactly one of the keys below, only where `[target]` gives no length |
//! | `baseline_mm` | mm | | distance of the cameras: a number or `{ value, sigma }` |
//! | `spacing_mm` | mm | | `{ view, value, sigma }`: distance of the centres in one view |
//! | `radius_mm` | mm | | `{ view, disc, value, sigma }`: radius of one disc in one view |
//! | `plane_z_mm` | mm | `true` | `true` or `{ sigma }` (of each position that has no sigma of its own): the steps between the views' `plane_z_mm`; may be left out where nothing else sets the scale |
//! | `[focus]` `tilt_sigma_deg` | deg | 0.5 | tolerance of the sheet's tilt against the plane of focus |
//! | `distance_sigma` | | 0.005 | relative tolerance of its distance; used where every camera has `focal_length_mm` |
//! | `[sheet]` `origin` | | the first camera's axis | `{ view, column, row, level }` (a disc or mark in a view) or `{ point_mm }` (rig frame), dropped onto the sheet |
//! | `x_axis` | | the rig's x axis | `{ view }`: along the target's x axis in that view, laid into the sheet |
//! | `flip_x` | | `false` | x and y turned over; z (and so w) stays towards the first camera |
//! | `[camera.design]` `object_distance_mm` | mm | required there | from the lens to the sheet along the lens axis; with `focal_length_mm` and `pixel_pitch_mm` it gives f and tilts to start from |
//! | `viewing_angle_deg` | deg | required there | inclination of the sheet along image x; positive: what is right in the image is nearer |
//! | `viewing_angle_vertical_deg` | deg | 0 | the same along image y; positive: what is low in the image is nearer |
//! | `f_sigma` | | no prior | relative standard deviation with which the designed f is also a prior |
//! | `tilt_sigma_deg` | deg | no prior | standard deviation with which the designed tilts are also priors |
//! | `[solve]` `observations` | | `"contour"` | `contour` or `bitangent` |
//! | `loss` | | `"huber"` | `none`, `huber`, `cauchy` |
//! | `estimate` | | `["k1"]` | distortion terms that are free: `k1`, `k2`, `k3`; a parameter with a prior is free too |
//! | `[[view]]` (camera name) | | | image of that camera; a view may lack a camera |
//! | `sheet` | | `false` | recorded in the laser sheet that is to be measured (needs two cameras) |
//! | `plane_z_mm` | mm | any pose | position along a traverse, parallel to the sheet: a number, `{ value, sigma }`, or `"unknown"` |
//!
//! Angles are in degrees in the file and in radians in [`RigDescription`]. Views and discs are counted from 0.
//! A single camera can be calibrated alone; there is no sheet then.

mod camera;
mod reader;
mod scale;
mod sheet;
mod solve;
mod target;
mod view;
mod window;

#[cfg(test)]
mod tests;

use crate::camera::Radial;
use crate::error::Result;
use crate::target::{DotId, Polarity, Target};
use reader::{Section, Source};
use std::path::{Path, PathBuf};
use toml::de::DeTable;

pub(crate) use camera::name_fault as camera_name_fault;
pub(crate) use target::MARKS;

/// Everything a rig file says, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct RigDescription {
    /// Name of the file as the user gave it, for messages.
    pub file: String,
    /// The text itself, so that a result can keep what it was made from.
    pub text: String,
    /// One or two cameras; the first is the rig frame.
    pub cameras: Vec<CameraDescription>,
    /// What was recorded.
    pub target: TargetDescription,
    /// The one fact that makes lengths metric.
    pub scale: Scale,
    /// Prior from the cameras being focused on the sheet.
    pub focus: Option<Focus>,
    /// Where the sheet frame stands.
    pub sheet: SheetFrame,
    /// How the adjustment is done.
    pub solve: Solve,
    /// The views in the order of the file.
    pub views: Vec<ViewDescription>,
}

/// One camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraDescription {
    /// Name, unique in the file.
    pub name: String,
    /// Distance of neighbouring pixels, mm.
    pub pixel_pitch_mm: Option<f64>,
    /// Nominal focal length of the lens, mm.
    pub focal_length_mm: Option<f64>,
    /// `radial`: direction of the radial polynomial.
    pub radial: Radial,
    /// What is known beforehand, at most once per parameter.
    pub known: Vec<(Parameter, Knowledge)>,
    /// Focal length and tilts by the drawing of the rig.
    pub design: Option<Design>,
    /// `[camera.window]`: a flat window between air and water before the camera.
    pub window: Option<WindowDescription>,
}

/// A flat window before a camera, see [`crate::camera::Window`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowDescription {
    /// Distance, thickness and indices in the order of [`crate::camera::LAYER_NAMES`], each with a standard deviation where it
    /// is estimated.
    pub layers: [(f64, Option<f64>); crate::camera::LAYERS],
    /// Standard deviation of the angle between window and sheet, rad.
    pub tilt_sigma_rad: f64,
}

/// Focal length and tilts that follow from the drawing of the rig, see [`crate::camera::Drawing`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Design {
    /// Image distance over pixel pitch, px.
    pub f_px: f64,
    /// Tilt about the u axis, rad.
    pub alpha_rad: f64,
    /// Tilt about the v axis, rad.
    pub beta_rad: f64,
    /// Standard deviation of `f_px` as a prior, px; none: a start only.
    pub f_sigma_px: Option<f64>,
    /// Standard deviation of both tilts as a prior, rad; none: a start only.
    pub tilt_sigma_rad: Option<f64>,
}

impl CameraDescription {
    /// What is known of a parameter beforehand.
    pub fn knowledge(&self, parameter: Parameter) -> Option<Knowledge> {
        self.known.iter().find(|(p, _)| *p == parameter).map(|(_, k)| *k)
    }
}

/// A parameter of a camera that can be known beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Parameter {
    /// `f_px`: image distance over pixel pitch, px.
    F,
    /// `aspect`: height over width of a pixel in the model.
    Aspect,
    /// `cx_px`: where the lens axis meets the sensor, px.
    Cx,
    /// `cy_px`: where the lens axis meets the sensor, px.
    Cy,
    /// `alpha_deg` in the file; here rad.
    Alpha,
    /// `beta_deg` in the file; here rad.
    Beta,
    /// `k1`: radial distortion.
    K1,
    /// `k2`: radial distortion.
    K2,
    /// `k3`: radial distortion.
    K3,
    /// `pupil_ratio`: exit over entrance pupil.
    PupilRatio,
}

impl Parameter {
    /// All parameters in the order of the documentation.
    pub const ALL: [Parameter; 10] = [
        Parameter::F,
        Parameter::Aspect,
        Parameter::Cx,
        Parameter::Cy,
        Parameter::Alpha,
        Parameter::Beta,
        Parameter::K1,
        Parameter::K2,
        Parameter::K3,
        Parameter::PupilRatio,
    ];
    /// Key in the rig file.
    pub fn key(self) -> &'static str {
        match self {
            Parameter::F => "f_px",
            Parameter::Aspect => "aspect",
            Parameter::Cx => "cx_px",
            Parameter::Cy => "cy_px",
            Parameter::Alpha => "alpha_deg",
            Parameter::Beta => "beta_deg",
            Parameter::K1 => "k1",
            Parameter::K2 => "k2",
            Parameter::K3 => "k3",
            Parameter::PupilRatio => "pupil_ratio",
        }
    }
}

/// Knowledge of a parameter, in the unit of [`Parameter`] (angles in rad).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Knowledge {
    /// Known with a Gaussian standard deviation; the parameter is estimated.
    Prior {
        /// Expected value.
        value: f64,
        /// Standard deviation.
        sigma: f64,
    },
    /// Exact; the parameter is not estimated.
    Fixed {
        /// The value.
        value: f64,
    },
}

/// The target and how freely it is adjusted.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetDescription {
    /// Nominal target.
    pub target: Target,
    /// Brighter or darker than its surroundings.
    pub polarity: Polarity,
    /// What of it is estimated.
    pub adjust: Adjust,
    /// Prior of each dot about its nominal place with [`Adjust::Points`], mm; none: the dots are free.
    pub point_sigma_mm: Option<f64>,
}

/// What of the target is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Adjust {
    /// Nothing: the target is exactly as described.
    None,
    /// Radii, ratio of spacing, step of a plate; one length stays as the scale.
    #[default]
    Shape,
    /// Every dot, besides the shape.
    Points,
}

/// A length that sets the scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// Value, mm.
    pub value_mm: f64,
    /// Standard deviation, mm; none: exact.
    pub sigma_mm: Option<f64>,
}

/// The one fact that makes lengths metric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// Spacing of the target (distance of two discs, pitch of a grid or plate).
    TargetSpacing(Length),
    /// Radius of a disc of the target, which has no known spacing.
    TargetRadius {
        /// Disc, counted from 0; 0 for a grid, whose dots are equal.
        disc: usize,
        /// Its radius.
        radius: Length,
    },
    /// Distance of the two projection centres.
    Baseline(Length),
    /// Distance of the two bubbles in one view.
    ViewSpacing {
        /// View, counted from 0.
        view: usize,
        /// Distance of the centres.
        spacing: Length,
    },
    /// Radius of one bubble in one view.
    ViewRadius {
        /// View, counted from 0.
        view: usize,
        /// Disc, 0 or 1.
        disc: usize,
        /// Its radius.
        radius: Length,
    },
    /// Steps between the views' [`ViewDescription::plane_z_mm`].
    Traverse {
        /// Standard deviation of each position, mm; none: exact.
        sigma_mm: Option<f64>,
    },
}

/// Prior from the cameras being focused on the sheet; `pupil_ratio` of a camera takes part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Focus {
    /// Tolerance of the sheet's tilt against the plane of focus, rad.
    pub tilt_sigma_rad: f64,
    /// Relative tolerance of its distance; none where a camera has no `focal_length_mm`.
    pub distance_sigma: Option<f64>,
}

impl Focus {
    /// `tilt_sigma_deg` where the file does not say it, deg.
    pub const DEFAULT_TILT_SIGMA_DEG: f64 = 0.5;
    /// `distance_sigma` where the file does not say it.
    pub const DEFAULT_DISTANCE_SIGMA: f64 = 0.005;
}

/// Where the frame of the laser sheet stands: z is always its normal towards the first camera.
///
/// A velocity component w along z is positive towards the first camera; `flip_x` changes the signs of x and y (and of u and v),
/// never that of w.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SheetFrame {
    /// Its origin.
    pub origin: SheetOrigin,
    /// View whose target's x axis it follows; none: the rig's x axis laid into the sheet.
    pub x_axis_view: Option<usize>,
    /// x and y turned over (half a turn about z).
    pub flip_x: bool,
}

impl SheetFrame {
    /// The placement in words, for reports.
    pub fn words(&self) -> String {
        let origin = match self.origin {
            SheetOrigin::FirstAxis => "where the first camera's axis meets the sheet".to_string(),
            SheetOrigin::Disc { view, id } => {
                format!("at column {}, row {}, level {} of the target in view {view}", id.column, id.row, id.level)
            }
            SheetOrigin::Point([x, y, z]) => format!("at the foot of ({x}, {y}, {z}) mm of the rig frame"),
        };
        let axis = self
            .x_axis_view
            .map_or_else(|| "the rig's x axis".to_string(), |v| format!("the target's x axis in view {v}"));
        let flip = if self.flip_x { ", x and y turned over" } else { "" };
        format!("origin {origin}; x along {axis}, laid into the sheet{flip}")
    }
}

/// Origin of the sheet frame; what does not lie in the sheet is dropped onto it along the normal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum SheetOrigin {
    /// Where the first camera's axis meets the sheet.
    #[default]
    FirstAxis,
    /// A disc or mark of the target as it lay in a view.
    Disc {
        /// View, counted from 0.
        view: usize,
        /// Its label; of two discs column 0 or 1.
        id: DotId,
    },
    /// A point in the frame of the first camera, mm.
    Point([f64; 3]),
}

/// What is compared with the images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Observations {
    /// Every subpixel point of a contour.
    #[default]
    Contour,
    /// Tangency points and intersections of common tangents of a pair.
    Bitangent,
}

/// How much a large residual counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Loss {
    /// Squares, all alike.
    None,
    /// Linear beyond a threshold.
    #[default]
    Huber,
    /// Logarithmic beyond a threshold.
    Cauchy,
}

/// How the adjustment is done.
#[derive(Debug, Clone, PartialEq)]
pub struct Solve {
    /// What is compared with the images.
    pub observations: Observations,
    /// How much a large residual counts.
    pub loss: Loss,
    /// Distortion terms that are free (unless `known` fixes them in a camera), sorted, each once.
    pub estimate: Vec<Parameter>,
}

impl Default for Solve {
    fn default() -> Self {
        Self { observations: Observations::default(), loss: Loss::default(), estimate: vec![Parameter::K1] }
    }
}

/// One position of the target.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewDescription {
    /// Image of each camera as written in the file, in the order of [`RigDescription::cameras`].
    pub images: Vec<Option<String>>,
    /// Recorded in the laser sheet that is to be measured.
    pub sheet: bool,
    /// Position along a traverse.
    pub plane_z_mm: Option<PlaneZ>,
    /// Line of the file where it begins, for messages.
    pub line: usize,
}

impl ViewDescription {
    /// Its known position along the sheet's normal, mm: that of the sheet itself is 0.
    pub fn position_mm(&self) -> Option<f64> {
        if self.sheet { Some(0.0) } else { self.plane_z_mm?.value_mm() }
    }
}

/// Position of a view along a traverse: parallel to the sheet, counted towards the viewer of the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlaneZ {
    /// Known.
    Known {
        /// Position, mm.
        z_mm: f64,
        /// Standard deviation, mm; none: that of `[scale] plane_z_mm`, else exact.
        sigma_mm: Option<f64>,
    },
    /// Parallel to the sheet at a position that is to be estimated.
    Unknown,
}

impl PlaneZ {
    /// The known position, mm.
    pub fn value_mm(self) -> Option<f64> {
        match self {
            PlaneZ::Known { z_mm, .. } => Some(z_mm),
            PlaneZ::Unknown => None,
        }
    }
}

impl RigDescription {
    /// Reads the text of a rig file; `file` is its name for messages.
    ///
    /// ```
    /// let text = r#"
    /// [[camera]]
    /// name = "left"
    /// [[camera]]
    /// name = "right"
    /// [target]
    /// kind = "two-discs"
    /// spacing_mm = 26.0
    /// [[view]]
    /// left = "v1_left.png"
    /// right = "v1_right.png"
    /// "#;
    /// let job = spivcal::rig_file::RigDescription::parse(text, "rig.toml")?;
    /// assert_eq!(job.cameras[1].name, "right");
    /// assert_eq!(job.views[0].images[0].as_deref(), Some("v1_left.png"));
    ///
    /// let wrong = text.replace("spacing_mm", "spacing");
    /// let message = spivcal::rig_file::RigDescription::parse(&wrong, "rig.toml").unwrap_err().to_string();
    /// assert!(message.starts_with("rig.toml:8: [target]: unknown key \"spacing\"; did you mean \"spacing_mm\"?"));
    /// # Ok::<(), spivcal::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::error::Invalid::Syntax`] with the line and what was expected.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let source = Source { file, text };
        let document = DeTable::parse(text).map_err(|e| toml_error(source, &e))?;
        let root = Section::root(source, document.get_ref());
        root.only(&["camera", "target", "scale", "focus", "sheet", "solve", "view"], |key| {
            (key == "views" || key == "cameras")
                .then(|| format!("is written [[{}]], once for each", &key[..key.len() - 1]))
        })?;
        let cameras = camera::read_all(&root)?;
        let (target, length) = target::read(&root)?;
        let views = view::read_all(&root, &cameras)?;
        let scale = scale::read(&root, &target, length, &cameras, &views)?;
        let focus = solve::read_focus(&root, &cameras, &views)?;
        let sheet = sheet::read(&root, &target.target, &views)?;
        let solve = solve::read(&root, &target, &cameras)?;
        window::refuse_contradictions(&root, &cameras, &views, &solve)?;
        let mut job =
            Self { file: file.to_string(), text: text.to_string(), cameras, target, scale, focus, sheet, solve, views };
        job.remember_scale_in_target();
        Ok(job)
    }

    /// Index of a camera by its name.
    pub fn camera_index(&self, name: &str) -> Option<usize> {
        self.cameras.iter().position(|c| c.name == name)
    }

    /// Whether any view was recorded in the laser sheet.
    pub fn has_sheet(&self) -> bool {
        self.views.iter().any(|v| v.sheet)
    }

    /// A spacing that `[scale]` gives for two discs, the same in every view, is the target's spacing.
    fn remember_scale_in_target(&mut self) {
        if let (Target::TwoDiscs(pair), Scale::TargetSpacing(length)) = (&mut self.target.target, self.scale) {
            pair.spacing_mm = Some(length.value_mm);
        }
    }
}

/// Where an image of a rig file is: in `images_dir` where one is given, else beside the rig file; an absolute
/// path stays as it is.
///
/// ```
/// use spivcal::rig_file::image_path;
/// use std::path::Path;
/// let rig = Path::new("examples/dice/rig.toml");
/// assert_eq!(image_path(rig, None, "a.png"), Path::new("examples/dice/a.png"));
/// assert_eq!(image_path(rig, Some(Path::new("data")), "a.png"), Path::new("data/a.png"));
/// ```
pub fn image_path(rig_file: &Path, images_dir: Option<&Path>, image: &str) -> PathBuf {
    let base = images_dir.or(rig_file.parent()).unwrap_or(Path::new(""));
    base.join(image)
}

fn toml_error(source: Source<'_>, error: &toml::de::Error) -> crate::Error {
    let words = error.message().split('\n').filter(|l| !l.is_empty()).collect::<Vec<_>>().join("; ");
    let line = error.span().map_or(1, |s| source.line(s.start));
    source.refuse_line(line, format!("this is not valid TOML: {words}"))
}
