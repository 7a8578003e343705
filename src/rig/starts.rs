//! Where the common adjustment starts.
//!
//! The effective pinhole, which carries all poses, is well known from the cameras alone; axis point and distortion are not:
//! ```text
//! alone      as each camera alone has them
//! centred    axis point at its known place or the sensor's centre, no distortion; the tilt follows
//! opposite   the same with the distortion of the other sign
//! untilted   axis point where the sensor is square to the axis
//! ```
//! The images show the distortion times its distance from the axis point: while both move, a long step from a poor start can
//! carry the distortion through zero, where the axis point is determined by nothing, and beyond lies a minimum of its own
//! with the other sign. So the first start is tried as it is, and all but the last with the axis points held until the rest
//! has settled.
//!
//! Their adjustments may end in different minima. All are run on a part of the edge points, unless the first explains them
//! to their noise; where two come out nearly equal and apart, all edge points decide. The order and the arithmetic are fixed, so
//! the choice is the same in every run.
//!
//! About an axis point that is far off, distortion settles near zero, where nothing calls it back. What tells such a minimum is that whole discs scatter by
//! more than noise: then the camera that they do in starts from nine axis points about where its own is assumed, 1.5 standard deviations apart, and all edge
//! points are asked whether a lower minimum lies there ([`elsewhere`]).

use super::mono::lightened;
use super::{RigProblem, Told, side_by_side};
use crate::bundle::{AdjustOptions, Adjustment, Fact, Model, SolveOptions, State, Termination, adjust};
use crate::camera::{Camera, Intrinsics};

/// A start whose chi-square exceeds its degrees of freedom by more than this many standard deviations has rivals.
const EXPLAINED_SIGMAS: f64 = 3.0;
/// Costs nearer than this part are compared with all edge points.
const NEARLY: f64 = 0.02;
/// Minima are the same if their costs differ by less than this part.
const SAME: f64 = 1e-4;

/// Intrinsics with which the common adjustment starts.
///
/// Where every disc is estimated, a camera alone had to explain printing errors by its lens: axis point and distortion have run
/// away with them. The rest starts again at the sensor's centre.
pub(super) fn joint_start(problem: &RigProblem, c: usize, alone: &Intrinsics) -> Intrinsics {
    if problem.model.target.offset_sigma_mm.is_none() {
        return *alone;
    }
    centred(problem, c, alone, 0.0)
}

/// The same pinhole with the axis point at the sensor's centre (or its known place) and the distortion times `k1`.
fn centred(problem: &RigProblem, c: usize, now: &Intrinsics, k1: f64) -> Intrinsics {
    let (model, start) = (&problem.model.cameras[c], &problem.starts[c]);
    let Ok(camera) = Camera::new(*now) else { return *now };
    let own = now.to_array();
    let mut p = own;
    if model.uses_pinhole_frame() {
        let center = |k: usize, size: f64| {
            if model.free[k] { start.values[k].unwrap_or((size - 1.0) / 2.0) } else { own[k] }
        };
        let (cx, cy) = (center(2, start.size_px[0]), center(3, start.size_px[1]));
        p = camera.effective_pinhole().with_axis_point(cx, cy, now.aspect).to_array();
    }
    for k in 6..9 {
        p[k] = if model.free[k] { start.values[k].unwrap_or(0.0) } else { own[k] };
    }
    if model.free[6] {
        p[6] += k1 * own[6];
    }
    p[9] = own[9];
    Intrinsics::from_array(&p, now.radial)
}

/// The same pinhole with the sensor square to the axis.
fn untilted(problem: &RigProblem, c: usize, now: &Intrinsics) -> Intrinsics {
    let model = &problem.model.cameras[c];
    let Ok(camera) = Camera::new(*now) else { return *now };
    if !(model.uses_pinhole_frame() && model.free[2] && model.free[3]) {
        return *now;
    }
    let e = camera.effective_pinhole();
    let mut p = e.with_axis_point(e.cx_px, e.cy_px, now.aspect).to_array();
    p[6..].copy_from_slice(&centred(problem, c, now, 0.0).to_array()[6..]);
    Intrinsics::from_array(&p, now.radial)
}

/// Most linearisations with the axis points held.
const HELD_ITERATIONS: usize = 30;

/// The state after an adjustment with the axis points held, where a tilt can follow them.
fn held(light: &Model, start: State, told: Told<'_>) -> State {
    let mut model = light.clone();
    let mut any = false;
    for camera in model.cameras.iter_mut().filter(|c| c.uses_pinhole_frame() && c.free[6..9].contains(&true)) {
        any |= camera.free[2] || camera.free[3];
        (camera.free[2], camera.free[3]) = (false, false);
    }
    if !any {
        return start;
    }
    let brief = AdjustOptions {
        solve: SolveOptions { decrement: 1.0, iterations: HELD_ITERATIONS },
        rounds: 0,
        ..AdjustOptions::default()
    };
    adjust(&model, start, &brief, &mut |i| told(i)).state
}

/// The given start and the others, each once.
fn starts(problem: &RigProblem, given: State) -> Vec<State> {
    let with = |change: &dyn Fn(usize, &Intrinsics) -> Intrinsics| {
        let cameras = given.cameras.iter().enumerate().map(|(c, i)| change(c, i)).collect();
        State { cameras, ..given.clone() }
    };
    let others = [
        with(&|c, i| centred(problem, c, i, 0.0)),
        with(&|c, i| centred(problem, c, i, -1.0)),
        with(&|c, i| untilted(problem, c, i)),
    ];
    let mut out = vec![given];
    for s in others {
        if !out.iter().any(|o: &State| o.cameras == s.cameras) {
            out.push(s);
        }
    }
    out
}

/// How far axis points are displaced, in standard deviations of what is known of them, in parts of the sensor at most.
const DISPLACED_SIGMAS: f64 = 1.5;
const DISPLACED_PART: f64 = 0.15;
/// Scatter of whole discs over what noise explains from which on it is asked for.
const SCATTERED: f64 = 1.2;
/// Observations beyond which it is not: they tell axis points well.
const MOST_OBSERVATIONS: usize = 30_000;
/// A cost that is lower by less, half a likelihood ratio of 100, is no other minimum.
const LOWER: f64 = 4.6;

/// States with the axis point of a camera elsewhere about where it is assumed, its pinhole kept.
fn displaced(problem: &RigProblem, from: &State, c: usize) -> Vec<State> {
    let (model, now) = (&problem.model.cameras[c], from.cameras[c]);
    let distorted = model.free[6..9].contains(&true);
    let Some(camera) = Camera::new(now).ok().filter(|_| model.uses_pinhole_frame() && distorted) else { return vec![] };
    let known = |k: usize| {
        problem.model.facts.iter().find_map(|fact| match fact {
            Fact::Intrinsic { camera, parameter, value, sigma } if (*camera, *parameter) == (c, k) => {
                Some((*value, *sigma))
            }
            _ => None,
        })
    };
    let [columns, rows] = [2, 3].map(|k| {
        let size = problem.starts[c].size_px[k - 2];
        let (middle, sigma) = known(k).unwrap_or(((size - 1.0) / 2.0, f64::INFINITY));
        let by = (DISPLACED_SIGMAS * sigma).min(DISPLACED_PART * size);
        if model.free[k] { vec![middle - by, middle, middle + by] } else { vec![[now.cx_px, now.cy_px][k - 2]] }
    });
    let at = |(x, y): (f64, f64)| {
        let mut p = camera.effective_pinhole().with_axis_point(x, y, now.aspect).to_array();
        p[6..].copy_from_slice(&now.to_array()[6..]);
        let mut state = from.clone();
        state.cameras[c] = Intrinsics::from_array(&p, now.radial);
        state
    };
    columns.iter().flat_map(|x| rows.iter().map(move |y| (*x, *y))).map(at).collect()
}

/// A state from where a lower minimum is reached than the one that was found, if there is one; of adjustments with the given sigmas.
pub(super) fn elsewhere(
    problem: &RigProblem,
    found: &Adjustment,
    options: &AdjustOptions,
    told: Told<'_>,
) -> Option<State> {
    let model = &problem.model;
    let scatters = |c: &usize| found.model.images.iter().any(|i| i.camera == *c && i.sigma_scale > SCATTERED);
    let cameras: Vec<usize> = (0..model.cameras.len()).filter(scatters).collect();
    if cameras.is_empty() || model.counts().observations > MOST_OBSERVATIONS {
        return None;
    }
    let quick = AdjustOptions { solve: SolveOptions { decrement: 0.3, iterations: 60 }, rounds: 0, ..*options };
    let try_from = |start: State| adjust(model, start, &quick, &mut |i| told(i));
    let (mut best, mut out) = (try_from(found.state.clone()), None);
    for c in cameras {
        let all = displaced(problem, &best.state, c);
        let tried = side_by_side(&all, |start| try_from(held(model, start.clone(), told)));
        if tried.iter().any(|t| t.termination == Termination::Cancelled) {
            return None;
        }
        let lower = tried.into_iter().filter(|t| t.cost < best.cost - LOWER);
        let Some(least) = lower.min_by(|a, b| a.cost.total_cmp(&b.cost)) else { continue };
        out = Some(least.state.clone());
        best = least;
    }
    out
}

/// Whether nothing but noise is left.
fn is_explained(model: &Model, trial: &Adjustment) -> bool {
    let n = model.counts();
    let dof = (n.observations + n.facts).saturating_sub(n.unknowns) as f64;
    2.0 * trial.cost < dof + EXPLAINED_SIGMAS * (2.0 * dof).sqrt()
}

/// The start that leads to the lowest cost, already near its minimum.
pub(super) fn best_start(problem: &RigProblem, given: State, options: &AdjustOptions, told: Told<'_>) -> State {
    let light = lightened(&problem.model);
    let quick = |decrement: f64, iterations: usize| AdjustOptions {
        solve: SolveOptions { decrement, iterations },
        rounds: 0,
        ..*options
    };
    let try_from = |start: State| adjust(&light, start, &quick(0.3, 40), &mut |i| told(i));
    // Whoever stops it stops the adjustment that follows as well.
    let cancelled = |t: &Adjustment| t.termination == Termination::Cancelled;
    // The given one twice: as it is, then with the axis points held.
    let first = try_from(given.clone());
    if cancelled(&first) {
        return given;
    }
    let explained = first.cost.is_finite() && is_explained(&light, &first);
    let mut tried = vec![first];
    if !explained {
        let all = starts(problem, given.clone());
        let order: Vec<usize> = (0..all.len()).collect();
        tried.extend(side_by_side(&order, |&k| {
            let last = k > 0 && k + 1 == all.len();
            try_from(if last { all[k].clone() } else { held(&light, all[k].clone(), told) })
        }));
    }
    if tried.iter().any(cancelled) {
        return given;
    }
    tried.retain(|t| t.cost.is_finite());
    // A stable sort: of equal costs the earlier start.
    tried.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let Some(least) = tried.first().map(|t| t.cost) else { return given };
    tried.retain(|t| t.cost <= least * (1.0 + NEARLY));
    let mut apart: Vec<Adjustment> = vec![];
    for t in tried {
        if apart.last().is_none_or(|a| t.cost > a.cost * (1.0 + SAME)) {
            apart.push(t);
        }
    }
    if apart.len() == 1 {
        return apart.swap_remove(0).state;
    }
    apart.truncate(2);
    let all = side_by_side(&apart, |t| adjust(&problem.model, t.state.clone(), &quick(0.1, 40), &mut |i| told(i)));
    all.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost)).map_or(given, |t| t.state)
}
