//! Ellipses against independent answers, and their covariance against draws.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod render;

use nalgebra::{Matrix3, SVector, Vector3};
use render::Random;
use spivcal::conic::{Ellipse, fit_direct, fit_geometric, image_of_circle};
use spivcal::frames::Pixel;
use spivcal::{Error, error::Insufficient};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

fn ellipse() -> Ellipse {
    Ellipse::new(Pixel::new(812.3, 455.7), 37.0, 14.0, 0.63).unwrap()
}

fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance}");
}

#[test]
fn matrix_vanishes_on_the_contour_and_leads_back() {
    let e = ellipse();
    let c = e.matrix();
    for k in 0..12 {
        let p = e.point(f64::from(k) * 0.5);
        let x = Vector3::new(p.u_px, p.v_px, 1.0);
        close((x.transpose() * c * x)[0], 0.0, 1e-9);
    }
    close(e.implicit(e.center_px), -1.0, 1e-15);
    let back = Ellipse::from_matrix(&(c * -7.5)).unwrap();
    close((back.parameters() - e.parameters()).amax(), 0.0, 1e-8);
}

#[test]
fn axes_are_ordered_and_angles_wrapped() {
    let e = Ellipse::new(Pixel::new(0.0, 0.0), 2.0, 5.0, 0.1).unwrap();
    close(e.semi_major_px, 5.0, 0.0);
    close(e.angle_rad, 0.1 + FRAC_PI_2 - PI, 1e-15);
    assert!(matches!(Ellipse::new(Pixel::new(0.0, 0.0), -1.0, 5.0, 0.1), Err(Error::Invalid(_))));
    assert!(Ellipse::new(Pixel::new(f64::NAN, 0.0), 1.0, 5.0, 0.1).is_err());
}

#[test]
fn no_ellipse_is_refused_by_type() {
    let hyperbola = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);
    let empty = Matrix3::identity();
    let line_pair = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    let nan = Matrix3::repeat(f64::NAN);
    for m in [hyperbola, empty, line_pair, nan] {
        assert!(matches!(Ellipse::from_matrix(&m), Err(Error::Insufficient(Insufficient::Degenerate(_)))));
    }
}

#[test]
fn distance_is_the_shortest_by_search() {
    let e = ellipse();
    for (u, v) in [(812.3, 455.7), (830.0, 470.0), (900.0, 400.0), (841.0, 478.0), (812.3, 500.0), (800.0, 447.0)] {
        let p = Pixel::new(u, v);
        let best = (0..200_000)
            .map(|k| e.point(f64::from(k) / 200_000.0 * TAU))
            .map(|q| (q.u_px - u).hypot(q.v_px - v))
            .fold(f64::INFINITY, f64::min);
        close(e.distance_px(p).abs(), best, 1e-6);
        assert_eq!(e.distance_px(p) < 0.0, e.implicit(p) < 0.0);
    }
    // On the major axis inside the evolute the foot is not the vertex: from the centre it is the end of the minor axis.
    let flat = Ellipse::new(Pixel::new(0.0, 0.0), 10.0, 2.0, 0.0).unwrap();
    close(flat.distance_px(Pixel::new(0.0, 0.0)), -2.0, 1e-12);
    let circle = Ellipse::new(Pixel::new(0.0, 0.0), 3.0, 3.0, 0.0).unwrap();
    close(circle.distance_px(Pixel::new(0.0, 0.0)), -3.0, 1e-12);
    close(circle.distance_px(Pixel::new(3.0, 4.0)), 2.0, 1e-12);
}

/// The rendered discs of other tests: cells that a look decides are those that the distance decides.
#[test]
fn cells_are_covered_as_without_the_look() {
    let mut near = 0;
    for (a, b, h) in [(30.0, 30.0, 0.125), (24.0, 9.0, 0.125), (5.0, 1.5, 0.5), (2.0, 0.3, 1.0)] {
        let spot = render::Spot { u: 40.3, v: 39.8, a, b, phi: 0.5 };
        for (i, j) in (0..160).flat_map(|i| (0..160).map(move |j| (i, j))) {
            let (u, v) = (0.5 * f64::from(i), 0.5 * f64::from(j));
            let (fast, plain) = (spot.cover(u, v, h), spot.cover_near_the_outline(u, v, h));
            assert_eq!(fast, plain, "{spot:?} at ({u}, {v})");
            near += usize::from(plain > 0.0 && plain < 1.0);
        }
    }
    assert!(near > 100, "{near} cells of the outline");
}

#[test]
fn lengths_agree_with_sums() {
    let e = ellipse();
    let n = 400_000;
    let sum: f64 = (0..n)
        .map(|k| {
            let (p, q) = (e.point(f64::from(k) / f64::from(n) * TAU), e.point(f64::from(k + 1) / f64::from(n) * TAU));
            (p.u_px - q.u_px).hypot(p.v_px - q.v_px)
        })
        .sum();
    close(e.perimeter_px(), sum, 1e-7);
    // Ellipse with axes 2 and 1: 9.688448220547676 (complete elliptic integral).
    close(Ellipse::new(Pixel::new(0.0, 0.0), 2.0, 1.0, 0.0).unwrap().perimeter_px(), 9.688_448_220_547_676, 1e-13);
    close(e.area_px2(), PI * 37.0 * 14.0, 1e-9);
    // Curvature radii at the vertices: b^2 / a and a^2 / b.
    close(e.curvature_radius_px(0.0), 14.0 * 14.0 / 37.0, 1e-12);
    close(e.curvature_radius_px(FRAC_PI_2), 37.0 * 37.0 / 14.0, 1e-9);
}

#[test]
fn image_of_a_circle_is_where_its_points_go() {
    let h = Matrix3::new(12.0, 1.0, 500.0, -0.4, 9.0, 300.0, 0.004, -0.002, 1.0);
    let e = image_of_circle(&h, [10.0, -5.0], 12.5).unwrap();
    for k in 0..16 {
        let t = f64::from(k) / 16.0 * TAU;
        let p = h * Vector3::new(10.0 + 12.5 * t.cos(), -5.0 + 12.5 * t.sin(), 1.0);
        close(e.distance_px(Pixel::new(p[0] / p[2], p[1] / p[2])), 0.0, 1e-9);
    }
    assert!(image_of_circle(&h, [-240.0, 0.0], 12.5).is_err(), "behind the camera");
    assert!(image_of_circle(&Matrix3::zeros(), [0.0, 0.0], 1.0).is_err());
    assert!(image_of_circle(&h, [0.0, 0.0], -1.0).is_err());
}

#[test]
fn direct_fit_is_exact_on_exact_points_and_refuses_lines() {
    let e = ellipse();
    let (u, v): (Vec<f64>, Vec<f64>) = (0..7).map(|k| e.point(f64::from(k) * 0.3)).map(|p| (p.u_px, p.v_px)).unzip();
    close((fit_direct(&u, &v).unwrap().parameters() - e.parameters()).amax(), 0.0, 1e-4);
    let line: Vec<f64> = (0..9).map(f64::from).collect();
    assert!(matches!(fit_direct(&line, &line), Err(Error::Insufficient(_))));
    assert!(matches!(fit_direct(&[1.0; 9], &[2.0; 9]), Err(Error::Insufficient(_))));
    assert!(matches!(fit_direct(&u[..4], &v[..4]), Err(Error::Insufficient(_))));
    assert!(matches!(fit_direct(&[f64::NAN; 9], &line), Err(Error::Invalid(_))));
    assert!(matches!(fit_geometric(&u, &v, &[0.0; 7]), Err(Error::Invalid(_))));
    assert!(matches!(fit_geometric(&u, &v, &[0.1; 3]), Err(Error::Invalid(_))));
}

/// Mean normalised squared error of fits to noisy points, and the share of a full contour seen.
fn nees(e: &Ellipse, seen: f64, regular_only: bool) -> f64 {
    let mut random = Random(11);
    let trials = 400;
    let mut sum = 0.0;
    for _ in 0..trials {
        let (mut u, mut v, mut s) = (vec![], vec![], vec![]);
        for k in 0..90 {
            let t = f64::from(k) / 90.0 * TAU * seen;
            let (p, n) = (e.point(t), e.normal(t));
            let sigma = 0.05 + 0.1 * random.uniform();
            let d = sigma * random.normal();
            u.push(p.u_px + d * n[0]);
            v.push(p.v_px + d * n[1]);
            s.push(sigma);
        }
        let fit = fit_geometric(&u, &v, &s).unwrap();
        let mut error: SVector<f64, 5> = fit.ellipse.parameters() - e.parameters();
        error[4] = (error[4] + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2;
        assert!(fit.covariance.iter().all(|x| x.is_finite()));
        sum += if regular_only {
            // Centre and size only: the direction of a circle does not exist.
            let c = fit.covariance.fixed_view::<2, 2>(0, 0).into_owned();
            let x = error.fixed_rows::<2>(0).into_owned();
            x.dot(&(c.try_inverse().unwrap() * x))
        } else {
            error.dot(&(fit.covariance.try_inverse().unwrap() * error))
        };
    }
    sum / f64::from(trials)
}

#[test]
fn covariance_is_true() {
    // Mean of 400 chi-square numbers of 5 degrees of freedom: 5 +- 2 sqrt(10 / 400).
    for seen in [1.0, 0.6] {
        let found = nees(&ellipse(), seen, false);
        assert!((found - 5.0).abs() < 2.0 * (10.0_f64 / 400.0).sqrt(), "nees {found} at {seen}");
    }
}

#[test]
fn a_circle_does_not_break_the_fit() {
    let circle = Ellipse::new(Pixel::new(100.0, 80.0), 20.0, 20.0, 0.0).unwrap();
    let found = nees(&circle, 1.0, true);
    assert!((found - 2.0).abs() < 2.0 * (4.0_f64 / 400.0).sqrt(), "nees of the centre {found}");
    let (u, v): (Vec<f64>, Vec<f64>) =
        (0..40).map(|k| circle.point(f64::from(k) * 0.157)).map(|p| (p.u_px, p.v_px)).unzip();
    let fit = fit_geometric(&u, &v, &[0.1; 40]).unwrap();
    close(fit.ellipse.semi_minor_px, 20.0, 1e-6);
    let sigma_angle = fit.covariance[(4, 4)].sqrt();
    assert!(sigma_angle > 0.3 && sigma_angle < 1.0, "an unknown angle has the sigma of a uniform one: {sigma_angle}");
}
