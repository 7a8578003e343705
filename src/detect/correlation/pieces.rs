//! Pieces of an image beside edges, whose pixels see one side only, and how much their pixels differ from one another.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | gamma(l) | `Tile::gamma` | 1 | grey^2 | half the mean squared difference at a lag |
//! | gamma(far) | `Far` | 2 | grey^2, grey^2/px^2 | the same at lags of 4 and 6 px as `variance + slow l^2`: light that changes slowly is no noise |

use crate::conic::Frame;
use crate::detect::candidate::Candidate;
use crate::frames::Pixel;
use crate::image::GrayView;
use crate::stats::median;
use nalgebra::{Matrix3, Vector3};

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
pub(super) const BESIDE_PX: f64 = 5.0;
/// Correlation of neighbours that is worth a closer look.
const GLANCE: f64 = 0.12;
/// Squares that a slope must explain, over the variance that it leaves: correlated noise explains some, and light that is taken off where there
/// is none takes correlation with it.
const SLANTED: f64 = 60.0;
/// Pixels in a piece, at least.
const LEAST_IN_TILE: usize = 60;

/// Pieces of the image, evenly among the `discs`, clear of the edges of all candidates.
pub(super) fn tiles(view: &GrayView, candidates: &[&Candidate], discs: &[&Candidate], inside: bool) -> Vec<Tile> {
    let pieces = pieces(discs);
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
pub(super) struct Tile {
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
        let (width, height) = (right - left + 1, bottom - top + 1);
        let count = width * height;
        let mut out = Self {
            width,
            height,
            grey: vec![0.0; count],
            counts: vec![0.0; count],
            bin: vec![0; count],
            contrast,
            variance: 0.0,
        };
        let ring = Ring::new(&own.0, side, own.1);
        for v in top..=bottom {
            for u in left..=right {
                let (x, y) = (u as f64, v as f64);
                if !ring.may_hold(x, y) {
                    continue;
                }
                let beyond = side * distance(&own.0, x, y) - own.1;
                let clear = (0.0..BESIDE_PX).contains(&beyond)
                    && edges.iter().all(|(edge, clear_px)| distance(edge, x, y).abs() > *clear_px);
                if clear {
                    let at = (v - top) * width + (u - left);
                    (out.grey[at], out.counts[at], out.bin[at]) = (view.get(u, v), 1.0, (beyond * BINS_PER_PX) as u8);
                }
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
    pub(super) fn seem_independent(&self) -> bool {
        [(1, 0), (0, 1)].iter().all(|lag| self.gamma(*lag).is_none_or(|gamma| gamma > (1.0 - GLANCE) * self.variance))
    }

    pub(super) fn pixels(&self) -> f64 {
        self.counts.iter().map(|c| f64::from(*c)).sum()
    }

    /// Variance of the noise, and by what slow changes of the light add to `gamma` per squared px of the lag: from lags at which noise has
    /// nothing in common.
    pub(super) fn far(&self) -> Option<Far> {
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
        // Differences from one of them: squares of large levels would hide small noise.
        let ground = some.first().map_or(0.0, |i| self.grey[*i]);
        for &i in &some {
            self.grey[i] -= ground;
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
    pub(super) fn gamma(&self, (du, dv): (i32, i32)) -> Option<f64> {
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
pub(super) struct Far {
    pub(super) variance: f64,
    pub(super) slow: f64,
}

/// Takes off what most pieces show at the same distance from the edge (the skirts of the blur), in units of the contrast.
fn take_skirts_off(tiles: &mut [Tile]) {
    let skirts: Vec<[Option<f64>; BINS]> = tiles.iter().map(Tile::skirt).collect();
    let typical: [f64; BINS] = std::array::from_fn(|bin| {
        let mut all: Vec<f64> = skirts.iter().filter_map(|s| s[bin]).collect();
        median(&mut all).unwrap_or(0.0)
    });
    for t in tiles {
        for i in (0..t.grey.len()).filter(|i| t.counts[*i] > 0.0) {
            t.grey[i] -= (t.contrast * typical[usize::from(t.bin[i])]) as f32;
        }
    }
}

/// Where pixels can lie that are as far from an ellipse as is asked for: told without a root or a division. With r the size of `(x/a, y/b)`
/// [`distance`] lies between `(r - 1) a` and `(r - 1) b`.
pub(super) struct Ring<'a> {
    frame: &'a Frame,
    /// `1/a^2` and `1/b^2`.
    by: [f64; 2],
    /// Of r^2.
    least: f64,
    most: f64,
}

impl<'a> Ring<'a> {
    /// From `from_px` on, [`BESIDE_PX`] wide, outside (`side` is 1) or inside (-1).
    pub(super) fn new(frame: &'a Frame, side: f64, from_px: f64) -> Self {
        let near = 1.0 + side * from_px / frame.a;
        let far = 1.0 + side * (from_px + BESIDE_PX) / frame.b;
        let square = |r: f64| r.max(0.0) * r.max(0.0);
        Self {
            frame,
            by: [frame.a, frame.b].map(|x| 1.0 / (x * x)),
            least: square(near.min(far)) * (1.0 - 1e-9),
            most: square(near.max(far)) * (1.0 + 1e-9),
        }
    }

    pub(super) fn may_hold(&self, u: f64, v: f64) -> bool {
        let f = self.frame;
        let (du, dv) = (u - f.u0, v - f.v0);
        let (x, y) = (f.cos * du + f.sin * dv, f.cos * dv - f.sin * du);
        (self.least..=self.most).contains(&(x * x * self.by[0] + y * y * self.by[1]))
    }
}

/// Distance of a pixel from an ellipse, to first order in it, px; positive outside.
pub(super) fn distance(frame: &Frame, u: f64, v: f64) -> f64 {
    let (du, dv) = (u - frame.u0, v - frame.v0);
    let (x, y) = (frame.cos * du + frame.sin * dv, frame.cos * dv - frame.sin * du);
    let r = ((x / frame.a) * (x / frame.a) + (y / frame.b) * (y / frame.b)).sqrt();
    if r > 0.0 { (1.0 - 1.0 / r) * (x * x + y * y).sqrt() } else { -frame.b }
}
