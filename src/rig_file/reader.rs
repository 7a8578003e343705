//! Walks a TOML document with its line numbers: every refusal names file, line, key and what was expected.

use crate::error::{Error, Invalid, Result};
use std::ops::Range;
use toml::de::{DeTable, DeValue};

/// The text that is read and the name it has in messages.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) text: &'a str,
}

impl Source<'_> {
    /// Line of a byte offset, counted from 1.
    pub(super) fn line(&self, offset: usize) -> usize {
        self.text.bytes().take(offset).filter(|b| *b == b'\n').count() + 1
    }
    /// A refusal at a byte offset.
    pub(super) fn refuse(&self, offset: usize, message: impl Into<String>) -> Error {
        self.refuse_line(self.line(offset), message)
    }
    /// A refusal at a line.
    pub(super) fn refuse_line(&self, line: usize, message: impl Into<String>) -> Error {
        Invalid::Syntax { file: self.file.to_string(), line, message: message.into() }.into()
    }
}

/// Open interval of allowed numbers, with its words.
#[derive(Clone, Copy)]
pub(super) struct Limits {
    above: f64,
    below: f64,
    words: &'static str,
}

impl Limits {
    pub(super) const fn new(above: f64, below: f64, words: &'static str) -> Self {
        Self { above, below, words }
    }
}

/// Any finite number.
pub(super) const FINITE: Limits = Limits::new(f64::NEG_INFINITY, f64::INFINITY, "a finite number");
/// A positive finite number.
pub(super) const POSITIVE: Limits = Limits::new(0.0, f64::INFINITY, "a finite number above 0");
/// A positive length in mm.
pub(super) const LENGTH_MM: Limits = Limits::new(1e-6, 1e6, "a length in mm, above 0 (1e-6 at least) and below 1 km");
/// A place, mm.
pub(super) const PLACE_MM: Limits = Limits::new(-1e6, 1e6, "a finite number of mm between -1 km and 1 km");
/// A standard deviation.
pub(super) const SIGMA: Limits = Limits::new(
    1e-12,
    f64::INFINITY,
    "a finite standard deviation above 1e-12 (for a value that is exact, leave sigma out)",
);

/// A value with the words that lead to it.
#[derive(Clone)]
pub(super) struct Item<'a> {
    pub(super) source: Source<'a>,
    /// As in messages, `[target] spacing_mm`.
    pub(super) name: String,
    /// Where its key (or, in a list, the value itself) begins.
    pub(super) offset: usize,
    value: &'a DeValue<'a>,
}

impl<'a> Item<'a> {
    pub(super) fn refuse(&self, message: impl AsRef<str>) -> Error {
        self.source.refuse(self.offset, format!("{}: {}", self.name, message.as_ref()))
    }
    pub(super) fn line(&self) -> usize {
        self.source.line(self.offset)
    }
    fn expected(&self, what: &str) -> Error {
        self.refuse(format!("expected {what}, found {}", self.found()))
    }
    fn found(&self) -> String {
        match self.value {
            DeValue::String(s) => format!("the text \"{s}\""),
            DeValue::Integer(i) => format!("{i}"),
            DeValue::Float(f) => format!("{f}"),
            DeValue::Boolean(b) => format!("{b}"),
            DeValue::Datetime(d) => format!("the date {d}"),
            DeValue::Array(_) => "a list [...]".to_string(),
            DeValue::Table(_) => "a table { ... }".to_string(),
        }
    }
    /// A number within limits; integers count as numbers.
    pub(super) fn number(&self, limits: Limits) -> Result<f64> {
        let value = match self.value {
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok().map(|i| i as f64),
            DeValue::Float(f) => f.as_str().parse::<f64>().ok(),
            _ => None,
        };
        match value {
            Some(v) if v.is_finite() && v > limits.above && v < limits.below => Ok(v),
            _ => Err(self.expected(limits.words)),
        }
    }
    /// A whole number from `low` to `high`.
    pub(super) fn integer(&self, low: i64, high: i64, what: &str) -> Result<i64> {
        let value = match self.value {
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok(),
            _ => None,
        };
        value.filter(|v| (low..=high).contains(v)).ok_or_else(|| self.expected(what))
    }
    pub(super) fn boolean(&self) -> Result<bool> {
        self.value.as_bool().ok_or_else(|| self.expected("true or false (without quotes)"))
    }
    pub(super) fn text(&self, what: &str) -> Result<&'a str> {
        self.value.as_str().ok_or_else(|| self.expected(&format!("{what}, in quotes")))
    }
    /// One of a few words.
    pub(super) fn choice<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T> {
        let words: Vec<&str> = choices.iter().map(|(w, _)| *w).collect();
        let listed = one_of(&words);
        let text = self.text(&format!("one of {listed}"))?;
        choices.iter().find(|(w, _)| *w == text).map(|(_, t)| *t).ok_or_else(|| {
            self.refuse(format!("\"{text}\" is not known{}; expected one of {listed}", did_you_mean(text, &words)))
        })
    }
    /// The elements of a list.
    pub(super) fn list(&self, what: &str) -> Result<Vec<Item<'a>>> {
        let array = self.value.as_array().ok_or_else(|| self.expected(what))?;
        let item = |(i, v): (usize, &'a toml::Spanned<DeValue<'a>>)| Item {
            source: self.source,
            name: format!("{}, item {}", self.name, i + 1),
            offset: v.span().start,
            value: v.get_ref(),
        };
        Ok(array.iter().enumerate().map(item).collect())
    }
    pub(super) fn is_text(&self) -> bool {
        self.value.is_str()
    }
    pub(super) fn is_table(&self) -> bool {
        self.value.is_table()
    }
    /// The value as a table of keys.
    pub(super) fn section(&self, what: &str) -> Result<Section<'a>> {
        let table = self.value.as_table().ok_or_else(|| self.expected(what))?;
        Ok(Section { source: self.source, name: self.name.clone(), offset: self.offset, table })
    }
}

/// A table of keys.
pub(super) struct Section<'a> {
    pub(super) source: Source<'a>,
    pub(super) name: String,
    pub(super) offset: usize,
    table: &'a DeTable<'a>,
}

impl<'a> Section<'a> {
    pub(super) fn root(source: Source<'a>, table: &'a DeTable<'a>) -> Self {
        Self { source, name: String::new(), offset: 0, table }
    }
    pub(super) fn named(mut self, name: impl Into<String>) -> Self {
        self.name = name.into();
        self
    }
    pub(super) fn refuse(&self, message: impl AsRef<str>) -> Error {
        self.source.refuse(self.offset, format!("{}: {}", self.name, message.as_ref()))
    }
    /// All keys in the order of the file.
    pub(super) fn items(&self) -> Vec<(&'a str, Item<'a>)> {
        let mut items: Vec<_> =
            self.table.iter().map(|(k, v)| (k.get_ref().as_ref(), self.item(k.span(), k.get_ref(), v))).collect();
        items.sort_by_key(|(_, item)| item.offset);
        items
    }
    fn item(&self, key: Range<usize>, name: &str, value: &'a toml::Spanned<DeValue<'a>>) -> Item<'a> {
        let name = if self.name.is_empty() { name.to_string() } else { format!("{} {name}", self.name) };
        Item { source: self.source, name, offset: key.start, value: value.get_ref() }
    }
    pub(super) fn find(&self, key: &str) -> Option<Item<'a>> {
        let (k, v) = self.table.iter().find(|(k, _)| k.get_ref() == key)?;
        Some(self.item(k.span(), key, v))
    }
    pub(super) fn require(&self, key: &str, why: &str) -> Result<Item<'a>> {
        self.find(key).ok_or_else(|| self.refuse(format!("the key \"{key}\" is missing: {why}")))
    }
    /// Refuses every key that is not in `known`; `elsewhere` may explain keys that belong to another place.
    pub(super) fn only(&self, known: &[&str], elsewhere: impl Fn(&str) -> Option<String>) -> Result<()> {
        for (key, item) in self.items() {
            if known.contains(&key) {
                continue;
            }
            let place = if self.name.is_empty() { "the rig file".to_string() } else { self.name.clone() };
            let message = match elsewhere(key) {
                Some(words) => format!("{place}: \"{key}\" {words}"),
                None => {
                    let hint = did_you_mean(key, known);
                    format!("{place}: unknown key \"{key}\"{hint}; known here: {}", known.join(", "))
                }
            };
            return Err(self.source.refuse(item.offset, message));
        }
        Ok(())
    }
    /// An optional number.
    pub(super) fn number(&self, key: &str, limits: Limits) -> Result<Option<f64>> {
        self.find(key).map(|i| i.number(limits)).transpose()
    }
}

/// Words in quotes, separated by commas.
pub(super) fn one_of(words: &[&str]) -> String {
    words.iter().map(|w| format!("\"{w}\"")).collect::<Vec<_>>().join(", ")
}

/// `; did you mean "..."?` where a known word is close, else nothing.
pub(super) fn did_you_mean(word: &str, known: &[&str]) -> String {
    let lower = word.to_lowercase();
    let distance = |k: &str| {
        // A forgotten unit ("spacing" for "spacing_mm") is the most frequent slip.
        let prefix = lower.len() >= 3 && (k.starts_with(&lower) || lower.starts_with(k));
        if prefix { 0 } else { strsim::damerau_levenshtein(&lower, k) }
    };
    let nearest = known.iter().map(|k| (distance(k), *k)).min_by_key(|(d, _)| *d);
    match nearest {
        Some((d, k)) if d <= 2.max(word.len() / 3) => format!("; did you mean \"{k}\"?"),
        _ => String::new(),
    }
}
