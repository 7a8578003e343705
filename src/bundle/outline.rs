//! Printed discs are not quite round: ovals, alike in every image of the disc.
//!
//! The outline of a printed disc departs from its circle by `a cos 2 phi + b sin 2 phi`, tau (mm) the standard deviation of a and
//! b. In the image that is far more than the noise of an edge point and common to all points of a contour, so that independent
//! sigmas would let ovals turn the plate: on a real plate 5 um of ovality are 0.35 px. The residuals of one contour, over
//! their sigmas, then have the covariance
//! ```text
//! k I + tau^2 B B^T,   B_i = (mm of outline -> px) / sigma_i * (cos 2 phi_i, sin 2 phi_i)
//! ```
//! (k the variance factor of single edge points) and are whitened by its inverse root, up to `1 / sqrt k`:
//! ```text
//! T = 1 - U diag(1 - 1 / sqrt(1 + tau^2 m_j / k)) U^T,   B = U diag(sqrt m) V^T
//! ```
//! T is formed once, from the feet of the first solution, and held: the cost stays one of least squares, its derivatives
//! exact. Higher harmonics do not couple to a plate's pose. tau is estimated from all contours together by moments,
//! `tau^2 = mean of |x|^2 / 2 - k tr (B^T B)^-1 / 2` with x the least-squares (a, b) of a contour, and taken for zero where it is no
//! more than chance.

use super::assemble::{SeenImage, threaded};
use super::contour::SeenCircle;
use super::edges::Feet;
use super::model::{DiscObservation, ImageObservations, Model};
use super::state::State;
use crate::threads::gathered;
use nalgebra::{Matrix2, Vector2};

/// What whitens the residuals of one contour.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlineNoise {
    /// Rows of U: two orthonormal columns over the edge points.
    basis: Vec<Vector2<f64>>,
    /// By how much each column is shrunk, 0 to 1.
    shrink: Vector2<f64>,
}

impl OutlineNoise {
    /// U column by column, continued by zeros up to `len` rows, and by how much each column is shrunk.
    pub(super) fn split(&self, columns: &mut [Vec<f64>; 2], len: usize) -> [f64; 2] {
        for (k, column) in columns.iter_mut().enumerate() {
            column.clear();
            column.extend(self.basis.iter().map(|u| u[k]));
            column.resize(len, 0.0);
        }
        [self.shrink.x, self.shrink.y]
    }

    /// T times a matrix given by its rows, one per edge point.
    pub(super) fn apply<const N: usize>(&self, rows: &mut [[f64; N]]) {
        let mut sums = [[0.0; N]; 2];
        for (row, u) in rows.iter().zip(&self.basis) {
            for n in 0..N {
                sums[0][n] += u.x * row[n];
                sums[1][n] += u.y * row[n];
            }
        }
        for (row, u) in rows.iter_mut().zip(&self.basis) {
            for n in 0..N {
                row[n] -= u.x * self.shrink.x * sums[0][n] + u.y * self.shrink.y * sums[1][n];
            }
        }
    }
}

/// Second harmonic of one contour.
struct Harmonic {
    rows: Vec<Vector2<f64>>,
    /// B^T B.
    information: Matrix2<f64>,
    /// Least-squares (a, b), mm.
    oval_mm: Vector2<f64>,
    /// Chi-square of the residuals without it, and how many numbers that are.
    rest: [f64; 2],
}

impl Harmonic {
    fn of(circle: &SeenCircle, seen: &DiscObservation) -> Option<Self> {
        let (edge, feet) = (&seen.edge, Feet::of(circle, seen)?);
        let (mut rows, mut information, mut b, mut chi2) =
            (Vec::with_capacity(edge.u_px.len()), Matrix2::zeros(), Vector2::zeros(), 0.0);
        for i in 0..edge.u_px.len() {
            let (cos, sin) = (feet.direction[0][i], feet.direction[1][i]);
            let iw = 1.0 / edge.sigma_px[i];
            let row = Vector2::new(cos * cos - sin * sin, 2.0 * sin * cos) * (feet.px_per_mm[i] * iw);
            let r = feet.distance_px[i] * iw;
            information += row * row.transpose();
            b += row * r;
            chi2 += r * r;
            rows.push(row);
        }
        let oval_mm = information.try_inverse()? * b;
        let rest = [chi2 - oval_mm.dot(&b), rows.len() as f64 - 5.0];
        (rest[1] > 0.0 && oval_mm.iter().all(|x| x.is_finite())).then_some(Self { rows, information, oval_mm, rest })
    }

    /// The whitening for a given tau^2 / k.
    fn noise(&self, ratio: f64) -> Option<OutlineNoise> {
        let eigen = self.information.symmetric_eigen();
        let m = eigen.eigenvalues;
        if !(m.min() > 0.0) {
            return None;
        }
        let to_basis = eigen.eigenvectors * Matrix2::from_diagonal(&m.map(|m| 1.0 / m.sqrt()));
        let basis = self.rows.iter().map(|row| to_basis.tr_mul(row)).collect();
        Some(OutlineNoise { basis, shrink: m.map(|m| 1.0 - 1.0 / (1.0 + ratio * m).sqrt()) })
    }
}

/// Estimates the ovality from the residuals and whitens every contour for it; its standard deviation tau, mm, or `None`
/// where the outlines are round as far as their noise shows (and nothing is changed).
pub(super) fn whiten(model: &mut Model, state: &State) -> Option<f64> {
    let of_image = |&(k, image): &(usize, &ImageObservations)| {
        let seen_image = SeenImage::of(model, state, image)?;
        let own = image.discs.iter().enumerate();
        let own = own.filter_map(|(d, seen)| Some((k, d, Harmonic::of(&seen_image.circle(seen.disc), seen)?)));
        Some(own.collect::<Vec<_>>())
    };
    let images: Vec<&ImageObservations> = model.images.iter().collect();
    let numbered: Vec<(usize, &ImageObservations)> = images.iter().copied().enumerate().collect();
    let all: Option<Vec<Vec<_>>> = gathered(threaded(&images), &numbered, of_image);
    let all: Vec<(usize, usize, Harmonic)> = all?.into_iter().flatten().collect();
    let chi2 = all.iter().fold([0.0, 0.0], |a, (_, _, h)| [a[0] + h.rest[0], a[1] + h.rest[1]]);
    let (n, factor) = (all.len() as f64, chi2[0] / chi2[1]);
    let half_square = all.iter().map(|(_, _, h)| 0.5 * h.oval_mm.norm_squared()).sum::<f64>() / n;
    let by_noise =
        all.iter().filter_map(|(_, _, h)| Some(0.5 * factor * h.information.try_inverse()?.trace())).sum::<f64>() / n;
    // Mean of 2 n squares: its relative standard deviation is 1 / sqrt n.
    if !(half_square > by_noise * (1.0 + 3.0 / n.sqrt())) {
        return None;
    }
    let variance = half_square - by_noise;
    for (k, d, h) in &all {
        model.images[*k].discs[*d].outline = h.noise(variance / factor);
    }
    Some(variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// T T^T (k I + tau^2 B B^T) / k is the identity.
    #[test]
    fn the_transform_whitens_the_covariance() {
        let angles: Vec<f64> = (0..9).map(|i| 0.7 * f64::from(i)).collect();
        let rows: Vec<Vector2<f64>> =
            angles.iter().map(|a| Vector2::new((2.0 * a).cos(), (2.0 * a).sin()) * (3.0 + a.cos())).collect();
        let information = rows.iter().map(|r| r * r.transpose()).sum();
        let h = Harmonic { rows: rows.clone(), information, oval_mm: Vector2::zeros(), rest: [0.0; 2] };
        let ratio = 0.3;
        let noise = h.noise(ratio).unwrap();
        let mut t = [[0.0; 9]; 9];
        (0..9).for_each(|i| t[i][i] = 1.0);
        noise.apply(&mut t);
        let t = nalgebra::SMatrix::<f64, 9, 9>::from_fn(|i, j| t[i][j]);
        let covariance =
            nalgebra::SMatrix::<f64, 9, 9>::from_fn(|i, j| f64::from(u8::from(i == j)) + ratio * rows[i].dot(&rows[j]));
        let white = t * covariance * t.transpose();
        assert!((white - nalgebra::SMatrix::<f64, 9, 9>::identity()).abs().max() < 1e-12, "{white}");
    }
}
