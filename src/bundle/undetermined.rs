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

/// Undetermined and prior-dominated parameters: a sentence for what belongs together.
pub(super) fn words(model: &Model, covariance: &NamedCovariance) -> Vec<String> {
    let mut out = vec![];
    for (c, camera) in model.cameras.iter().enumerate() {
        let mut open = vec![];
        for (k, know) in covariance.intrinsics[c].iter().enumerate() {
            let what = intrinsic_words(k);
            match know {
                ParameterKnowledge::Undetermined => open.push(what.to_owned()),
                ParameterKnowledge::Estimated { prior_share } if *prior_share > MOSTLY_PRIOR => {
                    let most = if *prior_share > ONLY_PRIOR { "only" } else { "mostly" };
                    out.push(format!("{what} of camera {} is known {most} from its prior", camera.name));
                }
                _ => {}
            }
        }
        if !open.is_empty() {
            let (what, are) = (listed(&open), is_or_are(open.len()));
            out.push(format!("{what} of camera {} {are} not determined by the images or by any prior", camera.name));
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
    out.extend(grouped(&other.map(|i| names[i].as_str()).collect::<Vec<_>>()));
    let own = by_themselves.iter().map(|(v, own)| (*v, own.iter().map(|i| names[*i].as_str()).collect()));
    let alone = of_targets(own.collect());
    out.extend(alone.iter().map(|(what, _)| format!("{what}: not determined, and no other number depends on it")));
    out
}

fn is_or_are(count: usize) -> &'static str {
    if count == 1 { "is" } else { "are" }
}

/// Numbers that are open, in a sentence for each camera, the sheet, the targets of the views, and the rest.
fn grouped(names: &[&str]) -> Vec<String> {
    let (mut motions, mut views, mut rest): (Vec<(String, Vec<&str>)>, Vec<(usize, Vec<&str>)>, Vec<String>) =
        Default::default();
    for name in names {
        let camera = name.split_once(".cam_from_rig.").map(|(c, step)| (format!("camera {c} against the first"), step));
        let sheet = name.strip_prefix("sheet.rig_from_sheet.").map(|step| ("the laser sheet".to_owned(), step));
        if let Some((of, step)) = camera.or(sheet) {
            add(&mut motions, of, step);
        } else if let Some(view) = view_of(name) {
            add(&mut views, view, name);
        } else {
            rest.push((*name).to_owned());
        }
    }
    let mut out: Vec<String> = motions
        .iter()
        .map(|(of, steps)| {
            let about = |first: char| -> Vec<String> {
                let axes = steps.iter().filter(|s| s.starts_with(first)).filter_map(|s| s.chars().nth(1));
                axes.map(String::from).collect()
            };
            let (turns, shifts) = (about('r'), about('t'));
            let parts = [("turn about", &turns), ("shift along", &shifts)];
            let parts: Vec<String> =
                parts.iter().filter(|p| !p.1.is_empty()).map(|p| format!("{} {}", p.0, listed(p.1))).collect();
            format!("{} of {of} {} not determined", listed(&parts), is_or_are(steps.len()))
        })
        .collect();
    out.extend(of_targets(views).iter().map(|(what, count)| format!("{what} {} not determined", is_or_are(*count))));
    if !rest.is_empty() {
        out.push(format!("{} {} not determined", listed(&rest), is_or_are(rest.len())));
    }
    out
}

fn add<'a, K: PartialEq>(groups: &mut Vec<(K, Vec<&'a str>)>, key: K, name: &'a str) {
    match groups.iter_mut().find(|g| g.0 == key) {
        Some((_, list)) => list.push(name),
        None => groups.push((key, vec![name])),
    }
}

/// What of the targets of which views is open, and how many things that are; views alike together.
fn of_targets(views: Vec<(usize, Vec<&str>)>) -> Vec<(String, usize)> {
    let mut open: Vec<(Vec<String>, Vec<String>)> = vec![];
    for (view, names) in views {
        let what = open_of_target(&names);
        match open.iter_mut().find(|(other, _)| *other == what) {
            Some((_, views)) => views.push(view.to_string()),
            None => open.push((what, vec![view.to_string()])),
        }
    }
    let words = |(what, views): &(Vec<String>, Vec<String>)| {
        let of = if views.len() == 1 { "the target of view" } else { "the targets of views" };
        (format!("{} of {of} {}", listed(what), listed(views)), what.len())
    };
    open.iter().map(words).collect()
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

/// What of the target of one view is open, from the names of those numbers.
fn open_of_target(names: &[&str]) -> Vec<String> {
    let any = |part: &str| names.iter().any(|n| n.contains(part));
    let place = any("_from_target.t") || any(".plane_z");
    let turn = names.iter().any(|n| n.ends_with("_rad"));
    let size = any("spacing") || any("radius") || any(".step");
    let parts = [(place, "place"), (turn, "direction"), (size, "size")];
    parts.iter().filter(|p| p.0).map(|p| p.1.to_owned()).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_belongs_together_is_one_sentence() {
        let steps = ["rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"];
        let of = |whose: &str| steps.map(|s| format!("{whose}.{s}")).to_vec();
        let mut names = of("right.cam_from_rig");
        names.push("sheet.rig_from_sheet.tz_mm".into());
        for v in [0, 1, 4] {
            names.extend(of(&format!("view{v}.rig_from_target")));
            names.push(format!("view{v}.radius0_mm"));
        }
        names.push("view2.plane_z_mm".into());
        names.push("target.spacing_mm".into());
        let told = grouped(&names.iter().map(String::as_str).collect::<Vec<_>>());
        let wanted = [
            "turn about x, y and z and shift along x, y and z of camera right against the first are not determined",
            "shift along z of the laser sheet is not determined",
            "place, direction and size of the targets of views 0, 1 and 4 are not determined",
            "place of the target of view 2 is not determined",
            "target.spacing_mm is not determined",
        ];
        assert_eq!(told, wanted);
        assert!(grouped(&[]).is_empty());
    }
}
