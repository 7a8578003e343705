//! The profile of a blurred curved edge.
//!
//! A disc whose boundary bends away from its tangent by `h(t) = kappa t^2 / 2 + kappa' t^3 / 6 + c4 t^4` covers, after a Gaussian blur
//! of standard deviation `s`, a pixel at the distance `d` outside the boundary to
//!
//! ```text
//! P = Prob(N < -(d + h(T)) / s) = Prob(W < -d / s),   W = N + h(T) / s,   N standard normal, T ~ N(0, s^2)
//! ```
//!
//! exactly, as long as the far side of the disc is out of reach. With `eps = kappa s` the cumulants of `W` are
//!
//! ```text
//! mean mu = eps/2 + 3 c4 s^3,   variance 1 + eps^2/2 + 12 kappa c4 s^4 + 5/12 kappa'^2 s^4,   third eps^3,   fourth 3 eps^4
//! ```
//!
//! and the Edgeworth series turns them into `P`; `eps/2` alone is the usual inward shift of a blurred edge. For an ellipse
//! `c4 = kappa^(5/3) (ab)^(-2/3) / 8 + 5 kappa'^2 / (72 kappa)` (its affine curvature is constant).
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | P | `inside` | 1 | share of the disc in the blurred pixel |
//! | dP/dd | `slope` | 1/px | derivative by the distance |
//! | dP/ds | `by_blur` | 1/px | derivative by the blur |
//! | - | `depth` | 1 | `(d/s + mu) / sqrt(variance)`: the distance in units of the blur as the profile sees it |
//!
//! Where the blur is no Gaussian's its shape is added ([`crate::detect::shape`]).
//!
//! Not valid where `eps` exceeds about one half.

use crate::detect::band::LANES;
use crate::detect::sectors::normal_tails;
use crate::detect::shape::{Shape, of_edge};
use crate::lanes::{self, Kernel};

/// One disc's part in the profile: what its pixels share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Profile {
    pub(crate) blur_px: f64,
    pub(crate) shape: Shape,
    pub(crate) a: f64,
    pub(crate) b: f64,
}

/// The profile at several pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lanes<const N: usize> {
    pub(crate) inside: [f64; N],
    pub(crate) slope: [f64; N],
    pub(crate) by_blur: [f64; N],
    pub(crate) depth: [f64; N],
    pub(crate) density: [f64; N],
    pub(crate) narrow: [f64; N],
}

impl Profile {
    /// At pixels with distances `d`, whose foot points have the eccentric angles with `cos` and `sin`.
    #[inline(always)]
    pub(crate) fn at<const N: usize>(&self, d: &[f64; N], cos: &[f64; N], sin: &[f64; N]) -> Lanes<N> {
        let (s, a, b) = (self.blur_px, self.a, self.b);
        let (s2, inverse) = (s * s, 1.0 / s);
        let (e2, affine) = (a * a - b * b, 1.0 / 8.0);
        let none = [0.0; N];
        let mut out = Lanes { inside: none, slope: none, by_blur: none, depth: none, density: none, narrow: none };
        let (mut y, mut root, mut eps, mut mean_by_blur, mut variance_by_blur) = (none, none, none, none, none);
        for i in 0..N {
            let (c, sn) = (cos[i], sin[i]);
            let n2 = b * b * c * c + a * a * sn * sn;
            let n = n2.sqrt();
            let kappa = a * b / (n2 * n);
            let turn = -3.0 * a * b * e2 * sn * c / (n2 * n2 * n2);
            // kappa^(5/3) (ab)^(-2/3) = ab / N^5
            let c4 = affine * a * b / (n2 * n2 * n) + 5.0 / 72.0 * turn * turn / kappa;
            eps[i] = kappa * s;
            let mean = 0.5 * eps[i] + 3.0 * c4 * s2 * s;
            let bends = (12.0 * kappa * c4 + 5.0 / 12.0 * turn * turn) * s2 * s2;
            let variance = 1.0 + 0.5 * eps[i] * eps[i] + bends;
            variance_by_blur[i] = (eps[i] * eps[i] + 4.0 * bends) * inverse;
            root[i] = 1.0 / variance.sqrt();
            mean_by_blur[i] = 0.5 * kappa + 9.0 * c4 * s2;
            y[i] = (d[i] * inverse + mean) * root[i];
        }
        normal_tails(&y, &mut out.inside, &mut out.density);
        let mut depth_by_blur = none;
        for i in 0..N {
            let (y, r, f) = (y[i], root[i], out.density[i]);
            let y2 = y * y;
            let bent = eps[i] * r;
            let third = bent * bent * bent * (1.0 / 6.0);
            let fourth = 0.125 * (bent * bent) * (bent * bent);
            let sixth = 0.5 * third * third;
            // He_2 and He_4 .. He_6 are even or odd: the tail is taken at -y.
            let (he2, he3, he4) = (y2 - 1.0, y * (y2 - 3.0), y2 * (y2 - 6.0) + 3.0);
            let he5 = y * (y2 * (y2 - 10.0) + 15.0);
            let he6 = y2 * (y2 * (y2 - 15.0) + 45.0) - 15.0;
            out.inside[i] += f * (-third * he2 + fourth * he3 + sixth * he5);
            let shape = 1.0 - third * he3 + fourth * he4 + sixth * he6;
            out.slope[i] = -f * shape * r * inverse;
            let widening = 0.5 * variance_by_blur[i] * r * r;
            let y_by_blur = (mean_by_blur[i] - d[i] * inverse * inverse) * r - y * widening;
            let shape_by_blur = (inverse - widening) * (-3.0 * third * he2 + 4.0 * fourth * he3 + 6.0 * sixth * he5);
            out.by_blur[i] = f * (shape_by_blur - shape * y_by_blur);
            out.depth[i] = y;
            out.narrow[i] = r;
            depth_by_blur[i] = y_by_blur;
        }
        if !self.shape.is_gaussian() {
            self.add_shape(&eps, &depth_by_blur, &mut out);
        }
        out
    }

    /// What the shape adds to the profile of a Gaussian; given `eps` and the derivative of the depth by the blur.
    #[inline(always)]
    fn add_shape<const N: usize>(&self, eps: &[f64; N], depth_by_blur: &[f64; N], out: &mut Lanes<N>) {
        let (shape, inverse) = ([self.shape.fourth, self.shape.sixth], 1.0 / self.blur_px);
        for i in 0..N {
            let (f, added) = (out.density[i], of_edge(shape, out.depth[i], eps[i]));
            out.inside[i] += f * added.share;
            out.slope[i] += f * added.by_depth * out.narrow[i] * inverse;
            out.by_blur[i] += f * (added.by_depth * depth_by_blur[i] + added.by_bend * eps[i] * inverse);
        }
    }
}

/// [`Profile::at`] as wide as the processor is.
#[derive(Clone)]
pub(crate) struct Profiled {
    pub(crate) profile: Profile,
    pub(crate) distance: [f64; LANES],
    pub(crate) cos: [f64; LANES],
    pub(crate) sin: [f64; LANES],
}

impl Kernel for Profiled {
    type Output = Lanes<LANES>;
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) -> Lanes<LANES> {
        self.profile.at(&self.distance, &self.cos, &self.sin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_widths_give_the_same_bits() {
        let angle = [0.1_f64, 0.7, 1.3, 2.0, 2.9, 4.0, 4.4, 6.0];
        let distance = [-3.0, -1.2, -0.4, 0.0, 0.3, 0.9, 2.0, 4.0];
        let profile = Profile { blur_px: 0.9, shape: Shape::GAUSSIAN, a: 7.0, b: 4.0 };
        let kernel = Profiled { profile, distance, cos: angle.map(f64::cos), sin: angle.map(f64::sin) };
        let plain = profile.at(&kernel.distance, &kernel.cos, &kernel.sin);
        let bits = |p: &Lanes<LANES>| {
            [p.inside, p.slope, p.by_blur, p.depth, p.density, p.narrow].map(|list| list.map(f64::to_bits))
        };
        for wide in lanes::run_all(&kernel) {
            assert_eq!(bits(&wide), bits(&plain));
        }
        assert!(plain.inside.windows(2).all(|p| p[0] > p[1]), "{:?}", plain.inside);
    }
}
