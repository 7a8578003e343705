//! Rows of edge points as they are collected, whitened, weighted and multiplied out; see [`super`].

use super::feet::{LaneCircle, dot, feet, feet_from, filled, padded};
use super::{COLLECTED, COLUMNS, Columns, Scratch};
use crate::bundle::assemble::{SPACE, SeenImage};
use crate::bundle::contour::SeenCircle;
use crate::bundle::model::{DiscObservation, Loss};
use crate::bundle::tie::Tie;
use crate::camera::{INTRINSICS, LaneCamera};
use crate::lanes::{self, GROUP, Lanes, splats};
use nalgebra::Vector3;
use std::ops::Range;

/// Columns of a tile.
const TILE: usize = 4;

/// Rows under way.
pub(in crate::bundle) struct Rows<'a> {
    pub(super) scratch: &'a mut Scratch,
    /// Columns of a group, with residuals and what is added for the tiles.
    width: usize,
    /// Columns that are multiplied out.
    used: usize,
    /// Points collected.
    pub(in crate::bundle) len: usize,
}

impl<'a> Rows<'a> {
    /// Columns that are not multiplied out.
    #[inline(always)]
    pub(in crate::bundle) fn new(scratch: &'a mut Scratch, width: usize) -> Self {
        scratch.width = width;
        Self { scratch, width, used: width, len: 0 }
    }

    /// Columns for products, whose running sums begin at zero. Tiles may read past the columns in use, but nothing becomes of it. An odd number:
    /// groups that lie a power of two apart take each other's lines of the cache.
    #[inline(always)]
    pub(in crate::bundle) fn for_products(scratch: &'a mut Scratch, used: usize) -> Self {
        let mut out = Self::new(scratch, used.next_multiple_of(TILE) + 1);
        out.used = used;
        out.clear();
        out
    }

    /// Room for another contour; returns where it begins.
    #[inline(always)]
    pub(in crate::bundle) fn grow(&mut self, points: usize) -> usize {
        let first = self.len;
        self.len += filled(points);
        if self.scratch.rows.len() < self.len * self.width {
            self.scratch.rows.resize(self.len * self.width, 0.0);
        }
        first
    }

    /// Eight numbers of one column.
    #[inline(always)]
    pub(in crate::bundle) fn group(&mut self, point: usize, column: usize) -> &mut [f64] {
        let at = point / GROUP * self.width * GROUP + column * GROUP;
        &mut self.scratch.rows[at..at + GROUP]
    }

    /// Columns of the group of a point, eight numbers each.
    #[inline(always)]
    pub(in crate::bundle) fn groups(&mut self, point: usize) -> impl Iterator<Item = &mut [f64]> {
        let at = point / GROUP * self.width * GROUP;
        self.scratch.rows[at..at + self.width * GROUP].chunks_exact_mut(GROUP)
    }

    /// Whitened distances of a contour into one column; the feet start where two other columns say.
    #[inline(always)]
    pub(super) fn distances<L: Lanes>(
        &mut self,
        first: usize,
        (column, near): (usize, Option<usize>),
        camera: &LaneCamera<L>,
        circle: &SeenCircle,
        (seen, scale): (&DiscObservation, f64),
    ) -> Option<()> {
        let (edge, circle) = (&seen.edge, LaneCircle::<L>::of(circle)?);
        for i in (0..filled(edge.u_px.len())).step_by(L::N) {
            let q = [padded(&edge.u_px, i, None), padded(&edge.v_px, i, None)];
            let point = first + i;
            let foot = match near {
                None => feet(camera, &circle, q)?,
                Some(k) => {
                    let cos = L::load(&self.group(point, k)[point % GROUP..]);
                    let sin = L::load(&self.group(point, k + 1)[point % GROUP..]);
                    feet_from(camera, &circle, q, [cos, sin])?
                }
            };
            let sigma: L = padded(&edge.sigma_px, i, Some(f64::INFINITY));
            let r = foot.distance * (L::splat(1.0) / (sigma * L::splat(scale)));
            r.store(&mut self.group(point, column)[point % GROUP..]);
        }
        Some(())
    }

    /// Whitened rows of a contour, behind them its whitened distances, and where wanted cosines and sines of the feet from a column on.
    #[inline(always)]
    pub(super) fn fill<L: Lanes>(
        &mut self,
        first: usize,
        (columns, feet_at): (&Columns, Option<usize>),
        camera: &LaneCamera<L>,
        (image, seen): (&SeenImage, &DiscObservation),
    ) -> Option<()> {
        let (edge, circle) = (&seen.edge, LaneCircle::<L>::of(&image.circle(seen.disc))?);
        let scale = L::splat(image.observations.sigma_scale);
        let d = image.model.target.disc_derivative(seen.disc);
        // Movement of the centre and growth of the radius by each length of the target.
        let mut shapes = [([L::splat(0.0); 3], L::splat(0.0)); 3];
        for (k, shape) in shapes.iter_mut().enumerate() {
            let shift = image.cam_from_target.rotation * Vector3::new(d[0][k], d[1][k], d[2][k]);
            *shape = (splats([shift.x, shift.y, shift.z]), L::splat(d[3][k]));
        }
        for i in (0..filled(edge.u_px.len())).step_by(L::N) {
            let foot = feet(camera, &circle, [padded(&edge.u_px, i, None), padded(&edge.v_px, i, None)])?;
            let iw = L::splat(1.0) / (padded::<L>(&edge.sigma_px, i, Some(f64::INFINITY)) * scale);
            let (g, by_intrinsics) = camera.derivative(&foot.image, [foot.normal[0] * iw, foot.normal[1] * iw]);
            let p = foot.p;
            let turn = [p[1] * g[2] - p[2] * g[1], p[2] * g[0] - p[0] * g[2], p[0] * g[1] - p[1] * g[0]];
            let outwards = dot(g, foot.radial);
            let mut row = [outwards; COLUMNS];
            row[..INTRINSICS].copy_from_slice(&by_intrinsics);
            row[INTRINSICS..INTRINSICS + 3].copy_from_slice(&turn);
            row[INTRINSICS + 3..SPACE].copy_from_slice(&g);
            for k in 0..3 {
                row[SPACE + k] = dot(g, shapes[k].0) + outwards * shapes[k].1;
            }
            let point = first + i;
            let mut groups = self.groups(point);
            for (group, &k) in groups.by_ref().zip(columns.list()) {
                row[k].store(&mut group[point % GROUP..]);
            }
            drop(groups);
            (foot.distance * iw).store(&mut self.group(point, columns.len)[point % GROUP..]);
            if let Some(at) = feet_at {
                foot.direction[0].store(&mut self.group(point, at)[point % GROUP..]);
                foot.direction[1].store(&mut self.group(point, at + 1)[point % GROUP..]);
            }
        }
        Some(())
    }

    /// Takes out what the points of a contour have in common, in the first `used` columns: a few columns at a time, which stay in the first-level
    /// cache for all that there is to take out.
    #[inline(always)]
    pub(super) fn whiten<L: Lanes>(&mut self, first: usize, seen: &DiscObservation, used: usize) {
        let whole = used / TILE * TILE;
        for column in (0..whole).step_by(TILE) {
            self.whiten_some::<L, TILE>((first, column), seen);
        }
        for column in whole..used {
            self.whiten_some::<L, 1>((first, column), seen);
        }
    }

    /// The same of `C` columns.
    #[inline(always)]
    fn whiten_some<L: Lanes, const C: usize>(&mut self, at: (usize, usize), seen: &DiscObservation) {
        self.take_out::<L, C>(at, seen.common.columns().chain(seen.outline.columns()), |_, _| ());
    }

    /// Products of what a tie holds with the first `used` columns, from which it is taken.
    #[inline(always)]
    pub(super) fn take_tie<L: Lanes>(&mut self, first: usize, tie: &Tie, used: usize) -> Vec<Vec<f64>> {
        let mut out = vec![vec![0.0; used]; tie.columns().count()];
        let whole = used / TILE * TILE;
        for column in (0..whole).step_by(TILE) {
            self.take_tie_from::<L, TILE>((first, column), tie, &mut out);
        }
        for column in whole..used {
            self.take_tie_from::<L, 1>((first, column), tie, &mut out);
        }
        out
    }

    /// The same of `C` columns.
    #[inline(always)]
    fn take_tie_from<L: Lanes, const C: usize>(&mut self, at: (usize, usize), tie: &Tie, out: &mut [Vec<f64>]) {
        let whole = tie.columns().map(|column| (column, 1.0));
        self.take_out::<L, C>(at, whole, |k, products| out[k][at.1..at.1 + C].copy_from_slice(&products));
    }

    /// Takes lists of numbers, one per point, times a part of their products with `C` columns from these, one list while the next is summed up;
    /// tells each list's parts.
    #[inline(always)]
    fn take_out<'l, L: Lanes, const C: usize>(
        &mut self,
        at: (usize, usize),
        lists: impl Iterator<Item = (&'l [f64], f64)>,
        mut told: impl FnMut(usize, [f64; C]),
    ) {
        let mut before: Option<(&[[f64; GROUP]], [f64; C])> = None;
        for (k, (list, part)) in lists.enumerate() {
            let (list, _) = list.as_chunks::<GROUP>();
            let sums = self.take_and_sum::<L, C>(at, before, Some(list));
            let mut parts = [0.0; C];
            for c in 0..C {
                parts[c] = part * lanes::sum(&sums[c]);
            }
            told(k, parts);
            before = Some((list, parts));
        }
        if before.is_some() {
            self.take_and_sum::<L, C>(at, before, None);
        }
    }

    /// Takes a list of numbers, one per point, times a part of each from `C` columns, and returns the sums of these columns times another list.
    #[inline(always)]
    fn take_and_sum<L: Lanes, const C: usize>(
        &mut self,
        (first, column): (usize, usize),
        taken: Option<(&[[f64; GROUP]], [f64; C])>,
        summed: Option<&[[f64; GROUP]]>,
    ) -> [[f64; GROUP]; C] {
        let (stride, mut out) = (self.width * GROUP, [[0.0; GROUP]; C]);
        let from = first / GROUP * stride + column * GROUP;
        let count = taken.map(|t| t.0).into_iter().chain(summed).map(<[_]>::len).min().unwrap_or(0);
        for lane in (0..GROUP).step_by(L::N) {
            let mut sums = [L::splat(0.0); C];
            for i in 0..count {
                let group = &mut self.scratch.rows[from + i * stride..][..C * GROUP];
                let mut row = [L::splat(0.0); C];
                for c in 0..C {
                    row[c] = L::load(&group[c * GROUP + lane..]);
                }
                if let Some((basis, parts)) = &taken {
                    let u = L::load(&basis[i][lane..]);
                    for c in 0..C {
                        row[c] = row[c] - u * L::splat(parts[c]);
                        row[c].store(&mut group[c * GROUP + lane..]);
                    }
                }
                if let Some(basis) = summed {
                    let u = L::load(&basis[i][lane..]);
                    for c in 0..C {
                        sums[c] = sums[c] + u * row[c];
                    }
                }
            }
            for c in 0..C {
                sums[c].store(&mut out[c][lane..]);
            }
        }
        out
    }

    /// Sum of the loss over a contour with whitened distances in column `used - 1`; rows and distances are multiplied by the root of
    /// their weights.
    #[inline(always)]
    pub(super) fn weigh(&mut self, first: usize, n: usize, used: usize, loss: Loss) -> f64 {
        let mut sums = [0.0; GROUP];
        for i in (0..filled(n)).step_by(GROUP) {
            let mut roots = [1.0; GROUP];
            let mut bent = false;
            let r = self.group(first + i, used - 1);
            for l in 0..GROUP {
                let (rho, weight) = loss.apply(r[l] * r[l]);
                sums[l] += rho;
                if weight != 1.0 {
                    (roots[l], bent) = (weight.sqrt(), true);
                }
            }
            if bent {
                for column in 0..used {
                    self.group(first + i, column).iter_mut().zip(&roots).for_each(|(x, w)| *x *= w);
                }
            }
        }
        lanes::sum(&sums)
    }

    /// Multiplies what has been collected into the running sums and forgets it. Long contours go in pieces that stay near.
    #[inline(always)]
    pub(in crate::bundle) fn multiply<L: Lanes>(&mut self) {
        for from in (0..self.len).step_by(COLLECTED) {
            let piece = from * self.width..(from + COLLECTED).min(self.len) * self.width;
            if L::N == GROUP {
                self.strips::<L, 4>(&piece);
            } else {
                self.strips::<L, 2>(&piece);
            }
        }
        self.len = 0;
    }

    /// Strips of `A` rows of the lower triangle, the last one of fewer.
    #[inline(always)]
    fn strips<L: Lanes, const A: usize>(&mut self, piece: &Range<usize>) {
        let whole = self.used / A * A;
        for i in (0..whole).step_by(A) {
            self.strip::<L, A>(i, piece);
        }
        match self.used - whole {
            1 => self.strip::<L, 1>(whole, piece),
            2 => self.strip::<L, 2>(whole, piece),
            3 => self.strip::<L, 3>(whole, piece),
            _ => {}
        }
    }

    /// Rows `i` to `i + A`: whole tiles as long as they lie left of the diagonal, then what is left of the one that it crosses.
    #[inline(always)]
    fn strip<L: Lanes, const A: usize>(&mut self, i: usize, piece: &Range<usize>) {
        let mut j = 0;
        while j + TILE <= i + 1 {
            self.tile::<L, A, TILE>((i, j), piece);
            j += TILE;
        }
        match i - j {
            0 => self.tile::<L, A, 0>((i, j), piece),
            2 => self.tile::<L, A, 2>((i, j), piece),
            _ => {}
        }
    }

    /// `A` x 4 products, which stay in registers over all points; row a of them up to column `D + a`.
    #[inline(always)]
    fn tile<L: Lanes, const A: usize, const D: usize>(&mut self, (i, j): (usize, usize), piece: &Range<usize>) {
        let width = self.width;
        for part in (0..GROUP).step_by(L::N) {
            let mut tile = [[L::splat(0.0); TILE]; A];
            for group in self.scratch.rows[piece.clone()].chunks_exact(width * GROUP) {
                let (left, right) = (&group[i * GROUP..(i + A) * GROUP], &group[j * GROUP..(j + TILE) * GROUP]);
                let mut columns = [L::splat(0.0); TILE];
                for b in 0..TILE {
                    if b < D + A {
                        columns[b] = L::load(&right[b * GROUP + part..]);
                    }
                }
                for a in 0..A {
                    let left = L::load(&left[a * GROUP + part..]);
                    for b in 0..TILE {
                        if b <= D + a {
                            tile[a][b] = tile[a][b] + left * columns[b];
                        }
                    }
                }
            }
            for a in 0..A {
                for b in 0..TILE {
                    if b <= D + a {
                        let at = ((i + a) * width + j + b) * GROUP + part;
                        let sum = &mut self.scratch.sums[at..at + L::N];
                        (L::load(sum) + tile[a][b]).store(sum);
                    }
                }
            }
        }
    }

    /// Clears the running sums.
    #[inline(always)]
    pub(in crate::bundle) fn clear(&mut self) {
        self.scratch.sums.clear();
        self.scratch.sums.resize(self.width * self.width * GROUP, 0.0);
    }

    /// Product of two columns.
    #[inline(always)]
    pub(in crate::bundle) fn product(&self, a: usize, b: usize) -> f64 {
        let at = (a.max(b) * self.width + a.min(b)) * GROUP;
        lanes::sum(&self.scratch.sums[at..at + GROUP])
    }
}
