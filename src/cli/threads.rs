//! Threads of a command.

use crate::error::Result;
use crate::pipeline::Workers;
use std::num::NonZeroUsize;

/// A pool of this call's own; without a number as many threads as there are processors.
pub(super) fn pool(threads: Option<NonZeroUsize>) -> Result<Workers> {
    Workers::new(threads.map_or(0, NonZeroUsize::get))
}
