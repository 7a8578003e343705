//! Where the check has nothing to go by, it says so: images of other moments, searches too far; and where particle images are as sharp as they get,
//! it goes by them.

#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod particle_scene;

use particle_scene::{Sharpness, pairs, plane, scene, truth};
use spivcal::disparity::{CheckOptions, check_sheet};
use spivcal::simulate::simulate_particles;

/// Frames out of step are the commonest slip: windows of any size, one pair or several, small images and larger ones.
#[test]
fn images_of_other_moments_give_no_sheet() {
    let large = |seed: u64, pairs: usize| {
        let angles_deg = [-42.0, 35.0];
        Sharpness { pitch_mm: 0.0078, size_px: [1024, 820], blur_px: 1.2, angles_deg }
            .scene(seed, 0.0, [0.0; 2], 0.6, pairs, 1.5)
    };
    let small = |seed: u64, pairs: usize| scene(seed, 0.0, [0.0; 2], 0.6, pairs);
    for (k, count) in [(0_u64, 1), (1, 1), (2, 2), (3, 3), (4, 1), (5, 2)] {
        let of = |seed: u64| if k < 4 { small(seed, count) } else { large(seed, count) };
        let [mut a, b] = [100 + k, 200 + k].map(|seed| simulate_particles(&of(seed)).unwrap());
        // The right images of other moments.
        (0..count).for_each(|i| a[2 * i + 1] = b[2 * i + 1].clone());
        let record = truth(&of(100 + k));
        for (window_px, refine) in [(64, true), (32, true), (32, false)] {
            let options = CheckOptions { window_px, refine, ..CheckOptions::default() };
            let refused = check_sheet(&record, &pairs(&a), &options).map(|c| c.check.history);
            println!("{k}, windows of {window_px} px: {refused:?}");
            let message = refused.unwrap_err();
            assert_eq!(message.exit_code(), 3);
            assert!(message.to_string().contains("no common particles"), "{message}");
        }
    }
}

/// Particle images as sharp as a lens makes them, 1 px and less of standard deviation between pixels of either image.
#[test]
fn sharp_particles_in_thin_light_keep_their_windows() {
    for (k, blur_px) in [0.3, 0.4, 0.5, 0.6, 0.9].into_iter().enumerate() {
        let angles_deg = [-42.0, 35.0];
        let sharp = Sharpness { pitch_mm: 0.0125, size_px: [640, 512], blur_px, angles_deg };
        let of = |offset_mm: f64| sharp.scene(31 + k as u64, offset_mm, [0.0; 2], 0.1, 2, 1.5);
        let images = simulate_particles(&of(0.4)).unwrap();
        let (start, real) = (truth(&of(0.0)), truth(&of(0.4)));
        let options = CheckOptions { refine: true, ..CheckOptions::default() };
        let found = check_sheet(&start, &pairs(&images), &options).unwrap();
        let c = &found.check;
        let z = (c.offset_mm - plane(&start, &real).x) / c.offset_sigma_mm;
        let [used, all] = c.history.last().unwrap().windows;
        println!(
            "blur {blur_px} px: {used} of {all} windows, {:.4} +- {:.4} mm, z {z:.2}",
            c.offset_mm, c.offset_sigma_mm
        );
        assert!(10 * used >= 9 * all && c.converged, "{blur_px}: {used} of {all}");
        assert!(z.abs() < 3.5 && c.offset_sigma_mm < 0.01, "{blur_px}: {z}");
    }
}

#[test]
fn a_search_too_far_is_told_how_far_it_may_go() {
    let images = simulate_particles(&scene(7, 0.5, [0.0; 2], 0.6, 1)).unwrap();
    let record = truth(&scene(7, 0.0, [0.0; 2], 0.6, 1));
    let check = |search_mm: f64| {
        check_sheet(&record, &pairs(&images), &CheckOptions { search_mm: Some(search_mm), ..CheckOptions::default() })
    };
    let told = check(500.0).unwrap_err().to_string();
    assert!(told.contains("search") && told.contains("at most"), "{told}");
    // What stands out from chance does not hang on how far was looked.
    let significance = [2.0, 10.0, 20.0].map(|mm| check(mm).unwrap().check.significance);
    println!("{significance:.1?}");
    let most = significance.iter().fold(0.0_f64, |m, s| m.max(*s));
    assert!(significance.iter().all(|s| *s > 15.0 && *s > 0.4 * most), "{significance:?}");
}
