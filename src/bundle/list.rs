//! All unknowns in one list, for tests against dense matrices.

use super::adjust::Bundle;
use super::model::Model;
use super::state::State;
use crate::solve::{NormalEquations, Problem, Step};
use nalgebra::{DMatrix, DVector};

/// All unknowns in one list, in steps up to which the problem is about linear.
pub(super) struct List<'a> {
    pub(super) bundle: Bundle<'a>,
    scales: Step,
}

impl List<'_> {
    pub(super) fn len(&self) -> usize {
        self.scales.global.len() + self.scales.blocks.iter().map(DVector::len).sum::<usize>()
    }
    /// The state with unknown `k` moved by a part of its scale.
    pub(super) fn moved(&self, state: &State, k: usize, part: f64) -> State {
        let mut step = self.scales.clone();
        let all = step.global.iter_mut().chain(step.blocks.iter_mut().flat_map(|b| b.iter_mut()));
        all.enumerate().for_each(|(i, x)| *x *= if i == k { part } else { 0.0 });
        self.bundle.retract(state, &step).unwrap()
    }
    pub(super) fn of<'m>(model: &'m Model, state: &State) -> List<'m> {
        let bundle = Bundle::with_views(model);
        let scales = bundle.scales(state);
        List { bundle, scales }
    }
    /// Gradient and matrix of equations in these steps.
    pub(super) fn dense(&self, e: &NormalEquations) -> (DMatrix<f64>, DVector<f64>) {
        let (n, total) = (self.scales.global.len(), self.len());
        let (mut h, mut b) = (DMatrix::zeros(total, total), DVector::zeros(total));
        h.view_mut((0, 0), (n, n)).copy_from(&e.h_gg);
        b.rows_mut(0, n).copy_from(&e.b_g);
        let mut at = n;
        for block in &e.blocks {
            let d = block.b_v.len();
            h.view_mut((at, at), (d, d)).copy_from(&block.h_vv);
            h.view_mut((at, 0), (d, n)).copy_from(&block.h_vg);
            h.view_mut((0, at), (n, d)).copy_from(&block.h_vg.transpose());
            b.rows_mut(at, d).copy_from(&block.b_v);
            at += d;
        }
        let own = self.scales.global.iter().chain(self.scales.blocks.iter().flat_map(|b| b.iter())).copied();
        let scale = DVector::from_iterator(total, own);
        (DMatrix::from_fn(total, total, |i, j| h[(i, j)] * scale[i] * scale[j]), b.component_mul(&scale))
    }
}
