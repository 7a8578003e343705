//! Images that show too little or too much light: what is said of them.

use crate::detect::pattern::label_discs;
use crate::detect::{DetectOptions, Disc, find_discs, noise};
use crate::error::{Error, Insufficient};
use crate::image::{GrayView, Samples};
use crate::rig_file::TargetDescription;
use crate::target::Polarity;
use std::ops::Range;

/// An image whose grey values span no more than this part of the range its camera uses, or so many times its noise, shows nothing.
const FLAT: f32 = 0.02;
const FLAT_SIGMAS: f32 = 12.0;
/// Surroundings of a disc in which saturation is counted, semi-axes.
const ABOUT_DISC: f64 = 1.25;
/// Of so many rows one is looked at.
pub(super) const ROW_STEP: usize = 4;

/// Says more of an image without its discs, where more can be said: that it is flat, or that the polarity is the other one.
pub(super) fn explained(e: Error, target: &TargetDescription, name: &str, view: &GrayView<'_>) -> Error {
    let Error::Insufficient(Insufficient::TooFewDiscs { image, found, needed, hint }) = e else { return e };
    let [low, high] = view.range();
    // Files of 16 bit hold levels of 10 or 12 bit, too.
    let full = match view.samples() {
        Samples::U8(_) => 255.0,
        Samples::U16(_) => {
            (8..16).map(|bits| ((1_u32 << bits) - 1) as f32).find(|end| high <= *end).unwrap_or(65_535.0)
        }
        Samples::F32(_) => high.abs(),
    };
    let other = match target.polarity {
        Polarity::Bright => Some(("dark", Polarity::Dark)),
        Polarity::Dark => Some(("bright", Polarity::Bright)),
        Polarity::Auto => None,
    };
    let shows = |polarity: Polarity| {
        let options = DetectOptions { polarity, ..DetectOptions::default() };
        find_discs(view, &options).is_ok_and(|d| label_discs(name, &d, &target.target).is_ok())
    };
    let hint = if let Some((word, _)) = other.filter(|(_, p)| shows(*p)) {
        format!("its discs are found with polarity = \"{word}\": write that into [target]")
    } else if high - low <= (FLAT * full).max(FLAT_SIGMAS * noise(view)) {
        format!(
            "all its grey values lie between {low} and {high}: nothing is to be seen in it; check light, shutter and the file"
        )
    } else {
        hint
    };
    Insufficient::TooFewDiscs { image, found, needed, hint }.into()
}

/// Part of the pixels within 1.25 semi-axes of discs whose grey value is the largest there, where that may be the end of a scale.
///
/// Every fourth row is looked at.
pub fn saturated_about<'a>(view: &GrayView<'_>, discs: impl Iterator<Item = &'a Disc>) -> f64 {
    let mut rows = Vec::new();
    for e in discs.map(|d| &d.ellipse) {
        let reach = ABOUT_DISC * e.semi_major_px;
        let columns = span(e.center_px.u_px, reach, view.width());
        let row = |v: usize| v * view.stride() + columns.start..v * view.stride() + columns.end;
        rows.extend(span(e.center_px.v_px, reach, view.height()).step_by(ROW_STEP).map(row));
    }
    let (high, equal) = match view.samples() {
        Samples::U8(s) => of_the_brightest(s, &rows, u8::MIN),
        Samples::U16(s) => of_the_brightest(s, &rows, u16::MIN),
        Samples::F32(s) => of_the_brightest(s, &rows, f32::NEG_INFINITY),
    };
    let all: usize = rows.iter().map(Range::len).sum();
    if view.may_saturate_at(high) { equal as f64 / all.max(1) as f64 } else { 0.0 }
}

/// Rows or columns, of so many, as far as `reach` from one of them, px.
pub(super) fn span(middle: f64, reach: f64, size: usize) -> Range<usize> {
    let from = ((middle - reach).max(0.0) as usize).min(size);
    from..((middle + reach + 1.0).max(0.0) as usize).clamp(from, size)
}

/// The largest of the samples, at least `low`, and how many of them it is.
fn of_the_brightest<S: Copy + PartialOrd + Into<f32>>(samples: &[S], rows: &[Range<usize>], low: S) -> (f32, usize) {
    let larger = |high: S, x: &S| if *x > high { *x } else { high };
    let high = rows.iter().fold(low, |high, row| samples[row.clone()].iter().fold(high, larger));
    let equal = rows.iter().map(|row| samples[row.clone()].iter().filter(|x| **x == high).count()).sum();
    (high.into(), equal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brightest_samples_are_counted_where_rows_say() {
        let samples = [9_u8, 7, 3, 8, 8, 2, 8, 9, 1];
        assert_eq!(of_the_brightest(&samples, &[1..4, 4..7], 0), (8.0, 3));
        assert_eq!(of_the_brightest(&samples, &[3..3, 0..0], 0), (0.0, 0));
        let floats = [0.5_f32, f32::NAN, 2.5, 2.5];
        assert_eq!(of_the_brightest(&floats, &[0..2, 2..4], f32::NEG_INFINITY), (2.5, 2));
    }
}
