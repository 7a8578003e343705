//! What was said is taken back: the description is then as if it had never been.

use super::super::detection::unknown_key;
use super::super::rig_keys::*;
use super::Document;
use crate::ffi::door::Fault;
use toml::{Table, Value};

/// Tables within the file that name a view, and how they are called in messages.
const VIEWS_NAMED: [(&[&str], &str); 4] = [
    (&["sheet", "origin"], "the origin of the sheet frame (SPIVCAL_RIG_SHEET_ORIGIN_VIEW)"),
    (&["sheet", "x_axis"], "the x axis of the sheet frame (SPIVCAL_RIG_SHEET_X_AXIS_VIEW)"),
    (&["scale", "spacing_mm"], "the scale (spivcal_rig_set_scale)"),
    (&["scale", "radius_mm"], "the scale (spivcal_rig_set_scale)"),
];

impl Document {
    /// `spivcal_rig_unset`.
    pub(in super::super) fn unset(&mut self, key: i32, index: u64) -> Result<(), Fault> {
        let number = NUMBERS.into_iter().find(|n| n.0 == key).map(|(_, place, name, form)| (place, name, Some(form)));
        let word = || WORDS.into_iter().find(|w| w.0 == key).map(|(_, place, name)| (place, name, None));
        let Some((place, name, form)) = number.or_else(word) else {
            return Err(unknown_key("SPIVCAL_RIG_*", key));
        };
        match form {
            Some(Form::Unknown) => self.read_again(place, index, name),
            Some(Form::Sigma) if matches!(self.stated(place, index, name), Some(Value::Table(_))) => {
                self.set_sigma(place, index, (name, 0.0))
            }
            Some(Form::Sigma) => self.exists(place, index),
            // A column of no view is nothing.
            _ if key == SPIVCAL_RIG_SHEET_ORIGIN_VIEW => {
                ["view", "column", "row", "level"].into_iter().try_for_each(|name| self.take(place, index, name))
            }
            _ => self.take(place, index, name),
        }
    }

    /// `spivcal_rig_unset_known`.
    pub(in super::super) fn unset_known(&mut self, camera: u64, parameter: i32) -> Result<(), Fault> {
        let Some((_, place, name)) = PARAMETERS.into_iter().find(|p| p.0 == parameter) else {
            return Err(unknown_key("SPIVCAL_PARAMETER_*", parameter));
        };
        self.take(place, camera, name)
    }

    /// `spivcal_rig_unset_scale`.
    pub(in super::super) fn unset_scale(&mut self) {
        self.cut(&[], "scale");
    }

    /// `spivcal_rig_remove_marks`.
    pub(in super::super) fn remove_marks(&mut self) {
        self.cut(&["target"], "marks");
    }

    /// No image of a camera in a view.
    pub(in super::super) fn unset_image(&mut self, view: u64, camera: u64) -> Result<(), Fault> {
        let names = self.camera_names();
        let name = usize::try_from(camera).ok().and_then(|c| names.get(c));
        let name = name.ok_or_else(|| Fault::index("camera", camera, names.len()))?;
        self.take(Place::View, view, name)
    }

    /// Views after it move up by one, in what names a view, too.
    pub(in super::super) fn remove_view(&mut self, view: u64) -> Result<(), Fault> {
        self.exists(Place::View, view)?;
        if let Some((_, words)) = VIEWS_NAMED.into_iter().find(|(way, _)| self.named(way) == Some(view)) {
            return Err(Fault::argument(format!(
                "view {view} is named by {words}: name another one, or unset that, before this view is removed"
            )));
        }
        for (way, _) in VIEWS_NAMED {
            let Some(later) = self.named(way).filter(|named| *named > view) else { continue };
            let found = way.iter().try_fold(&mut self.tables, |table, key| table.get_mut(*key)?.as_table_mut());
            found.map(|table| table.insert("view".into(), Value::Integer(later as i64 - 1)));
        }
        if let Some(views) = self.tables.get_mut("view").and_then(Value::as_array_mut) {
            views.remove(view as usize);
        }
        self.text = None;
        Ok(())
    }

    /// The view that a table names.
    fn named(&self, way: &[&str]) -> Option<u64> {
        let found = way.iter().try_fold(&self.tables, |table, key| table.get(*key)?.as_table())?;
        u64::try_from(found.get("view")?.as_integer()?).ok()
    }

    /// Takes a key out of its place; of a list this entry and all behind it.
    pub(super) fn take(&mut self, place: Place, index: u64, name: &str) -> Result<(), Fault> {
        self.exists(place, index)?;
        let (list, way) = place.way();
        let kept = if place.is_listed() { usize::try_from(index).unwrap_or(usize::MAX) } else { 0 };
        match (self.stated(place, index, name), list) {
            (None, _) => {}
            (Some(Value::Array(entries)), None) if kept > 0 => {
                let first = entries.iter().take(kept).cloned().collect();
                self.place(place, 0)?.insert(name.into(), Value::Array(first));
            }
            (_, Some(list)) => {
                cut(self.entry(list, index)?, way, name);
            }
            (_, None) => self.cut(way, name),
        }
        Ok(())
    }

    fn cut(&mut self, way: &[&str], name: &str) {
        if cut(&mut self.tables, way, name) {
            self.text = None;
        }
    }
}

/// Takes a key out, and tables that hold nothing any more: an empty one can say something, too. Whether it was there.
fn cut(outer: &mut Table, way: &[&str], name: &str) -> bool {
    let Some((first, rest)) = way.split_first() else { return outer.remove(name).is_some() };
    let Some(inner) = outer.get_mut(*first).and_then(Value::as_table_mut) else { return false };
    let found = cut(inner, rest, name);
    if found && inner.is_empty() {
        outer.remove(*first);
    }
    found
}
