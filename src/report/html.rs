//! The self-contained report: one page, nothing to load, no script; also well-formed XML.

use super::figures::{self, Figure};
use super::number::{plain, significant};
use super::overlay::{self, OverlayShapes};
use super::plots::{self, COLOURS};
use super::space;
use super::svg::escape;
use super::tables::{self, LONGEST_LIST, Table};
use super::verdict::{Level, sentence, verdict};
use super::{diagnosis, maps};
use crate::error::Result;
use crate::image::GrayView;
use crate::record::{Record, ResidualTable, View};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Correlations below this are no news.
const CORRELATION: f64 = 0.9;

/// One image with what was found in it.
#[derive(Debug, Clone, Copy)]
pub struct OverlayInput<'a> {
    /// View, as [`View::index`].
    pub view: usize,
    /// Camera, position in [`Record::cameras`].
    pub camera: usize,
    /// The image.
    pub image: GrayView<'a>,
    /// What is drawn on it.
    pub shapes: &'a OverlayShapes,
}

/// The report as one HTML file.
///
/// Numbers come from the record alone, pictures of residuals from the table, backgrounds from the images (shrunk).
/// Names are escaped, whatever they hold. Equal inputs give equal bytes.
///
/// # Errors
/// [`crate::Error::Bug`] where a background cannot be encoded.
pub fn write_html(record: &Record, overlays: &[OverlayInput<'_>], residuals: &ResidualTable) -> Result<String> {
    let mut out = String::new();
    head(&mut out, record);
    verdict_box(&mut out, record);
    space_section(&mut out, record);
    sheet_section(&mut out, record);
    mapping_section(&mut out, record);
    camera_section(&mut out, record);
    diagnosis_section(&mut out, record);
    residual_section(&mut out, record, residuals);
    outlier_section(&mut out, record, residuals);
    overlay_section(&mut out, record, overlays)?;
    correlation_section(&mut out, record);
    provenance_section(&mut out, record);
    out.push_str("</body></html>\n");
    Ok(out)
}

fn head(out: &mut String, r: &Record) {
    let names: Vec<_> = r.cameras.iter().map(|c| escape(&c.name)).collect();
    let rig = if r.provenance.rig_file.is_empty() {
        String::new()
    } else {
        format!("<code>{}</code> · ", escape(&r.provenance.rig_file))
    };
    let title = if r.sheet.is_some() { "Calibration in the laser sheet" } else { "Camera calibration" };
    let _ = write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\" xmlns=\"http://www.w3.org/1999/xhtml\"><head><meta charset=\"utf-8\"/>\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/><title>{title}: {} · spivcal</title>\
         <style>/*<![CDATA[*/\n{}/*]]>*/</style></head><body>\n<h1>{title}</h1>\n<p class=\"sub\">{rig}{} · {} views · target {}</p>\n",
        names.join(", "),
        include_str!("style.css"),
        names.join(", "),
        r.views.len(),
        escape(&r.target.kind)
    );
}

fn list(out: &mut String, title: &str, items: &[String]) {
    let _ = write!(out, "<div><h3>{title}</h3><ul>");
    for item in items {
        let _ = write!(out, "<li>{}</li>", escape(item));
    }
    out.push_str("</ul></div>\n");
}

fn verdict_box(out: &mut String, r: &Record) {
    let v = verdict(r);
    let (class, word) = match v.level {
        Level::Good => ("good", "Good."),
        Level::Care => ("care", "Care."),
        Level::Bad => ("bad", "Do not use."),
    };
    let headline = v.headline.strip_prefix("Do not use this calibration: ").unwrap_or(&v.headline);
    let _ = writeln!(
        out,
        "<section class=\"verdict {class}\"><p class=\"headline\"><b>{word}</b> {}</p><div class=\"three\">",
        escape(headline)
    );
    list(out, "Determined", &v.determined);
    list(out, "Not determined", &v.open);
    list(out, "What to do next", &v.next);
    out.push_str("</div></section>\n");
}

fn camera_keys(r: &Record) -> String {
    r.cameras
        .iter()
        .enumerate()
        .map(|(k, c)| format!("<span class=\"key cam{}\"></span>{}", k % COLOURS, escape(&c.name)))
        .collect()
}

fn space_section(out: &mut String, r: &Record) {
    let [whole, near] = space::pictures(r);
    let sheet = if r.sheet.is_some() {
        "Green: the laser sheet. Dashed: what each camera sees of it"
    } else {
        "Dashed: what each camera sees at the mean distance of the target"
    };
    let poses = if r.views.iter().any(|v| v.in_sheet) {
        "grey: target poses, green those in the sheet"
    } else {
        "grey: target poses"
    };
    let _ = write!(
        out,
        "<h2>Cameras and sheet in space</h2>\n<div class=\"two\"><figure>{whole}<figcaption>{} · The rig frame (x right, y down, z forward) stands at the first camera; dashed black: baseline.</figcaption></figure>\n\
         <figure>{near}<figcaption>The measured region. {sheet}; {poses}, each with its number and the side that is seen.\
         </figcaption></figure></div>\n",
        camera_keys(r)
    );
    write_table(out, &tables::rig(r));
}

fn sheet_section(out: &mut String, r: &Record) {
    out.push_str("<h2>Laser sheet</h2>\n");
    let Some(sheet) = &r.sheet else {
        out.push_str("<p>No view was recorded in the laser sheet, so it was not measured.</p>\n");
        return;
    };
    write_table(out, &tables::sheet(sheet));
    let _ = writeln!(
        out,
        "<p class=\"note\">Plane: a x + b y + c z = 1 in the rig frame, normal · p = distance, normal away from the first camera. \
         Angles 1 to 3: {}. Sheet frame: z, and a positive w, towards the first camera; {}. Sigmas include those of the cameras.</p>",
        escape(&sheet.angles_convention),
        r.provenance.options.get("sheet frame").map_or_else(
            || "x the rig's x axis laid into the sheet, y up in the first image".to_string(),
            |words| escape(words)
        )
    );
}

fn mapping_section(out: &mut String, r: &Record) {
    let Some(m) = &r.mapping_uncertainty else { return };
    out.push_str("<h2>What you will feel of it</h2>\n<p class=\"note\">What the uncertainty of the calibration adds to a measurement in the sheet: one standard \
         deviation each, the noise of your particle images comes on top. u, v, w are the components along sheet x, y and out of the sheet. A leak is the part of \
         one component that appears in another.");
    if m.by_views.is_some() {
        out.push_str(" As the views tell it: how many times larger the changes without single views tell it, over the whole of the sheet (–: one of them fixes it alone, or too few tell).");
    }
    if m.by_likelihood.is_some() {
        out.push_str(" As the likelihood tells it: where equations bend (with an axis point that the images hardly tell), numbers are within 1.96 times that 95 times in 100.");
    }
    out.push_str("</p>\n");
    write_table(out, &diagnosis::mapping(r));
    let drawn = maps::maps(m);
    if !drawn.is_empty() {
        out.push_str("<h3>Over the part of the sheet that both cameras see</h3>\n<div class=\"maps\">");
        for map in drawn {
            let _ = writeln!(out, "<figure>{}<figcaption>{}</figcaption></figure>", map.svg, escape(&map.caption));
        }
        out.push_str("</div>\n");
    }
}

fn diagnosis_section(out: &mut String, r: &Record) {
    let tables = [
        (
            "Known beforehand, against the images",
            diagnosis::priors(r),
            "\"The images alone\" is what the adjustment would say without that line of the rig file. More than about 3 sigmas apart is a conflict: one of the \
             two is wrong. Where the last but one column is near 1, only the prior speaks.",
        ),
        (
            "Is something missing in the model?",
            diagnosis::model_tests(r),
            "Each line asks whether one more unknown would explain the images significantly better. Where the answer is yes but no result \
             would change by much, it may be left out.",
        ),
        (
            "Each view left out once",
            diagnosis::views(r),
            "The change of the results without a view should be of the size that chance allows (last column but one, below about 3). A view without which a \
             result is lost is the only one that fixes it: record a second one.",
        ),
        (
            "What the views say of the standard deviations",
            diagnosis::spread(r),
            "As results change without each view in turn, a standard deviation follows that asks nothing of the noise (the jackknife). It is known to a third \
             where there are six views, to a sixth where there are twenty. Where it is larger by more than that, something that the model does not have \
             differs from view to view: state the larger one.",
        ),
        (
            "Where a standard deviation does not tell how far a number may be",
            diagnosis::bent(r),
            "These numbers hang on others that are hardly known (an axis point on a lens that distorts by little), so that noise changes their standard deviations, too. The              last column is what the likelihood of all images allows: state that. More views, more tilted ones and targets that fill the image make it narrower.",
        ),
    ];
    if tables.iter().all(|(_, t, _)| t.rows.is_empty()) {
        return;
    }
    out.push_str("<h2>Can it be trusted?</h2>\n");
    for (title, table, note) in tables.iter().filter(|(_, t, _)| !t.rows.is_empty()) {
        let _ = writeln!(out, "<h3>{title}</h3>");
        write_table(out, table);
        let _ = writeln!(out, "<p class=\"note\">{}</p>", escape(note));
    }
    let reasons: Vec<String> = diagnosis::set_aside(r).iter().map(|w| sentence(w)).collect();
    if !reasons.is_empty() {
        list(out, "Discs set aside", &reasons);
    }
}

fn camera_section(out: &mut String, r: &Record) {
    out.push_str("<h2>Cameras</h2>\n");
    write_table(out, &tables::cameras(r));
    out.push_str(
        "<p class=\"note\">Values ± one standard deviation. Without a mark: estimated from the images. <span class=\"badge\">held</span> \
         fixed by the rig file. <span class=\"badge\">prior</span> the share of what is known that comes from the prior: \
         at 100 % the images say nothing. Tilt, axis point and focal length compensate each other almost exactly; the effective \
         pinhole (the untilted camera with the same image) is what the images determine. Pixel (0, 0) is the centre of the first pixel.</p>\n",
    );
    out.push_str("<div class=\"two\"><div><h3>Target and scale</h3>\n");
    write_table(out, &tables::target(r));
    out.push_str("</div><div><h3>Fit</h3>\n");
    write_table(out, &tables::fit(r));
    out.push_str("</div></div>\n");
}

fn write_table(out: &mut String, table: &Table) {
    if table.rows.is_empty() {
        return;
    }
    // Without heads a table is a list of names and words; those break where the page is narrow, columns of numbers scroll.
    let class = if table.heads.is_empty() { " class=\"facts\"" } else { "" };
    let _ = write!(out, "<div class=\"wide\"><table{class}>");
    if !table.heads.is_empty() {
        out.push_str("<thead><tr><th></th>");
        for head in &table.heads {
            let _ = write!(out, "<th>{}</th>", escape(head));
        }
        out.push_str("</tr></thead>");
    }
    out.push_str("<tbody>");
    for row in &table.rows {
        let _ = write!(out, "<tr><th scope=\"row\">{}</th>", escape(&row.name));
        for cell in &row.cells {
            let _ = write!(out, "<td>{}", escape(&typographic(&cell.text)));
            if !cell.note.is_empty() {
                let class = if cell.strong { "badge prior" } else { "badge" };
                let _ = write!(out, "<span class=\"{class}\">{}</span>", escape(&cell.note));
            }
            out.push_str("</td>");
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

/// Hyphens that stand for a minus become one; hyphens inside words stay.
fn typographic(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut before = ' ';
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        let minus = c == '-' && !before.is_alphanumeric() && chars.peek().is_some_and(char::is_ascii_digit);
        out.push(if minus { '−' } else { c });
        before = c;
    }
    out
}

fn residual_section(out: &mut String, r: &Record, residuals: &ResidualTable) {
    let _ = write!(
        out,
        "<h2>Residuals</h2>\n<h3>Root mean square per view, px</h3>\n<figure class=\"wide\">{}<figcaption>{}</figcaption></figure>\n",
        plots::bars(r),
        camera_keys(r)
    );
    out.push_str(
        "<h3>Over the sensor: how far each disc lies from where the calibration expects it</h3>\n<div class=\"two\">",
    );
    for (k, camera) in r.cameras.iter().enumerate() {
        let (svg, caption) = plots::field(camera, k, residuals);
        let _ = writeln!(
            out,
            "<figure>{svg}<figcaption><span class=\"key cam{}\"></span>{}: {}</figcaption></figure>",
            k % COLOURS,
            escape(&camera.name),
            escape(&caption)
        );
    }
    out.push_str(
        "</div>\n<p class=\"note\">Arrows without order are noise. A pattern that returns from view to view is a lens term or a \
         target that is not as stated; one that differs between views is a target that bends or moved.</p>\n",
    );
    view_table(out, r);
}

fn view_table(out: &mut String, r: &Record) {
    out.push_str("<h3>Views</h3>\n<div class=\"wide\"><table><thead><tr><th class=\"n\">view</th><th></th>");
    for c in &r.cameras {
        let name = escape(&c.name);
        let _ = write!(
            out,
            "<th>{name}: image</th><th class=\"n\">rms of discs, px</th><th class=\"n\">edge points</th><th class=\"n\">outliers</th>"
        );
    }
    out.push_str("</tr></thead><tbody>");
    for v in &r.views {
        let _ =
            write!(out, "<tr><td class=\"n\">{}</td><td class=\"soft words\">{}</td>", v.index, escape(&view_words(v)));
        for c in &r.cameras {
            let image = v.images.get(&c.name).map_or(String::new(), |i| format!("<code>{}</code>", escape(i)));
            let rms = v.rms_px.get(&c.name).map_or("–".into(), |&x| significant(x, 3));
            let number = |map: &BTreeMap<String, usize>| map.get(&c.name).map_or("–".into(), usize::to_string);
            let outliers = v.outliers.get(&c.name).copied().unwrap_or(0);
            let _ = write!(
                out,
                "<td>{image}</td><td class=\"n\">{rms}</td><td class=\"n\">{}</td><td class=\"n\">{outliers}</td>",
                number(&v.observations)
            );
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

fn view_words(v: &View) -> String {
    let mut words = Vec::new();
    if v.in_sheet {
        words.push("in the sheet".to_string());
    }
    if !v.used {
        words.push(if v.why_unused.is_empty() { "not used".into() } else { format!("not used: {}", v.why_unused) });
    }
    if let Some(planarity_mm) = v.planarity_mm {
        words.push(format!("plane to {} mm", plain(planarity_mm, 2)));
    }
    words.join("; ")
}

#[derive(Default)]
struct OutlierGroup {
    count: usize,
    largest_px: f64,
    largest_sigmas: f64,
}

fn outlier_section(out: &mut String, r: &Record, table: &ResidualTable) {
    let mut groups: BTreeMap<_, OutlierGroup> = BTreeMap::new();
    for i in 0..table.len() {
        let (Some(reason), Some(row)) = (table.outlier(i), table.row(i)) else { continue };
        let group = groups.entry((row.view, row.camera, row.disc, reason)).or_default();
        let size_px = if row.normal_px.is_finite() { row.normal_px.abs() } else { row.du_px.hypot(row.dv_px) };
        group.count += 1;
        group.largest_px = group.largest_px.max(size_px);
        group.largest_sigmas = group.largest_sigmas.max(size_px / row.sigma_px);
    }
    out.push_str("<h2>Outliers</h2>\n");
    if groups.is_empty() {
        out.push_str("<p>None.</p>\n");
        return;
    }
    out.push_str(
        "<div class=\"wide\"><table><thead><tr><th class=\"n\">view</th><th>camera</th><th>disc (column, row, level)</th>\
         <th class=\"n\">observations</th><th class=\"n\">largest, px</th><th class=\"n\">in sigmas</th><th>reason</th></tr></thead><tbody>",
    );
    for ((view, camera, disc, reason), g) in groups.iter().take(LONGEST_LIST) {
        let name = r.cameras.get(*camera).map_or("", |c| c.name.as_str());
        let _ = writeln!(
            out,
            "<tr><td class=\"n\">{view}</td><td>{}</td><td>{}, {}, {}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{}</td><td class=\"words\">{}</td></tr>",
            escape(name),
            disc.column,
            disc.row,
            disc.level,
            g.count,
            plain(g.largest_px, 2),
            plain(g.largest_sigmas, 2),
            escape(reason)
        );
    }
    out.push_str("</tbody></table></div>\n");
    if groups.len() > LONGEST_LIST {
        let more = groups.len() - LONGEST_LIST;
        let _ = writeln!(out, "<p class=\"note\">And {more} more discs; all are in residuals.csv.</p>");
    }
}

fn overlay_section(out: &mut String, r: &Record, overlays: &[OverlayInput<'_>]) -> Result<()> {
    out.push_str("<h2>Images</h2>\n");
    if overlays.is_empty() {
        out.push_str("<p>No images were given to this report.</p>\n");
        return Ok(());
    }
    let width = |image: &GrayView<'_>| (image.width(), image.height());
    let largest = overlays.iter().map(|o| width(&o.image)).max().unwrap_or((1, 1));
    // One factor for all, so that views can be compared.
    let rms_px = overlay::rms_px(overlays.iter().map(|o| &o.shapes.marks));
    let radius_px = overlay::typical_radius_px(overlays.iter().map(|o| o.shapes));
    let factor = overlay::arrow_factor(rms_px, largest.0, largest.1, radius_px);
    out.push_str(
        "<p class=\"note long\"><span class=\"swatch\" style=\"color:#00b4d8;margin-left:0\"></span>measured contour\
         <span class=\"swatch\" style=\"color:#4caf50\"></span>ellipse or predicted circle\
         <span class=\"swatch\" style=\"color:#a08cf0\"></span>tangents and axes\
         <span class=\"swatch\" style=\"color:#e0b000\"></span>features and residuals (observed less predicted)\
         <span class=\"swatch\" style=\"color:#e5483f\"></span>outliers and rejected candidates</p>\n",
    );
    for v in &r.views {
        let mut of_view: Vec<_> = overlays.iter().filter(|o| o.view == v.index).collect();
        if of_view.is_empty() {
            continue;
        }
        of_view.sort_by_key(|o| o.camera);
        let words = view_words(v);
        let tail =
            if words.is_empty() { String::new() } else { format!(" <span class=\"soft\">({})</span>", escape(&words)) };
        let _ = write!(out, "<h3>View {}{tail}</h3>\n<div class=\"two\">", v.index);
        for o in of_view {
            overlay_figure(out, r, v, o, factor, figures::background_width_px(overlays.len()))?;
        }
        out.push_str("</div>\n");
    }
    Ok(())
}

fn overlay_figure(
    out: &mut String,
    r: &Record,
    v: &View,
    o: &OverlayInput<'_>,
    factor: f64,
    max_width: usize,
) -> Result<()> {
    let name = r.cameras.get(o.camera).map_or("", |c| c.name.as_str());
    let id = format!("v{}c{}", v.index, o.camera);
    let title = format!("View {}, camera {name}", v.index);
    let factor = o.shapes.magnification.unwrap_or(factor);
    let (svg, words) = figures::overlay_svg(&o.image, o.shapes, &Figure { id: &id, title: &title, factor, max_width })?;
    let mut caption = vec![escape(name)];
    if let Some(image) = v.images.get(name) {
        caption.push(format!("<code>{}</code>", escape(image)));
    }
    if let Some(rms) = v.rms_px.get(name).filter(|x| x.is_finite()) {
        caption.push(format!("rms {} px", plain(*rms, 2)));
    }
    if !words.is_empty() {
        caption.push(words);
    }
    let _ = writeln!(
        out,
        "<figure class=\"zoom overlay\" id=\"{id}\">{svg}<figcaption id=\"{id}-back\">{}\
         <span class=\"tozoom\"> · <a href=\"#{id}\">larger</a></span><span class=\"unzoom\"> · <a href=\"#{id}-back\">smaller</a></span>\
         </figcaption></figure>",
        caption.join(" · ")
    );
    Ok(())
}

fn correlation_section(out: &mut String, r: &Record) {
    out.push_str("<h2>What moves together</h2>\n");
    for n in &r.fit.near_null {
        let _ = writeln!(out, "<p>{}</p>", escape(&sentence(&n.words)));
    }
    let pairs = tables::correlations(r, CORRELATION, LONGEST_LIST);
    if pairs.is_empty() {
        let _ = writeln!(out, "<p>No two parameters are correlated by more than {CORRELATION}.</p>");
        return;
    }
    out.push_str(
        "<div class=\"wide\"><table><thead><tr><th>parameter</th><th>parameter</th><th class=\"n\">correlation</th></tr></thead><tbody>",
    );
    for p in &pairs {
        let _ = writeln!(
            out,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td></tr>",
            escape(p.first),
            escape(p.second),
            typographic(&format!("{:.4}", p.coefficient))
        );
    }
    out.push_str("</tbody></table></div>\n");
    if pairs.len() == LONGEST_LIST {
        out.push_str("<p class=\"note\">The strongest pairs, without poses of views, which all move with the cameras; the whole covariance is in calibration.json.</p>\n");
    } else {
        let _ = writeln!(
            out,
            "<p class=\"note\">All pairs above {CORRELATION}, without poses of views, which all move with the cameras; the whole covariance is in calibration.json.</p>"
        );
    }
}

fn provenance_section(out: &mut String, r: &Record) {
    let p = &r.provenance;
    out.push_str("<footer>");
    let _ = write!(out, "<p>Written by {}", if p.program.is_empty() { "spivcal".into() } else { escape(&p.program) });
    if !p.rig_file.is_empty() {
        let _ = write!(out, " from <code>{}</code>", escape(&p.rig_file));
    }
    out.push_str(". Numbers of this page are those of calibration.json (");
    let _ = write!(out, "{} version {}).</p>", escape(&r.format), r.version);
    if !p.options.is_empty() {
        let options: Vec<_> =
            p.options.iter().map(|(k, v)| format!("<code>{} = {}</code>", escape(k), escape(v))).collect();
        let _ = write!(out, "<p>Options: {}.</p>", options.join(", "));
    }
    if !p.images.is_empty() {
        let images: Vec<_> = p
            .images
            .iter()
            .map(|i| {
                let sum = i.sha256.as_ref().map_or(String::new(), |s| format!(" (SHA-256 {})", escape(s)));
                format!("<code>{}</code>{sum}", escape(&i.path))
            })
            .collect();
        let _ = write!(out, "<p>Images: {}.</p>", images.join(", "));
    }
    out.push_str("</footer>\n");
}
