//! Columns of waves in discs that are small against their blur: sums over places of the disc.
//!
//! As high as the image shows it far from the edge, a wave `exp(i k . x)` up to the edge is seen by the pixel `p` as
//!
//! ```text
//! exp(s^2 k^2 / 2) integral over the disc of exp(i k . x) G(x - p) dx^2,   x = (a sin t, b cos t y)
//! ```
//!
//! `G` the Gaussian of standard deviation `s`. Strips across the major axis lie at equal steps of `t`, over whose whole turn the integrand is smooth and periodic; along
//! each strip places and weights are those of Gauss and Legendre. Places less than a blur apart leave 1e-6, of the shortest waves 1e-5. Places too far from eight pixels for
//! any of them to see are left out.
//!
//! The waves lie on a lattice, and a wave is the product of one along either axis: the places of a strip are summed up once for all waves of
//! one step along the minor axis (`C`, `S`: times its cosine, its sine), the strips once for the two waves that differ in the sign of that step,
//!
//! ```text
//! cos: sum cos_x C -+ sum sin_x S,   sin: sum sin_x C +- sum cos_x S
//! ```
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | x | `Area::at` | n | px | places, in the frame of the axes, strip by strip |
//! | cos_x, sin_x | `Area::across` | steps x strips | 1 | weight of a strip times cosine and sine of its place along the major axis |
//! | - | `Area::up` | steps x n | 1 | weight of a place times cosine and sine of its place along the strip |
//! | C, S | `Area::sums` | strips | 1 | what the pixels see of each strip |

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

/// Waves of a lattice: the step along either axis, in units of one over the semi-axis, and how many of them each wave has.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lattice<'a> {
    pub(super) spacing: [f64; 2],
    pub(super) steps: &'a [[i32; 2]],
}

/// The waves of so many steps along the major axis and `up` along the minor one, either way: their places in the list.
#[derive(Debug, Clone, Copy)]
struct Pair {
    up: usize,
    across: usize,
    waves: [Option<usize>; 2],
}

/// Places of one disc, with its waves; and what some pixels see of them.
#[derive(Debug, Default)]
pub(super) struct Area {
    at: [Vec<f64>; 2],
    /// Places of a strip, and how many strips there are.
    along: usize,
    strips: usize,
    across: Vec<[f64; 2]>,
    up: Vec<[f64; 2]>,
    pairs: Vec<Pair>,
    blur_px: f64,
    near: Near,
    seen: Vec<Each>,
    sums: Vec<[Each; 2]>,
}

/// Places that some pixels see: the first strip, and of it and all that follow where their places end in the list.
#[derive(Debug, Default)]
struct Near {
    first: usize,
    ends: Vec<usize>,
    places: Vec<usize>,
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
    /// Sets the places anew, for waves of a lattice.
    pub(super) fn set(&mut self, [a, b]: [f64; 2], blur_px: f64, lattice: Lattice) {
        self.blur_px = blur_px;
        let along: Vec<(f64, f64)> = gauss_legendre((2.0 * b / (SPACING * blur_px)) as usize + 5).collect();
        self.along = along.len();
        self.strips = (PI * a / (SPACING * blur_px)).ceil().max(8.0) as usize;
        self.pair(lattice.steps);
        let most = |of: &dyn Fn(&Pair) -> usize| self.pairs.iter().map(of).max().unwrap_or(0);
        let (most_across, most_up) = (most(&|p| p.across), most(&|p| p.up));
        let strip = |i: usize| ((i as f64 + 0.5) * PI / self.strips as f64 - FRAC_PI_2).sin_cos();
        self.at.iter_mut().for_each(Vec::clear);
        self.across.clear();
        self.up.clear();
        let mut waves = vec![];
        for (x, half) in (0..self.strips).map(strip) {
            let width = a * b * half * half * PI / self.strips as f64 / (TAU * blur_px * blur_px);
            waves.push((lattice.spacing[0] * x, width));
            self.at[0].extend(along.iter().map(|_| a * x));
            self.at[1].extend(along.iter().map(|(y, _)| b * half * y));
        }
        turned(&waves, most_across, lattice.spacing[0] * blur_px / a, &mut self.across);
        waves.clear();
        let weights = along.iter().cycle().map(|(_, weight)| *weight);
        waves.extend(self.at[1].iter().map(|y| lattice.spacing[1] * y / b).zip(weights));
        turned(&waves, most_up, lattice.spacing[1] * blur_px / b, &mut self.up);
    }

    /// Puts waves that differ in the sign of their step along the minor axis side by side, those of one step one after the other.
    fn pair(&mut self, steps: &[[i32; 2]]) {
        let mut waves: Vec<(usize, usize, bool, usize)> = steps
            .iter()
            .enumerate()
            .map(|(k, [i, j])| (j.unsigned_abs() as usize, i.unsigned_abs() as usize, *j < 0, k))
            .collect();
        waves.sort_unstable();
        self.pairs.clear();
        for (up, across, down, k) in waves {
            match self.pairs.last_mut().filter(|p| (p.up, p.across) == (up, across)) {
                Some(pair) => pair.waves[usize::from(down)] = Some(k),
                None => {
                    let waves = if down { [None, Some(k)] } else { [Some(k), None] };
                    self.pairs.push(Pair { up, across, waves });
                }
            }
        }
    }

    /// Columns of the waves at `LANES` pixels, each times the `root` of its weight, from `columns[0]` on.
    pub(super) fn fill(&mut self, place: &[Each; 2], root: &Each, columns: &mut [f64]) {
        self.look_near(place);
        let (mut seen, mut sums) = (std::mem::take(&mut self.seen), std::mem::take(&mut self.sums));
        seen.resize(self.near.places.len(), [0.0; LANES]);
        sums.resize(self.near.ends.len(), [[0.0; LANES]; 2]);
        lanes::run(Fill { area: self, seen: &mut seen, sums: &mut sums, place, root, columns });
        (self.seen, self.sums) = (seen, sums);
    }

    /// The places that any of the pixels sees. Strips lie in the order of their place, so that those seen follow one another.
    fn look_near(&mut self, place: &[Each; 2]) {
        let far = FAR * self.blur_px;
        let [x, y] = [0, 1].map(|i| {
            let (least, most) = place[i].iter().fold((f64::MAX, f64::MIN), |(l, m), p| (l.min(*p), m.max(*p)));
            least - far..most + far
        });
        let (at, along) = (&self.at, self.along);
        let is_near = |strip: &usize| x.contains(&at[0][strip * along]);
        let near = &mut self.near;
        near.first = (0..self.strips).find(is_near).unwrap_or(self.strips);
        near.places.clear();
        near.ends.clear();
        for strip in (near.first..self.strips).take_while(is_near) {
            near.places.extend((strip * along..(strip + 1) * along).filter(|n| y.contains(&at[1][*n])));
            near.ends.push(near.places.len());
        }
    }
}

/// Appends weight times cosine and sine of 0 to `most` times each phase, higher by what a blur of `spread` times the step takes.
fn turned(waves: &[(f64, f64)], most: usize, spread: f64, out: &mut Vec<[f64; 2]>) {
    let turns: Vec<(f64, f64)> = waves.iter().map(|(phase, _)| phase.sin_cos()).collect();
    let mut now: Vec<[f64; 2]> = waves.iter().map(|(_, weight)| [*weight, 0.0]).collect();
    for step in 0..=most {
        let height = (0.5 * (step as f64 * spread).powi(2)).exp();
        out.extend(now.iter().map(|w| w.map(|x| x * height)));
        for ([cos, sin], (s, c)) in now.iter_mut().zip(&turns) {
            (*cos, *sin) = (*cos * c - *sin * s, *sin * c + *cos * s);
        }
    }
}

/// [`Area::fill`] as wide as the processor is.
struct Fill<'a> {
    area: &'a Area,
    seen: &'a mut [Each],
    sums: &'a mut [[Each; 2]],
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
            for pairs in self.area.pairs.chunk_by(|a, b| a.up == b.up) {
                self.sum_up_strips::<L>(at, pairs[0].up);
                for two in pairs.chunks(2) {
                    match two.len() {
                        2 => self.sum_up::<L, 2>(at, two),
                        _ => self.sum_up::<L, 1>(at, two),
                    }
                }
            }
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
        for (n, seen) in self.area.near.places.iter().zip(self.seen.iter_mut()) {
            let (dx, dy) = (L::splat(self.area.at[0][*n]) - x, L::splat(self.area.at[1][*n]) - y);
            (root * gaussian((dx * dx + dy * dy) * by_two_s2)).store(&mut seen[at..]);
        }
    }

    /// What they see of each strip, times the waves of `up` steps along it.
    #[inline(always)]
    fn sum_up_strips<L: Lanes>(&mut self, at: usize, up: usize) {
        let near = &self.area.near;
        let waves = &self.area.up[up * self.area.at[0].len()..];
        let mut from = 0;
        for (end, out) in near.ends.iter().zip(self.sums.iter_mut()) {
            let mut sums = [L::splat(0.0); 2];
            for (n, seen) in near.places[from..*end].iter().zip(&self.seen[from..*end]) {
                let seen = L::load(&seen[at..]);
                for i in 0..2 {
                    sums[i] = seen.fused(L::splat(waves[*n][i]), sums[i]);
                }
            }
            for i in 0..2 {
                sums[i].store(&mut out[i][at..]);
            }
            from = *end;
        }
    }

    /// The columns of `K` pairs of one step along the minor axis.
    #[inline(always)]
    fn sum_up<L: Lanes, const K: usize>(&mut self, at: usize, pairs: &[Pair]) {
        let (first, strips) = (self.area.near.first, self.area.strips);
        let waves: [&[[f64; 2]]; K] = std::array::from_fn(|k| &self.area.across[pairs[k].across * strips + first..]);
        // Of each pair: cos C, sin S, sin C, cos S.
        let mut sums = [[L::splat(0.0); 4]; K];
        for (n, strip) in self.sums.iter().enumerate() {
            let (c, s) = (L::load(&strip[0][at..]), L::load(&strip[1][at..]));
            for k in 0..K {
                let (cos, sin) = (L::splat(waves[k][n][0]), L::splat(waves[k][n][1]));
                let [cc, ss, sc, cs] = sums[k];
                sums[k] = [c.fused(cos, cc), s.fused(sin, ss), c.fused(sin, sc), s.fused(cos, cs)];
            }
        }
        for (pair, [cc, ss, sc, cs]) in pairs.iter().zip(sums) {
            for (wave, column) in pair.waves.iter().zip([[cc - ss, sc + cs], [cc + ss, sc - cs]]) {
                let Some(wave) = wave else { continue };
                for i in 0..2 {
                    column[i].store(&mut self.columns[(2 * wave + i) * CHUNK + at..]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLUR: f64 = 1.5;
    /// Semi-axes, px: a disc, and a flat one of which some pixels see some places only.
    const DISCS: [[f64; 2]; 2] = [[4.8, 4.0], [24.0, 3.0]];
    /// Steps of a lattice, a phase of 0.1 over one blur each, up to 2.5; one beside that which goes the other way, as a lattice has it, and some alone.
    const STEPS: [[i32; 2]; 6] = [[0, 0], [9, -7], [3, 2], [11, 11], [3, -2], [18, -17]];

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
            let mut columns = vec![0.0; 2 * STEPS.len() * CHUNK];
            let mut seen = vec![[0.0; LANES]; self.0.near.places.len()];
            let mut sums = vec![[[0.0; LANES]; 2]; self.0.near.ends.len()];
            let (root, place) = ([1.0; LANES], &self.1);
            Fill { area: self.0, seen: &mut seen, sums: &mut sums, place, root: &root, columns: &mut columns }
                .run::<L>();
            columns.into_iter().map(f64::to_bits).collect()
        }
    }

    #[test]
    fn sums_over_places_are_those_of_many_cells_and_all_widths_agree() {
        for [a, b] in DISCS {
            let mut area = Area::default();
            area.set([a, b], BLUR, Lattice { spacing: [0.1 * a / BLUR, 0.1 * b / BLUR], steps: &STEPS });
            let place = [0, 1].map(|i| std::array::from_fn(|l| [0.2 * a + 0.8 * l as f64, 0.9 * l as f64 - 3.0][i]));
            let mut columns = vec![0.0; 2 * STEPS.len() * CHUNK];
            area.fill(&place, &[2.0; LANES], &mut columns);
            println!("{} of {} places", area.near.places.len(), area.at[0].len());
            for (w, l) in (0..STEPS.len()).flat_map(|w| (0..LANES).map(move |l| (w, l))) {
                let expected = by_cells([a, b], STEPS[w].map(|n| 0.1 * f64::from(n)), [place[0][l], place[1][l]]);
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
