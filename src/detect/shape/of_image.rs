//! The shape of the blur of one image, told by all of its discs together.
//!
//! Each disc says by a score `g_i` and an information `S_i` where its four numbers `x = (c, e, p, q)` are ([`Told`]), fitted with `x0 = (c, e, 0, 0)`.
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
//! have those that are known to be full of smoke or feel a neighbour's light. Of small bright ones that may be full of smoke four must say the same; of
//! dark and printed ones one is enough.
//! A few are asked first, half of them of the widest blurs: where these show nothing for sure, or what would move no contour, it is a Gaussian. Fits have the shape;
//! what p and q do to the geometry is added to what they find.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | t | `Shapes::common` | 6 | 1 | what all discs of an image have in common |
//! | s0 | `Shapes::sharpest_px` | 1 | px | blur of the sharpest discs, as lines show it |
//! | B_i | `Shapes::parts` | 4 x 6 | 1 | how what is common goes into the numbers of a disc |
//! | V | inverse of `Pool::weight` | 6 x 6 | 1 | covariance of t |

use super::Shape;
use super::told::{OWN, Told};
use crate::conic::Frame;
use crate::detect::refine::Start;
use crate::stats::median;
use nalgebra::{Matrix4, Matrix6, SMatrix, Vector6};

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
/// Numbers that all discs have in common.
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
/// Rounds at most, and the squared distance over V below which they end.
const ROUNDS: usize = 5;
const STILL: f64 = 0.1;
/// Half of chi-square of four degrees of freedom lies below.
const MEDIAN: f64 = 3.357;

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
        let smoky = starts.iter().any(|start| start.may_be_full_of_smoke() && start.goes_the_longer_way());
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
    use nalgebra::Vector4;

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
