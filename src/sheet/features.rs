//! Features of pairs of discs that both cameras see: the eight points in which common tangents touch them, with their covariance.
//!
//! They are those of ellipses fitted in the undistorted image (the distorted one biases them by 0.04 to 0.55 px), and mapped back to real pixels. Ovality of a print is left in: both cameras see the same oval on the plane, and tangents of its images
//! are images of its tangents.

use crate::bitangent::{FROM_BEHIND, bitangents};
use crate::bundle::DiscObservation;
use crate::camera::Camera;
use crate::conic::fit_geometric;
use nalgebra::{Matrix2, SMatrix, Vector2, Vector3};

/// Tangency points of a pair of discs.
pub(super) const TOUCHING: usize = 8;
/// Covariance of the tangency points of a pair in one image, u and v of each in turn, px^2.
pub(super) type PairCovariance = SMatrix<f64, { 2 * TOUCHING }, { 2 * TOUCHING }>;

/// Features of the same pair of discs in both cameras, real (distorted) pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct PairFeatures {
    /// In the first camera, px.
    pub first_px: Vec<Vector2<f64>>,
    /// In the second camera, px.
    pub second_px: Vec<Vector2<f64>>,
    /// Of both, px^2.
    pub(super) covariance_px2: [PairCovariance; 2],
}

impl PairFeatures {
    /// The same with edge points in both images that scatter so many times as much as they say.
    pub(crate) fn scaled(mut self, by: [f64; 2]) -> Self {
        self.covariance_px2.iter_mut().zip(by).for_each(|(covariance, by)| *covariance *= by * by);
        self
    }

    /// Tangency points of two discs from their contours in both cameras; `None` where an image does not give two separated
    /// ellipses, or a camera looks through a window, behind which circles have no ellipses as images.
    pub fn of(cameras: [&Camera; 2], contours: [[&DiscObservation; 2]; 2]) -> Option<Self> {
        let (first_px, first) = tangency_points(cameras[0], contours[0])?;
        let (second_px, second) = tangency_points(cameras[1], contours[1])?;
        Some(Self { first_px, second_px, covariance_px2: [first, second] })
    }

    /// The same discs where the second camera sees the other side of their plane: left and right change places in its image.
    pub fn on_both_sides(&self) -> Self {
        let second_px = (0..self.second_px.len()).map(|i| self.second_px[FROM_BEHIND[i]]).collect();
        let [first, second] = &self.covariance_px2;
        let place = |i: usize| 2 * FROM_BEHIND[i / 2] + i % 2;
        let second = PairCovariance::from_fn(|i, j| second[(place(i), place(j))]);
        Self { first_px: self.first_px.clone(), second_px, covariance_px2: [*first, second] }
    }
}

/// The eight tangency points in real pixels and their covariance.
fn tangency_points(camera: &Camera, contours: [&DiscObservation; 2]) -> Option<(Vec<Vector2<f64>>, PairCovariance)> {
    if camera.window().is_some() {
        return None;
    }
    let e = camera.effective_pinhole();
    let turn = camera.cam_from_pinhole();
    let straight = |seen: &DiscObservation| {
        let (edge, mut u, mut v) = (&seen.edge, vec![], vec![]);
        for i in 0..edge.u_px.len() {
            let xy = camera.ideal_of_pixel(&Vector2::new(edge.u_px[i], edge.v_px[i])).ok()?;
            let p = turn.transpose() * xy.push(1.0);
            u.push(e.cx_px + e.f_px * p.x / p.z);
            v.push(e.cy_px + e.f_px * p.y / p.z);
        }
        fit_geometric(&u, &v, &edge.sigma_px).ok()?.with_common([&u, &v, &edge.sigma_px], &seen.common)
    };
    let fits = [straight(contours[0])?, straight(contours[1])?];
    let b = bitangents(&fits[0].ellipse, &fits[1].ellipse).ok()?;
    let covariance = b.covariance([&fits[0].covariance, &fits[1].covariance]);
    let real = |q: Vector2<f64>| {
        let ray = turn * Vector3::new((q.x - e.cx_px) / e.f_px, (q.y - e.cy_px) / e.f_px, 1.0);
        camera.project_xyz(&(ray * (100.0 / ray.z))).ok()
    };
    let mut points = vec![];
    let mut by_straight = PairCovariance::zeros();
    for k in 0..TOUCHING {
        let q = b.point(k)?;
        points.push(real(q)?);
        by_straight.fixed_view_mut::<2, 2>(2 * k, 2 * k).copy_from(&derivative(&q, real)?);
    }
    let straight = covariance.fixed_view::<{ 2 * TOUCHING }, { 2 * TOUCHING }>(0, 0);
    Some((points, by_straight * straight * by_straight.transpose()))
}

/// Derivative of a smooth map of pixels.
pub(super) fn derivative(q: &Vector2<f64>, map: impl Fn(Vector2<f64>) -> Option<Vector2<f64>>) -> Option<Matrix2<f64>> {
    let h = 1e-2;
    let by = |step: Vector2<f64>| Some((map(q + step)? - map(q - step)?) / (2.0 * h));
    Some(Matrix2::from_columns(&[by(Vector2::new(h, 0.0))?, by(Vector2::new(0.0, h))?]))
}
