//! Damped Schur elimination of the blocks and back substitution.

use super::factor::Cholesky;
use super::{NormalEquations, Step};
use nalgebra::{DMatrix, DVector};

/// `m + lambda diag(m)`; an unknown that nothing sees gets a unit diagonal, so that its step is zero.
pub(super) fn damped(m: &DMatrix<f64>, lambda: f64) -> DMatrix<f64> {
    let mut out = m.clone();
    for i in 0..m.nrows() {
        let d = m[(i, i)];
        out[(i, i)] = if d > 0.0 { d * (1.0 + lambda) } else { 1.0 };
    }
    out
}

/// `H_vv^-1` applied to the block's right-hand sides.
pub(super) struct EliminatedBlock {
    /// `H_vv^-1 H_vg`.
    pub(super) coupling: DMatrix<f64>,
    /// `H_vv^-1 b_v`.
    pub(super) own: DVector<f64>,
}

/// The factored, damped equations.
pub(super) struct Reduced<'a> {
    equations: &'a NormalEquations,
    lambda: f64,
    blocks: Vec<EliminatedBlock>,
    factor: Option<Cholesky>,
    rhs: DVector<f64>,
}

/// `S` and the right-hand side of the reduced system, with the eliminated blocks; `None` where a block is indefinite.
pub(super) fn eliminate(
    equations: &NormalEquations,
    lambda: f64,
) -> Option<(DMatrix<f64>, DVector<f64>, Vec<EliminatedBlock>)> {
    let mut s = damped(&equations.h_gg, lambda);
    let mut rhs = equations.b_g.clone();
    let mut blocks = Vec::with_capacity(equations.blocks.len());
    for block in &equations.blocks {
        let factor = Cholesky::of(&damped(&block.h_vv, lambda))?;
        let coupling = factor.solve(&block.h_vg);
        let own = factor.solve_vector(&block.b_v);
        s.gemm_tr(-1.0, &block.h_vg, &coupling, 1.0);
        rhs.gemv_tr(-1.0, &block.h_vg, &own, 1.0);
        blocks.push(EliminatedBlock { coupling, own });
    }
    Some((s, rhs, blocks))
}

impl<'a> Reduced<'a> {
    /// Eliminates the blocks with damping `lambda`; `None` where the result is not positive definite.
    pub(super) fn of(equations: &'a NormalEquations, lambda: f64) -> Option<Self> {
        let (s, rhs, blocks) = eliminate(equations, lambda)?;
        let factor = if s.nrows() == 0 { None } else { Some(Cholesky::of(&s)?) };
        Some(Self { equations, lambda, blocks, factor, rhs })
    }

    /// Solution of the damped equations.
    pub(super) fn step(&self) -> Step {
        let global = match &self.factor {
            Some(f) => f.solve_vector(&self.rhs),
            None => DVector::zeros(0),
        };
        let blocks = self.blocks.iter().map(|b| &b.own - &b.coupling * &global).collect();
        Step { global, blocks }
    }

    /// `sqrt(b^T (H + lambda D)^-1 b)`.
    pub(super) fn decrement(&self) -> f64 {
        self.b_dot(&self.step()).max(0.0).sqrt()
    }

    fn b_dot(&self, step: &Step) -> f64 {
        let views: f64 = self.equations.blocks.iter().zip(&step.blocks).map(|(b, d)| b.b_v.dot(d)).sum();
        self.equations.b_g.dot(&step.global) + views
    }

    /// Decrease of the quadratic model: `b^T d - 1/2 d^T H d = 1/2 (b^T d + lambda d^T D d)`.
    pub(super) fn predicted_decrease(&self, step: &Step) -> f64 {
        let weighted =
            |m: &DMatrix<f64>, d: &DVector<f64>| -> f64 { (0..d.len()).map(|i| m[(i, i)] * d[i] * d[i]).sum() };
        let views: f64 = self.equations.blocks.iter().zip(&step.blocks).map(|(b, d)| weighted(&b.h_vv, d)).sum();
        0.5 * (self.b_dot(step) + self.lambda * (weighted(&self.equations.h_gg, &step.global) + views))
    }
}
