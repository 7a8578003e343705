//! Uneven light makes no error that the discs of an image have in common, which no covariance of a disc would tell.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

mod disc_errors;

use disc_errors::errors_of_discs;
use nalgebra::{DMatrix, DVector};
use spivcal::simulate::Scene;

/// A grid of bright dots before the cameras of `examples/bubbles`, 17 px to a mm, tilted by up to 20 degrees in views at random.
struct Grid {
    radius_mm: f64,
    spacing_mm: f64,
    /// Columns and rows.
    count: [usize; 2],
    unevenness: f64,
    views: usize,
}

impl Grid {
    fn scene(&self, seed: u32) -> Scene {
        let text = include_str!("../examples/bubbles/scene.toml");
        let cameras = text.split("[target]").next().unwrap().replace("seed = 10", &format!("seed = {seed}"));
        let Self { radius_mm, spacing_mm, count: [columns, rows], unevenness, views } = self;
        let scene = format!(
            "{cameras}[target]\nkind = \"dot-grid\"\npolarity = \"bright\"\nspacing_mm = {spacing_mm:?}\nradius_mm = {radius_mm:?}\n\
             columns = {columns}\nrows = {rows}\n[image]\nblur_sigma_px = 1.1\nbits = 12\nfull_well_e = 30000\nread_noise_e = 8\n\
             unevenness = {unevenness:?}\n[random]\ncount = {views}\ntilt_deg = [20.0, 20.0]\nspin_deg = 180\nposition_mm = [2.0, 2.0, 2.0]\n\
             [rig]\nscale = \"target\"\n"
        );
        Scene::parse(&scene, "scene.toml").unwrap()
    }

    /// Mean square of what errors of centres over their sigmas show of a shift, a stretch and a bend of the whole image, each 1 where discs err by chance.
    fn measure(&self, seed: u32) -> f64 {
        let [columns, rows] = self.count.map(|n| n as f64);
        let of_image = self.count[0] * self.count[1];
        let errors = errors_of_discs(&self.scene(seed), 0);
        assert_eq!(errors.len(), 2 * self.views * of_image, "dots in the pictures");
        let mut squares = vec![];
        for (errors, k) in errors.chunks(of_image).flat_map(|image| [(image, 0), (image, 1)]) {
            let weighed = DMatrix::from_fn(of_image, 6, |i, j| {
                let x = (i % self.count[0]) as f64 / columns - 0.5;
                let y = (i / self.count[0]) as f64 / rows - 0.5;
                [1.0, x, y, x * x, x * y, y * y][j] / errors[i][k].1
            });
            let z = DVector::from_fn(of_image, |i, _| errors[i][k].0 / errors[i][k].1);
            squares.extend((weighed.qr().q().transpose() * z).iter().map(|x| x * x));
        }
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        println!("{columns} x {rows} dots of {} mm, unevenness {}: {mean:.2}", self.radius_mm, self.unevenness);
        mean
    }
}

/// With levels from twelve pixels of a disc, and no more than a plane from fewer than 40 discs, nothing from fewer than 12, the mean squares were 1.8, 1.9, 2.1,
/// 1.4, 3.5, and 0.9 in even light.
#[test]
fn uneven_light_shifts_stretches_and_bends_no_image() {
    let grids = [
        (1.2, 3.5, [9, 6], 0.4),
        (1.2, 3.5, [9, 6], 0.1),
        (1.5, 5.5, [5, 4], 0.3),
        (1.5, 6.0, [4, 3], 0.1),
        (0.5, 8.0, [3, 3], 0.4),
        (1.2, 3.5, [9, 6], 0.0),
    ];
    for (seed, (radius_mm, spacing_mm, count, unevenness)) in (31..).zip(grids) {
        let views = 8;
        let grid = Grid { radius_mm, spacing_mm, count, unevenness, views };
        let mean = grid.measure(seed);
        let chance = (2.0 / (6 * 2 * 2 * views) as f64).sqrt();
        assert!((mean - 1.0).abs() < 4.0 * chance, "mean square {mean:.2}, by chance 1 +- {chance:.2}");
    }
}
