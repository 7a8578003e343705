//! Rendered discs for detectors of other makes: `discs.txt` and one raw image file per condition.
//!
//! ```text
//! cases N, then each: NAME size trials low high, Cramer-Rao sigmas of u v a b,
//! [true u v a b, found u v a b] x trials
//! discs_K.f32: trials x size x size grey levels of condition K, 32-bit little-endian floats
//! ```

use crate::render::Random;
use crate::render::accuracy::{SIZE, bound, cases};
use spivcal::detect::{DetectOptions, find_discs};
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;

const TRIALS: usize = 80;

pub fn write(dir: &Path) -> ExitCode {
    std::fs::create_dir_all(dir).expect("folder for the images");
    let all = cases();
    let mut out = format!("cases {}\n", all.len());
    for (k, case) in all.iter().enumerate() {
        let _ = writeln!(out, "{} {SIZE} {TRIALS} {} {}", case.name.replace(' ', "_"), case.low, case.high);
        let limit = bound(case);
        (0..4).for_each(|j| {
            let _ = write!(out, "{:e} ", limit[(j, j)].sqrt());
        });
        out.push('\n');
        let mut random = Random(7 + k as u64);
        let mut pixels = vec![];
        for trial in 0..TRIALS {
            let (s, image) = case.expose(trial, &mut random);
            let found = find_discs(&image.view(), &DetectOptions::default()).expect("an image").discs;
            assert_eq!(found.len(), 1, "{}, trial {trial}", case.name);
            let e = &found[0].ellipse;
            let (c, a, b) = (e.center_px, e.semi_major_px, e.semi_minor_px);
            let _ = writeln!(out, "{:e} {:e} {:e} {:e} {:e} {:e} {a:e} {b:e}", s.u, s.v, s.a, s.b, c.u_px, c.v_px);
            pixels.extend(image.levels().iter().flat_map(|x| x.to_le_bytes()));
        }
        std::fs::write(dir.join(format!("discs_{k}.f32")), pixels).expect("images");
    }
    std::fs::write(dir.join("discs.txt"), out).expect("discs.txt");
    ExitCode::SUCCESS
}
