//! The structs of `calibration.json`, in the order of its keys.

use super::diagnosis::{Diagnosis, MappingUncertainty};
use super::number::{maybe, maybe_map, maybe_rows};
use super::provenance::Provenance;
use super::sigma::{CameraSigma, PoseSigma, RigSigma, SheetSigma, WindowSigma};
use super::target::{Target, ViewTarget};
use crate::bundle::view_of_direction;
use crate::camera::{self, Intrinsics};
use crate::rigid::Motion;
use nalgebra::{DMatrix, Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Value of the key `format`.
pub const FORMAT: &str = "spivcal-calibration";
/// Value of the key `version`.
pub const VERSION: u32 = 1;

/// Why a view that served the sheet alone is not used.
pub const SHEET_ALONE: &str = "it served the sheet alone, with the cameras held";

/// What [`Sheet::angles_deg`] means; written beside the numbers.
pub const ANGLES_CONVENTION: &str = "rig_from_sheet = Rx(angle 1) Ry(angle 2) Rz(angle 3), rotations about the rig's \
                                     x, y, z axes, up to the half turn about x that makes the sheet's z axis face \
                                     the first camera";

fn angles_convention() -> String {
    ANGLES_CONVENTION.into()
}

/// A whole calibration: the content of `calibration.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Always [`FORMAT`].
    pub format: String,
    /// Always [`VERSION`].
    pub version: u32,
    /// The cameras; the first is the rig frame.
    pub cameras: Vec<Camera>,
    /// Baseline and angle between the lens axes; none with a single camera.
    #[serde(default)]
    pub rig: Option<Rig>,
    /// The laser sheet; `null` where no view was recorded in it.
    #[serde(deserialize_with = "required_option")]
    pub sheet: Option<Sheet>,
    /// The target as it was adjusted.
    pub target: Target,
    /// The one metric fact that sets the scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<Scale>,
    /// Every view of the rig file, also the unused ones.
    pub views: Vec<View>,
    /// How well it fits and what is not determined.
    pub fit: Fit,
    /// What the uncertainty of the calibration does to measurements in the sheet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mapping_uncertainty: Option<MappingUncertainty>,
    /// Where it comes from.
    #[serde(default)]
    pub provenance: Provenance,
    /// Covariance of all estimated numbers, by name.
    pub covariance: Covariance,
}

/// `null` is an answer, a missing key is not.
fn required_option<'de, D, T>(d: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    Option::<T>::deserialize(d)
}

/// Direction of the radial polynomial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Radial {
    /// Brown: from the ideal to the distorted point, on the untilted plane.
    #[default]
    IdealToDistorted,
    /// Photogrammetric: from the distorted to the ideal point.
    DistortedToIdeal,
}

impl From<Radial> for camera::Radial {
    fn from(radial: Radial) -> Self {
        match radial {
            Radial::IdealToDistorted => camera::Radial::IdealToDistorted,
            Radial::DistortedToIdeal => camera::Radial::DistortedToIdeal,
        }
    }
}

impl From<camera::Radial> for Radial {
    fn from(radial: camera::Radial) -> Self {
        match radial {
            camera::Radial::IdealToDistorted => Radial::IdealToDistorted,
            camera::Radial::DistortedToIdeal => Radial::DistortedToIdeal,
        }
    }
}

/// One Scheimpflug camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Name in the rig file.
    pub name: String,
    /// Width and height, px.
    pub image_size_px: [usize; 2],
    /// Image distance over pixel pitch, px.
    pub f_px: f64,
    /// Pixel pitch in u over pixel pitch in v: `v = cy + aspect f ty`.
    pub aspect: f64,
    /// Where the lens axis meets the sensor, px.
    pub cx_px: f64,
    /// Where the lens axis meets the sensor, px.
    pub cy_px: f64,
    /// Tilt of the sensor about its u axis, rad (see [`crate::camera`]).
    pub alpha_rad: f64,
    /// Tilt of the sensor about its v axis, rad (see [`crate::camera`]).
    pub beta_rad: f64,
    /// Radial distortion, r^2 term.
    pub k1: f64,
    /// Radial distortion, r^4 term.
    pub k2: f64,
    /// Radial distortion, r^6 term.
    pub k3: f64,
    /// Direction of the radial polynomial.
    #[serde(default)]
    pub radial: Radial,
    /// Pupil ratio of the lens, 1 where it is not modelled.
    #[serde(default = "one")]
    pub pupil_ratio: f64,
    /// Size of a pixel, mm, where the rig file gives it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_pitch_mm: Option<f64>,
    /// The untilted pinhole that gives the same image without distortion.
    pub effective: Effective,
    /// Standard deviations.
    pub sigma: CameraSigma,
    /// Pose: camera coordinates from rig coordinates.
    pub cam_from_rig: Pose,
    /// The flat window before it, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<Window>,
    /// Root mean square residual of this camera, px: length of the departure of a disc's place or of a point, both
    /// coordinates together.
    pub rms_px: f64,
    /// Root mean square distance of edge points from the projected contour, px, where contours were used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edge_rms_px: Option<f64>,
    /// Edge points of this camera's discs that were used: a number each.
    #[serde(default)]
    pub observations: usize,
}

impl Camera {
    /// The parameters of the camera model.
    pub fn intrinsics(&self) -> Intrinsics {
        Intrinsics {
            f_px: self.f_px,
            aspect: self.aspect,
            cx_px: self.cx_px,
            cy_px: self.cy_px,
            alpha_rad: self.alpha_rad,
            beta_rad: self.beta_rad,
            k: [self.k1, self.k2, self.k3],
            pupil_ratio: self.pupil_ratio,
            radial: self.radial.into(),
        }
    }
}

impl Camera {
    /// The camera as a model, behind its window where it has one.
    ///
    /// # Errors
    /// [`crate::error::Invalid::Value`] where a number is none of a camera or window.
    pub fn model(&self) -> crate::error::Result<camera::Camera> {
        let window = self.window.as_ref().map(Window::model).transpose()?;
        Ok(camera::Camera::new(self.intrinsics())?.with_window(window))
    }
}

/// A flat window between air and water before a camera, see [`crate::camera::Window`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Window {
    /// Unit normal in the camera frame, away from the camera.
    pub normal_in_cam: [f64; 3],
    /// From the projection centre to the glass along the normal, mm.
    pub distance_mm: f64,
    /// Thickness of the glass, mm.
    pub thickness_mm: f64,
    /// Refractive index before the glass.
    pub n_air: f64,
    /// Refractive index of the glass.
    pub n_glass: f64,
    /// Refractive index behind the glass.
    pub n_water: f64,
    /// Standard deviations.
    pub sigma: WindowSigma,
}

impl Window {
    /// The window as a model.
    ///
    /// # Errors
    /// As [`camera::Window::new`].
    pub fn model(&self) -> crate::error::Result<camera::Window> {
        let indices = [self.n_air, self.n_glass, self.n_water];
        camera::Window::new(self.normal_in_cam.into(), self.distance_mm, self.thickness_mm, indices)
    }
}

fn one() -> f64 {
    1.0
}

/// The untilted pinhole along the sensor normal, px.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Effective {
    /// Distance of the projection centre from the sensor plane, px.
    #[serde(with = "maybe")]
    pub f_px: f64,
    /// Foot of the perpendicular from the projection centre, px.
    #[serde(with = "maybe")]
    pub cx_px: f64,
    /// Foot of the perpendicular from the projection centre, px.
    #[serde(with = "maybe")]
    pub cy_px: f64,
}

impl Default for Effective {
    /// Everything unknown.
    fn default() -> Self {
        Self { f_px: f64::NAN, cx_px: f64::NAN, cy_px: f64::NAN }
    }
}

/// A rigid motion as the file holds it; `p_to = rotation p_from + translation_mm`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rows of the rotation matrix.
    pub rotation: [[f64; 3]; 3],
    /// Origin of the source frame in the goal frame, mm.
    pub translation_mm: [f64; 3],
}

impl<To, From> std::convert::From<&Motion<To, From>> for Pose {
    fn from(m: &Motion<To, From>) -> Self {
        let r = &m.rotation;
        Pose {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)])),
            translation_mm: [m.translation_mm.x, m.translation_mm.y, m.translation_mm.z],
        }
    }
}

impl Pose {
    /// The motion; the caller names the frames, the bits are those of the file.
    pub fn motion<To, From>(&self) -> Motion<To, From> {
        let r = &self.rotation;
        Motion::new(Matrix3::from_fn(|i, j| r[i][j]), Vector3::from(self.translation_mm))
    }
}

/// What two cameras make together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rig {
    /// Distance of the projection centres, mm.
    pub baseline_mm: f64,
    /// Angle between the lens axes, degrees.
    pub axes_angle_deg: f64,
    /// Standard deviations.
    pub sigma: RigSigma,
}

/// The laser sheet: the plane `normal . p = distance` in the rig frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sheet {
    /// Unit normal, away from the first camera.
    pub normal_in_rig: [f64; 3],
    /// Distance from the first projection centre along the normal, mm.
    pub distance_mm: f64,
    /// `normal / distance`, per mm.
    pub abc_per_mm: [f64; 3],
    /// The paper's theta 1 to 3, degrees; see `angles_convention`.
    pub angles_deg: [f64; 3],
    /// What `angles_deg` means, in words.
    #[serde(default = "angles_convention")]
    pub angles_convention: String,
    /// Angle between the sheet and the line from the first projection centre to the second, degrees: 0 where the line runs along the
    /// sheet, positive where it runs towards it.
    #[serde(with = "maybe")]
    pub angle_to_baseline_deg: f64,
    /// Standard deviations.
    pub sigma: SheetSigma,
    /// Pose of the sheet frame: rig coordinates from sheet coordinates.
    pub rig_from_sheet: Pose,
    /// How it was found: `joint`, `homography`, `self-calibration`, `target plane`, or the package whose calibration gave it.
    #[serde(default)]
    pub method: String,
    /// Views recorded in the sheet that were used.
    #[serde(default)]
    pub views: Vec<usize>,
    /// Root mean square disparity of the sheet's views dewarped through both cameras, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub disparity_rms_px: Option<f64>,
    /// The paper's method beside it, where `method` is `joint`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub homography: Option<Homography>,
}

/// The sheet by the paper's homography, cameras held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Homography {
    /// `normal / distance`, per mm.
    pub abc_per_mm: [f64; 3],
    /// Distance from the first projection centre, mm.
    pub distance_mm: f64,
    /// As [`Sheet::angles_deg`], degrees.
    pub angles_deg: [f64; 3],
    /// Angle between the sheet and the baseline, degrees.
    #[serde(with = "maybe")]
    pub angle_to_baseline_deg: f64,
    /// Standard deviations, the cameras' covariance included.
    pub sigma: SheetSigma,
    /// Root mean square transfer error from one camera to the other, px.
    #[serde(with = "maybe")]
    pub transfer_rms_px: f64,
}

/// The metric fact that sets the scale.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    /// `spacing`, `radius`, `baseline` or `traverse`.
    pub fact: String,
    /// Its value, mm.
    pub value_mm: f64,
    /// Its standard deviation, mm; 0 where the rig file gives none.
    #[serde(with = "maybe")]
    pub sigma_mm: f64,
}

/// One view of the target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Position in the rig file, from 0.
    pub index: usize,
    /// Whether it was recorded in the laser sheet.
    pub in_sheet: bool,
    /// Pose: rig coordinates from target coordinates; `null` where the view was not used.
    #[serde(deserialize_with = "required_option")]
    pub rig_from_target: Option<Pose>,
    /// Root mean square residual per camera, px; cameras that do not see it are absent.
    #[serde(with = "maybe_map")]
    pub rms_px: BTreeMap<String, f64>,
    /// Whether it took part in the adjustment.
    #[serde(default = "yes")]
    pub used: bool,
    /// Why it did not.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub why_unused: String,
    /// Edge points used, per camera.
    #[serde(default)]
    pub observations: BTreeMap<String, usize>,
    /// Outliers left out, per camera.
    #[serde(default)]
    pub outliers: BTreeMap<String, usize>,
    /// Image file per camera, as the rig file names it.
    #[serde(default)]
    pub images: BTreeMap<String, String>,
    /// Standard deviations of the pose.
    #[serde(default)]
    pub sigma: PoseSigma,
    /// Root mean square distance of the view's own points from one plane, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub planarity_mm: Option<f64>,
    /// Position along the normal of the common plane, where the rig file left it to be estimated, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane_z_mm: Option<f64>,
    /// Its standard deviation, mm; absent where nothing determines it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane_z_sigma_mm: Option<f64>,
    /// Shape of this view's own target (bubbles).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<ViewTarget>,
}

fn yes() -> bool {
    true
}

/// How a parameter is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Known {
    /// Estimated from the images alone.
    Free,
    /// Held at a given value.
    Fixed,
    /// Estimated with a prior.
    Prior,
}

/// How one parameter is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name as in [`Covariance::names`].
    pub name: String,
    /// Free, fixed, or held by a prior.
    pub known: Known,
    /// Part of the information that comes from the prior, 0 to 1.
    #[serde(with = "maybe", default)]
    pub prior_share: f64,
}

/// A direction in the space of parameters that the data hardly determine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NearNull {
    /// What it is, in words.
    pub words: String,
    /// Names of the parameters with the largest parts, as in [`Covariance::names`].
    #[serde(default)]
    pub names: Vec<String>,
    /// Their parts, each in units of the parameter's typical size.
    #[serde(default)]
    pub components: Vec<f64>,
    /// How far the direction may move, in the same units; unknown where nothing holds it.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub sigma: f64,
}

/// How well the adjustment fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Root mean square residual over all cameras, px: as [`Camera::rms_px`] of the places of discs, not of edge points.
    pub rms_px: f64,
    /// Weighted sum of squares.
    pub chi2: f64,
    /// Observations and priors less unknowns.
    pub degrees_of_freedom: usize,
    /// Mean redundancy: degrees of freedom per observation.
    #[serde(with = "maybe")]
    pub redundancy: f64,
    /// Scalar observations used: edge points less what the light takes that is followed along contours, or numbers of common tangents.
    pub observations: usize,
    /// Iterations of the adjustment.
    pub iterations: usize,
    /// Newton decrement where it stopped, in sigmas.
    #[serde(with = "maybe")]
    pub newton_decrement: f64,
    /// Why it stopped.
    pub termination: String,
    /// Directions that nothing determines.
    pub nullity: usize,
    /// The directions that the images do not determine, in words.
    pub undetermined: Vec<String>,
    /// Outliers left out.
    pub outliers: usize,
    /// Whether it reached its minimum.
    #[serde(default = "yes")]
    pub converged: bool,
    /// What the user must look at before using the result, in words; empty: nothing.
    #[serde(default)]
    pub flags: Vec<String>,
    /// `contour` or `bitangent`.
    #[serde(default)]
    pub observation_model: String,
    /// `none`, `huber` or `cauchy`.
    #[serde(default)]
    pub loss: String,
    /// Factor by which all sigmas were enlarged because the residuals are larger than the noise (1: none).
    #[serde(default = "one")]
    pub sigma_scale: f64,
    /// How each parameter is known, in the order of the adjustment.
    #[serde(default)]
    pub parameters: Vec<Parameter>,
    /// Directions that the images hardly determine.
    #[serde(default)]
    pub near_null: Vec<NearNull>,
    /// Priors, model, views and outliers tested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diagnosis: Option<Diagnosis>,
}

/// Covariance of every estimated number.
///
/// Rows of the sheet are left steps of its frame as it is placed. Names are `owner.quantity_unit`: `left.f_px`, `right.cam_from_rig.rx_rad`, `sheet.rig_from_sheet.rx_rad`,
/// `view0.rig_from_target.tx_mm`, `target.spacing_mm`. Pose steps are those of [`PoseSigma`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Covariance {
    /// Names of rows and columns.
    pub names: Vec<String>,
    /// Symmetric matrix, rows in the order of the names; unit: product of the two names' units.
    #[serde(with = "maybe_rows")]
    pub matrix: Vec<Vec<f64>>,
    /// Names of numbers that nothing determines, where there are any: the matrix holds the determined directions alone, and these have no standard
    /// deviation.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undetermined: Vec<String>,
    /// The directions that nothing determines, over all names: a function of several numbers is known where it stands still along all of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub null_directions: Vec<Vec<f64>>,
}

impl Covariance {
    /// Whether something determines the number of row `i`.
    pub fn determines(&self, i: usize) -> bool {
        !self.undetermined.contains(&self.names[i])
    }
    /// The entry of two rows; `NaN` where one of them is not determined.
    pub fn known(&self, i: usize, j: usize) -> f64 {
        if self.determines(i) && self.determines(j) { self.matrix[i][j] } else { f64::NAN }
    }
    /// That of some of the rows, in their order.
    pub(crate) fn only(&self, rows: &[usize]) -> Self {
        let pick = |row: &Vec<f64>| -> Vec<f64> { rows.iter().map(|j| row[*j]).collect() };
        let lost = rows.iter().filter(|i| !self.determines(**i)).map(|i| self.names[*i].clone()).collect::<Vec<_>>();
        Self {
            names: rows.iter().map(|i| self.names[*i].clone()).collect(),
            matrix: rows.iter().map(|i| pick(&self.matrix[*i])).collect(),
            null_directions: if lost.is_empty() { vec![] } else { self.null_directions.iter().map(pick).collect() },
            undetermined: lost,
        }
    }
    /// That of other numbers in the place of some rows: linear in rows that are all determined, `by` of shape (rows, from).
    pub(crate) fn with_rows(&self, rows: &[usize], from: &[usize], by: &DMatrix<f64>) -> Self {
        let sum = |k: usize, of: &dyn Fn(usize) -> f64| {
            from.iter().enumerate().map(|(n, i)| by[(k, n)] * of(*i)).sum::<f64>()
        };
        let half: Vec<Vec<f64>> = (0..self.names.len())
            .map(|i| match rows.iter().position(|r| *r == i) {
                Some(k) => (0..self.names.len()).map(|j| sum(k, &|n| self.matrix[n][j])).collect(),
                None => self.matrix[i].clone(),
            })
            .collect();
        let entry = |i: usize, j: usize| match rows.iter().position(|r| *r == j) {
            Some(k) => sum(k, &|n| half[i][n]),
            None => half[i][j],
        };
        let n = self.names.len();
        let mut matrix: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect();
        // Sums in two orders differ by rounding.
        for (i, j) in (0..n).flat_map(|i| (0..i).map(move |j| (i, j))) {
            matrix[j][i] = matrix[i][j];
        }
        let direction = |d: &Vec<f64>| {
            let mut out = d.clone();
            rows.iter().enumerate().for_each(|(k, i)| out[*i] = sum(k, &|n| d[n]));
            out
        };
        Self { matrix, null_directions: self.null_directions.iter().map(direction).collect(), ..self.clone() }
    }
    /// The views that keep an undetermined direction to themselves, by their index in the names; no other number moves along it.
    pub fn loose_views(&self) -> Vec<usize> {
        let mut views: Vec<_> = self.null_directions.iter().filter_map(|d| view_of_direction(&self.names, d)).collect();
        views.sort_unstable();
        views.dedup();
        views
    }
    /// Number of undetermined directions that move what views share: cameras, motion, sheet, target.
    pub fn shared_nullity(&self) -> usize {
        self.null_directions.iter().filter(|d| view_of_direction(&self.names, *d).is_none()).count()
    }
    /// Index of a name.
    pub fn index(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|n| n == name)
    }
    /// Standard deviation of a name; `None` where the name is unknown or the number does not exist.
    pub fn sigma(&self, name: &str) -> Option<f64> {
        let i = self.index(name).filter(|i| self.determines(*i))?;
        let s = self.matrix.get(i)?.get(i)?.sqrt();
        s.is_finite().then_some(s)
    }
}

/// Sigmas enlarged more often than this, with residuals beyond those of the second line, are no printer's error.
const SCATTERED: f64 = 30.0;
const SCATTERED_PX: f64 = 0.05;
/// How the flag of such a calibration begins, where nothing else tells why.
pub const WHOLE_DISCS: &str = "whole discs lie";

impl Fit {
    /// Whether discs lie where neither noise nor a common printer's error explains them, though sigmas allow for it.
    pub fn scattered(&self) -> bool {
        self.sigma_scale > SCATTERED && self.rms_px > SCATTERED_PX
    }
}
