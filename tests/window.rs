//! A camera that looks through a flat window: where points appear against a ray tracer, derivatives against dual numbers.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod dual;

use nalgebra::{Matrix3, Vector2, Vector3};
use spivcal::camera::{Camera, Intrinsics, LAYERS, Refusal, Window};

type Dual = dual::Dual<11>;
type Space = [Dual; 3];

/// Water behind glass, a window seen 33 degrees obliquely; glass alone in air; and a camera in glass that looks into air.
fn windows() -> [Window; 4] {
    let tilted = Vector3::new(0.5, -0.2, 0.8);
    [
        Window::new(tilted, 400.0, 12.0, [1.0003, 1.49, 1.333]).unwrap(),
        Window::new(Vector3::new(0.02, 0.01, 1.0), 250.0, 0.0, [1.0, 1.5, 1.33]).unwrap(),
        Window::new(tilted, 300.0, 20.0, [1.0, 1.52, 1.0]).unwrap(),
        Window::new(Vector3::new(0.1, 0.05, 1.0), 80.0, 5.0, [1.5, 1.3, 1.0]).unwrap(),
    ]
}

fn points() -> Vec<Vector3<f64>> {
    let mut out = vec![];
    for x in [-120.0, -3.0, 40.0, 160.0] {
        for y in [-90.0, 0.5, 70.0] {
            for z in [650.0, 900.0] {
                out.push(Vector3::new(x, y, z));
            }
        }
    }
    out
}

/// The ray that leaves the camera under the angle of `a` to the normal, angle by angle: where it passes the depth of p.
fn traced(window: &Window, a: &Vector3<f64>, depth: f64) -> Vector3<f64> {
    let [d, t, air, glass, water] = window.layers();
    let n = window.normal();
    let aside = a - n * n.dot(a);
    let incidence = aside.norm().atan2(n.dot(a));
    let refracted = |index: f64| (air * incidence.sin() / index).asin();
    let reach = d * incidence.tan() + t * refracted(glass).tan() + (depth - d - t) * refracted(water).tan();
    n * depth + aside.normalize() * reach
}

#[test]
fn the_ray_of_the_apparent_point_arrives_at_the_point() {
    for window in windows() {
        for p in points() {
            let a = window.apparent(&p).unwrap();
            let n = window.normal();
            let arrived = traced(&window, &a, n.dot(&p));
            assert!((arrived - p).norm() < 1e-9, "{window:?}: {arrived} for {p}");
            assert!((a - p).cross(n).norm() < 1e-9, "the apparent point lies on the normal through the point");
            // And by vectors, from the camera outwards.
            let ray = window.water_ray(&a).unwrap();
            let off = (p - ray.from_mm).cross(&ray.direction).norm();
            assert!(off < 1e-9, "{window:?}: the traced ray passes {p} at {off} mm");
        }
    }
}

fn dot(a: &Space, b: &Space) -> Dual {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The apparent point on dual numbers: variables 0-2 the point, 3-7 the layers, 8-10 the turn of the window.
fn apparent_dual(window: &Window, p: &Vector3<f64>) -> Space {
    let point: Space = std::array::from_fn(|k| Dual::variable(p[k], k));
    let layers: [Dual; LAYERS] = std::array::from_fn(|k| Dual::variable(window.layers()[k], 3 + k));
    let turn: Space = std::array::from_fn(|k| Dual::variable(0.0, 8 + k));
    let n0: Space = std::array::from_fn(|k| Dual::constant(window.normal()[k]));
    let n: Space = std::array::from_fn(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        n0[k] + turn[i] * n0[j] - turn[j] * n0[i]
    });
    let [d, t, air, glass, water] = layers;
    let along = dot(&n, &point);
    let r = (dot(&point, &point) - along * along).sqrt();
    let one = Dual::constant(1.0);
    // Sine of the angle in air as the unknown, instead of its tangent.
    let tangent = |s: Dual| s / (one - s * s).sqrt();
    let reach = |s: Dual| d * tangent(s) + t * tangent(air * s / glass) + (along - d - t) * tangent(air * s / water);
    // Bisection for the value, then Newton's steps with a fixed slope, which carry the gradient.
    let value = |s: f64| (reach(Dual::constant(s)) - r).x;
    let limit = [glass.x, water.x].iter().fold(1.0_f64, |l, n| l.min(n / air.x));
    let (mut low, mut high) = (0.0, limit * (1.0 - 1e-12));
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if value(middle) > 0.0 { high = middle } else { low = middle }
    }
    let mut s = Dual::constant(0.5 * (low + high));
    let h = 1e-6 * limit;
    let slope = Dual::constant((value(s.x + h) - value(s.x - h)) / (2.0 * h));
    for _ in 0..30 {
        s = s - (reach(s) - r) / slope;
    }
    let depth = r / tangent(s);
    std::array::from_fn(|k| point[k] - n[k] * (along - depth))
}

#[test]
fn derivatives_are_those_of_dual_numbers() {
    for window in windows() {
        for p in points() {
            let jet = window.apparent_jet(&p).unwrap();
            let dual = apparent_dual(&window, &p);
            let analytic = |i: usize, k: usize| match k {
                0..3 => jet.by_point[(i, k)],
                3..8 => jet.by_layers[(i, k - 3)],
                _ => jet.by_turn[(i, k - 8)],
            };
            for k in 0..11 {
                let size = (0..3).map(|i| dual[i].d[k].abs()).fold(1e-3, f64::max);
                for (i, number) in dual.iter().enumerate() {
                    assert!((number.x - jet.apparent[i]).abs() < 1e-8, "{window:?} {p}: value {i}");
                    let gap = (number.d[k] - analytic(i, k)).abs();
                    assert!(gap < 1e-8 * size, "{window:?} {p}: {i} by {k}: {} {}", number.d[k], analytic(i, k));
                }
            }
        }
    }
}

/// On the normal through the camera nothing is singular.
#[test]
fn the_normal_through_the_camera_is_no_exception() {
    let window = windows()[0];
    let n = *window.normal();
    let [d, t, air, glass, water] = window.layers();
    let jet = window.apparent_jet(&(n * 900.0)).unwrap();
    let depth = d + t * air / glass + (900.0 - d - t) * air / water;
    assert!((jet.apparent - n * depth).norm() < 1e-9);
    // Sideways the apparent point goes with the point; along the normal it goes by the ratio of the indices.
    let expected = Matrix3::identity() - n * n.transpose() * (1.0 - air / water);
    assert!((jet.by_point - expected).norm() < 1e-12, "{}", jet.by_point);
}

#[test]
fn layers_of_air_change_nothing() {
    let window = Window::new(Vector3::new(0.3, 0.1, 0.9), 200.0, 15.0, [1.2; 3]).unwrap();
    for p in points() {
        assert!((window.apparent(&p).unwrap() - p).norm() < 1e-9);
    }
}

#[test]
fn pixels_and_rays_belong_together_through_the_window() {
    let mut i = Intrinsics::pinhole(6200.0, 511.0, 500.0);
    (i.alpha_rad, i.beta_rad, i.k[0]) = (0.03, -0.08, -0.2);
    let camera = Camera::new(i).unwrap();
    let window = windows()[0];
    let mut seen = 0;
    for p in points() {
        let Ok(jet) = camera.project_through(&window, &p) else { continue };
        let ray = camera.unproject_through(&window, &jet.pixel).unwrap();
        assert!((p - ray.from_mm).cross(&ray.direction).norm() < 1e-8);
        for k in 0..3 {
            let mut step = Vector3::zeros();
            step[k] = 1e-3;
            let at = |s: f64| camera.project_through(&window, &(p + step * s)).unwrap().pixel;
            let numeric: Vector2<f64> = (at(1.0) - at(-1.0)) / 2e-3;
            assert!((numeric - jet.dq_dp.column(k)).norm() < 1e-6 * (1.0 + numeric.norm()), "{p} by {k}");
        }
        seen += 1;
    }
    assert!(seen > 10, "{seen} points seen");
}

#[test]
fn what_is_not_behind_the_window_is_refused() {
    let window = windows()[0];
    let n = *window.normal();
    match window.apparent(&(n * 411.0)) {
        Err(Refusal::BeforeWindow { missing_mm }) => assert!((missing_mm - 1.0).abs() < 1e-9),
        other => panic!("{other:?}"),
    }
    assert_eq!(window.apparent(&Vector3::new(f64::NAN, 0.0, 900.0)), Err(Refusal::NotFinite));
    assert_eq!(window.water_ray(&-n), Err(Refusal::OffSensor));
    // From glass into air beyond the angle of total reflection.
    let reflecting = Window::new(Vector3::z(), 50.0, 0.0, [1.5, 1.5, 1.0]).unwrap();
    assert_eq!(reflecting.water_ray(&Vector3::new(1.0, 0.0, 1.0)), Err(Refusal::OffSensor));
    assert!(Window::new(Vector3::zeros(), 1.0, 1.0, [1.0; 3]).is_err());
    assert!(Window::new(Vector3::z(), 0.0, 1.0, [1.0; 3]).is_err());
    assert!(Window::new(Vector3::z(), 1.0, -1.0, [1.0; 3]).is_err());
    assert!(Window::new(Vector3::z(), 1.0, 1.0, [1.0, f64::NAN, 1.3]).is_err());
}
