//! `detect`: discs in images.

use super::Done;
use super::arguments::Detect;
use super::files::{Output, can_write, fault, tell_further_pages};
use super::progress::Bar;
use super::threads;
use crate::detect::{
    DetectMemory, DetectOptions, Detection, Smoke, counted, counted_words, find_discs_with, missing_words,
};
use crate::error::{Insufficient, Invalid, Result};
use crate::image::GrayImage;
use crate::pipeline::{cut_at_zero, load_image, saturated_about};
use crate::report::{
    CUT_AT_ZERO, CUT_OFF, DETECTION_FORMAT, SATURATED, TOO_BLACK, contours_csv, detection_json, detection_shapes,
    discs_csv, features_csv, overlay_png,
};
use crate::target::Polarity;
use rayon::prelude::*;
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// Standard deviations that were enlarged by more than this number for what contours scatter by more than noise are told.
const ENLARGED: f64 = 4.0;

/// What was found in one image, and the files that say it.
struct Found {
    discs: usize,
    /// Those that may be bubbles.
    bubbles: usize,
    /// Part of the pixels about them that are at the end of the scale.
    saturated: f64,
    /// Part of those beside their contours whose noise is cut off at 0.
    cut_at_zero: f64,
    rejected: BTreeMap<&'static str, usize>,
    /// Discs whose standard deviations were enlarged by a lot, and the most by which any was.
    rough: (usize, f64),
    /// The same in words; empty where none was turned down.
    words: String,
    /// The same with what to do where discs are missing.
    missing: String,
    /// What to say where the discs are of the other polarity than the one asked for.
    other: Option<String>,
    files: Vec<(String, Vec<u8>)>,
}

pub(super) fn run(command: &Detect, threads: Option<NonZeroUsize>, progress: &Bar) -> Result<Done> {
    let stems = stems(&command.images)?;
    stems.iter().try_for_each(|stem| spare_other_json(&command.output.join(format!("{stem}.json"))))?;
    can_write(&command.output)?;
    let options =
        DetectOptions { polarity: command.polarity.into(), smoke: command.light(), ..DetectOptions::default() };
    progress.stage("finding discs", command.images.len());
    let memory = DetectMemory::default();
    let one = |(path, stem): (&PathBuf, &String)| -> Result<Found> {
        let image = load_image(path)?;
        let detection = find_discs_with(&image.view(), &options, &memory)?;
        let mut found = describe(path, stem, &image, &detection)?;
        if detection.discs.is_empty() {
            found.other = other_polarity(&image, &options, &memory);
        }
        progress.step();
        Ok(found)
    };
    let pool = threads::pool(threads)?;
    // Collected first, so that the error that is told is that of the first image, whatever the threads did.
    let found: Vec<Result<Found>> = pool.install(|| command.images.par_iter().zip(&stems).map(one).collect());
    let found = found.into_iter().collect::<Result<Vec<Found>>>()?;
    let flags = empty_images(&command.images, &found);
    let none = nothing_found(command, &found);
    let rough = rough_words(&command.images, &found);
    if found.iter().all(|f| f.words.is_empty()) {
        none.clone()?;
    }
    let bubbles = found.iter().map(|f| f.bubbles).sum();
    let parts = |of: fn(&Found) -> f64| command.images.iter().zip(found.iter().map(of)).collect::<Vec<_>>();
    let (saturated, too_black) = (parts(|f| f.saturated), parts(|f| f.cut_at_zero));
    let mut out = Output::default();
    let mut text = String::new();
    let mut images = Vec::new();
    for (path, f) in command.images.iter().zip(found) {
        let turned_down = if f.words.is_empty() { String::new() } else { format!(" (turned down: {})", f.words) };
        let _ = writeln!(text, "{}: {} disc(s){turned_down}", path.display(), f.discs);
        let files: Vec<&String> = f.files.iter().map(|(n, _)| n).collect();
        images.push(json!({
            "image": path.display().to_string(), "discs": f.discs, "rejected": f.rejected,
            "saturated": f.saturated, "cut_at_zero": f.cut_at_zero,
            "rough_discs": f.rough.0, "sigmas_enlarged": f.rough.1, "files": files,
        }));
        f.files.into_iter().for_each(|(name, bytes)| out.add(name, bytes));
    }
    out.commit_beside(&command.output, &command.images.iter().map(AsRef::as_ref).collect::<Vec<&Path>>())?;
    tell_further_pages(progress, &command.images);
    if options.smoke == Smoke::Maybe {
        tell_of_smoke(progress, bubbles);
    }
    tell_of_saturation(progress, &saturated);
    tell_of_blacks(progress, &too_black);
    rough.iter().for_each(|words| progress.note(words));
    none?;
    let json = json!({ "output": command.output.display().to_string(), "images": images });
    Ok(Done { text, json, flags })
}

/// What result files of each image are called after; two images must not write the same files.
fn stems(images: &[PathBuf]) -> Result<Vec<String>> {
    let mut stems: Vec<String> = Vec::with_capacity(images.len());
    for (i, path) in images.iter().enumerate() {
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned());
        let stem = stem.ok_or_else(|| fault(path, "this names no file; expected an image"))?;
        if let Some(other) = stems.iter().position(|s| s.to_lowercase() == stem.to_lowercase()) {
            let words = format!(
                "{} and {} would both write \"{stem}_discs.csv\"; detect them into different folders (-o)",
                images[other].display(),
                images[i].display()
            );
            return Err(Invalid::Contradiction(words).into());
        }
        stems.push(stem);
    }
    Ok(stems)
}

/// Refuses to write over JSON that no detection wrote, such as a calibration.
fn spare_other_json(place: &Path) -> Result<()> {
    let Ok(old) = std::fs::read(place) else { return Ok(()) };
    let format = serde_json::from_slice::<serde_json::Value>(&old).ok().map(|v| v["format"] == DETECTION_FORMAT);
    match format {
        Some(true) => Ok(()),
        _ => Err(fault(
            place,
            "this file, which is no earlier result of detect, would be overwritten; name another folder with -o",
        )),
    }
}

fn describe(path: &Path, stem: &str, image: &GrayImage, detection: &Detection) -> Result<Found> {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut files = vec![
        (format!("{stem}_discs.csv"), discs_csv(detection).into_bytes()),
        (format!("{stem}_contours.csv"), contours_csv(detection).into_bytes()),
        (format!("{stem}.json"), detection_json(&name, [image.width(), image.height()], detection).into_bytes()),
        (format!("{stem}_overlay.png"), overlay_png(&image.view(), &detection_shapes(detection))?),
    ];
    if let Some(csv) = features_csv(detection) {
        files.push((format!("{stem}_features.csv"), csv.into_bytes()));
    }
    let rejected = counted(&detection.rejections);
    let rejections = &detection.rejections;
    let (words, missing) = (counted_words(rejections), missing_words(rejections));
    let (discs, bubbles) = (detection.discs.len(), detection.possible_bubbles());
    let saturated = saturated_about(&image.view(), detection.discs.iter());
    let cut_at_zero = cut_at_zero(&image.view(), detection.discs.iter());
    let rough = rough(detection);
    Ok(Found { discs, bubbles, saturated, cut_at_zero, rejected, rough, words, missing, other: None, files })
}

/// What to say of an image without discs that has some of the other polarity.
fn other_polarity(image: &GrayImage, options: &DetectOptions, memory: &DetectMemory) -> Option<String> {
    let (word, polarity) = match options.polarity {
        Polarity::Bright => ("dark", Polarity::Dark),
        Polarity::Dark => ("bright", Polarity::Bright),
        Polarity::Auto => return None,
    };
    let others = find_discs_with(&image.view(), &DetectOptions { polarity, ..*options }, memory).ok()?;
    let n = others.discs.len();
    (n > 0).then(|| format!("{n} disc(s) are found with --polarity {word}: say that, or leave --polarity out"))
}

/// Says what to do were the bright discs bubbles: weak or slow smoke looks like even light, so that no image tells them from prints.
fn tell_of_smoke(to: &Bar, bubbles: usize) {
    if bubbles > 0 {
        to.note(format_args!(
            "{bubbles} bright disc(s): if they are bubbles full of smoke, detect them with --smoke (weak or slow smoke looks like even light, and sigmas would be too small), if they are printed with --printed"
        ));
    }
}

/// How many images have more of something than `limit`, and the one with the most.
fn most<'a>(images: &[(&'a PathBuf, f64)], limit: f64) -> Option<(usize, &'a PathBuf, f64)> {
    let all = || images.iter().filter(|(_, part)| *part > limit);
    all().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(path, part)| (all().count(), *path, *part))
}

/// Says where light may have been cut off.
fn tell_of_saturation(to: &Bar, images: &[(&PathBuf, f64)]) {
    let Some((count, path, part)) = most(images, SATURATED) else { return };
    to.note(format_args!(
        "{count} image(s) with pixels about the discs at the end of the scale ({} the most, {:.0} %): {CUT_OFF}",
        path.display(),
        100.0 * part
    ));
}

/// Says where noise was cut off at grey level 0.
fn tell_of_blacks(to: &Bar, images: &[(&PathBuf, f64)]) {
    let Some((count, path, part)) = most(images, CUT_AT_ZERO) else { return };
    to.note(format_args!(
        "{count} image(s) whose noise beside the contours of discs is cut off at grey level 0 ({} the most, {:.0} % of the pixels): {TOO_BLACK}",
        path.display(),
        100.0 * part
    ));
}

/// How many discs have standard deviations that were enlarged by more than [`ENLARGED`] for their contours, and the most by which any was, 1 for none.
fn rough(detection: &Detection) -> (usize, f64) {
    let enlarged = || detection.discs.iter().map(|disc| disc.contour.enlarged());
    (enlarged().filter(|by| *by > ENLARGED).count(), enlarged().fold(1.0, f64::max))
}

/// Images whose discs are no ellipses for all that noise explains, each in a sentence.
fn rough_words(images: &[PathBuf], found: &[Found]) -> Vec<String> {
    let rough = images.iter().zip(found).filter(|(_, f)| f.rough.0 > 0);
    let words = |(path, f): (&PathBuf, &Found)| {
        let (n, by) = f.rough;
        format!(
            "{}: {n} of {} disc(s) are no ellipses: their edges scatter by more than the noise of the image, and standard deviations were enlarged for it, up to \
             {by:.0} times; look at the overlay, and see to the print (round dots with sharp, whole rims), to dirt, and to focus",
            path.display(),
            f.discs
        )
    };
    rough.map(words).collect()
}

/// What to look at in an image without discs.
fn hint(f: &Found) -> String {
    if let Some(other) = &f.other {
        return other.clone();
    }
    match f.missing.as_str() {
        "" => "nothing round stands out from its surroundings; check exposure, focus and that the target is in the picture".into(),
        words => format!("candidates were turned down ({words})"),
    }
}

/// Images without discs, by name.
fn empty_images(images: &[PathBuf], found: &[Found]) -> Vec<String> {
    let empty = images.iter().zip(found).filter(|(_, f)| f.discs == 0);
    empty.map(|(path, f)| format!("{}: no disc was found; {}", path.display(), hint(f))).collect()
}

/// Where no image has any disc that is an error; what was turned down is drawn all the same, so that it can be seen why.
fn nothing_found(command: &Detect, found: &[Found]) -> Result<()> {
    let ([first, ..], [path, ..]) = (found, &command.images[..]) else { return Ok(()) };
    if found.iter().any(|f| f.discs > 0) {
        return Ok(());
    }
    let drawn = match found.iter().any(|f| !f.words.is_empty()) {
        true => format!("; the overlay in {} shows where", command.output.display()),
        false => String::new(),
    };
    let (image, hint) = (path.display().to_string(), hint(first) + &drawn);
    Err(Insufficient::TooFewDiscs { image, found: 0, needed: 1, hint }.into())
}
