//! The named numbers of two cameras and a sheet (as [`super::NamedCovariance`] and the record's covariance name them), and what steps of them do.
//!
//! ```text
//! p = p_0 + d              intrinsics, layers of a window
//! (R, t) = exp(d) (R_0, t_0)   window, motion between the cameras, sheet: left steps, each retracted once, however many of its parts move
//! ```
//! Steps are taken straight in these numbers: right for derivatives, and for steps along which images are nearly straight. Long steps along the valley of
//! the lens axis are not, and are taken where they are made (`disparity::stepped`).
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | p | [`Parameter`] | of its name | one number |
//! | d | [`ParameterSteps`] | px, rad, mm, 1 | steps of any of them |
//!
//! Source: the conventions of [`crate::rigid`] and [`crate::camera`].

use crate::camera::{Camera, INTRINSIC_NAMES, INTRINSICS, Intrinsics, WINDOW_STEP_NAMES, WINDOW_STEPS};
use crate::rigid::{Motion, STEP_NAMES};
use nalgebra::{SVector, Vector3};

/// Row names of the sheet in a covariance.
pub(crate) const SHEET: &str = "sheet.rig_from_sheet.";

/// One adjusted number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Parameter {
    /// Camera and index of the intrinsic.
    Intrinsic(usize, usize),
    /// Camera and step of its window, see [`WINDOW_STEP_NAMES`].
    Window(usize, usize),
    /// Part of a left step of the motion of the second camera against the rig.
    Motion(usize),
    /// Part of a left step of the sheet against the rig.
    Sheet(usize),
}

impl Parameter {
    /// The number of this name; `None` for one that belongs to neither the two cameras nor the sheet.
    pub(crate) fn of(name: &str, camera_names: [&str; 2]) -> Option<Self> {
        let step = |rest: &str| STEP_NAMES.iter().position(|n| *n == rest);
        if let Some(rest) = name.strip_prefix(SHEET) {
            return step(rest).map(Parameter::Sheet);
        }
        let c = (0..2).find(|&c| name.strip_prefix(camera_names[c]).is_some_and(|r| r.starts_with('.')))?;
        let rest = &name[camera_names[c].len() + 1..];
        if let Some(k) = INTRINSIC_NAMES.iter().position(|n| *n == rest) {
            return Some(Parameter::Intrinsic(c, k));
        }
        if let Some(rest) = rest.strip_prefix("window.") {
            return WINDOW_STEP_NAMES.iter().position(|n| *n == rest).map(|k| Parameter::Window(c, k));
        }
        step(rest.strip_prefix("cam_from_rig.").filter(|_| c == 1)?).map(Parameter::Motion)
    }

    /// A change small enough to be straight and large enough to be felt, for cameras with these image distances and a sheet this far away.
    pub(crate) fn step(self, f_px: [f64; 2], distance_mm: f64) -> f64 {
        match self {
            Parameter::Intrinsic(c, 0 | 2 | 3) => 1e-5 * f_px[c],
            Parameter::Intrinsic(_, 6..=8) => 1e-3,
            Parameter::Window(_, 3 | 4) => 1e-5 * distance_mm,
            Parameter::Intrinsic(..) | Parameter::Window(..) => 1e-5,
            Parameter::Motion(k) | Parameter::Sheet(k) if k < 3 => 1e-5,
            Parameter::Motion(_) | Parameter::Sheet(_) => 1e-5 * distance_mm,
        }
    }
}

/// Steps of any of the numbers; what is not named stays.
#[derive(Debug, Clone, Default)]
pub(crate) struct ParameterSteps {
    intrinsics: [[f64; INTRINSICS]; 2],
    windows: [[f64; WINDOW_STEPS]; 2],
    motion: SVector<f64, 6>,
    sheet: SVector<f64, 6>,
}

impl FromIterator<(Parameter, f64)> for ParameterSteps {
    fn from_iter<I: IntoIterator<Item = (Parameter, f64)>>(steps: I) -> Self {
        let mut out = Self::default();
        for (parameter, h) in steps {
            match parameter {
                Parameter::Intrinsic(c, k) => out.intrinsics[c][k] += h,
                Parameter::Window(c, k) => out.windows[c][k] += h,
                Parameter::Motion(k) => out.motion[k] += h,
                Parameter::Sheet(k) => out.sheet[k] += h,
            }
        }
        out
    }
}

impl ParameterSteps {
    /// A step of one number.
    pub(crate) fn one(parameter: Parameter, h: f64) -> Self {
        Self::from_iter([(parameter, h)])
    }

    /// Camera `c` (0 or 1) after them; `None` where there is no such camera, or no window to step.
    pub(crate) fn camera(&self, c: usize, camera: &Camera) -> Option<Camera> {
        let (own, window) = (self.intrinsics.get(c)?, self.windows.get(c)?);
        let mut out = *camera;
        if own.iter().any(|d| *d != 0.0) {
            let i = camera.intrinsics();
            let mut p = i.to_array();
            p.iter_mut().zip(own).for_each(|(p, d)| *p += d);
            out = Camera::new(Intrinsics::from_array(&p, i.radial)).ok()?.with_window(camera.window().copied());
        }
        if window.iter().any(|d| *d != 0.0) {
            let [rx, ry, rz, layers @ ..] = *window;
            let stepped = camera.window()?.stepped(&Vector3::new(rx, ry, rz), &layers).ok()?;
            out = out.with_window(Some(stepped));
        }
        Some(out)
    }

    /// The motion between the rig, or the first camera, and the second camera after them.
    pub(crate) fn motion<A, B>(&self, second: &Motion<A, B>) -> Motion<A, B> {
        second.retract(&self.motion)
    }

    /// The sheet in the rig after them.
    pub(crate) fn sheet<A, B>(&self, rig_from_sheet: &Motion<A, B>) -> Motion<A, B> {
        rig_from_sheet.retract(&self.sheet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Window;
    use crate::frames::{Cam, Rig, Sheet};
    use crate::rigid::rotation_exp;

    /// All numbers that move two cameras and a sheet, with steps of all of them.
    fn all() -> Vec<(String, f64)> {
        let mut out = vec![];
        for c in ["left", "right"] {
            out.extend(INTRINSIC_NAMES.map(|q| format!("{c}.{q}")));
            out.extend(WINDOW_STEP_NAMES.map(|q| format!("{c}.window.{q}")));
        }
        out.extend(STEP_NAMES.map(|q| format!("right.cam_from_rig.{q}")));
        out.extend(STEP_NAMES.map(|q| format!("{SHEET}{q}")));
        out.into_iter().enumerate().map(|(i, n)| (n, 1e-4 * (i + 1) as f64)).collect()
    }

    /// Every name moves its own number by its step, in the unit of the name; together they move as each by itself, and what has no name stays.
    #[test]
    fn names_move_what_they_name() {
        let mut i = Intrinsics::pinhole(8000.0, 500.0, 390.0);
        (i.alpha_rad, i.beta_rad, i.k) = (0.2, -0.3, [0.1, -0.2, 0.3]);
        let window = Window::new(Vector3::new(0.1, -0.3, 1.0), 100.0, 8.0, [1.0, 1.5, 1.333]).unwrap();
        let camera = Camera::new(i).unwrap().with_window(Some(window));
        let pose = Motion::<Cam, Rig>::new(rotation_exp(&Vector3::new(0.1, -0.8, 0.2)), Vector3::new(400.0, 3.0, 90.0));
        let sheet =
            Motion::<Rig, Sheet>::new(rotation_exp(&Vector3::new(3.0, 0.2, 0.1)), Vector3::new(5.0, 1.0, 500.0));
        let named = all();
        let of = |n: &str| Parameter::of(n, ["left", "right"]).unwrap();
        let together: ParameterSteps = named.iter().map(|(n, h)| (of(n), *h)).collect();
        let step = |name: &str| named.iter().find(|(n, _)| n == name).unwrap().1;
        for (c, name) in ["left", "right"].into_iter().enumerate() {
            let moved = together.camera(c, &camera).unwrap();
            for (k, q) in INTRINSIC_NAMES.iter().enumerate() {
                let d = moved.intrinsics().to_array()[k] - i.to_array()[k];
                assert!((d - step(&format!("{name}.{q}"))).abs() < 1e-11, "{name}.{q}: {d}");
                let alone = ParameterSteps::one(of(&format!("{name}.{q}")), step(&format!("{name}.{q}")));
                let one = alone.camera(c, &camera).unwrap();
                assert_eq!(one.intrinsics().to_array()[k].to_bits(), moved.intrinsics().to_array()[k].to_bits());
                assert_eq!(one.window().unwrap(), &window);
                assert_eq!(alone.camera(1 - c, &camera).unwrap().intrinsics(), camera.intrinsics());
            }
            let now = moved.window().unwrap();
            let wanted: Vec<f64> = WINDOW_STEP_NAMES.iter().map(|q| step(&format!("{name}.window.{q}"))).collect();
            let turned = rotation_exp(&Vector3::new(wanted[0], wanted[1], wanted[2])) * *window.normal();
            assert!((*now.normal() - turned).norm() < 1e-12);
            assert!((0..5).all(|k| (now.layers()[k] - window.layers()[k] - wanted[3 + k]).abs() < 1e-11));
        }
        let steps = |owner: &str| SVector::<f64, 6>::from_fn(|k, _| step(&format!("{owner}{}", STEP_NAMES[k])));
        assert!((pose.step_to(&together.motion(&pose)) - steps("right.cam_from_rig.")).norm() < 1e-11);
        assert!((sheet.step_to(&together.sheet(&sheet)) - steps(SHEET)).norm() < 1e-11);
        // Not a number of these, no window, no camera.
        for other in ["left.cam_from_rig.rx_rad", "target.spacing_mm", "view0.rig_from_target.rx_rad", "top.f_px"] {
            assert!(Parameter::of(other, ["left", "right"]).is_none(), "{other}");
        }
        assert!(together.camera(0, &camera.with_window(None)).is_none() && together.camera(2, &camera).is_none());
        assert!(ParameterSteps::one(Parameter::Intrinsic(0, 0), -9000.0).camera(0, &camera).is_none());
    }
}
