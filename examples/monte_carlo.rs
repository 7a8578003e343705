//! Sampled against predicted scatter of the reference problems, in parts.
//!
//!     cargo run --release --example monte_carlo -- --problem A --from 0 --count 400 --out a0.csv
//!     cargo run --release --example monte_carlo -- --problem A --summarise a0.csv a1.csv
//!     cargo run --release --example monte_carlo -- --problem C0 --bound
//!
//! Seeds are the numbers of the runs: parts may be made in any order, on any number of threads (`--threads`, default 2), and
//! give the same lines. The problems and quantities are described in `tests/rig_scene`, which this program shares with the tests; it
//! is an example, so that it sees the library as any caller does and is built by every test run.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)]

#[path = "../tests/rig_scene/mod.rs"]
mod rig_scene;

use rayon::prelude::*;
use rig_scene::{Bound, Problem, QUANTITIES, Run, Summary, TWO_SIDED_95, band};

const DISPARITIES: [&str; 2] = ["disparity rms, px", "the same, plane refitted"];

struct Arguments {
    problem: String,
    from: u64,
    count: u64,
    threads: usize,
    out: Option<String>,
    summarise: Vec<String>,
    bound: bool,
}

fn arguments() -> Result<Arguments, String> {
    let mut a =
        Arguments { problem: "A".into(), from: 0, count: 400, threads: 2, out: None, summarise: vec![], bound: false };
    let mut words = std::env::args().skip(1).peekable();
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or_else(|| format!("{word} needs a value"));
        let number = |v: String| v.parse::<u64>().map_err(|_| format!("{word}: \"{v}\" is no whole number"));
        match word.as_str() {
            "--problem" => a.problem = value()?,
            "--from" => a.from = number(value()?)?,
            "--count" => a.count = number(value()?)?,
            "--threads" => a.threads = number(value()?)? as usize,
            "--out" => a.out = Some(value()?),
            "--bound" => a.bound = true,
            "--summarise" => a.summarise = words.by_ref().collect(),
            other => return Err(format!("unknown word {other}")),
        }
    }
    Ok(a)
}

fn show_bound(name: &str, bound: &Bound) {
    let covariance = &bound.covariance;
    println!("problem {name}: undetermined directions {}", covariance.nullity);
    covariance.undetermined.iter().for_each(|w| println!("  {w}"));
    for (what, sigma) in QUANTITIES.iter().zip(&bound.sigmas) {
        println!("  {what:24} {}", sigma.map_or("not determined".into(), |s| format!("{s:.3e}")));
    }
    for (what, disparity) in DISPARITIES.iter().zip([bound.disparity_px, bound.refitted_px]) {
        println!("  {what:24} {}", disparity.map_or("not determined".into(), |d| format!("{d:.5}")));
    }
}

fn show(name: &str, bound: &Bound, runs: &[Run]) {
    let s = Summary::of(runs);
    println!("problem {name}: {} runs, {} of them from a start that led elsewhere", s.runs, s.wrong_starts);
    println!("  {:24} {:>11} {:>9} {:>9}", "", "bound", "mean z", "ratio");
    for (k, what) in QUANTITIES.iter().enumerate() {
        let [mean, ratio] = s.mean_and_ratio[k];
        let sigma = bound.sigmas[k].map_or("none".into(), |b| format!("{b:.3e}"));
        println!("  {what:24} {sigma:>11} {mean:9.3} {ratio:9.3}");
    }
    let sampled = [s.disparity_px, s.refitted_px];
    for ((what, predicted), sampled) in DISPARITIES.iter().zip([bound.disparity_px, bound.refitted_px]).zip(sampled) {
        let predicted = predicted.unwrap_or(f64::NAN);
        println!("  {what:24} {predicted:11.5} {:>9} {:9.3}", "", sampled / predicted);
    }
    let [low, high] = band(8.0 * s.runs as f64, TWO_SIDED_95);
    println!(
        "  squared error / 8: at the truth {:.4}, at the estimate {:.4}; 95 % band {low:.4} to {high:.4}",
        s.nees_at_truth, s.nees_at_estimate
    );
}

fn run() -> Result<(), String> {
    let a = arguments()?;
    let problem = Problem::of(&a.problem)
        .ok_or_else(|| format!("no problem \"{}\"; there are {}", a.problem, Problem::NAMES.join(", ")))?;
    let bound = Bound::of(&problem);
    if a.bound {
        show_bound(&a.problem, &bound);
        return Ok(());
    }
    let mut runs: Vec<Run> = vec![];
    if a.summarise.is_empty() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(a.threads).build().map_err(|e| e.to_string())?;
        let seeds: Vec<u64> = (a.from..a.from + a.count).collect();
        runs = pool.install(|| seeds.par_iter().map(|s| Run::of(&problem, &bound, *s)).collect());
    }
    for file in &a.summarise {
        let text = std::fs::read_to_string(file).map_err(|e| format!("{file}: {e}"))?;
        for line in text.lines() {
            runs.push(Run::parse(line).ok_or_else(|| format!("{file}: not a line of runs: {line}"))?);
        }
    }
    if let Some(out) = &a.out {
        let lines: String = runs.iter().map(|r| r.line() + "\n").collect();
        std::fs::write(out, lines).map_err(|e| format!("{out}: {e}"))?;
    }
    show(&a.problem, &bound, &runs);
    Ok(())
}

fn main() -> std::process::ExitCode {
    match run() {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("monte_carlo: {message}");
            std::process::ExitCode::from(2)
        }
    }
}
