//! `dewarp`: images on a grid of the sheet.

use super::Done;
use super::arguments::Dewarp;
use super::dewarped::Dewarped;
use super::files::{Output, can_write, fault, read_text, tell_further_pages};
use super::progress::Bar;
use super::threads;
use crate::dewarp::{self, SheetGrid, SheetMap, dewarp};
use crate::error::{Invalid, Result};
use crate::image::{GrayImage, Pixels};
use crate::pipeline::{ImageScale, load_image, tiff_bytes};
use crate::record::Record;
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::num::NonZeroUsize;
use std::path::Path;

/// What the numbers beside an image mean.
const AXES: &str = "pixel (i, j), counted from 0, is centred on x = origin_mm[0] + mm_per_px i, y = origin_mm[1] - mm_per_px j \
                    in the sheet frame: x right and y up as the first camera sees them, z towards the first camera";

pub(super) fn run(command: &Dewarp, threads: Option<NonZeroUsize>, progress: &Bar) -> Result<Done> {
    let text = read_text(&command.calibration, "a calibration.json")?;
    let record = Record::from_json(&text, &command.calibration.display().to_string())?;
    let maps: Vec<SheetMap> =
        (0..record.cameras.len()).map(|c| SheetMap::from_record(&record, c)).collect::<Result<_>>()?;
    let grid = grid(command, &maps)?;
    can_write(&command.output)?;
    let identity = Dewarped::new(&record, &maps.iter().collect::<Vec<_>>(), grid, command.z_mm);
    let named: Vec<String> = command.images.iter().map(|path| name_of(path)).collect();
    let mut listed = identity.others(&command.output, &named)?;
    progress.stage("dewarping", command.images.len());
    let pool = threads::pool(threads)?;
    let mut out = Output::default();
    let mut masks: BTreeMap<usize, GrayImage> = BTreeMap::new();
    let mut flags = vec![];
    let names: Vec<&str> = record.cameras.iter().map(|c| c.name.as_str()).collect();
    let mut words = format!(
        "grid: {} x {} px of {:.6} mm, x {:.3} to {:.3} mm, y {:.3} to {:.3} mm, z = {} mm (x right, y up, z towards camera \"{}\")\n",
        grid.width_px,
        grid.height_px,
        grid.mm_per_px,
        grid.extent_mm()[0],
        grid.extent_mm()[2],
        grid.extent_mm()[1],
        grid.extent_mm()[3],
        command.z_mm,
        record.cameras[0].name
    );
    for path in &command.images {
        let camera = camera_of(path, command.camera.as_deref(), &record)?;
        flags.extend(
            named_otherwise(path, camera, &names).map(|w| format!("{w}: --camera is that of all these images")),
        );
        let image = floats(load_sized(path, &record, camera)?, command.float)?;
        let kernel = command.kernel.into();
        let dewarp::Dewarped { image, valid } =
            pool.install(|| dewarp(&image.view(), &maps[camera], &grid, kernel, command.z_mm))?;
        let share = valid.iter().filter(|v| **v).count() as f64 / valid.len() as f64;
        let name = name_of(path);
        if out.names().contains(&name.as_str()) {
            return Err(fault(
                path,
                "two images of this name would be written to one file; dewarp them into different folders",
            ));
        }
        let camera_name = &record.cameras[camera].name;
        let note = json!({ "format": "spivcal-dewarped", "version": 1, "camera": camera_name, "grid": grid, "z_mm": command.z_mm });
        let scale = ImageScale { mm_per_px: grid.mm_per_px, description: note.to_string() };
        out.add_to_series(&command.output, &name, tiff_bytes(&image, Some(&scale))?)?;
        if share == 0.0 {
            flags.push(format!("camera \"{camera_name}\" sees nothing of this grid; look at --extent-mm and --z-mm"));
        }
        let _ = writeln!(words, "{} (camera \"{camera_name}\") -> {name}, {:.1} % seen", path.display(), 100.0 * share);
        listed.push(json!({ "image": path.display().to_string(), "camera": camera_name, "file": name, "seen": share }));
        let mask = valid.iter().map(|v| if *v { 255 } else { 0 }).collect();
        masks.insert(camera, GrayImage::new(Pixels::U8(mask), grid.width_px, grid.height_px)?);
        progress.step();
    }
    for (camera, mask) in &masks {
        out.add(format!("mask_{}.tif", record.cameras[*camera].name), tiff_bytes(mask, None)?);
    }
    let json = json!({
        "format": "spivcal-dewarp", "version": 1, "grid": grid, "z_mm": command.z_mm, "extent_mm": grid.extent_mm(), "axes": AXES,
        "kernel": format!("{:?}", command.kernel).to_lowercase(), "images": listed, "grid_in_images_px": identity.grid_in_images_px,
    });
    out.add("dewarp.json", format!("{json:#}\n"));
    let inputs: Vec<&Path> = command.images.iter().map(AsRef::as_ref).chain([command.calibration.as_ref()]).collect();
    out.commit_beside(&command.output, &inputs)?;
    tell_further_pages(progress, &command.images);
    let _ = writeln!(words, "Written to {}, with masks (255: seen) and dewarp.json", command.output.display());
    Ok(Done { text: words, json, flags })
}

fn grid(command: &Dewarp, maps: &[SheetMap]) -> Result<SheetGrid> {
    let all: Vec<&SheetMap> = maps.iter().collect();
    match (command.extent_mm, command.mm_per_px) {
        (Some(extent), Some(scale)) => SheetGrid::over(extent, scale),
        (Some(extent), None) => SheetGrid::over(extent, SheetGrid::common(&all, None)?.mm_per_px),
        (None, scale) => SheetGrid::common(&all, scale),
    }
}

/// The file in which it is dewarped.
fn name_of(path: &Path) -> String {
    format!("{}_dewarped.tif", stem(path))
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn floats(image: GrayImage, wanted: bool) -> Result<GrayImage> {
    let levels = match image.pixels() {
        _ if !wanted => return Ok(image),
        Pixels::U8(p) => p.iter().map(|x| f32::from(*x)).collect(),
        Pixels::U16(p) => p.iter().map(|x| f32::from(*x)).collect(),
        Pixels::F32(p) => p.clone(),
    };
    GrayImage::new(Pixels::F32(levels), image.width(), image.height())
}

/// An image of the size that its camera was calibrated with.
pub(super) fn load_sized(path: &Path, record: &Record, camera: usize) -> Result<GrayImage> {
    let image = load_image(path)?;
    let [expected_width, expected_height] = record.cameras[camera].image_size_px;
    if [image.width(), image.height()] != [expected_width, expected_height] {
        return Err(Invalid::CalibratedSize {
            path: path.display().to_string(),
            camera: record.cameras[camera].name.clone(),
            width: image.width(),
            height: image.height(),
            expected_width,
            expected_height,
        }
        .into());
    }
    Ok(image)
}

/// Cameras whose names are whole words in the name of a file; punctuation and capitals do not matter.
fn named_in(path: &Path, names: &[&str]) -> Vec<usize> {
    let file = stem(path);
    (0..names.len()).filter(|c| has_words(&file, names[*c])).collect()
}

/// Says so where the name of a file is that of another camera alone than the one that it stands for.
pub(super) fn named_otherwise(path: &Path, c: usize, names: &[&str]) -> Option<String> {
    let [other] = named_in(path, names)[..] else { return None };
    let (file, is, says) = (path.display(), names[c], names[other]);
    (other != c).then(|| format!("{file} stands for camera \"{is}\", but its name is that of camera \"{says}\""))
}

fn has_words(text: &str, wanted: &str) -> bool {
    let small = |c: char| c.to_lowercase().next().unwrap_or(c);
    let wanted: Vec<char> = wanted.chars().filter(|c| c.is_alphanumeric()).map(small).collect();
    let (mut letters, mut begins, mut last) = (vec![], vec![], ' ');
    for c in text.chars() {
        if c.is_alphanumeric() {
            begins.push(!last.is_alphanumeric() || begins_word(last, c));
            letters.push(small(c));
        }
        last = c;
    }
    begins.push(true);
    let mut parts = letters.windows(wanted.len().max(1)).enumerate();
    parts.any(|(at, part)| part == wanted && begins[at] && begins[at + wanted.len()])
}

/// Whether a word begins between two letters or digits: `v01left`, `imageLeft`.
fn begins_word(last: char, next: char) -> bool {
    last.is_numeric() != next.is_numeric() || (last.is_lowercase() && next.is_uppercase())
}

/// The camera of an image: the one that is named, or the one whose name is in the file's name.
fn camera_of(path: &Path, named: Option<&str>, record: &Record) -> Result<usize> {
    let names: Vec<&str> = record.cameras.iter().map(|c| c.name.as_str()).collect();
    if let Some(wanted) = named {
        return names.iter().position(|n| *n == wanted).ok_or_else(|| {
            let what = format!("there is no camera \"{wanted}\"; the calibration has \"{}\"", names.join("\", \""));
            Invalid::Contradiction(what).into()
        });
    }
    match named_in(path, &names)[..] {
        [one] => Ok(one),
        _ => Err(fault(
            path,
            format!(
                "the file's name does not say of which camera it is (\"{}\"); say --camera NAME and dewarp one camera at a time",
                names.join("\", \"")
            ),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_named_by_whole_words() {
        let named = |file: &str| named_in(Path::new(file), &["left", "right"]);
        for file in ["a/v01_left.png", "left01.tif", "001left.png", "ImgLeft.tif", "LEFT-3.tif"] {
            assert_eq!(named(file), [0], "{file}");
        }
        for file in ["p01_upright_A.png", "leftover.png", "a/right/01.png", "x.png"] {
            assert_eq!(named(file), [0; 0], "{file}");
        }
        assert_eq!(named("left_right.png"), [0, 1]);
        let named = |file: &str| named_in(Path::new(file), &["cam-1", "cam-10"]);
        assert_eq!((named("cam_1_03.tif"), named("cam10_03.tif"), named("Cam1.tif")), (vec![0], vec![1], vec![0]));
    }
}
