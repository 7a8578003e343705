//! A correlation peak to its subpixel place and width, and how far it stands out.
//!
//! ```text
//! ln C = c0 + g . d - d^T H d / 2        least squares over samples around the maximum, weighted by C^2 (equal noise of C)
//! place = H^-1 g,   S = H^-1             S: covariance of the peak
//! ratio = height / max C(d) sqrt(overlap(d) / overlap(peak))   over the whole map where (d - peak)^T S^-1 (d - peak) > APART^2
//! near  = height / max C(d)              as far as the first was looked for, beyond APART_PX and FLANK standard deviations of it
//! ```
//! S counts with standard deviations of at most [`WIDEST`] of the window in both: it cannot tell a wider peak from what lies beside it.
//!
//! Samples exceed a part of the maximum and lie within a few pixels: its top, whatever the foot is like. Where the *width* is asked for, they follow it:
//! as far as the peak that they show is wide, in its ellipse. Noise of C falls with the root of the overlap. Among many
//! windows of one plane the second is sought where the first was; a window alone is told from chance by the whole map, however near it was looked for.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Samples this far from the maximum take part in any case, px.
const REACH_PX: isize = 3;
/// And those as far as this many standard deviations of a wider peak.
const REACH: f64 = 2.0;
/// Where they exceed this part of it.
const PART: f64 = 0.35;
/// Those beside the maximum already where they exceed this part: a peak of sharp images is no wider.
const PART_BESIDE: f64 = 0.02;
/// What of a normal equation the others may leave, at least; less is rounding.
const DETERMINED: f64 = 1e-9;
/// Fewest samples: the maximum and its four neighbours.
const FEWEST: usize = 5;
/// A second peak is looked for beyond this many standard deviations of the first.
const APART: f64 = 4.0;
/// Or, near the first, beyond this distance, px.
const APART_PX: isize = 5;
/// And this many standard deviations: less than those, for a peak of a few pixels is told by its distance.
const FLANK: f64 = 3.0;
/// Standard deviations of a first peak count as no more than this part of the window.
pub(super) const WIDEST: f64 = 1.0 / 16.0;
/// Rounds in which the samples follow the width that they show.
const ROUNDS: usize = 6;

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
    /// Where the largest sample is.
    at: (isize, isize),
}

/// Which samples of a peak are fitted.
struct Samples {
    at: (isize, isize),
    height: f64,
    reach: [isize; 2],
    /// H of the ellipse that they lie in; all within reach without one.
    ellipse: Option<Matrix2<f64>>,
    without_zero: bool,
}

impl Samples {
    /// As far as a peak of this covariance reaches.
    fn follow(&mut self, shape_px2: &Matrix2<f64>) {
        let wide = [0, 1].map(|a| (REACH * shape_px2[(a, a)].sqrt()).ceil() as isize);
        self.reach = [0, 1].map(|a| wide[a].max(REACH_PX));
        self.ellipse = if wide.iter().any(|w| *w > REACH_PX) { shape_px2.try_inverse() } else { None };
    }
}

impl CorrelationMap {
    /// Value at a shift; none outside.
    pub(super) fn at(&self, dx: isize, dy: isize) -> Option<f64> {
        let (x, y) = (dx + (self.width / 2) as isize, dy + (self.height / 2) as isize);
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        inside.then(|| self.values[y as usize * self.width + x as usize])
    }

    pub(super) fn shifts(&self) -> impl Iterator<Item = (isize, isize)> + '_ {
        let (hx, hy) = ((self.width / 2) as isize, (self.height / 2) as isize);
        (0..self.height as isize).flat_map(move |y| (0..self.width as isize).map(move |x| (x - hx, y - hy)))
    }

    /// The highest peak within `search` px: place and curvature of its top.
    pub(super) fn peak(&self, search: usize) -> Option<Peak> {
        let (at, height) = self.highest(search, |_| true)?;
        self.top(&Samples { at, height, reach: [REACH_PX; 2], ellipse: None, without_zero: false })
    }

    /// The largest sample of those to be looked at within `search` px.
    fn highest(&self, search: usize, looked: impl Fn(&(isize, isize)) -> bool) -> Option<((isize, isize), f64)> {
        let near = |d: &(isize, isize)| d.0.unsigned_abs() <= search && d.1.unsigned_abs() <= search;
        let mut best: Option<((isize, isize), f64)> = None;
        for d in self.shifts().filter(|d| near(d) && looked(d)) {
            let c = self.at(d.0, d.1).unwrap_or(f64::NEG_INFINITY);
            if best.is_none_or(|(_, h)| c > h) {
                best = Some((d, c));
            }
        }
        best
    }

    /// The highest peak within `search` px, as wide as it is.
    pub(super) fn wide_peak(&self, search: usize) -> Option<Peak> {
        let top = self.peak(search)?;
        self.followed(Samples {
            at: top.at,
            height: top.height,
            reach: [REACH_PX; 2],
            ellipse: None,
            without_zero: false,
        })
    }

    /// The peak of an autocorrelation, as wide as it is, without the sample at no shift (noise correlates with itself there).
    pub(super) fn own_peak(&self) -> Option<Peak> {
        let height = self.at(0, 1)?.max(self.at(1, 0)?);
        self.followed(Samples { at: (0, 0), height, reach: [REACH_PX; 2], ellipse: None, without_zero: true })
    }

    /// From its top outwards, as far as it is found wide.
    fn followed(&self, mut samples: Samples) -> Option<Peak> {
        let mut peak = self.top(&samples)?;
        for _ in 0..ROUNDS {
            let before = samples.reach;
            samples.follow(&peak.shape_px2);
            if (0..2).all(|a| samples.reach[a] <= before[a]) {
                break;
            }
            let Some(wider) = self.top(&samples) else { break };
            peak = wider;
        }
        Some(peak)
    }

    fn top(&self, samples: &Samples) -> Option<Peak> {
        if !(samples.height > 0.0) {
            return None;
        }
        let (place, shape_px2) = self.gaussian(samples)?;
        let shift_px = Vector2::new(samples.at.0 as f64, samples.at.1 as f64) + place;
        Some(Peak { shift_px, shape_px2, height: samples.height, at: samples.at })
    }

    /// Place relative to the maximum and covariance.
    fn gaussian(&self, of: &Samples) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let (mut normal, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
        let mut count = 0;
        let [rx, ry] = [of.reach[0].min(self.width as isize), of.reach[1].min(self.height as isize)];
        for dy in -ry..=ry {
            for dx in -rx..=rx {
                let (x, y) = (dx as f64, dy as f64);
                let d = Vector2::new(x, y);
                let outside = of.ellipse.is_some_and(|h| d.dot(&(h * d)) > REACH * REACH);
                if outside || of.without_zero && dx == 0 && dy == 0 {
                    continue;
                }
                let part = if dx.abs() <= 1 && dy.abs() <= 1 { PART_BESIDE } else { PART };
                let Some(c) = self.at(of.at.0 + dx, of.at.1 + dy).filter(|c| *c > part * of.height) else { continue };
                let row = SVector::<f64, 6>::from([1.0, x, y, x * x, x * y, y * y]);
                normal += row * row.transpose() * (c * c);
                right += row * (c * c * (c / of.height).ln());
                count += 1;
            }
        }
        if count < FEWEST {
            return None;
        }
        // Where samples off both axes do not tell how these go together, they are taken as they are along each.
        let s = solved(&normal, &right).or_else(|| {
            for k in 0..6 {
                (normal[(4, k)], normal[(k, 4)]) = (0.0, 0.0);
            }
            (normal[(4, 4)], right[4]) = (1.0, 0.0);
            solved(&normal, &right)
        })?;
        let h = Matrix2::new(-2.0 * s[3], -s[4], -s[4], -2.0 * s[5]);
        let shape = h.try_inverse()?;
        let place = shape * Vector2::new(s[1], s[2]);
        let beside = (0..2).all(|a| place[a].abs() < 0.5 * of.reach[a] as f64);
        (h.m11 > 0.0 && h.determinant() > 0.0 && beside).then_some((place, shape))
    }

    /// Height of a peak over that of the second where it was looked for: how well it is told from chance there. The flanks of a peak that light draws
    /// out are none; where they fill what was looked at, the whole map tells.
    pub(super) fn ratio_near(&self, peak: &Peak, search: usize) -> f64 {
        let shape = at_most(&peak.shape_px2, WIDEST * self.width as f64);
        let Some(flank) = shape.try_inverse() else { return 0.0 };
        let apart = |d: &(isize, isize)| {
            let at = Vector2::new(d.0 as f64, d.1 as f64) - peak.shift_px;
            let far = (d.0 - peak.at.0).abs() > APART_PX || (d.1 - peak.at.1).abs() > APART_PX;
            far && at.dot(&(flank * at)) > FLANK * FLANK
        };
        match self.highest(search, apart) {
            Some((_, second)) => peak.height / second.max(1e-12),
            None => self.ratio(peak, &shape),
        }
    }

    /// Height of a peak over that of the second in the whole map, beyond a peak of the covariance `shape_px2`; 0 where that leaves nothing of the map.
    pub(super) fn ratio(&self, peak: &Peak, shape_px2: &Matrix2<f64>) -> f64 {
        let Some(h) = shape_px2.try_inverse() else { return 0.0 };
        let root = |d: f64, side: usize| (1.0 - d.abs() / side as f64).max(0.0).sqrt();
        let [across, down] =
            [self.width, self.height].map(|n| (0..n).map(|i| root(i as f64 - (n / 2) as f64, n)).collect::<Vec<f64>>());
        let mut second = f64::NEG_INFINITY;
        for (row, y) in self.values.chunks_exact(self.width).zip(0..) {
            let dy = y as f64 - (self.height / 2) as f64 - peak.shift_px.y;
            for (c, x) in row.iter().zip(0..) {
                let dx = x as f64 - (self.width / 2) as f64 - peak.shift_px.x;
                let apart = h.m11 * dx * dx + 2.0 * h.m12 * dx * dy + h.m22 * dy * dy > APART * APART;
                if apart {
                    second = second.max(c * across[x] * down[y]);
                }
            }
        }
        if second == f64::NEG_INFINITY {
            return 0.0;
        }
        peak.height * root(peak.shift_px.x, self.width) * root(peak.shift_px.y, self.height) / second.max(1e-12)
    }
}

/// The solution of normal equations that determine it.
fn solved(normal: &SMatrix<f64, 6, 6>, right: &SVector<f64, 6>) -> Option<SVector<f64, 6>> {
    let factor = normal.cholesky()?;
    let l = factor.l_dirty();
    let determined = (0..6).all(|i| l[(i, i)] * l[(i, i)] > DETERMINED * normal[(i, i)]);
    determined.then(|| factor.solve(right))
}

/// A covariance with standard deviations of at most `sigma_px` in all directions: a window cannot tell a wider peak from what lies beside it.
pub(super) fn at_most(shape_px2: &Matrix2<f64>, sigma_px: f64) -> Matrix2<f64> {
    let mut e = shape_px2.symmetric_eigen();
    e.eigenvalues.iter_mut().for_each(|v| *v = v.min(sigma_px * sigma_px));
    e.recompose()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hills(side: usize, hills: &[(f64, Vector2<f64>, Matrix2<f64>)]) -> CorrelationMap {
        let mut map = CorrelationMap { width: side, height: side, values: vec![] };
        let value = |(x, y): (isize, isize)| -> f64 {
            let one = |(height, place, shape): &(f64, Vector2<f64>, Matrix2<f64>)| {
                let d = Vector2::new(x as f64, y as f64) - place;
                height * (-0.5 * d.dot(&(shape.try_inverse().unwrap() * d))).exp()
            };
            hills.iter().map(one).sum()
        };
        map.values = map.shifts().map(value).collect();
        map
    }

    #[test]
    fn a_gaussian_is_found_with_its_width_also_without_its_middle() {
        // Narrow, and of a width of which three pixels are the top alone.
        for shape in [Matrix2::new(2.2, 0.4, 0.4, 1.3), Matrix2::new(60.0, 10.0, 10.0, 3.0)] {
            let shift = Vector2::new(3.37, -5.81);
            let map = hills(65, &[(0.8, shift, shape)]);
            for p in [map.peak(16).unwrap(), map.wide_peak(16).unwrap()] {
                assert!((p.shift_px - shift).norm() < 1e-7 && (p.shape_px2 - shape).norm() < 1e-6, "{p:?}");
                assert!(map.ratio(&p, &p.shape_px2) > 5.0);
            }
            let mut map = hills(65, &[(0.8, Vector2::zeros(), shape)]);
            map.values[32 * 65 + 32] += 0.7;
            let p = map.own_peak().unwrap();
            assert!(p.shift_px.norm() < 1e-7 && (p.shape_px2 - shape).norm() < 1e-6, "{p:?}");
        }
        assert!(hills(9, &[]).peak(4).is_none() && hills(9, &[]).wide_peak(4).is_none());
    }

    /// Images of particles a pixel wide and less, and shifts of all parts of a pixel.
    #[test]
    fn peaks_of_sharp_images_are_found_wherever_they_lie() {
        for (k, sigma) in [0.55, 0.65, 0.8, 1.0].into_iter().enumerate() {
            let shape = Matrix2::identity() * (sigma * sigma);
            for part in [0.0, 0.25, 0.5] {
                let shift = Vector2::new(2.0 + part, -1.0 - 0.5 * part);
                let mut map = hills(33, &[(0.8, shift, shape)]);
                let p = map.peak(8).unwrap();
                assert!(
                    (p.shift_px - shift).norm() < 0.02 && (p.shape_px2 - shape).norm() < 0.05,
                    "{sigma} {part} {p:?}"
                );
                // Chance beside it.
                let noise = |i: usize| 0.01 * ((i * 7919 + k) % 101) as f64 / 101.0 - 0.005;
                map.values.iter_mut().enumerate().for_each(|(i, v)| *v += noise(i));
                let p = map.peak(8).unwrap();
                assert!((p.shift_px - shift).norm() < 0.06, "{sigma} {part} {p:?}");
            }
        }
        // Nor are samples that do not determine a peak: two rows of three, and a cross that lacks an arm, whatever is beside it.
        for lacking in [&[(-1, -1), (0, -1), (1, -1)][..], &[(0, -1), (-1, -1), (-1, 1), (1, -1)]] {
            let mut map = hills(33, &[(0.8, Vector2::new(0.1, 0.2), Matrix2::identity() * 0.3)]);
            let at = |(x, y): (isize, isize)| ((y + 16) * 33 + x + 16) as usize;
            let far: Vec<_> = map.shifts().filter(|d| d.0.abs() > 1 || d.1.abs() > 1).collect();
            far.into_iter().for_each(|d| map.values[at(d)] = 0.0);
            lacking.iter().for_each(|d| map.values[at(*d)] = 0.0);
            assert_eq!(map.peak(8), None, "{lacking:?}");
        }
        // A single sample is none.
        let mut map = hills(33, &[]);
        map.values[16 * 33 + 16] = 1.0;
        assert!(map.peak(8).is_none());
    }

    #[test]
    fn the_second_peak_is_sought_over_the_whole_map_and_not_on_the_flank_of_the_first() {
        let narrow = Matrix2::identity() * 1.7;
        let far = |height: f64| (height, Vector2::new(-11.0, 9.0), narrow);
        let ratio = |map: &CorrelationMap, search: usize| {
            let p = map.peak(search).unwrap();
            map.ratio(&p, &at_most(&p.shape_px2, map.width as f64 / 16.0))
        };
        // 0.45 of the height where five ninths of the width and eight elevenths of the height overlap.
        let map = hills(32, &[(1.0, Vector2::zeros(), narrow), far(0.45)]);
        let wanted = 1.0 / (0.45 * (21.0 / 32.0 * 23.0 / 32.0_f64).sqrt());
        assert!((ratio(&map, 4) / wanted - 1.0).abs() < 0.05, "{} {wanted}", ratio(&map, 4));
        // Chance, of which the higher one is out of reach.
        let map = hills(32, &[(0.5, Vector2::new(0.4, 0.2), narrow), far(0.9)]);
        assert!(ratio(&map, 4) < 1.0, "{}", ratio(&map, 4));
        // Thick light.
        let thick = Matrix2::new(160.0, 20.0, 20.0, 5.0);
        let map = hills(64, &[(1.0, Vector2::zeros(), thick), (0.2, Vector2::new(3.0, 20.0), narrow)]);
        let p = map.wide_peak(8).unwrap();
        assert!((4.5..7.5).contains(&map.ratio(&p, &thick)), "{}", map.ratio(&p, &thick));
        // Near the first: its flank is none, another peak is; where the flank fills what was looked at, the map tells.
        let wide = hills(256, &[(1.0, Vector2::zeros(), thick), (0.2, Vector2::new(3.0, 20.0), narrow)]);
        let near = wide.ratio_near(&wide.peak(8).unwrap(), 24);
        assert!((near / 5.0 - 1.0).abs() < 0.05, "{near}");
        let beside = hills(64, &[(1.0, Vector2::zeros(), narrow), (0.7, Vector2::new(8.0, 1.0), narrow)]);
        let near = beside.ratio_near(&beside.peak(4).unwrap(), 12);
        assert!((near * 0.7 - 1.0).abs() < 0.05, "{near}");
        let round = hills(256, &[(1.0, Vector2::zeros(), Matrix2::identity() * 100.0)]);
        let near = round.ratio_near(&round.peak(8).unwrap(), 12);
        assert!((100.0..1e6).contains(&near), "{near}");
        // A window no larger than the first peak cannot tell it from a second.
        assert_eq!(
            hills(8, &[(1.0, Vector2::zeros(), thick)]).peak(2).map(|p| map.ratio(&p, &(thick * 99.0))),
            Some(0.0)
        );
    }
}
