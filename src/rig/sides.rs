//! On which sides of the target the cameras stand.
//!
//! A pose that a camera finds alone has z towards that camera. A target that shows both its sides (two discs in one plane) may stand between
//! the cameras: then the second camera's frame of it is turned over against the first's, in all views alike, by
//! `P = diag(1, -1, -1)`, half a turn about the line through both discs, which keeps the discs in their places. The views then agree
//! on `right_from_target P left_from_target^-1` ([`super::consensus`]).
//!
//! Views of one plane cannot tell this from a mirrored camera: the mirror image of a camera in the plane of the target sees the same with
//! left and right exchanged. Views tilted against each other by t make the one of the two that is not true differ by 2 t. Poses of a camera
//! alone may be too weak to tell; then the cost of the common adjustment does, with the second camera's images as they are and flipped.

use super::consensus::{Choice, choices, votes};
use super::contradiction::{DOUBT, NAMED_RAD, contradicts_px, worst_px};
use super::joint::{Context, Trial, tried};
use super::labels::is_pair;
use super::mono::calibrate_camera;
use super::{Mono, Pose, RigProblem};
use crate::bundle::DiscObservation;
use crate::conic::Ellipse;
use crate::detect::EdgePoints;
use crate::error::Result;
use crate::frames::Pixel;
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

/// What explains the images of both cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// Both cameras stand on one side, or nothing explains the images better.
    Same,
    /// The second stands behind the target of the first.
    Opposite,
    /// The images of the second are flipped.
    Mirrored,
    /// The second stands behind the target, or its images are flipped: the views do not tell.
    OppositeOrMirrored,
}

/// Which it is: where the views of the cameras alone do not tell, by the cost of the common adjustment.
pub(super) fn side(problem: &RigProblem, monos: &[Mono], ways: &[Vec<Way>; 2], context: &Context<'_>) -> Side {
    let agree = |w: &[Way]| apart(w) == 0 && w[0].choice.spread() < NAMED_RAD;
    let [same, opposite] = ways.each_ref().map(|w| agree(w));
    if ways[1].is_empty() || same && !opposite { Side::Same } else { cheapest_side(problem, monos, ways, context) }
}

/// Views on which the cameras do not agree.
fn apart(ways: &[Way]) -> usize {
    ways.first().map_or(usize::MAX, |w| w.choice.outside().len())
}

/// The side that the common adjustment fits best, whatever the cameras alone say.
pub(super) fn cheapest_side(
    problem: &RigProblem,
    monos: &[Mono],
    [same, opposite]: &[Vec<Way>; 2],
    context: &Context<'_>,
) -> Side {
    let (limit_px, well_px) = (contradicts_px(monos), DOUBT * worst_px(monos));
    let fits = |problem: &RigProblem, ways: &[Way]| tried(problem, ways, context).filter(|t| t.rms_px < limit_px);
    let here = fits(problem, same);
    let well = here.is_some_and(|t| t.rms_px < well_px);
    if well && apart(opposite) > 0 && apart(opposite) >= apart(same) {
        return Side::Same;
    }
    let there = fits(problem, opposite);
    if well && there.is_none_or(|o| here.is_some_and(|t| t.as_good_as(&o))) {
        return Side::Same;
    }
    let over = flipped(problem, context).ok().and_then(|(problem, monos)| {
        let [near, far] = self::ways(&problem, &monos).map(|w| fits(&problem, &w));
        // What stands for a fault of the recording is claimed on nothing less than noise.
        better(near, far).filter(|t| t.converged && t.rms_px < well_px)
    });
    let best = better(better(here, there), over);
    let is_best = |t: Option<Trial>| t.zip(best).is_some_and(|(t, b)| t.as_good_as(&b));
    match [here, there, over].map(is_best) {
        [true, ..] => Side::Same,
        [_, true, false] => Side::Opposite,
        [_, true, true] => Side::OppositeOrMirrored,
        [.., true] => Side::Mirrored,
        // What is wrong with some of the views is told from where more of them agree.
        _ if apart(opposite) < apart(same) => Side::Opposite,
        _ => Side::Same,
    }
}

fn better(a: Option<Trial>, b: Option<Trial>) -> Option<Trial> {
    a.into_iter().chain(b).reduce(|a, b| if b.chi2 < a.chi2 { b } else { a })
}

/// The problem with the images of the second camera flipped left to right, and what the cameras find alone in it.
fn flipped(problem: &RigProblem, context: &Context<'_>) -> Result<(RigProblem, Vec<Mono>)> {
    let mut out = problem.clone();
    let last = problem.starts[1].size_px[0] - 1.0;
    let over = |u: &f64| last - u;
    for (image, ellipses) in out.model.images.iter_mut().zip(&mut out.ellipses).filter(|(i, _)| i.camera == 1) {
        let disc = |d: &DiscObservation| {
            let edge = EdgePoints { u_px: d.edge.u_px.iter().map(over).collect(), ..d.edge.clone() };
            DiscObservation::new(d.disc, edge)
        };
        image.discs = image.discs.iter().map(disc).collect();
        for e in ellipses {
            let center_px = Pixel { u_px: last - e.center_px.u_px, ..e.center_px };
            *e = Ellipse { center_px, angle_rad: -e.angle_rad, ..*e };
        }
    }
    let monos = [0, 1].map(|c| calibrate_camera(&out, c, context.told)).into_iter().collect::<Result<_>>()?;
    Ok((out, monos))
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
