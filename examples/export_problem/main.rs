//! Writes adjustment problems with the library's answers as plain text, for programs of other makes to solve anew; and judges
//! the answers of those.
//!
//! ```text
//! cargo run --example export_problem -- DIR            DIR/NAME.problem for every problem, DIR/projection.txt
//! cargo run --example export_problem -- --check DIR    Newton decrement of DIR/NAME.solution in the library's own equations
//! cargo run --example export_problem -- --bench DIR NAME...      problems of the benchmark
//! cargo run --example export_problem -- --time NAME N [THREADS]  mean seconds of N adjustments of one of them
//! cargo run --example export_problem -- --scale SVG    time and memory over the number of observations: a table, and a plot in SVG
//! cargo run --example export_problem -- --once NAME    a single call, to count its instructions
//! cargo run --example export_problem -- --discs DIR    rendered discs with truth, Cramer-Rao bound and what the library finds
//! ```
//! The formats are described in `text.rs`, `projection.rs` and `discs.rs`; `cpp_tests` reads them.
#![allow(missing_docs, unreachable_pub, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod check;
#[path = "../../tests/detect_table/mod.rs"]
mod detect_table;
mod discs;
mod once;
mod problems;
mod projection;
#[path = "../../tests/render/mod.rs"]
mod render;
#[path = "../../tests/rig_scene/mod.rs"]
mod rig_scene;
mod scale;
#[path = "../../benches/scenes/mod.rs"]
mod scenes;
mod text;
mod timing;

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["--check", dir] => check::check(Path::new(dir)),
        ["--discs", dir] => discs::write(Path::new(dir)),
        ["--bench", dir, ref names @ ..] => {
            std::fs::create_dir_all(dir).expect("folder for the problems");
            let named = |n: &&str| problems::timed(n).unwrap_or_else(|| panic!("no problem {n} in the benchmark"));
            names.iter().for_each(|n| text::write_start(&named(n), Path::new(dir)));
            ExitCode::SUCCESS
        }
        ["--scale", svg] => scale::all(Path::new(svg)),
        ["--scale-one", name] => scale::one(name),
        ["--once", name] => once::run(name),
        ["--time", name, rounds] => timing::run(name, rounds.parse().expect("a number of rounds"), 1),
        ["--time", name, rounds, threads] => {
            let number = |x: &str| x.parse().expect("a number");
            timing::run(name, number(rounds), number(threads))
        }
        [dir] if !dir.starts_with('-') => {
            std::fs::create_dir_all(dir).expect("folder for the problems");
            problems::all().iter().for_each(|p| text::write(p, Path::new(dir)));
            projection::write(Path::new(dir));
            ExitCode::SUCCESS
        }
        _ => {
            eprintln!(
                "export_problem DIR | --check DIR | --discs DIR | --bench DIR NAME... | --time NAME N [THREADS] | --scale SVG | --once NAME"
            );
            ExitCode::from(2)
        }
    }
}
