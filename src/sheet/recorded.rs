//! A plane as the record holds it.

use super::SheetEstimate;
use super::gain::SheetUncertainty;
use crate::bundle::{NamedCovariance, Natural, Parameter, ParameterKnowledge, typical};
use crate::camera::INTRINSICS;
use crate::record::{ANGLES_CONVENTION, Pose, Record, Sheet, SheetSigma};
use nalgebra::{DMatrix, DVector};

impl SheetEstimate {
    /// The part `sheet` of a record; `method` says how it was found, `views` from which views.
    pub fn to_record(&self, method: &str, views: Vec<usize>) -> Sheet {
        Sheet {
            normal_in_rig: self.normal.into(),
            distance_mm: self.distance_mm,
            abc_per_mm: self.abc_per_mm.into(),
            angles_deg: self.angles_rad.map(f64::to_degrees),
            angles_convention: ANGLES_CONVENTION.into(),
            angle_to_baseline_deg: self.angle_to_baseline_rad.to_degrees(),
            sigma: self.record_sigma(),
            rig_from_sheet: Pose::from(&self.rig_from_sheet),
            method: method.into(),
            views,
            disparity_rms_px: None,
            homography: None,
        }
    }

    /// Its standard deviations in the units of the file.
    pub fn record_sigma(&self) -> SheetSigma {
        let s = &self.sigmas;
        SheetSigma {
            distance_mm: s[0],
            normal_rad: [s[1], s[2]],
            abc_per_mm: [s[3], s[4], s[5]],
            angles_deg: [s[6], s[7], s[8]].map(f64::to_degrees),
            angle_to_baseline_deg: s[9].to_degrees(),
        }
    }
}

/// Numbers of both cameras and the sheet with what their record says of their errors. `None` where its covariance
/// does not name the sheet, or has numbers that do not exist.
pub(crate) fn covariance_of_record(record: &Record) -> Option<NamedCovariance> {
    let [first, second] = record.cameras.as_slice() else { return None };
    let (names, all) = ([first.name.as_str(), second.name.as_str()], &record.covariance);
    let own: Vec<usize> = (0..all.names.len()).filter(|i| Parameter::of(&all.names[*i], names).is_some()).collect();
    let c = all.only(&own);
    let n = own.len();
    let has_sheet = c.names.iter().any(|name| matches!(Parameter::of(name, names), Some(Parameter::Sheet(_))));
    let matrix = DMatrix::from_fn(n, n, |i, j| c.matrix[i][j]);
    if !has_sheet || matrix.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let known = ParameterKnowledge::Estimated { prior_share: 0.0 };
    let natural = Natural {
        cameras: vec![first.model().ok()?, second.model().ok()?],
        cam_from_rig: vec![first.cam_from_rig.motion(), second.cam_from_rig.motion()],
        rig_from_plane: Some(record.sheet.as_ref()?.rig_from_sheet.motion()),
        rig_from_target: vec![],
    };
    Some(NamedCovariance {
        scale: DVector::from_iterator(n, c.names.iter().map(|name| typical(&natural, name, &names))),
        determined: (0..n).map(|i| c.determines(i)).collect(),
        intrinsics: vec![[known; INTRINSICS]; 2],
        nullity: c.null_directions.len(),
        null_directions: DMatrix::from_fn(n, c.null_directions.len(), |i, k| c.null_directions[k][i]),
        undetermined: vec![],
        offset_sigmas_mm: vec![],
        disc_sigmas_mm: vec![],
        natural,
        names: c.names,
        matrix,
    })
}

/// Part of the distance of the sheet from its middle at which it is asked besides.
const BESIDE: f64 = 0.02;

/// Whether displacements that are measured with a record, and disparities, depend on nothing that its calibration leaves undetermined.
pub fn determines_measurements(record: &Record) -> bool {
    if record.covariance.shared_nullity() == 0 {
        return true;
    }
    let known = || {
        let covariance = covariance_of_record(record)?;
        let names = [record.cameras[0].name.as_str(), record.cameras[1].name.as_str()];
        let (uncertainty, r) = (SheetUncertainty::of(&covariance, names)?, BESIDE * record.sheet.as_ref()?.distance_mm);
        let known_at = |p: [f64; 2]| {
            let at = uncertainty.at(p)?;
            at.disparity_px()?;
            (0..9).try_for_each(|k| at.measured_from_true(k / 3, k % 3).map(drop))
        };
        [[0.0, 0.0], [r, 0.0], [-r, 0.0], [0.0, r], [0.0, -r]].into_iter().try_for_each(known_at)
    };
    known().is_some()
}
