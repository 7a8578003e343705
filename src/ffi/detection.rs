//! Discs in one image.

use super::abi::*;
use super::context::Context;
use super::door::{Fault, Outcome, destroy, enter, lock};
use super::keys::*;
use super::memory::{Out, give, give_text, text_of};
use super::table::{self, Body, Kind, Object};
use crate::detect::{DetectOptions, Detection, Disc, Smoke, find_discs_with};
use crate::pipeline::Workers;
use crate::report::detection_json;
use crate::target::Polarity;
use std::ffi::c_char;

/// Options and, after a run, what was found.
#[derive(Default)]
pub(super) struct DetectionState {
    options: DetectOptions,
    found: Option<Found>,
}

struct Found {
    detection: Detection,
    size_px: [usize; 2],
}

/// Makes an empty detection with the options that serve any target.
///
/// `detection`: receives the handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_detection_create(context: u64, detection: *mut u64) -> i32 {
    enter(context, Kind::Context, |_| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(detection, "detection") }?;
        out.set(table::insert(context, Body::Detection(Default::default()))?);
        Ok(SPIVCAL_OK)
    })
}

/// Sets an option of a detection.
///
/// `key`: one of SPIVCAL_DETECT_*, which say unit and default. `value`: a finite number.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_detection_set_number(detection: u64, key: i32, value: f64) -> i32 {
    on(detection, |state| {
        let o = &mut state.options;
        let refused = |expected: &str| Err(Fault::argument(format!("value {value} of key {key}: expected {expected}")));
        let positive = value.is_finite() && value > 0.0;
        let part = value > 0.0 && value <= 1.0;
        match key {
            SPIVCAL_DETECT_POLARITY => {
                o.polarity = match value {
                    0.0 => Polarity::Auto,
                    1.0 => Polarity::Bright,
                    2.0 => Polarity::Dark,
                    _ => return refused("0 (auto), 1 (bright) or 2 (dark)"),
                }
            }
            SPIVCAL_DETECT_FULL_OF_SMOKE => {
                o.smoke = match value {
                    0.0 => Smoke::Maybe,
                    1.0 => Smoke::Full,
                    2.0 => Smoke::None,
                    _ => return refused("0 (not known), 1 (full of smoke) or 2 (printed, without any)"),
                }
            }
            SPIVCAL_DETECT_MIN_SEMI_MINOR_PX | SPIVCAL_DETECT_MAX_SEMI_MAJOR_PX if !positive => {
                return refused("a positive length in px");
            }
            SPIVCAL_DETECT_MIN_SEMI_MINOR_PX => o.min_semi_minor_px = value,
            SPIVCAL_DETECT_MAX_SEMI_MAJOR_PX => o.max_semi_major_px = value,
            SPIVCAL_DETECT_MIN_AXIS_RATIO | SPIVCAL_DETECT_MIN_COVERAGE if !part => {
                return refused("a number above 0 and at most 1");
            }
            SPIVCAL_DETECT_MIN_AXIS_RATIO => o.min_axis_ratio = value,
            SPIVCAL_DETECT_MIN_COVERAGE => o.min_coverage = value,
            SPIVCAL_DETECT_MIN_CONTRAST_TO_NOISE if !positive => return refused("a positive number"),
            SPIVCAL_DETECT_MIN_CONTRAST_TO_NOISE => o.min_contrast_to_noise = value,
            _ => return Err(unknown_key("SPIVCAL_DETECT_*", key)),
        }
        Ok(SPIVCAL_OK)
    })
}

/// Takes an option of a detection back to its default.
///
/// `key`: one of SPIVCAL_DETECT_*.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_detection_unset(detection: u64, key: i32) -> i32 {
    on(detection, |state| {
        let (o, default) = (&mut state.options, DetectOptions::default());
        match key {
            SPIVCAL_DETECT_POLARITY => o.polarity = default.polarity,
            SPIVCAL_DETECT_FULL_OF_SMOKE => o.smoke = default.smoke,
            SPIVCAL_DETECT_MIN_SEMI_MINOR_PX => o.min_semi_minor_px = default.min_semi_minor_px,
            SPIVCAL_DETECT_MAX_SEMI_MAJOR_PX => o.max_semi_major_px = default.max_semi_major_px,
            SPIVCAL_DETECT_MIN_AXIS_RATIO => o.min_axis_ratio = default.min_axis_ratio,
            SPIVCAL_DETECT_MIN_COVERAGE => o.min_coverage = default.min_coverage,
            SPIVCAL_DETECT_MIN_CONTRAST_TO_NOISE => o.min_contrast_to_noise = default.min_contrast_to_noise,
            _ => return Err(unknown_key("SPIVCAL_DETECT_*", key)),
        }
        Ok(SPIVCAL_OK)
    })
}

/// Finds the discs of an image. What an earlier run found is replaced.
///
/// `image`: handle of the image. Blocks until it is done, some milliseconds for the image of a target, many seconds for one of particles, each of which is
/// looked at; SPIVCAL_DETECT_MIN_SEMI_MINOR_PX near the size of the discs spares most of that. SPIVCAL_OK also where no disc was found: see SPIVCAL_COUNT_DISCS.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_detection_run(detection: u64, image: u64) -> i32 {
    enter(detection, Kind::Detection, |object| {
        let image = image_of(image)?;
        let options = state(object)?.options;
        let Context { threads, memory } = context_of(object)?;
        let found = Workers::new(threads)?.install(|| find_discs_with(&image.view(), &options, &memory))?;
        let found = Found { detection: found, size_px: [image.width(), image.height()] };
        if let Some(replaced) = state(object)?.found.replace(found) {
            memory.take_replaced(replaced.detection);
        }
        Ok(SPIVCAL_OK)
    })
}

/// How many of something a detection holds.
///
/// `key`: SPIVCAL_COUNT_DISCS or SPIVCAL_COUNT_REJECTIONS. `count`: receives the number. SPIVCAL_ERROR_NOT_AVAILABLE before
/// spivcal_detection_run.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_detection_count(detection: u64, key: i32, count: *mut u64) -> i32 {
    on_found(detection, |found| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(count, "count") }?;
        out.set(match key {
            SPIVCAL_COUNT_DISCS => found.detection.discs.len() as u64,
            SPIVCAL_COUNT_REJECTIONS => found.detection.rejections.len() as u64,
            _ => return Err(unknown_key("SPIVCAL_COUNT_*", key)),
        });
        Ok(SPIVCAL_OK)
    })
}

/// Numbers of all discs (SPIVCAL_DISC_*, `disc` is not looked at), or of one disc (SPIVCAL_DISC_COVARIANCE and SPIVCAL_CONTOUR_*).
///
/// `key`: says what, its length and its unit. `disc`: from 0.
/// `buffer`: `capacity` doubles. `needed`: receives their number. `capacity` 0 asks for `needed` alone. SPIVCAL_ERROR_NOT_AVAILABLE before
/// spivcal_detection_run.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_detection_array_copy(
    detection: u64,
    key: i32,
    disc: u64,
    buffer: *mut f64,
    capacity: u64,
    needed: *mut u64,
) -> i32 {
    on_found(detection, |found| {
        let values = array(&found.detection, key, disc)?;
        // SAFETY: the contract of the header.
        unsafe { give(&values, buffer, capacity, needed) }
    })
}

/// Texts of a detection.
///
/// `key`: SPIVCAL_TEXT_JSON (everything that was found, with contours, features of a pair and rejections) or
/// SPIVCAL_TEXT_REJECTION (why candidate `index` was turned down; 0 with the other key). `image_name_utf8`: named in the JSON, may be NULL.
/// `buffer`, `capacity`, `needed`: bytes, as in spivcal_version_copy. SPIVCAL_ERROR_NOT_AVAILABLE before spivcal_detection_run.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_detection_text_copy(
    detection: u64,
    key: i32,
    index: u64,
    image_name_utf8: *const c_char,
    buffer: *mut c_char,
    capacity: u64,
    needed: *mut u64,
) -> i32 {
    on_found(detection, |found| {
        let name = if image_name_utf8.is_null() {
            String::new()
        } else {
            // SAFETY: the contract of the header.
            unsafe { text_of(image_name_utf8, "image_name_utf8") }?
        };
        let text = match key {
            SPIVCAL_TEXT_JSON => {
                Fault::unless_zero(index)?;
                detection_json(&name, found.size_px, &found.detection)
            }
            SPIVCAL_TEXT_REJECTION => {
                let all = &found.detection.rejections;
                let one = usize::try_from(index).ok().and_then(|i| all.get(i));
                one.ok_or_else(|| Fault::index("rejection", index, all.len()))?.reason.to_string()
            }
            _ => return Err(unknown_key("SPIVCAL_TEXT_*", key)),
        };
        // SAFETY: the contract of the header.
        unsafe { give_text(&text, buffer, capacity, needed) }
    })
}

/// Destroys a detection.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_detection_destroy(detection: u64) -> i32 {
    destroy(detection, Kind::Detection)
}

fn array(found: &Detection, key: i32, disc: u64) -> Result<Vec<f64>, Fault> {
    let each = |number: &dyn Fn(&Disc) -> f64| Ok(found.discs.iter().map(number).collect());
    let sigma = |i: usize| each(&move |d: &Disc| d.covariance[(i, i)].max(0.0).sqrt());
    let one = || {
        let one = usize::try_from(disc).ok().and_then(|i| found.discs.get(i));
        one.ok_or_else(|| Fault::index("disc", disc, found.discs.len()))
    };
    match key {
        SPIVCAL_DISC_U_PX => each(&|d| d.ellipse.center_px.u_px),
        SPIVCAL_DISC_V_PX => each(&|d| d.ellipse.center_px.v_px),
        SPIVCAL_DISC_SEMI_MAJOR_PX => each(&|d| d.ellipse.semi_major_px),
        SPIVCAL_DISC_SEMI_MINOR_PX => each(&|d| d.ellipse.semi_minor_px),
        SPIVCAL_DISC_ANGLE_RAD => each(&|d| d.ellipse.angle_rad),
        SPIVCAL_DISC_SIGMA_U_PX => sigma(0),
        SPIVCAL_DISC_SIGMA_V_PX => sigma(1),
        SPIVCAL_DISC_SIGMA_SEMI_MAJOR_PX => sigma(2),
        SPIVCAL_DISC_SIGMA_SEMI_MINOR_PX => sigma(3),
        SPIVCAL_DISC_SIGMA_ANGLE_RAD => sigma(4),
        SPIVCAL_DISC_BLUR_PX => each(&|d| d.blur_px),
        SPIVCAL_DISC_CONTRAST => each(&|d| d.contrast),
        SPIVCAL_DISC_IS_BRIGHT => each(&|d| f64::from(u8::from(d.polarity == Polarity::Bright))),
        SPIVCAL_DISC_COVARIANCE => Ok(one()?.covariance.transpose().as_slice().to_vec()),
        SPIVCAL_CONTOUR_U_PX => Ok(one()?.edge.u_px.clone()),
        SPIVCAL_CONTOUR_V_PX => Ok(one()?.edge.v_px.clone()),
        SPIVCAL_CONTOUR_SIGMA_PX => Ok(one()?.edge.sigma_px.clone()),
        SPIVCAL_REJECTION_U_PX => Ok(found.rejections.iter().map(|r| r.center_px.u_px).collect()),
        SPIVCAL_REJECTION_V_PX => Ok(found.rejections.iter().map(|r| r.center_px.v_px).collect()),
        _ => Err(unknown_key("SPIVCAL_DISC_*, SPIVCAL_CONTOUR_* or SPIVCAL_REJECTION_*", key)),
    }
}

pub(super) fn unknown_key(family: &str, key: i32) -> Fault {
    Fault::argument(format!("key {key} is none of {family} that belong to this function"))
}

/// The image behind a handle that is a further argument.
pub(super) fn image_of(handle: u64) -> Result<std::sync::Arc<crate::image::GrayImage>, Fault> {
    let object = table::find_kind(handle, Kind::Image).map_err(|s| Fault::handle("image", s))?;
    match &object.body {
        Body::Image(image) => Ok(std::sync::Arc::clone(image)),
        _ => Err(Fault::handle("image", SPIVCAL_ERROR_HANDLE_TYPE)),
    }
}

/// The context of an object.
pub(super) fn context_of(object: &Object) -> Result<Context, Fault> {
    match &table::find_kind(object.context, Kind::Context).map_err(|_| table::gone())?.body {
        Body::Context(context) => Ok(context.clone()),
        _ => Err(table::gone()),
    }
}

fn state(object: &Object) -> Result<std::sync::MutexGuard<'_, DetectionState>, Fault> {
    match &object.body {
        Body::Detection(state) => Ok(lock(state)),
        _ => Err(Fault::new(SPIVCAL_ERROR_HANDLE_TYPE, "this is no detection")),
    }
}

fn on(detection: u64, call: impl FnOnce(&mut DetectionState) -> Outcome) -> i32 {
    enter(detection, Kind::Detection, |object| call(&mut *state(object)?))
}

fn on_found(detection: u64, call: impl FnOnce(&Found) -> Outcome) -> i32 {
    on(detection, |state| match &state.found {
        Some(found) => call(found),
        None => {
            Err(Fault::new(SPIVCAL_ERROR_NOT_AVAILABLE, "nothing was searched yet; call spivcal_detection_run first"))
        }
    })
}
