//! `residuals.csv`: one row per observation, units in the column names, '.' as decimal sign.

use crate::record::{Record, ResidualTable};
use std::fmt::Write;

/// First line of `residuals.csv`.
const HEADER: &str =
    "view,camera,column,row,level,feature,u_px,v_px,du_px,dv_px,normal_px,sigma_px,weight,outlier,reason";

/// The text of `residuals.csv`; `record` gives the cameras' names.
///
/// One row per observation, RFC 4180 quoting; a number that does not exist is an empty field. `outlier` is 0 or 1.
pub fn residuals_csv(record: &Record, table: &ResidualTable) -> String {
    let names: Vec<String> = record.cameras.iter().map(|c| csv_field(&c.name)).collect();
    let mut out = String::with_capacity(table.len() * 130 + HEADER.len() + 2);
    out.push_str(HEADER);
    out.push('\n');
    for i in 0..table.len() {
        let Some(row) = table.row(i) else { break };
        let camera = names.get(row.camera).map_or("", String::as_str);
        let (d, kind) = (row.disc, row.kind.word());
        let _ = write!(out, "{},{camera},{},{},{},{kind}", row.view, d.column, d.row, d.level);
        let numbers = [row.u_px, row.v_px, row.du_px, row.dv_px, row.normal_px, row.sigma_px, row.weight];
        for x in numbers {
            out.push(',');
            if x.is_finite() {
                let _ = write!(out, "{x}");
            }
        }
        match table.outlier(i) {
            None => out.push_str(",0,\n"),
            Some(reason) => {
                let _ = writeln!(out, ",1,{}", csv_field(reason));
            }
        }
    }
    out
}

/// A text field of a CSV file: quoted where it holds a separator, a quote or a line end (RFC 4180).
pub fn csv_field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into() }
}
