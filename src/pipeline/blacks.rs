//! Noise beside contours that is cut off at grey level 0, where no camera says how dark it was.
//!
//! What is left of such noise is brighter on average than the ground or the disc is, and takes contours along: dark discs come out larger, bright ones smaller.
//! With `z(P)` the standard deviations below which a normal number lies with the probability P, `P_0` the part of pixels at 0, `P_g` of those up to a
//! level g and q the distance of two levels,
//!
//! ```text
//! s = g / (z(P_g) - z(P_0)),    C = P(z < z(P_0) - q / s)
//! ```
//!
//! s is the standard deviation of the noise and C the part of it that rounding alone would not have taken to 0. A ground without noise, and noise of less
//! than some half level, cannot be cut off.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | `P_0`, `P_g` | `at_zero`, `up_to` | 1 | parts of the pixels |
//! | g, q | `some`, `level` | grey | a level that many pixels exceed, and the least one |

use super::exposure::{ROW_STEP, span};
use crate::conic::Frame;
use crate::detect::Disc;
use crate::image::{GrayView, Samples};
use crate::stats::{median, normal_below, sigmas_below};
use std::ops::Range;

/// From so many blurs and px beside the contour the edge is not seen; so many px further are looked at.
const CLEAR_BLURS: f64 = 2.5;
const CLEAR_PX: f64 = 0.5;
const WIDE_PX: f64 = 6.0;
/// Fewer pixels tell nothing.
const LEAST: usize = 100;

/// Part of the pixels beside the contours of discs, inside or outside, whichever is more, whose noise is cut off at grey level 0.
///
/// Every fourth row is looked at. Where grey levels are below 0 nothing is.
pub fn cut_at_zero<'a>(view: &GrayView<'_>, discs: impl Iterator<Item = &'a Disc>) -> f64 {
    let bands: Vec<Band> = discs.map(Band::beside).collect();
    let looked_at =
        bands.iter().flat_map(|band| band.rows(view).flat_map(|v| band.stretches(v, view.width()).map(|u| (v, u))));
    // Most cameras have an offset, and none.
    if !looked_at.clone().any(|(v, columns)| any_zero(view, v, columns)) {
        return 0.0;
    }
    let mut sides = [Side::default(), Side::default()];
    for band in &bands {
        for v in band.rows(view) {
            for columns in band.stretches(v, view.width()) {
                let mut last = None;
                for u in columns {
                    let seen = band.side(u, v).map(|outside| (outside, view.get(u, v)));
                    if let Some((outside, grey)) = seen {
                        let before = last.filter(|(side, _)| *side == outside).map(|(_, grey)| grey);
                        sides[usize::from(outside)].take(grey, before);
                    }
                    last = seen;
                }
            }
        }
    }
    sides.iter_mut().map(Side::cut_off).fold(0.0, f64::max)
}

/// Pixels on either side of a contour, clear of its edge.
struct Band {
    frame: Frame,
    /// Distances from the contour, px.
    nearest: f64,
    furthest: f64,
}

impl Band {
    fn beside(disc: &Disc) -> Self {
        let nearest = CLEAR_BLURS * disc.blur_px + CLEAR_PX;
        Self { frame: Frame::new(&disc.ellipse), nearest, furthest: nearest + WIDE_PX }
    }

    fn rows(&self, view: &GrayView<'_>) -> impl Iterator<Item = usize> + Clone + use<> {
        span(self.frame.v0, self.frame.a + self.furthest, view.height()).step_by(ROW_STEP)
    }

    /// Columns of a row, of so many, beyond which none lies near enough: to first order points of `q = |(x/a, y/b)|` are `|q - 1| b` from the
    /// contour or further.
    fn stretches(&self, v: usize, width: usize) -> [Range<usize>; 2] {
        let share = self.furthest / self.frame.b;
        let Some([from, to]) = self.frame.crossed(v as f64, 1.0 + share) else { return [0..0, 0..0] };
        let columns = |from: f64, to: f64| span(0.5 * (from + to), 0.5 * (to - from) + 1.0, width);
        let middle = if share < 1.0 { self.frame.crossed(v as f64, 1.0 - share) } else { None };
        match middle.filter(|[left, right]| right - left > 4.0) {
            Some([left, right]) => [columns(from, left), columns(right, to)],
            None => [columns(from, to), 0..0],
        }
    }

    /// Whether a pixel of the band lies outside of the contour.
    fn side(&self, u: usize, v: usize) -> Option<bool> {
        let out = first_order(&self.frame, u as f64, v as f64);
        (self.nearest..self.furthest).contains(&out.abs()).then_some(out > 0.0)
    }
}

/// Whether one of the grey levels is 0.
fn any_zero(view: &GrayView<'_>, v: usize, columns: Range<usize>) -> bool {
    let at = v * view.stride() + columns.start..v * view.stride() + columns.end;
    match view.samples() {
        Samples::U8(s) => s[at].contains(&0),
        Samples::U16(s) => s[at].contains(&0),
        Samples::F32(s) => s[at].contains(&0.0),
    }
}

/// Distance from an ellipse to first order, px, positive outside; not a number in its middle.
fn first_order(frame: &Frame, u: f64, v: f64) -> f64 {
    let (x, y) = frame.inside(u, v);
    let (x, y) = (x / frame.a, y / frame.b);
    let length = |x: f64, y: f64| (x * x + y * y).sqrt();
    let q = length(x, y);
    (q - 1.0) * q / length(x / frame.a, y / frame.b)
}

/// Pixels on one side of contours.
#[derive(Default)]
struct Side {
    grey: Vec<f32>,
    /// Neighbours in a row, and those of which one alone is 0.
    pairs: usize,
    changes: usize,
}

impl Side {
    fn take(&mut self, grey: f32, before: Option<f32>) {
        self.grey.push(grey);
        if let Some(before) = before {
            self.pairs += 1;
            self.changes += usize::from((before == 0.0) != (grey == 0.0));
        }
    }

    /// C; 0 where nothing speaks for it.
    fn cut_off(&mut self) -> f64 {
        let all = self.grey.len() as f64;
        let part = |of: &dyn Fn(f32) -> bool| self.grey.iter().filter(|g| of(**g)).count() as f64 / all;
        let at_zero = part(&|g| g == 0.0);
        // Noise makes two of neighbours, each for itself, what a slope of light without noise or a patch does not.
        let mixed = self.changes as f64 > at_zero * (1.0 - at_zero) * self.pairs as f64;
        if self.grey.len() < LEAST || !mixed || self.grey.iter().any(|g| *g < 0.0) {
            return 0.0;
        }
        let mut lit: Vec<f64> = self.grey.iter().filter(|g| **g > 0.0).map(|g| f64::from(*g)).collect();
        let level = lit.iter().copied().fold(f64::INFINITY, f64::min);
        let Some(some) = median(&mut lit) else { return 0.0 };
        let up_to = part(&|g| f64::from(g) <= some);
        if at_zero == 0.0 || up_to >= 1.0 {
            return 0.0;
        }
        let z = sigmas_below(at_zero);
        let sigma = some / (sigmas_below(up_to) - z);
        normal_below(z - level / sigma)
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::Ellipse;
    use crate::detect::{DetectOptions, find_discs};
    use crate::frames::Pixel;
    use crate::image::Samples;
    use crate::stats::random::Random;

    const SIZE: usize = 110;

    /// A disc of 150 grey levels more or less than a ground, whichever is darker at `black`, behind a blur of 0.9 px.
    fn seen(black: f64, noise: f64, bright: bool) -> Vec<f64> {
        let e = Ellipse { center_px: Pixel::new(54.3, 55.8), semi_major_px: 32.0, semi_minor_px: 25.0, angle_rad: 0.3 };
        let (frame, mut random) = (Frame::new(&e), Random(7));
        let mut grey = |i: usize| {
            let out = first_order(&frame, (i % SIZE) as f64, (i / SIZE) as f64);
            let light = 150.0 * normal_below(if bright { -out } else { out } / 0.9);
            black + light + (noise * noise + 0.05 * light * f64::from(u8::from(noise > 0.0))).sqrt() * random.gauss()
        };
        (0..SIZE * SIZE).map(&mut grey).collect()
    }

    fn found(grey: &[f64], scale: Option<f64>) -> f64 {
        let floats: Vec<f32> = grey.iter().map(|g| *g as f32).collect();
        let whole =
            |scale: f64| grey.iter().map(|g| (g * scale).round().clamp(0.0, 65535.0) as u16).collect::<Vec<_>>();
        let whole = whole(scale.unwrap_or(1.0));
        let samples = if scale.is_some() { Samples::U16(&whole) } else { Samples::F32(&floats) };
        let view = GrayView::new(samples, SIZE, SIZE, SIZE).expect("an image");
        let all = find_discs(&view, &DetectOptions::default()).expect("a search");
        assert_eq!(all.discs.len(), 1, "{:?}", all.rejections);
        cut_at_zero(&view, all.discs.iter())
    }

    /// What is asked for is what the normal distribution says is cut off: half without an offset, next to nothing from three sigmas on.
    #[test]
    fn noise_that_is_cut_off_is_told_and_no_other() {
        for bright in [true, false] {
            for (black, noise) in
                [(0.0, 3.0), (2.0, 3.0), (4.0, 3.0), (9.0, 3.0), (0.0, 0.9), (3.0, 1.0), (8.0, 8.0), (24.0, 8.0)]
            {
                for scale in [1.0, 16.0] {
                    let part = found(&seen(black, noise, bright), Some(scale));
                    let wanted = normal_below(-(black + 0.5 / scale) / noise);
                    assert!(
                        (part - wanted).abs() < 0.01 + 0.25 * wanted,
                        "{black} {noise} {scale}: {part}, {wanted} wanted"
                    );
                }
            }
        }
    }

    /// What is left out of a row is too far from the contour.
    #[test]
    fn no_pixel_of_a_band_is_left_out() {
        let mut random = Random(3);
        for k in 0..40 {
            let semi_minor_px = 3.0 + 30.0 * random.in_range(0.0, 1.0);
            let e = Ellipse {
                center_px: Pixel::new(90.0 * random.in_range(0.0, 1.0), 90.0 * random.in_range(0.0, 1.0)),
                semi_major_px: semi_minor_px * (1.0 + 2.0 * random.in_range(0.0, 1.0)),
                semi_minor_px,
                angle_rad: f64::from(k),
            };
            let band = Band { frame: Frame::new(&e), nearest: 2.0, furthest: 2.0 + WIDE_PX };
            let mut seen = 0;
            for v in 0..SIZE {
                let [left, right] = band.stretches(v, SIZE);
                for u in (0..SIZE).filter(|u| band.side(*u, v).is_some()) {
                    assert!(left.contains(&u) != right.contains(&u), "{u}, {v} of {e:?}");
                    seen += 1;
                }
            }
            assert!(seen > 20, "{e:?}");
        }
    }

    /// Without noise nothing is, whether the ground is 0 or rises from there; nor by noise of less than a grey level.
    #[test]
    fn a_ground_without_noise_is_not_cut_off() {
        for bright in [true, false] {
            for (black, noise) in [(0.0, 0.0), (0.3, 0.0), (0.4, 0.3), (1.0, 0.5), (12.0, 0.0)] {
                let part = found(&seen(black, noise, bright), Some(1.0));
                assert!(part < 0.01, "{black} {noise}: {part}");
            }
        }
        let slope = |i: usize| 3.0 * (i % SIZE) as f64 / SIZE as f64;
        let rises: Vec<f64> = seen(-0.8, 0.0, true).iter().enumerate().map(|(i, g)| g + slope(i)).collect();
        assert_eq!(found(&rises, Some(1.0)), 0.0);
    }

    /// Floats may be below 0, and then are not cut off there.
    #[test]
    fn floats_are_cut_off_where_none_is_below() {
        let grey = seen(0.0, 3.0, true);
        assert_eq!(found(&grey, None), 0.0);
        let cut: Vec<f64> = grey.iter().map(|g| g.max(0.0)).collect();
        assert!((found(&cut, None) - 0.5).abs() < 0.05);
    }
}
