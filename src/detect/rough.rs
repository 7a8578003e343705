//! How much rougher a contour is than the noise of its grey values explains.

use crate::conic::{Ellipse, Frame};
use crate::detect::EdgePoints;
use nalgebra::{SMatrix, SVector};

/// Harmonics along the contour that a smooth lens may explain: 3 to this.
const SMOOTH: usize = 5;

/// Distances of the edge points from the ellipse without the low harmonics along the contour that a smooth lens explains, and the
/// degrees of freedom that are left.
fn without_smooth_bends(ellipse: &Ellipse, edge: &EdgePoints) -> (Vec<f64>, f64) {
    const N: usize = 2 * SMOOTH + 1;
    let n = edge.u_px.len();
    let (s, c) = ellipse.angle_rad.sin_cos();
    let frame = Frame::new(ellipse);
    let mut distance = Vec::with_capacity(n);
    let mut rows = Vec::with_capacity(n);
    let (mut matrix, mut right) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
    for i in 0..n {
        let p = crate::frames::Pixel::new(edge.u_px[i], edge.v_px[i]);
        let d = frame.foot(p.u_px, p.v_px, None).distance;
        let (du, dv) = (p.u_px - ellipse.center_px.u_px, p.v_px - ellipse.center_px.v_px);
        let (x, y) = ((c * du + s * dv) / ellipse.semi_major_px, (c * dv - s * du) / ellipse.semi_minor_px);
        let r = x.hypot(y);
        let (c1, s1) = (x / r, y / r);
        // A polynomial displacement of low degree is one of low harmonics when multiplied by the length of the tangent.
        let share = ellipse.semi_minor_px / (ellipse.semi_major_px * s1).hypot(ellipse.semi_minor_px * c1);
        let (mut cm, mut sm) = (1.0, 0.0);
        let mut row = SVector::<f64, N>::zeros();
        row[0] = share;
        for m in 1..=SMOOTH {
            (cm, sm) = (cm * c1 - sm * s1, sm * c1 + cm * s1);
            (row[2 * m - 1], row[2 * m]) = (share * cm, share * sm);
        }
        matrix += row * row.transpose();
        right += row * d;
        distance.push(d);
        rows.push(row);
    }
    let plain = (n as f64 - 5.0).max(1.0);
    if n < 4 * N {
        return (distance, plain);
    }
    match matrix.cholesky() {
        Some(factor) => {
            let x = factor.solve(&right);
            (distance.iter().zip(&rows).map(|(d, r)| d - r.dot(&x)).collect(), n as f64 - N as f64)
        }
        None => (distance, plain),
    }
}

/// Variance that, added to those of the edge points, makes their chi-square the number of degrees of freedom, px^2.
pub(crate) fn roughness_px2(ellipse: &Ellipse, edge: &EdgePoints) -> f64 {
    let (distance, freedom) = without_smooth_bends(ellipse, edge);
    let chi2 = |x: f64| distance.iter().zip(&edge.sigma_px).map(|(r, s)| r * r / (s * s + x)).sum::<f64>();
    if chi2(0.0) <= freedom {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, distance.iter().map(|r| r * r).sum::<f64>() / freedom);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if chi2(middle) > freedom { low = middle } else { high = middle }
    }
    high
}
