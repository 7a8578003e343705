//! Contours of one image, several edge points at a time: what [`super::contour`] says point by point, with no row of a Jacobian kept
//! beyond its contour.
//!
//! Rows go straight into the image's camera space (see [`super::assemble`]), and only those columns are formed that an adjusted unknown
//! moves: about 14 numbers and the residual per edge point. They are collected in groups of eight points until some hundred stand
//! there, whitened for ovals, weighted by the loss, and then multiplied into the normal matrix:
//! ```text
//! rows   w = (n . dq/di, p x g, g, g . dC + (g . e) dR)  / sigma,   r = distance / sigma
//! sums   N_l += w w^T   over the points l, l + 8, l + 16, ...;      H = ((N_0 + N_4) + (N_2 + N_6)) + ((N_1 + N_5) + (N_3 + N_7))
//! ```
//! The foot starts in the direction of the edge point from the centre and turns by the Cayley step `tan(d / 2)` in place of d, which needs
//! no trigonometry and meets the same root.
//!
//! Bits are the same on every machine (see [`crate::lanes`]) and for any number of threads. Equal to the plain path up to rounding: the
//! tests hold both together. Cameras behind windows or of the photogrammetric polynomial take the plain path.

use super::assemble::{ImageNormal, LOCAL, OffsetNormal, SPACE, SeenImage};
use super::contour::SeenCircle;
use super::model::{DiscObservation, Loss};
use crate::camera::{Camera, INTRINSICS, LaneCamera, LaneImage, Radial};
use crate::lanes::{self, GROUP, Kernel, Lanes, splats};
use nalgebra::{Matrix4, SMatrix, SVector, Vector3, Vector4};

/// Columns of a row: the camera space and the radius.
const COLUMNS: usize = LOCAL + 1;
const RADIUS: usize = LOCAL;
/// Rows are multiplied out when this many edge points have been collected: they still fit the first-level cache.
const COLLECTED: usize = 128;

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
    /// Running sums of products: column, column, one of [`GROUP`].
    sums: Vec<f64>,
    /// First and second column of an outline's basis.
    basis: [Vec<f64>; 2],
}

/// Cost of an image's contours; `None` where a circle has no image.
pub(super) fn cost(image: &SeenImage, scratch: &mut Scratch) -> Option<f64> {
    lanes::run(Cost { image, scratch })
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

/// Signed distances of the edge points of one contour and their feet's outward normals, px.
pub(super) fn distances(circle: &SeenCircle, seen: &DiscObservation, out: &mut [Vec<f64>; 3]) -> Option<()> {
    lanes::run(Distances { circle, seen, out })
}

/// A circle of the target in the camera frame, each number in every lane.
struct LaneCircle<L> {
    center: [L; 3],
    /// Axes of the target's plane times the radius.
    ex: [L; 3],
    ey: [L; 3],
    inverse_radius: L,
    center_px: [L; 2],
    plane_from_image: [[L; 2]; 2],
}

impl<L: Lanes> LaneCircle<L> {
    #[inline(always)]
    fn of(circle: &SeenCircle) -> Option<Self> {
        let start = circle.start()?;
        let motion = circle.cam_from_target;
        let axes = motion.rotation * circle.radius;
        let (center, plane) = (motion.apply(&circle.center), start.plane_from_image());
        Some(Self {
            center: splats([center.x, center.y, center.z]),
            ex: splats([axes[(0, 0)], axes[(1, 0)], axes[(2, 0)]]),
            ey: splats([axes[(0, 1)], axes[(1, 1)], axes[(2, 1)]]),
            inverse_radius: L::splat(1.0 / circle.radius),
            center_px: splats([start.center_px().x, start.center_px().y]),
            plane_from_image: [splats([plane[(0, 0)], plane[(0, 1)]]), splats([plane[(1, 0)], plane[(1, 1)]])],
        })
    }
}

/// Feet of some edge points.
struct LaneFoot<L: Lanes> {
    image: LaneImage<L>,
    p: [L; 3],
    radial: [L; 3],
    normal: [L; 2],
    distance: L,
}

#[inline(always)]
fn dot<L: Lanes, const N: usize>(a: [L; N], b: [L; N]) -> L {
    let mut sum = a[0] * b[0];
    for k in 1..N {
        sum = sum + a[k] * b[k];
    }
    sum
}

/// Feet of edge points on their imaged circle; `None` where one has none.
#[inline(always)]
fn feet<L: Lanes>(camera: &LaneCamera<L>, circle: &LaneCircle<L>, q: [L; 2]) -> Option<LaneFoot<L>> {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let [cu, cv] = circle.center_px;
    let aside = [q[0] - cu, q[1] - cv];
    let (gx, gy) = (dot(circle.plane_from_image[0], aside), dot(circle.plane_from_image[1], aside));
    let size = (gx * gx + gy * gy).sqrt();
    let off = zero.below(size);
    let (mut cos, mut sin) = (L::select(off, gx / size, one), L::select(off, gy / size, zero));
    for round in 0..12 {
        let (mut spoke, mut p, mut turned) = ([zero; 3], [zero; 3], [zero; 3]);
        for k in 0..3 {
            spoke[k] = circle.ex[k] * cos + circle.ey[k] * sin;
            p[k] = circle.center[k] + spoke[k];
            turned[k] = circle.ey[k] * cos - circle.ex[k] * sin;
        }
        let image = camera.image(p);
        if !L::all(image.valid) {
            return None;
        }
        let tangent = camera.along(&image, turned);
        let gap = [q[0] - image.u, q[1] - image.v];
        let (speed, along) = (dot(tangent, tangent), dot(gap, tangent));
        // 1e-7 px along the curve leave 1e-15 px across it.
        let arrived = (along * along).below(L::splat(1e-14) * speed);
        if L::all(arrived) || round == 11 {
            let length = one / speed.sqrt();
            let outward = [tangent[1] * length, -(tangent[0] * length)];
            let inwards = dot(outward, [image.u - cu, image.v - cv]).below(zero);
            let normal = [L::select(inwards, -outward[0], outward[0]), L::select(inwards, -outward[1], outward[1])];
            let inverse = circle.inverse_radius;
            let radial = [spoke[0] * inverse, spoke[1] * inverse, spoke[2] * inverse];
            return Some(LaneFoot { p, radial, normal, distance: dot(normal, gap), image });
        }
        // The ellipse's own q'' = centre - q.
        let curvature = dot(gap, [cu - image.u, cv - image.v]);
        let limit = L::splat(0.35);
        let half = (L::splat(0.5) * along / (speed - curvature).at_least(L::splat(0.3) * speed))
            .at_most(limit)
            .at_least(-limit);
        let square = half * half;
        let inverse = one / (one + square);
        let (c, s) = ((one - square) * inverse, (half + half) * inverse);
        // Those that have arrived stay where they are, whoever their neighbours are.
        let next = (cos * c - sin * s, sin * c + cos * s);
        (cos, sin) = (L::select(arrived, cos, next.0), L::select(arrived, sin, next.1));
    }
    None
}

/// The numbers from `at` on; past the end the last one, or `beyond`.
#[inline(always)]
fn padded<L: Lanes>(x: &[f64], at: usize, beyond: Option<f64>) -> L {
    if at + L::N <= x.len() {
        return L::load(&x[at..]);
    }
    let mut place = [0.0; GROUP];
    for (k, p) in place.iter_mut().enumerate() {
        let last = beyond.unwrap_or_else(|| x[x.len() - 1]);
        *p = x.get(at + k).copied().unwrap_or(last);
    }
    L::load(&place)
}

/// How many points the groups of `n` points hold.
fn filled(n: usize) -> usize {
    n.div_ceil(GROUP) * GROUP
}

/// Rows under way.
struct Rows<'a> {
    scratch: &'a mut Scratch,
    /// Columns of a group, with residuals and what is added for the tiles.
    width: usize,
    /// Points collected.
    len: usize,
}

impl<'a> Rows<'a> {
    #[inline(always)]
    fn new(scratch: &'a mut Scratch, width: usize) -> Self {
        Self { scratch, width, len: 0 }
    }

    /// Room for another contour; returns where it begins.
    #[inline(always)]
    fn grow(&mut self, points: usize) -> usize {
        let first = self.len;
        self.len += filled(points);
        if self.scratch.rows.len() < self.len * self.width {
            self.scratch.rows.resize(self.len * self.width, 0.0);
        }
        first
    }

    /// Eight numbers of one column.
    #[inline(always)]
    fn group(&mut self, point: usize, column: usize) -> &mut [f64] {
        let at = point / GROUP * self.width * GROUP + column * GROUP;
        &mut self.scratch.rows[at..at + GROUP]
    }

    #[inline(always)]
    fn put<L: Lanes>(&mut self, point: usize, column: usize, x: L) {
        x.store(&mut self.group(point, column)[point % GROUP..]);
    }

    /// Whitened distances of a contour into one column.
    #[inline(always)]
    fn distances<L: Lanes>(
        &mut self,
        first: usize,
        column: usize,
        camera: &LaneCamera<L>,
        circle: &SeenCircle,
        (seen, scale): (&DiscObservation, f64),
    ) -> Option<()> {
        let (edge, circle) = (&seen.edge, LaneCircle::<L>::of(circle)?);
        for i in (0..filled(edge.u_px.len())).step_by(L::N) {
            let foot = feet(camera, &circle, [padded(&edge.u_px, i, None), padded(&edge.v_px, i, None)])?;
            let sigma: L = padded(&edge.sigma_px, i, Some(f64::INFINITY));
            self.put(first + i, column, foot.distance * (L::splat(1.0) / (sigma * L::splat(scale))));
        }
        Some(())
    }

    /// Whitened rows of a contour, and its whitened distances behind them.
    #[inline(always)]
    fn fill<L: Lanes>(
        &mut self,
        first: usize,
        columns: &Columns,
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
            for (n, &k) in columns.list().iter().enumerate() {
                self.put(first + i, n, row[k]);
            }
            self.put(first + i, columns.len, foot.distance * iw);
        }
        Some(())
    }

    /// Takes out what ovals have in common, in the first `used` columns.
    #[inline(always)]
    fn whiten(&mut self, first: usize, seen: &DiscObservation, used: usize) {
        let Some(outline) = &seen.outline else { return };
        let n = filled(seen.edge.u_px.len());
        let mut basis = std::mem::take(&mut self.scratch.basis);
        let shrink = outline.split(&mut basis, n);
        for column in 0..used {
            let mut sums = [[0.0; GROUP]; 2];
            for i in (0..n).step_by(GROUP) {
                let row = self.group(first + i, column);
                for (sums, basis) in sums.iter_mut().zip(&basis) {
                    let part = &basis[i..i + GROUP];
                    (0..GROUP).for_each(|l| sums[l] += part[l] * row[l]);
                }
            }
            let (a, b) = (shrink[0] * lanes::sum(&sums[0]), shrink[1] * lanes::sum(&sums[1]));
            for i in (0..n).step_by(GROUP) {
                let (u, v) = (&basis[0][i..i + GROUP], &basis[1][i..i + GROUP]);
                let row = self.group(first + i, column);
                (0..GROUP).for_each(|l| row[l] -= u[l] * a + v[l] * b);
            }
        }
        self.scratch.basis = basis;
    }

    /// Sum of the loss over a contour with whitened distances in column `used - 1`; rows and distances are multiplied by the root of
    /// their weights.
    #[inline(always)]
    fn weigh(&mut self, first: usize, n: usize, used: usize, loss: Loss) -> f64 {
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

    /// Multiplies what has been collected into the running sums and forgets it.
    #[inline(always)]
    fn multiply<L: Lanes>(&mut self) {
        if L::N == GROUP {
            self.tiles::<L, 4>();
        } else {
            self.tiles::<L, 2>();
        }
        self.len = 0;
    }

    /// Tiles of `A` x 4 products stay in registers over all points.
    #[inline(always)]
    fn tiles<L: Lanes, const A: usize>(&mut self) {
        let width = self.width;
        let rows = &self.scratch.rows[..self.len * width];
        for i in (0..width).step_by(A) {
            for j in (0..i + A).step_by(4) {
                for part in (0..GROUP).step_by(L::N) {
                    let mut tile = [[L::splat(0.0); 4]; A];
                    for group in rows.chunks_exact(width * GROUP) {
                        let (left, right) = (&group[i * GROUP..(i + A) * GROUP], &group[j * GROUP..(j + 4) * GROUP]);
                        let mut columns = [L::splat(0.0); 4];
                        for b in 0..4 {
                            columns[b] = L::load(&right[b * GROUP + part..]);
                        }
                        for a in 0..A {
                            let left = L::load(&left[a * GROUP + part..]);
                            for b in 0..4 {
                                tile[a][b] = tile[a][b] + left * columns[b];
                            }
                        }
                    }
                    for a in 0..A {
                        for b in 0..4 {
                            let at = ((i + a) * width + j + b) * GROUP + part;
                            let sum = &mut self.scratch.sums[at..at + L::N];
                            (L::load(sum) + tile[a][b]).store(sum);
                        }
                    }
                }
            }
        }
    }

    /// Clears the running sums.
    #[inline(always)]
    fn clear(&mut self) {
        self.scratch.sums.clear();
        self.scratch.sums.resize(self.width * self.width * GROUP, 0.0);
    }

    /// Product of two columns.
    #[inline(always)]
    fn product(&self, a: usize, b: usize) -> f64 {
        let at = (a.max(b) * self.width + a.min(b)) * GROUP;
        lanes::sum(&self.scratch.sums[at..at + GROUP])
    }
}

struct Cost<'a> {
    image: &'a SeenImage<'a>,
    scratch: &'a mut Scratch,
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
            rows.distances(first, 0, &camera, &image.circle(seen.disc), (seen, scale))?;
            rows.whiten(first, seen, 1);
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
        let mut rows = Rows::new(self.scratch, used.next_multiple_of(4));
        // The columns that only fill the last tile may hold anything finite.
        rows.scratch.rows.clear();
        rows.clear();
        let mut rho = 0.0;
        for seen in image.observations.discs.iter().filter(|d| !d.edge.u_px.is_empty()) {
            let n = seen.edge.u_px.len();
            let first = rows.grow(n);
            rows.fill(first, columns, &camera, (image, seen))?;
            rows.whiten(first, seen, used);
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

/// Adds the running sums to the normal equations.
#[inline(always)]
fn add(rows: &Rows, columns: &Columns, out: &mut ImageNormal<LOCAL>) {
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
        // Behind the rows: residual, that before, that behind the state.
        let r = columns.len;
        let mut rows = Rows::new(self.scratch, r + 3);
        for seen in here.observations.discs.iter().filter(|d| !d.edge.u_px.is_empty()) {
            rows.len = 0;
            let n = seen.edge.u_px.len();
            let first = rows.grow(n);
            rows.fill(first, columns, &camera, (here, seen))?;
            rows.distances(first, r + 1, &before, &self.seen[0].circle(seen.disc), (seen, scale))?;
            rows.distances(first, r + 2, &behind, &self.seen[2].circle(seen.disc), (seen, scale))?;
            rows.whiten(first, seen, r + 3);
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

struct Distances<'a> {
    circle: &'a SeenCircle<'a>,
    seen: &'a DiscObservation,
    out: &'a mut [Vec<f64>; 3],
}

impl Kernel for Distances<'_> {
    type Output = Option<()>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<()> {
        let (edge, out) = (&self.seen.edge, self.out);
        let camera = LaneCamera::<L>::of(self.circle.camera)?;
        let circle = LaneCircle::<L>::of(self.circle)?;
        let n = edge.u_px.len();
        out.iter_mut().for_each(|o| o.resize(filled(n), 0.0));
        for i in (0..if n > 0 { filled(n) } else { 0 }).step_by(L::N) {
            let foot = feet(&camera, &circle, [padded(&edge.u_px, i, None), padded(&edge.v_px, i, None)])?;
            foot.distance.store(&mut out[0][i..]);
            foot.normal[0].store(&mut out[1][i..]);
            foot.normal[1].store(&mut out[2][i..]);
        }
        out.iter_mut().for_each(|o| o.truncate(n));
        Some(())
    }
}

#[cfg(test)]
mod tests;
