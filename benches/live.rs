//! Images to the record of a calibration: the twelve images of `examples/printed` (1024 x 768) decoded, searched, calibrated, the
//! record and the residuals written to files; no report, no overlays.
//!
//! `cargo bench --bench live`. Rounds with one and with two threads take turns; medians of the time that passes and of the processors' own
//! time, which other work on the machine lengthens less; the same of its three parts: images (decoded, searched and labelled), what is
//! computed from them, files. All of it twice: with the images as they are, compressed PNG, and copied to uncompressed TIFF, as cameras of
//! PIV write them. The goal is 50 ms with two threads.
//!
//! `cargo bench --bench live -- once` makes one record with one thread: its instructions are counted by running that program under
//! `valgrind --tool=callgrind`.
#![allow(unsafe_code, clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod clock;

use clock::{Clock, median, seconds};
use spivcal::detect::{DetectMemory, DetectOptions, find_discs_with};
use spivcal::error::Result;
use spivcal::image::GrayImage;
use spivcal::pipeline::{CalibrateOptions, Progress, calibrate, load_image};
use spivcal::report::residuals_csv;
use spivcal::rig_file::RigDescription;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

const ROUNDS: usize = 21;

/// Milliseconds that all threads of this process have run.
fn processor_ms(start: Instant) -> f64 {
    1e3 * seconds(Clock::Process, start)
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

/// The twelve images, and where the files go.
struct Work {
    images: Vec<[PathBuf; 2]>,
    job: RigDescription,
    to: tempfile::TempDir,
}

impl Work {
    /// The images as they are, or copied to uncompressed TIFF.
    fn new(tiff: bool) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/printed");
        let text = std::fs::read_to_string(folder.join("rig.toml")).unwrap();
        let job = RigDescription::parse(&text, "rig.toml").unwrap();
        let to = tempfile::tempdir().unwrap();
        let place = |file: &str| {
            let from = folder.join(file);
            if !tiff {
                return from;
            }
            let copy = to.path().join(file).with_extension("tif");
            image::open(from).unwrap().to_luma8().save(&copy).unwrap();
            copy
        };
        let images = job.views.iter().map(|v| [0, 1].map(|c: usize| place(v.images[c].as_ref().unwrap()))).collect();
        Self { images, job, to }
    }

    fn load(&self, view: usize, camera: usize) -> Result<Arc<GrayImage>> {
        load_image(&self.images[view][camera]).map(Arc::new)
    }

    /// From images to files; what passes until the last image has been searched, until all is computed, until the files are there.
    fn all(&self, threads: usize, origin: Instant) -> [[f64; 2]; 3] {
        let now = || [1e3 * origin.elapsed().as_secs_f64(), processor_ms(origin)];
        let (begin, mut seen) = (now(), [0.0; 2]);
        let options = CalibrateOptions { threads, ..CalibrateOptions::default() };
        let load = |view: usize, camera: usize| self.load(view, camera);
        let mut told = |p: Progress| {
            if matches!(p, Progress::Image { .. }) {
                seen = now();
            }
            true
        };
        let found = calibrate(&self.job, &load, &options, &mut told).unwrap();
        let computed = now();
        let to = self.to.path();
        // As the program does it.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let json = || std::fs::write(to.join("calibration.json"), found.record.to_json().unwrap()).unwrap();
        let csv = || std::fs::write(to.join("residuals.csv"), residuals_csv(&found.record, &found.residuals)).unwrap();
        pool.install(|| rayon::join(csv, json));
        drop((pool, found));
        let written = now();
        let passed = |a: [f64; 2], b: [f64; 2]| [b[0] - a[0], b[1] - a[1]];
        [passed(begin, seen), passed(seen, computed), passed(computed, written)]
    }
}

fn main() {
    if std::env::args().any(|a| a == "once") {
        black_box(Work::new(false).all(1, Instant::now()));
        return;
    }
    for (name, tiff) in [("PNG", false), ("TIFF, not compressed", true)] {
        println!("{name}, medians of {ROUNDS} rounds");
        measure(&Work::new(tiff));
    }
}

fn measure(work: &Work) {
    let wanted: Vec<(usize, usize)> = (0..work.job.views.len()).flat_map(|v| [(v, 0), (v, 1)]).collect();
    let decode = || wanted.iter().map(|(v, c)| work.load(*v, *c).unwrap()).collect::<Vec<Arc<GrayImage>>>();
    let options = DetectOptions { polarity: work.job.target.polarity, ..DetectOptions::default() };
    let memory = DetectMemory::default();
    let origin = Instant::now();
    let [mut decoding, mut searching] = [0; 2].map(|_| Times::default());
    let mut whole = [0; 2].map(|_| Times::default());
    let mut parts = [0; 2].map(|_| [0; 3].map(|_| Times::default()));
    for _ in 0..ROUNDS {
        let images = decoding.take(origin, decode);
        searching.take(origin, || {
            images.iter().map(|i| find_discs_with(&i.view(), &options, &memory).unwrap().discs.len()).sum::<usize>()
        });
        for (k, (whole, parts)) in whole.iter_mut().zip(&mut parts).enumerate() {
            let each = whole.take(origin, || work.all(k + 1, origin));
            for (part, [passed, of_processors]) in parts.iter_mut().zip(each) {
                part.passed.push(passed);
                part.of_processors.push(of_processors);
            }
        }
    }
    decoding.print("decoding, one thread");
    searching.print("searching, one thread");
    for (k, (whole, parts)) in whole.iter_mut().zip(&mut parts).enumerate() {
        println!("threads: {}", k + 1);
        whole.print("  images to record");
        for (part, name) in parts.iter_mut().zip(["  images seen", "  computed", "  files"]) {
            part.print(name);
        }
    }
}
