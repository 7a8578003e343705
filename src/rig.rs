//! Two cameras and the motion between them: from labelled discs to the adjusted rig.
//!
//! 1. Each camera alone: candidates for its effective pinhole ([`crate::seed`]), axis point at the sensor's centre, poses in
//!    closed form, a short adjustment of each candidate; the lowest cost wins. Views of one plane leave some of it open: the rest is held
//!    loosely where cameras usually are.
//! 2. The motion between the cameras: every common view gives one, `M_v = right_from_target left_from_target^-1`. They must agree. Where
//!    an image leaves open which disc is which (two discs of one size, a grid without marks), every way to join the labels of
//!    a view is a vote, and the consensus decides; what it leaves open, the cost of the common adjustment decides. Where every
//!    dot is estimated, its printing error tells the views how their labels belong together; a turn or a shift of the
//!    labels of all views together changes nothing (a gauge): those of one view are kept. Discs that are seen from both sides may have the
//!    cameras on opposite sides: where the views agree better so, all of the second camera's poses are turned over.
//! 3. One metric fact fixes the scale; drifting bubbles have a scale of their own in every view until the baseline is common.
//! 4. Several starts of the common adjustment, tried on a part of the edge points unless the first explains them to their
//!    noise; the lowest cost wins.
//! 5. Everything in one adjustment. Focal lengths that views of one plane leave open are held where they usually are, and said to be undetermined.
//!
//! A view, a pairing or a whole camera that contradicts the others is named: images of a view exchanged or of different
//! moments, a mirrored camera, a view marked as in the sheet that is not.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | M_v | `motion` | rad, mm | second solver frame from first, by view v |
//! | T | `changes` | - | change of labels, a quarter turn and a shift of the target; exchange of a pair: half a turn about its middle |
//! | P | `from_behind` | - | `diag(1, -1, -1)`: the target seen from its other side |
//! | D | mirror | - | `diag(-1, 1, 1)`: a horizontally mirrored camera |

mod consensus;
mod contradiction;
mod joint;
mod labels;
mod lone;
mod mono;
mod moved;
mod off_plane;
mod one_plane;
mod open;
mod pitches;
mod print;
mod sides;
mod starts;
mod windows;

pub use joint::calibrate_rig;
pub use labels::{OpenImage, OpenLabels};

use crate::bundle::{Adjustment, ImageObservations, Iteration, Model, State};
use crate::camera::{INTRINSICS, Intrinsics, Radial};
use crate::conic::Ellipse;
use crate::frames::{Cam, Target};
use crate::rigid::Motion;
use crate::target::DotId;
use crate::threads::side_by_side;

/// Pose of the target in a camera's solver frame, and its shape, mm.
type Pose = (Motion<Cam, Target>, [f64; 3]);

/// What is known of a camera before the start.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraStart {
    /// Width and height, px.
    pub size_px: [f64; 2],
    /// f of the drawing, px, where known.
    pub nominal_f_px: Option<f64>,
    /// Values at which fixed intrinsics are held, in the order of [`crate::camera::INTRINSIC_NAMES`]; for free ones where to
    /// start, if not in closed form.
    pub values: [Option<f64>; INTRINSICS],
    /// f (px), alpha and beta (rad) of the drawing, tried first.
    pub design: Option<[f64; 3]>,
    /// Direction of the radial polynomial.
    pub radial: Radial,
}

/// A rig to calibrate.
#[derive(Debug, Clone)]
pub struct RigProblem {
    /// Observations, unknowns, facts. Disc labels of pairs may be exchanged in any image.
    pub model: Model,
    /// One ellipse per disc of each image, in the order of `model.images` and their discs.
    pub ellipses: Vec<Vec<Ellipse>>,
    /// The cameras.
    pub starts: Vec<CameraStart>,
    /// First guess of the target's shape, mm (see [`crate::bundle::TargetShape`]); entries that are adjusted and unknown are `None`.
    pub shape_mm: [Option<f64>; 3],
    /// Names of the images for messages, like `model.images`.
    pub image_names: Vec<String>,
    /// What the images leave open about the labels of their discs.
    pub open: OpenLabels,
}

/// A calibrated rig.
#[derive(Debug, Clone)]
pub struct RigSolution {
    /// The adjustment.
    pub adjustment: Adjustment,
    /// Label of each disc of the adjusted target.
    pub labels: Vec<DotId>,
    /// For each image of the problem, which disc of the adjusted target each of its discs is (outliers included).
    pub disc_of: Vec<Vec<usize>>,
    /// What the images do not decide, in words: how it was taken, and what would decide it.
    pub undecided: Vec<String>,
}

/// A camera calibrated alone.
#[derive(Debug, Clone)]
struct Mono {
    intrinsics: Intrinsics,
    /// Per view of the rig: pose in the camera's solver frame and shape; `None` where the camera has no image.
    poses: Vec<Option<Pose>>,
    /// Root mean square contour distance, px.
    rms_px: f64,
}

/// Told of every iteration from any thread; returns false to stop.
type Told<'a> = &'a (dyn Fn(&Iteration) -> bool + Sync);

fn rms_of(model: &Model, state: &State) -> Option<f64> {
    rms_in(model, |_| state)
}

/// Root mean square contour distance of images in a state each, px.
fn rms_in<'a>(model: &Model, state: impl Fn(&ImageObservations) -> &'a State) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0.0);
    for image in &model.images {
        for disc in crate::bundle::residuals(model, state(image), image)?.discs {
            sum += disc.edges.distance_px.iter().map(|d| d * d).sum::<f64>();
            n += disc.edges.distance_px.len() as f64;
        }
    }
    Some((sum / f64::max(n, 1.0)).sqrt())
}
