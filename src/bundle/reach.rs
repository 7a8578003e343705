//! How far a number may be from its estimate where equations bend: its profile likelihood.
//!
//! A standard deviation is told by equations that are linear at the estimate. Where a number hangs on another one (the axis point of a lens that distorts by little,
//! on k1) noise changes the standard deviation as well as the number, and the true number may be twice as far off as is told. What holds there:
//!
//! ```text
//! F_p(t)   = min F(x) over q(x) = q_0 + t sigma
//! r(t)     = sign(t) (2 (F_p(t) - F_0))^(1/2)                  t where equations are linear
//! interval = the middle 95 % of exp(-r^2 / 2)                  q_0 -+ 1.96 sigma where equations are linear
//! bend     = rms of ln(sigma(x_0 + C^(1/2) s) / sigma(x_0))    over signs s
//! ```
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | x, x_0 | [`State`] | - | all unknowns; the estimate |
//! | q, q_0, sigma | [`Numbers`] | that of the number | a function of cameras, motion and sheet; its value and linear standard deviation at the estimate |
//! | F, F_0 | [`Problem::cost`], [`Adjustment::model`] | 1 | half of chi-square, with facts; at the estimate |
//! | r | [`Reach::root`] | 1 | signed root of the likelihood ratio, the same in whatever unknowns |
//! | C | [`Near::factor`] | - | covariance of what all views share |
//! | bend | [`Reach::bend`] | 1 | how uncertain a standard deviation is, as a part of it |
//!
//! The bend needs no residuals, and standard deviations one beside the other: a hundred observations of each image tell it, printed discs held
//! where they are estimated. Profiles take all observations, since what bends a cost are its residuals, too. q is held by a row of a thousandth of sigma; r is told at
//! a few places and goes straight between them.
//!
//! Ends where r is 1.96 either way would be those of the likelihood ratio. Where equations bend most they leave out the true number more often than 5 times in 100, as does
//! a standard deviation; the middle of the profile does not (`tests/reach.rs`).
//!
//! Source: Bates and Watts, "Nonlinear regression analysis and its applications" (1988), section 6.1; Venzon and Moolgavkar, "A method for computing
//! profile-likelihood-based confidence intervals" (1988); Berger, Liseo and Wolpert, "Integrated likelihood methods for eliminating nuisance parameters" (1999). Not valid where q is not determined.

use super::adjust::{Adjustment, Bundle};
use super::facts::Row;
use super::image_map::Slot;
use super::layout::{self, Places};
use super::model::Model;
use super::posterior::{Natural, natural};
use super::state::State;
use super::{part, retraction};
use crate::solve::{
    self, FIRST_DAMPING, Gradient, Iteration, NormalEquations, Options, Posterior, Problem, Step, Termination,
    minimise_from, posterior, symmetric_eigen,
};
use crate::threads;
use nalgebra::{DMatrix, DVector};

/// When a profile is near enough to its minimum: what is left is a hundredth of chi-square.
const LIMITS: Options = Options { decrement: 0.1, iterations: 30 };
/// Sigma of the row that holds a number, in its own.
const HELD: f64 = 1e-3;
/// Step of a numerical derivative, in steps up to which the problem is about linear.
const PART: f64 = 1e-4;
/// Distance, in sigmas, of places at which a profile is told.
const APART: f64 = 1.25;
/// How far it is followed, in sigmas.
pub const FURTHEST: f64 = 30.0;
/// Cost above the estimate's beyond which nothing is left that a percentile would feel.
const ENOUGH: f64 = 5.0;
/// Cost that must have been reached where a profile can be followed no further: what is beyond is then taken as going on straight.
const SEEN: f64 = 2.0;
/// Parts of a stretch between two places that are summed.
const PARTS: usize = 64;
/// Signs of the bend: so many patterns, each with its opposite.
const PATTERNS: usize = 4;

/// Told of iterations, maybe from several threads; returns false to stop.
pub type Observe<'a> = &'a (dyn Fn(&Iteration) -> bool + Sync);

/// Numbers that depend on cameras, motion and sheet.
#[derive(Clone, Copy)]
pub struct Numbers<'a> {
    /// Those of an estimate.
    pub of: &'a (dyn Fn(&Natural) -> Option<DVector<f64>> + Sync),
    /// At the estimate.
    pub values: &'a [f64],
    /// Their linear standard deviations; not finite where one is not determined.
    pub sigmas: &'a [f64],
}

impl Numbers<'_> {
    fn at(&self, model: &Model, state: &State) -> Option<DVector<f64>> {
        (self.of)(&natural(model, state)?)
    }

    /// Derivatives of all numbers (columns) by what all views share (rows), by central differences.
    fn gradient(&self, model: &Model, places: &Places, state: &State) -> Option<DMatrix<f64>> {
        // Numbers of which there is no derivative have no list either.
        if self.at(model, state)?.len() != self.values.len() {
            return None;
        }
        let Step { global, blocks } = layout::scales(model, places, state);
        let blocks: Vec<_> = blocks.iter().map(|b| DVector::zeros(b.len())).collect();
        let mut step = Step { global: DVector::zeros(global.len()), blocks };
        let mut out = DMatrix::zeros(global.len(), self.values.len());
        for k in 0..places.offsets.unwrap_or(places.global) {
            let h = PART * global[k];
            let mut at = |h: f64| {
                step.global[k] = h;
                self.at(model, &retraction::retract(model, places, state, &step)?)
            };
            out.set_row(k, &((at(h)? - at(-h)?) / (2.0 * h)).transpose());
            step.global[k] = 0.0;
        }
        Some(out)
    }
}

/// An estimate, ready to be asked how far from it numbers may be.
pub struct Reach<'a> {
    adjustment: &'a Adjustment,
    numbers: Numbers<'a>,
}

impl<'a> Reach<'a> {
    /// About an adjustment at its minimum.
    pub fn of(adjustment: &'a Adjustment, numbers: Numbers<'a>) -> Self {
        Self { adjustment, numbers }
    }

    /// How much the standard deviation of each number changes within that of all unknowns; `None` where nothing can be said.
    pub fn bend(&self) -> Option<Vec<f64>> {
        let model = part::with_few_observations(&self.adjustment.model)?;
        let near = Near::of(&model, &self.adjustment.state, &self.numbers)?;
        let sides: Vec<(usize, f64)> = (0..PATTERNS).flat_map(|p| [(p, 1.0), (p, -1.0)]).collect();
        let all: Option<Vec<Vec<f64>>> = threads::gathered(true, &sides, |(p, side)| near.logarithms(*p, *side));
        let all = all?;
        let mean = |k: usize| all.iter().map(|of| of[k] * of[k]).sum::<f64>() / all.len() as f64;
        Some((0..self.numbers.values.len()).map(|k| mean(k).sqrt()).collect())
    }

    /// The interval that holds number `k` 95 times in 100; none for an end that is not found within thirty standard deviations. `observe` sees each
    /// iteration and returns false to stop.
    pub fn interval(&self, k: usize, observe: Observe<'_>) -> [Option<f64>; 2] {
        let Numbers { values, sigmas, .. } = self.numbers;
        let Some(start) = self.start() else { return [None; 2] };
        let side = |side: f64| self.side(&start, k, side, observe);
        let (below, above) = threads::both(|| side(-1.0), || side(1.0));
        let ends = middle(&below, &above);
        [ends[0].filter(|_| below.ends), ends[1].filter(|_| above.ends)].map(|t| t.map(|t| values[k] + t * sigmas[k]))
    }

    /// r: the signed root of the likelihood ratio with number `k` at `t` standard deviations from its estimate; `None` where no estimate has it there.
    pub fn root(&self, k: usize, t: f64, observe: Observe<'_>) -> Option<f64> {
        self.root_from(&self.start()?, k, t, observe)
    }

    /// Equations at the estimate, from which every profile starts, with their cost: sigmas may have been set anew since the last adjustment.
    fn start(&self) -> Option<NormalEquations> {
        Bundle::of(&self.adjustment.model).linearise(&self.adjustment.state)
    }

    fn root_from(&self, start: &NormalEquations, k: usize, t: f64, observe: Observe<'_>) -> Option<f64> {
        let Adjustment { model, state, .. } = self.adjustment;
        let wanted = self.numbers.values[k] + t * self.numbers.sigmas[k];
        let (bundle, places) = (Bundle::of(model), Places::of(model));
        let held = Held { bundle, model, places, numbers: self.numbers, k, wanted };
        let mut equations = start.clone();
        held.hold(&mut equations, state)?;
        let out = minimise_from(&held, (state.clone(), equations), &LIMITS, FIRST_DAMPING, &mut |i| observe(i));
        let square = 2.0 * (out.cost - start.cost) - out.decrement * out.decrement;
        (out.termination == Termination::Converged).then(|| t.signum() * square.max(0.0).sqrt())
    }

    /// Roots on one side of the estimate, as far as they matter.
    fn side(&self, start: &NormalEquations, k: usize, side: f64, observe: Observe<'_>) -> Side {
        let mut places = vec![(0.0, 0.0)];
        let (mut t, mut apart) = (APART, APART);
        while t < FURTHEST {
            let Some(r) = self.root_from(start, k, side * t, observe).map(f64::abs) else { break };
            let last = places.last().map_or(0.0, |(_, r)| *r);
            places.push((t, r));
            if 0.5 * r * r > ENOUGH {
                break;
            }
            // Where it hardly rises, further on.
            apart *= if r - last < 0.5 * APART { 2.0 } else { 1.0 };
            t += apart;
        }
        let ends = places.last().is_some_and(|(_, r)| 0.5 * r * r > SEEN);
        // As straight on as it went last.
        if let (true, [.., a, b]) = (ends, places.as_slice()) {
            let slope = ((b.1 - a.1) / (b.0 - a.0)).max(0.1);
            places.push((b.0 + 3.0 / slope, b.1 + 3.0));
        }
        Side { places, ends }
    }
}

/// A profile on one side of the estimate.
struct Side {
    /// Distances, in standard deviations, and roots there, both without sign.
    places: Vec<(f64, f64)>,
    /// Whether it rises so far that its end can be told.
    ends: bool,
}

impl Side {
    /// Middles of the parts of all its stretches, with what the profile has of each.
    fn parts(&self) -> impl DoubleEndedIterator<Item = (f64, f64)> + '_ {
        self.places.windows(2).flat_map(|w| {
            let [(t, r), (next, next_r)] = [w[0], w[1]];
            (0..PARTS).map(move |i| {
                let part = (i as f64 + 0.5) / PARTS as f64;
                let root = r + part * (next_r - r);
                (t + part * (next - t), (-0.5 * root * root).exp() * (next - t) / PARTS as f64)
            })
        })
    }
}

/// Ends of the middle 95 % of a profile, in standard deviations.
fn middle(below: &Side, above: &Side) -> [Option<f64>; 2] {
    let all: f64 = below.parts().chain(above.parts()).map(|(_, has)| has).sum();
    let upwards = below.parts().rev().map(|(t, has)| (-t, has)).chain(above.parts());
    let downwards = above.parts().rev().chain(below.parts().map(|(t, has)| (-t, has)));
    [percentile(upwards, 0.025 * all), percentile(downwards, 0.025 * all)]
}

/// Where a sum comes to a given part, straight between the middles of its parts.
fn percentile(parts: impl Iterator<Item = (f64, f64)>, wanted: f64) -> Option<f64> {
    let (mut sum, mut last) = (0.0, None);
    for (t, has) in parts {
        // The half of a part lies before its middle.
        let here = sum + 0.5 * has;
        if here >= wanted {
            return Some(
                last.map_or(t, |(before, at): (f64, f64)| at + (t - at) * (wanted - before) / (here - before)),
            );
        }
        (sum, last) = (sum + has, Some((here, t)));
    }
    None
}

/// What is near an estimate, as a part of the observations tells it.
struct Near<'a> {
    model: &'a Model,
    state: &'a State,
    numbers: &'a Numbers<'a>,
    places: Places,
    posterior: Posterior,
    /// C^(1/2), columns by falling size.
    factor: DMatrix<f64>,
    /// Standard deviations of the numbers by this part.
    sigmas: DVector<f64>,
}

impl<'a> Near<'a> {
    fn of(model: &'a Model, state: &'a State, numbers: &'a Numbers<'a>) -> Option<Self> {
        let places = Places::of(model);
        let posterior = posterior(&Bundle::with_views(model).linearise(state)?);
        let scales = layout::scales(model, &places, state).global;
        let n = scales.len();
        let eigen =
            symmetric_eigen(&DMatrix::from_fn(n, n, |i, j| posterior.global[(i, j)] / (scales[i] * scales[j])))?;
        let factor = DMatrix::from_fn(n, n, |i, j| {
            eigen.vectors[(i, n - 1 - j)] * eigen.values[n - 1 - j].max(0.0).sqrt() * scales[i]
        });
        let mut out = Self { model, state, numbers, places, posterior, factor, sigmas: DVector::zeros(0) };
        out.sigmas = out.sigmas_at(state, &out.posterior)?;
        // The part knows less than all observations do: as far as those say.
        let mut ratios: Vec<f64> = numbers.sigmas.iter().zip(out.sigmas.iter()).map(|(all, part)| all / part).collect();
        ratios.retain(|r| r.is_finite());
        ratios.sort_by(f64::total_cmp);
        out.factor *= *ratios.get(ratios.len() / 2)?;
        Some(out)
    }

    fn sigmas_at(&self, state: &State, posterior: &Posterior) -> Option<DVector<f64>> {
        let gradient = self.numbers.gradient(self.model, &self.places, state)?;
        Some((gradient.tr_mul(&posterior.global) * gradient).diagonal().map(|v| v.max(0.0).sqrt()))
    }

    /// Logarithms of the numbers' standard deviations at one of the patterns, beside the estimate's.
    fn logarithms(&self, pattern: usize, side: f64) -> Option<Vec<f64>> {
        let signs = DVector::from_fn(self.factor.ncols(), |i, _| {
            if (i & pattern).count_ones().is_multiple_of(2) { side } else { -side }
        });
        let global = &self.factor * signs;
        let blocks = self.posterior.blocks.iter().map(|b| -(b.coupling() * &global)).collect();
        let bundle = Bundle::with_views(self.model);
        let state = bundle.retract(self.state, &Step { global, blocks })?;
        let sigmas = self.sigmas_at(&state, &posterior(&bundle.linearise(&state)?))?;
        Some(sigmas.iter().zip(self.sigmas.iter()).map(|(there, here)| (there / here).ln()).collect())
    }
}

/// The problem with a number held.
struct Held<'a> {
    bundle: Bundle<'a>,
    model: &'a Model,
    places: Places,
    numbers: Numbers<'a>,
    k: usize,
    wanted: f64,
}

impl Held<'_> {
    fn row_sigma(&self) -> f64 {
        HELD * self.numbers.sigmas[self.k]
    }

    fn residual(&self, state: &State) -> Option<f64> {
        Some((self.numbers.at(self.model, state)?[self.k] - self.wanted) / self.row_sigma())
    }

    /// Adds the row that holds the number.
    fn hold(&self, e: &mut NormalEquations, state: &State) -> Option<()> {
        let gradient = self.numbers.gradient(self.model, &self.places, state)?;
        let by = |k: usize| (Slot::Global(k), gradient[(k, self.k)] / self.row_sigma());
        let slots = (0..gradient.nrows()).map(by).filter(|(_, by)| *by != 0.0).collect();
        let row = Row { view: 0, residual: self.residual(state)?, slots };
        self.bundle.add_row(e, &row);
        Some(())
    }
}

impl Problem for Held<'_> {
    type State = State;
    fn layout(&self) -> solve::Layout {
        self.bundle.layout()
    }
    fn cost(&self, state: &State) -> Option<f64> {
        Some(self.bundle.cost(state)? + 0.5 * self.residual(state)?.powi(2))
    }
    fn linearise(&self, state: &State) -> Option<NormalEquations> {
        let mut e = self.bundle.linearise(state)?;
        self.hold(&mut e, state)?;
        Some(e)
    }
    fn scales(&self, state: &State) -> Step {
        self.bundle.scales(state)
    }
    fn bend(&self, state: &State, velocity: &Step) -> Option<Gradient> {
        self.bundle.bend(state, velocity)
    }
    fn retract(&self, state: &State, step: &Step) -> Option<State> {
        self.bundle.retract(state, step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn side(root: impl Fn(f64) -> f64, to: f64) -> Side {
        Side { places: (0..=200).map(|i| to * f64::from(i) / 200.0).map(|t| (t, root(t))).collect(), ends: true }
    }

    /// Of a normal distribution, of one that is wider above, and of an exponential one against their percentiles in closed form.
    #[test]
    fn the_middle_of_a_profile_is_that_of_its_distribution() {
        let ends = |below: &Side, above: &Side| middle(below, above).map(Option::unwrap);
        let few = || Side { places: [0.0, 1.25, 2.5, 3.75, 6.75].map(|t| (t, t)).to_vec(), ends: true };
        let [low, high] = ends(&few(), &few());
        assert!((low + 1.959964).abs() < 2e-3 && (high - 1.959964).abs() < 2e-3, "{low} {high}");
        // 1 and 3 standard deviations either side: a quarter of it below.
        let [low, high] = ends(&side(|t| t, 7.0), &side(|t| t / 3.0, 21.0));
        // 2.5 % of all are a tenth of that quarter, and a thirtieth of the rest: beyond these numbers either way.
        let (tenth, thirtieth) = (1.644854, 2.128045);
        assert!((low + tenth).abs() < 2e-3 && (high - 3.0 * thirtieth).abs() < 6e-3, "{low} {high}");
        let nothing = Side { places: vec![(0.0, 0.0), (1e-9, 9.0)], ends: true };
        let [low, high] = ends(&nothing, &side(|t| (2.0 * t).sqrt(), 30.0));
        let of = |part: f64| -(part.ln());
        assert!((low / of(0.975) - 1.0).abs() < 0.05 && (high / of(0.025) - 1.0).abs() < 2e-3, "{low} {high}");
    }
}
