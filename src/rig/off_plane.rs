//! Whether the views that are said to lie in the sheet, or parallel to it, do.
//!
//! With all marked views but one set free, each has a pose of its own in the rig frame. Of views i and j
//! ```text
//! tilt = atan2(|n_i x n_j|, n_i . n_j)        away = n_j . (t_i - t_j) - (z_i - z_j)
//! ```
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | n | `axis` | 1 | Rig | normal of the target, third column of its rotation |
//! | t | `translation_mm` | mm | Rig | origin of the target |
//! | z | `z_mm` | mm | Sheet | position that the rig file states, 0 in the sheet |

use super::contradiction::{DOUBT, contradicts_px, worst_px};
use super::joint::{Context, Together, together};
use super::lone::lone_camera;
use super::moved::explaining_step;
use super::{Mono, RigProblem, rms_of};
use crate::bundle::{AdjustOptions, PlanePosition, SolveOptions, State, Termination, ViewPlace};
use crate::error::{Insufficient, Result, Unusable};

/// The views are not where they are said to be if the residuals fall to this part of theirs without it.
const RELIEF: f64 = 0.5;
/// What fits better by this part, fits better.
const CLEARLY: f64 = 0.8;
/// Views are named that are seen as far off as this part of the furthest.
const SEEN: f64 = 0.1;

/// Views that are said to lie in one plane, or parallel to it, and do not: told in words where the images fit half as badly with it, `None`
/// where they do not say so. Where a camera that was moved between two views explains it better, that is told instead.
///
/// All views but one leave the plane for a second adjustment, only where the first hardly explains what each camera alone explains. Nothing is
/// said unless that reaches its minimum and moves a view by more than its contours scatter.
///
/// # Errors
/// [`Insufficient::Inconsistent`] with the same words where nothing can be made of the images as they are marked;
/// [`Unusable::Cancelled`].
pub(super) fn views_off_plane(
    problem: &RigProblem,
    monos: &[Mono],
    solved: Option<&Together>,
    context: &Context<'_>,
) -> Result<Option<String>> {
    let alone_px = worst_px(monos);
    let rms_px = match solved {
        Some(s) if s.adjustment.termination == Termination::Cancelled => return Err(Unusable::Cancelled.into()),
        Some(s) => rms_of(&s.adjustment.model, &s.adjustment.state).unwrap_or(f64::INFINITY),
        None => f64::INFINITY,
    };
    // A view that one camera alone sees may be as far away as it likes once it is free.
    let marked = (0..problem.model.views.len()).filter(|&v| problem.model.views[v].place.in_plane());
    let marked: Vec<usize> = marked.filter(|&v| lone_camera(problem, v).is_none()).collect();
    if marked.len() < 2 || rms_px < DOUBT * alone_px {
        return Ok(None);
    }
    let mut freed = problem.clone();
    marked[1..].iter().for_each(|&v| freed.model.views[v].place = ViewPlace::Free);
    let quick =
        AdjustOptions { solve: SolveOptions { decrement: 1e-2, iterations: 100 }, rounds: 0, ..*context.options };
    let Ok(freed) = together(&freed, monos, &Context { options: &quick, told: context.told }) else { return Ok(None) };
    let freed_px = rms_of(&freed.adjustment.model, &freed.adjustment.state).unwrap_or(f64::INFINITY);
    if freed.adjustment.termination != Termination::Converged || freed_px > RELIEF * rms_px {
        return Ok(None);
    }
    // Without the plane nothing but noise may be left where with it nothing was found at all.
    let limit_px = contradicts_px(monos);
    if freed_px > if rms_px.is_finite() { limit_px } else { DOUBT * alone_px } {
        return Ok(None);
    }
    let off = OffPlane::of(problem, &marked, &freed.adjustment.state);
    if !off.out.iter().any(|o| o.seen_px > DOUBT * alone_px) {
        return Ok(None);
    }
    let mut words = off.words([rms_px, freed_px]);
    match solved.and_then(|s| explaining_step(s, monos, context)) {
        Some(step) if step.rms_px < CLEARLY * freed_px => words = step.words(),
        Some(step) if step.rms_px < freed_px / CLEARLY => {
            words += &format!("; or else, as the images fit as well so: {}", step.words());
        }
        _ => {}
    }
    if rms_px > limit_px { Err(Insufficient::Inconsistent(words).into()) } else { Ok(Some(words)) }
}

/// A view against the plane of another.
#[derive(Clone, Copy)]
struct Off {
    view: usize,
    tilt_rad: f64,
    /// 0 where its distance is not known anyway.
    away_mm: f64,
    /// Largest movement of its contours that can come of it, px.
    seen_px: f64,
}

/// How far views are from the plane of the one that agrees best with the others.
struct OffPlane {
    base: usize,
    /// Those furthest off.
    out: Vec<Off>,
}

impl OffPlane {
    fn of(problem: &RigProblem, marked: &[usize], freed: &State) -> Self {
        let pose = |v: usize| &freed.views[v].first_from_target;
        let axis = |v: usize| pose(v).rotation.column(2).into_owned();
        let tilt = |i: usize, j: usize| axis(i).cross(&axis(j)).norm().atan2(axis(i).dot(&axis(j)));
        let away = |i: usize, j: usize| match [i, j].map(|v| problem.model.views[v].place) {
            [
                ViewPlace::InPlane { z_mm: a, known: PlanePosition::Exact },
                ViewPlace::InPlane { z_mm: b, known: PlanePosition::Exact },
            ] => axis(j).dot(&(pose(i).translation_mm - pose(j).translation_mm)) - (a - b),
            _ => 0.0,
        };
        let middling = |j: usize| {
            let mut t: Vec<f64> = marked.iter().map(|&i| tilt(i, j)).collect();
            t.sort_by(f64::total_cmp);
            t[marked.len() / 2]
        };
        let base = marked.iter().copied().min_by(|&i, &j| middling(i).total_cmp(&middling(j))).unwrap_or(0);
        let f_px = freed.cameras.iter().map(|c| c.f_px).fold(0.0, f64::max);
        let all = marked.iter().map(|&view| {
            let (tilt_rad, away_mm) = (tilt(view, base), away(view, base).abs());
            let px_per_mm = f_px / pose(view).translation_mm.norm();
            let seen_px = (tilt_rad * extent_mm(problem, freed, view) + away_mm) * px_per_mm;
            Off { view, tilt_rad, away_mm, seen_px }
        });
        let all: Vec<Off> = all.collect();
        let most = |f: fn(&Off) -> f64| all.iter().map(f).fold(0.0, f64::max);
        let (most_rad, most_mm, most_px) = (most(|o| o.tilt_rad), most(|o| o.away_mm), most(|o| o.seen_px));
        // The larger of two tilts is worth naming only where it is seen.
        let far = |o: &Off| o.tilt_rad > 0.5 * most_rad || o.away_mm > 0.5 * most_mm;
        let out = all.iter().filter(|o| o.view != base && far(o) && o.seen_px > SEEN * most_px).copied().collect();
        Self { base, out }
    }

    fn words(&self, [rms_px, freed_px]: [f64; 2]) -> String {
        let named = self.out.iter().map(|o| {
            let tilted = format!("view {} is tilted by {:.2} degrees", o.view, o.tilt_rad.to_degrees());
            if o.away_mm == 0.0 { tilted } else { format!("{tilted} and lies {:.2} mm away", o.away_mm) }
        });
        let named: Vec<String> = named.collect();
        let fit = if rms_px.is_finite() {
            format!("{rms_px:.2} px rms with it, {freed_px:.2} without")
        } else {
            format!("{freed_px:.2} px rms without it")
        };
        format!(
            "the views marked sheet = true or plane_z_mm are not in one plane, nor parallel ({fit}): against view {}, {} (views counted from 0); mark only views of a \
             target that lay in the laser sheet (one of them, where it was put there by hand), and views of a traverse whose steps are right",
            self.base,
            named.join(", ")
        )
    }
}

/// Largest distance of a point of the discs that a view shows from the target's origin, mm.
fn extent_mm(problem: &RigProblem, state: &State, view: usize) -> f64 {
    let target = &problem.model.target;
    let shape = if target.per_view() { &state.views[view].shape_mm } else { &state.shape_mm };
    let discs = problem.model.images.iter().filter(|i| i.view == view).flat_map(|i| &i.discs);
    let reach = discs.map(|d| target.nominal_disc(d.disc, shape)).map(|(center, radius)| center.norm() + radius);
    reach.fold(0.0, f64::max)
}
