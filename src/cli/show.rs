//! `show`: a calibration in words.

use super::Done;
use super::arguments::Show;
use super::calibrate::flags;
use super::files::read_text;
use crate::error::Result;
use crate::record::Record;

pub(super) fn run(command: &Show) -> Result<Done> {
    let text = read_text(&command.calibration, "a calibration.json")?;
    let record = Record::from_json(&text, &command.calibration.display().to_string())?;
    let json = serde_json::from_str(&record.to_json()?).unwrap_or_default();
    Ok(Done { text: crate::report::text(&record), json, flags: flags(&record) })
}
