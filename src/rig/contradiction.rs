//! Cameras that contradict each other, and why: a mirrored camera, one behind the target, images exchanged between cameras or views, or of
//! different moments.

use super::consensus::{CONSENSUS_RAD, Poses, choices, votes};
use super::joint::{Context, agrees};
use super::labels::{image_at, is_pair};
use super::mono::calibrate_camera;
use super::sides::{Way, behind};
use super::{Mono, Pose, RigProblem, side_by_side};
use crate::error::{Error, Insufficient, Result};
use crate::frames::{Cam, Target};
use crate::rigid::Motion;
use nalgebra::{Matrix3, Vector3};

/// A common adjustment that fits worse than this times the cameras alone (and than 0.3 px) is a contradiction.
const CONTRADICTION: f64 = 5.0;

/// One that fits worse than this times the cameras alone makes it worth asking whether images and views are what they are said to be.
pub(super) const DOUBT: f64 = 2.0;

/// Largest root mean square residual of a camera alone, px.
pub(super) fn worst_px(monos: &[Mono]) -> f64 {
    monos.iter().map(|m| m.rms_px).fold(0.0, f64::max)
}

/// Residuals of a common adjustment beyond this contradict what the cameras found alone, px.
pub(super) fn contradicts_px(monos: &[Mono]) -> f64 {
    (CONTRADICTION * worst_px(monos)).max(0.3)
}

/// A pose as a horizontally mirrored camera would have found it.
fn mirrored(pose: &Motion<Cam, Target>) -> Motion<Cam, Target> {
    let d = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
    let f = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    Motion::new(d * pose.rotation * f, d * pose.translation_mm)
}

/// Disagreement up to which all views together name a cause, rad.
pub(super) const NAMED_RAD: f64 = 0.3 * CONSENSUS_RAD;

/// A camera whose images agree with the other's when they are flipped, if there is one.
fn mirrored_camera(problem: &RigProblem, monos: &[Mono]) -> Option<usize> {
    [1, 0].into_iter().find(|&c| {
        let flip = |p: &Option<Pose>| p.as_ref().map(|(m, s)| (mirrored(m), *s));
        let flipped: Vec<_> = monos[c].poses.iter().map(flip).collect();
        let poses = [0, 1].map(|k| if k == c { &flipped } else { &monos[k].poses });
        let votes = votes(problem, poses[0], poses[1], true);
        choices(problem, &votes).first().is_some_and(|b| b.spread() < NAMED_RAD)
    })
}

/// Words where one camera's images are flipped.
pub(super) fn told_mirrored(problem: &RigProblem, camera: usize) -> String {
    let names = names(problem);
    format!(
        "the images of camera \"{}\" are mirrored against those of camera \"{}\" (or the other way round): the views agree only when one is flipped; \
         switch off the mirroring of that camera, or of a mirror in its path, in the recording software",
        names[camera],
        names[1 - camera]
    )
}

/// Words where cameras that seem to be on opposite sides may as well be on one side, the second of them mirrored.
pub(super) fn told_opposite_or_mirrored(problem: &RigProblem) -> String {
    let names = names(problem);
    format!(
        "the views agree when the images of camera \"{}\" are mirrored, and as well when the cameras \"{}\" and \"{}\" look at the target from opposite sides: views \
         parallel to each other cannot tell; switch off the mirroring if there is one, and record at least one view tilted by 5 degrees or more",
        names[1], names[0], names[1]
    )
}

fn names(problem: &RigProblem) -> Vec<&str> {
    problem.model.cameras.iter().map(|c| c.name.as_str()).collect()
}

/// Views on which the cameras do not agree.
fn apart(problem: &RigProblem, left: &Poses, right: &Poses) -> usize {
    choices(problem, &votes(problem, left, right, false)).first().map_or(usize::MAX, |c| c.outside().len())
}

/// Two views whose images of one camera, exchanged, make all views agree; of several the ones that no others do.
fn views_exchanged(problem: &RigProblem, monos: &[Mono], outside: &[usize]) -> Option<[usize; 2]> {
    let views = problem.model.views.len();
    let pairs = outside.iter().flat_map(|&a| (0..views).filter(move |&b| b != a).map(move |b| [a.min(b), a.max(b)]));
    let mut agreeing: Vec<[usize; 2]> = pairs
        .filter(|&[a, b]| {
            let mut right = monos[1].poses.clone();
            right.swap(a, b);
            apart(problem, &monos[0].poses, &right) == 0
        })
        .collect();
    agreeing.sort_unstable();
    agreeing.dedup();
    if let [one] = agreeing[..] { Some(one) } else { None }
}

/// The problem with the images of a view given to the other camera.
fn exchanged(problem: &RigProblem, view: usize) -> RigProblem {
    let mut out = problem.clone();
    out.model.images.iter_mut().filter(|i| i.view == view).for_each(|i| i.camera = 1 - i.camera);
    out
}

/// Views in which the images of the two cameras, exchanged, make everything agree; none where nothing does.
///
/// An image of the wrong camera spoils what that camera finds alone, so both are calibrated again for every view that may be it. The view
/// that leaves the fewest apart is kept, then the next.
fn cameras_exchanged(problem: &RigProblem, way: &Way, outside: usize, context: &Context<'_>) -> Vec<usize> {
    let views: Vec<usize> =
        (0..problem.model.views.len()).filter(|&v| (0..2).all(|c| image_at(problem, c, v).is_some())).collect();
    let (mut problem, mut out, mut least) = (problem.clone(), vec![], (outside, worst_px(&way.monos)));
    while 2 * (out.len() + 1) < views.len() {
        let rest: Vec<usize> = views.iter().copied().filter(|v| !out.contains(v)).collect();
        let tried = side_by_side(&rest, |&v| {
            let trial = exchanged(&problem, v);
            let alone: Result<Vec<Mono>> = (0..2).map(|c| calibrate_camera(&trial, c, context.told)).collect();
            let monos = alone.ok()?;
            let sided = way.turned(&monos);
            let score = (apart(&trial, &sided[0].poses, &sided[1].poses), worst_px(&monos));
            Some((score, v, monos))
        });
        let better = |a: &(usize, f64), b: &(usize, f64)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1));
        let best = tried.into_iter().flatten().min_by(|a, b| better(&a.0, &b.0));
        let Some((score, view, monos)) = best.filter(|b| better(&b.0, &least).is_lt()) else { return vec![] };
        out.push(view);
        problem = exchanged(&problem, view);
        if agrees(&problem, &monos, context) {
            out.sort_unstable();
            return out;
        }
        least = score;
    }
    vec![]
}

/// What makes the cameras' views agree, in words: images mirrored or exchanged; `None` where neither does.
pub(super) fn exchanged_or_mirrored(
    problem: &RigProblem,
    way: &Way,
    outside: &[usize],
    context: &Context<'_>,
) -> Option<String> {
    // Of pairs it was told by the cost.
    if 2 * outside.len() >= way.choice.common()
        && !is_pair(problem)
        && let Some(words) = mirrored_or_behind(problem, &way.monos)
    {
        return Some(words);
    }
    let names = names(problem);
    if let Some([a, b]) = views_exchanged(problem, &way.monos, outside) {
        return Some(format!(
            "the images of camera \"{}\", or those of camera \"{}\", seem to be exchanged between the view(s) {a}, {b} (counted from 0): exchange the file \
             names of one camera in the rig file",
            names[0], names[1]
        ));
    }
    let views = cameras_exchanged(problem, way, outside.len(), context);
    (!views.is_empty()).then(|| {
        format!(
            "the images of cameras \"{}\" and \"{}\" seem to be exchanged in view(s) {} (counted from 0); exchange their file names in the rig file",
            names[0],
            names[1],
            listed(&views)
        )
    })
}

/// Words where the views of a target that is made for one side agree when one camera's images are flipped, or when it is behind the target.
fn mirrored_or_behind(problem: &RigProblem, monos: &[Mono]) -> Option<String> {
    let names = names(problem);
    let mirrored = mirrored_camera(problem, monos).map(|c| told_mirrored(problem, c));
    let over = behind(monos);
    let opposite = choices(problem, &votes(problem, &over[0].poses, &over[1].poses, true));
    if opposite.first().is_none_or(|o| o.spread() >= NAMED_RAD) {
        return mirrored;
    }
    let sides = format!(
        "the cameras \"{}\" and \"{}\" look at the target from opposite sides, which is not supported for grids and plates: they have one front; use two discs that both \
         sides show, such as bubbles in the sheet",
        names[0], names[1]
    );
    Some(match mirrored {
        Some(words) => {
            format!("one of two things, which views parallel to each other cannot tell apart: {words}; or {sides}")
        }
        None => sides,
    })
}

fn listed(views: &[usize]) -> String {
    views.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
}

/// Finds out why the cameras' views do not agree, and says it.
pub(super) fn cameras_disagree(problem: &RigProblem, way: &Way, outside: &[usize], context: &Context<'_>) -> Error {
    let words = exchanged_or_mirrored(problem, way, outside, context).unwrap_or_else(|| {
        let common = way.choice.common();
        format!(
            "the two cameras do not see the same target position in view(s) {} (counted from 0): {} of {common} views agree on how the cameras stand to \
             each other; check that both images of a view were taken at the same moment, that they are not exchanged, and that no camera was moved",
            listed(outside),
            common - outside.len()
        )
    });
    Insufficient::Inconsistent(words).into()
}
