//! A synthetic rig with exact contours of two discs: the paper's geometry (50 mm lens, 500 mm, 45 degrees, 6.25 um).

#![allow(dead_code, unused_imports, clippy::expect_used, clippy::unwrap_used, clippy::panic)]

use nalgebra::{DMatrix, Vector2, Vector3};
use spivcal::bitangent::{EXTERNAL_CROSSING, ExternalUse, POINTS, bitangents};
use spivcal::bundle::{
    CameraModel, DiscObservation, Fact, ImageObservations, Loss, Model, Node, PairObservation, PlanePosition,
    PointObservations, State, TargetModel, TargetShape, ViewModel, ViewPlace, ViewState,
};
use spivcal::camera::{Camera, Intrinsics, Radial};
use spivcal::conic::{fit_direct, fit_geometric};
use spivcal::detect::EdgePoints;
use spivcal::frames::{Cam, Rig, Sheet, Target};
use spivcal::rig::{CameraStart, OpenLabels, RigProblem};
use spivcal::rigid::{Motion, rotation_exp};

mod diagnosed;
mod reference;
mod scatter;

pub(crate) use diagnosed::{adjusted, diagnosed, diagnosed_while, drawn};
pub(crate) use reference::{Draw, Problem};
pub(crate) use scatter::{
    Bound, QUANTITIES, Run, Summary, TWO_SIDED_95, TWO_SIDED_995, band, camera_covariance, camera_numbers, disparities,
    given_sigmas, grid, moved, nees, solved, together, true_stereo,
};

const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// Finaliser of splitmix64: a bijection that spreads every bit over all others.
fn mixed(x: u64) -> u64 {
    let mut z = x.wrapping_add(STEP);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Small seeded generator (splitmix64) with normal numbers.
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self::stream(seed, 0)
    }
    /// A stream of its own for each seed and purpose. The state of splitmix64 walks by equal steps through all numbers, so that
    /// states a few steps apart would share their draws: seed and purpose are mixed over all bits first.
    pub(crate) fn stream(seed: u64, purpose: u64) -> Self {
        Self(mixed(mixed(seed ^ 0x1234_5678_9abc_def0).wrapping_add(purpose)))
    }
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(STEP);
        (mixed(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }
    pub(crate) fn normal(&mut self) -> f64 {
        let u = self.uniform().max(1e-300);
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) model: Model,
    pub(crate) cameras: Vec<Camera>,
    pub(crate) truth: State,
}

pub(crate) fn tilted_camera(tilt_beta: f64, tilt_alpha: f64) -> Camera {
    let mut i = Intrinsics::pinhole(8889.0, 520.0, 380.0);
    (i.beta_rad, i.alpha_rad, i.k[0]) = (tilt_beta, tilt_alpha, -0.3);
    Camera::new(i).unwrap()
}

/// A view of [`Parts`].
#[derive(Clone, Copy)]
pub(crate) struct PartView {
    pub(crate) place: ViewPlace,
    pub(crate) rig_from_target: Motion<Rig, Target>,
    pub(crate) shape_mm: [f64; 3],
}

/// A grid of dots about the target's origin.
#[derive(Clone, Copy)]
pub(crate) struct Grid {
    pub(crate) columns: i32,
    pub(crate) rows: i32,
    pub(crate) pitch_mm: f64,
    pub(crate) radius_mm: f64,
    pub(crate) print_error_mm: f64,
    /// How much the views differ in tilt, turn and place: 1 as a hand holds it, 0 as on a traverse.
    pub(crate) turn: f64,
}

impl Grid {
    fn nodes(&self) -> Vec<Node> {
        let (c, r) = (self.columns, self.rows);
        let node = |k: i32| Node { x: f64::from(k % c - c / 2), y: f64::from(k / c - r / 2), level: 0.0 };
        (0..c * r).map(node).collect()
    }
}

/// What a scene is made of, in lens frames.
#[derive(Clone)]
pub(crate) struct Parts {
    pub(crate) cameras: Vec<Camera>,
    pub(crate) cam_from_rig: Motion<Cam, Rig>,
    pub(crate) rig_from_sheet: Option<Motion<Rig, Sheet>>,
    pub(crate) views: Vec<PartView>,
    pub(crate) target: TargetModel,
    pub(crate) shape_mm: [f64; 3],
    pub(crate) offsets_mm: Vec<[f64; 4]>,
    pub(crate) facts: Vec<Fact>,
    pub(crate) free: [bool; 10],
}

/// The grid of scenes whose every dot is estimated.
const THREE_BY_THREE: Grid =
    Grid { columns: 3, rows: 3, pitch_mm: 8.0, radius_mm: 2.5, print_error_mm: 0.01, turn: 1.0 };

impl Parts {
    /// Six views, parallel to the sheet at the positions given, mm; `None`: anywhere.
    fn of(
        seed: u64,
        cameras: Vec<Camera>,
        grid: Option<Grid>,
        per_view: bool,
        points: bool,
        position: &dyn Fn(usize) -> Option<f64>,
    ) -> Self {
        let plane = (0..6).any(|v| position(v).is_some());
        let mut noise = Noise::new(seed);
        // The sheet 500 mm away, seen under 45 degrees from either side.
        let rig_from_sheet: Motion<Rig, Sheet> = Motion::new(
            rotation_exp(&Vector3::new(0.0, -45_f64.to_radians(), 0.0))
                * rotation_exp(&Vector3::new(std::f64::consts::PI, 0.0, 0.0)),
            Vector3::new(0.0, 0.0, 500.0),
        );
        let right_from_sheet: Motion<Cam, Sheet> = Motion::new(
            rotation_exp(&Vector3::new(0.0, 45_f64.to_radians(), 0.0))
                * rotation_exp(&Vector3::new(std::f64::consts::PI, 0.0, 0.0)),
            Vector3::new(1.0, -2.0, 503.0),
        );
        let cam_from_rig = right_from_sheet * rig_from_sheet.inverse();
        let shape_mm = grid.map_or([13.0, 6.0, 4.7], |g| [g.pitch_mm, g.radius_mm, 0.0]);
        let lattice = grid.is_some();
        let turning = grid.map_or(1.0, |g| g.turn);
        let mut views = vec![];
        for v in 0..6 {
            let (z, in_plane) = (position(v).unwrap_or(0.0), position(v).is_some());
            let turn = if in_plane { [0.0, 0.0] } else { [0.45, 0.45].map(|t| turning * t * (noise.uniform() - 0.5)) };
            let spin = turning * 3.0 * (noise.uniform() - 0.5);
            let aside = [4.0 * turning * noise.normal(), 2.0 * turning * noise.normal()];
            let shift = [-6.0 + aside[0], aside[1], if in_plane { z } else { 2.0 * noise.normal() }];
            let rotation =
                rotation_exp(&Vector3::new(turn[0], turn[1], 0.0)) * rotation_exp(&Vector3::new(0.0, 0.0, spin));
            let sheet_from_target: Motion<Sheet, Target> =
                Motion::new(rotation, Vector3::from(shift) + rotation * Vector3::new(0.0, 0.0, 0.0));
            let own = [shape_mm[0] + noise.uniform(), shape_mm[1] - noise.uniform(), shape_mm[2] - noise.uniform()];
            views.push(PartView {
                place: if in_plane {
                    ViewPlace::InPlane { z_mm: z, known: PlanePosition::Exact }
                } else {
                    ViewPlace::Free
                },
                rig_from_target: rig_from_sheet * sheet_from_target,
                shape_mm: if per_view { own } else { shape_mm },
            });
        }
        let nodes = grid.map(|g| g.nodes());
        let count = nodes.as_ref().map_or(0, Vec::len);
        let shape = nodes.map_or(TargetShape::Pair { per_view }, TargetShape::Lattice);
        let error = grid.map_or(0.0, |g| g.print_error_mm);
        let offsets_mm = if points {
            (0..count).map(|_| [error * noise.normal(), error * noise.normal(), 0.0, 0.0]).collect()
        } else {
            vec![]
        };
        let mut free = [true; 10];
        (free[1], free[7], free[8], free[9]) = (false, false, false, false);
        let target = TargetModel {
            shape,
            free: [per_view, true, !lattice],
            offset_sigma_mm: points.then_some([0.02, 0.02, 0.02, 0.01]),
            oval_sigma_mm: None,
        };
        let mut facts = vec![];
        for camera in 0..2 {
            for (parameter, value) in [(2, 520.0), (3, 380.0)] {
                facts.push(Fact::Intrinsic { camera, parameter, value, sigma: 50.0 });
            }
        }
        if per_view {
            facts.push(Fact::Baseline { value_mm: cam_from_rig.translation_mm.norm(), sigma_mm: 0.01 });
        }
        Parts {
            views,
            cameras,
            cam_from_rig,
            rig_from_sheet: plane.then_some(rig_from_sheet),
            target,
            shape_mm,
            offsets_mm,
            facts,
            free,
        }
    }

    /// Two discs of known spacing in views parallel to the sheet at these positions, mm.
    pub(crate) fn at_positions(seed: u64, cameras: Vec<Camera>, position: &dyn Fn(usize) -> Option<f64>) -> Self {
        Self::of(seed, cameras, None, false, false, position)
    }

    /// The scene with exact contours.
    pub(crate) fn scene(&self) -> Scene {
        self.scene_of(EDGE_POINTS)
    }

    /// The same with so many edge points per disc.
    fn scene_of(&self, edge_points: i32) -> Scene {
        let model = Model {
            cameras: ["left", "right"]
                .map(|n| CameraModel { name: n.into(), free: self.free, window: None, axis_frame: false })
                .into(),
            target: self.target.clone(),
            views: self.views.iter().map(|v| ViewModel { place: v.place }).collect(),
            facts: self.facts.clone(),
            images: vec![],
            loss: Loss::None,
        };
        // In the solver poses live in the frame of the pinhole along the sensor normal, where f and the tilts are free.
        let pinhole = self.free[0] && self.free[4] && self.free[5];
        let turn = |c: usize| if pinhole { self.cameras[c].cam_from_pinhole() } else { nalgebra::Matrix3::identity() };
        let e: Motion<Cam, Cam> = Motion::new(turn(1), Vector3::zeros());
        let e0: Motion<Rig, Rig> = Motion::new(turn(0), Vector3::zeros());
        let in_plane = |v: &PartView| matches!(v.place, ViewPlace::InPlane { .. });
        let view = |v: &PartView| ViewState {
            first_from_target: e0.inverse() * v.rig_from_target,
            plane_from_target: self.rig_from_sheet.filter(|_| in_plane(v)).map(|p| p.inverse() * v.rig_from_target),
            shape_mm: v.shape_mm,
        };
        let truth = State {
            cameras: self.cameras.iter().map(|c| *c.intrinsics()).collect(),
            camera_from_first: vec![Motion::identity(), e.inverse() * self.cam_from_rig * e0],
            first_from_plane: self.rig_from_sheet.map(|p| e0.inverse() * p),
            views: self.views.iter().map(view).collect(),
            shape_mm: self.shape_mm,
            offsets_mm: self.offsets_mm.clone(),
            ovals_mm: vec![],
            slopes: vec![],
            windows: vec![],
        };
        let mut scene = Scene { model, cameras: self.cameras.clone(), truth };
        for (v, view) in self.views.iter().enumerate() {
            for (c, camera) in self.cameras.iter().enumerate() {
                let cam_from_target: Motion<Cam, Target> = match c {
                    0 => Motion::new(view.rig_from_target.rotation, view.rig_from_target.translation_mm),
                    _ => self.cam_from_rig * view.rig_from_target,
                };
                let own = if self.target.per_view() { view.shape_mm } else { self.shape_mm };
                let shape = (&own, &self.offsets_mm[..], &[][..]);
                scene.model.images.push(image(&self.target, camera, &cam_from_target, shape, (v, c), edge_points));
            }
        }
        scene
    }
}

/// Edge points per disc and standard deviation of each coordinate of one, px: centres good to 0.0045 px. Rendered discs of this size
/// give 600 edge points of 0.017 px, centres good to 0.0008 px.
const EDGE_POINTS: i32 = 40;
pub(crate) const SIGMA_PX: f64 = 0.02;

impl Scene {
    /// Six views, the last two in one sheet when `plane`; bubbles when `per_view`; a free 3 x 3 grid when `points`.
    pub(crate) fn build(seed: u64, per_view: bool, plane: bool, points: bool) -> Self {
        Self::with_cameras(
            seed,
            vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)],
            per_view,
            plane,
            points,
        )
    }

    /// The same with other cameras at the same places.
    pub(crate) fn with_cameras(seed: u64, cameras: Vec<Camera>, per_view: bool, plane: bool, points: bool) -> Self {
        Self::parts(seed, cameras, per_view, plane, points).scene()
    }

    /// What such a scene is made of, to be changed before it is seen.
    pub(crate) fn parts(seed: u64, cameras: Vec<Camera>, per_view: bool, plane: bool, points: bool) -> Parts {
        let position = |v: usize| (plane && v >= 4).then_some(0.0);
        Parts::of(seed, cameras, points.then_some(THREE_BY_THREE), per_view, points, &position)
    }

    /// The same with a grid as the target, no view in the sheet; every dot estimated when `points`.
    pub(crate) fn with_grid(seed: u64, cameras: Vec<Camera>, grid: Grid, points: bool) -> Self {
        Parts::of(seed, cameras, Some(grid), false, points, &|_| None).scene()
    }

    /// The same with the last three views in the sheet.
    pub(crate) fn with_grid_in_sheet(seed: u64, cameras: Vec<Camera>, grid: Grid) -> Self {
        Parts::of(seed, cameras, Some(grid), false, false, &|v| (v >= 3).then_some(0.0)).scene()
    }

    /// What a scene with a grid is made of, to be changed before it is seen.
    pub(crate) fn grid_parts(seed: u64, cameras: Vec<Camera>, grid: Grid) -> Parts {
        Parts::of(seed, cameras, Some(grid), false, false, &|_| None)
    }

    /// The same without contours, for what [`Scene::seen_as_points`] adds; a prior on every dot when `estimated`, and no error of print.
    pub(crate) fn with_grid_unseen(seed: u64, cameras: Vec<Camera>, grid: Grid, estimated: bool) -> Self {
        Parts::of(seed, cameras, Some(grid), false, estimated, &|_| None).scene_of(0)
    }

    /// Two discs in views parallel to the sheet at the positions given, mm; `None`: anywhere.
    pub(crate) fn at_positions(seed: u64, cameras: Vec<Camera>, position: &dyn Fn(usize) -> Option<f64>) -> Self {
        Parts::at_positions(seed, cameras, position).scene()
    }

    /// The same scene with its discs moved by offsets (dx, dy, dz, dr), mm.
    pub(crate) fn with_offsets(&self, offsets: &[[f64; 4]]) -> Self {
        self.seen_anew(offsets, EDGE_POINTS)
    }

    /// The same scene with so many edge points per disc, exact again.
    pub(crate) fn with_edge_points(&self, points: i32) -> Self {
        self.seen_anew(&self.truth.offsets_mm, points)
    }

    /// Its plate bent: `surface` gives height (mm) and slopes at a place of the target (mm). Discs are circles in the surface.
    pub(crate) fn bent(&self, surface: &dyn Fn(f64, f64) -> [f64; 3]) -> Self {
        let at = |j: usize| self.model.target.nominal_disc(j, &self.truth.shape_mm).0;
        let bent: Vec<[f64; 3]> = (0..self.model.target.disc_count()).map(|j| surface(at(j).x, at(j).y)).collect();
        let heights: Vec<[f64; 4]> =
            bent.iter().zip(&self.truth.offsets_mm).map(|(b, o)| [o[0], o[1], o[2] + b[0], o[3]]).collect();
        let mut out = self.clone();
        out.truth.slopes = bent.iter().map(|b| [b[1], b[2]]).collect();
        let mut out = out.seen_anew(&heights, EDGE_POINTS);
        // Not for the adjustment, which starts here.
        out.truth.slopes.clear();
        out
    }

    fn seen_anew(&self, offsets: &[[f64; 4]], points: i32) -> Self {
        let mut out = self.clone();
        out.truth.offsets_mm = offsets.to_vec();
        let e: Vec<Motion<Cam, Cam>> =
            self.cameras.iter().map(|c| Motion::new(c.cam_from_pinhole(), Vector3::zeros())).collect();
        for seen in &mut out.model.images {
            let (v, c) = (seen.view, seen.camera);
            let view = &self.truth.views[v];
            let cam_from_target = e[c] * self.truth.camera_from_first[c] * view.first_from_target;
            let own = if self.model.target.per_view() { view.shape_mm } else { self.truth.shape_mm };
            let discs = (&own, offsets, &self.truth.slopes[..]);
            *seen = image(&self.model.target, &self.cameras[c], &cam_from_target, discs, (v, c), points);
        }
        out
    }

    /// The same scene seen as points, the centres of its discs, with noise.
    pub(crate) fn seen_as_points(&self, seed: u64) -> Self {
        let mut noise = Noise::stream(seed, 5);
        let mut out = self.clone();
        let e: Vec<Motion<Cam, Cam>> =
            self.cameras.iter().map(|c| Motion::new(c.cam_from_pinhole(), Vector3::zeros())).collect();
        for seen in &mut out.model.images {
            let (v, c) = (seen.view, seen.camera);
            let cam_from_target = e[c] * self.truth.camera_from_first[c] * self.truth.views[v].first_from_target;
            let per_view = self.model.target.per_view();
            let shape = if per_view { &self.truth.views[v].shape_mm } else { &self.truth.shape_mm };
            seen.discs.clear();
            for j in 0..self.model.target.disc_count() {
                let (mut center, _) = self.model.target.nominal_disc(j, shape);
                if let Some(o) = self.truth.offsets_mm.get(j) {
                    center += Vector3::new(o[0], o[1], o[2]);
                }
                let q: Vector2<f64> = self.cameras[c].project_xyz(&cam_from_target.apply(&center)).unwrap();
                seen.points.disc.push(j as u32);
                seen.points.u_px.push(q.x + SIGMA_PX * noise.normal());
                seen.points.v_px.push(q.y + SIGMA_PX * noise.normal());
                seen.points.sigma_px.push(SIGMA_PX);
            }
        }
        // Points know no radius.
        match &out.model.target.shape {
            TargetShape::Lattice(_) => out.model.target.free[1] = false,
            TargetShape::Pair { .. } => (out.model.target.free[1], out.model.target.free[2]) = (false, false),
        }
        out
    }

    /// What a calibration from nothing but contours has to start from.
    pub(crate) fn problem(&self) -> RigProblem {
        let ellipse = |d: &DiscObservation| fit_direct(&d.edge.u_px, &d.edge.v_px).unwrap();
        let mut values = [None; 10];
        (values[1], values[7], values[8], values[9]) = (Some(1.0), Some(0.0), Some(0.0), Some(1.0));
        let start = CameraStart {
            size_px: [1024.0, 768.0],
            nominal_f_px: None,
            values,
            radial: Radial::default(),
            design: None,
        };
        let lattice = matches!(self.model.target.shape, TargetShape::Lattice(_));
        let spacing = (!self.model.target.per_view()).then_some(self.truth.shape_mm[0]);
        RigProblem {
            ellipses: self.model.images.iter().map(|i| i.discs.iter().map(ellipse).collect()).collect(),
            starts: vec![start; 2],
            shape_mm: [spacing, None, lattice.then_some(0.0)],
            image_names: self.model.images.iter().map(|i| format!("view {} camera {}", i.view, i.camera)).collect(),
            model: self.model.clone(),
            open: OpenLabels::default(),
        }
    }

    /// The truth, moved by a start's worth of error.
    pub(crate) fn perturbed(&self, seed: u64) -> State {
        self.perturbed_by(seed, 1.0)
    }

    /// The truth, moved by `amount` of a start's worth of error.
    pub(crate) fn perturbed_by(&self, seed: u64, amount: f64) -> State {
        let mut noise = Noise::stream(seed, 3);
        let mut s = self.truth.clone();
        for c in &mut s.cameras {
            c.f_px *= 1.0 + amount * 0.01 * noise.normal();
            c.k[0] += amount * 0.1;
            c.cx_px += amount * 20.0 * noise.normal();
        }
        let mut small = |w: f64, t: f64| {
            nalgebra::SVector::<f64, 6>::from_fn(|k, _| amount * noise.normal() * if k < 3 { w } else { t })
        };
        s.camera_from_first[1] = s.camera_from_first[1].retract(&small(0.001, 0.3));
        if let Some(p) = &mut s.first_from_plane {
            *p = p.retract(&small(0.001, 0.3));
        }
        for v in &mut s.views {
            match (&v.plane_from_target, &s.first_from_plane) {
                (Some(q), Some(p)) => v.first_from_target = *p * *q,
                _ => v.first_from_target = v.first_from_target.retract(&small(0.001, 0.3)),
            }
        }
        s
    }

    /// The same scene with every fact drawn about what it states.
    pub(crate) fn with_facts_drawn(&self, noise: &mut Noise) -> Self {
        let mut out = self.clone();
        for fact in &mut out.model.facts {
            match fact {
                Fact::Intrinsic { value, sigma, .. } => *value += *sigma * noise.normal(),
                Fact::Baseline { value_mm, sigma_mm } | Fact::Shape { value_mm, sigma_mm, .. } => {
                    *value_mm += *sigma_mm * noise.normal();
                }
                _ => unreachable!("the scenes state no focus and no windows"),
            }
        }
        out
    }

    /// The same scene with noisy edge points.
    pub(crate) fn with_noise(&self, seed: u64) -> Self {
        let mut noise = Noise::stream(seed, 2);
        let mut out = self.clone();
        for edge in out.model.images.iter_mut().flat_map(|i| &mut i.discs).map(|d| &mut d.edge) {
            for i in 0..edge.u_px.len() {
                edge.u_px[i] += SIGMA_PX * noise.normal();
                edge.v_px[i] += SIGMA_PX * noise.normal();
            }
        }
        out
    }
}

fn image(
    target: &TargetModel,
    camera: &Camera,
    cam_from_target: &Motion<Cam, Target>,
    (shape, offsets, slopes): (&[f64; 3], &[[f64; 4]], &[[f64; 2]]),
    (view, index): (usize, usize),
    points: i32,
) -> ImageObservations {
    let disc = |j: usize| {
        let (mut center, mut radius) = target.nominal_disc(j, shape);
        if let Some(o) = offsets.get(j) {
            center += Vector3::new(o[0], o[1], o[2]);
            radius += o[3];
        }
        // Tangents of the surface, orthonormal.
        let [sx, sy] = slopes.get(j).copied().unwrap_or_default();
        let ex = Vector3::new(1.0, 0.0, sx).normalize();
        let ey = Vector3::new(-sx, -sy, 1.0).normalize().cross(&ex);
        let mut edge = EdgePoints::default();
        for k in 0..points {
            let (s, c) = (std::f64::consts::TAU * f64::from(k) / f64::from(points)).sin_cos();
            let q: Vector2<f64> =
                camera.project_xyz(&cam_from_target.apply(&(center + (ex * c + ey * s) * radius))).unwrap();
            edge.u_px.push(q.x);
            edge.v_px.push(q.y);
            edge.sigma_px.push(SIGMA_PX);
        }
        DiscObservation::new(j, edge)
    };
    ImageObservations {
        view,
        camera: index,
        discs: (0..target.disc_count()).map(disc).collect(),
        pairs: vec![],
        points: PointObservations::default(),
        sigma_scale: 1.0,
    }
}

/// Tangent features, whitened, in place of contours; neighbours along the rows of the 3 x 3 grid are pairs.
pub(crate) fn with_tangents(mut model: Model, external: ExternalUse) -> Model {
    let grid = matches!(model.target.shape, TargetShape::Lattice(_));
    for image in &mut model.images {
        let discs = std::mem::take(&mut image.discs);
        let pairs = discs.windows(2).filter(|w| !grid || w[0].disc / 3 == w[1].disc / 3);
        image.pairs = pairs.map(|w| pair(&w[0], &w[1], external)).collect();
    }
    model
}

fn pair(a: &DiscObservation, b: &DiscObservation, external: ExternalUse) -> PairObservation {
    let fit = |d: &DiscObservation| fit_geometric(&d.edge.u_px, &d.edge.v_px, &d.edge.sigma_px).unwrap();
    let (ea, eb) = (fit(a), fit(b));
    let tangents = bitangents(&ea.ellipse, &eb.ellipse).unwrap();
    let whitening = tangents.whitening([&ea.covariance, &eb.covariance], external).unwrap();
    let kept: Vec<usize> = (0..POINTS).filter(|&p| whitening.external || p != EXTERNAL_CROSSING).collect();
    let at = |j: usize| 2 * kept[j / 2] + j % 2;
    PairObservation {
        discs: [a.disc, b.disc],
        pixels_px: (0..2 * kept.len()).map(|j| tangents.points[at(j)]).collect(),
        whitening: DMatrix::from_fn(whitening.rank, 2 * kept.len(), |i, j| whitening.matrix[(i, at(j))]),
        lens: None,
        ovals: None,
        kept,
    }
}
