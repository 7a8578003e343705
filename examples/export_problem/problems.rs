//! The problems: each a model with noisy observations and a start some way off.

use crate::rig_scene::{Grid, Noise, Parts, Scene, tilted_camera, with_tangents};
use nalgebra::Vector3;
use spivcal::bitangent::ExternalUse;
use spivcal::bundle::{Fact, Focus, Loss, Model, PlanePosition, State, TargetShape, ViewPlace, pair_features};
use spivcal::camera::{Camera, Radial};
use spivcal::frames::{Rig, Sheet, Target};
use spivcal::rigid::Motion;

pub struct Case {
    pub name: &'static str,
    pub model: Model,
    pub start: State,
}

const SEED: u64 = 4;

fn noisy(per_view: bool, plane: bool, points: bool) -> Scene {
    Scene::build(SEED, per_view, plane, points).with_noise(SEED)
}

fn case(name: &'static str, scene: Scene) -> Case {
    let start = scene.perturbed_by(SEED, 0.5);
    Case { name, model: scene.model, start }
}

/// What the first camera alone sees.
fn mono_case(name: &'static str, scene: Scene) -> Case {
    let mut case = case(name, scene);
    case.model.cameras.truncate(1);
    case.model.images.retain(|i| i.camera == 0);
    case.model.facts.retain(|f| matches!(f, Fact::Intrinsic { camera: 0, .. }));
    case.start.cameras.truncate(1);
    case.start.camera_from_first.truncate(1);
    case
}

/// Every 17th edge point moved off by up to 15 sigmas: what a robust loss is for.
fn with_outliers(mut scene: Scene, loss: Loss) -> Scene {
    let mut noise = Noise::new(99);
    for edge in scene.model.images.iter_mut().flat_map(|i| &mut i.discs).map(|d| &mut d.edge) {
        for i in (0..edge.u_px.len()).step_by(17) {
            edge.u_px[i] += 15.0 * edge.sigma_px[i] * (noise.uniform() - 0.5);
            edge.v_px[i] += 15.0 * edge.sigma_px[i] * (noise.uniform() - 0.5);
        }
    }
    scene.model.loss = loss;
    scene
}

/// Every fifth point moved off.
fn points_with_outliers(mut scene: Scene) -> Scene {
    let mut noise = Noise::new(98);
    for p in scene.model.images.iter_mut().map(|i| &mut i.points) {
        for i in (0..p.disc.len()).step_by(5) {
            p.u_px[i] += 8.0 * p.sigma_px[i] * (noise.uniform() - 0.5);
        }
    }
    scene.model.loss = Loss::Huber(1.5);
    scene
}

fn two_cameras() -> Vec<Camera> {
    vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)]
}

fn with_focus(mut scene: Scene) -> Scene {
    scene.model.facts.extend([Some((50.0, 0.005)), None].iter().enumerate().map(|(camera, distance)| {
        Fact::Focus(Focus { camera, pixel_pitch_mm: 0.00625, tilt_sigma_rad: 5e-3, distance: *distance })
    }));
    scene
}

/// f of the left camera fixed (lens chart on that side), priors on tilt and distortion of both.
fn fixed_f() -> Case {
    let mut scene = noisy(false, true, false);
    scene.model.cameras[0].free[0] = false;
    for (camera, tilt) in [(0, -0.1107), (1, 0.1107)] {
        scene.model.facts.push(Fact::Intrinsic { camera, parameter: 5, value: tilt + 0.002, sigma: 0.003 });
        scene.model.facts.push(Fact::Intrinsic { camera, parameter: 6, value: -0.25, sigma: 0.1 });
    }
    let mut case = case("fixed_f", scene);
    case.start = in_lens_frame(case.start);
    case
}

/// The lens chart of the first camera holds poses in its lens frame.
fn in_lens_frame(mut state: State) -> State {
    let camera = Camera::new(state.cameras[0]).expect("a camera");
    let turn: Motion<Rig, Rig> = Motion::new(camera.cam_from_pinhole(), Vector3::zeros());
    state.camera_from_first.iter_mut().skip(1).for_each(|m| *m = *m * turn.inverse());
    state.first_from_plane.iter_mut().for_each(|m| *m = turn * *m);
    state.views.iter_mut().for_each(|v| v.first_from_target = turn * v.first_from_target);
    state
}

/// Every intrinsic of both cameras free, the weak ones with priors.
fn with_all_intrinsics() -> Scene {
    let camera = |tilt: f64, alpha: f64| {
        let mut i = *tilted_camera(tilt, alpha).intrinsics();
        (i.aspect, i.k[1], i.pupil_ratio) = (1.003, 2.0, 1.02);
        Camera::new(i).unwrap()
    };
    let cameras = vec![camera(-0.1107, 0.01), camera(0.1107, -0.02)];
    let mut scene = Scene::with_cameras(SEED, cameras, false, true, false).with_noise(SEED);
    for camera in 0..2 {
        scene.model.cameras[camera].free = [true; 10];
        for (parameter, value, sigma) in [(1, 1.0, 0.01), (7, 0.0, 5.0), (8, 0.0, 50.0), (9, 1.0, 0.05)] {
            scene.model.facts.push(Fact::Intrinsic { camera, parameter, value, sigma });
        }
    }
    scene
}

/// The polynomial from distorted to ideal points.
fn photogrammetric() -> Scene {
    let camera = |tilt: f64, alpha: f64| {
        let mut i = *tilted_camera(tilt, alpha).intrinsics();
        i.radial = Radial::DistortedToIdeal;
        Camera::new(i).unwrap()
    };
    let cameras = vec![camera(-0.1107, 0.01), camera(0.1107, -0.02)];
    Scene::with_cameras(SEED, cameras, false, true, false).with_noise(SEED)
}

fn parts(plane: bool, points: bool) -> Parts {
    Scene::parts(SEED, vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)], false, plane, points)
}

/// Two discs on a traverse whose steps are the only length: the spacing is free, three views at known depths.
fn traverse() -> Case {
    let mut parts = parts(true, false);
    let sheet = parts.rig_from_sheet.expect("a sheet");
    let own = parts.views[4].rig_from_target;
    for (v, z_mm) in [(3, 1.5), (4, 0.0), (5, -1.5)] {
        parts.views[v].place = ViewPlace::InPlane { z_mm, known: PlanePosition::Exact };
        let from = if v == 3 { own } else { parts.views[v].rig_from_target };
        let mut planar: Motion<Sheet, Target> = sheet.inverse() * from;
        planar.translation_mm.z = z_mm;
        parts.views[v].rig_from_target = sheet * planar;
    }
    parts.target.free[0] = true;
    case("traverse", parts.scene().with_noise(SEED))
}

/// A perfect grid in place of one with every disc estimated.
fn perfect_grid(plane: bool) -> Scene {
    let mut parts = parts(plane, true);
    parts.offsets_mm.clear();
    parts.target.offset_sigma_mm = None;
    parts.scene().with_noise(SEED)
}

/// What other programs calibrate too: one camera, a perfect grid of known pitch, axis point held; f, tilts and k1 free.
fn plain_grid() -> Case {
    let mut scene = perfect_grid(false);
    (scene.model.cameras[0].free[2], scene.model.cameras[0].free[3]) = (false, false);
    let mut case = mono_case("plain_grid", scene);
    case.model.facts.clear();
    (case.start.cameras[0].cx_px, case.start.cameras[0].cy_px) = (520.0, 380.0);
    case
}

/// Features found through the lens of the start, with how they follow another lens.
fn through_the_lens() -> Case {
    let mut case = case("tangents_through_lens", noisy(false, true, false));
    for image in &mut case.model.images {
        let camera = Camera::new(case.start.cameras[image.camera]).expect("a camera");
        image.pairs = vec![pair_features(&camera, [&image.discs[0], &image.discs[1]]).expect("separated discs")];
        image.discs.clear();
    }
    case
}

/// Two cameras, `views` views of two discs (of a grid of dots), all poses free, so many edge points per disc.
fn many_views(views: usize, grid: Option<Grid>, edge_points: i32) -> Scene {
    let some = |seed: u64| {
        let scene = match grid {
            Some(grid) => Scene::with_grid(seed, two_cameras(), grid, false),
            None => Scene::build(seed, false, false, false),
        };
        scene.with_edge_points(edge_points).with_noise(seed)
    };
    let mut out = some(SEED);
    for seed in SEED + 1.. {
        if out.truth.views.len() >= views {
            break;
        }
        append(&mut out, some(seed));
    }
    shorten(&mut out, views);
    out
}

/// Two cameras, `views` views of a perfect lattice of points over about 40 x 30 mm; truth offsets are none.
fn many_points(points: usize, views: usize, estimated: bool) -> Scene {
    // A lattice as near to a square as the number of points allows.
    let rows = (1..=points).filter(|r| points.is_multiple_of(*r) && 2 * r * r <= 3 * points).max().unwrap_or(1);
    let columns = points / rows;
    let pitch_mm = 40.0 / columns as f64;
    let (columns, rows) = (columns as i32, rows as i32);
    let grid = Grid { columns, rows, pitch_mm, radius_mm: 0.3 * pitch_mm, print_error_mm: 0.0, turn: 1.0 };
    let mut out: Option<Scene> = None;
    for seed in SEED..SEED + views.div_ceil(6) as u64 {
        let cameras = two_cameras();
        let more = Scene::with_grid_unseen(seed, cameras, grid, estimated).seen_as_points(seed);
        match &mut out {
            None => out = Some(more),
            Some(out) => append(out, more),
        }
    }
    let mut out = out.expect("views");
    shorten(&mut out, views);
    out
}

/// Adds the views of a scene behind those of another.
fn append(out: &mut Scene, more: Scene) {
    let first = out.truth.views.len();
    out.truth.views.extend(more.truth.views);
    out.model.views.extend(more.model.views);
    out.model.images.extend(more.model.images.into_iter().map(|mut i| {
        i.view += first;
        i
    }));
}

fn shorten(out: &mut Scene, views: usize) {
    out.truth.views.truncate(views);
    out.model.views.truncate(views);
    out.model.images.retain(|i| i.view < views);
}

/// 25 dots of 5 mm, perfect.
const DOTS: Grid = Grid { columns: 5, rows: 5, pitch_mm: 8.0, radius_mm: 2.5, print_error_mm: 0.0, turn: 1.0 };

/// A problem of the benchmark; their names are `KIND_2xVIEWS` with KIND `tangents` (14 features of two discs per image), `contours`
/// (two discs of 50 edge points), `grid` (25 dots of 40 edge points), `pointsN` (a lattice of N points), `freeN` (the same, each point estimated
/// with 0.02 mm beforehand).
pub fn timed(name: &str) -> Option<Case> {
    let (kind, views) = name.split_once("_2x")?;
    let views = views.parse().ok()?;
    let name = Box::leak(name.to_string().into_boxed_str());
    let count = |prefix: &str| kind.strip_prefix(prefix)?.parse::<usize>().ok();
    if let Some(points) = count("points") {
        return Some(case(name, many_points(points, views, false)));
    }
    if let Some(points) = count("free") {
        let mut case = case(name, many_points(points, views, true));
        case.model.target.offset_sigma_mm = Some([0.02; 4]);
        return Some(case);
    }
    match kind {
        "tangents" => {
            let case = case(name, many_views(views, None, 40));
            Some(Case { model: with_tangents(case.model, ExternalUse::Never), ..case })
        }
        "contours" => Some(case(name, many_views(views, None, 50))),
        "grid" => Some(case(name, many_views(views, Some(DOTS), 40))),
        _ => None,
    }
}

pub fn all() -> Vec<Case> {
    let tangents = |case: Case| {
        // The external tangents of equal discs meet at infinity on the target, wherever they meet in the image.
        let equal = matches!(case.model.target.shape, TargetShape::Lattice(_));
        let external = if equal { ExternalUse::Never } else { ExternalUse::WhereMeasurable };
        Case { model: with_tangents(case.model, external), ..case }
    };
    let dots = || Scene::with_grid(SEED, two_cameras(), DOTS, false).seen_as_points(SEED);
    let huber = |k: f64| with_outliers(noisy(false, true, false), Loss::Huber(k));
    let mut robust_tangents = tangents(case("robust_tangents", noisy(false, true, false)));
    robust_tangents.model.loss = Loss::Huber(0.8);
    vec![
        mono_case("mono", noisy(false, false, false)),
        case("stereo", noisy(false, false, false)),
        case("joint_sheet", noisy(false, true, false)),
        case("joint_sheet_focus", with_focus(noisy(false, true, false))),
        case("bubbles", noisy(true, true, false)),
        case("bubbles_focus", with_focus(noisy(true, true, false))),
        case("grid", noisy(false, false, true)),
        plain_grid(),
        fixed_f(),
        case("all_intrinsics", with_all_intrinsics()),
        case("all_intrinsics_focus", with_focus(with_all_intrinsics())),
        case("photogrammetric", photogrammetric()),
        traverse(),
        case("huber", huber(2.0)),
        case("cauchy", with_outliers(noisy(false, true, false), Loss::Cauchy(3.0))),
        tangents(mono_case("mono_tangents", noisy(false, false, false))),
        tangents(case("stereo_tangents", noisy(false, false, false))),
        tangents(case("joint_sheet_tangents", noisy(false, true, false))),
        tangents(case("bubbles_tangents", noisy(true, true, false))),
        tangents(case("grid_tangents", perfect_grid(true))),
        robust_tangents,
        through_the_lens(),
        case("points", dots()),
        case("points_huber", points_with_outliers(dots())),
        case("points_estimated", Scene::build(SEED, false, false, true).seen_as_points(SEED)),
    ]
}
