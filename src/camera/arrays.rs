//! Many points through one camera: structures of arrays, several points at a time where it looks through no window.
//!
//! Every point is computed alone and the bits do not depend on the width of the processor ([`crate::lanes`]); they are those of the plain
//! path to rounding.

use super::{BulkCamera, Camera};
use crate::frames::Cam;
use crate::lanes::{Column, ColumnMut, Each, Kernel, Lanes, run, splats, sweep};
use crate::rigid::Motion;
use nalgebra::{Matrix3, Vector2, Vector3};

/// A rotation matrix in every lane, row by row.
#[inline(always)]
pub(crate) fn rows<L: Lanes>(m: &Matrix3<f64>) -> [[L; 3]; 3] {
    [splats([m.m11, m.m12, m.m13]), splats([m.m21, m.m22, m.m23]), splats([m.m31, m.m32, m.m33])]
}

/// Images of points of another frame.
struct Image<L> {
    camera: BulkCamera<L>,
    r: [[L; 3]; 3],
    t: [L; 3],
}

impl<L: Lanes> Each<L, 3, 2> for Image<L> {
    #[inline(always)]
    fn of(&self, p: [L; 3]) -> [L; 2] {
        let (r, t) = (&self.r, &self.t);
        let x = r[0][0] * p[0] + r[0][1] * p[1] + r[0][2] * p[2] + t[0];
        let y = r[1][0] * p[0] + r[1][1] * p[1] + r[1][2] * p[2] + t[1];
        let z = r[2][0] * p[0] + r[2][1] * p[1] + r[2][2] * p[2] + t[2];
        self.camera.image([x, y, z])
    }
}

/// Images of points of another frame on a line along its x axis.
pub(crate) struct LineImage<L> {
    camera: BulkCamera<L>,
    along: [L; 3],
    /// The point with x = 0 in the camera frame.
    foot: [L; 3],
}

impl<L: Lanes> LineImage<L> {
    /// Of the line with these y and z, mm.
    #[inline(always)]
    pub(crate) fn new<F>(camera: BulkCamera<L>, cam_from_points: &Motion<Cam, F>, y_mm: f64, z_mm: f64) -> Self {
        let (r, t) = (&cam_from_points.rotation, &cam_from_points.translation_mm);
        let foot =
            [r.m12 * y_mm + r.m13 * z_mm + t.x, r.m22 * y_mm + r.m23 * z_mm + t.y, r.m32 * y_mm + r.m33 * z_mm + t.z];
        Self { camera, along: splats([r.m11, r.m21, r.m31]), foot: splats(foot) }
    }

    /// Image (u, v), px, of the point with this x, mm; `NaN` where it has none.
    #[inline(always)]
    pub(crate) fn at(&self, x: L) -> [L; 2] {
        let (a, f) = (&self.along, &self.foot);
        self.camera.image([f[0] + a[0] * x, f[1] + a[1] * x, f[2] + a[2] * x])
    }
}

struct Images<'a> {
    camera: &'a Camera,
    rotation: &'a Matrix3<f64>,
    translation_mm: &'a Vector3<f64>,
    from: [Column<'a>; 3],
    to: [ColumnMut<'a>; 2],
}

impl Kernel for Images<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let Some(camera) = BulkCamera::<L>::of(self.camera) else { return false };
        let t = self.translation_mm;
        sweep(&Image { camera, r: rows(self.rotation), t: splats([t.x, t.y, t.z]) }, self.from, self.to)
    }
}

/// Unit directions of rays in another frame, in the air.
struct Ray<L> {
    camera: BulkCamera<L>,
    r: [[L; 3]; 3],
}

impl<L: Lanes> Each<L, 2, 3> for Ray<L> {
    #[inline(always)]
    fn of(&self, q: [L; 2]) -> [L; 3] {
        let d = self.camera.ray(&self.r, q);
        let per_length = L::splat(1.0) / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        [d[0] * per_length, d[1] * per_length, d[2] * per_length]
    }
}

struct Rays<'a> {
    camera: &'a Camera,
    rotation: &'a Matrix3<f64>,
    from: [Column<'a>; 2],
    to: [ColumnMut<'a>; 3],
}

impl Kernel for Rays<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let Some(camera) = BulkCamera::<L>::of(self.camera) else { return false };
        sweep(&Ray { camera, r: rows(self.rotation) }, self.from, self.to)
    }
}

impl Camera {
    /// Images (u, v), px, of points (x, y, z) of another frame, mm, columns of one length; `NaN` where a point has none. Whether every
    /// point has one; `false` is also said where that was not looked at.
    pub(crate) fn images_into<F>(
        &self,
        cam_from_points: &Motion<Cam, F>,
        from: [Column; 3],
        to: [ColumnMut; 2],
    ) -> bool {
        let Motion { rotation, translation_mm, .. } = cam_from_points;
        if self.window.is_none() {
            return run(Images { camera: self, rotation, translation_mm, from, to });
        }
        let [mut u, mut v] = to;
        for i in 0..from[0].len() {
            let p = cam_from_points.apply(&Vector3::new(from[0].get(i), from[1].get(i), from[2].get(i)));
            let q = self.project_xyz(&p).unwrap_or(Vector2::repeat(f64::NAN));
            u.set(i, q.x);
            v.set(i, q.y);
        }
        false
    }

    /// Unit directions (x, y, z) in another frame of the rays of pixels (u, v), px, in the air before any window, columns of one length;
    /// `NaN` where no ray reaches a pixel. What is returned: as for [`Camera::images_into`].
    pub(crate) fn rays_into(&self, other_from_cam: &Matrix3<f64>, from: [Column; 2], to: [ColumnMut; 3]) -> bool {
        // What a window does begins behind the air.
        let camera = &self.with_window(None);
        run(Rays { camera, rotation: other_from_cam, from, to })
    }
}
