//! What is not determined, in words.

use super::model::Model;
use super::posterior::{NamedCovariance, ParameterKnowledge};
use crate::camera::INTRINSIC_NAMES;

/// Posterior variance over prior variance from which on a number is known from its prior only: nine tenths of its sigma are left.
pub(crate) const ONLY_PRIOR: f64 = 0.81;
/// The same for mostly: the images know less than it.
pub(crate) const MOSTLY_PRIOR: f64 = 0.5;

/// The view that a direction belongs to, where it moves numbers of that view alone; `direction` in the order of the names.
pub(crate) fn view_of_direction<'a>(names: &[String], direction: impl IntoIterator<Item = &'a f64>) -> Option<usize> {
    let view = |name: &str| name.strip_prefix("view")?.split_once('.')?.0.parse().ok();
    let mut moved = names.iter().zip(direction).filter(|(_, d)| **d != 0.0).map(|(n, _)| view(n));
    let first = moved.next()??;
    moved.all(|v| v == Some(first)).then_some(first)
}

/// Undetermined and prior-dominated parameters.
pub(super) fn words(model: &Model, covariance: &NamedCovariance) -> Vec<String> {
    let mut out = vec![];
    for (c, camera) in model.cameras.iter().enumerate() {
        for (k, know) in covariance.intrinsics[c].iter().enumerate() {
            let what = intrinsic_words(k);
            match know {
                ParameterKnowledge::Undetermined => out
                    .push(format!("{what} of camera {} is not determined by the images or by any prior", camera.name)),
                ParameterKnowledge::Estimated { prior_share } if *prior_share > MOSTLY_PRIOR => {
                    let most = if *prior_share > ONLY_PRIOR { "only" } else { "mostly" };
                    out.push(format!("{what} of camera {} is known {most} from its prior", camera.name));
                }
                _ => {}
            }
        }
    }
    let of_intrinsic =
        |n: &str| model.cameras.iter().any(|c| INTRINSIC_NAMES.iter().any(|i| n == format!("{}.{i}", c.name)));
    let by_themselves = views_by_themselves(covariance);
    let of_view = |n: &str| by_themselves.iter().any(|(_, names)| names.iter().any(|own| own == n));
    let other =
        covariance.names.iter().zip(&covariance.determined).filter(|(n, d)| !**d && !of_intrinsic(n) && !of_view(n));
    out.extend(other.map(|(n, _)| format!("{n} is not determined")));
    let mut open: Vec<(String, Vec<usize>)> = vec![];
    for (v, names) in &by_themselves {
        let what = open_of_target(names);
        match open.iter_mut().find(|(other, _)| *other == what) {
            Some((_, views)) => views.push(*v),
            None => open.push((what, vec![*v])),
        }
    }
    out.extend(open.iter().map(|(what, views)| {
        let of = if views.len() == 1 { "the target of view" } else { "the targets of views" };
        let listed = listed(&views.iter().map(usize::to_string).collect::<Vec<_>>());
        format!("{what} of {of} {listed}: not determined, and no other number depends on it")
    }));
    out
}

/// Views with directions of their own, each with the numbers that no other direction leaves undetermined.
fn views_by_themselves(covariance: &NamedCovariance) -> Vec<(usize, Vec<String>)> {
    let directions: Vec<_> = covariance.null_directions.column_iter().collect();
    let own: Vec<Option<usize>> = directions.iter().map(|d| view_of_direction(&covariance.names, d.iter())).collect();
    let shared = |i: usize| directions.iter().zip(&own).any(|(d, own)| own.is_none() && d[i] != 0.0);
    let mut views: Vec<usize> = own.iter().flatten().copied().collect();
    views.dedup();
    let names = |v: usize| {
        let prefix = format!("view{v}.");
        let all =
            covariance.names.iter().enumerate().filter(|(i, n)| n.starts_with(&prefix) && !covariance.determined[*i]);
        all.filter(|(i, _)| !shared(*i)).map(|(_, n)| n.clone()).collect()
    };
    views.into_iter().map(|v| (v, names(v))).collect()
}

/// What one view leaves open by itself, from the names of those numbers.
fn open_of_target(names: &[String]) -> String {
    let any = |part: &str| names.iter().any(|n| n.contains(part));
    let place = any("_from_target.t") || any(".plane_z");
    let turn = names.iter().any(|n| n.ends_with("_rad"));
    let size = any("spacing") || any("radius") || any(".step");
    let parts = [(place, "place"), (turn, "direction"), (size, "size")];
    listed(&parts.iter().filter(|p| p.0).map(|p| p.1.to_owned()).collect::<Vec<_>>())
}

/// A list in words.
pub(crate) fn listed(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// An intrinsic parameter in words, by its index in [`INTRINSIC_NAMES`].
pub(crate) fn intrinsic_words(k: usize) -> &'static str {
    [
        "focal length f",
        "pixel aspect",
        "axis point cx",
        "axis point cy",
        "tilt alpha",
        "tilt beta",
        "distortion k1",
        "distortion k2",
        "distortion k3",
        "pupil ratio",
    ][k]
}

/// A layer of a window in words, by its index in [`crate::camera::LAYER_NAMES`].
pub(crate) fn layer_words(k: usize) -> &'static str {
    ["distance", "thickness", "index before the glass", "index of the glass", "index behind the glass"][k]
}
