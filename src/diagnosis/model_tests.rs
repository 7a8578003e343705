//! Whether the model lacks something, in words.

use super::keys::{Keys, intrinsic_unit};
use super::moved;
use super::{FALSE_ALARMS, FELT_SIGMAS, Subject, Watch, digits, measured};
use crate::bundle::{Extension, ExtensionTest, extension_tests, intrinsic_words, moved_test, named_rows};
use crate::record::ModelTest;
use crate::stats::chi_square_above;
use nalgebra::{DMatrix, DVector};

/// What a change of the global unknowns does to the keys.
struct Felt<'a> {
    keys: &'a Keys,
    rows: DMatrix<f64>,
    variance: DVector<f64>,
}

impl Felt<'_> {
    /// Largest change of a key, in its standard deviations, and which.
    fn bias(&self, change: &DVector<f64>) -> (f64, String) {
        let mut out = (0.0, String::new());
        if self.rows.ncols() != change.len() {
            return out;
        }
        let moved = &self.rows * change;
        for (k, key) in self.keys.list.iter().enumerate().filter(|(k, _)| self.keys.determined[*k]) {
            let sigma = self.variance[k].max(0.0).sqrt();
            if sigma > 0.0 && moved[k].abs() / sigma > out.0 {
                out = (moved[k].abs() / sigma, key.name.clone());
            }
        }
        out
    }
}

/// All tests; what explains the others is flagged in `first`.
pub(super) fn model_tests(
    s: &Subject<'_>,
    keys: &Keys,
    watch: &Watch<'_>,
    (first, flags): (&mut Vec<String>, &mut Vec<String>),
) -> Vec<ModelTest> {
    let Some(tests) = extension_tests(s.adjustment) else { return vec![] };
    let rows = named_rows(s.adjustment, &keys.rows).unwrap_or_else(|| DMatrix::zeros(0, 0));
    let felt = Felt { keys, rows, variance: s.covariance.propagate(&keys.rows).diagonal() };
    let moved = moved_test(s.adjustment, &mut |i| watch.goes_on(i));
    let asked = (tests.len() + usize::from(moved.is_some())) as f64;
    let needed = |p_value: f64| p_value * asked < FALSE_ALARMS;
    // Of what a moved camera does to the images other tests explain a part, and it a part of what they are of: what explains most is to be believed.
    let beyond = |statistic: f64, degrees: usize| statistic - degrees as f64;
    let explained = tests.iter().map(|t| beyond(t.statistic, t.degrees)).fold(0.0, f64::max);
    let of_move = moved.map(|test| {
        let views = s.adjustment.model.views.len();
        let [at_first, at_last] = test.changes.each_ref().map(|change| felt.bias(change));
        let bias = if at_first.0 > at_last.0 { at_first } else { at_last };
        let enlarged = Some(enlarged(s)).filter(|times| *times > ENLARGED);
        let (mut row, flagged) = moved::model_test(&test, views, (needed(test.p_value), enlarged), bias);
        let most = beyond(test.statistic, test.degrees) > explained;
        if row.needed && !most {
            row.words += "; what else the images ask for explains more, and goes first";
        }
        (row, flagged && most, test.when.alone(views).is_some())
    });
    let by_move = of_move.as_ref().is_some_and(|(_, flagged, _)| *flagged);
    let mut out: Vec<ModelTest> = vec![];
    for test in &tests {
        let p_value = chi_square_above(test.statistic, test.degrees as f64);
        let (mut one, flagged) = of_extension(s, test, (p_value, needed(p_value)), felt.bias(&test.shift));
        if one.needed && by_move {
            one.words += "; a moved camera explains more, and goes first";
        }
        flags.extend((flagged && !by_move).then(|| one.words.clone()));
        out.push(one);
    }
    if let Some((row, flagged, alone)) = of_move {
        // A single view may be wrong by itself: what else is said of it stays beside.
        if alone { &mut *flags } else { &mut *first }.extend(flagged.then(|| row.words.clone()));
        out.push(row);
    }
    out
}

/// One test, and whether a user would feel what is lacking.
fn of_extension(
    s: &Subject<'_>,
    test: &ExtensionTest,
    (p_value, needed): (f64, bool),
    bias: (f64, String),
) -> (ModelTest, bool) {
    let enlarged = enlarged(s);
    let alike = needed && test.extension == Extension::DisplacedDiscs && enlarged > ENLARGED;
    let felt = needed && (bias.0 > FELT_SIGMAS || alike);
    let one = ModelTest {
        question: question(s, test.extension),
        statistic: test.statistic,
        degrees_of_freedom: test.degrees,
        p_value,
        size: test.size * shown(test.extension).0,
        sigma: test.sigma * shown(test.extension).0,
        unit: shown(test.extension).1.into(),
        words: if alike { misprinted(test, enlarged) } else { words(s, test, needed, felt, &bias) },
        bias_sigmas: bias.0,
        bias_of: bias.1,
        needed,
    };
    (one, felt)
}

/// By how much the sigmas of an image are enlarged, at most.
fn enlarged(s: &Subject<'_>) -> f64 {
    s.adjustment.model.images.iter().map(|i| i.sigma_scale).fold(1.0, f64::max)
}

/// Sigmas enlarged by more hold what discs scatter by, but not that displaced ones are off by the same in all images.
const ENLARGED: f64 = 1.5;

/// What is said of dots off their places where the scatter of discs has enlarged sigmas: these hold errors of single images, and shrink with their number.
fn misprinted(t: &ExtensionTest, enlarged: f64) -> String {
    format!(
        "the dots lie {} um (rms) off their nominal places, by the same in all images: sigmas enlarged {} times for discs that scatter from image to image \
         do not hold that; write adjust = \"points\" in [target]",
        digits(1e3 * t.size, 2),
        digits(enlarged, 2)
    )
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
        Extension::BentTarget | Extension::DisplacedDiscs => (1.0, "mm"),
    }
}

fn question(s: &Subject<'_>, e: Extension) -> String {
    match e {
        Extension::Intrinsic { camera, parameter } => {
            let camera = &s.adjustment.model.cameras[camera];
            let beside = if parameter == 8 && !camera.free[7] { " beside k2" } else { "" };
            format!("is {} of camera {} needed{beside}?", intrinsic_words(parameter), camera.name)
        }
        Extension::BentTarget => "is the plate bent?".into(),
        Extension::DisplacedDiscs => "are the dots displaced?".into(),
    }
}

fn words(s: &Subject<'_>, t: &ExtensionTest, needed: bool, felt: bool, bias: &(f64, String)) -> String {
    let (factor, unit) = shown(t.extension);
    let found = measured(t.size * factor, t.sigma * factor, unit);
    let (yes, no) = match t.extension {
        Extension::Intrinsic { camera, parameter } => {
            let what = format!("{} of camera {}", intrinsic_words(parameter), s.adjustment.model.cameras[camera].name);
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
        return no;
    }
    if no_lens_has(s, t) {
        return format!("{yes}, which no lens has: something else bends the images so (a decentred lens, a window)");
    }
    if !felt {
        return format!(
            "{yes}; adding it would move no result by more than {} of its standard deviations",
            digits(bias.0, 2)
        );
    }
    let advice = match t.extension {
        Extension::Intrinsic { parameter: parameter @ 6..=8, .. } => {
            format!("add \"{}\" to estimate in [solve]", crate::camera::INTRINSIC_NAMES[parameter])
        }
        Extension::Intrinsic { parameter, .. } => {
            let key = crate::camera::INTRINSIC_NAMES[parameter];
            format!(
                "if lens or sensor give a reason, estimate it: {key} = {{ value = 1.0, sigma = ... }} in [camera.known]"
            )
        }
        Extension::BentTarget | Extension::DisplacedDiscs => "write adjust = \"points\" in [target]".into(),
    };
    format!("{yes}; without it the {} is off by {} of its standard deviations; {advice}", bias.1, digits(bias.0, 2))
}
