//! Levels of a block's windows, for each kernel.
//!
//! ```text
//! f(u, v) = sum_i w_i(u - floor u) sum_k w_k(v - floor v) c_(k, i)
//! ```
//! The weights of linear and cubic are polynomials of the position within the pixel as they stand. Those of the others are, with x that
//! position less one half,
//! ```text
//! w_i = e_i(x^2) + x o_i(x^2),   w_(7-i) = e_i(x^2) - x o_i(x^2)
//! ```
//! of degree nine, to 4e-8. Eight windows go side by side: weights with a place in each number, then row by row the samples of each window
//! times one weight, then the sums turned, so that a place in each number again meets its weights across. All is of single precision; sums
//! stand in one order, whether windows are read so or sixteen together ([`super::cluster`]): equal bits on every machine.

use super::chebyshev::{node, parts, powers};
use super::cluster::Cluster;
use super::kernel::{Kernel, MOST_TAPS};
use super::rows::{Places, TOGETHER};
use crate::lanes::{Greys, Lanes, Level, Raster, SINGLES, Several};
use std::hint::black_box;

/// Terms of the even and of the odd part of a weight.
pub(super) const TERMS: usize = 5;

/// Weights of each tap at eight places, across and down; none lies across two lines of the cache.
#[repr(align(32))]
struct Taps([[[f32; 8]; MOST_TAPS]; 2]);

/// What is found at the places of a block.
pub(super) struct Found {
    pub(super) levels: [f32; TOGETHER],
    /// On the way.
    taps: Taps,
}

impl Found {
    pub(super) const NONE: Self = Self { levels: [0.0; TOGETHER], taps: Taps([[[0.0; 8]; MOST_TAPS]; 2]) };
}

/// A kernel with windows of T samples along each axis.
pub(super) trait Weights<const T: usize> {
    /// Where places in a pixel are counted from.
    const FROM: f64;
    /// Levels at the first `n` places, of which every window is whole; some further ones may be looked at.
    fn levels<S: Level, L: Lanes>(&self, raster: &Raster<'_, S, T>, at: &Places, n: usize, found: &mut Found);
}

/// The sample itself.
pub(super) struct Nearest;

impl Weights<1> for Nearest {
    const FROM: f64 = 0.0;
    #[inline(always)]
    fn levels<S: Level, L: Lanes>(&self, raster: &Raster<'_, S, 1>, at: &Places, n: usize, found: &mut Found) {
        for (i, out) in found.levels.iter_mut().enumerate().take(n) {
            *out = raster.window(at.start(i)).number();
        }
    }
}

#[inline(always)]
fn twice<G: Greys>([a, b, c, d]: [f32; 4]) -> G {
    G::load(&[a, b, c, d, a, b, c, d])
}

/// Into a list, from number `first` on.
#[inline(always)]
fn put<G: Greys>(x: G, list: &mut [f32; TOGETHER], first: usize) {
    let mut out = [0.0; 8];
    x.store(&mut out);
    list[first..first + 8].copy_from_slice(&out);
}

/// Eight numbers from number `first` on.
#[inline(always)]
fn numbers<G: Greys>(list: &[f32], first: usize) -> G {
    let mut out = [0.0; 8];
    out.copy_from_slice(&list[first..first + 8]);
    G::load(&out)
}

/// A kernel of which two windows fill eight numbers.
trait Pairs<const T: usize> {
    /// Numbers whose sums of fours are the levels at places `first` + 2 K and `first` + 2 K + 1; `[x, y]` within their pixels, of all eight.
    fn pair<S: Level, G: Greys, const K: usize>(
        raster: &Raster<'_, S, T>,
        at: &Places,
        first: usize,
        at_pixel: [G; 2],
    ) -> G;
}

impl<P: Pairs<T>, const T: usize> Weights<T> for P {
    const FROM: f64 = 0.0;
    #[inline(always)]
    fn levels<S: Level, L: Lanes>(&self, raster: &Raster<'_, S, T>, at: &Places, n: usize, found: &mut Found) {
        let mut first = 0;
        while first < n {
            let x: [L::Greys; 2] = [numbers(&at.x[0], first), numbers(&at.x[1], first)];
            let levels = L::Greys::sums([
                Self::pair::<S, L::Greys, 0>(raster, at, first, x),
                Self::pair::<S, L::Greys, 1>(raster, at, first, x),
                Self::pair::<S, L::Greys, 2>(raster, at, first, x),
                Self::pair::<S, L::Greys, 3>(raster, at, first, x),
            ]);
            put(levels, &mut found.levels, first);
            first += 8;
        }
    }
}

/// Bilinear: the four samples of a window side by side.
pub(super) struct Linear;

impl Pairs<2> for Linear {
    #[inline(always)]
    fn pair<S: Level, G: Greys, const K: usize>(
        raster: &Raster<'_, S, 2>,
        at: &Places,
        first: usize,
        [x, y]: [G; 2],
    ) -> G {
        let across = x.four_times::<K>().fused(twice([-1.0, 1.0, -1.0, 1.0]), twice([1.0, 0.0, 1.0, 0.0]));
        let down = y.four_times::<K>().fused(twice([-1.0, -1.0, 1.0, 1.0]), twice::<G>([1.0, 1.0, 0.0, 0.0]));
        let i = first + 2 * K;
        let samples: G = raster.window(at.start(i)).greys(raster.window(at.start(i + 1)));
        samples * (across * down)
    }
}

/// Keys' cubic: rows of two windows side by side.
pub(super) struct Cubic;

impl Cubic {
    #[inline(always)]
    fn weights<G: Greys>(x: G) -> G {
        let (a, b) = (twice::<G>([0.0, 1.0, 0.0, 0.0]), twice::<G>([-0.5, 0.0, 0.5, 0.0]));
        let (c, d) = (twice::<G>([1.0, -2.5, 2.0, -0.5]), twice::<G>([-0.5, 1.5, -1.5, 0.5]));
        x.fused(x.fused(x.fused(d, c), b), a)
    }
}

impl Pairs<4> for Cubic {
    #[inline(always)]
    fn pair<S: Level, G: Greys, const K: usize>(
        raster: &Raster<'_, S, 4>,
        at: &Places,
        first: usize,
        [x, y]: [G; 2],
    ) -> G {
        let (across, down) = (Self::weights(x.four_times::<K>()), Self::weights(y.four_times::<K>()));
        let i = first + 2 * K;
        let (mut a, mut b) = (raster.window(at.start(i)), raster.window(at.start(i + 1)));
        let mut sum = a.greys::<G>(&mut b) * down.of_fours::<0>();
        sum = a.greys::<G>(&mut b).fused(down.of_fours::<1>(), sum);
        sum = a.greys::<G>(&mut b).fused(down.of_fours::<2>(), sum);
        a.greys::<G>(&mut b).fused(down.of_fours::<3>(), sum) * across
    }
}

/// Six or eight taps: a row of one window.
#[derive(Debug, Clone)]
pub(super) struct Table {
    /// Coefficients of the even parts of taps 0 to 3, lowest first.
    even: [[f32; MOST_TAPS / 2]; TERMS],
    /// Of the odd parts, which taps 7 to 4 have with the other sign: they round alike.
    odd: [[f32; MOST_TAPS / 2]; TERMS],
}

impl Table {
    /// Of a kernel with six or eight taps; six stand in the middle of eight.
    pub(super) fn of(kernel: Kernel) -> Self {
        const NODES: usize = 32;
        let margin = (MOST_TAPS - kernel.taps()) / 2;
        let at: [[f64; MOST_TAPS]; NODES] =
            std::array::from_fn(|j| kernel.weights(MOST_TAPS as f64 + 0.5 + 0.5 * node(j, NODES)).1);
        let mut table = Self { even: Default::default(), odd: Default::default() };
        for tap in 0..kernel.taps() / 2 {
            let parts = parts::<NODES>(&std::array::from_fn(|j| at[j][tap]));
            let powers = powers::<{ 2 * TERMS }>(std::array::from_fn(|p| parts[p]));
            for k in 0..TERMS {
                // t = 2 x.
                let scale = 4_f64.powi(k as i32);
                table.even[k][margin + tap] = (powers[2 * k] * scale) as f32;
                table.odd[k][margin + tap] = (2.0 * powers[2 * k + 1] * scale) as f32;
            }
        }
        table
    }

    /// Weights at several x, tap by tap.
    #[inline(always)]
    pub(super) fn each<F: Several<f32>>(&self, x: F) -> [F; MOST_TAPS] {
        let mut out = [x; MOST_TAPS];
        let (s, back) = (x * x, -x);
        for i in 0..MOST_TAPS / 2 {
            let (mut even, mut odd) = (F::splat(self.even[TERMS - 1][i]), F::splat(self.odd[TERMS - 1][i]));
            for k in 1..TERMS {
                even = even.fused(s, F::splat(self.even[TERMS - 1 - k][i]));
                odd = odd.fused(s, F::splat(self.odd[TERMS - 1 - k][i]));
            }
            out[i] = odd.fused(x, even);
            out[MOST_TAPS - 1 - i] = odd.fused(back, even);
        }
        out
    }

    /// The same at eight places across and down at once: coefficients are read once, and no sum waits for itself.
    #[inline(always)]
    fn both<G: Greys>(&self, at: &Places, first: usize, out: &mut Taps) {
        let x: [G; 2] = [numbers(&at.x[0], first), numbers(&at.x[1], first)];
        let (s, less) = ([x[0] * x[0], x[1] * x[1]], G::splat(-1.0));
        for i in 0..MOST_TAPS / 2 {
            let mut even = [G::splat(self.even[TERMS - 1][i]); 2];
            let mut odd = [G::splat(self.odd[TERMS - 1][i]); 2];
            for k in 1..TERMS {
                let (e, o) = (G::splat(self.even[TERMS - 1 - k][i]), G::splat(self.odd[TERMS - 1 - k][i]));
                for j in 0..2 {
                    even[j] = even[j].fused(s[j], e);
                    odd[j] = odd[j].fused(s[j], o);
                }
            }
            for j in 0..2 {
                odd[j].fused(x[j], even[j]).store(&mut out.0[j][i]);
                odd[j].fused(x[j] * less, even[j]).store(&mut out.0[j][MOST_TAPS - 1 - i]);
            }
        }
    }

    /// Levels at places from number `first` up to `end`, of eight windows at a time, wherever each lies. Weights are found for eight places and used at once:
    /// products of the one and samples of the other keep different parts of the processor busy.
    #[inline(always)]
    fn by_eights<S: Level, G: Greys>(
        &self,
        raster: &Raster<'_, S, 8>,
        at: &Places,
        [first, end]: [usize; 2],
        found: &mut Found,
    ) {
        let mut i = first;
        while i < end {
            // As in [`Cluster`]: what the next row of the result will look at.
            let start = at.start(i);
            raster.fetch(start + (MOST_TAPS + 1) * raster.stride());
            raster.fetch(start.wrapping_sub(2 * raster.stride()));
            self.both::<G>(at, i, &mut found.taps);
            let [across, down] = &found.taps.0;
            put(eight::<S, G>(raster, at, i, across, down), &mut found.levels, i);
            i += 8;
        }
    }
}

/// Eight windows whose weights are known.
#[inline(always)]
fn eight<S: Level, G: Greys>(
    raster: &Raster<'_, S, 8>,
    at: &Places,
    first: usize,
    across: &[[f32; 8]; MOST_TAPS],
    down: &[[f32; 8]; MOST_TAPS],
) -> G {
    let mut starts = [0; 8];
    for i in 0..8 {
        starts[i] = at.start(first + i);
    }
    let mut windows = raster.windows(starts);
    let mut sums = [G::splat(0.0); 8];
    // A list that the compiler does not know: else it would sum window by window, each sum waiting for itself, and take the weights out of
    // registers one by one.
    for w in black_box(&down[..]) {
        add(&mut sums, windows.greys(), w);
    }
    let mut sums = G::turned(sums);
    for i in 0..MOST_TAPS {
        sums[i] = sums[i] * G::load(&across[i]);
    }
    let [a, b, c, d] = [sums[0] + sums[4], sums[1] + sums[5], sums[2] + sums[6], sums[3] + sums[7]];
    (a + c) + (b + d)
}

/// Adds a row of each of eight windows.
#[inline(always)]
fn add<G: Greys>(sums: &mut [G; 8], rows: [G; 8], w: &[f32; 8]) {
    let low: G = twice([w[0], w[1], w[2], w[3]]);
    let high: G = twice([w[4], w[5], w[6], w[7]]);
    sums[0] = rows[0].fused(low.of_fours::<0>(), sums[0]);
    sums[1] = rows[1].fused(low.of_fours::<1>(), sums[1]);
    sums[2] = rows[2].fused(low.of_fours::<2>(), sums[2]);
    sums[3] = rows[3].fused(low.of_fours::<3>(), sums[3]);
    sums[4] = rows[4].fused(high.of_fours::<0>(), sums[4]);
    sums[5] = rows[5].fused(high.of_fours::<1>(), sums[5]);
    sums[6] = rows[6].fused(high.of_fours::<2>(), sums[6]);
    sums[7] = rows[7].fused(high.of_fours::<3>(), sums[7]);
}

impl Weights<8> for Table {
    const FROM: f64 = 0.5;
    #[inline(always)]
    fn levels<S: Level, L: Lanes>(&self, raster: &Raster<'_, S, 8>, at: &Places, n: usize, found: &mut Found) {
        if !L::PICKS {
            return self.by_eights::<S, L::Greys>(raster, at, [0, n], found);
        }
        let mut first = 0;
        while first < n {
            match L::with_picks(Cluster { table: self, raster, at, first }) {
                Some(Some(levels)) => found.levels[first..first + SINGLES].copy_from_slice(&levels),
                _ => self.by_eights::<S, L::Greys>(raster, at, [first, first + SINGLES], found),
            }
            first += SINGLES;
        }
    }
}
