//! The errata of the paper, each shown by numbers, and `docs/paper.md` names the test of each.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use nalgebra::{Matrix3, Matrix3x4, Matrix4x3, Vector2, Vector3};
use rig_scene::{Bound, Parts, Problem};
use spivcal::camera::{Camera, Intrinsics, Radial};
use spivcal::conic::Ellipse;
use spivcal::frames::Pixel;
use spivcal::rigid::rotation_exp;
use std::path::Path;

/// f of a 50 mm lens focused at 500 mm along its axis with 45 degrees, px.
const F_PX: f64 = 50.0 / 0.9 / 0.00625;

/// Eqs 10 and 11 one way, eqs 6 and 7 (corrected) the other, written out here: nothing is missing between them.
#[test]
fn equations_6_and_7_invert_10_and_11() {
    for (a, b) in [(0.0_f64, 0.11_f64), (0.11, 0.0), (0.2, -0.35), (-0.5, 0.4)] {
        let ((sa, ca), (sb, cb)) = (a.sin_cos(), b.sin_cos());
        for (x, y) in [(0.05, -0.04), (-0.06, 0.03), (0.2, 0.3)] {
            let lambda_1 = 1.0 / (1.0 - x * b.tan() - y * a.tan() / cb);
            let (tx, ty) = (lambda_1 * (x / cb + y * a.tan() * b.tan()), lambda_1 * y / ca);
            let lambda = 1.0 / (1.0 + tx * sb + ty * sa * cb);
            let back = [lambda * (tx * cb - ty * sa * sb), lambda * ty * ca];
            assert!((back[0] - x).hypot(back[1] - y) < 1e-14, "{a} {b}: {back:?}");
        }
    }
}

#[test]
fn equations_12_and_13_are_two_lenses() {
    let lens = |radial: Radial| {
        let mut i = Intrinsics::pinhole(F_PX, 511.5, 383.5);
        (i.k[0], i.radial) = (-0.15, radial);
        Camera::new(i).unwrap()
    };
    let corner = Vector3::new(511.5 / F_PX, 383.5 / F_PX, 1.0);
    let image = |r: Radial| lens(r).project_xyz(&corner).unwrap();
    let gap = (image(Radial::IdealToDistorted) - image(Radial::DistortedToIdeal)).norm();
    println!("corner: {gap:.2} px apart");
    assert!((0.5..1.5).contains(&gap), "{gap} px");
}

/// The paper's geometry, cameras without distortion.
fn undistorted() -> Parts {
    let mut parts = Problem::of("A").unwrap().parts;
    for c in &mut parts.cameras {
        let i = *c.intrinsics();
        *c = Camera::new(Intrinsics { k: [0.0; 3], ..i }).unwrap();
    }
    parts
}

/// The plane in the first camera: n and d.
fn plane(parts: &Parts) -> (Vector3<f64>, f64) {
    let sheet = parts.rig_from_sheet.unwrap();
    let n: Vector3<f64> = -sheet.rotation.column(2).into_owned();
    (n, n.dot(&sheet.translation_mm))
}

/// Points over the common field of the sheet, 60 x 36 mm, in the rig frame.
fn points(parts: &Parts) -> Vec<Vector3<f64>> {
    let sheet = parts.rig_from_sheet.unwrap();
    let place = |k: i32| Vector3::new(-30.0 + 5.0 * f64::from(k % 13), -18.0 + 4.5 * f64::from(k / 13), 0.0);
    (0..117).map(|k| sheet.apply(&place(k))).collect()
}

/// `p_in_cam1 = R_h p_in_cam2 + t_h`, so points go from camera 1 to camera 2 by `R_h^T [I | -t_h]`, not by `[R_h^T | t_h]`.
#[test]
fn equation_16_needs_the_inverse_motion() {
    let parts = undistorted();
    let (n, d) = plane(&parts);
    let cam1_from_cam2 = parts.cam_from_rig.inverse();
    let (r_h, t_h) = (cam1_from_cam2.rotation, cam1_from_cam2.translation_mm);
    let mut of_plane = Matrix4x3::zeros();
    of_plane.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    of_plane.fixed_view_mut::<1, 3>(3, 0).copy_from(&(n.transpose() / d));
    let motion = |t: Vector3<f64>| {
        let mut m = Matrix3x4::zeros();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&r_h.transpose());
        m.set_column(3, &t);
        m * of_plane
    };
    let worst = |h: Matrix3<f64>| {
        let gap = |p: &Vector3<f64>| (h * p).angle(&parts.cam_from_rig.apply(p)) * F_PX;
        points(&parts).iter().map(gap).fold(0.0, f64::max)
    };
    let (right, printed) = (worst(motion(-(r_h.transpose() * t_h))), worst(motion(t_h)));
    println!("right {right:.1e} px, as printed {printed:.0} px");
    assert!(right < 1e-3, "{right} px");
    assert!(printed > 1000.0, "{printed} px");
}

/// A ray through a point of the plane has the homogeneous point `[I; n^T/d] ray`, four numbers from three: its last one is the scale that
/// puts it on the plane. No 3 x 3 and no 3 x 4 matrix does that.
#[test]
fn equation_16_takes_the_plane_by_a_4x3_matrix() {
    let parts = undistorted();
    let (n, d) = plane(&parts);
    let mut of_plane = Matrix4x3::zeros();
    of_plane.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    of_plane.fixed_view_mut::<1, 3>(3, 0).copy_from(&(n.transpose() / d));
    for p in points(&parts) {
        // Any point of the ray: here at half the way.
        let h = of_plane * (0.5 * p);
        let found = Vector3::new(h.x, h.y, h.z) / h.w;
        assert!((found - p).norm() < 1e-10 * d, "{found} {p}");
    }
}

/// From pixel to pixel between two cameras without tilt: `K2 [R^T | -R^T t] [I; n^T/d] K1^-1` is 3 x 4 by 4 x 3 by 3 x 3, and exact.
#[test]
fn equation_16_takes_pixels_by_a_3x3_inverse() {
    let mut parts = undistorted();
    for c in &mut parts.cameras {
        let i = *c.intrinsics();
        *c = Camera::new(Intrinsics { alpha_rad: 0.0, beta_rad: 0.0, ..i }).unwrap();
    }
    let (n, d) = plane(&parts);
    let k = |c: usize| {
        let i = parts.cameras[c].intrinsics();
        Matrix3::new(i.f_px, 0.0, i.cx_px, 0.0, i.f_px, i.cy_px, 0.0, 0.0, 1.0)
    };
    let mut motion = Matrix3x4::zeros();
    motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&parts.cam_from_rig.rotation);
    motion.set_column(3, &parts.cam_from_rig.translation_mm);
    let mut of_plane = Matrix4x3::zeros();
    of_plane.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    of_plane.fixed_view_mut::<1, 3>(3, 0).copy_from(&(n.transpose() / d));
    let inverse: Matrix3<f64> = k(0).try_inverse().unwrap();
    let h: Matrix3<f64> = k(1) * motion * of_plane * inverse;
    for p in points(&parts) {
        let q1 = parts.cameras[0].project_xyz(&p).unwrap();
        let q2 = parts.cameras[1].project_xyz(&parts.cam_from_rig.apply(&p)).unwrap();
        let there = h * q1.push(1.0);
        let gap = (Vector2::new(there.x, there.y) / there.z - q2).norm();
        assert!(gap < 1e-8, "{gap} px");
    }
}

/// Both cameras as untilted ones with the same f and axis point.
#[test]
fn equation_16_without_tilt_is_two_pixels_off() {
    let parts = undistorted();
    let (n, d) = plane(&parts);
    let k = Matrix3::new(F_PX, 0.0, 511.5, 0.0, F_PX, 383.5, 0.0, 0.0, 1.0);
    let m = &parts.cam_from_rig;
    let h = k * (m.rotation + m.translation_mm * n.transpose() / d) * k.try_inverse().unwrap();
    let gap = |p: &Vector3<f64>| {
        let q1 = parts.cameras[0].project_xyz(p).unwrap();
        let q2 = parts.cameras[1].project_xyz(&m.apply(p)).unwrap();
        let there = h * q1.push(1.0);
        (Vector2::new(there.x, there.y) / there.z - q2).norm_squared()
    };
    let all = points(&parts);
    let rms = (all.iter().map(gap).sum::<f64>() / all.len() as f64).sqrt();
    println!("transfer without tilt: {rms:.2} px rms");
    assert!((2.0..2.2).contains(&rms), "{rms} px");
}

#[test]
fn a_pair_has_fourteen_features() {
    let disc = |u: f64, r: f64| Ellipse {
        center_px: Pixel::new(u, 300.0),
        semi_major_px: r,
        semi_minor_px: 0.7 * r,
        angle_rad: 0.3,
    };
    let b = spivcal::bitangent::bitangents(&disc(200.0, 90.0), &disc(500.0, 70.0)).unwrap();
    // Four common tangents touch two ellipses each, and cross each other in pairs.
    let (tangency, crossings) = (4 * 2, 4 * 3 / 2);
    assert_eq!(spivcal::bitangent::POINTS, tangency + crossings);
    let all: Vec<Vector2<f64>> = (0..spivcal::bitangent::POINTS).map(|k| b.point(k).unwrap()).collect();
    for (i, p) in all.iter().enumerate() {
        assert!(all[..i].iter().all(|q| (p - q).norm() > 1.0), "feature {i} is one of its own");
    }
    assert!(b.point(14).is_none());
}

/// Conjugate planes of a thin lens (Gauss along the axis, Scheimpflug across it).
#[test]
fn the_lens_needs_6_34_degrees_and_8889_px() {
    let image_distance_mm: f64 = 1.0 / (1.0 / 50.0 - 1.0 / 500.0);
    let f_px = image_distance_mm / 0.00625;
    let tilt = (image_distance_mm / 500.0 * 45_f64.to_radians().tan()).atan();
    assert!((f_px - 8888.9).abs() < 0.1 && (tilt.to_degrees() - 6.34).abs() < 0.005);
    let printed = (2.8_f64.to_radians().tan() * 500.0 / image_distance_mm).atan().to_degrees();
    assert!((printed - 23.8).abs() < 0.1, "a sensor tilted by 2.8 degrees is focused on a plane at {printed} degrees");
    for c in Problem::of("A").unwrap().parts.cameras {
        let i = c.intrinsics();
        assert!((i.f_px - f_px).abs() < 1e-6 && (i.beta_rad.abs() - tilt).abs() < 1e-9);
    }
}

#[test]
fn a_normal_has_two_angles() {
    let turn = |k: usize, angle: f64| {
        let mut w = Vector3::zeros();
        w[k] = angle;
        rotation_exp(&w)
    };
    let normal = |t: [f64; 3]| turn(0, t[0]) * turn(1, t[1]) * turn(2, t[2]) * Vector3::z();
    let here = normal([0.02, -0.78, 0.0]);
    for third in [-1.0, 0.3, 2.0] {
        assert!((normal([0.02, -0.78, third]) - here).norm() < 1e-15, "the third angle leaves the normal alone");
    }
    assert!((normal([0.03, -0.78, 0.0]) - here).norm() > 1e-3 && (normal([0.02, -0.77, 0.0]) - here).norm() > 1e-3);
}

/// Bounds of f and beta at the paper's set-up, with all that a user may know of the axis point.
#[test]
fn no_sigma_of_f_or_beta_can_be_smaller() {
    for name in ["paper-table1", "A"] {
        let mut problem = Problem::of(name).unwrap();
        let sigma = |p: &Problem, n: &str| Bound::of(p).covariance.sigma(n).unwrap();
        let usual = [sigma(&problem, "left.f_px"), sigma(&problem, "left.beta_rad").to_degrees()];
        for fact in &mut problem.parts.facts {
            if let spivcal::bundle::Fact::Intrinsic { sigma, .. } = fact {
                *sigma = 1e-3;
            }
        }
        let known = [sigma(&problem, "left.f_px"), sigma(&problem, "left.beta_rad").to_degrees()];
        println!(
            "{name}: f {:.2} px, beta {:.4} deg; axis point known: {:.2} px, {:.4} deg",
            usual[0], usual[1], known[0], known[1]
        );
        assert!(usual[0] >= known[0] && usual[1] >= known[1]);
        // Rendered images have a fifth of this noise: no method gets below a fifth of these.
        assert!(known[0] > 1.0 && known[1] > 0.01, "{known:?}");
    }
}

/// Every erratum of the document names a test, and there is such a test.
#[test]
fn every_erratum_names_a_test_that_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("docs/paper.md")).unwrap();
    let rows: Vec<&str> = text
        .split("## Errata")
        .nth(1)
        .expect("a list of errata")
        .lines()
        .skip_while(|l| !l.starts_with("|---"))
        .skip(1)
        .filter(|l| l.starts_with('|'))
        .collect();
    assert!(rows.len() >= 12, "{} errata", rows.len());
    for row in rows {
        let cell = row.trim_end_matches('|').rsplit('|').next().unwrap();
        let words: Vec<&str> = cell.split('`').collect();
        let [_, file, _, test, ..] = words[..] else { panic!("no file and test in {row}") };
        let source = std::fs::read_to_string(root.join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        assert!(source.contains(&format!("#[test]\nfn {test}()")), "{file} has no test {test}");
    }
}
