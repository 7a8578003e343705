//! Time of one adjustment, for the benchmark against other solvers.

use crate::problems::timed;
use rayon::ThreadPoolBuilder;
use spivcal::bundle::{AdjustOptions, Adjustment, Termination, adjust, named_covariance, shared_covariance};
use spivcal::solve::posterior;
use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

/// Processor time of this thread in seconds, which other programs on the machine do not lengthen; `None` where the system does not tell.
fn processor_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split(' ').next()?.parse::<f64>().ok()? * 1e-9)
}

/// Mean seconds of at least `rounds` calls and a quarter of a second, and what the last one gave: processor time of the one thread, or what
/// the clock on the wall says of several. The clock is read between ever longer runs of calls: to read it takes some microseconds.
pub fn timed_calls<T>(rounds: usize, threads: usize, mut call: impl FnMut() -> T) -> (f64, T) {
    let begin = Instant::now();
    let now = || match processor_seconds() {
        Some(seconds) if threads == 1 => seconds,
        _ => begin.elapsed().as_secs_f64(),
    };
    let mut last = call();
    let (start, mut calls, mut run) = (now(), 0, rounds.max(1));
    loop {
        for _ in 0..run {
            last = black_box(call());
        }
        calls += run;
        let seconds = now() - start;
        if seconds >= 0.25 {
            return (seconds / calls as f64, last);
        }
        // A quarter of all calls so far, so that the end is not overrun by much.
        run = calls.div_ceil(4);
    }
}

/// Prints observations, seconds of an adjustment, cost, decrement, number of linearisations; seconds of the covariance
/// of all unknowns of the solver, of what the views share alone, and of the natural parameters with names.
pub fn run(name: &str, rounds: usize, threads: usize) -> ExitCode {
    let Some(case) = timed(name) else {
        eprintln!("no problem {name} in the benchmark");
        return ExitCode::from(2);
    };
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let solve = || -> Adjustment { adjust(&case.model, case.start.clone(), &options, &mut |_| true) };
    pool.install(|| {
        let (seconds, out) = timed_calls(rounds, threads, solve);
        assert_eq!(out.termination, Termination::Converged, "{name}");
        let equations = out.equations.as_ref().expect("equations");
        // Where every point is estimated the covariance of all of them takes minutes.
        let large = case.model.target.offset_sigma_mm.is_some();
        let (covariance, _) =
            if large { (0.0, None) } else { timed_calls(rounds, threads, || Some(posterior(equations))) };
        let (shared, _) = if large { (0.0, None) } else { timed_calls(rounds, threads, || shared_covariance(&out)) };
        let named = || timed_calls(rounds, threads, || named_covariance(&out)).0;
        let named = if large || case.model.views.len() > 50 { 0.0 } else { named() };
        let (n, observed) = (out.iterations, case.model.counts().observations);
        println!("{observed} {seconds:e} {:e} {:e} {n} {covariance:e} {shared:e} {named:e}", out.cost, out.decrement);
    });
    ExitCode::SUCCESS
}
