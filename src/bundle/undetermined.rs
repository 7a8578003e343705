//! What is not determined, in words.

use super::model::Model;
use super::posterior::{NamedCovariance, ParameterKnowledge, ROUNDED};
use crate::camera::INTRINSIC_NAMES;
use nalgebra::DVectorView;

/// Posterior variance over prior variance from which on a number is known from its prior only: nine tenths of its sigma are left.
pub(crate) const ONLY_PRIOR: f64 = 0.81;
/// The same for mostly: the images know less than it.
pub(crate) const MOSTLY_PRIOR: f64 = 0.5;

/// The view that a direction belongs to, where it moves numbers of that view alone; `direction` in the order of the names.
pub(crate) fn view_of_direction<'a>(names: &[String], direction: impl IntoIterator<Item = &'a f64>) -> Option<usize> {
    let mut moved = names.iter().zip(direction).filter(|(_, d)| **d != 0.0).map(|(n, _)| view_of(n));
    let first = moved.next()??;
    moved.all(|v| v == Some(first)).then_some(first)
}

/// The view that a number belongs to; cameras may have any name.
fn view_of(name: &str) -> Option<usize> {
    let (view, what) = name.strip_prefix("view")?.split_once('.')?;
    let own = ["rig_from_target.", "plane_z_mm", "spacing_mm", "radius", "step_mm"];
    own.iter().any(|o| what.starts_with(o)).then(|| view.parse().ok())?
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
    let directions = &covariance.null_directions;
    let shared = |i: usize| {
        let mut others = directions.column_iter().filter(|d| view_of_direction(&covariance.names, d.iter()).is_none());
        others.any(|d| moves(covariance, &d, i))
    };
    let of_view = |i: usize| by_themselves.iter().any(|(_, own)| own.contains(&i)) && !shared(i);
    let names = &covariance.names;
    let other = (0..names.len()).filter(|i| !covariance.determined[*i] && !of_intrinsic(&names[*i]) && !of_view(*i));
    out.extend(other.map(|i| format!("{} is not determined", names[i])));
    let mut open: Vec<(String, Vec<usize>)> = vec![];
    for (v, own) in &by_themselves {
        let what = open_of_target(&own.iter().map(|i| names[*i].clone()).collect::<Vec<_>>());
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

/// Views with directions of their own, each with the numbers that move along these.
fn views_by_themselves(covariance: &NamedCovariance) -> Vec<(usize, Vec<usize>)> {
    let mut out: Vec<(usize, Vec<usize>)> = vec![];
    for d in covariance.null_directions.column_iter() {
        let Some(view) = view_of_direction(&covariance.names, d.iter()) else { continue };
        let moves = (0..d.len()).filter(|i| moves(covariance, &d, *i));
        match out.iter_mut().find(|(v, _)| *v == view) {
            Some((_, numbers)) => numbers.extend(moves),
            None => out.push((view, moves.collect())),
        }
    }
    out
}

/// Whether a direction moves a number by more than rounding.
fn moves(covariance: &NamedCovariance, direction: &DVectorView<'_, f64>, i: usize) -> bool {
    direction[i].abs() > ROUNDED * covariance.scale[i]
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

/// How round two printed discs are, where images do not tell.
pub(super) fn of_ovals(assumed_mm: f64) -> String {
    format!(
        "how round the two printed discs are is not determined: they are taken for ovals of {:.0} um (standard deviation), which the standard deviations of \
         all numbers hold; views tilted about other axes, or a second camera, would tell",
        1000.0 * assumed_mm
    )
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
