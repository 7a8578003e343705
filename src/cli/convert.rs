//! `convert`: other packages' calibrations.

use super::Done;
use super::arguments::{Convert, FromFormat, ToFormat};
use super::files::{Output, can_write, fault, read_text};
use crate::dewarp::{Placement, SoloffDegrees};
use crate::error::{Invalid, Result};
use crate::exchange::{
    Conversion, ExportFormat, ImportFormat, ImportOptions, Loss, NamedText, export, export_soloff, import, placed,
    placed_at_view,
};
use crate::record::Record;
use serde_json::json;
use std::path::{Path, PathBuf};

pub(super) fn run(command: &Convert) -> Result<Done> {
    let folder = command.output.clone().unwrap_or_else(|| PathBuf::from("."));
    can_write(&folder)?;
    let mut output = Output::default();
    let (notes, losses, marks, flags) = match (command.to, command.from) {
        (Some(to), None) => {
            let [file] = &command.files[..] else {
                return Err(
                    Invalid::Contradiction("--to writes one calibration; give one calibration.json".into()).into()
                );
            };
            if command.image_size.is_some() || command.pixel_pitch_mm.is_some() {
                let what = "--image-size and --pixel-pitch-mm are for --from, where a file does not say them; leave them out with --to";
                return Err(Invalid::Contradiction(what.into()).into());
            }
            let record = Record::from_json(&read_text(file, "a calibration.json")?, &file.display().to_string())?;
            let record = in_frame(command, record)?;
            if command.soloff_degrees.is_some() && to != ToFormat::Soloff {
                let what = "--soloff-degrees are those of --to soloff; leave them out for another format";
                return Err(Invalid::Contradiction(what.into()).into());
            }
            let done = match (export_format(to), command.soloff_degrees) {
                (None, _) => own(&record)?,
                (Some(_), Some([xy, z])) => export_soloff(&record, SoloffDegrees { xy, z })?,
                (Some(format), None) => export(&record, format)?,
            };
            let told = told(&done);
            done.result.into_iter().for_each(|(name, bytes)| output.add(name, bytes));
            told
        }
        (None, Some(from)) => {
            let options = ImportOptions { image_size_px: command.image_size, pixel_pitch_mm: command.pixel_pitch_mm };
            let done = import(&inputs(&command.files, from)?, import_format(from), &options)?;
            let told = told(&done);
            output.add("calibration.json", done.result.to_json()?);
            told
        }
        _ => return Err(Invalid::Contradiction("give either --to FORMAT or --from FORMAT".into()).into()),
    };
    let names: Vec<String> = output.names().iter().map(|n| folder.join(n).display().to_string()).collect();
    output.commit_beside(&folder, &command.files.iter().map(AsRef::as_ref).collect::<Vec<&Path>>())?;
    let loss = |l: &Loss| json!({ "rms_px": l.rms_px, "max_px": l.max_px });
    let all = |l: &[Loss]| l.iter().map(loss).collect::<Vec<_>>();
    let json = json!({ "files": names, "loss": all(&losses), "marks": all(&marks), "notes": notes });
    let mut text: String = names.iter().map(|n| format!("wrote {n}\n")).collect();
    for (i, l) in losses.iter().enumerate().filter(|(_, l)| l.max_px > 0.0) {
        text += &format!("camera {}: fitted, {:.2e} px rms, {:.2e} px at most\n", i + 1, l.rms_px, l.max_px);
    }
    notes.iter().for_each(|n| text += &format!("note: {n}\n"));
    Ok(Done { text, json, flags })
}

/// Notes, losses, residuals of marks, flags.
type Told = (Vec<String>, Vec<Loss>, Vec<Loss>, Vec<String>);

fn told<T>(done: &Conversion<T>) -> Told {
    (done.notes.clone(), done.losses.clone(), done.marks.clone(), done.flags())
}

/// The calibration with its sheet frame where it is to stand.
fn in_frame(command: &Convert, record: Record) -> Result<Record> {
    if let Some(view) = command.frame_of_view {
        return placed_at_view(&record, view);
    }
    let turn_deg = command.turn_deg.unwrap_or(0.0);
    if !turn_deg.is_finite() {
        return Err(Invalid::value("turn of the sheet frame (degrees)", turn_deg, "a number").into());
    }
    if command.origin_mm.is_none() && command.turn_deg.is_none() {
        return Ok(record);
    }
    let origin_mm = command.origin_mm.unwrap_or([0.0; 2]);
    placed(&record, &Placement { origin_mm, angle_rad: turn_deg.to_radians(), turned_round: false })
}

/// The calibration itself.
fn own(record: &Record) -> Result<Conversion<Vec<(String, Vec<u8>)>>> {
    let result = vec![("calibration.json".to_string(), record.to_json()?.into_bytes())];
    Ok(Conversion { result, losses: vec![Loss::NONE; record.cameras.len()], marks: vec![], notes: vec![] })
}

/// None for this program's own.
fn export_format(word: ToFormat) -> Option<ExportFormat> {
    match word {
        ToFormat::Spivcal => None,
        ToFormat::Opencv => Some(ExportFormat::OpenCv),
        ToFormat::OpencvXml => Some(ExportFormat::OpenCvXml),
        ToFormat::Openptv => Some(ExportFormat::OpenPtv),
        ToFormat::Matlab => Some(ExportFormat::Matlab),
        ToFormat::Soloff => Some(ExportFormat::Soloff),
        ToFormat::Csv => Some(ExportFormat::Csv),
    }
}

fn import_format(word: FromFormat) -> ImportFormat {
    match word {
        FromFormat::Opencv => ImportFormat::OpenCv,
        FromFormat::Openptv => ImportFormat::OpenPtv,
        FromFormat::Davis => ImportFormat::DaVis,
        FromFormat::Uvmat => ImportFormat::Uvmat,
    }
}

/// The files named, and the distortion file beside each OpenPTV orientation.
fn inputs(files: &[PathBuf], from: FromFormat) -> Result<Vec<NamedText>> {
    let named = |path: &Path| -> Result<NamedText> {
        let text = read_text(path, "a calibration of another package")?;
        Ok(NamedText { name: path.display().to_string(), text })
    };
    let mut out = Vec::new();
    for path in files {
        out.push(named(path)?);
        let partner = path.with_extension("addpar");
        if from == FromFormat::Openptv && path.extension().is_some_and(|e| e == "ori") && !files.contains(&partner) {
            if !partner.exists() {
                return Err(fault(
                    &partner,
                    "there is no such file; OpenPTV keeps the distortion there (k1 k2 k3 p1 p2 1 0)",
                ));
            }
            out.push(named(&partner)?);
        }
    }
    Ok(out)
}
