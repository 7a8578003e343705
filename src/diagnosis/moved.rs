//! Whether the cameras stood still to each other, in words.

use super::{Asked, FELT_SIGMAS, digits, measured};
use crate::bundle::MovedTest;
use crate::record::ModelTest;

/// The test as a row of the record, and whether a user would feel it; `views` is their number, `needed` whether the cameras moved. Standard deviations that
/// are `enlarged` for what a move does hide what results are off by.
pub(super) fn model_test(
    t: &MovedTest,
    views: usize,
    (needed, enlarged): (bool, Option<f64>),
    bias: (f64, String),
) -> Asked<ModelTest> {
    let [size, sigma] = t.turn_rad.map(f64::to_degrees);
    let felt = needed && (bias.0 > FELT_SIGMAS || enlarged.is_some());
    let found = match needed {
        false if t.scattered => "the views differ by more than noise, but not as after one move of a camera".into(),
        false => "the cameras stood still to each other as far as the views show".into(),
        true => found(t, views),
    };
    let then = match (needed, enlarged) {
        (false, _) => String::new(),
        (true, _) if !felt => {
            format!("; no result is off by more than {} of its standard deviations", digits(bias.0, 2))
        }
        (true, Some(times)) => {
            format!("; all standard deviations are {} times larger for it; {}", digits(times, 2), t.when.advice(views))
        }
        (true, None) => format!(
            "; the {} is off by {} of its standard deviations; {}",
            bias.1,
            digits(bias.0, 2),
            t.when.advice(views)
        ),
    };
    let row = ModelTest {
        question: "did a camera move between views?".into(),
        statistic: t.statistic,
        degrees_of_freedom: t.degrees,
        p_value: t.p_value,
        size,
        sigma,
        unit: "degrees".into(),
        words: format!("{found}{then}"),
        bias_sigmas: bias.0,
        bias_of: bias.1,
        needed,
    };
    Asked { row, found, flagged: felt }
}

fn found(t: &MovedTest, views: usize) -> String {
    // A shift of cameras whose distance nothing but the first motion tells has no size.
    let told = |[size, sigma]: [f64; 2]| size > 2.0 * sigma;
    let turn = measured(t.turn_rad[0].to_degrees(), t.turn_rad[1].to_degrees(), "degrees");
    let shift = measured(t.shift_mm[0], t.shift_mm[1], "mm");
    // Of a camera that turns, the other shifts as seen from it: which of both it was is not known, the angle is the same.
    let by = match (told(t.turn_rad), told(t.shift_mm)) {
        (true, _) => format!(": turned by {turn} against the other"),
        (false, true) => format!(": shifted by {shift} against the other"),
        (false, false) => String::new(),
    };
    t.when.words(views) + &by
}
