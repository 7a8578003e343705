//! The diagnosis as tables, for the text and for the HTML alike.

use super::number::{as_precise, count, measured, plain, with_unit};
use super::tables::{Cell, LONGEST_LIST, Row, Table};
use crate::record::{Interval, MappingByViews, MappingSigma, OFF_ITSELF, OutlierReason, Record};
use crate::stats::NORMAL_95;
use std::collections::BTreeMap;

fn cells(texts: impl IntoIterator<Item = String>) -> Vec<Cell> {
    texts.into_iter().map(|text| Cell { text, ..Cell::default() }).collect()
}

fn table(heads: &[&str], rows: Vec<(String, Vec<String>)>) -> Table {
    let rows = rows.into_iter().map(|(name, texts)| Row { name, cells: cells(texts) });
    Table { heads: heads.iter().map(|h| h.to_string()).collect(), rows: rows.collect() }
}

fn percent(x: f64) -> String {
    if x.is_finite() { format!("{} %", plain(100.0 * x, 2)) } else { "not determined".into() }
}

fn pixels(x: f64) -> String {
    if x.is_finite() { format!("{} px", plain(x, 2)) } else { "not determined".into() }
}

/// What a user feels, in the middle and at worst, how many times larger the views tell it, and what it is where equations bend.
pub(super) fn mapping(record: &Record) -> Table {
    let Some(m) = &record.mapping_uncertainty else { return Table::default() };
    let (by_views, at_worst) = (m.by_views.as_ref(), m.at_worst());
    let told = |factor: &dyn Fn(&MappingByViews) -> f64| {
        by_views.map(factor).map(|f| if f.is_finite() { format!("× {}", plain(f, 2)) } else { "–".into() })
    };
    let row = |name: &str, show: &dyn Fn(&MappingSigma) -> String, factor: &dyn Fn(&MappingByViews) -> f64| {
        let bent = m.by_likelihood.as_ref().map(|_| show(&at_worst));
        let cells = [show(&m.middle), show(&m.largest)].into_iter().chain(told(factor)).chain(bent);
        (String::from(name), cells.collect::<Vec<String>>())
    };
    let entry = |name: &str, i: usize, j: usize| {
        row(name, &|s: &MappingSigma| percent(s.displacement[i][j]), &|v: &MappingByViews| v.displacement[i][j])
    };
    let place = |s: &MappingSigma| format!("{} ({} µm)", pixels(s.in_plane_px), plain(1000.0 * s.in_plane_mm, 2));
    let rows = vec![
        row("disparity of the two cameras", &|s| pixels(s.disparity_px), &|v| v.disparity),
        row("place in the sheet", &place, &|v| v.in_plane),
        row("in-plane scale", &|s| percent(s.in_plane_scale), &|v| v.in_plane_scale),
        row("out-of-plane gain over in-plane scale", &|s| percent(s.out_of_plane_gain), &|v| v.out_of_plane_gain),
        entry("error of u per u", 0, 0),
        entry("error of v per v", 1, 1),
        entry("error of w per w", 2, 2),
        entry("leak of w into u", 0, 2),
        entry("leak of w into v", 1, 2),
        entry("leak of u into w", 2, 0),
        entry("leak of v into w", 2, 1),
        entry("leak of v into u", 0, 1),
    ];
    let views = by_views.map(|_| "as the views tell it");
    let bent = m.by_likelihood.as_ref().map(|_| "at worst, as the likelihood tells it");
    let heads: Vec<&str> = ["in the middle", "at worst"].into_iter().chain(views).chain(bent).collect();
    table(&heads, rows)
}

/// Every prior against the images.
pub(super) fn priors(record: &Record) -> Table {
    let Some(d) = &record.fit.diagnosis else { return Table::default() };
    let row = |p: &crate::record::Prior| {
        let verdict = match (p.conflict, p.sigma_ratio) {
            (true, _) => "CONFLICT",
            (_, r) if r > 0.9 => "only the prior speaks",
            (_, r) if r > std::f64::consts::FRAC_1_SQRT_2 => "mostly the prior",
            _ => "agrees",
        };
        let unit = if p.unit == "deg" { "°" } else { &p.unit };
        let images = if p.images_alone.is_finite() {
            with_unit(p.images_alone, p.images_alone_sigma, unit)
        } else {
            "nothing".into()
        };
        let z = if p.z.is_finite() { plain(p.z, 2) } else { "–".into() };
        let name = if p.stated { p.name.clone() } else { format!("{} (assumed)", p.name) };
        let prior = if p.exact() {
            format!("{} {unit}, taken as exact", plain(p.prior, 8))
        } else {
            with_unit(p.prior, p.prior_sigma, unit)
        };
        (name, vec![prior, images, z, plain(p.sigma_ratio, 2), verdict.into()])
    };
    let heads = ["known beforehand", "the images alone", "apart, sigmas", "sigma after / before", ""];
    table(&heads, d.priors.iter().map(row).collect())
}

/// Whether the model lacks something.
pub(super) fn model_tests(record: &Record) -> Table {
    let Some(d) = &record.fit.diagnosis else { return Table::default() };
    let row = |t: &crate::record::ModelTest| {
        let unit = if t.unit == "deg" { "°" } else { &t.unit };
        let size = if t.sigma.is_finite() {
            with_unit(t.size, t.sigma, unit)
        } else {
            format!("{} {unit}", measured(t.size, 0.0))
        };
        let answer = if t.needed { "yes" } else { "no" };
        // What a term would do that nobody asks for is what its noise would do.
        let effect = if t.needed { format!("{} sigma", plain(t.bias_sigmas, 2)) } else { "–".into() };
        (t.question.clone(), vec![answer.into(), size, plain(t.p_value, 2), effect])
    };
    let heads = ["answer", "estimate if added", "chance of this by noise", "largest change of a result"];
    table(&heads, d.model_tests.iter().map(row).collect())
}

/// What each view contributes.
pub(super) fn views(record: &Record) -> Table {
    let Some(d) = &record.fit.diagnosis else { return Table::default() };
    let row = |v: &crate::record::ViewInfluence| {
        let growth = match v.lost.as_slice() {
            [] if v.sigma_growth_of.is_empty() => "–".into(),
            [] => format!("× {} ({})", plain(v.sigma_growth, 3), v.sigma_growth_of),
            [one] => format!("lost: {one}"),
            [one, more @ ..] => format!("lost: {one} and {} more", more.len()),
        };
        let shift = if v.shift_sigmas.is_finite() { v.shift_sigmas } else { v.predicted_shift_sigmas };
        let shift =
            if v.lost.is_empty() && shift.is_finite() { format!("{} sigma", plain(shift, 2)) } else { "–".into() };
        let z =
            if v.z.is_finite() && v.lost.is_empty() { format!("{} ({})", plain(v.z, 2), v.z_of) } else { "–".into() };
        let verdict = if v.contradicts { "CONTRADICTS the others" } else { "agrees" };
        let verdict = if v.lost.is_empty() { verdict } else { "cannot be spared" };
        (format!("view {}", v.view), vec![growth, shift, z, verdict.into()])
    };
    let heads = ["largest sigma without it", "largest change", "most significant change in its own sigmas", ""];
    table(&heads, d.views.iter().map(row).collect())
}

/// What the views say of the standard deviations.
pub(super) fn spread(record: &Record) -> Table {
    let Some(d) = &record.fit.diagnosis else { return Table::default() };
    let row = |k: &crate::record::KeyQuantity| {
        let [unit, joined] =
            if k.unit == "deg" { ["°", "°"].map(String::from) } else { [k.unit.clone(), format!(" {}", k.unit)] };
        let by_views = format!("{}{joined}", plain(k.sigma_by_views, 2));
        let factor = format!("× {}", plain(k.sigma_by_views / k.sigma, 2));
        (k.name.clone(), vec![with_unit(k.value, k.sigma, &unit), by_views, factor])
    };
    let known = d.key_quantities.iter().filter(|k| k.sigma_by_views.is_finite());
    table(&["value as stated", "sigma by the views", "of the one stated"], known.map(row).collect())
}

/// Numbers whose standard deviation does not tell how far they may be.
pub(super) fn bent(record: &Record) -> Table {
    let Some(d) = &record.fit.diagnosis else { return Table::default() };
    let row = |k: &crate::record::KeyQuantity| {
        let unit = if k.unit == "deg" { "°" } else { k.unit.as_str() };
        let straight = [-NORMAL_95, NORMAL_95].map(|by| Some(k.value + by * k.sigma));
        let told = |ends: Interval| {
            let end = |x: Option<f64>| x.map_or("no end found".into(), |x| as_precise(x, k.sigma));
            format!("{} to {}", end(ends[0]), end(ends[1]))
        };
        let interval = k.interval_95.map_or_else(String::new, told);
        (k.name.clone(), vec![with_unit(k.value, k.sigma, unit), told(straight), interval])
    };
    let heads = ["value as stated", "1.96 sigma either way", "95 of 100, by the images"];
    table(&heads, d.key_quantities.iter().filter(|k| k.bends()).map(row).collect())
}

/// Discs that were set aside, each with its reason; of a long list the first. A dot that is off itself has one line, of the image where it is furthest off.
pub(super) fn set_aside(record: &Record) -> Vec<String> {
    let all: Vec<_> = record.fit.diagnosis.iter().flat_map(|d| &d.outliers).collect();
    let mut of_itself: BTreeMap<[i32; 3], Vec<&OutlierReason>> = BTreeMap::new();
    for o in all.iter().filter(|o| o.reason.ends_with(OFF_ITSELF)) {
        of_itself.entry(o.disc).or_default().push(o);
    }
    let mut lines = vec![];
    for o in all {
        let [column, row, level] = o.disc;
        if !o.reason.ends_with(OFF_ITSELF) {
            lines.push(format!("view {}, camera {}, disc {column}, {row}, {level}: {}", o.view, o.camera, o.reason));
            continue;
        }
        // Told where it is first met.
        let images = of_itself.remove(&o.disc).unwrap_or_default();
        lines.extend(images.iter().max_by(|a, b| a.distance_px.total_cmp(&b.distance_px)).map(|most| {
            let (count, view, camera) = (count(images.len(), "image"), most.view, &most.camera);
            format!(
                "disc {column}, {row}, {level} in {count}, furthest in view {view}, camera {camera}: {}",
                most.reason
            )
        }));
    }
    if lines.len() > LONGEST_LIST {
        let more = lines.len() - LONGEST_LIST;
        lines.truncate(LONGEST_LIST);
        lines.push(format!("and {more} more: all are in calibration.json"));
    }
    lines
}
