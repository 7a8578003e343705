//! Limits of every value of a scene file, and what excludes what; messages carry the line of the key.

use super::scene::{MarkWord, PolarityKey, ScaleKey, SceneFile, syntax};
use crate::error::Result;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A scene's text with the place of every key.
pub(super) struct Lines<'a> {
    file: &'a str,
    text: &'a str,
    root: Spanned<DeTable<'a>>,
}

/// One step from a table or list to a key or place in it.
#[derive(Clone, Copy)]
pub(super) enum Step<'a> {
    Key(&'a str),
    Item(usize),
}
use crate::target::TargetKind as Kind;
use Step::{Item, Key};

impl<'a> Lines<'a> {
    pub(super) fn new(text: &'a str, file: &'a str) -> Result<Self> {
        let root = DeTable::parse(text)
            .map_err(|e| syntax(file, line_at(text, e.span().map_or(0, |s| s.start)), e.message().trim()))?;
        Ok(Self { file, text, root })
    }

    /// Line of the deepest part of `path` that the file has.
    pub(super) fn line(&self, path: &[Step]) -> usize {
        let mut at = 0;
        let mut value: Option<&Spanned<DeValue>> = None;
        for step in path {
            let found = match (step, value) {
                (Key(k), None) => self.root.get_ref().get(*k),
                (Key(k), Some(v)) => v.get_ref().get(*k),
                (Item(i), Some(v)) => v.get_ref().get(*i),
                (Item(_), None) => None,
            };
            let Some(v) = found else { break };
            at = v.span().start;
            value = Some(v);
        }
        line_at(self.text, at)
    }

    pub(super) fn refuse<T>(&self, path: &[Step], message: impl Into<String>) -> Result<T> {
        Err(syntax(self.file, self.line(path), message))
    }

    /// A number within limits, both allowed.
    fn within(&self, path: &[Step], value: f64, low: f64, high: f64) -> Result<()> {
        if value >= low && value <= high {
            return Ok(());
        }
        self.refuse(path, format!("{} = {value} is not allowed: expected {low} to {high}", name_of(path)))
    }

    fn within_all(&self, path: &[Step], values: &[f64], low: f64, high: f64) -> Result<()> {
        values.iter().try_for_each(|&v| self.within(path, v, low, high))
    }

    fn wanted<T>(&self, table: &[Step], key: &str, value: Option<T>, why: &str) -> Result<T> {
        match value {
            Some(v) => Ok(v),
            None => self.refuse(table, format!("{} needs the key {key}: {why}", name_of(table))),
        }
    }
}

fn name_of(path: &[Step]) -> String {
    let mut name = String::new();
    for step in path {
        match step {
            Key(k) if name.is_empty() => name.push_str(k),
            Key(k) => {
                name.push('.');
                name.push_str(k);
            }
            Item(i) => name.push_str(&format!("[{i}]")),
        }
    }
    name
}

/// Line, counted from 1, of a place in a text.
pub(super) fn line_at(text: &str, at: usize) -> usize {
    1 + text.bytes().take(at).filter(|&b| b == b'\n').count()
}

/// Largest length that a scene may speak of, mm: far beyond any rig, small enough to keep arithmetic sane.
const FAR_MM: f64 = 1e5;

/// Refuse what has no meaning.
pub(super) fn check(scene: &SceneFile, lines: &Lines) -> Result<()> {
    if scene.cameras.is_empty() || scene.cameras.len() > 2 {
        return lines.refuse(&[Key("camera")], format!("{} [[camera]] tables: expected 1 or 2", scene.cameras.len()));
    }
    if scene.cameras.len() == 2 && scene.cameras[0].name == scene.cameras[1].name {
        return lines.refuse(&[Key("camera"), Item(1), Key("name")], "both cameras have the same name");
    }
    for i in 0..scene.cameras.len() {
        check_camera(scene, i, lines)?;
    }
    lines.within(&[Key("sheet"), Key("offset_mm")], scene.sheet.offset_mm, -FAR_MM, FAR_MM)?;
    lines.within_all(&[Key("sheet"), Key("tilt_deg")], &scene.sheet.tilt_deg, -60.0, 60.0)?;
    check_target(scene, lines)?;
    check_image(scene, lines)?;
    check_views(scene, lines)?;
    check_random(scene, lines)?;
    check_particles(scene, lines)?;
    check_rig(scene, lines)
}

fn check_camera(scene: &SceneFile, index: usize, lines: &Lines) -> Result<()> {
    let c = &scene.cameras[index];
    let table = [Key("camera"), Item(index)];
    let at = |key| [Key("camera"), Item(index), Key(key)];
    let plain = |ch: char| ch.is_ascii_alphanumeric() || ch == '_' || ch == '-';
    if c.name.is_empty() || !c.name.chars().all(plain) || ["sheet", "plane_z_mm"].contains(&c.name.as_str()) {
        let message = format!("the camera name \"{}\" is not allowed: expected letters, digits, _ and -", c.name);
        return lines.refuse(&at("name"), message);
    }
    if c.image_size_px.iter().any(|&n| !(32..=8192).contains(&n)) {
        return lines.refuse(&at("image_size_px"), "image_size_px: expected 32 to 8192 px in each direction");
    }
    lines.within_all(&at("pixel_pitch_mm"), c.pixel_pitch_mm.as_slice(), 1e-5, 1.0)?;
    lines.within_all(&at("focal_length_mm"), c.focal_length_mm.as_slice(), 0.1, FAR_MM)?;
    lines.within_all(&at("f_px"), c.f_px.as_slice(), 10.0, 1e7)?;
    lines.within(&at("aspect"), c.aspect, 0.2, 5.0)?;
    lines.within_all(&at("axis_point_px"), c.axis_point_px.as_ref().map_or(&[], |p| p.as_slice()), -1e5, 1e5)?;
    lines.within_all(&at("alpha_deg"), c.alpha_deg.as_slice(), -75.0, 75.0)?;
    lines.within_all(&at("beta_deg"), c.beta_deg.as_slice(), -75.0, 75.0)?;
    lines.within_all(&at("k"), &c.k, -1e6, 1e6)?;
    lines.within(&at("pupil_ratio"), c.pupil_ratio, 0.1, 10.0)?;
    if c.scheimpflug && (c.alpha_deg.is_some() || c.beta_deg.is_some()) {
        return lines
            .refuse(&at("scheimpflug"), "scheimpflug = true computes the tilt: leave out alpha_deg and beta_deg");
    }
    match (&c.aim, &c.pose) {
        (Some(a), None) => {
            let at = |key| [Key("camera"), Item(index), Key("aim"), Key(key)];
            lines.within(&at("distance_mm"), a.distance_mm, 1.0, FAR_MM)?;
            lines.within(&at("viewing_angle_deg"), a.viewing_angle_deg, -180.0, 180.0)?;
            lines.within(&at("elevation_deg"), a.elevation_deg, -80.0, 80.0)?;
            lines.within(&at("roll_deg"), a.roll_deg, -360.0, 360.0)?;
            lines.within_all(&at("look_at_mm"), &a.look_at_mm, -FAR_MM, FAR_MM)?;
        }
        (None, Some(p)) => {
            let at = |key| [Key("camera"), Item(index), Key("pose"), Key(key)];
            lines.within_all(&at("rotation_vector_deg"), &p.rotation_vector_deg, -360.0, 360.0)?;
            lines.within_all(&at("translation_mm"), &p.translation_mm, -FAR_MM, FAR_MM)?;
        }
        _ => return lines.refuse(&table, "a camera needs either [camera.aim] or [camera.pose], not both"),
    }
    if c.f_px.is_none() || c.scheimpflug {
        let why = "f_px and the tilt follow from pitch, lens and distance unless they are given";
        let pitch = lines.wanted(&table, "pixel_pitch_mm", c.pixel_pitch_mm, why)?;
        if c.f_px.is_none() {
            let lens = lines.wanted(&table, "focal_length_mm", c.focal_length_mm, why)?;
            let aim = lines.wanted(&table, "aim", c.aim.as_ref(), "f_px follows from the distance of the sheet")?;
            if aim.distance_mm <= 1.001 * lens {
                let message = format!("a lens of {lens} mm forms no image of a sheet {} mm away", aim.distance_mm);
                return lines.refuse(&at("focal_length_mm"), message);
            }
        }
        debug_assert!(pitch > 0.0);
    }
    Ok(())
}

fn check_target(scene: &SceneFile, lines: &Lines) -> Result<()> {
    let t = &scene.target;
    let table = [Key("target")];
    let at = |key| [Key("target"), Key(key)];
    lines.within_all(&at("spacing_mm"), t.spacing_mm.as_slice(), 1e-3, FAR_MM)?;
    lines.within_all(&at("radii_mm"), t.radii_mm.as_ref().map_or(&[], |r| r.as_slice()), 1e-3, FAR_MM)?;
    lines.within_all(&at("radius_mm"), t.radius_mm.as_slice(), 1e-3, FAR_MM)?;
    lines.within(&at("ring_hole"), t.ring_hole, 0.05, 0.95)?;
    lines.within(&at("large_factor"), t.large_factor, 1.05, 10.0)?;
    lines.within(&at("print_error_um"), t.print_error_um, 0.0, 1e4)?;
    let pair_only = [("radii_mm", t.radii_mm.is_some())];
    let grid_only = [
        ("radius_mm", t.radius_mm.is_some()),
        ("columns", t.columns.is_some()),
        ("rows", t.rows.is_some()),
        ("step_mm", t.step_mm.is_some()),
        ("marks", !t.marks.is_empty()),
        ("origin", t.origin != [0, 0]),
    ];
    let foreign = if t.kind.is_pair() { &grid_only[..] } else { &pair_only[..] };
    if let Some((key, _)) = foreign.iter().find(|(_, given)| *given) {
        return lines.refuse(&at(key), format!("{key} means nothing for a target of kind \"{}\"", t.kind.word()));
    }
    if t.kind == Kind::Bubbles && (t.radii_mm.is_some() || t.spacing_mm.is_some()) {
        let key = if t.radii_mm.is_some() { "radii_mm" } else { "spacing_mm" };
        return lines.refuse(&at(key), format!("bubbles have {key} of their own in each [[view]], not in [target]"));
    }
    if t.kind == Kind::TwoDiscs {
        let radii = lines.wanted(&table, "radii_mm", t.radii_mm, "the two discs are the same in every view")?;
        let spacing = lines.wanted(&table, "spacing_mm", t.spacing_mm, "distance of the centres")?;
        check_pair(lines, &at("spacing_mm"), radii, spacing)?;
    }
    if !t.kind.is_pair() {
        check_grid(scene, lines)?;
    }
    Ok(())
}

fn check_pair(lines: &Lines, path: &[Step], radii_mm: [f64; 2], spacing_mm: f64) -> Result<()> {
    if spacing_mm > 1.02 * (radii_mm[0] + radii_mm[1]) {
        return Ok(());
    }
    let message = format!(
        "spacing {spacing_mm} mm with radii {} and {} mm: the discs touch or nearly do; expected a gap of 2 % at least",
        radii_mm[0], radii_mm[1]
    );
    lines.refuse(path, message)
}

fn check_grid(scene: &SceneFile, lines: &Lines) -> Result<()> {
    let t = &scene.target;
    let table = [Key("target")];
    let at = |key| [Key("target"), Key(key)];
    let pitch = lines.wanted(&table, "spacing_mm", t.spacing_mm, "pitch of the dots")?;
    let radius = lines.wanted(&table, "radius_mm", t.radius_mm, "radius of a dot")?;
    let columns = lines.wanted(&table, "columns", t.columns, "number of dots along x")?;
    let rows = lines.wanted(&table, "rows", t.rows, "number of dots along y")?;
    if !(2..=200).contains(&columns) || !(2..=200).contains(&rows) {
        return lines.refuse(&at("columns"), format!("{columns} x {rows} dots: expected 2 to 200 in each direction"));
    }
    let plate = t.kind == Kind::TwoLevelPlate;
    // The nearest other thing is a pitch away; on a plate half of it, where a mark sits between two dots.
    let free = if plate { 0.5 * pitch } else { pitch };
    if 2.04 * radius >= free {
        return lines.refuse(&at("radius_mm"), format!("dots of radius {radius} mm touch at a pitch of {pitch} mm"));
    }
    if plate {
        let step = lines.wanted(&table, "step_mm", t.step_mm, "depth of the back level")?;
        lines.within(&at("step_mm"), step, 0.0, FAR_MM)?;
    } else if t.step_mm.is_some() {
        return lines.refuse(&at("step_mm"), "step_mm means nothing for a target of kind \"dot-grid\"");
    }
    for (i, mark) in t.marks.iter().enumerate() {
        let path = [Key("target"), Key("marks"), Item(i)];
        let polygon = matches!(mark.kind, MarkWord::Square | MarkWord::Triangle);
        if polygon != plate {
            let message = "ring and large marks belong to a dot-grid, square and triangle marks to a two-level-plate";
            return lines.refuse(&path, message);
        }
        if mark.kind == MarkWord::Large && radius * (1.0 + t.large_factor) * 1.02 >= pitch {
            return lines.refuse(&path, "a large mark of large_factor * radius_mm touches its neighbours");
        }
        if mark.level > u8::from(plate) {
            return lines.refuse(
                &path,
                format!("level {}: expected 0 (front){}", mark.level, if plate { " or 1 (back)" } else { "" }),
            );
        }
        if plate && (mark.column + mark.row).rem_euclid(2) == 0 {
            return lines
                .refuse(&path, "column + row is even there, which is the place of a dot: a mark sits between dots");
        }
    }
    Ok(())
}

fn check_image(scene: &SceneFile, lines: &Lines) -> Result<()> {
    let image = &scene.image;
    let at = |key| [Key("image"), Key(key)];
    if image.blur_sigma_px != 0.0 {
        lines.within(&at("blur_sigma_px"), image.blur_sigma_px, 0.0625, 10.0)?;
    }
    lines.within(&at("bits"), f64::from(image.bits), 8.0, 16.0)?;
    let (disc, ground) = levels(scene);
    lines.within(&at("disc_level"), disc, 0.0, 1.0)?;
    lines.within(&at("ground_level"), ground, 0.0, 1.0)?;
    lines.within(&at("offset_level"), image.offset_level, 0.0, 0.5)?;
    lines.within_all(&at("full_well_e"), image.full_well_e.as_slice(), 10.0, 1e7)?;
    lines.within(&at("read_noise_e"), image.read_noise_e, 0.0, 1e5)?;
    if image.read_noise_e > 0.0 && image.full_well_e.is_none() {
        return lines
            .refuse(&at("read_noise_e"), "read_noise_e needs full_well_e, which says how many electrons are white");
    }
    lines.within(&at("smoke"), image.smoke, 0.0, 0.95)?;
    lines.within(&at("smoke_length_mm"), image.smoke_length_mm, 1e-2, FAR_MM)?;
    lines.within(&at("unevenness"), image.unevenness, 0.0, 0.95)?;
    if let Some(g) = &image.glare {
        let at = |key| [Key("image"), Key("glare"), Key(key)];
        lines.within(&at("count"), g.count as f64, 0.0, 1000.0)?;
        lines.within(&at("radius_px"), g.radius_px, 0.3, 1e3)?;
        lines.within(&at("level"), g.level, 0.0, 10.0)?;
    }
    let bright = scene.target.polarity == PolarityKey::Bright;
    if (disc > ground) != bright || disc == ground {
        let message = format!(
            "polarity \"{}\" contradicts disc_level {disc} on ground_level {ground}",
            if bright { "bright" } else { "dark" }
        );
        return lines.refuse(&at("disc_level"), message);
    }
    Ok(())
}

/// Grey of discs and of the ground around them, as parts of full scale.
pub(super) fn levels(scene: &SceneFile) -> (f64, f64) {
    let (disc, ground) = match scene.target.polarity {
        PolarityKey::Bright => (0.7, 0.05),
        PolarityKey::Dark => (0.1, 0.7),
    };
    (scene.image.disc_level.unwrap_or(disc), scene.image.ground_level.unwrap_or(ground))
}

fn check_views(scene: &SceneFile, lines: &Lines) -> Result<()> {
    if scene.views.is_empty() && scene.random.is_none() {
        return lines.refuse(&[], "no views: list [[view]] tables or say [random] how many");
    }
    for (i, v) in scene.views.iter().enumerate() {
        let table = [Key("view"), Item(i)];
        let at = |key| [Key("view"), Item(i), Key(key)];
        lines.within_all(&at("position_mm"), &v.position_mm, -FAR_MM, FAR_MM)?;
        lines.within_all(&at("rotation_deg"), &v.rotation_deg, -360.0, 360.0)?;
        lines.within_all(&at("plane_z_mm"), v.plane_z_mm.as_slice(), -FAR_MM, FAR_MM)?;
        if v.sheet && v.plane_z_mm.is_some_and(|z| z != 0.0) {
            return lines.refuse(&at("plane_z_mm"), "sheet = true is plane_z_mm = 0: one of them is wrong");
        }
        let in_plane = v.sheet || v.plane_z_mm.is_some();
        if in_plane && (v.rotation_deg[0] != 0.0 || v.rotation_deg[1] != 0.0 || v.position_mm[2] != 0.0) {
            let message =
                "a view in (or parallel to) the sheet has position_mm = [x, y, 0] and rotation_deg = [0, 0, spin]";
            return lines.refuse(&table, message);
        }
        if scene.target.kind == Kind::Bubbles {
            let why = "bubbles have radii and a spacing of their own in each view";
            let radii = lines.wanted(&table, "radii_mm", v.radii_mm, why)?;
            let spacing = lines.wanted(&table, "spacing_mm", v.spacing_mm, why)?;
            lines.within_all(&at("radii_mm"), &radii, 1e-3, FAR_MM)?;
            lines.within(&at("spacing_mm"), spacing, 1e-3, FAR_MM)?;
            check_pair(lines, &at("spacing_mm"), radii, spacing)?;
        } else if v.radii_mm.is_some() || v.spacing_mm.is_some() || v.printed {
            return lines
                .refuse(&table, "radii_mm, spacing_mm and printed of a view are for a target of kind \"bubbles\"");
        }
    }
    Ok(())
}

fn check_random(scene: &SceneFile, lines: &Lines) -> Result<()> {
    let Some(r) = &scene.random else { return Ok(()) };
    let table = [Key("random")];
    let at = |key| [Key("random"), Key(key)];
    if r.sheet_count > r.count || r.count == 0 || r.count > 1000 {
        return lines.refuse(&at("count"), "count: expected 1 to 1000, of which sheet_count are in the sheet");
    }
    lines.within_all(&at("tilt_deg"), &r.tilt_deg, 0.0, 80.0)?;
    lines.within(&at("spin_deg"), r.spin_deg, 0.0, 180.0)?;
    lines.within_all(&at("position_mm"), &r.position_mm, 0.0, FAR_MM)?;
    if scene.target.kind != Kind::Bubbles {
        if r.radii_mm.is_some() || r.spacing_mm.is_some() {
            return lines.refuse(&table, "radii_mm and spacing_mm of [random] are for a target of kind \"bubbles\"");
        }
        return Ok(());
    }
    let why = "bubbles have radii and a spacing of their own in each view, drawn from [low, high]";
    let radii = lines.wanted(&table, "radii_mm", r.radii_mm, why)?;
    let spacing = lines.wanted(&table, "spacing_mm", r.spacing_mm, why)?;
    for range in radii.iter().chain([&spacing]) {
        lines.within_all(&table, range, 1e-3, FAR_MM)?;
        if range[0] > range[1] {
            return lines.refuse(&table, format!("the range [{}, {}] runs backwards", range[0], range[1]));
        }
    }
    check_pair(lines, &at("spacing_mm"), [radii[0][1], radii[1][1]], spacing[0])
}

fn check_particles(scene: &SceneFile, lines: &Lines) -> Result<()> {
    let Some(p) = &scene.particles else { return Ok(()) };
    let at = |key| [Key("particles"), Key(key)];
    if !(1..=1000).contains(&p.pairs) {
        return lines.refuse(&at("pairs"), format!("particles.pairs = {}: expected 1 to 1000", p.pairs));
    }
    lines.within(&at("per_mm2"), p.per_mm2, 1e-3, 1e4)?;
    lines.within(&at("thickness_mm"), p.thickness_mm, 1e-3, 100.0)?;
    lines.within(&at("level"), p.level, 1e-3, 100.0)?;
    lines.within(&at("offset_mm"), p.offset_mm, -FAR_MM, FAR_MM)?;
    lines.within_all(&at("tilt_deg"), &p.tilt_deg, -45.0, 45.0)?;
    let Some(f) = &p.flow else { return Ok(()) };
    let at = |key| [Key("particles"), Key("flow"), Key(key)];
    lines.within_all(&at("shift_mm"), &f.shift_mm, -FAR_MM, FAR_MM)?;
    lines.within(&at("vortex_mm"), f.vortex_mm, -FAR_MM, FAR_MM)?;
    lines.within(&at("jet_mm"), f.jet_mm, -FAR_MM, FAR_MM)?;
    lines.within(&at("radius_mm"), f.radius_mm, 1e-3, FAR_MM)?;
    lines.within_all(&at("center_mm"), &f.center_mm, -FAR_MM, FAR_MM)
}

fn check_rig(scene: &SceneFile, lines: &Lines) -> Result<()> {
    let rig = &scene.rig;
    let at = |key| [Key("rig"), Key(key)];
    let views = scene.views.len() + scene.random.as_ref().map_or(0, |r| r.count);
    if rig.scale_view >= views {
        return lines.refuse(
            &at("scale_view"),
            format!("scale_view = {}: there are {views} views, counted from 0", rig.scale_view),
        );
    }
    lines.within_all(&at("scale_sigma_mm"), rig.scale_sigma_mm.as_slice(), 1e-9, FAR_MM)?;
    let bubbles = scene.target.kind == Kind::Bubbles;
    match rig.scale {
        Some(ScaleKey::Target) | None if bubbles => {
            let message = "bubbles give no length: rig.scale must be \"baseline\", \"view-spacing\", \"view-radius\" or \"traverse\"";
            return lines.refuse(&at("scale"), message);
        }
        Some(ScaleKey::Target) | None => {}
        Some(ScaleKey::Traverse) if scene.views.iter().filter(|v| v.plane_z_mm.is_some()).count() < 2 => {
            return lines.refuse(&at("scale"), "scale = \"traverse\" needs plane_z_mm in at least two [[view]] tables");
        }
        Some(ScaleKey::Baseline) if scene.cameras.len() < 2 => {
            return lines.refuse(&at("scale"), "scale = \"baseline\" needs two cameras");
        }
        Some(ScaleKey::ViewSpacing | ScaleKey::ViewRadius) if !scene.target.kind.is_pair() => {
            return lines.refuse(&at("scale"), "scale = \"view-spacing\" and \"view-radius\" are for pairs of discs");
        }
        Some(_) => {}
    }
    let word = |key: &'static str, value: &Option<String>, allowed: &[&str]| match value {
        Some(v) if !allowed.contains(&v.as_str()) => {
            lines.refuse(&at(key), format!("{key} = \"{v}\": expected one of {}", allowed.join(", ")))
        }
        _ => Ok(()),
    };
    word("adjust", &rig.adjust, &["none", "shape", "points"])?;
    word("observations", &rig.observations, &["contour", "bitangent"])?;
    word("loss", &rig.loss, &["none", "huber", "cauchy"])?;
    for term in rig.estimate.iter().flatten() {
        word("estimate", &Some(term.clone()), &["k1", "k2", "k3"])?;
    }
    if let Some(f) = &rig.focus {
        lines.within(&at("focus"), f.tilt_sigma_deg, 1e-6, 45.0)?;
        lines.within(&at("focus"), f.distance_sigma, 1e-9, 1.0)?;
        if scene.cameras.iter().any(|c| c.focal_length_mm.is_none() || c.pixel_pitch_mm.is_none()) {
            return lines.refuse(&at("focus"), "focus needs focal_length_mm and pixel_pitch_mm of every camera");
        }
    }
    Ok(())
}
