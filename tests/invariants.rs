//! What must hold whatever the numbers: round trips, refusals by type, the algebra of motions, and what the whole
//! calibration does when its input is shifted, scaled, mirrored or mixed up.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod rig_scene;

use nalgebra::{SVector, Vector2, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use rig_scene::Scene;
use spivcal::bundle::{AdjustOptions, Fact, NamedCovariance, SolveOptions, State, adjust, named_covariance};
use spivcal::camera::{Camera, Intrinsics, Radial, Refusal};
use spivcal::frames::{Cam, Pixel, Point, Rig, Target};
use spivcal::rig::{RigProblem, calibrate_rig};
use spivcal::rigid::{Motion, rotation_exp, rotation_log};

/// Any float, and often those that break things: huge, tiny, signed zeros, infinities, NaN.
fn ugly() -> impl Strategy<Value = f64> {
    let magnitude =
        (-308.0..308.0_f64, any::<bool>()).prop_map(|(e, s)| if s { 10_f64.powf(e) } else { -10_f64.powf(e) });
    prop_oneof![
        proptest::num::f64::ANY,
        magnitude,
        -2000.0..2000.0_f64,
        prop::sample::select(vec![
            0.0,
            -0.0,
            f64::MIN_POSITIVE,
            f64::MAX,
            f64::MIN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NAN
        ]),
    ]
}

/// Cameras that exist: tilts to 35 degrees, lenses that bend rays by up to a few per cent at the image's edge.
fn camera(thin: bool) -> impl Strategy<Value = Camera> {
    let geometry = (600.0..12_000.0_f64, 0.8..1.25_f64, -300.0..2000.0_f64, -300.0..2000.0_f64);
    let tilt = (0.0..35_f64.to_radians(), 0.0..std::f64::consts::TAU);
    let lens = (-0.5..0.5_f64, -0.4..0.4_f64, -0.3..0.3_f64, 0.6..1.6_f64, any::<bool>());
    (geometry, tilt, lens).prop_map(move |((f, aspect, cx, cy), (tilt, to), (k1, k2, k3, pupil, brown))| {
        let pupil = if thin { 1.0 } else { pupil };
        let radial = if brown || thin { Radial::IdealToDistorted } else { Radial::DistortedToIdeal };
        let p = [f, aspect, cx, cy, tilt * to.sin(), tilt * to.cos(), k1, k2, k3, pupil];
        Camera::new(Intrinsics::from_array(&p, radial)).unwrap()
    })
}

fn motion<A: std::fmt::Debug, B: std::fmt::Debug>() -> impl Strategy<Value = Motion<A, B>> {
    let w = prop::array::uniform3(-3.0..3.0_f64);
    let t = prop::array::uniform3(-2000.0..2000.0_f64);
    (w, t).prop_map(|(w, t)| Motion::new(rotation_exp(&Vector3::from(w)), Vector3::from(t)))
}

fn near<A, B>(a: &Motion<A, B>, b: &Motion<A, B>, rad: f64, mm: f64) -> bool {
    (a.rotation - b.rotation).norm() < rad && (a.translation_mm - b.translation_mm).norm() < mm
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, rng_seed: RngSeed::Fixed(20_240_607), ..ProptestConfig::default() })]

    #[test]
    fn projection_and_its_inverse_are_one_another(
        camera in camera(false), x in -0.35..0.35_f64, y in -0.3..0.3_f64, exponent in -3.0..9.0_f64
    ) {
        let z = 10_f64.powf(exponent);
        let q = camera.project(&Point::new(x * z, y * z, z)).unwrap();
        let ray = camera.unproject(q).unwrap().xyz;
        prop_assert!((ray - Vector3::new(x, y, 1.0)).norm() < 1e-12, "{ray} {x} {y}");
        let again = camera.project_xyz(&ray).unwrap();
        prop_assert!((again - Vector2::new(q.u_px, q.v_px)).norm() < 1e-8);
    }

    /// Numbers come only where they mean something, and what comes back is where it came from.
    #[test]
    fn projection_refuses_what_has_no_image(camera in camera(false), p in prop::array::uniform3(ugly())) {
        let p = Vector3::from(p);
        let image = camera.project_xyz(&p);
        prop_assert_eq!(camera.project_jet(&p).is_ok(), image.is_ok());
        prop_assert_eq!(camera.image_of_point(&p).is_ok(), image.is_ok());
        match image {
            Ok(q) => {
                prop_assert!(p.iter().all(|c| c.is_finite()) && p.z > 0.0, "{p} has an image");
                prop_assert!(q.iter().all(|c| c.is_finite()), "{p} -> {q}");
            }
            Err(Refusal::BehindCamera { depth_mm }) => prop_assert!(depth_mm <= 0.0 && depth_mm == p.z),
            Err(Refusal::BeyondDistortion { radius, limit }) => prop_assert!(radius >= limit && limit > 0.0),
            Err(Refusal::OffSensor) => prop_assert!(p.z > 0.0),
            Err(Refusal::BeforeWindow { .. }) => prop_assert!(false, "there is no window"),
            Err(Refusal::NotFinite) => {
                let far = (p.x / p.z).hypot(p.y / p.z) > 1e30;
                prop_assert!(far || p.iter().any(|c| !c.is_finite()), "{p} is a point like any other");
            }
        }
    }

    #[test]
    fn unprojection_refuses_what_no_ray_reaches(camera in camera(false), u in ugly(), v in ugly()) {
        let ray = camera.unproject(Pixel::new(u, v));
        // At the horizon of the sensor plane the way forward may refuse by rounding what the way back still allows.
        let jet = camera.unproject_jet(&Vector2::new(u, v));
        prop_assert!(ray.is_ok() || jet.is_err());
        if let Ok(jet) = jet {
            prop_assert!(jet.dxy_dq.iter().chain(&jet.dxy_dintrinsics).all(|d| !d.is_nan()), "({u}, {v}): {jet:?}");
        }
        if let Ok(ray) = ray {
            prop_assert!(u.is_finite() && v.is_finite(), "({u}, {v}) has a ray");
            prop_assert!(ray.xyz.iter().all(|c| c.is_finite()), "({u}, {v}) -> {}", ray.xyz);
            prop_assert_eq!(ray.xyz.z, 1.0);
        }
    }

    #[test]
    fn cameras_of_ugly_numbers_are_refused_or_work(
        p in prop::array::uniform10(ugly()), x in ugly(), y in ugly(), z in ugly()
    ) {
        if let Ok(camera) = Camera::new(Intrinsics::from_array(&p, Radial::default())) {
            prop_assert!(p.iter().all(|c| c.is_finite()) && p[0] > 0.0 && p[1] > 0.0 && p[9] > 0.0);
            if let Ok(q) = camera.project_xyz(&Vector3::new(x, y, z)) {
                prop_assert!(z > 0.0 && q.iter().all(|c| c.is_finite()), "{q}");
            }
            if let Ok(ray) = camera.unproject(Pixel::new(x, y)) {
                prop_assert!(ray.xyz.iter().all(|c| c.is_finite()), "{}", ray.xyz);
            }
        }
    }

    #[test]
    fn the_polynomial_ends_where_it_stops_growing(
        k1 in -2.0..-0.05_f64, f in 500.0..9000.0_f64, part in 0.0..3.0_f64, turn in 0.0..std::f64::consts::TAU
    ) {
        let mut i = Intrinsics::pinhole(f, 500.0, 400.0);
        i.k[0] = k1;
        let camera = Camera::new(i).unwrap();
        let limit = (-1.0 / (3.0 * k1)).sqrt();
        let r = part * limit;
        prop_assume!((part - 1.0).abs() > 1e-9);
        let image = camera.project_xyz(&Vector3::new(r * turn.cos(), r * turn.sin(), 1.0));
        if part < 1.0 {
            let q = image.unwrap();
            prop_assert!(((q - Vector2::new(500.0, 400.0)).norm() - f * r * (1.0 + k1 * r * r)).abs() < 1e-9 * f);
        } else {
            let refused = matches!(image, Err(Refusal::BeyondDistortion { radius, limit: l })
                if (radius - r).abs() < 1e-12 * r && (l - limit).abs() < 1e-12 * limit);
            prop_assert!(refused, "{image:?}");
        }
        // On the sensor the lens ends at two thirds of that radius.
        let q = Vector2::new(500.0, 400.0) + Vector2::new(turn.cos(), turn.sin()) * (part * f * limit * 2.0 / 3.0);
        prop_assert_eq!(camera.ideal_of_pixel(&q).is_ok(), part < 1.0);
    }

    #[test]
    fn opencv_and_back_is_the_same_camera(
        camera in camera(true), x in -0.3..0.3_f64, y in -0.3..0.3_f64
    ) {
        let o = camera.to_opencv().unwrap();
        let (back, turn) = Camera::from_opencv(&o).unwrap();
        for (a, b) in back.intrinsics().to_array().iter().zip(camera.intrinsics().to_array()) {
            prop_assert!((a - b).abs() < 1e-12 * (1.0 + b.abs()), "{a} {b}");
        }
        prop_assert!((turn - o.cam_from_opencv()).norm() < 1e-14);
        // The same pixel by OpenCV's own formula, in OpenCV's camera frame.
        let p = turn.transpose() * Vector3::new(x, y, 1.0);
        let [k1, k2, k3] = o.k;
        let s = p.x * p.x + p.y * p.y;
        let xd = Vector3::new(p.x, p.y, 0.0) * (1.0 + s * (k1 + s * (k2 + s * k3))) + Vector3::z();
        let r = rotation_exp(&(Vector3::y() * -o.tau_y_rad)) * rotation_exp(&(Vector3::x() * -o.tau_x_rad));
        // OpenCV's matrix [[R33, 0, -R13], [0, R33, -R23], [0, 0, 1]] R with R = Ry(tau_y) Rx(tau_x), both turning backwards.
        let w = r * xd;
        let (tx, ty) = (r.m33 * w.x / w.z - r.m13, r.m33 * w.y / w.z - r.m23);
        let q = camera.project_xyz(&Vector3::new(x, y, 1.0)).unwrap();
        let off = (q - Vector2::new(o.fx_px * tx + o.cx_px, o.fy_px * ty + o.cy_px)).norm();
        prop_assert!(off < 1e-8, "{off} px");
    }

    #[test]
    fn motions_are_a_group(
        a in motion::<Cam, Rig>(), b in motion::<Rig, Target>(), p in prop::array::uniform3(-1e4..1e4_f64)
    ) {
        let p = Point::<Target>::from_vector(Vector3::from(p));
        prop_assert!(near(&(a * a.inverse()), &Motion::identity(), 1e-14, 1e-11));
        prop_assert!(near(&(a.inverse() * a), &Motion::identity(), 1e-14, 1e-11));
        prop_assert!(near(&(a * b).inverse(), &(b.inverse() * a.inverse()), 1e-14, 1e-11));
        prop_assert!(((a * b).point(&p).xyz_mm - a.point(&b.point(&p)).xyz_mm).norm() < 1e-10);
        prop_assert!((a.inverse().point(&a.point(&b.point(&p))).xyz_mm - b.point(&p).xyz_mm).norm() < 1e-10);
    }

    /// Exact for steps of any size: the adjoint of a rotation step about any axis, and of shifts.
    #[test]
    fn adjoints_carry_steps(a in motion::<Cam, Rig>(), b in motion::<Rig, Target>(), d in prop::array::uniform6(-1.0..1.0_f64)) {
        let full = SVector::<f64, 6>::from(d);
        prop_assert!((((a * b).adjoint() - a.adjoint() * b.adjoint()).norm()) < 1e-9);
        prop_assert!((a.inverse().adjoint() * a.adjoint() * full - full).norm() < 1e-9);
        let small = full * 1e-6;
        let (moved, carried) = (a * b.retract(&small), (a * b).retract(&(a.adjoint() * small)));
        // Second order of a step of 1e-6 over the 2 m of the shift, twice.
        prop_assert!(near(&moved, &carried, 1e-11, 1e-7), "{moved:?} {carried:?}");
    }

    #[test]
    fn logarithm_and_exponential_are_one_another(w in prop::array::uniform3(-3.1..3.1_f64)) {
        let w = Vector3::from(w);
        let w = w * (w.norm().min(0.999_999 * std::f64::consts::PI) / w.norm().max(f64::MIN_POSITIVE));
        prop_assert!((rotation_log(&rotation_exp(&w)) - w).norm() < 1e-13);
    }
}

fn options() -> AdjustOptions {
    AdjustOptions {
        solve: SolveOptions { decrement: 1e-8, ..SolveOptions::default() },
        rounds: 0,
        ..Default::default()
    }
}

fn solved(scene: &Scene, start: State) -> (NamedCovariance, f64) {
    let out = adjust(&scene.model, start, &options(), &mut |_| true);
    assert!(out.decrement < 1e-7, "{:?} at {}", out.termination, out.decrement);
    (named_covariance(&out).unwrap(), out.cost)
}

fn sigma_of(c: &NamedCovariance, name: &str) -> f64 {
    c.sigma(name).unwrap_or_else(|| panic!("{name} is not determined"))
}

/// Everything by name, as a step from `a` to `b` in sigmas of `a`: intrinsics, then motions.
fn departures(
    a: &NamedCovariance,
    b: &NamedCovariance,
    expected: impl Fn(&str) -> f64,
    length: f64,
) -> Vec<(String, f64)> {
    let mut out = vec![];
    let mut add = |name: String, step: f64| {
        let sigma = sigma_of(a, &name);
        if sigma > 0.0 {
            out.push((name.clone(), (step - expected(&name)) / sigma));
        } else {
            assert!(step == expected(&name), "{name} is held but moved by {step}");
        }
    };
    for (c, name) in ["left", "right"].iter().enumerate() {
        let (p, q) = (a.natural.cameras[c].intrinsics().to_array(), b.natural.cameras[c].intrinsics().to_array());
        for (k, parameter) in spivcal::camera::INTRINSIC_NAMES.iter().enumerate() {
            add(format!("{name}.{parameter}"), q[k] - p[k]);
        }
    }
    let mut pose = |name: String, r: nalgebra::Matrix3<f64>, from: Vector3<f64>, to: Vector3<f64>| {
        let w = rotation_log(&r);
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            add(format!("{name}.r{axis}_rad"), w[k]);
            add(format!("{name}.t{axis}_mm"), to[k] / length - from[k]);
        }
    };
    let (m, n) = (&a.natural.cam_from_rig[1], &b.natural.cam_from_rig[1]);
    pose("right.cam_from_rig".into(), n.rotation * m.rotation.transpose(), m.translation_mm, n.translation_mm);
    for (v, (m, n)) in a.natural.rig_from_target.iter().zip(&b.natural.rig_from_target).enumerate() {
        let name = format!("view{v}.rig_from_target");
        pose(name, n.rotation * m.rotation.transpose(), m.translation_mm, n.translation_mm);
    }
    out
}

fn assert_within(all: &[(String, f64)], limit: f64) {
    assert!(all.len() > 20, "compared {} numbers only", all.len());
    let worst = all.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).unwrap();
    assert!(all.iter().all(|(_, z)| z.abs() <= limit), "{} is off by {:.2e} sigmas", worst.0, worst.1);
}

#[test]
fn half_a_pixel_of_shift_moves_the_axis_points_alone() {
    for (per_view, points) in [(false, false), (true, false), (false, true)] {
        let scene = Scene::build(11, per_view, !points, points).with_noise(1);
        let (a, cost_a) = solved(&scene, scene.perturbed_by(2, 0.3));
        let mut shifted = scene.clone();
        for edge in shifted.model.images.iter_mut().flat_map(|i| &mut i.discs).map(|d| &mut d.edge) {
            edge.u_px.iter_mut().chain(&mut edge.v_px).for_each(|x| *x += 0.5);
        }
        for fact in &mut shifted.model.facts {
            if let Fact::Intrinsic { parameter: 2 | 3, value, .. } = fact {
                *value += 0.5;
            }
        }
        // From the start of the unshifted scene: it has to find the shift by itself.
        let (b, cost_b) = solved(&shifted, scene.perturbed_by(2, 0.3));
        let half = |name: &str| if name.ends_with(".cx_px") || name.ends_with(".cy_px") { 0.5 } else { 0.0 };
        assert_within(&departures(&a, &b, half, 1.0), 1e-6);
        assert!((cost_a - cost_b).abs() < 1e-9 * cost_a);
    }
}

#[test]
fn twice_the_spacing_is_twice_every_length_and_the_same_pixels() {
    let scene = Scene::build(12, false, true, false).with_noise(1);
    let mut problem = scene.problem();
    let run = |p: &RigProblem| {
        let out = calibrate_rig(p, &options(), &mut |_| true).unwrap().adjustment;
        (named_covariance(&out).unwrap(), out)
    };
    let (a, out_a) = run(&problem);
    problem.shape_mm[0] = problem.shape_mm[0].map(|s| 2.0 * s);
    let (b, out_b) = run(&problem);
    assert_within(&departures(&a, &b, |_| 0.0, 2.0), 1e-6);
    assert!((out_a.cost - out_b.cost).abs() < 1e-9 * out_a.cost, "{} {}", out_a.cost, out_b.cost);
    for k in 0..3 {
        assert!((out_b.state.shape_mm[k] / out_a.state.shape_mm[k] - 2.0).abs() < 1e-8);
    }
    for name in ["right.cam_from_rig.tx_mm", "view0.rig_from_target.tz_mm"] {
        assert!((sigma_of(&b, name) / sigma_of(&a, name) - 2.0).abs() < 1e-5, "sigma of {name}");
    }
    assert!((sigma_of(&b, "left.f_px") / sigma_of(&a, "left.f_px") - 1.0).abs() < 1e-5);
}
