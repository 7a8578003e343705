//! Two planar displacement fields to three components with standard deviations.
//!
//! A particle at P = (x, y, 0) of the sheet frame that moves by D = (u, v, w) moves in camera c by
//! ```text
//! d_c = q_c(P + D/2) - q_c(P - D/2)      `center`: the vector belongs to the middle of the path (central differences)
//! d_c = q_c(P + D) - q_c(P)              `start`:  it belongs to where the path begins
//! D = argmin sum_c |W_c (d_c - measured_c)|^2 / s_c^2      Gauss-Newton, exact maps, four equations for three unknowns
//! C_D = (sum_c J_c^T W_c^T W_c J_c / s_c^2)^-1,   J_c = dq_c/dP;     r = what is left of the four
//! ```
//! w is positive towards the first camera (z of the sheet frame). One equation is left over: its size over the whole field
//! gives the noise of the planar vectors where the user gives none (`noise.rs`), and marks the vectors that do not fit.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | d_c | `displacement` | px | Sensor | planar displacement in raw pixels of camera c, interpolated on its own grid |
//! | D | `u_mm`, `v_mm`, `w_mm` | mm | Sheet | displacement |
//! | W_c | `white` | unit/px | | from raw px to the unit of the fields: root of the determinant of that map (raw px: 1) |
//! | s_c | `sigma` | unit | | standard deviation of one component of a planar vector, times that of its interpolation |
//! | r | `residual_px` | px | Sensor | root of the sum of squares of what four equations leave |
//!
//! The noise is alike along x and y in *raw* pixels, of dewarped images as well: dewarping stretches the images of particles, and with
//! them the error, where a camera looks obliquely (measured on `examples/vortex`: 1.33 times along x; 1.31 by the view angles).
//!
//! Files may state the standard deviation of every vector along the axes of the field (`sigma_dx_mm`, `sigma_dy_mm`); these then take the place of
//! s_c and W_c, and the residuals tell how much of the errors both cameras share (`shared.rs`).
//!
//! Displacements in mm or px of dewarped images are taken back to raw pixels through the map that dewarped them, so that the
//! calibration's covariance acts on them as on raw ones. That covariance is propagated by moving the calibration by one
//! sigma along each column of its Cholesky factor.
//!
//! Sources: Prasad, Exp. Fluids 29 (2000) 103; Wieneke, Exp. Fluids 39 (2005) 267; grids by Keys' cubic, IEEE Trans. ASSP 29
//! (1981) 1153. Not valid where both cameras look along one line (no w) and where a vector is longer than its field is smooth.

mod calibration;
mod components;
mod grid;
mod noise;
mod read;
mod shared;
mod text;
mod vectors;

pub use calibration::{PerturbedMaps, perturbed_maps};
pub use components::{Components, PlanarPair, component_sigmas, three_components};
pub use grid::{OVERLAP, PlanarField};
pub use read::{FieldFormat, FieldTable, FieldUnit, parse_field};
pub use vectors::{Options, Reference, VectorField, flag, reconstruct};
