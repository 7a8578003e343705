//! Bubbles in one fixed sheet, cameras fixed: what is determined and what is not, case by case.
//!
//! Each camera sees the sheet through a homography of 8 numbers; circles of unknown places and radii give it up to a similarity of
//! the sheet (4 numbers), the same for both cameras: `2 x 8 - 4 = 12` numbers, however many views. The pair has 15 unknowns (f and
//! principal point of two cameras, motion, plane), so three directions are left: the scale and two more. Free tilts without
//! distortion add their four.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use nalgebra::{SVector, Vector3};
use rig_scene::{Bound, Parts, Problem, given_sigmas, true_stereo};
use spivcal::bundle::{Fact, NamedCovariance, PlanePosition, Termination, ViewPlace, adjust, named_covariance};
use spivcal::camera::{Camera, Intrinsics};
use spivcal::rigid::{Motion, rotation_exp};
use spivcal::sheet::{RESPONSES, SheetUncertainty, StereoSheet};

const LEFT_RIGHT: [&str; 2] = ["left", "right"];

/// Five pairs of bubbles in one sheet, no distortion, nothing known but the tilts: 15 unknowns of the pair.
fn bare() -> Parts {
    let mut parts = Problem::of("C0").unwrap().parts;
    parts.cameras.iter_mut().for_each(|c| {
        let i = *c.intrinsics();
        *c = Camera::new(Intrinsics { k: [0.0; 3], ..i }).unwrap();
    });
    parts.facts.clear();
    parts.free = [false; 10];
    (parts.free[0], parts.free[2], parts.free[3]) = (true, true, true);
    parts
}

/// The same with one length known.
fn scaled() -> Parts {
    let mut parts = bare();
    parts.knows(0, 0);
    parts
}

/// View `v` leaves the sheet: turned about the sheet's axes and shifted along its normal.
fn moved(mut parts: Parts, v: usize, turn_deg: [f64; 2], shift_mm: f64) -> Parts {
    let sheet = parts.rig_from_sheet.unwrap();
    let turn = rotation_exp(&Vector3::new(turn_deg[0].to_radians(), turn_deg[1].to_radians(), 0.0));
    let step = Motion::new(turn, Vector3::new(0.0, 0.0, shift_mm));
    parts.views[v].rig_from_target = sheet * step * (sheet.inverse() * parts.views[v].rig_from_target);
    parts.views[v].place = ViewPlace::Free;
    parts
}

fn covariance(parts: &Parts) -> NamedCovariance {
    let scene = parts.scene();
    let out = adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true);
    assert!(out.cost < 1e-9, "the truth is a minimum on exact contours, cost {}", out.cost);
    named_covariance(&out).unwrap()
}

/// Number of undetermined directions; without any, everything has a sigma, with some, the gain has none and what happens in
/// the sheet's plane has.
fn nullity(parts: &Parts) -> usize {
    let c = covariance(parts);
    let at = SheetUncertainty::of(&c, LEFT_RIGHT).unwrap().at([4.0, -3.0]).unwrap();
    let disparity = at.disparity_px().expect("the disparity is immune");
    assert!((1e-4..0.05).contains(&disparity), "disparity {disparity}");
    // The sheet's x axis follows the rig's: without a known lens axis it turns in the sheet, which is no strain.
    let metric = !parts.facts.is_empty();
    for (row, column) in [(0, 0), (1, 1), (2, 0), (2, 1), (0, 1)] {
        let mut sum = SVector::<f64, RESPONSES>::zeros();
        sum[6 + 3 * row + column] = 1.0;
        if (row, column) == (0, 1) {
            sum[6 + 3] = 1.0;
        }
        // Lengths in the sheet need a scale.
        assert!(at.sigma(&sum).is_some() || (!metric && row == column), "in-plane response {row} {column}");
    }
    let gain = at.relative_gain();
    println!("nullity {}, gain {gain:?}, disparity {disparity:.4} px", c.nullity);
    assert_eq!(gain.is_some(), c.nullity == 0, "gain {gain:?}");
    assert!(c.nullity == 0 || !c.undetermined.is_empty(), "said in words");
    c.nullity
}

#[test]
fn fixed_sheet_has_rank_12_of_15() {
    let parts = bare();
    let c = covariance(&parts);
    // f, cx, cy of two cameras, motion, plane: what is global in this adjustment.
    let names: Vec<&String> = c.names.iter().filter(|n| !n.starts_with("view")).collect();
    // The plane's three unknowns move all six parts of its named step.
    assert_eq!(names.len(), 15 + 3);
    assert_eq!(nullity(&parts), 3, "scale and two directions");
}

#[test]
fn a_known_length_leaves_two_directions() {
    assert_eq!(nullity(&scaled()), 2);
}

#[test]
fn more_views_of_a_fixed_sheet_do_not_help() {
    for count in [3, 5] {
        let mut parts = scaled();
        parts.views.truncate(count);
        assert_eq!(nullity(&parts), 2, "{count} views");
    }
    let mut parts = scaled();
    let more: Vec<_> = (0..15)
        .map(|k| {
            let mut view = parts.views[k % 5];
            let sheet = parts.rig_from_sheet.unwrap();
            let spin = rotation_exp(&Vector3::new(0.0, 0.0, 0.4 * (1 + k) as f64));
            let step = Motion::new(spin, Vector3::new(0.3 * k as f64, -0.2 * k as f64, 0.0));
            view.rig_from_target = sheet * step * (sheet.inverse() * view.rig_from_target);
            view
        })
        .collect();
    parts.views.extend(more);
    assert_eq!(nullity(&parts), 2, "20 views");
}

#[test]
fn free_tilts_make_six() {
    let mut parts = scaled();
    (parts.free[4], parts.free[5]) = (true, true);
    assert_eq!(nullity(&parts), 6);
    // Known axis points take the four of the tilts away, not the two of the sheet.
    for camera in 0..2 {
        for (parameter, value) in [(2, 511.5), (3, 383.5)] {
            parts.facts.push(Fact::Intrinsic { camera, parameter, value, sigma: 100.0 });
        }
    }
    assert_eq!(nullity(&parts), 2);
}

#[test]
fn distortion_alone_does_not_help() {
    // C0: k1 of -0.15 and -0.2, free, tilts free, axis points known to 100 px.
    assert_eq!(nullity(&Problem::of("C0").unwrap().parts), 2);
}

#[test]
fn a_printed_view_cures() {
    let mut parts = Problem::of("D1").unwrap().parts;
    assert_eq!(nullity(&parts), 0, "with tilts and k1 free");
    parts.facts.retain(|f| !matches!(f, Fact::Intrinsic { .. }));
    parts.free = bare().free;
    assert_eq!(nullity(&parts), 0);
}

#[test]
fn a_tilted_sheet_cures() {
    assert_eq!(nullity(&moved(scaled(), 4, [5.0, -4.0], 0.0)), 0);
}

#[test]
fn a_parallel_shift_does_not_suffice() {
    let shifted = |parts: Parts| moved(parts, 4, [0.0, 0.0], 4.0);
    assert_eq!(nullity(&shifted(scaled())), 1, "a view parallel to the sheet, step unknown, a length known");
    let known_step = |parts: Parts| {
        let mut parts = shifted(parts);
        parts.views[4].place = ViewPlace::InPlane { z_mm: 4.0, known: PlanePosition::Exact };
        parts
    };
    assert_eq!(nullity(&known_step(bare())), 1, "the step is the metric fact");
    // Two metric facts, across and along the sheet, are one more than the scale needs.
    assert_eq!(nullity(&known_step(scaled())), 0, "step and a length known");
}

#[test]
fn known_focal_lengths_cure() {
    let mut parts = scaled();
    for (camera, c) in parts.cameras.iter().enumerate() {
        parts.facts.push(Fact::Intrinsic { camera, parameter: 0, value: c.intrinsics().f_px, sigma: 20.0 });
    }
    assert_eq!(nullity(&parts), 0, "as a prior");
    let mut parts = scaled();
    parts.free[0] = false;
    assert_eq!(nullity(&parts), 0, "held");
    let mut parts = scaled();
    parts.facts.push(Fact::Intrinsic { camera: 0, parameter: 0, value: 8889.0, sigma: 20.0 });
    assert_eq!(nullity(&parts), 1, "of one camera only");
}

#[test]
fn the_focus_relation_cures() {
    let mut parts = scaled();
    parts.knows_focus();
    assert_eq!(nullity(&parts), 0);
    assert_eq!(nullity(&Problem::of("C").unwrap().parts), 0, "with tilts and k1 free");
}

/// Not only to first order: cameras whose focal lengths are wrong by 5 and 3 % explain the same contours exactly, without any disparity,
/// and measure another out-of-plane velocity.
#[test]
fn wrong_focal_lengths_leave_no_trace_but_the_gain() {
    let parts = scaled();
    let mut scene = parts.scene();
    let mut free = parts.free;
    free[0] = false;
    scene.model.cameras.iter_mut().for_each(|c| c.free = free);
    scene.truth.cameras[0].f_px *= 1.05;
    scene.truth.cameras[1].f_px *= 1.03;
    let out = adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true);
    assert_eq!(out.termination, Termination::Converged);
    let estimate = StereoSheet::of(&named_covariance(&out).unwrap()).unwrap();
    let r = estimate.response(&true_stereo(&parts), [5.0, 5.0]).unwrap();
    println!("cost {:.1e}, gain {:.4}, disparity {:.1e} px", out.cost, r.relative_gain(), r.disparity_px.norm());
    assert!(out.cost < 1e-6, "cost {}", out.cost);
    assert!(r.disparity_px.norm() < 1e-4, "disparity {}", r.disparity_px);
    let m = r.measured_from_true;
    assert!((r.in_plane_scale() - 1.0).abs() < 1e-4 && m.m31.abs() < 1e-4 && m.m32.abs() < 1e-4, "{m}");
    assert!((r.relative_gain() - 1.0).abs() > 2e-3, "gain {}", r.relative_gain());
}

/// The cures by their strength, as predicted at the truth (0.02 px, 40 edge points per disc).
#[test]
fn cures_reach_what_was_promised() {
    let gain = |name: &str| Bound::of(&Problem::of(name).unwrap()).sigmas[10];
    assert_eq!(gain("C0"), None, "without a cure no number");
    for (name, promised) in [("B", 2e-4), ("C", 6e-4), ("D1", 8.5e-4), ("D3", 2.7e-4), ("D10", 1.6e-4)] {
        let got = gain(name).unwrap();
        println!("{name}: gain {:.4} %, promised {:.3} %", 100.0 * got, 100.0 * promised);
        assert!(got < promised, "{name}: {got}");
    }
}

/// What a drawing says of both focal lengths is all that tells them in a fixed sheet: it counts however precise the images are, though its share of their
/// information is less than rounding then.
#[test]
fn a_drawing_counts_however_precise_the_images_are() {
    let mut parts = scaled();
    assert_eq!(nullity(&parts), 2);
    for (camera, c) in parts.cameras.clone().iter().enumerate() {
        let value = c.intrinsics().f_px;
        parts.facts.push(Fact::Intrinsic { camera, parameter: 0, value, sigma: 0.01 * value });
    }
    let mut first = None;
    for precision in [1.0, 0.1, 0.01, 1e-3] {
        let mut scene = parts.scene();
        let edges = scene.model.images.iter_mut().flat_map(|i| &mut i.discs).map(|d| &mut d.edge);
        edges.for_each(|edge| edge.sigma_px.iter_mut().for_each(|s| *s *= precision));
        let out = adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true);
        let c = named_covariance(&out).unwrap();
        let sigmas = LEFT_RIGHT.map(|name| c.sigma(&format!("{name}.f_px")).unwrap());
        println!("images {precision} times as noisy: nullity {}, f known to {sigmas:?} px", c.nullity);
        assert_eq!(c.nullity, 0, "{:?}", c.undetermined);
        let wanted = *first.get_or_insert(sigmas);
        for (own, wanted) in sigmas.iter().zip(wanted) {
            assert!((own / wanted - 1.0).abs() < 0.02 && *own > 40.0, "{sigmas:?} {wanted:?}");
        }
    }
}
