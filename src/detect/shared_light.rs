//! Light that all discs of one image stand in.
//!
//! A small disc cannot tell a slope of the light from a shift of its own: with slopes set free the centre of a disc of 6 px is known a third
//! worse (Fisher information), and slopes too weak to be seen on one disc shift it by a few thousandths of a px, alike in every image, which passes
//! for distortion. But the levels of many discs, and of the ground around them, tell the light of the image, a polynomial of the place
//!
//! ```text
//! L(x, y) = sum c_ij x^i y^j,   i + j <= 1, 2 or 3
//! ```
//!
//! on either side, and its gradient is what the fit of a single disc expects. The degree is the likeliest one (Akaike's criterion with the correction of
//! Hurvich and Tsai, Biometrika 76 (1989), for few data). What the polynomial is wrong by makes all centres of the image wrong alike, which no covariance
//! of a disc tells: so levels are means over every pixel inside that blur does not reach, and all along a line around the disc.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | g_in, g_out | `slopes` | grey/px | gradient of the light inside and outside, along u and v |
//! | c_ij | `Polynomial::coefficients` | grey | of `x`, `y`, half the longer side of the image from its centre |
//!
//! Where the light is even, or not a polynomial, nothing is expected.

use crate::conic::{Cut, Ellipse, Frame};
use crate::detect::candidate::Candidate;
use crate::detect::level::ROUND;
use crate::frames::Pixel;
use crate::image::{GrayView, Samples};
use crate::stats::{SIGMA_OVER_MEDIAN, median};
use crate::threads;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::Range;

/// Fewer discs tell nothing.
const LEAST_DISCS: usize = 9;
/// Discs that a coefficient asks for.
const PER_COEFFICIENT: usize = 2;
/// Longest contour of a disc that goes by a plane where there are too few discs for more, px: longer ones tell slopes of their own, and better.
const BY_PLANE_PX: f64 = 90.0;
/// By how much the polynomial must lessen the variance of the levels: less is noise, or light of another kind.
const TOLD: f64 = 4.0;
/// Rounds of leaving out what is no level (marks, dirt), and their limit in standard deviations.
const ROUNDS: usize = 4;
const CLIP: f64 = 4.0;
/// The part of the semi-axes up to which a disc is looked at however large its blur.
const CORE: f64 = 0.3;
/// Fewest pixels of a mean, and rows of it at most (twice as many, at the least).
const FEWEST_PIXELS: f64 = 12.0;
const MOST_ROWS: usize = 48;
/// Places of a mean on an ellipse, at least and at most, and those of all discs together that are enough: light of ten coefficients is then known to a
/// fiftieth of the noise of a pixel.
const FEWEST_PLACES: usize = 12;
const MOST_PLACES: usize = 128;
const ENOUGH_PLACES: usize = 24_000;
/// Coefficients up to the first, second and third degree.
const COUNTS: [usize; 3] = [3, 6, N];
const N: usize = 10;

/// What the discs of an image tell of its light.
#[derive(Debug, Default)]
pub(crate) struct SharedLight {
    bright: bool,
    /// Inside and outside, where they vary.
    sides: [Option<Polynomial>; 2],
}

/// Matrix and right-hand side of the normal equations.
type Sums = (SMatrix<f64, N, N>, SVector<f64, N>);

#[derive(Clone, Debug)]
struct Polynomial {
    /// How many coefficients there are; the others are zero.
    count: usize,
    /// Whether there are discs enough for more than a plane.
    bends: bool,
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
        let most = (ENOUGH_PLACES / alike.len()).clamp(FEWEST_PLACES, MOST_PLACES);
        let fit = |level: fn(&GrayView, &Candidate, usize) -> Option<(Pixel, f64)>| {
            let told = threads::side_by_side(&alike, |c| level(view, c, most)).into_iter().flatten();
            Polynomial::fit([view.width() as f64, view.height() as f64], &told.collect::<Vec<_>>())
        };
        let (inside, ground) = threads::both(|| fit(inside), || fit(ground));
        Self { bright, sides: [inside, ground] }
    }

    /// Gradients inside and outside that a disc may expect, grey/px along u and v.
    pub(crate) fn slopes(&self, disc: &Candidate) -> [[f64; 2]; 2] {
        let long = disc.ellipse.is_longer_than(BY_PLANE_PX);
        let at = |p: &Option<Polynomial>| match p {
            Some(p) if disc.bright == self.bright && (p.bends || !long) => p.gradient(disc.ellipse.center_px),
            _ => [0.0; 2],
        };
        [at(&self.sides[0]), at(&self.sides[1])]
    }
}

/// Gradients along u and v as coefficients of X and Y, the places in units of the semi-axes of an ellipse, grey.
pub(crate) fn in_axes(frame: &Frame, slopes: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let Frame { a, b, cos, sin, .. } = frame;
    slopes.map(|[gu, gv]| [a * (cos * gu + sin * gv), b * (cos * gv - sin * gu)])
}

/// Coefficients up to each degree that so many discs tell.
fn counts(discs: usize) -> impl Iterator<Item = usize> {
    COUNTS.into_iter().filter(move |count| PER_COEFFICIENT * count <= discs)
}

impl Polynomial {
    /// Robustly; none where the levels do not follow it, or vary no more than by chance.
    fn fit([width, height]: [f64; 2], levels: &[(Pixel, f64)]) -> Option<Self> {
        let mut fitted = Self {
            count: COUNTS[0],
            bends: false,
            coefficients: SVector::zeros(),
            centre: Pixel::new(0.5 * width, 0.5 * height),
            scale_px: 0.5 * width.max(height),
        };
        let mut kept: Vec<(Pixel, f64)> = levels.to_vec();
        let mut sums = fitted.normal_equations(&kept);
        for _ in 0..ROUNDS {
            fitted.count = counts(kept.len()).last()?;
            fitted.solve(&sums)?;
            let off: Vec<f64> = kept.iter().map(|x| fitted.off(x).abs()).collect();
            let limit = CLIP * SIGMA_OVER_MEDIAN * median(&mut off.clone())?;
            let before = kept.len();
            let mut off = off.into_iter();
            kept.retain(|_| off.next().is_some_and(|off| off <= limit));
            // Nothing left out: another round would be the same.
            if kept.len() == before {
                break;
            }
            sums = fitted.normal_equations(&kept);
        }
        if kept.len() < LEAST_DISCS {
            return None;
        }
        let n = kept.len() as f64;
        let mean = kept.iter().map(|x| x.1).sum::<f64>() / n;
        let about_mean = kept.iter().map(|x| (x.1 - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let fitted = fitted.of_likeliest_degree(&kept, &sums)?;
        let about_fit = fitted.sum_of_squares(&kept) / (n - fitted.count as f64);
        (about_mean > TOLD * about_fit).then_some(fitted)
    }

    /// Of the degree that is likeliest, of those that so many discs tell, by Akaike's criterion for few data: what a degree does not need only adds noise to the gradient.
    fn of_likeliest_degree(&self, levels: &[(Pixel, f64)], sums: &Sums) -> Option<Self> {
        let n = levels.len() as f64;
        let mut likeliest: Option<(f64, Self)> = None;
        for count in counts(levels.len()) {
            let (mut lower, p) = (self.clone(), count as f64 + 1.0);
            (lower.count, lower.bends) = (count, counts(levels.len()).nth(1).is_some());
            lower.solve(sums)?;
            let unlikely = n * lower.sum_of_squares(levels).ln() + 2.0 * p * n / (n - p - 1.0);
            if likeliest.as_ref().is_none_or(|(least, _)| unlikely < *least) {
                likeliest = Some((unlikely, lower));
            }
        }
        likeliest.map(|x| x.1)
    }

    /// The first coefficients, as many as there are; those of the others stay zero.
    fn solve(&mut self, (matrix, right): &Sums) -> Option<()> {
        // Discs in a row, say, fix no polynomial; what they leave open is no gradient.
        let mine = |i: usize| i < self.count;
        let part = SMatrix::<f64, N, N>::from_fn(|i, j| if mine(i) && mine(j) { matrix[(i, j)] } else { 0.0 });
        let ridge = 1e-9 * part.trace();
        let side = SVector::<f64, N>::from_fn(|i, _| if mine(i) { right[i] } else { 0.0 });
        self.coefficients = (part + SMatrix::identity() * ridge).cholesky()?.solve(&side);
        Some(())
    }

    fn sum_of_squares(&self, levels: &[(Pixel, f64)]) -> f64 {
        levels.iter().map(|x| self.off(x).powi(2)).sum()
    }

    fn normal_equations(&self, levels: &[(Pixel, f64)]) -> Sums {
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
        [1.0, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
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

/// Mean level inside, and where, as far as blur does not reach; of so many places at most where it is one on an ellipse.
fn inside(view: &GrayView, c: &Candidate, most: usize) -> Option<(Pixel, f64)> {
    let e = &c.ellipse;
    let part = |axes: [f64; 2]| Ellipse { semi_major_px: axes[0], semi_minor_px: axes[1], ..*e };
    let axes = [e.semi_major_px, e.semi_minor_px];
    mean_within(view, &part(axes.map(|x| (x - beyond_px(c)).max(CORE * x)))).or_else(|| {
        // So few pixels that the nearest ones have to do.
        Some((e.center_px, mean_on(view, &part(axes.map(|x| CORE * x)), most)?))
    })
}

/// Mean level of so many places at most beside the edge, beyond its blur, and where.
fn ground(view: &GrayView, c: &Candidate, most: usize) -> Option<(Pixel, f64)> {
    let mut around = c.ellipse;
    around.semi_major_px += beyond_px(c);
    around.semi_minor_px += beyond_px(c);
    Some((around.center_px, mean_on(view, &around, most)?))
}

/// How far from the edge blur no longer matters, px.
fn beyond_px(c: &Candidate) -> f64 {
    3.0 * c.blur_px + 1.5
}

/// Mean over the pixels within an ellipse that lies in the image, of a large one over some rows, and their own middle. None of fewer than [`FEWEST_PIXELS`], by its area or by their number.
fn mean_within(view: &GrayView, e: &Ellipse) -> Option<(Pixel, f64)> {
    if PI * e.semi_major_px * e.semi_minor_px < FEWEST_PIXELS {
        return None;
    }
    let (frame, Pixel { u_px: u0, v_px: v0, .. }) = (Frame::new(e), e.center_px);
    let half = (e.semi_major_px * frame.sin).hypot(e.semi_minor_px * frame.cos);
    let (first, last) = ((v0 - half).ceil(), (v0 + half).floor());
    if first < 0.0 || last >= view.height() as f64 {
        return None;
    }
    let step = ((last - first) as usize / MOST_ROWS).max(1);
    let cut = Cut::new(&frame, e.semi_major_px, e.semi_minor_px);
    let (mut count, mut sums) = (0.0, [0.0; 3]);
    for v in (first as usize..=last.max(first) as usize).step_by(step) {
        let Some((left, right)) = cut.span(v as f64 - v0) else { continue };
        let (left, right) = ((u0 + left).ceil(), (u0 + right).floor());
        if left < 0.0 || right >= view.width() as f64 {
            return None;
        }
        if left <= right {
            let n = right - left + 1.0;
            count += n;
            sums[0] += n * 0.5 * (left + right);
            sums[1] += n * v as f64;
            sums[2] += sum_of_row(view, v, left as usize..right as usize + 1);
        }
    }
    (count >= FEWEST_PIXELS).then(|| {
        let [u, v, grey] = sums.map(|x| x / count);
        (Pixel::new(u, v), grey)
    })
}

/// Sum of grey levels of a part of a row.
fn sum_of_row(view: &GrayView, v: usize, columns: Range<usize>) -> f64 {
    let at = v * view.stride() + columns.start..v * view.stride() + columns.end;
    match view.samples() {
        Samples::U8(s) => f64::from(s[at].iter().map(|x| u32::from(*x)).sum::<u32>()),
        Samples::U16(s) => s[at].iter().map(|x| u64::from(*x)).sum::<u64>() as f64,
        Samples::F32(s) => s[at].iter().map(|x| f64::from(*x)).sum(),
    }
}

/// Mean at places on an ellipse that lies in the image, the nearest pixel to each and about as many places as pixels, but so many at most: four a quarter of
/// the eccentric angle apart, so that a slope leaves the level of the centre.
fn mean_on(view: &GrayView, e: &Ellipse, most: usize) -> Option<f64> {
    let frame = Frame::new(e);
    let half_width = (frame.a * frame.cos).hypot(frame.b * frame.sin);
    let half_height = (frame.a * frame.sin).hypot(frame.b * frame.cos);
    let within = |at: f64, half: f64, size: usize| at - half > -0.5 && at + half < size as f64 - 0.5;
    if !(within(frame.u0, half_width, view.width()) && within(frame.v0, half_height, view.height())) {
        return None;
    }
    let places = if e.is_longer_than((most + 1) as f64) { most } else { e.perimeter_px() as usize };
    let quarter = places.clamp(FEWEST_PLACES, most).div_ceil(4);
    Some(match view.samples() {
        Samples::U8(s) => mean_of(s, view, &frame, quarter),
        Samples::U16(s) => mean_of(s, view, &frame, quarter),
        Samples::F32(s) => mean_of(s, view, &frame, quarter),
    })
}

/// Mean of the pixels nearest to places on the ellipse of a frame, which lies in the image, so many a quarter, grey.
fn mean_of<S: Copy + Into<f64>>(samples: &[S], view: &GrayView, frame: &Frame, quarter: usize) -> f64 {
    let (turn_sin, turn_cos) = (FRAC_PI_2 / quarter as f64).sin_cos();
    let last = [view.width() - 1, view.height() - 1];
    let grey = |du: f64, dv: f64| -> f64 {
        let [u, v] = [frame.u0 + du, frame.v0 + dv].map(|x| (x + ROUND).to_bits() as i32 as usize);
        samples[v.min(last[1]) * view.stride() + u.min(last[0])].into()
    };
    let ([mut x, mut y], mut sum) = ([1.0, 0.0], 0.0);
    for _ in 0..quarter {
        // Along the axes of the ellipse at this angle, and a quarter on.
        let [(p, q), (r, s)] = [(x * frame.a, y * frame.b), (-y * frame.a, x * frame.b)];
        for (p, q) in [(p, q), (r, s), (-p, -q), (-r, -s)] {
            sum += grey(frame.cos * p - frame.sin * q, frame.sin * p + frame.cos * q);
        }
        (x, y) = (turn_cos * x - turn_sin * y, turn_sin * x + turn_cos * y);
    }
    sum / (4 * quarter) as f64
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
        assert!(Polynomial::fit(SIZE_PX, &levels(|u, _| 150.0 + u)[..8]).is_none(), "too few");
        let few = Polynomial::fit(SIZE_PX, &levels(|u, v| 150.0 + 0.3 * u - 0.2 * v)[..24]).expect("a plane");
        let [gu, gv] = few.gradient(Pixel::new(80.0, 60.0));
        assert!((gu - 0.3).abs() < 0.01 && (gv + 0.2).abs() < 0.05, "{gu} {gv}");
    }

    /// Light that rises evenly has the level of the centre all along an ellipse, and within it; alike in all depths. What leaves the image tells none.
    #[test]
    fn means_are_levels_of_the_centre() {
        let (width, height) = (70, 60);
        let bytes: Vec<u8> = (0..width * height).map(|i| (20 + 2 * (i % width) + i / width) as u8).collect();
        let wide: Vec<u16> = bytes.iter().map(|x| u16::from(*x)).collect();
        let floats: Vec<f32> = bytes.iter().map(|x| f32::from(*x)).collect();
        for (u, v, a, b, angle_rad) in
            [(33.3, 28.6, 17.0, 9.0, 0.6), (30.0, 31.4, 3.0, 2.2, -1.1), (40.7, 20.2, 12.0, 12.0, 0.0)]
        {
            let e = Ellipse::new(Pixel::new(u, v), a, b, angle_rad).expect("an ellipse");
            let of = |samples: Samples| {
                let view = GrayView::new(samples, width, height, width).expect("an image");
                (
                    mean_on(&view, &e, MOST_PLACES).expect("within the image"),
                    mean_within(&view, &e).expect("pixels enough"),
                )
            };
            let all = [of(Samples::U8(&bytes)), of(Samples::U16(&wide)), of(Samples::F32(&floats))];
            assert!(all.iter().all(|x| *x == all[0]));
            let (on, (place, within)) = all[0];
            let light = |p: Pixel| 20.0 + 2.0 * p.u_px + p.v_px;
            // Places are those of the nearest pixels: by chance they are off by 0.4 px, a mean over n of them by that over the root of n.
            let by_chance = 0.4 * 5.0_f64.sqrt() / e.perimeter_px().max(12.0).sqrt();
            assert!((on - light(e.center_px)).abs() < 3.0 * by_chance, "{on} {}", light(e.center_px));
            assert!((within - light(place)).abs() < 1e-9, "{within} {}", light(place));
            let beyond = Ellipse { center_px: Pixel::new(a - 2.0, v), angle_rad: 0.0, ..e };
            let view = GrayView::new(Samples::U8(&bytes), width, height, width).expect("an image");
            assert!(mean_on(&view, &beyond, MOST_PLACES).is_none() && mean_within(&view, &beyond).is_none());
        }
    }

    /// The third degree asks for 20 levels; of 14 it is not told, even where the rounds began with it.
    #[test]
    fn what_is_left_out_tells_no_degree() {
        let all = levels(|u, v| 150.0 + 0.3 * u - 0.2 * v);
        let some: Vec<_> = all.into_iter().enumerate().filter(|(k, _)| k % 10 != 4).map(|x| x.1).collect();
        assert!(counts(20).eq(COUNTS) && counts(14).eq([3, 6]) && counts(9).eq([3]));
        let fitted = Polynomial::fit(SIZE_PX, &some[..14]).expect("a plane");
        let begun = Polynomial { count: N, ..fitted.clone() };
        let of_all = begun.of_likeliest_degree(&some[..14], &begun.normal_equations(&some[..14])).expect("a plane");
        assert_eq!((fitted.count, of_all.count, of_all.bends), (3, 3, true));
        assert!(!Polynomial::fit(SIZE_PX, &some[..9]).expect("a plane").bends);
    }
}
