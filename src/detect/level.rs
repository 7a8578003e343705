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
        let places = Places::of([u_px, v_px], [self.width(), self.height()]);
        let mut corners = [[0.0; K]; 4];
        for k in 0..K {
            let [u, v] = places.first(k);
            for (corners, (u, v)) in corners.iter_mut().zip([(u, v), (u + 1, v), (u, v + 1), (u + 1, v + 1)]) {
                corners[k] = f64::from(self.smooth(u, v));
            }
        }
        places.blend(&corners, out);
    }
    /// The field at (u, v), (u + 1, v), (u + 1, v + 1), (u, v + 1).
    #[inline]
    fn corners(&self, u: usize, v: usize) -> [f32; 4] {
        [self.field(u, v), self.field(u + 1, v), self.field(u + 1, v + 1), self.field(u, v + 1)]
    }
    /// Its difference from the local mean, in a unit that is the same all over the image.
    fn field(&self, u: usize, v: usize) -> f32;
    /// A bit for each pixel, none of them set; to be given back ([`Level::keep_marks`]).
    fn marks(&self) -> Vec<u64> {
        vec![0; (self.width() * self.height()).div_ceil(64)]
    }
    /// Takes the memory of such bits back.
    fn keep_marks(&self, _marks: Vec<u64>) {}
    /// Has what is known around a pixel brought near, where memory can be asked; the pixel may lie beyond the image.
    #[inline(always)]
    fn fetch(&self, _u: usize, _v: usize) {}
}

/// Places between pixels: the pixels before them in either direction, and how far behind those they lie, px.
pub(crate) struct Places<const K: usize> {
    first: [[i32; K]; 2],
    part: [[f64; K]; 2],
}

impl<const K: usize> Places<K> {
    /// Places in an image of this width and height, px; those beyond its border upon it.
    #[inline(always)]
    pub(crate) fn of(places_px: [&[f64; K]; 2], size: [usize; 2]) -> Self {
        let mut out = Self { first: [[0; K]; 2], part: [[0.0; K]; 2] };
        for axis in 0..2 {
            let (x, last) = (places_px[axis], size[axis] as f64 - 1.001);
            for k in 0..K {
                let x = x[k].max(0.0).min(last);
                // The whole number at or below, several at a time; of a whole number perhaps the one before, which comes to the same.
                out.first[axis][k] = (x - 0.5 + ROUND).to_bits() as i32;
                out.part[axis][k] = x - f64::from(out.first[axis][k]);
            }
        }
        out
    }

    /// Column and row of the pixel before one of the places.
    #[inline(always)]
    pub(crate) fn first(&self, k: usize) -> [usize; 2] {
        [self.first[0][k] as usize, self.first[1][k] as usize]
    }

    /// What lies there, from what the pixels around hold: above left and right, below left and right.
    #[inline(always)]
    pub(crate) fn blend(&self, corners: &[[f64; K]; 4], out: &mut [f64; K]) {
        for k in 0..K {
            let (fu, fv) = (self.part[0][k], self.part[1][k]);
            let (top, bottom) =
                ((1.0 - fu) * corners[0][k] + fu * corners[1][k], (1.0 - fu) * corners[2][k] + fu * corners[3][k]);
            out[k] = (1.0 - fv) * top + fv * bottom;
        }
    }
}
