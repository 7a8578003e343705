//! How wide correlation peaks are: by the images of particles, and by the depth of the light.
//!
//! Particles at depth z appear apart by `-z (s_2 - s_1)`, so that the cross-correlation of all windows together is that of particle images
//! drawn out along the direction of depth:
//! ```text
//! C_12 = P + v v^T,   P = (C_11 + C_22) / 2,   v = s_z (s_2 - s_1)              covariances of the peaks, px^2
//! C'(d) = C(d) - (C(d + t n) + C(d - t n)) / 2,   n across v,   t = 5 sigmas of P along n
//! ```
//! C' is taken of all three: what the local mean and that of the window took off the images lies under a peak, wider than it across v, and
//! would make it look too narrow along v.
//!
//! The peak of *one* window is a few of its particles at their own depths: lumps along v. Their mean depth is asked for, so maps of windows are
//! folded with a Gaussian of covariance `v v^T`, which is the filter matched to that peak; it is then P + 2 v v^T wide.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | P | `particle_px2` | px^2 | dewarped, y down | mean autocorrelation peak |
//! | s_z | `sigma_z_mm` | mm | Sheet | depth of the particles that make the correlation peak |
//! | v | `drawn_px` | px | dewarped, y down | what depth draws it out by |
//!
//! Source: Wieneke, Meas. Sci. Technol. 29 (2018) 084002 (thick light). Not valid where v is not small against the window: [`Smear::too_long`].

use super::correlate::{Correlator, Sums};
use super::peak::CorrelationMap;
use super::profile::bilinear;
use nalgebra::{Matrix2, Vector2};

/// Where the ground beside a peak is taken, standard deviations across.
const BESIDE: f64 = 5.0;
/// Half the box of the background, standard deviations of a particle's autocorrelation and of depth.
const BACKGROUND: [f64; 2] = [6.0, 2.0];
/// The Gaussian is cut off here, standard deviations.
const CUT: f64 = 2.5;
/// Depth that draws peaks out by less than so many standard deviations of a particle's autocorrelation does not break them into lumps: their tops are
/// found as they are, for the middle of what hangs together with a top depends on how uneven the light is.
const APART: f64 = 2.5;
/// Most of a window that one standard deviation of depth may take.
const SMALL: f64 = 0.125;

/// Width of peaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Smear {
    pub(super) particle_px2: Matrix2<f64>,
    /// `NaN` where the cross-correlation is no wider than particle images.
    pub(super) sigma_z_mm: f64,
}

/// Depth in the image: (s_2 - s_1) over the size of a pixel, its rows running down, px per mm.
pub(super) fn depth_px(slope_apart: Vector2<f64>, mm_per_px: f64) -> Vector2<f64> {
    Vector2::new(slope_apart.x, -slope_apart.y) / mm_per_px
}

impl Smear {
    /// From sums over all windows; none where they show no peaks.
    pub(super) fn of(sums: &Sums, window_px: usize, depth_px: Vector2<f64>) -> Option<Self> {
        let correlator = Correlator::new(window_px);
        let along = depth_px.normalize();
        let across = Vector2::new(-along.y, along.x);
        let map = |values: &[f64]| correlator.map(values.to_vec());
        let autos = sums.auto.each_ref().map(|a| map(a));
        let particle = |maps: &[CorrelationMap; 2]| -> Option<Matrix2<f64>> {
            Some(0.5 * (maps[0].own_peak()?.shape_px2 + maps[1].own_peak()?.shape_px2))
        };
        let rough = particle(&autos)?;
        let beside = across * (BESIDE * across.dot(&(rough * across)).sqrt());
        let particle_px2 = particle(&autos.each_ref().map(|a| above_ground(a, beside)))?;
        let cross = above_ground(&map(&sums.cross), beside).peak(window_px / 4, None)?.shape_px2;
        let variance_px2 = along.dot(&((cross - particle_px2) * along));
        Some(Self { particle_px2, sigma_z_mm: variance_px2.sqrt() / depth_px.norm() })
    }

    /// Full width of the light at 1/e^2, mm.
    pub(super) fn thickness_mm(&self) -> f64 {
        4.0 * std::f64::consts::SQRT_2 * self.sigma_z_mm
    }

    /// v, px.
    pub(super) fn drawn_px(&self, depth_px: Vector2<f64>) -> Vector2<f64> {
        if self.sigma_z_mm.is_finite() { depth_px * self.sigma_z_mm } else { Vector2::zeros() }
    }

    /// Half the box of a background that takes nothing of a peak with it, px.
    pub(super) fn background_px(&self, depth_px: Vector2<f64>) -> usize {
        let particle = self.particle_px2.symmetric_eigenvalues().max().max(0.0).sqrt();
        (BACKGROUND[0] * particle).max(BACKGROUND[1] * self.drawn_px(depth_px).norm()).ceil() as usize
    }

    /// Side of a window against which depth is small, where this one is not, px.
    pub(super) fn too_long(&self, depth_px: Vector2<f64>, window_px: usize) -> Option<usize> {
        let long = self.drawn_px(depth_px).norm();
        (long > SMALL * window_px as f64).then(|| ((long / SMALL / 16.0).ceil() as usize * 16).min(512))
    }

    /// A map of one window, its particles gathered along the depth, and the covariance of its peak; a peak as expected keeps its height.
    pub(super) fn gathered(&self, map: CorrelationMap, depth_px: Vector2<f64>) -> (CorrelationMap, Matrix2<f64>) {
        let v = self.drawn_px(depth_px);
        let along = v.dot(&(self.particle_px2 * v)) / v.norm_squared();
        if !(v.norm_squared() > APART * APART * along) {
            return (map, self.particle_px2);
        }
        let shape = self.particle_px2 + 2.0 * v * v.transpose();
        let before = along + v.norm_squared();
        let gain = (1.0 + v.norm_squared() / before).sqrt();
        (folded(&map, v, gain), shape)
    }
}

/// Less the mean of what lies on both sides.
fn above_ground(map: &CorrelationMap, beside: Vector2<f64>) -> CorrelationMap {
    let ground = |d: Vector2<f64>| {
        let [a, b] = [d + beside, d - beside].map(|d| bilinear(map, d));
        a.zip(b).map(|(a, b)| 0.5 * (a + b)).or(a).or(b).unwrap_or(0.0)
    };
    let one = |(x, y): (isize, isize)| map.at(x, y).unwrap_or(0.0) - ground(Vector2::new(x as f64, y as f64));
    CorrelationMap { width: map.width, height: map.height, values: map.shifts().map(one).collect() }
}

/// A map folded with a Gaussian of covariance `v v^T` and area `gain`: whole steps along the longer axis, linear between rows or columns.
fn folded(map: &CorrelationMap, v: Vector2<f64>, gain: f64) -> CorrelationMap {
    let lying = v.x.abs() >= v.y.abs();
    let (sigma, rise) = if lying { (v.x.abs(), v.y / v.x) } else { (v.y.abs(), v.x / v.y) };
    let reach = (CUT * sigma).ceil().min(map.width.max(map.height) as f64) as isize;
    let weight = |t: isize| (-0.5 * (t as f64 / sigma).powi(2)).exp();
    let area: f64 = (-reach..=reach).map(weight).sum();
    let mut out = vec![0.0; map.values.len()];
    for t in -reach..=reach {
        let (w, aside) = (gain * weight(t) / area, t as f64 * rise);
        let low = aside.floor();
        for (k, part) in [(low, 1.0 - (aside - low)), (low + 1.0, aside - low)] {
            let (dx, dy) = if lying { (t, k as isize) } else { (k as isize, t) };
            add_shifted(&mut out, map, [dx, dy], w * part);
        }
    }
    CorrelationMap { width: map.width, height: map.height, values: out }
}

/// Adds `weight` times the map moved by whole pixels; what leaves it is lost.
fn add_shifted(out: &mut [f64], map: &CorrelationMap, [dx, dy]: [isize; 2], weight: f64) {
    let (w, h) = (map.width as isize, map.height as isize);
    let (from, to) = (dx.max(0), w + dx.min(0));
    if weight == 0.0 || from >= to {
        return;
    }
    for y in dy.max(0)..h + dy.min(0) {
        let place = |x: isize, y: isize| (y * w + x) as usize;
        let source = &map.values[place(from - dx, y - dy)..][..(to - from) as usize];
        let target = &mut out[place(from, y)..][..(to - from) as usize];
        target.iter_mut().zip(source).for_each(|(t, s)| *t += weight * s);
    }
}

#[cfg(test)]
mod tests {
    use super::super::profile::tests::summed;
    use super::*;

    #[test]
    fn thickness_is_found_whatever_part_of_the_window_it_takes_up() {
        for slope in [Vector2::new(0.9, 0.0), Vector2::new(0.1, -0.9), Vector2::new(-0.7, 0.5)] {
            for (sigma_mm, mm_per_px) in [(0.2, 0.1), (0.2, 0.05), (0.2, 0.03), (0.4, 0.05)] {
                let mut sums = summed(|z| (-0.5 * (z / sigma_mm).powi(2)).exp(), slope, mm_per_px);
                // What a local mean has taken off: broad, and lower than the peak.
                let top = sums.cross.iter().fold(0.0_f64, |m, c| m.max(*c));
                for (i, c) in sums.cross.iter_mut().enumerate() {
                    let p = Vector2::new((i % 64) as f64 - 32.0, (i / 64) as f64 - 32.0);
                    *c -= 0.2 * top * (-0.5 * p.norm_squared() / 400.0).exp();
                }
                let depth = depth_px(slope, mm_per_px);
                let s = Smear::of(&sums, 64, depth).unwrap();
                // The squared profile's sigma is what the smear is.
                assert!((s.sigma_z_mm / sigma_mm - 1.0).abs() < 0.05, "{slope:?} {sigma_mm} {mm_per_px}: {s:?}");
                assert!((s.thickness_mm() / (4.0 * sigma_mm * std::f64::consts::SQRT_2) - 1.0).abs() < 0.05);
                assert_eq!(s.too_long(depth, 64).is_some(), sigma_mm * slope.norm() / mm_per_px > 8.0);
            }
        }
    }

    #[test]
    fn particles_are_gathered_to_their_mean_depth() {
        let s = Smear { particle_px2: Matrix2::identity() * 2.0, sigma_z_mm: 0.2 };
        for depth in [Vector2::new(40.0, 0.0), Vector2::new(-8.0, 30.0), Vector2::new(25.0, 20.0)] {
            let hill = |places: &[f64], wide: Matrix2<f64>| {
                let h = wide.try_inverse().unwrap();
                let mut map = CorrelationMap { width: 96, height: 96, values: vec![] };
                let one = |(x, y): (isize, isize)| -> f64 {
                    let d = |p: &f64| Vector2::new(x as f64, y as f64) - depth * *p;
                    places.iter().map(|p| (-0.5 * d(p).dot(&(h * d(p)))).exp()).sum()
                };
                map.values = map.shifts().map(one).collect();
                map
            };
            // Lumps of four particles.
            let depths = [-0.17, -0.08, 0.02, 0.15];
            let (map, shape) = s.gathered(hill(&depths, s.particle_px2), depth);
            let p = map.peak(20, Some(&shape)).unwrap();
            let off = p.shift_px - depth * (depths.iter().sum::<f64>() / 4.0);
            assert!(off.norm() < 0.3, "{depth:?} {off:?}");
            // A peak as expected keeps its height and becomes as wide as is told.
            let v = s.drawn_px(depth);
            let (map, shape) = s.gathered(hill(&[0.0], s.particle_px2 + v * v.transpose()), depth);
            let p = map.peak(20, Some(&shape)).unwrap();
            assert!((p.height - 1.0).abs() < 0.05 && p.shift_px.norm() < 0.01, "{p:?}");
            assert!((p.shape_px2 - shape).norm() < 0.1 * shape.norm(), "{p:?} {shape:?}");
        }
    }
}
