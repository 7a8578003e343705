//! One camera alone: candidates in closed form, each adjusted a little, the best adjusted to the end.

use super::one_plane::{all_in_plane, all_parallel, usual};
use super::{CameraStart, Mono, RigProblem, Told, rms_of};
use crate::bundle::{
    AdjustOptions, Adjustment, CameraModel, DiscObservation, Fact, ImageObservations, Loss, Model, PointObservations,
    SolveOptions, State, TargetShape, Termination, ViewModel, ViewPlace, ViewState, adjust,
};
use crate::camera::{Camera, EffectivePinhole, Intrinsics};
use crate::conic::Ellipse;
use crate::detect::EdgePoints;
use crate::error::{Insufficient, Result, Unusable};
use crate::frames::{Cam, Rig, Target};
use crate::rigid::Motion;
use crate::seed::{
    CircularPoint, homography, lattice_circular_point, lattice_pose, pair_circular_point, pair_pose, pinholes,
};
use crate::stats;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Edge points per disc and discs per image that a start looks at: enough to choose, few enough to be quick.
const START_EDGES: usize = 24;
const START_DISCS: usize = 48;
/// Edge points per disc where all discs are needed.
const LIGHT_EDGES: usize = 12;

/// What one view of the plane gives before the camera is known.
enum ViewSeed {
    Lattice { homography: Matrix3<f64>, mirrored: bool },
    Pair { ellipses: [Ellipse; 2], line: Vector3<f64> },
}

struct SeededImage {
    image: usize,
    view: usize,
    seed: ViewSeed,
    circular: CircularPoint,
}

/// Calibrates camera `c` of the problem alone; scale as in the problem's first guess.
///
/// # Errors
/// Too few views, discs that no circle pair or lattice explains, no start that converges; stopped by `told`.
pub(super) fn calibrate_camera(problem: &RigProblem, c: usize, told: Told<'_>) -> Result<Mono> {
    let name = &problem.model.cameras[c].name;
    let seeds = seeds(problem, c)?;
    let known_f = !problem.model.cameras[c].free[0]
        || problem
            .model
            .facts
            .iter()
            .any(|f| matches!(f, Fact::Intrinsic { camera, parameter: 0, .. } if *camera == c));
    let needed = if known_f { 1 } else { 2 };
    if seeds.len() < needed {
        return Err(Insufficient::TooFewViews { camera: name.clone(), found: seeds.len(), needed }.into());
    }
    refuse_mirrored(problem, name, &seeds)?;
    let points: Vec<CircularPoint> = seeds.iter().map(|s| s.circular).collect();
    let start = &problem.starts[c];
    let mut candidates: Vec<EffectivePinhole> = designed(start).into_iter().collect();
    candidates.extend(pinholes(&points, start.size_px, start.nominal_f_px));
    let mut model = mono_model(problem, c, &seeds);
    let one_plane = all_in_plane(problem, seeds.iter().map(|s| s.view));
    if one_plane {
        model.facts.extend(usual(problem, c));
    }
    let mut best = best_candidate(problem, c, (&seeds, &candidates), &model, told)?;
    if !one_plane && all_parallel(&best.state) {
        model.facts.extend(usual(problem, c));
        best = best_candidate(problem, c, (&seeds, &candidates), &model, told)?;
    }
    let fine =
        AdjustOptions { solve: SolveOptions { decrement: 1e-2, iterations: 100 }, rounds: 0, outlier_sigmas: 6.0 };
    let done = adjust(&model, best.state, &fine, &mut |i| told(i));
    if done.termination == Termination::Cancelled {
        return Err(Unusable::Cancelled.into());
    }
    let mut poses = vec![None; problem.model.views.len()];
    for (k, s) in seeds.iter().enumerate() {
        let view = &done.state.views[k];
        let pose: Motion<Cam, Target> =
            Motion::new(view.first_from_target.rotation, view.first_from_target.translation_mm);
        let shape = if model.target.per_view() { view.shape_mm } else { done.state.shape_mm };
        poses[s.view] = Some((pose, shape));
    }
    let rms_px = rms_of(&model, &done.state).unwrap_or(f64::INFINITY);
    Ok(Mono { intrinsics: done.state.cameras[0], poses, rms_px })
}

/// The candidate that explains the images best, adjusted a little.
fn best_candidate(
    problem: &RigProblem,
    c: usize,
    (seeds, candidates): (&[SeededImage], &[EffectivePinhole]),
    model: &Model,
    told: Told<'_>,
) -> Result<Adjustment> {
    let quick =
        AdjustOptions { solve: SolveOptions { decrement: 1.0, iterations: 25 }, rounds: 0, outlier_sigmas: 6.0 };
    let mut best: Option<Adjustment> = None;
    for pinhole in candidates {
        let Some(state) = mono_start(problem, c, seeds, pinhole) else { continue };
        let trial = adjust(model, state, &quick, &mut |i| told(i));
        if trial.termination == Termination::Cancelled {
            return Err(Unusable::Cancelled.into());
        }
        if trial.cost.is_finite() && best.as_ref().is_none_or(|b| trial.cost < b.cost) {
            best = Some(trial);
        }
        // A candidate that explains the contours to half a pixel needs no rival.
        if best.as_ref().and_then(|b| rms_of(model, &b.state)).is_some_and(|r| r < 0.5) {
            break;
        }
    }
    best.ok_or_else(|| {
        Insufficient::Degenerate(format!(
            "camera \"{}\": no start explains its images; record the target in clearly different tilts, or state focal_length_mm and pixel_pitch_mm",
            problem.model.cameras[c].name
        ))
        .into()
    })
}

/// Refuses labels that run the wrong way round: the front of a target never shows them so.
fn refuse_mirrored(problem: &RigProblem, name: &str, seeds: &[SeededImage]) -> Result<()> {
    let wrong: Vec<&str> = seeds
        .iter()
        .filter(|s| matches!(s.seed, ViewSeed::Lattice { mirrored: true, .. }))
        .map(|s| problem.image_names[s.image].as_str())
        .collect();
    if wrong.is_empty() {
        return Ok(());
    }
    Err(Insufficient::Inconsistent(format!(
        "camera \"{name}\": {} of {} images are mirrored (the dots' labels run the wrong way round in {}); switch off the mirroring of that \
         camera, or of a mirror in its path, in the recording software; the back of a transparent target looks the same, and grids and plates are \
         calibrated from their front only",
        wrong.len(),
        seeds.len(),
        wrong.join(", ")
    ))
    .into())
}

fn seeds(problem: &RigProblem, c: usize) -> Result<Vec<SeededImage>> {
    let mut out = vec![];
    for (k, image) in problem.model.images.iter().enumerate().filter(|(_, i)| i.camera == c) {
        let seed = match &problem.model.target.shape {
            TargetShape::Pair { .. } => pair_seed(image, &problem.ellipses[k]),
            TargetShape::Lattice(_) => lattice_seed(problem, image, &problem.ellipses[k]),
        };
        let Some((seed, circular)) = seed else {
            return Err(Insufficient::Pattern {
                image: problem.image_names[k].clone(),
                message:
                    "the discs are not the image of circles in one plane; check that these are the target's discs, \
                          not their reflections, and that the target is flat"
                        .into(),
            }
            .into());
        };
        out.push(SeededImage { image: k, view: image.view, seed, circular });
    }
    Ok(out)
}

fn pair_seed(image: &ImageObservations, ellipses: &[Ellipse]) -> Option<(ViewSeed, CircularPoint)> {
    let at = |disc: usize| image.discs.iter().position(|d| d.disc == disc).map(|i| ellipses[i]);
    let pair = [at(0)?, at(1)?];
    let (circular, line) = pair_circular_point([&pair[0], &pair[1]])?;
    Some((ViewSeed::Pair { ellipses: pair, line }, circular))
}

fn lattice_seed(
    problem: &RigProblem,
    image: &ImageObservations,
    ellipses: &[Ellipse],
) -> Option<(ViewSeed, CircularPoint)> {
    let shape = problem.shape_mm.map(|s| s.unwrap_or(1.0));
    // One level only: a homography knows no depth. The level with more dots.
    let level = |d: &DiscObservation| problem.model.target.nominal_disc(d.disc, &shape).0.z;
    let front = image.discs.iter().filter(|d| level(d) == 0.0).count();
    let on_front = 2 * front >= image.discs.len();
    let (mut plane, mut seen) = (vec![], vec![]);
    for (d, e) in image.discs.iter().zip(ellipses).filter(|(d, _)| (level(d) == 0.0) == on_front) {
        plane.push(problem.model.target.nominal_disc(d.disc, &shape).0.xy());
        seen.push(Vector2::new(e.center_px.u_px, e.center_px.v_px));
    }
    let h = homography(&plane, &seen)?;
    // Target y is up, image v down: an image that keeps the orientation is mirrored, whatever the camera.
    let mirrored = h.determinant() * (h * plane[0].push(1.0)).z > 0.0;
    Some((ViewSeed::Lattice { homography: h, mirrored }, lattice_circular_point(&h)))
}

/// Subsampled copy of a contour.
fn thinned(edge: &EdgePoints) -> EdgePoints {
    every(edge, START_EDGES)
}

/// About `count` points of a contour, evenly.
fn every(edge: &EdgePoints, count: usize) -> EdgePoints {
    let step = edge.u_px.len().div_ceil(count).max(1);
    let pick = |v: &[f64]| v.iter().step_by(step).copied().collect();
    EdgePoints { u_px: pick(&edge.u_px), v_px: pick(&edge.v_px), sigma_px: pick(&edge.sigma_px) }
}

/// Whether held radii are the only length of the target that is known.
fn radii_set_the_scale(problem: &RigProblem) -> bool {
    let [spacing_mm, ..] = problem.shape_mm;
    spacing_mm.is_none() && problem.model.target.held_radii().any(|k| problem.shape_mm[k].is_some())
}

/// A model with few discs and edge points, without printing errors: to choose between starts.
pub(super) fn thinned_model(model: &Model) -> Model {
    let mut out = model.clone();
    out.target.offset_sigma_mm = None;
    out.loss = START_LOSS;
    out.images.iter_mut().for_each(|i| i.discs = thinned_discs(&i.discs));
    out
}

/// A model with all discs but few edge points, sigmas smaller so that they say as much together.
pub(super) fn lightened(model: &Model) -> Model {
    let mut out = model.clone();
    for d in out.images.iter_mut().flat_map(|i| &mut i.discs) {
        let all = d.edge.u_px.len();
        *d = DiscObservation::new(d.disc, every(&d.edge, LIGHT_EDGES));
        let share = (d.edge.u_px.len() as f64 / all.max(1) as f64).sqrt();
        d.edge.sigma_px.iter_mut().for_each(|s| *s *= share);
    }
    out
}

fn thinned_discs(discs: &[DiscObservation]) -> Vec<DiscObservation> {
    let step = discs.len().div_ceil(START_DISCS).max(1);
    let thin = |d: &DiscObservation| DiscObservation::new(d.disc, thinned(&d.edge));
    discs.iter().step_by(step).map(thin).collect()
}

/// Wide enough not to hide a wrong candidate, tight enough to survive a bad contour.
const START_LOSS: Loss = Loss::Huber(50.0);

fn mono_model(problem: &RigProblem, c: usize, seeds: &[SeededImage]) -> Model {
    let full = &problem.model;
    let mut target = full.target.clone();
    // Scale is a gauge of a single camera, unless a radius holds it; printing errors wait for both.
    target.free[0] &= radii_set_the_scale(problem);
    target.offset_sigma_mm = None;
    let image = |(k, s): (usize, &SeededImage)| ImageObservations {
        view: k,
        camera: 0,
        discs: thinned_discs(&full.images[s.image].discs),
        pairs: vec![],
        points: PointObservations::default(),
        sigma_scale: 1.0,
    };
    let facts = full.facts.iter().filter_map(|f| match f {
        Fact::Intrinsic { camera, parameter, value, sigma } if *camera == c => {
            Some(Fact::Intrinsic { camera: 0, parameter: *parameter, value: *value, sigma: *sigma })
        }
        _ => None,
    });
    Model {
        // A camera alone sees the scene through the window as a pinhole sees another scene.
        cameras: vec![CameraModel { window: None, ..full.cameras[c].clone() }],
        target,
        views: vec![ViewModel { place: ViewPlace::Free }; seeds.len()],
        facts: facts.collect(),
        images: seeds.iter().enumerate().map(image).collect(),
        loss: START_LOSS,
    }
}

/// Intrinsics of an effective pinhole with the axis point at its known place or at the sensor's centre, fixed values held.
fn start_intrinsics(start: &CameraStart, free: &[bool; 10], pinhole: &EffectivePinhole) -> Intrinsics {
    let v = &start.values;
    let cx = v[2].unwrap_or((start.size_px[0] - 1.0) / 2.0);
    let cy = v[3].unwrap_or((start.size_px[1] - 1.0) / 2.0);
    let mut p = pinhole.with_axis_point(cx, cy, v[1].unwrap_or(1.0)).to_array();
    for k in 0..10 {
        if !free[k] {
            p[k] = v[k].unwrap_or(p[k]);
        }
    }
    Intrinsics::from_array(&p, start.radial)
}

/// The effective pinhole of the drawing, where there is one.
fn designed(start: &CameraStart) -> Option<EffectivePinhole> {
    let [f_px, alpha_rad, beta_rad] = start.design?;
    let cx = start.values[2].unwrap_or((start.size_px[0] - 1.0) / 2.0);
    let cy = start.values[3].unwrap_or((start.size_px[1] - 1.0) / 2.0);
    let aspect = start.values[1].unwrap_or(1.0);
    let camera = Camera::new(Intrinsics { alpha_rad, beta_rad, aspect, ..Intrinsics::pinhole(f_px, cx, cy) });
    Some(camera.ok()?.effective_pinhole())
}

fn mono_start(problem: &RigProblem, c: usize, seeds: &[SeededImage], pinhole: &EffectivePinhole) -> Option<State> {
    let camera = &problem.model.cameras[c];
    let intrinsics = start_intrinsics(&problem.starts[c], &camera.free, pinhole);
    // Poses belong to the pinhole that these intrinsics really have, which fixed values may have moved.
    let actual = Camera::new(intrinsics).ok()?;
    let pinhole = actual.effective_pinhole();
    let turn = if camera.uses_pinhole_frame() { Matrix3::identity() } else { actual.cam_from_pinhole() };
    let mut views = vec![];
    for s in seeds {
        let (pose, shape_mm) = match &s.seed {
            ViewSeed::Lattice { homography, .. } => {
                let pose = lattice_pose(homography, &pinhole)?;
                let shape = lattice_shape(problem, s, &pose, &actual);
                (pose, shape)
            }
            ViewSeed::Pair { ellipses, line } => {
                let p = pair_pose([&ellipses[0], &ellipses[1]], line, &pinhole)?;
                let ([r0, r1], spacing) = (p.radii, problem.shape_mm[0].unwrap_or(1.0));
                let pose = Motion::new(p.cam_from_target.rotation, p.cam_from_target.translation_mm * spacing);
                (pose, [1.0, r0, r1].map(|s| s * spacing))
            }
        };
        let first_from_target: Motion<Rig, Target> = Motion::new(turn * pose.rotation, turn * pose.translation_mm);
        views.push(ViewState { first_from_target, plane_from_target: None, shape_mm });
    }
    let metric = problem.shape_mm[0].is_some() || radii_set_the_scale(problem);
    scale_by_radii(problem, &mut views);
    let shape = |k: usize| {
        problem.shape_mm[k].filter(|_| metric).unwrap_or_else(|| median(views.iter().map(|v| v.shape_mm[k])))
    };
    let shape_mm = [shape(0), shape(1), shape(2)];
    Some(State {
        cameras: vec![intrinsics],
        camera_from_first: vec![Motion::identity()],
        first_from_plane: None,
        views,
        shape_mm,
        offsets_mm: vec![],
        ovals_mm: vec![],
        slopes: vec![],
        windows: vec![],
    })
}

fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    stats::median(&mut numbers.collect::<Vec<_>>()).unwrap_or(f64::NAN)
}

/// Brings the views, seen with a spacing of 1, to the scale of known radii where these set it.
fn scale_by_radii(problem: &RigProblem, views: &mut [ViewState]) {
    if !radii_set_the_scale(problem) {
        return;
    }
    let held = || problem.model.target.held_radii().filter_map(|k| Some((k, problem.shape_mm[k]?)));
    let scale = median(views.iter().flat_map(|v| held().map(|(k, radius_mm)| radius_mm / v.shape_mm[k])));
    for v in views {
        v.first_from_target.translation_mm *= scale;
        v.shape_mm.iter_mut().for_each(|s| *s *= scale);
    }
}

/// Shape of a lattice, its radius from the mean size of its dots in the image.
fn lattice_shape(problem: &RigProblem, s: &SeededImage, pose: &Motion<Cam, Target>, camera: &Camera) -> [f64; 3] {
    let shape = problem.shape_mm;
    let size: f64 = problem.ellipses[s.image].iter().map(|e| e.semi_major_px).sum::<f64>();
    let mean_px = size / problem.ellipses[s.image].len().max(1) as f64;
    let mm_per_px = pose.translation_mm.norm() / camera.effective_pinhole().f_px;
    [shape[0].unwrap_or(1.0), mean_px * mm_per_px, shape[2].unwrap_or(0.0)]
}
