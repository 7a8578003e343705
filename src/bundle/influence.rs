//! What the adjustment would be without one view: predicted from the normal equations, and adjusted anew.
//!
//! At the minimum the gradient of all views is zero, so without view v it is minus that of v, and one Newton step of the remaining
//! equations gives the new estimate; their inverse its covariance. What each image puts into the equations is formed once for all views
//! (where every disc is estimated, and that would be much memory, once for each view). Estimates with and without a view differ by
//! ```text
//! d = x_without - x,    Cov(d) = C_without - C
//! ```
//! (the estimate with all views is efficient), which makes z-scores of a comparison of the two.
//!
//! Source: Cook and Weisberg, "Residuals and influence in regression" (1982); Hausman, "Specification tests in econometrics" (1978)
//! for the difference of covariances.

use super::adjust::{AdjustOptions, Adjustment, Bundle, adjust};
use super::assemble;
use super::facts::Fact;
use super::image_map::MappedNormal;
use super::layout::Places;
use super::model::{ImageObservations, Model};
use super::posterior::{self, Natural};
use super::state::State;
use crate::solve::{
    FIRST_DAMPING, Iteration, NormalEquations, Options, Outcome, Prediction, Problem, minimise_from, predict,
};
use nalgebra::DMatrix;
use std::collections::HashMap;

/// Functions of named parameters (lists of name and coefficient) by the global unknowns; parts that belong to views are left out.
/// `None` after a bad start.
pub fn named_rows(adjustment: &Adjustment, functions: &[Vec<(String, f64)>]) -> Option<DMatrix<f64>> {
    let (model, state) = (&adjustment.model, &adjustment.state);
    let places = Places::of(model);
    let rows = posterior::rows(model, &places, state, &posterior::natural(model, state)?)?;
    let by_name: HashMap<&str, &[(usize, f64)]> = rows.iter().map(|r| (r.name.as_str(), &r.terms[..])).collect();
    let mut out = DMatrix::zeros(functions.len(), places.global);
    for (k, function) in functions.iter().enumerate() {
        for (name, coefficient) in function {
            let terms = by_name.get(name.as_str()).copied().unwrap_or_default();
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

fn without(model: &Model, is_out: &dyn Fn(&ImageObservations) -> bool) -> Model {
    let Model { cameras, target, views, facts, images, loss } = model;
    let images = images.iter().filter(|i| !is_out(i)).cloned().collect();
    let (cameras, target) = (cameras.clone(), target.clone());
    Model { cameras, target, views: views.clone(), facts: facts.clone(), images, loss: *loss }
}

/// Most numbers kept of all images together.
const KEPT: usize = 4_000_000;

/// A function whose standard deviation grows by no more than this factor is not lost, whatever holds it.
const SPARED: f64 = 2.0;

/// An adjustment, ready to be asked what it would be without some of its views.
pub struct ViewsLeftOut<'a> {
    adjustment: &'a Adjustment,
    /// View and equations of each image at the estimate; none where they are too large to be kept.
    images: Option<Vec<(usize, MappedNormal)>>,
    /// The model without priors, where it has any.
    unaided: Option<Model>,
}

/// Whether a fact is a prior on what images tell, and no length.
fn is_prior(fact: &Fact) -> bool {
    matches!(fact, Fact::Intrinsic { .. } | Fact::Focus(_) | Fact::WindowParallel { .. })
}

impl<'a> ViewsLeftOut<'a> {
    /// Of an adjustment at its minimum.
    pub fn of(adjustment: &'a Adjustment) -> Self {
        let (model, state) = (&adjustment.model, &adjustment.state);
        let places = Places::of(model);
        // An image touches some thirty unknowns, and those of its discs where each is estimated.
        let of_disc = if places.offsets.is_some() { 4 * 30 + 20 } else { 0 };
        let numbers: usize = model.images.iter().map(|i| 500 + of_disc * (i.discs.len() + i.points.disc.len())).sum();
        let images = if numbers <= KEPT { assemble::of_each_image(model, &places, state) } else { None };
        let unaided = model.facts.iter().any(is_prior).then(|| {
            let mut out = model.clone();
            out.facts.retain(|f| !is_prior(f));
            out
        });
        Self { adjustment, images, unaided }
    }

    /// Normal equations of the images at hand without those of some views.
    fn summed(&self, bundle: &Bundle<'_>, views: &[usize]) -> Option<NormalEquations> {
        let images = self.images.as_ref()?.iter().filter(|(v, _)| !views.contains(v));
        bundle.summed(images, &self.adjustment.state)
    }

    /// The same, one block per view, for the facts of a model.
    fn equations(&self, model: &Model, views: &[usize]) -> Option<NormalEquations> {
        match self.images {
            // Beside its images a model without a view is the same.
            Some(_) => self.summed(&Bundle::with_views(model), views),
            None => Bundle::with_views(&without(model, &|i| views.contains(&i.view))).linearise(&self.adjustment.state),
        }
    }

    /// Change and covariance of `rows` (functions x global unknowns) without the images of some views; facts about them stay. What only
    /// priors hold then, and images do with the views, counts as not determined. `None` where nothing can be said.
    pub fn predicted(&self, views: &[usize], rows: &DMatrix<f64>) -> Option<Prediction> {
        let mut out = predict(&self.equations(&self.adjustment.model, views)?, rows)?;
        let unaided = |views: &[usize]| predict(&self.equations(self.unaided.as_ref()?, views)?, rows);
        let Some(alone) = unaided(views) else { return Some(out) };
        let held: Vec<usize> = (0..rows.nrows()).filter(|&k| out.determined[k] && !alone.determined[k]).collect();
        if held.is_empty() {
            return Some(out);
        }
        if let (Some(all), Some(all_alone)) = (predicted_with_all_views(self.adjustment, rows), unaided(&[])) {
            let grows = |k: usize| out.covariance[(k, k)] > SPARED * SPARED * all.covariance[(k, k)];
            let lost: Vec<usize> = held.into_iter().filter(|&k| all_alone.determined[k] && grows(k)).collect();
            lost.into_iter().for_each(|k| out.determined[k] = false);
        }
        Some(out)
    }

    /// State and Newton decrement of the adjustment without the images of a view, from its estimate, with its sigmas and outliers, and
    /// why it ended. The state has no meaning for that view itself. `observe` sees each iteration and returns false to cancel.
    pub fn readjusted(
        &self,
        view: usize,
        options: &Options,
        observe: &mut dyn FnMut(&Iteration) -> bool,
    ) -> Option<Outcome<State>> {
        let model = without(&self.adjustment.model, &|i| i.view == view);
        let bundle = Bundle::of(&model);
        let state = &self.adjustment.state;
        let equations = self.summed(&bundle, &[view]).or_else(|| bundle.linearise(state))?;
        let start = (state.clone(), equations);
        Some(minimise_from(&bundle, start, options, FIRST_DAMPING, observe))
    }
}

/// The adjustment without some images, from its estimate, with its sigmas and outliers. The result has no meaning for views of which no image is
/// left. `observe` sees each iteration and returns false to cancel.
pub fn readjusted_without(
    adjustment: &Adjustment,
    is_out: &dyn Fn(&ImageObservations) -> bool,
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Adjustment {
    let model = without(&adjustment.model, is_out);
    adjust(&model, adjustment.state.clone(), &AdjustOptions { rounds: 0, ..*options }, observe)
}

/// Covariance of `rows` (functions x global unknowns) at the minimum itself, as [`ViewsLeftOut::predicted`] gives it without a view.
pub fn predicted_with_all_views(adjustment: &Adjustment, rows: &DMatrix<f64>) -> Option<Prediction> {
    predict(adjustment.equations.as_ref()?, rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::rig_scene::Scene;

    fn adjusted(per_view: bool, points: bool) -> Adjustment {
        let scene = Scene::build(4, per_view, true, points).with_noise(4);
        let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
        adjust(&scene.model, scene.truth.clone(), &options, &mut |_| true)
    }

    /// To the bit, for either order of the unknowns.
    #[test]
    fn equations_without_a_view_are_those_of_a_model_without_it() {
        for (per_view, points) in [(false, false), (true, false), (false, true)] {
            let adjustment = adjusted(per_view, points);
            let all = ViewsLeftOut::of(&adjustment);
            let full = Bundle::with_views(&adjustment.model).linearise(&adjustment.state).unwrap();
            for view in 0..adjustment.model.views.len() {
                let model = without(&adjustment.model, &|i| i.view == view);
                assert!(model.images.len() < adjustment.model.images.len());
                for bundle in [Bundle::of(&model), Bundle::with_views(&model)] {
                    let wanted = bundle.linearise(&adjustment.state).unwrap();
                    assert_eq!(all.summed(&bundle, &[view]).unwrap(), wanted);
                    assert_ne!(wanted, full);
                }
            }
        }
    }

    /// The same minimum as an adjustment that forms all equations anew, and the prediction nearly there.
    #[test]
    fn a_view_is_left_out_as_by_an_adjustment_without_it() {
        let adjustment = adjusted(false, false);
        let all = ViewsLeftOut::of(&adjustment);
        let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
        for view in 0..adjustment.model.views.len() {
            let out = all.readjusted(view, &options.solve, &mut |_| true).unwrap();
            let wanted = readjusted_without(&adjustment, &|i| i.view == view, &options, &mut |_| true);
            assert!(out.decrement < options.solve.decrement && wanted.decrement < options.solve.decrement);
            assert!((out.cost - wanted.cost).abs() < 1e-9 * wanted.cost, "{} {}", out.cost, wanted.cost);
            for (a, b) in out.state.cameras.iter().zip(&wanted.state.cameras) {
                assert!((a.f_px / b.f_px - 1.0).abs() < 1e-6, "{} {}", a.f_px, b.f_px);
            }
        }
    }
}
