//! What errors of the calibration do to measurements, over the part of the sheet that both cameras see.
//!
//! Displacements, disparity and gain come from [`SheetUncertainty`]. The place in the sheet that a pixel is mapped to is stated beside a
//! common shift and turn of the sheet frame, which a user chooses anyway (the frame's origin is where the first lens axis meets the
//! sheet, and an uncertain axis point moves it along the sheet without moving anything else):
//! ```text
//! e_i = misplacement of point i in a camera,  e' = e - (shift, turn) fitted to all points of both cameras,  C' = P D C D^T P^T
//! ```

use crate::bundle::NamedCovariance;
use crate::frames::{Rig, Sheet};
use crate::record::{MappingMap, MappingSigma, MappingUncertainty, Record};
use crate::rigid::Motion;
use crate::sheet::{PointUncertainty, SheetUncertainty, StereoSheet, covariance_of_record};
use crate::threads::gathered;
use nalgebra::{DMatrix, DVector, Vector2};

/// Points along the longer and the shorter side of what both cameras see.
const COLUMNS: usize = 19;
const ROWS: usize = 13;
/// Ratio of errors along and across the lines of sight that is worth a warning: less than 12 degrees between them.
const ONE_LINE: f64 = 10.0;
/// Relative out-of-plane gain that is worth a warning: 2 % of w.
const GAIN_LIMIT: f64 = 0.02;

/// Points of the sheet that both cameras see, and the distances of the grid they are taken from.
struct Field {
    points: Vec<[f64; 2]>,
    spacing_mm: [f64; 2],
}

/// What a record says of it anew, after its sheet or its cameras were refined; with what must be told. `None` where its covariance does not
/// name the sheet, or does not determine cameras and sheet.
pub fn mapping_of_record(record: &Record) -> Option<(MappingUncertainty, Vec<String>)> {
    let [first, second] = record.cameras.as_slice() else { return None };
    let names = [first.name.as_str(), second.name.as_str()];
    let covariance = covariance_of_record(record)?;
    let sizes_px = [first, second].map(|c| c.image_size_px.map(|n| n as f64));
    let mut flags = vec![];
    let frame = record.sheet.as_ref()?.rig_from_sheet.motion();
    let found = mapping_uncertainty(&covariance, &sizes_px, &names, Some(&frame), &mut flags)?;
    Some((found, flags))
}

/// Told in the frame of the sheet that is given, or else in the one that goes with the plane.
pub(super) fn mapping_uncertainty(
    covariance: &NamedCovariance,
    sizes_px: &[[f64; 2]],
    names: &[&str],
    frame: Option<&Motion<Rig, Sheet>>,
    flags: &mut Vec<String>,
) -> Option<MappingUncertainty> {
    let [first, second] = *names else { return None };
    let own = StereoSheet::of(covariance)?;
    let uncertainty =
        SheetUncertainty::about(frame.map_or(own, |frame| own.told_in(frame)), covariance, [first, second]);
    let stereo = *uncertainty.stereo();
    let field = field(&stereo, sizes_px)?;
    let mut points = field.points.clone();
    let n = points.len() as f64;
    points.push([points.iter().map(|p| p[0]).sum::<f64>() / n, points.iter().map(|p| p[1]).sum::<f64>() / n]);
    let at: Option<Vec<PointUncertainty>> = gathered(true, &points, |p| uncertainty.at(*p));
    let at = at?;
    let placed = places(covariance, (&points, &at), uncertainty.names_at())?;
    let all: Vec<MappingSigma> = points
        .iter()
        .zip(placed.iter().zip(&at))
        .filter_map(|(p, (placed_mm, u))| sigmas(&stereo, *p, *placed_mm, u))
        .collect();
    let (middle, over) = all.split_last()?;
    let over: Vec<&MappingSigma> = over.iter().collect();
    let undetermined = undetermined(&over);
    flags.extend(undetermined.iter().cloned());
    let largest = largest(&over)?;
    if largest.out_of_plane_gain > GAIN_LIMIT {
        flags.push(format!(
            "the out-of-plane component w is only known to {:.1} % (one standard deviation): record a target that is tilted against the sheet by a \
             few degrees, or state the lens ([focus], [camera.design])",
            100.0 * largest.out_of_plane_gain
        ));
    }
    let ratio = |p: &[f64; 2]| stereo.noise_ratio(*p).unwrap_or(f64::INFINITY);
    let worst = field.points.iter().map(ratio).fold(0.0, f64::max);
    if worst > ONE_LINE {
        flags.push(format!(
            "both cameras look at the sheet along nearly one line: noise makes errors along it up to {worst:.0} times those across; turn one camera to the \
             other side of the sheet's normal, best 30 to 45 degrees on either side"
        ));
    }
    Some(MappingUncertainty { middle: middle.clone(), largest, map: map(&field, &over), undetermined })
}

fn field(stereo: &StereoSheet, sizes_px: &[[f64; 2]]) -> Option<Field> {
    let size = |c: usize| sizes_px.get(c).copied();
    let (first, second) = (size(0)?, size(1)?);
    let inside = |q: &Vector2<f64>, size: [f64; 2]| {
        (-0.5..=size[0] - 0.5).contains(&q.x) && (-0.5..=size[1] - 0.5).contains(&q.y)
    };
    let seen = |p: [f64; 2]| stereo.pixels(p).is_some_and(|[a, b]| inside(&a, first) && inside(&b, second));
    // The first camera's border on the sheet.
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for k in 0..=8 {
        let t = f64::from(k) / 8.0;
        for q in [[t, 0.0], [t, 1.0], [0.0, t], [1.0, t]] {
            let p = stereo.point_at(0, &Vector2::new(q[0] * (first[0] - 1.0), q[1] * (first[1] - 1.0)))?;
            for a in 0..2 {
                low[a] = low[a].min(p[a]);
                high[a] = high[a].max(p[a]);
            }
        }
    }
    let grid = |low: [f64; 2], high: [f64; 2]| {
        let wide = high[0] - low[0] >= high[1] - low[1];
        let counts = if wide { [COLUMNS, ROWS] } else { [ROWS, COLUMNS] };
        let spacing_mm = [0, 1].map(|a| (high[a] - low[a]) / counts[a] as f64);
        let at = |a: usize, k: usize| low[a] + (k as f64 + 0.5) * spacing_mm[a];
        let all = (0..counts[1]).flat_map(|j| (0..counts[0]).map(move |i| (i, j)));
        let points: Vec<[f64; 2]> = all.map(|(i, j)| [at(0, i), at(1, j)]).filter(|p| seen(*p)).collect();
        Field { points, spacing_mm }
    };
    // Once over all of the first camera, once over what was common.
    let coarse = grid(low, high);
    for a in 0..2 {
        let bounds = coarse.points.iter().map(|p| p[a]);
        let (l, h) = bounds.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        low[a] = low[a].max(l - coarse.spacing_mm[a]);
        high[a] = high[a].min(h + coarse.spacing_mm[a]);
    }
    let fine = grid(low, high);
    (fine.points.len() > 3).then_some(fine)
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
        d.rows_mut(4 * i, 4).copy_from(u.misplaced_by());
    }
    let motion = rigid(points);
    let fitted = motion.rows(0, 4 * (points.len() - 1));
    let gram = fitted.tr_mul(&fitted).try_inverse()?;
    let beside = &d - &motion * (gram * fitted.tr_mul(&d.rows(0, fitted.nrows())));
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
    }
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
