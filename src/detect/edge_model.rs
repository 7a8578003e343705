//! The blurred edge of one disc, fitted to the grey values around it.
//!
//! Physical picture: a disc of one brightness on a ground of another, under light that varies smoothly over the image, blurred by optics
//! and by the area of the pixels. Along the outward normal, with `d` the signed distance of a pixel from the ellipse,
//!
//! ```text
//! g(d, t) = P L_in(t) + (1 - P) L_out(t) + slope terms,   P = Phi(-(d / s + kappa s / 2))
//! ```
//!
//! `Phi` is the normal distribution, `kappa` the local curvature: blur moves the half level of a curved edge inwards by
//! `kappa s^2 / 2` (heat equation in polar coordinates, first order; the second order only widens `s` by `1 + kappa^2 s^2 / 4`,
//! which the fitted `s` absorbs; the third order is `kappa^3 s^4 / 8`). The slope terms are those of light that rises, falls or bends
//! along the normal, blurred with the disc ([`crate::detect::sectors`]).
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | q | `geometry` | 5 | px | `(u0, v0, (a+b)/2, e1, e2)`, see [`crate::conic`] |
//! | s | `blur_px` | 1 | px | standard deviation of the blur, pixel area included (adds 1/12 px^2) |
//! | t | - | 1 | rad | eccentric angle of the foot point |
//! | L, S, B | `level`, `slope`, `bend` | 1 per sector and side | grey, grey/px, grey/px^2 | light on the contour and its derivatives along the normal, see [`crate::detect::light`] |
//! | var_in, var_out | `variance` | 2 | grey^2 | noise on either side; in between it follows P (shot noise rises with level) |
//!
//! One solve finds `(q, s, light)` together from the sums of the sectors ([`crate::detect::sectors`]): Gauss-Newton in `q` and `s`,
//! exact in the light. The light comes first in the elimination, so the Schur complement on the geometry and with it the price of not
//! knowing blur and light are at hand.
//!
//! The step `E = L_in - L_out` that turns a shift of the edge into grey levels is that of the light as solved before. Where the light is free at each
//! node, the noise that makes a stretch seem brighter also moves its edge: weighing it by its own step favours the brighter and draws all contours
//! outwards (test `bright_smoke_draws_no_contour_outwards`). So there sector `k` takes the mean of `L_in - L_out` over the sectors `k - 24 .. k + 24`, of
//! short contours over all. The sums stay without bias for any `E` that does not know of their errors; of the information remains
//! `<E>^2 / <E^2>`, for `E` that scatters by a fifth 0.96.
//!
//! A small disc cannot tell its size from blur; a prior holds what the data leave open: blur within 0.15 of the value given, or of a pixel.
//!
//! Not valid where the radius of curvature is not well above the blur, or where another edge lies within the band.

use crate::conic::{Ellipse, from_regular, to_regular};
use crate::detect::contour::Contour;
use crate::detect::dense::{Dense, FIXED};
use crate::detect::light::{Light, NodePrior, Side};
use crate::detect::sectors::{LOCAL, Sectors};
use nalgebra::{SMatrix, SVector};

/// Standard deviation of the prior of the blur, of the blur or of a pixel, the larger one: that of a disc of 4 px, in smoke, beside what the line that was
/// followed shows; larger ones show it to a twentieth.
const PRIOR_BLUR: f64 = 0.15;
/// Half the standard deviation of the area of a pixel, px.
pub(crate) const LEAST_BLUR_PX: f64 = 0.15;
/// Sectors either side over which the step is averaged where the light follows nodes; of short contours all around.
const STEP_OVER: usize = 24;
/// Most unknowns of a surface: two sides.
const MOST: usize = 2 * Side::MOST + FIXED;
/// Unknowns of the light at one node: level, slope and bend on either side.
const NODE: usize = LOCAL - 2;
/// Blur and geometry and the node where the chain closes.
const BORDER: usize = FIXED + NODE;

/// Weight of the prior of the blur, 1/px^2.
pub(crate) fn blur_weight(expected_px: f64) -> f64 {
    (PRIOR_BLUR * expected_px.max(1.0)).powi(-2)
}

/// State of the model of one disc.
#[derive(Debug, Clone)]
pub(crate) struct EdgeModel {
    pub(crate) ellipse: Ellipse,
    pub(crate) blur_px: f64,
    /// Blur expected before seeing this disc, px.
    pub(crate) expected_blur_px: f64,
    pub(crate) light: Light,
    /// Noise variance inside and outside, grey^2.
    pub(crate) variance: [f64; 2],
    /// Third derivative of the light, which the model does not follow, see [`Light::bends`].
    pub(crate) bends: [f64; 2],
    /// Inside minus outside, typical, grey.
    pub(crate) step: f64,
}

/// What one solve found, per sector and in total; reused.
#[derive(Debug, Default)]
pub(crate) struct Solution {
    /// Change of the geometry in regular coordinates, px.
    pub(crate) change: [f64; 5],
    pub(crate) blur_change_px: f64,
    /// Outward shift of each sector's edge that the change means, px.
    pub(crate) shift: Vec<f64>,
    /// Light of either side on each sector of the contour, and its slope along the normal.
    pub(crate) level: [Vec<f64>; 2],
    pub(crate) slope: [Vec<f64>; 2],
    /// Second derivative along the normal.
    pub(crate) bend: [Vec<f64>; 2],
    /// Step of each sector, grey.
    pub(crate) step: Vec<f64>,
    dense: Dense,
    chain: Chain,
}

impl EdgeModel {
    /// The model moved by what a solve found, each coordinate by at most `limit_px`; none where that is no ellipse.
    pub(crate) fn moved(&self, found: &Solution, limit_px: f64) -> Option<Self> {
        let largest = found.change.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        let factor = (limit_px / largest).min(1.0);
        let mut q = to_regular(&self.ellipse);
        for i in 0..5 {
            q[i] += factor * found.change[i];
        }
        let change = found.blur_change_px.clamp(-0.4 * self.blur_px, 0.8 * self.blur_px);
        // Noise may ask a faint small dot for no blur at all; pixels have an area.
        let blur_px = (self.blur_px + change).max(LEAST_BLUR_PX);
        if !(blur_px < 30.0) {
            return None;
        }
        Some(Self { ellipse: from_regular(&q)?, blur_px, ..self.clone() })
    }

    /// Finds geometry, blur and light together; false where the sums do not fix them.
    pub(crate) fn solve(&self, contour: &Contour, sectors: &Sectors, found: &mut Solution) -> bool {
        let solved = match &self.light {
            Light::Surface(sides) => self.solve_surface(sides, contour, sectors, found),
            Light::Nodes(n, priors) => self.solve_nodes(*n, priors, contour, sectors, found),
        };
        if !solved {
            return false;
        }
        found.shift.clear();
        found.step.clear();
        for k in 0..contour.len() {
            found.shift.push(-(0..5).map(|i| contour.row[k][i] * found.change[i]).sum::<f64>());
            found.step.push(found.level[0][k] - found.level[1][k]);
        }
        if matches!(self.light, Light::Nodes(..)) {
            average_around(&mut found.step, STEP_OVER);
        }
        true
    }

    /// Normal matrix and right side of blur and geometry alone, from the local sums of a sector.
    fn fixed_part(
        row: &[f64; 5],
        normal: &SMatrix<f64, LOCAL, LOCAL>,
        right: &SVector<f64, LOCAL>,
    ) -> (SMatrix<f64, FIXED, FIXED>, SVector<f64, FIXED>) {
        let matrix = SMatrix::from_fn(|a, b| match (a, b) {
            (0, 0) => normal[(1, 1)],
            (0, j) | (j, 0) => -row[j - 1] * normal[(0, 1)],
            (i, j) => row[i - 1] * row[j - 1] * normal[(0, 0)],
        });
        (matrix, SVector::from_fn(|a, _| if a == 0 { right[1] } else { -row[a - 1] * right[0] }))
    }

    fn blur_prior(&self) -> (f64, f64) {
        let weight = blur_weight(self.expected_blur_px);
        (weight, weight * (self.expected_blur_px - self.blur_px))
    }

    fn solve_surface(&self, sides: &[Side; 2], contour: &Contour, sectors: &Sectors, found: &mut Solution) -> bool {
        let count = [sides[0].count(), sides[1].count()];
        let lights = count[0] + count[1];
        let n = lights + FIXED;
        let work = &mut found.dense;
        work.clear(n);
        let mut mixed = [[0.0; MOST]; 6];
        for k in (0..contour.len()).filter(|k| sectors.keep[*k]) {
            let (normal, right) = sectors.local(k, found.step[k]);
            let (value, climb) = Side::basis(contour, k);
            // A column of the light is P value + P d climb.
            let column = |j: usize| {
                let (side, m) = if j < count[0] { (0, j) } else { (1, j - count[0]) };
                (2 + side, value[m], 4 + side, climb[m])
            };
            for j in 0..lights {
                let (a, x, b, y) = column(j);
                for (l, line) in mixed.iter_mut().enumerate() {
                    line[j] = normal[(l, a)] * x + normal[(l, b)] * y;
                }
            }
            for i in 0..lights {
                let (a, x, b, y) = column(i);
                for j in 0..=i {
                    work.matrix[i * n + j] += x * mixed[a][j] + y * mixed[b][j];
                }
                work.right[i] += x * right[a] + y * right[b];
            }
            for j in 0..lights {
                work.matrix[lights * n + j] += mixed[1][j];
                for i in 0..5 {
                    work.matrix[(lights + 1 + i) * n + j] -= contour.row[k][i] * mixed[0][j];
                }
            }
            let (fixed, right) = Self::fixed_part(&contour.row[k], &normal, &right);
            work.add_last(n, &fixed, &right);
        }
        let mut at = 0;
        for side in sides {
            for (m, sigma) in side.prior_sigmas().into_iter().enumerate().take(side.count()) {
                work.matrix[(at + m) * n + at + m] += sigma.powi(-2);
            }
            at += side.count();
        }
        let (weight, pull) = self.blur_prior();
        work.matrix[lights * n + lights] += weight;
        work.right[lights] += pull;
        if !work.solve(n) {
            return false;
        }
        found.take_fixed(lights);
        for side in 0..2 {
            let c = &found.dense.right[if side == 0 { 0 } else { count[0] }..][..count[side]];
            let (level, slope) = (&mut found.level[side], &mut found.slope[side]);
            level.clear();
            slope.clear();
            found.bend[side].clear();
            found.bend[side].resize(contour.len(), 0.0);
            for k in 0..contour.len() {
                let (value, climb) = Side::basis(contour, k);
                level.push(c.iter().zip(&value).map(|(c, v)| c * v).sum());
                slope.push(c.iter().zip(&climb).map(|(c, v)| c * v).sum());
            }
        }
        true
    }

    fn solve_nodes(
        &self,
        nodes: usize,
        priors: &[NodePrior; 2],
        contour: &Contour,
        sectors: &Sectors,
        found: &mut Solution,
    ) -> bool {
        let chain = &mut found.chain;
        chain.clear(nodes);
        found.dense.clear(BORDER);
        let count = contour.len();
        for k in (0..count).filter(|k| sectors.keep[*k]) {
            let (normal, mut right) = sectors.local(k, found.step[k]);
            let [inner, outer] = [0, 1].map(|side| priors[side].surface(contour, k));
            let about = [0.0, 0.0, inner[0], outer[0], inner[1], outer[1], inner[2], outer[2]];
            right -= normal * SVector::from(about);
            let (fixed, fixed_right) = Self::fixed_part(&contour.row[k], &normal, &right);
            found.dense.add_last(BORDER, &fixed, &fixed_right);
            let light: AtNode = normal.fixed_view::<NODE, NODE>(2, 2).into_owned();
            let light_right: SVector<f64, NODE> = right.fixed_rows::<NODE>(2).into_owned();
            let cross = SMatrix::<f64, NODE, FIXED>::from_fn(|a, b| match b {
                0 => normal[(2 + a, 1)],
                j => -contour.row[k][j - 1] * normal[(2 + a, 0)],
            });
            let (i, j, f) = place_between(k, count, nodes);
            for (node, w) in [(i, 1.0 - f), (j, f)] {
                chain.own[node] += light * (w * w);
                chain.right[node] += light_right * w;
                let mut border = chain.border[node].fixed_view_mut::<NODE, FIXED>(0, NODE);
                border += cross * w;
            }
            chain.couple(i, j, &(light * (f * (1.0 - f))));
        }
        for i in 0..nodes {
            let j = if i + 1 == nodes { 0 } else { i + 1 };
            let mut weights = SVector::<f64, NODE>::zeros();
            for (side, p) in priors.iter().enumerate() {
                let p = p.at(contour, i, nodes);
                for order in 0..3 {
                    let at = 2 * order + side;
                    chain.own[i][(at, at)] += p.own[order];
                    weights[at] = p.tie[order];
                }
            }
            let tie = AtNode::from_diagonal(&weights);
            chain.own[i] += tie;
            chain.own[j] += tie;
            chain.couple(i, j, &-tie);
        }
        let (weight, pull) = self.blur_prior();
        found.dense.matrix[NODE * BORDER + NODE] += weight;
        found.dense.right[NODE] += pull;
        if !found.chain.eliminate(&mut found.dense) || !found.dense.solve(BORDER) {
            return false;
        }
        found.take_fixed(NODE);
        found.chain.substitute(&found.dense.right);
        for side in 0..2 {
            let lists = [&mut found.level[side], &mut found.slope[side], &mut found.bend[side]];
            for (order, list) in lists.into_iter().enumerate() {
                list.clear();
                for k in 0..count {
                    let (i, j, f) = place_between(k, count, nodes);
                    let at = 2 * order + side;
                    let x = found.chain.right[i][at] * (1.0 - f) + found.chain.right[j][at] * f;
                    list.push(x + priors[side].surface(contour, k)[order]);
                }
            }
        }
        true
    }
}

impl Solution {
    /// Covariance of the regular coordinates of the geometry, blur and light unknown.
    pub(crate) fn covariance(&self) -> &SMatrix<f64, 5, 5> {
        &self.dense.covariance
    }

    fn take_fixed(&mut self, blur_at: usize) {
        self.blur_change_px = self.dense.right[blur_at];
        self.change.copy_from_slice(&self.dense.right[blur_at + 1..blur_at + FIXED]);
    }

    /// The local numbers of a sector as solved.
    pub(crate) fn local(&self, k: usize) -> SVector<f64, LOCAL> {
        let (level, slope, bend) = (&self.level, &self.slope, &self.bend);
        let light = [level, slope, bend].map(|x| [x[0][k], x[1][k]]);
        SVector::from_fn(|a, _| match a {
            0 => self.shift[k],
            1 => self.blur_change_px,
            _ => light[a / 2 - 1][a % 2],
        })
    }
}

/// The mean over `reach` places either side of each of a closed chain.
fn average_around(values: &mut [f64], reach: usize) {
    let n = values.len();
    if n == 0 {
        return;
    }
    let reach = reach.min((n - 1) / 2);
    let raw = values.to_vec();
    let mut sum: f64 = (0..=2 * reach).map(|i| raw[(n + i - reach) % n]).sum();
    for (k, value) in values.iter_mut().enumerate() {
        *value = sum / (2 * reach + 1) as f64;
        sum += raw[(k + reach + 1) % n] - raw[(k + n - reach) % n];
    }
}

/// The nodes on either side of the middle of a sector, and the share of the way to the second.
fn place_between(k: usize, count: usize, nodes: usize) -> (usize, usize, f64) {
    let x = (k as f64 + 0.5) / count as f64 * nodes as f64;
    let i = (x as usize).min(nodes - 1);
    (i, if i + 1 == nodes { 0 } else { i + 1 }, x - i as f64)
}

/// Products of the unknowns at a node.
type AtNode = SMatrix<f64, NODE, NODE>;

/// Light at nodes around the contour: a closed chain of blocks, cut at node 0, which joins the border.
#[derive(Debug, Default)]
struct Chain {
    own: Vec<AtNode>,
    /// Coupling of a node with the next.
    next: Vec<AtNode>,
    /// Coupling of a node with node 0, blur and geometry.
    border: Vec<SMatrix<f64, NODE, BORDER>>,
    right: Vec<SVector<f64, NODE>>,
}

impl Chain {
    fn clear(&mut self, nodes: usize) {
        self.own.clear();
        self.own.resize(nodes, AtNode::zeros());
        self.next.clear();
        self.next.resize(nodes, AtNode::zeros());
        self.border.clear();
        self.border.resize(nodes, SMatrix::zeros());
        self.right.clear();
        self.right.resize(nodes, SVector::zeros());
    }

    /// Adds a symmetric coupling of a node with the next.
    fn couple(&mut self, i: usize, j: usize, block: &AtNode) {
        if i == 0 || j == 0 {
            let mut border = self.border[i.max(j)].fixed_view_mut::<NODE, NODE>(0, 0);
            border += block;
        } else {
            self.next[i] += block;
        }
    }

    /// Eliminates all nodes but node 0 and leaves the rest in the dense equations.
    fn eliminate(&mut self, dense: &mut Dense) -> bool {
        let nodes = self.own.len();
        let mut rest = SMatrix::<f64, BORDER, BORDER>::zeros();
        let mut rest_right = SVector::<f64, BORDER>::zeros();
        let mut head = rest.fixed_view_mut::<NODE, NODE>(0, 0);
        head += self.own[0];
        for i in 0..FIXED {
            for j in 0..NODE {
                rest[(NODE + i, j)] += self.border[0][(j, NODE + i)];
            }
        }
        let mut head = rest_right.fixed_rows_mut::<NODE>(0);
        head += self.right[0];
        for i in 1..nodes {
            let Some(factor) = self.own[i].cholesky() else { return false };
            let (border, next) = (self.border[i], self.next[i]);
            let (along, across) = (factor.solve(&next), factor.solve(&border));
            let own = factor.solve(&self.right[i]);
            if i + 1 < nodes {
                self.own[i + 1] -= next.transpose() * along;
                self.border[i + 1] -= next.transpose() * across;
                self.right[i + 1] -= next.transpose() * own;
            }
            rest -= border.transpose() * across;
            rest_right -= border.transpose() * own;
            (self.next[i], self.border[i], self.right[i]) = (along, across, own);
        }
        for i in 0..BORDER {
            for j in 0..=i {
                dense.matrix[i * BORDER + j] += rest[(i, j)];
            }
            dense.right[i] += rest_right[i];
        }
        true
    }

    /// Values at the nodes, from those of the border.
    fn substitute(&mut self, border: &[f64]) {
        let x = SVector::<f64, BORDER>::from_column_slice(&border[..BORDER]);
        let nodes = self.own.len();
        self.right[0] = x.fixed_rows::<NODE>(0).into_owned();
        for i in (1..nodes).rev() {
            let mut value = self.right[i] - self.border[i] * x;
            if i + 1 < nodes {
                value -= self.next[i] * self.right[i + 1];
            }
            self.right[i] = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_around_a_closed_chain_are_those_taken_one_by_one() {
        for (n, reach) in [(41_usize, 5_usize), (41, 24), (6, 24), (1, 3)] {
            let values: Vec<f64> = (0..n).map(|k| (k as f64 * 1.7).sin() + 0.1 * k as f64).collect();
            let mut found = values.clone();
            average_around(&mut found, reach);
            average_around(&mut [], reach);
            let reach = reach.min((n - 1) / 2);
            for k in 0..n {
                let around = (0..=2 * reach).map(|i| values[(k + n + i - reach) % n]);
                let mean = around.sum::<f64>() / (2 * reach + 1) as f64;
                assert!((found[k] - mean).abs() < 1e-13, "{n} {reach} {k}: {} and {mean}", found[k]);
            }
        }
    }
}
