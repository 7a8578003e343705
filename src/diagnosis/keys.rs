//! The numbers that a user relies on, with their derivatives by the named parameters.

use crate::bundle::{NamedCovariance, Natural, Parameter, ParameterSteps, distance_mm};
use crate::camera::INTRINSIC_NAMES;
use crate::frames::{Plane, Rig};
use crate::record::SHEET_QUANTITIES;
use crate::rigid::{AxesAngle, PlaneAngle};
use crate::sheet::StereoSheet;
use nalgebra::{DMatrix, DVector, Vector3};

/// One number.
pub(super) struct Key {
    pub(super) name: String,
    pub(super) unit: &'static str,
    pub(super) value: f64,
}

/// All of them.
pub(super) struct Keys {
    pub(super) list: Vec<Key>,
    /// Derivatives by named parameters.
    pub(super) rows: Vec<Vec<(String, f64)>>,
    /// Whether nothing undetermined moves them.
    pub(super) determined: Vec<bool>,
    reference: Option<StereoSheet>,
    axes: Option<AxesAngle>,
    to_baseline: Option<PlaneAngle>,
}

fn stereo(natural: &Natural) -> Option<StereoSheet> {
    let cameras = [*natural.cameras.first()?, *natural.cameras.get(1)?];
    Some(StereoSheet::new(cameras, natural.cam_from_rig[1], natural.rig_from_plane.as_ref()?))
}

fn plane(n: &Natural) -> Option<Plane<Rig>> {
    let pose = n.rig_from_plane.as_ref()?;
    let normal: Vector3<f64> = pose.rotation.column(2).into_owned();
    Some(Plane::away_from_origin(normal, normal.dot(&pose.translation_mm)))
}

/// From the first camera to the second, in the rig frame.
fn baseline(n: &Natural) -> Option<Vector3<f64>> {
    Some(n.cam_from_rig.get(1)?.inverse().translation_mm.normalize())
}

impl Keys {
    pub(super) fn of(covariance: &NamedCovariance, names: &[&str]) -> Self {
        let natural = &covariance.natural;
        let reference = stereo(natural).filter(|s| s.response(s, [0.0, 0.0]).is_some());
        let axes = natural.cam_from_rig.get(1).map(|m| AxesAngle::of(&m.rotation));
        let to_baseline = plane(natural).zip(baseline(natural)).map(|(p, b)| PlaneAngle::of(&p.normal.xyz, &b));
        let mut out = Self { list: vec![], rows: vec![], determined: vec![], reference, axes, to_baseline };
        let Some(values) = out.values(natural) else { return out };
        let labels = labels(natural, names, out.reference.is_some());
        let derivative = derivative(covariance, names, &|n| out.values(n)).unwrap_or_else(|| DMatrix::zeros(0, 0));
        for (k, ((name, unit), value)) in labels.into_iter().zip(values.iter()).enumerate() {
            if k >= derivative.nrows() {
                break;
            }
            let row = derivative.row(k).transpose();
            out.determined.push(covariance.stands_still(&row));
            let terms = covariance.names.iter().zip(row.iter()).filter(|(_, v)| **v != 0.0);
            out.rows.push(terms.map(|(n, v)| (n.clone(), *v)).collect());
            out.list.push(Key { name, unit, value: *value });
        }
        out
    }

    /// The values of another estimate of the same rig, in the same order.
    pub(super) fn values(&self, n: &Natural) -> Option<DVector<f64>> {
        let mut out = vec![];
        for camera in &n.cameras {
            let e = camera.effective_pinhole();
            out.extend([e.f_px, e.cx_px, e.cy_px]);
        }
        if let Some((motion, axes)) = n.cam_from_rig.get(1).zip(self.axes) {
            out.push(motion.translation_mm.norm());
            out.push(axes.of_neighbour(&motion.rotation).to_degrees());
        }
        if let Some(plane) = plane(n) {
            out.push(plane.distance_mm);
            let angle = self.to_baseline.zip(baseline(n)).map(|(a, b)| a.of_neighbour(&plane.normal.xyz, &b));
            out.extend(angle.map(f64::to_degrees));
        }
        if let Some(reference) = &self.reference {
            out.push(100.0 * stereo(n)?.response(reference, [0.0, 0.0])?.relative_gain());
        }
        Some(DVector::from_vec(out))
    }
}

fn labels(natural: &Natural, names: &[&str], gain: bool) -> Vec<(String, &'static str)> {
    let mut out: Vec<(String, &'static str)> = vec![];
    for name in names {
        for what in ["effective focal length", "effective principal point cx", "effective principal point cy"] {
            out.push((format!("{what} of camera {name}"), "px"));
        }
    }
    if natural.cam_from_rig.len() > 1 {
        out.push(("distance of the cameras".into(), "mm"));
        out.push(("angle between the lens axes".into(), "deg"));
    }
    if natural.rig_from_plane.is_some() {
        out.push((SHEET_QUANTITIES[0].into(), "mm"));
        if natural.cam_from_rig.len() > 1 {
            out.push((SHEET_QUANTITIES[1].into(), "deg"));
        }
    }
    if gain {
        out.push((SHEET_QUANTITIES[2].into(), "%"));
    }
    out
}

/// Derivatives of `f` (rows) by every name of the covariance (columns; zero for those that belong to views or the target), by central
/// differences; `None` where `f` has no value.
pub(super) fn derivative(
    covariance: &NamedCovariance,
    names: &[&str],
    f: &dyn Fn(&Natural) -> Option<DVector<f64>>,
) -> Option<DMatrix<f64>> {
    let natural = &covariance.natural;
    let own = [names.first().copied().unwrap_or_default(), names.get(1).copied().unwrap_or_default()];
    let f_px = [0, 1].map(|c| natural.cameras.get(c).map_or(1.0, |camera| camera.intrinsics().f_px));
    let mut out = DMatrix::zeros(f(natural)?.len(), covariance.names.len());
    for (column, name) in covariance.names.iter().enumerate() {
        let Some(parameter) = Parameter::of(name, own) else { continue };
        let h = parameter.step(f_px, distance_mm(natural));
        let at = |h: f64| f(&stepped(natural, parameter, h)?);
        out.set_column(column, &((at(h)? - at(-h)?) / (2.0 * h)));
    }
    Some(out)
}

fn stepped(natural: &Natural, parameter: Parameter, h: f64) -> Option<Natural> {
    let steps = ParameterSteps::one(parameter, h);
    let mut out = natural.clone();
    for (c, camera) in out.cameras.iter_mut().enumerate() {
        *camera = steps.camera(c, camera)?;
    }
    out.cam_from_rig.iter_mut().skip(1).for_each(|m| *m = steps.motion(m));
    out.rig_from_plane = out.rig_from_plane.map(|m| steps.sheet(&m));
    Some(out)
}

/// `tilt alpha of camera left` for `left.alpha_rad`, and the factor and unit in which it is shown.
pub(super) fn parameter_words(name: &str, names: &[&str]) -> (String, f64, &'static str) {
    const DEG: f64 = 180.0 / std::f64::consts::PI;
    let own = [names.first().copied().unwrap_or_default(), names.get(1).copied().unwrap_or_default()];
    let step = |k: usize, what: &str| {
        let axis = ["x", "y", "z"][k % 3];
        if k < 3 {
            (format!("turn of {what} about {axis}"), DEG, "deg")
        } else {
            (format!("shift of {what} along {axis}"), 1.0, "mm")
        }
    };
    match Parameter::of(name, own) {
        Some(Parameter::Intrinsic(c, k)) => {
            let words = crate::bundle::intrinsic_words(k);
            let (factor, unit) = intrinsic_unit(k);
            (format!("{words} of camera {}", own[c]), factor, unit)
        }
        Some(Parameter::Window(c, k)) if k < 3 => step(k, &format!("the window of camera {}", own[c])),
        Some(Parameter::Window(c, k)) => {
            let unit = if k < 5 { "mm" } else { "" };
            (format!("{} of the window of camera {}", crate::bundle::layer_words(k - 3), own[c]), 1.0, unit)
        }
        Some(Parameter::Motion(k)) => step(k, &format!("camera {}", own[1])),
        Some(Parameter::Sheet(k)) => step(k, "the sheet"),
        None => (name.into(), 1.0, ""),
    }
}

/// Factor and unit in which an intrinsic is shown.
pub(super) fn intrinsic_unit(k: usize) -> (f64, &'static str) {
    match INTRINSIC_NAMES[k] {
        n if n.ends_with("_rad") => (180.0 / std::f64::consts::PI, "deg"),
        n if n.ends_with("_px") => (1.0, "px"),
        _ => (1.0, ""),
    }
}
