//! Where a calibration comes from.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// An image that took part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageFile {
    /// Name as in the rig file.
    pub path: String,
    /// View, from 0.
    pub view: usize,
    /// Camera name.
    pub camera: String,
    /// SHA-256 of the file, hexadecimal, where it was taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Part of the pixels about its discs that are at the end of the camera's scale, 0 to 1.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub saturated: f64,
    /// Part of the pixels beside the contours of its discs whose noise is cut off at grey level 0, 0 to 1.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub cut_at_zero: f64,
}

fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

/// Where a calibration comes from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Provenance {
    /// Program and version that wrote it.
    #[serde(default)]
    pub program: String,
    /// Rig file as the user named it.
    #[serde(default)]
    pub rig_file: String,
    /// Options of the run, name to value.
    #[serde(default)]
    pub options: BTreeMap<String, String>,
    /// Images that took part.
    #[serde(default)]
    pub images: Vec<ImageFile>,
}
