//! Single calls whose instructions are counted (benches/instructions.sh).

use crate::problems::timed;
use spivcal::bundle::{AdjustOptions, Termination, adjust};
use std::hint::black_box;
use std::process::ExitCode;

/// Only what happens in here is counted.
#[inline(never)]
fn measured<T>(call: impl FnOnce() -> T) -> T {
    black_box(call())
}

/// Makes the call of a name once.
pub fn run(name: &str) -> ExitCode {
    let Some(case) = name.strip_prefix("adjust_").and_then(timed) else {
        eprintln!("no call {name}");
        return ExitCode::from(2);
    };
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let out = measured(|| adjust(&case.model, case.start, &options, &mut |_| true));
    assert_eq!(out.termination, Termination::Converged, "{name}");
    ExitCode::SUCCESS
}
