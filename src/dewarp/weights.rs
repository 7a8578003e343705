//! Levels of eight windows at once, for each kernel.
//!
//! ```text
//! f(u, v) = sum_i w_i(u - floor u) sum_k w_k(v - floor v) c_(k, i)
//! ```
//! The weights of linear and cubic are polynomials of the position within the pixel as they stand. Those of the others are parabolas of
//! it in [`SEGMENTS`] pieces through Chebyshev nodes, `w_i(t) = a_0 + x (a_1 + x a_2)`, `x = SEGMENTS t - segment - 1/2`, to 4e-8. All is of single
//! precision. Products and sums are never fused and stand in one order: equal bits on every machine.

use super::kernel::{Kernel, MOST_TAPS};
use super::rows::Places;
use crate::lanes::{Greys, Level, Raster};

/// Pieces of a pixel.
pub(super) const SEGMENTS: usize = 128;

/// A kernel with windows of T samples along each axis.
pub(super) trait Weights<const T: usize> {
    /// Whether places need segments.
    const PIECES: bool;
    /// Levels at eight places from number `first` on, of which every window is whole.
    fn levels<S: Level, G: Greys>(&self, raster: &Raster<'_, S, T>, at: &Places, first: usize) -> [f32; 8];
}

/// The sample itself.
pub(super) struct Nearest;

impl Weights<1> for Nearest {
    const PIECES: bool = false;
    #[inline(always)]
    fn levels<S: Level, G: Greys>(&self, raster: &Raster<'_, S, 1>, at: &Places, first: usize) -> [f32; 8] {
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
fn eight<G: Greys>(list: &[f32], first: usize) -> G {
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
    const PIECES: bool = false;
    #[inline(always)]
    fn levels<S: Level, G: Greys>(&self, raster: &Raster<'_, S, T>, at: &Places, first: usize) -> [f32; 8] {
        let x = [eight::<G>(&at.x[0], first), eight(&at.x[1], first)];
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

/// Three coefficients, lowest first, of eight taps each; none lies across two lines of the cache.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
struct Piece([[f32; 8]; 3]);

/// Six or eight taps: a row of one window.
#[derive(Debug, Clone)]
pub(super) struct Table(Box<[Piece; SEGMENTS]>);

impl Table {
    /// Of a kernel with six or eight taps; six stand in the middle of eight.
    pub(super) fn of(kernel: Kernel) -> Self {
        let own = kernel.taps().min(MOST_TAPS);
        let margin = (MOST_TAPS - own) / 2;
        let angles = [1.0, 3.0, 5.0].map(|j| j * std::f64::consts::PI / 6.0);
        let mut table = Box::new([Piece([[0.0; 8]; 3]); SEGMENTS]);
        for (s, piece) in table.iter_mut().enumerate() {
            let node = |angle: f64| 16.0 + (s as f64 + 0.5 + 0.5 * angle.cos()) / SEGMENTS as f64;
            let at = angles.map(|angle| kernel.weights(node(angle)).1);
            for tap in 0..own {
                // By Chebyshev polynomials of 2 x, then by powers of x.
                let part = |m: f64| (0..3).map(|j| at[j][tap] * (m * angles[j]).cos()).sum::<f64>() / 1.5;
                let [c0, c1, c2] = [0.5 * part(0.0), part(1.0), part(2.0)];
                let powers = [c0 - c2, 2.0 * c1, 8.0 * c2];
                (0..3).for_each(|p| piece.0[p][margin + tap] = powers[p] as f32);
            }
        }
        Self(table)
    }

    /// Weights in a piece, at x of it.
    #[inline(always)]
    fn at<G: Greys>(&self, segment: usize, x: f32) -> G {
        let [a, b, c] = &self.0[segment % SEGMENTS].0;
        let x = G::splat(x);
        G::load(a) + x * (G::load(b) + x * G::load(c))
    }

    /// The eight products of a window's columns.
    #[inline(always)]
    fn products<S: Level, G: Greys>(&self, raster: &Raster<'_, S, 8>, at: &Places, i: usize) -> G {
        let across: G = self.at(at.segment(0, i), at.x[0][i]);
        let down: G = self.at(at.segment(1, i), at.x[1][i]);
        let (upper, lower) = (down.four_twice::<0>(), down.four_twice::<1>());
        let mut rows = raster.window(at.start(i));
        let a = rows.greys::<G>() * upper.of_fours::<0>() + rows.greys::<G>() * upper.of_fours::<1>();
        let b = rows.greys::<G>() * upper.of_fours::<2>() + rows.greys::<G>() * upper.of_fours::<3>();
        let c = rows.greys::<G>() * lower.of_fours::<0>() + rows.greys::<G>() * lower.of_fours::<1>();
        let d = rows.greys::<G>() * lower.of_fours::<2>() + rows.greys::<G>() * lower.of_fours::<3>();
        ((a + b) + (c + d)) * across
    }
}

impl Weights<8> for Table {
    const PIECES: bool = true;
    #[inline(always)]
    fn levels<S: Level, G: Greys>(&self, raster: &Raster<'_, S, 8>, at: &Places, first: usize) -> [f32; 8] {
        let mut fours = [G::splat(0.0); 4];
        for k in 0..4 {
            let a: G = self.products(raster, at, first + 2 * k);
            fours[k] = a.folded(self.products(raster, at, first + 2 * k + 1));
        }
        stored(G::sums(fours))
    }
}
