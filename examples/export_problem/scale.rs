//! Time and memory of an adjustment over the number of observations, up to ten million: a table and a plot.

use crate::problems::timed;
use crate::timing::timed_calls;
use rayon::ThreadPoolBuilder;
use spivcal::bundle::{AdjustOptions, Termination, adjust, adjust_owned};
use std::fmt::Write;
use std::path::Path;
use std::process::{Command, ExitCode};

/// Views of 2 x 1000 points, two numbers each: 4000 numbers per view.
const VIEWS: [usize; 8] = [5, 15, 50, 150, 500, 1000, 1500, 2500];

/// What one size took.
struct Measured {
    observations: f64,
    seconds: f64,
    iterations: f64,
    /// Peak of the resident memory beyond what was there before, bytes.
    bytes: f64,
}

/// Peak of the resident memory, bytes, since it was last forgotten.
fn peak_bytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).expect("VmHWM");
    1024.0 * line.trim().trim_end_matches(" kB").parse::<f64>().expect("kB")
}

/// One size in a process of its own: prints observations, seconds of processor time, linearisations of all observations, and bytes.
pub fn one(name: &str) -> ExitCode {
    let case = timed(name).expect("a problem of the benchmark");
    let pool = ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    pool.install(|| {
        let observations = case.model.counts().observations;
        let options = AdjustOptions { rounds: 0, ..AdjustOptions::default() };
        let (model, start) = (case.model.clone(), case.start.clone());
        // From here on the peak counts.
        std::fs::write("/proc/self/clear_refs", "5").expect("the peak forgotten");
        let before = peak_bytes();
        let out = adjust_owned(model, start, &options, &mut |_| true);
        let bytes = peak_bytes() - before;
        assert_eq!(out.termination, Termination::Converged, "{name}");
        let (seconds, _) = timed_calls(1, 1, || adjust(&case.model, case.start.clone(), &options, &mut |_| true));
        println!("{observations} {seconds:e} {} {bytes}", out.iterations);
    });
    ExitCode::SUCCESS
}

fn measured(views: usize) -> Measured {
    let this = std::env::current_exe().expect("this program");
    let name = format!("points1000_2x{views}");
    let out = Command::new(this).args(["--scale-one", &name]).output().expect("this program");
    assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8(out.stdout).expect("text");
    let n: Vec<f64> = text.split_whitespace().map(|w| w.parse().expect("a number")).collect();
    Measured { observations: n[0], seconds: n[1], iterations: n[2], bytes: n[3] }
}

/// Prints the table and writes the plot.
pub fn all(svg: &Path) -> ExitCode {
    println!(
        "| numbers | linearisations | time | per million numbers and linearisation | memory beside the input | per number |"
    );
    println!("|---|---|---|---|---|---|");
    let mut done = vec![];
    for views in VIEWS {
        let m = measured(views);
        println!(
            "| {} | {} | {:.1} ms | {:.1} ms | {:.1} MB | {:.1} bytes |",
            m.observations,
            m.iterations,
            1e3 * m.seconds,
            1e9 * m.seconds / m.observations / m.iterations,
            1e-6 * m.bytes,
            m.bytes / m.observations
        );
        done.push(m);
    }
    std::fs::write(svg, plot(&done)).expect("the plot");
    ExitCode::SUCCESS
}

/// Both axes logarithmic: time over numbers, with the line of time proportional to numbers through the largest.
fn plot(all: &[Measured]) -> String {
    let (x0, x1, y0, y1) = (4.0, 7.2, -4.0, 2.0);
    let x = |n: f64| 70.0 + 520.0 * (n.log10() - x0) / (x1 - x0);
    let y = |s: f64| 330.0 - 300.0 * (s.log10() - y0) / (y1 - y0);
    let mut out = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 620 390\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"620\" height=\"390\" fill=\"white\"/>\n",
    );
    for k in 4..=7 {
        let at = x(10_f64.powi(k));
        let _ = writeln!(out, "<line x1=\"{at:.1}\" y1=\"30\" x2=\"{at:.1}\" y2=\"330\" stroke=\"#ddd\"/>");
        let _ = writeln!(
            out,
            "<text x=\"{at:.1}\" y=\"348\" text-anchor=\"middle\">10<tspan dy=\"-5\" font-size=\"9\">{k}</tspan></text>"
        );
    }
    for (k, label) in
        [(-4, "0.1 ms"), (-3, "1 ms"), (-2, "10 ms"), (-1, "0.1 s"), (0, "1 s"), (1, "10 s"), (2, "100 s")]
    {
        let at = y(10_f64.powi(k));
        let _ = writeln!(out, "<line x1=\"70\" y1=\"{at:.1}\" x2=\"590\" y2=\"{at:.1}\" stroke=\"#ddd\"/>");
        let _ = writeln!(out, "<text x=\"64\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>", at + 4.0);
    }
    if let Some(last) = all.last() {
        let slope = last.seconds / last.observations;
        let ends = [all[0].observations, last.observations].map(|n| format!("{:.1},{:.1}", x(n), y(slope * n)));
        let _ = writeln!(
            out,
            "<polyline points=\"{} {}\" stroke=\"#999\" stroke-dasharray=\"4 3\" fill=\"none\"/>",
            ends[0], ends[1]
        );
    }
    let path: Vec<String> = all.iter().map(|m| format!("{:.1},{:.1}", x(m.observations), y(m.seconds))).collect();
    let _ = writeln!(
        out,
        "<polyline points=\"{}\" stroke=\"#1b6ca8\" stroke-width=\"1.5\" fill=\"none\"/>",
        path.join(" ")
    );
    for m in all {
        let _ = writeln!(
            out,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"#1b6ca8\"/>",
            x(m.observations),
            y(m.seconds)
        );
    }
    out.push_str(
        "<text x=\"330\" y=\"372\" text-anchor=\"middle\">numbers observed (two per point)</text>\n\
         <text x=\"330\" y=\"20\" text-anchor=\"middle\">Adjustment of two cameras, one thread; dashed: proportional</text>\n</svg>\n",
    );
    out
}
