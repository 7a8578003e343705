//! Values that the rig file fixes, and a radius that it states: told where they contradict the images, before what they bend; true ones are not.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod rig_scene;

use rig_scene::{Parts, Scene, adjusted, diagnosed, drawn, given_sigmas, tilted_camera};
use spivcal::bundle::{AdjustOptions, Adjustment, Extension, ExtensionTest, Fact, State, adjust, extension_tests};
use spivcal::stats::chi_square_above;

fn parts() -> Parts {
    let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
    let mut parts = Scene::parts(21, cameras, false, true, true);
    parts.offsets_mm.clear();
    parts.target.offset_sigma_mm = None;
    parts
}

/// A scene adjusted with values held that are wrong from the start.
fn held(parts: &Parts, seed: u64, wrong: impl Fn(&mut State)) -> Adjustment {
    let scene = drawn(&parts.scene(), seed);
    let mut start = scene.truth.clone();
    wrong(&mut start);
    adjust(&scene.model, start, &given_sigmas(), &mut |_| true)
}

fn test_of(a: &Adjustment, wanted: Extension) -> ExtensionTest {
    extension_tests(a).unwrap().list.into_iter().find(|t| t.extension == wanted).expect("the test was made")
}

/// In the frame of the sensor's axis, as f is held.
#[test]
fn a_fixed_focal_length_is_tested() {
    let mut parts = parts();
    parts.free[0] = false;
    let wanted = Extension::Intrinsic { camera: 0, parameter: 0 };
    let right = held(&parts, 3, |_| ());
    let t = test_of(&right, wanted);
    println!("right: {} +- {}", t.size, t.sigma);
    assert!(t.size.abs() < 4.0 * t.sigma && chi_square_above(t.statistic, 1.0) > 1e-3);
    assert!(diagnosed(&right).flags.is_empty(), "{:?}", diagnosed(&right).flags);
    // The score follows the tangent at the wrong value, so that the images have to ask for most of the way back.
    let off_px = 12.0 * t.sigma;
    let wrong = held(&parts, 3, |s| s.cameras[0].f_px += off_px);
    let t = test_of(&wrong, wanted);
    println!("wrong: {} +- {}, {:?}", t.size, t.sigma, diagnosed(&wrong).flags);
    assert!((t.size / -off_px - 1.0).abs() < 0.3, "{} {off_px}", t.size);
    // The likelihood ratio of an adjustment with it free, in the same frame.
    let mut model = wrong.model.clone();
    (model.cameras[0].free[0], model.cameras[0].axis_frame) = (true, true);
    let free = adjust(&model, wrong.state.clone(), &given_sigmas(), &mut |_| true);
    let ratio = 2.0 * (wrong.cost - free.cost);
    println!("score {}, likelihood ratio {ratio}, f {}", t.statistic, free.state.cameras[0].f_px);
    assert!((t.statistic / ratio - 1.0).abs() < 0.3, "{} {ratio}", t.statistic);
    let flags = diagnosed(&wrong).flags;
    let first = flags.first().expect("a flag");
    assert!(first.contains("the fixed focal length f of camera left contradicts the images"), "{flags:?}");
}

/// A focal length that is held far off draws axis points to where they were not expected: it goes first, and their rows say so.
#[test]
fn priors_go_after_the_value_that_bends_them() {
    let mut parts = parts();
    parts.free[0] = false;
    let off_px = 0.05 * parts.cameras[0].intrinsics().f_px;
    let found = diagnosed(&held(&parts, 3, |s| s.cameras.iter_mut().for_each(|c| c.f_px += off_px)));
    let after = |words: &String| words.contains("focal length f of camera") && words.contains("goes first");
    let conflicts: Vec<_> = found.diagnosis.priors.iter().filter(|p| p.conflict).collect();
    println!("{:?}\n{:#?}", found.flags, conflicts.iter().map(|p| (&p.words, p.z)).collect::<Vec<_>>());
    assert!(!conflicts.is_empty() && conflicts.iter().all(|p| after(&p.words)), "{conflicts:?}");
    assert!(found.flags.first().is_some_and(|f| f.starts_with("the fixed focal length")), "{:?}", found.flags);
}

/// In the pinhole frame, of which the axis point is two coordinates of its own.
#[test]
fn a_fixed_axis_point_is_tested() {
    let mut parts = parts();
    parts.free[2] = false;
    parts.facts.retain(|f| !matches!(f, Fact::Intrinsic { parameter: 2, .. }));
    let wanted = Extension::Intrinsic { camera: 1, parameter: 2 };
    let right = held(&parts, 5, |_| ());
    assert!(diagnosed(&right).flags.is_empty(), "{:?}", diagnosed(&right).flags);
    let own = test_of(&right, wanted);
    let off_px = 12.0 * own.sigma;
    let wrong = held(&parts, 5, |s| s.cameras[1].cx_px += off_px);
    let t = test_of(&wrong, wanted);
    println!("off by {off_px}: {} +- {}, {:?}", t.size, t.sigma, diagnosed(&wrong).flags);
    // The way back bends: k1 has followed the axis point.
    assert!(t.size < -off_px && t.size < -4.0 * t.sigma, "{} {off_px}", t.size);
    assert!(diagnosed(&wrong).flags.iter().any(|f| f.contains("the fixed axis point cx of camera right")));
}

#[test]
fn a_stated_radius_is_tested() {
    let mut parts = parts();
    parts.target.free[1] = false;
    let wanted = Extension::Radius { parameter: 1 };
    let right = held(&parts, 7, |_| ());
    assert!(diagnosed(&right).flags.is_empty(), "{:?}", diagnosed(&right).flags);
    let wrong = held(&parts, 7, |s| s.shape_mm[1] *= 1.02);
    let t = test_of(&wrong, wanted);
    println!("{} +- {}, {:?}", t.size, t.sigma, diagnosed(&wrong).flags);
    assert!((t.size / (-0.02 * parts.shape_mm[1]) - 1.0).abs() < 0.1, "{}", t.size);
    let flags = diagnosed(&wrong).flags;
    assert!(flags.iter().any(|f| f.contains("the stated radius of the dots contradicts the images")), "{flags:?}");
    // Sigmas that follow the scatter of discs are enlarged for it, and hide what it moves.
    let scene = drawn(&parts.scene(), 7);
    let mut start = scene.truth.clone();
    start.shape_mm[1] *= 1.02;
    let scattered = adjust(&scene.model, start, &AdjustOptions::default(), &mut |_| true);
    let enlarged = scattered.model.images.iter().map(|i| i.sigma_scale).fold(1.0, f64::max);
    let flags = diagnosed(&scattered).flags;
    println!("enlarged {enlarged:.1} times: {flags:?}");
    assert!(enlarged > 10.0 && flags.iter().any(|f| f.contains("the stated radius of the dots contradicts")));
    // Free, it has nothing to be tested.
    parts.target.free[1] = true;
    let free = adjusted(&drawn(&parts.scene(), 7));
    assert!(extension_tests(&free).unwrap().list.iter().all(|t| t.extension != wanted));
}
