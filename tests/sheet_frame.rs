//! `[sheet]`: the frame where the rig file wants it, and what is refused.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use nalgebra::{Matrix3, Vector3};
use spivcal::frames::{Rig, Sheet, Target};
use spivcal::pipeline::{CalibrateOptions, calibrate, load_image};
use spivcal::record::Record;
use spivcal::rig_file::{RigDescription, image_path};
use spivcal::rigid::Motion;
use std::path::Path;

fn run(sheet: &str) -> Record {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/printed/rig.toml");
    let text = std::fs::read_to_string(&file).unwrap() + sheet;
    let job = RigDescription::parse(&text, "rig.toml").unwrap_or_else(|e| panic!("{e}"));
    let load = |view: usize, camera: usize| {
        load_image(&image_path(&file, None, job.views[view].images[camera].as_deref().unwrap()))
            .map(std::sync::Arc::new)
    };
    calibrate(&job, &load, &CalibrateOptions::default(), &mut |_| true).unwrap_or_else(|e| panic!("{e}")).record
}

fn sheet_from_target(record: &Record, view: usize) -> Motion<Sheet, Target> {
    let sheet: Motion<Rig, Sheet> = record.sheet.as_ref().unwrap().rig_from_sheet.motion();
    let target: Motion<Rig, Target> = record.views[view].rig_from_target.unwrap().motion();
    sheet.inverse() * target
}

#[test]
fn the_frame_stands_on_the_disc_and_along_the_target() {
    let placed = run("\n[sheet]\norigin = { view = 5, column = 1 }\nx_axis = { view = 5 }\n");
    let pose = sheet_from_target(&placed, 5);
    let spacing = placed.target.spacing_mm;
    let disc = pose.apply(&Vector3::new(spacing, 0.0, 0.0));
    assert!(disc.norm() < 1e-9, "disc 1 at the origin: {disc}");
    // The target faces the first camera, and so does z: the two frames have the same axes.
    assert!((pose.rotation - Matrix3::identity()).norm() < 1e-9, "{}", pose.rotation);
    let plain = run("");
    // What is felt is told at the same points of the sheet, in this frame.
    let middle = |r: &Record| {
        let m = r.mapping_uncertainty.as_ref().unwrap().middle.clone();
        let frame: Motion<Rig, Sheet> = r.sheet.as_ref().unwrap().rig_from_sheet.motion();
        (frame.apply(&Vector3::new(m.point_mm[0], m.point_mm[1], 0.0)), m)
    };
    let ((p, here), (q, there)) = (middle(&placed), middle(&plain));
    assert!((p - q).norm() < 1.0, "{p} {q}: {:?} {:?}", here.point_mm, there.point_mm);
    assert!((here.point_mm[0] - there.point_mm[0]).abs() > 5.0, "{:?} {:?}", here.point_mm, there.point_mm);
    assert!((here.displacement[2][2] / there.displacement[2][2] - 1.0).abs() < 0.02);
    let (a, b) = (placed.sheet.unwrap(), plain.sheet.unwrap());
    for k in 0..3 {
        assert_eq!(a.normal_in_rig[k].to_bits(), b.normal_in_rig[k].to_bits());
    }
    // sigma of the turns goes with the axes: the same ellipse, seen in other axes.
    let size = |s: [f64; 2]| s[0] * s[0] + s[1] * s[1];
    assert!((size(a.sigma.normal_rad) / size(b.sigma.normal_rad) - 1.0).abs() < 1e-9);
    assert!((a.angles_deg[0] - b.angles_deg[0]).abs() < 1e-12 && b.angles_deg[2].abs() < 1e-9);
    assert!(a.angles_deg[2].abs() > 1.0, "{:?}", a.angles_deg);
}

#[test]
fn a_point_and_a_turn_place_it_too() {
    let turned = run("\n[sheet]\norigin = { point_mm = [3.0, -2.0, 500.0] }\nflip_x = true\n").sheet.unwrap();
    let plain = run("").sheet.unwrap();
    let (t, p): (Motion<Rig, Sheet>, Motion<Rig, Sheet>) =
        (turned.rig_from_sheet.motion(), plain.rig_from_sheet.motion());
    let half = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
    assert!((t.rotation - p.rotation * half).norm() < 1e-12, "x and y turned over, z kept");
    let n = Vector3::from(turned.normal_in_rig);
    let off = Vector3::new(3.0, -2.0, 500.0) - t.translation_mm;
    assert!((n.dot(&t.translation_mm) - turned.distance_mm).abs() < 1e-9 && n.cross(&off).norm() < 1e-9);
}

#[test]
fn what_cannot_place_a_frame_is_refused_with_its_line() {
    let text =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/printed/rig.toml")).unwrap();
    let lines = text.lines().count();
    let refused = |sheet: &str, words: &[&str]| {
        let message = RigDescription::parse(&(text.clone() + sheet), "rig.toml").unwrap_err().to_string();
        let line: usize = message.split(':').nth(1).unwrap().parse().unwrap();
        assert!(line > lines, "{message}");
        words.iter().for_each(|w| assert!(message.contains(w), "{w} in {message}"));
    };
    refused("\n[sheet]\norigin = { view = 9 }\n", &["0 to 5"]);
    refused("\n[sheet]\norigin = { view = 5, column = 2 }\n", &["0 or 1"]);
    refused("\n[sheet]\norigin = { view = 5, level = 1 }\n", &["one level"]);
    refused("\n[sheet]\norigin = { point_mm = [1.0, 2.0] }\n", &["three coordinates"]);
    refused("\n[sheet]\norigin = { view = 5, point_mm = [1.0, 2.0, 3.0] }\n", &["point_mm"]);
    refused("\n[sheet]\norigin = 5\n", &["view", "point_mm"]);
    refused("\n[sheet]\nx_axis = { column = 1 }\n", &["known here: view"]);
    refused("\n[sheet]\nflip_y = true\n", &["flip_x"]);
    refused("\n[sheet]\nflip_x = 1\n", &["true or false"]);
    let none = text.replace("sheet = true", "sheet = false") + "\n[sheet]\nflip_x = true\n";
    let message = RigDescription::parse(&none, "rig.toml").unwrap_err().to_string();
    assert!(message.contains("no view has sheet = true"), "{message}");
}
