//! Calibrations: load, save, ask.

use super::abi::*;
use super::detection::unknown_key;
use super::door::{Fault, Outcome, destroy, enter};
use super::keys::*;
use super::memory::{Out, give, give_text, text_of};
use super::numbers::{array, number};
use super::results::{CalibrationState, keep, state_of};
use super::table::Kind;
use crate::pipeline::{Output, read_text};
use crate::record::Record;
use crate::report::{residuals_csv, text, verdict};
use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;

/// Loads a calibration from the file calibration.json that the program or spivcal_calibration_save wrote.
///
/// `path_utf8`: the file. `calibration`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT where it cannot be read or holds no calibration.
/// SPIVCAL_OK also where the calibration must be looked at before it is used: ask for SPIVCAL_FIT_VERDICT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_load(
    context: u64,
    path_utf8: *const c_char,
    calibration: *mut u64,
) -> i32 {
    enter(context, Kind::Context, |_| {
        // SAFETY: the contract of the header.
        let (out, path) = unsafe { (Out::new(calibration, "calibration")?, text_of(path_utf8, "path_utf8")?) };
        let json = read_text(Path::new(&path), "a calibration.json")?;
        read(context, &json, &path, out)
    })
}

/// Makes a calibration from the text of a calibration.json.
///
/// `json_utf8`: zero-terminated. `calibration`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT where it holds no calibration.
/// Otherwise as spivcal_calibration_load.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_parse(
    context: u64,
    json_utf8: *const c_char,
    calibration: *mut u64,
) -> i32 {
    enter(context, Kind::Context, |_| {
        // SAFETY: the contract of the header.
        let (out, json) = unsafe { (Out::new(calibration, "calibration")?, text_of(json_utf8, "json_utf8")?) };
        read(context, &json, "calibration", out)
    })
}

fn read(context: u64, json: &str, name: &str, out: Out<u64>) -> Outcome {
    let state = CalibrationState::new(Record::from_json(json, name)?, None)?;
    // Programs compare this with SPIVCAL_OK; the verdict is in the record.
    keep(context, Arc::new(state), out).map(|_| SPIVCAL_OK)
}

/// Saves a calibration as calibration.json (schema version 1), which the program reads too, and every number of which is read back
/// to the bit.
///
/// `path_utf8`: the file; written under a temporary name and renamed, so that a failure leaves the old file. Missing folders are made.
/// SPIVCAL_ERROR_INVALID_INPUT where it cannot be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_save(calibration: u64, path_utf8: *const c_char) -> i32 {
    on(calibration, |state| {
        // SAFETY: the contract of the header.
        let path = unsafe { text_of(path_utf8, "path_utf8") }?;
        // "folder/" ends in no name, though it has a last one.
        let name = Path::new(&path).file_name().and_then(|n| n.to_str()).filter(|n| path.ends_with(n));
        let Some(name) = name else {
            return Err(Fault::argument(format!("path_utf8: \"{path}\" names no file")));
        };
        let path = Path::new(&path);
        let mut output = Output::default();
        output.add(name, state.record.to_json()?);
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        output.commit(folder)?;
        Ok(SPIVCAL_OK)
    })
}

/// How many of something a calibration holds.
///
/// `key`: SPIVCAL_COUNT_*. `count`: receives the number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_count(calibration: u64, key: i32, count: *mut u64) -> i32 {
    on(calibration, |state| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(count, "count") }?;
        let r = &state.record;
        let number = match key {
            SPIVCAL_COUNT_CAMERAS => r.cameras.len(),
            SPIVCAL_COUNT_VIEWS => r.views.len(),
            SPIVCAL_COUNT_SHEETS => usize::from(r.sheet.is_some()),
            SPIVCAL_COUNT_UNDETERMINED => r.fit.undetermined.len(),
            SPIVCAL_COUNT_FLAGS => r.fit.flags.len(),
            SPIVCAL_COUNT_COVARIANCE => r.covariance.names.len(),
            SPIVCAL_COUNT_TARGET_RADII => r.target.radii_mm.len(),
            SPIVCAL_COUNT_TARGET_POINTS => r.target.points.len(),
            _ => return Err(unknown_key("SPIVCAL_COUNT_*", key)),
        };
        out.set(number as u64);
        Ok(SPIVCAL_OK)
    })
}

/// A number of a calibration with its standard deviation.
///
/// `key`: SPIVCAL_CAMERA_*, SPIVCAL_BASELINE_MM, SPIVCAL_AXES_ANGLE_DEG, SPIVCAL_SHEET_*, SPIVCAL_TARGET_*, SPIVCAL_FIT_* or
/// SPIVCAL_VIEW_*, which say unit and what `index` counts (0 where nothing). `value`: receives the number.
/// `sigma`: receives the standard deviation: 0 where the number was held, NaN where it is unknown or the number has none. May be NULL.
/// SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no such number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_number(
    calibration: u64,
    key: i32,
    index: u64,
    value: *mut f64,
    sigma: *mut f64,
) -> i32 {
    on(calibration, |state| {
        // SAFETY: the contract of the header.
        let (value, sigma) = unsafe { (Out::new(value, "value")?, Out::new(sigma, "sigma").ok()) };
        let (number, own_sigma) = number(&state.record, key, index)?;
        value.set(number);
        if let Some(sigma) = sigma {
            sigma.set(own_sigma);
        }
        Ok(SPIVCAL_OK)
    })
}

/// An array of a calibration.
///
/// `key`: SPIVCAL_ARRAY_*, which says length, order, unit and what `index` counts (0 where nothing).
/// `buffer`: `capacity` doubles. `needed`: receives their number. `capacity` 0 asks for `needed` alone. SPIVCAL_ERROR_NOT_AVAILABLE where
/// the calibration has no such array.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_array_copy(
    calibration: u64,
    key: i32,
    index: u64,
    buffer: *mut f64,
    capacity: u64,
    needed: *mut u64,
) -> i32 {
    on(calibration, |state| {
        let values = array(&state.record, key, index)?;
        // SAFETY: the contract of the header.
        unsafe { give(&values, buffer, capacity, needed) }
    })
}

/// A text of a calibration.
///
/// `key`: SPIVCAL_TEXT_*, which says what `index` counts (0 where nothing).
/// `buffer`, `capacity`, `needed`: bytes, as in spivcal_version_copy. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no such text.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_text_copy(
    calibration: u64,
    key: i32,
    index: u64,
    buffer: *mut c_char,
    capacity: u64,
    needed: *mut u64,
) -> i32 {
    on(calibration, |state| {
        let words = words(state, key, index)?;
        // SAFETY: the contract of the header.
        unsafe { give_text(&words, buffer, capacity, needed) }
    })
}

/// Destroys a calibration.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_calibration_destroy(calibration: u64) -> i32 {
    destroy(calibration, Kind::Calibration)
}

fn words(state: &CalibrationState, key: i32, index: u64) -> Result<String, Fault> {
    let r = &state.record;
    let one = |what: &str, all: &[String]| {
        let found = usize::try_from(index).ok().and_then(|i| all.get(i)).cloned();
        found.ok_or_else(|| Fault::index(what, index, all.len()))
    };
    let found = match key {
        SPIVCAL_TEXT_JSON => r.to_json()?,
        SPIVCAL_TEXT_REPORT => text(r),
        SPIVCAL_TEXT_RESIDUALS_CSV => match &state.residuals {
            Some(residuals) => residuals_csv(r, residuals),
            None => {
                let text = "residuals belong to an adjustment that was run here; calibration.json does not hold them";
                return Err(Fault::new(SPIVCAL_ERROR_NOT_AVAILABLE, text));
            }
        },
        SPIVCAL_TEXT_HEADLINE => verdict(r).headline,
        SPIVCAL_TEXT_TERMINATION => r.fit.termination.clone(),
        SPIVCAL_TEXT_UNDETERMINED => one("direction", &r.fit.undetermined)?,
        SPIVCAL_TEXT_FLAG => one("flag", &r.fit.flags)?,
        SPIVCAL_TEXT_CAMERA_NAME => one("camera", &r.cameras.iter().map(|c| c.name.clone()).collect::<Vec<_>>())?,
        SPIVCAL_TEXT_COVARIANCE_NAME => one("row", &r.covariance.names)?,
        SPIVCAL_TEXT_TARGET_KIND => r.target.kind.clone(),
        SPIVCAL_TEXT_VIEW_WHY_UNUSED => one("view", &r.views.iter().map(|v| v.why_unused.clone()).collect::<Vec<_>>())?,
        _ => return Err(unknown_key("SPIVCAL_TEXT_*", key)),
    };
    if !matches!(key, SPIVCAL_TEXT_UNDETERMINED..=SPIVCAL_TEXT_COVARIANCE_NAME | SPIVCAL_TEXT_VIEW_WHY_UNUSED) {
        Fault::unless_zero(index)?;
    }
    Ok(found)
}

fn on(calibration: u64, call: impl FnOnce(&CalibrationState) -> Outcome) -> i32 {
    enter(calibration, Kind::Calibration, |object| call(state_of(object)?))
}
