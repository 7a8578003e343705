//! The order of things: zero lines at three scales, candidates, refinement, rings, polarity.
//!
//! The image is looked at in full, half and quarter size: at each size the zero lines of the difference from the local mean
//! that start at a real edge are followed. A disc seen at several sizes is kept at the finest. Nothing here depends on a threshold
//! given by the user: the least gradient follows from the noise of the image itself.

use crate::detect::candidate::{Candidate, Strength, Verdict, judge};
use crate::detect::edge_model::Reach;
use crate::detect::plane::Plane;
use crate::detect::refine::{Scratch, Start, refine};
use crate::detect::trace::{Line, Tracer};
use crate::detect::{DetectOptions, Detection, Disc, Rejection, RejectionReason, Shape};
use crate::error::{Invalid, Result};
use crate::frames::Pixel;
use crate::image::GrayView;
use crate::target::{MarkKind, Polarity};

/// A region with less than this part of the typical contrast is texture.
const TEXTURE: f64 = 0.15;
/// Pyramid levels looked at.
const LEVELS: u32 = 3;

/// Everything the coarse stage saw.
#[derive(Default)]
struct Seen {
    candidates: Vec<Candidate>,
    marks: Vec<(Candidate, MarkKind)>,
    rejected: Vec<(Candidate, RejectionReason)>,
}

/// Finds the discs of an image.
///
/// Positions and sizes in px, (0, 0) the centre of the first pixel; grey levels as they are in the image. The result holds
/// accepted discs (each with independent edge points, ellipse and covariance), square and triangle marks, and the candidates turned down.
///
/// # Errors
/// [`Invalid::Value`] where a floating-point sample is not finite or an option is out of its range.
pub fn find_discs(view: &GrayView, options: &DetectOptions) -> Result<Detection> {
    check_options(options)?;
    let image = Plane::from_view(view)?;
    let mut seen = look(&image, options);
    drop_texture(&mut seen, f64::from(image.noise()));
    drop_repeats(&mut seen);
    let mut detection = Detection::default();
    let mut scratch = Scratch::default();
    let rooms = rooms(&seen.candidates);
    for (candidate, room) in seen.candidates.iter().zip(&rooms) {
        if !wanted(candidate.bright, options.polarity) {
            continue;
        }
        let start =
            Start { ellipse: candidate.ellipse, blur_px: candidate.blur_px, bright: candidate.bright, room: *room };
        match refine(view, &start, options, &mut scratch) {
            Ok(disc) => detection.discs.push(disc),
            Err(reason) => detection.rejections.push(rejection(candidate, reason)),
        }
    }
    for (candidate, reason) in seen.rejected.iter().filter(|(c, _)| wanted(c.bright, options.polarity)) {
        detection.rejections.push(rejection(candidate, *reason));
    }
    mark_rings(&mut detection.discs, &seen.candidates);
    keep_one_polarity(&mut detection, options.polarity);
    keep_marks(&mut detection, &seen.marks);
    Ok(detection)
}

fn check_options(o: &DetectOptions) -> Result<()> {
    let positive = [
        ("min_semi_minor_px", o.min_semi_minor_px),
        ("max_semi_major_px", o.max_semi_major_px),
        ("min_contrast_to_noise", o.min_contrast_to_noise),
        ("max_edge_rms_px", o.max_edge_rms_px),
    ];
    for (name, value) in positive {
        if !(value > 0.0) {
            return Err(Invalid::value(name, value, "a positive number").into());
        }
    }
    for (name, value) in [("min_axis_ratio", o.min_axis_ratio), ("min_coverage", o.min_coverage)] {
        if !(value > 0.0 && value <= 1.0) {
            return Err(Invalid::value(name, value, "a number above 0 and at most 1").into());
        }
    }
    Ok(())
}

fn wanted(bright: bool, polarity: Polarity) -> bool {
    match polarity {
        Polarity::Auto => true,
        Polarity::Bright => bright,
        Polarity::Dark => !bright,
    }
}

fn rejection(c: &Candidate, reason: RejectionReason) -> Rejection {
    let e = &c.ellipse;
    Rejection { center_px: e.center_px, radius_px: (e.semi_major_px * e.semi_minor_px).sqrt(), reason }
}

/// Follows and judges the zero lines of every pyramid level.
fn look(image: &Plane, options: &DetectOptions) -> Seen {
    let mut seen = Seen::default();
    let mut line = Line::default();
    let quantum = 0.3;
    let mut noise = image.noise().max(quantum * image.range().min(1.0));
    let range = image.range();
    let mut halved;
    let mut current = image;
    for level in 0..LEVELS {
        if current.width < 12 || current.height < 12 {
            break;
        }
        let smooth = current.smoothed();
        let field = smooth.minus_local_mean();
        // Central difference over 1.5 px of the smoothed image: its noise is about 0.18 of a pixel's.
        let gradient = (5.0 * 0.18 * noise).max(0.004 * range);
        let mut tracer = Tracer::new(&field);
        for v in 0..field.height - 1 {
            for u in 0..field.width - 1 {
                if tracer.fresh_crossing(u, v) && (smooth.at(u + 1, v) - smooth.at(u, v)).abs() > gradient {
                    tracer.follow(u, v, &mut line);
                    match judge(&line, &smooth, Strength { gradient: f64::from(gradient) }, level, options) {
                        Verdict::Disc(c) => seen.candidates.push(c),
                        Verdict::Mark(c, kind) => seen.marks.push((c, kind)),
                        Verdict::Rejected(c, reason) => seen.rejected.push((c, reason)),
                        Verdict::Nothing => {}
                    }
                }
            }
        }
        halved = smooth.halved();
        current = &halved;
        noise *= 0.273;
        if level + 1 == LEVELS {
            break;
        }
        noise = noise.max(0.0);
    }
    seen
}

fn distance(a: Pixel, b: Pixel) -> f64 {
    (a.u_px - b.u_px).hypot(a.v_px - b.v_px)
}

/// Drops what is far weaker than the discs that dominate the image: paper, cloth, smoke. What has the size of a disc is named.
fn drop_texture(seen: &mut Seen, noise: f64) {
    let weight = |c: &Candidate| c.contrast * c.ellipse.perimeter_px();
    let mut weights: Vec<(f64, f64, f64)> = seen
        .candidates
        .iter()
        .map(|c| (c.contrast, weight(c), (c.ellipse.semi_major_px * c.ellipse.semi_minor_px).sqrt()))
        .collect();
    let total: f64 = weights.iter().map(|w| w.1).sum();
    weights.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sum = 0.0;
    let Some(typical) = weights.iter().find(|w| {
        sum += w.1;
        sum >= 0.5 * total
    }) else {
        return;
    };
    let (least, radius) = (TEXTURE * typical.0, typical.2);
    let mut weak = Vec::new();
    seen.candidates.retain(|c| {
        let size = (c.ellipse.semi_major_px * c.ellipse.semi_minor_px).sqrt();
        let strong = c.contrast >= least;
        if !strong && size > 0.5 * radius && size < 2.0 * radius && size > 4.0 {
            let contrast_to_noise = if noise > 0.0 { c.contrast / noise } else { c.contrast };
            weak.push((*c, RejectionReason::LowContrast { contrast_to_noise }));
        }
        strong
    });
    seen.marks.retain(|(c, _)| c.contrast >= least);
    seen.rejected.retain(|(c, _)| c.contrast >= least);
    seen.rejected.append(&mut weak);
}

/// The same region seen twice.
fn same(a: &Candidate, b: &Candidate) -> bool {
    let (ra, rb) = (a.ellipse.semi_minor_px, b.ellipse.semi_minor_px);
    a.bright == b.bright
        && distance(a.ellipse.center_px, b.ellipse.center_px) < 0.4 * ra.max(rb) + 1.0
        && (ra / rb - 1.0).abs().min((rb / ra - 1.0).abs()) < 0.35 + 1.0 / ra.min(rb)
}

/// Keeps of every region the view at the finest level.
fn drop_repeats(seen: &mut Seen) {
    let mut kept: Vec<Candidate> = Vec::with_capacity(seen.candidates.len());
    for c in &seen.candidates {
        if !kept.iter().any(|k| k.level < c.level && same(k, c)) {
            kept.push(*c);
        }
    }
    seen.candidates = kept;
    let mut marks: Vec<(Candidate, MarkKind)> = Vec::new();
    for m in &seen.marks {
        if !marks.iter().any(|k| same(&k.0, &m.0)) {
            marks.push(*m);
        }
    }
    seen.candidates.retain(|c| !marks.iter().any(|m| same(&m.0, c)));
    seen.marks = marks;
    let mut rejected: Vec<(Candidate, RejectionReason)> = Vec::new();
    for r in &seen.rejected {
        let known = seen.candidates.iter().any(|c| same(c, &r.0)) || rejected.iter().any(|k| same(&k.0, &r.0));
        if !known && !seen.marks.iter().any(|m| same(&m.0, &r.0)) {
            rejected.push(*r);
        }
    }
    seen.rejected = rejected;
}

/// How far the band around each candidate may reach: not into its neighbours, not into its own hole.
fn rooms(candidates: &[Candidate]) -> Vec<Reach> {
    candidates
        .iter()
        .map(|c| {
            let e = &c.ellipse;
            let mut room = Reach { inner_px: 0.9 * e.semi_minor_px, outer_px: 40.0 };
            for other in candidates {
                let o = &other.ellipse;
                let apart = distance(e.center_px, o.center_px);
                if apart > e.semi_major_px + o.semi_major_px + 40.0 || std::ptr::eq(c, other) {
                    continue;
                }
                let weighty = other.contrast > 0.3 * c.contrast;
                if apart < 0.6 * e.semi_minor_px && o.semi_major_px < 0.85 * e.semi_minor_px {
                    if other.bright != c.bright && weighty {
                        room.inner_px = room.inner_px.min(0.6 * (e.semi_minor_px - o.semi_major_px - apart).max(2.0));
                    }
                } else if apart > e.semi_minor_px && weighty {
                    // Along the line of centres; conservative for slim ellipses.
                    room.outer_px = room.outer_px.min(0.6 * (apart - e.semi_major_px - o.semi_major_px).max(2.0));
                }
            }
            room
        })
        .collect()
}

/// A disc around a region of the other polarity is a ring; the hole itself is no disc.
fn mark_rings(discs: &mut Vec<Disc>, candidates: &[Candidate]) {
    for d in discs.iter_mut() {
        let e = &d.ellipse;
        let bright = d.polarity == Polarity::Bright;
        let hole = candidates.iter().any(|c| {
            let ratio = c.ellipse.semi_minor_px / e.semi_minor_px;
            c.bright != bright
                && distance(c.ellipse.center_px, e.center_px) < 0.1 * e.semi_minor_px + 0.5
                && c.rms_px < 0.25 + 0.06 * c.ellipse.semi_minor_px
                && (0.1..0.8).contains(&ratio)
                && c.contrast > 0.5 * d.contrast
        });
        if hole {
            d.mark = Some(MarkKind::Ring);
        }
    }
    let rings: Vec<Disc> = discs.iter().filter(|d| d.mark.is_some()).cloned().collect();
    discs.retain(|d| {
        !rings.iter().any(|r| {
            r.polarity != d.polarity
                && distance(r.ellipse.center_px, d.ellipse.center_px) < 0.5 * r.ellipse.semi_minor_px
                && d.ellipse.semi_major_px < 0.9 * r.ellipse.semi_minor_px
        })
    });
}

/// Under `Auto` the polarity whose contours weigh more (length times contrast) stays; a target has one.
fn keep_one_polarity(detection: &mut Detection, polarity: Polarity) {
    if polarity != Polarity::Auto {
        return;
    }
    let weight = |p: Polarity| -> f64 {
        let of_p = detection.discs.iter().filter(|d| d.polarity == p);
        of_p.map(|d| d.contrast * d.ellipse.perimeter_px()).sum()
    };
    let winner = if weight(Polarity::Bright) > weight(Polarity::Dark) { Polarity::Bright } else { Polarity::Dark };
    let (kept, others): (Vec<Disc>, Vec<Disc>) =
        std::mem::take(&mut detection.discs).into_iter().partition(|d| d.polarity == winner);
    detection.discs = kept;
    for d in others {
        let e = &d.ellipse;
        detection.rejections.push(Rejection {
            center_px: e.center_px,
            radius_px: (e.semi_major_px * e.semi_minor_px).sqrt(),
            reason: RejectionReason::OtherPolarity,
        });
    }
}

/// Marks of the discs' polarity and of about their size.
fn keep_marks(detection: &mut Detection, marks: &[(Candidate, MarkKind)]) {
    let mut sizes: Vec<f64> =
        detection.discs.iter().map(|d| (d.ellipse.semi_major_px * d.ellipse.semi_minor_px).sqrt()).collect();
    if sizes.is_empty() {
        return;
    }
    let middle = sizes.len() / 2;
    let typical = *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
    let bright = detection.discs[0].polarity == Polarity::Bright;
    for (c, kind) in marks.iter().filter(|(c, _)| c.bright == bright) {
        let radius_px = (c.ellipse.semi_major_px * c.ellipse.semi_minor_px).sqrt();
        if radius_px > typical / 3.0 && radius_px < 3.0 * typical {
            detection.shapes.push(Shape { center_px: c.ellipse.center_px, radius_px, mark: *kind });
        }
    }
}
