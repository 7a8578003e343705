//! Specks far smaller than the discs of an image are no discs of the target.
//!
//! Letters, screws and drops beside a target are candidates, too, and what is in them is no even light, which takes long to find out: a hundred times
//! what the contour takes. So it is not asked of what is dust:
//! ```text
//! w = contrast * perimeter,    T_q = radius below which the part q of all w lies        of one polarity
//! put off: r <= SURELY DUST T_3/4          of all candidates; fitted without asking for smoke
//! dust:    r <= SURELY DUST T_1/2          of the discs that all these fits give
//! ```
//! What is put off and no dust is fitted as all others. The same rule without `SURELY` is that of all discs afterwards ([`super::of_target`]).
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | r | `radius` | px | image | mean radius of a candidate's ellipse, before it is fitted |
//! | w | `weight` | grey px | image | how much of a contour there is |
//! | T | `typical_px` | px | image | radius in whose size class the contours lie |

use super::refine::Start;
use super::{Disc, RejectionReason};
use crate::frames::Pixel;
use crate::threads;

/// A disc with less than this part of the typical radius is dust.
const DUST: f64 = 0.25;
/// Before it is fitted its radius is known to so much.
const SURELY: f64 = 0.9;
/// Part of all contours that is smaller than what is fitted first.
const LARGE: f64 = 0.75;
/// What is nearer to a disc than this, px, and than as many widths of its blur, may shine into it.
const NEAR_PX: f64 = 4.0;
const NEAR_BLURS: f64 = 4.0;

/// Radius in whose size class half of the contours lie, px, of (radius in px, contrast times perimeter).
pub(super) fn typical_radius_px(sizes: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    radius_px(sizes, 0.5)
}

/// Radius below which a part of the contours lies, px.
fn radius_px(sizes: impl Iterator<Item = (f64, f64)>, part: f64) -> Option<f64> {
    let mut sizes: Vec<(f64, f64)> = sizes.collect();
    sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let below = part * sizes.iter().map(|s| s.1).sum::<f64>();
    let mut sum = 0.0;
    sizes.into_iter().find_map(|(radius, weight)| {
        sum += weight;
        (sum >= below).then_some(radius)
    })
}

/// Whether none of some radii can be that of dust: none is typical but one of them, and the least is no dust among the largest.
pub(super) fn is_free_of_dust(radii_px: impl Iterator<Item = f64>) -> bool {
    let [least, most] = radii_px.fold([f64::INFINITY, 0.0], |[least, most], r| [r.min(least), r.max(most)]);
    !is_dust(least, most)
}

/// Radius and weight of a disc.
pub(super) fn size(disc: &Disc) -> (f64, f64) {
    (disc.ellipse.mean_radius_px(), disc.contrast * disc.ellipse.perimeter_px())
}

/// Whether a radius is that of dust among discs of a typical radius.
pub(super) fn is_dust(radius_px: f64, typical_px: f64) -> bool {
    radius_px <= DUST * typical_px
}

/// All starts refined, in their order, and which of them are dust.
pub(super) fn refined_but_dust(
    starts: &[Start],
    refine: impl Fn(&Start) -> Result<Disc, RejectionReason> + Sync + Send,
) -> (Vec<Result<Disc, RejectionReason>>, Vec<bool>) {
    let late = put_off(starts);
    if late.is_empty() {
        return (threads::side_by_side(starts, refine), vec![false; starts.len()]);
    }
    let mut out: Vec<Option<Result<Disc, RejectionReason>>> = vec![None; starts.len()];
    let fit = |of: &[usize], smoke: bool, out: &mut Vec<Option<_>>| {
        let start = |i: &usize| {
            let s = starts[*i];
            refine(&Start { smoke: s.smoke && smoke, full_of_smoke: s.full_of_smoke && smoke, ..s })
        };
        let found = threads::side_by_side(of, start);
        of.iter().zip(found).for_each(|(i, disc)| out[*i] = Some(disc));
    };
    let mut waits = vec![false; starts.len()];
    late.iter().for_each(|i| waits[*i] = true);
    let now: Vec<usize> = (0..starts.len()).filter(|i| !waits[*i]).collect();
    fit(&now, true, &mut out);
    fit(&late, false, &mut out);
    let surely = [false, true].map(|bright| {
        let own = (0..starts.len()).filter(|i| starts[*i].bright == bright);
        let discs = own.filter_map(|i| out[i].as_ref()?.as_ref().ok().map(size));
        SURELY * typical_radius_px(discs).unwrap_or(0.0)
    });
    let (dust, mut rest): (Vec<usize>, Vec<usize>) = late
        .into_iter()
        .partition(|i| is_dust(starts[*i].ellipse.mean_radius_px(), surely[usize::from(starts[*i].bright)]));
    // Where nobody asks for smoke they have been fitted as all others.
    rest.retain(|i| starts[*i].smoke);
    fit(&rest, true, &mut out);
    let mut is = vec![false; starts.len()];
    for i in dust {
        is[i] = true;
        if let Some(Ok(disc)) = &out[i] {
            out[i] = Some(Err(RejectionReason::TooSmall { semi_minor_px: disc.ellipse.semi_minor_px }));
        }
    }
    (out.into_iter().flatten().collect(), is)
}

/// What may be dust, and shines into no larger one.
fn put_off(starts: &[Start]) -> Vec<usize> {
    let mut out = vec![];
    let radius = |i: usize| starts[i].ellipse.mean_radius_px();
    let weight = |i: usize| starts[i].contrast * starts[i].ellipse.perimeter_px();
    for bright in [false, true] {
        let own: Vec<usize> = (0..starts.len()).filter(|i| starts[*i].bright == bright).collect();
        if is_free_of_dust(own.iter().map(|i| radius(*i))) {
            continue;
        }
        let typical_px = radius_px(own.iter().map(|i| (radius(*i), weight(*i))), LARGE).unwrap_or(0.0);
        let (small, large): (Vec<usize>, Vec<usize>) =
            own.iter().partition(|i| is_dust(radius(**i), SURELY * typical_px));
        out.extend(small.into_iter().filter(|i| !large.iter().any(|k| may_shine_into(&starts[*i], &starts[*k]))));
    }
    out
}

/// Whether light of a speck may reach the edge of a disc.
fn may_shine_into(speck: &Start, disc: &Start) -> bool {
    let far = |a: Pixel, b: Pixel| (a.u_px - b.u_px).hypot(a.v_px - b.v_px);
    let reach = speck.ellipse.semi_major_px + disc.ellipse.semi_major_px + NEAR_PX + NEAR_BLURS * disc.blur_px;
    far(speck.ellipse.center_px, disc.ellipse.center_px) < reach
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conic::Ellipse;
    use crate::detect::pattern::tests::disc;
    use std::sync::Mutex;

    fn start(at: [f64; 2], radius_px: f64) -> Start<'static> {
        let center_px = Pixel::new(at[0], at[1]);
        Start {
            clear: true,
            smoke: true,
            full_of_smoke: true,
            ..Start::alone(Ellipse { center_px, semi_major_px: radius_px, semi_minor_px: radius_px, angle_rad: 0.0 })
        }
    }

    /// Which starts were fitted in full, and what came of all, where `stands` says which are discs.
    fn fitted(starts: &[Start], stands: impl Fn(f64) -> bool + Sync + Send) -> (Vec<f64>, Vec<Result<f64, String>>) {
        let asked = Mutex::new(vec![]);
        let (found, dust) = refined_but_dust(starts, |s| {
            let (radius, at) = (s.ellipse.semi_major_px, s.ellipse.center_px);
            if s.smoke {
                asked.lock().unwrap().push(radius);
            }
            let found = disc(at.u_px, at.v_px, radius, radius, 0.0);
            if stands(radius) { Ok(found) } else { Err(RejectionReason::Overlapping) }
        });
        let asked = asked.into_inner().unwrap();
        assert_eq!(asked.len() + dust.iter().filter(|d| **d).count(), starts.len());
        let words = found.into_iter().map(|f| f.map(|d| d.ellipse.semi_major_px).map_err(|e| e.to_string()));
        (asked, words.collect())
    }

    #[test]
    fn radii_that_are_much_alike_are_no_dust() {
        let free = |radii: &[f64]| is_free_of_dust(radii.iter().copied());
        assert!(free(&[]) && free(&[7.0]) && free(&[10.0, 39.0, 12.0]));
        assert!(!free(&[10.0, 40.0]) && !free(&[30.0, 7.0, 29.0]));
    }

    /// Dots in rows, far from the middle.
    fn dots(count: u32, radius_px: f64) -> Vec<Start<'static>> {
        (0..count).map(|k| start([f64::from(k % 10) * 60.0, f64::from(k / 10) * 60.0], radius_px)).collect()
    }

    #[test]
    fn letters_beside_two_discs_are_not_asked_for_smoke() {
        let mut starts = vec![start([1300.0, 300.0], 100.0), start([1600.0, 300.0], 80.0)];
        starts.extend(dots(12, 12.0));
        // One on the rim of a disc, whose light it may be in.
        starts.push(start([1300.0, 408.0], 10.0));
        let (mut asked, found) = fitted(&starts, |_| true);
        asked.sort_by(f64::total_cmp);
        assert_eq!(asked, [10.0, 80.0, 100.0]);
        assert_eq!(found[0..2], [Ok(100.0), Ok(80.0)]);
        assert!(found[2..14].iter().all(|f| f == &Err("too small: minor semi-axis 12.0 px".into())), "{found:?}");
        assert_eq!(found[14], Ok(10.0));
        // More contour than the discs have, most of it no disc.
        starts.extend(dots(30, 11.0));
        let (asked, found) = fitted(&starts, |radius| radius != 11.0);
        assert_eq!(asked.len(), 3, "{asked:?}");
        assert!(found[15..].iter().all(|f| f == &Err("touching another disc".into())), "{found:?}");
    }

    /// A shadow that is no disc does not make dust of the discs, nor does a large disc of a grid, nor a lamp of the other polarity.
    #[test]
    fn what_stands_decides_what_is_dust() {
        let starts = [start([500.0, 500.0], 300.0), start([2100.0, 100.0], 30.0), start([2900.0, 100.0], 25.0)];
        let (asked, found) = fitted(&starts, |radius| radius < 100.0);
        assert_eq!(asked, [300.0, 30.0, 25.0]);
        assert!(found[0].is_err() && found[1..] == [Ok(30.0), Ok(25.0)], "{found:?}");
        for (count, radius_px, large_px) in [(49, 10.0, 300.0), (25, 10.0, 200.0), (9, 10.0, 60.0)] {
            let mut all = dots(count, radius_px);
            all.push(start([4000.0, 4000.0], large_px));
            let (asked, found) = fitted(&all, |_| true);
            assert_eq!((asked.len(), found.iter().filter(|f| f.is_ok()).count()), (all.len(), all.len()));
        }
        for (count, lamp_px) in [(9, 400.0), (49, 2000.0)] {
            let mut all = dots(count, 10.0);
            all.push(Start { bright: true, contrast: 900.0, ..start([9000.0, 9000.0], lamp_px) });
            assert_eq!(fitted(&all, |_| true).0.len(), all.len());
        }
        assert!(fitted(&[], |_| true).1.is_empty());
    }
}
