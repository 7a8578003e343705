//! Renders blurred discs by brute force, independently of the library: fine grid, exact Gaussian, pixel areas, seeded noise.
#![allow(dead_code, missing_docs, unreachable_pub, clippy::unwrap_used)]

pub mod accuracy;

/// Samples per pixel and axis of the fine grid.
const FINE: usize = 8;

/// An ellipse to draw.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    pub u: f64,
    pub v: f64,
    pub a: f64,
    pub b: f64,
    pub phi: f64,
}

impl Spot {
    pub fn circle(u: f64, v: f64, r: f64) -> Self {
        Self { u, v, a: r, b: r, phi: 0.0 }
    }

    /// First-order signed distance, positive outside; exact to the precision needed within a fraction of a pixel.
    fn distance(&self, u: f64, v: f64) -> f64 {
        let (s, c) = self.phi.sin_cos();
        let (x, y) = (c * (u - self.u) + s * (v - self.v), c * (v - self.v) - s * (u - self.u));
        let q = (x / self.a).hypot(y / self.b);
        if q < 1e-9 {
            return -self.b;
        }
        (q - 1.0) * q / (x / (self.a * self.a)).hypot(y / (self.b * self.b))
    }

    /// Part of a cell of size `h` that is inside.
    pub fn cover(&self, u: f64, v: f64, h: f64) -> f64 {
        // With q the distance from the middle in semi-axes, the distance is beyond |q - 1| b: most cells need no more than a look.
        let r2 = (u - self.u).powi(2) + (v - self.v).powi(2);
        if r2 > (self.a * (1.0 + 0.5 * h / self.b)).powi(2) {
            return 0.0;
        }
        if r2 < (self.b - 0.5 * h).max(0.0).powi(2) {
            return 1.0;
        }
        self.cover_near_the_outline(u, v, h)
    }

    /// The same without the look.
    pub fn cover_near_the_outline(&self, u: f64, v: f64, h: f64) -> f64 {
        (0.5 - self.distance(u, v) / h).clamp(0.0, 1.0)
    }
}

/// A small generator (splitmix64) with normal numbers.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let (r, t) = ((-2.0 * (1.0 - self.uniform()).ln()).sqrt(), std::f64::consts::TAU * self.uniform());
        r * t.cos()
    }
}

/// Grey levels of a scene before noise, row by row.
pub struct Clean {
    pub width: usize,
    pub height: usize,
    pub grey: Vec<f64>,
}

/// Draws `scene(u, v, h)` = brightness of the cell of size `h` at (u, v), blurred by a Gaussian of `psf` px and by the pixel area.
pub fn draw(width: usize, height: usize, psf: f64, scene: impl Fn(f64, f64, f64) -> f64) -> Clean {
    let pad = (4.5 * psf).ceil() as usize + 1;
    let (fw, fh) = ((width + 2 * pad) * FINE, (height + 2 * pad) * FINE);
    let h = 1.0 / FINE as f64;
    let at = |i: usize| (i as f64 + 0.5) * h - 0.5 - pad as f64;
    let reach = (4.5 * psf * FINE as f64).ceil() as usize;
    // Blur and pixel box as one kernel on the fine grid, taken only at pixel centres.
    let half = reach + FINE / 2;
    let kernel: Vec<f64> = (0..2 * half)
        .map(|k| {
            let x = (k as f64 + 0.5 - half as f64) * h;
            let steps = 16;
            (0..steps)
                .map(|j| {
                    let t = x + ((j as f64 + 0.5) / steps as f64 - 0.5);
                    (-0.5 * (t / psf).powi(2)).exp()
                })
                .sum::<f64>()
        })
        .collect();
    let total: f64 = kernel.iter().sum();
    let mut rows = vec![0.0; width * fh];
    let mut line = vec![0.0; fw];
    for j in 0..fh {
        for (i, x) in line.iter_mut().enumerate() {
            *x = scene(at(i), at(j), h);
        }
        for u in 0..width {
            let start = (u + pad) * FINE + FINE / 2 - half;
            rows[j * width + u] =
                line[start..start + 2 * half].iter().zip(&kernel).map(|(a, b)| a * b).sum::<f64>() / total;
        }
    }
    let mut grey = vec![0.0; width * height];
    for v in 0..height {
        let start = (v + pad) * FINE + FINE / 2 - half;
        let out = &mut grey[v * width..(v + 1) * width];
        for (weight, row) in kernel.iter().zip(rows[start * width..].chunks_exact(width)) {
            out.iter_mut().zip(row).for_each(|(sum, x)| *sum += x * weight);
        }
        out.iter_mut().for_each(|sum| *sum /= total);
    }
    Clean { width, height, grey }
}

/// Standard deviation of the noise where the clean image has a grey level: the same everywhere, or a function of that.
pub trait Noise {
    fn sigma(&self, grey: f64) -> f64;
}

impl Noise for f64 {
    fn sigma(&self, _: f64) -> f64 {
        *self
    }
}

impl<F: Fn(f64) -> f64> Noise for F {
    fn sigma(&self, grey: f64) -> f64 {
        self(grey)
    }
}

impl Clean {
    /// With Gaussian noise, as floats.
    fn noisy(&self, noise: impl Noise, random: &mut Random) -> impl Iterator<Item = f64> {
        self.grey.iter().map(move |g| g + noise.sigma(*g) * random.normal())
    }

    /// The same, rounded to 8 bit.
    pub fn noisy_u8(&self, noise: impl Noise, random: &mut Random) -> Vec<u8> {
        self.noisy(noise, random).map(|g| g.round().clamp(0.0, 255.0) as u8).collect()
    }

    /// The same, rounded to 16 bit.
    pub fn noisy_u16(&self, noise: impl Noise, random: &mut Random) -> Vec<u16> {
        self.noisy(noise, random).map(|g| g.round().clamp(0.0, 65535.0) as u16).collect()
    }

    /// The same in single precision.
    pub fn noisy_f32(&self, noise: impl Noise, random: &mut Random) -> Vec<f32> {
        self.noisy(noise, random).map(|g| g as f32).collect()
    }
}
