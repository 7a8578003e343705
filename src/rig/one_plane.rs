//! What holds a camera alone whose views all show one plane, or planes parallel to each other.
//!
//! Such views share one pair of circular points: 4 numbers (2 of a vanishing line, 2 of the points on it) for the 2 of the plane's normal and
//! the 3 of the effective pinhole. Along the direction that is left, and along those of tilt, axis point and distortion, nothing but noise says
//! where to stop, since each view's normal is free by itself: with weak contours a camera ran to a tilt of 80 degrees for a chi-square that was
//! smaller by two. No common adjustment finds back from there. So the camera starts as cameras usually are, loosely:
//! ```text
//! f          its nominal value, where there is one        15 %
//! cx, cy     their stated place or the sensor's centre    5 % of width, height
//! alpha, beta   0, or those of the drawing                8 degrees, 3 degrees
//! k1..k3     their stated value or 0                      1 % at the corner of the image
//! ```
//! Facts of the rig file stay as they are, and come instead. Of this the common adjustment takes no more than what it leaves open ([`super::open`]).

use super::{CameraStart, RigProblem};
use crate::bundle::{Fact, State};
use std::f64::consts::PI;

/// Normals of views nearer to each other than this say no more of the camera than noise does, rad.
const PARALLEL_RAD: f64 = 2.0 * PI / 180.0;
/// Usual departure of f from its nominal value.
pub(super) const NOMINAL: f64 = 0.15;
/// Usual distance of the axis point from the sensor's centre, in widths.
const OFF_CENTER: f64 = 0.05;
/// Usual tilt, and departure of a tilt from the drawing, rad.
const TILT_RAD: f64 = 8.0 * PI / 180.0;
const FROM_DRAWING_RAD: f64 = 3.0 * PI / 180.0;
/// Usual distortion at the corner of the image.
const DISTORTION: f64 = 0.01;

/// Whether all these views are said to be parallel to one plane.
pub(super) fn all_in_plane(problem: &RigProblem, views: impl IntoIterator<Item = usize>) -> bool {
    views.into_iter().all(|v| problem.model.views[v].place.in_plane())
}

/// Whether the targets of all views were found parallel to each other.
pub(super) fn all_parallel(state: &State) -> bool {
    let normal = |v: usize| state.views[v].first_from_target.rotation.column(2).into_owned();
    (1..state.views.len()).all(|v| {
        let (a, b) = (normal(0), normal(v));
        a.cross(&b).norm().atan2(a.dot(&b)) < PARALLEL_RAD
    })
}

/// What is usual of each free intrinsic of camera `c` that the rig file says nothing of, as facts of the only camera.
pub(super) fn usual(problem: &RigProblem, c: usize) -> Vec<Fact> {
    let camera = &problem.model.cameras[c];
    let stated = |k: usize| {
        let of = |f: &Fact| matches!(f, Fact::Intrinsic { camera, parameter, .. } if [*camera, *parameter] == [c, k]);
        problem.model.facts.iter().any(of)
    };
    let usual = usual_values(&problem.starts[c]).into_iter().filter(|(k, ..)| camera.free[*k] && !stated(*k));
    usual.map(|(parameter, value, sigma)| Fact::Intrinsic { camera: 0, parameter, value, sigma }).collect()
}

/// Parameter, value and standard deviation.
pub(super) fn usual_values(start: &CameraStart) -> Vec<(usize, f64, f64)> {
    let [width, height] = start.size_px;
    let mut out: Vec<(usize, f64, f64)> = start.nominal_f_px.iter().map(|f| (0, *f, NOMINAL * f)).collect();
    for (k, size) in [(2, width), (3, height)] {
        out.push((k, start.values[k].unwrap_or((size - 1.0) / 2.0), OFF_CENTER * size));
    }
    for k in [4, 5] {
        let drawn = start.design.map(|d| (k, d[k - 3], FROM_DRAWING_RAD));
        out.push(drawn.unwrap_or((k, 0.0, TILT_RAD)));
    }
    let f_px = start.nominal_f_px.unwrap_or(4.0 * width.max(height));
    let r2 = (width * width + height * height) / (4.0 * f_px * f_px);
    for (n, k) in (6..9).enumerate() {
        out.push((k, start.values[k].unwrap_or(0.0), DISTORTION / r2.powi(n as i32 + 1)));
    }
    out
}
