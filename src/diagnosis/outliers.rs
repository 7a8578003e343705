//! Discs that were set aside, each with a reason as far as the images show one.

use super::{Subject, digits};
use crate::bundle::Outlier;
use crate::record::{OFF_ITSELF, OutlierReason};
use std::collections::BTreeSet;

/// `lacking`: whether the images ask for something that the model does not have.
pub(super) fn outliers(s: &Subject<'_>, lacking: bool) -> Vec<OutlierReason> {
    let (all, model) = (&s.adjustment.outliers, &s.adjustment.model);
    all.iter()
        .map(|o| {
            let label = s.labels.get(o.disc).copied();
            OutlierReason {
                view: o.view,
                camera: model.cameras[o.camera].name.clone(),
                disc: label.map_or([0; 3], |l| [l.column, l.row, i32::from(l.level)]),
                distance_px: o.distance_px,
                reason: reason(o, all, !model.target.per_view(), lacking),
            }
        })
        .collect()
}

/// Why one of `all` that were set aside is; `shared`: all views show the same discs.
fn reason(o: &Outlier, all: &[Outlier], shared: bool, lacking: bool) -> String {
    let same_disc = |other: &&Outlier| other.disc == o.disc;
    let here = all.iter().filter(same_disc).filter(|x| x.view == o.view && x.camera != o.camera).count();
    let elsewhere = all.iter().filter(same_disc).filter(|x| x.view != o.view).map(|x| x.view);
    let elsewhere = elsewhere.collect::<BTreeSet<usize>>().len();
    let in_image = all.iter().filter(|x| x.view == o.view && x.camera == o.camera).count();
    let off = format!("{} px from where the other discs expect it", digits(o.distance_px, 2));
    // That may be all that is wrong with a disc.
    if lacking {
        format!("{off}: perhaps by nothing but what the model lacks (see what the images ask for)")
    } else if shared && elsewhere > 0 {
        format!("{off}, and off in {elsewhere} more view(s): {OFF_ITSELF}")
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
}

#[cfg(test)]
mod tests {
    use super::*;

    fn off(view: usize, camera: usize, disc: usize) -> Outlier {
        Outlier { view, camera, disc, distance_px: 0.53 }
    }

    /// Where the model lacks something no dot is called damaged for it.
    #[test]
    fn each_reason_where_it_belongs() {
        let all = [
            off(0, 0, 7),
            off(3, 1, 7),
            off(3, 0, 7),
            off(1, 0, 4),
            off(1, 1, 4),
            off(2, 0, 1),
            off(2, 0, 2),
            off(2, 0, 3),
        ];
        let of = |k: usize, shared: bool, lacking: bool| reason(&all[k], &all, shared, lacking);
        assert!(of(0, true, false).starts_with("0.53 px from where"));
        for (k, shared, lacking, words) in [
            (0, true, false, "off in 1 more view(s): the dot itself is misplaced or damaged"),
            (0, false, false, "in this image only"),
            (3, true, false, "in both cameras"),
            (5, true, false, "with 2 more in this image"),
            (0, true, true, "nothing but what the model lacks"),
            (5, true, true, "nothing but what the model lacks"),
        ] {
            assert!(of(k, shared, lacking).contains(words), "{}", of(k, shared, lacking));
        }
    }
}
