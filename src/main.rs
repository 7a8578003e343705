//! The program `spivcal`: a thin shell over the library.
#![allow(clippy::print_stderr)]

fn main() -> std::process::ExitCode {
    eprintln!("spivcal: commands are not built yet");
    std::process::ExitCode::from(4)
}
