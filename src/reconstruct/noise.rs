//! How large the errors of planar vectors are, from what four equations leave over the field.
//!
//! ```text
//! s^2 = s_0^2 + k^2 g,   g = mean over the cameras of sum over both axes |d(next vector) - d(vector before)|^2 / 4
//! ```
//! A window sees some N particles at random places; where the flow varies over the window by G, their mean is off by G / sqrt(12 N):
//! errors grow with the gradient. (s_0^2, k^2) are fitted to the squared residuals (one degree of freedom each), weighted by what
//! they are expected to be; residuals beyond three sigmas take no part, and what their lack takes off is given back:
//! ```text
//! E(t^2 | |t| < 3) = 1 - 6 phi(3) / (2 Phi(3) - 1) = 0.97334        t standard normal
//! ```
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | s | [`Noise::variance`] | unit of the fields, squared | error of one component of a planar vector |
//! | s_0^2 | `still` | unit^2 | the same where neighbours are alike |
//! | k^2 | `by_gradient` | 1 | |
//! | g | `unevenness` | unit^2 | squared change from vector to vector |
//!
//! Sources: Westerweel, Exp. Fluids 44 (2008) 831 (errors by gradients); Sciacchitano, Meas. Sci. Technol. 30 (2019) 092001. Not seen by
//! residuals, and so not in s: errors that both cameras share (`shared.rs` sees them where the files state standard deviations), and the mean
//! over a window instead of its middle.

/// Median of chi-square with one degree of freedom.
const MEDIAN_CHI2: f64 = 0.454_936;
/// Squared residuals beyond this multiple of their variance take no part.
const FAR: f64 = 9.0;
/// Mean of a chi-square with one degree of freedom that is below [`FAR`].
const MEAN_BELOW: f64 = 0.973_337;
/// Rounds of reweighting.
const ROUNDS: usize = 100;

/// Variance of planar vectors by the unevenness of the field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    pub(super) still: f64,
    pub(super) by_gradient: f64,
}

impl Noise {
    /// The same everywhere.
    pub(super) fn even(sigma: f64) -> Self {
        Self { still: sigma * sigma, by_gradient: 0.0 }
    }

    pub(super) fn variance(&self, unevenness: f64) -> f64 {
        self.still + self.by_gradient * unevenness
    }

    /// From squared residuals and the unevenness where they stand; `None` without residuals.
    pub(super) fn fit(squares: &[f64], unevenness: &[f64]) -> Option<Self> {
        let mut sorted = squares.to_vec();
        sorted.sort_by(f64::total_cmp);
        let middle = sorted.get(sorted.len() / 2)? / MEDIAN_CHI2;
        let mut noise = Self { still: middle, by_gradient: 0.0 };
        for _ in 0..ROUNDS {
            let before = noise;
            noise = before.again(squares, unevenness, 1e-4 * middle);
            let change = (noise.still - before.still).abs() / before.still
                + (noise.by_gradient - before.by_gradient).abs() / (before.by_gradient + 1e-12);
            if !(change > 1e-9) {
                break;
            }
        }
        Some(noise)
    }

    /// One weighted fit; what would be negative is held at zero.
    fn again(&self, squares: &[f64], unevenness: &[f64], least: f64) -> Self {
        let (mut n, mut b) = ([0.0; 3], [0.0; 2]);
        for (c, g) in squares.iter().zip(unevenness) {
            let expected = self.variance(*g);
            if *c > FAR * expected {
                continue;
            }
            let (w, c) = (1.0 / (expected * expected), c / MEAN_BELOW);
            n = [n[0] + w, n[1] + w * g, n[2] + w * g * g];
            b = [b[0] + w * c, b[1] + w * g * c];
        }
        let determinant = n[0] * n[2] - n[1] * n[1];
        if !(n[0] > 0.0) {
            return *self;
        }
        let even = Self { still: (b[0] / n[0]).max(least), by_gradient: 0.0 };
        if !(determinant > 1e-12 * n[0] * n[2]) {
            return even;
        }
        let by_gradient = (n[0] * b[1] - n[1] * b[0]) / determinant;
        if by_gradient <= 0.0 {
            return even;
        }
        let still = (n[2] * b[0] - n[1] * b[1]) / determinant;
        if still > least {
            return Self { still, by_gradient };
        }
        Self { still: least, by_gradient: ((b[1] - least * n[1]) / n[2]).max(0.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squares of normal numbers of known variance, some of them spoilt.
    fn sample(still: f64, by_gradient: f64, spoilt: usize) -> (Vec<f64>, Vec<f64>) {
        let mut x = 99_u64;
        let mut uniform = || {
            x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((x >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        };
        (0..4000)
            .map(|i| {
                let g = uniform().powi(4) * 30.0;
                let t = (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos();
                let scale = if i < spoilt { 1e4 } else { 1.0 };
                (scale * (still + by_gradient * g) * t * t, g)
            })
            .unzip()
    }

    #[test]
    fn the_variance_and_its_growth_are_found_among_outliers() {
        for (still, by_gradient, spoilt) in [(2.0, 0.5, 0), (2.0, 0.0, 0), (2.0, 0.5, 600), (0.3, 1.0, 200)] {
            let (squares, g) = sample(still, by_gradient, spoilt);
            let n = Noise::fit(&squares, &g).unwrap();
            // Each square has a relative variance of 2: 4000 of them give 2.2 %, two numbers together somewhat more.
            let tolerance = 0.12;
            assert!((n.still / still - 1.0).abs() < tolerance, "{n:?} of {still} {by_gradient}");
            assert!(
                (n.by_gradient - by_gradient).abs() < tolerance * (by_gradient + 0.2),
                "{n:?} of {still} {by_gradient}"
            );
        }
        assert_eq!(Noise::fit(&[], &[]), None);
        let even = Noise::fit(&[1.0; 50], &[0.0; 50]).unwrap();
        assert!(even.by_gradient == 0.0 && (even.still - 1.0 / MEAN_BELOW).abs() < 1e-9, "{even:?}");
        assert!(Noise::fit(&[0.0; 9], &[0.0; 9]).unwrap().still == 0.0);
    }
}
