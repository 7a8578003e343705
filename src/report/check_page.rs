//! The page of a check of the sheet: disparity before and after, rounds, sheet, thickness. One file, well-formed XML.

use super::number::{measured, nice_below, plain, significant, with_unit};
use super::svg::{escape, label, line, open, path, path_data};
use crate::record::{DisparityMap, SheetCheck};
use std::fmt::Write;

/// Width of a map, px of the page.
const MAP_PX: f64 = 540.0;
/// Room around a map for its labels.
const MARGIN_PX: f64 = 46.0;

/// The check as one HTML file.
pub fn check_html(check: &SheetCheck) -> String {
    let mut out = String::new();
    let names = check.cameras.each_ref().map(|c| escape(c));
    let _ = write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\" xmlns=\"http://www.w3.org/1999/xhtml\"><head><meta charset=\"utf-8\"/>\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/><title>Check of the laser sheet · spivcal</title>\
         <style>/*<![CDATA[*/\n{}/*]]>*/</style></head><body>\n<h1>Check of the laser sheet on particle images</h1>\n\
         <p class=\"sub\">{} and {} · {} image pair(s)</p>\n",
        include_str!("style.css"),
        names[0],
        names[1],
        check.pairs.len()
    );
    verdict(&mut out, check);
    out.push_str("<h2>The light against the calibrated sheet</h2>\n");
    sheet_table(&mut out, check);
    out.push_str("<h2>Disparity</h2>\n<div class=\"two\">");
    map_figure(&mut out, &check.before, "Before", check);
    if let Some(after) = &check.after {
        map_figure(&mut out, after, "After", check);
    }
    out.push_str(
        "</div>\n<p class=\"note\">Arrows: where the second camera sees the light less where the first does, in the sheet, enlarged as stated. \
         Red: windows that do not fit the plane and were left out.</p>\n",
    );
    history(&mut out, check);
    out.push_str("</body></html>\n");
    out
}

fn verdict(out: &mut String, check: &SheetCheck) {
    let before = check.before.median_px();
    let (class, word, words) = match &check.after {
        _ if !check.flags.is_empty() => ("care", "Care.", check.flags.join(" · ")),
        Some(after) => {
            let words = format!(
                "The sheet was corrected: median disparity {} px before, {} px after.",
                plain(before, 3),
                plain(after.median_px(), 2)
            );
            ("good", "Good.", words)
        }
        None => (
            "good",
            "Good.",
            format!("The light is in the calibrated sheet: median disparity {} px.", plain(before, 2)),
        ),
    };
    let _ = writeln!(
        out,
        "<section class=\"verdict {class}\"><p class=\"headline\"><b>{word}</b> {}</p></section>",
        escape(&words)
    );
}

fn row(out: &mut String, name: &str, value: &str) {
    let _ =
        writeln!(out, "<tr><th scope=\"row\">{}</th><td>{}</td></tr>", escape(name), escape(&value.replace('-', "−")));
}

fn sheet_table(out: &mut String, c: &SheetCheck) {
    out.push_str("<div class=\"wide\"><table><tbody>");
    let at = format!("offset along z at x = {}, y = {} mm", plain(c.reference_mm[0], 4), plain(c.reference_mm[1], 4));
    row(out, &at, &with_unit(c.offset_mm, c.offset_sigma_mm, "mm"));
    row(out, "tilt about x", &with_unit(c.tilt_deg[0], c.tilt_sigma_deg[0], "°"));
    row(out, "tilt about y", &with_unit(c.tilt_deg[1], c.tilt_sigma_deg[1], "°"));
    let mean = c.after.as_ref().unwrap_or(&c.before).mean_px();
    row(
        out,
        "mean disparity left, x and y",
        &format!("{} and {} px", significant(mean[0], 2), significant(mean[1], 2)),
    );
    row(out, "scatter of a window about the plane", &format!("{} px", plain(c.window_sigma_px, 2)));
    row(
        out,
        "disparity across the direction of depth (root mean square)",
        &format!("{} px", plain(c.across_rms_px, 2)),
    );
    let thickness = if c.thickness_mm.is_finite() {
        format!("{} mm (full width at 1/e²)", plain(c.thickness_mm, 2))
    } else {
        "thinner than the particle images can show".into()
    };
    row(out, "thickness of the light", &thickness);
    row(
        out,
        "the coarse plane stands out from chance by",
        &format!("{} standard deviations", plain(c.significance, 3)),
    );
    out.push_str(
        "</tbody></table></div>\n<p class=\"note\">z of the sheet frame points towards the first camera. Sigmas are those of the scatter of the \
         windows with the cameras held; the cameras' own uncertainty is in the calibration. A disparity across the direction of depth \
         is no matter of the sheet: it shows errors of the cameras.</p>\n",
    );
}

fn map_figure(out: &mut String, map: &DisparityMap, title: &str, check: &SheetCheck) {
    let limit = |list: &[f64]| list.iter().fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(*x), h.max(*x)));
    let ((x0, x1), (y0, y1)) = (limit(&map.x_mm), limit(&map.y_mm));
    let mut lengths: Vec<f64> = map.dx_px.iter().zip(&map.dy_px).map(|(x, y)| x.hypot(*y)).collect();
    lengths.sort_by(f64::total_cmp);
    let Some(typical) = lengths.get(lengths.len() * 9 / 10).copied().filter(|_| x1 > x0 && y1 > y0) else { return };
    let scale = (MAP_PX - 2.0 * MARGIN_PX) / (x1 - x0);
    let height = scale * (y1 - y0) + 2.0 * MARGIN_PX + 30.0;
    let place = |x: f64, y: f64| [MARGIN_PX + scale * (x - x0), MARGIN_PX + scale * (y1 - y)];
    // The ninth of ten arrows is about as long as the windows are apart.
    let spacing = ((x1 - x0) * (y1 - y0) / map.x_mm.len() as f64).sqrt() * scale;
    let per_px = if typical > 0.0 { 0.9 * spacing / typical } else { 1.0 };
    let mut svg = open(MAP_PX, height, &format!("{title}: disparity map"));
    for i in 0..map.x_mm.len() {
        let a = place(map.x_mm[i], map.y_mm[i]);
        let b = [a[0] + per_px * map.dx_px[i], a[1] - per_px * map.dy_px[i]];
        let class = if map.used[i] { "cam0" } else { "bad" };
        path(&mut svg, class, &path_data([a, b], false));
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = dx.hypot(dy);
        if length > 4.0 {
            let (ux, uy) = (3.0 * dx / length, 3.0 * dy / length);
            let head = [[b[0] - ux - 0.6 * uy, b[1] - uy + 0.6 * ux], b, [b[0] - ux + 0.6 * uy, b[1] - uy - 0.6 * ux]];
            path(&mut svg, class, &path_data(head, false));
        } else {
            path(&mut svg, class, &path_data([[a[0] - 0.6, a[1]], [a[0] + 0.6, a[1]]], false));
        }
    }
    let y = height - 16.0;
    let key_px = nice_below(60.0 / per_px);
    line(&mut svg, "axis", [MARGIN_PX, y], [MARGIN_PX + key_px * per_px, y]);
    label(
        &mut svg,
        "tick",
        [MARGIN_PX + key_px * per_px + 6.0, y + 4.0],
        "start",
        &format!("{} px of disparity", plain(key_px, 3)),
    );
    let bar_mm = nice_below(0.25 * (x1 - x0));
    let right = MAP_PX - MARGIN_PX;
    line(&mut svg, "axis", [right - bar_mm * scale, y], [right, y]);
    label(&mut svg, "tick", [right - bar_mm * scale - 6.0, y + 4.0], "end", &format!("{} mm", plain(bar_mm, 3)));
    svg.push_str("</svg>");
    let left_out = map.used.iter().filter(|u| !**u).count();
    let _ = writeln!(
        out,
        "<figure>{svg}<figcaption><b>{title}</b>: median {} px, {} windows ({left_out} left out); 1 px is {} mm in the sheet</figcaption></figure>",
        plain(map.median_px(), 2),
        map.x_mm.len(),
        plain(check.mm_per_px, 3)
    );
}

fn history(out: &mut String, c: &SheetCheck) {
    out.push_str(
        "<h2>Rounds</h2>\n<div class=\"wide\"><table><thead><tr><th class=\"n\">round</th><th class=\"n\">window, px</th><th class=\"n\">windows with a peak</th>\
         <th class=\"n\">median disparity before it, px</th><th class=\"n\">offset, mm</th><th class=\"n\">tilt about x</th><th class=\"n\">tilt about y</th></tr></thead><tbody>",
    );
    for (i, r) in c.history.iter().enumerate() {
        let _ = writeln!(
            out,
            "<tr><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{} of {}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
            i + 1,
            r.window_px,
            r.windows[0],
            r.windows[1],
            significant(r.median_px, 3),
            measured(r.offset_mm, c.offset_sigma_mm).split(" ±").next().unwrap_or_default().replace('-', "−"),
            format!("{:.4}°", r.tilt_deg[0]).replace('-', "−"),
            format!("{:.4}°", r.tilt_deg[1]).replace('-', "−")
        );
    }
    let rest =
        if c.converged { "The rounds came to rest." } else { "The rounds did not come to rest, or were not asked to." };
    let _ = writeln!(
        out,
        "</tbody></table></div>\n<p class=\"note\">Before the first round a coarse plane was found by dewarping both cameras on many planes. {rest}</p>"
    );
}
