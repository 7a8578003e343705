//! From an image to discs: subpixel contours, ellipses with covariance, and the pattern they form.

mod around;
mod band;
mod beside;
mod candidate;
mod contour;
mod correlation;
mod dense;
mod dust;
mod edge_model;
mod exact;
mod find;
mod level;
mod light;
mod of_target;
pub mod pattern;
mod plane;
mod profile;
mod quick;
mod refine;
mod rejection;
mod rim;
mod rough;
mod rows;
mod sectors;
mod shape;
mod shared_light;
mod shot_noise;
mod slim;
mod surface;
mod trace;
mod whole;

pub use find::{find_discs, find_discs_while, find_discs_with};
pub(crate) use plane::noise;
pub use rejection::{Rejection, RejectionReason, counted, counted_words, missing_words};
pub use whole::DetectMemory;

use crate::conic::{CommonNoise, ContourNoise, Ellipse};
use crate::frames::Pixel;
use crate::target::{DotId, MarkKind, Polarity};
use nalgebra::SMatrix;

/// What is known of the light of bright discs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Smoke {
    /// Nothing: each of them is asked whether it is full of smoke.
    #[default]
    Maybe,
    /// They are full of smoke, as bubbles cut by a laser sheet are. Behind a blur a small disc in weak smoke looks as in even
    /// light, and may lie two to five sigmas from where that would put it: only who knows of the smoke can tell. Even light is then one chance in
    /// eleven, and discs that have it pay: sigmas are a tenth larger for 4 to 11 px behind 1.5 px, those of a centre twice for 4 px behind 1.7 px.
    /// On contours above 130 px no polynomial is asked whether it suffices: of slow smoke noise hides what it leaves, which moves contours by two of their
    /// sigmas, and even light pays a fifth. Smoke that changes fast has its slopes held more loosely, whose sigmas were a tenth to a third too small
    /// otherwise. Of no effect in images of more than 24 candidates, wisps of smoke apart, whose discs are fitted without fields.
    Full,
    /// They are printed, and have none: louder noise is the light's own, and few of them, or one, tell the shape of a blur.
    None,
}

/// What to look for. The defaults serve any target; only [`DetectOptions::polarity`] and [`DetectOptions::smoke`] are worth knowing in advance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectOptions {
    /// Bright or dark discs; `Auto` keeps the polarity whose contours weigh more (length times contrast).
    pub polarity: Polarity,
    /// What is known of the light of bright discs.
    pub smoke: Smoke,
    /// Smallest minor semi-axis, px.
    pub min_semi_minor_px: f64,
    /// Largest major semi-axis, px.
    pub max_semi_major_px: f64,
    /// Smallest ratio of minor to major semi-axis.
    pub min_axis_ratio: f64,
    /// Smallest ratio of the grey step across the edge to the standard deviation of the noise.
    pub min_contrast_to_noise: f64,
    /// Smallest part of the contour that must be seen, above 0, at most 1.
    pub min_coverage: f64,
    /// Largest root mean square distance of edge points from the ellipse: constant part, px.
    pub max_edge_rms_px: f64,
    /// The same: part that grows with the minor semi-axis, px/px.
    pub max_edge_rms_ratio: f64,
}

impl DetectOptions {
    /// Largest root mean square distance of the edge points of an ellipse from it, noise apart, px.
    fn most_rms_px(&self, e: &Ellipse) -> f64 {
        self.max_edge_rms_px + self.max_edge_rms_ratio * e.semi_minor_px
    }
}

impl Default for DetectOptions {
    fn default() -> Self {
        Self {
            polarity: Polarity::Auto,
            smoke: Smoke::Maybe,
            min_semi_minor_px: 1.5,
            max_semi_major_px: 2000.0,
            min_axis_ratio: 0.2,
            min_contrast_to_noise: 3.0,
            min_coverage: 0.7,
            max_edge_rms_px: 0.15,
            max_edge_rms_ratio: 0.02,
        }
    }
}

/// Edge points of one contour, structure of arrays, each with a sigma of its own.
///
/// Independent points would say that an ellipse is known better than it is: what is uncertain of blur and light moves all of them
/// together. That is in [`Disc::covariance`], and in [`Disc::common_noise`] for those who use the points in place of the ellipse.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EdgePoints {
    /// Position, px.
    pub u_px: Vec<f64>,
    /// Position, px.
    pub v_px: Vec<f64>,
    /// Standard deviation normal to the contour of what is a point's own, px.
    pub sigma_px: Vec<f64>,
}

/// One disc found in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Disc {
    /// Ellipse fitted to the contour.
    pub ellipse: Ellipse,
    /// Covariance of `(u0, v0, a, b, phi)` (see [`crate::conic`]).
    pub covariance: SMatrix<f64, 5, 5>,
    /// The contour it was fitted to, already corrected for blur.
    pub edge: EdgePoints,
    /// What the fit knows of the contour beside its points.
    pub contour: ContourNoise,
    /// `Bright` or `Dark`, never `Auto`.
    pub polarity: Polarity,
    /// Standard deviation of the blur of the edge, px.
    pub blur_px: f64,
    /// Step of the grey level across the edge, grey levels (positive).
    pub contrast: f64,
    /// Mark, where the shape is one that is still a disc (`Ring`).
    pub mark: Option<MarkKind>,
}

impl Disc {
    /// What the distances of the edge points, over their sigmas, have in common.
    pub fn common_noise(&self) -> CommonNoise {
        let EdgePoints { u_px, v_px, sigma_px } = &self.edge;
        self.contour.of_points(&self.ellipse, [u_px, v_px, sigma_px])
    }

    /// Root mean square distance of the edge points from the ellipse, px.
    pub fn edge_rms_px(&self) -> f64 {
        let points = self.edge.u_px.iter().zip(&self.edge.v_px);
        let squares: f64 = points.map(|(u, v)| self.ellipse.distance_px(Pixel::new(*u, *v)).powi(2)).sum();
        (squares / self.edge.u_px.len().max(1) as f64).sqrt()
    }
}

/// A closed shape that is no disc but may be a mark.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Centroid, px.
    pub center_px: Pixel,
    /// Square root of area / pi, px.
    pub radius_px: f64,
    /// What it looks like, where it looks like a mark.
    pub mark: MarkKind,
}

/// Everything found in one image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Detection {
    /// Accepted discs.
    pub discs: Vec<Disc>,
    /// Square and triangle marks.
    pub shapes: Vec<Shape>,
    /// Candidates turned down, each with its reason.
    pub rejections: Vec<Rejection>,
}

impl Detection {
    /// Bright discs that may be bubbles full of smoke, for all that the image tells: none where discs are too many.
    pub fn possible_bubbles(&self) -> usize {
        let bright = self.discs.iter().filter(|disc| disc.polarity == Polarity::Bright);
        if self.discs.len() > around::MOST_SMOKY { 0 } else { bright.count() }
    }
}

/// A disc that knows its place in the pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LabelledDisc {
    /// Index into [`Detection::discs`].
    pub disc: usize,
    /// Its label.
    pub id: DotId,
}
