//! What a clean disc says of the shape of the blur.

use super::columns::BLOCK;
use super::few::{KEPT, ORDER};
use super::{Clean, LIGHTS, M, N, Quick};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::profile::{Profile, Profiled};
use crate::detect::shape::of_image::{Edge, Sums, Told};
use crate::lanes;
use nalgebra::Vector4;

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
        let mut sums = Sums::new(n);
        for i in (0..count).step_by(LANES) {
            let own = self.shapes(state, i);
            for (l, own) in own.into_iter().enumerate().take(count - i) {
                let (values, at) = (&self.columns.values[(i + l) / BLOCK], (i + l) % BLOCK);
                let left = f64::from(self.columns.left[i + l]);
                sums.add(&own, left, |k| f64::from(values[column(k)][at]));
            }
        }
        Some(sums.told(&self.dense))
    }

    /// Derivatives of the grey values of [`LANES`] pixels from one on by what they tell, over the noise.
    fn shapes(&self, state: &Clean, i: usize) -> [Vector4<f64>; LANES] {
        let Frame { a, b, cos: turn_cos, sin: turn_sin, .. } = self.frame;
        let near = &self.pixels.near;
        let mut profiled = Profiled {
            profile: Profile { blur_px: state.blur_px, shape: state.shape, a, b },
            distance: [0.0; LANES],
            cos: [1.0; LANES],
            sin: [0.0; LANES],
        };
        let (mut response, mut normal, mut kappa) = ([0.0; LANES], [[0.0; 2]; LANES], [0.0; LANES]);
        for l in 0..LANES.min(near.count - i) {
            response[l] = f64::from(self.columns.response[i + l]);
            let [nx, ny] = self.normal(i + l);
            // N of `conic`: of the foot point (a cos, b sin) the normal is (b cos, a sin) / N.
            let length = (nx / b).hypot(ny / a).recip();
            if !length.is_finite() {
                response[l] = 0.0;
                continue;
            }
            let ([x, y], cos, sin) = (near.place(i + l), nx * length / b, ny * length / a);
            (profiled.cos[l], profiled.sin[l]) = (cos, sin);
            profiled.distance[l] = (x - a * cos) * nx + (y - b * sin) * ny;
            (normal[l], kappa[l]) = ([nx, ny], a * b / length.powi(3));
        }
        let seen = lanes::run(profiled);
        std::array::from_fn(|l| {
            let step = if seen.slope[l].abs() > 1e-9 { response[l] / seen.slope[l] } else { 0.0 };
            let edge = Edge { depth: seen.depth[l], density: seen.density[l], slope: seen.slope[l], kappa: kappa[l] };
            edge.derivatives(state.blur_px, normal[l], [turn_cos, turn_sin]) * step
        })
    }

    /// Outward normal at the foot point of a pixel, in the frame of the axes; no numbers where it does not respond.
    fn normal(&self, i: usize) -> [f64; 2] {
        let (values, at) = (&self.columns.values[i / BLOCK], i % BLOCK);
        // The columns of the place are the normal, turned, times less the response.
        let [u, v] = [LIGHTS + 1, LIGHTS + 2].map(|k| f64::from(values[k][at]));
        let less = -1.0 / f64::from(self.columns.response[i]);
        let Frame { cos, sin, .. } = self.frame;
        [(cos * u + sin * v) * less, (cos * v - sin * u) * less]
    }
}
