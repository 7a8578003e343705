//! Where the user wants the sheet frame: origin, direction of x, and which way z points.

use crate::error::{Invalid, Result};
use crate::frames::{Rig, Sheet, Target};
use crate::record::Record;
use crate::rigid::{Motion, rotation_exp};
use nalgebra::{Matrix3, Vector3};

/// A frame in the same plane: moved, turned about the normal, and turned round.
///
/// Only proper frames exist: a mirrored one would change the sense of every rotation in the flow. Turning round (a half turn
/// about the new y axis) reverses x **and** z: w is then positive away from the first camera.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Placement {
    /// New origin in the calibration's sheet frame, mm.
    pub origin_mm: [f64; 2],
    /// Angle of the new x axis in the calibration's sheet frame, counter-clockwise as the first camera sees it, rad.
    pub angle_rad: f64,
    /// Whether z points away from the first camera.
    pub turned_round: bool,
}

impl Placement {
    /// The motion that carries new coordinates into the calibration's sheet frame.
    pub fn sheet_from_placed(&self) -> Motion<Sheet, Sheet> {
        let mut rotation = rotation_exp(&Vector3::new(0.0, 0.0, self.angle_rad));
        if self.turned_round {
            rotation *= Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, -1.0));
        }
        Motion::new(rotation, Vector3::new(self.origin_mm[0], self.origin_mm[1], 0.0))
    }

    /// Origin and x axis of the target of a view (its marks), laid into the sheet along the normal.
    ///
    /// # Errors
    /// [`Invalid`] where there is no sheet, no such view, the view was not used, or its target stands on the sheet.
    pub fn at_view(record: &Record, view: usize) -> Result<Self> {
        let found = record.views.iter().find(|v| v.index == view);
        let pose = found.and_then(|v| v.rig_from_target).zip(record.sheet.as_ref());
        let Some((rig_from_target, sheet)) = pose else {
            let what = format!("view {view} has no pose, or the calibration has no sheet; name a view that was used");
            return Err(Invalid::Contradiction(what).into());
        };
        let sheet_from_rig = sheet.rig_from_sheet.motion::<Rig, Sheet>().inverse();
        let m = sheet_from_rig * rig_from_target.motion::<Rig, Target>();
        let x = m.rotation.column(0);
        if x.x.hypot(x.y) < 0.1 {
            let what = format!("the x axis of the target of view {view} stands on the sheet; name another view");
            return Err(Invalid::Contradiction(what).into());
        }
        let t = m.translation_mm;
        Ok(Self { origin_mm: [t.x, t.y], angle_rad: x.y.atan2(x.x), turned_round: false })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_placed_frame_is_right_handed_and_in_the_plane() {
        for turned_round in [false, true] {
            let m = Placement { origin_mm: [3.0, -2.0], angle_rad: 0.4, turned_round }.sheet_from_placed();
            assert!((m.rotation.determinant() - 1.0).abs() < 1e-14);
            let towards = if turned_round { -1.0 } else { 1.0 };
            assert!((m.rotation.column(2) - Vector3::z() * towards).norm() < 1e-14);
            assert_eq!(m.translation_mm, Vector3::new(3.0, -2.0, 0.0));
            assert!((m.rotation.column(1) - Vector3::new(-0.4_f64.sin(), 0.4_f64.cos(), 0.0)).norm() < 1e-14);
        }
    }
}
