//! Predicted against sampled: the same rig measured again and again, with fresh noise on every edge point and a fresh
//! draw of everything known beforehand, must scatter about the truth as its covariance says.
//!
//! ```text
//! z      = (estimate - truth) / predicted sigma          sum of z^2 over n runs: chi-square, n degrees of freedom
//! nees   = e^T C^-1 e, e the errors of 8 camera numbers  sum over n runs: chi-square, 8 n degrees of freedom
//! ```
//! Bands hold 95 % for `nees` and 99.5 % for each of the ten single quantities of a rig; `rig_scene/scatter.rs` says what that means.
//! Facts are drawn anew in each run: a prior that always states the truth would make every z too small.
//!
//! `SPIVCAL_MC=400` runs more.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use nalgebra::{DVector, Vector3};
use rig_scene::{Noise, Scene, TWO_SIDED_95, TWO_SIDED_995, band};
use spivcal::bundle::{
    AdjustOptions, Adjustment, NamedCovariance, SolveOptions, State, Termination, adjust, adjust_tangents,
    named_covariance,
};
use spivcal::camera::Camera;
use spivcal::sheet::joint_sheet;

const NAMES: [&str; 2] = ["left", "right"];
const QUANTITIES: [&str; 4] = ["f_px", "effective.cx_px", "effective.cy_px", "k1"];

fn runs() -> u64 {
    std::env::var("SPIVCAL_MC").ok().and_then(|s| s.parse().ok()).unwrap_or(40)
}

/// f, effective principal point, k1 of a camera.
fn numbers(camera: &Camera) -> [f64; 4] {
    let (i, e) = (camera.intrinsics(), camera.effective_pinhole());
    [i.f_px, e.cx_px, e.cy_px, i.k[0]]
}

/// The same as linear functions of the named parameters:
/// `cx_e = cx - f sin b`, `cy_e = cy - aspect f sin a cos b`.
fn rows(name: &str, camera: &Camera) -> Vec<Vec<(String, f64)>> {
    let i = camera.intrinsics();
    let ((sa, ca), (sb, cb)) = (i.alpha_rad.sin_cos(), i.beta_rad.sin_cos());
    let row = |terms: &[(&str, f64)]| terms.iter().map(|(p, v)| (format!("{name}.{p}"), *v)).collect();
    let fa = i.f_px * i.aspect;
    vec![
        row(&[("f_px", 1.0)]),
        row(&[("cx_px", 1.0), ("f_px", -sb), ("beta_rad", -i.f_px * cb)]),
        row(&[("cy_px", 1.0), ("f_px", -i.aspect * sa * cb), ("alpha_rad", -fa * ca * cb), ("beta_rad", fa * sa * sb)]),
        row(&[("k1", 1.0)]),
    ]
}

/// Angle to the baseline and distance of the sheet of the scene as it was built.
fn true_sheet(scene: &Scene) -> [f64; 2] {
    // Solver frames are turned about the projection centres, which changes neither number.
    let plane = scene.truth.first_from_plane.expect("a sheet");
    let n: Vector3<f64> = plane.rotation.column(2).into_owned();
    let second = scene.truth.camera_from_first[1].inverse().translation_mm;
    let distance_mm = n.dot(&plane.translation_mm);
    // The normal away from the first camera.
    [(n * distance_mm.signum()).dot(&second.normalize()).asin(), distance_mm.abs()]
}

/// Fresh noise on the edge points and a fresh draw of the facts.
fn drawn(scene: &Scene, seed: u64) -> Scene {
    let mut spread = Noise::new(seed);
    let mut fresh = || (spread.uniform() * (1u64 << 53) as f64) as u64;
    let with_noise = scene.with_noise(fresh());
    with_noise.with_facts_drawn(&mut Noise::new(fresh()))
}

/// z of each quantity, and the normalised squared error of the eight camera numbers.
fn measure(truth: &Scene, covariance: &NamedCovariance) -> (Vec<f64>, f64) {
    let (mut errors, mut all) = (vec![], vec![]);
    for (c, name) in NAMES.iter().enumerate() {
        let camera = &covariance.natural.cameras[c];
        all.extend(rows(name, camera));
        errors.extend(numbers(camera).iter().zip(numbers(&truth.cameras[c])).map(|(a, b)| a - b));
    }
    let matrix = covariance.propagate(&all);
    let e = DVector::from_vec(errors);
    // Correlation form: f and k1 differ by ten powers of ten in variance.
    let sigma = matrix.diagonal().map(f64::sqrt);
    let z = e.component_div(&sigma);
    let correlation = nalgebra::DMatrix::from_fn(8, 8, |i, j| matrix[(i, j)] / (sigma[i] * sigma[j]));
    let nees = z.dot(&correlation.cholesky().expect("a covariance").solve(&z));
    let plane = covariance.natural.rig_from_plane.expect("a sheet");
    let sheet = joint_sheet(covariance, &plane, Some("right"));
    let [angle, distance] = true_sheet(truth);
    let mut z: Vec<f64> = z.iter().copied().collect();
    z.push((sheet.angle_to_baseline_rad - angle) / sheet.sigmas[9]);
    z.push((sheet.distance_mm - distance) / sheet.sigmas[0]);
    (z, nees)
}

/// The given sigmas are those of the noise: they are not to be scaled.
const OPTIONS: AdjustOptions =
    AdjustOptions { solve: SolveOptions { decrement: 1e-6, iterations: 300 }, rounds: 0, outlier_sigmas: 6.0 };

fn by_contours(scene: &Scene, start: State) -> Adjustment {
    adjust(&scene.model, start, &OPTIONS, &mut |_| true)
}

fn by_tangents(scene: &Scene, start: State) -> Adjustment {
    let out = adjust_tangents(&scene.model, start, &OPTIONS, &mut |_| true).unwrap();
    assert!(out.left_out.is_empty() && out.rounds <= 6, "{} rounds, without {:?}", out.rounds, out.left_out);
    out.adjustment
}

fn sampled_is_predicted(what: &str, truth: &Scene, solve: &dyn Fn(&Scene, State) -> Adjustment) {
    let n = runs();
    let (mut z, mut nees) = (vec![], 0.0);
    for seed in 0..n {
        let scene = drawn(truth, 1000 + seed);
        let out = solve(&scene, scene.perturbed_by(seed, 0.3));
        assert_eq!(out.termination, Termination::Converged, "{what}, seed {seed}: decrement {}", out.decrement);
        let (one, e) = measure(truth, &named_covariance(&out).unwrap());
        // A run far outside (chi-square of 8 exceeds 40 once in 3e5) is a wrong minimum or a wrong covariance: named.
        if e > 40.0 {
            let near = solve(&scene, truth.truth.clone());
            println!("{what}, seed {seed}: squared error {e:.1}, decrement {:.1e}, z {one:.1?}", out.decrement);
            println!("{what}, seed {seed}: cost {:.3}, from the truth {:.3}", out.cost, near.cost);
        }
        z.push(one);
        nees += e;
    }
    let runs = n as f64;
    let names = NAMES.iter().flat_map(|c| QUANTITIES.iter().map(move |q| format!("{c}.{q}")));
    let names: Vec<String> = names.chain(["sheet to baseline".into(), "sheet distance".into()]).collect();
    let mut outside = vec![];
    let [low, high] = band(runs, TWO_SIDED_995);
    for (k, name) in names.iter().enumerate() {
        let mean = z.iter().map(|r| r[k]).sum::<f64>() / runs;
        let square = z.iter().map(|r| r[k] * r[k]).sum::<f64>() / runs;
        println!("{what:9} {name:24} mean z {mean:6.3}, mean z^2 {square:.3} (band {low:.3} to {high:.3})");
        if !(low..=high).contains(&square) || !(mean.abs() < TWO_SIDED_995 / runs.sqrt()) {
            outside.push(format!("{name}: mean z {mean:.3}, mean z^2 {square:.3}"));
        }
    }
    let mean = nees / (8.0 * runs);
    let [low, high] = band(8.0 * runs, TWO_SIDED_95);
    println!("{what:9} normalised squared error / 8: {mean:.3} (band {low:.3} to {high:.3}), {n} runs");
    if !(low..=high).contains(&mean) {
        outside.push(format!("normalised squared error / 8: {mean:.3}, band {low:.3} to {high:.3}"));
    }
    assert!(outside.is_empty(), "{what}: {outside:#?}");
}

#[test]
fn two_discs_of_known_spacing() {
    sampled_is_predicted("two-discs", &Scene::build(21, false, true, false), &by_contours);
}

#[test]
fn bubbles_with_a_known_baseline() {
    sampled_is_predicted("bubbles", &Scene::build(21, true, true, false), &by_contours);
}

/// A lens that moves the corners of the image by 25 px, as features of ellipses fitted to its bent contours would not forgive.
fn strong_lens() -> Scene {
    let camera = |beta: f64, alpha: f64| {
        let mut i = *rig_scene::tilted_camera(beta, alpha).intrinsics();
        i.k[0] = -8.0;
        Camera::new(i).unwrap()
    };
    Scene::with_cameras(21, vec![camera(-0.1107, 0.01), camera(0.1107, -0.02)], false, true, false)
}

#[test]
fn two_discs_by_tangents_through_a_strong_lens() {
    sampled_is_predicted("tangents", &strong_lens(), &by_tangents);
}

/// Contours know a little more than the ten numbers of a pair: how a strong lens bends them off the ellipse. So their estimates and
/// those of the tangents differ by a small part of a sigma, as much as the sigmas say: for an efficient estimate a and another
/// one b, `var(b - a) = var(b) - var(a)`.
#[test]
fn tangents_agree_with_contours_through_a_strong_lens() {
    let truth = strong_lens();
    let (mut squares, mut lost, mut sum, mut count): (f64, f64, Vec<f64>, f64) = (0.0, 0.0, vec![0.0; 8], 0.0);
    for seed in 0..8 {
        let scene = drawn(&truth, 500 + seed);
        let contours = named_covariance(&by_contours(&scene, scene.perturbed_by(seed, 0.3))).unwrap();
        let tangents = named_covariance(&by_tangents(&scene, scene.perturbed_by(seed, 1.0))).unwrap();
        let mut k = 0;
        for (c, name) in NAMES.iter().enumerate() {
            let camera = &contours.natural.cameras[c];
            let all = rows(name, camera);
            let (own, other) = (contours.propagate(&all), tangents.propagate(&all));
            let pair = numbers(camera).into_iter().zip(numbers(&tangents.natural.cameras[c]));
            for (i, (a, b)) in pair.enumerate() {
                let sigma = own[(i, i)].sqrt();
                let ratio = other[(i, i)].sqrt() / sigma;
                assert!((ratio - 1.0).abs() < 0.03, "{name}.{}, seed {seed}: sigmas {ratio}", QUANTITIES[i]);
                squares += ((b - a) / sigma).powi(2);
                lost += ratio * ratio - 1.0;
                sum[k] += (b - a) / sigma;
                k += 1;
            }
        }
        count += 1.0;
    }
    let (rms, means) = ((squares / (8.0 * count)).sqrt(), sum.iter().map(|s| s / count).collect::<Vec<_>>());
    let expected = (lost / (8.0 * count)).sqrt();
    println!("tangents minus contours: rms {rms:.4} sigma, by the sigmas {expected:.4}, means {means:.4?}");
    // 64 numbers, correlated as about 24: chi-square over its degrees of freedom stays between 0.3 and 2.2 (99.9 %).
    assert!((0.3..2.2).contains(&(rms / expected).powi(2)), "rms {rms}, expected {expected}");
    assert!(rms < 0.2 && means.iter().all(|m| m.abs() < 0.1), "rms {rms} sigma, means {means:?}");
}

/// The band refuses what it should: sigmas too small or too large by a fifth.
#[test]
fn the_band_is_narrow_enough() {
    let [low, high] = band(320.0, TWO_SIDED_95);
    // Table values of chi-square with 320 degrees of freedom: 272.3 and 371.4.
    assert!((low - 272.3 / 320.0).abs() < 2e-3 && (high - 371.4 / 320.0).abs() < 2e-3, "{low} {high}");
    assert!(1.0 / (0.8 * 0.8) > high && 1.0 / (1.2 * 1.2) < low);
}
