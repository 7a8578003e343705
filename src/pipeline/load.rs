//! Files to grey images: PNG, TIFF, BMP, PGM, JPEG.

use super::files::of_the_system;
use crate::error::{self, Error, Invalid, Result};
use crate::image::{GrayImage, Pixels};
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use std::io::{Cursor, ErrorKind, Read};
use std::path::Path;

/// No compression of a TIFF makes a byte of the file stand for more: those of deflate for 1032, those of LZW for 1366.
const MOST_PACKED: u64 = 2048;

/// A bit of an image with a palette becomes three bytes.
const MOST_EXPANDED: u64 = 24;

/// What decoders take beside whole images, bytes: rows, tables, what is unpacked of one strip.
const BESIDE: u64 = 1 << 20;

const FORMATS: &str = "PNG, TIFF, BMP, PGM or JPEG";

/// Reads an image file as grey levels: PNG, TIFF (8, 16 bit, 32-bit float; uncompressed, LZW, deflate, PackBits), BMP,
/// PGM, JPEG.
///
/// Samples keep their depth and their values: 8 bit, 16 bit (also 10 or 12 bit in 16), or float. Colours become their
/// luma (a grey picture stored as colour keeps its grey levels); transparency is ignored.
///
/// # Errors
/// [`Invalid::File`] where the file is missing, empty, cut short, no image, of a kind that is not read, or holds
/// samples that are not finite; [`Invalid::Memory`] where there is no memory for the file, or for decoding it.
pub fn load_image(path: &Path) -> Result<GrayImage> {
    let bytes = file_bytes(path)?;
    if bytes.is_empty() {
        return Err(fault(path, "the file is empty (0 bytes); copy it again from where it was recorded"));
    }
    let format = format_of(&bytes)
        .ok_or_else(|| fault(path, format!("this is not an image that can be read; expected {FORMATS}")))?;
    if format == ImageFormat::Jpeg && !jpeg_is_whole(&bytes) {
        return Err(fault(path, truncated("the end of the JPEG data is missing")));
    }
    if format == ImageFormat::Tiff
        && let Some(image) = float_tiff(path, &bytes)?
    {
        return Ok(image);
    }
    grey(path, decoded(path, &bytes, format)?)
}

/// The whole file; memory is asked for by its size.
fn file_bytes(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = vec![];
    let mut size = 0;
    let read = std::fs::File::open(path).and_then(|mut file| {
        size = usize::try_from(file.metadata()?.len()).unwrap_or(usize::MAX);
        bytes.try_reserve_exact(size)?;
        file.read_to_end(&mut bytes)
    });
    match read {
        Ok(_) => Ok(bytes),
        // What has no size to ask for, such as a pipe, grew to so much.
        Err(e) if e.kind() == ErrorKind::OutOfMemory => Err(no_memory(path, "reading", size.max(bytes.len()) as u64)),
        Err(e) => Err(fault(path, cannot_read(path, &e))),
    }
}

/// The image in the depth and colours of the file; memory is asked for by the size that its header states.
fn decoded(path: &Path, bytes: &[u8], format: ImageFormat) -> Result<DynamicImage> {
    let mut limits = Limits::default();
    let least = limits.max_alloc.unwrap_or_default();
    let opened = ImageReader::with_format(Cursor::new(bytes), format).into_decoder();
    let mut decoder = opened.map_err(|e| explain(path, &e, least))?;
    let (whole, size, samples) = (decoder.total_bytes(), decoder.dimensions(), decoder.color_type());
    // Packed rows of a BMP may be left out, any number of them.
    if format != ImageFormat::Bmp {
        can_hold(path, whole / MOST_EXPANDED, bytes.len())?;
    }
    let of_decoder = match format {
        // Decoded into memory of its own, then copied.
        ImageFormat::Tiff => whole,
        // A progressive one keeps coefficients of 16 bit of all samples, and any one a copy of the file.
        ImageFormat::Jpeg => whole.saturating_mul(2),
        _ => 0,
    };
    let grey = if samples.has_color() || samples.has_alpha() { whole / u64::from(samples.channel_count()) } else { 0 };
    let needed = whole.saturating_add(of_decoder.max(grey)).saturating_add(BESIDE);
    room(path, size, needed)?;
    limits.max_alloc = Some(needed.max(least));
    decoder.set_limits(limits).map_err(|e| explain(path, &e, needed))?;
    DynamicImage::from_decoder(decoder).map_err(|e| explain(path, &e, needed))
}

/// The format that the first bytes tell; of a TIFF for files above 4 GB (BigTIFF), too, which `image` decodes but does not guess.
fn format_of(bytes: &[u8]) -> Option<ImageFormat> {
    let big = bytes.starts_with(b"II\x2b\0") || bytes.starts_with(b"MM\0\x2b");
    if big { Some(ImageFormat::Tiff) } else { image::guess_format(bytes).ok() }
}

/// Whether a file is a TIFF of several pages, of which [`load_image`] reads the first.
pub fn has_further_pages(path: &Path) -> bool {
    let decoder = std::fs::File::open(path).ok().map(std::io::BufReader::new).map(tiff::decoder::Decoder::new);
    decoder.is_some_and(|d| d.is_ok_and(|d| d.more_images()))
}

fn fault(path: &Path, message: impl Into<String>) -> Error {
    Invalid::File { path: path.display().to_string(), message: message.into() }.into()
}

fn cannot_read(path: &Path, error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::NotFound => {
            "there is no such file; check the name (capital and small letters differ) and the folder of the images"
                .to_string()
        }
        std::io::ErrorKind::PermissionDenied => "no permission to read the file".to_string(),
        _ if path.is_dir() => "this is a folder; expected an image file".to_string(),
        _ => format!("cannot be read: {}", of_the_system(error)),
    }
}

fn truncated(detail: &str) -> String {
    format!("the image is cut short or damaged ({detail}); copy it again from where it was recorded")
}

fn no_memory(path: &Path, doing: &str, bytes: u64) -> Error {
    let what = format!("{doing} the image {}", path.display());
    Invalid::Memory { what, bytes: usize::try_from(bytes).unwrap_or(usize::MAX) }.into()
}

/// What a decoder says, of an image for which `needed` bytes were asked.
fn explain(path: &Path, error: &ImageError, needed: u64) -> Error {
    let message = match error {
        ImageError::Limits(_) => return no_memory(path, "decoding", needed),
        ImageError::IoError(e) if e.kind() == ErrorKind::OutOfMemory => return no_memory(path, "decoding", needed),
        ImageError::Unsupported(e) => {
            format!("this kind of image is not read ({e}); save it as grey {FORMATS} with 8 or 16 bit")
        }
        ImageError::Decoding(_) | ImageError::IoError(_) => truncated(&error.to_string()),
        other => format!("cannot be read: {other}"),
    };
    fault(path, message)
}

fn grey(path: &Path, decoded: DynamicImage) -> Result<GrayImage> {
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let pixels = match decoded {
        DynamicImage::ImageLuma8(i) => Pixels::U8(i.into_raw()),
        DynamicImage::ImageLuma16(i) => Pixels::U16(i.into_raw()),
        d @ (DynamicImage::ImageLumaA8(_) | DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_)) => {
            Pixels::U8(d.into_luma8().into_raw())
        }
        d @ (DynamicImage::ImageLumaA16(_) | DynamicImage::ImageRgb16(_) | DynamicImage::ImageRgba16(_)) => {
            Pixels::U16(d.into_luma16().into_raw())
        }
        d => Pixels::F32(finite(path, d.to_luma32f().into_raw())?),
    };
    GrayImage::new(pixels, width, height).map_err(|_| fault(path, "the image has no pixels"))
}

fn finite(path: &Path, samples: Vec<f32>) -> Result<Vec<f32>> {
    match samples.iter().position(|x| !x.is_finite()) {
        None => Ok(samples),
        Some(i) => Err(fault(
            path,
            format!("sample {i} is {}; a floating-point image must hold finite numbers only", samples[i]),
        )),
    }
}

/// That a file of so many bytes can stand for the bytes of a decoded image.
fn can_hold(path: &Path, decoded: u64, file: usize) -> Result<()> {
    if decoded <= MOST_PACKED * file as u64 {
        return Ok(());
    }
    Err(fault(path, truncated(&format!("{file} bytes cannot hold its pixels, of {decoded} bytes or more"))))
}

/// That there is memory for decoding an image of this width and height.
fn room(path: &Path, (width, height): (u32, u32), needed: u64) -> Result<()> {
    let what = || format!("decoding the image {} of {width} x {height} px", path.display());
    error::room(what, usize::try_from(needed).unwrap_or(usize::MAX))
}

/// Grey TIFF of 32 or 64 bit floating-point samples, which the general decoder does not know; `None` for any other TIFF.
fn float_tiff(path: &Path, bytes: &[u8]) -> Result<Option<GrayImage>> {
    use tiff::decoder::{Decoder, DecodingResult, Limits};
    let usual = Limits::default();
    let explain = |e: tiff::TiffError, needed: usize| match e {
        tiff::TiffError::LimitsExceeded => no_memory(path, "decoding", needed as u64),
        tiff::TiffError::IoError(e) if e.kind() == ErrorKind::OutOfMemory => no_memory(path, "decoding", needed as u64),
        e => fault(path, truncated(&e.to_string())),
    };
    let opening = |e| explain(e, usual.decoding_buffer_size);
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(opening)?;
    let Ok(tiff::ColorType::Gray(bits @ (32 | 64))) = decoder.colortype() else { return Ok(None) };
    let (width, height) = decoder.dimensions().map_err(opening)?;
    let pixels = u64::from(width).saturating_mul(u64::from(height));
    let whole = pixels.saturating_mul(u64::from(bits / 8));
    can_hold(path, whole, bytes.len())?;
    // Those of 64 bit become 32.
    let narrowed = if bits == 64 { whole / 2 } else { 0 };
    room(path, (width, height), whole.saturating_add(narrowed).saturating_add(BESIDE))?;
    let needed = usize::try_from(whole).unwrap_or(usize::MAX);
    let mut limits = Limits::default();
    limits.decoding_buffer_size = needed.max(usual.decoding_buffer_size);
    limits.intermediate_buffer_size = needed.max(usual.intermediate_buffer_size);
    decoder = decoder.with_limits(limits);
    let samples = match decoder.read_image().map_err(|e| explain(e, needed))? {
        DecodingResult::F32(p) => p,
        DecodingResult::F64(p) => p.into_iter().map(|x| x as f32).collect(),
        _ => {
            let message =
                format!("grey levels of 32 bit or more are read as floating point only; save as 16 bit {FORMATS}");
            return Err(fault(path, message));
        }
    };
    let pixels = Pixels::F32(finite(path, samples)?);
    GrayImage::new(pixels, width as usize, height as usize)
        .map(Some)
        .map_err(|_| fault(path, truncated("fewer samples than pixels")))
}

/// Whether the end of the image is there: decoders fill what is missing with grey and do not complain.
///
/// Walks the segments up to the first scan (a preview inside a segment has an end of its own); after it the two bytes
/// FF D9 can only be the end, since the compressed data never hold them.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    let mut at = 2;
    loop {
        let Some(&[0xff, marker]) = bytes.get(at..at + 2) else { return false };
        let Some(&[high, low]) = bytes.get(at + 2..at + 4) else { return false };
        match marker {
            0xff => at += 1,
            // Start of scan.
            0xda => return bytes[at..].windows(2).any(|w| w == [0xff, 0xd9]),
            _ => at += 2 + usize::from(u16::from_be_bytes([high, low])),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::ImageEncoder;
    use std::path::PathBuf;

    struct Scratch(tempfile::TempDir);

    impl Scratch {
        fn new() -> Self {
            Self(tempfile::tempdir().unwrap())
        }
        fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
            let path = self.0.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        }
    }

    fn levels8() -> Vec<u8> {
        (0..48 * 32).map(|i| (i * 7 % 251) as u8).collect()
    }

    fn levels16() -> Vec<u16> {
        (0..48 * 32).map(|i| (i * 37 % 4096) as u16).collect()
    }

    #[test]
    fn big_tiff_is_read_and_other_bytes_are_refused_in_words() {
        let scratch = Scratch::new();
        let (mut big, levels) = (Cursor::new(Vec::new()), levels16());
        let mut encoder = tiff::encoder::TiffEncoder::new_big(&mut big).unwrap();
        encoder.write_image::<tiff::encoder::colortype::Gray16>(48, 32, &levels).unwrap();
        let image = load_image(&scratch.file("big.tif", big.get_ref())).unwrap();
        assert_eq!(image.pixels(), &Pixels::U16(levels));
        let message = load_image(&scratch.file("no.tif", b"II\x2c\0 something else")).unwrap_err().to_string();
        assert!(message.contains("this is not an image that can be read"), "{message}");
    }

    fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        image.write_to(&mut out, format).unwrap();
        out.into_inner()
    }

    fn luma8() -> DynamicImage {
        image::GrayImage::from_raw(48, 32, levels8()).unwrap().into()
    }

    fn luma16() -> DynamicImage {
        DynamicImage::ImageLuma16(image::ImageBuffer::from_raw(48, 32, levels16()).unwrap())
    }

    fn message(path: &Path) -> String {
        match load_image(path) {
            Err(Error::Invalid(Invalid::File { path: named, message })) => {
                assert_eq!(named, path.display().to_string());
                message
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn grey_levels_survive_every_lossless_format() {
        let s = Scratch::new();
        let rgb = DynamicImage::ImageRgb8(luma8().to_rgb8());
        for (format, name) in [
            (ImageFormat::Png, "a.png"),
            (ImageFormat::Tiff, "a.tif"),
            (ImageFormat::Bmp, "a.bmp"),
            (ImageFormat::Pnm, "a.pgm"),
        ] {
            for image in [luma8(), rgb.clone()] {
                let read = load_image(&s.file(name, &encoded(&image, format))).unwrap();
                assert_eq!((read.width(), read.height()), (48, 32));
                assert_eq!(read.pixels(), &Pixels::U8(levels8()), "{name}");
            }
            if format != ImageFormat::Bmp {
                let read = load_image(&s.file(name, &encoded(&luma16(), format))).unwrap();
                assert_eq!(read.pixels(), &Pixels::U16(levels16()), "{name}");
            }
        }
    }

    #[test]
    fn png_bytes_are_read_back() {
        let s = Scratch::new();
        for pixels in [Pixels::U8(levels8()), Pixels::U16(levels16())] {
            let image = GrayImage::new(pixels, 48, 32).unwrap();
            let path = s.file("a.png", &crate::pipeline::png_bytes(&image).unwrap());
            assert_eq!(load_image(&path).unwrap(), image);
        }
        let float = GrayImage::new(Pixels::F32(vec![0.5]), 1, 1).unwrap();
        assert!(crate::pipeline::png_bytes(&float).is_err());
    }

    fn tiff_of<C: tiff::encoder::colortype::ColorType>(
        samples: &[C::Inner],
        compression: tiff::encoder::Compression,
    ) -> Vec<u8>
    where
        [C::Inner]: tiff::encoder::TiffValue,
    {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut out).unwrap().with_compression(compression);
        encoder.write_image::<C>(48, 32, samples).unwrap();
        out.into_inner()
    }

    #[test]
    fn tiff_of_all_compressions_and_floats_is_read() {
        use tiff::encoder::{Compression, colortype};
        let s = Scratch::new();
        for c in [Compression::Uncompressed, Compression::Lzw, Compression::Packbits] {
            let path = s.file("a.tif", &tiff_of::<colortype::Gray16>(&levels16(), c));
            assert_eq!(load_image(&path).unwrap().pixels(), &Pixels::U16(levels16()));
            let path = s.file("a.tif", &tiff_of::<colortype::Gray8>(&levels8(), c));
            assert_eq!(load_image(&path).unwrap().pixels(), &Pixels::U8(levels8()));
        }
        let mut float: Vec<f32> = levels16().iter().map(|x| f32::from(*x) * 0.25 - 7.0).collect();
        let path = s.file("f.tif", &tiff_of::<colortype::Gray32Float>(&float, Compression::Uncompressed));
        assert_eq!(load_image(&path).unwrap().pixels(), &Pixels::F32(float.clone()));
        float[5] = f32::NAN;
        let path = s.file("f.tif", &tiff_of::<colortype::Gray32Float>(&float, Compression::Uncompressed));
        assert!(message(&path).contains("sample 5 is NaN"));
    }

    #[test]
    fn floats_of_any_size_are_read_as_far_as_there_is_memory() {
        let s = Scratch::new();
        let mut out = Cursor::new(Vec::new());
        let packed = tiff::encoder::Compression::Packbits;
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut out).unwrap().with_compression(packed);
        // 275 MB, more than the decoder takes of itself.
        let samples = vec![0.0; 8300 * 8300];
        encoder.write_image::<tiff::encoder::colortype::Gray32Float>(8300, 8300, &samples).unwrap();
        let read = load_image(&s.file("a.tif", out.get_ref())).unwrap();
        assert_eq!((read.width(), read.height()), (8300, 8300));
        // A size that the file cannot hold: as much is not asked of the system. Tag, type (3: 16 bit, 4: 32 bit), value.
        let size = 900_000u32;
        let tags: [(u16, u16, u32); 10] = [
            (256, 4, size),
            (257, 4, size),
            (258, 3, 32),
            (259, 3, 1),
            (262, 3, 1),
            (273, 4, 8),
            (277, 3, 1),
            (278, 4, size),
            (279, 4, 4),
            (339, 3, 3),
        ];
        let mut bytes = b"II*\0\x0c\0\0\0pixl\x0a\0".to_vec();
        for (tag, kind, value) in tags {
            bytes.extend([tag.to_le_bytes(), kind.to_le_bytes(), [1, 0], [0, 0]].concat());
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend([0; 4]);
        let text = message(&s.file("a.tif", &bytes));
        assert!(text.contains("cut short or damaged") && text.contains("cannot hold"), "{text}");
    }

    /// Headers of 60000 x 60000 px with next to nothing behind them.
    #[test]
    fn headers_of_images_that_no_file_holds_are_refused() {
        let s = Scratch::new();
        let side = 60_000u32;
        let be = side.to_be_bytes();
        let mut png = encoded(&luma8(), ImageFormat::Png);
        png[16..24].copy_from_slice(&[be, be].concat());
        // As the checksum of the header would be: the decoder looks at it first.
        let sum = png_checksum(&png[12..29]);
        png[29..33].copy_from_slice(&sum.to_be_bytes());
        let mut bmp = encoded(&luma8(), ImageFormat::Bmp);
        bmp[18..26].copy_from_slice(&[side.to_le_bytes(), side.to_le_bytes()].concat());
        let mut jpeg = encoded(&luma8(), ImageFormat::Jpeg);
        let frame = jpeg.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
        jpeg[frame + 5..frame + 9].copy_from_slice(&[be[2], be[3], be[2], be[3]]);
        let mut tiff = encoded(&luma16(), ImageFormat::Tiff);
        let first = u32::from_le_bytes(tiff[4..8].try_into().unwrap()) as usize + 2;
        let tags = usize::from(u16::from_le_bytes([tiff[first - 2], tiff[first - 1]]));
        for tag in tiff[first..first + 12 * tags].chunks_exact_mut(12) {
            // Width, height, rows of a strip.
            if [256, 257, 278].contains(&u16::from_le_bytes([tag[0], tag[1]])) {
                tag[2..4].copy_from_slice(&[4, 0]);
                tag[8..12].copy_from_slice(&side.to_le_bytes());
            }
        }
        let pgm = b"P5 60000 60000 255\nabc".to_vec();
        for (name, bytes) in [("a.png", png), ("a.jpg", jpeg), ("a.tif", tiff), ("a.pgm", pgm)] {
            let text = message(&s.file(name, &bytes));
            assert!(text.contains("cut short or damaged") && text.contains("cannot hold"), "{name}: {text}");
        }
        // Rows of a BMP may be left out: it is refused where memory ends, or the file.
        assert!(load_image(&s.file("a.bmp", &bmp)).is_err());
    }

    /// CRC-32 of a part of a PNG.
    fn png_checksum(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0, |sum, byte| {
            (0..8).fold(sum ^ u32::from(*byte), |s, _| if s & 1 == 1 { s >> 1 ^ 0xedb8_8320 } else { s >> 1 })
        })
    }

    #[test]
    fn what_has_no_memory_is_told_as_such() {
        let path = Path::new("a.png");
        let limits = || {
            ImageError::Limits(image::error::LimitError::from_kind(image::error::LimitErrorKind::InsufficientMemory))
        };
        let memory = ImageError::IoError(ErrorKind::OutOfMemory.into());
        for error in [explain(path, &limits(), 77), explain(path, &memory, 77), no_memory(path, "decoding", 77)] {
            let what = "decoding the image a.png".to_string();
            assert_eq!(error, Invalid::Memory { what, bytes: 77 }.into());
        }
        let told = room(path, (60_000, 50_000), u64::MAX).unwrap_err().to_string();
        assert!(told.starts_with("there is no memory for decoding the image a.png of 60000 x 50000 px, "), "{told}");
    }

    #[test]
    fn further_pages_are_seen() {
        let s = Scratch::new();
        for pages in 1..=2 {
            let mut out = Cursor::new(Vec::new());
            let mut encoder = tiff::encoder::TiffEncoder::new(&mut out).unwrap();
            for _ in 0..pages {
                encoder.write_image::<tiff::encoder::colortype::Gray8>(48, 32, &levels8()).unwrap();
            }
            let path = s.file("a.tif", &out.into_inner());
            assert_eq!(load_image(&path).unwrap().pixels(), &Pixels::U8(levels8()));
            assert_eq!(has_further_pages(&path), pages == 2);
        }
        assert!(!has_further_pages(&s.file("a.png", &encoded(&luma8(), ImageFormat::Png))));
    }

    #[test]
    fn files_that_are_no_image_say_so() {
        let s = Scratch::new();
        assert!(message(&s.0.path().join("none.png")).contains("no such file"));
        assert!(message(s.0.path()).contains("folder"));
        assert!(message(&s.file("a.png", b"")).contains("empty"));
        assert!(message(&s.file("a.png", b"view,u,v\n0,1,2\n")).contains("not an image"));
    }

    #[test]
    fn truncated_images_are_refused() {
        let s = Scratch::new();
        let jpeg = {
            let mut out = Vec::new();
            image::codecs::jpeg::JpegEncoder::new(&mut out)
                .write_image(&levels8(), 48, 32, image::ExtendedColorType::L8)
                .unwrap();
            out
        };
        assert!(load_image(&s.file("a.jpg", &jpeg)).is_ok());
        let files = [
            ("a.jpg", jpeg),
            ("a.png", encoded(&luma16(), ImageFormat::Png)),
            ("a.tif", encoded(&luma16(), ImageFormat::Tiff)),
            ("a.bmp", encoded(&luma8(), ImageFormat::Bmp)),
            ("a.pgm", encoded(&luma8(), ImageFormat::Pnm)),
        ];
        for (name, bytes) in files {
            for part in [0.3, 0.5, 0.9] {
                let cut = (bytes.len() as f64 * part) as usize;
                let text = message(&s.file(name, &bytes[..cut]));
                assert!(text.contains("cut short"), "{name} at {part}: {text}");
            }
        }
    }
}
