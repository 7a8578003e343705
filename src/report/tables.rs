//! Rows of numbers with their standard deviations, for the text and for the HTML alike.

use super::number::{plain, with_unit};
use crate::bundle::MOSTLY_PRIOR;
use crate::record::{Camera, Known, Record, Sheet, SheetSigma, Window};

/// Longest list of correlations, of outliers, and of discs.
pub(super) const LONGEST_LIST: usize = 40;

/// A number as it is shown, and how it is known.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Cell {
    /// Value, sigma, unit.
    pub(super) text: String,
    /// `held`, `prior 97 %`, or empty.
    pub(super) note: String,
    /// Whether the note is one to stop at: the prior says more than the images.
    pub(super) strong: bool,
}

/// One line of a table.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    /// What it is.
    pub(super) name: String,
    /// One cell per column.
    pub(super) cells: Vec<Cell>,
}

/// A table with column heads; the first column has none.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Table {
    pub(super) heads: Vec<String>,
    pub(super) rows: Vec<Row>,
}

impl Table {
    fn row(&mut self, name: &str, cells: Vec<Cell>) {
        self.rows.push(Row { name: name.into(), cells });
    }
    fn words(&mut self, name: &str, text: impl Into<String>) {
        self.row(name, vec![cell(text)]);
    }
}

fn cell(text: impl Into<String>) -> Cell {
    Cell { text: text.into(), ..Cell::default() }
}

/// Share of the prior; 0 where there is none.
fn prior_share(record: &Record, name: &str) -> f64 {
    let parameter = record.fit.parameters.iter().find(|p| p.name == name && p.known == Known::Prior);
    parameter.map_or(0.0, |p| p.prior_share)
}

/// How a camera's parameter is known; empty where it is free.
fn note(record: &Record, name: &str) -> String {
    match record.fit.parameters.iter().find(|p| p.name == name) {
        Some(p) if p.known == Known::Fixed => "held".into(),
        Some(p) if p.known == Known::Prior && p.prior_share.is_finite() => {
            format!("prior {:.0} %", 100.0 * p.prior_share)
        }
        Some(p) if p.known == Known::Prior => "prior".into(),
        _ => String::new(),
    }
}

/// Value and standard deviation of a camera's number.
type Get = fn(&Camera) -> (f64, f64);

/// `(name, key, unit, factor to the unit shown, how to get it)` of a camera's parameters.
type Quantity = (&'static str, &'static str, &'static str, f64, Get);

const QUANTITIES: [Quantity; 10] = [
    ("focal length f", "f_px", "px", 1.0, |c| (c.f_px, c.sigma.f_px)),
    ("axis point cx", "cx_px", "px", 1.0, |c| (c.cx_px, c.sigma.cx_px)),
    ("axis point cy", "cy_px", "px", 1.0, |c| (c.cy_px, c.sigma.cy_px)),
    ("tilt alpha", "alpha_rad", "°", DEG, |c| (c.alpha_rad, c.sigma.alpha_rad)),
    ("tilt beta", "beta_rad", "°", DEG, |c| (c.beta_rad, c.sigma.beta_rad)),
    ("radial k1", "k1", "", 1.0, |c| (c.k1, c.sigma.k1)),
    ("radial k2", "k2", "", 1.0, |c| (c.k2, c.sigma.k2)),
    ("radial k3", "k3", "", 1.0, |c| (c.k3, c.sigma.k3)),
    ("pixel aspect", "aspect", "", 1.0, |c| (c.aspect, c.sigma.aspect)),
    ("pupil ratio", "pupil_ratio", "", 1.0, |c| (c.pupil_ratio, c.sigma.pupil_ratio)),
];

const DEG: f64 = 180.0 / std::f64::consts::PI;

/// Layers of a window: name, key, unit, how to get it.
const LAYERS: [(&str, &str, &str, fn(&Window) -> (f64, f64)); 5] = [
    ("window, distance", "distance_mm", "mm", |w| (w.distance_mm, w.sigma.distance_mm)),
    ("window, thickness", "thickness_mm", "mm", |w| (w.thickness_mm, w.sigma.thickness_mm)),
    ("window, index before it", "n_air", "", |w| (w.n_air, w.sigma.n_air)),
    ("window, index of the glass", "n_glass", "", |w| (w.n_glass, w.sigma.n_glass)),
    ("window, index behind it", "n_water", "", |w| (w.n_water, w.sigma.n_water)),
];

/// Turn of a window's normal against the lens axis about the camera's x (`axis` 0) or y, rad, with its standard deviation by the
/// covariance of its turns w: `dn = w x n`.
fn window_turn(record: &Record, camera: &Camera, w: &Window, axis: usize) -> (f64, f64) {
    let [x, y, z] = w.normal_in_cam;
    let by = |first: [f64; 3], last: [f64; 3], a: f64, sign: f64| {
        let gradient: [f64; 3] = std::array::from_fn(|k| sign * (first[k] * z - a * last[k]) / (a * a + z * z));
        gradient
    };
    let dz = [y, -x, 0.0];
    let (value, gradient) = if axis == 0 {
        ((-y).atan2(z), by([-z, 0.0, x], dz, y, -1.0))
    } else {
        (x.atan2(z), by([0.0, z, -y], dz, x, 1.0))
    };
    let c = &record.covariance;
    let rows = ["rx_rad", "ry_rad", "rz_rad"].map(|k| c.index(&format!("{}.window.{k}", camera.name)));
    let [Some(a), Some(b), Some(d)] = rows else { return (value, f64::NAN) };
    let rows = [a, b, d];
    let variance: f64 = (0..9).map(|i| gradient[i / 3] * gradient[i % 3] * c.matrix[rows[i / 3]][rows[i % 3]]).sum();
    (value, variance.max(0.0).sqrt())
}

/// What stands before the cameras; nothing where no camera looks through a window.
fn windows(record: &Record, table: &mut Table) {
    if record.cameras.iter().all(|c| c.window.is_none()) {
        return;
    }
    let none = || cell("no window");
    for (name, key, unit, get) in LAYERS {
        let cells = record.cameras.iter().map(|c| {
            let Some(w) = &c.window else { return none() };
            let ((value, sigma), key) = (get(w), format!("{}.window.{key}", c.name));
            let told = note(record, &key);
            let held = told.is_empty() && sigma == 0.0;
            Cell {
                text: with_unit(value, sigma, unit),
                note: if held { "held".into() } else { told },
                strong: prior_share(record, &key) > MOSTLY_PRIOR,
            }
        });
        table.row(name, cells.collect());
    }
    for (axis, name) in ["window, turned about x", "window, turned about y"].iter().enumerate() {
        let cells = record.cameras.iter().map(|c| {
            let turn = |w: &Window| {
                let (value, sigma) = window_turn(record, c, w, axis);
                cell(with_unit(value * DEG, sigma * DEG, "°"))
            };
            c.window.as_ref().map_or_else(none, turn)
        });
        table.row(name, cells.collect());
    }
}

/// Interior of all cameras, one column each.
pub(super) fn cameras(record: &Record) -> Table {
    let mut table = Table { heads: record.cameras.iter().map(|c| c.name.clone()).collect(), rows: Vec::new() };
    for (name, key, unit, factor, get) in QUANTITIES {
        let cells = record.cameras.iter().map(|c| {
            let ((value, sigma), note) = (get(c), note(record, &format!("{}.{key}", c.name)));
            // A parameter that is held has no sigma, whatever was left in the field.
            let sigma = if note == "held" { 0.0 } else { sigma * factor };
            let strong = prior_share(record, &format!("{}.{key}", c.name)) > MOSTLY_PRIOR;
            Cell { text: with_unit(value * factor, sigma, unit), note, strong }
        });
        table.row(name, cells.collect());
    }
    windows(record, &mut table);
    let effective: [(&str, Get); 3] = [
        ("effective f", |c| (c.effective.f_px, c.sigma.effective.f_px)),
        ("effective cx", |c| (c.effective.cx_px, c.sigma.effective.cx_px)),
        ("effective cy", |c| (c.effective.cy_px, c.sigma.effective.cy_px)),
    ];
    for (name, get) in effective {
        let cells = record.cameras.iter().map(get).map(|(value, sigma)| cell(with_unit(value, sigma, "px")));
        table.row(name, cells.collect());
    }
    if record.cameras.iter().any(|c| c.pixel_pitch_mm.is_some()) {
        let cells = record.cameras.iter().map(|c| match c.pixel_pitch_mm {
            Some(pitch_mm) => cell(with_unit(c.f_px * pitch_mm, c.sigma.f_px * pitch_mm, "mm")),
            None => cell("pixel pitch not given"),
        });
        table.row("image distance", cells.collect());
    }
    type Show = fn(&Camera) -> String;
    let per_camera: [(&str, Show); 2] = [
        ("image size", |c| format!("{} × {} px", c.image_size_px[0], c.image_size_px[1])),
        (RMS_OF_DISCS, |c| format!("{} px", plain(c.rms_px, 3))),
    ];
    for (name, show) in per_camera {
        table.row(name, record.cameras.iter().map(|c| cell(show(c))).collect());
    }
    let edges = |c: &Camera| match c.edge_rms_px {
        Some(rms) => format!("{} px of {}", plain(rms, 3), c.observations),
        None => c.observations.to_string(),
    };
    if record.cameras.iter().any(|c| c.observations > 0) {
        table.row(RMS_OF_EDGES, record.cameras.iter().map(|c| cell(edges(c))).collect());
    }
    table
}

/// Both coordinates together of where each disc lies as a whole.
const RMS_OF_DISCS: &str = "residual rms, places of discs";
/// Across the contour, and how many edge points there are.
const RMS_OF_EDGES: &str = "residual rms, edge points";

/// Root mean square residual of the edge points of all cameras, px; none where a camera states none.
fn edge_rms_px(record: &Record) -> Option<f64> {
    let squares = |c: &Camera| Some(c.observations as f64 * c.edge_rms_px?.powi(2));
    let sum: f64 = record.cameras.iter().map(squares).sum::<Option<f64>>()?;
    let rms = (sum / edge_points(record) as f64).sqrt();
    rms.is_finite().then_some(rms)
}

fn edge_points(record: &Record) -> usize {
    record.cameras.iter().map(|c| c.observations).sum()
}

/// How many numbers were fitted, and what they are, beside the edge points that the cameras count.
fn observations(record: &Record) -> String {
    let (n, edges) = (record.fit.observations, edge_points(record));
    match record.fit.observation_model.as_str() {
        "contour" if n > 0 && edges == n => format!("{n} edge points"),
        "contour" if n > 0 && edges > n => {
            format!("{n}: {edges} edge points, less {} that went into the light followed along contours", edges - n)
        }
        "bitangent" if edges > 0 => format!("{n} of common tangents, from {edges} edge points"),
        _ => n.to_string(),
    }
}

/// Position and attitude of the cameras in the rig, and what they make together.
pub(super) fn rig(record: &Record) -> Table {
    let mut table = Table::default();
    if let Some(rig) = &record.rig {
        table.words("baseline", with_unit(rig.baseline_mm, rig.sigma.baseline_mm, "mm"));
        table.words("angle between the lens axes", with_unit(rig.axes_angle_deg, rig.sigma.axes_angle_deg, "°"));
    }
    for c in record.cameras.iter().skip(1) {
        let motion = c.cam_from_rig.motion::<(), ()>();
        let w = crate::rigid::rotation_log(&motion.rotation) * DEG;
        let (s, t) = (&c.sigma.cam_from_rig, c.cam_from_rig.translation_mm);
        let turn: Vec<_> = (0..3).map(|i| with_unit(w[i], s.rotation_rad[i] * DEG, "°")).collect();
        let shift: Vec<_> = (0..3).map(|i| with_unit(t[i], s.translation_mm[i], "mm")).collect();
        table.words(&format!("{}: rotation vector from rig", c.name), turn.join(", "));
        table.words(&format!("{}: translation from rig", c.name), shift.join(", "));
    }
    table
}

struct Plane<'a> {
    distance_mm: f64,
    angle_deg: f64,
    abc_per_mm: [f64; 3],
    angles_deg: [f64; 3],
    sigma: &'a SheetSigma,
}

/// The laser sheet, with the paper's method beside it where there is one.
pub(super) fn sheet(sheet: &Sheet) -> Table {
    let mut planes = vec![Plane {
        distance_mm: sheet.distance_mm,
        angle_deg: sheet.angle_to_baseline_deg,
        abc_per_mm: sheet.abc_per_mm,
        angles_deg: sheet.angles_deg,
        sigma: &sheet.sigma,
    }];
    let first = match sheet.method.as_str() {
        "joint" => "joint adjustment",
        "homography" => "homography",
        _ => "result",
    };
    let mut heads = vec![first.to_string()];
    if let Some(h) = &sheet.homography {
        heads.push("the paper's homography".into());
        planes.push(Plane {
            distance_mm: h.distance_mm,
            angle_deg: h.angle_to_baseline_deg,
            abc_per_mm: h.abc_per_mm,
            angles_deg: h.angles_deg,
            sigma: &h.sigma,
        });
    }
    let mut table = Table { heads, rows: Vec::new() };
    let mut add = |name: &str, show: &dyn Fn(&Plane<'_>) -> String| {
        table.row(name, planes.iter().map(|p| cell(show(p))).collect());
    };
    add("distance from the first camera", &|p| with_unit(p.distance_mm, p.sigma.distance_mm, "mm"));
    add("angle to the baseline", &|p| with_unit(p.angle_deg, p.sigma.angle_to_baseline_deg, "°"));
    for i in 0..3 {
        add(&format!("angle {}", i + 1), &|p| with_unit(p.angles_deg[i], p.sigma.angles_deg[i], "°"));
    }
    for (i, name) in ["a", "b", "c"].into_iter().enumerate() {
        add(name, &|p| with_unit(p.abc_per_mm[i], p.sigma.abc_per_mm[i], "/mm"));
    }
    let sigma = &sheet.sigma.normal_rad;
    let normal = sheet.normal_in_rig.map(|x| plain(x, 6)).join(", ");
    let turn = sigma.map(|s| if s.is_finite() { format!("{}°", plain(s * DEG, 2)) } else { "unknown".into() });
    let width = planes.len();
    let pad = |first: String, second: Option<String>| {
        let mut cells = vec![cell(first)];
        cells.extend((1..width).map(|_| cell(second.clone().unwrap_or_default())));
        cells
    };
    table.row("normal in the rig", pad(normal, None));
    table.row("sigma of the normal about sheet x, y", pad(turn.join(", "), None));
    let transfer = sheet.homography.as_ref().map(|h| format!("{} px", plain(h.transfer_rms_px, 3)));
    let disparity = sheet.disparity_rms_px.map(|d| format!("{} px", plain(d, 3)));
    if transfer.is_some() || disparity.is_some() {
        table.row("disparity, transfer error (rms)", pad(disparity.unwrap_or_default(), transfer));
    }
    table
}

/// The target and the scale.
pub(super) fn target(record: &Record) -> Table {
    let t = &record.target;
    let mut table = Table::default();
    table.words("kind", t.kind.clone());
    if !t.adjust.is_empty() {
        table.words("adjusted", t.adjust.clone());
    }
    if t.spacing_mm.is_finite() {
        table.words("spacing", with_unit(t.spacing_mm, t.sigma.spacing_mm, "mm"));
    } else {
        table.words("spacing", "each view has its own");
    }
    for (i, &radius_mm) in t.radii_mm.iter().enumerate() {
        let sigma = t.sigma.radii_mm.get(i).copied().unwrap_or(f64::NAN);
        table.words(&format!("radius {i}"), with_unit(radius_mm, sigma, "mm"));
    }
    if let Some(step_mm) = t.step_mm {
        table.words("step between the levels", with_unit(step_mm, t.sigma.step_mm.unwrap_or(f64::NAN), "mm"));
    }
    if !t.points.is_empty() {
        table.words("points adjusted", t.points.len().to_string());
    }
    if let Some(shift_mm) = t.shift_rms_mm {
        table.words("points off the nominal target (rms)", format!("{} µm", plain(shift_mm * 1000.0, 3)));
    }
    if let Some(ovality_mm) = t.ovality_mm {
        table.words("discs off round (ovality, rms)", format!("{} µm", plain(ovality_mm * 1000.0, 3)));
    }
    if let Some(light) = t.same_light {
        let [correlation, scatter] = [light.correlation, light.variance.sqrt()].map(|x| plain(x, 2));
        let words = format!(
            "alike by {correlation} (correlation) in both cameras, which see the same smoke; {scatter} times as far as each image by itself says"
        );
        table.words("errors of contours", words);
    }
    if let Some(s) = &record.scale {
        table.words("scale from", format!("{} = {}", s.fact, with_unit(s.value_mm, s.sigma_mm, "mm")));
    }
    table
}

/// Chi-square over so many degrees of freedom, at least, that says that edge points scatter less than their sigmas.
const LOW: f64 = 0.7;
const MANY_DEGREES: usize = 200;

/// Why edge points scatter less than their sigmas, where they do.
pub(super) fn why_low(record: &Record) -> Option<&'static str> {
    let f = &record.fit;
    if f.degrees_of_freedom <= MANY_DEGREES || f.chi2 >= LOW * f.degrees_of_freedom as f64 {
        return None;
    }
    Some(if f.sigma_scale > 1.0 {
        "sigmas were enlarged for whole discs, whose edge points scatter less"
    } else {
        "sigmas of edge points also hold noise that neighbouring pixels share, and light that is followed through smoke takes some of their scatter"
    })
}

/// How well it fits.
pub(super) fn fit(record: &Record) -> Table {
    let f = &record.fit;
    let mut table = Table::default();
    table.words(RMS_OF_DISCS, format!("{} px", plain(f.rms_px, 3)));
    if let Some(rms) = edge_rms_px(record) {
        table.words(RMS_OF_EDGES, format!("{} px", plain(rms, 3)));
    }
    table.words("chi-square over degrees of freedom", format!("{} / {}", plain(f.chi2, 6), f.degrees_of_freedom));
    if let Some(why) = why_low(record) {
        table.words("which is low, because", why);
    }
    table.words("observations", observations(record));
    table.words("redundancy", plain(f.redundancy, 4));
    table.words("outliers left out", f.outliers.to_string());
    table.words("undetermined directions", f.nullity.to_string());
    let model: Vec<_> = [&f.observation_model, &f.loss].into_iter().filter(|s| !s.is_empty()).cloned().collect();
    if !model.is_empty() {
        table.words("observations and loss", model.join(", "));
    }
    if f.sigma_scale != 1.0 {
        table.words("sigmas enlarged by", plain(f.sigma_scale, 3));
    }
    table.words("iterations", f.iterations.to_string());
    table.words("stopped on", f.termination.clone());
    table.words("Newton decrement", format!("{} sigma", plain(f.newton_decrement, 2)));
    table
}

/// A pair of parameters that move together: names and coefficient.
pub(super) struct Pair<'a> {
    pub(super) first: &'a str,
    pub(super) second: &'a str,
    pub(super) coefficient: f64,
}

/// The strongest correlations, at least `least` in size, strongest first, `most` of them. Poses of views, which all move with the cameras, are no news.
pub(super) fn correlations(record: &Record, least: f64, most: usize) -> Vec<Pair<'_>> {
    let c = &record.covariance;
    let variance = |i: usize| c.matrix.get(i).and_then(|row| row.get(i)).copied().unwrap_or(f64::NAN);
    let mut pairs = Vec::new();
    let told: Vec<usize> = (0..c.names.len()).filter(|i| !c.names[*i].contains(".rig_from_target.")).collect();
    for (n, &i) in told.iter().enumerate() {
        for &j in &told[..n] {
            let scale = (variance(i) * variance(j)).sqrt();
            let coefficient = c.matrix.get(i).and_then(|row| row.get(j)).copied().unwrap_or(f64::NAN) / scale;
            if coefficient.is_finite() && coefficient.abs() >= least {
                pairs.push(Pair { first: &c.names[j], second: &c.names[i], coefficient });
            }
        }
    }
    pairs.sort_by(|a, b| b.coefficient.abs().total_cmp(&a.coefficient.abs()));
    pairs.truncate(most);
    pairs
}
