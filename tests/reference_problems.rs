//! Predicted against sampled: the same rig measured again and again, with fresh noise on every edge point and a fresh
//! draw of everything known beforehand, must scatter about the truth as its covariance says.
//!
//! ```text
//! z      = (estimate - truth) / sigma predicted at the truth      sum of z^2 over n runs: chi-square, n degrees of freedom
//! nees   = e^T C^-1 e, e the errors of 8 camera numbers           sum over n runs: chi-square, 8 n degrees of freedom
//! ```
//! Four problems with eleven quantities each have to pass together, so every band holds 99.5 %.
//! The problems are described in `rig_scene/reference.rs`; `examples/monte_carlo.rs` runs 1600 of each.
//!
//! `SPIVCAL_MC=400` runs more.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use rig_scene::{Bound, Noise, Problem, QUANTITIES, Run, Summary, band};

/// Standard normal quantile of 0.9975.
const TWO_SIDED_995: f64 = 2.807034;

fn runs() -> u64 {
    std::env::var("SPIVCAL_MC").ok().and_then(|s| s.parse().ok()).unwrap_or(40)
}

fn sampled_is_predicted(what: &str) {
    let problem = Problem::of(what).unwrap();
    let bound = Bound::of(&problem);
    let n = runs();
    let all: Vec<Run> = (0..n).map(|seed| Run::of(&problem, &bound, 100_000 + seed)).collect();
    let s = Summary::of(&all);
    let mut outside = vec![];
    let [low, high] = band(n as f64, TWO_SIDED_995);
    for (name, [mean, ratio]) in QUANTITIES.iter().zip(&s.mean_and_ratio) {
        let square = ratio * ratio;
        println!("{what:9} {name:24} mean z {mean:6.3}, mean z^2 {square:.3} (band {low:.3} to {high:.3})");
        if !(low..=high).contains(&square) || !(mean.abs() < TWO_SIDED_995 / (n as f64).sqrt()) {
            outside.push(format!("{name}: mean z {mean:.3}, mean z^2 {square:.3}"));
        }
    }
    let [low, high] = band(8.0 * n as f64, TWO_SIDED_995);
    let (at_truth, at_estimate) = (s.nees_at_truth, s.nees_at_estimate);
    println!(
        "{what:9} squared error / 8: {at_truth:.3}, with the estimate's own covariance {at_estimate:.3} (band {low:.3} to {high:.3}), {n} runs"
    );
    if !(low..=high).contains(&at_truth) {
        outside.push(format!("squared error / 8: {at_truth:.3}, band {low:.3} to {high:.3}"));
    }
    // The start is a third of a usual start's error away: no other minimum may be nearer.
    if s.wrong_starts * 50 > s.runs {
        outside.push(format!("{} of {} starts led elsewhere", s.wrong_starts, s.runs));
    }
    assert!(outside.is_empty(), "{what}: {outside:#?}");
}

#[test]
fn reference_a_printed_pair() {
    sampled_is_predicted("A");
}

#[test]
fn reference_b_free_bubbles() {
    sampled_is_predicted("B");
}

#[test]
fn reference_c_fixed_sheet_in_focus() {
    sampled_is_predicted("C");
}

#[test]
fn reference_d_fixed_sheet_and_printed_views() {
    sampled_is_predicted("D3");
}

/// Streams of neighbouring seeds and purposes share no draw.
#[test]
fn streams_are_apart() {
    let mut seen = std::collections::BTreeSet::new();
    for (seed, purpose) in (0..100).flat_map(|s| (0..4).map(move |p| (s, p))) {
        let mut noise = Noise::stream(seed, purpose);
        for _ in 0..50 {
            assert!(seen.insert(noise.uniform().to_bits()), "seed {seed}, purpose {purpose}");
        }
    }
}

/// A table of runs is read back as it was written.
#[test]
fn runs_survive_their_file() {
    let problem = Problem::of("A").unwrap();
    let run = Run::of(&problem, &Bound::of(&problem), 7);
    let back = Run::parse(&run.line()).unwrap();
    assert_eq!((back.seed, back.wrong_start), (7, run.wrong_start));
    assert!(back.z.iter().zip(&run.z).all(|(a, b)| (a - b).abs() < 1e-6 * b.abs()));
    assert!(Run::parse("7,0,1.0").is_none() && Run::parse("").is_none());
}
