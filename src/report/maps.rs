//! Maps over the sheet: what the uncertainty of the calibration does where.

use super::number::{plain, significant};
use super::svg::{bounds, colour, label, num, open};
use crate::record::{MappingByViews, MappingUncertainty};
use std::fmt::Write;

/// A map with its words.
pub(super) struct Map {
    /// Picture.
    pub(super) svg: String,
    /// What it shows.
    pub(super) caption: String,
}

/// Stops of the colour scale, dark (small) to light (large); equal steps in lightness.
const STOPS: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];

/// The maps of everything that is determined.
pub(super) fn maps(m: &MappingUncertainty) -> Vec<Map> {
    let map = &m.map;
    let beyond_noise = m.by_views.as_ref().filter(|v| v.beyond_noise);
    let told = |of: &dyn Fn(&MappingByViews) -> f64| beyond_noise.map_or(f64::NAN, of);
    let entry = |i: usize, j: usize| told(&|v| v.displacement[i][j]);
    let (disparity, place) = (told(&|v| v.disparity), told(&|v| v.in_plane));
    let all: [(&[f64], f64, &str, &str, f64); 9] = [
        (&map.disparity_px, 1.0, "px", "Disparity: how far the two cameras' dewarped images lie apart", disparity),
        (&map.in_plane_px, 1.0, "px", "Place: where in the sheet a pixel looks, beside a common shift and turn", place),
        (&map.u_per_u, 100.0, "%", "Error of u, in % of u", entry(0, 0)),
        (&map.v_per_v, 100.0, "%", "Error of v, in % of v", entry(1, 1)),
        (&map.w_per_w, 100.0, "%", "Error of w, in % of w", entry(2, 2)),
        (&map.u_per_w, 100.0, "%", "Leak into u, in % of w", entry(0, 2)),
        (&map.v_per_w, 100.0, "%", "Leak into v, in % of w", entry(1, 2)),
        (&map.w_per_u, 100.0, "%", "Leak into w, in % of u", entry(2, 0)),
        (&map.w_per_v, 100.0, "%", "Leak into w, in % of v", entry(2, 1)),
    ];
    let drawn = all.into_iter().filter(|(values, ..)| values.len() == map.x_mm.len() && !values.is_empty());
    drawn
        .map(|(values, factor, unit, title, by_views)| {
            let shown: Vec<f64> = values.iter().map(|v| v * factor).collect();
            let larger = if by_views > 1.0 {
                format!("; the views tell {} times as much", plain(by_views, 2))
            } else {
                String::new()
            };
            Map { svg: picture(m, &shown, unit, title), caption: format!("{title}{larger}") }
        })
        .collect()
}

fn picture(m: &MappingUncertainty, values: &[f64], unit: &str, title: &str) -> String {
    let [dx, dy] = m.map.spacing_mm;
    let ([x0, x1], [y0, y1]) = (bounds(&m.map.x_mm), bounds(&m.map.y_mm));
    let (left, top, width, gap) = (44.0, 8.0, 300.0, 58.0);
    // One scale for both axes; a long field keeps a sensible height.
    let scale = (width / (x1 - x0 + dx).max(1e-9)).min(300.0 / (y1 - y0 + dy).max(1e-9));
    let height = (y1 - y0 + dy) * scale;
    let at = |x: f64, y: f64| [left + (x - x0 + 0.5 * dx) * scale, top + (y1 - y + 0.5 * dy) * scale];
    let mut out = open(left + width + 8.0, top + height + gap, title);
    let [low, high] = bounds(values);
    // Differences below a percent are no pattern.
    let span = (high - low).max(0.01 * high.abs()).max(f64::MIN_POSITIVE);
    for ((x, y), v) in m.map.x_mm.iter().zip(&m.map.y_mm).zip(values).filter(|(_, v)| v.is_finite()) {
        let [px, py] = at(x - 0.5 * dx, y + 0.5 * dy);
        let _ = write!(
            out,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" style=\"fill:{}\"/>",
            num(px),
            num(py),
            num(dx * scale + 0.3),
            num(dy * scale + 0.3),
            colour(&STOPS, (v - low) / span)
        );
    }
    for (x, anchor) in [(x0, "middle"), (x1, "middle")] {
        label(&mut out, "tick", [at(x, 0.0)[0], top + height + 15.0], anchor, &plain(x, 3));
    }
    label(&mut out, "tick", [at(0.5 * (x0 + x1), 0.0)[0], top + height + 15.0], "middle", "x, mm");
    for y in [y0, y1] {
        label(&mut out, "tick", [left - 5.0, at(0.0, y)[1] + 4.0], "end", &plain(y, 3));
    }
    label(&mut out, "tick", [left - 5.0, at(0.0, 0.5 * (y0 + y1))[1] + 4.0], "end", "y, mm");
    let bar = 120.0;
    for k in 0..40 {
        let x = left + 60.0 + bar * f64::from(k) / 40.0;
        let _ = write!(
            out,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"10\" style=\"fill:{}\"/>",
            num(x),
            num(top + height + 30.0),
            num(bar / 40.0 + 0.3),
            colour(&STOPS, f64::from(k) / 39.0)
        );
    }
    let y = top + height + 39.0;
    label(&mut out, "tick", [left + 54.0, y], "end", &significant(low, 2));
    label(&mut out, "tick", [left + 66.0 + bar, y], "start", &format!("{} {unit}", significant(high, 2)));
    out.push_str("</svg>");
    out
}
