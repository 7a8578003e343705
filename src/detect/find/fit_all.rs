//! All discs of an image fitted, each with what all of them tell together: light, noise, the shape of the blur.

use super::{seen_again, wanted};
use crate::detect::around::{MOST_SMOKY, surroundings, wisps};
use crate::detect::beside::{ask_beside, refine_beside};
use crate::detect::candidate::Candidate;
use crate::detect::correlation::NoiseCorrelation;
use crate::detect::dust::refined_but_dust;
use crate::detect::exact::is_large;
use crate::detect::refine::{Scratch, Start, noise_told, quantisation, refine, shape_told, smoke_told};
use crate::detect::rough::roughen_all;
use crate::detect::shape::Shape;
use crate::detect::shape::of_image::Question;
use crate::detect::shape::told::Told;
use crate::detect::shared_light::SharedLight;
use crate::detect::shot_noise::{MANY, ShotNoise};
use crate::detect::slim::turn_down_slim;
use crate::detect::{DetectOptions, Disc, RejectionReason, Smoke};
use crate::image::GrayView;
use crate::threads::{self, OwnMemory};
use nalgebra::Matrix4;
use std::sync::OnceLock;

/// Noise over contrast and root of the length of a contour below which its line tells place and blur to a hundredth of a pixel, px^(-1/2).
const CLEAR: f64 = 0.0035;

/// What a candidate is refined to.
type Refined = Result<Disc, RejectionReason>;

/// The candidates of the polarity wanted, in their order, and what they are refined to. The threads are those of the pool that the caller runs in; without
/// one there is one thread. Each disc depends on the image alone, so the result does not depend on their number.
pub(super) fn refine_all<'a>(
    view: &GrayView,
    candidates: &'a [Candidate],
    [noise_grey, range]: [f32; 2],
    options: &DetectOptions,
    go_on: &(dyn Fn() -> bool + Sync),
) -> (Vec<&'a Candidate>, Vec<Refined>) {
    let sigma = f64::from(noise_grey);
    let is_wanted = |c: &Candidate| wanted(c.bright, options.polarity);
    let all: Vec<&Candidate> = candidates.iter().filter(|c| is_wanted(c)).collect();
    let in_smoke = wisps(&all);
    let discs: Vec<&Candidate> = all.iter().zip(&in_smoke).filter(|(_, wisp)| !**wisp).map(|(c, _)| *c).collect();
    let few = |count: usize| count <= MOST_SMOKY;
    // Beside a wisp there is smoke, which must not pass for noise.
    let smoke = few(discs.len());
    let (light, (noise, around)) = threads::both(
        || SharedLight::of(view, candidates),
        || {
            let noise = NoiseCorrelation::of(view, &all, if smoke { &discs } else { &all }, !smoke);
            (noise, surroundings(candidates))
        },
    );
    let wanted = candidates.iter().zip(&around).filter(|(c, _)| is_wanted(c));
    let each = wanted.zip(&in_smoke).map(|((candidate, around), wisp)| {
        let smoke = if *wisp { few(all.len()) } else { smoke };
        Start {
            ellipse: candidate.ellipse,
            blur_px: candidate.blur_px,
            bright: candidate.bright,
            contrast: candidate.contrast,
            inner_px: around.inner_px,
            neighbours: &around.neighbours,
            slopes: light.slopes(candidate),
            noise: &noise,
            level: candidate.level,
            variance: sigma * sigma,
            quantisation: quantisation(view),
            clear: candidate.ellipse.is_longer_than((sigma / (CLEAR * candidate.contrast)).powi(2)),
            shot_noise: None,
            smoke,
            full_of_smoke: smoke && options.smoke == Smoke::Full && candidate.bright,
            printed: options.smoke == Smoke::None,
            shape: Shape::GAUSSIAN,
            stretch: [0.0; 2],
            shape_covariance: Matrix4::zeros(),
            asked: false,
            tells: None,
        }
    });
    let mut starts: Vec<Start> = each.collect();
    let told: Vec<OnceLock<Box<Told>>> = starts.iter().map(|_| OnceLock::new()).collect();
    let mut refined = fit_shaped(view, &mut starts, &told, [noise_grey, range], options, go_on);
    roughen_all(&mut refined, options);
    turn_down_slim(&mut refined, options.min_axis_ratio);
    (all, refined)
}

/// Fits all discs, with the shape of the blur that they tell together. Clean ones tell it by the way; before the others are asked for smoke it must be known.
fn fit_shaped<'a>(
    view: &GrayView,
    starts: &mut [Start<'a>],
    told: &'a [OnceLock<Box<Told>>],
    levels: [f32; 2],
    options: &DetectOptions,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Vec<Refined> {
    let memory = OwnMemory::<Scratch>::new();
    let ask = |start: &Start| {
        if go_on() { memory.with(|scratch| shape_told(view, start, options, scratch)) } else { None }
    };
    let ask_all = |asked: &[Start<'a>]| threads::side_by_side(asked, ask);
    if starts.len() < MANY {
        // What makes noise louder inside would look like a shape.
        let noise = noise_inside(view, starts, options, go_on);
        starts.iter_mut().for_each(|start| start.shot_noise = noise);
    }
    let question = Question::new(starts);
    let first = |starts: &[Start<'a>]| question.first.iter().map(|i| starts[*i]).collect::<Vec<_>>();
    if first(starts).iter().any(Start::goes_the_longer_way) {
        let told = ask_all(&first(starts));
        question.settle(starts, told, ask_all);
        return fit_all(view, starts, levels, options, go_on);
    }
    question.first.iter().for_each(|i| starts[*i].tells = told.get(*i));
    let before = starts.to_vec();
    let refined = fit_all(view, starts, levels, options, go_on);
    let by_the_way = |start: &Start<'a>| match start.tells.and_then(OnceLock::get) {
        Some(told) => Some((**told).clone()),
        // What the short way of a large disc comes to no end with is hardly a blur.
        None if is_large(&start.ellipse) => None,
        None => ask(start),
    };
    let told = threads::side_by_side(&first(&before), by_the_way);
    starts.copy_from_slice(&before);
    // They have told.
    starts.iter_mut().for_each(|start| start.tells = None);
    if question.settle(starts, told, ask_all) { fit_all(view, starts, levels, options, go_on) } else { refined }
}

/// The noise inside that all discs tell together; none where they know it themselves, do not tell, or may be full of smoke.
fn noise_inside(
    view: &GrayView,
    starts: &[Start],
    options: &DetectOptions,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Option<ShotNoise> {
    let memory = OwnMemory::<Scratch>::new();
    let ask = |start: &Start| {
        if go_on() { memory.with(|scratch| noise_told(view, start, options, scratch)) } else { None }
    };
    let told = ShotNoise::of(starts, |asked| threads::side_by_side(asked, ask));
    told.filter(|noise| {
        let ask = |start: &Start| {
            if go_on() { memory.with(|scratch| smoke_told(view, start, noise, options, scratch)) } else { None }
        };
        !starts.iter().any(|start| start.full_of_smoke)
            && noise.without_smoke(starts, |asked| threads::side_by_side(asked, ask))
    })
}

/// Fits all discs: alone, then those that are close without each other's light, with the noise that all of them tell together.
fn fit_all(
    view: &GrayView,
    starts: &mut [Start],
    [noise_grey, range]: [f32; 2],
    options: &DetectOptions,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Vec<Refined> {
    let sigma = f64::from(noise_grey);
    let memory = OwnMemory::<Scratch>::new();
    // Of a search that was stopped nothing is used, whatever is said of its discs.
    let stopped = Err(RejectionReason::NoGreyLevels);
    let refine = |view: &GrayView, start: &Start| {
        if go_on() { memory.with(|scratch| refine(view, start, options, scratch)) } else { stopped.clone() }
    };
    let again = |patch: &GrayView, start: &Start| {
        if !go_on() {
            return stopped.clone();
        }
        let line = seen_again(patch, start, [noise_grey, range], options);
        refine(patch, &line.as_ref().map_or(*start, |line| start.by(line)))
    };
    let shot_noise = noise_inside(view, starts, options, go_on);
    let few = starts.len() < MANY;
    for start in starts.iter_mut() {
        let known = start.bright && shot_noise.is_some_and(|noise| noise.is_all_of(start));
        // Of few discs that are printed each takes the longer way.
        start.smoke &= !known || few && start.printed;
        start.shot_noise = shot_noise;
    }
    let (mut refined, dust) = refined_but_dust(starts, |start| refine(view, start));
    let close = refine_beside(view, starts, &mut refined, sigma, again);
    if shot_noise.is_none() && close.contains(&true) && !starts.iter().any(Start::may_be_full_of_smoke) {
        // Light of neighbours may have passed for noise.
        let ask = |view: &GrayView, start: &Start| {
            if go_on() { memory.with(|scratch| noise_told(view, start, options, scratch)) } else { None }
        };
        let told = ShotNoise::of(starts, |asked| ask_beside(view, asked, (starts, &refined), sigma, ask));
        if told.is_some() {
            starts.iter_mut().for_each(|start| start.shot_noise = told);
            // Close ones start from what is known of their neighbours.
            let alone: Vec<usize> = (0..starts.len()).filter(|i| !close[*i] && !dust[*i]).collect();
            let found = threads::side_by_side(&alone, |i| refine(view, &starts[*i]));
            alone.into_iter().zip(found).for_each(|(i, disc)| refined[i] = disc);
            refine_beside(view, starts, &mut refined, sigma, again);
        }
    }
    refined
}
