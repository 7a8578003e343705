//! Tilt, axis point and their covariance when distortion goes to zero: without it a tilted camera is a pinhole along its sensor
//! normal, and tilt and axis point are told by nothing but priors.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use rig_scene::{Parts, Problem, band, given_sigmas};
use spivcal::bundle::{Fact, NamedCovariance, Termination, adjust, named_covariance};
use spivcal::camera::{Camera, Intrinsics};
use spivcal::sheet::{SheetUncertainty, joint_sheet};

const LEFT_RIGHT: [&str; 2] = ["left", "right"];
const AXIS: [&str; 4] = ["cx_px", "cy_px", "alpha_rad", "beta_rad"];
const SWEEP: [f64; 8] = [0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 3e-2, 0.1];

/// Reference A with another distortion in both cameras.
fn distorted(k1: f64) -> Parts {
    let mut parts = Problem::of("A").unwrap().parts;
    parts.cameras.iter_mut().for_each(|c| {
        let i = *c.intrinsics();
        *c = Camera::new(Intrinsics { k: [k1, 0.0, 0.0], ..i }).unwrap();
    });
    parts
}

/// Nothing known of the axis points.
fn without_priors(mut parts: Parts) -> Parts {
    parts.facts.retain(|f| !matches!(f, Fact::Intrinsic { .. }));
    parts
}

fn covariance(parts: &Parts) -> NamedCovariance {
    let scene = parts.scene();
    let out = adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true);
    assert!(out.cost < 1e-9 && out.decrement.is_finite(), "cost {}", out.cost);
    named_covariance(&out).unwrap()
}

/// Sigmas of f_e, cx_e, cy_e and of the sheet's angle to the baseline and the gain: what does not need the lens axis.
fn immune(c: &NamedCovariance) -> [f64; 3] {
    let sheet = joint_sheet(c, &c.natural.rig_from_plane.unwrap(), Some("right"));
    let at = SheetUncertainty::of(c, LEFT_RIGHT).unwrap().at([0.0, 0.0]).unwrap();
    [sheet.sigmas[9], at.relative_gain().expect("gain"), at.disparity_px().expect("disparity")]
}

fn finite(c: &NamedCovariance) {
    assert!(c.matrix.iter().all(|x| x.is_finite()), "no NaN");
    assert!((0..c.names.len()).all(|i| c.matrix[(i, i)] >= 0.0), "no negative variance");
}

#[test]
fn without_distortion_and_priors_the_null_space_is_exact() {
    for k1_free in [true, false] {
        let mut parts = without_priors(distorted(0.0));
        parts.free[6] = k1_free;
        let c = covariance(&parts);
        finite(&c);
        assert_eq!(c.nullity, 4, "two per camera, k1 free: {k1_free}");
        for camera in LEFT_RIGHT {
            for name in AXIS.iter().chain(&["f_px"]) {
                assert_eq!(c.sigma(&format!("{camera}.{name}")), None, "{camera}.{name}");
            }
            assert!(
                c.undetermined.iter().any(|w| w.contains("tilt beta") && w.contains(camera)),
                "{:?}",
                c.undetermined
            );
        }
        let [angle, gain, disparity] = immune(&c);
        println!("k1 free {k1_free}: angle {angle:.2e} rad, gain {gain:.2e}, disparity {disparity:.2e} px");
        assert!(angle.is_finite() && angle > 0.0 && angle < 1e-3, "{angle}");
        assert!(gain > 0.0 && gain < 1e-3 && disparity > 0.0 && disparity < 0.05);
        // The plane's place in the lens frame needs the lens axis.
        let sheet = joint_sheet(&c, &c.natural.rig_from_plane.unwrap(), Some("right"));
        assert!(sheet.sigmas[7].is_nan(), "theta 2 has no sigma");
    }
}

/// Without priors the axis point is told by the distortion alone: its sigma grows as 1 / k1, until it is called undetermined.
#[test]
fn confidence_in_the_axis_point_fades_with_the_distortion() {
    let mut last = f64::INFINITY;
    let mut products = vec![];
    for k1 in SWEEP {
        let c = covariance(&without_priors(distorted(k1)));
        finite(&c);
        let sigmas: Vec<Option<f64>> =
            LEFT_RIGHT.iter().flat_map(|n| AXIS.map(|a| c.sigma(&format!("{n}.{a}")))).collect();
        println!("k1 {k1:.0e}: nullity {}, axis and tilt {sigmas:?}", c.nullity);
        let known = sigmas.iter().flatten().count();
        assert_eq!(c.nullity == 0, known == 8, "all or none of a camera");
        assert!(immune(&c).iter().all(|s| s.is_finite()));
        if let Some(cx) = sigmas[0] {
            assert!(cx < last, "more distortion, less sigma");
            last = cx;
            products.push(cx * k1);
        } else {
            assert!(k1 < 1e-3, "k1 = {k1} is felt");
        }
    }
    assert!(products.len() >= 4);
    for p in &products {
        assert!((p / products[0] - 1.0).abs() < 0.2, "sigma times k1: {products:?}");
    }
}

/// With priors nothing is undetermined; at zero distortion the axis point is known from its prior and from nothing else.
#[test]
fn priors_hold_what_distortion_does_not_tell() {
    for k1 in SWEEP {
        let c = covariance(&distorted(k1));
        finite(&c);
        assert_eq!(c.nullity, 0);
        for name in LEFT_RIGHT {
            for axis in ["cx_px", "cy_px"] {
                let s = c.sigma(&format!("{name}.{axis}")).unwrap();
                assert!(s <= 102.4 * (1.0 + 1e-6), "{name}.{axis} {s}");
                if k1 <= 1e-4 {
                    assert!(s > 102.3, "{name}.{axis} at k1 = {k1}: {s}, no more is known than before");
                    let words = format!("axis point {} of camera {name} is known only from its prior", &axis[..2]);
                    assert!(c.undetermined.contains(&words), "{words}: {:?}", c.undetermined);
                }
            }
            // The tilt follows the axis point: 102.4 px of 8889 px.
            let beta = c.sigma(&format!("{name}.beta_rad")).unwrap();
            if k1 <= 1e-4 {
                assert!((beta * 8889.0 / 102.4 - 1.0).abs() < 0.05, "beta {beta}");
            }
        }
        assert!(immune(&c).iter().all(|s| s.is_finite()));
    }
}

/// Sampled: tilts and axis points of repeated measurements scatter as predicted, at zero distortion and near it.
#[test]
fn sampled_tilt_and_axis_point_are_the_predicted_ones() {
    let runs: u64 = std::env::var("SPIVCAL_MC").ok().and_then(|s| s.parse().ok()).unwrap_or(40);
    for k1 in [0.0, 1e-3, 0.1] {
        let problem = Problem::made_of("zero distortion", distorted(k1));
        let bound = covariance(&problem.parts);
        let mut sum = [0.0; 8];
        for seed in 0..runs {
            let draw = problem.draw(40_000 + seed);
            let out = adjust(&draw.scene.model, draw.scene.perturbed_by(seed, 0.3), &given_sigmas(), &mut |_| true);
            assert_eq!(out.termination, Termination::Converged, "k1 {k1}, seed {seed}: {:.1e}", out.decrement);
            let got = named_covariance(&out).unwrap();
            finite(&got);
            for (c, name) in LEFT_RIGHT.iter().enumerate() {
                let (e, t) =
                    (got.natural.cameras[c].intrinsics().to_array(), problem.parts.cameras[c].intrinsics().to_array());
                for (k, axis) in AXIS.iter().enumerate() {
                    let z = (e[2 + k] - t[2 + k]) / bound.sigma(&format!("{name}.{axis}")).unwrap();
                    sum[4 * c + k] += z * z;
                }
            }
        }
        // Eight quantities pass together: 99.9 % each.
        let [low, high] = band(runs as f64, 3.290527);
        let means = sum.map(|s| s / runs as f64);
        println!("k1 {k1}: mean z^2 {means:.3?}, band {low:.3} to {high:.3}");
        assert!(means.iter().all(|m| (low..=high).contains(m)), "k1 {k1}: {means:?}");
    }
}
