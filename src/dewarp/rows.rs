//! Grey levels at a row of positions.
//!
//! Inside the image every kernel is evaluated from a table: the weight of each tap is a cubic of the position within the pixel, in
//! [`SEGMENTS`] pieces through Chebyshev nodes (exact for the cubic kernel, to 1e-8 for the others), and sums are of `f32`. That is equal
//! to [`Sampler::at`] to the rounding of `f32`. At the border [`Sampler::at`] itself is asked.
//! ```text
//! f(u, v) = sum_k w_k(v - floor v) sum_i w_i(u - floor u) c_(k, i),    w_i(t) = ((a_3 x + a_2) x + a_1) x + a_0,
//! x = SEGMENTS t - segment - 1/2
//! ```
//! Products and sums are never fused and stand in one order: equal bits on every machine and for any number of threads.

use super::kernel::{Kernel, Sampler};
use crate::lanes;
use nalgebra::{Matrix4, Vector4};

/// Pieces of a pixel.
const SEGMENTS: usize = 32;
/// Taps of the widest kernel.
const WIDE: usize = 8;

/// Four coefficients, lowest first, for each piece; taps side by side.
#[derive(Debug, Clone)]
pub(super) struct Weights {
    taps: usize,
    table: Vec<[[f32; WIDE]; 4]>,
}

impl Weights {
    /// Of a kernel; `None` where a sample is only copied.
    pub(super) fn of(kernel: Kernel) -> Option<Self> {
        let own = kernel.taps();
        if own < 2 {
            return None;
        }
        // Six taps stand in the middle of eight.
        let taps = if own == 6 { 8 } else { own };
        let margin = (taps - own) / 2;
        let nodes = [0, 1, 2, 3].map(|j| 0.5 * (f64::from(2 * j + 1) * std::f64::consts::PI / 8.0).cos());
        let powers = Matrix4::from_fn(|j, p| nodes[j].powi(p as i32));
        let inverse = powers.try_inverse()?;
        let segment = |s: usize| {
            let mut out = [[0.0; WIDE]; 4];
            for tap in 0..own {
                let at = |x: f64| kernel.weights(16.0 + (s as f64 + 0.5 + x) / SEGMENTS as f64).1[tap];
                let c = inverse * Vector4::from(nodes.map(at));
                (0..4).for_each(|p| out[p][margin + tap] = c[p] as f32);
            }
            out
        };
        Some(Self { taps, table: (0..SEGMENTS).map(segment).collect() })
    }

    /// Weights in the piece `segment`, at x of it.
    #[inline(always)]
    fn at<const T: usize>(&self, segment: u32, x: f32) -> [f32; T] {
        let [a, b, c, d] = &self.table[segment as usize % SEGMENTS];
        let mut out = [0.0; T];
        for i in 0..T {
            out[i] = a[i] + x * (b[i] + x * (c[i] + x * d[i]));
        }
        out
    }
}

/// Positions that are prepared together.
const TOGETHER: usize = 32;
/// Added to a whole number below 2^52 it leaves that number in the lowest bits: quicker than a conversion that asks for overflow.
const WHOLE: f64 = 4_503_599_627_370_496.0;
const LOWEST: u64 = (1 << 52) - 1;

/// Where the windows of some positions begin, and what their weights need.
struct Places {
    /// First sample of the window.
    start: [u64; TOGETHER],
    /// Along u and v.
    segment: [[u32; TOGETHER]; 2],
    x: [[f32; TOGETHER]; 2],
    on_sensor: [bool; TOGETHER],
    /// Whether the whole window lies in the image.
    whole: [bool; TOGETHER],
}

impl Places {
    const NONE: Self = Self {
        start: [0; TOGETHER],
        segment: [[0; TOGETHER]; 2],
        x: [[0.0; TOGETHER]; 2],
        on_sensor: [false; TOGETHER],
        whole: [false; TOGETHER],
    };

    /// Without branches, so that the compiler takes several at a time. Comparisons with NaN are false.
    #[inline(always)]
    fn find<const T: usize>(&mut self, size_px: [usize; 2], u_px: &[f64; TOGETHER], v_px: &[f64; TOGETHER]) {
        let [width, height] = size_px.map(|n| n as f64);
        let reach = (T / 2 - 1) as f64;
        let (last_u, last_v) = (width - T as f64, height - T as f64);
        for i in 0..TOGETHER {
            let (u, v) = (u_px[i], v_px[i]);
            self.on_sensor[i] = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5);
            let (whole_u, whole_v) = (u.floor(), v.floor());
            let (first_u, first_v) = (whole_u - reach, whole_v - reach);
            let whole = (first_u >= 0.0) & (first_u <= last_u) & (first_v >= 0.0) & (first_v <= last_v);
            self.whole[i] = whole;
            let start = if whole { first_v * width + first_u } else { 0.0 };
            self.start[i] = (start + WHOLE).to_bits() & LOWEST;
            let place_u = if whole { (u - whole_u) * SEGMENTS as f64 } else { 0.0 };
            let place_v = if whole { (v - whole_v) * SEGMENTS as f64 } else { 0.0 };
            let (segment_u, segment_v) = (place_u.floor(), place_v.floor());
            self.segment[0][i] = (segment_u + WHOLE).to_bits() as u32;
            self.segment[1][i] = (segment_v + WHOLE).to_bits() as u32;
            self.x[0][i] = (place_u - segment_u - 0.5) as f32;
            self.x[1][i] = (place_v - segment_v - 0.5) as f32;
        }
    }
}

/// Grey levels and validity at positions (u, v), px; where a position is not on the sensor (or `NaN`) both stay as they are.
pub(super) struct Row<'a> {
    pub(super) sampler: &'a Sampler,
    pub(super) u_px: &'a [f64],
    pub(super) v_px: &'a [f64],
    pub(super) levels: &'a mut [f32],
    pub(super) valid: &'a mut [bool],
}

impl lanes::Kernel for Row<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) {
        match self.sampler.weights().map(|w| (w, w.taps)) {
            Some((w, 2)) => self.sample::<2>(w),
            Some((w, 4)) => self.sample::<4>(w),
            Some((w, _)) => self.sample::<8>(w),
            None => self.copy(),
        }
    }
}

impl Row<'_> {
    #[inline(always)]
    fn sample<const T: usize>(self, weights: &Weights) {
        let size_px = self.sampler.size_px();
        let (width, coefficients) = (size_px[0], self.sampler.coefficients());
        // An image smaller than a window has no whole one.
        let span = (T - 1) * width + T;
        let mut places = Places::NONE;
        let mut products = [[0.0_f32; T]; TOGETHER];
        let mut first = 0;
        while first < self.u_px.len() {
            let n = TOGETHER.min(self.u_px.len() - first);
            let (mut u, mut v) = ([f64::NAN; TOGETHER], [f64::NAN; TOGETHER]);
            u[..n].copy_from_slice(&self.u_px[first..first + n]);
            v[..n].copy_from_slice(&self.v_px[first..first + n]);
            places.find::<T>(size_px, &u, &v);
            for i in 0..n {
                let across = weights.at::<T>(places.segment[0][i], places.x[0][i]);
                let down = weights.at::<T>(places.segment[1][i], places.x[1][i]);
                let start = places.start[i] as usize;
                let Some(window) = coefficients.get(start..start + span) else { continue };
                let mut sums = [0.0_f32; T];
                for k in 0..T {
                    let row = &window[k * width..k * width + T];
                    for j in 0..T {
                        sums[j] += down[k] * row[j];
                    }
                }
                for j in 0..T {
                    products[i][j] = sums[j] * across[j];
                }
            }
            for i in 0..n {
                let mut sum = products[i];
                let mut half = T / 2;
                while half > 0 {
                    for k in 0..half {
                        sum[k] += sum[k + half];
                    }
                    half /= 2;
                }
                if places.whole[i] {
                    self.levels[first + i] = sum[0];
                }
            }
            for i in 0..n {
                if places.on_sensor[i] {
                    self.valid[first + i] = true;
                    if !places.whole[i] {
                        self.levels[first + i] = self.sampler.at(u[i], v[i]);
                    }
                }
            }
            first += TOGETHER;
        }
    }

    #[inline(always)]
    fn copy(self) {
        let [width, height] = self.sampler.size_px();
        for i in 0..self.u_px.len() {
            let (u, v) = (self.u_px[i], self.v_px[i]);
            if u >= -0.5 && u <= width as f64 - 0.5 && v >= -0.5 && v <= height as f64 - 0.5 {
                self.valid[i] = true;
                self.levels[i] = self.sampler.at(u, v);
            }
        }
    }
}
