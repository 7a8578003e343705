//! Specks far smaller than the discs of an image are no discs of the target.
//!
//! Letters, screws and drops beside a target are candidates, too, and what is in them is no even light, which takes long to find out. So large ones
//! are fitted first; what must be dust beside those that stood it is not fitted at all:
//! ```text
//! w = contrast * perimeter,    T_q = radius below which the part q of all w lies
//! put off: radius <= DUST T_3/4          of all candidates
//! dust:    radius <= DUST T_1/2          of the discs that were fitted, and of all that were put off, every second of which may be a disc: w / 2
//! ```
//! Where the large ones are none, those that were put off decide among themselves, and all are fitted.

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

/// Radius and weight of a disc.
pub(super) fn size(disc: &Disc) -> (f64, f64) {
    (disc.ellipse.mean_radius_px(), disc.contrast * disc.ellipse.perimeter_px())
}

/// Whether a radius is that of dust among discs of a typical radius.
pub(super) fn is_dust(radius_px: f64, typical_px: f64) -> bool {
    radius_px <= DUST * typical_px
}

/// All starts refined, in their order; dust is turned down without.
pub(super) fn refined_but_dust(
    starts: &[Start],
    refine: impl Fn(&Start) -> Result<Disc, RejectionReason> + Sync + Send,
) -> Vec<Result<Disc, RejectionReason>> {
    let sizes: Vec<(f64, f64)> =
        starts.iter().map(|s| (s.ellipse.mean_radius_px(), s.contrast * s.ellipse.perimeter_px())).collect();
    let surely = |i: usize, typical_px: f64| is_dust(sizes[i].0, SURELY * typical_px);
    let typical_px = radius_px(sizes.iter().copied(), LARGE).unwrap_or(0.0);
    let (small, large): (Vec<usize>, Vec<usize>) = (0..starts.len()).partition(|i| surely(*i, typical_px));
    let (late, mut now): (Vec<usize>, Vec<usize>) =
        small.into_iter().partition(|i| !large.iter().any(|k| may_shine_into(&starts[*i], &starts[*k])));
    now.extend(large);
    let mut out: Vec<Option<Result<Disc, RejectionReason>>> = vec![None; starts.len()];
    let fit = |of: &[usize], out: &mut Vec<Option<_>>| {
        let found = threads::side_by_side(of, |i| refine(&starts[*i]));
        of.iter().zip(found).for_each(|(i, disc)| out[*i] = Some(disc));
    };
    fit(&now, &mut out);
    let told = out.iter().flatten().flatten().map(size).chain(late.iter().map(|i| (sizes[*i].0, 0.5 * sizes[*i].1)));
    let typical_px = typical_radius_px(told).unwrap_or(0.0);
    let (dust, rest): (Vec<usize>, Vec<usize>) = late.into_iter().partition(|i| surely(*i, typical_px));
    fit(&rest, &mut out);
    for i in dust {
        out[i] = Some(Err(RejectionReason::TooSmall { semi_minor_px: starts[i].ellipse.semi_minor_px }));
    }
    out.into_iter().flatten().collect()
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
    use crate::detect::correlation::NoiseCorrelation;
    use crate::detect::pattern::tests::disc;
    use std::sync::Mutex;

    fn start(at: [f64; 2], radius_px: f64) -> Start<'static> {
        let center_px = Pixel::new(at[0], at[1]);
        Start {
            ellipse: Ellipse { center_px, semi_major_px: radius_px, semi_minor_px: radius_px, angle_rad: 0.0 },
            blur_px: 1.0,
            bright: false,
            contrast: 100.0,
            inner_px: radius_px,
            neighbours: &[],
            slopes: [[0.0; 2]; 2],
            noise: &NoiseCorrelation::NONE,
            level: 0,
            variance: 1.0,
            quantisation: 0.0,
            clear: true,
            shot_noise: None,
            smoke: false,
            full_of_smoke: false,
        }
    }

    /// Which starts were fitted, and what came of all, where `stands` says which are discs.
    fn fitted(starts: &[Start], stands: impl Fn(f64) -> bool + Sync + Send) -> (Vec<f64>, Vec<Result<f64, String>>) {
        let asked = Mutex::new(vec![]);
        let found = refined_but_dust(starts, |s| {
            let (radius, at) = (s.ellipse.semi_major_px, s.ellipse.center_px);
            asked.lock().unwrap().push(radius);
            let found = disc(at.u_px, at.v_px, radius, radius, 0.0);
            if stands(radius) { Ok(found) } else { Err(RejectionReason::Overlapping) }
        });
        let words = found.into_iter().map(|f| f.map(|d| d.ellipse.semi_major_px).map_err(|e| e.to_string()));
        (asked.into_inner().unwrap(), words.collect())
    }

    #[test]
    fn letters_beside_two_discs_are_not_fitted() {
        let mut starts = vec![start([300.0, 300.0], 100.0), start([600.0, 300.0], 80.0)];
        // As much contour as the discs have.
        starts.extend((0..16).map(|k| start([100.0 + 60.0 * f64::from(k), 600.0], 12.0)));
        // One on the rim of a disc, whose light it may be in.
        starts.push(start([300.0, 408.0], 10.0));
        let (asked, found) = fitted(&starts, |_| true);
        let mut sizes = asked.clone();
        sizes.sort_by(f64::total_cmp);
        assert_eq!(sizes, [10.0, 80.0, 100.0]);
        assert_eq!(found[0..2], [Ok(100.0), Ok(80.0)]);
        assert!(found[2..18].iter().all(|f| f == &Err("too small: minor semi-axis 12.0 px".into())), "{found:?}");
        assert_eq!(found[18], Ok(10.0));
    }

    /// A shadow that is no disc does not make dust of the discs.
    #[test]
    fn what_stands_decides_what_is_dust() {
        let starts = [start([500.0, 500.0], 300.0), start([100.0, 100.0], 30.0), start([900.0, 100.0], 25.0)];
        let (asked, found) = fitted(&starts, |radius| radius < 100.0);
        assert_eq!(asked, [300.0, 30.0, 25.0]);
        assert!(found[0].is_err() && found[1..] == [Ok(30.0), Ok(25.0)], "{found:?}");
        // Nor does a large one that is a disc among a hundred dots.
        let mut dots: Vec<Start> =
            (0..100).map(|k| start([f64::from(k % 10) * 40.0, f64::from(k / 10) * 40.0], 10.0)).collect();
        dots.push(start([2000.0, 2000.0], 300.0));
        assert_eq!(fitted(&dots, |_| true).0.len(), 101);
    }
}
