//! What one disc says of the noise inside, for all discs to tell it together ([`crate::detect::shot_noise`]).

use super::products::{CHUNK, Products};
use super::{Exact, State};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::shot_noise::{Told, asked};
use crate::lanes;

impl Exact {
    /// Minus twice the logarithm of the restricted likelihood of all that is asked, of the disc that was fitted last and came to `state`; `outside` is the
    /// variance of the noise there, if its pixels do not show it. None where the geometry is not fixed.
    pub(crate) fn noise_told(&mut self, state: &State, outside: f64) -> Option<Told> {
        let outside = self.noise()[1].unwrap_or(outside);
        let bare = self.bare_columns(state);
        let steepest = self.response[..self.count].iter().fold(0.0_f64, |most, h| most.max(h.abs()));
        let mut unlikely = vec![];
        for (ratio, rough) in asked() {
            let variance = |p: usize| {
                let h = self.response[p] / steepest;
                outside * (1.0 + (ratio - 1.0) * self.inside[p] + rough * h * h)
            };
            let variances: Vec<f64> = (0..self.count).map(variance).collect();
            self.sum_up_weighted(state, &bare, &variances);
            unlikely.push(self.solve(state)? + variances.iter().map(|v| v.ln()).sum::<f64>());
        }
        Some(Told { unlikely, step: state.step.abs() })
    }

    /// The columns of all pixels without weights, one after the other; responses lose theirs as well.
    fn bare_columns(&mut self, state: &State) -> Vec<f64> {
        let columns = Self::lights(state) + FIXED + 1;
        let frame = Frame::new(&state.ellipse);
        self.prepare(state, &frame);
        let mut bare = vec![0.0; columns * self.count];
        for i in (0..self.count).step_by(LANES) {
            self.fill(state, &frame, i, 0);
            for l in 0..LANES.min(self.count - i) {
                let root = Self::weight(state, self.inside[i + l]).sqrt();
                for j in 0..columns {
                    bare[j * self.count + i + l] = self.columns[j * CHUNK + l] / root;
                }
                self.response[i + l] /= root;
            }
        }
        bare
    }

    /// Products of all columns with these variances of the pixels.
    fn sum_up_weighted(&mut self, state: &State, bare: &[f64], variances: &[f64]) {
        let n = Self::lights(state) + FIXED + 1;
        self.gram.clear();
        self.gram.resize(n * n, 0.0);
        for from in (0..self.count).step_by(CHUNK) {
            let shown = CHUNK.min(self.count - from);
            let used = shown.next_multiple_of(LANES);
            for j in 0..n {
                let (to, of) = (&mut self.columns[j * CHUNK..][..used], &bare[j * self.count + from..][..shown]);
                to[shown..].fill(0.0);
                let weighted = of.iter().zip(&variances[from..]).map(|(x, v)| x / v.sqrt());
                to.iter_mut().zip(weighted).for_each(|(to, x)| *to = x);
            }
            lanes::run(Products { columns: &self.columns, used, n, gram: &mut self.gram });
        }
    }
}
