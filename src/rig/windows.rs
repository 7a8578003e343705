//! Where windows start: parallel to the common plane, the scene behind them where it would look as it does without.
//!
//! Cameras alone are adjusted as pinholes; what they take for the scene is its apparent place. With n the normal of the common
//! plane away from the camera, the plane's origin o goes to `behind(o)` ([`Window::behind`]), and the scene with it: one shift along n per
//! camera, by which the cameras then stand further apart from the scene and differently to each other.

use super::RigProblem;
use crate::bundle::State;
use crate::camera::Window;
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::Vector3;

/// An estimated window starts no farther away than this part of the apparent distance of the scene: of views along one normal a
/// camera alone knows that distance poorly.
const FARTHEST: f64 = 0.7;

/// Puts the windows of a problem into a start that knows none.
///
/// # Errors
/// [`Insufficient::Degenerate`] where there is no common plane, or a window would stand behind the target.
pub(super) fn set_windows(problem: &RigProblem, state: &mut State) -> Result<()> {
    let cameras = &problem.model.cameras;
    if cameras.iter().all(|c| c.window.is_none()) {
        return Ok(());
    }
    let plane = state.first_from_plane.ok_or_else(|| {
        Insufficient::Degenerate(
            "a window needs views in the sheet or along a traverse (sheet = true or plane_z_mm): its direction is counted from theirs"
                .into(),
        )
    })?;
    let apart: Vec<Motion<Cam, Sheet>> = state.camera_from_first.iter().map(|m| *m * plane).collect();
    let mut behind = apart.clone();
    let mut windows = vec![None; cameras.len()];
    for (c, camera) in cameras.iter().enumerate() {
        let Some(model) = &camera.window else { continue };
        let origin = apart[c].translation_mm;
        let axis: Vector3<f64> = apart[c].rotation.column(2).into_owned();
        let normal = axis * axis.dot(&origin).signum();
        let [mut distance, thickness, air, glass, water] = model.layers;
        if model.free[0] {
            distance = distance.min(FARTHEST * normal.dot(&origin) - thickness);
        }
        let window = Window::new(normal, distance, thickness, [air, glass, water])?;
        let Some(place) = window.behind(&origin) else {
            return Err(Insufficient::Degenerate(format!(
                "camera \"{}\": its window ({distance} mm away, {thickness} mm thick) would stand behind the target, which seems to be {:.1} mm away; correct distance_mm in [camera.window]",
                camera.name,
                normal.dot(&origin)
            ))
            .into());
        };
        behind[c].translation_mm = place;
        windows[c] = Some(window);
    }
    let new_plane = state.camera_from_first[0].inverse() * behind[0];
    state.first_from_plane = Some(new_plane);
    let shift = new_plane * plane.inverse();
    for view in &mut state.views {
        view.first_from_target = match &view.plane_from_target {
            Some(planar) => new_plane * *planar,
            None => shift * view.first_from_target,
        };
    }
    for c in 1..cameras.len() {
        state.camera_from_first[c] = behind[c] * new_plane.inverse();
    }
    state.windows = windows;
    Ok(())
}
