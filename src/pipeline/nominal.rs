//! Lengths of target and lens that are stated, against those that the images give: two of them that contradict each other mean that one is wrong, and
//! the one that sets the scale may be it. A wrong scale alone shows in nothing.
//! ```text
//! told where |l - l_0| > limit l_0  and  |l - l_0| > SIGMAS s        l by the images, l_0 as stated, s its standard deviation, mm, frame of the target
//! 1 / f = 1 / s + 1 / s'        thin lens: sheet s mm away along the axis, image distance s'; told where f is off the stated one by OTHER_LENS times
//! ```

use super::calibrate::Solved;
use crate::target::Target;

/// A step or a radius of two discs that is off by more than this part was not made so; ink and blur change dots of a grid by more.
const OFF: f64 = 0.05;
const OFF_DOTS: f64 = 0.25;
/// And by so many standard deviations.
const SIGMAS: f64 = 5.0;

/// A lens that focuses inside, or whose pupils differ, may act as one so many times shorter or longer than is engraved on it, near as it looks.
const OTHER_LENS: f64 = 2.0;
/// An image distance that is known to this part is compared.
const KNOWN_DISTANCE: f64 = 0.1;
/// A lens may be so much shorter than engraved on it.
const SHORTEST: f64 = 0.95;

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
    let cameras = 0..s.job.cameras.len();
    let lenses = cameras.filter_map(|c| impossible_lens(s, c).or_else(|| contradicting_lens(s, c)));
    lenses.chain(lengths(s).iter().filter(|l| far(l)).map(words)).collect()
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

/// Focal length as stated, image distance found, and its standard deviation, where pixels have a size in mm.
fn distances_mm(s: &Solved, c: usize) -> Option<[f64; 3]> {
    let d = &s.job.cameras[c];
    let (lens_mm, pitch_mm) = d.focal_length_mm.zip(d.pixel_pitch_mm)?;
    let sigma_px = s.covariance.sigma(&format!("{}.f_px", d.name)).unwrap_or(f64::NAN);
    Some([lens_mm, s.covariance.natural.cameras[c].intrinsics().f_px * pitch_mm, sigma_px * pitch_mm])
}

/// Says so where the image distance found is shorter than the focal length of the lens, at which no lens of that focal length forms an image.
fn impossible_lens(s: &Solved, c: usize) -> Option<String> {
    let d = &s.job.cameras[c];
    let [lens_mm, distance_mm, sigma_mm] = distances_mm(s, c)?;
    (distance_mm + 3.0 * sigma_mm < SHORTEST * lens_mm).then(|| {
        format!(
            "camera {}: an image distance of {distance_mm:.2} +- {sigma_mm:.2} mm is shorter than the focal length of its lens, {lens_mm} mm: focal_length_mm \
             or pixel_pitch_mm is wrong, the images were binned or made smaller, or the lens focuses inside and is shorter when it looks near (then state no \
             focal_length_mm)",
            d.name
        )
    })
}

/// Says so where no lens of about the stated focal length images a sheet so near or far at the image distance found: lengths were stated in another unit.
fn contradicting_lens(s: &Solved, c: usize) -> Option<String> {
    let d = &s.job.cameras[c];
    let [lens_mm, image_mm, sigma_mm] = distances_mm(s, c)?;
    let in_camera = s.covariance.natural.cam_from_rig[c] * s.covariance.natural.rig_from_plane?;
    let normal = in_camera.rotation.column(2);
    let far_mm = (normal.dot(&in_camera.translation_mm) / normal.z).abs();
    let asked_mm = far_mm * image_mm / (far_mm + image_mm);
    let off = asked_mm > OTHER_LENS * lens_mm || lens_mm > OTHER_LENS * asked_mm;
    (off && sigma_mm < KNOWN_DISTANCE * image_mm).then(|| {
        format!(
            "camera {}: an image distance of {image_mm:.1} mm and a sheet {far_mm:.4} mm away ask for a lens of about {asked_mm:.4} mm, but focal_length_mm is \
             {lens_mm}: the length that sets the scale is in another unit than mm, or focal_length_mm or pixel_pitch_mm is wrong",
            d.name
        )
    })
}
