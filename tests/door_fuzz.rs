//! The C door under random calls, seeded: the kept corpus of `fuzz/` first, then mutations of it.
//!
//! `SPIVCAL_FUZZ_SECONDS=600 cargo test --release --test door_fuzz -- --nocapture` for ten minutes, `SPIVCAL_FUZZ_SEED` for others than
//! the first. An input that fails is written to the temporary folder, named in the message.
#![allow(unsafe_code, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod door_calls;
mod scene;

use door_calls::TARGETS;
use proptest::prelude::Rng;
use proptest::test_runner::{RngAlgorithm, TestRng};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest input.
const LONGEST: usize = 1 << 16;

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name} is no number: {text}")))
}

fn corpus(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder).unwrap().map(|f| f.unwrap().path()).collect();
    files.sort();
    files.into_iter().map(|f| (f.clone(), std::fs::read(f).unwrap())).collect()
}

fn below(rng: &mut TestRng, n: usize) -> usize {
    (rng.next_u64() % n.max(1) as u64) as usize
}

/// A few changes of the kinds that libFuzzer makes.
fn mutated(rng: &mut TestRng, mut data: Vec<u8>, other: &[u8]) -> Vec<u8> {
    const DIGITS: [&[u8]; 8] = [b"-1", b"0", b"1e308", b"nan", b"9999999999", b"null", b"[]", b"\"\""];
    for _ in 0..1 + below(rng, 6) {
        let (at, length) = (below(rng, data.len() + 1), below(rng, 40));
        let end = (at + length).min(data.len());
        match below(rng, 7) {
            0 if at < data.len() => data[at] ^= 1 << below(rng, 8),
            1 if at < data.len() => data[at] = rng.next_u64() as u8,
            2 => drop(data.drain(at..end)),
            3 => drop(data.splice(at..at, (0..length).map(|_| rng.next_u64() as u8).collect::<Vec<_>>())),
            4 => drop(data.splice(at..end, DIGITS[below(rng, 8)].iter().copied())),
            5 => {
                let from = below(rng, other.len() + 1);
                let part = other[from..(from + length).min(other.len())].to_vec();
                drop(data.splice(at..end, part));
            }
            _ => drop(data.splice(at..at, data[at..end].to_vec())),
        }
    }
    data.truncate(LONGEST);
    data
}

#[test]
fn the_kept_corpus_passes() {
    for (name, target) in TARGETS {
        let files = corpus(name);
        assert!(files.len() >= 2, "fuzz/corpus/{name} is empty");
        for (path, data) in files {
            assert!(catch_unwind(|| target(&data)).is_ok(), "{}", path.display());
        }
    }
}

#[test]
fn random_calls_give_what_the_header_says() {
    let (seconds, seed) = (number("SPIVCAL_FUZZ_SECONDS", 8), number("SPIVCAL_FUZZ_SEED", 1));
    let share = Duration::from_secs(seconds) / TARGETS.len() as u32;
    for (name, target) in TARGETS {
        let mut rng = TestRng::from_seed(
            RngAlgorithm::ChaCha,
            &std::array::from_fn::<u8, 32, _>(|i| (seed >> (8 * (i % 8))) as u8),
        );
        let files = corpus(name);
        let (start, mut runs) = (Instant::now(), 0);
        while start.elapsed() < share {
            let pick = |rng: &mut TestRng| files[below(rng, files.len())].1.clone();
            let data = if name == "calls" && below(&mut rng, 2) == 0 {
                (0..below(&mut rng, 1200)).map(|_| rng.next_u64() as u8).collect()
            } else {
                let (one, other) = (pick(&mut rng), pick(&mut rng));
                mutated(&mut rng, one, &other)
            };
            if catch_unwind(AssertUnwindSafe(|| target(&data))).is_err() {
                let path = std::env::temp_dir().join(format!("spivcal-{name}-{seed}-{runs}"));
                std::fs::write(&path, &data).unwrap();
                panic!("target {name}, input {runs} of seed {seed}, {} bytes: {}", data.len(), path.display());
            }
            runs += 1;
        }
        println!("{name}: {runs} inputs in {:.1} s", start.elapsed().as_secs_f64());
        assert!(runs > 0);
    }
}

/// The seed of `calibration` is that of the made-up scene: `SPIVCAL_WRITE_CORPUS=1` writes it anew.
#[test]
fn the_scene_of_the_corpus_is_a_calibration() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/calibration/scene.json");
    if std::env::var("SPIVCAL_WRITE_CORPUS").is_ok() {
        std::fs::write(&path, scene::record().to_json().unwrap()).unwrap();
    }
    let read = spivcal::record::Record::from_json(&std::fs::read_to_string(&path).unwrap(), "scene.json").unwrap();
    assert!(read.sheet.is_some() && read.cameras.len() == 2);
}
