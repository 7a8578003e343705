//! The laser sheet as a plane in the rig frame: from the joint adjustment, and by the paper's homography.
//!
//! ```text
//! n . p = d,   n away from the first camera, d > 0,   (a, b, c) = n / d
//! for a small turn w and shift v of the plane:   dn = w x n,   dd = n . v,   d(abc) = (w x n) / d - n (n . v) / d^2
//! angle to the baseline = asin (n . b),   b the unit vector between the projection centres
//! rig_from_sheet = Rx(theta1) Ry(theta2) Rz(theta3) up to the half turn about x that makes z face the camera
//! ```
//! Sheet frame: z = -n (w is positive towards the first camera), x the rig's x axis projected into the sheet, y = z cross x;
//! origin where the first camera's axis meets the sheet. With this choice of x, theta3 is zero. A [`Placement`] chooses
//! another origin and another direction p for x; then theta3 is the angle from the one projected direction to the other about
//! n, and since a projected direction e of p turns by `dphi = (e . w) (p . n) / (p . e)` for a turn w within the sheet,
//! ```text
//! dtheta3 = (e_p . w) (p . n) / (p . e_p) - (e_x . w) (x . n) / (x . e_x)
//! ```
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | n, d | [`SheetEstimate::normal`], `distance_mm` | 1, mm | Rig | plane |
//! | (a, b, c) | `abc_per_mm` | 1/mm | Rig | n / d; the paper's three unknowns |
//! | theta | `angles_rad` | rad | Rig | the paper's theta 1-3 |
//!
//! Source: the paper's section 4. Its eq 16 needs `-R_h^T t_h`, a 4x3 plane matrix `[I; n^T/d]` and a 3x3 `K1^-1`, and it
//! leaves the tilt out, worth 2.2 px of transfer error at the paper's geometry; here points go through both cameras whole.
//! Not valid for a plane through a projection centre.

mod features;
mod frame;
mod gain;
mod homography;
mod joint;
mod measured;
mod recorded;
mod rows;

pub use features::PairFeatures;
pub(crate) use frame::{by_steps, on_plane_of, pose_rows, standing_on, step_rows, with_frame, with_frame_on_axis};
pub use gain::{PointUncertainty, RESPONSES, Response, SheetUncertainty, StereoSheet};
pub(crate) use gain::{gain_row, in_plane_scale_row, unit};
pub use homography::{
    HeldCameras, Homography, fit_homography, fit_placed_homography, transfer_residuals, triangulated_plane,
};
pub use joint::{joint_sheet, placed_joint_sheet};
pub(crate) use recorded::covariance_of_record;
pub use recorded::determines_measurements;
pub(crate) use rows::with_sheet;

use crate::frames::{Plane, Rig, Sheet};
use crate::rigid::{Motion, PlaneAngle};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// A plane with its standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetEstimate {
    /// Unit normal in the rig frame, away from the first camera.
    pub normal: Vector3<f64>,
    /// Distance from the first projection centre, mm.
    pub distance_mm: f64,
    /// `n / d`, 1/mm.
    pub abc_per_mm: Vector3<f64>,
    /// theta 1-3, rad.
    pub angles_rad: [f64; 3],
    /// Angle between the sheet and the baseline from the first camera to the second, rad; positive where the baseline runs
    /// towards the sheet (second camera nearer to it, or beyond), negative where it runs away; `NaN` for a single camera.
    pub angle_to_baseline_rad: f64,
    /// Pose of the sheet frame.
    pub rig_from_sheet: Motion<Rig, Sheet>,
    /// Standard deviations in the order of [`SheetEstimate::QUANTITIES`].
    pub sigmas: SVector<f64, 10>,
}

impl SheetEstimate {
    /// What [`SheetEstimate::sigmas`] holds: distance (mm), turn about the sheet's x and y (rad), a, b, c (1/mm), theta 1-3
    /// (rad), angle to the baseline (rad).
    pub const QUANTITIES: usize = 10;
}

/// Where the sheet frame stands in the sheet; z is always towards the first camera.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Placement {
    /// A point in the rig frame whose foot on the sheet is the origin, mm; none: where the first camera's axis meets it.
    pub origin_in_rig_mm: Option<Vector3<f64>>,
    /// A direction in the rig frame that x follows; none: the rig's x axis. One along the normal has no meaning.
    pub x_in_rig: Option<Vector3<f64>>,
    /// x and y turned over.
    pub flip_x: bool,
}

impl Placement {
    /// How a sheet frame was placed: where it is not the default one, its own origin and x axis.
    pub fn of_frame(rig_from_sheet: &Motion<Rig, Sheet>) -> Self {
        let (t, x) = (rig_from_sheet.translation_mm, rig_from_sheet.rotation.column(0).into_owned());
        let n = -rig_from_sheet.rotation.column(2).into_owned();
        let on_axis = t.x.hypot(t.y) <= SAME_FRAME * t.norm();
        let along_rig = (x - laid(&Vector3::x(), &n).0).norm() <= SAME_FRAME;
        Self { origin_in_rig_mm: (!on_axis).then_some(t), x_in_rig: (!along_rig).then_some(x), flip_x: false }
    }
}

/// Frames that differ by less, relative, were placed in the same way.
const SAME_FRAME: f64 = 1e-9;

/// A direction laid into the plane of normal n, and how much it turns about n per turn of the plane along it.
fn laid(direction: &Vector3<f64>, n: &Vector3<f64>) -> (Vector3<f64>, f64) {
    let along = direction - n * n.dot(direction);
    let e = along.normalize();
    (e, direction.dot(n) / direction.dot(&e))
}

/// Geometry of a plane and the derivatives of everything that is reported by a small turn w, a shift along n, and the second
/// projection centre.
struct PlaneGeometry {
    estimate: SheetEstimate,
    /// Rows: the ten quantities; columns: turn w (3), shift n . v (1), second centre (3).
    derivative: SMatrix<f64, 10, 7>,
}

/// Frame and derived numbers of the plane `normal . p = distance`; `second_center_mm` in the rig frame.
fn plane_geometry(
    normal: Vector3<f64>,
    distance_mm: f64,
    second_center_mm: Option<Vector3<f64>>,
    placement: &Placement,
) -> PlaneGeometry {
    let plane = Plane::<Rig>::away_from_origin(normal, distance_mm);
    let (n, d) = (plane.normal.xyz, plane.distance_mm);
    let z = -n;
    let (default_x, default_turn) = laid(&Vector3::x(), &n);
    let sign = if placement.flip_x { -1.0 } else { 1.0 };
    let (x, x_turn) = placement.x_in_rig.map_or((default_x * sign, default_turn * sign), |p| laid(&(p * sign), &n));
    let y = z.cross(&x);
    let axis_point = Vector3::new(0.0, 0.0, d / n.z);
    let origin = placement.origin_in_rig_mm.map_or(axis_point, |p| p - n * (n.dot(&p) - d));
    let theta3 = n.dot(&default_x.cross(&x)).atan2(default_x.dot(&x));
    let angles_rad = [(-n.y).atan2(n.z), n.x.asin(), theta3];
    let mut derivative = SMatrix::<f64, 10, 7>::zeros();
    // dn = w x n: derivative of n by w is -[n]x.
    let dn = -crate::rigid::skew(&n);
    derivative[(0, 3)] = 1.0;
    derivative.fixed_view_mut::<1, 3>(1, 0).copy_from(&x.transpose());
    derivative.fixed_view_mut::<1, 3>(2, 0).copy_from(&y.transpose());
    derivative.fixed_view_mut::<3, 3>(3, 0).copy_from(&(dn / d));
    derivative.fixed_view_mut::<3, 1>(3, 3).copy_from(&(-n / (d * d)));
    let yz = n.y * n.y + n.z * n.z;
    let theta1 = Vector3::new(0.0, -n.z / yz, n.y / yz);
    derivative.fixed_view_mut::<1, 3>(6, 0).copy_from(&(theta1.transpose() * dn));
    derivative.fixed_view_mut::<1, 3>(7, 0).copy_from(&(dn.row(0) / (1.0 - n.x * n.x).sqrt()));
    let dtheta3 = x * x_turn - default_x * default_turn;
    derivative.fixed_view_mut::<1, 3>(8, 0).copy_from(&dtheta3.transpose());
    let mut angle = f64::NAN;
    if let Some(c) = second_center_mm {
        let to_baseline = PlaneAngle::of(&n, &c.normalize());
        angle = to_baseline.rad;
        derivative.fixed_view_mut::<1, 3>(9, 0).copy_from(&to_baseline.by_turn().transpose());
        derivative.fixed_view_mut::<1, 3>(9, 4).copy_from(&to_baseline.by_end(c.norm()).transpose());
    }
    let estimate = SheetEstimate {
        normal: n,
        distance_mm: d,
        abc_per_mm: n / d,
        angles_rad,
        angle_to_baseline_rad: angle,
        rig_from_sheet: Motion::new(Matrix3::from_columns(&[x, y, z]), origin),
        sigmas: SVector::from_element(f64::NAN),
    };
    PlaneGeometry { estimate, derivative }
}

/// Square roots of a diagonal; `NaN` where the covariance is.
fn sigmas(covariance: &SMatrix<f64, 10, 10>) -> SVector<f64, 10> {
    covariance.diagonal().map(|v| if v.is_nan() { f64::NAN } else { v.max(0.0).sqrt() })
}
