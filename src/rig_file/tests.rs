//! What is read, and what is refused at which line.

use super::*;
use crate::error::{Error, Invalid};
use crate::target::{DotId, Grid, Mark, MarkKind, Pair};

const FULL: &str = r#"# line 1
[[camera]]
name = "left"
pixel_pitch_mm = 0.00625
focal_length_mm = 50
[camera.known]
f_px = { value = 8889, sigma = 90 }
alpha_deg = { value = 2.0, sigma = 1.0 }
k2 = { fixed = 0.0 }

[[camera]]
name = "right"
pixel_pitch_mm = 0.00625
focal_length_mm = 50.0

[target]
kind = "two-discs"
polarity = "bright"
spacing_mm = { value = 26.0, sigma = 0.01 }
radii_mm = [12.5, 10.0]
adjust = "shape"

[focus]
tilt_sigma_deg = 0.5

[solve]
observations = "bitangent"
loss = "cauchy"
estimate = ["k3", "k1"]

[[view]]
left = "v1_left.png"
right = "v1_right.png"

[[view]]
right = "v2_right.png"
sheet = true
plane_z_mm = 0
"#;

const BUBBLES: &str = r#"[[camera]]
name = "left"
[[camera]]
name = "right"
[target]
kind = "bubbles"
[scale]
baseline_mm = 707
[[view]]
left = "a.png"
right = "b.png"
plane_z_mm = 0.0
[[view]]
left = "c.png"
right = "d.png"
plane_z_mm = 2.0
sheet = false
"#;

const GRID: &str = r#"[[camera]]
name = "only"
[target]
kind = "dot-grid"
spacing_mm = 3.5
columns = 10
rows = 8
marks = [
  { kind = "ring", column = 0, row = 0 },
  { kind = "ring", column = 5, row = 0 },
  { kind = "large", column = 0, row = 3 },
]
[[view]]
only = "a.png"
"#;

const PLATE: &str = r#"[[camera]]
name = "left"
[target]
kind = "two-level-plate"
spacing_mm = 15
step_mm = 3
radii_mm = [1.6]
marks = [{ kind = "square", column = 1, row = 1, level = 1 }]
[[view]]
left = "a.png"
"#;

fn parse(text: &str) -> RigDescription {
    RigDescription::parse(text, "rig.toml").unwrap()
}

/// Replaces `from` (which must be there) and returns line and message of the refusal.
fn refusal(text: &str, from: &str, to: &str) -> (usize, String) {
    assert!(text.contains(from), "the case does not fit its text: {from}");
    match RigDescription::parse(&text.replacen(from, to, 1), "rig.toml") {
        Err(Error::Invalid(Invalid::Syntax { line, message, .. })) => (line, message),
        other => panic!("{from:?} -> {to:?} gave {other:?}"),
    }
}

#[track_caller]
fn refused(text: &str, from: &str, to: &str, line: usize, words: &[&str]) {
    let (found, message) = refusal(text, from, to);
    assert_eq!(found, line, "{message}");
    for word in words {
        assert!(message.contains(word), "{word:?} is not in: {message}");
    }
}

#[test]
fn everything_is_read() {
    let job = parse(FULL);
    let left = &job.cameras[0];
    assert_eq!((left.pixel_pitch_mm, left.focal_length_mm), (Some(0.00625), Some(50.0)));
    assert_eq!(left.knowledge(Parameter::F), Some(Knowledge::Prior { value: 8889.0, sigma: 90.0 }));
    let alpha = Knowledge::Prior { value: 2f64.to_radians(), sigma: 1f64.to_radians() };
    assert_eq!(left.knowledge(Parameter::Alpha), Some(alpha));
    assert_eq!(left.knowledge(Parameter::K2), Some(Knowledge::Fixed { value: 0.0 }));
    assert_eq!(left.knowledge(Parameter::Beta), None);
    assert_eq!(job.target.target, Target::TwoDiscs(Pair { spacing_mm: Some(26.0), radii_mm: Some([12.5, 10.0]) }));
    assert_eq!(job.target.polarity, Polarity::Bright);
    assert_eq!(job.scale, Scale::TargetSpacing(Length { value_mm: 26.0, sigma_mm: Some(0.01) }));
    let focus = Focus { tilt_sigma_rad: 0.5f64.to_radians(), distance_sigma: Some(0.005) };
    assert_eq!(job.focus, Some(focus));
    assert_eq!(job.solve.estimate, [Parameter::K1, Parameter::K3]);
    assert_eq!((job.solve.observations, job.solve.loss), (Observations::Bitangent, Loss::Cauchy));
    assert_eq!(job.views[0].images, [Some("v1_left.png".to_string()), Some("v1_right.png".to_string())]);
    let second = &job.views[1];
    let at = Some(PlaneZ::Known { z_mm: 0.0, sigma_mm: None });
    assert_eq!((second.images[0].as_deref(), second.sheet, second.plane_z_mm), (None, true, at));
    assert_eq!(second.line, 35);
    assert!(job.has_sheet() && job.camera_index("right") == Some(1) && job.text == FULL);
}

#[test]
fn defaults_are_the_documented_ones() {
    let job = parse(GRID);
    let mark = |kind, column, row| Mark { kind, at: DotId { column, row, level: 0 } };
    let grid = Grid {
        spacing_mm: Some(3.5),
        columns: Some(10),
        rows: Some(8),
        radius_mm: None,
        marks: vec![mark(MarkKind::Ring, 0, 0), mark(MarkKind::Ring, 5, 0), mark(MarkKind::Large, 0, 3)],
    };
    assert_eq!(job.target.target, Target::DotGrid(grid));
    assert_eq!((job.target.polarity, job.target.adjust), (Polarity::Auto, Adjust::Shape));
    assert_eq!((job.target.point_sigma_mm, job.focus), (None, None));
    assert_eq!(
        job.solve,
        Solve { observations: Observations::Contour, loss: Loss::Huber, estimate: vec![Parameter::K1] }
    );
    assert_eq!((job.views[0].sheet, job.views[0].plane_z_mm), (false, None));
    let focused = parse(&FULL.replace("tilt_sigma_deg = 0.5", "")).focus.unwrap();
    assert_eq!(focused.tilt_sigma_rad, Focus::DEFAULT_TILT_SIGMA_DEG.to_radians());
}

#[test]
fn every_metric_fact_is_read() {
    let fact = |to: &str| parse(&BUBBLES.replace("baseline_mm = 707", to)).scale;
    let exact = |value_mm| Length { value_mm, sigma_mm: None };
    let soft = |value_mm, s| Length { value_mm, sigma_mm: Some(s) };
    assert_eq!(fact("baseline_mm = 707"), Scale::Baseline(exact(707.0)));
    assert_eq!(fact("baseline_mm = { value = 707.0, sigma = 0.5 }"), Scale::Baseline(soft(707.0, 0.5)));
    let spacing = Scale::ViewSpacing { view: 1, spacing: soft(26.1, 0.2) };
    assert_eq!(fact("spacing_mm = { view = 1, value = 26.1, sigma = 0.2 }"), spacing);
    let radius = Scale::ViewRadius { view: 0, disc: 1, radius: exact(12.3) };
    assert_eq!(fact("radius_mm = { view = 0, disc = 1, value = 12.3 }"), radius);
    assert_eq!(fact("plane_z_mm = true"), Scale::Traverse { sigma_mm: None });
    assert_eq!(fact("plane_z_mm = { sigma = 0.02 }"), Scale::Traverse { sigma_mm: Some(0.02) });
    let bare = BUBBLES.replace("[scale]\nbaseline_mm = 707\n", "");
    assert_eq!(parse(&bare).scale, Scale::Traverse { sigma_mm: None });
    let place = |to: &str| parse(&BUBBLES.replace("plane_z_mm = 2.0\nsheet = false", to)).views[1].plane_z_mm;
    let about = PlaneZ::Known { z_mm: 2.0, sigma_mm: Some(0.01) };
    assert_eq!(place("plane_z_mm = { value = 2.0, sigma = 0.01 }"), Some(about));
    assert_eq!(place("plane_z_mm = \"unknown\""), Some(PlaneZ::Unknown));
    assert_eq!(parse(PLATE).scale, Scale::TargetSpacing(exact(15.0)));
    let discs = GRID.replace("spacing_mm = 3.5", "radii_mm = [0.9]");
    assert_eq!(parse(&discs).scale, Scale::TargetRadius { disc: 0, radius: exact(0.9) });
}

#[test]
fn a_scale_on_two_discs_belongs_to_the_plate() {
    let two = BUBBLES.replace("\"bubbles\"", "\"two-discs\"");
    let job = parse(&two.replace("baseline_mm = 707", "spacing_mm = { view = 1, value = 26.1 }"));
    assert_eq!(job.scale, Scale::TargetSpacing(Length { value_mm: 26.1, sigma_mm: None }));
    assert_eq!(job.target.target, Target::TwoDiscs(Pair { spacing_mm: Some(26.1), radii_mm: None }));
    let job = parse(&two.replace("baseline_mm = 707", "radius_mm = { view = 1, disc = 1, value = 9 }"));
    assert_eq!(job.scale, Scale::TargetRadius { disc: 1, radius: Length { value_mm: 9.0, sigma_mm: None } });
}

#[test]
fn a_drawing_gives_focal_length_and_tilts() {
    let design = "[camera.design]\nobject_distance_mm = 500\nviewing_angle_deg = 45";
    // Without what [camera.known] says of f and alpha.
    let bare = FULL.replace("f_px = { value = 8889, sigma = 90 }\nalpha_deg = { value = 2.0, sigma = 1.0 }\n", "");
    let known = "[camera.known]\n";
    let with = |more: &str| bare.replacen(known, &format!("{design}{more}\n{known}"), 1);
    let found = parse(&with("")).cameras[0].design.unwrap();
    assert!((found.f_px - 8888.89).abs() < 0.01 && (found.beta_rad.to_degrees() - 6.340).abs() < 0.001, "{found:?}");
    assert_eq!((found.alpha_rad, found.f_sigma_px, found.tilt_sigma_rad), (0.0, None, None));
    let found = parse(&with("\nviewing_angle_vertical_deg = -10\nf_sigma = 0.01\ntilt_sigma_deg = 0.5")).cameras[0]
        .design
        .unwrap();
    assert!(found.alpha_rad < 0.0 && (found.f_sigma_px.unwrap() - 88.8889).abs() < 1e-3);
    assert_eq!(found.tilt_sigma_rad, Some(0.5f64.to_radians()));
    refused(&with(""), "object_distance_mm = 500\n", "", 6, &["[camera.design]", "object_distance_mm", "missing"]);
    refused(&with(""), "object_distance_mm = 500", "object_distance_mm = 49", 7, &["above the focal length of 50 mm"]);
    refused(&with(""), "viewing_angle_deg = 45", "viewing_angle_deg = 90", 8, &["between -89 and 89"]);
    refused(&with(""), "viewing_angle_deg = 45", "angle_deg = 45", 8, &["unknown key", "viewing_angle_deg"]);
    refused(&with(""), "focal_length_mm = 50\n", "", 5, &["needs focal_length_mm of camera \"left\""]);
    refused(
        &with("\nf_sigma = 0.01"),
        known,
        "[camera.known]\nf_px = { value = 8889, sigma = 9 }\n",
        9,
        &["f_px", "remove one"],
    );
    refused(&with("\nf_sigma = 1"), "f_sigma = 1", "f_sigma = 1", 9, &["relative standard deviation"]);
}

#[test]
fn text_that_is_no_toml_is_refused_at_its_line() {
    refused(FULL, "name = \"left\"", "name = left", 3, &["not valid TOML"]);
    refused(FULL, "name = \"left\"", "name = \"left\"\nname = \"again\"", 4, &["not valid TOML", "duplicate"]);
    let (line, message) = refusal("x", "x", "");
    assert!(line == 1 && message.contains("[[camera]]"), "{message}");
}

/// What cannot be said so is told how else, in words that are right there.
#[test]
fn exact_values_and_positions_are_told_how_they_are_written() {
    let prior = "f_px = { value = 8889, sigma = 90 }";
    let exact = "f_px = { value = 8889, sigma = 0 }";
    refused(FULL, prior, exact, 7, &["for a value that is exact, write f_px = { fixed = 8889 }"]);
    refused(FULL, prior, "f_px = { value = 8889, sigma = -1 }", 7, &["{ fixed = ... }", "found -1"]);
    for wrong in ["\"x\"", "true"] {
        let z = format!("plane_z_mm = {wrong}");
        refused(
            BUBBLES,
            "plane_z_mm = 0.0",
            &z,
            12,
            &["a finite number in mm between -1 km and 1 km, { value = ..., sigma = ... } or \"unknown\""],
        );
    }
}

/// Lengths and places that no rig has would end in numbers that no sum holds.
#[test]
fn lengths_and_places_of_no_rig_are_refused() {
    for wrong in ["1e-160", "0", "1e7"] {
        refused(
            GRID,
            "spacing_mm = 3.5",
            &format!("spacing_mm = {wrong}"),
            5,
            &["above 0 (1e-6 at least) and below 1 km"],
        );
    }
    refused(BUBBLES, "plane_z_mm = 0.0", "plane_z_mm = 1e300", 12, &["between -1 km and 1 km"]);
}

#[test]
fn unknown_keys_are_refused_with_the_nearest() {
    refused(FULL, "[solve]", "[sovle]", 26, &["unknown key \"sovle\"", "did you mean \"solve\"?"]);
    refused(FULL, "[focus]", "[views]", 23, &["[[view]]"]);
    refused(FULL, "pixel_pitch_mm", "pixel_pitch", 4, &["did you mean \"pixel_pitch_mm\"?"]);
    refused(FULL, "f_px =", "F_px =", 7, &["did you mean \"f_px\"?"]);
    refused(FULL, "focal_length_mm = 50\n", "k1 = 3\n", 5, &["[camera.known]"]);
    refused(FULL, "fixed = 0.0", "fix = 0.0", 9, &["did you mean \"fixed\"?"]);
    refused(FULL, "radii_mm", "radii", 20, &["did you mean \"radii_mm\"?"]);
    refused(FULL, "polarity = \"bright\"", "rows = 3", 18, &["\"dot-grid\"", "two-discs"]);
    refused(FULL, "tilt_sigma_deg", "tilt_sigma", 24, &["did you mean \"tilt_sigma_deg\"?"]);
    refused(FULL, "loss", "los", 28, &["did you mean \"loss\"?"]);
    refused(
        FULL,
        "right = \"v2",
        "rihgt = \"v2",
        36,
        &["did you mean \"right\"?", "cameras are called \"left\", \"right\""],
    );
    refused(BUBBLES, "baseline_mm", "base_line_mm", 8, &["did you mean \"baseline_mm\"?"]);
    refused(GRID, "ring\", column", "ring\", col", 9, &["did you mean \"column\"?"]);
}

#[test]
fn wrong_types_are_refused() {
    refused(FULL, "[[view]]\nleft", "[view]\nleft", 35, &["not valid TOML"]);
    refused(GRID, "[[view]]", "[view]", 13, &["[[view]]", "double brackets"]);
    refused(FULL, "0.00625", "\"6.25 um\"", 4, &["6.25 um", "0.00625"]);
    refused(FULL, "{ value = 8889, sigma = 90 }", "8889", 7, &["fixed"]);
    refused(FULL, "sheet = true", "sheet = \"yes\"", 37, &["true or false"]);
    refused(FULL, "left = \"v1_left.png\"", "left = 3", 32, &["path of an image"]);
    refused(GRID, "columns = 10", "columns = 10.5", 6, &["whole number", "10.5"]);
    refused(GRID, "rows = 8", "rows = -8", 7, &["-8"]);
    refused(FULL, "[12.5, 10.0]", "12.5", 20, &["two radii"]);
    refused(FULL, "[12.5, 10.0]", "[12.5]", 20, &["two radii", "a list of 1"]);
    refused(FULL, "\"cauchy\"", "\"huder\"", 28, &["did you mean \"huber\"?", "\"none\""]);
    refused(FULL, "\"bright\"", "\"white\"", 18, &["\"bright\", \"dark\""]);
}

#[test]
fn numbers_without_meaning_are_refused() {
    for (from, line) in [("50\n", 5), ("8889", 7), ("2.0,", 8), ("1.0 }", 8), ("0.0 }", 9), ("26.0", 19), ("12.5", 20)]
    {
        for bad in ["nan", "-nan", "inf", "-inf", "1e999"] {
            let tail = from.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
            refused(FULL, from, &format!("{bad}{tail}"), line, &["expected"]);
        }
    }
    refused(FULL, "plane_z_mm = 0", "plane_z_mm = nan", 38, &["finite", "nan"]);
    refused(FULL, "0.00625", "6.25", 4, &["6.25 micrometres are 0.00625"]);
    refused(FULL, "0.00625", "-0.00625", 4, &["-0.00625"]);
    for sigma in ["sigma = 0", "sigma = 1e-300", "sigma = -1"] {
        refused(FULL, "sigma = 90", sigma, 7, &["finite standard deviation above 1e-12"]);
    }
    refused(FULL, "value = 8889", "value = -8889", 7, &["above 0"]);
    refused(FULL, "value = 2.0", "value = 120", 8, &["-89 and 89"]);
    refused(FULL, "tilt_sigma_deg = 0.5", "tilt_sigma_deg = 0", 24, &["above 0"]);
    refused(FULL, "tilt_sigma_deg = 0.5", "distance_sigma = 2", 24, &["0.005"]);
    refused(FULL, "26.0", "-26.0", 19, &["above 0"]);
    refused(BUBBLES, "707", "0", 8, &["above 0"]);
    refused(PLATE, "step_mm = 3", "step_mm = -3", 6, &["above 0"]);
}

#[test]
fn contradictions_about_cameras_are_refused() {
    refused(FULL, "\"right\"", "\"left\"", 12, &["both cameras", "left"]);
    refused(FULL, "\"right\"", "\"Left\"", 12, &["both cameras"]);
    refused(FULL, "\"right\"", "\"sheet\"", 12, &["[[view]]"]);
    refused(FULL, "\"right\"", "\"a/b\"", 12, &["letters"]);
    refused(FULL, "[target]", "[[camera]]\nname = \"third\"\n[target]", 16, &["3 cameras"]);
    refused(FULL, "fixed = 0.0", "fixed = 0.0, sigma = 1", 9, &["at once"]);
    refused(FULL, "fixed = 0.0", "fixed = 0.0, value = 1, sigma = 1", 9, &["at once"]);
    refused(FULL, "fixed = 0.0", "value = 0.0", 9, &["sigma"]);
    refused(FULL, "fixed = 0.0", "sigma = 0.1", 9, &["value"]);
    refused(FULL, "{ fixed = 0.0 }", "{}", 9, &["fixed"]);
    refused(FULL, "\"k3\"", "\"k2\"", 29, &["\"k2\"", "\"left\"", "fixes"]);
    refused(FULL, "\"k3\"", "\"k1\"", 29, &["twice"]);
    refused(FULL, "\"k3\"", "\"aspect\"", 29, &["[camera.known]"]);
    refused(FULL, "\"k3\"", "\"k4\"", 29, &["\"k4\"", "k3"]);
}

#[test]
fn contradictions_about_the_target_are_refused() {
    refused(FULL, "[12.5, 10.0]", "[16.0, 10.0]", 20, &["overlap", "16", "26"]);
    refused(FULL, "[12.5, 10.0]", "[16.5, 9.5]", 20, &["overlap"]);
    refused(GRID, "rows = 8", "radii_mm = [1.75]", 7, &["overlap", "pitch"]);
    refused(PLATE, "[1.6]", "[5.5]", 7, &["overlap", "other level"]);
    refused(GRID, "columns = 10", "columns = 5", 8, &["span 6 columns", "columns = 5"]);
    refused(GRID, "column = 5, row = 0", "column = 0, row = 0", 10, &["same place", "mark 1"]);
    refused(GRID, "column = 5, row = 0", "column = 5, row = 0, level = 1", 10, &["two-level"]);
    refused(PLATE, "level = 1", "level = 2", 8, &["front"]);
    refused(PLATE, "spacing_mm = 15\n", "", 3, &["spacing_mm"]);
    refused(PLATE, "step_mm = 3\n", "", 3, &["step_mm"]);
    refused(FULL, "\"shape\"", "\"points\"", 21, &["grids"]);
    refused(BUBBLES, "[scale]", "adjust = \"none\"\n[scale]", 7, &["always estimated"]);
    refused(GRID, "rows = 8", "adjust = \"none\"", 7, &["radii_mm is missing"]);
    refused(GRID, "rows = 8", "point_sigma_mm = 0.01", 7, &["adjust = \"points\""]);
    // A hundredth of which pitch?
    let unscaled = GRID.replace("spacing_mm = 3.5", "radii_mm = [1.0]");
    refused(&unscaled, "rows = 8", "adjust = \"points\"", 7, &["point_sigma_mm", "spacing_mm is missing"]);
    assert_eq!(
        parse(&unscaled.replace("rows = 8", "adjust = \"points\"\npoint_sigma_mm = 0.02")).target.point_sigma_mm,
        Some(0.02)
    );
    refused(GRID, "[[view]]", "[solve]\nobservations = \"bitangent\"\n[[view]]", 14, &["pair"]);
}

#[test]
fn contradictions_about_the_scale_are_refused() {
    refused(FULL, "[focus]", "[scale]\nbaseline_mm = 707\n[focus]", 24, &["[target] spacing_mm", "already"]);
    refused(BUBBLES, "baseline_mm = 707", "", 7, &["exactly one"]);
    refused(BUBBLES, "= 707", "= 707\nplane_z_mm = true", 9, &["second fact beside baseline_mm"]);
    refused(BUBBLES, "[scale]", "spacing_mm = 26\n[scale]", 7, &["bubbles", "view = 0"]);
    let bare = BUBBLES.replace("[scale]\nbaseline_mm = 707\n", "");
    refused(&bare, "plane_z_mm = 2.0", "plane_z_mm = 0.0", 5, &["nothing sets the scale", "two different"]);
    refused(&bare, "plane_z_mm = 2.0", "", 5, &["nothing sets the scale"]);
    // The sheet itself is a position, whether it is written or not.
    assert_eq!(parse(&bare.replace("plane_z_mm = 0.0\n", "sheet = true\n")).scale, Scale::Traverse { sigma_mm: None });
    let steps = BUBBLES.replace("baseline_mm = 707", "plane_z_mm = true");
    refused(&steps, "plane_z_mm = 2.0", "plane_z_mm = 0.0", 8, &["two views"]);
    refused(&steps, "plane_z_mm = 2.0\nsheet = false", "plane_z_mm = \"unknown\"", 8, &["two views"]);
    let unknown = BUBBLES.replace("plane_z_mm = 0.0", "");
    refused(
        &unknown,
        "plane_z_mm = 2.0\nsheet = false",
        "plane_z_mm = \"unknown\"",
        13,
        &["counts from", "sheet = true"],
    );
    let at_zero = ["[[view]] 1 plane_z_mm", "in the laser sheet, exactly at plane_z_mm = 0", "remove sheet = true"];
    for elsewhere in ["2.0", "\"unknown\"", "{ value = 2.0 }", "{ value = 0.0, sigma = 0.1 }"] {
        let place = format!("sheet = true\nplane_z_mm = {elsewhere}");
        refused(BUBBLES, "plane_z_mm = 2.0\nsheet = false", &place, 17, &at_zero);
    }
    refused(BUBBLES, "baseline_mm = 707", "spacing_mm = { view = 2, value = 26 }", 8, &["from 0 to 1"]);
    refused(BUBBLES, "baseline_mm = 707", "spacing_mm = { view = -1, value = 26 }", 8, &["from 0 to 1"]);
    refused(BUBBLES, "baseline_mm = 707", "spacing_mm = 26", 8, &["view = ..."]);
    refused(BUBBLES, "baseline_mm = 707", "radius_mm = { view = 0, disc = 2, value = 9 }", 8, &["0 or 1"]);
    refused(GRID, "spacing_mm = 3.5\n", "", 3, &["nothing sets the scale"]);
    let grid = GRID.replace("spacing_mm = 3.5\n", "").replace("[[view]]", "[scale]\nbaseline_mm = 7\n[[view]]");
    refused(&grid, "rows = 8", "rows = 8", 13, &["one camera"]);
    refused(&grid, "baseline_mm = 7", "spacing_mm = { view = 0, value = 3.5 }", 13, &["[target]"]);
}

#[test]
fn contradictions_about_views_and_focus_are_refused() {
    refused(GRID, "only = \"a.png\"", "only = \"a.png\"\nsheet = true", 15, &["two cameras"]);
    refused(GRID, "only = \"a.png\"", "", 13, &["no image"]);
    refused(GRID, "only = \"a.png\"", "only = \"\"", 14, &["empty"]);
    refused(GRID, "[[view]]\nonly = \"a.png\"", "", 1, &["[[view]]"]);
    refused(BUBBLES, "\"d.png\"", "\"a.png\"", 13, &["\"a.png\"", "view 0"]);
    refused(BUBBLES, "\"d.png\"", "\"c.png\"", 13, &["\"c.png\"", "view 1"]);
    refused(FULL, "left = \"v1_left.png\"\n", "", 31, &["nothing ties the cameras together"]);
    refused(FULL, "sheet = true\n", "", 23, &["sheet = true"]);
    let without_lens = FULL.replace("focal_length_mm = 50.0", "").replace("tilt_sigma_deg", "distance_sigma");
    refused(&without_lens, "bright", "dark", 24, &["\"right\"", "focal_length_mm"]);
    refused(FULL, "pixel_pitch_mm = 0.00625\nfocal_length_mm = 50.0", "", 22, &["\"right\"", "pixel_pitch_mm"]);
    let tilt_only = parse(&FULL.replace("focal_length_mm = 50.0", ""));
    assert_eq!(tilt_only.focus.unwrap().distance_sigma, None);
}

#[test]
fn images_are_beside_the_rig_file_or_where_told() {
    let rig = Path::new("a/rig.toml");
    assert_eq!(image_path(rig, None, "x/i.png"), Path::new("a/x/i.png"));
    assert_eq!(image_path(rig, Some(Path::new("b")), "x/i.png"), Path::new("b/x/i.png"));
    assert_eq!(image_path(Path::new("rig.toml"), None, "i.png"), Path::new("i.png"));
    let absolute = if cfg!(windows) { "C:\\i.png" } else { "/i.png" };
    assert_eq!(image_path(rig, Some(Path::new("b")), absolute), Path::new(absolute));
}

#[test]
fn line_ends_of_windows_count_once() {
    refused(&FULL.replace('\n', "\r\n"), "8889", "nan", 7, &["f_px"]);
}

/// A window stands below its camera, and needs views from which its direction is counted.
const WINDOW: &str = r#"[[camera]]
name = "a"
[camera.window]
distance_mm = { value = 300, sigma = 20 }
thickness_mm = 12
n_glass = { value = 1.49, sigma = 0.01 }
tilt_sigma_deg = 0.5
[[camera]]
name = "b"
[target]
kind = "two-discs"
spacing_mm = 26.0
[[view]]
a = "a.png"
b = "b.png"
sheet = true
"#;

#[test]
fn a_window_is_read_and_its_contradictions_are_refused() {
    let job = RigDescription::parse(WINDOW, "rig.toml").unwrap();
    let window = job.cameras[0].window.unwrap();
    let want = [(300.0, Some(20.0)), (12.0, None), (1.0, None), (1.49, Some(0.01)), (1.333, None)];
    assert_eq!(window.layers, want);
    assert!((window.tilt_sigma_rad - 0.5f64.to_radians()).abs() < 1e-15);
    assert_eq!(job.cameras[1].window, None);
    let distance = "distance_mm = { value = 300, sigma = 20 }\n";
    refused(WINDOW, distance, "", 3, &["[camera.window]", "distance_mm"]);
    refused(WINDOW, "value = 300, ", "", 4, &["value"]);
    refused(WINDOW, "thickness_mm = 12", "thickness_mm = -1", 5, &["thickness"]);
    refused(WINDOW, "thickness_mm = 12", "thickness = 12", 5, &["thickness_mm"]);
    refused(WINDOW, "value = 1.49", "value = 14.9", 6, &["refractive index"]);
    refused(WINDOW, "sheet = true\n", "", 1, &["sheet = true"]);
    refused(WINDOW, "[[view]]", "[solve]\nobservations = \"bitangent\"\n[[view]]", 13, &["contour"]);
}
