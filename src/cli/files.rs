//! Files read and written by the commands.

use super::progress::Bar;
use crate::error::{Error, Invalid, Result};
use crate::image::GrayImage;
use crate::pipeline::{has_further_pages, load_image};
use crate::rig_file::{RigDescription, image_path};
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub(super) use crate::pipeline::{Output, can_write, read_text, spares};

pub(super) fn fault(path: &Path, message: impl Into<String>) -> Error {
    Invalid::File { path: path.display().to_string(), message: message.into() }.into()
}

/// The image files that a rig file names.
pub(super) struct NamedImages<'a> {
    pub(super) job: &'a RigDescription,
    pub(super) rig: &'a Path,
    /// Where the images are, if not beside the rig file.
    pub(super) folder: Option<&'a Path>,
}

impl NamedImages<'_> {
    /// All of them.
    pub(super) fn paths(&self) -> Vec<PathBuf> {
        let names = self.job.views.iter().flat_map(|v| v.images.iter().flatten());
        names.map(|name| image_path(self.rig, self.folder, name)).collect()
    }
    /// One of them; the library asks only for images that the rig file names.
    pub(super) fn load(&self, view: usize, camera: usize) -> Result<Arc<GrayImage>> {
        let name = self.job.views[view].images[camera].as_deref().unwrap_or_default();
        let path = image_path(self.rig, self.folder, name);
        load_image(&path).map(Arc::new).map_err(|e| match e {
            Error::Invalid(Invalid::File { path: at, message }) if !path.exists() => {
                fault(at.as_ref(), format!("{message} (that of the rig file, or the one given by --images)"))
            }
            other => other,
        })
    }
}

/// Says which images have pages that were not read; no flag, for the first is what single images are.
pub(super) fn tell_further_pages<'a>(to: &Bar, images: impl IntoIterator<Item = &'a PathBuf>) {
    for path in images.into_iter().filter(|p| has_further_pages(p)) {
        to.note(format_args!("{}: it has several pages, of which the first is used", path.display()));
    }
}
