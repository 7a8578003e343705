//! What a calibration knows, what it does not, and whether its model holds: numbers and words for the record.
//!
//! | part | asks | by |
//! |---|---|---|
//! | priors | does what was known beforehand agree with the images? how much of a number is its prior? | [`crate::bundle::prior_checks`] |
//! | weak directions | which numbers move together? | principal directions of the covariance, in parts of 0.5 % and 5 mrad |
//! | model tests | is a lens term lacking, a value that is held wrong? is the plate bent, are its dots displaced? | [`crate::bundle::extension_tests`] |
//! | views | what does each view contribute, does it agree with the others, and which one does not? | [`crate::bundle::ViewsLeftOut`], and an adjustment without it |
//! | spread | do the views scatter as their noise says? what standard deviations do they tell? | the same changes, all together |
//! | reach | how far may a number be where equations bend? | [`crate::bundle::Reach`] |
//! | probes | and of what is felt in the sheet? | functions at a few points of it, without each view |
//! | mapping | what do errors of the calibration do to u, v, w and to dewarped images? | [`crate::sheet::SheetUncertainty`] |
//!
//! Every yes-or-no finding allows 1 % false alarms over all tests of its kind together (Bonferroni). A finding becomes a flag only where
//! it touches a number that a user relies on.

mod culprit;
mod enlarged;
mod explained;
mod field;
mod keys;
mod mapping;
mod model_tests;
mod moved;
mod outliers;
mod priors;
mod probes;
mod reach;
mod spread;
mod views;
mod weak;

pub use crate::bundle::Observe;
pub use mapping::mapping_of_record;

use crate::bundle::{AdjustOptions, Adjustment, Iteration, NamedCovariance, SolveOptions, Termination};
use crate::error::{Result, Unusable};
use crate::frames::{Rig, Sheet};
use crate::record::{Diagnosis, Interval, KeyQuantity, MappingUncertainty, NearNull};
use crate::rigid::Motion;
use crate::target::DotId;
use crate::threads;
use field::SeenSheet;
use keys::Keys;
use probes::Probes;
use spread::Spread;
use std::sync::atomic::{AtomicBool, Ordering};

/// False alarms allowed over all tests of a kind.
const FALSE_ALARMS: f64 = 0.01;
/// A key quantity that would move by more than this many of its standard deviations makes a finding a flag.
const FELT_SIGMAS: f64 = 3.0;
/// Views beyond which nothing is adjusted without single ones.
const MOST_ADJUSTED: usize = 40;

/// What is diagnosed.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// The adjustment at its minimum.
    pub adjustment: &'a Adjustment,
    /// Its covariance.
    pub covariance: &'a NamedCovariance,
    /// Indices of the facts that the program assumed and the user did not state.
    pub assumed: &'a [usize],
    /// Whether how far dots lie off their places was stated, where each is estimated.
    pub point_sigma_stated: bool,
    /// Label of each disc of the target.
    pub labels: &'a [DotId],
    /// Width and height of each camera's images, px.
    pub sizes_px: &'a [[f64; 2]],
    /// Where the frame of the sheet stands, unless it is the one that goes with the plane.
    pub sheet_frame: Option<Motion<Rig, Sheet>>,
    /// How views are adjusted away.
    pub options: &'a AdjustOptions,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Findings {
    /// For `fit.diagnosis`.
    pub diagnosis: Diagnosis,
    /// For `fit.near_null`.
    pub near_null: Vec<NearNull>,
    /// For `mapping_uncertainty`; none without a second camera or a sheet.
    pub mapping: Option<MappingUncertainty>,
    /// What a user must look at before relying on the result.
    pub flags: Vec<String>,
    /// Whether a flag says for which views standard deviations were enlarged.
    pub enlarged_for_views: bool,
}

/// A row of the record, and whether a user must look at it.
struct Asked<T> {
    row: T,
    /// Its words without what to do.
    found: String,
    flagged: bool,
}

/// Words of those that a user must look at.
fn flags<T: explained::Finding>(asked: &[Asked<T>]) -> Vec<String> {
    asked.iter().filter(|one| one.flagged).map(|one| one.row.words().into()).collect()
}

/// Asks whether to go on, and remembers a no.
struct Watch<'a> {
    observe: Observe<'a>,
    at_minimum: Iteration,
    stopped: AtomicBool,
}

impl Watch<'_> {
    fn goes_on(&self, iteration: &Iteration) -> bool {
        if self.stopped.load(Ordering::Relaxed) {
            return false;
        }
        let on = (self.observe)(iteration);
        if !on {
            self.stopped.store(true, Ordering::Relaxed);
        }
        on
    }

    /// Between two pieces of work.
    fn check(&self) -> Result<()> {
        if self.goes_on(&self.at_minimum) { Ok(()) } else { Err(Unusable::Cancelled.into()) }
    }
}

/// Diagnoses an adjustment that has reached its minimum. `observe` sees the iterations of the adjustments without single views, and
/// is asked between the parts.
///
/// # Errors
/// [`Unusable::Cancelled`] where `observe` stopped it.
pub fn diagnose(s: &Subject<'_>, observe: Observe<'_>) -> Result<Findings> {
    let a = s.adjustment;
    let at_minimum = Iteration { number: a.iterations, cost: a.cost, decrement: a.decrement };
    let watch = Watch { observe, at_minimum, stopped: AtomicBool::new(false) };
    let names: Vec<&str> = a.model.cameras.iter().map(|c| c.name.as_str()).collect();
    watch.check()?;
    let keys = Keys::of(s.covariance, &names);
    let sigmas = s.covariance.sigmas(&keys.rows);
    let mut out = Findings { near_null: weak::near_null(s.covariance, &names, &keys), ..Findings::default() };
    let mut priors = priors::priors(s);
    watch.check()?;
    let sheet = SeenSheet::of(s.covariance, s.sizes_px, &names, s.sheet_frame.as_ref());
    let probes = sheet.as_ref().and_then(|sheet| Probes::of(s.covariance, sheet));
    let views = || views::views(s, &names, (&keys, probes.as_ref()), &watch);
    let others = || -> Result<_> {
        let tests = model_tests::model_tests(s, (&keys, probes.as_ref()), &watch);
        watch.check()?;
        let felt = || Probes::with_the_middle(s.covariance, sheet.as_ref()?);
        let reached = reach::intervals(s, (&keys, &felt), &sigmas, &watch)?;
        let mut of_mapping = vec![];
        let mapping =
            sheet.as_ref().and_then(|sheet| mapping::mapping_uncertainty(s.covariance, sheet, &mut of_mapping));
        Ok((tests, mapping, of_mapping, reached))
    };
    // Each part has flags of its own, so that they stand in one order whoever is done first.
    let (views, others) = threads::both(views, others);
    let (mut views, (mut tests, mapping, of_mapping, (intervals, by_likelihood))) = (views?, others?);
    let of_wrong = explained::explained(s, &names, (&mut priors, &mut tests, &mut views), &watch)?;
    model_tests::priors_go_after(s, &tests, &mut priors.asked);
    out.diagnosis.key_quantities = quantities(&keys, &sigmas, &views.spreads, &intervals);
    out.mapping = mapping.map(|m| MappingUncertainty { by_views: views.felt, by_likelihood, ..m });
    let [first, of_tests] = tests.flags();
    out.diagnosis.outliers = outliers::outliers(s, !(first.is_empty() && of_tests.is_empty()));
    out.enlarged_for_views = !of_wrong.is_empty() && views.wrong.as_ref().is_some_and(|w| w.hidden.is_some());
    out.flags = [first, of_wrong, flags(&priors.asked), of_tests, views.flags, of_mapping].concat();
    out.diagnosis.priors = priors.asked.into_iter().map(|p| p.row).collect();
    out.diagnosis.model_tests = tests.asked.into_iter().map(|t| t.row).collect();
    out.diagnosis.views = views.influences;
    Ok(out)
}

/// How all is adjusted once more for a question, to a thousandth of a sigma.
fn brief(s: &Subject<'_>) -> AdjustOptions {
    AdjustOptions { solve: SolveOptions { decrement: 1e-3, iterations: 40 }, rounds: 0, ..*s.options }
}

/// An adjustment that got there; an error where it was stopped.
fn near_its_minimum(a: Adjustment) -> Result<Option<Adjustment>> {
    if a.termination == Termination::Cancelled {
        return Err(Unusable::Cancelled.into());
    }
    Ok((a.decrement < 0.1).then_some(a))
}

fn quantities(
    keys: &Keys,
    sigmas: &[f64],
    spreads: &[Option<Spread>],
    intervals: &[Option<Interval>],
) -> Vec<KeyQuantity> {
    let quantity = |(k, key): (usize, &keys::Key)| KeyQuantity {
        name: key.name.clone(),
        unit: key.unit.into(),
        value: key.value,
        sigma: sigmas[k],
        interval_95: intervals.get(k).copied().flatten(),
        sigma_by_views: spreads.get(k).copied().flatten().map_or(f64::NAN, |s| s.factor * sigmas[k]),
    };
    keys.list.iter().enumerate().map(quantity).collect()
}

/// A number with a sensible count of digits, for sentences.
fn digits(x: f64, n: usize) -> String {
    if x == 0.0 || !x.is_finite() {
        return if x == 0.0 { "0".into() } else { "unknown".into() };
    }
    let decimals = (n as i32 - 1 - x.abs().log10().floor() as i32).clamp(0, 9);
    format!("{x:.*}", decimals as usize)
}

/// A value and its standard deviation, rounded alike, with the unit.
fn measured(value: f64, sigma: f64, unit: &str) -> String {
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    if !(sigma.is_finite() && sigma > 0.0) {
        return format!("{}{unit}", digits(value, 6));
    }
    let decimals = (1 - sigma.log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.decimals$} ± {sigma:.decimals$}{unit}")
}
