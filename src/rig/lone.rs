//! Views of discs of unknown size that one camera alone sees: where they start.
//!
//! Such a view is seen in its direction only, `P = C + s D`, its size growing with its distance s. One that lies in the common plane is where
//! that direction meets the plane of the other views; any other starts as far away as these are on average.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | C | `eye` | mm | Rig | projection centre of the camera |
//! | D | `ray` | - | Rig | target as the camera alone has it, of any scale |
//! | n . p = d | `plane` | mm | Rig | the plane of the other views |

use super::{Pose, RigProblem};
use crate::bundle::{PlanePosition, ViewPlace};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::rigid::Motion;

/// The camera that alone sees view `v`, where the view has a scale of its own.
pub(super) fn lone_camera(problem: &RigProblem, v: usize) -> Option<usize> {
    let own_scale = problem.model.cameras.len() > 1 && problem.model.target.per_view();
    let mut seen = problem.model.images.iter().filter(|i| i.view == v).map(|i| i.camera);
    let first = seen.next().filter(|_| own_scale)?;
    seen.all(|c| c == first).then_some(first)
}

/// Puts the views that one camera alone sees where they may be: `alone` is what that camera found.
pub(super) fn place_lone_views(
    problem: &RigProblem,
    alone: &[Vec<Option<Pose>>; 2],
    second_from_first: &Motion<Cam, Rig>,
    plane: Option<&Motion<Rig, Sheet>>,
    poses: &mut [(Motion<Rig, Target>, [f64; 3])],
) {
    let eyes: [Motion<Rig, Cam>; 2] = [Motion::identity(), second_from_first.inverse()];
    let lone: Vec<Option<usize>> = (0..poses.len()).map(|v| lone_camera(problem, v)).collect();
    let shared: Vec<_> =
        poses.iter().zip(&lone).filter(|(_, l)| l.is_none()).map(|(p, _)| p.0.translation_mm).collect();
    for (v, c) in lone.iter().enumerate() {
        let Some((c, (pose, shape))) = c.and_then(|c| Some((c, alone[c][v]?))) else { continue };
        let (eye, ray) = (eyes[c].translation_mm, eyes[c].rotation * pose.translation_mm);
        let on_plane = match (problem.model.views[v].place, plane) {
            (ViewPlace::InPlane { known: PlanePosition::Unknown, .. } | ViewPlace::Free, _) | (_, None) => None,
            (ViewPlace::InPlane { z_mm, .. }, Some(plane)) => {
                let n = plane.rotation.column(2);
                Some((n.dot(&(plane.translation_mm - eye)) + z_mm) / n.dot(&ray))
            }
        };
        let away = shared.iter().map(|p| (p - eye).norm()).sum::<f64>() / shared.len().max(1) as f64;
        let scale = on_plane.filter(|s| s.is_finite() && *s > 0.0).unwrap_or(away / ray.norm());
        if scale.is_finite() && scale > 0.0 {
            let scaled: Motion<Cam, Target> = Motion::new(pose.rotation, pose.translation_mm * scale);
            poses[v] = (eyes[c] * scaled, shape.map(|s| s * scale));
        }
    }
}
