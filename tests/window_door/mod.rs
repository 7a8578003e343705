//! The rig of windows as pictures: what the C door makes of them is what the program makes of them, to the bit.

#![allow(unsafe_code)]

use super::scene;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use spivcal::bundle::WindowModel;
use spivcal::camera::{Camera, Intrinsics, LAYER_NAMES};
use spivcal::ffi::*;
use spivcal::frames::{Cam, Target};
use spivcal::image::{GrayImage, Pixels};
use spivcal::pipeline::png_bytes;
use spivcal::record::Record;
use spivcal::rigid::Motion;
use std::ffi::{CStr, c_char};
use std::path::Path;
use std::process::Command;

const SIZE: [usize; 2] = [400, 300];
/// The cameras of the scene with pixels as wide as four.
const SHRINK: f64 = 4.0;
const DISTANCE_SIGMA_MM: f64 = 3.0;
const TILT_SIGMA_DEG: f64 = 0.3;
const CAMERAS: [&str; 2] = ["left", "right"];

/// A camera of the scene with coarse pixels, turned about its centre until it looks at where it sees `middle`, and that turn.
fn aimed(camera: &Camera, middle: &Vector3<f64>) -> (Camera, Matrix3<f64>) {
    let i = camera.intrinsics();
    let coarse = Intrinsics { f_px: i.f_px / SHRINK, cx_px: 0.5 * SIZE[0] as f64, cy_px: 0.5 * SIZE[1] as f64, ..*i };
    let window = camera.window().unwrap();
    let turn = Rotation3::rotation_between(&window.apparent(middle).unwrap(), &Vector3::z()).unwrap().into_inner();
    (Camera::new(coarse).unwrap().with_window(Some(window.in_frame(&turn))), turn)
}

/// A picture of bright discs (centre x, radius; mm) on the plane z = 0 of the target: every pixel is followed through the window to
/// the plane, and its distance from the nearest outline makes its grey.
fn picture(camera: &Camera, cam_from_target: &Motion<Cam, Target>, discs: [[f64; 2]; 2]) -> GrayImage {
    let target_from_cam = cam_from_target.inverse();
    let met = |u: f64, v: f64| {
        let sight = camera.line_of_sight(&Vector2::new(u, v)).unwrap();
        let (from, along) = (target_from_cam.apply(&sight.from_mm), target_from_cam.rotation * sight.direction);
        from - along * (from.z / along.z)
    };
    let inside_mm = |p: Vector3<f64>| discs.map(|[x, r]| r - (p.x - x).hypot(p.y)).into_iter().fold(f64::MIN, f64::max);
    let grey = |i: usize| {
        let (u, v) = ((i % SIZE[0]) as f64, (i / SIZE[0]) as f64);
        let at = |du: f64, dv: f64| inside_mm(met(u + du, v + dv));
        let slope = Vector2::new(at(0.1, 0.0) - at(-0.1, 0.0), at(0.0, 0.1) - at(0.0, -0.1)).norm() / 0.2;
        let edge = (at(0.0, 0.0) / slope / 1.3).clamp(-1.0, 1.0);
        (110.0 + 70.0 * (1.5 * edge - 0.5 * edge.powi(3)) + ((i * 7919) % 5) as f64).round() as u8
    };
    GrayImage::new(Pixels::U8((0..SIZE[0] * SIZE[1]).map(grey).collect()), SIZE[0], SIZE[1]).unwrap()
}

/// The rig as a file, and one picture per view and camera.
fn rig() -> (String, Vec<[GrayImage; 2]>) {
    let scene = scene(1);
    let mut toml = String::new();
    for (name, window) in CAMERAS.iter().zip(&scene.model.cameras).map(|(n, c)| (n, c.window.unwrap())) {
        let WindowModel { layers, .. } = window;
        toml += &format!(
            "[[camera]]\nname = \"{name}\"\npixel_pitch_mm = 0.025\nfocal_length_mm = 50.0\n[camera.window]\n"
        );
        toml += &format!("distance_mm = {{ value = {}, sigma = {DISTANCE_SIGMA_MM} }}\n", layers[0]);
        (1..5).for_each(|k| toml += &format!("{} = {}\n", LAYER_NAMES[k], layers[k]));
        toml += &format!("tilt_sigma_deg = {TILT_SIGMA_DEG}\n");
    }
    let [spacing, r0, r1] = scene.truth.shape_mm;
    toml += &format!("[target]\nkind = \"two-discs\"\npolarity = \"bright\"\nspacing_mm = {spacing}\n");
    let parts = super::Scene::parts(1, scene.cameras.clone(), false, true, false);
    let sheet = parts.rig_from_sheet.unwrap().translation_mm;
    let aimed = [aimed(&scene.cameras[0], &sheet), aimed(&scene.cameras[1], &parts.cam_from_rig.apply(&sheet))];
    let discs = [0, 1].map(|d| [scene.model.target.nominal_disc(d, &scene.truth.shape_mm).0.x, [r0, r1][d]]);
    let mut pictures = vec![];
    for (v, view) in parts.views.iter().enumerate() {
        toml += &format!("[[view]]\nleft = \"l{v}.png\"\nright = \"r{v}.png\"\nsheet = {}\n", v >= 4);
        let seen = [
            Motion::new(view.rig_from_target.rotation, view.rig_from_target.translation_mm),
            parts.cam_from_rig * view.rig_from_target,
        ];
        pictures.push([0, 1].map(|c| {
            let (camera, turn) = &aimed[c];
            picture(camera, &Motion::new(turn * seen[c].rotation, turn * seen[c].translation_mm), discs)
        }));
    }
    (toml, pictures)
}

fn made(call: impl FnOnce(*mut u64) -> i32) -> u64 {
    let mut handle = 0;
    let status = call(&mut handle);
    assert!(status >= 0, "status {status}");
    handle
}

fn text(handle: u64, call: impl Fn(*mut c_char, u64, *mut u64) -> i32) -> String {
    let mut needed = 0;
    assert!(call(std::ptr::null_mut(), 0, &mut needed) >= 0, "no text of {handle}");
    let mut buffer = vec![0 as c_char; needed as usize];
    assert!(call(buffer.as_mut_ptr(), needed, &mut needed) >= 0);
    // SAFETY: texts end with a zero.
    unsafe { CStr::from_ptr(buffer.as_ptr()) }.to_str().unwrap().to_string()
}

/// The rig by calls alone, pictures from memory.
fn by_calls(context: u64, pictures: &[[GrayImage; 2]]) -> u64 {
    let scene = scene(1);
    // SAFETY (all calls): texts end with a zero, outputs can be written, pictures have the size stated.
    unsafe {
        let rig = made(|h| spivcal_rig_create(context, h));
        let ok =
            |status: i32| assert_eq!(status, SPIVCAL_OK, "{}", text(rig, |b, c, n| spivcal_error_text(rig, b, c, n)));
        for (c, name) in [c"left", c"right"].into_iter().enumerate() {
            assert_eq!(made(|n| spivcal_rig_add_camera(rig, name.as_ptr(), n)), c as u64);
            ok(spivcal_rig_set_number(rig, SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM, c as u64, 0.025));
            ok(spivcal_rig_set_number(rig, SPIVCAL_RIG_CAMERA_FOCAL_LENGTH_MM, c as u64, 50.0));
            ok(spivcal_rig_set_number(rig, SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, c as u64, TILT_SIGMA_DEG));
            for (k, layer) in scene.model.cameras[c].window.unwrap().layers.into_iter().enumerate() {
                let sigma = if k == 0 { DISTANCE_SIGMA_MM } else { 0.0 };
                ok(spivcal_rig_set_known(rig, c as u64, SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM + k as i32, layer, sigma));
            }
        }
        ok(spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 0, c"two-discs".as_ptr()));
        ok(spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_POLARITY, 0, c"bright".as_ptr()));
        ok(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_SPACING_MM, 0, scene.truth.shape_mm[0]));
        for (v, pair) in pictures.iter().enumerate() {
            let view = made(|n| spivcal_rig_add_view(rig, n));
            ok(spivcal_rig_set_number(rig, SPIVCAL_RIG_VIEW_SHEET, view, f64::from(u8::from(v >= 4))));
            for (c, picture) in pair.iter().enumerate() {
                let Pixels::U8(pixels) = picture.pixels() else { unreachable!() };
                let [w, h] = SIZE.map(|n| n as u32);
                let image = made(|i| spivcal_image_create_u8(context, pixels.as_ptr(), w, h, u64::from(w), i));
                ok(spivcal_rig_set_image(rig, view, c as u64, image));
            }
        }
        ok(spivcal_rig_check(rig));
        rig
    }
}

/// The program's calibration of the same pictures in files.
fn by_program(folder: &Path, toml: &str, pictures: &[[GrayImage; 2]]) -> Record {
    std::fs::write(folder.join("rig.toml"), toml).unwrap();
    for (v, [left, right]) in pictures.iter().enumerate() {
        std::fs::write(folder.join(format!("l{v}.png")), png_bytes(left).unwrap()).unwrap();
        std::fs::write(folder.join(format!("r{v}.png")), png_bytes(right).unwrap()).unwrap();
    }
    let out = Command::new(env!("CARGO_BIN_EXE_spivcal"))
        .args([
            "calibrate",
            "--quiet",
            folder.join("rig.toml").to_str().unwrap(),
            "-o",
            folder.join("out").to_str().unwrap(),
        ])
        .output()
        .unwrap();
    assert!(matches!(out.status.code(), Some(0 | 1)), "{}", String::from_utf8_lossy(&out.stderr));
    Record::from_json(&std::fs::read_to_string(folder.join("out/calibration.json")).unwrap(), "calibration.json")
        .unwrap()
}

#[test]
fn the_door_calibrates_behind_windows_as_the_program_does() {
    let (toml, pictures) = rig();
    let folder = tempfile::tempdir().unwrap();
    let wanted = by_program(folder.path(), &toml, &pictures);
    let context = made(|h| unsafe { spivcal_context_create(2, h) });
    let rig = by_calls(context, &pictures);
    let handle = made(|h| unsafe { spivcal_calibration_run(rig, h) });
    let json = text(handle, |b, c, n| unsafe { spivcal_calibration_text_copy(handle, SPIVCAL_TEXT_JSON, 0, b, c, n) });
    let got = Record::from_json(&json, "door").unwrap();
    assert_eq!((&got.cameras, &got.sheet, &got.covariance), (&wanted.cameras, &wanted.sheet, &wanted.covariance));
    for (c, camera) in wanted.cameras.iter().enumerate() {
        let window = camera.window.as_ref().unwrap();
        let number = |key: i32| {
            let (mut value, mut sigma) = (0.0, 0.0);
            assert_eq!(
                unsafe { spivcal_calibration_number(handle, key, c as u64, &mut value, &mut sigma) },
                SPIVCAL_OK
            );
            (value, sigma)
        };
        assert_eq!(number(SPIVCAL_CAMERA_WINDOW_DISTANCE_MM), (window.distance_mm, window.sigma.distance_mm));
        assert_eq!(number(SPIVCAL_CAMERA_WINDOW_N_WATER), (window.n_water, 0.0));
        let normal = [0, 1, 2].map(|k| number(SPIVCAL_CAMERA_WINDOW_NORMAL_X + k).0);
        assert_eq!(normal, window.normal_in_cam);
        let (mut sigma, mut needed) = ([0.0; 3], 0);
        let key = SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD;
        let status =
            unsafe { spivcal_calibration_array_copy(handle, key, c as u64, sigma.as_mut_ptr(), 3, &mut needed) };
        assert_eq!((status, sigma), (SPIVCAL_OK, window.sigma.normal_rad));
        // The window is where it was drawn: a defect of the drawing or of the calibration would show by many sigmas.
        let truth = scene(1).cameras[c].window().unwrap().layers()[0];
        let z = (window.distance_mm - truth) / window.sigma.distance_mm;
        assert!(
            z.abs() < 5.0,
            "camera {c}: distance {} +- {}, drawn {truth}",
            window.distance_mm,
            window.sigma.distance_mm
        );
    }
    maps(handle, &wanted);
    assert_eq!(spivcal_context_destroy(context), SPIVCAL_OK);
}

/// Every map, against each other and against those of the library that the program uses.
fn maps(handle: u64, record: &Record) {
    let (u, v) = ([100.0, 200.0, 270.0], [90.0, 145.0, 200.0]);
    let none = std::ptr::null_mut();
    for (c, placed) in record.placed_cameras().unwrap().iter().enumerate() {
        let map = spivcal::dewarp::SheetMap::from_record(record, c).unwrap();
        let [mut x, mut y, mut z, mut dx, mut dy, mut dz, mut u2, mut v2] = [[0.0; 3]; 8];
        let mut status = [9; 3];
        let c = c as u64;
        // SAFETY: every array has three elements.
        unsafe {
            let (u, v) = (u.as_ptr(), v.as_ptr());
            let (px, py, pz) = (x.as_mut_ptr(), y.as_mut_ptr(), z.as_mut_ptr());
            let (pdx, pdy, pdz) = (dx.as_mut_ptr(), dy.as_mut_ptr(), dz.as_mut_ptr());
            assert_eq!(
                spivcal_calibration_sight_from_pixel(handle, c, 3, u, v, px, py, pz, pdx, pdy, pdz, none),
                SPIVCAL_OK
            );
            // Points on the lines in the water have those pixels as their images.
            let on_line = |k: usize, s: f64| [x[k] + s * dx[k], y[k] + s * dy[k], z[k] + s * dz[k]];
            let far: [[f64; 3]; 3] = std::array::from_fn(|k| on_line(k, 200.0));
            let column = |k: usize| far.map(|p| p[k]);
            let (fx, fy, fz) = (column(0), column(1), column(2));
            let (pu, pv) = (u2.as_mut_ptr(), v2.as_mut_ptr());
            let answer = spivcal_calibration_project(handle, c, 3, fx.as_ptr(), fy.as_ptr(), fz.as_ptr(), pu, pv, none);
            assert_eq!(answer, SPIVCAL_OK);
        }
        for k in 0..3 {
            assert!((u2[k] - u[k]).hypot(v2[k] - v[k]) < 1e-8, "{} {} for {} {}", u2[k], v2[k], u[k], v[k]);
            let (from, along) = placed.sight_in_rig(&Vector2::new(u[k], v[k])).unwrap();
            assert_eq!(([x[k], y[k], z[k]], [dx[k], dy[k], dz[k]]), (from.into(), along.into()));
        }
        // The ray in the air goes from the projection centre to where the line in the water begins (the glass lies between).
        let [mut ax, mut ay, mut az] = [[0.0; 3]; 3];
        // SAFETY: every array has three elements; the point before the glass is one.
        unsafe {
            let (ax, ay, az) = (ax.as_mut_ptr(), ay.as_mut_ptr(), az.as_mut_ptr());
            assert_eq!(
                spivcal_calibration_unproject(handle, c, 3, u.as_ptr(), v.as_ptr(), ax, ay, az, none),
                SPIVCAL_OK
            );
            assert_eq!(
                spivcal_calibration_sheet_from_pixel(
                    handle,
                    c,
                    3,
                    u.as_ptr(),
                    v.as_ptr(),
                    x.as_mut_ptr(),
                    y.as_mut_ptr(),
                    none
                ),
                SPIVCAL_OK
            );
            assert_eq!(
                spivcal_calibration_pixel_from_sheet(
                    handle,
                    c,
                    3,
                    x.as_ptr(),
                    y.as_ptr(),
                    u2.as_mut_ptr(),
                    v2.as_mut_ptr(),
                    none
                ),
                SPIVCAL_OK
            );
        }
        let window = record.cameras[c as usize].window.as_ref().unwrap();
        for k in 0..3 {
            let refracted = Vector3::new(ax[k], ay[k], az[k]).angle(&Vector3::new(dx[k], dy[k], dz[k]));
            assert!(refracted > 1e-4, "the ray goes straight on");
            assert!((u2[k] - u[k]).hypot(v2[k] - v[k]) < 1e-8);
            let p = map.sheet_from_pixel(&Vector2::new(u[k], v[k]), 0.0).unwrap();
            assert_eq!([x[k], y[k]], [p.x, p.y]);
        }
        // A point half way to the glass has no image: it does not lie beyond the window.
        let before =
            placed.cam_from_rig.inverse().apply(&(Vector3::from(window.normal_in_cam) * 0.5 * window.distance_mm));
        // SAFETY: one element each.
        let answer = unsafe {
            spivcal_calibration_project(
                handle,
                c,
                1,
                &before.x,
                &before.y,
                &before.z,
                u2.as_mut_ptr(),
                v2.as_mut_ptr(),
                status.as_mut_ptr(),
            )
        };
        assert_eq!((answer, status[0]), (SPIVCAL_WARNING_POINTS, SPIVCAL_POINT_BEFORE_WINDOW));
        assert!(u2[0].is_nan());
    }
}

#[test]
fn a_description_by_calls_says_what_the_file_says() {
    let (toml, pictures) = rig();
    let context = made(|h| unsafe { spivcal_context_create(1, h) });
    let rig = by_calls(context, &pictures);
    let written = text(rig, |b, c, n| unsafe { spivcal_rig_text_copy(rig, b, c, n) });
    let parsed = |text: &str| spivcal::rig_file::RigDescription::parse(text, "rig.toml").unwrap();
    assert_eq!(parsed(&written).cameras, parsed(&toml).cameras);
    // A window has a distance: a tilt alone is refused with words that say so.
    let bare = made(|h| unsafe { spivcal_rig_create(context, h) });
    made(|n| unsafe { spivcal_rig_add_camera(bare, c"left".as_ptr(), n) });
    assert_eq!(spivcal_rig_set_number(bare, SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, 0, 0.5), SPIVCAL_OK);
    assert_eq!(spivcal_rig_check(bare), SPIVCAL_ERROR_INVALID_INPUT);
    let words = text(bare, |b, c, n| unsafe { spivcal_error_text(bare, b, c, n) });
    assert!(words.contains("distance_mm"), "{words}");
    assert_eq!(spivcal_context_destroy(context), SPIVCAL_OK);
}
