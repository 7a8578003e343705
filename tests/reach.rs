//! Where equations bend, the profile of the likelihood tells how far a number may be: against adjustments with the number given, and against noise drawn anew.
//! Exact contours of the paper's geometry.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use nalgebra::{DVector, Matrix3};
use rig_scene::{Grid, Scene, adjusted, diagnosed, drawn, given_sigmas, tilted_camera};
use spivcal::bundle::{Adjustment, Fact, Natural, Numbers, Reach, adjust, named_covariance};
use spivcal::camera::Camera;
use spivcal::sheet::StereoSheet;
use spivcal::stats::NORMAL_95;

/// Cameras of the paper's geometry, with tilted sensors or without, through lenses that distort so much.
fn cameras(tilted: bool, k1: f64) -> Vec<Camera> {
    let of = |c: Camera| {
        let mut i = *c.intrinsics();
        i.k[0] = k1;
        if !tilted {
            (i.alpha_rad, i.beta_rad) = (0.0, 0.0);
        }
        Camera::new(i).unwrap()
    };
    [tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)].map(of).into()
}

const PLATE: Grid = Grid { columns: 5, rows: 5, pitch_mm: 5.0, radius_mm: 1.5, print_error_mm: 0.0, turn: 1.0 };

/// Two discs, held otherwise in each of six views, seen by cameras that are not tilted, which nobody knows: where the sensors' normals meet them hangs on the axis
/// points, and these on lenses that distort by little.
fn bent_scene() -> Scene {
    bent(false)
}

/// With a view in the sheet or without one.
fn bent(sheet: bool) -> Scene {
    let mut parts = Scene::parts(3, cameras(false, 0.08), false, sheet, false);
    for fact in &mut parts.facts {
        if let Fact::Intrinsic { sigma, .. } = fact {
            *sigma = 100.0;
        }
    }
    parts.scene()
}

/// Axis points and k1 of both cameras, by their places among the intrinsics.
const AXIS_POINTS: [(usize, usize); 6] = [(0, 2), (0, 3), (0, 6), (1, 2), (1, 3), (1, 6)];

fn axis_points(n: &Natural) -> Option<DVector<f64>> {
    Some(DVector::from_iterator(6, AXIS_POINTS.iter().map(|(c, k)| n.cameras[*c].intrinsics().to_array()[*k])))
}

/// Values and standard deviations of the axis points.
fn told(a: &Adjustment) -> [Vec<f64>; 2] {
    let covariance = named_covariance(a).unwrap();
    let names = ["cx_px", "cy_px", "k1"].map(String::from);
    let sigma = |camera: &str, what: &str| covariance.sigma(&format!("{camera}.{what}")).unwrap();
    let of = |camera: &'static str| names.iter().map(move |what| (camera, what.clone()));
    let sigmas = of("left").chain(of("right")).map(|(camera, what)| sigma(camera, &what)).collect();
    [axis_points(&covariance.natural).unwrap().as_slice().to_vec(), sigmas]
}

/// The same chi-square as an adjustment which is told the number as a fact.
#[test]
fn a_profile_is_the_adjustment_with_the_number_given() {
    let a = adjusted(&drawn(&bent_scene(), 1));
    let [values, sigmas] = told(&a);
    let reach = Reach::of(&a, Numbers { of: &axis_points, values: &values, sigmas: &sigmas });
    let mut bent: f64 = 0.0;
    for (k, (camera, parameter)) in AXIS_POINTS.into_iter().enumerate() {
        for t in [-2.0, -0.7, 1.3] {
            let (value, sigma) = (values[k] + t * sigmas[k], 1e-4 * sigmas[k]);
            let mut model = a.model.clone();
            model.facts.push(Fact::Intrinsic { camera, parameter, value, sigma });
            let given = adjust(&model, a.state.clone(), &given_sigmas(), &mut |_| true);
            let wanted = t.signum() * (2.0 * (given.cost - a.cost)).sqrt();
            let root = reach.root(k, t, &|_| true).unwrap();
            assert!((root - wanted).abs() < 0.01, "number {k} at {t}: {root}, {wanted}");
            bent = bent.max((wanted / t - 1.0).abs());
        }
    }
    assert!(bent > 0.1, "roots are those of linear equations: {bent}");
}

/// Of a plate of many dots a standard deviation is as good as it looks, and an interval is 1.96 of them.
#[test]
fn where_nothing_bends_intervals_are_those_of_the_standard_deviations() {
    let a = adjusted(&drawn(&Scene::with_grid(3, cameras(true, -0.3), PLATE, false), 1));
    let [values, sigmas] = told(&a);
    let reach = Reach::of(&a, Numbers { of: &axis_points, values: &values, sigmas: &sigmas });
    let bend = reach.bend().unwrap();
    println!("{bend:?}");
    assert!(bend.iter().all(|b| *b < 0.05), "{bend:?}");
    for k in 0..values.len() {
        let [low, high] = reach.interval(k, &|_| true).map(|x| (x.unwrap() - values[k]) / sigmas[k]);
        assert!((low + 1.96).abs() < 0.08 && (high - 1.96).abs() < 0.08, "{k}: {low} {high}");
    }
}

/// What is felt in the sheet, with noise drawn anew: where equations bend it is further off than standard deviations say, and no further than the likelihood says.
#[test]
fn what_is_felt_is_told_where_equations_bend() {
    let truth = bent(true);
    let reference = StereoSheet::of(&named_covariance(&adjusted(&truth)).unwrap()).unwrap();
    let (rounds, mut told) = (30, 0);
    // Squares of u, v and w in the middle, and at worst over the sheet, over what is stated and over what is told.
    let mut sums = [[[0.0; 2]; 3]; 2];
    for seed in 0..rounds {
        let a = adjusted(&drawn(&truth, seed));
        let own = StereoSheet::of(&named_covariance(&a).unwrap()).unwrap();
        let m = diagnosed(&a).mapping.unwrap();
        told += usize::from(m.by_likelihood.is_some());
        let off = |p: [f64; 2]| own.response(&reference, p).unwrap().measured_from_true - Matrix3::identity();
        let everywhere: Vec<_> = m.map.x_mm.iter().zip(&m.map.y_mm).map(|(x, y)| off([*x, *y])).collect();
        let (middle, worst) = (off(m.middle.point_mm), m.at_worst());
        for i in 0..3 {
            let stated = m.middle.displacement[i][i];
            let most = everywhere.iter().map(|e| e[(i, i)].abs()).fold(0.0, f64::max);
            let added = m.by_likelihood.as_ref().map_or(0.0, |bent| bent.displacement[i][i]);
            for (sum, e, sigma, larger) in [
                (0, middle[(i, i)], stated, stated.hypot(added)),
                (1, most, m.largest.displacement[i][i], worst.displacement[i][i]),
            ] {
                sums[sum][i][0] += (e / sigma).powi(2) / f64::from(rounds as u32);
                sums[sum][i][1] += (e / larger).powi(2) / f64::from(rounds as u32);
            }
        }
    }
    println!(
        "{told} of {rounds} told; mean squares over stated, over told, of u, v, w: in the middle {:?}, at worst {:?}",
        sums[0], sums[1]
    );
    assert!(2 * told > rounds as usize);
    let [stated, told] = [0, 1].map(|k| sums[0].map(|of| of[k]));
    assert!(stated[0] > 2.2 && told.iter().all(|square| *square < 2.0), "{stated:?} {told:?}");
    assert!(sums[1].iter().all(|[stated, told]| told <= stated && *told < 3.0), "{:?}", sums[1]);
}

/// Effective principal points of both cameras, by their places among the key quantities.
const PRINCIPAL_POINTS: [usize; 4] = [1, 2, 4, 5];

/// Noise drawn anew: standard deviations leave out the true number twice as often as they say, the diagnosis's intervals as often as they say.
#[test]
fn intervals_hold_the_truth_where_standard_deviations_do_not() {
    let scene = bent_scene();
    let camera = |c: &Camera| [c.effective_pinhole().cx_px, c.effective_pinhole().cy_px];
    let truth: Vec<f64> = scene.cameras.iter().flat_map(camera).collect();
    let rounds = 150;
    let (mut linear, mut outside, mut bent, mut open) = (0, 0, 0, 0);
    for seed in 0..rounds {
        let keys = diagnosed(&adjusted(&drawn(&scene, seed))).diagnosis.key_quantities;
        for (key, truth) in PRINCIPAL_POINTS.map(|k| &keys[k]).into_iter().zip(&truth) {
            let [low, high] = key.interval_95.unwrap();
            linear += usize::from((truth - key.value).abs() > NORMAL_95 * key.sigma);
            outside += usize::from(low.is_some_and(|x| *truth < x) || high.is_some_and(|x| *truth > x));
            open += usize::from(low.is_none() || high.is_none());
            bent += usize::from(key.bends());
        }
    }
    let n = 4 * rounds as usize;
    println!("of {n}: outside 1.96 sigma {linear}, outside the interval {outside}; {bent} bent, {open} open");
    // 30 of 600, four numbers of one set of noise together.
    assert!(linear > 45 && (12..46).contains(&outside) && 2 * outside < 3 * linear, "{linear} {outside}");
    assert!(bent > n / 2 && open < n / 50, "{bent} {open}");
}
