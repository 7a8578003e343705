//! Whether the model lacks something, in words.

use super::culprit::TOLD_APART;
use super::enlarged::ENLARGED;
use super::keys::{Keys, intrinsic_unit};
use super::moved;
use super::probes::Probes;
use super::{Asked, FALSE_ALARMS, FELT_SIGMAS, Subject, Watch, digits, measured};
use crate::bundle::{
    CameraModel, Extension, ExtensionTest, ExtensionTests, Model, Moved, TargetShape, extension_tests, intrinsic_words,
    moved_test, named_rows,
};
use crate::record::{ModelTest, Prior};
use crate::stats::chi_square_above;
use nalgebra::{DMatrix, DVector};

/// What a change of the global unknowns does to what a user relies on: the keys, and what is felt over the sheet.
struct Felt<'a> {
    keys: &'a Keys,
    probes: Option<&'a Probes>,
    rows: DMatrix<f64>,
    variance: DVector<f64>,
}

impl<'a> Felt<'a> {
    fn of(s: &Subject<'_>, keys: &'a Keys, probes: Option<&'a Probes>) -> Self {
        let by_name: Vec<_> = keys.rows.iter().chain(probes.iter().flat_map(|p| &p.rows)).cloned().collect();
        let rows = named_rows(s.adjustment, &by_name).unwrap_or_else(|| DMatrix::zeros(0, 0));
        Self { keys, probes, rows, variance: s.covariance.propagate(&by_name).diagonal() }
    }

    fn name(&self, k: usize) -> String {
        match (self.keys.list.get(k), self.probes) {
            (None, Some(probes)) => probes.name(k - self.keys.list.len()),
            (key, _) => key.map_or(String::new(), |key| key.name.clone()),
        }
    }

    /// Largest change, in its standard deviations, and of what.
    fn bias(&self, change: &DVector<f64>) -> (f64, String) {
        let mut out = (0.0, 0);
        if self.rows.ncols() != change.len() {
            return (0.0, String::new());
        }
        let moved = &self.rows * change;
        let determined = self.keys.determined.iter().chain(self.probes.iter().flat_map(|p| &p.determined));
        for (k, _) in determined.enumerate().filter(|(_, determined)| **determined) {
            let sigma = self.variance[k].max(0.0).sqrt();
            if sigma > 0.0 && moved[k].abs() / sigma > out.0 {
                out = (moved[k].abs() / sigma, k);
            }
        }
        (out.0, if out.0 > 0.0 { self.name(out.1) } else { String::new() })
    }
}

/// What was asked of the model.
#[derive(Default)]
pub(super) struct ModelTests {
    pub(super) asked: Vec<Asked<ModelTest>>,
    /// What the first of them are about; that of a move follows.
    of: Vec<Extension>,
    /// When a camera was moved, where a user must be told of it before all else.
    pub(super) moved: Option<Moved>,
    /// The view that alone stands on one side of a move.
    pub(super) apart: Option<usize>,
}

impl ModelTests {
    /// The model with the lens terms that a user must look at, of both cameras, whose lenses are alike as a rule; and their number.
    pub(super) fn granted(&self, mut model: Model) -> (Model, usize) {
        let before = model.cameras.clone();
        for (of, _) in self.of.iter().zip(&self.asked).filter(|(_, asked)| asked.flagged) {
            if let Extension::Intrinsic { parameter, .. } = *of {
                model.cameras.iter_mut().for_each(|c| *c = c.clone().freed([parameter]));
            }
        }
        let free = |cameras: &[CameraModel]| cameras.iter().flat_map(|c| c.free).filter(|free| *free).count();
        let granted = free(&model.cameras) - free(&before);
        (model, granted)
    }

    /// What a user must be told: of a move that goes first, of the others.
    pub(super) fn flags(&self) -> [Vec<String>; 2] {
        let (others, first) = self.asked.split_at(self.asked.len() - usize::from(self.moved.is_some()));
        [first, others].map(super::flags)
    }
}

/// All tests.
pub(super) fn model_tests(s: &Subject<'_>, (keys, probes): (&Keys, Option<&Probes>), watch: &Watch<'_>) -> ModelTests {
    let Some(all) = extension_tests(s.adjustment) else { return ModelTests::default() };
    let tests = &all.list;
    let felt = Felt::of(s, keys, probes);
    let moved = moved_test(s.adjustment, &mut |i| watch.goes_on(i));
    let count = (tests.len() + usize::from(moved.is_some())) as f64;
    let needed = |p_value: f64| p_value * count < FALSE_ALARMS;
    // Of what a moved camera does to the images other tests explain a part, and it a part of what they are of: what explains most is to be believed.
    let beyond = |statistic: f64, degrees: usize| statistic - degrees as f64;
    let explained = tests.iter().map(|t| beyond(t.statistic, t.degrees)).fold(0.0, f64::max);
    let (mut of_move, mut first, mut apart) = (None, None, None);
    if let Some(test) = moved {
        let views = s.adjustment.model.views.len();
        let [at_first, at_last] = test.changes.each_ref().map(|change| felt.bias(change));
        let bias = if at_first.0 > at_last.0 { at_first } else { at_last };
        let enlarged = Some(enlarged(s)).filter(|times| *times > ENLARGED);
        let mut one = moved::model_test(&test, views, (needed(test.p_value), enlarged), bias);
        let excess = beyond(test.statistic, test.degrees);
        if one.row.needed && excess <= explained {
            one.row.words += "; what else the images ask for explains more, and goes first";
        }
        one.flagged &= excess > explained;
        // A single view may be wrong by itself: what else is said of it stays beside.
        apart = test.when.alone(views).filter(|_| one.flagged);
        first = (one.flagged && apart.is_none()).then_some(test.when);
        of_move = Some(one);
    }
    let by_move = of_move.as_ref().is_some_and(|one| one.flagged);
    let each = tests.iter().map(|test| {
        let p_value = chi_square_above(test.statistic, test.degrees as f64);
        let mut one = of_extension(s, test, (p_value, needed(p_value)), felt.bias(&test.shift));
        if one.row.needed && by_move {
            one.goes_after("a moved camera explains more");
        }
        one
    });
    let mut asked: Vec<Asked<ModelTest>> = each.collect();
    what_others_explain(s, &all, &mut asked, needed);
    asked.extend(of_move);
    ModelTests { asked, of: tests.iter().map(|t| t.extension).collect(), moved: first, apart }
}

/// What one lacking term does to the images others explain a part of: flags stay on the test that explains most, and on those that explain more beside it.
fn what_others_explain(
    s: &Subject<'_>,
    all: &ExtensionTests,
    asked: &mut [Asked<ModelTest>],
    needed: impl Fn(f64) -> bool,
) {
    let excess = |k: &usize| all.list[*k].statistic - all.list[*k].degrees as f64;
    let mut flagged: Vec<usize> = (0..asked.len()).filter(|k| asked[*k].flagged).collect();
    flagged.sort_by(|a, b| excess(b).total_cmp(&excess(a)));
    let mut kept: Vec<usize> = vec![];
    for k in flagged {
        let beside = if kept.is_empty() { None } else { Some(all.beside(k, &kept)) };
        match beside {
            Some(rest) if !rest.is_some_and(|(chi2, degrees)| needed(chi_square_above(chi2, degrees as f64))) => {
                asked[k].goes_after(&format!("not beside {}", what(s, all.list[kept[0]].extension)));
            }
            _ => kept.push(k),
        }
    }
}

/// Whether it is a number that every lens, sensor or disc has, and held because the rig file says so.
fn is_held(e: Extension) -> bool {
    matches!(e, Extension::Intrinsic { parameter: 0 | 2..=5, .. } | Extension::Radius { .. })
}

/// Priors that the images contradict by less than a lacking term explains: it is what bends the estimate there, as no prior explains more than what it
/// is off by.
pub(super) fn priors_go_after(s: &Subject<'_>, tests: &ModelTests, priors: &mut [Asked<Prior>]) {
    let flagged = tests.asked.iter().zip(&tests.of).filter(|(one, _)| one.flagged);
    let excess = |row: &ModelTest| row.statistic - row.degrees_of_freedom as f64;
    let Some((most, of)) = flagged.max_by(|a, b| excess(&a.0.row).total_cmp(&excess(&b.0.row))) else { return };
    for prior in priors.iter_mut().filter(|p| p.flagged && p.row.z.powi(2) + TOLD_APART < excess(&most.row)) {
        prior.goes_after(&format!("{} explains more, and goes first", what(s, *of)));
    }
}

/// What is lacking, in words.
fn what(s: &Subject<'_>, e: Extension) -> String {
    match e {
        Extension::Intrinsic { camera, parameter } => {
            let fixed = if is_held(e) { "the fixed " } else { "" };
            format!("{fixed}{} of camera {}", intrinsic_words(parameter), s.adjustment.model.cameras[camera].name)
        }
        Extension::Radius { parameter } => match s.adjustment.model.target.shape {
            TargetShape::Pair { .. } => format!("the stated radius of disc {}", parameter - 1),
            TargetShape::Lattice(_) => "the stated radius of the dots".into(),
        },
        Extension::BentTarget => "the bend of the plate".into(),
        Extension::DisplacedDiscs => "the displaced dots".into(),
    }
}

/// One test, and whether a user would feel what is lacking.
fn of_extension(
    s: &Subject<'_>,
    test: &ExtensionTest,
    (p_value, needed): (f64, bool),
    bias: (f64, String),
) -> Asked<ModelTest> {
    let enlarged = enlarged(s);
    let displaced = test.extension == Extension::DisplacedDiscs;
    // What is the same in all images passes for scatter where sigmas were enlarged for it.
    let alike = needed && enlarged > ENLARGED && (displaced || is_held(test.extension));
    let felt = needed && (bias.0 > FELT_SIGMAS || alike);
    let [found, then] =
        if alike && displaced { misprinted(test, enlarged) } else { words(s, test, needed, felt, &bias) };
    let row = ModelTest {
        question: question(s, test.extension),
        statistic: test.statistic,
        degrees_of_freedom: test.degrees,
        p_value,
        size: test.size * shown(test.extension).0,
        sigma: test.sigma * shown(test.extension).0,
        unit: shown(test.extension).1.into(),
        words: format!("{found}{then}"),
        bias_sigmas: bias.0,
        bias_of: bias.1,
        needed,
    };
    Asked { row, found, flagged: felt }
}

/// By how much the sigmas of an image are enlarged, at most.
fn enlarged(s: &Subject<'_>) -> f64 {
    s.adjustment.model.images.iter().map(|i| i.sigma_scale).fold(1.0, f64::max)
}

/// What is said of dots off their places where the scatter of discs has enlarged sigmas: these hold errors of single images, and shrink with their number.
fn misprinted(t: &ExtensionTest, enlarged: f64) -> [String; 2] {
    let found = format!(
        "the dots lie {} um (rms) off their nominal places, by the same in all images: sigmas enlarged {} times for discs that scatter from image to image \
         do not hold that",
        digits(1e3 * t.size, 2),
        digits(enlarged, 2)
    );
    [found, "; write adjust = \"points\" in [target]".into()]
}

/// Pupil ratios that lenses have, retrofocus and telephoto among them.
const PUPIL_RATIOS: std::ops::RangeInclusive<f64> = 0.3..=3.0;

/// Whether a test asks for a pupil ratio of no lens.
fn no_lens_has(s: &Subject<'_>, t: &ExtensionTest) -> bool {
    let Extension::Intrinsic { camera, parameter } = t.extension else { return false };
    let now = s.adjustment.state.cameras[camera].pupil_ratio;
    crate::camera::INTRINSIC_NAMES[parameter] == "pupil_ratio" && !PUPIL_RATIOS.contains(&(now + t.size))
}

fn shown(e: Extension) -> (f64, &'static str) {
    match e {
        Extension::Intrinsic { parameter, .. } => intrinsic_unit(parameter),
        Extension::Radius { .. } | Extension::BentTarget | Extension::DisplacedDiscs => (1.0, "mm"),
    }
}

fn question(s: &Subject<'_>, e: Extension) -> String {
    match e {
        Extension::Intrinsic { parameter: 0 | 2..=5, .. } | Extension::Radius { .. } => {
            format!("is {} right?", what(s, e))
        }
        Extension::Intrinsic { camera, parameter } => {
            let camera = &s.adjustment.model.cameras[camera];
            let beside = if parameter == 8 && !camera.free[7] { " beside k2" } else { "" };
            format!("is {} of camera {} needed{beside}?", intrinsic_words(parameter), camera.name)
        }
        Extension::BentTarget => "is the plate bent?".into(),
        Extension::DisplacedDiscs => "are the dots displaced?".into(),
    }
}

/// What was found, and what comes of it.
fn words(s: &Subject<'_>, t: &ExtensionTest, needed: bool, felt: bool, bias: &(f64, String)) -> [String; 2] {
    let (factor, unit) = shown(t.extension);
    let found = measured(t.size * factor, t.sigma * factor, unit);
    let (yes, no) = match t.extension {
        Extension::Intrinsic { parameter: 0 | 2..=5, .. } | Extension::Radius { .. } => {
            let what = what(s, t.extension);
            (
                format!("{what} contradicts the images: they ask for a change by {found}"),
                format!("{what} is that of the images"),
            )
        }
        Extension::Intrinsic { parameter, .. } => {
            let what = what(s, t.extension);
            let change = if matches!(parameter, 1 | 9) { "a change by" } else { "" };
            (
                format!("the images ask for {what}: {} {found}", if change.is_empty() { "about" } else { change }),
                format!("{what} is not needed"),
            )
        }
        Extension::BentTarget => (
            format!("the plate is bent by {found} (peak to valley)"),
            "the plate is flat as far as the images show".into(),
        ),
        Extension::DisplacedDiscs => (
            format!("the dots lie {} um (rms) off their nominal places", digits(1e3 * t.size, 2)),
            "the dots lie where they should as far as the images show".into(),
        ),
    };
    if !needed {
        return [no, String::new()];
    }
    if no_lens_has(s, t) {
        let then = ": something else bends the images so (a decentred lens, a window)";
        return [format!("{yes}, which no lens has"), then.into()];
    }
    if !felt {
        let then =
            format!("; adding it would move no result by more than {} of its standard deviations", digits(bias.0, 2));
        return [yes, then];
    }
    let advice = match t.extension {
        Extension::Intrinsic { parameter: parameter @ 6..=8, .. } => {
            format!("add \"{}\" to estimate in [solve]", crate::camera::INTRINSIC_NAMES[parameter])
        }
        Extension::Intrinsic { .. } if is_held(t.extension) => {
            "correct it in [camera.known], or write { value = ..., sigma = ... } with what is known of it".into()
        }
        Extension::Intrinsic { parameter, .. } => {
            let key = crate::camera::INTRINSIC_NAMES[parameter];
            format!(
                "if lens or sensor give a reason, estimate it: {key} = {{ value = 1.0, sigma = ... }} in [camera.known]"
            )
        }
        Extension::Radius { .. } => "correct radii_mm, or write adjust = \"shape\" in [target]".into(),
        Extension::BentTarget | Extension::DisplacedDiscs => "write adjust = \"points\" in [target]".into(),
    };
    let then =
        format!("; without it the {} is off by {} of its standard deviations; {advice}", bias.1, digits(bias.0, 2));
    [yes, then]
}
