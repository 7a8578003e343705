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
//!
//! Of the global unknowns a direction is flat where its share of information is below the same limit ([`Directions`]). Beside very precise images a prior that is
//! worth something has less than that, and elimination leaves it to rounding; but what is known beforehand is known exactly, row by row:
//! ```text
//! K = U_0^T D^-1/2 (sum J^T J) D^-1/2 U_0 = W diag(k) W^T      k > 1e-17: the direction U_0 w is determined, with the information k
//! ```
//! unless its standard deviation, `D^-1/2 U_0 w / k^(1/2)`, is beyond what may be called known ([`Known::reach`]): an axis point that is assumed to lie near the middle
//! of the image says something of a focal length, but not whether it is half or twice as long.

use super::factor::symmetric_eigen;
use super::reduced::{Eliminated, Ridge, eliminate};
use super::{Block, Known, NormalEquations};
use nalgebra::{DMatrix, DVector};

/// Share of information below which a direction counts as undetermined.
pub(super) const FLAT: f64 = 1e-12;

/// Largest trace of the inverse of a scaled matrix: no eigenvalue is then below [`FLAT`] times ten, so that what a Cholesky factor says holds to
/// a percent.
pub(super) const DETERMINED: f64 = 0.1 / FLAT;

/// Share of information of what is known beforehand from which on it determines a flat direction: well above what rounding turns of other directions into it.
const KNOWN: f64 = 1e-17;

/// Eigenvectors of a scaled information matrix, those that nothing determines first.
pub(super) struct Directions {
    /// Shares of information.
    pub(super) values: DVector<f64>,
    /// Columns, in scaled unknowns.
    pub(super) vectors: DMatrix<f64>,
    /// Number of those that nothing determines.
    pub(super) nullity: usize,
}

impl Directions {
    /// Of a matrix scaled by `scale` on either side; shares below `limit` are none, but for what is `known`.
    pub(super) fn of(scaled: &DMatrix<f64>, scale: &DVector<f64>, known: &Known, limit: f64) -> Option<Self> {
        let eigen = symmetric_eigen(scaled)?;
        let (mut values, mut vectors) = (eigen.values, eigen.vectors);
        let flat = values.iter().filter(|v| **v < limit).count();
        if flat == 0 || known.rows.is_empty() {
            return Some(Self { values, vectors, nullity: flat });
        }
        let own = vectors.columns(0, flat).into_owned();
        let along = |row: &[(usize, f64)], k: usize| row.iter().map(|(i, d)| d * scale[*i] * own[(*i, k)]).sum::<f64>();
        let rows = DMatrix::from_fn(known.rows.len(), flat, |r, k| along(&known.rows[r], k));
        let of_known = symmetric_eigen(&rows.tr_mul(&rows))?;
        let turned = own * &of_known.vectors;
        let is_known = |k: usize| {
            let sigma = |i: usize| (scale[i] * turned[(i, k)]).abs() / of_known.values[k].sqrt();
            of_known.values[k] > KNOWN && known.reach.iter().enumerate().all(|(i, reach)| sigma(i) <= *reach)
        };
        let (determined, open): (Vec<usize>, Vec<usize>) = (0..flat).partition(|k| is_known(*k));
        let nullity = open.len();
        for (place, k) in open.into_iter().chain(determined).enumerate() {
            vectors.set_column(place, &turned.column(k));
            values[place] = if place < nullity { values[place] } else { of_known.values[k] };
        }
        Some(Self { values, vectors, nullity })
    }
}

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
            let equations = NormalEquations { h_gg, b_g, blocks, known: Known::default(), cost: equations.cost };
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
