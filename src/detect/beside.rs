//! What the blur carries over from one disc to the next.
//!
//! Light adds up: with the ground taken as even, and `P_j` the share that a pixel sees of disc j,
//!
//! ```text
//! grey = ground + sum_j step_j P_j
//! ```
//!
//! A sector looks at three fifths of the gap to a neighbour. Where the gap is less than some 6 blurs it sees the neighbour's skirt there, which draws the
//! contour towards it: by 0.05 px of dots of 4 x 2.5 px behind a blur of 1.2 px with 3 px between them. So discs that are close are fitted again until they
//! stand still, in the image less what was found of their neighbours: exact integrals along their contours ([`crate::detect::rim`]). Their lines are looked
//! at there again: the skirt of a neighbour narrows the edge, and what the line tells of the blur is believed to some part. A disc that looked hidden or bent in
//! its neighbours' light is looked for again as well.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | step_j | `Lit::step` | grey | inside minus outside, of disc j |
//! | P_j | `Seen::inside` | 1 | share of disc j in a pixel |

use crate::conic::{Cut, Ellipse, Frame};
use crate::detect::band::LANES;
use crate::detect::contour::towards_px;
use crate::detect::refine::{Start, reach_px};
use crate::detect::rim::Rim;
use crate::detect::rows::ByRow;
use crate::detect::shape::Shape;
use crate::detect::{Disc, RejectionReason};
use crate::frames::Pixel;
use crate::image::{GrayView, Samples};
use crate::stats::normal_beyond;
use crate::target::Polarity;
use crate::threads;

/// Times that close discs are fitted again, at most.
const MOST_ROUNDS: usize = 6;
/// A neighbour that moved by less, in its place or its axes, need not be taken off anew, px.
const STILL_PX: f64 = 0.02;
/// Light of a neighbour that is felt, in standard deviations of the noise of a pixel: twice as much, of dots of 5.3 x 3.8 px on either side, moves axes by 0.0007 px.
const FELT: f64 = 1.0;
/// Blurs beyond the edge of a disc within which its light is taken off.
const SKIRT: f64 = 5.0;
/// Gap over the blur beyond which no neighbour is felt: there the pixels nearest to it see a millionth of its light.
const FAR: f64 = 12.0;
/// The same below which what is left of a neighbour's light may be as loud as the noise.
const CLOSEST: f64 = 2.4;

/// Times by which axes and contrast of discs that are alike differ, at most.
const ALIKE: [f64; 3] = [1.4, 1.4, 2.0];

type Refined = Result<Disc, RejectionReason>;

/// A disc that shines, or casts its shadow, upon others.
#[derive(Debug, Clone, Copy)]
struct Lit {
    ellipse: Ellipse,
    blur_px: f64,
    shape: Shape,
    step: f64,
}

impl Lit {
    fn of(disc: &Disc, shape: Shape) -> Self {
        let step = if disc.polarity == Polarity::Bright { disc.contrast } else { -disc.contrast };
        Self { ellipse: disc.ellipse, blur_px: disc.blur_px, shape, step }
    }

    /// Whether a disc `at` sees this one where it looks towards it, beyond noise of the standard deviation `sigma`.
    fn is_felt(&self, at: &Ellipse, sigma: f64) -> bool {
        let (p, q) = (at.center_px, self.ellipse.center_px);
        let (du, dv) = (p.u_px - q.u_px, p.v_px - q.v_px);
        let (reach, away2) = (at.semi_major_px + self.ellipse.semi_major_px + FAR * self.blur_px, du * du + dv * dv);
        // One disc found twice is no neighbour of itself.
        let twins = || self.ellipse.implicit(p) < 0.0 || at.implicit(q) < 0.0;
        if away2 > reach * reach || away2 < 0.25 * at.semi_minor_px * at.semi_minor_px || twins() {
            return false;
        }
        let gap = self.gap_px(at);
        let away = ((gap - towards_px(gap)) / self.blur_px).max(0.0);
        0.5 * normal_beyond(away) * self.step.abs() > FELT * sigma
    }

    /// Whether an ellipse with a step of light is about as large, and as bright or dark.
    fn is_like(&self, e: &Ellipse, step: f64) -> bool {
        let own = &self.ellipse;
        let times = [own.semi_major_px / e.semi_major_px, own.semi_minor_px / e.semi_minor_px, self.step / step];
        times.iter().zip(ALIKE).all(|(x, most)| (1.0 / most..most).contains(x))
    }

    /// Least distance from a disc beside it, px.
    fn gap_px(&self, at: &Ellipse) -> f64 {
        Frame::new(at).least_gap_px(&self.ellipse)
    }

    /// Takes its light off a patch of `width` pixels per row, whose first pixel is `corner`.
    fn take_off(&self, grey: &mut [f32], width: usize, corner: [usize; 2]) {
        let frame = Frame::new(&self.ellipse);
        let mut rim = Rim::default();
        rim.set(&frame, self.blur_px, self.shape);
        rim.step = rim.angles().map(|_| self.step).collect();
        let skirt = SKIRT * self.blur_px;
        let cut = Cut::new(&frame, frame.a + skirt, frame.b + skirt);
        for (row, grey) in grey.chunks_mut(width).enumerate() {
            let v = (corner[1] + row) as f64 - frame.v0;
            let Some((first, last)) = cut.span(v) else { continue };
            let column = |du: f64| (frame.u0 + du - corner[0] as f64).clamp(0.0, width as f64) as usize;
            let (first, last) = (column(first.floor()), column(last.ceil()));
            for from in (first..last).step_by(LANES) {
                let places: [_; LANES] =
                    std::array::from_fn(|l| frame.inside((corner[0] + from + l) as f64, v + frame.v0));
                let inside = rim.seen(&places.map(|p| p.0), &places.map(|p| p.1)).inside;
                let seen = grey[from..last.min(from + LANES)].iter_mut().zip(inside);
                seen.for_each(|(g, inside)| *g -= (self.step * inside) as f32);
            }
        }
    }
}

/// Fits discs again that feel their neighbours, each in the image without the light of these; `sigma` is the standard deviation of its noise. What does not hold
/// there stays as it was; what was turned down for its contour may hold there. Returns which of them felt any before the first round.
pub(super) fn refine_beside(
    view: &GrayView,
    starts: &[Start],
    refined: &mut [Refined],
    sigma: f64,
    refine: impl Fn(&GrayView, &Start) -> Refined + Sync,
) -> Vec<bool> {
    let (mut moved, mut felt) = (vec![true; refined.len()], vec![false; refined.len()]);
    for round in 0..MOST_ROUNDS {
        let close = close_ones(starts, refined, &moved, sigma);
        if close.is_empty() {
            break;
        }
        if round == 0 {
            close.iter().for_each(|(i, _)| felt[*i] = true);
        }
        let again = |(i, beside): &(usize, Vec<Lit>)| refine_in_patch(view, &starts[*i], beside, &refine);
        let found = threads::side_by_side(&close, again);
        moved.fill(false);
        for ((i, _), disc) in close.iter().zip(found) {
            let Some(new) = disc else { continue };
            moved[*i] = refined[*i].as_ref().map_or(true, |old| furthest_px(&new.ellipse, &old.ellipse) > STILL_PX);
            refined[*i] = Ok(new);
        }
    }
    felt
}

/// What is asked of some discs about noise, each in the image without the light of those that it feels; nothing of those nearest to others.
pub(super) fn ask_beside<T: Send>(
    view: &GrayView,
    asked: &[Start],
    (starts, refined): (&[Start], &[Refined]),
    sigma: f64,
    ask: impl Fn(&GrayView, &Start) -> Option<T> + Sync,
) -> Vec<Option<T>> {
    let lights = Lights::of(starts, refined, |_| true, sigma);
    threads::side_by_side(asked, |start| {
        let felt = lights.felt_by(&start.ellipse).unwrap_or_default();
        if felt.iter().any(|lit| lit.gap_px(&start.ellipse) < CLOSEST * lit.blur_px) {
            return None;
        }
        in_patch(view, start, &felt, |patch, start, _| ask(patch, start))
    })
}

/// The most that place or axes of two ellipses differ by, px.
fn furthest_px(a: &Ellipse, b: &Ellipse) -> f64 {
    (a.parameters() - b.parameters()).fixed_rows::<4>(0).amax()
}

/// The discs of an image as they shine upon each other.
struct Lights {
    /// Each with whether it has moved.
    lit: Vec<(bool, Lit)>,
    by_row: ByRow,
    /// The largest blur.
    blur_px: f64,
    sigma: f64,
}

impl Lights {
    /// Of the discs that the starts were refined to; `moved` says which have.
    fn of(starts: &[Start], refined: &[Refined], moved: impl Fn(usize) -> bool, sigma: f64) -> Self {
        let lit = |(i, (start, disc)): (usize, (&Start, &Refined))| {
            Some((moved(i), Lit::of(disc.as_ref().ok()?, start.shape)))
        };
        let lit: Vec<(bool, Lit)> = starts.iter().zip(refined).enumerate().filter_map(lit).collect();
        let by_row = ByRow::new(lit.iter().map(|(_, l)| &l.ellipse));
        let blur_px = lit.iter().map(|(_, l)| l.blur_px).fold(0.0, f64::max);
        Self { lit, by_row, blur_px, sigma }
    }

    /// All that is felt by a disc at a place, itself no neighbour; none where nothing is, or none of it has moved.
    fn felt_by(&self, e: &Ellipse) -> Option<Vec<Lit>> {
        let near = self.by_row.near(e.center_px, e.semi_major_px + self.by_row.largest_px + FAR * self.blur_px);
        let felt: Vec<_> = near.map(|k| &self.lit[k]).filter(|(_, lit)| lit.is_felt(e, self.sigma)).collect();
        felt.iter().any(|(moved, _)| *moved).then(|| felt.into_iter().map(|(_, lit)| *lit).collect())
    }
}

/// The discs that feel others of which one has moved, with all that they feel.
fn close_ones(starts: &[Start], refined: &[Refined], moved: &[bool], sigma: f64) -> Vec<(usize, Vec<Lit>)> {
    let lights = Lights::of(starts, refined, |i| moved[i], sigma);
    let felt_by = |&(start, disc): &(&Start, &Refined)| match disc {
        Ok(disc) => lights.felt_by(&disc.ellipse),
        // The light of others may be what made it look hidden or bent. What is no disc is hardly like them.
        Err(
            RejectionReason::Incomplete { .. }
            | RejectionReason::NotElliptical { .. }
            | RejectionReason::TooSmall { semi_minor_px: 0.0 },
        ) => {
            let like = |felt: &Vec<Lit>| felt.iter().any(|lit| lit.is_like(&start.ellipse, start.step()));
            lights.felt_by(&start.ellipse).filter(like)
        }
        Err(_) => None,
    };
    let all: Vec<_> = starts.iter().zip(refined).collect();
    let felt = threads::side_by_side(&all, felt_by).into_iter().enumerate();
    felt.filter_map(|(i, felt)| Some((i, felt?))).collect()
}

/// One disc in the image around it without the light of those beside it.
fn refine_in_patch(
    view: &GrayView,
    start: &Start,
    beside: &[Lit],
    refine: &impl Fn(&GrayView, &Start) -> Refined,
) -> Option<Disc> {
    in_patch(view, start, beside, |patch, start, [left, top]| {
        let mut disc = refine(patch, start).ok()?;
        disc.ellipse = moved(&disc.ellipse, [left, top]);
        disc.edge.u_px.iter_mut().for_each(|u| *u += left);
        disc.edge.v_px.iter_mut().for_each(|v| *v += top);
        Some(disc)
    })
}

/// An ellipse further on, px.
fn moved(e: &Ellipse, [du, dv]: [f64; 2]) -> Ellipse {
    Ellipse { center_px: Pixel::new(e.center_px.u_px + du, e.center_px.v_px + dv), ..*e }
}

/// Work on the image around a disc without the light of those beside it, given the start there and the place of the first pixel, px.
fn in_patch<T>(
    view: &GrayView,
    start: &Start,
    beside: &[Lit],
    work: impl Fn(&GrayView, &Start, [f64; 2]) -> Option<T>,
) -> Option<T> {
    let e = &start.ellipse;
    let reach = e.semi_major_px + 1.5 * reach_px(start.blur_px.max(1.0)) + 0.5 * e.semi_minor_px + 3.0;
    let span = |center: f64, size: usize| {
        let first = (center - reach).floor().max(0.0) as usize;
        (first, ((center + reach).ceil() as usize + 1).min(size))
    };
    let ((left, right), (top, bottom)) = (span(e.center_px.u_px, view.width()), span(e.center_px.v_px, view.height()));
    let width = right.checked_sub(left).filter(|n| *n > 0)?;
    let mut grey: Vec<f32> = (top..bottom).flat_map(|v| (left..right).map(move |u| view.get(u, v))).collect();
    beside.iter().for_each(|lit| lit.take_off(&mut grey, width, [left, top]));
    let patch = GrayView::new(Samples::F32(&grey), width, bottom.checked_sub(top)?, width).ok()?;
    let (left, top) = (left as f64, top as f64);
    let neighbours: Vec<Ellipse> = start.neighbours.iter().map(|n| moved(n, [-left, -top])).collect();
    work(&patch, &Start { ellipse: moved(e, [-left, -top]), neighbours: &neighbours, ..*start }, [left, top])
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLUR: f64 = 1.3;

    fn ellipse() -> Ellipse {
        Ellipse { center_px: Pixel::new(31.3, 22.6), semi_major_px: 4.4, semi_minor_px: 2.9, angle_rad: 0.5 }
    }

    /// Share of the blurred disc in a pixel, summed up over a fine grid.
    fn by_grid(e: &Ellipse, u: f64, v: f64) -> f64 {
        const STEP: f64 = 0.05;
        let reach = (6.0 * BLUR / STEP) as i32;
        let places = || (-reach..=reach).map(|i| f64::from(i) * STEP);
        let weight = |du: f64, dv: f64| (-0.5 * (du * du + dv * dv) / (BLUR * BLUR)).exp();
        let inside = |du: f64, dv: f64| e.implicit(Pixel::new(u + du, v + dv)) < 0.0;
        let seen = places().flat_map(|du| places().map(move |dv| (du, dv))).filter(|(du, dv)| inside(*du, *dv));
        seen.map(|(du, dv)| weight(du, dv)).sum::<f64>() * STEP * STEP / (std::f64::consts::TAU * BLUR * BLUR)
    }

    #[test]
    fn what_is_taken_off_is_the_blurred_disc() {
        let lit = Lit { ellipse: ellipse(), blur_px: BLUR, shape: Shape::GAUSSIAN, step: -80.0 };
        // A patch that the disc sticks out of.
        let (width, corner) = (23, [24, 19]);
        let mut grey = vec![100.0_f32; width * 17];
        lit.take_off(&mut grey, width, corner);
        for (column, row) in [(0, 0), (3, 5), (7, 3), (12, 4), (14, 2), (22, 16), (8, 11), (10, 8)] {
            let share = by_grid(&lit.ellipse, (corner[0] + column) as f64, (corner[1] + row) as f64);
            let found = f64::from(grey[row * width + column]);
            assert!(
                (found - 100.0 - 80.0 * share).abs() < 0.02,
                "{column} {row}: {found} and {}",
                100.0 + 80.0 * share
            );
        }
    }

    #[test]
    fn a_neighbour_is_felt_by_its_gap_and_no_disc_by_itself() {
        let e = ellipse();
        let lit = Lit { ellipse: e, blur_px: BLUR, shape: Shape::GAUSSIAN, step: -80.0 };
        let at =
            |du: f64, dv: f64| Ellipse { center_px: Pixel::new(e.center_px.u_px + du, e.center_px.v_px + dv), ..e };
        assert!(lit.is_felt(&at(12.0, 0.0), 1.0));
        assert!(!lit.is_felt(&at(25.0, 0.0), 1.0), "nobody sees that far");
        assert!(!lit.is_felt(&at(0.1, 0.1), 1.0), "found twice");
        assert!(!lit.is_felt(&at(12.0, 0.0), 1e3), "noise hides it");
    }

    /// A dot of a target is like its neighbours, a letter beside one is not.
    #[test]
    fn discs_are_alike_in_both_axes_and_light() {
        let e = ellipse();
        let lit = Lit { ellipse: e, blur_px: BLUR, shape: Shape::GAUSSIAN, step: -80.0 };
        assert!(lit.is_like(&Ellipse { semi_major_px: 5.5, semi_minor_px: 2.3, ..e }, -60.0));
        assert!(!lit.is_like(&Ellipse { semi_major_px: 6.5, ..e }, -60.0));
        assert!(!lit.is_like(&Ellipse { semi_minor_px: 1.8, ..e }, -60.0));
        assert!(!lit.is_like(&e, -30.0));
        assert!(!lit.is_like(&e, 80.0), "of the other polarity");
    }
}
