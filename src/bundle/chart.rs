//! Coordinates of a camera in the solver (see the room's head): the pinhole chart and the lens chart.
//!
//! With `du = cx - cx_e`, `dv = (cy - cy_e) / aspect`: `f^2 = f_e^2 + du^2 + dv^2`, `sin b = du / f`,
//! `tan a = dv / f_e`. Turning a tilt turns the pinhole's frame: `dE = [w]x E` with `w = da u - db y`, where u is the
//! sensor's first axis and y the camera's second.

use super::model::{CameraModel, Model};
use super::state::State;
use crate::camera::{Camera, EffectivePinhole, INTRINSICS, Intrinsics};
use nalgebra::{Matrix3, SMatrix};

/// Derivatives of intrinsics (rows 0-9) and of the frame turn w (rows 10-12) by the ten chart coordinates.
pub(super) type ChartDerivative = SMatrix<f64, 13, INTRINSICS>;

/// The camera as the solver sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct SolverCamera {
    /// The camera itself.
    pub(super) camera: Camera,
    /// Turns the solver's frame of this camera into its lens frame: E in the pinhole chart, identity in the lens chart.
    pub(super) cam_from_solver: Matrix3<f64>,
}

impl SolverCamera {
    pub(super) fn of(model: &CameraModel, intrinsics: &Intrinsics) -> Option<Self> {
        let camera = Camera::new(*intrinsics).ok()?;
        let cam_from_solver = if model.uses_pinhole_frame() { camera.cam_from_pinhole() } else { Matrix3::identity() };
        Some(Self { camera, cam_from_solver })
    }

    /// Camera `c` of a state, behind its window.
    pub(super) fn seen(model: &Model, state: &State, c: usize) -> Option<Self> {
        let mut out = Self::of(&model.cameras[c], &state.cameras[c])?;
        out.camera = out.camera.with_window(state.window(c).map(|w| w.in_frame(&out.cam_from_solver)));
        Some(out)
    }
}

/// Intrinsics after a step of the chart coordinates `(f or f_e, aspect, cx or cx_e, cy or cy_e, alpha or cx,
/// beta or cy, k1, k2, k3, m)`.
pub(super) fn retract(model: &CameraModel, i: &Intrinsics, step: &[f64; INTRINSICS]) -> Option<Intrinsics> {
    if !model.uses_pinhole_frame() {
        let mut p = i.to_array();
        p.iter_mut().zip(step).for_each(|(p, d)| *p += d);
        return Some(Intrinsics::from_array(&p, i.radial));
    }
    let e = Camera::new(*i).ok()?.effective_pinhole();
    let aspect = i.aspect + step[1];
    // At a changed aspect the pinhole stays, the tilt follows.
    let moved = EffectivePinhole { f_px: e.f_px + step[0], cx_px: e.cx_px + step[2], cy_px: e.cy_px + step[3] };
    let mut next = moved.with_axis_point(i.cx_px + step[4], i.cy_px + step[5], aspect);
    next.k = [i.k[0] + step[6], i.k[1] + step[7], i.k[2] + step[8]];
    next.pupil_ratio = i.pupil_ratio + step[9];
    next.radial = i.radial;
    (moved.f_px > 0.0).then_some(next)
}

/// Which chart coordinates move, given which intrinsics are free.
pub(super) fn active(model: &CameraModel) -> [bool; INTRINSICS] {
    let f = model.free;
    if !model.uses_pinhole_frame() {
        return f;
    }
    // f, alpha, beta free: three pinhole coordinates; the axis point is coordinates 4 and 5.
    [true, f[1], true, true, f[2], f[3], f[6], f[7], f[8], f[9]]
}

/// Derivative of intrinsics and frame turn by the chart coordinates.
pub(super) fn derivative(model: &CameraModel, camera: &Camera) -> ChartDerivative {
    let mut d = ChartDerivative::zeros();
    if !model.uses_pinhole_frame() {
        d.fixed_view_mut::<INTRINSICS, INTRINSICS>(0, 0).fill_with_identity();
        return d;
    }
    let i = camera.intrinsics();
    let e = camera.effective_pinhole();
    let (du, dv) = (i.cx_px - e.cx_px, (i.cy_px - e.cy_px) / i.aspect);
    let (f, fe) = (i.f_px, e.f_px);
    // Rows: derivative of (f_e, du, dv) by the chart coordinates 0..5.
    let dfe = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let ddu = [0.0, 0.0, -1.0, 0.0, 1.0, 0.0];
    let ddv = [0.0, -dv / i.aspect, 0.0, -1.0 / i.aspect, 0.0, 1.0 / i.aspect];
    let cb = i.beta_rad.cos();
    for c in 0..6 {
        let df = (fe * dfe[c] + du * ddu[c] + dv * ddv[c]) / f;
        let dbeta = (ddu[c] - du / f * df) / (f * cb);
        let dalpha = (fe * ddv[c] - dv * dfe[c]) / (fe * fe + dv * dv);
        d[(0, c)] = df;
        d[(4, c)] = dalpha;
        d[(5, c)] = dbeta;
        d.fixed_view_mut::<3, 1>(10, c).copy_from(&camera.pinhole_turn(dalpha, dbeta));
    }
    d[(1, 1)] = 1.0;
    d[(2, 4)] = 1.0;
    d[(3, 5)] = 1.0;
    for k in 6..10 {
        d[(k, k)] = 1.0;
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::rotation_log;

    /// The derivative against central differences of the retraction.
    #[test]
    fn derivative_is_that_of_the_retraction() {
        for free_f in [true, false] {
            let mut free = [true; INTRINSICS];
            free[0] = free_f;
            let model = CameraModel { name: "c".into(), free, window: None, axis_frame: false };
            let mut i = Intrinsics::pinhole(8000.0, 500.0, 390.0);
            (i.alpha_rad, i.beta_rad, i.aspect, i.k) = (0.2, -0.35, 1.02, [0.1, -0.2, 0.3]);
            let here = SolverCamera::of(&model, &i).unwrap();
            let d = derivative(&model, &here.camera);
            for c in 0..INTRINSICS {
                let h = [
                    1e-2,
                    1e-6,
                    1e-2,
                    1e-2,
                    if free_f { 1e-2 } else { 1e-6 },
                    if free_f { 1e-2 } else { 1e-6 },
                    1e-5,
                    1e-5,
                    1e-5,
                    1e-6,
                ][c];
                let at = |s: f64| {
                    let mut step = [0.0; INTRINSICS];
                    step[c] = s;
                    retract(&model, &i, &step).unwrap()
                };
                let (p, m) = (at(h), at(-h));
                for r in 0..INTRINSICS {
                    let numeric = (p.to_array()[r] - m.to_array()[r]) / (2.0 * h);
                    assert!(
                        (numeric - d[(r, c)]).abs() < 1e-7 * (1.0 + d[(r, c)].abs()),
                        "{r} {c} {numeric} {}",
                        d[(r, c)]
                    );
                }
                let (ep, em) = (SolverCamera::of(&model, &p).unwrap(), SolverCamera::of(&model, &m).unwrap());
                let w = rotation_log(&(ep.cam_from_solver * em.cam_from_solver.transpose())) / (2.0 * h);
                for r in 0..3 {
                    assert!((w[r] - d[(10 + r, c)]).abs() < 1e-8, "turn {r} {c}");
                }
            }
        }
    }
}
