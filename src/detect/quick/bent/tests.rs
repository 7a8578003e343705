#![allow(clippy::expect_used)]

use super::*;
use crate::conic::{Ellipse, Frame, to_regular};
use crate::detect::contour::Contour;
use crate::detect::exact::{Exact, State};
use crate::detect::quick::pixels::{Collect, Rings};
use crate::detect::quick::{Clean, Quick};
use crate::detect::refine::Start;
use crate::detect::shape::Shape;
use crate::frames::Pixel;
use crate::lanes;
use crate::stats::random::Random;
use nalgebra::{DMatrix, DVector};

const LARGE: Ellipse = Ellipse {
    center_px: Pixel { u_px: 150.3, v_px: 148.8 },
    semi_major_px: 112.0,
    semi_minor_px: 95.0,
    angle_rad: 0.5,
};
const SIZE: usize = 300;

/// Both coordinates of a pixel in units of the semi-axes.
fn place(frame: &Frame, u: f64, v: f64) -> [f64; 2] {
    let (du, dv) = (u - frame.u0, v - frame.v0);
    [(frame.cos * du + frame.sin * dv) / frame.a, (frame.cos * dv - frame.sin * du) / frame.b]
}

/// A dark disc under light that falls by `bend` from the middle of the picture to the middle of its borders.
fn picture(bend: f64, noise: f64, seed: u64) -> Vec<u16> {
    picture_in(|u, v| 1.0 - bend * ((u / 150.0 - 1.2).powi(2) + 0.4 * (v / 150.0 - 0.9).powi(2)), noise, seed)
}

/// A dark disc in some light.
fn picture_in(light: impl Fn(f64, f64) -> f64, noise: f64, seed: u64) -> Vec<u16> {
    let (frame, mut random) = (Frame::new(&LARGE), Random(seed));
    let mut grey = vec![];
    for (v, u) in (0..SIZE).flat_map(|v| (0..SIZE).map(move |u| (v as f64, u as f64))) {
        let [x, y] = place(&frame, u, v);
        let q = x.hypot(y).max(1e-9);
        let d = (q - 1.0) * q / (x / frame.a).hypot(y / frame.b);
        // The normal distribution to 1.4e-4.
        let z = d / 0.8;
        let inside = 1.0 / (1.0 + (z * (1.5976 + 0.07056 * z * z)).exp());
        let shown = 40_000.0 * light(u, v) * (1.0 - 0.8 * inside) + noise * random.gauss();
        grey.push(shown.round().clamp(0.0, 65_535.0) as u16);
    }
    grey
}

/// Closed forms over rows against sums over single pixels, of all kinds of samples.
#[test]
fn sums_over_rows_are_those_over_pixels() {
    let wide = picture(0.2, 300.0, 3);
    let narrow: Vec<u8> = wide.iter().map(|x| (x >> 8) as u8).collect();
    let floats: Vec<f32> = wide.iter().map(|x| f32::from(*x) * 0.37).collect();
    let frame = Frame::new(&LARGE);
    for samples in [Samples::U16(&wide), Samples::U8(&narrow), Samples::F32(&floats)] {
        let view = GrayView::new(samples, SIZE, SIZE, SIZE).expect("an image");
        let mut quick = Quick::default();
        let rings = Rings { near: 3.0, inner: 9.0, outer: 8.0, thin: 1, fetch: false };
        quick.frame = Frame::new(&LARGE);
        assert!(lanes::run(Collect { view: &view, frame: &frame, rings, out: &mut quick.pixels }));
        let pixels = &quick.pixels;
        for side in 0..2 {
            let bent = Bent::new(&view, pixels, side, &quick.turn(), (1e9, &Allowance::NONE), 1.0).expect("a surface");
            let (mut matrix, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
            let light = SVector::<f64, 6>::from([3.0, 50.0, -20.0, 30.0, 40.0, -25.0]);
            let mut left = 0.0;
            for run in &pixels.runs[side] {
                let first = run.u / run.n - 0.5 * (run.n - 1.0) + pixels.reference.0;
                let mut sum = 0.0;
                for i in 0..run.n as usize {
                    let (u, v) = (first + i as f64, run.v + pixels.reference.1);
                    let [x, y] = place(&frame, u, v);
                    let basis = SVector::from([1.0, x * x + y * y - 1.0, x, y, x * x - y * y, 2.0 * x * y]);
                    let grey = f64::from(view.get(u as usize, v as usize)) - pixels.ground;
                    matrix += basis * basis.transpose();
                    right += basis * grey;
                    sum += grey - basis.dot(&light);
                }
                left += sum * sum / run.n;
            }
            let (found, plain) = (bent.fits.matrix, matrix);
            assert!((found - plain).amax() < 1e-9 * plain.amax(), "{found} {plain}");
            assert!((bent.fits.right - right).amax() < 1e-9 * right.amax());
            let (third, third_plain) =
                (bent.moments.left_by_third_degree().expect("a surface"), third(&view, pixels, side));
            assert!((third - third_plain).abs() < 1e-7 * third_plain, "{third} {third_plain}");
            let (sum, count) = bent.left_by_rows(&pixels.runs[side], &light);
            assert!((sum - left).abs() < 1e-9 * left && count == pixels.runs[side].len() as f64);
        }
    }
}

/// Squares that a surface of third degree leaves of the pixels of one side, in units of a hundred pixels about the middle of the image, by a singular value
/// decomposition.
fn third(view: &GrayView, pixels: &Pixels, side: usize) -> f64 {
    let (mut rows, mut right) = (vec![], vec![]);
    for run in &pixels.runs[side] {
        let first = run.u / run.n - 0.5 * (run.n - 1.0) + pixels.reference.0;
        for i in 0..run.n as usize {
            let (u, v) = (first + i as f64, run.v + pixels.reference.1);
            let (x, y) = (u / 100.0 - 1.5, v / 100.0 - 1.5);
            rows.extend([1.0, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]);
            right.push(f64::from(view.get(u as usize, v as usize)) - pixels.ground);
        }
    }
    let (a, b) = (DMatrix::from_row_slice(right.len(), 10, &rows), DVector::from_vec(right));
    let x = a.clone().svd(true, true).solve(&b, 1e-12).expect("a solution");
    (b - a * x).norm_squared()
}

/// How often chance surpasses the limits of what is the same light.
#[test]
fn limits_are_what_chance_makes() {
    use crate::stats::chi_square_above;
    let (coefficients, third) = (SURFACE.len() as f64, (CUBIC - SURFACE.len()) as f64);
    assert!((chi_square_above(SAME_LIGHT, coefficients) - 1e-3).abs() < 1e-4);
    assert!((chi_square_above(THIRD_DEGREE, third) - 1e-2).abs() < 1e-3);
}

fn start_beside() -> Clean {
    let mut ellipse = LARGE;
    ellipse.center_px.u_px += 0.3;
    ellipse.semi_minor_px -= 0.2;
    Clean {
        near: false,
        ellipse,
        blur_px: 0.8,
        expected_blur_px: 0.8,
        shape: Shape::GAUSSIAN,
        step: -32_000.0,
        slopes: [[0.0; 2]; 2],
        variance: [1.0; 2],
        allow: Allowance::NONE,
        shot_noise: None,
    }
}

/// Pixels further off say more of light that bends: sigmas become smaller, and by so much as they say results move. More pixels take from the covariance of a
/// result that of its change.
#[test]
fn light_seen_from_afar_has_true_sigmas() {
    let (mut z2, mut ratio, pictures) = (0.0, 0.0, 20);
    for seed in 0..pictures {
        let grey = picture(0.1, 350.0, 100 + seed);
        let view = GrayView::new(Samples::U16(&grey), SIZE, SIZE, SIZE).expect("an image");
        let (mut near, mut state) = (start_beside(), start_beside());
        let (mut narrow, mut quick) = (Quick { same_beyond: Some([false; 2]), ..Quick::default() }, Quick::default());
        narrow.rounds(&view, &mut near, f64::INFINITY, 0.1).expect("a clean disc");
        quick.fit(&view, &mut state, f64::INFINITY, 0.1).expect("a clean disc");
        assert_eq!(quick.same_beyond, Some([true; 2]));
        let [wide, own] = [(&quick, &state), (&narrow, &near)].map(|(q, s)| to_regular(&s.ellipse) + q.change());
        let apart = narrow.covariance() - quick.covariance();
        z2 += (wide - own).dot(&(apart.try_inverse().expect("a covariance") * (wide - own))) / 5.0;
        ratio += (quick.covariance().determinant() / narrow.covariance().determinant()).powf(0.1);
    }
    let (z2, ratio) = (z2 / pictures as f64, ratio / pictures as f64);
    println!("mean z^2 {z2:.2}, sigmas {ratio:.2} times those of the pixels near the edge");
    assert!((0.6..1.5).contains(&z2) && ratio < 0.9, "{z2} {ratio}");
}

/// Light of the third degree, or a shadow in the middle of the disc, is not seen from afar: where the pixels differ from a surface by a fraction of their noise.
#[test]
fn other_light_further_off_does_not_count() {
    let bends = |u: f64, v: f64| 1.0 - 0.1 * ((u / 150.0 - 1.2).powi(2) + 0.4 * (v / 150.0 - 0.9).powi(2));
    let third = |u: f64, v: f64| bends(u, v) + 0.03 * (u / 150.0 - 1.0).powi(3);
    let shadow = |u: f64, v: f64| {
        let away = (u - 140.0).hypot(v - 150.0);
        bends(u, v) - if away < 40.0 { 0.02 } else { 0.0 }
    };
    let lights: [(&dyn Fn(f64, f64) -> f64, [bool; 2]); 3] =
        [(&bends, [true, true]), (&third, [false, false]), (&shadow, [false, true])];
    for (i, (light, wanted)) in lights.into_iter().enumerate() {
        let grey = picture_in(light, 150.0, 7 + i as u64);
        let view = GrayView::new(Samples::U16(&grey), SIZE, SIZE, SIZE).expect("an image");
        let (mut quick, mut state) = (Quick::default(), start_beside());
        quick.fit(&view, &mut state, f64::INFINITY, 0.1).expect("a clean disc");
        assert_eq!(quick.same_beyond, Some(wanted), "light {i}");
    }
}

/// The quick fit of a large disc under light that bends, and the fit to every pixel by itself in double precision.
#[test]
fn bent_light_is_fitted_as_the_longer_way_does() {
    let floor = 1.0 / 12.0;
    for (bend, noise, seed) in [(0.25, 350.0, 1), (0.1, 350.0, 2), (0.05, 100.0, 3)] {
        let grey = picture(bend, noise, seed);
        let view = GrayView::new(Samples::U16(&grey), SIZE, SIZE, SIZE).expect("an image");
        let (mut state, mut contour) = (start_beside(), Contour::default());
        let (blur_px, step) = (state.blur_px, state.step);
        // The longer way sees the pixels near the edge alone.
        let mut quick = Quick { same_beyond: Some([false; 2]), ..Quick::default() };
        quick.rounds(&view, &mut state, f64::INFINITY, floor).expect("a clean disc");
        contour.cut(&state.ellipse, &[]);
        quick.share_out(&contour);
        assert!(quick.clean(&state), "bend {bend}");
        let sides = quick.bent.as_ref().expect("light that bends").each_ref().map(|b| b.side);
        assert!(sides.iter().all(|s| s.degree == 2));

        let start = Start { level: 1, blur_px, contrast: -step, ..Start::alone(LARGE) };
        let (variance, field) = (state.variance, None);
        let mut plain = State {
            ellipse: LARGE,
            blur_px,
            expected_blur_px: blur_px,
            shape: Shape::GAUSSIAN,
            sides,
            field,
            slopes: [[0.0; 2]; 2],
            variance,
            step: state.step,
            full_of_smoke: false,
            allow: Allowance::NONE,
        };
        let mut exact = Exact::default();
        let keep = vec![true; contour.len()];
        exact.settle(&view, &mut plain, &mut contour, &keep, &start, floor).expect("a fit");
        let (longer, _, _) = exact.finished(&plain).expect("an ellipse");
        let (found, wanted) = (to_regular(&state.ellipse) + quick.change(), to_regular(&longer));
        let covariance = exact.covariance();
        for i in 0..5 {
            let sigma = covariance[(i, i)].sqrt();
            let ratio = quick.covariance()[(i, i)].sqrt() / sigma;
            let z = (found[i] - wanted[i]) / sigma;
            assert!(z.abs() < 0.1 && (ratio - 1.0).abs() < 0.03, "bend {bend}, {i}: {z} sigma, ratio {ratio}");
        }
    }
}
