//! What the second order of the model does to the mean of blur and geometry, taken back.
//!
//! A grey value is the product of the light and of what a pixel sees of the disc: where the light at the edge is found too bright, the edge is found
//! too far in, and the errors of both go together. So the most likely values are off in the mean over noise and light, to second order by `-C T`,
//!
//! ```text
//! A   = J^T W J + Lambda^-1,   C = A^-1
//! T_g = -sum_p w_p sum_h f_gh (C J_p)_h + (C_gg)^-1 sum_p w_p (C J_p)_g tr(f_gg C_gg) / 2,   T_h = 0
//! ```
//!
//! The mean of the posterior lies `-C_ij U_jkl C_kl / 2` from its top (Laplace; U half of `chi^2` and prior), and, of a prior of `g` that is flat, off the
//! truth by `sum_g dC_ig / dg`; over the light, which has a prior, the mean is taken. (Were the light known to stay, Box's bias would come out, J. R. Stat. Soc. B 33,
//! 1971.) In T is half the derivative of `ln det` of the light's block: a larger disc has more room for light, and explains more by that alone. The light
//! stands still in the image while the disc moves. How distances bend with the geometry is left out, 0.0003 px for discs of 4 px. The profile is
//! a Gaussian's: `f_dd = -R z / s`, `f_ds = R (z^2 - 1) / s`, `f_ss = R z (2 - z^2) / s`.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | g, h | | 6, n | | blur and geometry; unknowns of the light |
//! | f_gh, f_gg | | | | second derivatives of the grey value of pixel p, whose first are `J_p` |
//! | C J_p | `Exact::followed` | n + 6 | | by how much the unknowns follow the grey value of a pixel |
//! | C_gg | `covariance` | 6 x 6 | | covariance of blur and geometry |
//! | R | `Exact::response` | 1 | grey/px | derivative of the grey value by the distance d |
//! | z, s | `At::depth`, `At::blur_px` | 1 | 1, px | distance in units of the blur; blur |
//! | T | `Exact::tilt` | 6 | | added to the right side of the equations |

use super::waves::{Each, Heights, Waves};
use super::{Exact, State, polynomial_step};
use crate::conic::{Frame, OnContour, inverse_of_lower};
use crate::detect::band::LANES;
use crate::detect::dense::FIXED;
use crate::detect::exact::products::CHUNK;
use crate::detect::profile::Lanes;
use crate::detect::surface::At;
use crate::lanes;
use nalgebra::{SMatrix, SVector};

/// Distance from the edge beyond which a pixel does not feel it, in units of the blur.
const FAR: f64 = 5.0;

type Fixed = SVector<f64, FIXED>;

/// Derivatives of the distance of a pixel by blur and geometry where the blur is one of them: what it does to the grey value, over what the distance does.
fn row(foot: &OnContour, lanes: &Lanes<LANES>, l: usize) -> Fixed {
    let by_blur = if lanes.slope[l].abs() > 1e-9 { lanes.by_blur[l] / lanes.slope[l] } else { 0.0 };
    Fixed::from_fn(|k, _| if k == 0 { by_blur } else { foot.row[k - 1] })
}

/// `tr(f_gg C_gg)` over the derivative of the grey value by the distance, 1.
fn bend(pixel: &At, row: &Fixed, covariance: &SMatrix<f64, FIXED, FIXED>) -> f64 {
    let (z, s) = (pixel.depth, pixel.blur_px);
    let by_distance = Fixed::from_fn(|k, _| if k == 0 { 0.0 } else { row[k] });
    let spread = covariance * by_distance;
    let (dd, ds, ss) = (by_distance.dot(&spread), spread[0], covariance[(0, 0)]);
    (-z * dd + 2.0 * (z * z - 1.0) * ds + z * (2.0 - z * z) * ss) / s
}

impl Exact {
    /// `T` of blur and geometry, from the factor and the light that were found last.
    pub(super) fn second_order(&mut self, state: &State) -> Option<Fixed> {
        let (n, frame) = (Self::lights(state) + FIXED, Frame::new(&state.ellipse));
        let factor = self.dense.fixed_factor(n);
        let root = inverse_of_lower(&factor)?;
        let covariance = root.tr_mul(&root);
        self.prepare(state, &frame);
        let (mut followed, mut bent) = (Fixed::zeros(), Fixed::zeros());
        for i in (0..self.count).step_by(LANES) {
            let shown = LANES.min(self.count - i);
            if self.band.distance[i..i + shown].iter().all(|d| d.abs() > FAR * state.blur_px) {
                continue;
            }
            let [x, y] = self.second_of_lanes(state, &frame, &covariance, (i, shown));
            followed += x;
            bent += y;
        }
        let found = factor * (factor.transpose() * bent) - followed;
        // Beyond a standard deviation the second order says nothing.
        Some(found / found.dot(&(covariance * found)).max(1.0))
    }

    /// Both sums of [`Exact::second_order`] over the `shown` pixels from place `i` on.
    fn second_of_lanes(
        &mut self,
        state: &State,
        frame: &Frame,
        covariance: &SMatrix<f64, FIXED, FIXED>,
        (i, shown): (usize, usize),
    ) -> [Fixed; 2] {
        let lights = Self::lights(state);
        self.fill(state, frame, i, 0);
        self.followed.clear();
        self.followed
            .extend((0..lights + FIXED).map(|j| -> Each { std::array::from_fn(|l| self.columns[j * CHUNK + l]) }));
        self.dense.solve_each(&mut self.followed);
        let lanes = self.profile(state, i);
        let (feet, pixels) = self.feet_and_pixels(state, frame, &lanes, (i, shown));
        let root = self.roots(state, i, std::array::from_fn(|l| self.inside[i + l].clamp(0.0, 1.0)));
        let of_waves = state.field.as_ref().map_or([0.0; LANES], |field| {
            let heights = Heights::Each(&self.followed);
            let (columns, turns) = (&mut self.columns[..], &mut self.turns);
            lanes::run(Waves { field, pixels: &pixels, root: &root, heights, columns, turns })
        });
        let (mut followed, mut bent) = (Fixed::zeros(), Fixed::zeros());
        for l in 0..shown {
            let (p, row) = (i + l, row(&feet[l], &lanes, l));
            let step = polynomial_step(state, self.band.cos[p], self.band.sin[p], |j| self.followed[j][l]);
            followed += row * (root[l] * (pixels[l].slope * step + of_waves[l]));
            let geometry = Fixed::from_fn(|k, _| self.followed[lights + k][l]);
            bent += geometry * (0.5 * self.response[p] * bend(&pixels[l], &row, covariance));
        }
        [followed, bent]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::exact::tests::fitted;
    use nalgebra::DMatrix;

    /// Columns of all pixels and the derivative of their grey values by the distance.
    fn columns(exact: &mut Exact, state: &State) -> (DMatrix<f64>, Vec<f64>) {
        let n = Exact::lights(state) + FIXED;
        exact.prepare(state, &Frame::new(&state.ellipse));
        let mut out = DMatrix::zeros(exact.count, n);
        for i in (0..exact.count).step_by(LANES) {
            exact.fill(state, &Frame::new(&state.ellipse), i, 0);
            for (l, j) in (0..LANES.min(exact.count - i)).flat_map(|l| (0..n).map(move |j| (l, j))) {
                out[(i + l, j)] = exact.columns[l + j * CHUNK];
            }
        }
        (out, exact.response.clone())
    }

    /// Second derivatives by differences, the inverse of all equations, sums over all pixels and unknowns.
    #[test]
    fn sums_are_those_of_all_second_derivatives() {
        let (mut exact, state) = fitted();
        let found = exact.second_order(&state).unwrap();
        let lights = Exact::lights(&state);
        let n = lights + FIXED;
        let factor = DMatrix::from_fn(n, n, |i, j| if j <= i { exact.dense.matrix[i * n + j] } else { 0.0 });
        let c = (&factor * factor.transpose()).try_inverse().unwrap();
        let (jacobian, _) = columns(&mut exact, &state);
        let followed = &jacobian * &c;
        let geometry = |m: &DMatrix<f64>, p: usize| Fixed::from_fn(|k, _| m[(p, lights + k)]);
        let mut by_light = Fixed::zeros();
        for h in 0..lights {
            exact.light[h] += 1.0;
            let (moved, _) = columns(&mut exact, &state);
            exact.light[h] -= 1.0;
            for p in 0..exact.count {
                by_light += (geometry(&moved, p) - geometry(&jacobian, p)) * followed[(p, h)];
            }
        }
        const H: f64 = 1e-3;
        let mut shifted = |distance: f64, blur: f64| {
            let other = State { blur_px: state.blur_px + blur, ..state.clone() };
            exact.band.distance.iter_mut().for_each(|d| *d += distance);
            let out = columns(&mut exact, &other);
            exact.band.distance.iter_mut().for_each(|d| *d -= distance);
            out
        };
        let [further, nearer, wider, narrower] = [(H, 0.0), (-H, 0.0), (0.0, H), (0.0, -H)].map(|(d, s)| shifted(d, s));
        let covariance = c.fixed_view::<FIXED, FIXED>(lights, lights).into_owned();
        let (frame, mut bent) = (Frame::new(&state.ellipse), Fixed::zeros());
        for p in 0..exact.count {
            let foot = frame.on_contour(exact.band.cos[p], exact.band.sin[p]);
            let row = Fixed::from_fn(|k, _| if k == 0 { 0.0 } else { foot.row[k - 1] });
            let by = |up: f64, down: f64| (up - down) / (2.0 * H);
            let (dd, ds) = (by(further.1[p], nearer.1[p]), by(wider.1[p], narrower.1[p]));
            let ss = by(wider.0[(p, lights)], narrower.0[(p, lights)]);
            let spread = covariance * row;
            let trace = dd * row.dot(&spread) + 2.0 * ds * spread[0] + ss * covariance[(0, 0)];
            bent += geometry(&followed, p) * (0.5 * trace);
        }
        // What it moves, px, is compared: the numbers themselves differ by orders of magnitude.
        let (moved, expected) = (covariance * found, bent - covariance * by_light);
        println!(
            "moves blur and geometry by {:.5?}, expected {:.5?}, of it {:.5?} without the light",
            moved.as_slice(),
            expected.as_slice(),
            bent.as_slice()
        );
        assert!(expected.norm() > 0.004 && bent.norm() > 0.0005);
        assert!((moved - expected).norm() < 0.0001 + 0.02 * expected.norm());
    }
}
