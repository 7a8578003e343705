//! Noise that neighbouring pixels share: interpolated colours, compression, resampling, grain of paper and screens.
//!
//! A fit that takes pixels for independent finds the ellipse without bias, but its sigmas are too small. A shift of the edge is told by
//! pixels with weights in proportion to the slope of the profile, a Gaussian of the blur across the edge and slowly varying
//! along it; with the correlation `rho(l)` of two pixels a lag `l` apart its variance is that of independent pixels times
//!
//! ```text
//! kappa(n) = sum over lags of rho(l) exp(-(l . n)^2 / 4 s^2),   n the normal of the edge
//! ```
//!
//! (`sum w_i w_j rho / sum w_i^2`, and the Gaussian with itself a distance apart). `rho` comes from squared differences of pixels that see one
//! side only ([`pieces`]), `rho(l) = 1 - gamma(l) / gamma(far)`, `gamma(l) = <(g_i - g_i+l)^2> / 2`: unlike products about a mean found in
//! as few pixels these are free of bias. Where no correlation is beyond chance, pixels are taken for independent, to the bit.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | rho(l) | `NoiseCorrelation::rho` | 7 x 7 | 1 | correlation at the lags -3..3 along v and u |
//! | kappa(n) | [`NoiseCorrelation::inflation`] | 1 | 1 | variance of an edge over that of independent pixels |
//! | s | `blur_px` | 1 | px | |

mod pieces;

use crate::detect::candidate::Candidate;
use crate::image::{GrayView, Samples};
use crate::stats::median;
use pieces::{Far, Tile, tiles};

/// Largest lag, px, along u and v.
const REACH: i32 = 3;
const SIDE: usize = 2 * REACH as usize + 1;
/// Noise variance of which rounding to whole levels is no more than a third, grey^2.
const LEAST_VARIANCE: f64 = 0.25;
/// Correlation, beside chance, that is none.
const NONE: f64 = 0.05;
/// Pixels that tell nothing for certain when there are fewer.
const LEAST_PIXELS: f64 = 1000.0;
/// Pieces from which on the median of their correlations is taken: a spot of glare in some of them is no noise.
const SEVERAL: usize = 5;
/// By what factor the noise of a piece may surpass, or stay below, that of most.
const ODD: f64 = 4.0;
/// Correlation of neighbours that passes for noise where the light is judged.
const MOST_ALIKE: f64 = 0.6;

/// How alike the noise of two pixels is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct NoiseCorrelation {
    /// None where pixels are independent.
    rho: Option<Box<[[f64; SIDE]; SIDE]>>,
    /// What questions about residuals must allow for.
    pub(crate) allow: Allowance,
}

impl NoiseCorrelation {
    /// Independent pixels.
    pub(crate) const NONE: Self = Self { rho: None, allow: Allowance::NONE };

    /// From the pixels beside the edges of `discs`, clear of those of all `candidates`; `inside` tells whether those inside count, which smoke forbids.
    pub(crate) fn of(view: &GrayView, candidates: &[&Candidate], discs: &[&Candidate], inside: bool) -> Self {
        let least = if matches!(view.samples(), Samples::F32(_)) { 0.0 } else { LEAST_VARIANCE };
        let tiles = tiles(view, candidates, discs, inside);
        if tiles.iter().filter(|t| !t.seem_independent()).count() * 2 < tiles.len() {
            return Self::NONE;
        }
        let mut told: Vec<(&Tile, Far)> =
            tiles.iter().filter_map(|t| Some((t, t.far()?))).filter(|t| t.1.variance > least).collect();
        drop_odd(&mut told);
        let pixels: f64 = told.iter().map(|(t, _)| t.pixels()).sum();
        // Beside chance, what is not smooth to the last (a flank, a halo) is no correlation of the noise.
        let chance = 5.0 / pixels.sqrt() + NONE;
        let of_neighbours = [(1, 0), (0, 1)].map(|lag| correlation(&told, lag).unwrap_or(0.0));
        if 2 * told.len() < tiles.len() || pixels < LEAST_PIXELS || of_neighbours.iter().all(|rho| *rho < chance) {
            return Self::NONE;
        }
        let mut rho = Box::new([[0.0; SIDE]; SIDE]);
        rho[REACH as usize][REACH as usize] = 1.0;
        for (du, dv) in lags() {
            let (u, v) = ((REACH + du) as usize, (REACH + dv) as usize);
            rho[v][u] = correlation(&told, (du, dv)).unwrap_or(0.0).clamp(-1.0, 1.0);
            rho[SIDE - 1 - v][SIDE - 1 - u] = rho[v][u];
        }
        let mut out = Self { rho: Some(rho), allow: Allowance::NONE };
        out.allow = Allowance {
            alike: out.at(1, 0),
            rows: out.sum(|rho, _, dv| if dv == 0.0 { rho } else { 0.0 }).max(1.0),
            sums: out.sum(|rho, _, _| rho).max(1.0),
            squares: out.sum(|rho, _, _| rho * rho),
        };
        out
    }

    fn at(&self, du: i32, dv: i32) -> f64 {
        match &self.rho {
            Some(rho) => rho[(REACH + dv) as usize][(REACH + du) as usize],
            None => f64::from(u8::from(du == 0 && dv == 0)),
        }
    }

    fn sum(&self, of: impl Fn(f64, f64, f64) -> f64) -> f64 {
        let all = -REACH..=REACH;
        all.clone()
            .flat_map(|dv| all.clone().map(move |du| (du, dv)))
            .map(|(du, dv)| of(self.at(du, dv), f64::from(du), f64::from(dv)))
            .sum()
    }

    /// Whether pixels are independent.
    pub(crate) fn is_none(&self) -> bool {
        self.rho.is_none()
    }

    /// Variance of the place of an edge with this normal and blur over that of independent pixels: `kappa`.
    pub(crate) fn inflation(&self, [nu, nv]: [f64; 2], blur_px: f64) -> f64 {
        if self.rho.is_none() {
            return 1.0;
        }
        let four_s2 = 4.0 * blur_px * blur_px;
        let kappa = self.sum(|rho, du, dv| rho * (-(du * nu + dv * nv).powi(2) / four_s2).exp());
        // Sharpened images have less than one: too little is known of them to promise that.
        kappa.max(1.0)
    }
}

/// What noise that neighbours share makes of statistics of independent pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Allowance {
    /// Correlation of neighbours in a row.
    pub(crate) alike: f64,
    /// Variance of sums over rows, over areas, and of sums of squares, over those of independent pixels.
    pub(crate) rows: f64,
    pub(crate) sums: f64,
    pub(crate) squares: f64,
}

impl Allowance {
    /// Of independent pixels.
    pub(crate) const NONE: Self = Self { alike: 0.0, rows: 1.0, sums: 1.0, squares: 1.0 };

    /// Most that noise makes of the sum of the squares of so many means over rows, each over its pixels, in units of its variance.
    pub(crate) fn most_of_rows(&self, count: f64) -> f64 {
        self.rows * (count + 3.5 * ((2.0 * count + 2.0) * self.squares).sqrt())
    }

    /// Noise variance over half the mean squared difference of neighbours; what is alike beyond `MOST_ALIKE` may as well be light.
    pub(crate) fn over_neighbours(&self) -> f64 {
        1.0 / (1.0 - self.alike.clamp(0.0, MOST_ALIKE))
    }
}

fn lags() -> impl Iterator<Item = (i32, i32)> {
    let beside = (1..=REACH).map(|du| (du, 0));
    beside.chain((1..=REACH).flat_map(|dv| (-REACH..=REACH).map(move |du| (du, dv))))
}

/// Correlation at a lag, of several pieces the median; none where no pair is that far apart.
fn correlation(told: &[(&Tile, Far)], lag: (i32, i32)) -> Option<f64> {
    let square = f64::from(lag.0 * lag.0 + lag.1 * lag.1);
    let each = told.iter().filter_map(|(t, far)| Some((t.pixels(), t.gamma(lag)? - far.slow * square, far.variance)));
    if told.len() >= SEVERAL {
        let mut ratios: Vec<f64> = each.map(|(_, gamma, far)| gamma / far).collect();
        return median(&mut ratios).map(|ratio| 1.0 - ratio);
    }
    let (gamma, far) = each.fold((0.0, 0.0), |s, (n, gamma, far)| (s.0 + n * gamma, s.1 + n * far));
    (far > 0.0).then(|| 1.0 - gamma / far)
}

/// Leaves out the pieces that vary far more or less than most: dirt, other edges, clipped grounds.
fn drop_odd(told: &mut Vec<(&Tile, Far)>) {
    let mut all: Vec<f64> = told.iter().map(|t| t.1.variance).collect();
    let Some(typical) = median(&mut all) else { return };
    told.retain(|t| t.1.variance < ODD * typical && ODD * t.1.variance > typical);
}

#[cfg(test)]
#[path = "correlation/tests.rs"]
mod tests;
