//! Standard deviations: 0 where held, unknown where not determined.

use super::number::{maybe, maybe_array, maybe_list};
use super::schema::Effective;
use serde::{Deserialize, Serialize};

/// Standard deviations of a [`super::Camera`]; 0 where fixed, unknown where not determined.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraSigma {
    /// Of `f_px`.
    #[serde(with = "maybe")]
    pub f_px: f64,
    /// Of `aspect`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub aspect: f64,
    /// Of `cx_px`.
    #[serde(with = "maybe")]
    pub cx_px: f64,
    /// Of `cy_px`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub cy_px: f64,
    /// Of `alpha_rad`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub alpha_rad: f64,
    /// Of `beta_rad`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub beta_rad: f64,
    /// Of `k1`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub k1: f64,
    /// Of `k2`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub k2: f64,
    /// Of `k3`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub k3: f64,
    /// Of `pupil_ratio`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub pupil_ratio: f64,
    /// Of the effective pinhole.
    pub effective: Effective,
    /// Of the pose in the rig.
    #[serde(default)]
    pub cam_from_rig: PoseSigma,
}

impl Default for CameraSigma {
    /// Everything unknown.
    fn default() -> Self {
        let nan = f64::NAN;
        Self {
            f_px: nan,
            aspect: nan,
            cx_px: nan,
            cy_px: nan,
            alpha_rad: nan,
            beta_rad: nan,
            k1: nan,
            k2: nan,
            k3: nan,
            pupil_ratio: nan,
            effective: Effective::default(),
            cam_from_rig: PoseSigma::default(),
        }
    }
}

/// Standard deviations of a pose, for a step on the left: `R' = exp(dw) R`, `t' = exp(dw) t + dv`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseSigma {
    /// Of the rotation about the axes of the goal frame, rad.
    #[serde(with = "maybe_array")]
    pub rotation_rad: [f64; 3],
    /// Of the translation, mm.
    #[serde(with = "maybe_array")]
    pub translation_mm: [f64; 3],
}

impl Default for PoseSigma {
    /// Everything unknown.
    fn default() -> Self {
        Self { rotation_rad: maybe_array::unknown(), translation_mm: maybe_array::unknown() }
    }
}

/// Standard deviations of a [`super::Rig`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RigSigma {
    /// Of `baseline_mm`.
    #[serde(with = "maybe")]
    pub baseline_mm: f64,
    /// Of `axes_angle_deg`.
    #[serde(with = "maybe")]
    pub axes_angle_deg: f64,
}

/// Standard deviations of a [`super::Sheet`], those of the cameras included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SheetSigma {
    /// Of `distance_mm`.
    #[serde(with = "maybe")]
    pub distance_mm: f64,
    /// Of the normal, about the sheet's x and y axes, rad.
    #[serde(with = "maybe_array")]
    pub normal_rad: [f64; 2],
    /// Of `abc_per_mm`.
    #[serde(with = "maybe_array")]
    pub abc_per_mm: [f64; 3],
    /// Of `angles_deg`.
    #[serde(with = "maybe_array", default = "maybe_array::unknown")]
    pub angles_deg: [f64; 3],
    /// Of `angle_to_baseline_deg`.
    #[serde(with = "maybe")]
    pub angle_to_baseline_deg: f64,
}

impl Default for SheetSigma {
    /// Everything unknown.
    fn default() -> Self {
        let nan = f64::NAN;
        Self {
            distance_mm: nan,
            normal_rad: [nan; 2],
            abc_per_mm: [nan; 3],
            angles_deg: [nan; 3],
            angle_to_baseline_deg: nan,
        }
    }
}

/// Standard deviations of a [`super::Window`]; 0 where known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WindowSigma {
    /// Of the normal, about the axes of the camera frame, rad.
    #[serde(with = "maybe_array", default = "maybe_array::unknown")]
    pub normal_rad: [f64; 3],
    /// Of `distance_mm`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub distance_mm: f64,
    /// Of `thickness_mm`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub thickness_mm: f64,
    /// Of `n_air`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub n_air: f64,
    /// Of `n_glass`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub n_glass: f64,
    /// Of `n_water`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub n_water: f64,
}

/// Standard deviations of a [`super::Target`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TargetSigma {
    /// Of `radii_mm`.
    #[serde(with = "maybe_list", default)]
    pub radii_mm: Vec<f64>,
    /// Of `spacing_mm`.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub spacing_mm: f64,
    /// Of `step_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_mm: Option<f64>,
}
