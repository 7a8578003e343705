//! Where the real images of others are; they are never copied into the repository.

#![allow(clippy::print_stdout)]

use std::path::{Path, PathBuf};

/// The folder of a set of real images, or a loud word that it is not there.
pub(crate) fn folder(set: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SPIVCAL_REAL_IMAGES")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let path = root.join(set);
    if path.is_dir() {
        return Some(path);
    }
    println!("SKIPPED: no real images of {set}: {} is not there; set SPIVCAL_REAL_IMAGES", path.display());
    None
}
