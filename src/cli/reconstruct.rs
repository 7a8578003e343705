//! `reconstruct`: two planar displacement fields to three components.

use super::Done;
use super::arguments::Reconstruct;
use super::dewarp::named_otherwise;
use super::dewarped::Dewarped;
use super::files::{Output, can_write, fault, read_text};
use super::progress::Bar;
use super::threads;
use crate::dewarp::SheetMap;
use crate::error::{Invalid, Result};
use crate::reconstruct::{
    FieldFormat, FieldTable, FieldUnit, Options, PlanarField, VectorField, parse_field, perturbed_maps, reconstruct,
};
use crate::record::Record;
use crate::report::{VectorPicture, vectors_svg};
use crate::stats::median;
use serde_json::json;
use std::num::NonZeroUsize;
use std::path::Path;

/// More missing vectors than this part of the field are flagged.
const MISSING_LIMIT: f64 = 0.3;

/// Fields that fit this many times better exchanged are exchanged, by so many vectors at least.
const EXCHANGED: f64 = 3.0;
const FEWEST_COMPARED: usize = 30;
/// Residuals below this are rounding, px.
const ROUNDED_PX: f64 = 1e-3;

/// Residuals of more than this many times what stated sigmas let expect are flagged.
const RESIDUAL_LIMIT: f64 = 1.5;

pub(super) fn run(command: &Reconstruct, threads: Option<NonZeroUsize>, progress: &Bar) -> Result<Done> {
    let text = read_text(&command.calibration, "a calibration.json")?;
    let record = Record::from_json(&text, &command.calibration.display().to_string())?;
    let [first, second] = record.cameras.as_slice() else {
        let what = format!("three components need two cameras, but the calibration holds {}", record.cameras.len());
        return Err(fault(&command.calibration, what));
    };
    let (folder, name, picture_name) = place(&command.output)?;
    can_write(folder)?;
    let maps = [SheetMap::from_record(&record, 0)?, SheetMap::from_record(&record, 1)?];
    let read = |path: &Path| read_text(path, "a displacement field (CSV, OpenPIV, PIVlab)");
    let texts = [read(&command.left)?, read(&command.right)?];
    if texts[0] == texts[1] {
        let what =
            format!("this holds the same numbers as {}; name the field of the other camera", command.left.display());
        return Err(fault(&command.right, what));
    }
    let table = |k: usize, path: &Path| parse_field(&texts[k], &path.display().to_string());
    let tables = [table(0, &command.left)?, table(1, &command.right)?];
    let dewarped =
        command.dewarped.as_deref().map(|p| Dewarped::grid_of(p, &record, &[&maps[0], &maps[1]])).transpose()?;
    let unit = unit(command, &tables)?;
    let tables = tables.map(|t| t.in_unit(unit));
    let field = |t: &FieldTable| PlanarField::new(t)?.overlapping(command.overlap);
    let fields = [field(&tables[0])?, field(&tables[1])?];
    let perturbed = if command.no_calibration_sigma { None } else { perturbed_maps(&record)? };
    let mut flags = vec![];
    if perturbed.is_none() && !command.no_calibration_sigma {
        flags.push("the calibration does not determine all that the maps need: the sigmas hold the planar vectors' noise alone".to_string());
    }
    flags.extend(perturbed.as_ref().and_then(|_| untold(&record)));
    let names = [first.name.as_str(), second.name.as_str()];
    let otherwise = [&command.left, &command.right].into_iter().enumerate();
    let otherwise = otherwise.filter_map(|(c, path)| named_otherwise(path, c, &names));
    flags.extend(otherwise.map(|w| format!("{w}: the field of the first camera of the calibration comes first")));
    let options = Options {
        unit,
        dewarped,
        reference: command.reference.into(),
        sigma: command.sigma,
        spacing_mm: command.spacing_mm,
        perturbed,
    };
    progress.say("three components".to_string());
    let pool = threads::pool(threads)?;
    let found = pool.install(|| reconstruct([&maps[0], &maps[1]], [&fields[0], &fields[1]], names, &options))?;
    let exchanged = Options { perturbed: None, ..options };
    let exchanged = pool.install(|| reconstruct([&maps[0], &maps[1]], [&fields[1], &fields[0]], names, &exchanged));
    if let Some(what) = exchanged.ok().and_then(|other| fits_better(&other, &found, names)) {
        return Err(fault(&command.left, what));
    }
    flags.extend(gaps(&found, &fields, names));
    if found.common_errors.is_some() && found.residual_ratio > RESIDUAL_LIMIT {
        flags.push(format!(
            "the residuals are {:.1} times what the sigmas in the files let expect, and those of u, v and w have been enlarged as much: the stated ones are too \
             small, the sheet or the cameras are off (run spivcal check), or the fields are not of the same moments",
            found.residual_ratio
        ));
    }
    let (words, summary) = summary(&found, &tables, unit, [&command.output, &folder.join(&picture_name)], names[0]);
    let flagged: Vec<bool> = found.flags.iter().map(|f| *f != 0).collect();
    let mut out = Output::default();
    out.add(&name, found.to_csv());
    out.add(&picture_name, vectors_svg(&picture(&found, &flagged, names[0], &name)));
    let inputs = [&command.calibration, &command.left, &command.right].into_iter().chain(&command.dewarped);
    out.commit_beside(folder, &inputs.map(AsRef::as_ref).collect::<Vec<&Path>>())?;
    Ok(Done { text: words, json: summary, flags })
}

/// Folder and name of the CSV file, and name of the picture beside it.
fn place(output: &Path) -> Result<(&Path, String, String)> {
    if output.is_dir() {
        let example = output.join("vectors.csv");
        let what = format!("this is a folder; name the CSV file to be written, such as {}", example.display());
        return Err(fault(output, what));
    }
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let Some(name) = output.file_name() else {
        return Err(fault(output, "this is no name of a file; name the CSV file to be written"));
    };
    let picture = Path::new(name).with_extension("svg").to_string_lossy().into_owned();
    if picture == name.to_string_lossy() {
        let what = "this is the name of the picture that is written beside the CSV file; name the CSV file, such as vectors.csv";
        return Err(fault(output, what));
    }
    Ok((folder, name.to_string_lossy().into_owned(), picture))
}

/// Why fields are those of the other cameras: exchanged they leave far less.
fn fits_better(exchanged: &VectorField, found: &VectorField, names: [&str; 2]) -> Option<String> {
    let typical = |f: &VectorField| {
        let mut left: Vec<f64> = f.residual_px.iter().map(|r| r.abs()).filter(|r| r.is_finite()).collect();
        (left.len() >= FEWEST_COMPARED).then(|| median(&mut left))?
    };
    let (other, own) = (typical(exchanged)?, typical(found)?);
    (own > EXCHANGED * other.max(ROUNDED_PX)).then(|| {
        format!(
            "this field is given for camera \"{}\", but with the two fields exchanged both cameras agree to {other:.3} px (median) in place of {own:.3} px: name \
             the field of camera \"{}\" first",
            names[0], names[0]
        )
    })
}

/// Says so where a good part of the points has no vector.
fn gaps(found: &VectorField, fields: &[PlanarField; 2], names: [&str; 2]) -> Option<String> {
    let (filled, all) = (found.filled().0, found.covered);
    let part = |f: &PlanarField| format!("{} of {}", f.filled().0, f.filled().1);
    ((all - filled) as f64 > MISSING_LIMIT * all as f64).then(|| {
        format!(
            "{} of {all} points between the vectors of both cameras have no vector: the fields hold {} (\"{}\") and {} (\"{}\") of their vectors; check masks, flags and \
             validation of the planar fields",
            all - filled,
            part(&fields[0]),
            names[0],
            part(&fields[1]),
            names[1]
        )
    })
}

/// Says so where standard deviations by the calibration are too small by nobody knows how much.
fn untold(record: &Record) -> Option<String> {
    record.mapping_uncertainty.as_ref()?.by_views.as_ref()?.untold().then(|| {
        "the views of the calibration differ by more than their noise, and do not tell how much of that is in u, v and w: the sigmas by the calibration are too \
         small (its report says what to record)"
            .into()
    })
}

fn picture<'a>(found: &'a VectorField, flagged: &'a [bool], first: &'a str, title: &'a str) -> VectorPicture<'a> {
    VectorPicture {
        title,
        x_mm: &found.x_mm,
        y_mm: &found.y_mm,
        displacement_mm: [&found.u_mm, &found.v_mm, &found.w_mm],
        flagged,
        spacing_mm: found.grid.mm_per_px,
        towards: first,
    }
}

/// Unit of both fields, which no option and no header may contradict.
fn unit(command: &Reconstruct, tables: &[FieldTable; 2]) -> Result<FieldUnit> {
    let unit = stated_unit(command, tables)?;
    let mm = |u: FieldUnit| u == FieldUnit::Millimetres;
    // OpenPIV's header is the same for fields in mm.
    let named = |t: &&FieldTable| t.format != FieldFormat::OpenPiv && t.unit.is_some_and(|u| mm(u) != mm(unit));
    if let Some(table) = tables.iter().find(named) {
        let [there, said] = if mm(unit) { ["px", "mm"] } else { ["mm", "px"] };
        let what =
            format!("its header says {there}, but --unit says {said}; leave --unit out, or name the field in {said}");
        return Err(fault(Path::new(&table.file), what));
    }
    match &command.dewarped {
        Some(path) if unit != FieldUnit::DewarpedPixels => {
            let what = "--dewarped is for fields in pixels of dewarped images, and these are not; leave it out, or say --unit dewarped";
            Err(fault(path, what))
        }
        _ => Ok(unit),
    }
}

/// Unit of the option, else that of the files.
fn stated_unit(command: &Reconstruct, tables: &[FieldTable; 2]) -> Result<FieldUnit> {
    if let Some(word) = command.unit {
        return Ok(word.into());
    }
    let of = |t: &FieldTable| match (t.unit, &command.dewarped) {
        (Some(FieldUnit::RawPixels), Some(_)) => Some(FieldUnit::DewarpedPixels),
        (unit, _) => unit,
    };
    match tables.each_ref().map(of) {
        [Some(a), Some(b)] if a == b => Ok(a),
        [Some(_), Some(_)] => {
            let what = format!("{} and {} are in different units; export both alike", tables[0].file, tables[1].file);
            Err(Invalid::Contradiction(what).into())
        }
        _ => {
            let what = "the header does not name the unit; say --unit px (raw images), --unit dewarped or --unit mm";
            Err(fault(Path::new(&tables[0].file), what))
        }
    }
}

/// Four decimals, or four digits of what they would not show.
fn told(x: f64) -> String {
    if x != 0.0 && x.abs() < 0.01 { format!("{x:.3e}") } else { format!("{x:.4}") }
}

fn summary(
    found: &VectorField,
    tables: &[FieldTable; 2],
    unit: FieldUnit,
    [to, picture]: [&Path; 2],
    first: &str,
) -> (String, serde_json::Value) {
    let (filled, all) = found.filled();
    let median = |list: &[f64]| {
        let mut v: Vec<f64> = list.iter().copied().filter(|x| x.is_finite()).collect();
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let [su, sv, sw] = found.sigma_mm.each_ref().map(|s| median(s));
    let [cu, cv, cw] = found.calibration_sigma_mm.each_ref().map(|s| median(s));
    let residual = median(&found.residual_px);
    let how = match found.sigma_estimated {
        true if found.sigma_by_gradient > 0.0 => &format!(
            "estimated from the residuals; {:.3} of the change from vector to vector adds to it",
            found.sigma_by_gradient
        ),
        true => "estimated from the residuals",
        false if found.common_errors.is_some() => "median of what the files state",
        false => "given",
    };
    let mut text = format!(
        "{} and {}: {filled} of {all} vectors, {:.4} mm apart; w is positive towards camera \"{first}\"\n\
         sigma of a planar component: {} {} ({how}); median residual {} px\n\
         median sigma by the planar vectors: u {su:.3e}, v {sv:.3e}, w {sw:.3e} mm\n",
        tables[0].format.word(),
        tables[1].format.word(),
        found.grid.mm_per_px,
        told(found.sigma),
        match unit {
            FieldUnit::RawPixels => "px",
            FieldUnit::DewarpedPixels => "dewarped px",
            FieldUnit::Millimetres => "mm",
        },
        told(residual)
    );
    if let Some(common) = found.common_errors {
        text.push_str(&format!(
            "the residuals are {:.2} of what these sigmas let expect: a correlation of {common:.2} of both cameras' errors across the direction of depth, \
             which the sigmas of u, v, w hold\n",
            found.residual_ratio
        ));
    } else {
        text.push_str(
            "errors that both cameras share (the same particles) are in no residual, and not in these sigmas; they are where the files state \
             sigma_dx and sigma_dy of every vector\n",
        );
    }
    if cw.is_finite() {
        text.push_str(&format!("median sigma by the calibration:    u {cu:.3e}, v {cv:.3e}, w {cw:.3e} mm\n"));
        if found.calibration_enlarged != [1.0; 3] {
            let [u, v, w] = found.calibration_enlarged;
            text.push_str(&format!(
                "the calibration's report says why these are {u:.1}, {v:.1} and {w:.1} times what its noise alone would tell (views that differ, or equations that bend)\n"
            ));
        }
    }
    text.push_str(&format!("Written to {}, picture {}\n", to.display(), picture.display()));
    let number = |x: f64| if x.is_finite() { json!(x) } else { serde_json::Value::Null };
    let json = json!({
        "output": to.display().to_string(), "picture": picture.display().to_string(), "vectors": filled, "points": all, "grid": found.grid, "sigma": number(found.sigma),
        "sigma_estimated": found.sigma_estimated, "sigma_by_gradient": number(found.sigma_by_gradient), "common_errors": found.common_errors, "residual_ratio": number(found.residual_ratio), "median_residual_px": number(residual),
        "median_sigma_mm": [number(su), number(sv), number(sw)],
        "median_calibration_sigma_mm": [number(cu), number(cv), number(cw)], "calibration_sigma_enlarged": found.calibration_enlarged,
    });
    (text, json)
}
