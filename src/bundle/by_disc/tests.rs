//! Elimination by discs against elimination by views.

use super::*;
use crate::bundle::adjust::Bundle;
use crate::bundle::rig_scene::{Grid, Scene, tilted_camera};
use crate::bundle::{AdjustOptions, Loss, State, adjust, problem};
use crate::solve::{self, Problem};

/// More discs than six views of six unknowns.
const DOTS: Grid = Grid { columns: 5, rows: 4, pitch_mm: 6.0, radius_mm: 1.8, print_error_mm: 0.01, turn: 1.0 };

fn scene(as_points: bool, plane: bool) -> (Model, State) {
    let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
    let mut scene = match plane {
        // Nine discs, and two of their views in one plane.
        true => Scene::build(4, false, true, true).with_noise(4),
        false => Scene::with_grid(4, cameras, DOTS, true).with_noise(4),
    };
    if as_points {
        scene = scene.seen_as_points(4);
    }
    scene.model.loss = Loss::Huber(2.0);
    let mut start = scene.perturbed_by(4, 0.2);
    start.offsets_mm.iter_mut().for_each(|o| *o = [0.0; 4]);
    (scene.model, start)
}

fn near(a: &DMatrix<f64>, b: &DMatrix<f64>, part: f64) {
    assert_eq!(a.shape(), b.shape());
    let largest = b.abs().max();
    assert!((a - b).abs().max() <= part * largest, "{} of {largest}", (a - b).abs().max());
}

#[test]
fn equations_by_disc_say_what_those_by_view_say() {
    for (model, state) in [scene(false, false), scene(true, false), scene(true, true)] {
        let places = Places::of(&model);
        let Some(by) = ByDisc::of(&model, &places) else { continue };
        let (by_view, by_disc) = (problem(&model), Bundle::of(&model));
        let (wanted, other) = (by_view.linearise(&state).unwrap(), by_disc.linearise(&state).unwrap());
        assert_eq!(other.blocks.len(), model.target.disc_count());
        let got = by.equations_by_view(&other);
        assert!((got.cost / wanted.cost - 1.0).abs() < 1e-12);
        near(&got.h_gg, &wanted.h_gg, 1e-9);
        for (a, b) in got.blocks.iter().zip(&wanted.blocks) {
            near(&a.h_vv, &b.h_vv, 1e-9);
            near(&a.h_vg, &b.h_vg, 1e-9);
            assert!((&a.b_v - &b.b_v).norm() <= 1e-9 * b.b_v.norm());
        }
        assert!((&got.b_g - &wanted.b_g).norm() <= 1e-9 * wanted.b_g.norm());
        // Steps go there and back; the bend is the same numbers.
        let scales = by_view.scales(&state);
        assert_eq!(by.step_by_view(&by.step_by_disc(&scales)), scales);
        let bent = by.gradient_by_disc(&by_view.bend(&state, &scales).unwrap());
        let again = by_disc.bend(&state, &by.step_by_disc(&scales)).unwrap();
        assert_eq!(bent, again);
        let (a, b) = (by_view.retract(&state, &scales), by_disc.retract(&state, &by.step_by_disc(&scales)));
        assert_eq!(a, b);
    }
    let (model, _) = scene(true, false);
    assert!(ByDisc::of(&model, &Places::of(&model)).is_some());
}

/// The adjustment ends where a solve by views ends, with the same equations.
#[test]
fn the_minimum_is_that_of_the_solve_by_views() {
    for as_points in [false, true] {
        let (model, start) = scene(as_points, false);
        let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
        let fast = adjust(&model, start.clone(), &options, &mut |_| true);
        let by_view = problem(&model);
        let slow = solve::minimise(&by_view, start, &options.solve, &mut |_| true);
        assert!((fast.cost / slow.cost - 1.0).abs() < 1e-11, "{} {}", fast.cost, slow.cost);
        assert!(fast.decrement < 1e-6 && slow.decrement < 1e-6);
        for (a, b) in fast.state.offsets_mm.iter().flatten().zip(slow.state.offsets_mm.iter().flatten()) {
            assert!((a - b).abs() < 1e-8, "{a} {b}");
        }
        let (a, b) = (fast.equations.unwrap(), slow.equations.unwrap());
        // The states lie 1e-6 sigmas apart, and the information with them.
        near(&solve::posterior(&a).global, &solve::posterior(&b).global, 1e-5);
    }
}
