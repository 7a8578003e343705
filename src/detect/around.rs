//! What lies around a candidate: its own hole, its neighbours, the disc in whose smoke it is a wisp.

use crate::conic::{Ellipse, Frame};
use crate::detect::candidate::Candidate;
use crate::detect::contour::NEIGHBOUR;
use crate::detect::refine::reach_px;
use crate::detect::rows::ByRow;
use crate::threads;

/// Images with more candidates than this, wisps of smoke in them apart, show prints, not smoke.
pub(super) const MOST_SMOKY: usize = 24;
/// Contrast over that of the disc around it below which a region may be a wisp of smoke.
const WISP: f64 = 0.5;

/// What lies around one candidate.
pub(super) struct Surroundings {
    /// How far the band may reach inwards, px: not into a hole of the disc.
    pub(super) inner_px: f64,
    /// Other edges within sight.
    pub(super) neighbours: Vec<Ellipse>,
}

/// How far the bands around the candidates look at most, px.
const SIGHT_PX: f64 = 40.0;

/// Up to what gap another edge is felt, were the blur more than twice what it seems to be, px.
fn sight_px(blur_px: f64) -> f64 {
    (reach_px(2.0 * blur_px + 1.0) / NEIGHBOUR).min(SIGHT_PX)
}

/// Contrast over that of the disc from which a region of the other polarity inside is a hole; less is smoke.
const HOLE: f64 = 0.5;

/// What lies around each candidate: its own hole, its neighbours.
pub(super) fn surroundings(candidates: &[Candidate]) -> Vec<Surroundings> {
    let by_row = ByRow::new(candidates.iter().map(|c| &c.ellipse));
    threads::side_by_side(candidates, |c| around(c, candidates, &by_row))
}

fn around(c: &Candidate, candidates: &[Candidate], by_row: &ByRow) -> Surroundings {
    let e = &c.ellipse;
    let mut around = Surroundings { inner_px: 0.9 * e.semi_minor_px, neighbours: vec![] };
    let sight = sight_px(c.blur_px);
    for k in by_row.near(e.center_px, e.semi_major_px + by_row.largest_px + sight) {
        let other = &candidates[k];
        let o = &other.ellipse;
        let reach = e.semi_major_px + o.semi_major_px + sight;
        let (du, dv) = (e.center_px.u_px - o.center_px.u_px, e.center_px.v_px - o.center_px.v_px);
        if du * du + dv * dv > reach * reach || std::ptr::eq(c, other) || other.contrast <= 0.3 * c.contrast {
            continue;
        }
        let apart = du.hypot(dv);
        if apart < 0.6 * e.semi_minor_px && o.semi_major_px < 0.85 * e.semi_minor_px {
            if other.bright != c.bright && other.contrast > HOLE * c.contrast {
                around.inner_px = around.inner_px.min(0.6 * (e.semi_minor_px - o.semi_major_px - apart).max(2.0));
            }
        } else if apart > e.semi_minor_px {
            // A spot of the other polarity upon the contour (glare) spoils a few sectors, which show it themselves.
            let clear = apart - e.semi_major_px - o.semi_major_px > 2.0;
            if clear || other.bright == c.bright || Frame::new(e).least_gap_px(o) > 2.0 {
                around.neighbours.push(*o);
            }
        }
    }
    around
}

/// Which candidates are faint against a disc that they lie in, as wisps of its smoke are; none where more than [`MOST_SMOKY`] are not, which nobody asks for
/// smoke.
pub(super) fn wisps(candidates: &[&Candidate]) -> Vec<bool> {
    // The largest are enough to look in.
    let mut largest: Vec<(f64, usize)> =
        candidates.iter().enumerate().map(|(k, c)| (c.ellipse.semi_minor_px, k)).collect();
    if largest.len() > MOST_SMOKY {
        largest.select_nth_unstable_by(MOST_SMOKY, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        largest.truncate(MOST_SMOKY);
    }
    let in_disc = |c: &Candidate, disc: &Candidate| {
        c.contrast < WISP * disc.contrast
            && c.ellipse.semi_major_px < disc.ellipse.semi_minor_px
            && disc.ellipse.implicit(c.ellipse.center_px) < 0.0
    };
    let (mut out, mut others) = (Vec::with_capacity(candidates.len()), 0);
    for c in candidates {
        let wisp = largest.iter().any(|(_, k)| in_disc(c, candidates[*k]));
        others += usize::from(!wisp);
        if others > MOST_SMOKY {
            return vec![false; candidates.len()];
        }
        out.push(wisp);
    }
    out
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::frames::Pixel;

    /// A bubble full of smoke, another beside it, and in the first what is too strong for a wisp, and a wisp; the last lies between the bubbles.
    #[test]
    fn wisps_are_faint_and_lie_in_a_disc() {
        let of = |u_px: f64, semi_px: f64, contrast: f64| {
            let ellipse = Ellipse::new(Pixel::new(u_px, 50.0), semi_px, semi_px, 0.3).expect("an ellipse");
            Candidate { ellipse, blur_px: 1.0, bright: true, contrast, rms_px: 0.1, level: 0 }
        };
        let all = [
            of(100.0, 80.0, 160.0),
            of(300.0, 70.0, 150.0),
            of(110.0, 12.0, 90.0),
            of(60.0, 8.0, 40.0),
            of(200.0, 8.0, 40.0),
        ];
        assert_eq!(wisps(&all.iter().collect::<Vec<_>>()), [false, false, false, true, false]);
        // Before many wisps the largest are still looked in; among many discs nobody asks.
        let more = |wisps: usize, discs: usize| -> Vec<Candidate> {
            let wisps = (0..wisps).map(|k| of(60.0 + k as f64, 8.0, 40.0));
            wisps.chain(all).chain((0..discs).map(|k| of(1000.0 + 9.0 * k as f64, 4.0, 90.0))).collect()
        };
        for (few, count) in [(true, MOST_SMOKY - 4), (false, MOST_SMOKY - 3)] {
            let all = more(30, count);
            let found = wisps(&all.iter().collect::<Vec<_>>());
            assert_eq!(found.iter().filter(|x| **x).count(), if few { 31 } else { 0 });
        }
    }
}
