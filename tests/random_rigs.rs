//! Rigs drawn at random, from images to the calibration, against the truth: few here, many in `examples/random_rigs.rs`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod random_rig;
mod share;

use random_rig::{KINDS, NUMBERS, run, scene};
use share::share;

/// Of each kind of target two rigs: none refused, nothing found fault with, and errors as their standard deviations say.
#[test]
fn random_rigs_are_off_by_what_their_sigmas_say() {
    let (mut squares, mut count) = (0.0, 0.0);
    for kind in KINDS {
        for seed in 0..share(2, 2) as u64 {
            let outcome = run(&scene(seed, kind)).unwrap_or_else(|words| panic!("{kind}, rig {seed}: {words}"));
            for (name, z) in NUMBERS.iter().zip(&outcome.z) {
                // Of 120 numbers one is beyond 4.5 by chance once in 1200 times; written so that NaN is wrong too.
                assert!(z.abs() < 4.5, "{kind}, rig {seed}, {name}: {z:.1} standard deviations");
            }
            squares += outcome.z.iter().map(|z| z * z).sum::<f64>();
            count += outcome.z.len() as f64;
            assert!(outcome.alarms.is_empty(), "{kind}, rig {seed}: {:?}", outcome.alarms);
        }
    }
    let rms = (squares / count).sqrt();
    println!("{count} numbers, rms error in standard deviations {rms:.2}");
    // Ten numbers of a rig hang together: known to a tenth.
    assert!((0.7..1.4).contains(&rms), "{rms}");
}
