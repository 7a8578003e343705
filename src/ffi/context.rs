//! Contexts: what objects are made in.

use super::abi::*;
use super::door::{destroy, enter_without_object};
use super::memory::Out;
use super::table::{self, Body, Kind};
use crate::detect::DetectMemory;
use crate::pipeline::MOST_THREADS;
use std::sync::Arc;

/// How calls on the objects of a context work, and with what.
#[derive(Clone)]
pub(super) struct Context {
    /// Threads of each piece of work; 0: as many as the machine has.
    pub(super) threads: usize,
    /// What searches of images use again.
    pub(super) memory: Arc<DetectMemory>,
}

/// Makes a context. All other objects are made in one, and end with it.
///
/// `threads`: threads that each calibration or detection may use, 1 to 1024; 0: as many as the machine has. They are started by the
/// call or job that needs them and have ended when it returns or is destroyed. Results do not depend on their number, to the bit. The context keeps
/// the memory in which images were searched (some 6 bytes per pixel, at most 128 MB for each search at a time) for the next.
/// `context`: receives the handle. Any thread. Where it fails there is no object to hold an error text: SPIVCAL_ERROR_INVALID_INPUT means too many threads or
/// that the system gives none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_context_create(threads: i32, context: *mut u64) -> i32 {
    enter_without_object(|| {
        stay_silent();
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(context, "context") }?;
        let Some(threads) = usize::try_from(threads).ok().filter(|n| *n <= MOST_THREADS) else {
            return Err(super::door::Fault::argument("threads"));
        };
        out.set(table::insert(0, Body::Context(Context { threads, memory: Arc::default() }))?);
        Ok(SPIVCAL_OK)
    })
}

/// Destroys a context and everything that was made in it; jobs that still run are stopped and waited for.
///
/// All those handles are stale afterwards. It waits for the calls that are under way in other threads: calibrations stop as jobs do and
/// fail with SPIVCAL_ERROR_HANDLE, the others end.
/// Destroy every context before the library is unloaded.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_context_destroy(context: u64) -> i32 {
    destroy(context, Kind::Context)
}

/// A panic is caught and becomes a status; its message goes to the object, not to the host's standard error.
///
/// The program and Rust tests link the same code, and there a panic must be seen.
#[cfg(not(feature = "cli"))]
fn stay_silent() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| std::panic::set_hook(Box::new(|_| {})));
}

#[cfg(feature = "cli")]
fn stay_silent() {}
