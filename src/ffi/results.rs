//! What a calibration handle holds.

use super::abi::{SPIVCAL_ERROR_HANDLE_TYPE, SPIVCAL_OK, SPIVCAL_WARNING_FLAGGED};
use super::door::{Fault, Outcome};
use super::memory::Out;
use super::table::{self, Body, Kind, Object};
use crate::dewarp::SheetMap;
use crate::record::{PlacedCamera, Record, ResidualTable};
use crate::report::{Level, verdict};
use std::sync::Arc;

/// A calibration, never changed.
pub(super) struct CalibrationState {
    pub(super) record: Record,
    pub(super) residuals: Option<ResidualTable>,
    pub(super) cameras: Vec<PlacedCamera>,
    /// One per camera; none without a sheet.
    pub(super) maps: Vec<SheetMap>,
}

impl CalibrationState {
    pub(super) fn new(record: Record, residuals: Option<ResidualTable>) -> Result<Self, Fault> {
        let cameras = record.placed_cameras()?;
        let with_sheet = if record.sheet.is_some() { cameras.len() } else { 0 };
        let maps = (0..with_sheet).map(|c| SheetMap::from_record(&record, c)).collect::<Result<_, _>>()?;
        Ok(Self { record, residuals, cameras, maps })
    }
}

/// Gives a calibration a handle; the status says whether it must be looked at.
pub(super) fn keep(context: u64, state: Arc<CalibrationState>, out: Out<u64>) -> Outcome {
    let good = verdict(&state.record).level == Level::Good;
    out.set(table::insert(context, Body::Calibration(state))?);
    Ok(if good { SPIVCAL_OK } else { SPIVCAL_WARNING_FLAGGED })
}

pub(super) fn state_of(object: &Object) -> Result<&Arc<CalibrationState>, Fault> {
    match &object.body {
        Body::Calibration(state) => Ok(state),
        _ => Err(Fault::handle("calibration", SPIVCAL_ERROR_HANDLE_TYPE)),
    }
}

/// The calibration behind a handle that is a further argument.
pub(super) fn calibration_of(handle: u64) -> Result<Arc<CalibrationState>, Fault> {
    let object = table::find_kind(handle, Kind::Calibration).map_err(|s| Fault::handle("cameras", s))?;
    state_of(&object).map(Arc::clone)
}
