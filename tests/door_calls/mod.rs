//! The C door under random calls: bytes are read as a text, as an image file or as a sequence of calls, and what comes back must be
//! what the header says: a status that it lists and that is no defect, outputs untouched on an error, nothing written beyond a buffer.
//!
//! `tests/door_fuzz.rs` makes the bytes.

#![allow(unsafe_code, dead_code, clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

mod host;

use spivcal::ffi::*;
use std::collections::HashMap;
use std::ffi::{CString, c_char};
use std::sync::OnceLock;

/// One way to read bytes.
pub type Target = fn(&[u8]);
/// All of them; each has a folder of its name in `fuzz/corpus`.
pub const TARGETS: [(&str, Target); 4] =
    [("calls", host::calls), ("rig", rig), ("calibration", calibration), ("image", image)];

/// Runs the target of that name; what it finds is printed and ends the process. (The library silences the panics of its process, since it
/// must not print.)
#[allow(clippy::print_stderr)]
pub fn run(name: &str, data: &[u8]) {
    let all = || TARGETS.iter().filter(|t| t.0 == name).for_each(|t| (t.1)(data));
    if let Err(payload) = std::panic::catch_unwind(all) {
        let words = payload.downcast_ref::<String>().cloned();
        let words = words.or_else(|| payload.downcast_ref::<&str>().map(|s| s.to_string()));
        eprintln!("{name}: {}", words.unwrap_or_default());
        std::process::abort();
    }
}

/// What an output holds before a call.
const UNTOUCHED: u64 = 0x5a5a_5a5a_5a5a_5a5a;

/// The status, which must be one of the header's and none that admits a defect of the library.
fn judged(status: i32) -> i32 {
    let known = (SPIVCAL_ERROR_CANCELLED..=SPIVCAL_WARNING_RUNNING).contains(&status)
        || (SPIVCAL_ERROR_UNUSABLE..=SPIVCAL_ERROR_INVALID_INPUT).contains(&status);
    assert!(known, "status {status}");
    status
}

/// Statuses that a function gives only where the header says so at that function, or at one that its comment names.
const NAMED: [(i32, &str); 9] = [
    (SPIVCAL_WARNING_FLAGGED, "SPIVCAL_WARNING_FLAGGED"),
    (SPIVCAL_WARNING_POINTS, "SPIVCAL_WARNING_POINTS"),
    (SPIVCAL_WARNING_RUNNING, "SPIVCAL_WARNING_RUNNING"),
    (SPIVCAL_ERROR_NOT_AVAILABLE, "SPIVCAL_ERROR_NOT_AVAILABLE"),
    (SPIVCAL_ERROR_RUNNING, "SPIVCAL_ERROR_RUNNING"),
    (SPIVCAL_ERROR_CANCELLED, "SPIVCAL_ERROR_CANCELLED"),
    (SPIVCAL_ERROR_INVALID_INPUT, "SPIVCAL_ERROR_INVALID_INPUT"),
    (SPIVCAL_ERROR_INSUFFICIENT, "SPIVCAL_ERROR_INSUFFICIENT"),
    (SPIVCAL_ERROR_UNUSABLE, "SPIVCAL_ERROR_UNUSABLE"),
];

/// The comment of each function.
fn comments() -> HashMap<&'static str, &'static str> {
    let header = include_str!("../../include/spivcal.h");
    let functions = header.match_indices("\nint32_t spivcal_").filter_map(|(at, _)| {
        let name = header[at + "\nint32_t ".len()..].split_once('(')?.0;
        Some((name, header[..at].rsplit_once("/**")?.1))
    });
    functions.collect()
}

/// The status of the function of that name, which must be one that the header tells its readers to expect.
pub(crate) fn said(name: &str, status: i32) -> i32 {
    static COMMENTS: OnceLock<HashMap<&str, &str>> = OnceLock::new();
    let comments = COMMENTS.get_or_init(comments);
    let own = comments.get(name).unwrap_or_else(|| panic!("{name} is not in the header"));
    if let Some((_, word)) = NAMED.iter().find(|s| s.0 == status) {
        let words = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
        let referred = own.split(words).filter_map(|w| comments.get(w));
        assert!(referred.chain([own]).any(|c| c.contains(word)), "{name}: its comment does not say {word}");
    }
    status
}

/// Calls a function of the header and holds its status against its comment.
macro_rules! call {
    ($function:ident($($argument:expr),* $(,)?)) => {
        $crate::door_calls::said(stringify!($function), $function($($argument),*))
    };
}
pub(crate) use call;

/// A call with one handle or number as its output.
fn made(call: impl FnOnce(*mut u64) -> i32) -> Option<u64> {
    let mut out = UNTOUCHED;
    let status = judged(call(&mut out));
    assert_eq!(status < 0, out == UNTOUCHED, "status {status}, output {out:x}");
    (status >= 0).then_some(out)
}

/// A call that fills a buffer of `capacity`; what it gave.
fn filled<T: Copy + PartialEq>(
    capacity: usize,
    canary: T,
    call: impl FnOnce(*mut T, u64, *mut u64) -> i32,
) -> Option<Vec<T>> {
    let (mut buffer, mut needed) = (vec![canary; capacity + 8], UNTOUCHED);
    let status = judged(call(buffer.as_mut_ptr(), capacity as u64, &mut needed));
    let written = if status < 0 || capacity == 0 { 0 } else { needed as usize };
    assert!(written <= capacity && buffer[written..].iter().all(|x| *x == canary), "written beyond {written}");
    if status < 0 {
        assert!(needed == UNTOUCHED || status == SPIVCAL_ERROR_BUFFER_TOO_SMALL && needed > capacity as u64);
        return None;
    }
    buffer.truncate(written);
    Some(buffer)
}

/// A text of any length; none on an error.
fn text(call: impl Fn(*mut c_char, u64, *mut u64) -> i32) -> Option<String> {
    let needed = made(|n| call(std::ptr::null_mut(), 0, n))?;
    let mut bytes = filled(needed as usize, 0x5a, |b: *mut c_char, c, n| call(b, c, n)).expect("asked for its length");
    assert_eq!(bytes.pop(), Some(0), "texts end with a zero");
    Some(String::from_utf8(bytes.into_iter().map(|b| b as u8).collect()).expect("texts are UTF-8"))
}

fn context(threads: i32) -> u64 {
    // SAFETY: the handle can be written.
    made(|h| unsafe { call!(spivcal_context_create(threads, h)) }).expect("threads are within limits")
}

/// Bytes as a zero-terminated text: up to the first zero.
fn zero_terminated(data: &[u8]) -> CString {
    CString::new(data.split(|b| *b == 0).next().unwrap_or_default()).unwrap_or_default()
}

/// A rig file. What is accepted is written out, read again and then says the same.
fn rig(data: &[u8]) {
    let (context, toml) = (context(1), zero_terminated(data));
    let parse = |toml: &CString| {
        // SAFETY: the text ends with a zero, the handle can be written.
        made(|h| unsafe { call!(spivcal_rig_parse(context, toml.as_ptr(), std::ptr::null(), h)) })
    };
    // SAFETY: `text` gives buffers of the capacity it states.
    let written = |rig: u64| text(|b, c, n| unsafe { call!(spivcal_rig_text_copy(rig, b, c, n)) });
    if let Some(rig) = parse(&toml) {
        let sound = judged(call!(spivcal_rig_check(rig)));
        let once = written(rig).expect("what was read can be written");
        let again = parse(&CString::new(once.clone()).unwrap()).expect("what was written can be read");
        assert_eq!(written(again).as_ref(), Some(&once));
        assert_eq!(judged(call!(spivcal_rig_check(again))), sound, "{once}");
    }
    assert_eq!(call!(spivcal_context_destroy(context)), SPIVCAL_OK);
}

/// A calibration.json. What is accepted can be read in every part, written, and read again.
fn calibration(data: &[u8]) {
    let (context, json) = (context(1), zero_terminated(data));
    let parse = |json: &CString| {
        // SAFETY: the text ends with a zero, the handle can be written.
        made(|h| unsafe { call!(spivcal_calibration_parse(context, json.as_ptr(), h)) })
    };
    // SAFETY: `text` gives buffers of the capacity it states.
    let written =
        |c: u64, key| text(|b, n, needed| unsafe { call!(spivcal_calibration_text_copy(c, key, 0, b, n, needed)) });
    if let Some(handle) = parse(&json) {
        read_all(handle);
        dewarped(context, handle);
        let once = written(handle, SPIVCAL_TEXT_JSON).expect("what was read can be written");
        let again = parse(&CString::new(once.clone()).unwrap()).expect("what was written can be read");
        assert_eq!(written(again, SPIVCAL_TEXT_JSON).as_ref(), Some(&once));
        assert!(written(handle, SPIVCAL_TEXT_REPORT).is_some());
    }
    assert_eq!(call!(spivcal_context_destroy(context)), SPIVCAL_OK);
}

/// Every number, array and text, and points mapped every way.
fn read_all(handle: u64) {
    for key in 200..630 {
        for index in [0, 1, 7] {
            // SAFETY: outputs can be written, buffers have the capacity stated.
            unsafe {
                let (mut value, mut sigma) = (0.0, 0.0);
                judged(call!(spivcal_calibration_number(handle, key, index, &mut value, &mut sigma)));
                filled(40, 1.25e300, |b, c, n| call!(spivcal_calibration_array_copy(handle, key, index, b, c, n)));
                filled(40, 0x5a, |b, c, n| call!(spivcal_calibration_text_copy(handle, key, index, b, c, n)));
                made(|n| call!(spivcal_calibration_count(handle, key, n)));
            }
        }
    }
    let [u, v, z] = [[0.0, 100.0, 5000.0, -1e9], [0.0, 50.0, 5000.0, 1e9], [500.0, 0.0, -3.0, 1e9]];
    for camera in 0..3 {
        let (mut a, mut b, mut c, mut s) = ([0.0; 4], [0.0; 4], [0.0; 4], [0; 4]);
        let mut lines = [[0.0; 4]; 3];
        let [x, y, w] = lines.each_mut().map(|l| l.as_mut_ptr());
        let (a, b, c, s) = (a.as_mut_ptr(), b.as_mut_ptr(), c.as_mut_ptr(), s.as_mut_ptr());
        let (u, v, z) = (u.as_ptr(), v.as_ptr(), z.as_ptr());
        // SAFETY: every array has four elements.
        unsafe {
            judged(call!(spivcal_calibration_project(handle, camera, 4, u, v, z, a, b, s)));
            judged(call!(spivcal_calibration_unproject(handle, camera, 4, u, v, a, b, c, s)));
            judged(call!(spivcal_calibration_sight_from_pixel(handle, camera, 4, u, v, x, y, w, a, b, c, s)));
            judged(call!(spivcal_calibration_sheet_from_pixel(handle, camera, 4, u, v, a, b, s)));
            judged(call!(spivcal_calibration_pixel_from_sheet(handle, camera, 4, u, v, a, b, s)));
            judged(call!(spivcal_calibration_components(handle, 4, u, v, u, v, v, u, x, y, w, a, b, c, x, s)));
        }
    }
}

/// An image of each camera's size, where that is not too large, on a small grid of the sheet.
fn dewarped(context: u64, calibration: u64) {
    let (mut x, mut y, mut side, mut grid_width, mut grid_height) = (0.0, 0.0, 0.0, 0, 0);
    // SAFETY: outputs can be written.
    let status = unsafe {
        let (w, h) = (&mut grid_width, &mut grid_height);
        judged(call!(spivcal_calibration_sheet_grid(calibration, 0.0, &mut x, &mut y, &mut side, w, h)))
    };
    if status != SPIVCAL_OK {
        return;
    }
    for camera in 0..3 {
        let size = [SPIVCAL_CAMERA_WIDTH_PX, SPIVCAL_CAMERA_HEIGHT_PX].map(|key| {
            let (mut value, mut sigma) = (0.0, 0.0);
            // SAFETY: outputs can be written.
            unsafe { judged(call!(spivcal_calibration_number(calibration, key, camera, &mut value, &mut sigma))) };
            value as u32
        });
        if !size.iter().all(|n| (1..=2000).contains(n)) {
            continue;
        }
        let grey = vec![3_u8; (size[0] * size[1]) as usize];
        // SAFETY: images and grids have as many pixels as is said.
        unsafe {
            let (w, h) = (size[0], size[1]);
            let image =
                made(|n| call!(spivcal_image_create_u8(context, grey.as_ptr(), w, h, u64::from(w), n))).unwrap();
            let (mut out, mut seen) = (vec![0.0_f32; 36], vec![0_u8; 36]);
            let (out, seen) = (out.as_mut_ptr(), seen.as_mut_ptr());
            let side = side * f64::from(grid_width.max(grid_height)) / 6.0;
            for kernel in 0..6 {
                judged(call!(spivcal_calibration_dewarp(
                    calibration,
                    camera,
                    image,
                    kernel,
                    x,
                    y,
                    side,
                    0.5,
                    6,
                    6,
                    out,
                    seen
                )));
            }
        }
    }
}

/// An image file. What is accepted has a size, and small ones are searched.
fn image(data: &[u8]) {
    let thread = format!("{:?}", std::thread::current().id()).replace(['(', ')'], "");
    let path = std::env::temp_dir().join(format!("spivcal-door-{}-{thread}", std::process::id()));
    std::fs::write(&path, data).unwrap();
    let (context, name) = (context(1), CString::new(path.to_str().unwrap()).unwrap());
    // SAFETY: the text ends with a zero, outputs can be written.
    unsafe {
        if let Some(image) = made(|h| call!(spivcal_image_load(context, name.as_ptr(), h))) {
            let (mut width, mut height) = (0, 0);
            assert_eq!(call!(spivcal_image_size(image, &mut width, &mut height)), SPIVCAL_OK);
            assert!(width > 0 && height > 0);
            let detection = made(|h| call!(spivcal_detection_create(context, h))).expect("the context is there");
            if u64::from(width) * u64::from(height) <= 1 << 14 {
                judged(call!(spivcal_detection_run(detection, image)));
                text(|b, c, n| {
                    call!(spivcal_detection_text_copy(detection, SPIVCAL_TEXT_JSON, 0, std::ptr::null(), b, c, n))
                });
            }
        }
    }
    assert_eq!(call!(spivcal_context_destroy(context)), SPIVCAL_OK);
    let _ = std::fs::remove_file(&path);
}
