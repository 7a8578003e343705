//! Between a [`Record`] and the text of `calibration.json`.

use super::schema::{FORMAT, Record, VERSION};
use super::{check, place};
use crate::error::{Error, Invalid, Result, in_plain_types};
use serde_json::{Map, Value};
use std::fmt::Write;

/// Objects and lists that fit this many characters stay on one line.
const LINE_WIDTH: usize = 110;

impl Record {
    /// The text of `calibration.json`.
    ///
    /// Every `null` that stands for a missing number is listed by path under the key `not_finite`.
    ///
    /// # Errors
    /// [`Error::Bug`] where the record cannot be written at all.
    pub fn to_json(&self) -> Result<String> {
        let mut value = serde_json::to_value(self).map_err(|e| Error::Bug(format!("calibration record: {e}")))?;
        let mut nulls = Vec::new();
        list_nulls(&value, &mut String::new(), &mut nulls);
        if let Value::Object(map) = &mut value
            && !nulls.is_empty()
        {
            map.insert("not_finite".into(), Value::Array(nulls.into_iter().map(Value::String).collect()));
        }
        let mut text = String::new();
        write_value(&mut text, &value, 0);
        text.push('\n');
        Ok(text)
    }

    /// Whether every value is possible and nothing contradicts itself; what [`Record::from_json`] would refuse is refused.
    ///
    /// # Errors
    /// [`Error::Bug`] with the path of the first impossible value: a record that the library made must pass.
    pub fn check(&self) -> Result<()> {
        self.impossible().map_or(Ok(()), |what| Err(Error::Bug(format!("calibration record, {what}"))))
    }

    /// Path and words of the first value that [`Record::check`] refuses.
    pub(crate) fn impossible(&self) -> Option<String> {
        check::first_fault(self).map(|fault| format!("{}: {}", fault.path, fault.message))
    }

    /// The record in the text of a `calibration.json`; `file` is only named in messages.
    ///
    /// ```
    /// let error = spivcal::record::Record::from_json("{}", "c.json").unwrap_err();
    /// assert_eq!(error.to_string(), "c.json:1: no key \"format\": expected \"format\": \"spivcal-calibration\"");
    /// ```
    ///
    /// # Errors
    /// [`Invalid::Syntax`] with file and line where the text is not JSON, not a spivcal calibration, of another version,
    /// lacks a key, has a value of another type, or an impossible one.
    pub fn from_json(text: &str, file: &str) -> Result<Record> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let value: Value = serde_json::from_str(text).map_err(|e| syntax(file, text, &e))?;
        check_header(&value, text, file)?;
        let record: Record = serde_json::from_str(text).map_err(|e| at_key(file, text, &e))?;
        match check::first_fault(&record) {
            None => Ok(record),
            Some(fault) => Err(Invalid::Syntax {
                file: file.into(),
                line: place::line_of(text, &fault.path),
                message: format!("{}: {}", fault.path, fault.message),
            }
            .into()),
        }
    }
}

fn check_header(value: &Value, text: &str, file: &str) -> Result<()> {
    let fault = |key: &str, message: String| -> Result<()> {
        Err(Invalid::Syntax { file: file.into(), line: place::line_of(text, key), message }.into())
    };
    let Value::Object(map) = value else {
        return fault("", format!("this is not a calibration: expected an object with \"format\": \"{FORMAT}\""));
    };
    match map.get("format") {
        Some(Value::String(s)) if s == FORMAT => {}
        Some(other) => return fault("format", format!("format is {other}: expected \"{FORMAT}\"")),
        None => return fault("", format!("no key \"format\": expected \"format\": \"{FORMAT}\"")),
    }
    match map.get("version") {
        Some(v) if v.as_u64() == Some(u64::from(VERSION)) => Ok(()),
        Some(v) => fault("version", format!("version is {v}: this program reads version {VERSION}")),
        None => fault("", format!("no key \"version\": expected \"version\": {VERSION}")),
    }
}

/// The message of a value that is missing or of another type, with its key.
fn at_key(file: &str, text: &str, e: &serde_json::Error) -> Error {
    let (full, path) = (e.to_string(), place::path_at(text, e.line(), e.column()));
    let words = full.split(" at line ").next().unwrap_or(&full);
    let words = words.replace("null, expected f64", "null (a number that was not determined), expected f64");
    let words = in_plain_types(&words.replace("expected f64", "expected a finite number"));
    let message = if path.is_empty() { words } else { format!("{path}: {words}") };
    Invalid::Syntax { file: file.into(), line: place::line_of(text, &path), message }.into()
}

/// serde_json's message with our file and line, and the text it complains about.
fn syntax(file: &str, text: &str, e: &serde_json::Error) -> Error {
    let full = e.to_string();
    let words = full.split(" at line ").next().unwrap_or(&full);
    let line = e.line();
    let excerpt: String =
        text.lines().nth(line.saturating_sub(1)).map(|l| l.trim().chars().take(60).collect()).unwrap_or_default();
    let mut message =
        format!("this is not a whole calibration.json as spivcal calibrate writes it (not valid JSON: {words})");
    if !excerpt.is_empty() {
        let _ = write!(message, ", in `{excerpt}`");
    }
    Invalid::Syntax { file: file.into(), line, message }.into()
}

/// Paths of all `null`s, except those of whole objects that may be absent.
fn list_nulls(value: &Value, path: &mut String, found: &mut Vec<String>) {
    let len = path.len();
    match value {
        Value::Null => {
            let key = path.rsplit('.').next().unwrap_or_default();
            if !matches!(key, "sheet" | "rig" | "rig_from_target") {
                found.push(path.clone());
            }
        }
        Value::Array(list) => {
            for (i, v) in list.iter().enumerate() {
                let _ = write!(path, "[{i}]");
                list_nulls(v, path, found);
                path.truncate(len);
            }
        }
        Value::Object(map) => {
            for (k, v) in map {
                if len > 0 {
                    path.push('.');
                }
                path.push_str(k);
                list_nulls(v, path, found);
                path.truncate(len);
            }
        }
        _ => {}
    }
}

fn is_flat(value: &Value) -> bool {
    !matches!(value, Value::Array(_) | Value::Object(_))
}

fn write_value(out: &mut String, value: &Value, indent: usize) {
    match value {
        Value::Array(list) if list.is_empty() => out.push_str("[]"),
        Value::Object(map) if map.is_empty() => out.push_str("{}"),
        // A row of a matrix is one line however long it is.
        Value::Array(list) if list.iter().all(|v| v.is_number() || v.is_null()) => write_inline(out, value),
        Value::Array(list) => {
            if !try_inline(out, value) {
                write_items(out, ('[', ']'), indent, list.iter().map(|v| (None, v)));
            }
        }
        Value::Object(map) => {
            if indent == 0 || !try_inline(out, value) {
                write_items(out, ('{', '}'), indent, map.iter().map(|(k, v)| (Some(k), v)));
            }
        }
        scalar => write_inline(out, scalar),
    }
}

fn try_inline(out: &mut String, value: &Value) -> bool {
    if !children(value).all(|v| is_flat(v) || children(v).all(is_flat)) {
        return false;
    }
    let start = out.len();
    write_inline(out, value);
    let fits = out.len() - start <= LINE_WIDTH;
    if !fits {
        out.truncate(start);
    }
    fits
}

fn children(value: &Value) -> Box<dyn Iterator<Item = &Value> + '_> {
    match value {
        Value::Array(list) => Box::new(list.iter()),
        Value::Object(map) => Box::new(map.values()),
        _ => Box::new(std::iter::empty()),
    }
}

fn write_items<'a>(
    out: &mut String,
    brackets: (char, char),
    indent: usize,
    items: impl Iterator<Item = (Option<&'a String>, &'a Value)>,
) {
    out.push(brackets.0);
    for (i, (key, value)) in items.enumerate() {
        out.push_str(if i == 0 { "\n" } else { ",\n" });
        out.extend(std::iter::repeat_n(' ', indent + 2));
        if let Some(key) = key {
            let _ = write!(out, "{}: ", Value::from(key.as_str()));
        }
        write_value(out, value, indent + 2);
    }
    out.push('\n');
    out.extend(std::iter::repeat_n(' ', indent));
    out.push(brackets.1);
}

fn write_inline(out: &mut String, value: &Value) {
    match value {
        Value::Array(list) => {
            out.push('[');
            for (i, v) in list.iter().enumerate() {
                out.push_str(if i == 0 { "" } else { ", " });
                write_inline(out, v);
            }
            out.push(']');
        }
        Value::Object(map) => write_inline_object(out, map),
        scalar => {
            let _ = write!(out, "{scalar}");
        }
    }
}

fn write_inline_object(out: &mut String, map: &Map<String, Value>) {
    out.push('{');
    for (i, (k, v)) in map.iter().enumerate() {
        let _ = write!(out, "{}{}: ", if i == 0 { " " } else { ", " }, Value::from(k.as_str()));
        write_inline(out, v);
    }
    out.push_str(" }");
}
