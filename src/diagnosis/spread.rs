//! Whether the views scatter as their noise says: the standard deviations that they themselves tell.
//!
//! What a model lacks, and what differs from view to view (an uneven window, refraction, a plate that bends anew), is in no noise of edge points, however
//! much that was enlarged. It shows in the change d_v of a number without view v, whose variance is `D_v = C_without - C` where noise is all:
//!
//! ```text
//! factor^2 = sum d_v^2 / sum D_v
//! nu       = (sum D_v)^2 / sum_vw K_vw^2,   K_vv = D_v,   K_vw = - D_v D_w / C        nu factor^2 about chi-square with nu degrees of freedom
//! ```
//!
//! with K the covariance of the changes, exact where there is one number to be estimated (the mean of numbers of unlike noise), and C the variance of
//! the number itself. Of n views alike `D_v = C / (n - 1)`, `nu = n - 1`, and sigma times the factor is the jackknife's standard deviation, `((n - 1) / n sum d_v^2)^(1/2)`.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | d_v | [`Change::size`] | that of the number | change of the number without view v |
//! | D_v | [`Change::variance`] | its square | variance of that change where noise is all |
//! | C | `variance` | its square | variance of the number with all views |
//! | factor | [`Spread::factor`] | 1 | scatter of the views over what their noise says |
//! | nu | `degrees` | 1 | degrees of freedom |
//!
//! Nothing is said of a number that some view alone fixes, or that something else than views fixes (`sum D_v` is at least C where they fix it): of their error
//! the views do not tell.
//!
//! Source: Satterthwaite, "An approximate distribution of estimates of variance components" (1946), for nu; Tukey, "Bias and confidence in not quite
//! large samples" (1958); MacKinnon and White, "Some heteroskedasticity-consistent covariance matrix estimators" (1985) for the jackknife under noise that is
//! not what it was taken for.

use super::keys::Keys;
use super::{FALSE_ALARMS, digits, measured};
use crate::stats::chi_square_above;

/// Factor from which on a finding is told, whatever its significance.
const FELT: f64 = 1.5;
/// Views that must tell of a number.
const FEWEST: usize = 3;
/// The least sum of `D_v` over the variance of a number that views fix, and the largest `D_v` over it where none does so alone.
const FIXED: f64 = 0.5;
const ALONE: f64 = 8.0;

/// Change of a number without one view, and the variance which that has where noise is all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change {
    pub(super) size: f64,
    pub(super) variance: f64,
}

/// How the views scatter about one number, in units of what their noise says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    pub(super) factor: f64,
    /// Chance of so large a factor where noise is all.
    p_value: f64,
}

impl Spread {
    /// From the change without each view that has a say, of a number with the `variance` given.
    pub(super) fn of(changes: &[Change], variance: f64) -> Option<Self> {
        if changes.len() < FEWEST {
            return None;
        }
        let sum = |f: &dyn Fn(&Change) -> f64| changes.iter().map(f).sum::<f64>();
        let (squares, expected) = (sum(&|c| c.size * c.size), sum(&|c| c.variance));
        let alone = changes.iter().any(|c| c.variance > ALONE * variance);
        if alone || expected < FIXED * variance {
            return None;
        }
        let [second, fourth] = [2, 4].map(|n| sum(&|c| c.variance.powi(n)));
        let degrees = expected * expected / (second + (second * second - fourth) / (variance * variance));
        let factor = (squares / expected).sqrt();
        factor.is_finite().then(|| Self { factor, p_value: chi_square_above(degrees * factor * factor, degrees) })
    }
}

/// The finding in words; none where noise explains the scatter of every number, `sigmas` their standard deviations.
pub(super) fn finding(keys: &Keys, sigmas: &[f64], spreads: &[Option<Spread>]) -> Option<String> {
    let told = spreads.iter().filter(|s| s.is_some()).count() as f64;
    let all = spreads.iter().enumerate().filter_map(|(k, s)| Some((k, (*s)?)));
    let beyond: Vec<(usize, Spread)> =
        all.filter(|(_, s)| s.factor > FELT && s.p_value * told < FALSE_ALARMS).collect();
    let (worst, spread) = *beyond.iter().max_by(|a, b| a.1.factor.total_cmp(&b.1.factor))?;
    let (key, sigma) = (&keys.list[worst], sigmas[worst]);
    let others = match beyond.len() - 1 {
        0 => String::new(),
        1 => " (one more number by a smaller factor)".into(),
        n => format!(" ({n} more numbers by smaller factors)"),
    };
    Some(format!(
        "the views differ by more than their noise: as results change without each of them in turn, the {} is {}, with {} times the standard deviation that \
         is stated{others}; something that the model does not have differs from view to view (a lens that bends more than radially, refraction, a target \
         that moves or bends): rely on the larger ones, in the table \"What the views say of the standard deviations\"",
        key.name,
        measured(key.value, sigma * spread.factor, key.unit),
        digits(spread.factor, 2)
    ))
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    /// The mean of numbers of known noise, each left out once: the jackknife by its definition.
    #[test]
    fn of_views_alike_it_is_the_jackknife() {
        let (n, mut random) = (9, Random(3));
        let all: Vec<f64> = (0..n).map(|_| 2.5 * random.gauss()).collect();
        let mean = |without: Option<usize>| {
            let kept: Vec<f64> = (0..n).filter(|v| Some(*v) != without).map(|v| all[v]).collect();
            kept.iter().sum::<f64>() / kept.len() as f64
        };
        let change =
            |v: usize| Change { size: mean(Some(v)) - mean(None), variance: 1.0 / (n as f64 - 1.0) - 1.0 / n as f64 };
        let changes: Vec<Change> = (0..n).map(change).collect();
        let spread = Spread::of(&changes, 1.0 / n as f64).expect("views enough");
        let plain = all.iter().map(|x| (x - mean(None)).powi(2)).sum::<f64>() / (n as f64 - 1.0);
        assert!((spread.factor / plain.sqrt() - 1.0).abs() < 1e-12, "{} {}", spread.factor, plain.sqrt());
        // Numbers of noise 2.5 where 1 was said.
        let chance = chi_square_above((n as f64 - 1.0) * plain, n as f64 - 1.0);
        assert!((spread.p_value / chance - 1.0).abs() < 1e-9 && spread.p_value < 1e-3, "{}", spread.p_value);
        assert_eq!(Spread::of(&changes[..2], 1.0 / n as f64), None);
        assert_eq!(Spread::of(&changes, 20.0 / n as f64), None, "fixed by something else");
        let alone = Change { size: 5.0, variance: 1.0 };
        assert_eq!(Spread::of(&[&changes[..], &[alone]].concat(), 1.0 / n as f64), None, "fixed by one view");
    }

    /// One weight among many small ones: no more degrees of freedom than it leaves; as often beyond a limit as stated.
    #[test]
    fn chance_is_what_it_is_said_to_be() {
        const LIMITS: [f64; 3] = [0.05, 0.01, 0.003];
        let weights = [8.0, 3.0, 1.0, 1.0, 0.5, 0.5, 0.2];
        let total: f64 = weights.iter().sum();
        let mut random = Random(11);
        let (mut squares, mut below) = (0.0, [0.0; LIMITS.len()]);
        let rounds = 20_000;
        for _ in 0..rounds {
            let all: Vec<f64> = weights.iter().map(|w: &f64| random.gauss() / w.sqrt()).collect();
            let mean = weights.iter().zip(&all).map(|(w, x)| w * x).sum::<f64>() / total;
            let change = |(w, x): (&f64, &f64)| Change {
                size: (total * mean - w * x) / (total - w) - mean,
                variance: 1.0 / (total - w) - 1.0 / total,
            };
            let changes: Vec<Change> = weights.iter().zip(&all).map(change).collect();
            let spread = Spread::of(&changes, 1.0 / total).expect("views enough");
            squares += spread.factor * spread.factor;
            for (count, limit) in below.iter_mut().zip(LIMITS) {
                *count += f64::from(u8::from(spread.p_value < limit));
            }
        }
        let mean = squares / f64::from(rounds);
        assert!((mean - 1.0).abs() < 0.06, "{mean}");
        for (count, limit) in below.into_iter().zip(LIMITS) {
            let share = count / f64::from(rounds);
            assert!((0.6..1.4).contains(&(share / limit)), "{share} of {limit}");
        }
    }
}
