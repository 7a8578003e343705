//! Answers of other solvers, put into the library's own normal equations.
//!
//! `NAME.solution` holds, in natural frames: per camera 10 intrinsics; `cam_from_rig` of all but the first; `rig_from_plane`
//! where there is one; 3 shared lengths; per view `rig_from_target` and 3 own lengths; offsets where there are some; the cost.

use crate::problems::{Case, all};
use crate::text::lens_from_solver;
use nalgebra::{Matrix3, Vector3};
use spivcal::bundle::{Model, State, ViewPlace, ViewState, problem};
use spivcal::camera::Intrinsics;
use spivcal::frames::{Cam, Rig, Sheet, Target};
use spivcal::rigid::Motion;
use spivcal::solve::{Options, minimise};
use std::path::Path;
use std::process::ExitCode;

/// Newton decrement, in sigmas, that still counts as the minimum.
const STATIONARY: f64 = 1e-6;
/// Relative difference of the costs.
const SAME_COST: f64 = 1e-9;

struct Numbers(std::vec::IntoIter<f64>);

impl Numbers {
    fn one(&mut self) -> f64 {
        self.0.next().expect("a number")
    }
    fn some<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.one())
    }
    fn motion<A, B>(&mut self) -> Motion<A, B> {
        let r: [f64; 9] = self.some();
        Motion::new(Matrix3::from_row_slice(&r), Vector3::from(self.some::<3>()))
    }
}

fn state(model: &Model, start: &State, n: &mut Numbers) -> State {
    let radial = start.cameras[0].radial;
    let cameras: Vec<Intrinsics> = model.cameras.iter().map(|_| Intrinsics::from_array(&n.some(), radial)).collect();
    let e0: Motion<Rig, Rig> = lens_from_solver(&model.cameras[0], &cameras[0]);
    let mut camera_from_first = vec![Motion::identity()];
    for c in 1..cameras.len() {
        let e: Motion<Cam, Cam> = lens_from_solver(&model.cameras[c], &cameras[c]);
        camera_from_first.push(e.inverse() * n.motion() * e0);
    }
    let first_from_plane: Option<Motion<Rig, Sheet>> = start.first_from_plane.map(|_| e0.inverse() * n.motion());
    let shape_mm = n.some();
    let view = |v: &spivcal::bundle::ViewModel, n: &mut Numbers| {
        let first_from_target: Motion<Rig, Target> = e0.inverse() * n.motion();
        let planar = first_from_plane.filter(|_| matches!(v.place, ViewPlace::InPlane { .. }));
        let plane_from_target = planar.map(|p| p.inverse() * first_from_target);
        ViewState { first_from_target, plane_from_target, shape_mm: n.some() }
    };
    let views = model.views.iter().map(|v| view(v, n)).collect();
    let offsets_mm = start.offsets_mm.iter().map(|_| n.some()).collect();
    State {
        cameras,
        camera_from_first,
        first_from_plane,
        views,
        shape_mm,
        offsets_mm,
        ovals_mm: vec![],
        slopes: vec![],
        windows: vec![],
    }
}

fn judged(case: &Case, text: &str) -> bool {
    let all: Vec<f64> = text.split_whitespace().map(|w| w.parse().expect("a number")).collect();
    let mut numbers = Numbers(all.into_iter());
    let there = state(&case.model, &case.start, &mut numbers);
    let cost = numbers.one();
    // One linearisation: the decrement of the state itself, without a step.
    let out = minimise(&problem(&case.model), there, &Options { decrement: 0.0, iterations: 1 }, &mut |_| true);
    let relative = (out.cost / cost - 1.0).abs();
    let same = out.decrement < STATIONARY && relative < SAME_COST;
    let word = if same { "" } else { "  DIFFERS" };
    println!("{:22} decrement {:.1e} sigmas, relative cost {relative:.1e}{word}", case.name, out.decrement);
    same
}

pub fn check(dir: &Path) -> ExitCode {
    let mut good = true;
    for case in all() {
        let file = dir.join(format!("{}.solution", case.name));
        good &= judged(&case, &std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display())));
    }
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
