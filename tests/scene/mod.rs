//! A made-up but consistent stereo calibration at the paper's geometry (1024x768, 6.25 um, 50 mm, 500 mm, 45 degrees),
//! shared by the tests of `record` and `report`. The projection is written out here, independent of the library.

#![allow(dead_code, unreachable_pub)]

pub mod pictures;

use nalgebra::{Matrix3, Vector3};
use spivcal::frames;
use spivcal::record::*;
use spivcal::rigid::{Motion, rotation_exp};
use std::collections::BTreeMap;

pub const VIEWS: usize = 6;

/// Camera of the scene: `(f_px, cx_px, cy_px, alpha_rad, beta_rad, k1)`.
pub struct Eye {
    pub name: &'static str,
    pub f_px: f64,
    pub axis_px: [f64; 2],
    pub tilt_rad: [f64; 2],
    pub k1: f64,
    pub cam_from_rig: Motion<(), frames::Rig>,
}

impl Eye {
    /// Method section 2, eqs 10-11.
    pub fn project(&self, p_in_rig: &Vector3<f64>) -> [f64; 2] {
        let p = self.cam_from_rig.apply(p_in_rig);
        let (x, y) = (p.x / p.z, p.y / p.z);
        let d = 1.0 + self.k1 * (x * x + y * y);
        let (x, y) = (x * d, y * d);
        let ([a, b], f) = (self.tilt_rad, self.f_px);
        let lambda = 1.0 / (1.0 - x * b.tan() - y * a.tan() / b.cos());
        let t = [lambda * (x / b.cos() + y * a.tan() * b.tan()), lambda * y / a.cos()];
        [self.axis_px[0] + f * t[0], self.axis_px[1] + f * t[1]]
    }
}

pub fn eyes() -> [Eye; 2] {
    let turn = rotation_exp(&Vector3::new(0.004, 90f64.to_radians(), -0.003));
    // The right camera looks at the same point, from the same side of the sheet.
    let aim = Vector3::new(0.0, 0.0, 500.0);
    let left = Eye {
        name: "left",
        f_px: 8889.313872,
        axis_px: [513.82, 381.44],
        tilt_rad: [0.0021, 0.1107],
        k1: -0.0832,
        cam_from_rig: Motion::identity(),
    };
    let right = Eye {
        name: "right",
        f_px: 8871.902118,
        axis_px: [509.17, 386.93],
        tilt_rad: [-0.0013, -0.1109],
        k1: -0.0795,
        cam_from_rig: Motion::new(turn, aim - turn * aim),
    };
    [left, right]
}

pub fn rig_from_sheet() -> Motion<frames::Rig, frames::Sheet> {
    let z = -Vector3::new(-0.7, 0.011, 0.7).normalize();
    let x = (Vector3::x() - z * z.x).normalize();
    Motion::new(Matrix3::from_columns(&[x, z.cross(&x), z]), Vector3::new(0.0, 0.0, 500.0))
}

pub fn rig_from_target(view: usize) -> Motion<frames::Rig, frames::Target> {
    let i = view as f64;
    let w = [[0.0, 0.0], [0.21, 0.05], [-0.19, 0.11], [0.08, -0.24], [-0.12, -0.17], [0.0, 0.0]][view % VIEWS];
    let sheet = rig_from_sheet();
    let tilt = rotation_exp(&Vector3::new(w[0], w[1], 0.35 * i));
    let shift =
        Vector3::new(3.0 * (i * 1.7).sin(), 2.0 * (i * 2.3).cos(), if view == 5 { 0.0 } else { 1.5 * (i - 2.0) });
    Motion::new(sheet.rotation * tilt, sheet.rotation * shift + sheet.translation_mm)
}

fn effective(e: &Eye) -> Effective {
    let [a, b] = e.tilt_rad;
    Effective {
        f_px: e.f_px * a.cos() * b.cos(),
        cx_px: e.axis_px[0] - e.f_px * b.sin(),
        cy_px: e.axis_px[1] - e.f_px * a.sin() * b.cos(),
    }
}

fn camera(e: &Eye, observations: usize, rms_px: f64) -> Camera {
    let first = e.name == "left";
    let pose = if first { [0.0; 3] } else { [1.0; 3] };
    Camera {
        name: e.name.into(),
        image_size_px: [1024, 768],
        f_px: e.f_px,
        aspect: 1.0,
        cx_px: e.axis_px[0],
        cy_px: e.axis_px[1],
        alpha_rad: e.tilt_rad[0],
        beta_rad: e.tilt_rad[1],
        k1: e.k1,
        k2: 0.0,
        k3: 0.0,
        radial: Radial::IdealToDistorted,
        pupil_ratio: 1.0,
        pixel_pitch_mm: Some(0.00625),
        effective: effective(e),
        sigma: CameraSigma {
            f_px: 21.73,
            aspect: 0.0,
            cx_px: 17.8,
            cy_px: 19.31,
            alpha_rad: 0.002_17,
            beta_rad: 0.001_98,
            k1: 0.0271,
            k2: 0.0,
            k3: 0.0,
            pupil_ratio: 0.0,
            effective: Effective { f_px: 7.31, cx_px: 6.02, cy_px: 5.43 },
            cam_from_rig: PoseSigma { rotation_rad: pose.map(|x| x * 2.2e-3), translation_mm: pose.map(|x| x * 0.61) },
        },
        cam_from_rig: Pose::from(&e.cam_from_rig),
        window: None,
        rms_px,
        edge_rms_px: Some(rms_px * 1.02),
        observations,
    }
}

fn sheet_sigma(scale: f64) -> SheetSigma {
    SheetSigma {
        distance_mm: 0.41 * scale,
        normal_rad: [0.0021 * scale, 0.0019 * scale],
        abc_per_mm: [6.1e-6 * scale, 7.3e-6 * scale, 5.8e-6 * scale],
        angles_deg: [0.12 * scale, 0.11 * scale, 0.09 * scale],
        angle_to_baseline_deg: 0.031 * scale,
    }
}

fn angles_deg(rotation: &Matrix3<f64>) -> [f64; 3] {
    // Rx(pi) makes z face the camera; what is left is Rx Ry Rz.
    let r = rotation * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    [(-r[(1, 2)]).atan2(r[(2, 2)]), r[(0, 2)].asin(), (-r[(0, 1)]).atan2(r[(0, 0)])].map(f64::to_degrees)
}

fn sheet(second_centre: &Vector3<f64>) -> Sheet {
    let pose = rig_from_sheet();
    let n = -pose.rotation.column(2).into_owned();
    let d = n.dot(&pose.translation_mm);
    let abc = n / d;
    let list = |v: Vector3<f64>| [v.x, v.y, v.z];
    Sheet {
        normal_in_rig: list(n),
        distance_mm: d,
        abc_per_mm: list(abc),
        angles_deg: angles_deg(&pose.rotation),
        angles_convention: ANGLES_CONVENTION.into(),
        angle_to_baseline_deg: n.dot(&second_centre.normalize()).asin().to_degrees(),
        sigma: sheet_sigma(1.0),
        rig_from_sheet: Pose::from(&pose),
        method: "joint".into(),
        views: vec![5],
        disparity_rms_px: Some(0.0214),
        homography: Some(Homography {
            abc_per_mm: list(abc * 1.0004),
            distance_mm: d / 1.0004,
            angles_deg: angles_deg(&pose.rotation).map(|x| x + 0.04),
            angle_to_baseline_deg: 0.6411,
            sigma: sheet_sigma(1.3),
            transfer_rms_px: 0.0312,
        }),
    }
}

fn view(i: usize) -> View {
    let map = |l: f64, r: f64| BTreeMap::from([("left".to_string(), l), ("right".to_string(), r)]);
    let count = |n: usize| BTreeMap::from([("left".to_string(), n), ("right".to_string(), n + 7)]);
    let mut view = View {
        index: i,
        in_sheet: i == 5,
        rig_from_target: Some(Pose::from(&rig_from_target(i))),
        rms_px: map(0.021 + 0.002 * i as f64, 0.024 + 0.0013 * (i % 3) as f64),
        used: true,
        why_unused: String::new(),
        observations: count(1180 + 13 * i),
        outliers: BTreeMap::new(),
        images: BTreeMap::from([
            ("left".into(), format!("v{}_left.png", i + 1)),
            ("right".into(), format!("v{}_right.png", i + 1)),
        ]),
        sigma: PoseSigma { rotation_rad: [3.1e-4, 3.3e-4, 1.2e-4], translation_mm: [0.012, 0.011, 0.34] },
        planarity_mm: None,
        plane_z_mm: None,
        plane_z_sigma_mm: None,
        target: None,
    };
    if i == 3 {
        view.outliers = BTreeMap::from([("right".to_string(), 4)]);
        view.rms_px = map(0.029, 0.071);
    }
    view
}

fn covariance() -> Covariance {
    let quantities = ["f_px", "cx_px", "cy_px", "alpha_rad", "beta_rad", "k1"];
    let sigmas = [21.73, 17.8, 19.31, 0.002_17, 0.001_98, 0.0271];
    let names = ["left", "right"].iter().flat_map(|c| quantities.map(|q| format!("{c}.{q}"))).collect::<Vec<_>>();
    let n = names.len();
    let couple = |i: usize, j: usize| match (i.min(j) % 6, i.max(j) % 6) {
        _ if i == j => 1.0,
        _ if i / 6 != j / 6 => 0.05,
        (1, 4) => 0.994,
        (2, 3) => -0.991,
        (0, 5) => 0.31,
        _ => 0.1,
    };
    let matrix = (0..n).map(|i| (0..n).map(|j| couple(i, j) * sigmas[i % 6] * sigmas[j % 6]).collect()).collect();
    Covariance { names, matrix, ..Covariance::default() }
}

fn parameters() -> Vec<Parameter> {
    let mut list = Vec::new();
    for camera in ["left", "right"] {
        for (q, known, prior_share) in [
            ("f_px", Known::Prior, 0.06),
            ("cx_px", Known::Prior, 0.79),
            ("cy_px", Known::Prior, 0.93),
            ("alpha_rad", Known::Prior, 0.97),
            ("beta_rad", Known::Free, 0.0),
            ("k1", Known::Free, 0.0),
            ("k2", Known::Fixed, 0.0),
            ("k3", Known::Fixed, 0.0),
            ("aspect", Known::Fixed, 0.0),
            ("pupil_ratio", Known::Fixed, 0.0),
        ] {
            list.push(Parameter { name: format!("{camera}.{q}"), known, prior_share });
        }
    }
    list
}

fn fit() -> Fit {
    Fit {
        rms_px: 0.0267,
        chi2: 14_911.4,
        degrees_of_freedom: 14_583,
        redundancy: 0.9957,
        observations: 14_646,
        iterations: 11,
        newton_decrement: 3.1e-8,
        termination: "newton decrement".into(),
        nullity: 0,
        undetermined: vec!["tilt alpha of the right camera is known only from its prior".into()],
        outliers: 4,
        converged: true,
        flags: vec!["view 3, camera right: 4 outliers left out".into()],
        observation_model: "contour".into(),
        loss: "huber".into(),
        sigma_scale: 1.0,
        parameters: parameters(),
        near_null: vec![NearNull {
            words: "tilt beta of the left camera moves together with its axis point cx".into(),
            names: vec!["left.beta_rad".into(), "left.cx_px".into()],
            components: vec![0.71, 0.70],
            sigma: 18.2,
        }],
        diagnosis: None,
    }
}

/// The whole record.
pub fn record() -> Record {
    let [left, right] = eyes();
    let images = (0..VIEWS).flat_map(|view| {
        ["left", "right"].map(|camera| ImageFile {
            path: format!("v{}_{camera}.png", view + 1),
            view,
            camera: camera.into(),
            sha256: None,
            saturated: 0.0,
            cut_at_zero: 0.0,
        })
    });
    let provenance = Provenance {
        program: "spivcal 0.1.0".into(),
        rig_file: "examples/bubbles/rig.toml".into(),
        options: BTreeMap::from([("observations".into(), "contour".into()), ("loss".into(), "huber".into())]),
        images: images.collect(),
    };
    let centre = right.cam_from_rig.inverse().translation_mm;
    Record {
        format: FORMAT.into(),
        version: VERSION,
        cameras: vec![camera(&left, 7310, 0.0241), camera(&right, 7336, 0.0293)],
        rig: Some(Rig {
            baseline_mm: centre.norm(),
            axes_angle_deg: right.cam_from_rig.rotation.m33.acos().to_degrees(),
            sigma: RigSigma { baseline_mm: 0.57, axes_angle_deg: 0.021 },
        }),
        sheet: Some(sheet(&centre)),
        target: Target {
            kind: "two-discs".into(),
            radii_mm: vec![12.504_31, 9.998_12],
            spacing_mm: 26.0,
            sigma: TargetSigma { radii_mm: vec![0.0021, 0.0019], spacing_mm: 0.0, step_mm: None },
            adjust: "shape".into(),
            step_mm: None,
            extent_mm: Some([-25.5, -12.5, 23.0, 12.5]),
            shift_rms_mm: None,
            ovality_mm: None,
            same_light: None,
            points: Vec::new(),
        },
        scale: Some(Scale { fact: "spacing".into(), value_mm: 26.0, sigma_mm: 0.0 }),
        views: (0..VIEWS).map(view).collect(),
        fit: fit(),
        mapping_uncertainty: None,
        provenance,
        covariance: covariance(),
    }
}

/// What is felt in the sheet, every number another one; the views tell all but two of it.
pub fn mapping(beyond_noise: bool) -> MappingUncertainty {
    let sigma = MappingSigma {
        point_mm: [0.5, -0.25],
        in_plane_px: 0.11,
        in_plane_mm: 0.012,
        disparity_px: 0.13,
        in_plane_scale: 0.0014,
        out_of_plane_gain: 0.0015,
        displacement: vec![vec![0.001, 0.002, 0.004], vec![0.002, 0.001, 0.003], vec![0.0005, 0.0006, 0.0016]],
    };
    let by_views = MappingByViews {
        beyond_noise,
        disparity: f64::NAN,
        in_plane: 2.1,
        in_plane_scale: 0.8,
        out_of_plane_gain: 2.3,
        displacement: vec![vec![3.1, 3.2, 3.3], vec![1.4, f64::NAN, 1.5], vec![0.4, 0.5, 2.6]],
    };
    let list = vec![0.001, 0.002, 0.003, 0.004];
    let map = MappingMap {
        spacing_mm: [1.0, 1.0],
        x_mm: vec![0.0, 1.0, 0.0, 1.0],
        y_mm: vec![0.0, 0.0, -1.0, -1.0],
        in_plane_px: list.clone(),
        disparity_px: list.clone(),
        u_per_u: list.clone(),
        w_per_w: list.clone(),
        u_per_w: list.clone(),
        v_per_w: list.clone(),
        w_per_u: list.clone(),
        v_per_v: list.clone(),
        w_per_v: list.clone(),
        u_per_v: list.clone(),
        v_per_u: list,
    };
    MappingUncertainty {
        middle: sigma.clone(),
        largest: sigma,
        map,
        undetermined: vec![],
        by_views: Some(by_views),
        by_likelihood: None,
    }
}
