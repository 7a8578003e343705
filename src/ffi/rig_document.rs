//! A rig description under construction: the tables of a rig file.
//!
//! Setters write what a user would write into the file, and [`RigDescription::parse`] is the one judge of both.

mod removal;

use super::abi::SPIVCAL_ERROR_INTERNAL;
use super::door::Fault;
use super::rig_keys::*;
use crate::rig_file::{MARKS, RigDescription};
use toml::{Table, Value};

/// Name of a description that was not read from a file, in messages.
pub(super) const UNNAMED: &str = "rig description";
/// A position along a traverse that nobody has read.
const UNKNOWN: &str = "unknown";

/// A rig file as text and as tables.
#[derive(Default)]
pub(super) struct Document {
    /// Name for messages.
    name: String,
    /// As it was read; `None` once something was set.
    text: Option<String>,
    tables: Table,
}

impl Document {
    pub(super) fn new() -> Self {
        Self { name: UNNAMED.into(), ..Self::default() }
    }

    /// A rig file; refused where it has no meaning.
    pub(super) fn read(text: &str, name: &str) -> Result<Self, Fault> {
        RigDescription::parse(text, name)?;
        let tables = text.parse().map_err(|e| Fault::new(SPIVCAL_ERROR_INTERNAL, format!("{name}: {e}")))?;
        Ok(Self { name: name.into(), text: Some(text.into()), tables })
    }

    /// The text of the rig file.
    pub(super) fn text(&self) -> Result<String, Fault> {
        match &self.text {
            Some(text) => Ok(text.clone()),
            None => toml::to_string(&self.tables)
                .map_err(|e| Fault::new(SPIVCAL_ERROR_INTERNAL, format!("the description cannot be written: {e}"))),
        }
    }

    /// The description, checked for sense. Once it was changed, lines are those of its own text and not of the file.
    pub(super) fn description(&self) -> Result<RigDescription, Fault> {
        match &self.text {
            Some(text) => Ok(RigDescription::parse(text, &self.name)?),
            None => Ok(RigDescription::parse(&self.text()?, UNNAMED)?),
        }
    }

    pub(super) fn camera_names(&self) -> Vec<String> {
        let name = |c: &Value| c.get("name").and_then(Value::as_str).unwrap_or_default().to_string();
        self.list("camera").iter().map(name).collect()
    }

    fn list(&self, key: &str) -> &[Value] {
        self.tables.get(key).and_then(Value::as_array).map_or(&[], Vec::as_slice)
    }

    /// Appends a camera or a view and gives its index.
    pub(super) fn append(&mut self, list: &str, entry: Table) -> u64 {
        self.text = None;
        let all = self.tables.entry(list).or_insert_with(|| Value::Array(Vec::new()));
        match all {
            Value::Array(all) => {
                all.push(Value::Table(entry));
                all.len() as u64 - 1
            }
            _ => 0,
        }
    }

    /// Entry `index` of `[[camera]]` or `[[view]]`.
    pub(super) fn entry(&mut self, list: &str, index: u64) -> Result<&mut Table, Fault> {
        let count = self.list(list).len();
        let place = usize::try_from(index).ok().filter(|i| *i < count);
        let place = place.ok_or_else(|| Fault::index(list, index, count))?;
        let found = self.tables.get_mut(list).and_then(|l| l.get_mut(place)).and_then(Value::as_table_mut);
        let found = found.ok_or_else(|| Fault::argument(format!("{list} {place} is no table")))?;
        self.text = None;
        Ok(found)
    }

    /// A table of the file, made where it is missing.
    fn table(&mut self, key: &str) -> Result<&mut Table, Fault> {
        let found = within(&mut self.tables, key)?;
        self.text = None;
        Ok(found)
    }

    fn place(&mut self, place: Place, index: u64) -> Result<&mut Table, Fault> {
        let (list, way) = place.way();
        let start = match list {
            Some(list) => self.entry(list, index)?,
            None => {
                self.exists(place, index)?;
                self.text = None;
                &mut self.tables
            }
        };
        let found = way.iter().try_fold(start, |table, key| within(table, key))?;
        if matches!(place, Place::Point | Place::Origin) {
            // A point and a disc exclude each other.
            found.retain(|key, _| (key == "point_mm") == (place == Place::Point));
        }
        Ok(found)
    }

    /// `spivcal_rig_set_number`.
    pub(super) fn set_number(&mut self, key: i32, index: u64, value: f64) -> Result<(), Fault> {
        let Some((_, place, name, form)) = NUMBERS.into_iter().find(|n| n.0 == key) else {
            return Err(super::detection::unknown_key("SPIVCAL_RIG_*", key));
        };
        let refused = |expected: &str| Err(Fault::argument(format!("{name} = {value}: expected {expected}")));
        if !value.is_finite() {
            return refused("a finite number");
        }
        if DEFAULTS.contains(&(key, value)) {
            return self.take(place, index, name);
        }
        let whole = value.fract() == 0.0 && value.abs() < 1e9;
        let truth = value == 0.0 || value == 1.0;
        let written = match form {
            Form::Real => Value::Float(value),
            Form::Whole if whole => Value::Integer(value as i64),
            Form::Whole => return refused("a whole number"),
            Form::Truth if truth => Value::Boolean(value == 1.0),
            Form::Unknown if value == 1.0 => Value::String(UNKNOWN.into()),
            Form::Unknown if truth => return self.read_again(place, index, name),
            Form::Truth | Form::Unknown => return refused("0 or 1"),
            Form::Sigma if value < 0.0 => return refused("a standard deviation, 0 or more"),
            Form::Sigma => return self.set_sigma(place, index, (name, value)),
        };
        if place.is_listed() {
            return self.set_listed(place, index, name, written);
        }
        let table = self.place(place, index)?;
        match table.get_mut(name).and_then(Value::as_table_mut) {
            // Its standard deviation stays.
            Some(with_sigma) if form == Form::Real => with_sigma.insert("value".into(), written),
            _ => table.insert(name.into(), written),
        };
        Ok(())
    }

    /// What a key has that is there already.
    fn stated(&self, place: Place, index: u64, name: &str) -> Option<&Value> {
        let (list, way) = place.way();
        let start = match list {
            Some(list) => self.list(list).get(usize::try_from(index).ok()?)?.as_table()?,
            None => &self.tables,
        };
        way.iter().try_fold(start, |table, key| table.get(*key)?.as_table())?.get(name)
    }

    /// A position is no longer unknown.
    fn read_again(&mut self, place: Place, index: u64, name: &str) -> Result<(), Fault> {
        match self.stated(place, index, name).and_then(Value::as_str) {
            Some(UNKNOWN) => self.place(place, index).map(|view| drop(view.remove(name))),
            _ => self.exists(place, index),
        }
    }

    /// Refuses an index that counts nothing, or beyond what there is.
    fn exists(&self, place: Place, index: u64) -> Result<(), Fault> {
        let Some(list) = place.way().0 else {
            return if place.is_listed() { Ok(()) } else { Fault::unless_zero(index) };
        };
        let count = self.list(list).len();
        if index < count as u64 { Ok(()) } else { Err(Fault::index(list, index, count)) }
    }

    /// The standard deviation of a number that is there; of 0 nothing is written.
    fn set_sigma(&mut self, place: Place, index: u64, (name, sigma): (&str, f64)) -> Result<(), Fault> {
        let value = match self.stated(place, index, name) {
            Some(Value::Table(with_sigma)) => with_sigma.get("value").cloned(),
            Some(number @ (Value::Float(_) | Value::Integer(_))) => Some(number.clone()),
            _ => None,
        };
        let Some(value) = value else {
            self.exists(place, index)?;
            return Err(Fault::argument(format!("{name} has a standard deviation, but no value yet: set that first")));
        };
        let number = match sigma {
            0.0 => value,
            _ => Value::Table(Table::from_iter([("value".into(), value), ("sigma".into(), Value::Float(sigma))])),
        };
        self.place(place, index)?.insert(name.into(), number);
        Ok(())
    }

    /// An entry of a list that is filled in order.
    fn set_listed(&mut self, place: Place, index: u64, name: &str, written: Value) -> Result<(), Fault> {
        let (most, what) = match place {
            Place::Radius => (2, "radius (set them in order)"),
            _ => (3, "coordinate (set them in order)"),
        };
        let mut list = self.stated(place, 0, name).and_then(Value::as_array).cloned().unwrap_or_default();
        match usize::try_from(index) {
            Ok(i) if i < list.len() => list[i] = written,
            Ok(i) if i == list.len() && i < most => list.push(written),
            _ => return Err(Fault::index(what, index, list.len())),
        }
        self.place(place, index)?.insert(name.into(), Value::Array(list));
        Ok(())
    }

    /// `spivcal_rig_set_text`.
    pub(super) fn set_word(&mut self, key: i32, index: u64, word: String) -> Result<(), Fault> {
        let Some((_, place, name)) = WORDS.into_iter().find(|w| w.0 == key) else {
            return Err(super::detection::unknown_key("SPIVCAL_RIG_*", key));
        };
        let value = if key == SPIVCAL_RIG_SOLVE_ESTIMATE {
            Value::Array(word.split_whitespace().map(Value::from).collect())
        } else {
            Value::String(word)
        };
        self.place(place, index)?.insert(name.into(), value);
        Ok(())
    }

    /// `spivcal_rig_set_known`.
    pub(super) fn set_known(&mut self, camera: u64, parameter: i32, value: f64, sigma: f64) -> Result<(), Fault> {
        let Some((_, place, name)) = PARAMETERS.into_iter().find(|p| p.0 == parameter) else {
            return Err(super::detection::unknown_key("SPIVCAL_PARAMETER_*", parameter));
        };
        if !(value.is_finite() && sigma.is_finite() && sigma >= 0.0) {
            return Err(Fault::argument(format!(
                "{name} = {value} with sigma {sigma}: expected a finite value and a finite sigma, 0 where the value is exact"
            )));
        }
        let number = |key: &str, number: f64| (key.to_string(), Value::Float(number));
        let known = match place {
            _ if sigma > 0.0 => Value::Table(Table::from_iter([number("value", value), number("sigma", sigma)])),
            Place::Window => Value::Float(value),
            _ => Value::Table(Table::from_iter([number("fixed", value)])),
        };
        self.place(place, camera)?.insert(name.into(), known);
        Ok(())
    }

    /// `spivcal_rig_set_scale`.
    pub(super) fn set_scale(&mut self, fact: i32, view: u64, disc: u64, value: f64, sigma: f64) -> Result<(), Fault> {
        let number = |n: u64| Value::Integer(i64::try_from(n).unwrap_or(i64::MAX));
        if !(sigma >= 0.0 && sigma.is_finite()) {
            return Err(Fault::argument(format!(
                "sigma = {sigma}: expected a finite length in mm, 0 where it is exact"
            )));
        }
        if fact != SPIVCAL_SCALE_TRAVERSE && !(value > 0.0 && value.is_finite()) {
            return Err(Fault::argument(format!("value = {value}: expected a finite length above 0, in mm")));
        }
        let mut length = Table::new();
        if fact != SPIVCAL_SCALE_TRAVERSE {
            length.insert("value".into(), Value::Float(value));
        }
        if sigma > 0.0 {
            length.insert("sigma".into(), Value::Float(sigma));
        }
        let (key, entry) = match fact {
            SPIVCAL_SCALE_BASELINE => ("baseline_mm", Value::Table(length)),
            SPIVCAL_SCALE_SPACING | SPIVCAL_SCALE_RADIUS => {
                length.insert("view".into(), number(view));
                if fact == SPIVCAL_SCALE_RADIUS {
                    length.insert("disc".into(), number(disc));
                }
                (if fact == SPIVCAL_SCALE_RADIUS { "radius_mm" } else { "spacing_mm" }, Value::Table(length))
            }
            SPIVCAL_SCALE_TRAVERSE if sigma > 0.0 => ("plane_z_mm", Value::Table(length)),
            SPIVCAL_SCALE_TRAVERSE => ("plane_z_mm", Value::Boolean(true)),
            _ => return Err(super::detection::unknown_key("SPIVCAL_SCALE_*", fact)),
        };
        // There is one fact: a new one takes the place of the old.
        let scale = self.table("scale")?;
        scale.clear();
        scale.insert(key.into(), entry);
        Ok(())
    }

    /// `spivcal_rig_add_mark`.
    pub(super) fn add_mark(&mut self, kind: String, column: i32, row: i32, level: i32) -> Result<(), Fault> {
        if !MARKS.iter().any(|m| m.0 == kind) {
            let text = format!("\"{kind}\" is no kind of mark: expected ring, large, square or triangle");
            return Err(Fault::argument(text));
        }
        if !(0..=1).contains(&level) {
            return Err(Fault::argument(format!("level = {level}: expected 0 (front) or 1 (back)")));
        }
        let mut mark = Table::new();
        mark.insert("kind".into(), Value::String(kind));
        mark.insert("column".into(), Value::Integer(column.into()));
        mark.insert("row".into(), Value::Integer(row.into()));
        if level != 0 {
            mark.insert("level".into(), Value::Integer(level.into()));
        }
        let marks = self.table("target")?.entry("marks").or_insert_with(|| Value::Array(Vec::new()));
        if let Some(marks) = marks.as_array_mut() {
            marks.push(Value::Table(mark));
        }
        Ok(())
    }

    /// Names the image of a camera in a view.
    pub(super) fn set_image(&mut self, view: u64, camera: u64, name: &str) -> Result<(), Fault> {
        let names = self.camera_names();
        let camera_name = usize::try_from(camera).ok().and_then(|c| names.get(c));
        let camera_name = camera_name.ok_or_else(|| Fault::index("camera", camera, names.len()))?;
        self.entry("view", view)?.insert(camera_name.clone(), Value::String(name.into()));
        Ok(())
    }
}

/// A table in a table, made where it is missing.
fn within<'a>(outer: &'a mut Table, key: &str) -> Result<&'a mut Table, Fault> {
    let inner = outer.entry(key).or_insert_with(|| Value::Table(Table::new()));
    inner.as_table_mut().ok_or_else(|| Fault::argument(format!("{key} is no table")))
}
