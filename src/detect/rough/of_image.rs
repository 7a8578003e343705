//! How rough the contours of one image are, told by all of them together.
//!
//! A contour by itself tells its roughness badly: of 38 degrees of freedom chance makes chi-square larger or smaller by a quarter. Were whatever it shows
//! beyond the noise taken for roughness, half of all clean contours would be rough, and sigmas of clean dots 3 % too large on average and uneven by 13 %.
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
//! Where all contours together show no more than noise, those alone are asked that show more by themselves. Then, and of a single disc, r is
//! `max(0, e - s^2 / e)`.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | e, h, n | [`Said`] | px^2, px^2, 1 | what a contour says |
//! | r | `rough_px2` | px^2 | variance that is added to those of its edge points |
//!
//! Source: DerSimonian and Laird, Controlled Clinical Trials 7 (1986), for m and t; James and Stein's estimator with its positive part (Efron and Morris,
//! J. Amer. Statist. Assoc. 68 (1973)) for what chance leaves of r.

use super::{roughen, said};
use crate::conic::Feet;
use crate::detect::refine::is_known;
use crate::detect::{DetectOptions, Disc, RejectionReason};
use crate::threads::{self, OwnMemory};

/// Roughness of all contours that is let pass, of the variance by noise: 1.5 % of a sigma. And that of one that is not worth a fit.
const EVEN: f64 = 0.03;
const NOTHING: f64 = 0.02;
/// Standard deviations by which a contour alone shows more than noise, and by which it lies off those of the others.
const SURELY: f64 = 4.0;
const FAR: f64 = 4.0;
/// Rounds in which chance is judged by the mean of the round before.
const ROUNDS: usize = 3;
/// Standard deviation of a place or an axis beyond which a rough contour is none, in semi-minor axes.
const MOST_ROUGH: f64 = 0.25;

/// What one contour says of its roughness.
#[derive(Debug, Clone, Copy)]
pub(super) struct Said {
    /// Variance that takes chi-square to the degrees of freedom, px^2; negative where noise alone takes it below.
    pub(super) excess_px2: f64,
    /// Variance of an edge point by noise, harmonic mean, px^2.
    pub(super) noise_px2: f64,
    pub(super) freedom: f64,
}

impl Said {
    /// Variance of the excess by chance, of contours of some roughness, px^4.
    fn variance(&self, rough_px2: f64) -> f64 {
        2.0 / self.freedom * (self.noise_px2 + rough_px2.max(0.0)).powi(2)
    }

    /// The roughness of a contour that stands alone, px^2.
    fn alone(&self) -> f64 {
        shrunk(self.excess_px2, self.variance(0.0))
    }
}

/// A number that is not negative, from one with this variance.
fn shrunk(x: f64, variance: f64) -> f64 {
    if x > 0.0 { (x - variance / x).max(0.0) } else { 0.0 }
}

type Refined = Result<Disc, RejectionReason>;

/// Makes the discs of an image as rough as their contours say; turns down those that are no longer known well enough.
pub(crate) fn roughen_all(refined: &mut [Refined], options: &DetectOptions) {
    let found = refined.iter().enumerate().filter_map(|(i, disc)| Some((i, disc.as_ref().ok()?)));
    let shown: Vec<(usize, f64, f64)> = found.map(|(i, disc)| (i, disc.contour.chi2(), freedom(disc))).collect();
    let (chi2, all) = shown.iter().fold((0.0, 0.0), |sum, x| (sum.0 + x.1, sum.1 + x.2));
    let beyond = |(chi2, freedom): (f64, f64), least: f64| chi2 > freedom * (1.0 + least);
    let together = beyond((chi2, all), EVEN.max((2.0 / all).sqrt()));
    let asked = shown.iter().filter(|x| together || beyond((x.1, x.2), SURELY * (2.0 / x.2).sqrt())).map(|x| x.0);
    let asked: Vec<(usize, &Disc)> = asked.filter_map(|i| Some((i, refined[i].as_ref().ok()?))).collect();
    let memory = OwnMemory::<Feet>::new();
    let told = threads::side_by_side(&asked, |(_, disc)| memory.with(|feet| said(disc, feet)));
    let rough = if together { pooled(&told) } else { told.iter().map(Said::alone).collect() };
    let worth = asked.iter().zip(rough).zip(&told).filter(|((_, rough), said)| *rough > NOTHING * said.noise_px2);
    let worth: Vec<(usize, &Disc, f64)> = worth.map(|(((i, disc), rough), _)| (*i, *disc, rough)).collect();
    let again = |(_, disc, rough): &(usize, &Disc, f64)| memory.with(|feet| roughened(disc, *rough, options, feet));
    let new = threads::side_by_side(&worth, again);
    let places: Vec<usize> = worth.iter().map(|x| x.0).collect();
    places.into_iter().zip(new).for_each(|(i, disc)| refined[i] = disc);
}

/// Degrees of freedom of a contour.
fn freedom(disc: &Disc) -> f64 {
    (disc.edge.sigma_px.len() as f64 - 5.0).max(1.0)
}

/// How rough each of some contours is, px^2.
fn pooled(all: &[Said]) -> Vec<f64> {
    let mut sorted: Vec<f64> = all.iter().map(|x| x.excess_px2).collect();
    let middle = median(&mut sorted);
    sorted.iter_mut().for_each(|x| *x = (*x - middle).abs());
    let spread = 1.4826 * median(&mut sorted);
    let ordinary = |x: &Said| (x.excess_px2 - middle).abs() <= FAR * spread.max(x.variance(middle).sqrt());
    let of: Vec<&Said> = all.iter().filter(|x| ordinary(x)).collect();
    let (mut mean, mut apart2) = (middle, 0.0);
    for _ in 0..ROUNDS {
        let (plain, squares) = weighed(&of, |x| x.variance(mean));
        let about = of.iter().map(|x| (x.excess_px2 - plain).powi(2) / x.variance(mean)).sum::<f64>();
        let sum = of.iter().map(|x| 1.0 / x.variance(mean)).sum::<f64>();
        let by_one = sum - squares / sum;
        apart2 = if of.len() > 1 { ((about - of.len() as f64 + 1.0) / by_one).max(0.0) } else { 0.0 };
        mean = weighed(&of, |x| x.variance(mean) + apart2).0;
    }
    let chance = 1.0 / of.iter().map(|x| 1.0 / (x.variance(0.0) + apart2)).sum::<f64>();
    let common = shrunk(mean, chance);
    let each = |x: &Said| match ordinary(x) {
        true => (common + (x.excess_px2 - common) * apart2 / (apart2 + x.variance(common))).max(0.0),
        false => x.alone(),
    };
    all.iter().map(each).collect()
}

/// Mean of the excesses weighed by one over a variance each, and the sum of the squares of the weights.
fn weighed(of: &[&Said], variance: impl Fn(&Said) -> f64) -> (f64, f64) {
    let (mut sum, mut weights, mut squares) = (0.0, 0.0, 0.0);
    for x in of {
        let w = 1.0 / variance(x);
        (sum, weights, squares) = (sum + w * x.excess_px2, weights + w, squares + w * w);
    }
    (sum / weights, squares)
}

/// Of at least one number.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// A disc with a variance more for each of its edge points, px^2.
fn roughened(disc: &Disc, rough_px2: f64, options: &DetectOptions, feet: &mut Feet) -> Refined {
    let e = &disc.ellipse;
    let shape_px = options.max_edge_rms_px + options.max_edge_rms_ratio * e.semi_minor_px;
    let unknown = RejectionReason::NotElliptical { rms_px: f64::INFINITY, limit_px: shape_px };
    let mut edge = disc.edge.clone();
    feet.find(e, &edge.u_px, &edge.v_px);
    let (ellipse, added) = roughen(e, &mut edge, rough_px2, feet).ok_or(unknown)?;
    let covariance = disc.covariance + added;
    if !is_known(&covariance, shape_px.max(MOST_ROUGH * e.semi_minor_px)) {
        return Err(unknown);
    }
    Ok(Disc { ellipse, covariance, edge, ..disc.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    /// Noise that is alike everywhere, and as many degrees of freedom.
    const NOISE: f64 = 4e-4;
    const FREEDOM: usize = 38;

    /// What a contour says whose points scatter by noise and roughness, both in units of the noise.
    fn shown(rough: f64, random: &mut Random) -> Said {
        let chi2: f64 = (0..FREEDOM).map(|_| (1.0 + rough) * random.gauss().powi(2)).sum();
        let freedom = FREEDOM as f64;
        Said { excess_px2: (chi2 / freedom - 1.0) * NOISE, noise_px2: NOISE, freedom }
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
        let sure = Said { excess_px2: 3.0 * NOISE, noise_px2: NOISE, freedom: FREEDOM as f64 };
        for r in [pooled(&[sure])[0], sure.alone()] {
            assert!(r > 0.98 * sure.excess_px2 && r < sure.excess_px2, "{r}");
        }
    }
}
