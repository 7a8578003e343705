//! Particle images in the light sheet: the same particles in both cameras at the same moment.
//!
//! ```text
//! light   g(z) = exp(-8 z^2 / T^2)                         T full width at 1/e^2
//! image   I(q) = sum_k b_k g(z_k) Gaussian(q - q_k)        integrated over the pixel by 3 x 3 Gauss points
//! ```
//! Particles are uniform in space, x and y over what any camera sees and z over +- 0.9 T; b_k is uniform from 0.4 to 1 times the
//! level. Density counts the particles within the width T.

use super::random::{Stream, Use};
use super::scene::{ImageKeys, ParticleKeys};
use super::setup::{Bench, PlacedCamera};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::{Vector2, Vector3};

/// Half of the depth in which there are particles, over the sheet's full width.
const DEPTH: f64 = 0.9;
/// Gauss points and weights of a pixel.
const GAUSS: [(f64, f64); 3] =
    [(-0.387_298_334_620_741_7, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.387_298_334_620_741_7, 5.0 / 18.0)];

/// One moment: places in the sheet frame, mm, and brightness.
pub(super) struct Particles {
    points_mm: Vec<Vector3<f64>>,
    brightness: Vec<f64>,
}

/// `[x_min, y_min, x_max, y_max]` in the sheet of what the cameras see of it, mm.
fn field_mm(cameras: &[PlacedCamera], bench_from_sheet: &Motion<Bench, Sheet>) -> [f64; 4] {
    let mut out = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for c in cameras {
        let cam_from_sheet: Motion<Cam, Sheet> = c.cam_from_bench * *bench_from_sheet;
        let r = &cam_from_sheet.rotation;
        let eye = cam_from_sheet.inverse().translation_mm;
        let [w, h] = c.size_px.map(|n| n as f64);
        for i in 0..=16 {
            let t = f64::from(i) / 16.0;
            for q in [[t * w, 0.0], [t * w, h], [0.0, t * h], [w, t * h]] {
                let Ok(xy) = c.camera.ideal_of_pixel(&Vector2::new(q[0] - 0.5, q[1] - 0.5)) else { continue };
                let ray = r.tr_mul(&xy.push(1.0));
                let depth = -eye.z / ray.z;
                if depth > 0.0 && depth.is_finite() {
                    let p = eye + ray * depth;
                    out = [out[0].min(p.x), out[1].min(p.y), out[2].max(p.x), out[3].max(p.y)];
                }
            }
        }
    }
    out
}

impl Particles {
    /// The particles of a moment.
    pub(super) fn new(
        keys: &ParticleKeys,
        cameras: &[PlacedCamera],
        bench_from_sheet: &Motion<Bench, Sheet>,
        seed: u64,
        moment: usize,
    ) -> Self {
        let mut stream = Stream::new(seed, Use::Particles, &[moment]);
        let [x0, y0, x1, y1] = field_mm(cameras, bench_from_sheet);
        let area = (x1 - x0).max(0.0) * (y1 - y0).max(0.0);
        let count = stream.poisson(keys.per_mm2 * area * 2.0 * DEPTH) as usize;
        let mut out = Self { points_mm: Vec::with_capacity(count), brightness: Vec::with_capacity(count) };
        for _ in 0..count {
            let p =
                Vector3::new(stream.between(x0, x1), stream.between(y0, y1), stream.within(DEPTH * keys.thickness_mm));
            let t = p.z / keys.thickness_mm;
            out.points_mm.push(p);
            out.brightness.push(keys.level * stream.between(0.4, 1.0) * (-8.0 * t * t).exp());
        }
        out
    }

    /// Grey of one camera's image, parts of full scale.
    pub(super) fn image(
        &self,
        c: &PlacedCamera,
        bench_from_sheet: &Motion<Bench, Sheet>,
        image: &ImageKeys,
    ) -> Vec<f64> {
        let [width, height] = c.size_px;
        let cam_from_sheet: Motion<Cam, Sheet> = c.cam_from_bench * *bench_from_sheet;
        let sigma = image.blur_sigma_px.max(0.3);
        let reach = (5.0 * sigma).ceil();
        let mut grey = vec![0.0; width * height];
        let weight = |x: f64| GAUSS.iter().map(|(g, w)| w * (-0.5 * ((x + g) / sigma).powi(2)).exp()).sum::<f64>();
        for (p, b) in self.points_mm.iter().zip(&self.brightness) {
            let Ok(q) = c.camera.project_xyz(&cam_from_sheet.apply(p)) else { continue };
            let range = |x: f64, n: usize| (x - reach).max(0.0) as usize..((x + reach + 1.0).max(0.0) as usize).min(n);
            if range(q.x, width).is_empty() {
                continue;
            }
            let across: Vec<f64> = range(q.x, width).map(|u| weight(u as f64 - q.x)).collect();
            for v in range(q.y, height) {
                let down = b * weight(v as f64 - q.y);
                let start = v * width + range(q.x, width).start;
                for (g, a) in grey[start..].iter_mut().zip(&across) {
                    *g += down * a;
                }
            }
        }
        grey
    }
}
