//! Many points near one ellipse: distances, their derivatives, and the fit through points that already lie close.

use super::{Ellipse, Frame, from_regular, inverse_of_positive, parameters_by_regular, to_regular};
use crate::lanes::{self, GROUP, Kernel, Lanes};
use nalgebra::{SMatrix, SVector};

/// Gauss-Newton steps at most; points that need more are left to [`super::fit_geometric_from`].
const MOST_STEPS: usize = 4;
/// Decrease of `chi^2` that a step may still promise when it is the last one.
const STILL: f64 = 1e-6;
/// Products of five rows and the distance with each other, lower triangle.
const PRODUCTS: usize = 21;

/// Distances of points from an ellipse; buffers reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Feet {
    /// Distances, positive outside, px.
    pub(crate) distance: Vec<f64>,
    /// Their derivatives with respect to the regular coordinates, a group of points each.
    rows: Vec<[[f64; GROUP]; 5]>,
    /// Cosine and sine of the eccentric angle, a group of points each.
    direction: Vec<[[f64; GROUP]; 2]>,
}

/// Normal equations of an ellipse through points, in its regular coordinates.
#[derive(Debug, Clone)]
pub(crate) struct Normal {
    /// `J^T W J`, 1/px^2.
    pub(crate) matrix: SMatrix<f64, 5, 5>,
    /// `J^T W d`, 1/px.
    gradient: SVector<f64, 5>,
    /// `d^T W d`.
    pub(crate) chi2: f64,
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
                (x[i], y[i]) = frame.inside(self.u[at], self.v[at]);
            }
            let feet = frame.feet(&x, &y);
            let mut rows = [[0.0; GROUP]; 5];
            for i in 0..GROUP {
                let row = frame.row_at(feet.cos[i], feet.sin[i]);
                for k in 0..5 {
                    rows[k][i] = row[k];
                }
            }
            self.out.distance.extend_from_slice(&feet.distance[..GROUP.min(n - from)]);
            self.out.rows.push(rows);
            self.out.direction.push([feet.cos, feet.sin]);
        }
    }
}

/// Products of the rows and distances, each weighed.
struct Products<'a> {
    feet: &'a Feet,
    sigma_px: &'a [f64],
}

impl Kernel for Products<'_> {
    type Output = [f64; PRODUCTS];
    #[inline(always)]
    fn run<L: Lanes>(self) -> [f64; PRODUCTS] {
        let n = self.sigma_px.len();
        let mut sums = [[0.0; GROUP]; PRODUCTS];
        let mut part = 0;
        while part < GROUP {
            // Of one part of all groups, so that sums stay in registers.
            let mut own = [L::splat(0.0); PRODUCTS];
            for (g, rows) in self.feet.rows.iter().enumerate() {
                // What only fills the last group has no weight.
                let (mut distance, mut sigma) = ([0.0; GROUP], [f64::INFINITY; GROUP]);
                let from = g * GROUP;
                match (self.feet.distance[from..n].first_chunk(), self.sigma_px[from..].first_chunk()) {
                    (Some(d), Some(s)) => (distance, sigma) = (*d, *s),
                    _ => {
                        distance[..n - from].copy_from_slice(&self.feet.distance[from..n]);
                        sigma[..n - from].copy_from_slice(&self.sigma_px[from..]);
                    }
                }
                let inverse = L::splat(1.0) / L::load(&sigma[part..]);
                let mut numbers = [L::splat(0.0); 6];
                for k in 0..5 {
                    numbers[k] = L::load(&rows[k][part..]) * inverse;
                }
                numbers[5] = L::load(&distance[part..]) * inverse;
                let mut at = 0;
                for i in 0..6 {
                    for j in 0..=i {
                        own[at] = numbers[i].fused(numbers[j], own[at]);
                        at += 1;
                    }
                }
            }
            for k in 0..PRODUCTS {
                own[k].store(&mut sums[k][part..]);
            }
            part += L::N;
        }
        let mut out = [0.0; PRODUCTS];
        for k in 0..PRODUCTS {
            out[k] = lanes::sum(&sums[k]);
        }
        out
    }
}

impl Feet {
    /// Finds the feet of points, px, within the radius of curvature of the contour.
    pub(crate) fn find(&mut self, e: &Ellipse, u_px: &[f64], v_px: &[f64]) {
        lanes::run(Find { frame: Frame::new(e), u: u_px, v: v_px, out: self });
    }

    /// Cosine and sine of the eccentric angle of the feet that were found last, a group of points each.
    pub(crate) fn directions(&self) -> &[[[f64; GROUP]; 2]] {
        &self.direction
    }

    /// Normal equations of the points, whose feet were found last, with these sigmas, px.
    pub(crate) fn normal(&self, sigma_px: &[f64]) -> Normal {
        let products = lanes::run(Products { feet: self, sigma_px });
        let of = |i: usize, j: usize| products[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)];
        Normal { matrix: SMatrix::from_fn(of), gradient: SVector::from_fn(|i, _| of(5, i)), chi2: of(5, 5) }
    }

    /// By how much the covariances of the regular coordinates and of `(u0, v0, a, b, phi)` grow as the sigmas of the points, whose feet on `e` were
    /// found last, grow from `before_px` to those of the equations: never by a negative variance, as `(J^T W J)^-1` falls with W and both are
    /// turned alike.
    pub(crate) fn growth(&self, e: &Ellipse, grown: &Normal, before_px: &[f64]) -> Option<[SMatrix<f64, 5, 5>; 2]> {
        let (whole, before) =
            (inverse_of_positive(&grown.matrix)?, inverse_of_positive(&self.normal(before_px).matrix)?);
        let by = parameters_by_regular(&to_regular(e), &whole);
        let regular = whole - before;
        Some([regular, by * regular * by.transpose()])
    }

    /// Derivatives of the distances of the points, whose feet were found last, over their sigmas, px.
    pub(super) fn whitened_rows(&self, sigma_px: &[f64]) -> Vec<[f64; 5]> {
        let row = |(k, sigma): (usize, &f64)| self.rows[k / GROUP].map(|x| x[k % GROUP] / sigma);
        sigma_px.iter().enumerate().map(row).collect()
    }

    /// How what a smooth lens makes of a circle moves the points, whose feet on `e` were found last, over their sigmas, px.
    pub(super) fn whitened_bends(&self, e: &Ellipse, sigma_px: &[f64]) -> Vec<[f64; 4]> {
        let frame = Frame::new(e);
        let bends = |(k, sigma): (usize, &f64)| {
            let [cos, sin] = self.direction[k / GROUP].map(|x| x[k % GROUP]);
            frame.bends_at(cos, sin).map(|x| x / sigma)
        };
        sigma_px.iter().enumerate().map(bends).collect()
    }

    /// The ellipse through the points, from `e`, on which their feet were found last, with the normal equations there; none where a few steps do
    /// not lead there.
    pub(crate) fn refit(
        &mut self,
        e: &Ellipse,
        u_px: &[f64],
        v_px: &[f64],
        sigma_px: &[f64],
    ) -> Option<(Ellipse, Normal)> {
        let mut ellipse = *e;
        let mut normal = self.normal(sigma_px);
        for _ in 0..MOST_STEPS {
            let step = normal.matrix.cholesky()?.solve(&normal.gradient);
            let promised = step.dot(&normal.gradient);
            ellipse = from_regular(&(to_regular(&ellipse) - step))?;
            self.find(&ellipse, u_px, v_px);
            let next = self.normal(sigma_px);
            if !(next.chi2 <= normal.chi2 * (1.0 + 1e-9)) {
                return None;
            }
            normal = next;
            if promised < STILL * (1.0 + normal.chi2) {
                return Some((ellipse, normal));
            }
        }
        None
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::{covariance_from_regular, fit_geometric_from};
    use crate::frames::Pixel;

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
                (0..5).for_each(|i| assert!((feet.rows[k / GROUP][i][k % GROUP] - plain.row[i]).abs() < 1e-4));
            }
            let (found, normal) = feet.refit(&e, &u, &v, &sigma).expect("a fit");
            let regular = normal.matrix.cholesky().expect("a covariance").inverse();
            let covariance = covariance_from_regular(&to_regular(&found), &regular);
            let plain = fit_geometric_from(&e, &u, &v, &sigma).expect("a fit");
            let gap = (to_regular(&found) - to_regular(&plain.ellipse)).norm();
            assert!(gap < 1e-5, "{a} {b}: {gap} px");
            for i in 0..4 {
                assert!((covariance[(i, i)] / plain.covariance[(i, i)] - 1.0).abs() < 1e-3);
            }
        }
    }
}
