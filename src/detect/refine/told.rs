//! What single discs tell of what all of an image share: noise, smoke, the shape of the blur.

use super::{Scratch, Start, pixels, refine};
use crate::detect::DetectOptions;
use crate::detect::exact::State;
use crate::detect::shape;
use crate::detect::shot_noise::{ShotNoise, Told};
use crate::image::GrayView;

/// What one disc tells of the noise inside; none where it is no disc, or its light is not plain, or it knows it.
pub(crate) fn noise_told(view: &GrayView, start: &Start, options: &DetectOptions, s: &mut Scratch) -> Option<Told> {
    let state = plain(view, start, options, s)?;
    s.exact.noise_told(&state, start.variance)
}

/// What one disc says of smoke, under the noise that all discs tell; none as of [`noise_told`].
pub(crate) fn smoke_told(
    view: &GrayView,
    start: &Start,
    noise: &ShotNoise,
    options: &DetectOptions,
    s: &mut Scratch,
) -> Option<Vec<f64>> {
    let mut state = plain(view, start, options, s)?;
    state.variance = noise.fill([None, Some((state.variance[1], 0.0))], state.step)?;
    Some(s.exact.smoke_told(&state))
}

/// What one disc tells of the shape of the blur, beside that it is taken to have; none where it is no disc, or its light is not plain.
pub(crate) fn shape_told(
    view: &GrayView,
    start: &Start,
    options: &DetectOptions,
    s: &mut Scratch,
) -> Option<shape::told::Told> {
    if let Some(told) = pixels::shape_told(view, start, s) {
        return Some(told);
    }
    let unasked = Start { smoke: false, full_of_smoke: false, asked: true, ..*start };
    let (state, _) = plain_but_for_edge(view, &unasked, options, s)?;
    s.exact.shape_told(&state)
}

/// The disc that was fitted to single pixels, if its light is plain.
fn plain(view: &GrayView, start: &Start, options: &DetectOptions, s: &mut Scratch) -> Option<State> {
    plain_but_for_edge(view, start, options, s).filter(|(_, edge_alone)| !edge_alone).map(|(state, _)| state)
}

/// The same, whatever the profile of its edge; whether it is like no Gaussian's.
fn plain_but_for_edge(
    view: &GrayView,
    start: &Start,
    options: &DetectOptions,
    s: &mut Scratch,
) -> Option<(State, bool)> {
    s.plain = None;
    refine(view, start, options, s).ok()?;
    s.plain.take()
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::{Ellipse, Frame, to_regular};
    use crate::detect::band::LANES;
    use crate::detect::rim::Rim;
    use crate::detect::shape::Shape;
    use crate::frames::Pixel;
    use crate::image::Samples;
    use crate::stats::random::Random;
    use nalgebra::Vector4;

    const SIZE: usize = 72;
    const STEP: f64 = 100.0;
    const NOISE: f64 = 0.1;
    const TRUTH: Ellipse = Ellipse {
        center_px: Pixel { u_px: 34.3, v_px: 35.6 },
        semi_major_px: 13.0,
        semi_minor_px: 11.0,
        angle_rad: 0.5,
    };
    /// Half of the light is blurred less, half more, and all of it shifted either way along u.
    const BLUR_PX: f64 = 1.0;
    const APART: f64 = 0.3;
    const SHIFT_PX: f64 = 0.5;

    /// The disc behind that blur: what it adds to the variance along u, and `cosh (0.3 u) = 1 + 0.3^2 u^2 / 2` of the transfer function.
    fn image() -> Vec<f32> {
        let mut random = Random(9);
        let mut grey: Vec<f64> = (0..SIZE * SIZE).map(|_| 120.0 + NOISE * random.gauss()).collect();
        for (shift, wider) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let frame = Frame::new(&TRUTH);
            let mut rim = Rim::default();
            rim.set(&frame, BLUR_PX * (1.0 + APART * wider).sqrt(), Shape::GAUSSIAN);
            rim.step = vec![0.0; rim.angles().count()];
            for (row, grey) in grey.chunks_mut(SIZE).enumerate() {
                for from in (0..SIZE).step_by(LANES) {
                    let at: [_; LANES] =
                        std::array::from_fn(|l| frame.inside((from + l) as f64 + SHIFT_PX * shift, row as f64));
                    let seen = rim.seen(&at.map(|p| p.0), &at.map(|p| p.1)).inside;
                    grey[from..].iter_mut().zip(seen).for_each(|(g, inside)| *g -= 0.25 * STEP * inside);
                }
            }
        }
        grey.into_iter().map(|g| g as f32).collect()
    }

    /// Both ways tell what was drawn, to the second order of it, and the geometry follows.
    #[test]
    fn a_disc_tells_the_blur_that_it_is_seen_through() {
        let grey = image();
        let view = GrayView::new(Samples::F32(&grey), SIZE, SIZE, SIZE).expect("an image");
        let start = Start { blur_px: 1.5, contrast: STEP, variance: NOISE * NOISE, asked: true, ..Start::alone(TRUTH) };
        let (options, mut s) = (DetectOptions::default(), Scratch::default());
        let clean = pixels::fit_quickly(&view, &start, &mut s).expect("a clean disc");
        let quick = s.quick.shape_told(&clean).expect("equations");
        let by_quick = to_regular(&clean.ellipse) + s.quick.change();
        let (state, _) = plain_but_for_edge(&view, &Start { smoke: true, ..start }, &options, &mut s).expect("a disc");
        let exact = s.exact.shape_told(&state).expect("a disc");
        let along = SHIFT_PX * SHIFT_PX / (BLUR_PX * BLUR_PX + 0.5 * SHIFT_PX * SHIFT_PX);
        let drawn = Vector4::new(0.5 * APART * APART, 0.0, 0.5 * along, 0.0);
        for (told, found) in [(&quick, by_quick), (&exact, to_regular(&state.ellipse))] {
            let x = told.information.try_inverse().expect("information") * told.right;
            let off = found - to_regular(&TRUTH);
            let left = off + told.follows * x;
            let beside = (x - drawn).abs();
            assert!(
                beside[0] < 0.02 && beside[1] < 0.01 && beside[2] < 0.015 && beside[3] < 0.005,
                "told {x}, drawn {drawn}"
            );
            assert!(off.norm() > 0.005 && left.norm() < 0.25 * off.norm(), "off by {off}, with the shape {left}");
        }
    }
}
