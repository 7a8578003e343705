//! Columns of waves that reach up to a blurred edge, several pixels at a time.
//!
//! A wave `exp(i k . x)` up to the edge of a disc, as the image shows it far from the edge (blur included), sees the profile `P` of the edge at a complex place:
//! completing the square,
//!
//! ```text
//! (exp(i k . x) 1_disc) * G = F(p) P(p + i s^2 k),   distance of the complex place = d + s w,
//! w = i q - t^2 / (2 (R/s + d/s + i q)),   q = s k . n,   t = s |k x n|,   P(d + s w) = P + phi sum_n (-w)^n / n! He_(n-1)(z)
//! ```
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | k | `k` | 1 | wave vector in units of the semi-axes |
//! | n | `normal` | 1 | outward normal at the foot point, over the semi-axes, times the blur |
//! | z | `At::depth` | 1 | distance in units of the blur |
//! | R | 1 / `At::curvature` | px | radius of curvature |
//!
//! Not valid for waves shorter than four blurs.

use super::field::Field;
use super::products::CHUNK;
use crate::detect::band::LANES;
use crate::detect::surface::At;
use crate::lanes::{self, Kernel};

/// Below this density of the edge a pixel sees one side only.
const UNFELT: f64 = 1e-9;
/// Terms of the series in the shift of the complex distance.
const TERMS: usize = 7;

/// One number for each of several pixels.
pub(super) type Each = [f64; LANES];

/// Heights of the waves, cosine and sine wave by wave.
#[derive(Clone, Copy)]
pub(super) enum Heights<'a> {
    /// Of the light; empty while it is not known.
    Common(&'a [f64]),
    /// Others for each pixel.
    Each(&'a [Each]),
}

impl Heights<'_> {
    #[inline(always)]
    fn of(self, wave: usize) -> [Each; 2] {
        match self {
            Self::Common([]) => [[0.0; LANES]; 2],
            Self::Common(light) => [[light[2 * wave]; LANES], [light[2 * wave + 1]; LANES]],
            Self::Each(light) => [light[2 * wave], light[2 * wave + 1]],
        }
    }
}

/// Fills the columns of the waves of `LANES` pixels, each times the `root` of its weight, cosine and sine wave by wave, from `columns[0]` on;
/// returns the derivative of the light by the distance that these heights mean (1/px; none where they are not known).
pub(super) struct Waves<'a> {
    pub(super) field: &'a Field,
    pub(super) pixels: &'a [At; LANES],
    pub(super) root: &'a Each,
    pub(super) heights: Heights<'a>,
    pub(super) columns: &'a mut [f64],
    pub(super) turns: &'a mut Turns,
}

/// `cos` and `sin` of whole multiples of the phases of one step of the lattice, along both axes; reused.
#[derive(Debug, Default)]
pub(super) struct Turns([Vec<[Each; 2]>; 2]);

impl Turns {
    /// Up to `most` steps of the lattice, by turning on and on.
    #[inline(always)]
    fn set(&mut self, pixels: &[At; LANES], spacing: [f64; 2], most: [usize; 2]) {
        for axis in 0..2 {
            let list = &mut self.0[axis];
            let (mut c, mut s) = ([0.0; LANES], [0.0; LANES]);
            for l in 0..LANES {
                (s[l], c[l]) = (spacing[axis] * pixels[l].place[axis]).sin_cos();
            }
            list.clear();
            let (mut cos, mut sin) = ([1.0; LANES], [0.0; LANES]);
            for _ in 0..=most[axis] {
                list.push([cos, sin]);
                for l in 0..LANES {
                    (cos[l], sin[l]) = (cos[l] * c[l] - sin[l] * s[l], sin[l] * c[l] + cos[l] * s[l]);
                }
            }
        }
    }
}

/// What the pixels share between waves.
struct Edge {
    inside: Each,
    slope: Each,
    /// Normal and tangent over the semi-axes, times the blur.
    normal: [Each; 2],
    tangent: [Each; 2],
    /// Radius of curvature over blur, seen from the pixel.
    radius: Each,
    narrow: Each,
    /// Density of the edge, zero where it is not felt, and over the width of the profile (1/px).
    density: Each,
    by_distance: Each,
    /// Hermite's polynomials of the depth.
    hermite: [Each; TERMS + 1],
    felt: bool,
}

impl Edge {
    #[inline(always)]
    fn new(pixels: &[At; LANES]) -> Self {
        let none = [0.0; LANES];
        let mut e = Self {
            inside: none,
            slope: none,
            normal: [none; 2],
            tangent: [none; 2],
            radius: none,
            narrow: none,
            density: none,
            by_distance: none,
            hermite: [none; TERMS + 1],
            felt: false,
        };
        for l in 0..LANES {
            let p = &pixels[l];
            let felt = p.density > UNFELT;
            e.felt |= felt;
            e.inside[l] = p.inside;
            e.slope[l] = if felt { p.slope } else { 0.0 };
            for i in 0..2 {
                e.normal[i][l] = p.blur_px * p.normal[i];
                e.tangent[i][l] = p.blur_px * p.tangent[i];
            }
            e.radius[l] = 1.0 / (p.curvature * p.blur_px) + p.distance / p.blur_px;
            e.narrow[l] = p.narrow;
            e.density[l] = if felt { p.density } else { 0.0 };
            e.by_distance[l] = e.density[l] * p.narrow / p.blur_px;
            let (z, z2) = (p.depth, p.depth * p.depth);
            let hermite = [
                1.0,
                z,
                z2 - 1.0,
                z * (z2 - 3.0),
                z2 * (z2 - 6.0) + 3.0,
                z * (z2 * (z2 - 10.0) + 15.0),
                z2 * (z2 * (z2 - 15.0) + 45.0) - 15.0,
                z * (z2 * (z2 * (z2 - 21.0) + 105.0) - 105.0),
            ];
            for n in 0..=TERMS {
                e.hermite[n][l] = hermite[n];
            }
        }
        e
    }

    /// Real and imaginary part of what a wave of height one is multiplied with at the edge, and their derivatives by the distance.
    #[inline(always)]
    fn seen(&self, k: [f64; 2]) -> [Each; 4] {
        let none = [0.0; LANES];
        let (mut re, mut im) = (none, none);
        for l in 0..LANES {
            let q = k[0] * self.normal[0][l] + k[1] * self.normal[1][l];
            let t = k[0] * self.tangent[0][l] + k[1] * self.tangent[1][l];
            let radius = self.radius[l];
            // t^2 / (2 (radius + i q)) is how much the complex distance falls short.
            let short = 0.5 * t * t / (radius * radius + q * q).max(1.0);
            re[l] = self.narrow[l] * (-short * radius);
            im[l] = self.narrow[l] * (q + short * q);
        }
        // Minus the shift to the power n over n!, times He_(n-1) for the profile and He_n for its derivative.
        let (mut pr, mut pi) = ([1.0; LANES], none);
        let (mut sr, mut si, mut dr, mut di) = (none, none, none, none);
        for n in 1..=TERMS {
            let inverse = -1.0 / n as f64;
            for l in 0..LANES {
                (pr[l], pi[l]) = (inverse * (pr[l] * re[l] - pi[l] * im[l]), inverse * (pr[l] * im[l] + pi[l] * re[l]));
                sr[l] += pr[l] * self.hermite[n - 1][l];
                si[l] += pi[l] * self.hermite[n - 1][l];
                dr[l] += pr[l] * self.hermite[n][l];
                di[l] += pi[l] * self.hermite[n][l];
            }
        }
        for l in 0..LANES {
            sr[l] = self.inside[l] + self.density[l] * sr[l];
            si[l] *= -self.density[l];
            dr[l] = self.slope[l] - self.by_distance[l] * dr[l];
            di[l] *= self.by_distance[l];
        }
        [sr, si, dr, di]
    }
}

impl Kernel for Waves<'_> {
    type Output = Each;
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) -> Each {
        let field = self.field;
        self.turns.set(self.pixels, field.spacing, field.most);
        let edge = Edge::new(self.pixels);
        let none = [0.0; LANES];
        let mut response = none;
        for (w, k) in field.waves.iter().enumerate() {
            let [a, b, da, db] = if edge.felt { edge.seen(*k) } else { [edge.inside, none, none, none] };
            let [i, j] = field.steps[w];
            let ([ci, si], [cj, sj]) = (&self.turns.0[0][i as usize], &self.turns.0[1][j.unsigned_abs() as usize]);
            let sign = if j < 0 { -1.0 } else { 1.0 };
            let (x, y) = self.columns[2 * w * CHUNK..].split_at_mut(CHUNK);
            let heights = self.heights.of(w);
            for l in 0..LANES {
                let turn = sign * sj[l];
                let (cos, sin) = (ci[l] * cj[l] - si[l] * turn, si[l] * cj[l] + ci[l] * turn);
                x[l] = self.root[l] * (cos * a[l] + sin * b[l]);
                y[l] = self.root[l] * (sin * a[l] - cos * b[l]);
                response[l] +=
                    heights[0][l] * (cos * da[l] + sin * db[l]) + heights[1][l] * (sin * da[l] - cos * db[l]);
            }
        }
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conic::{Ellipse, Frame};
    use crate::detect::profile::Profile;
    use crate::frames::Pixel;
    use std::f64::consts::{PI, TAU};

    /// A disc: semi-axes and blur, px.
    #[derive(Clone, Copy)]
    struct Blurred(f64, f64, f64);
    const LARGE: Blurred = Blurred(22.0, 15.0, 0.9);

    fn ellipse(Blurred(a, b, _): Blurred) -> Ellipse {
        Ellipse { center_px: Pixel::new(0.0, 0.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.0 }
    }

    /// A pixel whose foot point has the eccentric angle `t`, at the distance `d` (px) outside.
    fn pixel(disc: Blurred, t: f64, d: f64) -> At {
        let (e, Blurred(a, b, blur_px)) = (ellipse(disc), disc);
        let (s, c) = t.sin_cos();
        let foot = Frame::new(&e).on_contour(c, s);
        let seen = Profile { blur_px, shape: crate::detect::shape::Shape::GAUSSIAN, a, b }.at(&[d], &[c], &[s]);
        let normal = foot.climb;
        let tangent = [-normal[1] * b / a, normal[0] * a / b];
        let curvature = a * b / (a * a * s * s + b * b * c * c).powf(1.5);
        let (across, along) = (-seen.slope[0] * seen.depth[0] / blur_px, curvature * seen.slope[0]);
        let bend = |i: usize, j: usize| across * normal[i] * normal[j] + along * tangent[i] * tangent[j];
        At {
            place: [c + normal[0] * d, s + normal[1] * d],
            normal,
            tangent,
            blur_px,
            curvature,
            inside: seen.inside[0],
            gradient: normal.map(|n| n * seen.slope[0]),
            bend: [bend(0, 0), bend(0, 1), bend(1, 1)],
            slope: seen.slope[0],
            depth: seen.depth[0],
            density: seen.density[0],
            distance: d,
            narrow: seen.narrow[0],
        }
    }

    /// Cosine and sine wave in the disc, blurred, at a pixel, as high as they are seen far from the edge: the integral over a fine grid.
    fn by_grid(Blurred(a, b, blur): Blurred, k: [f64; 2], place: [f64; 2]) -> [f64; 2] {
        const STEP: f64 = 0.03;
        let reach = (6.0 * blur / STEP) as i32;
        let mut sum = [0.0; 2];
        for (i, j) in (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (i, j))) {
            let (dx, dy) = (f64::from(i) * STEP, f64::from(j) * STEP);
            let (x, y) = (place[0] + dx / a, place[1] + dy / b);
            if x * x + y * y < 1.0 {
                let weight = STEP * STEP / (TAU * blur * blur) * (-0.5 * (dx * dx + dy * dy) / (blur * blur)).exp();
                let (sin, cos) = (k[0] * x + k[1] * y).sin_cos();
                sum[0] += weight * cos;
                sum[1] += weight * sin;
            }
        }
        let faded = -0.5 * blur * blur * ((k[0] / a).powi(2) + (k[1] / b).powi(2));
        sum.map(|x| x / faded.exp())
    }

    fn field() -> Field {
        let spacing = [1.1, 0.9];
        let steps = vec![[0, 1], [1, 1], [2, -3], [4, 0], [3, 5]];
        let waves = steps.iter().map(|[i, j]| [f64::from(*i) * spacing[0], f64::from(*j) * spacing[1]]).collect();
        let mut field = Field::default();
        (field.waves, field.steps, field.spacing, field.most) = (waves, steps, spacing, [4, 5]);
        field
    }

    /// Columns and response of eight pixels in every width.
    #[derive(Clone)]
    struct Made([At; LANES], Vec<f64>);
    impl Kernel for Made {
        type Output = (Vec<f64>, Each);
        #[inline(always)]
        fn run<L: lanes::Lanes>(self) -> Self::Output {
            let field = field();
            let mut columns = vec![0.0; 2 * field.waves.len() * CHUNK];
            let (mut turns, root) = (Turns::default(), [1.0; LANES]);
            let (pixels, heights, columns_of) = (&self.0, Heights::Common(&self.1), &mut columns[..]);
            let waves = Waves { field: &field, pixels, root: &root, heights, columns: columns_of, turns: &mut turns };
            let response = waves.run::<L>();
            (columns, response)
        }
    }

    #[test]
    fn waves_up_to_an_edge_are_blurred_as_a_fine_grid_says() {
        let distances = [-6.0, -2.0, -1.1, -0.4, 0.0, 0.5, 1.3, 2.4];
        let at = |moved: f64| -> [At; LANES] {
            std::array::from_fn(|l| pixel(LARGE, 0.3 + l as f64 * PI / 4.3, distances[l] + moved))
        };
        let pixels = at(0.0);
        let light: Vec<f64> = (0..2 * field().waves.len()).map(|i| (i as f64 * 1.3).cos()).collect();
        let all = lanes::run_all(&Made(pixels, light.clone()));
        all.iter().for_each(|one| assert_eq!(*one, all[0]));
        let (columns, response) = &all[0];
        for (w, k) in field().waves.iter().enumerate() {
            for l in 0..LANES {
                let expected = by_grid(LARGE, *k, pixels[l].place);
                let found = [columns[2 * w * CHUNK + l], columns[(2 * w + 1) * CHUNK + l]];
                let off = (found[0] - expected[0]).abs().max((found[1] - expected[1]).abs());
                assert!(off < 1.5e-3, "wave {k:?}, {} px off the edge: {found:?} and {expected:?}", distances[l]);
            }
        }
        // The light held while the edge moves inwards by as much as the pixel moves outwards: its own gradient along the normal taken off.
        const H: f64 = 1e-4;
        let sums = |pixels: [At; LANES]| -> Each {
            let (columns, _) = &lanes::run_all(&Made(pixels, light.clone()))[0];
            std::array::from_fn(|l| (0..light.len()).map(|j| light[j] * columns[j * CHUNK + l]).sum())
        };
        let (up, down) = (sums(at(H)), sums(at(-H)));
        for l in 0..LANES {
            let turned: f64 = field()
                .waves
                .iter()
                .enumerate()
                .map(|(w, k)| {
                    let climb = k[0] * pixels[l].normal[0] + k[1] * pixels[l].normal[1];
                    climb
                        * (light[2 * w + 1] * columns[2 * w * CHUNK + l]
                            - light[2 * w] * columns[(2 * w + 1) * CHUNK + l])
                })
                .sum();
            let expected = (up[l] - down[l]) / (2.0 * H) - turned;
            assert!((response[l] - expected).abs() < 5e-3, "{}: {} and {expected}", distances[l], response[l]);
        }
    }
}
