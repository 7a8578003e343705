//! Gauss-Newton over cameras and plane: what the windows of one measurement say (formulae: the room above).

use super::super::plane::{Match, PlaneFit, Seen, see, tukey, tukey_slope};
use super::super::propagate::sheet_pose;
use super::super::stepped::{Steps, maps_after};
use super::Prior;
use crate::frames::Sheet;
use crate::record::Record;
use crate::rigid::Motion;
use crate::stats::SIGMA_OVER_MEDIAN;
use nalgebra::{DMatrix, DVector, Vector3};

/// Gauss-Newton steps on one set of matches; two suffice but for cameras that were knocked.
const STEPS: usize = 8;
/// They end when w moves by less.
const STILL: f64 = 1e-4;
/// Part of a step below which it is taken as it is: rounding decides.
const SHORTEST: f64 = 1e-3;
/// The smooth part of a map: a quadratic.
const TERMS: usize = 6;

/// Cameras and plane after the windows were heard.
pub(in crate::disparity) struct Update {
    pub(in crate::disparity) w: DVector<f64>,
    /// Of the plane in the frame of the sheet that the matches were seen in, carried along.
    pub(in crate::disparity) abc: Vector3<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Information of the windows on w, the plane eliminated.
    pub(super) information: DMatrix<f64>,
}

/// The windows matched in one calibration, and how the numbers of all cameras move what they saw.
struct Windows<'a> {
    prior: &'a Prior,
    start: &'a Record,
    matches: &'a [Match],
    /// The sheet in which they were matched, in the anchor.
    anchor_from_sheet: Motion<Sheet, Sheet>,
    distance_mm: f64,
}

/// Where the iteration stands.
struct State {
    w: DVector<f64>,
    abc: Vector3<f64>,
    seen: Vec<Seen>,
}

/// Normal equations of (w, a, b, c).
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Prior {
    /// Hears the windows that were matched in `now`, the calibration at w with the sheet where it then was.
    pub(in crate::disparity) fn update(
        &self,
        start: &Record,
        now: &Record,
        matches: &[Match],
        fit: &PlaneFit,
        from: &DVector<f64>,
    ) -> Option<Update> {
        let sheet = sheet_pose(now)?;
        let anchor_from_sheet = self.anchor.at(start, &self.steps(start, from))?.inverse() * sheet;
        let distance_mm = sheet.translation_mm.norm();
        let windows = Windows { prior: self, start, matches, anchor_from_sheet, distance_mm };
        let seen = windows.seen_at(&(&self.factor * from))?;
        let weights = information(&seen, matches, fit)?;
        let mut state = State { w: from.clone(), abc: fit.abc, seen };
        let mut normal = windows.normal(&state, &weights)?;
        for left in (0..STEPS).rev() {
            let step = normal.matrix.clone().cholesky()?.solve(&normal.right);
            state = windows.step(&state, &step, &weights)?;
            if left == 0 || step.rows(0, from.len()).amax() < STILL {
                break;
            }
            normal = windows.normal(&state, &weights)?;
        }
        normal.update(state)
    }
}

impl Windows<'_> {
    /// What the matches are after steps of the numbers that move the cameras.
    fn seen_at(&self, numbers: &DVector<f64>) -> Option<Vec<Seen>> {
        let names = &self.start.covariance.names;
        let mut all = vec![0.0; names.len()];
        self.prior.numbers.iter().zip(numbers.iter()).for_each(|((i, _), s)| all[*i] = *s);
        let steps = Steps::new(names, all.into_iter());
        let sheet = self.prior.anchor.at(self.start, &steps)? * self.anchor_from_sheet;
        let maps = maps_after(self.start, &steps, &sheet)?;
        self.matches.iter().map(|m| see([&maps[0], &maps[1]], m)).collect()
    }

    /// G, central differences by the numbers, exact by the plane.
    fn jacobian(&self, state: &State) -> Option<DMatrix<f64>> {
        let f_px = [0, 1].map(|c| self.start.cameras[c].f_px);
        let (at, k) = (&self.prior.factor * &state.w, state.w.len());
        let mut by_number = DMatrix::zeros(2 * state.seen.len(), at.len());
        for (j, (_, parameter)) in self.prior.numbers.iter().enumerate() {
            let h = parameter.step(f_px, self.distance_mm);
            let side = |h: f64| {
                let mut moved = at.clone();
                moved[j] += h;
                self.seen_at(&moved).map(|s| residuals(&s, &state.abc))
            };
            by_number.set_column(j, &((side(h)? - side(-h)?) / (2.0 * h)));
        }
        let mut g = DMatrix::zeros(by_number.nrows(), k + 3);
        g.columns_mut(0, k).copy_from(&(by_number * &self.prior.factor));
        for (i, s) in state.seen.iter().enumerate() {
            for (a, x) in [1.0, s.point_mm.x, s.point_mm.y].into_iter().enumerate() {
                g[(2 * i + 1, k + a)] = -x * s.slope_apart;
            }
        }
        Some(g)
    }

    fn normal(&self, state: &State, weights: &[f64]) -> Option<Normal> {
        let g = self.jacobian(state)?;
        let weighted = DMatrix::from_fn(g.nrows(), g.ncols(), |i, j| weights[i] * g[(i, j)]);
        let mut matrix = g.tr_mul(&weighted);
        let mut right = -weighted.tr_mul(&residuals(&state.seen, &state.abc));
        for (j, w) in state.w.iter().enumerate() {
            matrix[(j, j)] += 1.0;
            right[j] -= w;
        }
        Some(Normal { matrix, right })
    }

    /// A step, shorter where the whole one does not pay.
    fn step(&self, from: &State, step: &DVector<f64>, weights: &[f64]) -> Option<State> {
        let (k, before) = (from.w.len(), from.cost(weights));
        let mut part = 1.0;
        loop {
            let (w, abc) = (&from.w + step.rows(0, k) * part, from.abc + step.fixed_rows::<3>(k) * part);
            let tried = self.seen_at(&(&self.prior.factor * &w)).map(|seen| State { w, abc, seen });
            if part < SHORTEST || tried.as_ref().is_some_and(|s| s.cost(weights) <= before * (1.0 + 1e-12)) {
                return tried;
            }
            part *= 0.5;
        }
    }
}

impl State {
    fn cost(&self, weights: &[f64]) -> f64 {
        let rest = residuals(&self.seen, &self.abc);
        self.w.norm_squared() + rest.iter().zip(weights).map(|(r, u)| u * r * r).sum::<f64>()
    }
}

impl Normal {
    fn update(&self, state: State) -> Option<Update> {
        let k = state.w.len();
        let covariance = self.matrix.clone().cholesky()?.inverse();
        let plane = self.matrix.view((k, k), (3, 3)).into_owned().cholesky()?.inverse();
        let with = self.matrix.view((0, k), (k, 3));
        let information = self.matrix.view((0, 0), (k, k)) - with * plane * with.transpose() - DMatrix::identity(k, k);
        Some(Update { w: state.w, abc: state.abc, covariance, information })
    }
}

/// Across and along for every match, mm of disparity.
fn residuals(seen: &[Seen], abc: &Vector3<f64>) -> DVector<f64> {
    let along = |s: &Seen| (s.point_mm.z - abc.dot(&Vector3::new(1.0, s.point_mm.x, s.point_mm.y))) * s.slope_apart;
    DVector::from_iterator(2 * seen.len(), seen.iter().flat_map(|s| [s.across_mm, along(s)]))
}

/// `u_i / s^2` for both parts of every match, 1/mm^2; `None` for too few of them.
fn information(seen: &[Seen], matches: &[Match], fit: &PlaneFit) -> Option<Vec<f64>> {
    let rest = residuals(seen, &fit.abc);
    let reach = seen.iter().fold(1e-9_f64, |m, s| m.max(s.point_mm.xy().amax()));
    let places = DMatrix::from_fn(seen.len(), TERMS, |i, k| {
        let (x, y) = (seen[i].point_mm.x / reach, seen[i].point_mm.y / reach);
        [1.0, x, y, x * x, x * y, y * y][k]
    });
    let used: Vec<bool> = fit.used.clone();
    let part = |a: usize| {
        let values = DVector::from_fn(seen.len(), |i, _| rest[2 * i + a]);
        scattered(&places, &values, matches, &used)
    };
    let (across, along) = (part(0)?, part(1)?);
    Some(across.into_iter().zip(along).flat_map(|(a, b)| [a, b]).collect())
}

/// Robust fit of the smooth part, and what each value then counts.
fn scattered(places: &DMatrix<f64>, values: &DVector<f64>, matches: &[Match], used: &[bool]) -> Option<Vec<f64>> {
    let n = used.iter().filter(|u| **u).count();
    if n < TERMS + 3 {
        return None;
    }
    let quality = |i: usize| if used[i] { matches[i].correlation.powi(2) } else { 0.0 };
    let mean = (0..values.len()).map(quality).sum::<f64>() / n as f64;
    // Windows of lower correlation scatter more: all of them on one scale.
    let even: Vec<f64> = (0..values.len()).map(|i| quality(i) / mean).collect();
    let mut robust = vec![1.0; values.len()];
    let (mut rest, mut scale) = (values.clone(), 0.0);
    for _ in 0..30 {
        let weighted = DMatrix::from_fn(places.nrows(), TERMS, |i, k| even[i] * robust[i] * places[(i, k)]);
        let c = places.tr_mul(&weighted).cholesky()?.solve(&weighted.tr_mul(values));
        rest = values - places * c;
        let mut sizes: Vec<f64> =
            (0..values.len()).filter(|i| used[*i]).map(|i| rest[i].abs() * even[i].sqrt()).collect();
        sizes.sort_by(f64::total_cmp);
        scale = (SIGMA_OVER_MEDIAN * sizes[sizes.len() / 2]).max(1e-12);
        (0..values.len()).for_each(|i| robust[i] = tukey(rest[i] * even[i].sqrt() / scale));
    }
    let (mut slope, mut square, mut sum) = (0.0, 0.0, 0.0);
    for i in (0..values.len()).filter(|i| used[*i]) {
        slope += even[i] * tukey_slope(rest[i] * even[i].sqrt() / scale);
        square += even[i] * (robust[i] * rest[i] * even[i].sqrt()).powi(2);
        sum += even[i] * robust[i];
    }
    // The smooth part has taken its terms from the scatter.
    let known = slope * slope / square * (n - TERMS) as f64 / n as f64;
    (known > 0.0 && known.is_finite()).then(|| (0..values.len()).map(|i| even[i] * robust[i] * known / sum).collect())
}
