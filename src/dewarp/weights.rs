//! Levels of sixteen windows, for each kernel.
//!
//! ```text
//! f(u, v) = sum_i w_i(u - floor u) sum_k w_k(v - floor v) c_(k, i)
//! ```
//! The weights of linear and cubic are polynomials of the position within the pixel as they stand. Those of the others are, with x that
//! position less one half,
//! ```text
//! w_i = e_i(x^2) + x o_i(x^2),   w_(7-i) = e_i(x^2) - x o_i(x^2)
//! ```
//! of degree nine, to 4e-8. All is of single precision; sums stand in one order, whether a window is summed by itself or with fifteen
//! others ([`super::cluster`]): equal bits on every machine.

use super::chebyshev::{node, parts, powers};
use super::cluster::Cluster;
use super::kernel::{Kernel, MOST_TAPS};
use super::rows::Places;
use crate::lanes::{Greys, Lanes, Level, Raster, SINGLES, Several};

/// Terms of the even and of the odd part of a weight.
pub(super) const TERMS: usize = 5;

/// A kernel with windows of T samples along each axis.
pub(super) trait Weights<const T: usize> {
    /// Where places in a pixel are counted from.
    const FROM: f64;
    /// Levels at eight places from number `first` on, of which every window is whole.
    fn eight<S: Level, G: Greys>(&self, raster: &Raster<'_, S, T>, at: &Places, first: usize) -> [f32; 8];
    /// Levels at [`SINGLES`] places, eight by eight.
    #[inline(always)]
    fn eights<S: Level, G: Greys>(&self, raster: &Raster<'_, S, T>, at: &Places, first: usize) -> [f32; SINGLES] {
        let mut out = [0.0; SINGLES];
        out[..8].copy_from_slice(&self.eight::<S, G>(raster, at, first));
        out[8..].copy_from_slice(&self.eight::<S, G>(raster, at, first + 8));
        out
    }
    /// Levels at [`SINGLES`] places as quickly as the processor can.
    #[inline(always)]
    fn levels<S: Level, L: Lanes>(&self, raster: &Raster<'_, S, T>, at: &Places, first: usize) -> [f32; SINGLES] {
        self.eights::<S, L::Greys>(raster, at, first)
    }
}

/// The sample itself.
pub(super) struct Nearest;

impl Weights<1> for Nearest {
    const FROM: f64 = 0.0;
    #[inline(always)]
    fn eight<S: Level, G: Greys>(&self, raster: &Raster<'_, S, 1>, at: &Places, first: usize) -> [f32; 8] {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = raster.window(at.start(first + i)).number();
        }
        out
    }
}

#[inline(always)]
fn twice<G: Greys>([a, b, c, d]: [f32; 4]) -> G {
    G::load(&[a, b, c, d, a, b, c, d])
}

#[inline(always)]
fn stored<G: Greys>(x: G) -> [f32; 8] {
    let mut out = [0.0; 8];
    x.store(&mut out);
    out
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
    fn eight<S: Level, G: Greys>(&self, raster: &Raster<'_, S, T>, at: &Places, first: usize) -> [f32; 8] {
        let x = [numbers::<G>(&at.x[0], first), numbers(&at.x[1], first)];
        stored(G::sums([
            Self::pair::<S, G, 0>(raster, at, first, x),
            Self::pair::<S, G, 1>(raster, at, first, x),
            Self::pair::<S, G, 2>(raster, at, first, x),
            Self::pair::<S, G, 3>(raster, at, first, x),
        ]))
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
        let across = twice::<G>([1.0, 0.0, 1.0, 0.0]) + x.four_times::<K>() * twice([-1.0, 1.0, -1.0, 1.0]);
        let down = twice::<G>([1.0, 1.0, 0.0, 0.0]) + y.four_times::<K>() * twice([-1.0, -1.0, 1.0, 1.0]);
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
        a + x * (b + x * (c + x * d))
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
        let upper = a.greys::<G>(&mut b) * down.of_fours::<0>() + a.greys::<G>(&mut b) * down.of_fours::<1>();
        let lower = a.greys::<G>(&mut b) * down.of_fours::<2>() + a.greys::<G>(&mut b) * down.of_fours::<3>();
        (upper + lower) * across
    }
}

/// Eight taps; none lies across two lines of the cache.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(32))]
struct Taps([f32; MOST_TAPS]);

/// Six or eight taps: a row of one window.
#[derive(Debug, Clone)]
pub(super) struct Table {
    /// Coefficients of the even parts, lowest first.
    even: [Taps; TERMS],
    /// Of the odd parts, of taps 4 to 7 with the other sign.
    odd: [Taps; TERMS],
}

impl Table {
    /// Of a kernel with six or eight taps; six stand in the middle of eight.
    pub(super) fn of(kernel: Kernel) -> Self {
        const NODES: usize = 32;
        let margin = (MOST_TAPS - kernel.taps()) / 2;
        let at: [[f64; MOST_TAPS]; NODES] =
            std::array::from_fn(|j| kernel.weights(MOST_TAPS as f64 + 0.5 + 0.5 * node(j, NODES)).1);
        let mut table = Self { even: Default::default(), odd: Default::default() };
        for tap in 0..kernel.taps() {
            let parts = parts::<NODES>(&std::array::from_fn(|j| at[j][tap]));
            let powers = powers::<{ 2 * TERMS }>(std::array::from_fn(|p| parts[p]));
            for k in 0..TERMS {
                // t = 2 x.
                let scale = 4_f64.powi(k as i32);
                table.even[k].0[margin + tap] = (powers[2 * k] * scale) as f32;
                table.odd[k].0[margin + tap] = (2.0 * powers[2 * k + 1] * scale) as f32;
            }
        }
        table.mirror();
        table
    }

    /// Rounding is that of the lower taps for the upper ones too.
    fn mirror(&mut self) {
        for k in 0..TERMS {
            for i in 0..MOST_TAPS / 2 {
                self.even[k].0[MOST_TAPS - 1 - i] = self.even[k].0[i];
                self.odd[k].0[MOST_TAPS - 1 - i] = -self.odd[k].0[i];
            }
        }
    }

    /// Weights of all taps at x.
    #[inline(always)]
    fn at<G: Greys>(&self, x: f32) -> G {
        let x = G::splat(x);
        let s = x * x;
        let (mut even, mut odd): (G, G) = (G::load(&self.even[TERMS - 1].0), G::load(&self.odd[TERMS - 1].0));
        for k in 1..TERMS {
            even = even.fused(s, G::load(&self.even[TERMS - 1 - k].0));
            odd = odd.fused(s, G::load(&self.odd[TERMS - 1 - k].0));
        }
        odd.fused(x, even)
    }

    /// The same for several x, tap by tap.
    #[inline(always)]
    pub(super) fn each<F: Several<f32>>(&self, x: F) -> [F; MOST_TAPS] {
        let mut out = [x; MOST_TAPS];
        let (s, back) = (x * x, -x);
        for i in 0..MOST_TAPS / 2 {
            let (mut even, mut odd) = (F::splat(self.even[TERMS - 1].0[i]), F::splat(self.odd[TERMS - 1].0[i]));
            for k in 1..TERMS {
                even = even.fused(s, F::splat(self.even[TERMS - 1 - k].0[i]));
                odd = odd.fused(s, F::splat(self.odd[TERMS - 1 - k].0[i]));
            }
            out[i] = odd.fused(x, even);
            out[MOST_TAPS - 1 - i] = odd.fused(back, even);
        }
        out
    }

    /// The eight products of a window's columns.
    #[inline(always)]
    fn products<S: Level, G: Greys>(&self, raster: &Raster<'_, S, 8>, at: &Places, i: usize) -> G {
        let (across, down): (G, G) = (self.at(at.x[0][i]), self.at(at.x[1][i]));
        let (upper, lower) = (down.four_twice::<0>(), down.four_twice::<1>());
        let mut rows = raster.window(at.start(i));
        let mut sum = rows.greys::<G>().fused(upper.of_fours::<0>(), G::splat(0.0));
        sum = rows.greys::<G>().fused(upper.of_fours::<1>(), sum);
        sum = rows.greys::<G>().fused(upper.of_fours::<2>(), sum);
        sum = rows.greys::<G>().fused(upper.of_fours::<3>(), sum);
        sum = rows.greys::<G>().fused(lower.of_fours::<0>(), sum);
        sum = rows.greys::<G>().fused(lower.of_fours::<1>(), sum);
        sum = rows.greys::<G>().fused(lower.of_fours::<2>(), sum);
        sum = rows.greys::<G>().fused(lower.of_fours::<3>(), sum);
        sum * across
    }
}

impl Weights<8> for Table {
    const FROM: f64 = 0.5;
    #[inline(always)]
    fn eight<S: Level, G: Greys>(&self, raster: &Raster<'_, S, 8>, at: &Places, first: usize) -> [f32; 8] {
        let mut fours = [G::splat(0.0); 4];
        for k in 0..4 {
            let a: G = self.products(raster, at, first + 2 * k);
            fours[k] = a.folded(self.products(raster, at, first + 2 * k + 1));
        }
        stored(G::sums(fours))
    }
    #[inline(always)]
    fn levels<S: Level, L: Lanes>(&self, raster: &Raster<'_, S, 8>, at: &Places, first: usize) -> [f32; SINGLES] {
        match L::with_picks(Cluster { table: self, raster, at, first }) {
            Some(Some(levels)) => levels,
            _ => self.eights::<S, L::Greys>(raster, at, first),
        }
    }
}
