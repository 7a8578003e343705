//! What the adjustment would be without one view: predicted from the normal equations, and adjusted anew.
//!
//! At the minimum the gradient of all views is zero, so without view v it is minus that of v, and one Newton step of the remaining
//! equations gives the new estimate; their inverse its covariance. Estimates with and without a view differ by
//! ```text
//! d = x_without - x,    Cov(d) = C_without - C
//! ```
//! (the estimate with all views is efficient), which makes z-scores of a comparison of the two.
//!
//! Source: Cook and Weisberg, "Residuals and influence in regression" (1982); Hausman, "Specification tests in econometrics" (1978)
//! for the difference of covariances.

use super::adjust::{AdjustOptions, Adjustment, adjust, problem};
use super::layout::Places;
use super::model::Model;
use super::posterior::{self, Natural};
use super::state::State;
use crate::solve::{Iteration, Prediction, Problem, predict};
use nalgebra::DMatrix;

/// Functions of named parameters (lists of name and coefficient) by the global unknowns; parts that belong to views are left out.
/// `None` after a bad start.
pub fn named_rows(adjustment: &Adjustment, functions: &[Vec<(String, f64)>]) -> Option<DMatrix<f64>> {
    let (model, state) = (&adjustment.model, &adjustment.state);
    let places = Places::of(model);
    let rows = posterior::rows(model, &places, state, &posterior::natural(model, state)?)?;
    let mut out = DMatrix::zeros(functions.len(), places.global);
    for (k, function) in functions.iter().enumerate() {
        for (name, coefficient) in function {
            let terms = rows.iter().find(|r| r.name == *name).map_or(&[][..], |r| &r.terms);
            for (at, value) in terms.iter().filter(|(at, _)| *at < places.global) {
                out[(k, *at)] += coefficient * value;
            }
        }
    }
    Some(out)
}

/// A state of an adjustment's model in natural frames; `None` where a camera is none.
pub fn natural_of(model: &Model, state: &State) -> Option<Natural> {
    posterior::natural(model, state)
}

fn without(model: &Model, views: &[usize]) -> Model {
    let mut out = model.clone();
    out.images.retain(|i| !views.contains(&i.view));
    out
}

/// Change and covariance of `rows` (functions x global unknowns) without the images of a view; facts about it stay. `None` where
/// nothing can be said.
pub fn predicted_without_view(adjustment: &Adjustment, view: usize, rows: &DMatrix<f64>) -> Option<Prediction> {
    let model = without(&adjustment.model, &[view]);
    let equations = problem(&model).linearise(&adjustment.state)?;
    predict(&equations, rows)
}

/// The adjustment without the images of some views, from its estimate, with its sigmas and outliers. The result has no meaning for
/// those views themselves. `observe` sees each iteration and returns false to cancel.
pub fn readjusted_without_views(
    adjustment: &Adjustment,
    views: &[usize],
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Adjustment {
    let model = without(&adjustment.model, views);
    adjust(&model, adjustment.state.clone(), &AdjustOptions { rounds: 0, ..*options }, observe)
}

/// Covariance of `rows` (functions x global unknowns) at the minimum itself, as [`predicted_without_view`] gives it without a view.
pub fn predicted_with_all_views(adjustment: &Adjustment, rows: &DMatrix<f64>) -> Option<Prediction> {
    predict(adjustment.equations.as_ref()?, rows)
}
