//! One size of the image, as lines are followed and judged on it.

/// Added to a number below 2^31 it leaves the nearest whole one in the lower half of the bits.
pub(crate) const ROUND: f64 = 6_755_399_441_055_744.0;

/// Smoothed grey levels and the field whose zero lines are the first guess of contours.
pub(crate) trait Level {
    /// Places `v * width + u`, row by row, where a line runs between `u` and `u + 1` and the grey level changes by more than the least gradient.
    fn starts(&self) -> impl Iterator<Item = u32>;
    /// Width, px.
    fn width(&self) -> usize;
    /// Height, px.
    fn height(&self) -> usize;
    /// Smoothed grey level at a pixel, grey.
    fn smooth(&self, u: usize, v: usize) -> f32;
    /// Bilinear grey levels at K places, border repeated. Plain loops, step by step, for vectors: samples that lie far apart are then waited for together.
    #[inline(always)]
    fn greys<const K: usize>(&self, u_px: &[f64; K], v_px: &[f64; K], out: &mut [f64; K]) {
        let last = [self.width() as f64 - 1.001, self.height() as f64 - 1.001];
        let (mut first, mut part) = ([[0_i32; K]; 2], [[0.0; K]; 2]);
        for (axis, x) in [u_px, v_px].into_iter().enumerate() {
            for k in 0..K {
                let x = x[k].max(0.0).min(last[axis]);
                // The whole number at or below, several at a time; of a whole number perhaps the one before, which comes to the same.
                first[axis][k] = (x - 0.5 + ROUND).to_bits() as i32;
                part[axis][k] = x - f64::from(first[axis][k]);
            }
        }
        let mut corner = [[0.0; K]; 4];
        for k in 0..K {
            let [[a, b], [c, d]] = self.square(first[0][k] as usize, first[1][k] as usize);
            (corner[0][k], corner[1][k], corner[2][k], corner[3][k]) = (a, b, c, d);
        }
        for k in 0..K {
            let (fu, fv) = (part[0][k], part[1][k]);
            let (top, bottom) =
                ((1.0 - fu) * corner[0][k] + fu * corner[1][k], (1.0 - fu) * corner[2][k] + fu * corner[3][k]);
            out[k] = (1.0 - fv) * top + fv * bottom;
        }
    }
    /// Smoothed grey levels at (u, v), (u + 1, v) and in the row below.
    #[inline(always)]
    fn square(&self, u: usize, v: usize) -> [[f64; 2]; 2] {
        [v, v + 1].map(|v| [u, u + 1].map(|u| f64::from(self.smooth(u, v))))
    }
    /// The field at (u, v), (u + 1, v), (u + 1, v + 1), (u, v + 1).
    #[inline]
    fn corners(&self, u: usize, v: usize) -> [f32; 4] {
        [self.field(u, v), self.field(u + 1, v), self.field(u + 1, v + 1), self.field(u, v + 1)]
    }
    /// Its difference from the local mean, in a unit that is the same all over the image.
    fn field(&self, u: usize, v: usize) -> f32;
    /// Has what is known around a pixel brought near, where memory can be asked; the pixel may lie beyond the image.
    #[inline(always)]
    fn fetch(&self, _u: usize, _v: usize) {}
}
