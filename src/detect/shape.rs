//! The shape of the blur, where it is no Gaussian's.
//!
//! A lens out of focus spreads light over a disc, one that is stopped down over rings. An edge behind such a blur, fitted with a Gaussian's, lies
//! where it should only as long as noise is the same on both sides and the contour is straight: its standard deviation comes out wrong by some
//! percent, and a curved edge lies `kappa s^2 / 2` inside of the sharp one. All discs of an image are seen through one lens, and tell its shape together
//! ([`of_image`]). With `u = (s k)^2 / 2`, k the wave number, the optical transfer function is
//!
//! ```text
//! exp(-u) (1 + c u^2 + e u^3)
//! ```
//!
//! s being the standard deviation whatever c and e are. Of a lens out of focus c is down to -0.1 and e to -0.06, of a lens stopped down c is up to 0.5.
//! As `u` is `-s^2 / 2` times the Laplacian, a straight edge adds derivatives of its profile; a curved one, isotropic blur taken for granted,
//! what they are away from where the mean of the other direction bends it, to the first order in `eps = kappa s`:
//!
//! ```text
//! P - P_gauss = phi(y) (c/4 (He3 - 2 eps He2) - e/8 (He5 - 3 eps He4)) (y)
//! ```
//!
//! and a point, seen `h = rho^2 / 2 s^2` off, is brighter by `q = 1 + c (h^2 - 4h + 2) - e (h^3 - 9h^2 + 18h - 6)` (polynomials of Laguerre, by the
//! heat equation `d/d(s^2) = Laplacian / 2`).
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | c, e | `Shape::fourth`, `Shape::sixth` | 1 | what the transfer function has of fourth and sixth order |
//! | y, phi | - | 1 | distance in units of the blur as the profile sees it, see [`crate::detect::profile`]; density of the normal distribution there |
//! | He | - | 1 | Hermite's polynomials |

pub(crate) mod of_image;
#[cfg(test)]
mod tests;
pub(crate) mod told;

use crate::lanes::Several;

/// Of fourth and of sixth order; none of a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Shape {
    pub(crate) fourth: f64,
    pub(crate) sixth: f64,
}

/// What a shape adds to the profile of an edge, each over the density there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Added<S> {
    /// To the share of the disc.
    pub(crate) share: S,
    /// To its derivative by `y`, and to that by `eps`.
    pub(crate) by_depth: S,
    pub(crate) by_bend: S,
}

impl Shape {
    pub(crate) const GAUSSIAN: Self = Self { fourth: 0.0, sixth: 0.0 };

    pub(crate) fn is_gaussian(&self) -> bool {
        *self == Self::GAUSSIAN
    }

    /// Standard deviation of the Gaussian that an edge behind this blur is fitted by, over its own: least squares along a straight edge.
    pub(crate) fn looks_wider(&self) -> f64 {
        1.0 - 0.375 * self.fourth - 0.468_75 * self.sixth
    }

    /// `q` of a point, and `q - q'`, by which the second derivatives grow, at `h`.
    #[inline(always)]
    pub(crate) fn of_point<S: Several<f64>>(&self, h: S) -> [S; 2] {
        let [one, c, e] = [1.0, self.fourth, self.sixth].map(S::splat);
        let number = |x: f64| S::splat(x);
        let second = h * (h - number(4.0)) + number(2.0);
        let third = h * (h * (h - number(9.0)) + number(18.0)) - number(6.0);
        let (by_second, by_third) = (h + h - number(4.0), h * (number(3.0) * h - number(18.0)) + number(18.0));
        let q = one + c * second - e * third;
        [q, q - (c * by_second - e * by_third)]
    }

    /// What the integral of the points nearer than `h` lacks, over `exp(-h)`: of a Gaussian it is `(1 - exp(-h)) / h`.
    #[inline(always)]
    pub(crate) fn of_disc<S: Several<f64>>(&self, h: S) -> S {
        let [c, e] = [self.fourth, self.sixth].map(S::splat);
        let number = |x: f64| S::splat(x);
        c * (h - number(2.0)) - e * (h * (h - number(6.0)) + number(6.0))
    }
}

/// What fourth and sixth order add to the profile of an edge, of one each, at the depth `y` where the contour is bent by `eps`.
#[inline(always)]
pub(crate) fn orders_of_edge<X: From<f32>, S: Several<X>>(y: S, eps: S) -> [Added<S>; 2] {
    let number = |x: f32| S::splat(X::from(x));
    let y2 = y * y;
    let (he2, he3) = (y2 - number(1.0), y * (y2 - number(3.0)));
    let he4 = y2 * (y2 - number(6.0)) + number(3.0);
    let he5 = y * (y2 * (y2 - number(10.0)) + number(15.0));
    let he6 = y2 * (y2 * (y2 - number(15.0)) + number(45.0)) - number(15.0);
    let (two, three) = (eps + eps, eps + eps + eps);
    let order = |factor: f32, [share, by_depth, by_bend]: [S; 3]| Added {
        share: number(factor) * share,
        by_depth: number(-factor) * by_depth,
        by_bend: number(factor) * by_bend,
    };
    [
        order(0.25, [he3 - two * he2, he4 - two * he3, number(-2.0) * he2]),
        order(-0.125, [he5 - three * he4, he6 - three * he5, number(-3.0) * he4]),
    ]
}

/// What a shape with these coefficients adds to the profile of an edge.
#[inline(always)]
pub(crate) fn of_edge<X: From<f32>, S: Several<X>>(shape: [S; 2], y: S, eps: S) -> Added<S> {
    let [fourth, sixth] = orders_of_edge(y, eps);
    let both = |a: S, b: S| shape[0] * a + shape[1] * b;
    Added {
        share: both(fourth.share, sixth.share),
        by_depth: both(fourth.by_depth, sixth.by_depth),
        by_bend: both(fourth.by_bend, sixth.by_bend),
    }
}
