//! What one disc says of the shape of the blur, as `quick/told.rs` of clean ones.

use super::{Exact, State};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::exact::products::CHUNK;
use crate::detect::profile::Lanes;
use crate::detect::rim::Rim;
use crate::detect::shape::of_image::{Sums, Told};
use crate::detect::shape::{Shape, orders_of_edge};
use nalgebra::Vector2;

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
                Some(rims) => self.orders_on_rim(rims, i),
                None => Self::orders_on_edge(state, &lanes, |l| self.band.curvature[i + l]),
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

    /// What both orders add to the share of [`LANES`] pixels.
    fn orders_on_edge(state: &State, lanes: &Lanes<LANES>, curvature: impl Fn(usize) -> f64) -> [Vector2<f64>; LANES] {
        std::array::from_fn(|l| {
            let orders = orders_of_edge(lanes.depth[l], state.blur_px * curvature(l));
            Vector2::from(orders.map(|order| lanes.density[l] * order.share))
        })
    }

    /// The same exactly, of the pixels from place `i` on.
    fn orders_on_rim(&self, rims: &[Rim; 3], i: usize) -> [Vector2<f64>; LANES] {
        let place = [&self.band.x, &self.band.y].map(|list| super::eight(list, i));
        let [gaussian, fourth, sixth] = rims.each_ref().map(|rim| rim.seen(&place[0], &place[1]).inside);
        std::array::from_fn(|l| Vector2::new(fourth[l] - gaussian[l], sixth[l] - gaussian[l]))
    }
}
