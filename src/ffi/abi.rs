//! Version, status codes, error texts.

use super::door::{enter_without_object, lock};
use super::memory::give_text;
use super::table;
use std::ffi::c_char;

/// Version of this interface. It grows only when something that a program uses changes its meaning; further functions and keys
/// leave it as it is.
pub const SPIVCAL_ABI_VERSION: i32 = 1;

/// Done.
pub const SPIVCAL_OK: i32 = 0;
/// Done, but something must be looked at before the result is used: see SPIVCAL_TEXT_HEADLINE, SPIVCAL_TEXT_FLAG,
/// SPIVCAL_TEXT_UNDETERMINED.
pub const SPIVCAL_WARNING_FLAGGED: i32 = 1;
/// Done, but some points have no meaning: their results are NaN, their point status says why.
pub const SPIVCAL_WARNING_POINTS: i32 = 2;
/// The time is over and the job still runs.
pub const SPIVCAL_WARNING_RUNNING: i32 = 3;
/// The handle is 0, was destroyed, or never was one.
pub const SPIVCAL_ERROR_HANDLE: i32 = -1;
/// The handle names an object of another type.
pub const SPIVCAL_ERROR_HANDLE_TYPE: i32 = -2;
/// A pointer is NULL that must not be.
pub const SPIVCAL_ERROR_NULL: i32 = -3;
/// A number or key is none of those allowed.
pub const SPIVCAL_ERROR_ARGUMENT: i32 = -4;
/// An index counts beyond what there is.
pub const SPIVCAL_ERROR_INDEX: i32 = -5;
/// The buffer is too small; the number of elements needed was written, nothing else.
pub const SPIVCAL_ERROR_BUFFER_TOO_SMALL: i32 = -6;
/// A text is not UTF-8.
pub const SPIVCAL_ERROR_UTF8: i32 = -7;
/// There is not enough memory, or the system starts no further thread.
pub const SPIVCAL_ERROR_MEMORY: i32 = -8;
/// The object has no such part, for example a calibration without a sheet.
pub const SPIVCAL_ERROR_NOT_AVAILABLE: i32 = -9;
/// The job has not ended yet.
pub const SPIVCAL_ERROR_RUNNING: i32 = -10;
/// The work was stopped by spivcal_job_cancel.
pub const SPIVCAL_ERROR_CANCELLED: i32 = -11;
/// An earlier call on this object ended in SPIVCAL_ERROR_PANIC; it can only be destroyed and asked for its error text.
pub const SPIVCAL_ERROR_POISONED: i32 = -12;
/// A defect of the library. A rig or a detection is poisoned, all other objects are as they were. A context, an image and a calibration, which
/// never change, are not: what was to be made was not made, and the call may be tried again with other input. Of a job only its result is lost.
pub const SPIVCAL_ERROR_PANIC: i32 = -13;
/// A file, a key or a number of the job is wrong: it is the caller's turn.
pub const SPIVCAL_ERROR_INVALID_INPUT: i32 = -20;
/// The images are too few or degenerate: it is the experimenter's turn.
pub const SPIVCAL_ERROR_INSUFFICIENT: i32 = -21;
/// There is a result, but it cannot be used.
pub const SPIVCAL_ERROR_UNUSABLE: i32 = -22;
/// A defect of the library that it noticed itself.
pub const SPIVCAL_ERROR_INTERNAL: i32 = -23;

/// Version of the interface that the library offers; compare with SPIVCAL_ABI_VERSION of the header.
///
/// Returns that number, not a status. Any thread.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_abi_version() -> i32 {
    SPIVCAL_ABI_VERSION
}

/// Version of the library, such as "0.1.0".
///
/// `buffer`: `capacity` bytes, receives the text with its closing zero. `needed`: receives the number of bytes with the zero.
/// `capacity` 0 asks for `needed` alone; `buffer` may then be NULL. Any thread.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_version_copy(buffer: *mut c_char, capacity: u64, needed: *mut u64) -> i32 {
    // SAFETY: the contract of the header.
    enter_without_object(|| unsafe { give_text(env!("CARGO_PKG_VERSION"), buffer, capacity, needed) })
}

/// What a status means, in a few English words; for unknown numbers "unknown status".
///
/// `buffer`, `capacity`, `needed`: as in spivcal_version_copy. Any thread.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_status_text(status: i32, buffer: *mut c_char, capacity: u64, needed: *mut u64) -> i32 {
    // SAFETY: the contract of the header.
    enter_without_object(|| unsafe { give_text(words(status), buffer, capacity, needed) })
}

/// Why the last failed call with `handle` as its first argument failed: one or more English sentences with numbers and what to do
/// next. Empty where none failed. Works for every type of handle, also for poisoned objects.
///
/// `buffer`, `capacity`, `needed`: as in spivcal_version_copy.
/// Two threads that use one object at once may see the text of each other's failure.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_error_text(handle: u64, buffer: *mut c_char, capacity: u64, needed: *mut u64) -> i32 {
    enter_without_object(|| {
        let object = table::find(handle).map_err(|status| super::door::Fault::new(status, ""))?;
        let text = lock(&object.error).clone();
        // SAFETY: the contract of the header.
        unsafe { give_text(&text, buffer, capacity, needed) }
    })
}

fn words(status: i32) -> &'static str {
    match status {
        SPIVCAL_OK => "done",
        SPIVCAL_WARNING_FLAGGED => "done, but look at the flags before using the result",
        SPIVCAL_WARNING_POINTS => "done, but some points have no result",
        SPIVCAL_WARNING_RUNNING => "the job still runs",
        SPIVCAL_ERROR_HANDLE => "no such object: the handle is 0, was destroyed, or never was one",
        SPIVCAL_ERROR_HANDLE_TYPE => "the handle names another type of object",
        SPIVCAL_ERROR_NULL => "a pointer is null that must not be",
        SPIVCAL_ERROR_ARGUMENT => "a number or key is not allowed",
        SPIVCAL_ERROR_INDEX => "an index is out of range",
        SPIVCAL_ERROR_BUFFER_TOO_SMALL => "the buffer is too small",
        SPIVCAL_ERROR_UTF8 => "a text is not UTF-8",
        SPIVCAL_ERROR_MEMORY => "not enough memory, or no further thread",
        SPIVCAL_ERROR_NOT_AVAILABLE => "the object has no such part",
        SPIVCAL_ERROR_RUNNING => "the job has not ended yet",
        SPIVCAL_ERROR_CANCELLED => "the work was stopped",
        SPIVCAL_ERROR_POISONED => "an internal error damaged this object earlier; destroy it",
        SPIVCAL_ERROR_PANIC => {
            "internal error; a rig or detection can only be destroyed then, a context, an image and a calibration are as they were"
        }
        SPIVCAL_ERROR_INVALID_INPUT => "a file, a key or a number is wrong",
        SPIVCAL_ERROR_INSUFFICIENT => "not enough or degenerate data",
        SPIVCAL_ERROR_UNUSABLE => "the result cannot be used",
        SPIVCAL_ERROR_INTERNAL => "internal error",
        _ => "unknown status",
    }
}
