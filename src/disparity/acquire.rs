//! A first, coarse plane: the one on which both images are most alike.
//!
//! Both images are dewarped on planes z = const, binned so far that neighbouring planes differ by about a pixel of disparity, and
//! multiplied. Every block of the field has then a likeness L_b(z), less its mean over the planes on which both cameras see it;
//! ```text
//! worth(z0, tx, ty) = sum_b L_b(z0 + tx X_b + ty Y_b),     noise^2 = sum_b mean L_b(z)^2
//! ```
//! The best of all planes wins where it is worth more than chance gives. Likenesses have long tails: a root mean square holds them, a median does not.

use super::masks::{Mask, eroded, set_at};
use super::prepare::{BACKGROUND_PX, particles};
use crate::dewarp::{Kernel, Sampler, SheetGrid, SheetMap};
use crate::image::{GrayView, Samples};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Pixels along the larger side of the coarse field.
const COARSE_PX: usize = 320;
/// Side of a block, coarse px.
const BLOCK_PX: usize = 16;
/// Tilted planes reach beyond the search at the ends of the field, by this factor; blocks that leave it abstain.
const BEYOND: f64 = 1.5;
/// Steepest tilt that is tried, mm per mm (8 degrees).
const STEEPEST: f64 = 0.14;
/// Most planes z = const.
pub(super) const MOST_PLANES: usize = 600;
/// Fewest planes on which both cameras see a block that takes part.
const FEWEST_PLANES: usize = 3;
/// Distance of the planes: so much disparity between neighbours, coarse px.
const STEP_PX: f64 = 0.8;
/// The best plane must stand out from chance by this many standard deviations.
pub(super) const SIGNIFICANT: f64 = 7.0;

/// One image, binned.
pub(super) struct Binned {
    sampler: Sampler,
    factor: usize,
    size_px: [usize; 2],
    /// Where interpolation meets nothing that the mask leaves out.
    clear: Option<Vec<bool>>,
}

impl Binned {
    /// Particles of an image, averaged over squares of `factor` px.
    pub(super) fn new(levels: &[f32], size_px: [usize; 2], factor: usize, mask: Option<&Mask>) -> Option<Self> {
        let [w, h] = size_px.map(|n| n / factor);
        // The other camera may see the field far more finely.
        if w == 0 || h == 0 {
            return None;
        }
        let mut out = vec![0.0; w * h];
        for v in 0..h * factor {
            for u in 0..w * factor {
                out[(v / factor) * w + u / factor] += levels[v * size_px[0] + u];
            }
        }
        let used = mask.map(|m| m.binned([w, h], factor));
        particles(&mut out, used.as_ref().unwrap_or(&vec![true; w * h]), w, BACKGROUND_PX);
        let view = GrayView::new(Samples::F32(&out), w, h, w).ok()?;
        let clear = used.map(|used| eroded(&used, w, 1));
        Some(Self { sampler: Sampler::new(&view, Kernel::Linear), factor, size_px: [w, h], clear })
    }

    fn at(&self, q: &Vector2<f64>) -> Option<f32> {
        let f = self.factor as f64;
        let b = Vector2::new((q.x + 0.5) / f - 0.5, (q.y + 0.5) / f - 0.5);
        let inside =
            b.x >= 0.0 && b.y >= 0.0 && b.x <= (self.size_px[0] - 1) as f64 && b.y <= (self.size_px[1] - 1) as f64;
        let clear = || self.clear.as_ref().is_none_or(|clear| set_at(clear, self.size_px[0], &b));
        (inside && clear()).then(|| self.sampler.at(b.x, b.y))
    }
}

/// The plane found: `z = a + b X + c Y` in the frame of the maps, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Acquired {
    pub(super) plane: Vector3<f64>,
    /// How far it stands out from chance, standard deviations.
    pub(super) significance: f64,
}

/// Factor by which images are binned for a field of this size.
pub(super) fn factor(grid: &SheetGrid) -> usize {
    grid.width_px.max(grid.height_px).div_ceil(COARSE_PX).max(1)
}

struct Block {
    middle_mm: Vector2<f64>,
    /// Likeness on each plane less its mean over the planes; `NaN` where too little of the block is seen by both.
    likeness: Vec<f64>,
}

/// Distance of the planes, mm: that of a coarse pixel of disparity in the middle of the field; none where that is not seen.
fn step_mm(maps: [&SheetMap; 2], coarse: &SheetGrid) -> Option<f64> {
    let [x0, y0, x1, y1] = coarse.extent_mm();
    let middle = Vector2::new(0.5 * (x0 + x1), 0.5 * (y0 + y1));
    let slope = |m: &SheetMap| m.project(&middle.push(0.0)).and_then(|q| m.hit(&q, 0.0)).map(|h| h.slope);
    Some(STEP_PX * coarse.mm_per_px / (slope(maps[1])? - slope(maps[0])?).norm().max(1e-3))
}

/// The furthest search, mm: beyond it planes a pixel of disparity apart are too many.
pub(super) fn furthest_mm(maps: [&SheetMap; 2], grid: &SheetGrid) -> Option<f64> {
    Some(step_mm(maps, &grid.coarser(factor(grid)))? * MOST_PLANES as f64 / (2.0 * BEYOND))
}

/// Looks for the plane within +- `search_mm` of the field's middle.
pub(super) fn acquire(
    maps: [&SheetMap; 2],
    moments: &[[Binned; 2]],
    grid: &SheetGrid,
    search_mm: f64,
) -> Option<Acquired> {
    let coarse = grid.coarser(factor(grid));
    let [x0, y0, x1, y1] = coarse.extent_mm();
    let middle = Vector2::new(0.5 * (x0 + x1), 0.5 * (y0 + y1));
    let half = 0.5 * (x1 - x0).max(y1 - y0);
    let reach = BEYOND * search_mm;
    let step = step_mm(maps, &coarse)?;
    let planes = (2.0 * reach / step).ceil() as usize + 1;
    let z_of = |k: usize| (k as f64 - 0.5 * (planes - 1) as f64) * step;
    let columns = coarse.width_px / BLOCK_PX;
    let rows = coarse.height_px / BLOCK_PX;
    let sums: Vec<Vec<[f64; 4]>> =
        (0..planes).into_par_iter().map(|k| plane_sums(maps, moments, &coarse, z_of(k), [columns, rows])).collect();
    let blocks: Vec<Block> = (0..columns * rows)
        .filter_map(|b| {
            let centre = |i: usize| (i * BLOCK_PX) as f64 + 0.5 * (BLOCK_PX - 1) as f64;
            let [x, y] = coarse.point_mm(centre(b % columns), centre(b / columns));
            let mut likeness: Vec<f64> = sums
                .iter()
                .map(|s| {
                    let [ab, aa, bb, seen] = s[b];
                    let enough = seen > 0.5 * (BLOCK_PX * BLOCK_PX * moments.len()) as f64;
                    if enough && aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { f64::NAN }
                })
                .collect();
            let known: Vec<f64> = likeness.iter().copied().filter(|l| l.is_finite()).collect();
            let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
            likeness.iter_mut().for_each(|l| *l -= mean);
            (known.len() >= FEWEST_PLANES).then(|| Block { middle_mm: Vector2::new(x, y) - middle, likeness })
        })
        .collect();
    best_plane(&blocks, planes, step, search_mm, half, middle)
}

/// Sums of products per block on one plane: ab, aa, bb, pixels seen by both.
fn plane_sums(
    maps: [&SheetMap; 2],
    moments: &[[Binned; 2]],
    grid: &SheetGrid,
    z_mm: f64,
    [columns, rows]: [usize; 2],
) -> Vec<[f64; 4]> {
    let mut out = vec![[0.0; 4]; columns * rows];
    for j in 0..rows * BLOCK_PX {
        for i in 0..columns * BLOCK_PX {
            let [x, y] = grid.point_mm(i as f64, j as f64);
            let p = Vector3::new(x, y, z_mm);
            let (Some(q0), Some(q1)) = (maps[0].project(&p), maps[1].project(&p)) else { continue };
            let block = &mut out[(j / BLOCK_PX) * columns + i / BLOCK_PX];
            for m in moments {
                if let (Some(a), Some(b)) = (m[0].at(&q0), m[1].at(&q1)) {
                    let (a, b) = (f64::from(a), f64::from(b));
                    *block = [block[0] + a * b, block[1] + a * a, block[2] + b * b, block[3] + 1.0];
                }
            }
        }
    }
    out
}

fn best_plane(
    blocks: &[Block],
    planes: usize,
    step: f64,
    search_mm: f64,
    half_mm: f64,
    middle: Vector2<f64>,
) -> Option<Acquired> {
    // Neighbouring tilts differ by one plane at the end of the field.
    let tilt_step = step / half_mm;
    let tilts = (STEEPEST / tilt_step).ceil() as i64;
    let offsets = (search_mm / step).floor() as i64;
    let centre = 0.5 * (planes - 1) as f64;
    // What chance gives; the true peak, on one plane of many, hardly adds to it.
    let mean_square = |b: &Block| {
        let (sum, n) = b.likeness.iter().filter(|l| l.is_finite()).fold((0.0, 0.0), |(s, n), l| (s + l * l, n + 1.0));
        sum / n
    };
    let noise = blocks.iter().map(mean_square).sum::<f64>().sqrt();
    let score = |z0: f64, tx: f64, ty: f64| -> f64 {
        blocks
            .iter()
            .map(|b| {
                let at = centre + z0 + (tx * b.middle_mm.x + ty * b.middle_mm.y) / half_mm;
                let k = at.floor();
                if k < 0.0 || k as usize + 1 >= planes {
                    return 0.0;
                }
                let t = at - k;
                let between = b.likeness[k as usize] * (1.0 - t) + b.likeness[k as usize + 1] * t;
                if between.is_finite() { between } else { 0.0 }
            })
            .sum()
    };
    let rows: Vec<(f64, [f64; 3])> = (-tilts..=tilts)
        .into_par_iter()
        .map(|tx| {
            let mut best = (f64::NEG_INFINITY, [0.0; 3]);
            for ty in -tilts..=tilts {
                for z0 in -offsets..=offsets {
                    let s = score(z0 as f64, tx as f64, ty as f64);
                    if s > best.0 {
                        best = (s, [z0 as f64, tx as f64, ty as f64]);
                    }
                }
            }
            best
        })
        .collect();
    let (top, [z0, tx, ty]) =
        rows.into_iter().fold((f64::NEG_INFINITY, [0.0; 3]), |a, b| if b.0 > a.0 { b } else { a });
    if !(top.is_finite() && noise > 0.0) {
        return None;
    }
    let (b, c) = (tx * tilt_step, ty * tilt_step);
    Some(Acquired { plane: Vector3::new(z0 * step - b * middle.x - c * middle.y, b, c), significance: top / noise })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_smaller_than_a_coarse_pixel_show_nothing() {
        assert!(Binned::new(&[1.0; 63], [9, 7], 10, None).is_none());
        assert!(Binned::new(&[1.0; 63], [9, 7], 2, None).is_some());
    }
}
