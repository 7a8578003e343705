//! Weak contours of bubbles in one fixed sheet: a camera alone is then undetermined but for noise, which must not carry it away, nor anything be
//! blamed for it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use rig_scene::{Noise, Problem, Scene};
use spivcal::bundle::{AdjustOptions, Fact, SolveOptions, adjust, named_covariance};
use spivcal::rig::{RigProblem, calibrate_rig};

/// Scatter of edge points, px, five times that of the scenes of other tests.
const WEAK_PX: f64 = 0.1;
/// f of the lens, px, as a rig file gives it: the image distance is a tenth larger.
const NOMINAL_F_PX: f64 = 50.0 / 0.00625;

/// Five views in the sheet, cameras focused within their tolerances, a baseline known to 0.3 mm, weak contours.
fn weak(seed: u64) -> Scene {
    let mut parts = Problem::of("C").unwrap().draw(seed).parts;
    let mut noise = Noise::stream(seed, 7);
    parts.facts.retain(|f| !matches!(f, Fact::Shape { .. }));
    let baseline_mm = parts.cam_from_rig.translation_mm.norm();
    parts.facts.push(Fact::Baseline { value_mm: baseline_mm + 0.3 * noise.normal(), sigma_mm: 0.3 });
    let mut scene = parts.scene().with_edge_points(200);
    for edge in scene.model.images.iter_mut().flat_map(|i| &mut i.discs).map(|d| &mut d.edge) {
        edge.u_px.iter_mut().chain(&mut edge.v_px).for_each(|x| *x += WEAK_PX * noise.normal());
        edge.sigma_px.fill(WEAK_PX);
    }
    scene
}

fn problem(scene: &Scene) -> RigProblem {
    let mut problem = scene.problem();
    problem.starts.iter_mut().for_each(|s| s.nominal_f_px = Some(NOMINAL_F_PX));
    problem
}

/// The sigmas of the contours are true: they stay.
fn options() -> AdjustOptions {
    AdjustOptions { rounds: 0, ..AdjustOptions::default() }
}

/// Without any seed the minimum is that in which the truth ends, and its sigmas hold.
fn ends_in_the_minimum_of_the_truth(seed: u64, scene: &Scene) {
    let solution = calibrate_rig(&problem(scene), &options(), &mut |_| true).unwrap_or_else(|e| panic!("{seed}: {e}"));
    assert!(solution.undecided.is_empty(), "{seed}: {:?}", solution.undecided);
    let wanted = adjust(&scene.model, scene.truth.clone(), &options(), &mut |_| true);
    let found = solution.adjustment;
    assert!((found.cost / wanted.cost - 1.0).abs() < 1e-6, "{seed}: cost {} and {}", found.cost, wanted.cost);
    let covariance = named_covariance(&found).unwrap();
    for (c, camera) in ["left", "right"].iter().enumerate() {
        let all = [("f_px", 0), ("alpha_rad", 4), ("beta_rad", 5), ("k1", 6)];
        for (name, k) in all {
            let of = |s: &spivcal::bundle::State| s.cameras[c].to_array()[k];
            let sigma = covariance.sigma(&format!("{camera}.{name}")).unwrap();
            let z = (of(&found.state) - of(&scene.truth)) / sigma;
            assert!(z.abs() < 4.0, "{seed}: {camera} {name} lies {z:.1} sigma off");
        }
    }
}

#[test]
fn weak_contours_of_a_fixed_sheet_end_in_the_minimum_of_the_truth() {
    for seed in 0..8 {
        ends_in_the_minimum_of_the_truth(seed, &weak(seed));
    }
}

/// Place and size of such a view are open; it has to start on the plane that the others show.
#[test]
fn a_view_in_the_sheet_that_one_camera_alone_sees_harms_nothing() {
    for seed in 20..24 {
        let mut scene = weak(seed);
        scene.model.images.retain(|i| ![[1, 1], [4, 0]].contains(&[i.view, i.camera]));
        ends_in_the_minimum_of_the_truth(seed, &scene);
    }
}

/// What has not reached its minimum says that, and nothing of views or mirrors.
#[test]
fn nothing_is_blamed_for_an_adjustment_that_did_not_end() {
    let brief = AdjustOptions { solve: SolveOptions { iterations: 1, ..SolveOptions::default() }, ..options() };
    for seed in 30..34 {
        let words = match calibrate_rig(&problem(&weak(seed)), &brief, &mut |_| true) {
            Ok(solution) => solution.undecided.join("; "),
            Err(e) => e.to_string(),
        };
        assert!(!words.contains("mirrored") && !words.contains("not in one plane"), "{seed}: {words}");
    }
}
