//! The paper's step alone: cameras known, three unknowns (a, b, c) from the transfer of one camera's features to the other.
//!
//! A feature q1 of the first camera goes back along its ray r to the plane, `p = r / (abc . r)`, and on into the second camera; the
//! residual is `q2 - image(p)`. Tilt and distortion stay in both cameras.
//!
//! Sigmas: `C = N^-1 (J^T S J + G C_cameras G^T) N^-1` with `N = J^T J`, S the covariance of the residuals, and G the change of
//! `J^T r` by the cameras' parameters. Without the second part they would be 5 to 1000 times too small. Where a parameter of
//! the cameras is not determined, no sigma of the sheet exists. The eight points of a pair hold ten numbers (two ellipses): with
//! T = dq/dq1 the transfer's derivative, `S = S_2 + T S_1 T^T`, both by the covariances of the fits.
//!
//! Where features scatter by more than S and the cameras explain (a plate that is not flat), S grows to what they show:
//! ```text
//! E |r|^2 = tr(P S) + tr(K),   K = C_cameras D^T P D,   P = 1 - J N^-1 J^T,   D the change of r by the cameras' parameters
//! more    = |r|^2 - E |r|^2            where that is beyond 3 (2 tr(S^2) + 2 tr(K^2))^(1/2), or else 0
//! scale^2 = 1 + (more - 3 (2 tr(K^2))^(1/2)) / tr(P S)     1 at least
//! ```
//! What cameras may do by chance is left to them: where K is far larger than S it would otherwise be blamed on the features. In a calibration, whose
//! cameras have seen these features, the expected sum is a little too large, and the scale too small.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | r | [`transfer_residuals`] | 16 per pair of discs | px (second camera) | u and v of the transfer errors |
//! | J | `by_abc` | 16 per pair x 3 | px mm | r by (a, b, c) of the rig frame |
//! | S | `covariance_px2`, `by_features` = J^T S J | 16 x 16 per pair | px^2 | covariance of r by the contours |
//! | D | `moved` | 16 per pair x parameters | px per unit | r by the cameras' parameters |
//! | scale | [`Homography::scatter`] | 1 | 1 | how much larger the features' noise is than said |
//!
//! Source of the scale: mean tr(A C) and variance 2 tr((A C)^2) of a quadratic form x^T A x of normal numbers with covariance C.
//!
//! The sheet moves with the cameras it was found with: left steps (w, v) of its frame are `-L N^-1 G` times the cameras' errors (L: w and v
//! by abc), and have that much in common with them ([`Homography::with_sheet`]).
//!
//! Start: the features of both cameras meet near points p (middle of the shortest line between their rays); `abc . p = 1` is
//! linear in abc.

use super::features::{PairCovariance, PairFeatures, TOUCHING, derivative};
use super::rows::with_sheet;
use super::{Placement, SheetEstimate, plane_geometry, sigmas};
use crate::bundle::{NamedCovariance, Parameter, ParameterSteps};
use crate::camera::Camera;
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Rig};
use crate::record::Covariance;
use crate::rigid::Motion;
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Matrix6, OMatrix, SMatrix, U6, Vector2, Vector3};

/// Result of [`fit_homography`].
#[derive(Debug, Clone, PartialEq)]
pub struct Homography {
    /// The plane with its sigmas, those of the cameras included.
    pub estimate: SheetEstimate,
    /// Root mean square transfer error, px.
    pub transfer_rms_px: f64,
    /// How many times as much as their contours say the features scatter, beyond what the cameras' uncertainty explains; 1 where that is no more than chance.
    pub scatter: f64,
    /// Left steps of the sheet by the cameras' numbers, and their covariance; none where the cameras are not determined.
    steps: Option<(OMatrix<f64, U6, Dyn>, Matrix6<f64>)>,
}

impl Homography {
    /// The covariance that the cameras were held with, and rows of the sheet found; `None` where it does not determine the sheet.
    pub fn with_sheet(&self, held: &HeldCameras, covariance: &Covariance) -> Option<Covariance> {
        let (by_number, own) = self.steps.as_ref()?;
        let rows: Option<Vec<usize>> = held.names.iter().map(|n| covariance.index(n)).collect();
        Some(with_sheet(covariance, &rows?, by_number, own))
    }
}

/// Cameras as the transfer sees them.
#[derive(Debug, Clone)]
struct Pair {
    cameras: [Camera; 2],
    second_from_first: Motion<Cam, Rig>,
}

/// Two cameras that are held, with what is known of them.
#[derive(Debug, Clone)]
pub struct HeldCameras {
    pair: Pair,
    parameters: Vec<Parameter>,
    /// Theirs.
    names: Vec<String>,
    covariance: DMatrix<f64>,
}

impl HeldCameras {
    /// Cameras, motion between them (second camera from rig), their names, and a covariance whose rows have names such as
    /// `left.f_px` and `right.cam_from_rig.rx_rad`; rows of anything else are left aside. A variance that is `NaN` means a
    /// parameter that nothing determines.
    pub fn new(
        cameras: [Camera; 2],
        second_from_first: Motion<Cam, Rig>,
        camera_names: [&str; 2],
        names: &[String],
        covariance: &DMatrix<f64>,
    ) -> Self {
        let parameter = |name: &String| Parameter::of(name, camera_names).filter(|p| !matches!(p, Parameter::Sheet(_)));
        let own: Vec<(usize, Parameter)> =
            names.iter().enumerate().filter_map(|(i, n)| Some((i, parameter(n)?))).collect();
        // A number without variance does not move.
        let own: Vec<(usize, Parameter)> = own.into_iter().filter(|(i, _)| covariance[(*i, *i)] != 0.0).collect();
        Self {
            pair: Pair { cameras, second_from_first },
            covariance: DMatrix::from_fn(own.len(), own.len(), |i, j| covariance[(own[i].0, own[j].0)]),
            names: own.iter().map(|(i, _)| names[*i].clone()).collect(),
            parameters: own.into_iter().map(|(_, h)| h).collect(),
        }
    }

    /// The first two cameras of an adjustment.
    pub fn of(covariance: &NamedCovariance, camera_names: [&str; 2]) -> Self {
        let natural = &covariance.natural;
        let mut matrix = covariance.matrix.clone();
        for i in (0..covariance.names.len()).filter(|i| !covariance.determined[*i]) {
            matrix[(i, i)] = f64::NAN;
        }
        let cameras = [natural.cameras[0], natural.cameras[1]];
        Self::new(cameras, natural.cam_from_rig[1], camera_names, &covariance.names, &matrix)
    }

    /// The two cameras.
    pub fn cameras(&self) -> [&Camera; 2] {
        [&self.pair.cameras[0], &self.pair.cameras[1]]
    }

    /// Whether the plane `abc . p = 1` of the rig frame lies between the cameras.
    pub fn on_opposite_sides(&self, abc_per_mm: &Vector3<f64>) -> bool {
        abc_per_mm.dot(&self.pair.second_from_first.inverse().translation_mm) > 1.0
    }

    /// Standard deviation of a parameter, `None` where it is not determined.
    fn sigma(&self, k: usize) -> Option<f64> {
        let s = self.covariance[(k, k)].sqrt();
        (s.is_finite() && s > 0.0).then_some(s)
    }

    /// The cameras after a change of one parameter.
    fn stepped(&self, parameter: Parameter, h: f64) -> Option<Pair> {
        let (steps, pair) = (ParameterSteps::one(parameter, h), &self.pair);
        Some(Pair {
            cameras: [steps.camera(0, &pair.cameras[0])?, steps.camera(1, &pair.cameras[1])?],
            second_from_first: steps.motion(&pair.second_from_first),
        })
    }
}

/// Residual and its derivative by (a, b, c); `None` where a feature does not transfer.
fn transfer(
    pair: &Pair,
    abc: &Vector3<f64>,
    q1: &Vector2<f64>,
    q2: &Vector2<f64>,
) -> Option<(Vector2<f64>, SMatrix<f64, 2, 3>)> {
    let ray = pair.cameras[0].ideal_of_pixel(q1).ok()?.push(1.0);
    let along = abc.dot(&ray);
    if !(along > 0.0) {
        return None;
    }
    let p = ray / along;
    let (q, dq_dp) = pair.cameras[1].image_of_point(&pair.second_from_first.apply(&p)).ok()?;
    // dp/dabc = -r r^T / (abc . r)^2
    let dp = -(ray * ray.transpose()) / (along * along);
    Some((q2 - q, -(dq_dp * pair.second_from_first.rotation * dp)))
}

/// `J^T J`, `J^T r`, sum of squares, count.
fn normals(
    pair: &Pair,
    abc: &Vector3<f64>,
    features: &[PairFeatures],
) -> Option<(Matrix3<f64>, Vector3<f64>, f64, f64)> {
    let (mut n, mut b, mut sum, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0, 0.0);
    for f in features {
        for (q1, q2) in f.first_px.iter().zip(&f.second_px) {
            let (r, j) = transfer(pair, abc, q1, q2)?;
            n += j.tr_mul(&j);
            b += j.tr_mul(&r);
            sum += r.norm_squared();
            count += 1.0;
        }
    }
    Some((n, b, sum, count))
}

fn minimum(pair: &Pair, start: &Vector3<f64>, features: &[PairFeatures]) -> Option<Vector3<f64>> {
    let mut abc = *start;
    let mut cost = normals(pair, &abc, features)?.2;
    for _ in 0..50 {
        let (n, b, _, _) = normals(pair, &abc, features)?;
        let mut step = -(n.cholesky()?.solve(&b));
        let size = (step.dot(&(n * step))).sqrt();
        // Halve until the transfer error falls.
        let mut moved = false;
        for _ in 0..30 {
            if let Some((_, _, c, _)) = normals(pair, &(abc + step), features) {
                if c <= cost {
                    (abc, cost, moved) = (abc + step, c, true);
                    break;
                }
            }
            step /= 2.0;
        }
        if !moved || size < 1e-10 {
            break;
        }
    }
    Some(abc)
}

/// The plane through the points in which features of both cameras nearly meet, as (a, b, c), 1/mm; `None` where they do not
/// meet in front of both cameras or do not span a plane.
pub fn triangulated_plane(held: &HeldCameras, features: &[PairFeatures]) -> Option<Vector3<f64>> {
    let pair = &held.pair;
    let first_from_second = pair.second_from_first.inverse();
    let center = first_from_second.translation_mm;
    let (mut n, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for f in features {
        for (q1, q2) in f.first_px.iter().zip(&f.second_px) {
            let r1 = pair.cameras[0].ideal_of_pixel(q1).ok()?.push(1.0);
            let r2 = first_from_second.rotation * pair.cameras[1].ideal_of_pixel(q2).ok()?.push(1.0);
            // s r1 and center + t r2 are nearest to one another.
            let (aa, ab, bb) = (r1.dot(&r1), r1.dot(&r2), r2.dot(&r2));
            let determinant = aa * bb - ab * ab;
            if !(determinant > 1e-12 * aa * bb) {
                return None;
            }
            let s = (bb * r1.dot(&center) - ab * r2.dot(&center)) / determinant;
            let t = (ab * r1.dot(&center) - aa * r2.dot(&center)) / determinant;
            if !(s > 0.0 && t > 0.0) {
                return None;
            }
            let p = 0.5 * (r1 * s + center + r2 * t);
            n += p * p.transpose();
            b += p;
        }
    }
    Some(n.cholesky()?.solve(&b))
}

/// The plane from features of views recorded in the sheet, cameras held; `start` is any plane in front of both cameras.
///
/// # Errors
/// [`Insufficient::Degenerate`] where there are no features or they do not fix a plane.
pub fn fit_homography(held: &HeldCameras, features: &[PairFeatures], start: &Vector3<f64>) -> Result<Homography> {
    fit_placed_homography(held, features, start, &Placement::default())
}

/// [`fit_homography`] with the sheet frame where `placement` says.
///
/// # Errors
/// As [`fit_homography`].
pub fn fit_placed_homography(
    held: &HeldCameras,
    features: &[PairFeatures],
    start: &Vector3<f64>,
    placement: &Placement,
) -> Result<Homography> {
    let degenerate = || {
        Insufficient::Degenerate(
            "the discs recorded in the sheet do not fix its plane; record the target at two or more places of the sheet, \
             seen by both cameras"
                .into(),
        )
    };
    let pair = &held.pair;
    let abc = minimum(pair, start, features).ok_or_else(degenerate)?;
    let (n, _, sum, count) = normals(pair, &abc, features).ok_or_else(degenerate)?;
    let inverse = n.try_inverse().ok_or_else(degenerate)?;
    let length = abc.norm();
    let center = |x: &Pair| x.second_from_first.inverse().translation_mm;
    let geometry = plane_geometry(abc / length, 1.0 / length, Some(center(pair)), placement);
    let turn = seven_by_abc(&geometry.estimate.normal, geometry.estimate.distance_mm);
    // Seven numbers (w, n . v, centre) by abc; the cameras' share by finite change of the normal equations.
    let mut by_camera = DMatrix::<f64>::zeros(7, held.parameters.len());
    let mut moved = DMatrix::<f64>::zeros(2 * TOUCHING * features.len(), held.parameters.len());
    let mut determined = true;
    for (k, parameter) in held.parameters.iter().enumerate() {
        let Some(sigma) = held.sigma(k) else {
            determined = false;
            continue;
        };
        let h = 0.1 * sigma;
        let (p, m) = held.stepped(*parameter, h).zip(held.stepped(*parameter, -h)).ok_or_else(degenerate)?;
        let g = |x: &Pair| normals(x, &abc, features).map(|v| v.1);
        let (gp, gm) = g(&p).zip(g(&m)).ok_or_else(degenerate)?;
        let dabc = -(inverse * (gp - gm) / (2.0 * h));
        let left = |x: &Pair| residuals(x, &abc, features);
        let (rp, rm) = left(&p).zip(left(&m)).ok_or_else(degenerate)?;
        moved.set_column(k, &((rp - rm) / (2.0 * h)));
        by_camera.fixed_view_mut::<4, 1>(0, k).copy_from(&(turn * dabc));
        by_camera.fixed_view_mut::<3, 1>(4, k).copy_from(&((center(&p) - center(&m)) / (2.0 * h)));
    }
    let mut estimate = geometry.estimate;
    let (mut steps, mut scatter) = (None, 1.0);
    if determined {
        let expected = Expected::of(pair, &abc, features).ok_or_else(degenerate)?;
        scatter = expected.scatter(sum, &inverse, &moved, &held.covariance);
        let cameras = &by_camera * &held.covariance * by_camera.transpose();
        let mut seven = SMatrix::<f64, 7, 7>::from_fn(|i, j| cameras[(i, j)]);
        let noise = inverse * expected.by_features * inverse * (scatter * scatter);
        let own = turn * noise * turn.transpose();
        let mut corner = seven.fixed_view_mut::<4, 4>(0, 0);
        corner += own;
        estimate.sigmas = sigmas(&(geometry.derivative * seven * geometry.derivative.transpose()));
        let by_four = step_by_four(&estimate);
        let own = by_four * seven.fixed_view::<4, 4>(0, 0) * by_four.transpose();
        steps = Some((by_four * by_camera.rows(0, 4), own));
    }
    Ok(Homography { estimate, transfer_rms_px: (sum / count).sqrt(), scatter, steps })
}

/// Left step of the sheet by turn w and shift n . v, its origin moving along the normal alone: `v = P [t]x w + n (n . v)`.
fn step_by_four(sheet: &SheetEstimate) -> SMatrix<f64, 6, 4> {
    let n = &sheet.normal;
    let project = Matrix3::identity() - n * n.transpose();
    let mut out = SMatrix::<f64, 6, 4>::identity();
    out.fixed_view_mut::<3, 3>(3, 0).copy_from(&(project * crate::rigid::skew(&sheet.rig_from_sheet.translation_mm)));
    out.fixed_view_mut::<3, 1>(3, 3).copy_from(n);
    out
}

/// Standard deviations of the sum of squares by which it has to be larger than expected before features are taken to scatter more than they say.
const MORE_THAN_CHANCE: f64 = 3.0;

/// What residuals are expected to be by the covariance S of the features.
struct Expected {
    /// J, rows as the residuals.
    by_abc: DMatrix<f64>,
    /// J^T S J.
    by_features: Matrix3<f64>,
    /// Traces of S and of its square.
    trace: f64,
    trace_of_square: f64,
}

impl Expected {
    /// `None` where a feature does not transfer.
    fn of(pair: &Pair, abc: &Vector3<f64>, features: &[PairFeatures]) -> Option<Self> {
        let by_abc = DMatrix::zeros(2 * TOUCHING * features.len(), 3);
        let mut out = Self { by_abc, by_features: Matrix3::zeros(), trace: 0.0, trace_of_square: 0.0 };
        for (i, f) in features.iter().enumerate() {
            let mut j = SMatrix::<f64, { 2 * TOUCHING }, 3>::zeros();
            let mut by_first = PairCovariance::zeros();
            for (k, (q1, q2)) in f.first_px.iter().zip(&f.second_px).enumerate() {
                j.fixed_view_mut::<2, 3>(2 * k, 0).copy_from(&transfer(pair, abc, q1, q2)?.1);
                let t = derivative(q1, |q| transfer(pair, abc, &q, q2).map(|r| r.0))?;
                by_first.fixed_view_mut::<2, 2>(2 * k, 2 * k).copy_from(&t);
            }
            let [first, second] = &f.covariance_px2;
            let s = second + by_first * first * by_first.transpose();
            out.by_abc.fixed_view_mut::<{ 2 * TOUCHING }, 3>(2 * TOUCHING * i, 0).copy_from(&j);
            out.by_features += j.tr_mul(&(s * j));
            out.trace += s.trace();
            out.trace_of_square += s.norm_squared();
        }
        Some(out)
    }

    /// How many times as much the features scatter, from the sum of squares, `N^-1`, the change of the residuals by the cameras' parameters, and their
    /// covariance.
    fn scatter(&self, sum: f64, inverse: &Matrix3<f64>, moved: &DMatrix<f64>, covariance: &DMatrix<f64>) -> f64 {
        let projected = moved - &self.by_abc * (inverse * self.by_abc.tr_mul(moved));
        let cameras = covariance * moved.tr_mul(&projected);
        let features = self.trace - (inverse * self.by_features).trace();
        let by_cameras = 2.0 * (&cameras * &cameras).trace();
        let more = sum - cameras.trace() - features;
        let chance = |variance: f64| MORE_THAN_CHANCE * variance.sqrt();
        if !(more > chance(2.0 * self.trace_of_square + by_cameras)) {
            return 1.0;
        }
        (1.0 + (more - chance(by_cameras)).max(0.0) / features).sqrt()
    }
}

/// Transfer errors in the order of the features, u and v of each; `None` where a feature does not transfer.
fn residuals(pair: &Pair, abc: &Vector3<f64>, features: &[PairFeatures]) -> Option<DVector<f64>> {
    let each = features.iter().flat_map(|f| f.first_px.iter().zip(&f.second_px));
    let all: Option<Vec<Vector2<f64>>> = each.map(|(q1, q2)| Some(transfer(pair, abc, q1, q2)?.0)).collect();
    Some(DVector::from_vec(all?.iter().flat_map(|r| [r.x, r.y]).collect()))
}

/// Turn w (perpendicular to n) and shift n . v by abc: `dn = d P dabc`, `w = n x dn`, `dd = -d^2 n . dabc`.
fn seven_by_abc(n: &Vector3<f64>, d: f64) -> SMatrix<f64, 4, 3> {
    let mut out = SMatrix::<f64, 4, 3>::zeros();
    let project = Matrix3::identity() - n * n.transpose();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&(crate::rigid::skew(n) * project * d));
    out.fixed_view_mut::<1, 3>(3, 0).copy_from(&(-(n.transpose()) * (d * d)));
    out
}

/// Transfer errors of features over a plane, px: what is left between the cameras in the sheet (disparity); `None` for a
/// feature that does not transfer.
pub fn transfer_residuals(
    held: &HeldCameras,
    abc_per_mm: &Vector3<f64>,
    features: &[PairFeatures],
) -> Vec<Option<Vector2<f64>>> {
    let each = |f: &PairFeatures| -> Vec<Option<Vector2<f64>>> {
        let pixels = f.first_px.iter().zip(&f.second_px);
        pixels.map(|(a, b)| transfer(&held.pair, abc_per_mm, a, b).map(|r| r.0)).collect()
    };
    features.iter().flat_map(each).collect()
}
