//! The bundle adjustment on exact synthetic contours: gradient against differences through the retraction, recovery,
//! and sampled against predicted covariance.

#![allow(clippy::unwrap_used, clippy::expect_used)]

mod rig_scene;

use nalgebra::DVector;
use rig_scene::{Scene, tilted_camera};
use spivcal::bundle::{AdjustOptions, Fact, Focus, adjust, named_covariance};
use spivcal::camera::{Camera, Intrinsics};
use spivcal::solve::{Problem, Step, Termination};

#[test]
fn gradient_is_that_of_the_cost() {
    for (per_view, plane, points) in [(false, true, false), (true, true, false), (false, false, true)] {
        let ratio = |c: Camera| {
            let pupil_ratio = if plane { 1.1 } else { 1.0 };
            Camera::new(Intrinsics { pupil_ratio, ..*c.intrinsics() }).unwrap()
        };
        let cameras = vec![ratio(tilted_camera(-0.1107, 0.01)), ratio(tilted_camera(0.1107, -0.02))];
        let mut scene = Scene::with_cameras(1, cameras, per_view, plane, points);
        if plane {
            // A pupil ratio that moves: in the focus relation, too.
            scene.model.cameras.iter_mut().for_each(|c| c.free[9] = true);
            scene.model.facts.extend((0..2).map(|camera| Fact::Intrinsic {
                camera,
                parameter: 9,
                value: 1.1,
                sigma: 0.1,
            }));
            scene.model.facts.extend([Some((50.0, 0.005)), None].iter().enumerate().map(|(camera, distance)| {
                Fact::Focus(Focus { camera, pixel_pitch_mm: 0.00625, tilt_sigma_rad: 2e-4, distance: *distance })
            }));
        }
        let problem = spivcal::bundle::problem(&scene.model);
        let state = scene.perturbed_by(3, 0.1);
        let e = problem.linearise(&state).unwrap();
        let layout = problem.layout();
        let zero = || Step {
            global: DVector::zeros(layout.global),
            blocks: layout.blocks.iter().map(|d| DVector::zeros(*d)).collect(),
        };
        let check = |what: String, set: &dyn Fn(&mut Step, f64), b: f64, h: f64| {
            let at = |x: f64| {
                let mut s = zero();
                set(&mut s, x);
                problem.cost(&problem.retract(&state, &s).unwrap()).unwrap()
            };
            // Step in units of the unknown's own precision; Richardson on central differences.
            let d = |x: f64| (at(x) - at(-x)) / (2.0 * x);
            let numeric = (4.0 * d(0.5 * h) - d(h)) / 3.0;
            assert!(
                (numeric + b).abs() < 2e-5 * b.abs() + 1e-6 / h,
                "{what} ({per_view} {plane} {points}), h {h}: {numeric} against {}; cost {} {} {}",
                -b,
                at(-h),
                at(0.0),
                at(h)
            );
        };
        for i in 0..layout.global {
            let h = 1.0 / e.h_gg[(i, i)].sqrt();
            check(format!("global {i}"), &|s, x| s.global[i] = x, e.b_g[i], h);
        }
        for (v, d) in layout.blocks.iter().enumerate() {
            for i in 0..*d {
                let block = &e.blocks[v];
                let h = 1.0 / block.h_vv[(i, i)].sqrt();
                check(format!("view {v} {i}"), &|s, x| s.blocks[v][i] = x, block.b_v[i], h);
            }
        }
    }
}

#[test]
fn truth_is_recovered_from_exact_contours() {
    let scene = Scene::build(2, false, true, false);
    let out = adjust(&scene.model, scene.perturbed(5), &AdjustOptions::default(), &mut |_| true);
    assert_eq!(out.termination, Termination::Converged);
    assert!(out.decrement < 1e-6);
    assert!(out.cost < 1e-6, "cost {}", out.cost);
    let cov = named_covariance(&out).unwrap();
    assert_eq!(cov.nullity, 0);
    for (got, truth) in cov.natural.cameras.iter().zip(&scene.cameras) {
        for (g, t) in got.intrinsics().to_array().iter().zip(truth.intrinsics().to_array()) {
            assert!((g - t).abs() < 1e-4 * (1.0 + t.abs()), "{g} {t}");
        }
    }
}

/// Normalised squared error of all natural parameters over repeated noise: chi-square with as many degrees of freedom.
#[test]
fn predicted_covariance_is_the_sampled_one() {
    let mut sum = 0.0;
    let mut count = 0.0;
    let truth = Scene::build(4, false, true, false);
    for seed in 0..20 {
        let scene = truth.with_noise(seed);
        let out = adjust(
            &scene.model,
            scene.perturbed(seed),
            &AdjustOptions { rounds: 0, ..Default::default() },
            &mut |_| true,
        );
        assert_eq!(out.termination, Termination::Converged, "seed {seed}: {} after {}", out.decrement, out.iterations);
        let cov = named_covariance(&out).unwrap();

        for c in 0..2 {
            let camera = if c == 0 { "left" } else { "right" };
            for (k, p) in ["f_px", "cx_px", "cy_px", "alpha_rad", "beta_rad", "k1"].iter().enumerate() {
                let index = [0, 2, 3, 4, 5, 6][k];
                let error = cov.natural.cameras[c].intrinsics().to_array()[index]
                    - scene.cameras[c].intrinsics().to_array()[index];
                let z = error / cov.sigma(&format!("{camera}.{p}")).unwrap();
                sum += z * z;
                count += 1.0;
            }
        }
    }
    let mean: f64 = sum / count;
    // The twelve parameters of a run are correlated: the band is that of about 20 x 4 independent numbers.
    assert!((0.6..1.5).contains(&mean), "mean squared z-score {mean}");
}
