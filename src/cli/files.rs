//! Files read and written by the commands.

use crate::error::{Error, Invalid};
use std::path::Path;

pub(super) use crate::pipeline::{Output, read_text};

pub(super) fn fault(path: &Path, message: impl Into<String>) -> Error {
    Invalid::File { path: path.display().to_string(), message: message.into() }.into()
}
