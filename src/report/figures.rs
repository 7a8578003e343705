//! Overlays inside the HTML: the image shrunk to a JPEG, everything else as SVG lines over it, sharp at any size.

use super::captions;
use super::grey::{self, Background};
use super::number::{count, plain};
use super::overlay::{self, OverlayShapes};
use super::svg::{escape, num, path_data};
use crate::error::{Error, Result};
use crate::image::GrayView;
use crate::record::FeatureKind;
use base64::Engine;
use image::ImageEncoder;
use image::codecs::jpeg::JpegEncoder;
use std::fmt::Write;

/// JPEG quality of the backgrounds.
const QUALITY: u8 = 75;
/// Points of a contour in the HTML; chords lie at most a thousandth of the radius inside the curve.
const CONTOUR_POINTS: usize = 72;
/// Arrows of one picture; beyond that only every second, third, ... is drawn.
const MOST_ARROWS: usize = 2500;

/// Background width for this many pictures in a report, px: a report stays a file that can be mailed.
pub(super) fn background_width_px(pictures: usize) -> usize {
    match pictures {
        0..=24 => 1280,
        25..=60 => 850,
        _ => 500,
    }
}

/// One overlay as it stands in the page.
pub(super) struct Figure<'a> {
    /// Distinguishes the page's pictures.
    pub(super) id: &'a str,
    /// Spoken title.
    pub(super) title: &'a str,
    /// Factor of the residual arrows.
    pub(super) factor: f64,
    /// Largest width of the background, px.
    pub(super) max_width: usize,
}

/// The image as a `data:` address.
fn data_uri(ground: &Background) -> Result<String> {
    let mut bytes = Vec::new();
    let size = |n: usize| u32::try_from(n).map_err(|_| Error::Bug(format!("a picture of {n} px")));
    JpegEncoder::new_with_quality(&mut bytes, QUALITY)
        .write_image(&ground.levels, size(ground.width)?, size(ground.height)?, image::ExtendedColorType::L8)
        .map_err(|e| Error::Bug(format!("picture of the report: {e}")))?;
    Ok(format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes)))
}

/// The overlay as SVG, and words on how its arrows were drawn.
///
/// # Errors
/// [`Error::Bug`] where the background cannot be encoded.
pub(super) fn overlay_svg(
    image: &GrayView<'_>,
    shapes: &OverlayShapes,
    figure: &Figure<'_>,
) -> Result<(String, String)> {
    let (width, height) = (image.width(), image.height());
    let ground = grey::shrunk(image, figure.max_width);
    let [span_u, span_v] = ground.span_px();
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-0.5 -0.5 {width} {height}\" role=\"img\"><title>{}</title>\
         <image x=\"-0.5\" y=\"-0.5\" width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\" href=\"{}\"/>",
        escape(figure.title),
        num(span_u),
        num(span_v),
        data_uri(&ground)?
    );
    let limit_px = overlay::arrow_limit_px(width, height);
    let (used, outliers, mut words) = arrow_paths(shapes, figure.factor, limit_px, width as f64);
    layer(&mut out, figure.id, "help", &polylines(&shapes.lines));
    layer(&mut out, figure.id, "contour", &polylines(&shapes.contours));
    let ellipses: String =
        shapes.ellipses.iter().map(|e| path_data(thinned(&overlay::ellipse_points(e)), true)).collect();
    layer(&mut out, figure.id, "model", &(polylines(&shapes.predicted) + &ellipses));
    layer(&mut out, figure.id, "arrow", &used);
    layer(&mut out, figure.id, "bad", &(outliers + &crosses(shapes) + &polylines(&shapes.unseen)));
    let silent = texts(&mut out, shapes, (width, height));
    if silent > 0 {
        let mark = if words.is_empty() { "" } else { "; " };
        let _ = write!(words, "{mark}no room for {}", count(silent, "label"));
    }
    out.push_str("</svg>");
    Ok((out, words))
}

/// One path, drawn twice: a dark ground and the colour on it.
fn layer(out: &mut String, id: &str, class: &str, data: &str) {
    if !data.is_empty() {
        let _ = write!(
            out,
            "<defs><path class=\"o-line\" id=\"{id}-{class}\" d=\"{data}\"/></defs>\
             <use class=\"o-halo\" href=\"#{id}-{class}\"/><use class=\"o-{class}\" href=\"#{id}-{class}\"/>"
        );
    }
}

fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let step = points.len().div_ceil(CONTOUR_POINTS).max(1);
    points.iter().step_by(step).copied().collect()
}

fn polylines(lines: &[overlay::Polyline]) -> String {
    lines
        .iter()
        .map(|l| {
            let points: Vec<_> = l.points().collect();
            // An open line must keep its end.
            let kept = if l.closed { thinned(&points) } else { points };
            path_data(kept, l.closed)
        })
        .collect()
}

/// Paths of used features and of outliers, and what was left out, in words.
fn arrow_paths(shapes: &OverlayShapes, factor: f64, limit_px: f64, width: f64) -> (String, String, String) {
    let marks = &shapes.marks;
    let (mut used, mut outliers) = (String::new(), String::new());
    let r = 0.004 * width;
    for i in 0..marks.len() {
        let (at, out) = ([marks.u_px[i], marks.v_px[i]], if marks.outlier[i] { &mut outliers } else { &mut used });
        match marks.kind[i] {
            FeatureKind::Edge => {}
            FeatureKind::Point => {
                let corners = [[at[0] - r, at[1]], [at[0], at[1] - r], [at[0] + r, at[1]], [at[0], at[1] + r]];
                out.push_str(&path_data(corners, true));
            }
            FeatureKind::DiscCentre => {
                out.push_str(&path_data([[at[0] - r, at[1]], [at[0] + r, at[1]]], false));
                out.push_str(&path_data([[at[0], at[1] - r], [at[0], at[1] + r]], false));
            }
        }
    }
    let step = marks.len().div_ceil(MOST_ARROWS).max(1);
    let (mut any, mut cut) = (false, false);
    for (i, arrow) in overlay::arrows(marks, factor, limit_px).enumerate() {
        if i % step != 0 && !arrow.outlier {
            continue;
        }
        any = true;
        cut |= arrow.cut;
        let out = if arrow.outlier { &mut outliers } else { &mut used };
        out.push_str(&path_data([arrow.from, arrow.to], false));
        if let Some(head) = overlay::head(&arrow, 0.006 * width) {
            out.push_str(&path_data(head, false));
        }
    }
    let mut words = String::new();
    if any {
        let _ = write!(words, "residuals × {}", plain(factor, 3));
        if step > 1 {
            let _ = write!(words, ", one arrow in {step}");
        }
        if cut {
            words.push_str(", longest cut");
        }
    }
    (used, outliers, words)
}

fn crosses(shapes: &OverlayShapes) -> String {
    let mut out = String::new();
    for mark in &shapes.rejected {
        let ([u, v], r) = (mark.at_px, overlay::cross_px(mark, 1.0));
        out.push_str(&path_data([[u - r, v - r], [u + r, v + r]], false));
        out.push_str(&path_data([[u - r, v + r], [u + r, v - r]], false));
    }
    out
}

/// Names and reasons where there is room for them; returns how many had none.
fn texts(out: &mut String, shapes: &OverlayShapes, (width, height): (usize, usize)) -> usize {
    // Letters no larger than small discs are, as long as they can be read enlarged.
    let wide = width as f64;
    let size = (2.0 * overlay::typical_radius_px([shapes])).clamp(0.008 * wide, 0.017 * wide);
    let (placed, silent) = captions::arrange(shapes, (width, height), [0.0; 2], [0.6 * size, size], 1.0);
    for caption in placed {
        let _ = write!(
            out,
            "<text class=\"{}\" style=\"font-size:{}px;stroke-width:{}px\" x=\"{}\" y=\"{}\">{}</text>",
            if caption.reason { "o-reason" } else { "o-label" },
            num(size),
            num(0.16 * size),
            num(caption.at_px[0]),
            num(caption.at_px[1] + 0.8 * size),
            escape(caption.text)
        );
    }
    silent
}
