//! What a clean disc says of the shape of the blur, a block of pixels at a time in single precision.

use super::columns::{BLOCK, Columns, Near};
use super::few::{KEPT, ORDER};
use super::{ALL, Clean, LIGHTS, M, N, Quick};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::profile::Profile;
use crate::detect::shape::told::{Edges, OWN, Told, Totals};
use crate::lanes::{self, Kernel, Lanes, SINGLES, Singles, sum_of_singles};

/// Columns whose products are taken together with those of all that is told: as many sums as there are registers.
const TOGETHER: usize = 3;

impl Quick {
    /// What the fit left, the sectors being shared out, says of a shape beside the one that it was made with.
    pub(crate) fn shape_told(&self, state: &Clean) -> Option<Told> {
        let n = self.solved;
        let bends = n.checked_sub(N);
        let column = |k: usize| match bends {
            None => ORDER[k],
            Some(bends) if k < bends => M + k,
            Some(bends) => k - bends,
        };
        if n < KEPT || bends.is_none() && n != KEPT {
            return None;
        }
        let order: [usize; ALL] = std::array::from_fn(|k| if k < n { column(k) } else { M });
        let profile = Profile { blur_px: state.blur_px, shape: state.shape, a: self.frame.a, b: self.frame.b };
        let (near, columns, frame) = (&self.pixels.near, &self.columns, &self.frame);
        Some(lanes::run(Tell { near, columns, frame, profile, order: &order[..n] }).told(&self.dense))
    }
}

/// The pixels of a disc, and the columns of its unknowns in their order.
struct Tell<'a> {
    near: &'a Near,
    columns: &'a Columns,
    frame: &'a Frame,
    profile: Profile,
    order: &'a [usize],
}

impl Kernel for Tell<'_> {
    type Output = Totals;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Totals {
        let (n, count) = (self.order.len(), self.near.count);
        let mut totals = Totals::new(n, count);
        let mut own = [[0.0_f32; BLOCK]; OWN];
        for (block, values) in self.columns.values.iter().enumerate().take(count.div_ceil(BLOCK)) {
            let from = block * BLOCK;
            let m = (count - from).min(BLOCK);
            for i in (0..m).step_by(LANES) {
                let shapes = self.shapes::<L>(from, i, m - i);
                for k in 0..OWN {
                    (0..LANES).for_each(|l| own[k][i + l] = shapes[k][l] as f32);
                }
            }
            let padded = m.next_multiple_of(SINGLES);
            own.iter_mut().for_each(|own| own[m..padded].fill(0.0));
            let left = &self.columns.left[from..from + padded];
            for k in (0..n).step_by(TOGETHER) {
                // What is too much is taken twice, and counts once.
                let columns = std::array::from_fn(|j| &values[self.order[(k + j).min(n - 1)]][..padded]);
                for (total, products) in totals.mixed[k..].iter_mut().zip(products::<L::Single>(&own, columns)) {
                    (0..OWN).for_each(|m| total[m] += products[m]);
                }
            }
            let [rest, right, _] = products::<L::Single>(&own, [&own[OWN - 1][..padded], left, left]);
            let information = products::<L::Single>(&own, [&own[0][..padded], &own[1][..padded], &own[2][..padded]]);
            for m in 0..OWN {
                totals.right[m] += right[m];
                (0..TOGETHER).for_each(|k| totals.information[k][m] += information[k][m]);
                totals.information[OWN - 1][m] += rest[m];
            }
            totals.squares += left[..m].iter().map(|x| f64::from(x * x)).sum::<f64>();
        }
        totals
    }
}

impl Tell<'_> {
    /// Derivatives of the grey values of [`LANES`] pixels from one of a block on by what they tell, over the noise; zero where there is no pixel.
    #[inline(always)]
    fn shapes<L: Lanes>(&self, from: usize, i: usize, count: usize) -> [[f64; LANES]; OWN] {
        let Frame { a, b, cos, sin, .. } = *self.frame;
        let values = &self.columns.values[from / BLOCK];
        let [u, v] = [LIGHTS + 1, LIGHTS + 2].map(|k| eight(&values[k][i..]));
        let (response, [x, y]) = (eight(&self.columns.response[from + i..]), self.near.places(from + i));
        let none = [0.0; LANES];
        let turn = [cos, sin];
        let mut edges = Edges { profile: self.profile, turn, distance: none, cos: none, sin: none };
        for l in 0..LANES {
            // The columns of the place are the normal, turned, times less the response.
            let (nx, ny) = (-(cos * u[l] + sin * v[l]) / response[l], -(cos * v[l] - sin * u[l]) / response[l]);
            // N of `conic`: of the foot point (a cos, b sin) the normal is (b cos, a sin) / N.
            let (p, q) = (nx / b, ny / a);
            let length = 1.0 / (p * p + q * q).sqrt();
            let seen = length.is_finite();
            let (c, s) = (if seen { p * length } else { 1.0 }, if seen { q * length } else { 0.0 });
            let distance = (x[l] - a * c) * nx + (y[l] - b * s) * ny;
            (edges.cos[l], edges.sin[l], edges.distance[l]) = (c, s, if seen { distance } else { 0.0 });
        }
        let (mut shapes, slope) = edges.run::<L>();
        for l in 0..LANES {
            let step = if l < count && slope[l].abs() > 1e-9 { response[l] / slope[l] } else { 0.0 };
            shapes.iter_mut().for_each(|shape| shape[l] *= step);
        }
        shapes
    }
}

/// Sums over pixels of the products of what is told with some columns.
#[inline(always)]
fn products<S: Singles>(own: &[[f32; BLOCK]; OWN], columns: [&[f32]; TOGETHER]) -> [[f64; OWN]; TOGETHER] {
    let mut apart = [[[0.0; SINGLES]; OWN]; TOGETHER];
    let m = columns.iter().fold(BLOCK, |m, column| m.min(column.len()));
    for part in (0..SINGLES).step_by(S::N) {
        let mut sums = [[S::splat(0.0); OWN]; TOGETHER];
        let mut at = part;
        while at + S::N <= m {
            let mut seen = [S::splat(0.0); OWN];
            for k in 0..OWN {
                seen[k] = S::load(&own[k][at..]);
            }
            for j in 0..TOGETHER {
                let column = S::load(&columns[j][at..]);
                for k in 0..OWN {
                    sums[j][k] = seen[k].fused(column, sums[j][k]);
                }
            }
            at += SINGLES;
        }
        for j in 0..TOGETHER {
            for k in 0..OWN {
                sums[j][k].store(&mut apart[j][k][part..]);
            }
        }
    }
    let mut out = [[0.0; OWN]; TOGETHER];
    for j in 0..TOGETHER {
        for k in 0..OWN {
            out[j][k] = sum_of_singles(&apart[j][k]);
        }
    }
    out
}

/// The first numbers of a list.
#[inline(always)]
fn eight(list: &[f32]) -> [f64; LANES] {
    let mut out = [0.0; LANES];
    (0..LANES).for_each(|l| out[l] = f64::from(list[l]));
    out
}
