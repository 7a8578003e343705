//! What Gauss-Newton leaves out of the curvature, learnt from how the gradient changes.
//!
//! The true curvature is `H + S`, `S = sum r_i grad^2 r_i`. In a weak direction, seen by residuals that bend, S may be as large as H: then steps of
//! Gauss-Newton shrink (S < 0: they fall short; S > 0: they overshoot) by `|S| / H` each, however close the minimum. Once
//! steps are short, pairs of a step `s` and the change `y = (H + S) s` of the gradient tell S where it matters: the step is that of limited-memory
//! BFGS about the present H with its damping,
//!
//! ```text
//! q = b;   newest to oldest:  alpha = s.q / s.y,  q -= alpha y;   r = H^-1 q;   oldest to newest:  r += s (alpha - y.r / s.y)
//! ```
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | s, y | `Pair::step`, `Pair::change` | an accepted step, and the gradient behind it less that before it |
//! | b | [`NormalEquations::b_g`], `b_v` | negative gradient |
//!
//! Source: Nocedal and Wright, "Numerical optimization" (2006), algorithm 7.4; Dennis, Gay and Welsch, "An adaptive nonlinear least-squares
//! algorithm" (1981), for why S is worth having.
//!
//! Not valid far from the minimum, where S changes from step to step.

use super::reduced::Reduced;
use super::{Block, Gradient, NormalEquations, Step};
use nalgebra::DVector;

/// Newton decrement, in sigmas, below which steps are short.
const SHORT: f64 = 1.0;
/// Pairs at most: as many weak directions may bend.
const MOST: usize = 6;
/// `s.y / s^T H s`, within which a pair is believed.
const BELIEVED: std::ops::Range<f64> = 0.02..50.0;
/// By how much it must differ from one for the first pair: where Gauss-Newton is nearly right the next H says more than the last gradients.
const WORTH: f64 = 0.3;
/// Least share of H in what the first step was solved with: one that the damping made short says nothing of a minimum.
const OWN: f64 = 0.5;

struct Pair {
    step: Step,
    change: Gradient,
    /// s.y
    product: f64,
}

/// The latest pairs, oldest first.
#[derive(Default)]
pub(super) struct Memory {
    pairs: Vec<Pair>,
}

/// `x += factor y`, list by list.
fn add(x: (&mut DVector<f64>, &mut [DVector<f64>]), factor: f64, y: (&DVector<f64>, &[DVector<f64>])) {
    x.0.axpy(factor, y.0, 1.0);
    x.1.iter_mut().zip(y.1).for_each(|(x, y)| x.axpy(factor, y, 1.0));
}

fn dot(step: &Step, gradient: &Gradient) -> f64 {
    step.global.dot(&gradient.global) + step.blocks.iter().zip(&gradient.blocks).map(|(s, g)| s.dot(g)).sum::<f64>()
}

/// `b`, the negative gradient.
fn downhill(e: &NormalEquations) -> Gradient {
    Gradient { global: e.b_g.clone(), blocks: e.blocks.iter().map(|b| b.b_v.clone()).collect() }
}

/// `s^T H s`, without damping.
fn curvature(e: &NormalEquations, s: &Step) -> f64 {
    let of_block = |(b, v): (&Block, &DVector<f64>)| v.dot(&(&b.h_vv * v)) + 2.0 * v.dot(&(&b.h_vg * &s.global));
    s.global.dot(&(&e.h_gg * &s.global)) + e.blocks.iter().zip(&s.blocks).map(of_block).sum::<f64>()
}

impl Memory {
    pub(super) fn clear(&mut self) {
        self.pairs.clear();
    }

    /// Remembers an accepted step, by the equations before and behind it; `decrement` is that of the damped equations before it.
    pub(super) fn learn(&mut self, step: Step, decrement: f64, before: &NormalEquations, behind: &NormalEquations) {
        if !(decrement < SHORT) {
            self.clear();
            return;
        }
        let (mut change, after) = (downhill(before), downhill(behind));
        let (own, solved) = (curvature(before, &step), dot(&step, &change));
        add((&mut change.global, &mut change.blocks), -1.0, (&after.global, &after.blocks));
        let product = dot(&step, &change);
        let ratio = product / own;
        let worth = !self.pairs.is_empty() || ((ratio - 1.0).abs() > WORTH && own > OWN * solved);
        if own > 0.0 && BELIEVED.contains(&ratio) && worth {
            if self.pairs.len() == MOST {
                self.pairs.remove(0);
            }
            self.pairs.push(Pair { step, change, product });
        }
    }

    /// The step with all that is remembered, and by how much it should lower the cost; none where nothing is.
    pub(super) fn step(&self, equations: &NormalEquations, reduced: &Reduced) -> Option<(Step, f64)> {
        if self.pairs.is_empty() {
            return None;
        }
        let b = downhill(equations);
        let mut rest = b.clone();
        let mut shares = vec![];
        for p in self.pairs.iter().rev() {
            let share = dot(&p.step, &rest) / p.product;
            add((&mut rest.global, &mut rest.blocks), -share, (&p.change.global, &p.change.blocks));
            shares.push(share);
        }
        let mut step = reduced.solve(&rest)?;
        for (p, share) in self.pairs.iter().zip(shares.iter().rev()) {
            let more = share - dot(&step, &p.change) / p.product;
            add((&mut step.global, &mut step.blocks), more, (&p.step.global, &p.step.blocks));
        }
        let predicted = 0.5 * dot(&step, &b);
        (predicted > 0.0 && predicted.is_finite()).then_some((step, predicted))
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::super::{Layout, Options, Problem, Termination, minimise};
    use super::*;
    use nalgebra::DMatrix;

    /// `x` is weakly seen by `r_1 = x`, and by `r_2 = c + k x^2 / 2`, whose curvature is all that Gauss-Newton leaves out: `S = c k` at `x = 0`.
    /// `y` follows x in a block of its own.
    struct Bent {
        c: f64,
        k: f64,
    }
    impl Bent {
        /// Residuals and their derivatives by x and y.
        fn rows(&self, [x, y]: [f64; 2]) -> [[f64; 3]; 3] {
            [[x, 1.0, 0.0], [self.c + 0.5 * self.k * x * x, self.k * x, 0.0], [3.0 * y - 2.0 * x, -2.0, 3.0]]
        }
    }
    impl Problem for Bent {
        type State = [f64; 2];
        fn layout(&self) -> Layout {
            Layout { global: 1, blocks: vec![1] }
        }
        fn cost(&self, s: &[f64; 2]) -> Option<f64> {
            Some(self.rows(*s).iter().map(|r| 0.5 * r[0] * r[0]).sum())
        }
        fn linearise(&self, s: &[f64; 2]) -> Option<NormalEquations> {
            let mut e = NormalEquations::zeros(&self.layout());
            e.cost = self.cost(s)?;
            for [r, x, y] in self.rows(*s) {
                let Block { h_vv, h_vg, b_v } = &mut e.blocks[0];
                e.h_gg[(0, 0)] += x * x;
                e.b_g[0] -= x * r;
                *h_vv += DMatrix::from_element(1, 1, y * y);
                *h_vg += DMatrix::from_element(1, 1, y * x);
                b_v[0] -= y * r;
            }
            Some(e)
        }
        fn scales(&self, _: &[f64; 2]) -> Step {
            Step { global: DVector::from_element(1, 10.0), blocks: vec![DVector::from_element(1, 10.0)] }
        }
        fn retract(&self, s: &[f64; 2], d: &Step) -> Option<[f64; 2]> {
            Some([s[0] + d.global[0], s[1] + d.blocks[0][0]])
        }
    }

    /// How many undamped Gauss-Newton steps it takes until the one ahead is shorter than `limit`.
    fn plain_steps(problem: &Bent, mut x: f64, limit: f64) -> usize {
        for n in 0.. {
            let [_, [r, by, _], _] = problem.rows([x, 2.0 / 3.0 * x]);
            let step = -(x + r * by) / (1.0 + by * by);
            if step.abs() < limit || n == 1000 {
                return n;
            }
            x += step;
        }
        0
    }

    #[test]
    fn curvature_that_gauss_newton_leaves_out_is_learnt() {
        for s in [0.78, -0.78, 0.5, -0.9] {
            let problem = Bent { c: 100.0, k: s / 100.0 };
            let out = minimise(&problem, [0.4, 0.0], &Options::default(), &mut |_| true);
            let plain = plain_steps(&problem, 0.4, 1e-6);
            assert_eq!(out.termination, Termination::Converged);
            assert!(out.state[0].abs() < 1e-4 && (out.state[1] - 2.0 / 3.0 * out.state[0]).abs() < 1e-6);
            assert!(plain > 18 && out.iterations <= 10, "S = {s} H: {} steps, {plain} without", out.iterations);
        }
    }

    /// Where the cost bends down the nearest stationary point is no minimum.
    #[test]
    fn a_saddle_is_left() {
        let problem = Bent { c: 100.0, k: -0.012 };
        let out = minimise(&problem, [0.01, 0.0], &Options::default(), &mut |_| true);
        let minimum = (0.4_f64).sqrt() / 0.012;
        assert_eq!(out.termination, Termination::Converged);
        assert!((out.state[0].abs() - minimum).abs() < 1e-3, "{} not {minimum}", out.state[0]);
    }

    /// What a first step of 1 where `H = 1` is not believed to tell: a saddle, next to no curvature or far too much, what Gauss-Newton knows as well, and
    /// anything where damping made the step short. A long step forgets the rest.
    #[test]
    fn what_says_little_is_not_believed() {
        let equations = |b: f64| {
            let mut e = NormalEquations::zeros(&Layout { global: 1, blocks: vec![] });
            (e.h_gg[(0, 0)], e.b_g[0]) = (1.0, b);
            e
        };
        let step = || Step { global: DVector::from_element(1, 1.0), blocks: vec![] };
        let learnt = |before: f64, behind: f64| {
            let mut memory = Memory::default();
            memory.learn(step(), 0.5, &equations(before), &equations(behind));
            memory
        };
        for (behind, known) in [(-0.5, 1), (0.6, 1), (1.2, 0), (0.99, 0), (-59.0, 0), (0.1, 0)] {
            assert_eq!(learnt(1.0, behind).pairs.len(), known, "curvature {}", 1.0 - behind);
        }
        assert_eq!(learnt(3.0, 1.5).pairs.len(), 0, "damping of twice the curvature");
        let mut memory = learnt(1.0, -0.5);
        memory.learn(step(), 2.0, &equations(1.0), &equations(-0.5));
        assert!(memory.pairs.is_empty());
    }

    /// With two pairs the step solves the secant equation of the last one: `B^-1 y = s`.
    #[test]
    fn the_last_change_of_the_gradient_gives_the_last_step() {
        let problem = Bent { c: 50.0, k: 0.01 };
        let states = [[0.4, 0.27], [0.05, 0.0367], [-0.05, -0.02]];
        let equations = states.map(|s| problem.linearise(&s).expect("equations"));
        let mut memory = Memory::default();
        for k in 0..2 {
            let d = [0, 1].map(|i| states[k + 1][i] - states[k][i]);
            let step = Step { global: DVector::from_element(1, d[0]), blocks: vec![DVector::from_element(1, d[1])] };
            memory.learn(step, 0.5, &equations[k], &equations[k + 1]);
            assert_eq!(memory.pairs.len(), k + 1);
        }
        let mut change = equations[2].clone();
        change.b_g = &equations[1].b_g - &equations[2].b_g;
        change.blocks[0].b_v = &equations[1].blocks[0].b_v - &equations[2].blocks[0].b_v;
        let reduced = Reduced::of(&change, &super::super::reduced::Ridge::Relative(0.0)).expect("positive");
        let (step, _) = memory.step(&change, &reduced).expect("remembered");
        assert!((step.global[0] - (states[2][0] - states[1][0])).abs() < 1e-12);
        assert!((step.blocks[0][0] - (states[2][1] - states[1][1])).abs() < 1e-12);
    }
}
