#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]
mod render;
use render::{Random, Spot, draw};
use spivcal::detect::{DetectOptions, find_discs};
use spivcal::image::{GrayView, Samples};
use std::f64::consts::TAU;
#[test]
fn look() {
    let b = 100.0;
    let size = 290usize;
    for (amp, noise, waves_of) in
        [(0.3, 0.015, 0), (0.3, 0.0015, 0), (0.1, 0.0015, 0), (0.3, 0.0015, 1), (0.3, 0.0015, 2)]
    {
        for scene in 0..4u64 {
            let spot = Spot {
                u: 145.0 + (scene as f64 * 0.618).fract() - 0.5,
                v: 145.0 + (scene as f64 * 0.414).fract() - 0.5,
                a: 1.2 * b,
                b,
                phi: 0.4,
            };
            let mut random = Random(35_000 + scene);
            let waves: Vec<[f64; 4]> = (0..8)
                .map(|i| {
                    let l = b * (1.0 + 3.0 * i as f64 / 7.0) * if waves_of == 1 { 3.0 } else { 1.0 };
                    let t = TAU * random.uniform();
                    let k = TAU / l;
                    [k * t.cos(), k * t.sin(), TAU * random.uniform(), amp / 8.0_f64.sqrt()]
                })
                .collect();
            let clean = draw(size, size, 0.8, |u, v, h| {
                let (x, y) = (u - 145.0, v - 145.0);
                let smoke: f64 = if waves_of == 2 {
                    0.0
                } else {
                    waves.iter().map(|w| w[3] * (w[0] * x + w[1] * y + w[2]).sin()).sum()
                };
                6000.0 + (36000.0 * (1.0 + smoke) - 6000.0) * spot.cover(u, v, h)
            });
            let p = clean.noisy_u16(noise * 30000.0, &mut random);
            let found =
                find_discs(&GrayView::new(Samples::U16(&p), size, size, size).unwrap(), &DetectOptions::default())
                    .unwrap();
            let d = &found.discs[0];
            let e = &d.ellipse;
            println!(
                "amp {amp} noise {noise} w{waves_of} scene {scene}: du {:+.4} dv {:+.4} da {:+.4} db {:+.4}; sigma {:.4} {:.4} {:.4} {:.4}; blur {:.3} n {}",
                e.center_px.u_px - spot.u,
                e.center_px.v_px - spot.v,
                e.semi_major_px - spot.a,
                e.semi_minor_px - spot.b,
                d.covariance[(0, 0)].sqrt(),
                d.covariance[(1, 1)].sqrt(),
                d.covariance[(2, 2)].sqrt(),
                d.covariance[(3, 3)].sqrt(),
                d.blur_px,
                d.edge.u_px.len()
            );
            if scene < 2 {
                // Distance of edge points from the true ellipse, first order, by stretches.
                let n = d.edge.u_px.len();
                let (s, c) = spot.phi.sin_cos();
                let dist: Vec<(f64, f64, f64)> = (0..n)
                    .map(|i| {
                        let (x, y) = (d.edge.u_px[i] - spot.u, d.edge.v_px[i] - spot.v);
                        let (p, q) = ((c * x + s * y) / spot.a, (-s * x + c * y) / spot.b);
                        let r = p.hypot(q);
                        let g = (p / spot.a).hypot(q / spot.b);
                        let (gx, gy) = ((c * p / spot.a - s * q / spot.b) / g, (s * p / spot.a + c * q / spot.b) / g);
                        let slope: f64 = waves
                            .iter()
                            .map(|w| {
                                w[3] * (w[0] * gx + w[1] * gy)
                                    * (w[0] * (x + spot.u - 145.0) + w[1] * (y + spot.v - 145.0) + w[2]).cos()
                            })
                            .sum();
                        ((r - 1.0) * r / g, d.edge.sigma_px[i], slope)
                    })
                    .collect();
                let m = 24;
                let line: Vec<String> = (0..m)
                    .map(|k| {
                        let part = &dist[k * n / m..(k + 1) * n / m];
                        let w: f64 = part.iter().map(|x| x.1.powi(-2)).sum();
                        format!(
                            "{:+.1}/{:.1}/{:+.1}",
                            1e3 * part.iter().map(|x| x.0 * x.1.powi(-2)).sum::<f64>() / w,
                            1e3 * w.powf(-0.5),
                            1e3 * part.iter().map(|x| x.2).sum::<f64>() / part.len() as f64
                        )
                    })
                    .collect();
                println!("   {}", line.join(" "));
            }
        }
    }
}
