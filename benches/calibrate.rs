//! Time of the main job in one thread: images of the paper's geometry (two cameras of 1024 x 768, six views) to record and
//! report; and of the adjustment alone.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/rig_scene/mod.rs"]
mod rig_scene;

use criterion::{Criterion, criterion_group, criterion_main};
use rig_scene::Scene;
use spivcal::bundle::{AdjustOptions, Termination, adjust};
use spivcal::pipeline::{CalibrateOptions, calibrate, load_image};
use spivcal::report::{OverlayInput, write_html};
use spivcal::rig_file::{RigDescription, image_path};
use std::hint::black_box;
use std::path::Path;

/// Files to the text of calibration.json and report.html; images are decoded inside.
fn printed() -> (String, String) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/printed/rig.toml");
    let job = RigDescription::parse(&std::fs::read_to_string(&file).unwrap(), "rig.toml").unwrap();
    let load = |view: usize, camera: usize| {
        load_image(&image_path(&file, None, job.views[view].images[camera].as_ref().unwrap())).map(std::sync::Arc::new)
    };
    let options = CalibrateOptions { threads: 1, ..CalibrateOptions::default() };
    let found = calibrate(&job, &load, &options, &mut |_| true).unwrap();
    let overlays: Vec<OverlayInput<'_>> = found
        .images
        .iter()
        .zip(&found.overlays)
        .map(|(i, shapes)| OverlayInput { view: i.view, camera: i.camera, image: i.image.view(), shapes })
        .collect();
    (found.record.to_json().unwrap(), write_html(&found.record, &overlays, &found.residuals).unwrap())
}

fn bench(c: &mut Criterion) {
    c.bench_function("printed: 12 images to record and report", |b| b.iter(|| black_box(printed())));

    let scene = Scene::build(4, false, true, false).with_noise(1);
    let start = scene.perturbed(1);
    let run = || adjust(&scene.model, start.clone(), &AdjustOptions::default(), &mut |_| true);
    assert_eq!(run().termination, Termination::Converged);
    c.bench_function("adjustment alone: 6 views of two discs, 960 edge points", |b| b.iter(|| black_box(run())));
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = bench
}
criterion_main!(benches);
