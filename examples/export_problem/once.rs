//! Single calls whose instructions are counted (benches/instructions.sh).

use crate::problems::timed;
use crate::scenes;
use spivcal::bundle::{AdjustOptions, Termination, adjust, shared_covariance};
use spivcal::detect::{DetectOptions, find_discs};
use spivcal::image::{GrayView, Samples};
use spivcal::pipeline::{CalibrateOptions, calibrate, load_image};
use spivcal::rig_file::RigDescription;
use std::hint::black_box;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

/// Only what happens in here is counted.
#[inline(never)]
fn measured<T>(call: impl FnOnce() -> T) -> T {
    black_box(call())
}

/// Makes the call of a name once.
pub fn run(name: &str) -> ExitCode {
    match name {
        "calibrate_printed" => return record("printed"),
        "detect_dots_48" => return detect(scenes::dots(592, 444), 48),
        "detect_shot_noise" => return detect(scenes::shot_noise(), 2),
        "detect_smoke" => return detect(scenes::smoke(), 1),
        "detect_two_discs" => return detect(scenes::two_discs(), 2),
        _ => {}
    }
    let (covariance, case) = match name.split_once('_') {
        Some(("adjust", case)) => (false, timed(case)),
        Some(("covariance", case)) => (true, timed(case)),
        _ => (false, None),
    };
    let Some(case) = case else {
        eprintln!("no call {name}");
        return ExitCode::from(2);
    };
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let solve = || adjust(&case.model, case.start.clone(), &options, &mut |_| true);
    let out = if covariance { solve() } else { measured(solve) };
    assert_eq!(out.termination, Termination::Converged, "{name}");
    if covariance {
        assert!(measured(|| shared_covariance(&out)).is_some(), "{name}");
    }
    ExitCode::SUCCESS
}

/// Images to the record of one of the examples, with one thread, which counts as a whole.
fn record(example: &str) -> ExitCode {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(example);
    let Ok(text) = std::fs::read_to_string(folder.join("rig.toml")) else { return ExitCode::FAILURE };
    let Ok(job) = RigDescription::parse(&text, "rig.toml") else { return ExitCode::FAILURE };
    let load = |view: usize, camera: usize| {
        let file = job.views[view].images[camera].as_ref().expect("images of both cameras");
        load_image(&folder.join(file)).map(Arc::new)
    };
    let options = CalibrateOptions { threads: 1, ..CalibrateOptions::default() };
    match calibrate(&job, &load, &options, &mut |_| true) {
        Ok(_) => ExitCode::SUCCESS,
        Err(_) => ExitCode::FAILURE,
    }
}

/// Detection of so many discs.
fn detect((grey, width, height): (Vec<u8>, usize, usize), discs: usize) -> ExitCode {
    let Ok(view) = GrayView::new(Samples::U8(&grey), width, height, width) else { return ExitCode::FAILURE };
    match measured(|| find_discs(&view, &DetectOptions::default())) {
        Ok(found) if found.discs.len() == discs => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}
