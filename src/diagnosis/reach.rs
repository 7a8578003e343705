//! How far numbers may be from their estimates: of 95 %, by their profiles where equations bend.

use super::Watch;
use super::keys::Keys;
use crate::bundle::{Adjustment, Natural, Numbers, Reach};
use crate::error::Result;
use crate::record::Interval;
use crate::stats::NORMAL_95;
use crate::threads;

/// Part of a standard deviation by which it is uncertain from which on the profile is asked: to less than that nobody states one.
const BENT: f64 = 0.05;

/// An interval for each number, none for those that are not determined.
pub(super) fn intervals(
    adjustment: &Adjustment,
    keys: &Keys,
    sigmas: &[f64],
    watch: &Watch<'_>,
) -> Result<Vec<Option<Interval>>> {
    let values: Vec<f64> = keys.list.iter().map(|k| k.value).collect();
    let of = |n: &Natural| keys.values(n);
    let reach = Reach::of(adjustment, Numbers { of: &of, values: &values, sigmas });
    let bends = reach.bend();
    let of_number = |k: &usize| {
        let (value, sigma) = (values[*k], sigmas[*k]);
        if !sigma.is_finite() {
            return None;
        }
        let bent = bends.as_ref().is_some_and(|bends| bends[*k] > BENT);
        let straight = || [-1.0, 1.0].map(|side| Some(value + side * NORMAL_95 * sigma));
        Some(if bent { reach.interval(*k, &|i| watch.goes_on(i)) } else { straight() })
    };
    let all: Vec<usize> = (0..values.len()).collect();
    let out = threads::gathered(true, &all, of_number);
    watch.check()?;
    Ok(out)
}
