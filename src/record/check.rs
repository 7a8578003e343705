//! Values that no calibration can have, found after the types are right.

use super::diagnosis::MappingUncertainty;
use super::schema::{Camera, Covariance, FORMAT, Pose, Record, Sheet, VERSION, View};
use std::collections::BTreeSet;
use std::f64::consts::FRAC_PI_2;

/// How far a rotation matrix may be from orthonormal; files written with 8 digits pass.
const ROTATION_TOLERANCE: f64 = 1e-6;
/// No camera has more pixels along a side; maps over an image take as many.
const LARGEST_SIDE_PX: usize = 100_000;

/// What is impossible, and where.
pub(super) struct Fault {
    /// Path in the file: `cameras[0].sigma.f_px`.
    pub(super) path: String,
    /// What was found and what was expected.
    pub(super) message: String,
}

pub(super) type Check = std::result::Result<(), Fault>;

pub(super) fn fault(path: impl Into<String>, message: impl Into<String>) -> Check {
    Err(Fault { path: path.into(), message: message.into() })
}

/// The first impossible value of a record.
pub(super) fn first_fault(record: &Record) -> Option<Fault> {
    check_record(record).err()
}

fn check_record(r: &Record) -> Check {
    if r.format != FORMAT || r.version != VERSION {
        return fault("format", format!("{} {}: expected {FORMAT} {VERSION}", r.format, r.version));
    }
    let mut names = BTreeSet::new();
    if r.cameras.is_empty() {
        return fault("cameras", "no camera: expected at least one");
    }
    for (i, c) in r.cameras.iter().enumerate() {
        check_camera(c, &format!("cameras[{i}]"))?;
        if !names.insert(c.name.as_str()) {
            return fault(
                format!("cameras[{i}].name"),
                format!("\"{}\" occurs twice: expected different names", c.name),
            );
        }
    }
    check_first_pose(&r.cameras[0].cam_from_rig)?;
    if let Some(sheet) = &r.sheet {
        check_sheet(sheet)?;
    }
    for (i, v) in r.views.iter().enumerate() {
        check_view(v, &names, &format!("views[{i}]"))?;
    }
    for (path, x) in [("fit.rms_px", r.fit.rms_px), ("fit.chi2", r.fit.chi2)] {
        not_negative(path, x)?;
    }
    if let Some(mapping) = &r.mapping_uncertainty {
        check_mapping(mapping)?;
    }
    super::agreement::check(r)?;
    check_covariance(&r.covariance)?;
    super::named::check(r)
}

fn positive(path: String, x: f64) -> Check {
    if x > 0.0 && x.is_finite() {
        Ok(())
    } else {
        fault(path, format!("{x} is not possible: expected a number above 0"))
    }
}

fn finite(path: String, x: f64) -> Check {
    if x.is_finite() { Ok(()) } else { fault(path, format!("{x} is not possible: expected a finite number")) }
}

/// Unknown (`NaN`) is allowed: whoever reads a sigma must be ready for it.
fn not_negative(path: impl Into<String>, x: f64) -> Check {
    if x < 0.0 { fault(path, format!("{x} is not possible: expected 0 or more")) } else { Ok(()) }
}

fn check_camera(c: &Camera, at: &str) -> Check {
    if c.name.is_empty() {
        return fault(format!("{at}.name"), "empty: expected the camera's name");
    }
    // Files are called after it.
    if c.name.contains(|x: char| x.is_control() || matches!(x, '/' | '\\')) || c.name.starts_with('.') {
        let message = format!(
            "{:?} cannot be part of the name of a file: expected no dot at its start, no \"/\", \"\\\", line end or other control character",
            c.name
        );
        return fault(format!("{at}.name"), message);
    }
    if let Some(side) = c.image_size_px.iter().find(|side| !(1..=LARGEST_SIDE_PX).contains(*side)) {
        let message = format!("a side of {side} px: expected width and height, 1 to {LARGEST_SIDE_PX} px");
        return fault(format!("{at}.image_size_px"), message);
    }
    positive(format!("{at}.f_px"), c.f_px)?;
    positive(format!("{at}.aspect"), c.aspect)?;
    positive(format!("{at}.pupil_ratio"), c.pupil_ratio)?;
    for (key, x) in [("alpha_rad", c.alpha_rad), ("beta_rad", c.beta_rad)] {
        if x.is_nan() || x.abs() >= FRAC_PI_2 {
            let message = format!("{x} is not possible: expected a tilt between -pi/2 and pi/2 rad (not degrees)");
            return fault(format!("{at}.{key}"), message);
        }
    }
    for (key, x) in [("cx_px", c.cx_px), ("cy_px", c.cy_px), ("k1", c.k1), ("k2", c.k2), ("k3", c.k3)] {
        finite(format!("{at}.{key}"), x)?;
    }
    match crate::camera::Camera::new(c.intrinsics()) {
        Err(error) => return fault(at, error.to_string()),
        Ok(camera) => super::agreement::check_effective(&c.effective, &camera.effective_pinhole(), at)?,
    }
    if let Some(window) = &c.window {
        if let Err(error) = window.model() {
            return fault(format!("{at}.window"), error.to_string());
        }
        let length = nalgebra::Vector3::from(window.normal_in_cam).norm();
        if (length - 1.0).abs() > ROTATION_TOLERANCE {
            return fault(format!("{at}.window.normal_in_cam"), format!("its length is {length}: expected 1"));
        }
        let s = &window.sigma;
        let all = [s.distance_mm, s.thickness_mm, s.n_air, s.n_glass, s.n_water];
        for x in s.normal_rad.into_iter().chain(all) {
            not_negative(format!("{at}.window.sigma"), x)?;
        }
    }
    let s = &c.sigma;
    let sigmas = [
        ("f_px", s.f_px),
        ("aspect", s.aspect),
        ("cx_px", s.cx_px),
        ("cy_px", s.cy_px),
        ("alpha_rad", s.alpha_rad),
        ("beta_rad", s.beta_rad),
        ("k1", s.k1),
        ("k2", s.k2),
        ("k3", s.k3),
    ];
    for (key, x) in sigmas {
        not_negative(format!("{at}.sigma.{key}"), x)?;
    }
    not_negative(format!("{at}.rms_px"), c.rms_px)?;
    check_pose(&c.cam_from_rig, &format!("{at}.cam_from_rig"))
}

fn check_pose(pose: &Pose, at: &str) -> Check {
    let m = pose.motion::<(), ()>();
    let gap = (m.rotation * m.rotation.transpose() - nalgebra::Matrix3::identity()).abs().max();
    let determinant = m.rotation.determinant();
    let finite = determinant.is_finite() && pose.translation_mm.iter().all(|x| x.is_finite());
    if !finite || gap > ROTATION_TOLERANCE || determinant < 0.0 {
        let message = format!(
            "not a rotation (largest entry of R R^T - 1 is {gap:.1e}, determinant {determinant:.3}): expected an orthonormal matrix with determinant 1"
        );
        return fault(format!("{at}.rotation"), message);
    }
    Ok(())
}

fn check_first_pose(pose: &Pose) -> Check {
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    if pose.rotation != identity || pose.translation_mm != [0.0; 3] {
        return fault("cameras[0].cam_from_rig", "the first camera is the rig frame: expected the identity");
    }
    Ok(())
}

fn check_sheet(s: &Sheet) -> Check {
    positive("sheet.distance_mm".into(), s.distance_mm)?;
    for (i, &x) in s.abc_per_mm.iter().enumerate() {
        finite(format!("sheet.abc_per_mm[{i}]"), x)?;
    }
    let n = s.normal_in_rig;
    let norm = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    if norm.is_nan() || (norm - 1.0).abs() > ROTATION_TOLERANCE {
        return fault("sheet.normal_in_rig", format!("its length is {norm}: expected a unit vector"));
    }
    let gap = (0..3).map(|i| (s.abc_per_mm[i] * s.distance_mm - n[i]).abs()).fold(0.0, f64::max);
    if gap > ROTATION_TOLERANCE {
        let message =
            format!("differs from normal_in_rig / distance_mm by {gap:.1e} of the normal: expected the same plane");
        return fault("sheet.abc_per_mm", message);
    }
    check_pose(&s.rig_from_sheet, "sheet.rig_from_sheet")?;
    let (r, t) = (&s.rig_from_sheet.rotation, &s.rig_from_sheet.translation_mm);
    let turned = (0..3).map(|i| (r[i][2] + n[i]).abs()).fold(0.0, f64::max);
    let off_mm = (0..3).map(|i| n[i] * t[i]).sum::<f64>() - s.distance_mm;
    if turned > ROTATION_TOLERANCE || off_mm.abs() > ROTATION_TOLERANCE * s.distance_mm {
        let message = format!(
            "its z axis differs from -normal_in_rig by {turned:.1e}, its origin lies {off_mm:.1e} mm off the plane: expected the same plane"
        );
        return fault("sheet.rig_from_sheet", message);
    }
    Ok(())
}

fn check_view(v: &View, cameras: &BTreeSet<&str>, at: &str) -> Check {
    let keys = v.rms_px.keys().chain(v.observations.keys()).chain(v.images.keys());
    for name in keys {
        if !cameras.contains(name.as_str()) {
            let expected: Vec<_> = cameras.iter().copied().collect();
            let message = format!("no camera is called \"{name}\": expected one of {}", expected.join(", "));
            return fault(at, message);
        }
    }
    match &v.rig_from_target {
        Some(pose) => check_pose(pose, &format!("{at}.rig_from_target")),
        None if v.used => fault(format!("{at}.rig_from_target"), "null in a view that was used: expected a pose"),
        None => Ok(()),
    }
}

fn check_mapping(m: &MappingUncertainty) -> Check {
    for (key, point) in [("middle", &m.middle), ("largest", &m.largest)] {
        check_square(&point.displacement, 3, &format!("mapping_uncertainty.{key}.displacement"))?;
    }
    if let Some(bent) = &m.by_likelihood {
        check_square(&bent.displacement, 3, "mapping_uncertainty.by_likelihood.displacement")?;
    }
    if let Some(by_views) = &m.by_views {
        check_square(&by_views.displacement, 3, "mapping_uncertainty.by_views.displacement")?;
    }
    let map = &m.map;
    let n = map.x_mm.len();
    if map.y_mm.len() != n {
        return fault("mapping_uncertainty.map.y_mm", format!("{} numbers: expected {n}, as in x_mm", map.y_mm.len()));
    }
    let lists = [
        ("in_plane_px", &map.in_plane_px),
        ("disparity_px", &map.disparity_px),
        ("u_per_u", &map.u_per_u),
        ("w_per_w", &map.w_per_w),
        ("u_per_w", &map.u_per_w),
        ("v_per_w", &map.v_per_w),
        ("w_per_u", &map.w_per_u),
        ("v_per_v", &map.v_per_v),
        ("w_per_v", &map.w_per_v),
        ("u_per_v", &map.u_per_v),
        ("v_per_u", &map.v_per_u),
    ];
    match lists.into_iter().find(|(_, list)| !list.is_empty() && list.len() != n) {
        None => Ok(()),
        Some((key, list)) => {
            let message = format!("{} numbers: expected {n}, as in x_mm, or none", list.len());
            fault(format!("mapping_uncertainty.map.{key}"), message)
        }
    }
}

/// Whether a matrix has `n` rows of `n` numbers.
fn check_square(rows: &[Vec<f64>], n: usize, at: &str) -> Check {
    if rows.len() != n {
        return fault(at, format!("{} rows: expected {n}", rows.len()));
    }
    match rows.iter().position(|row| row.len() != n) {
        None => Ok(()),
        Some(i) => fault(format!("{at}[{i}]"), format!("{} numbers: expected {n}", rows[i].len())),
    }
}

fn check_covariance(c: &Covariance) -> Check {
    let n = c.names.len();
    let distinct: BTreeSet<_> = c.names.iter().collect();
    if distinct.len() != n {
        return fault("covariance.names", "a name occurs twice: expected different names");
    }
    check_square(&c.matrix, n, "covariance.matrix")?;
    for (i, row) in c.matrix.iter().enumerate() {
        let path = || format!("covariance.matrix[{i}]");
        if row[i] < 0.0 {
            return fault(path(), format!("variance of {} is {}: expected 0 or more", c.names[i], row[i]));
        }
        let skew = (0..i).find(|&j| (row[j] - c.matrix[j][i]).abs() > 1e-9 * (row[i] * c.matrix[j][j]).abs().sqrt());
        if let Some(j) = skew {
            return fault(path(), format!("entry {j} differs from its mirror image: expected a symmetric matrix"));
        }
    }
    for (k, d) in c.null_directions.iter().enumerate() {
        if d.len() != n {
            return fault(format!("covariance.null_directions[{k}]"), format!("{} numbers: expected {n}", d.len()));
        }
    }
    Ok(())
}
