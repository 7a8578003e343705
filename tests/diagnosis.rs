//! The diagnosis against truth: false alarms at the stated rate, real departures found, predictions confirmed by adjustments, and
//! the uncertainty of mapping and displacements as sampled. Exact contours of the paper's geometry with noise drawn anew.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use nalgebra::{Matrix3, Vector3};
use rig_scene::{Noise, Scene, adjusted, diagnosed, drawn, given_sigmas, tilted_camera};
use spivcal::bundle::{AdjustOptions, PlanePosition, TargetShape, ViewPlace};
use spivcal::bundle::{Adjustment, Extension, Fact, PriorOf, adjust, extension_tests, named_covariance, prior_checks};
use spivcal::camera::{Camera, Intrinsics};
use spivcal::rigid::{Motion, rotation_exp};
use spivcal::sheet::StereoSheet;
use spivcal::stats::chi_square_above;

/// A grid whose dots are where they should be and are not estimated.
fn plate() -> Scene {
    let mut scene = Scene::build(5, false, true, true);
    let mut flat = scene.truth.clone();
    flat.offsets_mm.iter_mut().for_each(|o| *o = [0.0; 4]);
    scene = scene.with_offsets(&flat.offsets_mm);
    scene.truth.offsets_mm.clear();
    scene.model.target.offset_sigma_mm = None;
    scene
}

fn test_of(a: &Adjustment, wanted: Extension) -> spivcal::bundle::ExtensionTest {
    extension_tests(a).unwrap().list.into_iter().find(|t| t.extension == wanted).expect("the test was made")
}

/// Where the model is true, p-values are uniform: as many below 0.05, 0.2 and 0.5 as chance allows, and priors have standard normal z.
#[test]
fn false_alarms_come_at_the_stated_rate() {
    let truth = plate();
    let runs = 60;
    let (mut p_values, mut z) = (vec![], vec![]);
    for seed in 0..runs {
        let a = adjusted(&drawn(&truth, 7 + seed));
        let tests = extension_tests(&a).unwrap().list;
        // k2, aspect and pupil ratio of each camera, the bend, the displacements.
        assert_eq!(tests.len(), 8);
        // Tests of both cameras and of a plate are nearly independent of each other.
        p_values.push(tests.iter().map(|t| chi_square_above(t.statistic, t.degrees as f64)).collect::<Vec<_>>());
        z.extend(prior_checks(&a).unwrap().iter().filter_map(|c| c.z()));
    }
    for k in 0..8 {
        for level in [0.05, 0.2, 0.5] {
            let n = runs as f64;
            let below = p_values.iter().filter(|p| p[k] < level).count() as f64;
            let sigmas = (below - n * level) / (n * level * (1.0 - level)).sqrt();
            println!("test {k}: {below} of {n} below {level} ({sigmas:.2} sigmas)");
            // 24 questions asked together: 3.4 sigmas are passed by chance once in 60.
            assert!(sigmas.abs() < 3.4, "test {k}: {below} of {n} below {level}");
        }
    }
    let n = z.len() as f64;
    let square = z.iter().map(|z| z * z).sum::<f64>() / n;
    println!("priors: mean z^2 {square:.3} over {n}");
    // Four priors per run, correlated in pairs at worst.
    assert!((square - 1.0).abs() < 3.0 * (2.0 * 2.0 / n).sqrt(), "{square}");
}

/// A lens with k2, a plate bent by 30 um and dots displaced by 10 um are each found, with their size.
#[test]
fn what_is_missing_in_the_model_is_found() {
    let nodes = plate();
    let pitch = nodes.truth.shape_mm[0];
    let bent: Vec<[f64; 4]> = (0..9)
        .map(|k| {
            let (x, y) = (f64::from(k % 3) - 1.0, f64::from(k / 3) - 1.0);
            [0.0, 0.0, 0.03 * x * x + 0.01 * x * y, 0.0]
        })
        .collect();
    let a = adjusted(&drawn_with(&nodes, &bent, 3));
    let t = test_of(&a, Extension::BentTarget);
    println!("bent: {t:?}, pitch {pitch}");
    assert!(chi_square_above(t.statistic, t.degrees as f64) < 1e-6);
    // 0.03 x^2 + 0.01 x y beside a plane: from -0.02 - 0.01 to 0.01 + 0.01 at the corners.
    assert!((t.size - 0.04).abs() < 4.0 * t.sigma + 0.002, "{} {}", t.size, t.sigma);

    let mut noise = Noise::new(99);
    let moved: Vec<[f64; 4]> = (0..9).map(|_| [0.01 * noise.normal(), 0.01 * noise.normal(), 0.0, 0.0]).collect();
    let a = adjusted(&drawn_with(&nodes, &moved, 4));
    let t = test_of(&a, Extension::DisplacedDiscs);
    // 18 numbers less the six of a smooth (here affine) field.
    assert_eq!(t.degrees, 12);
    assert!(chi_square_above(t.statistic, t.degrees as f64) < 1e-6 && (0.004..0.02).contains(&t.size), "{t:?}");
    // Sigmas that follow the scatter of discs do not hold what is alike in all images: told, whatever result it moves.
    let scene = drawn_with(&nodes, &moved, 4);
    let scattered = adjust(&scene.model, scene.truth.clone(), &AdjustOptions::default(), &mut |_| true);
    let enlarged = scattered.model.images.iter().map(|i| i.sigma_scale).fold(1.0, f64::max);
    let told = diagnosed(&scattered).flags;
    println!("enlarged {enlarged:.1}: {told:?}");
    let alike = |f: &String| f.contains("by the same in all images") && f.contains("adjust = \"points\"");
    assert!(enlarged > 1.5 && told.iter().any(alike), "{enlarged}: {told:?}");

    let mut cameras = nodes.cameras.clone();
    let mut i = *cameras[1].intrinsics();
    i.k[1] = 2000.0;
    cameras[1] = Camera::new(i).unwrap();
    let mut scene = Scene::with_cameras(5, cameras, false, true, false);
    let lens = scene.truth.clone();
    scene = drawn(&scene, 11);
    // Adjusted without k2.
    let mut start = lens;
    start.cameras[1].k[1] = 0.0;
    let a = adjust(&scene.model, start.clone(), &given_sigmas(), &mut |_| true);
    let t = test_of(&a, Extension::Intrinsic { camera: 1, parameter: 7 });
    let other = test_of(&a, Extension::Intrinsic { camera: 0, parameter: 7 });
    println!("k2: {t:?}\nof the other: {other:?}");
    assert!(chi_square_above(t.statistic, 1.0) < 1e-6, "{t:?}");
    assert!(other.statistic < 0.25 * t.statistic, "{other:?}");
    // The likelihood ratio of an adjustment with k2, and its estimate, agree with the score.
    scene.model.cameras[1].free[7] = true;
    let full = adjust(&scene.model, a.state.clone(), &given_sigmas(), &mut |_| true);
    let ratio = 2.0 * (a.cost - full.cost);
    println!("score {}, likelihood ratio {ratio}, k2 {} and {}", t.statistic, t.size, full.state.cameras[1].k[1]);
    assert!((t.statistic / ratio - 1.0).abs() < 0.3, "{} {ratio}", t.statistic);
    assert!((t.size / full.state.cameras[1].k[1] - 1.0).abs() < 0.3);
}

/// Of a lens term that is lacking others explain a part, and it a part of what dots off their places do: only the cause is a flag, and the rest says what
/// goes first.
#[test]
fn what_another_lack_explains_is_no_flag() {
    let (mut flagged, mut others, mut taken) = (0, [0, 0], 0);
    for seed in 0..8 {
        let nodes = plate();
        let lens = |c: &Camera| {
            let own = *c.intrinsics();
            Camera::new(Intrinsics { k: [own.k[0], 2000.0, 0.0], ..own }).unwrap()
        };
        let mut bent = Scene::with_cameras(5, nodes.cameras.iter().map(lens).collect(), false, true, true);
        bent = bent.with_offsets(&vec![[0.0; 4]; 9]);
        bent.truth.offsets_mm.clear();
        bent.model.target.offset_sigma_mm = None;
        let mut scene = drawn(&bent, 70 + seed);
        scene.truth.cameras.iter_mut().for_each(|c| c.k[1] = 0.0);
        let of_lens = diagnosed(&adjusted(&scene));
        let mut noise = Noise::new(40 + seed);
        let off: Vec<[f64; 4]> = (0..9).map(|_| [0.004 * noise.normal(), 0.004 * noise.normal(), 0.0, 0.0]).collect();
        let of_dots = diagnosed(&adjusted(&drawn_with(&nodes, &off, seed)));
        for (k, (f, cause)) in
            [(of_lens, "distortion k2"), (of_dots, "off their nominal places")].into_iter().enumerate()
        {
            let of_model =
                |w: &&String| ["images ask for", "plate is bent", "off their nominal"].iter().any(|x| w.contains(x));
            let (own, other): (Vec<&String>, Vec<&String>) =
                f.flags.iter().filter(of_model).partition(|w| w.contains(cause));
            println!("{cause}, seed {seed}: {} flags, beside them {other:#?}", own.len());
            flagged += usize::from(!own.is_empty());
            others[k] += other.len();
            taken += f.diagnosis.model_tests.iter().filter(|t| t.words.contains("; not beside ")).count();
        }
    }
    println!("{flagged} of 16 causes are flags, {others:?} others are, {taken} are not beside them");
    // The stretch of dots that are off their places is as well one of a sensor whose pixels are not square.
    assert!(flagged == 16 && taken > 30 && others[0] <= 4 && others[1] < taken / 3, "{flagged} {others:?} {taken}");
}

/// A lens with k2 and k3, adjusted with k1 alone: both are asked for at once, k3 by what an adjustment with both explains beyond one with k2; of a lens
/// without k3 it is not.
#[test]
fn k3_is_asked_for_beside_k2() {
    for (k3, seed) in [(-3e6, 12), (0.0, 13)] {
        let mut cameras = plate().cameras.clone();
        let mut i = *cameras[1].intrinsics();
        (i.k[1], i.k[2]) = (2000.0, k3);
        cameras[1] = Camera::new(i).unwrap();
        let scene = Scene::with_cameras(5, cameras, false, true, false);
        let mut start = scene.truth.clone();
        (start.cameras[1].k[1], start.cameras[1].k[2]) = (0.0, 0.0);
        let mut scene = drawn(&scene, seed);
        let a = adjust(&scene.model, start, &given_sigmas(), &mut |_| true);
        let all = extension_tests(&a).unwrap().list;
        let of = |camera: usize, parameter: usize| {
            let wanted = Extension::Intrinsic { camera, parameter };
            all.iter().find(|t| t.extension == wanted)
        };
        assert!(of(0, 8).is_none() && chi_square_above(of(1, 7).unwrap().statistic, 1.0) < 1e-6);
        let t = of(1, 8).unwrap();
        let mut with = |free: usize| {
            scene.model.cameras[1].free[free] = true;
            adjust(&scene.model, a.state.clone(), &given_sigmas(), &mut |_| true)
        };
        let (k2, both) = (with(7), with(8));
        let ratio = 2.0 * (k2.cost - both.cost);
        println!(
            "k3 {k3}: score {}, likelihood ratio {ratio}, k3 {} and {}",
            t.statistic, t.size, both.state.cameras[1].k[2]
        );
        let asked = diagnosed(&a)
            .diagnosis
            .model_tests
            .into_iter()
            .find(|t| t.question.contains("k3 of camera right"))
            .unwrap();
        assert!(asked.question.ends_with("needed beside k2?"), "{}", asked.question);
        assert_eq!(asked.needed, k3 != 0.0, "{asked:?}");
        if k3 != 0.0 {
            assert!((t.statistic / ratio - 1.0).abs() < 0.4 && (t.size / both.state.cameras[1].k[2] - 1.0).abs() < 0.4);
            assert!(asked.words.starts_with("the images ask for distortion k3"), "{}", asked.words);
        }
    }
}

fn drawn_with(scene: &Scene, offsets: &[[f64; 4]], seed: u64) -> Scene {
    let mut out = scene.with_offsets(offsets);
    out.model.target.offset_sigma_mm = None;
    out.truth.offsets_mm.clear();
    drawn(&out, seed)
}

/// Leaving a view out: the prediction from the normal equations is what an adjustment without it finds, and z is standard normal where
/// the view agrees. What happens where one does not: `tests/wrong_view.rs`.
#[test]
fn views_left_out_are_predicted() {
    let truth = Scene::build(21, false, true, false);
    let (mut z, mut alarms) = (vec![], 0);
    for seed in 0..20 {
        let f = diagnosed(&adjusted(&drawn(&truth, 300 + seed)));
        assert_eq!(f.diagnosis.views.len(), 6);
        for v in &f.diagnosis.views {
            assert!(v.sigma_growth > 0.999, "{v:?}");
            // One Newton step: the problem bends within these changes of about a sigma.
            let slack = 0.2 + 0.3 * v.shift_sigmas;
            assert!((v.predicted_shift_sigmas - v.shift_sigmas).abs() < slack, "{v:?}");
            z.push(v.z.abs());
            alarms += usize::from(v.contradicts);
        }
    }
    println!("{alarms} alarms in 20 rigs; largest z {:.2}", z.iter().copied().fold(0.0, f64::max));
    assert!(alarms <= 2, "{alarms} alarms where 0.2 are expected");
    // The largest of about eleven correlated normal numbers has its median near 1.8.
    z.sort_by(f64::total_cmp);
    let median = z[z.len() / 2];
    assert!((1.0..2.6).contains(&median), "{median}");
}

/// A focal length stated 5 sigmas off, and an axis point 13 sigmas off, are told in words; true ones are not.
#[test]
fn a_wrong_prior_is_told() {
    let truth = Scene::build(21, false, true, false);
    let stated = |value: f64, sigma: f64| {
        let mut scene = drawn(&truth, 500);
        scene.model.facts.push(Fact::Intrinsic { camera: 0, parameter: 0, value, sigma });
        diagnosed(&adjusted(&scene))
    };
    let right = stated(8889.0 + 60.0, 90.0);
    assert!(right.flags.is_empty(), "{:?}", right.flags);
    let wrong = stated(8889.0 + 450.0, 90.0);
    println!("{:?}", wrong.flags);
    assert!(
        wrong
            .flags
            .iter()
            .any(|f| f.contains("focal length f of camera left") && f.contains("standard deviations apart"))
    );
    let prior = wrong.diagnosis.priors.iter().find(|p| p.name.contains("focal length")).unwrap();
    // What the images alone say is what an adjustment without the prior finds.
    let free = named_covariance(&adjusted(&drawn(&truth, 500))).unwrap();
    let (f, sigma) = (free.natural.cameras[0].intrinsics().f_px, free.sigma("left.f_px").unwrap());
    println!("images alone {} ± {}, adjusted {f} ± {sigma}", prior.images_alone, prior.images_alone_sigma);
    assert!((prior.images_alone - f).abs() < 0.3 * sigma && (prior.images_alone_sigma / sigma - 1.0).abs() < 0.1);
    assert!((prior.z.abs() - (9339.0 - f) / 90_f64.hypot(sigma)).abs() < 0.1);
    let mut scene = drawn(&truth, 501);
    for fact in &mut scene.model.facts {
        if let Fact::Intrinsic { camera: 1, parameter: 2, value, .. } = fact {
            *value = 520.0 + 13.0 * 50.0;
        }
    }
    let flags = diagnosed(&adjusted(&scene)).flags;
    assert!(flags.iter().any(|f| f.contains("axis point cx of camera right")), "{flags:?}");
}

/// Positions along a traverse stand among the priors: each check is about what it says, also those that follow, and a position stated
/// 8 sigmas off is told.
#[test]
fn a_wrong_position_on_the_traverse_is_told() {
    const SIGMA_MM: f64 = 0.02;
    let positions = [None, None, None, Some(-4.0), Some(0.0), Some(5.0)];
    let mut scene = Scene::parts(5, plate().cameras, false, true, true);
    for (view, z) in scene.views.iter_mut().zip(positions) {
        let known = PlanePosition::About { sigma_mm: SIGMA_MM };
        let Some(z_mm) = z else { continue };
        let sheet = scene.rig_from_sheet.unwrap();
        let mut planar = sheet.inverse() * view.rig_from_target;
        let spin = planar.rotation.m21.atan2(planar.rotation.m11);
        // The target's z axis is the sheet's in all views of the scene.
        planar = Motion::new(rotation_exp(&Vector3::new(0.0, 0.0, spin)), planar.translation_mm);
        planar.translation_mm.z = z_mm;
        (view.rig_from_target, view.place) = (sheet * planar, ViewPlace::InPlane { z_mm, known });
    }
    let scene = scene.scene();
    let mut right = drawn(&scene, 12);
    let a = adjusted(&right);
    let checks = prior_checks(&a).unwrap();
    let at: Vec<usize> =
        checks.iter().filter_map(|c| if let PriorOf::Position { view } = c.of { Some(view) } else { None }).collect();
    assert_eq!(at, [3, 4, 5]);
    let mut discs = 0;
    for c in &checks {
        let residual = match c.of {
            PriorOf::Position { view } => {
                let z = a.state.views[view].plane_from_target.unwrap().translation_mm.z;
                (z - positions[view].unwrap()) / SIGMA_MM
            }
            PriorOf::Disc { disc, part } => {
                discs += 1;
                a.state.offsets_mm[disc][part] / [0.02, 0.02, 0.02, 0.01][part]
            }
            PriorOf::Fact { .. } | PriorOf::Oval { .. } => continue,
        };
        assert!((c.residual - residual).abs() < 1e-12, "{c:?} {residual}");
        assert!(c.share > 0.0 && c.share < 1.0, "{c:?}");
    }
    assert_eq!(discs, 4 * 9);
    assert!(diagnosed(&a).flags.iter().all(|f| !f.contains("traverse")), "{:?}", diagnosed(&a).flags);
    if let ViewPlace::InPlane { z_mm, .. } = &mut right.model.views[4].place {
        *z_mm += 8.0 * SIGMA_MM;
    }
    let f = diagnosed(&adjusted(&right));
    println!("{:#?}", f.flags);
    assert!(f.flags.iter().any(|f| f.contains("of view") && f.contains("along the traverse")), "{:?}", f.flags);
}

/// Without a tilted view nothing but the weak prior tells tilt from axis point; without distortion the pair of numbers is named.
#[test]
fn weak_directions_are_named() {
    let cameras = [-0.11, 0.11].map(|beta| {
        let mut i = *rig_scene::tilted_camera(beta, 0.01).intrinsics();
        i.k[0] = 0.0;
        Camera::new(i).unwrap()
    });
    let mut scene = Scene::with_cameras(21, cameras.to_vec(), false, true, false);
    scene.model.cameras.iter_mut().for_each(|c| c.free[6] = false);
    for fact in &mut scene.model.facts {
        if let Fact::Intrinsic { sigma, .. } = fact {
            *sigma = 100.0;
        }
    }
    let f = diagnosed(&adjusted(&drawn(&scene, 2)));
    let words: Vec<&String> = f.near_null.iter().map(|n| &n.words).collect();
    println!("{words:#?}");
    assert!(f.near_null.len() >= 4, "four exact directions, each held by its prior: {words:?}");
    assert!(words.iter().any(|w| w.contains("tilt beta of camera left") && w.contains("axis point cx of camera left")));
    assert!(f.diagnosis.priors.iter().all(|p| p.sigma_ratio > 0.99), "{:?}", f.diagnosis.priors);
    // The exchange of tilt and axis point moves neither disparity nor gain.
    let m = f.mapping.unwrap();
    assert!(m.undetermined.is_empty() && m.largest.out_of_plane_gain.is_finite(), "{:?}", m.undetermined);
}

/// Displacements, disparity and places as sampled: mean squares over the predicted variances are 1 within their scatter.
#[test]
fn what_a_user_feels_is_what_repeated_calibrations_show() {
    let truth = Scene::build(21, false, true, false);
    let runs = 40_u32;
    // The truth as a calibration of its own, from exact contours.
    let exact = named_covariance(&adjusted(&truth)).unwrap();
    let reference = StereoSheet::of(&exact).unwrap();
    let (mut w, mut u, mut leak, mut gain, mut disparity, mut place) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for seed in 0..runs {
        let a = adjusted(&drawn(&truth, 900 + u64::from(seed)));
        let covariance = named_covariance(&a).unwrap();
        let m = diagnosed(&a).mapping.unwrap();
        let point = m.middle.point_mm;
        let own = StereoSheet::of(&covariance).unwrap();
        let r = own.response(&reference, point).unwrap();
        let e = r.measured_from_true - Matrix3::identity();
        let of = |i: usize, j: usize| (e[(i, j)] / m.middle.displacement[i][j]).powi(2);
        (w, u, leak) = (w + of(2, 2), u + of(0, 0), leak + of(0, 2));
        gain += ((r.relative_gain() - 1.0) / m.middle.out_of_plane_gain).powi(2);
        disparity += r.disparity_px.norm_squared() / m.middle.disparity_px.powi(2);
        place += placed(&own, &reference, &m);
    }
    let n = f64::from(runs);
    for (name, sum, degrees) in [
        ("u per u", u, 1.0),
        ("w per w", w, 1.0),
        ("w into u", leak, 1.0),
        ("gain", gain, 1.0),
        ("disparity", disparity, 1.0),
        ("place", place, 1.0),
    ] {
        let mean: f64 = sum / n;
        let z = (mean - 1.0) / (2.0 / (degrees * n)).sqrt();
        println!("{name}: mean square over variance {mean:.3} ({z:.2} sigmas)");
        assert!(z.abs() < 3.3, "{name}: {mean}");
    }
}

/// Lenses with a little k2, which cameras, motion and the middle of the sheet hide within their sigmas, but not what is measured away from it: wherever u, v or
/// w is off by more than its sigma allows, and k2 is asked for, it is a flag.
#[test]
fn what_is_felt_away_from_the_middle_is_a_flag() {
    let (mut felt, mut by_keys) = (0, 0);
    for k2 in [100.0, 200.0, 400.0, 800.0] {
        for seed in 0..4 {
            let lens = |x, y| {
                let own = *tilted_camera(x, y).intrinsics();
                Camera::new(Intrinsics { k: [own.k[0], k2, 0.0], ..own }).unwrap()
            };
            let exact = Scene::with_cameras(21, vec![lens(-0.1107, 0.01), lens(0.1107, -0.02)], false, true, false);
            let mut with_k2 = exact.clone();
            with_k2.model.cameras.iter_mut().for_each(|c| c.free[7] = true);
            let reference = StereoSheet::of(&named_covariance(&adjusted(&with_k2)).unwrap()).unwrap();
            let mut scene = drawn(&exact, 60 + seed);
            scene.truth.cameras.iter_mut().for_each(|c| c.k[1] = 0.0);
            let a = adjusted(&scene);
            let own = StereoSheet::of(&named_covariance(&a).unwrap()).unwrap();
            let f = diagnosed(&a);
            let m = f.mapping.as_ref().unwrap();
            let z = |p: [f64; 2]| {
                let e = own.response(&reference, p).unwrap().measured_from_true - Matrix3::identity();
                (0..3).map(|k| (e[(k, k)] / m.middle.displacement[k][k]).abs()).fold(0.0, f64::max)
            };
            // Half way to the rim: beyond lie no discs.
            let worst = m.map.x_mm.iter().zip(&m.map.y_mm).map(|(x, y)| z([0.5 * x, 0.5 * y])).fold(0.0, f64::max);
            let asked: Vec<_> =
                f.diagnosis.model_tests.iter().filter(|t| t.needed && t.question.contains("k2")).collect();
            let told = f.flags.iter().any(|w| w.contains("distortion k2"));
            println!("k2 {k2}, seed {seed}: off by {worst:.1} sigmas at worst, told {told}: {asked:?}");
            if !asked.is_empty() && worst > 10.0 {
                assert!(told, "{:#?}", f.flags);
                felt += 1;
                by_keys +=
                    usize::from(asked.iter().all(|t| f.diagnosis.key_quantities.iter().any(|k| k.name == t.bias_of)));
            }
        }
    }
    println!("{felt} of 16 felt, {by_keys} of them by a key quantity most of all");
    assert!(felt >= 4 && by_keys < felt, "{felt} {by_keys}");
}

/// Squared misplacement of the middle in the worse camera beside the common shift and turn of all points, over its variance.
fn placed(own: &StereoSheet, truth: &StereoSheet, m: &spivcal::record::MappingUncertainty) -> f64 {
    let mut points: Vec<[f64; 2]> = m.map.x_mm.iter().zip(&m.map.y_mm).map(|(x, y)| [*x, *y]).collect();
    let count = points.len();
    points.push(m.middle.point_mm);
    let misplaced: Vec<[nalgebra::Vector2<f64>; 2]> =
        points.iter().map(|p| own.response(truth, *p).unwrap().misplaced_mm).collect();
    // Least squares for shift (a, b) and turn t over both cameras, written out.
    let mut h = Matrix3::zeros();
    let mut g = nalgebra::Vector3::zeros();
    for (p, e) in points.iter().zip(&misplaced).take(count) {
        for e in e {
            for (row, value) in [([1.0, 0.0, -p[1]], e.x), ([0.0, 1.0, p[0]], e.y)] {
                let row = nalgebra::Vector3::from(row);
                h += row * row.transpose();
                g += row * value;
            }
        }
    }
    let x = h.try_inverse().unwrap() * g;
    let p = points[count];
    let fitted = nalgebra::Vector2::new(x[0] - x[2] * p[1], x[1] + x[2] * p[0]);
    let squares = misplaced[count].map(|e| (e - fitted).norm_squared());
    0.5 * (squares[0] + squares[1]) / m.middle.in_plane_mm.powi(2)
}

/// Dots that are estimated on a grid whose pitch has a standard deviation: their places have that of the pitch as well, not that of their own displacement alone.
#[test]
fn dots_are_known_no_better_than_their_pitch() {
    let mut scene = Scene::build(5, false, true, true);
    let (value_mm, sigma_mm) = (scene.truth.shape_mm[0], 0.05);
    scene.model.target.free[0] = true;
    scene.model.facts.push(Fact::Shape { parameter: 0, view: None, value_mm, sigma_mm });
    let TargetShape::Lattice(nodes) = &scene.model.target.shape else { panic!("a grid") };
    let c = named_covariance(&adjusted(&drawn(&scene, 3))).unwrap();
    let pitch_mm = c.sigmas(&[vec![("target.spacing_mm".to_string(), 1.0)]])[0];
    assert!(pitch_mm > 0.8 * sigma_mm, "{pitch_mm}");
    for ((node, found), own) in nodes.iter().zip(&c.disc_sigmas_mm).zip(&c.offset_sigmas_mm) {
        for (k, steps) in [(0, node.x), (1, node.y)] {
            let (by_pitch, own) = (steps.abs() * pitch_mm, own[k]);
            let within = (by_pitch - own).abs() - 1e-9..by_pitch + own + 1e-9;
            assert!(within.contains(&found[k]), "{} of {within:?} at {steps} pitches", found[k]);
        }
    }
}
