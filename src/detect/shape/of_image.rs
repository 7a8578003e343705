//! The shape of the blur of one image, told by all of its discs together.
//!
//! Beside its two numbers c and e a blur may be wider along one direction of the image than across: motion, an oblique window. Its covariance is
//! `s^2 (1 + p, q; q, 1 - p)` then, and adds to the share g of the disc in a pixel, to first order,
//!
//! ```text
//! s^2/2 (p (g_uu - g_vv) + 2 q g_uv),   of which along the normal, at the angle f from u:   s^2/2 (g_nn - g_tt) (p cos 2f + q sin 2f)
//! ```
//!
//! Disc i, fitted with `x0 = (c, e, 0, 0)`, says by its score `g_i` and information `S_i` where x = (c, e, p, q) is ([`Told`]): with `C_i` the
//! derivatives of the grey values by x, over the noise, `J_i` those by all unknowns of the disc, `A_i` their equations and `r_i` what these left,
//!
//! ```text
//! S_i = C^T C - C^T J A^-1 J^T C,   g_i = C^T r,   geometry follows by -A^-1 J^T C
//! ```
//!
//! Where focus differs over the image so does the shape. A blur of disc and Gaussian, s0 the Gaussian's, has of fourth order what goes with `x^2`, and of
//! sixth with `x^3`, `x = 1 - (s0 / s)^2`. So disc i, whose line shows the blur s_i, has
//!
//! ```text
//! (c, e, p, q)_i = B_i t,   B_i = (1 x_i^2 . . . .; . . 1 x_i^3 . .; . . . . 1 .; . . . . . 1),   s0 that of the sharpest discs
//! ```
//!
//! and with a prior `N(0, diag(0.3, 0.3, 0.1, 0.1, 0.3, 0.3)^2)`, `Lambda`,
//!
//! ```text
//! V = f (sum_i B^T S_i B + Lambda)^-1,   t = (sum_i B^T S_i B + Lambda)^-1 sum_i B^T (S_i B t0 + g_i)
//! ```
//!
//! t0 being what the discs were fitted with and f by how much discs differ more than noise makes them. Discs that lie far off have dirt on them and no say, nor
//! have those that are known to be full of smoke or feel a neighbour's light. Of small bright ones that may be full of smoke four must say the same.
//! A few are asked first, half of them of the widest blurs: where these show nothing for sure, or what would move no contour, it is a Gaussian. Fits have the shape;
//! what p and q do to the geometry is added to what they find.

use super::{Shape, orders_of_edge};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::dense::Dense;
use crate::detect::profile::Profile;
use crate::detect::refine::Start;
use crate::lanes::{self, Kernel};
use crate::stats::median;
use nalgebra::{Matrix4, Matrix6, SMatrix, SVector, Vector4, Vector6};

/// Discs that are asked first, and at most.
const FIRST: usize = 5;
const ASKED: usize = 64;
/// Bright discs that must say the same where they may be full of smoke.
const LEAST_SMOKY: usize = 4;
/// So many times as many are looked at for those that say of nothing else.
const MORE: usize = 3;
/// Gap to a neighbour, of which a fit looks at three fifths, over the blur from which its skirt is not felt: 3.6 blurs from it. A neighbour that is felt narrows
/// the blur that a line shows, which is taken for no less than this, px.
const CLEAR_BLURS: f64 = 9.0;
const LEAST_BLUR_PX: f64 = 1.0;
/// Numbers of a disc, and those that all have in common.
const OWN: usize = 4;
const COMMON: usize = 6;
/// Standard deviations of these before any image is seen.
const EXPECTED: [f64; COMMON] = [0.3, 0.3, 0.1, 0.1, 0.3, 0.3];
/// `t^T V^-1 t` that chance does not make of six numbers: once in 20000 images.
const SURE: f64 = 30.0;
/// One disc in so many is sharper than what is taken for the sharpest.
const SHARPEST: usize = 20;
/// By how much the geometry must move, squared and over its covariance, in the mean over discs.
const FELT: f64 = 0.01;
/// Furthest a disc may be off, of what is typical or of noise.
const FURTHEST: f64 = 30.0;
/// What a fit may leave of the squares that noise explains, or of those that are there: at little noise a shape explains most at once, the rest later.
const MOST_LEFT: f64 = 2.0;
const MOSTLY: f64 = 0.25;
/// Rounds at most, and the squared distance over V below which they end.
const ROUNDS: usize = 5;
const STILL: f64 = 0.1;
/// Half of chi-square of four degrees of freedom lies below.
const MEDIAN: f64 = 3.357;

/// What one disc says.
#[derive(Debug, Clone)]
pub(crate) struct Told {
    pub(crate) information: Matrix4<f64>,
    pub(crate) right: Vector4<f64>,
    /// Change of the geometry in regular coordinates with the shape, px.
    pub(crate) follows: SMatrix<f64, 5, OWN>,
    /// Covariance of the geometry, px^2.
    pub(crate) covariance: SMatrix<f64, 5, 5>,
    /// Squares that the fit left, over the noise, and number of pixels.
    pub(crate) squares: f64,
    pub(crate) pixels: f64,
}

/// What [`LANES`] pixels see of the edge near them: their distances from it, and the eccentric angles of their foot points.
pub(crate) struct Edges {
    pub(crate) profile: Profile,
    /// Cosine and sine of the angle of the major axis.
    pub(crate) turn: [f64; 2],
    pub(crate) distance: [f64; LANES],
    pub(crate) cos: [f64; LANES],
    pub(crate) sin: [f64; LANES],
}

impl Kernel for Edges {
    /// Derivatives of the share of the disc by c, e, p and q, and by the distance.
    type Output = ([[f64; LANES]; OWN], [f64; LANES]);
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) -> Self::Output {
        let Profile { blur_px, a, b, .. } = self.profile;
        let seen = self.profile.at(&self.distance, &self.cos, &self.sin);
        let mut out = [[0.0; LANES]; OWN];
        for l in 0..LANES {
            let (x, y) = (b * self.cos[l], a * self.sin[l]);
            let square = x * x + y * y;
            let length = square.sqrt();
            let kappa = a * b / (square * length);
            let orders = orders_of_edge(seen.depth[l], blur_px * kappa);
            for (k, order) in orders.iter().enumerate() {
                out[k][l] = seen.density[l] * order.share;
            }
            // g_nn - g_tt, as the second derivatives of `surface`.
            let bend = -seen.slope[l] * (seen.depth[l] / blur_px + kappa) / square;
            [out[2][l], out[3][l]] = by_stretch(blur_px, [bend * x * x, bend * x * y, bend * y * y], self.turn);
        }
        (out, seen.slope)
    }
}

/// Derivatives by p and q of what has the second derivatives xx, xy, yy (1/px^2) in a frame that is turned by the angle with this cosine and sine; what is
/// alike in all directions says nothing.
pub(crate) fn by_stretch(blur_px: f64, [xx, xy, yy]: [f64; 3], [cos, sin]: [f64; 2]) -> [f64; 2] {
    let (half, along, mixed) = (0.5 * blur_px * blur_px, xx - yy, 2.0 * xy);
    let (cos2, sin2) = ((cos - sin) * (cos + sin), 2.0 * cos * sin);
    [half * (along * cos2 - mixed * sin2), half * (along * sin2 + mixed * cos2)]
}

/// Sums over the pixels of one disc, from which it tells: pixels that are [`LANES`] apart go into one.
pub(crate) struct Sums {
    /// Of products with the columns of the unknowns.
    mixed: Vec<[[f64; LANES]; OWN]>,
    information: [[[f64; LANES]; OWN]; OWN],
    right: [[f64; LANES]; OWN],
    squares: [f64; LANES],
    pixels: usize,
    /// The columns of the unknowns at the pixels that are added.
    pub(crate) columns: Vec<[f64; LANES]>,
}

impl Sums {
    /// None yet, for `n` unknowns of the disc.
    pub(crate) fn new(n: usize) -> Self {
        let none = [0.0; LANES];
        Self {
            mixed: vec![[none; OWN]; n],
            information: [[none; OWN]; OWN],
            right: [none; OWN],
            squares: none,
            pixels: 0,
            columns: vec![none; n],
        }
    }

    /// Adds the first `count` of some pixels, whose columns are set: derivatives of their grey values by what is told, and what is left of these, over the noise.
    pub(crate) fn add(&mut self, mut own: [[f64; LANES]; OWN], mut left: [f64; LANES], count: usize) {
        for l in count.min(LANES)..LANES {
            own.iter_mut().for_each(|own| own[l] = 0.0);
            left[l] = 0.0;
        }
        self.pixels += count.min(LANES);
        lanes::run(Add { sums: self, own: &own, left: &left });
    }

    /// What the disc says, given the factor of its equations, the geometry last.
    pub(crate) fn told(self, dense: &Dense) -> Told {
        let n = self.mixed.len();
        let mixed: Vec<[f64; OWN]> = self.mixed.iter().map(|sums| sums.map(|x| lanes::sum(&x))).collect();
        let mut follows = mixed.clone();
        dense.solve_each(&mut follows);
        let known = Matrix4::from_fn(|a, b| (0..n).map(|k| mixed[k][a] * follows[k][b]).sum());
        Told {
            information: Matrix4::from_fn(|a, b| lanes::sum(&self.information[a.max(b)][a.min(b)])) - known,
            right: Vector4::from_fn(|a, _| lanes::sum(&self.right[a])),
            follows: SMatrix::from_fn(|i, m| -follows[n - 5 + i][m]),
            covariance: dense.covariance,
            squares: lanes::sum(&self.squares),
            pixels: self.pixels as f64,
        }
    }
}

/// [`Sums::add`] as wide as the processor is.
struct Add<'a> {
    sums: &'a mut Sums,
    own: &'a [[f64; LANES]; OWN],
    left: &'a [f64; LANES],
}

impl Kernel for Add<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) {
        let Self { sums, own, left } = self;
        for m in 0..OWN {
            for k in 0..=m {
                add_products(&mut sums.information[m][k], &own[m], &own[k]);
            }
            add_products(&mut sums.right[m], &own[m], left);
        }
        add_products(&mut sums.squares, left, left);
        for (mixed, column) in sums.mixed.iter_mut().zip(&sums.columns) {
            for m in 0..OWN {
                add_products(&mut mixed[m], &own[m], column);
            }
        }
    }
}

#[inline(always)]
fn add_products(sums: &mut [f64; LANES], a: &[f64; LANES], b: &[f64; LANES]) {
    for l in 0..LANES {
        sums[l] += a[l] * b[l];
    }
}

impl Told {
    /// How far off a shape is, given as what it adds to that of the fit.
    fn off(&self, beside: &Vector4<f64>) -> f64 {
        let left = self.right - self.information * beside;
        self.information.try_inverse().map_or(0.0, |inverse| left.dot(&(inverse * left)))
    }

    /// Whether noise and a shape explain what it sees.
    fn is_clean(&self) -> bool {
        let left = self.squares - self.off(&Vector4::zeros());
        self.information.determinant() > 0.0 && left < f64::max(MOST_LEFT * self.pixels, MOSTLY * self.squares)
    }

    /// By how much a blur that is wider along one direction moved the geometry, which the fit did not know, px.
    pub(crate) fn stretched(&self, [p, q]: [f64; 2]) -> SVector<f64, 5> {
        self.follows * Vector4::new(0.0, 0.0, p, q)
    }

    /// What not knowing the shape better adds to the covariance of the geometry, px^2.
    pub(crate) fn adds(&self, covariance: &Matrix4<f64>) -> SMatrix<f64, 5, 5> {
        self.follows * covariance * self.follows.transpose()
    }

    /// By how much the geometry moves, squared over its covariance.
    fn moved(&self, by: &Vector4<f64>) -> f64 {
        let moved = self.follows * by;
        self.covariance.cholesky().map_or(0.0, |c| moved.dot(&c.solve(&moved)))
    }
}

/// What all discs have in common: t, and s0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shapes {
    common: Vector6<f64>,
    sharpest_px: f64,
}

impl Shapes {
    /// What goes with each part of what is common, at a blur.
    fn parts(&self, blur_px: f64) -> SMatrix<f64, OWN, COMMON> {
        let x = 1.0 - (self.sharpest_px / blur_px).powi(2).min(1.0);
        let mut parts = SMatrix::zeros();
        for (i, k, part) in [(0, 0, 1.0), (0, 1, x * x), (1, 2, 1.0), (1, 3, x * x * x), (2, 4, 1.0), (3, 5, 1.0)] {
            parts[(i, k)] = part;
        }
        parts
    }

    /// The shape, and p and q, at a blur.
    fn at(&self, blur_px: f64) -> (Shape, [f64; 2]) {
        let [fourth, sixth, p, q] = (self.parts(blur_px) * self.common).into();
        (Shape { fourth, sixth }, [p, q])
    }
}

/// What one disc says, and the parts of its shape.
struct Said {
    told: Told,
    parts: SMatrix<f64, OWN, COMMON>,
}

/// What discs say together.
#[derive(Debug, Clone, Copy)]
struct Pool {
    common: Vector6<f64>,
    /// Inverse of V.
    weight: Matrix6<f64>,
    /// Mean of what the shapes move.
    felt: f64,
    /// Discs that have a say.
    count: usize,
}

impl Pool {
    /// Of discs fitted with what they were thought to have in common; none of none.
    fn of(told: &[Said], common: &Vector6<f64>) -> Option<Self> {
        // No fit knew of p and q.
        let fitted = Vector6::from_fn(|k, _| if k < COMMON - 2 { common[k] } else { 0.0 });
        let mut of: Vec<&Said> = told.iter().filter(|x| x.told.is_clean()).collect();
        let prior = Matrix6::from_diagonal(&Vector6::from(EXPECTED.map(|x| x.powi(-2))));
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
            out = Some(Self { common, weight: information / scatter, felt, count: of.len() });
            of.retain(|x| off(x) < FURTHEST * scatter);
        }
        out.filter(|_| scatter.is_finite())
    }

    /// Whether there is one for sure, and felt.
    fn is_sure(&self) -> bool {
        self.common.dot(&(self.weight * self.common)) > SURE && self.felt > FELT
    }
}

/// Whether neither smoke that is known nor the skirt of a neighbour looks like a shape of the blur.
fn says_of_blur_alone(start: &Start, blur_px: f64) -> bool {
    let frame = Frame::new(&start.ellipse);
    !start.full_of_smoke
        && start.neighbours.iter().all(|e| frame.least_gap_px(e) > CLEAR_BLURS * blur_px.max(LEAST_BLUR_PX))
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

/// The question for the shape of the blur of one image.
pub(crate) struct Question {
    blurs_px: Vec<f64>,
    sharpest_px: f64,
    /// The discs that are asked first.
    pub(crate) first: Vec<usize>,
    /// How many must say the same.
    least: usize,
}

impl Question {
    pub(crate) fn new(starts: &[Start]) -> Self {
        let blurs_px: Vec<f64> = starts.iter().map(Start::line_blur_px).collect();
        let mut sorted = blurs_px.clone();
        sorted.sort_by(f64::total_cmp);
        let sharpest_px = sorted.get(sorted.len() / SHARPEST).copied().unwrap_or(0.0);
        // Smoke that the blur hides may look like a shape, but hardly like one and the same in several discs.
        let smoky = starts.iter().any(|start| start.bright && start.goes_the_longer_way());
        let mut out = Self { blurs_px, sharpest_px, first: vec![], least: if smoky { LEAST_SMOKY } else { 1 } };
        out.first = out.some(starts, FIRST);
        out
    }

    /// So many of the discs that say of the blur alone.
    fn some(&self, starts: &[Start], most: usize) -> Vec<usize> {
        let mut some = some_of(&self.blurs_px, MORE * most);
        let asked = some.len();
        some.retain(|i| says_of_blur_alone(&starts[*i], self.blurs_px[*i]));
        // Where most are close, what lies alone is no disc of the pattern.
        if 2 * some.len() < asked {
            return vec![];
        }
        some.iter().step_by(some.len().div_ceil(most).max(1)).copied().collect()
    }

    /// What some discs say together, fitted with what they were thought to have in common, if that is sure.
    fn pool(&self, some: &[usize], told: Vec<Option<Told>>, common: &Vector6<f64>) -> Option<Pool> {
        let shapes = Shapes { common: *common, sharpest_px: self.sharpest_px };
        let said = some.iter().zip(told);
        let said = said.filter_map(|(i, told)| Some(Said { told: told?, parts: shapes.parts(self.blurs_px[*i]) }));
        Pool::of(&said.collect::<Vec<_>>(), common).filter(|pool| pool.is_sure() && pool.count >= self.least)
    }

    /// Gives all discs the shape that they have at the blurs of their lines, from what the first, fitted with a Gaussian, told and from what `ask` hears of
    /// more of them; false where it is a Gaussian.
    pub(crate) fn settle<'a>(
        &self,
        starts: &mut [Start<'a>],
        first: Vec<Option<Told>>,
        ask: impl Fn(&[Start<'a>]) -> Vec<Option<Told>>,
    ) -> bool {
        let Some(mut pool) = self.pool(&self.first, first, &Vector6::zeros()) else { return false };
        let some = self.some(starts, ASKED);
        for _ in 0..ROUNDS {
            let shapes = Shapes { common: pool.common, sharpest_px: self.sharpest_px };
            let shaped = |i: &usize| Start { shape: shapes.at(self.blurs_px[*i]).0, ..starts[*i] };
            let told = ask(&some.iter().map(shaped).collect::<Vec<_>>());
            let Some(next) = self.pool(&some, told, &pool.common) else { return false };
            let change = next.common - pool.common;
            let still = change.dot(&(next.weight * change)) < STILL;
            pool = next;
            if still {
                break;
            }
        }
        let shapes = Shapes { common: pool.common, sharpest_px: self.sharpest_px };
        let covariance = pool.weight.try_inverse();
        for (start, blur_px) in starts.iter_mut().zip(&self.blurs_px) {
            let parts = shapes.parts(*blur_px);
            (start.shape, start.stretch) = shapes.at(*blur_px);
            start.shape_covariance = covariance.map_or_else(Matrix4::zeros, |v| parts * v * parts.transpose());
        }
        true
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    const SHAPES: Shapes = Shapes { common: Vector6::new(-0.02, -0.08, 0.0, -0.06, 0.1, -0.05), sharpest_px: 0.8 };

    /// What a disc says that has such a shape, as a fit with a Gaussian leaves it; its score scatters as its information says.
    fn said(shapes: &Shapes, blur_px: f64, random: &mut Random) -> Said {
        let mut information = Matrix4::from_diagonal(&Vector4::new(4000.0, 9000.0, 2000.0, 1500.0));
        (information[(0, 1)], information[(1, 0)]) = (-3000.0, -3000.0);
        let parts = shapes.parts(blur_px);
        let root = information.cholesky().expect("positive").l();
        let noise = root * Vector4::from_fn(|_, _| random.gauss());
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

    /// Errors over V are those of six numbers, one disc with dirt on it or not.
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
                    all[7].told.right += Vector4::new(900.0, -1500.0, 500.0, 0.0);
                }
                let pool = Pool::of(&all, &Vector6::zeros()).expect("discs");
                assert!(pool.is_sure());
                let off = pool.common - SHAPES.common;
                chi2 += off.dot(&(pool.weight * off)) / (COMMON * IMAGES) as f64;
            }
            assert!((0.6..1.25).contains(&chi2), "dirty {dirty}: {chi2}");
        }
    }

    #[test]
    fn gaussians_have_no_shape() {
        let mut random = Random(4);
        let none = Shapes { common: Vector6::zeros(), ..SHAPES };
        for _ in 0..300 {
            let all: Vec<Said> = (0..8).map(|k| said(&none, 0.8 + 0.1 * f64::from(k), &mut random)).collect();
            assert!(!Pool::of(&all, &Vector6::zeros()).expect("discs").is_sure());
        }
        assert!(Pool::of(&[], &Vector6::zeros()).is_none());
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
