//! Columns of discs that are small against their blur: the [`Rim`](crate::detect::rim::Rim) tells what a pixel sees of them.
//!
//! Waves are summed up over its places (`area.rs`). Derivatives by geometry and blur are integrals along the contour over the light there, which of a
//! wave is higher than the image shows it far from the edge, by `exp(s^2 k^2 / 2)`.

use super::area::Lattice;
use super::{Exact, State};
use crate::conic::Frame;
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::exact::products::CHUNK;
use crate::detect::profile::Lanes;
use crate::detect::rim::Seen;
use crate::detect::surface::At;

impl Exact {
    /// Sets up the contour and the step of the light along it.
    pub(super) fn prepare_rim(&mut self, state: &State, frame: &Frame) {
        self.rim.set(frame, state.blur_px, state.shape);
        if let Some(field) = &state.field {
            let lattice = Lattice { spacing: field.spacing, steps: &field.steps };
            self.area.set([frame.a, frame.b], state.blur_px, lattice);
        }
        self.rim.step = if self.light.is_empty() && self.held.len() == self.rim.angles().count() {
            self.held.clone()
        } else {
            self.steps_on_rim(state)
        };
    }

    /// Step of the light at each node of the rim.
    pub(super) fn steps_on_rim(&self, state: &State) -> Vec<f64> {
        self.rim.angles().map(|(c, s)| self.step_at(state, c, s) + self.waves_on_contour(state, c, s)).collect()
    }

    /// Light of the waves on the contour, as it was before the blur took its part of them.
    fn waves_on_contour(&self, state: &State, c: f64, s: f64) -> f64 {
        let Some(field) = state.field.as_ref().filter(|_| !self.light.is_empty()) else { return 0.0 };
        let per_axis = [state.ellipse.semi_major_px, state.ellipse.semi_minor_px].map(|a| state.blur_px / a);
        let light = |(k, height): (&[f64; 2], &[f64])| {
            let (sin, cos) = (k[0] * c + k[1] * s).sin_cos();
            let phase = (k[0] * per_axis[0]).hypot(k[1] * per_axis[1]);
            (height[0] * cos + height[1] * sin) * (0.5 * phase * phase).exp()
        };
        field.waves.iter().zip(self.light.chunks(2)).map(light).sum()
    }

    /// Columns of `shown` pixels from place `i` on.
    pub(super) fn fill_from_rim(
        &mut self,
        state: &State,
        frame: &Frame,
        lanes: &Lanes<LANES>,
        (i, shown): (usize, usize),
        at: usize,
    ) {
        let place = [&self.band.x, &self.band.y].map(|list| super::eight(list, i));
        let seen = self.rim.seen(&place[0], &place[1]);
        let (_, local) = self.feet_and_pixels(state, frame, lanes, (i, shown));
        let pixels: [At; LANES] = std::array::from_fn(|l| exactly(state, &local[l], &seen, l.min(shown - 1)));
        let root = self.roots(state, i, pixels.map(|pixel| pixel.inside.clamp(0.0, 1.0)));
        // Of waves along the profile only what they say of the distance is wanted, which is nothing before they have heights.
        let of_waves = if self.light.is_empty() { [0.0; LANES] } else { self.fill_waves(state, &local, &root, at) };
        let (waves, j) = (state.heights(), Self::lights(state));
        if waves > 0 {
            self.area.fill(&place, &root, &mut self.columns[at..]);
        }
        for l in 0..shown {
            let (p, at, root) = (i + l, at + l, root[l]);
            let expected = self.fill_polynomials(state, &pixels[l], root, at, waves);
            self.columns[at + j * CHUNK] = root * seen.by_blur[l];
            for (m, x) in seen.by_geometry.iter().enumerate() {
                self.columns[at + (j + 1 + m) * CHUNK] = root * x[l];
            }
            self.columns[at + (j + FIXED) * CHUNK] = root * (self.band.grey[p] - expected);
            let step = self.step_at(state, self.band.cos[p], self.band.sin[p]);
            self.response[p] = root * (lanes.slope[l] * step + of_waves[l]);
            self.inside[p] = pixels[l].inside;
        }
    }
}

/// The pixel of lane `l` with what it sees of the disc exactly in place of the profile.
fn exactly(state: &State, local: &At, seen: &Seen, l: usize) -> At {
    let (a, b) = (state.ellipse.semi_major_px, state.ellipse.semi_minor_px);
    let bend = seen.bend.map(|lanes| lanes[l]);
    At {
        inside: seen.inside[l],
        gradient: [seen.gradient[0][l] / a, seen.gradient[1][l] / b],
        bend: [bend[0] / (a * a), bend[1] / (a * b), bend[2] / (b * b)],
        ..*local
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conic::Ellipse;
    use crate::detect::exact::Field;
    use crate::frames::Pixel;
    use std::f64::consts::TAU;

    const AXES: [f64; 2] = [4.8, 4.0];
    const BLUR: f64 = 1.5;
    const WAVE: [f64; 2] = [1.1, 0.9];
    const HEIGHTS: [f64; 2] = [0.8, -0.5];

    fn state() -> State {
        let mut field = Field::default();
        (field.waves, field.steps, field.spacing) = (vec![WAVE], vec![[1, 1]], WAVE);
        let ellipse =
            Ellipse { center_px: Pixel::new(0.0, 0.0), semi_major_px: AXES[0], semi_minor_px: AXES[1], angle_rad: 0.0 };
        State::in_smoke(ellipse, BLUR, 1.0, 1.0, field)
    }

    /// The wave within the disc moved by `moved` px along its major axis, blurred, over a fine grid.
    fn by_grid(moved: f64, at: [f64; 2]) -> f64 {
        const STEP: f64 = 0.02;
        let reach = (6.0 * BLUR / STEP) as i32;
        let mut sum = 0.0;
        for (i, j) in (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (i, j))) {
            let (dx, dy) = (f64::from(i) * STEP, f64::from(j) * STEP);
            let (x, y) = ((at[0] + dx) / AXES[0], (at[1] + dy) / AXES[1]);
            if (x - moved / AXES[0]).powi(2) + y * y < 1.0 {
                let (sin, cos) = (WAVE[0] * x + WAVE[1] * y).sin_cos();
                sum += (-0.5 * (dx * dx + dy * dy) / (BLUR * BLUR)).exp() * (HEIGHTS[0] * cos + HEIGHTS[1] * sin);
            }
        }
        let faded = -0.5 * BLUR * BLUR * ((WAVE[0] / AXES[0]).powi(2) + (WAVE[1] / AXES[1]).powi(2));
        sum * STEP * STEP / (TAU * BLUR * BLUR) / faded.exp()
    }

    #[test]
    fn light_on_the_contour_is_what_moving_the_disc_shows() {
        let state = state();
        // No light but that of the wave.
        let mut light = vec![0.0; Exact::lights(&state)];
        light[..2].copy_from_slice(&HEIGHTS);
        let mut exact = Exact { light, ..Exact::default() };
        exact.prepare_rim(&state, &Frame::new(&state.ellipse));
        for at in [[4.0, 1.0], [-4.9, 0.5], [1.0, -3.0]] {
            const H: f64 = 0.2;
            let expected = (by_grid(H, at) - by_grid(-H, at)) / (2.0 * H);
            let found = exact.rim.seen(&[at[0]; LANES], &[at[1]; LANES]).by_geometry[0][0];
            assert!((found - expected).abs() < 1e-3 + 0.01 * expected.abs(), "at {at:?}: {found} and {expected}");
        }
    }
}
