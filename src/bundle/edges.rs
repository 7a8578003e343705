//! Contours of one image, several edge points at a time: what [`super::contour`] says point by point, with no row of a Jacobian kept
//! beyond its contour.
//!
//! Rows go straight into the image's camera space (see [`super::assemble`]), and only those columns are formed that an adjusted unknown
//! moves: about 14 numbers and the residual per edge point. They are collected in groups of eight points until some hundred stand
//! there, whitened for what contours have in common, weighted by the loss, and then multiplied into the normal matrix:
//! ```text
//! rows   w = (n . dq/di, p x g, g, g . dC + (g . e) dR)  / sigma,   r = distance / sigma
//! sums   N_l += w w^T   over the points l, l + 8, l + 16, ...;      H = ((N_0 + N_4) + (N_2 + N_6)) + ((N_1 + N_5) + (N_3 + N_7))
//! ```
//! The foot starts in the direction of the edge point from the centre and turns by the Cayley step `tan(d / 2)` in place of d, which needs
//! no trigonometry and meets the same root.
//!
//! Bits are the same on every machine (see [`crate::lanes`]) and for any number of threads. Equal to the plain path up to rounding: the
//! tests hold both together. Cameras behind windows or of the photogrammetric polynomial take the plain path.

mod feet;
mod rows;

pub(super) use super::assemble::{ImageNormal, LOCAL, OffsetNormal, SeenImage};
use super::model::Loss;
use super::tie::Tied;
use crate::camera::{Camera, INTRINSICS, LaneCamera, Radial};
use crate::lanes::{self, GROUP, Kernel, Lanes};
pub(super) use feet::{Feet, filled, padded};
use nalgebra::{Matrix4, SMatrix, SVector, Vector4};
pub(super) use rows::Rows;

/// Columns of a row: the camera space and the radius.
const COLUMNS: usize = LOCAL + 1;
const RADIUS: usize = LOCAL;
/// Rows are multiplied out when this many edge points have been collected: they still fit the first-level cache.
pub(super) const COLLECTED: usize = 128;

/// True where an image's camera allows this path.
pub(super) fn allows(camera: &Camera) -> bool {
    camera.window().is_none() && camera.intrinsics().radial == Radial::IdealToDistorted
}

/// Columns of the camera space that are formed, in ascending order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Columns {
    at: [usize; COLUMNS],
    len: usize,
}

impl Columns {
    /// Those of the camera space for which `wanted` holds; with the radius where every disc is estimated.
    pub(super) fn of(wanted: impl Fn(usize) -> bool, radius: bool) -> Self {
        let mut out = Self { at: [0; COLUMNS], len: 0 };
        for k in (0..LOCAL).filter(|k| wanted(*k)).chain(radius.then_some(RADIUS)) {
            out.at[out.len] = k;
            out.len += 1;
        }
        out
    }
    /// Without the radius.
    pub(super) fn without_radius(&self) -> Self {
        let len = self.len - usize::from(self.list().last() == Some(&RADIUS));
        Self { at: self.at, len }
    }
    /// In ascending order, the radius last.
    pub(super) fn list(&self) -> &[usize] {
        &self.at[..self.len]
    }
}

/// Memory that is used again from image to image.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Rows: group, then column, then point of the group.
    rows: Vec<f64>,
    /// Columns of a group.
    width: usize,
    /// Running sums of products: column, column, one of [`GROUP`].
    sums: Vec<f64>,
}

/// Cost of an image's contours; `None` where a circle has no image. What they have in common with others is added to `tied`.
pub(super) fn cost(image: &SeenImage, scratch: &mut Scratch, tied: &mut Vec<Tied<()>>) -> Option<f64> {
    lanes::run(Cost { image, scratch, tied })
}

/// Adds an image's contours to its normal equations; `None` where a circle has no image.
pub(super) fn linearise(
    image: &SeenImage,
    columns: &Columns,
    scratch: &mut Scratch,
    out: &mut ImageNormal<LOCAL>,
) -> Option<()> {
    lanes::run(Normal { image, columns, scratch, out })
}

/// Adds `sum of w row r_vv / sigma` of an image's contours (see [`super::contour::bend`]) and lists it by the offsets of each disc; `seen` a
/// part `h` of the step before, at and behind the state.
pub(super) fn bend(
    seen: &[SeenImage; 3],
    columns: &Columns,
    h: f64,
    scratch: &mut Scratch,
    out: (&mut SVector<f64, LOCAL>, &mut Vec<(usize, Vector4<f64>)>),
) -> Option<()> {
    lanes::run(Bend { seen, columns, h, scratch, local: out.0, offsets: out.1 })
}

struct Cost<'a> {
    image: &'a SeenImage<'a>,
    scratch: &'a mut Scratch,
    tied: &'a mut Vec<Tied<()>>,
}

impl Kernel for Cost<'_> {
    type Output = Option<f64>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<f64> {
        let (image, loss) = (self.image, self.image.model.loss);
        let camera = LaneCamera::<L>::of(&image.camera.camera)?;
        let mut rows = Rows::new(self.scratch, 1);
        let mut rho = 0.0;
        for seen in image.observations.discs.iter().filter(|d| !d.edge.u_px.is_empty()) {
            rows.len = 0;
            let n = seen.edge.u_px.len();
            let first = rows.grow(n);
            let scale = image.observations.sigma_scale;
            rows.distances(first, (0, None), &camera, &image.circle(seen.disc), (seen, scale))?;
            rows.whiten::<L>(first, seen, 1);
            if let Some(tie) = image.tie(seen) {
                let products = rows.take_tie::<L>(first, tie, 1);
                self.tied.extend(tie.tied(image, seen.disc, products.iter().map(|r| (r[0], ()))));
            }
            rho += rows.weigh(first, n, 1, loss);
        }
        rho.is_finite().then_some(0.5 * rho)
    }
}

struct Normal<'a> {
    image: &'a SeenImage<'a>,
    columns: &'a Columns,
    scratch: &'a mut Scratch,
    out: &'a mut ImageNormal<LOCAL>,
}

impl Kernel for Normal<'_> {
    type Output = Option<()>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<()> {
        let (image, columns, out) = (self.image, self.columns, self.out);
        let camera = LaneCamera::<L>::of(&image.camera.camera)?;
        let (used, estimated) = (columns.len + 1, columns.list().contains(&RADIUS));
        let mut rows = Rows::for_products(self.scratch, used);
        let mut rho = 0.0;
        for seen in image.observations.discs.iter().filter(|d| !d.edge.u_px.is_empty()) {
            let n = seen.edge.u_px.len();
            let first = rows.grow(n);
            rows.fill(first, (columns, None), &camera, (image, seen))?;
            rows.whiten::<L>(first, seen, used);
            if let Some(tie) = image.tie(seen) {
                let products = rows.take_tie::<L>(first, tie, used);
                out.tied.extend(tie.tied(image, seen.disc, products.iter().map(|p| (p[used - 1], local(p, columns)))));
            }
            rho += rows.weigh(first, n, used, image.model.loss);
            if estimated {
                rows.multiply::<L>();
                add(&rows, columns, out);
                out.offsets.push(offset_normal(&rows, columns, image, seen.disc));
                rows.clear();
            } else if rows.len >= COLLECTED {
                rows.multiply::<L>();
            }
        }
        rows.multiply::<L>();
        add(&rows, columns, out);
        out.cost += 0.5 * rho;
        rho.is_finite().then_some(())
    }
}

/// Numbers of the columns in their places of the camera space.
fn local(products: &[f64], columns: &Columns) -> SVector<f64, LOCAL> {
    let mut out = SVector::zeros();
    columns.list().iter().zip(products).filter(|(k, _)| **k != RADIUS).for_each(|(k, x)| out[*k] = *x);
    out
}

/// Adds the running sums to the normal equations.
#[inline(always)]
pub(super) fn add(rows: &Rows, columns: &Columns, out: &mut ImageNormal<LOCAL>) {
    for (m, &i) in columns.list().iter().enumerate().filter(|(_, i)| **i != RADIUS) {
        out.b[i] += rows.product(m, columns.len);
        for (n, &j) in columns.list()[..=m].iter().enumerate() {
            let h = rows.product(m, n);
            out.h[(i, j)] += h;
            if i != j {
                out.h[(j, i)] += h;
            }
        }
    }
}

/// Equations of a disc's offsets (dx, dy, dz, dr): its shifts turned into the target's frame, and its radius.
fn offset_normal(rows: &Rows, columns: &Columns, image: &SeenImage, disc: usize) -> OffsetNormal<LOCAL> {
    let place = |k: usize| columns.list().iter().position(|c| *c == k);
    let own: [Option<usize>; 4] = [INTRINSICS + 3, INTRINSICS + 4, INTRINSICS + 5, RADIUS].map(place);
    let product = |m: usize, n: Option<usize>| own[m].zip(n).map_or(0.0, |(m, n)| rows.product(m, n));
    let map = offset_map(image);
    let with_local = SMatrix::<f64, 4, LOCAL>::from_fn(|m, k| product(m, place(k)));
    OffsetNormal {
        disc,
        own: map * Matrix4::from_fn(|m, n| product(m, own[n])) * map.transpose(),
        with_local: map * with_local,
        b: map * Vector4::from_fn(|m, _| product(m, Some(columns.len))),
    }
}

/// Offsets of a disc by its shift in the camera frame and its radius, transposed.
fn offset_map(image: &SeenImage) -> Matrix4<f64> {
    let mut map = Matrix4::identity();
    map.fixed_view_mut::<3, 3>(0, 0).copy_from(&image.cam_from_target.rotation.transpose());
    map
}

struct Bend<'a> {
    seen: &'a [SeenImage<'a>; 3],
    columns: &'a Columns,
    h: f64,
    scratch: &'a mut Scratch,
    local: &'a mut SVector<f64, LOCAL>,
    offsets: &'a mut Vec<(usize, Vector4<f64>)>,
}

impl Kernel for Bend<'_> {
    type Output = Option<()>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<()> {
        let here = &self.seen[1];
        let (columns, scale) = (self.columns, here.observations.sigma_scale);
        let before = LaneCamera::<L>::of(&self.seen[0].camera.camera)?;
        let camera = LaneCamera::<L>::of(&here.camera.camera)?;
        let behind = LaneCamera::<L>::of(&self.seen[2].camera.camera)?;
        // Behind the rows: residual, that before, that behind the state; cosine and sine of the feet.
        let r = columns.len;
        let mut rows = Rows::new(self.scratch, r + 5);
        for seen in here.observations.discs.iter().filter(|d| !d.edge.u_px.is_empty()) {
            rows.len = 0;
            let n = seen.edge.u_px.len();
            let first = rows.grow(n);
            rows.fill(first, (columns, Some(r + 3)), &camera, (here, seen))?;
            rows.distances(first, (r + 1, Some(r + 3)), &before, &self.seen[0].circle(seen.disc), (seen, scale))?;
            rows.distances(first, (r + 2, Some(r + 3)), &behind, &self.seen[2].circle(seen.disc), (seen, scale))?;
            rows.whiten::<L>(first, seen, r + 3);
            let own = bent(&mut rows, n, columns, self.h, here.model.loss);
            for (m, &k) in columns.list().iter().enumerate().filter(|(_, k)| **k != RADIUS) {
                self.local[k] += own[m];
            }
            if columns.list().contains(&RADIUS) {
                let of = |k: usize| columns.list().iter().position(|c| *c == k).map_or(0.0, |m| own[m]);
                let shift = INTRINSICS + 3;
                let moved = Vector4::new(of(shift), of(shift + 1), of(shift + 2), of(RADIUS));
                self.offsets.push((seen.disc, offset_map(here) * moved));
            }
        }
        Some(())
    }
}

/// Every column times weight and second derivative of the residual, summed over the contour collected.
#[inline(always)]
fn bent(rows: &mut Rows, n: usize, columns: &Columns, h: f64, loss: Loss) -> [f64; COLUMNS] {
    let r = columns.len;
    let mut sums = [[0.0; GROUP]; COLUMNS];
    for i in (0..filled(n)).step_by(GROUP) {
        let mut factor = [0.0; GROUP];
        for l in 0..GROUP {
            let at = |rows: &mut Rows, column: usize| rows.group(i, column)[l];
            let (here, before, behind) = (at(rows, r), at(rows, r + 1), at(rows, r + 2));
            factor[l] = loss.weight(here) * (behind - 2.0 * here + before) / (h * h);
        }
        for (m, sums) in sums.iter_mut().enumerate().take(r) {
            let row = rows.group(i, m);
            (0..GROUP).for_each(|l| sums[l] += row[l] * factor[l]);
        }
    }
    sums.map(|s| lanes::sum(&s))
}

#[cfg(test)]
mod tests;
