//! Progress on a terminal; silent when piped.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;

/// A line at the bottom of the terminal that says what is being done.
pub(super) struct Bar(ProgressBar);

impl Bar {
    /// Silent where asked for, or where standard error is not a terminal.
    pub(super) fn new(silent: bool) -> Self {
        let bar = ProgressBar::no_length();
        if silent || !std::io::stderr().is_terminal() {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        Self(bar)
    }
    /// Begins a stage of `total` steps.
    pub(super) fn stage(&self, what: &str, total: usize) {
        if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {pos}/{len}") {
            self.0.set_style(style.progress_chars("=> "));
        }
        self.0.set_length(total as u64);
        self.0.set_position(0);
        self.0.set_message(what.to_string());
        self.0.tick();
    }
    /// Says how far a stage is whose end is not known.
    pub(super) fn say(&self, what: String) {
        if let Ok(style) = ProgressStyle::with_template("{msg}") {
            self.0.set_style(style);
        }
        self.0.set_message(what);
        self.0.tick();
    }
    /// One more step is done.
    pub(super) fn step(&self) {
        self.0.inc(1);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
