//! The profile of an edge, step by step: what hangs on the foot point, the tail of the normal distribution there, and what both make of it. Each
//! step of many pixels before the next, as a pixel alone waits for each of its roots and divisions.
//!
//! The formulas are those of [`crate::detect::profile`], which stays the plain path.

use super::{Foot, Seen};
use crate::detect::shape::of_edge;
use crate::lanes::Singles;

/// Pixels that are taken through the steps together; a multiple of [`crate::lanes::SINGLES`].
pub(super) const PART: usize = 64;

/// How the contour bends at a foot point, and how far off it a pixel lies.
#[derive(Clone, Copy)]
pub(super) struct Curve<S> {
    kappa: S,
    /// Of fourth order: the term of the contour, and what both terms add to the variance.
    c4: S,
    bends: S,
    /// One over the standard deviation, in units of the blur.
    narrow: S,
    /// Distance in units of the blur, and as the profile sees it.
    along: S,
    depth: S,
}

/// The profile of the edge at a pixel.
#[derive(Clone, Copy)]
pub(super) struct Edge<S> {
    pub(super) inside: S,
    pub(super) slope: S,
    pub(super) by_blur: S,
    /// Distance in units of the blur as the profile sees it, and the curvature of the contour.
    pub(super) depth: S,
    pub(super) kappa: S,
}

/// Foot points, curves, tails, profiles and weights of some pixels.
#[derive(Debug)]
pub(super) struct Steps([[f32; PART]; NUMBERS]);

/// Numbers of a pixel, and where those of the foot point, of its curve, whose last is the depth, of the tail, and of the edge begin.
const NUMBERS: usize = 15;
const FOOT: usize = 0;
const CURVE: usize = 3;
const DEPTH: usize = 8;
const TAIL: usize = 9;
const EDGE: usize = 11;

impl Default for Steps {
    fn default() -> Self {
        Self([[0.0; PART]; NUMBERS])
    }
}

impl Steps {
    /// Those from one on, of the pixels from `i` on.
    #[inline(always)]
    fn put<S: Singles, const K: usize>(&mut self, first: usize, i: usize, numbers: [S; K]) {
        for k in 0..K {
            numbers[k].store(&mut self.0[first + k][i..]);
        }
    }

    #[inline(always)]
    fn get<S: Singles, const K: usize>(&self, first: usize, i: usize) -> [S; K] {
        let mut numbers = [S::splat(0.0); K];
        for k in 0..K {
            numbers[k] = S::load(&self.0[first + k][i..]);
        }
        numbers
    }

    /// First step: foot point and curve.
    #[inline(always)]
    pub(super) fn put_foot<S: Singles>(&mut self, i: usize, foot: &Foot<S>, curve: &Curve<S>) {
        self.put(FOOT, i, [foot.cos, foot.sin, foot.inverse]);
        let Curve { kappa, c4, bends, narrow, along, depth } = *curve;
        self.put(CURVE, i, [kappa, c4, bends, narrow, along, depth]);
    }

    /// Second and third step, of the first `count` or some more: tails, then profiles and roots of the weights.
    #[inline(always)]
    pub(super) fn find_profiles<S: Singles>(&mut self, seen: &Seen<S>, count: usize) {
        let mut i = 0;
        while i < count && i + S::N <= PART {
            let [depth] = self.get(DEPTH, i);
            let (tail, density) = normal_tail::<S>(depth);
            self.put(TAIL, i, [tail, density]);
            i += S::N;
        }
        i = 0;
        while i < count && i + S::N <= PART {
            let [kappa, c4, bends, narrow, along, depth, tail, density] = self.get(CURVE, i);
            let curve = Curve { kappa, c4, bends, narrow, along, depth };
            let edge = seen.shaped(seen.edge(&curve, [tail, density]), &curve, density);
            self.put(EDGE, i, [edge.inside, edge.slope, edge.by_blur, seen.root_of_weight(edge.inside)]);
            i += S::N;
        }
    }

    /// Foot point without its distance, profile, root of the weight.
    #[inline(always)]
    pub(super) fn found<S: Singles>(&self, i: usize) -> ([S; 3], Edge<S>, S) {
        let ([depth], [inside, slope, by_blur, root]) = (self.get(DEPTH, i), self.get(EDGE, i));
        let [cos, sin, inverse, kappa] = self.get(FOOT, i);
        ([cos, sin, inverse], Edge { inside, slope, by_blur, depth, kappa }, root)
    }
}

impl<S: Singles> Seen<S> {
    /// The contour at a foot point.
    #[inline(always)]
    pub(super) fn curve(&self, foot: &Foot<S>) -> Curve<S> {
        let number = |x: f32| S::splat(x);
        let (one, half) = (number(1.0), number(0.5));
        let (blur, i1) = (self.blur, foot.inverse);
        let i2 = i1 * i1;
        let i4 = i2 * i2;
        let i5 = i4 * i1;
        let s2 = blur * blur;
        let kappa = self.ab * (i1 * i2);
        let turned = self.e2 * (foot.sin * foot.cos);
        // kappa'^2 = (3 ab e2 s c / N^6)^2, over kappa = ab / N^3.
        let turn2_over_kappa = (number(9.0) * self.ab) * (turned * turned) * (i4 * i5);
        let c4 = number(5.0 / 72.0).fused(turn2_over_kappa, (number(0.125) * self.ab) * i5);
        let eps = kappa * blur;
        let mean = half.fused(eps, (number(3.0) * s2 * blur) * c4);
        let bends = number(12.0).fused(c4, number(5.0 / 12.0) * turn2_over_kappa) * (kappa * (s2 * s2));
        let eps2 = eps * eps;
        let r = one / half.fused(eps2, one + bends).sqrt();
        let d = foot.distance * self.inverse_blur;
        let y = (d + mean) * r;
        Curve { kappa, c4, bends, narrow: r, along: d, depth: y }
    }

    /// Root of the weight of a pixel, of which the disc covers so much.
    #[inline(always)]
    fn root_of_weight(&self, inside: S) -> S {
        let one = S::splat(1.0);
        one / self.variance[0].fused(inside, self.variance[1] * (one - inside)).sqrt()
    }

    /// The profile, its derivatives by distance and blur, where its tail and density are known.
    #[inline(always)]
    fn edge(&self, curve: &Curve<S>, [tail, f]: [S; 2]) -> Edge<S> {
        let number = |x: f32| S::splat(x);
        let (one, half) = (number(1.0), number(0.5));
        let Curve { kappa, narrow: r, depth: y, .. } = *curve;
        let eps = kappa * self.blur;
        let y2 = y * y;
        // The third cumulant over -6, the fourth over 24, the square of the third over 72.
        let bent = eps * r;
        let bent2 = bent * bent;
        let third = (bent * bent2) * number(-1.0 / 6.0);
        let (fourth, sixth) = (number(0.125) * (bent2 * bent2), half * (third * third));
        let (he2, he3) = (y2 - one, y * (y2 - number(3.0)));
        let he4 = y2.fused(y2 - number(6.0), number(3.0));
        let he5 = y * y2.fused(y2 - number(10.0), number(15.0));
        let he6 = y2.fused(y2.fused(y2 - number(15.0), number(45.0)), -number(15.0));
        let (of_third, of_fourth, of_sixth) = (third * he2, fourth * he3, sixth * he5);
        let inside = f.fused((of_third + of_fourth) + of_sixth, tail);
        let shape = fourth.fused(he4, sixth.fused(he6, third.fused(he3, one)));
        let slope = (f * shape) * (r * -self.inverse_blur);
        let [y_by_blur, widening] = self.depth_by_blur(curve);
        let bends = number(4.0).fused(of_fourth, number(6.0).fused(of_sixth, number(3.0) * of_third));
        let by_blur = f * (self.inverse_blur - widening).fused(bends, -(shape * y_by_blur));
        Edge { inside, slope, by_blur, depth: y, kappa }
    }

    /// Derivative of the depth by the blur, and by what part the profile grows wider beside it.
    #[inline(always)]
    fn depth_by_blur(&self, curve: &Curve<S>) -> [S; 2] {
        let number = |x: f32| S::splat(x);
        let half = number(0.5);
        let Curve { kappa, c4, bends, narrow: r, along: d, depth: y } = *curve;
        let (s2, eps) = (self.blur * self.blur, kappa * self.blur);
        let widening = (half * self.inverse_blur) * number(4.0).fused(bends, eps * eps) * (r * r);
        let mean_by_blur = half.fused(kappa, (number(9.0) * s2) * c4);
        [(-self.inverse_blur).fused(d, mean_by_blur).fused(r, -(y * widening)), widening]
    }

    /// The profile of a blur of another shape.
    #[inline(always)]
    fn shaped(&self, edge: Edge<S>, curve: &Curve<S>, f: S) -> Edge<S> {
        let Some(shape) = self.shape else { return edge };
        let added = of_edge(shape, curve.depth, curve.kappa * self.blur);
        let [y_by_blur, _] = self.depth_by_blur(curve);
        Edge {
            inside: edge.inside + f * added.share,
            slope: edge.slope + (f * added.by_depth) * (curve.narrow * self.inverse_blur),
            by_blur: edge.by_blur + f * (added.by_depth * y_by_blur + added.by_bend * curve.kappa),
            ..edge
        }
    }
}

/// `(Phi(-z), phi(z))` of the normal distribution, as [`crate::detect::sectors::normal_tails`].
#[inline(always)]
fn normal_tail<S: Singles>(z: S) -> (S, S) {
    let number = |x: f32| S::splat(x);
    let x = (z.size() * number(std::f32::consts::FRAC_1_SQRT_2)).at_most(number(6.0));
    let gauss = exp_of_negative(-(x * x));
    let t = number(1.0) / number(0.327_591_1).fused(x, number(1.0));
    let poly = t * powers(t, [0.254_829_6, -0.284_496_74, 1.421_413_7, -1.453_152, 1.061_405_4].map(|x| 0.5 * x));
    let half = poly * gauss;
    let tail = S::select(number(0.0).below(z), half, number(1.0) - half);
    (tail, number(0.398_942_3) * gauss)
}

/// `exp(x)` for `-40 <= x <= 0`: `2^n` times the power series on `|r| <= ln 2 / 2`.
#[inline(always)]
fn exp_of_negative<S: Singles>(x: S) -> S {
    let number = |x: f32| S::splat(x);
    // Adding 1.5 * 2^23 rounds to the nearest whole number.
    let round = number(12_582_912.0);
    let n = x.fused(number(std::f32::consts::LOG2_E), round) - round;
    let r = n.fused(number(2.121_944_4e-4), n.fused(number(-0.693_359_4), x));
    let series = powers(r, [1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0]);
    series * n.power_of_two()
}

/// `c[0] + c[1] x + c[2] x^2 + ...`
#[inline(always)]
fn powers<S: Singles, const K: usize>(x: S, c: [f32; K]) -> S {
    let mut sum = S::splat(c[K - 1]);
    for k in 1..K {
        sum = sum.fused(x, S::splat(c[K - 1 - k]));
    }
    sum
}
