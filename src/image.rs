//! Borrowed and owned grey images: 8 bit, 16 bit, 32-bit float, with stride.
//!
//! Pixel (0, 0) is the centre of the first sample; u runs right, v down. Values are raw grey levels
//! (0..255, 0..65535, or any finite float); nothing is rescaled.

use crate::error::{Invalid, Result};

/// Samples of an image, row by row; consecutive rows start `stride` samples apart.
#[derive(Debug, Clone, Copy)]
pub enum Samples<'a> {
    /// 8-bit grey levels.
    U8(&'a [u8]),
    /// 16-bit grey levels (also 10 and 12 bit in 16).
    U16(&'a [u16]),
    /// Floating-point grey levels.
    F32(&'a [f32]),
}

impl Samples<'_> {
    fn len(&self) -> usize {
        match self {
            Samples::U8(s) => s.len(),
            Samples::U16(s) => s.len(),
            Samples::F32(s) => s.len(),
        }
    }
}

/// A borrowed grey image.
#[derive(Debug, Clone, Copy)]
pub struct GrayView<'a> {
    samples: Samples<'a>,
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a> GrayView<'a> {
    /// A view of `width` x `height` samples whose rows start `stride` samples apart.
    ///
    /// # Errors
    /// [`Invalid::Value`] where a size is zero, the stride is below the width, or the slice is too short.
    pub fn new(samples: Samples<'a>, width: usize, height: usize, stride: usize) -> Result<Self> {
        if width == 0 || height == 0 {
            return Err(Invalid::value("image size", 0.0, "at least 1 x 1 px").into());
        }
        let needed = stride.checked_mul(height - 1).and_then(|n| n.checked_add(width));
        match needed {
            Some(n) if stride >= width && samples.len() >= n => Ok(Self { samples, width, height, stride }),
            _ => Err(Invalid::value(
                "image samples",
                samples.len() as f64,
                format!(
                    "stride >= width and at least stride * (height - 1) + width = {stride} * {} + {width}",
                    height - 1
                ),
            )
            .into()),
        }
    }
    /// Width, px.
    pub fn width(&self) -> usize {
        self.width
    }
    /// Height, px.
    pub fn height(&self) -> usize {
        self.height
    }
    /// Samples from one row to the next.
    pub fn stride(&self) -> usize {
        self.stride
    }
    /// The samples themselves.
    pub fn samples(&self) -> Samples<'a> {
        self.samples
    }
    /// Smallest and largest grey level.
    pub fn range(&self) -> [f32; 2] {
        let mut row = vec![];
        let mut out = [f32::INFINITY, f32::NEG_INFINITY];
        for v in 0..self.height {
            self.row(v, &mut row);
            out = row.iter().fold(out, |[low, high], &g| [low.min(g), high.max(g)]);
        }
        out
    }
    /// Whether an image whose largest grey level is `high` may have been cut off there: a dark, quantised image has many equal maxima, too.
    pub fn may_saturate_at(&self, high: f32) -> bool {
        match self.samples {
            Samples::U8(_) => high >= 250.0,
            Samples::U16(_) => high as u32 >= 1000 && ((high as u32 + 1).is_power_of_two() || high >= 65_000.0),
            Samples::F32(_) => true,
        }
    }
    /// Grey level at column `u`, row `v`; both must be inside.
    #[inline]
    pub fn get(&self, u: usize, v: usize) -> f32 {
        debug_assert!(u < self.width && v < self.height);
        let i = v * self.stride + u;
        match self.samples {
            Samples::U8(s) => f32::from(s[i]),
            Samples::U16(s) => f32::from(s[i]),
            Samples::F32(s) => s[i],
        }
    }
}

impl GrayView<'_> {
    /// Grey levels of row `v`, which must be inside; `out` is cleared first.
    pub fn row(&self, v: usize, out: &mut Vec<f32>) {
        let at = v * self.stride..v * self.stride + self.width;
        out.clear();
        match self.samples {
            Samples::U8(s) => out.extend(s[at].iter().map(|x| f32::from(*x))),
            Samples::U16(s) => out.extend(s[at].iter().map(|x| f32::from(*x))),
            Samples::F32(s) => out.extend_from_slice(&s[at]),
        }
    }
}

/// Owned samples of a grey image, rows packed.
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    /// 8-bit grey levels.
    U8(Vec<u8>),
    /// 16-bit grey levels.
    U16(Vec<u16>),
    /// Floating-point grey levels.
    F32(Vec<f32>),
}

/// An owned grey image, rows packed.
#[derive(Debug, Clone, PartialEq)]
pub struct GrayImage {
    pixels: Pixels,
    width: usize,
    height: usize,
}

impl GrayImage {
    /// An image of `width` x `height` packed samples.
    ///
    /// # Errors
    /// [`Invalid::Value`] where a size is zero or the count does not fit.
    pub fn new(pixels: Pixels, width: usize, height: usize) -> Result<Self> {
        let image = Self { pixels, width, height };
        GrayView::new(image.samples(), width, height, width)?;
        Ok(image)
    }
    /// Makes room for an image of `width` x `height` of the depth of `like`, in the memory that is there where its depth is the same; what the
    /// samples are is left open.
    pub(crate) fn renew(&mut self, like: &Samples<'_>, width: usize, height: usize) -> &mut Pixels {
        let n = width * height;
        match (&mut self.pixels, like) {
            (Pixels::U8(p), Samples::U8(_)) => p.resize(n, 0),
            (Pixels::U16(p), Samples::U16(_)) => p.resize(n, 0),
            (Pixels::F32(p), Samples::F32(_)) => p.resize(n, 0.0),
            (p, Samples::U8(_)) => *p = Pixels::U8(vec![0; n]),
            (p, Samples::U16(_)) => *p = Pixels::U16(vec![0; n]),
            (p, Samples::F32(_)) => *p = Pixels::F32(vec![0.0; n]),
        }
        (self.width, self.height) = (width, height);
        &mut self.pixels
    }
    fn samples(&self) -> Samples<'_> {
        match &self.pixels {
            Pixels::U8(p) => Samples::U8(p),
            Pixels::U16(p) => Samples::U16(p),
            Pixels::F32(p) => Samples::F32(p),
        }
    }
    /// The image, borrowed.
    pub fn view(&self) -> GrayView<'_> {
        GrayView { samples: self.samples(), width: self.width, height: self.height, stride: self.width }
    }
    /// The samples.
    pub fn pixels(&self) -> &Pixels {
        &self.pixels
    }
    /// Width, px.
    pub fn width(&self) -> usize {
        self.width
    }
    /// Height, px.
    pub fn height(&self) -> usize {
        self.height
    }
}
