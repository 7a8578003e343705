//! The caller's memory, byte by byte.
//!
//! A pointer of a caller may have any alignment (32-bit LabVIEW packs to one byte), so no reference and no slice is made
//! from it; a length is only used after its product with the size of an element was checked.

use super::abi::{SPIVCAL_ERROR_BUFFER_TOO_SMALL, SPIVCAL_ERROR_UTF8, SPIVCAL_OK};
use super::door::{Fault, Outcome};
use crate::error::{Error, Invalid};
use std::ffi::{CStr, c_char};

/// Elements of the longest array and bytes of the largest image that are taken: what is longer is a mistaken argument, and a mistake
/// that is found here is none in the caller's memory.
const MAX_LENGTH: u64 = 1 << 40;
/// Samples of the largest image that is taken: no camera has a billion, a mistaken size soon has.
const MAX_SAMPLES: u64 = 1 << 30;

/// Numbers that any bits are a valid value of.
pub(super) trait Plain: Copy + Default {}
impl Plain for u8 {}
impl Plain for u16 {}
impl Plain for f32 {}
impl Plain for f64 {}
impl Plain for i32 {}
impl Plain for u32 {}
impl Plain for u64 {}
impl Plain for c_char {}

/// Length in elements that a caller's array can have.
fn checked<T>(count: u64, argument: &str) -> Result<usize, Fault> {
    let limit = isize::MAX as u64 / size_of::<T>().max(1) as u64;
    if count > limit.min(MAX_LENGTH) {
        return Err(Fault::argument(format!("{argument}: {count} elements are more than memory can hold")));
    }
    Ok(count as usize)
}

/// One number that the call gives back.
pub(super) struct Out<T>(*mut T);

impl<T: Plain> Out<T> {
    /// # Safety
    /// `to` is null or can be written for one element.
    pub(super) unsafe fn new(to: *mut T, argument: &str) -> Result<Self, Fault> {
        if to.is_null() { Err(Fault::null(argument)) } else { Ok(Self(to)) }
    }

    pub(super) fn set(self, value: T) {
        // SAFETY: not null, and writable by the contract of `new`.
        unsafe { self.0.write_unaligned(value) }
    }
}

/// Length of an array of the caller, which is null only where it is empty.
pub(super) fn length_of<T: Plain>(array: *const T, count: u64, argument: &str) -> Result<usize, Fault> {
    let count = checked::<T>(count, argument)?;
    if array.is_null() && count > 0 { Err(Fault::null(argument)) } else { Ok(count) }
}

/// An array that the caller wants filled, of a length that both know.
#[derive(Clone, Copy)]
pub(super) struct Filled<T> {
    to: *mut T,
    count: usize,
}

impl<T: Plain> Filled<T> {
    /// # Safety
    /// `to` is null or can be written for `count` elements.
    pub(super) unsafe fn new(to: *mut T, count: u64, argument: &str) -> Result<Self, Fault> {
        Ok(Self { to, count: length_of(to, count, argument)? })
    }

    #[inline]
    pub(super) fn set(&self, i: usize, value: T) {
        assert!(i < self.count);
        // SAFETY: inside the array by the contract of `new`.
        unsafe { self.to.add(i).write_unaligned(value) }
    }

    /// Fills the array, which has as many elements.
    pub(super) fn fill(self, values: impl ExactSizeIterator<Item = T>) {
        assert_eq!(values.len(), self.count);
        values.enumerate().for_each(|(i, value)| self.set(i, value));
    }
}

/// Copies `values` to a caller's buffer of `capacity` elements and says in `needed` how many there are.
///
/// # Safety
/// `buffer` is null or writable for `capacity` elements, `needed` null or writable.
pub(super) unsafe fn give<T: Plain>(values: &[T], buffer: *mut T, capacity: u64, needed: *mut u64) -> Outcome {
    // SAFETY: the contract of this function.
    let needed = unsafe { Out::new(needed, "needed") }?;
    let count = values.len() as u64;
    if capacity == 0 {
        needed.set(count);
        return Ok(SPIVCAL_OK);
    }
    checked::<T>(capacity, "capacity")?;
    if buffer.is_null() {
        return Err(Fault::null("buffer"));
    }
    needed.set(count);
    if capacity < count {
        let text = format!("the buffer holds {capacity} elements, {count} are needed");
        return Err(Fault::new(SPIVCAL_ERROR_BUFFER_TOO_SMALL, text));
    }
    // SAFETY: `count <= capacity` elements are writable; bytes have no alignment; our slice does not overlap the caller's.
    unsafe {
        std::ptr::copy_nonoverlapping(values.as_ptr().cast::<u8>(), buffer.cast::<u8>(), std::mem::size_of_val(values));
    }
    Ok(SPIVCAL_OK)
}

/// Copies a text with its closing zero; `needed` counts that zero. A zero inside becomes the replacement character.
///
/// # Safety
/// As [`give`].
pub(super) unsafe fn give_text(text: &str, buffer: *mut c_char, capacity: u64, needed: *mut u64) -> Outcome {
    let mut bytes = text.replace('\0', "\u{fffd}").into_bytes();
    bytes.push(0);
    // SAFETY: the contract of this function; `c_char` is one byte.
    unsafe { give(&bytes, buffer.cast::<u8>(), capacity, needed) }
}

/// A zero-terminated text of the caller in UTF-8.
///
/// # Safety
/// `text` is null or points to a zero-terminated string.
pub(super) unsafe fn text_of(text: *const c_char, argument: &str) -> Result<String, Fault> {
    if text.is_null() {
        return Err(Fault::null(argument));
    }
    // SAFETY: not null, zero-terminated by the contract.
    let bytes = unsafe { CStr::from_ptr(text) }.to_bytes();
    match std::str::from_utf8(bytes) {
        Ok(text) => Ok(text.to_owned()),
        Err(e) => {
            let at = e.valid_up_to();
            Err(Fault::new(SPIVCAL_ERROR_UTF8, format!("{argument} is not UTF-8: byte {at} begins no character")))
        }
    }
}

/// Rows of an image, `stride_bytes` apart, as one array without gaps.
///
/// # Safety
/// `data` is null or every row of `width` samples can be read.
pub(super) unsafe fn rows_of<T: Plain>(
    data: *const T,
    width: u32,
    height: u32,
    stride_bytes: u64,
) -> Result<Vec<T>, Fault> {
    if data.is_null() {
        return Err(Fault::null("data"));
    }
    if width == 0 || height == 0 {
        return Err(Fault::argument(format!("the image is {width} x {height} px; expected at least 1 x 1")));
    }
    let row_bytes = u64::from(width) * size_of::<T>() as u64;
    if stride_bytes < row_bytes {
        return Err(Fault::argument(format!(
            "stride_bytes = {stride_bytes}, but a row of {width} samples has {row_bytes} bytes"
        )));
    }
    if u64::from(width) * u64::from(height) > MAX_SAMPLES {
        return Err(Fault::argument(format!("the image is {width} x {height} px; at most {MAX_SAMPLES} are read")));
    }
    let total = stride_bytes.checked_mul(u64::from(height)).filter(|n| *n <= MAX_LENGTH && isize::try_from(*n).is_ok());
    if total.is_none() {
        return Err(Fault::argument(format!("{height} rows of {stride_bytes} bytes are more than memory can hold")));
    }
    let (width, height) = (width as usize, height as usize);
    let mut pixels: Vec<T> = Vec::new();
    let what = || format!("an image of {width} x {height} px");
    let bytes = width * height * size_of::<T>();
    pixels.try_reserve_exact(width * height).map_err(|_| Error::from(Invalid::Memory { what: what(), bytes }))?;
    pixels.resize(width * height, T::default());
    for (v, row) in pixels.chunks_exact_mut(width).enumerate() {
        // SAFETY: row `v` begins `v * stride_bytes` after `data` and is readable by the contract; bytes have no alignment.
        unsafe {
            let from = data.cast::<u8>().add(v * stride_bytes as usize);
            std::ptr::copy_nonoverlapping(from, row.as_mut_ptr().cast::<u8>(), row_bytes as usize);
        }
    }
    Ok(pixels)
}
