//! Discs seen through a lens out of focus, whose blur is no Gaussian's: as accurate as can be, all discs of an image telling its shape.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod detect_table;
mod render;

use detect_table::{Condition, Light, off};
use render::{Clean, Random};
use spivcal::detect::{DetectOptions, find_discs};
use spivcal::image::{GrayView, Samples};

/// A Gaussian left axes off by 10 to 24 mpx here, with sigmas of 8 to 18.
#[test]
fn discs_out_of_focus_are_as_accurate_as_can_be() {
    for (semi_minor_px, blur_px, bits, bright) in [(8.0, 0.6, 8, false), (8.0, 0.9, 16, true), (15.0, 1.0, 8, false)] {
        let c = Condition { semi_minor_px, ratio: 1.2, blur_px, light: Light::Defocus, bits, noise: 0.015, bright };
        let row = c.run(10, 12, 31 + semi_minor_px as u64);
        let worst = row.bias_px.iter().zip(row.bound_px).map(|(bias, bound)| (bias / bound).abs()).fold(0.0, f64::max);
        println!(
            "{semi_minor_px} px, {blur_px} px, {bits} bits: ratio {:.2?}, bias {:.4?} px, bound {:.4?} px, z^2 {:.2}, {} found",
            row.ratio, row.bias_px, row.bound_px, row.z2, row.found
        );
        assert_eq!(row.found, 120);
        // Of 120 images a ratio is known to 6.5 % and a mean to 0.09 of the bound.
        assert!(row.overall() < 1.13 && row.ratio.iter().all(|x| *x < 1.25), "ratio {:?}", row.ratio);
        assert!(worst < 0.35, "a mean is off by {worst} of the bound");
        assert!((0.8..1.25).contains(&row.z2), "z^2 {}", row.z2);
    }
}

/// Dots of a tilted target, from sharp ones to those out of focus by 3 px: each has the shape that goes with its blur.
#[test]
fn focus_may_differ_over_the_image() {
    const COLUMNS: usize = 8;
    const ROWS: usize = 6;
    let c = Condition {
        semi_minor_px: 9.0,
        ratio: 1.2,
        blur_px: 1.0,
        light: Light::Defocus,
        bits: 16,
        noise: 0.006,
        bright: false,
    };
    let size = c.size();
    let mut all = Clean { width: COLUMNS * size, height: ROWS * size, grey: vec![0.0; COLUMNS * ROWS * size * size] };
    let mut spots = vec![];
    for k in 0..COLUMNS * ROWS {
        let [left, top] = [k % COLUMNS * size, k / COLUMNS * size];
        let mut spot = c.spot((0.618 * k as f64).fract() - 0.5, (0.414 * k as f64).fract() - 0.5);
        let spread_px = 3.0 * (k % COLUMNS) as f64 / (COLUMNS - 1) as f64;
        let one = c.draw_out_of_focus(&spot, 0.7, c.levels(), spread_px);
        for (v, row) in one.grey.chunks(size).enumerate() {
            all.grey[(top + v) * all.width + left..][..size].copy_from_slice(row);
        }
        (spot.u, spot.v) = (spot.u + left as f64, spot.v + top as f64);
        spots.push(spot);
    }
    let (mut random, mut z2, mut axes) = (Random(5), [0.0; 2], [0.0; 2]);
    const IMAGES: usize = 6;
    for _ in 0..IMAGES {
        let grey = all.noisy_u16(0.006 * (c.levels().0 - c.levels().1), &mut random);
        let view = GrayView::new(Samples::U16(&grey), all.width, all.height, all.width).unwrap();
        let discs = find_discs(&view, &DetectOptions::default()).unwrap().discs;
        for (k, spot) in spots.iter().enumerate() {
            let near = |d: &&spivcal::detect::Disc| {
                (d.ellipse.center_px.u_px - spot.u).hypot(d.ellipse.center_px.v_px - spot.v) < 3.0
            };
            let (error, squared) = off(spot, discs.iter().find(near).expect("a disc"));
            let half = usize::from(k % COLUMNS >= COLUMNS / 2);
            z2[half] += squared / (IMAGES * COLUMNS * ROWS / 2) as f64;
            axes[half] += 0.5 * (error[2] + error[3]) / (IMAGES * COLUMNS * ROWS / 2) as f64;
        }
    }
    println!("z^2 of the sharper half {:.2}, of the other {:.2}; axes off by {:.4?} px", z2[0], z2[1], axes);
    assert!(z2.iter().all(|z2| (0.75..1.35).contains(z2)), "z^2 {z2:?}");
    assert!(axes.iter().all(|x| x.abs() < 0.002), "axes off by {axes:?} px");
}
