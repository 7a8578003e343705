//! Bubbles in one fixed sheet without a focus relation, a printed view or a known focal length: two directions of the pair are open whatever the number
//! of views (`2 x 8 - 4 = 12` numbers of two homographies for 15 unknowns, less the scale), and noise must not pass for knowledge of them, carry the cameras
//! away along them, or keep the adjustment from an end.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use nalgebra::Vector3;
use rig_scene::{Noise, Parts, Problem, Scene, grid, true_stereo};
use spivcal::bundle::{
    AdjustOptions, Fact, PlanePosition, SolveOptions, Termination, ViewPlace, adjust, named_covariance, open_rows,
};
use spivcal::rig::{RigProblem, calibrate_rig};
use spivcal::rigid::{Motion, rotation_exp};
use spivcal::sheet::{SheetUncertainty, StereoSheet};

const LEFT_RIGHT: [&str; 2] = ["left", "right"];
/// f of the lens, px, as a rig file gives it: the image distance is a tenth larger.
const NOMINAL_F_PX: f64 = 50.0 / 0.00625;
/// Usual departure from it, px.
const NOMINAL_SIGMA_PX: f64 = 0.15 * NOMINAL_F_PX;

/// What is recorded.
#[derive(Debug, Clone, Copy)]
struct Case {
    /// Scatter of edge points, px.
    noise_px: f64,
    views: usize,
    /// By how much the second camera is turned about the sheet's vertical, from 45 degrees towards the first, degrees.
    turned_deg: f64,
    focused: bool,
    /// Whether the rig file says which lens it is.
    nominal: bool,
}

const WEAK: Case = Case { noise_px: 0.1, views: 5, turned_deg: 0.0, focused: false, nominal: true };

/// Axis points known to a tenth of the image's width, tilts and k1 free, a baseline known to 0.3 mm.
fn parts(case: Case, seed: u64) -> Parts {
    let mut parts = Problem::of("C").unwrap().draw(seed).parts;
    let mut noise = Noise::stream(seed, 8);
    let sheet = parts.rig_from_sheet.unwrap();
    let turned = |deg: f64| {
        let turn = Motion::new(rotation_exp(&Vector3::new(0.0, deg.to_radians(), 0.0)), Vector3::zeros());
        parts.cam_from_rig * sheet * turn * sheet.inverse()
    };
    let square = |deg: f64| (turned(deg).rotation * sheet.rotation.column(2)).z.abs();
    parts.cam_from_rig = turned(if square(25.0) > square(-25.0) { case.turned_deg } else { -case.turned_deg });
    parts.facts.retain(|f| !matches!(f, Fact::Shape { .. }) && (case.focused || !matches!(f, Fact::Focus(_))));
    let baseline_mm = parts.cam_from_rig.translation_mm.norm();
    parts.facts.push(Fact::Baseline { value_mm: baseline_mm + 0.3 * noise.normal(), sigma_mm: 0.3 });
    parts.views.truncate(case.views);
    parts
}

fn scene(case: Case, parts: &Parts, seed: u64) -> Scene {
    let mut noise = Noise::stream(seed, 9);
    let mut scene = parts.scene().with_edge_points(200);
    for edge in scene.model.images.iter_mut().flat_map(|i| &mut i.discs).map(|d| &mut d.edge) {
        edge.u_px.iter_mut().chain(&mut edge.v_px).for_each(|x| *x += case.noise_px * noise.normal());
        edge.sigma_px.fill(case.noise_px);
    }
    scene
}

fn problem(case: Case, scene: &Scene) -> RigProblem {
    let mut problem = scene.problem();
    problem.starts.iter_mut().for_each(|s| s.nominal_f_px = case.nominal.then_some(NOMINAL_F_PX));
    problem
}

/// The sigmas of the contours are true: they stay.
fn options() -> AdjustOptions {
    AdjustOptions { rounds: 0, ..AdjustOptions::default() }
}

fn usual() -> Vec<Fact> {
    let of = |camera| Fact::Intrinsic { camera, parameter: 0, value: NOMINAL_F_PX, sigma: NOMINAL_SIGMA_PX };
    (0..2).map(of).collect()
}

/// Chi-square at the minimum where the focal lengths are the true ones, to one pixel.
fn chi2_with_true_f(scene: &Scene) -> f64 {
    let mut model = scene.model.clone();
    let known = scene.truth.cameras.iter().enumerate();
    model.facts.extend(known.map(|(camera, c)| Fact::Intrinsic { camera, parameter: 0, value: c.f_px, sigma: 1.0 }));
    2.0 * adjust(&model, scene.truth.clone(), &options(), &mut |_| true).cost
}

fn two_directions_are_open(case: Case, seed: u64) {
    let parts = parts(case, seed);
    let scene = scene(case, &parts, seed);
    let solution = calibrate_rig(&problem(case, &scene), &options(), &mut |_| true)
        .unwrap_or_else(|e| panic!("{case:?} {seed}: {e}"));
    assert!(solution.undecided.is_empty(), "{case:?} {seed}: {:?}", solution.undecided);
    let found = solution.adjustment;
    assert_eq!(found.termination, Termination::Converged, "{case:?} {seed}");
    assert_eq!(found.model.facts, scene.model.facts, "nothing of what is usual remains");
    for c in &found.state.cameras {
        let off = if case.nominal { (c.f_px - NOMINAL_F_PX) / NOMINAL_SIGMA_PX } else { 0.0 };
        let tilt = c.alpha_rad.hypot(c.beta_rad);
        assert!(
            off.abs() < 1.0 && tilt < if case.nominal { 0.3 } else { 0.6 },
            "{case:?} {seed}: f {} px, tilt {tilt}",
            c.f_px
        );
    }
    let more = 2.0 * found.cost - chi2_with_true_f(&scene);
    let covariance = named_covariance(&found).unwrap();
    println!("{case:?} {seed}: nullity {}, chi-square {more:+.2}", covariance.nullity);
    // The chance of two open directions, and no other minimum.
    assert!(more.abs() < 12.0, "{case:?} {seed}: chi-square differs by {more}");
    assert_eq!((covariance.nullity, covariance.shared_nullity()), (2, 2), "{case:?} {seed}");
    let words = covariance.undetermined.join("; ");
    for camera in LEFT_RIGHT {
        assert_eq!(covariance.sigma(&format!("{camera}.f_px")), None, "{case:?} {seed}");
        let told = covariance.undetermined.iter().any(|w| w.contains("focal length f") && w.contains(camera));
        assert!(told, "{case:?} {seed}: {words}");
    }
    // What is immune is known, and holds; the gain has no number.
    let sheet = SheetUncertainty::of(&covariance, LEFT_RIGHT).unwrap();
    let (estimate, truth) = (StereoSheet::of(&covariance).unwrap(), true_stereo(&parts));
    for p in grid() {
        let at = sheet.at(p).unwrap();
        assert_eq!(at.relative_gain(), None, "{case:?} {seed}: the gain at {p:?}");
        let sigma = at.disparity_px().unwrap_or_else(|| panic!("{case:?} {seed}: the disparity is immune"));
        let off = estimate.response(&truth, p).unwrap().disparity_px.norm();
        assert!(off < 5.0 * sigma, "{case:?} {seed}: disparity {off} px, sigma {sigma}");
    }
}

#[test]
fn weak_contours_leave_two_directions_open() {
    for noise_px in [0.02, 0.1, 0.2] {
        for seed in 40..46 {
            two_directions_are_open(Case { noise_px, ..WEAK }, seed);
        }
    }
}

#[test]
fn few_and_many_views_leave_them_open() {
    for views in [3, 4] {
        for seed in 50..54 {
            two_directions_are_open(Case { views, ..WEAK }, seed);
        }
    }
}

/// Without the focal length of the lens they are held where the cameras alone start.
#[test]
fn unknown_lenses_leave_them_open() {
    for seed in 90..94 {
        two_directions_are_open(Case { nominal: false, ..WEAK }, seed);
    }
}

/// Viewing angles of 45 and 20 degrees, and of 45 and 15 degrees from the same side.
#[test]
fn other_rigs_leave_them_open() {
    for turned_deg in [25.0, 60.0] {
        for seed in 60..64 {
            two_directions_are_open(Case { turned_deg, ..WEAK }, seed);
        }
    }
}

/// As many as are counted by hand, on exact contours.
#[test]
fn what_is_open_is_counted() {
    let open = |parts: &Parts| {
        let scene = parts.scene();
        open_rows(&scene.model, &scene.truth, &usual()).len()
    };
    let sheet = parts(WEAK, 1);
    assert_eq!(open(&sheet), 2, "one sheet");
    assert_eq!(open(&parts(Case { focused: true, ..WEAK }, 1)), 0, "the focus relation");
    for camera in 0..2 {
        let mut one = sheet.clone();
        one.facts.push(Fact::Intrinsic { camera, parameter: 0, value: 8889.0, sigma: 20.0 });
        assert_eq!(open(&one), 1, "f of camera {camera} is known");
    }
    let moved = |turn_deg: f64, shift_mm: f64, known: Option<PlanePosition>| {
        let mut parts = sheet.clone();
        let turn = rotation_exp(&Vector3::new(turn_deg.to_radians(), 0.0, 0.0));
        let (frame, step) = (parts.rig_from_sheet.unwrap(), Motion::new(turn, Vector3::new(0.0, 0.0, shift_mm)));
        let view = &mut parts.views[4];
        view.rig_from_target = frame * step * (frame.inverse() * view.rig_from_target);
        view.place = known.map_or(ViewPlace::Free, |known| ViewPlace::InPlane { z_mm: shift_mm, known });
        parts
    };
    assert_eq!(open(&moved(5.0, 0.0, None)), 0, "a view tilted by five degrees");
    assert_eq!(open(&moved(0.0, 4.0, None)), 1, "a view parallel to the sheet");
    assert_eq!(open(&moved(0.0, 4.0, Some(PlanePosition::Exact))), 0, "a known step, and a known length");
    assert_eq!(open(&Problem::of("D1").unwrap().parts), 0, "a printed view");
}

/// With a focus relation everything is determined as it was: nothing usual enters.
#[test]
fn a_focus_relation_leaves_nothing_open() {
    for seed in 70..74 {
        let case = Case { focused: true, ..WEAK };
        let scene = scene(case, &parts(case, seed), seed);
        let found = calibrate_rig(&problem(case, &scene), &options(), &mut |_| true).unwrap().adjustment;
        let wanted = adjust(&scene.model, scene.truth.clone(), &options(), &mut |_| true);
        assert!((found.cost / wanted.cost - 1.0).abs() < 1e-6, "{seed}: cost {} and {}", found.cost, wanted.cost);
        let covariance = named_covariance(&found).unwrap();
        assert_eq!(covariance.nullity, 0);
        for (c, camera) in LEFT_RIGHT.iter().enumerate() {
            let sigma = covariance.sigma(&format!("{camera}.f_px")).unwrap();
            let z = (found.state.cameras[c].f_px - scene.truth.cameras[c].f_px) / sigma;
            assert!(z.abs() < 4.0, "{seed}: f of camera {camera} lies {z:.1} sigma off");
        }
    }
}

/// What has not reached its minimum says what it had nothing to hold on to, and what would help.
#[test]
fn an_adjustment_without_an_end_says_what_is_open() {
    let brief = AdjustOptions { solve: SolveOptions { iterations: 1, ..SolveOptions::default() }, ..options() };
    for seed in 80..83 {
        let scene = scene(WEAK, &parts(WEAK, seed), seed);
        let words = calibrate_rig(&problem(WEAK, &scene), &brief, &mut |_| true).unwrap_err().to_string();
        for wanted in
            ["along 2 direction(s)", "focal length f", "camera left", "camera right", "printed target", "[focus]"]
        {
            assert!(words.contains(wanted), "{seed}: {words}");
        }
    }
}
