//! The fit of one disc to single pixels: the short way of clean discs, the way of all others, and that of smoke.

use super::{Found, Scratch, Start, accept, border_px, check_size};
use crate::conic::{Ellipse, Frame, from_regular, to_regular};
use crate::detect::contour::{Contour, NEIGHBOUR};
use crate::detect::edge_model::{EdgeModel, LEAST_BLUR_PX};
use crate::detect::exact::{Answer, Exact, Field, Hidden, Share, State, is_large};
use crate::detect::light::{Light, Side};
use crate::detect::quick::Clean;
use crate::detect::shape::told::Told;
use crate::detect::{DetectOptions, Disc, EdgePoints, RejectionReason};
use crate::image::GrayView;
use crate::lanes::{self, Kernel, Lanes};
use crate::stats::{SIGMA_OVER_MEDIAN, median};
use nalgebra::{SMatrix, SVector};

/// Least information of an edge point, of the largest.
const LEAST_SHARE: f64 = 0.05;
/// By how much the noise that a field of smoke leaves may surpass, as a variance, that which neighbouring pixels showed.
/// On small discs, on large ones, which show it well.
const LOUDER: [f64; 2] = [1.5, 1.15];
/// Noise inside, as a variance, of that outside, that is believed of a small disc without pixels enough to show it.
const BELIEVED: f64 = 16.0;
/// Mean squared residual over the noise that says that something is not explained, and that it is.
const UNEXPLAINED: f64 = 2.0;
const EXPLAINED: f64 = 1.5;
/// The same that passes for noise, but for chance.
const MOST_NOISE: f64 = 1.2;
/// The same of a large disc, whose nodes are there otherwise.
const WELL_EXPLAINED: f64 = 1.1;
/// The same of a small disc whose smoke is known.
const SMOKE_LEAVES: f64 = 1.3;
/// Difference of what two fits of one image say that is none.
const ALIKE: f64 = 0.5;
/// Least information of a sector of a clean disc, of what is typical, and how many of its sigmas, or of what is typical, it is off at most.
const LEAST_TOLD: f64 = 0.15;
const FURTHEST: f64 = 4.5;
/// Least part of the semi-minor axis of its line that a disc has where that line tells where it is.
const LEAST_NEAR: f64 = 0.9;
/// By how much the variance of a profile that is no Gaussian's differs from that of the Gaussian fitted to it: a quarter for a square of pixels.
const OTHER_PROFILE: f64 = 0.35;
/// Longest contour with a field inside, px: its price grows with the area, 0.5 s for discs of 100 px.
const LONGEST_PX: f64 = 900.0;
/// Stretches of a quarter of the contour that are left out in turn.
const STRETCHES: usize = 8;

/// The short way: a disc with nothing hidden and nothing beside it; none where it may be otherwise. What it is content with may be weak smoke, which shows no
/// more than a slope: small discs that may be full of it, and all that are known to be, go the longer way.
pub(super) fn clean_disc(
    view: &GrayView,
    start: &Start,
    options: &DetectOptions,
    s: &mut Scratch,
) -> Option<Result<Disc, RejectionReason>> {
    if start.goes_the_longer_way() {
        return None;
    }
    let state = fit_quickly(view, start, s)?;
    if let Some((tells, told)) = start.tells.and_then(|tells| Some((tells, s.quick.shape_told(&state)?))) {
        // The first fit counts.
        tells.get_or_init(|| Box::new(told));
    }
    // A small disc in slow smoke looks clean but for that, and its axes come out wrong by many sigmas.
    if start.smoke && s.quick.slanted_inside && !is_large(&state.ellipse) {
        return None;
    }
    if !s.quick.clean(&state) || !agree(&s.quick.shares, &mut s.sorted) {
        return None;
    }
    let ends = border_px(view, &state.ellipse);
    let model = EdgeModel {
        ellipse: state.ellipse,
        blur_px: state.blur_px,
        expected_blur_px: state.expected_blur_px,
        light: Light::Surface([Side::plain(0, 1.0); 2]),
        variance: state.variance,
        bends: [0.0; 2],
        step: state.step,
    };
    if ends < 1.0 || check_size(&model, start, options).is_err() {
        return None;
    }
    let told = if state.shape.is_gaussian() { None } else { s.quick.shape_told(&state) };
    let change = s.quick.change() + told.as_ref().map_or_else(SVector::zeros, |told| told.stretched(start.stretch));
    let ellipse = from_regular(&(to_regular(&state.ellipse) + change))?;
    let mut edge = lanes::run(Edges { contour: &s.fine, shares: &s.quick.shares, kept: None, change: &change });
    let blur_px = (state.blur_px + s.quick.change_of_blur()).max(LEAST_BLUR_PX);
    // Sigmas are those of the blur before; what an edge tells goes with one over its blur.
    let wider = blur_px / state.blur_px;
    edge.sigma_px.iter_mut().for_each(|sigma| *sigma *= wider.sqrt());
    let added = told.map_or_else(SMatrix::zeros, |told| told.adds(&start.shape_covariance));
    let covariance = s.quick.covariance() * wider + added;
    let found = Found { ellipse, blur_px, covariance, followed: false };
    let disc = accept(&found, edge, &model, start, options, &mut s.feet);
    // Where noise is allowed to look like light the longer way has the last word.
    let sure = disc.is_ok() || start.noise.is_none();
    sure.then_some(disc)
}

/// The fit of the short way, shared out among the sectors.
pub(super) fn fit_quickly(view: &GrayView, start: &Start, s: &mut Scratch) -> Option<Clean> {
    let gap_px = |e: &Ellipse| Frame::new(&start.ellipse).least_gap_px(e);
    let outer_px = start.neighbours.iter().map(gap_px).fold(f64::INFINITY, f64::min) * NEIGHBOUR;
    if start.inner_px < 0.89 * start.ellipse.semi_minor_px {
        return None;
    }
    let (contour, blur_px) = start.contour();
    let near = start.level == 0 && contour.semi_minor_px > LEAST_NEAR * start.ellipse.semi_minor_px;
    let ellipse = if near { contour } else { start.ellipse };
    let mut state = Clean {
        ellipse,
        blur_px,
        expected_blur_px: blur_px,
        shape: start.shape,
        near: near && start.clear,
        step: start.step(),
        slopes: start.slopes,
        variance: [start.variance; 2],
        allow: start.noise.allow,
        shot_noise: start.shot_noise,
    };
    let floor = start.quantisation.max((1e-4 * start.contrast).powi(2));
    s.quick.fit(view, &mut state, outer_px, floor)?;
    s.fine.cut_frame(&s.quick.frame, &[]);
    s.quick.share_out(&s.fine);
    Some(state)
}

/// What a disc says of the shape of the blur; none where the short way comes to no end.
pub(super) fn shape_told(view: &GrayView, start: &Start, s: &mut Scratch) -> Option<Told> {
    let state = fit_quickly(view, start, s)?;
    s.quick.shape_told(&state)
}

/// Whether every sector of the contour says the same.
fn agree(shares: &[Share], sorted: &mut Vec<f64>) -> bool {
    let mut typical = |f: &dyn Fn(&Share) -> f64| {
        sorted.clear();
        sorted.extend(shares.iter().map(f));
        median(sorted).unwrap_or(0.0)
    };
    let (mut least, mut most, mut furthest2, mut even) = (f64::INFINITY, 0.0_f64, 0.0_f64, true);
    for x in shares {
        // Over its own sigma: a sector that the pixels happen to cut badly says less, and is further off.
        (least, most, furthest2) = (least.min(x.information), most.max(x.information), furthest2.max(x.deviation2()));
        let twice = 2.0 * x.pixels.max(1.0);
        even &= x.squares < twice + 5.0 * twice.sqrt();
    }
    let furthest = furthest2.sqrt();
    // What is typical lies below the most, and the limit is no less than that of noise alone: mostly neither needs to be known.
    even && (least > LEAST_TOLD * most || least > LEAST_TOLD * typical(&|x| x.information))
        && (furthest < FURTHEST
            || furthest < FURTHEST * (SIGMA_OVER_MEDIAN * typical(&|x| x.deviation2().sqrt())).max(1.0))
}

/// Edge points of the sectors that count, as wide as the processor is.
struct Edges<'a> {
    contour: &'a Contour,
    shares: &'a [Share],
    kept: Option<&'a [bool]>,
    /// Change of the ellipse since the contour was cut, px.
    change: &'a SVector<f64, 5>,
}

impl Kernel for Edges<'_> {
    type Output = EdgePoints;
    #[inline(always)]
    fn run<L: Lanes>(self) -> EdgePoints {
        let Self { contour, shares, kept, change } = self;
        let count = shares.len();
        let (kept, row) = (kept.map(|kept| &kept[..count]), &contour.row[..count]);
        let [u, v, normal_u, normal_v] =
            [&contour.u, &contour.v, &contour.normal_u, &contour.normal_v].map(|list| &list[..count]);
        let mut edge = EdgePoints { u_px: vec![0.0; count], v_px: vec![0.0; count], sigma_px: vec![0.0; count] };
        let [u_px, v_px, sigma_px] =
            [&mut edge.u_px, &mut edge.v_px, &mut edge.sigma_px].map(|list| &mut list[..count]);
        for k in 0..count {
            let moved: f64 = (0..5).map(|i| row[k][i] * change[i]).sum();
            let shift = shares[k].shift_px() - moved;
            (u_px[k], v_px[k]) = (u[k] + shift * normal_u[k], v[k] + shift * normal_v[k]);
            sigma_px[k] = 1.0 / shares[k].information.sqrt();
        }
        let counts = |k: usize| kept.is_none_or(|l| l[k]) && shares[k].information > 0.0;
        let most = (0..count).filter(|k| counts(*k)).fold(0.0_f64, |most, k| most.max(shares[k].information));
        // Of a sector that is all but hidden the pixels count, but they give no place.
        let tells = |k: usize| counts(k) && shares[k].information > LEAST_SHARE * most;
        if !(0..count).all(tells) {
            for list in [&mut edge.u_px, &mut edge.v_px, &mut edge.sigma_px] {
                let mut k = 0..;
                list.retain(|_| k.next().is_some_and(tells));
            }
        }
        edge
    }
}

/// What the fit to single pixels came to.
pub(super) enum Exactly {
    Fitted(Box<Found>, EdgePoints),
    /// What it leaves looks like smoke, of a disc too large for a field: nodes are to follow the light.
    Smoke,
}

/// The light that single pixels are fitted with, and whether nodes along the contour had followed it; none where these do better.
fn light_to_fit(model: &EdgeModel, start: &Start, large: bool) -> Option<([Side; 2], bool)> {
    let short = model.ellipse.perimeter_px() < LONGEST_PX;
    Some(match &model.light {
        Light::Surface(sides) => (*sides, false),
        // An edge of another profile may look like light that changes along it.
        Light::Nodes(..) if start.asked && !large => ([Side::plain(0, model.step.abs()); 2], false),
        Light::Nodes(..) if !start.smoke => return None,
        // Nodes along a long contour do as well as a field where the light changes fast, and for less.
        Light::Nodes(..) if large => (model.light.beside_slow_waves().filter(|_| short)?, true),
        Light::Nodes(..) => ([Side::plain(1, model.step.abs()), Side::plain(0, model.step.abs())], true),
    })
}

/// The fit to single pixels, with the sectors that the rounds kept; none where it does not hold.
pub(super) fn fit_exactly(view: &GrayView, model: &EdgeModel, start: &Start, s: &mut Scratch) -> Option<Exactly> {
    let keep = s.sectors.keep.clone();
    let large = is_large(&model.ellipse);
    let (sides, nodes) = light_to_fit(model, start, large)?;
    let mut state = State {
        ellipse: model.ellipse,
        blur_px: model.blur_px,
        expected_blur_px: model.expected_blur_px,
        shape: start.shape,
        sides,
        field: None,
        slopes: start.slopes,
        variance: model.variance,
        step: model.step,
        full_of_smoke: start.full_of_smoke && !large,
        allow: start.noise.allow,
    };
    let before = state.clone();
    let floor = start.quantisation.max((1e-4 * model.step).powi(2));
    s.exact.uncovered();
    let mut kept = s.exact.settle(view, &mut state, &mut s.fine, &keep, start, floor)?;
    // Nothing that lies in the light or upon it explains an edge that is no Gaussian's all around.
    let edge_alone = !(nodes && large) && s.exact.edge_alone(&state);
    let seen = !edge_alone && (nodes || looks_smoky(&state, start, &s.exact));
    let explained = large || s.exact.misfit() < UNEXPLAINED;
    // Light that only fields explain is not to pass for something hidden; nor that which a slope explains, but for a few pixels.
    let ask = !edge_alone && !large && start.may_be_full_of_smoke() && (!seen || explained);
    let answer = match (state.full_of_smoke && !edge_alone, ask) {
        (true, _) => Answer::Likely,
        (false, true) => s.exact.ask_for_smoke(&state),
        (false, false) => Answer::Open,
    };
    let told = answer == Answer::Likely;
    let smoky = told || answer == Answer::Possible || seen && answer == Answer::Open;
    let (mut clear, mut doubtful) = (false, None);
    if start.smoke && !edge_alone && !(nodes && large) {
        // What is hidden is asked for before smoke.
        let mut found = uncover(view, &state, &kept, start, floor, s);
        doubtful = found.take_if(|x| told || !x.believed(smoky));
        if found.is_none() && !explained {
            found = leave_a_stretch(view, &before, start, (&keep, floor), s);
        }
        clear = found.is_some();
        match found {
            Some(found) => (state, kept) = (found.state, found.kept),
            None => {
                s.exact.uncovered();
                kept = s.exact.settle(view, &mut state, &mut s.fine, &keep, start, floor)?;
            }
        }
    }
    if smoky && start.smoke && !clear {
        if large && !nodes {
            return Some(Exactly::Smoke);
        }
        match smoke_or_hidden(view, [&before, &state], doubtful, start, (&keep, floor), s)? {
            Some(found) => (state, kept) = found,
            None if nodes => return None,
            None => {
                kept = s.exact.settle(view, &mut state, &mut s.fine, &keep, start, floor)?;
                // No smoke: then rather more hidden than none.
                match uncover(view, &state, &kept, start, floor, s).filter(|x| x.believed(false)) {
                    Some(found) => (state, kept) = (found.state, found.kept),
                    None => {
                        s.exact.uncovered();
                        kept = s.exact.settle(view, &mut state, &mut s.fine, &keep, start, floor)?;
                    }
                }
            }
        }
    }
    finished(&state, start, (&kept, edge_alone), s)
}

/// What the fit came to, from the state where it stands still; kept in the scratch where its light is plain.
fn finished(state: &State, start: &Start, (kept, edge_alone): (&[bool], bool), s: &mut Scratch) -> Option<Exactly> {
    let plain = state.field.is_none() && s.exact.hides_nothing();
    s.plain = plain.then(|| (state.clone(), edge_alone));
    let told = if plain && !state.shape.is_gaussian() { s.exact.shape_told(state) } else { None };
    let (mut ellipse, mut change, blur_px) = s.exact.finished(state)?;
    if let Some(told) = &told {
        let stretched = told.stretched(start.stretch);
        ellipse = from_regular(&(to_regular(&ellipse) + stretched))?;
        change += stretched;
    }
    let mut covariance = s.exact.covariance();
    if edge_alone {
        s.exact.count_misfit_as_noise();
        covariance = s.exact.covariance() + of_other_profile(&ellipse, blur_px);
    }
    covariance += told.map_or_else(SMatrix::zeros, |told| told.adds(&start.shape_covariance));
    let edge = lanes::run(Edges { contour: &s.fine, shares: &s.exact.shares, kept: Some(kept), change: &change });
    Some(Exactly::Fitted(Box::new(Found { ellipse, blur_px, covariance, followed: state.field.is_some() }), edge))
}

/// What not knowing the profile of an edge adds to the covariance of the regular coordinates. A blurred edge of curvature k (1/px) lies `k s^2 / 2` px inside of
/// the sharp one, s the standard deviation of the profile; s^2 is known to [`OTHER_PROFILE`] alone, and k is taken as 1 / sqrt(a b) all around.
fn of_other_profile(e: &Ellipse, blur_px: f64) -> SMatrix<f64, 5, 5> {
    let size = e.mean_radius_px();
    let moved_px = 0.5 * OTHER_PROFILE * blur_px * blur_px / size;
    let larger = Ellipse { semi_major_px: e.semi_major_px + moved_px, semi_minor_px: e.semi_minor_px + moved_px, ..*e };
    let change = to_regular(&larger) - to_regular(e);
    change * change.transpose()
}

/// Whether what polynomials leave looks like smoke. A small disc hardly shows that: there light that rises inside alone is enough to ask; of the
/// others a few fields are asked.
fn looks_smoky(state: &State, start: &Start, exact: &Exact) -> bool {
    let [inside, outside] = state.sides.map(|side| side.degree > 0);
    exact.smoke_left(state) || too_loud(state, start, exact) || !is_large(&state.ellipse) && inside && !outside
}

/// Whether noise inside is louder than outside without being the light's own.
fn too_loud(state: &State, start: &Start, exact: &Exact) -> bool {
    !start.printed && exact.louder_inside(state)
}

/// The disc without the pixels that something hides.
struct Uncovered {
    state: State,
    /// Sectors that count.
    kept: Vec<bool>,
    hidden: Hidden,
    /// What is left is noise, no louder inside.
    quiet: bool,
    /// The same, and little is hidden.
    glare: bool,
    /// What is left looks like smoke.
    smoke: bool,
}

impl Uncovered {
    /// Whether that is what is seen. The skirts of glare look like smoke, but of little of the disc: where it may as well be `smoky` only little
    /// may be hidden.
    fn believed(&self, smoky: bool) -> bool {
        !self.smoke && (!smoky || self.glare)
    }
}

/// Looks for pixels that something hides; `plain` is what all pixels of the sectors `kept` came to, their residuals still in the scratch.
fn uncover(
    view: &GrayView,
    plain: &State,
    kept: &[bool],
    start: &Start,
    floor: f64,
    s: &mut Scratch,
) -> Option<Uncovered> {
    let mut state = plain.clone();
    let kept = s.exact.uncover(view, &mut state, &mut s.fine, kept, start, floor)?;
    let quiet = s.exact.misfit() < MOST_NOISE && !too_loud(&state, start, &s.exact);
    let (glare, smoke) = (quiet && s.exact.hides_little(), s.exact.smoke_left(&state));
    Some(Uncovered { state, kept, hidden: s.exact.hidden().clone(), quiet, glare, smoke })
}

/// The fit with smoke, or without the pixels that are `hidden` where these leave noise alone and smoke as much louder noise as it must not: on a
/// small disc waves explain a glare spot that half the disc has to be bent for. `Some(None)` and `None` as of [`fit_smoke`]. Smoke shines: of a dark disc, which a shadow,
/// dirt or a bright line may cross, only what is hidden is asked.
#[allow(clippy::option_option)]
fn smoke_or_hidden(
    view: &GrayView,
    [before, plain]: [&State; 2],
    hidden: Option<Uncovered>,
    start: &Start,
    (keep, floor): (&[bool], f64),
    s: &mut Scratch,
) -> Option<Option<(State, Vec<bool>)>> {
    let mut found = if start.bright && !start.printed {
        let Some((smoky, kept)) = fit_smoke(view, before, plain, start, (keep, floor), s)? else { return Some(None) };
        let louder = |x: &Uncovered| smoky.variance[0] > louder_by(&smoky, &s.exact) * x.state.variance[0];
        let Some(found) = hidden.filter(|x| x.quiet && louder(x)) else { return Some(Some((smoky, kept))) };
        found
    } else {
        let Some(found) = hidden.filter(|x| x.quiet) else { return Some(None) };
        found
    };
    s.exact.hide(found.hidden);
    let kept = s.exact.settle(view, &mut found.state, &mut s.fine, &found.kept, start, floor)?;
    Some(Some((found.state, kept)))
}

/// By how much the noise that a field leaves may surpass what is known of it: of few pixels it is not known well.
fn louder_by(state: &State, exact: &Exact) -> f64 {
    let large = is_large(&state.ellipse);
    LOUDER[usize::from(large)] * (1.0 + 2.0 * (2.0 / exact.free_in_field(state)).sqrt())
}

/// Glare on a small disc may bend the whole ellipse so that no sector disagrees more than another: one stretch of the contour after
/// the other is left out, and where the rest of one explains itself, that tells what is hidden.
fn leave_a_stretch(
    view: &GrayView,
    before: &State,
    start: &Start,
    (keep, floor): (&[bool], f64),
    s: &mut Scratch,
) -> Option<Uncovered> {
    let count = keep.len();
    let mut best: Option<(f64, State, Vec<bool>)> = None;
    for j in 0..STRETCHES {
        let within = |k: usize| (k + count - j * count / STRETCHES) % count * 4 < count;
        let rest: Vec<bool> = (0..count).map(|k| !within(k)).collect();
        let mut state = before.clone();
        s.exact.uncovered();
        if s.exact.settle(view, &mut state, &mut s.fine, &rest, start, floor).is_none()
            || too_loud(&state, start, &s.exact)
        {
            continue;
        }
        let misfit = s.exact.misfit();
        if misfit < best.as_ref().map_or(EXPLAINED, |b| b.0) {
            best = Some((misfit, state, rest));
        }
    }
    let (_, mut state, rest) = best?;
    s.exact.uncovered();
    let kept = s.exact.settle(view, &mut state, &mut s.fine, &rest, start, floor)?;
    uncover(view, &state, &kept, start, floor, s).filter(|x| x.believed(true))
}

/// The fit with a field of smoke and the sectors that counted, from where `before` stood; `plain` is what polynomials came to, their
/// residuals still in the scratch. `Some(None)` where no field explains the light, `None` where nothing could be solved.
#[allow(clippy::option_option)]
fn fit_smoke(
    view: &GrayView,
    before: &State,
    plain: &State,
    start: &Start,
    (keep, floor): (&[bool], f64),
    s: &mut Scratch,
) -> Option<Option<(State, Vec<bool>)>> {
    let large = is_large(&before.ellipse);
    let mut smoky = State { field: Some(Field::default()), ..before.clone() };
    smoky.sides[0] = Side::plain(0, before.step.abs());
    // Noise inside is told from smoke only once the smoke is known.
    let outside = s.exact.noise()[1].unwrap_or(plain.variance[1]).max(floor);
    let shown = s.exact.noise_between_neighbours(plain);
    let inside = shown.map_or(outside, |x| x.variance).max(floor);
    smoky.variance = [inside, outside];
    let known = match shown {
        Some(_) if large => inside,
        Some(x) => inside * (1.0 + 3.0 * x.sigma),
        None => BELIEVED * outside,
    };
    if !large {
        // Smoke looked like disagreement before it was known.
        let all = vec![true; keep.len()];
        if let Some(found) = likeliest_in_smoke(view, &smoky, [before, plain], start, (&all, floor, known), s) {
            return Some(Some(found));
        }
    }
    let kept = s.exact.settle(view, &mut smoky, &mut s.fine, keep, start, floor)?;
    // Where there is another edge inside, the field must explain what it is said to be.
    let alone = start.inner_px >= 0.85 * before.ellipse.semi_minor_px;
    let most = if large {
        WELL_EXPLAINED
    } else if alone {
        f64::INFINITY
    } else {
        1.5
    };
    Some(explains(&smoky, &s.exact, known, most).then_some((smoky, kept)))
}

/// Whether a field leaves about the noise that is `known`: what is no smoke is not to pass for noise.
fn explains(state: &State, exact: &Exact, known: f64, most: f64) -> bool {
    state.field.is_some() && state.variance[0] < louder_by(state, exact) * known && exact.misfit() < most
}

/// The likelier one of what the fit with smoke finds from two places: where it begins decides which disc it finds, for another may explain much of the
/// image.
fn likeliest_in_smoke(
    view: &GrayView,
    smoky: &State,
    from: [&State; 2],
    start: &Start,
    (keep, floor, known): (&[bool], f64, f64),
    s: &mut Scratch,
) -> Option<(State, Vec<bool>)> {
    let mut best: Option<(f64, State, Vec<bool>)> = None;
    let mut again = false;
    for place in from {
        let mut state = State { ellipse: place.ellipse, blur_px: place.blur_px, ..smoky.clone() };
        again = best.is_some();
        let Some(kept) = s.exact.settle(view, &mut state, &mut s.fine, keep, start, floor) else { continue };
        let value = s.exact.unlikely();
        if explains(&state, &s.exact, known, SMOKE_LEAVES) && best.as_ref().is_none_or(|b| value < b.0 + ALIKE) {
            (best, again) = (Some((value, state, kept)), false);
        }
    }
    let (_, mut state, kept) = best?;
    // The other one was looked at last.
    let kept = if again { s.exact.settle(view, &mut state, &mut s.fine, keep, start, floor)? } else { kept };
    Some((state, kept))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::random::Random;

    /// The criterion written out, with both medians.
    fn plainly(shares: &[Share]) -> bool {
        let typical = |f: &dyn Fn(&Share) -> f64| median(&mut shares.iter().map(f).collect::<Vec<_>>()).unwrap_or(0.0);
        let off = |x: &Share| x.shift_px().abs() * x.information.sqrt();
        let (information, limit) = (typical(&|x| x.information), 4.5 * (SIGMA_OVER_MEDIAN * typical(&off)).max(1.0));
        shares.iter().all(|x| {
            let (enough, spread) = (x.information > 0.15 * information, x.squares / x.pixels.max(1.0));
            enough && off(x) < limit && spread < 2.0 + 5.0 * (2.0 / x.pixels.max(1.0)).sqrt()
        })
    }

    /// Even and uneven sectors, one that says little or nothing, one or all of them off.
    #[test]
    fn sectors_agree_whether_medians_are_asked_for_or_not() {
        let mut random = Random(5);
        let mut agreed = [0; 2];
        for k in 0..4000 {
            let (rough, uneven): (f64, f64) = ([1.0, 2.0][k % 2], [0.2, 1.5][k / 2 % 2]);
            let mut shares = vec![Share::default(); 21];
            for x in &mut shares {
                let information = (uneven * random.gauss()).exp();
                let score = rough * random.gauss() * information.sqrt();
                x.add([score, information, 10.0 * rough.min(1.2), 10.0]);
            }
            if k % 5 == 0 {
                let sigma = shares[3].information.sqrt();
                shares[3].add([[4.4, 5.0, 20.0][k % 3] * sigma, 0.0, 0.0, 0.0]);
            }
            if k % 7 == 0 {
                shares[4] = Share::default();
            }
            let found = agree(&shares, &mut vec![]);
            assert_eq!(found, plainly(&shares), "{k}: {shares:?}");
            agreed[usize::from(found)] += 1;
        }
        assert!(agreed.iter().all(|n| *n > 400), "{agreed:?}");
    }
}
