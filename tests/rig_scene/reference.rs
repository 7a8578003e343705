//! The reference problems: what is measured again and again to compare the sampled with the predicted scatter.
//!
//! | name | views | metric fact |
//! |---|---|---|
//! | A | preset `paper-table2`: five of a printed pair of discs by hand, one in the sheet | spacing of the pair |
//! | B | 20 pairs of bubbles, freely posed, radii and spacing of their own; the last one is the sheet | spacing of the last |
//! | B5 | 20 pairs freely posed and five in one sheet | the same |
//! | C | 5 pairs of bubbles in one fixed sheet; focus relation of both cameras, 0.3 degrees and 0.5 % | spacing of the first |
//! | C0 | C without the focus relation | the same |
//! | D1, D3, D10 | C0 with 1, 3, 10 views of a printed plate of known shape | the plate |
//! | paper-table1, -3 | the presets | spacing of the pair |
//! | two-discs, bubbles | `Scene::build` | spacing; baseline |
//!
//! B is promised with a disparity although its views are posed freely and none need lie in the sheet: it is that of the two cameras, on the
//! sheet that the particle images of the measurement show ([`super::Bound::refitted_px`]). The one view in the sheet gives the plane where
//! something is to be said of it beforehand.
//!
//! All at the paper's geometry: 50 mm lens, 500 mm, +-45 degrees, 6.25 um; f, both tilts, axis point and k1 free; axis points known to
//! a tenth of the image's width, as the program assumes.

use super::{Noise, PartView, Parts, Scene, tilted_camera};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;
use spivcal::bundle::{Fact, Focus, PlanePosition, TargetModel, TargetShape, ViewPlace};
use spivcal::camera::{Camera, Intrinsics};
use spivcal::frames::{Cam, Rig};
use spivcal::rigid::Motion;
use spivcal::simulate;

/// A reference problem.
#[derive(Clone)]
pub(crate) struct Problem {
    pub(crate) name: String,
    pub(crate) parts: Parts,
    /// True where the cameras themselves are drawn from the focus relation.
    focused: bool,
}

/// One measurement: noisy contours, drawn facts, and what is true in it.
pub(crate) struct Draw {
    pub(crate) parts: Parts,
    pub(crate) scene: Scene,
}

const TILT_SIGMA_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
const DISTANCE_SIGMA: f64 = 0.005;
const LENS_MM: f64 = 50.0;
const PITCH_MM: f64 = 0.00625;
const AXIS_SIGMA_PX: f64 = 102.4;
/// How well the printed plate and the metric lengths are known, mm.
const LENGTH_SIGMA_MM: f64 = 0.001;

const BENCH: &str = r#"
[[camera]]
name = "left"
image_size_px = [1024, 768]
pixel_pitch_mm = 0.00625
focal_length_mm = 50.0
scheimpflug = true
k = [-0.15, 0.0, 0.0]
aim = { distance_mm = 500.0, viewing_angle_deg = -45.0 }

[[camera]]
name = "right"
image_size_px = [1024, 768]
pixel_pitch_mm = 0.00625
focal_length_mm = 50.0
scheimpflug = true
k = [-0.2, 0.0, 0.0]
aim = { distance_mm = 500.0, viewing_angle_deg = 45.0 }

[target]
kind = "bubbles"
polarity = "bright"
"#;

/// Poses of the printed plate, as one turns it by hand: tilt about x and y, spin, place.
const PRINTED: [[f64; 6]; 10] = [
    [18.0, -14.0, 10.0, 1.5, 0.5, 2.0],
    [-16.0, 17.0, -25.0, -2.0, -1.0, -3.0],
    [21.0, 12.0, 30.0, 1.0, 1.0, 4.0],
    [-12.0, -20.0, -8.0, -1.5, 0.5, -5.0],
    [15.0, 19.0, 18.0, 2.5, -0.5, 1.0],
    [-22.0, 8.0, -15.0, -1.0, 1.0, 3.0],
    [10.0, -22.0, 26.0, 2.0, -1.0, -2.0],
    [-18.0, -11.0, 5.0, -2.5, 0.0, 5.0],
    [23.0, -6.0, -20.0, 0.5, 0.5, -4.0],
    [-9.0, 21.0, 12.0, 0.0, -0.5, 2.0],
];

fn bubbles(count: usize, in_sheet: usize, printed: usize) -> String {
    let mut text = format!("seed = 5\n{BENCH}");
    for [a, b, spin, x, y, z] in &PRINTED[..printed] {
        text += &format!(
            "\n[[view]]\nprinted = true\nradii_mm = [12.5, 10.0]\nspacing_mm = 26.0\n\
             position_mm = [{x:?}, {y:?}, {z:?}]\nrotation_deg = [{a:?}, {b:?}, {spin:?}]\n"
        );
    }
    text + &format!(
        "\n[random]\ncount = {count}\nsheet_count = {in_sheet}\ntilt_deg = [25, 25]\nspin_deg = 60\n\
         position_mm = [14, 8, 8]\nradii_mm = [[6.0, 11.0], [6.0, 11.0]]\nspacing_mm = [23.0, 28.0]\n\n\
         [rig]\nscale = \"view-spacing\"\n"
    )
}

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_fn(|k, _| v[k].as_f64().unwrap())
}

fn motion<A, B>(v: &Value) -> Motion<A, B> {
    let row = |k: usize| vector(&v["rotation"][k]).transpose();
    Motion::new(Matrix3::from_rows(&[row(0), row(1), row(2)]), vector(&v["translation_mm"]))
}

/// The parts of a simulated scene, from its truth.
fn parts_of(scene: &simulate::Scene) -> Parts {
    let truth: Value = serde_json::from_str(&scene.truth_json().unwrap()).unwrap();
    let camera = |c: &Value| {
        let n = |key: &str| c[key].as_f64().unwrap();
        let mut i = Intrinsics::pinhole(n("f_px"), n("cx_px"), n("cy_px"));
        (i.alpha_rad, i.beta_rad, i.k[0]) = (n("alpha_rad"), n("beta_rad"), n("k1"));
        Camera::new(i).unwrap()
    };
    let shape = |t: &Value| {
        let number = |v: &Value| v.as_f64();
        let radius = |k: usize| number(&t["radii_mm"][k]);
        Some([number(&t["spacing_mm"])?, radius(0)?, radius(1)?])
    };
    let shared = shape(&truth["target"]);
    let view = |v: &Value| PartView {
        place: if v["in_sheet"].as_bool().unwrap() {
            ViewPlace::InPlane { z_mm: 0.0, known: PlanePosition::Exact }
        } else {
            ViewPlace::Free
        },
        rig_from_target: motion(&v["rig_from_target"]),
        shape_mm: shared.or_else(|| shape(&v["target"])).unwrap(),
    };
    let views: Vec<PartView> = truth["views"].as_array().unwrap().iter().map(view).collect();
    let per_view = shared.is_none();
    let mut free = [true; 10];
    (free[1], free[7], free[8], free[9]) = (false, false, false, false);
    let mut facts = vec![];
    for camera in 0..2 {
        for (parameter, value) in [(2, 511.5), (3, 383.5)] {
            facts.push(Fact::Intrinsic { camera, parameter, value, sigma: AXIS_SIGMA_PX });
        }
    }
    Parts {
        cameras: truth["cameras"].as_array().unwrap().iter().map(camera).collect(),
        cam_from_rig: motion(&truth["cameras"][1]["cam_from_rig"]),
        rig_from_sheet: Some(motion(&truth["sheet"]["rig_from_sheet"])),
        target: TargetModel {
            shape: TargetShape::Pair { per_view },
            free: [per_view, true, true],
            offset_sigma_mm: None,
            oval_sigma_mm: None,
        },
        shape_mm: views[0].shape_mm,
        views,
        offsets_mm: vec![],
        facts,
        free,
    }
}

impl Parts {
    /// A length of a view is known.
    pub(crate) fn knows(&mut self, view: usize, parameter: usize) {
        let value_mm = self.views[view].shape_mm[parameter];
        self.facts.push(Fact::Shape { parameter, view: Some(view), value_mm, sigma_mm: LENGTH_SIGMA_MM });
    }

    /// Both cameras are focused on the sheet.
    pub(crate) fn knows_focus(&mut self) {
        for camera in 0..2 {
            self.facts.push(Fact::Focus(Focus {
                camera,
                pixel_pitch_mm: PITCH_MM,
                tilt_sigma_rad: TILT_SIGMA_RAD,
                distance: Some((LENS_MM, DISTANCE_SIGMA)),
            }));
        }
    }
}

impl Problem {
    pub(crate) const NAMES: [&'static str; 12] =
        ["A", "B", "B5", "C", "C0", "D1", "D3", "D10", "paper-table1", "paper-table3", "two-discs", "bubbles"];

    /// A problem of other parts.
    pub(crate) fn made_of(name: &str, parts: Parts) -> Self {
        Self { name: name.into(), parts, focused: false }
    }

    /// The problem of this name.
    pub(crate) fn of(name: &str) -> Option<Self> {
        let of_text = |text: &str| parts_of(&simulate::Scene::parse(text, name).unwrap());
        let preset = |name: &str| parts_of(&simulate::Scene::preset(name).unwrap());
        let tilted = || vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
        let known = |mut parts: Parts, view: usize| {
            parts.knows(view, 0);
            parts
        };
        let with_plate = |count: usize| {
            let mut parts = of_text(&bubbles(5, 5, count));
            (0..count).for_each(|v| (0..3).for_each(|k| parts.knows(v, k)));
            parts
        };
        let parts = match name {
            "A" => preset("paper-table2"),
            "paper-table1" | "paper-table3" => preset(name),
            "B" => known(of_text(&bubbles(20, 1, 0)), 19),
            "B5" => known(of_text(&bubbles(25, 5, 0)), 24),
            "C" => {
                let mut parts = known(of_text(&bubbles(5, 5, 0)), 0);
                parts.knows_focus();
                parts
            }
            "C0" => known(of_text(&bubbles(5, 5, 0)), 0),
            "D1" => with_plate(1),
            "D3" => with_plate(3),
            "D10" => with_plate(10),
            "two-discs" => Parts::of(21, tilted(), None, false, false, &|v| (v >= 4).then_some(0.0)),
            "bubbles" => Parts::of(21, tilted(), None, true, false, &|v| (v >= 4).then_some(0.0)),
            _ => return None,
        };
        Some(Self { name: name.into(), parts, focused: name == "C" })
    }

    /// One measurement. Facts are drawn about the truth: a prior that always states the truth would make every error too small.
    /// The focus relation has no number that could be drawn; there the cameras are drawn about it.
    pub(crate) fn draw(&self, seed: u64) -> Draw {
        let mut parts = self.parts.clone();
        let mut noise = Noise::stream(seed, 1);
        if self.focused {
            for c in 0..2 {
                parts.cameras[c] = focused_camera(&parts, c, &mut noise);
            }
        }
        for fact in &mut parts.facts {
            match fact {
                Fact::Intrinsic { value, sigma, .. } => *value += *sigma * noise.normal(),
                Fact::Baseline { value_mm, sigma_mm } | Fact::Shape { value_mm, sigma_mm, .. } => {
                    *value_mm += *sigma_mm * noise.normal();
                }
                _ => {}
            }
        }
        Draw { scene: parts.scene().with_noise(seed), parts }
    }
}

/// Camera `c` as it may be if it is focused on the sheet within the tolerances: the plane of sharp focus is turned by two small
/// angles against the sheet and lies a little before or behind it.
fn focused_camera(parts: &Parts, c: usize, noise: &mut Noise) -> Camera {
    let cam_from_rig: Motion<Cam, Rig> = if c == 0 { Motion::identity() } else { parts.cam_from_rig };
    let sheet = cam_from_rig * parts.rig_from_sheet.unwrap();
    let axis = |k: usize| sheet.rotation.column(k).into_owned();
    let n: Vector3<f64> = axis(2) * axis(2).dot(&sheet.translation_mm).signum();
    let c_per_mm = n.z / n.dot(&sheet.translation_mm);
    let m = (n + (axis(0) * noise.normal() + axis(1) * noise.normal()) * TILT_SIGMA_RAD).normalize();
    let image_distance_mm = 1.0 / (1.0 / LENS_MM - c_per_mm * (1.0 + DISTANCE_SIGMA * noise.normal()));
    let mut i = *parts.cameras[c].intrinsics();
    i.f_px = image_distance_mm / PITCH_MM;
    i.beta_rad = (image_distance_mm * c_per_mm * m.x / m.z).atan();
    i.alpha_rad = (image_distance_mm * c_per_mm * m.y / m.z * i.beta_rad.cos()).atan();
    Camera::new(i).unwrap()
}
