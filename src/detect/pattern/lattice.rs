//! A square lattice of dots: seeds, growth by local prediction, and removal of what the neighbours do not predict.

use super::dots::{Dots, median};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use std::collections::BTreeMap;

/// A cell of the lattice.
pub(super) type Cell = (i32, i32);

/// How far a neighbour may be from its place around a seed, in pitches of the rounded plane.
const SEED_TOLERANCE: f64 = 0.22;
/// How far a dot may be from the prediction when the lattice grows, in pitches.
const GROWTH_TOLERANCE: f64 = 0.2;
/// The same once the lattice says how well it predicts: robust sigmas, and never less than this many pitches.
const GROWTH_SIGMAS: f64 = 15.0;
const GROWTH_LEAST: f64 = 0.07;
/// Cells that the neighbourhood predicts with a larger spread (in sigmas of a dot) are not filled: any blob would do.
const MOST_SPREAD: f64 = 2.5;
/// A dot of the finished lattice is off if it misses its neighbours' prediction by more robust sigmas than this ...
const OFF_SIGMAS: f64 = 6.0;
/// ... but never if by less than the first, always if by more than the second, in pitches.
const OFF_LIMITS: (f64, f64) = (0.006, 0.15);
/// Largest robust miss of a lattice of real dots, in pitches; chance alignments of blobs miss by about 0.1.
const CHANCE_MISS: f64 = 0.05;
/// A dot's semi-axes with the foreshortening taken out, over the typical dot's: outside of this it is no dot of the lattice.
const ALIKE: (f64, f64) = (0.65, 1.5);
/// The same for its radius where it may be a large mark.
const MARK_SIZE: (f64, f64) = (0.65, 4.0);
/// Seeds tried before the largest lattice is taken.
const SEEDS: usize = 16;

/// What lies between the dots of the lattice that is looked for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Between {
    /// Nothing: a plain grid.
    Nothing,
    /// One dot of another lattice in every cell: a two-level plate.
    OneDot,
}

/// Dots in the cells of a lattice; cell axis j is left of cell axis i for the viewer.
#[derive(Clone, Default)]
pub(super) struct Lattice {
    pub(super) nodes: BTreeMap<Cell, usize>,
}

/// Where a cell should be.
pub(super) struct Prediction {
    pub(super) at: Vector2<f64>,
    /// Columns: one step in i, one in j, px.
    pub(super) basis: Matrix2<f64>,
    /// Standard deviation of `at` in units of that of a dot.
    spread: f64,
}

struct Seed {
    score: i32,
    length: f64,
    nodes: BTreeMap<Cell, usize>,
}

/// The largest square lattice among the dots that are `free`, where there is one that is not chance.
pub(super) fn find(dots: &Dots, free: &[bool], between: Between) -> Option<Lattice> {
    let mut seeds: Vec<Seed> = (0..dots.len())
        .filter(|i| free[*i] && looks_like_a_dot(dots, *i))
        .filter_map(|i| seed_at(dots, free, i, between))
        .collect();
    seeds.sort_by(|a, b| b.score.cmp(&a.score).then(a.length.total_cmp(&b.length)));
    let total = free.iter().filter(|f| **f).count();
    let enough = if between == Between::OneDot { total / 3 } else { total * 2 / 3 };
    let mut best: Option<Lattice> = None;
    for seed in seeds.into_iter().take(SEEDS) {
        let lattice = grown(dots, free, Lattice { nodes: seed.nodes });
        if !lattice.is_credible(dots, total) {
            continue;
        }
        if best.as_ref().is_none_or(|b| lattice.nodes.len() > b.nodes.len()) {
            best = Some(lattice);
        }
        if best.as_ref().is_some_and(|b| b.nodes.len() > enough) {
            break;
        }
    }
    best
}

/// The lattice grown from given nodes, dots that do not fit removed.
pub(super) fn grown(dots: &Dots, free: &[bool], mut lattice: Lattice) -> Lattice {
    // Where the growth slipped onto another lattice, the dots along the slip are off and go first; what they held
    // together falls apart, and the larger part grows again, now with a tolerance that it knows.
    for _ in 0..2 {
        lattice.grow(dots, free);
        lattice.drop_off_dots(dots);
        lattice.keep_largest_part();
    }
    lattice.grow(dots, free);
    lattice.drop_off_dots(dots);
    lattice
}

/// The best way to see dot `i` as the middle of a square of dots.
fn seed_at(dots: &Dots, free: &[bool], i: usize, between: Between) -> Option<Seed> {
    let around: Vec<(usize, Vector2<f64>)> = {
        let mut near: Vec<_> = dots
            .nearest(&dots.at[i], 48)
            .into_iter()
            .filter(|k| *k != i && free[*k] && looks_like_a_dot(dots, *k))
            .map(|k| (k, dots.round[i] * (dots.at[k] - dots.at[i])))
            .collect();
        near.sort_by(|a, b| a.1.norm().total_cmp(&b.1.norm()).then(a.0.cmp(&b.0)));
        near.truncate(26);
        near
    };
    let tried = if between == Between::OneDot { 12 } else { 8 };
    let mut best: Option<Seed> = None;
    for (_, a) in around.iter().take(tried) {
        let seed = seed_with_step(i, a, &around, between);
        if seed.nodes.len() >= 4 && best.as_ref().is_none_or(|b| (seed.score, -seed.length) > (b.score, -b.length)) {
            best = Some(seed);
        }
    }
    best
}

/// Counts what speaks for and against the lattice with the rounded step `a`: eight neighbours, and what lies between.
fn seed_with_step(i: usize, a: &Vector2<f64>, around: &[(usize, Vector2<f64>)], between: Between) -> Seed {
    let square = a.norm_squared();
    // v runs down: this turn brings axis i to the left for the viewer.
    let b = Vector2::new(a.y, -a.x);
    let mut slots: BTreeMap<Cell, (f64, usize)> = BTreeMap::new();
    let mut strays: Vec<Vector2<f64>> = Vec::new();
    for (k, d) in around {
        let x = Vector2::new(d.dot(a), d.dot(&b)) / square;
        let cell = (x.x.round() as i32, x.y.round() as i32);
        let off = (x - Vector2::new(f64::from(cell.0), f64::from(cell.1))).norm();
        let near = cell.0.abs() <= 1 && cell.1.abs() <= 1;
        if near && cell != (0, 0) && off < SEED_TOLERANCE {
            let slot = slots.entry(cell).or_insert((off, *k));
            if off < slot.0 {
                *slot = (off, *k);
            }
        } else if x.x.abs() < 1.0 - SEED_TOLERANCE && x.y.abs() < 1.0 - SEED_TOLERANCE {
            strays.push(x);
        }
    }
    let matched = slots.len() as i32;
    let score = match between {
        Between::Nothing => matched - strays.len() as i32,
        Between::OneDot => matched + between_score(&strays),
    };
    let mut nodes: BTreeMap<Cell, usize> = slots.into_iter().map(|(cell, (_, k))| (cell, k)).collect();
    nodes.insert((0, 0), i);
    Seed { score, length: square.sqrt(), nodes }
}

/// Strays at one and the same place of their cells speak for a second lattice, others against it.
fn between_score(strays: &[Vector2<f64>]) -> i32 {
    let place = |x: &Vector2<f64>| Vector2::new(x.x - x.x.floor(), x.y - x.y.floor());
    let agree = |p: &Vector2<f64>| strays.iter().filter(|q| (place(q) - p).norm() < SEED_TOLERANCE).count() as i32;
    let best = strays.iter().map(|p| agree(&place(p))).max().unwrap_or(0);
    let against = strays.len() as i32 - best;
    if best < 2 { -9 } else { best.min(4) - (best - 4).max(0) - 2 * against }
}

impl Lattice {
    /// The cell `cell` as its labelled neighbourhood (without itself) predicts it.
    pub(super) fn predict(&self, dots: &Dots, cell: Cell) -> Option<Prediction> {
        let point = |(c, k): (&Cell, &usize)| {
            let step = Vector2::new(f64::from(c.0 - cell.0), f64::from(c.1 - cell.1));
            (step, dots.at[*k])
        };
        fitted(&self.around(cell, self.reach(cell)).map(point).collect::<Vec<_>>())
    }

    /// The nodes within so many cells of one, without itself.
    fn around(&self, cell: Cell, reach: i32) -> impl Iterator<Item = (&Cell, &usize)> {
        let column = move |i: i32| self.nodes.range((i, cell.1 - reach)..=(i, cell.1 + reach));
        (cell.0 - reach..=cell.0 + reach).flat_map(column).filter(move |(c, _)| **c != cell)
    }

    /// How far the neighbourhood of a cell goes that predicts it.
    fn reach(&self, cell: Cell) -> i32 {
        if self.around(cell, 2).count() < 12 { 3 } else { 2 }
    }

    /// Cells next to the lattice (up to two steps: one dot may be missing) that hold no dot.
    fn frontier(&self) -> Vec<(Cell, i32)> {
        let mut cells: BTreeMap<Cell, i32> = BTreeMap::new();
        for (i, j) in self.nodes.keys() {
            for di in -2..=2_i32 {
                for dj in -2..=2_i32 {
                    let cell = (i + di, j + dj);
                    if !self.nodes.contains_key(&cell) {
                        let steps = cells.entry(cell).or_insert(i32::MAX);
                        *steps = (*steps).min(di.abs().max(dj.abs()));
                    }
                }
            }
        }
        cells.into_iter().collect()
    }

    fn grow(&mut self, dots: &Dots, free: &[bool]) {
        let mut taken: Vec<bool> = free.iter().map(|f| !f).collect();
        self.nodes.values().for_each(|k| taken[*k] = true);
        let (mut tolerance, mut measured_at) = (GROWTH_TOLERANCE, 0);
        loop {
            // Once there are enough dots they say how well they can be predicted: a loose tolerance would let the
            // lattice drift over to the dots of another level.
            if self.nodes.len() >= 12 && 2 * self.nodes.len() >= 3 * measured_at {
                measured_at = self.nodes.len();
                let sigma = median(self.misses(dots).into_values().collect()) / 1.18;
                tolerance = (GROWTH_SIGMAS * sigma).clamp(GROWTH_LEAST, GROWTH_TOLERANCE);
            }
            // The best cell for each dot, so that the result does not depend on the order of the cells.
            let mut claims: BTreeMap<usize, (f64, Cell)> = BTreeMap::new();
            for (cell, steps) in self.frontier() {
                let Some(p) = self.predict(dots, cell) else { continue };
                let limit = if steps == 1 { tolerance } else { 0.7 * tolerance };
                if p.spread > MOST_SPREAD {
                    continue;
                }
                if let Some((k, off)) = self.nearest_free(dots, &taken, &p, limit) {
                    let claim = claims.entry(k).or_insert((off, cell));
                    if off < claim.0 {
                        *claim = (off, cell);
                    }
                }
            }
            if claims.is_empty() {
                return;
            }
            for (k, (_, cell)) in claims {
                if let std::collections::btree_map::Entry::Vacant(e) = self.nodes.entry(cell) {
                    e.insert(k);
                    taken[k] = true;
                }
            }
        }
    }

    /// The free dot nearest to the prediction, within `limit` pitches.
    fn nearest_free(&self, dots: &Dots, taken: &[bool], p: &Prediction, limit: f64) -> Option<(usize, f64)> {
        let inverse = p.basis.try_inverse()?;
        let reach = limit * (p.basis.column(0).norm() + p.basis.column(1).norm());
        dots.within(&p.at, reach)
            .into_iter()
            .filter(|k| !taken[*k] && looks_like_a_dot(dots, *k))
            .map(|k| (k, (inverse * (dots.at[k] - p.at)).norm()))
            .filter(|(_, off)| *off < limit)
            .min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)))
    }

    /// Miss of every dot against its neighbours' prediction, pitches, divided by the spread of the prediction.
    fn misses(&self, dots: &Dots) -> BTreeMap<Cell, f64> {
        let miss = |cell: &Cell, k: &usize| {
            let p = self.predict(dots, *cell)?;
            let inverse = p.basis.try_inverse()?;
            Some((inverse * (dots.at[*k] - p.at)).norm() / (1.0 + p.spread * p.spread).sqrt())
        };
        self.nodes.iter().filter_map(|(c, k)| miss(c, k).map(|m| (*c, m))).collect()
    }

    /// Removes dots that are off, the worst of each neighbourhood first: it spoils the prediction of the others.
    fn drop_off_dots(&mut self, dots: &Dots) {
        for _ in 0..20 {
            let misses = self.misses(dots);
            let sigma = median(misses.values().copied().collect()) / 1.18;
            let limit = (OFF_SIGMAS * sigma).clamp(OFF_LIMITS.0, OFF_LIMITS.1);
            let worst_around = |cell: &Cell| {
                let around = self.around(*cell, self.reach(*cell));
                around.filter_map(|(c, _)| misses.get(c)).copied().fold(0.0, f64::max)
            };
            let off: Vec<Cell> =
                misses.iter().filter(|(c, m)| **m > limit && **m >= worst_around(c)).map(|(c, _)| *c).collect();
            if off.is_empty() {
                break;
            }
            off.iter().for_each(|c| {
                self.nodes.remove(c);
            });
        }
        // What nothing around it predicts is not known to belong.
        let known = self.misses(dots);
        self.nodes.retain(|c, _| known.contains_key(c));
    }

    /// Keeps the largest set of cells that are joined side by side.
    fn keep_largest_part(&mut self) {
        let mut part: BTreeMap<Cell, usize> = BTreeMap::new();
        let mut sizes: Vec<usize> = Vec::new();
        for start in self.nodes.keys() {
            if part.contains_key(start) {
                continue;
            }
            let mut open = vec![*start];
            part.insert(*start, sizes.len());
            let mut size = 0;
            while let Some((i, j)) = open.pop() {
                size += 1;
                for next in [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)] {
                    if self.nodes.contains_key(&next) && !part.contains_key(&next) {
                        part.insert(next, sizes.len());
                        open.push(next);
                    }
                }
            }
            sizes.push(size);
        }
        let largest = (0..sizes.len()).rev().max_by_key(|k| sizes[*k]);
        self.nodes.retain(|cell, _| part.get(cell).copied() == largest);
    }

    /// Whether this is more than a few blobs in line by chance among `total`.
    pub(super) fn is_credible(&self, dots: &Dots, total: usize) -> bool {
        let count = self.nodes.len();
        let enough = if total <= 12 { 4 } else { (total / 4).clamp(6, 30) };
        count >= enough && median(self.misses(dots).into_values().collect()) < CHANCE_MISS && self.is_square(dots)
    }

    /// Whether the steps are of equal length and at right angles once the foreshortening is taken out.
    fn is_square(&self, dots: &Dots) -> bool {
        let (mut ratio, mut cosine) = (Vec::new(), Vec::new());
        for (cell, k) in &self.nodes {
            if let Some(p) = self.predict(dots, *cell) {
                let s = dots.round[*k] * p.basis;
                let (a, b) = (s.column(0).norm(), s.column(1).norm());
                ratio.push(a / b);
                cosine.push(s.column(0).dot(&s.column(1)) / (a * b));
            }
        }
        let (r, c) = (median(ratio), median(cosine));
        r > 0.65 && r < 1.5 && c.abs() < 0.4
    }

    /// Coordinates of an image point on the lattice, right near its dots.
    pub(super) fn locate(&self, dots: &Dots, p: &Vector2<f64>) -> Option<Vector2<f64>> {
        let (cell, k) = self
            .nodes
            .iter()
            .min_by(|a, b| (dots.at[*a.1] - p).norm().total_cmp(&(dots.at[*b.1] - p).norm()).then(a.0.cmp(b.0)))?;
        let basis = self.predict(dots, *cell)?.basis;
        let step = basis.try_inverse()? * (p - dots.at[*k]);
        Some(Vector2::new(f64::from(cell.0), f64::from(cell.1)) + step)
    }

    /// Smallest and largest cell along both axes.
    pub(super) fn extent(&self) -> (Cell, Cell) {
        self.nodes.keys().fold(((i32::MAX, i32::MAX), (i32::MIN, i32::MIN)), |(l, h), c| {
            ((l.0.min(c.0), l.1.min(c.1)), (h.0.max(c.0), h.1.max(c.1)))
        })
    }

    /// Centroid of the dots, px.
    pub(super) fn center(&self, dots: &Dots) -> Vector2<f64> {
        let sum: Vector2<f64> = self.nodes.values().map(|k| dots.at[*k]).sum();
        sum / self.nodes.len().max(1) as f64
    }

    /// How far up in the image (against v) one quarter-turned step of axis j points, cosine, over the whole lattice.
    pub(super) fn upness(&self, dots: &Dots, quarter_turns: u8) -> f64 {
        // Target y is axis j after the turn; before it, it was this direction of the lattice.
        let (i, j) = super::turned(4 - quarter_turns % 4, (0, 1));
        let mut sum = Vector2::zeros();
        for cell in self.nodes.keys() {
            if let Some(p) = self.predict(dots, *cell) {
                sum += p.basis * Vector2::new(f64::from(i), f64::from(j));
            }
        }
        if sum.norm() > 0.0 { -sum.y / sum.norm() } else { 0.0 }
    }
}

/// Whether a disc has the size and shape of the dots around it, or at least the shape of one larger one.
fn looks_like_a_dot(dots: &Dots, k: usize) -> bool {
    let e = (dots.round[k] * dots.shape[k] * dots.round[k]).symmetric_eigenvalues().map(|x| x.max(0.0).sqrt());
    let (large, small) = (e.max(), e.min());
    let alike = |x: f64| x > ALIKE.0 && x < ALIKE.1;
    (alike(large) && alike(small)) || (small > MARK_SIZE.0 && large < MARK_SIZE.1 && large < ALIKE.1 * small)
}

/// Prediction of step (0, 0) from dots at other steps: projective where they allow it, else affine.
fn fitted(points: &[(Vector2<f64>, Vector2<f64>)]) -> Option<Prediction> {
    if points.len() < 3 {
        return None;
    }
    let distinct = |axis: usize| {
        let mut v: Vec<i32> = points.iter().map(|(s, _)| s[axis] as i32).collect();
        v.sort_unstable();
        v.dedup();
        v.len()
    };
    let projective = points.len() >= 10 && distinct(0) >= 3 && distinct(1) >= 3;
    let unknowns = if projective { 8 } else { 6 };
    let origin = points[0].1;
    let mut a = DMatrix::<f64>::zeros(2 * points.len(), unknowns);
    let mut y = DVector::<f64>::zeros(2 * points.len());
    // Pixels scaled to about one pitch, so that all unknowns are of one size.
    let scale = points.iter().map(|(_, x)| (x - origin).norm()).fold(0.0, f64::max) / 3.0;
    if scale.is_nan() || scale <= 0.0 {
        return None;
    }
    for (r, (step, x)) in points.iter().enumerate() {
        let x = (x - origin) / scale;
        for axis in 0..2 {
            let row = 2 * r + axis;
            a[(row, 3 * axis)] = step.x;
            a[(row, 3 * axis + 1)] = step.y;
            a[(row, 3 * axis + 2)] = 1.0;
            if projective {
                a[(row, 6)] = -step.x * x[axis];
                a[(row, 7)] = -step.y * x[axis];
            }
            y[row] = x[axis];
        }
    }
    let normal = a.transpose() * &a;
    let inverse = normal.cholesky()?.inverse();
    let spread = inverse[(2, 2)].max(inverse[(5, 5)]).sqrt();
    let p = &inverse * (a.transpose() * y);
    if !p.iter().all(|x| x.is_finite()) || !(spread < 1e3) {
        return None;
    }
    let (c, g) = (Vector2::new(p[2], p[5]), if projective { Vector2::new(p[6], p[7]) } else { Vector2::zeros() });
    let basis = Matrix2::new(p[0], p[1], p[3], p[4]) - c * g.transpose();
    Some(Prediction { at: origin + c * scale, basis: basis * scale, spread })
}
