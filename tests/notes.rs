//! What the program says beside its results: of images whose noise is cut off at grey level 0, and of dots that are no ellipses.

#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod program;
mod render;

use program::{example, spivcal};
use render::{Random, Spot, draw};
use serde_json::Value;
use spivcal::image::{GrayImage, Pixels};
use spivcal::pipeline::{load_image, png_bytes};
use std::path::Path;

fn store(folder: &Path, name: &str, grey: Vec<u8>, width: usize) {
    let height = grey.len() / width;
    let image = GrayImage::new(Pixels::U8(grey), width, height).unwrap();
    std::fs::write(folder.join(name), png_bytes(&image).unwrap()).unwrap();
}

/// Notes of `spivcal detect` about the images of a folder, and what `--json` says of each.
fn detect(folder: &Path, names: &[&str]) -> (Vec<String>, Vec<Value>) {
    let out = folder.join("out");
    let paths: Vec<_> = names.iter().map(|name| folder.join(name)).collect();
    let mut arguments = vec!["detect", "--json", "-o", out.to_str().unwrap()];
    arguments.extend(paths.iter().map(|path| path.to_str().unwrap()));
    let done = spivcal(&arguments);
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert_eq!(done.status.code(), Some(0), "{said}");
    let json: Value = serde_json::from_slice(&done.stdout).unwrap();
    let notes = said.lines().filter(|line| line.starts_with("note: ")).map(Into::into).collect();
    (notes, json["images"].as_array().unwrap().clone())
}

/// Two discs on a ground, the darker of which is so bright, with read noise and, where there is any, shot noise.
fn pair(black: f64, bright: bool, read: f64) -> (Vec<u8>, usize) {
    let spots = [(45.3, 50.2), (125.1, 50.7)].map(|(u, v)| Spot { u, v, a: 30.0, b: 24.0, phi: 0.3 });
    let clean = draw(170, 100, 0.9, |u, v, h| {
        let inside = spots.iter().map(|s| s.cover(u, v, h)).fold(0.0, f64::max);
        black + 150.0 * if bright { inside } else { 1.0 - inside }
    });
    let noise = |grey: f64| (read * read + f64::from(u8::from(read > 0.0)) * 0.05 * (grey - black).max(0.0)).sqrt();
    (clean.noisy_u8(noise, &mut Random(5)), 170)
}

#[test]
fn noise_that_is_cut_off_at_zero_is_told_once_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("ground.png", 0.0, true, 3.0, true),
        ("discs.png", 1.0, false, 3.0, true),
        ("offset.png", 9.0, true, 3.0, false),
        ("offset_discs.png", 9.0, false, 3.0, false),
        ("clean.png", 0.0, true, 0.0, false),
        ("clean_offset.png", 9.0, false, 0.0, false),
    ];
    for (name, black, bright, read, _) in cases {
        let (grey, width) = pair(black, bright, read);
        store(folder.path(), name, grey, width);
    }
    let told =
        |notes: Vec<String>| -> Vec<String> { notes.into_iter().filter(|n| n.contains("grey level 0")).collect() };
    let (notes, images) = detect(folder.path(), &cases.map(|case| case.0));
    for (image, (name, .., cut)) in images.iter().zip(cases) {
        let part = image["cut_at_zero"].as_f64().unwrap();
        println!("{name}: {part:.4} cut off at zero");
        assert_eq!(image["discs"], 2, "{name}");
        assert!(if cut { part > 0.2 } else { part < 0.01 }, "{name}: {part}");
    }
    let notes = told(notes);
    let [note] = &notes[..] else { panic!("{notes:?}") };
    for words in ["2 image(s)", "ground.png the most", "raise the camera's offset"] {
        assert!(note.contains(words), "{words} is not in: {note}");
    }
    assert!(told(detect(folder.path(), &["offset.png", "clean.png"]).0).is_empty());
}

/// The report of a calibration says so, too, and its file by how much.
#[test]
fn a_calibration_from_images_without_an_offset_says_so() {
    let (folder, mut random) = (tempfile::tempdir().unwrap(), Random(8));
    for entry in std::fs::read_dir(example("printed")).unwrap() {
        let path = entry.unwrap().path();
        let place = folder.path().join(path.file_name().unwrap());
        if path.extension().is_some_and(|e| e == "png") {
            let image = load_image(&path).unwrap();
            let (view, width) = (image.view(), image.width());
            let mut darker = |i: usize| f64::from(view.get(i % width, i / width)) - 26.0 + 4.0 * random.normal();
            let grey = (0..width * image.height()).map(|i| darker(i).round().clamp(0.0, 255.0) as u8).collect();
            store(folder.path(), place.file_name().unwrap().to_str().unwrap(), grey, width);
        } else if path.extension().is_some_and(|e| e == "toml") {
            std::fs::copy(&path, place).unwrap();
        }
    }
    let (rig, out) = (folder.path().join("rig.toml"), folder.path().join("out"));
    let done = spivcal(&["calibrate", rig.to_str().unwrap(), "-o", out.to_str().unwrap()]);
    let text = String::from_utf8_lossy(&done.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(text.contains("In 12 images noise beside the contours of discs is cut off at grey level 0"), "{text}");
    let json: Value = serde_json::from_slice(&std::fs::read(out.join("calibration.json")).unwrap()).unwrap();
    let images = json["provenance"]["images"].as_array().unwrap();
    let parts: Vec<f64> = images.iter().map(|i| i["cut_at_zero"].as_f64().unwrap_or(0.0)).collect();
    println!("{parts:.3?}");
    assert!(parts.len() == 12 && parts.iter().all(|part| *part > 0.02), "{parts:?}");
}

/// Nine dark dots behind a blur of 0.9 px, with so many corners; round for none.
fn dots(corners: usize) -> (Vec<u8>, usize) {
    let pitch = 48.0;
    let clean = draw(144, 144, 0.9, |u, v, h| {
        let near = |x: f64| x - pitch * ((x / pitch).floor() + 0.5);
        let (x, y) = (near(u), near(v));
        let out = |k: usize| {
            let (s, c) = (0.2 + std::f64::consts::TAU * k as f64 / corners as f64).sin_cos();
            x * c + y * s
        };
        let out = if corners > 0 { (0..corners).map(out).fold(f64::MIN, f64::max) } else { x.hypot(y) };
        190.0 - 150.0 * (0.5 - (out - 15.0) / h).clamp(0.0, 1.0)
    });
    (clean.noisy_u8(1.5, &mut Random(3)), 144)
}

#[test]
fn dots_that_are_no_ellipses_are_told_once_an_image() {
    let folder = tempfile::tempdir().unwrap();
    for (name, corners) in [("round.png", 0), ("eight.png", 8)] {
        let (grey, width) = dots(corners);
        store(folder.path(), name, grey, width);
    }
    let (notes, images) = detect(folder.path(), &["round.png", "eight.png"]);
    let notes: Vec<&String> = notes.iter().filter(|n| n.contains("no ellipses")).collect();
    let [note] = notes[..] else { panic!("{notes:?}") };
    println!("{note}");
    for words in ["eight.png: 9 of 9 disc(s)", "up to 5 times", "see to the print"] {
        assert!(note.contains(words), "{words} is not in: {note}");
    }
    let told = |k: usize| (images[k]["rough_discs"].as_u64().unwrap(), images[k]["sigmas_enlarged"].as_f64().unwrap());
    assert!(told(0).0 == 0 && told(0).1 < 1.2 && told(1).0 == 9 && told(1).1 > 4.0, "{:?} {:?}", told(0), told(1));
    let one: Value = serde_json::from_slice(&std::fs::read(folder.path().join("out/eight.json")).unwrap()).unwrap();
    assert!(one["discs"].as_array().unwrap().iter().all(|d| d["sigmas_enlarged"].as_f64().unwrap() > 4.0));
}
