//! Rendered particles in a sheet that two cameras see.

#![allow(dead_code, unreachable_pub, clippy::unwrap_used)]

use nalgebra::Vector3;
use spivcal::disparity::ParticlePair;
use spivcal::frames::{Rig, Sheet};
use spivcal::image::GrayImage;
use spivcal::record::Record;
use spivcal::simulate::Scene;

/// Two cameras, particles, and a sheet in its place.
pub fn scene(seed: u64, offset_mm: f64, tilt_deg: [f64; 2], thickness_mm: f64, pairs: usize) -> Scene {
    seeded(seed, offset_mm, tilt_deg, thickness_mm, pairs, 1.5)
}

pub fn seeded(seed: u64, offset_mm: f64, tilt_deg: [f64; 2], thickness_mm: f64, pairs: usize, per_mm2: f64) -> Scene {
    let angles_deg = [-42.0, 35.0];
    Sharpness { pitch_mm: 0.0125, size_px: [640, 512], blur_px: 0.9, angles_deg }.scene(
        seed,
        offset_mm,
        tilt_deg,
        thickness_mm,
        pairs,
        per_mm2,
    )
}

/// How finely both cameras see the sheet, and from where.
pub struct Sharpness {
    pub pitch_mm: f64,
    pub size_px: [usize; 2],
    pub blur_px: f64,
    pub angles_deg: [f64; 2],
}

impl Sharpness {
    /// 90 degrees between the cameras, px of 0.0556 mm over `by`, the same field and the same particles whatever `by`.
    pub fn oblique(by: usize) -> Self {
        let [n, m] = [640, 512].map(|n| n * by);
        Self { pitch_mm: 0.00618 / by as f64, size_px: [n, m], blur_px: 0.9 * by as f64, angles_deg: [-45.0, 45.0] }
    }

    pub fn scene(
        &self,
        seed: u64,
        offset_mm: f64,
        tilt_deg: [f64; 2],
        thickness_mm: f64,
        pairs: usize,
        per_mm2: f64,
    ) -> Scene {
        let camera = |name: &str, angle: f64| {
            format!(
                "[[camera]]\nname = \"{name}\"\nimage_size_px = {:?}\npixel_pitch_mm = {:?}\nfocal_length_mm = 50.0\nscheimpflug = true\n\
                 k = [-0.05, 0.0, 0.0]\naim = {{ distance_mm = 500.0, viewing_angle_deg = {angle:?} }}\n",
                self.size_px, self.pitch_mm
            )
        };
        let [left, right] = self.angles_deg;
        let text = format!(
            "seed = {seed}\n{}{}[sheet]\noffset_mm = {offset_mm:?}\ntilt_deg = {tilt_deg:?}\n[target]\nkind = \"two-discs\"\npolarity = \"bright\"\n\
             radii_mm = [8.0, 6.0]\nspacing_mm = 18.0\n[image]\nbits = 12\nblur_sigma_px = {:?}\nfull_well_e = 20000.0\nread_noise_e = 20.0\n\
             [[view]]\n[particles]\npairs = {pairs}\nper_mm2 = {per_mm2:?}\nthickness_mm = {thickness_mm:?}\n",
            camera("left", left),
            camera("right", right),
            self.blur_px
        );
        Scene::parse(&text, "scene.toml").unwrap()
    }
}

pub fn truth(scene: &Scene) -> Record {
    Record::from_json(&scene.truth_json().unwrap(), "truth.json").unwrap()
}

pub fn pairs(images: &[(String, GrayImage)]) -> Vec<ParticlePair<'_>> {
    images
        .chunks_exact(2)
        .map(|p| ParticlePair { images: [p[0].1.view(), p[1].1.view()], names: [p[0].0.clone(), p[1].0.clone()] })
        .collect()
}

/// Where the true sheet lies in the frame of the one that was started from: `z = a + b x + c y`.
pub fn plane(start: &Record, now: &Record) -> Vector3<f64> {
    let pose = |r: &Record| r.sheet.as_ref().unwrap().rig_from_sheet.motion::<Rig, Sheet>();
    let m = pose(start).inverse() * pose(now);
    let n = m.rotation.column(2);
    let (b, c) = (-n.x / n.z, -n.y / n.z);
    Vector3::new(m.translation_mm.z - b * m.translation_mm.x - c * m.translation_mm.y, b, c)
}
