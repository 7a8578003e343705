use super::Shape;
use crate::conic::{Ellipse, Frame};
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
