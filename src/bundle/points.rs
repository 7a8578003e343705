//! Point residuals: pixels against the images of the discs' centres through the whole lens model.
//!
//! ```text
//! r = (q - image of C) / sigma      two numbers per point; the robust loss sees them as one, like the features of a pair
//! row = d image / dz / sigma        intrinsics, turn w: p x g, shift v: g, lengths of the target: g . dC
//! ```
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | q | `u_px`, `v_px` | 2 | px | where the point was seen |
//! | C | `disc(j)` | 3 | mm | its place on the target, offsets included |
//! | p, g | `by_point` | 3 | mm, 1/mm | the point in the camera frame; derivative of one coordinate by it, over sigma |
//!
//! Several points at a time go into the rows of [`super::edges`], the u coordinates of eight points as one group and the v coordinates as the
//! next, so that no Jacobian outlives some hundred rows. Cameras behind windows or of the photogrammetric polynomial take the plain path.
//! Equal to the plain path up to rounding; the same bits on every machine.

use super::assemble::{ImageNormal, LOCAL, OffsetNormal, SPACE, SeenImage};
use super::contour::{Foot, row};
use super::edges::{self, COLLECTED, Columns, Rows, filled};
use super::model::Loss;
use super::tangent::pair_loss;
use crate::camera::{INTRINSICS, LaneCamera, LaneImage};
use crate::frames::{Cam, Target};
use crate::lanes::{self, GROUP, Kernel, Lanes, splats};
use crate::rigid::Motion;
use nalgebra::{Matrix4, SMatrix, SVector, Vector2, Vector3, Vector4};

/// Loss of the two coordinates together.
fn point_loss(image: &SeenImage) -> Loss {
    pair_loss(image.model.loss, 2)
}

/// Memory that is used again from image to image of one state.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Places of the target's discs, x, y and z; empty until the first image asks.
    places: [Vec<f64>; 3],
}

impl Scratch {
    fn fill(&mut self, image: &SeenImage) {
        if !image.model.target.per_view() && !self.places[0].is_empty() {
            return;
        }
        self.places.iter_mut().for_each(Vec::clear);
        for j in 0..image.model.target.disc_count() {
            let (center, _) = image.disc(j);
            self.places.iter_mut().zip(center.iter()).for_each(|(p, c)| p.push(*c));
        }
    }
}

/// One coordinate as the plain path has it: rows by the camera space of a point and its whitened residual.
struct PlainPoint<const E: usize> {
    rows: [[f64; E]; 2],
    residual: [f64; 2],
}

/// Point `i` of an image in the camera frame, one over its sigma, its whitened residual; `None` where it has no image.
fn plain_image(image: &SeenImage, i: usize) -> Option<(Vector3<f64>, f64, [f64; 2])> {
    let (seen, camera) = (&image.observations.points, &image.camera.camera);
    let p_in_cam = image.cam_from_target.apply(&image.disc(seen.disc[i] as usize).0);
    let (q, _) = camera.image_of_point(&p_in_cam).ok()?;
    let iw = 1.0 / (seen.sigma_px[i] * image.observations.sigma_scale);
    Some((p_in_cam, iw, [(seen.u_px[i] - q.x) * iw, (seen.v_px[i] - q.y) * iw]))
}

/// Point `i` of an image with its rows.
fn plain<const E: usize>(image: &SeenImage, i: usize) -> Option<PlainPoint<E>> {
    let (p_in_cam, iw, residual) = plain_image(image, i)?;
    let of = |normal: Vector2<f64>| -> Option<[f64; E]> {
        let foot = Foot { p_in_cam, radial: Vector3::zeros(), normal, distance_px: 0.0 };
        Some(row::<E>(&image.camera.camera, &foot)?.map(|x| x * iw))
    };
    Some(PlainPoint { rows: [of(Vector2::x())?, of(Vector2::y())?], residual })
}

/// Whitened residuals of point `i`.
fn plain_residual(image: &SeenImage, i: usize) -> Option<[f64; 2]> {
    plain_image(image, i).map(|(_, _, residual)| residual)
}

fn square(r: [f64; 2]) -> f64 {
    r[0] * r[0] + r[1] * r[1]
}

/// Cost of an image's points, one by one.
pub(super) fn plain_cost(image: &SeenImage) -> Option<f64> {
    let (loss, mut rho) = (point_loss(image), 0.0);
    for i in 0..image.observations.points.disc.len() {
        rho += loss.apply(square(plain_residual(image, i)?)).0;
    }
    rho.is_finite().then_some(0.5 * rho)
}

/// Sum of the squares of an image's whitened residuals.
pub(super) fn chi2(image: &SeenImage) -> Option<f64> {
    (0..image.observations.points.disc.len()).map(|i| plain_residual(image, i).map(square)).sum()
}

/// Adds an image's points, one by one; with the equations of their discs where each is `estimated`.
pub(super) fn plain_linearise<const E: usize, const L: usize>(
    image: &SeenImage,
    estimated: bool,
    out: &mut ImageNormal<L>,
) -> Option<()> {
    let (loss, mut total) = (point_loss(image), 0.0);
    for (i, &disc) in image.observations.points.disc.iter().enumerate() {
        let PlainPoint { rows, residual } = plain::<E>(image, i)?;
        let (rho, weight) = loss.apply(square(residual));
        total += rho;
        let (mut h, mut b) = (SMatrix::<f64, E, E>::zeros(), SVector::<f64, E>::zeros());
        for (row, r) in rows.iter().zip(residual) {
            let row = SVector::<f64, E>::from(*row);
            h.ger(weight, &row, &row, 1.0);
            b.axpy(weight * r, &row, 1.0);
        }
        let map = image.disc_map::<E, L>(disc as usize);
        let hm = h * map;
        out.h += map.tr_mul(&hm);
        out.b += map.tr_mul(&b);
        if estimated {
            let o = image.offset_map::<E>();
            out.offsets.push(OffsetNormal {
                disc: disc as usize,
                own: o.tr_mul(&(h * o)),
                with_local: o.tr_mul(&hm),
                b: o.tr_mul(&b),
            });
        }
    }
    out.cost += 0.5 * total;
    total.is_finite().then_some(())
}

/// Adds `sum of w row r_vv` of an image's points, one by one; see [`super::contour::bend`].
pub(super) fn plain_bend<const E: usize, const L: usize>(
    seen: &[SeenImage; 3],
    h: f64,
    local: &mut SVector<f64, L>,
    offsets: &mut Vec<(usize, Vector4<f64>)>,
) -> Option<()> {
    let loss = point_loss(&seen[1]);
    for (i, &disc) in seen[1].observations.points.disc.iter().enumerate() {
        let here = plain::<E>(&seen[1], i)?;
        let (before, behind) = (plain_residual(&seen[0], i)?, plain_residual(&seen[2], i)?);
        let weight = loss.apply(square(here.residual)).1;
        let mut b = SVector::<f64, E>::zeros();
        for s in 0..2 {
            let second = (behind[s] - 2.0 * here.residual[s] + before[s]) / (h * h);
            b.axpy(weight * second, &SVector::from(here.rows[s]), 1.0);
        }
        *local += seen[1].disc_map::<E, L>(disc as usize).tr_mul(&b);
        offsets.push((disc as usize, seen[1].offset_map::<E>().tr_mul(&b)));
    }
    Some(())
}

/// Cost of an image's points; `None` where one has no image.
pub(super) fn cost(image: &SeenImage, scratch: &mut Scratch) -> Option<f64> {
    if image.observations.points.disc.is_empty() {
        return Some(0.0);
    }
    scratch.fill(image);
    lanes::run(Cost { image, places: &scratch.places })
}

/// Adds an image's points to its normal equations, with the equations of their discs where each is `estimated`; `None` where one has no image.
pub(super) fn linearise(
    image: &SeenImage,
    columns: &Columns,
    estimated: bool,
    (scratch, rows): (&mut Scratch, &mut edges::Scratch),
    out: &mut ImageNormal<LOCAL>,
) -> Option<()> {
    if image.observations.points.disc.is_empty() {
        return Some(());
    }
    scratch.fill(image);
    let columns = &columns.without_radius();
    lanes::run(Normal { image, columns, estimated, places: &scratch.places, rows, out })
}

/// Adds `sum of w row r_vv` of an image's points; `seen` a part `h` of the step before, at and behind the state.
pub(super) fn bend(
    seen: &[SeenImage; 3],
    columns: &Columns,
    h: f64,
    scratch: &mut [Scratch; 3],
    (local, offsets): (&mut SVector<f64, LOCAL>, &mut Vec<(usize, Vector4<f64>)>),
) -> Option<()> {
    if seen[1].observations.points.disc.is_empty() {
        return Some(());
    }
    scratch.iter_mut().zip(seen).for_each(|(s, seen)| s.fill(seen));
    let [before, here, behind] = scratch;
    let places = [&before.places, &here.places, &behind.places];
    lanes::run(Bend { seen, columns: &columns.without_radius(), h, places, local, offsets })
}

/// An image with its points in every lane.
struct LanePoints<'a, L> {
    image: &'a SeenImage<'a>,
    places: &'a [Vec<f64>; 3],
    camera: LaneCamera<L>,
    rotation: [[L; 3]; 3],
    shift: [L; 3],
    scale: L,
}

/// Some points: their images and whitened residuals.
struct Imaged<L: Lanes> {
    image: LaneImage<L>,
    inverse_sigma: L,
    residual: [L; 2],
}

impl<'a, L: Lanes> LanePoints<'a, L> {
    #[inline(always)]
    fn of(image: &'a SeenImage, places: &'a [Vec<f64>; 3]) -> Option<Self> {
        let motion: &Motion<Cam, Target> = &image.cam_from_target;
        let (r, t) = (&motion.rotation, &motion.translation_mm);
        let mut rotation = [[L::splat(0.0); 3]; 3];
        for (i, row) in rotation.iter_mut().enumerate() {
            *row = splats([r[(i, 0)], r[(i, 1)], r[(i, 2)]]);
        }
        Some(Self {
            image,
            places,
            camera: LaneCamera::<L>::of(&image.camera.camera)?,
            rotation,
            shift: splats([t.x, t.y, t.z]),
            scale: L::splat(image.observations.sigma_scale),
        })
    }

    /// Places on the target from point `i` on; past the end the last one once more.
    #[inline(always)]
    fn place(&self, i: usize) -> [L; 3] {
        let disc = &self.image.observations.points.disc;
        let mut out = [L::splat(0.0); 3];
        let first = disc[i.min(disc.len() - 1)] as usize;
        let mut ascending = i + L::N <= disc.len();
        if ascending {
            for (l, j) in disc[i..i + L::N].iter().enumerate() {
                ascending &= *j as usize == first + l;
            }
        }
        for (out, places) in out.iter_mut().zip(self.places) {
            if ascending {
                *out = L::load(&places[first..]);
                continue;
            }
            let mut place = [0.0; GROUP];
            for (l, x) in place[..L::N].iter_mut().enumerate() {
                *x = places[disc[(i + l).min(disc.len() - 1)] as usize];
            }
            *out = L::load(&place);
        }
        out
    }

    /// Images of the points from `i` on; `None` where one has none. Past the end there is no weight.
    #[inline(always)]
    fn imaged(&self, i: usize) -> Option<Imaged<L>> {
        let (place, seen) = (self.place(i), &self.image.observations.points);
        let mut p = self.shift;
        for (p, row) in p.iter_mut().zip(&self.rotation) {
            *p = *p + (row[0] * place[0] + row[1] * place[1] + row[2] * place[2]);
        }
        let image = self.camera.image(p);
        if !L::all(image.valid) {
            return None;
        }
        let sigma: L = edges::padded(&seen.sigma_px, i, Some(f64::INFINITY));
        let inverse_sigma = L::splat(1.0) / (sigma * self.scale);
        let [u, v]: [L; 2] = [edges::padded(&seen.u_px, i, None), edges::padded(&seen.v_px, i, None)];
        let residual = [(u - image.u) * inverse_sigma, (v - image.v) * inverse_sigma];
        Some(Imaged { image, inverse_sigma, residual })
    }

    /// Places from point `i` on by each length of the target, in the camera frame.
    #[inline(always)]
    fn by_shape(&self, i: usize, k: usize) -> [L; 3] {
        let seen = self.image.observations;
        let mut place = [[0.0; GROUP]; 3];
        for l in 0..L::N {
            let disc = &seen.points.disc;
            let d = self.image.model.target.disc_derivative(disc[(i + l).min(disc.len() - 1)] as usize);
            for c in 0..3 {
                place[c][l] = d[c][k];
            }
        }
        let by = [L::load(&place[0]), L::load(&place[1]), L::load(&place[2])];
        let mut out = by;
        for (out, row) in out.iter_mut().zip(&self.rotation) {
            *out = row[0] * by[0] + row[1] * by[1] + row[2] * by[2];
        }
        out
    }

    /// Rows of both coordinates of the points from `i` on by intrinsics, turn and shift; by the lengths of the target that are in use.
    #[inline(always)]
    fn rows(&self, i: usize, of: &Imaged<L>, columns: &Columns) -> [LanePointRow<L>; 2] {
        let [u, v] = self.camera.rows(&of.image, of.inverse_sigma);
        let shape = [L::splat(0.0); 3];
        let mut rows = [LanePointRow { space: u, shape }, LanePointRow { space: v, shape }];
        for &k in columns.list() {
            if (SPACE..LOCAL).contains(&k) {
                let moved = self.by_shape(i, k - SPACE);
                for row in &mut rows {
                    let g = &row.space[INTRINSICS + 3..];
                    row.shape[k - SPACE] = g[0] * moved[0] + g[1] * moved[1] + g[2] * moved[2];
                }
            }
        }
        rows
    }
}

impl<L: Lanes> LanePoints<'_, L> {
    /// One coordinate by a shift in the target's frame.
    #[inline(always)]
    fn in_target(&self, row: &LanePointRow<L>) -> [L; 3] {
        let g = &row.space[INTRINSICS + 3..];
        let r = &self.rotation;
        let mut out = [g[0]; 3];
        for k in 0..3 {
            out[k] = g[0] * r[0][k] + g[1] * r[1][k] + g[2] * r[2][k];
        }
        out
    }

    /// Equations of the offsets of the points from `i` on; rows not yet times `root`, residuals already.
    #[inline(always)]
    fn couple(
        &self,
        i: usize,
        (rows, residual, root): (&[LanePointRow<L>; 2], [L; 2], L),
        columns: &Columns,
        out: &mut Vec<OffsetNormal<LOCAL>>,
    ) {
        let disc = &self.image.observations.points.disc;
        let first = out.len();
        for &disc in disc[i.min(disc.len())..].iter().take(L::N) {
            let (own, with_local, b) = (Matrix4::zeros(), SMatrix::zeros(), Vector4::zeros());
            out.push(OffsetNormal { disc: disc as usize, own, with_local, b });
        }
        let new = &mut out[first..];
        let (u, v) = (self.in_target(&rows[0]), self.in_target(&rows[1]));
        let mut place = [0.0; GROUP];
        for k in 0..3 {
            let (u_k, v_k) = (u[k] * root, v[k] * root);
            (u_k * residual[0] + v_k * residual[1]).store(&mut place);
            new.iter_mut().zip(&place).for_each(|(o, x)| o.b[k] = *x);
            let (u_k, v_k) = (u_k * root, v_k * root);
            for m in 0..3 {
                (u_k * u[m] + v_k * v[m]).store(&mut place);
                new.iter_mut().zip(&place).for_each(|(o, x)| o.own[(k, m)] = *x);
            }
            for &m in columns.list() {
                (u_k * rows[0].by(m) + v_k * rows[1].by(m)).store(&mut place);
                new.iter_mut().zip(&place).for_each(|(o, x)| o.with_local[(k, m)] = *x);
            }
        }
    }
}

/// One coordinate of some points.
struct LanePointRow<L> {
    space: [L; SPACE],
    shape: [L; 3],
}

impl<L: Lanes> LanePointRow<L> {
    /// By number `k` of the camera space.
    #[inline(always)]
    fn by(&self, k: usize) -> L {
        if k < SPACE { self.space[k] } else { self.shape[k - SPACE] }
    }
}

/// Loss and weights of some points, number by number.
#[inline(always)]
fn weighted<L: Lanes>(loss: Loss, residual: &[L; 2], rho: &mut [f64], weights: &mut [f64; GROUP]) {
    let mut parts = [[0.0; GROUP]; 2];
    residual[0].store(&mut parts[0]);
    residual[1].store(&mut parts[1]);
    for l in 0..L::N {
        let (sum, weight) = loss.apply(parts[0][l] * parts[0][l] + parts[1][l] * parts[1][l]);
        rho[l] += sum;
        weights[l] = weight;
    }
}

struct Cost<'a> {
    image: &'a SeenImage<'a>,
    places: &'a [Vec<f64>; 3],
}

impl Kernel for Cost<'_> {
    type Output = Option<f64>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<f64> {
        let points = LanePoints::<L>::of(self.image, self.places)?;
        let (loss, mut rho, mut weights) = (point_loss(self.image), [0.0; GROUP], [1.0; GROUP]);
        for i in (0..filled(self.image.observations.points.disc.len())).step_by(L::N) {
            let of = points.imaged(i)?;
            weighted(loss, &of.residual, &mut rho[i % GROUP..], &mut weights);
        }
        let rho = lanes::sum(&rho);
        rho.is_finite().then_some(0.5 * rho)
    }
}

struct Normal<'a> {
    image: &'a SeenImage<'a>,
    columns: &'a Columns,
    estimated: bool,
    places: &'a [Vec<f64>; 3],
    rows: &'a mut edges::Scratch,
    out: &'a mut ImageNormal<LOCAL>,
}

impl Kernel for Normal<'_> {
    type Output = Option<()>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<()> {
        let points = LanePoints::<L>::of(self.image, self.places)?;
        let (columns, list) = (self.columns, self.columns.list());
        let loss = point_loss(self.image);
        let (mut rho, mut weights) = ([0.0; GROUP], [1.0; GROUP]);
        let mut rows = Rows::for_products(self.rows, list.len() + 1);
        for i in (0..filled(self.image.observations.points.disc.len())).step_by(L::N) {
            let of = points.imaged(i)?;
            weighted(loss, &of.residual, &mut rho[i % GROUP..], &mut weights);
            if i % GROUP == 0 {
                rows.grow(2 * GROUP);
            }
            let both = points.rows(i, &of, columns);
            let (at, bent) = (rows.len - 2 * GROUP + i % GROUP, loss != Loss::None);
            let root = if bent { L::load(&weights).sqrt() } else { L::splat(1.0) };
            for (s, row) in both.iter().enumerate() {
                let at = at + s * GROUP;
                for (group, &k) in rows.groups(at).zip(list) {
                    let x = if bent { row.by(k) * root } else { row.by(k) };
                    x.store(&mut group[at % GROUP..]);
                }
                let r = if bent { of.residual[s] * root } else { of.residual[s] };
                r.store(&mut rows.group(at, list.len())[at % GROUP..]);
            }
            if self.estimated {
                let residual = [of.residual[0] * root, of.residual[1] * root];
                points.couple(i, (&both, residual, root), columns, &mut self.out.offsets);
            }
            if rows.len >= COLLECTED && (i + L::N) % GROUP == 0 {
                rows.multiply::<L>();
            }
        }
        rows.multiply::<L>();
        edges::add(&rows, columns, self.out);
        let rho = lanes::sum(&rho);
        self.out.cost += 0.5 * rho;
        rho.is_finite().then_some(())
    }
}

struct Bend<'a> {
    seen: &'a [SeenImage<'a>; 3],
    columns: &'a Columns,
    h: f64,
    places: [&'a [Vec<f64>; 3]; 3],
    local: &'a mut SVector<f64, LOCAL>,
    offsets: &'a mut Vec<(usize, Vector4<f64>)>,
}

impl Kernel for Bend<'_> {
    type Output = Option<()>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<()> {
        let before = LanePoints::<L>::of(&self.seen[0], self.places[0])?;
        let here = LanePoints::<L>::of(&self.seen[1], self.places[1])?;
        let behind = LanePoints::<L>::of(&self.seen[2], self.places[2])?;
        let (list, loss) = (self.columns.list(), point_loss(&self.seen[1]));
        let (mut rho, mut weights) = ([0.0; GROUP], [1.0; GROUP]);
        let mut sums = [[0.0; GROUP]; LOCAL];
        let (two, inverse) = (L::splat(2.0), L::splat(1.0 / (self.h * self.h)));
        let disc = &self.seen[1].observations.points.disc;
        for i in (0..filled(disc.len())).step_by(L::N) {
            let (of, from, to) = (here.imaged(i)?, before.imaged(i)?.residual, behind.imaged(i)?.residual);
            weighted(loss, &of.residual, &mut rho[i % GROUP..], &mut weights);
            let both = here.rows(i, &of, self.columns);
            let mut moved = [[0.0; GROUP]; 3];
            for (s, row) in both.iter().enumerate() {
                let factor = L::load(&weights) * (to[s] - two * of.residual[s] + from[s]) * inverse;
                for &k in list.iter().filter(|k| **k < LOCAL) {
                    let sum = &mut sums[k][i % GROUP..];
                    (L::load(sum) + row.by(k) * factor).store(sum);
                }
                let shift = here.in_target(row);
                for k in 0..3 {
                    (L::load(&moved[k]) + shift[k] * factor).store(&mut moved[k]);
                }
            }
            for (l, &disc) in disc[i.min(disc.len())..].iter().take(L::N).enumerate() {
                self.offsets.push((disc as usize, Vector4::new(moved[0][l], moved[1][l], moved[2][l], 0.0)));
            }
        }
        for &k in list.iter().filter(|k| **k < LOCAL) {
            self.local[k] += lanes::sum(&sums[k]);
        }
        Some(())
    }
}

#[cfg(test)]
mod tests;
