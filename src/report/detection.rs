//! What was found in one image: CSV, JSON and what to draw.
//!
//! Lengths px, (0, 0) the centre of the first pixel; angles in degrees in columns ending in `_deg`, from +u towards +v.

use super::overlay::{Label, Marks, OverlayShapes, Polyline, RejectedMark};
use crate::bitangent::{Bitangents, EXTERNAL_CROSSING, NAMES, POINTS, bitangents};
use crate::detect::{Detection, Disc};
use crate::record::FeatureKind;
use crate::target::{MarkKind, Polarity};
use nalgebra::SMatrix;
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// Value of the key `format` of a detection.
pub const DETECTION_FORMAT: &str = "spivcal-detection";

/// A feature of a pair of discs: name (see [`crate::bitangent::NAMES`]), place and standard deviations, px.
struct Feature {
    name: &'static str,
    at_px: [f64; 2],
    sigma_px: [f64; 2],
}

/// One row per disc: ellipse, standard deviations, blur, contrast.
pub fn discs_csv(detection: &Detection) -> String {
    let mut out = String::from(
        "disc,u_px,v_px,semi_major_px,semi_minor_px,angle_deg,sigma_u_px,sigma_v_px,sigma_semi_major_px,\
         sigma_semi_minor_px,sigma_angle_deg,polarity,blur_px,contrast,mark,edge_points\n",
    );
    for (i, disc) in detection.discs.iter().enumerate() {
        let _ = write!(out, "{i}");
        for x in ellipse(disc).into_iter().chain(sigmas(disc)) {
            number(&mut out, x);
        }
        let _ = write!(out, ",{}", polarity(disc.polarity));
        number(&mut out, disc.blur_px);
        number(&mut out, disc.contrast);
        let _ = writeln!(out, ",{},{}", disc.mark.map_or("", mark), disc.edge.u_px.len());
    }
    out
}

/// One row per edge point of every disc, already corrected for blur.
pub fn contours_csv(detection: &Detection) -> String {
    let mut out = String::from("disc,u_px,v_px,sigma_px\n");
    for (i, disc) in detection.discs.iter().enumerate() {
        let e = &disc.edge;
        for ((u, v), sigma) in e.u_px.iter().zip(&e.v_px).zip(&e.sigma_px) {
            let _ = write!(out, "{i}");
            [u, v, sigma].into_iter().for_each(|x| number(&mut out, *x));
            out.push('\n');
        }
    }
    out
}

/// The 14 common-tangent features of a pair, one row each; none unless exactly two separate discs were found.
pub fn features_csv(detection: &Detection) -> Option<String> {
    let (features, _) = features(detection)?;
    let mut out = String::from("feature,u_px,v_px,sigma_u_px,sigma_v_px\n");
    for f in features {
        out.push_str(f.name);
        f.at_px.into_iter().chain(f.sigma_px).for_each(|x| number(&mut out, x));
        out.push('\n');
    }
    Some(out)
}

/// Everything that was found in an image, as JSON; `image` is its name.
pub fn detection_json(image: &str, size_px: [usize; 2], detection: &Detection) -> String {
    let value = json!({
        "format": DETECTION_FORMAT, "version": 1,
        "image": image, "image_size_px": size_px,
        "discs": detection.discs.iter().map(disc_json).collect::<Vec<_>>(),
        "features": features(detection).map(|(f, _)| f.iter().map(feature_json).collect::<Vec<_>>()),
        "marks": detection.shapes.iter().map(|s| json!({
            "kind": mark(s.mark), "center_px": [s.center_px.u_px, s.center_px.v_px], "radius_px": s.radius_px,
        })).collect::<Vec<_>>(),
        "rejections": detection.rejections.iter().map(|r| json!({
            "center_px": [r.center_px.u_px, r.center_px.v_px], "radius_px": r.radius_px, "reason": r.reason.to_string(),
        })).collect::<Vec<_>>(),
    });
    format!("{value:#}\n")
}

/// What an overlay of a detection shows: contours, ellipses, common tangents and features of a pair, rejected candidates.
pub fn detection_shapes(detection: &Detection) -> OverlayShapes {
    let mut shapes = OverlayShapes::default();
    for (i, disc) in detection.discs.iter().enumerate() {
        shapes.push_disc(disc);
        let c = disc.ellipse.center_px;
        let reach_px = disc.ellipse.semi_major_px;
        shapes.labels.push(Label { at_px: [c.u_px, c.v_px], reach_px, text: disc_label(i, disc) });
    }
    for s in &detection.shapes {
        let (at_px, text) = ([s.center_px.u_px, s.center_px.v_px], mark(s.mark).to_string());
        shapes.labels.push(Label { at_px, reach_px: s.radius_px, text });
    }
    if let Some((features, b)) = features(detection) {
        shapes.lines = tangent_lines(&b);
        let mut marks = Marks::default();
        features.iter().for_each(|f| marks.push(f.at_px, [f64::NAN; 2], FeatureKind::Point, false));
        shapes.marks = marks;
    }
    shapes.rejected = detection
        .rejections
        .iter()
        .map(|r| RejectedMark {
            at_px: [r.center_px.u_px, r.center_px.v_px],
            radius_px: r.radius_px,
            // Numbers would cover the picture; they are in the JSON.
            reason: r.reason.kind().into(),
        })
        .collect();
    shapes
}

fn features(detection: &Detection) -> Option<(Vec<Feature>, Bitangents)> {
    let [first, second] = detection.discs.as_slice() else { return None };
    let b = bitangents(&first.ellipse, &second.ellipse).ok()?;
    let covariance = b.covariance([&first.covariance, &second.covariance]);
    let feature = |i: usize| {
        let p = b.point(i)?;
        let sigma = |k: usize| covariance[(2 * i + k, 2 * i + k)].max(0.0).sqrt();
        Some(Feature { name: NAMES[i], at_px: [p.x, p.y], sigma_px: [sigma(0), sigma(1)] })
    };
    Some(((0..POINTS).filter_map(feature).collect(), b))
}

/// Each tangent from its first to its last feature; the crossing of the external ones may be far outside.
fn tangent_lines(b: &Bitangents) -> Vec<Polyline> {
    let on_line = |line: usize| {
        let crossings = crate::bitangent::CROSSINGS.iter().enumerate();
        let crossing = crossings.filter(move |(_, l)| l.contains(&line)).map(|(i, _)| EXTERNAL_CROSSING + i);
        [2 * line, 2 * line + 1].into_iter().chain(crossing.filter(|i| *i != EXTERNAL_CROSSING))
    };
    (0..4)
        .filter_map(|line| {
            let n = b.lines[line].normal;
            let along = |p: &nalgebra::Vector2<f64>| p.y * n.x - p.x * n.y;
            let points: Vec<_> = on_line(line).filter_map(|i| b.point(i)).collect();
            let first = points.iter().min_by(|p, q| along(p).total_cmp(&along(q)))?;
            let last = points.iter().max_by(|p, q| along(p).total_cmp(&along(q)))?;
            Some(Polyline { u_px: vec![first.x, last.x], v_px: vec![first.y, last.y], closed: false })
        })
        .collect()
}

fn disc_label(index: usize, disc: &Disc) -> String {
    disc.mark.map_or(index.to_string(), |m| format!("{index} {}", mark(m)))
}

fn ellipse(disc: &Disc) -> [f64; 5] {
    let p = disc.ellipse.parameters();
    [p[0], p[1], p[2], p[3], p[4].to_degrees()]
}

fn sigmas(disc: &Disc) -> [f64; 5] {
    let s = |i: usize| disc.covariance[(i, i)].max(0.0).sqrt();
    [s(0), s(1), s(2), s(3), s(4).to_degrees()]
}

fn disc_json(disc: &Disc) -> Value {
    let ([u, v, a, b, angle], e) = (ellipse(disc), &disc.edge);
    json!({
        "ellipse": { "center_px": [u, v], "semi_major_px": a, "semi_minor_px": b, "angle_deg": angle },
        "covariance": { "names": ["u_px", "v_px", "semi_major_px", "semi_minor_px", "angle_rad"], "matrix": rows(&disc.covariance) },
        "polarity": polarity(disc.polarity), "blur_px": disc.blur_px, "contrast": disc.contrast,
        "mark": disc.mark.map(mark), "sigmas_enlarged": disc.contour.enlarged(),
        "contour": { "u_px": e.u_px, "v_px": e.v_px, "sigma_px": e.sigma_px },
    })
}

fn feature_json(feature: &Feature) -> Value {
    let mut map = Map::new();
    map.insert("name".into(), feature.name.into());
    map.insert("at_px".into(), json!(feature.at_px));
    map.insert("sigma_px".into(), json!(feature.sigma_px));
    Value::Object(map)
}

fn rows(matrix: &SMatrix<f64, 5, 5>) -> Vec<Vec<f64>> {
    (0..5).map(|i| (0..5).map(|j| matrix[(i, j)]).collect()).collect()
}

fn number(out: &mut String, x: f64) {
    out.push(',');
    if x.is_finite() {
        let _ = write!(out, "{x}");
    }
}

fn polarity(p: Polarity) -> &'static str {
    match p {
        Polarity::Auto => "auto",
        Polarity::Bright => "bright",
        Polarity::Dark => "dark",
    }
}

fn mark(m: MarkKind) -> &'static str {
    match m {
        MarkKind::Ring => "ring",
        MarkKind::Large => "large",
        MarkKind::Square => "square",
        MarkKind::Triangle => "triangle",
    }
}
