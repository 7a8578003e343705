//! Whether a small disc may be full of smoke: what the blur leaves of smoke is often no more than light that rises shows.
//!
//! A few fields are held against light without waves, both under the noise that the fit found. Light that rises outside has a slope there, which smoke behind a blur
//! is often taken for: then it is asked besides what a field says with even light outside, and the prior of those slopes is counted for the light that has them.
//!
//! ```text
//! gain = 2 ln L(waves, outside as it is or even) - 2 ln L(level or slope, outside as it is)
//! ```
//!
//! Of 1600 discs of 3 to 8 px without smoke, behind blurs of 1.3 to 3 px in even light, 99 of 100 have a gain below 4, the most is 8.7. Where light rises by
//! 30 % across them, inside and out, waves gain up to 22, as not knowing the slopes inside costs 15, and with even light outside they lose 1e5;
//! smoke taken for such light gains 10 to 1080, with even light outside 45 to 1110 (4 px behind 1.7 px, 8 px behind 3 px, 93 discs).
//!
//! Weak smoke behind a blur may gain nothing, and draw the contour by two to five of the sigmas of even light all the same: of 350 discs of 4 px behind 1.7 px with waves of 5 or 10 %
//! of the light 95 have gains of -1 to 6. So has one clean disc in six. Smoke shines: bright discs of such gains are fitted as the mean over light with smoke and without.

use super::field::{Field, Spectrum, price_of_slopes, prior_of_amplitude, prior_of_noise};
use super::{Exact, State};
use crate::detect::light::Side;

/// Fields that are asked: lengths in semi-axes, amplitudes in steps of the light.
const LENGTHS: [f64; 3] = [0.64, 1.15, 2.2];
const AMPLITUDES: [f64; 3] = [0.06, 0.12, 0.24];
/// Where the noise inside is known if there is no smoke: what of it, as a power of its ratio to that outside, may be noise if there is.
const POWERS: [f64; 3] = [0.0, 0.5, 1.0];
/// The loss that says that there is none, whatever light looked like before: shot noise alone makes a bright disc louder than its ground.
const UNLIKELIER: f64 = 4.0;
/// The gain from which a bright disc in even light may be full of smoke as well as not.
const POSSIBLE: f64 = -1.0;
/// The gain that says that there is smoke: where light outside is even, where it rises, and with even light in place of that.
const LIKELIER: f64 = 6.0;
const LIKELIER_ON_SLOPE: f64 = 30.0;
const LIKELIER_THAN_SLOPE: f64 = 25.0;

/// What the fields that are asked say of smoke.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Answer {
    /// They say clearly more than light without waves.
    Likely,
    /// They say about as much, of a disc that smoke may have made bright.
    Possible,
    /// Neither.
    Open,
    /// They say clearly less.
    Unlikely,
}

impl Exact {
    /// Whether a field says clearly more, or less, of a small disc than the polynomials of `state`, to which the image was fitted last.
    pub(crate) fn ask_for_smoke(&mut self, state: &State) -> Answer {
        let own = (self.dense.clone(), self.found.clone(), self.light.clone());
        self.hold_steps(state);
        self.light.clear();
        let plain = [0, 1].into_iter().filter_map(|degree| self.listen_plainly(state, degree));
        let plain = plain.map(|s| s.value).fold(f64::INFINITY, f64::min);
        let outside = &state.sides[1];
        let as_it_is = plain - self.likeliest_asked(state, *outside);
        let mut gains = [(as_it_is, LIKELIER); 2];
        if outside.degree > 0 {
            let even = Side { degree: 0, ..*outside };
            let than_slope = plain + price_of_slopes(outside) - self.likeliest_asked(state, even);
            gains = [(as_it_is, LIKELIER_ON_SLOPE), (than_slope, LIKELIER_THAN_SLOPE)];
        }
        self.held.clear();
        (self.dense, self.found, self.light) = own;
        let smoke_shines = state.step > 0.0 && outside.degree == 0;
        if gains.iter().any(|(gain, likely)| gain > likely) {
            Answer::Likely
        } else if smoke_shines && as_it_is > POSSIBLE {
            Answer::Possible
        } else if gains.iter().all(|(gain, _)| *gain < -UNLIKELIER) {
            Answer::Unlikely
        } else {
            Answer::Open
        }
    }

    /// By how much each field that is asked is less likely than light that is at most slanted, for discs that have the noise of `state` in common, to which the image
    /// was fitted last: with that noise, and with so much less of it inside as the smoke may be. In twice the logarithm of the likelihood.
    pub(crate) fn smoke_told(&mut self, state: &State) -> Vec<f64> {
        self.hold_steps(state);
        self.light.clear();
        let plain = [0, 1].into_iter().filter_map(|degree| self.listen_plainly(state, degree));
        let plain = plain.map(|s| s.value).fold(f64::INFINITY, f64::min) - prior_of_noise(state.variance, state.step);
        let ([inside, outside], mut told) = (state.variance, vec![]);
        for power in POWERS {
            let quieter = State { variance: [outside * (inside / outside).powf(power), outside], ..state.clone() };
            self.each_asked(&quieter, state.sides[1], |exact, tried, value| {
                told.push(value + exact.price_of_known_noise(tried) - plain);
            });
        }
        self.held.clear();
        told
    }

    /// Minus twice the logarithm of the likelihood of the likeliest field asked, with the light given outside.
    fn likeliest_asked(&mut self, state: &State, outside: Side) -> f64 {
        let mut least = f64::INFINITY;
        self.each_asked(state, outside, |exact, tried, value| {
            let amplitude = tried.field.as_ref().map_or(0.0, |f| f.amplitude);
            least = least.min(value + prior_of_amplitude(amplitude, state) + exact.price_of_noise(tried));
        });
        least
    }

    /// What is left by each field asked, with the light given outside.
    fn each_asked(&mut self, state: &State, outside: Side, mut take: impl FnMut(&Self, &State, f64)) {
        for length in LENGTHS {
            let field = Field::new(Spectrum::Smooth, length, &state.ellipse, state.blur_px);
            let sides = [Side::plain(0, state.step.abs()), outside];
            let mut tried = State { field: Some(field), sides, ..state.clone() };
            self.sum_up(&tried);
            for part in AMPLITUDES {
                if let Some(f) = &mut tried.field {
                    f.amplitude = part * state.step.abs();
                }
                let value = self.solve(&tried).unwrap_or(f64::INFINITY);
                take(self, &tried, value);
            }
        }
    }
}
