use super::Shape;
use crate::conic::{Ellipse, Frame, from_regular, to_regular};
use crate::detect::band::LANES;
use crate::detect::profile::Profile;
use crate::detect::rim::{Rim, Seen};
use crate::frames::Pixel;

const DEFOCUS: Shape = Shape { fourth: -0.09, sixth: -0.05 };
const WINGS: Shape = Shape { fourth: 0.3, sixth: -0.04 };

fn ellipse(a: f64, b: f64) -> Ellipse {
    Ellipse { center_px: Pixel::new(0.0, 0.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.0 }
}

fn seen(e: &Ellipse, blur_px: f64, shape: Shape, [x, y]: [f64; 2]) -> Seen {
    let mut rim = Rim::default();
    rim.set(&Frame::new(e), blur_px, shape);
    rim.step = rim.angles().map(|_| 1.0).collect();
    rim.seen(&[x; LANES], &[y; LANES])
}

/// `u^m` of the transfer function is `(-v)^m d^m/dv^m`, v the variance: differences of discs behind Gaussians.
#[test]
fn a_shape_is_what_derivatives_by_the_variance_make_of_a_gaussian() {
    let (e, s) = (ellipse(4.8, 4.0), 1.3);
    for at in [[0.0, 0.0], [4.1, 1.0], [5.9, -1.4], [0.2, 5.0], [2.0, -3.1]] {
        let by = |k: f64| seen(&e, s * (1.0 + 0.02 * k).sqrt(), Shape::GAUSSIAN, at).inside[0];
        let second = (by(1.0) - 2.0 * by(0.0) + by(-1.0)) / 0.02_f64.powi(2);
        let third = (by(2.0) - 2.0 * by(1.0) + 2.0 * by(-1.0) - by(-2.0)) / (2.0 * 0.02_f64.powi(3));
        for shape in [DEFOCUS, WINGS] {
            let expected = by(0.0) + shape.fourth * second - shape.sixth * third;
            let found = seen(&e, s, shape, at).inside[0];
            assert!((found - expected).abs() < 3e-5, "{shape:?} at {at:?}: {found}, expected {expected}");
            assert!((found - by(0.0)).abs() > 1e-4, "nothing at {at:?}");
        }
    }
}

#[test]
fn derivatives_of_a_shaped_disc_are_those_of_its_value() {
    // With as many nodes for a blur that is a little wider or narrower.
    let (e, s, h) = (ellipse(4.8, 4.0), 1.33, 1e-4);
    for (shape, [x, y]) in [(DEFOCUS, [3.0, 2.0]), (WINGS, [5.5, 0.4]), (DEFOCUS, [0.2, -3.9])] {
        let value = |e: &Ellipse, s: f64, x: f64, y: f64| seen(e, s, shape, [x, y]).inside[0];
        let at = seen(&e, s, shape, [x, y]);
        let near = |what: &str, found: f64, up: f64, down: f64| {
            let expected = (up - down) / (2.0 * h);
            assert!((found - expected).abs() < 1e-6, "{what}, {shape:?}: {found}, expected {expected}");
        };
        near("by blur", at.by_blur[0], value(&e, s + h, x, y), value(&e, s - h, x, y));
        near("gradient", at.gradient[0][0], value(&e, s, x + h, y), value(&e, s, x - h, y));
        let gradient = |y: f64| seen(&e, s, shape, [x, y]).gradient;
        near("bend xy", at.bend[1][0], gradient(y + h)[0][0], gradient(y - h)[0][0]);
        near("bend yy", at.bend[2][0], gradient(y + h)[1][0], gradient(y - h)[1][0]);
        for i in 0..3 {
            let moved = |d: f64| {
                let mut q = to_regular(&e);
                q[i] += d;
                let m = from_regular(&q).unwrap_or(e);
                value(&ellipse(m.semi_major_px, m.semi_minor_px), s, x - m.center_px.u_px, y - m.center_px.v_px)
            };
            near("by geometry", at.by_geometry[i][0], moved(h), moved(-h));
        }
    }
}

/// The local profile against the exact disc; what it leaves out is of second order in curvature times blur, and in the shape.
#[test]
fn the_local_profile_has_the_shape_of_the_disc() {
    for (a, b, s, limit) in [(9.0, 8.0, 1.2, 1.2e-3), (30.0, 22.0, 1.6, 4e-4)] {
        let e = ellipse(a, b);
        let frame = Frame::new(&e);
        for (i, shape) in (0..24).flat_map(|i| [(i, DEFOCUS), (i, WINGS)]) {
            let (sin, cos) = (0.26 * f64::from(i)).sin_cos();
            let foot = frame.on_contour(cos, sin);
            let by = |d: f64, s: f64| Profile { blur_px: s, shape, a, b }.at(&[d], &[cos], &[sin]);
            for z in [-2.2, -1.5, -0.5, 0.0, 0.7, 2.0] {
                let (d, found) = (z * s, by(z * s, s));
                let exact = seen(&e, s, shape, [foot.u + d * foot.normal_u, foot.v + d * foot.normal_v]).inside[0];
                let inside = found.inside[0];
                assert!((inside - exact).abs() < limit, "{shape:?} {a} {b} {s}, z {z}: {inside} {exact}");
                let slope = (by(d + 1e-4, s).inside[0] - by(d - 1e-4, s).inside[0]) / 2e-4;
                assert!((found.slope[0] - slope).abs() < 1e-3, "{} {slope}", found.slope[0]);
                let by_blur = (by(d, s + 1e-4).inside[0] - by(d, s - 1e-4).inside[0]) / 2e-4;
                assert!((found.by_blur[0] - by_blur).abs() < 5e-3, "{} {by_blur}", found.by_blur[0]);
            }
        }
    }
}

/// A Gaussian fitted to a straight edge by least squares.
#[test]
fn a_gaussian_looks_wider_behind_defocus() {
    for shape in [DEFOCUS, WINGS] {
        let far = 1e6;
        let edge = |d: f64, s: f64, shape: Shape| {
            Profile { blur_px: s, shape, a: far, b: far }.at(&[d], &[1.0], &[0.0]).inside[0]
        };
        let misfit = |s: f64| {
            (-400..=400)
                .map(|k| edge(0.01 * f64::from(k), 1.0, shape) - edge(0.01 * f64::from(k), s, Shape::GAUSSIAN))
                .map(|x| x * x)
                .sum::<f64>()
        };
        let best = (0..800).map(|k| 0.6 + 0.001 * f64::from(k)).min_by(|a, b| misfit(*a).total_cmp(&misfit(*b)));
        let found = best.unwrap_or(0.0);
        assert!((found - shape.looks_wider()).abs() < 0.02, "{shape:?}: {found} and {}", shape.looks_wider());
    }
}
