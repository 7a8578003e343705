//! Numbers of a record that say the same twice, and signs that no number of its kind can have.

use super::check::{Check, fault};
use super::schema::{Effective, Record, Rig, Sheet};
use crate::camera::EffectivePinhole;
use crate::frames::{self, Cam};
use crate::rigid::rotation_exp;
use crate::target::TargetKind;
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// Files written with five digits agree to this, relative to lengths and in sines and cosines of angles.
const ROUNDING: f64 = 1e-4;

/// Value of `target.kind` where a calibration comes from another package.
const NO_TARGET: &str = "none";

pub(super) fn check(r: &Record) -> Check {
    let second = r.cameras.get(1).map(|c| &c.cam_from_rig).map(|p| p.motion::<Cam, frames::Rig>());
    if let (Some(rig), Some(second)) = (&r.rig, &second) {
        check_rig(rig, second.translation_mm.norm(), second.rotation.m33)?;
    }
    if let Some(sheet) = &r.sheet {
        check_angles(sheet, second.map(|m| m.inverse().translation_mm))?;
    }
    let kinds = TargetKind::WORDS.map(|(word, _)| word);
    if !kinds.iter().chain([&NO_TARGET]).any(|kind| *kind == r.target.kind) {
        let kinds = kinds.join(", ");
        let message = format!("\"{}\" is no kind of target: expected one of {kinds}, {NO_TARGET}", r.target.kind);
        return fault("target.kind", message);
    }
    check_views(r)?;
    let parts = json!({
        "cameras": r.cameras, "rig": r.rig, "sheet": r.sheet, "target": r.target, "scale": r.scale, "views": r.views,
        "fit": r.fit, "mapping_uncertainty": r.mapping_uncertainty,
    });
    check_signs(&parts, "", Sign::Any)
}

/// Every view once, in the order of the rig file, and those of the sheet among them.
fn check_views(r: &Record) -> Check {
    let mut indices = BTreeSet::new();
    for (i, v) in r.views.iter().enumerate() {
        let last = indices.last().copied();
        if !indices.insert(v.index) {
            return fault(format!("views[{i}].index"), format!("{} occurs twice: expected different numbers", v.index));
        }
        if let Some(last) = last.filter(|last| *last > v.index) {
            let message = format!("{} after {last}: expected the views in the order of the rig file", v.index);
            return fault(format!("views[{i}].index"), message);
        }
    }
    let of_sheet = r.sheet.iter().flat_map(|s| s.views.iter().enumerate());
    match of_sheet.into_iter().find(|(_, view)| !indices.contains(view)) {
        None => Ok(()),
        Some((i, view)) => {
            fault(format!("sheet.views[{i}]"), format!("no view has the index {view}: expected one of views[].index"))
        }
    }
}

/// The effective pinhole that a file states against that of the camera model; an image distance of 0 states none.
pub(super) fn check_effective(stated: &Effective, model: &EffectivePinhole, at: &str) -> Check {
    if stated.f_px == 0.0 {
        return Ok(());
    }
    let all =
        [("f_px", stated.f_px, model.f_px), ("cx_px", stated.cx_px, model.cx_px), ("cy_px", stated.cy_px, model.cy_px)];
    for (key, x, expected) in all {
        if x.is_finite() && (x - expected).abs() > ROUNDING * (model.f_px.abs() + expected.abs()) {
            let message = format!("{x} contradicts f, principal point and tilt of the camera: expected {expected}");
            return fault(format!("{at}.effective.{key}"), message);
        }
    }
    Ok(())
}

fn check_rig(rig: &Rig, baseline_mm: f64, cosine: f64) -> Check {
    if !((rig.baseline_mm - baseline_mm).abs() <= ROUNDING * baseline_mm) {
        let message =
            format!("{} contradicts cam_from_rig of the second camera: expected {baseline_mm}", rig.baseline_mm);
        return fault("rig.baseline_mm", message);
    }
    if !((rig.axes_angle_deg.to_radians().cos() - cosine).abs() <= ROUNDING) {
        let expected = cosine.clamp(-1.0, 1.0).acos().to_degrees();
        let message =
            format!("{} contradicts cam_from_rig of the second camera: expected {expected}", rig.axes_angle_deg);
        return fault("rig.axes_angle_deg", message);
    }
    Ok(())
}

fn check_angles(s: &Sheet, second_center_mm: Option<Vector3<f64>>) -> Check {
    let [a, b, c] = s.angles_deg.map(f64::to_radians);
    let turn =
        rotation_exp(&(Vector3::x() * a)) * rotation_exp(&(Vector3::y() * b)) * rotation_exp(&(Vector3::z() * c));
    let stated = Matrix3::from_fn(|i, j| s.rig_from_sheet.rotation[i][j]);
    let half_turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let gap = [turn, turn * half_turn].map(|t| (t - stated).abs().max());
    if !(gap[0].min(gap[1]) <= ROUNDING) {
        let message = format!(
            "their rotation differs from rig_from_sheet by {:.1e}, with and without the half turn: expected the same",
            gap[0].min(gap[1])
        );
        return fault("sheet.angles_deg", message);
    }
    // A view of one camera has no baseline.
    let Some(center) = second_center_mm.filter(|c| c.norm() > 0.0 && s.angle_to_baseline_deg.is_finite()) else {
        return Ok(());
    };
    let sine = Vector3::from(s.normal_in_rig).dot(&center.normalize()).abs();
    if (s.angle_to_baseline_deg.to_radians().sin().abs() - sine).abs() > ROUNDING {
        let message = format!(
            "{} contradicts normal_in_rig and the cameras: expected {}",
            s.angle_to_baseline_deg,
            sine.min(1.0).asin().to_degrees()
        );
        return fault("sheet.angle_to_baseline_deg", message);
    }
    Ok(())
}

/// What a number may be.
#[derive(Clone, Copy)]
enum Sign {
    Any,
    NotNegative,
    Positive,
}

impl Sign {
    /// Of the values under a key; standard deviations hold everything below them.
    fn of(self, key: &str) -> Self {
        let word = |wanted: &str| key.split('_').any(|w| w == wanted);
        match self {
            Sign::NotNegative => self,
            _ if word("sigma") || word("rms") => Sign::NotNegative,
            _ if ["radii_mm", "spacing_mm", "pixel_pitch_mm"].contains(&key) => Sign::Positive,
            _ => Sign::Any,
        }
    }
}

fn check_signs(value: &Value, at: &str, sign: Sign) -> Check {
    match value {
        Value::Object(map) => map.iter().try_for_each(|(key, v)| {
            let path = if at.is_empty() { key.clone() } else { format!("{at}.{key}") };
            check_signs(v, &path, sign.of(key))
        }),
        Value::Array(list) => {
            list.iter().enumerate().try_for_each(|(i, v)| check_signs(v, &format!("{at}[{i}]"), sign))
        }
        Value::Number(n) => match (sign, n.as_f64().unwrap_or(f64::NAN)) {
            (Sign::NotNegative, x) if x < 0.0 => fault(at, format!("{x} is not possible: expected 0 or more")),
            (Sign::Positive, x) if x <= 0.0 => fault(at, format!("{x} is not possible: expected a number above 0")),
            _ => Ok(()),
        },
        _ => Ok(()),
    }
}
