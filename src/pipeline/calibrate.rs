//! The main job: images to a calibration.

use super::images::{SeenImage, see_all};
use super::model::{Built, build};
use super::off_grid;
use super::outcome::record;
use super::residual_rows::residual_rows;
use super::sheet_part::{sheet_part, stated_frame};
use super::workers::Workers;
use super::{Progress, Source};
use crate::bundle::{
    AdjustOptions, Adjustment, Iteration, Model, NamedCovariance, Termination, adjust_tangents, named_covariance,
};
use crate::detect::pattern::Relabelling;
use crate::diagnosis::{Subject, diagnose};
use crate::error::{Error, Result, Unusable};
use crate::record::{Record, ResidualTable};
use crate::report::OverlayShapes;
use crate::rig::{RigSolution, calibrate_rig};
use crate::rig_file::{Observations, RigDescription, SheetFrame};
use std::sync::Mutex;

/// Options of [`calibrate`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CalibrateOptions {
    /// Threads; 0 takes as many as the machine has. Results do not depend on it.
    pub threads: usize,
    /// Options of the adjustment.
    pub adjust: AdjustOptions,
}

/// Everything that a calibration gives.
#[derive(Debug, Clone)]
pub struct CalibrationOutput {
    /// The content of `calibration.json`.
    pub record: Record,
    /// The content of `residuals.csv`.
    pub residuals: ResidualTable,
    /// The images with what was found in them, in the order of views and cameras.
    pub images: Vec<SeenImage>,
    /// What is drawn on each image.
    pub overlays: Vec<OverlayShapes>,
}

/// What the later parts of the pipeline look at.
pub(super) struct Solved<'a> {
    pub(super) job: &'a RigDescription,
    pub(super) images: &'a [SeenImage],
    pub(super) built: &'a Built,
    /// The adjustment with the observations of its model.
    pub(super) adjustment: &'a Adjustment,
    /// The same state against the contours, for residuals.
    pub(super) contours: &'a Model,
    pub(super) covariance: &'a NamedCovariance,
    /// What the images do not decide about the labels.
    pub(super) undecided: &'a [String],
}

/// Calibrates cameras, rig, target and sheet from images.
///
/// `progress` sees what happens and returns false to stop early. All threads have ended when this returns.
///
/// # Errors
/// Whatever is wrong with an image, the pattern, the views or the adjustment, each in its family;
/// [`crate::error::Unusable::Cancelled`] where `progress` stopped it.
pub fn calibrate(
    job: &RigDescription,
    source: &Source,
    options: &CalibrateOptions,
    progress: &mut (dyn FnMut(Progress) -> bool + Send),
) -> Result<CalibrationOutput> {
    Workers::new(options.threads)?.install(|| run(job, source, options, &Mutex::new(progress)))
}

fn run(
    job: &RigDescription,
    source: &Source,
    options: &CalibrateOptions,
    progress: &Mutex<&mut (dyn FnMut(Progress) -> bool + Send)>,
) -> Result<CalibrationOutput> {
    let mut images = see_all(job, source, progress)?;
    let size = |c: usize| {
        let first = images.iter().find(|i| i.camera == c);
        first.map_or([0.0; 2], |i| [i.image.width() as f64, i.image.height() as f64])
    };
    let sizes: Vec<[f64; 2]> = (0..job.cameras.len()).map(size).collect();
    let mut built = build(job, &images, &sizes)?;
    let told = |i: &Iteration| {
        let told = Progress::Iteration { number: i.number, cost: i.cost, decrement: i.decrement };
        progress.lock().is_ok_and(|mut p| p(told))
    };
    let mut observe = |i: &Iteration| told(i);
    let solution = calibrate_rig(&built.problem, &options.adjust, &mut observe).map_err(|e| explained(e, &images))?;
    take_labels(&mut built, &mut images, &solution);
    let RigSolution { mut adjustment, undecided, .. } = solution;
    let mut contours = adjustment.model.clone();
    let mut refits = None;
    if job.solve.observations == Observations::Bitangent {
        let outliers = std::mem::take(&mut adjustment.outliers);
        let (ovality_mm, ovality_assumed_mm) = (adjustment.ovality_mm, adjustment.ovality_assumed_mm);
        let tangents = adjust_tangents(&contours, adjustment.state, &options.adjust, &mut observe)?;
        if tangents.adjustment.termination == Termination::Cancelled {
            return Err(Unusable::Cancelled.into());
        }
        let ovality_mm = ovality_mm.map(|tau| tangents.adjustment.state.ovality_rms_mm().unwrap_or(tau));
        adjustment = Adjustment { outliers, ovality_mm, ovality_assumed_mm, ..tangents.adjustment };
        refits = Some((tangents.rounds, tangents.left_out));
    }
    off_grid::set_aside(job, &mut built, &mut images, &mut contours, &mut adjustment);
    let covariance =
        named_covariance(&adjustment).ok_or_else(|| Error::Bug("the adjustment gave no covariance".into()))?;
    let solved = Solved {
        job,
        images: &images,
        built: &built,
        adjustment: &adjustment,
        contours: &contours,
        covariance: &covariance,
        undecided: &undecided,
    };
    let subject = Subject {
        adjustment: &adjustment,
        covariance: &covariance,
        assumed: &built.assumed,
        point_sigma_stated: job.target.point_sigma_mm.is_some(),
        labels: &built.labels,
        sizes_px: &sizes,
        sheet_frame: stated_frame(&solved)?,
        options: &options.adjust,
    };
    let described = || (residual_rows(&solved), sheet_part(&solved));
    let (findings, (rows, sheet)) = rayon::join(|| diagnose(&subject, &told), described);
    let (findings, (residuals, overlays, fits)) = (findings?, rows?);
    let mut record = record(&solved, &fits, &findings, sheet?)?;
    if job.sheet != SheetFrame::default() && record.sheet.is_some() {
        record.provenance.options.insert("sheet frame".into(), job.sheet.words());
    }
    if let Some((rounds, left_out)) = refits {
        let words = format!("found through the lens {rounds} times, until both agreed");
        record.provenance.options.insert("bitangent features".into(), words);
        record.fit.flags.extend(left_out.iter().map(|[view, camera]| {
            let name = &job.cameras[*camera].name;
            format!("view {view}, camera {name}: the discs have no four common tangents and take no part")
        }));
    }
    Ok(CalibrationOutput { record, residuals, images, overlays })
}

/// Where nothing fits, what an image alone had left open may be why.
fn explained(error: Error, images: &[SeenImage]) -> Error {
    let first = images.iter().find_map(|i| Some(format!(" {}: {}", i.name, i.warnings.first()?)));
    match (error, first) {
        (Error::Unusable(Unusable::NotConverged { reason, decrement, wanted, besides }), Some(first)) => {
            Unusable::NotConverged { reason, decrement, wanted, besides: besides + &first }.into()
        }
        (error, _) => error,
    }
}

/// The labels that the views have decided; what an image alone had left open is void then.
fn take_labels(built: &mut Built, images: &mut [SeenImage], solution: &RigSolution) {
    built.labels = solution.labels.clone();
    let own = built.problem.model.images.iter_mut().zip(images).zip(&solution.disc_of);
    for ((image, seen), disc_of) in own {
        for ((d, s), disc) in image.discs.iter_mut().zip(&mut seen.discs).zip(disc_of) {
            d.disc = *disc;
            s.id = built.labels[*disc];
        }
        let levels_open = seen.open.alternatives.iter().any(Relabelling::exchanges_levels);
        if !levels_open {
            seen.warnings.clear();
        }
    }
}
