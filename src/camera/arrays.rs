//! Many points through one camera: structures of arrays, several points at a time where it looks through no window.
//!
//! Every point is computed alone and the bits do not depend on the width of the processor ([`crate::lanes`]); they are those of the plain
//! path to rounding.

use super::{BulkCamera, Camera};
use crate::frames::Cam;
use crate::lanes::{Column, ColumnMut, Each, Kernel, Lanes, Twice, run, splats, sweep};
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
        let mut q = *t;
        for k in 0..3 {
            q[k] = r[k][0].fused(p[0], r[k][1].fused(p[1], r[k][2].fused(p[2], t[k])));
        }
        self.camera.image(q)
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
        self.camera.image([a[0].fused(x, f[0]), a[1].fused(x, f[1]), a[2].fused(x, f[2])])
    }
}

struct Images<'a> {
    camera: &'a Camera,
    rotation: &'a Matrix3<f64>,
    translation_mm: &'a Vector3<f64>,
    from: [Column<'a>; 3],
    to: [ColumnMut<'a>; 2],
}

impl Images<'_> {
    #[inline(always)]
    fn image<L: Lanes>(&self) -> Option<Image<L>> {
        let t = self.translation_mm;
        Some(Image { camera: BulkCamera::of(self.camera)?, r: rows(self.rotation), t: splats([t.x, t.y, t.z]) })
    }
}

impl Kernel for Images<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        match (self.image::<Twice<L>>(), self.image::<L>()) {
            (Some(pair), Some(one)) => sweep(&pair, &one, self.from, self.to),
            _ => false,
        }
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
        let length = d[0].fused(d[0], d[1].fused(d[1], d[2] * d[2])).sqrt();
        let per_length = L::splat(1.0) / length;
        [d[0] * per_length, d[1] * per_length, d[2] * per_length]
    }
}

struct Rays<'a> {
    camera: &'a Camera,
    rotation: &'a Matrix3<f64>,
    from: [Column<'a>; 2],
    to: [ColumnMut<'a>; 3],
}

impl Rays<'_> {
    #[inline(always)]
    fn ray<L: Lanes>(&self) -> Option<Ray<L>> {
        Some(Ray { camera: BulkCamera::of(self.camera)?, r: rows(self.rotation) })
    }
}

impl Kernel for Rays<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        match (self.ray::<Twice<L>>(), self.ray::<L>()) {
            (Some(pair), Some(one)) => sweep(&pair, &one, self.from, self.to),
            _ => false,
        }
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
