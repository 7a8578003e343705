#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]
mod render;
use render::{Random, Spot, draw};
use spivcal::detect::{DetectOptions, find_discs};
use spivcal::image::{GrayView, Samples};
use std::f64::consts::TAU;
#[test]
fn look() {
    for (b, amp, noise, long) in [
        (100.0, 0.3, 0.015, 1.0),
        (100.0, 0.3, 0.0015, 1.0),
        (100.0, 0.3, 0.0015, 3.0),
        (100.0, 0.3, 0.015, 3.0),
        (100.0, 0.0, 0.015, 3.0),
        (40.0, 0.3, 0.015, 1.0),
        (40.0, 0.3, 0.0015, 1.0),
        (40.0, 0.3, 0.0015, 3.0),
    ] {
        let size = (2.0_f64 * 1.2 * b + 50.0) as usize;
        let m = (size / 2) as f64;
        let (mut z, mut sq, mut n) = ([0.0; 4], [0.0; 4], 0.0);
        let t0 = std::time::Instant::now();
        let mut spent = 0.0;
        for scene in 0..24u64 {
            let spot = Spot {
                u: m + (scene as f64 * 0.618).fract() - 0.5,
                v: m + (scene as f64 * 0.414).fract() - 0.5,
                a: 1.2 * b,
                b,
                phi: 0.4,
            };
            let mut random = Random((scene + 1).wrapping_mul(0x9e3779b97f4a7c15));
            for _ in 0..50 {
                random.uniform();
            }
            let waves: Vec<[f64; 4]> = (0..8)
                .map(|i| {
                    let l = b * (1.0 + 3.0 * i as f64 / 7.0) * long;
                    let t = TAU * random.uniform();
                    let k = TAU / l;
                    [k * t.cos(), k * t.sin(), TAU * random.uniform(), amp / 8.0_f64.sqrt()]
                })
                .collect();
            let clean = draw(size, size, 0.8, |u, v, h| {
                let (x, y) = (u - m, v - m);
                let smoke: f64 = waves.iter().map(|w| w[3] * (w[0] * x + w[1] * y + w[2]).sin()).sum();
                6000.0 + (36000.0 * (1.0 + smoke) - 6000.0) * spot.cover(u, v, h)
            });
            for _ in 0..4 {
                let p = clean.noisy_u16(noise * 30000.0, &mut random);
                let t1 = std::time::Instant::now();
                let found =
                    find_discs(&GrayView::new(Samples::U16(&p), size, size, size).unwrap(), &DetectOptions::default())
                        .unwrap();
                spent += t1.elapsed().as_secs_f64();
                let Some(d) = found.discs.first() else { continue };
                let e = &d.ellipse;
                let x = [
                    e.center_px.u_px - spot.u,
                    e.center_px.v_px - spot.v,
                    e.semi_major_px - spot.a,
                    e.semi_minor_px - spot.b,
                ];
                for k in 0..4 {
                    z[k] += x[k] * x[k] / d.covariance[(k, k)];
                    sq[k] += x[k] * x[k];
                }
                n += 1.0;
            }
        }
        println!(
            "b {b} amp {amp} noise {noise} long {long}: n {n} z2 {:.2?} rms {:.5?}; {:.1} ms each, {:.0} s",
            z.map(|x| x / n),
            sq.map(|x: f64| (x / n).sqrt()),
            1e3 * spent / n,
            t0.elapsed().as_secs_f64()
        );
    }
}
