//! A camera behind a flat window, and the camera without one that is nearest to it about the sheet.
//!
//! No format here holds a window. Refraction bends a bundle of rays into one that no centre of projection has, so the nearest camera of
//! the library is fitted (`refit.rs`) to where the points of the measured volume are seen through glass and water, and the loss is
//! what is left over that volume; it grows with depth beyond it. It starts where a camera looking straight through water only would be:
//! ```text
//! D' = n D,  f' = n f,  k_1' = n^2 k_1,   n = n_water / n_air      D apparent distance
//! ```
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | n | `n` | 1 | refractive index of the water against air |
//! | D | | mm | distance of the apparent origin of the sheet |
//!
//! Source: Treibitz et al., "Flat refractive geometry" (2012). Not valid where the volume is not beyond the window (refused).

use super::WorldCamera;
use super::distorted::fit_scheimpflug;
use super::refit::{DEPTH, Seen, volume};
use crate::camera::{Camera, Window};
use crate::dewarp::SheetMap;
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::{Vector2, Vector3};

/// Pixels over the whole image at three depths about the sheet, through the window.
fn seen_through(c: &WorldCamera) -> Vec<Seen> {
    let map = SheetMap::new(c.camera, c.cam_from_world, c.image_size_px);
    let depth_mm = DEPTH * c.cam_from_world.inverse().translation_mm.z.abs();
    let last = c.image_size_px.map(|n| n as f64 - 1.0);
    let mut out = Vec::with_capacity(17 * 13 * 3);
    for (i, j) in (0..17).flat_map(|i| (0..13).map(move |j| (i, j))) {
        let pixel = Vector2::new(last[0] * f64::from(i) / 16.0, last[1] * f64::from(j) / 12.0);
        for z in [-depth_mm, 0.0, depth_mm] {
            out.extend(map.hit(&pixel, z).map(|h| Seen { xyz_mm: h.xy_mm.push(z), pixel }));
        }
    }
    out
}

/// The nearest camera without the window, with what it was fitted to.
pub(super) fn without_window(c: WorldCamera, window: &Window) -> Result<WorldCamera> {
    let degenerate = || {
        Insufficient::Degenerate(format!(
            "camera \"{}\" looks through a window, and no camera without one is near to it: the measured volume does not lie beyond the window",
            c.name
        ))
    };
    let [.., n_air, _, n_water] = window.layers();
    let n = n_water / n_air;
    let mut start = *c.camera.intrinsics();
    start.f_px *= n;
    for (k, power) in start.k.iter_mut().zip([2, 4, 6]) {
        *k *= n.powi(power);
    }
    (start.pupil_ratio, start.radial) = (1.0, crate::camera::Radial::default());
    let origin = window.apparent(&c.cam_from_world.translation_mm).map_err(|_| degenerate())?;
    let pose = Motion::<Cam, Sheet>::new(c.cam_from_world.rotation, origin * n);
    let points = seen_through(&c);
    if points.len() < 100 {
        return Err(degenerate().into());
    }
    let (camera, cam_from_world, loss) = fit_scheimpflug(&Camera::new(start)?, &pose, &points)?;
    Ok(WorldCamera { camera, cam_from_world, loss, points: Some(points), ..c })
}

impl WorldCamera {
    /// The measured volume as this camera sees it; behind a window through that.
    pub(super) fn seen(&self) -> Vec<Seen> {
        self.points.clone().unwrap_or_else(|| volume(&self.camera, &self.cam_from_world, self.image_size_px))
    }

    /// Half the depth of that volume, mm.
    pub(super) fn depth_mm(&self) -> f64 {
        let of =
            |points: &Vec<Seen>| points.iter().map(|s: &Seen| Vector3::z().dot(&s.xyz_mm).abs()).fold(0.0, f64::max);
        self.points.as_ref().map_or(DEPTH * self.cam_from_world.inverse().translation_mm.z.abs(), of)
    }
}
