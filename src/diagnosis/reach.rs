//! How far numbers may be from their estimates: of 95 %, by their profiles where equations bend.

use super::keys::Keys;
use super::probes::Probes;
use super::{Subject, Watch};
use crate::bundle::{FURTHEST, Natural, Numbers, Reach};
use crate::error::Result;
use crate::record::{Interval, MappingByLikelihood};
use crate::stats::NORMAL_95;
use crate::threads;
use nalgebra::DVector;

/// Part of a standard deviation by which it is uncertain from which on the profile is asked: to less than that nobody states one.
const BENT: f64 = 0.05;

/// An interval for each number, none for those that are not determined; and what is added to what is felt in the sheet, which is asked for where one of the numbers bends.
pub(super) fn intervals(
    s: &Subject<'_>,
    (keys, felt): (&Keys, &dyn Fn() -> Option<Probes>),
    sigmas: &[f64],
    watch: &Watch<'_>,
) -> Result<(Vec<Option<Interval>>, Option<MappingByLikelihood>)> {
    let values: Vec<f64> = keys.list.iter().map(|k| k.value).collect();
    let of = |n: &Natural| keys.values(n);
    let reach = Reach::of(s.adjustment, Numbers { of: &of, values: &values, sigmas });
    let bends = reach.bend();
    let is_bent = |k: usize| bends.as_ref().is_some_and(|bends| bends[k] > BENT);
    let of_number = |k: &usize| {
        let (value, sigma) = (values[*k], sigmas[*k]);
        if !sigma.is_finite() {
            return None;
        }
        let straight = || [-1.0, 1.0].map(|side| Some(value + side * NORMAL_95 * sigma));
        Some(if is_bent(*k) { reach.interval(*k, &|i| watch.goes_on(i)) } else { straight() })
    };
    let all: Vec<usize> = (0..values.len()).collect();
    let out = threads::gathered(true, &all, of_number);
    watch.check()?;
    let probes = if all.iter().any(|k| is_bent(*k)) { felt() } else { None };
    let felt = probes.and_then(|probes| of_mapping(s, &probes, watch));
    watch.check()?;
    Ok((out, felt))
}

/// Of what is felt in the sheet, at the last of the points and at that of the others where it is largest; none where nothing of it bends.
fn of_mapping(s: &Subject<'_>, probes: &Probes, watch: &Watch<'_>) -> Option<MappingByLikelihood> {
    let values = vec![0.0; probes.count()];
    let sigmas: Vec<f64> = s.covariance.propagate(&probes.rows).diagonal().iter().map(|v| v.max(0.0).sqrt()).collect();
    let of = |n: &Natural| -> Option<DVector<f64>> { probes.change(n) };
    let reach = Reach::of(s.adjustment, Numbers { of: &of, values: &values, sigmas: &sigmas });
    let bends = reach.bend()?;
    let may_be = |k: &usize| sigmas[*k] * bends[*k].min(MOST_BENT).exp();
    let largest = |some: &Vec<usize>| {
        let all = some.iter().copied().filter(|k| probes.determined[*k]);
        all.max_by(|a, b| may_be(a).total_cmp(&may_be(b))).filter(|k| bends[*k] > BENT)
    };
    let asked: Vec<Option<usize>> = probes.of_kinds().iter().flatten().map(largest).collect();
    if asked.iter().all(Option::is_none) {
        return None;
    }
    let added = |k: &Option<usize>| {
        let Some(k) = *k else { return 0.0 };
        let ends = reach.interval(k, &|i| watch.goes_on(i));
        let furthest = ends.iter().map(|end| end.map_or(FURTHEST * sigmas[k], f64::abs)).fold(0.0, f64::max);
        ((furthest / NORMAL_95).powi(2) - sigmas[k] * sigmas[k]).max(0.0).sqrt()
    };
    let each: Vec<f64> = threads::gathered(true, &asked, added);
    let of_kinds: Vec<f64> = each.chunks(2).map(|two| two[0].max(two[1])).collect();
    Some(Probes::by_kind(&of_kinds))
}

/// Bend beyond which a standard deviation at the estimate tells nothing of what it is nearby.
const MOST_BENT: f64 = 5.0;
