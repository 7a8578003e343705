//! The program: arguments, files, progress, exit codes.
//!
//! Every command is one or two library calls. Exit codes: 0 done; 1 done but flagged; 2 bad input; 3 not enough or
//! degenerate data; 4 internal. On an error nothing is written, but for `detect` what shows why no disc was taken.

mod arguments;
mod calibrate;
mod check;
mod convert;
mod detect;
mod dewarp;
mod dewarped;
mod files;
mod progress;
mod reconstruct;
mod sheet;
mod show;
mod simulate;
mod threads;

use crate::error::{Error, Invalid};
use arguments::{Arguments, Command};
use clap::Parser;
use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

/// What a command has to say when it is done.
struct Done {
    /// For people.
    text: String,
    /// For programs, with `--json`.
    json: serde_json::Value,
    /// Points that must be looked at; the exit code is 1 where there is any.
    flags: Vec<String>,
}

/// Runs the program with its arguments (the first is its name) and says how it ended.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments = match Arguments::try_parse_from(arguments) {
        Ok(a) => a,
        Err(e) => {
            // Help and version are no errors; clap knows which stream they belong to.
            let _ = e.print();
            return ExitCode::from(if e.use_stderr() { 2 } else { 0 });
        }
    };
    // The default hook would print a backtrace's worth of text that no experimenter can use.
    std::panic::set_hook(Box::new(|_| {}));
    let result = catch_unwind(AssertUnwindSafe(|| dispatch(&arguments))).unwrap_or_else(|panic| {
        let words = panic.downcast_ref::<String>().cloned().or(panic.downcast_ref::<&str>().map(|s| s.to_string()));
        Err(Error::Bug(words.unwrap_or_else(|| "a panic without words".into())))
    });
    match result {
        Ok(done) => report(&arguments, &done),
        Err(e) => fail(&e),
    }
}

fn fail(error: &Error) -> ExitCode {
    let _ = print_to(&mut std::io::stderr(), &format!("error: {error}\n"));
    ExitCode::from(error.exit_code())
}

fn dispatch(arguments: &Arguments) -> crate::Result<Done> {
    let progress = progress::Bar::new(arguments.json, arguments.quiet);
    match &arguments.command {
        Command::Calibrate(c) => calibrate::run(c, arguments.threads, &progress),
        Command::Detect(c) => detect::run(c, arguments.threads, &progress),
        Command::Sheet(c) => sheet::run(c, arguments.threads, &progress),
        Command::Check(c) => check::run(c, arguments.threads, &progress),
        Command::Dewarp(c) => dewarp::run(c, arguments.threads, &progress),
        Command::Reconstruct(c) => reconstruct::run(c, arguments.threads, &progress),
        Command::Simulate(c) => simulate::run(c, &progress),
        Command::Show(c) => show::run(c),
        Command::Convert(c) => convert::run(c),
    }
}

fn report(arguments: &Arguments, done: &Done) -> ExitCode {
    let told = if arguments.json {
        print_to(&mut std::io::stdout(), &format!("{:#}\n", done.json))
    } else if !arguments.quiet || arguments.command.answers_on_stdout() {
        print_to(&mut std::io::stdout(), &done.text)
    } else {
        Ok(())
    };
    if let Err(e) = told {
        let what = Invalid::File { path: "standard output".into(), message: format!("cannot be written: {e}") };
        return fail(&what.into());
    }
    for flag in &done.flags {
        let _ = print_to(&mut std::io::stderr(), &format!("warning: {flag}\n"));
    }
    ExitCode::from(u8::from(!done.flags.is_empty()))
}

/// Writes to a stream; a reader that has gone away (`| head`) is no error.
fn print_to(stream: &mut dyn Write, text: &str) -> std::io::Result<()> {
    match stream.write_all(text.as_bytes()).and_then(|()| stream.flush()) {
        Err(e) if e.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}
