//! A problem as plain text: words and numbers separated by blanks, numbers read back to the bit.
//!
//! ```text
//! name NAME   radial 0|1 (1: distorted -> ideal)   loss none|huber|cauchy K
//! cameras N:       camera NAME, 10 flags (free), 10 intrinsics at the start, 10 at the optimum
//! motions N - 1:   cam_from_rig at the start, at the optimum (each rotation by rows, translation)
//! plane 0|1:       rig_from_plane at the start, at the optimum
//! target pair|bubbles|lattice N [x y level] x N, 3 flags, 3 lengths at the start, 3 at the optimum
//! offsets N, 4 sigmas, [4 x N at the start, 4 x N at the optimum, 4 x N sigmas of the optimum]
//! views N:         0|1 in the plane, z, then rig_from_target and 3 own lengths at the start, at the optimum
//! facts N:         intrinsic c k value sigma | baseline value sigma | shape k v|-1 value sigma
//!                  | focus c pitch tilt_sigma 0|1 focal_length sigma
//! images N:        view camera scale discs pairs points; disc j n [u v sigma] x n;
//!                  pair j0 j1 n [kept] x n [u v] x n rank, whitening matrix by rows,
//!                  0|1 follows the lens [10 intrinsics, 2 n x 10 derivative by rows];
//!                  [j u v sigma] x points
//! optimum cost decrement iterations
//! covariance N [names] N x N numbers
//! ```
//! Natural frames throughout: lens frames of the cameras, poses against the first lens. Covariance of the plane: of `(a, b, c) = n / d`
//! in place of its steps, since the axes within the plane are a choice of the solver.

use crate::problems::Case;
use nalgebra::{DMatrix, Vector3};
use spivcal::bundle::{
    AdjustOptions, Adjustment, CameraModel, Fact, ImageObservations, Loss, Model, NamedCovariance, PlanePosition,
    SolveOptions, State, TargetShape, ViewPlace, adjust, named_covariance,
};
use spivcal::camera::{Camera, Intrinsics, Radial};
use spivcal::frames::{Cam, Rig, Sheet, Target};
use spivcal::rigid::Motion;
use std::fmt::Write;
use std::path::Path;

/// The state in natural frames.
pub struct Natural {
    pub cam_from_rig: Vec<Motion<Cam, Rig>>,
    pub rig_from_plane: Option<Motion<Rig, Sheet>>,
    pub rig_from_target: Vec<Motion<Rig, Target>>,
}

/// Turns the solver's frame of a camera into its lens frame.
pub fn lens_from_solver<A, B>(model: &CameraModel, intrinsics: &Intrinsics) -> Motion<A, B> {
    // The pinhole chart is in use where f and both tilts are free.
    if model.free[0] && model.free[4] && model.free[5] {
        Motion::new(Camera::new(*intrinsics).expect("a camera").cam_from_pinhole(), Vector3::zeros())
    } else {
        Motion::identity()
    }
}

impl Natural {
    pub fn of(model: &Model, state: &State) -> Self {
        let e0: Motion<Rig, Rig> = lens_from_solver(&model.cameras[0], &state.cameras[0]);
        let motion = |c: usize| {
            let e: Motion<Cam, Cam> = lens_from_solver(&model.cameras[c], &state.cameras[c]);
            e * state.camera_from_first[c] * e0.inverse()
        };
        Self {
            cam_from_rig: (1..state.cameras.len()).map(motion).collect(),
            rig_from_plane: state.first_from_plane.map(|p| e0 * p),
            rig_from_target: state.views.iter().map(|v| e0 * v.first_from_target).collect(),
        }
    }
}

/// The library's answer: no rescaled sigmas, no outliers set aside, so that the cost stays the one that is written.
pub fn solved(case: &Case) -> Adjustment {
    let solve = SolveOptions { decrement: 1e-9, iterations: 300 };
    let options = AdjustOptions { solve, rounds: 0, ..AdjustOptions::default() };
    let out = adjust(&case.model, case.start.clone(), &options, &mut |_| true);
    assert!(out.decrement < 1e-7, "{}: {} at decrement {}", case.name, out.termination.word(), out.decrement);
    out
}

#[derive(Default)]
struct Words(String);

impl Words {
    fn word(&mut self, w: impl std::fmt::Display) -> &mut Self {
        let _ = write!(self.0, "{w} ");
        self
    }
    fn numbers<'a>(&mut self, all: impl IntoIterator<Item = &'a f64>) -> &mut Self {
        for x in all {
            let _ = write!(self.0, "{x:e} ");
        }
        self
    }
    fn flags(&mut self, all: &[bool]) -> &mut Self {
        all.iter().for_each(|f| {
            self.word(u8::from(*f));
        });
        self
    }
    fn motion<A, B>(&mut self, m: &Motion<A, B>) -> &mut Self {
        self.numbers(m.rotation.transpose().iter()).numbers(m.translation_mm.iter())
    }
    fn line(&mut self) {
        self.0.push('\n');
    }
}

/// The problem with the library's answer and its covariance.
pub fn write(case: &Case, dir: &Path) {
    written(case, dir, true);
}

/// The same with an empty covariance: that of hundreds of poses would outgrow the problem.
pub fn write_start(case: &Case, dir: &Path) {
    written(case, dir, false);
}

fn written(case: &Case, dir: &Path, with_covariance: bool) {
    let solution = solved(case);
    let mut out = Words::default();
    head(&mut out, case);
    state(&mut out, case, &solution, with_covariance);
    facts(&mut out, &case.model);
    out.word("images").word(case.model.images.len()).line();
    case.model.images.iter().for_each(|i| image(&mut out, i));
    out.word("optimum").numbers(&[solution.cost, solution.decrement]).word(solution.iterations).line();
    match with_covariance {
        true => covariance(&mut out, &named_covariance(&solution).expect("a covariance")),
        false => out.word("covariance 0").line(),
    }
    std::fs::write(dir.join(format!("{}.problem", case.name)), out.0).expect("problem file");
    println!(
        "{:22} cost {:.6} decrement {:.1e} iterations {}",
        case.name, solution.cost, solution.decrement, solution.iterations
    );
}

fn head(out: &mut Words, case: &Case) {
    let radial = case.start.cameras[0].radial == Radial::DistortedToIdeal;
    out.word("name").word(case.name).word("radial").flags(&[radial]).word("loss");
    match case.model.loss {
        Loss::None => out.word("none 0"),
        Loss::Huber(k) => out.word("huber").numbers(&[k]),
        Loss::Cauchy(k) => out.word("cauchy").numbers(&[k]),
    };
    out.line();
}

fn state(out: &mut Words, case: &Case, solution: &Adjustment, with_covariance: bool) {
    let (model, a, b) = (&case.model, &case.start, &solution.state);
    let (na, nb) = (Natural::of(model, a), Natural::of(model, b));
    out.word("cameras").word(model.cameras.len()).line();
    for (c, camera) in model.cameras.iter().enumerate() {
        out.word("camera").word(&camera.name).flags(&camera.free);
        out.numbers(&a.cameras[c].to_array()).numbers(&b.cameras[c].to_array()).line();
    }
    out.word("motions").word(na.cam_from_rig.len()).line();
    na.cam_from_rig.iter().zip(&nb.cam_from_rig).for_each(|(a, b)| out.motion(a).motion(b).line());
    out.word("plane").flags(&[na.rig_from_plane.is_some()]);
    na.rig_from_plane.iter().chain(&nb.rig_from_plane).for_each(|m| {
        out.motion(m);
    });
    out.line();
    out.word("target");
    match &model.target.shape {
        TargetShape::Pair { per_view } => out.word(if *per_view { "bubbles" } else { "pair" }),
        TargetShape::Lattice(nodes) => {
            let numbers: Vec<f64> = nodes.iter().flat_map(|n| [n.x, n.y, n.level]).collect();
            out.word("lattice").word(nodes.len()).numbers(&numbers)
        }
    };
    out.flags(&model.target.free).numbers(&a.shape_mm).numbers(&b.shape_mm).line();
    let offsets = if model.target.offset_sigma_mm.is_some() { a.offsets_mm.len() } else { 0 };
    out.word("offsets").word(offsets).numbers(&model.target.offset_sigma_mm.unwrap_or_default());
    if offsets > 0 {
        let sigmas = match with_covariance {
            true => named_covariance(solution).expect("a covariance").offset_sigmas_mm,
            false => vec![[0.0; 4]; offsets],
        };
        [&a.offsets_mm, &b.offsets_mm, &sigmas].iter().for_each(|o| {
            out.numbers(o.iter().flatten());
        });
    }
    out.line();
    out.word("views").word(model.views.len()).line();
    for (v, view) in model.views.iter().enumerate() {
        match view.place {
            ViewPlace::Free => out.word("0 0"),
            ViewPlace::InPlane { z_mm, known: PlanePosition::Exact } => out.word(1).numbers(&[z_mm]),
            ViewPlace::InPlane { .. } => panic!("the text has no place for an uncertain position on a traverse"),
        };
        out.motion(&na.rig_from_target[v]).numbers(&a.views[v].shape_mm);
        out.motion(&nb.rig_from_target[v]).numbers(&b.views[v].shape_mm).line();
    }
}

fn facts(out: &mut Words, model: &Model) {
    out.word("facts").word(model.facts.len()).line();
    for fact in &model.facts {
        match fact {
            Fact::Intrinsic { camera, parameter, value, sigma } => {
                out.word("intrinsic").word(camera).word(parameter).numbers(&[*value, *sigma])
            }
            Fact::Baseline { value_mm, sigma_mm } => out.word("baseline").numbers(&[*value_mm, *sigma_mm]),
            Fact::Shape { parameter, view, value_mm, sigma_mm } => {
                let view = view.map_or(-1, |v| v as i64);
                out.word("shape").word(parameter).word(view).numbers(&[*value_mm, *sigma_mm])
            }
            Fact::Focus(f) => {
                let (length, sigma) = f.distance.unwrap_or_default();
                out.word("focus").word(f.camera).numbers(&[f.pixel_pitch_mm, f.tilt_sigma_rad]);
                out.flags(&[f.distance.is_some()]).numbers(&[length, sigma])
            }
            Fact::WindowLayer { .. } | Fact::WindowParallel { .. } => panic!("the text has no place for windows"),
        }
        .line();
    }
}

fn image(out: &mut Words, image: &ImageObservations) {
    out.word(image.view).word(image.camera).numbers(&[image.sigma_scale]);
    out.word(image.discs.len()).word(image.pairs.len()).word(image.points.disc.len()).line();
    for d in &image.discs {
        out.word("disc").word(d.disc).word(d.edge.u_px.len());
        for i in 0..d.edge.u_px.len() {
            out.numbers(&[d.edge.u_px[i], d.edge.v_px[i], d.edge.sigma_px[i]]);
        }
        out.line();
    }
    for p in &image.pairs {
        out.word("pair").word(p.discs[0]).word(p.discs[1]).word(p.kept.len());
        p.kept.iter().for_each(|k| {
            out.word(k);
        });
        out.numbers(&p.pixels_px).word(p.whitening.nrows()).numbers(p.whitening.transpose().iter());
        out.flags(&[p.lens.is_some()]);
        if let Some(lens) = &p.lens {
            out.numbers(&lens.intrinsics).numbers(lens.derivative.transpose().iter());
        }
        out.line();
    }
    let p = &image.points;
    for (i, disc) in p.disc.iter().enumerate() {
        out.word(disc).numbers(&[p.u_px[i], p.v_px[i], p.sigma_px[i]]).line();
    }
}

/// Derivative of `(a, b, c) = n / d` by a turn w and a shift v of the plane: `(w x n) / d - n (n . v) / d^2`.
fn plane_rows(plane: &Motion<Rig, Sheet>) -> Vec<Vec<(String, f64)>> {
    let n: Vector3<f64> = plane.rotation.column(2).into_owned();
    let d = n.dot(&plane.translation_mm);
    let step = |s: &str| format!("sheet.rig_from_sheet.{s}");
    (0..3)
        .map(|r| {
            let turn = (0..3).map(|k| Vector3::ith(k, 1.0).cross(&n)[r] / d);
            let shift = (0..3).map(|k| -n[r] * n[k] / (d * d));
            let names = ["rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"].map(step);
            names.into_iter().zip(turn.chain(shift)).collect()
        })
        .collect()
}

fn covariance(out: &mut Words, covariance: &NamedCovariance) {
    let steps = |n: &&String| !n.starts_with("sheet.");
    let mut names: Vec<String> = covariance.names.iter().filter(steps).cloned().collect();
    let mut rows: Vec<Vec<(String, f64)>> = names.iter().map(|n| vec![(n.clone(), 1.0)]).collect();
    if let Some(plane) = &covariance.natural.rig_from_plane {
        names.extend(["a_per_mm", "b_per_mm", "c_per_mm"].map(|n| format!("sheet.{n}")));
        rows.extend(plane_rows(plane));
    }
    let matrix: DMatrix<f64> = covariance.propagate(&rows);
    out.word("covariance").word(names.len());
    names.iter().for_each(|n| {
        out.word(n);
    });
    out.line();
    out.numbers(matrix.iter()).line();
}
