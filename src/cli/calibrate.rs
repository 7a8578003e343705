//! `calibrate`: the main job.

use super::Done;
use super::arguments::Calibrate;
use super::files::{NamedImages, Output, can_write, read_text, tell_further_pages};
use super::progress::Bar;
use super::threads;
use crate::error::Result;
use crate::pipeline::{CalibrateOptions, Progress, SeenImage, calibrate};
use crate::record::{Record, ResidualTable};
use crate::report::{Level, OverlayInput, OverlayShapes, overlay_png, residuals_csv, text, verdict, write_html};
use crate::rig_file::RigDescription;
use rayon::prelude::*;
use serde_json::json;
use std::fmt::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

pub(super) fn run(command: &Calibrate, threads: Option<NonZeroUsize>, progress: &Bar) -> Result<Done> {
    let rig_text = read_text(&command.rig, "a rig file (TOML)")?;
    let job = RigDescription::parse(&rig_text, &command.rig.display().to_string())?;
    let images = NamedImages { job: &job, rig: &command.rig, folder: command.images.as_deref() };
    can_write(&command.output)?;
    let options = CalibrateOptions { threads: threads.map_or(0, NonZeroUsize::get), ..CalibrateOptions::default() };
    let found = calibrate(&job, &|view, camera| images.load(view, camera), &options, &mut |p| {
        tell(progress, &p);
        true
    })?;
    progress.say("writing the report".to_string());
    let results = Results {
        record: &found.record,
        residuals: Some(&found.residuals),
        images: &found.images,
        overlays: &found.overlays,
    };
    results.write(&command.output, &[&command.rig], &images.paths(), threads, progress)
}

pub(super) fn tell(bar: &Bar, progress: &Progress<'_>) {
    match *progress {
        Progress::Image { done, total, .. } => {
            if done == 1 {
                bar.stage("finding discs", total);
            }
            bar.step();
        }
        Progress::Searching => {}
        Progress::Iteration { number, cost, decrement } => {
            bar.say(format!("adjusting: iteration {number}, cost {cost:.6e}, Newton decrement {decrement:.1e}"));
        }
    }
}

/// What is written about a calibration.
pub(super) struct Results<'a> {
    pub(super) record: &'a Record,
    /// None where nothing was adjusted.
    pub(super) residuals: Option<&'a ResidualTable>,
    pub(super) images: &'a [SeenImage],
    pub(super) overlays: &'a [OverlayShapes],
}

impl Results<'_> {
    /// Writes everything, but over none of the `inputs` and `images` that were read, and says so.
    pub(super) fn write(
        &self,
        to: &Path,
        inputs: &[&Path],
        images: &[PathBuf],
        threads: Option<NonZeroUsize>,
        progress: &Bar,
    ) -> Result<Done> {
        let output = self.files(threads)?;
        let folder = to.display();
        let json = summary(self.record, &folder.to_string(), &output.names());
        let mut words = text(self.record);
        let _ = writeln!(words, "\nWritten to {folder}: {}", listed(&output.names()));
        let old = left_over(to, &output.names());
        if !old.is_empty() {
            let _ = writeln!(
                words,
                "Of an earlier run, and of other images: {}; remove what is not wanted",
                old.join(", ")
            );
        }
        let read: Vec<&Path> = inputs.iter().copied().chain(images.iter().map(AsRef::as_ref)).collect();
        output.commit_beside(to, &read)?;
        tell_further_pages(progress, images);
        Ok(Done { text: words, json, flags: flags(self.record) })
    }

    /// Everything that is written, by the name under which it is written.
    fn files(&self, threads: Option<NonZeroUsize>) -> Result<Output> {
        let inputs: Vec<OverlayInput<'_>> = self
            .images
            .iter()
            .zip(self.overlays)
            .map(|(i, shapes)| OverlayInput { view: i.view, camera: i.camera, image: i.image.view(), shapes })
            .collect();
        let none = ResidualTable::default();
        let overlays = || inputs.par_iter().map(|i| overlay_png(&i.image, i.shapes)).collect::<Vec<Result<Vec<u8>>>>();
        let page = || write_html(self.record, &inputs, self.residuals.unwrap_or(&none));
        let tables = || (self.record.to_json(), self.residuals.map(|r| residuals_csv(self.record, r)));
        let pool = threads::pool(threads)?;
        let ((page, tables), overlays) = pool.install(|| rayon::join(|| rayon::join(page, tables), overlays));
        let mut out = Output::default();
        out.add("calibration.json", tables.0?);
        if let Some(residuals) = tables.1 {
            out.add("residuals.csv", residuals);
        }
        out.add("report.html", page?);
        for (input, png) in inputs.iter().zip(overlays) {
            out.add(format!("overlay_{:02}_{}.png", input.view, self.record.cameras[input.camera].name), png?);
        }
        Ok(out)
    }
}

/// Overlays in the folder that are not written now.
fn left_over(folder: &Path, names: &[&str]) -> Vec<String> {
    let Ok(listing) = std::fs::read_dir(folder) else { return vec![] };
    let all = listing.filter_map(|e| e.ok().map(|e| e.file_name().to_string_lossy().into_owned()));
    let overlay = |n: &String| n.starts_with("overlay_") && n.ends_with(".png") && !names.contains(&n.as_str());
    let mut out: Vec<String> = all.filter(overlay).collect();
    out.sort();
    out
}

/// All names, overlays counted.
fn listed(names: &[&str]) -> String {
    let (overlays, others): (Vec<&str>, Vec<&str>) = names.iter().partition(|n| n.starts_with("overlay_"));
    format!("{}, {} overlay(s)", others.join(", "), overlays.len())
}

fn summary(record: &Record, folder: &str, files: &[&str]) -> serde_json::Value {
    let v = verdict(record);
    let level = match v.level {
        Level::Good => "good",
        Level::Care => "care",
        Level::Bad => "bad",
    };
    let cameras: Vec<_> = record.cameras.iter().map(|c| json!({ "name": c.name, "rms_px": c.rms_px })).collect();
    json!({
        "output": folder, "files": files, "verdict": level, "headline": v.headline, "cameras": cameras,
        "sheet": record.sheet, "fit": record.fit,
    })
}

/// What must be looked at before the result is used.
pub(super) fn flags(record: &Record) -> Vec<String> {
    let v = verdict(record);
    if v.level == Level::Good {
        return Vec::new();
    }
    let mut flags = vec![v.headline];
    flags.extend(record.fit.undetermined.iter().map(|u| format!("not determined: {u}")));
    flags.extend(record.fit.flags.iter().cloned());
    flags
}
