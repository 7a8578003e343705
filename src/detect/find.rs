//! The order of things: zero lines at three scales, candidates, refinement, that of close discs once more, rings, polarity.
//!
//! The image is looked at in full, half and quarter size: at each size the zero lines of the difference from the local mean
//! that start at a real edge are followed. A disc seen at several sizes is kept at the finest. Nothing here depends on a threshold
//! given by the user: the least gradient follows from the noise of the image itself.

mod fit_all;

use crate::conic::Ellipse;
use crate::detect::candidate::{Candidate, Odd, Strength, Verdict, judge, judge_odd, scaled};
use crate::detect::level::Level;
use crate::detect::of_target::{drop_twins, keep_target, within};
use crate::detect::plane::{self, Floats, Source, check_finite};
use crate::detect::refine::Start;
use crate::detect::rejection::told;
use crate::detect::rows::ByRow;
use crate::detect::slim::drop_widened;
use crate::detect::trace::{Line, Tracer};
use crate::detect::whole::{self, DetectMemory, LEVELS, Rows};
use crate::detect::{DetectOptions, Detection, Disc, Rejection, RejectionReason};
use crate::error::{self, Invalid, Result, Unusable};
use crate::image::GrayView;
use crate::target::{MarkKind, Polarity};
use crate::threads;
use fit_all::refine_all;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

/// A region with less than this part of the typical contrast is texture.
const TEXTURE: f64 = 0.15;
/// So many lines are judged by one thread while others are followed, in images of so many pixels at least.
const LINES_AT_ONCE: usize = 16;
const SHARED_PX: usize = 10_000;

/// Memory that a search takes, with one level more for images of floats or of little contrast.
const BYTES_PER_PIXEL: usize = 12;

/// Everything the coarse stage saw.
#[derive(Default)]
struct Seen {
    candidates: Vec<Candidate>,
    marks: Vec<(Candidate, MarkKind)>,
    rejected: Vec<(Candidate, RejectionReason)>,
    odd: Vec<Odd>,
}

impl Seen {
    fn take(&mut self, verdict: Verdict) {
        match verdict {
            Verdict::Disc(c) => self.candidates.push(c),
            Verdict::Mark(c, kind) => self.marks.push((c, kind)),
            Verdict::Rejected(c, reason) => self.rejected.push((c, reason)),
            Verdict::Overlap(parts) => self.rejected.extend(parts.map(|c| (c, RejectionReason::Overlapping))),
            Verdict::Odd(odd) => self.odd.push(odd),
            Verdict::Nothing => {}
        }
    }
}

/// Finds the discs of an image.
///
/// Positions and sizes in px, (0, 0) the centre of the first pixel; grey levels as they are in the image. The result holds
/// accepted discs (each with independent edge points, ellipse and covariance), square and triangle marks, and the candidates turned down.
///
/// # Errors
/// [`Invalid::Value`] where a floating-point sample is not finite or an option is out of its range; [`Invalid::Memory`] where there is not as much as a
/// search takes.
pub fn find_discs(view: &GrayView, options: &DetectOptions) -> Result<Detection> {
    find_discs_with(view, options, &DetectMemory::default())
}

/// As [`find_discs`], image after image in one memory.
///
/// # Errors
/// Those of [`find_discs`].
pub fn find_discs_with(view: &GrayView, options: &DetectOptions, memory: &DetectMemory) -> Result<Detection> {
    find_discs_while(view, options, memory, &|| true)
}

/// As [`find_discs_with`], as long as `go_on` says so, which is asked before each disc: images of particles, which nobody should take for discs, have
/// thousands.
///
/// # Errors
/// Those of [`find_discs`]; [`Unusable::Cancelled`] where `go_on` said no.
pub fn find_discs_while(
    view: &GrayView,
    options: &DetectOptions,
    memory: &DetectMemory,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Result<Detection> {
    let stopped = AtomicBool::new(false);
    // A no stays one.
    let go_on = &|| {
        if !stopped.load(Ordering::Relaxed) && !go_on() {
            stopped.store(true, Ordering::Relaxed);
        }
        !stopped.load(Ordering::Relaxed)
    };
    check_options(options)?;
    check_finite(view)?;
    let (width, height) = (view.width(), view.height());
    error::room(
        || format!("searching an image of {width} x {height} px"),
        BYTES_PER_PIXEL.saturating_mul(width * height),
    )?;
    let (noise, range) = threads::both(|| plane::noise(view), || plane::range(view));
    let mut seen = look(view, [noise, range], options, memory);
    drop_texture(&mut seen, f64::from(noise), options);
    drop_repeats(&mut seen);
    let (candidates, refined) = refine_all(view, &seen.candidates, [noise, range], options, go_on);
    if !go_on() {
        return Err(Unusable::Cancelled.into());
    }
    // Meanwhile another thread drops what an earlier search found.
    Ok(threads::both(|| conclude(view, &seen, candidates, refined, options.polarity), || memory.drop_replaced()).0)
}

/// The discs and all that was turned down, from the candidates and what they were refined to.
fn conclude(
    view: &GrayView,
    seen: &Seen,
    candidates: Vec<&Candidate>,
    refined: Vec<std::result::Result<Disc, RejectionReason>>,
    polarity: Polarity,
) -> Detection {
    let (mut detection, keep) = (Detection::default(), drop_twins(&refined));
    let mut turned_down = |c: &Candidate, reason| detection.rejections.push(rejection(c, told(reason, view, c)));
    // Discs are large: where they lie they are collected.
    let found = refined.into_iter().enumerate().filter_map(|(i, refined)| match refined {
        Ok(disc) => keep[i].then_some(disc),
        Err(reason) => {
            turned_down(candidates[i], reason);
            None
        }
    });
    detection.discs = found.collect();
    for (candidate, reason) in seen.rejected.iter().filter(|(c, _)| wanted(c.bright, polarity)) {
        detection.rejections.push(rejection(candidate, *reason));
    }
    keep_target(&mut detection, &seen.candidates, &seen.marks, polarity);
    detection
}

fn check_options(o: &DetectOptions) -> Result<()> {
    let positive = [
        ("min_semi_minor_px", o.min_semi_minor_px),
        ("max_semi_major_px", o.max_semi_major_px),
        ("min_contrast_to_noise", o.min_contrast_to_noise),
        ("max_edge_rms_px", o.max_edge_rms_px),
    ];
    for (name, value) in positive {
        if value.is_nan() || value <= 0.0 {
            return Err(Invalid::value(name, value, "a positive number").into());
        }
    }
    for (name, value) in [("min_axis_ratio", o.min_axis_ratio), ("min_coverage", o.min_coverage)] {
        if !(value > 0.0 && value <= 1.0) {
            return Err(Invalid::value(name, value, "a number above 0 and at most 1").into());
        }
    }
    Ok(())
}

fn wanted(bright: bool, polarity: Polarity) -> bool {
    match polarity {
        Polarity::Auto => true,
        Polarity::Bright => bright,
        Polarity::Dark => !bright,
    }
}

fn rejection(c: &Candidate, reason: RejectionReason) -> Rejection {
    let e = &c.ellipse;
    Rejection { center_px: e.center_px, radius_px: e.mean_radius_px(), reason }
}

/// Follows and judges the zero lines of every pyramid level.
fn look(view: &GrayView, [noise, range]: [f32; 2], options: &DetectOptions, memory: &DetectMemory) -> Seen {
    let quantum = 0.3;
    let mut noise = noise.max(quantum * range.min(1.0));
    let mut gradients = vec![];
    // Whole numbers are faster; floats hold whatever there is.
    let rows = whole::rows(view, noise);
    for level in 0..LEVELS {
        if (view.width() - 1) >> level < 11 || (view.height() - 1) >> level < 11 {
            break;
        }
        // Central difference over 1.5 px of the smoothed image: its noise is about 0.18 of a pixel's.
        gradients.push((5.0 * 0.18 * noise).max(0.008 * range));
        noise *= 0.273;
    }
    match rows {
        Some(rows) => memory.with(|levels| {
            let gradients = &gradients;
            look_at(levels, gradients, options, |out, finer, k| {
                out.remake(finer.map_or(rows, Rows::Finer), gradients[k], k + 1 == gradients.len())
            })
        }),
        None => look_at(&mut [(); LEVELS].map(|()| Floats::default()), &gradients, options, |out, finer, k| {
            let halved = finer.map(|finer| finer.smoothed().halved());
            *out = Floats::new(halved.as_ref().map_or(Source::View(view), Source::Plane), gradients[k]);
        }),
    }
}

/// What the line of a disc tells in a small image without its neighbours, whose light narrows the edge that it shows.
fn seen_again(patch: &GrayView, start: &Start, levels: [f32; 2], options: &DetectOptions) -> Option<Candidate> {
    let seen = look(patch, levels, options, &DetectMemory::default());
    let again =
        |c: &Candidate| c.bright == start.bright && c.level == start.level && same_place(&c.ellipse, &start.ellipse);
    seen.candidates.into_iter().find(again)
}

/// The candidates of an image, for tests of what is made of them.
#[cfg(test)]
pub(crate) fn candidates_of(view: &GrayView) -> Vec<Candidate> {
    let mut seen =
        look(view, [plane::noise(view), plane::range(view)], &DetectOptions::default(), &DetectMemory::default());
    drop_repeats(&mut seen);
    seen.candidates
}

/// One level after the other; coarser ones are made, each from the finer one, within a pool while the lines of the first are followed.
fn look_at<L: Level + Send + Sync>(
    levels: &mut [L],
    gradients: &[f32],
    options: &DetectOptions,
    make: impl Fn(&mut L, Option<&L>, usize) + Sync,
) -> Seen {
    let mut seen = Seen::default();
    let Some((first, rest)) = levels[..gradients.len()].split_first_mut() else { return seen };
    make(first, None, 0);
    let finest = || follow(Tracer::new(&*first), (&[], 0), gradients[0], 0, options, &mut seen);
    let coarser = || {
        let mut finer = &*first;
        for (k, level) in rest.iter_mut().enumerate() {
            make(level, Some(finer), k + 1);
            finer = level;
        }
    };
    threads::both(finest, coarser);
    let (mut tracer, mut passed) = (None, 0);
    for (k, on) in (1..).zip(rest.iter()) {
        let finer: Vec<(Ellipse, bool)> = seen.candidates.iter().map(|c| (c.ellipse, c.bright)).collect();
        let own = tracer.take().unwrap_or_else(|| Tracer::new(on));
        // What was seen so far need not be waited for.
        let prepare = || {
            rest.get(k).map(|next| {
                let mut tracer = Tracer::new(next);
                finer.iter().for_each(|(e, _)| tracer.pass_over(&at_level(e, k + 1)));
                tracer
            })
        };
        let follow = || follow(own, (&finer, passed), gradients[k], k as u32, options, &mut seen);
        (tracer, passed) = (threads::both(follow, prepare).1, finer.len());
    }
    seen
}

/// An ellipse in px of a level.
fn at_level(e: &Ellipse, level: usize) -> Ellipse {
    scaled(e, 1.0 / f64::from(1u32 << level))
}

/// Follows and judges the lines of one level from where they start, given what was seen at finer ones, the first of
/// which the tracer has passed over. Within a pool they are judged side by side.
fn follow(
    mut tracer: Tracer<impl Level + Sync>,
    (finer, passed): (&[(Ellipse, bool)], usize),
    gradient: f32,
    level: u32,
    options: &DetectOptions,
    seen: &mut Seen,
) {
    let (on, strength) = (tracer.level, Strength { gradient: f64::from(gradient) });
    finer[passed..].iter().for_each(|(e, _)| tracer.pass_over(&at_level(e, level as usize)));
    let by_row = OnceLock::new();
    // What was seen at a finer level need not be judged again.
    let known = |e: &Ellipse, bright: bool| {
        let by_row = by_row.get_or_init(|| ByRow::new(finer.iter().map(|c| &c.0)));
        let reach = repeat_px(e.semi_minor_px.max(by_row.largest_px));
        by_row.near(e.center_px, reach).any(|k| finer[k].1 == bright && same_place(&finer[k].0, e))
    };
    let judged = |line: &Line| judge(line, on, strength, level, options, &known);
    let mut line = Line::default();
    let mut each = |take: &mut dyn FnMut(&Line)| {
        for start in on.starts() {
            let start = start as usize;
            if tracer.fresh(start) {
                tracer.follow(start % on.width(), start / on.width(), &mut line);
                take(&line);
            }
        }
    };
    if threads::several() && on.width() * on.height() >= SHARED_PX {
        let verdicts = threads::while_found(LINES_AT_ONCE, |found| each(&mut |line| found(line.clone())), judged);
        verdicts.into_iter().for_each(|v| seen.take(v));
    } else {
        each(&mut |line| seen.take(judged(line)));
    }
    tracer.end();
}

/// Drops what is far weaker than the discs that dominate the image: paper, cloth, smoke. What has the size of a disc is named.
fn drop_texture(seen: &mut Seen, noise: f64, options: &DetectOptions) {
    let regions = seen.candidates.iter().chain(seen.odd.iter().map(|o| &o.rough));
    let most = regions.clone().fold(0.0_f64, |most, c| c.contrast.max(most));
    let all = regions.chain(seen.marks.iter().map(|m| &m.0)).chain(seen.rejected.iter().map(|r| &r.0));
    if all.fold(f64::INFINITY, |least, c| c.contrast.min(least)) >= TEXTURE * most {
        // None is weak, whichever of them is typical.
        std::mem::take(&mut seen.odd).iter().for_each(|odd| seen.take(judge_odd(odd, options)));
        return;
    }
    let weight = |c: &Candidate| c.contrast * c.ellipse.perimeter_px();
    let mut weights: Vec<(f64, f64, f64)> = seen
        .candidates
        .iter()
        .chain(seen.odd.iter().map(|o| &o.rough))
        .map(|c| (c.contrast, weight(c), c.ellipse.mean_radius_px()))
        .collect();
    let total: f64 = weights.iter().map(|w| w.1).sum();
    weights.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sum = 0.0;
    let Some(typical) = weights.iter().find(|w| {
        sum += w.1;
        sum >= 0.5 * total
    }) else {
        return;
    };
    let (least, radius) = (TEXTURE * typical.0, typical.2);
    let mut weak = Vec::new();
    seen.candidates.retain(|c| {
        let size = c.ellipse.mean_radius_px();
        let strong = c.contrast >= least;
        if !strong && size > 0.5 * radius && size < 2.0 * radius && size > 4.0 {
            let contrast_to_noise = if noise > 0.0 { c.contrast / noise } else { c.contrast };
            weak.push((*c, RejectionReason::LowContrast { contrast_to_noise }));
        }
        strong
    });
    for odd in std::mem::take(&mut seen.odd) {
        if odd.rough.contrast >= least {
            seen.take(judge_odd(&odd, options));
        }
    }
    seen.marks.retain(|(c, _)| c.contrast >= least);
    seen.rejected.retain(|(c, _)| c.contrast >= least);
    seen.rejected.append(&mut weak);
}

/// The same region seen twice.
fn same(a: &Candidate, b: &Candidate) -> bool {
    a.bright == b.bright && same_place(&a.ellipse, &b.ellipse)
}

/// How far apart two views of one region may lie, of which the larger one has this minor semi-axis, px.
fn repeat_px(semi_minor_px: f64) -> f64 {
    0.4 * semi_minor_px + 1.0
}

/// By what part of the larger one two views of one region may differ in size, however small the region: a coarse view widens a dot by some of
/// its own pixels, but nothing is a view of all that it lies in.
const MOST_WIDENED: f64 = 0.85;

/// Two ellipses of about one place and size.
fn same_place(a: &Ellipse, b: &Ellipse) -> bool {
    let (small, large) = (a.semi_minor_px.min(b.semi_minor_px), a.semi_minor_px.max(b.semi_minor_px));
    within(a.center_px, b.center_px, repeat_px(large)) && 1.0 - small / large < (0.35 + 1.0 / small).min(MOST_WIDENED)
}

/// A coarse view in which a disc that is seen by itself at a finer level has run into something else.
fn swallows(coarse: &Candidate, fine: &Candidate) -> bool {
    if coarse.level <= fine.level || coarse.bright != fine.bright {
        return false;
    }
    let (big, small) = (coarse.ellipse.mean_radius_px(), fine.ellipse.mean_radius_px());
    !same(coarse, fine)
        && small > 0.3 * big
        && small < big
        && fine.contrast > 0.5 * coarse.contrast
        && coarse.ellipse.implicit(fine.ellipse.center_px) < 0.0
}

/// Keeps of every region the view at the finest level.
fn drop_repeats(seen: &mut Seen) {
    drop_widened(&mut seen.candidates, &seen.rejected);
    // Candidates come level by level: those of finer levels are decided first.
    let mut keep = vec![true; seen.candidates.len()];
    let finest = seen.candidates.iter().take_while(|c| c.level == 0).count();
    if finest < seen.candidates.len() {
        let by_row = ByRow::new(seen.candidates.iter().map(|c| &c.ellipse));
        for (i, c) in seen.candidates.iter().enumerate().skip(finest) {
            let mut near = by_row.near(c.ellipse.center_px, repeat_px(by_row.largest_px));
            keep[i] = !near.any(|k| keep[k] && seen.candidates[k].level < c.level && same(&seen.candidates[k], c));
        }
    }
    let mut kept: Vec<Candidate> = seen.candidates.iter().zip(&keep).filter(|(_, k)| **k).map(|(c, _)| *c).collect();
    // Parts of a disc that overlaps another are not to be used, even where enough of the contour is free.
    let overlaps: Vec<Candidate> =
        seen.rejected.iter().filter(|r| r.1 == RejectionReason::Overlapping).map(|r| r.0).collect();
    kept.retain(|c| !overlaps.iter().any(|o| (o.level <= c.level && same(o, c)) || swallows(c, o)));
    let finer: Vec<Candidate> = kept.clone();
    kept.retain(|c| c.level == 0 || !finer.iter().any(|f| swallows(c, f)));
    seen.candidates = kept;
    let mut marks: Vec<(Candidate, MarkKind)> = Vec::new();
    for m in &seen.marks {
        // Coarse views round corners off and cut gaps: the finest view decides what a region is.
        let finer = seen.candidates.iter().any(|c| c.level < m.0.level && same(c, &m.0));
        if !finer && !marks.iter().any(|k| same(&k.0, &m.0)) {
            marks.push(*m);
        }
    }
    seen.candidates.retain(|c| !marks.iter().any(|m| m.0.level <= c.level && same(&m.0, c)));
    seen.marks = marks;
    let mut rejected: Vec<(Candidate, RejectionReason)> = Vec::new();
    for r in &seen.rejected {
        let known = seen.candidates.iter().any(|c| same(c, &r.0)) || rejected.iter().any(|k| same(&k.0, &r.0));
        if !known && !seen.marks.iter().any(|m| same(&m.0, &r.0)) {
            rejected.push(*r);
        }
    }
    seen.rejected = rejected;
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::frames::Pixel;

    fn candidate(u_px: f64, v_px: f64, semi_px: (f64, f64), level: u32) -> Candidate {
        let ellipse = Ellipse::new(Pixel::new(u_px, v_px), semi_px.0, semi_px.1, 0.3).expect("an ellipse");
        Candidate { ellipse, blur_px: 1.0, bright: true, contrast: 100.0, rms_px: 0.1, level }
    }

    /// A search of many dots that is stopped looks at no more of them.
    #[test]
    fn a_search_ends_where_it_is_told_to() {
        let (w, h) = (400, 300);
        let out_px = |i: usize| ((i % w % 20) as f64 - 9.7).hypot((i / w % 20) as f64 - 10.2) - 5.5;
        let light = |i: usize| 50.0 + 150.0 / (1.0 + out_px(i).exp()) + (i * i % 7) as f64;
        let grey: Vec<u8> = (0..w * h).map(|i| light(i) as u8).collect();
        let view = GrayView::new(crate::image::Samples::U8(&grey), w, h, w).expect("an image");
        let asked = std::sync::atomic::AtomicUsize::new(0);
        let search = |most: usize| {
            asked.store(0, std::sync::atomic::Ordering::Relaxed);
            let go_on = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) < most;
            find_discs_while(&view, &DetectOptions::default(), &DetectMemory::default(), &go_on)
        };
        let whole = search(usize::MAX).expect("a search");
        assert!(whole.discs.len() > 200, "{}", whole.discs.len());
        assert_eq!(whole, find_discs(&view, &DetectOptions::default()).expect("a search"));
        let stopped = search(10).expect_err("stopped");
        assert!(matches!(stopped, crate::Error::Unusable(Unusable::Cancelled)), "{stopped}");
    }

    /// Two specks of smoke that touch, each finer than 1.5 px, lay near the centre of a bubble: it went with them.
    #[test]
    fn touching_specks_inside_a_disc_do_not_take_it_along() {
        for speck_px in [0.4, 0.9, 1.4, 2.0, 3.0] {
            let disc = candidate(253.6, 395.7, (202.1, 138.5), 0);
            let speck = candidate(270.0, 401.0, (2.0 * speck_px, speck_px), 0);
            let mut seen = Seen { candidates: vec![disc], ..Seen::default() };
            seen.rejected.push((speck, RejectionReason::Overlapping));
            drop_repeats(&mut seen);
            assert_eq!(seen.candidates.len(), 1, "specks of {speck_px} px");
            assert!(!same_place(&disc.ellipse, &speck.ellipse), "known from a speck of {speck_px} px");
        }
    }

    /// Coarse views of a dot are wider by some of their own pixels, and are dropped.
    #[test]
    fn of_a_dot_seen_at_several_sizes_the_finest_view_stays() {
        for (fine_px, coarse_px) in [(1.6, 4.0), (2.5, 5.5), (4.0, 6.0), (30.0, 31.0)] {
            let views =
                [candidate(50.0, 50.0, (fine_px, fine_px), 0), candidate(50.6, 49.8, (coarse_px, coarse_px), 1)];
            let mut seen = Seen { candidates: views.to_vec(), ..Seen::default() };
            drop_repeats(&mut seen);
            assert_eq!(seen.candidates.len(), 1, "{fine_px} and {coarse_px} px");
            assert_eq!(seen.candidates[0].level, 0);
        }
    }
}
