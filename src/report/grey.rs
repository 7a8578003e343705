//! An image as the background of a picture: 8 bit, stretched between its darkest and brightest half percent.

use crate::image::GrayView;

/// Pixels looked at for the stretch; more change nothing visible.
const SAMPLES: usize = 40_000;

/// An 8-bit background, rows packed.
pub(super) struct Background {
    /// Grey levels.
    pub(super) levels: Vec<u8>,
    /// Width, px of this background.
    pub(super) width: usize,
    /// Height, px of this background.
    pub(super) height: usize,
    /// Image pixels per background pixel, along each axis.
    factor: usize,
}

/// The grey levels that become black and white.
fn limits(view: &GrayView<'_>) -> (f32, f32) {
    let n = view.width() * view.height();
    let step = (n / SAMPLES).max(1);
    // A step that divides the width would look at a few columns only.
    let step = if view.width().is_multiple_of(step) { step + 1 } else { step };
    let mut seen: Vec<f32> =
        (0..n).step_by(step).map(|i| view.get(i % view.width(), i / view.width())).filter(|x| x.is_finite()).collect();
    seen.sort_by(f32::total_cmp);
    let at = |q: f64| seen.get(((seen.len().saturating_sub(1)) as f64 * q) as usize).copied().unwrap_or(0.0);
    (at(0.005), at(0.995))
}

/// The image at full size.
pub(super) fn full(view: &GrayView<'_>) -> Background {
    shrunk(view, usize::MAX)
}

/// The image averaged over squares of whole pixels, so that it is at most `max_width` wide.
///
/// The squares start at the first pixel; the picture must be drawn `factor` times as large as it is, which
/// [`Background::span_px`] gives.
pub(super) fn shrunk(view: &GrayView<'_>, max_width: usize) -> Background {
    let factor = view.width().div_ceil(max_width.max(1)).max(1);
    let (width, height) = (view.width().div_ceil(factor), view.height().div_ceil(factor));
    let (black, white) = limits(view);
    let gain = if white > black { 255.0 / (white - black) } else { 0.0 };
    let offset = if white > black { 0.0 } else { 128.0 };
    let mut levels = Vec::with_capacity(width * height);
    let (mut line, mut sums) = (Vec::with_capacity(view.width()), vec![0.0; width]);
    for row in 0..height {
        let vs = row * factor..((row + 1) * factor).min(view.height());
        let lines = vs.len();
        sums.fill(0.0);
        for v in vs {
            view.row(v, &mut line);
            for (sum, square) in sums.iter_mut().zip(line.chunks(factor)) {
                *sum += square.iter().sum::<f32>();
            }
        }
        for (column, sum) in sums.iter().enumerate() {
            let count = lines * (view.width() - column * factor).min(factor);
            let level = (sum / count as f32 - black) * gain + offset;
            // Samples that are not numbers become black.
            levels.push(level.clamp(0.0, 255.0) as u8);
        }
    }
    Background { levels, width, height, factor }
}

impl Background {
    /// Width and height that it covers, in pixels of the image it was made from (a little beyond its right and lower edge).
    pub(super) fn span_px(&self) -> [f64; 2] {
        [(self.width * self.factor) as f64, (self.height * self.factor) as f64]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Samples;

    #[test]
    fn a_shrunk_image_keeps_its_place() {
        let data: Vec<u16> = (0..70 * 10).map(|i| if i % 70 < 35 { 100 } else { 4000 }).collect();
        let view = GrayView::new(Samples::U16(&data), 70, 10, 70).unwrap();
        let small = shrunk(&view, 20);
        assert_eq!((small.width, small.height), (18, 3));
        assert_eq!(small.span_px(), [72.0, 12.0]);
        assert_eq!((small.levels[7], small.levels[9]), (0, 255));
        let nine = GrayView::new(Samples::U16(&data), 9, 2, 70).unwrap();
        assert_eq!(shrunk(&nine, 3).span_px(), [9.0, 3.0]);
        assert_eq!(shrunk(&nine, 2).span_px(), [10.0, 5.0]);
        assert!((60..200).contains(&small.levels[8]), "the square over the edge is in between");
    }

    #[test]
    fn flat_and_broken_images_are_pictures_too() {
        let flat = [7u8; 12];
        let view = GrayView::new(Samples::U8(&flat), 4, 3, 4).unwrap();
        assert_eq!(full(&view).levels, [128; 12]);
        let broken = [f32::NAN, 0.0, 1.0, f32::INFINITY];
        let view = GrayView::new(Samples::F32(&broken), 2, 2, 2).unwrap();
        assert_eq!(full(&view).levels[0], 0);
        assert_eq!(full(&view).levels.len(), 4);
    }
}
