//! The surface of a bent plate, in which its discs lie.
//!
//! Where every disc is estimated heights tell how a plate is bent, and what is seen of a disc is the outline of a circle in that surface: a plate of 20 mm that is
//! bent by 0.3 mm slopes by 0.06 rad at its rim, which at a viewing angle of 45 degrees makes a disc shorter by 6 %. Of circles that stay parallel to the plane
//! z = 0 the cameras would pay for that.
//!
//! ```text
//! dz ~ sum c_ab x^a y^b,  a + b <= d      least squares over the discs that are seen
//! (sx, sy) = grad of it, less the slope of the plane that fits dz best (which pose and heights share)
//! ```
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | x, y | `at` | 1 | Target | nominal place of a disc about the middle, over half the extent L |
//! | dz | `offsets_mm[j][2]` | mm | Target | its height |
//! | d | `degree` | 1 | - | 2 to 6: the one with which outlines fit best |
//! | (sx, sy) | `slopes` | 1 | Target | slope at a disc |
//!
//! Slopes are found from heights between solves and held during them, so that the cost stays one of least squares and its derivatives exact: a height
//! moves a disc's image far more than its slope does. A plate is taken for flat where slopes do not make outlines fit better than chance lets. Roughness from disc to disc
//! has no slope here.

use super::assemble;
use super::model::{Model, TargetShape};
use super::state::State;
use nalgebra::{DMatrix, DVector, Vector2};
use std::collections::BTreeSet;

/// By how much the cost must fall for a plate to be bent (three standard deviations), and for its slopes to be found anew.
const SHOWN: f64 = 4.5;
const ANEW: f64 = 0.05;

/// Largest degree of the surface.
const MOST: usize = 6;

/// Slopes of the surface that heights show, where outlines fit better with them; true where they have changed.
pub(super) fn follow(model: &Model, state: &mut State) -> bool {
    let contours = model.images.iter().any(|i| !i.discs.is_empty());
    if state.offsets_mm.is_empty() || !contours || !matches!(model.target.shape, TargetShape::Lattice(_)) {
        return false;
    }
    let (least, flat) = (if state.slopes.is_empty() { SHOWN } else { ANEW }, state.slopes.is_empty());
    let Some(before) = assemble::cost(model, state) else { return false };
    let candidates = (2..=MOST).map_while(|degree| slopes(model, state, degree)).chain((!flat).then(Vec::new));
    let mut tried = state.clone();
    let mut cost = |slopes: &Vec<[f64; 2]>| {
        tried.slopes.clone_from(slopes);
        assemble::cost(model, &tried)
    };
    let best = candidates.filter_map(|s| Some((cost(&s)?, s))).min_by(|a, b| a.0.total_cmp(&b.0));
    match best {
        Some((now, slopes)) if now < before - least => {
            state.slopes = slopes;
            true
        }
        _ => false,
    }
}

/// Exponents of x and y up to a degree, the plane's first.
fn terms(degree: usize) -> impl Iterator<Item = [i32; 2]> {
    (0..=degree as i32).flat_map(|d| (0..=d).map(move |b| [d - b, b]))
}

/// Least-squares coefficients of the terms up to a degree; `None` where places do not tell them apart.
fn fitted(at: &[Vector2<f64>], heights: &DVector<f64>, degree: usize) -> Option<DVector<f64>> {
    let terms: Vec<[i32; 2]> = terms(degree).collect();
    let rows = DMatrix::from_fn(at.len(), terms.len(), |j, k| at[j].x.powi(terms[k][0]) * at[j].y.powi(terms[k][1]));
    let gram = rows.tr_mul(&rows);
    let eigenvalues = gram.symmetric_eigenvalues();
    if eigenvalues.min() < 1e-8 * eigenvalues.max() || at.len() < 2 * terms.len() {
        return None;
    }
    Some(gram.cholesky()?.solve(&rows.tr_mul(heights)))
}

/// Slopes of all discs by a surface of a degree through the heights of those that are seen; `None` where they are too few for it.
fn slopes(model: &Model, state: &State, degree: usize) -> Option<Vec<[f64; 2]>> {
    let (places, half_mm) = model.target.spread(&state.shape_mm);
    let seen: BTreeSet<usize> = model.images.iter().flat_map(|i| i.discs.iter().map(|d| d.disc)).collect();
    let at: Vec<Vector2<f64>> = seen.iter().map(|j| places[*j]).collect();
    let heights = DVector::from_iterator(seen.len(), seen.iter().map(|j| state.offsets_mm[*j][2]));
    let (surface, plane) = (fitted(&at, &heights, degree)?, fitted(&at, &heights, 1)?);
    let slope = |p: &Vector2<f64>| {
        let mut slope = [-plane[1], -plane[2]];
        for ([a, b], c) in terms(degree).zip(surface.iter()) {
            slope[0] += if a > 0 { c * f64::from(a) * p.x.powi(a - 1) * p.y.powi(b) } else { 0.0 };
            slope[1] += if b > 0 { c * f64::from(b) * p.x.powi(a) * p.y.powi(b - 1) } else { 0.0 };
        }
        slope.map(|s| s / half_mm)
    };
    Some(places.iter().map(slope).collect())
}
