//! Images that show too little or too much light: what is said of them.

use crate::detect::pattern::label_discs;
use crate::detect::{DetectOptions, Detection, LabelledDisc, find_discs};
use crate::error::{Error, Insufficient};
use crate::image::{GrayView, Samples};
use crate::rig_file::TargetDescription;
use crate::target::Polarity;

/// An image whose grey values span no more than this part of their type's range shows nothing.
const FLAT: f32 = 0.02;
/// Surroundings of a disc in which saturation is counted, semi-axes.
const ABOUT_DISC: f64 = 1.25;
/// Of so many rows one is looked at.
const ROW_STEP: usize = 4;

/// Says more of an image without its discs, where more can be said: that it is flat, or that the polarity is the other one.
pub(super) fn explained(e: Error, target: &TargetDescription, name: &str, view: &GrayView<'_>) -> Error {
    let Error::Insufficient(Insufficient::TooFewDiscs { image, found, needed, hint }) = e else { return e };
    let [low, high] = view.range();
    let full = match view.samples() {
        Samples::U8(_) => 255.0,
        Samples::U16(_) => 65_535.0,
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
    let hint = if high - low <= FLAT * full {
        format!(
            "all its grey values lie between {low} and {high}: nothing is to be seen in it; check light, shutter and the file"
        )
    } else if let Some((word, _)) = other.filter(|(_, p)| shows(*p)) {
        format!("its discs are found with polarity = \"{word}\": write that into [target]")
    } else {
        hint
    };
    Insufficient::TooFewDiscs { image, found, needed, hint }.into()
}

/// Part of the pixels within 1.25 semi-axes of the discs whose grey value is the largest there, where that may be the end of a scale.
///
/// Every fourth row is looked at.
pub(super) fn saturated_about(view: &GrayView<'_>, detection: &Detection, discs: &[LabelledDisc]) -> f64 {
    let (mut high, mut equal, mut all) = (f32::NEG_INFINITY, 0usize, 0usize);
    for d in discs {
        let e = &detection.discs[d.disc].ellipse;
        let reach = ABOUT_DISC * e.semi_major_px;
        let span = |middle: f64, size: usize| {
            let from = (middle - reach).max(0.0) as usize;
            from..((middle + reach + 1.0).max(0.0) as usize).min(size)
        };
        for v in span(e.center_px.v_px, view.height()).step_by(ROW_STEP) {
            let columns = span(e.center_px.u_px, view.width());
            all += columns.len();
            for grey in columns.map(|u| view.get(u, v)) {
                if grey > high {
                    (high, equal) = (grey, 1);
                } else if grey == high {
                    equal += 1;
                }
            }
        }
    }
    if view.may_saturate_at(high) { equal as f64 / all.max(1) as f64 } else { 0.0 }
}
