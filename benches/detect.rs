//! Time to find the discs of one image, one thread.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, criterion_group, criterion_main};
use spivcal::detect::{DetectOptions, find_discs};
use spivcal::image::{GrayView, Samples};
use std::hint::black_box;

/// Dark ellipses `(u, v, a, b)`, blurred by 1 px, under uneven light, with noise of 2 grey levels.
fn picture(width: usize, height: usize, spots: impl Fn(f64, f64) -> (f64, f64, f64, f64)) -> Vec<u8> {
    let mut state = 1u64;
    let mut noise = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as f64 / (1u64 << 31) as f64 - 0.5) * 7.0
    };
    let mut grey = Vec::with_capacity(width * height);
    for v in 0..height {
        for u in 0..width {
            let (x, y) = (u as f64, v as f64);
            let (cu, cv, a, b) = spots(x, y);
            let q = ((x - cu) / a).hypot((y - cv) / b).max(1e-6);
            let d = (q - 1.0) * q / ((x - cu) / (a * a)).hypot((y - cv) / (b * b)).max(1e-6);
            // The normal distribution to 1.4e-4.
            let inside = 1.0 / (1.0 + (0.07056 * d.powi(3) + 1.5976 * d).exp());
            let light = 170.0 + 40.0 * x / width as f64;
            grey.push((light * (1.0 - 0.75 * inside) + noise()).round().clamp(0.0, 255.0) as u8);
        }
    }
    grey
}

fn bench(c: &mut Criterion) {
    let two =
        picture(1024, 768, |x, _| if x < 512.0 { (300.3, 380.2, 120.0, 90.0) } else { (720.7, 390.6, 100.0, 75.0) });
    let view = GrayView::new(Samples::U8(&two), 1024, 768, 1024).unwrap();
    let options = DetectOptions::default();
    assert_eq!(find_discs(&view, &options).unwrap().discs.len(), 2);
    c.bench_function("two discs, 1024 x 768", |b| b.iter(|| find_discs(black_box(&view), &options).unwrap()));

    let (width, height, pitch) = (2592, 1944, 74.0);
    let many = picture(width, height, |x, y| {
        ((x / pitch).floor() * pitch + 37.0, (y / pitch).floor() * pitch + 37.0, 13.0, 11.0)
    });
    let view = GrayView::new(Samples::U8(&many), width, height, width).unwrap();
    assert!(find_discs(&view, &options).unwrap().discs.len() >= 900);
    c.bench_function("900 dots, 5 MP", |b| b.iter(|| find_discs(black_box(&view), &options).unwrap()));
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = bench
}
criterion_main!(benches);
