//! From the words of a scene to cameras, sheet and targets in one frame.
//!
//! The *bench* is the nominal sheet: z = 0, x right, y up, z towards a camera at viewing angle 0. A camera aims at a
//! point of it from `distance_mm`, at `viewing_angle_deg` about y and `elevation_deg` towards +y.
//!
//! Tilt of a focused camera (Scheimpflug; F = f in mm, m the pupil ratio, (a, b, c) = n / d of the bench in the camera frame):
//! ```text
//! 1/F = 1/f_lens - c/m,   tan(beta) = a F,   tan(alpha) = b F cos(beta)
//! ```
//!
//! | symbol | identifier | unit | frame | source |
//! |---|---|---|---|---|
//! | R, t | `cam_from_bench` | 1, mm | Cam, Bench | scene |
//! | (a, b, c) | `abc_per_mm` | 1/mm | Cam | the paper, section 4; method section 6 |
//! | F | `image_distance_mm` | mm | Cam | Gauss; a thin lens has m = 1 |
//!
//! Not valid for a camera whose axis runs in the sheet (viewing angle 90 degrees): refused.

use super::check::{Lines, Step};
use super::pattern::{self, Pattern};
use super::random::{Stream, Use};
use super::scene::{AimKeys, CameraKeys, PoseKeys, RadialKey, RandomKeys, SceneFile, ViewKeys};
use crate::camera::{Camera, Intrinsics, Radial};
use crate::error::{Insufficient, Result};
use crate::frames::{Cam, Sheet, Target};
use crate::rigid::{Motion, rotation_exp};
use crate::target::TargetKind as Kind;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Frame of the nominal sheet, in which a scene is written down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bench;

/// A camera in its place.
#[derive(Debug, Clone)]
pub(super) struct PlacedCamera {
    pub(super) name: String,
    pub(super) camera: Camera,
    pub(super) size_px: [usize; 2],
    pub(super) cam_from_bench: Motion<Cam, Bench>,
    pub(super) pixel_pitch_mm: Option<f64>,
    pub(super) focal_length_mm: Option<f64>,
}

/// A target in its place.
#[derive(Debug, Clone)]
pub(super) struct PlacedView {
    pub(super) in_sheet: bool,
    pub(super) plane_z_mm: Option<f64>,
    pub(super) printed: bool,
    pub(super) bench_from_target: Motion<Bench, Target>,
    pub(super) pattern: Pattern,
    /// Bubbles: radii and spacing of this view.
    pub(super) pair_mm: Option<([f64; 2], f64)>,
}

/// Everything placed.
#[derive(Debug, Clone)]
pub(super) struct Setup {
    pub(super) cameras: Vec<PlacedCamera>,
    pub(super) bench_from_sheet: Motion<Bench, Sheet>,
    /// Where the light is while particles are recorded.
    pub(super) bench_from_light: Motion<Bench, Sheet>,
    pub(super) views: Vec<PlacedView>,
}

/// Discs of a pair stay this far inside the image, beyond three times the blur, px.
const MARGIN_PX: f64 = 6.0;
/// Whole dots that a grid must show in each image.
const FEWEST_DOTS: usize = 9;
/// A plane seen more obliquely than this shows nothing, degrees.
const MOST_OBLIQUE_DEG: f64 = 85.0;
/// Draws of a pose before the ranges are called impossible.
const MOST_DRAWS: usize = 20_000;

/// Rotation about x, then about its own y.
fn turn(tilt_deg: [f64; 2]) -> Matrix3<f64> {
    let [tx, ty] = tilt_deg.map(f64::to_radians);
    rotation_exp(&(Vector3::x() * tx)) * rotation_exp(&(Vector3::y() * ty))
}

fn along_z(offset_mm: f64) -> Vector3<f64> {
    Vector3::new(0.0, 0.0, offset_mm)
}

impl Setup {
    pub(super) fn new(scene: &SceneFile, lines: &Lines) -> Result<Self> {
        let mut cameras = Vec::new();
        for (i, keys) in scene.cameras.iter().enumerate() {
            cameras.push(place_camera(keys).or_else(|why| lines.refuse(&[Step::Key("camera"), Step::Item(i)], why))?);
        }
        let bench_from_sheet = Motion::<Bench, Sheet>::new(turn(scene.sheet.tilt_deg), along_z(scene.sheet.offset_mm));
        let (tilt_deg, offset_mm) = scene.particles.as_ref().map_or(([0.0; 2], 0.0), |p| (p.tilt_deg, p.offset_mm));
        let bench_from_light = bench_from_sheet * Motion::<Sheet, Sheet>::new(turn(tilt_deg), along_z(offset_mm));
        let mut setup = Setup { cameras, bench_from_sheet, bench_from_light, views: Vec::new() };
        let fixed = match scene.target.kind {
            Kind::Bubbles => None,
            _ => Some(fixed_pattern(scene)),
        };
        for (i, keys) in scene.views.iter().enumerate() {
            let view = setup.place_view(keys, fixed.as_ref());
            if let Err(why) = setup.visible(&view, scene) {
                return lines.refuse(&[Step::Key("view"), Step::Item(i)], format!("view {i}: {why}"));
            }
            setup.views.push(view);
        }
        if let Some(random) = &scene.random {
            for i in 0..random.count {
                let view = setup.draw_view(random, i, scene, fixed.as_ref())?;
                setup.views.push(view);
            }
        }
        Ok(setup)
    }

    fn place_view(&self, keys: &ViewKeys, fixed: Option<&Pattern>) -> PlacedView {
        let pair_mm = keys.radii_mm.zip(keys.spacing_mm);
        let pattern = match (fixed, pair_mm) {
            (Some(p), _) => p.clone(),
            (None, Some((radii, spacing))) => pattern::pair(radii, spacing),
            (None, None) => Pattern { features: Vec::new(), middle_mm: Vector3::zeros() },
        };
        let [rx, ry, rz] = keys.rotation_deg.map(f64::to_radians);
        let turn = rotation_exp(&(Vector3::x() * rx))
            * rotation_exp(&(Vector3::y() * ry))
            * rotation_exp(&(Vector3::z() * rz));
        let mut position = Vector3::from(keys.position_mm);
        let plane_z_mm = if keys.sheet { Some(0.0) } else { keys.plane_z_mm };
        position.z += plane_z_mm.unwrap_or(0.0);
        let placed = Motion::<Bench, Target>::new(turn, position - turn * pattern.middle_mm);
        let bench_from_target = match plane_z_mm {
            Some(_) => Motion::new(
                self.bench_from_sheet.rotation * placed.rotation,
                self.bench_from_sheet.apply(&placed.translation_mm),
            ),
            None => placed,
        };
        PlacedView {
            in_sheet: keys.sheet,
            plane_z_mm: keys.plane_z_mm,
            printed: keys.printed || fixed.is_some(),
            bench_from_target,
            pattern,
            pair_mm,
        }
    }

    /// A view drawn from the ranges, the first that every camera sees.
    fn draw_view(
        &self,
        r: &RandomKeys,
        index: usize,
        scene: &SceneFile,
        fixed: Option<&Pattern>,
    ) -> Result<PlacedView> {
        let mut stream = Stream::new(r.seed.unwrap_or(scene.seed), Use::Pose, &[index]);
        let in_sheet = index + r.sheet_count >= r.count;
        let mut why = String::new();
        for _ in 0..MOST_DRAWS {
            let mut keys = ViewKeys { sheet: in_sheet, ..ViewKeys::default() };
            let tilt = r.tilt_deg.map(|half| stream.within(half));
            let position = r.position_mm.map(|half| stream.within(half));
            let spin = stream.within(r.spin_deg);
            let free = if in_sheet { 0.0 } else { 1.0 };
            keys.rotation_deg = [free * tilt[0], free * tilt[1], spin];
            keys.position_mm = [position[0], position[1], free * position[2]];
            keys.radii_mm = r.radii_mm.map(|pair| pair.map(|range| stream.between(range[0], range[1])));
            keys.spacing_mm = r.spacing_mm.map(|range| stream.between(range[0], range[1]));
            let view = self.place_view(&keys, fixed);
            match self.visible(&view, scene) {
                Ok(()) => return Ok(view),
                Err(reason) => why = reason,
            }
        }
        Err(Insufficient::Degenerate(format!(
            "[random] view {index}: none of {MOST_DRAWS} draws from the ranges shows the target in every image (the last: {why}); \
             narrow position_mm and tilt_deg, or make the target smaller"
        ))
        .into())
    }

    /// `Err` with the reason where a camera does not see the view as a target needs it.
    fn visible(&self, view: &PlacedView, scene: &SceneFile) -> std::result::Result<(), String> {
        let margin = MARGIN_PX + 3.0 * scene.image.blur_sigma_px;
        for c in &self.cameras {
            let cam_from_target = c.cam_from_bench * view.bench_from_target;
            let normal = cam_from_target.rotation.column(2).into_owned();
            let toward = cam_from_target.apply(&view.pattern.middle_mm);
            if toward.z <= 0.0 {
                return Err(format!("the target lies {:.1} mm behind the camera \"{}\"", -toward.z, c.name));
            }
            let cosine = -normal.dot(&toward) / toward.norm();
            if cosine.abs() < MOST_OBLIQUE_DEG.to_radians().cos() {
                return Err(format!(
                    "camera \"{}\" sees the target edge-on (beyond {MOST_OBLIQUE_DEG} degrees)",
                    c.name
                ));
            }
            if view.printed && cosine < 0.0 {
                return Err(format!("camera \"{}\" sees the back of the printed target", c.name));
            }
            let mut whole = 0;
            for f in &view.pattern.features {
                match fully_inside(c, &cam_from_target, f, margin) {
                    Ok(()) => whole += 1,
                    Err(why) if scene.target.kind.is_pair() => {
                        return Err(format!("disc {} and camera \"{}\": {why}", f.id.column, c.name));
                    }
                    Err(_) => {}
                }
            }
            if !scene.target.kind.is_pair() && whole < FEWEST_DOTS {
                return Err(format!(
                    "camera \"{}\" sees {whole} whole dots, at least {FEWEST_DOTS} are needed",
                    c.name
                ));
            }
        }
        Ok(())
    }
}

fn fixed_pattern(scene: &SceneFile) -> Pattern {
    let t = &scene.target;
    let mut pattern = match (t.kind, t.radii_mm.zip(t.spacing_mm)) {
        (Kind::TwoDiscs, Some((radii, spacing))) => pattern::pair(radii, spacing),
        _ => pattern::grid(t),
    };
    if t.print_error_um > 0.0 {
        pattern::misprint(&mut pattern, t.print_error_um, scene.seed);
    }
    pattern
}

/// `Err` with the reason where part of a feature's outline is not in the image.
pub(super) fn fully_inside(
    c: &PlacedCamera,
    cam_from_target: &Motion<Cam, Target>,
    f: &pattern::Feature,
    margin_px: f64,
) -> std::result::Result<(), String> {
    let [width, height] = c.size_px.map(|n| n as f64);
    for p in f.outline.rim(48) {
        let q = c
            .camera
            .project_xyz(&cam_from_target.apply(&(f.center_mm + Vector3::new(p.x, p.y, 0.0))))
            .map_err(|refusal| refusal.to_string())?;
        let lowest = margin_px - 0.5;
        if q.x < lowest || q.y < lowest || q.x > width - 1.0 - lowest || q.y > height - 1.0 - lowest {
            return Err(format!(
                "its image reaches ({:.1}, {:.1}) px, outside or within {margin_px:.1} px of the border of {width} x {height} px",
                q.x, q.y
            ));
        }
    }
    Ok(())
}

fn place_camera(keys: &CameraKeys) -> std::result::Result<PlacedCamera, String> {
    let cam_from_bench = match (&keys.aim, &keys.pose) {
        (Some(aim), _) => aimed(aim),
        (None, Some(pose)) => posed(pose),
        (None, None) => Motion::identity(),
    };
    let normal = cam_from_bench.rotation.column(2).into_owned();
    let distance_mm = normal.dot(&cam_from_bench.translation_mm);
    if (normal.z).abs() < (MOST_OBLIQUE_DEG.to_radians()).cos() {
        return Err(format!(
            "the lens axis runs within 5 degrees along the sheet: expected a viewing angle below {MOST_OBLIQUE_DEG} degrees"
        ));
    }
    let abc_per_mm = normal / distance_mm;
    if abc_per_mm.z <= 0.0 || !abc_per_mm.iter().all(|v| v.is_finite()) {
        return Err("the sheet lies behind the camera".to_owned());
    }
    let intrinsics = intrinsics(keys, &abc_per_mm)?;
    let camera = Camera::new(intrinsics).map_err(|e| e.to_string())?;
    Ok(PlacedCamera {
        name: keys.name.clone(),
        camera,
        size_px: keys.image_size_px,
        cam_from_bench,
        pixel_pitch_mm: keys.pixel_pitch_mm,
        focal_length_mm: keys.focal_length_mm,
    })
}

/// Intrinsics of a camera that sees the bench as the plane `abc_per_mm . p = 1`.
fn intrinsics(keys: &CameraKeys, abc_per_mm: &Vector3<f64>) -> std::result::Result<Intrinsics, String> {
    let image_distance_mm = match (keys.f_px, keys.pixel_pitch_mm, keys.focal_length_mm) {
        (Some(f), Some(pitch), _) => Some(f * pitch),
        (None, _, Some(lens)) => Some(1.0 / (1.0 / lens - abc_per_mm.z / keys.pupil_ratio)),
        _ => None,
    };
    let f_px = match (keys.f_px, image_distance_mm, keys.pixel_pitch_mm) {
        (Some(f), _, _) => f,
        (None, Some(distance), Some(pitch)) if distance > 0.0 => distance / pitch,
        _ => return Err("f_px does not follow from the keys given: the lens forms no image of the sheet".to_owned()),
    };
    let (alpha_rad, beta_rad) = match (keys.scheimpflug, image_distance_mm) {
        (true, Some(distance)) => {
            let beta = (abc_per_mm.x * distance).atan();
            ((abc_per_mm.y * distance * beta.cos()).atan(), beta)
        }
        _ => (keys.alpha_deg.unwrap_or(0.0).to_radians(), keys.beta_deg.unwrap_or(0.0).to_radians()),
    };
    let centre = keys.image_size_px.map(|n| 0.5 * (n as f64 - 1.0));
    let [cx_px, cy_px] = keys.axis_point_px.unwrap_or(centre);
    let radial = match keys.radial {
        RadialKey::IdealToDistorted => Radial::IdealToDistorted,
        RadialKey::DistortedToIdeal => Radial::DistortedToIdeal,
    };
    Ok(Intrinsics {
        f_px,
        aspect: keys.aspect,
        cx_px,
        cy_px,
        alpha_rad,
        beta_rad,
        k: keys.k,
        pupil_ratio: keys.pupil_ratio,
        radial,
    })
}

/// A camera that looks at a point of the bench, its image upright.
fn aimed(aim: &AimKeys) -> Motion<Cam, Bench> {
    let (azimuth, elevation) = (aim.viewing_angle_deg.to_radians(), aim.elevation_deg.to_radians());
    let place = Vector3::new(azimuth.sin() * elevation.cos(), elevation.sin(), azimuth.cos() * elevation.cos());
    let forward = -place;
    let down = (forward * forward.y - Vector3::y()).normalize();
    let upright = Matrix3::from_rows(&[down.cross(&forward).transpose(), down.transpose(), forward.transpose()]);
    let rotation = rotation_exp(&(Vector3::z() * aim.roll_deg.to_radians())) * upright;
    let center_mm = Vector3::from(aim.look_at_mm) + place * aim.distance_mm;
    Motion::new(rotation, -(rotation * center_mm))
}

fn posed(pose: &PoseKeys) -> Motion<Cam, Bench> {
    let rotation = rotation_exp(&Vector3::from(pose.rotation_vector_deg.map(f64::to_radians)));
    Motion::new(rotation, Vector3::from(pose.translation_mm))
}

/// Images of points of a feature's outline, px; empty where part of it has no image.
pub(super) fn rim_px(
    c: &PlacedCamera,
    cam_from_target: &Motion<Cam, Target>,
    f: &pattern::Feature,
    count: usize,
) -> Vec<Vector2<f64>> {
    let image = |p: &Vector2<f64>| {
        c.camera.project_xyz(&cam_from_target.apply(&(f.center_mm + Vector3::new(p.x, p.y, 0.0)))).ok()
    };
    f.outline.rim(count).iter().map(image).collect::<Option<Vec<_>>>().unwrap_or_default()
}
