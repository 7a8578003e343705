//! `truth.json`: the true values in the shape of a calibration, so that it can be read wherever a calibration can.
//!
//! Standard deviations are zero and the fit is empty, since nothing was estimated. Beside the keys of a calibration each
//! view lists what it shows: place in the target, and per camera the image of the centre and the ellipse of the
//! outline (exact without distortion, else fitted to 72 points of the projected outline).
//!
//! Sheet frame and angles: z = -normal (towards the first camera), x = the rig's x axis projected into the sheet, origin
//! where the first camera's axis meets it; `rig_from_sheet = Rx(t1) Ry(t2) Rz(t3)` times the half turn about x.
//! `angle_to_baseline_deg = asin(normal . b)`, b the unit vector from the first camera to the second; 0 where it runs
//! along the sheet, positive where it runs towards the sheet.

use super::pattern::Feature;
use super::rig::image_name;
use super::scene::SceneFile;
use super::setup::{Bench, PlacedCamera, PlacedView, Setup, fully_inside, rim_px};
use crate::conic::Ellipse;
use crate::error::{Error, Result};
use crate::frames::{Cam, Pixel, Plane, Rig, Sheet, Target};
use crate::rigid::{AxesAngle, Motion, PlaneAngle};
use crate::target::TargetKind as Kind;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
use serde_json::{Map, Value, json};

/// The text of `truth.json`.
pub(super) fn truth_json(scene: &SceneFile, setup: &Setup) -> Result<String> {
    let first = &setup.cameras[0];
    let rig_from_bench = Motion::<Rig, Bench>::new(first.cam_from_bench.rotation, first.cam_from_bench.translation_mm);
    let cam_from_rig = |i: usize, c: &PlacedCamera| {
        // The first camera is the rig: exactly, not up to rounding.
        if i == 0 { Motion::identity() } else { c.cam_from_bench * rig_from_bench.inverse() }
    };
    let cameras: Vec<Value> = setup.cameras.iter().enumerate().map(|(i, c)| camera(c, &cam_from_rig(i, c))).collect();
    let views: Vec<Value> =
        setup.views.iter().enumerate().map(|(i, v)| view(i, v, setup, &rig_from_bench)).collect::<Result<_>>()?;
    let t = &scene.target;
    let radii = match t.kind {
        Kind::TwoDiscs => json!(t.radii_mm),
        Kind::Bubbles => json!([]),
        _ => json!([t.radius_mm]),
    };
    let mut truth = json!({
        "format": "spivcal-calibration",
        "version": 1,
        "note": "true values of a simulated scene: nothing was estimated, every sigma is zero",
        "cameras": cameras,
        "rig": rig(setup),
        "sheet": sheet(setup, &rig_from_bench),
        "target": { "kind": t.kind.word(), "radii_mm": radii, "spacing_mm": t.spacing_mm, "sigma": {} },
        "views": views,
        "fit": { "rms_px": 0.0, "chi2": 0.0, "degrees_of_freedom": 0, "redundancy": 0, "observations": 0, "iterations": 0,
                 "newton_decrement": 0.0, "termination": "truth", "nullity": 0, "undetermined": [], "outliers": 0 },
        "covariance": { "names": [], "matrix": [] },
    });
    if let Some(p) = &scene.particles {
        let flow = p.flow.as_ref().map(|f| {
            json!({ "shift_mm": f.shift_mm, "vortex_mm": f.vortex_mm, "jet_mm": f.jet_mm, "radius_mm": f.radius_mm,
                    "center_mm": f.center_mm })
        });
        let rig_from_light: Motion<Rig, Sheet> = rig_from_bench * setup.bench_from_light;
        truth["particles"] =
            json!({ "thickness_mm": p.thickness_mm, "rig_from_light": motion(&rig_from_light), "flow": flow });
    }
    serde_json::to_string_pretty(&truth).map(|s| s + "\n").map_err(|e| Error::Bug(e.to_string()))
}

fn rows(m: &Matrix3<f64>) -> Value {
    json!([[m.m11, m.m12, m.m13], [m.m21, m.m22, m.m23], [m.m31, m.m32, m.m33]])
}

fn motion<A, B>(m: &Motion<A, B>) -> Value {
    json!({ "rotation": rows(&m.rotation), "translation_mm": m.translation_mm.as_slice() })
}

fn camera(c: &PlacedCamera, cam_from_rig: &Motion<Cam, Rig>) -> Value {
    let i = c.camera.intrinsics();
    let e = c.camera.effective_pinhole();
    let none = ["f_px", "aspect", "cx_px", "cy_px", "alpha_rad", "beta_rad", "k1", "k2", "k3"];
    let mut sigma: Map<String, Value> = none.iter().map(|n| ((*n).to_owned(), json!(0.0))).collect();
    sigma.insert("effective".to_owned(), json!({ "f_px": 0.0, "cx_px": 0.0, "cy_px": 0.0 }));
    json!({
        "name": c.name,
        "image_size_px": c.size_px,
        "f_px": i.f_px, "aspect": i.aspect, "cx_px": i.cx_px, "cy_px": i.cy_px,
        "alpha_rad": i.alpha_rad, "beta_rad": i.beta_rad, "k1": i.k[0], "k2": i.k[1], "k3": i.k[2],
        "pupil_ratio": i.pupil_ratio,
        "pixel_pitch_mm": c.pixel_pitch_mm,
        "radial": match i.radial {
            crate::camera::Radial::IdealToDistorted => "ideal_to_distorted",
            crate::camera::Radial::DistortedToIdeal => "distorted_to_ideal",
        },
        "effective": { "f_px": e.f_px, "cx_px": e.cx_px, "cy_px": e.cy_px },
        "sigma": sigma,
        "cam_from_rig": motion(cam_from_rig),
        "rms_px": 0.0,
    })
}

/// Baseline and angle of the lens axes; none with a single camera.
fn rig(setup: &Setup) -> Option<Value> {
    let [a, b] = &setup.cameras[..] else { return None };
    let second = a.cam_from_bench * b.cam_from_bench.inverse();
    Some(json!({
        "baseline_mm": second.translation_mm.norm(),
        "axes_angle_deg": AxesAngle::of(&second.rotation).rad.to_degrees(),
        "sigma": { "baseline_mm": 0.0, "axes_angle_deg": 0.0 },
    }))
}

/// The laser plane in the rig frame and the frame in it.
fn sheet(setup: &Setup, rig_from_bench: &Motion<Rig, Bench>) -> Value {
    let rig_from_plane: Motion<Rig, Sheet> = *rig_from_bench * setup.bench_from_sheet;
    let normal = rig_from_plane.rotation.column(2).into_owned();
    let plane = Plane::<Rig>::away_from_origin(normal, normal.dot(&rig_from_plane.translation_mm));
    let (normal, distance_mm) = (plane.normal.xyz, plane.distance_mm);
    let z = -normal;
    let x = (Vector3::x() - z * z.x).normalize();
    let rotation = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let origin_mm = Vector3::new(0.0, 0.0, distance_mm / normal.z);
    let turned = rotation * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let angles = [(-turned.m23).atan2(turned.m33), turned.m13.clamp(-1.0, 1.0).asin(), (-turned.m12).atan2(turned.m11)];
    let to_baseline = setup.cameras.get(1).map(|c| {
        let baseline = rig_from_bench.apply(&c.cam_from_bench.inverse().translation_mm);
        PlaneAngle::of(&normal, &baseline.normalize()).rad.to_degrees()
    });
    json!({
        "normal_in_rig": normal.as_slice(),
        "distance_mm": distance_mm,
        "abc_per_mm": (normal / distance_mm).as_slice(),
        "angles_deg": angles.map(f64::to_degrees),
        "angle_to_baseline_deg": to_baseline,
        "sigma": { "distance_mm": 0.0, "normal_rad": [0.0, 0.0], "abc_per_mm": [0.0, 0.0, 0.0],
                   "angles_deg": [0.0, 0.0, 0.0], "angle_to_baseline_deg": 0.0 },
        "rig_from_sheet": motion(&Motion::<Rig, Sheet>::new(rotation, origin_mm)),
    })
}

fn view(index: usize, v: &PlacedView, setup: &Setup, rig_from_bench: &Motion<Rig, Bench>) -> Result<Value> {
    let rms: Map<String, Value> = setup.cameras.iter().map(|c| (c.name.clone(), json!(0.0))).collect();
    let images: Map<String, Value> =
        setup.cameras.iter().map(|c| (c.name.clone(), json!(image_name(index, &c.name)))).collect();
    let discs: Vec<Value> = v.pattern.features.iter().map(|f| disc(f, v, setup)).collect::<Result<_>>()?;
    let mut value = json!({
        "index": index,
        "in_sheet": v.in_sheet,
        "rig_from_target": motion(&(*rig_from_bench * v.bench_from_target)),
        "rms_px": rms,
        "images": images,
        "discs": discs,
    });
    if let Some((radii, spacing)) = v.pair_mm {
        value["target"] = json!({ "radii_mm": radii, "spacing_mm": spacing, "sigma": {} });
    }
    Ok(value)
}

fn disc(f: &Feature, v: &PlacedView, setup: &Setup) -> Result<Value> {
    let mut images = Map::new();
    for c in &setup.cameras {
        let cam_from_target: Motion<Cam, Target> = c.cam_from_bench * v.bench_from_target;
        let whole = fully_inside(c, &cam_from_target, f, 0.0).is_ok();
        let center = c.camera.project_xyz(&cam_from_target.apply(&f.center_mm)).ok();
        let ellipse = match f.outline.radius_mm() {
            Some(_) if whole => ellipse_of(&rim_px(c, &cam_from_target, f, 72)),
            _ => None,
        };
        let ellipse = ellipse.map(|e| {
            json!({ "center_px": [e.center_px.u_px, e.center_px.v_px], "semi_major_px": e.semi_major_px,
                    "semi_minor_px": e.semi_minor_px, "angle_rad": e.angle_rad })
        });
        images.insert(
            c.name.clone(),
            json!({ "whole": whole, "center_px": center.map(|q| [q.x, q.y]), "ellipse": ellipse }),
        );
    }
    Ok(json!({
        "column": f.id.column, "row": f.id.row, "level": f.id.level,
        "mark": f.mark.map(|m| m.word()),
        "center_in_target_mm": f.center_mm.as_slice(),
        "radius_mm": f.outline.radius_mm(),
        "images": images,
    }))
}

/// Ellipse through points that lie on one, by linear least squares in coordinates of unit size.
pub(super) fn ellipse_of(points: &[Vector2<f64>]) -> Option<Ellipse> {
    let n = points.len() as f64;
    let middle = points.iter().sum::<Vector2<f64>>() / n;
    let size = (points.iter().map(|p| (p - middle).norm_squared()).sum::<f64>() / n).sqrt();
    let (mut normal, mut right) = (SMatrix::<f64, 5, 5>::zeros(), SVector::<f64, 5>::zeros());
    for p in points {
        let q = (p - middle) / size;
        let row = SVector::<f64, 5>::from([q.x * q.x, 2.0 * q.x * q.y, q.y * q.y, q.x, q.y]);
        normal += row * row.transpose();
        right += row;
    }
    let s = normal.lu().solve(&right)?;
    let a = Matrix2::new(s[0], s[1], s[1], s[2]);
    let center = a.lu().solve(&Vector2::new(-0.5 * s[3], -0.5 * s[4]))?;
    let scale = 1.0 + (a * center).dot(&center);
    let eigen = a.symmetric_eigen();
    let axes = eigen.eigenvalues.map(|l| (scale / l).sqrt() * size);
    if !axes.iter().all(|x| x.is_finite()) {
        return None;
    }
    let major = if axes[0] >= axes[1] { 0 } else { 1 };
    let direction = eigen.eigenvectors.column(major);
    let mut angle_rad = direction.y.atan2(direction.x);
    if angle_rad > std::f64::consts::FRAC_PI_2 {
        angle_rad -= std::f64::consts::PI;
    } else if angle_rad <= -std::f64::consts::FRAC_PI_2 {
        angle_rad += std::f64::consts::PI;
    }
    let c = middle + center * size;
    Some(Ellipse {
        center_px: Pixel::new(c.x, c.y),
        semi_major_px: axes[major],
        semi_minor_px: axes[1 - major],
        angle_rad,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ellipse_goes_through_its_points() {
        let e =
            Ellipse { center_px: Pixel::new(400.0, 300.0), semi_major_px: 150.0, semi_minor_px: 90.0, angle_rad: -1.1 };
        let points: Vec<_> =
            (0..72).map(|i| e.point(f64::from(i) * 0.0872)).map(|p| Vector2::new(p.u_px, p.v_px)).collect();
        let got = ellipse_of(&points).unwrap();
        assert!((got.parameters() - e.parameters()).norm() < 1e-9, "{got:?}");
    }
}
