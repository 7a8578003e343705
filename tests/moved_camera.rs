//! A camera that was moved between views, or drifts: named with the view and by how much; not where nothing moved, nor where views merely scatter.
//! Exact contours of the paper's geometry with noise drawn anew.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;
mod share;

use nalgebra::SVector;
use rig_scene::{Grid, Noise, Parts, Problem, Scene, adjusted, diagnosed, drawn, tilted_camera};
use share::share;
use spivcal::bundle::{AdjustOptions, Moved, MovedTest, moved_test};
use spivcal::camera::Camera;
use spivcal::rig::calibrate_rig;

const PLATE: Grid = Grid { columns: 5, rows: 5, pitch_mm: 5.0, radius_mm: 1.5, print_error_mm: 0.0, turn: 1.0 };

/// Turn (rad) and shift (mm) of the second camera in its own frame.
type Step = SVector<f64, 6>;

fn cameras() -> Vec<Camera> {
    vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)]
}

/// Twelve views of a plate, held otherwise in each.
fn plate() -> Parts {
    let mut parts = Scene::grid_parts(5, cameras(), PLATE);
    parts.views.extend(Scene::grid_parts(6, cameras(), PLATE).views);
    parts
}

/// The same with every dot off its place and estimated.
fn misprinted() -> Parts {
    let mut parts = plate();
    let mut noise = Noise::stream(7, 1);
    parts.target.offset_sigma_mm = Some([0.02, 0.02, 0.02, 0.01]);
    parts.offsets_mm = (0..25).map(|_| [0.02 * noise.normal(), 0.02 * noise.normal(), 0.0, 0.0]).collect();
    parts
}

/// The scene in which the second camera stands otherwise in each view.
fn with_steps(parts: &Parts, step: &dyn Fn(usize) -> Step) -> Scene {
    let mut out = parts.scene();
    for v in 0..parts.views.len() {
        let mut moved = parts.clone();
        moved.cam_from_rig = moved.cam_from_rig.retract(&step(v));
        let seen = moved.scene().model.images;
        for (own, other) in out.model.images.iter_mut().zip(seen).filter(|(own, _)| own.view == v && own.camera == 1) {
            *own = other;
        }
    }
    out
}

/// 0.007 degrees and 0.04 mm: 0.7 px.
fn step() -> Step {
    Step::from_column_slice(&[1e-4, 5e-5, -4e-5, 0.01, -0.03, 0.02])
}

fn test_of(scene: &Scene, seed: u64) -> MovedTest {
    moved_test(&adjusted(&drawn(scene, seed)), &mut |_| true).expect("the test was made")
}

/// Whichever view it was moved before, and whatever it was moved by: both are found.
#[test]
fn a_camera_that_was_moved_is_found_with_the_view_and_by_how_much() {
    let pair = Scene::parts(21, cameras(), false, true, false);
    let bubbles = Scene::parts(22, cameras(), true, false, false);
    for (name, parts) in [("plate", plate()), ("misprinted", misprinted()), ("pair", pair), ("bubbles", bubbles)] {
        let views = parts.views.len();
        let mut off = vec![];
        for before in 1..views {
            let step = step();
            let scene = with_steps(&parts, &|v| if v >= before { step } else { Step::zeros() });
            let t = test_of(&scene, 70 + before as u64);
            println!("{name}, before view {before}: {t:?}");
            assert_eq!(t.when, Moved::Before(before), "{name}");
            assert!(t.p_value < 1e-6 && t.degrees >= 5, "{name}: {}", t.p_value);
            let (turn, shift) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
            off.push((t.turn_rad[0] - turn) / t.turn_rad[1]);
            // Of bubbles the baseline, known before the step, is the one length.
            if name != "bubbles" {
                off.push((t.shift_mm[0] - shift) / t.shift_mm[1]);
            }
        }
        let square = off.iter().map(|z| z * z).sum::<f64>() / off.len() as f64;
        println!("{name}: mean z^2 {square:.2} of {}", off.len());
        assert!(square < 3.0, "{name}: {off:?}");
    }
}

/// Where nothing moved, as many are said to have been as chance allows; asked of many steps together, no more, and not none at all.
#[test]
fn cameras_that_stood_still_are_said_to() {
    let runs = share(300, 3) as u64;
    for (name, parts) in [("plate", plate()), ("D10", Problem::of("D10").unwrap().parts)] {
        let scene = parts.scene();
        let p: Vec<f64> = (0..runs).map(|seed| test_of(&scene, 500 + seed).p_value).collect();
        for level in [0.01, 0.05, 0.3] {
            let below = p.iter().filter(|p| **p < level).count() as f64;
            let (expected, n) = (level * runs as f64, runs as f64);
            println!("{name}: {below} of {runs} below {level}");
            assert!(below < expected + 3.0 * (expected * (1.0 - level)).sqrt() + 1.0, "{name}: {below} below {level}");
            // The steps overlap: to ask them together costs less than their number.
            assert!(level < 0.3 || below > 0.2 * level * n, "{name}: {below} below {level}");
        }
    }
}

/// A mount that gives way a little otherwise in each view is no step, of many views and of few.
#[test]
fn views_that_scatter_without_order_are_no_step() {
    let few = Scene::grid_parts(5, cameras(), PLATE);
    let mut fewer = few.clone();
    fewer.views.truncate(5);
    for (parts, most) in [(plate(), 3), (few, 6), (fewer, 6)] {
        let (mut alarms, runs, views) = (0, share(60, 2) as u64, parts.views.len());
        for seed in 0..runs {
            let mut noise = Noise::stream(seed, 9);
            let part = |noise: &mut Noise, k: usize| noise.normal() * if k < 3 { 2e-5 } else { 0.005 };
            let jitter: Vec<Step> = (0..views).map(|_| Step::from_fn(|k, _| part(&mut noise, k))).collect();
            let t = test_of(&with_steps(&parts, &|v| jitter[v]), 40 + seed);
            assert!(t.statistic > 30.0, "felt: {}", t.statistic);
            alarms += u64::from(t.p_value < 0.001);
        }
        println!("{alarms} of {runs} taken for a step, {views} views");
        assert!(60 * alarms <= most * runs, "{alarms} of {runs}, {views} views");
    }
}

#[test]
fn a_drift_is_no_step() {
    let step = step();
    let t = test_of(&with_steps(&plate(), &|v| step * (v as f64 / 11.0)), 3);
    println!("{t:?}");
    assert_eq!(t.when, Moved::Steadily);
    assert!(t.p_value < 1e-3 && (t.turn_rad[0] - step.fixed_rows::<3>(0).norm()).abs() < 3.0 * t.turn_rad[1]);
}

/// The user is told, first of all, and nothing of what the move merely seems to be.
#[test]
fn who_moved_a_camera_is_told() {
    let scene = with_steps(&plate(), &|v| if v >= 7 { step() } else { Step::zeros() });
    let f = diagnosed(&adjusted(&drawn(&scene, 4)));
    println!("{:#?}", f.flags);
    assert!(f.flags[0].contains("one camera was moved between view 6 and view 7 of 12"), "{:?}", f.flags);
    let of_model = |w: &String| w.contains("the images ask for") || w.contains("bent") || w.contains("the dots");
    assert!(!f.flags.iter().any(of_model), "{:#?}", f.flags);
    let row = f.diagnosis.model_tests.iter().find(|t| t.question.contains("did a camera move")).expect("a row");
    assert!(row.needed && row.unit == "degrees" && (row.size - 0.0068).abs() < 0.002, "{row:?}");
}

/// A push by many pixels, which no common adjustment follows: what it stops at is said to be the move, with the view and by how much.
#[test]
fn a_refusal_names_the_move() {
    let pair = Scene::parts(21, cameras(), false, true, false);
    let mut refused = 0;
    for (name, parts) in [("plate", plate()), ("pair", pair)] {
        let views = parts.views.len();
        for before in [views / 2, views - 2, views - 1] {
            for turn in [6e-3, 0.02] {
                let step = Step::from_column_slice(&[turn, 0.6 * turn, -0.3 * turn, 0.0, 0.0, 0.0]);
                let scene = with_steps(&parts, &|v| if v >= before { step } else { Step::zeros() });
                let problem = scene.with_noise(before as u64).problem();
                let Err(error) = calibrate_rig(&problem, &AdjustOptions::default(), &mut |_| true) else { continue };
                let words = error.to_string();
                println!("{name}, before view {before}, {turn}: {words}");
                let when = match before + 1 == views {
                    true => format!("view {before} stands apart from the others, as if one camera was moved before it"),
                    false => format!("one camera was moved between view {} and view {before} of {views}", before - 1),
                };
                let by = words.split("turned by ").nth(1).and_then(|w| w.split(' ').next()?.parse::<f64>().ok());
                let off = by.unwrap_or_else(|| panic!("{words}")) - step.norm().to_degrees();
                assert!(words.contains(&when) && off.abs() < 0.02, "{off}: {words}");
                refused += 1;
            }
        }
    }
    assert!(refused >= 4, "{refused} of 12 were refused");
}
