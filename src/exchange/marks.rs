//! A camera from marks of known position: the direct linear transformation, then the whole camera.
//!
//! `s (u, v, 1)' = P (X, Y, Z, 1)'`, twelve unknowns from the smallest singular vector of the normalised equations (Hartley and
//! Zisserman 2004, algorithm 7.1); `P = K [R t]` by an RQ decomposition; then the reprojection error over pose, f, principal
//! point, aspect, tilts and k1, k2 from there. Tilt and axis point are only as good as the distortion lets them be; the images
//! of points near the marks are good in any case.

use super::distorted::fit_scheimpflug;
use super::refit::{Center, Loss, Seen};
use crate::camera::{Camera, Intrinsics};
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet};
use crate::rigid::{Motion, orthonormalised};
use nalgebra::{DMatrix, Matrix3, Matrix3x4, Matrix4, Vector2, Vector3};

/// Fewest marks for a camera of 14 numbers with something to spare.
const LEAST: usize = 12;
/// Depth of the marks over their width below which they count as one plane.
const FLAT: f64 = 1e-3;

/// Known points and their pixels.
#[derive(Debug, Default)]
pub(super) struct Marks(Vec<Seen>);

impl Marks {
    pub(super) fn push(&mut self, xyz_mm: Vector3<f64>, pixel: Vector2<f64>) {
        self.0.push(Seen { xyz_mm, pixel });
    }
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }
}

/// Centre and mean distance from it.
fn spread<const N: usize>(
    points: impl Iterator<Item = nalgebra::SVector<f64, N>> + Clone,
) -> (nalgebra::SVector<f64, N>, f64) {
    let n = points.clone().count() as f64;
    let center = points.clone().sum::<nalgebra::SVector<f64, N>>() / n;
    (center, points.map(|p| (p - center).norm()).sum::<f64>() / n)
}

/// The camera that sees the marks, its pose, and the residual.
pub(super) fn camera_of_marks(marks: &Marks, image_size_px: [usize; 2]) -> Result<(Camera, Motion<Cam, Sheet>, Loss)> {
    let seen = &marks.0;
    if seen.len() < LEAST {
        return Err(Insufficient::Degenerate(format!("{} marks: at least {LEAST} are needed", seen.len())).into());
    }
    let p = projection_matrix(seen)?;
    let (intrinsics, pose) = decompose(&p, seen)?;
    // Tilt by the equivalence, from the axis point at the image centre.
    let center = image_size_px.map(|n| 0.5 * n as f64 - 0.5);
    let plain = Camera::new(intrinsics)?;
    let tilted = plain.effective_pinhole().with_axis_point(center[0], center[1], intrinsics.aspect);
    let start = Camera::new(tilted)?;
    let turned: Motion<Cam, Cam> = Motion::new(start.cam_from_pinhole(), Vector3::zeros());
    fit_scheimpflug(&start, &(turned * pose), seen, Center::Free)
}

fn projection_matrix(seen: &[Seen]) -> Result<Matrix3x4<f64>> {
    let (x0, xs) = spread(seen.iter().map(|s| s.xyz_mm));
    let (q0, qs) = spread(seen.iter().map(|s| s.pixel));
    if !(xs > 0.0 && qs > 0.0) {
        let what =
            "all marks lie in one point of space or of the image; export the marks with their places in mm and px";
        return Err(Insufficient::Degenerate(what.into()).into());
    }
    let mut a = DMatrix::zeros(2 * seen.len(), 12);
    for (i, s) in seen.iter().enumerate() {
        let x = ((s.xyz_mm - x0) / xs).push(1.0);
        let q = (s.pixel - q0) / qs;
        for k in 0..4 {
            (a[(2 * i, k)], a[(2 * i, 8 + k)]) = (x[k], -q.x * x[k]);
            (a[(2 * i + 1, 4 + k)], a[(2 * i + 1, 8 + k)]) = (x[k], -q.y * x[k]);
        }
    }
    let eigen = (a.transpose() * &a).symmetric_eigen();
    let mut order: Vec<usize> = (0..12).collect();
    order.sort_by(|i, j| eigen.eigenvalues[*i].total_cmp(&eigen.eigenvalues[*j]));
    let [least, next, largest] = [order[0], order[1], order[11]].map(|i| eigen.eigenvalues[i].max(0.0).sqrt());
    // The gap to the next direction falls with the depth of the marks; noise fills the least.
    if next < FLAT * largest || next < 3.0 * least {
        return Err(Insufficient::Degenerate(
            "the marks lie in one plane (or nearly): a camera needs marks at two depths at least; export the marks of a \
             two-level plate or of several plate positions"
                .into(),
        )
        .into());
    }
    let v = eigen.eigenvectors.column(order[0]);
    let normalised = Matrix3x4::from_row_iterator(v.iter().copied());
    let pixels = Matrix3::new(qs, 0.0, q0.x, 0.0, qs, q0.y, 0.0, 0.0, 1.0);
    let mut points = Matrix4::identity() / xs;
    points[(3, 3)] = 1.0;
    points.fixed_view_mut::<3, 1>(0, 3).copy_from(&(-x0 / xs));
    Ok(pixels * normalised * points)
}

/// `P = K [R t]`, the sign such that the marks lie in front.
fn decompose(p: &Matrix3x4<f64>, seen: &[Seen]) -> Result<(Intrinsics, Motion<Cam, Sheet>)> {
    let mut p = *p / p.fixed_view::<1, 3>(2, 0).norm();
    let front: f64 = seen.iter().map(|s| (p.row(2) * s.xyz_mm.push(1.0))[0]).sum();
    if front < 0.0 {
        p = -p;
    }
    let m = p.fixed_view::<3, 3>(0, 0).into_owned();
    let mirrored =
        || Insufficient::Degenerate("the marks give a mirrored camera: check the directions of their axes".to_string());
    if m.determinant() <= 0.0 {
        return Err(mirrored().into());
    }
    // K K' = M M', upper triangular K from below.
    let s = m * m.transpose();
    let (cx, cy) = (s.m13 / s.m33, s.m23 / s.m33);
    let fy = (s.m22 / s.m33 - cy * cy).max(0.0).sqrt();
    let skew = (s.m12 / s.m33 - cx * cy) / fy;
    let fx = (s.m11 / s.m33 - skew * skew - cx * cx).max(0.0).sqrt();
    let k = Matrix3::new(fx, skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0);
    let inverse = k.try_inverse().ok_or_else(mirrored)?;
    let r = orthonormalised(&(inverse * m));
    let t = inverse * p.column(3);
    let mut i = Intrinsics::pinhole(fx, cx, cy);
    i.aspect = fy / fx;
    Ok((i, Motion::new(r, t)))
}
