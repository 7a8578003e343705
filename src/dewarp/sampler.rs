//! An image made ready to be read between its pixels; the prefilter of the B-spline.
//!
//! The prefilter inverts `sum_j c_j B(i - j) = f_i` by one causal and one anticausal recursion per pole z, with
//! `c+_i = f_i + z c+_(i-1)`, `c_i = z (c_(i+1) - c+_i)`, gain `(1 - z)(1 - 1/z)`, beyond the border mirrored at the border sample. Lines go
//! through it [`STRIP`] at a time, each as it would alone.
//!
//! Source: Unser, Aldroubi, Eden, IEEE Trans. SP 41 (1993) 834.

use super::kernel::{Kernel, Source, mirrored};
use crate::image::GrayView;
use crate::lanes::{self, Lanes, Several, Twice, run};
use rayon::prelude::*;

/// Lines that are filtered side by side.
const STRIP: usize = 16;
/// Poles of the quintic B-spline's prefilter.
const POLES: [f64; 2] = [-0.430_575_347_099_973_8, -0.043_096_288_203_264_65];

/// An image made ready to be read between its pixels.
#[derive(Debug, Clone)]
pub struct Sampler {
    kernel: Kernel,
    size_px: [usize; 2],
    coefficients: Vec<f32>,
}

impl Sampler {
    /// An image with a kernel; of the B-spline the prefilter is done here, by the threads of the pool in which this is called.
    pub fn new(view: &GrayView<'_>, kernel: Kernel) -> Self {
        let [width, height] = [view.width(), view.height()];
        let mut coefficients = vec![0.0; width * height];
        let bands = coefficients.par_chunks_mut(STRIP * width).enumerate();
        bands.for_each_init(Memory::default, |memory, (k, band)| {
            for (j, out) in band.chunks_exact_mut(width).enumerate() {
                view.row(k * STRIP + j, &mut memory.row);
                out.copy_from_slice(&memory.row);
            }
            if kernel == Kernel::BSpline {
                rows(band, width, &mut memory.strip);
            }
        });
        if kernel == Kernel::BSpline {
            columns(&mut coefficients, width);
        }
        Self { kernel, size_px: [width, height], coefficients }
    }

    /// Width and height, px.
    pub fn size_px(&self) -> [usize; 2] {
        self.size_px
    }

    /// Grey level at (u, v), px.
    pub fn at(&self, u_px: f64, v_px: f64) -> f32 {
        self.source().at(u_px, v_px)
    }

    /// What is read.
    pub(super) fn source(&self) -> Source<'_, f32> {
        Source { kernel: self.kernel, samples: &self.coefficients, stride: self.size_px[0], size_px: self.size_px }
    }
}

/// Memory of one thread.
#[derive(Default)]
struct Memory {
    row: Vec<f32>,
    strip: Vec<[f64; STRIP]>,
}

/// At most [`STRIP`] rows, along u, in place.
fn rows(band: &mut [f32], width: usize, strip: &mut Vec<[f64; STRIP]>) {
    strip.clear();
    strip.resize(width, [0.0; STRIP]);
    // Square by square: a strip's columns lie far apart.
    for u in (0..width).step_by(STRIP) {
        for (j, row) in band.chunks_exact(width).enumerate() {
            strip[u..].iter_mut().zip(&row[u..]).take(STRIP).for_each(|(s, x)| s[j] = f64::from(*x));
        }
    }
    run(Prefilter { lines: strip });
    for u in (0..width).step_by(STRIP) {
        for (j, row) in band.chunks_exact_mut(width).enumerate() {
            row[u..].iter_mut().zip(&strip[u..]).take(STRIP).for_each(|(x, s)| *x = s[j] as f32);
        }
    }
}

/// All columns, in place.
fn columns(coefficients: &mut [f32], width: usize) {
    let height = coefficients.len() / width;
    let mut strip = vec![[0.0; STRIP]; height];
    for first in (0..width).step_by(STRIP) {
        let n = STRIP.min(width - first);
        for (s, row) in strip.iter_mut().zip(coefficients.chunks_exact(width)) {
            s[..n].iter_mut().zip(&row[first..first + n]).for_each(|(s, x)| *s = f64::from(*x));
        }
        run(Prefilter { lines: &mut strip });
        for (s, row) in strip.iter().zip(coefficients.chunks_exact_mut(width)) {
            row[first..first + n].iter_mut().zip(s).for_each(|(x, s)| *x = *s as f32);
        }
    }
}

/// Samples to coefficients of the quintic B-spline along the list, in place; lines side by side.
struct Prefilter<'a> {
    lines: &'a mut [[f64; STRIP]],
}

impl lanes::Kernel for Prefilter<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let n = self.lines.len();
        if n < 2 {
            return;
        }
        let mut k = 0;
        while k < STRIP {
            for z in POLES {
                one_pole::<Twice<L>>(self.lines, k, z);
            }
            k += Twice::<L>::N;
        }
    }
}

/// Both recursions of a pole, lines from number k on.
#[inline(always)]
fn one_pole<L: Lanes>(lines: &mut [[f64; STRIP]], k: usize, pole: f64) {
    let n = lines.len();
    let (z, gain) = (L::splat(pole), L::splat((1.0 - pole) * (1.0 - 1.0 / pole)));
    // First causal value: the sum over the mirrored past, as far as it counts.
    let reach = (1e-12_f64.ln() / pole.abs().ln()).ceil() as usize;
    let mut power = 1.0;
    let mut last = L::splat(0.0);
    for i in 0..reach {
        last = L::splat(power).fused(gain * L::load(&lines[mirrored(i as isize, n)][k..]), last);
        power *= pole;
    }
    last.store(&mut lines[0][k..]);
    let mut before = last;
    for i in 1..n {
        before = last;
        last = z.fused(last, gain * L::load(&lines[i][k..]));
        last.store(&mut lines[i][k..]);
    }
    last = L::splat(pole / (pole * pole - 1.0)) * z.fused(before, last);
    last.store(&mut lines[n - 1][k..]);
    for i in (0..n - 1).rev() {
        last = z.fused(last, -(z * L::load(&lines[i][k..])));
        last.store(&mut lines[i][k..]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::run_all;

    #[derive(Clone)]
    struct Filtered(Vec<[f64; STRIP]>);
    impl lanes::Kernel for Filtered {
        type Output = Vec<[u64; STRIP]>;
        #[inline(always)]
        fn run<L: Lanes>(mut self) -> Self::Output {
            lanes::Kernel::run::<L>(Prefilter { lines: &mut self.0 });
            self.0.iter().map(|l| l.map(f64::to_bits)).collect()
        }
    }

    /// The coefficients weighted by the kernel at the samples, mirrored at both ends, are the samples.
    #[test]
    fn the_prefilter_inverts_the_kernel_in_all_widths() {
        for n in [2, 3, 7, 40] {
            let samples: Vec<[f64; STRIP]> =
                (0..n).map(|i| std::array::from_fn(|k| (1.3 * i as f64 + 0.7 * k as f64).sin())).collect();
            let all = run_all(&Filtered(samples.clone()));
            all.iter().for_each(|one| assert_eq!(*one, all[0]));
            let (first, weights) = Kernel::BSpline.weights(100.0);
            for i in 0..n as isize {
                for k in 0..STRIP {
                    let at = |t: usize| f64::from_bits(all[0][mirrored(i + first + t as isize - 100, n)][k]);
                    let sum: f64 = (0..6).map(|t| weights[t] * at(t)).sum();
                    assert!((sum - samples[i as usize][k]).abs() < 1e-11, "{n} {i} {k}: {sum}");
                }
            }
        }
    }
}
