//! Wrong views behind standard deviations that were enlarged for them.
//!
//! Where whole discs lie off, all sigmas of a camera are enlarged as much, and a view that is wrong by a pixel agrees with the others within them. So views are
//! left out, one after the other, as long as what is left fits better:
//! ```text
//! s_c(V)   factor by which the sigmas of camera c are enlarged where the views V are left out, adjusted with these sigmas
//! V        each time the view with which  L = sum_c n_c ln s_c(V)  falls most, n_c the discs that camera c sees
//! e(V)     = max(max_c s_c(V)^2 - 1, 1/2)                     variance of what discs are off beyond their noise
//! F        = (e(V) (k + 2) / e(V + v) - k) / 2                 with 2 over k = 2 (m - 1) - 5 degrees of freedom, m views but for V
//! ```
//! Where all views are off by something of their own, one of them is furthest off: of the two numbers by which a view may differ from the others (the shift of one image
//! against the other) cameras and motion follow five altogether, and what leaving out v explains is distributed as F. Only where that is no chance, over all views
//! that could have been left out, v belongs to V.
//!
//! With the sigmas `s_c(V)` all views are adjusted again and asked whether they contradict each other, as where nothing was enlarged ([`super::culprit`]):
//! the views named there are wrong.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | s_c | `scales` | factor of the given sigmas of a camera |
//! | L | `noise` | log of the noise of all discs |
//! | e | `excess` | what scatters beyond noise |
//! | F | `explained` | what one view more explains |

use super::culprit::{BY_CHANCE, MOST, Wrong, culprits, seen};
use super::{Subject, Watch};
use crate::bundle::{
    AdjustOptions, Adjustment, ImageObservations, SolveOptions, Termination, readjusted_with, readjusted_without,
    sigma_scales,
};
use crate::error::{Result, Unusable};
use crate::stats::ratio_above;
use crate::threads::gathered;

/// Factor by which sigmas were enlarged from which on it is asked why.
const ENLARGED: f64 = 1.5;
/// Factor by which sigmas fall at least without a view, that another one is sought beside it.
const FALLS: f64 = 1.15;
/// Views beyond which none is left out, and most that are.
const MOST_ADJUSTED: usize = 40;
const MOST_WRONG: usize = 3;
/// Views without which the rest is adjusted with its own sigmas.
const TRIED: usize = 3;
/// Rounds of sigmas and adjustment, and the change of sigmas at which they end.
const ROUNDS: usize = 4;
const SETTLED: f64 = 0.05;
/// Numbers by which a view may differ from the others, and those of them that cameras and motion follow.
const OF_VIEW: f64 = 2.0;
const FOLLOWED: f64 = 5.0;
/// Variance beyond noise that is not told from none.
const LEAST: f64 = 0.5;

/// An adjustment without views, and the factors of the sigmas that its residuals show.
struct Left {
    adjustment: Adjustment,
    scales: Vec<f64>,
}

/// Largest factor by which sigmas fall.
fn falls(from: &[f64], to: &[f64]) -> f64 {
    from.iter().zip(to).map(|(a, b)| a / b).fold(0.0, f64::max)
}

/// Whether nothing is left to explain.
fn is_noise(scales: &[f64]) -> bool {
    scales.iter().all(|s| *s < ENLARGED)
}

/// Variance of discs beyond noise.
fn excess(scales: &[f64]) -> f64 {
    (scales.iter().fold(1.0, |a: f64, b| a.max(*b)).powi(2) - 1.0).max(LEAST)
}

/// Chance that one view of `views` explains so much where all differ alike, `ways` having been asked.
fn by_chance([before, after]: [&[f64]; 2], views: usize, ways: f64) -> f64 {
    let rest = OF_VIEW * (views as f64 - 1.0) - FOLLOWED;
    if rest < 1.0 {
        return 1.0;
    }
    let explained = (excess(before) / excess(after) * (rest + OF_VIEW) - rest) / OF_VIEW;
    ratio_above(explained, [OF_VIEW, rest]) * ways
}

struct Search<'a> {
    s: &'a Subject<'a>,
    options: AdjustOptions,
    /// Discs that each camera sees.
    discs: Vec<f64>,
    watch: &'a Watch<'a>,
}

impl Search<'_> {
    fn noise(&self, left: &Left) -> f64 {
        self.discs.iter().zip(&left.scales).map(|(n, s)| n * s.ln()).sum()
    }

    /// `None` where it does not get near its minimum.
    fn reached(&self, a: Adjustment) -> Result<Option<Left>> {
        if a.termination == Termination::Cancelled {
            return Err(Unusable::Cancelled.into());
        }
        let near = a.decrement < 0.1;
        Ok(near.then(|| sigma_scales(&a)).flatten().map(|scales| Left { adjustment: a, scales }))
    }

    /// With the sigmas that all views show.
    fn without(&self, views: &[usize]) -> Result<Option<Left>> {
        self.watch.check()?;
        let is_out = |i: &ImageObservations| views.contains(&i.view);
        self.reached(readjusted_without(self.s.adjustment, &is_out, &self.options, &mut |i| self.watch.goes_on(i)))
    }

    fn with(&self, a: &Adjustment, scales: &[f64], from: &Adjustment) -> Result<Option<Left>> {
        // A loss that spares what is far off converges slowly beside it.
        let options = AdjustOptions { solve: SolveOptions { iterations: 200, ..self.options.solve }, ..self.options };
        self.reached(readjusted_with(a, scales, &from.state, &options, &mut |i| self.watch.goes_on(i)))
    }

    /// With the sigmas that its own residuals show, beginning with those given: enlarged ones keep a camera out for whose residuals they were.
    fn settled(&self, left: Left) -> Result<Option<Left>> {
        let given = vec![1.0; left.scales.len()];
        let Some(mut left) = self.with(&left.adjustment, &given, &left.adjustment)? else { return Ok(None) };
        for _ in 0..ROUNDS {
            let Some(next) = self.with(&left.adjustment, &left.scales, &left.adjustment)? else { return Ok(None) };
            let changed = falls(&left.scales, &next.scales).max(falls(&next.scales, &left.scales));
            left = next;
            if changed < 1.0 + SETTLED {
                break;
            }
        }
        Ok(Some(left))
    }

    /// The view without which, beside those that are out, least is left.
    fn next(&self, out: &[usize], views: &[usize]) -> Result<Option<(usize, Left)>> {
        let others: Vec<usize> = views.iter().copied().filter(|v| !out.contains(v)).collect();
        let one = |v: &usize| Ok(self.without(&[out, &[*v]].concat())?.map(|left| (*v, left)));
        let first: Result<Vec<_>> = gathered(true, &others, one);
        let mut first: Vec<(usize, Left)> = first?.into_iter().flatten().collect();
        first.sort_by(|a, b| self.noise(&a.1).total_cmp(&self.noise(&b.1)));
        first.truncate(TRIED);
        let again: Result<Vec<_>> = first.into_iter().map(|(v, left)| Ok((v, self.settled(left)?))).collect();
        let settled = again?.into_iter().filter_map(|(v, left)| Some((v, left?)));
        Ok(settled.min_by(|a, b| self.noise(&a.1).total_cmp(&self.noise(&b.1))))
    }

    /// What is left without the views for which sigmas were enlarged; `None` where there are none.
    fn left(&self, now: &[f64]) -> Result<Option<Left>> {
        let views = seen(self.s.adjustment);
        let n = views.len();
        let most = ((MOST * n as f64) as usize).min(MOST_WRONG);
        let (mut out, mut last, mut found, mut ways) = (vec![], now.to_vec(), None, 1.0);
        while out.len() < most {
            let Some((view, left)) = self.next(&out, &views)? else { break };
            let others = n - out.len();
            out.push(view);
            ways *= others as f64 / out.len() as f64;
            let (fell, chance) = (falls(&last, &left.scales), by_chance([&last, &left.scales], others, ways));
            last.clone_from(&left.scales);
            if chance < BY_CHANCE {
                found = Some(left);
            }
            if fell < FALLS || is_noise(&last) {
                break;
            }
        }
        Ok(found)
    }
}

/// Wrong views that hide behind enlarged sigmas; `None` where sigmas are not enlarged, or not for a few views.
pub(super) fn hidden(s: &Subject<'_>, names: &[&str], watch: &Watch<'_>) -> Result<Option<Wrong>> {
    let a = s.adjustment;
    let own = |c: usize| a.model.images.iter().filter(move |i| i.camera == c);
    let cameras = 0..a.model.cameras.len();
    let now: Vec<f64> = cameras.clone().map(|c| own(c).map(|i| i.sigma_scale).fold(1.0, f64::max)).collect();
    if is_noise(&now) || a.model.views.len() > MOST_ADJUSTED {
        return Ok(None);
    }
    let solve = SolveOptions { decrement: 1e-3, iterations: 40 };
    let options = AdjustOptions { solve, rounds: 0, ..*s.options };
    let discs = cameras.map(|c| own(c).map(|i| i.discs.len() as f64).sum()).collect();
    let search = Search { s, options, discs, watch };
    let Some(left) = search.left(&now)? else { return Ok(None) };
    let Some(Left { adjustment: strict, .. }) = search.with(a, &left.scales, &left.adjustment)? else {
        return Ok(None);
    };
    let Some(wrong) = culprits(&Subject { adjustment: &strict, ..*s }, names, watch)? else { return Ok(None) };
    let kept = wrong.without.as_ref().and_then(sigma_scales);
    let fell = kept.map(|kept| falls(&now, &kept)).filter(|fell| *fell > ENLARGED);
    Ok(fell.map(|fell| Wrong { hidden: Some((strict, fell)), ..wrong }))
}
