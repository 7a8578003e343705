//! The state after a step, along coordinates in which images are nearly straight.
//!
//! To first order the step is what [`super`] says: additive charts, left steps of motions. But `pixel = f X / Z` bends: a focal
//! length that grows with all distances leaves images almost as they are, and a straight step along that valley would not.
//! So points are moved in
//! ```text
//! a = cx + f X / Z,   b = cy + f Y / Z,   mu = ln(f / Z)          (X, Y, Z): the point in the camera's frame
//! ```
//! by the linear prediction of (a, b, mu). One camera alone: the middle of each target, since each magnification is seen by
//! itself. Two cameras: the middle of the whole scene, in each camera; the scene around it moves as a rigid body plus what each
//! view moves of its own, since what is depth to one camera is width to the other (a dolly zoom). Lengths of the
//! target grow by `exp(dL / L)`. Where a baseline or a target length of one view sets the scale, the whole scene is finally scaled
//! so that this length is the linear prediction: a similarity changes no image.

use super::chart;
use super::facts::Fact;
use super::layout::Places;
use super::model::{Model, TargetShape};
use super::state::{State, ViewState};
use crate::camera::{Camera, INTRINSICS, Intrinsics};
use crate::frames::{Rig, Target};
use crate::rigid::{Motion, orthonormalised, rotation_exp};
use crate::solve::Step;
use nalgebra::{DVector, Matrix3, SVector, Vector3};

/// Pinhole of a solver frame.
#[derive(Clone, Copy)]
struct Eye {
    f: f64,
    fv: f64,
    cx: f64,
    cy: f64,
}

impl Eye {
    fn of(model: &super::CameraModel, i: &Intrinsics) -> Option<Self> {
        if !model.uses_pinhole_frame() {
            return Some(Self { f: i.f_px, fv: i.f_px * i.aspect, cx: i.cx_px, cy: i.cy_px });
        }
        let e = Camera::new(*i).ok()?.effective_pinhole();
        Some(Self { f: e.f_px, fv: e.f_px * i.aspect, cx: e.cx_px, cy: e.cy_px })
    }

    /// Change of (a, b, mu) for a change of the eye to `next` and of the point by `dc`, to first order.
    fn predicted(&self, next: &Eye, c: &Vector3<f64>, dc: &Vector3<f64>) -> [f64; 3] {
        let (x, y) = (c.x / c.z, c.y / c.z);
        let (dx, dy) = ((dc.x - x * dc.z) / c.z, (dc.y - y * dc.z) / c.z);
        [
            next.cx - self.cx + (next.f - self.f) * x + self.f * dx,
            next.cy - self.cy + (next.fv - self.fv) * y + self.fv * dy,
            (next.f - self.f) / self.f - dc.z / c.z,
        ]
    }

    /// The point after the change of (a, b, mu), seen by `next`.
    fn moved(&self, next: &Eye, c: &Vector3<f64>, change: [f64; 3]) -> Vector3<f64> {
        let a = self.cx + self.f * c.x / c.z + change[0];
        let b = self.cy + self.fv * c.y / c.z + change[1];
        let z = c.z * (next.f / self.f) * (-change[2]).exp();
        Vector3::new((a - next.cx) / next.f, (b - next.cy) / next.fv, 1.0) * z
    }
}

fn middle(model: &Model, shape: &[f64; 3]) -> Vector3<f64> {
    let n = model.target.disc_count();
    (0..n).map(|j| model.target.nominal_disc(j, shape).0).sum::<Vector3<f64>>() / n.max(1) as f64
}

/// One view on its way: middle of its target before, its linear movement, its turn.
struct Moving {
    c: Vector3<f64>,
    dc: Vector3<f64>,
    w: Vector3<f64>,
    middle: Vector3<f64>,
    shape: [f64; 3],
}

/// The state after a step.
pub(super) fn retract(model: &Model, places: &Places, state: &State, step: &Step) -> Option<State> {
    let mut next = state.clone();
    let g = &step.global;
    for (c, camera) in model.cameras.iter().enumerate() {
        let d: [f64; INTRINSICS] = places.charts[c].map(|at| at.map_or(0.0, |at| g[at]));
        next.cameras[c] = chart::retract(camera, &state.cameras[c], &d)?;
    }
    for c in 0..next.windows.len() {
        let (Some(window), Some(at)) = (state.window(c), places.windows.get(c)) else { continue };
        let of = |k: usize| at[k].map_or(0.0, |at| g[at]);
        let [first, second] = window.tangents();
        let layers = std::array::from_fn(|k| of(2 + k));
        next.windows[c] = Some(window.stepped(&(first * of(0) + second * of(1)), &layers).ok()?);
    }
    for (k, at) in places.shape.iter().enumerate() {
        next.shape_mm[k] = grown(state.shape_mm[k], at.map_or(0.0, |at| g[at]));
    }
    if let Some(at) = places.ovals {
        next.ovals_mm.iter_mut().flatten().zip(at..).for_each(|(o, at)| *o += g[at]);
    }
    if let Some(at) = places.offsets {
        for (j, o) in next.offsets_mm.iter_mut().enumerate() {
            (0..4).for_each(|k| o[k] += g[at + 4 * j + k]);
        }
    }
    let eyes =
        |s: &State| -> Option<Vec<Eye>> { model.cameras.iter().zip(&s.cameras).map(|(m, i)| Eye::of(m, i)).collect() };
    let (before, after) = (eyes(state)?, eyes(&next)?);
    // The middle of many discs is the same for all views that share a shape.
    let mut scene = None;
    let mut all = Vec::with_capacity(state.views.len());
    for v in 0..state.views.len() {
        let shapes = match scene {
            Some(shapes) if !model.target.per_view() => shapes,
            _ => *scene.insert(Shapes::of(model, places, state, step, v)),
        };
        all.push(moving(model, places, state, step, v, &shapes));
    }
    let moving = all;
    let eye = (&before[0], &after[0]);
    let body = (model.cameras.len() > 1).then(|| Body::of(&moving, eye));
    move_plane(places, state, &mut next, g, body.as_ref(), eye);
    for (v, m) in moving.iter().enumerate() {
        let b = &step.blocks[v];
        let view = &state.views[v];
        let shape_mm = if model.target.per_view() { m.shape } else { next.shape_mm };
        next.views[v] = match (&next.first_from_plane, &view.plane_from_target) {
            (Some(plane), Some(planar)) => {
                let planar = planar.retract(&planar_step(model, v, b));
                ViewState { first_from_target: *plane * planar, plane_from_target: Some(planar), shape_mm }
            }
            _ => {
                let c = moved_point(body.as_ref(), eye, &m.c, &m.dc);
                let rotation = orthonormalised(&(rotation_exp(&m.w) * view.first_from_target.rotation));
                let pose: Motion<Rig, Target> = Motion::new(rotation, c - rotation * m.middle);
                ViewState { first_from_target: pose, plane_from_target: None, shape_mm }
            }
        };
    }
    if let Some(body) = &body {
        move_cameras(places, state, &mut next, g, body, (&before, &after));
    }
    if !metric_scaled(model, places, state, &mut next, step) {
        return None;
    }
    plausible(model, &next).then_some(next)
}

/// Step of a view inside the common plane, as a left step.
fn planar_step(model: &Model, v: usize, b: &DVector<f64>) -> SVector<f64, 6> {
    let mut step = SVector::zeros();
    model.views[v].place.planar_steps().iter().enumerate().for_each(|(n, k)| step[*k] = b[n]);
    step
}

/// A length after a step: multiplicative, so that sizes in the image stay straight; zero lengths (no second level) additive.
fn grown(length: f64, step: f64) -> f64 {
    if length > 0.0 { length * (step / length).exp() } else { length + step }
}

/// Lengths of the target of a view after a step, and the middle of its discs before, after the linear step, and after the step.
#[derive(Clone, Copy)]
struct Shapes {
    after: [f64; 3],
    middles: [Vector3<f64>; 3],
}

impl Shapes {
    fn of(model: &Model, places: &Places, state: &State, step: &Step, v: usize) -> Self {
        let (view, b, g) = (&state.views[v], &step.blocks[v], &step.global);
        let per_view = model.target.per_view();
        let old_shape = if per_view { view.shape_mm } else { state.shape_mm };
        let mut d_shape = [0.0; 3];
        for k in 0..3 {
            d_shape[k] = if per_view {
                places.view_shape[k].map_or(0.0, |at| b[places.pose_sizes[v] + at])
            } else {
                places.shape[k].map_or(0.0, |at| g[at])
            };
        }
        let after = std::array::from_fn(|k| grown(old_shape[k], d_shape[k]));
        let linear = std::array::from_fn(|k| old_shape[k] + d_shape[k]);
        Self { after, middles: [old_shape, linear, after].map(|s| middle(model, &s)) }
    }
}

fn moving(model: &Model, places: &Places, state: &State, step: &Step, v: usize, shapes: &Shapes) -> Moving {
    let (view, b, g) = (&state.views[v], &step.blocks[v], &step.global);
    let [old_middle, linear_middle, new_middle] = shapes.middles;
    let pose = &view.first_from_target;
    let c = pose.apply(&old_middle);
    let d: SVector<f64, 6> = match (&state.first_from_plane, &view.plane_from_target, places.plane) {
        (Some(plane), Some(_), Some(at)) => {
            let of_plane = SVector::<f64, 6>::from([g[at], g[at + 1], 0.0, 0.0, 0.0, g[at + 2]]);
            plane.adjoint() * (of_plane + planar_step(model, v, b))
        }
        _ => b.fixed_rows::<6>(0).into_owned(),
    };
    let w = d.fixed_rows::<3>(0).into_owned();
    let dc = w.cross(&c) + d.fixed_rows::<3>(3) + pose.rotation * (linear_middle - old_middle);
    Moving { c, dc, w, middle: new_middle, shape: shapes.after }
}

/// The scene as a rigid body: its middle before and after, its turn.
struct Body {
    p: Vector3<f64>,
    dp: Vector3<f64>,
    moved: Vector3<f64>,
    w: Vector3<f64>,
    turn: Matrix3<f64>,
}

impl Body {
    fn of(moving: &[Moving], eye: (&Eye, &Eye)) -> Self {
        let n = moving.len().max(1) as f64;
        let mean = |f: &dyn Fn(&Moving) -> Vector3<f64>| moving.iter().map(f).sum::<Vector3<f64>>() / n;
        let (p, dp, w) = (mean(&|m| m.c), mean(&|m| m.dc), mean(&|m| m.w));
        Self { p, dp, w, moved: eye.0.moved(eye.1, &p, eye.0.predicted(eye.1, &p, &dp)), turn: rotation_exp(&w) }
    }

    /// A point whose own linear movement is `dc`.
    fn carried(&self, c: &Vector3<f64>, dc: &Vector3<f64>) -> Vector3<f64> {
        let arm = c - self.p;
        self.moved + self.turn * (arm + dc - self.dp - self.w.cross(&arm))
    }
}

fn moved_point(body: Option<&Body>, eye: (&Eye, &Eye), c: &Vector3<f64>, dc: &Vector3<f64>) -> Vector3<f64> {
    match body {
        Some(body) => body.carried(c, dc),
        None => eye.0.moved(eye.1, c, eye.0.predicted(eye.1, c, dc)),
    }
}

/// Turns the common plane and carries its origin.
fn move_plane(
    places: &Places,
    state: &State,
    next: &mut State,
    g: &DVector<f64>,
    body: Option<&Body>,
    eye: (&Eye, &Eye),
) {
    let (Some(at), Some(plane)) = (places.plane, &state.first_from_plane) else { return };
    let w = plane.rotation * Vector3::new(g[at], g[at + 1], 0.0);
    let dc = plane.rotation.column(2) * g[at + 2];
    let rotation = orthonormalised(&(rotation_exp(&w) * plane.rotation));
    next.first_from_plane = Some(Motion::new(rotation, moved_point(body, eye, &plane.translation_mm, &dc)));
}

/// Moves the other cameras so that the middle of the scene follows its image coordinates there.
fn move_cameras(
    places: &Places,
    state: &State,
    next: &mut State,
    g: &DVector<f64>,
    body: &Body,
    eyes: (&[Eye], &[Eye]),
) {
    for (c, at) in places.motions.iter().enumerate() {
        let Some(at) = *at else { continue };
        let motion = &state.camera_from_first[c];
        let w = g.fixed_rows::<3>(at).into_owned();
        let q = motion.apply(&body.p);
        let dq = w.cross(&q) + g.fixed_rows::<3>(at + 3) + motion.rotation * body.dp;
        let moved = eyes.0[c].moved(&eyes.1[c], &q, eyes.0[c].predicted(&eyes.1[c], &q, &dq));
        let rotation = orthonormalised(&(rotation_exp(&w) * motion.rotation));
        next.camera_from_first[c] = Motion::new(rotation, moved - rotation * body.moved);
    }
}

/// Scales the scene so that the length that sets the scale is its linear prediction; false where that is not positive.
fn metric_scaled(model: &Model, places: &Places, state: &State, next: &mut State, step: &Step) -> bool {
    let per_view = model.target.per_view();
    // Behind windows of known distances a similarity does change images.
    if !(per_view || model.target.free[0]) || next.windows.iter().any(Option::is_some) {
        return true;
    }
    let wanted = model.facts.iter().find_map(|f| match *f {
        Fact::Baseline { .. } => {
            let at = (*places.motions.get(1)?)?;
            let t = &state.camera_from_first[1].translation_mm;
            let (w, v) = (step.global.fixed_rows::<3>(at).into_owned(), step.global.fixed_rows::<3>(at + 3));
            let linear = t.norm() + t.normalize().dot(&(w.cross(t) + v));
            Some((linear, next.camera_from_first[1].translation_mm.norm()))
        }
        Fact::Shape { parameter, view: Some(v), .. } if per_view => {
            let at = places.pose_sizes[v] + places.view_shape[parameter]?;
            Some((state.views[v].shape_mm[parameter] + step.blocks[v][at], next.views[v].shape_mm[parameter]))
        }
        _ => None,
    });
    let Some((linear, now)) = wanted else { return true };
    if !(linear > 0.0 && now > 0.0)
        || state.views.iter().any(|v| v.plane_from_target.is_some_and(|p| p.translation_mm.z != 0.0))
    {
        return linear > 0.0;
    }
    scale(next, linear / now);
    true
}

fn scale(s: &mut State, by: f64) {
    s.camera_from_first.iter_mut().for_each(|m| m.translation_mm *= by);
    s.first_from_plane.iter_mut().for_each(|m| m.translation_mm *= by);
    s.shape_mm.iter_mut().for_each(|l| *l *= by);
    s.offsets_mm.iter_mut().flatten().for_each(|o| *o *= by);
    s.ovals_mm.iter_mut().flatten().for_each(|o| *o *= by);
    for v in &mut s.views {
        v.first_from_target.translation_mm *= by;
        v.plane_from_target.iter_mut().for_each(|m| m.translation_mm *= by);
        v.shape_mm.iter_mut().for_each(|l| *l *= by);
    }
}

/// Radii and spacings must stay positive.
fn plausible(model: &Model, state: &State) -> bool {
    let pair = matches!(model.target.shape, TargetShape::Pair { .. });
    let positive = |s: &[f64; 3]| s[0] > 0.0 && s[1] > 0.0 && (s[2] > 0.0 || !pair);
    if model.target.per_view() { state.views.iter().all(|v| positive(&v.shape_mm)) } else { positive(&state.shape_mm) }
}
