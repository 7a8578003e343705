//! The little of XML that the report writes: escaped text, numbers, elements.

use std::fmt::Write;

/// Text or attribute value: the five special characters escaped, characters that XML forbids replaced.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' => out.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// A coordinate with two decimals at most; what is not finite is 0 (callers leave such marks out).
pub(super) fn num(x: f64) -> String {
    let mut out = String::new();
    push_num(&mut out, x);
    out
}

/// As [`num`], at the end of a text: a page holds tens of thousands of them.
fn push_num(out: &mut String, x: f64) {
    let hundredths = (x * 100.0).round();
    // Pictures end far below this.
    if !(hundredths.abs() < 1e15) {
        out.push('0');
        return;
    }
    let (sign, whole) = (if hundredths < 0.0 { "-" } else { "" }, hundredths.abs() as u64);
    let (tenths, rest) = (whole % 100 / 10, whole % 10);
    let _ = match (tenths, rest) {
        (0, 0) => write!(out, "{sign}{}", whole / 100),
        (t, 0) => write!(out, "{sign}{}.{t}", whole / 100),
        (t, r) => write!(out, "{sign}{}.{t}{r}", whole / 100),
    };
}

/// Path data of a chain of points; points that are not finite are left out.
pub(super) fn path_data(points: impl IntoIterator<Item = [f64; 2]>, closed: bool) -> String {
    let mut out = String::new();
    for [x, y] in points {
        if x.is_finite() && y.is_finite() {
            out.push(if out.is_empty() { 'M' } else { 'L' });
            push_num(&mut out, x);
            out.push(' ');
            push_num(&mut out, y);
        }
    }
    if closed && !out.is_empty() {
        out.push('Z');
    }
    out
}

/// `<path class d>`, or nothing for an empty path.
pub(super) fn path(out: &mut String, class: &str, data: &str) {
    if !data.is_empty() {
        let _ = write!(out, "<path class=\"{class}\" d=\"{data}\"/>");
    }
}

/// A text element; `anchor` is `start`, `middle` or `end`.
pub(super) fn label(out: &mut String, class: &str, at: [f64; 2], anchor: &str, text: &str) {
    let _ = write!(
        out,
        "<text class=\"{class}\" x=\"{}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
        num(at[0]),
        num(at[1]),
        escape(text)
    );
}

/// A straight line.
pub(super) fn line(out: &mut String, class: &str, from: [f64; 2], to: [f64; 2]) {
    path(out, class, &path_data([from, to], false));
}

/// Opening tag of a picture with the view box `(0, 0, width, height)` and a spoken title.
/// Smallest and largest of the finite ones.
pub(super) fn bounds(values: &[f64]) -> [f64; 2] {
    let finite = values.iter().copied().filter(|v| v.is_finite());
    finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)])
}

/// The colour at a part (0 to 1) of a scale with evenly spaced stops.
pub(super) fn colour(stops: &[[f64; 3]], part: f64) -> String {
    let t = part.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let k = (t.floor() as usize).min(stops.len() - 2);
    let mix = |a: usize| (stops[k][a] + (t - k as f64) * (stops[k + 1][a] - stops[k][a])).round();
    format!("rgb({},{},{})", mix(0), mix(1), mix(2))
}

pub(super) fn open(width: f64, height: f64, title: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" role=\"img\"><title>{}</title>",
        num(width),
        num(height),
        escape(title)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_escapes() {
        assert_eq!(escape("a<b>&\"'\u{0}\u{1b}é"), "a&lt;b&gt;&amp;&quot;&#39;\u{fffd}\u{fffd}é");
    }

    #[test]
    fn coordinates_are_short_and_finite() {
        assert_eq!([num(1.0), num(-0.001), num(2.345678), num(f64::NAN)], ["1", "0", "2.35", "0"]);
        assert_eq!(path_data([[0.0, 1.0], [f64::NAN, 2.0], [3.0, 4.5]], true), "M0 1L3 4.5Z");
    }
}
