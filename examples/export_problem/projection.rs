//! `projection.txt`: random cameras, their OpenCV form, points with their pixels.
//!
//! ```text
//! cameras N, then each: f aspect cx cy alpha beta k1 k2 k3, fx fy cx cy, 14 coefficients, cam_from_opencv by rows,
//! n, [x y z (camera frame, mm) u v] x n
//! ```

use crate::rig_scene::Noise;
use nalgebra::Vector3;
use spivcal::camera::{Camera, Intrinsics};
use std::fmt::Write;
use std::path::Path;

const CAMERAS: usize = 40;
const POINTS: usize = 100;

/// Tilts to 30 degrees in any direction, lenses of short and long focal length.
fn camera(noise: &mut Noise) -> Camera {
    let mut within = |low: f64, high: f64| low + (high - low) * noise.uniform();
    let (tilt, direction) = (within(0.0, 30_f64.to_radians()), within(0.0, std::f64::consts::TAU));
    let mut i = Intrinsics::pinhole(within(900.0, 12_000.0), within(300.0, 1500.0), within(200.0, 1200.0));
    (i.alpha_rad, i.beta_rad) = (tilt * direction.sin(), tilt * direction.cos());
    i.aspect = within(0.95, 1.05);
    i.k = [within(-0.3, 0.3), within(-0.2, 0.2), within(-0.1, 0.1)];
    Camera::new(i).expect("a camera")
}

pub fn write(dir: &Path) {
    let mut noise = Noise::new(7);
    let mut out = format!("cameras {CAMERAS}\n");
    for _ in 0..CAMERAS {
        let camera = camera(&mut noise);
        let o = camera.to_opencv().expect("OpenCV has this model");
        let mut numbers = |all: &[f64]| {
            all.iter().for_each(|x| {
                let _ = write!(out, "{x:e} ");
            });
        };
        numbers(&camera.intrinsics().to_array()[..9]);
        numbers(&[o.fx_px, o.fy_px, o.cx_px, o.cy_px]);
        numbers(&o.distortion_coefficients());
        numbers(o.cam_from_opencv().transpose().as_slice());
        let mut points = vec![];
        while points.len() < POINTS {
            let z = 50.0 + 2000.0 * noise.uniform();
            let p = Vector3::new((noise.uniform() - 0.5) * 0.5 * z, (noise.uniform() - 0.5) * 0.4 * z, z);
            points.extend(camera.project_xyz(&p).ok().map(|q| [p.x, p.y, p.z, q.x, q.y]));
        }
        numbers(&[POINTS as f64]);
        points.iter().for_each(|p| numbers(p));
        out.push('\n');
    }
    std::fs::write(dir.join("projection.txt"), out).expect("projection.txt");
}
