//! Noise that grows with the light, as all small discs of an image tell it.
//!
//! Light carries shot noise: inside a bright disc the noise is louder than around it. A dot of 4 px behind a blur of 1 px has a handful of pixels
//! that its edge does not reach, too few to tell; with the noise of the ground inside as well, sigmas of such dots would be up to 1.9 times too
//! small where they are bright, 1.25 times too large where they are dark. But all of them together tell the ratio
//!
//! ```text
//! r = var_in / var_out = arg min  sum_d min(D_d(r, c), least of D_d + FURTHEST)
//! ```
//!
//! with D_d minus twice the logarithm of the restricted likelihood of disc d (Patterson and Thompson 1971: place, axes, blur and light integrated
//! out), the variance of a pixel in it
//!
//! ```text
//! var_out (1 + (r - 1) P + c (h / h_max)^2)
//! ```
//!
//! P its share of the disc, h its response to a shift of the edge: c takes what a rough edge leaves, which is not to pass for noise inside. What one disc
//! says counts up to a limit, so that one with dirt on it has no more say than any other.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | r | `ratios`, `ShotNoise::ratio` | 1 | variance inside over that outside |
//! | c | `ROUGH` | 1 | variance that a rough edge adds where it is steepest, over that outside |
//! | c_0 | `EXPECTED_ROUGH` | 1 | what c is expected to be where few tell |
//! | D_d | `Told::unlikely` | 1 | what one disc says of each r and c |
//!
//! Light of neighbours would pass for noise: discs that are close and told nothing are asked again without it ([`crate::detect::beside`]). In bright discs what light adds grows with their contrast.
//!
//! Few bright discs may be full of smoke, which passes for noise. They are asked besides what they say of fields of smoke that all of them have in common,
//! under the noise that they told or less, and are believed where each field is clearly less likely than noise alone. Dark discs, and those that are
//! known to be printed, have none: few of them (n below eight), or one, are believed, as far as what is lighter is what is louder. On so few pixels a rough edge
//! looks alike, so that it has an exponential prior of the mean c_0, and few may say as much as eight:
//!
//! ```text
//! r = arg min  2 c / c_0 + sum_d min(D_d(r, c), least of D_d + FURTHEST 8 / n)
//! ```

use crate::detect::refine::Start;
use std::f64::consts::SQRT_2;

/// Ratios that are tried: so many steps of `sqrt(2)`, of which the first so many are below one.
const STEPS: usize = 19;
const QUIETER: i32 = 8;
/// Roughness that is tried.
const ROUGH: [f64; 6] = [0.0, 0.25, 0.5, 1.0, 2.0, 4.0];
/// What edges are expected to add where few discs are asked: the mean of an exponential distribution.
const EXPECTED_ROUGH: f64 = 0.25;
/// How much more unlikely than its best one disc of many may call a ratio.
const FURTHEST: f64 = 9.0;
/// Discs that are asked, at most.
const ASKED: usize = 32;
/// From so many on discs are believed whatever they are.
pub(crate) const MANY: usize = 8;
/// At least, where they are printed, or dark.
const LEAST_PRINTED: usize = 1;
/// Loss in all of what the discs say by which one ratio must surpass no difference.
const SURE: f64 = 9.0;
/// Discs that are asked for smoke, at most.
const ASKED_FOR_SMOKE: usize = 12;
/// Blurs from the edge at which a pixel sees one side only, to a part in 200.
const CLEAR_OF_EDGE: f64 = 2.6;
/// Number of pixels that tell the noise inside for themselves.
const ENOUGH: f64 = 50.0;
/// Least ratio that is believed: a clipped side has no noise at all, yet it must not outweigh the flank of the edge.
const LEAST_RATIO: f64 = 1.0 / 16.0;

/// What one disc says.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Told {
    /// Of all that is asked, how unlikely it is.
    pub(crate) unlikely: Vec<f64>,
    /// Step of its light, grey, positive.
    pub(crate) step: f64,
}

/// The noise inside that discs of an image may expect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ShotNoise {
    ratio: f64,
    bright: bool,
    /// What the step of the light typically is, grey.
    step: f64,
}

/// All ratios and roughnesses that a disc is asked for, in the order of what they say.
pub(crate) fn asked() -> impl Iterator<Item = (f64, f64)> {
    (0..STEPS).flat_map(|k| ROUGH.iter().map(move |c| (ratio(k as f64), *c)))
}

fn ratio(step: f64) -> f64 {
    SQRT_2.powf(step - f64::from(QUIETER))
}

/// Whether a disc, of the light given, has too few pixels inside that its edge does not reach.
fn is_untold(start: &Start, bright: bool) -> bool {
    let e = &start.ellipse;
    let [a, b] = [e.semi_major_px, e.semi_minor_px].map(|axis| (axis - CLEAR_OF_EDGE * start.blur_px).max(0.0));
    start.bright == bright && std::f64::consts::PI * a * b < ENOUGH
}

impl ShotNoise {
    /// From what `ask` hears of some of the discs; none where they know it themselves, do not tell, or are few.
    pub(crate) fn of<'a>(starts: &[Start<'a>], ask: impl FnOnce(&[Start<'a>]) -> Vec<Option<Told>>) -> Option<Self> {
        let bright = 2 * starts.iter().filter(|s| s.bright).count() > starts.len();
        let mut told: Vec<Told> = ask(&some_of(starts, bright, ASKED)?).into_iter().flatten().collect();
        if told.len() < least(starts) {
            return None;
        }
        // Smoke may be as loud as any noise, but no quieter than its ground. Dirt on few discs is neither.
        let smoke = starts.iter().any(|s| s.smoke && !s.printed);
        let few = told.len() < MANY;
        let may_be = |ratio: f64| (bright || !smoke || ratio < 1.0) && (!few || (ratio > 1.0) == bright);
        let ratio = likeliest(&told).filter(|ratio| may_be(*ratio))?;
        let middle = told.len() / 2;
        let step = told.select_nth_unstable_by(middle, |a, b| a.step.total_cmp(&b.step)).1.step;
        Some(Self { ratio, bright, step })
    }

    /// Whether smoke has no part in it: bright discs that may be full of it say so, as `ask` hears of some of them.
    pub(crate) fn without_smoke<'a>(
        &self,
        starts: &[Start<'a>],
        ask: impl FnOnce(&[Start<'a>]) -> Vec<Option<Vec<f64>>>,
    ) -> bool {
        if !self.bright || !starts.iter().any(Start::may_be_full_of_smoke) {
            return true;
        }
        let Some(asked) = some_of(starts, self.bright, ASKED_FOR_SMOKE) else { return false };
        let told: Vec<Vec<f64>> = ask(&asked).into_iter().flatten().collect();
        told.len() >= MANY && no_smoke(&told)
    }

    /// Whether it is all that makes a disc louder than its ground, where smoke has no part in it.
    pub(crate) fn is_all_of(&self, start: &Start) -> bool {
        is_untold(start, self.bright)
    }

    /// The variance inside a disc whose ground has the variance `outside`, with a step of the light inside less outside.
    fn inside(&self, outside: f64, step: f64) -> f64 {
        let part = if self.bright { step.abs() / self.step } else { 1.0 };
        outside * (1.0 + (self.ratio - 1.0) * part).max(LEAST_RATIO)
    }

    /// The variances of both sides of a disc with the step given, inside less outside, from what its own pixels show and their number; none where
    /// they show nothing, or it is a disc of the other polarity.
    pub(crate) fn fill(&self, shown: [Option<(f64, f64)>; 2], step: f64) -> Option<[f64; 2]> {
        let outside = shown[1].filter(|_| (step > 0.0) == self.bright)?.0;
        let expected = self.inside(outside, step);
        let inside = shown[0].map_or(expected, |(own, pixels)| {
            let weight = (pixels / ENOUGH).min(1.0);
            weight * own + (1.0 - weight) * expected
        });
        Some([inside, outside])
    }
}

fn least(starts: &[Start]) -> usize {
    if starts.iter().all(|s| s.printed || !s.bright) { LEAST_PRINTED } else { MANY }
}

/// Some of the small discs that have the light of most, asked as if there were no smoke in bright ones; none where they are few.
fn some_of<'a>(starts: &[Start<'a>], bright: bool, most: usize) -> Option<Vec<Start<'a>>> {
    let untold = starts.iter().filter(|s| is_untold(s, bright));
    let mut small: Vec<Start> = untold.map(|s| Start { smoke: s.smoke && !bright, ..*s }).collect();
    if small.len() < MANY {
        // None of them is to be spared.
        small.iter_mut().for_each(|s| s.asked = s.printed);
    }
    let every = small.len().div_ceil(most);
    (small.len() >= least(starts)).then(|| small.into_iter().step_by(every).collect())
}

/// Whether all fields of smoke that discs are asked for are clearly less likely than none.
fn no_smoke(told: &[Vec<f64>]) -> bool {
    let mut fields = 0..told.first().map_or(0, Vec::len);
    fields.all(|k| told.iter().map(|disc| disc[k].clamp(-FURTHEST, FURTHEST)).sum::<f64>() > SURE)
}

/// The ratio that most discs call likely; none where they hardly prefer it to no difference, or the likeliest is the last that was tried.
fn likeliest(told: &[Told]) -> Option<f64> {
    let mut sums = vec![0.0; STEPS * ROUGH.len()];
    let least_of = |of: &[f64]| of.iter().copied().fold(f64::INFINITY, f64::min);
    // Few have the say of many, and do not tell noise that comes with light from a rough edge.
    let few = told.len() < MANY;
    let furthest = FURTHEST * f64::max(MANY as f64 / told.len() as f64, 1.0);
    if few {
        sums.iter_mut().zip(asked()).for_each(|(sum, (_, rough))| *sum += 2.0 * rough / EXPECTED_ROUGH);
    }
    for disc in told {
        let limit = least_of(&disc.unlikely) + furthest;
        sums.iter_mut().zip(&disc.unlikely).for_each(|(sum, x)| *sum += x.min(limit));
    }
    let of_ratio: Vec<f64> = sums.chunks(ROUGH.len()).map(least_of).collect();
    let least = (1..STEPS).fold(0, |best, k| if of_ratio[k] < of_ratio[best] { k } else { best });
    let rough = &sums[least * ROUGH.len()..(least + 1) * ROUGH.len()];
    // An edge that is rough beyond all that was tried is no edge that this model tells anything of.
    let explained = rough[ROUGH.len() - 1] > least_of(rough);
    let sure = of_ratio[QUIETER as usize] - of_ratio[least] > SURE;
    if least + 1 == STEPS || !explained || !sure {
        return None;
    }
    let vertex = if least == 0 { 0.0 } else { vertex(&of_ratio[least - 1..=least + 1]) };
    Some(ratio(least as f64 + vertex).max(LEAST_RATIO))
}

/// Where a parabola through three values at -1, 0 and 1 is least.
fn vertex(values: &[f64]) -> f64 {
    let (rise, bend) = (0.5 * (values[2] - values[0]), values[0] - 2.0 * values[1] + values[2]);
    if bend > 0.0 { (-rise / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a disc says that prefers the ratio at the step `at` and the roughness `rough`.
    fn preferring(at: f64, rough: f64) -> Told {
        let of =
            |(ratio, c): (f64, f64)| 4.0 * (2.0 * ratio.log2() - at + f64::from(QUIETER)).powi(2) + (c - rough).powi(2);
        Told { unlikely: asked().map(of).collect(), step: 80.0 }
    }

    #[test]
    fn one_disc_with_dirt_on_it_has_no_more_say_than_any_other() {
        let mut told = vec![preferring(12.3, 0.25); 9];
        assert!((likeliest(&told).expect("a ratio") / ratio(12.3) - 1.0).abs() < 0.01);
        told.push(preferring(17.0, 4.0));
        assert!((likeliest(&told).expect("a ratio") / ratio(12.3) - 1.0).abs() < 0.01);
    }

    #[test]
    fn nothing_is_told_where_nothing_is_sure() {
        let alike = vec![preferring(f64::from(QUIETER) + 0.1, 0.0); 9];
        assert_eq!(likeliest(&alike), None, "no difference");
        assert_eq!(likeliest(&vec![preferring(30.0, 0.0); 9]), None, "beyond all that was tried");
        assert_eq!(likeliest(&vec![preferring(12.0, 9.0); 9]), None, "an edge rougher than all that was tried");
        // A clipped side has no noise at all.
        assert_eq!(likeliest(&vec![preferring(-3.0, 0.0); 9]), Some(LEAST_RATIO));
    }

    /// One printed disc is believed where it is sure, unless its edge is rougher than all that was tried.
    #[test]
    fn few_are_believed_but_for_their_edges() {
        let sure = |rough: f64| {
            let of = |(ratio, c): (f64, f64)| 20.0 * (2.0 * ratio.log2() - 6.3).powi(2) + 40.0 * (c - rough).powi(2);
            likeliest(&[Told { unlikely: asked().map(of).collect(), step: 80.0 }])
        };
        assert!((sure(0.0).expect("a ratio") / 8.9 - 1.0).abs() < 0.1);
        assert_eq!(sure(9.0), None);
        assert_eq!(likeliest(&[preferring(9.0, 0.0)]), None, "hardly louder");
    }

    /// One disc that calls smoke unlikely is not enough, and one that is dirty does not change what eleven say.
    #[test]
    fn smoke_is_ruled_out_by_many() {
        let disc = |says: f64| vec![says, says + 3.0];
        assert!(no_smoke(&vec![disc(2.0); 12]));
        assert!(!no_smoke(&[disc(100.0), disc(0.1), disc(-0.3)]));
        let mut told = vec![disc(2.0); 12];
        told[3] = disc(-100.0);
        assert!(no_smoke(&told));
        told[4] = disc(-100.0);
        assert!(!no_smoke(&told), "two of twelve are not dirt");
    }

    /// What few pixels show counts by their number; the other polarity has light of its own.
    #[test]
    fn own_pixels_count_by_their_number() {
        let noise = ShotNoise { ratio: 9.0, bright: true, step: 100.0 };
        assert_eq!(noise.fill([None, Some((2.0, 80.0))], 50.0), Some([10.0, 2.0]));
        assert_eq!(noise.fill([Some((4.0, 25.0)), Some((2.0, 80.0))], 50.0), Some([7.0, 2.0]));
        assert_eq!(noise.fill([Some((4.0, 90.0)), Some((2.0, 80.0))], 50.0), Some([4.0, 2.0]));
        assert_eq!(noise.fill([None, Some((2.0, 80.0))], -50.0), None);
        assert_eq!(noise.fill([None, None], 50.0), None);
    }
}
