//! Candidates that are no discs, and why, in words.

use crate::conic::Ellipse;
use crate::detect::candidate::Candidate;
use crate::detect::quick::contour_of;
use crate::frames::Pixel;
use crate::image::GrayView;
use std::collections::BTreeMap;
use std::fmt;

/// Why a closed contour is not a disc.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum RejectionReason {
    /// It touches the border of the image.
    CutByBorder,
    /// Contour and ellipse differ too much, or the fit does not stay where the contour is.
    NotElliptical {
        /// Root mean square distance of the contour from its ellipse, or of the ellipse fitted from that of the contour, px.
        rms_px: f64,
        /// The limit that it exceeds, px.
        limit_px: f64,
    },
    /// Two discs that touch or overlap.
    Overlapping,
    /// Minor semi-axis below the smallest that can be measured.
    TooSmall {
        /// Minor semi-axis, px; 0 where it does not show beside the blur.
        semi_minor_px: f64,
    },
    /// Contrast too close to the noise.
    LowContrast {
        /// Grey step over the standard deviation of the noise.
        contrast_to_noise: f64,
    },
    /// Part of the contour is hidden (glare, shadow, another object).
    Incomplete {
        /// Part of the contour that was seen, 0 to 1.
        coverage: f64,
    },
    /// No grey level lies between those of disc and ground: the image was made black and white, and its contour is steps of whole pixels.
    NoGreyLevels,
    /// A disc, but dark where the image's discs are bright, or bright where they are dark.
    OtherPolarity,
    /// An ellipse that is slimmer than a disc that is worth measuring: seen too obliquely.
    TooSlim {
        /// Minor over major semi-axis.
        axis_ratio: f64,
        /// The least that is accepted.
        least: f64,
    },
}

impl RejectionReason {
    /// In two or three words that can be counted.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::CutByBorder => "cut by the border",
            Self::NotElliptical { .. } => "not elliptical",
            Self::Overlapping => "touching another disc",
            Self::TooSmall { .. } => "too small",
            Self::LowContrast { .. } => "too faint",
            Self::Incomplete { .. } => "partly hidden",
            Self::NoGreyLevels => "without grey levels at the rim",
            Self::OtherPolarity => "of the other polarity",
            Self::TooSlim { .. } => "too slim",
        }
    }
}

impl fmt::Display for RejectionReason {
    /// With its numbers.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind())?;
        match self {
            Self::NotElliptical { rms_px, limit_px } if !rms_px.is_finite() => {
                write!(f, ": no ellipse fits, or none is known to {limit_px:.2} px")
            }
            Self::NotElliptical { rms_px, limit_px } => {
                write!(f, ": {rms_px:.2} px from its ellipse, at most {limit_px:.2}")
            }
            Self::TooSmall { semi_minor_px: 0.0 } => f.write_str(": its size does not show beside its blur"),
            Self::TooSmall { semi_minor_px } => write!(f, ": minor semi-axis {semi_minor_px:.1} px"),
            Self::LowContrast { contrast_to_noise } => {
                write!(f, " (among brighter discs, or for the noise): {contrast_to_noise:.1} times the noise")
            }
            Self::Incomplete { coverage } => write!(f, ": {:.0} % of its contour seen", 100.0 * coverage),
            Self::NoGreyLevels => f.write_str(": the image was made black and white"),
            Self::TooSlim { axis_ratio, least } => write!(
                f,
                ": axis ratio {axis_ratio:.3}, at least {least:.3}, as a disc seen {:.0} degrees off its normal has",
                least.acos().to_degrees()
            ),
            Self::CutByBorder | Self::Overlapping | Self::OtherPolarity => Ok(()),
        }
    }
}

/// A candidate that was turned down.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejection {
    /// Where it is, px.
    pub center_px: Pixel,
    /// Its size: square root of area / pi, px.
    pub radius_px: f64,
    /// Why.
    pub reason: RejectionReason,
}

/// The reason as it is told: edges between pixels of two levels alone look hidden, bent or too sharp to each test in turn, and of a spot that is hardly more
/// than its blur no ellipse is left.
pub(crate) fn told(reason: RejectionReason, view: &GrayView<'_>, candidate: &Candidate) -> RejectionReason {
    use RejectionReason as R;
    let by_edge = matches!(
        reason,
        R::NotElliptical { .. } | R::Incomplete { .. } | R::LowContrast { .. } | R::TooSmall { semi_minor_px: 0.0 }
    );
    match reason {
        _ if by_edge && two_levels(view, &candidate.ellipse) => R::NoGreyLevels,
        R::NotElliptical { rms_px, .. } if !rms_px.is_finite() && is_spot(candidate) => {
            R::TooSmall { semi_minor_px: 0.0 }
        }
        _ => reason,
    }
}

/// Minor semi-axis of what the line of a spot without any size looks like, in blurs.
const SPOT: f64 = 2.3;

/// Whether a candidate may be a spot of the size of its blur.
fn is_spot(candidate: &Candidate) -> bool {
    let (contour, blur_px) = contour_of(&candidate.ellipse, candidate.blur_px);
    candidate.level == 0 && contour.semi_minor_px < SPOT * blur_px
}

/// Whether the pixels about an ellipse have two grey levels alone.
fn two_levels(view: &GrayView<'_>, around: &Ellipse) -> bool {
    let reach = around.semi_major_px + 2.0;
    let range = |middle: f64, n: usize| (middle - reach).max(0.0) as usize..((middle + reach).max(0.0) as usize).min(n);
    let (us, vs) = (range(around.center_px.u_px, view.width()), range(around.center_px.v_px, view.height()));
    let mut levels: Vec<f32> = vec![];
    for (u, v) in vs.flat_map(|v| us.clone().map(move |u| (u, v))) {
        let g = view.get(u, v);
        if !levels.contains(&g) {
            levels.push(g);
        }
        if levels.len() > 2 {
            return false;
        }
    }
    levels.len() == 2
}

/// How many were turned down, by [`RejectionReason::kind`].
#[must_use]
pub fn counted(rejections: &[Rejection]) -> BTreeMap<&'static str, usize> {
    let mut out = BTreeMap::new();
    rejections.iter().for_each(|r| *out.entry(r.reason.kind()).or_insert(0) += 1);
    out
}

/// The same in a line; empty where none was.
#[must_use]
pub fn counted_words(rejections: &[Rejection]) -> String {
    let words: Vec<String> = counted(rejections).iter().map(|(why, n)| format!("{n} {why}")).collect();
    let advice = match rejections.iter().any(|r| r.reason == RejectionReason::NoGreyLevels) {
        true => "; give images as the camera took them, not made black and white",
        false => "",
    };
    words.join(", ") + advice
}

/// The same where the discs that were looked for are missing, with what to do; empty where nothing was turned down.
#[must_use]
pub fn missing_words(rejections: &[Rejection]) -> String {
    let slim = rejections.iter().any(|r| matches!(r.reason, RejectionReason::TooSlim { .. }));
    let advice = if slim { "; turn the target more towards this camera, or leave the view out" } else { "" };
    counted_words(rejections) + advice
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::detect::{DetectOptions, find_discs};
    use crate::image::Samples;

    #[test]
    fn candidates_are_counted_and_advice_is_given_once() {
        let one = |reason| Rejection { center_px: Pixel { u_px: 1.0, v_px: 2.0 }, radius_px: 3.0, reason };
        let all =
            [one(RejectionReason::NoGreyLevels), one(RejectionReason::CutByBorder), one(RejectionReason::NoGreyLevels)];
        assert_eq!(
            counted_words(&all),
            "1 cut by the border, 2 without grey levels at the rim; give images as the camera took them, not made black and white"
        );
        assert_eq!((counted_words(&[]), counted(&all)["cut by the border"]), (String::new(), 1));
        let words = RejectionReason::TooSmall { semi_minor_px: 2.06 }.to_string();
        assert_eq!(words, "too small: minor semi-axis 2.1 px");
    }

    /// Discs seen at 77 and 79 degrees: the limit is between, and what was turned down is told.
    #[test]
    fn discs_seen_too_obliquely_are_said_to_be_slim() {
        for (degrees, found) in [(77.0_f64, true), (79.0, false), (82.0, false)] {
            let (a, b) = (70.0, 70.0 * degrees.to_radians().cos());
            let size = 180;
            let grey: Vec<u8> = (0..size * size)
                .map(|i| {
                    let (x, y) = ((i % size) as f64 - 90.3, (i / size) as f64 - 88.7);
                    // To first order how far outside the ellipse, px.
                    let off =
                        ((x / a).hypot(y / b) - 1.0) * (x / a).hypot(y / b) / (x / a / a).hypot(y / b / b).max(1e-9);
                    let noise = ((i * 7919) % 101) as f64 / 101.0 - 0.5;
                    (40.0 + 160.0 / (1.0 + (-1.7 * off).exp()) + 3.0 * noise) as u8
                })
                .collect();
            let view = GrayView::new(Samples::U8(&grey), size, size, size).expect("an image");
            let all = find_discs(&view, &DetectOptions::default()).expect("a search");
            assert_eq!(all.discs.len(), usize::from(found), "{degrees}: {:?}", all.rejections);
            assert_eq!(counted_words(&all.rejections), if found { "" } else { "1 too slim" }, "{degrees}");
            assert_eq!(missing_words(&all.rejections).contains("; turn the target more towards this camera"), !found);
            if let Some(told) = all.rejections.first() {
                let words = told.reason.to_string();
                assert!(words.contains("at least 0.200") && words.contains("78 degrees off"), "{words}");
            }
        }
    }

    /// Spots without any size are too small, not bent; a dot of 1.5 px behind a blur of 1 px is one.
    #[test]
    fn spots_of_the_size_of_their_blur_are_called_too_small() {
        for (radius_px, blur_px, found) in [(0.0, 0.8, false), (0.0, 1.2, false), (1.0, 0.8, false), (1.5, 1.0, true)] {
            let grey = spot(radius_px, blur_px);
            let view = GrayView::new(Samples::U16(&grey), SIZE, SIZE, SIZE).expect("an image");
            let all = find_discs(&view, &DetectOptions::default()).expect("a search");
            let told: Vec<String> = all.rejections.iter().map(|r| r.reason.to_string()).collect();
            assert_eq!(all.discs.len(), usize::from(found), "{radius_px} behind {blur_px}: {told:?}");
            let wanted: &[&str] = if found { &[] } else { &["too small: its size does not show beside its blur"] };
            assert_eq!(told, wanted, "{radius_px} behind {blur_px}");
        }
    }

    const SIZE: usize = 60;

    /// A bright disc behind a blur, both in px, of 2000 grey levels were it not blurred; noise of some three.
    fn spot(radius_px: f64, blur_px: f64) -> Vec<u16> {
        let steps = if radius_px > 0.0 { 15 } else { 0 };
        let along = |k: i32| radius_px * f64::from(k) / f64::from(steps.max(1));
        let all = (-steps..=steps).flat_map(|i| (-steps..=steps).map(move |j| (along(i), along(j))));
        let points: Vec<(f64, f64)> = all.filter(|(x, y)| x.hypot(*y) <= radius_px).collect();
        let grey = |u: usize, v: usize| {
            let far = |(x, y): &(f64, f64)| (u as f64 - 30.3 - x).powi(2) + (v as f64 - 29.8 - y).powi(2);
            let sum: f64 = points.iter().map(|p| (-far(p) / (2.0 * blur_px * blur_px)).exp()).sum();
            let noise = ((u * 7919 + v * 104_729) % 1013) as f64 / 1013.0 - 0.5;
            (100.0 + 12.0 * noise + 2000.0 * sum / points.len() as f64) as u16
        };
        (0..SIZE * SIZE).map(|i| grey(i % SIZE, i / SIZE)).collect()
    }
}
