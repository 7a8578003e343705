//! `[sheet]`: where the sheet frame stands.

use super::reader::{Item, PLACE_MM, Section};
use super::{SheetFrame, SheetOrigin, ViewDescription};
use crate::error::Result;
use crate::target::{DotId, Target};

pub(super) fn read(root: &Section<'_>, target: &Target, views: &[ViewDescription]) -> Result<SheetFrame> {
    let Some(item) = root.find("sheet") else { return Ok(SheetFrame::default()) };
    let section = item.section("[sheet] (in single brackets)")?.named("[sheet]");
    section.only(&["origin", "x_axis", "flip_x"], |key| {
        (key == "flip_y").then(|| {
            "does not exist: flip_x = true turns x and y over together, z stays towards the first camera".into()
        })
    })?;
    if !views.iter().any(|v| v.sheet) {
        return Err(
            section.refuse("places the frame of the sheet, but no view has sheet = true; expected at least one")
        );
    }
    let origin = section.find("origin").map_or(Ok(SheetOrigin::FirstAxis), |i| origin(&i, target, views))?;
    let x_axis_view = section
        .find("x_axis")
        .map(|i| {
            let axis = i.section("{ view = ... }: the view whose target x axis the sheet's x axis follows")?;
            axis.only(&["view"], |_| None)?;
            view_index(&axis, views)
        })
        .transpose()?;
    let flip_x = section.find("flip_x").map_or(Ok(false), |i| i.boolean())?;
    Ok(SheetFrame { origin, x_axis_view, flip_x })
}

fn origin(item: &Item<'_>, target: &Target, views: &[ViewDescription]) -> Result<SheetOrigin> {
    let form = "{ view = ..., column = ..., row = ... } (a disc or mark of the target in that view) or { point_mm = [x, y, z] } \
                (a point in the frame of the first camera)";
    let section = item.section(form)?;
    if let Some(point) = section.find("point_mm") {
        section.only(&["point_mm"], |_| Some("does not go with point_mm; keep one of the two".into()))?;
        let what = "three coordinates in mm in the frame of the first camera, such as [0.0, 0.0, 500.0]";
        let list = point.list(what)?;
        let [x, y, z] = list.as_slice() else {
            return Err(point.refuse(format!("expected {what}, found a list of {}", list.len())));
        };
        return Ok(SheetOrigin::Point([x.number(PLACE_MM)?, y.number(PLACE_MM)?, z.number(PLACE_MM)?]));
    }
    section.only(&["view", "column", "row", "level"], |_| None)?;
    let view = view_index(&section, views)?;
    let place = |key: &str, low: i64, high: i64, what: &str| -> Result<i64> {
        section.find(key).map_or(Ok(0), |i| i.integer(low, high, what))
    };
    let id = if matches!(target, Target::TwoDiscs(_) | Target::Bubbles(_)) {
        let pair = "0 or 1: two discs are columns 0 and 1 of one row";
        place("row", 0, 0, "0: two discs lie in one row")?;
        place("level", 0, 0, "0: two discs lie on one level")?;
        DotId { column: i32::from(place("column", 0, 1, pair)? == 1), row: 0, level: 0 }
    } else {
        let what = "a whole number from -10000 to 10000 (its place on the lattice)";
        let along = |key: &str| place(key, -10_000, 10_000, what).map(|n| i32::try_from(n).unwrap_or(0));
        let levels = i64::from(matches!(target, Target::TwoLevelPlate(_)));
        let level = place("level", 0, levels, "0 (front level), or 1 (back level) on a plate")?;
        DotId { column: along("column")?, row: along("row")?, level: u8::from(level == 1) }
    };
    Ok(SheetOrigin::Disc { view, id })
}

fn view_index(section: &Section<'_>, views: &[ViewDescription]) -> Result<usize> {
    super::scale::view_index(section, views)
}
