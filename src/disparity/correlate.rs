//! Ensemble correlation of windows of two dewarped images.
//!
//! ```text
//! C(d) = mean over pairs of  sum_x a(x) b(x + d) / (overlap(d) sigma_a sigma_b),   overlap(d) = (w - |d_x|)(w - |d_y|)
//! ```
//! a and b less their means, zero-padded to twice the window; both go through one complex transform. Dividing by the overlap takes
//! away the bias towards no shift.

use super::peak::CorrelationMap;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Part of a window that must be seen by both cameras.
const SEEN: f64 = 0.75;

/// Transforms for windows of one size.
pub(super) struct Correlator {
    window: usize,
    size: usize,
    forward: Arc<dyn Fft<f64>>,
    backward: Arc<dyn Fft<f64>>,
}

/// Dewarped images of one moment, particles alone.
pub(super) struct Dewarped {
    pub(super) levels: [Vec<f32>; 2],
    pub(super) seen: Vec<bool>,
}

/// Means over pairs of the cross-correlation and the two autocorrelations of one window.
pub(super) struct Sums {
    pub(super) cross: Vec<f64>,
    pub(super) auto: [Vec<f64>; 2],
}

impl Correlator {
    pub(super) fn new(window: usize) -> Self {
        let size = (2 * window).next_power_of_two();
        let mut planner = FftPlanner::new();
        Self { window, size, forward: planner.plan_fft_forward(size), backward: planner.plan_fft_inverse(size) }
    }

    /// Two-dimensional transform in place: rows, turned, rows, and turned back.
    fn transform(&self, fft: &Arc<dyn Fft<f64>>, data: &mut [Complex<f64>]) {
        let n = self.size;
        for _ in 0..2 {
            fft.process(data);
            for j in 0..n {
                for i in 0..j {
                    data.swap(j * n + i, i * n + j);
                }
            }
        }
    }

    /// Correlation of the window whose first pixel is (column, row), over all moments; none where too little is seen.
    pub(super) fn window(&self, moments: &[Dewarped], width: usize, column: usize, row: usize) -> Option<Sums> {
        let (w, n) = (self.window, self.size);
        let mut spectra = vec![vec![Complex::new(0.0, 0.0); n * n]; 2];
        let mut pairs = 0;
        let mut data = vec![Complex::new(0.0, 0.0); n * n];
        for m in moments {
            let place = |i: usize| (row + i / w) * width + column + i % w;
            let seen = (0..w * w).filter(|i| m.seen[place(*i)]).count();
            if (seen as f64) < SEEN * (w * w) as f64 {
                return None;
            }
            let moments = m.levels.each_ref().map(|l| {
                let values = || (0..w * w).map(place).filter(|p| m.seen[*p]).map(|p| f64::from(l[p]));
                let mean = values().sum::<f64>() / seen as f64;
                let variance = values().map(|x| (x - mean).powi(2)).sum::<f64>() / seen as f64;
                (mean, variance.sqrt())
            });
            // An empty window says nothing, and would divide by zero.
            if !(moments[0].1 > 0.0 && moments[1].1 > 0.0) {
                continue;
            }
            data.iter_mut().for_each(|z| *z = Complex::new(0.0, 0.0));
            for i in 0..w * w {
                let p = place(i);
                if m.seen[p] {
                    let of = |c: usize| (f64::from(m.levels[c][p]) - moments[c].0) / moments[c].1;
                    data[(i / w) * n + i % w] = Complex::new(of(0), of(1));
                }
            }
            self.transform(&self.forward, &mut data);
            // Spectra of two real images from one transform: A = (Z(k) + Z*(-k)) / 2, B = (Z(k) - Z*(-k)) / 2i.
            for k in 0..n * n {
                let mirror = ((n - k / n) % n) * n + (n - k % n) % n;
                let (z, y) = (data[k], data[mirror].conj());
                let (a, b) = ((z + y) * 0.5, (z - y) * Complex::new(0.0, -0.5));
                spectra[0][k] += a.conj() * b;
                // Both autocorrelations are real and even: they share one inverse transform.
                spectra[1][k] += Complex::new(a.norm_sqr(), b.norm_sqr());
            }
            pairs += 1;
        }
        if pairs == 0 {
            return None;
        }
        spectra.iter_mut().for_each(|s| self.transform(&self.backward, s));
        let scale = 1.0 / ((n * n) as f64 * pairs as f64);
        let list = |s: &[Complex<f64>], part: fn(&Complex<f64>) -> f64| self.centred(s, scale, part);
        Some(Sums {
            cross: list(&spectra[0], |z| z.re),
            auto: [list(&spectra[1], |z| z.re), list(&spectra[1], |z| z.im)],
        })
    }

    /// Shifts up to half a window, the zero shift in the middle, divided by the overlap.
    fn centred(&self, values: &[Complex<f64>], scale: f64, part: fn(&Complex<f64>) -> f64) -> Vec<f64> {
        let (w, n, half) = (self.window, self.size, (self.window / 2) as isize);
        let mut out = Vec::with_capacity(w * w);
        for dy in -half..w as isize - half {
            for dx in -half..w as isize - half {
                let at = |d: isize| d.rem_euclid(n as isize) as usize;
                let overlap = (w as f64 - dx.unsigned_abs() as f64) * (w as f64 - dy.unsigned_abs() as f64);
                out.push(part(&values[at(dy) * n + at(dx)]) * scale / overlap);
            }
        }
        out
    }

    pub(super) fn map(&self, values: Vec<f64>) -> CorrelationMap {
        CorrelationMap { width: self.window, height: self.window, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_gives_the_sums_of_products() {
        let (w, width) = (8, 12);
        let mut x = 7_u32;
        let mut next = || {
            x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (x >> 16) as f32
        };
        let levels = [0, 1].map(|_| (0..width * width).map(|_| next()).collect::<Vec<f32>>());
        let moment = Dewarped { levels, seen: vec![true; width * width] };
        let c = Correlator::new(w);
        let sums = c.window(&[moment], width, 3, 2).unwrap();
        let moment = Dewarped { levels: [0, 1].map(|_| vec![0.0; width * width]), seen: vec![true; width * width] };
        assert!(c.window(&[moment], width, 3, 2).is_none(), "nothing to be seen");
        // Again from the definition.
        let mut x = 7_u32;
        let mut next = || {
            x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from((x >> 16) as f32)
        };
        let images = [0, 1].map(|_| (0..width * width).map(|_| next()).collect::<Vec<f64>>());
        let cut = images.each_ref().map(|l| {
            let v: Vec<f64> = (0..w * w).map(|i| l[(2 + i / w) * width + 3 + i % w]).collect();
            let mean = v.iter().sum::<f64>() / v.len() as f64;
            let sigma = (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / v.len() as f64).sqrt();
            v.iter().map(|x| (x - mean) / sigma).collect::<Vec<f64>>()
        });
        for (dx, dy) in [(0_isize, 0_isize), (2, -3), (-4, 1), (3, 3)] {
            let (mut sum, mut count) = (0.0, 0.0);
            for j in 0..w as isize {
                for i in 0..w as isize {
                    let (p, q) = (i + dx, j + dy);
                    if (0..w as isize).contains(&p) && (0..w as isize).contains(&q) {
                        sum += cut[0][(j * w as isize + i) as usize] * cut[1][(q * w as isize + p) as usize];
                        count += 1.0;
                    }
                }
            }
            let at = ((dy + 4) * w as isize + dx + 4) as usize;
            assert!((sums.cross[at] - sum / count).abs() < 1e-9, "{dx} {dy}");
        }
        assert!((sums.auto[0][4 * w + 4] - 1.0).abs() < 1e-9 && (sums.auto[1][4 * w + 4] - 1.0).abs() < 1e-9);
    }
}
