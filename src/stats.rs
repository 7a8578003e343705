//! Probabilities of the normal, the chi-square and the F distribution.
//!
//! ```text
//! Q(a, x) = integral from x to infinity of t^(a-1) e^-t dt / Gamma(a)
//! P(chi-square with n degrees of freedom > c) = Q(n/2, c/2),   P(|z| > s) = Q(1/2, s^2/2)
//! P(F with n over m degrees of freedom > f) = I_x(m/2, n/2),   x = m / (m + n f),   I_x(a, b) = integral from 0 to x of t^(a-1) (1-t)^(b-1) dt / B(a, b)
//! ```
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | n, m | `degrees` | degrees of freedom |
//! | c | `chi2` | weighted sum of squares |
//! | s | `sigmas` | distance in standard deviations |
//!
//! Source: Abramowitz and Stegun 6.5.29 (series, below x = a + 1) and 6.5.31 (continued fraction, above), DLMF 8.17.22 for I_x, Lanczos for ln Gamma.
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

/// Probability that the ratio of two chi-squares, each over its `degrees` of freedom, exceeds `ratio`; 1 for `ratio <= 0`, `NaN` for `NaN`.
pub(crate) fn ratio_above(ratio: f64, degrees: [f64; 2]) -> f64 {
    if ratio.is_nan() {
        return f64::NAN;
    }
    let [n, m] = degrees;
    if ratio <= 0.0 { 1.0 } else { incomplete_beta(m / (m + n * ratio), 0.5 * m, 0.5 * n) }
}

/// I_x(a, b).
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let front = (a * x.ln() + b * (-x).ln_1p() + ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b)).exp() / a;
    // Lentz's evaluation of the continued fraction, two terms at a time.
    let (mut c, mut d) = (1.0, 1.0 / nonzero(1.0 - (a + b) * x / (a + 1.0)));
    let mut h = d;
    for k in 1..10_000 {
        let k = f64::from(k);
        let even = k * (b - k) * x / ((a + 2.0 * k - 1.0) * (a + 2.0 * k));
        let odd = -(a + k) * (a + b + k) * x / ((a + 2.0 * k) * (a + 2.0 * k + 1.0));
        let mut last = 1.0;
        for term in [even, odd] {
            d = 1.0 / nonzero(1.0 + term * d);
            c = nonzero(1.0 + term / c);
            last = d * c;
            h *= last;
        }
        if (last - 1.0_f64).abs() < 1e-15 {
            break;
        }
    }
    (front * h).clamp(0.0, 1.0)
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

    /// Against another program's numbers (scipy), and in closed form for two degrees over m.
    #[test]
    fn ratios_of_chi_squares() {
        for (f, degrees, p) in [
            (3.0, [6.0, 24.0], 0.02481122852001008),
            (10.0, [6.0, 24.0], 1.4609093079624507e-05),
            (1.3, [40.0, 7.5], 0.3758062602969902),
            (250.0, [5.0, 12.0], 1.070596296394588e-11),
            (0.4, [3.0, 100.0], 0.7532943624654513),
        ] {
            assert!((ratio_above(f, degrees) / p - 1.0).abs() < 1e-10, "{f} {degrees:?} {}", ratio_above(f, degrees));
        }
        for (f, m) in [(0.01, 3.0), (1.0, 8.0), (40.0, 31.0), (1e6, 12.0)] {
            let closed = (1.0_f64 + 2.0 * f / m).powf(-0.5 * m);
            assert!((ratio_above(f, [2.0, m]) / closed - 1.0).abs() < 1e-10, "{f} {m}");
        }
        assert_eq!(ratio_above(-1.0, [3.0, 3.0]), 1.0);
        assert!(ratio_above(f64::NAN, [3.0, 3.0]).is_nan() && ratio_above(1e300, [3.0, 3.0]) < 1e-100);
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
