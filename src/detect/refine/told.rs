//! What single discs tell of what all of an image share: noise, smoke, the shape of the blur.

use super::{Scratch, Start, pixels, refine};
use crate::detect::DetectOptions;
use crate::detect::exact::State;
use crate::detect::shape::of_image;
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
) -> Option<of_image::Told> {
    if let Some(told) = pixels::shape_told(view, start, s) {
        return Some(told);
    }
    let unasked = Start { smoke: false, full_of_smoke: false, asked_for_shape: true, ..*start };
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
