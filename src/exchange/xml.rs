//! Elements and attributes of an XML file, with messages that name file and line.

use super::NamedText;
use crate::error::{Error, Invalid, Result};
use roxmltree::{Document, Node};

/// A parsed file that knows its name.
pub(super) struct Xml<'a> {
    pub(super) name: &'a str,
    document: Document<'a>,
}

impl<'a> Xml<'a> {
    pub(super) fn parse(file: &'a NamedText) -> Result<Self> {
        let document = Document::parse(file.text.trim_start_matches('\u{feff}')).map_err(|e| Invalid::Syntax {
            file: file.name.clone(),
            line: e.pos().row as usize,
            message: format!("this is not XML: {e}"),
        })?;
        Ok(Self { name: &file.name, document })
    }
    pub(super) fn root(&self) -> Node<'_, 'a> {
        self.document.root_element()
    }
    pub(super) fn fault(&self, at: Node<'_, '_>, message: String) -> Error {
        let line = self.document.text_pos_at(at.range().start).row as usize;
        Invalid::Syntax { file: self.name.into(), line, message }.into()
    }
    /// The first element of this name below a node.
    pub(super) fn find<'n>(&self, below: Node<'n, 'a>, name: &str) -> Result<Node<'n, 'a>> {
        below
            .descendants()
            .find(|n| n.has_tag_name(name))
            .ok_or_else(|| self.fault(below, format!("<{}> has no <{name}>", below.tag_name().name())))
    }
    /// A number in an attribute.
    pub(super) fn number(&self, node: Node<'_, '_>, key: &str) -> Result<f64> {
        let text = node
            .attribute(key)
            .ok_or_else(|| self.fault(node, format!("<{}> has no attribute {key}", node.tag_name().name())))?;
        number(text).ok_or_else(|| self.fault(node, format!("{key} = \"{text}\" is not a finite number")))
    }
    /// The numbers in the text of an element.
    pub(super) fn numbers(&self, node: Node<'_, '_>) -> Result<Vec<f64>> {
        let text = node.text().unwrap_or_default();
        text.split(|c: char| c.is_whitespace() || c == ',' || c == ';')
            .filter(|w| !w.is_empty())
            .map(|w| number(w).ok_or_else(|| self.fault(node, format!("\"{w}\" is not a finite number"))))
            .collect()
    }
}

fn number(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|x: &f64| x.is_finite())
}
