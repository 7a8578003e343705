//! Whether the cameras stood still to each other, in words.

use super::{FELT_SIGMAS, digits, measured};
use crate::bundle::{Moved, MovedTest};
use crate::record::ModelTest;

/// The test as a row of the record, and whether a user would feel it; `views` is their number, `needed` whether the cameras moved. Standard deviations that
/// are `enlarged` for what a move does hide what results are off by.
pub(super) fn model_test(
    t: &MovedTest,
    views: usize,
    (needed, enlarged): (bool, Option<f64>),
    bias: (f64, String),
) -> (ModelTest, bool) {
    let [size, sigma] = t.turn_rad.map(f64::to_degrees);
    let felt = needed && (bias.0 > FELT_SIGMAS || enlarged.is_some());
    let row = ModelTest {
        question: "did a camera move between views?".into(),
        statistic: t.statistic,
        degrees_of_freedom: t.degrees,
        p_value: t.p_value,
        size,
        sigma,
        unit: "degrees".into(),
        words: match (needed, felt) {
            (false, _) if t.scattered => {
                "the views differ by more than noise, but not as after one move of a camera".into()
            }
            (false, _) => "the cameras stood still to each other as far as the views show".into(),
            (true, false) => {
                format!(
                    "{}; no result is off by more than {} of its standard deviations",
                    found(t, views),
                    digits(bias.0, 2)
                )
            }
            (true, true) => {
                let off = match enlarged {
                    Some(times) => format!("all standard deviations are {} times larger for it", digits(times, 2)),
                    None => format!("the {} is off by {} of its standard deviations", bias.1, digits(bias.0, 2)),
                };
                format!("{}; {off}; {}", found(t, views), advice(t.when, views))
            }
        },
        bias_sigmas: bias.0,
        bias_of: bias.1,
        needed,
    };
    (row, felt)
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
    if let Some(view) = t.when.alone(views) {
        let when = if view == 0 { "after" } else { "before" };
        return format!(
            "view {view} stands apart from the others: one camera was moved {when} it{by} (or the target, between its two exposures)"
        );
    }
    match t.when {
        Moved::Before(view) => format!(
            "one camera was moved between view {} and view {view} of {views} (in the order of the rig file){by}",
            view - 1
        ),
        Moved::Steadily => format!(
            "the cameras drift against each other from view to view (in the order of the rig file), from the first to the last{by}"
        ),
    }
}

fn advice(when: Moved, views: usize) -> &'static str {
    match when {
        when if when.alone(views).is_some() => {
            "leave it out; if your recordings were made on its side, take the other views again"
        }
        Moved::Before(_) => {
            "calibrate the views before and those after by themselves (each needs a length and a view in the sheet of its own), and take those of the time \
             of your recordings"
        }
        Moved::Steadily => "fasten the cameras, let them warm up, and take the views again",
    }
}
