//! What the pixels of each sector of the contour say, summed up once: everything after works on sectors, not on pixels.
//!
//! In a sector the model of [`crate::detect::edge_model`] is linear in eight local numbers,
//!
//! ```text
//! g(d) = shift E e + ds E f + L_in P + L_out Q + S_in (P d - s^2 e) + S_out (Q d + s^2 e)
//!        + B_in d (P d - s^2 e) / 2 + B_out d (Q d + s^2 e) / 2,     Q = 1 - P,  E = L_in - L_out
//! z = d / s + kappa s / 2,   P = Phi(-z),   e = phi(z) / s,   f = -phi(z) (kappa / 2 - d / s^2)
//! ```
//!
//! (a light that rises along the normal is blurred with the disc: `(x 1[x < 0]) * G_s = P d - s^2 e` for a straight edge; one that bends,
//! and that the blur alone would leave as `d^2 / 2`: `((x^2 - s^2) / 2 1[x < 0]) * G_s = d (P d - s^2 e) / 2`),
//!
//! so the weighted sums of products of the columns `(e, f, P, Q, P d - s^2 e, Q d + s^2 e, g, bent in, bent out)` are all that the image has to
//! say about them (the step `E` is put in later). The last two are only summed up where light varies that much. Sums of the pixels away from the edge, on either side, are kept beside them: they judge noise and light.

use crate::detect::band::{Band, LANES};
use crate::detect::contour::Contour;
use crate::lanes::{self, Kernel, Lanes};
use nalgebra::{SMatrix, SVector};

/// Local numbers of a sector: shift, change of the blur, and level, slope and bend of the light inside and outside.
pub(crate) const LOCAL: usize = 8;
/// Columns of the sums: the local numbers, and the grey level between them.
const COLUMNS: usize = LOCAL + 1;
/// Place of the grey level among the columns; those of light that bends come last.
const GREY: usize = 6;
/// Columns of the local numbers.
const COLUMN: [usize; LOCAL] = [0, 1, 2, 3, 4, 5, 7, 8];
/// Products of two columns, by rows of the first [`LANES`] columns, those above the diagonal without meaning; the last column's with itself behind.
const PRODUCTS: usize = COLUMNS * LANES + 1;
/// Beyond this many blurs the edge is not felt.
const FAR: f64 = 4.5;
/// Beyond this many blurs a pixel shows the light of its side; what is left of the edge is taken off.
const AWAY: f64 = 2.3;

/// Pixels that share the error of light that the model does not follow.
const SHARING: f64 = 10.0;

/// Sums over the pixels of one side away from the edge.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Away {
    pub(crate) n: f64,
    pub(crate) d: f64,
    pub(crate) dd: f64,
    pub(crate) ddd: f64,
    pub(crate) dddd: f64,
    pub(crate) y: f64,
    pub(crate) yd: f64,
    pub(crate) ydd: f64,
    pub(crate) yy: f64,
}

impl Away {
    #[inline(always)]
    fn push(&mut self, d: f64, y: f64) {
        self.n += 1.0;
        self.d += d;
        let dd = d * d;
        self.dd += dd;
        self.ddd += dd * d;
        self.dddd += dd * dd;
        self.y += y;
        self.yd += y * d;
        self.ydd += y * dd;
        self.yy += y * y;
    }

    pub(crate) fn add(&mut self, o: &Away) {
        self.n += o.n;
        self.d += o.d;
        self.dd += o.dd;
        self.ddd += o.ddd;
        self.dddd += o.dddd;
        self.y += o.y;
        self.yd += o.yd;
        self.ydd += o.ydd;
        self.yy += o.yy;
    }

    /// Sum of `y - level - slope d - bend d^2 / 2`, and of its squares.
    pub(crate) fn about(&self, level: f64, slope: f64, bend: f64) -> (f64, f64) {
        let half = 0.5 * bend;
        let sum = self.y - level * self.n - slope * self.d - half * self.dd;
        let along = self.yd - level * self.d - slope * self.dd - half * self.ddd;
        let bent = self.ydd - level * self.dd - slope * self.ddd - half * self.dddd;
        // Residual times residual: what the light takes off y, and what it takes off the rest.
        let squares = self.yy - level * (self.y + sum) - slope * (self.yd + along) - half * (self.ydd + bent);
        (sum, squares.max(0.0))
    }
}

/// Sums of all sectors of one contour, reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Sectors {
    products: Vec<[f64; PRODUCTS]>,
    /// Inside, outside.
    pub(crate) away: [Vec<Away>; 2],
    pub(crate) pixels: Vec<u32>,
    /// Sectors that count.
    pub(crate) keep: Vec<bool>,
    /// Sectors that something hides: these never do.
    pub(crate) hidden: Vec<bool>,
}

/// What a pixel is weighed and explained with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lens {
    pub(crate) blur_px: f64,
    /// Noise variance inside and outside, grey^2.
    pub(crate) variance: [f64; 2],
    /// Third derivatives of the light, which the model does not follow, inside and outside, grey in units of the semi-axes; zero for light
    /// that hardly bends at all.
    pub(crate) bends: [f64; 2],
    /// Inside minus outside, roughly, grey.
    pub(crate) step: f64,
    /// Taken off every grey level: sums of squares of small numbers are exact.
    pub(crate) ground: f64,
}

impl Sectors {
    pub(crate) fn len(&self) -> usize {
        self.keep.len()
    }

    fn clear(&mut self, count: usize) {
        self.products.clear();
        self.products.resize(count, [0.0; PRODUCTS]);
        for side in &mut self.away {
            side.clear();
            side.resize(count, Away::default());
        }
        self.pixels.clear();
        self.pixels.resize(count, 0);
        self.keep.clear();
        self.keep.resize(count, true);
        self.hidden.clear();
        self.hidden.resize(count, false);
    }

    /// From now on these sectors do not count.
    pub(crate) fn hide(&mut self, which: &[bool]) {
        self.hidden.iter_mut().zip(which).for_each(|(h, w)| *h |= w);
        self.keep.iter_mut().zip(&self.hidden).for_each(|(keep, h)| *keep &= !h);
    }

    /// Sums up the pixels of a band.
    pub(crate) fn sum_up(&mut self, band: &Band, contour: &Contour, lens: &Lens) {
        self.clear(contour.len());
        lanes::run(SumUp { sectors: self, band, contour, lens });
    }

    /// [`Sectors::sum_up`] of sums that are zero.
    #[inline(always)]
    fn add<L: Lanes>(&mut self, band: &Band, contour: &Contour, lens: &Lens) {
        // Light that turns away from its parabola by `bend d^3 / 6`; neighbouring pixels share that error.
        let bent = |k: usize, d: f64| {
            let left = lens.bends[usize::from(d > 0.0)] * (contour.steepness(k) * d).powi(3) / 6.0;
            SHARING * left * left
        };
        let smooth = lens.bends == [0.0; 2];
        let inverse = 1.0 / lens.blur_px;
        let (mut z, mut inside, mut density) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for at in (0..band.len()).step_by(LANES) {
            let (d, kappa) = (&band.distance[at..at + LANES], &band.curvature[at..at + LANES]);
            for i in 0..LANES {
                z[i] = d[i] * inverse + 0.5 * kappa[i] * lens.blur_px;
            }
            normal_tails(&z, &mut inside, &mut density);
            for i in 0..LANES {
                let d = d[i];
                if d.is_nan() {
                    continue;
                }
                let k = band.sector[at + i] as usize;
                let y = band.grey[at + i] - lens.ground;
                self.pixels[k] += 1;
                if z[i] > AWAY {
                    self.away[1][k].push(d, y - lens.step * inside[i]);
                } else if z[i] < -AWAY {
                    self.away[0][k].push(d, y + lens.step * (1.0 - inside[i]));
                }
                let bent = if smooth { 0.0 } else { bent(k, d) };
                let columns = if smooth { GREY + 1 } else { COLUMNS };
                if z[i] > FAR {
                    self.push_far(k, 1, 1.0 / (lens.variance[1] + bent), d, y);
                } else if z[i] < -FAR {
                    self.push_far(k, 0, 1.0 / (lens.variance[0] + bent), d, y);
                } else {
                    let (p, q) = (inside[i], 1.0 - inside[i]);
                    let weight = 1.0 / (lens.variance[0] * p + lens.variance[1] * q + bent);
                    let e = density[i] * inverse;
                    let f = density[i] * (d * inverse * inverse - 0.5 * kappa[i]);
                    let mixed = lens.blur_px * density[i];
                    let [levels, slopes, bends] = light(d, p, mixed);
                    let column = [e, f, levels[0], levels[1], slopes[0], slopes[1], y, bends[0], bends[1]];
                    self.push_near::<L>(k, weight, columns, column);
                }
            }
        }
    }

    /// A pixel at the edge, by so many of its columns.
    #[inline(always)]
    fn push_near<L: Lanes>(&mut self, k: usize, weight: f64, columns: usize, column: [f64; COLUMNS]) {
        let (rows, last) = self.products[k].split_at_mut(COLUMNS * LANES);
        for a in 0..columns {
            let w = L::splat(weight * column[a]);
            let mut at = 0;
            while at < LANES {
                let sums = &mut rows[a * LANES + at..][..L::N];
                (L::load(sums) + w * L::load(&column[at..])).store(sums);
                at += L::N;
            }
        }
        if columns == COLUMNS {
            last[0] += weight * column[LANES] * column[LANES];
        }
    }

    /// A pixel that sees one side only.
    #[inline(always)]
    fn push_far(&mut self, k: usize, side: usize, weight: f64, d: f64, y: f64) {
        let sums = &mut self.products[k];
        let (level, slope, bend) = (2 + side, 4 + side, GREY + 1 + side);
        let (wd, wy, half) = (weight * d, weight * y, 0.5 * d * d);
        sums[place(level, level)] += weight;
        sums[place(slope, level)] += wd;
        sums[place(slope, slope)] += wd * d;
        sums[place(GREY, level)] += wy;
        sums[place(GREY, slope)] += wy * d;
        sums[place(GREY, GREY)] += wy * y;
        sums[place(bend, level)] += weight * half;
        sums[place(bend, slope)] += wd * half;
        sums[place(bend, GREY)] += wy * half;
        sums[place(bend, bend)] += weight * half * half;
    }

    /// Normal matrix and right side of the local numbers of sector `k` with the step of the light there.
    pub(crate) fn local(&self, k: usize, step: f64) -> (SMatrix<f64, LOCAL, LOCAL>, SVector<f64, LOCAL>) {
        let sums = &self.products[k];
        let scale = |a: usize| if a < 2 { step } else { 1.0 };
        let product = |a: usize, b: usize| sums[place(a.max(b), a.min(b))];
        let normal = SMatrix::from_fn(|a, b| product(COLUMN[a], COLUMN[b]) * scale(a) * scale(b));
        (normal, SVector::from_fn(|a, _| product(GREY, COLUMN[a]) * scale(a)))
    }

    /// Weighted sum of the squared grey levels of sector `k`.
    pub(crate) fn squares(&self, k: usize) -> f64 {
        self.products[k][place(GREY, GREY)]
    }

    /// What sector `k` says about the shift of its edge, 1/px^2.
    pub(crate) fn information(&self, k: usize, step: f64) -> f64 {
        self.products[k][0] * step * step
    }

    /// Step of the grey level that sector `k` shows by itself, its edge where the ellipse is; none where it sees one side only.
    pub(crate) fn own_step(&self, k: usize) -> Option<f64> {
        let s = &self.products[k];
        let (pp, qp, qq) = (s[place(2, 2)], s[place(3, 2)], s[place(3, 3)]);
        let (yp, yq) = (s[place(GREY, 2)], s[place(GREY, 3)]);
        let det = pp * qq - qp * qp;
        (det > 1e-9 * (pp + qq) * (pp + qq)).then(|| ((qq * yp - qp * yq) - (pp * yq - qp * yp)) / det)
    }
}

/// Columns of level, slope and bend of the light inside and outside, of a pixel at distance `d` with the profile `p`; `mixed` is `s^2 e`.
#[inline(always)]
fn light(d: f64, p: f64, mixed: f64) -> [[f64; 2]; 3] {
    let q = 1.0 - p;
    let slope = [p * d - mixed, q * d + mixed];
    [[p, q], slope, slope.map(|x| 0.5 * d * x)]
}

/// Place of a product, `a >= b`.
#[inline(always)]
const fn place(a: usize, b: usize) -> usize {
    a * LANES + b
}

/// As wide as the processor is.
struct SumUp<'a> {
    sectors: &'a mut Sectors,
    band: &'a Band,
    contour: &'a Contour,
    lens: &'a Lens,
}

impl Kernel for SumUp<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        self.sectors.add::<L>(self.band, self.contour, self.lens);
    }
}

/// `(Phi(-z), phi(z))` of the normal distribution for many `z`, without branches: Abramowitz and Stegun 7.1.26, error below 1.5e-7.
#[inline(always)]
pub(crate) fn normal_tails<const N: usize>(z: &[f64; N], tail: &mut [f64; N], density: &mut [f64; N]) {
    const INVERSE_ROOT_TAU: f64 = 0.398_942_280_401_432_7;
    for i in 0..N {
        let x = (z[i].abs() * std::f64::consts::FRAC_1_SQRT_2).min(6.0);
        let gauss = exp_of_negative(-x * x);
        let t = 1.0 / (1.0 + 0.327_591_1 * x);
        let poly =
            t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
        let half = 0.5 * poly * gauss;
        tail[i] = if z[i] > 0.0 { half } else { 1.0 - half };
        density[i] = INVERSE_ROOT_TAU * gauss;
    }
}

/// `exp(x)` for `-40 <= x <= 0`, relative error below 1e-10: `2^n` times the power series on `|r| <= ln 2 / 2`.
#[inline(always)]
fn exp_of_negative(x: f64) -> f64 {
    // Adding 1.5 * 2^52 rounds to the nearest whole number and leaves it in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * 0.693_147_180_369_123_8) - n * 1.908_214_929_270_587_7e-10;
    let series = 1.0
        + r * (1.0
            + r * (1.0 / 2.0
                + r * (1.0 / 6.0
                    + r * (1.0 / 24.0
                        + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0 + r * (1.0 / 40320.0))))))));
    let power = f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52);
    series * power
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conic::Ellipse;
    use crate::detect::band::Reach;
    use crate::frames::Pixel;
    use crate::image::{GrayView, Samples};

    /// Sums made at one width.
    #[derive(Clone)]
    struct Made<'a> {
        band: &'a Band,
        contour: &'a Contour,
        lens: &'a Lens,
    }

    impl Kernel for Made<'_> {
        type Output = Sectors;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Sectors {
            let mut out = Sectors::default();
            out.clear(self.contour.len());
            SumUp { sectors: &mut out, band: self.band, contour: self.contour, lens: self.lens }.run::<L>();
            out
        }
    }

    /// Sums of an image with noise, light that bends included.
    #[test]
    fn all_widths_give_the_same_sums() {
        let e = Ellipse { center_px: Pixel::new(30.3, 33.1), semi_major_px: 14.2, semi_minor_px: 9.7, angle_rad: 0.6 };
        let grey: Vec<f32> = (0..64 * 64).map(|i| ((i * 7919) % 251) as f32).collect();
        let view = GrayView::new(Samples::F32(&grey), 64, 64, 64).unwrap();
        let (mut band, mut contour) = (Band::default(), Contour::default());
        contour.cut(&e, &[]);
        band.collect(&view, &e, &contour, Reach { inner_px: 5.0, outer_px: 6.0 });
        for bends in [[0.0; 2], [3.0, 5.0]] {
            let lens = Lens { blur_px: 0.9, variance: [4.0, 9.0], bends, step: -60.0, ground: 100.0 };
            let all = lanes::run_all(&Made { band: &band, contour: &contour, lens: &lens });
            let bits = |s: &Sectors| s.products.iter().flatten().map(|x| x.to_bits()).collect::<Vec<_>>();
            let plain = &all[0];
            for wide in &all[1..] {
                assert_eq!(bits(plain), bits(wide));
                assert_eq!(plain.pixels, wide.pixels);
            }
            let count = plain.pixels.iter().sum::<u32>() as usize;
            assert_eq!(count, band.distance.iter().filter(|d| d.is_finite()).count());
            assert!(plain.squares(0) > 0.0);
        }
    }

    #[test]
    fn tails_agree_with_the_exponential_and_the_integral() {
        // Phi(-z) by Simpson's rule from the density.
        let simpson = |z: f64| {
            let (n, top) = (4000, 9.0);
            let h = (top - z) / f64::from(n);
            let phi = |x: f64| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
            (0..=n)
                .map(|i| {
                    let w = if i == 0 || i == n { 1.0 } else { f64::from(2 + 2 * (i % 2)) };
                    w * phi(z + h * f64::from(i))
                })
                .sum::<f64>()
                * h
                / 3.0
        };
        for k in -50..=50 {
            let z = 0.11 * f64::from(k);
            let (mut tail, mut density) = ([0.0; LANES], [0.0; LANES]);
            normal_tails(&[z; LANES], &mut tail, &mut density);
            let phi = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
            assert!((density[3] - phi).abs() < 1e-10, "density at {z}: {} against {phi}", density[3]);
            assert!((tail[5] - simpson(z)).abs() < 2e-7, "tail at {z}: {} against {}", tail[5], simpson(z));
        }
    }

    /// Against the blur of a light that is 1, x or (x^2 - s^2) / 2 on one side of a straight edge and nothing on the other.
    #[test]
    fn light_on_either_side_is_blurred_with_the_disc() {
        let s = 0.9;
        for d in [-2.5, -0.7, 0.0, 0.4, 1.9] {
            let z: f64 = d / s;
            let (mut tail, mut density) = ([0.0; 1], [0.0; 1]);
            normal_tails(&[z], &mut tail, &mut density);
            let columns = light(d, tail[0], s * density[0]);
            let lights: [fn(f64, f64) -> f64; 3] = [|_, _| 1.0, |x, _| x, |x, s| 0.5 * (x * x - s * s)];
            for (column, light) in columns.into_iter().zip(lights) {
                for (side, column) in column.into_iter().enumerate() {
                    let (n, h) = (20_000, 10.0 / 20_000.0);
                    let sign = if side == 0 { -1.0 } else { 1.0 };
                    let sum: f64 = (0..n)
                        .map(|i| sign * (f64::from(i) + 0.5) * h)
                        .map(|x| light(x, s) * (-0.5 * ((d - x) / s).powi(2)).exp())
                        .sum();
                    let blurred = sum * h / (s * std::f64::consts::TAU.sqrt());
                    assert!((column - blurred).abs() < 1e-6, "{d} {side}: {column} {blurred}");
                }
            }
        }
    }
}
