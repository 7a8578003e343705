//! A correlation peak to its subpixel place and width.
//!
//! `ln C = c0 + g . d - d^T H d / 2` by least squares over the samples around the maximum that exceed a part of it, weighted by
//! C^2 (equal noise of C); the peak is at `H^-1 g`, its covariance `H^-1`.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Samples this far from the maximum take part, px.
const REACH: isize = 3;
/// And exceed this part of it.
const PART: f64 = 0.35;
/// A second peak is looked for beyond this distance, px.
const APART: isize = 5;

/// A correlation map: `width` x `height`, the zero shift in the middle.
pub(super) struct CorrelationMap {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) values: Vec<f64>,
}

/// What a peak says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peak {
    /// Shift of the second image against the first, px, y down.
    pub(super) shift_px: Vector2<f64>,
    /// Covariance of the Gaussian, px^2.
    pub(super) shape_px2: Matrix2<f64>,
    /// Height.
    pub(super) height: f64,
    /// Height over that of the second peak.
    pub(super) ratio: f64,
}

impl CorrelationMap {
    /// Value at a shift; none outside.
    pub(super) fn at(&self, dx: isize, dy: isize) -> Option<f64> {
        let (x, y) = (dx + (self.width / 2) as isize, dy + (self.height / 2) as isize);
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        inside.then(|| self.values[y as usize * self.width + x as usize])
    }

    fn shifts(&self) -> impl Iterator<Item = (isize, isize)> + '_ {
        let (hx, hy) = ((self.width / 2) as isize, (self.height / 2) as isize);
        (0..self.height as isize).flat_map(move |y| (0..self.width as isize).map(move |x| (x - hx, y - hy)))
    }

    /// The highest peak within `search` px; `without_zero` leaves the sample at no shift out (noise correlates with itself there).
    pub(super) fn peak(&self, search: usize, without_zero: bool) -> Option<Peak> {
        let near = |d: &(isize, isize)| d.0.unsigned_abs() <= search && d.1.unsigned_abs() <= search;
        let value = |d: &(isize, isize)| self.at(d.0, d.1).unwrap_or(f64::NEG_INFINITY);
        let highest = |keep: &dyn Fn(&(isize, isize)) -> bool| {
            self.shifts().filter(|d| near(d) && keep(d)).fold(None, |best: Option<((isize, isize), f64)>, d| match best
            {
                Some((_, h)) if h >= value(&d) => best,
                _ => Some((d, value(&d))),
            })
        };
        let (at, height) =
            if without_zero { ((0, 0), self.at(0, 1)?.max(self.at(1, 0)?)) } else { highest(&|_| true)? };
        let apart = |d: &(isize, isize)| (d.0 - at.0).abs() > APART || (d.1 - at.1).abs() > APART;
        let second = highest(&apart).map_or(0.0, |s| s.1).max(1e-12);
        if !(height > 0.0) {
            return None;
        }
        let fit = self.gaussian(at, height, without_zero)?;
        Some(Peak {
            shift_px: Vector2::new(at.0 as f64, at.1 as f64) + fit.0,
            shape_px2: fit.1,
            height,
            ratio: height / second,
        })
    }

    /// Place relative to `at` and covariance.
    fn gaussian(&self, at: (isize, isize), height: f64, without_zero: bool) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let (mut normal, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
        let mut count = 0;
        for dy in -REACH..=REACH {
            for dx in -REACH..=REACH {
                if without_zero && dx == 0 && dy == 0 {
                    continue;
                }
                let Some(c) = self.at(at.0 + dx, at.1 + dy).filter(|c| *c > PART * height) else { continue };
                let (x, y) = (dx as f64, dy as f64);
                let row = SVector::<f64, 6>::from([1.0, x, y, x * x, x * y, y * y]);
                normal += row * row.transpose() * (c * c);
                right += row * (c * c * (c / height).ln());
                count += 1;
            }
        }
        if count < 6 {
            return None;
        }
        let s = normal.cholesky()?.solve(&right);
        let h = Matrix2::new(-2.0 * s[3], -s[4], -s[4], -2.0 * s[5]);
        let shape = h.try_inverse()?;
        let place = shape * Vector2::new(s[1], s[2]);
        (h.m11 > 0.0 && h.determinant() > 0.0 && place.amax() < 1.5).then_some((place, shape))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gaussian_is_found_with_its_width_also_without_its_middle() {
        let shape = Matrix2::new(2.2, 0.4, 0.4, 1.3);
        let h = shape.try_inverse().unwrap();
        for (shift, without_zero) in [(Vector2::new(3.37, -5.81), false), (Vector2::new(0.0, 0.0), true)] {
            let mut map = CorrelationMap { width: 33, height: 33, values: vec![] };
            let c = |dx: isize, dy: isize| {
                let d = Vector2::new(dx as f64, dy as f64) - shift;
                let spike = if without_zero && dx == 0 && dy == 0 { 0.7 } else { 0.0 };
                0.8 * (-0.5 * d.dot(&(h * d))).exp() + spike
            };
            map.values = map.shifts().map(|(x, y)| c(x, y)).collect();
            let p = map.peak(16, without_zero).unwrap();
            assert!((p.shift_px - shift).norm() < 1e-9 && (p.shape_px2 - shape).norm() < 1e-9, "{p:?}");
            assert!(p.ratio > 5.0);
        }
        assert!(CorrelationMap { width: 9, height: 9, values: vec![0.0; 81] }.peak(4, false).is_none());
    }
}
