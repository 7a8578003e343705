//! The calibration as a record: what `calibration.json` (schema version 1) and `residuals.csv` hold.
//!
//! Plain structs, one per JSON object, whose field names are the keys of the file. Angles are rad in keys that end in
//! `_rad` and degrees in keys that end in `_deg`; lengths are mm; image coordinates are px with (0, 0) the centre of
//! the first pixel. Poses are read target first: `cam_from_rig` maps rig coordinates to camera coordinates.
//!
//! * **Unknown numbers.** A standard deviation that does not exist (a direction that the images do not determine) is
//!   `NaN` or infinite in memory and `null` in the file. No `null` is silent: [`Record::to_json`] lists the path of each
//!   under the key `not_finite`. An *estimate* that is not finite is written the same way, and such a file is refused
//!   when it is read.
//! * **Reading back.** Numbers are written with as many digits as name them uniquely (17 at most), so that a record
//!   read is the record written, to the bit. Keys keep the order of the structs; keys unknown to this version are ignored.
//! * **Sigma and how it is known.** [`Parameter::known`] says whether a number was free, fixed or held by a prior, and
//!   [`Parameter::prior_share`] how much of what is known comes from the prior (1: the images say nothing).

mod agreement;
mod check;
mod diagnosis;
mod geometry;
mod json;
mod named;
mod number;
mod place;
mod provenance;
mod residuals;
mod schema;
mod sheet_check;
mod sigma;
mod target;

pub(crate) use diagnosis::SHEET_QUANTITIES;
pub use diagnosis::{
    Diagnosis, EXACT, Interval, KeyQuantity, MappingByLikelihood, MappingByViews, MappingMap, MappingSigma,
    MappingTold, MappingUncertainty, ModelTest, OFF_ITSELF, OutlierReason, Prior, ViewInfluence,
};
pub use geometry::PlacedCamera;
pub use provenance::{ImageFile, Provenance};
pub use residuals::{FeatureKind, Residual, ResidualTable};
pub use schema::{
    ANGLES_CONVENTION, Camera, Covariance, Effective, FORMAT, Fit, Homography, Known, NearNull, Parameter, Pose,
    Radial, Record, Rig, SHEET_ALONE, Scale, Sheet, VERSION, View, WHOLE_DISCS, Window,
};
pub use sheet_check::{
    CamerasRefined, CheckRound, DisparityMap, LightProfile, Misalignment, RefinedNumber, SheetCheck,
};
pub use sigma::{CameraSigma, PoseSigma, RigSigma, SheetSigma, TargetSigma, WindowSigma};
pub use target::{SameLight, Target, TargetPoint, ViewTarget};
