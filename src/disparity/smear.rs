//! How far the depth of the light draws correlation peaks out.
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
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | P | `particle_px2` | px^2 | dewarped, y down | mean autocorrelation peak |
//! | s_z | `sigma_z_mm` | mm | Sheet | depth of the particles that make the correlation peak |
//! | s_2 - s_1 | `depth_px` | px/mm | dewarped, y down | what depth moves the second image against the first by |
//!
//! Source: Wieneke, Meas. Sci. Technol. 29 (2018) 084002 (thick light). Not valid where v is not small against the window: [`Smear::window_px`].

use super::peak::CorrelationMap;
use super::profile::bilinear;
use nalgebra::{Matrix2, Vector2};

/// Where the ground beside a peak is taken, standard deviations across.
const BESIDE: f64 = 5.0;
/// Half the box of the background, standard deviations of a particle's autocorrelation and of depth.
const BACKGROUND: [f64; 2] = [6.0, 2.0];
/// Most of a window that one standard deviation of depth may take.
const SMALL: f64 = 0.125;
/// Windows are multiples of so many pixels.
const STEP_PX: usize = 16;

/// Width of peaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Smear {
    particle_px2: Matrix2<f64>,
    /// `NaN` where the cross-correlation is no wider than particle images.
    sigma_z_mm: f64,
    depth_px: Vector2<f64>,
}

impl Smear {
    /// From the cross-correlation and both autocorrelations of all windows together; none where they show no peaks.
    pub(super) fn of(cross: &CorrelationMap, autos: &[CorrelationMap; 2], depth_px: Vector2<f64>) -> Option<Self> {
        let along = depth_px.normalize();
        let across = Vector2::new(-along.y, along.x);
        let particle = |maps: &[CorrelationMap; 2]| -> Option<Matrix2<f64>> {
            Some(0.5 * (maps[0].own_peak()?.shape_px2 + maps[1].own_peak()?.shape_px2))
        };
        let rough = particle(autos)?;
        let beside = across * (BESIDE * across.dot(&(rough * across)).sqrt());
        let particle_px2 = particle(&autos.each_ref().map(|a| above_ground(a, beside)))?;
        let drawn = above_ground(cross, beside).wide_peak(cross.width / 4)?.shape_px2;
        let variance_px2 = along.dot(&((drawn - particle_px2) * along));
        Some(Self { particle_px2, sigma_z_mm: variance_px2.sqrt() / depth_px.norm(), depth_px })
    }

    /// Full width of the light at 1/e^2, mm; `NaN` where the cross-correlation is no wider than particle images.
    pub(super) fn thickness_mm(&self) -> f64 {
        4.0 * std::f64::consts::SQRT_2 * self.sigma_z_mm
    }

    /// Length of v, px.
    fn drawn_px(&self) -> f64 {
        if self.sigma_z_mm.is_finite() { self.depth_px.norm() * self.sigma_z_mm } else { 0.0 }
    }

    /// Half the box of a background that takes nothing of a peak with it, px.
    pub(super) fn background_px(&self) -> usize {
        let particle = self.particle_px2.symmetric_eigenvalues().max().max(0.0).sqrt();
        (BACKGROUND[0] * particle).max(BACKGROUND[1] * self.drawn_px()).ceil() as usize
    }

    /// Side of a window against which depth is small, px.
    pub(super) fn window_px(&self) -> usize {
        (self.drawn_px() / SMALL / STEP_PX as f64).ceil() as usize * STEP_PX
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

#[cfg(test)]
mod tests {
    use super::super::profile::tests::summed;
    use super::*;

    #[test]
    fn thickness_is_found_whatever_part_of_the_window_it_takes_up() {
        for slope in [Vector2::new(0.9, 0.0), Vector2::new(0.1, 0.9), Vector2::new(-0.7, -0.5)] {
            for (sigma_mm, mm_per_px) in [(0.2, 0.1), (0.2, 0.05), (0.2, 0.03), (0.4, 0.05)] {
                let depth_px = slope / mm_per_px;
                let [mut cross, auto] = summed(|z| (-0.5 * (z / sigma_mm).powi(2)).exp(), depth_px);
                // What a local mean has taken off: broad, and lower than the peak.
                let top = cross.values.iter().fold(0.0_f64, |m, c| m.max(*c));
                for (i, c) in cross.values.iter_mut().enumerate() {
                    let p = Vector2::new((i % 64) as f64 - 32.0, (i / 64) as f64 - 32.0);
                    *c -= 0.2 * top * (-0.5 * p.norm_squared() / 400.0).exp();
                }
                let other = CorrelationMap { values: auto.values.clone(), ..auto };
                let s = Smear::of(&cross, &[auto, other], depth_px).unwrap();
                // The squared profile's sigma is what the smear is.
                assert!((s.thickness_mm() / (4.0 * sigma_mm * std::f64::consts::SQRT_2) - 1.0).abs() < 0.05, "{s:?}");
                assert_eq!(s.window_px() > 64, sigma_mm * depth_px.norm() > 8.0, "{s:?}");
                assert!(s.background_px() as f64 >= 2.0 * s.drawn_px() && s.background_px() >= 8);
            }
        }
    }
}
