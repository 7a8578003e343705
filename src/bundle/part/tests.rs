//! What a start from a part changes: the number of linearisations, and nothing else.

use super::*;
use crate::bundle::rig_scene::{Grid, Scene, tilted_camera, with_tangents};
use crate::bundle::{AdjustOptions, State, Termination, adjust, named_covariance, problem};
use crate::solve;

const DOTS: Grid = Grid { columns: 8, rows: 6, pitch_mm: 5.0, radius_mm: 1.5, print_error_mm: 0.0, turn: 1.0 };
const POINTS: Grid = Grid { columns: 30, rows: 20, pitch_mm: 1.3, radius_mm: 0.4, print_error_mm: 0.0, turn: 1.0 };

fn scene(grid: Grid) -> Scene {
    let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
    match grid.columns {
        30 => Scene::with_grid_unseen(4, cameras, grid, false).seen_as_points(4),
        _ => Scene::with_grid(4, cameras, grid, false).with_noise(4),
    }
}

#[test]
fn a_part_is_spread_evenly_and_whole_groups() {
    let all = scene(POINTS).model;
    let some = part(&all).unwrap();
    for (a, b) in all.images.iter().zip(&some.images) {
        assert!(observed(b) >= ENOUGH && observed(b) <= ENOUGH + 2 * GROUP, "{}", observed(b));
        let runs = b.points.disc.chunks(GROUP).all(|g| g.windows(2).all(|w| w[1] == w[0] + 1));
        assert!(runs, "{:?}", b.points.disc);
        for (i, &j) in b.points.disc.iter().enumerate() {
            let at = j as usize;
            assert_eq!((b.points.u_px[i], b.points.v_px[i]), (a.points.u_px[at], a.points.v_px[at]));
        }
        // As many in the first half of the plate as in the second.
        let first = b.points.disc.iter().filter(|j| **j < 300).count();
        assert!(first.abs_diff(b.points.disc.len() - first) <= 2 * GROUP);
    }
    let contours = scene(DOTS).model;
    let some = part(&contours).unwrap();
    for (a, b) in contours.images.iter().zip(&some.images) {
        assert_eq!((a.discs.len(), b.discs.len()), (48, 16));
        assert!(b.discs.iter().all(|d| d.edge.u_px.len() == GROUP && d.independent()));
    }
    // Few observations, and tangents, are left alone.
    let few = Scene::build(4, false, false, false).with_noise(4).model;
    assert!(part(&few).is_none());
    assert!(part(&with_tangents(few, crate::bitangent::ExternalUse::Never)).is_none());
}

/// All unknowns in units of their sigmas.
fn apart(model: &Model, a: &State, b: &State, sigma: impl Fn(&str) -> Option<f64>) -> f64 {
    let mut largest: f64 = 0.0;
    for (c, camera) in model.cameras.iter().enumerate() {
        for (k, name) in crate::camera::INTRINSIC_NAMES.iter().enumerate() {
            if let Some(s) = sigma(&format!("{}.{name}", camera.name)) {
                largest = largest.max((a.cameras[c].to_array()[k] - b.cameras[c].to_array()[k]).abs() / s);
            }
        }
    }
    largest
}

#[test]
fn the_minimum_is_the_same_and_reached_no_later() {
    for grid in [DOTS, POINTS] {
        let scene = scene(grid);
        let start = scene.perturbed_by(4, 0.5);
        let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
        let fast = adjust(&scene.model, start.clone(), &options, &mut |_| true);
        let slow = solve::minimise(&problem(&scene.model), start, &options.solve, &mut |_| true);
        assert_eq!((fast.termination, slow.termination), (Termination::Converged, Termination::Converged));
        assert!((fast.cost / slow.cost - 1.0).abs() < 1e-12, "{} {}", fast.cost, slow.cost);
        let known = named_covariance(&fast).unwrap();
        let apart = apart(&scene.model, &fast.state, &slow.state, |n| known.sigma(n));
        assert!(apart < 1e-5, "{apart} sigmas");
        // Points bend little: the whole needs few linearisations from anywhere.
        let most = if grid.columns == POINTS.columns { slow.iterations } else { slow.iterations - 1 };
        assert!(fast.iterations <= most, "{} {}", fast.iterations, slow.iterations);
    }
}

/// From the minimum itself the part would lead away: it is left alone, and so is a caller who cancels.
#[test]
fn a_good_start_is_kept_and_cancelling_is_heard() {
    let scene = scene(POINTS);
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let first = adjust(&scene.model, scene.truth.clone(), &options, &mut |_| true);
    let again = adjust(&scene.model, first.state.clone(), &options, &mut |_| true);
    assert_eq!(again.iterations, 1);
    assert_eq!(again.state, first.state);
    let mut calls = 0;
    let cancelled = adjust(&scene.model, scene.perturbed_by(4, 0.5), &options, &mut |_| {
        calls += 1;
        calls < 2
    });
    assert_eq!((cancelled.termination, calls), (Termination::Cancelled, 2));
}

/// Shared unknowns alone: the same covariance as with everything, and `None` where one is undetermined.
#[test]
fn the_covariance_of_what_is_shared_is_that_of_the_posterior() {
    let scene = scene(POINTS);
    let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
    let mut out = adjust(&scene.model, scene.truth.clone(), &options, &mut |_| true);
    let (shared, all) =
        (crate::bundle::shared_covariance(&out).unwrap(), solve::posterior(out.equations.as_ref().unwrap()));
    for i in 0..shared.nrows() {
        for j in 0..shared.ncols() {
            let size = (all.global[(i, i)] * all.global[(j, j)]).sqrt();
            assert!((shared[(i, j)] - all.global[(i, j)]).abs() < 1e-7 * size, "{i} {j}");
        }
    }
    // A shared unknown that is another one once more.
    let e = out.equations.as_mut().unwrap();
    let column = e.h_gg.column(0).into_owned();
    e.h_gg.set_column(1, &column);
    let row = column.transpose();
    e.h_gg.set_row(1, &row);
    e.h_gg[(1, 1)] = e.h_gg[(0, 0)];
    e.h_gg[(0, 1)] = e.h_gg[(0, 0)];
    e.h_gg[(1, 0)] = e.h_gg[(0, 0)];
    for b in &mut e.blocks {
        let c = b.h_vg.column(0).into_owned();
        b.h_vg.set_column(1, &c);
    }
    assert_eq!(solve::posterior(e).nullity, 1);
    assert!(crate::bundle::shared_covariance(&out).is_none());
}
