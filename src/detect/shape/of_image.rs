//! The shape of the blur of one image, told by all of its discs together.
//!
//! Disc i, fitted with the shape `x0 = (c, e)`, says by its score `g_i` and information `S_i` where the shape is ([`Told`]): with `C_i` the derivatives of the
//! grey values by the two numbers of [`crate::detect::shape`], over the noise, `J_i` those by all unknowns of the disc, `A_i` their equations and `r_i` what these left,
//!
//! ```text
//! S_i = C^T C - C^T J A^-1 J^T C,   g_i = C^T r,   geometry follows by -A^-1 J^T C
//! ```
//!
//! Where focus differs over the image so does the shape. A blur of disc and Gaussian, s0 the Gaussian's, has of fourth order what goes with `x^2`, and of
//! sixth with `x^3`, `x = 1 - (s0 / s)^2`. So disc i, whose line shows the blur s_i, has the shape
//!
//! ```text
//! (c, e)_i = B_i t,   B_i = (1 x_i^2 0 0; 0 0 1 x_i^3),   s0 that of the sharpest discs
//! ```
//!
//! and with a prior `N(0, diag(0.3, 0.3, 0.1, 0.1)^2)`, `Lambda`,
//!
//! ```text
//! V = f (sum_i B^T S_i B + Lambda)^-1,   t = (sum_i B^T S_i B + Lambda)^-1 sum_i B^T (S_i B t0 + g_i)
//! ```
//!
//! t0 being what the discs were fitted with and f by how much discs differ more than noise makes them. Discs that lie far off have dirt on them and no say.
//! A few are asked first, half of them of the widest blurs: where these show no shape for sure, or one that would move no contour, it is a Gaussian.

use super::Shape;
use crate::detect::dense::Dense;
use crate::detect::refine::Start;
use crate::stats::median;
use nalgebra::{Matrix2, Matrix4, SMatrix, Vector2, Vector4};

/// Discs that are asked first, and at most.
const FIRST: usize = 8;
const ASKED: usize = 64;
/// Standard deviations of both parts of fourth and of sixth order before any image is seen.
const EXPECTED: [f64; 4] = [0.3, 0.3, 0.1, 0.1];
/// `t^T V^-1 t` that chance does not make of four numbers: once in 20000 images.
const SURE: f64 = 25.0;
/// One disc in so many is sharper than what is taken for the sharpest.
const SHARPEST: usize = 20;
/// By how much the geometry must move, squared and over its covariance, in the mean over discs.
const FELT: f64 = 0.01;
/// Furthest a disc may be off, of what is typical or of noise.
const FURTHEST: f64 = 20.0;
/// What a fit may leave of the squares that noise explains, or of those that are there: at little noise a shape explains most at once, the rest later.
const MOST_LEFT: f64 = 2.0;
const MOSTLY: f64 = 0.25;
/// Rounds at most, and the squared distance over V below which they end.
const ROUNDS: usize = 5;
const STILL: f64 = 0.1;
/// Half of chi-square of two degrees of freedom lies below.
const MEDIAN: f64 = 1.386;

/// What one disc says.
#[derive(Debug, Clone)]
pub(crate) struct Told {
    pub(crate) information: Matrix2<f64>,
    pub(crate) right: Vector2<f64>,
    /// Change of the geometry in regular coordinates with the shape, px.
    pub(crate) follows: SMatrix<f64, 5, 2>,
    /// Covariance of the geometry, px^2.
    pub(crate) covariance: SMatrix<f64, 5, 5>,
    /// Squares that the fit left, over the noise, and number of pixels.
    pub(crate) squares: f64,
    pub(crate) pixels: f64,
}

/// Sums over the pixels of one disc, from which it tells.
pub(crate) struct Sums {
    mixed: Vec<[f64; 2]>,
    information: Matrix2<f64>,
    right: Vector2<f64>,
    squares: f64,
    pixels: f64,
}

impl Sums {
    /// None yet, for `n` unknowns of the disc.
    pub(crate) fn new(n: usize) -> Self {
        let (information, right) = (Matrix2::zeros(), Vector2::zeros());
        Self { mixed: vec![[0.0; 2]; n], information, right, squares: 0.0, pixels: 0.0 }
    }

    /// Adds a pixel: derivatives of its grey value by the shape and what is left of it, both over the noise, and those by the unknowns.
    #[inline(always)]
    pub(crate) fn add(&mut self, own: &Vector2<f64>, left: f64, column: impl Fn(usize) -> f64) {
        self.information += own * own.transpose();
        self.right += own * left;
        (self.squares, self.pixels) = (self.squares + left * left, self.pixels + 1.0);
        for (k, sums) in self.mixed.iter_mut().enumerate() {
            let value = column(k);
            (sums[0], sums[1]) = (sums[0] + own[0] * value, sums[1] + own[1] * value);
        }
    }

    /// What the disc says, given the factor of its equations, the geometry last.
    pub(crate) fn told(self, dense: &Dense) -> Told {
        let (n, mut follows) = (self.mixed.len(), self.mixed.clone());
        dense.solve_each(&mut follows);
        let known = Matrix2::from_fn(|a, b| (0..n).map(|k| self.mixed[k][a] * follows[k][b]).sum());
        Told {
            information: self.information - known,
            right: self.right,
            follows: SMatrix::from_fn(|i, m| -follows[n - 5 + i][m]),
            covariance: dense.covariance,
            squares: self.squares,
            pixels: self.pixels,
        }
    }
}

impl Told {
    /// How far off a shape is, given as what it adds to that of the fit.
    fn off(&self, beside: &Vector2<f64>) -> f64 {
        let left = self.right - self.information * beside;
        self.information.try_inverse().map_or(0.0, |inverse| left.dot(&(inverse * left)))
    }

    /// Whether noise and a shape explain what it sees.
    fn is_clean(&self) -> bool {
        let left = self.squares - self.off(&Vector2::zeros());
        self.information.determinant() > 0.0 && left < f64::max(MOST_LEFT * self.pixels, MOSTLY * self.squares)
    }

    /// What not knowing the shape better adds to the covariance of the geometry, px^2.
    pub(crate) fn adds(&self, covariance: &Matrix2<f64>) -> SMatrix<f64, 5, 5> {
        self.follows * covariance * self.follows.transpose()
    }

    /// By how much the geometry moves, squared over its covariance.
    fn moved(&self, by: &Vector2<f64>) -> f64 {
        let moved = self.follows * by;
        self.covariance.cholesky().map_or(0.0, |c| moved.dot(&c.solve(&moved)))
    }
}

/// What all discs have in common: t, and s0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shapes {
    common: Vector4<f64>,
    sharpest_px: f64,
}

impl Shapes {
    /// What goes with each part of what is common, at a blur.
    fn parts(&self, blur_px: f64) -> SMatrix<f64, 2, 4> {
        let x = 1.0 - (self.sharpest_px / blur_px).powi(2).min(1.0);
        SMatrix::from_rows(&[[1.0, x * x, 0.0, 0.0].into(), [0.0, 0.0, 1.0, x * x * x].into()])
    }

    fn at(&self, blur_px: f64) -> Shape {
        let [fourth, sixth] = (self.parts(blur_px) * self.common).into();
        Shape { fourth, sixth }
    }
}

/// What one disc says, and the parts of its shape.
struct Said {
    told: Told,
    parts: SMatrix<f64, 2, 4>,
}

/// What discs say together.
#[derive(Debug, Clone, Copy)]
struct Pool {
    common: Vector4<f64>,
    /// Inverse of V.
    weight: Matrix4<f64>,
    /// Mean of what the shapes move.
    felt: f64,
}

impl Pool {
    /// Of discs fitted with what they were thought to have in common; none of none.
    fn of(told: &[Said], fitted: &Vector4<f64>) -> Option<Self> {
        let mut of: Vec<&Said> = told.iter().filter(|x| x.told.is_clean()).collect();
        let prior = Matrix4::from_diagonal(&Vector4::from(EXPECTED.map(|x| x.powi(-2))));
        let (mut out, mut scatter) = (None, 1.0);
        // Those that lie far off are told from what the others say.
        for _ in 0..3 {
            let information = of.iter().fold(prior, |sum, x| sum + x.parts.tr_mul(&x.told.information) * x.parts);
            let right = of.iter().fold(-prior * fitted, |sum, x| sum + x.parts.tr_mul(&x.told.right));
            let beside = information.try_inverse()? * right;
            let common = fitted + beside;
            let off = |x: &Said| x.told.off(&(x.parts * beside));
            let mut all: Vec<f64> = of.iter().map(|x| off(x)).collect();
            scatter = f64::max(median(&mut all)? / MEDIAN, 1.0);
            let felt = of.iter().map(|x| x.told.moved(&(x.parts * common))).sum::<f64>() / of.len() as f64;
            out = Some(Self { common, weight: information / scatter, felt });
            of.retain(|x| off(x) < FURTHEST * scatter);
        }
        out.filter(|_| scatter.is_finite())
    }

    /// Whether there is one for sure, and felt.
    fn is_sure(&self) -> bool {
        self.common.dot(&(self.weight * self.common)) > SURE && self.felt > FELT
    }
}

/// So many of the discs: half of them from all, in order, and half from the quarter with the widest blurs.
fn some_of(blurs_px: &[f64], most: usize) -> Vec<usize> {
    let count = blurs_px.len();
    if count <= most {
        return (0..count).collect();
    }
    let mut by_blur: Vec<usize> = (0..count).collect();
    by_blur.sort_by(|a, b| blurs_px[*b].total_cmp(&blurs_px[*a]).then(a.cmp(b)));
    let half = most / 2;
    let widest = count.div_ceil(4);
    let mut out: Vec<usize> = (0..half).map(|k| k * count / half).collect();
    out.extend((0..half).map(|k| by_blur[k * widest / half]));
    out.sort_unstable();
    out.dedup();
    out
}

/// Gives all discs of an image the shape that they have at the blurs of their lines, from what `ask` hears of some of them.
pub(crate) fn shape_all<'a>(starts: &mut [Start<'a>], ask: impl Fn(&[Start<'a>]) -> Vec<Option<Told>>) {
    let blurs_px: Vec<f64> = starts.iter().map(Start::line_blur_px).collect();
    let mut sorted = blurs_px.clone();
    sorted.sort_by(f64::total_cmp);
    let Some(sharpest_px) = sorted.get(sorted.len() / SHARPEST).copied() else { return };
    let hear = |most: usize, common: Vector4<f64>| {
        let shapes = Shapes { common, sharpest_px };
        let some = some_of(&blurs_px, most);
        let asked: Vec<Start> = some.iter().map(|i| Start { shape: shapes.at(blurs_px[*i]), ..starts[*i] }).collect();
        let said = some.iter().zip(ask(&asked));
        let said: Vec<Said> =
            said.filter_map(|(i, told)| Some(Said { told: told?, parts: shapes.parts(blurs_px[*i]) })).collect();
        Pool::of(&said, &common).filter(Pool::is_sure)
    };
    let Some(mut pool) = hear(FIRST, Vector4::zeros()) else { return };
    for _ in 0..ROUNDS {
        let Some(next) = hear(ASKED, pool.common) else { return };
        let change = next.common - pool.common;
        let still = change.dot(&(next.weight * change)) < STILL;
        pool = next;
        if still {
            break;
        }
    }
    let (shapes, covariance) = (Shapes { common: pool.common, sharpest_px }, pool.weight.try_inverse());
    for (start, blur_px) in starts.iter_mut().zip(blurs_px) {
        let parts = shapes.parts(blur_px);
        start.shape = shapes.at(blur_px);
        start.shape_covariance = covariance.map_or_else(Matrix2::zeros, |v| parts * v * parts.transpose());
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    const SHAPES: Shapes = Shapes { common: Vector4::new(-0.02, -0.08, 0.0, -0.06), sharpest_px: 0.8 };

    /// What a disc says that has such a shape, as a fit with a Gaussian leaves it; its score scatters as its information says.
    fn said(shapes: &Shapes, blur_px: f64, random: &mut Random) -> Said {
        let information = Matrix2::new(4000.0, -3000.0, -3000.0, 9000.0);
        let parts = shapes.parts(blur_px);
        let root = information.cholesky().expect("positive").l();
        let noise = root * Vector2::new(random.gauss(), random.gauss());
        let told = Told {
            information,
            right: information * (parts * shapes.common) + noise,
            follows: SMatrix::from_fn(|i, m| if i == 2 { 0.1 - 0.05 * m as f64 } else { 0.0 }),
            covariance: SMatrix::identity() * 1e-5,
            squares: 500.0,
            pixels: 500.0,
        };
        Said { told, parts }
    }

    /// Errors over V are those of four numbers, one disc with dirt on it or not.
    #[test]
    fn discs_of_many_blurs_tell_what_they_have_in_common() {
        let mut random = Random(3);
        for dirty in [false, true] {
            let mut chi2 = 0.0;
            const IMAGES: usize = 200;
            for _ in 0..IMAGES {
                let blur_px = |k: usize| 0.8 + 0.05 * k as f64;
                let mut all: Vec<Said> = (0..20).map(|k| said(&SHAPES, blur_px(k), &mut random)).collect();
                if dirty {
                    all[7].told.right += Vector2::new(900.0, -1500.0);
                }
                let pool = Pool::of(&all, &Vector4::zeros()).expect("discs");
                assert!(pool.is_sure());
                let off = pool.common - SHAPES.common;
                chi2 += off.dot(&(pool.weight * off)) / (4 * IMAGES) as f64;
            }
            assert!((0.6..1.25).contains(&chi2), "dirty {dirty}: {chi2}");
        }
    }

    #[test]
    fn gaussians_have_no_shape() {
        let mut random = Random(4);
        let none = Shapes { common: Vector4::zeros(), ..SHAPES };
        for _ in 0..300 {
            let all: Vec<Said> = (0..8).map(|k| said(&none, 0.8 + 0.1 * f64::from(k), &mut random)).collect();
            assert!(!Pool::of(&all, &Vector4::zeros()).expect("discs").is_sure());
        }
        assert!(Pool::of(&[], &Vector4::zeros()).is_none());
    }

    /// As many as may be, no disc twice, the widest blurs among them.
    #[test]
    fn half_of_those_that_are_asked_have_the_widest_blurs() {
        let blurs_px: Vec<f64> = (0..100).map(|k| 1.0 + 0.01 * f64::from((37 * k) % 100)).collect();
        let some = some_of(&blurs_px, 8);
        assert!(some.len() >= 6 && some.windows(2).all(|w| w[0] < w[1]), "{some:?}");
        assert!(some.iter().filter(|i| blurs_px[**i] >= 1.75).count() >= 4, "{some:?}");
        assert_eq!(some_of(&blurs_px[..5], 8), [0, 1, 2, 3, 4]);
    }
}
