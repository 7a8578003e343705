//! A target carried along the sheet's normal: positions known with a sigma, or not at all.
//!
//! Repeated measurement, fresh noise and freshly drawn positions each time: the scatter is the predicted one.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use rig_scene::{Noise, Scene, TWO_SIDED_995, band, tilted_camera};
use spivcal::bundle::{AdjustOptions, PlanePosition, Termination, ViewPlace, adjust, named_covariance};

const POSITIONS_MM: [f64; 3] = [-4.0, 0.0, 5.0];
const SIGMA_MM: f64 = 0.02;
const RUNS: u64 = 40;

/// Three free views, three along the traverse.
fn scene(scale_by_traverse: bool, known: [PlanePosition; 3]) -> Scene {
    let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
    let mut out = Scene::at_positions(9, cameras, &|v| (v >= 3).then(|| POSITIONS_MM[v - 3]));
    out.model.target.free[0] = scale_by_traverse;
    for k in 0..3 {
        out.model.views[3 + k].place = ViewPlace::InPlane { z_mm: POSITIONS_MM[k], known: known[k] };
    }
    out
}

/// Mean squared z-scores over the runs of: spacing (where it is free), f of both cameras, each estimated position.
fn mean_squares(truth: &Scene) -> Vec<(String, f64)> {
    let mut sums: Vec<(String, f64)> = vec![];
    for seed in 0..RUNS {
        let mut scene = truth.with_noise(seed);
        let mut noise = Noise::new(seed.wrapping_mul(0x9e37_79b9) ^ 0xfeed);
        for view in &mut scene.model.views {
            if let ViewPlace::InPlane { z_mm, known: PlanePosition::About { sigma_mm } } = &mut view.place {
                *z_mm += *sigma_mm * noise.normal();
            }
        }
        for fact in &mut scene.model.facts {
            if let spivcal::bundle::Fact::Intrinsic { value, sigma, .. } = fact {
                *value += *sigma * noise.normal();
            }
        }
        let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
        let out = adjust(&scene.model, scene.perturbed_by(seed, 0.3), &options, &mut |_| true);
        assert_eq!(out.termination, Termination::Converged, "seed {seed}: {}", out.decrement);
        let covariance = named_covariance(&out).unwrap();
        assert_eq!(covariance.nullity, 0);
        let mut all = vec![("target.spacing_mm".to_string(), out.state.shape_mm[0] - truth.truth.shape_mm[0])];
        for (c, name) in ["left", "right"].iter().enumerate() {
            let error = covariance.natural.cameras[c].intrinsics().f_px - truth.cameras[c].intrinsics().f_px;
            all.push((format!("{name}.f_px"), error));
        }
        for k in 0..3 {
            let z = out.state.views[3 + k].plane_from_target.unwrap().translation_mm.z;
            all.push((format!("view{}.plane_z_mm", 3 + k), z - POSITIONS_MM[k]));
        }
        for (name, error) in all {
            let sigma = covariance.sigma(&name).unwrap();
            if sigma == 0.0 {
                continue;
            }
            match sums.iter_mut().find(|(n, _)| *n == name) {
                Some(sum) => sum.1 += (error / sigma).powi(2) / RUNS as f64,
                None => sums.push((name, (error / sigma).powi(2) / RUNS as f64)),
            }
        }
    }
    sums
}

fn within_band(what: &str, means: &[(String, f64)]) {
    let [low, high] = band(RUNS as f64, TWO_SIDED_995);
    for (name, mean) in means {
        println!("{what}: {name} mean z^2 {mean:.3}");
        assert!((low..high).contains(mean), "{what}: {name} mean z^2 {mean}");
    }
}

#[test]
fn steps_with_a_sigma_set_the_scale() {
    let truth = scene(true, [PlanePosition::About { sigma_mm: SIGMA_MM }; 3]);
    let means = mean_squares(&truth);
    assert_eq!(means.len(), 6);
    within_band("scale by steps", &means);
    // The steps' own sigma is the scale's: 9 mm known to 0.02 sqrt(2), less than the three positions allow, more than none.
    let exact = scene(true, [PlanePosition::Exact; 3]);
    let sigma = |s: &Scene| {
        let out = adjust(&s.model, s.truth.clone(), &AdjustOptions::default(), &mut |_| true);
        named_covariance(&out).unwrap().sigma("target.spacing_mm").unwrap() / s.truth.shape_mm[0]
    };
    let (soft, hard) = (sigma(&truth), sigma(&exact));
    let by_steps = (soft * soft - hard * hard).sqrt();
    // Slope of a line through three positions: sigma / sqrt(sum of (z - mean)^2).
    let mean = POSITIONS_MM.iter().sum::<f64>() / 3.0;
    let expected = SIGMA_MM / POSITIONS_MM.iter().map(|z| (z - mean).powi(2)).sum::<f64>().sqrt();
    println!(
        "relative sigma of the scale: {soft:.2e}, exact steps {hard:.2e}; from steps {by_steps:.3e}, expected {expected:.3e}"
    );
    assert!((by_steps / expected - 1.0).abs() < 0.15, "{by_steps} {expected}");
}

#[test]
fn unknown_steps_are_measured() {
    let known = [PlanePosition::Exact, PlanePosition::Unknown, PlanePosition::Unknown];
    let means = mean_squares(&scene(false, known));
    assert_eq!(means.len(), 4);
    within_band("unknown steps", &means);
}
