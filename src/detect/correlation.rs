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
//! side only, `rho(l) = 1 - gamma(l) / gamma(far)`, `gamma(l) = <(g_i - g_i+l)^2> / 2`: unlike products about a mean found in
//! as few pixels these are free of bias. Where no correlation is beyond chance, pixels are taken for independent, to the bit.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | rho(l) | `NoiseCorrelation::rho` | 7 x 7 | 1 | correlation at the lags -3..3 along v and u |
//! | gamma(l) | `Tile::gamma` | 1 | grey^2 | half the mean squared difference at a lag |
//! | gamma(far) | `Far` | 2 | grey^2, grey^2/px^2 | the same at lags of 4 and 6 px as `variance + slow l^2`: light that changes slowly is no noise |
//! | kappa(n) | [`NoiseCorrelation::inflation`] | 1 | 1 | variance of an edge over that of independent pixels |
//! | s | `blur_px` | 1 | px | |

use crate::conic::Frame;
use crate::detect::candidate::Candidate;
use crate::frames::Pixel;
use crate::image::{GrayView, Samples};
use nalgebra::{Matrix3, Vector3};

/// Largest lag, px, along u and v.
const REACH: i32 = 3;
const SIDE: usize = 2 * REACH as usize + 1;
/// Lags at which noise has nothing in common: about 4 and about 6 px.
const FAR: [[(i32, i32); 4]; 2] = [[(4, 0), (0, 4), (3, 3), (-3, 3)], [(6, 0), (0, 6), (4, 4), (-4, 4)]];
/// Their squares, px^2, means over the four.
const FAR_PX2: [f64; 2] = [17.0, 34.0];
/// Bins of the distance from the edge in which pieces are compared, per px.
const BINS_PER_PX: f64 = 2.0;
const BINS: usize = (BESIDE_PX * BINS_PER_PX) as usize;
/// Half the side of the pieces of the image that are looked at, px, and how many of them at most.
const TILE: i32 = 22;
const MOST_TILES: usize = 12;
/// Blurs from the edge beyond which a pixel sees one side, and what is added for ellipses that are rough yet, px.
const CLEAR: f64 = 3.5;
const ROUGH_PX: f64 = 2.0;
/// Pixels beyond that, px: what the fits look at.
const BESIDE_PX: f64 = 5.0;
/// Noise variance of which rounding to whole levels is no more than a third, grey^2.
const LEAST_VARIANCE: f64 = 0.25;
/// Correlation, beside chance, that is none.
const NONE: f64 = 0.05;
/// Correlation of neighbours that is worth a closer look.
const GLANCE: f64 = 0.12;
/// Pixels that tell nothing for certain when there are fewer.
const LEAST_PIXELS: f64 = 1000.0;
/// Pieces from which on the median of their correlations is taken: a spot of glare in some of them is no noise.
const SEVERAL: usize = 5;
/// By what factor the noise of a piece may surpass, or stay below, that of most.
const ODD: f64 = 4.0;
/// Squares that a slope must explain, over the variance that it leaves: correlated noise explains some, and light that is taken off where there
/// is none takes correlation with it.
const SLANTED: f64 = 60.0;
/// Correlation of neighbours that passes for noise where the light is judged.
const MOST_ALIKE: f64 = 0.6;
/// Pixels in a piece, at least.
const LEAST_IN_TILE: usize = 60;

/// How alike the noise of two pixels is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct NoiseCorrelation {
    /// None where pixels are independent.
    rho: Option<Box<[[f64; SIDE]; SIDE]>>,
}

impl NoiseCorrelation {
    /// Independent pixels.
    pub(crate) const NONE: Self = Self { rho: None };

    /// From the pixels beside the edges of candidates; `inside` tells whether those inside count, which smoke forbids.
    pub(crate) fn of(view: &GrayView, candidates: &[&Candidate], inside: bool) -> Self {
        let least = if matches!(view.samples(), Samples::F32(_)) { 0.0 } else { LEAST_VARIANCE };
        let tiles = tiles(view, candidates, inside);
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
        Self { rho: Some(rho) }
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

    /// What questions about residuals must allow for.
    pub(crate) fn allowance(&self) -> Allowance {
        if self.rho.is_none() {
            return Allowance::NONE;
        }
        Allowance {
            alike: self.at(1, 0),
            rows: self.sum(|rho, _, dv| if dv == 0.0 { rho } else { 0.0 }).max(1.0),
            sums: self.sum(|rho, _, _| rho).max(1.0),
            squares: self.sum(|rho, _, _| rho * rho),
        }
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
        let middle = ratios.len() / 2;
        return (!ratios.is_empty()).then(|| 1.0 - *ratios.select_nth_unstable_by(middle, f64::total_cmp).1);
    }
    let (gamma, far) = each.fold((0.0, 0.0), |s, (n, gamma, far)| (s.0 + n * gamma, s.1 + n * far));
    (far > 0.0).then(|| 1.0 - gamma / far)
}

/// Leaves out the pieces that vary far more or less than most: dirt, other edges, clipped grounds.
fn drop_odd(told: &mut Vec<(&Tile, Far)>) {
    let mut all: Vec<f64> = told.iter().map(|t| t.1.variance).collect();
    if all.is_empty() {
        return;
    }
    let middle = all.len() / 2;
    let typical = *all.select_nth_unstable_by(middle, f64::total_cmp).1;
    told.retain(|t| t.1.variance < ODD * typical && ODD * t.1.variance > typical);
}

/// Pieces of the image, evenly among the candidates.
fn tiles(view: &GrayView, candidates: &[&Candidate], inside: bool) -> Vec<Tile> {
    let pieces = pieces(candidates);
    let step = pieces.len().div_ceil(MOST_TILES).max(1);
    let (mut out, mut within) = (Vec::new(), Vec::new());
    for (at, disc) in pieces.iter().step_by(step) {
        let beside = candidates.iter().filter(|c| near(c, *at));
        let edges: Vec<(Frame, f64)> = beside.map(|c| (Frame::new(&c.ellipse), clear_px(c))).collect();
        let own = (Frame::new(&disc.ellipse), clear_px(disc));
        let side = |side: f64| Tile::new(view, *at, &own, &edges, (side, disc.contrast));
        out.extend(side(1.0));
        let room = inside && own.0.b > own.1 + 1.0;
        within.extend(if room { side(-1.0) } else { None });
    }
    take_skirts_off(&mut out);
    take_skirts_off(&mut within);
    out.append(&mut within);
    out
}

/// How far from an edge a pixel sees one side only, px; what was seen at a coarse level may be off by some of its pixels.
fn clear_px(c: &Candidate) -> f64 {
    CLEAR * c.blur_px + ROUGH_PX * f64::from(1_u32 << c.level)
}

/// Whether the edge of a disc may be felt in the piece around a point.
fn near(c: &Candidate, at: Pixel) -> bool {
    let e = &c.ellipse;
    let reach = e.semi_major_px + clear_px(c) + f64::from(TILE);
    (e.center_px.u_px - at.u_px).abs() < reach && (e.center_px.v_px - at.v_px).abs() < reach
}

/// Middles of the pieces: small discs as a whole, of large ones up to four places of the contour.
fn pieces<'a>(candidates: &[&'a Candidate]) -> Vec<(Pixel, &'a Candidate)> {
    let mut out = Vec::new();
    for c in candidates {
        let e = &c.ellipse;
        if e.semi_major_px + CLEAR * c.blur_px < 0.6 * f64::from(TILE) {
            out.push((e.center_px, *c));
        } else {
            let count = ((0.5 * e.perimeter_px() / f64::from(TILE)) as usize).clamp(1, 4);
            let turn = std::f64::consts::TAU / count as f64;
            out.extend((0..count).map(|k| (e.point(turn * k as f64), *c)));
        }
    }
    out
}

/// A piece of the image: grey values of the pixels that see one side of one disc, zeros elsewhere.
#[derive(Debug)]
struct Tile {
    width: usize,
    height: usize,
    grey: Vec<f32>,
    /// One where the pixel counts, zero elsewhere.
    counts: Vec<f32>,
    /// Bin of the distance from the edge of those that count.
    bin: Vec<u8>,
    /// Contrast of the disc, grey.
    contrast: f64,
    /// Variance about the plane, grey^2.
    variance: f64,
}

impl Tile {
    /// The pixels around `at` beside one edge, outside (`side` is 1) or inside (-1) of it and clear of all edges, less the plane through them;
    /// none where they are few.
    fn new(
        view: &GrayView,
        at: Pixel,
        own: &(Frame, f64),
        edges: &[(Frame, f64)],
        (side, contrast): (f64, f64),
    ) -> Option<Self> {
        let half = (own.0.a + own.1 + BESIDE_PX + 1.0).min(f64::from(TILE));
        let span =
            |x: f64, size: usize| [x - half, x + half].map(|x| (x.round() as i64).clamp(0, size as i64 - 1) as usize);
        let ([left, right], [top, bottom]) = (span(at.u_px, view.width()), span(at.v_px, view.height()));
        let mut out = Self {
            width: right - left + 1,
            height: bottom - top + 1,
            grey: vec![],
            counts: vec![],
            bin: vec![],
            contrast,
            variance: 0.0,
        };
        for v in top..=bottom {
            for u in left..=right {
                let (x, y) = (u as f64, v as f64);
                let beyond = side * distance(&own.0, x, y) - own.1;
                let clear = (0.0..BESIDE_PX).contains(&beyond)
                    && edges.iter().all(|(edge, clear_px)| distance(edge, x, y).abs() > *clear_px);
                out.counts.push(f32::from(u8::from(clear)));
                out.bin.push(if clear { (beyond * BINS_PER_PX) as u8 } else { 0 });
                out.grey.push(if clear { view.get(u, v) } else { 0.0 });
            }
        }
        out.take_plane_off().then_some(out)
    }

    /// Mean at each distance from the edge, in units of the contrast.
    fn skirt(&self) -> [Option<f64>; BINS] {
        let mut sums = [(0.0, 0.0); BINS];
        for i in (0..self.grey.len()).filter(|i| self.counts[*i] > 0.0) {
            let sum = &mut sums[usize::from(self.bin[i])];
            *sum = (sum.0 + f64::from(self.grey[i]), sum.1 + 1.0);
        }
        sums.map(|(sum, count)| (count > 0.0).then(|| sum / (count * self.contrast)))
    }

    /// Whether neighbours differ as much as any two pixels, at a glance.
    fn seem_independent(&self) -> bool {
        [(1, 0), (0, 1)].iter().all(|lag| self.gamma(*lag).is_none_or(|gamma| gamma > (1.0 - GLANCE) * self.variance))
    }

    fn pixels(&self) -> f64 {
        self.counts.iter().map(|c| f64::from(*c)).sum()
    }

    /// Variance of the noise, and by what slow changes of the light add to `gamma` per squared px of the lag: from lags at which noise has
    /// nothing in common.
    fn far(&self) -> Option<Far> {
        let mean = |lags: &[(i32, i32)]| {
            let all: Vec<f64> = lags.iter().filter_map(|lag| self.gamma(*lag)).collect();
            (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
        };
        let [near, far] = [mean(&FAR[0])?, mean(&FAR[1])?];
        let slow = (far - near) / (FAR_PX2[1] - FAR_PX2[0]);
        Some(Far { variance: near - slow * FAR_PX2[0], slow })
    }

    /// Takes off the mean, and a slope where there clearly is one; false where there are too few pixels.
    fn take_plane_off(&mut self) -> bool {
        let (mut matrix, mut right, mut squares) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros(), 0.0);
        let row = |i: usize, width: usize| Vector3::new(1.0, (i % width) as f64, (i / width) as f64);
        let some: Vec<usize> = (0..self.grey.len()).filter(|i| self.counts[*i] > 0.0).collect();
        for &i in &some {
            let (r, g) = (row(i, self.width), f64::from(self.grey[i]));
            matrix += r * r.transpose();
            right += r * g;
            squares += g * g;
        }
        if some.len() < LEAST_IN_TILE {
            return false;
        }
        let Some(mut plane) = matrix.cholesky().map(|m| m.solve(&right)) else { return false };
        let mean = right[0] / matrix[(0, 0)];
        let left = (squares - right.dot(&plane)).max(0.0);
        let explained = squares - right[0] * mean - left;
        let count = some.len() as f64;
        self.variance = left / count;
        if explained < SLANTED * self.variance {
            plane = Vector3::new(mean, 0.0, 0.0);
            self.variance = (left + explained) / count;
        }
        for &i in &some {
            self.grey[i] = (f64::from(self.grey[i]) - row(i, self.width).dot(&plane)) as f32;
        }
        true
    }

    /// Half the mean squared difference at a lag; none where pairs are few.
    fn gamma(&self, (du, dv): (i32, i32)) -> Option<f64> {
        let (dv, shift) = (dv as usize, du.unsigned_abs() as usize);
        if dv >= self.height || shift >= self.width {
            return None;
        }
        let (mut sum, mut pairs) = (0.0, 0.0);
        let (first, second) = if du < 0 { (shift, 0) } else { (0, shift) };
        let n = self.width - shift;
        for v in 0..self.height - dv {
            let (a, b) = (v * self.width + first, (v + dv) * self.width + second);
            let of = |list: &[f32], at: usize| at..at + n.min(list.len() - at);
            let (x, y) = (&self.grey[of(&self.grey, a)], &self.grey[of(&self.grey, b)]);
            let (p, q) = (&self.counts[of(&self.counts, a)], &self.counts[of(&self.counts, b)]);
            let (mut squares, mut count) = (0.0_f32, 0.0_f32);
            for i in 0..n {
                let (both, step) = (p[i] * q[i], x[i] - y[i]);
                squares += both * step * step;
                count += both;
            }
            sum += f64::from(squares);
            pairs += f64::from(count);
        }
        (pairs >= 20.0).then(|| 0.5 * sum / pairs)
    }
}

/// What far lags tell of a piece.
#[derive(Debug, Clone, Copy)]
struct Far {
    variance: f64,
    slow: f64,
}

/// Takes off what most pieces show at the same distance from the edge (the skirts of the blur), in units of the contrast.
fn take_skirts_off(tiles: &mut [Tile]) {
    let skirts: Vec<[Option<f64>; BINS]> = tiles.iter().map(Tile::skirt).collect();
    let typical: [f64; BINS] = std::array::from_fn(|bin| {
        let mut all: Vec<f64> = skirts.iter().filter_map(|s| s[bin]).collect();
        let middle = all.len() / 2;
        if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(middle, f64::total_cmp).1 }
    });
    for t in tiles {
        for i in (0..t.grey.len()).filter(|i| t.counts[*i] > 0.0) {
            t.grey[i] -= (t.contrast * typical[usize::from(t.bin[i])]) as f32;
        }
    }
}

/// Distance of a pixel from an ellipse, to first order in it, px; positive outside.
fn distance(frame: &Frame, u: f64, v: f64) -> f64 {
    let (du, dv) = (u - frame.u0, v - frame.v0);
    let (x, y) = (frame.cos * du + frame.sin * dv, frame.cos * dv - frame.sin * du);
    let r = ((x / frame.a) * (x / frame.a) + (y / frame.b) * (y / frame.b)).sqrt();
    if r > 0.0 { (1.0 - 1.0 / r) * (x * x + y * y).sqrt() } else { -frame.b }
}

#[cfg(test)]
#[path = "correlation/tests.rs"]
mod tests;
