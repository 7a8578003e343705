//! The paper's step alone: the cameras are known, the sheet is found from new views recorded in it.
//!
//! Which disc of a pair is which is not known across the cameras, nor whether the sheet lies between them. Each view and pairing proposes a
//! plane, with both cameras on one side of it and with one on each; the plane over which all views transfer best, each in its better pairing,
//! decides for all of them. Where another choice transfers about as well, that is
//! said instead of guessed.

use super::images::{SeenImage, see_all};
use super::residual_rows::found_shapes;
use super::sheet_part::common_features;
use super::workers::Workers;
use super::{Progress, Source};
use crate::bundle::DiscObservation;
use crate::camera::{Camera, INTRINSIC_NAMES};
use crate::diagnosis::mapping_of_record;
use crate::error::{Error, Insufficient, Invalid, Result};
use crate::record::{self, FeatureKind, Record, View};
use crate::report::OverlayShapes;
use crate::rig_file::{RigDescription, SheetOrigin};
use crate::sheet::{
    HeldCameras, Homography, PairFeatures, Placement, fit_homography, fit_placed_homography, transfer_residuals,
    triangulated_plane, with_frame_on_axis,
};
use crate::target::{DotId, Target};
use nalgebra::{DMatrix, Vector3};
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Transfer errors beyond this do not come from noise, px: the result is flagged.
pub const TRANSFER_LIMIT_PX: f64 = 1.0;
/// And beyond this many times what contours and cameras explain, where it is this much, px.
const SCATTER_LIMIT: f64 = 5.0;
const SCATTER_LIMIT_PX: f64 = 0.1;
/// Another pairing must transfer worse by this factor before the better one is believed.
const DISTINCT: f64 = 3.0;

/// Options of [`find_sheet`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SheetOptions {
    /// Threads; 0 takes as many as the machine has. Results do not depend on it.
    pub threads: usize,
}

/// What [`find_sheet`] gives.
#[derive(Debug, Clone)]
pub struct SheetOutput {
    /// The calibration with the new sheet; the views of the sheet stand behind those of the calibration.
    pub record: Record,
    /// The images with what was found in them; their `view` is that of the record.
    pub images: Vec<SeenImage>,
    /// What is drawn on each image; arrows in the second camera are transfer errors.
    pub overlays: Vec<OverlayShapes>,
}

/// One view of the sheet, seen by both cameras.
struct SheetView {
    /// View of the rig file.
    view: usize,
    /// Features with the labels as detected, and with those of the second camera exchanged (pairs only).
    choices: Vec<Vec<PairFeatures>>,
}

impl SheetView {
    /// The same with the sheet between the cameras.
    fn on_both_sides(&self) -> Self {
        let turned = |c: &Vec<PairFeatures>| c.iter().map(PairFeatures::on_both_sides).collect();
        Self { view: self.view, choices: self.choices.iter().map(turned).collect() }
    }
}

/// The sheet from the views of `job` with `sheet = true`, with the cameras of `calibration` held; their covariance is part of
/// the sheet's sigmas.
///
/// # Errors
/// [`Invalid`] where no view is marked, or the calibration does not belong to the rig file (other cameras, other image
/// size); [`Insufficient`] where the discs do not fix a plane or cannot be told apart; whatever is wrong with an image.
pub fn find_sheet(
    job: &RigDescription,
    source: &Source,
    calibration: &Record,
    options: &SheetOptions,
    progress: &mut (dyn FnMut(Progress) -> bool + Send),
) -> Result<SheetOutput> {
    let held = held_cameras(job, calibration)?;
    let wanted = sheet_views_alone(job)?;
    let images = Workers::new(options.threads)?.install(|| see_all(&wanted, source, &Mutex::new(progress)))?;
    check_sizes(&images, calibration)?;
    let pair = matches!(job.target.target, Target::TwoDiscs(_) | Target::Bubbles(_));
    let views = features(&wanted, &images, &held, pair);
    let mut sides = vec![views];
    if pair {
        sides.push(sides[0].iter().map(SheetView::on_both_sides).collect());
    }
    let (homography, chosen) = fit(&held, &sides, &placement(job)?, &job.file)?;
    let views = &sides[0];
    Ok(output(calibration, job, &held, images, views, &homography, &chosen))
}

/// Where the rig file places the sheet frame; without the poses of targets only by a point.
fn placement(job: &RigDescription) -> Result<Placement> {
    let origin_in_rig_mm = match job.sheet.origin {
        SheetOrigin::FirstAxis => None,
        SheetOrigin::Point(p) => Some(Vector3::from(p)),
        SheetOrigin::Disc { .. } => {
            return Err(mismatch(
                job,
                "[sheet] origin: the sheet alone is found without poses of the target; give point_mm, \
             a point in the frame of the first camera, or calibrate the whole rig",
            ));
        }
    };
    if job.sheet.x_axis_view.is_some() {
        return Err(mismatch(
            job,
            "[sheet] x_axis: the sheet alone is found without poses of the target; remove x_axis, or calibrate the whole rig",
        ));
    }
    Ok(Placement { origin_in_rig_mm, x_in_rig: None, flip_x: job.sheet.flip_x })
}

fn mismatch(job: &RigDescription, message: impl Into<String>) -> Error {
    Invalid::File { path: job.file.clone(), message: message.into() }.into()
}

/// Both cameras with their covariance from the record.
fn held_cameras(job: &RigDescription, calibration: &Record) -> Result<HeldCameras> {
    let [first, second] = calibration.cameras.as_slice() else {
        let n = calibration.cameras.len();
        return Err(mismatch(
            job,
            format!("the sheet needs two cameras, but the calibration holds {n}; calibrate both"),
        ));
    };
    let own: Vec<&str> = job.cameras.iter().map(|c| c.name.as_str()).collect();
    let theirs = [first.name.as_str(), second.name.as_str()];
    if own != theirs {
        return Err(mismatch(
            job,
            format!(
                "its cameras are \"{}\", but the calibration is of \"{}\"; give the calibration of this rig, or name the cameras \
                 as there and in the same order",
                own.join("\", \""),
                theirs.join("\", \"")
            ),
        ));
    }
    if let Some(c) = calibration.cameras.iter().find(|c| c.window.is_some()) {
        return Err(mismatch(
            job,
            format!(
                "camera \"{}\" of the calibration looks through a window, behind which a plane is seen by no homography and tangents of discs are \
                 not those of their images (refraction bends straight lines); mark the views in the sheet with sheet = true and calibrate them \
                 together, which goes through glass and water exactly, or find the sheet on particles with spivcal check --refine",
                c.name
            ),
        ));
    }
    let mut names: Vec<String> = vec![];
    let mut sigmas = vec![];
    for c in &calibration.cameras {
        let s = &c.sigma;
        let all = [s.f_px, s.aspect, s.cx_px, s.cy_px, s.alpha_rad, s.beta_rad, s.k1, s.k2, s.k3, s.pupil_ratio];
        names.extend(INTRINSIC_NAMES.iter().map(|n| format!("{}.{n}", c.name)));
        sigmas.extend(all);
    }
    let motion = second.sigma.cam_from_rig;
    names.extend(
        ["rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"].map(|n| format!("{}.cam_from_rig.{n}", second.name)),
    );
    sigmas.extend(motion.rotation_rad.into_iter().chain(motion.translation_mm));
    let at: Vec<Option<usize>> = names.iter().map(|n| calibration.covariance.index(n)).collect();
    let covariance = DMatrix::from_fn(names.len(), names.len(), |i, j| match (at[i], at[j]) {
        _ if sigmas[i] == 0.0 || sigmas[j] == 0.0 => 0.0,
        // A number that moves, but nobody knows how far.
        _ if i == j && !sigmas[i].is_finite() => f64::NAN,
        (Some(a), Some(b)) => calibration.covariance.known(a, b),
        _ if i == j => f64::NAN,
        _ => 0.0,
    });
    let cameras = [Camera::new(first.intrinsics())?, Camera::new(second.intrinsics())?];
    Ok(HeldCameras::new(cameras, second.cam_from_rig.motion(), theirs, &names, &covariance))
}

/// The job with no images but those of the sheet that both cameras saw.
fn sheet_views_alone(job: &RigDescription) -> Result<RigDescription> {
    if !job.has_sheet() {
        return Err(mismatch(
            job,
            "no view is marked as recorded in the laser sheet; write sheet = true in every [[view]] whose target stood in the sheet",
        ));
    }
    let mut out = job.clone();
    for view in &mut out.views {
        if !view.sheet || view.images.iter().any(Option::is_none) {
            view.images.iter_mut().for_each(|i| *i = None);
        }
    }
    if out.views.iter().all(|v| v.images.iter().all(Option::is_none)) {
        return Err(mismatch(
            job,
            "no view with sheet = true has an image of both cameras; the sheet is where both see the same discs, so name both images",
        ));
    }
    Ok(out)
}

fn check_sizes(images: &[SeenImage], calibration: &Record) -> Result<()> {
    for i in images {
        let camera = &calibration.cameras[i.camera];
        let [expected_width, expected_height] = camera.image_size_px;
        if [i.image.width(), i.image.height()] != camera.image_size_px {
            return Err(Invalid::CalibratedSize {
                path: i.name.clone(),
                camera: camera.name.clone(),
                width: i.image.width(),
                height: i.image.height(),
                expected_width,
                expected_height,
            }
            .into());
        }
    }
    Ok(())
}

fn features(job: &RigDescription, images: &[SeenImage], held: &HeldCameras, pair: bool) -> Vec<SheetView> {
    let mut out = vec![];
    for view in 0..job.views.len() {
        let of = |camera: usize| images.iter().find(|i| i.view == view && i.camera == camera);
        let (Some(first), Some(second)) = (of(0), of(1)) else { continue };
        let seen = [first, second].map(contours);
        let choice = |exchange: bool| {
            common_features(held.cameras(), [&labelled(first, &seen[0], false), &labelled(second, &seen[1], exchange)])
        };
        let exchanges: &[bool] = if pair { &[false, true] } else { &[false] };
        let choices: Vec<Vec<PairFeatures>> = exchanges.iter().map(|e| choice(*e)).collect();
        if choices.iter().all(|c| !c.is_empty()) {
            out.push(SheetView { view, choices });
        }
    }
    out
}

/// Contours of the labelled discs of an image.
fn contours(image: &SeenImage) -> Vec<DiscObservation> {
    image.discs.iter().enumerate().map(|(k, d)| DiscObservation::of(k, &image.detection.discs[d.disc])).collect()
}

/// The contours with their labels; of a pair exchanged where asked for.
fn labelled<'a>(
    image: &SeenImage,
    contours: &'a [DiscObservation],
    exchange: bool,
) -> Vec<(DotId, &'a DiscObservation)> {
    let label = |id: DotId| if exchange { DotId { column: 1 - id.column, ..id } } else { id };
    image.discs.iter().map(|d| label(d.id)).zip(contours).collect()
}

/// Mean squared transfer error over a plane, px^2; infinite where a feature does not transfer.
fn transfer_square(held: &HeldCameras, abc: &Vector3<f64>, features: &[PairFeatures]) -> f64 {
    let all = transfer_residuals(held, abc, features);
    let sum: Option<f64> = all.iter().map(|r| r.map(|r| r.norm_squared())).sum();
    sum.map_or(f64::INFINITY, |s| s / all.len().max(1) as f64)
}

/// The better choice of every view over a plane, and the mean squared transfer error of all.
fn better_choices(held: &HeldCameras, abc: &Vector3<f64>, views: &[SheetView]) -> (Vec<usize>, f64) {
    let mut total = 0.0;
    let of = |v: &SheetView| {
        let squares = v.choices.iter().map(|c| transfer_square(held, abc, c)).enumerate();
        let (best, square) = squares.fold((0, f64::INFINITY), |a, b| if b.1 < a.1 { b } else { a });
        total += square / views.len() as f64;
        best
    };
    let chosen = views.iter().map(of).collect();
    (chosen, total)
}

/// The features of every view in the choice made.
fn chosen_features(views: &[SheetView], chosen: &[usize]) -> Vec<Vec<PairFeatures>> {
    views.iter().zip(chosen).map(|(v, c)| v.choices[*c].clone()).collect()
}

/// The plane over which all views transfer best, with the features of the choices made; `sides`: the views with both cameras on one side of
/// the sheet, then, where the target shows both its sides, with the sheet between them.
fn fit(
    held: &HeldCameras,
    sides: &[Vec<SheetView>],
    placement: &Placement,
    file: &str,
) -> Result<(Homography, Vec<Vec<PairFeatures>>)> {
    let nothing = || {
        Insufficient::Inconsistent(format!(
            "{file}: the discs that both cameras see in the sheet's views do not meet in one plane in front of them; check that the \
             calibration is of this rig, that nothing was moved since, and that left and right images belong together"
        ))
    };
    // Side and choices of all views with the root mean square error that they reach, best first.
    let mut found: Vec<((usize, Vec<usize>), Homography)> = vec![];
    let all =
        sides.iter().enumerate().flat_map(|(s, views)| views.iter().flat_map(move |v| &v.choices).map(move |c| (s, c)));
    for (side, choice) in all {
        let Some(start) = triangulated_plane(held, choice) else { continue };
        let Ok(own) = fit_homography(held, choice, &start) else { continue };
        if held.on_opposite_sides(&own.estimate.abc_per_mm) != (side == 1) {
            continue;
        }
        let (chosen, square) = better_choices(held, &own.estimate.abc_per_mm, &sides[side]);
        let chosen = (side, chosen);
        if !square.is_finite() || found.iter().any(|(c, _)| *c == chosen) {
            continue;
        }
        let features = chosen_features(&sides[side], &chosen.1).concat();
        if let Ok(all) = fit_placed_homography(held, &features, &own.estimate.abc_per_mm, placement) {
            found.push((chosen, all));
        }
    }
    found.sort_by(|a, b| a.1.transfer_rms_px.total_cmp(&b.1.transfer_rms_px));
    if let [best, next, ..] = found.as_slice()
        && next.1.transfer_rms_px < DISTINCT * best.1.transfer_rms_px
    {
        return Err(Insufficient::Degenerate(format!(
            "{file}: which disc is which in the two cameras cannot be told: one pairing transfers with {:.2} px, another with {:.2} px; \
             record the target at more places of the sheet, or use two discs of clearly different size",
            best.1.transfer_rms_px, next.1.transfer_rms_px
        ))
        .into());
    }
    let ((side, chosen), homography) = found.into_iter().next().ok_or_else(nothing)?;
    Ok((homography, chosen_features(&sides[side], &chosen)))
}

fn output(
    calibration: &Record,
    job: &RigDescription,
    held: &HeldCameras,
    mut images: Vec<SeenImage>,
    views: &[SheetView],
    homography: &Homography,
    features: &[Vec<PairFeatures>],
) -> SheetOutput {
    let mut record = calibration.clone();
    let beside = record.told_of_another_sheet();
    forget_old_sheet(&mut record);
    let first = record.views.iter().map(|v| v.index + 1).max().unwrap_or(0);
    let place = |view: usize| views.iter().position(|v| v.view == view).map(|k| first + k);
    images.retain(|i| place(i.view).is_some());
    images.iter_mut().for_each(|i| i.view = place(i.view).unwrap_or(first));
    record.views.extend((0..views.len()).map(|k| appended(first + k, &images, job)));
    let mut sheet = homography.estimate.to_record("homography", (first..first + views.len()).collect());
    sheet.disparity_rms_px = Some(homography.transfer_rms_px);
    record.sheet = Some(sheet);
    let scatter = match homography.scatter {
        1.0 => String::new(),
        by => format!(
            "; its features scatter {by:.2} times as much as contours and cameras explain, and its sigmas allow for that, not for cameras that moved since"
        ),
    };
    let told = format!("homography with the cameras held, from {}{scatter}", job.file);
    record.provenance.options.insert("sheet".into(), told);
    record.provenance.images.extend(images.iter().map(|i| i.file(job)));
    let mut flags = flags(job, views, homography, &images);
    if let Some(covariance) = homography.with_sheet(held, &record.covariance) {
        record.covariance = with_frame_on_axis(covariance, &homography.estimate.rig_from_sheet);
    }
    if let Some((mapping, told)) = mapping_of_record(&record, beside) {
        record.mapping_uncertainty = Some(mapping);
        flags.extend(told);
    }
    record.fit.flags.extend(flags.into_iter().map(|f| format!("{FLAG}{f}")));
    let overlays = overlays(held, &images, homography, features, first);
    SheetOutput { record, images, overlays }
}

/// How what this room has to flag begins.
const FLAG: &str = "sheet found alone: ";

/// Views, covariance and statements of a sheet that is no longer there.
fn forget_old_sheet(record: &mut Record) {
    record.forget_sheet();
    record.fit.flags.retain(|f| !f.starts_with(FLAG));
    record.views.iter_mut().for_each(|v| v.in_sheet = false);
    record.views.retain(|v| v.used || v.why_unused != record::SHEET_ALONE);
    let kept = &record.views;
    record.provenance.images.retain(|i| kept.iter().any(|v| v.index == i.view));
    let stays: Vec<usize> =
        (0..record.covariance.names.len()).filter(|i| !record.covariance.names[*i].starts_with("sheet.")).collect();
    record.covariance = record.covariance.only(&stays);
}

fn appended(index: usize, images: &[SeenImage], job: &RigDescription) -> View {
    let own = images.iter().filter(|i| i.view == index);
    View {
        index,
        in_sheet: true,
        rig_from_target: None,
        rms_px: BTreeMap::new(),
        used: false,
        why_unused: record::SHEET_ALONE.into(),
        observations: BTreeMap::new(),
        outliers: BTreeMap::new(),
        images: own.map(|i| (job.cameras[i.camera].name.clone(), i.name.clone())).collect(),
        sigma: record::PoseSigma::default(),
        planarity_mm: None,
        plane_z_mm: None,
        plane_z_sigma_mm: None,
        target: None,
    }
}

fn flags(job: &RigDescription, views: &[SheetView], homography: &Homography, images: &[SeenImage]) -> Vec<String> {
    let mut out = vec![];
    let rms = homography.transfer_rms_px;
    if rms > TRANSFER_LIMIT_PX {
        out.push(format!(
            "in the sheet the two cameras disagree by {rms:.2} px: the calibration may be of another rig, something may have moved \
             since, or the discs do not lie in one plane"
        ));
    }
    if rms <= TRANSFER_LIMIT_PX && homography.scatter > SCATTER_LIMIT && rms > SCATTER_LIMIT_PX {
        out.push(format!(
            "in the sheet the two cameras disagree by {rms:.3} px, {:.0} times as much as contours and cameras explain: something may have moved since the \
             calibration, it may be of another rig, or the plate is not flat; the sheet's sigmas hold that scatter, but not cameras that moved. Compare with \
             spivcal check on particle images, or calibrate again",
            homography.scatter
        ));
    }
    if !homography.estimate.sigmas.iter().all(|s| s.is_finite()) {
        out.push("the sheet has no standard deviations: the calibration does not determine all that they need".into());
    }
    let left_out = job.views.iter().enumerate().filter(|(i, v)| v.sheet && !views.iter().any(|s| s.view == *i));
    out.extend(left_out.map(|(i, _)| {
        format!(
            "view {i} of the rig file says nothing about the sheet: no two separated discs are seen by both cameras"
        )
    }));
    out.extend(images.iter().flat_map(|i| i.warnings.iter().map(|w| format!("{}: {w}", i.name))));
    out
}

fn overlays(
    held: &HeldCameras,
    images: &[SeenImage],
    homography: &Homography,
    features: &[Vec<PairFeatures>],
    first_view: usize,
) -> Vec<OverlayShapes> {
    let mut shapes: Vec<OverlayShapes> =
        images.iter().map(|i| found_shapes(i, &i.discs.iter().map(|d| d.id).collect::<Vec<_>>())).collect();
    // The features stand in the order of the views; those of a view in both cameras.
    let residuals = transfer_residuals(held, &homography.estimate.abc_per_mm, &features.concat());
    let mut next = residuals.into_iter();
    for (k, of_view) in features.iter().enumerate() {
        let second = images.iter().position(|i| i.camera == 1 && i.view == first_view + k);
        for (q, r) in of_view.iter().flat_map(|f| &f.second_px).zip(&mut next) {
            if let (Some(at), Some(r)) = (second, r) {
                shapes[at].marks.push([q.x, q.y], [r.x, r.y], FeatureKind::Point, false);
            }
        }
    }
    shapes
}
