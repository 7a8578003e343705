//! Residuals as pictures: rms per view as bars, shifts over the sensor as arrows.

use super::number::{nice_below, plain};
use super::svg::{label, line, num, open, path, path_data};
use crate::record::{Camera, FeatureKind, Record, ResidualTable};
use nalgebra::{Matrix2, Vector2};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Cameras with a colour of their own; later ones share them in turn.
pub(super) const COLOURS: usize = 4;
/// Arrows beyond this number are averaged in cells.
const MOST_ARROWS: usize = 1200;
/// Cells along the longer side of the sensor where arrows are averaged.
const CELLS: f64 = 36.0;
/// A mean arrow is this part of the sensor's diagonal.
const ARROW_PART: f64 = 0.03;

/// Bars of the residual rms, one group per view, one bar per camera.
pub(super) fn bars(record: &Record) -> String {
    let (views, cameras) = (&record.views, &record.cameras);
    let (width, height, left, bottom, top) = (960.0, 240.0, 52.0, 40.0, 14.0);
    let highest = views.iter().flat_map(|v| v.rms_px.values()).copied().filter(|x| x.is_finite()).fold(0.0, f64::max);
    let mut out = open(width, height, "Residual rms of the places of discs per view and camera, px");
    let tick = nice_below(highest.max(1e-9) / 2.5);
    let top_px = tick * (highest / tick + 0.15).ceil().max(1.0);
    let y = |x: f64| height - bottom - (height - bottom - top) * x / top_px;
    for i in 0..=(top_px / tick).round() as usize {
        let x = i as f64 * tick;
        line(&mut out, "grid", [left, y(x)], [width, y(x)]);
        label(&mut out, "tick", [left - 6.0, y(x) + 4.0], "end", &plain(x, 2));
    }
    label(&mut out, "tick", [left - 6.0, height - 8.0], "end", "view");
    let slot = (width - left) / views.len().max(1) as f64;
    let bar = (0.76 * slot / cameras.len().max(1) as f64).min(38.0);
    let skip = (30.0 / slot).ceil().max(1.0) as usize;
    for (i, v) in views.iter().enumerate() {
        let middle = left + slot * (i as f64 + 0.5);
        for (k, c) in cameras.iter().enumerate() {
            let Some(&rms) = v.rms_px.get(&c.name).filter(|x| x.is_finite()) else { continue };
            let x0 = middle + bar * (k as f64 - 0.5 * cameras.len() as f64);
            let (w, h) = ((bar - 1.5).max(0.5), y(0.0) - y(rms));
            let tip = super::svg::escape(&format!("view {}, {}: {} px", v.index, c.name, plain(rms, 3)));
            let faded = if v.used { "" } else { " faded" };
            let _ = write!(
                out,
                "<rect class=\"bar cam{}{faded}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"><title>{tip}</title></rect>",
                k % COLOURS,
                num(x0),
                num(y(rms)),
                num(w),
                num(h)
            );
            if bar >= 28.0 {
                label(&mut out, "small", [x0 + 0.5 * w, y(rms) - 4.0], "middle", &plain(rms, 2));
            }
        }
        if i % skip == 0 {
            label(&mut out, "tick", [middle, height - bottom + 16.0], "middle", &v.index.to_string());
        }
        let remark = if v.in_sheet {
            "in sheet"
        } else if v.used {
            ""
        } else {
            "unused"
        };
        if slot > 52.0 && !remark.is_empty() {
            label(&mut out, "small", [middle, height - 8.0], "middle", remark);
        }
    }
    line(&mut out, "axis", [left, y(0.0)], [width, y(0.0)]);
    out.push_str("</svg>");
    out
}

/// Mean shift of one disc in one image, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    pub(super) at_px: [f64; 2],
    pub(super) by_px: [f64; 2],
}

#[derive(Default)]
struct Sums {
    n: f64,
    at: [f64; 2],
    normal: Matrix2<f64>,
    right: Vector2<f64>,
}

/// Shift of every disc of a camera, observed less predicted.
///
/// Edge points tell only the part normal to the contour: the shift is the least-squares one, `sum n n' s = sum n r`.
/// Outliers are left out; so are discs whose edge points all look in one direction.
pub(super) fn disc_shifts(table: &ResidualTable, camera: usize) -> Vec<Shift> {
    let mut groups: BTreeMap<_, Sums> = BTreeMap::new();
    for i in 0..table.len() {
        let Some(row) = table.row(i).filter(|r| r.camera == camera) else { continue };
        let d = Vector2::new(row.du_px, row.dv_px);
        if table.outlier(i).is_some() || !(d.norm().is_finite() && row.u_px.is_finite() && row.v_px.is_finite()) {
            continue;
        }
        let sums = groups.entry((row.view, row.disc)).or_default();
        let projector = match row.kind {
            FeatureKind::Edge if d.norm() > 0.0 => d * d.transpose() / d.norm_squared(),
            FeatureKind::Edge => continue,
            _ => Matrix2::identity(),
        };
        sums.n += 1.0;
        sums.at[0] += row.u_px;
        sums.at[1] += row.v_px;
        sums.normal += projector;
        sums.right += d;
    }
    let shifts = groups.into_values().filter_map(|s| {
        // With n unit normals all around, both eigenvalues are n / 2.
        let inverse = s.normal.try_inverse().filter(|_| s.normal.determinant() > 1e-3 * s.n * s.n)?;
        let by = inverse * s.right;
        Some(Shift { at_px: s.at.map(|x| x / s.n), by_px: [by.x, by.y] })
    });
    shifts.collect()
}

/// Means over square cells, for sensors with too many shifts to see.
fn averaged(shifts: &[Shift], size_px: [f64; 2]) -> Vec<Shift> {
    let cell = size_px[0].max(size_px[1]) / CELLS;
    let mut cells: BTreeMap<(i64, i64), (f64, [f64; 4])> = BTreeMap::new();
    for s in shifts {
        let (n, sum) = cells.entry(((s.at_px[1] / cell) as i64, (s.at_px[0] / cell) as i64)).or_default();
        *n += 1.0;
        for (sum, x) in sum.iter_mut().zip([s.at_px[0], s.at_px[1], s.by_px[0], s.by_px[1]]) {
            *sum += x;
        }
    }
    cells.into_values().map(|(n, s)| Shift { at_px: [s[0] / n, s[1] / n], by_px: [s[2] / n, s[3] / n] }).collect()
}

/// Shifts of the discs over one sensor as enlarged arrows, with a caption.
pub(super) fn field(camera: &Camera, index: usize, table: &ResidualTable) -> (String, String) {
    let size = camera.image_size_px.map(|n| n as f64);
    let mut shifts = disc_shifts(table, index);
    let discs = shifts.len();
    let averaged_over = discs > MOST_ARROWS;
    if averaged_over {
        shifts = averaged(&shifts, size);
    }
    let (width, bottom) = (470.0, 30.0);
    let scale = width / size[0];
    let height = size[1] * scale;
    let mut out = open(width, height + bottom, &format!("Shifts of the discs on the sensor of {}", camera.name));
    let _ = write!(
        out,
        "<rect class=\"sensor\" x=\"0.5\" y=\"0.5\" width=\"{}\" height=\"{}\"/>",
        num(width - 1.0),
        num(height - 1.0)
    );
    let mean =
        (shifts.iter().map(|s| s.by_px[0].powi(2) + s.by_px[1].powi(2)).sum::<f64>() / discs_or_one(&shifts)).sqrt();
    // From px of residual to px of the drawing.
    let gain = if mean > 0.0 { ARROW_PART * width.hypot(height) / mean } else { 0.0 };
    let mut data = String::new();
    for s in &shifts {
        // The centre of the first pixel is half a pixel inside the sensor's corner.
        let at = s.at_px.map(|x| (x + 0.5) * scale);
        data.push_str(&arrow(at, s.by_px.map(|d| d * gain)));
    }
    path(&mut out, &format!("field cam{}", index % COLOURS), &data);
    let caption = if discs == 0 {
        "no disc with a residual".to_string()
    } else {
        let key = nice_below(width * 0.3 / gain.max(1e-12));
        let y = height + 18.0;
        path(&mut out, "key", &arrow([8.0, y], [key * gain, 0.0]));
        label(&mut out, "tick", [key * gain + 16.0, y + 4.0], "start", &format!("{} px", plain(key, 2)));
        let what = if averaged_over { "means over cells of the sensor" } else { "one arrow per disc and view" };
        format!("{discs} discs, {what}; rms shift {} px", plain(mean, 2))
    };
    out.push_str("</svg>");
    (out, caption)
}

fn discs_or_one(shifts: &[Shift]) -> f64 {
    shifts.len().max(1) as f64
}

/// Path data of an arrow with a head that grows with it.
fn arrow(from: [f64; 2], by: [f64; 2]) -> String {
    let to = [from[0] + by[0], from[1] + by[1]];
    let k = (4.0 / by[0].hypot(by[1]).max(1e-9)).min(0.35);
    let wing = |side: f64| [to[0] - k * (by[0] + 0.45 * side * by[1]), to[1] - k * (by[1] - 0.45 * side * by[0])];
    path_data([from, to], false) + &path_data([wing(1.0), to, wing(-1.0)], false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Residual;
    use crate::target::DotId;

    #[test]
    fn edge_residuals_give_the_shift_of_the_disc() {
        let (shift, disc) = (Vector2::new(0.3, -0.1), DotId { column: 2, row: -1, level: 0 });
        let mut table = ResidualTable::default();
        for i in 0..40 {
            let (s, c) = (i as f64 * 0.16).sin_cos();
            let n = Vector2::new(c, s);
            let r = n.dot(&shift);
            let row = Residual {
                view: 1,
                camera: 0,
                disc,
                kind: FeatureKind::Edge,
                u_px: 100.0 + 20.0 * c,
                v_px: 50.0 + 20.0 * s,
                du_px: r * c,
                dv_px: r * s,
                normal_px: r,
                sigma_px: 0.03,
                weight: 1.0,
            };
            table.push(&row, None);
            table.push(&Residual { du_px: 40.0, dv_px: 3.0, ..row }, Some("far off"));
            table.push(&Residual { camera: 1, ..row }, None);
        }
        let found = disc_shifts(&table, 0);
        assert_eq!(found.len(), 1);
        assert!((found[0].by_px[0] - 0.3).abs() < 1e-12 && (found[0].by_px[1] + 0.1).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn a_contour_seen_from_one_side_has_no_shift() {
        let mut table = ResidualTable::default();
        for i in 0..5 {
            let row = Residual {
                view: 0,
                camera: 0,
                disc: DotId { column: 0, row: 0, level: 0 },
                kind: FeatureKind::Edge,
                u_px: 1.0,
                v_px: i as f64,
                du_px: 0.1,
                dv_px: 0.0,
                normal_px: 0.1,
                sigma_px: 0.1,
                weight: 1.0,
            };
            table.push(&row, None);
        }
        assert!(disc_shifts(&table, 0).is_empty());
    }
}
