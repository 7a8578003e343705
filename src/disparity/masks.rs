//! Where particle images may be looked at.
//!
//! A model, a wall or a reflection is the same in all images and no particle: windows would find it alike in both cameras wherever the sheet is.
//! Pixels of 0 in the mask of a camera are left out with all to which interpolation would carry their light: a pixel of the sheet is seen where no pixel
//! within `REACH_PX` of the nearest one, along rows and columns, is left out.

use crate::dewarp::{Kernel, Sampler, SheetGrid, SheetMap, resample};
use crate::error::{Insufficient, Invalid, Result};
use crate::image::{GrayView, Samples};
use nalgebra::Vector2;

/// Cubic interpolation takes four pixels in a row, of which the nearest to a place is the second or the third.
const REACH_PX: usize = 2;

/// The pixels of one camera that may be used.
pub(super) struct Mask {
    used: Vec<bool>,
    width: usize,
    /// 1 where all pixels within reach may be used, 0 elsewhere.
    clear: Sampler,
}

impl Mask {
    /// From an image of the size of the camera's: pixels of 0 are left out.
    ///
    /// # Errors
    /// [`Invalid::Contradiction`] for another size, [`Insufficient::Degenerate`] where no pixel is left.
    pub(super) fn of(view: &GrayView<'_>, size_px: [usize; 2], camera: &str) -> Result<Self> {
        let [width, height] = size_px;
        if [view.width(), view.height()] != size_px {
            let what = format!(
                "the mask of camera \"{camera}\" is {} x {} px, but its images are {width} x {height} px",
                view.width(),
                view.height()
            );
            return Err(Invalid::Contradiction(what).into());
        }
        let used: Vec<bool> = (0..height).flat_map(|v| (0..width).map(move |u| view.get(u, v) > 0.0)).collect();
        let clear: Vec<f32> = eroded(&used, width, REACH_PX).iter().map(|c| f32::from(u8::from(*c))).collect();
        if !clear.contains(&1.0) {
            let what = format!(
                "the mask of camera \"{camera}\" leaves no pixel: pixels of 0 (black) are left out, all others are used"
            );
            return Err(Insufficient::Degenerate(what).into());
        }
        let clear = Sampler::new(&GrayView::new(Samples::F32(&clear), width, height, width)?, Kernel::Nearest);
        Ok(Self { used, width, clear })
    }

    /// Whether a pixel may be used, rows packed.
    pub(super) fn used(&self) -> &[bool] {
        &self.used
    }

    /// Takes away what the mask leaves out of what a camera sees of the sheet, rows packed.
    pub(super) fn take_off(&self, seen: &mut [bool], map: &SheetMap, grid: &SheetGrid) {
        let (clear, _) = resample(&self.clear, map, grid, 0.0);
        seen.iter_mut().zip(&clear).for_each(|(s, c)| *s &= *c > 0.5);
    }

    /// Squares of `factor` px of which every pixel may be used.
    pub(super) fn binned(&self, size_px: [usize; 2], factor: usize) -> Vec<bool> {
        let mut out = vec![true; size_px[0] * size_px[1]];
        for v in 0..size_px[1] * factor {
            let row = &self.used[v * self.width..][..size_px[0] * factor];
            let squares = &mut out[(v / factor) * size_px[0]..][..size_px[0]];
            squares.iter_mut().zip(row.chunks_exact(factor)).for_each(|(s, used)| *s &= !used.contains(&false));
        }
        out
    }
}

/// Whether all pixels within `reach` along rows and columns are set.
pub(super) fn eroded(set: &[bool], width: usize, reach: usize) -> Vec<bool> {
    let height = set.len() / width;
    let near = |i: usize, n: usize| i.saturating_sub(reach)..(i + reach + 1).min(n);
    let rows: Vec<bool> = (0..set.len()).map(|i| near(i % width, width).all(|u| set[i / width * width + u])).collect();
    (0..set.len()).map(|i| near(i / width, height).all(|v| rows[v * width + i % width])).collect()
}

/// Whether a place between pixels lies on one that is set.
pub(super) fn set_at(set: &[bool], width: usize, place: &Vector2<f64>) -> bool {
    let (u, v) = (place.x.round().max(0.0) as usize, place.y.round().max(0.0) as usize);
    set.get(v * width + u.min(width - 1)).is_some_and(|s| *s)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(data: &[u8], width: usize) -> GrayView<'_> {
        GrayView::new(Samples::U8(data), width, data.len() / width, width).unwrap()
    }

    #[test]
    fn what_lies_near_a_pixel_that_is_left_out_is_not_set() {
        let (w, h) = (9, 7);
        let mut set = vec![true; w * h];
        set[3 * w + 5] = false;
        let out = eroded(&set, w, 2);
        for (i, o) in out.iter().enumerate() {
            assert_eq!(*o, (i % w).abs_diff(5) > 2 || (i / w).abs_diff(3) > 2, "{i}");
        }
        assert!(set_at(&out, w, &Vector2::new(8.4, 3.0)) && !set_at(&out, w, &Vector2::new(7.4, 3.4)));
    }

    #[test]
    fn squares_hold_no_pixel_that_is_left_out() {
        let (w, h) = (13, 9);
        let mut data = vec![255; w * h];
        data[4 * w + 7] = 0;
        let mask = Mask::of(&view(&data, w), [w, h], "left").unwrap();
        let squares = mask.binned([6, 4], 2);
        assert_eq!(squares.iter().filter(|s| !**s).count(), 1);
        assert!(!squares[2 * 6 + 3]);
    }

    #[test]
    fn masks_that_do_not_fit_are_told() {
        let told = |data: &[u8], size| Mask::of(&view(data, 6), size, "left").err().unwrap().to_string();
        assert!(told(&[1; 36], [6, 5]).contains("6 x 6 px, but its images are 6 x 5 px"));
        assert!(told(&[0; 36], [6, 6]).contains("leaves no pixel"));
        let mut line = [0; 36];
        line[6..12].fill(9);
        assert!(told(&line, [6, 6]).contains("leaves no pixel"), "nothing is out of reach");
    }
}
