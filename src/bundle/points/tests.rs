//! Lanes against the plain path, each width against the others, and the plain path against differences of the cost.

use super::*;
use crate::bundle::assemble::columns;
use crate::bundle::contour::EDGE;
use crate::bundle::layout::Places;
use crate::bundle::model::Model;
use crate::bundle::problem;
use crate::bundle::rig_scene::{Grid, Noise, Scene, tilted_camera};
use crate::bundle::state::State;
use crate::lanes::run_all;
use crate::solve::{Problem, Step};
use nalgebra::DVector;

/// Part of the largest possible value (Cauchy-Schwarz) that rounding may take.
const ROUNDING: f64 = 1e-11;

const DOTS: Grid = Grid { columns: 5, rows: 5, pitch_mm: 8.0, radius_mm: 2.5, print_error_mm: 0.01, turn: 1.0 };

/// Uneven numbers of points, sigmas, scales and orders; outliers.
fn roughened(mut scene: Scene, loss: Loss) -> (Model, State) {
    let mut noise = Noise::new(5);
    for (k, image) in scene.model.images.iter_mut().enumerate() {
        image.sigma_scale = 1.0 + 0.2 * k as f64;
        let p = &mut image.points;
        let n = p.disc.len() - k % 7 % p.disc.len();
        p.disc.truncate(n);
        [&mut p.u_px, &mut p.v_px, &mut p.sigma_px].into_iter().for_each(|x| x.truncate(n));
        p.sigma_px.iter_mut().for_each(|s| *s *= 0.5 + noise.uniform());
        p.u_px[n / 2] += 0.3;
        if k % 2 == 1 {
            p.disc.reverse();
            [&mut p.u_px, &mut p.v_px, &mut p.sigma_px].into_iter().for_each(|x| x.reverse());
        }
    }
    scene.model.loss = loss;
    (scene.model.clone(), scene.perturbed_by(4, 0.1))
}

fn dots(estimated: bool) -> Scene {
    let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
    Scene::with_grid(4, cameras, DOTS, estimated).seen_as_points(4)
}

fn scenes() -> Vec<(Model, State)> {
    let mut all_free = dots(false);
    all_free.model.cameras.iter_mut().for_each(|c| c.free = [true; INTRINSICS]);
    all_free.model.target.free = [true; 3];
    vec![
        roughened(dots(false), Loss::None),
        roughened(dots(false), Loss::Huber(2.0)),
        roughened(Scene::build(4, true, true, false).seen_as_points(4), Loss::Cauchy(3.0)),
        roughened(all_free, Loss::Huber(2.0)),
        roughened(dots(true), Loss::Huber(2.0)),
    ]
}

#[derive(Clone)]
struct OneImage<'a> {
    image: &'a SeenImage<'a>,
    columns: Columns,
    estimated: bool,
}

impl Kernel for OneImage<'_> {
    type Output = (f64, ImageNormal<LOCAL>);
    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let (mut scratch, mut rows, mut out) = (Scratch::default(), edges::Scratch::default(), ImageNormal::zeros());
        scratch.fill(self.image);
        let (image, places) = (self.image, &scratch.places);
        let cost = Cost { image, places }.run::<L>().unwrap();
        let (columns, rows, estimated) = (&self.columns.without_radius(), &mut rows, self.estimated);
        Normal { image, columns, estimated, places, rows, out: &mut out }.run::<L>().unwrap();
        (cost, out)
    }
}

fn bits(x: &[f64]) -> Vec<u64> {
    x.iter().map(|x| x.to_bits()).collect()
}

fn near(a: f64, b: f64, largest: f64) {
    assert!((a - b).abs() <= ROUNDING * largest, "{a} {b} of {largest}");
}

#[test]
fn lanes_agree_with_the_plain_path_and_each_other() {
    for (model, state) in scenes() {
        let places = Places::of(&model);
        for o in &model.images {
            let image = SeenImage::of(&model, &state, o).unwrap();
            let (columns, estimated) = (columns(&model, &places, o.camera), places.offsets.is_some());
            let all = run_all(&OneImage { image: &image, columns, estimated });
            let (cost, fast) = &all[0];
            for (other_cost, other) in &all {
                assert_eq!(bits(other.h.as_slice()), bits(fast.h.as_slice()));
                assert_eq!(bits(other.b.as_slice()), bits(fast.b.as_slice()));
                assert_eq!(bits(&[*other_cost, other.cost]), bits(&[*cost, fast.cost]));
            }
            let mut plain = ImageNormal::<LOCAL>::zeros();
            plain_linearise::<EDGE, LOCAL>(&image, estimated, &mut plain).unwrap();
            assert!(plain.cost > 1.0);
            for c in [*cost, fast.cost, plain_cost(&image).unwrap()] {
                assert!((c / plain.cost - 1.0).abs() < 1e-11, "{c} {}", plain.cost);
            }
            let size = |i: usize| plain.h[(i, i)].sqrt();
            for i in columns.list().iter().copied().filter(|i| *i < LOCAL) {
                near(fast.b[i], plain.b[i], size(i) * (2.0 * plain.cost).sqrt());
                for j in columns.list().iter().copied().filter(|j| *j < LOCAL) {
                    near(fast.h[(i, j)], plain.h[(i, j)], size(i) * size(j));
                }
            }
            assert_eq!((fast.offsets.len(), estimated), (plain.offsets.len(), !plain.offsets.is_empty()));
            for (a, b) in fast.offsets.iter().zip(&plain.offsets) {
                assert_eq!(a.disc, b.disc);
                let own = b.own.trace().sqrt();
                assert!((a.own - b.own).abs().max() <= ROUNDING * own * own);
                assert!((a.b - b.b).abs().max() <= ROUNDING * own * (2.0 * plain.cost).sqrt());
                for j in columns.list().iter().copied().filter(|j| *j < LOCAL) {
                    (0..4).for_each(|m| near(a.with_local[(m, j)], b.with_local[(m, j)], own * size(j)));
                }
            }
        }
    }
}

#[derive(Clone)]
struct OneBend<'a> {
    seen: &'a [SeenImage<'a>; 3],
    columns: Columns,
}

impl Kernel for OneBend<'_> {
    type Output = (SVector<f64, LOCAL>, Vec<(usize, Vector4<f64>)>);
    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let (mut local, mut scratch) = (SVector::zeros(), [Scratch::default(), Scratch::default(), Scratch::default()]);
        scratch.iter_mut().zip(self.seen).for_each(|(s, seen)| s.fill(seen));
        let places = [&scratch[0].places, &scratch[1].places, &scratch[2].places];
        let (mut offsets, columns) = (vec![], &self.columns.without_radius());
        let (seen, local_out, offsets_out) = (self.seen, &mut local, &mut offsets);
        Bend { seen, columns, h: 0.1, places, local: local_out, offsets: offsets_out }.run::<L>().unwrap();
        (local, offsets)
    }
}

#[test]
fn the_bend_agrees_with_the_plain_path() {
    for (model, here) in scenes() {
        let places = Places::of(&model);
        let aside = |by: f64| {
            let mut s = here.clone();
            s.views.iter_mut().for_each(|v| v.first_from_target.translation_mm.x += by);
            s.cameras[0].f_px += 40.0 * by;
            s
        };
        let states = [aside(-0.5), here.clone(), aside(0.5)];
        for o in &model.images {
            let columns = columns(&model, &places, o.camera);
            let seen = [0, 1, 2].map(|k| SeenImage::of(&model, &states[k], o).unwrap());
            let all = run_all(&OneBend { seen: &seen, columns });
            let (mut plain, mut offsets) = (SVector::<f64, LOCAL>::zeros(), vec![]);
            plain_bend::<EDGE, LOCAL>(&seen, 0.1, &mut plain, &mut offsets).unwrap();
            let largest = plain.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            for (local, discs) in &all {
                assert_eq!((local, discs), (&all[0].0, &all[0].1));
                assert_eq!(discs.len(), offsets.len());
                for (a, b) in discs.iter().zip(&offsets) {
                    assert_eq!(a.0, b.0);
                    assert!((a.1 - b.1).norm() < 1e-7 * b.1.norm() + 1e-10 * largest, "{} {}", a.1, b.1);
                }
                for &k in columns.list().iter().filter(|k| **k < LOCAL) {
                    assert!((local[k] - plain[k]).abs() < 1e-8 * largest, "{k}: {} {}", local[k], plain[k]);
                }
            }
        }
    }
}

#[test]
fn states_without_an_image_are_refused_as_by_the_plain_path() {
    let (model, start) = roughened(dots(false), Loss::None);
    let mut states = vec![start; 3];
    states[0].views[0].first_from_target.translation_mm.z *= -1.0;
    states[1].views[0].first_from_target.translation_mm.x = f64::NAN;
    states[2].views[0].first_from_target.translation_mm.x = 1e4;
    for state in &states {
        let image = SeenImage::of(&model, state, &model.images[0]).unwrap();
        let columns = columns(&model, &Places::of(&model), 0);
        assert!(plain_cost(&image).is_none() && cost(&image, &mut Scratch::default()).is_none());
        let (mut scratch, mut rows, mut out) = (Scratch::default(), edges::Scratch::default(), ImageNormal::zeros());
        assert!(linearise(&image, &columns, false, (&mut scratch, &mut rows), &mut out).is_none());
    }
}

/// A step of one unknown.
fn unit(sizes: &crate::solve::Layout, at: usize, h: f64) -> Step {
    let mut global = DVector::zeros(sizes.global);
    let mut blocks: Vec<DVector<f64>> = sizes.blocks.iter().map(|d| DVector::zeros(*d)).collect();
    if at < sizes.global {
        global[at] = h;
    } else {
        let mut rest = at - sizes.global;
        for b in &mut blocks {
            if rest < b.len() {
                b[rest] = h;
                break;
            }
            rest -= b.len();
        }
    }
    Step { global, blocks }
}

/// The right-hand side of the normal equations is minus the gradient of the cost along the retraction, for every unknown, also where each disc is
/// estimated.
#[test]
fn the_gradient_is_that_of_the_cost() {
    for (model, state) in scenes() {
        let problem = problem(&model);
        let (layout, scales) = (problem.layout(), problem.scales(&state));
        let e = problem.linearise(&state).unwrap();
        assert!((e.cost / problem.cost(&state).unwrap() - 1.0).abs() < 1e-10);
        let right = |of: &DVector<f64>, blocks: Vec<&DVector<f64>>| -> Vec<f64> {
            of.iter().chain(blocks.into_iter().flatten()).copied().collect()
        };
        let b = right(&e.b_g, e.blocks.iter().map(|b| &b.b_v).collect());
        let scale = right(&scales.global, scales.blocks.iter().collect());
        let curvature: Vec<f64> = e
            .h_gg
            .diagonal()
            .iter()
            .chain(e.blocks.iter().flat_map(|b| b.h_vv.diagonal().data.as_vec().clone()).collect::<Vec<_>>().iter())
            .copied()
            .collect();
        for at in 0..b.len() {
            // A step of a hundredth of a sigma: neither rounding nor the third derivative reach what is asked.
            let h = (0.01 / curvature[at].max(1e-12).sqrt()).min(1e-3 * scale[at]);
            let moved = |h: f64| problem.cost(&problem.retract(&state, &unit(&layout, at, h)).unwrap()).unwrap();
            let slope = (moved(h) - moved(-h)) / (2.0 * h);
            let limit = 1e-6 * (b[at].abs() + (curvature[at] * e.cost).sqrt()) + 1e-11 * e.cost / h;
            assert!((slope + b[at]).abs() < limit, "{at}: {slope} {} {limit}", -b[at]);
        }
    }
}

/// Points move the estimate as contours of the same dots do: both find the truth within their sigmas.
#[test]
fn points_alone_find_the_truth() {
    let scene = dots(false);
    let options = crate::bundle::AdjustOptions::default();
    let out = crate::bundle::adjust(&scene.model, scene.perturbed_by(4, 0.5), &options, &mut |_| true);
    assert_eq!(out.termination, crate::bundle::Termination::Converged);
    let o = scene.model.counts();
    let dof = (o.observations + o.facts - o.unknowns) as f64;
    // Four standard deviations of a chi-square.
    assert!((2.0 * out.cost - dof).abs() < 4.0 * (2.0 * dof).sqrt(), "{} {dof}", 2.0 * out.cost);
    let known = crate::bundle::named_covariance(&out).unwrap();
    for (c, (a, b)) in out.state.cameras.iter().zip(&scene.truth.cameras).enumerate() {
        for k in [0, 4, 5, 6] {
            let sigma =
                known.sigma(&format!("{}.{}", ["left", "right"][c], crate::camera::INTRINSIC_NAMES[k])).unwrap();
            let z = (a.to_array()[k] - b.to_array()[k]) / sigma;
            assert!(z.abs() < 4.0, "{c} {k}: {z}");
        }
    }
}
