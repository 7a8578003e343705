//! The image of a plane figure through the exact camera, integrated over pixels and blurred.
//!
//! Irradiance on the sensor, in parts of full scale, and what a pixel collects of it:
//! ```text
//! E(q)  = B(q) + C(q) 1[q sees the inside of an outline]
//! I(q)  = (E * G_sigma * box)(q)          G_sigma Gaussian, box the square of one pixel
//! ```
//! The indicator is averaged over cells of 1/S px (S = 8, more for a sharp point spread): a cell that an outline may cross
//! is cut into 2 x 2 parts, and in each the outline is its tangent, placed by the depth at the part's centre and its
//! gradient through the unprojection (Sampson). What a tangent misses of an outline of radius R px in a part of width w is
//! `w^2 / (24 R)`, 2e-4 px at R = 0.8 px. Pixels then weigh the cells with box and sampled Gaussian; along an edge the
//! error of that sum averages to zero, and in one pixel it is below `(h^2 / 12) (G(0) - G(1))`, h = 1/S: 4e-4 of the
//! contrast at sigma = 0.8 px. Measured in `render/tests.rs`: edge within 1e-4 px also for dots of 4 x 2 px.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | sigma | `blur_sigma_px` | px | standard deviation of the point spread, without the pixel's own box |
//! | S | `cells` | 1/px | cells per pixel and direction |
//! | B, C | `ground`, `contrast` | 1 | grey outside, and inside minus outside; smooth over a few px |
//!
//! Not valid where the contrast varies within a pixel (it is interpolated between pixel centres), or where the map from
//! pixels to the plane bends within one (a lens of a few pixels' focal length).

use super::pattern::Feature;
use super::setup::{PlacedCamera, rim_px};
use crate::frames::{Cam, Target};
use crate::rigid::Motion;
use nalgebra::{Matrix2, Matrix3x2, Vector2, Vector3};

/// Width and height of the squares an image is worked in, px.
const TILE_PX: usize = 32;
/// Side of the blocks of a tile that are first asked whether an outline crosses them at all, px.
const BLOCK_PX: usize = 8;
/// An edge cell is cut into this many parts in each direction.
const PARTS: usize = 2;

/// One plane figure before one camera.
pub(super) struct Figure<'a> {
    pub(super) camera: &'a PlacedCamera,
    pub(super) cam_from_target: Motion<Cam, Target>,
    pub(super) features: &'a [Feature],
}

impl Figure<'_> {
    /// Where a pixel sees the front plane of the target, mm; none where its ray misses it.
    pub(super) fn front_mm(&self, q: &Vector2<f64>) -> Option<Vector2<f64>> {
        let ideal = self.camera.camera.ideal_of_pixel(q).ok()?;
        SeenPlane::new(&self.cam_from_target, 0.0).meet(&ideal).map(|(p, _)| p)
    }
}

/// Where a pixel's ray meets a plane z = const of the target.
struct Hit {
    /// Ideal point of the pixel and its derivative, 1 and 1 per px.
    ideal: Vector2<f64>,
    dideal_dq: Matrix2<f64>,
    /// x and y in the target, mm.
    xy_mm: Vector2<f64>,
    /// Its derivative by the pixel, mm per px.
    dxy_dq: Matrix2<f64>,
}

/// A plane z = const of the target, seen from the camera.
struct SeenPlane {
    origin_mm: Vector3<f64>,
    normal: Vector3<f64>,
    axes: Matrix3x2<f64>,
    distance_mm: f64,
}

impl SeenPlane {
    fn new(cam_from_target: &Motion<Cam, Target>, z_mm: f64) -> Self {
        let r = &cam_from_target.rotation;
        let origin_mm = cam_from_target.apply(&Vector3::new(0.0, 0.0, z_mm));
        let normal = r.column(2).into_owned();
        Self { origin_mm, normal, axes: r.fixed_columns::<2>(0).into_owned(), distance_mm: normal.dot(&origin_mm) }
    }

    /// Target coordinates and depth along the lens axis where the ray (x, y, 1) meets the plane.
    #[inline]
    fn meet(&self, xy: &Vector2<f64>) -> Option<(Vector2<f64>, f64)> {
        let ray = Vector3::new(xy.x, xy.y, 1.0);
        let s = self.distance_mm / self.normal.dot(&ray);
        (s > 0.0 && s.is_finite()).then(|| (self.axes.tr_mul(&(ray * s - self.origin_mm)), s))
    }

    /// Target coordinates `step` px beside a pixel whose hit is known.
    ///
    /// The lens is linear on this way and the plane exact: within a pixel of a tilted, distorting camera the lens
    /// bends by less than `(6 |k1| r + tan(tilt)) / (8 f)` px, 2e-6 px at the paper's geometry.
    #[inline]
    fn beside(&self, hit: &Hit, step: &Vector2<f64>) -> Option<Vector2<f64>> {
        self.meet(&(hit.ideal + hit.dideal_dq * step)).map(|(p, _)| p)
    }

    /// Target coordinates at a pixel with their derivative.
    fn hit(&self, c: &PlacedCamera, q: &Vector2<f64>) -> Option<Hit> {
        let jet = c.camera.unproject_jet(q).ok()?;
        let (xy_mm, s) = self.meet(&jet.xy)?;
        let ray = Vector3::new(jet.xy.x, jet.xy.y, 1.0);
        // d(s ray) = s d(ray) - ray s^2 / distance (n . d(ray)).
        let along = self.normal.fixed_rows::<2>(0) * (s * s / self.distance_mm);
        let dp = Matrix3x2::new(s, 0.0, 0.0, s, 0.0, 0.0) - ray * along.transpose();
        let dxy_dq = self.axes.tr_mul(&dp) * jet.dxy_dq;
        Some(Hit { ideal: jet.xy, dideal_dq: jet.dxy_dq, xy_mm, dxy_dq })
    }
}

/// Largest movement in the plane for one pixel of movement in the image, mm per px.
fn stretch(j: &Matrix2<f64>) -> f64 {
    let (half, det) = (0.5 * j.norm_squared(), j.determinant());
    (half + (half * half - det * det).max(0.0).sqrt()).sqrt()
}

/// Part of a square of side `side` on the positive side of a line at signed distance `d` along the unit normal (nx, ny).
fn covered(d: f64, nx: f64, ny: f64, side: f64) -> f64 {
    let (a, b) = if nx.abs() > ny.abs() { (nx.abs(), ny.abs()) } else { (ny.abs(), nx.abs()) };
    let t = d / side;
    let reach = 0.5 * (a + b);
    if t >= reach {
        1.0
    } else if t <= -reach {
        0.0
    } else if t.abs() <= 0.5 * (a - b) {
        0.5 + t / a
    } else {
        let corner = (reach - t.abs()).powi(2) / (2.0 * a * b);
        if t > 0.0 { 1.0 - corner } else { corner }
    }
}

/// Weights of the cells around a pixel: Gaussian times pixel box, of cells `-reach .. S + reach`.
struct Kernel {
    cells: usize,
    reach: usize,
    weights: Vec<f64>,
}

impl Kernel {
    fn new(sigma_px: f64) -> Self {
        let mut cells = 8;
        while sigma_px > 0.0 && (cells as f64) * sigma_px < 1.0 {
            cells *= 2;
        }
        let reach = (6.0 * sigma_px * cells as f64).ceil() as usize;
        let gauss = |i: i64| {
            let x = i as f64 / (sigma_px * cells as f64);
            if sigma_px > 0.0 { (-0.5 * x * x).exp() } else { f64::from(u8::from(i == 0)) }
        };
        let total: f64 = (-(reach as i64)..=reach as i64).map(gauss).sum();
        let weight = |i: i64| {
            let box_sum: f64 =
                (0..cells as i64).map(|k| i - k).filter(|j| j.unsigned_abs() as usize <= reach).map(gauss).sum();
            box_sum / (total * cells as f64)
        };
        let weights = (-(reach as i64)..(cells + reach) as i64).map(weight).collect();
        Self { cells, reach, weights }
    }

    /// Pixels beyond a tile that its convolution looks at.
    fn halo_px(&self) -> usize {
        self.reach.div_ceil(self.cells)
    }
}

/// A level of the target and the features on it with their boxes in the image.
struct Level<'a> {
    plane: SeenPlane,
    shapes: Vec<Shape<'a>>,
}

struct Shape<'a> {
    feature: &'a Feature,
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl Shape<'_> {
    fn reaches(&self, low: &Vector2<f64>, high: &Vector2<f64>) -> bool {
        self.low.x <= high.x && self.low.y <= high.y && self.high.x >= low.x && self.high.y >= low.y
    }
}

fn levels<'a>(figure: &Figure<'a>) -> Vec<Level<'a>> {
    let mut levels: Vec<(f64, Level)> = Vec::new();
    for feature in figure.features {
        let rim = rim_px(figure.camera, &figure.cam_from_target, feature, 64);
        if rim.is_empty() {
            continue;
        }
        let mut shape = Shape { feature, low: rim[0], high: rim[0] };
        for q in &rim {
            shape.low = shape.low.inf(q);
            shape.high = shape.high.sup(q);
        }
        // The box of 64 points falls short of that of the curve by less than 0.2 % of its size.
        let slack = (shape.high - shape.low) * 0.01 + Vector2::new(1.0, 1.0);
        shape.low -= slack;
        shape.high += slack;
        let z = feature.center_mm.z;
        match levels.iter_mut().find(|(at, _)| *at == z) {
            Some((_, level)) => level.shapes.push(shape),
            None => levels.push((z, Level { plane: SeenPlane::new(&figure.cam_from_target, z), shapes: vec![shape] })),
        }
    }
    levels.into_iter().map(|(_, level)| level).collect()
}

/// Grey of every pixel in parts of full scale, row by row: `ground(q) + blurred (inside * contrast(q))`.
pub(super) fn render(
    figure: &Figure,
    blur_sigma_px: f64,
    ground: &dyn Fn(&Vector2<f64>) -> f64,
    contrast: &dyn Fn(&Vector2<f64>) -> f64,
) -> Vec<f64> {
    let [width, height] = figure.camera.size_px;
    let kernel = Kernel::new(blur_sigma_px);
    let levels = levels(figure);
    let mut image = Vec::with_capacity(width * height);
    for v in 0..height {
        image.extend((0..width).map(|u| ground(&Vector2::new(u as f64, v as f64))));
    }
    for top in (0..height).step_by(TILE_PX) {
        for left in (0..width).step_by(TILE_PX) {
            let tile = Tile::new(left, top, TILE_PX.min(width - left), TILE_PX.min(height - top), &kernel);
            let Some(cover) = tile.cover(figure.camera, &levels) else { continue };
            let shade = tile.shade(&cover, contrast);
            tile.add(&cover, &shade, &kernel, &mut image, width);
        }
    }
    image
}

/// Part of every cell of a tile that is inside an outline, row by row, and which pixels have such cells.
struct Cover {
    cells: Vec<f64>,
    touched: Vec<bool>,
}

/// A square of the image with the margin that its convolution needs.
struct Tile {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    halo: usize,
    cells: usize,
}

impl Tile {
    fn new(left: usize, top: usize, width: usize, height: usize, kernel: &Kernel) -> Self {
        Self { left, top, width, height, halo: kernel.halo_px(), cells: kernel.cells }
    }
    fn columns(&self) -> usize {
        self.width + 2 * self.halo
    }
    fn rows(&self) -> usize {
        self.height + 2 * self.halo
    }
    /// Pixel of a column and row counted from the corner of the margin.
    fn pixel(&self, column: usize, row: usize) -> Vector2<f64> {
        let at = |start: usize, n: usize| start as f64 + n as f64 - self.halo as f64;
        Vector2::new(at(self.left, column), at(self.top, row))
    }

    /// What the outlines cover; none where no outline comes near.
    fn cover(&self, c: &PlacedCamera, levels: &[Level]) -> Option<Cover> {
        let half = Vector2::new(0.5, 0.5);
        let (low, high) = (self.pixel(0, 0) - half, self.pixel(self.columns() - 1, self.rows() - 1) + half);
        let mut cover: Option<Cover> = None;
        for level in levels {
            let near: Vec<&Shape> = level.shapes.iter().filter(|s| s.reaches(&low, &high)).collect();
            if near.is_empty() {
                continue;
            }
            let cover = cover.get_or_insert_with(|| Cover {
                cells: vec![0.0; self.columns() * self.rows() * self.cells * self.cells],
                touched: vec![false; self.columns() * self.rows()],
            });
            for row in (0..self.rows()).step_by(BLOCK_PX) {
                for column in (0..self.columns()).step_by(BLOCK_PX) {
                    self.cover_block(c, level, &near, [column, row], cover);
                }
            }
        }
        cover.filter(|c| c.touched.contains(&true))
    }

    /// Add the cover of one block: whole where its middle is deep enough inside, nothing where it is far outside.
    fn cover_block(&self, c: &PlacedCamera, level: &Level, near: &[&Shape], corner: [usize; 2], cover: &mut Cover) {
        let end = [(corner[0] + BLOCK_PX).min(self.columns()), (corner[1] + BLOCK_PX).min(self.rows())];
        let (first, last) = (self.pixel(corner[0], corner[1]), self.pixel(end[0] - 1, end[1] - 1));
        let half = Vector2::new(0.5, 0.5);
        let middle = level.plane.hit(c, &((first + last) * 0.5));
        for s in near.iter().filter(|s| s.reaches(&(first - half), &(last + half))) {
            if let Some(hit) = &middle {
                // The stretch may grow by half within a block, 5 % within a pixel, before a crossing is missed.
                let reach = 1.5 * stretch(&hit.dxy_dq) * std::f64::consts::FRAC_1_SQRT_2 * BLOCK_PX as f64;
                let depth = s.feature.outline.depth(&(hit.xy_mm - s.feature.center_mm.xy())).0;
                if depth <= -reach {
                    continue;
                }
                if depth >= reach {
                    for row in corner[1]..end[1] {
                        (corner[0]..end[0]).for_each(|column| self.fill(column, row, cover));
                    }
                    continue;
                }
            }
            for row in corner[1]..end[1] {
                for column in corner[0]..end[0] {
                    if let Some(hit) = level.plane.hit(c, &self.pixel(column, row)) {
                        self.cover_pixel(&level.plane, s.feature, &hit, [column, row], cover);
                    }
                }
            }
        }
    }

    fn first_cell(&self, column: usize, row: usize) -> usize {
        (row * self.columns() * self.cells + column) * self.cells
    }

    fn fill(&self, column: usize, row: usize, cover: &mut Cover) {
        cover.touched[row * self.columns() + column] = true;
        let first = self.first_cell(column, row);
        for j in 0..self.cells {
            cover.cells[first + j * self.columns() * self.cells..][..self.cells].fill(1.0);
        }
    }

    /// Add a feature's cover of the cells of one pixel.
    fn cover_pixel(&self, plane: &SeenPlane, feature: &Feature, hit: &Hit, at: [usize; 2], cover: &mut Cover) {
        let [column, row] = at;
        let stretch = 1.05 * stretch(&hit.dxy_dq) * std::f64::consts::FRAC_1_SQRT_2;
        let depth = feature.outline.depth(&(hit.xy_mm - feature.center_mm.xy())).0;
        if depth <= -stretch {
            return;
        }
        if depth >= stretch {
            return self.fill(column, row, cover);
        }
        cover.touched[row * self.columns() + column] = true;
        let (h, first) = (1.0 / self.cells as f64, self.first_cell(column, row));
        for j in 0..self.cells {
            for i in 0..self.cells {
                let step = Vector2::new((i as f64 + 0.5) * h - 0.5, (j as f64 + 0.5) * h - 0.5);
                let cell = &mut cover.cells[first + j * self.columns() * self.cells + i];
                *cell = (*cell + cover_cell(plane, feature, hit, &step, h, stretch)).min(1.0);
            }
        }
    }

    /// The contrast at every pixel that has covered cells, and at their neighbours.
    fn shade(&self, cover: &Cover, contrast: &dyn Fn(&Vector2<f64>) -> f64) -> Vec<f64> {
        let (columns, rows) = (self.columns(), self.rows());
        let mut shade = vec![0.0; columns * rows];
        for row in 0..rows {
            for column in 0..columns {
                let mut around = (row.saturating_sub(1)..(row + 2).min(rows))
                    .flat_map(|r| (column.saturating_sub(1)..(column + 2).min(columns)).map(move |c| r * columns + c));
                if around.any(|n| cover.touched[n]) {
                    shade[row * columns + column] = contrast(&self.pixel(column, row));
                }
            }
        }
        shade
    }

    /// Convolve inside times contrast and add it to the image.
    fn add(&self, cover: &Cover, shade: &[f64], kernel: &Kernel, image: &mut [f64], image_width: usize) {
        let (s, stride) = (self.cells, self.columns() * self.cells);
        let skip = self.halo * s - kernel.reach;
        let across = self.between(self.columns());
        let down = self.between(self.rows());
        let mut line = vec![0.0; stride];
        let mut narrow = vec![0.0; self.rows() * s * self.width];
        for (y, out) in narrow.chunks_exact_mut(self.width).enumerate() {
            let covered = &cover.cells[y * stride..][..stride];
            let Some(first) = covered.iter().position(|&c| c > 0.0) else { continue };
            let last = covered.iter().rposition(|&c| c > 0.0).unwrap_or(first);
            let (r0, r1, fy) = down[y];
            let (upper, lower) = (&shade[r0 * self.columns()..], &shade[r1 * self.columns()..]);
            for (x, value) in line.iter_mut().enumerate() {
                let part = covered[x];
                let (c0, c1, fx) = across[x];
                let a = upper[c0] + fx * (upper[c1] - upper[c0]);
                let b = lower[c0] + fx * (lower[c1] - lower[c0]);
                *value = if part == 0.0 { 0.0 } else { part * (a + fy * (b - a)) };
            }
            let reached = (last + s).saturating_sub(skip) / s;
            let begin = (first + 1).saturating_sub(skip + kernel.weights.len()) / s;
            for (u, o) in out.iter_mut().enumerate().take(reached).skip(begin) {
                let from = u * s + skip;
                *o = kernel.weights.iter().zip(&line[from..]).map(|(w, l)| w * l).sum();
            }
        }
        for v in 0..self.height {
            let row = &mut image[(self.top + v) * image_width + self.left..][..self.width];
            for (k, w) in kernel.weights.iter().enumerate() {
                let from = &narrow[(v * s + skip + k) * self.width..][..self.width];
                row.iter_mut().zip(from).for_each(|(r, n)| *r += w * n);
            }
        }
    }

    /// For every cell along one direction of `pixels` pixels: the two pixel centres around it and its place between.
    fn between(&self, pixels: usize) -> Vec<(usize, usize, f64)> {
        let place = |cell: usize| {
            let x = ((cell as f64 + 0.5) / self.cells as f64 - 0.5).clamp(0.0, (pixels - 1) as f64);
            let low = x.floor();
            (low as usize, (low as usize + 1).min(pixels - 1), x - low)
        };
        (0..pixels * self.cells).map(place).collect()
    }
}

/// Part of a cell of width `h` px, `step` px from the pixel of `hit`, that is inside the outline.
fn cover_cell(plane: &SeenPlane, f: &Feature, hit: &Hit, step: &Vector2<f64>, h: f64, stretch: f64) -> f64 {
    let center = f.center_mm.xy();
    let Some(p) = plane.beside(hit, step) else { return 0.0 };
    let depth = f.outline.depth(&(p - center)).0;
    if depth.abs() >= stretch * h {
        return f64::from(u8::from(depth > 0.0));
    }
    let part = h / PARTS as f64;
    let mut sum = 0.0;
    for j in 0..PARTS {
        for i in 0..PARTS {
            let at = step + Vector2::new((i as f64 + 0.5) * part - 0.5 * h, (j as f64 + 0.5) * part - 0.5 * h);
            let Some(p) = plane.beside(hit, &at) else { continue };
            let (depth, inwards) = f.outline.depth(&(p - center));
            let gradient = hit.dxy_dq.tr_mul(&inwards);
            let steepness = gradient.norm();
            sum += covered(depth / steepness, gradient.x / steepness, gradient.y / steepness, part);
        }
    }
    sum / (PARTS * PARTS) as f64
}

#[cfg(test)]
mod tests;
