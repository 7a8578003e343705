//! Residuals after (or before) an adjustment: per edge point, and per disc.
//!
//! Per disc the distances are explained by a shift (du, dv) of the whole contour and a growth dr:
//! `distance_i = n_i . (du, dv) + dr`, weighted least squares. (du, dv) is the reprojection error of the disc in the usual
//! sense (observed minus predicted position), and the three numbers' chi-square tells departures of whole discs from
//! scatter along the contour.

use super::assemble::{SeenImage, threaded};
use super::edges::Feet;
use super::model::{DiscObservation, ImageObservations, Model};
use super::outline;
use super::state::State;
use crate::threads::gathered;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Residuals of the edge points of one disc, structure of arrays.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EdgeResidual {
    /// Signed orthogonal distance of the edge point from the predicted contour, ovality of the disc included, px; positive outside.
    pub distance_px: Vec<f64>,
    /// Outward unit normal of the predicted contour.
    pub normal_u: Vec<f64>,
    /// Outward unit normal of the predicted contour.
    pub normal_v: Vec<f64>,
}

/// Residuals of one disc.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscResidual {
    /// Disc of the target.
    pub disc: usize,
    /// Predicted image of the disc's centre, px.
    pub center_px: Vector2<f64>,
    /// Observed minus predicted position, px.
    pub shift_px: Vector2<f64>,
    /// Observed minus predicted size, px.
    pub growth_px: f64,
    /// Chi-square of shift and growth (3 numbers), with scaled sigmas.
    pub chi2: f64,
    /// Chi-square of the numbers that its rim says together with others, with scaled sigmas as the image has them, where it does: five together with the
    /// other camera's, two less what the ovality of a printed disc explains.
    pub rim_chi2: Option<f64>,
    /// Chi-square of all edge points, with scaled sigmas.
    pub edge_chi2: f64,
    /// The edge points.
    pub edges: EdgeResidual,
}

impl DiscResidual {
    /// Length of the shift, px.
    pub fn distance_px(&self) -> f64 {
        self.shift_px.norm()
    }
}

/// Residuals of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageResiduals {
    /// Its discs, in the order of the observations.
    pub discs: Vec<DiscResidual>,
}

/// Residuals of one image; `None` where a circle has no image in this state.
pub fn residuals(model: &Model, state: &State, observations: &ImageObservations) -> Option<ImageResiduals> {
    let image = SeenImage::of(model, state, observations)?;
    let discs: Option<Vec<DiscResidual>> =
        observations.discs.iter().map(|seen| disc_residual(&image, seen, observations.sigma_scale)).collect();
    Some(ImageResiduals { discs: discs? })
}

/// Where an image shows a disc of the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictedPlace {
    /// Image of its centre, px.
    pub center_px: Vector2<f64>,
    /// Affine map from the image to the target's plane about it, mm per px.
    pub plane_from_image: Matrix2<f64>,
}

/// Where an image of a view and a camera shows each disc of the target; `None` for a disc that has no image in this state.
pub fn predicted_places(model: &Model, state: &State, image: &ImageObservations) -> Vec<Option<PredictedPlace>> {
    let Some(seen) = SeenImage::of(model, state, image) else { return vec![None; model.target.disc_count()] };
    let place = |j: usize| {
        let start = seen.circle(j).start()?;
        Some(PredictedPlace { center_px: start.center_px(), plane_from_image: *start.plane_from_image() })
    };
    (0..model.target.disc_count()).map(place).collect()
}

/// [`residuals`] of every image.
pub(super) fn of_each_image(model: &Model, state: &State) -> Vec<Option<ImageResiduals>> {
    let images: Vec<&ImageObservations> = model.images.iter().collect();
    gathered(threaded(&images), &images, |o| residuals(model, state, o))
}

fn disc_residual(image: &SeenImage, seen: &DiscObservation, scale: f64) -> Option<DiscResidual> {
    let circle = image.circle(seen.disc);
    let start = circle.start()?;
    let feet = Feet::of(&circle, seen)?;
    let oval_mm = image.oval_mm(seen.disc);
    let by_oval = if oval_mm == [0.0; 2] { vec![] } else { outline::moved_px(&feet, oval_mm) };
    let Feet { mut distance_px, normal: [normal_u, normal_v], .. } = feet;
    distance_px.iter_mut().zip(by_oval).for_each(|(distance, moved)| *distance -= moved);
    let edges = EdgeResidual { distance_px, normal_u, normal_v };
    let row = |i: usize| {
        let w = 1.0 / (seen.edge.sigma_px[i] * scale);
        [edges.normal_u[i] * w, edges.normal_v[i] * w, w, edges.distance_px[i] * w]
    };
    let mut rows: Vec<_> = (0..seen.edge.u_px.len()).map(row).collect();
    seen.whiten(&mut rows);
    let (mut n, mut b, mut edge_chi2) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for &[u, v, grow, r] in &rows {
        let row = Vector3::new(u, v, grow);
        n += row * row.transpose();
        b += row * r;
        edge_chi2 += r * r;
    }
    let rim_chi2 = seen.tie.as_ref().map(|tie| tie.take(&mut rows).iter().map(|[.., r]| r * r).sum());
    let x = n.cholesky().map_or_else(Vector3::zeros, |c| c.solve(&b));
    Some(DiscResidual {
        disc: seen.disc,
        center_px: start.center_px(),
        shift_px: Vector2::new(x.x, x.y),
        growth_px: x.z,
        chi2: x.dot(&b),
        rim_chi2,
        edge_chi2,
        edges,
    })
}
