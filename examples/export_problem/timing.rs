//! Time of one adjustment, for the benchmark against other solvers.

use crate::problems::timed;
use rayon::ThreadPoolBuilder;
use spivcal::bundle::{AdjustOptions, Adjustment, Termination, adjust, named_covariance};
use spivcal::solve::posterior;
use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

fn median(mut x: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    x[x.len() / 2]
}

/// Median seconds of `rounds` calls, and what the last one gave.
fn timed_calls<T>(rounds: usize, mut call: impl FnMut() -> T) -> (f64, T) {
    let mut last = call();
    let seconds = (0..rounds.max(1)).map(|_| {
        let begin = Instant::now();
        last = black_box(call());
        begin.elapsed().as_secs_f64()
    });
    (median(seconds.collect()), last)
}

/// Prints observations, seconds of an adjustment (median of `rounds`), cost, decrement, number of linearisations; seconds of the covariance
/// of all unknowns of the solver, and of the natural parameters with names.
pub fn run(name: &str, rounds: usize, threads: usize) -> ExitCode {
    let Some(case) = timed(name) else {
        eprintln!("no problem {name} in the benchmark");
        return ExitCode::from(2);
    };
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let solve = || -> Adjustment { adjust(&case.model, case.start.clone(), &options, &mut |_| true) };
    pool.install(|| {
        let (seconds, out) = timed_calls(rounds, solve);
        assert_eq!(out.termination, Termination::Converged, "{name}");
        let equations = out.equations.as_ref().expect("equations");
        let (covariance, _) = timed_calls(rounds, || posterior(equations));
        let named = if case.model.views.len() > 50 { 0.0 } else { timed_calls(rounds, || named_covariance(&out)).0 };
        let (n, observed) = (out.iterations, case.model.counts().observations);
        println!("{observed} {seconds:e} {:e} {:e} {n} {covariance:e} {named:e}", out.cost, out.decrement);
    });
    ExitCode::SUCCESS
}
