//! Particle images made ready for correlation: background taken off, bright outliers capped, saturation counted; all of that where they are seen.

use crate::error::{Insufficient, Result};
use crate::image::GrayView;

/// Half width of the box whose mean is the background of particle images, px.
pub(super) const BACKGROUND_PX: usize = 8;
/// Brightness above this quantile is capped: a few large particles would outvote all others.
const CAP: f64 = 0.998;
/// More equal brightest pixels than this part of an image are saturation.
pub(super) const SATURATED: f64 = 1e-3;
/// Beyond this part nothing can be measured.
const ALL_SATURATED: f64 = 0.2;

/// Part of the pixels that have the image's largest value, of those that may be used (rows packed; all where it is not said).
///
/// # Errors
/// [`Insufficient::Degenerate`] where the image is flat or mostly saturated.
pub(super) fn saturated_part(view: &GrayView<'_>, used: Option<&[bool]>, name: &str) -> Result<f64> {
    let mut row = vec![];
    let mut over_used = |each: &mut dyn FnMut(f32)| {
        for v in 0..view.height() {
            view.row(v, &mut row);
            let used = used.map(|used| &used[v * view.width()..]);
            row.iter().enumerate().filter(|(u, _)| used.is_none_or(|used| used[*u])).for_each(|(_, g)| each(*g));
        }
    };
    let (mut low, mut high, mut count) = (f32::INFINITY, f32::NEG_INFINITY, 0.0);
    over_used(&mut |g| (low, high, count) = (low.min(g), high.max(g), count + 1.0));
    if !(high > low) {
        let what =
            format!("{name}: the image is flat (every pixel is {high}); check the exposure and that the laser fired");
        return Err(Insufficient::Degenerate(what).into());
    }
    let mut equal = 0.0;
    over_used(&mut |g| equal += f64::from(u8::from(g == high)));
    let part = equal / count;
    let end = view.may_saturate_at(high);
    if end && part > ALL_SATURATED {
        let what = format!(
            "{name}: {:.0} % of the pixels are saturated (at {high}); no particle can be told from another: reduce laser power or aperture",
            100.0 * part
        );
        return Err(Insufficient::Degenerate(what).into());
    }
    Ok(if end { part } else { 0.0 })
}

/// Mean of a row or column over a sliding box, which ends where the line does.
fn sliding(line: &[f32], out: &mut [f32], half: usize) {
    let n = line.len();
    let mut sum = 0.0_f64;
    let (mut from, mut to) = (0, 0);
    for i in 0..n {
        let (a, b) = (i.saturating_sub(half), (i + half + 1).min(n));
        while to < b {
            sum += f64::from(line[to]);
            to += 1;
        }
        while from < a {
            sum -= f64::from(line[from]);
            from += 1;
        }
        out[i] = (sum / (b - a) as f64) as f32;
    }
}

/// Mean over a box around every pixel.
fn box_mean(levels: &[f32], width: usize, half: usize) -> Vec<f32> {
    let height = levels.len() / width;
    let mut rows = vec![0.0; levels.len()];
    for (row, out) in levels.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        sliding(row, out, half);
    }
    let (mut line, mut out) = (vec![0.0; height], vec![0.0; height]);
    for u in 0..width {
        (0..height).for_each(|v| line[v] = rows[v * width + u]);
        sliding(&line, &mut out, half);
        (0..height).for_each(|v| rows[v * width + u] = out[v]);
    }
    rows
}

/// Particles alone: what is above the mean of what is seen in the box that reaches `background_px` to all sides, capped; 0 where nothing is seen.
pub(super) fn particles(levels: &mut [f32], seen: &[bool], width: usize, background_px: usize) {
    let unseen = seen.contains(&false);
    if unseen {
        levels.iter_mut().zip(seen).filter(|(_, seen)| !**seen).for_each(|(l, _)| *l = 0.0);
    }
    let mut mean = box_mean(levels, width, background_px);
    if unseen {
        let part: Vec<f32> = seen.iter().map(|s| f32::from(u8::from(*s))).collect();
        let part = box_mean(&part, width, background_px);
        mean.iter_mut().zip(part.iter().zip(seen)).filter(|(_, (_, seen))| **seen).for_each(|(m, (p, _))| *m /= p);
    }
    let above = |(l, m, s): (&f32, &f32, &bool)| if *s { (l - m).max(0.0) } else { 0.0 };
    (0..levels.len()).for_each(|i| levels[i] = above((&levels[i], &mean[i], &seen[i])));
    let step = (levels.len() / 100_000).max(1);
    let looked_at = levels.iter().zip(seen).step_by(step);
    let mut looked_at: Vec<f32> = looked_at.filter(|(_, seen)| **seen).map(|(l, _)| *l).collect();
    looked_at.sort_by(f32::total_cmp);
    let cap = looked_at.get((looked_at.len().saturating_sub(1) as f64 * CAP) as usize).copied().unwrap_or(0.0);
    if cap > 0.0 {
        levels.iter_mut().for_each(|l| *l = l.min(cap));
    }
}

/// The grey levels of an image.
pub(super) fn levels(view: &GrayView<'_>) -> Vec<f32> {
    (0..view.height()).flat_map(|v| (0..view.width()).map(move |u| view.get(u, v))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Samples;

    #[test]
    fn box_mean_is_the_mean_of_the_box() {
        let (w, h, half) = (9, 7, 2);
        let levels: Vec<f32> = (0..w * h).map(|i| ((i * 37) % 23) as f32).collect();
        let mean = box_mean(&levels, w, half);
        for v in 0..h {
            for u in 0..w {
                let (us, vs) =
                    (u.saturating_sub(half)..(u + half + 1).min(w), v.saturating_sub(half)..(v + half + 1).min(h));
                let n = us.len() * vs.len();
                let sum: f32 = vs.map(|b| us.clone().map(|a| levels[b * w + a]).sum::<f32>()).sum();
                assert!((mean[v * w + u] - sum / n as f32).abs() < 1e-4);
            }
        }
    }

    /// Ground of any height beside what is not seen is no particle.
    #[test]
    fn the_rim_of_what_is_seen_is_no_particle() {
        let (w, h) = (40, 30);
        let seen: Vec<bool> = (0..w * h).map(|i| i % w > 12 || i / w > 20).collect();
        for ground in [0.0, 1000.0] {
            let mut levels = vec![ground; w * h];
            let particle = [10 * w + 30, 4 * w + 36, 25 * w + 2];
            particle.iter().for_each(|i| levels[*i] += 50.0);
            particles(&mut levels, &seen, w, 8);
            for (i, l) in levels.iter().enumerate() {
                assert!(if particle.contains(&i) { *l > 40.0 } else { *l < 0.5 }, "{ground} {i}: {l}");
            }
        }
        let mut none = vec![3.0; w * h];
        particles(&mut none, &vec![false; w * h], w, 8);
        assert!(none.iter().all(|l| *l == 0.0));
    }

    #[test]
    fn saturation_and_flat_images_are_told() {
        let part = |data: &[u8]| saturated_part(&GrayView::new(Samples::U8(data), 10, 10, 10).unwrap(), None, "a.tif");
        assert!(part(&[7; 100]).unwrap_err().to_string().contains("a.tif: the image is flat"));
        let mut data = [3; 100];
        data[..30].fill(255);
        assert!(part(&data).unwrap_err().to_string().contains("30 % of the pixels are saturated (at 255)"));
        data[2..30].fill(9);
        assert_eq!(part(&data).unwrap(), 0.02);
        data[..2].fill(90);
        assert_eq!(part(&data).unwrap(), 0.0);
        // A flare that is left out.
        data[..50].fill(255);
        let used: Vec<bool> = (0..100).map(|i| i >= 50).collect();
        let view = GrayView::new(Samples::U8(&data), 10, 10, 10).unwrap();
        assert!(
            saturated_part(&view, Some(&used), "a.tif")
                .unwrap_err()
                .to_string()
                .contains("the image is flat (every pixel is 3)")
        );
        data[60] = 90;
        let view = GrayView::new(Samples::U8(&data), 10, 10, 10).unwrap();
        assert_eq!(saturated_part(&view, Some(&used), "a.tif").unwrap(), 0.0);
    }
}
