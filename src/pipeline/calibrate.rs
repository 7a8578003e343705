//! The main job: images to a calibration.

use super::images::{SeenImage, see_all};
use super::model::{Built, build};
use super::outcome::record;
use super::residual_rows::residual_rows;
use super::sheet_part::sheet_part;
use super::workers::Workers;
use super::{Progress, Source};
use crate::bitangent::{ExternalUse, POINTS, bitangents};
use crate::bundle::{
    AdjustOptions, Adjustment, Iteration, Model, NamedCovariance, PairObservation, adjust, named_covariance,
};
use crate::error::{Error, Result};
use crate::record::{Record, ResidualTable};
use crate::report::OverlayShapes;
use crate::rig::{RigSolution, calibrate_rig};
use crate::rig_file::{Observations, RigDescription};
use nalgebra::DMatrix;
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
}

/// Calibrates cameras, rig, target and sheet from images.
///
/// `progress` sees what happens and returns false to stop early. All threads have ended when this returns.
///
/// # Errors
/// Whatever is wrong with an image, the pattern, the views or the adjustment, each in its family;
/// [`crate::error::Unusable::Cancelled`] where `progress` stopped it before the adjustment (stopped there, it gives what it has).
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
    let images = see_all(job, source, progress)?;
    let size = |c: usize| {
        let first = images.iter().find(|i| i.camera == c);
        first.map_or([0.0; 2], |i| [i.image.width() as f64, i.image.height() as f64])
    };
    let sizes: Vec<[f64; 2]> = (0..job.cameras.len()).map(size).collect();
    let mut built = build(job, &images, &sizes)?;
    let mut observe = |i: &Iteration| {
        let told = Progress::Iteration { number: i.number, cost: i.cost, decrement: i.decrement };
        progress.lock().is_ok_and(|mut p| p(told))
    };
    let RigSolution { mut adjustment, swapped } = calibrate_rig(&built.problem, &options.adjust, &mut observe)?;
    exchange_labels(&mut built, &swapped);
    let contours = adjustment.model.clone();
    if job.solve.observations == Observations::Bitangent {
        let model = bitangent_model(&contours, &images, &built)?;
        let outliers = std::mem::take(&mut adjustment.outliers);
        adjustment = adjust(&model, adjustment.state, &AdjustOptions { rounds: 0, ..options.adjust }, &mut observe);
        adjustment.outliers = outliers;
    }
    let covariance =
        named_covariance(&adjustment).ok_or_else(|| Error::Bug("the adjustment gave no covariance".into()))?;
    let solved = Solved {
        job,
        images: &images,
        built: &built,
        adjustment: &adjustment,
        contours: &contours,
        covariance: &covariance,
    };
    let (residuals, overlays, fits) = residual_rows(&solved)?;
    let sheet = sheet_part(&solved)?;
    let record = record(&solved, &fits, sheet)?;
    Ok(CalibrationOutput { record, residuals, images, overlays })
}

/// The labels of pairs that the consensus exchanged.
fn exchange_labels(built: &mut Built, swapped: &[bool]) {
    for (image, _) in built.problem.model.images.iter_mut().zip(swapped).filter(|(_, s)| **s) {
        image.discs.iter_mut().for_each(|d| d.disc = 1 - d.disc);
    }
}

/// The same model with tangent features instead of contours: for a lattice the pairs of neighbours along rows.
fn bitangent_model(contours: &Model, images: &[SeenImage], built: &Built) -> Result<Model> {
    let mut model = contours.clone();
    for (k, image) in model.images.iter_mut().enumerate() {
        let original = &built.problem.model.images[k].discs;
        let labels = &built.labels;
        let mut order: Vec<usize> = (0..image.discs.len()).collect();
        order.sort_by_key(|&i| {
            (labels[image.discs[i].disc].level, labels[image.discs[i].disc].row, labels[image.discs[i].disc].column)
        });
        for pair in order.windows(2) {
            let (a, b) = (&image.discs[pair[0]], &image.discs[pair[1]]);
            let (la, lb) = (labels[a.disc], labels[b.disc]);
            if (la.level, la.row) != (lb.level, lb.row) {
                continue;
            }
            let found = |disc: usize| {
                let at = original.iter().position(|d| d.disc == disc)?;
                Some(&images[k].detection.discs[images[k].discs[at].disc])
            };
            let (Some(da), Some(db)) = (found(a.disc), found(b.disc)) else { continue };
            let Ok(tangents) = bitangents(&da.ellipse, &db.ellipse) else { continue };
            let whitening = tangents.whitening([&da.covariance, &db.covariance], ExternalUse::WhereMeasurable)?;
            let kept: Vec<usize> =
                (0..POINTS).filter(|&p| whitening.external || p != crate::bitangent::EXTERNAL_CROSSING).collect();
            let at = |j: usize| 2 * kept[j / 2] + j % 2;
            image.pairs.push(PairObservation {
                discs: [a.disc, b.disc],
                pixels_px: (0..2 * kept.len()).map(|j| tangents.points[at(j)]).collect(),
                whitening: DMatrix::from_fn(whitening.rank, 2 * kept.len(), |i, j| whitening.matrix[(i, at(j))]),
                kept,
            });
        }
        image.discs.clear();
    }
    model.target.offset_sigma_mm = None;
    Ok(model)
}
