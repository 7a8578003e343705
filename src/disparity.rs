//! Is the sheet where the calibration says? Particle images of both cameras answer (Wieneke's self-calibration).
//!
//! Both cameras see the same particles at the same moment. Where the calibrated sheet is off the light by Z, the two dewarped images
//! are apart by the disparity
//! ```text
//! d = x_2 - x_1 = -Z (s_2 - s_1)                  s_c slope of the ray of camera c, see dewarp
//! Z = argmin |x_1 + Z s_1 - x_2 - Z s_2|^2        triangulation; what is left across s_2 - s_1 no sheet explains
//! Z = a + b X + c Y                               weighted, robust: the sheet's true place in its own frame
//! ```
//! 1. *Acquire*: both images are dewarped on planes z = const, coarsely, and multiplied; blocks of the field vote for the plane
//!    (offset and two tilts) on which they are most alike. Finds offsets of several mm and tilts of several degrees.
//! 2. *Measure*: ensemble correlation of windows over all pairs by FFT, coarse windows first, subpixel peak by a Gaussian.
//! 3. *Refit* the plane, and again, until the disparity no longer changes.
//! 4. *Cameras*, where it is asked for: what no plane takes away corrects cameras and plane together, weighed against the calibration's
//!    covariance (`cameras.rs`).
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | d | `dx_px`, `dy_px` | px of the dewarped image | Sheet (y up) | second camera minus first |
//! | Z | `z_mm` | mm | Sheet | place of the light along the normal |
//! | s_z | `thickness_mm` / (4 sqrt 2) | mm | Sheet | depth of the particles that make the correlation peak |
//!
//! **Walls.** What stands still is left out by masks (`masks.rs`), taken off with the mean of all moments, or told (`still.rs`).
//!
//! **Thickness.** Particles at different depth have different disparity, so the cross-correlation peak is wider along s_2 - s_1
//! than the autocorrelation peaks: `s_z^2 |s_2 - s_1|^2 = C_12 - (C_11 + C_22) / 2` (`smear.rs`). Both images carry the light's profile, so the
//! product falls off as its square: the profile's standard deviation is sqrt(2) s_z, its full width at 1/e^2 four times that. Windows and
//! background in which it is looked at are as large as that width asks for (`light.rs`).
//!
//! **Displacements.** The same correlation between two exposures of one camera gives planar displacements ([`planar_displacements`]).
//!
//! Sigmas of the plane hold the scatter of the windows, which do not overlap, and the calibration's covariance (`propagate.rs`).
//! **What is left.** Windows scatter about the right sheet, too: few particles, anywhere in the light's thickness
//! (`misalignment.rs`; the light along the normal: `profile.rs`). Sources: Wieneke, Exp.
//! Fluids 39 (2005) 267; Wieneke, Meas. Sci. Technol. 29 (2018) 084002. Not valid for images without common particles (refused),
//! and blind to errors of the cameras that a plane can mimic.

mod acquire;
mod anchor;
mod cameras;
mod check;
mod correlate;
mod lattice;
mod light;
mod masks;
mod misalignment;
mod peak;
mod planar;
mod plane;
mod prepare;
mod profile;
mod propagate;
mod round;
mod scatter;
mod smear;
mod stepped;
mod still;

pub use check::{CheckOptions, CheckOutput, ParticlePair, check_sheet, check_sheet_masked};
pub use planar::{PlanarOptions, PlanarVectors, planar_displacements};
pub use plane::sheet_of_view;
