//! Covariance of all unknowns and the directions that nothing determines.
//!
//! With `A_v = H_vv^-1 H_vg`: `C_gg = S^+`, `C_vg = -A_v C_gg`, `C_vw = A_v C_gg A_w^T + [v = w] H_vv^-1`.
//! `S^+` is the inverse over the directions that are determined. Rank is judged on `D^-1/2 S D^-1/2` with
//! `D = diag(H_gg)`: its eigenvalues are the shares of information that survive the elimination of everything else,
//! free of units. Rounding leaves about 1e-15 in an exactly flat direction; what is known beforehand is asked by itself. Directions in which a block is flat by itself are found and held
//! before ([`super::flat`]): they are undetermined, too, and have no part in the covariance.

use super::NormalEquations;
use super::factor::Cholesky;
use super::flat::{DETERMINED, Directions, FLAT, is_unseen, over_determined};
use super::reduced::{EliminatedBlock, Ridge, eliminate};
use nalgebra::{DMatrix, DVector};

/// Covariance parts of one block.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockPosterior {
    /// Covariance of the block's own unknowns, d x d.
    pub own: DMatrix<f64>,
    /// Covariance of the block with the global unknowns, d x n.
    pub with_global: DMatrix<f64>,
    /// `H_vv^-1 H_vg`, d x n.
    coupling: DMatrix<f64>,
}

/// Covariance of all unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    /// Covariance of the global unknowns, n x n, over the determined directions.
    pub global: DMatrix<f64>,
    /// The blocks.
    pub blocks: Vec<BlockPosterior>,
    /// Number of undetermined directions.
    pub nullity: usize,
    /// Movement of all unknowns (global ones first, then the blocks in order) along each undetermined direction, one column each: those that blocks
    /// have by themselves come last.
    pub null_movements: DMatrix<f64>,
    /// Ascending eigenvalues of the scaled reduced matrix.
    pub information_shares: DVector<f64>,
}

impl BlockPosterior {
    /// `H_vv^-1 H_vg`: the block moves by minus this times a movement of the global unknowns.
    pub fn coupling(&self) -> &DMatrix<f64> {
        &self.coupling
    }
}

impl Posterior {
    /// Covariance of everything, global unknowns first, then the blocks in order.
    pub fn full(&self) -> DMatrix<f64> {
        let n = self.global.nrows();
        let total = n + self.blocks.iter().map(|b| b.own.nrows()).sum::<usize>();
        let mut c = DMatrix::zeros(total, total);
        c.view_mut((0, 0), (n, n)).copy_from(&self.global);
        let mut at = n;
        for (v, block) in self.blocks.iter().enumerate() {
            let d = block.own.nrows();
            c.view_mut((at, 0), (d, n)).copy_from(&block.with_global);
            c.view_mut((0, at), (n, d)).copy_from(&block.with_global.transpose());
            c.view_mut((at, at), (d, d)).copy_from(&block.own);
            let mut other_at = at + d;
            for other in &self.blocks[v + 1..] {
                let e = other.own.nrows();
                let cross = -(&block.with_global * other.coupling.transpose());
                c.view_mut((other_at, at), (e, d)).copy_from(&cross.transpose());
                c.view_mut((at, other_at), (d, e)).copy_from(&cross);
                other_at += e;
            }
            at += d;
        }
        c
    }
}

/// Covariance of the global unknowns alone, n x n: what [`posterior`] says without eigenvectors and blocks, a hundred times sooner. `None` where
/// not every direction is determined.
pub fn global_covariance(equations: &NormalEquations) -> Option<DMatrix<f64>> {
    let (mut s, _, blocks) = eliminate(equations, &Ridge::Relative(0.0))?;
    if blocks.doubtful(equations) || equations.blocks.iter().any(is_unseen) {
        return None;
    }
    let n = s.nrows();
    let scale: Vec<f64> = equations.h_gg.diagonal().iter().map(|d| d.sqrt().recip()).collect();
    if !scale.iter().all(|d| d.is_finite()) {
        return None;
    }
    for j in 0..n {
        (j..n).for_each(|i| s[(i, j)] *= scale[i] * scale[j]);
    }
    let mut inverse = Cholesky::of(&s)?.inverse();
    if !(inverse.trace() < DETERMINED) {
        return None;
    }
    for j in 0..n {
        (0..n).for_each(|i| inverse[(i, j)] *= scale[i] * scale[j]);
    }
    Some(inverse)
}

/// Covariance from the normal equations at the minimum.
pub fn posterior(equations: &NormalEquations) -> Posterior {
    let n = equations.h_gg.nrows();
    let (s, held) =
        over_determined(equations).map_or_else(|| (DMatrix::zeros(n, n), None), |(s, _, held)| (s, Some(held)));
    let scale = DVector::from_fn(n, |i, _| {
        let d = equations.h_gg[(i, i)];
        if d > 0.0 { d.sqrt().recip() } else { 1.0 }
    });
    // What nothing sees has no information; the unit diagonal of the elimination only makes its step zero.
    let seen = |i: usize| equations.h_gg[(i, i)] > 0.0;
    let scaled =
        DMatrix::from_fn(
            n,
            n,
            |i, j| {
                if seen(i) && seen(j) { s[(i.max(j), i.min(j))] * scale[i] * scale[j] } else { 0.0 }
            },
        );
    let Directions { values, vectors, nullity } = Directions::of(&scaled, &scale, &equations.known, FLAT)
        .unwrap_or_else(|| Directions { values: DVector::zeros(n), vectors: DMatrix::identity(n, n), nullity: n });
    let mut global = DMatrix::zeros(n, n);
    for i in nullity..n {
        let v = vectors.column(i).component_mul(&scale);
        global.ger(1.0 / values[i], &v, &v, 1.0);
    }
    let of = |(block, flat): (EliminatedBlock, &DMatrix<f64>)| {
        let coupling = block.coupling();
        let with_global = -(&coupling * &global);
        let own = block.inverse() - flat * flat.transpose() - &with_global * coupling.transpose();
        BlockPosterior { own, with_global, coupling }
    };
    let blocks: Vec<BlockPosterior> = held.iter().flat_map(|h| h.blocks.blocks().zip(&h.flat).map(of)).collect();
    let flat = held.map_or(vec![], |h| h.flat);
    let shared = DMatrix::from_fn(n, nullity, |i, k| vectors[(i, k)] * scale[i]);
    let null_movements = null_movements(&shared, &blocks, &flat);
    Posterior { global, blocks, nullity: null_movements.ncols(), null_movements, information_shares: values }
}

/// Those of the global unknowns, which the blocks follow, then those of each block.
fn null_movements(shared: &DMatrix<f64>, blocks: &[BlockPosterior], flat: &[DMatrix<f64>]) -> DMatrix<f64> {
    let (n, nullity) = shared.shape();
    let total = n + blocks.iter().map(|b| b.own.nrows()).sum::<usize>();
    let mut out = DMatrix::zeros(total, nullity + flat.iter().map(DMatrix::ncols).sum::<usize>());
    out.view_mut((0, 0), (n, nullity)).copy_from(shared);
    let (mut row, mut column) = (n, nullity);
    for (block, own) in blocks.iter().zip(flat) {
        let d = block.own.nrows();
        out.view_mut((row, 0), (d, nullity)).copy_from(&-(&block.coupling * shared));
        out.view_mut((row, column), own.shape()).copy_from(own);
        (row, column) = (row + d, column + own.ncols());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::{Layout, predict};
    use super::*;

    /// Equations of the rows given: unknowns of each row with their derivatives, global ones first.
    fn equations(layout: &Layout, rows: &[Vec<(usize, f64)>]) -> (NormalEquations, DMatrix<f64>) {
        let n = layout.global;
        let total = n + layout.blocks.iter().sum::<usize>();
        let mut h = DMatrix::zeros(total, total);
        for row in rows {
            row.iter().for_each(|(i, a)| row.iter().for_each(|(j, b)| h[(*i, *j)] += a * b));
        }
        let mut e = NormalEquations::zeros(layout);
        e.h_gg.copy_from(&h.view((0, 0), (n, n)));
        let mut at = n;
        for (block, &d) in e.blocks.iter_mut().zip(&layout.blocks) {
            block.h_vv.copy_from(&h.view((at, at), (d, d)));
            block.h_vg.copy_from(&h.view((at, 0), (d, n)));
            at += d;
        }
        (e, h)
    }

    /// Two global unknowns of which everything sees the sum alone, beside a block of the same kind, in units of very different size: each is flat by
    /// itself, neither hides the other, and the covariance is the pseudo-inverse of the whole.
    #[test]
    fn a_block_that_is_flat_by_itself_is_said_and_hides_nothing() {
        let layout = Layout { global: 2, blocks: vec![2, 2, 1] };
        // Sum of the global ones; the first block with it and by its own sum; a determined block; one that nothing sees.
        let rows = vec![
            vec![(0, 1.0), (1, 1e6)],
            vec![(0, 1.0), (1, 1e6), (2, 1e-3), (3, 2.0)],
            vec![(2, 3e-3), (3, 6.0)],
            vec![(4, 2.0), (0, 1.0), (1, 1e6)],
            vec![(5, 1.0)],
        ];
        let (e, h) = equations(&layout, &rows);
        let post = posterior(&e);
        assert_eq!(post.nullity, 3, "{}", post.null_movements);
        assert!(global_covariance(&e).is_none());
        for column in post.null_movements.column_iter() {
            assert!(
                rows.iter().all(|r| r.iter().map(|(i, a)| a * column[*i]).sum::<f64>().abs() < 1e-9 * column.amax())
            );
        }
        // What is determined: each row, and it has the covariance that all others would find without the flat directions.
        let scale: Vec<f64> = (0..7).map(|i| if h[(i, i)] > 0.0 { h[(i, i)].sqrt() } else { 1.0 }).collect();
        let scaled = DMatrix::from_fn(7, 7, |i, j| h[(i, j)] / (scale[i] * scale[j]));
        let pseudo = scaled.pseudo_inverse(1e-10).unwrap();
        let full = post.full();
        for a in &rows {
            for b in &rows {
                let by = |c: &dyn Fn(usize, usize) -> f64| -> f64 {
                    a.iter()
                        .flat_map(|(i, x)| b.iter().map(move |(j, y)| (i, j, x * y)))
                        .map(|(i, j, w)| w * c(*i, *j))
                        .sum()
                };
                let (ours, wanted) = (by(&|i, j| full[(i, j)]), by(&|i, j| pseudo[(i, j)] / (scale[i] * scale[j])));
                assert!((ours - wanted).abs() < 1e-9, "{a:?} {b:?}: {ours} {wanted}");
            }
        }
        assert_eq!(full[(6, 6)], 0.0, "nothing sees it");
    }

    /// Two unknowns of which images tell the sum to 1e-7 and a prior the first to 1: the prior has 1e-14 of the information, which is no less than what it says.
    #[test]
    fn what_is_known_beforehand_counts_however_small_its_share() {
        let layout = Layout { global: 2, blocks: vec![] };
        let (mut e, _) = equations(&layout, &[vec![(0, 1e7), (1, 1e7)], vec![(0, 1.0)]]);
        assert_eq!(posterior(&e).nullity, 1, "by its share alone");
        e.known.rows = vec![vec![(0, 1.0)]];
        let post = posterior(&e);
        assert_eq!(post.nullity, 0);
        // x and y - x of two unit numbers: the sum has a variance of 1e-14.
        let c = &post.global;
        assert!(
            (c[(0, 0)] - 1.0).abs() < 1e-6 && (c[(1, 1)] - 1.0).abs() < 1e-6 && (c[(0, 1)] + 1.0).abs() < 1e-6,
            "{c}"
        );
        let told = predict(&e, &DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 1.0, 1.0])).unwrap();
        assert_eq!(told.determined, [true, true]);
        assert!((told.covariance[(0, 0)] - 1.0).abs() < 1e-6 && told.covariance[(1, 1)] < 1e-13, "{}", told.covariance);
        // Known to 1 each, the second must not be known to less than 0.9, or than 1.1.
        for (reach, nullity) in [(0.9, 1), (1.1, 0)] {
            e.known.reach = vec![f64::INFINITY, reach];
            assert_eq!(posterior(&e).nullity, nullity, "{reach}");
        }
        // Of a direction that it does not touch it says nothing.
        e.known.rows = vec![vec![(0, 1.0), (1, 1.0)]];
        assert_eq!(posterior(&e).nullity, 1);
    }

    /// A view whose own directions are weak by 1e-5 of their information is determined, and the short way says the same.
    #[test]
    fn a_weak_block_is_not_flat() {
        let layout = Layout { global: 1, blocks: vec![2] };
        let rows = vec![vec![(0, 1.0), (1, 1.0), (2, 1.0)], vec![(1, 1.0), (2, 1.0 + 1e-2)], vec![(1, 1.0), (2, 1.0)]];
        let (e, h) = equations(&layout, &rows);
        let (post, inverse) = (posterior(&e), h.try_inverse().unwrap());
        assert_eq!(post.nullity, 0);
        assert!((post.full() - &inverse).amax() < 1e-9 * inverse.amax());
        assert!((global_covariance(&e).unwrap()[(0, 0)] / inverse[(0, 0)] - 1.0).abs() < 1e-9);
    }
}
