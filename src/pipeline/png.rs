//! Grey images to PNG.

use crate::error::{Error, Invalid, Result};
use crate::image::{GrayImage, Pixels};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

/// The bytes of an 8 or 16 bit grey PNG file with exactly these samples.
///
/// # Errors
/// [`Invalid::Contradiction`] for floating-point samples, which PNG cannot hold.
pub fn png_bytes(image: &GrayImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let (samples, colour): (std::borrow::Cow<'_, [u8]>, _) = match image.pixels() {
        Pixels::U8(p) => (p.as_slice().into(), ExtendedColorType::L8),
        // The encoder takes native byte order and writes PNG's own.
        Pixels::U16(p) => (p.iter().flat_map(|x| x.to_ne_bytes()).collect::<Vec<_>>().into(), ExtendedColorType::L16),
        Pixels::F32(_) => {
            let words = "a floating-point image does not fit into a PNG; convert it to 8 or 16 bit first";
            return Err(Invalid::Contradiction(words.to_string()).into());
        }
    };
    let size = |n: usize| u32::try_from(n).map_err(|_| Error::Bug(format!("image side of {n} px")));
    PngEncoder::new(&mut bytes)
        .write_image(&samples, size(image.width())?, size(image.height())?, colour)
        .map_err(|e| Error::Bug(format!("PNG encoder: {e}")))?;
    Ok(bytes)
}
