//! Cameras behind flat windows in the adjustment: derivatives against differences through the retraction, recovery from contours
//! alone, sampled against predicted sigmas, and the calibration as a record.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod rig_scene;
mod window_door;

use nalgebra::{DVector, Vector2, Vector3};
use rig_scene::{Noise, Scene, tilted_camera};
use spivcal::bundle::{AdjustOptions, Fact, SolveOptions, WindowModel, adjust, named_covariance};
use spivcal::camera::{WINDOW_STEP_NAMES, Window};
use spivcal::dewarp::SheetMap;
use spivcal::rig::calibrate_rig;
use spivcal::solve::{Problem, Step, Termination};

const NAMES: [&str; 2] = ["left", "right"];
const DISTANCE_SIGMA_MM: f64 = 3.0;
const THICKNESS_SIGMA_MM: f64 = 0.2;
const INDEX_SIGMA: f64 = 1e-3;
const TILT_SIGMA_RAD: f64 = 5e-3;

/// The paper's rig with the sheet behind one window per camera, each nearly parallel to it; all of the window unknown but the air.
fn scene(seed: u64) -> Scene {
    let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
    let mut parts = Scene::parts(seed, cameras, false, true, false);
    let mut windows = vec![];
    for c in 0..2 {
        let sheet = parts.rig_from_sheet.unwrap();
        let axis: Vector3<f64> = match c {
            0 => sheet.rotation.column(2).into_owned(),
            _ => parts.cam_from_rig.rotation * sheet.rotation.column(2),
        };
        let layers = [[180.0, 10.0, 1.0, 1.49, 1.333], [200.0, 12.0, 1.0, 1.5, 1.33]][c];
        let normal = -axis + Vector3::new(0.003, -0.002, 0.001);
        let window = Window::new(normal, layers[0], layers[1], [layers[2], layers[3], layers[4]]).unwrap();
        parts.cameras[c] = parts.cameras[c].with_window(Some(window));
        let sigmas = [Some(DISTANCE_SIGMA_MM), Some(THICKNESS_SIGMA_MM), None, Some(INDEX_SIGMA), Some(INDEX_SIGMA)];
        for (layer, sigma) in sigmas.iter().enumerate() {
            let value = window.layers()[layer];
            parts.facts.extend(sigma.map(|sigma| Fact::WindowLayer { camera: c, layer, value, sigma }));
        }
        parts.facts.extend([0, 1].map(|axis| Fact::WindowParallel { camera: c, axis, sigma_rad: TILT_SIGMA_RAD }));
        windows.push((window, WindowModel { free: sigmas.map(|s| s.is_some()), layers }));
    }
    let mut scene = parts.scene();
    scene.truth.windows = vec![];
    for (c, (window, model)) in windows.into_iter().enumerate() {
        scene.model.cameras[c].window = Some(model);
        let solver_from_cam = scene.cameras[c].cam_from_pinhole().transpose();
        scene.truth.windows.push(Some(window.in_frame(&solver_from_cam)));
    }
    scene
}

#[test]
fn gradient_is_that_of_the_cost() {
    let scene = scene(1);
    let problem = spivcal::bundle::problem(&scene.model);
    let state = scene.perturbed_by(3, 0.1);
    let e = problem.linearise(&state).unwrap();
    let layout = problem.layout();
    let mut checked = 0;
    for i in 0..layout.global {
        let h = 1.0 / e.h_gg[(i, i)].sqrt();
        let at = |x: f64| {
            let blocks = layout.blocks.iter().map(|d| DVector::zeros(*d)).collect();
            let mut step = Step { global: DVector::zeros(layout.global), blocks };
            step.global[i] = x;
            problem.cost(&problem.retract(&state, &step).unwrap()).unwrap()
        };
        let d = |x: f64| (at(x) - at(-x)) / (2.0 * x);
        let (numeric, b) = ((4.0 * d(0.5 * h) - d(h)) / 3.0, e.b_g[i]);
        assert!((numeric + b).abs() < 2e-5 * b.abs() + 1e-6 / h, "global {i}, h {h}: {numeric} against {}", -b);
        checked += 1;
    }
    // Two windows: two tilts and four layers each, beside 2 x 6 camera numbers, 6 of the motion, 3 of the plane, 2 radii.
    assert_eq!(checked, 2 * 6 + 2 * 6 + 6 + 3 + 2);
}

#[test]
fn a_rig_behind_windows_is_found_from_contours_alone() {
    let mut scene = scene(2).with_noise(7);
    // What is stated need not be true: the start has the distances of the rig file.
    scene.model.cameras[0].window.as_mut().unwrap().layers[0] = 250.0;
    let found = calibrate_rig(&scene.problem(), &AdjustOptions { rounds: 0, ..Default::default() }, &mut |_| true);
    let out = found.unwrap().adjustment;
    let counts = out.model.counts();
    let dof = (counts.observations + counts.facts - counts.unknowns) as f64;
    let z = (2.0 * out.cost - dof) / (2.0 * dof).sqrt();
    println!("chi-square {:.1} of {dof}", 2.0 * out.cost);
    assert!(z.abs() < 5.0 && out.termination == Termination::Converged, "chi-square {} of {dof}", 2.0 * out.cost);
}

/// z of each number of both windows, of the effective focal lengths and of the sheet's distance.
fn z_scores(scene: &Scene, seed: u64) -> Vec<f64> {
    let mut drawn = scene.with_noise(seed);
    let mut noise = Noise::new(seed + 500);
    for fact in &mut drawn.model.facts {
        match fact {
            Fact::WindowLayer { value, sigma, .. } | Fact::Intrinsic { value, sigma, .. } => {
                *value += *sigma * noise.normal();
            }
            _ => {}
        }
    }
    let options =
        AdjustOptions { solve: SolveOptions { decrement: 1e-6, iterations: 300 }, rounds: 0, outlier_sigmas: 6.0 };
    let out = adjust(&drawn.model, drawn.truth.clone(), &options, &mut |_| true);
    assert_eq!(out.termination, Termination::Converged);
    let covariance = named_covariance(&out).unwrap();
    assert_eq!(covariance.nullity, 0, "{:?}", covariance.undetermined);
    let mut z = vec![];
    for (c, name) in NAMES.iter().enumerate() {
        let (found, truth) = (&covariance.natural.cameras[c], &scene.cameras[c]);
        let of = |k: usize| covariance.sigma(&format!("{name}.window.{}", WINDOW_STEP_NAMES[k])).unwrap();
        let (found_window, true_window) = (found.window().unwrap(), truth.window().unwrap());
        // n = (1 + [w]x) n_true: what a turn w about the x axis moves is n_z, and so on; two of three parts of w are seen.
        let moved = true_window.normal().cross(found_window.normal());
        let rows: Vec<Vec<(String, f64)>> = true_window
            .tangents()
            .iter()
            .map(|t| (0..3).map(|k| (format!("{name}.window.{}", WINDOW_STEP_NAMES[k]), t[k])).collect())
            .collect();
        let spread = covariance.propagate(&rows);
        for (k, t) in true_window.tangents().iter().enumerate() {
            z.push(moved.dot(t) / spread[(k, k)].sqrt());
        }
        for k in [0, 1, 3, 4] {
            z.push((found_window.layers()[k] - true_window.layers()[k]) / of(3 + k));
        }
        z.push(
            (found.intrinsics().f_px - truth.intrinsics().f_px) / covariance.sigma(&format!("{name}.f_px")).unwrap(),
        );
    }
    z
}

#[test]
fn sampled_errors_of_windows_are_the_predicted_ones() {
    let mut scene = scene(3);
    // The windows' own departures from parallel are fixed: a prior of zero would be wrong in every run alike.
    scene.model.facts.iter_mut().for_each(|f| {
        if let Fact::WindowParallel { sigma_rad, .. } = f {
            *sigma_rad = 0.2;
        }
    });
    let runs: Vec<Vec<f64>> = (0..24).map(|seed| z_scores(&scene, seed)).collect();
    let n = runs.len() as f64;
    let squares: Vec<f64> = (0..runs[0].len()).map(|k| runs.iter().map(|r| r[k] * r[k]).sum::<f64>() / n).collect();
    println!("mean z^2: {squares:.2?}");
    // Mean of 24 squares: chi-square over its degrees of freedom lies between 0.29 and 2.4 (99.99 %).
    assert!(squares.iter().all(|s| (0.29..2.4).contains(s)), "{squares:?}");
}

#[test]
fn a_map_through_a_window_goes_there_and_back() {
    let scene = scene(4);
    let sheet = Scene::parts(4, scene.cameras.clone(), false, true, false).rig_from_sheet.unwrap();
    let cam_from_sheet = spivcal::rigid::Motion::new(sheet.rotation, sheet.translation_mm);
    let map = SheetMap::new(scene.cameras[0], cam_from_sheet, [1024, 768]);
    for (x, y, z) in [(0.0, 0.0, 0.0), (12.0, -7.0, 1.5), (-20.0, 15.0, -2.0)] {
        let q = map.pixel_from_sheet(&Vector3::new(x, y, z)).unwrap();
        let p = map.sheet_from_pixel(&q, z).unwrap();
        assert!((p - Vector2::new(x, y)).norm() < 1e-9, "{p:?} for {x}, {y}, {z}");
        // The derivatives of both directions, against differences of the maps themselves.
        let jets = map.sheet_of_pixel_jets(&[q.x], &[q.y], &[z]).unwrap();
        let h = 1e-3;
        let at = |du: f64, dv: f64, dz: f64| map.sheet_from_pixel(&(q + Vector2::new(du, dv)), z + dz).unwrap();
        let by = |du: f64, dv: f64, dz: f64| (at(du, dv, dz) - at(-du, -dv, -dz)) / (2.0 * h);
        let want = [by(h, 0.0, 0.0), by(0.0, h, 0.0), by(0.0, 0.0, h)];
        let got = [[jets.dx_du[0], jets.dy_du[0]], [jets.dx_dv[0], jets.dy_dv[0]], [jets.dx_dz[0], jets.dy_dz[0]]];
        for (w, g) in want.iter().zip(got) {
            assert!((w - Vector2::from(g)).norm() < 1e-7 * w.norm() + 1e-9, "{w:?} {g:?}");
        }
    }
}
