//! A calibration in words and pictures: text, `residuals.csv`, overlay PNGs and a self-contained `report.html`.
//!
//! Nothing here computes a calibration or touches a file: every number comes from the [`Record`](crate::record::Record)
//! and the [`ResidualTable`](crate::record::ResidualTable), every function returns text or bytes.
//!
//! | function | gives |
//! |---|---|
//! | [`text()`] | the calibration in plain words, for a terminal |
//! | [`write_html`] | one HTML file without scripts or anything to load, also well-formed XML |
//! | [`check_html`] | the check of the sheet on particle images as one HTML file |
//! | [`vectors_svg`] | three components: arrows over colours for w, one SVG file |
//! | [`residuals_csv`] | one row per observation |
//! | [`discs_csv`], [`contours_csv`], [`features_csv`], [`detection_json`] | what was found in one image |
//! | [`overlay_png`] | the image with what was found in it, at full resolution |
//!
//! Pictures keep the pixel convention: a mark at (u, v) = (0, 0) is centred on the centre of the first pixel. In SVG the
//! image therefore spans (-0.5, -0.5) to (width - 0.5, height - 0.5). Residual arrows start where a feature was seen and
//! run along observed less predicted, enlarged by a stated factor.
//!
//! Standard deviations are rounded to two significant digits, and values to the same decimal.

mod canvas;
mod captions;
mod check_page;
mod csv;
mod detection;
mod diagnosis;
mod figures;
mod grey;
mod html;
mod maps;
mod number;
mod overlay;
mod plots;
mod space;
mod svg;
mod tables;
mod text;
mod vectors;
mod verdict;

pub use check_page::check_html;
pub use csv::{csv_field, residuals_csv};
pub use detection::{DETECTION_FORMAT, contours_csv, detection_json, detection_shapes, discs_csv, features_csv};
pub use html::{OverlayInput, write_html};
pub use overlay::{Label, Marks, OverlayShapes, Polyline, RejectedMark, overlay_png};
pub use text::text;
pub use vectors::{VectorPicture, vectors_svg};
pub use verdict::{CUT_AT_ZERO, CUT_OFF, Level, SATURATED, TOO_BLACK, Verdict, verdict};
