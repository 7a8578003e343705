//! `residuals.csv`: one row per observation, units in the column names, '.' as decimal sign.

use crate::record::{Record, ResidualTable};
use rayon::prelude::*;
use std::ops::Range;

/// First line of `residuals.csv`.
const HEADER: &str =
    "view,camera,column,row,level,feature,u_px,v_px,du_px,dv_px,normal_px,sigma_px,weight,outlier,reason";

/// Rows that a thread writes at a time.
const ROWS: usize = 2048;

/// The text of `residuals.csv`; `record` gives the cameras' names.
///
/// One row per observation, RFC 4180 quoting; a number that does not exist is an empty field, others are the shortest that read back to
/// the last bit. `outlier` is 0 or 1. Within a thread pool written by its threads, to the same text.
pub fn residuals_csv(record: &Record, table: &ResidualTable) -> String {
    let names: Vec<String> = record.cameras.iter().map(|c| csv_field(&c.name)).collect();
    let mut out = Vec::with_capacity(table.len() * 130 + HEADER.len() + 2);
    out.extend_from_slice(HEADER.as_bytes());
    out.push(b'\n');
    let parts = table.len().div_ceil(ROWS);
    let part = |k: usize| k * ROWS..((k + 1) * ROWS).min(table.len());
    if parts > 1 && rayon::current_thread_index().is_some() {
        let written = (0..parts).into_par_iter().map(|k| {
            let mut out = Vec::with_capacity(ROWS * 130);
            push_rows(&mut out, &names, table, part(k));
            out
        });
        written.collect::<Vec<_>>().iter().for_each(|text| out.extend_from_slice(text));
    } else {
        (0..parts).for_each(|k| push_rows(&mut out, &names, table, part(k)));
    }
    // Only text went in.
    String::from_utf8(out).unwrap_or_default()
}

fn push_rows(out: &mut Vec<u8>, names: &[String], table: &ResidualTable, rows: Range<usize>) {
    // What a row belongs to is that of many rows on end.
    let (mut place, mut belongs) = (None, String::new());
    for i in rows {
        let Some(row) = table.row(i) else { break };
        let here = Some((row.view, row.camera, row.disc, row.kind));
        if place != here {
            place = here;
            let camera = names.get(row.camera).map_or("", String::as_str);
            let (d, kind) = (row.disc, row.kind.word());
            belongs = format!("{},{camera},{},{},{},{kind}", row.view, d.column, d.row, d.level);
        }
        out.extend_from_slice(belongs.as_bytes());
        for x in [row.u_px, row.v_px, row.du_px, row.dv_px, row.normal_px, row.sigma_px, row.weight] {
            out.push(b',');
            push_number(out, x);
        }
        match table.outlier(i) {
            None => out.extend_from_slice(b",0,\n"),
            Some(reason) => out.extend_from_slice(format!(",1,{}\n", csv_field(reason)).as_bytes()),
        }
    }
}

/// What `{x}` gives (of two shortest texts that are equally near, the other one), nothing for what is no number. `serde_json` finds the
/// digits five times faster, but writes an exponent for what is small or large and `.0` behind whole numbers.
fn push_number(out: &mut Vec<u8>, x: f64) {
    if !x.is_finite() {
        return;
    }
    if !(1e-5..1e15).contains(&x.abs()) || serde_json::to_writer(&mut *out, &x).is_err() {
        out.extend_from_slice(x.to_string().as_bytes());
    } else if out.ends_with(b".0") {
        out.truncate(out.len() - 2);
    }
}

/// A text field of a CSV file: quoted where it holds a separator, a quote or a line end (RFC 4180).
pub fn csv_field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(x: f64) -> String {
        let mut out = b"5.0,".to_vec();
        push_number(&mut out, x);
        String::from_utf8(out.split_off(4)).unwrap()
    }

    #[test]
    fn numbers_are_as_short_as_can_be_and_read_back() {
        let edges = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            10.0,
            1e-5,
            1e15,
            1e16,
            0.1,
            1.0 / 3.0,
            5e-324,
            f64::MAX,
            f64::EPSILON,
            100.5,
            123456789.0,
        ];
        let near = edges.iter().flat_map(|x| [*x, x.next_up(), x.next_down()]);
        // Bits in disorder: all signs, exponents and digits; and the sizes that pixels have.
        let disorder = (1..200_000u64).map(|k| k.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let sizes = disorder.clone().map(|k| (k >> 11) as f64 * 2f64.powi(-44 - (k % 31) as i32));
        for x in near.chain(disorder.map(f64::from_bits)).chain(sizes) {
            let text = written(x);
            if !x.is_finite() {
                assert_eq!(text, "");
                continue;
            }
            let wanted = format!("{x}");
            assert_eq!(text.parse::<f64>().unwrap().to_bits(), x.to_bits(), "{text} {wanted}");
            // All but the last digit are the same: no exponent, nothing behind a whole number.
            assert_eq!((text.len(), &text[..text.len() - 1]), (wanted.len(), &wanted[..wanted.len() - 1]));
        }
    }
}
