//! Planar displacements from dewarped particle images, for `spivcal reconstruct`.
//!
//!     cargo run --release --example planar_displacements -- DEWARPED left left.csv p01a_left p01b_left
//!     cargo run --release --example planar_displacements -- --window 48 --step 24 DEWARPED left left.csv p01a_left p01b_left p02a_left p02b_left
//!
//! `DEWARPED` is the folder of `spivcal dewarp`; then the camera, the CSV file to be written (mm in the sheet, y up), and the names of the raw
//! images, first and second exposure by turns. Several pairs give one field by ensemble correlation (of a flow that is steady). Any program of
//! planar PIV may take its place: `spivcal reconstruct` reads the exports of OpenPIV and PIVlab.

#![allow(clippy::print_stdout, clippy::print_stderr)]

use serde_json::Value;
use spivcal::dewarp::SheetGrid;
use spivcal::disparity::{PlanarOptions, planar_displacements};
use spivcal::image::{GrayImage, Pixels};
use spivcal::pipeline::{Output, load_image, read_text};
use std::error::Error;
use std::fmt::Write;
use std::path::Path;

struct Arguments {
    options: PlanarOptions,
    folder: String,
    camera: String,
    out: String,
    images: Vec<String>,
}

fn arguments(mut words: impl Iterator<Item = String>) -> Result<Arguments, Box<dyn Error>> {
    let mut options = PlanarOptions::default();
    let mut rest = vec![];
    while let Some(word) = words.next() {
        let mut number = || -> Result<usize, Box<dyn Error>> {
            let value = words.next().ok_or_else(|| format!("{word} needs a number of px"))?;
            Ok(value.parse().map_err(|_| format!("{word}: \"{value}\" is no whole number"))?)
        };
        match word.as_str() {
            "--window" => options.window_px = number()?,
            "--step" => options.step_px = number()?,
            option if option.starts_with('-') => return Err(format!("unknown option {option}").into()),
            _ => rest.push(word),
        }
    }
    let mut rest = rest.into_iter();
    let (Some(folder), Some(camera), Some(out)) = (rest.next(), rest.next(), rest.next()) else {
        return Err("expected [--window PX] [--step PX] DEWARPED CAMERA OUT.csv FIRST SECOND [FIRST SECOND ...]".into());
    };
    let images: Vec<String> = rest.collect();
    if images.is_empty() || !images.len().is_multiple_of(2) {
        return Err(format!("{} images: expected first and second exposure by turns", images.len()).into());
    }
    Ok(Arguments { options, folder, camera, out, images })
}

fn main() -> Result<(), Box<dyn Error>> {
    println!("{}", run(std::env::args().skip(1))?);
    Ok(())
}

/// Writes the field and says what it is.
pub(crate) fn run(words: impl Iterator<Item = String>) -> Result<String, Box<dyn Error>> {
    let a = arguments(words)?;
    let folder = Path::new(&a.folder);
    let dewarped: Value =
        serde_json::from_str(&read_text(&folder.join("dewarp.json"), "the dewarp.json of spivcal dewarp")?)?;
    let grid: SheetGrid = serde_json::from_value(dewarped["grid"].clone())?;
    let mask = load_image(&folder.join(format!("mask_{}.tif", a.camera)))?;
    let seen: Vec<bool> = match mask.pixels() {
        Pixels::U8(p) => p.iter().map(|x| *x > 0).collect(),
        _ => return Err("the mask is not of 8 bit; let spivcal dewarp write it again".into()),
    };
    let load = |name: &String| load_image(&folder.join(format!("{name}_dewarped.tif")));
    let images: Vec<GrayImage> = a.images.iter().map(load).collect::<Result<_, _>>()?;
    let pairs: Vec<_> = images.chunks_exact(2).map(|p| [p[0].view(), p[1].view()]).collect();
    let field = planar_displacements(&pairs, &seen, &a.options)?;
    let mut text = String::from("x_mm,y_mm,dx_mm,dy_mm,sigma_dx_mm,sigma_dy_mm\n");
    let number = |x: f64| if x.is_finite() { format!("{x:.7}") } else { "nan".into() };
    for k in 0..field.x_px.len() {
        let [x, y] = grid.point_mm(field.x_px[k], field.y_px[k]);
        let (dx, dy) = (grid.mm_per_px * field.dx_px[k], -grid.mm_per_px * field.dy_px[k]);
        let [sx, sy] = field.sigma_px.each_ref().map(|s| number(grid.mm_per_px * s[k]));
        writeln!(text, "{x:.6},{y:.6},{},{},{sx},{sy}", number(dx), number(dy))?;
    }
    let out = Path::new(&a.out);
    let name = out.file_name().ok_or("OUT.csv is no name of a file")?.to_string_lossy();
    let mut output = Output::default();
    output.add(name, text);
    output.commit(out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")))?;
    let good = field.dx_px.iter().filter(|d| d.is_finite()).count();
    Ok(format!(
        "{}: {good} of {} vectors, windows of {} px ({:.2} mm), {:.2} mm apart",
        a.out,
        field.dx_px.len(),
        a.options.window_px,
        a.options.window_px as f64 * grid.mm_per_px,
        a.options.step_px as f64 * grid.mm_per_px
    ))
}
