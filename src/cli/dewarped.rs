//! `dewarp.json`: on which grid images were dewarped, and with which calibration.

use super::files::{fault, read_text};
use crate::dewarp::{SheetGrid, SheetMap};
use crate::error::Result;
use crate::record::Record;
use serde::{Deserialize, Serialize};
use serde_json::Value;
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
    /// What is said of each image.
    #[serde(default)]
    images: Vec<Value>,
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
        Self { grid, z_mm, grid_in_images_px, images: vec![] }
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
        if let Some(name) = told.grid_in_images_px.keys().find(|n| !own.grid_in_images_px.contains_key(*n)) {
            let what =
                format!("the images were dewarped with a calibration that has a camera \"{name}\"; this one has none");
            return Err(fault(path, what));
        }
        for name in own.grid_in_images_px.keys() {
            let Some(apart) = told.apart_px(&own, name) else {
                let what = format!(
                    "it does not say where its grid lies in the images of camera \"{name}\", or nowhere where that sees it with this calibration: whether \
                     the images were dewarped with it cannot be told; dewarp them again with this one"
                );
                return Err(fault(path, what));
            };
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

    /// How far the grid lies elsewhere in the images of a camera, px; none where no point of it is known in both.
    fn apart_px(&self, other: &Self, camera: &str) -> Option<f64> {
        let [then, now] = [self, other].map(|d| d.grid_in_images_px.get(camera));
        let pairs = then?.iter().zip(now?).filter_map(|(a, b)| a.zip(*b));
        pairs.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).reduce(f64::max)
    }

    /// What a folder says of images that are there besides those of the files named, which are to be written.
    ///
    /// # Errors
    /// [`crate::error::Invalid::File`] where those are on another grid, or of another calibration: one `dewarp.json` tells of all.
    pub(super) fn others(&self, folder: &Path, named: &[String]) -> Result<Vec<Value>> {
        let path = folder.join("dewarp.json");
        let told = std::fs::read_to_string(&path).ok().and_then(|text| serde_json::from_str::<Self>(&text).ok());
        let Some(told) = told else { return Ok(vec![]) };
        let file = |image: &Value| image["file"].as_str().map(str::to_string);
        let there = |f: &String| !named.contains(f) && folder.join(f).is_file();
        let others: Vec<Value> = told.images.iter().filter(|i| file(i).is_some_and(|f| there(&f))).cloned().collect();
        let Some(first) = others.first().and_then(file) else { return Ok(others) };
        let same = |name: &String| told.apart_px(self, name).is_some_and(|apart| apart <= SAME_PX);
        if told.grid == self.grid && told.z_mm == self.z_mm && told.grid_in_images_px.keys().all(same) {
            return Ok(others);
        }
        let what = format!(
            "{first} and what else is told here lies on another grid, {} x {} px of {} mm at z = {} mm, or is of another calibration; dewarp into another \
             folder (-o), or all images at once",
            told.grid.width_px, told.grid.height_px, told.grid.mm_per_px, told.z_mm
        );
        Err(fault(&path, what))
    }
}
