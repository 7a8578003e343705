//! How much rougher a contour is than the noise of its grey values explains.

use crate::conic::{Ellipse, Feet, fit_geometric_from};
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

/// Adds a variance, px^2, to those of the edge points, whose feet on `e` were found last: the ellipse through them with these sigmas, and what
/// the variance adds to the covariance of `(u0, v0, a, b, phi)`. Both covariances are about the ellipse that is returned, so that what
/// is added is positive semidefinite, as `(J^T W J)^-1` is for a smaller W; none where the points fix no ellipse.
pub(crate) fn roughen(
    e: &Ellipse,
    edge: &mut EdgePoints,
    variance_px2: f64,
    feet: &mut Feet,
) -> Option<(Ellipse, SMatrix<f64, 5, 5>)> {
    let plain_px = edge.sigma_px.clone();
    edge.sigma_px.iter_mut().for_each(|s| *s = (*s * *s + variance_px2).sqrt());
    let ellipse = match feet.refit(e, &edge.u_px, &edge.v_px, &edge.sigma_px) {
        Some((ellipse, _)) => ellipse,
        None => {
            let ellipse = fit_geometric_from(e, &edge.u_px, &edge.v_px, &edge.sigma_px).ok()?.ellipse;
            feet.find(&ellipse, &edge.u_px, &edge.v_px);
            ellipse
        }
    };
    let added = feet.growth(&ellipse, &edge.sigma_px, &plain_px)?;
    Some((ellipse, added))
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::{Frame, covariance_from_regular, to_regular};
    use crate::frames::Pixel;
    use crate::stats::random::Random;

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

    /// Covariance of `(u0, v0, a, b, phi)` by its definition, foot by foot.
    fn of(e: &Ellipse, edge: &EdgePoints) -> Option<SMatrix<f64, 5, 5>> {
        let frame = Frame::new(e);
        let mut normal = SMatrix::<f64, 5, 5>::zeros();
        for i in 0..edge.u_px.len() {
            let row = SVector::from(frame.foot(edge.u_px[i], edge.v_px[i], None).row) / edge.sigma_px[i];
            normal += row * row.transpose();
        }
        Some(covariance_from_regular(&to_regular(e), &normal.cholesky()?.inverse()))
    }

    /// A few points of half a contour, far off the ellipse: covariances about two ellipses differed by negative variances.
    #[test]
    fn roughness_never_makes_an_ellipse_better_known() {
        let e = Ellipse { center_px: Pixel::new(9.0, 7.0), semi_major_px: 5.0, semi_minor_px: 3.2, angle_rad: 0.4 };
        let mut random = Random(5);
        let (mut before, mut fitted) = (0, 0);
        for _ in 0..300 {
            let mut edge = EdgePoints::default();
            for k in 0..8 {
                let p = e.point(0.45 * f64::from(k));
                edge.u_px.push(p.u_px + 0.25 * random.gauss());
                edge.v_px.push(p.v_px + 0.25 * random.gauss());
                edge.sigma_px.push(0.04);
            }
            let mut feet = Feet::default();
            feet.find(&e, &edge.u_px, &edge.v_px);
            let of_start = of(&e, &edge);
            let Some((ellipse, added)) = roughen(&e, &mut edge, 0.003, &mut feet) else { continue };
            fitted += 1;
            let whole = of(&ellipse, &edge).expect("a covariance");
            let least = |m: SMatrix<f64, 5, 5>| m.symmetric_eigenvalues().min() / whole.trace();
            assert!(least(added) > -1e-9, "{}", least(added));
            assert!(least(whole - added) > -1e-9);
            before += usize::from(of_start.is_some_and(|c| (whole - c).diagonal().min() < 0.0));
        }
        assert!(fitted > 250 && before > 0, "{fitted} fitted, {before} negative about two ellipses");
    }
}
