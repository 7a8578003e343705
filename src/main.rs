//! The program `spivcal`: a thin shell over the library.

fn main() -> std::process::ExitCode {
    spivcal::cli::run(std::env::args_os())
}
