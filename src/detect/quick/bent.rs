//! Light that bends: polynomials of the second degree on the pixels that see one side only.
//!
//! Sums of products of the monomials `1, u, v, u^2, u v, v^2` over stretches of rows have closed forms; with the grey values there is one
//! pass. An affine map turns the monomials about the reference pixel into the polynomials of [`crate::detect::light`],
//!
//! ```text
//! 1, X^2 + Y^2 - 1, X, Y, X^2 - Y^2, 2 X Y,     X = x0 + xu u + xv v,   Y = y0 + yu u + yv v
//! ```
//!
//! and its rule says what degree the light has. So a large disc under light that bends takes no longer way than others.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | u, v | - | 1 | px | column and row about the reference pixel |
//! | - | `Moments::products` | 15 | px^0 .. px^4 | sums of `u^i v^j`, `i + j <= 4` |
//! | - | `Moments::right` | 6 | grey | sums of the grey value times the monomials |
//! | - | `turn` | 6 x 6 | | polynomials from monomials |

use super::pixels::{Pixels, Run, Sums};
use crate::detect::correlation::Allowance;
use crate::detect::light::{Fits, Side};
use crate::image::{GrayView, Samples};
use nalgebra::{Matrix3, SMatrix, SVector};

/// Contours shorter than this have too few pixels beside them to tell light that bends from smoke, px.
pub(super) const LEAST_CONTOUR_PX: f64 = 130.0;

/// Along longer contours light that rises is taken to bend whether it is seen to or not, px: a bend of three standard deviations, too little to
/// be sure of, moves the edge by half of one of its own.
pub(super) const LONG_CONTOUR_PX: f64 = 250.0;

/// Exponents of the monomials.
const MONOMIALS: [(usize, usize); 6] = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)];

/// Sums over all stretches of one side.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    /// Of `u^i v^j` at `[i][j]`.
    products: [[f64; 5]; 5],
    right: [f64; 6],
}

/// What the pixels of one side say about its light.
#[derive(Debug)]
pub(super) struct Bent {
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
        (floor, allow): (f64, &Allowance),
        step: f64,
    ) -> Result<Self, ()> {
        let sums = &pixels.sums[side];
        let moments = Moments::new(view, pixels, side);
        let turn = second_degree(turn);
        let fits = moments.fits(&turn, sums);
        let mut out = Self { fits, turn, side: Side::plain(0, step), across: 0.0, variance: None };
        if sums.count() < 16.0 {
            return Ok(out);
        }
        let (left, _) = out.fits.left_by(&[0, 1, 2, 3, 4, 5]).ok_or(())?;
        let variance = sums.noise_about(left, 6.0, floor, allow)?;
        let degrees = out.fits.degrees().ok_or(())?;
        out.across = Side::bend_across(&degrees[2].1);
        out.side = out.fits.side(&degrees, variance.max(floor), sums.count(), step);
        out.variance = Some(variance);
        Ok(out)
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
    pub(super) fn of_both(inside: Self, outside: Self) -> [Self; 2] {
        let mut inside = inside;
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

impl Moments {
    fn new(view: &GrayView, pixels: &Pixels, side: usize) -> Self {
        let mut out = Self::default();
        for run in &pixels.runs[side] {
            let first = run.u / run.n - 0.5 * (run.n - 1.0);
            let (u, v) = ((first + pixels.reference.0) as usize, (run.v + pixels.reference.1) as usize);
            let range = v * view.stride() + u..v * view.stride() + u + run.n as usize;
            let grey = match view.samples() {
                Samples::U8(s) => whole_squares(&s[range], pixels.ground),
                Samples::U16(s) => whole_squares(&s[range], pixels.ground),
                Samples::F32(s) => squares(&s[range], pixels.ground),
            };
            out.add(run, first, grey);
        }
        out
    }

    /// Adds a stretch from the column `first` on, with its sums of the grey value times place and times its square.
    fn add(&mut self, run: &Run, first: f64, [gi, gii]: [f64; 2]) {
        let (n, v, f) = (run.n, run.v, first);
        let m = n - 1.0;
        // Sums of i^k from 0 to n - 1, then of (first + i)^k.
        let (s1, s2) = (0.5 * n * m, n * m * (2.0 * n - 1.0) / 6.0);
        let (s3, s4) = (s1 * s1, s2 * (3.0 * n * m - 1.0) / 5.0);
        let f2 = f * f;
        let powers = [
            n,
            s1 + n * f,
            s2 + 2.0 * f * s1 + n * f2,
            s3 + 3.0 * f * s2 + 3.0 * f2 * s1 + n * f2 * f,
            s4 + 4.0 * f * s3 + 6.0 * f2 * s2 + 4.0 * f2 * f * s1 + n * f2 * f2,
        ];
        for (i, power) in powers.into_iter().enumerate() {
            let mut x = power;
            for j in 0..5 - i {
                self.products[i][j] += x;
                x *= v;
            }
        }
        let (gu, guu) = (gi + f * run.g, gii + 2.0 * f * gi + f2 * run.g);
        let right = [run.g, gu, run.g * v, guu, gu * v, run.g * v * v];
        (0..6).for_each(|k| self.right[k] += right[k]);
    }

    fn fits(&self, turn: &SMatrix<f64, 6, 6>, sums: &Sums) -> Fits<6> {
        let product = |k: usize, l: usize| {
            let (a, b) = (MONOMIALS[k], MONOMIALS[l]);
            self.products[a.0 + b.0][a.1 + b.1]
        };
        let matrix = turn * SMatrix::<f64, 6, 6>::from_fn(product) * turn.transpose();
        Fits { matrix, right: turn * SVector::from(self.right), squares: sums.right().1 }
    }
}

/// Sums of the grey value times the place, and times its square.
fn squares(grey: &[f32], ground: f64) -> [f64; 2] {
    let (mut gi, mut gii) = (0.0, 0.0);
    for (i, x) in grey.iter().enumerate() {
        let x = (f64::from(*x) - ground) * i as f64;
        gi += x;
        gii += x * i as f64;
    }
    [gi, gii]
}

/// The same of whole numbers.
fn whole_squares<T: Copy + Into<i64>>(grey: &[T], ground: f64) -> [f64; 2] {
    let ground = ground as i64;
    let (mut gi, mut gii) = (0, 0);
    for (i, x) in grey.iter().enumerate() {
        let x = ((*x).into() - ground) * i as i64;
        gi += x;
        gii += x * i as i64;
    }
    [gi as f64, gii as f64]
}

#[cfg(test)]
mod tests;
