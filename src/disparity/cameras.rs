//! Cameras and the light's plane together, from the disparities of the windows.
//!
//! A plane takes away only the disparity along s_2 - s_1. What is left across it, and what is not flat along it, tells of the cameras.
//! Both are observations of every number p of the calibration, whose estimate p_0 and covariance P are what is known before:
//! ```text
//! r_i(p, a, b, c) = [ across_i;  (Z_i - a - b X_i - c Y_i) |s_2 - s_1| ]     0 but for scatter, of a window in the flat light
//! p = p_0 (+) L w,   L L^T = P_pp,   w ~ N(0, 1)                             (+) adds, and steps poses and windows from the left
//! minimise |w|^2 + sum u_i r_i^2 / s^2     by Gauss-Newton:   (G^T R^-1 G + diag(1, 0)) step = -G^T R^-1 r - (w, 0)
//! N = G^T R^-1 G + diag(1, 0),   C = N^-1            covariance of (w, a, b, c); nothing is known of (a, b, c) before
//! x = x_0 (+) M w,  M = P_xp P_pp^-1 L,  P_xx' = P_xx - M M^T + G C_ww G^T    every number x of the calibration; G = dx/dw, M at w = 0
//! d log F = A D (w, a, b, c) + S (G_q w + e_q),   cov(e_q, x) = P_qx - M_q M_x^T    a frame that a mark or a view placed; A, S as in `propagate.rs`
//! ```
//! This is the update of a Kalman filter, written with as many unknowns as P has directions, so that a covariance with exact
//! correlations and numbers that are held need no care. Where no window tells anything, w stays 0 and P stays P.
//!
//! (+) follows the valley of the lens axis (`stepped.rs`), and planes are told against an anchor that keeps its images (`anchor.rs`), so that plate
//! and light, which move together along weak directions, stay together.
//!
//! Scatter: s is that of the windows about the smooth (quadratic) part of the map, along and across apart, so that errors of the cameras
//! do not count as noise; u_i is the square of the correlation times Tukey's weight. s^2 is scaled so that `sum u_i / s^2` is what the
//! M-estimate of a mean knows, `(sum psi')^2 / sum psi^2`.
//!
//! Does the change fit what was known? With `N_w` the information of the windows on w (the plane eliminated) and its eigenpairs (l, v),
//! `(v . w)^2 (1 + l) / l` is a chi-square with one degree of freedom where the calibration and its covariance are true; summed over those
//! directions on which the windows tell at least as much as the calibration.
//!
//! | symbol | identifier | shape | meaning |
//! |---|---|---|---|
//! | L, M | `factor`, `gain` | n x k, N x k | numbers of the cameras, and of the calibration, by w |
//! | D | `sheet_by` | 6 x (k + 3) | left step of the sheet, carried with the anchor, by w and (a, b, c) |
//! | q, G_q, e_q | `q`, `start_by`, `rest` | 6, 6 x k, 6 | left step of the starting sheet's frame: all, by w, and what the cameras do not tell of it |
//! | w | `w` | k | in standard deviations of independent directions |
//! | C | `covariance` | k + 3 square | of (w, a, b, c) |
//!
//! Sources: Wieneke, Exp. Fluids 39 (2005) 267 (disparities refine cameras, too); Gelb, Applied Optimal Estimation (1974), 4.2. Not valid
//! where the light is bent (taken for an error of the cameras), nor along directions that the calibration leaves undetermined: refused.

mod windows;

use super::anchor::Anchor;
use super::propagate::{
    Propagated, against_by_sheet, against_by_start, camera_numbers, frame_by, over, sheet_pose, start_rows, tilted,
};
use super::stepped::{Steps, numbers_between, record_after, take_sigmas};
use crate::bundle::{Parameter, SHEET, symmetric_eigen};
use crate::error::{Error, Insufficient, Result};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::record::{CamerasRefined, Covariance, Pose, Record, RefinedNumber, View};
use crate::rigid::{Motion, STEP_NAMES};
use crate::sheet::Placement;
use crate::stats::chi_square_above;
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Matrix6, OMatrix, SVector, U3, U6};
pub(super) use windows::Update;

/// Directions of the correlation with less than this part of the largest are exact dependences.
const EXACT: f64 = 1e-12;
/// Steps of w for derivatives, standard deviations.
const SIDE: f64 = 1e-3;
/// The method of a sheet that is the plane of a view's target.
const METHOD_OF_VIEW: &str = "target plane";
/// A change of one number beyond this many of its standard deviations is told.
const FAR: f64 = 3.0;
/// And changes that together are less likely than this.
const UNLIKELY: f64 = 1e-3;

/// What is known of the numbers before.
pub(super) struct Prior {
    /// Row in the covariance of each number that moves the cameras.
    numbers: Vec<(usize, Parameter)>,
    factor: DMatrix<f64>,
    gain: DMatrix<f64>,
    anchor: Anchor,
    /// Left step of the anchor by w, where the calibration stands.
    drift: DMatrix<f64>,
}

fn unknown(what: &str) -> Error {
    Insufficient::Degenerate(format!(
        "the cameras cannot be refined: {what}; leave out --refine-cameras, or calibrate again with what the report of the calibration asks for"
    ))
    .into()
}

impl Prior {
    /// From the covariance of a calibration.
    ///
    /// # Errors
    /// [`Insufficient`] where it states none, or does not determine the cameras.
    pub(super) fn of(start: &Record) -> Result<Self> {
        let numbers = camera_numbers(start).ok_or_else(|| unknown("the calibration does not hold two cameras"))?;
        if numbers.is_empty() {
            return Err(unknown("the calibration states no covariance of its cameras"));
        }
        let c = &start.covariance.matrix;
        let lost =
            |(i, _): &&(usize, Parameter)| numbers.iter().any(|(j, _)| !start.covariance.known(*i, *j).is_finite());
        let own = |(i, _): &&(usize, Parameter)| !start.covariance.known(*i, *i).is_finite();
        if let Some((i, _)) = numbers.iter().find(own).or_else(|| numbers.iter().find(lost)) {
            let name = &start.covariance.names[*i];
            return Err(unknown(&format!(
                "the calibration does not determine {name}, so there is no covariance to weigh the particles against"
            )));
        }
        let scale: Vec<f64> = numbers.iter().map(|(i, _)| c[*i][*i].max(0.0).sqrt()).collect();
        let inverse: Vec<f64> = scale.iter().map(|s| if *s > 0.0 { 1.0 / s } else { 0.0 }).collect();
        let n = numbers.len();
        let correlation = DMatrix::from_fn(n, n, |i, j| c[numbers[i].0][numbers[j].0] * inverse[i] * inverse[j]);
        let eigen =
            symmetric_eigen(&correlation).ok_or_else(|| unknown("the calibration's covariance has no factor"))?;
        let most = eigen.values.amax();
        let kept: Vec<usize> = (0..n).filter(|k| eigen.values[*k] > EXACT * most).collect();
        let factor = DMatrix::from_fn(n, kept.len(), |i, k| {
            scale[i] * eigen.vectors[(i, kept[k])] * eigen.values[kept[k]].sqrt()
        });
        // M = P_xp D^-1 V / sqrt(values); a number whose covariance with the cameras is not known stays.
        let back = DMatrix::from_fn(n, kept.len(), |i, k| {
            inverse[i] * eigen.vectors[(i, kept[k])] / eigen.values[kept[k]].sqrt()
        });
        let mut gain = DMatrix::zeros(c.len(), kept.len());
        for (x, row) in c.iter().enumerate() {
            let with = DMatrix::from_fn(1, n, |_, j| row[numbers[j].0]);
            if with.iter().all(|v| v.is_finite()) {
                gain.set_row(x, &(with * &back).row(0));
            }
        }
        for (k, (i, _)) in numbers.iter().enumerate() {
            gain.set_row(*i, &factor.row(k));
        }
        let lost = || unknown("the cameras do not see the sheet");
        let anchor = Anchor::of(start).ok_or_else(lost)?;
        let mut prior = Self { numbers, factor, gain, anchor, drift: DMatrix::zeros(6, kept.len()) };
        for k in 0..kept.len() {
            let at = |h: f64| {
                prior
                    .anchor
                    .at(start, &prior.steps(start, &DVector::from_fn(kept.len(), |j, _| if j == k { h } else { 0.0 })))
            };
            let (m, p) = (at(-SIDE).ok_or_else(lost)?, at(SIDE).ok_or_else(lost)?);
            prior.drift.set_column(k, &(m.step_to(&p) / (2.0 * SIDE)));
        }
        Ok(prior)
    }

    /// Nothing heard yet.
    pub(super) fn start(&self) -> DVector<f64> {
        DVector::zeros(self.factor.ncols())
    }

    fn steps<'a>(&self, start: &'a Record, w: &DVector<f64>) -> Steps<'a> {
        let all = &self.gain * w;
        Steps::new(&start.covariance.names, all.as_slice().to_vec().into_iter())
    }

    /// The calibration at w with the sheet that was started from moved along; standard deviations are those of before.
    pub(super) fn record_at(&self, start: &Record, w: &DVector<f64>) -> Option<Record> {
        let steps = self.steps(start, w);
        let mut out = record_after(start, &steps)?;
        // A sheet that the covariance does not name is held.
        if let Some(rows) = start_rows(start) {
            let all = &self.gain * w;
            let beside = SVector::<f64, 6>::from_fn(|k, _| all[rows[k]]) - &self.drift * w;
            let moved = self.anchor.at(start, &steps)?.retract(&beside);
            let by: Motion<Rig, Rig> = moved * sheet_pose(start)?.inverse();
            let sheet = out.sheet.as_mut()?;
            sheet.rig_from_sheet = (&moved).into();
            if let (METHOD_OF_VIEW, [view]) = (sheet.method.as_str(), sheet.views.as_slice()) {
                let of = |views: &[View]| views.iter().position(|v| v.index == *view);
                let old = of(&start.views).and_then(|k| start.views[k].rig_from_target);
                let pose = old.map(|p| Pose::from(&(by * p.motion::<Rig, Target>())));
                if let Some(k) = of(&out.views) {
                    out.views[k].rig_from_target = pose;
                }
            }
        }
        Some(out)
    }

    /// A sheet in the rig at one w, held against the anchor on the way to another.
    pub(super) fn carried(
        &self,
        start: &Record,
        [from, to]: [&DVector<f64>; 2],
        sheet: &Motion<Rig, Sheet>,
    ) -> Option<Motion<Rig, Sheet>> {
        let at = |w: &DVector<f64>| self.anchor.at(start, &self.steps(start, w));
        let beside: Motion<Sheet, Sheet> = at(from)?.inverse() * *sheet;
        Some(at(to)? * beside)
    }

    /// Where the frame of a sheet stands at the w of `reference`, the calibration there with the starting sheet moved along: over that one's frame, where a
    /// mark or a view placed it that the covariance knows. Other frames are carried with the cameras.
    pub(super) fn placement(start: &Record, reference: &Record) -> Option<Placement> {
        let placed = Placement::of_frame(&sheet_pose(start)?);
        let known = start_rows(start)?.iter().all(|i| start.covariance.determines(*i));
        let frame = sheet_pose(reference)?;
        (placed.origin_in_rig_mm.is_some() && known).then(|| over(&placed, &frame))
    }

    /// What is known afterwards: `reference` is the calibration at w with the starting sheet moved along, `now` the one with the sheet found.
    ///
    /// Derivatives by w are those at the new place: along weak directions the old ones no longer are.
    pub(super) fn propagated(
        &self,
        start: &Record,
        reference: &Record,
        now: &Record,
        update: &Update,
        reference_mm: [f64; 2],
    ) -> Option<Propagated> {
        let (k, old, w) = (update.w.len(), &start.covariance, &update.w);
        let (pose, start_pose, q) = (sheet_pose(now)?, sheet_pose(reference)?, start_rows(start));
        let mut g = self.gain.clone();
        let (mut start_by, mut sheet_by) = (OMatrix::<f64, U6, Dyn>::zeros(k), OMatrix::<f64, U6, Dyn>::zeros(k + 3));
        for j in 0..k {
            let side = |h: f64| {
                let mut moved = w.clone();
                moved[j] += h;
                Some((self.record_at(start, &moved)?, self.carried(start, [w, &moved], &pose)?))
            };
            let ((m, m_sheet), (p, p_sheet)) = (side(-SIDE)?, side(SIDE)?);
            for (i, d) in numbers_between(&m, &p, &old.names).iter().enumerate() {
                if let Some(d) = d.filter(|_| !old.names[i].starts_with(SHEET)) {
                    g[(i, j)] = d / (2.0 * SIDE);
                }
            }
            start_by.set_column(j, &(sheet_pose(&m)?.step_to(&sheet_pose(&p)?) / (2.0 * SIDE)));
            sheet_by.set_column(j, &(m_sheet.step_to(&p_sheet) / (2.0 * SIDE)));
        }
        sheet_by.columns_mut(k, 3).copy_from(&(pose.adjoint() * tilted()));
        let c = &update.covariance;
        let (before, after) = (&self.gain * self.gain.transpose(), &g * c.view((0, 0), (k, k)) * g.transpose());
        let left = |i: usize, j: usize| old.matrix[i][j] - before[(i, j)] + 0.5 * (after[(i, j)] + after[(j, i)]);
        let by_start = against_by_start(&start_pose, &pose, reference_mm);
        let mut gradient = against_by_sheet(&start_pose, &pose, reference_mm) * &sheet_by;
        let mut part = gradient.columns_mut(0, k);
        part += by_start * &start_by;
        let known = &gradient * c * gradient.transpose();
        let mut against_start = Matrix3::from_fn(|i, j| known[(i, j)]);
        // What the cameras do not tell of the starting sheet; one that the covariance does not name is held.
        if let Some(q) = q {
            let own = Matrix6::from_fn(|i, j| old.matrix[q[i]][q[j]] - before[(q[i], q[j])]);
            against_start += by_start * own * by_start.transpose();
        }
        if against_start.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let own_step = pose.inverse().adjoint() * &sheet_by;
        let plane_by = tilted().transpose() * own_step;
        let plane_and_center = self.plane_and_center(now, old, &plane_by, c, &g);
        // A placed frame goes with the start's, of which the cameras do not tell all; others are carried.
        let placed = Self::placement(start, reference).map(|kind| frame_by(&kind, &start_pose, &pose));
        if let Some([by_pose, by_frame]) = placed {
            sheet_by = by_pose * sheet_by;
            let mut part = sheet_by.columns_mut(0, k);
            part += by_frame * &start_by;
        }
        let (mut sheet, mut cross) =
            (&sheet_by * c * sheet_by.transpose(), &sheet_by * c.columns(0, k) * g.transpose());
        if let (Some(q), Some([_, by_frame])) = (q, placed) {
            let rest = DMatrix::from_fn(6, old.names.len(), |i, x| old.matrix[q[i]][x] - before[(q[i], x)]);
            sheet += by_frame * rest.select_columns(&q) * by_frame.transpose();
            cross += by_frame * rest;
        }
        let kept: Vec<usize> = (0..old.names.len()).filter(|i| !old.names[*i].starts_with(SHEET)).collect();
        let n = kept.len();
        let entry = |i: usize, j: usize| match (i < n, j < n) {
            (true, true) => left(kept[i], kept[j]),
            (false, false) => 0.5 * (sheet[(i - n, j - n)] + sheet[(j - n, i - n)]),
            (false, true) => cross[(i - n, kept[j])],
            (true, false) => cross[(j - n, kept[i])],
        };
        let rest = old.only(&kept);
        let covariance = Covariance {
            names: rest.names.into_iter().chain(STEP_NAMES.map(|s| format!("{SHEET}{s}"))).collect(),
            matrix: (0..n + 6).map(|i| (0..n + 6).map(|j| entry(i, j)).collect()).collect(),
            // Those of views and target: none moves the cameras, nor the sheet.
            undetermined: rest.undetermined,
            null_directions: rest.null_directions.into_iter().map(|d| [d, vec![0.0; 6]].concat()).collect(),
        };
        Some(Propagated { plane_and_center, against_start, covariance })
    }

    /// Covariance of (a, b, c) and the second centre.
    fn plane_and_center(
        &self,
        now: &Record,
        old: &Covariance,
        plane_by: &OMatrix<f64, U3, Dyn>,
        c: &DMatrix<f64>,
        g: &DMatrix<f64>,
    ) -> Matrix6<f64> {
        let k = g.ncols();
        let second = &now.cameras[1];
        let turn = second.cam_from_rig.motion::<Cam, Rig>().center_by_shift();
        let mut by = DMatrix::zeros(6, k + 3);
        by.rows_mut(0, 3).copy_from(plane_by);
        let row = |s: &str| old.index(&format!("{}.cam_from_rig.{s}", second.name));
        for (a, row) in STEP_NAMES[3..].iter().enumerate().filter_map(|(a, s)| Some((a, row(s)?))) {
            let moved = turn.column(a) * g.row(row);
            let mut part = by.view_mut((3, 0), (3, k));
            part += moved;
        }
        let all = &by * c * by.transpose();
        Matrix6::from_fn(|i, j| 0.5 * (all[(i, j)] + all[(j, i)]))
    }

    /// The changes in numbers, and what must be said of them.
    pub(super) fn told(
        &self,
        start: &Record,
        after: &Covariance,
        update: &Update,
        flags: &mut Vec<String>,
    ) -> CamerasRefined {
        let moved = self.record_at(start, &update.w);
        let between = moved.map(|m| numbers_between(start, &m, &start.covariance.names)).unwrap_or_default();
        let straight = &self.factor * &update.w;
        let one = |(k, (i, _)): (usize, &(usize, Parameter))| {
            let name = start.covariance.names[*i].clone();
            let sigma_before = start.covariance.matrix[*i][*i].max(0.0).sqrt();
            let sigma_after = after.sigma(&name).unwrap_or(f64::NAN);
            let change = between.get(*i).copied().flatten().unwrap_or(straight[k]);
            let change_sigmas = if sigma_before > 0.0 { change / sigma_before } else { 0.0 };
            RefinedNumber { name, change, sigma_before, sigma_after, change_sigmas }
        };
        let numbers: Vec<RefinedNumber> = self.numbers.iter().enumerate().map(one).collect();
        let (mut chi2, mut degrees) = (0.0, 0);
        if let Some(e) = symmetric_eigen(&update.information) {
            for (l, v) in e.values.iter().zip(e.vectors.column_iter()).filter(|(l, _)| **l > 1.0) {
                chi2 += v.dot(&update.w).powi(2) * (1.0 + l) / l;
                degrees += 1;
            }
        }
        let chance = if degrees > 0 { chi_square_above(chi2, degrees as f64) } else { f64::NAN };
        let far: Vec<String> = numbers
            .iter()
            .filter(|n| n.change_sigmas.abs() > FAR)
            .map(|n| format!("{} by {:+.1}", n.name, n.change_sigmas))
            .collect();
        let why = "the calibration was wrong there, or a camera or its window was moved, refocused or knocked after it; calibrate again, and use this \
                   correction only where that cannot be done";
        if !far.is_empty() {
            flags.push(format!("the particles move the cameras beyond what the calibration allows ({} of its standard deviations): {why}", far.join(", ")));
        } else if chance < UNLIKELY {
            flags.push(format!(
                "taken together the particles contradict the calibration of the cameras (chi-square {chi2:.0} of {degrees}, chance {chance:.0e}), though no \
                 number by itself moves beyond {FAR:.0} of its standard deviations: {why}"
            ));
        }
        CamerasRefined { numbers, chi2, degrees, chance }
    }
}

/// The calibration with all that was learnt: the record at w with its sheet, covariance and standard deviations.
pub(super) fn with_sigmas(mut record: Record, covariance: &Covariance) -> Record {
    take_sigmas(&mut record, covariance);
    record
}
