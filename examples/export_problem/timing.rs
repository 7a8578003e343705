//! Time of one adjustment, for the benchmark against other solvers.

use crate::problems::timed;
use spivcal::bundle::{AdjustOptions, Termination, adjust};
use std::process::ExitCode;
use std::time::Instant;

/// Prints the median seconds of `rounds` adjustments, the decrement and the number of linearisations.
pub fn run(name: &str, rounds: usize) -> ExitCode {
    let Some(case) = timed().into_iter().find(|c| c.name == name) else {
        eprintln!("no problem {name} in the benchmark");
        return ExitCode::from(2);
    };
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let mut seconds = vec![];
    let mut last = (0.0, 0);
    for _ in 0..rounds.max(1) {
        let start = case.start.clone();
        let begin = Instant::now();
        let out = adjust(&case.model, start, &options, &mut |_| true);
        seconds.push(begin.elapsed().as_secs_f64());
        assert_eq!(out.termination, Termination::Converged, "{name}");
        last = (out.decrement, out.iterations);
    }
    seconds.sort_by(f64::total_cmp);
    println!("{:e} {:e} {}", seconds[seconds.len() / 2], last.0, last.1);
    ExitCode::SUCCESS
}
