//! Light that is not even: smoke in the bubbles, uneven illumination, glare.
//!
//! ```text
//! smoke     T(p) = 1 + s tanh( sum_m a_m cos(k_m . p + phase_m) )      M = 16 waves, |k| = 2 pi / wavelength
//! uneven    U(q) = 1 - e ((1 + w) / 2)^2,   w = (xi cos t + eta sin t) / sqrt 2
//! glare     + level exp(-|q - q0|^2 / (2 r^2))
//! ```
//! Smoke belongs to the sheet (both cameras see the same), wavelengths from 0.4 to 4 times `smoke_length_mm`,
//! evenly spread in their logarithm, the long ones stronger (a_m as the root of the wavelength, total variance 0.6);
//! xi and eta run from -1 to 1 across the image, so U falls from 1 to 1 - e along the direction t.

use super::random::{Stream, Use};
use super::scene::{GlarePlace, ImageKeys};
use super::setup::{PlacedCamera, PlacedView, rim_px};
use nalgebra::Vector2;

/// Brightness of the smoke in a bubble, about 1.
pub(super) struct Smoke {
    amplitude: f64,
    waves: Vec<Wave>,
}

struct Wave {
    k_per_mm: Vector2<f64>,
    phase_rad: f64,
    height: f64,
}

impl Smoke {
    const WAVES: usize = 16;

    pub(super) fn new(image: &ImageKeys, seed: u64, view: usize) -> Self {
        let mut stream = Stream::new(seed, Use::Smoke, &[view]);
        let wave = |i: usize| {
            let octave = (i as f64 + stream.uniform()) / Self::WAVES as f64;
            let ratio = 0.4 * 10.0_f64.powf(octave);
            let (direction, phase_rad) = (stream.within(std::f64::consts::PI), stream.within(std::f64::consts::PI));
            let k = std::f64::consts::TAU / (image.smoke_length_mm * ratio);
            Wave { k_per_mm: Vector2::new(k * direction.cos(), k * direction.sin()), phase_rad, height: ratio.sqrt() }
        };
        let mut waves: Vec<Wave> = (0..Self::WAVES).map(wave).collect();
        let variance: f64 = waves.iter().map(|w| 0.5 * w.height * w.height).sum();
        waves.iter_mut().for_each(|w| w.height *= (0.6 / variance).sqrt());
        Self { amplitude: image.smoke, waves }
    }

    pub(super) fn at(&self, p_mm: &Vector2<f64>) -> f64 {
        if self.amplitude == 0.0 {
            return 1.0;
        }
        let sum: f64 = self.waves.iter().map(|w| w.height * (w.k_per_mm.dot(p_mm) + w.phase_rad).cos()).sum();
        1.0 + self.amplitude * sum.tanh()
    }
}

/// Uneven illumination of one image.
pub(super) struct Uneven {
    amount: f64,
    direction: Vector2<f64>,
    middle: Vector2<f64>,
    half: Vector2<f64>,
}

impl Uneven {
    pub(super) fn new(image: &ImageKeys, c: &PlacedCamera, seed: u64, view: usize, camera: usize) -> Self {
        let t = Stream::new(seed, Use::Light, &[view, camera]).within(std::f64::consts::PI);
        let half = Vector2::from(c.size_px.map(|n| 0.5 * n as f64));
        Self {
            amount: image.unevenness,
            direction: Vector2::new(t.cos(), t.sin()) * std::f64::consts::FRAC_1_SQRT_2,
            middle: half - Vector2::new(0.5, 0.5),
            half,
        }
    }

    pub(super) fn at(&self, q: &Vector2<f64>) -> f64 {
        let w = self.direction.dot(&(q - self.middle).component_div(&self.half));
        1.0 - self.amount * (0.5 * (1.0 + w)).powi(2)
    }
}

/// Add the glare spots of one image.
pub(super) fn add_glare(
    grey: &mut [f64],
    image: &ImageKeys,
    c: &PlacedCamera,
    view: &PlacedView,
    name: [usize; 2],
    seed: u64,
) {
    let Some(g) = &image.glare else { return };
    let mut stream = Stream::new(seed, Use::Glare, &name);
    let [width, height] = c.size_px;
    let cam_from_target = c.cam_from_bench * view.bench_from_target;
    let rims: Vec<Vector2<f64>> =
        view.pattern.features.iter().flat_map(|f| rim_px(c, &cam_from_target, f, 360)).collect();
    for _ in 0..g.count {
        let (a, b) = (stream.uniform(), stream.uniform());
        let at = match g.on {
            GlarePlace::Rim if !rims.is_empty() => rims[((a * rims.len() as f64) as usize).min(rims.len() - 1)],
            _ => Vector2::new(a * width as f64, b * height as f64),
        };
        let reach = 6.0 * g.radius_px;
        let bounds = |x: f64, n: usize| ((x - reach).max(0.0) as usize, ((x + reach).max(0.0) as usize + 1).min(n));
        let ((u0, u1), (v0, v1)) = (bounds(at.x, width), bounds(at.y, height));
        for v in v0..v1 {
            for u in u0..u1 {
                let r2 = (Vector2::new(u as f64, v as f64) - at).norm_squared();
                grey[v * width + u] += g.level * (-0.5 * r2 / (g.radius_px * g.radius_px)).exp();
            }
        }
    }
}
