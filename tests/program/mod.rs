//! The program itself, and the examples that come with it.

#![allow(clippy::unwrap_used, dead_code)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs the program.
pub(crate) fn spivcal(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).output().unwrap()
}

/// The folder of an example.
pub(crate) fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(name)
}
