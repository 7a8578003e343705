//! Grey images to TIFF with scale and origin.

use crate::error::{Error, Result};
use crate::image::{GrayImage, Pixels};
use std::io::{Cursor, Seek, Write};
use tiff::encoder::colortype::{ColorType, Gray8, Gray16, Gray32Float};
use tiff::encoder::{Rational, TiffEncoder, TiffValue};
use tiff::tags::{ResolutionUnit, Tag};

/// What a TIFF file says about the size of its pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageScale {
    /// Side of a pixel, mm; goes into XResolution and YResolution (pixels per cm).
    pub mm_per_px: f64,
    /// Text of the tag ImageDescription; only ASCII is kept.
    pub description: String,
}

/// The bytes of a grey TIFF file with exactly these samples: 8 bit, 16 bit or 32-bit float, uncompressed.
///
/// # Errors
/// [`Error::Bug`] only: every image can be written.
pub fn tiff_bytes(image: &GrayImage, scale: Option<&ImageScale>) -> Result<Vec<u8>> {
    let mut out = Cursor::new(Vec::new());
    let size = |n: usize| u32::try_from(n).map_err(|_| Error::Bug(format!("image side of {n} px")));
    let size = [size(image.width())?, size(image.height())?];
    let written = match image.pixels() {
        Pixels::U8(p) => write::<Gray8, _>(&mut out, size, p, scale),
        Pixels::U16(p) => write::<Gray16, _>(&mut out, size, p, scale),
        Pixels::F32(p) => write::<Gray32Float, _>(&mut out, size, p, scale),
    };
    written.map_err(|e| Error::Bug(format!("TIFF encoder: {e}")))?;
    Ok(out.into_inner())
}

fn write<C: ColorType, W: Write + Seek>(
    out: &mut W,
    [width, height]: [u32; 2],
    samples: &[C::Inner],
    scale: Option<&ImageScale>,
) -> tiff::TiffResult<()>
where
    [C::Inner]: TiffValue,
{
    let mut encoder = TiffEncoder::new(out)?;
    let mut image = encoder.new_image::<C>(width, height)?;
    if let Some(s) = scale {
        // As many decimals as 32 bit hold.
        let per_cm = 10.0 / s.mm_per_px;
        let d = 10_f64.powi((9.0 - per_cm.log10().ceil()).clamp(0.0, 9.0) as i32);
        let value = Rational { n: (per_cm * d).round().min(f64::from(u32::MAX)) as u32, d: d as u32 };
        image.resolution(ResolutionUnit::Centimeter, value);
        let ascii: String = s.description.chars().map(|c| if c.is_ascii() && c != '\0' { c } else { '?' }).collect();
        image.encoder().write_tag(Tag::ImageDescription, ascii.as_str())?;
    }
    image.write_data(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiff::decoder::Decoder;

    #[test]
    fn samples_scale_and_description_are_read_back() {
        let scale = ImageScale { mm_per_px: 0.0213, description: "{\"origin_mm\":[-3.5,2.25]}".into() };
        for pixels in [
            Pixels::U8((0..12).collect()),
            Pixels::U16((0..12).map(|i| i * 5000).collect()),
            Pixels::F32((0..12).map(|i| i as f32 * 0.25 - 1.0).collect()),
        ] {
            let image = GrayImage::new(pixels, 4, 3).unwrap();
            let bytes = tiff_bytes(&image, Some(&scale)).unwrap();
            let scratch = tempfile::tempdir().unwrap();
            let path = scratch.path().join("a.tif");
            std::fs::write(&path, &bytes).unwrap();
            assert_eq!(crate::pipeline::load_image(&path).unwrap(), image);
            let mut decoder = Decoder::new(Cursor::new(&bytes)).unwrap();
            assert_eq!(decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap(), scale.description);
            let per_cm = decoder.get_tag(Tag::XResolution).unwrap();
            let tiff::decoder::ifd::Value::Rational(n, d) = per_cm else { panic!("{per_cm:?}") };
            assert!((10.0 * f64::from(d) / f64::from(n) - 0.0213).abs() < 1e-10);
        }
    }
}
