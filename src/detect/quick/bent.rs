//! Light that bends: polynomials of the second degree on the pixels that see one side only.
//!
//! Sums of products of the monomials `1, u, v, u^2, u v, v^2, ...` over stretches of rows have closed forms; with the grey values there is one
//! pass. An affine map turns the monomials about the reference pixel into the polynomials of [`crate::detect::light`],
//!
//! ```text
//! 1, X^2 + Y^2 - 1, X, Y, X^2 - Y^2, 2 X Y,     X = x0 + xu u + xv v,   Y = y0 + yu u + yv v
//! ```
//!
//! and its rule says what degree the light has. So a large disc under light that bends takes no longer way than others.
//!
//! What bends is better seen from afar: all pixels within the edge, and some more outside, are asked too. They count where they and those near the
//! edge have the same six coefficients, `chi^2` of both less that of each being what chance makes of six (Chow's test), where noise is the same, and where
//! all together show nothing of third degree.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | u, v | - | 1 | px | column and row about the reference pixel |
//! | - | `Moments::products` | 28 | px^0 .. px^6 | sums of `u^i v^j`, `i + j <= 6` |
//! | - | `Moments::right` | 10 | grey | sums of the grey value times the monomials up to third degree |
//! | - | `turn` | 6 x 6 | | polynomials from monomials |

use super::pixels::{Pixels, Run, Sums};
use crate::detect::correlation::Allowance;
use crate::detect::light::{Fits, Side};
use crate::image::{GrayView, Samples};
use crate::lanes::{self, Kernel, Lanes};
use nalgebra::{Matrix3, SMatrix, SVector};

/// Contours shorter than this have too few pixels beside them to tell light that bends from smoke, px.
pub(super) const LEAST_CONTOUR_PX: f64 = 130.0;

/// Along longer contours light that rises is taken to bend whether it is seen to or not, px: a bend of three standard deviations, too little to
/// be sure of, moves the edge by half of one of its own.
pub(super) const LONG_CONTOUR_PX: f64 = 250.0;

/// By how much `chi^2` may rise where pixels further off are to have the same six coefficients, and fall for the four of the third degree: chance
/// does more once in a thousand and once in a hundred sides.
const SAME_LIGHT: f64 = 22.5;
const THIRD_DEGREE: f64 = 13.3;

/// The coefficients of a surface.
const SURFACE: [usize; Side::MOST] = [0, 1, 2, 3, 4, 5];

/// Exponents of the monomials: the first six are those of a surface.
const MONOMIALS: [(usize, usize); CUBIC] =
    [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)];
const CUBIC: usize = 10;
/// Orders of products of two of them.
const ORDERS: usize = 7;
/// Binomial coefficients.
const CHOOSE: [[f64; ORDERS]; ORDERS] = [
    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 3.0, 3.0, 1.0, 0.0, 0.0, 0.0],
    [1.0, 4.0, 6.0, 4.0, 1.0, 0.0, 0.0],
    [1.0, 5.0, 10.0, 10.0, 5.0, 1.0, 0.0],
    [1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0],
];

/// Sums over all stretches of one side.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    /// Of `u^i v^j` at `[i][j]`.
    products: [[f64; ORDERS]; ORDERS],
    right: [f64; CUBIC],
    /// Of the squared grey values.
    squares: f64,
}

/// What the pixels of one side say about its light.
#[derive(Debug)]
pub(super) struct Bent {
    moments: Moments,
    pub(super) fits: Fits<6>,
    /// Polynomials from monomials.
    turn: SMatrix<f64, 6, 6>,
    pub(super) side: Side,
    /// Standard deviation of the bend across the contour that goes with the one seen along it, grey.
    across: f64,
    /// Noise variance about a surface of the second degree, grey^2.
    pub(super) variance: Option<f64>,
}

impl Bent {
    /// Of one side; an error where rows differ more than neighbours do, or the pixels fix no surface.
    pub(super) fn new(
        view: &GrayView,
        pixels: &Pixels,
        side: usize,
        turn: &Matrix3<f64>,
        noise: (f64, &Allowance),
        step: f64,
    ) -> Result<Self, ()> {
        let sums = &pixels.sums[side];
        Self::of(Moments::new(view, pixels, side), second_degree(turn), sums, noise, step)
    }

    fn of(
        moments: Moments,
        turn: SMatrix<f64, 6, 6>,
        sums: &Sums,
        (floor, allow): (f64, &Allowance),
        step: f64,
    ) -> Result<Self, ()> {
        let fits = moments.fits(&turn);
        let mut out = Self { moments, fits, turn, side: Side::plain(0, step), across: 0.0, variance: None };
        if sums.count() < 16.0 {
            return Ok(out);
        }
        let (left, _) = out.fits.left_by(&SURFACE).ok_or(())?;
        let variance = sums.noise_about(left, 6.0, floor, allow)?;
        let degrees = out.fits.degrees().ok_or(())?;
        out.across = Side::bend_across(&degrees[2].1);
        out.side = out.fits.side(&degrees, variance.max(floor), sums.count(), step);
        out.variance = Some(variance);
        Ok(out)
    }

    /// With the pixels `beyond` those it was made of, `pixels`, where they show the same light and the same noise.
    pub(super) fn with(
        &self,
        view: &GrayView,
        side: usize,
        [pixels, beyond]: [&Pixels; 2],
        (floor, allow): (f64, &Allowance),
    ) -> Option<Self> {
        let (own, more) = (&pixels.sums[side], &beyond.sums[side]);
        let variance = self.variance?.max(floor);
        let mut moments = Moments::new(view, beyond, side);
        let (alone, light) = moments.fits(&self.turn).left_by(&SURFACE)?;
        let noise = more.noise_about(alone, 6.0, floor, allow).ok()?;
        let scatter = (2.0 * allow.squares * (1.0 / own.count() + 1.0 / more.count())).sqrt();
        let (rows, count) = self.left_by_rows(&beyond.runs[side], &light);
        if noise > variance * (1.25 + 5.0 * scatter) || rows > allow.most_of_rows(count) * noise.max(floor) {
            return None;
        }
        moments.add_all(&self.moments);
        let mut sums = *own;
        sums.add(more);
        let both = Self::of(moments, self.turn, &sums, (floor, allow), self.side.step).ok()?;
        let together = both.fits.left_by(&SURFACE)?.0;
        let apart = together - self.fits.left_by(&SURFACE)?.0 - alone;
        let third = together - moments.left_by_third_degree()?;
        let chance = allow.sums * both.variance?.max(floor);
        (apart < SAME_LIGHT * chance && third < THIRD_DEGREE * chance).then_some(both)
    }

    /// Takes the light to bend.
    pub(super) fn loosen(&mut self) {
        let side = &mut self.side;
        *side = Side { degree: 2, radial: side.radial.max(self.across), ..*side };
    }

    /// Whether the light is more than level.
    pub(super) fn rises(&self) -> bool {
        self.side.degree > 0
    }

    /// Whether the light is more than level and slope.
    pub(super) fn bends(&self) -> bool {
        self.side.degree == 2 || self.side.radial > Side::plain(0, self.side.step).radial
    }

    /// Standard deviations of the coefficients before seeing the image, grey: slopes are free, what is not seen to bend is held.
    pub(super) fn prior_sigmas(&self) -> [f64; Side::MOST] {
        let mut sigmas = self.side.prior_sigmas();
        if self.side.degree < 2 {
            sigmas[4..].fill(1e-5 * self.side.step);
        }
        sigmas
    }

    /// Both sides. Light that bends outside bends inside as well, where a dark disc hides it in the noise.
    pub(super) fn of_both([mut inside, outside]: [Self; 2]) -> [Self; 2] {
        inside.side.degree = inside.side.degree.max(outside.side.degree);
        [inside, outside]
    }

    /// Sum of the squares that stretches leave about the light with these coefficients, each over its pixels, and how many there are.
    pub(super) fn left_by_rows(&self, runs: &[Run], light: &SVector<f64, 6>) -> (f64, f64) {
        let c = self.turn.transpose() * light;
        let mut sum = 0.0;
        for x in runs {
            let (n, u, v) = (x.n, x.u, x.v);
            // Of consecutive columns.
            let uu = u * u / n + n * (n * n - 1.0) / 12.0;
            let shown = (c[0] + v * (c[2] + v * c[5])) * n + (c[1] + v * c[4]) * u + c[3] * uu;
            sum += (x.g - shown) * (x.g - shown) / n;
        }
        (sum, runs.len() as f64)
    }
}

/// The polynomials from the monomials, where `turn` makes `1, X, Y` from `1, u, v`.
fn second_degree(turn: &Matrix3<f64>) -> SMatrix<f64, 6, 6> {
    let row = |i: usize| SVector::<f64, 6>::from([turn[(i, 0)], turn[(i, 1)], turn[(i, 2)], 0.0, 0.0, 0.0]);
    let product = |i: usize, j: usize| {
        let (a, b) = (turn.row(i), turn.row(j));
        SVector::<f64, 6>::from([
            a[0] * b[0],
            a[0] * b[1] + a[1] * b[0],
            a[0] * b[2] + a[2] * b[0],
            a[1] * b[1],
            a[1] * b[2] + a[2] * b[1],
            a[2] * b[2],
        ])
    };
    let (one, xx, yy) = (row(0), product(1, 1), product(2, 2));
    let rows = [one, xx + yy - one, row(1), row(2), xx - yy, 2.0 * product(1, 2)];
    SMatrix::from_fn(|i, j| rows[i][j])
}

/// Sums up the rows of one side.
struct Rows<'a> {
    view: &'a GrayView<'a>,
    pixels: &'a Pixels,
    side: usize,
}

impl Kernel for Rows<'_> {
    type Output = Moments;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Moments {
        let Self { view, pixels, side } = self;
        let mut out = Moments::default();
        for run in &pixels.runs[side] {
            let first = run.u / run.n - 0.5 * (run.n - 1.0);
            let (u, v) = ((first + pixels.reference.0) as usize, (run.v + pixels.reference.1) as usize);
            let range = v * view.stride() + u..v * view.stride() + u + run.n as usize;
            let grey = match view.samples() {
                Samples::U8(s) => with_places(&s[range], pixels.ground),
                Samples::U16(s) => with_places(&s[range], pixels.ground),
                Samples::F32(s) => with_places(&s[range], pixels.ground),
            };
            out.add(run, first, grey);
        }
        out.squares = pixels.sums[side].right().1;
        out
    }
}

impl Moments {
    fn new(view: &GrayView, pixels: &Pixels, side: usize) -> Self {
        lanes::run(Rows { view, pixels, side })
    }

    fn add_all(&mut self, other: &Self) {
        self.products.as_flattened_mut().iter_mut().zip(other.products.as_flattened()).for_each(|(a, b)| *a += b);
        self.right.iter_mut().zip(&other.right).for_each(|(a, b)| *a += b);
        self.squares += other.squares;
    }

    /// Adds a stretch from the column `first` on, with its sums of the grey value times place, its square and its cube.
    fn add(&mut self, run: &Run, first: f64, [gi, gii, giii]: [f64; 3]) {
        let (n, v, f) = (run.n, run.v, first);
        // Sums of t^k about the middle of the stretch, then of (middle + t)^k; those of odd powers are none.
        let (middle, n2) = (f + 0.5 * (n - 1.0), n * n);
        let second = n * (n2 - 1.0) / 12.0;
        let fourth = second * (3.0 * n2 - 7.0) / 20.0;
        let sixth = second * (3.0 * n2 * n2 - 18.0 * n2 + 31.0) / 112.0;
        let about = [n, 0.0, second, 0.0, fourth, 0.0, sixth];
        for i in 0..ORDERS {
            // Horner's rule in the middle.
            let power = (0..=i).fold(0.0, |sum, k| sum * middle + CHOOSE[i][k] * about[k]);
            let mut x = power;
            for j in 0..ORDERS - i {
                self.products[i][j] += x;
                x *= v;
            }
        }
        let f2 = f * f;
        let gu = gi + f * run.g;
        let guu = gii + 2.0 * f * gi + f2 * run.g;
        let guuu = giii + 3.0 * f * gii + 3.0 * f2 * gi + f2 * f * run.g;
        let by_columns = [run.g, gu, guu, guuu];
        for (right, (i, j)) in self.right.iter_mut().zip(MONOMIALS) {
            *right += by_columns[i] * v.powi(j as i32);
        }
    }

    fn product(&self, k: usize, l: usize) -> f64 {
        let (a, b) = (MONOMIALS[k], MONOMIALS[l]);
        self.products[a.0 + b.0][a.1 + b.1]
    }

    fn fits(&self, turn: &SMatrix<f64, 6, 6>) -> Fits<6> {
        let matrix = turn * SMatrix::<f64, 6, 6>::from_fn(|k, l| self.product(k, l)) * turn.transpose();
        Fits { matrix, right: turn * SVector::from_fn(|k, _| self.right[k]), squares: self.squares }
    }

    /// Squares that a surface of the third degree leaves.
    fn left_by_third_degree(&self) -> Option<f64> {
        let all: [usize; CUBIC] = std::array::from_fn(|k| k);
        let matrix = SMatrix::from_fn(|k, l| self.product(k, l));
        let fits = Fits::<CUBIC> { matrix, right: SVector::from(self.right), squares: self.squares };
        fits.left_by(&all).map(|x| x.0)
    }
}

/// Sums of the grey value times the place, times its square and times its cube.
#[inline(always)]
fn with_places<T: Copy + Into<f64>>(grey: &[T], ground: f64) -> [f64; 3] {
    // Side by side, so that none waits for the one before.
    const SIDE_BY_SIDE: usize = 8;
    let mut sums = [[0.0; SIDE_BY_SIDE]; 3];
    let eights = grey.chunks_exact(SIDE_BY_SIDE);
    let done = grey.len() - eights.remainder().len();
    for (c, eight) in eights.enumerate() {
        for k in 0..SIDE_BY_SIDE {
            let place = (c * SIDE_BY_SIDE + k) as i32 as f64;
            let mut x = eight[k].into() - ground;
            for sum in &mut sums {
                x *= place;
                sum[k] += x;
            }
        }
    }
    for (i, x) in grey.iter().enumerate().skip(done) {
        let mut x = (*x).into() - ground;
        for sum in &mut sums {
            x *= i as f64;
            sum[0] += x;
        }
    }
    sums.map(|s| s.iter().sum())
}

#[cfg(test)]
mod tests;
