//! Bundle adjustment: all images of one or two cameras, the poses, the target and the laser sheet in one least squares.
//!
//! This is the only room where a camera meets a solver.
//!
//! **Observation models.** `contour`: every subpixel edge point against the image of its circle through the whole lens
//! model; the residual is the signed orthogonal distance in the image,
//! ```text
//! r = n . (q - q(phi)),   q(phi) = image of C + R (cos phi, sin phi, 0),   (q - q(phi)) . q'(phi) = 0
//! ```
//! Because the foot `phi` makes the distance stationary, the derivative is exactly `-n . dq/dz` at fixed `phi`, for
//! every unknown z. `bitangent`: the 14 tangent features of a pair of discs, of ellipses fitted where the lens is undone,
//! against the images of the circles' own features, whitened with their rank-10 covariance ([`adjust_tangents`]). `points`: the images
//! of the discs' centres, or of corners in their places, two whitened coordinates each ([`PointObservations`]).
//!
//! **Unknowns.**
//!
//! | symbol | identifier | size | unit | frame | meaning |
//! |---|---|---|---|---|---|
//! | e | chart of a camera | 10 | px, rad, 1 | - | intrinsics, see [`chart`](self) below |
//! | (t, d, g, n) | `windows` | 2 + 5 | rad, mm, 1 | solver frame | direction and layers of a camera's window |
//! | (w, v) | `camera_from_first` | 6 | rad, mm | second camera | motion between the cameras, step on the left |
//! | (w, v) | pose of a view | 6 | rad, mm | first camera | `first_from_target`, step on the left |
//! | (wx, wy, vz) | plane | 3 | rad, mm | Sheet | the common plane of all views in the sheet or on a traverse |
//! | (wz, vx, vy, vz) | planar pose | 3 or 4 | rad, mm | Sheet | where such a view lies in that plane; vz where its distance is estimated |
//! | tau | `shape` | 3 | mm | Target | two discs: spacing, radius 0, radius 1; grids: pitch, radius, step between levels |
//! | (dx, dy, dz, dr) | `offsets` | 4 per disc | mm | Target | departure of a printed disc from its nominal place and radius |
//!
//! **Charts.** Without distortion a tilted camera equals a pinhole along its sensor normal, so f, tilts, axis point and
//! all poses trade off along a curved two-dimensional valley (method section 2). The *pinhole chart* makes it
//! straight: the unknowns are `(f_e, aspect, cx_e, cy_e, cx, cy, k1, k2, k3, m)` and poses are held in the pinhole's frame,
//! so that moving the axis point changes nothing but the distortion's centre. The *lens chart* has the intrinsics
//! themselves and poses in the lens frame; it is used where f or a tilt is fixed.
//!
//! **Order of work.** Where observations are many a part of them finds the start. Views are eliminated, or where every disc is estimated and
//! discs are more than poses the discs; either way the normal equations of the result have one block per view.
//!
//! **Two cameras.** Errors of the contours of a bubble in both cameras are alike as far as both see the same smoke; how far, the images tell
//! (`same_light.rs`).
//!
//! **Gauge.** The first camera is the rig frame. Scale comes from one [`Fact`]. Nothing else is free.
//!
//! Source: the paper's section 2; Triggs et al. (2000); the orthogonal distance after Ahn, "Least squares orthogonal
//! distance fitting" (2004). Not valid where a circle is not wholly in front of a camera (the state is refused).

mod adjust;
mod assemble;
mod by_disc;
mod chart;
mod conflict;
mod contour;
mod dots_plane;
mod edges;
mod extension;
mod facts;
mod focus;
mod image_map;
mod influence;
mod layout;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod list;
mod model;
mod moved;
mod open;
mod outline;
mod part;
mod points;
mod posterior;
mod reach;
mod refit;
mod residuals;
mod retraction;
mod same_light;
mod state;
mod steps;
mod surface;
mod tangent;
mod tie;
mod typical;
mod undetermined;

/// The scenes of the tests below `tests`, for those in here.
#[cfg(test)]
#[path = "../tests/rig_scene/mod.rs"]
mod rig_scene;

pub use adjust::{
    AdjustOptions, Adjustment, Outlier, adjust, adjust_owned, problem, readjusted_with, shared_covariance, sigma_scales,
};
pub use conflict::{PriorCheck, prior_checks};
pub use extension::{Extension, ExtensionTest, ExtensionTests, extension_tests};
pub use facts::{Fact, PriorOf};
pub use focus::Focus;
pub use influence::{ViewsLeftOut, named_rows, natural_of, predicted_with_all_views, readjusted_without};
pub use model::{
    CameraModel, DiscObservation, ImageObservations, LensDependence, Loss, Model, Node, Observed, OvalDependence,
    PairObservation, PlanePosition, PointObservations, TargetModel, TargetShape, ViewModel, ViewPlace, WindowModel,
};
pub use moved::{Moved, MovedFit, MovedTest, moved_before, moved_test};
pub use open::{Released, open_rows, released};
pub use posterior::{NamedCovariance, Natural, ParameterKnowledge, named_covariance};
pub use reach::{FURTHEST, Numbers, Observe, Reach};
pub use refit::{TangentAdjustment, adjust_tangents, pair_features};
pub use residuals::{DiscResidual, EdgeResidual, ImageResiduals, PredictedPlace, predicted_places, residuals};
pub use state::{State, ViewState};
pub(crate) use steps::{Parameter, ParameterSteps, SHEET};
pub use tie::Alike;
pub(crate) use typical::{distance_mm, typical};
pub(crate) use undetermined::{MOSTLY_PRIOR, ONLY_PRIOR, intrinsic_words, layer_words, listed, view_of_direction};

/// How the adjustment is steered and how it ended: rooms above speak of it without knowing the solver.
pub use crate::solve::{Iteration, Options as SolveOptions, Prediction, Termination, symmetric_eigen};
