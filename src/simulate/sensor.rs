//! From light to grey levels: photons, electronics, bit depth.
//!
//! ```text
//! electrons = Poisson(full_well g) + read_noise n        g grey in parts of full scale, n normal
//! level     = round( (2^bits - 1) (offset + electrons / full_well) ), kept within 0 .. 2^bits - 1
//! ```
//! Without a full well the light is measured without noise.

use super::random::{Stream, Use};
use super::scene::ImageKeys;
use crate::error::Result;
use crate::image::{GrayImage, Pixels};

/// Digitise one image; `name` is its view and camera.
pub(super) fn expose(
    grey: &[f64],
    size_px: [usize; 2],
    image: &ImageKeys,
    seed: u64,
    name: [usize; 2],
) -> Result<GrayImage> {
    let [width, height] = size_px;
    let white = f64::from((1_u32 << image.bits) - 1);
    let mut levels = Vec::with_capacity(grey.len());
    for (v, row) in grey.chunks_exact(width).enumerate() {
        // A stream per row: rows could be exposed in any order.
        let mut stream = Stream::new(seed, Use::Sensor, &[name[0], name[1], v]);
        for &g in row {
            let signal = match image.full_well_e {
                None => g,
                Some(full) => {
                    let photons = stream.poisson(full * g);
                    let read = if image.read_noise_e > 0.0 { image.read_noise_e * stream.normal() } else { 0.0 };
                    (photons + read) / full
                }
            };
            levels.push((white * (image.offset_level + signal)).round().clamp(0.0, white));
        }
    }
    let pixels = if image.bits == 8 {
        Pixels::U8(levels.iter().map(|&l| l as u8).collect())
    } else {
        Pixels::U16(levels.iter().map(|&l| l as u16).collect())
    };
    GrayImage::new(pixels, width, height)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(bits: u32, full_well_e: Option<f64>, read_noise_e: f64) -> ImageKeys {
        ImageKeys { bits, full_well_e, read_noise_e, offset_level: 0.02, ..ImageKeys::default() }
    }

    #[test]
    fn every_bit_depth_has_its_full_scale_and_clips() {
        for bits in 8..=16 {
            let image = expose(&[0.0, 0.5, 2.0, -1.0], [4, 1], &keys(bits, None, 0.0), 1, [0, 0]).unwrap();
            let white = f64::from((1_u32 << bits) - 1);
            let want = [(0.02 * white).round(), (0.52 * white).round(), white, 0.0];
            let got: Vec<f64> = (0..4).map(|u| f64::from(image.view().get(u, 0))).collect();
            assert_eq!(got, want, "{bits} bit");
            assert_eq!(matches!(image.pixels(), Pixels::U8(_)), bits == 8);
        }
    }

    #[test]
    fn noise_is_that_of_the_photons_and_the_electronics() {
        let (full, read, n) = (20_000.0, 15.0, 40_000);
        for g in [0.0005, 0.05, 0.7] {
            let image = expose(&vec![g; n], [200, 200], &keys(16, Some(full), read), 5, [0, 1]).unwrap();
            let electrons = |i: usize| (f64::from(image.view().get(i % 200, i / 200)) / 65_535.0 - 0.02) * full;
            let mean = (0..n).map(electrons).sum::<f64>() / n as f64;
            let variance = (0..n).map(|i| (electrons(i) - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
            // Rounding to 16 bit adds the variance of one uniform level.
            let wanted = full * g + read * read + (full / 65_535.0_f64).powi(2) / 12.0;
            let z_mean = (mean - full * g) / (wanted / n as f64).sqrt();
            let z_variance = (variance / wanted - 1.0) / (2.0 / n as f64).sqrt();
            assert!(z_mean.abs() < 4.0 && z_variance.abs() < 4.0, "g {g}: z {z_mean:.2} {z_variance:.2}");
        }
    }
}
