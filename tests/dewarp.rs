//! Dewarped images against the brightness that was rendered, in the sheet itself; the identity map; the grid.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod scene;

use nalgebra::{Matrix3, Vector3};
use spivcal::camera::{Camera, Intrinsics};
use spivcal::dewarp::{Kernel, SheetGrid, SheetMap, dewarp};
use spivcal::image::{GrayImage, Pixels};
use spivcal::rigid::Motion;
use std::process::Command;

/// Brightness in the sheet, 0 to 1, no wavelength below 0.4 mm (about 7 px).
fn brightness(x: f64, y: f64) -> f64 {
    let wave = |kx: f64, ky: f64, phase: f64| (kx * x + ky * y + phase).cos();
    0.5 + 0.12 * (wave(15.7, 0.0, 0.3) + wave(0.0, 14.1, 1.1) + wave(9.0, 8.0, 2.0) + wave(-4.0, 11.0, 0.7))
}

fn map(camera: usize) -> SheetMap {
    SheetMap::from_record(&scene::record(), camera).unwrap()
}

/// What a camera sees of the brightness, without a pixel's width, times `gain`.
fn seen(map: &SheetMap, gain: f64) -> Vec<f64> {
    let [w, h] = map.size_px();
    let (u, v): (Vec<f64>, Vec<f64>) = (0..w * h).map(|i| ((i % w) as f64, (i / w) as f64)).unzip();
    let p = map.sheet_of_pixel(&u, &v, &vec![0.0; w * h]).unwrap();
    (0..w * h).map(|i| gain * brightness(p.x_mm[i], p.y_mm[i])).collect()
}

/// Root mean square departure from the brightness well inside the common field, grey levels.
fn departure(map: &SheetMap, pixels: Pixels, grid: &SheetGrid, kernel: Kernel, gain: f64) -> f64 {
    let [w, h] = map.size_px();
    let image = GrayImage::new(pixels, w, h).unwrap();
    let out = dewarp(&image.view(), map, grid, kernel, 0.0).unwrap();
    let (mut sum, mut count) = (0.0, 0.0);
    for i in 0..out.valid.len() {
        let (column, row) = (i % grid.width_px, i / grid.width_px);
        assert!(out.valid[i]);
        let [x, y] = grid.point_mm(column as f64, row as f64);
        let level = f64::from(out.image.view().get(column, row));
        sum += (level - gain * brightness(x, y)).powi(2);
        count += 1.0;
    }
    (sum / count).sqrt()
}

#[test]
fn high_order_kernels_reach_the_sampling_floor() {
    let grid = SheetGrid::over([-8.0, -6.0, 8.0, 6.0], 0.05).unwrap();
    for c in 0..2 {
        let map = map(c);
        let clean = seen(&map, 1.0);
        let of = |kernel, gain: f64| {
            let pixels = Pixels::F32(clean.iter().map(|g| (gain * g) as f32).collect());
            departure(&map, pixels, &grid, kernel, gain)
        };
        let all =
            [Kernel::Nearest, Kernel::Linear, Kernel::Cubic, Kernel::Lanczos, Kernel::BSpline].map(|k| of(k, 1.0));
        println!("camera {c}: nearest, linear, cubic, lanczos, b-spline {all:.6?} of full scale");
        assert!(all[0] > 2.0 * all[1] && all[1] > 2.0 * all[2] && all[2] > all[3] && all[3] > all[4]);
        assert!(all[4] < 1e-4 && all[3] < 1e-3, "{all:?}");
        // 8 bit: two roundings, that of the camera (interpolation averages it) and that of the result.
        let floor = (2.0_f64 / 12.0).sqrt();
        for kernel in [Kernel::Lanczos, Kernel::BSpline] {
            let pixels = Pixels::U8(clean.iter().map(|g| (250.0 * g).round() as u8).collect());
            let d = departure(&map, pixels, &grid, kernel, 250.0);
            println!("camera {c}: {kernel:?} in 8 bit {d:.3}, two roundings {floor:.3}");
            assert!(d < 1.1 * floor, "{kernel:?} {d}");
        }
        let pixels = Pixels::U16(clean.iter().map(|g| (60_000.0 * g).round() as u16).collect());
        let d = departure(&map, pixels, &grid, Kernel::BSpline, 60_000.0);
        assert!(d < 6.0, "16 bit: {d}");
    }
}

#[test]
fn a_place_that_is_no_number_is_refused() {
    let (map, grid) = straight(40, 30);
    let image = GrayImage::new(Pixels::U8(vec![7; 40 * 30]), 40, 30).unwrap();
    for z_mm in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let refused = dewarp(&image.view(), &map, &grid, Kernel::Cubic, z_mm).unwrap_err();
        assert_eq!(
            (refused.exit_code(), refused.to_string().contains("a finite number of mm")),
            (2, true),
            "{refused}"
        );
    }
}

/// A camera straight above the sheet, one pixel per mm.
fn straight(w: usize, h: usize) -> (SheetMap, SheetGrid) {
    let (cx, cy) = (0.5 * (w - 1) as f64, 0.5 * (h - 1) as f64);
    let turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let camera = Camera::new(Intrinsics::pinhole(1000.0, cx, cy)).unwrap();
    let map = SheetMap::new(camera, Motion::new(turn, Vector3::new(0.0, 0.0, 1000.0)), [w, h]);
    (map, SheetGrid { origin_mm: [-cx, cy], mm_per_px: 1.0, width_px: w, height_px: h })
}

#[test]
fn the_identity_returns_the_image_to_the_bit() {
    let (w, h) = (61, 47);
    let (map, grid) = straight(w, h);
    let mut x = 12345_u32;
    let mut next = || {
        x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        x >> 8
    };
    for pixels in [
        Pixels::U8((0..w * h).map(|_| next() as u8).collect()),
        Pixels::U16((0..w * h).map(|_| next() as u16).collect()),
        Pixels::F32((0..w * h).map(|_| next() as f32 * 1e-3 - 4000.0).collect()),
    ] {
        let image = GrayImage::new(pixels, w, h).unwrap();
        let out = dewarp(&image.view(), &map, &grid, Kernel::Nearest, 0.0).unwrap();
        assert_eq!(out.image, image);
        assert!(out.valid.iter().all(|v| *v));
        for kernel in [Kernel::Linear, Kernel::Cubic, Kernel::Lanczos, Kernel::BSpline] {
            let same = dewarp(&image.view(), &map, &grid, kernel, 0.0).unwrap();
            if !matches!(image.pixels(), Pixels::F32(_)) {
                assert_eq!(same.image, image, "{kernel:?}");
            }
        }
    }
}

#[test]
fn what_the_camera_does_not_see_is_zero_and_marked() {
    let (map, grid) = straight(61, 47);
    let wider = SheetGrid {
        origin_mm: [grid.origin_mm[0] - 5.0, grid.origin_mm[1] + 3.0],
        width_px: 71,
        height_px: 53,
        ..grid
    };
    let image = GrayImage::new(Pixels::U8(vec![200; 61 * 47]), 61, 47).unwrap();
    let out = dewarp(&image.view(), &map, &wider, Kernel::BSpline, 0.0).unwrap();
    for j in 0..53 {
        for i in 0..71 {
            let inside = (5..66).contains(&i) && (3..50).contains(&j);
            assert_eq!(out.valid[j * 71 + i], inside, "{i} {j}");
            assert_eq!(out.image.view().get(i, j), if inside { 200.0 } else { 0.0 });
        }
    }
    let small = GrayImage::new(Pixels::U8(vec![0; 60 * 47]), 60, 47).unwrap();
    let message = dewarp(&small.view(), &map, &grid, Kernel::Linear, 0.0).unwrap_err().to_string();
    assert!(message.contains("image width = 60") && message.contains("61 px"), "{message}");
}

#[test]
fn the_common_grid_covers_what_both_see_at_the_finest_scale() {
    let maps = [map(0), map(1)];
    let grid = SheetGrid::common(&[&maps[0], &maps[1]], None).unwrap();
    let image = GrayImage::new(Pixels::U8(vec![9; 1024 * 768]), 1024, 768).unwrap();
    let out = maps.each_ref().map(|m| dewarp(&image.view(), m, &grid, Kernel::Nearest, 0.0).unwrap().valid);
    let both = out[0].iter().zip(&out[1]).filter(|(a, b)| **a && **b).count() as f64 / out[0].len() as f64;
    let e = grid.extent_mm();
    println!("{} x {} px of {:.5} mm, both see {:.1} %", grid.width_px, grid.height_px, grid.mm_per_px, 100.0 * both);
    assert!(both > 0.8);
    // Nothing that both see lies a percent beyond the grid.
    let (w, h) = (e[2] - e[0], e[3] - e[1]);
    for t in 0..100 {
        let t = f64::from(t) / 99.0;
        for p in [
            [e[0] - 0.01 * w, e[1] + t * h],
            [e[2] + 0.01 * w, e[1] + t * h],
            [e[0] + t * w, e[1] - 0.01 * h],
            [e[0] + t * w, e[3] + 0.01 * h],
        ] {
            let sees = |m: &SheetMap| {
                let q = m.pixel_of_sheet(&[p[0]], &[p[1]], &[0.0]).unwrap();
                (-0.5..1023.5).contains(&q.u_px[0]) && (-0.5..767.5).contains(&q.v_px[0])
            };
            assert!(!maps.iter().all(sees), "{p:?}");
        }
    }
    let jets = maps[0].pixel_of_sheet_jets(&[0.0], &[0.0], &[0.0]).unwrap();
    let per_mm = jets.du_dx[0].hypot(jets.dv_dx[0]).max(jets.du_dy[0].hypot(jets.dv_dy[0]));
    assert!((grid.mm_per_px * per_mm - 1.0).abs() < 0.05, "{}", grid.mm_per_px * per_mm);
    assert!(
        SheetGrid::over([0.0, 0.0, 1.0, 1.0], 1e-9).is_err() && SheetGrid::over([1.0, 0.0, 1.0, 1.0], 0.1).is_err()
    );
}

#[test]
fn the_program_writes_images_masks_and_scale() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    std::fs::write(at("c.json"), scene::record().to_json().unwrap()).unwrap();
    for c in 0..2 {
        let pixels = Pixels::U16(seen(&map(c), 60_000.0).iter().map(|g| *g as u16).collect());
        let png = spivcal::pipeline::png_bytes(&GrayImage::new(pixels, 1024, 768).unwrap()).unwrap();
        std::fs::write(at(["run_left_1.png", "run_RIGHT_1.png"][c]), png).unwrap();
    }
    let run = |arguments: &[String]| Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).output().unwrap();
    let words = |list: &[&str]| list.iter().map(|s| s.to_string()).collect::<Vec<_>>();
    let mut arguments =
        words(&["dewarp", &at("c.json"), &at("run_left_1.png"), &at("run_RIGHT_1.png"), "-o", &at("out")]);
    arguments.extend(words(&["--extent-mm", "-20,-15.5,20,16"]));
    let output = run(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    println!("{}", String::from_utf8_lossy(&output.stdout));
    let images =
        ["out/run_left_1_dewarped.tif", "out/run_RIGHT_1_dewarped.tif", "out/mask_left.tif", "out/mask_right.tif"]
            .map(|n| spivcal::pipeline::load_image(at(n).as_ref()).unwrap());
    // Both cameras saw one brightness: where both see, they are one image.
    let (mut worst, mut count) = (0.0_f32, 0);
    for j in 5..images[0].height() - 5 {
        for i in 5..images[0].width() - 5 {
            // Away from the border, where samples beyond it are mirrored.
            let whole = |c: usize| {
                let seen = |di: usize, dj: usize| images[2 + c].view().get(i + di - 5, j + dj - 5) > 0.0;
                seen(0, 5) && seen(10, 5) && seen(5, 0) && seen(5, 10)
            };
            if whole(0) && whole(1) {
                worst = worst.max((images[0].view().get(i, j) - images[1].view().get(i, j)).abs());
                count += 1;
            }
        }
    }
    println!("{count} px, largest difference {worst} of 60000");
    assert!(count > 100_000 && worst < 600.0);
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(at("out/dewarp.json")).unwrap()).unwrap();
    assert_eq!(json["grid"]["width_px"], images[0].width());
    // One image again: the other stays listed where the grid is the same, and another grid is refused.
    let told = || serde_json::from_slice::<serde_json::Value>(&std::fs::read(at("out/dewarp.json")).unwrap()).unwrap();
    let mut one = words(&["dewarp", &at("c.json"), &at("run_left_1.png"), "-o", &at("out")]);
    one.extend(words(&["--extent-mm", "-20,-15.5,20,16"]));
    assert_eq!(run(&one).status.code(), Some(0));
    assert_eq!((told()["images"].as_array().unwrap().len(), &told()["grid"]), (2, &json["grid"]));
    one.extend(words(&["--mm-per-px", "0.2"]));
    let output = run(&one);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("another grid"), "{said}");
    assert_eq!(told()["grid"], json["grid"]);
    // A name that says otherwise than --camera, as in reconstruct.
    let mut slip = words(&["dewarp", &at("c.json"), &at("run_left_1.png"), "-o", &at("slip"), "--camera", "right"]);
    slip.extend(words(&["--extent-mm", "-5,-4,5,4"]));
    let output = run(&slip);
    let said = String::from_utf8_lossy(&output.stderr);
    let told = "stands for camera \"right\", but its name is that of camera \"left\"";
    assert!(output.status.code() == Some(1) && said.contains(told) && said.contains("--camera"), "{said}");
    *slip.last_mut().unwrap() = "-5,-4,nan,4".into();
    let output = run(&slip);
    let said = String::from_utf8_lossy(&output.stderr);
    let told = "x_max of the extent = NaN is not allowed: expected a finite number of mm";
    assert!(output.status.code() == Some(2) && said.contains(told), "{said}");
    std::fs::copy(at("run_left_1.png"), at("a.png")).unwrap();
    arguments[2] = at("a.png");
    let output = run(&arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("--camera NAME"), "{said}");
}
