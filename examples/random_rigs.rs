//! Rigs drawn at random, from images to the calibration, against the truth: how often each number is off by how much of its standard deviation.
//!
//!     cargo run --release --example random_rigs -- --from 0 --count 60
//!
//! Of each kind of target so many rigs; seeds are numbers of rigs, so that parts may be made in any order, and each rig can be drawn again with
//! `--kind "two discs" --from SEED --count 1 --scene FILE`, which writes its scene for `spivcal simulate`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)]

#[path = "../tests/random_rig/mod.rs"]
mod random_rig;

use random_rig::{KINDS, NUMBERS, Outcome, run, scene};
use rayon::prelude::*;

struct Arguments {
    from: u64,
    count: u64,
    kind: Option<String>,
    scene: Option<String>,
}

fn arguments() -> Result<Arguments, String> {
    let mut a = Arguments { from: 0, count: 20, kind: None, scene: None };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or_else(|| format!("{word} needs a value"));
        let number = |v: String| v.parse::<u64>().map_err(|_| format!("{word}: \"{v}\" is no whole number"));
        match word.as_str() {
            "--from" => a.from = number(value()?)?,
            "--count" => a.count = number(value()?)?,
            "--kind" => a.kind = Some(value()?),
            "--scene" => a.scene = Some(value()?),
            other => return Err(format!("unknown word {other}")),
        }
    }
    Ok(a)
}

fn rms(all: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = all.filter(|z| z.is_finite()).fold((0.0, 0.0), |(sum, n), z| (sum + z * z, n + 1.0));
    (sum / n).sqrt()
}

fn summary(kind: &str, all: &[(u64, Result<Outcome, String>)]) {
    let told: Vec<&Outcome> = all.iter().filter_map(|(_, o)| o.as_ref().ok()).collect();
    let z = || told.iter().flat_map(|o| o.z.iter().copied());
    let beyond = |limit: f64| z().filter(|z| z.abs() > limit).count();
    println!(
        "{kind}: {} rigs, {} refused; rms error in standard deviations {:.2}, {} of {} numbers beyond 2, {} beyond 3, largest {:.1}; {} beyond \
         1.96, {} outside their intervals of 95 %; {} with an alarm",
        all.len(),
        all.len() - told.len(),
        rms(z()),
        beyond(2.0),
        z().count(),
        beyond(3.0),
        z().fold(0.0, |most: f64, z| most.max(z.abs())),
        beyond(1.96),
        told.iter().map(|o| o.outside).sum::<usize>(),
        told.iter().filter(|o| !o.alarms.is_empty()).count()
    );
    for (seed, outcome) in all {
        match outcome {
            Err(words) => println!("  {seed} refused: {words}"),
            Ok(o) => {
                let far = NUMBERS.iter().zip(&o.z).filter(|(_, z)| z.abs() > 3.0);
                far.for_each(|(name, z)| println!("  {seed}: {name} off by {z:.1} standard deviations"));
                o.alarms.iter().for_each(|words| println!("  {seed}: {words}"));
            }
        }
    }
}

fn main() -> Result<(), String> {
    let a = arguments()?;
    let kinds: Vec<&str> = KINDS.into_iter().filter(|k| a.kind.as_ref().is_none_or(|wanted| wanted == k)).collect();
    if let Some(path) = &a.scene {
        return std::fs::write(path, scene(a.from, kinds.first().ok_or("no such kind")?)).map_err(|e| e.to_string());
    }
    let mut numbers: Vec<Vec<f64>> = vec![vec![]; NUMBERS.len()];
    for kind in kinds {
        let seeds: Vec<u64> = (a.from..a.from + a.count).collect();
        let all: Vec<(u64, Result<Outcome, String>)> =
            seeds.into_par_iter().map(|seed| (seed, run(&scene(seed, kind)))).collect();
        summary(kind, &all);
        for outcome in all.iter().filter_map(|(_, o)| o.as_ref().ok()) {
            outcome.z.iter().zip(&mut numbers).for_each(|(z, list)| list.push(*z));
        }
    }
    for (name, list) in NUMBERS.iter().zip(&numbers) {
        println!("{name:36} rms error in standard deviations {:.2} of {} rigs", rms(list.iter().copied()), list.len());
    }
    Ok(())
}
