//! Each view left out once: what is lost without it, and whether it agrees with the others.

use super::culprit::{Culprit, culprits};
use super::keys::Keys;
use super::spread::{self, Change, Spread};
use super::{FALSE_ALARMS, FELT_SIGMAS, Subject, Watch, digits, listed};
use crate::bundle::{Prediction, SolveOptions, Termination, ViewsLeftOut, named_rows, natural_of};
use crate::error::{Result, Unusable};
use crate::record::ViewInfluence;
use crate::stats::normal_beyond;
use crate::threads::gathered;
use nalgebra::{DMatrix, DVector};

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

impl Left {
    /// Change of the keys, as adjusted or else as predicted.
    fn shift(&self) -> &DVector<f64> {
        self.adjusted.as_ref().unwrap_or(&self.prediction.shift)
    }
}

/// What the views say, each left out once.
#[derive(Default)]
pub(super) struct Views {
    pub(super) influences: Vec<ViewInfluence>,
    /// Of each key, how the views scatter about it; none where that cannot be said.
    pub(super) spreads: Vec<Option<Spread>>,
}

pub(super) fn views(
    s: &Subject<'_>,
    names: &[&str],
    keys: &Keys,
    watch: &Watch<'_>,
    flags: &mut Vec<String>,
) -> Result<Views> {
    let model = &s.adjustment.model;
    if model.views.len() < 2 || keys.list.is_empty() {
        return Ok(Views::default());
    }
    let Some(rows) = named_rows(s.adjustment, &keys.rows) else { return Ok(Views::default()) };
    let full = s.covariance.propagate(&keys.rows);
    let seen: Vec<usize> = (0..model.views.len()).filter(|v| model.images.iter().any(|i| i.view == *v)).collect();
    let without = ViewsLeftOut::of(s.adjustment);
    let left: Result<Vec<Option<Left>>> = gathered(true, &seen, |v| left_out(s, (keys, &rows), (&without, *v), watch));
    let tests = (seen.len() * keys.list.len()) as f64;
    let left = left?;
    let each = seen.iter().zip(&left);
    let mut out: Vec<ViewInfluence> =
        each.filter_map(|(v, left)| Some(influence(keys, &full, *v, left.as_ref()?, tests))).collect();
    let wrong = if out.iter().any(|v| v.contradicts) { culprits(s, names, watch)? } else { None };
    let single = wrong.is_some();
    name_the_wrong(&mut out, wrong);
    let spreads: Vec<Option<Spread>> = (0..keys.list.len()).map(|k| spread(keys, &full, k, &left)).collect();
    let sigmas: Vec<f64> = full.diagonal().iter().map(|x| x.max(0.0).sqrt()).collect();
    let finding = spread::finding(keys, &sigmas, &spreads).filter(|_| !single);
    match finding {
        // Where all differ none is wrong by itself.
        Some(words) => flags.push(words + &most_different(&out)),
        None => flags.extend(out.iter().filter(|v| v.contradicts && change(v) > FELT_SIGMAS).map(|v| v.words.clone())),
    }
    Ok(Views { influences: out, spreads })
}

/// How the views scatter about a key; none where one of them alone fixes it.
fn spread(keys: &Keys, full: &DMatrix<f64>, k: usize, left: &[Option<Left>]) -> Option<Spread> {
    let told = || left.iter().flatten();
    if !(keys.determined[k] && told().all(|left| left.prediction.determined[k])) {
        return None;
    }
    let changes: Vec<Change> = told().filter_map(|left| own_change(full, k, left)).collect();
    Spread::of(&changes, full[(k, k)])
}

/// Change of a key without a view, where more of its variance than rounding goes with the view.
fn own_change(full: &DMatrix<f64>, k: usize, left: &Left) -> Option<Change> {
    let variance = left.prediction.covariance[(k, k)] - full[(k, k)];
    (variance > TESTABLE * full[(k, k)]).then(|| Change { size: left.shift()[k], variance })
}

/// Where few views explain all contradictions, only they contradict. Otherwise all do that seem to.
fn name_the_wrong(views: &mut [ViewInfluence], wrong: Option<Vec<Culprit>>) {
    let Some(wrong) = wrong else { return };
    let list = |w: &[usize]| listed(&w.iter().map(usize::to_string).collect::<Vec<_>>());
    let all = list(&wrong.iter().map(|c| c.view).collect::<Vec<_>>());
    let [without, there] = match wrong[..] {
        [_] => [format!("view {all} is left out"), "that view".into()],
        _ => [format!("views {all} are left out"), "one of those".into()],
    };
    for v in views {
        let rival_of = wrong.iter().find(|c| c.rivals.contains(&v.view));
        if let Some(c) = wrong.iter().find(|c| c.view == v.view) {
            v.contradicts = true;
            v.words = contradiction(v);
            if !c.rivals.is_empty() {
                v.words += &format!(" (or view {} is wrong instead: the others agree without either)", list(&c.rivals));
            }
        } else if let Some(c) = rival_of {
            v.contradicts = true;
            v.words =
                format!("{} (or view {} is wrong instead: the others agree without either)", contradiction(v), c.view);
        } else if v.contradicts {
            v.contradicts = false;
            v.words = format!(
                "view {} agrees with the others once {without}; while {there} takes part, it seems to contradict them",
                v.view
            );
        }
    }
}

/// The view without which something changes most significantly.
fn most_different(views: &[ViewInfluence]) -> String {
    let most = views.iter().filter(|v| v.z.is_finite()).max_by(|a, b| a.z.abs().total_cmp(&b.z.abs()));
    most.map_or(String::new(), |v| format!("; begin with the images of view {}, which differs most", v.view))
}

/// Largest change without the view, as adjusted or else as predicted, in standard deviations.
fn change(v: &ViewInfluence) -> f64 {
    if v.shift_sigmas.is_finite() { v.shift_sigmas } else { v.predicted_shift_sigmas.abs() }
}

fn contradiction(v: &ViewInfluence) -> String {
    let z = digits(v.z.abs(), 2);
    let most_significant = match v.z_of.as_str() {
        "" => String::new(),
        same if same == v.shift_of => format!(" ({z} of those of the change)"),
        other => format!(", the {other} by {z} of those of its change"),
    };
    format!(
        "view {} contradicts the others: without it the {} changes by {} of its standard deviations{most_significant}; \
         look at its images, and leave it out if the target moved, was bent, or is not the same",
        v.view,
        v.shift_of,
        digits(change(v), 2)
    )
}

fn left_out(
    s: &Subject<'_>,
    (keys, rows): (&Keys, &DMatrix<f64>),
    (without, view): (&ViewsLeftOut<'_>, usize),
    watch: &Watch<'_>,
) -> Result<Option<Left>> {
    watch.check()?;
    let Some(prediction) = without.predicted(view, rows) else { return Ok(None) };
    // Where something is lost there is no minimum to go to.
    let lost = prediction.determined.iter().zip(&keys.determined).any(|(now, before)| *before && !*now);
    if lost || s.adjustment.model.views.len() > MOST_ADJUSTED {
        return Ok(Some(Left { adjusted: None, prediction }));
    }
    let options = SolveOptions { decrement: 1e-3, iterations: 40 };
    let Some(other) = without.readjusted(view, &options, &mut |i| watch.goes_on(i)) else {
        return Ok(Some(Left { adjusted: None, prediction }));
    };
    if other.termination == Termination::Cancelled {
        return Err(Unusable::Cancelled.into());
    }
    let adjusted = || {
        let natural = natural_of(&s.adjustment.model, &other.state).filter(|_| other.decrement < 0.1)?;
        Some(keys.values(&natural)? - keys.values(&s.covariance.natural)?)
    };
    Ok(Some(Left { adjusted: adjusted(), prediction }))
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
    let shift = left.shift();
    let moved = largest(usable.iter().map(|&k| (k, shift[k] / sigma(k))));
    let predicted = moved.map_or(f64::NAN, |(k, _)| (p.shift[k] / sigma(k)).abs());
    let z = largest(usable.iter().filter_map(|&k| own_change(full, k, left).map(|c| (k, c.size / c.variance.sqrt()))));
    let contradicts = lost.is_empty() && z.is_some_and(|(_, z)| normal_beyond(z) * tests < FALSE_ALARMS);
    let metric = |name: &String| keys.list.iter().any(|k| k.name == *name && k.unit == "mm");
    let words = if !lost.is_empty()
        && lost.iter().all(metric)
        && keys.list.iter().filter(|k| k.unit == "mm").count() == lost.len()
    {
        format!("view {view} cannot be spared: it alone sets the scale")
    } else if !lost.is_empty() {
        format!("view {view} cannot be spared: without it no image determines the {}", listed(&lost))
    } else if usable.is_empty() {
        format!("what view {view} adds cannot be said: no quantity that matters is determined with all views")
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
    let mut out = ViewInfluence {
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
    };
    if contradicts {
        out.words = contradiction(&out);
    }
    out
}
