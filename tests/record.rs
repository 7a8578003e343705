//! `calibration.json`: the schema of version 1 key by key, round trip to the bit, refusals.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod scene;

use serde_json::Value;
use spivcal::error::{Error, Invalid};
use spivcal::exchange::{ExportFormat, export};
use spivcal::record::{Known, MappingByLikelihood, Record, TargetPoint, Window, WindowSigma};
use spivcal::target::DotId;

fn reread(record: &Record) -> Record {
    Record::from_json(&record.to_json().unwrap(), "c.json").unwrap()
}

/// Changes the value at a JSON pointer of the scene's file and reads the result.
fn read_with(pointer: &str, value: Value) -> Result<Record, Error> {
    let mut json: Value = serde_json::from_str(&scene::record().to_json().unwrap()).unwrap();
    *json.pointer_mut(pointer).unwrap_or_else(|| panic!("no {pointer}")) = value;
    Record::from_json(&serde_json::to_string_pretty(&json).unwrap(), "c.json")
}

fn refusal(pointer: &str, value: Value) -> (usize, String) {
    match read_with(pointer, value) {
        Err(Error::Invalid(Invalid::Syntax { file, line, message })) => {
            assert_eq!(file, "c.json");
            (line, message)
        }
        other => panic!("{pointer}: not refused: {other:?}"),
    }
}

#[test]
fn every_key_of_the_schema_is_written_with_its_type() {
    let wanted: Value = serde_json::from_str(include_str!("fixtures/calibration_schema_1.json")).unwrap();
    let found: Value = serde_json::from_str(&scene::record().to_json().unwrap()).unwrap();
    assert!(lacks(&wanted, &found, "").is_empty(), "{:?}", lacks(&wanted, &found, ""));
    // The walk itself must be able to refuse.
    let mut broken = found.clone();
    broken["cameras"][0].as_object_mut().unwrap().remove("beta_rad");
    broken["fit"]["nullity"] = Value::from("none");
    assert_eq!(lacks(&wanted, &broken, ""), [".cameras[].beta_rad is missing", ".fit.nullity has another type"]);
}

/// Keys of `wanted` that `found` lacks or holds with another type; the first element of a list stands for all.
fn lacks(wanted: &Value, found: &Value, path: &str) -> Vec<String> {
    match (wanted, found) {
        (Value::Object(w), Value::Object(f)) => w
            .iter()
            .filter(|(key, _)| *key != "...")
            .flat_map(|(key, w)| match f.get(key) {
                Some(f) => lacks(w, f, &format!("{path}.{key}")),
                None => vec![format!("{path}.{key} is missing")],
            })
            .collect(),
        (Value::Array(w), Value::Array(f)) => match w.first() {
            Some(w) if f.is_empty() => vec![format!("{path} is empty, expected values like {w}")],
            Some(w) => f.iter().flat_map(|f| lacks(w, f, &format!("{path}[]"))).collect(),
            None => vec![],
        },
        _ if std::mem::discriminant(wanted) == std::mem::discriminant(found) => vec![],
        _ => vec![format!("{path} has another type")],
    }
}

#[test]
fn a_record_read_is_the_record_written_to_the_bit() {
    let mut record = scene::record();
    // Numbers whose shortest decimal form needs 17 digits, is tiny, huge, subnormal, or a negative zero.
    let ugly = [
        0.1 + 0.2,
        1.0 / 3.0,
        f64::MIN_POSITIVE,
        5e-324,
        f64::MAX,
        -0.0,
        9007199254740993.0,
        f64::MIN_POSITIVE * 0.999,
    ];
    for (i, x) in ugly.into_iter().enumerate() {
        record.fit.near_null[0].components.push(x);
        record.target.points.push(TargetPoint {
            label: DotId { column: -3 + i as i32, row: 2, level: 1 },
            xyz_mm: [x, -x, 1.0 + f64::EPSILON],
            sigma_mm: [0.1, 0.2, 0.3],
        });
    }
    let back = reread(&record);
    assert_eq!(back, record);
    // Equality of numbers does not tell the zeros apart.
    assert!(back.target.points[5].xyz_mm[0].is_sign_negative());
    assert_eq!(back.to_json().unwrap(), record.to_json().unwrap());
}

#[test]
fn a_sigma_that_does_not_exist_is_null_and_said_so() {
    let mut record = scene::record();
    record.cameras[1].sigma.alpha_rad = f64::INFINITY;
    record.sheet.as_mut().unwrap().sigma.normal_rad[1] = f64::NAN;
    record.covariance.matrix[2][2] = f64::NAN;
    let text = record.to_json().unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        json["not_finite"],
        serde_json::json!(["cameras[1].sigma.alpha_rad", "sheet.sigma.normal_rad[1]", "covariance.matrix[2][2]"])
    );
    let back = Record::from_json(&text, "c.json").unwrap();
    assert!(back.cameras[1].sigma.alpha_rad.is_nan());
    assert_eq!(back.covariance.sigma("left.cy_px"), None);
    assert_eq!(back.to_json().unwrap(), text);
}

#[test]
fn an_estimate_that_is_not_a_number_is_named_and_refused_on_reading() {
    let mut record = scene::record();
    record.cameras[0].f_px = f64::NAN;
    let text = record.to_json().unwrap();
    assert!(text.contains("\"cameras[0].f_px\""));
    let error = Record::from_json(&text, "c.json").unwrap_err().to_string();
    assert!(error.contains("null") && error.contains("expected a finite number") && error.contains("f_px"), "{error}");
}

#[test]
fn no_sheet_is_null_and_not_an_error() {
    let mut record = scene::record();
    record.sheet = None;
    record.views[2].used = false;
    record.views[2].rig_from_target = None;
    let text = record.to_json().unwrap();
    assert!(text.contains("\"sheet\": null") && !text.contains("not_finite"));
    assert_eq!(reread(&record), record);
}

#[test]
fn keys_of_later_minor_versions_are_ignored() {
    let mut json: Value = serde_json::from_str(&scene::record().to_json().unwrap()).unwrap();
    json["cameras"][0]["colour"] = Value::from("red");
    json["window"] = serde_json::json!({"thickness_mm": 3});
    assert_eq!(Record::from_json(&json.to_string(), "c.json").unwrap(), scene::record());
}

#[test]
fn a_file_with_only_the_keys_of_the_schema_is_enough() {
    let wanted: Value = serde_json::from_str(include_str!("fixtures/calibration_schema_1.json")).unwrap();
    let full: Value = serde_json::from_str(&scene::record().to_json().unwrap()).unwrap();
    let lean = Record::from_json(&only(&wanted, &full).to_string(), "c.json").unwrap();
    assert_eq!(lean.cameras[0].pupil_ratio, 1.0);
    assert!(lean.cameras[0].sigma.beta_rad.is_nan(), "a sigma that is not there is unknown, not zero");
    assert!(lean.fit.parameters.is_empty() && lean.views[0].used);
}

/// `full` without the keys that `wanted` does not show ("..." and empty objects keep all).
fn only(wanted: &Value, full: &Value) -> Value {
    match (wanted, full) {
        (Value::Object(w), Value::Object(f)) if !w.is_empty() => f
            .iter()
            .filter_map(|(k, f)| w.get(k).map(|w| (k.clone(), only(w, f))))
            .collect::<serde_json::Map<_, _>>()
            .into(),
        (Value::Array(w), Value::Array(f)) if !w.is_empty() => f.iter().map(|f| only(&w[0], f)).collect(),
        _ => full.clone(),
    }
}

#[test]
fn a_record_can_be_checked_before_it_is_written() {
    scene::record().check().unwrap();
    let mut broken = scene::record();
    broken.cameras[1].f_px = -1.0;
    let error = broken.check().unwrap_err();
    assert_eq!(error.exit_code(), 4);
    assert!(error.to_string().contains("cameras[1].f_px: -1 is not possible"), "{error}");
    let with_nan: [fn(&mut Record); 7] = [
        |r| r.cameras[1].f_px = f64::NAN,
        |r| r.cameras[0].beta_rad = f64::NAN,
        |r| r.cameras[0].k2 = f64::INFINITY,
        |r| r.views[2].rig_from_target.as_mut().unwrap().rotation[1][1] = f64::NAN,
        |r| r.views[2].rig_from_target.as_mut().unwrap().translation_mm[0] = f64::NAN,
        |r| r.sheet.as_mut().unwrap().normal_in_rig[0] = f64::NAN,
        |r| r.sheet.as_mut().unwrap().abc_per_mm[2] = f64::NAN,
    ];
    for (i, break_it) in with_nan.into_iter().enumerate() {
        let mut record = scene::record();
        break_it(&mut record);
        assert!(record.check().is_err(), "case {i}: no estimate may be NaN");
    }
}

#[test]
fn keys_keep_their_order() {
    let text = scene::record().to_json().unwrap();
    let order =
        ["\"format\"", "\"cameras\"", "\"rig\":", "\"sheet\"", "\"target\"", "\"views\"", "\"fit\"", "\"covariance\""];
    let places: Vec<_> = order.iter().map(|k| text.find(&format!("\n  {k}")).unwrap()).collect();
    assert!(places.is_sorted(), "{places:?}");
    let row = text.lines().find(|l| l.contains("472.1929")).expect("a row of the covariance is one line");
    assert_eq!(row.matches(',').count(), 12);
}

fn zeros(n: usize) -> Value {
    serde_json::json!(vec![vec![0.0; n]; n])
}

/// What a record may leave out or not know contradicts nothing.
#[test]
fn numbers_that_are_not_there_contradict_nothing() {
    let mut record = scene::record();
    record.covariance.undetermined.push("left.f_px".into());
    record.cameras[0].effective.cx_px = f64::NAN;
    record.cameras[1].sigma.k1 = f64::NAN;
    record.cameras[1].sigma.beta_rad = 0.0;
    record.covariance.matrix[3][3] = f64::NAN;
    record.check().unwrap();
    record.covariance.undetermined.push("left.k3".into());
    assert!(record.check().unwrap_err().to_string().contains("\"left.k3\" is not among covariance.names"));
    record.covariance = Default::default();
    record.check().unwrap();
}

#[test]
fn impossible_values_are_refused_with_line_and_expectation() {
    for (pointer, value, words) in [
        ("/cameras/1/f_px", Value::from(-3.0), "expected a number above 0"),
        ("/cameras/0/alpha_rad", Value::from(6.34), "not degrees"),
        ("/cameras/0/sigma/k1", Value::from(-1e-3), "expected 0 or more"),
        ("/cameras/1/name", Value::from("left"), "expected different names"),
        ("/cameras/0/name", Value::from(""), "expected the camera's name"),
        ("/cameras/0/image_size_px/1", Value::from(0), "expected width and height"),
        ("/cameras/1/cam_from_rig/rotation/0/0", Value::from(0.5), "not a rotation"),
        ("/cameras/0/cam_from_rig/translation_mm/0", Value::from(0.5), "the first camera is the rig frame"),
        ("/sheet/distance_mm", Value::from(0.0), "expected a number above 0"),
        ("/sheet/normal_in_rig/0", Value::from(0.9), "expected a unit vector"),
        ("/sheet/abc_per_mm/0", Value::from(0.9), "expected the same plane"),
        ("/sheet/rig_from_sheet/translation_mm/2", Value::from(501.0), "mm off the plane"),
        ("/rig/baseline_mm", Value::from(-707.0), "contradicts cam_from_rig of the second camera"),
        ("/rig/axes_angle_deg", Value::from(12.0), "contradicts cam_from_rig of the second camera"),
        ("/sheet/angles_deg/1", Value::from(77.0), "differs from rig_from_sheet"),
        ("/sheet/angle_to_baseline_deg", Value::from(77.0), "contradicts normal_in_rig"),
        ("/sheet/sigma/normal_rad/1", Value::from(-1e-4), "expected 0 or more"),
        ("/rig/sigma/baseline_mm", Value::from(-1e-4), "expected 0 or more"),
        ("/cameras/1/sigma/effective/cx_px", Value::from(-1e-4), "expected 0 or more"),
        ("/cameras/0/pixel_pitch_mm", Value::from(0.0), "expected a number above 0"),
        ("/cameras/0/image_size_px/1", Value::from(0), "a side of 0 px: expected width and height"),
        (
            "/cameras/0/image_size_px/0",
            Value::from(1_000_000_000),
            "a side of 1000000000 px: expected width and height",
        ),
        ("/cameras/0/name", Value::from("../evil"), "cannot be part of the name of a file"),
        ("/cameras/0/name", Value::from("left\n"), "\"left\\n\" cannot be part of the name of a file"),
        ("/target/kind", Value::from("disks"), "expected one of two-discs, "),
        ("/target/radii_mm/0", Value::from(-12.5), "expected a number above 0"),
        ("/target/spacing_mm", Value::from(-26.0), "expected a number above 0"),
        ("/target/sigma/radii_mm/1", Value::from(-26.0), "expected 0 or more"),
        ("/views/4/index", Value::from(0), "occurs twice"),
        ("/views/4/rms_px/left", Value::from(-0.1), "expected 0 or more"),
        ("/views/4/rms_px", serde_json::json!({"middle": 0.1}), "no camera is called \"middle\""),
        ("/views/4/rig_from_target", Value::Null, "expected a pose"),
        ("/views/4/index", Value::from(7), "5 after 7: expected the views in the order of the rig file"),
        ("/sheet/views/0", Value::from(99), "no view has the index 99"),
        (
            "/cameras/0/effective/f_px",
            Value::from(1.0),
            "contradicts f, principal point and tilt of the camera: expected 8834",
        ),
        ("/cameras/1/effective/cx_px", Value::from(-475.0), "contradicts f, principal point and tilt of the camera"),
        ("/cameras/1/effective/cy_px", Value::from(400.0), "contradicts f, principal point and tilt of the camera"),
        ("/covariance/names/1", Value::from("zzz.foo"), "\"zzz.foo\" is no number of this calibration: expected owner"),
        ("/covariance/names/1", Value::from("view9.plane_z_mm"), "is no number of this calibration"),
        ("/covariance/matrix", zeros(12), "variance of left.f_px is 0.0, which contradicts cameras[0].sigma.f_px"),
        ("/cameras/1/sigma/beta_rad", Value::from(2e-3), "contradicts cameras[1].sigma.beta_rad = 0.002"),
        ("/covariance/names/0", Value::from("left.k1"), "occurs twice"),
        ("/covariance/matrix/3/0", Value::from(1e9), "expected a symmetric matrix"),
        ("/covariance/matrix/3/3", Value::from(-1.0), "variance of left.alpha_rad is -1"),
    ] {
        let (line, message) = refusal(pointer, value);
        assert!(message.contains(words), "{pointer}: {message}");
        assert!(line > 1, "{pointer}: line {line}");
    }
}

#[test]
fn the_line_of_a_refusal_is_the_line_of_the_value() {
    let text = scene::record().to_json().unwrap();
    let text = text.replacen("\"alpha_rad\": -0.0013", "\"alpha_rad\": -7.3", 1);
    let line = 1 + text.lines().position(|l| l.contains("-7.3")).unwrap();
    let Err(Error::Invalid(Invalid::Syntax { line: found, message, .. })) = Record::from_json(&text, "c.json") else {
        panic!("not refused")
    };
    assert_eq!(found, line, "{message}");
    assert!(message.starts_with("cameras[1].alpha_rad: -7.3"), "{message}");
}

#[test]
fn wrong_types_and_missing_keys_are_refused_with_their_line() {
    let (line, message) = refusal("/cameras/0/f_px", Value::from("8889"));
    assert!(
        line > 1 && message.contains("cameras[0].f_px: invalid type: string \"8889\", expected a finite number"),
        "{message}"
    );
    for (whole, words) in [
        ("", "EOF"),
        ("[package]", "not a whole calibration.json"),
        ("[1, 2]", "not a calibration"),
        ("{}", "no key \"format\""),
        (r#"{"format": "dice", "version": 1}"#, "expected \"spivcal-calibration\""),
        (r#"{"format": "spivcal-calibration"}"#, "no key \"version\""),
        (r#"{"format": "spivcal-calibration", "version": 2}"#, "this program reads version 1"),
        (r#"{"format": "spivcal-calibration", "version": 1}"#, "missing key `cameras`"),
        (r#"{"format": "spivcal-calibration", "version": 1, "cameras": [NaN]}"#, "expected value"),
    ] {
        let error = Record::from_json(whole, "c.json").unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(words), "{whole}: {error}");
    }
    let mut json: Value = serde_json::from_str(&scene::record().to_json().unwrap()).unwrap();
    json.as_object_mut().unwrap().remove("sheet");
    let error = Record::from_json(&json.to_string(), "c.json").unwrap_err().to_string();
    assert!(error.contains("missing key `sheet`"), "{error}");
    for (pointer, value, words) in [
        ("/cameras/1", serde_json::json!({ "name": "right" }), "cameras[1]: missing key"),
        (
            "/cameras/1/cam_from_rig/rotation/1",
            serde_json::json!([0.0, 1.0]),
            "cameras[1].cam_from_rig.rotation[1]: invalid length 2, expected a list of length 3",
        ),
        ("/cameras/0/image_size_px", Value::from(7), "cameras[0].image_size_px: invalid type: integer `7`"),
        ("/cameras/0/f_px", serde_json::json!([1500.0]), "cameras[0].f_px: invalid type: a list"),
        ("/cameras/1/name", serde_json::json!({}), "cameras[1].name: invalid type: a table"),
        ("/views", serde_json::json!({}), "views: invalid type: a table"),
        (
            "/fit/iterations",
            Value::from("many"),
            "fit.iterations: invalid type: string \"many\", expected a whole number",
        ),
    ] {
        let (line, message) = refusal(pointer, value);
        assert!(line > 1 && message.contains(words), "{pointer}: line {line}: {message}");
    }
}

#[test]
fn damaged_files_never_panic() {
    let text = scene::record().to_json().unwrap();
    for cut in (0..text.len()).step_by(97) {
        let Some(head) = text.get(..cut) else { continue };
        assert!(Record::from_json(head, "c.json").is_err());
    }
    // A digit changed anywhere gives a record or a refusal.
    for at in (0..text.len()).step_by(53) {
        let mut bytes = text.clone().into_bytes();
        bytes[at] = b'9';
        let _ = Record::from_json(&String::from_utf8(bytes).unwrap(), "c.json");
    }
}

#[test]
fn how_a_parameter_is_known_is_a_plain_word() {
    let text = scene::record().to_json().unwrap();
    assert!(text.contains(r#"{ "name": "left.cy_px", "known": "prior", "prior_share": 0.93 }"#), "{text}");
    assert_eq!(reread(&scene::record()).fit.parameters[4].known, Known::Free);
}

/// A camera behind a window: written and read to the bit, absent without one, refused where it is none.
#[test]
fn a_window_stands_beside_its_camera() {
    assert!(!scene::record().to_json().unwrap().contains("window"));
    let mut record = scene::record();
    record.cameras[1].window = Some(Window {
        normal_in_cam: [0.6, 0.0, 0.8],
        distance_mm: 212.1 + 1e-13,
        thickness_mm: 12.0,
        n_air: 1.0003,
        n_glass: 1.49,
        n_water: 1.333,
        sigma: WindowSigma {
            normal_rad: [0.02, 0.01, 0.003],
            distance_mm: 5.1,
            thickness_mm: 0.0,
            n_air: 0.0,
            n_glass: 0.0,
            n_water: 0.0,
        },
    });
    assert_eq!(reread(&record), record);
    let camera = record.cameras[1].model().unwrap();
    assert_eq!(camera.window().unwrap().layers(), [212.1 + 1e-13, 12.0, 1.0003, 1.49, 1.333]);
    let text = record.to_json().unwrap();
    for (from, to, words) in [
        ("\"n_water\": 1.333", "\"n_water\": -1.0", "n_water"),
        ("\"thickness_mm\": 12.0", "\"thickness_mm\": -2.0", "thickness"),
    ] {
        assert!(text.contains(from));
        let message = Record::from_json(&text.replacen(from, to, 1), "c.json").unwrap_err().to_string();
        assert!(message.contains("window") && message.contains(words), "{message}");
    }
    // OpenCV's format holds no window: the nearest camera stands for it, with the loss stated.
    let conversion = export(&record, ExportFormat::OpenCv).unwrap();
    assert_eq!(conversion.losses[0].rms_px, 0.0);
    assert!(conversion.losses[1].rms_px > 0.01, "{:?}", conversion.losses);
    assert!(
        conversion.notes.iter().any(|n| n.starts_with("right: looks through a flat window")),
        "{:?}",
        conversion.notes
    );
}

#[test]
fn flags_of_a_check_are_kept_once() {
    let mut record = scene::record();
    record.fit.flags = vec!["the plate is bent".into()];
    for told in ["it still moves", "it holds"] {
        record.fit.forget_check_flags();
        record.fit.keep_check_flags(&[told.to_string()]);
    }
    assert_eq!(record.fit.flags, ["the plate is bent", "check on particle images: it holds"]);
}

/// What the views say of measurements goes through the file, unknown factors as null; displacements are enlarged by what is known to be larger, and only
/// where the views differ by more than their noise.
#[test]
fn what_the_views_say_of_measurements_is_kept_and_enlarges_displacements() {
    let mut record = scene::record();
    record.mapping_uncertainty = Some(scene::mapping(true));
    let json: Value = serde_json::from_str(&record.to_json().unwrap()).unwrap();
    assert!(json.pointer("/mapping_uncertainty/by_views/disparity").unwrap().is_null());
    assert!(json.pointer("/mapping_uncertainty/by_views/displacement/1/1").unwrap().is_null());
    let read = reread(&record).mapping_uncertainty.unwrap();
    let told = read.by_views.as_ref().unwrap();
    assert!(told.disparity.is_nan() && told.displacement[1][1].is_nan() && told.displacement[2][2] == 2.6);
    // By hand: root of the sum of what is told over that of what is stated, none smaller than stated.
    let [u, v, w] = read.enlarged();
    let by_hand = |terms: [[f64; 2]; 3]| {
        let sum = |f: &dyn Fn(&[f64; 2]) -> f64| terms.iter().map(f).sum::<f64>();
        (sum(&|[s, f]| s * s * f * f) / sum(&|[s, _]| s * s)).sqrt()
    };
    for (got, wanted) in [
        (u, by_hand([[1.0, 3.1], [2.0, 3.2], [4.0, 3.3]])),
        (v, by_hand([[2.0, 1.4], [1.0, 1.0], [3.0, 1.5]])),
        (w, by_hand([[0.5, 1.0], [0.6, 1.0], [1.6, 2.6]])),
    ] {
        assert!((got / wanted - 1.0).abs() < 1e-12, "{got} {wanted}");
    }
    // Where equations bend, squares are added; unknown ones are not.
    let mut bent = read.clone();
    bent.by_likelihood = Some(MappingByLikelihood {
        disparity_px: 0.05,
        in_plane_mm: 0.009,
        in_plane_scale: 0.0,
        out_of_plane_gain: f64::NAN,
        displacement: vec![vec![0.003, f64::NAN, 0.0], vec![0.0; 3], vec![0.0, 0.0, 0.012]],
    });
    record.mapping_uncertainty = Some(bent);
    let bent = reread(&record).mapping_uncertainty.unwrap();
    let stated = 1.0 + 4.0 + 16.0_f64;
    let wanted = ((3.1_f64.powi(2) + 6.4_f64.powi(2) + 13.2_f64.powi(2) + 9.0) / stated).sqrt();
    assert!((bent.enlarged()[0] / wanted - 1.0).abs() < 1e-12 && bent.enlarged()[1] == v, "{:?}", bent.enlarged());
    let worst = bent.at_worst();
    assert!((worst.in_plane_mm - 0.015).abs() < 1e-12 && (worst.in_plane_px - 0.11 * 1.25).abs() < 1e-12);
    assert!((worst.disparity_px - 0.13_f64.hypot(0.05)).abs() < 1e-12 && worst.in_plane_scale == 0.0014);
    assert!(worst.out_of_plane_gain.is_nan() && worst.displacement[2][2] == 0.0016_f64.hypot(0.012));
    assert_eq!(read.at_worst(), read.largest);
    // Of v as it is of v nothing is told, but of what w leaks into it.
    let mut told = told.clone();
    assert!(!told.untold());
    told.displacement[2][2] = f64::NAN;
    assert!(told.untold());
    told.beyond_noise = false;
    assert!(!told.untold());
    assert_eq!(scene::mapping(false).enlarged(), [1.0; 3]);
    // A file without it is read.
    let mut json = json;
    json.pointer_mut("/mapping_uncertainty").unwrap().as_object_mut().unwrap().remove("by_views");
    let old = Record::from_json(&serde_json::to_string_pretty(&json).unwrap(), "c.json").unwrap();
    assert_eq!(old.mapping_uncertainty.unwrap().by_views, None);
}
