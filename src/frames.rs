//! Coordinate frames as types, so that a point cannot be used in the wrong one.
//!
//! | frame | origin and axes | unit |
//! |---|---|---|
//! | [`Cam`] | projection centre; z along the lens axis, forward; x right, y down | mm |
//! | [`Rig`] | the frame of the first camera | mm |
//! | [`Target`] | a pattern, plane z = 0; x right, y up, z towards the viewer of its printed side; of one that shows both sides, towards the first camera | mm |
//! | [`Sheet`] | the laser sheet, plane z = 0; z towards the first camera, x right and y up as it sees them | mm |
//! | [`Sensor`] | pixels: (0, 0) is the centre of the first pixel, u right, v down | px |
//!
//! A point moves with a frame change, a [`Direction`] only turns.

use nalgebra::Vector3;
use std::marker::PhantomData;

/// Frame of one camera (see the module table).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cam;
/// Frame of the rig: that of the first camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rig;
/// Frame of a calibration target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target;
/// Frame of the laser sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sheet;
/// Frame of the sensor, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor;

/// A point in frame `F`, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point<F> {
    /// Coordinates in `F`, mm.
    pub xyz_mm: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Point<F> {
    /// The point with these coordinates in `F`, mm.
    pub fn new(x_mm: f64, y_mm: f64, z_mm: f64) -> Self {
        Self::from_vector(Vector3::new(x_mm, y_mm, z_mm))
    }
    /// The point with this coordinate vector in `F`, mm.
    pub fn from_vector(xyz_mm: Vector3<f64>) -> Self {
        Self { xyz_mm, frame: PhantomData }
    }
}

/// A direction in frame `F`: turned, never shifted, by a frame change. Not necessarily of unit length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction<F> {
    /// Components in `F`.
    pub xyz: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Direction<F> {
    /// The direction with this component vector in `F`.
    pub fn from_vector(xyz: Vector3<f64>) -> Self {
        Self { xyz, frame: PhantomData }
    }
}

/// The plane `normal . p = distance_mm` in frame `F`; `normal` has unit length.
///
/// In the rig frame the normal points away from the first camera, so `distance_mm > 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane<F> {
    /// Unit normal.
    pub normal: Direction<F>,
    /// Distance from the origin along the normal, mm.
    pub distance_mm: f64,
}

impl<F> Plane<F> {
    /// The plane `normal . p = distance_mm` (unit normal, mm) with its normal turned away from the origin.
    pub fn away_from_origin(normal: Vector3<f64>, distance_mm: f64) -> Self {
        let sign = if distance_mm < 0.0 { -1.0 } else { 1.0 };
        Self { normal: Direction::from_vector(normal * sign), distance_mm: distance_mm * sign }
    }
}

/// A position on the sensor in px; (0, 0) is the centre of the first pixel, u right, v down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel {
    /// To the right, px.
    pub u_px: f64,
    /// Down, px.
    pub v_px: f64,
}

impl Pixel {
    /// The pixel position (u, v).
    pub fn new(u_px: f64, v_px: f64) -> Self {
        Self { u_px, v_px }
    }
}
