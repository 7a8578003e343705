//! A calibration in plain words, for a terminal.

use super::diagnosis;
use super::tables::{self, Table};
use super::verdict::{Level, verdict};
use crate::record::Record;
use std::fmt::Write;

/// Longest line of running text.
const WIDTH: usize = 100;

/// The calibration in plain words: verdict, cameras, rig, sheet, target, fit, views.
///
/// Control characters in names are replaced, so that a file cannot steer the terminal.
pub fn text(record: &Record) -> String {
    let mut out = String::new();
    let v = verdict(record);
    let word = match v.level {
        Level::Good => "GOOD",
        Level::Care => "CARE",
        Level::Bad => "DO NOT USE",
    };
    paragraph(&mut out, &format!("{word}: "), &v.headline);
    for (title, sentences) in [("Determined", &v.determined), ("Not determined", &v.open), ("What to do next", &v.next)]
    {
        let _ = writeln!(out, "\n{title}");
        sentences.iter().for_each(|s| paragraph(&mut out, "  - ", s));
    }
    section(&mut out, "Cameras", &tables::cameras(record));
    section(&mut out, "Rig (the frame of the first camera)", &tables::rig(record));
    if let Some(sheet) = &record.sheet {
        section(&mut out, "Laser sheet", &tables::sheet(sheet));
        paragraph(&mut out, "  ", &format!("Angles: {}.", sheet.angles_convention));
    }
    section(
        &mut out,
        "What the calibration's uncertainty does to a measurement (one sigma)",
        &diagnosis::mapping(record),
    );
    section(&mut out, "Target", &tables::target(record));
    section(&mut out, "Fit", &tables::fit(record));
    section(&mut out, "Residual rms of the places of discs per view, px", &views(record));
    section(&mut out, "Known beforehand, against the images", &diagnosis::priors(record));
    section(&mut out, "Is something missing in the model?", &diagnosis::model_tests(record));
    section(&mut out, "Each view left out once", &diagnosis::views(record));
    section(&mut out, "What the views say of the standard deviations", &diagnosis::spread(record));
    section(&mut out, "Where a standard deviation does not tell how far a number may be", &diagnosis::bent(record));
    let aside = diagnosis::set_aside(record);
    if !aside.is_empty() {
        let _ = writeln!(out, "\nDiscs set aside");
        aside.iter().for_each(|words| paragraph(&mut out, "  - ", words));
    }
    // Line ends are ours; everything else that steers a terminal came with a name.
    out.chars().map(|c| if c.is_control() && c != '\n' { '\u{fffd}' } else { c }).collect()
}

fn views(record: &Record) -> Table {
    let mut table = Table { heads: record.cameras.iter().map(|c| c.name.clone()).collect(), rows: Vec::new() };
    for v in &record.views {
        let what = if v.in_sheet { ", in the sheet" } else { "" };
        let unused = if v.used { "" } else { ", not used" };
        let cells = record.cameras.iter().map(|c| tables::Cell {
            text: v.rms_px.get(&c.name).map_or("-".into(), |&x| super::number::significant(x, 3)),
            note: match v.outliers.get(&c.name) {
                Some(&n) if n > 0 => format!("{n} left out"),
                _ => String::new(),
            },
            strong: false,
        });
        table.rows.push(tables::Row { name: format!("view {}{what}{unused}", v.index), cells: cells.collect() });
    }
    table
}

/// Words wrapped at [`WIDTH`], later lines indented as far as the lead.
fn paragraph(out: &mut String, lead: &str, words: &str) {
    let indent = lead.chars().count();
    let mut column = indent;
    out.push_str(lead);
    for (i, word) in words.split_whitespace().enumerate() {
        let n = word.chars().count();
        if i > 0 && column + 1 + n > WIDTH {
            out.push('\n');
            out.extend(std::iter::repeat_n(' ', indent));
            column = indent;
        } else if i > 0 {
            out.push(' ');
            column += 1;
        }
        out.push_str(word);
        column += n;
    }
    out.push('\n');
}

fn section(out: &mut String, title: &str, table: &Table) {
    if table.rows.is_empty() {
        return;
    }
    let _ = writeln!(out, "\n{title}");
    let show = |c: &tables::Cell| if c.note.is_empty() { c.text.clone() } else { format!("{} [{}]", c.text, c.note) };
    let first = table.rows.iter().map(|r| r.name.chars().count()).max().unwrap_or(0);
    let columns = table.rows.iter().map(|r| r.cells.len()).max().unwrap_or(0);
    let width = |i: usize| {
        let cells = table.rows.iter().filter_map(|r| r.cells.get(i)).map(|c| show(c).chars().count());
        cells.chain(table.heads.get(i).map(|h| h.chars().count())).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut line = |name: &str, cells: &[String]| {
        let mut row = format!("  {name:first$}");
        for (cell, &width) in cells.iter().zip(&widths) {
            let _ = write!(row, "   {cell:width$}");
        }
        let _ = writeln!(out, "{}", row.trim_end());
    };
    if !table.heads.is_empty() {
        line("", &table.heads);
    }
    for row in &table.rows {
        line(&row.name, &row.cells.iter().map(show).collect::<Vec<_>>());
    }
}
