//! Rendered discs for detectors of other makes: `discs.txt` and one raw image file per condition.
//!
//! ```text
//! cases N, then each: NAME size trials low high, Cramer-Rao sigmas of u v a b,
//! [true u v a b, found u v a b] x trials
//! discs_K.f32: trials x size x size grey levels of condition K, 32-bit little-endian floats
//! ```

use crate::detect_table::{Condition, Light};
use crate::render::Random;
use crate::render::accuracy::{SIZE, bound, cases};
use spivcal::conic::Ellipse;
use spivcal::detect::{DetectOptions, find_discs};
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;

const TRIALS: usize = 80;

/// The text and the images of one condition.
#[derive(Default)]
struct Shots {
    lines: String,
    pixels: Vec<u8>,
    count: usize,
}

impl Shots {
    /// Takes in an image: the true u v a b, its levels, what was found.
    fn push(&mut self, truth: [f64; 4], levels: &[f32], found: &Ellipse) {
        let (c, a, b) = (found.center_px, found.semi_major_px, found.semi_minor_px);
        for x in truth.into_iter().chain([c.u_px, c.v_px, a, b]) {
            let _ = write!(self.lines, "{x:e} ");
        }
        self.lines.push('\n');
        self.pixels.extend(levels.iter().flat_map(|x| x.to_le_bytes()));
        self.count += 1;
    }
}

/// Rows of `cargo bench --bench detect_table`: name, what they show, scenes and images of each.
fn rows() -> [(&'static str, Condition, usize, usize); 6] {
    let row = |semi_minor_px, blur_px, light, bits, bright| Condition {
        semi_minor_px,
        ratio: 1.2,
        blur_px,
        light,
        bits,
        noise: 0.015,
        bright,
    };
    [
        ("b 4 px, 16 bit", row(4.0, 0.8, Light::Even, 16, true), 20, 4),
        ("b 4 px, blur 1.7 px", row(4.0, 1.7, Light::Even, 8, false), 20, 4),
        ("b 8 px, blur 3 px", row(8.0, 3.0, Light::Even, 16, true), 20, 4),
        ("b 8 px, slant of 30 %", row(8.0, 0.8, Light::Slanted, 8, false), 20, 4),
        ("b 15 px, glare on the contour", row(15.0, 0.8, Light::Glare, 8, false), 20, 4),
        ("b 8 px, smoke of 30 %", row(8.0, 0.8, Light::Smoke, 16, true), 40, 1),
    ]
}

pub fn write(dir: &Path) -> ExitCode {
    std::fs::create_dir_all(dir).expect("folder for the images");
    let mut out = format!("cases {}\n", cases().len() + rows().len());
    let mut files = 0;
    let mut done = |name: &str, size: usize, levels: (f64, f64), bound: [f64; 4], shots: Shots| {
        let name = name.replace(' ', "_");
        let _ = writeln!(out, "{name} {size} {} {} {}", shots.count, levels.0, levels.1);
        let _ = writeln!(out, "{:e} {:e} {:e} {:e}", bound[0], bound[1], bound[2], bound[3]);
        out.push_str(&shots.lines);
        std::fs::write(dir.join(format!("discs_{files}.f32")), shots.pixels).expect("images");
        files += 1;
    };
    for (k, case) in cases().iter().enumerate() {
        let limit = bound(case);
        let mut random = Random(7 + k as u64);
        let mut shots = Shots::default();
        for trial in 0..TRIALS {
            let (s, image) = case.expose(trial, &mut random);
            let found = find_discs(&image.view(), &DetectOptions::default()).expect("an image").discs;
            assert_eq!(found.len(), 1, "{}, trial {trial}", case.name);
            shots.push([s.u, s.v, s.a, s.b], &image.levels(), &found[0].ellipse);
        }
        done(case.name, SIZE, (case.low, case.high), [0, 1, 2, 3].map(|j| limit[(j, j)].sqrt()), shots);
    }
    for (k, (name, condition, scenes, images)) in rows().into_iter().enumerate() {
        let mut shots = Shots::default();
        let bound = condition.show(scenes, images, 7 + k as u64, |s, levels, disc| {
            let disc = disc.unwrap_or_else(|| panic!("{name}: no disc"));
            shots.push([s.u, s.v, s.a, s.b], levels, &disc.ellipse);
        });
        done(name, condition.size(), condition.levels(), bound, shots);
    }
    std::fs::write(dir.join("discs.txt"), out).expect("discs.txt");
    ExitCode::SUCCESS
}
