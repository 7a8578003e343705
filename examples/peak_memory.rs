//! The program `spivcal` with an allocator that counts: after the command, one line on standard error says the most bytes that it held at a
//! time, in MB. What the system maps of the program's own file, and the stacks of threads, are not in it: those depend on the system's page
//! cache, not on the work.
//!
//!     cargo run --example peak_memory -- calibrate examples/printed/rig.toml -o out

#![allow(clippy::print_stderr)]

#[global_allocator]
static ALLOCATED: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;

fn main() -> std::process::ExitCode {
    let code = spivcal::cli::run(std::env::args_os());
    eprintln!("peak of allocated memory: {:.1} MB", ALLOCATED.peak_usage_as_mb());
    code
}
