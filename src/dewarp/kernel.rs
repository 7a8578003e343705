//! Interpolation between samples: kernels, and the prefilter of the B-spline.
//!
//! ```text
//! f(u, v) = sum_ij c_ij K(u - i) K(v - j),   samples beyond the border are those mirrored at the border sample
//! ```
//! | kernel | K | taps | c |
//! |---|---|---|---|
//! | nearest | box | 1 | samples |
//! | linear | triangle | 2 | samples |
//! | cubic | Keys, a = -1/2 (third order) | 4 | samples |
//! | lanczos | sinc(t) sinc(t / 4), weights divided by their sum | 8 | samples |
//! | b-spline | quintic B-spline, exact for polynomials of degree 5 | 6 | prefiltered samples |
//!
//! The prefilter inverts `sum_j c_j B(i - j) = f_i` by one causal and one anticausal recursion per pole z, with
//! `c+_i = f_i + z c+_(i-1)`, `c_i = z (c_(i+1) - c+_i)`, gain `(1 - z)(1 - 1/z)`.
//!
//! Sources: Keys, IEEE Trans. ASSP 29 (1981) 1153; Unser, Aldroubi, Eden, IEEE Trans. SP 41 (1993) 834; Thevenaz, Blu, Unser,
//! IEEE Trans. MI 19 (2000) 739; kernels for PIV: Astarita, Cardone, Exp. Fluids 38 (2005) 233.

use super::rows::Weights;
use crate::image::GrayView;

/// How grey levels between pixels are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Kernel {
    /// The nearest sample.
    Nearest,
    /// Bilinear.
    Linear,
    /// Keys' cubic.
    Cubic,
    /// Lanczos with eight taps.
    Lanczos,
    /// Quintic B-spline with prefilter.
    #[default]
    BSpline,
}

/// Most taps of a kernel.
const MOST_TAPS: usize = 8;
/// Columns that are filtered side by side.
const STRIP: usize = 16;
/// Poles of the quintic B-spline's prefilter.
const POLES: [f64; 2] = [-0.430_575_347_099_973_8, -0.043_096_288_203_264_65];

impl Kernel {
    /// Samples used along each axis.
    pub fn taps(self) -> usize {
        match self {
            Kernel::Nearest => 1,
            Kernel::Linear => 2,
            Kernel::Cubic => 4,
            Kernel::Lanczos => 8,
            Kernel::BSpline => 6,
        }
    }

    /// First sample and weights at the position `x`.
    pub(super) fn weights(self, x: f64) -> (isize, [f64; MOST_TAPS]) {
        let mut w = [0.0; MOST_TAPS];
        if self == Kernel::Nearest {
            w[0] = 1.0;
            return ((x + 0.5).floor() as isize, w);
        }
        let taps = self.taps();
        let first = x.floor() as isize - (taps as isize / 2 - 1);
        for (k, w) in w.iter_mut().enumerate().take(taps) {
            *w = self.value((x - (first + k as isize) as f64).abs());
        }
        if self == Kernel::Lanczos {
            let sum: f64 = w.iter().sum();
            w.iter_mut().for_each(|w| *w /= sum);
        }
        (first, w)
    }

    /// The kernel at the distance t >= 0.
    fn value(self, t: f64) -> f64 {
        match self {
            Kernel::Nearest => f64::from(u8::from(t <= 0.5)),
            Kernel::Linear => (1.0 - t).max(0.0),
            Kernel::Cubic if t < 1.0 => 1.0 + t * t * (1.5 * t - 2.5),
            Kernel::Cubic if t < 2.0 => 2.0 + t * (-4.0 + t * (2.5 - 0.5 * t)),
            Kernel::Lanczos if t < 1e-12 => 1.0,
            Kernel::Lanczos if t < 4.0 => {
                let p = std::f64::consts::PI * t;
                4.0 * p.sin() * (p / 4.0).sin() / (p * p)
            }
            Kernel::BSpline if t < 1.0 => {
                let s = t * t;
                11.0 / 20.0 + s * (-0.5 + s * (0.25 - t / 12.0))
            }
            Kernel::BSpline if t < 2.0 => {
                17.0 / 40.0 + t * (5.0 / 8.0 + t * (-7.0 / 4.0 + t * (5.0 / 4.0 + t * (-3.0 / 8.0 + t / 24.0))))
            }
            Kernel::BSpline if t < 3.0 => (3.0 - t).powi(5) / 120.0,
            Kernel::Cubic | Kernel::Lanczos | Kernel::BSpline => 0.0,
        }
    }
}

/// Position mirrored at the first and last sample.
fn mirrored(i: isize, n: usize) -> usize {
    if n == 1 {
        return 0;
    }
    let period = 2 * (n as isize - 1);
    let i = i.rem_euclid(period);
    if i < n as isize { i as usize } else { (period - i) as usize }
}

/// An image made ready to be read between its pixels.
#[derive(Debug, Clone)]
pub struct Sampler {
    kernel: Kernel,
    width: usize,
    height: usize,
    coefficients: Vec<f32>,
    weights: Option<Weights>,
}

impl Sampler {
    /// An image with a kernel; of the B-spline the prefilter is done here.
    pub fn new(view: &GrayView<'_>, kernel: Kernel) -> Self {
        let (width, height) = (view.width(), view.height());
        let mut coefficients = Vec::with_capacity(width * height);
        let mut row = vec![];
        for v in 0..height {
            view.row(v, &mut row);
            coefficients.extend_from_slice(&row);
        }
        if kernel == Kernel::BSpline {
            let mut line = vec![0.0; width.max(height)];
            for row in coefficients.chunks_exact_mut(width) {
                line.iter_mut().zip(row.iter()).for_each(|(l, x)| *l = f64::from(*x));
                prefilter(&mut line[..width]);
                row.iter_mut().zip(&line).for_each(|(x, l)| *x = *l as f32);
            }
            // Columns side by side, so that every line of the cache is read once.
            let mut strip = vec![0.0; STRIP * height];
            for first in (0..width).step_by(STRIP) {
                let n = STRIP.min(width - first);
                for v in 0..height {
                    let row = &coefficients[v * width + first..][..n];
                    row.iter().enumerate().for_each(|(k, x)| strip[k * height + v] = f64::from(*x));
                }
                strip.chunks_exact_mut(height).take(n).for_each(prefilter);
                for v in 0..height {
                    let row = &mut coefficients[v * width + first..][..n];
                    row.iter_mut().enumerate().for_each(|(k, x)| *x = strip[k * height + v] as f32);
                }
            }
        }
        Self { kernel, width, height, coefficients, weights: Weights::of(kernel) }
    }

    /// Width and height, px.
    pub fn size_px(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Samples, or coefficients of the B-spline, rows packed.
    pub(super) fn coefficients(&self) -> &[f32] {
        &self.coefficients
    }

    /// Weights for rows of positions.
    pub(super) fn weights(&self) -> Option<&Weights> {
        self.weights.as_ref()
    }

    /// Grey level at (u, v), px.
    pub fn at(&self, u_px: f64, v_px: f64) -> f32 {
        let (first_u, wu) = self.kernel.weights(u_px);
        let (first_v, wv) = self.kernel.weights(v_px);
        let taps = self.kernel.taps();
        let whole = first_u >= 0 && first_u as usize + taps <= self.width;
        let mut sum = 0.0;
        for (k, wv) in wv.iter().enumerate().take(taps) {
            let row = &self.coefficients[mirrored(first_v + k as isize, self.height) * self.width..][..self.width];
            let mut part = 0.0;
            if whole {
                for (c, w) in row[first_u as usize..][..taps].iter().zip(&wu) {
                    part += f64::from(*c) * w;
                }
            } else {
                for (i, w) in wu.iter().enumerate().take(taps) {
                    part += f64::from(row[mirrored(first_u + i as isize, self.width)]) * w;
                }
            }
            sum += part * wv;
        }
        sum as f32
    }
}

/// Samples to coefficients of the quintic B-spline, in place.
fn prefilter(line: &mut [f64]) {
    let n = line.len();
    if n < 2 {
        return;
    }
    for z in POLES {
        let gain = (1.0 - z) * (1.0 - 1.0 / z);
        line.iter_mut().for_each(|x| *x *= gain);
        // First causal value: the sum over the mirrored past, as far as it counts.
        let reach = (1e-12_f64.ln() / z.abs().ln()).ceil() as usize;
        let mut power = 1.0;
        let mut first = 0.0;
        for k in 0..reach {
            first += power * line[mirrored(k as isize, n)];
            power *= z;
        }
        line[0] = first;
        for i in 1..n {
            line[i] += z * line[i - 1];
        }
        line[n - 1] = z / (z * z - 1.0) * (line[n - 1] + z * line[n - 2]);
        for i in (0..n - 1).rev() {
            line[i] = z * (line[i + 1] - line[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Samples;

    const ALL: [Kernel; 5] = [Kernel::Nearest, Kernel::Linear, Kernel::Cubic, Kernel::Lanczos, Kernel::BSpline];

    #[test]
    fn weights_sum_to_one() {
        for kernel in ALL {
            for i in 0..50 {
                let x = 20.0 + f64::from(i) * 0.0213;
                let (first, w) = kernel.weights(x);
                assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-14, "{kernel:?} {x}");
                let reach = kernel.taps() as f64 / 2.0;
                assert!((x - first as f64) < reach + 0.5 && first as f64 + 2.0 * reach - 1.0 - x < reach + 0.5);
            }
        }
    }

    #[test]
    fn samples_are_met_and_polynomials_of_the_order_reproduced() {
        let (w, h) = (40, 33);
        for (kernel, degree) in [(Kernel::Linear, 1), (Kernel::Cubic, 2), (Kernel::BSpline, 5), (Kernel::Lanczos, 0)] {
            let f = |u: f64, v: f64| {
                1000.0 + 200.0 * ((u - 20.0) / 20.0).powi(degree) - 120.0 * ((v - 16.0) / 16.0).powi(degree)
            };
            let data: Vec<f32> = (0..w * h).map(|i| f((i % w) as f64, (i / w) as f64) as f32).collect();
            let sampler = Sampler::new(&GrayView::new(Samples::F32(&data), w, h, w).unwrap(), kernel);
            for i in 0..w * h {
                let (u, v) = (i % w, i / w);
                assert!((sampler.at(u as f64, v as f64) - data[i]).abs() < 2e-3, "{kernel:?} {u} {v}");
            }
            // Away from the border, where mirroring breaks a polynomial.
            for (u, v) in [(20.3, 16.7), (18.51, 15.02), (21.99, 17.5)] {
                assert!(
                    (f64::from(sampler.at(u, v)) - f(u, v)).abs() < 2e-2,
                    "{kernel:?} {u} {v}: {} {}",
                    sampler.at(u, v),
                    f(u, v)
                );
            }
        }
    }

    /// Rows of positions against single ones: to the rounding of `f32`, and equal bits for all widths of the processor.
    #[test]
    fn rows_agree_with_single_positions() {
        use super::super::rows::Row;
        use crate::lanes::{self, Lanes, run_all};
        #[derive(Clone)]
        struct Bits {
            sampler: Sampler,
            u: Vec<f64>,
            v: Vec<f64>,
        }
        impl lanes::Kernel for Bits {
            type Output = (Vec<u32>, Vec<bool>);
            #[inline(always)]
            fn run<L: Lanes>(self) -> Self::Output {
                let (mut levels, mut valid) = (vec![0.0; self.u.len()], vec![false; self.u.len()]);
                let row = Row {
                    sampler: &self.sampler,
                    u_px: &self.u,
                    v_px: &self.v,
                    levels: &mut levels,
                    valid: &mut valid,
                };
                lanes::Kernel::run::<L>(row);
                (levels.iter().map(|x| x.to_bits()).collect(), valid)
            }
        }
        let (w, h) = (60, 47);
        let data: Vec<f32> = (0..w * h).map(|i| 30000.0 + 30000.0 * (0.8 * i as f32).sin()).collect();
        for kernel in ALL {
            let sampler = Sampler::new(&GrayView::new(Samples::F32(&data), w, h, w).unwrap(), kernel);
            let place = |i: usize, n: usize, step: f64| (0.5 + 0.53 * (step * i as f64).sin()) * n as f64;
            let mut u: Vec<f64> = (0..4000).map(|i| place(i, w, 0.377)).collect();
            let mut v: Vec<f64> = (0..4000).map(|i| place(i, h, 0.611)).collect();
            (u[0], v[0], u[1], v[1]) = (f64::NAN, 3.0, -0.5, 46.5);
            (u[2], v[2], u[3], v[3]) = (30.0, 20.0, 29.999_999_999_999_996, 19.5);
            let all = run_all(&Bits { sampler: sampler.clone(), u: u.clone(), v: v.clone() });
            all.iter().for_each(|one| assert!(*one == all[0]));
            let (mut inside, mut worst) = (0, 0.0_f32);
            for i in 0..u.len() {
                let on = (-0.5..=59.5).contains(&u[i]) && (-0.5..=46.5).contains(&v[i]);
                assert_eq!(all[0].1[i], on, "{kernel:?} {} {}", u[i], v[i]);
                let wanted = if on { sampler.at(u[i], v[i]) } else { 0.0 };
                worst = worst.max((f32::from_bits(all[0].0[i]) - wanted).abs());
                inside += usize::from(on);
            }
            println!("{kernel:?}: {inside} inside, largest difference {worst}");
            // Of levels up to 60000, and coefficients of the B-spline some times as large.
            assert!(inside > 2000 && worst < 0.1, "{kernel:?}: {worst}");
        }
    }

    #[test]
    fn one_sample_and_one_row_are_images_too() {
        for kernel in ALL {
            for (w, h) in [(1, 1), (3, 1), (1, 2)] {
                let data = vec![7.0; w * h];
                let sampler = Sampler::new(&GrayView::new(Samples::F32(&data), w, h, w).unwrap(), kernel);
                assert!((sampler.at(0.2, 0.3) - 7.0).abs() < 1e-5, "{kernel:?} {w} {h}");
            }
        }
    }
}
