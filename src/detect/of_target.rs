//! Which of the discs found are those of a target: no second views, of one polarity and no dust, with rings named and marks beside them.

use crate::detect::candidate::Candidate;
use crate::detect::dust::{is_dust, is_free_of_dust, size, typical_radius_px};
use crate::detect::rows::ByRow;
use crate::detect::{Detection, Disc, Rejection, RejectionReason, Shape};
use crate::frames::Pixel;
use crate::target::{MarkKind, Polarity};

/// Whether two points are less than `limit_px` apart.
pub(super) fn within(a: Pixel, b: Pixel, limit_px: f64) -> bool {
    let (du, dv) = (a.u_px - b.u_px, a.v_px - b.v_px);
    du * du + dv * dv < limit_px * limit_px
}

/// Two starts that ended on one disc.
fn one_and_the_same(a: &Disc, b: &Disc) -> bool {
    let (ra, rb) = (a.ellipse.semi_minor_px, b.ellipse.semi_minor_px);
    a.polarity == b.polarity
        && within(a.ellipse.center_px, b.ellipse.center_px, 0.5 * ra.min(rb))
        && ra.min(rb) > 0.5 * ra.max(rb)
}

/// Which results are no second view of a disc that came before.
pub(super) fn drop_twins(refined: &[Result<Disc, RejectionReason>]) -> Vec<bool> {
    let discs: Vec<(usize, &Disc)> =
        refined.iter().enumerate().filter_map(|(i, r)| r.as_ref().ok().map(|d| (i, d))).collect();
    let by_row = ByRow::new(discs.iter().map(|(_, d)| &d.ellipse));
    let mut keep = vec![true; refined.len()];
    for (k, (i, d)) in discs.iter().enumerate() {
        let near = by_row.near(d.ellipse.center_px, 0.5 * d.ellipse.semi_minor_px);
        let mut before = near.filter(|n| *n < k).map(|n| discs[n]);
        keep[*i] = !before.any(|(j, other)| keep[j] && one_and_the_same(other, d));
    }
    keep
}

/// Leaves of all discs and rejections those that say something of a target; `candidates` and `marks` are what the coarse stage saw.
pub(super) fn keep_target(
    detection: &mut Detection,
    candidates: &[Candidate],
    marks: &[(Candidate, MarkKind)],
    polarity: Polarity,
) {
    mark_rings(&mut detection.discs, candidates);
    keep_one_polarity(detection, polarity);
    keep_marks(detection, marks);
    drop_dust(detection);
    keep_telling_rejections(detection);
}

/// A disc around a region of the other polarity is a ring; the hole itself is no disc.
fn mark_rings(discs: &mut Vec<Disc>, candidates: &[Candidate]) {
    let holes = [false, true].map(|bright| candidates.iter().filter(|c| c.bright == bright).collect::<Vec<_>>());
    for d in discs.iter_mut() {
        let e = &d.ellipse;
        let hole = holes[usize::from(d.polarity != Polarity::Bright)].iter().any(|c| {
            if !within(c.ellipse.center_px, e.center_px, 0.1 * e.semi_minor_px + 0.5) {
                return false;
            }
            let ratio = c.ellipse.semi_minor_px / e.semi_minor_px;
            c.rms_px < 0.25 + 0.06 * c.ellipse.semi_minor_px
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
                && within(r.ellipse.center_px, d.ellipse.center_px, 0.5 * r.ellipse.semi_minor_px)
                && d.ellipse.semi_major_px < 0.9 * r.ellipse.semi_minor_px
        })
    });
}

/// Under `Auto` the polarity whose contours weigh more (length times contrast) stays; a target has one.
fn keep_one_polarity(detection: &mut Detection, polarity: Polarity) {
    let first = detection.discs.first().map(|d| d.polarity);
    if polarity != Polarity::Auto || detection.discs.iter().all(|d| Some(d.polarity) == first) {
        return;
    }
    let weight = |p: Polarity| -> f64 {
        let of_p = detection.discs.iter().filter(|d| d.polarity == p);
        of_p.map(|d| d.contrast * d.ellipse.perimeter_px()).sum()
    };
    let winner = if weight(Polarity::Bright) > weight(Polarity::Dark) { Polarity::Bright } else { Polarity::Dark };
    for d in detection.discs.extract_if(.., |d| d.polarity != winner) {
        let e = &d.ellipse;
        detection.rejections.push(Rejection {
            center_px: e.center_px,
            radius_px: e.mean_radius_px(),
            reason: RejectionReason::OtherPolarity,
        });
    }
}

/// Radius in whose size class the discs of the image lie, px.
fn typical_px(discs: &[Disc]) -> Option<f64> {
    typical_radius_px(discs.iter().map(size))
}

fn drop_dust(detection: &mut Detection) {
    if is_free_of_dust(detection.discs.iter().map(|d| d.ellipse.mean_radius_px())) {
        return;
    }
    let Some(typical) = typical_px(&detection.discs) else { return };
    let dust = detection.discs.extract_if(.., |d| is_dust(d.ellipse.mean_radius_px(), typical));
    detection.rejections.extend(dust.map(|d| Rejection {
        center_px: d.ellipse.center_px,
        radius_px: d.ellipse.mean_radius_px(),
        reason: RejectionReason::TooSmall { semi_minor_px: d.ellipse.semi_minor_px },
    }));
}

/// Structure inside an accepted disc, or a coarser view of one, is not worth a word.
fn keep_telling_rejections(detection: &mut Detection) {
    let discs = &detection.discs;
    detection.rejections.retain(|r| {
        !discs.iter().any(|d| {
            let radius = d.ellipse.mean_radius_px();
            within(d.ellipse.center_px, r.center_px, radius.max(r.radius_px.min(4.0 * radius)))
        })
    });
}

/// Marks of the discs' polarity and of about their size.
fn keep_marks(detection: &mut Detection, marks: &[(Candidate, MarkKind)]) {
    if marks.is_empty() {
        return;
    }
    let Some(typical) = typical_px(&detection.discs) else { return };
    let bright = detection.discs[0].polarity == Polarity::Bright;
    for (c, kind) in marks.iter().filter(|(c, _)| c.bright == bright) {
        let radius_px = c.ellipse.mean_radius_px();
        if radius_px > typical / 3.0 && radius_px < 3.0 * typical {
            detection.shapes.push(Shape { center_px: c.ellipse.center_px, radius_px, mark: *kind });
        }
    }
}
