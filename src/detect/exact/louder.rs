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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conic::Ellipse;
    use crate::detect::edge_model::blur_weight;
    use crate::detect::exact::Field;
    use crate::detect::exact::tests::looked_at;
    use crate::detect::light::Side;
    use crate::frames::Pixel;
    use nalgebra::{DMatrix, DVector};

    /// Against the likelihood of the grey values themselves, whose covariance holds all that has a prior, with the geometry, which has none, taken out
    /// (Harville 1974): no information matrix of the unknowns is in it.
    #[test]
    fn what_is_told_is_the_restricted_likelihood() {
        let ellipse =
            Ellipse { center_px: Pixel::new(14.6, 15.3), semi_major_px: 4.8, semi_minor_px: 4.0, angle_rad: 0.4 };
        let smoky = State::in_smoke(ellipse, 0.8, 60.0, 2.0, Field::default());
        // Levels with a prior of 60 grey levels: one a thousand times as wide leaves the covariance three digits.
        let state = State { field: None, sides: [Side::plain(0, 0.06); 2], ..smoky };
        let mut seed = 7_u32;
        let mut exact = looked_at(
            26,
            &state,
            |_, _| 60.0,
            || {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                f64::from(seed >> 16) / 16_384.0 - 2.0
            },
        );
        let outside = 1.7;
        let told = exact.noise_told(&state, outside).expect("a likelihood").unlikely;

        let columns =
            DMatrix::from_column_slice(exact.count, Exact::lights(&state) + FIXED + 1, &exact.bare_columns(&state));
        let known = Exact::lights(&state) + 1;
        let (light, geometry) = (columns.columns(0, known), columns.columns(known, FIXED - 1));
        let grey: DVector<f64> = columns.column(known + FIXED - 1).into_owned();
        let sigmas = state.sides.iter().flat_map(|side| side.prior_sigmas().into_iter().take(side.count()));
        let prior: Vec<f64> = sigmas.map(|s| s * s).chain([1.0 / blur_weight(state.expected_blur_px)]).collect();
        let spread = light * DMatrix::from_diagonal(&DVector::from_vec(prior)) * light.transpose();
        let steepest = exact.response[..exact.count].iter().fold(0.0_f64, |most, h| most.max(h.abs()));
        let plainly = |(ratio, rough): (f64, f64)| {
            let own = |p: usize| {
                let h = exact.response[p] / steepest;
                outside * (1.0 + (ratio - 1.0) * exact.inside[p] + rough * h * h)
            };
            let covariance = &spread + DMatrix::from_diagonal(&DVector::from_fn(exact.count, |p, _| own(p)));
            let factor = covariance.cholesky().expect("a covariance");
            let by_geometry = (geometry.transpose() * factor.solve(&geometry)).cholesky().expect("a geometry");
            let right = geometry.transpose() * factor.solve(&grey);
            let log_det = |l: &DMatrix<f64>| 2.0 * l.diagonal().iter().map(|x| x.ln()).sum::<f64>();
            grey.dot(&factor.solve(&grey)) - right.dot(&by_geometry.solve(&right))
                + log_det(&factor.l())
                + log_det(&by_geometry.l())
        };
        // They differ by a constant, that of the priors.
        let plain: Vec<f64> = asked().map(plainly).collect();
        for (found, expected) in told.iter().zip(&plain) {
            let (found, expected) = (found - told[0], expected - plain[0]);
            assert!((found - expected).abs() < 1e-4, "{found} and {expected}");
        }
        assert!(told.iter().copied().fold(0.0, f64::min) < told[0] - 10.0, "some are far likelier than others");
    }
}
