//! Time to find the discs of one image, one thread, in the memory of the image before.
#![allow(missing_docs, clippy::unwrap_used)]

mod scenes;

use criterion::{Criterion, criterion_group, criterion_main};
use spivcal::detect::{DetectMemory, DetectOptions, find_discs_with};
use spivcal::image::{GrayView, Samples};
use std::hint::black_box;

fn bench(c: &mut Criterion) {
    let (options, memory) = (DetectOptions::default(), DetectMemory::default());
    let mut time = |name: &str, least: usize, scene: &dyn Fn() -> (Vec<u8>, usize, usize)| {
        c.bench_function(name, |b| {
            let (grey, width, height) = scene();
            let view = GrayView::new(Samples::U8(&grey), width, height, width).unwrap();
            assert!(find_discs_with(&view, &options, &memory).unwrap().discs.len() >= least);
            b.iter(|| find_discs_with(black_box(&view), &options, &memory).unwrap());
        });
    };
    time("two discs, 1024 x 768", 2, &scenes::two_discs);
    time("900 dots, 5 MP", 900, &|| scenes::dots(2592, 1944));
    time("a bubble of 7 x 5 px full of smoke", 1, &scenes::smoke);
    time("two bright discs of 7 x 5 px in shot noise", 2, &scenes::shot_noise);
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = bench
}
criterion_main!(benches);
