//! Smoke as a random field: its lattice of waves, its prior, and what not knowing it costs.

use super::{Exact, SLICE, State, is_large, on_rim};
use crate::conic::Ellipse;
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::light::Side;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::{PI, SQRT_2, TAU};

/// Phase over one blur beyond which waves are left out: where the local profile of the edge holds, which says nothing of shorter ones, and on discs small against their
/// blur, whose integrals hold for any wave. There the image shows a thirtieth of the height of the shortest far from the edge, but more at the edge.
const SHORTEST: f64 = 1.57;
const SHORTEST_ON_RIM: f64 = 2.5;
/// Waves at most; the shortest are left out first.
const MOST_WAVES: f64 = 200.0;
/// Gain in twice the logarithm of the likelihood that a field must bring in a large disc, whose light nodes along the contour follow otherwise.
const WORTH: f64 = 16.0;
/// Loss in the same that a field may bring in a small disc: light without waves is among what its result is the mean over.
const AFFORDED: f64 = 8.0;
/// Loss in the same from which a field has no say.
const NO_SAY: f64 = 16.0;
/// Times that noise inside is made louder by a factor of `sqrt(2)` in its variance.
pub(super) const MOST_LOUD: usize = 24;
/// Factors by which the variance of the noise on the side with more light may well be larger or smaller.
const LIKELY: f64 = 4.0;
const UNLIKELY: f64 = 1.3;
/// Standard deviation of the amplitude of a field before seeing it, in steps of the light, and the least that a disc known to be full of smoke may have.
const AMPLE: f64 = 0.5;
const FAINTEST: f64 = 0.03;
/// How likely light without waves is beforehand, beside all fields together: of a disc of which nothing is known, and of one known to be full of smoke.
const EVEN: [f64; 2] = [1.0, 0.1];
/// Degrees of freedom from which the noise inside is known well enough.
const NOISE_KNOWN: f64 = 150.0;
/// Loss in twice the logarithm of the likelihood at which other noise is no longer tried, and steps of it at most, either way.
const FAR: f64 = 6.0;
const MOST_STEPS: usize = 4;
/// Pixels from which the prior of a field is chosen.
const PRIOR_PIXELS: usize = 3000;

/// Minus twice the logarithm of the prior of the noise inside, beside that outside: with more light comes more shot noise, of a factor
/// that may well be `LIKELY`; less noise with more light is hardly more than another ground.
pub(super) fn prior_of_noise([inside, outside]: [f64; 2], step: f64) -> f64 {
    let louder = (inside / outside).ln() * step.signum();
    (louder / if louder > 0.0 { LIKELY } else { UNLIKELY }.ln()).powi(2)
}

/// Minus twice the logarithm of the prior of an amplitude, per factor, beside the step of the light: light is nowhere negative, and a scatter of more than
/// its mean hardly ever seen. As any blur hides fainter smoke, of all factors below most would say what even light says: where smoke is known to be there
/// it is not that faint.
pub(super) fn prior_of_amplitude(amplitude: f64, state: &State) -> f64 {
    let part = amplitude / state.step.abs();
    if state.full_of_smoke && part < FAINTEST { f64::INFINITY } else { (part / AMPLE).powi(2) }
}

/// What the prior of the slopes of one side takes for them, in twice the logarithm of the likelihood.
pub(super) fn price_of_slopes(side: &Side) -> f64 {
    side.prior_sigmas()[2..side.count()].iter().map(|s| 2.0 * s.ln()).sum()
}

/// Variance of the noise inside beyond which it would hide the step of the light: what asks for more is not the light of a disc.
pub(super) fn loudest_noise(state: &State) -> f64 {
    state.step * state.step
}

/// Length from which waves that end fall off, over that at which they end.
const OUTER: f64 = 8.0;

/// How the variance of the waves falls with the wave number `k`, for a length `l`, before the blur takes its part.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) enum Spectrum {
    /// `(1 + (k l)^2 / 6)^(-3)`: light with a slope that has a slope itself (Matern). A bell would promise more: that light seen
    /// inside says without error what it is at the rim.
    #[default]
    Smooth,
    /// `(1 + (k l)^2)^(-4/3)`: what turbulence mixes, cut by a sheet (von Karman; `E(k) ~ k^(-5/3)` in space).
    Karman,
    /// `exp(-(k l)^8) / (1 + (OUTER k l)^2)`: waves between a longest and a shortest, `2 pi l`, which ends them at once. From no theory (diffusion ends
    /// them more slowly); chosen by what errors it leaves (docs/accuracy.md).
    Ended,
}

impl Spectrum {
    const ALL: [Self; 3] = [Self::Smooth, Self::Karman, Self::Ended];

    /// Lengths tried, in semi-axes. Of the short waves of turbulence only amplitude and length together are seen.
    const fn lengths(self) -> &'static [f64] {
        match self {
            Self::Smooth => &[0.27, 0.36, 0.48, 0.64, 0.85, 1.15, 1.6, 2.2, 3.2, 4.5, 6.4],
            Self::Karman => &[0.4, 1.0, 2.5],
            Self::Ended => &[0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5, 0.64],
        }
    }

    fn variance(self, kl: f64) -> f64 {
        match self {
            Self::Smooth => (1.0 + kl * kl / 6.0).powi(-3),
            Self::Karman => (1.0 + kl * kl).powf(-4.0 / 3.0),
            Self::Ended => (-kl.powi(8)).exp() / (1.0 + (OUTER * kl).powi(2)),
        }
    }

    /// Wave number times length beyond which waves have less than 0.002 of the variance of the longest: pixels of a whole disc tell more from nothing.
    const fn cut(self) -> f64 {
        match self {
            Self::Smooth => 6.5,
            Self::Karman => f64::INFINITY,
            Self::Ended => 1.27,
        }
    }

    /// Least length worth trying, in blurs: of a shorter one the image shows no more than of a longer one.
    const fn least_length(self) -> f64 {
        match self {
            Self::Smooth => 1.8,
            Self::Karman => 0.0,
            Self::Ended => 1.0,
        }
    }

    /// By how much the lattice repeats itself beyond the region, in semi-axes.
    fn margin(self, length: f64) -> f64 {
        match self {
            Self::Smooth => 3.0 * length,
            Self::Karman => 1.0,
            Self::Ended => (OUTER * length).min(2.0),
        }
    }
}

/// Random light inside the disc.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Field {
    spectrum: Spectrum,
    length: f64,
    pub(super) amplitude: f64,
    pub(super) waves: Vec<[f64; 2]>,
    /// Each in steps of the lattice, their lengths, and the most of them along either axis.
    pub(super) steps: Vec<[i32; 2]>,
    pub(super) spacing: [f64; 2],
    pub(super) most: [usize; 2],
    /// Prior variances of the heights, as the image shows them, for an amplitude of one.
    pub(super) variances: Vec<f64>,
}

impl Field {
    /// The lattice for the disc `e` seen with the blur given.
    pub(super) fn new(spectrum: Spectrum, length: f64, e: &Ellipse, blur_px: f64) -> Self {
        let axes = [e.semi_major_px, e.semi_minor_px];
        let spacing = axes.map(|a| TAU / (2.0 * (1.0 + 2.5 * blur_px / a) + spectrum.margin(length)));
        let most = if on_rim(e, blur_px) { SHORTEST_ON_RIM } else { SHORTEST };
        let shortest = axes.map(|a| (spectrum.cut() / length).min(most * a / blur_px));
        let count = 0.5 * PI * shortest[0] / spacing[0] * shortest[1] / spacing[1];
        let shortest = shortest.map(|k| k * (MOST_WAVES / count).sqrt().min(1.0));
        let most = [0, 1].map(|i| (shortest[i] / spacing[i]) as i32);
        let mut field = Self { spectrum, length, spacing, most: most.map(|m| m as usize), ..Self::default() };
        for i in 0..=most[0] {
            for j in -most[1]..=most[1] {
                let k = [f64::from(i) * spacing[0], f64::from(j) * spacing[1]];
                if (i > 0 || j > 0) && (k[0] / shortest[0]).hypot(k[1] / shortest[1]) < 1.0 {
                    field.waves.push(k);
                    field.steps.push([i, j]);
                    let phase = (k[0] / axes[0]).hypot(k[1] / axes[1]) * blur_px;
                    field.variances.push(spectrum.variance(k[0].hypot(k[1]) * length) * (-phase * phase).exp());
                }
            }
        }
        let sum: f64 = field.variances.iter().sum();
        field.variances.iter_mut().for_each(|v| *v /= sum);
        field
    }

    /// Whether the waves are the same, whatever their variances: so are what pixels see of them, and the products of that.
    fn has_the_waves_of(&self, other: &Self) -> bool {
        self.spacing == other.spacing && self.steps == other.steps
    }

    /// Prior variance of the heights of wave `i`.
    pub(super) fn variance(&self, i: usize) -> f64 {
        self.variances[i] * self.amplitude * self.amplitude
    }
}

#[cfg(test)]
impl State {
    /// A disc in light that a field and a level on either side say.
    pub(super) fn in_smoke(ellipse: Ellipse, blur_px: f64, step: f64, variance: f64, field: Field) -> Self {
        Self {
            ellipse,
            blur_px,
            expected_blur_px: blur_px,
            shape: crate::detect::shape::Shape::GAUSSIAN,
            sides: [Side::plain(0, step); 2],
            field: Some(field),
            slopes: [[0.0; 2]; 2],
            variance: [variance; 2],
            step,
            full_of_smoke: false,
            allow: crate::detect::correlation::Allowance::NONE,
        }
    }
}

/// What one field says.
pub(super) struct Said {
    /// Minus twice the logarithm of its likelihood.
    pub(super) value: f64,
    amplitude: f64,
    change: SVector<f64, FIXED>,
    covariance: SMatrix<f64, 5, 5>,
}

/// What all fields together say of blur and geometry.
#[derive(Debug, Clone, Copy)]
pub(super) struct Verdict {
    pub(super) change: SVector<f64, FIXED>,
    pub(super) covariance: SMatrix<f64, 5, 5>,
    /// Minus twice the logarithm of the likelihood of the likeliest, less that of ground in every pixel: discs that take in more or fewer pixels are compared.
    pub(super) value: f64,
}

impl Exact {
    /// Keeps the step of the light that each pixel feels while another model of the light is tried.
    pub(super) fn hold_steps(&mut self, state: &State) {
        self.held.clear();
        if state.exact_rim() {
            self.held = self.steps_on_rim(state);
            return;
        }
        for start in (0..self.count).step_by(LANES) {
            let lanes = self.profile(state, start);
            for l in 0..LANES.min(self.count - start) {
                let p = start + l;
                let response = self.response[p] / Self::weight(state, self.inside[p]).sqrt();
                self.held.push(if lanes.slope[l].abs() > 1e-6 { response / lanes.slope[l] } else { state.step });
            }
        }
    }

    /// What the fields of one spectrum and length say, with amplitudes uphill from the one given, a factor of `sqrt(2)` apart;
    /// the best is among them. Products stand where the field `before` left them, if it had the same waves.
    fn listen(&mut self, tried: &mut State, start: f64, before: Option<&Field>) -> Vec<Said> {
        let stands = before.zip(tried.field.as_ref()).is_some_and(|(b, f)| f.has_the_waves_of(b));
        if !stands {
            self.sum_up(tried);
        }
        let mut said: Vec<Said> = vec![];
        let mut evaluate = |amplitude: f64| {
            if let Some(f) = &mut tried.field {
                f.amplitude = amplitude;
            }
            let value = self.solve(tried)? + prior_of_amplitude(amplitude, tried);
            said.push(self.said(tried, value, amplitude));
            Some(value)
        };
        let Some(first) = evaluate(start) else { return said };
        let mut best = first;
        for factor in [SQRT_2, SQRT_2.recip()] {
            let mut amplitude = start;
            for _ in 0..12 {
                amplitude *= factor;
                match evaluate(amplitude) {
                    Some(value) if value < best + 4.0 => best = best.min(value),
                    _ => break,
                }
            }
        }
        said
    }

    /// What the fields given and, of a small disc, light without waves say under the noise of the state, that noise and its prior counted;
    /// and the least value of each field. Light without waves has its share beforehand ([`EVEN`]).
    fn listen_to_all(&mut self, state: &State, fields: &[Field], amplitude: f64) -> (Vec<Said>, Vec<f64>) {
        let (mut all, mut bests) = (vec![], vec![]);
        for (i, field) in fields.iter().enumerate() {
            let mut tried = State { field: Some(field.clone()), ..state.clone() };
            let mut said = self.listen(&mut tried, amplitude, i.checked_sub(1).map(|i| &fields[i]));
            let noise = self.price_of_noise(state);
            said.iter_mut().for_each(|s| s.value += noise);
            bests.push(said.iter().map(|s| s.value).fold(f64::INFINITY, f64::min));
            all.extend(said);
        }
        if !is_large(&state.ellipse) {
            let share = 2.0 * (EVEN[usize::from(state.full_of_smoke)] * all.len() as f64).ln();
            let plain = [0, 1].into_iter().filter_map(|degree| self.listen_plainly(state, degree));
            all.extend(plain.map(|s| Said { value: s.value - share, ..s }));
        }
        (all, bests)
    }

    /// Spectrum, length and amplitude with the largest likelihood; no field where none is worth it, beside light without waves, both under
    /// noise inside made louder up to `loudest` times; a field where there is smoke. Unless `afresh`, only the amplitude of a field chosen before is chosen anew.
    pub(super) fn choose_field(&mut self, state: &mut State, afresh: bool, loudest: usize) {
        let before = state.field.take().filter(|f| !afresh && !f.waves.is_empty());
        self.light.clear();
        // A few thousand pixels fix the prior.
        self.thinned = self.count.div_ceil(PRIOR_PIXELS);
        let without = self.without_field(state, loudest);
        let fields = match before {
            Some(f) => vec![f],
            None => self.all_fields(state),
        };
        let large = is_large(&state.ellipse);
        let mut best: Option<(f64, Field)> = None;
        for (i, field) in fields.iter().enumerate() {
            let mut tried = State { field: Some(field.clone()), ..state.clone() };
            let top = self.likeliest(&mut tried, field.amplitude, i.checked_sub(1).map(|i| &fields[i]));
            if let Some((value, amplitude)) = top.filter(|t| best.as_ref().is_none_or(|b| t.0 < b.0)) {
                best = tried.field.map(|f| (value, Field { amplitude, ..f }));
            }
        }
        if let (Some(best), false) = (&mut best, large) {
            self.make_louder(state, best, loudest);
        }
        self.thinned = 1;
        let worth = match (large, state.full_of_smoke) {
            (true, _) => WORTH,
            (false, false) => -AFFORDED,
            (false, true) => f64::NEG_INFINITY,
        };
        state.field = best.filter(|b| without.is_some_and(|w| b.0 + worth < w)).map(|b| b.1);
    }

    /// The likeliest amplitude of the field of `tried`, sought from `start` on, and its value with the price of the noise.
    fn likeliest(&mut self, tried: &mut State, start: f64, before: Option<&Field>) -> Option<(f64, f64)> {
        let said = self.listen(tried, start, before);
        let top = said.iter().min_by(|a, b| a.value.total_cmp(&b.value))?;
        Some((top.value + self.price_of_noise(tried), top.amplitude))
    }

    /// Makes the noise inside louder, up to `loudest` times, as long as the field and the value of `best` gain by it: small discs hardly show
    /// their noise apart from their smoke.
    fn make_louder(&mut self, state: &mut State, (value, field): &mut (f64, Field), loudest: usize) {
        let mut tried = State { field: Some(field.clone()), ..state.clone() };
        for _ in 0..loudest {
            tried.variance[0] *= SQRT_2;
            if tried.variance[0] > loudest_noise(state) {
                break;
            }
            match self.likeliest(&mut tried, field.amplitude, None) {
                Some((now, amplitude)) if now < *value => {
                    (*value, field.amplitude, state.variance[0]) = (now, amplitude, tried.variance[0]);
                }
                _ => break,
            }
        }
    }

    /// Sum of the logarithms of the noise variances of the pixels summed up last, and what the prior of the noise takes for it.
    pub(super) fn price_of_noise(&self, state: &State) -> f64 {
        self.price_of_known_noise(state) + prior_of_noise(state.variance, state.step)
    }

    /// The same of noise that has no prior of its own.
    pub(super) fn price_of_known_noise(&self, state: &State) -> f64 {
        let chosen = (0..self.count).filter(|i| (i / SLICE).is_multiple_of(self.thinned.max(1)));
        chosen.map(|i| -Self::weight(state, self.inside[i]).ln()).sum()
    }

    /// Least value of light that is at most slanted, under the noise inside that explains it best: light carries shot noise that the
    /// ground does not show.
    fn without_field(&mut self, state: &State, loudest: usize) -> Option<f64> {
        let mut least: Option<f64> = None;
        for degree in [0, 1] {
            let mut plain = State { field: None, ..state.clone() };
            let mut quieter = f64::INFINITY;
            for _ in 0..=loudest {
                let value = self.listen_plainly(&plain, degree)?.value;
                if value > quieter {
                    break;
                }
                quieter = value;
                plain.variance[0] *= SQRT_2;
                if plain.variance[0] > loudest_noise(state) {
                    break;
                }
            }
            least = Some(least.map_or(quieter, |x| x.min(quieter)));
        }
        least
    }

    /// What light without waves, of the degree given inside, says under the noise of the state.
    pub(super) fn listen_plainly(&mut self, state: &State, degree: usize) -> Option<Said> {
        let mut plain = State { field: None, ..state.clone() };
        plain.sides[0] = Side { degree, ..plain.sides[0] };
        self.sum_up(&plain);
        let value = self.solve(&plain)? + price_of_slopes(&plain.sides[0]) + self.price_of_noise(&plain);
        Some(self.said(&plain, value, 0.0))
    }

    /// What was solved last.
    fn said(&self, state: &State, value: f64, amplitude: f64) -> Said {
        let lights = Self::lights(state);
        let change = SVector::from_fn(|i, _| self.found[lights + i]);
        Said { value, amplitude, change, covariance: self.dense.covariance }
    }

    fn all_fields(&self, state: &State) -> Vec<Field> {
        let (e, blur_px) = (&state.ellipse, state.blur_px);
        // Nodes follow what turbulence mixes in large discs.
        let large = is_large(e);
        let blur = blur_px / e.mean_radius_px();
        Spectrum::ALL
            .iter()
            .filter(|s| !large || **s == Spectrum::Smooth)
            .flat_map(|s| s.lengths().iter().map(move |l| (*s, *l)))
            .filter(|(s, l)| *l >= s.least_length() * blur)
            .map(|(s, l)| Field { amplitude: 0.15 * state.step.abs(), ..Field::new(s, l, e, blur_px) })
            .collect()
    }

    /// Estimate and covariance averaged over all fields and, where few pixels show it, over the noise inside, each with its likelihood as
    /// weight: what not knowing the kind of light costs, between fields and within each. The state must stand where its own field left it.
    pub(super) fn weigh_fields(&mut self, state: &State) -> Option<Verdict> {
        let amplitude = state.field.as_ref()?.amplitude;
        let own = (self.dense.clone(), self.found.clone(), self.light.clone());
        let free = self.free_in_field(state);
        self.hold_steps(state);
        self.light.clear();
        let fields = self.all_fields(state);
        let (mut all, bests) = self.listen_to_all(state, &fields, amplitude);
        let mut least = bests.iter().copied().fold(f64::INFINITY, f64::min);
        if (1.0..NOISE_KNOWN).contains(&free) {
            let heard = fields.into_iter().zip(&bests).filter(|(_, best)| **best < least + NO_SAY);
            let fields: Vec<Field> = heard.map(|(field, _)| field).collect();
            // Steps of one standard deviation of the logarithm.
            let step = (2.0 / free).sqrt();
            for factor in [step.exp(), (-step).exp()] {
                let mut tried = state.clone();
                for _ in 0..MOST_STEPS {
                    tried.variance[0] *= factor;
                    let (said, bests) = self.listen_to_all(&tried, &fields, amplitude);
                    all.extend(said);
                    let best = bests.into_iter().fold(f64::INFINITY, f64::min);
                    if best > least + FAR {
                        break;
                    }
                    least = least.min(best);
                }
            }
        }
        (self.dense, self.found, self.light) = own;
        all.retain(|s| s.value < least + NO_SAY);
        let weight = |s: &Said| (-0.5 * (s.value - least)).exp();
        let sum: f64 = all.iter().map(weight).sum();
        let change = all.iter().map(|s| s.change * (weight(s) / sum)).sum::<SVector<f64, FIXED>>();
        let covariance = all
            .iter()
            .map(|s| {
                let off = (s.change - change).fixed_rows::<5>(1).into_owned();
                (s.covariance + off * off.transpose()) * (weight(s) / sum)
            })
            .sum();
        let ground = self.count as f64 * (1.0 + state.variance[1].ln());
        Some(Verdict { change, covariance, value: least - ground })
    }

    /// By how much the noise inside differs from that which the fit took, variance over variance: the most likely with its prior,
    /// from squared residuals over the degrees of freedom that the waves left them.
    pub(super) fn noise_in_field(&self, state: &State) -> f64 {
        if self.within.count < 6.0 {
            return 1.0;
        }
        let free = self.free_in_field(state);
        let cost = |factor: f64| {
            let [inside, outside] = state.variance;
            free * factor.ln() + self.within.squares / factor + prior_of_noise([factor * inside, outside], state.step)
        };
        let factors = (-120..=120).map(|i| (0.03 * f64::from(i)).exp());
        factors.min_by(|a, b| cost(*a).total_cmp(&cost(*b))).unwrap_or(1.0)
    }

    /// Degrees of freedom that the waves left the pixels inside.
    pub(crate) fn free_in_field(&self, state: &State) -> f64 {
        let Some(field) = &state.field else { return self.within.count };
        let variances = self.dense.variances(state.heights(), Self::lights(state) + FIXED);
        let spent: f64 = variances.iter().enumerate().map(|(j, v)| 1.0 - v / field.variance(j / 2)).sum();
        self.within.count * (1.0 - (spent / self.within.all).min(0.9))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::exact::tests::{fitted, looked_at};
    use crate::frames::Pixel;
    use crate::stats::random::Random;

    /// Turbulence of any length has the same waves: what one field left says of the next what that says itself.
    #[test]
    fn products_stand_for_all_fields_of_the_same_waves() {
        let (mut exact, state) = fitted();
        let field = |spectrum, length| Field::new(spectrum, length, &state.ellipse, state.blur_px);
        let [short, long] = [0.4, 2.5].map(|length| field(Spectrum::Karman, length));
        assert!(long.has_the_waves_of(&short) && long.variances != short.variances);
        assert!(!long.has_the_waves_of(&field(Spectrum::Smooth, 0.4)));
        exact.light.clear();
        exact.hold_steps(&state);
        let mut listen = |field: &Field, before: Option<&Field>| {
            let said = exact.listen(&mut State { field: Some(field.clone()), ..state.clone() }, 5.0, before);
            said.iter().map(|s| (s.value, s.amplitude, s.change, s.covariance)).collect::<Vec<_>>()
        };
        let alone = listen(&long, None);
        let first = listen(&short, None);
        assert_ne!(first, alone);
        assert_eq!(listen(&long, Some(&short)), alone);
    }

    #[test]
    fn nothing_is_seen_beyond_the_cut() {
        for spectrum in [Spectrum::Smooth, Spectrum::Ended] {
            let beyond = spectrum.variance(spectrum.cut()) / spectrum.variance(0.0);
            assert!(beyond < 0.002, "{spectrum:?}: {beyond}");
        }
    }

    /// By how much light that ends is likelier than light that falls off, twice the logarithm: for a disc of 12 x 10 px full of eight waves, the
    /// longest of 40 px, the shortest as long as its semi-minor axis over `shortest`.
    fn ended_likelier(shortest: f64, seed: u64) -> f64 {
        let ellipse =
            Ellipse { center_px: Pixel::new(22.3, 21.6), semi_major_px: 12.0, semi_minor_px: 10.0, angle_rad: 0.4 };
        let state = State { field: None, ..State::in_smoke(ellipse, 0.8, 60.0, 1.0, Field::default()) };
        let mut random = Random(seed);
        let waves: Vec<[f64; 3]> = (0..8)
            .map(|i| {
                let k = TAU / 40.0 * (4.0 * shortest).powf(f64::from(i) / 7.0);
                let (s, c) = random.in_range(0.0, TAU).sin_cos();
                [k * c, k * s, random.in_range(0.0, TAU)]
            })
            .collect();
        let light = |u: f64, v: f64| {
            let seen = |w: &[f64; 3]| (-0.32 * (w[0] * w[0] + w[1] * w[1])).exp() * (w[0] * u + w[1] * v + w[2]).sin();
            60.0 * (1.0 + 0.1 * waves.iter().map(seen).sum::<f64>())
        };
        let mut exact = looked_at(44, &state, light, || random.gauss());
        exact.sum_up(&state);
        exact.hold_steps(&state);
        let mut best = [f64::INFINITY; 2];
        for field in exact.all_fields(&state) {
            let ended = usize::from(field.spectrum == Spectrum::Ended);
            let mut tried = State { field: Some(field), ..state.clone() };
            let said = exact.likeliest(&mut tried, 9.0, None);
            best[ended] = said.map_or(f64::INFINITY, |s| s.0).min(best[ended]);
        }
        best[0] - best[1]
    }

    /// Six discs: light that ends well before the blur takes it is about as likely to end as to fall off (twice the logarithm within 5 a disc), and light
    /// that goes on does not pass for light that ends.
    #[test]
    fn light_that_goes_on_is_not_seen_to_end() {
        let [ends, goes_on] =
            [1.0, 4.0].map(|shortest| (1..=6).map(|seed| ended_likelier(shortest, seed)).sum::<f64>());
        println!("ended likelier by {ends:.1} and {goes_on:.1}");
        assert!(ends.abs() < 30.0 && goes_on < -1000.0);
    }

    /// Light that no wave may explain asks for louder noise, again and again; it gets what a disc may have and no more.
    #[test]
    fn noise_is_never_made_louder_than_the_step_of_the_light() {
        let (mut exact, mut state) = fitted();
        state.variance = [1e-4; 2];
        state.step = 0.1;
        let quiet = state.variance[0];
        exact.light.clear();
        exact.hold_steps(&state);
        exact.choose_field(&mut state, true, MOST_LOUD);
        println!("noise {:.3e} of {quiet:.1e}, step squared {:.1e}", state.variance[0], state.step.powi(2));
        assert!(state.variance[0] > 10.0 * quiet && state.variance[0] <= state.step.powi(2));
    }
}
