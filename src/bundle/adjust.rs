//! The adjustment: Levenberg-Marquardt with sigmas that follow the data and discs that do not fit set aside.
//!
//! The given sigmas come from grey-value noise. Real contours scatter more (rough print, a lens that the model does not
//! know), and they do so disc by disc, not edge point by edge point. After each solve two variance factors are formed per
//! camera: of the edge points within their discs, and of the discs' own departures (centre and size, three numbers each; two of a point).
//! The larger one, where it is significant, scales the sigmas of that camera, and the solve is repeated.

use super::assemble::{self, SeenImage};
use super::by_disc::ByDisc;
use super::facts;
use super::image_map::MappedNormal;
use super::layout::{self, Places};
use super::model::{ImageObservations, Model};
use super::outline::{self, Outlines};
use super::part;
use super::points;
use super::residuals::{self, DiscResidual, ImageResiduals};
use super::retraction;
use super::same_light;
use super::state::State;
use super::surface;
use super::tie::Alike;
use crate::solve::{self, Gradient, Iteration, NormalEquations, Posterior, Problem, Step, Termination};
use crate::stats::chi_square_above;
use nalgebra::DMatrix;

/// Options of [`adjust`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdjustOptions {
    /// When a solve ends.
    pub solve: solve::Options,
    /// How often sigmas are rescaled and outliers set aside; 0 keeps the given sigmas.
    pub rounds: usize,
    /// A disc whose image lies more than this many robust standard deviations off (and more than 0.2 px) is an outlier.
    pub outlier_sigmas: f64,
}

impl Default for AdjustOptions {
    fn default() -> Self {
        Self { solve: solve::Options::default(), rounds: 4, outlier_sigmas: 6.0 }
    }
}

/// A disc that was set aside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlier {
    /// View.
    pub view: usize,
    /// Camera.
    pub camera: usize,
    /// Disc of the target.
    pub disc: usize,
    /// Distance of its image from where the adjustment expects it after which it was set aside, px.
    pub distance_px: f64,
}

/// Result of [`adjust`].
#[derive(Debug, Clone)]
pub struct Adjustment {
    /// The estimate.
    pub state: State,
    /// The model with the final sigma scales and without outliers.
    pub model: Model,
    /// Cost at the estimate.
    pub cost: f64,
    /// Newton decrement, in sigmas.
    pub decrement: f64,
    /// Linearisations of all observations in all rounds.
    pub iterations: usize,
    /// Why the last solve ended.
    pub termination: Termination,
    /// Normal equations at the estimate; `None` only after a bad start.
    pub equations: Option<NormalEquations>,
    /// Discs set aside.
    pub outliers: Vec<Outlier>,
    /// Standard deviation of the printed discs' ovality, mm, where their outlines show one; of two discs the root mean square of what is estimated.
    pub ovality_mm: Option<f64>,
    /// Standard deviation of that ovality which is assumed, mm, where the images do not tell how large it may be.
    pub ovality_assumed_mm: Option<f64>,
    /// How what the contours of both cameras say of bubbles goes together.
    pub same_light: Option<Alike>,
}

/// The least-squares problem of a model, for solvers and tests of other makes.
pub fn problem(model: &Model) -> impl Problem<State = State> + '_ {
    Bundle::with_views(model)
}

/// The problem with one block per view, or where that is less work one per disc.
pub(super) struct Bundle<'a> {
    model: &'a Model,
    places: Places,
    by: Option<ByDisc>,
}

impl<'a> Bundle<'a> {
    /// With the blocks that are the less work.
    pub(super) fn of(model: &'a Model) -> Self {
        Self::with_places(model, Places::of(model))
    }

    /// The same with one block per view in any case.
    pub(super) fn with_views(model: &'a Model) -> Self {
        Self { model, places: Places::of(model), by: None }
    }

    /// The same with unknowns that may be more than those of the model ([`Places::with_further`]).
    pub(super) fn with_places(model: &'a Model, places: Places) -> Self {
        let by = ByDisc::of(model, &places);
        Self { model, places, by }
    }

    pub(super) fn places(&self) -> &Places {
        &self.places
    }

    /// A step of its unknowns with one block per view.
    pub(super) fn step_by_view(&self, step: &Step) -> Step {
        self.by.as_ref().map_or_else(|| step.clone(), |by| by.step_by_view(step))
    }

    /// What [`Problem::linearise`] gives, from the equations of images that were formed before at the same state.
    pub(super) fn summed<'n>(
        &self,
        images: impl Iterator<Item = &'n (usize, MappedNormal)>,
        state: &State,
    ) -> Option<NormalEquations> {
        let of_images = match &self.by {
            Some(by) => assemble::summed_by_disc(by, images),
            None => assemble::summed(self.model, &self.places, images),
        };
        self.with_facts(of_images, state)
    }

    /// View and equations of each image, in their order; they are summed by [`Bundle::summed`].
    pub(super) fn of_each_image(&self, state: &State) -> Option<Vec<(usize, MappedNormal)>> {
        assemble::of_each_image(self.model, &self.places, state)
    }

    /// Equations of the images as the solver wants them.
    fn with_facts(&self, mut e: NormalEquations, state: &State) -> Option<NormalEquations> {
        let scales = self.scales(state);
        match &self.by {
            Some(by) => {
                by.drop_unseen(&mut e, &scales, unseen);
                facts::linearise_by_disc(self.model, (&self.places, by, &scales.global), state, &mut e)?;
            }
            None => {
                drop_unseen(&mut e, &scales);
                facts::linearise(self.model, (&self.places, &scales.global), state, &mut e)?;
            }
        }
        Some(e)
    }

    /// Adds a row of what all views share to equations, with its cost.
    pub(super) fn add_row(&self, e: &mut NormalEquations, row: &facts::Row) {
        match &self.by {
            Some(by) => by.add_row(e, row),
            None => facts::add(e, row),
        }
    }

    /// Equations with one block per view.
    fn by_view(&self, equations: NormalEquations) -> NormalEquations {
        match &self.by {
            Some(by) => by.equations_by_view(&equations),
            None => equations,
        }
    }
}

impl Problem for Bundle<'_> {
    type State = State;
    fn layout(&self) -> solve::Layout {
        self.by.as_ref().map_or_else(|| self.places.layout(), ByDisc::layout)
    }
    fn cost(&self, state: &State) -> Option<f64> {
        Some(assemble::cost(self.model, state)? + facts::cost(self.model, &self.places, state)?)
    }
    fn linearise(&self, state: &State) -> Option<NormalEquations> {
        let of_images = match &self.by {
            Some(by) => assemble::linearise_by_disc(self.model, &self.places, by, state)?,
            None => assemble::linearise(self.model, &self.places, state, None)?,
        };
        self.with_facts(of_images, state)
    }
    fn scales(&self, state: &State) -> Step {
        let scales = layout::scales(self.model, &self.places, state);
        self.by.as_ref().map_or_else(|| scales.clone(), |by| by.step_by_disc(&scales))
    }
    fn bend(&self, state: &State, velocity: &Step) -> Option<Gradient> {
        // A tenth of the step: far above rounding, near enough for a second derivative.
        const H: f64 = 0.1;
        let part = |h: f64| {
            let blocks = velocity.blocks.iter().map(|b| b * h).collect();
            self.retract(state, &Step { global: &velocity.global * h, blocks })
        };
        let bent = assemble::bend(self.model, &self.places, [&part(-H)?, state, &part(H)?], H)?;
        Some(match &self.by {
            Some(by) => by.gradient_by_disc(&bent),
            None => bent,
        })
    }
    fn retract(&self, state: &State, step: &Step) -> Option<State> {
        match &self.by {
            Some(by) => retraction::retract(self.model, &self.places, state, &by.step_by_view(step)),
            None => retraction::retract(self.model, &self.places, state, step),
        }
    }
}

/// Information, about a global unknown that is moved by as far as the problem is about linear, below which the images do not see it:
/// its sigma would be more than a hundred such steps. Rounding leaves 1e-5 on the axis point of a camera without distortion, where
/// terms a million times larger cancel.
const UNSEEN: f64 = 1e-4;

fn unseen(information: f64, scale: f64) -> bool {
    information * scale.powi(2) < UNSEEN
}

/// Clears what rounding leaves on global unknowns that the images do not see, before facts are added: it would pass for knowledge.
fn drop_unseen(e: &mut NormalEquations, scales: &Step) {
    for i in 0..e.h_gg.nrows() {
        if unseen(e.h_gg[(i, i)], scales.global[i]) {
            e.h_gg.row_mut(i).fill(0.0);
            e.h_gg.column_mut(i).fill(0.0);
            e.b_g[i] = 0.0;
            e.blocks.iter_mut().for_each(|b| b.h_vg.column_mut(i).fill(0.0));
        }
    }
}

/// Linearisations that a start from a part of the observations is given.
const PART_ITERATIONS: usize = 50;
/// Newton decrement of the part, in its own sigmas, at which all observations take over.
const PART_DECREMENT: f64 = 0.3;

/// A start and the damping to leave it with: from a part of the observations where that pays.
fn first_start(
    model: &Model,
    start: State,
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> (State, f64, bool) {
    let Some(part) = part::part(model) else { return (start, solve::FIRST_DAMPING, true) };
    let bundle = Bundle::of(&part);
    let counts = part.counts();
    // Where the start is no further off than chance would put the part's own minimum, the part has nothing to add.
    let near = (2.0 * counts.unknowns as f64).sqrt();
    let (mut good_already, mut wanted) = (false, true);
    let mut seen = |i: &Iteration| {
        good_already |= i.number == 1 && i.decrement < near;
        wanted &= observe(i);
        wanted && !good_already
    };
    let limits = solve::Options {
        decrement: PART_DECREMENT.max(options.solve.decrement),
        iterations: PART_ITERATIONS.min(options.solve.iterations),
    };
    let out = solve::minimise(&bundle, start.clone(), &limits, &mut seen);
    match out.termination {
        Termination::Converged if !good_already => (out.state, out.damping, wanted),
        _ => (start, solve::FIRST_DAMPING, wanted),
    }
}

/// How often the surface of a bent plate is found anew; each time it is five times nearer.
const FOLLOWED: usize = 8;

/// Adjusts everything from a start. `observe` sees each iteration, also those of a start from a part of the observations, and returns false
/// to cancel. The threads are those of the pool that the caller runs in, without one there is one; results do not depend on their number.
pub fn adjust(
    model: &Model,
    start: State,
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Adjustment {
    adjust_owned(model.clone(), start, options, observe)
}

/// Covariance of all that the views share, in the order of the solver's unknowns: what [`super::named_covariance`] and the posterior say
/// about them, without the poses. `None` where not everything is determined, or without equations.
pub fn shared_covariance(adjustment: &Adjustment) -> Option<DMatrix<f64>> {
    solve::global_covariance(adjustment.equations.as_ref()?)
}

/// [`adjust`] of a model that nobody else needs: its observations are not copied.
pub fn adjust_owned(
    mut model: Model,
    start: State,
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Adjustment {
    let mut start = start;
    match model.target.oval_sigma_mm {
        Some(_) => start.ovals_mm.resize(model.target.disc_count(), [0.0; 2]),
        None => start.ovals_mm.clear(),
    }
    if model.target.offset_sigma_mm.is_none() {
        start.slopes.clear();
    }
    let (mut state, damping, wanted) = first_start(&model, start, options, observe);
    let mut observe = |i: &Iteration| wanted && observe(i);
    let mut damping = Some(damping);
    let mut iterations = 0;
    let mut outliers = vec![];
    let (mut outlines, mut same_light) = (Outlines::default(), None);
    let (mut round, mut followed) = (0, 0);
    loop {
        let bundle = Bundle::of(&model);
        let first = damping.take().unwrap_or(solve::FIRST_DAMPING);
        let mut out = solve::minimise_damped(&bundle, state, &options.solve, first, &mut observe);
        out.equations = out.equations.map(|e| bundle.by_view(e));
        iterations += out.iterations;
        let stopped = matches!(out.termination, Termination::Cancelled | Termination::BadStart);
        let goes_on = round < options.rounds && !stopped;
        // Before all else: outlines in a surface that is not known yet would pass for ovals, and enlarge sigmas.
        if goes_on && followed < FOLLOWED {
            if surface::follow(&model, &mut out.state) {
                state = out.state;
                followed += 1;
                continue;
            }
            // What is flat once is not asked again.
            followed = if followed == 0 { FOLLOWED } else { followed };
        }
        let changed = goes_on && {
            let mut all = residuals::of_each_image(&model, &out.state);
            let set_aside = set_outliers_aside(&mut model, &mut all, options, &mut outliers);
            if round == 0 {
                outlines = outline::find(&mut model, &mut out.state);
            }
            let oval = round == 0 && outlines.changed;
            if oval {
                all = residuals::of_each_image(&model, &out.state);
            }
            if round == 0 || set_aside {
                same_light = same_light::tie(&mut model, &out.state);
            }
            let tied = round == 0 && same_light.is_some();
            // Equations of fewer unknowns say nothing of what these pay for.
            let known = !(oval && model.target.oval_sigma_mm.is_some());
            let rescaled = known && rescale(&mut model, &all, &out.state, out.equations.as_ref());
            rescaled || set_aside || oval || tied
        };
        if !changed {
            return Adjustment {
                ovality_mm: outlines.ovality_mm.map(|tau| out.state.ovality_rms_mm().unwrap_or(tau)),
                ovality_assumed_mm: outlines.assumed_mm,
                state: out.state,
                model,
                cost: out.cost,
                decrement: out.decrement,
                iterations,
                termination: out.termination,
                equations: out.equations,
                outliers,
                same_light,
            };
        }
        state = out.state;
        round += 1;
    }
}

/// Number of unknowns that the observations of camera `c` pay for: `tr(C N_c)`, C the covariance and N_c the camera's part
/// of the normal matrix (Foerstner's variance components). Equal shares instead would drive a camera that fits a little
/// worse out of the adjustment: common unknowns follow the other one, and its residuals grow further.
fn unknowns_paid(model: &Model, state: &State, posterior: &Posterior, c: usize) -> Option<f64> {
    let own = assemble::linearise(model, &Places::of(model), state, Some(c))?;
    let mut sum = posterior.global.component_mul(&own.h_gg).sum();
    for (p, n) in posterior.blocks.iter().zip(&own.blocks) {
        sum += p.own.component_mul(&n.h_vv).sum() + 2.0 * p.with_global.component_mul(&n.h_vg).sum();
    }
    Some(sum)
}

/// Scales the sigmas of each camera to what the residuals show; true where a scale changed by more than 3 %.
fn rescale(
    model: &mut Model,
    all: &[Option<ImageResiduals>],
    state: &State,
    equations: Option<&NormalEquations>,
) -> bool {
    let Some(scales) = equations.map(|e| scales_of(model, all, state, e)) else { return false };
    let changed = model.images.iter().any(|i| (scales[i.camera] / i.sigma_scale - 1.0).abs() > 0.03);
    set_scales(model, &scales);
    changed
}

fn set_scales(model: &mut Model, scales: &[f64]) {
    model.images.iter_mut().for_each(|i| i.sigma_scale = scales[i.camera]);
}

/// Factor of the given sigmas of each camera that the residuals of an adjustment show, whatever it was made with; `None` without equations.
pub fn sigma_scales(a: &Adjustment) -> Option<Vec<f64>> {
    let all = residuals::of_each_image(&a.model, &a.state);
    Some(scales_of(&a.model, &all, &a.state, a.equations.as_ref()?))
}

fn scales_of(model: &Model, all: &[Option<ImageResiduals>], state: &State, equations: &NormalEquations) -> Vec<f64> {
    let posterior = solve::posterior(equations);
    (0..model.cameras.len()).map(|c| scale_of_camera(model, all, (state, &posterior), c)).collect()
}

/// The adjustment with other factors of the given sigmas, one for each camera, from where another one of the same rig ended; nothing is set aside.
pub fn readjusted_with(
    a: &Adjustment,
    scales: &[f64],
    start: &State,
    options: &AdjustOptions,
    observe: &mut dyn FnMut(&Iteration) -> bool,
) -> Adjustment {
    let mut model = a.model.clone();
    set_scales(&mut model, scales);
    adjust_owned(model, start.clone(), &AdjustOptions { rounds: 0, ..*options }, observe)
}

/// Root of the larger significant variance factor of a camera, relative to the given sigmas.
fn scale_of_camera(
    model: &Model,
    all: &[Option<ImageResiduals>],
    (state, posterior): (&State, &Posterior),
    c: usize,
) -> f64 {
    let (mut edge_chi2, mut edge_dof, mut disc_chi2, mut disc_dof) = (0.0, 0.0, 0.0, 0.0);
    for (image, r) in model.images.iter().zip(all).filter(|(i, _)| i.camera == c) {
        let Some(r) = r else { continue };
        let unscale = image.sigma_scale * image.sigma_scale;
        for (seen, disc) in image.discs.iter().zip(&r.discs) {
            // Where cameras err alike both pay for what an ellipse may follow, which are all five numbers of the rim.
            let (chi2, numbers, variance) = match (disc.rim_chi2, &seen.tie) {
                (Some(chi2), Some(tie)) => match tie.alike() {
                    Some(alike) => (chi2, 5.0, alike.variance),
                    // What ovals pay for.
                    None => (disc.chi2 + chi2, 5.0, 1.0),
                },
                // Ties that were formed since the residuals say nothing of them.
                _ => (disc.chi2, 3.0, 1.0),
            };
            disc_chi2 += chi2 * unscale / variance;
            disc_dof += numbers;
            edge_chi2 += (disc.edge_chi2 - chi2) * unscale;
            edge_dof += seen.count() as f64 - numbers;
        }
        // Points are to discs what discs are to edge points.
        let points = SeenImage::of(model, state, image).and_then(|seen| points::chi2(&seen));
        disc_chi2 += points.unwrap_or(0.0) * unscale;
        disc_dof += 2.0 * image.points.disc.len() as f64;
    }
    disc_dof -= unknowns_paid(model, state, posterior, c).unwrap_or(0.0);
    variance_factor(edge_chi2, edge_dof).max(variance_factor(disc_chi2, disc_dof)).sqrt()
}

/// Chance beyond which a sum of squares is no chance: that of three standard deviations of a normal number, on one side.
const CHANCE: f64 = 1.35e-3;

/// `chi2 / dof` where true sigmas would hardly ever give so much, else 1: a factor that follows mere chance would spoil them. The chance
/// is the chi-square's own: of the ten degrees that a few discs leave, one in a hundred lies three of their standard deviations above.
fn variance_factor(chi2: f64, dof: f64) -> f64 {
    if dof < 1.0 || chi_square_above(chi2, dof) > CHANCE { 1.0 } else { chi2 / dof }
}

/// Takes out discs that lie off by more than the limit; never more than a fifth of an image, those of earlier rounds included.
///
/// `all` are the residuals of the images; those of the discs taken out leave with them.
fn set_outliers_aside(
    model: &mut Model,
    all: &mut [Option<ImageResiduals>],
    options: &AdjustOptions,
    outliers: &mut Vec<Outlier>,
) -> bool {
    let mut found = false;
    for c in 0..model.cameras.len() {
        let mut own: Vec<(&mut ImageObservations, &mut Vec<DiscResidual>)> = model
            .images
            .iter_mut()
            .zip(all.iter_mut())
            .filter(|(i, _)| i.camera == c)
            .filter_map(|(i, r)| r.as_mut().map(|r| (i, &mut r.discs)))
            .collect();
        let mut sizes: Vec<f64> = own.iter().flat_map(|(_, d)| d.iter().map(DiscResidual::distance_px)).collect();
        if sizes.len() < 20 {
            continue;
        }
        sizes.sort_by(f64::total_cmp);
        // Median of a two-dimensional normal distance is 1.1774 sigma.
        let limit = (options.outlier_sigmas * sizes[sizes.len() / 2] / 1.1774).max(0.2);
        for (image, discs) in &mut own {
            let is_bad = |d: &DiscResidual| d.distance_px() > limit;
            let bad: Vec<Outlier> = discs
                .iter()
                .filter(|d| is_bad(d))
                .map(|d| Outlier { view: image.view, camera: c, disc: d.disc, distance_px: d.distance_px() })
                .collect();
            let before = outliers.iter().filter(|o| [o.view, o.camera] == [image.view, c]).count();
            if bad.is_empty() || 5 * (before + bad.len()) > before + discs.len() {
                continue;
            }
            found = true;
            image.discs.retain(|d| !bad.iter().any(|b| b.disc == d.disc));
            discs.retain(|d| !bad.iter().any(|b| b.disc == d.disc));
            outliers.extend(bad);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the upper points of printed tables: one in a hundred or in two hundred is chance, one in a thousand is not.
    #[test]
    fn a_variance_factor_is_no_chance() {
        for (chi2, dof) in [(5.0, 10.0), (25.188, 10.0), (135.807, 100.0), (10.828, 0.9)] {
            assert_eq!(variance_factor(chi2, dof), 1.0, "{chi2} of {dof}");
        }
        for (chi2, dof) in [(10.828, 1.0), (29.588, 10.0), (149.449, 100.0)] {
            assert_eq!(variance_factor(chi2, dof), chi2 / dof);
        }
    }
}
