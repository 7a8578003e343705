//! From a rough ellipse to independent edge points with honest sigmas.
//!
//! 1. Fit the blurred-edge model ([`crate::detect::edge_model`]) to the grey values in a band around the ellipse.
//! 2. Cut the band into sectors of about 1.75 px of contour; each pixel belongs to exactly one, so the sectors are independent.
//! 3. In each sector solve for the shift of the edge along the normal, levels and blur fixed: with residual `r`, weight `w` and response
//!    `h = d(model)/d(shift)`, `shift = sum w r h / sum w h^2`, `sigma = (sum w h^2)^(-1/2)` (its Fisher information).
//! 4. Drop sectors that disagree (glare, shadow, another object), fit again without their pixels.
//! 5. The disc's ellipse is the geometric fit through these edge points; where they scatter more than the grey noise says (rough
//!    prints, speckle), one variance is added to all until chi2 is the number of degrees of freedom.
//!
//! Levels, blur and slopes are common to all sectors; what their uncertainty adds to the geometry is spread evenly over the sigmas.

use crate::conic::{Ellipse, fit_geometric_from};
use crate::detect::band::{Band, Reach};
use crate::detect::edge_model::{EdgeModel, Levels, Normal, turn_share};
use crate::detect::{DetectOptions, Disc, EdgePoints, RejectionReason};
use crate::image::{GrayView, Samples};
use crate::target::Polarity;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;

/// Length of contour per edge point, px.
const SECTOR_PX: f64 = 1.75;
/// Pixels that suffice while the ellipse is still being approached.
const ROUGH_PIXELS: usize = 250;
/// A step of the whole model below this ends the descent, px: the sectors take the last step, their error is of second order.
const FINE_PX: f64 = 0.02;
/// The same where the levels vary from node to node: the sectors hold them, so they must have settled.
const FINE_SPLINE_PX: f64 = 0.002;
/// Entries of the table from eccentric angle to arc length.
const ARC_STEPS: usize = 256;

/// Buffers reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    band: Band,
    normal: Normal,
    sectors: Sectors,
    sorted: Vec<f64>,
}

/// A disc to refine.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub(crate) ellipse: Ellipse,
    pub(crate) blur_px: f64,
    pub(crate) bright: bool,
    /// How far the band may reach without meeting another edge, px.
    pub(crate) room: Reach,
}

/// Sums per sector, structure of arrays.
#[derive(Debug, Default)]
struct Sectors {
    of_pixel: Vec<u32>,
    score: Vec<f64>,
    information: Vec<f64>,
    angle_sum: Vec<f64>,
    misfit: Vec<f64>,
    pixels: Vec<u32>,
    keep: Vec<bool>,
    middle_angle: Vec<f64>,
}

/// Refines one disc, or says why it is none.
pub(crate) fn refine(
    view: &GrayView,
    start: &Start,
    options: &DetectOptions,
    scratch: &mut Scratch,
) -> Result<Disc, RejectionReason> {
    let mut model = rough_model(view, start, scratch)?;
    fine_model(view, start, &mut model, scratch)?;
    check_size(&model, start, options)?;
    let mut before = 1.0;
    for _ in 0..3 {
        assign_sectors(&model, scratch);
        let coverage = drop_sectors(scratch);
        if coverage < options.min_coverage {
            return Err(RejectionReason::Incomplete { coverage });
        }
        // Few sectors more or less do not move a fit that they were not pulling.
        if coverage > before - 0.03 {
            break;
        }
        before = coverage;
        estimate_variance(view, &mut model, scratch);
        descend(&mut model, scratch, 1, 1, FINE_PX)?;
    }
    finish(&model, start, options, scratch)
}

fn not_elliptical(model_rms_px: f64, limit_px: f64) -> RejectionReason {
    RejectionReason::NotElliptical { rms_px: model_rms_px, limit_px }
}

fn descend(
    model: &mut EdgeModel,
    s: &mut Scratch,
    rounds: usize,
    stride: usize,
    tolerance_px: f64,
) -> Result<(), RejectionReason> {
    model
        .descend(&mut s.band, &mut s.normal, rounds, stride, tolerance_px)
        .ok_or_else(|| not_elliptical(f64::INFINITY, model.ellipse.semi_minor_px))
}

/// First-harmonic levels (light falls off over the disc), narrow band: brings the ellipse within a fraction of the blur.
fn rough_model(view: &GrayView, start: &Start, s: &mut Scratch) -> Result<EdgeModel, RejectionReason> {
    let wanted = 2.5 * start.blur_px + 1.0;
    let reach = Reach { inner_px: wanted.min(start.room.inner_px), outer_px: wanted.min(start.room.outer_px.max(1.5)) };
    s.band.collect(view, &start.ellipse, reach, f64::INFINITY);
    screen(&start.ellipse, s);
    if s.band.u.len() < 20 {
        return Err(RejectionReason::TooSmall { semi_minor_px: start.ellipse.semi_minor_px });
    }
    let mut sums = [(0.0, 0.0); 2];
    let kept = s.band.keep.iter();
    for ((d, g), _) in s.band.distance.iter().zip(&s.band.grey).zip(kept).filter(|(_, keep)| **keep) {
        let side = &mut sums[usize::from(*d > 0.0)];
        *side = (side.0 + g, side.1 + 1.0);
    }
    let mean = |x: (f64, f64)| x.0 / f64::max(x.1, 1.0);
    let (inner, outer) = (mean(sums[0]), mean(sums[1]));
    let mut model = EdgeModel::new(&start.ellipse, start.blur_px, inner, outer);
    model.set_levels([Levels::Harmonic; 2], [0.0; 2]);
    // Weights in units of the contrast keep the damping meaningful for any bit depth.
    let unit = ((inner - outer) * 0.05).powi(2).max(1e-12);
    model.variance = [unit, unit];
    let stride = (s.band.u.len() / ROUGH_PIXELS).max(1) | 1;
    descend(&mut model, s, 12, stride, 0.02)?;
    if (model.step() > 0.0) != start.bright {
        return Err(RejectionReason::LowContrast { contrast_to_noise: 0.0 });
    }
    Ok(model)
}

/// Wide band, level model as rich as the image asks, noise from residuals.
fn fine_model(view: &GrayView, start: &Start, model: &mut EdgeModel, s: &mut Scratch) -> Result<(), RejectionReason> {
    for pass in 0..3 {
        let reach = fine_reach(model, start);
        let before = model.ellipse;
        if border_px(view, &model.ellipse) < 1.0 {
            return Err(RejectionReason::CutByBorder);
        }
        s.band.collect(view, &model.ellipse, reach, 3.8 * model.blur_px + 0.5);
        screen(&model.ellipse, s);
        if pass == 0 {
            model.set_levels([Levels::Constant; 2], [0.0; 2]);
            model.evaluate(&mut s.band, None, 1);
            let stride = (s.band.u.len() / ROUGH_PIXELS).max(1) | 1;
            estimate_variance(view, model, s);
            choose_levels(view, model, s);
            if model.levels != [Levels::Constant; 2] {
                model.fit_levels(&mut s.band, &mut s.normal, if model.has_splines() { 1 } else { stride });
            }
            estimate_variance(view, model, s);
            model.sloped = [shows_slope(model, s, 0), shows_slope(model, s, 1)];
            if model.has_splines() {
                // Another, narrower band serves these; the ellipse is as good as this one can make it.
                continue;
            }
        }
        let tolerance_px = if model.has_splines() { FINE_SPLINE_PX } else { FINE_PX };
        descend(model, s, 6, 1, tolerance_px)?;
        estimate_variance(view, model, s);
        let moved = (before.center_px.u_px - model.ellipse.center_px.u_px)
            .hypot(before.center_px.v_px - model.ellipse.center_px.v_px)
            .max((before.semi_major_px - model.ellipse.semi_major_px).abs())
            .max((before.semi_minor_px - model.ellipse.semi_minor_px).abs());
        // The band was laid around a place this close; its pixels are the right ones.
        if moved < 0.15 {
            break;
        }
    }
    Ok(())
}

/// Band of the fine fit: the edge, and beside it what fixes the levels; close to the edge where they vary along it.
fn fine_reach(model: &EdgeModel, start: &Start) -> Reach {
    let core = 3.0 * model.blur_px + 0.7;
    let beside = if model.has_splines() { 1.0 } else { (2.0 * model.blur_px).max(3.0) };
    Reach {
        inner_px: (core + beside).min(start.room.inner_px).min(0.85 * model.ellipse.semi_minor_px),
        outer_px: (core + beside).min(start.room.outer_px.max(1.5)),
    }
}

/// Sets aside stretches of the contour without the step that the others show (glare, another object): a descent would follow them.
fn screen(e: &Ellipse, s: &mut Scratch) {
    let stretches = ((e.perimeter_px() / 6.0) as usize).clamp(6, 200);
    let mut sums = vec![[(0.0_f64, 0.0_f64); 2]; stretches];
    let of = |angle: f64| ((turn_share(angle) * stretches as f64) as usize).min(stretches - 1);
    for i in 0..s.band.u.len() {
        let d = s.band.distance[i];
        let near = d.abs() > 0.5;
        if near {
            let sum = &mut sums[of(s.band.angle[i])][usize::from(d > 0.0)];
            *sum = (sum.0 + s.band.grey[i], sum.1 + 1.0);
        }
    }
    let step = |x: &[(f64, f64); 2]| x[0].0 / x[0].1.max(1.0) - x[1].0 / x[1].1.max(1.0);
    s.sorted.clear();
    s.sorted.extend(sums.iter().map(step));
    let typical = median(&mut s.sorted);
    let alike: Vec<bool> = sums.iter().map(|x| (0.35..2.8).contains(&(step(x) / typical))).collect();
    // Where hardly any stretch shows the step the start is bad, and a selection would only fix its error.
    if alike.iter().filter(|a| **a).count() * 2 < stretches {
        return;
    }
    for i in 0..s.band.u.len() {
        s.band.keep[i] = alike[of(s.band.angle[i])];
    }
}

/// Least distance of the ellipse from the outermost pixel centres, px; negative where it leaves the image.
fn border_px(view: &GrayView, e: &Ellipse) -> f64 {
    let (s, c) = e.angle_rad.sin_cos();
    let half_width = (e.semi_major_px * c).hypot(e.semi_minor_px * s);
    let half_height = (e.semi_major_px * s).hypot(e.semi_minor_px * c);
    let (u, v) = (e.center_px.u_px, e.center_px.v_px);
    let (u_last, v_last) = (view.width() as f64 - 1.0, view.height() as f64 - 1.0);
    (u - half_width).min(u_last - u - half_width).min(v - half_height).min(v_last - v - half_height)
}

fn check_size(model: &EdgeModel, start: &Start, options: &DetectOptions) -> Result<(), RejectionReason> {
    let (e, e0) = (&model.ellipse, &start.ellipse);
    if e.semi_minor_px < options.min_semi_minor_px {
        return Err(RejectionReason::TooSmall { semi_minor_px: e.semi_minor_px });
    }
    let shift = (e.center_px.u_px - e0.center_px.u_px).hypot(e.center_px.v_px - e0.center_px.v_px);
    let limit_px = 0.5 * e0.semi_minor_px + 1.0;
    let gap = shift.max((e.semi_major_px - e0.semi_major_px).abs()).max((e.semi_minor_px - e0.semi_minor_px).abs());
    if gap > limit_px || model.blur_px > 0.9 * e.semi_minor_px {
        return Err(not_elliptical(gap.max(model.blur_px), limit_px));
    }
    let noise = (0.5 * (model.variance[0] + model.variance[1])).sqrt();
    let contrast_to_noise = model.step().abs() / noise;
    if (model.step() > 0.0) != start.bright || contrast_to_noise < options.min_contrast_to_noise {
        return Err(RejectionReason::LowContrast { contrast_to_noise });
    }
    Ok(())
}

/// Smallest noise variance that samples of this kind can have, grey^2.
fn quantisation(view: &GrayView) -> f64 {
    match view.samples() {
        Samples::U8(_) | Samples::U16(_) => 1.0 / 12.0,
        Samples::F32(_) => 0.0,
    }
}

/// Noise variance inside and outside from the residuals away from the edge.
fn estimate_variance(view: &GrayView, model: &mut EdgeModel, s: &mut Scratch) {
    let mut found = [None; 2];
    for (side, found) in found.iter_mut().enumerate() {
        let mut squares = 0.0;
        s.sorted.clear();
        for i in 0..s.band.u.len() {
            let p = s.band.inside[i];
            let away = if side == 0 { p > 0.97 } else { p < 0.03 };
            if away && s.band.keep[i] {
                s.sorted.push(s.band.residual[i].abs());
                squares += s.band.residual[i].powi(2);
            }
        }
        if s.sorted.len() < 8 {
            continue;
        }
        let median = median(&mut s.sorted);
        // A few glints must not make the rest look noisy, a few odd values on a clipped ground must still count.
        let clip = (5.0 * 1.4826 * median).max(0.05 * model.step().abs());
        let clipped: f64 = s.sorted.iter().map(|r| r.min(clip).powi(2)).sum();
        *found = Some(clipped.min(squares) / s.sorted.len() as f64);
    }
    let (inner, outer) = match (found[0], found[1]) {
        (Some(a), Some(b)) => (a, b),
        (Some(a), None) | (None, Some(a)) => (a, a),
        (None, None) => {
            let kept = s.band.keep.iter().filter(|k| **k).count().max(1) as f64;
            let sum: f64 = s.band.residual.iter().zip(&s.band.keep).filter(|(_, k)| **k).map(|(r, _)| r * r).sum();
            (sum / kept, sum / kept)
        }
    };
    model.variance = not_too_sure(view, model, [inner, outer]);
}

/// Variances not below the quantisation, nor far apart: a clipped ground has no noise at all, yet it must not outweigh the flank
/// of the edge.
fn not_too_sure(view: &GrayView, model: &EdgeModel, found: [f64; 2]) -> [f64; 2] {
    let floor = quantisation(view).max((1e-4 * model.step()).powi(2));
    let least = floor.max(found[0].max(found[1]) / 16.0);
    found.map(|x| x.max(least))
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Residuals away from the edge in one stretch of the contour, on one side.
#[derive(Debug, Clone, Copy, Default)]
struct Stretch {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Stretch {
    fn mean(&self) -> f64 {
        self.sum / self.count
    }
}

/// The poorest level model that the residuals away from the edge do not contradict, for either side.
/// With it the noise variance that is left when the levels follow the image.
fn choose_levels(view: &GrayView, model: &mut EdgeModel, s: &Scratch) {
    let perimeter = model.ellipse.perimeter_px();
    let mut chosen = [Levels::Constant; 2];
    let mut gradient = [0.0; 2];
    let mut noise = model.variance;
    for side in 0..2 {
        // A narrow band leaves few pixels away from the edge: fewer nodes then, but never an untested side.
        let mut nodes = EdgeModel::nodes_for(perimeter);
        let mut seen = stretches(s, side, nodes);
        while seen.len() * 10 < nodes * 6 && nodes > 5 {
            nodes = (nodes / 2).max(5);
            seen = stretches(s, side, nodes);
        }
        if seen.len() < 4 {
            // On a small disc a gradient of the levels and a shift of the centre look alike; a large one can bear it.
            chosen[side] = if perimeter > 40.0 { Levels::Harmonic } else { Levels::Constant };
            continue;
        }
        // Scatter within the stretches only: what varies between them is what is asked for.
        let freedom: f64 = seen.iter().map(|x| x.1.count - 1.0).sum();
        let scatter: f64 = seen.iter().map(|x| x.1.squares - x.1.sum * x.1.mean()).sum();
        let variance = (scatter / freedom).max(1e-12 * model.step().powi(2)).max(1e-300);
        chosen[side] = poorest(&seen, nodes, variance);
        if chosen[side] != Levels::Constant {
            noise[side] = variance;
        }
        let mut square = 0.0;
        for pair in seen.windows(2) {
            let (a, b) = (pair[0].1, pair[1].1);
            square += (a.mean() - b.mean()).powi(2) - variance * (1.0 / a.count + 1.0 / b.count);
        }
        gradient[side] = (square.max(0.0) / seen.len() as f64).sqrt() * nodes as f64 / perimeter;
    }
    model.variance = not_too_sure(view, model, noise);
    model.set_levels(chosen, gradient);
}

/// Residuals away from the edge on one side, in equal stretches of the eccentric angle; those with too few pixels left out.
fn stretches(s: &Scratch, side: usize, nodes: usize) -> Vec<(usize, Stretch)> {
    let mut all = vec![Stretch::default(); nodes];
    for i in (0..s.band.u.len()).filter(|i| s.band.keep[*i]) {
        let p = if side == 0 { s.band.inside[i] } else { 1.0 - s.band.inside[i] };
        if p > 0.97 {
            let r = s.band.residual[i];
            let x = &mut all[(turn_share(s.band.angle[i]) * nodes as f64) as usize % nodes];
            *x = Stretch { count: x.count + 1.0, sum: x.sum + r, squares: x.squares + r * r };
        }
    }
    all.into_iter().enumerate().filter(|x| x.1.count >= 3.0).collect()
}

/// Whether the residuals away from the edge rise or fall with the distance, beyond four sigmas.
fn shows_slope(model: &EdgeModel, s: &Scratch, side: usize) -> bool {
    let (mut n, mut d1, mut d2, mut r1, mut rd) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for i in (0..s.band.u.len()).filter(|i| s.band.keep[*i]) {
        let p = if side == 0 { s.band.inside[i] } else { 1.0 - s.band.inside[i] };
        if p > 0.97 {
            let (d, r) = (s.band.distance[i], s.band.residual[i]);
            (n, d1, d2, r1, rd) = (n + 1.0, d1 + d, d2 + d * d, r1 + r, rd + r * d);
        }
    }
    let spread = d2 - d1 * d1 / n;
    if n < 10.0 || spread <= 0.0 {
        return false;
    }
    let slope = (rd - d1 * r1 / n) / spread;
    slope * slope * spread > 16.0 * model.variance[side]
}

/// Tests the means of the stretches against a constant, then against a first harmonic.
fn poorest(seen: &[(usize, Stretch)], nodes: usize, variance: f64) -> Levels {
    let n = seen.len();
    let angle = |k: usize| (k as f64 + 0.5) / nodes as f64 * TAU;
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    for (k, x) in seen {
        let row = Vector3::new(1.0, angle(*k).cos(), angle(*k).sin());
        normal += row * row.transpose() * x.count;
        right += row * x.sum;
    }
    let harmonic = normal.cholesky().map_or_else(Vector3::zeros, |c| c.solve(&right));
    let c0 = right[0] / normal[(0, 0)];
    let (mut flat, mut wave) = (0.0, 0.0);
    for (k, x) in seen {
        flat += (x.mean() - c0).powi(2) * x.count / variance;
        let h = harmonic[0] + harmonic[1] * angle(*k).cos() + harmonic[2] * angle(*k).sin();
        wave += (x.mean() - h).powi(2) * x.count / variance;
    }
    let limit = |dof: f64| dof + 3.5 * (2.0 * dof).sqrt();
    // A first harmonic has two degrees of its own; test it alone so that many bins do not drown it.
    let harmonic = flat - wave > limit(2.0) + 4.0;
    if n > 5 && wave > limit(n as f64 - 3.0) {
        Levels::Spline(n)
    } else if harmonic || flat > limit(n as f64 - 1.0) {
        Levels::Harmonic
    } else {
        Levels::Constant
    }
}

/// Gives every pixel its sector and sums up scores and information.
fn assign_sectors(model: &EdgeModel, s: &mut Scratch) {
    let e = &model.ellipse;
    let perimeter = e.perimeter_px();
    let count = ((perimeter / SECTOR_PX).round() as usize).max(8);
    let arc = arc_table(e);
    let q = &mut s.sectors;
    q.of_pixel.clear();
    for list in [&mut q.score, &mut q.information, &mut q.angle_sum, &mut q.misfit] {
        list.clear();
        list.resize(count, 0.0);
    }
    q.pixels.clear();
    q.pixels.resize(count, 0);
    q.middle_angle.clear();
    q.middle_angle.extend((0..count).map(|k| angle_at(&arc, (k as f64 + 0.5) / count as f64)));
    let b = &s.band;
    for i in 0..b.u.len() {
        // The angle on the ellipse as it is now: that of a near-circle may have turned since the band was collected.
        let angle = b.foot_angle(i);
        let x = turn_share(angle) * ARC_STEPS as f64;
        let j = (x as usize).min(ARC_STEPS - 1);
        let along = arc[j] + (arc[j + 1] - arc[j]) * (x - j as f64);
        let k = ((along * count as f64) as usize).min(count - 1);
        q.of_pixel.push(k as u32);
        let weight = 1.0 / model.variance_at(b.inside[i]);
        let information = weight * b.response[i] * b.response[i];
        q.score[k] += weight * b.response[i] * b.residual[i];
        q.information[k] += information;
        q.misfit[k] += weight * b.residual[i] * b.residual[i];
        q.pixels[k] += 1;
        let off = angle - q.middle_angle[k];
        q.angle_sum[k] += information * (off - TAU * (off / TAU).round());
    }
}

/// Share of the contour, 0 to 1, at equal steps of the eccentric angle from 0 to 2 pi.
fn arc_table(e: &Ellipse) -> [f64; ARC_STEPS + 1] {
    let mut arc = [0.0; ARC_STEPS + 1];
    for i in 0..ARC_STEPS {
        let t = (i as f64 + 0.5) / ARC_STEPS as f64 * TAU;
        arc[i + 1] = arc[i] + (e.semi_major_px * t.sin()).hypot(e.semi_minor_px * t.cos());
    }
    let total = arc[ARC_STEPS];
    arc.map(|x| x / total)
}

fn angle_at(arc: &[f64; ARC_STEPS + 1], share: f64) -> f64 {
    let j = arc.partition_point(|x| *x <= share).clamp(1, ARC_STEPS);
    let f = (share - arc[j - 1]) / (arc[j] - arc[j - 1]);
    (j as f64 - 1.0 + f) / ARC_STEPS as f64 * TAU
}

/// Marks the sectors that disagree with the rest and their pixels; returns the share that stays.
fn drop_sectors(s: &mut Scratch) -> f64 {
    let q = &mut s.sectors;
    let count = q.score.len();
    let collect = |f: &dyn Fn(usize) -> f64, sorted: &mut Vec<f64>| {
        sorted.clear();
        sorted.extend((0..count).filter(|k| q.information[*k] > 0.0).map(f));
        if sorted.is_empty() { 0.0 } else { median(sorted) }
    };
    let information = collect(&|k| q.information[k], &mut s.sorted);
    let shift = 1.4826 * collect(&|k| (q.score[k] / q.information[k]).abs(), &mut s.sorted);
    let misfit = collect(&|k| q.misfit[k] / f64::from(q.pixels[k].max(1)), &mut s.sorted);
    let shift_limit = 4.5 * shift.max(information.powf(-0.5));
    q.keep.clear();
    for k in 0..count {
        let enough = q.information[k] > 0.15 * information && information > 0.0;
        let near = (q.score[k] / q.information[k]).abs() < shift_limit;
        let pixels = f64::from(q.pixels[k].max(1));
        let like = q.misfit[k] / pixels < misfit.max(1.0) * (1.0 + 5.0 * (2.0 / pixels).sqrt() + 1.0);
        q.keep.push(enough && near && like);
    }
    for i in 0..s.band.u.len() {
        s.band.keep[i] = q.keep[q.of_pixel[i] as usize];
    }
    q.keep.iter().filter(|k| **k).count() as f64 / count as f64
}

/// Variance that, added to those of the edge points, makes their chi-square the number of degrees of freedom, px^2.
fn roughness_px2(ellipse: &Ellipse, edge: &EdgePoints, degrees_of_freedom: f64) -> f64 {
    let squares: Vec<f64> = (0..edge.u_px.len())
        .map(|i| ellipse.distance_px(crate::frames::Pixel::new(edge.u_px[i], edge.v_px[i])).powi(2))
        .collect();
    let chi2 = |x: f64| squares.iter().zip(&edge.sigma_px).map(|(r, s)| r / (s * s + x)).sum::<f64>();
    let (mut low, mut high) = (0.0, squares.iter().sum::<f64>() / degrees_of_freedom);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if chi2(middle) > degrees_of_freedom { low = middle } else { high = middle }
    }
    high
}

/// Edge points, the ellipse through them, the honest sigmas.
fn finish(model: &EdgeModel, start: &Start, options: &DetectOptions, s: &mut Scratch) -> Result<Disc, RejectionReason> {
    let e = &model.ellipse;
    let widen = model.nuisance_factor(&mut s.normal);
    let q = &s.sectors;
    let mut edge = EdgePoints::default();
    for k in (0..q.score.len()).filter(|k| q.keep[*k]) {
        let t = q.middle_angle[k] + q.angle_sum[k] / q.information[k];
        let shift = q.score[k] / q.information[k];
        let (foot, n) = (e.point(t), e.normal(t));
        edge.u_px.push(foot.u_px + shift * n[0]);
        edge.v_px.push(foot.v_px + shift * n[1]);
        edge.sigma_px.push(widen * q.information[k].powf(-0.5));
    }
    let fit_edges = |edge: &EdgePoints| {
        fit_geometric_from(e, &edge.u_px, &edge.v_px, &edge.sigma_px)
            .map_err(|_| not_elliptical(f64::INFINITY, e.semi_minor_px))
    };
    let mut fit = fit_edges(&edge)?;
    let limit_px = options.max_edge_rms_px + options.max_edge_rms_ratio * fit.ellipse.semi_minor_px;
    if fit.rms_px > limit_px {
        return Err(not_elliptical(fit.rms_px, limit_px));
    }
    if fit.chi2 > fit.degrees_of_freedom as f64 {
        // Rough prints and speckle scatter all edge points alike, sharp or blurred: their variance adds to that of the noise.
        let roughness = roughness_px2(&fit.ellipse, &edge, fit.degrees_of_freedom as f64);
        edge.sigma_px.iter_mut().for_each(|s| *s = (*s * *s + roughness).sqrt());
        fit = fit_edges(&edge)?;
    }
    Ok(Disc {
        ellipse: fit.ellipse,
        covariance: fit.covariance,
        edge,
        polarity: if start.bright { Polarity::Bright } else { Polarity::Dark },
        blur_px: model.blur_px,
        contrast: model.step().abs(),
        mark: None,
    })
}
