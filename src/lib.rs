//! Stereo PIV calibration directly in the laser sheet.
//!
//! Two cameras look obliquely at a thin laser sheet, their sensors tilted (Scheimpflug). From images of discs
//! spivcal finds subpixel contours, adjusts both cameras, the motion between them and the unknown target in one
//! bundle adjustment, and gives the plane of the sheet, all with standard deviations.
//!
#![doc = include_str!("MAP.md")]

/// Scenes of the integration tests name the library from outside; tests within use them too.
#[cfg(test)]
extern crate self as spivcal;

pub mod bitangent;
pub mod bundle;
pub mod camera;
#[cfg(feature = "cli")]
pub mod cli;
pub mod conic;
pub mod detect;
pub mod dewarp;
pub mod diagnosis;
pub mod disparity;
pub mod error;
pub mod exchange;
pub mod ffi;
pub mod frames;
pub mod image;
pub(crate) mod lanes;
pub mod pipeline;
pub mod reconstruct;
pub mod record;
pub mod report;
pub mod rig;
pub mod rig_file;
pub mod rigid;
pub mod seed;
pub mod sheet;
pub mod simulate;
pub mod solve;
pub mod stats;
pub mod target;
pub(crate) mod threads;

pub use error::{Error, Result};
