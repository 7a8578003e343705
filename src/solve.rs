//! Levenberg-Marquardt on numbers: block-arrow normal equations, Schur elimination, stop on the Newton decrement.
//!
//! Minimises `F(x) = 1/2 sum rho(|r_i(x)|^2)`. The unknowns fall into one global part g and blocks v (the views) that
//! only meet through g:
//!
//! ```text
//! H = | H_gg   H_gv |      b = -gradient,   (H + mu D) step = b,   D = diag(1 / scale^2)
//!     | H_vg   H_vv |
//! S      = H_gg - sum_v H_gv H_vv^-1 H_vg                      reduced matrix (Schur complement)
//! delta  = sqrt(b^T H^-1 b)                                    Newton decrement, in sigmas
//! ```
//! The decrement is the length of the remaining Newton step in units of the estimate's own standard deviations: below
//! 1e-6 nothing that is left can matter, whatever the units, also in a weak valley where the cost no longer moves.
//!
//! | symbol | identifier | shape | meaning |
//! |---|---|---|---|
//! | H_gg, b_g | [`NormalEquations::h_gg`], `b_g` | n x n, n | global part |
//! | H_vv, H_vg, b_v | [`Block`] | d x d, d x n, d | one view |
//! | scale | [`Problem::scales`] | n, d | step of each unknown up to which the problem is about linear |
//! | mu | `mu` | 1 | damping |
//! | rho | `gain` | 1 | cost decrease over predicted decrease; radius law of Nielsen |
//!
//! Source: Marquardt (1963); Nielsen, "Damping parameter in Marquardt's method" (1999); Triggs et al., "Bundle
//! adjustment - a modern synthesis" (2000), section 6.
//!
//! Damping by `diag(H)` (Marquardt) would be the usual choice. Here it stalls: strongly seen unknowns form weak, curved
//! combinations, and a damping that is small against the diagonal is still large against the valley. The scales are
//! those on which the *problem* bends, so strong directions are never damped and weak ones only as far as they bend.
//!
//! Where steps still bend, the geodesic acceleration `a = -(H + mu D)^-1 J^T r_vv` goes with the velocity: `step = v + a / 2`,
//! refused where `|a| > 0.75 |v|` (Transtrum and Sethna, "Improvements to the Levenberg-Marquardt algorithm for nonlinear
//! least-squares minimization", 2012).
//!
//! Close to the minimum the gradients of the last steps tell what Gauss-Newton leaves out (`solve/secant.rs`).
//!
//! This room knows numbers, never cameras. Not for problems whose blocks meet each other directly.

mod evidence;
mod factor;
mod flat;
mod open;
mod posterior;
mod reduced;
mod score;
mod secant;
mod tiles;

pub use evidence::{evidence, likely_mean};
pub use factor::{SymmetricEigen, symmetric_eigen};
pub use open::OpenCombinations;
pub use posterior::{BlockPosterior, Posterior, global_covariance, posterior};
pub use score::{Prediction, Score, ScoreTests, predict};

use nalgebra::{DMatrix, DVector};
use reduced::{Reduced, Ridge};
use secant::Memory;

/// Sizes of the unknowns.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// Number of global unknowns.
    pub global: usize,
    /// Number of unknowns of each block.
    pub blocks: Vec<usize>,
}

/// One block (a view) of the normal equations.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// `H_vv`, d x d.
    pub h_vv: DMatrix<f64>,
    /// `H_vg`, d x n.
    pub h_vg: DMatrix<f64>,
    /// `b_v`, d.
    pub b_v: DVector<f64>,
}

/// Gauss-Newton normal equations of block-arrow shape.
#[derive(Debug, Clone, PartialEq)]
pub struct NormalEquations {
    /// Global part of H, n x n.
    pub h_gg: DMatrix<f64>,
    /// Global part of the negative gradient, n.
    pub b_g: DVector<f64>,
    /// The views.
    pub blocks: Vec<Block>,
    /// What is known beforehand of global unknowns alone; `h_gg` holds it as well.
    pub known: Known,
    /// Cost at the point of linearisation.
    pub cost: f64,
}

/// What is known beforehand.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Known {
    /// Whitened rows: unknowns and the derivatives by them.
    pub rows: Vec<Vec<(usize, f64)>>,
    /// By how much one standard deviation of a direction that nothing else determines may move each of the first unknowns, and the others by any amount: what is known
    /// to less is not known.
    pub reach: Vec<f64>,
}

impl Known {
    /// Of some unknowns, in the order of `at`; rows of others as well are left away.
    fn of(&self, at: &[usize]) -> Self {
        let place = |i: usize| at.iter().position(|b| *b == i);
        let row = |r: &Vec<(usize, f64)>| r.iter().map(|(i, d)| Some((place(*i)?, *d))).collect::<Option<_>>();
        let reach = at.iter().map(|i| self.reach.get(*i).copied().unwrap_or(f64::INFINITY));
        Self { rows: self.rows.iter().filter_map(row).collect(), reach: reach.collect() }
    }
}

impl NormalEquations {
    /// Zero equations of this layout.
    pub fn zeros(layout: &Layout) -> Self {
        let n = layout.global;
        let block =
            |&d: &usize| Block { h_vv: DMatrix::zeros(d, d), h_vg: DMatrix::zeros(d, n), b_v: DVector::zeros(d) };
        Self {
            h_gg: DMatrix::zeros(n, n),
            b_g: DVector::zeros(n),
            blocks: layout.blocks.iter().map(block).collect(),
            known: Known::default(),
            cost: 0.0,
        }
    }
}

/// A right-hand side: the shape of [`NormalEquations::b_g`] and the blocks' `b_v`.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// Of the global unknowns.
    pub global: DVector<f64>,
    /// Of each block.
    pub blocks: Vec<DVector<f64>>,
}

/// A step of all unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Of the global unknowns.
    pub global: DVector<f64>,
    /// Of each block.
    pub blocks: Vec<DVector<f64>>,
}

/// What the solver needs to know about a problem.
pub trait Problem {
    /// A point in the space of unknowns; need not be a vector.
    type State: Clone;
    /// Sizes of the unknowns.
    fn layout(&self) -> Layout;
    /// Cost, or `None` where the state has no meaning (a point behind a camera): the step is then rejected.
    fn cost(&self, state: &Self::State) -> Option<f64>;
    /// Normal equations at the state, with the cost ([`Problem::cost`] up to rounding); `None` as for that.
    fn linearise(&self, state: &Self::State) -> Option<NormalEquations>;
    /// For each unknown the step up to which the problem is about linear (units of the unknown, positive).
    fn scales(&self, state: &Self::State) -> Step;
    /// Right-hand side `-J^T r_vv` of the geodesic acceleration: `r_vv` is the second derivative of the residuals along the
    /// retraction of `velocity`. `None` where the problem does not offer it.
    fn bend(&self, _state: &Self::State, _velocity: &Step) -> Option<Gradient> {
        None
    }
    /// The state after a step; `None` where there is none.
    fn retract(&self, state: &Self::State, step: &Step) -> Option<Self::State>;
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Newton decrement, in sigmas, below which the minimum is reached.
    pub decrement: f64,
    /// Most steps.
    pub iterations: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { decrement: 1e-6, iterations: 300 }
    }
}

/// Why the iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The Newton decrement fell below its limit.
    Converged,
    /// The limit of iterations came first.
    IterationLimit,
    /// No step, however short, lowers the cost.
    Stalled,
    /// The caller asked to stop.
    Cancelled,
    /// The start itself has no meaning.
    BadStart,
}

impl Termination {
    /// The word for it in files and reports.
    pub fn word(self) -> &'static str {
        match self {
            Termination::Converged => "converged",
            Termination::IterationLimit => "iteration limit",
            Termination::Stalled => "stalled",
            Termination::Cancelled => "cancelled",
            Termination::BadStart => "bad start",
        }
    }
}

/// Progress of one iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// Linearisations so far.
    pub number: usize,
    /// Current cost.
    pub cost: f64,
    /// Newton decrement, in sigmas; while it is far above the limit, that of the damped step ahead, which is at most as long.
    pub decrement: f64,
}

/// Where the iteration ended.
#[derive(Debug, Clone)]
pub struct Outcome<S> {
    /// Best state.
    pub state: S,
    /// Its cost.
    pub cost: f64,
    /// Its Newton decrement, in sigmas.
    pub decrement: f64,
    /// Linearisations at states that were reached; a step that was tried and refused may have cost one besides.
    pub iterations: usize,
    /// Damping of the step that would have come next.
    pub damping: f64,
    /// Why it ended.
    pub termination: Termination,
    /// Normal equations at the state (`None` only for a bad start).
    pub equations: Option<NormalEquations>,
}

/// Ridge, times the diagonal of H, with which the "undamped" Newton decrement is computed: it bounds what rounding in an exactly flat
/// direction can add to about 1e-8 sigmas, and changes a direction determined to one part in 1e5 by one percent.
const FLAT_RIDGE: f64 = 1e-12;
/// Residuals up to which a cost far below their number still has its rounding judged rightly.
const FEW_RESIDUALS: f64 = 2000.0;
/// Damping beyond which steps are too short to matter: scales times 1e-12 for residuals of 1e6 sigmas.
const MU_MAX: f64 = 1e24;
/// Damping below which it cannot be felt.
const MU_MIN: f64 = 1e-9;

/// Damping from which a start of unknown quality is left.
pub const FIRST_DAMPING: f64 = 1.0;
/// A damped decrement may exceed that with [`FLAT_RIDGE`] by what rounding adds in flat directions: by no more than this times the
/// limit is the latter worth its elimination.
const NEAR: f64 = 1e3;

/// Minimises a problem from a start. `observe` sees every iteration and returns false to cancel.
pub fn minimise<P: Problem>(
    problem: &P,
    start: P::State,
    options: &Options,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Outcome<P::State> {
    minimise_damped(problem, start, options, FIRST_DAMPING, observe)
}

/// The same with a damping to begin with: a start known to be good needs less than [`FIRST_DAMPING`].
pub fn minimise_damped<P: Problem>(
    problem: &P,
    start: P::State,
    options: &Options,
    damping: f64,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Outcome<P::State> {
    match problem.linearise(&start) {
        Some(equations) => minimise_from(problem, (start, equations), options, damping, observe),
        None => Outcome {
            state: start,
            cost: f64::INFINITY,
            decrement: f64::INFINITY,
            iterations: 0,
            damping,
            termination: Termination::BadStart,
            equations: None,
        },
    }
}

/// The same where the normal equations at the start are at hand.
pub fn minimise_from<P: Problem>(
    problem: &P,
    (mut state, mut equations): (P::State, NormalEquations),
    options: &Options,
    damping: f64,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Outcome<P::State> {
    let mut radius = Damping { mu: damping, growth: GROWTH, bent: false };
    let mut memory = Memory::default();
    let mut iterations = 1;
    let (mut left, termination) = loop {
        let scales = problem.scales(&state);
        let reduced = Reduced::of(&equations, &Ridge::Scaled { mu: radius.mu, scales: &scales });
        let ahead = reduced.as_ref().map_or(0.0, Reduced::decrement);
        let far = ahead > NEAR * options.decrement;
        let seen = if far { ahead } else { decrement(&equations) };
        let exact = || if far { decrement(&equations) } else { seen };
        if !observe(&Iteration { number: iterations, cost: equations.cost, decrement: seen }) {
            break (exact(), Termination::Cancelled);
        }
        if !far && seen < options.decrement {
            break (seen, Termination::Converged);
        }
        if iterations >= options.iterations {
            break (exact(), Termination::IterationLimit);
        }
        match accepted_step(problem, &state, (&equations, reduced), (&mut radius, &mut memory), &scales) {
            Some(next) => {
                memory.learn(next.step, seen, &equations, &next.equations);
                (state, equations) = (next.state, next.equations);
            }
            None => break (exact(), Termination::Stalled),
        }
        iterations += 1;
    };
    if !left.is_finite() {
        left = f64::INFINITY;
    }
    let cost = equations.cost;
    let damping = radius.mu;
    Outcome { state, cost, decrement: left, iterations, damping, termination, equations: Some(equations) }
}

struct Damping {
    mu: f64,
    growth: f64,
    /// The last step did not do what the straight model said.
    bent: bool,
}

/// By how much the damping grows after the first refused step; then twice that, and so on.
const GROWTH: f64 = 4.0;
/// Gain below which a step counts as bent.
const STRAIGHT_GAIN: f64 = 0.9;
/// Largest acceleration over velocity.
const BEND_LIMIT: f64 = 0.75;

/// Shortens the step until the cost falls; `None` where nothing helps. With the equations come those eliminated with the damping at hand.
fn accepted_step<'a, P: Problem>(
    problem: &P,
    state: &P::State,
    (equations, mut reduced): (&'a NormalEquations, Option<Reduced<'a>>),
    (damping, memory): (&mut Damping, &mut Memory),
    scales: &'a Step,
) -> Option<Trial<P::State>> {
    let mut remembered = reduced.as_ref().and_then(|r| memory.step(equations, r));
    while damping.mu < MU_MAX {
        let with_memory = remembered.is_some();
        let plain = || plain_step(problem, state, reduced.as_ref()?, damping, scales);
        let tried = remembered.take().or_else(plain);
        if let Some(trial) = tried.and_then(|step| judged(problem, state, equations, step, damping)) {
            // Nielsen's law, allowed to fall by 100 so that the weak valley is undamped after few good steps.
            let factor = (1.0 - (2.0 * trial.gain - 1.0).powi(3)).clamp(0.01, 2.0);
            *damping =
                Damping { mu: (damping.mu * factor).max(MU_MIN), growth: GROWTH, bent: trial.gain < STRAIGHT_GAIN };
            return Some(trial);
        }
        if with_memory {
            memory.clear();
            continue;
        }
        damping.mu *= damping.growth;
        damping.growth *= 2.0;
        damping.bent = true;
        reduced = Reduced::of(equations, &Ridge::Scaled { mu: damping.mu, scales });
    }
    None
}

/// Length of a step in units of the scales.
fn length(step: &Step, scales: &Step) -> f64 {
    let part = |d: &DVector<f64>, s: &DVector<f64>| d.component_div(s).norm_squared();
    let blocks: f64 = step.blocks.iter().zip(&scales.blocks).map(|(d, s)| part(d, s)).sum();
    (part(&step.global, &scales.global) + blocks).sqrt()
}

struct Trial<S> {
    state: S,
    equations: NormalEquations,
    step: Step,
    gain: f64,
}

/// The damped step, with its acceleration where steps bend, and by how much it should lower the cost; none where it bends too much.
fn plain_step<P: Problem>(
    problem: &P,
    state: &P::State,
    reduced: &Reduced,
    damping: &Damping,
    scales: &Step,
) -> Option<(Step, f64)> {
    let velocity = reduced.step();
    let mut step = velocity.clone();
    if damping.bent
        && let Some(rhs) = problem.bend(state, &velocity)
    {
        let acceleration = reduced.solve(&rhs)?;
        if length(&acceleration, scales) > BEND_LIMIT * length(&velocity, scales) {
            return None;
        }
        step.global += &acceleration.global * 0.5;
        step.blocks.iter_mut().zip(&acceleration.blocks).for_each(|(s, a)| *s += a * 0.5);
    }
    Some((step, reduced.predicted_decrease(&velocity)))
}

/// Takes a step that should lower the cost by as much as `predicted`; none where it does not lower it.
fn judged<P: Problem>(
    problem: &P,
    state: &P::State,
    equations: &NormalEquations,
    (step, predicted): (Step, f64),
    damping: &Damping,
) -> Option<Trial<P::State>> {
    let next = problem.retract(state, &step)?;
    // Most first steps are accepted and want their equations anyway, which hold the cost; after a refusal the cost alone comes first.
    let linearised = if damping.growth > GROWTH { None } else { Some(problem.linearise(&next)?) };
    let decrease = equations.cost - linearised.as_ref().map_or_else(|| problem.cost(&next), |e| Some(e.cost))?;
    let linearise = || linearised.or_else(|| problem.linearise(&next));
    // Pixels of size 1e3 and sigmas of 0.01 px leave 1e-11 in a whitened residual, hence at most 1e-11 sum |r| in the cost, and
    // sum |r| <= sqrt(2 n cost): by the cost itself where residuals are of one sigma, more where a good fit leaves less.
    let rounding = 1e-11 * (equations.cost + FEW_RESIDUALS.sqrt() * equations.cost.sqrt());
    if predicted > rounding || decrease.abs() > rounding {
        let gain = decrease / predicted;
        if !(gain > 1e-4) {
            return None;
        }
        return linearise().map(|equations| Trial { state: next, equations, step, gain });
    }
    // Below rounding the cost cannot judge a step: the gradient has to. Where residuals bend more than the valley is steep,
    // an undamped step overshoots, and only this notices.
    let next_equations = linearise()?;
    let left = decrement(&next_equations) / decrement(equations);
    // Little may be gained only because the damping still holds the weak valley: it falls, and an overshoot raises it again.
    (left < 1.0).then_some(Trial { state: next, equations: next_equations, step, gain: 1.0 })
}

/// Newton decrement of normal equations, infinite where they are not positive.
fn decrement(equations: &NormalEquations) -> f64 {
    Reduced::of(equations, &Ridge::Relative(FLAT_RIDGE)).map_or(f64::INFINITY, |r| r.decrement())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Exponential decays with a common rate: each block has its own amplitude, the rate is global.
    struct Decay {
        data: Vec<Vec<f64>>,
    }
    impl Decay {
        fn rows(&self, s: &(f64, Vec<f64>)) -> Vec<(usize, f64, f64, f64)> {
            let mut rows = vec![];
            for (v, ys) in self.data.iter().enumerate() {
                for (i, y) in ys.iter().enumerate() {
                    let t = i as f64 * 0.3;
                    let e = (-s.0 * t).exp();
                    rows.push((v, s.1[v] * e - y, -s.1[v] * t * e, e));
                }
            }
            rows
        }
    }
    impl Problem for Decay {
        type State = (f64, Vec<f64>);
        fn layout(&self) -> Layout {
            Layout { global: 1, blocks: vec![1; self.data.len()] }
        }
        fn cost(&self, s: &Self::State) -> Option<f64> {
            (s.0 > 0.0).then(|| self.rows(s).iter().map(|r| 0.5 * r.1 * r.1).sum())
        }
        fn linearise(&self, s: &Self::State) -> Option<NormalEquations> {
            let mut n = NormalEquations::zeros(&self.layout());
            n.cost = self.cost(s)?;
            for (v, r, jg, jv) in self.rows(s) {
                n.h_gg[(0, 0)] += jg * jg;
                n.b_g[0] -= jg * r;
                let b = &mut n.blocks[v];
                b.h_vv[(0, 0)] += jv * jv;
                b.h_vg[(0, 0)] += jv * jg;
                b.b_v[0] -= jv * r;
            }
            Some(n)
        }
        fn scales(&self, _: &Self::State) -> Step {
            Step { global: DVector::from_element(1, 0.3), blocks: vec![DVector::from_element(1, 1.0); self.data.len()] }
        }
        fn retract(&self, s: &Self::State, d: &Step) -> Option<Self::State> {
            Some((s.0 + d.global[0], s.1.iter().zip(&d.blocks).map(|(a, b)| a + b[0]).collect()))
        }
    }

    fn decay() -> Decay {
        let noise = |v: usize, i: usize| 0.01 * ((v * 31 + i * 17) as f64 * 1.7).sin();
        let curve =
            |v: usize| (0..12).map(|i| (1.0 + v as f64) * (-0.7 * i as f64 * 0.3).exp() + noise(v, i)).collect();
        Decay { data: (0..3).map(curve).collect() }
    }

    #[test]
    fn reaches_the_stationary_point_and_says_so() {
        let p = decay();
        let out = minimise(&p, (3.0, vec![0.2; 3]), &Options::default(), &mut |_| true);
        assert_eq!(out.termination, Termination::Converged);
        assert!(out.decrement < 1e-6);
        // Stationary: the cost rises in every coordinate direction.
        for (dg, dv) in [(1e-4, 0.0), (-1e-4, 0.0), (0.0, 1e-4), (0.0, -1e-4)] {
            let moved = (out.state.0 + dg, out.state.1.iter().map(|a| a + dv).collect());
            assert!(p.cost(&moved).unwrap() > out.cost);
        }
    }

    #[test]
    fn covariance_is_the_inverse_of_the_full_matrix() {
        let p = decay();
        let out = minimise(&p, (1.0, vec![1.0; 3]), &Options::default(), &mut |_| true);
        let rows = p.rows(&out.state);
        let mut h = DMatrix::<f64>::zeros(4, 4);
        for (v, _, jg, jv) in rows {
            let mut j = DVector::zeros(4);
            (j[0], j[1 + v]) = (jg, jv);
            h += &j * j.transpose();
        }
        let full = h.try_inverse().unwrap();
        let post = posterior(out.equations.as_ref().unwrap());
        assert_eq!(post.nullity, 0);
        assert!((post.global[(0, 0)] - full[(0, 0)]).abs() < 1e-12 * full[(0, 0)]);
        for v in 0..3 {
            let b = &post.blocks[v];
            assert!((b.own[(0, 0)] - full[(1 + v, 1 + v)]).abs() < 1e-12 * full[(1 + v, 1 + v)]);
            assert!((b.with_global[(0, 0)] - full[(1 + v, 0)]).abs() < 1e-12 * full[(0, 0)]);
        }
        let all = post.full();
        assert!((all - full).norm() < 1e-12);
    }

    #[test]
    fn cancel_and_bad_start_are_said() {
        let p = decay();
        let out = minimise(&p, (3.0, vec![0.2; 3]), &Options::default(), &mut |i| i.number < 2);
        assert_eq!((out.termination, out.iterations), (Termination::Cancelled, 2));
        let out = minimise(&p, (-1.0, vec![0.2; 3]), &Options::default(), &mut |_| true);
        assert_eq!(out.termination, Termination::BadStart);
    }

    #[test]
    fn a_flat_direction_is_counted_and_does_not_hinder() {
        // Two global unknowns of which only the sum is seen.
        struct Sum;
        impl Problem for Sum {
            type State = [f64; 2];
            fn layout(&self) -> Layout {
                Layout { global: 2, blocks: vec![] }
            }
            fn cost(&self, s: &[f64; 2]) -> Option<f64> {
                let r = s[0] + s[1] - 3.0;
                Some(0.5 * r * r)
            }
            fn linearise(&self, s: &[f64; 2]) -> Option<NormalEquations> {
                let r = s[0] + s[1] - 3.0;
                let mut n = NormalEquations::zeros(&self.layout());
                n.h_gg.fill(1.0);
                n.b_g.fill(-r);
                n.cost = 0.5 * r * r;
                Some(n)
            }
            fn scales(&self, _: &[f64; 2]) -> Step {
                Step { global: DVector::from_element(2, 1.0), blocks: vec![] }
            }
            fn retract(&self, s: &[f64; 2], d: &Step) -> Option<[f64; 2]> {
                Some([s[0] + d.global[0], s[1] + d.global[1]])
            }
        }
        let out = minimise(&Sum, [0.0, 0.5], &Options::default(), &mut |_| true);
        assert_eq!(out.termination, Termination::Converged);
        assert!((out.state[0] + out.state[1] - 3.0).abs() < 1e-6);
        let post = posterior(out.equations.as_ref().unwrap());
        assert_eq!(post.nullity, 1);
        let n = post.null_movements.column(0);
        assert!((n[0] + n[1]).abs() < 1e-12 && n[0].abs() > 0.5);
    }
}
