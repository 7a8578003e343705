//! Interpolation between samples: kernels, and one position after the other.
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
//! | b-spline | quintic B-spline, exact for polynomials of degree 5 | 6 | prefiltered samples ([`super::sampler`]) |
//!
//! Sources: Keys, IEEE Trans. ASSP 29 (1981) 1153; Thevenaz, Blu, Unser, IEEE Trans. MI 19 (2000) 739; kernels for PIV: Astarita,
//! Cardone, Exp. Fluids 38 (2005) 233.

use crate::lanes::Level;

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
pub(super) const MOST_TAPS: usize = 8;

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
pub(super) fn mirrored(i: isize, n: usize) -> usize {
    if n == 1 {
        return 0;
    }
    let period = 2 * (n as isize - 1);
    let i = i.rem_euclid(period);
    if i < n as isize { i as usize } else { (period - i) as usize }
}

/// Samples of an image, or coefficients of the B-spline, in their own depth and memory.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source<'a, S> {
    pub(super) kernel: Kernel,
    pub(super) samples: &'a [S],
    /// Samples from one row to the next.
    pub(super) stride: usize,
    /// Width and height.
    pub(super) size_px: [usize; 2],
}

impl<S: Level> Source<'_, S> {
    /// Grey level at (u, v), px.
    pub(super) fn at(&self, u_px: f64, v_px: f64) -> f32 {
        let [width, height] = self.size_px;
        let (first_u, wu) = self.kernel.weights(u_px);
        let (first_v, wv) = self.kernel.weights(v_px);
        let taps = self.kernel.taps();
        let whole = first_u >= 0 && first_u as usize + taps <= width;
        let mut sum = 0.0;
        for (k, wv) in wv.iter().enumerate().take(taps) {
            let row = &self.samples[mirrored(first_v + k as isize, height) * self.stride..][..width];
            let mut part = 0.0;
            if whole {
                for (c, w) in row[first_u as usize..][..taps].iter().zip(&wu) {
                    part += f64::from(c.number()) * w;
                }
            } else {
                for (i, w) in wu.iter().enumerate().take(taps) {
                    part += f64::from(row[mirrored(first_u + i as isize, width)].number()) * w;
                }
            }
            sum += part * wv;
        }
        sum as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dewarp::Sampler;
    use crate::image::{GrayView, Samples};

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
