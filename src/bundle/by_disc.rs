//! Every disc estimated: discs eliminated in place of views.
//!
//! The normal equations have three parts, what all share (s), the poses (p) and the offsets of the discs (o). Poses never meet each other, and no more
//! do discs, but every pose meets every disc it shows:
//! ```text
//!     | ss  sp  so |      blocks of views: global = (s, o), one block per pose        (what the rooms above are given)
//! H = | ps  pp  po |      blocks of discs: global = (s, p), one block per disc        (this file)
//!     | os  op  oo |
//! ```
//! Eliminating the views leaves a dense matrix of all discs, four unknowns each; eliminating the discs leaves one of all poses. The smaller one
//! is solved; at the end the equations are put back into the other order, where they say the same.
//!
//! Not for targets whose shape belongs to the views: those have no discs in common.

use super::facts::Row;
use super::image_map::{MappedNormal, Slot};
use super::layout::Places;
use super::model::Model;
use crate::solve::{Block, Gradient, Layout, NormalEquations, Step};
use nalgebra::{DMatrix, DVector};

/// Unknowns of a disc.
const DISC: usize = 4;

/// The order of the unknowns with one block per disc.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ByDisc {
    /// Number of unknowns that all share.
    shared: usize,
    /// First unknown of each view's pose, and one past the last.
    poses: Vec<usize>,
    discs: usize,
}

/// Where an unknown stands in that order.
enum Place {
    Global(usize),
    Disc(usize, usize),
}

impl ByDisc {
    /// `None` where no disc is estimated or poses are no fewer than discs.
    pub(super) fn of(model: &Model, places: &Places) -> Option<Self> {
        let shared = places.offsets.filter(|_| !model.target.per_view())?;
        let mut poses = vec![shared];
        for size in &places.pose_sizes {
            poses.push(poses[poses.len() - 1] + size);
        }
        let out = Self { shared, poses, discs: model.target.disc_count() };
        (out.global() - shared < DISC * out.discs).then_some(out)
    }

    fn global(&self) -> usize {
        *self.poses.last().unwrap_or(&self.shared)
    }

    pub(super) fn layout(&self) -> Layout {
        Layout { global: self.global(), blocks: vec![DISC; self.discs] }
    }

    fn place(&self, view: usize, slot: Slot) -> Place {
        match slot {
            Slot::Global(g) if g >= self.shared => Place::Disc((g - self.shared) / DISC, (g - self.shared) % DISC),
            Slot::Global(g) => Place::Global(g),
            Slot::Block(v) => Place::Global(self.poses[view] + v),
        }
    }

    /// Numbers by views in the order by discs.
    fn numbers_by_disc(&self, global: &DVector<f64>, blocks: &[DVector<f64>]) -> (DVector<f64>, Vec<DVector<f64>>) {
        let all = global.iter().take(self.shared).chain(blocks.iter().flatten());
        let discs = (0..self.discs).map(|j| global.rows(self.shared + DISC * j, DISC).into_owned()).collect();
        (DVector::from_iterator(self.global(), all.copied()), discs)
    }

    pub(super) fn step_by_disc(&self, step: &Step) -> Step {
        let (global, blocks) = self.numbers_by_disc(&step.global, &step.blocks);
        Step { global, blocks }
    }

    pub(super) fn gradient_by_disc(&self, gradient: &Gradient) -> Gradient {
        let (global, blocks) = self.numbers_by_disc(&gradient.global, &gradient.blocks);
        Gradient { global, blocks }
    }

    /// A step by discs in the order by views.
    pub(super) fn step_by_view(&self, step: &Step) -> Step {
        let all = step.global.iter().take(self.shared).chain(step.blocks.iter().flatten());
        let views = self.poses.windows(2).map(|p| step.global.rows(p[0], p[1] - p[0]).into_owned()).collect();
        Step { global: DVector::from_iterator(self.shared + DISC * self.discs, all.copied()), blocks: views }
    }

    /// Adds one image.
    pub(super) fn add(&self, e: &mut NormalEquations, view: usize, image: &MappedNormal) {
        e.cost += image.cost;
        let at = |slot: &Slot| match *slot {
            Slot::Global(g) => g,
            Slot::Block(v) => self.poses[view] + v,
        };
        let mut h = image.h.iter();
        for (i, si) in image.slots.iter().enumerate() {
            let p = at(si);
            e.b_g[p] += image.b[i];
            for ((j, sj), h) in image.slots[..=i].iter().enumerate().zip(&mut h) {
                let q = at(sj);
                e.h_gg[(p, q)] += h;
                if i != j {
                    e.h_gg[(q, p)] += h;
                }
            }
        }
        let wide = image.slots.len().max(1);
        for (o, crosses) in image.offsets.iter().zip(image.crosses.chunks_exact(wide)) {
            let block = &mut e.blocks[o.disc];
            (0..DISC).for_each(|k| block.b_v[k] += o.b[k]);
            block.h_vv.as_mut_slice().iter_mut().zip(o.own.as_slice()).for_each(|(h, x)| *h += x);
            let h_vg = block.h_vg.as_mut_slice();
            for (slot, cross) in image.slots.iter().zip(crosses) {
                let p = DISC * at(slot);
                h_vg[p..p + DISC].iter_mut().zip(cross.as_slice()).for_each(|(h, x)| *h += x);
            }
        }
    }

    /// Adds one row of what is known beforehand: of one disc alone, or of no disc.
    pub(super) fn add_row(&self, e: &mut NormalEquations, row: &Row) {
        for &(si, di) in &row.slots {
            match self.place(row.view, si) {
                Place::Global(p) => e.b_g[p] -= di * row.residual,
                Place::Disc(j, k) => e.blocks[j].b_v[k] -= di * row.residual,
            }
            for &(sj, dj) in &row.slots {
                match (self.place(row.view, si), self.place(row.view, sj)) {
                    (Place::Global(p), Place::Global(q)) => e.h_gg[(p, q)] += di * dj,
                    (Place::Disc(j, k), Place::Disc(_, m)) => e.blocks[j].h_vv[(k, m)] += di * dj,
                    (Place::Disc(j, k), Place::Global(q)) => e.blocks[j].h_vg[(k, q)] += di * dj,
                    (Place::Global(_), Place::Disc(..)) => {}
                }
            }
        }
        e.cost += 0.5 * row.residual * row.residual;
    }

    /// Clears unknowns that the images do not see, shared ones and those of discs; `unseen(information, scale)`.
    pub(super) fn drop_unseen(&self, e: &mut NormalEquations, scales: &Step, unseen: impl Fn(f64, f64) -> bool) {
        for i in (0..self.shared).filter(|&i| unseen(e.h_gg[(i, i)], scales.global[i])).collect::<Vec<_>>() {
            e.h_gg.row_mut(i).fill(0.0);
            e.h_gg.column_mut(i).fill(0.0);
            e.b_g[i] = 0.0;
            e.blocks.iter_mut().for_each(|b| b.h_vg.column_mut(i).fill(0.0));
        }
        for (b, scale) in e.blocks.iter_mut().zip(&scales.blocks) {
            for k in 0..DISC {
                if unseen(b.h_vv[(k, k)], scale[k]) {
                    b.h_vv.row_mut(k).fill(0.0);
                    b.h_vv.column_mut(k).fill(0.0);
                    b.h_vg.row_mut(k).fill(0.0);
                    b.b_v[k] = 0.0;
                }
            }
        }
    }

    /// The same equations with one block per view.
    pub(super) fn equations_by_view(&self, e: &NormalEquations) -> NormalEquations {
        let (s, n) = (self.shared, self.shared + DISC * self.discs);
        let (mut h_gg, mut b_g) = (DMatrix::zeros(n, n), DVector::zeros(n));
        h_gg.view_mut((0, 0), (s, s)).copy_from(&e.h_gg.view((0, 0), (s, s)));
        b_g.rows_mut(0, s).copy_from(&e.b_g.rows(0, s));
        for (j, disc) in e.blocks.iter().enumerate() {
            let at = s + DISC * j;
            h_gg.view_mut((at, at), (DISC, DISC)).copy_from(&disc.h_vv);
            let cross = disc.h_vg.columns(0, s);
            h_gg.view_mut((at, 0), (DISC, s)).copy_from(&cross);
            h_gg.view_mut((0, at), (s, DISC)).copy_from(&cross.transpose());
            b_g.rows_mut(at, DISC).copy_from(&disc.b_v);
        }
        let view = |p: &[usize]| {
            let (at, d) = (p[0], p[1] - p[0]);
            let mut h_vg = DMatrix::zeros(d, n);
            h_vg.columns_mut(0, s).copy_from(&e.h_gg.view((at, 0), (d, s)));
            for (j, disc) in e.blocks.iter().enumerate() {
                h_vg.columns_mut(s + DISC * j, DISC).copy_from(&disc.h_vg.columns(at, d).transpose());
            }
            Block { h_vv: e.h_gg.view((at, at), (d, d)).into_owned(), h_vg, b_v: e.b_g.rows(at, d).into_owned() }
        };
        let blocks = self.poses.windows(2).map(view).collect();
        NormalEquations { h_gg, b_g, blocks, known: e.known.clone(), cost: e.cost }
    }
}

#[cfg(test)]
mod tests;
