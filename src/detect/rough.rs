//! How much rougher a contour is than the noise of its grey values explains.

use crate::conic::Ellipse;
use crate::detect::EdgePoints;
use nalgebra::{SMatrix, SVector};

/// Harmonics along the contour that a smooth lens may explain: 3 to this.
const SMOOTH: usize = 5;
/// Coefficients of these.
const N: usize = 2 * SMOOTH + 1;

/// Distances of the edge points from the ellipse without the low harmonics along the contour that a smooth lens explains, and the
/// degrees of freedom that are left.
fn without_smooth_bends(ellipse: &Ellipse, edge: &EdgePoints, mut distance: Vec<f64>) -> (Vec<f64>, f64) {
    let n = distance.len();
    let plain = (n as f64 - 5.0).max(1.0);
    if n < 4 * N {
        return (distance, plain);
    }
    let (s, c) = ellipse.angle_rad.sin_cos();
    let mut rows = Vec::with_capacity(n);
    let (mut matrix, mut right) = ([[0.0; N]; N], [0.0; N]);
    for i in 0..n {
        let (du, dv) = (edge.u_px[i] - ellipse.center_px.u_px, edge.v_px[i] - ellipse.center_px.v_px);
        let (x, y) = ((c * du + s * dv) / ellipse.semi_major_px, (c * dv - s * du) / ellipse.semi_minor_px);
        let inverse = 1.0 / (x * x + y * y).sqrt();
        let (c1, s1) = (x * inverse, y * inverse);
        // A polynomial displacement of low degree is one of low harmonics when multiplied by the length of the tangent.
        let (along, across) = (ellipse.semi_major_px * s1, ellipse.semi_minor_px * c1);
        let share = ellipse.semi_minor_px / (along * along + across * across).sqrt();
        let (mut cm, mut sm) = (1.0, 0.0);
        let mut row = [0.0; N];
        row[0] = share;
        for m in 1..=SMOOTH {
            (cm, sm) = (cm * c1 - sm * s1, sm * c1 + cm * s1);
            (row[2 * m - 1], row[2 * m]) = (share * cm, share * sm);
        }
        for k in 0..N {
            for l in 0..=k {
                matrix[k][l] += row[k] * row[l];
            }
            right[k] += row[k] * distance[i];
        }
        rows.push(row);
    }
    let matrix = SMatrix::<f64, N, N>::from_fn(|k, l| matrix[k.max(l)][k.min(l)]);
    match matrix.cholesky() {
        Some(factor) => {
            let x = factor.solve(&SVector::from(right));
            for (d, row) in distance.iter_mut().zip(&rows) {
                *d -= row.iter().zip(x.iter()).map(|(r, x)| r * x).sum::<f64>();
            }
            (distance, n as f64 - N as f64)
        }
        None => (distance, plain),
    }
}

/// Variance that, added to those of the edge points, makes their chi-square the number of degrees of freedom, px^2; `distance` is that
/// of each from the ellipse, px.
pub(crate) fn roughness_px2(ellipse: &Ellipse, edge: &EdgePoints, distance: &[f64]) -> f64 {
    let (distance, freedom) = without_smooth_bends(ellipse, edge, distance.to_vec());
    // chi2 and its slope; it falls and bends upwards, so that Newton steps from zero never pass the root.
    let chi2 = |x: f64| {
        let (mut sum, mut slope) = (0.0, 0.0);
        for (d, sigma) in distance.iter().zip(&edge.sigma_px) {
            let w = 1.0 / (sigma * sigma + x);
            let term = d * d * w;
            sum += term;
            slope -= term * w;
        }
        (sum, slope)
    };
    let mut x = 0.0;
    for _ in 0..60 {
        let (sum, slope) = chi2(x);
        if sum <= freedom || !(slope < 0.0) {
            break;
        }
        let step = (freedom - sum) / slope;
        x += step;
        if step < 1e-10 * x {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Pixel;

    /// Against its definition, with sigmas that are too small in part.
    #[test]
    fn with_the_roughness_chi2_is_the_freedom() {
        let e = Ellipse { center_px: Pixel::new(0.0, 0.0), semi_major_px: 13.0, semi_minor_px: 11.0, angle_rad: 0.2 };
        for (size, rough) in [(0.03, true), (0.004, false)] {
            let mut edge = EdgePoints::default();
            let mut distance = vec![];
            for k in 0..60 {
                let p = e.point(0.1 * f64::from(k));
                edge.u_px.push(p.u_px);
                edge.v_px.push(p.v_px);
                edge.sigma_px.push(0.01 * f64::from(1 + k % 4));
                distance.push(size * f64::from((k * 29) % 13 - 6) / 6.0);
            }
            let x = roughness_px2(&e, &edge, &distance);
            let (left, freedom) = without_smooth_bends(&e, &edge, distance);
            let chi2: f64 = left.iter().zip(&edge.sigma_px).map(|(d, s)| d * d / (s * s + x)).sum();
            assert_eq!(x > 0.0, rough);
            assert!(if rough { (chi2 / freedom - 1.0).abs() < 1e-9 } else { chi2 < freedom }, "{chi2} {freedom}");
        }
    }
}
