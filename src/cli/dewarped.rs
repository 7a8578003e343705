//! `dewarp.json`: on which grid images were dewarped, and with which calibration.

use super::files::{fault, read_text};
use crate::dewarp::{SheetGrid, SheetMap};
use crate::error::Result;
use crate::record::Record;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Two calibrations that send a point of the grid farther apart than this are two, px.
const SAME_PX: f64 = 0.05;

/// What is read of `dewarp.json` again.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Dewarped {
    pub(super) grid: SheetGrid,
    /// Position of the grid along the sheet's normal, mm.
    #[serde(default)]
    pub(super) z_mm: f64,
    /// Where the corners and the middle of the grid lie in the image of each camera, px; `null` where it does not see them.
    #[serde(default)]
    pub(super) grid_in_images_px: BTreeMap<String, Vec<Option<[f64; 2]>>>,
}

impl Dewarped {
    pub(super) fn new(record: &Record, maps: &[&SheetMap], grid: SheetGrid, z_mm: f64) -> Self {
        let [right, bottom] = [(grid.width_px - 1) as f64, (grid.height_px - 1) as f64];
        let places = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom], [0.5 * right, 0.5 * bottom]];
        let seen = |map: &SheetMap| {
            let at = |[i, j]: [f64; 2]| {
                let [x, y] = grid.point_mm(i, j);
                map.pixel_from_sheet(&nalgebra::Vector3::new(x, y, z_mm)).ok().map(|p| [p.x, p.y])
            };
            places.map(at).to_vec()
        };
        let grid_in_images_px = record.cameras.iter().zip(maps).map(|(c, m)| (c.name.clone(), seen(m))).collect();
        Self { grid, z_mm, grid_in_images_px }
    }

    /// The grid of images that were dewarped with this calibration.
    ///
    /// # Errors
    /// [`crate::error::Invalid::File`] where this is no `dewarp.json`, that of another calibration, or not of the sheet itself.
    pub(super) fn grid_of(path: &Path, record: &Record, maps: &[&SheetMap]) -> Result<SheetGrid> {
        let text = read_text(path, "the dewarp.json that spivcal dewarp writes beside its images")?;
        let told: Self = serde_json::from_str(&text)
            .map_err(|e| fault(path, format!("this is not a dewarp.json of spivcal dewarp: {e}")))?;
        if told.z_mm != 0.0 {
            let what = format!(
                "the images were dewarped at z = {} mm; vectors need images of the sheet itself (z = 0)",
                told.z_mm
            );
            return Err(fault(path, what));
        }
        let own = Self::new(record, maps, told.grid, 0.0);
        for (name, then) in &told.grid_in_images_px {
            let Some(now) = own.grid_in_images_px.get(name) else {
                let what = format!(
                    "the images were dewarped with a calibration that has a camera \"{name}\"; this one has none"
                );
                return Err(fault(path, what));
            };
            let pairs = then.iter().zip(now).filter_map(|(a, b)| a.zip(*b));
            let apart = pairs.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).fold(0.0, f64::max);
            if apart > SAME_PX {
                let what = format!(
                    "the images were dewarped with another calibration: points of their grid lie up to {apart:.2} px elsewhere in the images of camera \"{name}\"; \
                     dewarp them again with this one, or name the one they were dewarped with"
                );
                return Err(fault(path, what));
            }
        }
        Ok(told.grid)
    }
}
