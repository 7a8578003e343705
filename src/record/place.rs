//! Where in the text of a calibration a value stands: from its path to its line, and from a byte to its path.

use std::ops::Range;

/// Line (from 1) on which the value at `path` starts in valid JSON text; the deepest part of the path that is found.
pub(super) fn line_of(text: &str, path: &str) -> usize {
    let mut found = None;
    each_value(text, &mut |at, _, line| {
        let rest = path.strip_prefix(at);
        if rest.is_some_and(|r| at.is_empty() || r.is_empty() || r.starts_with(['.', '['])) {
            // What is inside comes before what it is inside of.
            found.get_or_insert(line);
        }
    });
    found.unwrap_or(1)
}

/// Path of the innermost value of valid JSON text that a reader was in, or stood before, when it had taken `column` bytes of `line` (from 1).
pub(super) fn path_at(text: &str, line: usize, column: usize) -> String {
    let before: usize = text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
    let (byte, mut found) = (before + column, None);
    each_value(text, &mut |path, bytes, _| {
        if (bytes.start..=bytes.end).contains(&byte) {
            found.get_or_insert_with(|| path.to_owned());
        }
    });
    found.unwrap_or_default()
}

/// Calls `see` with path (`cameras[1].f_px`), bytes and line (from 1) of every value of valid JSON text, parts before the whole.
fn each_value(text: &str, see: &mut dyn FnMut(&str, Range<usize>, usize)) {
    Scan { text, at: 0, line: 1, path: String::new(), see }.value();
}

struct Scan<'a> {
    text: &'a str,
    at: usize,
    line: usize,
    path: String,
    see: &'a mut dyn FnMut(&str, Range<usize>, usize),
}

impl<'a> Scan<'a> {
    /// The next byte that is no space, comma or colon.
    fn peek(&mut self) -> Option<u8> {
        while let Some(&b) = self.text.as_bytes().get(self.at) {
            match b {
                b'\n' => self.line += 1,
                b' ' | b'\t' | b'\r' | b',' | b':' => {}
                _ => return Some(b),
            }
            self.at += 1;
        }
        None
    }

    /// The raw text between the quotes of the string that starts here.
    fn string(&mut self) -> &'a str {
        let start = self.at + 1;
        self.at = start;
        while let Some(&b) = self.text.as_bytes().get(self.at) {
            match b {
                b'"' => break,
                b'\\' => self.at += 2,
                _ => self.at += 1,
            }
        }
        let inside = self.text.get(start..self.at).unwrap_or_default();
        self.at += 1;
        inside
    }

    fn value(&mut self) {
        let Some(open) = self.peek() else { return };
        let (start, line) = (self.at, self.line);
        match open {
            b'"' => {
                self.string();
            }
            b'{' | b'[' => self.members(open == b'{'),
            _ => {
                let rest = &self.text[start..];
                self.at += rest.find([',', ']', '}', ' ', '\t', '\r', '\n']).unwrap_or(rest.len());
            }
        }
        (self.see)(&self.path, start..self.at, line);
    }

    fn members(&mut self, object: bool) {
        self.at += 1;
        let whole = self.path.len();
        for index in 0usize.. {
            match self.peek() {
                None => return,
                Some(b'}' | b']') => break,
                Some(_) if object => {
                    let key = self.string();
                    self.path.push_str(if whole > 0 { "." } else { "" });
                    self.path.push_str(key);
                }
                Some(_) => self.path.push_str(&format!("[{index}]")),
            }
            self.value();
            self.path.truncate(whole);
        }
        self.at += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "{\n  \"a\": 1,\n  \"list\": [[1, 2], {\"b\\\"\": \"x]\", \"c\": [] }],\n  \"a_\": -3e4\n}";

    #[test]
    fn a_path_has_the_line_of_its_deepest_part() {
        for (path, line) in
            [("", 1), ("a", 2), ("list[1].c", 3), ("list[7].c", 3), ("a_", 4), ("a.b", 2), ("nothing", 1)]
        {
            assert_eq!(line_of(TEXT, path), line, "{path}");
        }
    }

    #[test]
    fn a_byte_has_the_path_of_what_it_ends() {
        for (line, end, path) in [
            (2, "\"a\": 1", "a"),
            (3, "[[1, 2", "list[0][1]"),
            (3, "[[1, 2]", "list[0]"),
            (3, "\"x]\"", "list[1].b\\\""),
            (3, "\"c\": [", "list[1].c"),
            (3, "\"c\": [] }", "list[1]"),
            (4, "-3e4", "a_"),
            (5, "}", ""),
            // Where a list is refused before it is read.
            (3, "\"c\": ", "list[1].c"),
            (3, "[", "list[0]"),
        ] {
            let row = TEXT.lines().nth(line - 1).unwrap();
            let column = row.find(end).unwrap() + end.len();
            assert_eq!(path_at(TEXT, line, column), path, "{end}");
        }
    }
}
