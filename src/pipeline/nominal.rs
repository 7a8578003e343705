//! Lengths of the target that are stated, against those that the images give it: two of them that contradict each other mean that one is wrong, and
//! the one that sets the scale may be it. A wrong scale alone shows in nothing.
//! ```text
//! told where |l - l_0| > limit l_0  and  |l - l_0| > SIGMAS s        l by the images, l_0 as stated, s its standard deviation, mm, frame of the target
//! ```

use super::calibrate::Solved;
use crate::target::Target;

/// A step or a radius of two discs that is off by more than this part was not made so; ink and blur change dots of a grid by more.
const OFF: f64 = 0.05;
const OFF_DOTS: f64 = 0.25;
/// And by so many standard deviations.
const SIGMAS: f64 = 5.0;

/// A stated length, what it is by the images, and how far that may be off, mm; the part from which on it is told.
struct Stated {
    name: &'static str,
    stated_mm: f64,
    found_mm: f64,
    sigma_mm: f64,
    limit: f64,
}

/// What is to be told of lengths that contradict the one that sets the scale.
pub(super) fn contradictions(s: &Solved) -> Vec<String> {
    let far = |l: &Stated| {
        let off = (l.found_mm - l.stated_mm).abs();
        off > l.limit * l.stated_mm && off > SIGMAS * l.sigma_mm
    };
    lengths(s).iter().filter(|l| far(l)).map(words).collect()
}

fn words(l: &Stated) -> String {
    format!(
        "the {} is {:.4} mm by the images, but {} mm as stated ({:+.1} %): two lengths that the rig file states contradict each other. The one that sets the scale may \
         be the wrong one, and with it all lengths of this calibration; measure spacing_mm, radii_mm and step_mm again",
        l.name,
        l.found_mm,
        l.stated_mm,
        100.0 * (l.found_mm / l.stated_mm - 1.0)
    )
}

fn lengths(s: &Solved) -> Vec<Stated> {
    let shape = s.adjustment.state.shape_mm;
    // What is not determined contradicts nothing.
    let sigma = |name: &str| s.covariance.sigma(name).unwrap_or(f64::NAN);
    let of = |name, stated_mm: Option<f64>, found_mm, key: &str, limit| {
        stated_mm.map(|stated_mm| Stated { name, stated_mm, found_mm, sigma_mm: sigma(key), limit })
    };
    let all = match &s.job.target.target {
        Target::TwoDiscs(p) => {
            let radius = |k: usize| p.radii_mm.map(|r| r[k]);
            vec![
                of("distance of the two discs", p.spacing_mm, shape[0], "target.spacing_mm", OFF),
                of("radius of the first disc", radius(0), shape[1], "target.radius0_mm", OFF),
                of("radius of the second disc", radius(1), shape[2], "target.radius1_mm", OFF),
            ]
        }
        // Of another size in each view.
        Target::Bubbles(_) => vec![],
        Target::DotGrid(g) => vec![
            of("pitch of the grid", g.spacing_mm, shape[0], "target.spacing_mm", OFF),
            of("radius of its dots", g.radius_mm, shape[1], "target.radius_mm", OFF_DOTS),
        ],
        Target::TwoLevelPlate(p) => vec![
            of("pitch of the plate", Some(p.spacing_mm), shape[0], "target.spacing_mm", OFF),
            of("step of the plate", Some(p.step_mm), shape[2], "target.step_mm", OFF),
            of("radius of its dots", p.radius_mm, shape[1], "target.radius_mm", OFF_DOTS),
        ],
    };
    all.into_iter().flatten().collect()
}
