//! What a clean disc says of the shape of the blur.

use super::columns::BLOCK;
use super::few::{KEPT, ORDER};
use super::{Clean, LIGHTS, M, N, Quick};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::profile::Profile;
use crate::detect::shape::told::{Edges, Sums, Told};
use crate::lanes;

impl Quick {
    /// What the fit left, the sectors being shared out, says of a shape beside the one that it was made with.
    pub(crate) fn shape_told(&self, state: &Clean) -> Option<Told> {
        let (n, count) = (self.solved, self.pixels.near.count);
        let bends = n.checked_sub(N);
        let column = |k: usize| match bends {
            None => ORDER[k],
            Some(bends) if k < bends => M + k,
            Some(bends) => k - bends,
        };
        if n < KEPT || bends.is_none() && n != KEPT {
            return None;
        }
        let order: Vec<usize> = (0..n).map(column).collect();
        let mut sums = Sums::new(n);
        for i in (0..count).step_by(LANES) {
            let (values, at) = (&self.columns.values[i / BLOCK], i % BLOCK);
            for (column, k) in sums.columns.iter_mut().zip(&order) {
                *column = eight(&values[*k][at..]);
            }
            sums.add(self.shapes(state, i), eight(&self.columns.left[i..]), count - i);
        }
        Some(sums.told(&self.dense))
    }

    /// Derivatives of the grey values of [`LANES`] pixels from one on by what they tell, over the noise; without meaning where there is no pixel.
    fn shapes(&self, state: &Clean, i: usize) -> [[f64; LANES]; 4] {
        let Frame { a, b, cos, sin, .. } = self.frame;
        let (values, at) = (&self.columns.values[i / BLOCK], i % BLOCK);
        let [u, v] = [LIGHTS + 1, LIGHTS + 2].map(|k| eight(&values[k][at..]));
        let response = eight(&self.columns.response[i..]);
        let mut edges = Edges {
            profile: Profile { blur_px: state.blur_px, shape: state.shape, a, b },
            turn: [cos, sin],
            distance: [0.0; LANES],
            cos: [1.0; LANES],
            sin: [0.0; LANES],
        };
        let near = &self.pixels.near;
        for l in 0..LANES.min(near.count - i) {
            // The columns of the place are the normal, turned, times less the response.
            let (nx, ny) = (-(cos * u[l] + sin * v[l]) / response[l], -(cos * v[l] - sin * u[l]) / response[l]);
            // N of `conic`: of the foot point (a cos, b sin) the normal is (b cos, a sin) / N.
            let length = 1.0 / ((nx / b).powi(2) + (ny / a).powi(2)).sqrt();
            if length.is_finite() {
                let ([x, y], c, s) = (near.place(i + l), nx * length / b, ny * length / a);
                (edges.cos[l], edges.sin[l], edges.distance[l]) = (c, s, (x - a * c) * nx + (y - b * s) * ny);
            }
        }
        let (mut shapes, slope) = lanes::run(edges);
        for l in 0..LANES {
            let step = if slope[l].abs() > 1e-9 { response[l] / slope[l] } else { 0.0 };
            shapes.iter_mut().for_each(|shape| shape[l] *= step);
        }
        shapes
    }
}

/// The first numbers of a list.
#[inline(always)]
fn eight(list: &[f32]) -> [f64; LANES] {
    std::array::from_fn(|l| f64::from(list[l]))
}
