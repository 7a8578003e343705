//! How rough the contours of one image are, told by all of them together.
//!
//! A contour by itself tells its roughness badly: of 38 degrees of freedom chance makes chi-square larger or smaller by a quarter. Were whatever it shows
//! beyond the noise taken for roughness, half of all clean contours would be rough, and sigmas of clean dots 3 % too large on average (docs/accuracy.md).
//! But discs of one image come from one print. With `e_i` the variance that takes chi-square of contour i to its degrees of freedom `n_i`,
//! negative where noise alone is more than enough, and `h_i` the variance of its edge points by noise,
//!
//! ```text
//! e_i = m + apart + chance,    var (chance) = s_i^2 = 2 (h_i + m)^2 / n_i,    var (apart) = t^2
//! ```
//!
//! m and t are estimated from all contours but those that lie far off, whose roughness is their own, and a contour is taken to be as rough as all of
//! this says,
//!
//! ```text
//! r_i = max(0, m' + (e_i - m') t^2 / (t^2 + s_i^2)),    m' = max(0, m - var (m) / m)
//! ```
//!
//! Where all contours together show hardly more than noise (5 % of its variance), that is the noise of all, and those alone are asked that show much more by
//! themselves. Of these, of contours that lie far off and of a single disc r is `max(0, e - s^2 / e)`, s^2 that of noise alone.
//!
//! Each edge point is that rough, r. The covariance of an ellipse grows by L times what r would add were points rough each for itself
//! ([`super::long_waves`]), and all but one part of that is noise that the points of the contour have in common.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | e, h, n | [`Said`] | px^2, px^2, 1 | what a contour says |
//! | r | `variance_px2` | px^2 | variance that is added to those of its edge points |
//! | L | `long` | 1 | waves that bend an ellipse over all, as their powers |
//!
//! Source: DerSimonian and Laird, Controlled Clinical Trials 7 (1986), for m and t; James and Stein's estimator with its positive part (Efron and Morris,
//! J. Amer. Statist. Assoc. 68 (1973)) for what chance leaves of r.

use super::long_waves::Rim;
use super::{Said, roughen, said, shrunk};
use crate::conic::Feet;
use crate::detect::refine::is_known;
use crate::detect::{DetectOptions, Disc, RejectionReason};
use crate::stats::{SIGMA_OVER_MEDIAN, median};
use crate::threads::{self, OwnMemory};

/// Roughness that no contour is asked about, of the variance by noise.
const EVEN: f64 = 0.05;
/// Contours that tell whether more of them need to be asked.
const MANY: usize = 128;
/// Standard deviations by which a contour alone shows more than noise, and by which it lies off those of the others.
const SURELY: f64 = 4.0;
const FAR: f64 = 4.0;
/// Rounds in which chance is judged by the mean of the round before.
const ROUNDS: usize = 3;
/// Standard deviation of a place or an axis beyond which a rough contour is none, in semi-minor axes.
const MOST_ROUGH: f64 = 0.25;

/// How rough a contour is.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rough {
    /// Variance of each edge point, px^2.
    variance_px2: f64,
    /// How many times as much there is of the waves that bend an ellipse as of all.
    long: f64,
}

impl Said {
    /// Variance of the excess by chance, of contours of some roughness, px^4.
    fn variance(&self, rough_px2: f64) -> f64 {
        2.0 / self.freedom * (self.noise_px2 + rough_px2.max(0.0)).powi(2)
    }

    /// The roughness of a contour that stands alone.
    fn alone(&self) -> Rough {
        let long = Rim::of(&[(self, 1.0)]).long(&self.waves);
        Rough { variance_px2: shrunk(self.excess_px2, self.variance(0.0)), long }
    }
}

type Refined = Result<Disc, RejectionReason>;

/// Makes the discs of an image as rough as their contours say; turns down those that are no longer known well enough.
pub(crate) fn roughen_all(refined: &mut [Refined], options: &DetectOptions) {
    let discs: Vec<(usize, &Disc)> =
        refined.iter().enumerate().filter_map(|(i, disc)| Some((i, disc.as_ref().ok()?))).collect();
    let memory = OwnMemory::<Feet>::new();
    let ask = |of: &[(usize, &Disc)]| threads::side_by_side(of, |(_, disc)| memory.with(|feet| said(disc, feet)));
    let shown: Vec<Shown> = discs.iter().map(|(_, disc)| Shown::of(disc)).collect();
    let even = even(&discs, &shown, ask);
    let asked = discs.iter().zip(&shown).filter(|(_, shown)| even.is_none() || shows_more(&[**shown], SURELY));
    let asked: Vec<(usize, &Disc)> = asked.map(|(disc, _)| *disc).collect();
    let told = ask(&asked);
    let pool = if even.is_none() { Pool::of(&told) } else { None };
    let rough = |said: &Said| pool.as_ref().map_or_else(|| said.alone(), |pool| pool.rough(said));
    let worth = asked.iter().zip(&told).map(|((i, disc), said)| (*i, *disc, rough(said), said.noise_px2));
    let worth = worth.filter(|(_, _, rough, noise_px2)| rough.variance_px2 > EVEN * noise_px2);
    let worth: Vec<(usize, &Disc, Rough)> = worth.map(|(i, disc, rough, _)| (i, disc, rough)).collect();
    let again = |(_, disc, rough): &(usize, &Disc, Rough)| memory.with(|feet| roughened(disc, *rough, options, feet));
    let new = threads::side_by_side(&worth, again);
    let places: Vec<usize> = worth.iter().map(|x| x.0).collect();
    let by = 1.0 + even.unwrap_or(0.0);
    if by > 1.0 {
        threads::each(refined, |disc| disc.iter_mut().for_each(|disc| widen(disc, by)));
    }
    places.into_iter().zip(new).for_each(|(i, disc)| refined[i] = disc);
}

/// By what part all contours scatter more than noise explains, where that is so little that none need be asked how rough it is.
fn even(discs: &[(usize, &Disc)], all: &[Shown], ask: impl Fn(&[(usize, &Disc)]) -> Vec<Said>) -> Option<f64> {
    if !shows_more(all, 1.0) {
        return Some(shown(all).map_or(0.0, |(more, chance)| shrunk(more, chance)));
    }
    // What looks rough may be bent smoothly: of many contours some are asked first.
    let some: Vec<_> = discs.iter().step_by(discs.len().div_ceil(MANY).max(1)).copied().collect();
    if some.len() == discs.len() {
        return None;
    }
    Pool::of(&ask(&some)).map(|pool| pool.common_px2 / pool.noise_px2).filter(|more| *more <= EVEN)
}

/// What a contour shows at a glance, smooth bends counted.
#[derive(Debug, Clone, Copy)]
struct Shown {
    chi2: f64,
    freedom: f64,
}

impl Shown {
    fn of(disc: &Disc) -> Self {
        Self { chi2: disc.contour.chi2(), freedom: (disc.edge.sigma_px.len() as f64 - 5.0).max(1.0) }
    }
}

/// By what part some contours scatter more than noise explains, smooth bends counted, and the variance of that by chance; none of nothing.
fn shown(all: &[Shown]) -> Option<(f64, f64)> {
    let (chi2, freedom) = all.iter().fold((0.0, 0.0), |sum, x| (sum.0 + x.chi2, sum.1 + x.freedom));
    (freedom > 0.0).then(|| (chi2 / freedom - 1.0, 2.0 / freedom))
}

/// Whether that is beyond chance by so many standard deviations, and more than is let pass.
fn shows_more(all: &[Shown], sigmas: f64) -> bool {
    shown(all).is_some_and(|(more, chance)| more > EVEN.max(sigmas * chance.sqrt()))
}

/// Multiplies the variances of a disc and its edge points.
fn widen(disc: &mut Disc, by: f64) {
    disc.covariance *= by;
    disc.edge.sigma_px.iter_mut().for_each(|sigma| *sigma *= by.sqrt());
}

/// What contours say together.
struct Pool {
    /// m' and t^2, px^2 and px^4.
    common_px2: f64,
    apart_px4: f64,
    /// What lies further than this from there is no one's but its own, px^2.
    middle_px2: f64,
    spread_px2: f64,
    /// Mean variance by noise, px^2.
    noise_px2: f64,
    rim: Rim,
}

impl Pool {
    /// Of at least one contour.
    fn of(all: &[Said]) -> Option<Self> {
        let mut sorted: Vec<f64> = all.iter().map(|x| x.excess_px2).collect();
        let middle_px2 = median(&mut sorted)?;
        sorted.iter_mut().for_each(|x| *x = (*x - middle_px2).abs());
        let spread_px2 = SIGMA_OVER_MEDIAN * median(&mut sorted)?;
        let noise_px2 = all.iter().map(|x| x.noise_px2).sum::<f64>() / all.len() as f64;
        let mut pool =
            Self { common_px2: middle_px2, apart_px4: 0.0, middle_px2, spread_px2, noise_px2, rim: Rim::default() };
        let of: Vec<&Said> = all.iter().filter(|x| pool.holds(x)).collect();
        let count = of.len() as f64;
        for _ in 0..ROUNDS {
            let chance = |x: &Said| x.variance(pool.common_px2);
            let (mean, [sum, squares]) = weighed(&of, chance);
            let about = of.iter().map(|x| (x.excess_px2 - mean).powi(2) / chance(x)).sum::<f64>();
            let by_one = sum - squares / sum;
            let apart_px4 = if of.len() > 1 { ((about - count + 1.0) / by_one).max(0.0) } else { 0.0 };
            let common_px2 = weighed(&of, |x| chance(x) + apart_px4).0;
            (pool.apart_px4, pool.common_px2) = (apart_px4, common_px2);
        }
        let weight = |x: &Said| 1.0 / (x.variance(pool.common_px2) + pool.apart_px4);
        pool.rim = Rim::of(&of.iter().map(|x| (*x, weight(x))).collect::<Vec<_>>());
        let weights = weighed(&of, |x| x.variance(0.0) + pool.apart_px4).1[0];
        pool.common_px2 = shrunk(pool.common_px2, 1.0 / weights);
        Some(pool)
    }

    /// Whether a contour is one of those that say something of each other.
    fn holds(&self, x: &Said) -> bool {
        (x.excess_px2 - self.middle_px2).abs() <= FAR * self.spread_px2.max(x.variance(self.middle_px2).sqrt())
    }

    /// How rough a contour is.
    fn rough(&self, x: &Said) -> Rough {
        if !self.holds(x) {
            return x.alone();
        }
        let share = self.apart_px4 / (self.apart_px4 + x.variance(self.common_px2));
        let variance_px2 = (self.common_px2 + (x.excess_px2 - self.common_px2) * share).max(0.0);
        Rough { variance_px2, long: self.rim.long(&x.waves) }
    }
}

/// Mean of the excesses weighed by one over a variance each, and the sums of the weights and of their squares.
fn weighed(of: &[&Said], variance: impl Fn(&Said) -> f64) -> (f64, [f64; 2]) {
    let (mut sum, mut weights, mut squares) = (0.0, 0.0, 0.0);
    for x in of {
        let w = 1.0 / variance(x);
        (sum, weights, squares) = (sum + w * x.excess_px2, weights + w, squares + w * w);
    }
    (sum / weights, [weights, squares])
}

/// A disc as rough as that: its edge points each for itself, its ellipse by the long waves.
fn roughened(disc: &Disc, rough: Rough, options: &DetectOptions, feet: &mut Feet) -> Refined {
    let e = &disc.ellipse;
    let shape_px = options.most_rms_px(e);
    let unknown = RejectionReason::NotElliptical { rms_px: f64::INFINITY, limit_px: shape_px };
    let (mut edge, mut contour) = (disc.edge.clone(), disc.contour.clone());
    feet.find(e, &edge.u_px, &edge.v_px);
    let (ellipse, [regular, added]) = roughen(e, &mut edge, rough.variance_px2, feet).ok_or(unknown)?;
    let covariance = disc.covariance + added * rough.long;
    if !is_known(&covariance, shape_px.max(MOST_ROUGH * e.semi_minor_px)) {
        return Err(unknown);
    }
    contour.enlarge((0..4).map(|i| (covariance[(i, i)] / disc.covariance[(i, i)]).sqrt()).fold(1.0, f64::max));
    if rough.long > 1.0 {
        contour.add(&(regular * (rough.long - 1.0)));
    }
    Ok(Disc { ellipse, covariance, edge, contour, ..disc.clone() })
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::detect::rough::long_waves::Waves;
    use crate::stats::random::Random;

    /// Noise that is alike everywhere, and as many degrees of freedom.
    const NOISE: f64 = 4e-4;
    const FREEDOM: usize = 38;

    /// What a contour says whose points scatter by noise and roughness, both in units of the noise.
    fn shown(rough: f64, random: &mut Random) -> Said {
        let chi2: f64 = (0..FREEDOM).map(|_| (1.0 + rough) * random.gauss().powi(2)).sum();
        let freedom = FREEDOM as f64;
        told((chi2 / freedom - 1.0) * NOISE)
    }

    /// What says nothing of long waves.
    fn told(excess_px2: f64) -> Said {
        Said { excess_px2, noise_px2: NOISE, freedom: FREEDOM as f64, waves: Waves::default() }
    }

    fn pooled(all: &[Said]) -> Vec<f64> {
        let pool = Pool::of(all).expect("contours");
        all.iter().map(|x| pool.rough(x).variance_px2).collect()
    }

    fn mean(all: impl ExactSizeIterator<Item = f64>) -> f64 {
        let count = all.len() as f64;
        all.sum::<f64>() / count
    }

    /// Of 400 clean contours chance made half rough, by a tenth of the noise on average; together they show that there is none.
    #[test]
    fn chance_is_no_roughness() {
        let mut random = Random(1);
        let all: Vec<Said> = (0..400).map(|_| shown(0.0, &mut random)).collect();
        let by_itself = mean(all.iter().map(|x| x.excess_px2.max(0.0) / NOISE));
        let found = pooled(&all);
        let left = mean(found.iter().map(|r| r / NOISE));
        let most = found.iter().fold(0.0_f64, |m, r| m.max(r / NOISE));
        assert!(by_itself > 0.07 && left < 0.01 && most < 0.15, "{by_itself} by themselves, {left}, at most {most}");
    }

    /// Contours that are as rough as each other, by less than chance makes one show.
    #[test]
    fn what_all_show_is_told_of_each() {
        let mut random = Random(2);
        let all: Vec<Said> = (0..400).map(|_| shown(0.2, &mut random)).collect();
        for r in pooled(&all).into_iter().map(|r| r / NOISE) {
            assert!((0.12..0.28).contains(&r), "{r} of the noise, 0.2 wanted");
        }
    }

    /// Some contours are rougher than others: each has its own roughness, better known than by itself.
    #[test]
    fn contours_that_differ_keep_their_own() {
        let mut random = Random(3);
        let rough: Vec<f64> = (0..300).map(|k| 0.02 * f64::from(k % 50)).collect();
        let all: Vec<Said> = rough.iter().map(|rough| shown(*rough, &mut random)).collect();
        let found = pooled(&all);
        let off2 = |x: &[f64]| mean(x.iter().zip(&rough).map(|(x, wanted)| (x / NOISE - wanted).powi(2)));
        let own: Vec<f64> = all.iter().map(|x| x.excess_px2.max(0.0)).collect();
        let [by_all, by_itself] = [off2(&found), off2(&own)].map(f64::sqrt);
        assert!(by_all < 0.8 * by_itself, "off by {by_all} of the noise, by itself by {by_itself}");
        let total = mean(found.iter().map(|r| r / NOISE));
        assert!((total - 0.49).abs() < 0.05, "{total} of the noise on average, 0.49 wanted");
    }

    /// A few torn contours are their own business.
    #[test]
    fn what_lies_far_off_says_nothing_of_the_others() {
        let mut random = Random(4);
        let all: Vec<Said> = (0..100).map(|k| shown(if k % 25 == 7 { 20.0 } else { 0.0 }, &mut random)).collect();
        for (k, (r, said)) in pooled(&all).into_iter().zip(&all).enumerate() {
            match k % 25 {
                7 => assert!(r > 0.95 * said.excess_px2 && r > 8.0 * NOISE, "{r}"),
                _ => assert!(r < 0.2 * NOISE, "{} of the noise", r / NOISE),
            }
        }
    }

    /// One contour, or two: what it shows by chance is mostly none, what it shows for sure is believed.
    #[test]
    fn a_single_contour_is_rough_for_sure_or_hardly() {
        let mut random = Random(5);
        let all: Vec<Said> = (0..2000).map(|_| shown(0.0, &mut random)).collect();
        let alone = mean(all.iter().map(|x| pooled(&[*x])[0] / NOISE));
        let of_two = mean(all.chunks(2).map(|x| mean(pooled(x).into_iter()) / NOISE));
        assert!(alone < 0.045 && of_two < 0.045, "{alone} and {of_two} of the noise");
        let sure = told(3.0 * NOISE);
        for r in [pooled(&[sure])[0], sure.alone().variance_px2] {
            assert!(r > 0.98 * sure.excess_px2 && r < sure.excess_px2, "{r}");
        }
    }
}
