//! Scenes as a whole: repeatable, refused where they must be, and true to their words.

use super::*;
use crate::error::{Error, Insufficient};
use crate::image::Pixels;
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

const SMALL: &str = "
seed = 7
[[camera]]
name = 'left'
image_size_px = [200, 150]
pixel_pitch_mm = 0.02
focal_length_mm = 25.0
scheimpflug = true
aim = { distance_mm = 400.0, viewing_angle_deg = -40.0 }
[[camera]]
name = 'right'
image_size_px = [200, 150]
pixel_pitch_mm = 0.02
focal_length_mm = 25.0
scheimpflug = true
aim = { distance_mm = 400.0, viewing_angle_deg = 40.0 }
[target]
kind = 'two-discs'
polarity = 'bright'
radii_mm = [6.0, 5.0]
spacing_mm = 14.0
[image]
full_well_e = 10000
[[view]]
rotation_deg = [10.0, -12.0, 20.0]
[[view]]
sheet = true
[rig]
scale = 'target'
";

fn run(text: &str) -> Simulation {
    simulate(&Scene::parse(text, "scene.toml").unwrap()).unwrap()
}

fn grey(image: &GrayImage) -> Vec<f64> {
    let v = image.view();
    (0..v.height()).flat_map(|y| (0..v.width()).map(move |x| f64::from(v.get(x, y)))).collect()
}

/// The committed images of an example, rendered again from its scene.
fn example_comes_out_the_same(name: &str) {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(name);
    let got = run(preset_text(name).unwrap());
    assert_eq!(got.rig_toml, std::fs::read_to_string(folder.join("rig.toml")).unwrap());
    let truth = |text: &str| serde_json::from_str::<Value>(text).unwrap();
    assert_close(&truth(&got.truth_json), &truth(&std::fs::read_to_string(folder.join("truth.json")).unwrap()));
    if !folder.join(&got.images[0].0).exists() {
        println!("SKIPPED: the images of examples/{name} are not there (a packaged crate comes without them)");
        return;
    }
    for (file, image) in &got.images {
        let committed = ::image::open(folder.join(file)).unwrap().into_luma8();
        assert_eq!((committed.width() as usize, committed.height() as usize), (image.width(), image.height()));
        assert!(*image.pixels() == Pixels::U8(committed.into_raw()), "{name}/{file} differs");
    }
}

/// Equal but for the last digits of numbers, which belong to the mathematical library of the system.
fn assert_close(a: &Value, b: &Value) {
    match (a, b) {
        (Value::Number(x), Value::Number(y)) => {
            let (x, y) = (x.as_f64().unwrap(), y.as_f64().unwrap());
            assert!((x - y).abs() <= 1e-9 * (1.0 + x.abs()), "{x} {y}");
        }
        (Value::Array(x), Value::Array(y)) => {
            assert_eq!(x.len(), y.len());
            x.iter().zip(y).for_each(|(x, y)| assert_close(x, y));
        }
        (Value::Object(x), Value::Object(y)) => {
            assert_eq!(x.keys().collect::<Vec<_>>(), y.keys().collect::<Vec<_>>());
            x.iter().for_each(|(k, v)| assert_close(v, &y[k]));
        }
        _ => assert_eq!(a, b),
    }
}

#[test]
fn example_bubbles_comes_out_the_same_bit_for_bit() {
    example_comes_out_the_same("bubbles");
}

#[test]
fn example_printed_comes_out_the_same_bit_for_bit() {
    example_comes_out_the_same("printed");
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_other_noise() {
    let (a, b) = (run(SMALL), run(SMALL));
    assert_eq!(a, b);
    let c = run(&SMALL.replace("seed = 7", "seed = 8"));
    assert_eq!(a.truth_json, c.truth_json);
    assert_ne!(a.images, c.images);
    assert_ne!(a.images[0].1, a.images[1].1);
}

/// Views drawn with a seed of their own stay where they are under other noise; without one they are drawn anew.
#[test]
fn views_drawn_with_their_own_seed_stay() {
    let of = |seed: u64, own: &str| {
        let views = format!("[random]\n{own}count = 2\ntilt_deg = [5, 5]\nposition_mm = [1, 1, 1]\n[rig]");
        run(&SMALL.replace("seed = 7", &format!("seed = {seed}")).replace("[rig]", &views))
    };
    let [a, b] = [7, 8].map(|seed| of(seed, "seed = 3\n"));
    assert_eq!(a.truth_json, b.truth_json);
    assert_ne!(a.images, b.images);
    assert_ne!(of(7, "").truth_json, of(8, "").truth_json);
    assert_eq!(of(7, "").truth_json, of(7, "seed = 7\n").truth_json);
}

#[test]
fn without_noise_the_grey_levels_are_those_asked_for() {
    let text =
        SMALL.replace("full_well_e = 10000", "bits = 12\ndisc_level = 0.6\nground_level = 0.1\noffset_level = 0.05");
    let got = run(&text);
    let values = grey(&got.images[0].1);
    let (low, high) = values.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), &v| (l.min(v), h.max(v)));
    assert_eq!((low, high), ((0.15_f64 * 4095.0).round(), (0.65_f64 * 4095.0).round()));
    let dark = run(&text.replace("bright", "dark").replace("disc_level = 0.6", "disc_level = 0.02"));
    assert_eq!(grey(&dark.images[0].1).into_iter().fold(f64::INFINITY, f64::min), (0.07_f64 * 4095.0).round());
}

#[test]
fn smoke_uneven_light_and_glare_do_what_they_say() {
    let plain = SMALL.replace("full_well_e = 10000", "bits = 16\noffset_level = 0.0");
    let bubbles = plain.replace("'two-discs'", "'bubbles'").replace("radii_mm = [6.0, 5.0]\nspacing_mm = 14.0", "");
    let pair = "radii_mm = [6.0, 5.0]\nspacing_mm = 14.0\n";
    let bubbles = bubbles.replace("[[view]]", &format!("[[view]]\n{pair}")).replace("'target'", "'baseline'");
    let even = grey(&run(&bubbles).images[0].1);
    let inside: Vec<usize> = (0..even.len()).filter(|&i| even[i] > 0.69 * 65_535.0).collect();
    let smoky = grey(&run(&bubbles.replace("bits = 16", "bits = 16\nsmoke = 0.3")).images[0].1);
    let ratios: Vec<f64> = inside.iter().map(|&i| smoky[i] / even[i]).collect();
    let (low, high) = ratios.iter().fold((2.0_f64, 0.0_f64), |(l, h), &r| (l.min(r), h.max(r)));
    assert!(low > 0.699 && low < 0.85 && high > 1.15 && high < 1.301, "{low} {high}");
    let printed =
        bubbles.replace("bits = 16", "bits = 16\nsmoke = 0.3").replace(pair, &format!("printed = true\n{pair}"));
    assert_eq!(grey(&run(&printed).images[0].1), even, "a printed view has no smoke");
    let uneven = grey(&run(&bubbles.replace("bits = 16", "bits = 16\nunevenness = 0.4")).images[0].1);
    let (low, high) =
        (0..even.len()).map(|i| uneven[i] / even[i]).fold((2.0_f64, 0.0_f64), |(l, h), r| (l.min(r), h.max(r)));
    assert!(low > 0.599 && low < 0.8 && high > 0.95 && high < 1.001, "{low} {high}");
    let glare = "bits = 16\nglare = { count = 3, radius_px = 4.0, level = 0.2, on = 'rim' }";
    let spots = grey(&run(&bubbles.replace("bits = 16", glare)).images[0].1);
    let light: f64 = (0..even.len()).map(|i| (spots[i] - even[i]) / 65_535.0).sum();
    let want = 3.0 * 0.2 * std::f64::consts::TAU * 16.0;
    assert!((light / want - 1.0).abs() < 0.02, "{light} {want}");
}

#[test]
fn refusals_name_file_line_and_what_was_expected() {
    let cases = [
        ("seed = 7", "seed = 7\ncolor = 3", "scene.toml:3: ", "color"),
        ("[image]", "[image]\nblurr_px = 1", "scene.toml:23: ", "blurr_px"),
        ("focal_length_mm = 25.0", "focal_length_mm = 'long'", "scene.toml:7: ", "string"),
        ("spacing_mm = 14.0", "spacing_mm = 11.0", "scene.toml:21: ", "touch"),
        ("spacing_mm = 14.0", "spacing_mm = nan", "scene.toml:21: ", "spacing_mm"),
        ("spacing_mm = 14.0", "spacing_mm = 14.0\nradius_mm = 3.0", "scene.toml:22: ", "two-discs"),
        ("full_well_e = 10000", "bits = 7", "scene.toml:23: ", "8 to 16"),
        ("full_well_e = 10000", "blur_sigma_px = 0.01", "scene.toml:23: ", "0.0625"),
        ("full_well_e = 10000", "disc_level = 0.0\nground_level = 0.5", "scene.toml:23: ", "polarity"),
        (
            "rotation_deg = [10.0, -12.0, 20.0]",
            "position_mm = [0.0, 0.0, 900.0]",
            "scene.toml:24: ",
            "behind the camera",
        ),
        (
            "rotation_deg = [10.0, -12.0, 20.0]",
            "position_mm = [60.0, 0.0, 0.0]",
            "scene.toml:24: ",
            "border of 200 x 150",
        ),
        ("rotation_deg = [10.0, -12.0, 20.0]", "rotation_deg = [0.0, 180.0, 0.0]", "scene.toml:24: ", "back"),
        ("rotation_deg = [10.0, -12.0, 20.0]", "rotation_deg = [0.0, 50.0, 0.0]", "scene.toml:24: ", "edge-on"),
        (
            "sheet = true",
            "sheet = true\nrotation_deg = [5.0, 0.0, 0.0]",
            "scene.toml:26: ",
            "in (or parallel to) the sheet",
        ),
        (
            "rotation_deg = [10.0, -12.0, 20.0]",
            "rotation_deg = [10.0, -12.0, 20.0, 5.0]",
            "scene.toml:25: ",
            "a list of 3 items, found 4",
        ),
        ("viewing_angle_deg = 40.0", "viewing_angle_deg = 89.0", "scene.toml:10: ", "along the sheet"),
        ("name = 'right'", "name = 'left'", "scene.toml:11: ", "same name"),
        ("scheimpflug = true\naim", "scheimpflug = true\nbeta_deg = 1.0\naim", "scene.toml:8: ", "beta_deg"),
        ("'target'", "'somewhere'", "scene.toml:29: ", "somewhere"),
        ("'two-discs'", "'bubbles'", "scene.toml:20: ", "each [[view]]"),
        ("[target]", "[target", "scene.toml:17: ", ""),
    ];
    for (from, to, place, word) in cases {
        assert!(SMALL.contains(from), "{from}");
        let error = Scene::parse(&SMALL.replacen(from, to, 1), "scene.toml").unwrap_err();
        let message = error.to_string();
        println!("{message}");
        assert!(matches!(error, Error::Invalid(_)), "{message}");
        assert!(message.starts_with(place) && message.contains(word), "{from} -> {to}: {message}");
    }
}

#[test]
fn ranges_that_no_camera_can_see_are_refused_by_name() {
    let text = SMALL.replace("spacing_mm = 14.0", "spacing_mm = 80.0");
    let start = text.find("[[view]]").unwrap();
    let text = format!("{}[random]\ncount = 2\ntilt_deg = [5, 5]\nposition_mm = [1, 1, 1]\n", &text[..start]);
    let error = Scene::parse(&text, "scene.toml").unwrap_err();
    assert!(matches!(error, Error::Insufficient(Insufficient::Degenerate(_))), "{error}");
}

#[test]
fn every_preset_is_a_scene_and_an_unknown_one_names_them() {
    for (name, text) in PRESETS {
        let scene = Scene::parse(text, name).unwrap();
        let rig: toml::Table = scene.rig_toml().parse().unwrap();
        assert_eq!(rig["view"].as_array().unwrap().len(), scene.views());
        assert!(rig["view"].as_array().unwrap().iter().any(|v| v["sheet"].as_bool() == Some(true)), "{name}");
        assert!(scene.truth_json().unwrap().contains("spivcal-calibration"));
    }
    assert!(Scene::preset("paper").unwrap_err().to_string().contains("paper-table1"));
}

#[test]
fn a_lens_of_50_mm_at_500_mm_and_45_degrees_is_tilted_by_6_34_degrees() {
    let scene = Scene::preset("paper-table2").unwrap();
    for (c, sign) in scene.setup.cameras.iter().zip([-1.0, 1.0]) {
        let i = c.camera.intrinsics();
        assert!((i.f_px - 8888.889).abs() < 1e-3);
        assert!((i.beta_rad.to_degrees() - sign * 6.3402).abs() < 1e-4 && i.alpha_rad.abs() < 1e-15);
    }
    let printed = Scene::preset("paper-table1").unwrap();
    let i = printed.setup.cameras[1].camera.intrinsics();
    assert_eq!((i.f_px, i.beta_rad.to_degrees()), (8067.0, 2.8));
}

#[test]
fn a_focused_camera_images_every_point_of_the_nominal_sheet_sharply() {
    // Thin lens: 1/Z + 1/Z' = 1/f for every pair of a sheet point and its place on the tilted sensor.
    let text =
        SMALL.replace("viewing_angle_deg = 40.0", "viewing_angle_deg = 40.0, elevation_deg = 17.0, roll_deg = 30.0");
    let scene = Scene::parse(&text, "scene.toml").unwrap();
    let c = &scene.setup.cameras[1];
    let i = c.camera.intrinsics();
    for (x, y) in [(0.0, 0.0), (15.0, 0.0), (-12.0, 9.0), (4.0, -11.0)] {
        let p = c.cam_from_bench.apply(&Vector3::new(x, y, 0.0));
        let q = c.camera.project_xyz(&p).unwrap();
        let (tx, ty) = ((q.x - i.cx_px) / i.f_px, (q.y - i.cy_px) / i.f_px);
        let depth = i.f_px * 0.02 * (1.0 + tx * i.beta_rad.sin() + ty * i.alpha_rad.sin() * i.beta_rad.cos());
        assert!((1.0 / p.z + 1.0 / depth - 1.0 / 25.0).abs() < 1e-15, "{}", 1.0 / p.z + 1.0 / depth);
    }
}

#[test]
fn truth_tells_the_sheet_in_the_frame_of_the_first_camera() {
    let text = SMALL.replace("[target]", "[sheet]\noffset_mm = 2.0\ntilt_deg = [3.0, -4.0]\n[target]");
    let scene = Scene::parse(&text, "scene.toml").unwrap();
    let truth: Value = serde_json::from_str(&scene.truth_json().unwrap()).unwrap();
    let numbers = |v: &Value| v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect::<Vec<_>>();
    let matrix =
        |v: &Value| Matrix3::from_row_slice(&v.as_array().unwrap().iter().flat_map(&numbers).collect::<Vec<_>>());
    let sheet = &truth["sheet"];
    let normal = Vector3::from_row_slice(&numbers(&sheet["normal_in_rig"]));
    let distance = sheet["distance_mm"].as_f64().unwrap();
    assert!(distance > 0.0 && normal.z > 0.0);
    // Every disc of the view in the sheet lies in that plane, and none of the other view does.
    for view in truth["views"].as_array().unwrap() {
        let (r, t) = (
            matrix(&view["rig_from_target"]["rotation"]),
            Vector3::from_row_slice(&numbers(&view["rig_from_target"]["translation_mm"])),
        );
        for disc in view["discs"].as_array().unwrap() {
            let p = r * Vector3::from_row_slice(&numbers(&disc["center_in_target_mm"])) + t;
            let off = normal.dot(&p) - distance;
            assert_eq!(off.abs() < 1e-10, view["in_sheet"].as_bool().unwrap(), "{off}");
            let seen = Vector3::from_row_slice(&[numbers(&disc["images"]["left"]["center_px"]), vec![1.0]].concat());
            let q = scene.setup.cameras[0].camera.project_xyz(&p).unwrap();
            assert!((seen.xy() - q).norm() < 1e-9);
        }
    }
    let r = matrix(&sheet["rig_from_sheet"]["rotation"]);
    let origin = Vector3::from_row_slice(&numbers(&sheet["rig_from_sheet"]["translation_mm"]));
    assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-12 && (r.determinant() - 1.0).abs() < 1e-12);
    assert!(
        (r.column(2) + normal).norm() < 1e-12
            && origin.xy().norm() < 1e-12
            && (normal.dot(&origin) - distance).abs() < 1e-9
    );
    assert!(r.m11 > 0.0 && r.m22 < 0.0, "x right, y up as the first camera sees them");
    let [a, b, c] = [0, 1, 2].map(|i| numbers(&sheet["angles_deg"])[i].to_radians());
    let turn = |axis: Vector3<f64>, angle: f64| crate::rigid::rotation_exp(&(axis * angle));
    let product = turn(Vector3::x(), a) * turn(Vector3::y(), b) * turn(Vector3::z(), c);
    assert!((product * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) - r).norm() < 1e-12);
    let cam = &truth["cameras"][1]["cam_from_rig"];
    let center = -(matrix(&cam["rotation"]).transpose() * Vector3::from_row_slice(&numbers(&cam["translation_mm"])));
    let angle = (normal.dot(&center) / center.norm()).asin().to_degrees();
    assert!((sheet["angle_to_baseline_deg"].as_f64().unwrap() - angle).abs() < 1e-9);
}

#[test]
fn misprinted_dots_are_off_by_the_stated_sigma_and_stay_so_in_every_view() {
    let text = preset_text("dot-grid").unwrap().replace("print_error_um = 5.0", "print_error_um = 20.0");
    let scene = Scene::parse(&text, "grid").unwrap();
    let first = &scene.setup.views[0].pattern;
    assert!(scene.setup.views.iter().all(|v| v.pattern == *first));
    let errors: Vec<f64> = first
        .features
        .iter()
        .flat_map(|f| [f.center_mm.x - 3.5 * f64::from(f.id.column), f.center_mm.y - 3.5 * f64::from(f.id.row)])
        .collect();
    let sigma = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let z = (sigma / 0.020 - 1.0) * (2.0 * errors.len() as f64).sqrt();
    assert!(z.abs() < 4.0, "{sigma} mm, z {z}");
}

#[test]
fn two_hundred_random_rigs_of_the_paper_find_their_views() {
    for seed in 0..200 {
        let text = preset_text("paper-table2").unwrap().replace("seed = 2", &format!("seed = {seed}"));
        assert_eq!(Scene::parse(&text, "paper-table2").unwrap().views(), 6);
    }
}

#[test]
fn every_key_is_in_the_documentation() {
    // An unknown key makes each table say which keys it knows.
    let text = include_str!("../../docs/simulate.md");
    let pair = "radii_mm = [6.0, 5.0]\nspacing_mm = 14.0";
    let marks = "marks = [{ kind = 'ring', column = 0, row = 0, bogus = 1 }]";
    let tables = [
        ("seed = 7", "seed = 7\nbogus = 1"),
        ("name = 'left'", "name = 'left'\nbogus = 1"),
        ("-40.0 }", "-40.0, bogus = 1 }"),
        ("aim = { distance_mm = 400.0, viewing_angle_deg = -40.0 }", "pose = { bogus = 1 }"),
        ("[target]", "[sheet]\nbogus = 1\n[target]"),
        ("[target]", "[target]\nbogus = 1"),
        (pair, marks),
        ("[image]", "[image]\nbogus = 1"),
        ("[image]", "[image]\nglare = { bogus = 1 }"),
        ("[[view]]", "[[view]]\nbogus = 1"),
        ("[rig]", "[random]\nbogus = 1\n[rig]"),
        ("[rig]", "[rig]\nbogus = 1"),
        ("[rig]", "[rig]\nfocus = { bogus = 1 }"),
    ];
    let mut known = 0;
    for (from, to) in tables {
        let message = Scene::parse(&SMALL.replacen(from, to, 1), "s").unwrap_err().to_string();
        let (_, keys) = message.split_once("expected ").unwrap_or_else(|| panic!("{message}"));
        for key in keys.split('`').skip(1).step_by(2).filter(|k| !["camera", "view"].contains(k)) {
            known += 1;
            let written = text.match_indices(key).any(|(at, _)| {
                let beside = |c: Option<char>| c.is_none_or(|c| !c.is_ascii_alphanumeric() && c != '_');
                beside(text[..at].chars().next_back()) && beside(text[at + key.len()..].chars().next())
            });
            assert!(written, "docs/simulate.md does not name {key}");
        }
    }
    assert!(known > 60, "{known} keys");
}

#[test]
fn a_value_of_another_type_is_told_by_its_key() {
    let text = preset_text("paper-table1").unwrap();
    let wrong = text.replacen("spacing_mm = 26.0", "spacing_mm = '14 mm'", 1);
    let message = Scene::parse(&wrong, "s.toml").unwrap_err().to_string();
    let line = 1 + wrong.lines().position(|l| l.contains("14 mm")).expect("the preset has this key");
    let expected = format!("s.toml:{line}: target.spacing_mm: invalid type: string \"14 mm\", expected a number");
    assert_eq!(message, expected);
}

/// A light that a camera looks along reaches to the horizon: more particles than any memory holds.
#[test]
fn light_without_end_is_refused_with_its_particles() {
    let text = preset_text("printed").unwrap().replace("\n[particles]", "\n[old]");
    let particles = "\n[particles]\npairs = 1\nper_mm2 = 1e4\nthickness_mm = 100.0\ntilt_deg = [0.0, 44.9]\n";
    let scene = Scene::parse(&format!("{text}{particles}"), "scene.toml").unwrap();
    let refused = simulate_particles(&scene).unwrap_err().to_string();
    assert!(refused.contains("particles of a moment") && refused.contains("per_mm2"), "{refused}");
}
