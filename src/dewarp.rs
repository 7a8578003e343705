//! From pixels to the laser sheet and back: mapping functions, view angles, and images resampled on a grid of the sheet.
//!
//! A pixel q of camera c sees the points of one ray; in the sheet frame that ray is `p(z) = (x, y, z)`:
//! ```text
//! q = image_c(R p + t)                          cam_from_sheet = (R, t)         exact, lens and tilt included
//! (x, y) = o + (z - o_z) s,   s = (d_x, d_y) / d_z,   d = R^T ray(q),   o = -R^T t
//! s = d(x, y)/dz along the ray = (tan a_x, tan a_y)                           view slopes
//! ```
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | (x, y, z) | `x_mm`, `y_mm`, `z_mm` | mm | Sheet | a point; z = 0 is the middle of the sheet |
//! | (u, v) | `u_px`, `v_px` | px | Sensor | its image; (0, 0) is the centre of the first pixel |
//! | s | `dx_dz`, `dy_dz` | 1 | Sheet | slope of the ray of a pixel |
//! | a_x, a_y | `x_rad`, `y_rad` | rad | Sheet | view angles: of the ray to the sheet's normal, in the planes y = const and x = const |
//!
//! **Frame and sign of w.** Sheet frame: x right and y up as the first camera sees them, z towards the first camera. The
//! out-of-plane velocity w is along z: **positive towards the first camera**, unless a [`Placement`] turns the frame round.
//! A particle that moves by (u, v, w) seems to move by `(u, v) - w s` in the dewarped image of a camera.
//!
//! Source: method of direct dewarping with the three-dimensional pinhole map, Soloff, Adrian, Liu, Meas. Sci. Technol. 8
//! (1997) 1441, for the polynomial map; Willert, Meas. Sci. Technol. 8 (1997) 1465. Not valid for a camera that looks along
//! the sheet, where `d_z = 0`: such pixels have no place (`NaN`).

mod bulk;
mod chebyshev;
mod cluster;
mod grid;
mod kernel;
mod map;
mod panels;
mod placement;
mod resample;
mod rows;
mod sampler;
mod soloff;
mod weights;

pub use grid::SheetGrid;
pub use kernel::Kernel;
pub use map::{NoMeeting, PixelJets, Pixels, SheetJets, SheetMap, SheetPoints, ViewAngles};
pub use placement::Placement;
pub use resample::{Dewarped, dewarp, dewarp_into};
pub(crate) use resample::{dewarped_levels, resample};
pub use sampler::Sampler;
pub use soloff::{Soloff, SoloffDegrees, SoloffFit, SoloffVolume};
