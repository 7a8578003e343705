//! The adjustment as a record.

use super::calibrate::Solved;
use super::nominal::contradictions;
use super::residual_rows::ImageFit;
use super::sheet_part::of_frame;
use crate::bundle::{Fact, Observed, ParameterKnowledge, TargetShape, Termination};
use crate::camera::{Camera, INTRINSIC_NAMES, WINDOW_STEP_NAMES, Window};
use crate::diagnosis::Findings;
use crate::error::{Error, Result};
use crate::record::{
    self, CameraSigma, Covariance, Effective, Fit, Known, Parameter, PlacedCamera, Pose, PoseSigma, Provenance, Record,
    Rig, RigSigma, SameLight, Scale, Sheet, Target, TargetPoint, TargetSigma, View, ViewTarget, WHOLE_DISCS,
    WindowSigma,
};
use crate::rig_file::{Adjust, Length, Loss, Observations, Scale as ScaleFact, ViewDescription};
use crate::rigid::AxesAngle;
use crate::target::TargetKind;
use std::collections::BTreeMap;

/// Part of all discs that may be outliers before the result is flagged.
const OUTLIER_LIMIT: f64 = 0.05;

/// Everything but the sheet, and the sheet.
pub(super) fn record(s: &Solved, fits: &[ImageFit], findings: &Findings, sheet: Option<Sheet>) -> Result<Record> {
    let cameras: Vec<record::Camera> = (0..s.job.cameras.len())
        .map(|c| camera(s, fits, c))
        .collect::<Option<_>>()
        .ok_or_else(|| Error::Bug("a camera has no image".into()))?;
    Ok(Record {
        format: record::FORMAT.into(),
        version: record::VERSION,
        rig: rig(s),
        cameras,
        covariance: match &sheet {
            Some(sheet) => of_frame(s, covariance(s), &sheet.rig_from_sheet.motion()),
            None => covariance(s),
        },
        sheet,
        target: target(s),
        scale: Some(scale(s)),
        views: (0..s.job.views.len()).map(|v| view(s, fits, v)).collect(),
        fit: fit(s, fits, findings),
        mapping_uncertainty: findings.mapping.clone(),
        provenance: provenance(s),
    })
}

fn covariance(s: &Solved) -> Covariance {
    let c = &s.covariance;
    let lost = c.names.iter().zip(&c.determined).filter(|(_, known)| !**known);
    Covariance {
        names: c.names.clone(),
        matrix: c.matrix.row_iter().map(|r| r.iter().copied().collect()).collect(),
        undetermined: lost.map(|(name, _)| name.clone()).collect(),
        null_directions: c.null_directions.column_iter().map(|d| d.iter().copied().collect()).collect(),
    }
}

/// Sigma of a named parameter; 0 where held, `NaN` where undetermined.
fn sigma(s: &Solved, name: &str) -> f64 {
    s.covariance.sigma(name).unwrap_or(f64::NAN)
}

fn total<'a>(fits: impl Iterator<Item = &'a ImageFit>) -> ImageFit {
    fits.fold(ImageFit::default(), |a, b| a.plus(b))
}

fn camera(s: &Solved, fits: &[ImageFit], c: usize) -> Option<record::Camera> {
    let description = &s.job.cameras[c];
    let first = s.images.iter().find(|i| i.camera == c)?;
    let own = total(s.images.iter().zip(fits).filter(|(i, _)| i.camera == c).map(|(_, f)| f));
    let camera = &s.covariance.natural.cameras[c];
    let size = [first.image.width(), first.image.height()];
    let placed = PlacedCamera { camera: *camera, cam_from_rig: s.covariance.natural.cam_from_rig[c] };
    let of = |k: usize| sigma(s, &format!("{}.{}", description.name, INTRINSIC_NAMES[k]));
    Some(record::Camera {
        sigma: CameraSigma {
            f_px: of(0),
            aspect: of(1),
            cx_px: of(2),
            cy_px: of(3),
            alpha_rad: of(4),
            beta_rad: of(5),
            k1: of(6),
            k2: of(7),
            k3: of(8),
            pupil_ratio: of(9),
            effective: effective_sigma(s, &description.name, camera),
            cam_from_rig: if c == 0 { still() } else { pose_sigma(s, &format!("{}.cam_from_rig", description.name)) },
        },
        window: camera.window().map(|w| window(s, &description.name, w)),
        rms_px: own.rms_px(),
        edge_rms_px: Some(own.edge_rms_px()),
        observations: own.edges,
        ..placed.to_record(&description.name, size, description.pixel_pitch_mm)
    })
}

fn window(s: &Solved, name: &str, window: &Window) -> record::Window {
    let of = |k: usize| sigma(s, &format!("{name}.window.{}", WINDOW_STEP_NAMES[k]));
    let [distance_mm, thickness_mm, n_air, n_glass, n_water] = window.layers();
    record::Window {
        normal_in_cam: (*window.normal()).into(),
        distance_mm,
        thickness_mm,
        n_air,
        n_glass,
        n_water,
        sigma: WindowSigma {
            normal_rad: [of(0), of(1), of(2)],
            distance_mm: of(3),
            thickness_mm: of(4),
            n_air: of(5),
            n_glass: of(6),
            n_water: of(7),
        },
    }
}

fn still() -> PoseSigma {
    PoseSigma { rotation_rad: [0.0; 3], translation_mm: [0.0; 3] }
}

fn pose_sigma(s: &Solved, name: &str) -> PoseSigma {
    let of = |step: &str| sigma(s, &format!("{name}.{step}"));
    PoseSigma {
        rotation_rad: ["rx_rad", "ry_rad", "rz_rad"].map(of),
        translation_mm: ["tx_mm", "ty_mm", "tz_mm"].map(of),
    }
}

/// Sigmas of the effective pinhole.
fn effective_sigma(s: &Solved, name: &str, camera: &Camera) -> Effective {
    let by = camera.effective_pinhole_by_intrinsics();
    let row = |q: usize| -> Vec<(String, f64)> {
        let terms = INTRINSIC_NAMES.iter().zip(by.row(q)).filter(|(_, d)| **d != 0.0);
        terms.map(|(n, d)| (format!("{name}.{n}"), *d)).collect()
    };
    let sigmas = s.covariance.sigmas(&[row(0), row(1), row(2)]);
    Effective { f_px: sigmas[0], cx_px: sigmas[1], cy_px: sigmas[2] }
}

fn rig(s: &Solved) -> Option<Rig> {
    let motion = s.covariance.natural.cam_from_rig.get(1)?;
    let name = &s.job.cameras[1].name;
    let t = motion.translation_mm;
    let b = t.normalize();
    let axes = AxesAngle::of(&motion.rotation);
    let [by_rx, by_ry] = axes.by_left_turn();
    let step = |k: &str| format!("{name}.cam_from_rig.{k}");
    let rows = [
        vec![(step("tx_mm"), b.x), (step("ty_mm"), b.y), (step("tz_mm"), b.z)],
        vec![(step("rx_rad"), by_rx), (step("ry_rad"), by_ry)],
    ];
    let sigmas = s.covariance.sigmas(&rows);
    Some(Rig {
        baseline_mm: t.norm(),
        axes_angle_deg: axes.rad.to_degrees(),
        sigma: RigSigma { baseline_mm: sigmas[0], axes_angle_deg: sigmas[1].to_degrees() },
    })
}

fn target(s: &Solved) -> Target {
    let model = &s.adjustment.model.target;
    let state = &s.adjustment.state;
    let shape = state.shape_mm;
    let per_view = model.per_view();
    let pair = matches!(model.shape, TargetShape::Pair { .. });
    let kind = s.job.target.target.kind();
    let (radii_mm, radii_sigma) = match (per_view, pair) {
        (true, _) => (vec![], vec![]),
        (false, true) => (vec![shape[1], shape[2]], vec![sigma(s, "target.radius0_mm"), sigma(s, "target.radius1_mm")]),
        (false, false) => (vec![shape[1]], vec![sigma(s, "target.radius_mm")]),
    };
    let plate = kind == TargetKind::TwoLevelPlate;
    let discs: Vec<_> = (0..model.disc_count()).map(|j| (j, model.nominal_disc(j, &shape).0)).collect();
    let mut extent = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for (_, p) in &discs {
        extent = [extent[0].min(p.x), extent[1].min(p.y), extent[2].max(p.x), extent[3].max(p.y)];
    }
    let moved = |j: usize| state.offsets_mm.get(j).copied();
    let points: Vec<TargetPoint> = discs
        .iter()
        .filter_map(|(j, p)| {
            let (o, sig) = (moved(*j)?, s.covariance.disc_sigmas_mm.get(*j)?);
            let xyz_mm = [p.x + o[0], p.y + o[1], p.z + o[2]];
            Some(TargetPoint { label: s.built.labels[*j], xyz_mm, sigma_mm: [sig[0], sig[1], sig[2]] })
        })
        .collect();
    let shift: f64 = state.offsets_mm.iter().map(|o| o[0] * o[0] + o[1] * o[1] + o[2] * o[2]).sum();
    Target {
        kind: kind.word().into(),
        radii_mm,
        spacing_mm: if per_view { f64::NAN } else { shape[0] },
        sigma: TargetSigma {
            radii_mm: radii_sigma,
            spacing_mm: if per_view { f64::NAN } else { sigma(s, "target.spacing_mm") },
            step_mm: plate.then(|| sigma(s, "target.step_mm")),
        },
        adjust: match s.job.target.adjust {
            Adjust::None => "none",
            Adjust::Shape => "shape",
            Adjust::Points => "points",
        }
        .into(),
        step_mm: plate.then_some(shape[2]),
        extent_mm: (!per_view).then_some(extent),
        ovality_mm: s.adjustment.ovality_mm,
        same_light: s.adjustment.same_light.map(|a| SameLight { correlation: a.correlation, variance: a.variance }),
        shift_rms_mm: (!points.is_empty()).then(|| (shift / points.len() as f64).sqrt()),
        points,
    }
}

fn scale(s: &Solved) -> Scale {
    let of =
        |fact: &str, l: Length| Scale { fact: fact.into(), value_mm: l.value_mm, sigma_mm: l.sigma_mm.unwrap_or(0.0) };
    match s.job.scale {
        ScaleFact::TargetSpacing(l) | ScaleFact::ViewSpacing { spacing: l, .. } => of("spacing", l),
        ScaleFact::TargetRadius { radius: l, .. } | ScaleFact::ViewRadius { radius: l, .. } => of("radius", l),
        ScaleFact::Baseline(l) => of("baseline", l),
        ScaleFact::Traverse { sigma_mm } => {
            let z: Vec<f64> = s.job.views.iter().filter_map(ViewDescription::position_mm).collect();
            let range =
                z.iter().copied().fold(f64::NEG_INFINITY, f64::max) - z.iter().copied().fold(f64::INFINITY, f64::min);
            of("traverse", Length { value_mm: range, sigma_mm })
        }
    }
}

fn view(s: &Solved, fits: &[ImageFit], v: usize) -> View {
    let description = &s.job.views[v];
    let mut out = View {
        index: v,
        in_sheet: description.sheet,
        rig_from_target: Some(Pose::from(&s.covariance.natural.rig_from_target[v])),
        rms_px: BTreeMap::new(),
        used: true,
        why_unused: String::new(),
        observations: BTreeMap::new(),
        outliers: BTreeMap::new(),
        images: BTreeMap::new(),
        sigma: pose_sigma(s, &format!("view{v}.rig_from_target")),
        planarity_mm: None,
        plane_z_mm: None,
        plane_z_sigma_mm: None,
        target: None,
    };
    for (image, fit) in s.images.iter().zip(fits).filter(|(i, _)| i.view == v) {
        let name = s.job.cameras[image.camera].name.clone();
        out.rms_px.insert(name.clone(), fit.rms_px());
        out.observations.insert(name.clone(), fit.edges);
        out.outliers.insert(name.clone(), fit.outliers);
        out.images.insert(name, image.name.clone());
    }
    if s.adjustment.model.views[v].place.moves_along_normal() {
        out.plane_z_mm = s.adjustment.state.views[v].plane_from_target.map(|p| p.translation_mm.z);
        out.plane_z_sigma_mm = s.covariance.sigma(&format!("view{v}.plane_z_mm"));
    }
    if s.adjustment.model.target.per_view() {
        let [spacing_mm, r0, r1] = s.adjustment.state.views[v].shape_mm;
        let of = |what: &str| sigma(s, &format!("view{v}.{what}"));
        out.target = Some(ViewTarget {
            radii_mm: vec![r0, r1],
            spacing_mm,
            sigma: TargetSigma {
                radii_mm: vec![of("radius0_mm"), of("radius1_mm")],
                spacing_mm: of("spacing_mm"),
                step_mm: None,
            },
        });
    }
    out
}

fn fit(s: &Solved, fits: &[ImageFit], findings: &Findings) -> Fit {
    let Observed { observations, facts, unknowns } = s.adjustment.model.counts();
    let all = total(fits.iter());
    let degrees_of_freedom = (observations + facts).saturating_sub(unknowns);
    let adjustment = s.adjustment;
    let mut flags = vec![];
    let shared = s.covariance.shared_nullity();
    if shared > 0 {
        flags.push(format!(
            "{shared} direction(s) of the calibration are determined by nothing; see what is not determined"
        ));
    }
    let outliers = adjustment.outliers.len();
    if outliers as f64 > OUTLIER_LIMIT * (all.discs + outliers) as f64 {
        flags.push(format!("{outliers} of {} discs lie off the target; look at the overlays", all.discs + outliers));
    }
    if adjustment.termination != Termination::Converged {
        flags.push(format!(
            "the adjustment ended early ({}) at a Newton decrement of {:.1e}",
            adjustment.termination.word(),
            adjustment.decrement
        ));
    }
    flags.extend(contradictions(s));
    flags.extend(findings.flags.iter().cloned());
    flags.extend(s.undecided.iter().cloned());
    flags.extend(s.images.iter().flat_map(|i| i.warnings.iter().map(|w| format!("{}: {w}", i.name))));
    let scales = adjustment.model.images.iter().map(|i| i.sigma_scale);
    let mut fit = Fit {
        rms_px: all.rms_px(),
        chi2: 2.0 * adjustment.cost,
        degrees_of_freedom,
        redundancy: degrees_of_freedom as f64 / observations.max(1) as f64,
        observations,
        iterations: adjustment.iterations,
        newton_decrement: adjustment.decrement,
        termination: adjustment.termination.word().into(),
        nullity: s.covariance.nullity,
        undetermined: s.covariance.undetermined.clone(),
        outliers,
        converged: adjustment.termination == Termination::Converged,
        flags,
        observation_model: match s.job.solve.observations {
            Observations::Contour => "contour",
            Observations::Bitangent => "bitangent",
        }
        .into(),
        loss: match s.job.solve.loss {
            Loss::None => "none",
            Loss::Huber => "huber",
            Loss::Cauchy => "cauchy",
        }
        .into(),
        sigma_scale: scales.fold(1.0, f64::max),
        parameters: parameters(s),
        near_null: findings.near_null.clone(),
        diagnosis: Some(findings.diagnosis.clone()),
    };
    if fit.scattered() && !findings.enlarged_for_views {
        fit.flags.insert(
            0,
            format!(
                "{WHOLE_DISCS} up to {:.0} times further off than noise explains, {:.3} px (rms): a camera or the target moved between or within views, the target \
                 is not as stated (adjust = \"points\" where its dots lie elsewhere), or an image is of something else",
                fit.sigma_scale, fit.rms_px
            ),
        );
    }
    fit
}

fn parameters(s: &Solved) -> Vec<Parameter> {
    let mut out = vec![];
    for (c, camera) in s.job.cameras.iter().enumerate() {
        for (k, knowledge) in s.covariance.intrinsics[c].iter().enumerate() {
            let has_prior = s
                .adjustment
                .model
                .facts
                .iter()
                .any(|f| matches!(f, Fact::Intrinsic { camera, parameter, .. } if *camera == c && *parameter == k));
            let (known, prior_share) = match knowledge {
                ParameterKnowledge::Fixed => (Known::Fixed, 0.0),
                ParameterKnowledge::Undetermined => (Known::Free, f64::NAN),
                ParameterKnowledge::Estimated { prior_share } => {
                    (if has_prior { Known::Prior } else { Known::Free }, *prior_share)
                }
            };
            out.push(Parameter { name: format!("{}.{}", camera.name, INTRINSIC_NAMES[k]), known, prior_share });
        }
    }
    out
}

fn provenance(s: &Solved) -> Provenance {
    Provenance {
        program: format!("spivcal {}", env!("CARGO_PKG_VERSION")),
        rig_file: s.job.file.clone(),
        options: BTreeMap::new(),
        images: s.images.iter().map(|i| i.file(s.job)).collect(),
    }
}
