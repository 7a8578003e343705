//! The page of a check of the sheet: disparity before and after, rounds, sheet, thickness. One file, well-formed XML.

use super::number::{measured, nice_below, plain, significant, with_unit};
use super::svg::{escape, label, line, open, path, path_data};
use crate::record::{CamerasRefined, DisparityMap, LightProfile, SheetCheck};
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
                "The sheet was corrected: median disparity {} px before, {} px after. {}",
                plain(before, 3),
                plain(after.median_px(), 2),
                left_over(check)
            );
            ("good", "Good.", words)
        }
        None => (
            "good",
            "Good.",
            format!(
                "The light is in the calibrated sheet: median disparity {} px. {}",
                plain(before, 2),
                left_over(check)
            ),
        ),
    };
    let _ = writeln!(
        out,
        "<section class=\"verdict {class}\"><p class=\"headline\"><b>{word}</b> {}</p></section>",
        escape(&words)
    );
}

/// What of the disparities is the sheet's, and what is scatter.
fn left_over(check: &SheetCheck) -> String {
    let m = check.misalignment_after.as_ref().unwrap_or(&check.misalignment_before);
    let part = |a: usize| {
        let beside = plain(m.smooth_noise_px[a], 2);
        match m.smooth_px[a] {
            s if s > m.smooth_noise_px[a] => format!("{} px (scatter alone gives {beside})", plain(s, 2)),
            s if s.is_finite() => format!("no more than scatter gives ({beside} px)"),
            _ => "too few windows to tell".into(),
        }
    };
    format!(
        "Left smooth over the field: along the direction of depth {}, across it {}. Single windows scatter by {} and {} px.",
        part(0),
        part(1),
        plain(m.scatter_px[0], 2),
        plain(m.scatter_px[1], 2)
    )
}

fn row(out: &mut String, name: &str, value: &str) {
    let _ =
        writeln!(out, "<tr><th scope=\"row\">{}</th><td>{}</td></tr>", escape(name), escape(&value.replace('-', "−")));
}

fn sheet_table(out: &mut String, c: &SheetCheck) {
    out.push_str("<div class=\"wide\"><table class=\"facts\"><tbody>");
    let at = format!("offset along z at x = {}, y = {} mm", plain(c.reference_mm[0], 4), plain(c.reference_mm[1], 4));
    row(out, &at, &with_unit(c.offset_mm, c.offset_sigma_mm, "mm"));
    row(out, "tilt about x", &with_unit(c.tilt_deg[0], c.tilt_sigma_deg[0], "°"));
    row(out, "tilt about y", &with_unit(c.tilt_deg[1], c.tilt_sigma_deg[1], "°"));
    row(
        out,
        "of these sigmas, by the scatter of the windows",
        &format!(
            "{} mm, {}° and {}°",
            plain(c.offset_sigma_windows_mm, 2),
            plain(c.tilt_sigma_windows_deg[0], 2),
            plain(c.tilt_sigma_windows_deg[1], 2)
        ),
    );
    let m = c.misalignment_after.as_ref().unwrap_or(&c.misalignment_before);
    row(out, "median disparity left along x", &with_unit(m.median_px[0], m.median_sigma_px[0], "px"));
    row(out, "median disparity left along y", &with_unit(m.median_px[1], m.median_sigma_px[1], "px"));
    for (a, name) in ["along the direction of depth (the sheet)", "across it (the cameras)"].iter().enumerate() {
        row(
            out,
            &format!("smooth disparity left {name}, root mean square"),
            &format!("{} px; scatter alone gives {} px", plain(m.smooth_px[a], 2), plain(m.smooth_noise_px[a], 2)),
        );
    }
    row(
        out,
        "scatter of single windows along the direction of depth, and across it",
        &format!("{} and {} px", plain(m.scatter_px[0], 2), plain(m.scatter_px[1], 2)),
    );
    let thickness = if c.thickness_mm.is_finite() {
        format!("{} mm (full width at 1/e²)", plain(c.thickness_mm, 2))
    } else {
        "not seen: thinner than the particle images, or too few windows tell of it".into()
    };
    row(out, "thickness of the light", &thickness);
    if let Some(p) = &c.profile {
        row(
            out,
            "the light is brightest, and has its centre of gravity, from the plane found at z =",
            &format!("{} and {} mm", plain(p.top_mm, 2), plain(p.middle_mm, 2)),
        );
    }
    row(
        out,
        "the coarse plane stands out from chance by",
        &format!("{} standard deviations", plain(c.significance, 3)),
    );
    let held = if c.sigmas_hold_calibration {
        "Sigmas hold the scatter of the windows and the calibration's covariance."
    } else {
        "Sigmas are those of the scatter of the windows alone: the calibration states no covariance for what they need."
    };
    let _ = write!(
        out,
        "</tbody></table></div>\n<p class=\"note\">z of the sheet frame points towards the first camera. {held} A window holds few particles, \
         which lie anywhere in the thickness of the light, so that it scatters along the direction of depth in the right sheet, too: by the light's \
         depth over the root of the number of particles. The median length of the arrows tells that; the smooth part and the medians with their signs \
         tell how far the sheet is off. A smooth disparity across the direction of depth is no matter of the sheet: it shows errors of the \
         cameras.</p>\n"
    );
    if let Some(p) = &c.profile {
        profile_figure(out, p);
    }
    if let Some(r) = &c.cameras_refined {
        cameras_table(out, r);
    }
}

/// What the particles did to the cameras.
fn cameras_table(out: &mut String, r: &CamerasRefined) {
    let together = if r.degrees > 0 {
        format!(
            "Together: chi-square {} of {} directions of which the particles tell at least as much as the calibration (chance {}).",
            plain(r.chi2, 3),
            r.degrees,
            plain(r.chance, 2)
        )
    } else {
        "The particles tell nothing of the cameras that the calibration did not know better.".into()
    };
    let _ = write!(
        out,
        "<h3>Cameras, corrected with the sheet</h3>\n<p>What no sheet explains was weighed against the covariance of the calibration. {}</p>\n\
         <div class=\"wide\"><table><thead><tr><th>number</th><th>change</th><th>in sigmas of the calibration</th><th>sigma before</th>\
         <th>sigma after</th></tr></thead><tbody>",
        escape(&together)
    );
    for n in &r.numbers {
        let cell = |x: f64| escape(&plain(x, 3).replace('-', "−")).to_string();
        let _ = writeln!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&n.name),
            cell(n.change),
            cell(n.change_sigmas),
            cell(n.sigma_before),
            cell(n.sigma_after)
        );
    }
    out.push_str("</tbody></table></div>\n");
}

/// The light along the normal.
fn profile_figure(out: &mut String, p: &LightProfile) {
    let lit = || (0..p.z_mm.len()).filter(|i| p.light[*i] > 0.02);
    let reach = lit().map(|i| (p.z_mm[i] - p.top_mm).abs()).fold(0.0, f64::max).min(4.0 * width_mm(p)).max(1e-6);
    let (low, high) = (p.top_mm - reach, p.top_mm + reach);
    let (width, height) = (MAP_PX, 190.0);
    let place = |z: f64, l: f64| {
        [MARGIN_PX + (z - low) / (high - low) * (width - 2.0 * MARGIN_PX), height - 34.0 - 130.0 * l.max(0.0)]
    };
    let mut svg = open(width, height, "The light along the normal of the sheet");
    let points = (0..p.z_mm.len()).filter(|i| (low..=high).contains(&p.z_mm[*i])).map(|i| place(p.z_mm[i], p.light[i]));
    let ends = [place(high, 0.0), place(low, 0.0)];
    path(&mut svg, "sheet", &path_data(points.chain(ends), true));
    line(&mut svg, "axis", place(low, 0.0), place(high, 0.0));
    for (z, class) in [(0.0, "axis"), (p.top_mm, "grid"), (p.middle_mm, "grid")] {
        line(&mut svg, class, place(z, 0.0), place(z, 1.05));
    }
    let step = nice_below(0.5 * (high - low));
    for k in -4..=4 {
        let z = f64::from(k) * 0.5 * step;
        if z > low && z < high {
            let [x, y] = place(z, 0.0);
            label(&mut svg, "tick", [x, y + 16.0], "middle", &plain(z, 3).replace('-', "−"));
        }
    }
    label(&mut svg, "tick", [width - MARGIN_PX, height - 4.0], "end", "z, mm");
    svg.push_str("</svg>");
    let _ = writeln!(
        out,
        "<div class=\"two\"><figure>{svg}<figcaption><b>The light along the normal</b> of the plane found (z = 0), as both cameras' images correlate, all windows \
         together; brightest at {} mm, centre of gravity at {} mm. Where the two are apart, the place of the light is no better defined than \
         that.</figcaption></figure></div>",
        plain(p.top_mm, 2).replace('-', "−"),
        plain(p.middle_mm, 2).replace('-', "−")
    );
}

/// Full width at half of the maximum, mm.
fn width_mm(p: &LightProfile) -> f64 {
    let step = p.z_mm.get(1).map_or(0.0, |z| z - p.z_mm[0]);
    step * p.light.iter().filter(|l| **l > 0.5).count() as f64
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
