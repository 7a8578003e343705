//! Whether views that no common motion of the cameras explains are explained by one that was moved between two of them.
//!
//! A step of the second camera before each view in turn is adjusted, on a part of the edge points. It is told where the best of them fits
//! half as badly as without, and about as well as the cameras fit alone.

use super::contradiction::{DOUBT, worst_px};
use super::joint::{Context, Together, quick};
use super::mono::thinned_model;
use super::{Mono, rms_in, rms_of};
use crate::bundle::{MovedFit, State, moved_before};

/// A move explains what is wrong if the residuals fall to this part of theirs without it.
const RELIEF: f64 = 0.5;

/// A camera that was moved before a view.
pub(super) struct Step {
    pub(super) fit: MovedFit,
    pub(super) rms_px: f64,
    without_px: f64,
    views: usize,
}

/// The step that explains what a common adjustment does not; `None` where none does.
pub(super) fn explaining_step(solved: &Together, monos: &[Mono], context: &Context<'_>) -> Option<Step> {
    let model = thinned_model(&solved.problem.model);
    let without_px = rms_of(&solved.problem.model, &solved.adjustment.state)?;
    // A push that stopped the common adjustment has led it astray.
    let start = State { offsets_mm: vec![], ..solved.start.clone() };
    let fit = moved_before(&model, &start, &quick(context.options).solve, context.told)?;
    let rms_px = rms_in(&model, |image| fit.state_of(image))?;
    let explains = rms_px < RELIEF * without_px && rms_px < DOUBT * worst_px(monos);
    explains.then_some(Step { fit, rms_px, without_px, views: model.views.len() })
}

impl Step {
    /// What happened, and what to do.
    pub(super) fn words(&self) -> String {
        let [turn_rad, shift_mm] = self.fit.moved_by();
        format!(
            "{}: turned by {:.2} degrees and shifted by {:.2} mm against the other ({:.2} px rms with it, {:.2} without); {}",
            self.fit.when.words(self.views),
            turn_rad.to_degrees(),
            shift_mm,
            self.rms_px,
            self.without_px,
            self.fit.when.advice(self.views)
        )
    }
}
