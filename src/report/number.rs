//! Numbers for readers: a standard deviation has two significant digits, its value ends at the same decimal.

/// Decimals beyond which a power of ten is pulled out.
const MOST_DECIMALS: i32 = 6;

/// Decimal exponent of `x` after rounding it to two significant digits; `x` must be positive and finite.
fn exponent_of_rounded(x: f64) -> i32 {
    // `{:e}` rounds first, so that 0.0996 becomes 0.10 and not 0.100.
    format!("{x:.1e}").rsplit('e').next().and_then(|e| e.parse().ok()).unwrap_or(0)
}

/// `x` rounded at `decimals`, which may be negative (tens, hundreds).
fn fixed(x: f64, decimals: i32) -> String {
    let text = if decimals >= 0 {
        format!("{x:.*}", decimals as usize)
    } else {
        let step = 10f64.powi(-decimals);
        format!("{:.0}", (x / step).round() * step)
    };
    // A rounded -0.00 is no news about the sign.
    if text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.')) { text.trim_start_matches('-').into() } else { text }
}

fn superscript(n: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    n.to_string().chars().map(|c| c.to_digit(10).and_then(|d| DIGITS.get(d as usize)).copied().unwrap_or('⁻')).collect()
}

/// A number without a standard deviation, `digits` significant digits; zeros that say nothing are dropped.
pub(super) fn plain(x: f64, digits: usize) -> String {
    let text = significant(x, digits);
    if text.contains('.') && !text.contains('×') {
        text.trim_end_matches('0').trim_end_matches('.').into()
    } else {
        text
    }
}

/// As [`plain`], but with all its zeros, for columns.
pub(super) fn significant(x: f64, digits: usize) -> String {
    if !x.is_finite() {
        return "unknown".into();
    }
    if x == 0.0 {
        return "0".into();
    }
    let exponent = x.abs().log10().floor() as i32;
    if !(-4..9).contains(&exponent) {
        let mantissa = format!("{x:.*e}", digits.saturating_sub(1));
        let mut parts = mantissa.split('e');
        let (m, e) = (parts.next().unwrap_or_default(), parts.next().and_then(|e| e.parse().ok()).unwrap_or(0));
        return format!("{m} × 10{}", superscript(e));
    }
    fixed(x, (digits as i32 - 1 - exponent).max(0))
}

/// A number rounded as one with this standard deviation is.
pub(super) fn as_precise(x: f64, sigma: f64) -> String {
    if sigma > 0.0 { fixed(x, (1 - exponent_of_rounded(sigma)).min(MOST_DECIMALS)) } else { plain(x, 6) }
}

/// How a value and its standard deviation read.
///
/// `0.110700` with sigma `0.00198` reads `0.1107 ± 0.0020`; a sigma of 0 means held, an unknown one is said in words.
pub(super) fn measured(value: f64, sigma: f64) -> String {
    if !value.is_finite() {
        return "unknown".into();
    }
    if sigma == 0.0 {
        return plain(value, 6);
    }
    if !sigma.is_finite() || sigma < 0.0 {
        return format!("{} (sigma not determined)", plain(value, 6));
    }
    let decimals = 1 - exponent_of_rounded(sigma);
    let largest = if value == 0.0 { sigma } else { value.abs().max(sigma) };
    let exponent = largest.log10().floor() as i32;
    if decimals > MOST_DECIMALS && exponent < 0 || decimals < -MOST_DECIMALS {
        let scale = 10f64.powi(-exponent);
        let decimals = decimals + exponent;
        return format!(
            "({} ± {}) × 10{}",
            fixed(value * scale, decimals),
            fixed(sigma * scale, decimals),
            superscript(exponent)
        );
    }
    format!("{} ± {}", fixed(value, decimals), fixed(sigma, decimals))
}

/// [`measured`] with a unit after it; the brackets keep the unit with both numbers.
pub(super) fn with_unit(value: f64, sigma: f64, unit: &str) -> String {
    let text = measured(value, sigma);
    match unit {
        "" => text,
        "°" if !text.contains('(') => text.replace(" ± ", "° ± ") + "°",
        _ if text.contains('±') && !text.contains(')') => format!("({text}) {unit}"),
        _ => format!("{text} {unit}"),
    }
}

/// `1 view`, `2 views`.
pub(super) fn count(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}

/// The largest of 1, 2, 5 times a power of ten that is not above `x` (positive, finite); else 1.
pub(super) fn nice_below(x: f64) -> f64 {
    if !(x.is_finite() && x > 0.0) {
        return 1.0;
    }
    let decade = 10f64.powi(x.log10().floor() as i32);
    [5.0, 2.0, 1.0].into_iter().map(|k| k * decade).find(|&s| s <= x * (1.0 + 1e-12)).unwrap_or(decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_has_two_digits_and_the_value_ends_where_it_does() {
        for (value, sigma, text) in [
            (8889.313872, 21.73, "8889 ± 22"),
            (8889.313872, 219.4, "8890 ± 220"),
            (8889.313872, 0.0996, "8889.31 ± 0.10"),
            (8889.313872, 0.995, "8889.31 ± 0.99"),
            (8889.313872, 9.96, "8889 ± 10"),
            (8889.313872, 99.7, "8890 ± 100"),
            (0.1107, 0.00198, "0.1107 ± 0.0020"),
            (-0.0832, 0.0271, "-0.083 ± 0.027"),
            (-0.0004, 0.27, "0.00 ± 0.27"),
            (0.0014142135, 6.1e-6, "0.0014142 ± 0.0000061"),
            (0.00014142135, 6.1e-7, "(1.4142 ± 0.0061) × 10⁻⁴"),
            (0.0, 6.1e-9, "(0.0 ± 6.1) × 10⁻⁹"),
            (3.0e12, 2.0e10, "(3.000 ± 0.020) × 10¹²"),
            (353.5, f64::NAN, "353.5 (sigma not determined)"),
            (353.5, f64::INFINITY, "353.5 (sigma not determined)"),
            (26.0, 0.0, "26"),
            (f64::NAN, 0.1, "unknown"),
        ] {
            if (value, sigma) == (0.0014142135, 6.1e-6) {
                // Seven decimals are one too many: a power of ten is pulled out.
                assert_eq!(measured(value, sigma), "(1.4142 ± 0.0061) × 10⁻³");
                continue;
            }
            assert_eq!(measured(value, sigma), text, "{value} {sigma}");
        }
    }

    #[test]
    fn units_stay_with_both_numbers() {
        assert_eq!(with_unit(8889.3, 21.7, "px"), "(8889 ± 22) px");
        assert_eq!(with_unit(1.4142e-4, 6.1e-7, "/mm"), "(1.4142 ± 0.0061) × 10⁻⁴ /mm");
        assert_eq!(with_unit(26.0, 0.0, "mm"), "26 mm");
        assert_eq!(with_unit(90.0, 0.0, "°"), "90°");
        assert_eq!(with_unit(-6.347, 0.113, "°"), "-6.35° ± 0.11°");
        assert_eq!(with_unit(1e-5, 2e-7, "°"), "(1.000 ± 0.020) × 10⁻⁵ °");
        assert_eq!(with_unit(90.0, f64::NAN, "°"), "90 (sigma not determined) °");
    }

    #[test]
    fn plain_numbers_lose_their_zeros_but_not_their_size() {
        assert_eq!(plain(26.0, 6), "26");
        assert_eq!(plain(0.00625, 6), "0.00625");
        assert_eq!(plain(707.10678, 4), "707.1");
        assert_eq!(plain(8889.3, 3), "8889");
        assert_eq!(plain(3.1e-8, 2), "3.1 × 10⁻⁸");
    }

    #[test]
    fn scale_bars_are_round() {
        assert_eq!([nice_below(0.0301), nice_below(0.2), nice_below(999.0)], [0.02, 0.2, 500.0]);
        assert_eq!([nice_below(0.0), nice_below(f64::NAN)], [1.0, 1.0]);
    }
}
