//! Simulated discs beside their truth.

#![allow(clippy::unwrap_used, unreachable_pub)]

use spivcal::detect::{DetectOptions, Disc, find_discs};
use spivcal::simulate::{Scene, simulate};

/// Errors of the discs of a scene and their sigmas, centre u, v, semi-major, semi-minor, px, from the view `first` on.
pub fn errors_of_discs(scene: &Scene, first: usize) -> Vec<[(f64, f64); 4]> {
    errors_of_discs_found(scene, first, &DetectOptions::default())
}

/// The same of discs found as the options say.
pub fn errors_of_discs_found(scene: &Scene, first: usize, options: &DetectOptions) -> Vec<[(f64, f64); 4]> {
    let simulation = simulate(scene).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&simulation.truth_json).unwrap();
    let mut errors = vec![];
    for view in truth["views"].as_array().unwrap().iter().skip(first) {
        for (camera, file) in view["images"].as_object().unwrap() {
            let image = &simulation.images.iter().find(|(name, _)| Some(&name[..]) == file.as_str()).unwrap().1;
            let found = find_discs(&image.view(), options).unwrap().discs;
            for disc in view["discs"].as_array().unwrap() {
                let e = &disc["images"][camera]["ellipse"];
                let at = |key: &str| e[key].as_f64().unwrap();
                let (u, v) = (e["center_px"][0].as_f64().unwrap(), e["center_px"][1].as_f64().unwrap());
                let away = |d: &&Disc| (d.ellipse.center_px.u_px - u).hypot(d.ellipse.center_px.v_px - v);
                let d = found.iter().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
                let off = [
                    d.ellipse.center_px.u_px - u,
                    d.ellipse.center_px.v_px - v,
                    d.ellipse.semi_major_px - at("semi_major_px"),
                    d.ellipse.semi_minor_px - at("semi_minor_px"),
                ];
                errors.push(std::array::from_fn(|k| (off[k], d.covariance[(k, k)].sqrt())));
            }
        }
    }
    errors
}
