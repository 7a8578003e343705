//! The edge along a line: smoothed grey levels on either side of it, along the normal.

use super::{Strength, evenly};
use crate::detect::level::Level;
use crate::detect::trace::Line;
use crate::lanes::{self, Kernel, Lanes};

/// How far on either side of a line its gradient and its step are looked at, px.
pub(in crate::detect) const LOOK_PX: [f64; 2] = [0.75, 3.0];
/// Places of a line at which its edge is looked at.
const LOOKS: usize = 36;

/// Contrast and blur along a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) contrast: f64,
    pub(super) blur_px: f64,
}

/// Looks across the line at up to [`LOOKS`] places; returns the typical edge and the share of places where the grey falls outwards
/// (`turn` = sense of turning, negated for dark regions) by more than the least gradient.
pub(super) fn edge_strength(line: &Line, smooth: &impl Level, strength: Strength, turn: f64) -> (Edge, f64) {
    let looks = line.u.len().min(LOOKS);
    let [mut gradients, mut steps] = lanes::run(Looks { line, smooth, turn });
    let strong = gradients[..looks].iter().filter(|g| **g > strength.gradient).count();
    let middle = looks / 2;
    let gradient = *gradients[..looks].select_nth_unstable_by(middle, f64::total_cmp).1;
    let contrast = *steps[..looks].select_nth_unstable_by(middle, f64::total_cmp).1;
    // The smoothed edge has variance blur^2 + 1 and slope contrast / (sqrt(2 pi) sigma).
    let sigma = contrast.max(gradient) / (2.506_628 * gradient.max(1e-12));
    let blur_px = (sigma * sigma - 1.0).max(0.25).sqrt().min(4.0);
    (Edge { contrast: contrast.max(gradient), blur_px }, strong as f64 / looks as f64)
}

/// Gradients across the line, grey/px, and steps from inside to outside, grey.
#[derive(Clone)]
struct Looks<'a, T> {
    line: &'a Line,
    smooth: &'a T,
    turn: f64,
}

impl<T: Level> Kernel for Looks<'_, T> {
    type Output = [[f64; LOOKS]; 2];
    #[inline(always)]
    fn run<L: Lanes>(self) -> [[f64; LOOKS]; 2] {
        let Self { line, smooth, turn } = self;
        let n = line.u.len();
        let looks = n.min(LOOKS);
        // Place and tangent.
        let mut along = [[0.0_f32; LOOKS]; 4];
        for (k, i) in evenly(n, looks).enumerate() {
            let (before, after) = match line.closed {
                true => (if i < 2 { i + n - 2 } else { i - 2 }, if i + 2 < n { i + 2 } else { i + 2 - n }),
                false => (i.saturating_sub(2), (i + 2).min(n - 1)),
            };
            along[0][k] = line.u[i];
            along[1][k] = line.v[i];
            along[2][k] = line.u[after] - line.u[before];
            along[3][k] = line.v[after] - line.v[before];
        }
        let [u, v, tu, tv] = &along;
        let mut normal = [[0.0; LOOKS]; 2];
        for k in 0..LOOKS {
            let length = f64::from(tu[k] * tu[k] + tv[k] * tv[k]).sqrt().max(1e-6);
            normal[0][k] = turn * f64::from(tv[k]) / length;
            normal[1][k] = -turn * f64::from(tu[k]) / length;
        }
        let mut grey = [[0.0; LOOKS]; 4];
        let [near, far] = LOOK_PX;
        for (grey, d) in grey.iter_mut().zip([-near, near, -far, far]) {
            let mut at = [[0.0; LOOKS]; 2];
            for k in 0..LOOKS {
                at[0][k] = f64::from(u[k]) + d * normal[0][k];
                at[1][k] = f64::from(v[k]) + d * normal[1][k];
            }
            smooth.greys(&at[0], &at[1], grey);
        }
        let mut out = [[0.0; LOOKS]; 2];
        for k in 0..LOOKS {
            out[0][k] = (grey[0][k] - grey[1][k]) / (2.0 * near);
            out[1][k] = grey[2][k] - grey[3][k];
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grey levels that rise evenly.
    #[derive(Clone)]
    struct Ramp;
    impl Level for Ramp {
        fn starts(&self) -> impl Iterator<Item = u32> {
            std::iter::empty()
        }
        fn width(&self) -> usize {
            60
        }
        fn height(&self) -> usize {
            50
        }
        fn smooth(&self, u: usize, v: usize) -> f32 {
            3.0 * u as f32 + 2.0 * v as f32
        }
        fn field(&self, _: usize, _: usize) -> f32 {
            0.0
        }
    }

    /// On a circle, where the normal is known, for lines with more and fewer points than places; alike in all widths.
    #[test]
    fn looks_go_along_the_normal() {
        for (count, closed) in [(90, true), (40, false), (20, true)] {
            let angle = |i: usize| std::f32::consts::TAU * i as f32 / count as f32;
            let (u, v) = (0..count).map(|i| (30.0 + 12.0 * angle(i).cos(), 25.0 + 12.0 * angle(i).sin())).unzip();
            let line = Line { u, v, closed, rising: true };
            let all = lanes::run_all(&Looks { line: &line, smooth: &Ramp, turn: 1.0 });
            assert!(all.iter().all(|one| one.map(|x| x.map(f64::to_bits)) == all[0].map(|x| x.map(f64::to_bits))));
            let looks = count.min(LOOKS);
            // At the ends of an open line the tangent is that of a point beside it.
            let ends = if closed { 0 } else { 2 };
            for k in ends..looks - ends {
                let (s, c) = f64::from(angle(k * count / looks)).sin_cos();
                let rise = 3.0 * c + 2.0 * s;
                assert!((all[0][0][k] + rise).abs() < 2e-2, "{k} of {count}: {} {rise}", all[0][0][k]);
                assert!((all[0][1][k] + 6.0 * rise).abs() < 1e-1, "{k} of {count}: {} {rise}", all[0][1][k]);
            }
        }
    }
}
