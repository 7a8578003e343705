//! Dots that are marks by their size take no part in the adjustment.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use spivcal::pipeline::{CalibrateOptions, calibrate};
use spivcal::record::Record;
use spivcal::report::{Level, verdict};
use spivcal::rig_file::RigDescription;
use spivcal::simulate::{Scene, simulate};

/// 63 dots, of which the marks are larger.
fn scene(marks: &str) -> String {
    let camera = |name: &str, lens: &str| {
        format!(
            "[[camera]]\nname = \"{name}\"\nimage_size_px = [1024, 768]\npixel_pitch_mm = 0.00625\nfocal_length_mm = 50.0\nscheimpflug = true\n{lens}\n"
        )
    };
    let poses = [
        ([-4.0, 2.0, 3.0], [24.0, -18.0, 8.0]),
        ([5.0, -2.5, -4.0], [-26.0, 14.0, -12.0]),
        ([3.0, 4.0, 5.0], [12.0, 26.0, 20.0]),
        ([-3.0, -1.0, -3.0], [-14.0, -27.0, 22.0]),
        ([2.0, 0.0, 0.0], [20.0, 20.0, -30.0]),
    ];
    let views: String =
        poses.iter().map(|(p, r)| format!("[[view]]\nposition_mm = {p:?}\nrotation_deg = {r:?}\n")).collect();
    let left = "k = [-0.15, 0.0, 0.0]\naim = { distance_mm = 506.0, viewing_angle_deg = -44.3, elevation_deg = 1.2 }";
    let right = "k = [-0.2, 0.0, 0.0]\naim = { distance_mm = 494.0, viewing_angle_deg = 46.2, elevation_deg = -0.8 }";
    format!(
        "seed = 3\n{}{}[sheet]\noffset_mm = 0.8\ntilt_deg = [0.7, -0.5]\n[target]\nkind = \"dot-grid\"\npolarity = \"dark\"\nspacing_mm = 5.0\n\
         radius_mm = 1.2\ncolumns = 9\nrows = 7\norigin = [4, 3]\nmarks = [{marks}]\n[image]\nblur_sigma_px = 0.8\nbits = 8\nfull_well_e = 25000\n\
         read_noise_e = 12\n{views}[[view]]\nposition_mm = [0.0, 0.0, 0.0]\nrotation_deg = [0.0, 0.0, 0.0]\nsheet = true\n",
        camera("left", left),
        camera("right", right)
    )
}

/// Taken for a dot like the others, one larger dot among 63 moved k1 from -0.15 to -0.82 and the radius by a hundredth, with sigmas enlarged 734 times.
#[test]
fn a_larger_dot_tells_the_axes_and_nothing_else() {
    let at = |column: usize, row: usize| format!("{{ kind = \"large\", column = {column}, row = {row} }}");
    for marks in [at(0, 0), [at(0, 0), at(2, 0), at(0, 1)].join(", ")] {
        let simulation = simulate(&Scene::parse(&scene(&marks), "scene.toml").unwrap()).unwrap();
        let job = RigDescription::parse(&simulation.rig_toml, "rig.toml").unwrap();
        let image = |view: usize, camera: usize| {
            let name = job.views[view].images[camera].as_ref().unwrap();
            Ok(std::sync::Arc::new(simulation.images.iter().find(|(n, _)| n == name).unwrap().1.clone()))
        };
        let out =
            calibrate(&job, &image, &CalibrateOptions::default(), &mut |_| true).unwrap_or_else(|e| panic!("{e}"));
        let (r, truth) = (out.record, Record::from_json(&simulation.truth_json, "truth.json").unwrap());
        println!("{} dots; {:.4} px, sigmas x {:.2}", r.fit.observations, r.fit.rms_px, r.fit.sigma_scale);
        for (found, truth) in r.cameras.iter().zip(&truth.cameras) {
            let z = (found.k1 - truth.k1) / found.sigma.k1;
            println!("{}: k1 {:.4} +- {:.4}, z {z:.2}", found.name, found.k1, found.sigma.k1);
            assert!(z.abs() < 4.0 && found.sigma.k1 < 0.02, "{z}");
        }
        assert!(r.fit.rms_px < 0.01 && r.fit.sigma_scale < 2.0, "{} {}", r.fit.rms_px, r.fit.sigma_scale);
        assert_eq!(verdict(&r).level, Level::Good);
    }
}
