//! Covariance in the user's own parameters, with names.
//!
//! The solver's unknowns are charts and steps in solver frames. The natural parameters follow linearly at the estimate:
//! ```text
//! intrinsics       di = A dchart
//! window           w_c + E_c dturn, dlayers
//! cam_from_rig     (w_c, 0) + diag(E_c, E_c) dmotion - Ad(cam_from_rig) (w_0, 0)      w_c = B_c dchart_c
//! rig_from_target  (w_0, 0) + diag(E_0, E_0) dpose
//! ```
//! Steps of natural motions are left steps (see [`crate::rigid`]) about the axes of the target frame of the motion.

use super::Fact;
use super::adjust::Adjustment;
use super::chart::{self, ChartDerivative, SolverCamera};
use super::dots_plane::DotsPlane;
use super::layout::Places;
use super::model::{Model, TargetShape};
use super::state::State;
use super::steps::SHEET;
use super::typical::typical;
use super::undetermined;
use crate::camera::{Camera, INTRINSIC_NAMES, INTRINSICS, LAYERS, WINDOW_STEP_NAMES};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::rigid::{Motion, STEP_NAMES};
use crate::solve::posterior;
use nalgebra::{DMatrix, DVector, DVectorView, SMatrix, Vector3};
use std::collections::HashMap;

/// How a parameter is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterKnowledge {
    /// From the images; the part of its variance that a prior alone would give, 0 to 1.
    Estimated {
        /// Posterior variance over prior variance; 0 without prior, near 1 where only the prior speaks.
        prior_share: f64,
    },
    /// Held fixed.
    Fixed,
    /// Neither images nor priors determine it.
    Undetermined,
}

/// Covariance of the natural parameters of the first-camera gauge.
#[derive(Debug, Clone)]
pub struct NamedCovariance {
    /// One name per row, unit at its end: `left.f_px`, `right.cam_from_rig.rx_rad`, `view0.rig_from_target.tx_mm`.
    pub names: Vec<String>,
    /// Covariance, over the determined directions.
    pub matrix: DMatrix<f64>,
    /// A large change of each parameter: the measure by which a movement counts as none.
    pub scale: DVector<f64>,
    /// False where a parameter moves along an undetermined direction.
    pub determined: Vec<bool>,
    /// Knowledge of each camera's intrinsics, in the order of [`INTRINSIC_NAMES`].
    pub intrinsics: Vec<[ParameterKnowledge; INTRINSICS]>,
    /// Number of undetermined directions.
    pub nullity: usize,
    /// The undetermined directions in the named parameters, one column each; the parameter that moves most by its scale.
    pub null_directions: DMatrix<f64>,
    /// Undetermined and prior-dominated parameters in words.
    pub undetermined: Vec<String>,
    /// Standard deviations of disc offsets `(dx, dy, dz, dr)`, mm; empty where discs are not estimated.
    pub offset_sigmas_mm: Vec<[f64; 4]>,
    /// Standard deviations of the discs' `(X, Y, Z, R)` in the target frame, mm, those of pitch and step included, `NaN` where one is not determined; empty
    /// where discs are not estimated.
    pub disc_sigmas_mm: Vec<[f64; 4]>,
    /// Cameras, motions and poses in the natural frames.
    pub natural: Natural,
}

/// The estimate in natural frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Natural {
    /// The cameras.
    pub cameras: Vec<Camera>,
    /// Motion of each camera against the first.
    pub cam_from_rig: Vec<Motion<Cam, Rig>>,
    /// The common plane, where there is one, through the dots as they are found; z towards the viewer of the target.
    pub rig_from_plane: Option<Motion<Rig, Sheet>>,
    /// Pose of each view.
    pub rig_from_target: Vec<Motion<Rig, Target>>,
}

impl NamedCovariance {
    /// Row of a name.
    pub fn index(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|n| n == name)
    }
    /// Standard deviation of a parameter; 0 for one that is not adjusted, `None` where it is undetermined.
    pub fn sigma(&self, name: &str) -> Option<f64> {
        match self.index(name) {
            None => Some(0.0),
            Some(i) => self.determined[i].then(|| self.matrix[(i, i)].max(0.0).sqrt()),
        }
    }
    /// Number of undetermined directions that move what views share.
    pub fn shared_nullity(&self) -> usize {
        let shared = |d: &DVectorView<'_, f64>| undetermined::view_of_direction(&self.names, d.iter()).is_none();
        self.null_directions.column_iter().filter(shared).count()
    }
    /// True where a linear function of named parameters, a (name, coefficient) list, stands still along every undetermined
    /// direction: the angle of the sheet to the baseline may be known where neither sheet nor baseline is.
    pub fn is_determined(&self, row: &[(String, f64)]) -> bool {
        let mut all = DVector::<f64>::zeros(self.names.len());
        row.iter().filter_map(|(n, c)| Some((self.index(n)?, *c))).for_each(|(i, c)| all[i] += c);
        self.stands_still(&all)
    }
    /// The same of derivatives by all names: its terms cancel, or are rounding against what it would feel if all of its parameters moved by their scale.
    pub(crate) fn stands_still(&self, row: &DVector<f64>) -> bool {
        let size: f64 = row.iter().zip(self.scale.iter()).map(|(r, s)| r.abs() * s).sum();
        self.null_directions.column_iter().all(|d| {
            let terms = row.component_mul(&d);
            terms.sum().abs() <= (CANCELLED * terms.abs().sum()).max(ROUNDED * size)
        })
    }
    /// Standard deviations of linear functions of named parameters, `NaN` where one is not determined.
    pub fn sigmas(&self, rows: &[Vec<(String, f64)>]) -> Vec<f64> {
        let c = self.propagate(rows);
        let sigma = |k: usize| if self.is_determined(&rows[k]) { c[(k, k)].max(0.0).sqrt() } else { f64::NAN };
        (0..rows.len()).map(sigma).collect()
    }
    /// Covariance of linear functions of named parameters: `rows` are (name, coefficient) lists.
    pub fn propagate(&self, rows: &[Vec<(String, f64)>]) -> DMatrix<f64> {
        let at: HashMap<&str, usize> = self.names.iter().enumerate().map(|(i, n)| (n.as_str(), i)).collect();
        let mut j = DMatrix::zeros(rows.len(), self.names.len());
        for (r, row) in rows.iter().enumerate() {
            row.iter().filter_map(|(n, v)| Some((*at.get(n.as_str())?, v))).for_each(|(c, v)| j[(r, c)] += v);
        }
        &j * &self.matrix * j.transpose()
    }
}

/// One natural parameter as a linear function of all unknowns.
pub(super) struct Row {
    pub(super) name: String,
    pub(super) terms: Vec<(usize, f64)>,
}

/// The estimate and its covariance in natural parameters; `None` after a bad start.
pub fn named_covariance(adjustment: &Adjustment) -> Option<NamedCovariance> {
    let (model, state) = (&adjustment.model, &adjustment.state);
    let places = Places::of(model);
    let post = posterior(adjustment.equations.as_ref()?);
    let natural = natural(model, state)?;
    let rows = rows(model, &places, state, &natural)?;
    let full = post.full();
    let g = DMatrix::from_fn(rows.len(), full.ncols(), |r, c| {
        rows[r].terms.iter().filter(|t| t.0 == c).map(|t| t.1).sum::<f64>()
    });
    let matrix = &g * &full * g.transpose();
    // Large variances along weak directions cancel in small ones: rounding is not the same on both sides.
    let matrix = 0.5 * (&matrix + matrix.transpose());
    let moved = &post.null_movements;
    let cameras: Vec<&str> = model.cameras.iter().map(|c| c.name.as_str()).collect();
    let scale = DVector::from_iterator(rows.len(), rows.iter().map(|row| typical(&natural, &row.name, &cameras)));
    let null_directions = measured(&g * moved, &scale);
    let still = |i: usize, k: usize| {
        let by_rounding = null_directions[(i, k)].abs() <= ROUNDED * scale[i];
        by_rounding || cancels(&rows[i].terms, &moved.column(k))
    };
    let determined: Vec<bool> = (0..rows.len()).map(|i| (0..post.nullity).all(|k| still(i, k))).collect();
    let names: Vec<String> = rows.into_iter().map(|r| r.name).collect();
    let offset_sigmas_mm = places.offsets.map_or_else(Vec::new, |at| {
        let sigma = |i: usize| post.global[(i, i)].max(0.0).sqrt();
        (0..model.target.disc_count()).map(|j| [0, 1, 2, 3].map(|k| sigma(at + 4 * j + k))).collect()
    });
    let loose = shape_names(model).map(|name| {
        let at = names.iter().position(|n| n.strip_prefix("target.") == Some(name));
        at.is_some_and(|i| !determined[i])
    });
    let disc_sigmas_mm = places.offsets.map_or_else(Vec::new, |at| {
        (0..model.target.disc_count()).map(|j| disc_sigmas(model, &places, at, j, &post.global, loose)).collect()
    });
    let mut out = NamedCovariance {
        names,
        null_directions,
        matrix,
        scale,
        determined,
        intrinsics: vec![],
        nullity: post.nullity,
        undetermined: vec![],
        offset_sigmas_mm,
        disc_sigmas_mm,
        natural,
    };
    out.intrinsics = (0..model.cameras.len()).map(|c| knowledge(model, &out, c)).collect();
    out.undetermined = undetermined::words(model, &out);
    out.undetermined.extend(adjustment.ovality_assumed_mm.map(undetermined::of_ovals));
    Some(out)
}

pub(super) fn natural(model: &Model, state: &State) -> Option<Natural> {
    let solver: Option<Vec<SolverCamera>> =
        (0..model.cameras.len()).map(|c| SolverCamera::seen(model, state, c)).collect();
    let solver = solver?;
    let e0 = solver[0].cam_from_solver;
    let rig_from_first: Motion<Rig, Rig> = Motion::new(e0, Vector3::zeros());
    let motion = |c: usize| {
        let turn: Motion<Cam, Cam> = Motion::new(solver[c].cam_from_solver, Vector3::zeros());
        turn * state.camera_from_first[c] * rig_from_first.inverse()
    };
    Some(Natural {
        cameras: solver.iter().map(|s| s.camera).collect(),
        cam_from_rig: (0..solver.len()).map(|c| if c == 0 { Motion::identity() } else { motion(c) }).collect(),
        rig_from_plane: state.first_from_plane.map(|p| {
            let of_dots = DotsPlane::of(model, state).map_or_else(Motion::identity, |dots| dots.motion());
            rig_from_first * p * of_dots
        }),
        rig_from_target: state.views.iter().map(|v| rig_from_first * v.first_from_target).collect(),
    })
}

/// Turn of a camera's window about the axes of the lens frame, and its layers that are adjusted.
fn window_rows(model: &Model, places: &Places, state: &State, c: usize, d: &ChartDerivative) -> Vec<Row> {
    let own = || Some((state.window(c)?, SolverCamera::of(&model.cameras[c], &state.cameras[c])?));
    let Some((window, solver)) = own() else { return vec![] };
    let name = |k: usize| format!("{}.window.{}", model.cameras[c].name, WINDOW_STEP_NAMES[k]);
    let tangents = window.tangents().map(|t| solver.cam_from_solver * t);
    let turn = |r: usize| {
        let own = (0..2).filter_map(|k| Some((places.windows[c][k]?, tangents[k][r])));
        let of_chart = (0..INTRINSICS).filter_map(|j| Some((places.charts[c][j]?, d[(INTRINSICS + r, j)])));
        Row { name: name(r), terms: own.chain(of_chart).collect() }
    };
    let layer = |k: usize| Some(Row { name: name(3 + k), terms: vec![(places.windows[c][2 + k]?, 1.0)] });
    (0..3).map(turn).chain((0..LAYERS).filter_map(layer)).collect()
}

pub(super) fn rows(model: &Model, places: &Places, state: &State, natural: &Natural) -> Option<Vec<Row>> {
    let mut out = vec![];
    let mut turns: Vec<SMatrix<f64, 3, INTRINSICS>> = vec![];
    let chart_at = |c: usize, k: usize| places.charts[c][k];
    for (c, camera) in natural.cameras.iter().enumerate() {
        let d = chart::derivative(&model.cameras[c], camera);
        for (k, name) in INTRINSIC_NAMES.iter().enumerate().filter(|(k, _)| model.cameras[c].free[*k]) {
            let terms = (0..INTRINSICS).filter_map(|j| chart_at(c, j).map(|at| (at, d[(k, j)]))).collect();
            out.push(Row { name: format!("{}.{name}", model.cameras[c].name), terms });
        }
        out.extend(window_rows(model, places, state, c, &d));
        turns.push(d.fixed_rows::<3>(INTRINSICS).into_owned());
    }
    // A turn of a camera's solver frame as a left step through the adjoint `ad`.
    let turn_terms = |c: usize, ad: &SMatrix<f64, 6, 6>, row: usize, sign: f64| -> Vec<(usize, f64)> {
        (0..INTRINSICS)
            .filter_map(|j| {
                let w = turns[c].column(j);
                let value = sign * (ad[(row, 0)] * w[0] + ad[(row, 1)] * w[1] + ad[(row, 2)] * w[2]);
                chart_at(c, j).map(|at| (at, value))
            })
            .collect()
    };
    let solver0 = SolverCamera::of(&model.cameras[0], &state.cameras[0])?;
    let identity = SMatrix::<f64, 6, 6>::identity();
    for c in 1..natural.cameras.len() {
        let Some(first) = places.motions[c] else { continue };
        let own = SolverCamera::of(&model.cameras[c], &state.cameras[c])?;
        let turn = Motion::<Cam, Cam>::new(own.cam_from_solver, Vector3::zeros()).adjoint();
        for r in 0..6 {
            let mut terms: Vec<(usize, f64)> = (0..6).map(|k| (first + k, turn[(r, k)])).collect();
            terms.extend(turn_terms(c, &identity, r, 1.0));
            terms.extend(turn_terms(0, &natural.cam_from_rig[c].adjoint(), r, -1.0));
            out.push(Row { name: format!("{}.cam_from_rig.{}", model.cameras[c].name, STEP_NAMES[r]), terms });
        }
    }
    let turn0: Motion<Rig, Rig> = Motion::new(solver0.cam_from_solver, Vector3::zeros());
    let plane_ad = state.first_from_plane.map(|p| (turn0 * p).adjoint());
    if let (Some(ad), Some(first)) = (&plane_ad, places.plane) {
        for (r, mut terms) in sheet_terms(model, (places, first), state, ad).into_iter().enumerate() {
            terms.extend(turn_terms(0, &identity, r, 1.0));
            out.push(Row { name: format!("{SHEET}{}", STEP_NAMES[r]), terms });
        }
    }
    let shape_names = shape_names(model);
    for k in 0..3 {
        if let Some(at) = places.shape[k] {
            out.push(Row { name: format!("target.{}", shape_names[k]), terms: vec![(at, 1.0)] });
        }
    }
    let mut at = places.global;
    for v in 0..model.views.len() {
        let steps = model.views[v].place.planar_steps();
        for r in 0..6 {
            let mut terms: Vec<(usize, f64)> = match (&plane_ad, places.plane, &state.views[v].plane_from_target) {
                (Some(ad), Some(first), Some(_)) => {
                    let plane = [0, 1, 5].iter().enumerate().map(|(n, &k)| (first + n, ad[(r, k)]));
                    plane.chain(steps.iter().enumerate().map(|(n, &k)| (at + n, ad[(r, k)]))).collect()
                }
                _ => (0..6).map(|k| (at + k, turn0.adjoint()[(r, k)])).collect(),
            };
            terms.extend(turn_terms(0, &identity, r, 1.0));
            out.push(Row { name: format!("view{v}.rig_from_target.{}", STEP_NAMES[r]), terms });
        }
        if model.views[v].place.moves_along_normal() {
            out.push(Row { name: format!("view{v}.plane_z_mm"), terms: vec![(at + 3, 1.0)] });
        }
        for k in 0..3 {
            if let Some(inside) = places.view_shape[k] {
                let terms = vec![(at + places.pose_sizes[v] + inside, 1.0)];
                out.push(Row { name: format!("view{v}.{}", shape_names[k]), terms });
            }
        }
        at += places.layout().blocks[v];
    }
    Some(out)
}

/// Steps of the sheet by those of the plane, whose first is given, and by the heights of its dots; `ad` takes steps about the plane to steps of the sheet.
fn sheet_terms(
    model: &Model,
    (places, first): (&Places, usize),
    state: &State,
    ad: &SMatrix<f64, 6, 6>,
) -> [Vec<(usize, f64)>; 6] {
    let dots = places.offsets.zip(DotsPlane::of(model, state));
    std::array::from_fn(|r| {
        let of_plane = [0, 1, 5].iter().enumerate().map(|(n, &k)| (first + n, ad[(r, k)]));
        let of_dots = dots
            .iter()
            .flat_map(|(at, dots)| dots.steps().map(move |(j, step)| (at + 4 * j + 2, ad.row(r).tr_dot(&step))));
        of_plane.chain(of_dots).collect()
    })
}

fn shape_names(model: &Model) -> [&'static str; 3] {
    match model.target.shape {
        TargetShape::Pair { .. } => ["spacing_mm", "radius0_mm", "radius1_mm"],
        TargetShape::Lattice(_) => ["spacing_mm", "radius_mm", "step_mm"],
    }
}

/// Standard deviations of X, Y, Z and R of disc `j` by its own offsets, the first of all at `first`, and the shape of all; `NaN` where they follow one of
/// the shape parameters that are loose.
fn disc_sigmas(model: &Model, places: &Places, first: usize, j: usize, c: &DMatrix<f64>, loose: [bool; 3]) -> [f64; 4] {
    let by_shape = model.target.disc_derivative(j);
    std::array::from_fn(|k| {
        let by = |p: &usize| by_shape[k][*p];
        if (0..3).any(|p| loose[p] && by(&p) != 0.0) {
            return f64::NAN;
        }
        let shape = (0..3).filter_map(|p| Some((places.shape[p]?, by(&p))));
        let row: Vec<(usize, f64)> = shape.chain([(first + 4 * j + k, 1.0)]).collect();
        row.iter().flat_map(|(a, x)| row.iter().map(move |(b, y)| x * y * c[(*a, *b)])).sum::<f64>().max(0.0).sqrt()
    })
}

/// Directions of such length that what moves most moves by its scale.
fn measured(mut directions: DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    for mut d in directions.column_iter_mut() {
        let most = d.iter().zip(scale.iter()).filter(|(_, s)| **s > 0.0).map(|(d, s)| d.abs() / s).fold(0.0, f64::max);
        if most > 0.0 {
            d.unscale_mut(most);
        }
    }
    directions
}

/// Part of the movements of its terms by which a sum may move and yet stand still, and part of what it would feel of large changes: what rounding
/// makes of a direction.
const CANCELLED: f64 = 1e-4;
pub(super) const ROUNDED: f64 = 1e-6;

/// Whether the movements of its unknowns cancel in a sum.
fn cancels(terms: &[(usize, f64)], moved: &DVectorView<'_, f64>) -> bool {
    let sum: f64 = terms.iter().map(|(i, c)| c * moved[*i]).sum();
    let size: f64 = terms.iter().map(|(i, c)| (c * moved[*i]).abs()).sum();
    sum.abs() <= CANCELLED * size
}

fn knowledge(model: &Model, covariance: &NamedCovariance, c: usize) -> [ParameterKnowledge; INTRINSICS] {
    std::array::from_fn(|k| {
        let name = format!("{}.{}", model.cameras[c].name, INTRINSIC_NAMES[k]);
        match (covariance.index(&name), covariance.sigma(&name)) {
            (None, _) => ParameterKnowledge::Fixed,
            (Some(_), None) => ParameterKnowledge::Undetermined,
            (Some(_), Some(s)) => {
                let prior = model.facts.iter().find_map(|f| match *f {
                    Fact::Intrinsic { camera, parameter, sigma, .. } if camera == c && parameter == k => Some(sigma),
                    _ => None,
                });
                ParameterKnowledge::Estimated { prior_share: prior.map_or(0.0, |p| (s / p).powi(2).min(1.0)) }
            }
        }
    })
}
