//! Which view is wrong, where some disagree.
//!
//! A view that is wrong moves the estimate, and then every other view disagrees with that estimate a little. So each view is asked
//! how much better all would fit if its own estimate were free. With V its share of the information (whitened by all of it), q
//! the whitened gradient it leaves to the others, and `V = sum lambda_k u_k u_k^T`:
//! ```text
//! d   = x_without - x                       change of cameras, motion and sheet without the view
//! D   = Cov(d) = C_without - C              for lambda_k in (0, 1): D_k = lambda_k / (1 - lambda_k)
//! T   = d^T D^+ d = sum (u_k . q)^2 / (lambda_k (1 - lambda_k))
//! ```
//! T is twice the gain in log-likelihood, for the view alone and for the others together: chi-square with the rank of D where the view
//! is right. Noise of edge points that no camera could follow cancels in it, and a view is not spared for being the strongest.
//! The largest T names the wrong view. That is then put to the proof: an adjustment without it, in which the rest must agree; where they
//! do not, the next view is sought among them (two wrong views hide each other as long as both are there). At last every view but the
//! last one found is taken back for once: one that agrees with what is left was named by mistake.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | T | [`Disagreement::statistic`] | how much better all would fit if the view were free |
//!
//! Source: Hausman, "Specification tests in econometrics" (1978); Cook and Weisberg, "Residuals and influence in regression" (1982).

use super::{Subject, Watch, brief, near_its_minimum};
use crate::bundle::{
    Adjustment, ImageObservations, Iteration, Parameter, Prediction, ViewsLeftOut, named_rows,
    predicted_with_all_views, readjusted_without, symmetric_eigen,
};
use crate::error::Result;
use crate::stats::chi_square_above;
use crate::threads::gathered;
use nalgebra::{DMatrix, DVector};

/// Information below this part of the largest is rounding: named parameters are not independent of each other.
const INDEPENDENT: f64 = 1e-9;
/// Difference of covariances, part of the covariance, below which rounding would be tested.
const TESTABLE: f64 = 1e-4;
/// Twice the log of a likelihood ratio of 100: two views whose T differ by less cannot be told apart.
pub(super) const TOLD_APART: f64 = 9.2;
/// Chance of naming one view too many in a round of the search: it follows an alarm, and every round asks anew.
pub(super) const BY_CHANCE: f64 = 0.001;
/// Views that are put to the proof in each round.
const TRIED: usize = 3;
/// Where more than this part of the views would have to go, it is not single views that are wrong.
pub(super) const MOST: f64 = 0.34;

/// How much one view disagrees with the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Disagreement {
    pub(super) view: usize,
    pub(super) statistic: f64,
    pub(super) degrees: usize,
}

impl Disagreement {
    /// Beyond its expectation.
    fn excess(&self) -> f64 {
        self.statistic - self.degrees as f64
    }

    /// Whether it is beyond chance, `tests` being asked together.
    fn is_significant(&self, tests: usize) -> bool {
        chi_square_above(self.statistic, self.degrees as f64) * (tests as f64) < BY_CHANCE
    }
}

/// A wrong view, and those that could be it instead.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Culprit {
    pub(super) view: usize,
    pub(super) rivals: Vec<usize>,
}

/// The views that must go so that the rest agree.
pub(super) struct Wrong {
    /// In their order.
    pub(super) views: Vec<Culprit>,
    /// T of all of them together, less its degrees of freedom.
    pub(super) excess: f64,
    /// The adjustment without them; none where it does not get near its minimum.
    pub(super) without: Option<Adjustment>,
    /// Where sigmas had been enlarged for them: the adjustment with those that are left without them, and by how much these are smaller.
    pub(super) hidden: Option<(Adjustment, f64)>,
}

/// T of a view (or of several, called by one) from what its absence does to functions whose covariance with all views is `full`; `None` where nothing can be tested.
fn disagreement(view: usize, full: &Prediction, p: &Prediction) -> Option<Disagreement> {
    let usable: Vec<usize> = (0..full.determined.len())
        .filter(|&k| full.determined[k] && p.determined[k] && full.covariance[(k, k)] > 0.0)
        .collect();
    let n = usable.len();
    let sigma = |i: usize| full.covariance[(usable[i], usable[i])].sqrt();
    let scaled = |m: &DMatrix<f64>| {
        DMatrix::from_fn(n, n, |i, j| {
            let (a, b) = (usable[i], usable[j]);
            0.5 * (m[(a, b)] + m[(b, a)]) / (sigma(i) * sigma(j))
        })
    };
    let eigen = symmetric_eigen(&scaled(&full.covariance))?;
    let kept: Vec<usize> = (0..n).filter(|&k| eigen.values[k] > INDEPENDENT * n as f64).collect();
    let whiten = DMatrix::from_fn(kept.len(), n, |i, j| eigen.vectors[(j, kept[i])] / eigen.values[kept[i]].sqrt());
    let change = &whiten * DVector::from_fn(n, |i, _| p.shift[usable[i]] / sigma(i));
    let more = &whiten * (scaled(&p.covariance) - scaled(&full.covariance)) * whiten.transpose();
    let eigen = symmetric_eigen(&more)?;
    let (mut statistic, mut degrees) = (0.0, 0);
    for (k, value) in eigen.values.iter().enumerate().filter(|(_, v)| **v > TESTABLE) {
        statistic += eigen.vectors.column(k).dot(&change).powi(2) / value;
        degrees += 1;
    }
    (degrees > 0 && f64::is_finite(statistic)).then_some(Disagreement { view, statistic, degrees })
}

/// Cameras, motion and sheet, each number as a function of its own.
fn functions(s: &Subject<'_>, names: &[&str]) -> Vec<Vec<(String, f64)>> {
    let own = [names.first().copied().unwrap_or_default(), names.get(1).copied().unwrap_or_default()];
    let all = s.covariance.names.iter().filter(|n| Parameter::of(n, own).is_some());
    all.map(|n| vec![(n.clone(), 1.0)]).collect()
}

/// Views of which there is an image.
pub(super) fn seen(a: &Adjustment) -> Vec<usize> {
    (0..a.model.views.len()).filter(|v| a.model.images.iter().any(|i| i.view == *v)).collect()
}

/// All views that have an image, in their order.
fn disagreements(a: &Adjustment, functions: &[Vec<(String, f64)>], watch: &Watch<'_>) -> Result<Vec<Disagreement>> {
    let full = || {
        let rows = named_rows(a, functions)?;
        Some((predicted_with_all_views(a, &rows)?, rows))
    };
    let Some((full, rows)) = full() else { return Ok(vec![]) };
    let without = ViewsLeftOut::of(a);
    let one = |v: &usize| {
        watch.check()?;
        Ok(without.predicted(&[*v], &rows).and_then(|p| disagreement(*v, &full, &p)))
    };
    let all: Result<Vec<Option<Disagreement>>> = gathered(true, &seen(a), one);
    Ok(all?.into_iter().flatten().collect())
}

/// A view left out for the proof, beside those that are out already.
struct Trial {
    out: Disagreement,
    /// What disagrees among the rest.
    left: Vec<Disagreement>,
}

struct Search<'a> {
    s: &'a Subject<'a>,
    functions: Vec<Vec<(String, f64)>>,
    views: usize,
    watch: &'a Watch<'a>,
}

impl Search<'_> {
    /// Views that disagree, the likeliest first.
    fn suspects(&self, a: &Adjustment) -> Result<Vec<Disagreement>> {
        let mut out = disagreements(a, &self.functions, self.watch)?;
        out.retain(|d| d.is_significant(self.views));
        out.sort_by(|a, b| b.excess().total_cmp(&a.excess()).then(a.view.cmp(&b.view)));
        Ok(out)
    }

    /// The adjustment without views; `None` where it does not get near its minimum.
    fn without(&self, views: &[usize]) -> Result<Option<Adjustment>> {
        let is_out = |i: &ImageObservations| views.contains(&i.view);
        let goes_on = &mut |i: &Iteration| self.watch.goes_on(i);
        near_its_minimum(readjusted_without(self.s.adjustment, &is_out, &brief(self.s), goes_on))
    }

    /// The first suspects, each left out for once.
    fn trials(&self, suspects: &[Disagreement], out: &[Culprit]) -> Result<Vec<Trial>> {
        let without = |d: &Disagreement| {
            let views: Vec<usize> = out.iter().map(|c| c.view).chain([d.view]).collect();
            let Some(adjustment) = self.without(&views)? else { return Ok(None) };
            let left = self.suspects(&adjustment)?;
            Ok(Some(Trial { out: *d, left }))
        };
        let first = &suspects[..suspects.len().min(TRIED)];
        let tried: Result<Vec<Option<Trial>>> = gathered(true, first, without);
        Ok(tried?.into_iter().flatten().collect())
    }

    /// Takes back those that agree with what is left.
    fn pardoned(&self, mut out: Vec<Culprit>) -> Result<Vec<Culprit>> {
        let mut k = 0;
        while out.len() > 1 && k + 1 < out.len() {
            let rest: Vec<usize> = out.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, c)| c.view).collect();
            let agrees = match self.without(&rest)? {
                Some(a) => self.suspects(&a)?.is_empty(),
                None => false,
            };
            if agrees {
                out.remove(k);
            } else {
                k += 1;
            }
        }
        Ok(out)
    }
}

/// Whether views contradict each other in an adjustment of the same rig.
pub(super) fn contradict(s: &Subject<'_>, names: &[&str], a: &Adjustment, watch: &Watch<'_>) -> Result<bool> {
    let search = Search { s, functions: functions(s, names), views: seen(a).len(), watch };
    Ok(!search.suspects(a)?.is_empty())
}

/// The wrong views; `None` where no few are, or nothing disagrees.
pub(super) fn culprits(s: &Subject<'_>, names: &[&str], watch: &Watch<'_>) -> Result<Option<Wrong>> {
    let views = seen(s.adjustment).len();
    let search = Search { s, functions: functions(s, names), views, watch };
    let mut suspects = search.suspects(s.adjustment)?;
    let mut out: Vec<Culprit> = vec![];
    while !suspects.is_empty() {
        let most = (out.len() + 1) as f64 > MOST * views as f64;
        let mut trials = if most { vec![] } else { search.trials(&suspects, &out)? };
        if trials.is_empty() {
            return Ok(None);
        }
        // Of several without which the rest agree, the likeliest stands first; where none is enough, the likeliest of all goes.
        let clears = |t: &Trial| t.left.is_empty();
        let best = trials.iter().position(clears).unwrap_or(0);
        let close = |t: &&Trial| clears(t) && trials[best].out.excess() - t.out.excess() < TOLD_APART;
        let rivals = trials[best + 1..].iter().filter(close).map(|t| t.out.view).collect();
        let Trial { out: found, left } = trials.swap_remove(best);
        out.push(Culprit { view: found.view, rivals });
        suspects = left;
    }
    let mut views = search.pardoned(out)?;
    if views.is_empty() {
        return Ok(None);
    }
    views.sort_by_key(|c| c.view);
    let all: Vec<usize> = views.iter().map(|c| c.view).collect();
    let together = || {
        let rows = named_rows(s.adjustment, &search.functions)?;
        let full = predicted_with_all_views(s.adjustment, &rows)?;
        let p = ViewsLeftOut::of(s.adjustment).predicted(&all, &rows)?;
        disagreement(all[0], &full, &p)
    };
    let excess = together().map_or(0.0, |d| d.excess());
    Ok(Some(Wrong { excess, without: search.without(&all)?, hidden: None, views }))
}
