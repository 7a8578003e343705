//! Single calls whose instructions are counted (benches/instructions.sh).

use crate::problems::timed;
use crate::scenes;
use spivcal::bundle::{AdjustOptions, Termination, adjust};
use spivcal::detect::{DetectOptions, find_discs};
use spivcal::image::{GrayView, Samples};
use std::hint::black_box;
use std::process::ExitCode;

/// Only what happens in here is counted.
#[inline(never)]
fn measured<T>(call: impl FnOnce() -> T) -> T {
    black_box(call())
}

/// Makes the call of a name once.
pub fn run(name: &str) -> ExitCode {
    match name {
        "detect_dots_48" => return detect(scenes::dots(592, 444), 48),
        "detect_two_discs" => return detect(scenes::two_discs(), 2),
        _ => {}
    }
    let Some(case) = name.strip_prefix("adjust_").and_then(timed) else {
        eprintln!("no call {name}");
        return ExitCode::from(2);
    };
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let out = measured(|| adjust(&case.model, case.start, &options, &mut |_| true));
    assert_eq!(out.termination, Termination::Converged, "{name}");
    ExitCode::SUCCESS
}

/// Detection of so many discs.
fn detect((grey, width, height): (Vec<u8>, usize, usize), discs: usize) -> ExitCode {
    let Ok(view) = GrayView::new(Samples::U8(&grey), width, height, width) else { return ExitCode::FAILURE };
    match measured(|| find_discs(&view, &DetectOptions::default())) {
        Ok(found) if found.discs.len() == discs => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}
