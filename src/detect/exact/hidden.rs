//! Pixels that something hides (glare, dirt, a shadow, another object), one by one, so that the rest of their sectors still counts.
//!
//! A pixel is *odd* where its residual, alone or averaged with its eight neighbours, is `ODD` times what is usual. Glare has
//! skirts that no single pixel betrays, yet together they drag the edge along. So odd pixels that lie together grow by rings: a
//! ring is hidden where its mean residual, or what is to be expected of it were the excess to go on falling from ring to ring as it
//! did before, exceeds `FELT` of the noise. The first ring, the pixels in the spot's corners or else those side by side with it, is always hidden.
//! Skirts fall at least exponentially, so the expectation is on the safe side; they do not rise outwards, so a ring of few pixels that is
//! brighter by chance than those before it is taken together with them.
//!
//! What rings show so little of is not all lost: with the mean residual `m` of its `n` pixels, known to `n^(-1/2)`, a ring's pixels may hold
//!
//! ```text
//! e^2 = VARIES (m^2 + 1/n)
//! ```
//!
//! each, in units of the noise, and count as much as noise larger by that lets them: `1 / (1 + e^2)` of a pixel.
//!
//! Light that exceeds the model by `e` on both sides of an edge blurred by `s` shifts it by `sum e h / sum h^2`, `h = E phi(d / s) / s`:
//!
//! ```text
//! shift = 2 pi^(1/2) s e / E,     felt = FELT (SHORT_PX / perimeter)^(1/2)
//! ```
//!
//! and the last pixels before a gap have the longest lever. The ellipse of a long contour is known so much better that it feels less: rings go on to be
//! hidden where a few of them together show more than `felt` on either side of the edge.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | r | `left` | noise | residual of a pixel |
//! | e | | grey | what a skirt adds |
//! | s, E | | px, grey | blur and step of the edge |
//! | felt | | noise | mean residual of the rings that are hidden on long contours |
//! | m | `mean` | noise | mean residual of a ring, positive in the spot, at least none |
//! | - | `Hidden` | | the hidden pixels of the image, in whole or in part |

use super::{Exact, State};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::contour::Contour;
use crate::detect::refine::Start;
use crate::image::GrayView;
use crate::stats::{SIGMA_OVER_MEDIAN, median};

/// Residual of an odd pixel, in units of the usual one.
const ODD: f64 = 4.5;
/// Mean residual of a ring that is hidden, in units of the noise.
const FELT: f64 = 0.4;
/// Contour whose ellipse does not feel that, px.
const SHORT_PX: f64 = 60.0;
/// Widest skirt, px.
const MOST_SKIRT_PX: i64 = 40;
/// Width of a ring, px: pixels side by side are in another than those corner to corner.
const RING_PX: f64 = 0.4;
/// Ring of the pixels in the corners of a spot; no other lies so near.
const CORNERS: usize = 1;
const MOST_RINGS: usize = (MOST_SKIRT_PX as f64 / RING_PX) as usize;
/// Rings that are looked at together on long contours.
const TOGETHER: usize = 5;
/// By how much more than its mean a skirt differs from pixel to pixel of a ring, as a variance.
const VARIES: f64 = 3.0;
/// Parts of a pixel.
const WHOLE: u8 = 16;
/// Largest share of the pixels of either side that may be hidden.
const MOST_HIDDEN: f64 = 0.4;
/// Largest share that glare is believed to hide where it may as well be smoke.
const LITTLE: f64 = 0.15;
/// Pixels of a neighbourhood that must be there for its mean to count.
const ENOUGH: f64 = 5.0;
/// Rounds of hiding and solving.
const ROUNDS: usize = 3;

/// Numbers at the pixels around one disc.
#[derive(Debug, Default, Clone, PartialEq)]
struct Grid<T> {
    u0: i64,
    v0: i64,
    width: i64,
    height: i64,
    at: Vec<T>,
}

impl<T: Copy> Grid<T> {
    fn place(&self, u: i64, v: i64) -> Option<usize> {
        let (i, j) = (u - self.u0, v - self.v0);
        (i >= 0 && j >= 0 && i < self.width && j < self.height).then(|| (j * self.width + i) as usize)
    }

    fn like<S: Copy>(&self, value: S) -> Grid<S> {
        Grid { u0: self.u0, v0: self.v0, width: self.width, height: self.height, at: vec![value; self.at.len()] }
    }

    /// Places within `reach` of place `p`, itself included.
    fn around(&self, p: usize, reach: i64) -> impl Iterator<Item = usize> + '_ {
        let (i, j) = self.column_and_row(p);
        let rows = (j - reach).max(0)..=(j + reach).min(self.height - 1);
        rows.flat_map(move |b| {
            let columns = (i - reach).max(0)..=(i + reach).min(self.width - 1);
            columns.map(move |a| (b * self.width + a) as usize)
        })
    }

    /// Places of the rectangle around some places, so much larger on each side.
    fn about(&self, places: &[usize], reach: i64) -> impl Iterator<Item = usize> + '_ {
        let (mut first, mut last) = ((i64::MAX, i64::MAX), (-1, -1));
        for p in places {
            let (i, j) = self.column_and_row(*p);
            (first, last) = ((first.0.min(i), first.1.min(j)), (last.0.max(i), last.1.max(j)));
        }
        let rows = first.1.saturating_sub(reach).max(0)..=(last.1 + reach).min(self.height - 1);
        rows.flat_map(move |j| {
            let columns = first.0.saturating_sub(reach).max(0)..=(last.0 + reach).min(self.width - 1);
            columns.map(move |i| (j * self.width + i) as usize)
        })
    }

    fn column_and_row(&self, p: usize) -> (i64, i64) {
        (p as i64 % self.width, p as i64 / self.width)
    }
}

/// The hidden pixels around one disc.
#[derive(Debug, Default, Clone, PartialEq)]
pub(crate) struct Hidden {
    /// Parts of each pixel that count.
    at: Grid<u8>,
    /// Share of the pixels on the side of the edge that has more of them.
    share: f64,
}

impl Hidden {
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(super) fn none(&self) -> bool {
        self.share == 0.0
    }

    /// How much of a pixel counts.
    fn counted(&self, (u, v): (i64, i64)) -> f64 {
        self.at.place(u, v).map_or(1.0, |p| f64::from(self.at.at[p]) / f64::from(WHOLE))
    }
}

/// The pixel at a place in the frame of the axes.
fn pixel(frame: &Frame, x: f64, y: f64) -> (i64, i64) {
    let (u, v) = (frame.u0 + frame.cos * x - frame.sin * y, frame.v0 + frame.sin * x + frame.cos * y);
    (u.round() as i64, v.round() as i64)
}

fn usual(mut sizes: Vec<f64>) -> f64 {
    median(&mut sizes).map_or(1.0, |size| (SIGMA_OVER_MEDIAN * size).max(1.0))
}

impl Exact {
    /// Leaves out what does not count, before the band is made compact.
    pub(super) fn leave_out_hidden(&mut self, state: &State) {
        let frame = Frame::new(&state.ellipse);
        let seen = if self.hidden.none() { 0 } else { self.band.len() };
        for i in 0..seen {
            if self.left_of(&frame, i) == 0.0 {
                self.band.distance[i] = f64::NAN;
            }
        }
    }

    /// How much of each pixel of the compact band counts.
    pub(super) fn count_parts(&mut self, state: &State) {
        let frame = Frame::new(&state.ellipse);
        let mut counted = std::mem::take(&mut self.counted);
        counted.clear();
        if !self.hidden.none() {
            counted.extend((0..self.count).map(|i| self.left_of(&frame, i)));
        }
        self.counted = counted;
    }

    /// How much something leaves of the pixel at place `i` of the band.
    fn left_of(&self, frame: &Frame, i: usize) -> f64 {
        self.hidden.counted(pixel(frame, self.band.x[i], self.band.y[i]))
    }

    /// How much of the pixel at place `p` counts.
    pub(super) fn counted(&self, p: usize) -> f64 {
        self.counted.get(p).copied().unwrap_or(1.0)
    }

    /// Roots of the weights of `LANES` pixels from place `i` on, of which so much is inside.
    pub(super) fn roots(&self, state: &State, i: usize, inside: [f64; LANES]) -> [f64; LANES] {
        std::array::from_fn(|l| (self.counted(i + l) * Self::weight(state, inside[l])).sqrt())
    }

    /// Takes back the sectors that were dropped, but for the pixels that something hides: `kept` says which sectors counted in the fit
    /// whose result stands in the scratch. Returns the sectors that count now; none, with the state as it was, where too much
    /// is hidden.
    pub(crate) fn uncover(
        &mut self,
        view: &GrayView,
        state: &mut State,
        contour: &mut Contour,
        kept: &[bool],
        start: &Start,
        floor: f64,
    ) -> Option<Vec<bool>> {
        let mut kept = kept.to_vec();
        let mut tried = state.clone();
        let mut counted = None;
        for round in 0..ROUNDS {
            let before = std::mem::take(&mut self.hidden);
            let all = vec![true; contour.len()];
            if !self.look(view, &tried, contour, &all, Self::reach(&tried, start)) {
                return None;
            }
            self.shares(&tried, contour.len());
            let hidden = self.odd_pixels(&tried, &kept)?;
            let settled = round > 0 && hidden == before;
            self.hidden = hidden;
            if round == 0 && self.hidden.none() && kept.iter().all(|k| *k) {
                return Some(kept);
            }
            if settled {
                // The residuals in the scratch are those of all pixels: once more without the hidden.
                kept = self.fit_uncovered(view, &mut tried, contour, &kept, start, floor)?;
                counted = Some(kept);
                break;
            }
            kept = self.fit_uncovered(view, &mut tried, contour, &all, start, floor)?;
            counted = Some(kept.clone());
        }
        *state = tried;
        counted
    }

    /// Solves without the hidden pixels, and once more without the sectors that disagree all the same.
    fn fit_uncovered(
        &mut self,
        view: &GrayView,
        state: &mut State,
        contour: &mut Contour,
        keep: &[bool],
        start: &Start,
        floor: f64,
    ) -> Option<Vec<bool>> {
        let kept = self.settle(view, state, contour, keep, start, floor)?;
        let agree = self.agreeing(&kept);
        if agree == kept { Some(kept) } else { self.settle(view, state, contour, &agree, start, floor) }
    }

    /// Whether all pixels count.
    pub(crate) fn hides_nothing(&self) -> bool {
        self.hidden.share == 0.0
    }

    /// Whether some pixels are hidden, but few on either side: rather glare than smoke.
    pub(crate) fn hides_little(&self) -> bool {
        (f64::MIN_POSITIVE..LITTLE).contains(&self.hidden.share)
    }

    /// The pixels that something hides, from the residuals of all in the scratch; none where they are too many. `kept` are the
    /// sectors that say what is usual.
    fn odd_pixels(&self, state: &State, kept: &[bool]) -> Option<Hidden> {
        let frame = Frame::new(&state.ellipse);
        let band = &self.band;
        let places: Vec<(i64, i64)> = (0..self.count).map(|i| pixel(&frame, band.x[i], band.y[i])).collect();
        let (first, last) = places.iter().fold(((i64::MAX, i64::MAX), (i64::MIN, i64::MIN)), |(a, b), p| {
            ((a.0.min(p.0), a.1.min(p.1)), (b.0.max(p.0), b.1.max(p.1)))
        });
        let (width, height) = (last.0 - first.0 + 1, last.1 - first.1 + 1);
        let at = vec![f64::NAN; (width * height) as usize];
        let mut left = Grid { u0: first.0, v0: first.1, width, height, at };
        let (mut trusted, mut inside) = (left.like(false), left.like(false));
        for (i, (u, v)) in places.iter().enumerate() {
            if let Some(p) = left.place(*u, *v) {
                left.at[p] = self.left[i];
                inside.at[p] = band.distance[i] < 0.0;
                trusted.at[p] = kept[band.sector[i] as usize];
            }
        }
        let seen: Vec<usize> = (0..left.at.len()).filter(|p| !left.at[*p].is_nan()).collect();
        let usual_of =
            |f: &dyn Fn(usize) -> f64| usual(seen.iter().filter(|p| trusted.at[**p]).map(|p| f(*p).abs()).collect());
        let single = usual_of(&|p| left.at[p]);
        let mut odd = left.like(false);
        seen.iter().for_each(|p| odd.at[*p] = left.at[*p].abs() > ODD * single);
        // Pixels that are odd by themselves must not make their neighbours so.
        let alone = odd.clone();
        let mean = |p: usize| {
            let near = left.around(p, 1).filter(|q| !alone.at[*q]).map(|q| left.at[q]).filter(|r| !r.is_nan());
            let (sum, n) = near.fold((0.0, 0.0), |(sum, n), r| (sum + r, n + 1.0));
            if n < ENOUGH { 0.0 } else { sum / f64::sqrt(n) }
        };
        let together = usual_of(&mean);
        seen.iter().for_each(|p| odd.at[*p] |= mean(*p).abs() > ODD * together);
        let mut hidden = left.like(WHOLE);
        let shorter = SHORT_PX / state.ellipse.perimeter_px();
        for spot in spots(&odd) {
            let (rings, sign) = rings(&left, &spot);
            let mut end = felt(&left, &rings, sign / single);
            if shorter < 1.0 {
                end = felt_on_either_side(&left, &inside, &rings, end, sign / (single * shorter.sqrt()));
            }
            spot.iter().for_each(|p| hidden.at[*p] = 0);
            for ring in &rings[1..=end] {
                let parts = parts(&left, ring, sign / single);
                ring.iter().for_each(|p| hidden.at[*p] = parts.min(hidden.at[*p]));
            }
        }
        let mut share = [[0.0; 2]; 2];
        for (i, (u, v)) in places.iter().enumerate() {
            let side = &mut share[usize::from(band.distance[i] > 0.0)];
            side[0] += f64::from(u8::from(left.place(*u, *v).is_some_and(|p| hidden.at[p] < WHOLE)));
            side[1] += 1.0;
        }
        let share = share.map(|[n, of]| n / f64::max(of, 1.0));
        let share = share[0].max(share[1]);
        (share < MOST_HIDDEN).then_some(Hidden { at: hidden, share })
    }
}

/// Odd pixels that lie together: at most two pixels apart.
fn spots(odd: &Grid<bool>) -> Vec<Vec<usize>> {
    let mut free = odd.clone();
    let mut all = vec![];
    for p in 0..free.at.len() {
        if !free.at[p] {
            continue;
        }
        free.at[p] = false;
        let mut spot = vec![p];
        let mut next = 0;
        while next < spot.len() {
            let near: Vec<usize> = free.around(spot[next], 2).filter(|q| free.at[*q]).collect();
            near.iter().for_each(|q| free.at[*q] = false);
            spot.extend(near);
            next += 1;
        }
        all.push(spot);
    }
    all
}

/// Rings around a spot, its own rim first, and the sign of what it adds. A corner, a pixel with two of the rim side by side, is nearer than others.
fn rings(left: &Grid<f64>, spot: &[usize]) -> (Vec<Vec<usize>>, f64) {
    let sign = spot.iter().map(|p| left.at[*p]).sum::<f64>().signum();
    let mut own = left.like(false);
    spot.iter().for_each(|p| own.at[*p] = true);
    let rim: Vec<usize> = spot.iter().copied().filter(|p| left.around(*p, 1).any(|q| !own.at[q])).collect();
    let rim_at: Vec<(i64, i64)> = rim.iter().map(|p| left.column_and_row(*p)).collect();
    let mut rings: Vec<Vec<usize>> = vec![vec![]; MOST_RINGS + 1];
    for q in left.about(&rim, MOST_SKIRT_PX).filter(|q| !own.at[*q] && !left.at[*q].is_nan()) {
        let (u, v) = left.column_and_row(q);
        let squares = rim_at.iter().map(|(i, j)| (u - i).pow(2) + (v - j).pow(2));
        let nearest = squares.clone().min().unwrap_or(i64::MAX);
        let corner = nearest == 1 && squares.filter(|d| *d == 1).count() > 1;
        let ring = if corner { CORNERS } else { ((nearest as f64).sqrt() / RING_PX) as usize };
        if ring <= MOST_RINGS {
            rings[ring].push(q);
        }
    }
    rings[0] = rim;
    (rings, sign)
}

/// Parts of the pixels of a ring that count; residuals times `scale` are in units of the noise, positive in the spot.
fn parts(left: &Grid<f64>, ring: &[usize], scale: f64) -> u8 {
    let n = f64::max(ring.len() as f64, 1.0);
    let mean = (scale * ring.iter().map(|p| left.at[*p]).sum::<f64>() / n).max(0.0);
    (f64::from(WHOLE) / (1.0 + VARIES * (mean * mean + 1.0 / n))).round() as u8
}

/// The last ring in which a spot is felt; residuals times `scale` are in units of the noise, positive in the spot.
fn felt(left: &Grid<f64>, rings: &[Vec<usize>], scale: f64) -> usize {
    let sum = |ring: &[usize]| (scale * ring.iter().map(|p| left.at[*p]).sum::<f64>(), ring.len() as f64);
    let excess = |(sum, count): (f64, f64)| sum / f64::max(count, 1.0);
    // Rings, those together that would rise.
    let (mut falling, mut end) = (vec![sum(&rings[0])], 0);
    for (i, ring) in rings.iter().enumerate().skip(1).filter(|(_, r)| !r.is_empty()) {
        let expected = match falling[..] {
            [.., before, last] => excess(last).max(0.0) * (excess(last) / excess(before)).clamp(0.0, 1.0),
            _ => 0.0,
        };
        falling.push(sum(ring));
        while let [.., a, b] = falling[..]
            && excess(b) > excess(a)
        {
            falling.truncate(falling.len() - 2);
            falling.push((a.0 + b.0, a.1 + b.1));
        }
        let now = falling.last().map_or(0.0, |x| excess(*x));
        if end > 0 && now.max(expected) < FELT {
            break;
        }
        end = i;
    }
    end
}

/// The same beyond ring `end` in the mean of the rings that follow, inside or outside.
fn felt_on_either_side(
    left: &Grid<f64>,
    inside: &Grid<bool>,
    rings: &[Vec<usize>],
    mut end: usize,
    scale: f64,
) -> usize {
    let on = |side: bool, next: &[Vec<usize>]| {
        let pixels = next.iter().flatten().filter(|p| inside.at[**p] == side);
        let (sum, count) = pixels.fold((0.0, 0.0), |(sum, n), p| (sum + left.at[*p], n + 1.0));
        scale * sum / f64::max(count, 1.0)
    };
    while end + TOGETHER < rings.len() && [true, false].iter().any(|s| on(*s, &rings[end + 1..][..TOGETHER]) > FELT) {
        end += 1;
    }
    end
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals of 21 x 21 pixels.
    fn grid(of: impl Fn(i64, i64) -> f64) -> Grid<f64> {
        let at = (0..21 * 21).map(|p| of(p % 21 - 10, p / 21 - 10)).collect();
        Grid { u0: 0, v0: 0, width: 21, height: 21, at }
    }

    fn place(u: i64, v: i64) -> usize {
        ((v + 10) * 21 + u + 10) as usize
    }

    #[test]
    fn corners_of_a_spot_are_the_first_ring() {
        let left = grid(|u, v| if u.abs() + v.abs() < 2 { -30.0 } else { 0.0 });
        let spot: Vec<usize> = (0..left.at.len()).filter(|p| left.at[*p] < 0.0).collect();
        let (rings, sign) = rings(&left, &spot);
        assert_eq!(sign, -1.0);
        assert_eq!(rings[0].len(), 5);
        let mut corners = rings[CORNERS].clone();
        corners.sort_unstable();
        assert_eq!(corners, [place(-1, -1), place(1, -1), place(-1, 1), place(1, 1)]);
        // Ends of the arms, at one pixel; then those corner to corner.
        assert_eq!(rings[2].len(), 4);
        assert_eq!(rings[3].len(), 8);
        assert_eq!(rings.iter().map(Vec::len).sum::<usize>(), 21 * 21);
    }

    #[test]
    fn rings_count_by_what_they_may_hold() {
        let of = |mean: f64, n: usize| {
            let left = grid(|_, _| 2.0 * mean);
            f64::from(parts(&left, &(0..n).collect::<Vec<_>>(), 0.5)) / f64::from(WHOLE)
        };
        // Darker than expected by chance: no more is known than that it holds as much as its mean may be off.
        for (mean, n, e2) in [(0.0, 4, 0.75), (-0.4, 4, 0.75), (0.5, 12, 1.0), (1.0, 8, 3.375)] {
            let off = of(mean, n) - 1.0 / (1.0 + e2);
            assert!(off.abs() <= 0.5 / f64::from(WHOLE), "mean {mean} of {n}: off by {off}");
        }
        assert_eq!(of(6.0, 8), 0.0);
        assert_eq!(of(9.0, 0), of(0.0, 1));
    }

    /// Means of rings of so many pixels.
    fn end_of(means: &[(f64, usize)]) -> usize {
        let (mut at, mut rings) = (vec![], vec![]);
        for (mean, count) in means {
            rings.push((at.len()..at.len() + count).collect());
            at.extend(std::iter::repeat_n(*mean, *count));
        }
        let left = Grid { u0: 0, v0: 0, width: at.len() as i64, height: 1, at };
        felt(&left, &rings, 1.0)
    }

    #[test]
    fn rings_end_where_nothing_is_felt_and_chance_does_not_make_them_go_on() {
        // The first is hidden whatever it shows.
        assert_eq!(end_of(&[(40.0, 4), (0.1, 8), (0.0, 4), (0.0, 16)]), 1);
        // Skirts that are seen.
        assert_eq!(end_of(&[(40.0, 4), (9.0, 8), (1.5, 12), (0.1, 16)]), 2);
        // They fall by half from ring to ring: the one that shows nothing by chance is expected to go on, at 0.5.
        assert_eq!(end_of(&[(8.0, 4), (4.0, 8), (2.0, 12), (1.0, 16), (0.1, 20), (0.0, 24)]), 4);
        // Four pixels that are bright by chance behind eight that are not: one standard deviation.
        assert_eq!(end_of(&[(40.0, 4), (0.0, 8), (0.5, 4), (-0.4, 16), (0.0, 20)]), 1);
        assert_eq!(end_of(&[(40.0, 4), (0.1, 8), (1.1, 4), (-0.4, 16), (0.0, 20)]), 2);
    }
}
