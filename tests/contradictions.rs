//! What contradicts itself is named: a mirrored camera, images exchanged between cameras or views, views marked as in the sheet that are
//! not. Exact contours with noise, without any seed.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use nalgebra::Vector3;
use rig_scene::{Scene, tilted_camera};
use spivcal::bundle::{AdjustOptions, PlanePosition, ViewPlace};
use spivcal::error::{Error, Insufficient};
use spivcal::rig::{RigProblem, calibrate_rig};
use spivcal::rigid::{Motion, rotation_exp};

fn refused(problem: &RigProblem) -> String {
    match calibrate_rig(problem, &AdjustOptions::default(), &mut |_| true) {
        Err(Error::Insufficient(Insufficient::Inconsistent(words))) => words,
        Err(other) => panic!("another refusal: {other}"),
        Ok(s) => panic!("not refused, cost {}", s.adjustment.cost),
    }
}

#[test]
fn a_mirrored_camera_is_refused_as_mirrored() {
    for (per_view, points) in [(false, false), (true, false)] {
        let mut scene = Scene::build(13, per_view, !points, points).with_noise(1);
        for edge in
            scene.model.images.iter_mut().filter(|i| i.camera == 1).flat_map(|i| &mut i.discs).map(|d| &mut d.edge)
        {
            edge.u_px.iter_mut().for_each(|u| *u = 1023.0 - *u);
        }
        let words = refused(&scene.problem());
        assert!(words.contains("mirrored") && words.contains("\"right\""), "{words}");
    }
}

/// Scenes of printed pairs, bubbles and a grid, two views in the sheet where there is one.
fn scenes(seed: u64) -> [Scene; 3] {
    [(false, true, false), (true, true, false), (false, false, true)]
        .map(|(per_view, plane, points)| Scene::build(seed, per_view, plane, points).with_noise(seed))
}

#[test]
fn images_of_one_camera_exchanged_between_views_are_named() {
    for [a, b] in [[1, 3], [0, 2], [2, 5]] {
        for mut scene in scenes(14) {
            for image in scene.model.images.iter_mut().filter(|i| i.camera == 1) {
                image.view = if image.view == a {
                    b
                } else if image.view == b {
                    a
                } else {
                    image.view
                };
            }
            let words = refused(&scene.problem());
            assert!(words.contains(&format!("between the view(s) {a}, {b} ")), "{words}");
        }
    }
}

#[test]
fn cameras_exchanged_in_views_are_named() {
    for views in [&[0][..], &[3], &[5], &[1, 4]] {
        for mut scene in scenes(15) {
            for image in scene.model.images.iter_mut().filter(|i| views.contains(&i.view)) {
                image.camera = 1 - image.camera;
            }
            let words = refused(&scene.problem());
            let named: Vec<String> = views.iter().map(usize::to_string).collect();
            assert!(words.contains(&format!("exchanged in view(s) {} ", named.join(", "))), "{words}");
        }
    }
}

/// An image of another moment, which no exchange explains: only its view is named.
#[test]
fn an_image_of_another_moment_is_named() {
    let (scene, other) = (Scene::build(16, false, true, false), Scene::build(17, false, true, false));
    let mut scene = scene.with_noise(1);
    let strange = other.with_noise(2).model.images.into_iter().find(|i| i.view == 2 && i.camera == 1).unwrap();
    *scene.model.images.iter_mut().find(|i| i.view == 2 && i.camera == 1).unwrap() = strange;
    let words = refused(&scene.problem());
    assert!(words.contains("in view(s) 2 (counted") && words.contains("5 of 6 views agree"), "{words}");
}

/// The number that follows these words.
fn number_after(words: &str, before: &str) -> f64 {
    let rest = words.split(before).nth(1).unwrap_or_else(|| panic!("no \"{before}\" in: {words}"));
    rest.split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn a_view_marked_as_in_the_sheet_that_is_not_is_named() {
    for (seed, per_view) in [(18, false), (19, true), (20, false)] {
        for view in 0..4 {
            let scene = Scene::build(seed, per_view, true, false).with_noise(seed);
            let axis = |v: usize| scene.truth.views[v].first_from_target.rotation.column(2).into_owned();
            let tilt_deg = axis(view).angle(&axis(4)).to_degrees();
            let mut problem = scene.problem();
            problem.model.views[view].place = ViewPlace::InPlane { z_mm: 0.0, known: PlanePosition::Exact };
            let words = refused(&problem);
            assert!(words.contains("are not in one plane"), "{words}");
            let found = number_after(&words, &format!("view {view} is tilted by "));
            assert!((found - tilt_deg).abs() < 0.3, "{tilt_deg}: {words}");
        }
    }
}

/// A target put into the sheet twice by hand, the second time 0.15 degrees and 0.1 mm off: told with both numbers.
#[test]
fn a_view_a_little_out_of_the_sheet_is_told() {
    for seed in 21..24 {
        let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
        let mut parts = Scene::parts(seed, cameras, false, true, false);
        let off =
            Motion::new(rotation_exp(&Vector3::new(0.15_f64.to_radians(), 0.0, 0.0)), Vector3::new(0.0, 0.0, 0.1));
        parts.views[5].rig_from_target = parts.views[5].rig_from_target * off;
        let problem = parts.scene().with_noise(seed).problem();
        let solution = calibrate_rig(&problem, &AdjustOptions::default(), &mut |_| true).unwrap();
        let words = solution.undecided.join("; ");
        let (degrees, mm) = (number_after(&words, "is tilted by "), number_after(&words, "degrees and lies "));
        assert!((degrees - 0.15).abs() < 0.05 && (mm - 0.1).abs() < 0.03, "{words}");
    }
}

#[test]
fn rigs_without_a_contradiction_are_left_in_peace() {
    for seed in 30..50 {
        for scene in scenes(seed) {
            let solution = calibrate_rig(&scene.problem(), &AdjustOptions::default(), &mut |_| true).unwrap();
            let told = solution.undecided.iter().any(|w| w.contains("plane"));
            assert!(!told, "seed {seed}: {:?}", solution.undecided);
        }
    }
}
