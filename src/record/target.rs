//! The target as the images show it.

use super::number::{label, maybe, maybe_array, maybe_list};
use super::sigma::TargetSigma;
use crate::target::DotId;
use serde::{Deserialize, Serialize};

/// The target as it was adjusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// `two-discs`, `bubbles`, `dot-grid`, `two-level-plate`; `none` for a calibration of another package.
    pub kind: String,
    /// Radii, mm; one for a grid, two for a pair; empty where only centres were used.
    #[serde(with = "maybe_list")]
    pub radii_mm: Vec<f64>,
    /// Distance of the centres of a pair, pitch of a grid, mm; unknown where each view has its own.
    #[serde(with = "maybe")]
    pub spacing_mm: f64,
    /// Standard deviations.
    pub sigma: TargetSigma,
    /// `none`, `shape` or `points`.
    #[serde(default)]
    pub adjust: String,
    /// Distance of the two levels of a plate, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_mm: Option<f64>,
    /// What the target covers in its own plane: least x, least y, largest x, largest y, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extent_mm: Option<[f64; 4]>,
    /// Root mean square shift of the points from the nominal target, mm, where the points were adjusted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shift_rms_mm: Option<f64>,
    /// Standard deviation of the printed discs' ovality (two parts, across and along the diagonals), mm, where it shows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ovality_mm: Option<f64>,
    /// Of bubbles: how what the contours of both cameras say goes together, since both see the same smoke; from the images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub same_light: Option<SameLight>,
    /// Every point of the target, where the points were adjusted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<TargetPoint>,
}

/// How errors of the contours of both cameras go together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SameLight {
    /// Correlation of what both say of a disc, 0 to 1.
    pub correlation: f64,
    /// Variance of what they say, over that which either image has.
    pub variance: f64,
}

/// One adjusted point of the target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TargetPoint {
    /// Lattice label: column, row, level.
    #[serde(with = "label")]
    pub label: DotId,
    /// Position in the target frame, mm.
    pub xyz_mm: [f64; 3],
    /// Standard deviations, mm.
    #[serde(with = "maybe_array")]
    pub sigma_mm: [f64; 3],
}

/// Two bubbles of one view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewTarget {
    /// Radii, mm.
    #[serde(with = "maybe_list")]
    pub radii_mm: Vec<f64>,
    /// Distance of the centres, mm.
    #[serde(with = "maybe")]
    pub spacing_mm: f64,
    /// Standard deviations.
    pub sigma: TargetSigma,
}
