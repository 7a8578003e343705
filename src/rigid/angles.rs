//! Angles where they fold: between two axes (at 0 and at 180 degrees), and between a plane and a line (at 90 degrees).
//!
//! An angle that cannot go on beyond its fold has no derivative there, and neighbours of it say nothing of its standard
//! deviation. Both are therefore taken along the direction in which they open, a unit vector e that is kept: then they go
//! through the fold as a straight line does:
//!
//! ```text
//! axes:   theta = atan2(e . a, a_z)                      d theta = e_x w_y - e_y w_x
//! plane:  theta = atan2(n . b, e . (b - n (n . b)))      d theta = w . (n x e) + dc . (n cos theta - e sin theta) / |c|
//! ```
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | theta | `rad` | 1 | rad | the angle; of a plane positive where the line runs to the side of n |
//! | a, e | - , `across` | 3, 2 | 1 | the other frame's z axis in the first; where it leans across the first's z |
//! | n, e | `normal`, `along` | 3, 3 | 1 | unit normal; the line laid into the plane; both in one frame |
//! | b, c | `direction`, - | 3, 3 | 1, mm | direction `c / |c|` of the line to its end c |
//! | w | - | 3 | rad | turn of the second frame, seen in the first: `da = w x a`; of the plane: `dn = w x n` |
//!
//! Both follow by differentiating along e at the estimate, where e is the direction itself.

use nalgebra::{Matrix3, Vector2, Vector3};
use std::f64::consts::TAU;

/// Below this a direction is rounding.
const NONE: f64 = 1e-14;

/// The angle nearest to `near` that differs from `theta` by whole turns.
fn unwound(theta: f64, near: f64) -> f64 {
    theta - TAU * ((theta - near) / TAU).round()
}

/// Angle between the z axes of two frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxesAngle {
    /// The angle, 0 to pi.
    pub rad: f64,
    /// Where the second axis leans, across the first.
    across: Vector2<f64>,
}

impl AxesAngle {
    /// Of the frames that a rotation joins: its last column is the second frame's z axis in the first.
    pub fn of(rotation: &Matrix3<f64>) -> Self {
        let a = Vector2::new(rotation.m13, rotation.m23);
        let sine = a.norm();
        let across = if sine > NONE { a / sine } else { Vector2::x() };
        Self { rad: sine.atan2(rotation.m33), across }
    }
    /// Derivatives by a left turn about the first frame's x and y: `R' = exp(w) R`.
    pub fn by_left_turn(&self) -> [f64; 2] {
        [-self.across.y, self.across.x]
    }
    /// The angle of a neighbour, along the same direction; below 0 and above pi where it went through the fold.
    pub fn of_neighbour(&self, rotation: &Matrix3<f64>) -> f64 {
        let sine = self.across.dot(&Vector2::new(rotation.m13, rotation.m23));
        unwound(sine.atan2(rotation.m33), self.rad)
    }
}

/// Angle between a plane and a line: positive where the line runs to the side of the normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneAngle {
    /// The angle, -pi/2 to pi/2.
    pub rad: f64,
    normal: Vector3<f64>,
    /// The line laid into the plane.
    along: Vector3<f64>,
}

impl PlaneAngle {
    /// Of a unit normal and the line's unit direction, in one frame.
    pub fn of(normal: &Vector3<f64>, direction: &Vector3<f64>) -> Self {
        let sine = normal.dot(direction);
        let laid = direction - normal * sine;
        let cosine = laid.norm();
        let along = if cosine > NONE { laid / cosine } else { across(normal) };
        Self { rad: sine.atan2(cosine), normal: *normal, along }
    }
    /// Derivative by a turn w of the plane: `dn = w x n`.
    pub fn by_turn(&self) -> Vector3<f64> {
        self.normal.cross(&self.along)
    }
    /// Derivative by the line's end, where it has this length.
    pub fn by_end(&self, length_mm: f64) -> Vector3<f64> {
        (self.normal * self.rad.cos() - self.along * self.rad.sin()) / length_mm
    }
    /// The angle of a neighbour, along the same direction; beyond a quarter turn where it went through the fold.
    pub fn of_neighbour(&self, normal: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
        let sine = normal.dot(direction);
        unwound(sine.atan2(self.along.dot(&(direction - normal * sine))), self.rad)
    }
}

/// A unit vector across another.
fn across(n: &Vector3<f64>) -> Vector3<f64> {
    let least = n.iamin();
    n.cross(&Vector3::ith(least, 1.0)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::rotation_exp;

    const H: f64 = 1e-6;

    /// At folds and away from them: derivatives are those of neighbours on both sides, and the plain formulas hold.
    #[test]
    fn axes_open_and_close_smoothly() {
        for turn in [[0.0; 3], [0.3, -0.5, 0.2], [1e-8, 0.0, 0.4], [std::f64::consts::PI, 0.0, 0.0], [0.0, 3.1, 0.1]] {
            let r = rotation_exp(&Vector3::from(turn));
            let angle = AxesAngle::of(&r);
            assert!((angle.rad.cos() - r.m33).abs() < 1e-14 && (0.0..=std::f64::consts::PI).contains(&angle.rad));
            for k in 0..3 {
                let side = |h: f64| angle.of_neighbour(&(rotation_exp(&Vector3::ith(k, h)) * r));
                let numeric = (side(H) - side(-H)) / (2.0 * H);
                let expected = [angle.by_left_turn()[0], angle.by_left_turn()[1], 0.0][k];
                assert!((numeric - expected).abs() < 1e-8, "{turn:?} about {k}: {numeric} {expected}");
            }
        }
    }

    #[test]
    fn a_line_goes_through_a_plane_and_past_its_normal_smoothly() {
        let n = Vector3::new(0.5, -0.1, 0.8).normalize();
        let e = across(&n);
        let line = |rad: f64| (n * rad.sin() + e * rad.cos()) * 700.0;
        for rad in [0.0, 1e-9, -0.4, 0.8, 1.57, std::f64::consts::FRAC_PI_2, -std::f64::consts::FRAC_PI_2] {
            let end = line(rad);
            let angle = PlaneAngle::of(&n, &end.normalize());
            assert!((angle.rad - rad).abs() < 1e-14, "{} {rad}", angle.rad);
            for k in 0..3 {
                let turned = |h: f64| angle.of_neighbour(&(rotation_exp(&Vector3::ith(k, h)) * n), &end.normalize());
                let moved = |h: f64| angle.of_neighbour(&n, &(end + Vector3::ith(k, h)).normalize());
                let by_turn = (turned(H) - turned(-H)) / (2.0 * H);
                let by_end = (moved(1e-2) - moved(-1e-2)) / 2e-2;
                assert!((by_turn - angle.by_turn()[k]).abs() < 1e-8, "{rad}: turn {k}");
                assert!((by_end - angle.by_end(700.0)[k]).abs() < 1e-10, "{rad}: end {k}");
            }
        }
    }
}
