//! Priors against the images, in words.

use super::keys::intrinsic_unit;
use super::{Asked, FALSE_ALARMS, Subject, digits, measured};
use crate::bundle::{
    Fact, MOSTLY_PRIOR, Model, ONLY_PRIOR, PlanePosition, PriorCheck, PriorOf, TargetShape, ViewPlace, intrinsic_words,
    layer_words, prior_checks,
};
use crate::record::Prior;
use crate::stats::{chi_square_above, normal_beyond};

/// What a prior is about, how it is shown, and what to do about a conflict.
struct Known {
    name: String,
    value: f64,
    sigma: f64,
    factor: f64,
    unit: &'static str,
    advice: &'static str,
}

/// What was asked of the priors.
#[derive(Default)]
pub(super) struct Priors {
    pub(super) asked: Vec<Asked<Prior>>,
    /// What the first of them are about; those that follow are about all dots together.
    of: Vec<PriorOf>,
}

impl Priors {
    /// The model without those that a user must look at, and their number.
    pub(super) fn without_flagged(&self, model: &Model) -> (Model, usize) {
        let mut out = model.clone();
        let flagged = || self.of.iter().zip(&self.asked).filter(|(_, asked)| asked.flagged).map(|(of, _)| of);
        for of in flagged() {
            if let PriorOf::Position { view } = *of
                && let ViewPlace::InPlane { known, .. } = &mut out.views[view].place
            {
                *known = PlanePosition::Unknown;
            }
        }
        let mut index = 0..;
        out.facts.retain(|_| {
            let at = index.next();
            !flagged().any(|of| matches!(of, PriorOf::Fact { index, .. } if Some(*index) == at))
        });
        (out, flagged().count())
    }
}

pub(super) fn priors(s: &Subject<'_>) -> Priors {
    let Some(checks) = prior_checks(s.adjustment) else { return Priors::default() };
    let own: Vec<(&PriorCheck, Known, bool)> = checks
        .iter()
        .filter_map(|check| match check.of {
            PriorOf::Fact { index, row } => Some((check, known(s, index, row), !s.assumed.contains(&index))),
            PriorOf::Position { view } => Some((check, position(s, view)?, true)),
            PriorOf::Disc { .. } | PriorOf::Oval { .. } => None,
        })
        .collect();
    let tested = own.iter().filter(|(c, ..)| c.z().is_some()).count().max(1) as f64;
    let each = own.iter().map(|(check, known, stated)| prior(known, check, *stated, tested));
    Priors {
        asked: each.chain(OF_DOTS.iter().filter_map(|of| dots(s, &checks, of))).collect(),
        of: own.iter().map(|(check, ..)| check.of).collect(),
    }
}

fn prior(k: &Known, check: &PriorCheck, stated: bool, tested: f64) -> Asked<Prior> {
    let (value, sigma) = (k.value * k.factor, k.sigma * k.factor);
    let z = check.z().unwrap_or(f64::NAN);
    let (away, own) = check.images_alone().unwrap_or((f64::NAN, f64::NAN));
    let conflict = normal_beyond(z) * tested < FALSE_ALARMS;
    let (images_alone, images_alone_sigma) = (value + away * sigma, own * sigma);
    let said = measured(value, sigma, k.unit);
    let [found, then] = if conflict {
        let source = if stated { "the rig file says" } else { "where it is expected without other knowledge:" };
        let advice = if stated {
            k.advice
        } else {
            "look for what drives it there (a lens term that is lacking, a target that is bent or not as stated), or state what is known under [camera.known]"
        };
        let found = format!(
            "{}: {source} {said}, but the images alone say {}, {} standard deviations apart",
            k.name,
            measured(images_alone, images_alone_sigma, k.unit),
            digits(z.abs(), 2)
        );
        [found, format!("; {advice}")]
    } else if check.share > ONLY_PRIOR {
        [format!("{} is known only from its prior {said}; the images add next to nothing", k.name), String::new()]
    } else if check.share > MOSTLY_PRIOR {
        [format!("{} is known mostly from its prior {said}; the images add less than it", k.name), String::new()]
    } else {
        [format!("{}: prior {said} and images agree; the images know more", k.name), String::new()]
    };
    let words = format!("{found}{then}");
    let row = Prior {
        name: k.name.clone(),
        stated,
        unit: k.unit.into(),
        prior: value,
        prior_sigma: sigma,
        estimate: value + check.residual * sigma,
        sigma_ratio: check.share.sqrt(),
        images_alone,
        images_alone_sigma,
        z,
        conflict,
        words,
    };
    Asked { row, found, flagged: conflict }
}

fn known(s: &Subject<'_>, index: usize, row: usize) -> Known {
    let model = &s.adjustment.model;
    let camera = |c: usize| &model.cameras[c].name;
    match &model.facts[index] {
        Fact::Intrinsic { camera: c, parameter, value, sigma } => {
            let (factor, unit) = intrinsic_unit(*parameter);
            Known {
                name: format!("{} of camera {}", intrinsic_words(*parameter), camera(*c)),
                value: *value,
                sigma: *sigma,
                factor,
                unit,
                advice: "correct the value in [camera.known] or [camera.design], give it the sigma it deserves, or remove it",
            }
        }
        Fact::WindowLayer { camera: c, layer, value, sigma } => Known {
            name: format!("{} of the window of camera {}", layer_words(*layer), camera(*c)),
            value: *value,
            sigma: *sigma,
            factor: 1.0,
            unit: if *layer < 2 { "mm" } else { "" },
            advice: "correct the value in [camera.window], or give it the sigma it deserves",
        },
        Fact::WindowParallel { camera: c, axis, sigma_rad } => Known {
            name: format!(
                "angle between the window of camera {} and the sheet along sheet {}",
                camera(*c),
                if *axis == 0 { "x" } else { "y" }
            ),
            value: 0.0,
            sigma: *sigma_rad,
            factor: 1f64.to_degrees(),
            unit: "deg",
            advice: "does the window stand parallel to the sheet? give tilt_sigma_deg in [camera.window] what it deserves",
        },
        Fact::Baseline { value_mm, sigma_mm } => Known {
            name: "distance of the cameras".into(),
            value: *value_mm,
            sigma: *sigma_mm,
            factor: 1.0,
            unit: "mm",
            advice: "correct baseline_mm, or give it a larger sigma",
        },
        Fact::Shape { parameter, view, value_mm, sigma_mm } => {
            let names = match model.target.shape {
                TargetShape::Pair { .. } => ["spacing", "radius of disc 0", "radius of disc 1"],
                TargetShape::Lattice(_) => ["spacing", "radius of the dots", "step between the levels"],
            };
            let place = view.map_or(String::new(), |v| format!(" in view {v}"));
            Known {
                name: format!("{}{place}", names[(*parameter).min(2)]),
                value: *value_mm,
                sigma: *sigma_mm,
                factor: 1.0,
                unit: "mm",
                advice: "correct the length in the rig file, or give it a larger sigma",
            }
        }
        Fact::Focus(focus) => {
            let advice =
                "is the lens stopped down, was it refocused, is focal_length_mm right? widen [focus] or remove it";
            let (what, sigma, factor, unit) = match (row, focus.distance) {
                (2, Some((_, sigma))) => ("distance of the sheet from the plane of focus", sigma, 100.0, "%"),
                (1, _) => (
                    "angle between sheet and plane of focus along sheet y",
                    focus.tilt_sigma_rad,
                    1f64.to_degrees(),
                    "deg",
                ),
                _ => (
                    "angle between sheet and plane of focus along sheet x",
                    focus.tilt_sigma_rad,
                    1f64.to_degrees(),
                    "deg",
                ),
            };
            Known { name: format!("{what}, camera {}", camera(focus.camera)), value: 0.0, sigma, factor, unit, advice }
        }
    }
}

/// Where a view stands on the traverse, as far as the rig file knows.
fn position(s: &Subject<'_>, view: usize) -> Option<Known> {
    let ViewPlace::InPlane { z_mm, known: PlanePosition::About { sigma_mm } } = s.adjustment.model.views[view].place
    else {
        return None;
    };
    Some(Known {
        name: format!("position of view {view} along the traverse"),
        value: z_mm,
        sigma: sigma_mm,
        factor: 1.0,
        unit: "mm",
        advice: "correct plane_z_mm of this view, or give it a larger sigma",
    })
}

/// What is asked of all dots together: the name, what they are off, the parts of an offset.
struct OfDots {
    name: &'static str,
    off: &'static str,
    parts: &'static [usize],
}

const OF_DOTS: [OfDots; 2] = [
    OfDots { name: "places of the printed dots", off: "their nominal places", parts: &[0, 1] },
    OfDots { name: "heights of the printed dots", off: "the plane of the plate", parts: &[2] },
];

/// All dots together: departures in prior sigmas are a chi-square with as many degrees of freedom as the images decide.
fn dots(s: &Subject<'_>, checks: &[PriorCheck], of: &OfDots) -> Option<Asked<Prior>> {
    let sigma = s.adjustment.model.target.offset_sigma_mm?[of.parts[0]];
    let is_own = |c: &&PriorCheck| matches!(c.of, PriorOf::Disc { part, .. } if of.parts.contains(&part));
    let own: Vec<&PriorCheck> = checks.iter().filter(is_own).collect();
    let chi2: f64 = own.iter().map(|c| c.residual * c.residual).sum();
    let degrees: f64 = own.iter().map(|c| 1.0 - c.share).sum();
    let rms = sigma * (chi2 / own.len().max(1) as f64).sqrt();
    let testable = degrees >= 1.0;
    // A plate better than it was said to be is no contradiction.
    let z = if testable { ((chi2 - degrees) / (2.0 * degrees).sqrt()).max(0.0) } else { f64::NAN };
    let conflict = z > 0.0 && chi_square_above(chi2, degrees) * (OF_DOTS.len() as f64) < FALSE_ALARMS;
    let name = of.name.to_string();
    let what = format!(
        "the dots lie {} um (rms) off {}; {} um were allowed",
        digits(1e3 * rms, 2),
        of.off,
        digits(1e3 * sigma, 2)
    );
    let found = format!("{name}: {what}");
    let then = if conflict {
        "; give point_sigma_mm in [target] the size they have, and check that the plate is the one described"
    } else {
        ""
    };
    let share = own.iter().map(|c| c.share).sum::<f64>() / own.len().max(1) as f64;
    let words = format!("{found}{then}");
    let row = Prior {
        name,
        stated: s.point_sigma_stated,
        unit: "mm".into(),
        prior: 0.0,
        prior_sigma: sigma,
        estimate: rms,
        sigma_ratio: share.sqrt(),
        images_alone: f64::NAN,
        images_alone_sigma: f64::NAN,
        z,
        conflict,
        words,
    };
    Some(Asked { row, found, flagged: conflict })
}
