//! Soloff's polynomial as text: one file of coefficients per camera.
//!
//! ```text
//! u = sum a_ijk X^i Y^j Z^k,   v = sum b_ijk X^i Y^j Z^k                 i + j + k <= 3, k <= 2: 19 terms (other degrees on request)
//! X = (x - middle_x) / half_x,  Y and Z alike                            -1 to 1 in the volume
//! ```
//! (x, y, z) in mm of the sheet frame, z towards the first camera; (u, v) in px, (0, 0) the centre of the first pixel, v down. The volume
//! is the field that all cameras see, 2 % of the smallest distance before and behind the sheet; outside it the polynomial is worth nothing. The
//! file is lines of words: a key and its numbers, then `i j k a_px b_px` per term; `#` begins a comment.
//!
//! Source: Soloff, Adrian, Liu, Meas. Sci. Technol. 8 (1997) 1441, eq 17; coordinates scaled, which loses no digits.

use super::refit::DEPTH;
use super::{Cameras, Conversion, Loss, WorldCamera};
use crate::dewarp::{SheetGrid, SheetMap, Soloff, SoloffDegrees, SoloffFit, SoloffVolume};
use crate::error::Result;
use std::fmt::Write;

/// What all cameras see, mm.
fn volume(cameras: &[WorldCamera], maps: &[SheetMap]) -> Result<SoloffVolume> {
    let [x0, y0, x1, y1] = SheetGrid::common(&maps.iter().collect::<Vec<_>>(), None)?.extent_mm();
    let distance = |c: &WorldCamera| c.cam_from_world.inverse().translation_mm.z.abs();
    let nearest = cameras.iter().map(distance).fold(f64::INFINITY, f64::min);
    Ok(SoloffVolume {
        middle_mm: [0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0],
        half_mm: [0.5 * (x1 - x0), 0.5 * (y1 - y0), DEPTH * nearest],
    })
}

fn text(c: &WorldCamera, fit: &SoloffFit) -> String {
    let v = fit.map.volume();
    let row = |v: [f64; 3]| v.map(|x| format!("{x:.17e}")).join(" ");
    let mut out = format!(
        "# Soloff polynomial of camera {}: sheet (x, y, z) in mm to pixel (u, v)\n\
         # u = sum a X^i Y^j Z^k, v = sum b X^i Y^j Z^k, X = (x - middle_x) / half_x and so on; only within -1 to 1\n\
         # z towards the first camera; (0, 0) is the centre of the first pixel, v down\n\
         # departs from the exact map by {:.3e} px rms, {:.3e} px at most\n\
         image_size_px {} {}\nmiddle_mm {}\nhalf_mm {}\n# i j k a_px b_px\n",
        c.name.replace(char::is_control, " "),
        fit.rms_px,
        fit.largest_px,
        c.image_size_px[0],
        c.image_size_px[1],
        row(v.middle_mm),
        row(v.half_mm)
    );
    for ([i, j, k], [a, b]) in fit.map.terms() {
        // Writing to a String cannot fail.
        let _ = writeln!(out, "{i} {j} {k} {a:.17e} {b:.17e}");
    }
    out
}

/// `soloff_<camera>.txt` per camera.
pub(super) fn export(rig: &Cameras, degrees: SoloffDegrees) -> Result<Conversion<Vec<(String, Vec<u8>)>>> {
    let maps: Vec<SheetMap> =
        rig.cameras.iter().map(|c| SheetMap::new(c.camera, c.cam_from_world, c.image_size_px)).collect();
    let volume = volume(&rig.cameras, &maps)?;
    let (mut result, mut losses, mut notes) = (Vec::new(), Vec::new(), rig.notes.clone());
    for ((c, map), name) in rig.cameras.iter().zip(&maps).zip(rig.file_names()) {
        let fit = Soloff::fit(map, volume, degrees)?;
        result.push((format!("soloff_{name}.txt"), text(c, &fit).into_bytes()));
        losses.push(Loss { rms_px: fit.rms_px, max_px: fit.largest_px });
    }
    let [x, y, z] =
        [0, 1, 2].map(|a| (volume.middle_mm[a] - volume.half_mm[a], volume.middle_mm[a] + volume.half_mm[a]));
    notes.push(format!(
        "the polynomials hold for x {:.2} to {:.2}, y {:.2} to {:.2}, z {:.2} to {:.2} mm only",
        x.0, x.1, y.0, y.1, z.0, z.1
    ));
    Ok(Conversion::of(result, losses, notes))
}
