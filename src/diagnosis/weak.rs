//! Directions that the images hardly determine, named.
//!
//! The covariance of cameras, motion and sheet, each number in units of half a percent or 5 mrad, has principal directions; those
//! along which one standard deviation exceeds one unit are weak. Directions that nothing determines come first, without a sigma.

use super::digits;
use super::keys::{Keys, parameter_words};
use crate::bundle::{NamedCovariance, Parameter, listed, symmetric_eigen};
use crate::record::NearNull;
use nalgebra::{DMatrix, DVector};

/// Weak directions named at most, beside those that nothing determines.
const MOST: usize = 6;
/// Parameters with less than this part of the largest one are not named.
const PART: f64 = 0.2;

pub(super) fn near_null(covariance: &NamedCovariance, names: &[&str], keys: &Keys) -> Vec<NearNull> {
    let cameras = [0, 1].map(|c| names.get(c).copied().unwrap_or_default());
    let of_rig = |i: &usize| Parameter::of(&covariance.names[*i], cameras).is_some();
    let own: Vec<(usize, f64)> = (0..covariance.names.len()).filter(of_rig).map(|i| (i, covariance.scale[i])).collect();
    let mut out = vec![];
    for direction in covariance.null_directions.column_iter() {
        let d = DVector::from_fn(own.len(), |i, _| direction[own[i].0] / own[i].1);
        if d.amax() > 0.0 {
            out.push(named(covariance, names, keys, &own, &d.normalize(), f64::NAN));
        }
    }
    let scaled =
        DMatrix::from_fn(own.len(), own.len(), |i, j| covariance.matrix[(own[i].0, own[j].0)] / (own[i].1 * own[j].1));
    let Some(eigen) = symmetric_eigen(&scaled) else { return out };
    for k in (0..own.len()).rev().take(MOST) {
        let sigma = eigen.values[k].max(0.0).sqrt();
        if sigma > 1.0 {
            out.push(named(covariance, names, keys, &own, &eigen.vectors.column(k).into_owned(), sigma));
        }
    }
    out
}

fn named(
    covariance: &NamedCovariance,
    names: &[&str],
    keys: &Keys,
    own: &[(usize, f64)],
    direction: &DVector<f64>,
    sigma: f64,
) -> NearNull {
    let mut order: Vec<usize> = (0..own.len()).filter(|i| direction[*i].abs() > PART * direction.amax()).collect();
    order.sort_by(|a, b| direction[*b].abs().total_cmp(&direction[*a].abs()).then(a.cmp(b)));
    order.truncate(6);
    // The sign of an eigenvector is arbitrary: the largest part grows.
    let sign = direction[order.first().copied().unwrap_or(0)].signum();
    let length = if sigma.is_finite() { sigma } else { 1.0 };
    let parts: Vec<String> = order
        .iter()
        .map(|&i| {
            let (what, factor, unit) = parameter_words(&covariance.names[own[i].0], names);
            let by = sign * direction[i] * length * own[i].1 * factor;
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            format!("{what} by {}{}{unit}", if by < 0.0 { "" } else { "+" }, digits(by, 2))
        })
        .collect();
    // What a user would feel of it.
    let gain = keys.list.iter().position(|k| k.name == "out-of-plane gain").map(|k| {
        let along = |i: &usize| {
            let coefficient = keys.rows[k].iter().find(|(n, _)| *n == covariance.names[own[*i].0]).map_or(0.0, |t| t.1);
            coefficient * direction[*i] * length * own[*i].1
        };
        (0..own.len()).map(|i| along(&i)).sum::<f64>().abs()
    });
    let moves = if parts.len() > 1 { "move together" } else { "may move" };
    let felt = gain.map_or(String::new(), |g| format!("; the out-of-plane gain changes by {} % with it", digits(g, 2)));
    let words = if sigma.is_finite() {
        format!(
            "the images hardly tell these apart, they {moves} within one standard deviation: {}{felt}",
            listed(&parts)
        )
    } else {
        format!(
            "nothing determines this direction, its numbers may {} as far as you like, in these proportions: {}{felt}",
            if parts.len() > 1 { "move together" } else { "move" },
            listed(&parts)
        )
    };
    NearNull {
        words,
        names: order.iter().map(|&i| covariance.names[own[i].0].clone()).collect(),
        components: order.iter().map(|&i| sign * direction[i]).collect(),
        sigma,
    }
}
