//! Columns of waves in discs that are small against their blur: sums over places of the disc.
//!
//! As high as the image shows it far from the edge, a wave `exp(i k . x)` up to the edge is seen by the pixel `p` as
//!
//! ```text
//! exp(s^2 k^2 / 2) integral over the disc of exp(i k . x) G(x - p) dx^2,   x = (a sin t, b cos t y)
//! ```
//!
//! `G` the Gaussian of standard deviation `s`. Strips across the major axis lie at equal steps of `t`, over whose whole turn the integrand is smooth and periodic; along
//! each strip places and weights are those of Gauss and Legendre. Places less than a blur apart leave 1e-6. Places too far from eight pixels for
//! any of them to see are left out.
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | x | `Area::at` | n | px | places, in the frame of the axes |
//! | - | `Area::waves` | n x 2 m | 1 | weight of each place times cosine and sine of each wave there |

use super::products::CHUNK;
use super::waves::Each;
use crate::detect::band::LANES;
use crate::detect::rim::gaussian;
use crate::lanes::{self, Kernel, Lanes};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Distance of two places over the blur.
const SPACING: f64 = 0.8;
/// Distance beyond which a pixel sees nothing of a place, over the blur.
const FAR: f64 = 6.0;
/// Columns that are summed up together.
const TILE: usize = 8;

/// Places of one disc, with its waves; and what some pixels see of them.
#[derive(Debug, Default)]
pub(super) struct Area {
    at: [Vec<f64>; 2],
    waves: Vec<f64>,
    columns: usize,
    blur_px: f64,
    near: Vec<usize>,
    seen: Vec<Each>,
}

/// Places and weights in -1..1 that are exact for polynomials up to the degree `2 n - 1`: roots of Legendre's polynomial by Newton's method.
fn gauss_legendre(n: usize) -> impl Iterator<Item = (f64, f64)> {
    let degree = n as f64;
    (0..n).map(move |i| {
        let (mut x, mut slope) = ((PI * (i as f64 + 0.75) / (degree + 0.5)).cos(), 1.0);
        for _ in 0..6 {
            let (mut before, mut value) = (1.0, x);
            for k in 2..=n {
                let k = k as f64;
                (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
            }
            slope = degree * (x * value - before) / (x * x - 1.0);
            x -= value / slope;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    })
}

impl Area {
    /// Sets the places anew, for wave vectors in units of the semi-axes.
    pub(super) fn set(&mut self, [a, b]: [f64; 2], blur_px: f64, waves: &[[f64; 2]]) {
        let s2 = blur_px * blur_px;
        self.at.iter_mut().for_each(Vec::clear);
        self.waves.clear();
        (self.columns, self.blur_px) = (2 * waves.len(), blur_px);
        let height = |k: &[f64; 2]| (0.5 * s2 * ((k[0] / a).powi(2) + (k[1] / b).powi(2))).exp();
        let heights: Vec<f64> = waves.iter().map(height).collect();
        let strips = (PI * a / (SPACING * blur_px)).ceil().max(8.0);
        let along: Vec<(f64, f64)> = gauss_legendre((2.0 * b / (SPACING * blur_px)) as usize + 5).collect();
        for i in 0..strips as usize {
            let (x, half) = ((i as f64 + 0.5) * PI / strips - FRAC_PI_2).sin_cos();
            let width = a * b * half * half * PI / strips / (TAU * s2);
            for (y, weight) in &along {
                let y = half * y;
                self.at[0].push(a * x);
                self.at[1].push(b * y);
                self.waves.extend(waves.iter().zip(&heights).flat_map(|(k, height)| {
                    let (sin, cos) = (k[0] * x + k[1] * y).sin_cos();
                    [cos, sin].map(|wave| wave * weight * width * height)
                }));
            }
        }
    }

    /// Columns of the waves at `LANES` pixels, each times the `root` of its weight, from `columns[0]` on.
    pub(super) fn fill(&mut self, place: &[Each; 2], root: &Each, columns: &mut [f64]) {
        let far = FAR * self.blur_px;
        let [x, y] = [0, 1].map(|i| {
            let (least, most) = place[i].iter().fold((f64::MAX, f64::MIN), |(l, m), p| (l.min(*p), m.max(*p)));
            least - far..most + far
        });
        self.near.clear();
        self.near.extend((0..self.at[0].len()).filter(|n| x.contains(&self.at[0][*n]) && y.contains(&self.at[1][*n])));
        let mut seen = std::mem::take(&mut self.seen);
        seen.resize(self.near.len(), [0.0; LANES]);
        lanes::run(Fill { area: self, seen: &mut seen, place, root, columns });
        self.seen = seen;
    }
}

/// [`Area::fill`] as wide as the processor is.
struct Fill<'a> {
    area: &'a Area,
    seen: &'a mut [Each],
    place: &'a [Each; 2],
    root: &'a Each,
    columns: &'a mut [f64],
}

impl Kernel for Fill<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        for at in (0..LANES).step_by(L::N) {
            self.look::<L>(at);
            let whole = self.area.columns / TILE * TILE;
            (0..whole).step_by(TILE).for_each(|j| self.sum_up::<L, TILE>(at, j));
            (whole..self.area.columns).for_each(|j| self.sum_up::<L, 1>(at, j));
        }
    }
}

impl Fill<'_> {
    /// What the pixels see of each place, times the root of their weight.
    #[inline(always)]
    fn look<L: Lanes>(&mut self, at: usize) {
        let [x, y] = [0, 1].map(|i| L::load(&self.place[i][at..]));
        let (root, s) = (L::load(&self.root[at..]), self.area.blur_px);
        let by_two_s2 = L::splat(0.5 / (s * s));
        for (n, seen) in self.area.near.iter().zip(self.seen.iter_mut()) {
            let (dx, dy) = (L::splat(self.area.at[0][*n]) - x, L::splat(self.area.at[1][*n]) - y);
            (root * gaussian((dx * dx + dy * dy) * by_two_s2)).store(&mut seen[at..]);
        }
    }

    /// `K` columns from column `j` on.
    #[inline(always)]
    fn sum_up<L: Lanes, const K: usize>(&mut self, at: usize, j: usize) {
        let mut sums = [L::splat(0.0); K];
        for (n, seen) in self.area.near.iter().zip(self.seen.iter()) {
            let seen = L::load(&seen[at..]);
            let waves = &self.area.waves[n * self.area.columns + j..][..K];
            for k in 0..K {
                sums[k] = seen.fused(L::splat(waves[k]), sums[k]);
            }
        }
        for k in 0..K {
            sums[k].store(&mut self.columns[(j + k) * CHUNK + at..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLUR: f64 = 1.5;
    /// Semi-axes, px: a disc, and a flat one of which some pixels see some places only.
    const DISCS: [[f64; 2]; 2] = [[4.8, 4.0], [24.0, 3.0]];
    /// Up to a phase of 1.57 over one blur.
    const PHASES: [[f64; 2]; 4] = [[0.0, 0.0], [0.3, 0.2], [-0.9, 0.7], [1.1, 1.1]];

    /// Integrals over many thin strips cut into cells, cosine and sine.
    fn by_cells([a, b]: [f64; 2], [kx, ky]: [f64; 2], p: [f64; 2]) -> [f64; 2] {
        const STEP: f64 = 0.03;
        const STRIPS: u32 = 400;
        let reach = (6.5 * BLUR / STEP) as i32;
        let mut sum = [0.0; 2];
        for j in 0..STRIPS {
            // Strips of equal steps of the angle: the ends of the disc need no finer ones.
            let (y, half) = ((f64::from(j) + 0.5) * PI / f64::from(STRIPS) - FRAC_PI_2).sin_cos();
            let (y, half, width) = (b * y, a * half, b * half * PI / f64::from(STRIPS));
            for i in -reach..=reach {
                let x = p[0] + f64::from(i) * STEP;
                // Part of the cell that is inside.
                let part = ((half - x.abs()) / STEP + 0.5).clamp(0.0, 1.0);
                if part > 0.0 {
                    let h = ((x - p[0]).powi(2) + (y - p[1]).powi(2)) / (2.0 * BLUR * BLUR);
                    let (sin, cos) = ((kx * x + ky * y) / BLUR).sin_cos();
                    let weight = part * (-h).exp() * STEP * width / (TAU * BLUR * BLUR);
                    sum = [sum[0] + weight * cos, sum[1] + weight * sin];
                }
            }
        }
        sum.map(|x| x * (0.5 * (kx * kx + ky * ky)).exp())
    }

    #[derive(Clone)]
    struct Made<'a>(&'a Area, [Each; 2]);
    impl Kernel for Made<'_> {
        type Output = Vec<u64>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<u64> {
            let (mut seen, mut columns) = (vec![[0.0; LANES]; self.0.near.len()], vec![0.0; self.0.columns * CHUNK]);
            let (root, place) = ([1.0; LANES], &self.1);
            Fill { area: self.0, seen: &mut seen, place, root: &root, columns: &mut columns }.run::<L>();
            columns.into_iter().map(f64::to_bits).collect()
        }
    }

    #[test]
    fn sums_over_places_are_those_of_many_cells_and_all_widths_agree() {
        for [a, b] in DISCS {
            let mut area = Area::default();
            let waves = PHASES.map(|[x, y]| [x * a / BLUR, y * b / BLUR]);
            area.set([a, b], BLUR, &waves);
            let place = [0, 1].map(|i| std::array::from_fn(|l| [0.2 * a + 0.8 * l as f64, 0.9 * l as f64 - 3.0][i]));
            let mut columns = vec![0.0; area.columns * CHUNK];
            area.fill(&place, &[2.0; LANES], &mut columns);
            println!("{} of {} places", area.near.len(), area.at[0].len());
            for (w, l) in (0..PHASES.len()).flat_map(|w| (0..LANES).map(move |l| (w, l))) {
                let expected = by_cells([a, b], PHASES[w], [place[0][l], place[1][l]]);
                for i in 0..2 {
                    let found = 0.5 * columns[(2 * w + i) * CHUNK + l];
                    assert!((found - expected[i]).abs() < 1e-4, "{a} {b}, wave {w}: {found} and {}", expected[i]);
                }
            }
            let all = lanes::run_all(&Made(&area, place));
            all.iter().for_each(|one| assert_eq!(*one, all[0]));
        }
    }

    #[test]
    fn places_and_weights_integrate_polynomials() {
        for (n, degree) in [(5, 8), (12, 22), (40, 60)] {
            let sum: f64 = gauss_legendre(n).map(|(x, weight)| weight * x.powi(degree)).sum();
            assert!((sum - 2.0 / f64::from(degree + 1)).abs() < 1e-13, "{n}: {sum}");
        }
    }
}
