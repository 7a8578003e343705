//! `[target]`.

use super::reader::{Item, LENGTH_MM, SIGMA, Section, one_of};
use super::{Adjust, Length, Scale, TargetDescription};
use crate::error::Result;
use crate::target::{DotId, Grid, Mark, MarkKind, Pair, Plate, Polarity, Target, TargetKind as Kind};

/// Kinds of marks by their words.
pub(crate) const MARKS: [(&str, MarkKind); 4] = [
    ("ring", MarkKind::Ring),
    ("large", MarkKind::Large),
    ("square", MarkKind::Square),
    ("triangle", MarkKind::Triangle),
];

/// Keys of `[target]` that have a meaning for a kind.
fn keys(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::TwoDiscs => &["kind", "polarity", "adjust", "spacing_mm", "radii_mm"],
        Kind::Bubbles => &["kind", "polarity", "adjust"],
        Kind::DotGrid => {
            &["kind", "polarity", "adjust", "point_sigma_mm", "spacing_mm", "radii_mm", "columns", "rows", "marks"]
        }
        Kind::TwoLevelPlate => {
            &["kind", "polarity", "adjust", "point_sigma_mm", "spacing_mm", "radii_mm", "step_mm", "marks"]
        }
    }
}

/// The target, and the length that it gives as the scale.
pub(super) fn read(root: &Section<'_>) -> Result<(TargetDescription, Option<Scale>)> {
    let kinds: Vec<&str> = Kind::WORDS.iter().map(|(w, _)| *w).collect();
    let item = root.find("target").ok_or_else(|| {
        let message = format!("no [target] is described; add [target] with kind = one of {}", one_of(&kinds));
        root.source.refuse_line(1, message)
    })?;
    let section = item.section("[target] (in single brackets)")?.named("[target]");
    let kind = section.require("kind", &format!("expected one of {}", one_of(&kinds)))?.choice(&Kind::WORDS)?;
    section.only(keys(kind), |key| elsewhere(kind, key))?;
    let polarity = section.find("polarity").map_or(Ok(Polarity::Auto), |i| {
        i.choice(&[("auto", Polarity::Auto), ("bright", Polarity::Bright), ("dark", Polarity::Dark)])
    })?;
    let adjust = adjust(kind, &section)?;
    let spacing = section.find("spacing_mm").map(|i| length(&i)).transpose()?;
    let (target, scale) = match kind {
        Kind::TwoDiscs => two_discs(&section, spacing)?,
        Kind::Bubbles => (Target::Bubbles(Pair::default()), None),
        Kind::DotGrid => dot_grid(&section, spacing)?,
        Kind::TwoLevelPlate => two_level_plate(&section, spacing)?,
    };
    if adjust == Adjust::None {
        complete(&section, kind, &target)?;
    }
    let point_sigma_mm = point_sigma(&section, adjust)?;
    if adjust == Adjust::Points && point_sigma_mm.is_none() && spacing.is_none() {
        return Err(section.require("adjust", "")?.refuse(
            "\"points\" estimates every dot about its place, which is taken to be known to a hundredth of the pitch, but spacing_mm is missing; say how far \
             dots lie off their places with point_sigma_mm, in mm",
        ));
    }
    Ok((TargetDescription { target, polarity, adjust, point_sigma_mm }, scale))
}

/// Keys that other kinds of target have.
fn elsewhere(kind: Kind, key: &str) -> Option<String> {
    if kind == Kind::Bubbles && matches!(key, "spacing_mm" | "radii_mm") {
        return Some(
            "cannot be said of bubbles, whose radii and spacing differ in each view; where one of them is known, \
             give it as the scale: [scale] spacing_mm = { view = 0, value = ... } or \
             radius_mm = { view = 0, disc = 0, value = ... }"
                .to_string(),
        );
    }
    let owners: Vec<&str> = Kind::WORDS.iter().filter(|(_, k)| keys(*k).contains(&key)).map(|(w, _)| *w).collect();
    (!owners.is_empty())
        .then(|| format!("has no meaning for kind = \"{}\"; it belongs to {}", kind.word(), one_of(&owners)))
}

fn adjust(kind: Kind, section: &Section<'_>) -> Result<Adjust> {
    let Some(item) = section.find("adjust") else { return Ok(Adjust::default()) };
    let adjust = item.choice(&[("none", Adjust::None), ("shape", Adjust::Shape), ("points", Adjust::Points)])?;
    match adjust {
        Adjust::Points if kind.is_pair() => {
            Err(item.refuse("\"points\" is for grids and plates; the shape of two discs is estimated by \"shape\""))
        }
        Adjust::None if kind == Kind::Bubbles => Err(item
            .refuse("radii and spacing of bubbles are always estimated, in each view of their own; leave adjust out")),
        _ => Ok(adjust),
    }
}

/// A length: a number, or `{ value, sigma }`.
pub(super) fn length(item: &Item<'_>) -> Result<Length> {
    if !item.is_table() {
        return Ok(Length { value_mm: item.number(LENGTH_MM)?, sigma_mm: None });
    }
    let section = item.section("a table")?;
    section.only(&["value", "sigma"], |_| None)?;
    length_in(&section)
}

/// `value` and `sigma` of a table that may have further keys.
pub(super) fn length_in(section: &Section<'_>) -> Result<Length> {
    let value_mm = section.require("value", "expected a length in mm")?.number(LENGTH_MM)?;
    Ok(Length { value_mm, sigma_mm: section.number("sigma", SIGMA)? })
}

/// A target that is not adjusted must be described entirely.
fn complete(section: &Section<'_>, kind: Kind, target: &Target) -> Result<()> {
    let (spacing, radii) = match target {
        Target::TwoDiscs(p) | Target::Bubbles(p) => (p.spacing_mm.is_some(), p.radii_mm.is_some()),
        Target::DotGrid(g) => (g.spacing_mm.is_some(), g.radius_mm.is_some()),
        Target::TwoLevelPlate(p) => (true, p.radius_mm.is_some()),
    };
    if spacing && radii {
        return Ok(());
    }
    let missing = if spacing { "radii_mm" } else { "spacing_mm" };
    Err(section.require("adjust", "")?.refuse(format!(
        "\"none\" takes the {} as exactly known, but {missing} is missing; add it, or let adjust = \"shape\" estimate it",
        kind.word()
    )))
}

fn point_sigma(section: &Section<'_>, adjust: Adjust) -> Result<Option<f64>> {
    let Some(item) = section.find("point_sigma_mm") else { return Ok(None) };
    if adjust != Adjust::Points {
        return Err(item.refuse("only has a meaning with adjust = \"points\", where every dot is estimated"));
    }
    Ok(Some(item.number(SIGMA)?))
}

/// The radii as given: two of a pair, one of equal dots.
fn radii<const N: usize>(section: &Section<'_>, what: &str) -> Result<Option<[f64; N]>> {
    let Some(item) = section.find("radii_mm") else { return Ok(None) };
    let list = item.list(what)?;
    if list.len() != N {
        return Err(item.refuse(format!("expected {what}, found a list of {}", list.len())));
    }
    let mut radii = [0.0; N];
    for (radius, item) in radii.iter_mut().zip(&list) {
        *radius = item.number(LENGTH_MM)?;
    }
    Ok(Some(radii))
}

type Described = (Target, Option<Scale>);

fn two_discs(section: &Section<'_>, spacing: Option<Length>) -> Result<Described> {
    let radii_mm = radii::<2>(section, "the two radii in mm, such as [12.5, 10.0]")?;
    if let (Some(s), Some([r0, r1])) = (spacing, radii_mm)
        && r0 + r1 >= s.value_mm
    {
        return Err(section.require("radii_mm", "")?.refuse(format!(
            "discs of {r0} mm and {r1} mm whose centres are {} mm apart overlap; \
             expected r0 + r1 below the spacing (radii, not diameters)",
            s.value_mm
        )));
    }
    // Where the spacing is known, it sets the scale and the radii are nominal: a spacing is measured better.
    let scale = spacing.map(Scale::TargetSpacing).or(radii_mm.map(|r| first_radius(r[0])));
    Ok((Target::TwoDiscs(Pair { spacing_mm: spacing.map(|s| s.value_mm), radii_mm }), scale))
}

fn first_radius(value_mm: f64) -> Scale {
    Scale::TargetRadius { disc: 0, radius: Length { value_mm, sigma_mm: None } }
}

fn dot_grid(section: &Section<'_>, spacing: Option<Length>) -> Result<Described> {
    let radius_mm = radii::<1>(section, "a list with the one radius of the dots in mm, such as [1.2]")?.map(|r| r[0]);
    if let (Some(s), Some(r)) = (spacing, radius_mm) {
        separate(section, r, s.value_mm, "the pitch")?;
    }
    let count = |key: &str| {
        section.find(key).map(|i| i.integer(2, 10_000, "a whole number of dots from 2 to 10000")).transpose()
    };
    let (columns, rows) = (count("columns")?, count("rows")?);
    let marks = marks(section, false)?;
    let extent = |along: fn(&Mark) -> i32| {
        let (low, high) = marks.iter().map(along).fold((i32::MAX, i32::MIN), |(l, h), x| (l.min(x), h.max(x)));
        if marks.is_empty() { 0 } else { i64::from(high) - i64::from(low) + 1 }
    };
    for (name, limit, used) in [("columns", columns, extent(|m| m.at.column)), ("rows", rows, extent(|m| m.at.row))] {
        if let Some(limit) = limit.filter(|limit| used > *limit) {
            return Err(section
                .require("marks", "")?
                .refuse(format!("the marks span {used} {name}, but {name} = {limit}; one of the two is wrong")));
        }
    }
    let size = |n: Option<i64>| n.and_then(|n| usize::try_from(n).ok());
    let scale = spacing.map(Scale::TargetSpacing).or(radius_mm.map(first_radius));
    let grid =
        Grid { spacing_mm: spacing.map(|s| s.value_mm), columns: size(columns), rows: size(rows), radius_mm, marks };
    Ok((Target::DotGrid(grid), scale))
}

fn two_level_plate(section: &Section<'_>, spacing: Option<Length>) -> Result<Described> {
    let Some(spacing) = spacing else {
        return Err(section.refuse("the key \"spacing_mm\" is missing: the pitch of the dots on one level, in mm"));
    };
    let step_mm =
        section.require("step_mm", "the depth of the back level below the front level, in mm")?.number(LENGTH_MM)?;
    let radius_mm = radii::<1>(section, "a list with the one radius of the dots in mm, such as [1.6]")?.map(|r| r[0]);
    if let Some(r) = radius_mm {
        // Dots of the other level are half a pitch away along both axes.
        separate(section, r, spacing.value_mm * std::f64::consts::FRAC_1_SQRT_2, "the nearest dot of the other level")?;
    }
    let plate = Plate { spacing_mm: spacing.value_mm, step_mm, radius_mm, marks: marks(section, true)? };
    Ok((Target::TwoLevelPlate(plate), Some(Scale::TargetSpacing(spacing))))
}

fn separate(section: &Section<'_>, radius_mm: f64, distance_mm: f64, what: &str) -> Result<()> {
    if 2.0 * radius_mm < distance_mm {
        return Ok(());
    }
    Err(section.require("radii_mm", "")?.refuse(format!(
        "dots of radius {radius_mm} mm overlap: {what} is {distance_mm:.6} mm away; \
         expected less than half of that (a radius, not a diameter)"
    )))
}

fn marks(section: &Section<'_>, levels: bool) -> Result<Vec<Mark>> {
    let Some(item) = section.find("marks") else { return Ok(Vec::new()) };
    let form = "a list such as [{ kind = \"ring\", column = 0, row = 0 }]";
    let mut marks: Vec<Mark> = Vec::new();
    for item in item.list(form)? {
        let mark = mark(&item, levels)?;
        if let Some(other) = marks.iter().position(|m| m.at == mark.at) {
            return Err(item.refuse(format!("is at the same place as mark {}; two marks need two places", other + 1)));
        }
        marks.push(mark);
    }
    Ok(marks)
}

fn mark(item: &Item<'_>, levels: bool) -> Result<Mark> {
    let section = item.section("a table such as { kind = \"ring\", column = 0, row = 0 }")?;
    let keys: &[&str] = if levels { &["kind", "column", "row", "level"] } else { &["kind", "column", "row"] };
    section.only(keys, |key| (key == "level").then(|| "is for two-level plates only".to_string()))?;
    let place = |key: &str| -> Result<i32> {
        let what = "a whole number from -10000 to 10000 (its place on the lattice)";
        Ok(section.require(key, what)?.integer(-10_000, 10_000, what)? as i32)
    };
    let level = match section.find("level") {
        Some(i) => u8::from(i.integer(0, 1, "0 (front level) or 1 (back level)")? == 1),
        None => 0,
    };
    let kind = section.require("kind", "expected ring, large, square or triangle")?.choice(&MARKS)?;
    Ok(Mark { kind, at: DotId { column: place("column")?, row: place("row")?, level } })
}
