//! From pictures to sigmas: `examples/bubbles` in various light, rendered, detected and calibrated seed by seed, against the truth.
//!
//! Shared by the program `from_pictures` and the test of that name.

#![allow(clippy::unwrap_used, clippy::expect_used, unreachable_pub)]

#[path = "../bubbles_in/mod.rs"]
mod bubbles_in;
#[path = "../joint/mod.rs"]
mod joint;

use bubbles_in::bubbles_in;
use spivcal::pipeline::CalibrateOptions;
use spivcal::record::{Camera, Record};

/// Light of a scene: its name, share of the smoke and the length of its waves in mm, unevenness of the illumination.
pub const LIGHTS: [(&str, f64, f64, f64); 6] = [
    ("even", 0.0, 6.0, 0.0),
    ("uneven", 0.0, 6.0, 0.05),
    ("more-uneven", 0.0, 6.0, 0.2),
    ("slow-smoke", 0.3, 6.0, 0.2),
    ("smoke", 0.3, 2.5, 0.2),
    ("short-smoke", 0.3, 0.7, 0.2),
];

pub const QUANTITIES: [&str; 12] = [
    "effective f, left",
    "effective f, right",
    "effective cx, left",
    "effective cx, right",
    "effective cy, left",
    "effective cy, right",
    "k1, left",
    "k1, right",
    "baseline",
    "angle between the axes",
    "angle of the sheet to the baseline",
    "distance of the sheet",
];

/// One scene calibrated.
pub struct Run {
    /// Error and sigma of each of [`QUANTITIES`].
    pub quantities: [[f64; 2]; QUANTITIES.len()],
    /// Chi-square of the edge points over the degrees of freedom.
    pub fit: f64,
    /// Chi-square of all numbers of both cameras against the truth, over their number. Where axis points are known to 10 px only, the valley
    /// along which they and the tilts lie bends, and linear propagation says little of it.
    pub joint: f64,
}

impl Run {
    /// `None` for light without a name in [`LIGHTS`].
    pub fn of(light: &str, seed: u64) -> Option<Self> {
        let (_, smoke, length_mm, unevenness) = LIGHTS.into_iter().find(|l| l.0 == light)?;
        let options = CalibrateOptions { threads: 1, ..CalibrateOptions::default() };
        let (record, truth) = joint::calibrated(&bubbles_in(seed, [smoke, length_mm, unevenness]), &options);
        let (joint, numbers) = joint::joint_chi2(&record, &truth);
        Some(Self {
            quantities: quantities(&record, &truth),
            fit: record.fit.chi2 / record.fit.degrees_of_freedom as f64,
            joint: joint / numbers as f64,
        })
    }
}

fn quantities(record: &Record, truth: &Record) -> [[f64; 2]; QUANTITIES.len()] {
    let both = |value: &dyn Fn(&Camera) -> f64, sigma: &dyn Fn(&Camera) -> f64| {
        [0, 1].map(|c| [value(&record.cameras[c]) - value(&truth.cameras[c]), sigma(&record.cameras[c])])
    };
    let cameras = [
        both(&|c| c.effective.f_px, &|c| c.sigma.effective.f_px),
        both(&|c| c.effective.cx_px, &|c| c.sigma.effective.cx_px),
        both(&|c| c.effective.cy_px, &|c| c.sigma.effective.cy_px),
        both(&|c| c.k1, &|c| c.sigma.k1),
    ];
    let [rig, true_rig] = [record, truth].map(|r| r.rig.as_ref().unwrap());
    let [sheet, true_sheet] = [record, truth].map(|r| r.sheet.as_ref().unwrap());
    let rest = [
        [rig.baseline_mm - true_rig.baseline_mm, rig.sigma.baseline_mm],
        [rig.axes_angle_deg - true_rig.axes_angle_deg, rig.sigma.axes_angle_deg],
        [sheet.angle_to_baseline_deg - true_sheet.angle_to_baseline_deg, sheet.sigma.angle_to_baseline_deg],
        [sheet.distance_mm - true_sheet.distance_mm, sheet.sigma.distance_mm],
    ];
    std::array::from_fn(|k| cameras.as_flattened().get(k).copied().unwrap_or_else(|| rest[k - 8]))
}

/// What many runs say.
pub struct Summary {
    /// Median sigma, mean error over its sigma, mean of the squares of that, of each of [`QUANTITIES`].
    pub quantities: [[f64; 3]; QUANTITIES.len()],
    pub fit: f64,
    pub joint: f64,
}

impl Summary {
    pub fn of(runs: &[Run]) -> Self {
        let mean = |of: &dyn Fn(&Run) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
        let quantity = |k: usize| {
            let mut sigmas: Vec<f64> = runs.iter().map(|r| r.quantities[k][1]).collect();
            sigmas.sort_by(f64::total_cmp);
            let z = |r: &Run| r.quantities[k][0] / r.quantities[k][1];
            [sigmas[sigmas.len() / 2], mean(&z), mean(&|r| z(r).powi(2))]
        };
        Self { quantities: std::array::from_fn(quantity), fit: mean(&|r| r.fit), joint: mean(&|r| r.joint) }
    }
}
