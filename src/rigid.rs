//! Rotations and rigid motions: exponential, logarithm, their Jacobians, and motions that name their frames.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | w | `w_rad` | 3 | rad | rotation vector: axis times angle |
//! | exp(w) | [`rotation_exp`] | 3x3 | 1 | Rodrigues' formula |
//! | J(w) | [`left_jacobian`] | 3x3 | 1 | `exp(w + dw) = exp(J(w) dw) exp(w)` to first order |
//! | (R, t) | [`Motion`] | 3x3, 3 | 1, mm | `p_to = R p_from + t` |
//! | d = (dw, dv) | step | 6 | rad, mm | retraction on the left: `R' = exp(dw) R`, `t' = exp(dw) t + dv` |
//!
//! The retraction moves a point by `dp_to = dw x p_to + dv`, whatever the motion: the derivative lives in the
//! target frame alone. [`Motion::adjoint`] carries a step made in the source frame to the target frame.
//! [`AxesAngle`] and [`PlaneAngle`] are the two angles that are reported, with their derivatives.
//!
//! Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018), eqs 132-147 and 170-176.

mod angles;

pub use angles::{AxesAngle, PlaneAngle};

use crate::frames::{Direction, Plane, Point};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use std::marker::PhantomData;
use std::ops::Mul;

/// Ends of the names of the parts of a left step, with their units.
pub(crate) const STEP_NAMES: [&str; 6] = ["rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"];

/// The matrix with `skew(w) p = w x p`.
pub fn skew(w: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

/// `sin(a)/a`, `(1 - cos a)/a^2`, `(a - sin a)/a^3`, right to rounding also near a = 0.
fn sinc_terms(a: f64) -> (f64, f64, f64) {
    if a < 1e-2 {
        let s = a * a;
        (
            1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0)),
            0.5 - s / 24.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0)),
            1.0 / 6.0 - s / 120.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0)),
        )
    } else {
        let half = (0.5 * a).sin();
        (a.sin() / a, 2.0 * half * half / (a * a), (a - a.sin()) / (a * a * a))
    }
}

/// Rotation matrix of the rotation vector `w_rad` (Rodrigues).
///
/// ```
/// use nalgebra::Vector3;
/// let r = spivcal::rigid::rotation_exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
/// assert!((r * Vector3::x() - Vector3::y()).norm() < 1e-15);
/// ```
pub fn rotation_exp(w_rad: &Vector3<f64>) -> Matrix3<f64> {
    let (s, c, _) = sinc_terms(w_rad.norm());
    let k = skew(w_rad);
    Matrix3::identity() + k * s + k * k * c
}

/// Rotation vector of a rotation matrix, angle in [0, pi]. Right to rounding at 0 and near pi.
pub fn rotation_log(r: &Matrix3<f64>) -> Vector3<f64> {
    // The unit quaternion (q0, q) with the largest component first is stable everywhere (Shepperd).
    let d = r.diagonal();
    let q4 = [1.0 + d.x + d.y + d.z, 1.0 + d.x - d.y - d.z, 1.0 - d.x + d.y - d.z, 1.0 - d.x - d.y + d.z];
    let best = (0..4).fold(0, |b, i| if q4[i] > q4[b] { i } else { b });
    let axis = Vector3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12);
    let (mut q0, mut q) = match best {
        0 => (q4[0], axis),
        1 => (axis.x, Vector3::new(q4[1], r.m21 + r.m12, r.m13 + r.m31)),
        2 => (axis.y, Vector3::new(r.m21 + r.m12, q4[2], r.m32 + r.m23)),
        _ => (axis.z, Vector3::new(r.m13 + r.m31, r.m32 + r.m23, q4[3])),
    };
    if q0 < 0.0 {
        q0 = -q0;
        q = -q;
    }
    let n = q.norm();
    if n == 0.0 { Vector3::zeros() } else { q * (2.0 * n.atan2(q0) / n) }
}

/// Left Jacobian of SO(3): `exp(w + dw) = exp(J dw) exp(w)` to first order.
pub fn left_jacobian(w_rad: &Vector3<f64>) -> Matrix3<f64> {
    let (_, c, d) = sinc_terms(w_rad.norm());
    let k = skew(w_rad);
    Matrix3::identity() + k * c + k * k * d
}

/// The nearest rotation to a matrix that is almost one (keeps products of many rotations orthonormal).
pub fn orthonormalised(r: &Matrix3<f64>) -> Matrix3<f64> {
    let x = r.column(0).normalize();
    let y = (r.column(1) - x * x.dot(&r.column(1))).normalize();
    Matrix3::from_columns(&[x, y, x.cross(&y)])
}

/// Rigid motion from frame `From` to frame `To`: `p_to = rotation p_from + translation_mm`.
///
/// Named `to_from`, and read target first: `cam_from_rig`.
#[derive(Debug, PartialEq)]
pub struct Motion<To, From> {
    /// Rotation matrix (orthonormal, determinant +1).
    pub rotation: Matrix3<f64>,
    /// Origin of `From` expressed in `To`, mm.
    pub translation_mm: Vector3<f64>,
    frames: PhantomData<(To, From)>,
}

impl<A, B> Clone for Motion<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<A, B> Copy for Motion<A, B> {}

impl<A, B> Motion<A, B> {
    /// The motion with this rotation and translation (mm).
    pub fn new(rotation: Matrix3<f64>, translation_mm: Vector3<f64>) -> Self {
        Self { rotation, translation_mm, frames: PhantomData }
    }
    /// The motion that changes nothing.
    pub fn identity() -> Self {
        Self::new(Matrix3::identity(), Vector3::zeros())
    }
    /// The motion back, `from_to`.
    pub fn inverse(&self) -> Motion<B, A> {
        let rt = self.rotation.transpose();
        Motion::new(rt, -(rt * self.translation_mm))
    }
    /// How the origin of `A` seen from `B`, C = -R^T t, follows the shift v of a left step: by -R^T.
    pub fn center_by_shift(&self) -> Matrix3<f64> {
        -self.rotation.transpose()
    }
    /// A point seen from `A`.
    pub fn point(&self, p: &Point<B>) -> Point<A> {
        Point::from_vector(self.apply(&p.xyz_mm))
    }
    /// A direction seen from `A`.
    pub fn direction(&self, d: &Direction<B>) -> Direction<A> {
        Direction::from_vector(self.rotation * d.xyz)
    }
    /// A plane seen from `A`; the normal is turned, not flipped.
    pub fn plane(&self, plane: &Plane<B>) -> Plane<A> {
        let normal = self.direction(&plane.normal);
        let distance_mm = plane.distance_mm + normal.xyz.dot(&self.translation_mm);
        Plane { normal, distance_mm }
    }
    /// Coordinates in `A` of coordinates in `B` (for inner loops that keep plain vectors), mm.
    pub fn apply(&self, xyz_mm: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * xyz_mm + self.translation_mm
    }
    /// The motion after the step `d = (dw_rad, dv_mm)`: `R' = exp(dw) R`, `t' = exp(dw) t + dv`.
    pub fn retract(&self, step: &SVector<f64, 6>) -> Self {
        let e = rotation_exp(&step.fixed_rows::<3>(0).into_owned());
        let v = step.fixed_rows::<3>(3);
        Self::new(orthonormalised(&(e * self.rotation)), e * self.translation_mm + v)
    }
    /// The step that leads from this motion to another: `retract` of it is that one.
    pub fn step_to(&self, to: &Self) -> SVector<f64, 6> {
        let turn = to.rotation * self.rotation.transpose();
        let (w, v) = (rotation_log(&turn), to.translation_mm - turn * self.translation_mm);
        SVector::from([w.x, w.y, w.z, v.x, v.y, v.z])
    }
    /// 6x6 matrix that turns a retraction step of a `B`-valued motion into the step of the same movement in `A`.
    ///
    /// `(a_from_b * b_from_c.retract(d)) = (a_from_b * b_from_c).retract(adjoint d)` to first order.
    pub fn adjoint(&self) -> SMatrix<f64, 6, 6> {
        let mut m = SMatrix::<f64, 6, 6>::zeros();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        m.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rotation);
        m.fixed_view_mut::<3, 3>(3, 0).copy_from(&(skew(&self.translation_mm) * self.rotation));
        m
    }
}

impl<A, B, C> Mul<Motion<B, C>> for Motion<A, B> {
    type Output = Motion<A, C>;
    fn mul(self, rhs: Motion<B, C>) -> Motion<A, C> {
        Motion::new(self.rotation * rhs.rotation, self.apply(&rhs.translation_mm))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::{Cam, Rig, Target};

    fn motion<A, B>(w: [f64; 3], t: [f64; 3]) -> Motion<A, B> {
        Motion::new(rotation_exp(&Vector3::from(w)), Vector3::from(t))
    }

    #[test]
    fn log_inverts_exp_also_at_zero_and_near_pi() {
        let axis = Vector3::new(0.3, -0.5, 0.81).normalize();
        for angle in [0.0, 1e-300, 1e-9, 5e-3, 0.0099, 0.0101, 0.5, 2.0, 3.1, std::f64::consts::PI - 1e-9] {
            let w = axis * angle;
            assert!((rotation_log(&rotation_exp(&w)) - w).norm() < 1e-14 * (1.0 + angle), "{angle}");
        }
    }

    #[test]
    fn left_jacobian_is_the_difference_quotient_of_exp() {
        for w in [Vector3::new(1e-5, 2e-5, -3e-5), Vector3::new(0.4, -1.0, 0.7)] {
            let j = left_jacobian(&w);
            for i in 0..3 {
                let h = 1e-6;
                let mut dw = Vector3::zeros();
                dw[i] = h;
                let plus = rotation_log(&(rotation_exp(&(w + dw)) * rotation_exp(&w).transpose()));
                let minus = rotation_log(&(rotation_exp(&(w - dw)) * rotation_exp(&w).transpose()));
                assert!(((plus - minus) / (2.0 * h) - j.column(i)).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn adjoint_carries_a_step_through_a_motion() {
        let a: Motion<Cam, Rig> = motion([0.1, 0.7, -0.2], [30.0, -5.0, 400.0]);
        let b: Motion<Rig, Target> = motion([-0.4, 0.2, 0.9], [3.0, 15.0, 500.0]);
        let h = 1e-7;
        for i in 0..6 {
            let mut d = SVector::<f64, 6>::zeros();
            d[i] = h;
            let moved = a * b.retract(&d);
            let carried = (a * b).retract(&(a.adjoint() * d));
            assert!((moved.rotation - carried.rotation).norm() < 1e-12);
            assert!((moved.translation_mm - carried.translation_mm).norm() < 1e-9);
        }
    }

    #[test]
    fn plane_and_point_move_together() {
        let m: Motion<Cam, Rig> = motion([0.2, -0.3, 0.5], [1.0, 2.0, 3.0]);
        let plane = Plane { normal: Direction::from_vector(Vector3::new(0.6, 0.0, 0.8)), distance_mm: 10.0 };
        let p = Point::<Rig>::new(6.0, 7.0, 8.0);
        assert!((plane.normal.xyz.dot(&p.xyz_mm) - plane.distance_mm).abs() < 1e-12);
        let (q, pl) = (m.point(&p), m.plane(&plane));
        assert!((pl.normal.xyz.dot(&q.xyz_mm) - pl.distance_mm).abs() < 1e-12);
        assert!((m.inverse().point(&q).xyz_mm - p.xyz_mm).norm() < 1e-13);
    }
}
