//! The 14 points of two circles of the target plane in closed form.
//!
//! With `e` from centre 0 to centre 1 (distance L) and `m` to its left (y up), a tangent has the normal
//! `n = C e +- S m`, `C = (r0 - r1) / L` external, `(r0 + r1) / L` internal, `S = sqrt(1 - C^2)`; it touches at
//! `c0 + r0 n` and `c1 +- r1 n`. Two tangents with normals n, n' meet at `c0 + r0 (n + n') / (1 + n . n')`.

use super::{CROSSINGS, EXTERNAL_CROSSING, POINTS};
use crate::error::{Insufficient, Invalid, Result};
use nalgebra::{SMatrix, SVector, Vector2};

/// The 14 points of two circles and their derivative.
#[derive(Debug, Clone, PartialEq)]
pub struct CirclePair {
    /// `(x, y)` of the 14 points, mm, frame `Target` (y up); zero for an external crossing at infinity.
    pub points_mm: SVector<f64, 28>,
    /// Derivative by `(x0, y0, r0, x1, y1, r1)`.
    pub jacobian: SMatrix<f64, 28, 6>,
    /// Whether the radii differ enough for the external tangents to meet.
    pub external_is_finite: bool,
}

/// A point `(along e, along m)` counted from centre 0, with its derivative by `(L, r0, r1)`.
#[derive(Clone, Copy)]
struct Local {
    value: Vector2<f64>,
    by: SMatrix<f64, 2, 3>,
}

impl Local {
    fn new(value: Vector2<f64>, by: SMatrix<f64, 2, 3>) -> Self {
        Self { value, by }
    }
    fn plus(self, other: Self) -> Self {
        Self::new(self.value + other.value, self.by + other.by)
    }
    /// Times a scalar with derivative row `ds`.
    fn times(self, s: f64, ds: SMatrix<f64, 1, 3>) -> Self {
        Self::new(self.value * s, self.by * s + self.value * ds)
    }
}

/// Normal of a tangent: `internal` is -1 or +1 times r1 in `C = (r0 + internal r1) / L`, `side` +1 left, -1 right.
fn normal(l: f64, r0: f64, r1: f64, internal: f64, side: f64) -> Local {
    let c = (r0 + internal * r1) / l;
    let s = ((1.0 - c) * (1.0 + c)).sqrt();
    let dc = SMatrix::<f64, 1, 3>::new(-c / l, 1.0 / l, internal / l);
    let slope = Vector2::new(1.0, -side * c / s);
    Local::new(Vector2::new(c, side * s), slope * dc)
}

/// The four normals in the order of [`super`]: external left, right, internal left, right.
fn normals(l: f64, r0: f64, r1: f64) -> [Local; 4] {
    [(-1.0, 1.0), (-1.0, -1.0), (1.0, 1.0), (1.0, -1.0)].map(|(internal, side)| normal(l, r0, r1, internal, side))
}

/// The 14 points in the frame (e, m) of the pair; the external crossing is `None` for equal radii.
fn local_points(l: f64, r0: f64, r1: f64) -> [Option<Local>; POINTS] {
    let n = normals(l, r0, r1);
    let (by_l, by_r0, by_r1) = (
        SMatrix::<f64, 1, 3>::new(1.0, 0.0, 0.0),
        SMatrix::<f64, 1, 3>::new(0.0, 1.0, 0.0),
        SMatrix::<f64, 1, 3>::new(0.0, 0.0, 1.0),
    );
    let along = Local::new(Vector2::x(), SMatrix::zeros());
    let center_1 = along.times(l, by_l);
    let mut out = [None; POINTS];
    for k in 0..4 {
        let q = if k < 2 { 1.0 } else { -1.0 };
        out[2 * k] = Some(n[k].times(r0, by_r0));
        out[2 * k + 1] = Some(center_1.plus(n[k].times(q * r1, by_r1 * q)));
    }
    for (c, [a, b]) in CROSSINGS.into_iter().enumerate().skip(1) {
        let w = 1.0 + n[a].value.dot(&n[b].value);
        let dw = n[a].value.transpose() * n[b].by + n[b].value.transpose() * n[a].by;
        let factor = by_r0 / w - dw * (r0 / (w * w));
        out[EXTERNAL_CROSSING + c] = Some(n[a].plus(n[b]).times(r0 / w, factor));
    }
    let d = r0 - r1;
    // The derivative goes with 1 / d^2: keep it finite.
    if d.abs() > 1e-9 * l {
        let by = SMatrix::<f64, 1, 3>::new(r0 / d, -l * r1 / (d * d), l * r0 / (d * d));
        out[EXTERNAL_CROSSING] = Some(along.times(l * r0 / d, by));
    }
    out
}

/// The 14 points of two circles of the target plane (y up, seen from its front), in the order of [`super`].
///
/// # Errors
/// [`Invalid::Value`] where a number is not finite or a radius not positive; [`Insufficient::NotSeparated`] where the circles touch or overlap.
pub fn circle_features(
    center_0_mm: Vector2<f64>,
    radius_0_mm: f64,
    center_1_mm: Vector2<f64>,
    radius_1_mm: f64,
) -> Result<CirclePair> {
    let offset = center_1_mm - center_0_mm;
    let l = offset.norm();
    if !l.is_finite() {
        return Err(Invalid::value("centre of a circle", l, "a finite number").into());
    }
    for r in [radius_0_mm, radius_1_mm] {
        if !(r.is_finite() && r > 0.0) {
            return Err(Invalid::value("radius of a circle", r, "above 0 mm").into());
        }
    }
    if l <= (radius_0_mm + radius_1_mm) * (1.0 + 1e-10) {
        return Err(Insufficient::NotSeparated { gap: l - radius_0_mm - radius_1_mm }.into());
    }
    let e = offset / l;
    let m = Vector2::new(-e.y, e.x);
    let frame = SMatrix::<f64, 2, 2>::from_columns(&[e, m]);
    let mut out = CirclePair { points_mm: SVector::zeros(), jacobian: SMatrix::zeros(), external_is_finite: false };
    for (i, local) in local_points(l, radius_0_mm, radius_1_mm).into_iter().enumerate() {
        let Some(Local { value, by }) = local else { continue };
        out.external_is_finite |= i == EXTERNAL_CROSSING;
        out.points_mm.fixed_rows_mut::<2>(2 * i).copy_from(&(center_0_mm + frame * value));
        let by_local = frame * by;
        // Turning the pair: de = m (m . dD) / L, dm = -e (m . dD) / L.
        let by_offset = by_local.column(0) * e.transpose() + (m * value.x - e * value.y) * (m.transpose() / l);
        let mut j = out.jacobian.fixed_rows_mut::<2>(2 * i);
        j.fixed_columns_mut::<2>(0).copy_from(&(SMatrix::<f64, 2, 2>::identity() - by_offset));
        j.set_column(2, &by_local.column(1));
        j.fixed_columns_mut::<2>(3).copy_from(&by_offset);
        j.set_column(5, &by_local.column(2));
    }
    Ok(out)
}
