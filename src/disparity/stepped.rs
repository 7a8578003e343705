//! A calibration after steps of the numbers that its covariance names: cameras, windows, poses, target.
//!
//! A lens axis is hardly known where a lens has little distortion: tilt, axis point and the turn of the lens frame move together by many
//! pixels and leave all images as they are. Steps along that valley are long, and a straight one in these numbers would leave it. So a step
//! is taken to the chart in which the valley is straight, the untilted pinhole with its frame E (see [`crate::bundle`]), and taken there:
//! ```text
//! (f_e, cx_e, cy_e)' = (f_e, cx_e, cy_e) + d(f_e, cx_e, cy_e)/d(f, cx, cy, alpha, beta, aspect) step
//! pose in the pinhole's frame = E^T pose,   its step = E^T (step - w),   w = d(alpha) u - d(beta) y the turn of E with the tilt
//! ```
//! To first order nothing is changed by that. Cameras of which f or a tilt is held have no such valley, and are stepped as they are.

use crate::camera::{Camera, EffectivePinhole, INTRINSIC_NAMES, Intrinsics, WINDOW_STEP_NAMES};
use crate::dewarp::SheetMap;
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::record::{self, CameraSigma, Covariance, Effective, Pose, PoseSigma, Record, RigSigma, WindowSigma};
use crate::rigid::{AxesAngle, Motion, STEP_NAMES, rotation_exp, rotation_log};
use nalgebra::{Matrix3, SVector, Vector3};
use std::collections::BTreeMap;

/// The numbers of a camera that must be free for its axis to have a valley.
const VALLEY: [&str; 3] = ["f_px", "alpha_rad", "beta_rad"];

/// Steps by name, as [`Covariance::names`] has them; what is not named stays.
pub(super) struct Steps<'a>(BTreeMap<&'a str, f64>);

impl<'a> Steps<'a> {
    pub(super) fn new(names: &'a [String], steps: impl Iterator<Item = f64>) -> Self {
        Self(names.iter().map(String::as_str).zip(steps).collect())
    }

    fn get(&self, owner: &str, quantity: &str) -> Option<f64> {
        self.0.get(format!("{owner}.{quantity}").as_str()).copied()
    }

    fn of(&self, owner: &str, quantity: &str) -> f64 {
        self.get(owner, quantity).unwrap_or(0.0)
    }

    /// Turn and shift of a left step.
    fn motion(&self, owner: &str) -> [Vector3<f64>; 2] {
        [0, 3].map(|from| Vector3::from_fn(|k, _| self.of(owner, STEP_NAMES[from + k])))
    }
}

/// A camera before and after, with the frames of its pinhole.
struct Stepped {
    camera: Camera,
    /// E before and after.
    cam_from_pinhole: [Matrix3<f64>; 2],
    /// w: turn of E, to first order.
    turn: Vector3<f64>,
}

/// `None` where there is no such camera.
fn stepped(camera: &record::Camera, steps: &Steps<'_>) -> Option<Stepped> {
    let model = camera.model().ok()?;
    let (i, name) = (model.intrinsics(), camera.name.as_str());
    let d = INTRINSIC_NAMES.map(|n| steps.of(name, n));
    let has_valley = VALLEY.iter().all(|q| steps.get(name, q).is_some());
    let (next, frames, turn) = if has_valley {
        let [_, dm, dcx, dcy, da, db, k @ .., pupil] = d;
        let (e, by) = (model.effective_pinhole(), model.effective_pinhole_by_intrinsics() * SVector::from(d));
        let moved = EffectivePinhole { f_px: e.f_px + by[0], cx_px: e.cx_px + by[1], cy_px: e.cy_px + by[2] };
        let mut next = moved.with_axis_point(i.cx_px + dcx, i.cy_px + dcy, i.aspect + dm);
        (0..3).for_each(|j| next.k[j] = i.k[j] + k[j]);
        (next.pupil_ratio, next.radial) = (i.pupil_ratio + pupil, i.radial);
        let after = Camera::new(next).ok()?.cam_from_pinhole();
        (next, [model.cam_from_pinhole(), after], model.pinhole_turn(da, db))
    } else {
        let mut p = i.to_array();
        p.iter_mut().zip(d).for_each(|(p, d)| *p += d);
        (Intrinsics::from_array(&p, i.radial), [Matrix3::identity(); 2], Vector3::zeros())
    };
    let owner = format!("{name}.window");
    let [rx, ry, rz, layers @ ..] = WINDOW_STEP_NAMES.map(|n| steps.of(&owner, n));
    let [before, after] = frames;
    let window = match model.window() {
        Some(w) => {
            let turned = rotation_exp(&(before.transpose() * (Vector3::new(rx, ry, rz) - turn)));
            Some(w.stepped(&rotation_log(&(after * turned * before.transpose())), &layers).ok()?)
        }
        None => None,
    };
    Some(Stepped { camera: Camera::new(next).ok()?.with_window(window), cam_from_pinhole: frames, turn })
}

fn step6(turn: Vector3<f64>, shift: Vector3<f64>) -> SVector<f64, 6> {
    SVector::<f64, 6>::from_fn(|k, _| if k < 3 { turn[k] } else { shift[k - 3] })
}

fn turned<A, B>(by: &Matrix3<f64>) -> Motion<A, B> {
    Motion::new(*by, Vector3::zeros())
}

/// A pose in the rig, whose frame is that of the first camera.
fn in_rig<B>(pose: &Motion<Rig, B>, [turn, shift]: [Vector3<f64>; 2], first: &Stepped) -> Motion<Rig, B> {
    let [before, after] = &first.cam_from_pinhole;
    let back = before.transpose();
    let in_pinhole: Motion<Rig, B> = turned::<Rig, Rig>(&back) * *pose;
    turned::<Rig, Rig>(after) * in_pinhole.retract(&step6(back * (turn - first.turn), back * shift))
}

/// The pose of a camera that is not the first.
fn beside(
    pose: &Motion<Cam, Rig>,
    [turn, shift]: [Vector3<f64>; 2],
    own: &Stepped,
    first: &Stepped,
) -> Motion<Cam, Rig> {
    let ([e, e_after], [e1, e1_after]) = (&own.cam_from_pinhole, &first.cam_from_pinhole);
    let (back, carried) = (e.transpose(), pose.rotation * first.turn);
    let between: Motion<Cam, Rig> = turned::<Cam, Cam>(&back) * *pose * turned::<Rig, Rig>(e1);
    let step = step6(back * (turn - own.turn + carried), back * (shift - carried.cross(&pose.translation_mm)));
    turned::<Cam, Cam>(e_after) * between.retract(&step) * turned::<Rig, Rig>(&e1_after.transpose())
}

/// All cameras and their poses.
fn cameras_after(start: &Record, steps: &Steps<'_>) -> Option<Vec<(Stepped, Motion<Cam, Rig>)>> {
    let all: Option<Vec<Stepped>> = start.cameras.iter().map(|c| stepped(c, steps)).collect();
    let all = all?;
    let poses: Vec<Motion<Cam, Rig>> = start
        .cameras
        .iter()
        .zip(&all)
        .enumerate()
        .map(|(k, (c, s))| {
            let pose = c.cam_from_rig.motion::<Cam, Rig>();
            if k == 0 { pose } else { beside(&pose, steps.motion(&format!("{}.cam_from_rig", c.name)), s, &all[0]) }
        })
        .collect();
    Some(all.into_iter().zip(poses).collect())
}

/// Maps of both cameras after the steps on a sheet in the rig.
pub(super) fn maps_after(
    start: &Record,
    steps: &Steps<'_>,
    rig_from_sheet: &Motion<Rig, Sheet>,
) -> Option<[SheetMap; 2]> {
    let all = cameras_after(start, steps)?;
    let one = |c: usize| -> Option<SheetMap> {
        let (s, pose) = all.get(c)?;
        Some(SheetMap::new(s.camera, *pose * *rig_from_sheet, start.cameras[c].image_size_px))
    };
    Some([one(0)?, one(1)?])
}

/// The sheet that was started from, held against the pinhole of the first camera.
pub(super) fn sheet_after(start: &Record, steps: &Steps<'_>) -> Option<Motion<Rig, Sheet>> {
    let pose = start.sheet.as_ref()?.rig_from_sheet.motion::<Rig, Sheet>();
    let first = stepped(start.cameras.first()?, steps)?;
    Some(in_rig(&pose, [first.turn, Vector3::zeros()], &first))
}

/// The numbers of these names that differ between two records of one calibration; poses as left steps, windows as the smallest turn. None
/// for names of other things.
pub(super) fn numbers_between(from: &Record, to: &Record, names: &[String]) -> Vec<Option<f64>> {
    let mut all: BTreeMap<String, f64> = BTreeMap::new();
    let mut pose = |owner: String, a: &Pose, b: &Pose| {
        let step = a.motion::<Rig, Rig>().step_to(&b.motion());
        STEP_NAMES.iter().zip(step.iter()).for_each(|(s, d)| {
            all.insert(format!("{owner}.{s}"), *d);
        });
    };
    for (a, b) in from.cameras.iter().zip(&to.cameras) {
        pose(format!("{}.cam_from_rig", a.name), &a.cam_from_rig, &b.cam_from_rig);
    }
    for (a, b) in from.views.iter().zip(&to.views) {
        if let (Some(x), Some(y)) = (&a.rig_from_target, &b.rig_from_target) {
            pose(format!("view{}.rig_from_target", a.index), x, y);
        }
    }
    for (a, b) in from.cameras.iter().zip(&to.cameras) {
        let (x, y) = (a.intrinsics().to_array(), b.intrinsics().to_array());
        for (k, n) in INTRINSIC_NAMES.iter().enumerate() {
            all.insert(format!("{}.{n}", a.name), y[k] - x[k]);
        }
        if let (Some(v), Some(w)) = (&a.window, &b.window) {
            let normal = Vector3::from(v.normal_in_cam);
            let mut turn = normal.cross(&Vector3::from(w.normal_in_cam));
            // About its own normal a window turns with the frame of the pinhole, as its name in the covariance does.
            let named = |q: &str| names.iter().any(|n| *n == format!("{}.{q}", a.name));
            if let (true, Ok(x), Ok(y)) = (VALLEY.iter().all(|q| named(q)), a.model(), b.model()) {
                let frame = rotation_log(&(y.cam_from_pinhole() * x.cam_from_pinhole().transpose()));
                turn += normal * normal.dot(&frame);
            }
            let layers = |w: &record::Window| [w.distance_mm, w.thickness_mm, w.n_air, w.n_glass, w.n_water];
            let (v, w) = (layers(v), layers(w));
            let steps = turn.iter().copied().chain((0..5).map(|k| w[k] - v[k]));
            WINDOW_STEP_NAMES.iter().zip(steps).for_each(|(n, d)| {
                all.insert(format!("{}.window.{n}", a.name), d);
            });
        }
    }
    names.iter().map(|n| all.get(n).copied()).collect()
}

/// The record with all that the steps name moved, but its sheet; its standard deviations and its covariance stay as they were.
pub(super) fn record_after(start: &Record, steps: &Steps<'_>) -> Option<Record> {
    let all = cameras_after(start, steps)?;
    let first = &all.first()?.0;
    let mut out = start.clone();
    for (camera, (s, pose)) in out.cameras.iter_mut().zip(&all) {
        let (i, e) = (s.camera.intrinsics(), s.camera.effective_pinhole());
        (camera.f_px, camera.aspect, camera.cx_px, camera.cy_px) = (i.f_px, i.aspect, i.cx_px, i.cy_px);
        (camera.alpha_rad, camera.beta_rad, camera.pupil_ratio) = (i.alpha_rad, i.beta_rad, i.pupil_ratio);
        [camera.k1, camera.k2, camera.k3] = i.k;
        camera.effective = Effective { f_px: e.f_px, cx_px: e.cx_px, cy_px: e.cy_px };
        camera.cam_from_rig = Pose::from(pose);
        if let (Some(to), Some(from)) = (&mut camera.window, s.camera.window()) {
            to.normal_in_cam = (*from.normal()).into();
            [to.distance_mm, to.thickness_mm, to.n_air, to.n_glass, to.n_water] = from.layers();
        }
    }
    let second = out.cameras.get(1).map(|c| c.cam_from_rig.motion::<Cam, Rig>());
    if let (Some(rig), Some(m)) = (&mut out.rig, second) {
        rig.baseline_mm = m.translation_mm.norm();
        rig.axes_angle_deg = AxesAngle::of(&m.rotation).rad.to_degrees();
    }
    for view in &mut out.views {
        let owner = format!("view{}", view.index);
        let step = steps.motion(&format!("{owner}.rig_from_target"));
        view.rig_from_target =
            view.rig_from_target.map(|p| Pose::from(&in_rig(&p.motion::<Rig, Target>(), step, first)));
        if let Some(z) = &mut view.plane_z_mm {
            *z += steps.of(&owner, "plane_z_mm");
        }
        if let Some(t) = &mut view.target {
            t.spacing_mm += steps.of(&owner, "spacing_mm");
            t.radii_mm.iter_mut().enumerate().for_each(|(k, r)| *r += steps.of(&owner, &format!("radius{k}_mm")));
        }
    }
    let t = &mut out.target;
    t.spacing_mm += steps.of("target", "spacing_mm");
    t.step_mm = t.step_mm.map(|s| s + steps.of("target", "step_mm"));
    let one = t.radii_mm.len() == 1;
    for (k, r) in t.radii_mm.iter_mut().enumerate() {
        *r += steps.of("target", &if one { "radius_mm".into() } else { format!("radius{k}_mm") });
    }
    Some(out)
}

/// Writes the standard deviations of cameras, windows, poses and target that a covariance states into a record.
pub(super) fn take_sigmas(record: &mut Record, covariance: &Covariance) {
    let named = |owner: &str, quantity: &str| covariance.sigma(&format!("{owner}.{quantity}"));
    let take = |to: &mut f64, owner: &str, quantity: &str| {
        if let Some(s) = named(owner, quantity) {
            *to = s;
        }
    };
    let pose = |to: &mut PoseSigma, owner: &str| {
        for k in 0..3 {
            take(&mut to.rotation_rad[k], owner, STEP_NAMES[k]);
            take(&mut to.translation_mm[k], owner, STEP_NAMES[3 + k]);
        }
    };
    for camera in &mut record.cameras {
        let name = camera.name.clone();
        let effective = effective_sigma(camera, covariance);
        let CameraSigma { f_px, aspect, cx_px, cy_px, alpha_rad, beta_rad, k1, k2, k3, pupil_ratio, .. } =
            &mut camera.sigma;
        let all = [f_px, aspect, cx_px, cy_px, alpha_rad, beta_rad, k1, k2, k3, pupil_ratio];
        all.into_iter().zip(INTRINSIC_NAMES).for_each(|(to, q)| take(to, &name, q));
        camera.sigma.effective = effective;
        pose(&mut camera.sigma.cam_from_rig, &format!("{name}.cam_from_rig"));
        if let Some(w) = &mut camera.window {
            let owner = format!("{name}.window");
            let WindowSigma { normal_rad: [rx, ry, rz], distance_mm, thickness_mm, n_air, n_glass, n_water } =
                &mut w.sigma;
            let all = [rx, ry, rz, distance_mm, thickness_mm, n_air, n_glass, n_water];
            all.into_iter().zip(WINDOW_STEP_NAMES).for_each(|(to, q)| take(to, &owner, q));
        }
    }
    if let Some(second) = record.cameras.get(1) {
        let (m, owner) = (second.cam_from_rig.motion::<Cam, Rig>(), format!("{}.cam_from_rig", second.name));
        if let Some(rig) = &mut record.rig {
            rig.sigma = rig_sigma(&m, &owner, covariance);
        }
    }
    for view in &mut record.views {
        let owner = format!("view{}", view.index);
        pose(&mut view.sigma, &format!("{owner}.rig_from_target"));
        if let (Some(s), Some(z)) = (&mut view.plane_z_sigma_mm, named(&owner, "plane_z_mm")) {
            *s = z;
        }
        if let Some(t) = &mut view.target {
            take(&mut t.sigma.spacing_mm, &owner, "spacing_mm");
            t.sigma.radii_mm.iter_mut().enumerate().for_each(|(k, r)| take(r, &owner, &format!("radius{k}_mm")));
        }
    }
    let sigma = &mut record.target.sigma;
    take(&mut sigma.spacing_mm, "target", "spacing_mm");
    if let (Some(s), Some(step)) = (&mut sigma.step_mm, named("target", "step_mm")) {
        *s = step;
    }
    let one = sigma.radii_mm.len() == 1;
    for (k, r) in sigma.radii_mm.iter_mut().enumerate() {
        take(r, "target", &if one { "radius_mm".into() } else { format!("radius{k}_mm") });
    }
}

/// Standard deviation of a linear function of named numbers; those that the covariance does not name are held.
fn of_terms(covariance: &Covariance, terms: &[(String, f64)]) -> f64 {
    let rows: Vec<(usize, f64)> = terms.iter().filter_map(|(n, d)| Some((covariance.index(n)?, *d))).collect();
    let products = rows.iter().flat_map(|(i, a)| rows.iter().map(move |(j, b)| a * b * covariance.matrix[*i][*j]));
    products.sum::<f64>().max(0.0).sqrt()
}

fn effective_sigma(camera: &record::Camera, covariance: &Covariance) -> Effective {
    let Ok(model) = camera.model() else { return Effective::default() };
    let by = model.effective_pinhole_by_intrinsics();
    let sigma = |q: usize| {
        let terms = INTRINSIC_NAMES.iter().zip(by.row(q)).map(|(n, d)| (format!("{}.{n}", camera.name), *d));
        of_terms(covariance, &terms.collect::<Vec<_>>())
    };
    Effective { f_px: sigma(0), cx_px: sigma(1), cy_px: sigma(2) }
}

/// Of baseline and angle between the axes: `d|t| = b . dv`.
fn rig_sigma(m: &Motion<Cam, Rig>, owner: &str, covariance: &Covariance) -> RigSigma {
    let b = m.translation_mm.normalize();
    let [by_rx, by_ry] = AxesAngle::of(&m.rotation).by_left_turn();
    let step = |k: usize| format!("{owner}.{}", STEP_NAMES[k]);
    let baseline = [(step(3), b.x), (step(4), b.y), (step(5), b.z)];
    let angle = [(step(0), by_rx), (step(1), by_ry)];
    RigSigma { baseline_mm: of_terms(covariance, &baseline), axes_angle_deg: of_terms(covariance, &angle).to_degrees() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    fn record() -> Record {
        // The schema's blanks filled in.
        let text = include_str!("../../tests/fixtures/calibration_schema_1.json")
            .replace("[[]]", "[[1,0,0],[0,-1,0],[0,0,-1]]")
            .replace("\"translation_mm\": []", "\"translation_mm\": [0,0,500]")
            .replace(
                "\"rig_from_target\": {}",
                "\"rig_from_target\": {\"rotation\": [[1,0,0],[0,-1,0],[0,0,-1]], \"translation_mm\": [0,0,500]}",
            )
            .replace(", \"right\": 0", "")
            .replace("\"spacing_mm\": 0", "\"spacing_mm\": 20")
            .replace("\"f_px\": 0, \"aspect\": 1", "\"f_px\": 8000, \"aspect\": 1")
            .replace(
                "\"distance_mm\": 0, \"abc_per_mm\": [0,0,0]",
                "\"distance_mm\": 500, \"abc_per_mm\": [0,0,0.002]",
            );
        let mut r = Record::from_json(&text, "fixture").unwrap();
        let first = &mut r.cameras[0];
        (first.f_px, first.cx_px, first.cy_px, first.k1) = (8000.0, 511.5, 383.5, -0.1);
        (first.alpha_rad, first.beta_rad) = (-0.02, 0.1);
        let mut second = first.clone();
        second.name = "second".into();
        (second.alpha_rad, second.beta_rad) = (0.03, -0.11);
        let view =
            Motion::<Rig, Target>::new(rotation_exp(&Vector3::new(3.0, 0.1, 0.2)), Vector3::new(5.0, -7.0, 500.0));
        r.views[0].rig_from_target = Some(Pose::from(&view));
        let pose =
            Motion::<Cam, Rig>::new(rotation_exp(&Vector3::new(0.02, -0.9, 0.1)), Vector3::new(400.0, 20.0, 150.0));
        second.cam_from_rig = Pose::from(&pose);
        r.cameras.push(second);
        for (c, camera) in r.cameras.iter_mut().enumerate() {
            let normal = Vector3::new(0.1, -0.3 + 0.5 * c as f64, 1.0).normalize();
            let sigma = WindowSigma {
                normal_rad: [0.0; 3],
                distance_mm: 0.0,
                thickness_mm: 0.0,
                n_air: 0.0,
                n_glass: 0.0,
                n_water: 0.0,
            };
            camera.window = Some(record::Window {
                normal_in_cam: normal.into(),
                distance_mm: 100.0,
                thickness_mm: 8.0,
                n_air: 1.0,
                n_glass: 1.5,
                n_water: 1.333,
                sigma,
            });
        }
        r
    }

    fn names(r: &Record) -> Vec<String> {
        let mut out = vec![];
        for c in &r.cameras {
            out.extend(["f_px", "cx_px", "cy_px", "alpha_rad", "beta_rad", "k1"].map(|q| format!("{}.{q}", c.name)));
            out.extend(["rx_rad", "ry_rad", "distance_mm", "n_water"].map(|q| format!("{}.window.{q}", c.name)));
        }
        out.extend(STEP_NAMES.map(|s| format!("{}.cam_from_rig.{s}", r.cameras[1].name)));
        out.extend(STEP_NAMES.map(|s| format!("view{}.rig_from_target.{s}", r.views[0].index)));
        out
    }

    /// To first order a step moves the number that it names and no other; windows turn about axes across their normal.
    #[test]
    fn small_steps_are_those_of_the_numbers() {
        let start = record();
        let names = names(&start);
        for (k, name) in names.iter().enumerate() {
            let h = if name.ends_with("_mm") || name.ends_with("_px") { 1e-3 } else { 1e-6 };
            let step = |sign: f64| {
                let steps = (0..names.len()).map(|j| if j == k { sign * h } else { 0.0 });
                record_after(&start, &Steps::new(&names, steps)).unwrap()
            };
            for (j, d) in numbers_between(&step(-1.0), &step(1.0), &names).iter().enumerate() {
                let d = d.unwrap() / (2.0 * h);
                // About its normal no window is seen to turn: there its name goes with the tilt, as in a covariance.
                let turns = ["window.r", "alpha_rad", "beta_rad"].iter().any(|q| name.contains(q));
                if turns && names[j].contains("window.r") {
                    continue;
                }
                let wanted = f64::from(u8::from(j == k));
                // Different units: a px beside a rad.
                let unit = if names[j].ends_with("_px") || names[j].ends_with("_mm") { 1e-3 } else { 1e-7 };
                assert!((d - wanted).abs() < unit * (1.0 + 1e-4 / h), "{name} -> {}: {d}", names[j]);
            }
        }
    }

    /// Along the valley of a lens without distortion all images stay, however far the axis point goes.
    #[test]
    fn a_long_step_along_the_valley_of_the_lens_axis_moves_no_image() {
        let mut start = record();
        start.cameras.iter_mut().for_each(|c| (c.k1, c.k2, c.k3) = (0.0, 0.0, 0.0));
        let names = names(&start);
        let camera = &start.cameras[1];
        let model = camera.model().unwrap();
        // The same pinhole with another axis point, and what that does to tilt, f, turn of the lens frame, window: taken straight.
        let (i, e) = (model.intrinsics(), model.effective_pinhole());
        let h = 1e-3;
        let side = |sign: f64| {
            let n = e.with_axis_point(i.cx_px, i.cy_px + sign * h, i.aspect);
            let frame = Camera::new(n).unwrap().cam_from_pinhole();
            (n, rotation_log(&(frame * model.cam_from_pinhole().transpose())))
        };
        let ((m, turn_m), (p, turn_p)) = (side(-1.0), side(1.0));
        let turn = (turn_p - turn_m) / (2.0 * h);
        let pose = camera.cam_from_rig.motion::<Cam, Rig>();
        let shift = Vector3::zeros();
        let rate: BTreeMap<String, f64> = [
            ("f_px".to_string(), (p.f_px - m.f_px) / (2.0 * h)),
            ("cy_px".into(), 1.0),
            ("alpha_rad".into(), (p.alpha_rad - m.alpha_rad) / (2.0 * h)),
            ("beta_rad".into(), (p.beta_rad - m.beta_rad) / (2.0 * h)),
        ]
        .into_iter()
        .chain(
            STEP_NAMES
                .iter()
                .enumerate()
                .map(|(k, s)| (format!("cam_from_rig.{s}"), if k < 3 { turn[k] } else { shift[k - 3] })),
        )
        .chain((0..3).map(|k| (format!("window.{}", WINDOW_STEP_NAMES[k]), turn[k])))
        .map(|(q, d)| (format!("{}.{q}", camera.name), d))
        .collect();
        let names: Vec<String> = names.into_iter().chain([format!("{}.window.rz_rad", camera.name)]).collect();
        let far =
            record_after(&start, &Steps::new(&names, names.iter().map(|n| 80.0 * rate.get(n).copied().unwrap_or(0.0))))
                .unwrap();
        let now = &far.cameras[1];
        assert!((now.alpha_rad - camera.alpha_rad).abs() > 0.005, "{}", now.alpha_rad);
        let there = now.cam_from_rig.motion::<Cam, Rig>();
        for q in [Vector2::new(100.0, 100.0), Vector2::new(900.0, 400.0), Vector2::new(500.0, 700.0)] {
            let sight = model.line_of_sight(&q).unwrap();
            let p = pose.inverse().apply(&(sight.from_mm + sight.direction * 300.0));
            let image = now.model().unwrap().project_xyz(&there.apply(&p)).unwrap();
            assert!((image - q).norm() < 1e-6, "{image} {q}");
        }
    }
}
