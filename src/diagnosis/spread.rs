//! Whether the views scatter as their noise says: the standard deviations that they themselves tell.
//!
//! What a model lacks, and what differs from view to view (an uneven window, refraction, a plate that bends anew), is in no noise of edge points, however
//! much that was enlarged. It shows in the change d_v of a number without view v, whose variance is `D_v = C_without - C` where noise is all:
//!
//! ```text
//! h_v      = D_v / (C + D_v)                                     part of what is known of the number that view v tells
//! factor^2 = 1 + sum_v h_v (d_v^2 / D_v - 1) / max(1, sum_v h_v) C factor^2: the variance as the views tell it
//! f_v      = sign(d_v) min(|d_v|, |e_v|), 0 where d_v e_v <= 0   part of d_v that one Newton step of the equations foretells as e_v
//! Q        = sum_v h_v f_v^2 / D_v                               with the cumulants of a quadratic form of the matrix K:
//! K        = diag(h + a^2 / s) - a a^T / s,   a_v = h_v / (1 - h_v)^(1/2)
//! p        = P(chi^2_nu > nu + (Q - c_1) (nu / c_2)^(1/2)),   nu = c_2^3 / c_3^2,   c_k = tr K^k
//! ```
//!
//! Where one number is to be estimated the shares add up to 1, or to less where facts tell beside the views (their part stays as stated); K, with s = 1, is the covariance
//! of the changes over their standard deviations times `h_v^(1/2)`, exactly. Beside other unknowns a view that is left out makes all of them worse, and shares add up to more:
//! then factor^2 is the mean of `d_v^2 / D_v` weighted by shares, and s the least with which K is the covariance of anything. Where noise is all, factor^2 is 1 in the mean
//! always. Of n views alike that alone fix a number, sigma times the factor is the jackknife's standard deviation, `((n - 1) / n sum d_v^2)^(1/2)`, and `nu = n - 1`. Where
//! views scatter three times as much as stated, the variance told is right without facts, and up to a tenth too small where a fact tells as much as six views beside one
//! that tells half of the rest.
//! Of several numbers together, such as one at several points of the sheet, factor^2 is the sum of the variances that the views tell over the sum of C.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | d_v | [`Change::size`] | that of the number | change of the number without view v, adjusted |
//! | f_v | [`Change::foretold`] | that of the number | the part of it that is predicted, all of it where equations are linear; where Q finds nothing it stands for d_v in factor^2, too |
//! | D_v | [`Change::variance`] | its square | variance of that change where noise is all |
//! | C | [`Number::variance`] | its square | variance of the number with all views |
//! | h_v | `share` | 1 | share of view v |
//! | factor | [`Spread::factor`] | 1 | standard deviation as the views tell it over the one stated |
//! | nu | `degrees` | 1 | degrees of freedom |
//! | s | `slack` | 1 | how much less than those of one number alone the changes hang on each other |
//!
//! Nothing is said of a number that some view alone fixes: of its error the others do not tell.
//!
//! Source: Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples" (2002), with views as clusters, for the weights
//! and K; MacKinnon and White, "Some heteroskedasticity-consistent covariance matrix estimators" (1985); Imhof, "Computing the distribution of quadratic forms in normal
//! variables" (1961), for Pearson's approximation by three moments.

use super::keys::Keys;
use super::{FALSE_ALARMS, digits, measured};
use crate::stats::chi_square_above;

/// Factor from which on a finding is told, whatever its significance.
const FELT: f64 = 1.5;
/// Views that must tell of a number.
const FEWEST: usize = 3;
/// Largest `D_v` over the variance of a number that no view fixes alone.
const ALONE: f64 = 8.0;

/// Change of a number without one view, and the variance which that has where noise is all; zero of a view that tells nothing of it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Change {
    pub(super) size: f64,
    /// The part of it that is adjusted as it is predicted.
    pub(super) foretold: f64,
    pub(super) variance: f64,
}

/// A number as all views tell it, and without each.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Number {
    pub(super) variance: f64,
    /// One for each view.
    pub(super) changes: Vec<Change>,
}

impl Number {
    /// Each view's share in what is known, with the change without it.
    fn shares(&self) -> impl Iterator<Item = (f64, &Change)> {
        self.changes.iter().map(|c| (c.variance / (self.variance + c.variance), c))
    }

    /// With the foretold changes alone, for where nothing contradicts.
    pub(super) fn as_foretold(&mut self) {
        self.changes.iter_mut().for_each(|c| c.size = c.foretold);
    }

    /// What the views tell of the variance beyond the one stated.
    fn excess(&self) -> f64 {
        let telling = || self.shares().filter(|(share, _)| *share > 0.0);
        let sum: f64 = telling().map(|(share, _)| share).sum();
        let beyond: f64 = telling().map(|(share, c)| share * (c.size * c.size / c.variance - 1.0)).sum();
        self.variance * beyond / sum.max(1.0)
    }
}

/// The least number of at least 1 with which K is positive.
fn slack(shares: &[f64]) -> f64 {
    let too_small = |s: f64| shares.iter().map(|h| h / (h + s * (1.0 - h))).sum::<f64>() > 1.0;
    let (mut low, mut high) = (1.0, 1.0);
    while too_small(high) && high < 1e6 {
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if too_small(middle) { low = middle } else { high = middle }
    }
    high
}

/// How the views scatter about one number, in units of what their noise says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    pub(super) factor: f64,
    /// Chance of so large a factor where noise is all.
    p_value: f64,
}

/// The factor of several numbers together, whose changes are those without the same views; none where too few views tell of them, or one fixes them alone.
pub(super) fn common_factor(numbers: &[&Number]) -> Option<f64> {
    let variance: f64 = numbers.iter().map(|n| n.variance).sum();
    let views = numbers.first()?.changes.len();
    let of_view = |v: usize| numbers.iter().map(|n| n.changes[v].variance).sum::<f64>();
    let telling = (0..views).filter(|v| of_view(*v) > 0.0).count();
    if telling < FEWEST || (0..views).any(|v| of_view(v) > ALONE * variance) {
        return None;
    }
    let excess: f64 = numbers.iter().map(|n| n.excess()).sum();
    let factor = (1.0 + excess / variance).max(0.0).sqrt();
    factor.is_finite().then_some(factor)
}

impl Spread {
    /// Of one number.
    pub(super) fn of(number: &Number) -> Option<Self> {
        let factor = common_factor(&[number])?;
        let all: Vec<(f64, &Change)> = number.shares().filter(|(share, _)| *share > 0.0).collect();
        let shares: Vec<f64> = all.iter().map(|(share, _)| *share).collect();
        let squares: f64 = all.iter().map(|(share, c)| share * c.foretold * c.foretold / c.variance).sum();
        let slack = slack(&shares);
        // K = diag(d) - b b^T with b = a / sqrt(s).
        let b = |h: f64| h * h / ((1.0 - h) * slack);
        let sum = |f: &dyn Fn(f64) -> f64| shares.iter().map(|h| f(*h)).sum::<f64>();
        let [d1, d2, d3] = [1, 2, 3].map(|k| sum(&|h| (h + b(h)).powi(k)));
        let [b0, b1, b2] = [0, 1, 2].map(|k| sum(&|h| b(h) * (h + b(h)).powi(k)));
        let c1 = d1 - b0;
        let c2 = d2 - 2.0 * b1 + b0 * b0;
        let c3 = d3 - 3.0 * b2 + 3.0 * b1 * b0 - b0.powi(3);
        let degrees = c2.powi(3) / (c3 * c3);
        let p_value = chi_square_above((degrees + (squares - c1) * (degrees / c2).sqrt()).max(0.0), degrees);
        Some(Self { factor, p_value })
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

    /// Of linear equations.
    fn change(size: f64, variance: f64) -> Change {
        Change { size, foretold: size, variance }
    }

    /// The mean of numbers of known noise, each left out once: the jackknife by its definition.
    #[test]
    fn of_views_alike_it_is_the_jackknife() {
        let (n, mut random) = (9, Random(3));
        let all: Vec<f64> = (0..n).map(|_| 2.5 * random.gauss()).collect();
        let mean = |without: Option<usize>| {
            let kept: Vec<f64> = (0..n).filter(|v| Some(*v) != without).map(|v| all[v]).collect();
            kept.iter().sum::<f64>() / kept.len() as f64
        };
        let without = |v: usize| change(mean(Some(v)) - mean(None), 1.0 / (n as f64 - 1.0) - 1.0 / n as f64);
        let changes: Vec<Change> = (0..n).map(without).collect();
        let number = |changes: &[Change]| Number { variance: 1.0 / n as f64, changes: changes.to_vec() };
        let spread = Spread::of(&number(&changes)).expect("views enough");
        let plain = all.iter().map(|x| (x - mean(None)).powi(2)).sum::<f64>() / (n as f64 - 1.0);
        assert!((spread.factor / plain.sqrt() - 1.0).abs() < 1e-12, "{} {}", spread.factor, plain.sqrt());
        // Numbers of noise 2.5 where 1 was said.
        let chance = chi_square_above((n as f64 - 1.0) * plain, n as f64 - 1.0);
        assert!((spread.p_value / chance - 1.0).abs() < 1e-9 && spread.p_value < 1e-3, "{}", spread.p_value);
        let silent = [Change::default(); 3];
        assert_eq!(Spread::of(&number(&[&changes[..2], &silent].concat())), None, "two views tell");
        let with_silent = Spread::of(&number(&[&changes[..], &silent].concat())).expect("views enough");
        assert!((with_silent.factor / spread.factor - 1.0).abs() < 1e-12, "{with_silent:?} {spread:?}");
        assert!((with_silent.p_value / spread.p_value - 1.0).abs() < 1e-9, "{with_silent:?} {spread:?}");
        let alone = change(5.0, 1.0);
        assert_eq!(Spread::of(&number(&[&changes[..], &[alone]].concat())), None, "fixed by one view");
    }

    /// K has a negative eigenvalue with any smaller s, and none with this one; 1 where shares add up to 1 or less.
    #[test]
    fn the_slack_is_the_least_that_leaves_a_covariance() {
        let least = |shares: &[f64], s: f64| {
            let n = shares.len();
            let a = |i: usize| shares[i] / (1.0 - shares[i]).sqrt();
            let k = nalgebra::DMatrix::from_fn(n, n, |i, j| {
                let own = if i == j { shares[i] + a(i) * a(i) / s } else { 0.0 };
                own - a(i) * a(j) / s
            });
            k.symmetric_eigenvalues().min()
        };
        for shares in [vec![0.5; 6], vec![0.85, 0.3, 0.2, 0.05], vec![0.6, 0.6, 0.01]] {
            let s = slack(&shares);
            assert!(s > 1.01 && least(&shares, s) > -1e-9 && least(&shares, 0.99 * s) < -1e-4, "{shares:?}: {s}");
        }
        for shares in [vec![0.25; 4], vec![0.56, 0.21, 0.07, 0.07, 0.035, 0.035, 0.014], vec![0.1, 0.02, 0.3]] {
            let s = slack(&shares);
            assert!(s < 1.0 + 1e-9 && least(&shares, s) > -1e-9, "{shares:?}: {s}");
        }
    }

    const WEIGHTS: [f64; 7] = [8.0, 3.0, 1.0, 1.0, 0.5, 0.5, 0.2];

    /// Mean of numbers of unlike weights with noise of the standard deviation `noise` times what is stated, and of a fact of weight `fact` about zero, and
    /// what it would be without each of them: its value, as the views tell it.
    fn weighted(random: &mut Random, noise: f64, fact: f64) -> (f64, Number) {
        let all: Vec<f64> = WEIGHTS.iter().map(|w: &f64| noise * random.gauss() / w.sqrt()).collect();
        let total = fact + WEIGHTS.iter().sum::<f64>();
        let known = if fact > 0.0 { fact.sqrt() * random.gauss() } else { 0.0 };
        let sum = known + WEIGHTS.iter().zip(&all).map(|(w, x)| w * x).sum::<f64>();
        let without =
            |(w, x): (&f64, &f64)| change((sum - w * x) / (total - w) - sum / total, 1.0 / (total - w) - 1.0 / total);
        let changes = WEIGHTS.iter().zip(&all).map(without).collect();
        (sum / total, Number { variance: 1.0 / total, changes })
    }

    /// One weight among many small ones, without a fact and with one that tells as much as half of them or six times as much: one in the mean, no more
    /// degrees of freedom than there are, and as often beyond a limit as stated.
    #[test]
    fn chance_is_what_it_is_said_to_be() {
        const LIMITS: [f64; 3] = [0.05, 0.01, 0.003];
        for fact in [0.0, 7.0, 90.0] {
            let mut random = Random(11);
            let (mut squares, mut below) = (0.0, [0.0; LIMITS.len()]);
            let rounds = 20_000;
            for _ in 0..rounds {
                let spread = Spread::of(&weighted(&mut random, 1.0, fact).1).expect("views enough");
                squares += spread.factor * spread.factor;
                for (count, limit) in below.iter_mut().zip(LIMITS) {
                    *count += f64::from(u8::from(spread.p_value < limit));
                }
            }
            let mean = squares / f64::from(rounds);
            assert!((mean - 1.0).abs() < 0.03, "{fact}: {mean}");
            for (count, limit) in below.into_iter().zip(LIMITS) {
                let share = count / f64::from(rounds);
                assert!((0.6..1.4).contains(&(share / limit)), "{fact}: {share} of {limit}");
            }
        }
    }

    /// Of noise that is larger than stated the scatter is told, somewhat less where a fact that is as good as stated tells, too.
    #[test]
    fn larger_noise_is_told_as_it_scatters() {
        for fact in [0.0, 7.0, 90.0] {
            let mut random = Random(13);
            let (mut told, mut scatter) = (0.0, 0.0);
            for _ in 0..20_000 {
                let (value, number) = weighted(&mut random, 3.0, fact);
                let factor = common_factor(&[&number]).expect("views enough");
                told += number.variance * factor * factor;
                scatter += value * value;
            }
            let ratio = told / scatter;
            let least = if fact > 0.0 { 0.87 } else { 0.96 };
            assert!((least..1.04).contains(&ratio), "{fact}: {ratio}");
        }
    }
}
