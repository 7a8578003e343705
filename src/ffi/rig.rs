//! Rig descriptions: what is to be calibrated.

use super::abi::SPIVCAL_OK;
use super::detection::image_of;
use super::door::{Fault, Outcome, destroy, enter, lock};
use super::memory::{Out, give_text, text_of};
use super::rig_document::{Document, UNNAMED};
use super::table::{self, Body, Kind, Object};
use crate::error::Result as Loaded;
use crate::image::GrayImage;
use crate::pipeline::{load_image, read_text};
use crate::rig_file::{RigDescription, camera_name_fault, image_path};
use std::collections::BTreeMap;
use std::ffi::c_char;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use toml::{Table, Value};

/// A description and the images that came from memory.
pub(super) struct RigState {
    pub(super) document: Document,
    /// The rig file, where there is one: images stand beside it.
    file: PathBuf,
    images_dir: Option<PathBuf>,
    images: BTreeMap<(u64, u64), Arc<GrayImage>>,
}

/// A description ready to be worked on, independent of what the caller does to the rig meanwhile.
pub(super) struct Task {
    pub(super) job: RigDescription,
    file: PathBuf,
    images_dir: Option<PathBuf>,
    images: BTreeMap<(u64, u64), Arc<GrayImage>>,
}

impl Task {
    /// Gives the image of a view and camera.
    pub(super) fn image(&self, view: usize, camera: usize) -> Loaded<Arc<GrayImage>> {
        if let Some(image) = self.images.get(&(view as u64, camera as u64)) {
            return Ok(Arc::clone(image));
        }
        // The library asks only for images that the description names.
        let name = self.job.views[view].images[camera].as_deref().unwrap_or_default();
        load_image(&image_path(&self.file, self.images_dir.as_deref(), name)).map(Arc::new)
    }
}

impl RigState {
    pub(super) fn task(&self) -> Result<Task, Fault> {
        let job = self.document.description()?;
        Ok(Task { job, file: self.file.clone(), images_dir: self.images_dir.clone(), images: self.images.clone() })
    }
}

impl RigState {
    /// No image of a camera in a view.
    pub(super) fn unset_image(&mut self, view: u64, camera: u64) -> Result<(), Fault> {
        self.document.unset_image(view, camera)?;
        self.images.remove(&(view, camera));
        Ok(())
    }

    /// Images from memory move up with their views, and so do the names that they have.
    pub(super) fn remove_view(&mut self, view: u64) -> Result<(), Fault> {
        self.document.remove_view(view)?;
        for ((v, camera), image) in std::mem::take(&mut self.images) {
            if v == view {
                continue;
            }
            let now = v - u64::from(v > view);
            self.document.set_image(now, camera, &from_memory(now, camera))?;
            self.images.insert((now, camera), image);
        }
        Ok(())
    }
}

/// What results and messages call an image that is no file.
fn from_memory(view: u64, camera: u64) -> String {
    format!("view{view}_camera{camera}")
}

pub(super) fn rig_state(object: &Object) -> Result<MutexGuard<'_, RigState>, Fault> {
    match &object.body {
        Body::Rig(state) => Ok(lock(state)),
        _ => Err(Fault::argument("this is no rig")),
    }
}

pub(super) fn on(rig: u64, call: impl FnOnce(&mut RigState) -> Outcome) -> i32 {
    enter(rig, Kind::Rig, |object| call(&mut *rig_state(object)?))
}

fn keep(context: u64, out: Out<u64>, document: Document, file: PathBuf, images_dir: Option<PathBuf>) -> Outcome {
    let state = RigState { document, file, images_dir, images: BTreeMap::new() };
    out.set(table::insert(context, Body::Rig(Mutex::new(state)))?);
    Ok(SPIVCAL_OK)
}

/// A folder given by the caller; NULL and "" are none.
///
/// # Safety
/// `path` is null or zero-terminated.
unsafe fn folder(path: *const c_char) -> Result<Option<PathBuf>, Fault> {
    if path.is_null() {
        return Ok(None);
    }
    // SAFETY: the contract of this function.
    let text = unsafe { text_of(path, "images_dir_utf8") }?;
    Ok((!text.is_empty()).then(|| PathBuf::from(text)))
}

/// Makes an empty rig description, to be filled by the functions below.
///
/// It needs cameras, a target, one length in mm (of the target, or spivcal_rig_set_scale), views and their images. Error texts name lines and keys
/// of the text that spivcal_rig_text_copy gives. What was set can be replaced, and taken back (spivcal_rig_unset).
/// `rig`: receives the handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_create(context: u64, rig: *mut u64) -> i32 {
    enter(context, Kind::Context, |_| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(rig, "rig") }?;
        keep(context, out, Document::new(), PathBuf::new(), None)
    })
}

/// Makes a rig description from the text of a rig file (TOML).
///
/// `toml_utf8`: zero-terminated. `images_dir_utf8`: folder that relative paths of images begin at; NULL or "": the current one.
/// `rig`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT with line and what was expected in the error text of the context.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_parse(
    context: u64,
    toml_utf8: *const c_char,
    images_dir_utf8: *const c_char,
    rig: *mut u64,
) -> i32 {
    // SAFETY: the contract of the header.
    enter(context, Kind::Context, |_| unsafe {
        let out = Out::new(rig, "rig")?;
        let (text, images_dir) = (text_of(toml_utf8, "toml_utf8")?, folder(images_dir_utf8)?);
        keep(context, out, Document::read(&text, UNNAMED)?, PathBuf::new(), images_dir)
    })
}

/// Makes a rig description from a rig file.
///
/// `path_utf8`: the file. `images_dir_utf8`: folder that relative paths of images begin at; NULL or "": that of the file.
/// `rig`: receives the handle; SPIVCAL_ERROR_INVALID_INPUT as for spivcal_rig_parse. Images are read when a calibration asks for them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_load(
    context: u64,
    path_utf8: *const c_char,
    images_dir_utf8: *const c_char,
    rig: *mut u64,
) -> i32 {
    // SAFETY: the contract of the header.
    enter(context, Kind::Context, |_| unsafe {
        let out = Out::new(rig, "rig")?;
        let (path, images_dir) = (text_of(path_utf8, "path_utf8")?, folder(images_dir_utf8)?);
        let text = read_text(Path::new(&path), "a rig file (TOML)")?;
        keep(context, out, Document::read(&text, &path)?, PathBuf::from(&path), images_dir)
    })
}

/// Adds a camera; the first one is the rig frame, two are the most.
///
/// `name_utf8`: up to 64 bytes of letters, digits, '-', '_', but not "sheet" or "plane_z_mm"; it names the camera in results, and differs
/// from that of the other by more than capitals. `camera`: receives its index, from 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_add_camera(rig: u64, name_utf8: *const c_char, camera: *mut u64) -> i32 {
    on(rig, |state| {
        // SAFETY: the contract of the header.
        let (out, name) = unsafe { (Out::new(camera, "camera")?, text_of(name_utf8, "name_utf8")?) };
        if let Some(fault) = camera_name_fault(&name) {
            return Err(Fault::argument(fault));
        }
        let names = state.document.camera_names();
        if names.len() >= 2 {
            return Err(Fault::argument("there are two cameras already"));
        }
        if let Some(other) = names.iter().find(|other| other.to_lowercase() == name.to_lowercase()) {
            return Err(Fault::argument(format!("there is a camera \"{other}\" already")));
        }
        out.set(state.document.append("camera", Table::from_iter([("name".to_string(), Value::String(name))])));
        Ok(SPIVCAL_OK)
    })
}

/// Adds a view: one position of the target, seen by the cameras at the same moment.
///
/// `view`: receives its index, from 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_add_view(rig: u64, view: *mut u64) -> i32 {
    on(rig, |state| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(view, "view") }?;
        out.set(state.document.append("view", Table::new()));
        Ok(SPIVCAL_OK)
    })
}

/// Adds a mark of a grid or plate.
///
/// `kind_utf8`: ring, large, square or triangle. `column`, `row`: its place on the lattice. `level`: 0 front, 1 back (plates).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_add_mark(
    rig: u64,
    kind_utf8: *const c_char,
    column: i32,
    row: i32,
    level: i32,
) -> i32 {
    on(rig, |state| {
        // SAFETY: the contract of the header.
        let kind = unsafe { text_of(kind_utf8, "kind_utf8") }?;
        state.document.add_mark(kind, column, row, level)?;
        Ok(SPIVCAL_OK)
    })
}

/// Sets a number of the description.
///
/// `key`: one of the number keys SPIVCAL_RIG_*, which say unit and what `index` counts. `index`: 0 where nothing is counted.
/// `value`: a finite number. Whether it makes sense beside all others is asked by spivcal_rig_check and by whatever uses the description:
/// SPIVCAL_ERROR_INVALID_INPUT there, as it would be of a rig file.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_set_number(rig: u64, key: i32, index: u64, value: f64) -> i32 {
    on(rig, |state| state.document.set_number(key, index, value).map(|()| SPIVCAL_OK))
}

/// Sets a word of the description.
///
/// `key`: one of the text keys SPIVCAL_RIG_*, which list the words and say what `index` counts. `index`: 0 where nothing is counted.
/// `text_utf8`: zero-terminated.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_set_text(rig: u64, key: i32, index: u64, text_utf8: *const c_char) -> i32 {
    on(rig, |state| {
        // SAFETY: the contract of the header.
        let text = unsafe { text_of(text_utf8, "text_utf8") }?;
        state.document.set_word(key, index, text).map(|()| SPIVCAL_OK)
    })
}

/// States what is known of a parameter of a camera beforehand.
///
/// `camera`: from 0. `parameter`: SPIVCAL_PARAMETER_*, with the unit of `value` and `sigma`. `sigma` > 0: a prior; 0: the value is exact.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_set_known(rig: u64, camera: u64, parameter: i32, value: f64, sigma: f64) -> i32 {
    on(rig, |state| state.document.set_known(camera, parameter, value, sigma).map(|()| SPIVCAL_OK))
}

/// States the one fact that makes lengths metric, where the target gives none; a later call replaces an earlier one.
///
/// `fact`: SPIVCAL_SCALE_*. `view`, `disc`: which one, where the fact belongs to one. `value_mm`: the length.
/// `sigma_mm`: its standard deviation, 0 where it is exact.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_set_scale(
    rig: u64,
    fact: i32,
    view: u64,
    disc: u64,
    value_mm: f64,
    sigma_mm: f64,
) -> i32 {
    on(rig, |state| state.document.set_scale(fact, view, disc, value_mm, sigma_mm).map(|()| SPIVCAL_OK))
}

/// Gives the image that a camera saw in a view. It takes the place of a file that the description names.
///
/// `view`, `camera`: from 0. `image`: handle; the rig keeps the image, the handle may be destroyed. Results and error texts call it
/// "view0_camera1", with its numbers.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_set_image(rig: u64, view: u64, camera: u64, image: u64) -> i32 {
    on(rig, |state| {
        let image = image_of(image)?;
        state.document.set_image(view, camera, &from_memory(view, camera))?;
        state.images.insert((view, camera), image);
        Ok(SPIVCAL_OK)
    })
}

/// Names the file of the image that a camera saw in a view; it is read when a calibration asks for it.
///
/// `view`, `camera`: from 0. `path_utf8`: the file, zero-terminated; a relative path begins at the folder of the images,
/// which of spivcal_rig_create is the current one of the process.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_set_image_file(rig: u64, view: u64, camera: u64, path_utf8: *const c_char) -> i32 {
    on(rig, |state| {
        // SAFETY: the contract of the header.
        let path = unsafe { text_of(path_utf8, "path_utf8") }?;
        if path.is_empty() {
            return Err(Fault::argument("path_utf8 is empty; expected the file of an image"));
        }
        state.document.set_image(view, camera, &path)?;
        state.images.remove(&(view, camera));
        Ok(SPIVCAL_OK)
    })
}

/// Checks a description for sense without opening an image: SPIVCAL_OK, or SPIVCAL_ERROR_INVALID_INPUT with an error text.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_check(rig: u64) -> i32 {
    on(rig, |state| state.document.description().map(|_| SPIVCAL_OK))
}

/// The description as the text of a rig file (TOML). An image from memory has the name that results and error texts give it there, and is to be
/// given again to a description that is made from this text.
///
/// `buffer`, `capacity`, `needed`: bytes, as in spivcal_version_copy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_rig_text_copy(rig: u64, buffer: *mut c_char, capacity: u64, needed: *mut u64) -> i32 {
    on(rig, |state| {
        let text = state.document.text()?;
        // SAFETY: the contract of the header.
        unsafe { give_text(&text, buffer, capacity, needed) }
    })
}

/// Destroys a rig description. Jobs that were started with it go on.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_rig_destroy(rig: u64) -> i32 {
    destroy(rig, Kind::Rig)
}
