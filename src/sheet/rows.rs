//! Rows of a sheet in the covariance of a calibration.

use crate::bundle::SHEET;
use crate::record::Covariance;
use crate::rigid::STEP_NAMES;
use nalgebra::{DMatrix, DVector, Dyn, Matrix6, OMatrix, U6};

/// A covariance with rows of another sheet, or of one for the first time: `by_number` (6 x n) are left steps of that sheet by the numbers
/// at the places `numbers`, `own` is their whole covariance.
pub(crate) fn with_sheet(
    old: &Covariance,
    numbers: &[usize],
    by_number: &OMatrix<f64, U6, Dyn>,
    own: &Matrix6<f64>,
) -> Covariance {
    let kept: Vec<usize> = (0..old.names.len()).filter(|i| !old.names[*i].starts_with(SHEET)).collect();
    let beside = DMatrix::from_fn(numbers.len(), kept.len(), |i, j| old.matrix[numbers[i]][kept[j]]);
    let cross = by_number * beside;
    let n = kept.len();
    let entry = |i: usize, j: usize| match (i < n, j < n) {
        (true, true) => old.matrix[kept[i]][kept[j]],
        (false, false) => 0.5 * (own[(i - n, j - n)] + own[(j - n, i - n)]),
        (false, true) => cross[(i - n, j)],
        (true, false) => cross[(j - n, i)],
    };
    let with_cameras = |d: &Vec<f64>| -> Vec<f64> {
        let sheet = by_number * DVector::from_fn(numbers.len(), |k, _| d[numbers[k]]);
        kept.iter().map(|i| d[*i]).chain(sheet.iter().copied()).collect()
    };
    let rest = old.only(&kept);
    // The sheet's own steps move with the cameras; what is measured in it need not.
    let lost = STEP_NAMES.iter().filter(|_| numbers.iter().any(|i| !old.determines(*i)));
    Covariance {
        names: rest.names.into_iter().chain(STEP_NAMES.map(|s| format!("{SHEET}{s}"))).collect(),
        matrix: (0..n + 6).map(|i| (0..n + 6).map(|j| entry(i, j)).collect()).collect(),
        undetermined: rest.undetermined.into_iter().chain(lost.map(|s| format!("{SHEET}{s}"))).collect(),
        null_directions: old.null_directions.iter().map(with_cameras).collect(),
    }
}
