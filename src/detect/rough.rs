//! How much rougher a contour is than the noise of its grey values explains.

mod long_waves;
mod of_image;

use crate::conic::{Ellipse, Feet, fit_geometric_from};
use crate::detect::{Disc, EdgePoints};
use crate::lanes::{self, GROUP, Kernel, Lanes};
use long_waves::Waves;
use nalgebra::{SMatrix, SVector};
pub(crate) use of_image::roughen_all;

/// Harmonics along the contour that a smooth lens may explain: 3 to this.
const SMOOTH: usize = 5;
/// Coefficients of these and of the lower ones: 1, then cosine and sine of each.
const N: usize = 2 * SMOOTH + 1;
/// Numbers of the harmonics up to twice that, which products of two make.
const TWICE: usize = 4 * SMOOTH + 1;

/// What one contour says of its roughness.
#[derive(Debug, Clone, Copy)]
struct Said {
    /// Variance that takes chi-square to the degrees of freedom, px^2; negative where noise alone takes it below.
    excess_px2: f64,
    /// Variance of an edge point by noise, harmonic mean, px^2.
    noise_px2: f64,
    freedom: f64,
    waves: Waves,
}

/// A number that is not negative, from one with this variance.
fn shrunk(x: f64, variance: f64) -> f64 {
    if x > 0.0 { (x - variance / x).max(0.0) } else { 0.0 }
}

/// Harmonics of the eccentric angle, times `b / |t|` as a smooth lens makes them (`Frame::bends_at`), at points whose feet were found last.
#[derive(Clone, Copy)]
struct Harmonics<'a> {
    axes_px: [f64; 2],
    feet: &'a Feet,
}

impl Harmonics<'_> {
    /// Cosine, sine and `b / |t|` of some points of a group.
    #[inline(always)]
    fn at<L: Lanes>(&self, group: usize, part: usize) -> [L; 3] {
        let [c, s] = self.feet.directions()[group];
        let (c, s) = (L::load(&c[part..]), L::load(&s[part..]));
        let (along, across) = (L::splat(self.axes_px[0]) * s, L::splat(self.axes_px[1]) * c);
        [c, s, L::splat(self.axes_px[1]) / along.fused(along, across * across).sqrt()]
    }
}

/// Sums over the points: of the harmonics up to twice those of a lens times `(b / |t|)^2`, and of those of a lens times `b / |t|` and the distance.
#[derive(Clone)]
struct Sums<'a>(Harmonics<'a>);

impl Kernel for Sums<'_> {
    type Output = ([f64; TWICE], [f64; N]);
    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let Self(harmonics) = self;
        let all = &harmonics.feet.distance;
        let (mut squares, mut right) = ([[0.0; GROUP]; TWICE], [[0.0; GROUP]; N]);
        for (group, here) in all.chunks(GROUP).enumerate() {
            // What only fills the last group has no weight.
            let (mut distance, mut counts) = ([0.0; GROUP], [0.0; GROUP]);
            distance[..here.len()].copy_from_slice(here);
            counts[..here.len()].fill(1.0);
            let mut part = 0;
            while part < GROUP {
                let [c, s, share] = harmonics.at::<L>(group, part);
                let weight = share * share * L::load(&counts[part..]);
                let moved = share * L::load(&distance[part..]);
                let (mut cm, mut sm) = (L::splat(1.0), L::splat(0.0));
                add(&mut squares[0][part..], weight, cm);
                add(&mut right[0][part..], moved, cm);
                for m in 1..=2 * SMOOTH {
                    (cm, sm) = (cm * c - sm * s, sm * c + cm * s);
                    add(&mut squares[2 * m - 1][part..], weight, cm);
                    add(&mut squares[2 * m][part..], weight, sm);
                    if m <= SMOOTH {
                        add(&mut right[2 * m - 1][part..], moved, cm);
                        add(&mut right[2 * m][part..], moved, sm);
                    }
                }
                part += L::N;
            }
        }
        let mut out = ([0.0; TWICE], [0.0; N]);
        for k in 0..TWICE {
            out.0[k] = lanes::sum(&squares[k]);
        }
        for k in 0..N {
            out.1[k] = lanes::sum(&right[k]);
        }
        out
    }
}

#[inline(always)]
fn add<L: Lanes>(sum: &mut [f64], a: L, b: L) {
    a.fused(b, L::load(sum)).store(sum);
}

/// Distances less the harmonics with these coefficients; those of the last group filled up.
#[derive(Clone)]
struct Left<'a> {
    harmonics: Harmonics<'a>,
    coefficients: &'a [f64; N],
}

impl Kernel for Left<'_> {
    type Output = Vec<f64>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Vec<f64> {
        let mut left = self.harmonics.feet.distance.clone();
        left.resize(left.len().div_ceil(GROUP) * GROUP, 0.0);
        for at in (0..left.len()).step_by(L::N) {
            let [c, s, share] = self.harmonics.at::<L>(at / GROUP, at % GROUP);
            let (mut cm, mut sm, mut sum) = (L::splat(1.0), L::splat(0.0), L::splat(self.coefficients[0]));
            for m in 1..=SMOOTH {
                (cm, sm) = (cm * c - sm * s, sm * c + cm * s);
                sum = cm.fused(L::splat(self.coefficients[2 * m - 1]), sum);
                sum = sm.fused(L::splat(self.coefficients[2 * m]), sum);
            }
            (L::load(&left[at..]) - share * sum).store(&mut left[at..]);
        }
        left
    }
}

/// Sums of products of the harmonics `i` and `j` from those of single harmonics: `2 cos m cos n = cos(m - n) + cos(m + n)` and the like.
fn product(sums: &[f64; TWICE], i: usize, j: usize) -> f64 {
    let cos = |m: usize| if m == 0 { sums[0] } else { sums[2 * m - 1] };
    let sin = |m: usize| if m == 0 { 0.0 } else { sums[2 * m] };
    let (m, n) = (i.div_ceil(2), j.div_ceil(2));
    let of_sines = |k: usize| k > 0 && k.is_multiple_of(2);
    let apart = m.abs_diff(n);
    0.5 * match (of_sines(i), of_sines(j)) {
        (false, false) => cos(apart) + cos(m + n),
        (true, true) => cos(apart) - cos(m + n),
        (true, false) => sin(m + n) + if m < n { -sin(apart) } else { sin(apart) },
        (false, true) => sin(m + n) + if n < m { -sin(apart) } else { sin(apart) },
    }
}

/// Edge points, whose feet were found last, less what is no roughness.
struct Bent {
    /// Distances, px.
    distance: Vec<f64>,
    /// Degrees of freedom.
    freedom: f64,
    /// Harmonics along the contour that were taken off: up to this.
    smooth: usize,
}

/// Distances of the edge points, whose feet were found last, from the ellipse without the low harmonics along the contour that a smooth lens
/// explains; of few points with these, but for those of the ellipse.
fn without_smooth_bends(ellipse: &Ellipse, feet: &Feet) -> Bent {
    let n = feet.distance.len();
    let plain = || Bent { distance: feet.distance.clone(), freedom: (n as f64 - 5.0).max(1.0), smooth: 2 };
    if n < 4 * N {
        return plain();
    }
    let harmonics = Harmonics { axes_px: [ellipse.semi_major_px, ellipse.semi_minor_px], feet };
    let (sums, right) = lanes::run(Sums(harmonics));
    let matrix = SMatrix::<f64, N, N>::from_fn(|i, j| product(&sums, i, j));
    let Some(factor) = matrix.cholesky() else { return plain() };
    let coefficients = factor.solve(&SVector::from(right)).into();
    let mut distance = lanes::run(Left { harmonics, coefficients: &coefficients });
    distance.truncate(n);
    Bent { distance, freedom: (n - N) as f64, smooth: SMOOTH }
}

/// What the contour of a disc says of its roughness: the variance that, added to those of its edge points, makes their chi-square the number of degrees
/// of freedom, and where noise alone is more than enough by how much.
fn said(disc: &Disc, feet: &mut Feet) -> Said {
    let EdgePoints { u_px, v_px, sigma_px } = &disc.edge;
    feet.find(&disc.ellipse, u_px, v_px);
    said_by(&disc.ellipse, sigma_px, feet)
}

/// The same of edge points, px, whose feet were found last.
fn said_by(ellipse: &Ellipse, sigma_px: &[f64], feet: &Feet) -> Said {
    let bent = without_smooth_bends(ellipse, feet);
    let noise_px2 = sigma_px.len() as f64 / sigma_px.iter().map(|s| 1.0 / (s * s)).sum::<f64>();
    let of_noise = chi2(&bent.distance, sigma_px, 0.0)[0];
    let excess_px2 =
        if of_noise <= bent.freedom { (of_noise / bent.freedom - 1.0) * noise_px2 } else { added_for(&bent, sigma_px) };
    let waves = Waves::of(ellipse, &bent, sigma_px, feet);
    Said { excess_px2, noise_px2, freedom: bent.freedom, waves }
}

/// Chi-square of distances with a variance more for each, px^2, and its slope.
fn chi2(distance_px: &[f64], sigma_px: &[f64], more_px2: f64) -> [f64; 2] {
    let (mut sum, mut slope) = (0.0, 0.0);
    for (d, sigma) in distance_px.iter().zip(sigma_px) {
        let w = 1.0 / (sigma * sigma + more_px2);
        let term = d * d * w;
        sum += term;
        slope -= term * w;
    }
    [sum, slope]
}

/// The variance that takes chi-square down to the degrees of freedom, px^2. It falls and bends upwards, so that Newton steps from zero never pass the root.
fn added_for(bent: &Bent, sigma_px: &[f64]) -> f64 {
    let mut x = 0.0;
    for _ in 0..60 {
        let [sum, slope] = chi2(&bent.distance, sigma_px, x);
        if sum <= bent.freedom || !(slope < 0.0) {
            break;
        }
        let step = (bent.freedom - sum) / slope;
        x += step;
        if step < 1e-10 * x {
            break;
        }
    }
    x
}

/// Adds a variance, px^2, to those of the edge points, whose feet on `e` were found last: the ellipse through them with these sigmas, and what
/// the variance adds to the covariances of its regular coordinates and of `(u0, v0, a, b, phi)`. All covariances are about the ellipse that is
/// returned, so that what is added is positive semidefinite, as `(J^T W J)^-1` is for a smaller W; none where the points fix no ellipse.
fn roughen(
    e: &Ellipse,
    edge: &mut EdgePoints,
    variance_px2: f64,
    feet: &mut Feet,
) -> Option<(Ellipse, [SMatrix<f64, 5, 5>; 2])> {
    let plain_px = edge.sigma_px.clone();
    edge.sigma_px.iter_mut().for_each(|s| *s = (*s * *s + variance_px2).sqrt());
    let (ellipse, normal) = match feet.refit(e, &edge.u_px, &edge.v_px, &edge.sigma_px) {
        Some(found) => found,
        None => {
            let ellipse = fit_geometric_from(e, &edge.u_px, &edge.v_px, &edge.sigma_px).ok()?.ellipse;
            feet.find(&ellipse, &edge.u_px, &edge.v_px);
            (ellipse, feet.normal(&edge.sigma_px))
        }
    };
    let added = feet.growth(&ellipse, &normal, &plain_px)?;
    Some((ellipse, added))
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::{Frame, covariance_from_regular, to_regular};
    use crate::frames::Pixel;
    use crate::stats::random::Random;
    use nalgebra::{DMatrix, DVector};

    /// Sixty points so far from an ellipse, px, as if their feet had been found.
    fn off(e: &Ellipse, distance: &dyn Fn(i32) -> f64) -> Feet {
        let (u, v): (Vec<f64>, Vec<f64>) =
            (0..60).map(|k| e.point(0.1 * f64::from(k))).map(|p| (p.u_px, p.v_px)).unzip();
        let mut feet = Feet::default();
        feet.find(e, &u, &v);
        feet.distance = (0..60).map(distance).collect();
        feet
    }

    /// Against a plain fit of the harmonics themselves, of a contour that bends and is rough; alike in all widths.
    #[test]
    fn what_a_smooth_lens_explains_is_a_plain_least_squares_fit() {
        let e = Ellipse { center_px: Pixel::new(5.0, 4.0), semi_major_px: 17.0, semi_minor_px: 9.0, angle_rad: 0.3 };
        let feet = off(&e, &|k| 0.03 * (0.3 * f64::from(k)).sin() + 0.02 * f64::from((k * 29) % 13 - 6));
        let rows = DMatrix::from_fn(60, N, |k, i| {
            let (s, c) = (0.1 * k as f64).sin_cos();
            let angle = i.div_ceil(2) as f64 * 0.1 * k as f64;
            let share = e.semi_minor_px / (e.semi_minor_px * c).hypot(e.semi_major_px * s);
            share * if i > 0 && i.is_multiple_of(2) { angle.sin() } else { angle.cos() }
        });
        let distance = DVector::from_column_slice(&feet.distance);
        let found = rows.clone().svd(true, true).solve(&distance, 1e-12).expect("a fit");
        let bent = without_smooth_bends(&e, &feet);
        assert_eq!(bent.freedom, 49.0);
        let left = DVector::from(bent.distance.clone());
        assert!((&left - (distance - rows * found)).amax() < 1e-10);
        let harmonics = Harmonics { axes_px: [e.semi_major_px, e.semi_minor_px], feet: &feet };
        let sums = lanes::run_all(&Sums(harmonics));
        let left = lanes::run_all(&Left { harmonics, coefficients: &sums[0].1 });
        assert!(sums.iter().all(|x| *x == sums[0]) && left.iter().all(|x| *x == left[0]));
    }

    /// Against its definition, with sigmas that are too small in part.
    #[test]
    fn with_the_roughness_chi2_is_the_freedom() {
        let e = Ellipse { center_px: Pixel::new(0.0, 0.0), semi_major_px: 13.0, semi_minor_px: 11.0, angle_rad: 0.2 };
        for (size, rough) in [(0.03, true), (0.004, false)] {
            let sigma: Vec<f64> = (0..60).map(|k| 0.01 * f64::from(1 + k % 4)).collect();
            let feet = off(&e, &|k| size * f64::from((k * 29) % 13 - 6) / 6.0);
            let x = said_by(&e, &sigma, &feet).excess_px2;
            let Bent { distance, freedom, .. } = without_smooth_bends(&e, &feet);
            let chi2: f64 = distance.iter().zip(&sigma).map(|(d, s)| d * d / (s * s + x.max(0.0))).sum();
            assert_eq!(x > 0.0, rough);
            let noise = 60.0 / sigma.iter().map(|s| s.powi(-2)).sum::<f64>();
            let wanted = if rough { freedom } else { freedom * (1.0 + x / noise) };
            assert!((chi2 / wanted - 1.0).abs() < 1e-9, "{chi2} {wanted}");
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
            let Some((ellipse, [_, added])) = roughen(&e, &mut edge, 0.003, &mut feet) else { continue };
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
