//! Discs that were set aside, each with a reason as far as the images show one.

use super::{Subject, digits};
use crate::record::OutlierReason;

pub(super) fn outliers(s: &Subject<'_>) -> Vec<OutlierReason> {
    let all = &s.adjustment.outliers;
    let model = &s.adjustment.model;
    let reason = |o: &crate::bundle::Outlier| {
        let same_disc = |other: &&crate::bundle::Outlier| other.disc == o.disc;
        let here = all.iter().filter(same_disc).filter(|x| x.view == o.view && x.camera != o.camera).count();
        let elsewhere = all.iter().filter(same_disc).filter(|x| x.view != o.view).count();
        let in_image = all.iter().filter(|x| x.view == o.view && x.camera == o.camera).count();
        let off = format!("{} px from where the other discs expect it", digits(o.distance_px, 2));
        let shared = !model.target.per_view();
        if shared && elsewhere > 0 {
            format!("{off}, and off in {elsewhere} more view(s): the dot itself is misplaced or damaged on the target")
        } else if here > 0 {
            format!("{off}, in both cameras: the dot is misplaced on the target, or the target is bent there")
        } else if in_image > 2 {
            format!(
                "{off}, with {} more in this image: part of the image is disturbed (reflection, shadow, refraction)",
                in_image - 1
            )
        } else {
            format!("{off}, in this image only: a reflection, dirt or a speck at its rim, or another disc taken for it")
        }
    };
    all.iter()
        .map(|o| {
            let label = s.labels.get(o.disc).copied();
            OutlierReason {
                view: o.view,
                camera: model.cameras[o.camera].name.clone(),
                disc: label.map_or([0; 3], |l| [l.column, l.row, i32::from(l.level)]),
                distance_px: o.distance_px,
                reason: reason(o),
            }
        })
        .collect()
}
