//! Rigs drawn at random, rendered, found in their images and calibrated from what an experimenter would know, compared with the truth.

#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, unreachable_pub)]

#[path = "../joint/mod.rs"]
mod joint;
#[path = "../render/mod.rs"]
mod render;

use joint::try_calibrated;
use render::Random;
use spivcal::pipeline::CalibrateOptions;
use spivcal::record::Record;
use spivcal::report::{Level, verdict};
use spivcal::simulate::Scene;

use std::fmt::Write;

/// What is held into the sheet.
pub const KINDS: [&str; 6] =
    ["two discs", "bubbles", "marked grid", "unmarked grid", "estimated grid", "two-level plate"];

/// Numbers of uneven size.
struct Draw(Random);

impl Draw {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.uniform()
    }
    fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[((self.0.uniform() * list.len() as f64) as usize).min(list.len() - 1)]
    }
    fn count(&mut self, low: usize, high: usize) -> usize {
        low + ((self.0.uniform() * (high - low + 1) as f64) as usize).min(high - low)
    }
}

/// What a field of view holds.
struct Field {
    /// Width and height on the sheet, mm.
    wide_mm: f64,
    high_mm: f64,
    /// Angle of either camera to the sheet's normal, degrees.
    half_deg: f64,
}

/// The scene of a seed: lenses of 25 to 105 mm, 6 to 16 of their focal lengths away, 36 to 96 degrees between the cameras, with and without tilted sensors, k1 within
/// 0.25, targets of all kinds, light, blur and noise of all kinds.
pub fn scene(seed: u64, kind: &str) -> String {
    let mut d = Draw(Random(1000 + seed));
    let mut text = format!("seed = {seed}\n");
    let field = cameras(&mut d, &mut text);
    let [x, y] = [d.between(-2.0, 2.0), d.between(-2.0, 2.0)];
    let offset = d.between(-0.01, 0.01) * field.wide_mm;
    writeln!(text, "[sheet]\noffset_mm = {offset:.3}\ntilt_deg = [{x:.2}, {y:.2}]").unwrap();
    let smoke = match kind {
        "two discs" => pair(&mut d, &field, &mut text),
        "bubbles" => bubbles(&mut d, &field, &mut text),
        "two-level plate" => plate(&mut d, &field, &mut text),
        _ => grid(&mut d, &field, kind, &mut text),
    };
    let [blur, uneven] = [d.between(0.5, 1.8), d.between(0.0, 0.4)];
    let (bits, well, read) = (d.of(&[8, 12]), d.of(&[8000, 15_000, 30_000]), d.of(&[8, 15, 25]));
    writeln!(
        text,
        "[image]\nblur_sigma_px = {blur:.2}\nbits = {bits}\nunevenness = {uneven:.2}\nfull_well_e = {well}\nread_noise_e = {read}\n{smoke}"
    )
    .unwrap();
    let scale = if kind == "bubbles" { "view-spacing" } else { "target" };
    let adjust = if kind == "estimated grid" { "adjust = \"points\"\n" } else { "" };
    writeln!(text, "[rig]\nscale = \"{scale}\"\nestimate = [\"k1\"]\n{adjust}").unwrap();
    text
}

fn cameras(d: &mut Draw, text: &mut String) -> Field {
    let wide = d.of(&[640, 800, 1024]);
    let size_px = [wide, (wide as f64 * d.of(&[0.75, 0.8, 1.0])) as usize];
    let (pitch_mm, lens_mm) = (d.of(&[0.0045, 0.0055, 0.0065, 0.0074]), d.of(&[25.0, 35.0, 50.0, 60.0, 85.0, 105.0]));
    let distance_mm = lens_mm * d.between(6.0, 16.0);
    let half_deg = d.between(18.0, 48.0);
    let tilted = d.0.uniform() < 0.7;
    for (name, side) in [("left", -1.0), ("right", 1.0)] {
        // As the prior on the axis point says, but within 1.5 of its standard deviations, so that targets are in view.
        let [u, v] = [0, 1].map(|_| d.0.normal().clamp(-1.5, 1.5) * 0.1 * wide as f64);
        let [cx, cy] = [0.5 * size_px[0] as f64 + u, 0.5 * size_px[1] as f64 + v];
        let [k1, near, angle] = [d.between(-0.25, 0.25), d.between(0.95, 1.05), d.between(-5.0, 5.0)];
        let [up, roll] = [d.between(-8.0, 8.0), d.between(-4.0, 4.0)];
        writeln!(
            text,
            "[[camera]]\nname = \"{name}\"\nimage_size_px = {size_px:?}\npixel_pitch_mm = {pitch_mm}\nfocal_length_mm = {lens_mm:.1}\n\
             scheimpflug = {tilted}\nk = [{k1:.4}, 0.0, 0.0]\naxis_point_px = [{cx:.1}, {cy:.1}]\naim = {{ distance_mm = {:.1}, \
             viewing_angle_deg = {:.2}, elevation_deg = {up:.2}, roll_deg = {roll:.2} }}",
            near * distance_mm,
            side * half_deg + angle
        )
        .unwrap();
    }
    let wide_mm = wide as f64 * pitch_mm * distance_mm / lens_mm;
    Field { high_mm: wide_mm * size_px[1] as f64 / wide as f64, wide_mm, half_deg }
}

/// Views by hand and the last one in the sheet; nothing is seen more than some 72 degrees off its normal.
fn views(d: &mut Draw, field: &Field, (few, many): (usize, usize), spin_deg: f64, most_deg: f64) -> String {
    let (count, tilt) = (d.count(few, many), most_deg.min(67.0 - field.half_deg));
    let at = [0.08, 0.07, 0.05].map(|part| part * field.wide_mm);
    format!(
        "[random]\ncount = {count}\nsheet_count = 1\ntilt_deg = [{tilt:.1}, {tilt:.1}]\nspin_deg = {spin_deg}\nposition_mm = [{:.2}, {:.2}, {:.2}]\n",
        at[0], at[1], at[2]
    )
}

fn polarity(d: &mut Draw) -> &'static str {
    d.of(&["bright", "dark"])
}

fn pair(d: &mut Draw, field: &Field, text: &mut String) -> String {
    let r = 0.13 * field.high_mm;
    let [other, spacing] = [d.between(0.6, 0.85) * r, d.between(2.0, 2.5) * r];
    let polarity = polarity(d);
    writeln!(
        text,
        "[target]\nkind = \"two-discs\"\npolarity = \"{polarity}\"\nradii_mm = [{r:.3}, {other:.3}]\nspacing_mm = {spacing:.3}"
    )
    .unwrap();
    *text += &views(d, field, (5, 9), 180.0, 26.0);
    String::new()
}

fn bubbles(d: &mut Draw, field: &Field, text: &mut String) -> String {
    let r = 0.13 * field.high_mm;
    *text += "[target]\nkind = \"bubbles\"\npolarity = \"bright\"\n";
    let radii = [0.7, 1.0, 0.4, 0.7].map(|x| x * r);
    *text += &views(d, field, (7, 10), 180.0, 26.0);
    writeln!(
        text,
        "radii_mm = [[{:.3}, {:.3}], [{:.3}, {:.3}]]\nspacing_mm = [{:.3}, {:.3}]",
        radii[0],
        radii[1],
        radii[2],
        radii[3],
        1.9 * r,
        2.5 * r
    )
    .unwrap();
    format!("smoke = {:.2}\nsmoke_length_mm = {:.3}", d.between(0.0, 0.4), d.between(0.3, 0.8) * r)
}

fn grid(d: &mut Draw, field: &Field, kind: &str, text: &mut String) -> String {
    let (columns, rows) = (d.count(7, 14), d.count(6, 11));
    let pitch = 0.62 * (field.wide_mm / columns as f64).min(field.high_mm / rows as f64);
    let radius = d.between(0.18, 0.3) * pitch;
    let polarity = polarity(d);
    writeln!(
        text,
        "[target]\nkind = \"dot-grid\"\npolarity = \"{polarity}\"\nspacing_mm = {pitch:.3}\nradius_mm = {radius:.3}\ncolumns = {columns}\nrows = {rows}\n\
         origin = [{}, {}]",
        columns / 2,
        rows / 2
    )
    .unwrap();
    match kind {
        "marked grid" => {
            *text += "marks = [ { kind = \"large\", column = 0, row = 0 }, { kind = \"large\", column = 1, row = 0 }, { kind = \"large\", column = 0, row = 2 } ]\n";
        }
        "estimated grid" => writeln!(text, "print_error_um = {:.1}", 4.0 * pitch).unwrap(),
        _ => {}
    }
    let spin = d.of(&[20.0, 180.0]);
    *text += &views(d, field, (4, 7), spin, 26.0);
    String::new()
}

fn plate(d: &mut Draw, field: &Field, text: &mut String) -> String {
    let (columns, rows) = (d.count(5, 7), d.count(4, 6));
    let pitch = 0.62 * (field.wide_mm / columns as f64).min(field.high_mm / rows as f64);
    let [radius, step] = [d.between(0.14, 0.2) * pitch, d.between(0.05, 0.12) * pitch];
    writeln!(
        text,
        "[target]\nkind = \"two-level-plate\"\npolarity = \"bright\"\nspacing_mm = {pitch:.3}\nradius_mm = {radius:.3}\ncolumns = {columns}\nrows = {rows}\n\
         origin = [{}, {}]\nstep_mm = {step:.4}\nmarks = [ {{ kind = \"square\", column = 1, row = 0, level = 0 }}, {{ kind = \"triangle\", column = 0, row = 1, \
         level = 0 }} ]",
        columns / 2,
        rows / 2
    )
    .unwrap();
    *text += &views(d, field, (4, 6), 15.0, 15.0);
    String::new()
}

/// What came out of one rig.
pub struct Outcome {
    /// Errors of what a user relies on over their standard deviations.
    pub z: Vec<f64>,
    /// How many of them the record's intervals of 95 % leave out.
    pub outside: usize,
    /// Flags that say something is wrong with images, views or model.
    pub alarms: Vec<String>,
}

/// Words of flags that find fault; that something is not determined, or that more views would help, is no fault.
const FAULTS: [&str; 5] = [
    "contradicts the others",
    "differ by more than their noise",
    "the images ask for",
    "the dots lie",
    "standard deviations apart",
];

/// [`NUMBERS`] of a record and their standard deviations.
fn numbers(r: &Record) -> (Vec<f64>, Vec<f64>) {
    let (rig, sheet) = (r.rig.as_ref().unwrap(), r.sheet.as_ref().unwrap());
    let of_cameras = r.cameras.iter().flat_map(|c| {
        let (own, s) = (&c.effective, &c.sigma.effective);
        [(own.f_px, s.f_px), (own.cx_px, s.cx_px), (own.cy_px, s.cy_px)]
    });
    let others = [
        (rig.baseline_mm, rig.sigma.baseline_mm),
        (rig.axes_angle_deg, rig.sigma.axes_angle_deg),
        (sheet.distance_mm, sheet.sigma.distance_mm),
        (sheet.angle_to_baseline_deg, sheet.sigma.angle_to_baseline_deg),
    ];
    of_cameras.chain(others).unzip()
}

fn outcome(record: &Record, truth: &Record) -> Outcome {
    let [(mut own, sigmas), (wanted, _)] = [record, truth].map(numbers);
    let keys = &record.fit.diagnosis.as_ref().unwrap().key_quantities;
    let outside = keys.iter().zip(&wanted).filter(|(key, x)| {
        let [low, high] = key.interval_95.unwrap_or_default();
        low.is_some_and(|low| **x < low) || high.is_some_and(|high| **x > high)
    });
    let outside = outside.count();
    own.iter_mut().zip(&wanted).zip(&sigmas).for_each(|((own, at), sigma)| *own = (*own - at) / sigma);
    let fault = |f: &&String| FAULTS.iter().any(|w| f.contains(w));
    let mut alarms: Vec<String> = record.fit.flags.iter().filter(fault).cloned().collect();
    let verdict = verdict(record);
    alarms.extend((verdict.level == Level::Bad).then_some(verdict.headline));
    Outcome { z: own, outside, alarms }
}

/// What are the numbers of [`Outcome::z`], as the first of the key quantities.
pub const NUMBERS: [&str; 10] = [
    "effective f, left",
    "effective cx, left",
    "effective cy, left",
    "effective f, right",
    "effective cx, right",
    "effective cy, right",
    "distance of the cameras",
    "angle between the lens axes",
    "distance of the sheet",
    "angle of the sheet to the baseline",
];

/// Renders and calibrates a scene; what was refused in words.
pub fn run(scene: &str) -> Result<Outcome, String> {
    let scene = Scene::parse(scene, "scene.toml").map_err(|e| format!("scene: {e}"))?;
    let (record, truth) = try_calibrated(&scene, &CalibrateOptions::default()).map_err(|e| e.to_string())?;
    Ok(outcome(&record, &truth))
}
