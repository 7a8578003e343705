//! The image with what was found in it: contours, ellipses, features, residual arrows, labels, rejected candidates.

use super::canvas::{Canvas, Colour};
use super::captions;
use super::grey;
use super::number::{count, nice_below, plain};
use crate::conic::Ellipse;
use crate::detect::Disc;
use crate::error::{Error, Result};
use crate::image::GrayView;
use crate::record::FeatureKind;
use crate::stats::median;
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

/// Measured contours.
pub(super) const CONTOUR: Colour = [0, 220, 255];
/// Ellipses and projected circles.
pub(super) const MODEL: Colour = [120, 255, 90];
/// Common tangents and other help lines.
pub(super) const HELP: Colour = [190, 170, 255];
/// Features and residual arrows.
pub(super) const ARROW: Colour = [255, 205, 0];
/// Outliers, rejected candidates and what of a rim was left out.
pub(super) const BAD: Colour = [255, 80, 70];
/// Labels.
pub(super) const LABEL: Colour = [255, 255, 255];

/// A typical residual arrow is this part of the image's diagonal.
const ARROW_PART: f64 = 0.012;
/// On small discs a typical arrow is at most this part of their radius, so that the discs stay visible.
const ARROW_RADIUS: f64 = 0.35;
/// The longest arrow that is drawn in full, part of the image's diagonal.
const ARROW_LIMIT: f64 = 0.08;

/// Edge points that are this many times further apart than usual, and so many px, have something unseen between them.
const UNSEEN: f64 = 3.0;
const UNSEEN_PX: f64 = 4.0;

/// Notes below the picture's left corner: distance of their lines, most lines and most letters in units of the scale.
const NOTE_PX: usize = 10;
const NOTES: usize = 2;
const NOTE_LETTERS: usize = 42;

/// Pictures of more pixels are compressed with more effort: their size on the disk matters more than milliseconds.
const LARGE_PX: usize = 1_500_000;

/// A chain of image points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Polyline {
    /// Columns, px.
    pub u_px: Vec<f64>,
    /// Rows, px.
    pub v_px: Vec<f64>,
    /// Whether the last point is joined to the first.
    pub closed: bool,
}

impl Polyline {
    pub(super) fn points(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.u_px.iter().zip(&self.v_px).map(|(&u, &v)| [u, v])
    }

    /// A closed chain without the long jumps between neighbours: itself where there are none, else what lies between them.
    pub fn split_at_gaps(self) -> Vec<Self> {
        let n = self.u_px.len().min(self.v_px.len());
        if n < 3 || !self.closed {
            return vec![self];
        }
        let gap = |i: usize| (self.u_px[i] - self.u_px[(i + 1) % n]).hypot(self.v_px[i] - self.v_px[(i + 1) % n]);
        let wide = wide_px((0..n).map(gap).collect());
        let jumps: Vec<usize> = (0..n).filter(|i| gap(*i) > wide).collect();
        let Some(last) = jumps.last().copied() else { return vec![self] };
        let mut from = last + 1;
        let mut parts = Vec::with_capacity(jumps.len());
        for jump in jumps {
            // The first part may begin at the end of the chain.
            let to = if from > jump { jump + n } else { jump };
            let (u_px, v_px) = (from..=to).map(|i| (self.u_px[i % n], self.v_px[i % n])).unzip();
            parts.push(Self { u_px, v_px, closed: false });
            from = jump + 1;
        }
        parts
    }
}

/// Observed features with their residuals, structure of arrays of one length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Marks {
    /// Observed position, px.
    pub u_px: Vec<f64>,
    /// Observed position, px.
    pub v_px: Vec<f64>,
    /// Observed less predicted, px; `NaN` where there is no prediction.
    pub du_px: Vec<f64>,
    /// Observed less predicted, px; `NaN` where there is no prediction.
    pub dv_px: Vec<f64>,
    /// What was observed: edges are drawn as arrows only, points as rings, centres as crosses.
    pub kind: Vec<FeatureKind>,
    /// Whether it was left out of the adjustment.
    pub outlier: Vec<bool>,
}

impl Marks {
    /// Adds a feature; the residual is `NaN` where there is no prediction.
    pub fn push(&mut self, at_px: [f64; 2], residual_px: [f64; 2], kind: FeatureKind, outlier: bool) {
        self.u_px.push(at_px[0]);
        self.v_px.push(at_px[1]);
        self.du_px.push(residual_px[0]);
        self.dv_px.push(residual_px[1]);
        self.kind.push(kind);
        self.outlier.push(outlier);
    }
    /// Number of features.
    pub fn len(&self) -> usize {
        let lengths = [self.u_px.len(), self.v_px.len(), self.du_px.len(), self.dv_px.len(), self.kind.len()];
        lengths.into_iter().fold(self.outlier.len(), usize::min)
    }
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Words about a disc or a mark.
#[derive(Debug, Clone, PartialEq)]
pub struct Label {
    /// Its middle, px.
    pub at_px: [f64; 2],
    /// How far it reaches, px.
    pub reach_px: f64,
    /// A few characters.
    pub text: String,
}

/// A candidate that was turned down.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedMark {
    /// Its centre, px.
    pub at_px: [f64; 2],
    /// Its size, px.
    pub radius_px: f64,
    /// Why, in a few words.
    pub reason: String,
}

/// What is drawn on an image; everything in px of the image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OverlayShapes {
    /// Measured contours.
    pub contours: Vec<Polyline>,
    /// Fitted ellipses.
    pub ellipses: Vec<Ellipse>,
    /// Stretches of rims where nothing was measured: glare, dirt, a neighbour.
    pub unseen: Vec<Polyline>,
    /// Circles of the target as the calibration predicts them.
    pub predicted: Vec<Polyline>,
    /// Help lines: common tangents, axes of the pattern.
    pub lines: Vec<Polyline>,
    /// Features and their residuals.
    pub marks: Marks,
    /// Names of discs and marks.
    pub labels: Vec<Label>,
    /// Candidates turned down.
    pub rejected: Vec<RejectedMark>,
    /// Factor of the residual arrows; `None` chooses 1, 2 or 5 times a power of ten so that they are seen.
    pub magnification: Option<f64>,
}

impl OverlayShapes {
    /// The contour of a disc, its ellipse and what of its rim was left out.
    pub fn push_disc(&mut self, disc: &Disc) {
        let (u_px, v_px) = (disc.edge.u_px.clone(), disc.edge.v_px.clone());
        let seen = Polyline { u_px, v_px, closed: true }.split_at_gaps();
        self.unseen.extend(unseen(&disc.ellipse, &seen));
        self.contours.extend(seen);
        self.ellipses.push(disc.ellipse);
    }
}

/// Distance of neighbours beyond which something between them was left out, px.
fn wide_px(mut gaps: Vec<f64>) -> f64 {
    median(&mut gaps).map_or(UNSEEN_PX, |gap| (UNSEEN * gap).max(UNSEEN_PX))
}

/// Stretches of an ellipse between the parts of its rim that were seen, which follow each other with the eccentric angle.
fn unseen(e: &Ellipse, seen: &[Polyline]) -> Vec<Polyline> {
    let (sin, cos) = e.angle_rad.sin_cos();
    let eccentric = |[u_px, v_px]: [f64; 2]| {
        let (du, dv) = (u_px - e.center_px.u_px, v_px - e.center_px.v_px);
        ((cos * dv - sin * du) / e.semi_minor_px).atan2((cos * du + sin * dv) / e.semi_major_px)
    };
    let stretch = |(one, next): (&Polyline, &Polyline)| {
        let (from, to) = (eccentric(one.points().last()?), eccentric(next.points().next()?));
        let turn = (to - from).rem_euclid(std::f64::consts::TAU);
        let steps = (turn * (e.semi_major_px.max(1.0) / 0.1).sqrt()).ceil().clamp(2.0, 400.0);
        let at = |i: usize| e.point(from + turn * i as f64 / steps);
        let (u_px, v_px) = (0..=steps as usize).map(at).map(|p| (p.u_px, p.v_px)).unzip();
        Some(Polyline { u_px, v_px, closed: false })
    };
    let open = || seen.iter().filter(|part| !part.closed);
    open().zip(open().cycle().skip(1)).filter_map(stretch).collect()
}

/// A residual arrow as it is drawn, px of the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arrow {
    pub(super) from: [f64; 2],
    pub(super) to: [f64; 2],
    pub(super) outlier: bool,
    pub(super) cut: bool,
    /// Edge points lie too close together for heads; the side of the contour tells the direction.
    pub(super) edge: bool,
}

/// Residual arrows of `marks`, `factor` times enlarged; those longer than `limit_px` are cut there.
pub(super) fn arrows(marks: &Marks, factor: f64, limit_px: f64) -> impl Iterator<Item = Arrow> + '_ {
    (0..marks.len()).filter_map(move |i| {
        let from = [marks.u_px[i], marks.v_px[i]];
        let d = [marks.du_px[i] * factor, marks.dv_px[i] * factor];
        let length = d[0].hypot(d[1]);
        if !length.is_finite() || !from.iter().all(|x| x.is_finite()) {
            return None;
        }
        let cut = length > limit_px;
        let k = if cut { limit_px / length } else { 1.0 };
        Some(Arrow {
            from,
            to: [from[0] + k * d[0], from[1] + k * d[1]],
            outlier: marks.outlier[i],
            cut,
            edge: marks.kind[i] == FeatureKind::Edge,
        })
    })
}

/// Longest arrow on an image of this size, px.
pub(super) fn arrow_limit_px(width: usize, height: usize) -> f64 {
    ARROW_LIMIT * (width as f64).hypot(height as f64)
}

/// The factor of residual arrows for residuals of this root mean square, on an image of this size with discs of this
/// radius (infinite where there are none).
pub(super) fn arrow_factor(rms_px: f64, width: usize, height: usize, radius_px: f64) -> f64 {
    let goal_px = (ARROW_PART * (width as f64).hypot(height as f64)).min(ARROW_RADIUS * radius_px);
    if rms_px > 0.0 { nice_below(goal_px / rms_px) } else { 1.0 }
}

/// Root mean square length of the residuals that were used, px; 0 where there is none.
pub(super) fn rms_px<'a>(marks: impl IntoIterator<Item = &'a Marks>) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for m in marks {
        for i in (0..m.len()).filter(|&i| !m.outlier[i]) {
            let square = m.du_px[i] * m.du_px[i] + m.dv_px[i] * m.dv_px[i];
            if square.is_finite() {
                sum += square;
                n += 1;
            }
        }
    }
    if n > 0 { (sum / n as f64).sqrt() } else { 0.0 }
}

/// Median radius of the discs that are drawn, px; infinite where there are none.
pub(super) fn typical_radius_px<'a>(all: impl IntoIterator<Item = &'a OverlayShapes>) -> f64 {
    let mut radii = Vec::new();
    for shapes in all {
        radii.extend(shapes.ellipses.iter().map(|e| e.semi_minor_px));
        radii.extend(shapes.predicted.iter().chain(&shapes.contours).filter(|l| l.closed).map(half_width));
    }
    radii.retain(|r| r.is_finite() && *r > 0.0);
    radii.sort_by(f64::total_cmp);
    radii.get(radii.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// Half the smaller side of the box around a line, px.
fn half_width(line: &Polyline) -> f64 {
    let span = |x: &[f64]| {
        let (low, high) = x.iter().fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
        high - low
    };
    0.5 * span(&line.u_px).min(span(&line.v_px))
}

/// An ellipse as a chain; its points lie less than 0.05 px inside it.
pub(super) fn ellipse_points(e: &Ellipse) -> Vec<[f64; 2]> {
    // The gap between chord and arc is a (1 - cos(pi / n)).
    let n = (std::f64::consts::PI * (e.semi_major_px.max(1.0) / 0.1).sqrt()).ceil().clamp(16.0, 400.0) as usize;
    (0..n)
        .map(|i| {
            let p = e.point(std::f64::consts::TAU * i as f64 / n as f64);
            [p.u_px, p.v_px]
        })
        .collect()
}

/// The image with its overlay as a PNG file, at full resolution, 8-bit RGB.
///
/// Grey levels are stretched between the darkest and brightest half percent.
///
/// # Errors
/// [`Error::Bug`] where the picture cannot be encoded.
pub fn overlay_png(image: &GrayView<'_>, shapes: &OverlayShapes) -> Result<Vec<u8>> {
    let (width, height) = (image.width(), image.height());
    let factor = shapes
        .magnification
        .unwrap_or_else(|| arrow_factor(rms_px([&shapes.marks]), width, height, typical_radius_px([shapes])));
    let mut canvas = Canvas::new(&grey::full(image));
    // Lines stay visible when a large image is looked at as a whole.
    let scale = (width.max(height) / 1500 + 1).min(4);
    draw_shapes(&mut canvas, shapes, scale as f64);
    let cut = draw_marks(&mut canvas, &shapes.marks, factor, arrow_limit_px(width, height), scale as f64);
    let silent = write_captions(&mut canvas, shapes, (width, height), scale);
    let mut notes = Vec::new();
    if !shapes.marks.is_empty() && rms_px([&shapes.marks]) > 0.0 {
        let tail = if cut { ", longest cut" } else { "" };
        notes.push(format!("arrows: residual x {}{tail}", plain(factor, 3)));
    }
    if silent > 0 {
        notes.push(format!("no room for {}: see the tables", count(silent, "label")));
    }
    for (line, words) in notes.iter().rev().enumerate() {
        canvas.text([6.0, height as f64 - (NOTE_PX * scale * (line + 1)) as f64], words, scale, ARROW);
    }
    let (width, height, rgb) = canvas.into_rgb();
    encode_png(&rgb, width, height)
}

fn encode_png(rgb: &[u8], width: usize, height: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let size = |n: usize| u32::try_from(n).map_err(|_| Error::Bug(format!("an overlay of {n} px")));
    // Measured on a noisy 1024x768 overlay: fast 4 ms, 1.6 MB; level 1 18 ms, 0.9 MB; default 245 ms, 0.8 MB.
    let level = if width * height > LARGE_PX { CompressionType::Level(1) } else { CompressionType::Fast };
    PngEncoder::new_with_quality(&mut bytes, level, FilterType::Up)
        .write_image(rgb, size(width)?, size(height)?, image::ExtendedColorType::Rgb8)
        .map_err(|e| Error::Bug(format!("overlay PNG: {e}")))?;
    Ok(bytes)
}

fn draw_shapes(canvas: &mut Canvas, shapes: &OverlayShapes, scale: f64) {
    let mut draw = |lines: &[Polyline], colour: Colour| {
        for line in lines {
            let points: Vec<_> = line.points().collect();
            canvas.chain(&points, line.closed, scale, colour);
        }
    };
    draw(&shapes.lines, HELP);
    draw(&shapes.contours, CONTOUR);
    draw(&shapes.predicted, MODEL);
    for ellipse in &shapes.ellipses {
        canvas.chain(&ellipse_points(ellipse), true, scale, MODEL);
    }
    for line in &shapes.unseen {
        canvas.chain(&line.points().collect::<Vec<_>>(), false, scale, BAD);
    }
    for mark in &shapes.rejected {
        let ([u, v], r) = (mark.at_px, cross_px(mark, scale));
        canvas.chain(&[[u - r, v - r], [u + r, v + r]], false, scale, BAD);
        canvas.chain(&[[u - r, v + r], [u + r, v - r]], false, scale, BAD);
    }
}

/// Half the side of the cross on a candidate turned down, px.
pub(super) fn cross_px(mark: &RejectedMark, scale: f64) -> f64 {
    mark.radius_px.clamp(4.0 * scale, 60.0 * scale)
}

/// Writes names and reasons where there is room for them; returns how many had none.
fn write_captions(canvas: &mut Canvas, shapes: &OverlayShapes, size: (usize, usize), scale: usize) -> usize {
    // Letters no larger than the discs.
    let letters = ((typical_radius_px([shapes]) / 4.0) as usize).clamp(1, scale);
    let notes = [(8 * NOTE_LETTERS * scale) as f64, (NOTE_PX * NOTES * scale) as f64];
    let (placed, silent) = captions::arrange(shapes, size, notes, [8.0 * letters as f64; 2], scale as f64);
    for caption in placed {
        canvas.text(caption.at_px, caption.text, letters, if caption.reason { BAD } else { LABEL });
    }
    silent
}

/// Draws features and arrows; tells whether an arrow was cut.
fn draw_marks(canvas: &mut Canvas, marks: &Marks, factor: f64, limit_px: f64, scale: f64) -> bool {
    for i in 0..marks.len() {
        let at = [marks.u_px[i], marks.v_px[i]];
        let colour = if marks.outlier[i] { BAD } else { ARROW };
        let r = 3.0 * scale;
        match marks.kind[i] {
            FeatureKind::Edge => {}
            FeatureKind::Point => {
                let ring: Vec<_> = (0..16)
                    .map(|k| (k as f64 * std::f64::consts::TAU / 16.0).sin_cos())
                    .map(|(s, c)| [at[0] + r * c, at[1] + r * s])
                    .collect();
                canvas.chain(&ring, true, scale, colour);
            }
            FeatureKind::DiscCentre => {
                canvas.chain(&[[at[0] - r, at[1]], [at[0] + r, at[1]]], false, scale, colour);
                canvas.chain(&[[at[0], at[1] - r], [at[0], at[1] + r]], false, scale, colour);
            }
        }
    }
    let mut any_cut = false;
    for arrow in arrows(marks, factor, limit_px) {
        any_cut |= arrow.cut;
        let colour = if arrow.outlier { BAD } else { ARROW };
        canvas.chain(&[arrow.from, arrow.to], false, scale, colour);
        if let Some(head) = head(&arrow, 4.0 * scale) {
            canvas.chain(&head, false, scale, colour);
        }
    }
    any_cut
}

/// The head of an arrow that is long enough to have one.
pub(super) fn head(arrow: &Arrow, size_px: f64) -> Option<[[f64; 2]; 3]> {
    let (du, dv) = (arrow.to[0] - arrow.from[0], arrow.to[1] - arrow.from[1]);
    let length = du.hypot(dv);
    if arrow.edge || arrow.cut || length < 2.0 * size_px {
        return None;
    }
    let (du, dv) = (du / length * size_px, dv / length * size_px);
    let wing = |side: f64| [arrow.to[0] - du - 0.5 * side * dv, arrow.to[1] - dv + 0.5 * side * du];
    Some([wing(1.0), arrow.to, wing(-1.0)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Pixel;
    use crate::image::Samples;

    /// Where the green of a drawn picture is, weighted centroid, px.
    fn centroid(png: &[u8], is_mark: impl Fn([u8; 3]) -> f64) -> [f64; 2] {
        let picture = image::load_from_memory(png).unwrap().to_rgb8();
        let (mut sum, mut u, mut v) = (0.0, 0.0, 0.0);
        for (x, y, p) in picture.enumerate_pixels() {
            let w = is_mark(p.0);
            sum += w;
            u += w * f64::from(x);
            v += w * f64::from(y);
        }
        assert!(sum > 0.0, "nothing was drawn");
        [u / sum, v / sum]
    }

    fn ground() -> Vec<u8> {
        vec![128; 96 * 64]
    }

    #[test]
    fn an_ellipse_is_drawn_where_it_is_to_a_twentieth_of_a_pixel() {
        let data = ground();
        let view = GrayView::new(Samples::U8(&data), 96, 64, 96).unwrap();
        for (u, v) in [(40.0, 30.0), (40.5, 30.5), (41.25, 29.8), (11.0, 11.0)] {
            let circle =
                Ellipse { center_px: Pixel::new(u, v), semi_major_px: 10.0, semi_minor_px: 10.0, angle_rad: 0.3 };
            let shapes = OverlayShapes { ellipses: vec![circle], ..Default::default() };
            let png = overlay_png(&view, &shapes).unwrap();
            let found = centroid(&png, |[r, g, _]| f64::from(g.saturating_sub(r)));
            assert!((found[0] - u).abs() < 0.05 && (found[1] - v).abs() < 0.05, "({u}, {v}) drawn at {found:?}");
        }
    }

    /// Edge points that do not lie evenly leave no gap; a hidden stretch does, also across the seam of the angle, and two do.
    #[test]
    fn what_of_a_rim_was_left_out_is_drawn() {
        let center_px = crate::frames::Pixel::new(80.0, 60.0);
        let e = Ellipse { center_px, semi_major_px: 40.0, semi_minor_px: 25.0, angle_rad: 0.4 };
        let at = |k: f64| e.point(k / 120.0 * std::f64::consts::TAU);
        let chain = |hidden: &[[usize; 2]]| {
            let seen = (0..120).filter(|k| !hidden.iter().any(|h| (h[0]..h[1]).contains(k)));
            let points = seen.map(|k| at(k as f64 + 0.3 * f64::from(k as u32 % 3)));
            let (u_px, v_px) = points.map(|p| (p.u_px, p.v_px)).unzip();
            Polyline { u_px, v_px, closed: true }
        };
        assert_eq!(chain(&[]).split_at_gaps(), [chain(&[])]);
        assert!(unseen(&e, &[chain(&[])]).is_empty());
        let cases: [&[[usize; 2]]; 5] = [&[[0, 10]], &[[30, 42]], &[[55, 66]], &[[110, 120]], &[[5, 15], [70, 90]]];
        for hidden in cases {
            let parts = chain(hidden).split_at_gaps();
            let left: usize = hidden.iter().map(|h| h[1] - h[0]).sum();
            assert_eq!(parts.iter().map(|p| p.u_px.len()).sum::<usize>(), 120 - left);
            assert!(parts.len() == hidden.len() && parts.iter().all(|p| !p.closed), "{hidden:?}");
            for part in &parts {
                let steps = part.u_px.windows(2).zip(part.v_px.windows(2));
                assert!(steps.fold(0.0_f64, |m, (u, v)| m.max((u[1] - u[0]).hypot(v[1] - v[0]))) < 4.0);
            }
            let found = unseen(&e, &parts);
            assert_eq!(found.len(), hidden.len(), "{hidden:?}");
            for h in hidden {
                let middle = at(0.5 * (h[0] + h[1]) as f64);
                let away = |line: &Polyline| {
                    line.points().map(|[u, v]| (u - middle.u_px).hypot(v - middle.v_px)).fold(9.0, f64::min)
                };
                assert_eq!(found.iter().filter(|line| away(line) < 2.0).count(), 1, "{hidden:?}");
            }
        }
    }

    #[test]
    fn an_arrow_starts_at_the_feature_and_points_along_the_residual() {
        let data = ground();
        let view = GrayView::new(Samples::U8(&data), 96, 64, 96).unwrap();
        let mut shapes = OverlayShapes { magnification: Some(100.0), ..Default::default() };
        shapes.marks.push([30.0, 30.0], [0.05, 0.0], FeatureKind::Edge, false);
        let png = overlay_png(&view, &shapes).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        let yellow = |x: u32, y: u32| picture.get_pixel(x, y).0[0] > 200 && picture.get_pixel(x, y).0[2] < 90;
        assert!(yellow(30, 30) && yellow(35, 30), "five pixels to the right");
        assert!(!yellow(28, 30) && !yellow(37, 30) && !yellow(32, 32));
    }

    #[test]
    fn a_line_is_seen_on_black_and_on_white() {
        for level in [0u8, 255] {
            let data = [&[level; 95 * 64][..], &[255 - level; 64][..]].concat();
            let view = GrayView::new(Samples::U8(&data), 96, 64, 96).unwrap();
            let line = Polyline { u_px: vec![10.0, 80.0], v_px: vec![20.0, 20.0], closed: false };
            let shapes = OverlayShapes { contours: vec![line], ..Default::default() };
            let picture = image::load_from_memory(&overlay_png(&view, &shapes).unwrap()).unwrap().to_rgb8();
            let luma = |y| {
                let [r, g, b] = picture.get_pixel(40, y).0.map(f64::from);
                0.3 * r + 0.59 * g + 0.11 * b
            };
            let step = (18..23).map(|y| (luma(y) - luma(y + 1)).abs()).fold(0.0, f64::max);
            assert!(step > 60.0, "grey {level}: step {step}");
        }
    }

    #[test]
    fn wild_shapes_do_no_harm() {
        let data = ground();
        let view = GrayView::new(Samples::U8(&data), 96, 64, 96).unwrap();
        let mut shapes = OverlayShapes::default();
        let wild = vec![f64::NAN, -1e300, 1e9, f64::INFINITY, 5.0, 4000.0];
        shapes.contours.push(Polyline { u_px: wild.clone(), v_px: wild.clone(), closed: true });
        shapes.marks.push([f64::NAN, 1.0], [1e300, f64::NAN], FeatureKind::Point, true);
        shapes.marks.push([5.0, 1.0], [1e300, 1.0], FeatureKind::Edge, true);
        shapes.labels.push(Label {
            at_px: [-50.0, 1e9],
            reach_px: 3.0,
            text: "a very long label that is wider than the image ☃".into(),
        });
        shapes.rejected.push(RejectedMark { at_px: [95.0, 63.0], radius_px: f64::INFINITY, reason: "?".into() });
        assert!(overlay_png(&view, &shapes).is_ok());
    }

    #[test]
    fn the_factor_is_round_and_long_arrows_are_cut() {
        assert_eq!(arrow_factor(0.03, 1024, 768, f64::INFINITY), 500.0);
        assert_eq!(arrow_factor(0.0, 1024, 768, 20.0), 1.0);
        assert_eq!(arrow_factor(0.03, 1024, 768, 20.0), 200.0);
        let circle =
            |r| Ellipse { center_px: Pixel::new(5.0, 5.0), semi_major_px: r, semi_minor_px: r, angle_rad: 0.0 };
        let shapes = OverlayShapes { ellipses: vec![circle(4.0), circle(9.0), circle(300.0)], ..Default::default() };
        assert_eq!(typical_radius_px([&shapes]), 9.0);
        assert_eq!(typical_radius_px([]), f64::INFINITY);
        let mut marks = Marks::default();
        marks.push([0.0, 0.0], [3.0, 4.0], FeatureKind::Point, false);
        let cut: Vec<_> = arrows(&marks, 10.0, 25.0).collect();
        assert_eq!(cut, [Arrow { from: [0.0, 0.0], to: [15.0, 20.0], outlier: false, cut: true, edge: false }]);
    }
}
