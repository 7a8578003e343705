//! What is known beforehand, each a Gaussian row `(value(x) - known) / sigma`.
//!
//! | fact | value | gradient |
//! |---|---|---|
//! | an intrinsic | i_k | row k of the chart's derivative |
//! | baseline | `|t|`, t the origin of one camera seen from the other | `t / |t|` by the motion's shift |
//! | a length of the target | tau_k, shared or of one view | 1 |
//! | position along a traverse | z of a view in the common plane | 1 |
//! | offsets of printed discs | (dx, dy, dz, dr) | 1 |
//! | ovality of printed discs | (a, b) | 1 |
//! | a layer of a window | distance, thickness, index | 1 |
//! | a window parallel to the common plane | m_x, m_y of `m = R^T n`, R camera from plane | `R^T (w x n)` by its turn, the opposite by the motion, `-w x m` by the plane |
//! | focus | the sheet lies in the plane of focus | see [`super::focus`] |

use super::by_disc::ByDisc;
use super::chart::{self, ChartDerivative, SolverCamera};
use super::focus::Focus;
use super::image_map::{Slot, add_row};
use super::layout::Places;
use super::model::{Model, PlanePosition, ViewPlace};
use super::state::State;
use crate::camera::INTRINSICS;
use crate::solve::{Known, NormalEquations};
use nalgebra::{DMatrix, DVector, Vector3};

/// Something known before the images are looked at.
#[derive(Debug, Clone, PartialEq)]
pub enum Fact {
    /// An intrinsic parameter of a camera, by its index in [`crate::camera::INTRINSIC_NAMES`].
    Intrinsic {
        /// Camera.
        camera: usize,
        /// Index of the parameter.
        parameter: usize,
        /// Known value, px, rad or 1.
        value: f64,
        /// Its standard deviation.
        sigma: f64,
    },
    /// Distance of the two projection centres.
    Baseline {
        /// Known value, mm.
        value_mm: f64,
        /// Its standard deviation, mm.
        sigma_mm: f64,
    },
    /// A shape parameter of the target, see [`super::TargetShape`].
    Shape {
        /// 0, 1 or 2.
        parameter: usize,
        /// The view, where the shape belongs to views.
        view: Option<usize>,
        /// Known value, mm.
        value_mm: f64,
        /// Its standard deviation, mm.
        sigma_mm: f64,
    },
    /// A layer of a camera's window, by its index in [`crate::camera::LAYER_NAMES`].
    WindowLayer {
        /// Camera.
        camera: usize,
        /// Index of the layer.
        layer: usize,
        /// Known value, mm or 1.
        value: f64,
        /// Its standard deviation.
        sigma: f64,
    },
    /// The window of a camera stands parallel to the common plane, as far as a turn about one of its axes goes; needs a plane.
    WindowParallel {
        /// Camera.
        camera: usize,
        /// Part of the window's normal in the plane's frame that is zero: 0 (x) or 1 (y).
        axis: usize,
        /// Standard deviation, rad.
        sigma_rad: f64,
    },
    /// The common plane lies where a camera is focused; needs a plane.
    Focus(Focus),
}

/// What a prior is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PriorOf {
    /// A fact, by its index in the model; a focus relation has rows 0 and 1 (directions) and 2 (distance).
    Fact {
        /// Index in the model's facts.
        index: usize,
        /// Row of the fact.
        row: usize,
    },
    /// The position of a view along the traverse.
    Position {
        /// The view.
        view: usize,
    },
    /// The place or size of a disc: dx, dy, dz, dr.
    Disc {
        /// Disc of the target.
        disc: usize,
        /// 0 to 3.
        part: usize,
    },
    /// The ovality of a disc, a or b, of which the adjustment has found the standard deviation.
    Oval {
        /// Disc of the target.
        disc: usize,
        /// 0 or 1.
        part: usize,
    },
}

/// One whitened row: residual and its derivatives.
pub(super) struct Row {
    pub(super) view: usize,
    pub(super) residual: f64,
    pub(super) slots: Vec<(Slot, f64)>,
}

/// The rows of all facts in their order, then those of positions along a traverse and of the discs' offsets and ovality, each with what it is about.
pub(super) fn rows(model: &Model, places: &Places, state: &State) -> Option<Vec<(PriorOf, Row)>> {
    let mut out = vec![];
    let mut charts = vec![None; model.cameras.len()];
    for (index, fact) in model.facts.iter().enumerate() {
        match fact {
            Fact::Focus(focus) => {
                let own = focus.rows(model, places, state)?;
                out.extend(own.into_iter().enumerate().map(|(row, r)| (PriorOf::Fact { index, row }, r)));
            }
            other => out.push((PriorOf::Fact { index, row: 0 }, row(model, places, state, other, &mut charts)?)),
        }
    }
    for (v, z_mm, sigma_mm) in positions(model) {
        let now = state.views[v].plane_from_target?.translation_mm.z;
        let slots = vec![(Slot::Block(3), 1.0 / sigma_mm)];
        out.push((PriorOf::Position { view: v }, Row { view: v, residual: (now - z_mm) / sigma_mm, slots }));
    }
    if let (Some(sigmas), Some(first)) = (model.target.offset_sigma_mm, places.offsets) {
        for (j, offset) in state.offsets_mm.iter().enumerate() {
            for k in 0..4 {
                let slots = vec![(Slot::Global(first + 4 * j + k), 1.0 / sigmas[k])];
                let of = PriorOf::Disc { disc: j, part: k };
                out.push((of, Row { view: 0, residual: offset[k] / sigmas[k], slots }));
            }
        }
    }
    if let (Some(sigma), Some(first)) = (model.target.oval_sigma_mm, places.ovals) {
        for (k, oval) in state.ovals_mm.iter().flatten().enumerate() {
            let slots = vec![(Slot::Global(first + k), 1.0 / sigma)];
            let of = PriorOf::Oval { disc: k / 2, part: k % 2 };
            out.push((of, Row { view: 0, residual: oval / sigma, slots }));
        }
    }
    Some(out)
}

/// Derivatives of some intrinsics by the global unknowns, whitened: one row per fact, facts x n. `None` where one is about anything else.
pub(super) fn intrinsic_rows(model: &Model, places: &Places, state: &State, facts: &[Fact]) -> Option<DMatrix<f64>> {
    let mut charts = vec![None; model.cameras.len()];
    let mut out = DMatrix::zeros(facts.len(), places.layout().global);
    for (k, fact) in facts.iter().enumerate() {
        if !matches!(fact, Fact::Intrinsic { .. }) {
            return None;
        }
        for (slot, d) in row(model, places, state, fact, &mut charts)?.slots {
            let Slot::Global(at) = slot else { return None };
            out[(k, at)] += d;
        }
    }
    Some(out)
}

/// `charts`: derivatives of the cameras' charts, each found when it is first asked for.
fn row(
    model: &Model,
    places: &Places,
    state: &State,
    fact: &Fact,
    charts: &mut [Option<ChartDerivative>],
) -> Option<Row> {
    match *fact {
        Fact::Intrinsic { camera, parameter, value, sigma } => {
            let now = state.cameras[camera].to_array()[parameter];
            if charts[camera].is_none() {
                let seen = SolverCamera::of(&model.cameras[camera], &state.cameras[camera])?;
                charts[camera] = Some(chart::derivative(&model.cameras[camera], &seen.camera));
            }
            let d = charts[camera].as_ref()?;
            let slot = |k: usize| places.charts[camera][k].map(|at| (Slot::Global(at), d[(parameter, k)] / sigma));
            Some(Row { view: 0, residual: (now - value) / sigma, slots: (0..INTRINSICS).filter_map(slot).collect() })
        }
        Fact::Baseline { value_mm, sigma_mm } => {
            let t = state.camera_from_first.get(1)?.translation_mm;
            let at = (*places.motions.get(1)?)?;
            let slots = (0..3).map(|k| (Slot::Global(at + 3 + k), t[k] / t.norm() / sigma_mm)).collect();
            Some(Row { view: 0, residual: (t.norm() - value_mm) / sigma_mm, slots })
        }
        Fact::Shape { parameter, view, value_mm, sigma_mm } => {
            let (now, slot) = match view {
                Some(v) if model.target.per_view() => {
                    let at = places.view_shape[parameter].map(|at| Slot::Block(places.pose_sizes[v] + at));
                    (state.views[v].shape_mm[parameter], at)
                }
                _ => (state.shape_mm[parameter], places.shape[parameter].map(Slot::Global)),
            };
            let slots = slot.map(|s| (s, 1.0 / sigma_mm)).into_iter().collect();
            Some(Row { view: view.unwrap_or(0), residual: (now - value_mm) / sigma_mm, slots })
        }
        Fact::WindowLayer { camera, layer, value, sigma } => {
            let now = state.window(camera)?.layers()[layer];
            let at = places.windows[camera][2 + layer].map(|at| (Slot::Global(at), 1.0 / sigma));
            Some(Row { view: 0, residual: (now - value) / sigma, slots: at.into_iter().collect() })
        }
        Fact::WindowParallel { camera, axis, sigma_rad } => parallel(places, state, camera, axis, sigma_rad),
        Fact::Focus(_) => None,
    }
}

/// The window's normal in the plane's frame, one part.
fn parallel(places: &Places, state: &State, camera: usize, axis: usize, sigma_rad: f64) -> Option<Row> {
    let window = state.window(camera)?;
    let n = window.normal();
    let plane_from_camera = (state.camera_from_first[camera].rotation * state.first_from_plane?.rotation).transpose();
    let m = plane_from_camera * n;
    let mut slots = vec![];
    let mut by = |at: Option<usize>, dm: Vector3<f64>| {
        slots.extend(at.map(|at| (Slot::Global(at), dm[axis] / sigma_rad)));
    };
    for (k, t) in window.tangents().iter().enumerate() {
        by(places.windows[camera][k], plane_from_camera * t.cross(n));
    }
    for k in 0..3 {
        let step = Vector3::ith(k, 1.0);
        by(places.motions[camera].map(|at| at + k), -(plane_from_camera * step.cross(n)));
        if k < 2 {
            by(places.plane.map(|at| at + k), -step.cross(&m));
        }
    }
    Some(Row { view: 0, residual: m[axis] / sigma_rad, slots })
}

/// Views whose position along the common plane's normal is known with a sigma: view, position and sigma in mm.
fn positions(model: &Model) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
    model.views.iter().enumerate().filter_map(|(v, view)| match view.place {
        ViewPlace::InPlane { z_mm, known: PlanePosition::About { sigma_mm } } => Some((v, z_mm, sigma_mm)),
        _ => None,
    })
}

/// Cost of all facts.
pub(super) fn cost(model: &Model, places: &Places, state: &State) -> Option<f64> {
    rows(model, places, state).map(|r| r.iter().map(|(_, r)| 0.5 * r.residual * r.residual).sum())
}

/// Adds all facts to the normal equations.
///
/// `scales` are steps up to which the problem is about linear.
pub(super) fn linearise(
    model: &Model,
    (places, scales): (&Places, &DVector<f64>),
    state: &State,
    e: &mut NormalEquations,
) -> Option<()> {
    let rows = rows(model, places, state)?;
    rows.iter().for_each(|(_, row)| add(e, row));
    e.known = known(&rows, places, scales);
    Some(())
}

/// Steps beyond which a number that nothing but facts tells counts as unknown: 15 percent of a focal length.
const REACH: f64 = 7.5;

/// Those of the unknowns that all views share, and of nothing else.
fn known(rows: &[(PriorOf, Row)], places: &Places, scales: &DVector<f64>) -> Known {
    let shared = |(slot, d): &(Slot, f64)| match slot {
        Slot::Global(at) if *at < places.shared() => Some((*at, *d)),
        _ => None,
    };
    let reach = scales.iter().take(places.shared()).map(|s| REACH * s).collect();
    Known { rows: rows.iter().filter_map(|(_, row)| row.slots.iter().map(shared).collect()).collect(), reach }
}

/// Adds one row to equations with one block per view.
pub(super) fn add(e: &mut NormalEquations, row: &Row) {
    add_row(e, row.view, &row.slots, row.residual);
    e.cost += 0.5 * row.residual * row.residual;
}

/// The same with one block per disc.
pub(super) fn linearise_by_disc(
    model: &Model,
    (places, by, scales): (&Places, &ByDisc, &DVector<f64>),
    state: &State,
    e: &mut NormalEquations,
) -> Option<()> {
    let rows = rows(model, places, state)?;
    rows.iter().for_each(|(_, row)| by.add_row(e, row));
    e.known = known(&rows, places, scales);
    Some(())
}

/// Number of rows that facts add to the observations.
pub(super) fn count(model: &Model) -> usize {
    let of_fact = |f: &Fact| if let Fact::Focus(focus) = f { focus.count() } else { 1 };
    model.facts.iter().map(of_fact).sum::<usize>()
        + positions(model).count()
        + model.target.offset_sigma_mm.map_or(0, |_| 4 * model.target.disc_count())
        + model.target.oval_sigma_mm.map_or(0, |_| 2 * model.target.disc_count())
}
