//! Wrong views behind standard deviations that were enlarged for them.
//!
//! Where whole discs lie off, all sigmas of a camera are enlarged as much, and a view that is wrong by a pixel agrees with the others within them. So views are
//! left out, one after the other, as long as what is left fits better:
//! ```text
//! s_c(V)   factor by which the sigmas of camera c are enlarged where the views V are left out, adjusted with these sigmas
//! V        each time the view with which  L = sum_c n_c ln s_c(V)  falls most, n_c the discs that camera c sees
//! e(V)     = max(max_c s_c(V)^2 - 1, 1/2)                     variance of what discs are off beyond their noise
//! F        = (e(V) (k + 2) / e(V + v) - k) / 2                 with 2 over k = 2 (m - 1) - 5 degrees of freedom, m views but for V
//! P(F > f) = (1 + 2 f / k)^(-k / 2) = (e(V) (k + 2) / (e(V + v) k))^(-k / 2)
//! ```
//! Where all views are off by something of their own, one of them is furthest off: of the two numbers by which a view may differ from the others (the shift of one image
//! against the other) cameras and motion follow five altogether, and what leaving out v explains is distributed as F. Only where that is no chance, over all views
//! that could have been left out, v belongs to V. (Five is what experiments give: of 40 rigs of six views, all images off by something of their own, four fall by 2.3 or more.)
//!
//! At last every view of V but the last one is taken back for once: one that explains nothing beside the others was named by mistake.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | s_c | `scales` | factor of the given sigmas of a camera |
//! | L | `noise` | log of the noise of all discs |
//! | e | `excess` | what scatters beyond noise |
//! | k | `rest` | degrees of freedom that are left |
//!
//! Source: Foerstner, "Ein Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten" (1979), for the factors; Snedecor's F, in closed form for two over k.

use super::culprit::{BY_CHANCE, Culprit, MOST, Wrong, seen};
use super::{MOST_ADJUSTED, Subject, Watch, brief, near_its_minimum};
use crate::bundle::{
    AdjustOptions, Adjustment, ImageObservations, SolveOptions, readjusted_with, readjusted_without, sigma_scales,
};
use crate::error::Result;
use crate::threads::gathered;

/// Factor by which sigmas were enlarged from which on it is asked why: larger ones hold what discs scatter by, but not that all of them are off alike.
pub(super) const ENLARGED: f64 = 1.5;
/// Factor by which sigmas fall at least without a view, that another one is sought beside it.
const FALLS: f64 = 1.15;
/// Views that are left out at most.
const MOST_WRONG: usize = 3;
/// Views without which the rest is adjusted with its own sigmas.
const TRIED: usize = 3;
/// Rounds of sigmas and adjustment, and the change of sigmas at which they end.
const ROUNDS: usize = 4;
const SETTLED: f64 = 0.05;
/// Numbers by which a view may differ from the others, and those of them that cameras and motion follow.
const OF_VIEW: f64 = 2.0;
const FOLLOWED: f64 = 5.0;
/// Part of what is beyond noise without one view up to which it is as good to leave out another one.
const AS_GOOD: f64 = 1.5;
/// Variance beyond noise that is not told from none.
const LEAST: f64 = 0.5;

/// An adjustment without views, and the factors of the sigmas that its residuals show.
#[derive(Clone)]
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
    let part = excess(before) * (rest + OF_VIEW) / (excess(after) * rest);
    part.max(1.0).powf(-0.5 * rest) * ways
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
        let left = |a: Adjustment| sigma_scales(&a).map(|scales| Left { adjustment: a, scales });
        Ok(near_its_minimum(a)?.and_then(left))
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

    /// With the sigmas that its own residuals show. Where one camera's are large the other one leads, and they stay so: from there those that are given are tried, too.
    fn settled(&self, left: Left) -> Result<Option<Left>> {
        let scales = left.scales.clone();
        let Some(own) = self.settled_from(left, &scales)? else { return Ok(None) };
        if is_noise(&own.scales) {
            return Ok(Some(own));
        }
        let given = self.settled_from(own.clone(), &vec![1.0; own.scales.len()])?;
        Ok(Some(given.filter(|given| self.noise(given) < self.noise(&own)).unwrap_or(own)))
    }

    fn settled_from(&self, mut left: Left, scales: &[f64]) -> Result<Option<Left>> {
        let mut scales = scales.to_vec();
        for _ in 0..ROUNDS {
            let Some(next) = self.with(&left.adjustment, &scales, &left.adjustment)? else { return Ok(None) };
            let changed = falls(&scales, &next.scales).max(falls(&next.scales, &scales));
            scales.clone_from(&next.scales);
            left = next;
            if changed < 1.0 + SETTLED {
                break;
            }
        }
        Ok(Some(left))
    }

    fn settled_without(&self, views: &[usize]) -> Result<Option<Left>> {
        self.without(views)?.map_or(Ok(None), |left| self.settled(left))
    }

    /// The view without which, beside those that are out, least is left; and others without which no more is.
    fn next(&self, out: &[usize], views: &[usize]) -> Result<Option<(Culprit, Left)>> {
        let others: Vec<usize> = views.iter().copied().filter(|v| !out.contains(v)).collect();
        let one = |v: &usize| Ok(self.without(&[out, &[*v]].concat())?.map(|left| (*v, left)));
        let first: Result<Vec<_>> = gathered(true, &others, one);
        let mut tried: Vec<(usize, Left)> = first?.into_iter().flatten().collect();
        let in_order = |tried: &mut Vec<(usize, Left)>| {
            tried.sort_by(|a, b| self.noise(&a.1).total_cmp(&self.noise(&b.1)).then(a.0.cmp(&b.0)));
        };
        in_order(&mut tried);
        tried.truncate(TRIED);
        let again: Result<Vec<_>> = tried.into_iter().map(|(v, left)| Ok((v, self.settled(left)?))).collect();
        let mut tried: Vec<(usize, Left)> = again?.into_iter().filter_map(|(v, left)| Some((v, left?))).collect();
        in_order(&mut tried);
        let mut tried = tried.into_iter();
        let Some((view, left)) = tried.next() else { return Ok(None) };
        let as_good = |other: &Left| excess(&other.scales) < AS_GOOD * excess(&left.scales);
        let rivals = tried.filter(|(_, other)| as_good(other)).map(|(v, _)| v).collect();
        Ok(Some((Culprit { view, rivals }, left)))
    }

    /// The views for which sigmas were enlarged, in their order, with what is left without them; `None` where there are none.
    fn wrong(&self, now: &[f64]) -> Result<Option<(Vec<Culprit>, Left)>> {
        let views = seen(self.s.adjustment);
        let n = views.len();
        let most = ((MOST * n as f64) as usize).min(MOST_WRONG);
        let (mut out, mut last, mut found, mut ways) = (vec![], now.to_vec(), None, 1.0);
        while out.len() < most {
            let all: Vec<usize> = out.iter().map(|c: &Culprit| c.view).collect();
            let Some((culprit, left)) = self.next(&all, &views)? else { break };
            let others = n - out.len();
            out.push(culprit);
            ways *= others as f64 / out.len() as f64;
            let (fell, chance) = (falls(&last, &left.scales), by_chance([&last, &left.scales], others, ways));
            last.clone_from(&left.scales);
            if chance < BY_CHANCE {
                found = Some((out.clone(), left));
            }
            if fell < FALLS || is_noise(&last) {
                break;
            }
        }
        let Some((out, left)) = found else { return Ok(None) };
        let (mut out, left) = self.pardoned(out, left, ways)?;
        out.sort_by_key(|c| c.view);
        Ok(Some((out, left)))
    }

    /// Takes back those beside the last one without which no less is left.
    fn pardoned(&self, mut out: Vec<Culprit>, mut left: Left, ways: f64) -> Result<(Vec<Culprit>, Left)> {
        let n = seen(self.s.adjustment).len();
        let mut k = 0;
        while k + 1 < out.len() {
            let rest: Vec<usize> = out.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, c)| c.view).collect();
            match self.settled_without(&rest)? {
                Some(with) if by_chance([&with.scales, &left.scales], n - rest.len(), ways) > BY_CHANCE => {
                    out.remove(k);
                    left = with;
                }
                _ => k += 1,
            }
        }
        Ok((out, left))
    }
}

/// Wrong views that hide behind enlarged sigmas; `None` where sigmas are not enlarged, or not for a few views.
pub(super) fn hidden(s: &Subject<'_>, watch: &Watch<'_>) -> Result<Option<Wrong>> {
    let a = s.adjustment;
    let own = |c: usize| a.model.images.iter().filter(move |i| i.camera == c);
    let cameras = 0..a.model.cameras.len();
    let now: Vec<f64> = cameras.clone().map(|c| own(c).map(|i| i.sigma_scale).fold(1.0, f64::max)).collect();
    if is_noise(&now) || a.model.views.len() > MOST_ADJUSTED {
        return Ok(None);
    }
    let options = brief(s);
    let discs = cameras.map(|c| own(c).map(|i| i.discs.len() as f64).sum()).collect();
    let search = Search { s, options, discs, watch };
    let Some((views, left)) = search.wrong(&now)? else { return Ok(None) };
    let fell = falls(&now, &left.scales);
    let Some(Left { adjustment: strict, .. }) = search.with(a, &left.scales, &left.adjustment)? else {
        return Ok(None);
    };
    // What is theirs costs half of each number where they are right.
    let is_out = |i: &&ImageObservations| views.iter().any(|c| c.view == i.view);
    let own: usize = a.model.images.iter().filter(is_out).flat_map(|i| &i.discs).map(|d| d.count()).sum();
    let excess = 2.0 * (strict.cost - left.adjustment.cost) - own as f64;
    Ok(Some(Wrong { views, excess, without: Some(left.adjustment), hidden: Some((strict, fell)) }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    /// Of six sums of two squares of which five numbers are followed: the largest explains as much as stated no more often than is said, or as a simulation does.
    #[test]
    fn chance_is_that_of_two_numbers_over_those_that_are_left() {
        let (mut random, rounds, views, limit) = (Random(5), 20_000, 6, 0.02);
        let rest = 2.0 * 5.0 - 5.0;
        let mut below = 0;
        for _ in 0..rounds {
            let square = |random: &mut Random| random.gauss().powi(2);
            let own = square(&mut random) + square(&mut random);
            let others: f64 = (0..5).map(|_| square(&mut random)).sum();
            // Far beyond noise, as variances per degree of freedom.
            let scale = |sum: f64, degrees: f64| vec![(1.0 + 1e6 * sum / degrees).sqrt()];
            let (before, after) = (scale(own + others, rest + 2.0), scale(others, rest));
            below += usize::from(by_chance([&before, &after], views, 1.0) < limit);
        }
        let share = below as f64 / f64::from(rounds);
        assert!((0.85..1.15).contains(&(share / limit)), "{share} of {limit}");
        // Sigmas that rise explain nothing, and of three views none can be told.
        assert_eq!(by_chance([&[2.0], &[3.0]], views, 1.0), 1.0);
        assert_eq!(by_chance([&[1e3], &[1.0]], 3, 1.0), 1.0);
    }
}
