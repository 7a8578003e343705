//! Noise that the points of one contour have in common.
//!
//! Distances of edge points over their own sigmas have the covariance `1 + R C R^T`: R one row per point, how its distance follows few
//! numbers, over its sigma; C the covariance of these numbers, which all points share. With
//! ```text
//! R^T R = K K^T,   K^T C K = V diag(m) V^T,   U = R K^-T V,      R C R^T = U diag(m) U^T,   U^T U = 1
//! ```
//! they are whitened by `T = 1 - U diag(1 - 1 / sqrt(1 + m)) U^T`, without a matrix as large as the contour.
//!
//! Four kinds are known. What is uncertain of blur and light moves the contour of a disc as a whole: the five numbers of its ellipse
//! are known less well than its edge points, each for itself, would say. So do the long waves of a rough rim. Light that is followed along the
//! contour takes what bends it off an ellipse for light, so that a contour says nothing of that, m infinite. [`ContourNoise`] holds these.
//! And printed discs are ovals (see [`crate::bundle`]).

use super::feet::{Feet, Normal};
use super::{Ellipse, inverse_of_positive};
use crate::lanes::GROUP;
use nalgebra::{DMatrix, SMatrix};

/// Variance, over that of independent points, below which points have nothing in common: 5 % of a standard deviation.
const LEAST: f64 = 0.1;

/// Noise that the points of one contour have in common, in distances over their own sigmas.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CommonNoise {
    /// Orthonormal columns of U, each continued by zeros to whole groups.
    columns: Vec<f64>,
    /// By how much each column is shrunk, 0 to 1.
    shrink: Vec<f64>,
}

impl CommonNoise {
    /// That of numbers with the covariance `c`, which move the points by `rows`, over their sigmas; nothing where the points do not fix
    /// the numbers.
    pub(crate) fn of<const N: usize>(rows: &[[f64; N]], c: &SMatrix<f64, N, N>) -> Self {
        let mut out = Self::default();
        let mut normal = SMatrix::<f64, N, N>::zeros();
        for row in rows {
            for i in 0..N {
                (0..=i).for_each(|j| normal[(i, j)] += row[i] * row[j]);
            }
        }
        normal.fill_upper_triangle_with_lower_triangle();
        // The trace of K^T C K, the sum of all m.
        if !(normal.component_mul(c).sum() > LEAST) {
            return out;
        }
        let Some(k) = normal.cholesky().map(|c| c.l()) else { return out };
        let Some(inverse) = k.try_inverse() else { return out };
        let excess = k.transpose() * c * k;
        let eigen = DMatrix::from_fn(N, N, |i, j| excess[(i, j)]).symmetric_eigen();
        for j in (0..N).filter(|j| eigen.eigenvalues[*j] > LEAST) {
            let to_column = inverse.tr_mul(&SMatrix::<f64, N, 1>::from_fn(|i, _| eigen.eigenvectors[(i, j)]));
            out.shrink.push(1.0 - 1.0 / (1.0 + eigen.eigenvalues[j]).sqrt());
            out.columns.extend(rows.iter().map(|row| row.iter().zip(&to_column).map(|(r, t)| r * t).sum::<f64>()));
            out.columns.resize(out.columns.len().next_multiple_of(GROUP), 0.0);
        }
        out
    }

    /// Orthonormal columns, given by their rows, of which points say nothing.
    pub(crate) fn of_orthonormal<const N: usize>(rows: &[[f64; N]]) -> Self {
        let mut out = Self { columns: vec![], shrink: vec![1.0; N] };
        for k in 0..N {
            out.columns.extend(rows.iter().map(|row| row[k]));
            out.columns.resize(out.columns.len().next_multiple_of(GROUP), 0.0);
        }
        out
    }

    /// Adds that nothing is known of how the points move by `rows`, over their sigmas, beyond what the numbers that move them by `known` say.
    pub(crate) fn forget<const K: usize, const N: usize>(&mut self, known: &[[f64; K]], rows: &[[f64; N]]) {
        let n = known.len();
        let all = DMatrix::from_fn(n, K + N, |i, j| if j < K { known[i][j] } else { rows[i][j - K] });
        if n < K + N {
            return;
        }
        let q = all.qr().q();
        for j in K..K + N {
            self.shrink.push(1.0);
            self.columns.extend(q.column(j).iter());
            self.columns.resize(self.columns.len().next_multiple_of(GROUP), 0.0);
        }
    }

    /// That of some of so many points, spread evenly along the contour, that stand for all of them.
    pub(crate) fn of_some(&self, at: &[usize], all: usize) -> Self {
        let grown = (all as f64 / at.len().max(1) as f64).sqrt();
        let mut out = Self { columns: vec![], shrink: self.shrink.clone() };
        for (column, _) in self.columns() {
            out.columns.extend(at.iter().map(|i| grown * column[*i]));
            out.columns.resize(out.columns.len().next_multiple_of(GROUP), 0.0);
        }
        out
    }

    /// Number of directions in which the points say nothing.
    pub(crate) fn forgotten(&self) -> usize {
        self.shrink.iter().filter(|s| **s >= 1.0).count()
    }

    /// True where the points are independent.
    pub fn is_none(&self) -> bool {
        self.shrink.is_empty()
    }

    /// Columns of U with how much each is shrunk.
    #[inline(always)]
    pub(crate) fn columns(&self) -> impl Iterator<Item = (&[f64], f64)> {
        let length = self.columns.len() / self.shrink.len().max(1);
        self.columns.chunks_exact(length.max(1)).zip(self.shrink.iter().copied())
    }

    /// T times a matrix given by its rows, one per point.
    pub(crate) fn apply<const N: usize>(&self, rows: &mut [[f64; N]]) {
        for (column, shrink) in self.columns() {
            let mut sums = [0.0; N];
            for (row, u) in rows.iter().zip(column) {
                (0..N).for_each(|n| sums[n] += u * row[n]);
            }
            for (row, u) in rows.iter_mut().zip(column) {
                (0..N).for_each(|n| row[n] -= u * shrink * sums[n]);
            }
        }
    }
}

/// What the fit of a contour knows of it beside the edge points, each for itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ContourNoise {
    /// Covariance of the regular coordinates of the ellipse beyond that of independent points, px^2; none where that is next to nothing.
    excess: Option<SMatrix<f64, 5, 5>>,
    /// Whether the light was followed along the contour and took what bends it off an ellipse.
    followed: bool,
    /// Chi-square of the edge points with the sigmas that noise alone gives them.
    chi2: f64,
    /// By what number standard deviations of place and axes were multiplied at most for points that scatter by more than that; 0 where none was.
    enlarged: f64,
}

impl ContourNoise {
    /// That of an ellipse with this covariance of its regular coordinates, px^2, from points with these normal equations.
    pub(crate) fn of(normal: &Normal, covariance: &SMatrix<f64, 5, 5>, followed: bool) -> Self {
        let more = normal.matrix.component_mul(covariance).sum() > 5.0 + LEAST;
        let own = if more { inverse_of_positive(&normal.matrix) } else { None };
        Self { excess: own.map(|own| covariance - own), followed, chi2: normal.chi2, enlarged: 0.0 }
    }

    /// Adds what is uncertain of the regular coordinates by something else, px^2.
    pub(crate) fn add(&mut self, covariance: &SMatrix<f64, 5, 5>) {
        self.excess = Some(self.excess.map_or(*covariance, |excess| excess + covariance));
    }

    /// Chi-square of the edge points by noise alone.
    pub(crate) fn chi2(&self) -> f64 {
        self.chi2
    }

    /// By what number standard deviations of place and axes were multiplied at most for edge points that scatter by more than noise; 1 where none was.
    pub fn enlarged(&self) -> f64 {
        self.enlarged.max(1.0)
    }

    /// Notes that they were multiplied by so much.
    pub(crate) fn enlarge(&mut self, by: f64) {
        self.enlarged = by;
    }

    /// What the points, px, of the contour `e` have in common.
    pub(crate) fn of_points(&self, e: &Ellipse, [u_px, v_px, sigma_px]: [&[f64]; 3]) -> CommonNoise {
        let mut common = CommonNoise::default();
        if self.excess.is_none() && !self.followed {
            return common;
        }
        let mut feet = Feet::default();
        feet.find(e, u_px, v_px);
        let rows = feet.whitened_rows(sigma_px);
        if let Some(excess) = &self.excess {
            common = CommonNoise::of(&rows, excess);
        }
        if self.followed {
            common.forget(&rows, &feet.whitened_bends(e, sigma_px));
        }
        common
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::{covariance_from_regular, fit_geometric_from, to_regular};
    use crate::frames::Pixel;
    use nalgebra::SVector;

    /// T (1 + R C R^T) T^T is the identity.
    #[test]
    fn the_transform_whitens_the_covariance() {
        let rows: [[f64; 3]; 13] = std::array::from_fn(|i| std::array::from_fn(|j| (0.7 * (i * (j + 1)) as f64).cos()));
        let root = SMatrix::<f64, 3, 3>::from_fn(|i, j| {
            (1.0 + 2.3 * i as f64 + 0.9 * j as f64).sin() + f64::from(u8::from(i == j))
        });
        let c = root * root.transpose();
        let noise = CommonNoise::of(&rows, &c);
        assert_eq!(noise.columns().count(), 3);
        let mut t = [[0.0; 13]; 13];
        (0..13).for_each(|i| t[i][i] = 1.0);
        noise.apply(&mut t);
        let t = SMatrix::<f64, 13, 13>::from_fn(|i, j| t[i][j]);
        let r = SMatrix::<f64, 13, 3>::from_fn(|i, j| rows[i][j]);
        let white = t * (SMatrix::<f64, 13, 13>::identity() + r * c * r.transpose()) * t.transpose();
        assert!((white - SMatrix::<f64, 13, 13>::identity()).abs().max() < 1e-12, "{white}");
    }

    /// Independent points have nothing in common, whatever rounding makes of a covariance.
    #[test]
    fn independent_points_have_nothing_in_common() {
        let rows: [[f64; 2]; 9] = std::array::from_fn(|i| [1.0, i as f64]);
        let little = SMatrix::<f64, 2, 2>::from_diagonal_element(1e-6);
        for c in [SMatrix::zeros(), little, -little] {
            assert!(CommonNoise::of(&rows, &c).is_none());
        }
        // Nothing fixes the second number.
        assert!(CommonNoise::of(&[[1.0, 0.0]; 9], &SMatrix::identity()).is_none());
    }

    /// An ellipse that is known less well than its points, each for itself, say: whitened for what they have in common they say the same.
    #[test]
    fn points_with_what_they_have_in_common_say_what_the_ellipse_does() {
        let e = Ellipse { center_px: Pixel::new(50.0, 40.0), semi_major_px: 13.0, semi_minor_px: 11.0, angle_rad: 0.7 };
        let points: Vec<Pixel> = (0..43).map(|k| e.point(0.146 * f64::from(k))).collect();
        let [u, v]: [Vec<f64>; 2] = [points.iter().map(|p| p.u_px).collect(), points.iter().map(|p| p.v_px).collect()];
        let sigma: Vec<f64> = (0..43).map(|k| 0.02 * f64::from(1 + k % 3)).collect();
        let mut feet = Feet::default();
        feet.find(&e, &u, &v);
        let normal = feet.normal(&sigma);
        let own = normal.matrix.cholesky().expect("an ellipse").inverse();
        let noise =
            |covariance, followed| ContourNoise::of(&normal, covariance, followed).of_points(&e, [&u, &v, &sigma]);
        assert!(noise(&own, false).is_none());
        let spread = SVector::from([3e-3, -2e-3, 8e-3, 1e-3, 4e-3]);
        let whole = own * 1.5 + spread * spread.transpose();
        let fit = fit_geometric_from(&e, &u, &v, &sigma).expect("a fit");
        let shared = fit.with_common([&u, &v, &sigma], &noise(&whole, false)).expect("a covariance").covariance;
        let wanted = covariance_from_regular(&to_regular(&e), &whole);
        assert!((shared - wanted).abs().max() < 1e-4 * wanted.abs().max(), "{shared} {wanted}");
        // Nor does it say more or less of the ellipse without the bends of a smooth lens, and nothing of these.
        let alone = noise(&whole, true);
        assert_eq!(alone.forgotten(), 4);
        let fit = fit_geometric_from(&e, &u, &v, &sigma).expect("a fit");
        let shared = fit.with_common([&u, &v, &sigma], &alone).expect("a covariance").covariance;
        assert!((shared - wanted).abs().max() < 1e-4 * wanted.abs().max(), "{shared} {wanted}");
        let (own, bends) = (feet.whitened_rows(&sigma), feet.whitened_bends(&e, &sigma));
        let of = |k: usize, i: usize| if i < 5 { own[k][i] } else { bends[k][i - 5] };
        let mut rows: Vec<[f64; 9]> = (0..43).map(|k| std::array::from_fn(|i| of(k, i))).collect();
        let before = rows.clone();
        alone.apply(&mut rows);
        let product = |a: &[[f64; 9]], i: usize, j: usize| a.iter().map(|r| r[i] * r[j]).sum::<f64>();
        let normal = SMatrix::<f64, 9, 9>::from_fn(|i, j| product(&rows, i, j));
        let ellipse = normal.fixed_view::<5, 5>(0, 0).try_inverse().expect("an ellipse");
        let (to_ellipse, own) = (normal.fixed_view::<4, 5>(5, 0), normal.fixed_view::<4, 4>(5, 5));
        let left = own - to_ellipse * ellipse * to_ellipse.transpose();
        let largest = (5..9).map(|i| product(&before, i, i)).fold(0.0, f64::max);
        assert!(left.abs().max() < 1e-9 * largest, "{left}");
    }
}
