//! Cameras, sheet and target poses in space, seen obliquely from behind the cameras (parallel projection).

use super::captions::Room;
use super::number::{count, nice_below, plain, with_unit};
use super::plots::COLOURS;
use super::svg::{label, line, open, path, path_data};
use crate::camera::{self, Intrinsics};
use crate::frames::Pixel;
use crate::record::{Camera, Record};
use nalgebra::Vector3;

type P = Vector3<f64>;

/// How steeply the picture looks down, rad.
const PITCH_RAD: f64 = 0.55;
/// How far the picture is turned from the mean direction of the cameras, rad.
const YAW_RAD: f64 = 0.4;

/// Direction of a pixel in the camera's frame, of unit length.
///
/// Where the distortion has no inverse (a corner that no ray reaches) the lens is taken as perfect: it is a picture.
fn ray(c: &Camera, u_px: f64, v_px: f64) -> P {
    let bent = c.intrinsics();
    let perfect = Intrinsics { k: [0.0; 3], ..bent };
    [bent, perfect]
        .into_iter()
        .filter_map(|i| camera::Camera::new(i).ok()?.unproject(Pixel::new(u_px, v_px)).ok())
        .next()
        .map_or(P::z(), |d| d.xyz.normalize())
}

/// One camera, ready to be drawn; everything in rig coordinates, mm.
struct Eye {
    centre: P,
    axis: P,
    corners: [P; 4],
}

fn eye(c: &Camera) -> Eye {
    let rig_from_cam = c.cam_from_rig.motion::<(), ()>().inverse();
    let turn = |d: P| rig_from_cam.rotation * d;
    let [w, h] = c.image_size_px.map(|n| n as f64 - 0.5);
    let corners = [(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)].map(|(u, v)| turn(ray(c, u, v)));
    Eye { centre: rig_from_cam.translation_mm, axis: turn(P::z()), corners }
}

/// A line, a filled face or a word in space.
enum Item {
    Chain { class: String, points: Vec<P>, closed: bool },
    Word { at: P, text: String, below_px: f64 },
}

/// What is drawn, in drawing order.
#[derive(Default)]
struct Scene {
    items: Vec<Item>,
}

impl Scene {
    fn chain(&mut self, class: impl Into<String>, points: impl Into<Vec<P>>, closed: bool) {
        self.items.push(Item::Chain { class: class.into(), points: points.into(), closed });
    }
    fn word(&mut self, at: P, below_px: f64, text: impl Into<String>) {
        self.items.push(Item::Word { at, text: text.into(), below_px });
    }
}

/// The parallel projection: screen right and screen down in rig coordinates.
struct Screen {
    right: P,
    down: P,
}

impl Screen {
    fn new(eyes: &[Eye]) -> Self {
        let mean: P = eyes.iter().map(|e| e.axis).sum();
        let yaw = mean.x.atan2(mean.z) + YAW_RAD;
        let (sy, cy, sp, cp) = (yaw.sin(), yaw.cos(), PITCH_RAD.sin(), PITCH_RAD.cos());
        let into = P::new(sy * cp, sp, cy * cp);
        let right = P::new(cy, 0.0, -sy);
        Self { right, down: into.cross(&right) }
    }
    fn at(&self, p: &P) -> [f64; 2] {
        [self.right.dot(p), self.down.dot(p)]
    }
}

/// The plane `normal . p = distance` in which the fields of view are compared.
struct Face {
    normal: P,
    distance_mm: f64,
}

impl Face {
    fn hit(&self, from: &P, along: &P) -> Option<P> {
        let speed = self.normal.dot(along);
        let t = (self.distance_mm - self.normal.dot(from)) / speed;
        (t.is_finite() && t > 0.0).then(|| from + along * t)
    }
}

/// Where the cameras look: the sheet, or without one the plane across the first camera's axis through the targets.
fn face(record: &Record) -> Option<Face> {
    if let Some(s) = &record.sheet {
        return Some(Face { normal: P::from(s.normal_in_rig), distance_mm: s.distance_mm });
    }
    let depths: Vec<f64> = record.views.iter().filter_map(|v| v.rig_from_target.map(|p| p.translation_mm[2])).collect();
    let mean = depths.iter().sum::<f64>() / depths.len() as f64;
    (mean > 0.0).then(|| Face { normal: P::z(), distance_mm: mean })
}

/// Corners of the sheet's rectangle that holds all fields of view, and those fields.
fn fields(eyes: &[Eye], face: &Face) -> (Vec<Vec<P>>, Vec<P>) {
    let fields: Vec<Vec<P>> = eyes
        .iter()
        .map(|e| e.corners.iter().filter_map(|d| face.hit(&e.centre, d)).collect::<Vec<_>>())
        .map(|f| if f.len() == 4 { f } else { Vec::new() })
        .collect();
    let z = face.normal;
    let x = (P::x() - z * z.x).try_normalize(1e-6).unwrap_or_else(P::y);
    let y = z.cross(&x);
    let points: Vec<&P> = fields.iter().flatten().collect();
    if points.is_empty() {
        return (fields, Vec::new());
    }
    let span = |axis: &P| {
        let (low, high) =
            points.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(axis.dot(p)), h.max(axis.dot(p))));
        let margin = 0.12 * (high - low);
        (low - margin, high + margin)
    };
    let ((x0, x1), (y0, y1)) = (span(&x), span(&y));
    let corner = |a: f64, b: f64| x * a + y * b + z * face.distance_mm;
    (fields, vec![corner(x0, y0), corner(x1, y0), corner(x1, y1), corner(x0, y1)])
}

/// Two pictures: the whole rig, and a close-up of the measured region with the target poses.
pub(super) fn pictures(record: &Record) -> [String; 2] {
    let eyes: Vec<Eye> = record.cameras.iter().map(eye).collect();
    let screen = Screen::new(&eyes);
    let face = face(record);
    let (fields, sheet) =
        face.as_ref().map_or_else(|| (vec![Vec::new(); eyes.len()], Vec::new()), |f| fields(&eyes, f));
    let mut near = Scene::default();
    add_sheet(&mut near, record, &fields, &sheet);
    let reach = face.as_ref().map_or(100.0, |f| f.distance_mm);
    add_targets(&mut near, record, reach, true);
    let mut whole = Scene::default();
    add_sheet(&mut whole, record, &fields, &sheet);
    add_targets(&mut whole, record, reach, false);
    add_cameras(&mut whole, record, &eyes, &fields, reach);
    [
        draw(&whole, &screen, [560.0, 430.0], "The cameras and the laser sheet"),
        draw(&near, &screen, [560.0, 430.0], "The measured region and the target poses"),
    ]
}

fn add_sheet(scene: &mut Scene, record: &Record, fields: &[Vec<P>], sheet: &[P]) {
    if sheet.is_empty() {
        return;
    }
    let class = if record.sheet.is_some() { "sheet" } else { "plane" };
    scene.chain(class, sheet, true);
    for (k, field) in fields.iter().enumerate().filter(|(_, f)| !f.is_empty()) {
        scene.chain(format!("footprint cam{}", k % COLOURS), field.clone(), true);
    }
}

fn add_targets(scene: &mut Scene, record: &Record, reach_mm: f64, with_names: bool) {
    let small = 0.03 * reach_mm;
    let [x0, y0, x1, y1] = record.target.extent_mm.unwrap_or([-small, -small, small, small]);
    for v in record.views.iter().filter(|v| v.used) {
        let Some(pose) = v.rig_from_target.map(|p| p.motion::<(), ()>()) else { continue };
        let at = |x: f64, y: f64, z: f64| pose.apply(&P::new(x, y, z));
        let class = if v.in_sheet { "target insheet" } else { "target" };
        scene.chain(class, [at(x0, y0, 0.0), at(x1, y0, 0.0), at(x1, y1, 0.0), at(x0, y1, 0.0)], true);
        if with_names {
            let (x, y, up) = (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.25 * (x1 - x0).hypot(y1 - y0));
            scene.chain(format!("{class} pin"), [at(x, y, 0.0), at(x, y, up)], false);
            // At a corner: the middles lie close together.
            scene.word(at(x1, y1, 0.0), 4.0, v.index.to_string());
        }
    }
}

fn add_cameras(scene: &mut Scene, record: &Record, eyes: &[Eye], fields: &[Vec<P>], reach_mm: f64) {
    for (k, (eye, camera)) in eyes.iter().zip(&record.cameras).enumerate() {
        let class = |what: &str| format!("{what} cam{}", k % COLOURS);
        for corner in &fields[k] {
            scene.chain(class("beam"), [eye.centre, *corner], false);
        }
        let size = 0.24 * reach_mm;
        let base: Vec<P> = eye.corners.iter().map(|d| eye.centre + d * size).collect();
        for corner in &base {
            scene.chain(class("frustum"), [eye.centre, *corner], false);
        }
        scene.chain(class("frustum face"), base, true);
        add_body(scene, &class("body"), eye, reach_mm);
        scene.word(eye.centre - eye.axis * (0.085 * reach_mm) - P::y() * (0.05 * reach_mm), -8.0, camera.name.clone());
    }
    for (eye, camera) in eyes.iter().zip(&record.cameras).skip(1) {
        scene.chain("baseline", [eyes[0].centre, eye.centre], false);
        let length = (eye.centre - eyes[0].centre).norm();
        let sigma = record.rig.as_ref().map_or(f64::NAN, |r| r.sigma.baseline_mm);
        let words = if record.cameras.len() == 2 && sigma.is_finite() {
            with_unit(length, sigma, "mm")
        } else {
            format!("{} {} mm", camera.name, plain(length, 4))
        };
        scene.word((eyes[0].centre + eye.centre) * 0.5, 20.0, words);
    }
    let tip = 0.12 * reach_mm;
    for (axis, name) in [(P::x(), "x"), (P::y(), "y"), (P::z(), "z")] {
        scene.chain("triad", [eyes[0].centre, eyes[0].centre + axis * tip], false);
        scene.word(eyes[0].centre + axis * (1.2 * tip), 4.0, name);
    }
}

/// A box behind the projection centre, so that one sees which way a camera with a narrow view looks.
fn add_body(scene: &mut Scene, class: &str, eye: &Eye, reach_mm: f64) {
    let across = (eye.corners[1] - eye.corners[0]).normalize() * (0.045 * reach_mm);
    let down = eye.axis.cross(&across) * 0.75;
    let face = |depth: f64| {
        let middle = eye.centre + eye.axis * (depth * reach_mm);
        [middle - across - down, middle + across - down, middle + across + down, middle - across + down]
    };
    let (front, back) = (face(-0.02), face(-0.15));
    for i in 0..4 {
        let j = (i + 1) % 4;
        scene.chain(class, [front[i], front[j], back[j], back[i]], true);
    }
}

/// Width of a letter and height of a line of words, about, px.
const LETTER_PX: [f64; 2] = [7.0, 13.0];

fn draw(scene: &Scene, screen: &Screen, size: [f64; 2], title: &str) -> String {
    let points: Vec<[f64; 2]> = scene
        .items
        .iter()
        .flat_map(|i| match i {
            Item::Chain { points, .. } => points.iter().map(|p| screen.at(p)).collect::<Vec<_>>(),
            Item::Word { at, .. } => vec![screen.at(at)],
        })
        .filter(|p| p[0].is_finite() && p[1].is_finite())
        .collect();
    let mut out = open(size[0], size[1], title);
    let limit = |i: usize| points.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p[i]), h.max(p[i])));
    let ((x0, x1), (y0, y1)) = (limit(0), limit(1));
    if points.is_empty() || x1 - x0 <= 0.0 {
        out.push_str("</svg>");
        return out;
    }
    let margin = 40.0;
    let scale = ((size[0] - 2.0 * margin) / (x1 - x0)).min((size[1] - 2.0 * margin) / (y1 - y0).max(1e-9));
    let shift = [0.5 * (size[0] - scale * (x0 + x1)), 0.5 * (size[1] - 14.0 - scale * (y0 + y1))];
    let place = |p: &P| {
        let at = screen.at(p);
        [scale * at[0] + shift[0], scale * at[1] + shift[1]]
    };
    let (mut room, mut unwritten) = (Room::new(size[0] as usize, size[1] as usize), 0);
    for item in &scene.items {
        match item {
            Item::Chain { class, points, closed } => {
                path(&mut out, class, &path_data(points.iter().map(place), *closed));
            }
            Item::Word { at, text, below_px } => {
                let [x, y] = place(at);
                let [wide, high] = [LETTER_PX[0] * text.chars().count() as f64, LETTER_PX[1]];
                // Letters stand on the line that is told, and reach a quarter below it.
                let middle = [x, y + below_px - 0.25 * high];
                match room.place(middle, high, [wide, high]) {
                    Some([left, top]) => {
                        label(&mut out, "word", [left + 0.5 * wide, top + 0.75 * high], "middle", text);
                    }
                    None => unwritten += 1,
                }
            }
        }
    }
    let bar_mm = nice_below(0.25 * size[0] / scale);
    let y = size[1] - 10.0;
    line(&mut out, "axis", [10.0, y], [10.0 + bar_mm * scale, y]);
    label(&mut out, "tick", [16.0 + bar_mm * scale, y + 4.0], "start", &format!("{} mm", plain(bar_mm, 3)));
    if unwritten > 0 {
        let text = format!("no room for {}", count(unwritten, "name"));
        label(&mut out, "tick", [size[0] - 10.0, y + 4.0], "end", &text);
    }
    out.push_str("</svg>");
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{CameraSigma, Effective, Pose, Radial};

    fn camera() -> Camera {
        Camera {
            name: "left".into(),
            image_size_px: [1024, 768],
            f_px: 8889.0,
            aspect: 1.0,
            cx_px: 513.8,
            cy_px: 381.4,
            alpha_rad: 0.05,
            beta_rad: -0.11,
            k1: 0.0,
            k2: 0.0,
            k3: 0.0,
            radial: Radial::IdealToDistorted,
            pupil_ratio: 1.0,
            pixel_pitch_mm: None,
            window: None,
            effective: Effective::default(),
            sigma: CameraSigma::default(),
            cam_from_rig: Pose {
                rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                translation_mm: [0.0; 3],
            },
            rms_px: 0.02,
            edge_rms_px: None,
            observations: 0,
        }
    }

    #[test]
    fn a_corner_that_no_ray_reaches_is_drawn_all_the_same() {
        let mut c = camera();
        assert!((ray(&c, c.cx_px, c.cy_px) - P::z()).norm() < 1e-15, "the axis point looks along z");
        let plain = ray(&c, 0.0, 0.0);
        c.k1 = -0.08;
        assert!((ray(&c, 0.0, 0.0) - plain).norm() > 1e-7, "distortion counts");
        c.k1 = -1e4;
        assert_eq!(ray(&c, 0.0, 0.0), plain);
        c.f_px = f64::NAN;
        assert_eq!(ray(&c, 0.0, 0.0), P::z());
    }

    /// Poses all but on top of each other: their numbers stand beside each other or not at all.
    #[test]
    fn words_cover_no_others() {
        let mut scene = Scene::default();
        scene.chain("sheet", [P::new(-50.0, -50.0, 0.0), P::new(50.0, 50.0, 0.0)], false);
        (0..9).for_each(|k| scene.word(P::new(0.01 * f64::from(k), 0.0, 0.0), 4.0, format!("{}", 10 + k)));
        let svg = draw(&scene, &Screen::new(&[eye(&camera())]), [560.0, 430.0], "poses");
        let number = |text: &str, name: &str| -> f64 {
            text.split(&format!("{name}=\"")).nth(1).and_then(|t| t.split('"').next()).unwrap().parse().unwrap()
        };
        let words: Vec<[f64; 2]> =
            svg.split("<text class=\"word\"").skip(1).map(|t| [number(t, " x"), number(t, " y")]).collect();
        assert!((3..9).contains(&words.len()), "{words:?}");
        assert!(svg.contains(&format!("no room for {} name", 9 - words.len())), "{svg}");
        for (i, a) in words.iter().enumerate() {
            let apart = |b: &[f64; 2]| (a[0] - b[0]).abs() >= 14.0 || (a[1] - b[1]).abs() >= 13.0;
            assert!(words[..i].iter().all(apart), "{words:?}");
        }
    }

    #[test]
    fn the_screen_is_right_handed_and_looks_down() {
        let eye = eye(&camera());
        let s = Screen::new(&[eye]);
        assert!((s.right.norm() - 1.0).abs() < 1e-12 && (s.down.norm() - 1.0).abs() < 1e-12);
        assert!(s.right.dot(&s.down).abs() < 1e-12);
        assert!(s.down.y > 0.0, "rig y, down, goes down on the screen");
        assert!(s.down.z < 0.0, "what is farther away is higher up");
    }
}
