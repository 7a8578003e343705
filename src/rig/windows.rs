//! Where windows start: parallel to the common plane, the scene behind them where it would look as it does without.
//!
//! Cameras alone are adjusted as pinholes; what they take for the scene is its apparent place. With n the normal of the common
//! plane away from the camera, the plane's origin o goes to `behind(o)` ([`Window::behind`]), and the scene with it: one shift along n per
//! camera, by which the cameras then stand further apart from the scene and differently to each other.

use super::RigProblem;
use crate::bundle::{Fact, State};
use crate::camera::{Camera, Intrinsics, Window};
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::Vector3;

/// An estimated window starts no farther away than this part of the apparent distance of the scene: of views along one normal a
/// camera alone knows that distance poorly.
const FARTHEST: f64 = 0.7;

/// Views whose normals lie within this angle of the common plane's are seen along one normal, rad.
const ONE_NORMAL_RAD: f64 = 0.1;

/// Whether a camera alone knows how far away the scene is.
fn knows_distance(problem: &RigProblem, state: &State, c: usize) -> bool {
    let model = &problem.model;
    let of_f = |f: &Fact| matches!(f, Fact::Intrinsic { camera, parameter: 0, .. } if *camera == c);
    let lens = !model.cameras[c].free[0] || model.facts.iter().any(of_f);
    let Some(plane) = &state.first_from_plane else { return lens };
    let turned = |v: &crate::bundle::ViewState| {
        let cosine = v.first_from_target.rotation.column(2).dot(&plane.rotation.column(2)).abs();
        cosine < ONE_NORMAL_RAD.cos()
    };
    lens || state.views.iter().any(turned)
}

/// The same camera with its effective focal length `q` times as large: a scene `q` times as far away keeps its size in the image.
fn magnified(problem: &RigProblem, c: usize, now: &Intrinsics, q: f64) -> Intrinsics {
    let mut out = *now;
    out.f_px *= q;
    let Ok(camera) = Camera::new(*now) else { return out };
    if problem.model.cameras[c].uses_pinhole_frame() {
        let mut e = camera.effective_pinhole();
        e.f_px *= q;
        let moved = e.with_axis_point(now.cx_px, now.cy_px, now.aspect);
        (out.f_px, out.alpha_rad, out.beta_rad) = (moved.f_px, moved.alpha_rad, moved.beta_rad);
    }
    out
}

/// Puts the windows of a problem into a start that knows none.
///
/// Where the distance of a window is given and the scene seems to be before it, though the camera alone cannot tell, the scene starts
/// behind it, and the focal length follows.
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
        let mut origin = apart[c].translation_mm;
        let axis: Vector3<f64> = apart[c].rotation.column(2).into_owned();
        let normal = axis * axis.dot(&origin).signum();
        let [mut distance, thickness, air, glass, water] = model.layers;
        if model.free[0] {
            distance = distance.min(FARTHEST * normal.dot(&origin) - thickness);
        }
        let window = Window::new(normal, distance, thickness, [air, glass, water])?;
        // The view nearest to the camera, counted from the plane's origin.
        let nearest = state.views.iter().map(|v| {
            let along = axis.dot(&normal) * (plane.inverse() * v.first_from_target).translation_mm.z;
            normal.dot(&origin) + along
        });
        let before = nearest.fold(f64::INFINITY, f64::min) <= distance + thickness;
        if !model.free[0] && before && !knows_distance(problem, state, c) {
            let q = (distance + thickness) / FARTHEST / normal.dot(&origin);
            origin *= q;
            state.cameras[c] = magnified(problem, c, &state.cameras[c], q);
        }
        let Some(place) = window.behind(&origin) else {
            return Err(Insufficient::Degenerate(format!(
                "camera \"{}\": its window ({distance} mm away, {thickness} mm thick) would stand behind the target, which seems to be {:.1} mm away along its normal; correct distance_mm in [camera.window]",
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::{
        CameraModel, Loss, Model, PlanePosition, TargetModel, TargetShape, ViewModel, ViewPlace, ViewState, WindowModel,
    };
    use crate::camera::{INTRINSICS, Radial};
    use crate::frames::{Rig, Target};
    use crate::rig::{CameraStart, OpenLabels};
    use crate::rigid::rotation_exp;

    /// A camera 353 mm before the plane along its normal, of which it is known to be 300 mm away; the window at 330 mm.
    fn problem(f_known: bool) -> (RigProblem, State) {
        let mut free = [true; INTRINSICS];
        (free[1], free[7], free[8], free[9]) = (false, false, false, false);
        let window = WindowModel { free: [false; 5], layers: [330.0, 6.0, 1.0, 1.49, 1.333] };
        let place = ViewPlace::InPlane { z_mm: 0.0, known: PlanePosition::Exact };
        let model = Model {
            cameras: vec![CameraModel { name: "left".into(), free, window: Some(window), axis_frame: false }],
            target: TargetModel {
                shape: TargetShape::Pair { per_view: false },
                free: [false, true, true],
                offset_sigma_mm: None,
                oval_sigma_mm: None,
            },
            views: vec![ViewModel { place }; 2],
            facts: if f_known {
                vec![Fact::Intrinsic { camera: 0, parameter: 0, value: 7550.0, sigma: 10.0 }]
            } else {
                vec![]
            },
            images: vec![],
            loss: Loss::None,
        };
        let start = CameraStart {
            size_px: [1024.0, 768.0],
            nominal_f_px: None,
            values: [None; INTRINSICS],
            design: None,
            radial: Radial::default(),
        };
        let problem = RigProblem {
            model,
            ellipses: vec![],
            starts: vec![start],
            shape_mm: [Some(13.0), None, None],
            image_names: vec![],
            open: OpenLabels::default(),
        };
        let mut i = Intrinsics::pinhole(7550.0, 520.0, 380.0);
        (i.alpha_rad, i.beta_rad) = (0.02, -0.1);
        let turn = rotation_exp(&Vector3::new(0.0, -45_f64.to_radians(), 0.0))
            * rotation_exp(&Vector3::new(std::f64::consts::PI, 0.0, 0.0));
        let plane: Motion<Rig, Sheet> = Motion::new(turn, Vector3::new(0.0, 0.0, 300.0 * 2.0_f64.sqrt()));
        let view = |x: f64, z: f64| {
            let planar: Motion<Sheet, Target> = Motion::new(nalgebra::Matrix3::identity(), Vector3::new(x, 1.0, z));
            ViewState { first_from_target: plane * planar, plane_from_target: Some(planar), shape_mm: [13.0, 6.0, 4.7] }
        };
        let state = State {
            cameras: vec![i],
            camera_from_first: vec![Motion::identity()],
            first_from_plane: Some(plane),
            views: vec![view(-4.0, -5.0), view(5.0, 5.0)],
            shape_mm: [13.0, 6.0, 4.7],
            offsets_mm: vec![],
            ovals_mm: vec![],
            slopes: vec![],
            windows: vec![],
        };
        (problem, state)
    }

    #[test]
    fn a_scene_that_seems_to_stand_before_its_window_starts_behind_it() {
        let (problem, mut state) = problem(false);
        let before = Camera::new(state.cameras[0]).unwrap().effective_pinhole();
        set_windows(&problem, &mut state).unwrap();
        let after = Camera::new(state.cameras[0]).unwrap().effective_pinhole();
        let window = state.windows[0].unwrap();
        assert_eq!(window.layers()[0], 330.0, "a given distance is kept");
        for view in &state.views {
            let seen = window.apparent(&view.first_from_target.translation_mm).expect("behind the window");
            assert!(window.normal().dot(&seen) > 336.0, "{seen}");
        }
        // As large in the image as before: f over the apparent distance.
        let origin = state.first_from_plane.unwrap().translation_mm;
        let apparent = window.normal().dot(&window.apparent(&origin).unwrap());
        assert!((after.f_px / apparent / (before.f_px / 300.0) - 1.0).abs() < 1e-9, "{} {apparent}", after.f_px);
        assert!((after.cx_px - before.cx_px).abs() < 1e-6 && (after.cy_px - before.cy_px).abs() < 1e-6);
    }

    #[test]
    fn a_camera_that_knows_the_distance_refuses_the_window_in_words() {
        let (problem, mut state) = problem(true);
        let told = set_windows(&problem, &mut state).unwrap_err().to_string();
        assert!(told.contains("behind the target") && told.contains("300.0 mm"), "{told}");
    }
}
