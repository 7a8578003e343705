//! Sampled against predicted errors of calibrations from rendered pictures.
//!
//!     cargo run --release --example from_pictures -- --light short-smoke --from 0 --count 100
//!
//! The pictures are those of `examples/bubbles` in other light, each seed with noise and smoke of its own; what is told beforehand is what
//! an experimenter would know. Seeds are the numbers of the runs and give the same on any number of threads (`--threads`, default 2).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)]

#[path = "../tests/picture_runs/mod.rs"]
mod picture_runs;

use picture_runs::{LIGHTS, QUANTITIES, Run, Summary};
use rayon::prelude::*;

fn run() -> Result<(), String> {
    let (mut light, mut from, mut count, mut threads) = ("uneven".to_string(), 0, 40, 2);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let value = words.next().ok_or_else(|| format!("{word} needs a value"))?;
        let number = || value.parse::<u64>().map_err(|_| format!("{word}: \"{value}\" is no whole number"));
        match word.as_str() {
            "--light" => light = value,
            "--from" => from = number()?,
            "--count" => count = number()?,
            "--threads" => threads = number()?,
            other => return Err(format!("unknown word {other}")),
        }
    }
    let names = LIGHTS.map(|l| l.0).join(", ");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build().map_err(|e| e.to_string())?;
    let runs: Option<Vec<Run>> =
        pool.install(|| (from..from + count).into_par_iter().map(|seed| Run::of(&light, seed)).collect());
    let runs = runs.filter(|r| !r.is_empty()).ok_or_else(|| format!("no runs of \"{light}\"; there are {names}"))?;
    let s = Summary::of(&runs);
    println!("{light}: {} runs, chi-square of the fits over degrees of freedom {:.3}", runs.len(), s.fit);
    println!("  {:36} {:>11} {:>9} {:>9}", "", "sigma", "mean z", "mean z^2");
    for (what, [sigma, z, z2]) in QUANTITIES.iter().zip(s.quantities) {
        println!("  {what:36} {sigma:11.3e} {z:9.2} {z2:9.2}");
    }
    println!("  all numbers of both cameras together, chi-square over their number: {:.3}", s.joint);
    Ok(())
}

fn main() -> std::process::ExitCode {
    match run() {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("from_pictures: {message}");
            std::process::ExitCode::from(2)
        }
    }
}
