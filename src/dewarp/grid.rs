//! The grid of a dewarped image in the sheet.

use super::map::SheetMap;
use crate::error::{Insufficient, Invalid, Result};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Points per side of an image's border that are followed to the sheet.
const BORDER: usize = 65;
/// Points per side of the lattice on which the common field is looked for.
const LATTICE: usize = 201;
/// Most pixels along a side of a dewarped image.
const LARGEST_PX: usize = 32_768;

/// Square pixels in the plane z = const: pixel (i, j) is centred on `(x0 + s i, y0 - s j)`, so that y goes up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "AsRead")]
pub struct SheetGrid {
    /// Centre of the first (upper left) pixel, sheet frame, mm.
    pub origin_mm: [f64; 2],
    /// Side of a pixel, mm.
    pub mm_per_px: f64,
    /// Pixels along x.
    pub width_px: usize,
    /// Pixels along y.
    pub height_px: usize,
}

/// A grid in a file, which may say anything.
#[derive(Deserialize)]
struct AsRead {
    origin_mm: [f64; 2],
    mm_per_px: f64,
    width_px: usize,
    height_px: usize,
}

impl TryFrom<AsRead> for SheetGrid {
    type Error = crate::Error;

    fn try_from(read: AsRead) -> Result<Self> {
        Self::at(read.origin_mm, read.mm_per_px, [read.width_px, read.height_px])
    }
}

impl SheetGrid {
    /// The grid whose first pixel is centred on `origin_mm`.
    ///
    /// # Errors
    /// [`Invalid::Value`] where a number is none, the pixel has no size, or there are no or too many pixels.
    pub fn at(origin_mm: [f64; 2], mm_per_px: f64, size_px: [usize; 2]) -> Result<Self> {
        if let Some(x) = origin_mm.iter().find(|x| !x.is_finite()) {
            return Err(Invalid::value("place of the first pixel", *x, "a number in mm of the sheet frame").into());
        }
        if !(mm_per_px > 0.0 && mm_per_px.is_finite()) {
            return Err(Invalid::value("mm per px", mm_per_px, "a positive number").into());
        }
        if let Some(n) = size_px.iter().find(|n| !(1..=LARGEST_PX).contains(*n)) {
            return Err(Invalid::value("pixels along a side", *n as f64, format!("1 to {LARGEST_PX}")).into());
        }
        Ok(Self { origin_mm, mm_per_px, width_px: size_px[0], height_px: size_px[1] })
    }

    /// The grid over `[x_min, y_min, x_max, y_max]`, mm.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the extent is empty, the pixel has no size, or there would be too many pixels.
    pub fn over(extent_mm: [f64; 4], mm_per_px: f64) -> Result<Self> {
        let [x0, y0, x1, y1] = extent_mm;
        if !(mm_per_px > 0.0 && mm_per_px.is_finite()) {
            return Err(Invalid::value("mm per px", mm_per_px, "a positive number").into());
        }
        let named = ["x_min", "y_min", "x_max", "y_max"].into_iter().zip(extent_mm);
        if let Some((name, x)) = named.into_iter().find(|(_, x)| !x.is_finite()) {
            return Err(Invalid::value(format!("{name} of the extent"), x, "a finite number of mm").into());
        }
        if !(x1 > x0 && y1 > y0) {
            let what = "x_min below x_max and y_min below y_max, in mm of the sheet frame";
            return Err(Invalid::value("extent", (x1 - x0).min(y1 - y0), what).into());
        }
        let count = |length: f64| {
            let n = (length / mm_per_px).round() + 1.0;
            if n <= LARGEST_PX as f64 {
                Ok(n as usize)
            } else {
                Err(Invalid::value(
                    "pixels along a side",
                    n,
                    format!("at most {LARGEST_PX}; choose more mm per px or a smaller extent"),
                ))
            }
        };
        Ok(Self { origin_mm: [x0, y1], mm_per_px, width_px: count(x1 - x0)?, height_px: count(y1 - y0)? })
    }

    /// The field that all cameras see, with the finest resolution that any of them has there unless one is given.
    ///
    /// The extent is that of the common field; its corners may be seen by one camera only (see the mask).
    ///
    /// # Errors
    /// [`Insufficient::Degenerate`] where the cameras see nothing in common; [`Invalid::Value`] as [`SheetGrid::over`].
    pub fn common(maps: &[&SheetMap], mm_per_px: Option<f64>) -> Result<Self> {
        let nothing = || {
            Insufficient::Degenerate(
                "the cameras see no common part of the laser sheet; check that the calibration is of this rig and that its sheet is \
                 where the laser is"
                    .into(),
            )
        };
        let mut field = [f64::NEG_INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY];
        for map in maps {
            let own = footprint_mm(map).ok_or_else(nothing)?;
            field = [field[0].max(own[0]), field[1].max(own[1]), field[2].min(own[2]), field[3].min(own[3])];
        }
        if !(field[2] > field[0] && field[3] > field[1]) {
            return Err(nothing().into());
        }
        let cell = [0, 1].map(|a| (field[a + 2] - field[a]) / (LATTICE - 1) as f64);
        let mut seen = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        let mut finest: Vec<Vec<f64>> = vec![vec![]; maps.len()];
        for j in 0..LATTICE {
            for i in 0..LATTICE {
                let p = [field[0] + cell[0] * i as f64, field[1] + cell[1] * j as f64];
                let scales: Option<Vec<f64>> = maps.iter().map(|m| finest_mm_per_px(m, p)).collect();
                let Some(scales) = scales else { continue };
                seen = [seen[0].min(p[0]), seen[1].min(p[1]), seen[2].max(p[0]), seen[3].max(p[1])];
                finest.iter_mut().zip(scales).for_each(|(all, s)| all.push(s));
            }
        }
        if !(seen[2] > seen[0] && seen[3] > seen[1]) {
            return Err(nothing().into());
        }
        // The border of the common field lies up to a cell beyond the last lattice point that was seen.
        for a in 0..2 {
            seen[a] = (seen[a] - cell[a]).max(field[a]);
            seen[a + 2] = (seen[a + 2] + cell[a]).min(field[a + 2]);
        }
        let median = |all: &mut Vec<f64>| {
            all.sort_by(f64::total_cmp);
            all[all.len() / 2]
        };
        let automatic = finest.iter_mut().map(median).fold(f64::INFINITY, f64::min);
        Self::over(seen, mm_per_px.unwrap_or(automatic))
    }

    /// Place of a pixel, mm.
    pub fn point_mm(&self, i_px: f64, j_px: f64) -> [f64; 2] {
        [self.origin_mm[0] + self.mm_per_px * i_px, self.origin_mm[1] - self.mm_per_px * j_px]
    }
    /// Pixel of a place, px.
    pub fn pixel(&self, x_mm: f64, y_mm: f64) -> [f64; 2] {
        [(x_mm - self.origin_mm[0]) / self.mm_per_px, (self.origin_mm[1] - y_mm) / self.mm_per_px]
    }
    /// `[x_min, y_min, x_max, y_max]` of the pixel centres, mm.
    pub fn extent_mm(&self) -> [f64; 4] {
        let [x1, y0] = self.point_mm((self.width_px - 1) as f64, (self.height_px - 1) as f64);
        [self.origin_mm[0], y0, x1, self.origin_mm[1]]
    }
    /// The same field with pixels `factor` times as large.
    pub(crate) fn coarser(&self, factor: usize) -> Self {
        let size = |n: usize| (n / factor).max(1);
        let middle = 0.5 * (factor as f64 - 1.0);
        Self {
            origin_mm: self.point_mm(middle, middle),
            mm_per_px: self.mm_per_px * factor as f64,
            width_px: size(self.width_px),
            height_px: size(self.height_px),
        }
    }
}

/// Smallest length in the sheet that one pixel of movement in the image makes, mm per px; none where the camera does not see the
/// point.
fn finest_mm_per_px(map: &SheetMap, p: [f64; 2]) -> Option<f64> {
    let (q, d) = map.project_jet(&Vector3::new(p[0], p[1], 0.0))?;
    if !map.on_sensor(&q) {
        return None;
    }
    // Largest singular value of dq/d(x, y), px per mm.
    let m = d.fixed_columns::<2>(0).into_owned();
    let (half, det) = (0.5 * m.norm_squared(), m.determinant());
    let s = 1.0 / (half + (half * half - det * det).max(0.0).sqrt()).sqrt();
    s.is_finite().then_some(s)
}

/// Bounding box in the sheet of what a camera sees of it, mm.
fn footprint_mm(map: &SheetMap) -> Option<[f64; 4]> {
    let [w, h] = map.size_px().map(|n| n as f64);
    let mut out = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for i in 0..BORDER {
        let t = i as f64 / (BORDER - 1) as f64;
        for q in [[t * w, 0.0], [t * w, h], [0.0, t * h], [w, t * h]] {
            if let Some(hit) = map.hit(&Vector2::new(q[0] - 0.5, q[1] - 0.5), 0.0) {
                let p = hit.xy_mm;
                out = [out[0].min(p.x), out[1].min(p.y), out[2].max(p.x), out[3].max(p.y)];
            }
        }
    }
    (out[2] > out[0] && out[3] > out[1]).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_that_a_file_says_is_one_that_could_be_made() {
        let read = |mm_per_px: f64, width_px: u64| {
            let text = format!(
                r#"{{"origin_mm": [1.0, 2.0], "mm_per_px": {mm_per_px:?}, "width_px": {width_px}, "height_px": 5}}"#
            );
            serde_json::from_str::<SheetGrid>(&text)
        };
        assert_eq!(read(0.1, 4).unwrap(), SheetGrid::at([1.0, 2.0], 0.1, [4, 5]).unwrap());
        for (mm_per_px, width_px) in [(0.0, 4), (-0.1, 4), (0.1, 0), (0.1, 1 << 63)] {
            assert!(read(mm_per_px, width_px).is_err(), "{mm_per_px} {width_px}");
        }
    }
}
