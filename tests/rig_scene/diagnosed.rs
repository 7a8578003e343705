//! A scene with noise and facts drawn, adjusted with the sigmas given, and what the diagnosis finds of it.

use super::{Noise, Scene, given_sigmas};
use spivcal::bundle::{Adjustment, Iteration, adjust, named_covariance};
use spivcal::diagnosis::{Findings, Subject, diagnose};
use spivcal::error::Result;
use spivcal::target::DotId;

/// Fresh noise on edges and a fresh draw of every fact.
pub(crate) fn drawn(scene: &Scene, seed: u64) -> Scene {
    let mut noise = Noise::new(seed.wrapping_mul(0x9e6c_63d0_876a_3f6b) >> 5);
    scene.with_noise(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 7).with_facts_drawn(&mut noise)
}

pub(crate) fn adjusted(scene: &Scene) -> Adjustment {
    adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true)
}

/// `observe` as [`diagnose`] asks it; labels count the discs in rows of three.
pub(crate) fn diagnosed_while(a: &Adjustment, observe: &(dyn Fn(&Iteration) -> bool + Sync)) -> Result<Findings> {
    let covariance = named_covariance(a).unwrap();
    let label = |k: usize| DotId { column: k as i32 % 3, row: k as i32 / 3, level: 0 };
    let labels: Vec<DotId> = (0..a.model.target.disc_count()).map(label).collect();
    let subject = Subject {
        adjustment: a,
        covariance: &covariance,
        assumed: &[],
        point_sigma_stated: true,
        labels: &labels,
        sizes_px: &[[1024.0, 768.0]; 2],
        sheet_frame: None,
        options: &given_sigmas(),
    };
    diagnose(&subject, observe)
}

pub(crate) fn diagnosed(a: &Adjustment) -> Findings {
    diagnosed_while(a, &|_| true).unwrap()
}
