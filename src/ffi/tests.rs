//! The door from inside: panics, poisoning, memory of any alignment. What a C host can do wrong is in `cpp_tests/interface`.

use super::door::{Fault, enter};
use super::memory::{Filled, give, give_text, rows_of, text_of};
use super::table::{self, Kind};
use super::*;
use crate::dewarp::SheetMap;
use crate::lanes::Column;
use crate::record::Record;
use nalgebra::{Vector2, Vector3};
use std::ffi::{CStr, CString, c_char};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Barrier};
use std::time::Duration;

mod rig;
mod velocity;

fn context() -> u64 {
    let mut handle = 0;
    assert_eq!(unsafe { spivcal_context_create(1, &mut handle) }, SPIVCAL_OK);
    handle
}

fn rig(context: u64) -> u64 {
    let mut handle = 0;
    assert_eq!(unsafe { spivcal_rig_create(context, &mut handle) }, SPIVCAL_OK);
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
    let owner = context();
    let (broken, whole) = (rig(owner), rig(owner));
    assert_eq!(enter(broken, Kind::Rig, |_| panic!("seven {}", 7)), SPIVCAL_ERROR_PANIC);
    assert!(error_text(broken).contains("seven 7"));
    let mut view = 99;
    assert_eq!(unsafe { spivcal_rig_add_view(broken, &mut view) }, SPIVCAL_ERROR_POISONED);
    assert_eq!(view, 99);
    assert_eq!(unsafe { spivcal_rig_add_view(whole, &mut view) }, SPIVCAL_OK);
    assert!(error_text(broken).contains("seven 7"), "the text of the panic stays");
    assert_eq!(spivcal_rig_destroy(broken), SPIVCAL_OK);
    assert_eq!(spivcal_rig_destroy(broken), SPIVCAL_ERROR_HANDLE);
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
    assert_eq!(spivcal_rig_check(whole), SPIVCAL_ERROR_HANDLE, "it ended with its context");
}

#[test]
fn a_panic_while_something_is_made_leaves_the_context_and_all_in_it() {
    let owner = context();
    let kept = rig(owner);
    assert_eq!(enter(owner, Kind::Context, |_| panic!("seven {}", 7)), SPIVCAL_ERROR_PANIC);
    let told = error_text(owner);
    assert!(told.contains("seven 7") && told.contains("nothing was made"), "{told}");
    let mut view = 99;
    assert_eq!(unsafe { spivcal_rig_add_view(kept, &mut view) }, SPIVCAL_OK);
    rig(owner);
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn an_object_in_use_ends_when_its_last_call_returns() {
    let owner = context();
    let rig = rig(owner);
    let weak = Arc::downgrade(&table::find(rig).unwrap());
    let status = enter(rig, Kind::Rig, |_| {
        assert_eq!(spivcal_rig_destroy(rig), SPIVCAL_OK);
        assert!(weak.upgrade().is_some());
        Ok(SPIVCAL_OK)
    });
    assert_eq!(status, SPIVCAL_OK);
    assert!(weak.upgrade().is_none());
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn a_context_ends_after_the_calls_that_are_under_way_in_it() {
    let owner = context();
    let (destroyed, kept) = (rig(owner), rig(owner));
    let (begun, done) = (Barrier::new(3), AtomicUsize::new(0));
    let slow = |handle| {
        enter(handle, Kind::Rig, |_| {
            begun.wait();
            std::thread::sleep(Duration::from_millis(300));
            done.fetch_add(1, Ordering::SeqCst);
            Ok(SPIVCAL_OK)
        })
    };
    std::thread::scope(|s| {
        let calls = [destroyed, kept].map(|handle| s.spawn(move || slow(handle)));
        begun.wait();
        assert_eq!(spivcal_rig_destroy(destroyed), SPIVCAL_OK);
        assert_eq!(done.load(Ordering::SeqCst), 0, "a rig does not wait for its calls");
        assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
        assert_eq!(done.load(Ordering::SeqCst), 2);
        calls.into_iter().for_each(|c| assert_eq!(c.join().unwrap(), SPIVCAL_OK));
    });
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
fn a_handle_of_the_wrong_type_is_told_to_the_object_that_it_names() {
    let owner = context();
    let rig = rig(owner);
    let (mut n, mut other) = (0, 0);
    let told = |what| format!("this handle names a rig description; the function takes {what}");
    assert_eq!(spivcal_rig_check(rig), SPIVCAL_ERROR_INVALID_INPUT);
    assert_eq!(unsafe { spivcal_calibration_count(rig, SPIVCAL_COUNT_VIEWS, &mut n) }, SPIVCAL_ERROR_HANDLE_TYPE);
    assert_eq!(error_text(rig), told("a calibration"));
    assert_eq!(spivcal_image_destroy(rig), SPIVCAL_ERROR_HANDLE_TYPE);
    assert_eq!(error_text(rig), told("an image"));
    assert_eq!(unsafe { spivcal_rig_create(rig, &mut other) }, SPIVCAL_ERROR_HANDLE_TYPE);
    assert_eq!(error_text(rig), told("a context"));
    assert_eq!(enter(rig, Kind::Rig, |_| panic!("seven")), SPIVCAL_ERROR_PANIC);
    assert_eq!(spivcal_image_destroy(rig), SPIVCAL_ERROR_HANDLE_TYPE);
    assert!(error_text(rig).contains("seven"), "the text of the panic stays");
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

/// A rig description with one camera, its radii not stated, as a user writes it.
const RIG: &str = "# mine\n[[camera]]\nname = \"left\"\n[target]\nkind = \"two-discs\"\nspacing_mm = 26.0\n[[view]]\nleft = \"file.png\"\n";

fn parsed_rig(context: u64) -> u64 {
    let (text, mut rig) = (CString::new(RIG).unwrap(), 0);
    assert_eq!(unsafe { spivcal_rig_parse(context, text.as_ptr(), std::ptr::null(), &mut rig) }, SPIVCAL_OK);
    rig
}

fn rig_text(rig: u64) -> String {
    let (mut buffer, mut needed) = ([0 as c_char; 3000], 0);
    assert_eq!(unsafe { spivcal_rig_text_copy(rig, buffer.as_mut_ptr(), 3000, &mut needed) }, SPIVCAL_OK);
    unsafe { CStr::from_ptr(buffer.as_ptr()) }.to_str().unwrap().to_string()
}

#[test]
fn a_setter_that_fails_changes_nothing() {
    let owner = context();
    let rig = parsed_rig(owner);
    for (key, index) in [
        (SPIVCAL_RIG_TARGET_RADIUS_MM, 1),
        (SPIVCAL_RIG_TARGET_RADIUS_MM, u64::MAX),
        (SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM, 1),
        (SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, 1),
        (SPIVCAL_RIG_VIEW_PLANE_Z_MM, 1),
    ] {
        assert_eq!(spivcal_rig_set_number(rig, key, index, 10.0), SPIVCAL_ERROR_INDEX, "{key}");
        assert_eq!(rig_text(rig), RIG, "{key}");
        assert_eq!(spivcal_rig_check(rig), SPIVCAL_OK, "{key}: {}", error_text(rig));
    }
    assert_eq!(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, 0, 9.0), SPIVCAL_OK);
    assert_eq!(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, 1, 10.0), SPIVCAL_OK);
    assert!(rig_text(rig).contains("radii_mm = [9.0, 10.0]"), "{}", rig_text(rig));
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn arguments_that_have_no_meaning_are_refused_at_the_call() {
    let owner = context();
    let rig = parsed_rig(owner);
    let mut n = 99;
    let mut told = |wanted: i32, words: &str, call: &mut dyn FnMut(*mut u64) -> i32| {
        assert_eq!(call(&mut n), wanted, "{words}");
        assert!(error_text(rig).contains(words), "{words}: {}", error_text(rig));
        assert_eq!((rig_text(rig).as_str(), n), (RIG, 99), "{words}");
    };
    let (argument, index) = (SPIVCAL_ERROR_ARGUMENT, SPIVCAL_ERROR_INDEX);
    for (name, words) in [(c"bad name!", "letters, digits"), (c"", "letters, digits"), (c"sheet", "[[view]]")] {
        told(argument, words, &mut |n| unsafe { spivcal_rig_add_camera(rig, name.as_ptr(), n) });
    }
    for value in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        for fact in [SPIVCAL_SCALE_BASELINE, SPIVCAL_SCALE_SPACING, SPIVCAL_SCALE_RADIUS] {
            told(argument, &format!("value = {value}"), &mut |_| spivcal_rig_set_scale(rig, fact, 0, 0, value, 0.0));
        }
    }
    let nothing = "counts nothing";
    told(index, nothing, &mut |_| unsafe {
        spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 77, c"bubbles".as_ptr())
    });
    told(index, nothing, &mut |_| spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_SPACING_MM, 1, 9.0));
    told(argument, "ring, large", &mut |_| unsafe { spivcal_rig_add_mark(rig, c"nonsense".as_ptr(), 0, 0, 0) });
    told(argument, "level = 77", &mut |_| unsafe { spivcal_rig_add_mark(rig, c"ring".as_ptr(), 0, 0, 77) });
    told(argument, "path_utf8", &mut |_| unsafe { spivcal_rig_set_image_file(rig, 0, 0, c"".as_ptr()) });
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

/// In a rig, and in a calibration of it.
#[test]
fn the_direction_of_the_distortion_is_set_and_asked() {
    let owner = context();
    let rig = parsed_rig(owner);
    let set = |word: &CStr| unsafe { spivcal_rig_set_text(rig, SPIVCAL_RIG_CAMERA_RADIAL, 0, word.as_ptr()) };
    assert_eq!(set(c"distorted-to-ideal"), SPIVCAL_OK);
    assert!(rig_text(rig).contains("radial = \"distorted-to-ideal\""), "{}", rig_text(rig));
    assert_eq!(spivcal_rig_check(rig), SPIVCAL_OK, "{}", error_text(rig));
    let mut json = full_calibration();
    for (word, wanted) in [("ideal_to_distorted", 0.0), ("distorted_to_ideal", 1.0)] {
        json["cameras"][1]["radial"] = word.into();
        let (_, calibration) = parsed(owner, &json);
        let [mut x, mut y] = [9.0; 2];
        let told = unsafe { spivcal_calibration_number(calibration, SPIVCAL_CAMERA_RADIAL, 1, &mut x, &mut y) };
        assert_eq!((told, x, y.is_nan()), (SPIVCAL_OK, wanted, true), "{word}");
    }
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

/// As in a rig file: some file systems do not tell them apart.
#[test]
fn names_of_cameras_differ_by_more_than_capitals() {
    let (owner, mut n) = (context(), 0);
    let rig = rig(owner);
    let mut add = |name: &CStr| unsafe { spivcal_rig_add_camera(rig, name.as_ptr(), &mut n) };
    assert_eq!([add(c"left"), add(c"Left"), add(c"right")], [SPIVCAL_OK, SPIVCAL_ERROR_ARGUMENT, SPIVCAL_OK]);
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn an_index_that_counts_nothing_must_be_0() {
    let (owner, [mut x, mut y], mut n) = (context(), [0.0; 2], 0);
    let handle = parsed(owner, &full_calibration()).1;
    let none = std::ptr::null_mut();
    for key in [SPIVCAL_BASELINE_MM, SPIVCAL_SHEET_DISTANCE_MM, SPIVCAL_TARGET_SPACING_MM, SPIVCAL_FIT_RMS_PX] {
        let mut number = |index| unsafe { spivcal_calibration_number(handle, key, index, &mut x, &mut y) };
        assert_eq!([0, 9999].map(&mut number), [SPIVCAL_OK, SPIVCAL_ERROR_INDEX], "{key}");
        assert!(error_text(handle).contains("index 9999: this key counts nothing"));
    }
    for key in [SPIVCAL_ARRAY_RIG_FROM_SHEET, SPIVCAL_ARRAY_COVARIANCE, SPIVCAL_ARRAY_TARGET_POINT_LABEL] {
        let array = |index| unsafe { spivcal_calibration_array_copy(handle, key, index, none, 0, &mut n) };
        assert_eq!([0, 9999].map(array), [SPIVCAL_OK, SPIVCAL_ERROR_INDEX], "{key}");
    }
    for key in [SPIVCAL_TEXT_JSON, SPIVCAL_TEXT_REPORT, SPIVCAL_TEXT_HEADLINE, SPIVCAL_TEXT_TARGET_KIND] {
        let text = |index| unsafe { spivcal_calibration_text_copy(handle, key, index, none.cast(), 0, &mut n) };
        assert_eq!([0, 9999].map(text), [SPIVCAL_OK, SPIVCAL_ERROR_INDEX], "{key}");
    }
    assert_eq!(unsafe { spivcal_calibration_number(handle, 330, 0, &mut x, &mut y) }, SPIVCAL_ERROR_ARGUMENT);
    assert_eq!(error_text(handle), "key 330 is none of the number keys that belong to this function");
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn a_calibration_is_saved_under_the_name_of_a_file() {
    let (owner, scratch) = (context(), tempfile::tempdir().unwrap());
    let handle = parsed(owner, &full_calibration()).1;
    for end in ["new/", "new/.", "new/.."] {
        let path = CString::new(format!("{}/{end}", scratch.path().display())).unwrap();
        assert_eq!(unsafe { spivcal_calibration_save(handle, path.as_ptr()) }, SPIVCAL_ERROR_ARGUMENT, "{end}");
        assert!(error_text(handle).contains("names no file"), "{}", error_text(handle));
    }
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0);
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn an_image_from_memory_is_not_called_by_the_name_of_a_file() {
    let owner = context();
    let (rig, mut image, mut calibration) = (parsed_rig(owner), 0, 0);
    unsafe {
        assert_eq!(spivcal_image_create_u8(owner, [7u8; 4096].as_ptr(), 64, 64, 64, &mut image), SPIVCAL_OK);
        assert_eq!(spivcal_rig_set_image(rig, 0, 0, image), SPIVCAL_OK);
        assert_eq!(spivcal_calibration_run(rig, &mut calibration), SPIVCAL_ERROR_INSUFFICIENT);
    }
    let told = error_text(rig);
    assert!(told.contains("view0_camera0") && !told.contains("file.png"), "{told}");
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
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

/// A calibration of the corpus with what a full one holds beside it, as JSON.
fn full_calibration() -> serde_json::Value {
    let mut json: serde_json::Value = serde_json::from_str(CALIBRATIONS[0]).unwrap();
    let point = serde_json::json!({
        "point_mm": [0.0, 1.0], "in_plane_px": 0.1, "in_plane_mm": 0.01, "disparity_px": 0.1, "in_plane_scale": 0.001,
        "out_of_plane_gain": 0.01, "displacement": [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]]
    });
    let list = [0.1, 0.2];
    json["mapping_uncertainty"] = serde_json::json!({
        "middle": point, "largest": point, "by_views": {
            "beyond_noise": true, "disparity": 1.5, "in_plane": null, "in_plane_scale": 1.0, "out_of_plane_gain": 2.0,
            "displacement": [[1.1, 1.2, 1.3], [1.4, null, 1.6], [1.7, 1.8, 1.9]]
        }, "map": {
            "spacing_mm": [1.0, 1.0], "x_mm": list, "y_mm": list, "in_plane_px": list, "disparity_px": list,
            "u_per_u": list, "w_per_w": [], "u_per_w": list, "v_per_w": list, "w_per_u": list
        }
    });
    json
}

fn parsed(context: u64, json: &serde_json::Value) -> (i32, u64) {
    let (text, mut handle) = (CString::new(serde_json::to_string_pretty(json).unwrap()).unwrap(), 0);
    (unsafe { spivcal_calibration_parse(context, text.as_ptr(), &mut handle) }, handle)
}

/// Pointers to the first lists of a document; of many alike the first three.
fn lists(value: &serde_json::Value, at: &str, found: &mut Vec<String>) {
    match value {
        serde_json::Value::Array(list) => {
            found.push(at.to_string());
            list.iter().take(3).enumerate().for_each(|(i, v)| lists(v, &format!("{at}/{i}"), found));
        }
        serde_json::Value::Object(map) => map.iter().for_each(|(k, v)| lists(v, &format!("{at}/{k}"), found)),
        _ => {}
    }
}

#[test]
fn lists_of_any_length_in_a_calibration_are_read_or_refused() {
    let (owner, whole) = (context(), full_calibration());
    assert_eq!(parsed(owner, &whole).0, SPIVCAL_OK, "{}", error_text(owner));
    let mut all = vec![];
    lists(&whole, "", &mut all);
    assert!(all.len() > 60, "{}", all.len());
    for pointer in &all {
        for change in 0..3 {
            let mut json = whole.clone();
            let list = json.pointer_mut(pointer).unwrap().as_array_mut().unwrap();
            match change {
                0 => list.clear(),
                1 => drop(list.pop()),
                _ => list.extend(list.last().cloned()),
            }
            let (status, handle) = parsed(owner, &json);
            if status != SPIVCAL_OK {
                assert_eq!(status, SPIVCAL_ERROR_INVALID_INPUT, "{pointer} {change}: {}", error_text(owner));
                continue;
            }
            for key in 400..630 {
                let (mut x, mut n) = (0.0, 0);
                let got = unsafe {
                    [
                        spivcal_calibration_number(handle, key, 0, &mut x, &mut x),
                        spivcal_calibration_array_copy(handle, key, 0, std::ptr::null_mut(), 0, &mut n),
                        spivcal_calibration_text_copy(handle, key, 0, std::ptr::null_mut(), 0, &mut n),
                    ]
                };
                assert!(!got.contains(&SPIVCAL_ERROR_PANIC), "{pointer} {change} {key}: {}", error_text(handle));
            }
        }
    }
    for (pointer, path) in [
        ("/mapping_uncertainty/largest/displacement", "mapping_uncertainty.largest.displacement: "),
        ("/mapping_uncertainty/middle/displacement/1", "mapping_uncertainty.middle.displacement[1]: "),
        ("/mapping_uncertainty/by_views/displacement", "mapping_uncertainty.by_views.displacement: "),
        ("/mapping_uncertainty/map/y_mm", "mapping_uncertainty.map.y_mm: "),
        ("/mapping_uncertainty/map/u_per_w", "mapping_uncertainty.map.u_per_w: "),
    ] {
        let mut json = whole.clone();
        json.pointer_mut(pointer).unwrap().as_array_mut().unwrap().pop();
        assert_eq!(parsed(owner, &json).0, SPIVCAL_ERROR_INVALID_INPUT, "{pointer}");
        let told = error_text(owner);
        let line: usize = told.split(':').nth(1).unwrap().parse().unwrap();
        assert!(line > 100 && told.contains(path), "{told}");
    }
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

/// What the header says of `spivcal_calibration_load`, and the C++ header relies on.
#[test]
fn a_flagged_calibration_says_so_after_it_was_loaded() {
    let (owner, mut json, [mut x, mut y]) = (context(), full_calibration(), [7.0; 2]);
    json["fit"]["undetermined"] = serde_json::json!([]);
    for (flags, wanted) in [(serde_json::json!([]), 0.0), (serde_json::json!(["look at view 3"]), 1.0)] {
        json["fit"]["flags"] = flags;
        let (status, handle) = parsed(owner, &json);
        assert_eq!(status, SPIVCAL_OK);
        let asked = unsafe { spivcal_calibration_number(handle, SPIVCAL_FIT_VERDICT, 0, &mut x, &mut y) };
        assert_eq!((asked, x), (SPIVCAL_OK, wanted));
    }
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
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
