//! Discs are found to the Cramer-Rao bound, without bias, with sigmas that are true.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod bubbles_in;
mod detect_table;
mod disc_errors;
mod program;
mod render;
mod share;

use bubbles_in::{bubbles_in, bubbles_text};
use detect_table::{Condition, Light, off};
use disc_errors::{errors_of_discs, errors_of_discs_found};
use program::spivcal;
use rayon::prelude::*;
use render::accuracy::{Case, bound, cases};
use render::{Random, Spot, draw};
use share::share;
use spivcal::detect::{DetectOptions, Smoke, find_discs};
use spivcal::image::{GrayView, Samples};
use spivcal::simulate::Scene;

struct Score {
    bias: [f64; 4],
    over_bound: [f64; 4],
    nees: f64,
    nees_sigma: f64,
    bound: [f64; 4],
}

/// What is known of the root mean square of so many errors, and of the mean square, as a part of it.
fn of_rms(errors: usize) -> f64 {
    0.5 * of_mean_square(errors)
}

fn of_mean_square(errors: usize) -> f64 {
    (2.0 / errors as f64).sqrt()
}

fn run(case: &Case, trials: usize, seed: u64) -> Score {
    let limit = bound(case);
    let mut random = Random(seed);
    let mut errors: Vec<[f64; 4]> = Vec::new();
    let mut nees = 0.0;
    for trial in 0..trials {
        let (spot, image) = case.expose(trial, &mut random);
        let discs = find_discs(&image.view(), &DetectOptions::default()).unwrap().discs;
        assert_eq!(discs.len(), 1, "{}: trial {trial}", case.name);
        let (error, z2) = off(&spot, &discs[0]);
        nees += 5.0 * z2 / trials as f64;
        errors.push(error);
    }
    let n = trials as f64;
    let mut score =
        Score { bias: [0.0; 4], over_bound: [0.0; 4], nees, nees_sigma: (10.0 / n).sqrt(), bound: [0.0; 4] };
    for k in 0..4 {
        let mean = errors.iter().map(|e| e[k]).sum::<f64>() / n;
        let variance = errors.iter().map(|e| (e[k] - mean).powi(2)).sum::<f64>() / (n - 1.0);
        score.bias[k] = mean;
        score.bound[k] = limit[(k, k)].sqrt();
        score.over_bound[k] = (variance / limit[(k, k)]).sqrt();
    }
    score
}

#[test]
fn scatter_reaches_the_bound_and_sigmas_are_true() {
    let cases = cases();
    let trials = 80;
    for (k, case) in cases.iter().enumerate() {
        let s = run(case, trials, 7 + k as u64);
        println!(
            "{:36} scatter/bound u {:.2} v {:.2} a {:.2} b {:.2}   bias px {:+.4} {:+.4} {:+.4} {:+.4}   nees/5 {:.2}",
            case.name,
            s.over_bound[0],
            s.over_bound[1],
            s.over_bound[2],
            s.over_bound[3],
            s.bias[0],
            s.bias[1],
            s.bias[2],
            s.bias[3],
            s.nees / 5.0
        );
        // Sampling: the standard deviation from 80 draws is known to 8 %; a mean over 80 to a ninth of a sigma.
        for j in 0..4 {
            assert!(s.over_bound[j] < 1.3, "{}: parameter {j} at {} times the bound", case.name, s.over_bound[j]);
            let sigma_of_mean = s.bound[j] / (trials as f64).sqrt();
            assert!(s.bias[j].abs() < 0.003 + 3.0 * sigma_of_mean, "{}: bias {} px", case.name, s.bias[j]);
        }
        let mean = s.over_bound[..2].iter().sum::<f64>() / 2.0;
        assert!(mean < 1.1 * (1.0 + 1.7 * 0.056), "{}: centres at {mean} times the bound", case.name);
        // Mean of 80 chi-square numbers of 5 degrees of freedom: 5 +- sqrt(10 / 80).
        assert!((s.nees - 5.0).abs() < 3.5 * s.nees_sigma, "{}: nees {}", case.name, s.nees);
    }
}

/// A few rows of `cargo bench --bench detect_table`.
#[test]
fn the_table_of_conditions_in_short() {
    let rows = [
        (Light::Slanted, 12.0, 8, false),
        (Light::Glare, 15.0, 8, false),
        (Light::Even, 4.0, 16, true),
        (Light::Glare, 40.0, 8, false),
        (Light::Glare, 4.0, 8, false),
        // The skirts of glare are not to pass for smoke: it had been 1.5 times the bound.
        (Light::Glare, 70.0, 8, false),
    ];
    for (k, (light, semi_minor_px, bits, bright)) in rows.into_iter().enumerate() {
        let c = Condition { semi_minor_px, ratio: 1.2, blur_px: 0.8, light, bits, noise: 0.015, bright };
        let (scenes, shots) = (share(8, 3), 10);
        let row = c.run(scenes, shots, 40 + k as u64);
        println!("row {k}: ratio {:.2?} bias {:.4?} z^2 {:.2}", row.ratio, row.bias_px, row.z2);
        assert_eq!(row.found, scenes * shots);
        assert!(row.overall() < 1.15 + 3.5 * of_rms(4 * scenes * shots), "row {k}: {} times the bound", row.overall());
        for j in 0..4 {
            let of_mean = row.bound_px[j] / ((scenes * shots) as f64).sqrt();
            assert!(row.bias_px[j].abs() < 0.005 + 3.5 * of_mean, "row {k}: bias {} px", row.bias_px[j]);
        }
        assert!((0.6..1.6).contains(&row.z2), "row {k}: sigmas are not true, z^2 {}", row.z2);
    }
}

/// Light that rises or bends across a large disc is told by all of it: by the pixels near the edge alone errors in the second row were 1.2 times the bound, and
/// axes 0.0017 px too long.
#[test]
fn light_that_bends_is_told_by_the_whole_disc() {
    for (light, seed) in [(Light::Slanted, 61), (Light::Bent, 62)] {
        let c =
            Condition { semi_minor_px: 40.0, ratio: 1.2, blur_px: 0.8, light, bits: 8, noise: 0.015, bright: false };
        let (scenes, shots) = (20, 10);
        let row = c.run(scenes, shots, seed);
        println!("ratio {:.2?} bias {:.5?} z^2 {:.2}", row.ratio, row.bias_px, row.z2);
        assert_eq!(row.found, scenes * shots);
        // 800 errors: their root mean square is known to 2.5 %.
        assert!(row.overall() < 1.05 + 3.5 * 0.025, "{} times the bound", row.overall());
        for j in 0..4 {
            let of_mean = row.bound_px[j] / ((scenes * shots) as f64).sqrt();
            assert!(row.bias_px[j].abs() < 0.0004 + 3.5 * of_mean, "bias {:?} px", row.bias_px);
        }
        // Five degrees of freedom each: known to 4.5 %.
        assert!((row.z2 - 1.0).abs() < 0.05 + 3.5 * 0.045, "sigmas are not true, z^2 {}", row.z2);
    }
}

/// A spot of glare on the contour of a small disc: waves explain it too, where half the disc is bent for them and the noise inside is ten times that
/// of the ground. One image of these scenes in eight was off by half a pixel, 30 to 60 times the bound; it had been so in one scene of a hundred.
#[test]
fn glare_on_a_small_disc_does_not_pass_for_smoke() {
    let light = Light::Glare;
    for seed in [823, 850, 917] {
        let c = Condition { semi_minor_px: 4.0, ratio: 1.2, blur_px: 0.8, light, bits: 8, noise: 0.015, bright: false };
        let row = c.run(1, 8, seed);
        println!("seed {seed}: ratio {:.2?} z^2 {:.2}", row.ratio, row.z2);
        assert_eq!(row.found, 8);
        // Of 32 errors the root mean square is known to 13 %.
        assert!(row.overall() < 1.25 + 3.5 * 0.13, "seed {seed}: {} times the bound", row.overall());
    }
}

/// The edge of a shadow of 10 % across one of two small dark discs: fields of smoke explained it, and drew centres by ten of their sigmas (0.06 px), mean z^2 of
/// two numbers 100.
#[test]
fn a_shadow_on_a_small_dark_disc_is_not_taken_for_smoke() {
    let mut all = vec![];
    for seed in 0..12 {
        let mut random = Random(300 + seed);
        let [x, y] = [38.0 + random.uniform(), 38.0 + random.uniform()];
        let spots = [x, 115.0].map(|u| Spot { u, v: y, a: 15.0, b: 12.0, phi: 3.0 * random.uniform() });
        let (sin, cos) = (std::f64::consts::TAU * random.uniform()).sin_cos();
        let shade = |u: f64, v: f64| 0.1 / (1.0 + (-0.17 * ((u - x) * cos + (v - y) * sin - 3.6)).exp());
        let clean = draw(153, 76, 0.8, |u, v, h| {
            let cover: f64 = spots.iter().map(|s| s.cover(u, v, h)).sum();
            (178.0 - 153.0 * cover) * (1.0 - shade(u, v))
        });
        let grey = clean.noisy_u8(2.55, &mut random);
        let found = find_discs(&GrayView::new(Samples::U8(&grey), 153, 76, 153).unwrap(), &DetectOptions::default());
        let discs = found.unwrap().discs;
        assert_eq!(discs.len(), 2);
        let disc = discs.iter().find(|d| d.ellipse.center_px.u_px < 76.0).unwrap();
        let off = [disc.ellipse.center_px.u_px - x, disc.ellipse.center_px.v_px - y];
        all.push((0..2).map(|k| off[k] * off[k] / disc.covariance[(k, k)]).sum::<f64>());
    }
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    println!("mean z^2 of two numbers {mean:.1}, {all:.1?}");
    assert!(mean < 8.0, "sigmas are not true, {all:.1?}");
}

/// The smallest discs full of smoke, of which a few dozen pixels say what the light is like and where the edge is: each is fitted with smoke;
/// taken for noise or for something hidden, it would be off by up to ten times the bound.
#[test]
fn the_smallest_discs_full_of_smoke_are_as_accurate_as_can_be() {
    let smoke = Light::Smoke;
    let c =
        Condition { semi_minor_px: 4.0, ratio: 1.2, blur_px: 0.8, light: smoke, bits: 16, noise: 0.015, bright: true };
    let scenes = share(24, 3);
    let row = c.run(scenes, 1, 8);
    println!("smoke: ratio {:.2?} bias {:.4?} z^2 {:.2}", row.ratio, row.bias_px, row.z2);
    assert_eq!(row.found, scenes);
    assert!(row.overall() < 1.1 + 3.0 * of_rms(4 * scenes), "{} times the bound", row.overall());
    assert!(row.z2 < 1.2 + 3.0 * of_mean_square(5 * scenes), "sigmas are not true, z^2 {}", row.z2);
}

/// Smoke that a blur hides: light that is at most slanted explains as much of it as noise lets, with other axes and another blur, and shorter waves than the blur
/// shows are felt at the edge. Mean z^2 had been 5.8 and 2.2.
#[test]
fn smoke_behind_a_blur_is_asked_for() {
    for (semi_minor_px, blur_px, seed) in [(4.0, 1.7, 8), (8.0, 3.0, 17)] {
        let light = Light::Smoke;
        let c = Condition { semi_minor_px, ratio: 1.2, blur_px, light, bits: 16, noise: 0.015, bright: true };
        let mut all = vec![];
        c.show_only(32, seed, |spot, disc| all.extend(disc.map(|disc| off(spot, disc).1)));
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        println!("blur {blur_px}: {} found, mean z^2 {mean:.2}", all.len());
        let most = 1.25 + 3.0 * of_mean_square(5 * all.len());
        assert!(all.len() > 29 && mean < most, "blur {blur_px}: sigmas are not true, z^2 {all:.1?}");
    }
}

/// Weak smoke behind a blur, waves of 10 and 5 % of the light: it says no more than even light, which put places two to five of their sigmas off. Mean z^2 of
/// centres and axes had been 4.2 and 5.3. Where it is known to be there it is 1.5 and 1.1, and sigmas are not far too large where it is not.
#[test]
fn weak_smoke_behind_a_blur_is_reckoned_with() {
    let known = DetectOptions { smoke: Smoke::Full, ..DetectOptions::default() };
    for (options, light, heights, [least, most]) in [
        (&DetectOptions::default(), Light::Smoke, 0.3, [0.0, 3.0]),
        (&DetectOptions::default(), Light::Smoke, 0.15, [0.0, 3.0]),
        (&known, Light::Smoke, 0.3, [0.7, 1.7]),
        (&known, Light::Smoke, 0.15, [0.7, 1.35]),
        (&known, Light::Even, 1.0, [0.4, 1.0]),
    ] {
        let c = Condition { semi_minor_px: 4.0, ratio: 1.2, blur_px: 1.7, light, bits: 16, noise: 0.015, bright: true };
        let of_seed = |seed: u64| {
            let mut all = vec![];
            c.show_together([4, 3], heights, options, seed, |spot, disc| {
                all.extend(disc.map(|disc| off(spot, disc).1))
            });
            all
        };
        let all: Vec<f64> = (80..85).into_par_iter().flat_map_iter(of_seed).collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let known = options.smoke == Smoke::Full;
        println!("{heights} of the smoke, known {known}: {} found, mean z^2 {mean:.2}", all.len());
        assert!(all.len() > 57 && (least..most).contains(&mean), "sigmas are not true, z^2 {all:.1?}");
    }
}

/// A bright disc in even light behind a blur: who says that it is full of smoke gets the sigmas of a disc that may be, from the program as well. It asks
/// those who do not say.
#[test]
fn the_program_may_be_told_of_smoke() {
    let spot = Spot { u: 30.3, v: 29.8, a: 4.8, b: 4.0, phi: 0.4 };
    let clean = draw(60, 60, 1.7, |u, v, h| 6000.0 + 30_000.0 * spot.cover(u, v, h));
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let grey = clean.noisy_u16(450.0, &mut Random(4));
    let image = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(60, 60, grey).unwrap();
    image.save(at("disc.png")).unwrap();
    let sigma_px = |smoke: &[&str]| {
        let done = spivcal(&[&["detect", &at("disc.png"), "-o", &at("out")], smoke].concat());
        let said = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(0), "{said}");
        assert_eq!(said.contains("1 bright disc(s): if they are bubbles"), smoke.is_empty(), "{said}");
        let text = std::fs::read_to_string(at("out/disc_discs.csv")).unwrap();
        let column = text.lines().next().unwrap().split(',').position(|name| name == "sigma_u_px").unwrap();
        text.lines().nth(1).unwrap().split(',').nth(column).unwrap().parse::<f64>().unwrap()
    };
    let [unknown, known] = [sigma_px(&[]), sigma_px(&["--smoke"])];
    println!("sigma of the centre {unknown:.4} px, {known:.4} px in smoke");
    assert!(known > 1.2 * unknown && known < 4.0 * unknown, "{known} and {unknown} px");
}

/// Twelve small discs of one image, which tell the noise together, do not take smoke for it: they would be off by twice what their sigmas say.
#[test]
fn many_discs_full_of_smoke_do_not_pass_for_noise() {
    let light = Light::Bubble;
    let c = Condition { semi_minor_px: 4.0, ratio: 1.2, blur_px: 0.8, light, bits: 16, noise: 0.015, bright: true };
    let mut all = vec![];
    for seed in 70..72 {
        c.show_together([4, 3], 1.0, &DetectOptions::default(), seed, |spot, disc| {
            all.push(off(spot, disc.expect("a disc")).1)
        });
    }
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    println!("mean z^2 {mean:.2}");
    assert!(mean < 1.1 + 3.0 * of_mean_square(5 * all.len()), "sigmas are not true, z^2 {all:.1?}");
}

/// Light that rises across a disc behind a blur is not asked for smoke, which would make the sigmas of the axes a third larger.
#[test]
fn light_that_rises_is_not_taken_for_smoke() {
    let light = Light::Slanted;
    let c = Condition { semi_minor_px: 4.0, ratio: 1.2, blur_px: 1.7, light, bits: 8, noise: 0.015, bright: false };
    let mut sigmas = [0.0; 4];
    let scenes = 24;
    let bound = c.show(scenes, 1, 8, |_, _, disc| {
        let disc = disc.expect("a disc");
        (0..4).for_each(|k| sigmas[k] += disc.covariance[(k, k)] / scenes as f64);
    });
    let over: [f64; 4] = std::array::from_fn(|k| sigmas[k].sqrt() / bound[k]);
    println!("sigmas over the bound {over:.2?}");
    assert!(over.iter().all(|x| (0.95..1.15).contains(x)), "{over:.2?}");
}

/// Smoke that varies slowly over large discs, little and much noise: the slope of the light at the edge must neither be held to that of a surface
/// nor be thought known as often as there are nodes. Then mean z^2 was 4 to 13.
#[test]
fn sigmas_are_true_in_large_discs_full_of_haze() {
    for (noise, most) in [(0.0015, 2.3), (0.015, 1.35)] {
        let (semi_minor_px, light) = (40.0, Light::Haze);
        let c = Condition { semi_minor_px, ratio: 1.2, blur_px: 0.8, light, bits: 16, noise, bright: true };
        let (scenes, shots) = (share(16, 4), 2);
        let row = c.run(scenes, shots, 20);
        println!("noise {noise}: ratio {:.2?} bias {:.5?} z^2 {:.2}", row.ratio, row.bias_px, row.z2);
        assert_eq!(row.found, scenes * shots);
        // Errors of one scene are alike.
        assert!(row.z2 < 1.2 + 3.0 * of_mean_square(5 * scenes), "sigmas are not true, z^2 {}", row.z2);
        assert!(row.overall() < most, "{} times the bound", row.overall());
    }
}

/// Large discs in smoke whose waves are as long as the disc is wide: waves follow it, for nodes along the contour had 1.5 times the bound.
#[test]
fn large_discs_full_of_slow_smoke_are_as_accurate_as_can_be() {
    let (semi_minor_px, light) = (40.0, Light::Smoke);
    let c = Condition { semi_minor_px, ratio: 1.2, blur_px: 0.8, light, bits: 16, noise: 0.015, bright: true };
    let scenes = share(16, 4);
    let row = c.run(scenes, 1, 30);
    println!("smoke: ratio {:.2?} bias {:.4?} z^2 {:.2}", row.ratio, row.bias_px, row.z2);
    assert_eq!(row.found, scenes);
    assert!(row.overall() < 1.05 + 2.5 * of_rms(4 * scenes), "{} times the bound", row.overall());
    assert!((0.5..1.1 + 3.0 * of_mean_square(5 * scenes)).contains(&row.z2), "sigmas are not true, z^2 {}", row.z2);
}

/// Bubbles of 5 to 15 px (`divisor` 12), or of 60 to 180 px, full of smoke, as the simulator renders them: light carries shot noise that the ground does not
/// show, and smoke has waves of all lengths.
fn sigmas_of_bubbles_are_true(divisor: f64, length_mm: f64) {
    // Eight views, the first of a printed plate.
    let errors = errors_of_discs(&smaller_bubbles(divisor, length_mm), 8 - share(7, 2));
    let count = errors.len() as f64;
    let z2: [f64; 4] = std::array::from_fn(|k| errors.iter().map(|e| (e[k].0 / e[k].1).powi(2)).sum::<f64>() / count);
    println!("radii over {divisor}, smoke of {length_mm} mm: mean z^2 of {count} discs {z2:.2?}");
    // Both cameras see the same smoke: about as many independent errors as bubbles.
    let limit = 1.0 + 4.0 * (2.0 / (0.5 * count)).sqrt();
    assert!(z2.iter().all(|x| *x < limit), "{z2:?} above {limit}");
    assert!(z2.iter().sum::<f64>() > 4.0 * 0.4, "sigmas are too large, mean z^2 {z2:?}");
}

#[test]
fn sigmas_are_true_in_small_bubbles_full_of_slow_smoke() {
    sigmas_of_bubbles_are_true(12.0, 1.5);
}

#[test]
fn sigmas_are_true_in_small_bubbles_full_of_quick_smoke() {
    sigmas_of_bubbles_are_true(12.0, 0.5);
}

/// Wisps of smoke are candidates by dozens: beside them smoke passed for noise that neighbours share, and mean z^2 was 0.1 0.1 0.1 0.8.
#[test]
fn sigmas_are_true_in_large_bubbles_full_of_slow_smoke() {
    sigmas_of_bubbles_are_true(1.0, 2.0);
}

/// What is not known of the blur moves the flat sides outwards together: spread evenly over edge points it left the semi-minor axis with a mean z^2 of 3.
#[test]
fn sigmas_are_true_in_large_bubbles_full_of_quick_smoke() {
    sigmas_of_bubbles_are_true(1.0, 0.7);
}

/// The brighter a stretch of the contour by noise, the more it weighed and the further out it lay: in smoke with waves of 4 to 40 px semi-minor axes came out
/// 9.4 +- 1.3 mpx too long.
#[test]
fn bright_smoke_draws_no_contour_outwards() {
    let scene = random_bubbles(7, share(8, 2), [8.0, 14.0], 0.9, (0.3, 0.7));
    let errors = errors_of_discs(&scene, 0);
    let mean = |k: usize| errors.iter().map(|e| e[k].0).sum::<f64>() / errors.len() as f64;
    println!("axes of {} discs too long by {:.4} and {:.4} px", errors.len(), mean(2), mean(3));
    assert!(mean(2).abs() < 0.004 && mean(3).abs() < 0.004, "axes are off by {} and {} px", mean(2), mean(3));
}

/// Errors and mean z^2 of discs whose smoke nobody tells of, and of the same where it is known.
fn smoke_untold_and_known(scene: &Scene) -> [(f64, f64); 2] {
    let known = DetectOptions { smoke: Smoke::Full, ..DetectOptions::default() };
    [DetectOptions::default(), known].map(|options| {
        let errors = errors_of_discs_found(scene, 0, &options);
        let mean =
            |of: &dyn Fn(&(f64, f64)) -> f64| errors.iter().flatten().map(of).sum::<f64>() / (4 * errors.len()) as f64;
        let [rms, z2] = [mean(&|(error, _)| error * error).sqrt(), mean(&|(error, sigma)| (error / sigma).powi(2))];
        println!(
            "smoke known: {}; {} discs, rms {:.1} mpx, mean z^2 {z2:.2}",
            options.smoke == Smoke::Full,
            errors.len(),
            1e3 * rms
        );
        (rms, z2)
    })
}

/// Of the errors of those whose smoke nobody tells of at most so much is left where it is known, and sigmas are true.
fn telling_of_smoke_helps(scene: &Scene, most_left: f64) {
    let [before, now] = smoke_untold_and_known(scene);
    assert!(now.0 < most_left * before.0, "errors of {:.4} px, {:.4} px where smoke is not known", now.0, before.0);
    assert!(
        now.1 < before.1 && (0.4..1.4).contains(&now.1),
        "mean z^2 {:.2}, {:.2} where smoke is not known",
        now.1,
        before.1
    );
}

/// Bubbles of 20 to 66 px behind a blur, in smoke with waves of 8 to 80 px: light at nodes was held too tightly, and the mean z^2 of 72 such discs was 1.6 1.4 1.6 1.7.
/// Where smoke is known slopes are held more loosely, and errors are smaller, too.
#[test]
fn known_smoke_that_changes_fast_is_held_loosely() {
    telling_of_smoke_helps(&random_bubbles(500, share(6, 2), [2.4, 4.5], 1.68, (0.37, 1.3)), 0.95);
}

/// The same in smoke with waves of 2 to 30 semi-axes: noise hides from a polynomial what it leaves, and contours moved by more than their sigmas.
#[test]
fn known_smoke_that_changes_slowly_is_no_polynomial() {
    telling_of_smoke_helps(&random_bubbles(600, share(6, 2), [2.4, 4.5], 1.68, (0.3, 20.0)), 0.8);
}

/// Bubbles of 3 to 10 px in smoke with waves longer than they are wide, and in weak smoke of which a disc shows little more than a slope: such light was taken
/// for plain light under louder noise, or for even light, and axes were off by up to 20 sigmas, with a mean z^2 of up to 13.
#[test]
fn sigmas_are_true_in_the_smallest_bubbles() {
    for smoke in [(0.3, 1.0), (0.15, 2.0)] {
        let errors = errors_of_discs(&random_bubbles(52, share(10, 3), [0.3, 0.7], 0.9, smoke), 0);
        let z = |e: &[(f64, f64); 4], k: usize| (e[k].0 / e[k].1).abs();
        let z2: [f64; 4] =
            std::array::from_fn(|k| errors.iter().map(|e| z(e, k).powi(2)).sum::<f64>() / errors.len() as f64);
        let worst = errors.iter().flat_map(|e| (0..4).map(|k| z(e, k))).fold(0.0, f64::max);
        println!("smoke {smoke:?}: mean z^2 of {} discs {z2:.2?}, at most {worst:.1} sigmas", errors.len());
        // Both cameras see the same smoke: about as many independent errors as bubbles.
        let limit = 1.0 + 4.0 * (2.0 / (0.5 * errors.len() as f64)).sqrt();
        assert!(z2.iter().all(|x| *x < limit), "{z2:?} above {limit}");
        assert!(z2.iter().sum::<f64>() > 4.0 * 0.5, "sigmas are too large, mean z^2 {z2:?}");
        assert!(worst < 5.0, "one is off by {worst} sigmas");
    }
}

/// Weak smoke behind a blur shows no more than a slope, or a slope and a few pixels that something may hide: so one was off by 8 sigmas, one by 5.
#[test]
fn weak_smoke_behind_a_blur_is_no_plain_light() {
    let line = |line: &str| match line.split(" = ").next() {
        Some("blur_sigma_px") => "blur_sigma_px = 1.5".to_string(),
        Some(key @ ("radii_mm" | "spacing_mm")) => {
            let part = if key == "radii_mm" { 16.0 } else { 4.0 };
            let number = |x: &str| x.trim_matches(['[', ']', ' ']).parse::<f64>().unwrap() / part;
            let numbers: Vec<f64> = line.split(" = ").nth(1).unwrap().split(',').map(number).collect();
            if key == "radii_mm" { format!("{key} = {numbers:?}") } else { format!("{key} = {:?}", numbers[0]) }
        }
        _ => line.to_string(),
    };
    let text: Vec<String> = bubbles_text(91, [0.15, 2.0, 0.2]).lines().map(line).collect();
    let small = Scene::parse(&text.join("\n"), "scene.toml").unwrap();
    for scene in [small, random_bubbles(52, 2, [0.35, 0.75], 1.5, (0.15, 2.0))] {
        let errors = errors_of_discs(&scene, 0);
        let worst = errors.iter().flatten().map(|(error, sigma)| (error / sigma).abs()).fold(0.0, f64::max);
        println!("{} discs, at most {worst:.1} sigmas", errors.len());
        assert!(worst < 4.7, "one is off by {worst} sigmas");
    }
}

/// Light that is uneven by a twentieth over the image bends by less than a large disc is sure to show: taken for light that does not bend, it moved the
/// ends of the contour, and the mean z^2 of the semi-major axis was 1.5.
#[test]
fn light_that_hardly_bends_moves_no_contour() {
    let errors: Vec<[(f64, f64); 4]> = (100..100 + share(6, 3) as u64)
        .flat_map(|seed| errors_of_discs(&bubbles_in(seed, [0.0, 6.0, 0.05]), 0))
        .collect();
    let count = errors.len() as f64;
    let z2: [f64; 4] = std::array::from_fn(|k| errors.iter().map(|e| (e[k].0 / e[k].1).powi(2)).sum::<f64>() / count);
    println!("mean z^2 of {count} discs {z2:.2?}");
    // Every disc has noise of its own: three standard deviations.
    let limit = 1.0 + 3.0 * (2.0 / count).sqrt();
    assert!(z2.iter().all(|x| (0.6..limit).contains(x)), "{z2:?} above {limit}");
}

/// Bubbles before the cameras of `examples/bubbles`, of radii in mm, full of smoke, its share of the light and the length of its waves in mm.
fn random_bubbles(
    seed: u32,
    views: usize,
    [least, most]: [f64; 2],
    blur_px: f64,
    (smoke, length_mm): (f64, f64),
) -> Scene {
    let text = include_str!("../examples/bubbles/scene.toml");
    let cameras = text.split("[target]").next().unwrap().replace("seed = 10", &format!("seed = {seed}"));
    let bubbles =
        "[target]\nkind = \"bubbles\"\npolarity = \"bright\"\n[image]\nfull_well_e = 10000\nread_noise_e = 20\n";
    let light = format!("blur_sigma_px = {blur_px:?}\nsmoke = {smoke:?}\nsmoke_length_mm = {length_mm:?}\n");
    let poses = format!(
        "[random]\ncount = {views}\nsheet_count = 0\ntilt_deg = [15, 15]\nposition_mm = [6, 4, 2]\n\
         radii_mm = [[{least:?}, {most:?}], [{least:?}, {most:?}]]\nspacing_mm = [{:?}, {:?}]\n[rig]\nscale = \"baseline\"\n",
        2.2 * most,
        2.5 * most
    );
    Scene::parse(&[&cameras, bubbles, &light, &poses].concat(), "scene.toml").unwrap()
}

/// `examples/bubbles` with its bubbles made smaller.
fn smaller_bubbles(divisor: f64, smoke_length_mm: f64) -> Scene {
    let text = include_str!("../examples/bubbles/scene.toml");
    let line = |line: &str| match line.strip_prefix("radii_mm = [").and_then(|x| x.strip_suffix(']')) {
        Some(pair) => {
            let radii: Vec<f64> = pair.split(',').map(|x| x.trim().parse::<f64>().unwrap() / divisor).collect();
            format!("radii_mm = {radii:?}")
        }
        None if line.starts_with("smoke_length_mm") => format!("smoke_length_mm = {smoke_length_mm:?}"),
        None => line.to_string(),
    };
    Scene::parse(&text.lines().map(line).collect::<Vec<_>>().join("\n"), "scene.toml").unwrap()
}

/// Noise as neighbours share it after interpolated colours, compression or resampling: each pixel the mean of a few, and for comparison noise of
/// its own. Sigmas of independent pixels would have z^2 of 2 to 5.
#[test]
fn sigmas_are_true_where_neighbours_share_noise() {
    const SIDE: usize = 12;
    const PITCH: usize = 40;
    let size = SIDE * PITCH;
    let mut random = Random(31);
    let mut at = |i: usize| (i * PITCH) as f64 + 19.0 + random.uniform();
    let spots: Vec<Spot> =
        (0..SIDE * SIDE).map(|k| Spot { u: at(k % SIDE), v: at(k / SIDE), a: 8.0, b: 6.7, phi: 0.4 }).collect();
    let clean = draw(size, size, 0.9, |u, v, h| {
        let near = |x: f64| ((x / PITCH as f64) as usize).min(SIDE - 1);
        220.0 - 150.0 * spots[near(v.max(0.0)) * SIDE + near(u.max(0.0))].cover(u, v, h)
    });
    for (kernel, limits) in
        [(&[1.0][..], 0.8..1.2), (&[1.0, 2.0, 1.0], 0.8..1.25), (&[1.0, 3.0, 4.0, 3.0, 1.0], 0.8..1.25)]
    {
        let (mut sum, mut count) = (0.0, 0.0);
        for _ in 0..3 {
            let noise = shared_noise(size, kernel, &mut random);
            let grey: Vec<u8> =
                clean.grey.iter().zip(noise).map(|(g, n)| (g + 3.0 * n).round().clamp(0.0, 255.0) as u8).collect();
            let view = GrayView::new(Samples::U8(&grey), size, size, size).unwrap();
            let discs = find_discs(&view, &DetectOptions::default()).unwrap().discs;
            assert_eq!(discs.len(), SIDE * SIDE);
            for d in &discs {
                let e = &d.ellipse;
                let near = |x: f64| x as usize / PITCH;
                let spot = &spots[near(e.center_px.v_px) * SIDE + near(e.center_px.u_px)];
                let off = [
                    e.center_px.u_px - spot.u,
                    e.center_px.v_px - spot.v,
                    e.semi_major_px - spot.a,
                    e.semi_minor_px - spot.b,
                ];
                sum += (0..4).map(|i| off[i] * off[i] / d.covariance[(i, i)]).sum::<f64>();
                count += 4.0;
            }
        }
        println!("mean of {} pixels along u and v: z^2 {:.2}", kernel.len(), sum / count);
        assert!(limits.contains(&(sum / count)), "mean of {} pixels: z^2 {}", kernel.len(), sum / count);
    }
}

/// White noise through a filter along u and v, variance 1.
fn shared_noise(size: usize, kernel: &[f64], random: &mut Random) -> Vec<f64> {
    let norm = kernel.iter().map(|k| k * k).sum::<f64>().sqrt();
    let mut noise: Vec<f64> = (0..size * size).map(|_| random.normal()).collect();
    for step in [1, size] {
        let at = |i: usize, k: usize| (i + k * step) % (size * size);
        noise = (0..size * size)
            .map(|i| kernel.iter().enumerate().map(|(k, w)| w / norm * noise[at(i, k)]).sum())
            .collect();
    }
    noise
}
