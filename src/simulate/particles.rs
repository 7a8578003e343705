//! Particle images in the light sheet: the same particles in both cameras at the same moment.
//!
//! ```text
//! light   g(z) = exp(-8 z^2 / T^2)                         T full width at 1/e^2
//! image   I(q) = sum_k b_k g(z_k) Gaussian(q - q_k)        integrated over the pixel by 3 x 3 Gauss points
//! flow    d(p) = shift + vortex (r / R) exp((1 - r^2 / R^2) / 2) e_theta + jet exp(-r^2 / 2 R^2) e_z
//! ```
//! r and e_theta about the centre of the vortex, which turns counter-clockwise for the viewer whom z faces; `vortex` is the largest
//! displacement around it, at r = R. With a flow there are two exposures, at p - d(p) / 2 and p + d(p) / 2. The light lies
//! where `[particles]` says, off the sheet in which the targets stood, and the flow is given in its frame.
//!
//! Particles are uniform in space, x and y over what any camera sees and z over +- 0.9 T; b_k is uniform from 0.4 to 1 times the
//! level. Density counts the particles within the width T.

use super::random::{Stream, Use};
use super::scene::{FlowKeys, ImageKeys, ParticleKeys};
use super::setup::{Bench, PlacedCamera};
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::{Vector2, Vector3};

/// Half of the depth in which there are particles, over the sheet's full width.
const DEPTH: f64 = 0.9;
/// Most particles of a moment.
const MOST: f64 = 2e7;
/// Gauss points and weights of a pixel.
const GAUSS: [(f64, f64); 3] =
    [(-0.387_298_334_620_741_7, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.387_298_334_620_741_7, 5.0 / 18.0)];

/// One exposure: places in the frame of the light, mm, and brightness.
pub(super) struct Particles {
    points_mm: Vec<Vector3<f64>>,
    /// In the middle of the light.
    brightness: Vec<f64>,
    thickness_mm: f64,
}

/// Displacement of a particle between the two exposures, mm, when it is at p half way.
fn displacement_mm(flow: &FlowKeys, p: &Vector3<f64>) -> Vector3<f64> {
    let (x, y) = (p.x - flow.center_mm[0], p.y - flow.center_mm[1]);
    let r2 = (x * x + y * y) / (flow.radius_mm * flow.radius_mm);
    let around = flow.vortex_mm / flow.radius_mm * (0.5 * (1.0 - r2)).exp();
    let turn = Vector3::new(-around * y, around * x, flow.jet_mm * (-0.5 * r2).exp());
    Vector3::from(flow.shift_mm) + turn
}

/// `[x_min, y_min, x_max, y_max]` in the light of what the cameras see of it, mm.
fn field_mm(cameras: &[PlacedCamera], bench_from_light: &Motion<Bench, Sheet>) -> [f64; 4] {
    let mut out = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for c in cameras {
        let cam_from_light: Motion<Cam, Sheet> = c.cam_from_bench * *bench_from_light;
        let r = &cam_from_light.rotation;
        let eye = cam_from_light.inverse().translation_mm;
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
        bench_from_light: &Motion<Bench, Sheet>,
        seed: u64,
        moment: usize,
    ) -> Result<Self> {
        let mut stream = Stream::new(seed, Use::Particles, &[moment]);
        let [x0, y0, x1, y1] = field_mm(cameras, bench_from_light);
        let area = (x1 - x0).max(0.0) * (y1 - y0).max(0.0);
        let expected = keys.per_mm2 * area * 2.0 * DEPTH;
        // A camera that looks along the light sees it to the horizon.
        if !(expected <= MOST) {
            let what = format!(
                "at most {MOST:.0} in the {area:.3e} mm^2 of the light that the cameras see; look at it less slantingly, or take fewer per_mm2"
            );
            return Err(Invalid::value("particles of a moment", expected, what).into());
        }
        let count = stream.poisson(expected) as usize;
        let mut out = Self {
            points_mm: Vec::with_capacity(count),
            brightness: Vec::with_capacity(count),
            thickness_mm: keys.thickness_mm,
        };
        for _ in 0..count {
            let p =
                Vector3::new(stream.between(x0, x1), stream.between(y0, y1), stream.within(DEPTH * keys.thickness_mm));
            out.points_mm.push(p);
            out.brightness.push(keys.level * stream.between(0.4, 1.0));
        }
        Ok(out)
    }

    /// The same particles after a part of the way that the flow carries them, -1/2 for the first exposure.
    pub(super) fn carried(&self, flow: &FlowKeys, part: f64) -> Self {
        let points_mm = self.points_mm.iter().map(|p| p + displacement_mm(flow, p) * part).collect();
        Self { points_mm, brightness: self.brightness.clone(), thickness_mm: self.thickness_mm }
    }

    /// Grey of one camera's image, parts of full scale.
    pub(super) fn image(
        &self,
        c: &PlacedCamera,
        bench_from_light: &Motion<Bench, Sheet>,
        image: &ImageKeys,
    ) -> Vec<f64> {
        let [width, height] = c.size_px;
        let cam_from_light: Motion<Cam, Sheet> = c.cam_from_bench * *bench_from_light;
        let sigma = image.blur_sigma_px.max(0.3);
        let reach = (5.0 * sigma).ceil();
        let mut grey = vec![0.0; width * height];
        let weight = |x: f64| GAUSS.iter().map(|(g, w)| w * (-0.5 * ((x + g) / sigma).powi(2)).exp()).sum::<f64>();
        for (p, b) in self.points_mm.iter().zip(&self.brightness) {
            let Ok(q) = c.camera.project_xyz(&cam_from_light.apply(p)) else { continue };
            let t = p.z / self.thickness_mm;
            let b = b * (-8.0 * t * t).exp();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_flow_is_what_its_keys_say() {
        let flow =
            FlowKeys { shift_mm: [0.1, -0.2, 0.3], vortex_mm: 0.5, jet_mm: 0.4, radius_mm: 6.0, center_mm: [2.0, 1.0] };
        let shift = Vector3::from(flow.shift_mm);
        let at = |x: f64, y: f64| displacement_mm(&flow, &Vector3::new(x, y, 0.1)) - shift;
        assert!((at(2.0, 1.0) - Vector3::new(0.0, 0.0, 0.4)).norm() < 1e-15);
        // On the radius: largest around, counter-clockwise; the jet at one standard deviation.
        assert!((at(8.0, 1.0) - Vector3::new(0.0, 0.5, 0.4 * (-0.5_f64).exp())).norm() < 1e-15);
        assert!((at(2.0, 7.0) - Vector3::new(-0.5, 0.0, 0.4 * (-0.5_f64).exp())).norm() < 1e-15);
        assert!(at(7.9, 1.0).y < 0.5 && at(8.1, 1.0).y < 0.5);
    }
}
