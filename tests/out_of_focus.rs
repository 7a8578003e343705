//! Discs seen through a lens out of focus, whose blur is no Gaussian's: as accurate as can be, all discs of an image telling its shape.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod detect_table;
mod render;

use detect_table::{Condition, Light, off};
use render::{Clean, Random, Spot};
use spivcal::detect::{DetectOptions, Disc, find_discs};
use spivcal::image::{GrayView, Samples};

/// Discs side by side, each drawn by `draw` about the middle of its square, and where they are.
fn side_by_side(
    c: &Condition,
    [columns, rows]: [usize; 2],
    draw: impl Fn(usize, &Spot) -> Clean,
) -> (Clean, Vec<Spot>) {
    let size = c.size();
    let (width, height) = (columns * size, rows * size);
    let (mut all, mut spots) = (Clean { width, height, grey: vec![0.0; width * height] }, vec![]);
    for k in 0..columns * rows {
        let [left, top] = [k % columns * size, k / columns * size];
        let spot = c.spot((0.618 * k as f64).fract() - 0.5, (0.414 * k as f64).fract() - 0.5);
        for (v, row) in draw(k, &spot).grey.chunks(size).enumerate() {
            all.grey[(top + v) * width + left..][..size].copy_from_slice(row);
        }
        spots.push(Spot { u: spot.u + left as f64, v: spot.v + top as f64, ..spot });
    }
    (all, spots)
}

/// Shows each disc as it is found in so many noisy images.
fn expose(c: &Condition, all: &Clean, spots: &[Spot], images: usize, mut each: impl FnMut(usize, &Spot, &Disc)) {
    let mut random = Random(5);
    for _ in 0..images {
        let grey = all.noisy_u16(|grey| c.sigma(grey), &mut random);
        let view = GrayView::new(Samples::U16(&grey), all.width, all.height, all.width).unwrap();
        let discs = find_discs(&view, &DetectOptions::default()).unwrap().discs;
        for (k, spot) in spots.iter().enumerate() {
            let off_px = |d: &&Disc| (d.ellipse.center_px.u_px - spot.u).hypot(d.ellipse.center_px.v_px - spot.v);
            each(k, spot, discs.iter().find(|d| off_px(d) < 3.0).expect("a disc"));
        }
    }
}

/// A Gaussian left axes off by 10 to 24 mpx here, with sigmas of 8 to 18.
#[test]
fn dark_discs_out_of_focus_are_as_accurate_as_can_be() {
    for (semi_minor_px, blur_px) in [(8.0, 0.6), (15.0, 1.0)] {
        let (light, bright) = (Light::Defocus, false);
        let c = Condition { semi_minor_px, ratio: 1.2, blur_px, light, bits: 8, noise: 0.015, bright };
        let row = c.run(10, 12, 31 + semi_minor_px as u64);
        let worst = row.bias_px.iter().zip(row.bound_px).map(|(bias, bound)| (bias / bound).abs()).fold(0.0, f64::max);
        println!(
            "{semi_minor_px} px, {blur_px} px: ratio {:.2?}, bias {:.4?} px, bound {:.4?} px, z^2 {:.2}, {} found",
            row.ratio, row.bias_px, row.bound_px, row.z2, row.found
        );
        assert_eq!(row.found, 120);
        // Of 120 images a ratio is known to 6.5 % and a mean to 0.09 of the bound.
        assert!(row.overall() < 1.13 && row.ratio.iter().all(|x| *x < 1.25), "ratio {:?}", row.ratio);
        assert!(worst < 0.35, "a mean is off by {worst} of the bound");
        assert!((0.8..1.25).contains(&row.z2), "z^2 {}", row.z2);
    }
}

/// One bright disc of the smallest, printed: it tells how much louder the light is inside, and then that it is the lens. Taken for one that may be full of
/// smoke it had axes 0.12 px too long, and one in four was not found.
#[test]
fn the_smallest_printed_disc_out_of_focus_is_as_accurate_as_can_be() {
    let (light, bright) = (Light::Defocus, true);
    let c = Condition { semi_minor_px: 4.0, ratio: 1.2, blur_px: 1.0, light, bits: 16, noise: 0.015, bright };
    let row = c.run(10, 16, 37);
    println!(
        "ratio {:.2?}, bias {:.4?} px, bound {:.4?} px, z^2 {:.2}, {} found",
        row.ratio, row.bias_px, row.bound_px, row.z2, row.found
    );
    assert_eq!(row.found, 160);
    // Of 160 images a ratio is known to 6 % and a mean to 0.08 of the bound.
    assert!(row.overall() < 1.13 && row.ratio.iter().all(|x| *x < 1.25), "ratio {:?}", row.ratio);
    assert!(row.bias_px.iter().zip(row.bound_px).all(|(bias, bound)| bias.abs() < 0.35 * bound), "{:?}", row.bias_px);
    assert!((0.75..1.25).contains(&row.z2), "z^2 {}", row.z2);
}

/// Bright discs, which may be full of smoke: six of them say that it is the lens.
#[test]
fn bright_discs_out_of_focus_are_as_accurate_as_can_be() {
    let (light, bright) = (Light::Defocus, true);
    let c = Condition { semi_minor_px: 8.0, ratio: 1.2, blur_px: 0.9, light, bits: 16, noise: 0.015, bright };
    let bound = c.show(1, 0, 1, |_, _, _| ());
    let (all, spots) = side_by_side(&c, [3, 2], |_, spot| c.draw_out_of_focus(spot, 0.9, c.levels(), 2.7));
    const IMAGES: usize = 25;
    let count = (IMAGES * spots.len()) as f64;
    let (mut squares, mut means, mut z2) = (0.0, [0.0; 4], 0.0);
    expose(&c, &all, &spots, IMAGES, |_, spot, disc| {
        let (error, squared) = off(spot, disc);
        z2 += squared / count;
        squares += error.iter().zip(bound).map(|(e, b)| (e / b).powi(2)).sum::<f64>() / (4.0 * count);
        means.iter_mut().zip(error).for_each(|(sum, e)| *sum += e / count);
    });
    println!("ratio {:.2}, bias {means:.4?} px, bound {bound:.4?} px, z^2 {z2:.2}", squares.sqrt());
    assert!(squares.sqrt() < 1.13, "ratio {}", squares.sqrt());
    assert!(means.iter().zip(bound).all(|(mean, bound)| mean.abs() < 0.35 * bound), "off by {means:?} px");
    assert!((0.8..1.25).contains(&z2), "z^2 {z2}");
}

/// Dots of a tilted target, from sharp ones to those out of focus by 3 px: each has the shape that goes with its blur.
#[test]
fn focus_may_differ_over_the_image() {
    const COLUMNS: usize = 8;
    const ROWS: usize = 6;
    const IMAGES: usize = 6;
    let (light, bright) = (Light::Defocus, false);
    let c = Condition { semi_minor_px: 9.0, ratio: 1.2, blur_px: 1.0, light, bits: 16, noise: 0.006, bright };
    let (all, spots) = side_by_side(&c, [COLUMNS, ROWS], |k, spot| {
        let spread_px = 3.0 * (k % COLUMNS) as f64 / (COLUMNS - 1) as f64;
        c.draw_out_of_focus(spot, 0.7, c.levels(), spread_px)
    });
    let (mut z2, mut axes, each) = ([0.0; 2], [0.0; 2], (IMAGES * COLUMNS * ROWS / 2) as f64);
    expose(&c, &all, &spots, IMAGES, |k, spot, disc| {
        let (error, squared) = off(spot, disc);
        let half = usize::from(k % COLUMNS >= COLUMNS / 2);
        z2[half] += squared / each;
        axes[half] += 0.5 * (error[2] + error[3]) / each;
    });
    println!("z^2 of the sharper half {:.2}, of the other {:.2}; axes off by {:.4?} px", z2[0], z2[1], axes);
    assert!(z2.iter().all(|z2| (0.75..1.35).contains(z2)), "z^2 {z2:?}");
    assert!(axes.iter().all(|x| x.abs() < 0.002), "axes off by {axes:?} px");
}
