//! Points on given tangent lines and their derivatives by the ten ellipse parameters.

use super::{Bitangents, CROSSINGS, EXTERNAL_CROSSING, ExternalCrossing, Line};
use crate::conic::Ellipse;
use crate::error::{Invalid, Result};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Sine of the angle between the external tangents below which their crossing is lost in rounding.
const PARALLEL_SINE: f64 = 1e-9;

/// Centre and shape matrix `M = R diag(a^2, b^2) R'` of an ellipse, with the derivative of M by `a, b, phi`.
pub(super) struct Shape {
    pub(super) center: Vector2<f64>,
    pub(super) matrix: Matrix2<f64>,
    by_parameter: [Matrix2<f64>; 3],
}

impl Shape {
    pub(super) fn new(ellipse: &Ellipse) -> Result<Self> {
        let p = ellipse.parameters();
        if let Some(bad) = p.iter().find(|x| !x.is_finite()) {
            return Err(Invalid::value("ellipse parameter", *bad, "a finite number").into());
        }
        let (a, b) = (p[2], p[3]);
        if !(b > 0.0 && a > 0.0) {
            return Err(Invalid::value("semi-axis of an ellipse", a.min(b), "above 0 px").into());
        }
        let (s, c) = p[4].sin_cos();
        let (e, f) = (Vector2::new(c, s), Vector2::new(-s, c));
        let (ee, ff, ef) = (e * e.transpose(), f * f.transpose(), e * f.transpose() + f * e.transpose());
        Ok(Self {
            center: Vector2::new(p[0], p[1]),
            matrix: ee * (a * a) + ff * (b * b),
            by_parameter: [ee * (2.0 * a), ff * (2.0 * b), ef * (a * a - b * b)],
        })
    }
    /// `s(n)`: half the width of the ellipse across lines of normal `n`, px.
    pub(super) fn support(&self, n: &Vector2<f64>) -> f64 {
        n.dot(&(self.matrix * n)).sqrt()
    }
    /// Derivative of `c . n + q s(n)` by the five parameters, n held.
    fn support_by_parameters(&self, n: &Vector2<f64>, q: f64) -> SVector<f64, 5> {
        let half = q / (2.0 * self.support(n));
        let by = |k: usize| half * n.dot(&(self.by_parameter[k] * n));
        SVector::from([n.x, n.y, by(0), by(1), by(2)])
    }
    /// The point `c + q M n / s` where the line touches.
    fn touch(&self, n: &Vector2<f64>, q: f64) -> Vector2<f64> {
        self.center + self.matrix * n * (q / self.support(n))
    }
    /// Derivative of the touching point by the five parameters (n held) and by the angle of n.
    fn touch_derivative(&self, n: &Vector2<f64>, q: f64) -> (SMatrix<f64, 2, 5>, Vector2<f64>) {
        let s = self.support(n);
        let mn = self.matrix * n;
        let dn = Vector2::new(-n.y, n.x);
        let mut by_p = SMatrix::<f64, 2, 5>::zeros();
        by_p.fixed_view_mut::<2, 2>(0, 0).fill_diagonal(1.0);
        for k in 0..3 {
            let dm_n = self.by_parameter[k] * n;
            by_p.set_column(2 + k, &((dm_n - mn * (n.dot(&dm_n) / (2.0 * s * s))) * (q / s)));
        }
        let by_t = (self.matrix * dn - mn * (mn.dot(&dn) / (s * s))) * (q / s);
        (by_p, by_t)
    }
}

/// One tangent with the first-order movement of everything on it.
struct Moving {
    normal: Vector2<f64>,
    distance: f64,
    /// dt/dp of the angle of the normal.
    turn: SMatrix<f64, 1, 10>,
    /// Shift along the normal at the point where the line touches disc 0, by p.
    shift: SMatrix<f64, 1, 10>,
    touch: [Vector2<f64>; 2],
    touch_by_p: [SMatrix<f64, 2, 10>; 2],
}

fn side_of_disc_1(line: usize) -> f64 {
    if line < 2 { 1.0 } else { -1.0 }
}

impl Moving {
    fn new(shapes: &[Shape; 2], line: &Line, q_1: f64) -> Self {
        let (n, q) = (line.normal, [1.0, q_1]);
        let dn = Vector2::new(-n.y, n.x);
        let touch = [0, 1].map(|i: usize| shapes[i].touch(&n, q[i]));
        let held = [0, 1].map(|i: usize| shapes[i].support_by_parameters(&n, q[i]));
        let dg_dt = (touch[1] - touch[0]).dot(&dn);
        let (mut turn, mut shift) = (SMatrix::<f64, 1, 10>::zeros(), SMatrix::<f64, 1, 10>::zeros());
        for k in 0..5 {
            turn[k] = held[0][k] / dg_dt;
            turn[5 + k] = -held[1][k] / dg_dt;
            shift[k] = held[0][k];
        }
        let touch_by_p = [0, 1].map(|i: usize| {
            let (by_p, by_t) = shapes[i].touch_derivative(&n, q[i]);
            let mut j = by_t * turn;
            for k in 0..5 {
                let column = j.column(5 * i + k) + by_p.column(k);
                j.set_column(5 * i + k, &column);
            }
            j
        });
        Self { normal: n, distance: line.distance_px, turn, shift, touch, touch_by_p }
    }
    /// First-order shift of the line along its normal at a point `x` on it, by p.
    fn shift_at(&self, x: &Vector2<f64>) -> SMatrix<f64, 1, 10> {
        let dn = Vector2::new(-self.normal.y, self.normal.x);
        self.shift + self.turn * (self.touch[0] - x).dot(&dn)
    }
}

/// Crossing of two lines and its derivative.
fn crossing(a: &Moving, b: &Moving) -> (Vector2<f64>, SMatrix<f64, 2, 10>) {
    let sine = a.normal.perp(&b.normal);
    // Distances counted from a point near the discs: far from pixel (0, 0) the plain formula loses digits.
    let near = a.touch[0];
    let (da, db) = (a.distance - a.normal.dot(&near), b.distance - b.normal.dot(&near));
    let solve =
        |ra: f64, rb: f64| Vector2::new(ra * b.normal.y - rb * a.normal.y, rb * a.normal.x - ra * b.normal.x) / sine;
    let x = near + solve(da, db);
    let (sa, sb) = (a.shift_at(&x), b.shift_at(&x));
    let mut j = SMatrix::<f64, 2, 10>::zeros();
    for k in 0..10 {
        j.set_column(k, &solve(sa[k], sb[k]));
    }
    (x, j)
}

/// All points on the four tangents, in the module's order, with their derivatives.
pub(super) fn assemble(shapes: &[Shape; 2], lines: &[Line; 4]) -> Bitangents {
    let moving = [0, 1, 2, 3].map(|k: usize| Moving::new(shapes, &lines[k], side_of_disc_1(k)));
    let mut points = SVector::<f64, 28>::zeros();
    let mut jacobian = SMatrix::<f64, 28, 10>::zeros();
    for (k, m) in moving.iter().enumerate() {
        for i in 0..2 {
            points.fixed_rows_mut::<2>(4 * k + 2 * i).copy_from(&m.touch[i]);
            jacobian.fixed_rows_mut::<2>(4 * k + 2 * i).copy_from(&m.touch_by_p[i]);
        }
    }
    let (left, right) = (&moving[0], &moving[1]);
    let external_sine = left.normal.perp(&right.normal);
    // d(n_l x n_r) = (n_l . n_r)(dt_r - dt_l)
    let external_sine_jacobian = (right.turn - left.turn) * left.normal.dot(&right.normal);
    let mut external = ExternalCrossing::AtInfinity((left.touch[1] - left.touch[0]).normalize());
    for (c, [a, b]) in CROSSINGS.into_iter().enumerate() {
        let at = 2 * (EXTERNAL_CROSSING + c);
        if c == 0 && external_sine.abs() < PARALLEL_SINE {
            continue;
        }
        let (x, j) = crossing(&moving[a], &moving[b]);
        if c == 0 {
            external = ExternalCrossing::At(x);
        }
        points.fixed_rows_mut::<2>(at).copy_from(&x);
        jacobian.fixed_rows_mut::<2>(at).copy_from(&j);
    }
    Bitangents { lines: *lines, points, external, jacobian, external_sine, external_sine_jacobian }
}
