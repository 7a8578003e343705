//! Grey levels as floats, smoothed, and their difference from the local mean.
//!
//! The difference `s - m` (s: binomial blur, sigma 1 px; m: mean of `s` over 9 x 9 px) changes sign at every edge, however uneven
//! the light: its zero line is the first guess of a contour.

use crate::error::{Invalid, Result};
use crate::image::{GrayView, Samples};

/// Half width of the window of the local mean, px.
const MEAN_RADIUS: usize = 4;

/// A packed image of floats.
#[derive(Debug, Clone)]
pub(crate) struct Plane {
    /// Row-major samples.
    pub(crate) data: Vec<f32>,
    /// Width, px.
    pub(crate) width: usize,
    /// Height, px.
    pub(crate) height: usize,
}

impl Plane {
    /// The grey levels of a view.
    ///
    /// # Errors
    /// [`Invalid::Value`] where a sample is not finite.
    pub(crate) fn from_view(view: &GrayView) -> Result<Self> {
        let (width, height) = (view.width(), view.height());
        let mut data = Vec::with_capacity(width * height);
        for v in 0..height {
            let row = v * view.stride()..v * view.stride() + width;
            match view.samples() {
                Samples::U8(s) => data.extend(s[row].iter().map(|x| f32::from(*x))),
                Samples::U16(s) => data.extend(s[row].iter().map(|x| f32::from(*x))),
                Samples::F32(s) => {
                    if let Some(bad) = s[row.clone()].iter().find(|x| !x.is_finite()) {
                        return Err(Invalid::value("grey level", f64::from(*bad), "a finite number").into());
                    }
                    data.extend_from_slice(&s[row]);
                }
            }
        }
        Ok(Self { data, width, height })
    }

    /// Row `v`.
    pub(crate) fn row(&self, v: usize) -> &[f32] {
        &self.data[v * self.width..(v + 1) * self.width]
    }

    /// Grey level at a pixel.
    #[inline]
    pub(crate) fn at(&self, u: usize, v: usize) -> f32 {
        self.data[v * self.width + u]
    }

    /// Blurred by the binomial (1 4 6 4 1)/16 in both directions; the border is repeated.
    pub(crate) fn smoothed(&self) -> Self {
        let mut out = vec![0.0_f32; self.data.len()];
        let mut column = vec![0.0_f32; self.width + 4];
        let last = self.height - 1;
        for v in 0..self.height {
            let r = [v.saturating_sub(2), v.saturating_sub(1), v, (v + 1).min(last), (v + 2).min(last)]
                .map(|k| self.row(k));
            for (i, c) in column[2..self.width + 2].iter_mut().enumerate() {
                *c = (r[0][i] + r[4][i]) + 4.0 * (r[1][i] + r[3][i]) + 6.0 * r[2][i];
            }
            repeat_ends(&mut column, 2);
            let target = &mut out[v * self.width..(v + 1) * self.width];
            let n = target.len();
            let (a, b, c, d, e) =
                (&column[..n], &column[1..=n], &column[2..n + 2], &column[3..n + 3], &column[4..n + 4]);
            for i in 0..n {
                target[i] = ((a[i] + e[i]) + 4.0 * (b[i] + d[i]) + 6.0 * c[i]) * (1.0 / 256.0);
            }
        }
        Self { data: out, width: self.width, height: self.height }
    }

    /// Minus the mean over the window around each pixel.
    pub(crate) fn minus_local_mean(&self) -> Self {
        const R: usize = MEAN_RADIUS;
        let mut out = vec![0.0_f32; self.data.len()];
        let mut column = vec![0.0_f32; self.width + 2 * R];
        let last = self.height - 1;
        let norm = 1.0 / ((2 * R + 1) * (2 * R + 1)) as f32;
        for v in 0..self.height {
            column.fill(0.0);
            let sums = &mut column[R..R + self.width];
            for k in 0..=2 * R {
                let row = self.row((v + k).saturating_sub(R).min(last));
                for (s, x) in sums.iter_mut().zip(row) {
                    *s += x;
                }
            }
            repeat_ends(&mut column, R);
            let target = &mut out[v * self.width..(v + 1) * self.width];
            let n = target.len();
            for k in 0..=2 * R {
                for (t, c) in target.iter_mut().zip(&column[k..k + n]) {
                    *t += c;
                }
            }
            for (t, s) in target.iter_mut().zip(self.row(v)) {
                *t = s - *t * norm;
            }
        }
        Self { data: out, width: self.width, height: self.height }
    }

    /// Every second pixel of every second row; pixel (u, v) becomes (2 u, 2 v) of the finer level.
    pub(crate) fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut data = Vec::with_capacity(width * height);
        for v in 0..height {
            data.extend(self.row(2 * v).iter().step_by(2));
        }
        Self { data, width, height }
    }

    /// Standard deviation of the pixel noise, grey levels, from second differences that planes and edges leave at zero.
    pub(crate) fn noise(&self) -> f32 {
        if self.width < 3 || self.height < 3 {
            return 0.0;
        }
        // A few ten thousand pixels fix the median to a per cent.
        let step = ((self.width * self.height / 40_000) as f64).sqrt().floor().max(1.0) as usize;
        let mut seen = Vec::with_capacity(60_000);
        for v in (1..self.height - 1).step_by(step) {
            let (a, b, c) = (self.row(v - 1), self.row(v), self.row(v + 1));
            for u in (1..self.width - 1).step_by(step) {
                let d = (a[u - 1] + a[u + 1] + c[u - 1] + c[u + 1]) - 2.0 * (a[u] + c[u] + b[u - 1] + b[u + 1])
                    + 4.0 * b[u];
                seen.push(d.abs());
            }
        }
        let middle = seen.len() / 2;
        let (_, median, _) = seen.select_nth_unstable_by(middle, f32::total_cmp);
        *median / (0.6745 * 6.0)
    }

    /// Span of the grey levels without the darkest and brightest thousandth.
    pub(crate) fn range(&self) -> f32 {
        let step = (self.data.len() / 100_000).max(1) | 1;
        let mut seen: Vec<f32> = self.data.iter().step_by(step).copied().collect();
        let cut = seen.len() / 1000;
        let last = seen.len() - 1;
        let high = *seen.select_nth_unstable_by(last - cut, f32::total_cmp).1;
        let low = *seen.select_nth_unstable_by(cut, f32::total_cmp).1;
        high - low
    }
}

/// Copies the first and last inner values into `pad` places at either end.
fn repeat_ends(line: &mut [f32], pad: usize) {
    let n = line.len();
    let (first, last) = (line[pad], line[n - pad - 1]);
    line[..pad].fill(first);
    line[n - pad..].fill(last);
}
