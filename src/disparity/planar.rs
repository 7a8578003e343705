//! Planar displacements between two exposures of one camera, from dewarped images.
//!
//! ```text
//! d_0 = 0;   a_k(x) = a(x - d_k(x) / 2),  b_k(x) = b(x + d_k(x) / 2)
//! d_k+1 = mean of d_k(x) over the window + peak of C(a_k, b_k)
//! d     = d_K - L^2 / 24 (second differences of d_K along x and y)
//! ```
//! Windows are correlated (`correlate.rs`), vectors that contradict their neighbours are replaced by them, and both images are
//! resampled half the way each (B-spline) for the next round: windows follow the flow, and the peak comes to lie at no shift, where
//! its interpolation has no bias to first order. Mean of the guide and peak together are what the whole window moves by; the guide's value in its
//! middle instead would sharpen the field round by round, and its noise 2.5 times. What a mean over a window of side L takes off a bent field,
//! `L^2 / 24` times its curvature, is given back once, over half a window to either side; noise grows by 1.35. The vector belongs to the middle of its window and of its path. Its standard deviation comes from
//! what the parts of the window say one by one (`scatter.rs`).
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | a, b | `images` | 1 | dewarped px | the two exposures, particles alone |
//! | d | `dx_px`, `dy_px` | px | dewarped, y down | displacement from a to b |
//!
//! Source: Scarano, Meas. Sci. Technol. 13 (2002) R1 (image deformation); Westerweel, Scarano, Exp. Fluids 39 (2005) 1096 (normalised
//! median test). Simple on purpose: a window is not weighted, and a flow that
//! bends more than quadratically over one is averaged.

use super::correlate::{Correlator, Dewarped};
use super::lattice::Lattice;
use super::peak::{WIDEST, at_most};
use super::prepare::{BACKGROUND_PX, levels, particles};
use super::scatter::scatter;
use crate::dewarp::{Kernel, Sampler};
use crate::error::{Insufficient, Invalid, Result};
use crate::image::{GrayView, Samples};
use crate::stats::median;
use rayon::prelude::*;

/// Rounds of deformation and correlation.
const ROUNDS: usize = 4;
/// A peak must be this much higher than the second.
const RATIO: f64 = 1.2;
/// Residual of the normalised median test beyond which a vector is taken out.
const OUTLIER: f64 = 2.0;
/// Noise that the test allows in any case, px.
const NOISE_PX: f64 = 0.1;
/// And at the rim of the field, where neighbours lie on one side only and a gradient looks like a contradiction, px.
const RIM_PX: f64 = 0.5;

/// Options of [`planar_displacements`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlanarOptions {
    /// Side of a window, px, 8 to 512.
    pub window_px: usize,
    /// Distance of the windows, px, from 1.
    pub step_px: usize,
}

impl Default for PlanarOptions {
    fn default() -> Self {
        Self { window_px: 32, step_px: 16 }
    }
}

/// Vectors on a regular grid, x fastest, y from the top down; `NaN` where there is none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlanarVectors {
    /// Middle of the window, px of the images.
    pub x_px: Vec<f64>,
    /// Middle of the window, px, downwards.
    pub y_px: Vec<f64>,
    /// Displacement, px.
    pub dx_px: Vec<f64>,
    /// Displacement, px, downwards.
    pub dy_px: Vec<f64>,
    /// Standard deviation of the displacement by the particles that happen to be there, along x and y, px.
    pub sigma_px: [Vec<f64>; 2],
}

impl Lattice {
    fn neighbours(&self, k: usize) -> impl Iterator<Item = usize> + '_ {
        let (i, j) = ((k % self.columns) as isize, (k / self.columns) as isize);
        let offsets = (-1..=1).flat_map(|dj| (-1..=1).map(move |di| (di, dj)));
        offsets.filter(|d| *d != (0, 0)).filter_map(move |(di, dj)| {
            let (i, j) = (i + di, j + dj);
            let inside = i >= 0 && j >= 0 && (i as usize) < self.columns && (j as usize) < self.rows;
            inside.then(|| j as usize * self.columns + i as usize)
        })
    }

    /// Bilinear between the middles of the windows, held beyond the outermost.
    fn at(&self, field: &[[f64; 2]], x: usize, y: usize) -> [f64; 2] {
        let half = 0.5 * (self.window_px - 1) as f64;
        let place = |p: usize, first: usize, count: usize| {
            let t = ((p as f64 - first as f64 - half) / self.step_px as f64).clamp(0.0, (count - 1) as f64);
            let low = (t as usize).min(count.saturating_sub(2));
            (low, (low + 1).min(count - 1), t - low as f64)
        };
        let (i0, i1, s) = place(x, self.first_px[0], self.columns);
        let (j0, j1, t) = place(y, self.first_px[1], self.rows);
        let f = |i: usize, j: usize, a: usize| field[j * self.columns + i][a];
        [0, 1].map(|a| {
            (1.0 - t) * ((1.0 - s) * f(i0, j0, a) + s * f(i1, j0, a))
                + t * ((1.0 - s) * f(i0, j1, a) + s * f(i1, j1, a))
        })
    }
}

impl Lattice {
    /// Mean of the guide over a window.
    fn mean(&self, guide: &[[f64; 2]], k: usize) -> [f64; 2] {
        let ([x, y], w) = (self.corner(k), self.window_px);
        let mut sum = [0.0; 2];
        for (i, j) in (0..w).flat_map(|j| (0..w).map(move |i| (i, j))) {
            let d = self.at(guide, x + i, y + j);
            (0..2).for_each(|a| sum[a] += d[a]);
        }
        sum.map(|s| s / (w * w) as f64)
    }

    /// The windows half a side away on either side, along x and along y; none where one is outside.
    fn beside(&self, k: usize) -> [Option<[usize; 2]>; 2] {
        let far = (self.window_px as f64 / (2.0 * self.step_px as f64)).round().max(1.0) as usize;
        let (i, j) = (k % self.columns, k / self.columns);
        let along_x = i >= far && i + far < self.columns;
        let along_y = j >= far && j + far < self.rows;
        [along_x.then(|| [k - far, k + far]), along_y.then(|| [k - far * self.columns, k + far * self.columns])]
    }

    /// Part of a window that lies in another.
    fn overlap(&self, a: usize, b: usize) -> f64 {
        let (p, q) = (self.corner(a), self.corner(b));
        (0..2).map(|c| 1.0 - (p[c].abs_diff(q[c]) as f64 / self.window_px as f64).min(1.0)).product()
    }

    /// The displacement in the middle of a window from the means over it and over those beside it, with its standard deviation: noise of
    /// windows is alike as far as they overlap.
    fn unbent(
        &self,
        found: &[Option<[f64; 2]>],
        sigmas: &[Option<[f64; 2]>],
        k: usize,
    ) -> Option<([f64; 2], [f64; 2])> {
        let mut terms = vec![(k, 1.0)];
        for pair in self.beside(k).into_iter().flatten() {
            if pair.iter().all(|n| found[*n].is_some() && sigmas[*n].is_some()) {
                let lag = (self.corner(pair[1])[0].abs_diff(self.corner(k)[0]))
                    .max(self.corner(pair[1])[1].abs_diff(self.corner(k)[1]));
                let c = (self.window_px as f64 / lag as f64).powi(2) / 24.0;
                terms[0].1 += 2.0 * c;
                terms.extend(pair.map(|n| (n, -c)));
            }
        }
        let (mut d, mut variance) = ([0.0; 2], [0.0; 2]);
        for (n, c) in &terms {
            for a in 0..2 {
                d[a] += c * found[*n]?[a];
                for (m, e) in &terms {
                    variance[a] += c * e * self.overlap(*n, *m) * sigmas[*n]?[a] * sigmas[*m]?[a];
                }
            }
        }
        Some((d, variance.map(|v| v.max(0.0).sqrt())))
    }
}

/// Both exposures of one moment.
struct Exposed {
    samplers: [Sampler; 2],
}

/// Displacements between the first and the second image of every pair, one field by ensemble correlation over all pairs.
///
/// All images are of one camera on one grid; `seen` marks the pixels that the camera sees, rows packed. Windows are shared by the threads of
/// the pool in which this is called; the bits do not depend on their number.
///
/// # Errors
/// [`Invalid`] where sizes differ or an option is out of its range; [`Insufficient`] where no window shows a displacement.
pub fn planar_displacements(
    pairs: &[[GrayView<'_>; 2]],
    seen: &[bool],
    options: &PlanarOptions,
) -> Result<PlanarVectors> {
    let Some(first) = pairs.first() else {
        return Err(Invalid::Contradiction("no image pair was given; name two exposures of one camera".into()).into());
    };
    let [width, height] = [first[0].width(), first[0].height()];
    if pairs.iter().flatten().any(|i| [i.width(), i.height()] != [width, height]) || seen.len() != width * height {
        let what =
            format!("the images and their mask must all be {width} x {height} px, as the first; dewarp them together");
        return Err(Invalid::Contradiction(what).into());
    }
    let PlanarOptions { window_px, step_px } = *options;
    if !(8..=512).contains(&window_px) || window_px > width.min(height) {
        let what = format!("8 to 512 px and at most the images' {width} x {height} px");
        return Err(Invalid::value("window", window_px as f64, what).into());
    }
    if step_px == 0 {
        return Err(Invalid::value("distance of the windows", 0.0, "1 px or more").into());
    }
    let lattice = Lattice::centred([width, height], window_px, step_px);
    let exposed: Vec<Exposed> = pairs.iter().map(|p| prepare(p, seen, width)).collect::<Result<_>>()?;
    let mut guide = vec![[0.0; 2]; lattice.len()];
    let mut found = vec![];
    for round in 0..ROUNDS {
        found = correlated(&exposed, seen, width, &lattice, &guide, round);
        let bad = contradicting(&found, &lattice);
        found.iter_mut().zip(bad).filter(|(_, bad)| *bad).for_each(|(d, _)| *d = None);
        guide = filled(&found, &lattice).ok_or_else(|| {
            let what = format!(
                "none of {} windows of {window_px} px shows a displacement; check that both exposures are of one moment and camera, take \
                 larger windows, or shorten the time between the exposures",
                lattice.len()
            );
            Insufficient::Degenerate(what)
        })?;
    }
    let sigmas = scatter(&moved(&exposed, seen, width, &lattice, &guide), width, &lattice);
    let mut out = PlanarVectors::default();
    for k in 0..found.len() {
        let [x, y] = lattice.middle(k);
        // A vector whose own scatter cannot be told is none: it stands on too few particles.
        let ([dx, dy], sigma) = lattice.unbent(&found, &sigmas, k).unwrap_or(([f64::NAN; 2], [f64::NAN; 2]));
        out.x_px.push(x);
        out.y_px.push(y);
        out.dx_px.push(dx);
        out.dy_px.push(dy);
        (0..2).for_each(|a| out.sigma_px[a].push(sigma[a]));
    }
    Ok(out)
}

fn prepare(pair: &[GrayView<'_>; 2], seen: &[bool], width: usize) -> Result<Exposed> {
    let sampler = |view: &GrayView<'_>| -> Result<Sampler> {
        let mut grey = levels(view);
        particles(&mut grey, seen, width, BACKGROUND_PX);
        Ok(Sampler::new(&GrayView::new(Samples::F32(&grey), width, view.height(), width)?, Kernel::BSpline))
    };
    Ok(Exposed { samplers: [sampler(&pair[0])?, sampler(&pair[1])?] })
}

/// Both images of every moment moved half the guide each.
fn moved(exposed: &[Exposed], seen: &[bool], width: usize, lattice: &Lattice, guide: &[[f64; 2]]) -> Vec<Dewarped> {
    let moved = |sampler: &Sampler, part: f64| -> Vec<f32> {
        let row = |y: usize| {
            (0..width).map(move |x| {
                let d = lattice.at(guide, x, y);
                sampler.at(x as f64 + part * d[0], y as f64 + part * d[1])
            })
        };
        let rows: Vec<Vec<f32>> = (0..seen.len() / width).into_par_iter().map(|y| row(y).collect()).collect();
        rows.concat()
    };
    exposed
        .iter()
        .map(|e| Dewarped { levels: [moved(&e.samplers[0], -0.5), moved(&e.samplers[1], 0.5)], seen: seen.to_vec() })
        .collect()
}

/// One round: what is left of the displacement after the guide.
fn correlated(
    exposed: &[Exposed],
    seen: &[bool],
    width: usize,
    lattice: &Lattice,
    guide: &[[f64; 2]],
    round: usize,
) -> Vec<Option<[f64; 2]>> {
    let moments = moved(exposed, seen, width, lattice, guide);
    let correlator = Correlator::new(lattice.window_px);
    // What the first round found is followed; peaks far from it are chance.
    let search = if round == 0 { 2 * lattice.window_px / 5 } else { (lattice.window_px / 8).max(3) };
    let one = |k: usize| {
        let [x, y] = lattice.corner(k);
        let sums = correlator.window(&moments, width, x, y)?;
        let map = correlator.map(sums.cross);
        let peak = map.peak(search)?;
        (map.ratio(&peak, &at_most(&peak.shape_px2, WIDEST * lattice.window_px as f64)) > RATIO).then_some(())?;
        let mean = lattice.mean(guide, k);
        Some([0, 1].map(|a| mean[a] + peak.shift_px[a]))
    };
    (0..lattice.len()).into_par_iter().map(one).collect()
}

/// The normalised median test: vectors unlike their neighbours.
fn contradicting(found: &[Option<[f64; 2]>], lattice: &Lattice) -> Vec<bool> {
    let test = |k: usize| {
        let Some(d) = found[k] else { return false };
        let near: Vec<[f64; 2]> = lattice.neighbours(k).filter_map(|n| found[n]).collect();
        let all = lattice.neighbours(k).count();
        let noise_px = if all < 8 { RIM_PX } else { NOISE_PX };
        // Two neighbours cannot outvote a vector, which in a single row or column has no more.
        near.len() < 3 && all >= 3
            || (0..2).any(|a| {
                let mut values: Vec<f64> = near.iter().map(|v| v[a]).collect();
                let middle = median(&mut values).unwrap_or(d[a]);
                let mut spread: Vec<f64> = near.iter().map(|v| (v[a] - middle).abs()).collect();
                (d[a] - middle).abs() > OUTLIER * (median(&mut spread).unwrap_or(0.0) + noise_px)
            })
    };
    (0..found.len()).map(test).collect()
}

/// The field without gaps: what is missing is the mean of its neighbours, from the rim of the gaps inwards. None without any vector.
fn filled(found: &[Option<[f64; 2]>], lattice: &Lattice) -> Option<Vec<[f64; 2]>> {
    let mut all = found.to_vec();
    while all.iter().any(Option::is_none) {
        let next: Vec<Option<[f64; 2]>> = (0..all.len())
            .map(|k| {
                all[k].or_else(|| {
                    let near: Vec<[f64; 2]> = lattice.neighbours(k).filter_map(|n| all[n]).collect();
                    let mean = |a: usize| near.iter().map(|v| v[a]).sum::<f64>() / near.len() as f64;
                    (!near.is_empty()).then(|| [mean(0), mean(1)])
                })
            })
            .collect();
        if next.iter().flatten().count() == all.iter().flatten().count() {
            return None;
        }
        all = next;
    }
    Some(all.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Particles rendered where a flow has carried them, `part` of the way.
    fn exposure(part: f64, flow: &dyn Fn(f64, f64) -> [f64; 2], seed: u32) -> Vec<f32> {
        let n = 192;
        let mut grey = vec![0.0_f32; n * n];
        let mut x = seed;
        let mut next = || {
            x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(x >> 8) / f64::from(1 << 24)
        };
        for _ in 0..1800 {
            let p = [next() * n as f64, next() * n as f64];
            let d = flow(p[0], p[1]);
            let q = [p[0] + part * d[0], p[1] + part * d[1]];
            for v in (q[1] - 5.0).max(0.0) as usize..((q[1] + 6.0).max(0.0) as usize).min(n) {
                for u in (q[0] - 5.0).max(0.0) as usize..((q[0] + 6.0).max(0.0) as usize).min(n) {
                    let r2 = (u as f64 - q[0]).powi(2) + (v as f64 - q[1]).powi(2);
                    grey[v * n + u] += (200.0 * (-0.5 * r2).exp()) as f32;
                }
            }
        }
        grey
    }

    #[test]
    fn a_sheared_flow_is_measured_at_the_middles_of_windows_and_paths() {
        let n = 192;
        let flow = |x: f64, y: f64| [4.3 + 0.02 * (y - 96.0), -2.6 + 0.015 * (x - 96.0)];
        let (a, b) = (exposure(-0.5, &flow, 5), exposure(0.5, &flow, 5));
        let view = |g: &'static [f32]| GrayView::new(Samples::F32(g), n, n, n).unwrap();
        let pair = [view(a.leak()), view(b.leak())];
        let field = planar_displacements(&[pair], &vec![true; n * n], &PlanarOptions::default()).unwrap();
        let (mut errors, mut mean) = (vec![], [0.0; 2]);
        for k in 0..field.x_px.len() {
            let true_d = flow(field.x_px[k], field.y_px[k]);
            let e = [field.dx_px[k] - true_d[0], field.dy_px[k] - true_d[1]];
            if e[0].is_finite() {
                errors.push(e[0].hypot(e[1]));
                (0..2).for_each(|c| mean[c] += e[c]);
            }
        }
        assert!(errors.len() * 10 > field.x_px.len() * 9, "{} of {}", errors.len(), field.x_px.len());
        let n = errors.len() as f64;
        let scatter = (errors.iter().map(|e| e * e).sum::<f64>() / (2.0 * n)).sqrt();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 0.1, "median error {} px", errors[errors.len() / 2]);
        // Windows overlap by half: one vector in four is independent.
        let sigma = scatter / (0.25 * n).sqrt();
        assert!(mean.iter().all(|m| (m / n).abs() < 4.0 * sigma), "{mean:?} of {n}, {sigma}");
    }

    /// One row, one column, one window: nobody can contradict them.
    #[test]
    fn a_single_row_of_windows_is_measured() {
        let n = 192;
        let flow = |_: f64, _: f64| [1.3, -0.6];
        let (a, b) = (exposure(-0.5, &flow, 9), exposure(0.5, &flow, 9));
        for (width, height, window_px) in [(192, 40, 32), (40, 192, 32), (64, 64, 64)] {
            let cut = |g: &[f32]| (0..width * height).map(|i| g[i / width * n + i % width]).collect::<Vec<f32>>();
            let view = |g: &'static [f32]| GrayView::new(Samples::F32(g), width, height, width).unwrap();
            let pair = [view(cut(&a).leak()), view(cut(&b).leak())];
            let options = PlanarOptions { window_px, step_px: 16 };
            let field = planar_displacements(&[pair], &vec![true; width * height], &options).unwrap();
            let right = |k: &usize| (field.dx_px[*k] - 1.3).hypot(field.dy_px[*k] + 0.6) < 0.3;
            let (found, all) = ((0..field.x_px.len()).filter(right).count(), field.x_px.len());
            assert!(10 * found >= 8 * all, "{width} x {height}: {found} of {all}");
        }
    }

    /// Left half: the same particles, moved. Right half: others.
    #[test]
    fn windows_of_unpaired_particles_show_no_displacement() {
        let n = 192;
        let flow = |_: f64, _: f64| [2.3, -1.4];
        for (window_px, step_px) in [(16, 8), (32, 16), (48, 16)] {
            let (a, mut b) = (exposure(-0.5, &flow, 5), exposure(0.5, &flow, 5));
            let other = exposure(0.5, &flow, 77);
            (0..n * n).filter(|i| i % n >= n / 2).for_each(|i| b[i] = other[i]);
            let view = |g: &'static [f32]| GrayView::new(Samples::F32(g), n, n, n).unwrap();
            let pair = [view(a.leak()), view(b.leak())];
            let options = PlanarOptions { window_px, step_px };
            let field = planar_displacements(&[pair], &vec![true; n * n], &options).unwrap();
            let half = 0.5 * window_px as f64;
            let (mut found, mut all, mut right) = ([0; 2], [0; 2], 0);
            for k in 0..field.x_px.len() {
                let side = if field.x_px[k] + half <= 96.0 {
                    0
                } else if field.x_px[k] - half >= 96.0 {
                    1
                } else {
                    continue;
                };
                all[side] += 1;
                found[side] += usize::from(field.dx_px[k].is_finite());
                right += usize::from(side == 0 && (field.dx_px[k] - 2.3).hypot(field.dy_px[k] + 1.4) < 0.3);
            }
            println!("{window_px} px: {found:?} of {all:?}, {right} right");
            assert!(10 * right > 8 * all[0], "{window_px} px: {right} of {}", all[0]);
            assert!(10 * found[1] <= all[1], "{window_px} px: {found:?} of {all:?}");
        }
    }

    #[test]
    fn images_without_common_particles_and_wrong_sizes_are_refused() {
        let n = 192;
        let (still, other) = (exposure(0.0, &|_, _| [0.0; 2], 1), vec![0.0_f32; n * n]);
        let view = |g: &'static [f32]| GrayView::new(Samples::F32(g), n, n, n).unwrap();
        let (still, other) = (view(still.leak()), view(other.leak()));
        let seen = vec![true; n * n];
        let refusal = |pairs: &[[GrayView<'_>; 2]], seen: &[bool], o: PlanarOptions| {
            planar_displacements(pairs, seen, &o).unwrap_err().to_string()
        };
        let o = PlanarOptions::default();
        assert!(refusal(&[[still, other]], &seen, o).contains("shows a displacement"));
        assert!(refusal(&[[still, still]], &seen[1..], o).contains("192 x 192 px"));
        assert!(refusal(&[], &seen, o).contains("no image pair"));
        assert!(refusal(&[[still, still]], &seen, PlanarOptions { window_px: 400, ..o }).contains("window"));
        assert!(refusal(&[[still, still]], &seen, PlanarOptions { step_px: 0, ..o }).contains("1 px or more"));
    }
}
