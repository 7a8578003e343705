//! The effective pinhole from circular points.

use crate::camera::EffectivePinhole;
use nalgebra::{Matrix3, Vector3};

/// Image of a circular point: `real + i imaginary`, homogeneous pixel coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CircularPoint {
    /// Real part.
    pub real: Vector3<f64>,
    /// Imaginary part.
    pub imaginary: Vector3<f64>,
}

/// Candidates for the effective pinhole of one camera, the likeliest first; never empty.
///
/// * `points`: one circular point per view; * `size_px`: width and height; * `nominal_f_px`: f of the drawing, where known.
///
/// The full solution needs views that differ in direction; where they do not, candidates with the principal point at the
/// sensor's centre or at fixed tilts follow, so that a caller can try them in turn.
pub fn pinholes(points: &[CircularPoint], size_px: [f64; 2], nominal_f_px: Option<f64>) -> Vec<EffectivePinhole> {
    // Centre and scale of the sensor: all three unknowns are then of order one.
    let (cx, cy) = ((size_px[0] - 1.0) / 2.0, (size_px[1] - 1.0) / 2.0);
    let scale = nominal_f_px.unwrap_or(4.0 * size_px[0].max(size_px[1]));
    let rows: Vec<[f64; 4]> = points.iter().flat_map(|p| constraint_rows(p, cx, cy, scale)).collect();
    let mut out = vec![];
    let mut push = |x: f64, y: f64, f2: f64| {
        if f2.is_finite() && f2 > 1e-3 && x.is_finite() && y.is_finite() && f2 < 1e4 {
            out.push(EffectivePinhole { f_px: f2.sqrt() * scale, cx_px: cx + x * scale, cy_px: cy + y * scale });
        }
    };
    if let Some(s) = least_squares(&rows) {
        push(-s.x, -s.y, s.z - s.x * s.x - s.y * s.y);
    }
    // A known principal point leaves c alone: its weighted mean.
    let at = |x: f64, y: f64| {
        let (mut num, mut den) = (0.0, 0.0);
        for r in &rows {
            let rest = r[3] - (-x) * r[0] - (-y) * r[1];
            num += r[2] * rest;
            den += r[2] * r[2];
        }
        num / den - x * x - y * y
    };
    push(0.0, 0.0, at(0.0, 0.0));
    for tilt_deg in [-24.0_f64, -12.0, 12.0, 24.0] {
        let t = tilt_deg.to_radians().tan();
        // With f = scale the effective principal point lies f sin b off the axis.
        push(t, 0.0, at(t, 0.0));
        push(0.0, t, at(0.0, t));
    }
    push(0.0, 0.0, 1.0);
    out
}

/// Rows `(A, rhs)` of real and imaginary part for the unknowns (a, b, c) in centred, scaled pixels.
fn constraint_rows(p: &CircularPoint, cx: f64, cy: f64, scale: f64) -> [[f64; 4]; 2] {
    let centred = |v: &Vector3<f64>| Vector3::new((v.x - cx * v.z) / scale, (v.y - cy * v.z) / scale, v.z);
    let (r, i) = (centred(&p.real), centred(&p.imaginary));
    let n = (r.norm_squared() + i.norm_squared()).sqrt();
    let (r, i) = (r / n, i / n);
    // (r + i j)(r' + i j') products: real part rr' - ii', imaginary part ri' + ir'.
    let re = |a: usize, b: usize| r[a] * r[b] - i[a] * i[b];
    let im = |a: usize, b: usize| r[a] * i[b] + i[a] * r[b];
    [
        [2.0 * re(0, 2), 2.0 * re(1, 2), re(2, 2), -(re(0, 0) + re(1, 1))],
        [2.0 * im(0, 2), 2.0 * im(1, 2), im(2, 2), -(im(0, 0) + im(1, 1))],
    ]
}

fn least_squares(rows: &[[f64; 4]]) -> Option<Vector3<f64>> {
    let (mut n, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for r in rows {
        let a = Vector3::new(r[0], r[1], r[2]);
        n += a * a.transpose();
        b += a * r[3];
    }
    let scale = n.trace();
    let eigen = n.symmetric_eigen();
    let low = eigen.eigenvalues.min();
    // One view leaves an exact null direction; anything clearly above rounding may still help as a start.
    if rows.len() < 4 || low <= 1e-13 * scale {
        return None;
    }
    n.cholesky().map(|c| c.solve(&b))
}
