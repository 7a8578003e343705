//! A plane that stays where the images of its points are, whatever the numbers of the cameras.
//!
//! Along weak directions of a calibration (image distance, windows) cameras and everything they see move by many millimetres together, on a
//! path that is bent: plane and light, stepped straight and each for itself, would part by more than their distance is known to. So planes are
//! told against an anchor, the plane A whose points X keep their images q in both cameras:
//! ```text
//! A(p) = argmin sum over cameras and points |q_c(p, A X) - q_c(p_0, A_0 X)|^2         Gauss-Newton over the six steps of A
//! ```
//! Source: the same idea makes a bundle adjustment's poses follow its cameras. Not valid where fewer than three points are seen.

use super::stepped::{Steps, maps_after, sheet_after};
use crate::dewarp::{SheetGrid, SheetMap};
use crate::frames::{Rig, Sheet};
use crate::record::Record;
use crate::rigid::{Motion, skew};
use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector2, Vector3};

/// Points along each side of the field.
const POINTS: usize = 5;
/// Gauss-Newton steps at most, and the step that ends them, mm.
const STEPS: usize = 20;
const STILL_MM: f64 = 1e-8;

/// Points of the starting sheet with their images.
pub(super) struct Anchor {
    points: Vec<(Vector3<f64>, [Vector2<f64>; 2])>,
}

impl Anchor {
    /// Points over the field that both cameras see; `None` without a sheet.
    pub(super) fn of(start: &Record) -> Option<Self> {
        let maps = [SheetMap::from_record(start, 0).ok()?, SheetMap::from_record(start, 1).ok()?];
        let [x0, y0, x1, y1] = SheetGrid::common(&[&maps[0], &maps[1]], None).ok()?.extent_mm();
        let at = |k: usize| (k as f64 + 0.5) / POINTS as f64;
        let place = |k: usize| Vector3::new(x0 + at(k % POINTS) * (x1 - x0), y0 + at(k / POINTS) * (y1 - y0), 0.0);
        let seen = |p: Vector3<f64>| Some((p, [maps[0].project(&p)?, maps[1].project(&p)?]));
        let points: Vec<_> = (0..POINTS * POINTS).filter_map(|k| seen(place(k))).collect();
        (points.len() >= 3).then_some(Self { points })
    }

    /// The plane after steps of the cameras.
    pub(super) fn at(&self, start: &Record, steps: &Steps<'_>) -> Option<Motion<Rig, Sheet>> {
        let mut pose = sheet_after(start, steps)?;
        for _ in 0..STEPS {
            let maps = maps_after(start, steps, &pose)?;
            let (mut normal, mut right) = (Matrix6::zeros(), SVector::<f64, 6>::zeros());
            for (p, pixels) in &self.points {
                let mut by_step = SMatrix::<f64, 3, 6>::zeros();
                by_step.fixed_columns_mut::<3>(0).copy_from(&-skew(p));
                by_step.fixed_columns_mut::<3>(3).copy_from(&Matrix3::identity());
                for c in 0..2 {
                    let (q, dq_dp) = maps[c].project_jet(p)?;
                    let j = dq_dp * by_step;
                    normal += j.tr_mul(&j);
                    right += j.tr_mul(&(pixels[c] - q));
                }
            }
            let step = normal.cholesky()?.solve(&right);
            pose = pose * Motion::<Sheet, Sheet>::identity().retract(&step);
            if step.fixed_rows::<3>(3).norm() < STILL_MM {
                break;
            }
        }
        Some(pose)
    }
}
