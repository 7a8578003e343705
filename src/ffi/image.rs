//! Images from memory and from files.

use super::abi::SPIVCAL_OK;
use super::door::{Fault, Outcome, destroy, enter};
use super::memory::{Out, Plain, rows_of, text_of};
use super::table::{self, Body, Kind};
use crate::image::{GrayImage, Pixels};
use crate::pipeline::load_image;
use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;

/// Image of 8-bit grey levels from memory; see spivcal_image_create_u16.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_image_create_u8(
    context: u64,
    data: *const u8,
    width: u32,
    height: u32,
    stride_bytes: u64,
    image: *mut u64,
) -> i32 {
    // SAFETY: the contract of the header.
    unsafe { create(context, data, [width, height], stride_bytes, image, |pixels| Ok(Pixels::U8(pixels))) }
}

/// Image of 16-bit grey levels from memory (10, 12 and 14 bit cameras deliver them too), in the machine's byte order.
///
/// `data`: first sample of the first row; rows follow from top to bottom, samples from left to right. Any alignment. Copied: the
/// memory may be used again when the call returns.
/// `width`, `height`: px, at least 1 each.
/// `stride_bytes`: bytes from one row to the next, at least those of a row; larger where rows are padded.
/// `image`: receives the handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_image_create_u16(
    context: u64,
    data: *const u16,
    width: u32,
    height: u32,
    stride_bytes: u64,
    image: *mut u64,
) -> i32 {
    // SAFETY: the contract of the header.
    unsafe { create(context, data, [width, height], stride_bytes, image, |pixels| Ok(Pixels::U16(pixels))) }
}

/// Image of floating-point grey levels from memory, all finite; see spivcal_image_create_u16.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_image_create_f32(
    context: u64,
    data: *const f32,
    width: u32,
    height: u32,
    stride_bytes: u64,
    image: *mut u64,
) -> i32 {
    let finite = |pixels: Vec<f32>| match pixels.iter().position(|x| !x.is_finite()) {
        None => Ok(Pixels::F32(pixels)),
        Some(i) => {
            let (u, v) = (i % width as usize, i / width as usize);
            let text = format!("the grey level at ({u}, {v}) px is {}; expected finite numbers", pixels[i]);
            Err(Fault::argument(text))
        }
    };
    // SAFETY: the contract of the header.
    unsafe { create(context, data, [width, height], stride_bytes, image, finite) }
}

/// Image from a file: PNG, TIFF (8, 16 bit, floating point), BMP, PGM, JPEG. Colours become grey; of several pages the first is
/// read, give others by spivcal_image_create_u8 and its like.
///
/// `path_utf8`: zero-terminated. `image`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT where it cannot be read.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_image_load(context: u64, path_utf8: *const c_char, image: *mut u64) -> i32 {
    enter(context, Kind::Context, |_| {
        // SAFETY: the contract of the header.
        let (out, path) = unsafe { (Out::new(image, "image")?, text_of(path_utf8, "path_utf8")?) };
        keep(context, load_image(Path::new(&path))?, out)
    })
}

/// Size of an image.
///
/// `width`, `height`: receive it, px.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_image_size(image: u64, width: *mut u32, height: *mut u32) -> i32 {
    enter(image, Kind::Image, |object| {
        // SAFETY: the contract of the header.
        let (w, h) = unsafe { (Out::new(width, "width")?, Out::new(height, "height")?) };
        let Body::Image(image) = &object.body else { return Err(Fault::argument("image")) };
        w.set(u32::try_from(image.width()).unwrap_or(u32::MAX));
        h.set(u32::try_from(image.height()).unwrap_or(u32::MAX));
        Ok(SPIVCAL_OK)
    })
}

/// Destroys an image. Rigs it was given to keep it.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_image_destroy(image: u64) -> i32 {
    destroy(image, Kind::Image)
}

/// Image of the samples of a caller, of whatever type.
///
/// # Safety
/// `data` is null or every row of `width` samples can be read, `image` is null or can be written.
unsafe fn create<T: Plain>(
    context: u64,
    data: *const T,
    [width, height]: [u32; 2],
    stride_bytes: u64,
    image: *mut u64,
    pixels_of: impl FnOnce(Vec<T>) -> Result<Pixels, Fault>,
) -> i32 {
    enter(context, Kind::Context, |_| {
        // SAFETY: the contract of this function.
        let (out, samples) = unsafe { (Out::new(image, "image")?, rows_of(data, width, height, stride_bytes)?) };
        keep(context, GrayImage::new(pixels_of(samples)?, width as usize, height as usize)?, out)
    })
}

fn keep(context: u64, image: GrayImage, out: Out<u64>) -> Outcome {
    out.set(table::insert(context, Body::Image(Arc::new(image)))?);
    Ok(SPIVCAL_OK)
}
