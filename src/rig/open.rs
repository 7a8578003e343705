//! The common adjustment of two cameras whose views all show one plane, or planes parallel to each other.
//!
//! Such views leave the focal lengths open, if nothing else tells them (a focus relation, a known f); where nothing is known of axis points, these
//! as well. Without anything to hold on to, an adjustment follows the noise: of 19 jobs of bubbles in one sheet without `[focus]` seven were refused,
//! stalled at a tilt of 80 degrees or in the limit of iterations, and twelve ended at focal lengths between 0.3 and 2.3 times the true ones. What is
//! open by how little the images know of it, compared with what is usual, is held there (`bundle/open.rs`) and said to be undetermined:
//! ```text
//! f          that of the drawing, else its nominal value, else that of the start    15 %
//! cx, cy     their stated place or the sensor's centre                              5 % of width, height
//! ```
//! Where nothing is open, nothing of this enters.

use super::RigProblem;
use super::joint::Context;
use super::one_plane::{NOMINAL, all_in_plane, all_parallel, usual_values};
use super::starts::best_start;
use crate::bundle::{Adjustment, Fact, State, Termination, adjust, named_covariance, open_rows, released};

/// What is usual of focal lengths and axis points that are free and of which the rig file says nothing.
fn usual(problem: &RigProblem, start: &State) -> Vec<Fact> {
    let model = &problem.model;
    let stated = |c: usize, k: usize| {
        let of = |f: &Fact| matches!(f, Fact::Intrinsic { camera, parameter, .. } if [*camera, *parameter] == [c, k]);
        model.facts.iter().any(of)
    };
    let mut out = vec![];
    for (camera, own) in problem.starts.iter().enumerate() {
        let f = own.design.map(|d| d[0]).or(own.nominal_f_px).unwrap_or(start.cameras[camera].f_px);
        let centers = usual_values(own).into_iter().filter(|(k, ..)| [2, 3].contains(k));
        let free = |k: usize| model.cameras[camera].free[k] && !stated(camera, k);
        let all = std::iter::once((0, f, NOMINAL * f)).chain(centers).filter(|(k, ..)| free(*k));
        out.extend(all.map(|(parameter, value, sigma)| Fact::Intrinsic { camera, parameter, value, sigma }));
    }
    out
}

/// What holds the common adjustment where the images leave intrinsics open at a start: their usual values, as many as directions are open.
pub(super) fn usual_where_open(problem: &RigProblem, start: &State) -> Vec<Fact> {
    let model = &problem.model;
    let plain = model.cameras.len() == 2 && model.cameras.iter().all(|c| c.window.is_none());
    if !plain || !(all_in_plane(problem, 0..model.views.len()) || all_parallel(start)) {
        return vec![];
    }
    open_rows(model, start, &usual(problem, start))
}

/// The common adjustment with what is open held as is usual and taken out again; `None` where nothing is open.
pub(super) fn adjusted_as_usual(problem: &RigProblem, start: &State, context: &Context<'_>) -> Option<Adjustment> {
    let mut held = usual_where_open(problem, start);
    let usual = usual(problem, start);
    let mut from = None;
    // Each round holds fewer, or more than the start let expect; it does not go on for ever.
    for _ in 0..=usual.len() {
        if held.is_empty() {
            return None;
        }
        let mut with = problem.clone();
        with.model.facts.extend(held.iter().cloned());
        let state = match from.take() {
            Some(state) => state,
            None => best_start(&with, start.clone(), context.options, context.told),
        };
        let adjustment = adjust(&with.model, state, context.options, &mut |i| (context.told)(i));
        let over = matches!(adjustment.termination, Termination::Cancelled | Termination::BadStart);
        let found = released(adjustment, held.len())?;
        let all = open_rows(&found.adjustment.model, &found.adjustment.state, &usual);
        let next = if found.needed.len() < held.len() { found.needed } else { all };
        if over || next.len() == held.len() {
            return Some(found.adjustment);
        }
        from = Some(found.adjustment.state);
        held = next;
    }
    None
}

/// What the images leave open where an adjustment did not end, and what would tell it; a sentence after a blank, empty where nothing is open.
pub(super) fn left_open(adjustment: &Adjustment) -> String {
    let Some(covariance) = named_covariance(adjustment).filter(|c| c.shared_nullity() > 0) else {
        return String::new();
    };
    format!(
        " Nothing holds it along {} direction(s) that the images leave open: {}. Record a printed target, or the sheet itself, tilted by a few degrees in one or \
         more further views (a parallel shift does not help), or state the lens ([focus], [camera.design], f_px in [camera.known]).",
        covariance.shared_nullity(),
        covariance.undetermined.join("; ")
    )
}
