//! How far a displacement is off by the particles that happen to be in its window: the jackknife.
//!
//! A window is cut into n blocks (of every pair of exposures), and the correlation about its peak into what each contributes. The peak is found
//! again without each block in turn:
//! ```text
//! C = sum_b C_b,    C_b(d) = sum of a(x) b(x + d) over x + d / 2 in block b        images moved by the guide: the peak is at d = 0
//! theta_b = place of the peak of C - C_b
//! s^2 = (n - 1) / n sum_b (theta_b - mean theta)^2
//! ```
//! It holds whatever differs from block to block: particles at random places in a flow that varies over the window, particles that leave,
//! overlapping images, noise of the sensor. It does not hold what they have in common: the flow averaged over the window instead of taken in
//! its middle.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | d | `dx`, `dy` | px | shift, within +- [`REACH`] |
//! | C_b | `blocks` | 1 | parts of the correlation |
//! | s | the result | px | standard deviation along x and y |
//!
//! Sources: Efron and Stein, Ann. Stat. 9 (1981) 586 (jackknife); Wieneke, Meas. Sci. Technol. 26 (2015) 074002 (uncertainty of a displacement from
//! the correlation's own parts). Not valid for windows with a handful of particles: a block without which there is no peak gives none.

use super::correlate::Dewarped;
use super::lattice::Lattice;
use super::peak::CorrelationMap;
use rayon::prelude::*;

/// Shifts about the peak, px: those that its fit uses, with the maximum one beside the middle.
const REACH: isize = 4;
/// Shifts along one axis.
const SIDE: usize = 2 * REACH as usize + 1;
/// Side of a block at least, px: larger than the image of a particle.
const BLOCK_PX: usize = 8;
/// Blocks along a side at least and at most.
const BLOCKS: [usize; 2] = [2, 8];

/// Standard deviations along x and y, px, of every window; none where the peak does not stand without each of its blocks.
pub(super) fn scatter(moments: &[Dewarped], width: usize, lattice: &Lattice) -> Vec<Option<[f64; 2]>> {
    (0..lattice.len()).into_par_iter().map(|k| window(moments, width, lattice, k)).collect()
}

fn window(moments: &[Dewarped], width: usize, lattice: &Lattice, k: usize) -> Option<[f64; 2]> {
    let blocks = blocks(moments, width, lattice, k);
    let whole: Vec<f64> = (0..SIDE * SIDE).map(|s| blocks.iter().map(|b| b[s]).sum()).collect();
    let w = lattice.window_px as f64;
    // As the correlation itself: without the bias towards no shift.
    let place = |values: &dyn Fn(usize) -> f64| {
        let even = |s: usize| {
            let [dx, dy] = [s % SIDE, s / SIDE].map(|i| (i as isize - REACH).unsigned_abs() as f64);
            values(s) / ((w - dx) * (w - dy))
        };
        let map = CorrelationMap { width: SIDE, height: SIDE, values: (0..SIDE * SIDE).map(even).collect() };
        map.peak(1).map(|p| p.shift_px)
    };
    let without: Option<Vec<_>> =
        blocks.iter().filter(|b| b.iter().any(|c| *c != 0.0)).map(|b| place(&|s| whole[s] - b[s])).collect();
    let without = without.filter(|w| w.len() >= 4)?;
    let n = without.len() as f64;
    Some([0, 1].map(|a| {
        let mean = without.iter().map(|p| p[a]).sum::<f64>() / n;
        ((n - 1.0) / n * without.iter().map(|p| (p[a] - mean).powi(2)).sum::<f64>()).sqrt()
    }))
}

/// What each block of each moment contributes to the correlation about no shift.
fn blocks(moments: &[Dewarped], width: usize, lattice: &Lattice, k: usize) -> Vec<Vec<f64>> {
    let (w, [column, row]) = (lattice.window_px, lattice.corner(k));
    let per_side = (w / BLOCK_PX).clamp(BLOCKS[0], BLOCKS[1]);
    let mut out = vec![vec![0.0; SIDE * SIDE]; moments.len() * per_side * per_side];
    for (m, moment) in moments.iter().enumerate() {
        let place = |i: usize| (row + i / w) * width + column + i % w;
        let normal =
            moment.levels.each_ref().map(|l| normalised((0..w * w).map(|i| (l[place(i)], moment.seen[place(i)]))));
        let [Some(a), Some(b)] = normal else { continue };
        for (s, (dy, dx)) in (-REACH..=REACH).flat_map(|dy| (-REACH..=REACH).map(move |dx| (dy, dx))).enumerate() {
            let ends = |d: isize| (d.min(0).unsigned_abs(), w - d.max(0).unsigned_abs());
            let ((x0, x1), (y0, y1)) = (ends(dx), ends(dy));
            // Twice the middle of both, over twice the side of a block.
            let block = |p: usize, d: isize| ((2 * p as isize + d) as usize * per_side) / (2 * w);
            for y in y0..y1 {
                let (of_a, of_b) = (y * w, (y as isize + dy) as usize * w);
                for x in x0..x1 {
                    let to = (m * per_side + block(y, dy)) * per_side + block(x, dx);
                    out[to][s] += a[of_a + x] * b[of_b + (x as isize + dx) as usize];
                }
            }
        }
    }
    out
}

/// Less the mean, over the standard deviation, 0 where not seen; none for an empty window.
fn normalised(levels: impl Iterator<Item = (f32, bool)> + Clone) -> Option<Vec<f64>> {
    let seen = || levels.clone().filter(|(_, s)| *s).map(|(l, _)| f64::from(l));
    let n = seen().count().max(1) as f64;
    let mean = seen().sum::<f64>() / n;
    let sigma = (seen().map(|l| (l - mean).powi(2)).sum::<f64>() / n).sqrt();
    (sigma > 0.0).then(|| levels.map(|(l, s)| if s { (f64::from(l) - mean) / sigma } else { 0.0 }).collect())
}
