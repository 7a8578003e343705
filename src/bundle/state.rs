//! A point in the space of unknowns.

use crate::camera::{Intrinsics, Window};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::rigid::Motion;

/// One view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewState {
    /// Where the target is, seen from the solver frame of the first camera.
    pub first_from_target: Motion<Rig, Target>,
    /// Where it lies in the common plane, for views that do.
    pub plane_from_target: Option<Motion<Sheet, Target>>,
    /// Shape of its own (drifting bubbles), mm; ignored otherwise.
    pub shape_mm: [f64; 3],
}

/// All unknowns.
///
/// Here `Cam` and `Rig` mean the solver frames of the second and first camera: the pinhole along the sensor normal in the
/// pinhole chart, the lens frame in the lens chart.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Intrinsics of each camera.
    pub cameras: Vec<Intrinsics>,
    /// Motion of each camera against the first (the first: identity).
    pub camera_from_first: Vec<Motion<Cam, Rig>>,
    /// Common plane of all views in the sheet or along a traverse.
    pub first_from_plane: Option<Motion<Rig, Sheet>>,
    /// The views.
    pub views: Vec<ViewState>,
    /// Shape of the target, mm (see [`super::TargetShape`]).
    pub shape_mm: [f64; 3],
    /// Offsets `(dx, dy, dz, dr)` of each disc, mm; empty where discs are not estimated.
    pub offsets_mm: Vec<[f64; 4]>,
    /// Ovality of each printed disc, mm `(a, b)`: its radius grows by `a cos 2 phi + b sin 2 phi`; empty where it is not estimated.
    pub ovals_mm: Vec<[f64; 2]>,
    /// Slopes `(d z / d x, d z / d y)` of the surface at each disc in the target frame; empty where it is flat. Held during a solve.
    pub slopes: Vec<[f64; 2]>,
    /// Window of each camera in its solver frame; empty where no camera has one.
    pub windows: Vec<Option<Window>>,
}

impl State {
    /// Window of a camera, in its solver frame.
    pub fn window(&self, camera: usize) -> Option<&Window> {
        self.windows.get(camera)?.as_ref()
    }

    /// Root mean square of the ovality of printed discs, mm; `None` where it is not estimated.
    pub fn ovality_rms_mm(&self) -> Option<f64> {
        let count = 2 * self.ovals_mm.len();
        let squares = self.ovals_mm.iter().flatten().map(|x| x * x).sum::<f64>();
        (count > 0).then(|| (squares / count as f64).sqrt())
    }
}
