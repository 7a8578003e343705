//! Smoke as a random field: its lattice of waves, its prior, and what not knowing it costs.

use super::{Exact, FIXED, State};
use crate::conic::{Ellipse, from_regular, to_regular};
use crate::detect::band::{LANES, Reach};
use crate::detect::contour::Contour;
use crate::image::GrayView;
use std::f64::consts::TAU;

/// Waves longer than the length of the field over this are left out.
const CUT: f64 = 3.0;
/// Gain in twice the logarithm of the likelihood that a field must bring.
const WORTH: f64 = 16.0;
/// Pixels from which the prior of a field is chosen.
pub(super) const PRIOR_PIXELS: usize = 3000;

/// Random light inside the disc.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Field {
    pub(crate) length: f64,
    pub(crate) amplitude: f64,
    pub(super) waves: Vec<[f64; 2]>,
    /// Prior variances of the heights for an amplitude of one.
    pub(super) variances: Vec<f64>,
}

impl Field {
    /// The lattice for a region of the half sizes given, in units of the semi-axes.
    fn new(length: f64, half: [f64; 2]) -> Self {
        let spacing = half.map(|h| TAU / (2.0 * h + 3.0 * length));
        let most = spacing.map(|d| (CUT / length / d) as i32);
        let mut field = Self { length, amplitude: 0.0, waves: vec![], variances: vec![] };
        for i in 0..=most[0] {
            for j in -most[1]..=most[1] {
                if i == 0 && j <= 0 {
                    continue;
                }
                let k = [f64::from(i) * spacing[0], f64::from(j) * spacing[1]];
                let q = (k[0] * k[0] + k[1] * k[1]) * length * length;
                if q < CUT * CUT {
                    field.waves.push(k);
                    field.variances.push((-0.5 * q).exp());
                }
            }
        }
        let sum: f64 = field.variances.iter().sum();
        field.variances.iter_mut().for_each(|v| *v /= sum);
        field
    }
}

impl Exact {
    /// Keeps the step of the light that each pixel feels while another model of the light is tried.
    pub(super) fn hold_steps(&mut self, state: &State) {
        self.held.clear();
        for start in (0..self.count).step_by(LANES) {
            let lanes = self.profile(state, start);
            for l in 0..LANES.min(self.count - start) {
                let p = start + l;
                let response = self.response[p] / Self::weight(state, self.inside[p]).sqrt();
                self.held.push(if lanes.slope[l].abs() > 1e-6 { response / lanes.slope[l] } else { state.step });
            }
        }
    }

    /// Half the derivatives of `ln det` of the light's block by blur and geometry: a larger disc has more room for light, and explains
    /// more by that alone; the likelihood with the light integrated out takes it back.
    pub(super) fn price_of_room(
        &mut self,
        view: &GrayView,
        state: &State,
        contour: &mut Contour,
        keep: &[bool],
        reach: &dyn Fn(&State) -> Reach,
        cut: &dyn Fn(&mut Contour, &Ellipse),
    ) -> Option<[f64; FIXED]> {
        const STEP_PX: f64 = 0.05;
        let mut tilt = [0.0; FIXED];
        let fixed = reach(state);
        for (i, t) in tilt.iter_mut().enumerate() {
            for sign in [1.0, -1.0] {
                let mut moved = state.clone();
                if i == 0 {
                    moved.blur_px += sign * STEP_PX;
                } else {
                    let mut q = to_regular(&state.ellipse);
                    q[i - 1] += sign * STEP_PX;
                    moved.ellipse = from_regular(&q)?;
                }
                cut(contour, &moved.ellipse);
                let keep: Vec<bool> =
                    (0..contour.len()).map(|k| keep[(k * keep.len() / contour.len()).min(keep.len() - 1)]).collect();
                if !self.look(view, &moved, contour, &keep, fixed) {
                    return None;
                }
                self.sum_up(&moved);
                self.solve(&moved)?;
                let (lights, n) = (Self::lights(&moved), Self::lights(&moved) + FIXED);
                let log_det: f64 = (0..lights).map(|j| 2.0 * self.dense.matrix[j * n + j].ln()).sum();
                *t += 0.5 * sign * log_det / (2.0 * STEP_PX);
            }
        }
        Some(tilt)
    }

    /// Length and amplitude with the largest likelihood; no field where none is worth it.
    pub(super) fn choose_field(&mut self, state: &mut State) {
        let e = &state.ellipse;
        let reach = 2.5 * state.blur_px;
        let half = [1.0 + reach / e.semi_major_px, 1.0 + reach / e.semi_minor_px];
        let least = 1.8 * state.blur_px / (e.semi_major_px * e.semi_minor_px).sqrt();
        let plain = State { field: None, ..state.clone() };
        self.light.clear();
        // A few thousand pixels fix the prior.
        self.thinned = self.count.div_ceil(PRIOR_PIXELS);
        self.sum_up(&plain);
        let Some(without) = self.solve(&plain) else { return self.thinned = 1 };
        let mut best: Option<(f64, Field)> = None;
        for length in [0.27, 0.36, 0.48, 0.64, 0.85, 1.15] {
            if length < least {
                continue;
            }
            let mut tried = State { field: Some(Field::new(length, half)), ..state.clone() };
            self.sum_up(&tried);
            let mut evaluate = |amplitude: f64, best: &mut Option<(f64, Field)>| {
                if let Some(f) = &mut tried.field {
                    f.amplitude = amplitude;
                }
                let value = self.solve(&tried).unwrap_or(f64::INFINITY);
                if best.as_ref().is_none_or(|b| value < b.0) {
                    *best = tried.field.clone().map(|f| (value, f));
                }
                value
            };
            let (mut middle, mut ratio) = (0.15 * state.step.abs(), 2.0);
            let mut value = evaluate(middle, &mut best);
            for _ in 0..2 {
                for factor in [ratio, 1.0 / ratio] {
                    let mut moved = false;
                    for _ in 0..4 {
                        let next = evaluate(middle * factor, &mut best);
                        if next >= value {
                            break;
                        }
                        (middle, value, moved) = (middle * factor, next, true);
                    }
                    if moved {
                        break;
                    }
                }
                ratio = 2.0_f64.sqrt();
            }
        }
        self.thinned = 1;
        state.field = best.filter(|b| b.0 + WORTH < without).map(|b| b.1);
    }
}
