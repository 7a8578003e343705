//! Whether what was known beforehand agrees with the images.
//!
//! ```text
//! r = (x - prior) / sigma_prior          after the adjustment
//! p = sigma_post^2 / sigma_prior^2       0: the images alone decide, 1: only the prior speaks
//! z = r / sqrt(1 - p)                    standard normal where the prior is true
//! images alone:  x + (x - prior) p / (1 - p)  with  sigma_post / sqrt(1 - p)
//! ```
//! z is the prior against the images alone, `(x_images - prior) / sqrt(sigma_images^2 + sigma_prior^2)`, without a second adjustment:
//! the posterior is the weighted mean of the two. Where p is 1 the images say nothing, and nothing can be tested.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | r | [`PriorCheck::residual`] | departure of the estimate from the prior, in prior sigmas |
//! | p | [`PriorCheck::share`] | variance of the estimate over that of the prior |
//!
//! Source: Baarda, "A testing procedure for use in geodetic networks" (1968): a prior is one more observation.

use super::adjust::Adjustment;
use super::facts::{self, PriorOf};
use super::image_map::Slot;
use super::layout::Places;
use crate::solve::{Posterior, posterior};

/// Below this part of its variance the images move a prior too little for the residual to stand out from rounding.
const TESTABLE: f64 = 1e-6;

/// One prior after the adjustment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorCheck {
    /// What it is about.
    pub of: PriorOf,
    /// (estimate - prior) / sigma of the prior.
    pub residual: f64,
    /// Variance of the estimate over that of the prior, 0 to 1.
    pub share: f64,
}

impl PriorCheck {
    /// Standard normal where the prior is true; `None` where the images say nothing about it.
    pub fn z(&self) -> Option<f64> {
        let left = 1.0 - self.share;
        (left > TESTABLE).then(|| self.residual / left.sqrt())
    }

    /// What the images alone say, as `(distance from the prior, sigma)` in prior sigmas; `None` as for [`Self::z`].
    pub fn images_alone(&self) -> Option<(f64, f64)> {
        let left = 1.0 - self.share;
        (left > TESTABLE).then(|| (self.residual / left, (self.share / left).sqrt()))
    }
}

/// All priors of an adjustment; `None` after a bad start.
pub fn prior_checks(adjustment: &Adjustment) -> Option<Vec<PriorCheck>> {
    let (model, state) = (&adjustment.model, &adjustment.state);
    let places = Places::of(model);
    let post = posterior(adjustment.equations.as_ref()?);
    let check = |(of, row): (PriorOf, facts::Row)| PriorCheck {
        of,
        residual: row.residual,
        share: variance(&post, &row).clamp(0.0, 1.0),
    };
    Some(facts::rows(model, &places, state)?.into_iter().map(check).collect())
}

/// `j C j^T`.
fn variance(post: &Posterior, row: &facts::Row) -> f64 {
    let block = post.blocks.get(row.view);
    let covariance = |a: Slot, b: Slot| match (a, b) {
        (Slot::Global(i), Slot::Global(j)) => post.global[(i, j)],
        (Slot::Block(i), Slot::Block(j)) => block.map_or(0.0, |p| p.own[(i, j)]),
        (Slot::Block(i), Slot::Global(j)) | (Slot::Global(j), Slot::Block(i)) => {
            block.map_or(0.0, |p| p.with_global[(i, j)])
        }
    };
    let all = row.slots.iter().flat_map(|a| row.slots.iter().map(move |b| (a, b)));
    all.map(|((a, x), (b, y))| x * y * covariance(*a, *b)).sum()
}
