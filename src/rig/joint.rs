//! The motion between the cameras by consensus of the views, scale, and the common adjustment.

use super::mono::calibrate_camera;
use super::{Mono, RigProblem, RigSolution, rms_of};
use crate::bundle::{
    AdjustOptions, Fact, Iteration, PlanePosition, SolveOptions, State, TargetShape, Termination, ViewPlace, ViewState,
    adjust,
};
use crate::camera::{Camera, Intrinsics};
use crate::error::{Error, Insufficient, Result, Unusable};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::rigid::{Motion, rotation_log};
use nalgebra::{Matrix3, Vector3};

/// Motions of two views that differ by more than this contradict each other, rad. Poses of a camera calibrated alone are
/// good to a few tenths of a degree.
const CONSENSUS_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;

/// A common adjustment that fits worse than this times the cameras alone (and than 0.3 px) is a contradiction.
const CONTRADICTION: f64 = 5.0;

/// Calibrates one or two cameras.
///
/// # Errors
/// [`Insufficient`] where views are missing, degenerate or contradict each other (with the view or camera named),
/// [`Unusable::NotConverged`] where the adjustment does not reach its minimum.
pub fn calibrate_rig(
    problem: &RigProblem,
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<RigSolution> {
    let mut problem = problem.clone();
    let mut swapped = vec![false; problem.model.images.len()];
    order_pairs(&mut problem, &mut swapped);
    let count = problem.model.cameras.len();
    let monos: Vec<Mono> = (0..count).map(|c| calibrate_camera(&problem, c)).collect::<Result<_>>()?;
    let mut start = None;
    let mut doubt = None;
    if count == 1 {
        start = Some(single_start(&problem, &monos[0])?);
    } else {
        let agreed = agreed_motion(&mut problem, &monos, &mut swapped)?;
        let state = pair_start(&problem, &monos, &agreed)?;
        if agreed.outside.is_empty() {
            start = Some(state);
        } else {
            // A weak pose of one camera alone is no contradiction: let the common adjustment decide.
            let quick =
                AdjustOptions { solve: SolveOptions { decrement: 1e-1, iterations: 100 }, rounds: 0, ..*options };
            let trial = adjust(&problem.model, state, &quick, observe);
            let alone = monos.iter().map(|m| m.rms_px).fold(0.0, f64::max);
            if rms_of(&problem.model, &trial.state).is_some_and(|r| r < (CONTRADICTION * alone).max(0.3)) {
                start = Some(trial.state);
            } else {
                doubt = Some(contradiction(&problem, &monos, &agreed));
            }
        }
    }
    let Some(start) = start else {
        return Err(doubt.unwrap_or_else(|| Error::Bug("no start and no reason".into())));
    };
    let adjustment = adjust(&problem.model, start, options, observe);
    match adjustment.termination {
        Termination::Converged => {}
        Termination::Cancelled => {}
        _ if adjustment.decrement < 1e-3 => {}
        t => {
            return Err(Unusable::NotConverged {
                reason: t.word().into(),
                decrement: adjustment.decrement,
                wanted: options.solve.decrement,
            }
            .into());
        }
    }
    Ok(RigSolution { adjustment, swapped })
}

/// Labels the larger disc of each pair as the model's larger one; equal discs keep their order.
fn order_pairs(problem: &mut RigProblem, swapped: &mut [bool]) {
    if !matches!(problem.model.target.shape, TargetShape::Pair { .. }) {
        return;
    }
    let first_is_smaller = matches!(problem.shape_mm, [_, Some(r0), Some(r1)] if r0 < r1);
    for k in 0..problem.model.images.len() {
        let size = |disc: usize| {
            let at = problem.model.images[k].discs.iter().position(|d| d.disc == disc);
            at.map(|i| problem.ellipses[k][i].semi_major_px)
        };
        if let (Some(a), Some(b)) = (size(0), size(1)) {
            if (a < b) != first_is_smaller {
                swap_image(problem, k, swapped);
            }
        }
    }
}

fn swap_image(problem: &mut RigProblem, k: usize, swapped: &mut [bool]) {
    for d in &mut problem.model.images[k].discs {
        d.disc = 1 - d.disc;
    }
    swapped[k] = !swapped[k];
}

/// The same pose with the two discs exchanged.
fn exchanged(pose: &Motion<Cam, Target>, shape: &[f64; 3]) -> (Motion<Cam, Target>, [f64; 3]) {
    let half_turn = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
    let swap: Motion<Target, Target> = Motion::new(half_turn, Vector3::new(shape[0], 0.0, 0.0));
    (*pose * swap, [shape[0], shape[2], shape[1]])
}

/// A pose as a horizontally mirrored camera would have found it.
fn mirrored(pose: &Motion<Cam, Target>) -> Motion<Cam, Target> {
    let d = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
    let f = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    Motion::new(d * pose.rotation * f, d * pose.translation_mm)
}

/// What the views agree on.
struct Agreed {
    /// Second solver frame from first; translation in the scale of the views, or of unit length for views with scales of their own.
    motion: Motion<Cam, Rig>,
    /// Poses of the second camera after exchanges.
    right: Vec<Option<(Motion<Cam, Target>, [f64; 3])>>,
    /// The vote at the centre of the consensus.
    center: Vote,
    /// Views that disagree.
    outside: Vec<usize>,
    /// Views seen by both cameras.
    common: usize,
}

#[derive(Clone, Copy)]
struct Vote {
    view: usize,
    swap: bool,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

fn angle(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    rotation_log(&(a * b.transpose())).norm()
}

type Poses = [Option<(Motion<Cam, Target>, [f64; 3])>];

fn votes(pair: bool, left: &Poses, right: &Poses) -> Vec<Vote> {
    let mut out = vec![];
    for (view, (l, r)) in left.iter().zip(right).enumerate() {
        let (Some((l, _)), Some((r, shape))) = (l, r) else { continue };
        for swap in if pair { vec![false, true] } else { vec![false] } {
            let r = if swap { exchanged(r, shape).0 } else { *r };
            let m = r * l.inverse();
            out.push(Vote { view, swap, rotation: m.rotation, translation: m.translation_mm });
        }
    }
    out
}

/// The vote that most views support, and for each view its best vote and distance from the chosen one.
fn consensus(votes: &[Vote], views: usize) -> Option<(Vote, Vec<Option<(Vote, f64)>>)> {
    let best_per_view = |center: &Vote| {
        let mut best: Vec<Option<(Vote, f64)>> = vec![None; views];
        for v in votes {
            let gap = angle(&v.rotation, &center.rotation)
                + 0.3 * v.translation.normalize().angle(&center.translation.normalize());
            if best[v.view].is_none_or(|(_, g)| gap < g) {
                best[v.view] = Some((*v, gap));
            }
        }
        best
    };
    let cost =
        |center: &Vote| -> f64 { best_per_view(center).iter().flatten().map(|(_, g)| g.min(CONSENSUS_RAD)).sum() };
    let center = votes.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
    Some((*center, best_per_view(center)))
}

fn spread(best: &[Option<(Vote, f64)>]) -> f64 {
    let mut gaps: Vec<f64> = best.iter().flatten().map(|(_, g)| *g).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(f64::INFINITY)
}

fn agreed_motion(problem: &mut RigProblem, monos: &[Mono], swapped: &mut [bool]) -> Result<Agreed> {
    let views = problem.model.views.len();
    let pair = matches!(problem.model.target.shape, TargetShape::Pair { .. });
    let (left, right) = (&monos[0].poses, &monos[1].poses);
    let votes_now = votes(pair, left, right);
    let (center, best) = consensus(&votes_now, views).ok_or_else(|| {
        Insufficient::Degenerate(
            "no view was seen by both cameras; at least one view needs an image of each camera".into(),
        )
    })?;
    let outside: Vec<usize> = best.iter().flatten().filter(|(_, g)| *g > CONSENSUS_RAD).map(|(v, _)| v.view).collect();
    let common = best.iter().flatten().count();
    let mut agreed_right = right.clone();
    let mut rotations = Matrix3::zeros();
    let mut shift = Vector3::zeros();
    let per_view = problem.model.target.per_view();
    let mut inside = 0.0;
    for (vote, gap) in best.iter().flatten() {
        if vote.swap {
            if let Some(k) = problem.model.images.iter().position(|i| i.camera == 1 && i.view == vote.view) {
                swap_image(problem, k, swapped);
            }
            agreed_right[vote.view] = right[vote.view].as_ref().map(|(m, s)| exchanged(m, s));
        }
        if *gap <= CONSENSUS_RAD {
            rotations += vote.rotation;
            shift += if per_view { vote.translation.normalize() } else { vote.translation };
            inside += 1.0;
        }
    }
    let rotation = crate::rigid::orthonormalised(&rotations);
    Ok(Agreed { motion: Motion::new(rotation, shift / inside), right: agreed_right, center, outside, common })
}

/// Finds out why views do not agree, and says it.
fn contradiction(problem: &RigProblem, monos: &[Mono], agreed: &Agreed) -> Error {
    let Agreed { center, outside, common, .. } = agreed;
    let pair = matches!(problem.model.target.shape, TargetShape::Pair { .. });
    let names: Vec<&str> = problem.model.cameras.iter().map(|c| c.name.as_str()).collect();
    let views = problem.model.views.len();
    if 2 * outside.len() >= *common {
        for (c, other) in [(1, 0), (0, 1)] {
            let flip = |p: &Option<(Motion<Cam, Target>, [f64; 3])>| p.as_ref().map(|(m, s)| (mirrored(m), *s));
            let flipped: Vec<_> = monos[c].poses.iter().map(flip).collect();
            let v =
                if c == 1 { votes(pair, &monos[0].poses, &flipped) } else { votes(pair, &flipped, &monos[1].poses) };
            if consensus(&v, views).is_some_and(|(_, b)| spread(&b) < 0.3 * CONSENSUS_RAD) {
                return Insufficient::Inconsistent(format!(
                    "the images of camera \"{}\" are mirrored against those of camera \"{}\" (or the other way round): the views agree only when one is flipped; switch off the mirroring of that camera, or of a mirror in its path, in the recording software",
                    names[c], names[other]
                ))
                .into();
            }
        }
    }
    let exchanged_views: Vec<usize> = outside
        .iter()
        .copied()
        .filter(|v| match (&monos[0].poses[*v], &monos[1].poses[*v]) {
            // Poses found by the wrong camera are off by its own tilt at most, far less than the angle between cameras.
            (Some((l, s)), Some((r, _))) => [*l, exchanged(l, s).0]
                .iter()
                .any(|l| angle(&(l.rotation * r.rotation.transpose()), &center.rotation) < 5.0 * CONSENSUS_RAD),
            _ => false,
        })
        .collect();
    let list = |v: &[usize]| v.iter().map(usize::to_string).collect::<Vec<_>>().join(", ");
    if exchanged_views.len() == outside.len() {
        return Insufficient::Inconsistent(format!(
            "the images of cameras \"{}\" and \"{}\" seem to be exchanged in view(s) {} (counted from 0); exchange their file names in the rig file",
            names[0], names[1], list(outside)
        ))
        .into();
    }
    Insufficient::Inconsistent(format!(
        "the two cameras do not see the same target position in view(s) {} (counted from 0): {} of {common} views agree on how the cameras stand to each other; check that both images of a view were taken at the same moment, that they are not exchanged, and that no camera was moved",
        list(outside),
        common - outside.len()
    ))
    .into()
}

fn single_start(problem: &RigProblem, mono: &Mono) -> Result<State> {
    let nobody = Vote { view: 0, swap: false, rotation: Matrix3::identity(), translation: Vector3::zeros() };
    let right = vec![None; problem.model.views.len()];
    let nothing = Agreed { motion: Motion::identity(), right, center: nobody, outside: vec![], common: 0 };
    let mut state = pair_start(problem, std::slice::from_ref(mono), &nothing)?;
    state.camera_from_first.truncate(1);
    Ok(state)
}

/// State of the common adjustment, scaled by the metric fact.
fn pair_start(problem: &RigProblem, monos: &[Mono], agreed: &Agreed) -> Result<State> {
    let model = &problem.model;
    let per_view = model.target.per_view();
    let left_from_right = Motion::<Rig, Cam>::new(
        agreed.motion.rotation.transpose(),
        -(agreed.motion.rotation.transpose() * agreed.motion.translation_mm),
    );
    let mut poses: Vec<(Motion<Rig, Target>, [f64; 3])> = vec![];
    // A view outside the consensus has one weak pose: that of the camera whose fit alone is worse is left away.
    let right_is_better = monos.get(1).is_some_and(|r| r.rms_px < monos[0].rms_px);
    for v in 0..model.views.len() {
        let prefer_right = right_is_better && agreed.outside.contains(&v) && agreed.right[v].is_some() && !per_view;
        let left = monos[0].poses[v].map(|(m, s)| (Motion::<Rig, Target>::new(m.rotation, m.translation_mm), s));
        let pose = match (left, agreed.right[v]) {
            (Some((m, s)), Some((r, _))) if per_view => {
                // The view's own scale: its shift between the cameras against the unit baseline.
                let shift = r.translation_mm - agreed.motion.rotation * m.translation_mm;
                Some(scaled(&m, &s, 1.0 / shift.norm()))
            }
            (Some(own), _) if !prefer_right => Some(own),
            (_, Some((r, s))) => Some((left_from_right * r, s)),
            _ => None,
        };
        poses.push(pose.ok_or_else(|| Insufficient::Degenerate(format!("view {v} has no usable image")))?);
    }
    let shape0 = poses[0].1;
    let scale = metric_scale(problem, agreed, &poses);
    for p in &mut poses {
        *p = scaled(&p.0, &p.1, scale);
    }
    let motion: Motion<Cam, Rig> = Motion::new(agreed.motion.rotation, agreed.motion.translation_mm * scale);
    let first_from_plane = plane_of(problem, &poses);
    let views =
        poses.iter().zip(&model.views).map(|((m, s), view)| view_state(m, s, view.place, first_from_plane.as_ref()));
    let mut state = State {
        cameras: monos.iter().enumerate().map(|(c, m)| joint_start(problem, c, &m.intrinsics)).collect(),
        camera_from_first: vec![Motion::identity(), motion],
        first_from_plane,
        views: views.collect(),
        shape_mm: shape0.map(|s| s * scale),
        offsets_mm: model.target.offset_sigma_mm.map_or(vec![], |_| vec![[0.0; 4]; model.target.disc_count()]),
    };
    if !model.target.free[0] && !per_view {
        state.shape_mm[0] = problem.shape_mm[0].unwrap_or(state.shape_mm[0]);
    }
    Ok(state)
}

/// Intrinsics with which the common adjustment starts.
///
/// Where every disc is estimated, a camera alone had to explain printing errors by its lens: axis point and distortion have run
/// away with them. The effective pinhole, which carries all poses, has not; the rest starts again at the sensor's centre.
fn joint_start(problem: &RigProblem, c: usize, alone: &Intrinsics) -> Intrinsics {
    let (model, start) = (&problem.model.cameras[c], &problem.starts[c]);
    if problem.model.target.offset_sigma_mm.is_none() || !model.uses_pinhole_frame() {
        return *alone;
    }
    let Ok(camera) = Camera::new(*alone) else { return *alone };
    let center = |k: usize, size: f64| {
        if model.free[k] { start.values[k].unwrap_or((size - 1.0) / 2.0) } else { alone.to_array()[k] }
    };
    let (cx, cy) = (center(2, start.size_px[0]), center(3, start.size_px[1]));
    let mut p = camera.effective_pinhole().with_axis_point(cx, cy, alone.aspect).to_array();
    for k in 6..10 {
        p[k] = start.values[k].filter(|_| model.free[k] || k == 9).unwrap_or(if model.free[k] {
            0.0
        } else {
            alone.to_array()[k]
        });
    }
    Intrinsics::from_array(&p, alone.radial)
}

fn scaled(m: &Motion<Rig, Target>, shape: &[f64; 3], by: f64) -> (Motion<Rig, Target>, [f64; 3]) {
    (Motion::new(m.rotation, m.translation_mm * by), shape.map(|s| s * by))
}

/// Factor that brings the start to the metric fact; 1 where the target itself is metric.
fn metric_scale(problem: &RigProblem, agreed: &Agreed, poses: &[(Motion<Rig, Target>, [f64; 3])]) -> f64 {
    let model = &problem.model;
    for fact in &model.facts {
        match *fact {
            Fact::Baseline { value_mm, .. } => return value_mm / agreed.motion.translation_mm.norm(),
            Fact::Shape { parameter, view, value_mm, .. } => return value_mm / poses[view.unwrap_or(0)].1[parameter],
            Fact::Intrinsic { .. } | Fact::Focus(_) => {}
        }
    }
    // Steps of a traverse, where nothing else is metric.
    if model.target.free[0] {
        let at = |i: usize| match model.views[i].place {
            ViewPlace::InPlane { known: PlanePosition::Unknown, .. } | ViewPlace::Free => None,
            ViewPlace::InPlane { z_mm, .. } => {
                Some((z_mm, poses[i].0.rotation.column(2).dot(&poses[i].0.translation_mm)))
            }
        };
        let all: Vec<(f64, f64)> = (0..poses.len()).filter_map(at).collect();
        let ends = all
            .iter()
            .copied()
            .reduce(|a, b| if b.0 < a.0 { b } else { a })
            .zip(all.iter().copied().reduce(|a, b| if b.0 > a.0 { b } else { a }));
        if let Some((low, high)) = ends.filter(|(l, h)| h.0 > l.0 && h.1 != l.1) {
            return ((high.0 - low.0) / (high.1 - low.1)).abs();
        }
    }
    1.0
}

/// Mean plane of the views that lie in it.
fn plane_of(problem: &RigProblem, poses: &[(Motion<Rig, Target>, [f64; 3])]) -> Option<Motion<Rig, Sheet>> {
    let mut frames = problem.model.views.iter().zip(poses).filter_map(|(view, (m, _))| match view.place {
        ViewPlace::InPlane { known: PlanePosition::Unknown, .. } => Some((*m, None)),
        ViewPlace::InPlane { z_mm, .. } => Some((*m, Some(z_mm))),
        ViewPlace::Free => None,
    });
    let (first, z) = frames.next()?;
    let (mut normal, mut depth, mut n) = (Vector3::zeros(), 0.0, 0.0);
    for (m, z) in std::iter::once((first, z)).chain(frames) {
        let axis = m.rotation.column(2);
        normal += axis;
        if let Some(z) = z {
            depth += axis.dot(&m.translation_mm) - z;
            n += 1.0;
        }
    }
    let axis = normal.normalize();
    let x = (first.rotation.column(0) - axis * axis.dot(&first.rotation.column(0))).normalize();
    let rotation = Matrix3::from_columns(&[x, axis.cross(&x), axis]);
    // The foot of the first view's origin: near the images, so that tilts and depth are little correlated.
    let origin = first.translation_mm + axis * (depth / f64::max(n, 1.0) - axis.dot(&first.translation_mm));
    Some(Motion::new(rotation, origin))
}

fn view_state(
    m: &Motion<Rig, Target>,
    shape: &[f64; 3],
    place: ViewPlace,
    plane: Option<&Motion<Rig, Sheet>>,
) -> ViewState {
    match (place, plane) {
        (ViewPlace::InPlane { z_mm, known }, Some(plane)) => {
            let q: Motion<Sheet, Target> = plane.inverse() * *m;
            let turn = q.rotation.m21.atan2(q.rotation.m11);
            let (s, c) = turn.sin_cos();
            let rotation = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
            let z = if known == PlanePosition::Unknown { q.translation_mm.z } else { z_mm };
            let planar = Motion::new(rotation, Vector3::new(q.translation_mm.x, q.translation_mm.y, z));
            ViewState { first_from_target: *plane * planar, plane_from_target: Some(planar), shape_mm: *shape }
        }
        _ => ViewState { first_from_target: *m, plane_from_target: None, shape_mm: *shape },
    }
}
