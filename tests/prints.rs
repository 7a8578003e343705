//! Many dots of one print: what chance makes of single contours is no roughness, and roughness of all is told of each.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

mod detect_table;
mod render;

use detect_table::off;
use render::{Random, Spot, draw};
use spivcal::detect::{DetectOptions, Disc, find_discs};
use spivcal::frames::Pixel;
use spivcal::image::{GrayView, Samples};

/// Columns and rows of dots, and pixels of each, edge to edge.
const DOTS: [usize; 2] = [12, 9];
const TILE: [usize; 2] = [46, 42];
/// Harmonics of a rough rim: waves down to 1.7 px, so that edge points scatter each for itself.
const RAGGED: std::ops::Range<usize> = 0..31;

/// Dark dots of 9 x 7.5 px behind a blur of 0.9 px, noise of 2 % of the step; rims scatter by a standard deviation, px.
fn seen(rough_px: f64, seed: u64) -> Vec<(Spot, Disc)> {
    let mut random = Random(seed);
    let [columns, rows] = DOTS;
    let mut near = |middle: usize| middle as f64 + random.uniform() - 0.5;
    let spots: Vec<Spot> = (0..columns * rows)
        .map(|k| {
            let [u, v] = [k % columns * TILE[0] + TILE[0] / 2, k / columns * TILE[1] + TILE[1] / 2].map(&mut near);
            Spot { u, v, a: 9.0, b: 7.5, phi: 0.4 }
        })
        .collect();
    let height = rough_px / (RAGGED.len() as f64).sqrt();
    // All harmonics alike, and the radius, one number, half as much.
    let of = |m: usize| if m == 0 { height / 2f64.sqrt() } else { height };
    let rims: Vec<Vec<[f64; 2]>> =
        spots.iter().map(|_| RAGGED.map(|m| [(); 2].map(|()| of(m) * random.normal())).collect()).collect();
    let cover = |u: f64, v: f64, h: f64| {
        let tile = |x: f64, size: usize, count: usize| ((x.max(0.0) as usize) / size).min(count - 1);
        let k = tile(v, TILE[1], rows) * columns + tile(u, TILE[0], columns);
        let spot = &spots[k];
        let angle = (v - spot.v).atan2(u - spot.u);
        let wave = |(m, [x, y]): (usize, &[f64; 2])| {
            let (s, c) = (m as f64 * angle).sin_cos();
            x * c + y * s
        };
        let more: f64 = if rough_px > 0.0 { RAGGED.zip(&rims[k]).map(wave).sum() } else { 0.0 };
        Spot { a: spot.a + more, b: spot.b + more, ..*spot }.cover(u, v, h)
    };
    let clean = draw(columns * TILE[0], rows * TILE[1], 0.9, |u, v, h| 45_000.0 - 30_000.0 * cover(u, v, h));
    let grey = clean.noisy_u16(600.0, &mut random);
    let view = GrayView::new(Samples::U16(&grey), clean.width, clean.height, clean.width).unwrap();
    let discs = find_discs(&view, &DetectOptions::default()).unwrap().discs;
    assert_eq!(discs.len(), spots.len());
    let nearest = |spot: &Spot| {
        let off = |disc: &&Disc| (disc.ellipse.center_px.u_px - spot.u).hypot(disc.ellipse.center_px.v_px - spot.v);
        discs.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap().clone()
    };
    spots.iter().map(|spot| (*spot, nearest(spot))).collect()
}

/// What dots say, all together.
struct Told {
    /// Mean z^2 of all numbers.
    z2: f64,
    /// Chi-square of the edge points about the ellipses, over its degrees of freedom.
    chi2: f64,
    /// Mean and spread of the sigmas of edge points, px.
    mean: f64,
    spread: f64,
}

fn told(rough_px: f64, seeds: std::ops::Range<u64>) -> Told {
    let all: Vec<(Spot, Disc)> = seeds.flat_map(|seed| seen(rough_px, seed)).collect();
    let count = all.len() as f64;
    let z2 = all.iter().map(|(spot, disc)| off(spot, disc).1).sum::<f64>() / count;
    let sigma_px = |disc: &Disc| {
        let of = &disc.edge.sigma_px;
        (of.iter().map(|s| s * s).sum::<f64>() / of.len() as f64).sqrt()
    };
    let mean = all.iter().map(|x| sigma_px(&x.1)).sum::<f64>() / count;
    let spread = (all.iter().map(|x| (sigma_px(&x.1) - mean).powi(2)).sum::<f64>() / count).sqrt();
    let squares = |disc: &Disc| -> f64 {
        let points = disc.edge.u_px.iter().zip(&disc.edge.v_px).zip(&disc.edge.sigma_px);
        points.map(|((u, v), sigma)| (disc.ellipse.distance_px(Pixel::new(*u, *v)) / sigma).powi(2)).sum()
    };
    let freedom: f64 = all.iter().map(|x| x.1.edge.sigma_px.len() as f64 - 5.0).sum();
    let chi2 = all.iter().map(|x| squares(&x.1)).sum::<f64>() / freedom;
    println!(
        "rims rough by {rough_px} px: mean z^2 {z2:.3}, chi-square {chi2:.3}, edge points known to {mean:.4} +- {spread:.4} px"
    );
    Told { z2, chi2, mean, spread }
}

/// Taken for roughness, what chance makes of a contour of forty points made sigmas of every second dot too large.
#[test]
fn clean_dots_have_the_sigmas_of_noise_alone() {
    let Told { z2, chi2, mean, spread } = told(0.0, 1..4);
    let by_chance = (2.0 / (5.0 * 3.0 * (DOTS[0] * DOTS[1]) as f64)).sqrt();
    assert!((z2 - 1.0).abs() < 3.5 * by_chance, "{z2}");
    assert!((chi2 - 1.0).abs() < 0.05, "{chi2}");
    assert!(spread < 0.06 * mean, "{spread} of {mean} px");
}

/// Rims rougher than the noise: all dots say so alike, edge points scatter as their sigmas say, and so do whole dots, though the blur takes short waves off
/// a rim and leaves the long ones, which bend an ellipse: taken for as rough in these as in all, dots had a mean z^2 of 2.1.
#[test]
fn rough_rims_are_told_by_all_dots() {
    let [clean, rough] = [0.0, 0.1].map(|rough_px| told(rough_px, 7..9));
    assert!(rough.mean > 1.2 * clean.mean, "{} px, clean ones {}", rough.mean, clean.mean);
    assert!((rough.chi2 - 1.0).abs() < 0.2, "{}", rough.chi2);
    assert!((rough.z2 - 1.0).abs() < 0.15, "{}", rough.z2);
    assert!(rough.spread < 0.09 * rough.mean, "{} of {} px", rough.spread, rough.mean);
}
