//! `residuals.csv`: one row per observation, units in the column names, '.' as decimal sign.

use crate::record::{Record, ResidualTable};
use std::io::Write;

/// First line of `residuals.csv`.
const HEADER: &str =
    "view,camera,column,row,level,feature,u_px,v_px,du_px,dv_px,normal_px,sigma_px,weight,outlier,reason";

/// The text of `residuals.csv`; `record` gives the cameras' names.
///
/// One row per observation, RFC 4180 quoting; a number that does not exist is an empty field, others are the shortest that read back to
/// the last bit. `outlier` is 0 or 1.
pub fn residuals_csv(record: &Record, table: &ResidualTable) -> String {
    let names: Vec<String> = record.cameras.iter().map(|c| csv_field(&c.name)).collect();
    let mut out = Vec::with_capacity(table.len() * 130 + HEADER.len() + 2);
    out.extend_from_slice(HEADER.as_bytes());
    out.push(b'\n');
    // What a row belongs to is that of many rows on end. Writing to memory does not fail.
    let (mut place, mut belongs) = (None, vec![]);
    for i in 0..table.len() {
        let Some(row) = table.row(i) else { break };
        let here = Some((row.view, row.camera, row.disc, row.kind));
        if place != here {
            place = here;
            let camera = names.get(row.camera).map_or("", String::as_str);
            let (d, kind) = (row.disc, row.kind.word());
            belongs.clear();
            let _ = write!(belongs, "{},{camera},{},{},{},{kind}", row.view, d.column, d.row, d.level);
        }
        out.extend_from_slice(&belongs);
        for x in [row.u_px, row.v_px, row.du_px, row.dv_px, row.normal_px, row.sigma_px, row.weight] {
            out.push(b',');
            push_number(&mut out, x);
        }
        match table.outlier(i) {
            None => out.extend_from_slice(b",0,\n"),
            Some(reason) => {
                let _ = writeln!(out, ",1,{}", csv_field(reason));
            }
        }
    }
    // Only text went in.
    String::from_utf8(out).unwrap_or_default()
}

/// What `{x}` gives, nothing for what is no number. `serde_json` finds the same digits five times faster, but writes an exponent for what is
/// small or large and `.0` behind whole numbers.
fn push_number(out: &mut Vec<u8>, x: f64) {
    if !x.is_finite() {
        return;
    }
    if !(1e-5..1e15).contains(&x.abs()) || serde_json::to_writer(&mut *out, &x).is_err() {
        let _ = write!(out, "{x}");
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
    fn numbers_are_those_of_the_standard_library() {
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
            let wanted = if x.is_finite() { format!("{x}") } else { String::new() };
            assert_eq!(written(x), wanted);
        }
    }
}
