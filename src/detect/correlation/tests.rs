#![allow(clippy::expect_used)]
use super::pieces::{BESIDE_PX, Ring, distance};
use super::*;
use crate::conic::{Ellipse, Frame};
use crate::frames::Pixel;
use crate::stats::random::Random;

const SIZE: usize = 320;

/// Dark discs of 9 px, 40 px apart, on ground of 1000 with noise of 20 that is the mean of white noise under `kernel` along u and `across` along v.
fn picture(kernel: &[f64], across: &[f64], seed: u64) -> (Vec<f32>, Vec<Candidate>) {
    let mut random = Random(seed);
    let white: Vec<f64> = (0..SIZE * SIZE).map(|_| random.gauss()).collect();
    let (nu, nv) = (kernel.len(), across.len());
    let squares = |k: &[f64]| k.iter().map(|x| x * x).sum::<f64>();
    let norm = (squares(kernel) * squares(across)).sqrt();
    let mut candidates = Vec::new();
    for k in 0..49 {
        let at = Pixel::new(40.0 + 40.0 * f64::from(k % 7), 40.0 + 40.0 * f64::from(k / 7));
        let ellipse = Ellipse::new(at, 9.0, 9.0, 0.0).expect("an ellipse");
        candidates.push(Candidate { ellipse, blur_px: 1.0, bright: false, contrast: 800.0, rms_px: 0.1, level: 0 });
    }
    let grey = (0..SIZE * SIZE).map(|i| {
        let (u, v) = (i % SIZE, i / SIZE);
        let wrapped = |du: usize, dv: usize| white[(v + dv) % SIZE * SIZE + (u + du) % SIZE];
        let noise: f64 = (0..nv)
            .flat_map(|b| (0..nu).map(move |a| (a, b)))
            .map(|(a, b)| kernel[a] * across[b] * wrapped(a, b))
            .sum();
        let disc = candidates.iter().any(|c| distance(&Frame::new(&c.ellipse), u as f64, v as f64) < 0.0);
        ((if disc { 200.0 } else { 1000.0 }) + 20.0 * noise / norm) as f32
    });
    (grey.collect(), candidates)
}

fn found(kernel: &[f64], across: &[f64], seed: u64) -> NoiseCorrelation {
    let (grey, candidates) = picture(kernel, across, seed);
    let view = GrayView::new(Samples::F32(&grey), SIZE, SIZE, SIZE).expect("an image");
    let all: Vec<&Candidate> = candidates.iter().collect();
    NoiseCorrelation::of(&view, &all, &all, true)
}

#[test]
fn independent_pixels_are_taken_for_such_to_the_bit() {
    for seed in 1..=20 {
        let found = found(&[1.0], &[1.0], seed);
        assert_eq!(found, NoiseCorrelation::NONE, "seed {seed}");
        assert_eq!(found.inflation([0.6, 0.8], 0.9), 1.0);
        assert_eq!(found.allow, Allowance::NONE);
    }
}

/// Against the correlation of the filter that made the noise.
#[test]
fn the_correlation_of_filtered_noise_is_found() {
    let (kernel, across) = ([1.0, 2.0, 1.0], [1.0, 1.0]);
    let truth = |du: i32, dv: i32| {
        let u = match du.abs() {
            0 => 1.0,
            1 => 4.0 / 6.0,
            2 => 1.0 / 6.0,
            _ => 0.0,
        };
        u * match dv.abs() {
            0 => 1.0,
            1 => 0.5,
            _ => 0.0,
        }
    };
    let all: Vec<NoiseCorrelation> = (1..=6).map(|seed| found(&kernel, &across, seed)).collect();
    let mean = |of: &dyn Fn(&NoiseCorrelation) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
    for (du, dv) in lags() {
        let (found, truth) = (mean(&|n| n.at(du, dv)), truth(du, dv));
        assert!((found - truth).abs() < 0.08, "lag {du} {dv}: {found}, {truth}");
    }
    // The variance of a sum along u is that of 16/6 independent ones, along v of 2.
    let (rows, sums) = (mean(&|n| n.allow.rows), mean(&|n| n.allow.sums));
    assert!((rows - 16.0 / 6.0).abs() < 0.3, "{rows}");
    assert!((sums - 32.0 / 6.0).abs() < 0.7, "{sums}");
    // Far wider than the noise reaches, the blur sees all of it; a sharp edge along v has the noise along v in full.
    assert!((mean(&|n| n.inflation([1.0, 0.0], 1e3)) - sums).abs() < 1e-3);
    let sharp = mean(&|n| n.inflation([1.0, 0.0], 0.01));
    assert!((sharp - 2.0).abs() < 0.3, "{sharp}");
}

/// What it is for: the scatter of a weighted sum over correlated noise, weights as those of an edge.
#[test]
fn inflation_is_that_of_weights_across_an_edge() {
    let found = found(&[1.0, 2.0, 1.0], &[1.0, 1.0], 7);
    for (blur, degrees) in [(0.8_f64, 0.0_f64), (1.5, 30.0), (1.0, 90.0)] {
        let (s, c) = degrees.to_radians().sin_cos();
        let weight = |u: i32, v: i32| (-(f64::from(u) * c + f64::from(v) * s).powi(2) / (2.0 * blur * blur)).exp();
        let half = 40;
        let all = || (-half..=half).flat_map(|v| (-half..=half).map(move |u| (u, v)));
        let plain: f64 = all().map(|(u, v)| weight(u, v).powi(2)).sum();
        let shared = found.sum(|rho, du, dv| {
            rho * all().map(|(u, v)| weight(u, v) * weight(u + du as i32, v + dv as i32)).sum::<f64>()
        });
        let (kappa, wanted) = (found.inflation([c, s], blur), shared / plain);
        assert!((kappa - wanted).abs() < 0.02 * wanted, "{blur} {degrees}: {kappa} {wanted}");
    }
}

/// Every pixel whose distance counts, and few others.
#[test]
fn rings_hold_what_is_as_far_as_asked_for() {
    for (a, b, angle_rad) in [(9.0, 9.0, 0.0), (30.0, 12.0, 0.7), (14.0, 5.0, -1.2), (120.0, 90.0, 2.0)] {
        let frame = Frame::new(&Ellipse::new(Pixel::new(150.3, 149.6), a, b, angle_rad).expect("an ellipse"));
        for (side, from_px) in [(1.0, 2.0), (1.0, 7.5), (-1.0, 2.0), (-1.0, 6.0)] {
            let ring = Ring::new(&frame, side, from_px);
            let (mut held, mut inside) = (0, 0);
            for (u, v) in (0..300).flat_map(|v| (0..300).map(move |u| (f64::from(u), f64::from(v)))) {
                let counts = (from_px..from_px + BESIDE_PX).contains(&(side * distance(&frame, u, v)));
                assert!(!counts || ring.may_hold(u, v), "({u}, {v}) of {a} x {b}, {side}, {from_px}");
                held += u32::from(ring.may_hold(u, v));
                inside += u32::from(counts);
            }
            assert!(held < 8 * inside + 200, "{held} for {inside} of {a} x {b}, {side}, {from_px}");
        }
    }
}
