//! Ellipses slimmer than discs that are worth measuring: what lines tell of them, and what contours.
//!
//! The line of a slim disc runs ahead of its tips, by 0.9 px of a major semi-axis of 30 px (ratio 0.21) and 1.6 px of one of 20, and its ratio is up to a
//! tenth too small. Discs whose line is near the limit are measured, and their contours decide. Coarse views are too wide, and would pass.

use crate::conic::Ellipse;
use crate::detect::candidate::{Candidate, Verdict};
use crate::detect::of_target::within;
use crate::detect::{Disc, RejectionReason};

/// Part of the least ratio down to which a line may be that of a disc which has it.
pub(super) const SHOWN_SLIMMER: f64 = 0.85;
/// Part of it down to which something slim may be a disc: scratches and fibres are finer.
const SLIM: f64 = 0.4;
/// By how much two views of one slim region may differ in length.
const AS_LONG: f64 = 1.5;

/// Ratio of axes below which tips of lines are looked after.
const TIPS: f64 = 0.3;

/// Whether the line of such an ellipse runs so far ahead of its tips that it matters.
pub(super) fn is_slim(line: &Ellipse) -> bool {
    line.semi_minor_px < TIPS * line.semi_major_px
}

/// A disc that is seen too obliquely, or a streak; `share` of its line is an edge.
pub(super) fn slim_disc(candidate: Candidate, share: f64, least: f64) -> Verdict {
    let axis_ratio = candidate.ellipse.semi_minor_px / candidate.ellipse.semi_major_px;
    if share > 0.9 && axis_ratio > SLIM * least {
        Verdict::Rejected(candidate, RejectionReason::TooSlim { axis_ratio, least })
    } else {
        Verdict::Nothing
    }
}

/// Turns down what its contour shows to be too slim.
pub(super) fn turn_down_slim(refined: &mut [Result<Disc, RejectionReason>], least: f64) {
    for found in refined {
        let Ok(Disc { ellipse: e, .. }) = found else { continue };
        let axis_ratio = e.semi_minor_px / e.semi_major_px;
        if axis_ratio < least {
            *found = Err(RejectionReason::TooSlim { axis_ratio, least });
        }
    }
}

/// Drops coarse views of what a finer one shows to be too slim.
pub(super) fn drop_widened(candidates: &mut Vec<Candidate>, rejected: &[(Candidate, RejectionReason)]) {
    let is_slim = |r: &&(Candidate, RejectionReason)| matches!(r.1, RejectionReason::TooSlim { .. });
    let slim: Vec<&Candidate> = rejected.iter().filter(is_slim).map(|r| &r.0).collect();
    candidates.retain(|c| !slim.iter().any(|fine| widens(c, fine)));
}

/// Whether one view may be that of the other in larger pixels.
fn widens(coarse: &Candidate, fine: &Candidate) -> bool {
    let (a, b) = (coarse.ellipse.semi_major_px, fine.ellipse.semi_major_px);
    coarse.level > fine.level
        && coarse.bright == fine.bright
        && within(coarse.ellipse.center_px, fine.ellipse.center_px, fine.ellipse.semi_minor_px)
        && a.max(b) < AS_LONG * a.min(b)
}
