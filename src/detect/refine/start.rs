//! What is known of a disc before it is refined.

use crate::conic::Ellipse;
use crate::detect::candidate::Candidate;
use crate::detect::correlation::NoiseCorrelation;
use crate::detect::exact::is_large;
use crate::detect::quick::contour_of;
use crate::detect::shape::Shape;
use crate::detect::shape::told::Told;
use crate::detect::shot_noise::ShotNoise;
use nalgebra::Matrix4;
use std::sync::OnceLock;

/// A disc to refine.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start<'a> {
    pub(crate) ellipse: Ellipse,
    pub(crate) blur_px: f64,
    pub(crate) bright: bool,
    /// Inside minus outside, roughly, grey, positive.
    pub(crate) contrast: f64,
    /// How far the band may reach inwards without meeting another edge, px.
    pub(crate) inner_px: f64,
    /// Other edges around.
    pub(crate) neighbours: &'a [Ellipse],
    /// Gradients of the light inside and outside that the discs around tell, grey/px along u and v.
    pub(crate) slopes: [[f64; 2]; 2],
    /// What the noise of neighbouring pixels has in common.
    pub(crate) noise: &'a NoiseCorrelation,
    /// The level of the pyramid in which the line of the ellipse was followed; 0 are the pixels of the image themselves.
    pub(crate) level: u32,
    /// Noise variance of a pixel of the image, roughly, grey^2.
    pub(crate) variance: f64,
    /// Smallest variance that its samples can have, grey^2.
    pub(crate) quantisation: f64,
    /// Whether noise hardly moved that line.
    pub(crate) clear: bool,
    /// What the discs around tell of the noise inside.
    pub(crate) shot_noise: Option<ShotNoise>,
    /// Whether a random field of light may be fitted, which takes thousands of times as long as a clean disc.
    pub(crate) smoke: bool,
    /// Whether it is known to have one.
    pub(crate) full_of_smoke: bool,
    /// Whether it is known to be printed, without any.
    pub(crate) printed: bool,
    /// The shape of the blur, as all discs tell it, by what part it is wider along the image than across, and how well they know both.
    pub(crate) shape: Shape,
    pub(crate) stretch: [f64; 2],
    pub(crate) shape_covariance: Matrix4<f64>,
    /// Whether it is fitted for what it says of these, or of noise, alone; or where to put what it says of the blur by the way.
    pub(crate) asked: bool,
    pub(crate) tells: Option<&'a OnceLock<Box<Told>>>,
}

impl Start<'_> {
    /// Light inside minus outside, roughly, grey.
    pub(crate) fn step(&self) -> f64 {
        if self.bright { self.contrast } else { -self.contrast }
    }

    /// The same disc as another look at its line shows it.
    pub(crate) fn by(&self, line: &Candidate) -> Self {
        Self { ellipse: line.ellipse, blur_px: line.blur_px, contrast: line.contrast, ..*self }
    }

    /// The blur that the line shows, that of a Gaussian, px.
    pub(crate) fn line_blur_px(&self) -> f64 {
        Self { shape: Shape::GAUSSIAN, ..*self }.contour().1
    }

    /// Whether it may be full of smoke, which shines.
    pub(crate) fn may_be_full_of_smoke(&self) -> bool {
        self.smoke && self.bright && !self.printed
    }

    /// Whether the short way of clean discs is not for it: it may be full of smoke that looks like a slope, or is asked what that does not tell.
    pub(crate) fn goes_the_longer_way(&self) -> bool {
        self.full_of_smoke || (self.smoke || self.asked) && !is_large(&self.ellipse)
    }

    /// The ellipse and the blur that the line followed is that of.
    pub(super) fn contour(&self) -> (Ellipse, f64) {
        let scale = f64::from(1_u32 << self.level);
        let of_level = Ellipse {
            semi_major_px: self.ellipse.semi_major_px / scale,
            semi_minor_px: self.ellipse.semi_minor_px / scale,
            ..self.ellipse
        };
        let (e, blur_px) = contour_of(&of_level, self.blur_px / scale / self.shape.looks_wider());
        (
            Ellipse { semi_major_px: scale * e.semi_major_px, semi_minor_px: scale * e.semi_minor_px, ..e },
            scale * blur_px,
        )
    }
}

#[cfg(test)]
impl Start<'static> {
    /// A dark disc alone in white noise of one grey level, one hundred above it, for tests.
    pub(crate) fn alone(ellipse: Ellipse) -> Self {
        Self {
            ellipse,
            blur_px: 1.0,
            bright: false,
            contrast: 100.0,
            inner_px: ellipse.semi_minor_px,
            neighbours: &[],
            slopes: [[0.0; 2]; 2],
            noise: &NoiseCorrelation::NONE,
            level: 0,
            variance: 1.0,
            quantisation: 0.0,
            clear: false,
            shot_noise: None,
            smoke: false,
            full_of_smoke: false,
            printed: false,
            shape: Shape::GAUSSIAN,
            stretch: [0.0; 2],
            shape_covariance: Matrix4::zeros(),
            asked: false,
            tells: None,
        }
    }
}
