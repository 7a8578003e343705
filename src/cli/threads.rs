//! Threads of a command.

use crate::error::{Error, Result};
use std::num::NonZeroUsize;

/// A pool of this call's own; without a number as many threads as there are processors.
pub(super) fn pool(threads: Option<NonZeroUsize>) -> Result<rayon::ThreadPool> {
    let count = threads.map_or(0, NonZeroUsize::get);
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build()
        .map_err(|e| Error::Bug(format!("{count} threads cannot be started: {e}")))
}
