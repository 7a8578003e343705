//! What the fit leaves unexplained: the share of each sector, the noise of either side, and whether it looks like light.

use super::products::CHUNK;
use super::{Exact, State};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::refine::Start;
use crate::stats::{SIGMA_OVER_MEDIAN, median};

/// Pairs of neighbours below which smoke may pass for noise: chance alone makes three standard deviations of their likeness a quarter.
const FEW: f64 = 144.0;

/// A pixel so many times the blur and half a pixel from the edge feels nothing of it, whatever its profile.
const DEEP: f64 = 3.3;
/// Mean squared residual over the noise that is no noise.
const UNLIKE_NOISE: f64 = 2.0;

/// One sector's share in the result.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Share {
    /// Weighted residuals times response, 1/px.
    score: f64,
    /// Information about the shift of the edge, 1/px^2.
    pub(crate) information: f64,
    /// Weighted squared residuals and their number.
    pub(crate) squares: f64,
    pub(crate) pixels: f64,
}

impl Share {
    /// Takes in a pixel of which so much counts, with the response `h` and the residual `left`, both over the noise.
    #[inline(always)]
    pub(crate) fn push(&mut self, h: f64, left: f64, counted: f64) {
        self.score += h * left;
        self.information += h * h;
        self.squares += left * left;
        self.pixels += counted;
    }

    /// Takes in sums over pixels: of response times residual, squared responses, squared residuals, and their number.
    #[inline(always)]
    pub(crate) fn add(&mut self, [score, information, squares, pixels]: [f64; 4]) {
        self.score += score;
        self.information += information;
        self.squares += squares;
        self.pixels += pixels;
    }

    /// Outward shift of the edge beyond that of the ellipse, px.
    pub(crate) fn shift_px(&self) -> f64 {
        -self.score / self.information
    }

    /// Square of the same over its variance.
    pub(crate) fn deviation2(&self) -> f64 {
        self.score * self.score / self.information
    }
}

/// Sums over pixels that see at least nine tenths of the disc; residuals over the noise.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Within {
    pub(super) squares: f64,
    pub(super) count: f64,
    /// Squares of what the middle one of three in a row is off the mean of the others, as a variance, and their number.
    pub(super) bends: f64,
    pub(super) triples: f64,
    /// Shares of all pixels in the disc.
    pub(super) all: f64,
    /// Number of pairs of neighbouring residuals that the edge does not reach, sums of the first, of the second, and of their products.
    pub(super) deep: [f64; 4],
}

/// Noise that a few pixels show.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Noise {
    /// grey^2.
    pub(crate) variance: f64,
    /// Standard deviation of the variance, relative.
    pub(crate) sigma: f64,
}

impl Exact {
    /// What each sector and each side leave unexplained.
    pub(super) fn shares(&mut self, state: &State, sectors: usize) {
        let lights = Self::lights(state);
        let frame = Frame::new(&state.ellipse);
        self.shares.clear();
        self.shares.resize(sectors, Share::default());
        self.away = [[0.0; 2]; 2];
        self.neighbours = [0.0; 2];
        self.within = Within::default();
        self.left.clear();
        self.prepare(state, &frame);
        let mut before: [Option<(usize, f64)>; 2] = [None; 2];
        let deep = DEEP * state.blur_px + 0.5;
        for start in (0..self.count).step_by(LANES) {
            self.fill(state, &frame, start, 0);
            let mut model = [0.0; LANES];
            for (j, x) in self.found.iter().enumerate() {
                model.iter_mut().zip(&self.columns[j * CHUNK..]).for_each(|(m, column)| *m += x * column);
            }
            for l in 0..LANES.min(self.count - start) {
                let p = start + l;
                let left = self.columns[(lights + FIXED) * CHUNK + l] - model[l];
                self.left.push(left);
                let (q, h) = (self.inside[p], self.response[p]);
                let counted = self.counted(p);
                self.shares[self.band.sector[p] as usize].push(h, left, counted);
                let far = if q > 0.995 { Some(0) } else { (q < 0.005).then_some(1) };
                if let Some(side) = far {
                    self.away[side][0] += left * left / Self::weight(state, q);
                    self.away[side][1] += counted;
                }
                self.within.all += q;
                let here = (q > 0.9 && counted == 1.0).then_some((p, left));
                if let Some((_, r2)) = here {
                    self.within.squares += left * left;
                    self.within.count += 1.0;
                    before[1] = before[1].filter(|(p1, _)| self.side_by_side(*p1, p));
                    if let Some((p1, r1)) = before[1] {
                        self.neighbours[0] += r1 * r2;
                        self.neighbours[1] += 1.0;
                        if self.band.distance[p1].abs().min(self.band.distance[p].abs()) > deep {
                            let sums = [1.0, r1, r2, r1 * r2];
                            self.within.deep.iter_mut().zip(sums).for_each(|(sum, x)| *sum += x);
                        }
                        if let Some((_, r0)) = before[0].filter(|(p0, _)| self.side_by_side(*p0, p1)) {
                            self.within.bends += (r1 - 0.5 * (r0 + r2)).powi(2) / 1.5;
                            self.within.triples += 1.0;
                        }
                    }
                }
                before = [before[1], here];
            }
        }
    }

    /// Of the sectors that counted, those that say the same as the rest.
    pub(super) fn agreeing(&self, kept: &[bool]) -> Vec<bool> {
        let median = |f: &dyn Fn(&Share) -> f64| {
            let kept = self.shares.iter().zip(kept).filter(|(x, k)| **k && x.information > 0.0);
            median(&mut kept.map(|(x, _)| f(x)).collect::<Vec<_>>()).unwrap_or(0.0)
        };
        let scatter = (SIGMA_OVER_MEDIAN * median(&|x| x.shift_px().abs() * x.information.sqrt())).max(1.0);
        let misfit = median(&|x| x.squares / x.pixels.max(1.0)).max(1.0);
        let agrees = |x: &Share| {
            let off = if x.information > 0.0 { x.shift_px().abs() * x.information.sqrt() } else { 0.0 };
            off < 4.5 * scatter && x.squares < x.pixels * misfit * (2.0 + 5.0 * (2.0 / x.pixels.max(1.0)).sqrt())
        };
        self.shares.iter().zip(kept).map(|(x, k)| *k && (x.pixels == 0.0 || agrees(x))).collect()
    }

    /// Whether two pixels of the band touch along a row.
    fn side_by_side(&self, i: usize, j: usize) -> bool {
        let b = &self.band;
        (b.x[i] - b.x[j]).hypot(b.y[i] - b.y[j]) < 1.01
    }

    /// Noise inside that the scatter of neighbours shows whatever the smoke; at most that of the shortest smoke is in it.
    pub(crate) fn noise_between_neighbours(&self, state: &State) -> Option<Noise> {
        let Within { bends, triples, .. } = self.within;
        // Bends at neighbouring pixels are alike, -2/3 and 1/6 one and two further on.
        (triples > 12.0).then(|| Noise { variance: state.variance[0] * bends / triples, sigma: (3.9 / triples).sqrt() })
    }

    /// Whether what is left inside looks like light rather than noise: more alike from pixel to pixel than noise is.
    pub(crate) fn smoke_left(&self, state: &State) -> bool {
        let [product, n] = self.neighbours;
        if n < 12.0 {
            return self.misfit() > 2.0;
        }
        let beyond = product - state.allow.alike.max(0.0) * n;
        beyond > 0.25 * n && beyond > 3.0 * (n * state.allow.squares).sqrt()
    }

    /// Whether the edge alone is not explained, along most of it: it has another profile than a Gaussian's, and the light beside it is even.
    pub(crate) fn edge_alone(&self, state: &State) -> bool {
        let [n, first, second, products] = self.within.deep;
        // About their mean: what the edge does not explain shifts the level.
        let product = products - first * second / n.max(1.0);
        let alike = product > 0.25 * n + 3.0 * (n * state.allow.squares).sqrt();
        let seen = || self.shares.iter().filter(|x| x.pixels > 0.0);
        let unexplained = seen().filter(|x| x.squares > UNLIKE_NOISE * x.pixels).count();
        n >= 12.0 && !alike && 2 * unexplained > seen().count()
    }

    /// Counts what an edge of another profile leaves as noise: it moves contours as much, the axes more than the centre.
    pub(crate) fn count_misfit_as_noise(&mut self) {
        let misfit = self.misfit().max(1.0);
        for share in &mut self.shares {
            (share.score, share.information, share.squares) =
                (share.score / misfit, share.information / misfit, share.squares / misfit);
        }
        self.dense.covariance *= misfit;
    }

    /// Whether the noise inside is well above that outside, on a disc of too few pixels to show whether they are alike.
    pub(crate) fn louder_inside(&self, state: &State) -> bool {
        let [inner, outer] = self.away.map(|[_, n]| n);
        let [a, b] = state.variance;
        self.neighbours[1] < FEW
            && inner > 0.0
            && outer > 0.0
            && (a / b).ln() > 2.5 * (2.0 / inner + 2.0 / outer).sqrt()
    }

    /// Mean squared residual over the noise.
    pub(crate) fn misfit(&self) -> f64 {
        let sum = |f: &dyn Fn(&Share) -> f64| self.shares.iter().map(f).sum::<f64>();
        sum(&|s| s.squares) / sum(&|s| s.pixels).max(1.0)
    }

    /// Noise variances of both sides, from what their pixels show and, of few pixels, what all discs tell, grey^2.
    pub(super) fn noise_of_sides(&self, state: &State, start: &Start) -> [f64; 2] {
        let shown = self.away.map(|[squares, n]| (n > 0.0).then(|| (squares / n, n)));
        let outside = self.noise()[1].unwrap_or(start.variance);
        let expected = start.shot_noise.and_then(|x| x.fill([shown[0], Some((outside, 0.0))], state.step));
        expected.unwrap_or_else(|| match self.noise() {
            [Some(a), Some(b)] => [a, b],
            [Some(a), None] | [None, Some(a)] => [a, a],
            [None, None] => state.variance,
        })
    }

    /// Noise variances of either side where enough pixels show them, grey^2.
    pub(crate) fn noise(&self) -> [Option<f64>; 2] {
        self.away.map(|[squares, n]| (n > 12.0).then(|| squares / n))
    }
}
