//! Images to the record of a calibration: the twelve images of `examples/printed` (1024 x 768) decoded, searched, calibrated, the
//! record and the residuals written to files; no report, no overlays.
//!
//! `cargo bench --bench live`. Rounds with one and with two threads take turns; medians of the time that passes and of the processors' own
//! time, which other work on the machine lengthens less. The goal is 50 ms with two threads.
#![allow(unsafe_code, clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use spivcal::detect::{DetectOptions, find_discs};
use spivcal::image::GrayImage;
use spivcal::pipeline::{CalibrateOptions, calibrate, load_image};
use spivcal::report::residuals_csv;
use spivcal::rig_file::RigDescription;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

const ROUNDS: usize = 21;

/// Milliseconds that all threads of this process have run, or those that have passed.
fn processor_ms(start: Instant) -> f64 {
    #[cfg(target_os = "linux")]
    {
        #[repr(C)]
        struct Time {
            s: std::ffi::c_long,
            ns: std::ffi::c_long,
        }
        unsafe extern "C" {
            fn clock_gettime(clock: i32, time: *mut Time) -> i32;
        }
        const PROCESS: i32 = 2;
        let mut time = Time { s: 0, ns: 0 };
        // SAFETY: the time can be written.
        if unsafe { clock_gettime(PROCESS, &mut time) } == 0 {
            return 1e3 * time.s as f64 + 1e-6 * time.ns as f64;
        }
    }
    1e3 * start.elapsed().as_secs_f64()
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// What one kind of work took in all rounds.
#[derive(Default)]
struct Times {
    passed: Vec<f64>,
    of_processors: Vec<f64>,
}

impl Times {
    fn take<R>(&mut self, origin: Instant, work: impl FnOnce() -> R) -> R {
        let (start, before) = (Instant::now(), processor_ms(origin));
        let result = black_box(work());
        self.of_processors.push(processor_ms(origin) - before);
        self.passed.push(1e3 * start.elapsed().as_secs_f64());
        result
    }

    fn print(&mut self, name: &str) {
        let least = self.passed.iter().copied().fold(f64::INFINITY, f64::min);
        let (passed, own) = (median(&mut self.passed), median(&mut self.of_processors));
        println!("{name:28} {passed:8.1} ms passed (least {least:.1}), {own:8.1} ms of processors");
    }
}

fn main() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/printed");
    let text = std::fs::read_to_string(folder.join("rig.toml")).unwrap();
    let job = RigDescription::parse(&text, "rig.toml").unwrap();
    let load = |view: usize, camera: usize| load_image(&folder.join(job.views[view].images[camera].as_ref().unwrap()));
    let to = tempfile::tempdir().unwrap();
    let all = |threads: usize| {
        let options = CalibrateOptions { threads, ..CalibrateOptions::default() };
        let found = calibrate(&job, &load, &options, &mut |_| true).unwrap();
        std::fs::write(to.path().join("calibration.json"), found.record.to_json().unwrap()).unwrap();
        std::fs::write(to.path().join("residuals.csv"), residuals_csv(&found.record, &found.residuals)).unwrap();
    };
    let wanted: Vec<(usize, usize)> = (0..job.views.len()).flat_map(|v| [(v, 0), (v, 1)]).collect();
    let decode = || wanted.iter().map(|(v, c)| load(*v, *c).unwrap()).collect::<Vec<GrayImage>>();
    let options = DetectOptions { polarity: job.target.polarity, ..DetectOptions::default() };
    let origin = Instant::now();
    let [mut decoding, mut searching, mut one, mut two] = [0; 4].map(|_| Times::default());
    for _ in 0..ROUNDS {
        let images = decoding.take(origin, decode);
        searching.take(origin, || {
            images.iter().map(|i| find_discs(&i.view(), &options).unwrap().discs.len()).sum::<usize>()
        });
        one.take(origin, || all(1));
        two.take(origin, || all(2));
    }
    println!("{} images, medians of {ROUNDS} rounds", wanted.len());
    decoding.print("decoding, one thread");
    searching.print("searching, one thread");
    one.print("images to record, one thread");
    two.print("images to record, two threads");
}
