//! How much of a slow set is run: a part with `./check`, all of it with `./check --accuracy`.

#![allow(unreachable_pub)]

/// So many of `all`, at least one: the part `1 / by`, or all where that is asked for.
pub fn share(all: usize, by: usize) -> usize {
    if std::env::var_os("SPIVCAL_ALL_SCENES").is_some() { all } else { all.div_ceil(by) }
}
