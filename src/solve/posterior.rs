//! Covariance of all unknowns and the directions that nothing determines.
//!
//! With `A_v = H_vv^-1 H_vg`: `C_gg = S^+`, `C_vg = -A_v C_gg`, `C_vw = A_v C_gg A_w^T + [v = w] H_vv^-1`.
//! `S^+` is the inverse over the directions that are determined. Rank is judged on `D^-1/2 S D^-1/2` with
//! `D = diag(H_gg)`: its eigenvalues are the shares of information that survive the elimination of everything else,
//! free of units. Rounding leaves about 1e-15 in an exactly flat direction.

use super::NormalEquations;
use super::factor::{Cholesky, symmetric_eigen};
use super::reduced::{Ridge, eliminate};
use nalgebra::{DMatrix, DVector};

/// Share of information below which a direction counts as undetermined.
pub(super) const RANK_LIMIT: f64 = 1e-12;

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
    /// Undetermined directions of the global unknowns, n x nullity; each scaled by the unknowns' own precision
    /// (`D^1/2` times the direction) and of unit length.
    pub null_directions: DMatrix<f64>,
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
    /// True where global unknown `i` moves along an undetermined direction.
    pub fn touched_by_null(&self, i: usize) -> bool {
        self.null_directions.row(i).norm() > 1e-4
    }

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

/// Largest trace of the inverse of the scaled reduced matrix: no eigenvalue is then below [`RANK_LIMIT`] times ten, so that what a Cholesky
/// factor says holds to a percent.
const DETERMINED: f64 = 0.1 / RANK_LIMIT;

/// Covariance of the global unknowns alone, n x n: what [`posterior`] says without eigenvectors and blocks, a hundred times sooner. `None` where
/// not every direction is determined.
pub fn global_covariance(equations: &NormalEquations) -> Option<DMatrix<f64>> {
    let (mut s, _, _) = eliminate(equations, &Ridge::Relative(0.0))?;
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
///
/// A block that is singular in itself is held by a ridge of 1e-12 of its diagonal.
pub fn posterior(equations: &NormalEquations) -> Posterior {
    let n = equations.h_gg.nrows();
    // Blocks without damping where they allow it: the ridge would hide weak directions.
    let eliminated =
        eliminate(equations, &Ridge::Relative(0.0)).or_else(|| eliminate(equations, &Ridge::Blocks(1e-12)));
    let (s, eliminated) =
        eliminated.map_or_else(|| (DMatrix::zeros(n, n), None), |(s, _, eliminated)| (s, Some(eliminated)));
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
    let eigen = symmetric_eigen(&scaled)
        .unwrap_or_else(|| super::SymmetricEigen { values: DVector::zeros(n), vectors: DMatrix::identity(n, n) });
    let nullity = eigen.values.iter().filter(|v| **v < RANK_LIMIT).count();
    let mut global = DMatrix::zeros(n, n);
    for i in nullity..n {
        let v = eigen.vectors.column(i).component_mul(&scale);
        global.ger(1.0 / eigen.values[i], &v, &v, 1.0);
    }
    let of = |block: super::reduced::EliminatedBlock| {
        let coupling = block.coupling();
        let with_global = -(&coupling * &global);
        let own = block.inverse() - &with_global * coupling.transpose();
        BlockPosterior { own, with_global, coupling }
    };
    let blocks = eliminated.iter().flat_map(|e| e.blocks().map(of)).collect();
    let null_directions = eigen.vectors.columns(0, nullity).into_owned();
    Posterior { global, blocks, nullity, null_directions, information_shares: eigen.values }
}

#[cfg(test)]
mod tests {
    use super::super::{Block, Layout};
    use super::*;

    /// Two global unknowns of which everything sees the sum alone, beside a block of the same kind: a ridge that holds the block must not make
    /// the global ones pass for determined.
    #[test]
    fn a_block_that_is_singular_hides_nothing_of_the_others() {
        let ones = DMatrix::from_element(2, 2, 1.0);
        let mut equations = NormalEquations::zeros(&Layout { global: 2, blocks: vec![2] });
        equations.h_gg = 2.0 * &ones;
        equations.blocks = vec![Block { h_vv: ones.clone(), h_vg: ones, b_v: DVector::zeros(2) }];
        assert!(eliminate(&equations, &Ridge::Relative(0.0)).is_none());
        let post = posterior(&equations);
        assert_eq!(post.nullity, 1);
        assert!((post.null_directions[(0, 0)] + post.null_directions[(1, 0)]).abs() < 1e-9);
        // Their sum is known as by its own observation alone, for the block takes the other.
        assert!((post.global.sum() - 1.0).abs() < 1e-6, "{}", post.global);
    }
}
