//! Intrinsics that the images leave open: held by what is usual while everything is adjusted, and said to be undetermined afterwards.
//!
//! Views of one fixed sheet give `2 x 8 - 4 = 12` numbers for the 15 of a pair of cameras, motion and plane. A length takes one of the three that are
//! left, and two remain, in which both focal lengths change, and tilts, motion and sheet with them. Only distortion tells these apart, and with a noise
//! that makes its trace on f as large as f itself: chi-square differs by one to four between a third and twice the focal length. Its minimum lies
//! anywhere, in the limit of the tilts (80 degrees) as well, where an adjustment stalls; elsewhere its standard deviations, which are those of the place
//! where it ended, make a number that nobody knows look known. So:
//! ```text
//! adjusted:   images + facts + (x - usual) / sigma of as many intrinsics as directions are open
//! reported:   images + facts, without what they say of the directions that the last rows held       (solve/open.rs)
//! ```
//! As many rows as open directions cost nothing but the noise that these directions hold: everything else is where it would be with the open
//! directions held anywhere, and no row of what is usual remains in the model, the cost or the covariance.

use super::adjust::{Adjustment, Bundle};
use super::facts::{Fact, intrinsic_rows};
use super::layout::Places;
use super::model::Model;
use super::state::State;
use crate::solve::{OpenCombinations, Problem};

/// An adjustment without the usual values that held it.
#[derive(Debug, Clone)]
pub struct Released {
    /// The adjustment: model and cost without those facts, equations without what the images say of the directions that are open.
    pub adjustment: Adjustment,
    /// Those of the facts that suffice to hold the open directions.
    pub needed: Vec<Fact>,
}

/// The facts of `usual` that suffice to hold what the images and facts of a model leave open at a state: as many as directions are open, each
/// an intrinsic with its usual value and departure. Empty where none is open, or where that cannot be told.
pub fn open_rows(model: &Model, state: &State, usual: &[Fact]) -> Vec<Fact> {
    let places = Places::of(model);
    let found = || {
        let rows = intrinsic_rows(model, &places, state, usual)?;
        OpenCombinations::of(&Bundle::with_views(model).linearise(state)?, &rows)
    };
    found().map_or_else(Vec::new, |open| needed(&open, usual))
}

/// Takes the last `held` facts out of an adjustment, which are usual values of intrinsics; `None` where it has no equations.
pub fn released(mut adjustment: Adjustment, held: usize) -> Option<Released> {
    let model = &mut adjustment.model;
    let usual = model.facts.split_off(model.facts.len().checked_sub(held)?);
    let equations = Bundle::with_views(model).linearise(&adjustment.state)?;
    let rows = intrinsic_rows(model, &Places::of(model), &adjustment.state, &usual)?;
    adjustment.cost = equations.cost;
    let Some(open) = OpenCombinations::of(&equations, &rows) else {
        adjustment.equations = Some(equations);
        return Some(Released { adjustment, needed: vec![] });
    };
    adjustment.equations = Some(open.taken_from(&equations, &rows));
    Some(Released { adjustment, needed: needed(&open, &usual) })
}

fn needed(open: &OpenCombinations, usual: &[Fact]) -> Vec<Fact> {
    open.leading_rows().into_iter().map(|k| usual[k].clone()).collect()
}
