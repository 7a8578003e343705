//! Lanes against the plain path, and each width against the others.

use super::*;
use crate::bundle::assemble::{columns, plain_bend};
use crate::bundle::contour::EDGE;
use crate::bundle::layout::Places;
use crate::bundle::model::Model;
use crate::bundle::outline;
use crate::bundle::rig_scene::{Noise, Scene};
use crate::bundle::same_light;
use crate::bundle::state::State;
use crate::conic::CommonNoise;
use crate::lanes::run_all;
use nalgebra::Matrix3;

/// A part of the largest possible value (Cauchy-Schwarz): feet are found within 1e-7 px along contours of some 50 px, and directions
/// turn with them.
const ROUNDING: f64 = 1e-9;

#[derive(Clone)]
struct OneImage<'a> {
    image: &'a SeenImage<'a>,
    columns: Columns,
}

struct Seen {
    cost: f64,
    normal: ImageNormal<LOCAL>,
    tied: Vec<Tied<()>>,
}

impl Kernel for OneImage<'_> {
    type Output = Seen;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Seen {
        let mut scratch = Scratch::default();
        let mut normal = ImageNormal::zeros();
        let mut tied = vec![];
        let cost = Cost { image: self.image, scratch: &mut scratch, tied: &mut tied }.run::<L>().unwrap();
        Normal { image: self.image, columns: &self.columns, scratch: &mut scratch, out: &mut normal }
            .run::<L>()
            .unwrap();
        Seen { cost, normal, tied }
    }
}

/// Uneven numbers of edge points, sigmas and scales, outliers.
fn roughened(mut scene: Scene, loss: Loss) -> Scene {
    let mut noise = Noise::new(5);
    for (k, image) in scene.model.images.iter_mut().enumerate() {
        image.sigma_scale = 1.0 + 0.2 * k as f64;
        for (j, disc) in image.discs.iter_mut().enumerate() {
            let n = disc.edge.u_px.len() - (3 * k + 5 * j) % 11;
            disc.edge.u_px.truncate(n);
            disc.edge.v_px.truncate(n);
            disc.edge.sigma_px.truncate(n);
            disc.edge.sigma_px.iter_mut().for_each(|s| *s *= 0.5 + noise.uniform());
            disc.edge.u_px[n / 2] += 0.3;
        }
    }
    scene.model.loss = loss;
    scene
}

/// Scenes with their states, half a start's error off.
fn scenes() -> Vec<(Model, State)> {
    let mut out = vec![];
    for (loss, per_view, plane, points) in [
        (Loss::None, false, false, false),
        (Loss::Huber(2.0), true, true, false),
        (Loss::Cauchy(3.0), false, true, false),
        (Loss::None, false, false, true),
        (Loss::Huber(2.0), false, false, true),
    ] {
        let scene = roughened(Scene::build(4, per_view, plane, points).with_noise(4), loss);
        let mut model = scene.model.clone();
        assert_eq!(same_light::tie(&mut model, &scene.truth).is_some(), per_view);
        out.push((scene.perturbed_by(4, 0.1), model));
    }
    // Everything free, contours that have something in common, and oval discs.
    let mut scene = roughened(Scene::build(4, false, false, true).with_noise(4), Loss::Huber(2.0));
    scene.model.cameras.iter_mut().for_each(|c| c.free = [true; INTRINSICS]);
    scene.model.target.free = [true; 3];
    let mut noise = Noise::new(6);
    for disc in scene.model.images.iter_mut().flat_map(|i| &mut i.discs) {
        let (shift, n) = (0.4 * noise.normal(), disc.edge.u_px.len());
        (0..n).for_each(|i| disc.edge.u_px[i] += shift * (2.0 * std::f64::consts::TAU * i as f64 / n as f64).cos());
    }
    for disc in scene.model.images.iter_mut().flat_map(|i| i.discs.iter_mut().step_by(2)) {
        let angle = |i: usize| std::f64::consts::TAU * i as f64 / disc.edge.u_px.len() as f64;
        let row = |(i, sigma): (usize, &f64)| [1.0 / sigma, angle(i).cos() / sigma, angle(i).sin() / sigma];
        let rows: Vec<[f64; 3]> = disc.edge.sigma_px.iter().enumerate().map(row).collect();
        disc.common = CommonNoise::of(&rows, &Matrix3::from_diagonal_element(1e-4));
        assert!(!disc.common.is_none());
    }
    assert!(outline::whiten(&mut scene.model, &scene.truth).is_some());
    assert!(scene.model.images.iter().all(|i| i.discs.iter().all(|d| !d.outline.is_none())));
    out.push((scene.perturbed_by(4, 0.1), scene.model));
    out.into_iter().map(|(s, m)| (m, s)).collect()
}

fn same_bits(a: &ImageNormal<LOCAL>, b: &ImageNormal<LOCAL>) {
    let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(a.h.as_slice()), bits(b.h.as_slice()));
    assert_eq!(bits(a.b.as_slice()), bits(b.b.as_slice()));
    assert_eq!(a.cost.to_bits(), b.cost.to_bits());
    assert_eq!(a.tied.len(), b.tied.len());
    for (a, b) in a.tied.iter().zip(&b.tied) {
        assert_eq!(a.residual.to_bits(), b.residual.to_bits());
        assert_eq!(bits(a.row.as_slice()), bits(b.row.as_slice()));
    }
    assert_eq!(a.offsets.len(), b.offsets.len());
    for (a, b) in a.offsets.iter().zip(&b.offsets) {
        assert_eq!(bits(a.own.as_slice()), bits(b.own.as_slice()));
        assert_eq!(bits(a.with_local.as_slice()), bits(b.with_local.as_slice()));
        assert_eq!(bits(a.b.as_slice()), bits(b.b.as_slice()));
    }
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
            let columns = columns(&model, &places, o.camera);
            let all = run_all(&OneImage { image: &image, columns });
            for seen in &all {
                same_bits(&seen.normal, &all[0].normal);
                assert_eq!(seen.cost.to_bits(), all[0].cost.to_bits());
            }
            let (fast, mut plain) = (&all[0], ImageNormal::<LOCAL>::zeros());
            let estimated = places.offsets.is_some();
            image.plain_contours::<EDGE, LOCAL>(estimated, &mut plain).unwrap();
            // What the second camera says of the rim is no longer in its own cost.
            let apart: f64 = plain.tied.iter().map(|t| 0.5 * t.residual * t.residual).sum();
            assert!(plain.cost + apart > 10.0);
            assert!((fast.cost / plain.cost - 1.0).abs() < 1e-12);
            assert!((fast.normal.cost / plain.cost - 1.0).abs() < 1e-12);
            let mut tied = vec![];
            assert!((image.plain_cost(&mut tied).unwrap() / plain.cost - 1.0).abs() < 1e-12);
            let size = (2.0 * plain.cost).sqrt();
            assert_eq!(fast.normal.tied.len(), plain.tied.len());
            assert_eq!([tied.len(), fast.tied.len()], [plain.tied.len(); 2]);
            for (k, (a, b)) in fast.normal.tied.iter().zip(&plain.tied).enumerate() {
                [a.residual, tied[k].residual, fast.tied[k].residual].iter().for_each(|r| near(*r, b.residual, size));
                // The second camera's is no longer in the matrix.
                columns
                    .list()
                    .iter()
                    .for_each(|i| near(a.row[*i], b.row[*i], plain.h[(*i, *i)].sqrt() + b.row[*i].abs()));
            }
            let size = |i: usize| plain.h[(i, i)].sqrt();
            for i in columns.list().iter().copied().filter(|i| *i < LOCAL) {
                near(fast.normal.b[i], plain.b[i], size(i) * (2.0 * plain.cost).sqrt());
                for j in columns.list().iter().copied().filter(|j| *j < LOCAL) {
                    near(fast.normal.h[(i, j)], plain.h[(i, j)], size(i) * size(j));
                }
            }
            assert_eq!(fast.normal.offsets.len(), plain.offsets.len());
            for (a, b) in fast.normal.offsets.iter().zip(&plain.offsets) {
                assert_eq!(a.disc, b.disc);
                for m in 0..4 {
                    let own = b.own[(m, m)].sqrt();
                    near(a.b[m], b.b[m], own * (2.0 * plain.cost).sqrt());
                    (0..4).for_each(|n| near(a.own[(m, n)], b.own[(m, n)], own * b.own[(n, n)].sqrt()));
                    for j in columns.list().iter().copied().filter(|j| *j < LOCAL) {
                        near(a.with_local[(m, j)], b.with_local[(m, j)], own * size(j));
                    }
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
        let (mut local, mut offsets, mut scratch) = (SVector::zeros(), vec![], Scratch::default());
        let (out, columns) = ((&mut local, &mut offsets), &self.columns);
        Bend { seen: self.seen, columns, h: 0.1, scratch: &mut scratch, local: out.0, offsets: out.1 }
            .run::<L>()
            .unwrap();
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
            for (local, discs) in &all {
                assert_eq!(local, &all[0].0);
                assert_eq!(discs, &all[0].1);
                // Second differences of distances lose digits; the sums cancel besides.
                let largest = plain.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
                for &k in columns.list().iter().filter(|k| **k < LOCAL) {
                    assert!((local[k] - plain[k]).abs() < 1e-9 * largest, "{k}: {} {}", local[k], plain[k]);
                }
                if places.offsets.is_some() {
                    for (a, b) in discs.iter().zip(&offsets) {
                        assert_eq!(a.0, b.0);
                        assert!((a.1 - b.1).norm() < 1e-8 * b.1.norm(), "{} {}", a.1, b.1);
                    }
                }
            }
        }
    }
}

#[test]
fn states_without_an_image_are_refused_as_by_the_plain_path() {
    let scene = Scene::build(4, false, false, false);
    let mut states = vec![scene.truth.clone(); 3];
    states[0].views[0].first_from_target.translation_mm.z *= -1.0;
    states[1].views[0].first_from_target.translation_mm.x = f64::NAN;
    states[2].views[0].first_from_target.translation_mm.x = 1e4;
    for state in &states {
        let image = SeenImage::of(&scene.model, state, &scene.model.images[0]).unwrap();
        let columns = columns(&scene.model, &Places::of(&scene.model), 0);
        assert!(image.plain_cost(&mut vec![]).is_none());
        assert!(cost(&image, &mut Scratch::default(), &mut vec![]).is_none());
        let mut out = ImageNormal::zeros();
        assert!(linearise(&image, &columns, &mut Scratch::default(), &mut out).is_none());
    }
}

#[test]
fn feet_are_the_plain_ones() {
    let scene = roughened(Scene::build(4, false, false, false).with_noise(4), Loss::None);
    let image = SeenImage::of(&scene.model, &scene.truth, &scene.model.images[1]).unwrap();
    let seen = &image.observations.discs[1];
    let circle = image.circle(seen.disc);
    let (mut fast, mut plain) = (Feet::of(&circle, seen).unwrap(), Feet::plain(&circle, seen).unwrap());
    for (k, (a, b)) in fast.all().into_iter().zip(plain.all()).enumerate() {
        assert_eq!((a.len(), b.len()), (seen.edge.u_px.len(), seen.edge.u_px.len()));
        for (a, b) in a.iter().zip(b) {
            let rounding = if k == 0 { 1e-12 } else { 1e-8 };
            assert!((*a - *b).abs() < rounding * (1.0 + b.abs()), "{k}: {a} {b}");
        }
    }
}
