//! Each view left out once: what is lost without it, and whether it agrees with the others.

use super::keys::Keys;
use super::{FALSE_ALARMS, FELT_SIGMAS, Subject, digits, listed};
use crate::bundle::{
    AdjustOptions, Prediction, SolveOptions, named_rows, natural_of, predicted_without_view, readjusted_without_view,
};
use crate::record::ViewInfluence;
use crate::stats::normal_beyond;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Views beyond which only the prediction is made.
const MOST_ADJUSTED: usize = 40;
/// A view without which no sigma grows by more than this part adds little.
const LITTLE: f64 = 0.02;
/// Difference of covariances, part of the covariance, below which rounding would be tested.
const TESTABLE: f64 = 1e-4;

/// What one view does, before words.
struct Left {
    prediction: Prediction,
    /// Change of the keys by an adjustment without the view; none where it did not converge.
    adjusted: Option<DVector<f64>>,
}

pub(super) fn views(s: &Subject<'_>, keys: &Keys, flags: &mut Vec<String>) -> Vec<ViewInfluence> {
    let model = &s.adjustment.model;
    if model.views.len() < 2 || keys.list.is_empty() {
        return vec![];
    }
    let Some(rows) = named_rows(s.adjustment, &keys.rows) else { return vec![] };
    let full = s.covariance.propagate(&keys.rows);
    let seen: Vec<usize> = (0..model.views.len()).filter(|v| model.images.iter().any(|i| i.view == *v)).collect();
    let left: Vec<Option<Left>> = seen.par_iter().map(|v| left_out(s, keys, &rows, *v)).collect();
    let tests = (seen.len() * keys.list.len()) as f64;
    let mut out = vec![];
    for (view, left) in seen.into_iter().zip(left) {
        let Some(left) = left else { continue };
        let one = influence(keys, &full, view, &left, tests);
        if one.contradicts && one.shift_sigmas > FELT_SIGMAS {
            flags.push(one.words.clone());
        }
        out.push(one);
    }
    out
}

fn left_out(s: &Subject<'_>, keys: &Keys, rows: &DMatrix<f64>, view: usize) -> Option<Left> {
    let prediction = predicted_without_view(s.adjustment, view, rows)?;
    let adjusted = || {
        // Where something is lost there is no minimum to go to.
        let lost = prediction.determined.iter().zip(&keys.determined).any(|(now, before)| *before && !*now);
        if lost || s.adjustment.model.views.len() > MOST_ADJUSTED {
            return None;
        }
        let options =
            AdjustOptions { solve: SolveOptions { decrement: 1e-3, iterations: 40 }, rounds: 0, ..*s.options };
        let other = readjusted_without_view(s.adjustment, view, &options);
        let natural = natural_of(&other.model, &other.state).filter(|_| other.decrement < 0.1)?;
        let before = keys.values(&s.covariance.natural)?;
        Some(keys.values(&natural)? - before)
    };
    Some(Left { adjusted: adjusted(), prediction })
}

/// The largest of numbers that exist, with its place.
fn largest(numbers: impl Iterator<Item = (usize, f64)>) -> Option<(usize, f64)> {
    numbers.filter(|(_, x)| x.is_finite()).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}

fn influence(keys: &Keys, full: &DMatrix<f64>, view: usize, left: &Left, tests: f64) -> ViewInfluence {
    let p = &left.prediction;
    let usable: Vec<usize> =
        (0..keys.list.len()).filter(|&k| keys.determined[k] && p.determined[k] && full[(k, k)] > 0.0).collect();
    let sigma = |k: usize| full[(k, k)].sqrt();
    let name = |found: Option<(usize, f64)>| found.map_or(String::new(), |(k, _)| keys.list[k].name.clone());
    let size = |found: Option<(usize, f64)>| found.map_or(f64::NAN, |(_, x)| x);
    let lost: Vec<String> = (0..keys.list.len())
        .filter(|&k| keys.determined[k] && !p.determined[k])
        .map(|k| keys.list[k].name.clone())
        .collect();
    let growth = largest(usable.iter().map(|&k| (k, (p.covariance[(k, k)] / full[(k, k)]).sqrt())));
    let shift = left.adjusted.as_ref().unwrap_or(&p.shift);
    let moved = largest(usable.iter().map(|&k| (k, shift[k] / sigma(k))));
    let predicted = moved.map_or(f64::NAN, |(k, _)| (p.shift[k] / sigma(k)).abs());
    let z = largest(usable.iter().map(|&k| {
        let more = p.covariance[(k, k)] - full[(k, k)];
        (k, if more > TESTABLE * full[(k, k)] { shift[k] / more.sqrt() } else { f64::NAN })
    }));
    let contradicts = lost.is_empty() && z.is_some_and(|(_, z)| normal_beyond(z) * tests < FALSE_ALARMS);
    let metric = |name: &String| keys.list.iter().any(|k| k.name == *name && k.unit == "mm");
    let words = if !lost.is_empty()
        && lost.iter().all(metric)
        && keys.list.iter().filter(|k| k.unit == "mm").count() == lost.len()
    {
        format!("view {view} cannot be spared: it alone sets the scale")
    } else if !lost.is_empty() {
        format!("view {view} cannot be spared: without it nothing determines the {}", listed(&lost))
    } else if contradicts {
        format!(
            "view {view} contradicts the others: without it the {} changes by {} of its standard deviations ({} of those of the change); \
             look at its images, and leave it out if the target moved, was bent, or is not the same",
            name(moved),
            digits(size(moved).abs(), 2),
            digits(size(z).abs(), 2)
        )
    } else if size(growth) < 1.0 + LITTLE {
        format!(
            "view {view} adds little: without it no standard deviation grows by more than {} %",
            digits(100.0 * (size(growth) - 1.0).max(0.0), 2)
        )
    } else {
        format!(
            "view {view} agrees with the others; without it the standard deviation of the {} would be {} times as large",
            name(growth),
            digits(size(growth), 3)
        )
    };
    ViewInfluence {
        view,
        sigma_growth: if lost.is_empty() { size(growth) } else { f64::NAN },
        sigma_growth_of: name(growth),
        lost,
        predicted_shift_sigmas: predicted,
        shift_sigmas: if left.adjusted.is_some() { size(moved).abs() } else { f64::NAN },
        shift_of: name(moved),
        z: size(z),
        z_of: name(z),
        contradicts,
        words,
    }
}
