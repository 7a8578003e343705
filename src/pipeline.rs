//! The order of things: from files and rig descriptions to results.

mod blacks;
mod calibrate;
mod exposure;
mod files;
mod images;
mod leftovers;
mod load;
mod model;
mod nominal;
mod off_grid;
mod outcome;
mod png;
mod residual_rows;
mod sheet_alone;
mod sheet_part;
mod tiff_file;
mod workers;

pub use blacks::cut_at_zero;
pub use calibrate::{CalibrateOptions, CalibrationOutput, calibrate};
pub use exposure::saturated_about;
pub use files::{Output, can_write, of_the_system, read_text, spares};
pub use images::SeenImage;
pub use load::{has_further_pages, load_image};
pub use model::{AXIS_POINT_SIGMA, LOSS_SIGMAS, POINT_SIGMA};
pub use png::png_bytes;
pub use sheet_alone::{SheetOptions, SheetOutput, TRANSFER_LIMIT_PX, find_sheet};
pub use tiff_file::{ImageScale, tiff_bytes};
pub use workers::{MOST_THREADS, STACK_BYTES, Workers};

use crate::error::Result;
use crate::image::GrayImage;
use std::sync::Arc;

/// Gives the image of a view and camera of the rig file; called from several threads. What somebody else keeps is shared, not copied.
pub type Source<'a> = dyn Fn(usize, usize) -> Result<Arc<GrayImage>> + Sync + 'a;

/// What long work tells about itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Progress<'a> {
    /// An image has been searched.
    Image {
        /// Images done.
        done: usize,
        /// Images in all.
        total: usize,
        /// Name of the image.
        name: &'a str,
    },
    /// An image is being searched: nothing new, but a question whether to go on.
    Searching,
    /// A step of the adjustment.
    Iteration {
        /// Linearisations so far in this solve.
        number: usize,
        /// Cost.
        cost: f64,
        /// Newton decrement, in sigmas.
        decrement: f64,
    },
}
