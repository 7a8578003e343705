//! The rounds of the check.

use super::acquire::{Acquired, Binned, MOST_PLANES, SIGNIFICANT, acquire, factor, furthest_mm};
use super::cameras::{Prior, Update, with_sigmas};
use super::light::{Light, light};
use super::masks::Mask;
use super::misalignment::misalignment;
use super::plane::{Match, cameras_held, moved_sheet, see};
use super::prepare::{SATURATED, levels, saturated_part};
use super::propagate::{Propagated, against, against_by_plane, propagate};
use super::round::{FEWEST, Moment, Round, Series, maps_of, measure};
use super::still::{self, without_mean};
use crate::dewarp::{Kernel, Sampler, SheetGrid, SheetMap};
use crate::error::{Insufficient, Invalid, Result};
use crate::frames::{Rig, Sheet};
use crate::image::GrayView;
use crate::record::{CheckRound, DisparityMap, Misalignment, Pose, Record, SheetCheck};
use crate::rigid::Motion;
use crate::sheet::Placement;
use nalgebra::{Matrix3, Matrix6, Vector3};
use rayon::prelude::*;

/// Rounds at most.
const ROUNDS: usize = 12;
/// The rounds end when the plane's disparity changes by less, px.
const STILL_PX: f64 = 0.002;
/// Or moves by less than this part of its sigma (windows at the limit of being used come and go).
const STILL_SIGMAS: f64 = 0.3;
/// Fewer windows do not tell how much they scatter.
const FEW_WINDOWS: usize = 20;
/// Where and what is noted of cameras that particles refined.
const CAMERAS: &str = "cameras";
const CAMERAS_REFINED: &str = ", cameras refined with it";
/// Rounds for the cameras at most.
const CAMERA_ROUNDS: usize = 8;
/// They end when nothing moves by more than this part of its sigma: windows at the limit of being used come and go.
const STILL_CAMERAS: f64 = 0.5;
/// Smooth disparity beyond which the sheet (along the direction of depth) and the cameras (across it) are off, px ...
const OFF_PX: [f64; 2] = [0.5, 0.3];
/// ... where it is this many times what scatter alone would show.
const OVER_NOISE: f64 = 3.0;

/// Options of [`check_sheet`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckOptions {
    /// Side of a window, px of the dewarped image.
    pub window_px: usize,
    /// Largest offset that is looked for, mm; a tenth of the field's larger side where not given.
    pub search_mm: Option<f64>,
    /// Whether the sheet is to be corrected.
    pub refine: bool,
    /// Whether the cameras are to be corrected with it, weighed against the calibration's covariance.
    pub refine_cameras: bool,
    /// Whether the mean of all images of a camera is taken off each, pixel by pixel: walls and reflections stand still.
    pub subtract_mean: bool,
    /// Point of the starting sheet at which its offset is reported, its frame, mm.
    pub reference_mm: [f64; 2],
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self {
            window_px: 64,
            search_mm: None,
            refine: false,
            refine_cameras: false,
            subtract_mean: false,
            reference_mm: [0.0; 2],
        }
    }
}

/// Images of both cameras of one moment.
#[derive(Debug, Clone)]
pub struct ParticlePair<'a> {
    /// First and second camera.
    pub images: [GrayView<'a>; 2],
    /// Their names in messages.
    pub names: [String; 2],
}

/// What the check gives.
#[derive(Debug, Clone)]
pub struct CheckOutput {
    /// Maps, history, sheet, thickness.
    pub check: SheetCheck,
    /// The calibration with the corrected sheet, where it was asked for.
    pub record: Option<Record>,
}

/// Checks the record's sheet on particle images, and corrects it where the options ask for it.
///
/// Work is shared by the threads of the pool in which this is called; the bits do not depend on their number.
///
/// # Errors
/// [`Invalid`] for a calibration without two cameras or a sheet, or other image sizes; [`Insufficient`] where the images are flat,
/// saturated, or show no common particles.
pub fn check_sheet(record: &Record, pairs: &[ParticlePair], options: &CheckOptions) -> Result<CheckOutput> {
    check_sheet_masked(record, pairs, [None, None], options)
}

/// As [`check_sheet`], where the masks of the first and the second camera allow it: pixels that are 0 in a mask of the size of the camera's images are
/// left out of all of them (a model, a wall, reflections), those within reach of interpolation with them.
///
/// # Errors
/// Those of [`check_sheet`]; [`Invalid`] for a mask of another size, [`Insufficient`] for one that leaves nothing.
pub fn check_sheet_masked(
    record: &Record,
    pairs: &[ParticlePair],
    masks: [Option<GrayView>; 2],
    options: &CheckOptions,
) -> Result<CheckOutput> {
    let maps = maps_of(record)?;
    let [first, second] = &maps;
    let mask = |c: usize| -> Result<Option<Mask>> {
        masks[c].map(|view| Mask::of(&view, maps[c].size_px(), &record.cameras[c].name)).transpose()
    };
    let masks = &[mask(0)?, mask(1)?];
    let mut flags = vec![];
    check_images(pairs, &maps, masks, &mut flags)?;
    let less = if options.subtract_mean { Some(without_mean(pairs)?) } else { None };
    let less: Option<Vec<ParticlePair>> = less.as_ref().map(|less| {
        let views = less.iter().map(|l| [l[0].view(), l[1].view()]);
        views.zip(pairs).map(|(images, p)| ParticlePair { images, names: p.names.clone() }).collect()
    });
    let pairs = less.as_deref().unwrap_or(pairs);
    if !(16..=512).contains(&options.window_px) {
        return Err(Invalid::value("window", options.window_px as f64, "16 to 512 px").into());
    }
    if options.refine_cameras && !options.refine {
        let what = "the cameras can only be refined together with the sheet; say --refine as well";
        return Err(Invalid::Contradiction(what.into()).into());
    }
    let prior = if options.refine_cameras { Some(Prior::of(record)?) } else { None };
    let grid = SheetGrid::common(&[first, second], None)?;
    let found = coarse_plane([first, second], pairs, masks, &grid, options)?;
    let moments = pairs
        .par_iter()
        .map(|p| Moment { samplers: p.images.each_ref().map(|i| Sampler::new(i, Kernel::Cubic)) })
        .collect();
    let series = Series { moments, masks };
    let mut history = vec![];
    let start = moved(record, &found.plane, &Matrix6::zeros(), &own_placement(record)?)?;
    let (mut current, mut result, mut converged) = refine_plane(record, start, &series, &grid, options, &mut history)?;
    if options.refine && !converged {
        flags.push(format!("the plane still moves after {ROUNDS} rounds; more image pairs would hold it"));
    }
    let refined = match &prior {
        Some(prior) => Some(refine_cameras(record, prior, current.clone(), &series, options, &mut history)?),
        None => None,
    };
    let refined = refined.map(|r| {
        converged = converged && r.still;
        if !r.still {
            flags
                .push(format!("the cameras still move after {CAMERA_ROUNDS} rounds; more image pairs would hold them"));
        }
        (current, result) = (r.now, r.round);
        (r.reference, r.update)
    });
    let mut reference = record.clone();
    let mut shared = None;
    let mut cameras_refined = None;
    if let (Some(prior), Some((moved, update))) = (&prior, refined) {
        shared = prior.propagated(record, &moved, &current, &update, options.reference_mm);
        let after = shared.as_ref().map_or(&record.covariance, |s| &s.covariance);
        cameras_refined = Some(prior.told(record, after, &update, &mut flags));
        reference = moved;
    }
    let ends = [record, &reference];
    let light = light(&current, &series, options.window_px)?;
    flags.extend(light.flags());
    flags.extend(still::flag(&current, &series, options.window_px)?);
    flags.extend(few_windows(&result));
    flags.extend(refined_before(record).filter(|_| options.refine_cameras));
    let mut out = output(ends, current, pairs, result, history, &found, converged, options, shared, light, flags)?;
    out.check.cameras_refined = cameras_refined;
    let masked = masks.iter().any(Option::is_some);
    if let Some(corrected) = &mut out.record {
        note(corrected, &out.check, masked, options);
    }
    Ok(out)
}

/// Notes in a corrected calibration where its sheet is from, and what was flagged.
fn note(corrected: &mut Record, check: &SheetCheck, masked: bool, options: &CheckOptions) {
    let how = match (options.refine_cameras, check.sigmas_hold_calibration) {
        (true, _) => CAMERAS_REFINED,
        (false, true) => "",
        (false, false) => ", cameras held",
    };
    let without = match (masked, options.subtract_mean) {
        (true, true) => ", masked, less their mean",
        (true, false) => ", masked",
        (false, true) => ", less their mean",
        (false, false) => "",
    };
    let from = format!("self-calibration on {} particle image pair(s){without}{how}", check.pairs.len());
    if options.refine_cameras {
        corrected.provenance.options.insert(CAMERAS.into(), format!("refined: {from}"));
    }
    corrected.provenance.options.insert("sheet".into(), from);
    corrected.fit.forget_check_flags();
    corrected.fit.keep_check_flags(&check.flags);
}

/// Rounds for the plane with the cameras held: the calibration with its sheet, the last round, and whether it came to rest.
fn refine_plane(
    start: &Record,
    mut current: Record,
    series: &Series,
    grid: &SheetGrid,
    options: &CheckOptions,
    history: &mut Vec<CheckRound>,
) -> Result<(Record, Round, bool)> {
    let placement = own_placement(start)?;
    // Coarse windows first, unless the field holds too few of them.
    let coarse = 2 * options.window_px;
    let enough = (grid.width_px / coarse) * (grid.height_px / coarse) >= 2 * FEWEST;
    for round in 0..ROUNDS {
        let fine = round > 0;
        let window = if fine || !enough { options.window_px } else { coarse };
        let result = measure(&current, series, window, fine)?;
        let abc = result.fit.abc;
        let step_sigmas = result.fit.covariance.try_inverse().map_or(f64::INFINITY, |w| abc.dot(&(w * abc)).sqrt());
        let next = moved(&current, &abc, &cameras_held(&result.fit.covariance), &placement)?;
        history.push(entry(start, &next, &result, window, options)?);
        current = next;
        let converged = fine && (result.step_px < STILL_PX || step_sigmas < STILL_SIGMAS);
        if converged || (!options.refine && fine) || round + 1 == ROUNDS {
            return Ok((current, result, converged));
        }
    }
    Err(crate::Error::Bug("no round of the check".into()))
}

/// Says so where windows are too few to tell how much they scatter.
fn few_windows(last: &Round) -> Option<String> {
    let count = last.fit.count();
    (count < FEW_WINDOWS).then(|| {
        format!(
            "the sheet stands on {count} windows: below {FEW_WINDOWS} their scatter is hardly known, and the sigmas with it; take more image pairs, or smaller \
             windows (--window-px)"
        )
    })
}

/// Says so where what the same images tell may be counted twice.
fn refined_before(record: &Record) -> Option<String> {
    record.provenance.options.get(CAMERAS).map(|_| {
        "particle images have refined the cameras of this calibration before: where these are the same images, what they tell is counted twice and the sigmas are \
         too small; start from the calibration of the target"
            .into()
    })
}

/// Cameras and plane at rest.
struct Refined {
    now: Record,
    /// The calibration with the new cameras and the sheet that was started from, moved along with them.
    reference: Record,
    round: Round,
    update: Update,
    still: bool,
}

/// Rounds for cameras and plane together, from the plane that was found with the cameras held.
fn refine_cameras(
    start: &Record,
    prior: &Prior,
    mut now: Record,
    series: &Series,
    options: &CheckOptions,
    history: &mut Vec<CheckRound>,
) -> Result<Refined> {
    let lost = || -> crate::Error {
        let what =
            "the windows do not fix cameras and plane together; leave out --refine-cameras, or give more image pairs";
        Insufficient::Degenerate(what.into()).into()
    };
    let mut w = prior.start();
    let mut place: Vector3<f64> = Vector3::zeros();
    for k in 1.. {
        let mut round = measure(&now, series, options.window_px, true)?;
        let update = prior.update(start, &now, &round.matches, &round.fit, &w).ok_or_else(lost)?;
        round.fit.abc = update.abc;
        let reference = prior.record_at(start, &update.w).ok_or_else(lost)?;
        let mut next = reference.clone();
        next.sheet.clone_from(&now.sheet);
        let sheet = prior.carried(start, [&w, &update.w], &pose(&now)?).ok_or_else(lost)?;
        if let Some(s) = &mut next.sheet {
            s.rig_from_sheet = Pose::from(&sheet);
        }
        let placement = Prior::placement(start, &reference).map_or_else(|| own_placement(&next), Ok)?;
        now = moved(&next, &update.abc, &cameras_held(&round.fit.covariance), &placement)?;
        history.push(entry(&reference, &now, &round, options.window_px, options)?);
        // At rest when neither cameras nor the light's place change by more than their sigmas allow.
        let sigmas = prior.propagated(start, &reference, &now, &update, options.reference_mm).map(|p| p.against_start);
        let e = against(&pose(&reference)?, &pose(&now)?, options.reference_mm);
        let moves = |a: usize| match &sigmas {
            Some(c) => (e[a] - place[a]).abs() > STILL_CAMERAS * c[(a, a)].max(0.0).sqrt(),
            None => false,
        };
        let still = k > 1 && (&update.w - &w).amax() < STILL_CAMERAS && !(0..3).any(moves);
        place = e;
        w.clone_from(&update.w);
        if still || k >= CAMERA_ROUNDS {
            return Ok(Refined { now, reference, round, update, still });
        }
    }
    Err(crate::Error::Bug("no round of the cameras".into()))
}

fn check_images(
    pairs: &[ParticlePair],
    maps: &[SheetMap; 2],
    masks: &[Option<Mask>; 2],
    flags: &mut Vec<String>,
) -> Result<()> {
    if pairs.is_empty() {
        return Err(Invalid::Contradiction("no image pair was given; name the images of both cameras".into()).into());
    }
    for pair in pairs {
        for c in 0..2 {
            let (image, name) = (&pair.images[c], &pair.names[c]);
            if [image.width(), image.height()] != maps[c].size_px() {
                let [w, h] = maps[c].size_px();
                let what = format!(
                    "{name}: the image is {} x {} px, but its camera was calibrated with {w} x {h} px",
                    image.width(),
                    image.height()
                );
                return Err(Invalid::Contradiction(what).into());
            }
            let part = saturated_part(image, masks[c].as_ref().map(Mask::used), name)?;
            if part > SATURATED {
                flags.push(format!(
                    "{name}: {:.2} % of the pixels are saturated; bright particles are cut off, so reduce the exposure",
                    100.0 * part
                ));
            }
        }
    }
    Ok(())
}

fn coarse_plane(
    maps: [&SheetMap; 2],
    pairs: &[ParticlePair],
    masks: &[Option<Mask>; 2],
    grid: &SheetGrid,
    options: &CheckOptions,
) -> Result<Acquired> {
    let by = factor(grid);
    let bin = |p: &ParticlePair| -> Option<[Binned; 2]> {
        let one = |c: usize| Binned::new(&levels(&p.images[c]), maps[c].size_px(), by, masks[c].as_ref());
        Some([one(0)?, one(1)?])
    };
    let binned: Option<Vec<[Binned; 2]>> = pairs.par_iter().map(bin).collect();
    let side = grid.mm_per_px * grid.width_px.max(grid.height_px) as f64;
    let search_mm = options.search_mm.unwrap_or(0.1 * side);
    if !(search_mm > 0.0 && search_mm.is_finite()) {
        return Err(Invalid::value("search", search_mm, "a positive length in mm").into());
    }
    let furthest_mm = furthest_mm(maps, grid).unwrap_or(f64::INFINITY);
    if search_mm > furthest_mm {
        let what = format!("at most {furthest_mm:.1} mm, {MOST_PLANES} planes that are a pixel of disparity apart");
        return Err(Invalid::value("search", search_mm, what).into());
    }
    let found = binned.and_then(|b| acquire(maps, &b, grid, search_mm));
    match found {
        Some(f) if f.significance > SIGNIFICANT => Ok(f),
        other => Err(Insufficient::Degenerate(format!(
            "no common particles: on no plane within {search_mm:.1} mm of the sheet are the images of both cameras alike (the best stands out by {:.1} \
             standard deviations, {SIGNIFICANT} are needed); check that left and right images are of the same moments and cameras, that \
             they show particles, or search further with --search-mm",
            other.map_or(0.0, |f| f.significance)
        ))
        .into()),
    }
}

/// How the frame of a record's sheet was placed.
fn own_placement(record: &Record) -> Result<Placement> {
    Ok(Placement::of_frame(&pose(record)?))
}

fn moved(record: &Record, abc: &Vector3<f64>, covariance: &Matrix6<f64>, placement: &Placement) -> Result<Record> {
    moved_sheet(record, abc, covariance, placement)
        .ok_or_else(|| crate::Error::Bug("a sheet was lost on the way".into()))
}

fn pose(record: &Record) -> Result<Motion<Rig, Sheet>> {
    let sheet = record.sheet.as_ref().ok_or_else(|| crate::Error::Bug("a sheet was lost on the way".into()))?;
    Ok(sheet.rig_from_sheet.motion())
}

/// Offset at the reference point, mm, and tilts about x and y, degrees.
fn offset_and_tilt(start: &Record, now: &Record, reference_mm: [f64; 2]) -> Result<(f64, [f64; 2])> {
    let e = against(&pose(start)?, &pose(now)?, reference_mm);
    Ok((e.x, [e.y.to_degrees(), e.z.to_degrees()]))
}

fn entry(start: &Record, next: &Record, r: &Round, window: usize, options: &CheckOptions) -> Result<CheckRound> {
    let (offset_mm, tilt_deg) = offset_and_tilt(start, next, options.reference_mm)?;
    Ok(CheckRound {
        window_px: window,
        windows: [r.matches.len(), r.windows],
        median_px: r.median_px,
        offset_mm,
        tilt_deg,
    })
}

/// Matches seen in a record's sheet.
fn map_in(record: &Record, matches: &[Match], used: &[bool], mm_per_px: f64) -> Result<DisparityMap> {
    let maps = maps_of(record)?;
    let mut out = DisparityMap::default();
    for (m, used) in matches.iter().zip(used) {
        let Some(s) = see([&maps[0], &maps[1]], m) else { continue };
        let place = s.point_mm.xy();
        out.x_mm.push(place.x);
        out.y_mm.push(place.y);
        out.dx_px.push(s.disparity_mm.x / mm_per_px);
        out.dy_px.push(s.disparity_mm.y / mm_per_px);
        out.across_px.push(s.across_mm / mm_per_px);
        out.z_mm.push(s.point_mm.z);
        out.correlation.push(m.correlation);
        out.peak_ratio.push(m.ratio);
        out.used.push(*used);
    }
    Ok(out)
}

/// What the map says must be looked at.
fn told(before: &Misalignment, now: &Misalignment, refine: bool, flags: &mut Vec<String>) {
    let off =
        |m: &Misalignment, a: usize| m.smooth_px[a] > OFF_PX[a] && m.smooth_px[a] > OVER_NOISE * m.smooth_noise_px[a];
    if off(now, 1) {
        flags.push(format!(
            "disparities of {:.2} px (root mean square, smooth over the field) across the direction of depth remain: no sheet explains them, the \
             cameras' calibration itself is off (moved camera, refraction)",
            now.smooth_px[1]
        ));
    }
    if off(now, 0) {
        flags.push(format!(
            "disparities of {:.2} px (root mean square, smooth over the field) along the direction of depth remain about the best plane: the light is \
             bent, a wall or reflections pass for particles (--masks leaves them out), or the cameras' calibration is off; a plane through it is a mean, \
             and vectors away from it are off",
            now.smooth_px[0]
        ));
    }
    // What is left about the best plane no correction takes away.
    let plane_px = (before.smooth_px[0].powi(2) - now.smooth_px[0].powi(2)).max(0.0).sqrt();
    if !refine && off(before, 0) && plane_px > OFF_PX[0] {
        flags.push(format!(
            "the sheet is off: disparities of {plane_px:.2} px (root mean square over the field) along the direction of depth are those of another \
             plane; run again with --refine and use the corrected calibration"
        ));
    }
}

#[allow(clippy::too_many_arguments)]
fn output(
    [start, reference]: [&Record; 2],
    corrected: Record,
    pairs: &[ParticlePair],
    last: Round,
    history: Vec<CheckRound>,
    found: &Acquired,
    converged: bool,
    options: &CheckOptions,
    refined: Option<Propagated>,
    light: Light,
    mut flags: Vec<String>,
) -> Result<CheckOutput> {
    let scale = last.grid.mm_per_px;
    let before = map_in(start, &last.matches, &last.fit.used, scale)?;
    let after = map_in(&corrected, &last.matches, &last.fit.used, scale)?;
    let (offset_mm, tilt_deg) = offset_and_tilt(reference, &corrected, options.reference_mm)?;
    // The covariance of the scatter lives in the last frame, which the found one differs from by less than a sigma.
    let by_plane = against_by_plane(&pose(reference)?, &pose(&corrected)?, options.reference_mm);
    let windows = by_plane * last.fit.covariance * by_plane.transpose();
    let shared = match refined {
        None if !options.refine_cameras => propagate(start, &corrected, &last.matches, &last.fit, options.reference_mm),
        refined => refined,
    };
    let whole = shared.as_ref().map_or(windows, |s| s.against_start);
    let sigma = |c: &Matrix3<f64>, k: usize| c[(k, k)].max(0.0).sqrt();
    let tilts = |c: &Matrix3<f64>| [sigma(c, 1).to_degrees(), sigma(c, 2).to_degrees()];
    let used = || (0..after.x_mm.len()).filter(|i| after.used[*i]);
    let n = used().count() as f64;
    let across_rms_px = (used().map(|i| after.across_px[i].powi(2)).sum::<f64>() / n).sqrt();
    let misaligned = [misalignment(&before, false), misalignment(&after, true)];
    told(&misaligned[0], &misaligned[1], options.refine, &mut flags);
    if shared.is_none() && start.covariance.shared_nullity() > 0 {
        flags.push(
            "the calibration leaves undetermined what the sheet depends on: sigmas here are those of the particles with the cameras held, and the \
             sheet has none; calibrate again with what the report of the calibration asks for"
                .into(),
        );
    }
    let check = SheetCheck {
        format: "spivcal-check".into(),
        version: 1,
        cameras: [start.cameras[0].name.clone(), start.cameras[1].name.clone()],
        pairs: pairs.iter().map(|p| p.names.clone()).collect(),
        mm_per_px: scale,
        significance: found.significance,
        before,
        after: options.refine.then_some(after),
        history,
        converged,
        reference_mm: options.reference_mm,
        offset_mm,
        tilt_deg,
        offset_sigma_mm: sigma(&whole, 0),
        tilt_sigma_deg: tilts(&whole),
        offset_sigma_windows_mm: sigma(&windows, 0),
        tilt_sigma_windows_deg: tilts(&windows),
        sigmas_hold_calibration: shared.is_some(),
        window_sigma_px: last.fit.scatter_mm / scale,
        across_rms_px,
        misalignment_before: misaligned[0],
        misalignment_after: options.refine.then_some(misaligned[1]),
        cameras_refined: None,
        thickness_mm: light.thickness_mm(),
        profile: light.profile,
        flags,
    };
    let record = options.refine.then(|| corrected_record(corrected, shared, options)).transpose()?;
    Ok(CheckOutput { check, record })
}

/// The calibration with the sheet's sigmas and rows of the covariance.
fn corrected_record(corrected: Record, shared: Option<Propagated>, options: &CheckOptions) -> Result<Record> {
    let mut r = corrected;
    if let Some(s) = shared {
        r = moved(&r, &Vector3::zeros(), &s.plane_and_center, &own_placement(&r)?)?;
        if options.refine_cameras {
            r = with_sigmas(r, &s.covariance);
        }
        r.covariance = s.covariance;
    } else {
        let c = &r.covariance;
        let kept: Vec<usize> = (0..c.names.len()).filter(|i| !c.names[*i].starts_with("sheet.")).collect();
        if c.shared_nullity() > 0 {
            r = moved(&r, &Vector3::zeros(), &Matrix6::repeat(f64::NAN), &own_placement(&r)?)?;
        }
        r.covariance = r.covariance.only(&kept);
    }
    r.forget_sheet();
    Ok(r)
}

#[cfg(test)]
mod tests {
    use super::super::misalignment::tests::{map, noise};
    use super::*;

    /// Flags of a map before and after the plane that it shows was taken out.
    fn flags(before: impl Fn(f64) -> f64, after: impl Fn(f64) -> f64, refine: bool) -> Vec<String> {
        let of = |f: &dyn Fn(f64) -> f64, refitted: bool| {
            misalignment(&map(|x, _, k| [f(x) + 0.1 * noise(k, 1), 0.1 * noise(k, 2)]), refitted)
        };
        let mut flags = vec![];
        told(&of(&before, false), &of(&after, true), refine, &mut flags);
        flags
    }

    #[test]
    fn what_no_plane_takes_away_is_told_whether_it_was_asked_for_or_not() {
        // Without a plane of its own over the twenty columns.
        let bow = |x: f64| 0.03 * (x * x - 33.25);
        for refine in [false, true] {
            let bent = flags(bow, bow, refine);
            assert!(bent.len() == 1 && bent[0].contains("bent"), "{bent:?}");
            let both = flags(|x| bow(x) + 2.0, bow, refine);
            assert!(both.iter().any(|f| f.contains("bent")), "{both:?}");
            assert_eq!(both.iter().any(|f| f.contains("--refine")), !refine, "{both:?}");
        }
        assert!(flags(|_| 0.0, |_| 0.0, false).is_empty());
        let off = flags(|x| 1.0 + 0.1 * x, |_| 0.0, false);
        assert!(off.len() == 1 && off[0].contains("--refine"), "{off:?}");
        assert!(flags(|x| 1.0 + 0.1 * x, |_| 0.0, true).is_empty());
    }
}
