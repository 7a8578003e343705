//! Tangent residuals: the bitangent features of a pair of discs against the images of the circles' own features.
//!
//! `r = W (f + G (i - i0) + D (o - o0) - image of F(c0, r0, c1, r1))`, W the whitening of the features' rank-10 covariance, so that r has
//! unit variance; F in closed form ([`crate::bitangent::circle_features`]), its derivative by the shape of the target through
//! those of centres and radii; G (px per unit) how features found through the lens i0 follow another lens i, and D (px/mm) how those found with the
//! ovality o0 (mm, a and b of either disc in the target frame) taken off their contours follow another o ([`super::refit`]). Equal
//! radii have no external crossing: a state with them is refused where that point was kept. The robust loss sees the pair as one,
//! with a threshold grown by the root of its rank.
//!
//! The features of a pair are imaged side by side (see [`crate::lanes`]), and the products with W and of its rows run along the columns of
//! the camera space that are in use, the residual being one more.

use super::assemble::{ImageNormal, LOCAL, SPACE, SeenImage};
use super::edges::{Columns, allows};
use super::model::{Loss, OvalDependence, PairObservation};
use super::tie::Tied;
use crate::bitangent::{EXTERNAL_CROSSING, FROM_BEHIND, POINTS, circle_features};
use crate::camera::{Camera, INTRINSICS, LaneCamera};
use crate::lanes::{self, GROUP, Kernel, Lanes, splats};
use nalgebra::{Matrix3x2, SMatrix, SVector, Vector3};

/// The loss of so many numbers that are judged together.
pub(super) fn pair_loss(loss: Loss, rank: usize) -> Loss {
    let root = (rank as f64).sqrt();
    match loss {
        Loss::None => Loss::None,
        Loss::Huber(k) => Loss::Huber(k * root),
        Loss::Cauchy(k) => Loss::Cauchy(k * root),
    }
}

/// Derivative of `(x0, y0, r0, x1, y1, r1)` by the three shape parameters.
fn circles_by_shape(image: &SeenImage, discs: [usize; 2]) -> SMatrix<f64, 6, 3> {
    let mut out = SMatrix::zeros();
    for (n, j) in discs.into_iter().enumerate() {
        let d = image.model.target.disc_derivative(j);
        for k in 0..3 {
            out[(3 * n, k)] = d[0][k];
            out[(3 * n + 1, k)] = d[1][k];
            out[(3 * n + 2, k)] = d[3][k];
        }
    }
    out
}

/// Columns of a row: the camera space and the residual, filled up to whole groups.
const WIDE: usize = (LOCAL + 1).next_multiple_of(GROUP);
/// Where no more are in use.
const NARROW: usize = WIDE - GROUP;

/// Memory that is used again from pair to pair.
#[derive(Debug)]
pub(super) struct Scratch {
    imaged: Imaged,
    gap: [f64; 2 * POINTS],
    /// Per coordinate of a feature the derivative of its image by the columns in use, then the gap.
    rows: [[f64; WIDE]; 2 * POINTS],
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            imaged: [[[0.0; 2 * GROUP]; 4 + INTRINSICS]; 2],
            gap: [0.0; 2 * POINTS],
            rows: [[0.0; WIDE]; 2 * POINTS],
        }
    }
}

/// Images of points with their derivatives by the point and by the intrinsics.
struct Images<'a> {
    camera: &'a Camera,
    points: &'a [[f64; POINTS]; 3],
    n: usize,
    out: &'a mut Imaged,
}

/// Pixel, its derivative by the point, by the intrinsics; of the u and of the v coordinate.
type Imaged = [[[f64; 2 * GROUP]; 4 + INTRINSICS]; 2];

impl Kernel for Images<'_> {
    type Output = Option<()>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<()> {
        let (camera, out) = (LaneCamera::<L>::of(self.camera)?, self.out);
        for i in (0..self.n).step_by(L::N) {
            let mut p = [L::splat(0.0); 3];
            for (p, points) in p.iter_mut().zip(self.points) {
                let mut place = [0.0; GROUP];
                for (l, x) in place[..L::N].iter_mut().enumerate() {
                    // Past the end the last point once more.
                    *x = points[(i + l).min(self.n - 1)];
                }
                *p = L::load(&place);
            }
            let image = camera.image(p);
            if !L::all(image.valid) {
                return None;
            }
            for (s, n) in [[1.0, 0.0], [0.0, 1.0]].into_iter().enumerate() {
                let (by_point, by_intrinsics) = camera.derivative(&image, splats(n));
                let pixel = if s == 0 { image.u } else { image.v };
                pixel.store(&mut out[s][0][i..]);
                for (k, x) in by_point.into_iter().chain(by_intrinsics).enumerate() {
                    x.store(&mut out[s][1 + k][i..]);
                }
            }
        }
        Some(())
    }
}

/// The same for a camera that lanes do not serve.
fn plain_images(camera: &Camera, points: &[[f64; POINTS]; 3], n: usize, out: &mut Imaged) -> Option<()> {
    for i in 0..n {
        let jet = camera.project_jet(&Vector3::new(points[0][i], points[1][i], points[2][i])).ok()?;
        for (s, out) in out.iter_mut().enumerate() {
            out[0][i] = jet.pixel[s];
            (0..3).for_each(|k| out[1 + k][i] = jet.dq_dp[(s, k)]);
            (0..INTRINSICS).for_each(|k| out[4 + k][i] = jet.dq_dintrinsics[(s, k)]);
        }
    }
    Some(())
}

/// Gaps of the features that were kept, observed minus predicted, and minus their derivatives; `None` where they have no image.
fn gaps(image: &SeenImage, pair: &PairObservation, columns: Option<&Columns>, scratch: &mut Scratch) -> Option<()> {
    let camera = &image.camera.camera;
    // Behind a window circles have no tangents in common with their images.
    if camera.window().is_some() {
        return None;
    }
    let ((c0, r0), (c1, r1)) = (image.disc(pair.discs[0]), image.disc(pair.discs[1]));
    let features = circle_features(c0.xy(), r0, c1.xy(), r1).ok()?;
    if pair.kept.contains(&EXTERNAL_CROSSING) && !features.external_is_finite {
        return None;
    }
    let (motion, n) = (&image.cam_from_target, pair.kept.len());
    let behind = motion.rotation.column(2).dot(&motion.translation_mm) > 0.0;
    let on_target = |k: usize| if behind { FROM_BEHIND[k] } else { k };
    let mut points = [[0.0; POINTS]; 3];
    for (row, &k) in pair.kept.iter().enumerate() {
        let k = on_target(k);
        let p = motion.apply(&Vector3::new(features.points_mm[2 * k], features.points_mm[2 * k + 1], c0.z));
        (0..3).for_each(|i| points[i][row] = p[i]);
    }
    let Scratch { imaged, gap, rows } = scratch;
    match allows(camera) {
        true => lanes::run(Images { camera, points: &points, n, out: imaged })?,
        false => plain_images(camera, &points, n, imaged)?,
    };
    (0..2 * n).for_each(|j| gap[j] = pair.pixels_px[j] - imaged[j % 2][0][j / 2]);
    if let Some(lens) = &pair.lens {
        let now = camera.intrinsics().to_array();
        let change = SVector::<f64, INTRINSICS>::from_fn(|i, _| now[i] - lens.intrinsics[i]);
        (0..2 * n).for_each(|j| gap[j] += lens.derivative.row(j).iter().zip(&change).map(|(d, c)| d * c).sum::<f64>());
    }
    if let Some(ovals) = &pair.ovals {
        let change = oval_change(image, pair, ovals);
        (0..2 * n).for_each(|j| gap[j] += ovals.derivative.row(j).iter().zip(&change).map(|(d, c)| d * c).sum::<f64>());
    }
    let Some(columns) = columns else { return Some(()) };
    let by_shape = features.jacobian * circles_by_shape(image, pair.discs);
    let in_plane: Matrix3x2<f64> = motion.rotation.fixed_columns::<2>(0).into_owned();
    for j in 0..2 * n {
        let (row, of) = (j / 2, &imaged[j % 2]);
        let p = Vector3::new(points[0][row], points[1][row], points[2][row]);
        let g = Vector3::new(of[1][row], of[2][row], of[3][row]);
        let turn = p.cross(&g);
        let shape = in_plane.tr_mul(&g).transpose() * by_shape.fixed_rows::<2>(2 * on_target(pair.kept[row]));
        for (x, &k) in rows[j].iter_mut().zip(columns.list()) {
            *x = match k {
                k if k < INTRINSICS => of[4 + k][row] - pair.lens.as_ref().map_or(0.0, |l| l.derivative[(j, k)]),
                k if k < INTRINSICS + 3 => turn[k - INTRINSICS],
                k if k < SPACE => g[k - INTRINSICS - 3],
                k if k < LOCAL => shape[k - SPACE],
                // Discs are not estimated from their tangents: a radius of its own moves nothing.
                _ => 0.0,
            };
        }
        rows[j][columns.list().len()] = gap[j];
    }
    Some(())
}

/// Ovality (a, b) of both discs less that which was taken off, mm.
fn oval_change(image: &SeenImage, pair: &PairObservation, ovals: &OvalDependence) -> [f64; 4] {
    let now = pair.discs.map(|disc| image.oval_mm(disc));
    std::array::from_fn(|k| now[k / 2][k % 2] - ovals.ovals_mm[k / 2][k % 2])
}

/// Cost of one pair; `None` where it has no image.
pub(super) fn cost(image: &SeenImage, pair: &PairObservation, scratch: &mut Scratch) -> Option<f64> {
    gaps(image, pair, None, scratch)?;
    let (rank, scale) = (pair.whitening.nrows(), image.observations.sigma_scale);
    let mut square = 0.0;
    for row in pair.whitening.row_iter() {
        let r: f64 = row.iter().zip(&scratch.gap).map(|(w, g)| w * g).sum();
        square += (r / scale).powi(2);
    }
    let rho = pair_loss(image.model.loss, rank).apply(square).0;
    rho.is_finite().then_some(0.5 * rho)
}

/// Adds one pair to the normal equations of its image; `None` where it has no image.
pub(super) fn linearise(
    image: &SeenImage,
    pair: &PairObservation,
    columns: &Columns,
    scratch: &mut Scratch,
    out: &mut ImageNormal<LOCAL>,
) -> Option<()> {
    gaps(image, pair, Some(columns), scratch)?;
    let (loss, scale) = (image.model.loss, image.observations.sigma_scale);
    let (list, rows) = (columns.list(), &scratch.rows);
    if let (Some(ovals), Some(_)) = (&pair.ovals, image.model.target.oval_sigma_mm) {
        return rows_with_ovals(pair, ovals, (loss, scale), (list, rows), out);
    }
    match list.len() < NARROW {
        true => lanes::run(Product::<NARROW> { pair, loss, scale, list, rows, out }),
        false => lanes::run(Product::<WIDE> { pair, loss, scale, list, rows, out }),
    }
}

/// Whitened rows, one by one: they move ovals as well, which are unknowns of all images.
fn rows_with_ovals(
    pair: &PairObservation,
    ovals: &OvalDependence,
    (loss, scale): (Loss, f64),
    (list, rows): (&[usize], &[[f64; WIDE]; 2 * POINTS]),
    out: &mut ImageNormal<LOCAL>,
) -> Option<()> {
    let white = |w: nalgebra::RowDVector<f64>| {
        let (mut row, mut by_mm, mut residual) = (SVector::<f64, LOCAL>::zeros(), [0.0; 4], 0.0);
        for (j, w) in w.iter().enumerate() {
            let factor = w / scale;
            list.iter().zip(&rows[j]).filter(|(k, _)| **k < LOCAL).for_each(|(k, x)| row[*k] += factor * x);
            (0..4).for_each(|k| by_mm[k] -= factor * ovals.derivative[(j, k)]);
            residual += factor * rows[j][list.len()];
        }
        (residual, row, by_mm)
    };
    let all: Vec<_> = pair.whitening.row_iter().map(|w| white(w.into_owned())).collect();
    let square = all.iter().map(|(r, _, _)| r * r).sum();
    let (rho, weight) = pair_loss(loss, all.len()).apply(square);
    let root = weight.sqrt();
    let weighed = |(r, row, by_mm): (f64, SVector<f64, LOCAL>, [f64; 4])| {
        Tied::of_pair(pair.discs, by_mm.map(|x| root * x), root * r, root * row)
    };
    out.tied.extend(all.into_iter().map(weighed));
    out.cost += 0.5 * rho;
    rho.is_finite().then_some(())
}

/// Whitens the rows and adds their products, `W` numbers of each.
struct Product<'a, const W: usize> {
    pair: &'a PairObservation,
    loss: Loss,
    scale: f64,
    list: &'a [usize],
    rows: &'a [[f64; WIDE]; 2 * POINTS],
    out: &'a mut ImageNormal<LOCAL>,
}

impl<const W: usize> Kernel for Product<'_, W> {
    type Output = Option<()>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<()> {
        let (list, out, w) = (self.list, self.out, &self.pair.whitening);
        let m = list.len();
        let (mut h, mut square) = ([[0.0; W]; W], 0.0);
        let inverse_scale = 1.0 / self.scale;
        for i in 0..w.nrows() {
            let mut white = [0.0; W];
            for (j, row) in self.rows.iter().enumerate().take(w.ncols()) {
                let factor = w[(i, j)] * inverse_scale;
                for c in 0..W {
                    white[c] += factor * row[c];
                }
            }
            square += white[m] * white[m];
            for (a, h) in h.iter_mut().enumerate().take(m) {
                for c in 0..W {
                    h[c] += white[a] * white[c];
                }
            }
        }
        let (rho, weight) = pair_loss(self.loss, w.nrows()).apply(square);
        for (h, &a) in h.iter().zip(list).filter(|(_, a)| **a < LOCAL) {
            out.b[a] += weight * h[m];
            for (&b, h) in list.iter().zip(h).filter(|(b, _)| **b < LOCAL) {
                out.h[(a, b)] += weight * h;
            }
        }
        out.cost += 0.5 * rho;
        rho.is_finite().then_some(())
    }
}
