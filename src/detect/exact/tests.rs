//! A fitted disc for the tests of this room.

use super::field::{Field, Spectrum};
use super::{Exact, State};
use crate::conic::{Ellipse, Frame};
use crate::detect::band::Reach;
use crate::detect::contour::Contour;
use crate::frames::Pixel;
use crate::image::{GrayView, Samples};

/// A disc in light that rises to one side, fitted once.
pub(super) fn fitted() -> (Exact, State) {
    let center_px = Pixel::new(14.6, 15.3);
    let ellipse = Ellipse { center_px, semi_major_px: 4.8, semi_minor_px: 4.0, angle_rad: 0.4 };
    let mut field = Field::new(Spectrum::default(), 0.64, &ellipse, 0.8);
    field.amplitude = 9.0;
    let state = State::in_smoke(ellipse, 0.8, 60.0, 2.0, field);
    let light = |u: f64, v: f64| 60.0 * (1.0 + 0.05 * (u - 14.6) - 0.02 * (v - 15.3));
    let mut exact = looked_at(30, &state, light, || 0.0);
    for _ in 0..2 {
        exact.sum_up(&state);
        exact.solve(&state).unwrap();
        exact.light = exact.found[..Exact::lights(&state)].to_vec();
    }
    (exact, state)
}

/// The disc of `state` in a square of `side` px: light beyond a ground of 10, noise, and a logistic edge about as wide as the blur, which no wave
/// explains in full; its pixels are collected, nothing is fitted.
pub(super) fn looked_at(
    side: usize,
    state: &State,
    light: impl Fn(f64, f64) -> f64,
    mut noise: impl FnMut() -> f64,
) -> Exact {
    let (ellipse, blur_px) = (state.ellipse, state.blur_px);
    let frame = Frame::new(&ellipse);
    let grey: Vec<f32> = (0..side * side)
        .map(|i| {
            let (u, v) = ((i % side) as f64, (i / side) as f64);
            let outside = (1.7 * frame.foot(u, v, None).distance / blur_px).exp();
            (10.0 + light(u, v) / (1.0 + outside) + noise()) as f32
        })
        .collect();
    let (mut exact, mut contour) = (Exact::default(), Contour::default());
    contour.cut(&ellipse, &[]);
    let view = GrayView::new(Samples::F32(&grey), side, side, side).unwrap();
    let keep = vec![true; contour.len()];
    let reach = Reach { inner_px: 2.0 * ellipse.semi_major_px, outer_px: 6.0 };
    assert!(exact.look(&view, state, &contour, &keep, reach));
    exact
}
