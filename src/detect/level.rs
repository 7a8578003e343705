//! One size of the image, as lines are followed and judged on it.

/// Smoothed grey levels and the field whose zero lines are the first guess of contours.
pub(crate) trait Level {
    /// Width, px.
    fn width(&self) -> usize;
    /// Height, px.
    fn height(&self) -> usize;
    /// Smoothed grey level at a pixel, grey.
    fn smooth(&self, u: usize, v: usize) -> f32;
    /// Its difference from the local mean, in a unit that is the same all over the image.
    fn field(&self, u: usize, v: usize) -> f32;
}
