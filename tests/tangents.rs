//! Bitangent features through the lens: where they are, how they follow it, and that they need no start at the contours.

#![allow(clippy::unwrap_used, clippy::expect_used)]

mod rig_scene;

use nalgebra::{Vector2, Vector3};
use rig_scene::Scene;
use spivcal::bitangent::circle_features;
use spivcal::bundle::{AdjustOptions, Termination, adjust_tangents, pair_features};
use spivcal::camera::{Camera, INTRINSIC_NAMES, Intrinsics, Radial};
use spivcal::rigid::Motion;

/// A lens that moves the corners of the image by about 25 px.
fn strong(beta: f64, alpha: f64) -> Camera {
    let mut i = *rig_scene::tilted_camera(beta, alpha).intrinsics();
    (i.k, i.aspect) = ([-8.0, 40.0, 0.0], 1.01);
    Camera::new(i).unwrap()
}

fn strong_scene() -> Scene {
    Scene::with_cameras(21, vec![strong(-0.1107, 0.01), strong(0.1107, -0.02)], false, true, false)
}

/// Through the true lens, exact contours give the images of the circles' own features, to the contour's rounding.
#[test]
fn through_the_true_lens_features_are_images_of_the_circles_own() {
    let scene = strong_scene();
    for image in &scene.model.images {
        let camera = &scene.cameras[image.camera];
        let found = pair_features(camera, [&image.discs[0], &image.discs[1]]).unwrap();
        let [l, r0, r1] = scene.truth.shape_mm;
        let own = circle_features(Vector2::zeros(), r0, Vector2::new(l, 0.0), r1).unwrap();
        // The state's poses are seen from the pinholes along the sensor normals.
        let turn: Motion<spivcal::frames::Cam, spivcal::frames::Cam> =
            Motion::new(camera.cam_from_pinhole(), Vector3::zeros());
        let pose = turn * scene.truth.camera_from_first[image.camera] * scene.truth.views[image.view].first_from_target;
        assert!(found.kept.len() >= 12, "{:?}", found.kept);
        assert_eq!(found.whitening.nrows(), 10);
        for (row, &k) in found.kept.iter().enumerate() {
            let p = pose.apply(&Vector3::new(own.points_mm[2 * k], own.points_mm[2 * k + 1], 0.0));
            let q = camera.project_xyz(&p).unwrap();
            let gap = (q.x - found.pixels_px[2 * row]).hypot(q.y - found.pixels_px[2 * row + 1]);
            assert!(gap < 1e-6, "feature {k}: {gap} px");
        }
    }
}

/// The derivative by every intrinsic against central differences of finding the features through another lens.
#[test]
fn features_follow_the_lens_as_their_derivative_says() {
    let scene = strong_scene();
    let image = &scene.model.images[3];
    let discs = [&image.discs[0], &image.discs[1]];
    let camera = &scene.cameras[image.camera];
    let here = pair_features(camera, discs).unwrap();
    let derivative = &here.lens.as_ref().unwrap().derivative;
    let steps = [10.0, 1e-4, 1.0, 1.0, 1e-4, 1e-4, 1e-2, 1.0, 1e2, 1e-4];
    for (k, h) in steps.into_iter().enumerate() {
        let at = |x: f64| {
            let mut p = camera.intrinsics().to_array();
            p[k] += x;
            let moved = Camera::new(Intrinsics::from_array(&p, Radial::IdealToDistorted)).unwrap();
            pair_features(&moved, discs).unwrap()
        };
        let (plus, minus) = (at(h), at(-h));
        assert_eq!(plus.kept, here.kept);
        for i in 0..here.pixels_px.len() {
            let numeric = (plus.pixels_px[i] - minus.pixels_px[i]) / (2.0 * h);
            let gap = (numeric - derivative[(i, k)]).abs() * h;
            assert!(
                gap < 1e-5 + 1e-3 * (numeric * h).abs(),
                "{} on coordinate {i}: {numeric} against {}",
                INTRINSIC_NAMES[k],
                derivative[(i, k)]
            );
        }
    }
}

/// From a start whose lens has no distortion at all, the truth within a few rounds: no slow loop of undistort and refit.
#[test]
fn the_truth_is_found_from_a_lens_without_distortion() {
    let scene = strong_scene();
    let mut start = scene.perturbed_by(5, 0.3);
    start.cameras.iter_mut().for_each(|c| c.k[0] = 0.0);
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let out = adjust_tangents(&scene.model, start, &options, &mut |_| true).unwrap();
    assert_eq!(out.adjustment.termination, Termination::Converged);
    assert!(out.rounds <= 8, "{} rounds", out.rounds);
    assert!(out.adjustment.cost < 1e-6, "cost {}", out.adjustment.cost);
    for (got, truth) in out.adjustment.state.cameras.iter().zip(&scene.cameras) {
        assert!((got.k[0] - truth.intrinsics().k[0]).abs() < 1e-3, "{}", got.k[0]);
    }
}

/// What the features cannot express is refused, not ignored.
#[test]
fn grids_and_estimated_discs_are_refused() {
    let scene = Scene::build(1, false, false, true);
    let refused = adjust_tangents(&scene.model, scene.truth.clone(), &AdjustOptions::default(), &mut |_| true);
    let words = refused.unwrap_err().to_string();
    assert!(words.contains("observations = \"contour\"") && words.contains("adjust = \"points\""), "{words}");
}
