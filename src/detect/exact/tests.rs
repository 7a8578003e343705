//! A fitted disc for the tests of this room.

use super::field::{Field, Spectrum};
use super::{Exact, State};
use crate::conic::{Ellipse, Frame};
use crate::detect::band::Reach;
use crate::detect::contour::Contour;
use crate::frames::Pixel;
use crate::image::{GrayView, Samples};

const SIDE: usize = 30;

/// A disc in light that rises to one side, fitted once.
pub(super) fn fitted() -> (Exact, State) {
    let center_px = Pixel::new(14.6, 15.3);
    let ellipse = Ellipse { center_px, semi_major_px: 4.8, semi_minor_px: 4.0, angle_rad: 0.4 };
    let (frame, blur_px) = (Frame::new(&ellipse), 0.8);
    let grey: Vec<f32> = (0..SIDE * SIDE)
        .map(|i| {
            let (u, v) = ((i % SIDE) as f64, (i / SIDE) as f64);
            let light = 60.0 * (1.0 + 0.05 * (u - 14.6) - 0.02 * (v - 15.3));
            (10.0 + light / (1.0 + (1.7 * frame.foot(u, v, None).distance / blur_px).exp())) as f32
        })
        .collect();
    let mut field = Field::new(Spectrum::default(), 0.64, &ellipse, blur_px);
    field.amplitude = 9.0;
    let state = State::in_smoke(ellipse, blur_px, 60.0, 2.0, field);
    let (mut exact, mut contour) = (Exact::default(), Contour::default());
    contour.cut(&ellipse, &[]);
    let view = GrayView::new(Samples::F32(&grey), SIDE, SIDE, SIDE).unwrap();
    let keep = vec![true; contour.len()];
    assert!(exact.look(&view, &state, &contour, &keep, Reach { inner_px: 9.6, outer_px: 6.0 }));
    for _ in 0..2 {
        exact.sum_up(&state);
        exact.solve(&state).unwrap();
        exact.light = exact.found[..Exact::lights(&state)].to_vec();
    }
    (exact, state)
}
