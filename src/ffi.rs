//! The C door: everything that `include/spivcal.h` declares, and the only `unsafe` code of the crate.
//!
//! | rule | where it is kept |
//! |---|---|
//! | a caller passes numbers: a handle is looked up, never dereferenced | `ffi/table.rs` |
//! | every call goes through one door: lookup, poisoning, panics, error text | `ffi/door.rs` |
//! | no slice is ever formed from a caller's pointer; bytes are copied, whatever their alignment | `ffi/memory.rs` |
//! | long work has threads of its own, which have ended before their object is gone | `ffi/job.rs` |
//! | nothing is printed, not even by a panic | `ffi/context.rs` |
//!
//! The comments of the exported functions are the documentation of the header: they are written for C.
#![allow(unsafe_code)]
// The contract of every pointer is the same and stands once, at the top of the header.
#![allow(clippy::missing_safety_doc)]

mod abi;
mod calibration;
mod context;
mod detection;
mod door;
mod image;
mod job;
mod keys;
mod mapping;
mod memory;
mod numbers;
mod results;
mod rig;
mod rig_document;
mod rig_keys;
mod rig_removal;
mod table;
mod velocity;

#[cfg(test)]
mod tests;

pub use abi::*;
pub use calibration::*;
pub use context::*;
pub use detection::*;
pub use image::*;
pub use job::*;
pub use keys::*;
pub use mapping::*;
pub use rig::*;
pub use rig_keys::*;
pub use rig_removal::*;
pub use velocity::*;
