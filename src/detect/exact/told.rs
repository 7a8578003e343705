//! What one disc says of the shape of the blur, as `quick/told.rs` of clean ones.

use super::{Exact, State};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::exact::products::CHUNK;
use crate::detect::profile::Profile;
use crate::detect::rim::Rim;
use crate::detect::shape::Shape;
use crate::detect::shape::told::{Edges, Sums, Told, by_stretch};
use crate::lanes;

/// Fourth and sixth order alone.
const ALONE: [Shape; 2] = [Shape { fourth: 1.0, sixth: 0.0 }, Shape { fourth: 0.0, sixth: 1.0 }];

impl Exact {
    /// From the state where the fit stands still; none where its equations have no solution.
    pub(crate) fn shape_told(&mut self, state: &State) -> Option<Told> {
        self.sum_up(state);
        self.solve(state)?;
        let (frame, n) = (Frame::new(&state.ellipse), Self::lights(state) + FIXED);
        // A shape is linear: what the orders add to a disc is what they show beside a Gaussian.
        let rims = state.exact_rim().then(|| {
            [Shape::GAUSSIAN, ALONE[0], ALONE[1]].map(|shape| {
                let mut rim = Rim::default();
                rim.set(&frame, state.blur_px, shape);
                rim.step = vec![0.0; rim.angles().count()];
                rim
            })
        });
        let mut sums = Sums::new(n);
        for i in (0..self.count).step_by(LANES) {
            self.fill(state, &frame, i, 0);
            let mut shares = match &rims {
                Some(rims) => self.on_rim(state, &frame, rims, i),
                None => self.on_edge(state, &frame, i),
            };
            let root = self.roots(state, i, std::array::from_fn(|l| self.inside[i + l].clamp(0.0, 1.0)));
            let mut left = super::eight(&self.columns, n * CHUNK);
            for k in 0..n {
                sums.columns[k] = super::eight(&self.columns, k * CHUNK);
                (0..LANES).for_each(|l| left[l] -= self.found[k] * sums.columns[k][l]);
            }
            for l in 0..LANES.min(self.count - i) {
                let step = root[l] * self.step_at(state, self.band.cos[i + l], self.band.sin[i + l]);
                shares.iter_mut().for_each(|share| share[l] *= step);
            }
            sums.add(shares, left, self.count - i);
        }
        Some(sums.told(&self.dense))
    }

    /// Derivatives of the share of [`LANES`] pixels from place `i` on, by the local profile.
    fn on_edge(&self, state: &State, frame: &Frame, i: usize) -> [[f64; LANES]; 4] {
        let profile = Profile { blur_px: state.blur_px, shape: state.shape, a: frame.a, b: frame.b };
        let [distance, cos, sin] =
            [&self.band.distance, &self.band.cos, &self.band.sin].map(|list| super::eight(list, i));
        lanes::run(Edges { profile, turn: [frame.cos, frame.sin], distance, cos, sin }).0
    }

    /// The same exactly.
    fn on_rim(&self, state: &State, frame: &Frame, rims: &[Rim; 3], i: usize) -> [[f64; LANES]; 4] {
        let place = [&self.band.x, &self.band.y].map(|list| super::eight(list, i));
        let [gaussian, fourth, sixth] = rims.each_ref().map(|rim| rim.seen(&place[0], &place[1]).inside);
        let bend = self.rim.seen(&place[0], &place[1]).bend;
        let mut out = [fourth, sixth, [0.0; LANES], [0.0; LANES]];
        for l in 0..LANES {
            (out[0][l], out[1][l]) = (fourth[l] - gaussian[l], sixth[l] - gaussian[l]);
            let second = bend.map(|lanes| lanes[l]);
            [out[2][l], out[3][l]] = by_stretch(state.blur_px, second, [frame.cos, frame.sin]);
        }
        out
    }
}
