//! `check`: the sheet on particle images.

use super::Done;
use super::arguments::Check;
use super::dewarp::load_sized;
use super::files::{Output, can_write, fault, read_text, spares, tell_further_pages};
use super::progress::Bar;
use super::threads;
use crate::diagnosis::mapping_of_record;
use crate::disparity::{CheckOptions, ParticlePair, check_sheet_masked, sheet_of_view};
use crate::error::{Error, Invalid, Result};
use crate::frames::{Rig, Sheet};
use crate::image::GrayImage;
use crate::pipeline::of_the_system;
use crate::record::{CamerasRefined, Record, SheetCheck};
use crate::report::check_html;
use serde_json::json;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

pub(super) fn run(command: &Check, threads: Option<NonZeroUsize>, progress: &Bar) -> Result<Done> {
    quoted(command)?;
    let mut record = of_two_cameras(&command.calibration)?;
    let mut reference_mm = [0.0; 2];
    if let Some(view) = command.plane_of_view {
        let sheet = sheet_of_view(&record, view)?;
        // The offset is told where the target has its origin.
        let origin = record.views.iter().find(|v| v.index == view).and_then(|v| v.rig_from_target);
        if let Some(pose) = origin {
            let there = sheet.rig_from_sheet.motion::<Rig, Sheet>().inverse().apply(&pose.translation_mm.into());
            reference_mm = [there.x, there.y];
        }
        record.sheet = Some(sheet);
    } else if record.sheet.is_none() {
        let what = "the calibration has no laser sheet to check; say --plane-of-view N to start from the plane of the target of a view";
        return Err(fault(&command.calibration, what));
    }
    let files = pairs_of(&command.pairs)?;
    spared(command)?;
    let masks = masks(command, &record)?;
    progress.stage("reading images", files.len());
    let mut images: Vec<[GrayImage; 2]> = vec![];
    for pair in &files {
        images.push([load_sized(&pair[0], &record, 0)?, load_sized(&pair[1], &record, 1)?]);
        progress.step();
    }
    let name = |p: &PathBuf| p.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let pairs: Vec<ParticlePair> = images
        .iter()
        .zip(&files)
        .map(|(i, f)| ParticlePair { images: [i[0].view(), i[1].view()], names: f.each_ref().map(name) })
        .collect();
    progress.say("looking for the plane of the light".to_string());
    let options = CheckOptions {
        window_px: command.window_px,
        search_mm: command.search_mm,
        refine: command.refine,
        refine_cameras: command.refine_cameras,
        subtract_mean: command.subtract_mean,
        reference_mm,
    };
    let pool = threads::pool(threads)?;
    let mut found = pool.install(|| {
        let masks = masks.each_ref().map(|mask| mask.as_ref().map(GrayImage::view));
        check_sheet_masked(&record, &pairs, masks, &options)
    })?;
    if let Some(corrected) = &mut found.record
        && let Some((mapping, told)) = pool.install(|| mapping_of_record(corrected, record.told_of_another_sheet()))
    {
        corrected.mapping_uncertainty = Some(mapping);
        corrected.fit.keep_check_flags(&told);
        found.check.flags.extend(told);
    }
    found.check.flags.extend(mispaired(&files));
    let mut out = Output::default();
    let value = serde_json::to_value(&found.check).map_err(|e| Error::Bug(format!("check.json: {e}")))?;
    out.add("check.json", format!("{value:#}\n"));
    out.add("report.html", check_html(&found.check));
    if let Some(corrected) = &found.record {
        out.add("calibration.json", corrected.to_json()?);
    }
    if found.record.is_none() && command.output.join("calibration.json").exists() {
        let what = "this folder holds a calibration, whose report.html would be replaced by that of the check; name another folder with -o";
        return Err(fault(&command.output, what));
    }
    let words = words(&found.check, command.plane_of_view, &command.output, &out.names());
    let json = json!({
        "output": command.output.display().to_string(), "files": out.names(), "offset_mm": value["offset_mm"], "tilt_deg": value["tilt_deg"],
        "offset_sigma_mm": value["offset_sigma_mm"], "tilt_sigma_deg": value["tilt_sigma_deg"], "thickness_mm": value["thickness_mm"],
        "median_before_px": found.check.before.median_px(), "median_after_px": found.check.after.as_ref().map(|a| a.median_px()),
        "offset_sigma_windows_mm": value["offset_sigma_windows_mm"], "tilt_sigma_windows_deg": value["tilt_sigma_windows_deg"],
        "sigmas_hold_calibration": found.check.sigmas_hold_calibration, "misalignment_before": value["misalignment_before"],
        "misalignment_after": value["misalignment_after"],
        "cameras_refined": value["cameras_refined"], "converged": found.check.converged, "history": value["history"], "flags": found.check.flags,
    });
    out.commit_beside(&command.output, &[&command.calibration])?;
    tell_further_pages(progress, files.iter().flatten());
    Ok(Done { text: words, json, flags: found.check.flags })
}

/// The masks of both cameras.
fn masks(command: &Check, record: &Record) -> Result<[Option<GrayImage>; 2]> {
    let Some([left, right]) = command.masks.as_deref() else { return Ok([None, None]) };
    Ok([Some(load_sized(left, record, 0)?), Some(load_sized(right, record, 1)?)])
}

/// That results can be written, and not over the calibration: known before the work.
fn spared(command: &Check) -> Result<()> {
    can_write(&command.output)?;
    let written: &[&str] = if command.refine { &["calibration.json"] } else { &[] };
    spares(&command.output, written, &[&command.calibration])
}

/// The calibration, of two cameras.
fn of_two_cameras(file: &Path) -> Result<Record> {
    let text = read_text(file, "a calibration.json")?;
    let record = Record::from_json(&text, &file.display().to_string())?;
    match record.cameras.len() {
        2 => Ok(record),
        n => Err(fault(file, format!("the check needs two cameras, but this calibration holds {n}"))),
    }
}

/// Patterns without quotes are replaced by a shell, and come as more names than two.
fn quoted(command: &Check) -> Result<()> {
    let Some(first) = command.unquoted.first() else { return Ok(()) };
    Err(Invalid::Contradiction(format!(
        "\"{first}\" is one name too many: --pairs takes two patterns, and a shell puts names in the place of patterns that are not in quotes; write --pairs \"L*.tif\" \"R*.tif\""
    ))
    .into())
}

/// The files of each pair.
fn pairs_of(patterns: &[String]) -> Result<Vec<[PathBuf; 2]>> {
    let [left, right] = patterns else {
        return Err(Error::Bug("--pairs takes two patterns".into()));
    };
    paired(matching(left)?, matching(right)?, left, right)
}

fn words(c: &SheetCheck, view: Option<usize>, to: &Path, files: &[&str]) -> String {
    // The frame of a view's plane is that of its target, x and y turned and shifted against the frame that a calibration gives its sheet.
    let (plane, frame) = match view {
        Some(view) => (
            format!("the plane of the target in view {view}"),
            format!(
                "x, y and z count along the axes of the target in view {view} and from its origin, in the corrected calibration, too\n"
            ),
        ),
        None => ("the calibrated sheet".to_string(), String::new()),
    };
    let mut text = format!(
        "the light lies {:+.4} ± {:.4} mm from {plane} at x = {:.2}, y = {:.2} mm (towards camera \"{}\" is positive),\n\
         tilted by {:+.4} ± {:.4} degrees about x and {:+.4} ± {:.4} degrees about y\n\
         median disparity {:.3} px",
        c.offset_mm,
        c.offset_sigma_mm,
        c.reference_mm[0],
        c.reference_mm[1],
        c.cameras[0],
        c.tilt_deg[0],
        c.tilt_sigma_deg[0],
        c.tilt_deg[1],
        c.tilt_sigma_deg[1],
        c.before.median_px()
    );
    if let Some(after) = &c.after {
        text.push_str(&format!(", after the correction {:.3} px ({} rounds)", after.median_px(), c.history.len()));
    }
    text.push('\n');
    text.push_str(&frame);
    let m = c.misalignment_after.as_ref().unwrap_or(&c.misalignment_before);
    text.push_str(&format!(
        "of that, smooth over the field: {:.3} px along the direction of depth (the sheet; scatter alone gives {:.3}), {:.3} px across it (the \
         cameras; {:.3});\nwith their signs: median {:+.3} ± {:.3} px along x, {:+.3} ± {:.3} px along y; single windows scatter by {:.2} and {:.2} px\n",
        m.smooth_px[0],
        m.smooth_noise_px[0],
        m.smooth_px[1],
        m.smooth_noise_px[1],
        m.median_px[0],
        m.median_sigma_px[0],
        m.median_px[1],
        m.median_sigma_px[1],
        m.scatter_px[0],
        m.scatter_px[1]
    ));
    if let Some(r) = &c.cameras_refined {
        text.push_str(&refined_words(r));
    }
    if c.thickness_mm.is_finite() {
        text.push_str(&format!("thickness of the light: {:.2} mm (full width at 1/e^2)", c.thickness_mm));
        if let Some(p) = &c.profile {
            text.push_str(&format!(
                "; brightest {:+.3} mm, centre of gravity {:+.3} mm from the plane found",
                p.top_mm, p.middle_mm
            ));
        }
        text.push('\n');
    }
    if !c.sigmas_hold_calibration {
        text.push_str(
            "the sigmas are those of the windows alone: the calibration states no covariance for what they need\n",
        );
    }
    text.push_str(&format!("Written to {}: {}\n", to.display(), files.join(", ")));
    text
}

/// What the particles did to the cameras.
fn refined_words(r: &CamerasRefined) -> String {
    let mut text =
        String::from("cameras refined with the sheet; change of each number, and its sigma before and after:\n");
    let wide = r.numbers.iter().map(|n| n.name.len()).max().unwrap_or(0);
    for n in &r.numbers {
        let (name, change) = (&n.name, n.change);
        text.push_str(&format!(
            "  {name:<wide$}  {change:+11.3e}  {:+6.2} sigmas   {:.2e} -> {:.2e}\n",
            n.change_sigmas, n.sigma_before, n.sigma_after
        ));
    }
    if r.degrees > 0 {
        text.push_str(&format!(
            "together: chi-square {:.1} of {} that the particles tell of (chance {:.2})\n",
            r.chi2, r.degrees, r.chance
        ));
    } else {
        text.push_str("the particles tell nothing of the cameras that the calibration did not know better\n");
    }
    text
}

/// Files whose names match a pattern with `*` and `?`, in the order of their names.
fn matching(pattern: &str) -> Result<Vec<PathBuf>> {
    let path = Path::new(pattern);
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let listing = std::fs::read_dir(folder)
        .map_err(|e| fault(folder, format!("this folder cannot be read: {}", of_the_system(&e))))?;
    let mut found: Vec<PathBuf> = listing
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|p| p.is_file() && p.file_name().is_some_and(|n| matches(&name, &n.to_string_lossy())))
        .collect();
    found.sort();
    if found.is_empty() {
        return Err(fault(
            path,
            "no file matches this pattern; * stands for any characters, and the pattern must be in quotes",
        ));
    }
    Ok(found)
}

fn paired(left: Vec<PathBuf>, right: Vec<PathBuf>, a: &str, b: &str) -> Result<Vec<[PathBuf; 2]>> {
    if left.len() != right.len() {
        let what = format!(
            "{} files, but \"{b}\" matches {}; every moment needs one image of each camera",
            left.len(),
            right.len()
        );
        return Err(fault(Path::new(a), what));
    }
    if let Some((twice, _)) = left.iter().zip(&right).find(|(l, r)| l == r) {
        return Err(fault(
            twice,
            "this image is given for both cameras; name the other camera's in the second pattern",
        ));
    }
    Ok(left.into_iter().zip(right).map(|(l, r)| [l, r]).collect())
}

/// Words of the name of a file from its end: numbers, and runs of letters.
fn name_words(path: &Path) -> Vec<String> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    let (mut out, mut last): (Vec<String>, _) = (vec![], None);
    for c in name.chars() {
        let kind = c.is_alphanumeric().then(|| c.is_numeric());
        match out.last_mut() {
            _ if kind.is_none() => {}
            Some(word) if kind == last => word.push(c),
            _ => out.push(c.to_string()),
        }
        last = kind;
    }
    out.reverse();
    out
}

/// The words of each name that are not the same in all of them.
fn running_words<'a>(files: impl Iterator<Item = &'a PathBuf>) -> Vec<Vec<String>> {
    let all: Vec<Vec<String>> = files.map(|path| name_words(path)).collect();
    let most = all.iter().map(Vec::len).max().unwrap_or(0);
    let runs = |k: &usize| all.iter().any(|words| words.get(*k) != all[0].get(*k));
    let running: Vec<usize> = (0..most).filter(runs).collect();
    // A number is the same with and without zeros before it.
    let plain = |word: &String| word.parse::<u64>().map_or_else(|_| word.clone(), |number| number.to_string());
    all.iter().map(|words| running.iter().filter_map(|k| words.get(*k).map(plain)).collect()).collect()
}

/// What must be said of pairs whose names count differently although both series have the same words.
fn mispaired(files: &[[PathBuf; 2]]) -> Option<String> {
    let [left, right] = [0, 1].map(|c| running_words(files.iter().map(|p| &p[c])));
    let pair = files.iter().zip(left.iter().zip(&right)).find(|(_, (l, r))| l != r)?.0;
    let name = |p: &PathBuf| p.file_name().unwrap_or_default().to_string_lossy().into_owned();
    left.iter().any(|l| right.contains(l)).then(|| {
        format!(
            "{} is paired with {}: files are paired in the order of their names, and these differ; where they are not of the same moment, remove \
             images that have no partner",
            name(&pair[0]),
            name(&pair[1])
        )
    })
}

/// Whether a name matches a pattern of `*` (any characters) and `?` (one).
fn matches(pattern: &str, name: &str) -> bool {
    let (p, n): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let mut row = vec![false; n.len() + 1];
    row[0] = true;
    for c in p {
        let mut before = row[0];
        row[0] = row[0] && c == '*';
        for i in 1..=n.len() {
            let here = row[i];
            row[i] = if c == '*' { here || row[i - 1] } else { before && (c == '?' || c == n[i - 1]) };
            before = here;
        }
    }
    row[n.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_whose_numbers_differ_are_told_unless_both_cameras_count_on_their_own() {
        let said = |pairs: &[[&str; 2]]| mispaired(&pairs.iter().map(|p| p.map(PathBuf::from)).collect::<Vec<_>>());
        let told = said(&[["l_1.png", "r_2.png"], ["l_2.png", "r_3.png"]]).unwrap();
        assert!(told.starts_with("l_1.png is paired with r_2.png"), "{told}");
        for right in [
            [["c1_f01.tif", "c2_f01.tif"], ["c1_f02.tif", "c2_f02.tif"]],
            [["a100.tif", "b700.tif"], ["a101.tif", "b701.tif"]],
            [["left.tif", "right.tif"], ["left_b.tif", "right_b.tif"]],
            [["E_1_frame_50.png", "E_3_frame_50.png"], ["E_1_frame_51.png", "E_3_frame_51.png"]],
        ] {
            assert_eq!(said(&right), None);
        }
        assert_eq!(said(&[["l_1.png", "r_2.png"]]), None);
        // Both exposures of a moment, one of each of which is not there.
        let exposures = [["p1a_l", "p1a_r"], ["p1b_l", "p1b_r"], ["p2a_l", "p2b_r"]];
        assert!(said(&exposures).is_some_and(|told| told.starts_with("p2a_l is paired with p2b_r")));
        assert_eq!(said(&[["p1a_l", "p1a_r"], ["p1b_l", "p1b_r"], ["p02a_l", "p2a_r"]]), None);
    }

    #[test]
    fn patterns_are_those_of_a_shell() {
        for (pattern, name, wanted) in [
            ("L*.tif", "L001.tif", true),
            ("L*.tif", "R001.tif", false),
            ("L*.tif", "L001.tiff", false),
            ("*", "anything", true),
            ("a?c", "abc", true),
            ("a?c", "ac", false),
            ("*_1_*.png", "E_camera_1_frame_1_.png", true),
            ("a.b", "a.b", true),
            ("", "a", false),
        ] {
            assert_eq!(matches(pattern, name), wanted, "{pattern} {name}");
        }
    }
}
