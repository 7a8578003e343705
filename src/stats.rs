//! Probabilities of the normal and the chi-square distribution.
//!
//! ```text
//! Q(a, x) = integral from x to infinity of t^(a-1) e^-t dt / Gamma(a)
//! P(chi-square with n degrees of freedom > c) = Q(n/2, c/2),   P(|z| > s) = Q(1/2, s^2/2)
//! ```
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | n | `degrees` | degrees of freedom |
//! | c | `chi2` | weighted sum of squares |
//! | s | `sigmas` | distance in standard deviations |
//!
//! Source: Abramowitz and Stegun 6.5.29 (series, below x = a + 1) and 6.5.31 (continued fraction, above), Lanczos for ln Gamma.
//! Accurate to about 1e-12 relative for few degrees, 1e-11 for 1e4 and 1e-9 for 1e6, where ln Gamma is subtracted from numbers of its own size; below
//! 1e-300 the answer is 0.

#[cfg(test)]
pub(crate) mod random;

/// Standard deviations either way that hold a normal number 95 times in 100.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Probability that a chi-square with `degrees` degrees of freedom, whole or not, exceeds `chi2`; 1 for `chi2 <= 0`, `NaN` for `NaN`.
///
/// ```
/// // Two degrees of freedom: e^(-x/2).
/// assert!((spivcal::stats::chi_square_above(6.0, 2.0) - (-3.0_f64).exp()).abs() < 1e-14);
/// ```
pub fn chi_square_above(chi2: f64, degrees: f64) -> f64 {
    upper_gamma(degrees / 2.0, chi2 / 2.0)
}

/// Standard deviation of normal numbers over the median of their sizes.
pub(crate) const SIGMA_OVER_MEDIAN: f64 = 1.4826;

/// The middle one of some numbers, of two the larger, which end in another order; none of nothing.
pub(crate) fn median(numbers: &mut [f64]) -> Option<f64> {
    let middle = numbers.len() / 2;
    (!numbers.is_empty()).then(|| *numbers.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Probability that a normal number lies further than `sigmas` standard deviations from its mean, on either side.
pub fn normal_beyond(sigmas: f64) -> f64 {
    upper_gamma(0.5, 0.5 * sigmas * sigmas)
}

/// Probability that a normal number is less than so many standard deviations above its mean.
pub(crate) fn normal_below(sigmas: f64) -> f64 {
    let beyond = 0.5 * normal_beyond(sigmas);
    if sigmas > 0.0 { 1.0 - beyond } else { beyond }
}

/// The standard deviations above its mean below which a normal number lies with this probability, at most 10 either way; to 1e-12.
pub(crate) fn sigmas_below(probability: f64) -> f64 {
    let (mut low, mut high) = (-10.0, 10.0);
    for _ in 0..44 {
        let middle = 0.5 * (low + high);
        if normal_below(middle) < probability { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Q(a, x).
fn upper_gamma(a: f64, x: f64) -> f64 {
    if x.is_nan() {
        return f64::NAN;
    }
    if x <= 0.0 || a <= 0.0 {
        return 1.0;
    }
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    // The slowest case, x = a, needs about 6 sqrt(a) terms.
    let most = 200 + 20 * a.sqrt() as usize;
    if x < a + 1.0 {
        let (mut term, mut sum) = (1.0 / a, 1.0 / a);
        for k in 1..most {
            term *= x / (a + k as f64);
            sum += term;
            if term < sum * 1e-16 {
                break;
            }
        }
        return (1.0 - front * sum).clamp(0.0, 1.0);
    }
    // Lentz's evaluation of the continued fraction.
    let mut b = x + 1.0 - a;
    let mut c = 1e300;
    let mut d = 1.0 / b;
    let mut h = d;
    for k in 1..most {
        let an = -(k as f64) * (k as f64 - a);
        b += 2.0;
        d = 1.0 / nonzero(an * d + b);
        c = nonzero(b + an / c);
        h *= d * c;
        if (d * c - 1.0).abs() < 1e-15 {
            break;
        }
    }
    (front * h).clamp(0.0, 1.0)
}

fn nonzero(x: f64) -> f64 {
    if x.abs() < 1e-300 { 1e-300 } else { x }
}

/// Lanczos, g = 7, nine terms.
fn ln_gamma(x: f64) -> f64 {
    const TERMS: [f64; 8] = [
        676.5203681218851,
        -1259.1392167224028,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507343278686905,
        -0.13857109526572012,
        9.984_369_578_019_572e-6,
        1.5056327351493116e-7,
    ];
    let y = x - 1.0;
    let sum = TERMS.iter().enumerate().fold(0.999_999_999_999_809_9, |s, (k, c)| s + c / (y + k as f64 + 1.0));
    let t = y + 7.5;
    0.5 * std::f64::consts::TAU.ln() + (y + 0.5) * t.ln() - t + sum.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_are_found_by_their_probability() {
        assert!((normal_below(1.0) - 0.841_344_746_068_543).abs() < 1e-12 && normal_below(0.0) == 0.5);
        for sigmas in [-6.0, -NORMAL_95, 0.0, 0.4, 3.5] {
            assert!((sigmas_below(normal_below(sigmas)) - sigmas).abs() < 1e-10, "{sigmas}");
        }
        assert!((sigmas_below(0.025) + NORMAL_95).abs() < 1e-10);
        assert!(sigmas_below(0.0) < -9.9 && sigmas_below(1.0) > 8.0);
    }

    #[test]
    fn tables_of_the_normal_and_the_chi_square() {
        for (z, p) in [(1.0, 0.317310507862914), (NORMAL_95, 0.05), (5.0, 5.733031437583866e-7)] {
            assert!((normal_beyond(z) / p - 1.0).abs() < 1e-11, "{z} {}", normal_beyond(z));
        }
        // Upper points of the usual tables; even degrees also in closed form.
        for (c, n, p) in
            [(3.841458820694124, 1.0, 0.05), (18.307038053275146, 10.0, 0.05), (124.34211340400407, 100.0, 0.05)]
        {
            assert!((chi_square_above(c, n) / p - 1.0).abs() < 1e-10, "{n} {}", chi_square_above(c, n));
        }
        for x in [0.1, 2.0, 7.0, 40.0] {
            let h: f64 = 0.5 * x;
            let closed = (-h).exp() * (1.0 + h + h * h / 2.0 + h * h * h / 6.0);
            assert!((chi_square_above(x, 8.0) / closed - 1.0).abs() < 1e-12);
        }
        // By 40 digits (mpmath).
        for (c, n, p, within) in [
            (9800.0, 1e4, 0.922_055_043_773_486_1, 1e-11),
            (10_200.0, 1e4, 0.079_328_881_077_618_98, 1e-11),
            (999_000.0, 1e6, 0.760_176_731_459_872_8, 1e-9),
            (1_001_000.0, 1e6, 0.239_676_804_825_521_36, 1e-9),
        ] {
            let q = chi_square_above(c, n);
            assert!((q / p - 1.0).abs() < within, "{n} {q} {:e}", q / p - 1.0);
        }
        // Median of a large chi-square is n - 2/3.
        assert!((chi_square_above(100_000.0 - 2.0 / 3.0, 100_000.0) - 0.5).abs() < 1e-6);
        assert_eq!((chi_square_above(0.0, 3.0), chi_square_above(1e6, 3.0)), (1.0, 0.0));
        assert!(chi_square_above(f64::NAN, 3.0).is_nan());
    }
}
