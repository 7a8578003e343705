//! Which waves along the contours of an image are rough: those that bend an ellipse are not those of which edge points mostly tell.
//!
//! Blur takes short waves off a rim and leaves long ones. Of a rim that scatters point by point and is smoothed by a Gaussian of standard deviation tau the
//! power of the m-th harmonic along a contour of radius R is `G_m = exp (-(m tau / R)^2)`; such are real prints (docs/accuracy.md). The five numbers of
//! an ellipse are bent by the harmonics up to the second, edge points tell of all beyond. The covariance of the ellipse grows by L times what it would if all
//! were alike,
//!
//! ```text
//! L = (1 + 2 G_1 + 2 G_2) / 5 / mean (G_6 to G_(n/2)),        mean (G_6 to G_11) / mean (G_6 to G_(n/2)) = Q,
//! Q = 1 + shrunk (sum w_i l_i / sum w_i e_i - 1),    l_i = (mean_m |D_m|^2 - sum_k 1 / sigma_k^2) / sum_k 1 / sigma_k^4,
//! D_m = sum_k d_k / sigma_k^2 exp (i m theta_k),     m from 6 to 11
//! ```
//!
//! with e_i what all waves of contour i beyond the fifth say ([`super::of_image`]), w_i its weight, d_k the distances of its n edge
//! points at the eccentric angles theta_k without harmonics up to the fifth, and `shrunk (x) = max (0, x - var (x) / x)`, by chance; of less than 44 points
//! m from 3 to 5, without those up to the second. tau is one of the image.
//!
//! The third to fifth harmonics a lens may bend as well: it can only add to what roughness makes of them, so that tau is at most what these say, and one
//! standard deviation of chance. Polygons, of which shorter waves stand out alone, bend no ellipse.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | tau | `smoothed_px` | px | standard deviation of the Gaussian that smoothed the rims |
//! | l | [`Band`] | px^2 | the variance that long waves alone would say |
//! | L | [`Rim::long`] | 1 | waves that bend an ellipse over all, as their powers |
//!
//! Source: the periodogram, each harmonic of which is exponential about the spectrum (Brillinger, "Time Series", 1981, section 5.2).

use super::{Bent, Said, add, shrunk};
use crate::conic::{Ellipse, Feet};
use crate::lanes::{self, GROUP, Kernel, Lanes};

/// Harmonics that a lens may bend, too.
const LENS: [usize; 2] = [3, 5];
/// Halvings of the range in which tau lies.
const HALVED: usize = 12;

/// What some waves along a contour say.
#[derive(Debug, Clone, Copy, Default)]
struct Band {
    /// First and last harmonic.
    of: [usize; 2],
    /// The variance of points, each for itself, that would leave as much of these beyond noise, px^2.
    px2: f64,
    freedom: f64,
}

/// What long waves along a contour say.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Waves {
    radius_px: f64,
    /// First harmonic that no lens bends, and the last that the points show.
    rough: [usize; 2],
    /// The long ones of these, and longer ones that a lens may bend; of few points the same, of fewer nothing.
    bands: Option<[Band; 2]>,
}

impl Waves {
    /// Those of edge points whose feet on `e` were found last.
    pub(super) fn of(e: &Ellipse, bent: &Bent, sigma_px: &[f64], feet: &Feet) -> Self {
        let first = bent.smooth + 1;
        let long = [first, 2 * bent.smooth + 1];
        let radius_px = (0.5 * (e.semi_major_px.powi(2) + e.semi_minor_px.powi(2))).sqrt();
        let bands = (sigma_px.len() >= 4 * long[1]).then(|| {
            let by_lens = if first > LENS[0] { LENS } else { long };
            [Band::of(&bent.distance, sigma_px, feet, long), Band::of(&feet.distance, sigma_px, feet, by_lens)]
        });
        Self { radius_px, rough: [first, first.max(sigma_px.len() / 2)], bands }
    }

    /// Mean power of the waves from the first to the last of these over that of all rough ones, of a rim that is smoothed so far; at most so far that a third
    /// of the first rough one is left.
    fn power(&self, of: [usize; 2], smoothed_px: f64) -> f64 {
        let [first, last] = self.rough;
        let falls = (-(smoothed_px / self.radius_px).min(1.0 / first as f64).powi(2)).exp();
        let (mut power, mut step) = (1.0, falls);
        let (mut sum, mut all) = (0.0, 0.0);
        for m in 0..=last.max(of[1]) {
            // A constant is one number, a wave two.
            let numbers = if m == 0 { 1.0 } else { 2.0 };
            sum += if (of[0]..=of[1]).contains(&m) { numbers * power } else { 0.0 };
            all += if (first..=last).contains(&m) { numbers * power } else { 0.0 };
            power *= step;
            step *= falls * falls;
        }
        let numbers = |[first, last]: [usize; 2]| 2.0 * (last + 1 - first) as f64 - if first == 0 { 1.0 } else { 0.0 };
        (sum / numbers(of)) / (all / numbers(self.rough))
    }
}

impl Band {
    /// What the waves from the first to the last of these say of distances, px.
    fn of(distance_px: &[f64], sigma_px: &[f64], feet: &Feet, of: [usize; 2]) -> Self {
        let weight = |sigma: &f64| 1.0 / (sigma * sigma);
        let mut numbers: Vec<f64> = distance_px.iter().zip(sigma_px).map(|(d, sigma)| d * weight(sigma)).collect();
        numbers.resize(numbers.len().next_multiple_of(GROUP), 0.0);
        let waves = lanes::run(Power { feet, numbers: &numbers, of });
        let power = waves.iter().map(|[c, s]| c * c + s * s).sum::<f64>() / waves.len() as f64;
        let (by_noise, by_roughness) =
            sigma_px.iter().map(weight).fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
        Self { of, px2: (power - by_noise) / by_roughness, freedom: 2.0 * waves.len() as f64 }
    }
}

/// How the rims of an image are rough.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rim {
    /// tau, px; zero where they are rough point by point.
    smoothed_px: f64,
}

impl Rim {
    /// That of contours with their weights; rough point by point where what they show of long waves may be chance.
    pub(super) fn of(all: &[(&Said, f64)]) -> Self {
        let of: Vec<Asked> = all.iter().filter_map(|(x, w)| Some((*x, *w, x.waves.bands?))).collect();
        let all_px2 = mean(&of, |x, _| x.excess_px2);
        // Mean power of a band over that of all, and its variance by chance.
        let told = |band: usize| {
            let px2 = mean(&of, |_, bands| bands[band].px2);
            let one = |(x, w, bands): &Asked| 2.0 / bands[band].freedom * (w * (x.noise_px2 + px2)).powi(2);
            let weights = of.iter().map(|x| x.1).sum::<f64>();
            [px2 / all_px2, of.iter().map(one).sum::<f64>() / (weights * all_px2).powi(2)]
        };
        let [[long, chance], [by_lens, chance_by_lens]] = [told(0), told(1)];
        let more = shrunk(long - 1.0, chance);
        if !(all_px2 > 0.0 && more > 0.0) {
            return Self::default();
        }
        let smoothed_px = smoothed(&of, 0, 1.0 + more);
        Self { smoothed_px: smoothed_px.min(smoothed(&of, 1, by_lens + chance_by_lens.sqrt())) }
    }

    /// L of a contour.
    pub(super) fn long(&self, waves: &Waves) -> f64 {
        waves.power([0, 2], self.smoothed_px).max(1.0)
    }
}

/// A contour with its weight and its bands.
type Asked<'a> = (&'a Said, f64, [Band; 2]);

/// Mean of a number of each.
fn mean(of: &[Asked], number: impl Fn(&Said, &[Band; 2]) -> f64) -> f64 {
    let (sum, weights) =
        of.iter().fold((0.0, 0.0), |(sum, weights), (x, w, bands)| (sum + w * number(x, bands), weights + w));
    sum / weights
}

/// How far rims are smoothed whose waves of a band have so much power over that of all, px.
fn smoothed(of: &[Asked], band: usize, wanted: f64) -> f64 {
    let furthest = |(x, ..): &Asked| x.waves.radius_px / x.waves.rough[0] as f64;
    let (mut least, mut most) = (0.0, of.iter().map(furthest).fold(0.0, f64::max));
    for _ in 0..HALVED {
        let middle = 0.5 * (least + most);
        let far = mean(of, |x, bands| x.waves.power(bands[band].of, middle)) > wanted;
        *(if far { &mut most } else { &mut least }) = middle;
    }
    least
}

/// Sums over the points of numbers times the cosines and sines of the waves from the first to the last of these.
#[derive(Clone)]
struct Power<'a> {
    feet: &'a Feet,
    /// One per point, continued by zeros to whole groups.
    numbers: &'a [f64],
    of: [usize; 2],
}

impl Kernel for Power<'_> {
    type Output = Vec<[f64; 2]>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let [first, last] = self.of;
        let mut sums = vec![[[0.0; GROUP]; 2]; last + 1 - first];
        for at in (0..self.numbers.len()).step_by(L::N) {
            let part = at % GROUP;
            let [c, s] = self.feet.directions()[at / GROUP];
            let (c, s, number) = (L::load(&c[part..]), L::load(&s[part..]), L::load(&self.numbers[at..]));
            let (mut cm, mut sm) = (L::splat(1.0), L::splat(0.0));
            for m in 1..=last {
                (cm, sm) = (cm * c - sm * s, sm * c + cm * s);
                if m >= first {
                    let [cosine, sine] = &mut sums[m - first];
                    add(&mut cosine[part..], number, cm);
                    add(&mut sine[part..], number, sm);
                }
            }
        }
        let mut out = vec![];
        for [cosine, sine] in &sums {
            out.push([lanes::sum(cosine), lanes::sum(sine)]);
        }
        out
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::detect::rough::said_by;
    use crate::frames::Pixel;
    use crate::stats::random::Random;
    use std::f64::consts::TAU;

    const NOISE: f64 = 4e-4;

    /// L of contours of so many points with unequal noise and roughness of the same variance, which is a moving sum of white noise with these weights, and
    /// all of the same shape, px off at each angle; and L by its definition, the power of the moving sum at the waves that bend an ellipse over that at those beyond.
    fn long_waves(points: usize, weights: &[f64], bent: fn(f64) -> f64, random: &mut Random) -> [f64; 2] {
        let e = Ellipse { center_px: Pixel::new(5.0, 4.0), semi_major_px: 13.0, semi_minor_px: 12.99, angle_rad: 0.3 };
        let angle = |k: usize| TAU * k as f64 / points as f64;
        let (u, v): (Vec<f64>, Vec<f64>) = (0..points).map(|k| e.point(angle(k))).map(|p| (p.u_px, p.v_px)).unzip();
        let sigma: Vec<f64> = (0..points).map(|k| (NOISE * (0.7 + 0.3 * (k % 3) as f64)).sqrt()).collect();
        let mut feet = Feet::default();
        feet.find(&e, &u, &v);
        let mut one = || {
            let white: Vec<f64> = (0..points).map(|_| NOISE.sqrt() * random.gauss()).collect();
            let rough = |k: usize| weights.iter().enumerate().map(|(j, w)| w * white[(k + j) % points]).sum::<f64>();
            feet.distance = (0..points).map(|k| rough(k) + bent(angle(k)) + sigma[k] * random.gauss()).collect();
            // As the fit of an ellipse does.
            for m in 0..3 {
                for wave in [f64::cos, f64::sin] {
                    let wave: Vec<f64> = (0..points).map(|k| wave(angle(m * k))).collect();
                    let dot = |a: &[f64]| a.iter().zip(&wave).map(|(a, b)| a * b).sum::<f64>();
                    let share = dot(&feet.distance) / dot(&wave).max(1e-9);
                    feet.distance.iter_mut().zip(&wave).for_each(|(d, w)| *d -= share * w);
                }
            }
            said_by(&e, &sigma, &feet)
        };
        let all: Vec<Said> = (0..400).map(|_| one()).collect();
        let power = |m: usize| {
            let wave = |f: fn(f64) -> f64| weights.iter().enumerate().map(|(j, w)| w * f(angle(m * j))).sum::<f64>();
            wave(f64::cos).powi(2) + wave(f64::sin).powi(2)
        };
        let bends = (power(0) + 2.0 * power(1) + 2.0 * power(2)) / 5.0;
        let [first, _] = all[0].waves.rough;
        let beyond = (first..points - first + 1).map(power).sum::<f64>() / (points + 1 - 2 * first) as f64;
        let rim = Rim::of(&all.iter().map(|x| (x, 1.0)).collect::<Vec<_>>());
        [rim.long(&all[0].waves), bends / beyond]
    }

    /// Against the sums by their definition, with equal bits in all widths.
    #[test]
    fn powers_are_those_of_the_plain_sums() {
        let e = Ellipse { center_px: Pixel::new(5.0, 4.0), semi_major_px: 17.0, semi_minor_px: 9.0, angle_rad: 0.3 };
        let (u, v): (Vec<f64>, Vec<f64>) =
            (0..53).map(|k| e.point(0.118 * f64::from(k))).map(|p| (p.u_px, p.v_px)).unzip();
        let mut feet = Feet::default();
        feet.find(&e, &u, &v);
        let mut numbers: Vec<f64> = (0..53).map(|k| f64::from((k * 29) % 13 - 6)).collect();
        let wave = |m: usize, f: fn(f64) -> f64| (0..53).map(|k| numbers[k] * f(0.118 * (m * k) as f64)).sum::<f64>();
        let wanted: Vec<[f64; 2]> = (3..=7).map(|m| [wave(m, f64::cos), wave(m, f64::sin)]).collect();
        numbers.resize(53_usize.next_multiple_of(GROUP), 0.0);
        let found = lanes::run_all(&Power { feet: &feet, numbers: &numbers, of: [3, 7] });
        assert!(found.iter().all(|of| *of == found[0]));
        for (a, b) in found[0].iter().flatten().zip(wanted.iter().flatten()) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }

    /// Roughness of which the blur left long waves only, of which it left all, and of which it took the long ones: that makes no ellipse better known.
    #[test]
    fn long_waves_are_told_from_short_ones() {
        let mut random = Random(6);
        for points in [60, 32] {
            let mut of = |weights: &[f64]| long_waves(points, weights, |_| 0.0, &mut random);
            let [found, wanted] = of(&[0.4, 0.8, 0.4]);
            assert!(wanted > 2.5 && (found / wanted - 1.0).abs() < 0.15, "{points}: {found}, {wanted} wanted");
            let [found, wanted] = of(&[1.0]);
            assert!((wanted - 1.0).abs() < 1e-9 && found < 1.15, "{points}: {found}");
            let [found, wanted] = of(&[0.7, -0.7]);
            assert!(wanted < 0.6 && found == 1.0, "{points}: {found}");
        }
    }

    /// A lens bends contours by a wave that says nothing of roughness; polygons have long waves, but none as long as that.
    #[test]
    fn bends_of_a_lens_say_no_more_and_polygons_no_less() {
        let mut random = Random(7);
        let [found, wanted] = long_waves(60, &[0.4, 0.8, 0.4], |angle| 0.08 * (3.0 * angle).cos(), &mut random);
        assert!((found / wanted - 1.0).abs() < 0.15, "{found}, {wanted} wanted");
        let [found, _] = long_waves(60, &[0.1], |angle| 0.08 * (8.0 * angle).cos(), &mut random);
        assert!(found < 1.1, "{found}");
    }
}
