//! A wall that both cameras see besides the particles, and the masks that take it out of the check.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod particle_scene;
mod program;

use nalgebra::Vector2;
use particle_scene::{pairs, plane, scene, truth};
use spivcal::dewarp::SheetMap;
use spivcal::disparity::{CheckOptions, check_sheet, check_sheet_masked};
use spivcal::image::{GrayImage, Pixels};
use spivcal::record::Record;
use spivcal::simulate::simulate_particles;
use std::path::Path;

/// Corner of the wall at the lower left and upper right, mm of the calibrated sheet in which it stands.
const WALL_MM: [[f64; 2]; 2] = [[-28.0, -26.0], [14.0, 26.0]];

/// Rough paint, the same at every moment: levels of 0 to 1 in squares of 0.2 mm.
fn paint(x_mm: f64, y_mm: f64) -> f64 {
    let (i, j) = ((x_mm / 0.2).floor() as i64, (y_mm / 0.2).floor() as i64);
    let mut h = (i.wrapping_mul(73_856_093) ^ j.wrapping_mul(19_349_663)) as u64;
    (0..3).for_each(|_| {
        h = h.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407) ^ (h >> 29)
    });
    (h >> 40) as f64 / (1_u64 << 24) as f64
}

/// The wall in an image, and the mask of a camera that leaves it out.
fn with_wall(image: &GrayImage, map: &SheetMap) -> (GrayImage, GrayImage) {
    let (w, h) = (image.width(), image.height());
    let Pixels::U16(levels) = image.pixels() else { panic!("12 bits") };
    let (mut levels, mut mask) = (levels.clone(), vec![255; w * h]);
    for i in 0..w * h {
        let at = map.sheet_from_pixel(&Vector2::new((i % w) as f64, (i / w) as f64), 0.0).unwrap();
        if (WALL_MM[0][0]..WALL_MM[1][0]).contains(&at.x) && (WALL_MM[0][1]..WALL_MM[1][1]).contains(&at.y) {
            levels[i] = 300 + (2000.0 * paint(at.x, at.y)) as u16;
            mask[i] = 0;
        }
    }
    (GrayImage::new(Pixels::U16(levels), w, h).unwrap(), GrayImage::new(Pixels::U8(mask), w, h).unwrap())
}

struct Walled {
    start: Record,
    real: Record,
    images: Vec<(String, GrayImage)>,
    masks: [GrayImage; 2],
}

/// The light is 0.5 mm off the calibrated sheet and tilted; the wall takes more than half of the field (a fourth is outvoted by particles without a mask).
fn walled(seed: u64) -> Walled {
    let (start, there) = (truth(&scene(seed, 0.0, [0.0; 2], 0.4, 4)), scene(seed, 0.5, [0.3, -0.4], 0.4, 4));
    let maps = [0, 1].map(|c| SheetMap::from_record(&start, c).unwrap());
    let mut images = simulate_particles(&there).unwrap();
    let mut masks = vec![];
    for (k, (_, image)) in images.iter_mut().enumerate() {
        let (walled, mask) = with_wall(image, &maps[k % 2]);
        *image = walled;
        masks.push(mask);
    }
    masks.truncate(2);
    Walled { start, real: truth(&there), images, masks: masks.try_into().unwrap() }
}

#[test]
fn a_wall_draws_the_sheet_to_itself_unless_it_is_left_out() {
    let options = CheckOptions { window_px: 32, refine: true, ..CheckOptions::default() };
    for seed in [1, 2, 3] {
        let Walled { start, real, images, masks } = walled(seed);
        let real_mm = plane(&start, &real).x;
        let masks = masks.each_ref().map(|m| Some(m.view()));
        let found = check_sheet_masked(&start, &pairs(&images), masks, &options).unwrap().check;
        let z = [
            (found.offset_mm - real_mm) / found.offset_sigma_mm,
            (found.tilt_deg[0] - 0.3) / found.tilt_sigma_deg[0],
            (found.tilt_deg[1] + 0.4) / found.tilt_sigma_deg[1],
        ];
        let [used, all] = found.history.last().unwrap().windows;
        println!(
            "{seed}: {used} of {all} windows, {:.4} +- {:.4} mm, z {z:.2?}",
            found.offset_mm, found.offset_sigma_mm
        );
        assert!(found.converged && z.iter().all(|z| z.abs() < 3.5), "{z:?}");
        assert!(used > all / 5 && used < all / 2, "{used} of {all}");
        assert!((found.thickness_mm / 0.4 - 1.0).abs() < 0.25, "{}", found.thickness_mm);
        // No window lies on the wall.
        let map = found.after.as_ref().unwrap();
        let on_wall = |i: &usize| {
            let inside = |x: f64, a: usize| x > WALL_MM[0][a] + 0.5 && x < WALL_MM[1][a] - 0.5;
            inside(map.x_mm[*i], 0) && inside(map.y_mm[*i], 1)
        };
        assert_eq!((0..map.x_mm.len()).filter(on_wall).count(), 0);
        // With the wall in it is another sheet, or none.
        match check_sheet(&start, &pairs(&images), &options) {
            Ok(found) => {
                let z = (found.check.offset_mm - real_mm) / found.check.offset_sigma_mm;
                println!("{seed}: {:.4} mm with the wall, z {z:.1}; {:?}", found.check.offset_mm, found.check.flags);
                assert!(z.abs() > 5.0, "{z}");
                let told = found.check.flags.iter().any(|f| f.contains("different moments are alike"));
                assert!(told, "{:?}", found.check.flags);
            }
            Err(error) => println!("{seed}: {error}"),
        }
    }
}

/// The mean of all images has the wall, and not the particles.
#[test]
fn the_mean_of_the_images_takes_a_wall_off() {
    for seed in [1, 2] {
        let Walled { start, real, images, .. } = walled(seed);
        let real_mm = plane(&start, &real).x;
        let options = CheckOptions { window_px: 32, refine: true, subtract_mean: true, ..CheckOptions::default() };
        let found = check_sheet(&start, &pairs(&images), &options).unwrap().check;
        let z = (found.offset_mm - real_mm) / found.offset_sigma_mm;
        println!("{seed}: {:.4} +- {:.4} mm, z {z:.2}; {:?}", found.offset_mm, found.offset_sigma_mm, found.flags);
        assert!(found.converged && z.abs() < 3.5, "{z}");
        assert!(found.flags.iter().all(|f| !f.contains("are alike")), "{:?}", found.flags);
        let one = check_sheet(&start, &pairs(&images[..2]), &options).unwrap_err().to_string();
        assert!(one.contains("two image pairs at least"), "{one}");
    }
}

/// A mask without black changes no bit, and one camera may have none.
#[test]
fn a_white_mask_leaves_nothing_out() {
    let there = scene(7, 0.3, [0.0; 2], 0.4, 2);
    let (start, images) = (truth(&scene(7, 0.0, [0.0; 2], 0.4, 2)), simulate_particles(&there).unwrap());
    let white = GrayImage::new(Pixels::U8(vec![1; 640 * 512]), 640, 512).unwrap();
    let options = CheckOptions::default();
    let plain = check_sheet(&start, &pairs(&images), &options).unwrap();
    let masked = check_sheet_masked(&start, &pairs(&images), [Some(white.view()), None], &options).unwrap();
    assert_eq!(masked.check, plain.check);
    assert!(plain.check.flags.iter().all(|f| !f.contains("are alike")), "{:?}", plain.check.flags);
}

#[test]
fn the_program_takes_masks_and_tells_those_that_do_not_fit() {
    let Walled { start, images, masks, .. } = walled(4);
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name).display().to_string();
    std::fs::write(path("calibration.json"), start.to_json().unwrap()).unwrap();
    let pgm = |to: &str, image: &GrayImage| {
        let head = |most: u16| format!("P5 {} {} {most}\n", image.width(), image.height()).into_bytes();
        let bytes = match image.pixels() {
            Pixels::U8(p) => [head(255), p.clone()].concat(),
            Pixels::U16(p) => [head(65535), p.iter().flat_map(|x| x.to_be_bytes()).collect()].concat(),
            Pixels::F32(_) => panic!("whole numbers"),
        };
        std::fs::write(Path::new(to), bytes).unwrap();
    };
    for (k, (_, image)) in images.iter().enumerate() {
        pgm(&path(&format!("{}{}.pgm", ["l", "r"][k % 2], k / 2)), image);
    }
    masks.iter().zip(["ml.pgm", "mr.pgm"]).for_each(|(m, name)| pgm(&path(name), m));
    pgm(&path("small.pgm"), &GrayImage::new(Pixels::U8(vec![255; 100]), 10, 10).unwrap());
    pgm(&path("black.pgm"), &GrayImage::new(Pixels::U8(vec![0; 640 * 512]), 640, 512).unwrap());
    let check = |masks: [&str; 2]| {
        let [l, r, out, from] = ["l?.pgm", "r?.pgm", "out", "calibration.json"].map(&path);
        let [a, b] = masks.map(&path);
        let run = program::spivcal(&["check", &from, "--pairs", &l, &r, "--masks", &a, &b, "--refine", "-o", &out]);
        (run.status.code().unwrap(), String::from_utf8(run.stderr).unwrap())
    };
    assert_eq!(check(["ml.pgm", "small.pgm"]).0, 2);
    let (code, told) = check(["black.pgm", "mr.pgm"]);
    assert!(code == 3 && told.contains("camera \"left\" leaves no pixel"), "{code}: {told}");
    let (code, told) = check(["ml.pgm", "missing.pgm"]);
    assert!(code == 2 && told.contains("missing.pgm"), "{code}: {told}");
    assert!(!Path::new(&path("out")).join("check.json").exists());
    let (code, told) = check(["ml.pgm", "mr.pgm"]);
    assert!(code <= 1, "{told}");
    let written = std::fs::read_to_string(Path::new(&path("out")).join("calibration.json")).unwrap();
    assert!(written.contains("4 particle image pair(s), masked"), "the result says so");
}
