//! Cameras read from another package as a record of this one.

use super::{Conversion, Found, ImportOptions, Loss, NamedText, WorldCamera};
use crate::camera::Radial;
use crate::error::{Error, Invalid, Result};
use crate::frames::{Cam, Rig, Sheet};
use crate::record::{
    self, Covariance, FORMAT, Fit, PlacedCamera, Provenance, Record, RigSigma, Target, TargetSigma, VERSION,
};
use crate::rigid::{AxesAngle, Motion};
use crate::sheet::SheetEstimate;
use nalgebra::{Matrix3, Matrix6, Vector3};

/// The record of the cameras found; the first becomes the rig frame, the plane z = 0 the sheet.
pub(super) fn record(found: Found, files: &[NamedText]) -> Result<Conversion<Record>> {
    let Found { cameras, has_sheet, of_marks, mut notes, program } = found;
    refuse_alike(&cameras, files)?;
    let first = cameras.first().ok_or_else(|| Invalid::Contradiction("the file holds no camera".into()))?;
    let mut rig_from_world: Motion<Rig, Sheet> =
        Motion::new(first.cam_from_world.rotation, first.cam_from_world.translation_mm);
    if -rig_from_world.rotation.column(2).dot(&rig_from_world.translation_mm) < 0.0 {
        // The sheet's z faces the first camera; a world that looks the other way is turned half about x.
        rig_from_world.rotation *= Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        notes.push(
            "z of the file's world points away from the first camera; the sheet's frame is that world turned by half a \
             turn about x, so y and z (and v and w) change sign"
                .into(),
        );
    }
    let world_from_rig =
        Motion::<Rig, Sheet>::new(first.cam_from_world.rotation, first.cam_from_world.translation_mm).inverse();
    let cam_from_rig: Vec<Motion<Cam, Rig>> = cameras
        .iter()
        .enumerate()
        .map(|(i, c)| if i == 0 { Motion::identity() } else { c.cam_from_world * world_from_rig })
        .collect();
    let center = cam_from_rig.get(1).map(|m| m.inverse().translation_mm);
    let unknown = Matrix6::repeat(f64::NAN);
    let sheet = has_sheet.then(|| {
        // The frame is the file's, not the default one of a plane.
        SheetEstimate::from_plane(&rig_from_world, &Vector3::zeros(), &unknown, center).to_record(program, Vec::new())
    });
    let losses: Vec<Loss> = cameras.iter().map(|c| c.loss).collect();
    let result = Record {
        format: FORMAT.into(),
        version: VERSION,
        rig: cam_from_rig.get(1).map(rig),
        cameras: cameras.iter().zip(&cam_from_rig).map(|(c, pose)| camera(c, pose)).collect(),
        sheet,
        target: no_target(),
        scale: None,
        views: Vec::new(),
        fit: no_fit(program, &losses),
        mapping_uncertainty: None,
        provenance: Provenance {
            program: format!("spivcal {}", env!("CARGO_PKG_VERSION")),
            rig_file: names(files),
            ..Provenance::default()
        },
        covariance: Covariance::default(),
    };
    if let Some(what) = result.impossible() {
        return Err(refusal(
            files,
            format!("this is no possible calibration ({what}); correct the file, or write it anew"),
        ));
    }
    for c in cameras.iter().filter(|c| c.camera.intrinsics().radial == Radial::DistortedToIdeal) {
        notes.push(format!(
            "{}: the polynomial from distorted to ideal points follows its lens best (radial of calibration.json)",
            c.name
        ));
    }
    notes.push("the file holds no standard deviations: all of them are unknown (null)".into());
    Ok(if of_marks {
        Conversion { result, losses: vec![Loss::NONE; losses.len()], marks: losses, notes }
    } else {
        Conversion::of(result, losses, notes)
    })
}

/// Options fill in what a format does not say; what a file says itself they must not contradict.
pub(super) fn refuse_contradictions(found: &Found, options: &ImportOptions) -> Result<()> {
    for c in &found.cameras {
        let ([w, h], name) = (c.image_size_px, &c.name);
        if let Some([gw, gh]) = options.image_size_px.filter(|given| *given != c.image_size_px) {
            let what = format!(
                "the file says that images of camera \"{name}\" are {w} x {h} px, --image-size {gw}x{gh}; leave the option out, or correct one of them"
            );
            return Err(Invalid::Contradiction(what).into());
        }
        let pitches = c.pixel_pitch_mm.zip(options.pixel_pitch_mm).filter(|(a, b)| (a - b).abs() > 1e-6 * b.abs());
        if let Some((file, given)) = pitches {
            let what = format!(
                "the file says that pixels of camera \"{name}\" are {file} mm, --pixel-pitch-mm {given}; leave the option out, or correct one of them"
            );
            return Err(Invalid::Contradiction(what).into());
        }
    }
    Ok(())
}

fn refusal(files: &[NamedText], message: String) -> Error {
    Invalid::File { path: names(files), message }.into()
}

fn names(files: &[NamedText]) -> String {
    files.iter().map(|f| f.name.as_str()).collect::<Vec<_>>().join(", ")
}

/// Cameras must be told apart by their names.
fn refuse_alike(cameras: &[WorldCamera], files: &[NamedText]) -> Result<()> {
    for (i, c) in cameras.iter().enumerate() {
        if cameras[..i].iter().any(|other| other.name == c.name) {
            let message = format!(
                "two cameras are called \"{}\"; give each a name of its own (in the file, or in the names of the files)",
                c.name
            );
            return Err(refusal(files, message));
        }
    }
    Ok(())
}

fn camera(c: &WorldCamera, pose: &Motion<Cam, Rig>) -> record::Camera {
    let placed = PlacedCamera { camera: c.camera, cam_from_rig: *pose };
    record::Camera { rms_px: c.loss.rms_px, ..placed.to_record(&c.name, c.image_size_px, c.pixel_pitch_mm) }
}

fn rig(second: &Motion<Cam, Rig>) -> record::Rig {
    record::Rig {
        baseline_mm: second.translation_mm.norm(),
        axes_angle_deg: AxesAngle::of(&second.rotation).rad.to_degrees(),
        sigma: RigSigma { baseline_mm: f64::NAN, axes_angle_deg: f64::NAN },
    }
}

fn no_target() -> Target {
    Target {
        kind: "none".into(),
        radii_mm: Vec::new(),
        spacing_mm: f64::NAN,
        sigma: TargetSigma { radii_mm: Vec::new(), spacing_mm: f64::NAN, step_mm: None },
        adjust: "none".into(),
        step_mm: None,
        extent_mm: None,
        shift_rms_mm: None,
        ovality_mm: None,
        same_light: None,
        points: Vec::new(),
    }
}

fn no_fit(program: &str, losses: &[Loss]) -> Fit {
    let n = losses.len().max(1) as f64;
    Fit {
        rms_px: (losses.iter().map(|l| l.rms_px * l.rms_px).sum::<f64>() / n).sqrt(),
        chi2: 0.0,
        degrees_of_freedom: 0,
        redundancy: f64::NAN,
        observations: 0,
        iterations: 0,
        newton_decrement: f64::NAN,
        termination: format!("read from {program}"),
        nullity: 0,
        undetermined: Vec::new(),
        outliers: 0,
        converged: true,
        flags: Vec::new(),
        observation_model: String::new(),
        loss: String::new(),
        sigma_scale: 1.0,
        parameters: Vec::new(),
        near_null: Vec::new(),
        diagnosis: None,
    }
}
