//! `[scale]`: exactly one metric fact.

use super::reader::{Item, SIGMA, Section};
use super::target::{length, length_in};
use super::{CameraDescription, Scale, TargetDescription, ViewDescription};
use crate::error::Result;
use crate::target::Target;

const FACTS: [&str; 4] = ["baseline_mm", "spacing_mm", "radius_mm", "plane_z_mm"];
const WAYS: &str = "a length of the target in [target], or [scale] with one of baseline_mm = ..., \
                    spacing_mm = { view = 0, value = ... }, radius_mm = { view = 0, disc = 0, value = ... }, \
                    or plane_z_mm of at least two different values in the views";

pub(super) fn read(
    root: &Section<'_>,
    target: &TargetDescription,
    of_target: Option<Scale>,
    cameras: &[CameraDescription],
    views: &[ViewDescription],
) -> Result<Scale> {
    let Some(item) = root.find("scale") else {
        return match of_target {
            Some(scale) => Ok(scale),
            None if has_steps(views) => Ok(Scale::Traverse { sigma_mm: None }),
            None => Err(root.source.refuse(
                root.find("target").map_or(0, |t| t.offset),
                format!("nothing sets the scale, so no length can be given in mm; add exactly one: {WAYS}"),
            )),
        };
    };
    let section = item.section("[scale] (in single brackets)")?.named("[scale]");
    section.only(&FACTS, |_| None)?;
    let facts = section.items();
    let (key, fact) = match facts.as_slice() {
        [] => return Err(section.refuse(format!("is empty; expected exactly one fact: {WAYS}"))),
        [one] => one,
        [first, second, ..] => {
            return Err(second.1.refuse(format!(
                "is a second fact beside {}; two facts would contradict each other, keep the one you trust most",
                first.0
            )));
        }
    };
    if let Some(given) = of_target {
        let key = if matches!(given, Scale::TargetSpacing(_)) { "spacing_mm" } else { "radii_mm" };
        return Err(fact.refuse(format!(
            "[target] {key} sets the scale already; two facts would contradict each other, remove one of them"
        )));
    }
    match *key {
        "baseline_mm" => baseline(fact, cameras),
        "spacing_mm" => spacing(fact, &target.target, views),
        "radius_mm" => radius(fact, &target.target, views),
        _ => traverse(fact, views),
    }
}

fn has_steps(views: &[ViewDescription]) -> bool {
    let mut positions = views.iter().filter_map(ViewDescription::position_mm);
    positions.next().is_some_and(|first| positions.any(|z| z != first))
}

fn baseline(fact: &Item<'_>, cameras: &[CameraDescription]) -> Result<Scale> {
    if cameras.len() < 2 {
        return Err(fact.refuse("there is one camera, and so no baseline; expected another fact"));
    }
    Ok(Scale::Baseline(length(fact)?))
}

fn spacing(fact: &Item<'_>, target: &Target, views: &[ViewDescription]) -> Result<Scale> {
    pair_only(fact, target, "spacing_mm")?;
    let section =
        fact.section("{ view = ..., value = ... }: in which view the spacing is known, and its length in mm")?;
    section.only(&["view", "value", "sigma"], |_| None)?;
    let (view, spacing) = (view_index(&section, views)?, length_in(&section)?);
    // Two discs on a plate have one spacing, whatever the view.
    if matches!(target, Target::TwoDiscs(_)) {
        return Ok(Scale::TargetSpacing(spacing));
    }
    Ok(Scale::ViewSpacing { view, spacing })
}

fn radius(fact: &Item<'_>, target: &Target, views: &[ViewDescription]) -> Result<Scale> {
    pair_only(fact, target, "radii_mm")?;
    let section = fact.section("{ view = ..., disc = ..., value = ... }: view, disc (0 or 1), and the radius in mm")?;
    section.only(&["view", "disc", "value", "sigma"], |_| None)?;
    let what = "0 or 1 (the disc whose radius is known)";
    let disc = usize::from(section.require("disc", what)?.integer(0, 1, what)? == 1);
    let (view, radius) = (view_index(&section, views)?, length_in(&section)?);
    if matches!(target, Target::TwoDiscs(_)) {
        return Ok(Scale::TargetRadius { disc, radius });
    }
    Ok(Scale::ViewRadius { view, disc, radius })
}

fn pair_only(fact: &Item<'_>, target: &Target, key: &str) -> Result<()> {
    match target {
        Target::TwoDiscs(_) | Target::Bubbles(_) => Ok(()),
        Target::DotGrid(_) | Target::TwoLevelPlate(_) => {
            Err(fact.refuse(format!("a grid or plate has one shape in all views; give it as {key} in [target]")))
        }
    }
}

pub(super) fn view_index(section: &Section<'_>, views: &[ViewDescription]) -> Result<usize> {
    let last = views.len().saturating_sub(1);
    let what = format!("a view from 0 to {last} (there are {}, counted from 0)", views.len());
    let index = section.require("view", &what)?.integer(0, i64::try_from(last).unwrap_or(i64::MAX), &what)?;
    Ok(usize::try_from(index).unwrap_or(0))
}

fn traverse(fact: &Item<'_>, views: &[ViewDescription]) -> Result<Scale> {
    let sigma_mm = if fact.is_table() {
        let section = fact.section("a table")?;
        section.only(&["sigma"], |_| None)?;
        section.number("sigma", SIGMA)?
    } else if fact.boolean()? {
        None
    } else {
        return Err(fact.refuse("false says nothing; remove it, or write true (or { sigma = ... })"));
    };
    if !has_steps(views) {
        return Err(fact
            .refuse("the steps of a traverse set the scale only where at least two views have different plane_z_mm"));
    }
    Ok(Scale::Traverse { sigma_mm })
}
