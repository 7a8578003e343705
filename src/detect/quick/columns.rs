//! Columns of the pixels near the edge and their products, sixteen pixels at a time in single precision.
//!
//! The grey values come less what the model already says, so that single precision is precise enough: sums of what is left are as wrong
//! as their last digit, seven digits below what is left. The formulas are those of [`crate::conic`]'s foot points and of
//! [`crate::detect::profile`], which stay the plain path (`columns_are_those_of_the_plain_profile`).

mod steps;

use super::{ALL, BENDS, LIGHTS, M, N, PLAIN, PRODUCTS, place};
use crate::conic::Frame;
use crate::detect::shape::Shape;
use crate::lanes::{Kernel, Lanes, SINGLES, Singles, sum_of_singles};
use steps::{Edge, PART, Steps};

/// Pixels whose columns are stored before their products are taken; a multiple of [`SINGLES`]. As many as the nearest cache holds: the sums are put
/// away after each block.
pub(super) const BLOCK: usize = 256;
/// Places in a group.
const FIRST: [f32; SINGLES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];
/// Newton steps of a foot point at most.
const STEPS: usize = 6;
/// A step below this, times the square of the ratio of the axes, is the last: it leaves about its square, 1e-5, which moves a foot point along the
/// contour, but its distance by nothing that single precision holds.
const LAST_STEP: f64 = 0.006;
/// Ratio of the axes up to which the distance of a pixel is in the guess of its foot point, and the least part of what it is without that it is then.
const ROUND: f64 = 1.4;
const LEAST_GUESS: f32 = 0.3;
/// Pixels that are collected together.
pub(super) const EIGHT: usize = 8;

/// Pixels near the edge, in the frame of the axes. The lists only ever grow: what follows the pixels that count is of no meaning, and
/// finite.
#[derive(Debug, Default)]
pub(super) struct Near {
    x: Vec<f32>,
    y: Vec<f32>,
    grey: Vec<f32>,
    /// Pixels that count; they come first.
    pub(super) count: usize,
}

impl Near {
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// Room for `more` pixels, which count from now on, in whole eights; returns the place of the first.
    #[inline(always)]
    pub(super) fn make_room(&mut self, more: usize) -> usize {
        let (first, end) = (self.count, self.count + more.next_multiple_of(EIGHT));
        if self.grey.len() < end {
            let room = (2 * end).div_ceil(SINGLES) * SINGLES;
            for list in [&mut self.x, &mut self.y, &mut self.grey] {
                list.resize(room, 0.0);
            }
        }
        self.count += more;
        first
    }

    /// The eight places from one on, for which there is room: `x`, `y`, grey value. What is too much is of no meaning.
    #[inline(always)]
    pub(super) fn eight(&mut self, first: usize) -> [&mut [f32; EIGHT]; 3] {
        [&mut self.x, &mut self.y, &mut self.grey].map(|list| &mut list[first..first + EIGHT].as_chunks_mut().0[0])
    }

    /// Places of eight pixels.
    #[inline(always)]
    pub(super) fn places(&self, first: usize) -> [[f64; EIGHT]; 2] {
        [&self.x, &self.y].map(|list| {
            let mut out = [0.0; EIGHT];
            list[first..first + EIGHT].iter().zip(&mut out).for_each(|(x, out)| *out = f64::from(*x));
            out
        })
    }

    /// Fills up to a multiple of [`SINGLES`] with pixels on the contour at `(a, 0)`.
    pub(super) fn fill_up(&mut self, a: f64) {
        let (count, n) = (self.count, self.padded());
        if n > count {
            // The lists have a multiple of as many places.
            self.x[count..n].fill(a as f32);
            self.y[count..n].fill(0.0);
            self.grey[count..n].fill(0.0);
        }
    }

    /// The number of pixels, filled up.
    fn padded(&self) -> usize {
        self.count.div_ceil(SINGLES) * SINGLES
    }
}

/// What the pixels are seen through.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lens {
    pub(super) blur_px: f64,
    pub(super) shape: Shape,
    /// Noise variance inside and outside, grey^2.
    pub(super) variance: [f64; 2],
    /// Level and slopes of the light inside and outside, then what is of second degree, grey.
    pub(super) light: [f64; LIGHTS + BENDS],
}

/// The columns, block by block, each times the root of its weight: light, blur, geometry, what is left of the grey value, and where the
/// light bends its second degree.
#[derive(Debug)]
pub(super) struct Columns {
    pub(super) values: Vec<[[f32; BLOCK]; ALL]>,
    /// Derivative of the grey value by the distance from the edge, times the root of the weight.
    pub(super) response: Vec<f32>,
    /// Angle of the foot point on the diamond, see [`crate::detect::contour`].
    pub(super) diamond: Vec<f32>,
    /// Cell of the contour that it lies in.
    pub(super) cell: Vec<u32>,
    /// What is left of the grey value, over the noise, once [`super::shares::ShareOut`] has run.
    pub(super) left: Vec<f32>,
    /// What each pixel adds to the sums of its sector, and these.
    pub(super) terms: Vec<[f32; 4]>,
    pub(super) sums: Vec<[f32; 4]>,
    /// Unit vectors of the foot points of a block, and what is left to do of each.
    feet: [[f32; BLOCK]; 3],
    /// What is known of the pixels that are worked on.
    steps: Steps,
    /// Sums of products of two columns, of pixels that are as many apart as there are in a group.
    apart: [[f32; SINGLES]; PRODUCTS],
    /// The same of all pixels.
    pub(super) gram: [f64; PRODUCTS],
}

impl Default for Columns {
    fn default() -> Self {
        Self {
            values: vec![],
            response: vec![],
            diamond: vec![],
            cell: vec![],
            left: vec![],
            terms: vec![],
            sums: vec![],
            feet: [[0.0; BLOCK]; 3],
            steps: Steps::default(),
            apart: [[0.0; SINGLES]; PRODUCTS],
            gram: [0.0; PRODUCTS],
        }
    }
}

/// Makes the columns and takes their products; those of the second degree where the light is `BENT`.
pub(super) struct SumUp<'a, const BENT: bool> {
    pub(super) near: &'a Near,
    pub(super) frame: &'a Frame,
    pub(super) lens: &'a Lens,
    pub(super) out: &'a mut Columns,
}

impl<const BENT: bool> Kernel for SumUp<'_, BENT> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        if BENT {
            self.of::<L::Single, PRODUCTS>();
        } else {
            self.of::<L::Single, PLAIN>();
        }
    }
}

impl<const BENT: bool> SumUp<'_, BENT> {
    #[inline(always)]
    fn of<S: Singles, const P: usize>(self) {
        let n = self.near.padded();
        let blocks = n.div_ceil(BLOCK);
        if self.out.values.len() < blocks {
            self.out.values.resize(blocks, [[0.0; BLOCK]; ALL]);
        }
        if self.out.response.len() < n {
            self.out.response.resize(n, 0.0);
            self.out.diamond.resize(n, 0.0);
        }
        let count = S::splat(self.near.count as f32);
        let seen = Seen::<S>::new(self.frame, self.lens);
        let used = if BENT { ALL } else { M };
        let Columns { values, response, diamond, feet, steps, apart, gram, .. } = self.out;
        for block in 0..blocks {
            let from = block * BLOCK;
            let m = (n - from).min(BLOCK);
            let values = &mut values[block];
            let [xs, ys, greys] = [&self.near.x, &self.near.y, &self.near.grey].map(|list| &list[from..from + m]);
            let [responses, diamonds] = [&mut *response, &mut *diamond].map(|list| &mut list[from..from + m]);
            seen.feet([xs, ys], feet);
            for part in (0..m).step_by(PART) {
                let mut k = 0;
                // Said so that no place needs to be checked.
                while k + S::N <= PART && part + k + S::N <= m && m <= BLOCK {
                    let i = part + k;
                    let [x, y, c, s] = [&xs[i..], &ys[i..], &feet[0][i..], &feet[1][i..]].map(S::load);
                    let foot = seen.foot(x, y, c, s);
                    steps.put_foot(k, &foot, &seen.curve(&foot));
                    k += S::N;
                }
                steps.find_profiles(&seen, m - part);
                let mut k = 0;
                while k + S::N <= PART && part + k + S::N <= m && m <= BLOCK {
                    let i = part + k;
                    let [x, y, grey] = [&xs[i..], &ys[i..], &greys[i..]].map(S::load);
                    // Single precision counts up to 16 million pixels.
                    let index = S::splat((from + i) as f32) + S::load(&FIRST);
                    let shown = S::select(index.below(count), S::splat(1.0), S::splat(0.0));
                    let (foot, edge, root) = steps.found(k);
                    let (columns, response) = seen.pixel::<BENT>(foot, &edge, [x, y, grey, shown * root]);
                    for k in 0..used {
                        columns[k].store(&mut values[k][i..]);
                    }
                    response.store(&mut responses[i..]);
                    diamond_of(foot[0], foot[1]).store(&mut diamonds[i..]);
                    k += S::N;
                }
            }
            let mut out = Put { sums: apart, first: block == 0 };
            products::<S>(values, m, &mut out);
            if BENT {
                products_of_bends::<S>(values, m, &mut out);
            }
        }
        for k in 0..P {
            gram[k] = sum_of_singles(&apart[k]);
        }
    }
}

/// Where sums of products over a block go: in place of what was there, for the first block, or added to it.
struct Put<'a> {
    sums: &'a mut [[f32; SINGLES]; PRODUCTS],
    first: bool,
}

impl Put<'_> {
    #[inline(always)]
    fn put<S: Singles>(&mut self, product: usize, part: usize, sum: S) {
        let own = &mut self.sums[product][part..];
        let sum = if self.first { sum } else { S::load(own) + sum };
        sum.store(own);
    }
}

/// Products of the first `m` pixels of a block, tile by tile: numbers once loaded serve a whole tile, of which only what lies in the lower triangle
/// is computed. No tile has more sums than registers.
#[inline(always)]
fn products<S: Singles>(values: &[[f32; BLOCK]; ALL], m: usize, out: &mut Put) {
    tile::<S, 4, 4>(values, m, 0, 0, out);
    tile::<S, 2, 6>(values, m, 4, 0, out);
    tile::<S, 2, 6>(values, m, 6, 0, out);
    tile::<S, 2, 6>(values, m, 8, 0, out);
    tile::<S, 2, 6>(values, m, 10, 0, out);
    tile::<S, 4, 4>(values, m, 6, 6, out);
    tile::<S, 2, 6>(values, m, 10, 6, out);
    tile::<S, 1, 13>(values, m, 12, 0, out);
}

/// Those with columns of the second degree.
#[inline(always)]
fn products_of_bends<S: Singles>(values: &[[f32; BLOCK]; ALL], m: usize, out: &mut Put) {
    for second in [0, 4, 8, 12] {
        tile::<S, 3, 4>(values, m, 13, second, out);
        tile::<S, 3, 4>(values, m, 16, second, out);
    }
    tile::<S, 3, 3>(values, m, 16, 16, out);
}

/// Products of `A` columns from `first` on with `B` columns from `second` on, as far as these are not beyond those.
#[inline(always)]
fn tile<S: Singles, const A: usize, const B: usize>(
    values: &[[f32; BLOCK]; ALL],
    m: usize,
    first: usize,
    second: usize,
    out: &mut Put,
) {
    let m = m.min(BLOCK);
    let mut part = 0;
    while part < SINGLES {
        let mut sum = [[S::splat(0.0); B]; A];
        let mut at = part;
        while at + S::N <= m {
            let mut a = [S::splat(0.0); A];
            for k in 0..A {
                a[k] = S::load(&values[first + k][at..]);
            }
            for l in 0..B {
                let b = if second + l < first { S::load(&values[second + l][at..]) } else { a[second + l - first] };
                for k in 0..A {
                    if second + l <= first + k {
                        sum[k][l] = a[k].fused(b, sum[k][l]);
                    }
                }
            }
            at += SINGLES;
        }
        for k in 0..A {
            for l in 0..B {
                if second + l <= first + k {
                    out.put(place(first + k, second + l), part, sum[k][l]);
                }
            }
        }
        part += S::N;
    }
}

/// The ellipse, its blur and its light, in every lane.
struct Seen<S> {
    a: S,
    b: S,
    inverse_a: S,
    inverse_b: S,
    ab: S,
    e2: S,
    cos: S,
    sin: S,
    cos2: S,
    sin2: S,
    /// The sine turned negative; `(a + b) / a` times that of the doubled angle turned negative, and its cosine.
    less_sin: S,
    across: [S; 2],
    /// Twice the product of the axes, none of contours that are not round; the last of Newton's steps for foot points.
    two_ab: S,
    last_step: S,
    blur: S,
    inverse_blur: S,
    /// What it has of fourth and sixth order, where it is no Gaussian.
    shape: Option<[S; 2]>,
    variance: [S; 2],
    light: [S; LIGHTS + BENDS],
}

/// A foot point.
struct Foot<S> {
    cos: S,
    sin: S,
    distance: S,
    /// One over `((b cos)^2 + (a sin)^2)^(1/2)`.
    inverse: S,
}

impl<S: Singles> Seen<S> {
    #[inline(always)]
    fn new(frame: &Frame, lens: &Lens) -> Self {
        let one = |x: f64| S::splat(x as f32);
        let mut light = [S::splat(0.0); LIGHTS + BENDS];
        for k in 0..LIGHTS + BENDS {
            light[k] = one(lens.light[k]);
        }
        Self {
            a: one(frame.a),
            b: one(frame.b),
            inverse_a: one(1.0 / frame.a),
            inverse_b: one(1.0 / frame.b),
            ab: one(frame.a * frame.b),
            e2: one(frame.a * frame.a - frame.b * frame.b),
            cos: one(frame.cos),
            sin: one(frame.sin),
            cos2: one(frame.cos2),
            sin2: one(frame.sin2),
            less_sin: one(-frame.sin),
            across: [-frame.sin2, frame.cos2].map(|x| one((frame.a + frame.b) / frame.a * x)),
            two_ab: one(if frame.a < ROUND * frame.b { 2.0 * frame.a * frame.b } else { 0.0 }),
            last_step: one(LAST_STEP * (frame.b * frame.b) / (frame.a * frame.a)),
            blur: one(lens.blur_px),
            inverse_blur: one(1.0 / lens.blur_px),
            shape: (!lens.shape.is_gaussian()).then(|| [lens.shape.fourth, lens.shape.sixth].map(one)),
            variance: [one(lens.variance[0]), one(lens.variance[1])],
            light,
        }
    }

    /// Columns and response of a pixel.
    #[inline(always)]
    fn pixel<const BENT: bool>(
        &self,
        [c, s, inverse]: [S; 3],
        edge: &Edge<S>,
        [x, y, grey, root]: [S; 4],
    ) -> ([S; ALL], S) {
        let one = S::splat(1.0);
        let (nx, ny) = (self.b * c * inverse, self.a * s * inverse);
        let (p, slope) = (edge.inside, edge.slope);
        let q = one - p;
        let (px, py) = (x * self.inverse_a, y * self.inverse_b);
        let moved = self.blur * self.blur * slope;
        let (bx, by) = (px.fused(p, moved * nx * self.inverse_a), py.fused(p, moved * ny * self.inverse_b));
        let (ox, oy) = (px - bx, py - by);
        let light = &self.light;
        let mut step = (light[1] - light[4]).fused(c, (light[2] - light[5]).fused(s, light[0] - light[3]));
        if BENT {
            let (twice, two) = ((c - s) * (c + s), c * s + c * s);
            step = (light[7] - light[10]).fused(twice, (light[8] - light[11]).fused(two, step));
        }
        let h = root * step * slope;
        // Along the axes of the ellipse, less than nothing as the distance falls where the ellipse grows; of `(a + b) c s / N` that of `ny = a s / N`.
        let (hx, hy) = (-(h * nx), -(h * ny));
        let (da, db, across) = (hx * c, hy * s, hy * c);
        let along = da - db;
        let inside = light[0].fused(p, light[1].fused(bx, light[2] * by));
        let mut model = inside + light[3].fused(q, light[4].fused(ox, light[5] * oy));
        let mut columns = [S::splat(0.0); ALL];
        if BENT {
            let bends = self.bends(px, py, nx, ny, edge);
            for k in 0..BENDS {
                model = light[LIGHTS + k].fused(bends[k], model);
                columns[M + k] = root * bends[k];
            }
        }
        columns[0] = root * p;
        columns[1] = root * bx;
        columns[2] = root * by;
        columns[3] = root * q;
        columns[4] = root * ox;
        columns[5] = root * oy;
        columns[6] = root * step * edge.by_blur;
        columns[7] = self.cos.fused(hx, self.less_sin * hy);
        columns[8] = self.sin.fused(hx, self.cos * hy);
        columns[9] = da + db;
        columns[10] = self.cos2.fused(along, self.across[0] * across);
        columns[11] = self.sin2.fused(along, self.across[1] * across);
        columns[N] = root * (grey - model);
        (columns, h)
    }

    /// `X^2 + Y^2 - 1`, `X^2 - Y^2`, `2 X Y` times the profile, then times what it leaves, as [`crate::detect::surface`].
    #[inline(always)]
    fn bends(&self, px: S, py: S, nx: S, ny: S, edge: &Edge<S>) -> [S; BENDS] {
        let (one, two) = (S::splat(1.0), S::splat(2.0));
        let (p, s2) = (edge.inside, self.blur * self.blur);
        let (gx, gy) = (edge.slope * nx * self.inverse_a, edge.slope * ny * self.inverse_b);
        // Second derivatives of the profile, across and along the contour.
        let (across, along) = (-(edge.slope * edge.depth * self.inverse_blur), edge.kappa * edge.slope);
        let (turn, mixed) = (across - along, self.inverse_a * self.inverse_b);
        let xx = (along + turn * nx * nx) * (self.inverse_a * self.inverse_a);
        let yy = (along + turn * ny * ny) * (self.inverse_b * self.inverse_b);
        let xy = turn * nx * ny * mixed;
        let (x2, y2, xy2) = (px * px, py * py, two * px * py);
        let (first, second) = (two * s2, s2 * s2);
        let (gxx, gyy) = (px * gx, py * gy);
        let rho = (x2 + y2) - one;
        let inside = [
            rho * p + first * (gxx + gyy) + second * (xx + yy),
            (x2 - y2) * p + first * (gxx - gyy) + second * (xx - yy),
            xy2 * p + first * (py * gx + px * gy) + second * two * xy,
        ];
        [inside[0], inside[1], inside[2], rho - inside[0], (x2 - y2) - inside[1], xy2 - inside[2]]
    }

    /// Eccentric angles of the foot points as unit vectors, `cos` and `sin` in the first two lists; the third says how much of a step is left
    /// to take. Newton steps of a whole block side by side, so that none waits for the one before; each lane ends by itself, so that its bits
    /// do not hang on the others. They begin, `d` off the contour, with `N` of [`Foot::inverse`], at
    ///
    /// ```text
    /// x = c (a + b d / N),  y = s (b + a d / N)
    /// d / N about (q - 1) a b / N^2,  q^2 = (x/a)^2 + (y/b)^2,  q - 1 about 2 (q^2 - 1) / (q^2 + 3),  N^2 about ((b x/a)^2 + (a y/b)^2) / q^2
    /// ```
    #[inline(always)]
    fn feet(&self, [x, y]: [&[f32]; 2], feet: &mut [[f32; BLOCK]; 3]) {
        let one = S::splat(1.0);
        let m = x.len().min(y.len()).min(BLOCK);
        let [cos, sin, left] = feet;
        let mut i = 0;
        while i + S::N <= m {
            let (x, y) = (S::load(&x[i..]), S::load(&y[i..]));
            let (px, py) = (x * self.inverse_a, y * self.inverse_b);
            let (square, n2) = (px.fused(px, py * py), self.n2(px, py));
            let (d, all) = (self.two_ab * (square - one) * square, (square + S::splat(3.0)) * n2);
            let (least_b, least_a) = (self.b * all, self.a * all);
            let p = x * self.a.fused(d, least_b).at_least(least_b * S::splat(LEAST_GUESS));
            let q = y * self.b.fused(d, least_a).at_least(least_a * S::splat(LEAST_GUESS));
            let scale = one / p.fused(p, q * q).sqrt().at_least(S::splat(1e-30));
            (p * scale).store(&mut cos[i..]);
            (q * scale).store(&mut sin[i..]);
            one.store(&mut left[i..]);
            i += S::N;
        }
        for _ in 0..STEPS {
            let (mut moving, mut i) = (S::splat(0.0), 0);
            while i + S::N <= m {
                let at = [S::load(&cos[i..]), S::load(&sin[i..]), S::load(&left[i..])];
                let [c, s, more] = self.turned(at, S::load(&x[i..]), S::load(&y[i..]));
                c.store(&mut cos[i..]);
                s.store(&mut sin[i..]);
                more.store(&mut left[i..]);
                moving = moving.at_least(more);
                i += S::N;
            }
            if S::all(moving.below(one)) {
                break;
            }
        }
    }

    #[inline(always)]
    fn n2(&self, px: S, py: S) -> S {
        let (along, across) = (self.b * px, self.a * py);
        along.fused(along, across * across)
    }

    /// One Newton step for the zero of `f(t) = e2 c s - a x s + b y c`, half the derivative of the squared distance of `(x, y)` from `(a c, b s)`,
    /// px^2, `c = cos t`, `s = sin t`, `e2 = a^2 - b^2`, in the frame of the axes: unit vector and what is left before and after.
    #[inline(always)]
    fn turned(&self, [c, s, left]: [S; 3], x: S, y: S) -> [S; 3] {
        let (zero, one, half) = (S::splat(0.0), S::splat(1.0), S::splat(0.5));
        let (ax, by) = (x * self.a, y * self.b);
        let f = (self.e2 * c - ax).fused(s, by * c);
        let df = self.e2.fused((c - s) * (c + s), -ax.fused(c, by * s));
        let t = S::select(df.below(zero), -(f / df), zero).at_least(-half).at_most(half) * left;
        // 1 / (1 + t^2)^(1/2) to the last digit for small turns; what it leaves of large ones goes by a step of Newton's for the length.
        let t2 = t * t;
        let inverse = t2.fused(t2.fused(S::splat(0.375), -half), one);
        let (c, s) = ((-t).fused(s, c) * inverse, t.fused(c, s) * inverse);
        let length = left.fused((-half).fused(c.fused(c, s * s), half), one);
        [c * length, s * length, S::select(t.size().below(self.last_step), zero, left)]
    }

    /// The foot point at a unit vector.
    #[inline(always)]
    fn foot(&self, x: S, y: S, c: S, s: S) -> Foot<S> {
        let (one, half, a, b) = (S::splat(1.0), S::splat(0.5), self.a, self.b);
        // What rounding left of the length, by a step of Newton's: near one a root cannot tell 1 + 2^-23 from one, and the foot points of
        // a whole contour would lie outside by the last digit.
        let length = one + (-half).fused(c.fused(c, s * s), half);
        let (c, s) = (c * length, s * length);
        let (bc, sa) = (b * c, a * s);
        let inverse = one / bc.fused(bc, sa * sa).sqrt();
        let distance = (-a).fused(c, x).fused(bc, (-b).fused(s, y) * sa) * inverse;
        Foot { cos: c, sin: s, distance, inverse }
    }
}

/// Angle on the diamond, 0 to 4, as [`crate::detect::contour::diamond`].
#[inline(always)]
fn diamond_of<S: Singles>(c: S, s: S) -> S {
    let zero = S::splat(0.0);
    let x = s / (c.size() + s.size());
    let right = S::select(s.below(zero), S::splat(4.0) + x, x);
    S::select(c.below(zero), S::splat(2.0) - x, right)
}

const _: () =
    assert!(N + 1 == M && M == 13 && ALL == 19, "the tiles cover thirteen columns, and six of the second degree");

#[cfg(test)]
mod tests;
