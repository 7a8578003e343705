//! What errors of the calibration do to measurements, over the part of the sheet that both cameras see.
//!
//! Displacements, disparity and gain come from [`SheetUncertainty`](crate::sheet::SheetUncertainty). The place in the sheet that a
//! pixel is mapped to is stated beside a common shift and turn of the sheet frame, which a user chooses anyway (the frame's origin is
//! where the first lens axis meets the sheet, and an uncertain axis point moves it along the sheet without moving anything else):
//! ```text
//! e_i = misplacement of point i in a camera,  e' = e - (shift, turn) fitted to all points of both cameras,  C' = P D C D^T P^T
//! ```

use super::digits;
use super::field::{Field, SeenSheet};
use crate::bundle::NamedCovariance;
use crate::record::{MappingMap, MappingSigma, MappingTold, MappingUncertainty, Record};
use crate::sheet::{PointUncertainty, StereoSheet, covariance_of_record};
use crate::threads::gathered;
use nalgebra::{DMatrix, DVector};

/// Where the misplacements stand among the numbers of a response.
pub(super) const PLACES: usize = 2;
/// Ratio of errors along and across the lines of sight that is worth a warning: less than 12 degrees between them.
const ONE_LINE: f64 = 10.0;
/// Relative out-of-plane gain that is worth a warning: 2 % of w.
const GAIN_LIMIT: f64 = 0.02;
/// Disparity that is worth a warning, px: vectors of both cameras would be of places that far apart, a few of them in a window.
const DISPARITY_LIMIT_PX: f64 = 0.5;

/// What a record says of it anew, after its sheet, its frame or its cameras were changed, with what must be told; `beside` is what else is told of it.
/// `None` where its covariance does not name the sheet, or does not determine cameras and sheet.
pub fn mapping_of_record(record: &Record, beside: MappingTold) -> Option<(MappingUncertainty, Vec<String>)> {
    let [first, second] = record.cameras.as_slice() else { return None };
    let names = [first.name.as_str(), second.name.as_str()];
    let covariance = covariance_of_record(record)?;
    let sizes_px = [first, second].map(|c| c.image_size_px.map(|n| n as f64));
    let mut flags = vec![];
    let frame = record.sheet.as_ref()?.rig_from_sheet.motion();
    let sheet = SeenSheet::of(&covariance, &sizes_px, &names, Some(&frame))?;
    let found = mapping_uncertainty(&covariance, &sheet, &mut flags)?;
    let MappingTold { by_views, by_likelihood } = beside;
    Some((MappingUncertainty { by_views, by_likelihood, ..found }, flags))
}

pub(super) fn mapping_uncertainty(
    covariance: &NamedCovariance,
    SeenSheet { uncertainty, field }: &SeenSheet,
    flags: &mut Vec<String>,
) -> Option<MappingUncertainty> {
    let stereo = uncertainty.stereo();
    let mut points = field.points.clone();
    points.push(field.middle());
    let at: Option<Vec<PointUncertainty>> = gathered(true, &points, |p| uncertainty.at(*p));
    let at = at?;
    let placed = places(covariance, (&points, &at), uncertainty.names_at())?;
    let all: Vec<MappingSigma> = points
        .iter()
        .zip(placed.iter().zip(&at))
        .filter_map(|(p, (placed_mm, u))| sigmas(stereo, *p, *placed_mm, u))
        .collect();
    let (middle, over) = all.split_last()?;
    let over: Vec<&MappingSigma> = over.iter().collect();
    let undetermined = undetermined(&over);
    flags.extend(undetermined.iter().cloned());
    let largest = largest(&over)?;
    flags.extend(hardly_known(&largest));
    let ratio = |p: &[f64; 2]| stereo.noise_ratio(*p).unwrap_or(f64::INFINITY);
    let worst = field.points.iter().map(ratio).fold(0.0, f64::max);
    if worst > ONE_LINE {
        flags.push(format!(
            "both cameras look at the sheet along nearly one line: noise makes errors along it up to {worst:.0} times those across; turn one camera to the \
             other side of the sheet's normal, best 30 to 45 degrees on either side"
        ));
    }
    Some(MappingUncertainty {
        middle: middle.clone(),
        largest,
        map: map(field, &over),
        undetermined,
        by_views: None,
        by_likelihood: None,
    })
}

/// Standard deviation (root of the sum over both axes, the larger of both cameras) of the place of every point, mm, beside a common shift
/// and turn; the last point takes no part in their fit. `NaN` where nothing determines it.
fn places(
    covariance: &NamedCovariance,
    (points, at): (&[[f64; 2]], &[PointUncertainty]),
    own: &[usize],
) -> Option<Vec<f64>> {
    let mut d = DMatrix::zeros(4 * points.len(), own.len());
    for (i, u) in at.iter().enumerate() {
        d.rows_mut(4 * i, 4).copy_from(&u.derivative().rows(PLACES, 4));
    }
    let beside = beside_shift_and_turn(points, points.len() - 1, &d)?;
    let spread = &beside * DMatrix::from_fn(own.len(), own.len(), |i, j| covariance.matrix[(own[i], own[j])]);
    let is_still = |row: usize| {
        let mut by_name = DVector::zeros(covariance.names.len());
        own.iter().zip(beside.row(row).iter()).for_each(|(i, x)| by_name[*i] = *x);
        covariance.stands_still(&by_name)
    };
    let sigma = |row: usize| {
        if is_still(row) { spread.row(row).dot(&beside.row(row)).max(0.0).sqrt() } else { f64::NAN }
    };
    let of = |i: usize| {
        let [a, b] = [0, 2].map(|c| sigma(4 * i + c).hypot(sigma(4 * i + c + 1)));
        if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
    };
    Some((0..points.len()).map(of).collect())
}

/// Misplacements (columns: x, y in the first and in the second camera, point after point) beside a common shift and turn that the first of the points tell.
pub(super) fn beside_shift_and_turn(
    points: &[[f64; 2]],
    first: usize,
    misplaced: &DMatrix<f64>,
) -> Option<DMatrix<f64>> {
    let motion = rigid(points);
    let fitted = motion.rows(0, 4 * first);
    let gram = fitted.tr_mul(&fitted).try_inverse()?;
    Some(misplaced - &motion * (gram * fitted.tr_mul(&misplaced.rows(0, fitted.nrows()))))
}

/// Common shift and turn of all points in both cameras, one column each.
fn rigid(points: &[[f64; 2]]) -> DMatrix<f64> {
    DMatrix::from_fn(4 * points.len(), 3, |row, k| {
        let ([x, y], axis) = (points[row / 4], row % 2);
        match (k, axis) {
            (0, 0) | (1, 1) => 1.0,
            (2, 0) => -y,
            (2, 1) => x,
            _ => 0.0,
        }
    })
}

fn sigmas(stereo: &StereoSheet, point_mm: [f64; 2], placed_mm: f64, u: &PointUncertainty) -> Option<MappingSigma> {
    let unknown = |x: Option<f64>| x.unwrap_or(f64::NAN);
    // Pixels of the first camera per mm: root of the area ratio.
    const H_MM: f64 = 0.01;
    let at = |dx: f64, dy: f64| stereo.pixels([point_mm[0] + dx, point_mm[1] + dy]).map(|[q, _]| q);
    let (x, y) = (at(H_MM, 0.0)? - at(-H_MM, 0.0)?, at(0.0, H_MM)? - at(0.0, -H_MM)?);
    let px_per_mm = (x.x * y.y - x.y * y.x).abs().sqrt() / (2.0 * H_MM);
    Some(MappingSigma {
        point_mm,
        in_plane_px: placed_mm * px_per_mm,
        in_plane_mm: placed_mm,
        disparity_px: unknown(u.disparity_px()),
        in_plane_scale: unknown(u.in_plane_scale()),
        out_of_plane_gain: unknown(u.relative_gain()),
        displacement: (0..3).map(|i| (0..3).map(|j| unknown(u.measured_from_true(i, j))).collect()).collect(),
    })
}

/// The largest of each number; `NaN` where one point has none.
fn largest(all: &[&MappingSigma]) -> Option<MappingSigma> {
    all.first()?;
    let most = |get: &dyn Fn(&MappingSigma) -> f64| {
        all.iter().map(|m| get(m)).fold(0.0, |a: f64, b| if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) })
    };
    Some(MappingSigma {
        point_mm: [f64::NAN; 2],
        in_plane_px: most(&|m| m.in_plane_px),
        in_plane_mm: most(&|m| m.in_plane_mm),
        disparity_px: most(&|m| m.disparity_px),
        in_plane_scale: most(&|m| m.in_plane_scale),
        out_of_plane_gain: most(&|m| m.out_of_plane_gain),
        displacement: (0..3).map(|i| (0..3).map(|j| most(&|m| m.displacement[i][j])).collect()).collect(),
    })
}

fn map(field: &Field, all: &[&MappingSigma]) -> MappingMap {
    let list = |get: &dyn Fn(&MappingSigma) -> f64| -> Vec<f64> {
        let out: Vec<f64> = all.iter().map(|m| get(m)).collect();
        if out.iter().all(|x| x.is_nan()) { vec![] } else { out }
    };
    MappingMap {
        spacing_mm: field.spacing_mm,
        x_mm: all.iter().map(|m| m.point_mm[0]).collect(),
        y_mm: all.iter().map(|m| m.point_mm[1]).collect(),
        in_plane_px: list(&|m| m.in_plane_px),
        disparity_px: list(&|m| m.disparity_px),
        u_per_u: list(&|m| m.displacement[0][0]),
        w_per_w: list(&|m| m.displacement[2][2]),
        u_per_w: list(&|m| m.displacement[0][2]),
        v_per_w: list(&|m| m.displacement[1][2]),
        w_per_u: list(&|m| m.displacement[2][0]),
        v_per_v: list(&|m| m.displacement[1][1]),
        w_per_v: list(&|m| m.displacement[2][1]),
        u_per_v: list(&|m| m.displacement[0][1]),
        v_per_u: list(&|m| m.displacement[1][0]),
    }
}

/// What is determined, but not as well as measurements need.
fn hardly_known(largest: &MappingSigma) -> Vec<String> {
    let mut out = vec![];
    if largest.disparity_px > DISPARITY_LIMIT_PX {
        out.push(format!(
            "the two cameras' images lie on each other in the sheet to {} px only (one standard deviation): vectors would be put together from places that \
             far apart; correct the sheet on particle images (spivcal check), or record the target in the sheet with both cameras",
            digits(largest.disparity_px, 2)
        ));
    }
    if largest.out_of_plane_gain > GAIN_LIMIT {
        out.push(format!(
            "the out-of-plane component w is only known to {:.1} % (one standard deviation): record a target that is tilted against the sheet by a \
             few degrees, or state the lens ([focus], [camera.design])",
            100.0 * largest.out_of_plane_gain
        ));
    }
    out
}

fn undetermined(all: &[&MappingSigma]) -> Vec<String> {
    let lost = |get: &dyn Fn(&MappingSigma) -> f64| all.iter().any(|m| get(m).is_nan());
    let mut out = vec![];
    if lost(&|m| m.disparity_px) {
        out.push("nothing determines how the two cameras' images lie on each other in the sheet: record the target in the sheet with both cameras".into());
    }
    if lost(&|m| m.in_plane_px) {
        out.push(
            "nothing determines where in the sheet a pixel looks: dewarped images have no sure scale or shape".into(),
        );
    }
    if lost(&|m| m.out_of_plane_gain) {
        out.push(
            "nothing determines the out-of-plane component w (its gain relative to the in-plane scale): do not use w; record a target that is tilted \
             against the sheet by a few degrees, or state the lens ([focus], [camera.design])"
                .into(),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_hardly_known_is_told_with_its_number() {
        let of = |disparity_px: f64, out_of_plane_gain: f64| {
            let displacement = vec![vec![0.0; 3]; 3];
            let (point_mm, in_plane_px, in_plane_mm, in_plane_scale) = ([0.0; 2], 0.1, 0.01, 0.001);
            hardly_known(&MappingSigma {
                point_mm,
                in_plane_px,
                in_plane_mm,
                disparity_px,
                in_plane_scale,
                out_of_plane_gain,
                displacement,
            })
        };
        assert!(of(0.49, 0.019).is_empty());
        // What nothing determines has words of its own.
        assert!(of(f64::NAN, f64::NAN).is_empty());
        let both = of(1.26, 0.034);
        assert!(both[0].contains("1.3 px only") && both[0].contains("spivcal check"), "{}", both[0]);
        assert!(both[1].contains("only known to 3.4 %"), "{}", both[1]);
        assert_eq!(both.len(), 2);
    }
}
