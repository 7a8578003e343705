//! The covariance against the numbers beside it: names that are none, variances that say otherwise than standard deviations.

use super::check::{Check, fault};
use super::schema::{Covariance, Record};
use super::sigma::{PoseSigma, TargetSigma};
use crate::camera::{INTRINSIC_NAMES, WINDOW_STEP_NAMES};
use crate::rigid::STEP_NAMES;
use std::collections::{HashMap, HashSet};

/// Files written with five digits agree to this.
const ROUNDING: f64 = 1e-4;

/// What a covariance may name.
struct Number {
    /// Name in the covariance.
    name: String,
    /// Path of its standard deviation in the file.
    path: String,
    /// Its standard deviation; unknown where the file has no place for it.
    sigma: f64,
}

pub(super) fn check(r: &Record) -> Check {
    let c = &r.covariance;
    // Whoever took the covariance away states that nothing is known of what goes together.
    if c.names.is_empty() {
        return Ok(());
    }
    let numbers = numbers(r);
    let at: HashMap<&str, usize> = c.names.iter().enumerate().map(|(i, n)| (n.as_str(), i)).collect();
    check_names(c, &at, &numbers)?;
    let known = numbers.iter().filter(|n| n.sigma.is_finite());
    known.filter_map(|n| at.get(n.name.as_str()).map(|i| (*i, n))).try_for_each(|(i, n)| check_variance(c, i, n))
}

fn check_names(c: &Covariance, at: &HashMap<&str, usize>, numbers: &[Number]) -> Check {
    let possible: HashSet<&str> = numbers.iter().map(|n| n.name.as_str()).collect();
    if let Some(i) = c.names.iter().position(|n| !possible.contains(n.as_str())) {
        let example = numbers.first().map_or("left.f_px", |n| n.name.as_str());
        let message = format!(
            "\"{}\" is no number of this calibration: expected owner and quantity, such as \"{example}\", \"sheet.rig_from_sheet.rx_rad\"",
            c.names[i]
        );
        return fault(format!("covariance.names[{i}]"), message);
    }
    if let Some(i) = c.undetermined.iter().position(|n| !at.contains_key(n.as_str())) {
        let message = format!("\"{}\" is not among covariance.names: expected one of them", c.undetermined[i]);
        return fault(format!("covariance.undetermined[{i}]"), message);
    }
    Ok(())
}

fn check_variance(c: &Covariance, i: usize, n: &Number) -> Check {
    let by_matrix = c.known(i, i).sqrt();
    // What is not determined has none, and of 0 nothing is stated beside the matrix.
    if !by_matrix.is_finite() || n.sigma == 0.0 || (by_matrix - n.sigma).abs() <= ROUNDING * by_matrix.max(n.sigma) {
        return Ok(());
    }
    let message = format!(
        "variance of {} is {:?}, which contradicts {} = {:?}: expected {:?}",
        n.name,
        c.matrix[i][i],
        n.path,
        n.sigma,
        n.sigma * n.sigma
    );
    fault(format!("covariance.matrix[{i}]"), message)
}

/// All that the covariance of a record may name.
fn numbers(r: &Record) -> Vec<Number> {
    let mut out = vec![];
    let mut add = |group: &str, quantity: &str, path: String, sigma: f64| {
        out.push(Number { name: format!("{group}.{quantity}"), path, sigma });
    };
    for (i, c) in r.cameras.iter().enumerate() {
        let s = &c.sigma;
        let own = [s.f_px, s.aspect, s.cx_px, s.cy_px, s.alpha_rad, s.beta_rad, s.k1, s.k2, s.k3, s.pupil_ratio];
        for (q, x) in INTRINSIC_NAMES.iter().zip(own) {
            add(&c.name, q, format!("cameras[{i}].sigma.{q}"), x);
        }
        if let Some(w) = &c.window {
            let (s, [rx, ry, rz]) = (&w.sigma, w.sigma.normal_rad);
            let own = [rx, ry, rz, s.distance_mm, s.thickness_mm, s.n_air, s.n_glass, s.n_water];
            for (k, (q, x)) in WINDOW_STEP_NAMES.iter().zip(own).enumerate() {
                let key = if k < 3 { format!("normal_rad[{k}]") } else { (*q).to_string() };
                add(&format!("{}.window", c.name), q, format!("cameras[{i}].window.sigma.{key}"), x);
            }
        }
        if i > 0 {
            let at = format!("cameras[{i}].sigma.cam_from_rig");
            add_pose(&mut add, &format!("{}.cam_from_rig", c.name), &at, &s.cam_from_rig);
        }
    }
    add_pose(&mut add, "sheet.rig_from_sheet", "sheet.sigma", &PoseSigma::default());
    add_shape(&mut add, "target", "target.sigma", Some(&r.target.sigma));
    for (k, v) in r.views.iter().enumerate() {
        let (owner, at) = (format!("view{}", v.index), format!("views[{k}]"));
        add_pose(&mut add, &format!("{owner}.rig_from_target"), &format!("{at}.sigma"), &v.sigma);
        let z_sigma = v.plane_z_sigma_mm.unwrap_or(f64::NAN);
        add(&owner, "plane_z_mm", format!("{at}.plane_z_sigma_mm"), z_sigma);
        add_shape(&mut add, &owner, &format!("{at}.target.sigma"), v.target.as_ref().map(|t| &t.sigma));
    }
    out
}

type Add<'a> = dyn FnMut(&str, &str, String, f64) + 'a;

fn add_pose(add: &mut Add, group: &str, at: &str, s: &PoseSigma) {
    let [[rx, ry, rz], [tx, ty, tz]] = [s.rotation_rad, s.translation_mm];
    for (k, (step, x)) in STEP_NAMES.iter().zip([rx, ry, rz, tx, ty, tz]).enumerate() {
        let key = if k < 3 { "rotation_rad" } else { "translation_mm" };
        add(group, step, format!("{at}.{key}[{}]", k % 3), x);
    }
}

/// Distance and radii of a pair, pitch, radius and step of a grid.
fn add_shape(add: &mut Add, group: &str, at: &str, s: Option<&TargetSigma>) {
    let radius = |k: usize, wanted: usize| {
        let radii = s.map(|s| &s.radii_mm).filter(|r| r.len() == wanted);
        radii.map_or(f64::NAN, |r| r[k])
    };
    add(group, "spacing_mm", format!("{at}.spacing_mm"), s.map_or(f64::NAN, |s| s.spacing_mm));
    add(group, "step_mm", format!("{at}.step_mm"), s.and_then(|s| s.step_mm).unwrap_or(f64::NAN));
    add(group, "radius_mm", format!("{at}.radii_mm[0]"), radius(0, 1));
    for k in 0..2 {
        add(group, &format!("radius{k}_mm"), format!("{at}.radii_mm[{k}]"), radius(k, 2));
    }
}
