//! The door from inside: panics, poisoning, memory of any alignment. What a C host can do wrong is in `cpp_tests/interface`.

use super::door::{Fault, destroy, run};
use super::memory::{Filled, give, give_text, rows_of, text_of};
use super::table::{self, Kind};
use super::*;
use crate::dewarp::SheetMap;
use crate::lanes::Column;
use crate::record::Record;
use nalgebra::{Vector2, Vector3};
use std::ffi::{CStr, CString, c_char};

fn context() -> u64 {
    let mut handle = 0;
    assert_eq!(unsafe { spivcal_context_create(1, &mut handle) }, SPIVCAL_OK);
    handle
}

fn error_text(handle: u64) -> String {
    let mut buffer = [0 as c_char; 500];
    let mut needed = 0;
    assert_eq!(unsafe { spivcal_error_text(handle, buffer.as_mut_ptr(), 500, &mut needed) }, SPIVCAL_OK);
    unsafe { CStr::from_ptr(buffer.as_ptr()) }.to_str().unwrap().to_string()
}

#[test]
fn a_panic_is_a_status_and_poisons_its_object_alone() {
    let (broken, whole) = (context(), context());
    let object = table::find(broken).unwrap();
    assert_eq!(run(&object, |_| panic!("seven {}", 7)), SPIVCAL_ERROR_PANIC);
    assert!(error_text(broken).contains("seven 7"));
    let mut rig = 0;
    assert_eq!(unsafe { spivcal_rig_create(broken, &mut rig) }, SPIVCAL_ERROR_POISONED);
    assert_eq!(rig, 0);
    assert_eq!(unsafe { spivcal_rig_create(whole, &mut rig) }, SPIVCAL_OK);
    assert!(error_text(broken).contains("seven 7"), "the text of the panic stays");
    drop(object);
    assert_eq!(spivcal_context_destroy(broken), SPIVCAL_OK);
    assert_eq!(spivcal_context_destroy(broken), SPIVCAL_ERROR_HANDLE);
    assert_eq!(spivcal_context_destroy(whole), SPIVCAL_OK);
    assert_eq!(spivcal_rig_check(rig), SPIVCAL_ERROR_HANDLE, "it ended with its context");
}

#[test]
fn an_object_in_use_ends_when_its_last_call_returns() {
    let handle = context();
    let object = table::find_kind(handle, Kind::Context).unwrap();
    let weak = std::sync::Arc::downgrade(&object);
    let status = run(&object, |_| {
        assert_eq!(destroy(handle, Kind::Context), SPIVCAL_OK);
        assert!(weak.upgrade().is_some());
        Ok(SPIVCAL_OK)
    });
    assert_eq!(status, SPIVCAL_OK);
    drop(object);
    assert!(weak.upgrade().is_none());
}

#[test]
fn the_error_text_is_that_of_the_last_failure() {
    let handle = context();
    assert_eq!(error_text(handle), "");
    let mut rig = 0;
    let path = c"no/such/rig.toml".as_ptr();
    assert_eq!(unsafe { spivcal_rig_load(handle, path, std::ptr::null(), &mut rig) }, SPIVCAL_ERROR_INVALID_INPUT);
    assert!(error_text(handle).contains("no/such/rig.toml: there is no such file"), "{}", error_text(handle));
    assert_eq!(unsafe { spivcal_rig_create(handle, &mut rig) }, SPIVCAL_OK);
    assert!(error_text(handle).contains("rig.toml"), "success leaves it");
    assert_eq!(spivcal_context_destroy(handle), SPIVCAL_OK);
}

#[test]
fn memory_of_any_alignment_is_read_and_written() {
    let mut bytes = [0u8; 64];
    for shift in 0..8 {
        let at = bytes[shift..].as_mut_ptr().cast::<f64>();
        let filled = unsafe { Filled::new(at, 3, "x") }.unwrap();
        (0..3).for_each(|i| filled.set(i, 1.5 * i as f64));
        let column = unsafe { Column::new(at, 3) };
        let read = || [0, 1, 2].map(|i| column.get(i));
        assert_eq!(read(), [0.0, 1.5, 3.0]);
        let mut needed = 0;
        assert_eq!(unsafe { give(&[7.0, 8.0], at, 2, &mut needed) }, Ok(SPIVCAL_OK));
        assert_eq!((read(), needed), ([7.0, 8.0, 3.0], 2));
    }
}

#[test]
fn rows_of_padded_images_are_copied_without_the_padding() {
    let padded: Vec<u8> = (0..40).collect();
    let from = padded[1..].as_ptr().cast::<u16>();
    let rows = unsafe { rows_of(from, 2, 3, 11) }.unwrap();
    let at = |i: usize| u16::from_ne_bytes([padded[1 + i], padded[2 + i]]);
    assert_eq!(rows, [at(0), at(2), at(11), at(13), at(22), at(24)]);
    let refused = |w, h, stride| unsafe { rows_of(from, w, h, stride) }.unwrap_err().status;
    assert_eq!(refused(2, 3, 3), SPIVCAL_ERROR_ARGUMENT);
    assert_eq!(refused(0, 3, 8), SPIVCAL_ERROR_ARGUMENT);
    assert_eq!(refused(2, 3, u64::MAX), SPIVCAL_ERROR_ARGUMENT);
    assert_eq!(refused(1 << 20, 1 << 20, 1 << 21), SPIVCAL_ERROR_ARGUMENT);
}

#[test]
fn texts_keep_their_closing_zero_and_nothing_is_written_where_they_do_not_fit() {
    let mut buffer = [1 as c_char; 8];
    let mut needed = 0;
    assert_eq!(unsafe { give_text("a\0b", buffer.as_mut_ptr(), 8, &mut needed) }, Ok(SPIVCAL_OK));
    assert_eq!(unsafe { CStr::from_ptr(buffer.as_ptr()) }.to_str(), Ok("a\u{fffd}b"));
    assert_eq!(needed, 6);
    let mut small = [1 as c_char; 3];
    let fault: Fault = unsafe { give_text("abc", small.as_mut_ptr(), 3, &mut needed) }.unwrap_err();
    assert_eq!((fault.status, needed, small), (SPIVCAL_ERROR_BUFFER_TOO_SMALL, 4, [1; 3]));
    let bytes = [0x61u8, 0xff, 0];
    let fault = unsafe { text_of(bytes.as_ptr().cast(), "name") }.unwrap_err();
    assert_eq!(
        (fault.status, fault.text.as_str()),
        (SPIVCAL_ERROR_UTF8, "name is not UTF-8: byte 1 begins no character")
    );
}

/// Two cameras with a sheet, in air and behind a window.
const CALIBRATIONS: [&str; 2] = [
    include_str!("../../fuzz/corpus/calibration/scene.json"),
    include_str!("../../fuzz/corpus/calibration/window.json"),
];

/// What the five maps give for lists of three numbers: six lists, of which the first ones are theirs, and the status.
fn mapped(handle: u64, which: usize, from: [&[f64]; 3]) -> ([Vec<f64>; 6], Vec<i32>) {
    let n = from[0].len();
    let mut to = [(); 6].map(|_| vec![7.0; n]);
    let mut status = vec![77; n];
    let ([x, y, z], s, count) = (from.map(<[f64]>::as_ptr), status.as_mut_ptr(), n as u64);
    let [a, b, c, d, e, f] = to.each_mut().map(Vec::as_mut_ptr);
    let answer = unsafe {
        match which {
            0 => spivcal_calibration_project(handle, 0, count, x, y, z, a, b, s),
            1 => spivcal_calibration_unproject(handle, 0, count, x, y, a, b, c, s),
            2 => spivcal_calibration_sight_from_pixel(handle, 0, count, x, y, a, b, c, d, e, f, s),
            3 => spivcal_calibration_sheet_from_pixel(handle, 0, count, x, y, a, b, s),
            _ => spivcal_calibration_pixel_from_sheet(handle, 0, count, x, y, a, b, s),
        }
    };
    let refused = status.iter().any(|s| *s != SPIVCAL_POINT_OK);
    assert_eq!(answer, if refused { SPIVCAL_WARNING_POINTS } else { SPIVCAL_OK });
    (to, status)
}

/// What the plain paths give for one point.
fn plain(record: &Record, which: usize, p: Vector3<f64>) -> Option<Vec<f64>> {
    let camera = record.placed_cameras().unwrap()[0];
    let map = SheetMap::from_record(record, 0).unwrap();
    match which {
        0 => camera.pixel_from_rig(&p).ok().map(|q| vec![q.x, q.y]),
        1 => camera.ray_in_rig(&p.xy()).ok().map(|d| vec![d.x, d.y, d.z]),
        2 => camera.sight_in_rig(&p.xy()).ok().map(|(p, d)| vec![p.x, p.y, p.z, d.x, d.y, d.z]),
        3 => map.sheet_from_pixel(&p.xy(), 0.0).ok().map(|p| vec![p.x, p.y]),
        _ => map.pixel_from_sheet(&p.xy().push(0.0)).ok().map(|q| vec![q.x, q.y]),
    }
}

/// Points in front of the first camera, or pixels, some of them none.
fn points_for(record: &Record, which: usize, n: usize) -> [Vec<f64>; 3] {
    let map = SheetMap::from_record(record, 0).unwrap();
    let size = record.cameras[0].image_size_px.map(|n| n as f64);
    let rig_from_sheet =
        record.sheet.as_ref().unwrap().rig_from_sheet.motion::<crate::frames::Rig, crate::frames::Sheet>();
    let odd = [f64::NAN, f64::INFINITY, -1e300, 1e7, -1e4, 0.0];
    let mut lists = [vec![], vec![], vec![]];
    for i in 0..n {
        let at = |step: f64| (i as f64 * step).fract();
        let mut q = Vector2::new(size[0] * at(0.618_033_988_749), size[1] * at(0.754_877_666_246)).push(500.0);
        match which {
            0 => q = rig_from_sheet.apply(&map.sheet_from_pixel(&q.xy(), 0.0).unwrap().push(at(0.3))),
            4 => q = map.sheet_from_pixel(&q.xy(), 0.0).unwrap().push(0.0),
            _ => {}
        }
        if i % 97 == 41 {
            q[i % 3] = odd[i / 97 % odd.len()];
        }
        (0..3).for_each(|k| lists[k].push(q[k]));
    }
    lists
}

#[test]
fn points_among_others_have_the_bits_that_they_have_alone_and_those_of_the_plain_path_to_rounding() {
    for json in CALIBRATIONS {
        let (record, text, owner) = (Record::from_json(json, "scene").unwrap(), CString::new(json).unwrap(), context());
        let mut handle = 0;
        assert!(unsafe { spivcal_calibration_parse(owner, text.as_ptr(), &mut handle) } >= 0);
        for which in 0..5 {
            let lists = points_for(&record, which, 3001);
            let (found, status) = mapped(handle, which, lists.each_ref().map(|l| &l[..]));
            assert!(status.iter().filter(|s| **s != SPIVCAL_POINT_OK).count() > 10, "map {which}");
            for i in 0..3001 {
                let (alone, why) = mapped(handle, which, lists.each_ref().map(|l| &l[i..=i]));
                let bits = |x: f64| if x.is_nan() { 0 } else { x.to_bits() };
                assert!(
                    (0..6).all(|k| bits(alone[k][0]) == bits(found[k][i])) && why[0] == status[i],
                    "map {which}, {i}"
                );
                match plain(&record, which, Vector3::new(lists[0][i], lists[1][i], lists[2][i])) {
                    None => assert!(status[i] != SPIVCAL_POINT_OK && found[0][i].is_nan(), "map {which}, {i}"),
                    Some(wanted) => {
                        let scale = 1e-13 * (1e3 + wanted.iter().fold(0.0, |a: f64, b| a.max(b.abs())));
                        let near = |(k, w): (usize, &f64)| (found[k][i] - w).abs() < scale;
                        assert!(
                            status[i] == SPIVCAL_POINT_OK && wanted.iter().enumerate().all(near),
                            "map {which}, {i}"
                        );
                    }
                }
            }
        }
        assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
    }
}
