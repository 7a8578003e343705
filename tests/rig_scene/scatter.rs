//! Sampled against predicted scatter of a reference problem.
//!
//! ```text
//! z        = (estimate - truth) / bound       bound: the sigma predicted at the truth from exact contours (Cramer-Rao)
//! ratio    = sqrt(mean z^2)                   1 for an efficient estimator with true sigmas
//! nees     = e^T C^-1 e / 8                   e: errors of f_e, cx_e, cy_e, k1 of both cameras; C at the truth, or at the estimate
//! ```
//!
//! Bands. A right library fails a test by chance, for the seeds it happens to have; how often is stated here for all Monte-Carlo tests:
//!
//! | comparison | band | right libraries it refuses |
//! |---|---|---|
//! | a squared error of eight camera numbers | 95 %, as promised | 1 in 20 |
//! | one quantity among few | 99.5 % | 1 in 200 |
//! | one quantity among all of a table | [`together`] | all of them together 1 in 20 |
//!
//! A comparison that falls outside for its seeds is repeated with more runs, which makes its band narrower; it is never given a wider one.

use super::{Draw, Parts, Problem, Scene};
use nalgebra::{DMatrix, DVector, Vector3};
use spivcal::bundle::{AdjustOptions, Adjustment, NamedCovariance, Termination, adjust, named_covariance};
use spivcal::camera::Camera;
use spivcal::frames::{Rig, Sheet};
use spivcal::rigid::{Motion, rotation_exp};
use spivcal::sheet::{SheetUncertainty, StereoSheet, joint_sheet};

pub(crate) const NAMES: [&str; 2] = ["left", "right"];

/// What is compared.
pub(crate) const QUANTITIES: [&str; 11] = [
    "left effective f, px",
    "left effective cx, px",
    "left effective cy, px",
    "left k1",
    "right effective f, px",
    "right effective cx, px",
    "right effective cy, px",
    "right k1",
    "sheet to baseline, rad",
    "sheet distance, mm",
    "out-of-plane gain",
];

/// Where disparities are looked at, mm in the sheet.
const GRID_X_MM: [f64; 5] = [-20.0, -10.0, 0.0, 10.0, 20.0];
const GRID_Y_MM: [f64; 3] = [-10.0, 0.0, 10.0];

/// Standard normal quantiles of 0.975 and 0.9975.
pub(crate) const TWO_SIDED_95: f64 = 1.959964;
pub(crate) const TWO_SIDED_995: f64 = 2.807034;

/// Two-sided normal quantile with which `comparisons` together refuse a right library once in 20 times (Bonferroni).
pub(crate) fn together(comparisons: usize) -> f64 {
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..80 {
        let middle: f64 = 0.5 * (low + high);
        if spivcal::stats::normal_beyond(middle) * comparisons as f64 > 0.05 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Band of a chi-square over its degrees of freedom (Wilson and Hilferty).
pub(crate) fn band(degrees: f64, quantile: f64) -> [f64; 2] {
    let w = 2.0 / (9.0 * degrees);
    [-quantile, quantile].map(|q| (1.0 - w + q * w.sqrt()).powi(3))
}

/// Keeps the given sigmas: the contours' noise is what it says.
pub(crate) fn given_sigmas() -> AdjustOptions {
    AdjustOptions { rounds: 0, ..AdjustOptions::default() }
}

pub(crate) fn camera_numbers(camera: &Camera) -> [f64; 4] {
    let e = camera.effective_pinhole();
    [e.f_px, e.cx_px, e.cy_px, camera.intrinsics().k[0]]
}

/// The same as linear functions of the named parameters: `f_e = f cos a cos b`, `cx_e = cx - f sin b`,
/// `cy_e = cy - aspect f sin a cos b`.
fn camera_rows(name: &str, camera: &Camera) -> Vec<Vec<(String, f64)>> {
    let i = camera.intrinsics();
    let ((sa, ca), (sb, cb)) = (i.alpha_rad.sin_cos(), i.beta_rad.sin_cos());
    let row = |terms: &[(&str, f64)]| terms.iter().map(|(p, v)| (format!("{name}.{p}"), *v)).collect();
    let (f, fa) = (i.f_px, i.f_px * i.aspect);
    vec![
        row(&[("f_px", ca * cb), ("alpha_rad", -f * sa * cb), ("beta_rad", -f * ca * sb)]),
        row(&[("cx_px", 1.0), ("f_px", -sb), ("beta_rad", -f * cb)]),
        row(&[("cy_px", 1.0), ("f_px", -i.aspect * sa * cb), ("alpha_rad", -fa * ca * cb), ("beta_rad", fa * sa * sb)]),
        row(&[("k1", 1.0)]),
    ]
}

/// Covariance of the eight camera numbers.
pub(crate) fn camera_covariance(covariance: &NamedCovariance) -> DMatrix<f64> {
    let cameras = covariance.natural.cameras.iter().zip(NAMES);
    covariance.propagate(&cameras.flat_map(|(c, n)| camera_rows(n, c)).collect::<Vec<_>>())
}

/// `e^T C^-1 e / 8`, in correlation form: f and k1 differ by ten powers of ten in variance.
pub(crate) fn nees(e: &[f64], covariance: &DMatrix<f64>) -> f64 {
    let sigma = covariance.diagonal().map(f64::sqrt);
    let z = DVector::from_column_slice(e).component_div(&sigma);
    let correlation = DMatrix::from_fn(8, 8, |i, j| covariance[(i, j)] / (sigma[i] * sigma[j]));
    z.dot(&correlation.cholesky().expect("a covariance").solve(&z)) / 8.0
}

/// Angle to the baseline (signed, unlike the reported one: it may be zero in truth) and distance of the sheet.
fn sheet_numbers(stereo: &StereoSheet, second_center_mm: Vector3<f64>) -> [f64; 2] {
    let plane = stereo.rig_from_sheet();
    let n: Vector3<f64> = -plane.rotation.column(2).into_owned();
    [n.dot(&second_center_mm.normalize()).asin(), n.dot(&plane.translation_mm)]
}

pub(crate) fn true_stereo(parts: &Parts) -> StereoSheet {
    let plane = parts.rig_from_sheet.expect("a sheet");
    StereoSheet::new([parts.cameras[0], parts.cameras[1]], parts.cam_from_rig, &plane)
}

/// Disparities over the sheet, px.
pub(crate) fn disparities(s: &StereoSheet, truth: &StereoSheet) -> DVector<f64> {
    let all: Vec<f64> = grid()
        .flat_map(|p| s.response(truth, p).expect("seen").disparity_px.iter().copied().collect::<Vec<_>>())
        .collect();
    DVector::from_vec(all)
}

/// A plane turned about its own axes (rad) and shifted along its normal (mm).
pub(crate) fn moved(plane: &Motion<Rig, Sheet>, by: [f64; 3]) -> Motion<Rig, Sheet> {
    *plane * Motion::new(rotation_exp(&Vector3::new(by[0], by[1], 0.0)), Vector3::new(0.0, 0.0, by[2]))
}

/// The plane whose disparities are least, by Gauss-Newton steps of its three numbers: what a disparity check finds from images without
/// noise.
fn refitted(
    start: &Motion<Rig, Sheet>,
    with: &dyn Fn(&Motion<Rig, Sheet>) -> StereoSheet,
    truth: &StereoSheet,
) -> Motion<Rig, Sheet> {
    let mut plane = *start;
    for _ in 0..2 {
        let here = disparities(&with(&plane), truth);
        let mut slopes = DMatrix::zeros(here.len(), 3);
        for (k, h) in [1e-5, 1e-5, 1e-3].into_iter().enumerate() {
            let mut by = [0.0; 3];
            by[k] = h;
            slopes.set_column(k, &((disparities(&with(&moved(&plane, by)), truth) - &here) / h));
        }
        let step = slopes.tr_mul(&slopes).try_inverse().expect("a plane") * slopes.tr_mul(&here);
        plane = moved(&plane, [-step[0], -step[1], -step[2]]);
    }
    plane
}

pub(crate) fn grid() -> impl Iterator<Item = [f64; 2]> {
    GRID_X_MM.into_iter().flat_map(|x| GRID_Y_MM.into_iter().map(move |y| [x, y]))
}

/// What is predicted at the truth.
pub(crate) struct Bound {
    /// In the order of [`QUANTITIES`]; `None` where nothing determines it.
    pub(crate) sigmas: Vec<Option<f64>>,
    pub(crate) covariance: NamedCovariance,
    cameras: DMatrix<f64>,
    /// Root mean square over the sheet, px; `None` as above.
    pub(crate) disparity_px: Option<f64>,
    /// The same after the plane has been found anew from particle images.
    pub(crate) refitted_px: Option<f64>,
}

impl Bound {
    pub(crate) fn of(problem: &Problem) -> Self {
        let scene = problem.parts.scene();
        let out = adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true);
        assert!(out.cost < 1e-9, "{}: the truth is the minimum on exact contours, cost {}", problem.name, out.cost);
        let covariance = named_covariance(&out).expect("a covariance");
        let cameras = camera_covariance(&covariance);
        let plane = covariance.natural.rig_from_plane.expect("a sheet");
        let sheet = joint_sheet(&covariance, &plane, Some("right"));
        let sheet_points = SheetUncertainty::of(&covariance, NAMES).expect("two cameras and a sheet");
        let rows = covariance.natural.cameras.iter().zip(NAMES).flat_map(|(c, n)| camera_rows(n, c));
        let mut sigmas: Vec<Option<f64>> =
            rows.enumerate().map(|(k, row)| covariance.is_determined(&row).then(|| cameras[(k, k)].sqrt())).collect();
        sigmas.extend([sheet.sigmas[9], sheet.sigmas[0]].map(|s| s.is_finite().then_some(s)));
        sigmas.push(sheet_points.at([0.0, 0.0]).expect("seen").relative_gain());
        let all: Option<Vec<f64>> = grid().map(|p| sheet_points.at(p).expect("seen").disparity_px()).collect();
        let disparity_px = all.map(|d| (d.iter().map(|d| d * d).sum::<f64>() / d.len() as f64).sqrt());
        let refitted_px = sheet_points.disparity_after_refit_px(&grid().collect::<Vec<_>>());
        Self { sigmas, covariance, cameras, disparity_px, refitted_px }
    }
}

/// One measurement in units of the bound.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Run {
    pub(crate) seed: u64,
    /// The start led into another minimum than the truth did; what follows is then of the better one.
    pub(crate) wrong_start: bool,
    /// In the order of [`QUANTITIES`].
    pub(crate) z: Vec<f64>,
    pub(crate) nees_at_truth: f64,
    pub(crate) nees_at_estimate: f64,
    /// Mean square disparity over the sheet, px^2.
    pub(crate) disparity_px2: f64,
    /// The same with the plane that fits the true images of the sheet best.
    pub(crate) refitted_px2: f64,
}

pub(crate) fn solved(scene: &Scene, seed: u64) -> (Adjustment, bool) {
    let options = given_sigmas();
    let out = adjust(&scene.model, scene.perturbed_by(seed, 0.3), &options, &mut |_| true);
    let near = adjust(&scene.model, scene.truth.clone(), &options, &mut |_| true);
    let worse = out.termination != Termination::Converged || out.cost > near.cost * (1.0 + 1e-6);
    let best = if worse { near } else { out };
    assert_eq!(best.termination, Termination::Converged, "seed {seed}: decrement {}", best.decrement);
    (best, worse)
}

impl Run {
    pub(crate) fn of(problem: &Problem, bound: &Bound, seed: u64) -> Self {
        let Draw { parts, scene } = problem.draw(seed);
        let (out, wrong_start) = solved(&scene, seed);
        let covariance = named_covariance(&out).expect("a covariance");
        let natural = &covariance.natural;
        let (stereo, truth) = (StereoSheet::of(&covariance).expect("a sheet"), true_stereo(&parts));
        let mut errors: Vec<f64> = vec![];
        for (estimate, truth) in natural.cameras.iter().zip(&parts.cameras) {
            errors.extend(camera_numbers(estimate).iter().zip(camera_numbers(truth)).map(|(a, b)| a - b));
        }
        let nees_at_truth = nees(&errors, &bound.cameras);
        let nees_at_estimate = nees(&errors, &camera_covariance(&covariance));
        let got = sheet_numbers(&stereo, natural.cam_from_rig[1].inverse().translation_mm);
        let wanted = sheet_numbers(&truth, parts.cam_from_rig.inverse().translation_mm);
        errors.extend(got.iter().zip(wanted).map(|(a, b)| a - b));
        errors.push(stereo.response(&truth, [0.0, 0.0]).expect("seen").relative_gain() - 1.0);
        let plane = natural.rig_from_plane.expect("a sheet");
        let with = |plane: &Motion<Rig, Sheet>| {
            StereoSheet::new([natural.cameras[0], natural.cameras[1]], natural.cam_from_rig[1], plane)
        };
        let z = errors.iter().zip(&bound.sigmas).map(|(e, s)| e / s.unwrap_or(f64::NAN)).collect();
        let mean_square = |d: DVector<f64>| 2.0 * d.norm_squared() / d.len() as f64;
        let disparity_px2 = mean_square(disparities(&with(&plane), &truth));
        let refitted_px2 = mean_square(disparities(&with(&refitted(&plane, &with, &truth)), &truth));
        Self { seed, wrong_start, z, nees_at_truth, nees_at_estimate, disparity_px2, refitted_px2 }
    }

    /// One line of a table of runs.
    pub(crate) fn line(&self) -> String {
        let z: Vec<String> = self.z.iter().map(|z| format!("{z:.6e}")).collect();
        format!(
            "{},{},{},{:.6e},{:.6e},{:.6e},{:.6e}",
            self.seed,
            u8::from(self.wrong_start),
            z.join(","),
            self.nees_at_truth,
            self.nees_at_estimate,
            self.disparity_px2,
            self.refitted_px2
        )
    }

    pub(crate) fn parse(line: &str) -> Option<Self> {
        let n: Vec<&str> = line.split(',').collect();
        let numbers: Vec<f64> = n.get(2..)?.iter().map(|x| x.parse().ok()).collect::<Option<_>>()?;
        let [z @ .., nees_at_truth, nees_at_estimate, disparity_px2, refitted_px2] = &numbers[..] else { return None };
        Some(Self {
            seed: n[0].parse().ok()?,
            wrong_start: n[1] == "1",
            z: (z.len() == QUANTITIES.len()).then(|| z.to_vec())?,
            nees_at_truth: *nees_at_truth,
            nees_at_estimate: *nees_at_estimate,
            disparity_px2: *disparity_px2,
            refitted_px2: *refitted_px2,
        })
    }
}

/// Means over runs.
pub(crate) struct Summary {
    pub(crate) runs: usize,
    pub(crate) wrong_starts: usize,
    /// Mean z and sampled scatter over bound, in the order of [`QUANTITIES`].
    pub(crate) mean_and_ratio: Vec<[f64; 2]>,
    pub(crate) nees_at_truth: f64,
    pub(crate) nees_at_estimate: f64,
    pub(crate) disparity_px: f64,
    pub(crate) refitted_px: f64,
}

impl Summary {
    pub(crate) fn of(runs: &[Run]) -> Self {
        let n = runs.len() as f64;
        let mean = |f: &dyn Fn(&Run) -> f64| runs.iter().map(f).sum::<f64>() / n;
        Self {
            runs: runs.len(),
            wrong_starts: runs.iter().filter(|r| r.wrong_start).count(),
            mean_and_ratio: (0..QUANTITIES.len())
                .map(|k| [mean(&|r| r.z[k]), mean(&|r| r.z[k] * r.z[k]).sqrt()])
                .collect(),
            nees_at_truth: mean(&|r| r.nees_at_truth),
            nees_at_estimate: mean(&|r| r.nees_at_estimate),
            disparity_px: mean(&|r| r.disparity_px2).sqrt(),
            refitted_px: mean(&|r| r.refitted_px2).sqrt(),
        }
    }
}
