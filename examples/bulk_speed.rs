//! Speed of maps, dewarping and three components: millions of points, pixels or vectors per second (elapsed), and per second of the
//! processor's time where it runs in one thread (Linux tells it; else the elapsed one again).
//!
//!     cargo run --release --example bulk_speed -- WORK THREADS [SECONDS]
//!
//! WORK: plane-to-pixel, pixel-to-plane (4096 points of arrays that stay in the cache), linear, cubic, lanczos, b-spline (2048 x 2048 float,
//! the map computed on the way), components (4096 vectors); plane-to-pixel-5000 and so on: 5000 of them, whose arrays do not lie a power of two
//! apart. `cpp_tests/bench/bench_bulk.cpp` lets it take turns with OpenCV and numpy.

#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)]

use nalgebra::Vector3;
use spivcal::camera::{Camera, Intrinsics};
use spivcal::dewarp::{Kernel, Pixels, SheetGrid, SheetMap, SheetPoints, dewarp, dewarp_into};
use spivcal::image::{GrayView, Samples};
use spivcal::pipeline::Workers;
use spivcal::reconstruct::{Components, three_components};
use spivcal::rigid::{Motion, rotation_exp};
use std::hint::black_box;
use std::time::Instant;

const SIZE: usize = 2048;

/// The paper's camera with a sensor of `SIZE` pixels: 50 mm, 500 mm, 45 degrees.
fn map() -> SheetMap {
    let c = (SIZE as f64 - 1.0) / 2.0;
    let mut i = Intrinsics::pinhole(8888.9, c, c);
    (i.beta_rad, i.alpha_rad, i.k[0]) = (0.1107, 0.01, -0.15);
    let turn = rotation_exp(&Vector3::new(0.0, -45_f64.to_radians(), 0.0))
        * rotation_exp(&Vector3::new(std::f64::consts::PI, 0.0, 0.0));
    SheetMap::new(Camera::new(i).unwrap(), Motion::new(turn, Vector3::new(0.0, 0.0, 500.0)), [SIZE, SIZE])
}

/// Time that the processor gave to this thread, s.
fn own_time() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(1e-9 * text.split_whitespace().next()?.parse::<f64>().ok()?)
}

/// Millions per second: `count` of them in each call; elapsed, and by the time of this thread.
fn rate(count: usize, seconds: f64, mut call: impl FnMut()) -> [f64; 2] {
    call();
    let (begin, own, mut calls) = (Instant::now(), own_time(), 0.0);
    while begin.elapsed().as_secs_f64() < seconds {
        call();
        calls += 1.0;
    }
    let elapsed = begin.elapsed().as_secs_f64();
    let alone = rayon::current_num_threads() == 1;
    let busy = own_time().zip(own).filter(|_| alone).map_or(elapsed, |(now, then)| now - then);
    [elapsed, busy].map(|t| 1e-6 * calls * count as f64 / t)
}

fn measured(work: &str, seconds: f64) -> Option<[f64; 2]> {
    let map = map();
    let (work, count) = work.strip_suffix("-5000").map_or((work, 4096), |work| (work, 5000));
    let wave = |scale: f64, step: f64| (0..count).map(|i| scale * (step * i as f64).sin()).collect::<Vec<f64>>();
    let zero = vec![0.0; count];
    Some(match work {
        "plane-to-pixel" => {
            let (x, y, mut out) = (wave(40.0, 0.37), wave(40.0, 0.61), Pixels::default());
            rate(count, seconds, || map.pixel_of_sheet_into(black_box(&x), &y, &zero, &mut out).unwrap())
        }
        "pixel-to-plane" => {
            let shifted = |l: Vec<f64>| l.into_iter().map(|x| x + SIZE as f64 / 2.0).collect::<Vec<f64>>();
            let (u, v) = (shifted(wave(1000.0, 0.37)), shifted(wave(1000.0, 0.61)));
            let mut out = SheetPoints::default();
            rate(count, seconds, || map.sheet_of_pixel_into(black_box(&u), &v, &zero, &mut out).unwrap())
        }
        "components" => {
            let list = |k: u32| (0..count).map(|i| ((0.37 + 0.1 * f64::from(k)) * i as f64).sin()).collect();
            let all: Vec<Vec<f64>> = (0..8).map(list).collect();
            let mut out = Components::default();
            rate(count, seconds, || {
                let slopes = [[&all[0][..], &all[1]], [&all[2], &all[3]]];
                let planar = [[&all[4][..], &all[5]], [&all[6], &all[7]]];
                three_components(black_box(slopes), planar, &mut out).unwrap();
            })
        }
        other => {
            let kernel = match other {
                "linear" => Kernel::Linear,
                "cubic" => Kernel::Cubic,
                "lanczos" => Kernel::Lanczos,
                "b-spline" => Kernel::BSpline,
                _ => return None,
            };
            let image: Vec<f32> = (0..SIZE * SIZE).map(|i| (0.013 * i as f32).sin()).collect();
            let view = GrayView::new(Samples::F32(&image), SIZE, SIZE, SIZE).unwrap();
            let grid = SheetGrid::over([-40.0, -50.0, 40.0, 50.0], 0.05).unwrap();
            let count = grid.width_px * grid.height_px;
            let mut out = dewarp(&view, &map, &grid, kernel, 0.0).unwrap();
            rate(count, seconds, || {
                dewarp_into(black_box(&view), &map, &grid, kernel, 0.0, &mut out).unwrap();
                black_box(&out);
            })
        }
    })
}

fn main() -> std::process::ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let threads = words.get(1).and_then(|t| t.parse().ok()).unwrap_or(1);
    let seconds = words.get(2).and_then(|t| t.parse().ok()).unwrap_or(0.5);
    let work = words.first().map_or("", String::as_str);
    match Workers::new(threads).unwrap().install(|| measured(work, seconds)) {
        Some([elapsed, busy]) => {
            println!("{elapsed:.2} {busy:.2}");
            std::process::ExitCode::SUCCESS
        }
        None => {
            eprintln!("bulk_speed WORK THREADS [SECONDS]: no work \"{work}\"");
            std::process::ExitCode::from(2)
        }
    }
}
