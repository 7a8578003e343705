//! How likely observations are under one description of their noise beside another, all unknowns integrated out.
//!
//! With the equations linear about the state, `b` and `H` those of the description,
//! ```text
//! -2 ln L = 2 F - b^T (H + D)^-1 b + ln det (H + D) + constant,      D = LEAST / scale^2
//! ```
//! and what the description itself adds: the logarithm of the determinant of its covariance. `D` holds what nothing sees: unknowns a
//! hundred times as far as the problem is about linear, in every description alike.
//!
//! Source: Patterson and Thompson, "Recovery of inter-block information when block sizes are unequal" (1971).

use super::reduced::{Reduced, Ridge};
use super::{NormalEquations, Step};

/// Information, in scales of the unknowns, of those that nothing sees.
const LEAST: f64 = 1e-4;

/// Minus twice the logarithm of the likelihood but for the description's own part; `None` where the equations are none.
pub fn evidence(equations: &NormalEquations, scales: &Step) -> Option<f64> {
    let reduced = Reduced::of(equations, &Ridge::Scaled { mu: LEAST, scales })?;
    let value = 2.0 * equations.cost - reduced.decrement().powi(2) + reduced.log_determinant();
    value.is_finite().then_some(value)
}

/// Mean of numbers by how likely they are, of which `value` says minus twice the logarithm.
pub fn likely_mean(numbers: &[f64], value: impl FnMut(f64) -> Option<f64>) -> Option<f64> {
    let values: Vec<f64> = numbers.iter().copied().map(value).collect::<Option<_>>()?;
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let weights: Vec<f64> = values.iter().map(|v| (-0.5 * (v - least)).exp()).collect();
    Some(numbers.iter().zip(&weights).map(|(x, w)| x * w).sum::<f64>() / weights.iter().sum::<f64>())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::solve::{Block, Layout};
    use nalgebra::{DMatrix, DVector};

    /// Against the dense matrix with all unknowns in one list.
    #[test]
    fn evidence_is_that_of_the_dense_equations() {
        // Numbers without order between -1 and 1.
        let number = |k: usize| (1.7 * (k * k) as f64 + 0.3 * k as f64).sin();
        let (n, sizes) = (4, [3, 2]);
        let mut e = NormalEquations::zeros(&Layout { global: n, blocks: sizes.to_vec() });
        let total = n + 5;
        let (mut h, mut b) = (DMatrix::zeros(total, total), DVector::zeros(total));
        for row in 0..30 {
            // Every row meets the shared unknowns and one block.
            let (v, at) = if row % 2 == 0 { (0, n) } else { (1, n + 3) };
            let d = sizes[v];
            let x =
                DVector::from_fn(
                    total,
                    |i, _| if i < n || (at..at + d).contains(&i) { number(40 * row + i) } else { 0.0 },
                );
            let y = number(40 * row + 31);
            h += &x * x.transpose();
            b += &x * y;
            e.cost += 0.5 * y * y;
        }
        e.h_gg.copy_from(&h.view((0, 0), (n, n)));
        e.b_g.copy_from(&b.rows(0, n));
        for (block, (at, d)) in e.blocks.iter_mut().zip([(n, 3), (n + 3, 2)]) {
            *block = Block {
                h_vv: h.view((at, at), (d, d)).into_owned(),
                h_vg: h.view((at, 0), (d, n)).into_owned(),
                b_v: b.rows(at, d).into_owned(),
            };
        }
        let scales = Step {
            global: DVector::from_element(n, 2.0),
            blocks: sizes.map(|d| DVector::from_element(d, 2.0)).to_vec(),
        };
        let ridged = h + DMatrix::from_diagonal_element(total, total, LEAST / 4.0);
        let root = ridged.cholesky().unwrap();
        let log_determinant: f64 = root.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
        let wanted = 2.0 * e.cost - b.dot(&root.solve(&b)) + log_determinant;
        let found = evidence(&e, &scales).unwrap();
        assert!((found - wanted).abs() < 1e-10 * wanted.abs(), "{found} {wanted}");
    }
}
