//! Tables: one number per row with its name, unit and standard deviation, and the covariance.
//!
//! Cameras and their windows, the sheet, poses of the views and their residuals. Sigmas of a pose's numbers follow from the covariance of its
//! left step (w, v), empty where the record does not determine it:
//! ```text
//! dR = [w] R,   dt = w x t + v
//! ```
//! Not in the tables: target, scale, baseline, fit and its diagnosis, uncertainty of the mapping, provenance. They are in calibration.json.

use super::Conversion;
use crate::record::{Covariance, Pose, Radial, Record};
use crate::report::csv_field as field;
use crate::rigid::{STEP_NAMES, skew};
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector3};
use std::fmt::Write;

/// A number; empty where it does not exist.
fn number(x: f64) -> String {
    if x.is_finite() { x.to_string() } else { String::new() }
}

/// Standard deviation of a variance, which rounding may leave a little below 0.
fn root(variance: f64) -> f64 {
    if variance < 0.0 { 0.0 } else { variance.sqrt() }
}

struct Table(String);

impl Table {
    fn new() -> Self {
        Self("owner,quantity,value,sigma,unit\n".into())
    }
    fn row(&mut self, owner: &str, quantity: &str, value: f64, sigma: f64, unit: &str) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.0, "{},{quantity},{},{},{unit}", field(owner), number(value), number(sigma));
    }
    /// Numbers of a pose; `known` is the covariance of its left step, 1 and mm.
    fn pose(&mut self, owner: &str, name: &str, pose: &Pose, known: &Matrix6<f64>) {
        let sigmas = |by_step: Matrix3x6<f64>| (by_step * known * by_step.transpose()).diagonal().map(root);
        let turned = |x: &Vector3<f64>| {
            let mut by_step = Matrix3x6::zeros();
            by_step.fixed_view_mut::<3, 3>(0, 0).copy_from(&-skew(x));
            by_step
        };
        let rotation = Matrix3::from_fn(|i, j| pose.rotation[i][j]);
        let columns = [0, 1, 2].map(|j| sigmas(turned(&rotation.column(j).into_owned())));
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            self.row(owner, &format!("{name}.r{}{}", i + 1, j + 1), rotation[(i, j)], columns[j][i], "1");
        }
        let mut moved = turned(&Vector3::from(pose.translation_mm));
        moved.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        for ((axis, x), sigma) in ["tx", "ty", "tz"].iter().zip(pose.translation_mm).zip(sigmas(moved).iter()) {
            self.row(owner, &format!("{name}.{axis}"), x, *sigma, "mm");
        }
    }
}

/// Covariance of the left step of a pose; `NaN` where the record does not state it, 0 where the pose is the frame's own.
fn of_step(c: &Covariance, prefix: &str, fixed: bool) -> Matrix6<f64> {
    let rows: Option<Vec<usize>> = STEP_NAMES.iter().map(|step| c.index(&format!("{prefix}.{step}"))).collect();
    match rows {
        Some(rows) => Matrix6::from_fn(|i, j| c.known(rows[i], rows[j])),
        None => Matrix6::repeat(if fixed { 0.0 } else { f64::NAN }),
    }
}

fn cameras(record: &Record) -> String {
    let mut t = Table::new();
    for (index, c) in record.cameras.iter().enumerate() {
        let (o, s) = (c.name.as_str(), &c.sigma);
        t.row(o, "image_width", c.image_size_px[0] as f64, f64::NAN, "px");
        t.row(o, "image_height", c.image_size_px[1] as f64, f64::NAN, "px");
        t.row(o, "pixel_pitch", c.pixel_pitch_mm.unwrap_or(f64::NAN), f64::NAN, "mm");
        t.row(o, "f", c.f_px, s.f_px, "px");
        t.row(o, "aspect", c.aspect, s.aspect, "1");
        t.row(o, "cx", c.cx_px, s.cx_px, "px");
        t.row(o, "cy", c.cy_px, s.cy_px, "px");
        t.row(o, "alpha", c.alpha_rad, s.alpha_rad, "rad");
        t.row(o, "beta", c.beta_rad, s.beta_rad, "rad");
        for (name, x, sigma) in [("k1", c.k1, s.k1), ("k2", c.k2, s.k2), ("k3", c.k3, s.k3)] {
            t.row(o, name, x, sigma, "1");
        }
        let from_ideal = c.radial == Radial::default();
        t.row(o, "k_from_ideal_to_distorted", f64::from(u8::from(from_ideal)), f64::NAN, "1");
        t.row(o, "pupil_ratio", c.pupil_ratio, s.pupil_ratio, "1");
        t.row(o, "effective.f", c.effective.f_px, s.effective.f_px, "px");
        t.row(o, "effective.cx", c.effective.cx_px, s.effective.cx_px, "px");
        t.row(o, "effective.cy", c.effective.cy_px, s.effective.cy_px, "px");
        t.row(o, "rms", c.rms_px, f64::NAN, "px");
        // The first camera is the rig's frame, wherever anything is known.
        let fixed = index == 0 && !record.covariance.names.is_empty();
        t.pose(o, "cam_from_rig", &c.cam_from_rig, &of_step(&record.covariance, &format!("{o}.cam_from_rig"), fixed));
        if let Some(w) = &c.window {
            for (i, name) in ["x", "y", "z"].iter().enumerate() {
                t.row(o, &format!("window.normal_{name}"), w.normal_in_cam[i], f64::NAN, "1");
            }
            // What is known of the normal: turns about the axes of the camera, by which it is off.
            for (i, name) in ["x", "y", "z"].iter().enumerate() {
                t.row(o, &format!("window.turn_{name}"), 0.0, w.sigma.normal_rad[i], "rad");
            }
            t.row(o, "window.distance", w.distance_mm, w.sigma.distance_mm, "mm");
            t.row(o, "window.thickness", w.thickness_mm, w.sigma.thickness_mm, "mm");
            for (name, x, sigma) in [
                ("n_air", w.n_air, w.sigma.n_air),
                ("n_glass", w.n_glass, w.sigma.n_glass),
                ("n_water", w.n_water, w.sigma.n_water),
            ] {
                t.row(o, &format!("window.{name}"), x, sigma, "1");
            }
        }
    }
    t.0
}

fn sheet(record: &Record) -> Option<String> {
    let s = record.sheet.as_ref()?;
    let mut t = Table::new();
    t.row("sheet", "distance", s.distance_mm, s.sigma.distance_mm, "mm");
    for (i, name) in ["a", "b", "c"].iter().enumerate() {
        t.row("sheet", name, s.abc_per_mm[i], s.sigma.abc_per_mm[i], "1/mm");
    }
    let known = of_step(&record.covariance, "sheet.rig_from_sheet", false);
    // The normal is the third axis of that pose, or its opposite: a turn w moves it by w x n.
    let by_turn = skew(&Vector3::from(s.normal_in_rig));
    let normal = (by_turn * known.fixed_view::<3, 3>(0, 0) * by_turn.transpose()).diagonal();
    for (i, name) in ["normal_x", "normal_y", "normal_z"].iter().enumerate() {
        t.row("sheet", name, s.normal_in_rig[i], root(normal[i]), "1");
    }
    // And what is known of it as turns about the sheet's own axes, by which it is off.
    for (name, sigma) in ["turn_x", "turn_y"].iter().zip(s.sigma.normal_rad) {
        t.row("sheet", name, 0.0, sigma, "rad");
    }
    for (i, x) in s.angles_deg.iter().enumerate() {
        t.row("sheet", &format!("theta{}", i + 1), *x, s.sigma.angles_deg[i], "deg");
    }
    t.row("sheet", "angle_to_baseline", s.angle_to_baseline_deg, s.sigma.angle_to_baseline_deg, "deg");
    t.pose("sheet", "rig_from_sheet", &s.rig_from_sheet, &known);
    Some(t.0)
}

fn views(record: &Record) -> String {
    let mut t = Table::new();
    for v in &record.views {
        let owner = format!("view{}", v.index);
        t.row(&owner, "in_sheet", f64::from(u8::from(v.in_sheet)), f64::NAN, "1");
        for (camera, rms) in &v.rms_px {
            t.row(&owner, &field(&format!("rms.{camera}")), *rms, f64::NAN, "px");
        }
        if let Some(pose) = &v.rig_from_target {
            t.pose(
                &owner,
                "rig_from_target",
                pose,
                &of_step(&record.covariance, &format!("{owner}.rig_from_target"), false),
            );
        }
    }
    t.0
}

fn covariance(record: &Record) -> String {
    let c = &record.covariance;
    let mut out = String::from("name");
    c.names.iter().for_each(|n| out += &format!(",{}", field(n)));
    out.push('\n');
    for (i, name) in c.names.iter().enumerate() {
        out += &field(name);
        (0..c.names.len()).for_each(|j| out += &format!(",{}", number(c.known(i, j))));
        out.push('\n');
    }
    out
}

/// `cameras.csv`, `sheet.csv`, `views.csv`, `covariance.csv`.
pub(super) fn export(record: &Record) -> Conversion<Vec<(String, Vec<u8>)>> {
    let mut result = vec![("cameras.csv".to_string(), cameras(record).into_bytes())];
    result.extend(sheet(record).map(|t| ("sheet.csv".to_string(), t.into_bytes())));
    result.push(("views.csv".into(), views(record).into_bytes()));
    result.push(("covariance.csv".into(), covariance(record).into_bytes()));
    let losses = vec![super::Loss::NONE; record.cameras.len()];
    Conversion::of(result, losses, Vec::new())
}
