//! The calibration moved by one sigma along each column of the Cholesky factor of its covariance.
//!
//! Where the views differ by more than their noise, and tell larger standard deviations, these are stated: the pattern over the sheet is that of the
//! covariance, its size that of the scatter of the views.

use crate::camera::{Camera, INTRINSIC_NAMES, Intrinsics, WINDOW_STEP_NAMES, WINDOW_STEPS};
use crate::dewarp::SheetMap;
use crate::error::Result;
use crate::frames::{Cam, Rig, Sheet};
use crate::record::Record;
use crate::rigid::Motion;
use crate::sheet::{SHEET, STEP_NAMES, determines_measurements};
use nalgebra::{DMatrix, DVector, SVector, Vector3};

/// One number of the calibration that moves the maps.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Moved {
    Intrinsic(usize, usize),
    /// Camera and step of its window.
    Window(usize, usize),
    /// Part of a left step of a camera's pose.
    Pose(usize, usize),
    /// Part of a left step of the sheet's pose.
    Sheet(usize),
    /// Turn about the sheet's own x or y, and shift along its normal, where the covariance does not name the sheet.
    SheetAlone(usize),
}

/// Numbers that move the maps with their covariance; none where one of them is not determined.
fn moved_numbers(record: &Record) -> Option<(Vec<Moved>, DMatrix<f64>)> {
    let c = &record.covariance;
    let mut moved = vec![];
    let mut rows = vec![];
    for (i, camera) in record.cameras.iter().enumerate() {
        for (k, name) in INTRINSIC_NAMES.iter().enumerate() {
            if let Some(row) = c.index(&format!("{}.{name}", camera.name)) {
                moved.push(Moved::Intrinsic(i, k));
                rows.push(Some(row));
            }
        }
        for (k, name) in WINDOW_STEP_NAMES.iter().enumerate() {
            if let Some(row) = c.index(&format!("{}.window.{name}", camera.name)) {
                moved.push(Moved::Window(i, k));
                rows.push(Some(row));
            }
        }
        for (k, step) in STEP_NAMES.iter().enumerate().filter(|_| i > 0) {
            if let Some(row) = c.index(&format!("{}.cam_from_rig.{step}", camera.name)) {
                moved.push(Moved::Pose(i, k));
                rows.push(Some(row));
            }
        }
    }
    // Of cameras that another program found nothing is known; where images were adjusted, the second one's place is always a number.
    if moved.is_empty() {
        return None;
    }
    let mut own = vec![0.0; rows.len()];
    let named: Vec<Option<usize>> = STEP_NAMES.iter().map(|s| c.index(&format!("{SHEET}{s}"))).collect();
    if named.iter().all(Option::is_some) {
        (0..6).for_each(|k| moved.push(Moved::Sheet(k)));
        rows.extend(named);
        own.extend([0.0; 6]);
    } else {
        let s = &record.sheet.as_ref()?.sigma;
        for (k, sigma) in [s.normal_rad[0], s.normal_rad[1], s.distance_mm].into_iter().enumerate() {
            moved.push(Moved::SheetAlone(k));
            rows.push(None);
            own.push(sigma);
        }
    }
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| match (rows[i], rows[j]) {
        (Some(a), Some(b)) => c.matrix[a][b],
        _ if i == j => own[i] * own[i],
        _ => 0.0,
    });
    covariance.iter().all(|v| v.is_finite()).then_some((moved, covariance))
}

/// What errors of a calibration do to three components.
///
/// The change of any result, half the difference between plus and minus, squared and summed over the directions, is its variance by
/// the calibration as its noise tells it.
#[derive(Debug, Clone, PartialEq)]
pub struct PerturbedMaps {
    /// The maps of all cameras with the calibration moved by plus and minus one sigma along each independent direction of its covariance.
    pub sides: Vec<[Vec<SheetMap>; 2]>,
    /// How many times larger the standard deviations of u, v and w are as the calibration's views tell them ([`crate::record::MappingUncertainty::enlarged`]).
    pub enlarged: [f64; 3],
}

/// The maps of a calibration moved by its covariance; `None` where a number that the maps need is not determined. Where the covariance does not name
/// the sheet, its own sigmas stand beside the cameras', which counts the cameras' share twice.
///
/// # Errors
/// As [`SheetMap::from_record`].
pub fn perturbed_maps(record: &Record) -> Result<Option<PerturbedMaps>> {
    for c in 0..record.cameras.len() {
        SheetMap::from_record(record, c)?;
    }
    let Some((moved, covariance)) = moved_numbers(record).filter(|_| determines_measurements(record)) else {
        return Ok(None);
    };
    let scale = DVector::from_fn(moved.len(), |i, _| covariance[(i, i)].max(0.0).sqrt());
    let free: Vec<usize> = (0..moved.len()).filter(|i| scale[*i] > 0.0).collect();
    // Correlations, a trace of the unit matrix added so that exact ones keep a factor.
    let n = free.len();
    let correlation = DMatrix::from_fn(n, n, |i, j| {
        covariance[(free[i], free[j])] / (scale[free[i]] * scale[free[j]]) + if i == j { 1e-9 } else { 0.0 }
    });
    let Some(factor) = correlation.cholesky() else { return Ok(None) };
    let l = factor.l();
    let mut sides = vec![];
    for k in 0..n {
        let side = |sign: f64| -> Option<Vec<SheetMap>> {
            let steps: Vec<(Moved, f64)> =
                (k..n).map(|i| (moved[free[i]], sign * l[(i, k)] * scale[free[i]])).collect();
            maps_after(record, &steps)
        };
        let (Some(plus), Some(minus)) = (side(1.0), side(-1.0)) else { return Ok(None) };
        sides.push([plus, minus]);
    }
    let enlarged = record.mapping_uncertainty.as_ref().map_or([1.0; 3], |m| m.enlarged());
    Ok(Some(PerturbedMaps { sides, enlarged }))
}

fn maps_after(record: &Record, steps: &[(Moved, f64)]) -> Option<Vec<SheetMap>> {
    let sheet = record.sheet.as_ref()?;
    let mut in_rig = SVector::<f64, 6>::zeros();
    let mut in_sheet = SVector::<f64, 6>::zeros();
    for (what, step) in steps {
        match what {
            Moved::Sheet(k) => in_rig[*k] += step,
            Moved::SheetAlone(2) => in_sheet[5] += step,
            Moved::SheetAlone(k) => in_sheet[*k] += step,
            _ => {}
        }
    }
    let rig_from_sheet: Motion<Rig, Sheet> = sheet.rig_from_sheet.motion::<Rig, Sheet>().retract(&in_rig)
        * Motion::<Sheet, Sheet>::identity().retract(&in_sheet);
    let map = |(i, camera): (usize, &crate::record::Camera)| {
        let intrinsics = camera.intrinsics();
        let mut values = intrinsics.to_array();
        let mut pose = SVector::<f64, 6>::zeros();
        let mut window = [0.0; WINDOW_STEPS];
        for (what, step) in steps {
            match what {
                Moved::Intrinsic(c, k) if *c == i => values[*k] += step,
                Moved::Pose(c, k) if *c == i => pose[*k] += step,
                Moved::Window(c, k) if *c == i => window[*k] += step,
                _ => {}
            }
        }
        let cam_from_rig = camera.cam_from_rig.motion::<Cam, Rig>().retract(&pose);
        let [rx, ry, rz, layers @ ..] = window;
        let window = match camera.model().ok()?.window() {
            Some(window) => Some(window.stepped(&Vector3::new(rx, ry, rz), &layers).ok()?),
            None => None,
        };
        let moved = Camera::new(Intrinsics::from_array(&values, intrinsics.radial)).ok()?.with_window(window);
        Some(SheetMap::new(moved, cam_from_rig * rig_from_sheet, camera.image_size_px))
    };
    record.cameras.iter().enumerate().map(map).collect()
}
