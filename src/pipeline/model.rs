//! From a rig description and labelled discs to the least-squares problem.

use super::images::SeenImage;
use crate::bundle::{
    CameraModel, DiscObservation, Fact, Focus, ImageObservations, Loss, Model, Node, PlanePosition, PointObservations,
    TargetModel, TargetShape, ViewModel, ViewPlace, WindowModel,
};
use crate::camera::INTRINSICS;
use crate::conic::Ellipse;
use crate::error::{Insufficient, Invalid, Result};
use crate::record;
use crate::rig::{CameraStart, OpenLabels, RigProblem};
use crate::rig_file::{
    Adjust, CameraDescription, Knowledge, Length, Loss as LossName, Parameter, PlaneZ, RigDescription, Scale,
    ViewDescription, WindowDescription,
};
use crate::target::{DotId, Target};

/// Standard deviation of the weak prior that holds the axis point at the sensor's centre, part of the image's width.
///
/// Without distortion nothing in the images says where the lens axis meets the sensor. A mount that is off by a tenth of
/// the sensor would be seen with the naked eye.
pub const AXIS_POINT_SIGMA: f64 = 0.1;
/// Residuals beyond this many sigmas count linearly (Huber) or logarithmically (Cauchy).
pub const LOSS_SIGMAS: f64 = 3.0;
/// Standard deviation of every printed dot about its nominal place where the rig file gives none, part of the pitch.
pub const POINT_SIGMA: f64 = 0.01;

/// The problem and the labels of its discs.
pub(super) struct Built {
    pub(super) problem: RigProblem,
    /// Label of each disc of the target.
    pub(super) labels: Vec<DotId>,
    /// Facts that the rig file does not state.
    pub(super) assumed: Vec<usize>,
}

/// Builds the adjustment of all images that show the target; `sizes_px` per camera.
pub(super) fn build(job: &RigDescription, images: &[SeenImage], sizes_px: &[[f64; 2]]) -> Result<Built> {
    let labels = labels_of(job, images);
    let (observations, ellipses) = observations(images, &labels);
    let (target, shape_mm, mut facts) = target(job, &labels)?;
    let mut cameras = vec![];
    let mut starts = vec![];
    let mut assumed = vec![];
    for (c, description) in job.cameras.iter().enumerate() {
        let (model, start) = camera(job, description, sizes_px[c]);
        facts.extend(stated_facts(c, description));
        let own = axis_point_facts(c, description, &model, sizes_px[c]);
        assumed.extend(facts.len()..facts.len() + own.len());
        facts.extend(own);
        facts.extend(focus(job, c)?);
        facts.extend(window_facts(c, description));
        cameras.push(model);
        starts.push(start);
    }
    let views = job.views.iter().map(|v| ViewModel { place: place(job, v) });
    let model = Model {
        cameras,
        target,
        views: views.collect(),
        facts,
        images: observations,
        loss: match job.solve.loss {
            LossName::None => Loss::None,
            LossName::Huber => Loss::Huber(LOSS_SIGMAS),
            LossName::Cauchy => Loss::Cauchy(LOSS_SIGMAS),
        },
    };
    let image_names = images.iter().map(|i| i.name.clone()).collect();
    let step_pitches = label_step(&job.target.target);
    let size = unmarked_size(&job.target.target);
    let open = OpenLabels { step_pitches, size, images: images.iter().map(|i| i.open.clone()).collect() };
    Ok(Built { problem: RigProblem { model, ellipses, starts, shape_mm, image_names, open }, labels, assumed })
}

/// Length of a step of a label, pitches.
fn label_step(target: &Target) -> f64 {
    if matches!(target, Target::TwoLevelPlate(_)) { 0.5 } else { 1.0 }
}

/// Columns and rows of a grid without marks.
fn unmarked_size(target: &Target) -> [Option<usize>; 2] {
    match target {
        Target::DotGrid(grid) if grid.marks.is_empty() => [grid.columns, grid.rows],
        _ => [None; 2],
    }
}

/// Where a view's target is. In the sheet it is exactly at 0; on a traverse as the view says, else as `[scale]` does.
fn place(job: &RigDescription, view: &ViewDescription) -> ViewPlace {
    let common = if let Scale::Traverse { sigma_mm } = job.scale { sigma_mm } else { None };
    match view.plane_z_mm {
        _ if view.sheet => ViewPlace::InPlane { z_mm: 0.0, known: PlanePosition::Exact },
        None => ViewPlace::Free,
        Some(PlaneZ::Unknown) => ViewPlace::InPlane { z_mm: 0.0, known: PlanePosition::Unknown },
        Some(PlaneZ::Known { z_mm, sigma_mm }) => {
            let sigma_mm = sigma_mm.or(common);
            let known = sigma_mm.map_or(PlanePosition::Exact, |sigma_mm| PlanePosition::About { sigma_mm });
            ViewPlace::InPlane { z_mm, known }
        }
    }
}

fn labels_of(job: &RigDescription, images: &[SeenImage]) -> Vec<DotId> {
    if matches!(job.target.target, Target::TwoDiscs(_) | Target::Bubbles(_)) {
        return vec![DotId { column: 0, row: 0, level: 0 }, DotId { column: 1, row: 0, level: 0 }];
    }
    let mut all: Vec<DotId> = images.iter().flat_map(|i| i.discs.iter().map(|d| d.id)).collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn observations(images: &[SeenImage], labels: &[DotId]) -> (Vec<ImageObservations>, Vec<Vec<Ellipse>>) {
    let mut out = vec![];
    let mut ellipses = vec![];
    for image in images {
        let (mut discs, mut own) = (vec![], vec![]);
        for d in &image.discs {
            if let Ok(disc) = labels.binary_search(&d.id) {
                let found = &image.detection.discs[d.disc];
                discs.push(DiscObservation::of(disc, found));
                own.push(found.ellipse);
            }
        }
        let (view, camera, points) = (image.view, image.camera, PointObservations::default());
        out.push(ImageObservations { view, camera, discs, pairs: vec![], points, sigma_scale: 1.0 });
        ellipses.push(own);
    }
    (out, ellipses)
}

/// Lattice place of a label: labels of a plate count half pitches, since the levels alternate.
pub(super) fn node(target: &Target, l: &DotId) -> Node {
    let unit = label_step(target);
    Node { x: unit * f64::from(l.column), y: unit * f64::from(l.row), level: f64::from(l.level) }
}

fn stiff(length: Length) -> (f64, f64) {
    (length.value_mm, length.sigma_mm.unwrap_or(record::EXACT * length.value_mm))
}

/// Target model, first guess of its shape, and the facts that fix its scale.
fn target(job: &RigDescription, labels: &[DotId]) -> Result<(TargetModel, [Option<f64>; 3], Vec<Fact>)> {
    let nodes = || labels.iter().map(|l| node(&job.target.target, l)).collect();
    let (shape, mut shape_mm) = match &job.target.target {
        Target::TwoDiscs(p) | Target::Bubbles(p) => {
            let per_view = matches!(job.target.target, Target::Bubbles(_));
            let radii = p.radii_mm.map_or([None; 2], |r| r.map(Some));
            (TargetShape::Pair { per_view }, [p.spacing_mm, radii[0], radii[1]])
        }
        Target::DotGrid(g) => (TargetShape::Lattice(nodes()), [g.spacing_mm, g.radius_mm, Some(0.0)]),
        Target::TwoLevelPlate(p) => (TargetShape::Lattice(nodes()), [Some(p.spacing_mm), p.radius_mm, Some(p.step_mm)]),
    };
    let adjusts = job.target.adjust != Adjust::None;
    let two_levels = labels.iter().any(|l| l.level == 1);
    let pair = matches!(shape, TargetShape::Pair { .. });
    let mut free = [
        true,
        adjusts || shape_mm[1].is_none(),
        if pair { adjusts || shape_mm[2].is_none() } else { adjusts && two_levels },
    ];
    let mut facts = vec![];
    let mut fix =
        |parameter: usize, view: Option<usize>, length: Length, exact_is_fixed: bool, free: &mut [bool; 3]| {
            if exact_is_fixed && length.sigma_mm.is_none() {
                free[parameter] = false;
            } else {
                let (value_mm, sigma_mm) = stiff(length);
                facts.push(Fact::Shape { parameter, view, value_mm, sigma_mm });
            }
        };
    match job.scale {
        Scale::TargetSpacing(length) => {
            fix(0, None, length, true, &mut free);
            shape_mm[0] = Some(length.value_mm);
        }
        Scale::TargetRadius { disc, radius } => {
            let k = 1 + if pair { disc } else { 0 };
            fix(k, None, radius, true, &mut free);
            shape_mm[k] = Some(radius.value_mm);
        }
        Scale::ViewSpacing { view, spacing } => fix(0, Some(view), spacing, false, &mut free),
        Scale::ViewRadius { view, disc, radius } => fix(1 + disc, Some(view), radius, false, &mut free),
        Scale::Baseline(length) => {
            let (value_mm, sigma_mm) = stiff(length);
            facts.push(Fact::Baseline { value_mm, sigma_mm });
        }
        // The positions themselves are facts: see `place`.
        Scale::Traverse { .. } => {}
    }
    let offset_sigma_mm = (job.target.adjust == Adjust::Points).then(|| {
        let pitch = shape_mm[0].unwrap_or(1.0);
        let s = job.target.point_sigma_mm.unwrap_or(POINT_SIGMA * pitch);
        [s, s, s, s]
    });
    if labels.is_empty() {
        return Err(Insufficient::Degenerate("no image shows the target".into()).into());
    }
    Ok((TargetModel { shape, free, offset_sigma_mm, oval_sigma_mm: None }, shape_mm, facts))
}

/// Index of a rig-file parameter in [`crate::camera::INTRINSIC_NAMES`].
fn index(p: Parameter) -> usize {
    match p {
        Parameter::F => 0,
        Parameter::Aspect => 1,
        Parameter::Cx => 2,
        Parameter::Cy => 3,
        Parameter::Alpha => 4,
        Parameter::Beta => 5,
        Parameter::K1 => 6,
        Parameter::K2 => 7,
        Parameter::K3 => 8,
        Parameter::PupilRatio => 9,
    }
}

fn camera(job: &RigDescription, d: &CameraDescription, size_px: [f64; 2]) -> (CameraModel, CameraStart) {
    let mut free = [true, false, true, true, true, true, false, false, false, false];
    let mut values = [None; INTRINSICS];
    (values[1], values[9]) = (Some(1.0), Some(1.0));
    (6..9).for_each(|k| values[k] = Some(0.0));
    job.solve.estimate.iter().for_each(|p| free[index(*p)] = true);
    for (p, knowledge) in &d.known {
        let k = index(*p);
        match *knowledge {
            Knowledge::Fixed { value } => {
                free[k] = false;
                values[k] = Some(value);
            }
            Knowledge::Prior { value, .. } => {
                free[k] = true;
                values[k] = Some(value);
            }
        }
    }
    // The image distance of a lens is a little longer than its focal length: 10 % at ten focal lengths.
    let from_lens = d.focal_length_mm.zip(d.pixel_pitch_mm).map(|(f, pitch)| 1.1 * f / pitch);
    let nominal_f_px = values[0].or(d.design.map(|d| d.f_px)).or(from_lens);
    let design = d.design.map(|d| [d.f_px, d.alpha_rad, d.beta_rad]);
    (
        CameraModel { name: d.name.clone(), free, window: d.window.map(|w| window(&w)), axis_frame: false },
        CameraStart { size_px, nominal_f_px, values, design, radial: d.radial },
    )
}

/// The sheet as the plane on which a camera is focused, where the rig file says so.
fn focus(job: &RigDescription, camera: usize) -> Result<Option<Fact>> {
    let Some(focus) = job.focus else { return Ok(None) };
    let d = &job.cameras[camera];
    let pixel_pitch_mm = d.pixel_pitch_mm.ok_or_else(|| Invalid::File {
        path: job.file.clone(),
        message: format!("[focus] needs pixel_pitch_mm of camera \"{}\"; add it, or remove [focus]", d.name),
    })?;
    let distance = d.focal_length_mm.zip(focus.distance_sigma);
    Ok(Some(Fact::Focus(Focus { camera, pixel_pitch_mm, tilt_sigma_rad: focus.tilt_sigma_rad, distance })))
}

/// What the rig file says of a camera.
fn stated_facts(camera: usize, d: &CameraDescription) -> Vec<Fact> {
    let fact = |(p, knowledge): &(Parameter, Knowledge)| match *knowledge {
        Knowledge::Prior { value, sigma } => Some(Fact::Intrinsic { camera, parameter: index(*p), value, sigma }),
        Knowledge::Fixed { .. } => None,
    };
    let mut out: Vec<Fact> = d.known.iter().filter_map(fact).collect();
    if let Some(design) = &d.design {
        let mut add = |p: Parameter, value: f64, sigma: Option<f64>| {
            out.extend(sigma.map(|sigma| Fact::Intrinsic { camera, parameter: index(p), value, sigma }));
        };
        add(Parameter::F, design.f_px, design.f_sigma_px);
        add(Parameter::Alpha, design.alpha_rad, design.tilt_sigma_rad);
        add(Parameter::Beta, design.beta_rad, design.tilt_sigma_rad);
    }
    out
}

fn window(d: &WindowDescription) -> WindowModel {
    WindowModel { free: d.layers.map(|l| l.1.is_some()), layers: d.layers.map(|l| l.0) }
}

/// What the rig file says of a camera's window.
fn window_facts(camera: usize, d: &CameraDescription) -> Vec<Fact> {
    let Some(window) = &d.window else { return vec![] };
    let layer = |(layer, (value, sigma)): (usize, &(f64, Option<f64>))| {
        sigma.map(|sigma| Fact::WindowLayer { camera, layer, value: *value, sigma })
    };
    let parallel = |axis: usize| Fact::WindowParallel { camera, axis, sigma_rad: window.tilt_sigma_rad };
    window.layers.iter().enumerate().filter_map(layer).chain([0, 1].map(parallel)).collect()
}

/// The weak prior on an axis point of which the rig file says nothing.
fn axis_point_facts(camera: usize, d: &CameraDescription, model: &CameraModel, size_px: [f64; 2]) -> Vec<Fact> {
    let mut out = vec![];
    for (parameter, size) in [(2, size_px[0]), (3, size_px[1])] {
        let stated = d.known.iter().any(|(p, _)| index(*p) == parameter);
        if model.free[parameter] && !stated {
            let sigma = AXIS_POINT_SIGMA * size_px[0];
            out.push(Fact::Intrinsic { camera, parameter, value: (size - 1.0) / 2.0, sigma });
        }
    }
    out
}
