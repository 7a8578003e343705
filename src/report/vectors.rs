//! Three components as a picture: arrows in the plane over colours for w, axes in mm, doubtful vectors marked. One SVG file.

use super::number::{nice_below, plain, significant};
use super::svg::{bounds, colour, escape, label, line, num, open, path, path_data};
use std::fmt::Write;

/// Width of the field and room for its labels, px of the picture.
const FIELD_PX: f64 = 720.0;
const LEFT_PX: f64 = 64.0;
const TOP_PX: f64 = 44.0;
/// A high field is drawn smaller.
const HIGHEST_PX: f64 = 720.0;
/// Arrows along the longer side at most; colours are drawn for every vector.
const ARROWS: usize = 48;
/// Colours from the smallest to the largest w, blue over white to red; beyond these parts of all vectors they stay the same.
const QUANTILES: [f64; 2] = [0.01, 0.99];
const STOPS: [[f64; 3]; 3] = [[33.0, 102.0, 172.0], [247.0, 247.0, 247.0], [178.0, 24.0, 43.0]];

const STYLE: &str = "text{font:13px system-ui,sans-serif;fill:#1b1f24}.tick{font-size:12px;fill:#444}.title{font-size:15px;font-weight:600}\
path{fill:none;stroke-linecap:round;stroke-linejoin:round}.axis{stroke:#444;stroke-width:1}.arrow{stroke:#111;stroke-width:1.1}\
.flagged{stroke:#00b35a;stroke-width:1.8}.missing{stroke:#999;stroke-width:3}";

/// What a picture of vectors shows: lists of one length, one element per point of a regular grid.
#[derive(Debug, Clone, Copy)]
pub struct VectorPicture<'a> {
    /// Line above the picture.
    pub title: &'a str,
    /// Places, mm.
    pub x_mm: &'a [f64],
    /// Places, mm; up.
    pub y_mm: &'a [f64],
    /// Displacements (u, v, w), mm; not finite where there is no vector.
    pub displacement_mm: [&'a [f64]; 3],
    /// Whether a vector is doubtful.
    pub flagged: &'a [bool],
    /// Distance of neighbouring points, mm.
    pub spacing_mm: f64,
    /// Name of the camera towards which w is positive.
    pub towards: &'a str,
}

/// From the field to the picture.
struct Frame {
    x0_mm: f64,
    y1_mm: f64,
    px_per_mm: f64,
    width_px: f64,
    height_px: f64,
}

impl Frame {
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        [LEFT_PX + (x - self.x0_mm) * self.px_per_mm, TOP_PX + (self.y1_mm - y) * self.px_per_mm]
    }
}

/// Sorted finite values to a quantile; 0 without any.
fn quantile(sorted: &[f64], part: f64) -> f64 {
    sorted.get((part * sorted.len().saturating_sub(1) as f64).round() as usize).copied().unwrap_or(0.0)
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut out: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    out.sort_by(f64::total_cmp);
    out
}

/// Which colours stand for low and high: white is zero, or the end next to it where w has one sign only.
fn parts([low, high]: [f64; 2]) -> [f64; 2] {
    if low >= 0.0 {
        [0.5, 1.0]
    } else if high <= 0.0 {
        [0.0, 0.5]
    } else {
        [0.0, 1.0]
    }
}

/// Ends of the colours: the same on both sides of zero where w has both signs.
fn scale(w: impl Iterator<Item = f64>) -> [f64; 2] {
    let w = sorted(w);
    let [low, high] = QUANTILES.map(|q| quantile(&w, q));
    let [low, high] = if low < 0.0 && high > 0.0 { [-high.max(-low), high.max(-low)] } else { [low, high] };
    if high > low { [low, high] } else { [low - 0.5e-3, high + 0.5e-3] }
}

/// The picture as the text of an SVG file.
pub fn vectors_svg(p: &VectorPicture) -> String {
    let ([x0, x1], [y0, y1]) = (bounds(p.x_mm), bounds(p.y_mm));
    let half = 0.5 * p.spacing_mm;
    let (wide, high) = (x1 - x0 + p.spacing_mm, y1 - y0 + p.spacing_mm);
    let px_per_mm = (FIELD_PX / wide).min(HIGHEST_PX / high);
    let f = Frame {
        x0_mm: x0 - half,
        y1_mm: y1 + half,
        px_per_mm,
        width_px: wide * px_per_mm,
        height_px: high * px_per_mm,
    };
    let [total_width, total_height] = [LEFT_PX + f.width_px.max(480.0) + 120.0, TOP_PX + f.height_px + 96.0];
    let mut out = open(total_width, total_height, p.title);
    let _ = write!(
        out,
        "<style>{STYLE}</style><rect width=\"{}\" height=\"{}\" fill=\"#fff\"/>",
        num(total_width),
        num(total_height)
    );
    label(&mut out, "title", [LEFT_PX, 26.0], "start", p.title);
    let good = |i: usize| !p.flagged[i];
    let limits = scale((0..p.x_mm.len()).filter(|i| good(*i)).map(|i| p.displacement_mm[2][i]));
    cells(&mut out, p, &f, limits);
    axes(&mut out, &f);
    arrows(&mut out, p, &f);
    bar(&mut out, p, &f, limits);
    out.push_str("</svg>\n");
    out
}

/// One square per vector in the colour of w.
fn cells(out: &mut String, p: &VectorPicture, f: &Frame, [low, high]: [f64; 2]) {
    let [from, to] = parts([low, high]);
    let side = num(p.spacing_mm * f.px_per_mm + 0.4);
    for i in 0..p.x_mm.len() {
        let w = p.displacement_mm[2][i];
        if w.is_finite() {
            let [x, y] = f.at(p.x_mm[i] - 0.5 * p.spacing_mm, p.y_mm[i] + 0.5 * p.spacing_mm);
            let fill = colour(&STOPS, from + (to - from) * ((w - low) / (high - low)).clamp(0.0, 1.0));
            let _ = write!(
                out,
                "<rect x=\"{}\" y=\"{}\" width=\"{side}\" height=\"{side}\" fill=\"{fill}\"/>",
                num(x),
                num(y)
            );
        }
    }
}

fn axes(out: &mut String, f: &Frame) {
    let (right, bottom) = (LEFT_PX + f.width_px, TOP_PX + f.height_px);
    let frame = [[LEFT_PX, TOP_PX], [right, TOP_PX], [right, bottom], [LEFT_PX, bottom]];
    path(out, "axis", &path_data(frame, true));
    let step = nice_below(f.width_px.max(f.height_px) / f.px_per_mm / 5.0);
    let ticks = |from: f64, length_px: f64| {
        let to = from + length_px / f.px_per_mm;
        ((from / step).ceil() as i64..=(to / step).floor() as i64).map(move |k| k as f64 * step)
    };
    for x in ticks(f.x0_mm, f.width_px) {
        let at = f.at(x, 0.0)[0];
        line(out, "axis", [at, bottom], [at, bottom + 5.0]);
        label(out, "tick", [at, bottom + 19.0], "middle", &plain(x, 4).replace('-', "\u{2212}"));
    }
    for y in ticks(f.y1_mm - f.height_px / f.px_per_mm, f.height_px) {
        let at = f.at(0.0, y)[1];
        line(out, "axis", [LEFT_PX - 5.0, at], [LEFT_PX, at]);
        label(out, "tick", [LEFT_PX - 8.0, at + 4.0], "end", &plain(y, 4).replace('-', "\u{2212}"));
    }
    label(out, "", [LEFT_PX + 0.5 * f.width_px, bottom + 38.0], "middle", "x, mm");
    let y = TOP_PX + 0.5 * f.height_px;
    let _ = write!(
        out,
        "<text x=\"16\" y=\"{}\" text-anchor=\"middle\" transform=\"rotate(-90 16 {})\">y, mm</text>",
        num(y),
        num(y)
    );
}

/// Arrows begin at their point; below the picture stands how long one is.
fn arrows(out: &mut String, p: &VectorPicture, f: &Frame) {
    let [u, v, _] = p.displacement_mm;
    let every = ((f.width_px.max(f.height_px) / f.px_per_mm / p.spacing_mm) as usize).div_ceil(ARROWS).max(1);
    let node = |mm: f64| ((mm / p.spacing_mm).round() as usize).is_multiple_of(every);
    let (x0, y1) = (f.x0_mm + 0.5 * p.spacing_mm, f.y1_mm - 0.5 * p.spacing_mm);
    let shown: Vec<usize> = (0..p.x_mm.len()).filter(|i| node(p.x_mm[*i] - x0) && node(y1 - p.y_mm[*i])).collect();
    let lengths = sorted(shown.iter().filter(|i| !p.flagged[**i]).map(|i| u[*i].hypot(v[*i])));
    let longest = quantile(&lengths, 0.98);
    // A long arrow reaches over one and a half of its neighbours' distance.
    let per_mm = if longest > 0.0 { 1.5 * p.spacing_mm * every as f64 * f.px_per_mm / longest } else { 1.0 };
    for &i in &shown {
        let [x, y] = f.at(p.x_mm[i], p.y_mm[i]);
        if !(u[i].is_finite() && v[i].is_finite()) {
            path(out, "missing", &path_data([[x, y], [x + 0.01, y]], false));
        } else if !p.flagged[i] || u[i].hypot(v[i]) <= 2.0 * longest {
            arrow(out, "arrow", [x, y], [per_mm * u[i], -per_mm * v[i]]);
        }
    }
    for i in (0..p.x_mm.len()).filter(|i| p.flagged[*i] && u[*i].is_finite()) {
        let [x, y] = f.at(p.x_mm[i], p.y_mm[i]);
        let r = 3.5;
        path(out, "flagged", &path_data([[x - r, y - r], [x + r, y + r]], false));
        path(out, "flagged", &path_data([[x - r, y + r], [x + r, y - r]], false));
    }
    let y = TOP_PX + f.height_px + 72.0;
    let key_mm = nice_below(if longest > 0.0 { longest } else { 1.0 });
    arrow(out, "arrow", [LEFT_PX, y - 4.0], [key_mm * per_mm, 0.0]);
    let x = LEFT_PX + key_mm * per_mm + 8.0;
    let more = if every > 1 { format!(" (one of {every} in x and y)") } else { String::new() };
    label(out, "tick", [x, y], "start", &format!("{} mm in the plane{more}", plain(key_mm, 3)));
    path(out, "flagged", &path_data([[x + 256.5, y - 7.5], [x + 263.5, y - 0.5]], false));
    path(out, "flagged", &path_data([[x + 256.5, y - 0.5], [x + 263.5, y - 7.5]], false));
    label(out, "tick", [x + 270.0, y], "start", "flagged");
    path(out, "missing", &path_data([[x + 340.0, y - 4.0], [x + 340.01, y - 4.0]], false));
    label(out, "tick", [x + 348.0, y], "start", "no vector");
}

fn arrow(out: &mut String, class: &str, [x, y]: [f64; 2], [dx, dy]: [f64; 2]) {
    let length = dx.hypot(dy);
    let to = [x + dx, y + dy];
    let mut data = path_data([[x, y], to], false);
    if length > 3.0 {
        let head = 4.0_f64.min(0.5 * length);
        let (ux, uy) = (head * dx / length, head * dy / length);
        let sides =
            [[to[0] - ux - 0.5 * uy, to[1] - uy + 0.5 * ux], to, [to[0] - ux + 0.5 * uy, to[1] - uy - 0.5 * ux]];
        data += &path_data(sides, false);
    }
    path(out, class, &data);
}

fn bar(out: &mut String, p: &VectorPicture, f: &Frame, [low, high]: [f64; 2]) {
    const PARTS: u32 = 64;
    let (x, length) = (LEFT_PX + f.width_px + 24.0, f.height_px.min(320.0));
    let top = TOP_PX + 0.5 * (f.height_px - length);
    let [from, to] = parts([low, high]);
    for k in 0..PARTS {
        let part = f64::from(k) / f64::from(PARTS);
        let _ = write!(
            out,
            "<rect x=\"{}\" y=\"{}\" width=\"16\" height=\"{}\" fill=\"{}\"/>",
            num(x),
            num(top + length * (1.0 - part - 1.0 / f64::from(PARTS))),
            num(length / f64::from(PARTS) + 0.4),
            colour(&STOPS, from + (to - from) * (f64::from(k) + 0.5) / f64::from(PARTS))
        );
    }
    for (w, y) in [(high, top), (0.5 * (low + high), top + 0.5 * length), (low, top + length)] {
        line(out, "axis", [x + 16.0, y], [x + 20.0, y]);
        let text = if w == 0.0 { "0".into() } else { significant(w, 2).replace('-', "\u{2212}") };
        label(out, "tick", [x + 24.0, y + 4.0], "start", &text);
    }
    label(out, "", [x, top - 12.0], "start", "w, mm");
    let _ = write!(
        out,
        "<text class=\"tick\" x=\"{0}\" y=\"{1}\" text-anchor=\"middle\" transform=\"rotate(-90 {0} {1})\">positive towards {2}</text>",
        num(x + 82.0),
        num(top + 0.5 * length),
        escape(p.towards)
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A 5 x 4 field, 2 mm apart: w rises with x, one vector flagged, one missing.
    fn picture(extent: f64) -> String {
        let (mut x, mut y, mut u, mut v, mut w) = (vec![], vec![], vec![], vec![], vec![]);
        for j in 0..4 {
            for i in 0..5 {
                x.push(extent * f64::from(i));
                y.push(-extent * f64::from(j));
                u.push(0.3);
                v.push(0.1 * f64::from(j));
                w.push(0.2 * (f64::from(i) - 2.0));
            }
        }
        u[7] = f64::NAN;
        v[7] = f64::NAN;
        w[7] = f64::NAN;
        let mut flagged = vec![false; 20];
        flagged[12] = true;
        let p = VectorPicture {
            title: "a <b> & c",
            x_mm: &x,
            y_mm: &y,
            displacement_mm: [&u, &v, &w],
            flagged: &flagged,
            spacing_mm: extent,
            towards: "left",
        };
        vectors_svg(&p)
    }

    #[test]
    fn every_vector_is_drawn_once_and_what_is_doubtful_is_marked() {
        for extent in [2.0, 0.013, 400.0] {
            let svg = picture(extent);
            let tree = roxmltree::Document::parse(&svg).unwrap();
            let count = |class: &str| tree.descendants().filter(|n| n.attribute("class") == Some(class)).count();
            // 20 less the missing, and the key; the legend repeats the marks.
            assert_eq!((count("arrow"), count("flagged"), count("missing")), (20, 4, 2), "{extent}");
            let rects: Vec<_> = tree.descendants().filter(|n| n.has_tag_name("rect")).collect();
            assert_eq!(rects.len(), 1 + 19 + 64);
            // w from -0.4 to 0.4: the ends of the colours and white for zero.
            let fill = |i: usize| rects[1 + i].attribute("fill").unwrap();
            assert_eq!([fill(0), fill(2), fill(4)], ["rgb(33,102,172)", "rgb(247,247,247)", "rgb(178,24,43)"]);
            for text in ["w, mm", "x, mm", "y, mm", "positive towards left", "0.40", "a &lt;b&gt; &amp; c"] {
                assert!(svg.contains(text), "{text}");
            }
            assert!(!svg.contains("NaN") && !svg.contains("inf"));
        }
    }

    #[test]
    fn white_is_zero_or_what_is_next_to_it() {
        assert_eq!([[-1.0, 1.0], [0.2, 0.4], [-0.4, -0.2]].map(parts), [[0.0, 1.0], [0.5, 1.0], [0.0, 0.5]]);
        assert_eq!(scale([-0.1, 0.4, f64::NAN].into_iter()), [-0.4, 0.4]);
        assert_eq!(scale([0.2, 0.4].into_iter()), [0.2, 0.4]);
        let [low, high] = scale([].into_iter());
        assert!(low < high);
    }
}
