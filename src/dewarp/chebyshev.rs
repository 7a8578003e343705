//! Polynomials through values at Chebyshev's points.

use std::f64::consts::PI;

/// Point number k of n, in (-1, 1) from above: a zero of T_n.
pub(super) fn node(k: usize, n: usize) -> f64 {
    ((k as f64 + 0.5) * PI / n as f64).cos()
}

/// a_j of `f(t) = sum_j a_j T_j(t)` through the values at the N nodes.
pub(super) fn parts<const N: usize>(values: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|j| {
        let sum: f64 = (0..N).map(|k| values[k] * (j as f64 * (k as f64 + 0.5) * PI / N as f64).cos()).sum();
        sum * if j == 0 { 1.0 } else { 2.0 } / N as f64
    })
}

/// c_p of `sum_p c_p t^p = sum_j a_j T_j(t)`.
pub(super) fn powers<const N: usize>(parts: [f64; N]) -> [f64; N] {
    let (mut out, mut last, mut one) = ([0.0; N], [0.0; N], [0.0; N]);
    one[0] = 1.0;
    for (j, part) in parts.iter().enumerate() {
        (0..N).for_each(|p| out[p] += part * one[p]);
        let mut next = [0.0; N];
        for p in 0..N {
            // T_1 = t, T_(j+1) = 2 t T_j - T_(j-1).
            let shifted = if p == 0 { 0.0 } else { one[p - 1] };
            next[p] = if j == 0 { shifted } else { 2.0 * shifted - last[p] };
        }
        (last, one) = (one, next);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_comes_back_and_a_function_nearly() {
        let wanted = [0.3, -1.2, 0.5, 2.0, -0.7, 0.1];
        let at = |t: f64| wanted.iter().rev().fold(0.0, |sum, c| sum * t + c);
        let found = powers(parts(&std::array::from_fn::<f64, 6, _>(|k| at(node(k, 6)))));
        for (a, b) in found.iter().zip(wanted) {
            assert!((a - b).abs() < 1e-14, "{found:?}");
        }
        // a_j of exp are 2 I_j(1), modified Bessel functions.
        let a = parts(&std::array::from_fn::<f64, 16, _>(|k| node(k, 16).exp()));
        for (found, bessel) in a.iter().zip([1.266_065_877_752_008, 0.565_159_103_992_485, 0.135_747_669_767_038]) {
            let wanted = if bessel > 1.0 { bessel } else { 2.0 * bessel };
            assert!((found - wanted).abs() < 1e-14, "{a:?}");
        }
    }
}
