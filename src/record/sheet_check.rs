//! The check of the sheet on particle images as a record: what `check.json` holds.

use super::number::{maybe, maybe_array};
use super::schema::Fit;
use crate::stats::median;
use serde::{Deserialize, Serialize};

/// Disparities of the windows of a field, structure of arrays.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DisparityMap {
    /// Middle of the window in the sheet frame that it was seen in, mm.
    pub x_mm: Vec<f64>,
    /// Middle of the window, mm.
    pub y_mm: Vec<f64>,
    /// Disparity along x: second camera minus first, px of the dewarped image.
    pub dx_px: Vec<f64>,
    /// Disparity along y (up), px of the dewarped image.
    pub dy_px: Vec<f64>,
    /// Part across the direction in which depth shows: what no sheet explains, px.
    pub across_px: Vec<f64>,
    /// Depth of the light, mm.
    pub z_mm: Vec<f64>,
    /// Height of the correlation peak, 0 to 1.
    pub correlation: Vec<f64>,
    /// Height over that of the second peak.
    pub peak_ratio: Vec<f64>,
    /// Whether the window took part in the fit of the plane.
    pub used: Vec<bool>,
}

impl DisparityMap {
    /// Median length of the disparities of the windows that were used, px; `NaN` where there are none.
    pub fn median_px(&self) -> f64 {
        let lengths = (0..self.x_mm.len()).filter(|i| self.used[*i]).map(|i| self.dx_px[i].hypot(self.dy_px[i]));
        median(&mut lengths.collect::<Vec<_>>()).unwrap_or(f64::NAN)
    }
    /// Mean disparity (x, y) of the windows that were used, px.
    pub fn mean_px(&self) -> [f64; 2] {
        let used: Vec<usize> = (0..self.x_mm.len()).filter(|i| self.used[*i]).collect();
        let mean = |l: &[f64]| used.iter().map(|i| l[*i]).sum::<f64>() / used.len() as f64;
        [mean(&self.dx_px), mean(&self.dy_px)]
    }
}

/// What a disparity map says about the sheet and the cameras, apart from the scatter of its windows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Misalignment {
    /// Median with its sign, along x and along y, px.
    #[serde(with = "maybe_array")]
    pub median_px: [f64; 2],
    /// Standard deviation of these medians by the scatter of the windows, px.
    #[serde(with = "maybe_array")]
    pub median_sigma_px: [f64; 2],
    /// Root mean square of the smooth (quadratic) part of the map, what scatter puts into it taken off: along the direction of depth (the
    /// sheet), and across it (the cameras), px.
    #[serde(with = "maybe_array")]
    pub smooth_px: [f64; 2],
    /// What scatter alone would show there, px.
    #[serde(with = "maybe_array")]
    pub smooth_noise_px: [f64; 2],
    /// Scatter of single windows about the smooth part, along and across, px.
    #[serde(with = "maybe_array")]
    pub scatter_px: [f64; 2],
}

/// The light along the normal of the sheet that was found, as both cameras' images correlate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LightProfile {
    /// Along z of the sheet that was found, mm.
    pub z_mm: Vec<f64>,
    /// Correlation, its maximum 1: the light's profile squared, broadened by the images of particles.
    pub light: Vec<f64>,
    /// Where it is brightest, mm.
    pub top_mm: f64,
    /// Centre of gravity, mm; apart from the top where the profile is skewed.
    pub middle_mm: f64,
}

/// One round of the refinement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckRound {
    /// Side of a window, px.
    pub window_px: usize,
    /// Windows with a peak, and windows in all.
    pub windows: [usize; 2],
    /// Median disparity before this round's fit, px.
    #[serde(with = "maybe")]
    pub median_px: f64,
    /// Offset along the starting sheet's normal at its reference point, mm.
    pub offset_mm: f64,
    /// Tilt against the starting sheet about its x and y axes, degrees.
    pub tilt_deg: [f64; 2],
}

/// What the particles did to one number of the cameras.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RefinedNumber {
    /// Name as in the covariance; its unit is that of the change.
    pub name: String,
    /// After less before; of a pose or a window's turn the left step.
    pub change: f64,
    /// Standard deviation by the calibration.
    pub sigma_before: f64,
    /// Standard deviation with the particles.
    #[serde(with = "maybe")]
    pub sigma_after: f64,
    /// Change over the standard deviation by the calibration.
    pub change_sigmas: f64,
}

/// Cameras corrected by the particles, weighed against the covariance of their calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CamerasRefined {
    /// Every number of the cameras that the calibration estimated.
    pub numbers: Vec<RefinedNumber>,
    /// Square of the change over what was to be expected, summed over the directions that the particles tell of.
    pub chi2: f64,
    /// Directions that the particles know at least as well as the calibration.
    pub degrees: usize,
    /// Chance of so large a change where calibration and covariance are true; unknown where the particles tell nothing new.
    #[serde(with = "maybe")]
    pub chance: f64,
}

/// The check of a sheet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SheetCheck {
    /// Always `spivcal-check`.
    pub format: String,
    /// Always 1.
    pub version: u32,
    /// Names of the two cameras.
    pub cameras: [String; 2],
    /// Image pairs, first and second camera.
    pub pairs: Vec<[String; 2]>,
    /// Side of a pixel of the dewarped images, mm.
    pub mm_per_px: f64,
    /// How far the coarse plane stands out from chance, standard deviations.
    pub significance: f64,
    /// The sheet that was checked.
    pub before: DisparityMap,
    /// The corrected sheet, where it was asked for.
    pub after: Option<DisparityMap>,
    /// Rounds.
    pub history: Vec<CheckRound>,
    /// Whether the rounds came to rest.
    pub converged: bool,
    /// Point of the starting sheet at which `offset_mm` is given, its frame, mm.
    pub reference_mm: [f64; 2],
    /// Offset of the light from the starting sheet at the reference point along its z (towards the first camera), mm.
    pub offset_mm: f64,
    /// Tilt of the light against the starting sheet about its x and y axes, degrees.
    pub tilt_deg: [f64; 2],
    /// Standard deviation of the offset, mm.
    #[serde(with = "maybe")]
    pub offset_sigma_mm: f64,
    /// Standard deviations of the tilts, degrees.
    #[serde(with = "maybe_array")]
    pub tilt_sigma_deg: [f64; 2],
    /// The part of the offset's by the scatter of the windows, mm.
    #[serde(with = "maybe")]
    pub offset_sigma_windows_mm: f64,
    /// The part of the tilts' by the scatter of the windows, degrees.
    #[serde(with = "maybe_array")]
    pub tilt_sigma_windows_deg: [f64; 2],
    /// Whether the standard deviations hold the calibration's covariance; not where it states none, or does not determine them.
    pub sigmas_hold_calibration: bool,
    /// Standard deviation of a window's disparity about the fit, px.
    #[serde(with = "maybe")]
    pub window_sigma_px: f64,
    /// Root mean square disparity across the direction of depth, px: errors of the cameras, and scatter.
    #[serde(with = "maybe")]
    pub across_rms_px: f64,
    /// The sheet that was checked, apart from the scatter of its windows.
    pub misalignment_before: Misalignment,
    /// The corrected sheet, where it was asked for.
    pub misalignment_after: Option<Misalignment>,
    /// The cameras, where their correction was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras_refined: Option<CamerasRefined>,
    /// The light along the normal of the sheet that was found.
    pub profile: Option<LightProfile>,
    /// Full width of the light's profile at 1/e^2, mm; unknown where the peak is no wider than the particles.
    #[serde(with = "maybe")]
    pub thickness_mm: f64,
    /// What must be looked at.
    pub flags: Vec<String>,
}

/// Before every flag of a check that a calibration keeps.
const CHECKED: &str = "check on particle images: ";

impl Fit {
    /// Forgets what an earlier check on particle images had flagged.
    pub fn forget_check_flags(&mut self) {
        self.flags.retain(|f| !f.starts_with(CHECKED));
    }
    /// Keeps what a check on particle images flagged beside what the images of the target say, so that whoever reads the calibration is told.
    pub fn keep_check_flags(&mut self, flags: &[String]) {
        self.flags.extend(flags.iter().map(|f| format!("{CHECKED}{f}")));
    }
}
