//! OpenCV's file storage: named matrices, numbers and words, as YAML or XML.

use super::NamedText;
use super::xml::Xml;
use crate::error::{Invalid, Result};
use std::collections::BTreeMap;
use std::fmt::Write;
use yaml_rust2::parser::{Event, Parser};
use yaml_rust2::{Yaml, YamlLoader};

/// How the storage is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Syntax {
    Yaml,
    Xml,
}

/// A matrix, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Matrix {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) data: Vec<f64>,
}

/// What a storage holds. A scalar is among the words as it is written, and among the numbers where it is one: a camera may be called "1".
#[derive(Debug, Default)]
pub(super) struct Storage {
    pub(super) matrices: BTreeMap<String, Matrix>,
    pub(super) numbers: BTreeMap<String, f64>,
    pub(super) words: BTreeMap<String, String>,
}

/// Nodes in the order in which they are to be written.
#[derive(Debug)]
pub(super) enum Node {
    Number(String, f64),
    Word(String, String),
    Matrix(String, Matrix),
}

fn list(data: &[f64]) -> String {
    // {:?} keeps the point of whole numbers and names the number uniquely.
    data.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ")
}

/// The text of a storage.
pub(super) fn write(nodes: &[Node], syntax: Syntax) -> String {
    let mut out = String::new();
    match syntax {
        Syntax::Yaml => out.push_str("%YAML:1.0\n---\n"),
        Syntax::Xml => out.push_str("<?xml version=\"1.0\"?>\n<opencv_storage>\n"),
    }
    for node in nodes {
        // Writing to a String cannot fail.
        let _ = match (node, syntax) {
            (Node::Number(k, x), Syntax::Yaml) => writeln!(out, "{k}: {x}"),
            (Node::Number(k, x), Syntax::Xml) => writeln!(out, "<{k}>{x}</{k}>"),
            (Node::Word(k, w), Syntax::Yaml) => writeln!(out, "{k}: {}", quoted(w)),
            // In quotes, as OpenCV writes what it would else read as a number or as several words.
            (Node::Word(k, w), Syntax::Xml) => writeln!(out, "<{k}>\"{}\"</{k}>", escaped(w)),
            (Node::Matrix(k, m), Syntax::Yaml) => writeln!(
                out,
                "{k}: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [ {} ]",
                m.rows,
                m.columns,
                list(&m.data)
            ),
            (Node::Matrix(k, m), Syntax::Xml) => writeln!(
                out,
                "<{k} type_id=\"opencv-matrix\">\n  <rows>{}</rows>\n  <cols>{}</cols>\n  <dt>d</dt>\n  <data>\n    {}</data></{k}>",
                m.rows,
                m.columns,
                list(&m.data).replace(", ", " ")
            ),
        };
    }
    if syntax == Syntax::Xml {
        out.push_str("</opencv_storage>\n");
    }
    out
}

fn quoted(word: &str) -> String {
    format!("\"{}\"", word.replace('\\', "\\\\").replace('"', "\\\""))
}

fn escaped(word: &str) -> String {
    word.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Reads a storage; XML is known by its first character.
pub(super) fn read(file: &NamedText) -> Result<Storage> {
    if file.text.trim_start_matches('\u{feff}').trim_start().starts_with('<') {
        read_xml(file)
    } else {
        read_yaml(file)
    }
}

/// Line of a name in the text, from 1.
pub(super) fn line_of(file: &NamedText, key: &str) -> Option<usize> {
    let starts = |line: &str| {
        let rest = line.trim_start().trim_start_matches('<').strip_prefix(key);
        rest.is_some_and(|rest| rest.starts_with([':', ' ', '>']))
    };
    file.text.lines().position(starts).map(|line| line + 1)
}

/// What is wrong with what stands under a name.
pub(super) fn refusal(file: &NamedText, key: &str, message: String) -> crate::Error {
    fault(file, line_of(file, key).unwrap_or(1), message)
}

fn fault(file: &NamedText, line: usize, message: String) -> crate::Error {
    Invalid::Syntax { file: file.name.clone(), line, message }.into()
}

fn whole(x: f64) -> Option<usize> {
    (x >= 0.0 && x.fract() == 0.0 && x < 1e6).then_some(x as usize)
}

/// Width or height of an image: a whole number from 1.
pub(super) fn pixels(x: f64) -> Option<usize> {
    whole(x).filter(|n| *n > 0)
}

fn matrix(rows: Option<f64>, columns: Option<f64>, data: Vec<f64>) -> std::result::Result<Matrix, String> {
    let (rows, columns) = (rows.and_then(whole), columns.and_then(whole));
    let (Some(rows), Some(columns)) = (rows, columns) else {
        return Err("a matrix needs rows and cols as whole numbers".into());
    };
    if rows * columns != data.len() {
        return Err(format!("a {rows} x {columns} matrix needs {} numbers, found {}", rows * columns, data.len()));
    }
    if let Some(x) = data.iter().find(|x| !x.is_finite()) {
        return Err(format!("{x} in a matrix: expected finite numbers"));
    }
    Ok(Matrix { rows, columns, data })
}

fn yaml_number(y: &Yaml) -> Option<f64> {
    match y {
        Yaml::Integer(i) => Some(*i as f64),
        // OpenCV writes "1." and ".Nan".
        Yaml::Real(text) | Yaml::String(text) => text.parse().ok(),
        _ => None,
    }
}

fn yaml_word(y: &Yaml) -> Option<String> {
    match y {
        Yaml::Integer(i) => Some(i.to_string()),
        Yaml::Boolean(b) => Some(b.to_string()),
        Yaml::Real(text) | Yaml::String(text) => Some(text.clone()),
        _ => None,
    }
}

/// References make a few lines grow to more than any memory, and OpenCV writes none.
fn spared_of_aliases(file: &NamedText, text: &str) -> Result<()> {
    let mut parser = Parser::new_from_str(text);
    loop {
        match parser.next_token() {
            Ok((Event::Alias(_), at)) => {
                return Err(fault(file, at.line().max(1), "a reference (*name): OpenCV writes values in full".into()));
            }
            // What is no YAML is told by the reader.
            Ok((Event::StreamEnd, _)) | Err(_) => return Ok(()),
            Ok(_) => {}
        }
    }
}

fn read_yaml(file: &NamedText) -> Result<Storage> {
    // OpenCV's directive "%YAML:1.0" has a colon that YAML does not know; a line end in its place keeps line numbers.
    let text = match file.text.strip_prefix('\u{feff}').unwrap_or(&file.text).split_once('\n') {
        Some((first, rest)) if first.starts_with('%') => format!("\n{rest}"),
        _ => file.text.clone(),
    };
    spared_of_aliases(file, &text)?;
    let documents = YamlLoader::load_from_str(&text)
        .map_err(|e| fault(file, e.marker().line().max(1), format!("this is not YAML: {}", e.info())))?;
    let Some(Yaml::Hash(nodes)) = documents.first() else {
        return Err(fault(file, 1, "expected an OpenCV file storage: names with matrices".into()));
    };
    let mut out = Storage::default();
    for (key, value) in nodes {
        let Some(key) = key.as_str() else { continue };
        if let Some(data) = value["data"].as_vec() {
            let numbers = data.iter().map(|y| yaml_number(y).unwrap_or(f64::NAN)).collect();
            let found = matrix(yaml_number(&value["rows"]), yaml_number(&value["cols"]), numbers);
            out.matrices.insert(key.into(), found.map_err(|m| refusal(file, key, format!("{key}: {m}")))?);
            continue;
        }
        out.words.extend(yaml_word(value).map(|word| (key.to_string(), word)));
        out.numbers.extend(yaml_number(value).map(|x| (key.to_string(), x)));
    }
    Ok(out)
}

fn read_xml(file: &NamedText) -> Result<Storage> {
    let xml = Xml::parse(file)?;
    let mut out = Storage::default();
    for node in xml.root().children().filter(|n| n.is_element()) {
        let key = node.tag_name().name();
        if node.attribute("type_id") == Some("opencv-matrix") {
            let first =
                |name: &str| -> Result<Option<f64>> { Ok(xml.numbers(xml.find(node, name)?)?.first().copied()) };
            let data = xml.numbers(xml.find(node, "data")?)?;
            let found = matrix(first("rows")?, first("cols")?, data);
            out.matrices.insert(key.into(), found.map_err(|m| xml.fault(node, format!("{key}: {m}")))?);
        } else if let Some(text) = node.text() {
            let text = text.trim();
            let text = text.strip_prefix('"').and_then(|t| t.strip_suffix('"')).unwrap_or(text);
            out.words.insert(key.into(), text.into());
            out.numbers.extend(text.parse().ok().map(|x| (key.to_string(), x)));
        }
    }
    Ok(out)
}
