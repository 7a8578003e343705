//! Views whose labels are a pitch off.
//!
//! Where any dot may be the origin, the consensus rounds what the two images of a view are shifted by to whole pitches ([`super::consensus`]), and poses that
//! each camera finds alone may be half a pitch wrong where a lens is long and views are narrow. Then the common adjustment contradicts the images. Each view
//! is tried a pitch further each way, the one that lessens the cost most is kept, and so on as long as one does by more than chance.

use super::RigProblem;
use super::contradiction::{DOUBT, worst_px};
use super::joint::{Context, tried};
use super::side_by_side;
use super::sides::Way;
use std::slice::from_ref;

/// The way with views shifted so that the images agree better; none where they agree, or no shift helps.
pub(super) fn shifted(problem: &RigProblem, way: &Way, context: &Context<'_>) -> Option<Way> {
    if way.choice.best.iter().flatten().all(|(vote, _)| !vote.may_slide()) {
        return None;
    }
    let enough_px = DOUBT * worst_px(&way.monos);
    let mut least = tried(problem, from_ref(way), context)?;
    let mut best = None;
    for _ in 0..way.choice.common() {
        if least.rms_px < enough_px {
            break;
        }
        let from: &Way = best.as_ref().unwrap_or(way);
        let others: Vec<Way> =
            from.choice.shifted_by_one(problem).into_iter().map(|choice| Way { choice, ..from.clone() }).collect();
        let trials = side_by_side(&others, |other| tried(problem, from_ref(other), context));
        let found = others.into_iter().zip(trials).filter_map(|(other, trial)| Some((other, trial?)));
        let cheapest = found.min_by(|a, b| a.1.chi2.total_cmp(&b.1.chi2));
        let Some((other, trial)) = cheapest.filter(|(_, trial)| !least.as_good_as(trial)) else { break };
        (best, least) = (Some(other), trial);
    }
    best
}
