//! Seeded random numbers: the same seed gives the same bits on every run and for every thread count.
//!
//! Every use draws from a stream of its own, named by a list of integers (what for, view, camera, image row), so
//! that a change in one part of a scene does not shift the noise of another.
//!
//! Sources: splitmix64 and xoshiro256++ (Blackman, Vigna 2018); Poisson by transformed rejection
//! (Hoermann 1993, algorithm PTRS); normal deviates by the polar method.

/// What a stream is for; the first number of its name.
#[derive(Debug, Clone, Copy)]
#[repr(u64)]
pub(super) enum Use {
    /// Poses, radii and spacings that the scene leaves to chance.
    Pose = 1,
    /// Printing errors of the dots.
    Print = 2,
    /// Smoke inside the bubbles.
    Smoke = 3,
    /// Glare spots.
    Glare = 4,
    /// Direction of uneven light.
    Light = 5,
    /// Photons and electronics.
    Sensor = 6,
    /// Places and brightness of particles.
    Particles = 7,
}

/// xoshiro256++ with the draws that a scene needs.
#[derive(Debug, Clone)]
pub(super) struct Stream {
    state: [u64; 4],
    spare_normal: Option<f64>,
}

fn splitmix(x: &mut u64) -> u64 {
    *x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *x;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Stream {
    /// The stream of `seed` with this name.
    pub(super) fn new(seed: u64, purpose: Use, name: &[usize]) -> Self {
        let mut x = seed;
        let mut mixed = splitmix(&mut x) ^ purpose as u64;
        for &n in name {
            mixed = splitmix(&mut mixed) ^ n as u64;
        }
        Self { state: std::array::from_fn(|_| splitmix(&mut mixed)), spare_normal: None }
    }

    fn next_u64(&mut self) -> u64 {
        let s = &mut self.state;
        let out = s[0].wrapping_add(s[3]).rotate_left(23).wrapping_add(s[0]);
        let t = s[1] << 17;
        s[2] ^= s[0];
        s[3] ^= s[1];
        s[1] ^= s[2];
        s[0] ^= s[3];
        s[2] ^= t;
        s[3] = s[3].rotate_left(45);
        out
    }

    /// Uniform in (0, 1): the middles of 2^52 equal cells, so that neither end can come.
    pub(super) fn uniform(&mut self) -> f64 {
        ((self.next_u64() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    /// Uniform between two ends.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform within +-`half`.
    pub(super) fn within(&mut self, half: f64) -> f64 {
        self.between(-half, half)
    }

    /// Normal deviate of mean 0 and variance 1.
    pub(super) fn normal(&mut self) -> f64 {
        if let Some(n) = self.spare_normal.take() {
            return n;
        }
        loop {
            let (x, y) = (self.within(1.0), self.within(1.0));
            let s = x * x + y * y;
            if s < 1.0 && s > 0.0 {
                let scale = (-2.0 * s.ln() / s).sqrt();
                self.spare_normal = Some(y * scale);
                return x * scale;
            }
        }
    }

    /// Poisson deviate of this mean (0 where the mean is not positive).
    pub(super) fn poisson(&mut self, mean: f64) -> f64 {
        if mean <= 0.0 {
            0.0
        } else if mean < 12.0 {
            self.poisson_by_products(mean)
        } else {
            self.poisson_by_rejection(mean)
        }
    }

    fn poisson_by_products(&mut self, mean: f64) -> f64 {
        let limit = (-mean).exp();
        let (mut count, mut product) = (0.0, self.uniform());
        while product > limit {
            count += 1.0;
            product *= self.uniform();
        }
        count
    }

    fn poisson_by_rejection(&mut self, mean: f64) -> f64 {
        let b = 0.931 + 2.53 * mean.sqrt();
        let a = -0.059 + 0.02483 * b;
        let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
        let v_r = 0.9277 - 3.6224 / (b - 2.0);
        loop {
            let u = self.uniform() - 0.5;
            let v = self.uniform();
            let us = 0.5 - u.abs();
            let k = ((2.0 * a / us + b) * u + mean + 0.43).floor();
            if us >= 0.07 && v <= v_r {
                return k;
            }
            if k < 0.0 || (us < 0.013 && v > us) {
                continue;
            }
            let accept = (v * inverse_alpha / (a / (us * us) + b)).ln();
            if accept <= k * mean.ln() - mean - ln_factorial(k) {
                return k;
            }
        }
    }
}

/// `ln k!` for a whole number k >= 0: by product below 10, else Stirling's series (error below 1e-10).
fn ln_factorial(k: f64) -> f64 {
    if k < 10.0 {
        return (1..=k as u64).map(|i| i as f64).product::<f64>().ln();
    }
    let n = k + 1.0;
    let i2 = 1.0 / (n * n);
    (n - 0.5) * n.ln() - n + 0.918_938_533_204_672_8 + (1.0 / 12.0 - i2 * (1.0 / 360.0 - i2 / 1260.0)) / n
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn xoshiro_gives_the_published_sequence() {
        // Reference implementation with the state 1, 2, 3, 4.
        let mut s = Stream { state: [1, 2, 3, 4], spare_normal: None };
        let got: Vec<u64> = (0..4).map(|_| s.next_u64()).collect();
        assert_eq!(got, [41_943_041, 58_720_359, 3_588_806_011_781_223, 3_591_011_842_654_386]);
    }

    #[test]
    fn streams_are_repeatable_and_apart() {
        let draw = |seed, name: &[usize]| Stream::new(seed, Use::Sensor, name).next_u64();
        assert_eq!(draw(7, &[1, 2]), draw(7, &[1, 2]));
        assert_ne!(draw(7, &[1, 2]), draw(7, &[2, 1]));
        assert_ne!(draw(7, &[1, 2]), draw(8, &[1, 2]));
        assert_ne!(draw(7, &[1]), draw(7, &[1, 0]));
    }

    #[test]
    fn poisson_has_equal_mean_and_variance_on_both_branches() {
        for mean in [0.3, 5.0, 11.9, 12.1, 60.0, 900.0, 20_000.0] {
            let mut s = Stream::new(3, Use::Sensor, &[]);
            let n = 40_000;
            let draws: Vec<f64> = (0..n).map(|_| s.poisson(mean)).collect();
            let m = draws.iter().sum::<f64>() / n as f64;
            let v = draws.iter().map(|d| (d - m) * (d - m)).sum::<f64>() / (n - 1) as f64;
            let z_mean = (m - mean) / (mean / n as f64).sqrt();
            // Variance of the sample variance of a Poisson deviate: (mean + 2 mean^2) / n.
            let z_var = (v - mean) / ((mean + 2.0 * mean * mean) / n as f64).sqrt();
            assert!(z_mean.abs() < 4.0 && z_var.abs() < 4.0, "{mean}: z {z_mean} {z_var}");
        }
    }

    #[test]
    fn normal_deviates_have_unit_variance_and_normal_tails() {
        let mut s = Stream::new(11, Use::Pose, &[]);
        let n = 100_000;
        let draws: Vec<f64> = (0..n).map(|_| s.normal()).collect();
        let m = draws.iter().sum::<f64>() / n as f64;
        let v = draws.iter().map(|d| d * d).sum::<f64>() / n as f64;
        let beyond_two = draws.iter().filter(|d| d.abs() > 2.0).count() as f64 / n as f64;
        assert!(m.abs() < 4.0 / (n as f64).sqrt());
        assert!((v - 1.0).abs() < 4.0 * (2.0 / n as f64).sqrt());
        assert!((beyond_two - 0.0455).abs() < 4.0 * (0.0455 / n as f64).sqrt());
    }
}
