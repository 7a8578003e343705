//! `sheet`: the laser plane alone, cameras known.

use super::Done;
use super::arguments::Sheet;
use super::calibrate::{Results, tell};
use super::files::{NamedImages, can_write, read_text};
use super::progress::Bar;
use crate::error::Result;
use crate::pipeline::{SheetOptions, find_sheet};
use crate::record::Record;
use crate::rig_file::RigDescription;
use std::num::NonZeroUsize;

pub(super) fn run(command: &Sheet, threads: Option<NonZeroUsize>, progress: &Bar) -> Result<Done> {
    let rig_text = read_text(&command.rig, "a rig file (TOML)")?;
    let job = RigDescription::parse(&rig_text, &command.rig.display().to_string())?;
    let text = read_text(&command.calibration, "a calibration.json")?;
    let calibration = Record::from_json(&text, &command.calibration.display().to_string())?;
    let images = NamedImages { job: &job, rig: &command.rig, folder: command.images.as_deref() };
    can_write(&command.output)?;
    let options = SheetOptions { threads: threads.map_or(0, NonZeroUsize::get) };
    let found = find_sheet(&job, &|view, camera| images.load(view, camera), &calibration, &options, &mut |p| {
        tell(progress, &p);
        true
    })?;
    progress.say("writing the report".to_string());
    let results = Results { record: &found.record, residuals: None, images: &found.images, overlays: &found.overlays };
    results.write(&command.output, &[&command.rig, &command.calibration], &images.paths(), threads, progress)
}
