//! Each view left out once: what is lost without it, and whether it agrees with the others.
//!
//! The change of a number without view v is found twice: by one Newton step of the equations about the estimate, and by an adjustment. Where equations
//! are linear they agree. Where they bend (an axis point is known by its prior alone as long as distortion seems to be nothing, and by the images once there
//! is some) either may be many standard deviations of linear equations and say nothing of the view: whether it contradicts is judged by what both say.

use super::culprit::{Wrong, culprits};
use super::enlarged::hidden;
use super::keys::Keys;
use super::probes::Probes;
use super::spread::{self, Change, Number, Spread};
use super::{FALSE_ALARMS, FELT_SIGMAS, MOST_ADJUSTED, Subject, Watch, brief, digits};
use crate::bundle::{Natural, Prediction, Termination, ViewsLeftOut, listed, named_rows, natural_of};
use crate::error::{Result, Unusable};
use crate::record::{MappingByViews, ViewInfluence};
use crate::stats::normal_beyond;
use crate::threads::gathered;
use nalgebra::{DMatrix, DVector};

/// A view without which no sigma grows by more than this part adds little.
const LITTLE: f64 = 0.02;
/// Difference of covariances, part of the covariance, below which rounding would be tested.
const TESTABLE: f64 = 1e-4;

/// Said where views differ and do not tell of u, v and w.
const UNTOLD: &str = "how much of what differs from view to view is in u, v and w is not known, since one view alone fixes the sheet, or too few do: \
                      record the target in the sheet three times or more, shifted and turned in it";

/// What is looked at without single views: the keys, then what is felt in the sheet.
struct Functions<'a> {
    keys: &'a Keys,
    probes: Option<&'a Probes>,
    /// By the global unknowns.
    rows: DMatrix<f64>,
    /// Variance with all views, and whether nothing undetermined moves it.
    variance: Vec<f64>,
    determined: Vec<bool>,
}

impl<'a> Functions<'a> {
    fn of(s: &Subject<'_>, keys: &'a Keys, probes: Option<&'a Probes>) -> Option<Self> {
        let mut by_name = keys.rows.clone();
        let mut determined = keys.determined.clone();
        if let Some(probes) = probes {
            by_name.extend(probes.rows.iter().cloned());
            determined.extend(&probes.determined);
        }
        let rows = named_rows(s.adjustment, &by_name)?;
        let variance = s.covariance.propagate(&by_name).diagonal().iter().map(|x| x.max(0.0)).collect();
        Some(Self { keys, probes, rows, variance, determined })
    }

    /// From the estimate to another one of the same rig.
    fn change(&self, from: &Natural, to: &Natural) -> Option<DVector<f64>> {
        let of_keys = self.keys.values(to)? - self.keys.values(from)?;
        let of_probes = match self.probes {
            Some(probes) => probes.change(to)?,
            None => DVector::zeros(0),
        };
        Some(DVector::from_iterator(self.rows.nrows(), of_keys.iter().chain(of_probes.iter()).copied()))
    }
}

/// What one view does, before words.
struct Left {
    prediction: Prediction,
    /// Change of the functions by an adjustment without the view; none where it did not converge.
    adjusted: Option<DVector<f64>>,
}

impl Left {
    /// Change of the functions, as adjusted or else as predicted.
    fn shift(&self) -> &DVector<f64> {
        self.adjusted.as_ref().unwrap_or(&self.prediction.shift)
    }

    /// The part of the change of a function that is adjusted as it is predicted: the smaller of both, nothing where they go opposite ways.
    fn foretold(&self, k: usize) -> f64 {
        let [adjusted, predicted] = [self.shift()[k], self.prediction.shift[k]];
        if adjusted * predicted > 0.0 { adjusted.signum() * adjusted.abs().min(predicted.abs()) } else { 0.0 }
    }
}

/// What the views say, each left out once.
#[derive(Default)]
pub(super) struct Views {
    pub(super) influences: Vec<ViewInfluence>,
    /// Of each key, how the views scatter about it; none where that cannot be said.
    pub(super) spreads: Vec<Option<Spread>>,
    /// How many times larger the views tell what is felt in the sheet.
    pub(super) felt: Option<MappingByViews>,
    /// Those that are wrong, where few are.
    pub(super) wrong: Option<Wrong>,
    /// What else a user must look at.
    pub(super) flags: Vec<String>,
}

impl Views {
    /// None contradicts the others once something else is mended.
    pub(super) fn agree_once(&mut self, mended: &str) {
        for v in self.influences.iter_mut().filter(|v| v.contradicts) {
            v.contradicts = false;
            v.words = format!(
                "view {} agrees with the others once {mended}; until then, it seems to contradict them",
                v.view
            );
        }
        self.flags.clear();
    }

    /// What a user must be told of wrong views: those that are felt, all where they are `blamed` for something else.
    pub(super) fn contradictions(&self, blamed: bool) -> Vec<String> {
        let all = blamed || self.wrong.as_ref().is_some_and(|w| w.hidden.is_some());
        let told = self.influences.iter().filter(|v| v.contradicts && (all || change(v) > FELT_SIGMAS));
        told.map(|v| v.words.clone()).collect()
    }
}

pub(super) fn views(
    s: &Subject<'_>,
    names: &[&str],
    (keys, probes): (&Keys, Option<&Probes>),
    watch: &Watch<'_>,
) -> Result<Views> {
    let model = &s.adjustment.model;
    if model.views.len() < 2 || keys.list.is_empty() {
        return Ok(Views::default());
    }
    let Some(functions) = Functions::of(s, keys, probes) else { return Ok(Views::default()) };
    let seen: Vec<usize> = (0..model.views.len()).filter(|v| model.images.iter().any(|i| i.view == *v)).collect();
    let without = ViewsLeftOut::of(s.adjustment);
    let left: Result<Vec<Option<Left>>> = gathered(true, &seen, |v| left_out(s, &functions, (&without, *v), watch));
    let tests = (seen.len() * keys.list.len()) as f64;
    let left = left?;
    let each = seen.iter().zip(&left);
    let mut out: Vec<ViewInfluence> =
        each.filter_map(|(v, left)| Some(influence(&functions, *v, left.as_ref()?, tests))).collect();
    let mut wrong = hidden(s, watch)?;
    if wrong.is_none() && out.iter().any(|v| v.contradicts) {
        wrong = culprits(s, names, watch)?;
    }
    name_the_wrong(&mut out, wrong.as_ref());
    let Scatter { of_probes, spreads, finding } = Scatter::of(&functions, &left);
    let felt = probes.and_then(|p| p.by_views(&of_probes, finding.is_some()));
    let mut views = Views { influences: out, spreads, felt, wrong, flags: vec![] };
    match finding.filter(|_| views.wrong.is_none()) {
        // Where all differ none is wrong by itself.
        Some(words) => {
            views.flags.push(words + &most_different(&views.influences));
            views.flags.extend(views.felt.as_ref().filter(|f| f.untold()).map(|_| UNTOLD.into()));
        }
        None if views.wrong.is_none() => views.flags = views.contradictions(false),
        None => {}
    }
    Ok(views)
}

/// How all views scatter.
struct Scatter {
    of_probes: Vec<Option<Number>>,
    /// Of each key.
    spreads: Vec<Option<Spread>>,
    finding: Option<String>,
}

impl Scatter {
    /// By the changes as adjusted; where they contradict nothing, by the part of them that is foretold.
    fn of(functions: &Functions<'_>, left: &[Option<Left>]) -> Self {
        let keys = functions.keys;
        let mut of_keys: Vec<Option<Number>> =
            (0..functions.variance.len()).map(|k| number(functions, k, left)).collect();
        let mut of_probes = of_keys.split_off(keys.list.len());
        let spreads = |of: &[Option<Number>]| of.iter().map(|n| Spread::of(n.as_ref()?)).collect();
        let adjusted: Vec<Option<Spread>> = spreads(&of_keys);
        let sigmas: Vec<f64> = functions.variance[..keys.list.len()].iter().map(|x| x.sqrt()).collect();
        let finding = spread::finding(keys, &sigmas, &adjusted);
        if finding.is_some() {
            return Self { of_probes, spreads: adjusted, finding };
        }
        of_keys.iter_mut().chain(&mut of_probes).flatten().for_each(Number::as_foretold);
        Self { of_probes, spreads: spreads(&of_keys), finding }
    }
}

/// A function with all views and without each; none where it is not determined.
fn number(functions: &Functions<'_>, k: usize, left: &[Option<Left>]) -> Option<Number> {
    let told = || left.iter().flatten();
    if !(functions.determined[k] && told().all(|left| left.prediction.determined[k])) {
        return None;
    }
    let variance = functions.variance[k];
    let changes = told().map(|left| own_change(variance, k, left).unwrap_or_default()).collect();
    (variance > 0.0).then_some(Number { variance, changes })
}

/// Change of a function without a view, where more of its variance than rounding goes with the view.
fn own_change(variance: f64, k: usize, left: &Left) -> Option<Change> {
    let more = left.prediction.covariance[(k, k)] - variance;
    (more > TESTABLE * variance).then(|| Change { size: left.shift()[k], foretold: left.foretold(k), variance: more })
}

/// Where few views explain all contradictions, only they contradict. Otherwise all do that seem to.
fn name_the_wrong(views: &mut [ViewInfluence], found: Option<&Wrong>) {
    let wrong = found.map_or(&[][..], |w| &w.views);
    let contradiction = |v: &ViewInfluence| match found.and_then(|w| w.hidden.as_ref()) {
        Some((_, fell)) => hidden_contradiction(v, wrong.len(), *fell),
        None => contradiction(v),
    };
    let list = |w: &[usize]| listed(&w.iter().map(usize::to_string).collect::<Vec<_>>());
    let all = list(&wrong.iter().map(|c| c.view).collect::<Vec<_>>());
    let [without, there] = match wrong {
        [] => return,
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

/// Of a view for which, beside others, standard deviations were enlarged.
fn hidden_contradiction(v: &ViewInfluence, wrong: usize, fell: f64) -> String {
    let without = if wrong == 1 { "it" } else { "those that do" };
    format!(
        "view {} contradicts the others: without {without} the discs of the rest lie up to {} times nearer to where they should, and standard deviations, \
         which are enlarged for it, are as much smaller; {LOOK}",
        v.view,
        digits(fell, 2)
    )
}

/// What to do about a view that contradicts.
const LOOK: &str = "look at its images, and leave it out if the target moved, was bent, or is not the same (record it again where no other one is in the sheet)";

fn contradiction(v: &ViewInfluence) -> String {
    let z = digits(v.z.abs(), 2);
    let most_significant = match v.z_of.as_str() {
        "" => String::new(),
        same if same == v.shift_of => format!(" ({z} of those of the change)"),
        other => format!(", the {other} by {z} of those of its change"),
    };
    format!(
        "view {} contradicts the others: without it the {} changes by {} of its standard deviations{most_significant}; {LOOK}",
        v.view,
        v.shift_of,
        digits(change(v), 2)
    )
}

fn left_out(
    s: &Subject<'_>,
    functions: &Functions<'_>,
    (without, view): (&ViewsLeftOut<'_>, usize),
    watch: &Watch<'_>,
) -> Result<Option<Left>> {
    watch.check()?;
    let Some(prediction) = without.predicted(&[view], &functions.rows) else { return Ok(None) };
    // Where something is lost there is no minimum to go to.
    let lost = prediction.determined.iter().zip(&functions.keys.determined).any(|(now, before)| *before && !*now);
    if lost || s.adjustment.model.views.len() > MOST_ADJUSTED {
        return Ok(Some(Left { adjusted: None, prediction }));
    }
    let Some(other) = without.readjusted(view, &brief(s).solve, &mut |i| watch.goes_on(i)) else {
        return Ok(Some(Left { adjusted: None, prediction }));
    };
    if other.termination == Termination::Cancelled {
        return Err(Unusable::Cancelled.into());
    }
    let adjusted = || {
        let natural = natural_of(&s.adjustment.model, &other.state).filter(|_| other.decrement < 0.1)?;
        functions.change(&s.covariance.natural, &natural)
    };
    Ok(Some(Left { adjusted: adjusted(), prediction }))
}

/// The largest of numbers that exist, with its place.
fn largest(numbers: impl Iterator<Item = (usize, f64)>) -> Option<(usize, f64)> {
    numbers.filter(|(_, x)| x.is_finite()).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}

fn influence(functions: &Functions<'_>, view: usize, left: &Left, tests: f64) -> ViewInfluence {
    let (keys, variance, p) = (functions.keys, &functions.variance, &left.prediction);
    let usable: Vec<usize> =
        (0..keys.list.len()).filter(|&k| keys.determined[k] && p.determined[k] && variance[k] > 0.0).collect();
    let sigma = |k: usize| variance[k].sqrt();
    let name = |found: Option<(usize, f64)>| found.map_or(String::new(), |(k, _)| keys.list[k].name.clone());
    let size = |found: Option<(usize, f64)>| found.map_or(f64::NAN, |(_, x)| x);
    let lost: Vec<String> = (0..keys.list.len())
        .filter(|&k| keys.determined[k] && !p.determined[k])
        .map(|k| keys.list[k].name.clone())
        .collect();
    let growth = largest(usable.iter().map(|&k| (k, (p.covariance[(k, k)] / variance[k]).sqrt())));
    let shift = left.shift();
    let moved = largest(usable.iter().map(|&k| (k, shift[k] / sigma(k))));
    let predicted = moved.map_or(f64::NAN, |(k, _)| (p.shift[k] / sigma(k)).abs());
    let z = largest(
        usable.iter().filter_map(|&k| own_change(variance[k], k, left).map(|c| (k, c.foretold / c.variance.sqrt()))),
    );
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
