//! Light that all discs of one image stand in.
//!
//! A small disc cannot tell a slope of the light from a shift of its own: with slopes set free the centre of a disc of 6 px is known a third
//! worse (Fisher information), and slopes too weak to be seen on one disc shift it by a few thousandths of a px, alike in every image, which passes
//! for distortion. But the levels of many discs, and of the ground around them, tell the light of the image, a polynomial of the place
//!
//! ```text
//! L(x, y) = sum c_ij x^i y^j,   i + j <= 3, of few discs <= 1
//! ```
//!
//! on either side, and its gradient is what the fit of a single disc expects.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | g_in, g_out | `slopes` | grey/px | gradient of the light inside and outside, along u and v |
//! | c_ij | `Polynomial::coefficients` | grey | of `x`, `y`, half the longer side of the image from its centre |
//!
//! Where the light is even, or not a polynomial, nothing is expected.

use crate::conic::Ellipse;
use crate::detect::candidate::Candidate;
use crate::frames::Pixel;
use crate::image::GrayView;
use nalgebra::{SMatrix, SVector};

/// Discs from which a plane and the whole polynomial are told; fewer tell nothing.
const LEAST_DISCS: usize = 12;
const MANY_DISCS: usize = 40;
/// By how much the polynomial must lessen the variance of the levels: less is noise, or light of another kind.
const TOLD: f64 = 4.0;
/// Rounds of leaving out what is no level (marks, dirt), and their limit in standard deviations.
const ROUNDS: usize = 4;
const CLIP: f64 = 4.0;
/// Directions in which levels are looked at: every 30 degrees, opposite ones in pairs.
const DIRECTIONS: [[f64; 2]; 6] = [[1.0, 0.0], [ROOT, 0.5], [0.5, ROOT], [0.0, 1.0], [-0.5, ROOT], [-ROOT, 0.5]];
const ROOT: f64 = 0.866_025_403_784_438_6;
/// Coefficients, and those of a plane, which come first.
const N: usize = 10;
const PLANE: usize = 3;

/// What the discs of an image tell of its light.
#[derive(Debug, Default)]
pub(crate) struct SharedLight {
    bright: bool,
    /// Inside and outside, where they vary.
    sides: [Option<Polynomial>; 2],
}

#[derive(Debug)]
struct Polynomial {
    /// How many coefficients there are; the others are zero.
    count: usize,
    coefficients: SVector<f64, N>,
    centre: Pixel,
    scale_px: f64,
}

impl SharedLight {
    /// From the levels inside and around the candidates of the commoner polarity.
    pub(crate) fn of(view: &GrayView, candidates: &[Candidate]) -> Self {
        let brights = candidates.iter().filter(|c| c.bright).count();
        let bright = 2 * brights > candidates.len();
        let alike: Vec<&Candidate> = candidates.iter().filter(|c| c.bright == bright).collect();
        if alike.len() < LEAST_DISCS {
            return Self::default();
        }
        let fit = |level: &dyn Fn(&Candidate) -> Option<f64>| {
            let told = alike.iter().filter_map(|c| Some((c.ellipse.center_px, level(c)?)));
            Polynomial::fit([view.width() as f64, view.height() as f64], &told.collect::<Vec<_>>())
        };
        Self { bright, sides: [fit(&|c| inside(view, &c.ellipse)), fit(&|c| ground(view, c))] }
    }

    /// Gradients inside and outside that a disc may expect, grey/px along u and v.
    pub(crate) fn slopes(&self, disc: &Candidate) -> [[f64; 2]; 2] {
        let at = |p: &Option<Polynomial>| match p {
            Some(p) if disc.bright == self.bright => p.gradient(disc.ellipse.center_px),
            _ => [0.0; 2],
        };
        [at(&self.sides[0]), at(&self.sides[1])]
    }
}

/// Gradients along u and v as coefficients of X and Y, the places in units of the semi-axes of an ellipse, grey.
pub(crate) fn in_axes(e: &Ellipse, slopes: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let (sin, cos) = e.angle_rad.sin_cos();
    slopes.map(|[gu, gv]| [e.semi_major_px * (cos * gu + sin * gv), e.semi_minor_px * (cos * gv - sin * gu)])
}

impl Polynomial {
    /// Robustly; none where the levels do not follow it, or vary no more than by chance.
    fn fit([width, height]: [f64; 2], levels: &[(Pixel, f64)]) -> Option<Self> {
        let mut fitted = Self {
            count: PLANE,
            coefficients: SVector::zeros(),
            centre: Pixel::new(0.5 * width, 0.5 * height),
            scale_px: 0.5 * width.max(height),
        };
        let mut kept: Vec<(Pixel, f64)> = levels.to_vec();
        let mut equations: Option<(usize, usize, _)> = None;
        for _ in 0..ROUNDS {
            if kept.len() < LEAST_DISCS {
                return None;
            }
            fitted.count = if kept.len() < MANY_DISCS { PLANE } else { N };
            // Nothing left out, nothing to sum up anew.
            let (matrix, right) = match equations {
                Some((count, of, sums)) if (count, of) == (fitted.count, kept.len()) => sums,
                _ => fitted.normal_equations(&kept),
            };
            equations = Some((fitted.count, kept.len(), (matrix, right)));
            // Discs in a row, say, fix no polynomial; what they leave open is no gradient.
            let ridge = 1e-9 * matrix.trace();
            fitted.coefficients = (matrix + SMatrix::identity() * ridge).cholesky()?.solve(&right);
            let mut off: Vec<f64> = kept.iter().map(|x| fitted.off(x).abs()).collect();
            let middle = off.len() / 2;
            let limit = CLIP * 1.4826 * *off.select_nth_unstable_by(middle, f64::total_cmp).1;
            kept.retain(|x| fitted.off(x).abs() <= limit);
        }
        let n = kept.len() as f64;
        let mean = kept.iter().map(|x| x.1).sum::<f64>() / n;
        let about_mean = kept.iter().map(|x| (x.1 - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let about_fit = kept.iter().map(|x| fitted.off(x).powi(2)).sum::<f64>() / (n - fitted.count as f64);
        (kept.len() >= LEAST_DISCS && about_mean > TOLD * about_fit).then_some(fitted)
    }

    fn normal_equations(&self, levels: &[(Pixel, f64)]) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
        let (mut matrix, mut right) = ([[0.0; N]; N], [0.0; N]);
        for (p, level) in levels {
            let row = self.monomials(*p);
            for i in 0..N {
                for j in 0..=i {
                    matrix[i][j] += row[i] * row[j];
                }
                right[i] += row[i] * level;
            }
        }
        (SMatrix::from_fn(|i, j| matrix[i.max(j)][i.min(j)]), SVector::from(right))
    }

    fn off(&self, level: &(Pixel, f64)) -> f64 {
        let row = self.monomials(level.0);
        level.1 - row.iter().zip(&self.coefficients).map(|(x, c)| x * c).sum::<f64>()
    }

    /// A place from the centre, in units of the scale.
    fn place(&self, p: Pixel) -> [f64; 2] {
        [(p.u_px - self.centre.u_px) / self.scale_px, (p.v_px - self.centre.v_px) / self.scale_px]
    }

    fn monomials(&self, p: Pixel) -> [f64; N] {
        let [x, y] = self.place(p);
        let mut row = [1.0, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y];
        row[self.count..].fill(0.0);
        row
    }

    /// Along u and v, grey/px.
    fn gradient(&self, p: Pixel) -> [f64; 2] {
        let [x, y] = self.place(p);
        let c = &self.coefficients;
        let du = c[1] + 2.0 * c[3] * x + c[4] * y + 3.0 * c[6] * x * x + 2.0 * c[7] * x * y + c[8] * y * y;
        let dv = c[2] + c[4] * x + 2.0 * c[5] * y + c[7] * x * x + 2.0 * c[8] * x * y + 3.0 * c[9] * y * y;
        [du / self.scale_px, dv / self.scale_px]
    }
}

/// Grey level at the nearest pixel; none outside the image.
fn grey(view: &GrayView, p: Pixel) -> Option<f64> {
    let (u, v) = (p.u_px.round(), p.v_px.round());
    let within = u >= 0.0 && v >= 0.0 && u < view.width() as f64 && v < view.height() as f64;
    within.then(|| f64::from(view.get(u as usize, v as usize)))
}

/// Mean level around the centre; none where blur reaches it.
fn inside(view: &GrayView, e: &Ellipse) -> Option<f64> {
    let part = Ellipse { semi_major_px: 0.3 * e.semi_major_px, semi_minor_px: 0.3 * e.semi_minor_px, ..*e };
    mean_on(view, &part)
}

/// Mean level beside the edge, beyond its blur.
fn ground(view: &GrayView, c: &Candidate) -> Option<f64> {
    let beyond = 3.0 * c.blur_px + 1.5;
    let e = &c.ellipse;
    let ring = Ellipse { semi_major_px: e.semi_major_px + beyond, semi_minor_px: e.semi_minor_px + beyond, ..*e };
    mean_on(view, &ring)
}

/// Mean over an ellipse that lies in the image: opposite places, so that a slope leaves the level of the centre.
fn mean_on(view: &GrayView, e: &Ellipse) -> Option<f64> {
    let (sin, cos) = e.angle_rad.sin_cos();
    let mut sum = 0.0;
    for [x, y] in DIRECTIONS {
        let (p, q) = (x * e.semi_major_px, y * e.semi_minor_px);
        let (du, dv) = (cos * p - sin * q, sin * p + cos * q);
        for sign in [1.0, -1.0] {
            sum += grey(view, Pixel::new(e.center_px.u_px + sign * du, e.center_px.v_px + sign * dv))?;
        }
    }
    Some(sum / (2 * DIRECTIONS.len()) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    const SIZE_PX: [f64; 2] = [420.0, 300.0];

    /// Levels on a lattice of 8 x 8 places, noise of one grey level; every tenth is a mark 60 grey levels darker.
    fn levels(light: impl Fn(f64, f64) -> f64) -> Vec<(Pixel, f64)> {
        let mut random = Random(3);
        let one = |k: usize| {
            let (u, v) = (30.0 + 50.0 * (k % 8) as f64, 25.0 + 35.0 * (k / 8) as f64);
            let mark = if k % 10 == 4 { -60.0 } else { 0.0 };
            (Pixel::new(u, v), light(u, v) + mark + random.gauss())
        };
        (0..64).map(one).collect()
    }

    #[test]
    fn gradients_are_those_of_the_light() {
        let light = |u: f64, v: f64| 150.0 + 0.1 * u - 0.05 * v + 2e-4 * u * v - 3e-7 * u * u * u;
        let fitted = Polynomial::fit(SIZE_PX, &levels(light)).expect("light that varies");
        for (u, v) in [(100.0, 80.0), (210.0, 150.0), (330.0, 230.0)] {
            let expected = [0.1 + 2e-4 * v - 9e-7 * u * u, -0.05 + 2e-4 * u];
            let found = fitted.gradient(Pixel::new(u, v));
            for (f, e) in found.into_iter().zip(expected) {
                assert!((f - e).abs() < 0.01, "at {u}, {v}: {found:?}, expected {expected:?}");
            }
        }
    }

    #[test]
    fn nothing_is_expected_of_even_light_or_where_no_polynomial_follows_it() {
        assert!(Polynomial::fit(SIZE_PX, &levels(|_, _| 150.0)).is_none());
        assert!(Polynomial::fit(SIZE_PX, &levels(|u, v| 150.0 + 20.0 * (0.2 * u + 0.3 * v).sin())).is_none());
        assert!(Polynomial::fit(SIZE_PX, &levels(|u, _| 150.0 + u)[..11]).is_none(), "too few");
        let few = Polynomial::fit(SIZE_PX, &levels(|u, v| 150.0 + 0.3 * u - 0.2 * v)[..24]).expect("a plane");
        let [gu, gv] = few.gradient(Pixel::new(80.0, 60.0));
        assert!((gu - 0.3).abs() < 0.01 && (gv + 0.2).abs() < 0.05, "{gu} {gv}");
    }
}
