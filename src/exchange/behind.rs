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
use super::refit::{Center, DEPTH, PIXELS, Seen, over_image, rays};
use crate::camera::{Camera, Window};
use crate::dewarp::SheetMap;
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::Motion;
use nalgebra::Vector3;

/// Pixels over the whole image at three depths about the sheet, through the window.
fn seen_through(c: &WorldCamera) -> Vec<Seen> {
    let map = SheetMap::new(c.camera, c.cam_from_world, c.image_size_px);
    let depth_mm = DEPTH * c.cam_from_world.inverse().translation_mm.z.abs();
    let depths = [-depth_mm, 0.0, depth_mm];
    over_image(c.image_size_px, |q| depths.map(|z| map.hit(q, z).map(|h| h.xy_mm.push(z))).into_iter().flatten())
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
    let (camera, cam_from_world, loss) = fit_scheimpflug(&Camera::new(start)?, &pose, &points, Center::Free)?;
    Ok(WorldCamera { camera, cam_from_world, loss, points: Some(points), ..c })
}

impl WorldCamera {
    /// What this camera sees over the whole image: points on its rays; behind a window those of the measured volume.
    ///
    /// # Errors
    /// As [`rays`].
    pub(super) fn seen(&self) -> Result<Vec<Seen>> {
        let on_rays =
            || rays(&self.name, self.image_size_px, &self.cam_from_world, |q| self.camera.ideal_of_pixel(q).ok());
        self.points.clone().map_or_else(on_rays, Ok)
    }

    /// Whether the camera to be written is to keep this one's projection centre: not where this stands for one behind a window.
    pub(super) fn center(&self) -> Center {
        if self.points.is_some() { Center::Free } else { Center::Held }
    }

    /// Of the pixels compared, how many see that volume.
    pub(super) fn pixels_seen(&self) -> usize {
        self.points.as_ref().map_or(PIXELS, |points| points.chunk_by(|a, b| a.pixel == b.pixel).count())
    }

    /// Half the depth of that volume, mm.
    pub(super) fn depth_mm(&self) -> f64 {
        let of =
            |points: &Vec<Seen>| points.iter().map(|s: &Seen| Vector3::z().dot(&s.xyz_mm).abs()).fold(0.0, f64::max);
        self.points.as_ref().map_or(DEPTH * self.cam_from_world.inverse().translation_mm.z.abs(), of)
    }
}
