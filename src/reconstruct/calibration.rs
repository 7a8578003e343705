//! The calibration moved by one sigma along each column of the Cholesky factor of its covariance.
//!
//! Where the views differ by more than their noise, and tell larger standard deviations, these are stated: the pattern over the sheet is that of the
//! covariance, its size that of the scatter of the views.

use crate::bundle::{Parameter, ParameterSteps, SHEET};
use crate::dewarp::SheetMap;
use crate::error::Result;
use crate::frames::Sheet;
use crate::record::Record;
use crate::rigid::Motion;
use crate::sheet::{determines_measurements, step_rows};
use nalgebra::{DMatrix, DVector, SVector};

/// One number of the calibration that moves the maps.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Moved {
    /// One that the covariance names.
    Named(Parameter),
    /// Turn about the sheet's own x or y, and shift along its normal, where the covariance does not name the sheet.
    SheetAlone(usize),
}

/// Numbers that move the maps with their covariance; none where one of them is not determined.
fn moved_numbers(record: &Record) -> Option<(Vec<Moved>, DMatrix<f64>)> {
    let c = &record.covariance;
    let names = [0, 1].map(|k| record.cameras.get(k).map_or("", |camera| camera.name.as_str()));
    let named = |(row, name): (usize, &String)| Some((Moved::Named(Parameter::of(name, names)?), Some(row), 0.0));
    let of_sheet = |m: &Moved| matches!(m, Moved::Named(Parameter::Sheet(_)));
    let all: Vec<(Moved, Option<usize>, f64)> = c.names.iter().enumerate().filter_map(named).collect();
    let (sheet, mut numbers): (Vec<_>, Vec<_>) = all.into_iter().partition(|(m, ..)| of_sheet(m));
    // Of cameras that another program found nothing is known; where images were adjusted, the second one's place is always a number.
    if numbers.is_empty() {
        return None;
    }
    if step_rows(c, SHEET).is_some() {
        numbers.extend(sheet);
    } else {
        let s = &record.sheet.as_ref()?.sigma;
        let own = [s.normal_rad[0], s.normal_rad[1], s.distance_mm].into_iter().enumerate();
        numbers.extend(own.map(|(k, sigma)| (Moved::SheetAlone(k), None, sigma)));
    }
    let covariance = DMatrix::from_fn(numbers.len(), numbers.len(), |i, j| match (&numbers[i], &numbers[j]) {
        ((_, Some(a), _), (_, Some(b), _)) => c.matrix[*a][*b],
        ((.., sigma), _) if i == j => sigma * sigma,
        _ => 0.0,
    });
    let finite = covariance.iter().all(|v| v.is_finite());
    finite.then(|| (numbers.into_iter().map(|(m, ..)| m).collect(), covariance))
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
    let mut in_sheet = SVector::<f64, 6>::zeros();
    for (what, step) in steps {
        match what {
            Moved::SheetAlone(2) => in_sheet[5] += step,
            Moved::SheetAlone(k) => in_sheet[*k] += step,
            Moved::Named(_) => {}
        }
    }
    let named = steps.iter().filter_map(|(what, step)| match what {
        Moved::Named(parameter) => Some((*parameter, *step)),
        Moved::SheetAlone(_) => None,
    });
    let named: ParameterSteps = named.collect();
    let rig_from_sheet =
        named.sheet(&sheet.rig_from_sheet.motion()) * Motion::<Sheet, Sheet>::identity().retract(&in_sheet);
    SheetMap::after_steps(record, &named, &rig_from_sheet)
}
