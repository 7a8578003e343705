//! Directions in which a block is flat by itself: a view with a gauge of its own, like discs of unknown size that one camera sees.
//!
//! H is positive semidefinite, so `H_vv n = 0` makes `H_gv n = 0`: a flat direction of a block meets nothing, `(0, n)` is one of the whole, and
//! everything else is as if the block were held along it. With `E = diag(sqrt(H_vv,ii))` (1 where nothing sees an unknown):
//! ```text
//! E^-1 H_vv E^-1 = U diag(lambda) U^T      U_0: columns with lambda < 1e-12      n = E^-1 U_0
//! held:   H_vv + E U_0 U_0^T E,   (1 - E U_0 U_0^T E^-1) H_vg,   the same of b_v
//! H_vv^+ (over the determined directions) = (held H_vv)^-1 - n n^T
//! ```
//! What is added is as large as what the block knows of its other directions: nothing is lost to rounding, as it would be with a small ridge.

use super::factor::symmetric_eigen;
use super::reduced::{Eliminated, Ridge, eliminate};
use super::{Block, NormalEquations};
use nalgebra::{DMatrix, DVector};

/// Share of information below which a direction counts as undetermined.
pub(super) const FLAT: f64 = 1e-12;

/// Largest trace of the inverse of a scaled matrix: no eigenvalue is then below [`FLAT`] times ten, so that what a Cholesky factor says holds to
/// a percent.
pub(super) const DETERMINED: f64 = 0.1 / FLAT;

/// The blocks, eliminated where they are determined.
pub(super) struct Held {
    pub(super) blocks: Eliminated,
    /// n of each block: its flat directions, one column each, in its unknowns.
    pub(super) flat: Vec<DMatrix<f64>>,
}

/// S (lower triangle) and right-hand side of the global unknowns, over the directions that the blocks determine; `None` where a block
/// holds `NaN`.
pub(super) fn over_determined(equations: &NormalEquations) -> Option<(DMatrix<f64>, DVector<f64>, Held)> {
    // Nothing sees a view that was left out: it is flat as a whole, and no other way round leads to that.
    let unseen = || {
        let of = |b: &Block| DMatrix::identity(b.b_v.len(), if is_unseen(b) { b.b_v.len() } else { 0 });
        equations.blocks.iter().map(of).collect()
    };
    match eliminate(equations, &Ridge::Relative(0.0)) {
        Some((s, rhs, blocks)) if !blocks.doubtful(equations) => Some((s, rhs, Held { blocks, flat: unseen() })),
        _ => {
            let (blocks, flat): (Vec<Block>, Vec<_>) =
                equations.blocks.iter().map(held).collect::<Option<Vec<_>>>()?.into_iter().unzip();
            let (h_gg, b_g) = (equations.h_gg.clone(), equations.b_g.clone());
            let equations = NormalEquations { h_gg, b_g, blocks, cost: equations.cost };
            let (s, rhs, blocks) = eliminate(&equations, &Ridge::Relative(0.0))?;
            Some((s, rhs, Held { blocks, flat }))
        }
    }
}

/// Whether nothing sees any unknown of a block.
pub(super) fn is_unseen(block: &Block) -> bool {
    block.h_vv.diagonal().iter().all(|h| *h <= 0.0)
}

/// A block held along its flat directions, and those.
fn held(block: &Block) -> Option<(Block, DMatrix<f64>)> {
    let d = block.b_v.len();
    let root = DVector::from_fn(d, |i, _| if block.h_vv[(i, i)] > 0.0 { block.h_vv[(i, i)].sqrt() } else { 1.0 });
    let scaled = DMatrix::from_fn(d, d, |i, j| block.h_vv[(i.max(j), i.min(j))] / (root[i] * root[j]));
    let eigen = symmetric_eigen(&scaled)?;
    let flat = eigen.values.iter().filter(|v| **v < FLAT).count();
    let own = eigen.vectors.columns(0, flat);
    let information = DMatrix::from_fn(d, flat, |i, k| own[(i, k)] * root[i]);
    let directions = DMatrix::from_fn(d, flat, |i, k| own[(i, k)] / root[i]);
    let mut out = block.clone();
    out.h_vv += &information * information.transpose();
    out.h_vg -= &information * (directions.transpose() * &block.h_vg);
    out.b_v -= &information * (directions.transpose() * &block.b_v);
    Some((out, directions))
}
