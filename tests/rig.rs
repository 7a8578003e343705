//! From contours alone, without any seed, to the adjusted rig: random rigs with tilts up to 30 degrees, and rigs that must
//! be refused by name.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod rig_scene;

use rig_scene::{Grid, Noise, Scene, tilted_camera};
use spivcal::bundle::{AdjustOptions, Fact, Iteration, State, named_covariance};
use spivcal::camera::{Camera, Intrinsics};
use spivcal::error::{Error, Unusable};
use spivcal::rig::calibrate_rig;

fn random_camera(noise: &mut Noise) -> Camera {
    let tilt = 30_f64.to_radians() * noise.uniform();
    let direction = std::f64::consts::TAU * noise.uniform();
    let mut i = Intrinsics::pinhole(
        8889.0 * (0.9 + 0.2 * noise.uniform()),
        511.5 + 25.0 * noise.normal(),
        383.5 + 25.0 * noise.normal(),
    );
    i.beta_rad = tilt * direction.cos();
    i.alpha_rad = tilt * direction.sin();
    i.k[0] = 0.6 * (noise.uniform() - 0.5);
    Camera::new(i).unwrap()
}

/// `SPIVCAL_RIGS=200` runs the full set; the short one runs by default.
#[test]
fn random_rigs_converge_without_a_seed() {
    let count: u64 = std::env::var("SPIVCAL_RIGS").ok().and_then(|s| s.parse().ok()).unwrap_or(30);
    let (mut failed, mut chi2, mut iterations) = (vec![], 0.0, vec![]);
    for seed in 0..count {
        let mut noise = Noise::new(seed + 1000);
        let cameras = vec![random_camera(&mut noise), random_camera(&mut noise)];
        let scene = Scene::with_cameras(seed, cameras, seed % 3 == 1, true, seed % 3 == 2).with_noise(seed);
        match calibrate_rig(&scene.problem(), &AdjustOptions { rounds: 0, ..Default::default() }, &mut |_| true) {
            Ok(s) if s.adjustment.decrement < 1e-3 => {
                let rows = scene.model.images.iter().flat_map(|i| &i.discs).map(|d| d.edge.u_px.len()).sum::<usize>();
                chi2 += 2.0 * s.adjustment.cost / rows as f64;
                iterations.push(s.adjustment.iterations);
                if 2.0 * s.adjustment.cost / rows as f64 > 1.5 {
                    failed.push(format!("{seed}: wrong minimum, chi2/n {}", 2.0 * s.adjustment.cost / rows as f64));
                }
                assert!(named_covariance(&s.adjustment).is_some());
            }
            Ok(s) => failed.push(format!("{seed}: decrement {}", s.adjustment.decrement)),
            Err(e) => failed.push(format!("{seed}: {e}")),
        }
    }
    iterations.sort_unstable();
    println!(
        "{count} rigs, {} failed, mean chi2/n {:.3}, iterations median {:?} max {:?}",
        failed.len(),
        chi2 / count as f64,
        iterations.get(iterations.len() / 2),
        iterations.last()
    );
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn whoever_stops_the_work_does_not_wait_for_its_end() {
    let problem = Scene::build(5, false, true, false).with_noise(1).problem();
    // 0 and 5: in a camera alone; 20: among the starts of the common adjustment. One held start, its trial and the adjustment itself
    // may each look once more.
    for (after, most) in [(0, 1), (5, 2), (20, 2)] {
        let (mut told, mut later) = (0, 0);
        let mut observe = |_: &Iteration| {
            told += 1;
            later += u32::from(told > after + 1);
            told <= after
        };
        let stopped = calibrate_rig(&problem, &AdjustOptions::default(), &mut observe);
        assert!(matches!(stopped, Err(Error::Unusable(Unusable::Cancelled))), "after {after}");
        assert!(later <= most, "{later} more iterations after {after}");
    }
}

/// A radius is as good a length as the spacing: of either disc of a pair, of both, of a grid's dots; exact or with a sigma.
#[test]
fn a_known_radius_sets_the_scale() {
    let cameras = || [[0.1, 0.02], [-0.12, 0.01]].map(|[b, a]| tilted_camera(b, a)).to_vec();
    let pair = Scene::with_cameras(3, cameras(), false, true, false).with_noise(3);
    let grid = Grid { columns: 5, rows: 4, pitch_mm: 4.0, radius_mm: 1.2, print_error_mm: 0.0, turn: 1.0 };
    let dots = Scene::with_grid(3, cameras(), grid, false).with_noise(3);
    for (scene, radii, sigma_mm) in [
        (&pair, &[1][..], None),
        (&pair, &[2], None),
        (&pair, &[1, 2], None),
        (&pair, &[1], Some(1e-4)),
        (&pair, &[2], Some(1e-4)),
        (&dots, &[1], None),
        (&dots, &[1], Some(1e-4)),
    ] {
        let mut problem = scene.problem();
        problem.model.target.free[0] = true;
        problem.shape_mm[0] = None;
        for &parameter in radii {
            let value_mm = scene.truth.shape_mm[parameter];
            problem.shape_mm[parameter] = Some(value_mm);
            match sigma_mm {
                None => problem.model.target.free[parameter] = false,
                Some(sigma_mm) => problem.model.facts.push(Fact::Shape { parameter, view: None, value_mm, sigma_mm }),
            }
        }
        let solution = calibrate_rig(&problem, &AdjustOptions { rounds: 0, ..Default::default() }, &mut |_| true);
        let found = solution.unwrap_or_else(|e| panic!("{radii:?} {sigma_mm:?}: {e}")).adjustment.state;
        let baseline_mm = |s: &State| s.camera_from_first[1].translation_mm.norm();
        for (name, own, true_mm) in [
            ("spacing", found.shape_mm[0], scene.truth.shape_mm[0]),
            ("baseline", baseline_mm(&found), baseline_mm(&scene.truth)),
        ] {
            assert!((own / true_mm - 1.0).abs() < 2e-3, "{radii:?} {sigma_mm:?}: {name} {own} for {true_mm} mm");
        }
    }
}
