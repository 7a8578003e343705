//! What one disc says of the shape of the blur, as `quick/told.rs` of clean ones.

use super::{Exact, State};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::exact::products::CHUNK;
use crate::detect::profile::Lanes;
use crate::detect::rim::Rim;
use crate::detect::shape::Shape;
use crate::detect::shape::of_image::{Edge, Sums, Told, by_stretch};
use nalgebra::Vector4;

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
            let lanes = self.profile(state, i);
            self.fill(state, &frame, i, 0);
            let shares = match &rims {
                Some(rims) => self.on_rim(state, &frame, rims, i),
                None => self.on_edge(state, &frame, &lanes, i),
            };
            let root = self.roots(state, i, std::array::from_fn(|l| self.inside[i + l].clamp(0.0, 1.0)));
            for (l, share) in shares.into_iter().enumerate().take(self.count - i) {
                let step = root[l] * self.step_at(state, self.band.cos[i + l], self.band.sin[i + l]);
                let column = |k: usize| self.columns[k * CHUNK + l];
                let left = column(n) - (0..n).map(|k| self.found[k] * column(k)).sum::<f64>();
                sums.add(&(share * step), left, column);
            }
        }
        Some(sums.told(&self.dense))
    }

    /// Derivatives of the share of [`LANES`] pixels from place `i` on, by the local profile.
    fn on_edge(&self, state: &State, frame: &Frame, lanes: &Lanes<LANES>, i: usize) -> [Vector4<f64>; LANES] {
        std::array::from_fn(|l| {
            let (cos, sin) = (self.band.cos[i + l], self.band.sin[i + l]);
            let (x, y) = (frame.b * cos, frame.a * sin);
            let (length, kappa) = (x.hypot(y), self.band.curvature[i + l]);
            let edge = Edge { depth: lanes.depth[l], density: lanes.density[l], slope: lanes.slope[l], kappa };
            edge.derivatives(state.blur_px, [x / length, y / length], [frame.cos, frame.sin])
        })
    }

    /// The same exactly.
    fn on_rim(&self, state: &State, frame: &Frame, rims: &[Rim; 3], i: usize) -> [Vector4<f64>; LANES] {
        let place = [&self.band.x, &self.band.y].map(|list| super::eight(list, i));
        let [gaussian, fourth, sixth] = rims.each_ref().map(|rim| rim.seen(&place[0], &place[1]));
        let bend = self.rim.seen(&place[0], &place[1]).bend;
        std::array::from_fn(|l| {
            let [p, q] = by_stretch(state.blur_px, bend.map(|lanes| lanes[l]), [frame.cos, frame.sin]);
            let [c, e] = [fourth.inside[l], sixth.inside[l]].map(|x| x - gaussian.inside[l]);
            Vector4::new(c, e, p, q)
        })
    }
}
