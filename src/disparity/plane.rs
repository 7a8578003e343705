//! Matched places to depth, depths to a plane, the plane to a sheet.

use crate::dewarp::SheetMap;
use crate::error::{Invalid, Result};
use crate::frames::{Cam, Rig, Sheet, Target};
use crate::record::{self, Record};
use crate::rigid::Motion;
use crate::sheet::{Placement, SheetEstimate};
use crate::stats;
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};

/// A plane that follows a point by more is held by nothing else there.
const MOST_FOLLOWED: f64 = 0.95;
/// Tukey's constant: 95 % efficiency for normal scatter.
const TUKEY: f64 = 4.685;

/// One place seen by both cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Match {
    /// Raw pixels of the same light in both cameras.
    pub(super) pixels: [Vector2<f64>; 2],
    pub(super) correlation: f64,
    pub(super) ratio: f64,
}

/// A match seen in a sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seen {
    /// Point where the rays meet (nearest), mm.
    pub(super) point_mm: Vector3<f64>,
    /// Disparity in the plane z = 0: second less first, mm.
    pub(super) disparity_mm: Vector2<f64>,
    /// Its part across the direction of depth, mm.
    pub(super) across_mm: f64,
    /// Length of s_2 - s_1.
    pub(super) slope_apart: f64,
}

/// Triangulates a match; none where a pixel does not see the sheet or both look along one line.
pub(super) fn see(maps: [&SheetMap; 2], m: &Match) -> Option<Seen> {
    let [a, b] = [maps[0].hit(&m.pixels[0], 0.0)?, maps[1].hit(&m.pixels[1], 0.0)?];
    let (d, s) = (b.xy_mm - a.xy_mm, b.slope - a.slope);
    let length = s.norm();
    if !(length > 1e-6) {
        return None;
    }
    let z = -d.dot(&s) / (length * length);
    let xy = 0.5 * (a.xy_mm + a.slope * z + b.xy_mm + b.slope * z);
    Some(Seen {
        point_mm: xy.push(z),
        disparity_mm: d,
        across_mm: (d.x * s.y - d.y * s.x) / length,
        slope_apart: length,
    })
}

/// `z = a + b x + c y` through points.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlaneFit {
    pub(super) abc: Vector3<f64>,
    /// From the scatter of the points.
    pub(super) covariance: Matrix3<f64>,
    /// Standard deviation of a disparity about the fit, mm.
    pub(super) scatter_mm: f64,
    /// Whether a point took part.
    pub(super) used: Vec<bool>,
    /// What each point counted in the end.
    pub(super) weights: Vec<f64>,
}

impl PlaneFit {
    /// Points that took part.
    pub(super) fn count(&self) -> usize {
        self.used.iter().filter(|u| **u).count()
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    stats::median(&mut values).unwrap_or(f64::NAN)
}

pub(super) fn tukey(t: f64) -> f64 {
    let t = t / TUKEY;
    if t.abs() < 1.0 { (1.0 - t * t).powi(2) } else { 0.0 }
}

/// Slope of Tukey's weighted residual: what one more sigma of an observation moves the estimate by.
pub(super) fn tukey_slope(t: f64) -> f64 {
    let t = t / TUKEY;
    if t.abs() < 1.0 { (1.0 - t * t) * (1.0 - 5.0 * t * t) } else { 0.0 }
}

/// Whether a match is real, by the part of its disparity that no plane changes: 0 where it is far from all others.
fn likely_across(seen: &[Seen]) -> Vec<f64> {
    let middle = median(seen.iter().map(|s| s.across_mm).collect());
    let scale =
        (stats::SIGMA_OVER_MEDIAN * median(seen.iter().map(|s| (s.across_mm - middle).abs()).collect())).max(1e-12);
    seen.iter().map(|s| f64::from(u8::from((s.across_mm - middle).abs() < TUKEY * scale))).collect()
}

fn row(s: &Seen) -> Vector3<f64> {
    Vector3::new(1.0, s.point_mm.x, s.point_mm.y)
}

/// Plane through points with given weights.
pub(super) fn weighted_plane(seen: &[Seen], weights: &[f64]) -> Option<Vector3<f64>> {
    let (mut n, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for (s, w) in seen.iter().zip(weights) {
        n += row(s) * row(s).transpose() * *w;
        b += row(s) * (w * s.point_mm.z);
    }
    Some(n.cholesky()?.solve(&b))
}

fn weights_of(seen: &[Seen], matches: &[Match], robust: &[f64]) -> Vec<f64> {
    let one = |((s, m), r): ((&Seen, &Match), &f64)| r * (m.correlation * s.slope_apart).powi(2);
    seen.iter().zip(matches).zip(robust).map(one).collect()
}

/// Weighted robust fit; residuals count in disparity, `r = (z - plane) |s_2 - s_1|`, weights as the square of the correlation.
pub(super) fn fit_plane(matches: &[Match], seen: &[Seen]) -> Option<PlaneFit> {
    let residual = |s: &Seen, abc: &Vector3<f64>| (s.point_mm.z - abc.dot(&row(s))) * s.slope_apart;
    let mut abc = Vector3::zeros();
    let likely = likely_across(seen);
    let mut robust = likely.clone();
    let mut scale = f64::INFINITY;
    for round in 0..30 {
        let next = weighted_plane(seen, &weights_of(seen, matches, &robust))?;
        let moved = (next - abc).norm();
        abc = next;
        let sizes = seen.iter().zip(&likely).filter(|(_, l)| **l > 0.0).map(|(s, _)| residual(s, &abc).abs());
        let sizes: Vec<f64> = sizes.collect();
        // The fit has taken three numbers from them.
        let kept = sizes.len() as f64;
        scale = (stats::SIGMA_OVER_MEDIAN * median(sizes) * (kept / (kept - 3.0).max(1.0)).sqrt()).max(1e-12);
        for ((r, s), likely) in robust.iter_mut().zip(seen).zip(&likely) {
            *r = likely * tukey(residual(s, &abc) / scale);
        }
        if round > 3 && moved < 1e-9 {
            break;
        }
    }
    // Covariance of the weighted estimate from its own residuals (sandwich), for correct weights or not; each over what is left of it where the plane
    // follows the point itself (HC3).
    let weights = weights_of(seen, matches, &robust);
    let n = seen.iter().zip(&weights).fold(Matrix3::zeros(), |n, (s, w)| n + row(s) * row(s).transpose() * *w);
    let inverse = n.try_inverse()?;
    let mut meat = Matrix3::zeros();
    let (mut count, mut slope, mut sum) = (0.0_f64, 0.0, 0.0);
    for ((s, w), r) in seen.iter().zip(&weights).zip(&robust) {
        let followed = (w * row(s).dot(&(inverse * row(s)))).min(MOST_FOLLOWED);
        let left = (s.point_mm.z - abc.dot(&row(s))) / (1.0 - followed);
        meat += row(s) * row(s).transpose() * (w * left).powi(2);
        count += f64::from(u8::from(*r > 0.0));
        if *r > 0.0 {
            slope += tukey_slope(residual(s, &abc) / scale);
            sum += r;
        }
    }
    let used: Vec<bool> = robust.iter().map(|r| *r > 0.0).collect();
    if count < 4.0 {
        return None;
    }
    // An M-estimate answers to its data by the slope of the weighted residual, which is less than the weight.
    let answer = (slope / sum).max(0.5);
    let covariance = inverse * meat * inverse / (answer * answer);
    Some(PlaneFit { abc, covariance, scatter_mm: scale, used, weights })
}

/// The record with its sheet at `z = a + b x + c y` of its present sheet frame, the new one where `placement` says; the covariance is that of (a, b, c)
/// and of the second projection centre.
pub(super) fn moved_sheet(
    record: &Record,
    abc: &Vector3<f64>,
    covariance: &Matrix6<f64>,
    placement: &Placement,
) -> Option<Record> {
    let mut out = record.clone();
    let old = record.sheet.as_ref()?;
    let center = record.cameras.get(1).map(|c| c.cam_from_rig.motion::<Cam, Rig>().inverse().translation_mm);
    let estimate = SheetEstimate::from_placed_plane(&old.rig_from_sheet.motion(), abc, covariance, center, placement);
    out.sheet = Some(estimate.to_record("self-calibration", old.views.clone()));
    Some(out)
}

/// The covariance of a plane with the cameras held.
pub(super) fn cameras_held(covariance: &Matrix3<f64>) -> Matrix6<f64> {
    let mut out = Matrix6::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(covariance);
    out
}

/// A sheet to start from where the calibration has none: the plane of the target of a view.
///
/// # Errors
/// [`Invalid`] where there is no such view or it was not used.
pub fn sheet_of_view(record: &Record, view: usize) -> Result<record::Sheet> {
    let found = record.views.iter().find(|v| v.index == view).and_then(|v| v.rig_from_target);
    let Some(pose) = found else {
        let what = format!(
            "view {view} has no pose; name a view of the calibration that was used (0 to {})",
            record.views.len().saturating_sub(1)
        );
        return Err(Invalid::Contradiction(what).into());
    };
    let center = record.cameras.get(1).map(|c| c.cam_from_rig.motion::<Cam, Rig>().inverse().translation_mm);
    let target: Motion<Rig, Target> = pose.motion();
    let frame = Motion::<Rig, Sheet>::new(target.rotation, target.translation_mm);
    let unknown = Matrix6::repeat(f64::NAN);
    Ok(SheetEstimate::from_plane(&frame, &Vector3::zeros(), &unknown, center).to_record("target plane", vec![view]))
}

#[cfg(test)]
mod tests {
    use super::super::misalignment::tests::noise;
    use super::*;

    /// The same windows with new scatter: how the plane scatters, and what it says of itself.
    #[test]
    fn the_covariance_of_a_plane_is_that_of_planes_measured_again() {
        let (trials, windows) = (400, 12 * 12);
        let (mut sum, mut square, mut told) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for trial in 0..trials {
            let one = |k: usize| {
                let (x, y) = ((k % 12) as f64 - 5.5, (k / 12) as f64 - 5.5);
                let z = 0.3 + 0.02 * x + 0.5 * noise(k, 3 + trial);
                Seen {
                    point_mm: Vector3::new(x, y, z),
                    disparity_mm: Vector2::zeros(),
                    across_mm: 0.05 * noise(k, 90_001 + trial),
                    slope_apart: 0.8,
                }
            };
            let seen: Vec<Seen> = (0..windows).map(one).collect();
            let m = Match { pixels: [Vector2::zeros(); 2], correlation: 0.4, ratio: 3.0 };
            let fit = fit_plane(&vec![m; windows], &seen).unwrap();
            sum += fit.abc;
            square += fit.abc.component_mul(&fit.abc);
            told += fit.covariance.diagonal();
        }
        let n = trials as f64;
        let ratio = ((square - sum.component_mul(&sum) / n) / (n - 1.0)).component_div(&(told / n));
        // A variance of 400 samples scatters by 7 %.
        assert!(ratio.iter().all(|r| (r - 1.0).abs() < 0.25), "{ratio}");
    }

    /// Of few windows: residuals that the plane follows are no scatter. Mean z^2 of 2000 planes; without allowing for that 12 windows had 3, and 10 had 8.
    #[test]
    fn few_windows_do_not_pass_for_many() {
        for (columns, rows, most) in [(5, 2, 1.8), (4, 3, 1.7), (5, 3, 1.7), (5, 4, 1.4), (6, 5, 1.25), (8, 6, 1.2)] {
            let (windows, trials) = (columns * rows, 2000);
            let (mut z2, mut beyond) = (Vector3::<f64>::zeros(), 0.0);
            for trial in 0..trials {
                let one = |k: usize| {
                    let at = |i: usize, n: usize| i as f64 - 0.5 * (n - 1) as f64;
                    let point_mm =
                        Vector3::new(at(k % columns, columns), at(k / columns, rows), 0.5 * noise(k, 3 + trial));
                    let across_mm = 0.05 * noise(k, 90_001 + trial);
                    Seen { point_mm, disparity_mm: Vector2::zeros(), across_mm, slope_apart: 0.8 }
                };
                let seen: Vec<Seen> = (0..windows).map(one).collect();
                let m = Match { pixels: [Vector2::zeros(); 2], correlation: 0.4, ratio: 3.0 };
                let Some(fit) = fit_plane(&vec![m; windows], &seen) else { continue };
                let z = Vector3::from_fn(|i, _| fit.abc[i] / fit.covariance[(i, i)].sqrt());
                z2 += z.component_mul(&z) / trials as f64;
                beyond += z.iter().filter(|z| z.abs() > 3.0).count() as f64 / (3 * trials) as f64;
            }
            println!("{windows} windows: mean z^2 {:.2?}, beyond 3 sigmas {:.1} %", z2.as_slice(), 100.0 * beyond);
            assert!(z2.iter().all(|z| (0.8..most).contains(z)), "{windows}: {z2}");
        }
    }
}
