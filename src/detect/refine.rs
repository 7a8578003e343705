//! From a rough ellipse to independent edge points with honest sigmas.
//!
//! 1. Cut the contour into sectors of about 1.75 px ([`crate::detect::contour`]); sum up what the pixels around it say, each in exactly
//!    one sector ([`crate::detect::sectors`]), so that the sectors are independent.
//! 2. Solve for geometry, blur and light together ([`crate::detect::edge_model`]); the light as rich as the image asks.
//! 3. Drop sectors that disagree (glare, shadow, another object) and solve again from the same sums.
//! 4. In each sector the shift of the edge along the normal, light and blur held: with residual `r`, weight `w` and response
//!    `h = d(model)/d(shift)`, `shift = sum w r h / sum w h^2`, `sigma = (sum w h^2)^(-1/2)` (its Fisher information), times
//!    the root of what noise that neighbouring pixels share makes of it ([`crate::detect::correlation`]).
//! 5. The disc's ellipse is the geometric fit through these edge points, its covariance that of step 2 with blur and light integrated out. Where points
//!    scatter more than the grey noise says (rough prints, speckle), all discs of an image tell by how much ([`crate::detect::rough`]).
//!
//! Steps 1 and 2 are repeated from the ellipse found until it stands still; two or three rounds suffice. Blur and light are common to
//! all sectors: what their uncertainty adds to the geometry stands in the covariance of the ellipse, and what edge points have in common by it in
//! [`ContourNoise`]; their sigmas are those of each for itself.

mod pixels;
mod start;
mod told;

use crate::conic::{ContourNoise, Ellipse, Feet, covariance_from_regular, fit_geometric_from, to_regular};
use crate::detect::band::{Band, Reach};
use crate::detect::contour::Contour;
use crate::detect::correlation::NoiseCorrelation;
use crate::detect::edge_model::{EdgeModel, Solution};
use crate::detect::exact::{Exact, State};
use crate::detect::light::{self, Light, Side};
use crate::detect::quick::Quick;
use crate::detect::sectors::{Lens, Sectors};
use crate::detect::slim::is_slim;
use crate::detect::{DetectOptions, Disc, EdgePoints, RejectionReason};
use crate::image::{GrayView, Samples};
use crate::stats::{SIGMA_OVER_MEDIAN, median};
use crate::target::Polarity;
use nalgebra::SMatrix;
use pixels::{Exactly, clean_disc, fit_exactly};
pub(crate) use start::Start;
pub(crate) use told::{noise_told, shape_told, smoke_told};

/// Rounds at most: a disc that is not still by then is judged as it is.
const MOST_ROUNDS: usize = 10;
/// A change of the geometry below this ends the rounds, px: what is left of it is of third order in the ratio to the blur.
const STILL_PX: f64 = 0.02;
/// How many times the way that a disc may move, and its semi-minor axis as a blur, tell that it is lost.
const STRAYED: f64 = 8.0;
const BLURRED: f64 = 3.0;

/// Buffers reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    band: Band,
    contour: Contour,
    sectors: Sectors,
    found: Solution,
    sorted: Vec<f64>,
    exact: Exact,
    fine: Contour,
    quick: Quick,
    feet: Feet,
    /// What the longer way came to, where there was neither smoke nor anything hidden, and whether its edge was like no Gaussian's.
    plain: Option<(State, bool)>,
}

/// Refines one disc, or says why it is none.
pub(crate) fn refine(
    view: &GrayView,
    start: &Start,
    options: &DetectOptions,
    s: &mut Scratch,
) -> Result<Disc, RejectionReason> {
    if let Some(disc) = clean_disc(view, start, options, s) {
        return disc;
    }
    let mut model = rough_model(view, start, s)?;
    let mut smoke = false;
    for round in 0..MOST_ROUNDS {
        if border_px(view, &model.ellipse) < 1.0 {
            return Err(RejectionReason::CutByBorder);
        }
        look(view, &model, start, fine_reach(&model, start), s);
        let (weighed, bends) = (model.variance, model.bends);
        let coverage = fit_light(start, &mut model, options, smoke, s)?;
        // The sums must have been made with about the right weights.
        let alike = |side: usize| (0.75..1.33).contains(&(model.variance[side] / weighed[side]));
        let bent_alike = (bends == [0.0; 2]) == (model.bends == [0.0; 2]);
        let still = alike(0) && alike(1) && bent_alike && s.found.change.iter().all(|x| x.abs() < STILL_PX);
        let last = round + 1 == MOST_ROUNDS;
        if still || last {
            check_size(&model, start, options)?;
            // One sector more or less is chance: on a small dot it is a good part of the contour.
            if coverage + 1.0 / (s.sectors.len() as f64) < options.min_coverage {
                return Err(RejectionReason::Incomplete { coverage });
            }
            let moved = moved(&model, start, s)?;
            let (found, edge) = match fit_exactly(view, &moved, start, s) {
                Some(Exactly::Fitted(found, edge)) => (*found, edge),
                Some(Exactly::Smoke) if !smoke && !last => {
                    smoke = true;
                    continue;
                }
                _ => by_sectors(&moved, s)?,
            };
            return accept(&found, edge, &moved, start, options, &mut s.feet);
        }
        model = moved(&model, start, s)?;
    }
    Err(not_elliptical(f64::INFINITY, model.ellipse.semi_minor_px))
}

fn not_elliptical(model_rms_px: f64, limit_px: f64) -> RejectionReason {
    RejectionReason::NotElliptical { rms_px: model_rms_px, limit_px }
}

fn moved(model: &EdgeModel, start: &Start, s: &Scratch) -> Result<EdgeModel, RejectionReason> {
    let next = model.moved(&s.found, model.blur_px + 0.3);
    let next = next.ok_or_else(|| not_elliptical(f64::INFINITY, model.ellipse.semi_minor_px))?;
    check_course(&next, start)?;
    Ok(next)
}

/// Cuts the contour, collects the band and sums it up.
fn look(view: &GrayView, model: &EdgeModel, start: &Start, reach: Reach, s: &mut Scratch) {
    s.contour.cut(&model.ellipse, start.neighbours);
    s.band.collect(view, &model.ellipse, &s.contour, reach);
    let ground = s.band.grey.get(s.band.len() / 2).copied().unwrap_or(0.0);
    let lens = Lens { blur_px: model.blur_px, variance: model.variance, bends: model.bends, step: model.step, ground };
    s.sectors.sum_up(&s.band, &s.contour, &lens);
}

fn solve(model: &EdgeModel, s: &mut Scratch) -> Result<(), RejectionReason> {
    let solved = model.solve(&s.contour, &s.sectors, &mut s.found);
    solved.then_some(()).ok_or_else(|| not_elliptical(f64::INFINITY, model.ellipse.semi_minor_px))
}

/// Light that rises across the disc, narrow band: brings the ellipse within a fraction of the blur.
fn rough_model(view: &GrayView, start: &Start, s: &mut Scratch) -> Result<EdgeModel, RejectionReason> {
    let (_, blur_px) = start.contour();
    let mut model = EdgeModel {
        ellipse: start.ellipse,
        blur_px,
        expected_blur_px: blur_px,
        light: Light::Surface([Side::plain(1, 1.0); 2]),
        // Weights in units of the contrast, until the noise is known.
        variance: [(0.05 * start.contrast).powi(2).max(1e-300); 2],
        bends: [0.0; 2],
        step: start.step(),
    };
    for _ in 0..MOST_ROUNDS {
        let wanted = 2.5 * model.blur_px + 1.0;
        look(view, &model, start, Reach { inner_px: wanted.min(start.inner_px), outer_px: wanted }, s);
        let pixels: u32 = s.sectors.pixels.iter().sum();
        if pixels < 20 {
            return Err(RejectionReason::TooSmall { semi_minor_px: start.ellipse.semi_minor_px });
        }
        model.step = screen(s);
        if (model.step > 0.0) != start.bright || model.step == 0.0 {
            return Err(RejectionReason::LowContrast { contrast_to_noise: 0.0 });
        }
        s.found.step.clear();
        s.found.step.resize(s.contour.len(), model.step);
        model.light = Light::Surface([Side::plain(1, model.step.abs()); 2]);
        solve(&model, s)?;
        let largest = s.found.change.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        model = moved(&model, start, s)?;
        if largest < 0.4 * model.blur_px {
            break;
        }
    }
    Ok(model)
}

/// Sets aside sectors without the step that the others show (glare, another object): a solve would follow them. Returns the typical step.
fn screen(s: &mut Scratch) -> f64 {
    let count = s.sectors.len();
    s.sorted.clear();
    s.sorted.extend((0..count).filter_map(|k| s.sectors.own_step(k)));
    let Some(typical) = median(&mut s.sorted) else { return 0.0 };
    let alike = |k: usize| s.sectors.own_step(k).is_some_and(|x| (0.35..2.8).contains(&(x / typical)));
    // Where hardly any sector shows the step the start is bad, and a selection would only fix its error.
    if (0..count).filter(|k| alike(*k)).count() * 2 >= count {
        let keep: Vec<bool> = (0..count).map(alike).collect();
        s.sectors.keep = keep;
    }
    typical
}

/// Light as rich as the image asks, or nodes where there is `smoke`, noise from what it leaves, sectors that disagree dropped. Returns the share of those that stay.
fn fit_light(
    start: &Start,
    model: &mut EdgeModel,
    options: &DetectOptions,
    smoke: bool,
    s: &mut Scratch,
) -> Result<f64, RejectionReason> {
    model.step = screen(s);
    s.found.step.clear();
    s.found.step.resize(s.contour.len(), model.step);
    model.light = light::choose(&s.contour, &mut s.sectors, model.step, [smoke, start.full_of_smoke]);
    solve(model, s)?;
    let mut before = 1.0;
    for _ in 0..3 {
        let coverage = drop_sectors(s);
        if coverage < 0.5 * options.min_coverage {
            return Err(RejectionReason::Incomplete { coverage });
        }
        // With the steps of the light itself, and without the sectors that disagree.
        solve(model, s)?;
        if coverage > before - 0.03 {
            before = coverage;
            break;
        }
        before = coverage;
        model.light = light::choose(&s.contour, &mut s.sectors, model.step, [smoke, start.full_of_smoke]);
    }
    estimate_noise(start, model, s);
    model.bends = model.light.bends();
    Ok(before)
}

/// How far from the edge the fine fit looks, px.
pub(crate) fn reach_px(blur_px: f64) -> f64 {
    3.0 * blur_px + 0.7 + (2.0 * blur_px).max(3.0)
}

/// Band of the fine fit: the edge, and beside it what fixes the light.
fn fine_reach(model: &EdgeModel, start: &Start) -> Reach {
    let wanted = reach_px(model.blur_px);
    Reach { inner_px: wanted.min(start.inner_px).min(0.85 * model.ellipse.semi_minor_px), outer_px: wanted }
}

/// Least distance of the ellipse from the outermost pixel centres, px; negative where it leaves the image.
pub(crate) fn border_px(view: &GrayView, e: &Ellipse) -> f64 {
    let (s, c) = e.angle_rad.sin_cos();
    let half_width = (e.semi_major_px * c).hypot(e.semi_minor_px * s);
    let half_height = (e.semi_major_px * s).hypot(e.semi_minor_px * c);
    let (u, v) = (e.center_px.u_px, e.center_px.v_px);
    let (u_last, v_last) = (view.width() as f64 - 1.0, view.height() as f64 - 1.0);
    (u - half_width).min(u_last - u - half_width).min(v - half_height).min(v_last - v - half_height)
}

/// How far place and axes have moved from where they started, and how far they may, px.
fn moved_px(model: &EdgeModel, start: &Start) -> (f64, f64) {
    let (e, e0) = (&model.ellipse, &start.ellipse);
    let shift = (e.center_px.u_px - e0.center_px.u_px).hypot(e.center_px.v_px - e0.center_px.v_px);
    let ahead = if is_slim(e0) { (e0.semi_major_px - start.contour().0.semi_major_px).max(0.0) } else { 0.0 };
    let major = (e.semi_major_px - e0.semi_major_px).max(e0.semi_major_px - ahead - e.semi_major_px);
    let axes = major.max((e.semi_minor_px - e0.semi_minor_px).abs());
    (shift.max(axes), 0.5 * e0.semi_minor_px + 1.0)
}

/// Gives up what has moved or blurred so far that it does not come back: it would go on to look at much of the image, round after round.
fn check_course(model: &EdgeModel, start: &Start) -> Result<(), RejectionReason> {
    let (gap, limit_px) = moved_px(model, start);
    let blurred = model.blur_px > BLURRED * start.ellipse.semi_minor_px.max(start.blur_px);
    if gap > STRAYED * limit_px {
        return Err(not_elliptical(gap, limit_px));
    }
    if blurred { Err(RejectionReason::TooSmall { semi_minor_px: 0.0 }) } else { Ok(()) }
}

fn check_size(model: &EdgeModel, start: &Start, options: &DetectOptions) -> Result<(), RejectionReason> {
    let e = &model.ellipse;
    if e.semi_minor_px < options.min_semi_minor_px {
        return Err(RejectionReason::TooSmall { semi_minor_px: e.semi_minor_px });
    }
    let (gap, limit_px) = moved_px(model, start);
    if gap > limit_px {
        return Err(not_elliptical(gap, limit_px));
    }
    if model.blur_px > 0.9 * e.semi_minor_px {
        return Err(RejectionReason::TooSmall { semi_minor_px: 0.0 });
    }
    let noise = (0.5 * (model.variance[0] + model.variance[1])).sqrt();
    let contrast_to_noise = model.step.abs() / noise;
    if (model.step > 0.0) != start.bright || contrast_to_noise < options.min_contrast_to_noise {
        return Err(RejectionReason::LowContrast { contrast_to_noise });
    }
    Ok(())
}

/// Smallest noise variance that samples of this kind can have, grey^2.
pub(crate) fn quantisation(view: &GrayView) -> f64 {
    match view.samples() {
        Samples::U8(_) | Samples::U16(_) => 1.0 / 12.0,
        Samples::F32(_) => 0.0,
    }
}

/// Noise variance inside and outside: not below the quantisation, nor far apart: a clipped ground has no noise at all, yet it must
/// not outweigh the flank of the edge.
fn estimate_noise(start: &Start, model: &mut EdgeModel, s: &mut Scratch) {
    let found = match light::noise(&s.sectors, &model.light, &s.found, model.step, &mut s.sorted) {
        [Some(a), Some(b)] => [a, b],
        [Some(a), None] | [None, Some(a)] => [a, a],
        [None, None] => {
            let (mut sum, mut pixels) = (0.0, 0.0);
            for k in (0..s.sectors.len()).filter(|k| s.sectors.keep[*k]) {
                sum += residual(s, k).1;
                pixels += f64::from(s.sectors.pixels[k]);
            }
            // The sums are weighted with the variances they were made with, which differ little here.
            let factor = sum / f64::max(pixels - 10.0, 1.0);
            model.variance.map(|v| v * factor)
        }
    };
    let floor = start.quantisation.max((1e-4 * model.step).powi(2));
    let least = floor.max(found[0].max(found[1]) / 16.0);
    model.variance = found.map(|x| x.max(least));
}

/// Score of a further shift of a sector's edge, 1/px, and its weighted sum of squared residuals.
fn residual(s: &Scratch, k: usize) -> (f64, f64) {
    let (normal, right) = s.sectors.local(k, s.found.step[k]);
    let local = s.found.local(k);
    let left = right - normal * local;
    let squares = s.sectors.squares(k) - local.dot(&(right + left));
    (left[0], squares.max(0.0))
}

/// Marks the sectors that disagree with the rest; returns the share that stays.
fn drop_sectors(s: &mut Scratch) -> f64 {
    let count = s.sectors.len();
    let information: Vec<f64> = (0..count).map(|k| s.sectors.information(k, s.found.step[k])).collect();
    let left: Vec<(f64, f64)> = (0..count).map(|k| residual(s, k)).collect();
    let each = |k: usize| (left[k].0 / information[k], left[k].1 / f64::from(s.sectors.pixels[k].max(1)));
    let mut of_kept = |f: &dyn Fn(usize) -> f64| {
        s.sorted.clear();
        s.sorted.extend((0..count).filter(|k| information[*k] > 0.0).map(f));
        median(&mut s.sorted).unwrap_or(0.0)
    };
    let typical = of_kept(&|k| information[k]);
    let shift = SIGMA_OVER_MEDIAN * of_kept(&|k| each(k).0.abs());
    let misfit = of_kept(&|k| each(k).1);
    let shift_limit = 4.5 * shift.max(typical.powf(-0.5));
    let keep: Vec<bool> = (0..count)
        .map(|k| {
            let enough = information[k] > 0.15 * typical && information[k] > 0.0;
            let (off, spread) = each(k);
            let pixels = f64::from(s.sectors.pixels[k].max(1));
            !s.sectors.hidden[k]
                && enough
                && off.abs() < shift_limit
                && spread < misfit.max(1.0) * (2.0 + 5.0 * (2.0 / pixels).sqrt())
        })
        .collect();
    s.sectors.keep = keep;
    s.sectors.keep.iter().filter(|k| **k).count() as f64 / count as f64
}

/// What a fit says about the disc as a whole.
struct Found {
    ellipse: Ellipse,
    blur_px: f64,
    /// Of the regular coordinates, whatever blur and light are.
    covariance: SMatrix<f64, 5, 5>,
    /// Whether the light was followed along the contour: then it has taken some of what bends the contour off an ellipse for light.
    followed: bool,
}

/// The ellipse through the edge points that the sums over sectors give, with the covariance of the fit: blur and light move all of them
/// together, along flat sides most, which points by themselves do not tell.
fn by_sectors(model: &EdgeModel, s: &Scratch) -> Result<(Found, EdgePoints), RejectionReason> {
    let edge = sector_edges(s);
    let ellipse = fit_geometric_from(&model.ellipse, &edge.u_px, &edge.v_px, &edge.sigma_px)
        .map_err(|_| not_elliptical(f64::INFINITY, model.ellipse.semi_minor_px))?
        .ellipse;
    Ok((
        Found {
            ellipse,
            blur_px: model.blur_px,
            covariance: *s.found.covariance(),
            followed: matches!(model.light, Light::Nodes(..)),
        },
        edge,
    ))
}

/// Edge points from the sums over sectors.
fn sector_edges(s: &Scratch) -> EdgePoints {
    let (contour, found) = (&s.contour, &s.found);
    let mut edge = EdgePoints::default();
    for k in (0..s.sectors.len()).filter(|k| s.sectors.keep[*k]) {
        let information = s.sectors.information(k, found.step[k]);
        let shift = found.shift[k] + residual(s, k).0 / information;
        edge.u_px.push(contour.u[k] + shift * contour.normal_u[k]);
        edge.v_px.push(contour.v[k] + shift * contour.normal_v[k]);
        edge.sigma_px.push(information.powf(-0.5));
    }
    edge
}

/// Widens the sigmas of edge points by the noise that their pixels have in common; returns by how much that of the ellipse grows, as a variance.
fn share_noise(e: &Ellipse, edge: &mut EdgePoints, noise: &NoiseCorrelation, blur_px: f64) -> f64 {
    if noise.is_none() {
        return 1.0;
    }
    let (sin, cos) = e.angle_rad.sin_cos();
    let (mut information, mut widened) = (0.0, 0.0);
    for i in 0..edge.sigma_px.len() {
        let (du, dv) = (edge.u_px[i] - e.center_px.u_px, edge.v_px[i] - e.center_px.v_px);
        let x = (cos * du + sin * dv) / (e.semi_major_px * e.semi_major_px);
        let y = (cos * dv - sin * du) / (e.semi_minor_px * e.semi_minor_px);
        let length = x.hypot(y).max(f64::MIN_POSITIVE);
        let kappa = noise.inflation([(cos * x - sin * y) / length, (sin * x + cos * y) / length], blur_px);
        let weight = edge.sigma_px[i].powi(-2);
        information += weight;
        widened += weight * kappa;
        edge.sigma_px[i] *= kappa.sqrt();
    }
    if information > 0.0 { widened / information } else { 1.0 }
}

/// Whether the standard deviations of place and axes are below a limit.
pub(crate) fn is_known(covariance: &SMatrix<f64, 5, 5>, limit_px: f64) -> bool {
    (0..4).all(|i| covariance[(i, i)] > 0.0 && covariance[(i, i)] < limit_px * limit_px)
}

/// Checks the shape and makes a disc of what was found.
fn accept(
    found: &Found,
    mut edge: EdgePoints,
    model: &EdgeModel,
    start: &Start,
    options: &DetectOptions,
    feet: &mut Feet,
) -> Result<Disc, RejectionReason> {
    let e = &found.ellipse;
    // What the grey noise explains is no sign of another shape.
    let count = edge.sigma_px.len() as f64;
    let noise_px2 = edge.sigma_px.iter().map(|s| s * s).sum::<f64>() / count;
    feet.find(e, &edge.u_px, &edge.v_px);
    let squares: f64 = feet.distance.iter().map(|d| d * d).sum();
    let (ellipse, rms_px) = (*e, (squares / count).sqrt());
    let shape_px = options.most_rms_px(&ellipse);
    // Noise that explains any scatter says nothing of a shape either: place and size must be known within the same limit.
    let own = covariance_from_regular(&to_regular(e), &found.covariance);
    if !is_known(&own, shape_px) {
        return Err(not_elliptical(f64::INFINITY, shape_px));
    }
    let limit_px = shape_px.hypot(noise_px2.sqrt());
    if rms_px > limit_px {
        return Err(not_elliptical(rms_px, limit_px));
    }
    let common = share_noise(&ellipse, &mut edge, start.noise, found.blur_px);
    let (regular, covariance) = (found.covariance * common, own * common);
    let contour = ContourNoise::of(&feet.normal(&edge.sigma_px), &regular, found.followed);
    Ok(Disc {
        ellipse,
        covariance,
        edge,
        contour,
        polarity: if start.bright { Polarity::Bright } else { Polarity::Dark },
        blur_px: found.blur_px,
        contrast: model.step.abs(),
        mark: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Pixel;

    /// A disc comes back from some way off; one that is lost would make the band the whole image.
    #[test]
    fn what_strays_far_is_given_up() {
        let ellipse =
            Ellipse { center_px: Pixel::new(50.0, 60.0), semi_major_px: 5.0, semi_minor_px: 4.0, angle_rad: 0.2 };
        let start = Start { bright: true, contrast: 50.0, clear: true, ..Start::alone(ellipse) };
        let course = |shift_px: f64, semi_minor_px: f64, blur_px: f64| {
            let center_px = Pixel::new(50.0 + shift_px, 60.0);
            let light = Light::Surface([Side::plain(1, 50.0); 2]);
            let (variance, bends, step) = ([1.0; 2], [0.0; 2], 50.0);
            let ellipse = Ellipse { center_px, semi_minor_px, ..ellipse };
            check_course(&EdgeModel { ellipse, blur_px, expected_blur_px: 1.0, light, variance, bends, step }, &start)
        };
        // May move by 3 px in the end.
        assert!(course(20.0, 4.0, 1.0).is_ok() && course(0.0, 0.01, 1.0).is_ok() && course(0.0, 4.0, 11.0).is_ok());
        for lost in [course(25.0, 4.0, 1.0), course(0.0, 29.0, 1.0)] {
            assert!(matches!(lost, Err(RejectionReason::NotElliptical { rms_px, .. }) if rms_px > 12.0), "{lost:?}");
        }
        let blurred = course(0.0, 4.0, 13.0);
        assert!(matches!(blurred, Err(RejectionReason::TooSmall { semi_minor_px: 0.0 })), "{blurred:?}");
    }
}
