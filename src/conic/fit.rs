//! Ellipses through points.
//!
//! Direct: minimise the algebraic distance `sum (a u^2 + b u v + c v^2 + d u + e v + f)^2` under `4 a c - b^2 = 1`, by the split of
//! Halir and Flusser (1998), on points shifted and scaled to unit size. Biased towards small ellipses under noise: a start.
//!
//! Geometric: minimise `sum (d_i / sigma_i)^2` over the orthogonal distances `d_i` by Levenberg-Marquardt in the regular
//! coordinates `(u0, v0, (a+b)/2, e1, e2)` of [`crate::conic`]. With `n` the outward normal at the foot `(a cos t, b sin t)`:
//! `dd/d(u0, v0) = -n`, `dd/da = -n_x cos t`, `dd/db = -n_y sin t`, `dd/dphi = -(a^2 - b^2) cos t sin t / N`.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | d_i | `distance` | 1 | px | orthogonal distance of point i |
//! | sigma_i | `sigma_px` | 1 | px | its standard deviation |
//! | J^T W J | `normal` | 5 x 5 | 1/px^2 | normal matrix; its inverse is the covariance |
//!
//! Not valid for fewer than 6 points (5 leave no redundancy for a covariance that means something) or points on a line.

use crate::conic::{
    CommonNoise, Ellipse, Frame, covariance_from_regular, from_regular, inverse_of_positive, to_regular,
};
use crate::error::{Insufficient, Invalid, Result};
use crate::frames::Pixel;
use crate::lanes::{self, GROUP, Kernel, Lanes};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// An ellipse fitted to points, with what the fit knows about itself.
#[derive(Debug, Clone, PartialEq)]
pub struct EllipseFit {
    /// The ellipse.
    pub ellipse: Ellipse,
    /// Covariance of `(u0, v0, a, b, phi)` that follows from the sigmas given (not scaled by the residuals).
    pub covariance: SMatrix<f64, 5, 5>,
    /// Sum of squared distances over their sigmas.
    pub chi2: f64,
    /// Points minus five.
    pub degrees_of_freedom: usize,
    /// Root mean square of the orthogonal distances, px.
    pub rms_px: f64,
}

/// Direct least-squares ellipse through points (px); a starting value without iteration.
///
/// # Errors
/// [`Invalid::Value`] where the slices differ in length or hold numbers that are not finite;
/// [`Insufficient::Degenerate`] for fewer than 5 points or points that lie on a line.
pub fn fit_direct(u_px: &[f64], v_px: &[f64]) -> Result<Ellipse> {
    check_points(u_px, v_px, 5)?;
    let n = u_px.len() as f64;
    let mean = [u_px, v_px].map(|x| x.iter().sum::<f64>() / n);
    let moments = lanes::run(Moments { u_px, v_px, mean });
    let scale = ((moments[degree(2)] + moments[degree(2) + 2]) / (2.0 * n)).sqrt();
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(degenerate("all points coincide").into());
    }
    let mut of = [1.0; MOMENTS];
    for d in 1..=4 {
        (degree(d)..degree(d + 1)).for_each(|k| of[k] = moments[k] / (n * scale.powi(d as i32)));
    }
    let [_, x, y, xx, xy, yy, xxx, xxy, xyy, yyy, xxxx, xxxy, xxyy, xyyy, yyyy] = of;
    let s1 = Matrix3::new(xxxx, xxxy, xxyy, xxxy, xxyy, xyyy, xxyy, xyyy, yyyy);
    let s2 = Matrix3::new(xxx, xxy, xx, xxy, xyy, xy, xyy, yyy, yy);
    let s3 = Matrix3::new(xx, xy, x, xy, yy, y, x, y, 1.0);
    let q = halir_flusser(&s1, &s2, &s3).ok_or_else(|| degenerate("the points lie on a line"))?;
    let unit = Matrix3::new(q[0], q[1] / 2.0, q[3] / 2.0, q[1] / 2.0, q[2], q[4] / 2.0, q[3] / 2.0, q[4] / 2.0, q[5]);
    let e = Ellipse::from_matrix(&unit)?;
    let center = Pixel::new(mean[0] + scale * e.center_px.u_px, mean[1] + scale * e.center_px.v_px);
    Ellipse::new(center, scale * e.semi_major_px, scale * e.semi_minor_px, e.angle_rad)
}

/// Sums of `x^p y^q`, `p + q <= 4`, over points, by degree and in each by q; x and y from the mean, px.
#[derive(Clone)]
struct Moments<'a> {
    u_px: &'a [f64],
    v_px: &'a [f64],
    mean: [f64; 2],
}

/// How many there are.
const MOMENTS: usize = degree(5);

/// Where those of a degree begin.
const fn degree(d: usize) -> usize {
    d * (d + 1) / 2
}

#[inline(always)]
fn add_point<L: Lanes>(sums: &mut [L; MOMENTS], x: L, y: L) {
    let (xx, xy, yy, one) = (x * x, x * y, y * y, L::splat(1.0));
    let factors = [
        [one, one],
        [x, one],
        [y, one],
        [x, x],
        [x, y],
        [y, y],
        [xx, x],
        [xx, y],
        [yy, x],
        [yy, y],
        [xx, xx],
        [xx, xy],
        [xx, yy],
        [xy, yy],
        [yy, yy],
    ];
    for k in degree(1)..MOMENTS {
        sums[k] = factors[k][0].fused(factors[k][1], sums[k]);
    }
}

impl Kernel for Moments<'_> {
    type Output = [f64; MOMENTS];
    #[inline(always)]
    fn run<L: Lanes>(self) -> [f64; MOMENTS] {
        let n = self.u_px.len();
        let whole = n / GROUP * GROUP;
        // What only fills the last group lies at the mean.
        let (mut u, mut v) = ([self.mean[0]; GROUP], [self.mean[1]; GROUP]);
        u[..n - whole].copy_from_slice(&self.u_px[whole..]);
        v[..n - whole].copy_from_slice(&self.v_px[whole..]);
        let mean = lanes::splats::<L, 2>(self.mean);
        let mut sums = [[0.0; GROUP]; MOMENTS];
        // Part by part of the groups, so that the sums stay in registers.
        let mut part = 0;
        while part < GROUP {
            let mut of_part = [L::splat(0.0); MOMENTS];
            for from in (0..whole).step_by(GROUP) {
                let (u, v) = (L::load(&self.u_px[from + part..]), L::load(&self.v_px[from + part..]));
                add_point(&mut of_part, u - mean[0], v - mean[1]);
            }
            add_point(&mut of_part, L::load(&u[part..]) - mean[0], L::load(&v[part..]) - mean[1]);
            for k in degree(1)..MOMENTS {
                of_part[k].store(&mut sums[k][part..]);
            }
            part += L::N;
        }
        let mut out = [n as f64; MOMENTS];
        for k in degree(1)..MOMENTS {
            out[k] = lanes::sum(&sums[k]);
        }
        out
    }
}

/// The six coefficients that minimise the algebraic distance, from the blocks of the scatter matrix.
fn halir_flusser(s1: &Matrix3<f64>, s2: &Matrix3<f64>, s3: &Matrix3<f64>) -> Option<SVector<f64, 6>> {
    let t = -(s3.try_inverse()? * s2.transpose());
    let mut reduced = s1 + s2 * t;
    reduced = 0.5 * (reduced + reduced.transpose());
    // Points exactly on an ellipse make the matrix singular; the ridge is far below any noise.
    reduced += Matrix3::identity() * (1e-15 * s1.trace());
    let lower = reduced.cholesky()?.l();
    let lower_inverse = lower.try_inverse()?;
    let constraint = Matrix3::new(0.0, 0.0, 2.0, 0.0, -1.0, 0.0, 2.0, 0.0, 0.0);
    let a1 = lower_inverse.transpose() * positive_vector(&(lower_inverse * constraint * lower_inverse.transpose()))?;
    let a2 = t * a1;
    Some(SVector::from([a1[0], a1[1], a1[2], a2[0], a2[1], a2[2]]))
}

/// Newton steps for an eigenvalue at most.
const MOST_ROOT_STEPS: usize = 60;

/// Eigenvector, of no certain length, of the largest eigenvalue of a symmetric matrix with one positive eigenvalue; none where there is none.
///
/// ```text
/// lambda: largest root of x^3 - t x^2 + m x - d,   t trace, m sum of the principal minors, d determinant
/// ```
///
/// by Newton's steps from `t/3 + (2/3)^(1/2) |M - t/3|`, not below it (Wolkowicz and Styan, "Bounds for eigenvalues using traces", 1980): from there they fall,
/// and never pass the root, as all three are real. The columns of the adjugate of `M - lambda` are multiples of the vector.
fn positive_vector(m: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let (t, d) = (m.trace(), m.determinant());
    let minors = 0.5 * (t * t - m.component_mul(m).sum());
    let mut x = t / 3.0 + (m - Matrix3::identity() * (t / 3.0)).norm() * (2.0_f64 / 3.0).sqrt();
    for _ in 0..MOST_ROOT_STEPS {
        let (value, slope) = (((x - t) * x + minors) * x - d, (3.0 * x - 2.0 * t) * x + minors);
        let next = x - value / slope;
        // It falls until rounding ends it.
        if !(next < x * (1.0 - 4.0 * f64::EPSILON)) {
            break;
        }
        x = next;
    }
    if !(x > 0.0 && x.is_finite()) {
        return None;
    }
    let [a, b, c] = [0, 1, 2].map(|k| m.column(k) - Vector3::ith(k, x));
    [a.cross(&b), b.cross(&c), c.cross(&a)].into_iter().max_by(|p, q| p.norm_squared().total_cmp(&q.norm_squared()))
}

impl EllipseFit {
    /// With the covariance that follows where the points that it was fitted to have something in common.
    pub(crate) fn with_common(mut self, [u_px, v_px, sigma_px]: [&[f64]; 3], common: &CommonNoise) -> Option<Self> {
        if common.is_none() {
            return Some(self);
        }
        let frame = Frame::new(&self.ellipse);
        let row = |i: usize| frame.foot(u_px[i], v_px[i], None).row.map(|x| x / sigma_px[i]);
        let mut rows: Vec<[f64; 5]> = (0..u_px.len()).map(row).collect();
        common.apply(&mut rows);
        let normal: SMatrix<f64, 5, 5> = rows.iter().map(|row| SVector::from(*row)).map(|x| x * x.transpose()).sum();
        self.covariance = covariance_from_regular(&to_regular(&self.ellipse), &inverse_of_positive(&normal)?);
        Some(self)
    }
}

/// Orthogonal-distance ellipse through points (px) with standard deviations (px) normal to the contour.
///
/// # Errors
/// [`Invalid::Value`] where the slices differ in length, numbers are not finite, or a sigma is not positive;
/// [`Insufficient::Degenerate`] for fewer than 6 points or points that do not fix an ellipse.
pub fn fit_geometric(u_px: &[f64], v_px: &[f64], sigma_px: &[f64]) -> Result<EllipseFit> {
    let start = fit_direct(u_px, v_px)?;
    fit_geometric_from(&start, u_px, v_px, sigma_px)
}

/// [`fit_geometric`] from a known start.
pub(crate) fn fit_geometric_from(start: &Ellipse, u_px: &[f64], v_px: &[f64], sigma_px: &[f64]) -> Result<EllipseFit> {
    check_points(u_px, v_px, 6)?;
    if sigma_px.len() != u_px.len() {
        return Err(Invalid::value("sigmas", sigma_px.len() as f64, format!("one per point ({})", u_px.len())).into());
    }
    if let Some(bad) = sigma_px.iter().find(|s| !(**s > 0.0 && s.is_finite())) {
        return Err(Invalid::value("sigma of an edge point (px)", *bad, "a positive number").into());
    }
    let mut q = to_regular(start);
    let mut ellipse = *start;
    let (mut normal, mut gradient, mut chi2) = normal_equations(&ellipse, u_px, v_px, sigma_px);
    let mut damping = 1e-6;
    for _ in 0..60 {
        let mut damped = normal;
        for i in 0..5 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = damped.cholesky().ok_or_else(|| degenerate("the points do not fix an ellipse"))?.solve(&gradient);
        let decrement = step.dot(&gradient);
        let tried = from_regular(&(q - step)).map(|e| (e, normal_equations(&e, u_px, v_px, sigma_px)));
        match tried {
            Some((e, next)) if next.2 <= chi2 * (1.0 + 1e-12) => {
                q -= step;
                ellipse = e;
                (normal, gradient, chi2) = next;
                damping = (damping * 0.1).max(1e-12);
                if decrement.abs() < 1e-14 * (1.0 + chi2) {
                    break;
                }
            }
            _ if decrement.abs() < 1e-12 * (1.0 + chi2) => break,
            _ => damping = (damping * 10.0).max(1e-3),
        }
        if damping > 1e12 {
            break;
        }
    }
    let regular = inverse_of_positive(&normal).ok_or_else(|| degenerate("the points do not fix an ellipse"))?;
    let frame = Frame::new(&ellipse);
    let distance = |(u, v): (&f64, &f64)| {
        let p = Pixel::new(*u, *v);
        // Near the contour Newton steps are enough.
        if ellipse.implicit(p).abs() < 0.5 { frame.foot(*u, *v, None).distance } else { ellipse.distance_px(p) }
    };
    let squares: f64 = u_px.iter().zip(v_px).map(|p| distance(p).powi(2)).sum();
    Ok(EllipseFit {
        ellipse,
        covariance: covariance_from_regular(&q, &regular),
        chi2,
        degrees_of_freedom: u_px.len() - 5,
        rms_px: (squares / u_px.len() as f64).sqrt(),
    })
}

/// `(J^T W J, J^T W d, chi2)` over all points, in regular coordinates.
fn normal_equations(
    e: &Ellipse,
    u_px: &[f64],
    v_px: &[f64],
    sigma_px: &[f64],
) -> (SMatrix<f64, 5, 5>, SVector<f64, 5>, f64) {
    let (mut normal, mut gradient, mut chi2) = (SMatrix::<f64, 5, 5>::zeros(), SVector::<f64, 5>::zeros(), 0.0);
    let frame = Frame::new(e);
    for i in 0..u_px.len() {
        let p = Pixel::new(u_px[i], v_px[i]);
        // Far from the contour Newton steps may end on the wrong side; there the bracketed search sets the start.
        let near = if e.implicit(p).abs() < 0.5 { None } else { Some(e.closest_angle_rad(p).sin_cos()) };
        let foot = frame.foot(p.u_px, p.v_px, near.map(|(s, c)| (c, s)));
        let row = SVector::<f64, 5>::from(foot.row) / sigma_px[i];
        let distance = foot.distance / sigma_px[i];
        normal += row * row.transpose();
        gradient += row * distance;
        chi2 += distance * distance;
    }
    (normal, gradient, chi2)
}

fn check_points(u_px: &[f64], v_px: &[f64], needed: usize) -> Result<()> {
    if u_px.len() != v_px.len() {
        return Err(Invalid::value("points", v_px.len() as f64, format!("as many v as u ({})", u_px.len())).into());
    }
    // All at once first: a search ends at every point.
    let finite = |x: &[f64]| x.iter().fold(true, |all, x| all & x.is_finite());
    if !(finite(u_px) && finite(v_px)) {
        let bad = u_px.iter().chain(v_px).find(|x| !x.is_finite()).unwrap_or(&f64::NAN);
        return Err(Invalid::value("edge point (px)", *bad, "a finite number").into());
    }
    if u_px.len() < needed {
        return Err(degenerate(&format!("{} points, at least {needed} are needed", u_px.len())).into());
    }
    Ok(())
}

fn degenerate(why: &str) -> Insufficient {
    Insufficient::Degenerate(format!("no ellipse through the points: {why}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    /// Against the vectors that matrices are made of, with one positive eigenvalue, as the constraint has, or none, from alike to twelve powers of ten apart.
    #[test]
    fn the_positive_vector_is_that_of_the_largest_eigenvalue() {
        let mut random = Random(11);
        let (mut positive, mut sharp) = (0, 0);
        for k in 0..400 {
            let turn = Matrix3::from_fn(|_, _| random.gauss()).qr().q();
            let values = Vector3::from_fn(|i, _| {
                let size = 10.0_f64.powf(f64::from(k % 5) * 3.0 * (random.gauss().abs().min(1.0) - 0.5));
                if i == k as usize % 3 { size } else { -size }
            });
            let values = if k % 11 == 0 { values.map(|x| -x.abs()) } else { values };
            let m = turn * Matrix3::from_diagonal(&values) * turn.transpose();
            let m = 0.5 * (m + m.transpose());
            let best = values.imax();
            let Some(found) = positive_vector(&m) else {
                assert!(values[best] < 1e-12 * values.amax(), "{values}");
                continue;
            };
            positive += 1;
            let gap = (0..3).filter(|i| *i != best).map(|i| values[best] - values[i]).fold(f64::INFINITY, f64::min);
            let off = found.normalize().cross(&turn.column(best)).norm();
            // What rounding of the matrix does to its vectors.
            let limit = 1e-13 * values.amax() / gap * (1.0 + values.amax() / gap);
            sharp += usize::from(limit < 1e-9);
            assert!(off < limit, "{off} of {values}");
        }
        assert!(positive > 300 && sharp > 200, "{positive} {sharp}");
    }

    /// Against plain sums, with a last group that is not full; alike in all widths.
    #[test]
    fn moments_are_those_of_plain_sums() {
        let u_px: Vec<f64> = (0..21).map(|k| 300.0 + 12.0 * (0.3 * f64::from(k)).cos()).collect();
        let v_px: Vec<f64> = (0..21).map(|k| 200.0 + 7.0 * (0.3 * f64::from(k)).sin()).collect();
        let found = lanes::run_all(&Moments { u_px: &u_px, v_px: &v_px, mean: [301.0, 200.5] });
        assert!(found.iter().all(|x| *x == found[0]));
        for d in 0..=4 {
            for q in 0..=d {
                let power = |(u, v): (&f64, &f64)| (u - 301.0).powi((d - q) as i32) * (v - 200.5).powi(q as i32);
                let (plain, size) =
                    u_px.iter().zip(&v_px).map(power).fold((0.0, 0.0), |(a, b), x| (a + x, b + x.abs()));
                assert!((found[0][degree(d) + q] - plain).abs() < 1e-13 * size, "{d} {q}");
            }
        }
    }
}
