//! Dewarping and three components through the door, against the Rust interface and against displacements that are known.

use super::*;
use crate::dewarp::{Kernel, SheetGrid, dewarp};
use crate::image::{GrayImage, Pixels};

const NONE: *mut i32 = std::ptr::null_mut();

/// A calibration, its maps, and the handles of its context and itself.
fn calibrated(text: &str) -> (u64, u64, Vec<SheetMap>) {
    let owner = context();
    let record = Record::from_json(text, "c.json").unwrap();
    let maps = (0..record.cameras.len()).map(|c| SheetMap::from_record(&record, c).unwrap()).collect();
    let (status, handle) = parsed(owner, &serde_json::from_str(text).unwrap());
    assert!(status >= SPIVCAL_OK, "{}", error_text(owner));
    (owner, handle, maps)
}

fn grid_of(calibration: u64, mm_per_px: f64) -> (i32, SheetGrid) {
    let (mut x, mut y, mut side, mut w, mut h) = (0.0, 0.0, 0.0, 0, 0);
    let status =
        unsafe { spivcal_calibration_sheet_grid(calibration, mm_per_px, &mut x, &mut y, &mut side, &mut w, &mut h) };
    (status, SheetGrid { origin_mm: [x, y], mm_per_px: side, width_px: w as usize, height_px: h as usize })
}

#[test]
fn images_are_dewarped_as_by_the_rust_interface() {
    let (owner, calibration, maps) = calibrated(CALIBRATIONS[0]);
    let all: Vec<&SheetMap> = maps.iter().collect();
    let (status, own) = grid_of(calibration, 0.0);
    assert_eq!((status, own), (SPIVCAL_OK, SheetGrid::common(&all, None).unwrap()));
    let (status, grid) = grid_of(calibration, 8.0 * own.mm_per_px);
    assert_eq!((status, grid), (SPIVCAL_OK, SheetGrid::common(&all, Some(8.0 * own.mm_per_px)).unwrap()));
    let (status, nothing) = grid_of(calibration, -1.0);
    assert_eq!((status, nothing.width_px), (SPIVCAL_ERROR_INVALID_INPUT, 0), "{}", error_text(calibration));
    let [w, h] = maps[1].size_px();
    let levels: Vec<f32> = (0..w * h).map(|i| ((i % w) as f32 * 0.11).sin() * 90.0 + (i / w) as f32 * 0.1).collect();
    let plain = GrayImage::new(Pixels::F32(levels.clone()), w, h).unwrap();
    let mut image = 0;
    let made =
        unsafe { spivcal_image_create_f32(owner, levels.as_ptr(), w as u32, h as u32, 4 * w as u64, &mut image) };
    assert_eq!(made, SPIVCAL_OK);
    let n = grid.width_px * grid.height_px;
    let (mut grey, mut seen) = (vec![7.5_f32; n], vec![9_u8; n]);
    let mut call = |image: u64, kernel: i32, side: f64, z: f64, width: usize| {
        let ([x, y], size) = (grid.origin_mm, [width as u32, grid.height_px as u32]);
        let (to, mask) = (grey.as_mut_ptr(), seen.as_mut_ptr());
        unsafe { spivcal_calibration_dewarp(calibration, 1, image, kernel, x, y, side, z, size[0], size[1], to, mask) }
    };
    let (side, width) = (grid.mm_per_px, grid.width_px);
    assert_eq!(call(image, 5, side, 0.0, width), SPIVCAL_ERROR_ARGUMENT);
    assert!(error_text(calibration).contains("SPIVCAL_KERNEL_*"));
    assert_eq!(call(calibration, 0, side, 0.0, width), SPIVCAL_ERROR_HANDLE_TYPE);
    for (side, z, width) in [(f64::NAN, 0.0, width), (side, f64::NAN, width), (side, 0.0, 0), (side, 0.0, 40_000)] {
        assert_eq!(call(image, 0, side, z, width), SPIVCAL_ERROR_INVALID_INPUT, "{side} {z} {width}");
    }
    let mut small = 0;
    assert_eq!(unsafe { spivcal_image_create_f32(owner, levels.as_ptr(), 9, 9, 36, &mut small) }, SPIVCAL_OK);
    assert_eq!(call(small, 0, side, 0.0, width), SPIVCAL_ERROR_INVALID_INPUT);
    assert!(error_text(calibration).contains("as at the calibration"), "{}", error_text(calibration));
    let kernels = [Kernel::Nearest, Kernel::Linear, Kernel::Cubic, Kernel::Lanczos, Kernel::BSpline];
    for (k, kernel) in kernels.into_iter().enumerate() {
        for z_mm in [0.0, 1.5] {
            assert_eq!(call(image, k as i32, side, z_mm, width), SPIVCAL_OK);
        }
        let again = call(image, k as i32, side, 1.5, width);
        let wanted = dewarp(&plain.view(), &maps[1], &grid, kernel, 1.5).unwrap();
        let Pixels::F32(levels) = wanted.image.pixels() else { panic!("float in, float out") };
        assert!(again == SPIVCAL_OK && wanted.valid.iter().filter(|v| **v).count() > n / 2);
        // What was written last, read through the call's own arrays.
        let (ours, mask) = read(calibration, image, k as i32, &grid);
        assert_eq!(
            ours.iter().map(|x| x.to_bits()).collect::<Vec<_>>(),
            levels.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
        );
        assert!(mask.iter().zip(&wanted.valid).all(|(a, b)| *a == u8::from(*b)));
    }
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

/// On a grid, 1.5 mm before the sheet, into memory at an odd address.
fn read(calibration: u64, image: u64, kernel: i32, grid: &SheetGrid) -> (Vec<f32>, Vec<u8>) {
    let n = grid.width_px * grid.height_px;
    let (mut room, mut mask) = (vec![0_u8; 4 * n + 1], vec![0_u8; n]);
    let ([x, y], side) = (grid.origin_mm, grid.mm_per_px);
    let (w, h) = (grid.width_px as u32, grid.height_px as u32);
    let to = unsafe { room.as_mut_ptr().add(1) }.cast::<f32>();
    let status = unsafe {
        spivcal_calibration_dewarp(calibration, 1, image, kernel, x, y, side, 1.5, w, h, to, mask.as_mut_ptr())
    };
    assert_eq!(status, SPIVCAL_OK);
    let float = |i: usize| f32::from_ne_bytes([0, 1, 2, 3].map(|k| room[1 + 4 * i + k]));
    ((0..n).map(float).collect(), mask)
}

/// Displacements of particles, seen by both cameras at the beginning and at the end of their paths.
#[test]
fn displacements_are_found_in_all_components() {
    let (owner, calibration, maps) = calibrated(CALIBRATIONS[0]);
    let grid = SheetGrid::common(&maps.iter().collect::<Vec<_>>(), None).unwrap();
    let [x0, y0, x1, y1] = grid.extent_mm();
    let seen =
        |c: usize, p: Vector3<f64>| maps[c].sheet_from_pixel(&maps[c].pixel_from_sheet(&p).unwrap(), 0.0).unwrap();
    let n = 40;
    let mut from = [(); 6].map(|_| vec![]);
    let mut truth = vec![];
    for i in 0..n {
        let part = |step: f64| 0.2 + 0.6 * (i as f64 * step).fract();
        let p = Vector3::new(x0 + part(0.618) * (x1 - x0), y0 + part(0.755) * (y1 - y0), 0.0);
        let d = Vector3::new((i as f64).sin(), (i as f64).cos(), 0.7 * (1.3 * i as f64).sin()) * 0.3;
        let planar = [0, 1].map(|c| seen(c, p + 0.5 * d) - seen(c, p - 0.5 * d));
        let row = [p.x, p.y, planar[0].x, planar[0].y, planar[1].x, planar[1].y];
        from.iter_mut().zip(row).for_each(|(list, x)| list.push(x));
        truth.push(d);
    }
    from[2][7] = f64::NAN;
    from[0][8] = f64::INFINITY;
    let mut to = [(); 7].map(|_| vec![5.0; n]);
    let mut status = vec![77; n];
    let [x, y, a, b, c, d] = from.each_ref().map(|l| l.as_ptr());
    let [u, v, w, r, su, sv, sw] = to.each_mut().map(|l| l.as_mut_ptr());
    let s = status.as_mut_ptr();
    let answer =
        unsafe { spivcal_calibration_components(calibration, n as u64, x, y, a, b, c, d, u, v, w, r, su, sv, sw, s) };
    assert_eq!((answer, status[7]), (SPIVCAL_WARNING_POINTS, SPIVCAL_POINT_NOT_FINITE));
    assert!(status[8] != SPIVCAL_POINT_OK && to.iter().all(|l| l[7].is_nan() && l[8].is_nan()));
    for i in (0..n).filter(|i| *i != 7 && *i != 8) {
        let found = Vector3::new(to[0][i], to[1][i], to[2][i]);
        // Third order in the displacement over the distance.
        assert!((found - truth[i]).norm() < 1e-6 && to[3][i] < 1e-6, "{i}: {found} {}", truth[i]);
        assert!(status[i] == SPIVCAL_POINT_OK && (0..2).all(|k| (0.7..3.0).contains(&to[4 + k][i])));
        assert!(to[6][i] > 0.5 && to[6][i].is_finite());
    }
    assert_eq!(
        unsafe { spivcal_calibration_components(calibration, 1, x, y, a, b, c, d, u, v, w, r, su, sv, sw, NONE) },
        SPIVCAL_OK
    );
    // What is read must not be overwritten before: in place, one off, and by the status of the points.
    let before = from.clone();
    let over = from[2].as_mut_ptr();
    for (u, s) in [(over, NONE), (unsafe { over.add(n - 1) }, NONE), (u, over.cast())] {
        assert_eq!(
            unsafe {
                spivcal_calibration_components(calibration, n as u64, x, y, over, b, c, d, u, v, w, r, su, sv, sw, s)
            },
            SPIVCAL_ERROR_ARGUMENT
        );
        assert!(error_text(calibration).contains("lies in the memory of dx1_mm"), "{}", error_text(calibration));
        assert!(from.iter().flatten().map(|x| x.to_bits()).eq(before.iter().flatten().map(|x| x.to_bits())));
    }
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}
