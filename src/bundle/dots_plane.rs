//! The plane of dots that do not lie in one.
//!
//! Where every dot is estimated a plate may be bent, and the plane z = 0 of its frame, from which heights count, is where outlines and priors hold it: outlines
//! follow the printed surface, and over a plate whose slopes do not cancel their mean leans otherwise than the dots lie. The sheet is the plane that fits the
//! dots seen in it best:
//!
//! ```text
//! sum (dz - (c + a x + b y))^2 -> min      (c, a, b) = M^-1 sum (1, x, y) dz,   M = sum (1, x, y)' (1, x, y)
//! rig_from_sheet = rig_from_plane T,       T = (rotation exp(b, -a, 0), translation (0, 0, c))
//! ```
//!
//! over the dots of all views in the sheet, as often as they are there.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | x, y | - | mm | plane | nominal place of a dot |
//! | dz | `offsets_mm[j][2]` | mm | plane | its height |
//! | c, a, b | `fit` | mm, 1, 1 | plane | height at the origin, slopes |

use super::model::{Model, ViewPlace};
use super::state::State;
use crate::frames::Sheet;
use crate::rigid::{Motion, rotation_exp};
use nalgebra::{Matrix3, SVector, Vector3};
use std::collections::BTreeSet;

/// The plane through the dots beside the one that heights count from.
pub(super) struct DotsPlane {
    fit: Vector3<f64>,
    /// Derivative of the fit by the height of each disc that takes part.
    by_height: Vec<(usize, Vector3<f64>)>,
}

impl DotsPlane {
    /// `None` where dots are not estimated, no view lies in the sheet, or its dots lie in a line.
    pub(super) fn of(model: &Model, state: &State) -> Option<Self> {
        if state.offsets_mm.is_empty() || state.first_from_plane.is_none() {
            return None;
        }
        let mut seen: Vec<(usize, Vector3<f64>)> = vec![];
        for (v, view) in state.views.iter().enumerate() {
            let Some(planar) =
                view.plane_from_target.filter(|_| matches!(model.views[v].place, ViewPlace::InPlane { .. }))
            else {
                continue;
            };
            let images = model.images.iter().filter(|image| image.view == v);
            let discs: BTreeSet<usize> = images
                .flat_map(|i| i.discs.iter().map(|d| d.disc).chain(i.points.disc.iter().map(|j| *j as usize)))
                .collect();
            seen.extend(discs.into_iter().map(|j| {
                let at = planar.apply(&model.target.nominal_disc(j, &state.shape_mm).0);
                (j, Vector3::new(1.0, at.x, at.y))
            }));
        }
        let gram: Matrix3<f64> = seen.iter().map(|(_, p)| p * p.transpose()).sum();
        let inverse = gram.try_inverse()?;
        let by_height: Vec<_> = seen.into_iter().map(|(j, p)| (j, inverse * p)).collect();
        let fit = by_height.iter().map(|(j, d)| d * state.offsets_mm[*j][2]).sum();
        Some(Self { fit, by_height })
    }

    /// T.
    pub(super) fn motion(&self) -> Motion<Sheet, Sheet> {
        let [c, a, b] = [self.fit[0], self.fit[1], self.fit[2]];
        Motion::new(rotation_exp(&Vector3::new(b, -a, 0.0)), Vector3::new(0.0, 0.0, c))
    }

    /// Step of T about the axes of the plane with the height of each disc that takes part.
    pub(super) fn steps(&self) -> impl Iterator<Item = (usize, SVector<f64, 6>)> + '_ {
        self.by_height.iter().map(|(j, d)| (*j, SVector::from([d[2], -d[1], 0.0, 0.0, 0.0, d[0]])))
    }
}
