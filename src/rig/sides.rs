//! On which sides of the target the cameras stand.
//!
//! A pose that a camera finds alone has z towards that camera. A target that shows both its sides (two discs in one plane) may stand between
//! the cameras: then the second camera's frame of it is turned over against the first's, in all views alike, by
//! `P = diag(1, -1, -1)`, half a turn about the line through both discs, which keeps the discs in their places. The views then agree
//! on `right_from_target P left_from_target^-1` ([`super::consensus`]).
//!
//! Views of one plane cannot tell this from a mirrored camera: the mirror image of a camera in the plane of the target sees the same with
//! left and right exchanged. Views tilted against each other by t make the one of the two that is not true differ by 2 t.

use super::consensus::{Choice, choices, votes};
use super::labels::is_pair;
use super::{Mono, Pose, RigProblem};
use crate::rigid::Motion;
use nalgebra::{Matrix3, Vector3};

/// A pose of the same target seen from its other side: z away from the camera.
fn from_behind(pose: &Pose) -> Pose {
    let p = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    (Motion::new(pose.0.rotation * p, pose.0.translation_mm), pose.1)
}

/// The same cameras with the second behind the target of the first.
pub(super) fn behind(monos: &[Mono]) -> Vec<Mono> {
    let mut out = monos.to_vec();
    if let Some(second) = out.get_mut(1) {
        second.poses.iter_mut().flatten().for_each(|p| *p = from_behind(p));
    }
    out
}

/// One way in which the images of all views belong together.
#[derive(Clone)]
pub(super) struct Way {
    /// Whether the second camera is behind the target of the first.
    pub(super) behind: bool,
    /// What the cameras found alone, poses in the first camera's frame of the target.
    pub(super) monos: Vec<Mono>,
    pub(super) choice: Choice,
}

impl Way {
    /// What cameras found alone, to this way's frame of the target or back from it.
    pub(super) fn turned(&self, monos: &[Mono]) -> Vec<Mono> {
        if self.behind { behind(monos) } else { monos.to_vec() }
    }
}

/// Ways with both cameras on one side, and with the second behind the target; none of these where the target shows one side only.
pub(super) fn ways(problem: &RigProblem, monos: &[Mono]) -> [Vec<Way>; 2] {
    let of = |monos: Vec<Mono>, behind: bool| -> Vec<Way> {
        let votes = votes(problem, &monos[0].poses, &monos[1].poses, false);
        choices(problem, &votes).into_iter().map(|choice| Way { behind, monos: monos.clone(), choice }).collect()
    };
    [of(monos.to_vec(), false), if is_pair(problem) { of(behind(monos), true) } else { vec![] }]
}

#[cfg(test)]
mod tests {
    use super::super::labels::{EXCHANGE, turned_target};
    use super::*;
    use crate::frames::{Cam, Target};
    use crate::rigid::rotation_exp;

    #[test]
    fn the_other_side_shows_the_discs_where_they_are_whichever_is_which() {
        let pose: Motion<Cam, Target> =
            Motion::new(rotation_exp(&Vector3::new(2.7, 0.3, -0.4)), Vector3::new(3.0, -2.0, 500.0));
        let (other, shape) = from_behind(&(pose, [26.0, 12.5, 10.0]));
        for x in [0.0, 26.0] {
            let disc = Vector3::new(x, 0.0, 0.0);
            assert!((pose.apply(&disc) - other.apply(&disc)).norm() < 1e-12);
        }
        assert!((pose.rotation.column(2) + other.rotation.column(2)).norm() < 1e-14);
        let exchange = turned_target(&EXCHANGE, shape[0]);
        let [a, b] = [from_behind(&(pose * exchange, shape)).0, other * exchange];
        assert!((a.rotation - b.rotation).norm() < 1e-14 && (a.translation_mm - b.translation_mm).norm() < 1e-12);
    }
}
