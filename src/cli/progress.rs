//! Progress on a terminal, silent when piped, and remarks.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt::Display;
use std::io::{IsTerminal, Write};

/// A line at the bottom of the terminal that says what is being done.
pub(super) struct Bar {
    line: ProgressBar,
    quiet: bool,
}

impl Bar {
    /// Without the line where asked for, or where standard error is not a terminal; without remarks, too, where it is to be quiet.
    pub(super) fn new(no_line: bool, quiet: bool) -> Self {
        let line = ProgressBar::no_length();
        if no_line || quiet || !std::io::stderr().is_terminal() {
            line.set_draw_target(ProgressDrawTarget::hidden());
        }
        Self { line, quiet }
    }
    /// A remark that is no flag, for whoever is there to read it.
    pub(super) fn note(&self, words: impl Display) {
        if !self.quiet {
            let _ = writeln!(std::io::stderr(), "note: {words}");
        }
    }
    /// Begins a stage of `total` steps.
    pub(super) fn stage(&self, what: &str, total: usize) {
        if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {pos}/{len}") {
            self.line.set_style(style.progress_chars("=> "));
        }
        self.line.set_length(total as u64);
        self.line.set_position(0);
        self.line.set_message(what.to_string());
        self.line.tick();
    }
    /// Says how far a stage is whose end is not known.
    pub(super) fn say(&self, what: String) {
        if let Ok(style) = ProgressStyle::with_template("{msg}") {
            self.line.set_style(style);
        }
        self.line.set_message(what);
        self.line.tick();
    }
    /// One more step is done.
    pub(super) fn step(&self) {
        self.line.inc(1);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.line.finish_and_clear();
    }
}
