//! Many points near one ellipse: distances, their derivatives, and the fit through points that already lie close.

use super::common::{CommonNoise, LEAST};
use super::{Ellipse, Frame, covariance_from_regular, from_regular, parameters_by_regular, to_regular};
use crate::lanes::{self, GROUP, Kernel, Lanes};
use nalgebra::{SMatrix, SVector};

/// Gauss-Newton steps at most; points that need more are left to [`super::fit_geometric_from`].
const MOST_STEPS: usize = 4;
/// Decrease of `chi^2` that a step may still promise when it is the last one.
const STILL: f64 = 1e-9;

/// Distances of points from an ellipse; buffers reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Feet {
    /// Distances, positive outside, px.
    pub(crate) distance: Vec<f64>,
    /// Their derivatives with respect to the regular coordinates.
    rows: Vec<[f64; 5]>,
    /// Cosine and sine of the eccentric angle.
    direction: Vec<[f64; 2]>,
}

struct Find<'a> {
    frame: Frame,
    u: &'a [f64],
    v: &'a [f64],
    out: &'a mut Feet,
}

impl Kernel for Find<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (frame, n) = (&self.frame, self.u.len());
        self.out.distance.clear();
        self.out.rows.clear();
        self.out.direction.clear();
        for from in (0..n).step_by(GROUP) {
            let (mut x, mut y) = ([0.0; GROUP], [0.0; GROUP]);
            for i in 0..GROUP {
                let at = (from + i).min(n - 1);
                let (du, dv) = (self.u[at] - frame.u0, self.v[at] - frame.v0);
                x[i] = frame.cos * du + frame.sin * dv;
                y[i] = frame.cos * dv - frame.sin * du;
            }
            let feet = frame.feet(&x, &y);
            for i in 0..GROUP.min(n - from) {
                self.out.distance.push(feet.distance[i]);
                self.out.rows.push(frame.row_at(feet.cos[i], feet.sin[i]));
                self.out.direction.push([feet.cos[i], feet.sin[i]]);
            }
        }
    }
}

/// Rows over the sigmas of their points.
fn whitened<const N: usize>(rows: &[[f64; N]], sigma_px: &[f64]) -> Vec<[f64; N]> {
    rows.iter().zip(sigma_px).map(|(row, sigma)| row.map(|x| x / sigma)).collect()
}

impl Feet {
    /// Finds the feet of points, px, within the radius of curvature of the contour.
    pub(crate) fn find(&mut self, e: &Ellipse, u_px: &[f64], v_px: &[f64]) {
        lanes::run(Find { frame: Frame::new(e), u: u_px, v: v_px, out: self });
    }

    /// `(J^T W J, J^T W d, chi^2)` in regular coordinates.
    fn normal_equations(&self, sigma_px: &[f64]) -> (SMatrix<f64, 5, 5>, SVector<f64, 5>, f64) {
        let (mut normal, mut gradient, mut chi2) = ([[0.0; 5]; 5], [0.0; 5], 0.0);
        for ((row, d), sigma) in self.rows.iter().zip(&self.distance).zip(sigma_px) {
            let w = 1.0 / (sigma * sigma);
            for i in 0..5 {
                let wr = w * row[i];
                for j in 0..=i {
                    normal[i][j] += wr * row[j];
                }
                gradient[i] += wr * d;
            }
            chi2 += w * d * d;
        }
        let normal = SMatrix::from_fn(|i, j| normal[i.max(j)][i.min(j)]);
        (normal, SVector::from(gradient), chi2)
    }

    /// By how much the covariance of `(u0, v0, a, b, phi)` grows as the sigmas of the points, px, whose feet on `e` were found last, grow from
    /// `before_px`: never by a negative variance, as `(J^T W J)^-1` falls with W and both are turned alike.
    pub(crate) fn growth(&self, e: &Ellipse, sigma_px: &[f64], before_px: &[f64]) -> Option<SMatrix<f64, 5, 5>> {
        let regular = |sigma_px: &[f64]| Some(self.normal_equations(sigma_px).0.cholesky()?.inverse());
        let (whole, before) = (regular(sigma_px)?, regular(before_px)?);
        let by = parameters_by_regular(&to_regular(e), &whole);
        Some(by * (whole - before) * by.transpose())
    }

    /// By how much an ellipse with a covariance of its regular coordinates is known less well than the points, whose feet on it were found
    /// last, would say if they were independent; none where that is next to nothing.
    pub(crate) fn excess(&self, covariance: &SMatrix<f64, 5, 5>, sigma_px: &[f64]) -> Option<SMatrix<f64, 5, 5>> {
        let normal = self.normal_equations(sigma_px).0;
        if !(normal.component_mul(covariance).sum() > 5.0 + LEAST) {
            return None;
        }
        Some(covariance - normal.cholesky()?.inverse())
    }

    /// What the points, whose feet were found last, have in common where the regular coordinates of their ellipse have the covariance `c`
    /// beyond that of independent points.
    pub(crate) fn common(&self, c: &SMatrix<f64, 5, 5>, sigma_px: &[f64]) -> CommonNoise {
        CommonNoise::of(&whitened(&self.rows, sigma_px), c)
    }

    /// Adds that the points, whose feet on `e` were found last, say nothing but their ellipse of what a smooth lens makes of a circle.
    pub(crate) fn forget_bends(&self, e: &Ellipse, sigma_px: &[f64], common: &mut CommonNoise) {
        let frame = Frame::new(e);
        let bends: Vec<[f64; 4]> = self.direction.iter().map(|[c, s]| frame.bends_at(*c, *s)).collect();
        common.forget(&whitened(&self.rows, sigma_px), &whitened(&bends, sigma_px));
    }

    /// The ellipse through the points, from `e`, on which their feet were found last, with its covariance; none where a few steps do
    /// not lead there.
    pub(crate) fn refit(
        &mut self,
        e: &Ellipse,
        u_px: &[f64],
        v_px: &[f64],
        sigma_px: &[f64],
    ) -> Option<(Ellipse, SMatrix<f64, 5, 5>)> {
        let mut ellipse = *e;
        let (mut normal, mut gradient, mut chi2) = self.normal_equations(sigma_px);
        for _ in 0..MOST_STEPS {
            let step = normal.cholesky()?.solve(&gradient);
            let promised = step.dot(&gradient);
            ellipse = from_regular(&(to_regular(&ellipse) - step))?;
            self.find(&ellipse, u_px, v_px);
            let next = self.normal_equations(sigma_px);
            if !(next.2 <= chi2 * (1.0 + 1e-9)) {
                return None;
            }
            (normal, gradient, chi2) = next;
            if promised < STILL * (1.0 + chi2) {
                let regular = normal.cholesky()?.inverse();
                return Some((ellipse, covariance_from_regular(&to_regular(&ellipse), &regular)));
            }
        }
        None
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::fit_geometric_from;
    use crate::frames::Pixel;

    /// An ellipse that is known less well than its points, each for itself, say: whitened for what they have in common they say the same.
    #[test]
    fn points_with_what_they_have_in_common_say_what_the_ellipse_does() {
        let e = Ellipse { center_px: Pixel::new(50.0, 40.0), semi_major_px: 13.0, semi_minor_px: 11.0, angle_rad: 0.7 };
        let points: Vec<Pixel> = (0..43).map(|k| e.point(0.146 * f64::from(k))).collect();
        let [u, v]: [Vec<f64>; 2] = [points.iter().map(|p| p.u_px).collect(), points.iter().map(|p| p.v_px).collect()];
        let sigma: Vec<f64> = (0..43).map(|k| 0.02 * f64::from(1 + k % 3)).collect();
        let mut feet = Feet::default();
        feet.find(&e, &u, &v);
        let own = feet.normal_equations(&sigma).0.cholesky().expect("an ellipse").inverse();
        assert!(feet.excess(&own, &sigma).is_none());
        let spread = SVector::from([3e-3, -2e-3, 8e-3, 1e-3, 4e-3]);
        let whole = own * 1.5 + spread * spread.transpose();
        let excess = feet.excess(&whole, &sigma).expect("more than points say");
        let fit = fit_geometric_from(&e, &u, &v, &sigma).expect("a fit");
        let shared = fit.with_common([&u, &v, &sigma], &feet.common(&excess, &sigma)).expect("a covariance").covariance;
        let wanted = covariance_from_regular(&to_regular(&e), &whole);
        assert!((shared - wanted).abs().max() < 1e-4 * wanted.abs().max(), "{shared} {wanted}");
        // Nor does it say more or less of the ellipse without the bends of a smooth lens, and nothing of these.
        let mut alone = feet.common(&excess, &sigma);
        feet.forget_bends(&e, &sigma, &mut alone);
        assert_eq!(alone.forgotten(), 4);
        let fit = fit_geometric_from(&e, &u, &v, &sigma).expect("a fit");
        let shared = fit.with_common([&u, &v, &sigma], &alone).expect("a covariance").covariance;
        assert!((shared - wanted).abs().max() < 1e-4 * wanted.abs().max(), "{shared} {wanted}");
        let bends: Vec<[f64; 4]> = feet.direction.iter().map(|[c, s]| Frame::new(&e).bends_at(*c, *s)).collect();
        let of = |k: usize, i: usize| feet.rows[k].get(i).copied().unwrap_or_else(|| bends[k][i - 5]) / sigma[k];
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

    /// Against foot points one by one and the damped fit.
    #[test]
    fn the_refit_is_the_geometric_fit() {
        for (a, b) in [(13.0, 11.0), (40.0, 12.0), (7.0, 6.99)] {
            let e = Ellipse { center_px: Pixel::new(50.0, 40.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.7 };
            let (mut u, mut v, mut sigma) = (vec![], vec![], vec![]);
            for k in 0..43 {
                let p = e.point(0.146 * f64::from(k));
                let off = 0.05 * f64::from((k * 17) % 11 - 5);
                u.push(p.u_px + off);
                v.push(p.v_px - 0.5 * off);
                sigma.push(0.02 * f64::from(1 + k % 3));
            }
            let mut feet = Feet::default();
            feet.find(&e, &u, &v);
            let frame = Frame::new(&e);
            for k in 0..u.len() {
                let plain = frame.foot(u[k], v[k], None);
                assert!((feet.distance[k] - plain.distance).abs() < 1e-6, "{} {}", feet.distance[k], plain.distance);
                (0..5).for_each(|i| assert!((feet.rows[k][i] - plain.row[i]).abs() < 1e-4));
            }
            let (found, covariance) = feet.refit(&e, &u, &v, &sigma).expect("a fit");
            let plain = fit_geometric_from(&e, &u, &v, &sigma).expect("a fit");
            let gap = (to_regular(&found) - to_regular(&plain.ellipse)).norm();
            assert!(gap < 1e-5, "{a} {b}: {gap} px");
            for i in 0..4 {
                assert!((covariance[(i, i)] / plain.covariance[(i, i)] - 1.0).abs() < 1e-3);
            }
        }
    }
}
