//! From keys to the numbers of a record.

use super::abi::SPIVCAL_ERROR_NOT_AVAILABLE;
use super::detection::unknown_key;
use super::door::Fault;
use super::keys::*;
use crate::record::{Camera, Pose, PoseSigma, Radial, Record, Sheet, View, Window};
use crate::report::{Level, verdict};

/// A value and its standard deviation, NaN where there is none.
type Number = Result<(f64, f64), Fault>;

const NO_SIGMA: f64 = f64::NAN;

fn missing(what: &str) -> Fault {
    Fault::new(SPIVCAL_ERROR_NOT_AVAILABLE, format!("this calibration has no {what}"))
}

fn one<'a, T>(all: &'a [T], index: u64, what: &str) -> Result<&'a T, Fault> {
    usize::try_from(index).ok().and_then(|i| all.get(i)).ok_or_else(|| Fault::index(what, index, all.len()))
}

fn sheet_of(record: &Record) -> Result<&Sheet, Fault> {
    record.sheet.as_ref().ok_or_else(|| missing("sheet: no view was recorded in it (sheet = true)"))
}

fn window_of(camera: &Camera) -> Result<&Window, Fault> {
    camera.window.as_ref().ok_or_else(|| missing(&format!("window before camera \"{}\"", camera.name)))
}

/// `spivcal_calibration_number`.
pub(super) fn number(record: &Record, key: i32, index: u64) -> Number {
    let found = match key {
        SPIVCAL_CAMERA_F_PX..=SPIVCAL_CAMERA_RADIAL => of_camera(one(&record.cameras, index, "camera")?, key),
        SPIVCAL_CAMERA_WINDOW_NORMAL_X..=SPIVCAL_CAMERA_WINDOW_N_WATER => {
            of_window(window_of(one(&record.cameras, index, "camera")?)?, key)
        }
        SPIVCAL_BASELINE_MM | SPIVCAL_AXES_ANGLE_DEG => {
            let rig = record.rig.as_ref().ok_or_else(|| missing("second camera"))?;
            Ok(match key {
                SPIVCAL_BASELINE_MM => (rig.baseline_mm, rig.sigma.baseline_mm),
                _ => (rig.axes_angle_deg, rig.sigma.axes_angle_deg),
            })
        }
        SPIVCAL_SHEET_DISTANCE_MM..=SPIVCAL_SHEET_DISPARITY_RMS_PX => of_sheet(sheet_of(record)?, key),
        SPIVCAL_TARGET_SPACING_MM..=SPIVCAL_TARGET_SHIFT_RMS_MM | SPIVCAL_TARGET_RADIUS_MM => {
            of_target(record, key, index)
        }
        SPIVCAL_FIT_RMS_PX..=SPIVCAL_FIT_VERDICT => of_fit(record, key),
        SPIVCAL_VIEW_IN_SHEET..=SPIVCAL_VIEW_RADIUS1_MM => of_view(one(&record.views, index, "view")?, key),
        _ => Err(unknown_key("the number keys", key)),
    }?;
    if !matches!(
        key,
        SPIVCAL_CAMERA_F_PX..=SPIVCAL_CAMERA_WINDOW_N_WATER
            | SPIVCAL_TARGET_RADIUS_MM
            | SPIVCAL_VIEW_IN_SHEET..=SPIVCAL_VIEW_RADIUS1_MM
    ) {
        Fault::unless_zero(index)?;
    }
    Ok(found)
}

fn of_camera(c: &Camera, key: i32) -> Number {
    let s = &c.sigma;
    Ok(match key {
        SPIVCAL_CAMERA_F_PX => (c.f_px, s.f_px),
        SPIVCAL_CAMERA_ASPECT => (c.aspect, s.aspect),
        SPIVCAL_CAMERA_CX_PX => (c.cx_px, s.cx_px),
        SPIVCAL_CAMERA_CY_PX => (c.cy_px, s.cy_px),
        SPIVCAL_CAMERA_ALPHA_RAD => (c.alpha_rad, s.alpha_rad),
        SPIVCAL_CAMERA_BETA_RAD => (c.beta_rad, s.beta_rad),
        SPIVCAL_CAMERA_K1 => (c.k1, s.k1),
        SPIVCAL_CAMERA_K2 => (c.k2, s.k2),
        SPIVCAL_CAMERA_K3 => (c.k3, s.k3),
        SPIVCAL_CAMERA_PUPIL_RATIO => (c.pupil_ratio, s.pupil_ratio),
        SPIVCAL_CAMERA_EFFECTIVE_F_PX => (c.effective.f_px, s.effective.f_px),
        SPIVCAL_CAMERA_EFFECTIVE_CX_PX => (c.effective.cx_px, s.effective.cx_px),
        SPIVCAL_CAMERA_EFFECTIVE_CY_PX => (c.effective.cy_px, s.effective.cy_px),
        SPIVCAL_CAMERA_RMS_PX => (c.rms_px, NO_SIGMA),
        SPIVCAL_CAMERA_WIDTH_PX => (c.image_size_px[0] as f64, NO_SIGMA),
        SPIVCAL_CAMERA_HEIGHT_PX => (c.image_size_px[1] as f64, NO_SIGMA),
        SPIVCAL_CAMERA_OBSERVATIONS => (c.observations as f64, NO_SIGMA),
        SPIVCAL_CAMERA_PIXEL_PITCH_MM => (c.pixel_pitch_mm.ok_or_else(|| missing("pixel pitch"))?, NO_SIGMA),
        SPIVCAL_CAMERA_RADIAL => (f64::from(u8::from(c.radial == Radial::DistortedToIdeal)), NO_SIGMA),
        _ => return Err(unknown_key("SPIVCAL_CAMERA_*", key)),
    })
}

fn of_window(w: &Window, key: i32) -> Number {
    let s = &w.sigma;
    Ok(match key {
        SPIVCAL_CAMERA_WINDOW_NORMAL_X => (w.normal_in_cam[0], NO_SIGMA),
        SPIVCAL_CAMERA_WINDOW_NORMAL_Y => (w.normal_in_cam[1], NO_SIGMA),
        SPIVCAL_CAMERA_WINDOW_NORMAL_Z => (w.normal_in_cam[2], NO_SIGMA),
        SPIVCAL_CAMERA_WINDOW_DISTANCE_MM => (w.distance_mm, s.distance_mm),
        SPIVCAL_CAMERA_WINDOW_THICKNESS_MM => (w.thickness_mm, s.thickness_mm),
        SPIVCAL_CAMERA_WINDOW_N_AIR => (w.n_air, s.n_air),
        SPIVCAL_CAMERA_WINDOW_N_GLASS => (w.n_glass, s.n_glass),
        SPIVCAL_CAMERA_WINDOW_N_WATER => (w.n_water, s.n_water),
        _ => return Err(unknown_key("SPIVCAL_CAMERA_WINDOW_*", key)),
    })
}

fn of_sheet(sheet: &Sheet, key: i32) -> Number {
    let s = &sheet.sigma;
    let at = |first: i32| usize::try_from(key - first).unwrap_or(0);
    Ok(match key {
        SPIVCAL_SHEET_DISTANCE_MM => (sheet.distance_mm, s.distance_mm),
        SPIVCAL_SHEET_NORMAL_X..=SPIVCAL_SHEET_NORMAL_Z => (sheet.normal_in_rig[at(SPIVCAL_SHEET_NORMAL_X)], NO_SIGMA),
        SPIVCAL_SHEET_A_PER_MM..=SPIVCAL_SHEET_C_PER_MM => {
            let i = at(SPIVCAL_SHEET_A_PER_MM);
            (sheet.abc_per_mm[i], s.abc_per_mm[i])
        }
        SPIVCAL_SHEET_ANGLE1_DEG..=SPIVCAL_SHEET_ANGLE3_DEG => {
            let i = at(SPIVCAL_SHEET_ANGLE1_DEG);
            (sheet.angles_deg[i], s.angles_deg[i])
        }
        SPIVCAL_SHEET_ANGLE_TO_BASELINE_DEG => (sheet.angle_to_baseline_deg, s.angle_to_baseline_deg),
        SPIVCAL_SHEET_DISPARITY_RMS_PX => (sheet.disparity_rms_px.ok_or_else(|| missing("disparity"))?, NO_SIGMA),
        _ => return Err(unknown_key("SPIVCAL_SHEET_*", key)),
    })
}

fn of_target(record: &Record, key: i32, index: u64) -> Number {
    let t = &record.target;
    Ok(match key {
        SPIVCAL_TARGET_SPACING_MM if t.spacing_mm.is_nan() => {
            return Err(missing("one spacing: each view has its own"));
        }
        SPIVCAL_TARGET_SPACING_MM => (t.spacing_mm, t.sigma.spacing_mm),
        SPIVCAL_TARGET_STEP_MM => {
            (t.step_mm.ok_or_else(|| missing("second level"))?, t.sigma.step_mm.unwrap_or(NO_SIGMA))
        }
        SPIVCAL_TARGET_SHIFT_RMS_MM => (t.shift_rms_mm.ok_or_else(|| missing("points that were adjusted"))?, NO_SIGMA),
        SPIVCAL_TARGET_RADIUS_MM => {
            (*one(&t.radii_mm, index, "radius")?, one(&t.sigma.radii_mm, index, "radius").copied().unwrap_or(NO_SIGMA))
        }
        _ => return Err(unknown_key("SPIVCAL_TARGET_*", key)),
    })
}

fn of_fit(record: &Record, key: i32) -> Number {
    let f = &record.fit;
    let value = match key {
        SPIVCAL_FIT_RMS_PX => f.rms_px,
        SPIVCAL_FIT_CHI2 => f.chi2,
        SPIVCAL_FIT_DEGREES_OF_FREEDOM => f.degrees_of_freedom as f64,
        SPIVCAL_FIT_REDUNDANCY => f.redundancy,
        SPIVCAL_FIT_OBSERVATIONS => f.observations as f64,
        SPIVCAL_FIT_ITERATIONS => f.iterations as f64,
        SPIVCAL_FIT_NEWTON_DECREMENT => f.newton_decrement,
        SPIVCAL_FIT_NULLITY => f.nullity as f64,
        SPIVCAL_FIT_OUTLIERS => f.outliers as f64,
        SPIVCAL_FIT_CONVERGED => f64::from(u8::from(f.converged)),
        SPIVCAL_FIT_SIGMA_SCALE => f.sigma_scale,
        SPIVCAL_FIT_VERDICT => match verdict(record).level {
            Level::Good => 0.0,
            Level::Care => 1.0,
            Level::Bad => 2.0,
        },
        _ => return Err(unknown_key("SPIVCAL_FIT_*", key)),
    };
    Ok((value, NO_SIGMA))
}

fn of_view(view: &View, key: i32) -> Number {
    let truth = |t: bool| Ok((f64::from(u8::from(t)), NO_SIGMA));
    let own = || view.target.as_ref().ok_or_else(|| missing("bubbles in this view"));
    match key {
        SPIVCAL_VIEW_IN_SHEET => truth(view.in_sheet),
        SPIVCAL_VIEW_USED => truth(view.used),
        SPIVCAL_VIEW_SPACING_MM => own().map(|t| (t.spacing_mm, t.sigma.spacing_mm)),
        SPIVCAL_VIEW_RADIUS0_MM | SPIVCAL_VIEW_RADIUS1_MM => {
            let (t, i) = (own()?, u64::from(key == SPIVCAL_VIEW_RADIUS1_MM));
            let sigma = one(&t.sigma.radii_mm, i, "radius").copied().unwrap_or(NO_SIGMA);
            Ok((*one(&t.radii_mm, i, "radius")?, sigma))
        }
        _ => Err(unknown_key("SPIVCAL_VIEW_*", key)),
    }
}

/// `spivcal_calibration_array_copy`.
pub(super) fn array(record: &Record, key: i32, index: u64) -> Result<Vec<f64>, Fault> {
    let camera = || one(&record.cameras, index, "camera");
    let view = || one(&record.views, index, "view");
    let points = &record.target.points;
    let columns = |of: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        (0..3).flat_map(|k| (0..points.len()).map(move |i| (i, k))).map(|(i, k)| of(i, k)).collect()
    };
    let found = match key {
        SPIVCAL_ARRAY_CAM_FROM_RIG => matrix(&camera()?.cam_from_rig),
        SPIVCAL_ARRAY_CAM_FROM_RIG_SIGMA => steps(&camera()?.sigma.cam_from_rig),
        SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD => window_of(camera()?)?.sigma.normal_rad.to_vec(),
        SPIVCAL_ARRAY_RIG_FROM_SHEET => matrix(&sheet_of(record)?.rig_from_sheet),
        SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD => sheet_of(record)?.sigma.normal_rad.to_vec(),
        SPIVCAL_ARRAY_RIG_FROM_TARGET => {
            matrix(view()?.rig_from_target.as_ref().ok_or_else(|| missing("pose of this view: it was not used"))?)
        }
        SPIVCAL_ARRAY_RIG_FROM_TARGET_SIGMA => steps(&view()?.sigma),
        SPIVCAL_ARRAY_VIEW_RMS_PX => {
            let rms = &view()?.rms_px;
            record.cameras.iter().map(|c| rms.get(&c.name).copied().unwrap_or(f64::NAN)).collect()
        }
        SPIVCAL_ARRAY_COVARIANCE => {
            let n = record.covariance.names.len();
            (0..n * n).map(|k| record.covariance.known(k / n, k % n)).collect()
        }
        SPIVCAL_ARRAY_TARGET_POINT_XYZ_MM => columns(&|i, k| points[i].xyz_mm[k]),
        SPIVCAL_ARRAY_TARGET_POINT_SIGMA_MM => columns(&|i, k| points[i].sigma_mm[k]),
        SPIVCAL_ARRAY_TARGET_POINT_LABEL => columns(&|i, k| {
            let l = points[i].label;
            f64::from([l.column, l.row, i32::from(l.level)][k])
        }),
        _ => return Err(unknown_key("SPIVCAL_ARRAY_*", key)),
    };
    if !matches!(
        key,
        SPIVCAL_ARRAY_CAM_FROM_RIG..=SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD
            | SPIVCAL_ARRAY_RIG_FROM_TARGET..=SPIVCAL_ARRAY_VIEW_RMS_PX
    ) {
        Fault::unless_zero(index)?;
    }
    Ok(found)
}

/// 4 x 4 row-major, homogeneous.
fn matrix(pose: &Pose) -> Vec<f64> {
    let row = |i: usize| pose.rotation[i].into_iter().chain([pose.translation_mm[i]]);
    (0..3).flat_map(row).chain([0.0, 0.0, 0.0, 1.0]).collect()
}

fn steps(sigma: &PoseSigma) -> Vec<f64> {
    sigma.rotation_rad.into_iter().chain(sigma.translation_mm).collect()
}
