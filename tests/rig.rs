//! From contours alone, without any seed, to the adjusted rig: random rigs with tilts up to 30 degrees, and rigs that must
//! be refused by name.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod rig_scene;

use rig_scene::{Noise, Scene};
use spivcal::bundle::{AdjustOptions, Iteration, named_covariance};
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
