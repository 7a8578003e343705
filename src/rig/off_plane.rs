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
use super::{Mono, RigProblem, rms_of};
use crate::bundle::{AdjustOptions, PlanePosition, SolveOptions, Termination, ViewPlace};
use crate::error::{Insufficient, Result, Unusable};
use crate::frames::{Rig, Target};
use crate::rigid::Motion;

/// The views are not where they are said to be if the residuals fall to this part of theirs without it.
const RELIEF: f64 = 0.5;

/// Views that are said to lie in one plane, or parallel to it, and do not: told in words where the images fit half as badly with it, `None`
/// where they do not say so.
///
/// All views but one leave the plane for a second adjustment, only where the first hardly explains what each camera alone explains.
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
    let marked: Vec<usize> =
        (0..problem.model.views.len()).filter(|&v| problem.model.views[v].place.in_plane()).collect();
    if marked.len() < 2 || rms_px < DOUBT * alone_px {
        return Ok(None);
    }
    let mut freed = problem.clone();
    marked[1..].iter().for_each(|&v| freed.model.views[v].place = ViewPlace::Free);
    let quick =
        AdjustOptions { solve: SolveOptions { decrement: 1e-2, iterations: 100 }, rounds: 0, ..*context.options };
    let Ok(freed) = together(&freed, monos, &Context { options: &quick, told: context.told }) else { return Ok(None) };
    let freed_px = rms_of(&freed.adjustment.model, &freed.adjustment.state).unwrap_or(f64::INFINITY);
    let limit_px = contradicts_px(monos);
    if freed_px > limit_px || freed_px > RELIEF * rms_px {
        return Ok(None);
    }
    let places: Vec<ViewPlace> = marked.iter().map(|&v| problem.model.views[v].place).collect();
    let poses: Vec<_> = marked.iter().map(|&v| freed.adjustment.state.views[v].first_from_target).collect();
    let words = off_plane_words(&marked, &places, &poses, [rms_px, freed_px]);
    if rms_px > limit_px { Err(Insufficient::Inconsistent(words).into()) } else { Ok(Some(words)) }
}

/// How far each marked view is from the plane of the one that agrees best with the others.
fn off_plane_words(
    marked: &[usize],
    places: &[ViewPlace],
    poses: &[Motion<Rig, Target>],
    [rms_px, freed_px]: [f64; 2],
) -> String {
    let axis = |i: usize| poses[i].rotation.column(2).into_owned();
    let tilt = |i: usize, j: usize| axis(i).cross(&axis(j)).norm().atan2(axis(i).dot(&axis(j))).to_degrees();
    let away = |i: usize, j: usize| match (places[i], places[j]) {
        (
            ViewPlace::InPlane { z_mm: a, known: PlanePosition::Exact },
            ViewPlace::InPlane { z_mm: b, known: PlanePosition::Exact },
        ) => axis(j).dot(&(poses[i].translation_mm - poses[j].translation_mm)) - (a - b),
        _ => 0.0,
    };
    let all = 0..marked.len();
    let middling = |j: usize| {
        let mut t: Vec<f64> = all.clone().map(|i| tilt(i, j)).collect();
        t.sort_by(f64::total_cmp);
        t[marked.len() / 2]
    };
    let base = all.clone().min_by(|&i, &j| middling(i).total_cmp(&middling(j))).unwrap_or(0);
    let worst = |f: &dyn Fn(usize) -> f64| all.clone().map(f).fold(0.0, f64::max);
    let (most_deg, most_mm) = (worst(&|i| tilt(i, base)), worst(&|i| away(i, base).abs()));
    let out =
        all.clone().filter(|&i| i != base && (tilt(i, base) > 0.5 * most_deg || away(i, base).abs() > 0.5 * most_mm));
    let named = out.map(|i| {
        let tilted = format!("view {} is tilted by {:.2} degrees", marked[i], tilt(i, base));
        if away(i, base) == 0.0 { tilted } else { format!("{tilted} and lies {:.2} mm away", away(i, base).abs()) }
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
        marked[base],
        named.join(", ")
    )
}
