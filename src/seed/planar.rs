//! One view of a plane: its homography or its two circles, its circular point, its pose.

use super::pinhole::CircularPoint;
use crate::camera::EffectivePinhole;
use crate::conic::Ellipse;
use crate::frames::{Cam, Target};
use crate::rigid::{Motion, orthonormalised};
use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};

/// Homography `image ~ H plane` of point pairs (plane in mm or pitches, image in px), by normalised DLT; `None` for fewer than
/// four points or collinear ones.
pub fn homography(plane: &[Vector2<f64>], image: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    if plane.len() < 4 || plane.len() != image.len() {
        return None;
    }
    let (tp, ti) = (normaliser(plane)?, normaliser(image)?);
    let mut a = DMatrix::zeros(9, 9);
    for (p, q) in plane.iter().zip(image) {
        let p = tp * p.push(1.0);
        let q = ti * q.push(1.0);
        for (s, t) in [(0, q.x), (1, q.y)] {
            let mut row = nalgebra::SVector::<f64, 9>::zeros();
            row.fixed_rows_mut::<3>(3 * s).copy_from(&p);
            row.fixed_rows_mut::<3>(6).copy_from(&(-p * t));
            a += row * row.transpose();
        }
    }
    let eigen = a.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    // Collinear points leave a second null vector.
    if eigen.eigenvalues[order[1]] < 1e-9 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = eigen.eigenvectors.column(order[0]);
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    Some(ti.try_inverse()? * h * tp)
}

/// Similarity that brings points to mean zero and mean distance sqrt 2.
fn normaliser(points: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector2<f64>>() / n;
    let size = points.iter().map(|p| (p - mean).norm()).sum::<f64>() / n;
    if !(size > 0.0) {
        return None;
    }
    let s = std::f64::consts::SQRT_2 / size;
    Some(Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0))
}

/// Circular point of a plane from its homography: `h1 + i h2`.
pub fn lattice_circular_point(image_from_plane: &Matrix3<f64>) -> CircularPoint {
    CircularPoint { real: image_from_plane.column(0).into(), imaginary: image_from_plane.column(1).into() }
}

/// Vanishing line of the common plane of two circles seen as separated ellipses, and the circular point on it.
///
/// Of the three degenerate conics of the pencil `A - mu B` one is a pair of real lines: the vanishing line and the radical axis.
/// The radical axis separates the ellipses, the vanishing line does not.
pub fn pair_circular_point(ellipses: [&Ellipse; 2]) -> Option<(CircularPoint, Vector3<f64>)> {
    // Work in units of the pair's size around its middle.
    let c = ellipses.map(|e| Vector2::new(e.center_px.u_px, e.center_px.v_px));
    let middle = (c[0] + c[1]) / 2.0;
    let size = (c[1] - c[0]).norm();
    if !(size > 0.0) {
        return None;
    }
    let px_from_local = Matrix3::new(size, 0.0, middle.x, 0.0, size, middle.y, 0.0, 0.0, 1.0);
    let local = |e: &Ellipse| {
        let m = px_from_local.transpose() * e.matrix() * px_from_local;
        m / m.determinant().abs().cbrt()
    };
    let (a, b) = (local(ellipses[0]), local(ellipses[1]));
    let centers = c.map(|c| ((c - middle) / size).push(1.0));
    for mu in pencil_roots(&a, &b) {
        let eigen = (a - b * mu).symmetric_eigen();
        let (v, e) = (eigen.eigenvalues, eigen.eigenvectors);
        let smallest = v.iamin();
        let rest: Vec<usize> = (0..3).filter(|i| *i != smallest).collect();
        if v[rest[0]] * v[rest[1]] >= 0.0 {
            continue;
        }
        let (p, m) = if v[rest[0]] > 0.0 { (rest[0], rest[1]) } else { (rest[1], rest[0]) };
        for sign in [1.0, -1.0] {
            let line: Vector3<f64> = e.column(p) * v[p].sqrt() + e.column(m) * (sign * (-v[m]).sqrt());
            if line.dot(&centers[0]) * line.dot(&centers[1]) > 0.0 {
                if let Some(point) = on_line(&line, &a) {
                    let to_px = |x: Vector3<f64>| px_from_local * x;
                    let point = CircularPoint { real: to_px(point.real), imaginary: to_px(point.imaginary) };
                    return Some((point, px_from_local.try_inverse()?.transpose() * line));
                }
            }
        }
    }
    None
}

/// Real roots of `det(A - mu B)`.
fn pencil_roots(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Vec<f64> {
    let Some(b_inverse) = b.try_inverse() else { return vec![] };
    let m = b_inverse * a;
    // Characteristic polynomial mu^3 - t mu^2 + s mu - d.
    let (t, d) = (m.trace(), m.determinant());
    let s = 0.5 * (t * t - (m * m).trace());
    let p = |x: f64| ((x - t) * x + s) * x - d;
    let dp = |x: f64| (3.0 * x - 2.0 * t) * x + s;
    // Depressed cubic: three real roots by the cosine, each polished.
    let q = (t * t - 3.0 * s) / 9.0;
    let r = (-2.0 * t.powi(3) + 9.0 * t * s - 27.0 * d) / 54.0;
    if q <= 0.0 {
        return vec![];
    }
    let theta = (r / q.powf(1.5)).clamp(-1.0, 1.0).acos();
    (0..3)
        .map(|k| {
            let mut x = -2.0 * q.sqrt() * ((theta + std::f64::consts::TAU * f64::from(k)) / 3.0).cos() + t / 3.0;
            for _ in 0..3 {
                let slope = dp(x);
                if slope != 0.0 {
                    x -= p(x) / slope;
                }
            }
            x
        })
        .collect()
}

/// The complex point in which a line that misses an ellipse meets it.
fn on_line(line: &Vector3<f64>, conic: &Matrix3<f64>) -> Option<CircularPoint> {
    let p = if line.x.abs() < 0.6 * line.norm() { line.cross(&Vector3::x()) } else { line.cross(&Vector3::y()) };
    let p = p.normalize();
    let q = line.cross(&p).normalize();
    let (aa, bb, cc) = (q.dot(&(conic * q)), 2.0 * p.dot(&(conic * q)), p.dot(&(conic * p)));
    let disc = bb * bb - 4.0 * aa * cc;
    if disc >= 0.0 || aa == 0.0 {
        return None;
    }
    let (re, im) = (-bb / (2.0 * aa), (-disc).sqrt() / (2.0 * aa));
    Some(CircularPoint { real: p + q * re, imaginary: q * im })
}

/// Pose of a lattice from its homography, in the pinhole's frame (z along the sensor normal).
///
/// The target's z points to the viewer; `None` where the homography is that of a mirrored image.
pub fn lattice_pose(image_from_plane: &Matrix3<f64>, pinhole: &EffectivePinhole) -> Option<Motion<Cam, Target>> {
    let m = inverse_k(pinhole) * image_from_plane;
    let scale = 2.0 / (m.column(0).norm() + m.column(1).norm());
    // In front of the camera.
    let scale = if m[(2, 2)] < 0.0 { -scale } else { scale };
    let (x, y, t): (Vector3<f64>, Vector3<f64>, Vector3<f64>) =
        ((m.column(0) * scale), (m.column(1) * scale), (m.column(2) * scale));
    let rotation = orthonormalised(&Matrix3::from_columns(&[x, y, x.cross(&y)]));
    (rotation.column(2).dot(&t) < 0.0).then(|| Motion::new(rotation, t))
}

fn inverse_k(p: &EffectivePinhole) -> Matrix3<f64> {
    Matrix3::new(1.0 / p.f_px, 0.0, -p.cx_px / p.f_px, 0.0, 1.0 / p.f_px, -p.cy_px / p.f_px, 0.0, 0.0, 1.0)
}

/// Pose and shape of two discs in units of their spacing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairPose {
    /// Disc 0 at the origin, disc 1 at (1, 0, 0), z towards the viewer; translation in spacings.
    pub cam_from_target: Motion<Cam, Target>,
    /// Radii over spacing.
    pub radii: [f64; 2],
}

/// Pose of two discs from their images and the vanishing line of their plane, in the pinhole's frame.
///
/// Centres are the poles of the vanishing line, so the perspective of circles costs nothing.
pub fn pair_pose(
    ellipses: [&Ellipse; 2],
    vanishing_line: &Vector3<f64>,
    pinhole: &EffectivePinhole,
) -> Option<PairPose> {
    let ki = inverse_k(pinhole);
    let k = ki.try_inverse()?;
    let normal = (k.transpose() * vanishing_line).normalize();
    let mut centers = [Vector3::zeros(); 2];
    let mut radii = [0.0; 2];
    let mut n = normal;
    for (j, e) in ellipses.iter().enumerate() {
        let pole = e.matrix().try_inverse()? * vanishing_line;
        let ray = ki * (pole / pole.z);
        if j == 0 && normal.dot(&ray) < 0.0 {
            n = -normal;
        }
        centers[j] = on_unit_plane(&n, &ray)?;
        // Mean over the outline.
        const STEPS: u32 = 16;
        for i in 0..STEPS {
            let q = e.point(std::f64::consts::TAU * f64::from(i) / f64::from(STEPS));
            let rim = on_unit_plane(&n, &(ki * Vector3::new(q.u_px, q.v_px, 1.0)))?;
            radii[j] += (rim - centers[j]).norm() / f64::from(STEPS);
        }
    }
    let spacing = (centers[1] - centers[0]).norm();
    let x = (centers[1] - centers[0]) / spacing;
    let z = -n;
    let rotation = orthonormalised(&Matrix3::from_columns(&[x, z.cross(&x), z]));
    Some(PairPose { cam_from_target: Motion::new(rotation, centers[0] / spacing), radii: radii.map(|r| r / spacing) })
}

/// Where a ray meets the plane `n . p = 1`.
fn on_unit_plane(n: &Vector3<f64>, ray: &Vector3<f64>) -> Option<Vector3<f64>> {
    let along = n.dot(ray);
    (along > 0.0).then(|| ray / along)
}
