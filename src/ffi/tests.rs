//! The door from inside: panics, poisoning, memory of any alignment. What a C host can do wrong is in `cpp_tests/interface`.

use super::door::{Fault, destroy, run};
use super::memory::{Filled, In, give, give_text, rows_of, text_of};
use super::table::{self, Kind};
use super::*;
use std::ffi::{CStr, c_char};

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
        let read = unsafe { In::new(at.cast_const(), 3, "x") }.unwrap();
        assert_eq!([read.get(0), read.get(1), read.get(2)], [0.0, 1.5, 3.0]);
        let mut needed = 0;
        assert_eq!(unsafe { give(&[7.0, 8.0], at, 2, &mut needed) }, Ok(SPIVCAL_OK));
        assert_eq!((read.get(0), read.get(1), read.get(2), needed), (7.0, 8.0, 3.0, 2));
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
