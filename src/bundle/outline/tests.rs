//! Against the dense covariance of all images of a disc, numerical derivatives, and discs drawn off round.

use super::*;
use crate::bundle::list::List;
use crate::bundle::part;
use crate::bundle::rig_scene::{
    Noise, Problem as Reference, SIGMA_PX, Scene, TWO_SIDED_995, band, camera_covariance, camera_numbers, nees,
};
use crate::bundle::{AdjustOptions, Loss, Termination, adjust, adjust_tangents, named_covariance, problem, residuals};
use crate::camera::Camera;
use crate::solve::{self, Step};
use nalgebra::{DMatrix, DVector, Matrix3};

/// Two printed discs off round by so much, mm, as every image shows them.
fn drawn(scene: &Scene, ovals_mm: &[[f64; 2]], seed: u64) -> Model {
    let (mut noise, mut model) = (Noise::stream(seed, 3), scene.model.clone());
    for (k, image) in scene.model.images.iter().enumerate() {
        let seen_image = SeenImage::of(&scene.model, &scene.truth, image).unwrap();
        for (d, seen) in image.discs.iter().enumerate() {
            let feet = Feet::of(&seen_image.circle(seen.disc), seen).unwrap();
            let edge = &mut model.images[k].discs[d].edge;
            for i in 0..edge.u_px.len() {
                let (cos, sin) = (feet.direction[0][i], feet.direction[1][i]);
                let [a, b] = ovals_mm[seen.disc];
                let moved = feet.px_per_mm[i] * (a * (cos * cos - sin * sin) + b * 2.0 * sin * cos);
                edge.u_px[i] += moved * feet.normal[0][i] + SIGMA_PX * noise.normal();
                edge.v_px[i] += moved * feet.normal[1][i] + SIGMA_PX * noise.normal();
            }
        }
    }
    model
}

/// Contours that have something in common, sigmas of different size, ovals as unknowns; and a state that is no minimum.
fn shared() -> (Model, State) {
    shared_by(Scene::build(4, false, true, false))
}

fn shared_by(scene: Scene) -> (Model, State) {
    let mut model = drawn(&scene, &[[2e-3, -1e-3], [-1e-3, 3e-3]], 4);
    for (k, image) in model.images.iter_mut().enumerate() {
        image.sigma_scale = 1.0 + 0.1 * k as f64;
        for disc in &mut image.discs {
            let angle = |i: usize| std::f64::consts::TAU * i as f64 / disc.edge.u_px.len() as f64;
            let row = |(i, sigma): (usize, &f64)| [1.0 / sigma, angle(i).cos() / sigma, angle(i).sin() / sigma];
            let rows: Vec<[f64; 3]> = disc.edge.sigma_px.iter().enumerate().map(row).collect();
            disc.common = CommonNoise::of(&rows, &Matrix3::from_diagonal_element(1e-4));
        }
    }
    let mut state = scene.truth.clone();
    let found = find(&mut model, &mut state);
    assert!(found.changed && found.ovality_mm.is_some_and(|tau| (5e-4..2e-2).contains(&tau)), "{found:?}");
    state = State { ovals_mm: vec![[1e-3, 2e-3], [-5e-4, 1e-3]], ..scene.perturbed_by(4, 0.1) };
    (model, state)
}

/// Whitened distances of all contours of all images, as if discs were round.
fn distances(model: &Model, state: &State) -> DVector<f64> {
    let (state, mut out) = (&State { ovals_mm: vec![], ..state.clone() }, vec![]);
    for image in &model.images {
        let all = residuals(model, state, image).unwrap();
        for (seen, own) in image.discs.iter().zip(&all.discs) {
            let each = own.edges.distance_px.iter().zip(&seen.edge.sigma_px);
            let mut rows: Vec<[f64; 1]> = each.map(|(r, s)| [r / (s * image.sigma_scale)]).collect();
            seen.whiten(&mut rows);
            out.extend(rows.iter().map(|[r]| *r));
        }
    }
    DVector::from_vec(out)
}

/// B of all of them: one pair of columns per disc. It is held from the state at which it was formed.
fn movements(model: &Model, formed: &State) -> DMatrix<f64> {
    let rows = distances(model, formed).len();
    let (mut out, mut at) = (DMatrix::zeros(rows, 2 * model.target.disc_count()), 0);
    for image in &model.images {
        let seen_image = SeenImage::of(model, formed, image).unwrap();
        for seen in &image.discs {
            let harmonic = Harmonic::of(&seen_image.circle(seen.disc), seen).unwrap();
            for row in &harmonic.rows {
                (0..2).for_each(|k| out[(at, 2 * seen.disc + k)] = row[k] / image.sigma_scale);
                at += 1;
            }
        }
    }
    out
}

/// With the ovals eliminated, cost, gradient and matrix are those of the covariance that all images of a disc have together, with derivatives by
/// differences.
#[test]
fn images_of_a_disc_are_weighed_by_their_common_covariance() {
    let (model, state) = shared();
    let tau = model.target.oval_sigma_mm.unwrap();
    let b = movements(&model, &Scene::build(4, false, true, false).truth);
    let covariance = DMatrix::identity(b.nrows(), b.nrows()) + &b * b.transpose() * (tau * tau);
    let inverse = covariance.cholesky().unwrap().inverse();

    let list = List::of(&model, &state);
    let equations = problem(&model).linearise(&state).unwrap();
    let cost = problem(&model).cost(&state).unwrap();
    assert!((cost / equations.cost - 1.0).abs() < 1e-12);
    let (h, gradient) = list.dense(&equations);
    let first = Places::of(&model).ovals.unwrap();
    let ovals: Vec<usize> = (first..first + b.ncols()).collect();
    let others: Vec<usize> = (0..h.nrows()).filter(|i| !ovals.contains(i)).collect();
    let pick = |rows: &[usize], columns: &[usize]| {
        DMatrix::from_fn(rows.len(), columns.len(), |i, j| h[(rows[i], columns[j])])
    };
    let part = |at: &[usize]| DVector::from_fn(at.len(), |i, _| gradient[at[i]]);
    let own = pick(&ovals, &ovals).cholesky().unwrap();
    let cross = pick(&ovals, &others);
    let reduced_h = pick(&others, &others) - cross.tr_mul(&own.solve(&cross));
    let reduced_b = part(&others) - cross.tr_mul(&own.solve(&part(&ovals)));
    let reduced_cost = equations.cost - 0.5 * part(&ovals).dot(&own.solve(&part(&ovals)));

    // What is known beforehand has nothing to do with outlines: it is taken off.
    let mut round = model.clone();
    (round.target.oval_sigma_mm, round.images) = (None, vec![]);
    let facts = problem(&round).linearise(&state).unwrap();
    let (facts_h, facts_b) = List::of(&round, &state).dense(&facts);
    let r = distances(&model, &state);
    let step = 1e-4;
    let slope = |k: &usize| {
        let [before, behind] = [-step, step].map(|x| distances(&model, &list.moved(&state, *k, x)));
        (behind - before) / (2.0 * step)
    };
    let slopes = DMatrix::from_columns(&others.iter().map(slope).collect::<Vec<_>>());
    let wanted_h = slopes.tr_mul(&(&inverse * &slopes)) + facts_h;
    let wanted_b = facts_b - slopes.tr_mul(&(&inverse * &r));
    let wanted_cost = facts.cost + 0.5 * r.dot(&(&inverse * &r));
    assert!((reduced_cost / wanted_cost - 1.0).abs() < 1e-9, "{reduced_cost} {wanted_cost}");
    for i in 0..others.len() {
        let size = wanted_h[(i, i)].sqrt();
        let limit = 1e-6 * size * (2.0 * wanted_cost).sqrt();
        assert!((reduced_b[i] - wanted_b[i]).abs() < limit, "{i}: {} {}", reduced_b[i], wanted_b[i]);
        for j in 0..others.len() {
            let limit = 1e-6 * size * wanted_h[(j, j)].sqrt();
            assert!(
                (reduced_h[(i, j)] - wanted_h[(i, j)]).abs() <= limit,
                "{i} {j}: {} {}",
                reduced_h[(i, j)],
                wanted_h[(i, j)]
            );
        }
    }
}

/// Gradient and cost of the equations against the cost and its slopes.
fn gradient_is_that_of_the_cost(model: &Model, state: &State) {
    let (p, list) = (problem(model), List::of(model, state));
    let (equations, cost) = (p.linearise(state).unwrap(), p.cost(state).unwrap());
    assert!((equations.cost / cost - 1.0).abs() < 1e-12, "{} {cost}", equations.cost);
    let (h, b) = list.dense(&equations);
    let part = 1e-6;
    for k in 0..b.len() {
        let [before, behind] = [-part, part].map(|x| p.cost(&list.moved(state, k, x)).unwrap());
        let slope = (before - behind) / (2.0 * part);
        let limit = 1e-5 * h[(k, k)].sqrt() * (2.0 * cost).sqrt();
        assert!((b[k] - slope).abs() < limit, "{:?}, {k}: {} {slope}", model.loss, b[k]);
    }
}

/// With a loss that bends, too.
#[test]
fn the_gradient_is_that_of_the_cost() {
    let (mut model, state) = shared();
    model.loss = Loss::Huber(2.0);
    gradient_is_that_of_the_cost(&model, &state);
}

/// Some points of each contour stand for all: standard deviations of what views share are the same.
#[test]
fn some_points_stand_for_all() {
    let (model, state) = shared_by(Scene::build(4, false, true, false).with_edge_points(600));
    let some = part::with_few_observations(&model).unwrap();
    let points =
        |model: &Model| -> usize { model.images.iter().flat_map(|i| &i.discs).map(|d| d.edge.u_px.len()).sum() };
    assert!(8 * points(&some) < points(&model), "{} of {}", points(&some), points(&model));
    let square = Model { loss: Loss::None, ..model };
    let known = |model: &Model| {
        let posterior = solve::posterior(&Bundle::with_views(model).linearise(&state).unwrap());
        assert_eq!(posterior.nullity, 0);
        posterior.global.diagonal().map(f64::sqrt)
    };
    let ratio = known(&some).component_div(&known(&square));
    assert!(ratio.iter().all(|r| (r - 1.0).abs() < 0.02), "{ratio}");
}

/// What bends along a step moves ovals as the whitened distances say that every image of a disc has them.
#[test]
fn ovals_follow_what_bends() {
    let (model, state) = shared();
    let (p, first) = (problem(&model), Places::of(&model).ovals.unwrap());
    let mut velocity = p.scales(&state);
    let all = velocity.global.iter_mut().chain(velocity.blocks.iter_mut().flat_map(|b| b.iter_mut()));
    all.enumerate().for_each(|(i, x)| *x *= 0.3 * (1.3 * i as f64).sin());
    let bent = p.bend(&state, &velocity).unwrap();
    // Differences as far as a tenth of the step are its own, too.
    let h = 0.1;
    let part = |by: f64| {
        let blocks = velocity.blocks.iter().map(|b| b * by).collect();
        distances(&model, &p.retract(&state, &Step { global: &velocity.global * by, blocks }).unwrap())
    };
    let second = (part(h) - 2.0 * distances(&model, &state) + part(-h)) / (h * h);
    let wanted = movements(&model, &Scene::build(4, false, true, false).truth).tr_mul(&second);
    assert!(wanted.iter().all(|x| *x != 0.0));
    for k in 0..wanted.len() {
        let got = bent.global[first + k];
        assert!((got - wanted[k]).abs() < 1e-6 * wanted.amax(), "{k}: {got} {}", wanted[k]);
    }
}

/// Means of squares over variances, of the eight numbers of two cameras (or four of one), and the normalised squares of the eight.
fn squares(name: &str, tau_mm: f64, runs: u64, (cameras, tangents): (usize, bool)) -> (Vec<f64>, f64) {
    let scene = Reference::of(name).unwrap().parts.scene().with_edge_points(100);
    let (mut out, mut square) = (vec![0.0; 4 * cameras], 0.0);
    for seed in 0..runs {
        let mut noise = Noise::stream(seed, 5);
        let ovals: Vec<[f64; 2]> = (0..2).map(|_| [tau_mm * noise.normal(), tau_mm * noise.normal()]).collect();
        let mut model = drawn(&scene, &ovals, seed);
        model.facts = scene.with_facts_drawn(&mut Noise::stream(seed, 4)).model.facts;
        let mut start = scene.truth.clone();
        if cameras == 1 {
            model.images.retain(|i| i.camera == 0);
            model.facts.retain(|f| !matches!(f, crate::bundle::Fact::Intrinsic { camera: 1, .. }));
            model.cameras.truncate(1);
            start.cameras.truncate(1);
            start.camera_from_first.truncate(1);
        }
        let mut found = adjust(&model, start, &AdjustOptions::default(), &mut |_| true);
        if tangents {
            let by_tangents = adjust_tangents(&found.model, found.state, &AdjustOptions::default(), &mut |_| true);
            found = by_tangents.unwrap().adjustment;
        }
        assert_eq!(found.termination, Termination::Converged, "seed {seed}: decrement {}", found.decrement);
        let covariance = named_covariance(&found).unwrap();
        let numbers = |cameras: &[Camera]| -> Vec<f64> { cameras.iter().flat_map(camera_numbers).collect() };
        let (own, wanted) = (numbers(&covariance.natural.cameras), numbers(&scene.cameras[..cameras]));
        let c = camera_covariance(&covariance);
        let errors: Vec<f64> = own.iter().zip(&wanted).map(|(a, b)| a - b).collect();
        errors.iter().enumerate().for_each(|(k, e)| out[k] += e * e / c[(k, k)] / runs as f64);
        if cameras == 2 {
            square += nees(&errors, &c) / runs as f64;
        }
    }
    println!("{name}, {cameras} camera(s), {tau_mm} mm, tangents {tangents}: {out:.2?}, all together {square:.3}");
    (out, square)
}

/// Discs that are round and discs that are not: standard deviations hold, with two cameras and with one, by contours and by their tangents.
#[test]
fn standard_deviations_hold_where_discs_are_ovals() {
    const RUNS: u64 = 60;
    let all = band((8 * RUNS) as f64, TWO_SIDED_995);
    let one = band(RUNS as f64, TWO_SIDED_995);
    for (tau_mm, tangents) in [(1e-3, false), (4e-3, false), (1e-3, true)] {
        let (each, square) = squares("A", tau_mm, RUNS, (2, tangents));
        assert!((all[0]..all[1]).contains(&square), "{square} outside {all:.3?}");
        assert!(each.iter().all(|z| *z < 2.0), "{each:?}");
        let (each, _) = squares("A", tau_mm, RUNS, (1, tangents));
        assert!(each.iter().all(|z| *z < one[1]), "{each:?} outside {one:.3?}");
    }
    // Round ones are not known to be so: their sigmas are a little larger than they need be.
    let (each, square) = squares("A", 0.0, RUNS, (2, false));
    assert!((0.6..all[1]).contains(&square), "{square}");
    assert!(each.iter().all(|z| *z < one[1]), "{each:?}");
}

/// Residuals beside the ovals that were estimated are the noise, and those of contours without them.
#[test]
fn residuals_are_told_beside_the_ovals() {
    let scene = Reference::of("A").unwrap().parts.scene().with_edge_points(100);
    let model = drawn(&scene, &[[3e-3, -2e-3], [-1e-3, 3e-3]], 6);
    let found = adjust(&model, scene.truth.clone(), &AdjustOptions::default(), &mut |_| true);
    let bare = State { ovals_mm: vec![], ..found.state.clone() };
    for image in &found.model.images {
        let shown = residuals(&found.model, &found.state, image).unwrap();
        let of_image = SeenImage::of(&found.model, &found.state, image).unwrap();
        let mut without = image.clone();
        for seen in &mut without.discs {
            *seen = round(&of_image, seen).unwrap().0;
            assert!(seen.tie.is_none());
        }
        let left = residuals(&found.model, &bare, &without).unwrap();
        for (a, b) in left.discs.iter().zip(&shown.discs) {
            let each = a.edges.distance_px.iter().zip(&b.edges.distance_px);
            let worst = each.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(worst < 0.02 * SIGMA_PX, "{worst} px");
            let rms = (b.edges.distance_px.iter().map(|r| r * r).sum::<f64>() / 100.0).sqrt();
            assert!((0.6..1.5).contains(&(rms / SIGMA_PX)), "{rms} px");
        }
    }
}

/// Features follow what is taken off the contours as ovality, and cost has its gradient with ovals among the unknowns.
#[test]
fn tangents_follow_ovals() {
    let scene = Reference::of("A").unwrap().parts.scene().with_edge_points(100);
    let model = drawn(&scene, &[[3e-3, -2e-3], [-1e-3, 3e-3]], 6);
    let contours = adjust(&model, scene.truth.clone(), &AdjustOptions::default(), &mut |_| true);
    let tangents = adjust_tangents(&contours.model, contours.state.clone(), &AdjustOptions::default(), &mut |_| true);
    let tangents = tangents.unwrap().adjustment;
    // Features of contours with more taken off, through the same lens and from the same place.
    let ovals_mm = |by: f64| {
        let [a, b] = [tangents.state.ovals_mm[0], tangents.state.ovals_mm[1]];
        vec![[a[0] + by, a[1] - 2.0 * by], [b[0] - by, b[1] + 0.5 * by]]
    };
    let (step, change) = (1e-4, [1.0, -2.0, -1.0, 0.5]);
    let at = |by: f64| State { ovals_mm: ovals_mm(by), ..tangents.state.clone() };
    let found = [-step, 0.0, step].map(|by| crate::bundle::refit::with_features(&contours.model, &at(by)).0);
    for k in 0..found[1].images.len() {
        let of = |i: usize| &found[i].images[k].pairs[0];
        let d = &of(1).ovals.as_ref().unwrap().derivative;
        for (j, at) in of(1).pixels_px.iter().enumerate() {
            let slope = (of(2).pixels_px[j] - of(0).pixels_px[j]) / (2.0 * step);
            let told: f64 = (0..4).map(|k| d[(j, k)] * change[k]).sum();
            assert!((slope - told).abs() < 1e-3 * d.amax(), "image {k}, {j} at {at}: {slope} {told} of {}", d.amax());
        }
    }
    for loss in [Loss::None, Loss::Huber(0.8)] {
        let model = Model { loss, ..tangents.model.clone() };
        let state = State { ovals_mm: ovals_mm(1e-3), ..scene.perturbed_by(3, 0.05) };
        gradient_is_that_of_the_cost(&model, &state);
    }
}

/// Tangents of ellipses find what contours did, and are about as uncertain of it.
#[test]
fn tangents_find_what_contours_did() {
    let scene = Reference::of("A").unwrap().parts.scene().with_edge_points(100);
    for seed in 0..5 {
        let model = drawn(&scene, &[[3e-3, -2e-3], [-1e-3, 3e-3]], seed);
        let contours = adjust(&model, scene.truth.clone(), &AdjustOptions::default(), &mut |_| true);
        let options = AdjustOptions::default();
        let tangents = adjust_tangents(&contours.model, contours.state.clone(), &options, &mut |_| true).unwrap();
        let (a, b) = (named_covariance(&contours).unwrap(), named_covariance(&tangents.adjustment).unwrap());
        for camera in ["left", "right"] {
            for what in ["f_px", "cx_px", "k1"] {
                let name = format!("{camera}.{what}");
                let k = usize::from(camera == "right");
                let at = intrinsic(what);
                let value = |c: &crate::bundle::NamedCovariance| c.natural.cameras[k].intrinsics().to_array()[at];
                let (apart, sigma) = (value(&a) - value(&b), a.sigma(&name).unwrap());
                let ratio = b.sigma(&name).unwrap() / sigma;
                println!("{name}: {:.3} sigmas apart, sigma {ratio:.4} of the contours'", apart / sigma);
                // A contour bent by the lens is no ellipse, which says something of the lens, too: what an estimate without that is off by is independent
                // of the better one.
                assert!((0.999..1.15).contains(&ratio), "{name}: {ratio}");
                let expected = sigma * (ratio * ratio - 1.0).max(0.0).sqrt();
                assert!(apart.abs() < 3.5 * expected + 0.02 * sigma, "{name}: {apart} of {expected}, sigma {sigma}");
            }
        }
    }
}

fn intrinsic(name: &str) -> usize {
    crate::camera::INTRINSIC_NAMES.iter().position(|n| *n == name).unwrap()
}

/// A glint on one rim hardly moves what all images say, where the loss is one that bends.
#[test]
fn a_bad_arc_is_not_taken_for_an_oval() {
    let ovals = [[2e-3, -1e-3], [-1e-3, 2e-3]];
    let scene = Reference::of("A").unwrap().parts.scene().with_edge_points(100);
    let estimate = |bad: bool| {
        let mut model = drawn(&scene, &ovals, 8);
        model.loss = Loss::Huber(2.0);
        let edge = &mut model.images[3].discs[0].edge;
        // A tenth of the rim, 50 sigmas off.
        (0..if bad { 10 } else { 0 }).for_each(|i| edge.u_px[i] += 50.0 * SIGMA_PX);
        let found = adjust(&model, scene.truth.clone(), &AdjustOptions::default(), &mut |_| true);
        assert_eq!(found.termination, Termination::Converged);
        let sigma = named_covariance(&found).unwrap().sigma("left.f_px").unwrap();
        (found.state.ovals_mm.clone(), found.state.cameras[0].f_px, sigma)
    };
    let ((clean, f, sigma), (bad, moved_f, _)) = (estimate(false), estimate(true));
    println!("{clean:?} {bad:?}, f {f} {moved_f} +- {sigma}");
    for (a, b) in clean.iter().flatten().zip(bad.iter().flatten()) {
        assert!((a - b).abs() < 3e-4, "{a} {b}");
    }
    assert!((f - moved_f).abs() < 2.0 * sigma, "{f} {moved_f} {sigma}");
}

/// One view of one camera does not tell how large ovals are: what is assumed is said. Six of two cameras tell.
#[test]
fn what_images_do_not_tell_is_assumed_in_words() {
    let scene = Reference::of("A").unwrap().parts.scene().with_edge_points(100);
    let model = drawn(&scene, &[[1e-3, 0.0], [0.0, 1e-3]], 9);
    let told = adjust(&model, scene.truth.clone(), &AdjustOptions::default(), &mut |_| true);
    assert!(told.ovality_assumed_mm.is_none());
    let (mut few, mut start) = (model, scene.truth.clone());
    few.images.retain(|i| i.camera == 0 && i.view == 0);
    few.views.truncate(1);
    start.views.truncate(1);
    few.facts.retain(|f| !matches!(f, crate::bundle::Fact::Intrinsic { camera: 1, .. }));
    few.cameras.truncate(1);
    start.cameras.truncate(1);
    start.camera_from_first.truncate(1);
    few.cameras[0].free = [false; 10];
    few.cameras[0].free[0] = true;
    let found = adjust(&few, start, &AdjustOptions::default(), &mut |_| true);
    let assumed = found.ovality_assumed_mm.unwrap();
    assert!((1e-4..2e-2).contains(&assumed), "{assumed}");
    let words = named_covariance(&found).unwrap().undetermined;
    assert!(words.iter().any(|w| w.starts_with("how round the two printed discs are is not determined")), "{words:?}");
}

/// Which of two discs of one size is the first may differ from view to view: each contour counts by itself.
#[test]
fn discs_of_one_size_share_nothing() {
    let mut parts = Reference::of("A").unwrap().parts;
    parts.shape_mm[2] = parts.shape_mm[1];
    parts.views.iter_mut().for_each(|v| v.shape_mm = parts.shape_mm);
    let scene = parts.scene();
    let (mut model, mut state) = (drawn(&scene, &[[3e-3, 0.0], [0.0, 3e-3]], 1), scene.truth.clone());
    assert!(find(&mut model, &mut state).changed);
    assert!(state.ovals_mm.is_empty() && model.target.oval_sigma_mm.is_none());
    assert!(model.images.iter().flat_map(|i| &i.discs).all(|d| d.tie.is_none() && !d.outline.is_none()));
}

/// Bubbles and grids keep their own ways, and round discs no ovals.
#[test]
fn who_has_ovals_of_its_own() {
    let ovals = [[3e-3, 0.0], [0.0, 3e-3]];
    let scene = Scene::build(4, false, true, false);
    let (mut model, mut state) = (drawn(&scene, &ovals, 1), scene.truth.clone());
    let found = find(&mut model, &mut state);
    assert!(found.changed && found.ovality_mm.is_some());
    assert_eq!(state.ovals_mm.len(), 2);
    assert!(model.images.iter().flat_map(|i| &i.discs).all(|d| d.tie.is_some() && d.outline.is_none()));
    // A model that knows is left as it is.
    let before = model.clone();
    assert_eq!(find(&mut model, &mut state), Outlines::default());
    assert_eq!(model, before);
    // Without ovals none are shown.
    let (mut model, mut state) = (drawn(&scene, &[[0.0; 2]; 2], 1), scene.truth.clone());
    let found = find(&mut model, &mut state);
    assert!(found.ovality_mm.is_none());
    assert_eq!(found.changed, model.target.oval_sigma_mm.is_some());
    assert_eq!(state.ovals_mm.len(), if found.changed { 2 } else { 0 });
    let bubbles = Scene::build(4, true, true, false);
    let (mut model, mut state) = (drawn(&bubbles, &ovals, 1), bubbles.truth.clone());
    assert!(find(&mut model, &mut state).changed);
    assert!(state.ovals_mm.is_empty() && model.images.iter().flat_map(|i| &i.discs).all(|d| d.tie.is_none()));
}
