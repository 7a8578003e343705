//! The motion between the cameras by consensus of the views, scale, and the common adjustment.

use super::consensus::{CONSENSUS_RAD, Choice};
use super::contradiction::{
    DOUBT, cameras_disagree, contradicts_px, exchanged_or_mirrored, told_mirrored, told_opposite_or_mirrored, worst_px,
};
use super::labels::{changed, image_at, is_pair, labels, order_pairs, relabel};
use super::lone::{lone_camera, place_lone_views};
use super::mono::{calibrate_camera, thinned_model};
use super::moved::explaining_step;
use super::off_plane::views_off_plane;
use super::open::{adjusted_as_usual, left_open, usual_where_open};
use super::pitches::shifted;
use super::print::labels_by_print;
use super::sides::{Side, Way, cheapest_side, side, ways};
use super::starts::{best_start, elsewhere, joint_start};
use super::windows::set_windows;
use super::{Mono, Pose, RigProblem, RigSolution, Told, rms_of, side_by_side};
use crate::bundle::{
    AdjustOptions, Adjustment, Fact, Iteration, Model, PlanePosition, SolveOptions, State, Termination, ViewPlace,
    ViewState, adjust,
};
use crate::detect::pattern::Relabelling;
use crate::error::{Insufficient, Result, Unusable};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::rigid::Motion;
use nalgebra::{Matrix3, Vector3};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

/// Labels whose chi-square is larger by less than this, in units of the best one's variance factor, fit as well as the best.
const AS_GOOD: f64 = 30.0;

/// Told of every iteration; returns false to stop.
type Observe<'a> = &'a mut (dyn FnMut(&Iteration) -> bool + Send);

/// Hands iterations from several threads to one observer, which is not asked again once it has said no.
struct Asked<'a> {
    observe: Mutex<Observe<'a>>,
    stopped: AtomicBool,
}

impl Asked<'_> {
    fn goes_on(&self, iteration: &Iteration) -> bool {
        let ask = || self.observe.lock().is_ok_and(|mut observe| observe(iteration));
        let on = !self.stopped.load(Ordering::Relaxed) && ask();
        if !on {
            self.stopped.store(true, Ordering::Relaxed);
        }
        on
    }
}

/// Calibrates one or two cameras.
///
/// # Errors
/// [`Insufficient`] where views are missing, degenerate or contradict each other (with the view or camera named),
/// [`Unusable::NotConverged`] where the adjustment does not reach its minimum, [`Unusable::Cancelled`] where `observe` stopped it.
///
/// Within a thread pool cameras and starts are tried side by side; the result is the same to the bit.
pub fn calibrate_rig(problem: &RigProblem, options: &AdjustOptions, observe: Observe<'_>) -> Result<RigSolution> {
    let mut problem = problem.clone();
    order_pairs(&mut problem);
    let asked = Asked { observe: Mutex::new(observe), stopped: AtomicBool::new(false) };
    let told = |i: &Iteration| asked.goes_on(i);
    let cameras: Vec<usize> = (0..problem.model.cameras.len()).collect();
    let monos = side_by_side(&cameras, |c| calibrate_camera(&problem, *c, &told));
    let monos: Vec<Mono> = monos.into_iter().collect::<Result<_>>()?;
    let context = Context { options, told: &told };
    let solved = together(&problem, &monos, &context);
    if asked.stopped.load(Ordering::Relaxed) {
        return Err(Unusable::Cancelled.into());
    }
    let off_plane = views_off_plane(&problem, &monos, solved.as_ref().ok(), &context)?;
    let mut found = solved?;
    found.undecided.extend(off_plane);
    match found.adjustment.termination {
        Termination::Converged => {}
        Termination::Cancelled => return Err(Unusable::Cancelled.into()),
        _ if found.adjustment.decrement < 1e-3 => {}
        t => {
            if let Some(step) = explaining_step(&found, &monos, &context) {
                return Err(Insufficient::Inconsistent(step.words()).into());
            }
            let Together { problem, adjustment, .. } = found;
            return Err(Unusable::NotConverged {
                reason: format!("{}{}", t.word(), weak_windows(&problem.model)),
                decrement: adjustment.decrement,
                wanted: options.solve.decrement,
                besides: left_open(&adjustment),
            }
            .into());
        }
    }
    let Together { problem, adjustment, undecided, .. } = found;
    let disc_of = problem.model.images.iter().map(|i| i.discs.iter().map(|d| d.disc).collect()).collect();
    Ok(RigSolution { adjustment, labels: labels(&problem), disc_of, undecided })
}

/// A common adjustment, wherever it ended.
pub(super) struct Together {
    /// The problem with the labels that were decided.
    pub(super) problem: RigProblem,
    pub(super) adjustment: Adjustment,
    /// Where it started: poses of a camera alone, and the motion on which most views agree.
    pub(super) start: State,
    undecided: Vec<String>,
}

/// All cameras in one adjustment, from what each found alone.
pub(super) fn together(problem: &RigProblem, monos: &[Mono], context: &Context<'_>) -> Result<Together> {
    let [_, _] = monos else {
        return Ok(adjusted((problem.clone(), single_start(problem, &monos[0])?), vec![], context));
    };
    let ways = ways(problem, monos);
    let believed = side(problem, monos, &ways, context);
    let found = on_side(problem, believed, &ways, context)?;
    let explained = || rms_of(&found.problem.model, &found.adjustment.state).is_some_and(|r| r < contradicts_px(monos));
    if !is_pair(problem) || found.adjustment.termination == Termination::Cancelled || explained() {
        return Ok(found);
    }
    // Views of a mirrored camera may agree by chance.
    match cheapest_side(problem, monos, &ways, context) {
        other if other == believed => Ok(found),
        other => on_side(problem, other, &ways, context),
    }
}

/// The common adjustment with the cameras on these sides.
fn on_side(problem: &RigProblem, side: Side, ways: &[Vec<Way>; 2], context: &Context<'_>) -> Result<Together> {
    let mut undecided = vec![];
    let start = match common_start(problem, side, ways, context, &mut undecided)? {
        Common::Start(start) => *start,
        Common::Doubtful(start, outside) => {
            let (labelled, state, way) = *start;
            if let Some(words) = exchanged_or_mirrored(problem, &way, &outside, context) {
                return Err(Insufficient::Inconsistent(words).into());
            }
            (labelled, state)
        }
        Common::Apart(way, outside) => return Err(cameras_disagree(problem, &way, &outside, context)),
    };
    Ok(adjusted(start, undecided, context))
}

fn adjusted(start: (RigProblem, State), undecided: Vec<String>, context: &Context<'_>) -> Together {
    let Context { options, told } = *context;
    let (mut problem, mut start) = start;
    labels_by_print(&mut problem, &mut start);
    let adjustment = adjusted_as_usual(&problem, &start, context).unwrap_or_else(|| {
        let start = best_start(&problem, start.clone(), options, told);
        let found = adjust(&problem.model, start, options, &mut |i| told(i));
        match elsewhere(&problem, &found, options, told) {
            Some(start) => adjust(&problem.model, start, options, &mut |i| told(i)),
            None => found,
        }
    });
    Together { problem, adjustment, start, undecided }
}

/// What to do where windows leave an adjustment without an end: directions in which the cost hardly changes.
fn weak_windows(model: &Model) -> &'static str {
    if model.cameras.iter().all(|c| c.window.is_none()) {
        ""
    } else if model.target.offset_sigma_mm.is_some() {
        "; windows and a target whose every dot is free bend images alike, and together find no end: hold the dots with adjust = \"shape\" in [target]"
    } else {
        "; what a window does, image distance and distortion do nearly as well: state distance_mm of [camera.window] with a smaller sigma, or add views \
         of the target tilted by 20 degrees and more"
    }
}

/// What the views agree on.
struct Agreed {
    /// Second solver frame from first; translation in the scale of the views, or of unit length for views with scales of their own.
    motion: Motion<Cam, Rig>,
    /// Poses of each camera after changes of labels.
    poses: [Vec<Option<Pose>>; 2],
    /// Views that disagree.
    outside: Vec<usize>,
}

/// How a common adjustment is made.
pub(super) struct Context<'a> {
    pub(super) options: &'a AdjustOptions,
    pub(super) told: Told<'a>,
}

/// What the cameras say together.
enum Common {
    /// The problem with the labels that fit best, and where its adjustment starts.
    Start(Box<(RigProblem, State)>),
    /// The same where views are apart and the adjustment brings them together, though not as well as the cameras alone let expect.
    Doubtful(Box<(RigProblem, State, Way)>, Vec<usize>),
    /// Views that no common motion explains, with the labels that explain most.
    Apart(Box<Way>, Vec<usize>),
}

/// Start of the common adjustment on these sides, with the labels that fit best.
fn common_start(
    problem: &RigProblem,
    side: Side,
    ways: &[Vec<Way>; 2],
    context: &Context<'_>,
    undecided: &mut Vec<String>,
) -> Result<Common> {
    let refused = |words: String| Err(Insufficient::Inconsistent(words).into());
    match side {
        Side::Same => start_of(problem, &ways[0], context, undecided),
        Side::Opposite => start_of(problem, &ways[1], context, undecided),
        Side::Mirrored => refused(told_mirrored(problem, 1)),
        Side::OppositeOrMirrored => refused(told_opposite_or_mirrored(problem)),
    }
}

/// Start of the common adjustment in the way that fits best, the first where others fit as well.
fn start_of(problem: &RigProblem, ways: &[Way], context: &Context<'_>, undecided: &mut Vec<String>) -> Result<Common> {
    let Context { options, told } = *context;
    let mut starts = vec![];
    for way in ways {
        let (labelled, agreed) = agreed(problem, &way.monos, &way.choice);
        let state = pair_start(&labelled, &way.monos, &agreed)?;
        starts.push((labelled, agreed, state));
    }
    let best = if starts.len() > 1 { cheapest(&starts, undecided, told) } else { 0 };
    let Some((mut labelled, mut views_agree, mut state)) = (!starts.is_empty()).then(|| starts.swap_remove(best))
    else {
        return Err(Insufficient::Degenerate(
            "no view was seen by both cameras; at least one view needs an image of each camera".into(),
        )
        .into());
    };
    let mut way = ways[best].clone();
    if let Some(better) = shifted(problem, &way, context) {
        (labelled, views_agree) = agreed(problem, &better.monos, &better.choice);
        state = pair_start(&labelled, &better.monos, &views_agree)?;
        way = better;
    }
    if views_agree.outside.is_empty() {
        return Ok(Common::Start(Box::new((labelled, state))));
    }
    // A weak pose of one camera alone is no contradiction: let the common adjustment decide, quickly first.
    let limit_px = contradicts_px(&way.monos);
    let fits = |model: &Model, state: State| {
        let trial = adjust(model, state, &quick(options), &mut |i| told(i)).state;
        rms_of(model, &trial).filter(|r| *r < limit_px).map(|r| (trial, r))
    };
    let mut model = labelled.model.clone();
    model.facts.extend(usual_where_open(&labelled, &state));
    let light = fits(&thinned_model(&model), State { offsets_mm: vec![], ..state.clone() });
    Ok(match light.and_then(|_| fits(&model, state)) {
        Some((state, rms_px)) if rms_px > DOUBT * worst_px(&way.monos) => {
            Common::Doubtful(Box::new((labelled, state, way)), views_agree.outside)
        }
        Some((state, _)) => Common::Start(Box::new((labelled, state))),
        None => Common::Apart(Box::new(way), views_agree.outside),
    })
}

/// An adjustment that tells whether something fits at all.
pub(super) fn quick(options: &AdjustOptions) -> AdjustOptions {
    AdjustOptions { solve: SolveOptions { decrement: 1e-1, iterations: 100 }, rounds: 0, ..*options }
}

/// How well a common adjustment of part of the edge points fits.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trial {
    pub(super) chi2: f64,
    pub(super) observations: f64,
    pub(super) rms_px: f64,
    pub(super) converged: bool,
}

impl Trial {
    /// Whether its chi-square is not larger than the other's by more than chance.
    pub(super) fn as_good_as(&self, other: &Self) -> bool {
        as_good(self.chi2, [other.chi2, other.observations])
    }
}

/// Whether a chi-square is not larger than one of so many observations by more than chance.
fn as_good(chi2: f64, [other, observations]: [f64; 2]) -> bool {
    // Too few observations never make a factor below one.
    chi2 < other + AS_GOOD * (other / observations).max(1.0)
}

/// The best of some ways; none where none has an adjustment.
pub(super) fn tried(problem: &RigProblem, ways: &[Way], context: &Context<'_>) -> Option<Trial> {
    let one = |way: &Way| -> Option<Trial> {
        let (labelled, agreed) = agreed(problem, &way.monos, &way.choice);
        let state = pair_start(&labelled, &way.monos, &agreed).ok()?;
        let model = thinned_model(&labelled.model);
        let state = State { offsets_mm: vec![], ..state };
        let trial = adjust(&model, state, &quick(context.options), &mut |i| (context.told)(i));
        let observations = (model.counts().observations as f64).max(1.0);
        let converged = trial.termination == Termination::Converged;
        Some(Trial { chi2: 2.0 * trial.cost, observations, rms_px: rms_of(&model, &trial.state)?, converged })
    };
    side_by_side(ways, one).into_iter().flatten().reduce(|a, b| if b.chi2 < a.chi2 { b } else { a })
}

/// Whether the cameras can be adjusted together.
pub(super) fn agrees(problem: &RigProblem, monos: &[Mono], context: &Context<'_>) -> bool {
    let ways = ways(problem, monos);
    let side = side(problem, monos, &ways, context);
    matches!(common_start(problem, side, &ways, context, &mut vec![]), Ok(Common::Start(_)))
}

/// The start with the labels that the common adjustment fits best, the first where others fit as well.
fn cheapest(starts: &[(RigProblem, Agreed, State)], undecided: &mut Vec<String>, told: Told<'_>) -> usize {
    let quick =
        AdjustOptions { solve: SolveOptions { decrement: 1e-1, iterations: 40 }, rounds: 0, outlier_sigmas: 6.0 };
    let tried = side_by_side(starts, |(problem, _, state)| {
        let model = thinned_model(&problem.model);
        let counts = model.counts();
        let state = State { offsets_mm: vec![], ..state.clone() };
        let trial = adjust(&model, state, &quick, &mut |i| told(i));
        (trial.termination, [2.0 * trial.cost, (counts.observations as f64).max(1.0)])
    });
    // Whoever stopped it stops the adjustment that follows as well.
    if tried.iter().any(|(t, _)| *t == Termination::Cancelled) {
        return 0;
    }
    let chi2: Vec<[f64; 2]> = tried.into_iter().map(|(_, chi2)| chi2).collect();
    let least = chi2.iter().copied().reduce(|a, b| if b[0] < a[0] { b } else { a }).unwrap_or([f64::INFINITY, 1.0]);
    let alike: Vec<usize> = (0..chi2.len()).filter(|&i| as_good(chi2[i][0], least)).collect();
    if alike.len() > 1 && !is_pair(&starts[0].0) {
        undecided.push(format!(
            "how the dots' labels of the two cameras belong together is not decided by the images ({} ways fit equally well): taken with \
             both cameras upright (target y up) and the grids' middles as near to each other as the images allow; record the \
             target in clearly different tilts and turns, or mark one of its dots",
            alike.len()
        ));
    }
    alike.first().copied().unwrap_or(0)
}

/// The problem with the labels of a choice, and what its views agree on.
fn agreed(problem: &RigProblem, monos: &[Mono], choice: &Choice) -> (RigProblem, Agreed) {
    let mut changes = vec![Relabelling::NONE; problem.model.images.len()];
    let mut poses = [monos[0].poses.clone(), monos[1].poses.clone()];
    let (mut rotations, mut shift, mut inside) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    let per_view = problem.model.target.per_view();
    for (vote, gap) in choice.best.iter().flatten() {
        for c in 0..2 {
            if let Some(k) = image_at(problem, c, vote.view) {
                changes[k] = vote.changes[c];
            }
            poses[c][vote.view] = monos[c].poses[vote.view].as_ref().map(|p| changed(problem, p, &vote.changes[c]));
        }
        if *gap <= CONSENSUS_RAD {
            let m = vote.motion();
            rotations += m.rotation;
            shift += if per_view { m.translation_mm.normalize() } else { m.translation_mm };
            inside += 1.0;
        }
    }
    let motion = Motion::new(crate::rigid::orthonormalised(&rotations), shift / inside);
    let mut labelled = problem.clone();
    relabel(&mut labelled, &changes);
    (labelled, Agreed { motion, poses, outside: choice.outside() })
}

fn single_start(problem: &RigProblem, mono: &Mono) -> Result<State> {
    let poses = [mono.poses.clone(), vec![None; problem.model.views.len()]];
    let nothing = Agreed { motion: Motion::identity(), poses, outside: vec![] };
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
        let prefer_right = right_is_better && agreed.outside.contains(&v) && agreed.poses[1][v].is_some() && !per_view;
        let left = agreed.poses[0][v].map(|(m, s)| (Motion::<Rig, Target>::new(m.rotation, m.translation_mm), s));
        let pose = match (left, agreed.poses[1][v]) {
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
    place_lone_views(problem, &agreed.poses, &motion, plane_of(problem, &poses).as_ref(), &mut poses);
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
        ovals_mm: vec![],
        slopes: vec![],
        windows: vec![],
    };
    if !model.target.free[0] && !per_view {
        state.shape_mm[0] = problem.shape_mm[0].unwrap_or(state.shape_mm[0]);
    }
    set_windows(problem, &mut state)?;
    Ok(state)
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
            Fact::Intrinsic { .. } | Fact::Focus(_) | Fact::WindowLayer { .. } | Fact::WindowParallel { .. } => {}
        }
    }
    // Steps of a traverse, where nothing else is metric.
    if model.target.free[0] && model.target.held_radii().next().is_none() {
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
    // A view that has no scale in common with others says nothing of where the plane is, unless there is no other.
    let marked = || (0..poses.len()).filter(|&v| problem.model.views[v].place.in_plane());
    let all_lone = marked().all(|v| lone_camera(problem, v).is_some());
    let of = marked().filter(|&v| all_lone || lone_camera(problem, v).is_none());
    let mut frames = of.filter_map(|v| match (problem.model.views[v].place, poses[v].0) {
        (ViewPlace::InPlane { known: PlanePosition::Unknown, .. }, m) => Some((m, None)),
        (ViewPlace::InPlane { z_mm, .. }, m) => Some((m, Some(z_mm))),
        (ViewPlace::Free, _) => None,
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
