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
//! has no slope here, and what is not known of slopes is in no standard deviation. A disc is flat itself: that its rim lies a quarter of radius squared times the
//! trace of the surface's second derivatives above its tangent plane (0.2 um of discs of 1.4 mm on a plate of 38 mm bent by 0.3 mm) is left out.
//!
//! Source: none; the polynomial is the ordinary one of least squares, the rest is held against drawn plates (tests/bent_sheet.rs).

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
    let flat = state.slopes.is_empty();
    let least = if flat { SHOWN } else { ANEW };
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
    let seen: Vec<(Vector2<f64>, f64)> = seen.iter().map(|j| (places[*j], state.offsets_mm[*j][2])).collect();
    let slopes = gradient(&seen, &places, degree)?;
    Some(slopes.into_iter().map(|slope| slope.map(|s| s / half_mm)).collect())
}

/// Gradient, at places, of a surface of a degree through heights at places, less that of the plane that fits them best.
fn gradient(seen: &[(Vector2<f64>, f64)], places: &[Vector2<f64>], degree: usize) -> Option<Vec<[f64; 2]>> {
    let at: Vec<Vector2<f64>> = seen.iter().map(|s| s.0).collect();
    let heights = DVector::from_iterator(seen.len(), seen.iter().map(|s| s.1));
    let (surface, plane) = (fitted(&at, &heights, degree)?, fitted(&at, &heights, 1)?);
    let slope = |p: &Vector2<f64>| {
        let mut slope = [-plane[1], -plane[2]];
        for ([a, b], c) in terms(degree).zip(surface.iter()) {
            slope[0] += if a > 0 { c * f64::from(a) * p.x.powi(a - 1) * p.y.powi(b) } else { 0.0 };
            slope[1] += if b > 0 { c * f64::from(b) * p.x.powi(a) * p.y.powi(b - 1) } else { 0.0 };
        }
        slope
    };
    Some(places.iter().map(slope).collect())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Of a grid of so many columns and rows, and heights over it.
    fn seen(columns: usize, rows: usize, height: impl Fn(f64, f64) -> f64) -> Vec<(Vector2<f64>, f64)> {
        let part = |k: usize, of: usize| 2.0 * k as f64 / (of - 1).max(1) as f64 - 1.0;
        let place = |k: usize| Vector2::new(part(k % columns, columns), part(k / columns, rows));
        (0..columns * rows).map(|k| (place(k), height(place(k).x, place(k).y))).collect()
    }

    /// Against the derivatives of a cubic surface; over a symmetric grid the plane beside `x^3` has the slope `sum x^4 / sum x^2`, and a tilt has none.
    #[test]
    fn slopes_are_those_of_the_surface_beside_its_plane() {
        let seen = seen(7, 6, |x, y| 0.3 * x * x - 0.2 * x * y + 0.1 * x.powi(3) + 0.4 * y + 5.0);
        let places: Vec<Vector2<f64>> = seen.iter().map(|s| s.0).collect();
        let sum = |power: i32| places.iter().map(|p| p.x.powi(power)).sum::<f64>();
        for degree in 3..=4 {
            let slopes = gradient(&seen, &places, degree).unwrap();
            for (p, slope) in places.iter().zip(slopes) {
                let wanted = [0.6 * p.x - 0.2 * p.y + 0.3 * p.x * p.x - 0.1 * sum(4) / sum(2), -0.2 * p.x];
                assert!((0..2).all(|k| (slope[k] - wanted[k]).abs() < 1e-10), "{degree}: {slope:?}, {wanted:?}");
            }
        }
    }

    /// Two rows say nothing of a bend across them, nor a few discs of one in many terms.
    #[test]
    fn surfaces_that_places_do_not_tell_are_not_found() {
        for (columns, rows, most) in [(10, 2, 1), (3, 3, 1), (4, 3, 2), (5, 4, 3), (9, 9, 6)] {
            let seen = seen(columns, rows, |x, _| x * x);
            let told = (2..=MOST).take_while(|degree| gradient(&seen, &[], *degree).is_some()).last().unwrap_or(1);
            assert_eq!(told, most, "{columns} x {rows}");
        }
    }
}
