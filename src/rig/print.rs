//! Labels between views, by the printing errors of the dots.
//!
//! Where every dot is estimated, all views must name it alike. A perfect lattice looks the same after a turn or a shift; what
//! differs is where its dots really are. After an adjustment with a perfect lattice each dot of a view is off by `d_v(id)` on the
//! target. If `id' = g(id)` joins the labels of view v to those of the views before it, with m their mean, one set of offsets
//! serves both, and chi-square falls, against offsets of their own, by `2 sum d . m / s^2`: the g with the largest
//! correlation is the cheapest. Where no correlation is significant, the printing errors are below the noise and no
//! labelling costs more than another.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | d_v(id) | `off` | mm | place of a dot on the target minus the lattice, seen in view v |
//! | m | `known` | mm | its mean over the views joined so far |
//! | g | `change` | - | change of labels common to both cameras |
//!
//! Turns and shifts of all views together are a gauge: of the views that leave fewest turns open the one with most dots keeps its labels.

use super::RigProblem;
use super::labels::{
    Extent, Size, any_origin, extent, image_at, labellings, labels, relabel, sizes_of, slide, turned_target,
};
use super::mono::lightened;
use crate::bundle::{AdjustOptions, Model, SolveOptions, State, adjust, residuals};
use crate::camera::Camera;
use crate::detect::pattern::Relabelling;
use crate::frames::Cam;
use crate::rigid::Motion;
use crate::target::DotId;
use nalgebra::{Matrix2, Vector2, Vector3};
use std::collections::BTreeMap;

/// Correlation, in standard deviations of chance, from which printing errors are believed.
const SIGNIFICANT: f64 = 5.0;
/// Part of a view's dots that must be known before to be compared.
const OVERLAP: f64 = 0.4;
/// Shifts that are tried each way.
const MOST_SHIFT: i32 = 12;

type Offsets = BTreeMap<DotId, Vector2<f64>>;

/// Joins the labels of the views where every dot is estimated; changes problem and state.
pub(super) fn labels_by_print(problem: &mut RigProblem, state: &mut State) {
    let views = problem.model.views.len();
    let open = |v: usize| (0..2).filter_map(|c| image_at(problem, c, v)).any(|k| is_open(problem, k));
    if problem.model.target.offset_sigma_mm.is_none() || !(0..views).any(open) {
        return;
    }
    let mut model = lightened(&problem.model);
    model.target.offset_sigma_mm = None;
    let quick =
        AdjustOptions { solve: SolveOptions { decrement: 1.0, iterations: 40 }, rounds: 0, outlier_sigmas: 6.0 };
    let flat = adjust(&model, State { offsets_mm: vec![], ..state.clone() }, &quick, &mut |_| true).state;
    let ids = labels(problem);
    let mut off: Vec<Offsets> = (0..views).map(|v| offsets(&model, &flat, &ids, v).unwrap_or_default()).collect();
    let mut order: Vec<usize> = (0..views).collect();
    order.sort_by_cached_key(|v| (open(*v), turns(problem, *v), std::cmp::Reverse(off[*v].len()), *v));
    let mut known: BTreeMap<DotId, (Vector2<f64>, f64)> = BTreeMap::new();
    let mut changes = vec![Relabelling::NONE; views];
    for v in order {
        let fits = fitting(problem, v, &off[v], &known);
        let best = common_changes(problem, v)
            .into_iter()
            .filter(|g| fits(g))
            .filter_map(|g| Some((g, correlation(&off[v], &known, &g)?)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((g, _)) = best.filter(|b| b.1 > SIGNIFICANT) {
            changes[v] = g;
            off[v] = off[v].iter().map(|(id, d)| (g.apply(*id), turned(&g, d))).collect();
        }
        for (id, d) in &off[v] {
            let k = known.entry(*id).or_insert((Vector2::zeros(), 0.0));
            *k = (k.0 + d, k.1 + 1.0);
        }
    }
    apply(problem, state, &changes);
}

/// Whether a view's labels, changed, fit into the target together with those of the views before it, as long as these do themselves.
fn fitting(
    problem: &RigProblem,
    v: usize,
    off: &Offsets,
    known: &BTreeMap<DotId, (Vector2<f64>, f64)>,
) -> impl Fn(&Relabelling) -> bool + use<> {
    let images: Vec<usize> = (0..2).filter_map(|c| image_at(problem, c, v)).collect();
    let known = Extent::of(known.keys().copied());
    let sizes: Vec<Size> = sizes_of(problem, &images).into_iter().filter(|size| known.fits(*size)).collect();
    let own: Vec<DotId> = off.keys().copied().collect();
    move |change| {
        let both = Extent::of(own.iter().map(|id| change.apply(*id))).with(known);
        sizes.is_empty() || sizes.iter().any(|size| both.fits(*size))
    }
}

fn is_open(problem: &RigProblem, k: usize) -> bool {
    any_origin(problem, k) || labellings(problem, k).len() > 1
}

fn apply(problem: &mut RigProblem, state: &mut State, changes: &[Relabelling]) {
    let step_mm = problem.open.step_pitches * state.shape_mm[0];
    for (view, change) in state.views.iter_mut().zip(changes) {
        let back = turned_target(change, step_mm).inverse();
        view.first_from_target = view.first_from_target * back;
        view.plane_from_target = view.plane_from_target.map(|m| m * back);
    }
    let of_images: Vec<Relabelling> = problem.model.images.iter().map(|i| changes[i.view]).collect();
    relabel(problem, &of_images);
    state.offsets_mm = vec![[0.0; 4]; problem.model.target.disc_count()];
}

fn turned(g: &Relabelling, d: &Vector2<f64>) -> Vector2<f64> {
    turned_target(&Relabelling { quarter_turns: g.quarter_turns, ..Relabelling::NONE }, 0.0).apply(&d.push(0.0)).xy()
}

/// Changes of labels that all images of a view allow together; the given labels first.
fn common_changes(problem: &RigProblem, v: usize) -> Vec<Relabelling> {
    let images: Vec<usize> = (0..2).filter_map(|c| image_at(problem, c, v)).collect();
    let Some(&first) = images.first() else { return vec![] };
    let turn_alone = |g: &Relabelling| Relabelling { columns: 0, rows: 0, ..*g };
    let allowed = |k: usize, g: &Relabelling| {
        let own = labellings(problem, k);
        if any_origin(problem, k) { own.iter().any(|a| turn_alone(a) == turn_alone(g)) } else { own.contains(g) }
    };
    let exact = images.iter().copied().find(|k| !any_origin(problem, *k));
    let candidates: Vec<Relabelling> = match exact {
        Some(k) => labellings(problem, k),
        None => {
            let n = slide(problem);
            let shifts =
                (-MOST_SHIFT..=MOST_SHIFT).flat_map(|i| (-MOST_SHIFT..=MOST_SHIFT).map(move |j| (n * i, n * j)));
            let shifts: Vec<(i32, i32)> = shifts.collect();
            let shifted = |a: Relabelling| {
                // Turned about the middle of the view's own labels, then shifted.
                let about = middle_turn(problem, first, &a);
                shifts
                    .iter()
                    .map(move |(i, j)| Relabelling { columns: about.0 + i, rows: about.1 + j, ..a })
                    .collect::<Vec<_>>()
            };
            labellings(problem, first).into_iter().flat_map(shifted).collect()
        }
    };
    candidates.into_iter().filter(|g| images.iter().all(|k| allowed(*k, g))).collect()
}

/// How many turns a view leaves open.
fn turns(problem: &RigProblem, v: usize) -> usize {
    let all = common_changes(problem, v);
    (0..4).filter(|q| all.iter().any(|g| g.quarter_turns == *q)).count()
}

/// Shift after which a turn leaves the middle of an image's labels where it was.
fn middle_turn(problem: &RigProblem, k: usize, turn: &Relabelling) -> (i32, i32) {
    let n = slide(problem);
    let [column, row] = extent(problem, &labels(problem), k, &Relabelling::NONE).middle().map(|x| x / n * n);
    let middle = DotId { column, row, level: 0 };
    let moved = Relabelling { columns: 0, rows: 0, ..*turn }.apply(middle);
    (middle.column - moved.column, middle.row - moved.row)
}

/// Correlation of a view's offsets, after a change of labels, with those known, in standard deviations of chance.
fn correlation(off: &Offsets, known: &BTreeMap<DotId, (Vector2<f64>, f64)>, change: &Relabelling) -> Option<f64> {
    let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = off
        .iter()
        .filter_map(|(id, d)| known.get(&change.apply(*id)).map(|(sum, n)| (turned(change, d), sum / *n)))
        .collect();
    if (pairs.len() as f64) < (OVERLAP * off.len() as f64).max(8.0) {
        return None;
    }
    let (a, b) = (without_trend(pairs.iter().map(|p| p.0)), without_trend(pairs.iter().map(|p| p.1)));
    let dot: f64 = a.iter().zip(&b).map(|(a, b)| a.dot(b)).sum();
    let size = |v: &[Vector2<f64>]| v.iter().map(Vector2::norm_squared).sum::<f64>();
    let chance = (size(&a) * size(&b) / (2.0 * a.len() as f64)).sqrt();
    (chance > 0.0).then(|| dot / chance)
}

/// Without their mean, which a pose takes up.
fn without_trend(all: impl Iterator<Item = Vector2<f64>>) -> Vec<Vector2<f64>> {
    let all: Vec<Vector2<f64>> = all.collect();
    let mean = all.iter().sum::<Vector2<f64>>() / all.len().max(1) as f64;
    all.into_iter().map(|v| v - mean).collect()
}

/// Where the dots of a view lie on the target besides their nominal places, mean of the cameras, mm.
fn offsets(model: &Model, state: &State, ids: &[DotId], v: usize) -> Option<Offsets> {
    let mut out: BTreeMap<DotId, (Vector2<f64>, f64)> = BTreeMap::new();
    for image in model.images.iter().filter(|i| i.view == v) {
        let c = image.camera;
        let bare = Camera::new(state.cameras[c]).ok()?;
        let turn: Motion<Cam, Cam> = if model.cameras[c].uses_pinhole_frame() {
            Motion::new(bare.cam_from_pinhole(), Vector3::zeros())
        } else {
            Motion::identity()
        };
        let camera = bare.with_window(state.window(c).map(|w| w.in_frame(&turn.rotation)));
        let cam_from_target = turn * state.camera_from_first[c] * state.views[v].first_from_target;
        let h = 1e-4 * state.shape_mm[0];
        for r in residuals(model, state, image)?.discs {
            let p = model.target.nominal_disc(r.disc, &state.shape_mm).0;
            let at = |d: Vector3<f64>| camera.project_xyz(&cam_from_target.apply(&(p + d))).ok();
            let column = |d: Vector3<f64>| Some((at(d * h)? - at(-d * h)?) / (2.0 * h));
            let map = Matrix2::from_columns(&[column(Vector3::x())?, column(Vector3::y())?]);
            let entry = out.entry(ids[r.disc]).or_insert((Vector2::zeros(), 0.0));
            *entry = (entry.0 + map.try_inverse()? * r.shift_px, entry.1 + 1.0);
        }
    }
    Some(out.into_iter().map(|(id, (sum, n))| (id, sum / n)).collect())
}
