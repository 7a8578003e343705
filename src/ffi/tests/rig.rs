//! What setters say is what a rig file says.

use super::*;
use crate::ffi::rig_keys::DEFAULTS;
use crate::rig_file::RigDescription;

/// A grid on a traverse, cameras from the drawing, and the frame of the sheet on a disc.
const WHOLE: &str = r#"
[[camera]]
name = "left"
pixel_pitch_mm = 0.0065
focal_length_mm = 50.0
design = { object_distance_mm = 500.0, viewing_angle_deg = 45.0, viewing_angle_vertical_deg = -3.0, f_sigma = 0.01, tilt_sigma_deg = 0.5 }

[[camera]]
name = "right"

[target]
kind = "dot-grid"
spacing_mm = { value = 5.0, sigma = 0.002 }
radii_mm = [1.0]
columns = 9
rows = 7

[[view]]
left = "a.png"
right = "b.png"
sheet = true

[[view]]
left = "c.png"
plane_z_mm = { value = 2.0, sigma = 0.01 }

[[view]]
left = "d.png"
plane_z_mm = "unknown"

[sheet]
origin = { view = 1, column = -1, row = 2, level = 0 }
x_axis = { view = 0 }
flip_x = true
"#;

fn number(rig: u64, key: i32, index: u64, value: f64) {
    assert_eq!(spivcal_rig_set_number(rig, key, index, value), SPIVCAL_OK, "{key}: {}", error_text(rig));
}

fn described(rig: u64) -> RigDescription {
    meaning(&rig_text(rig))
}

/// Without the text and its lines.
fn meaning(text: &str) -> RigDescription {
    let mut out = RigDescription::parse(text, "whole").unwrap();
    out.text.clear();
    out.views.iter_mut().for_each(|v| v.line = 0);
    out
}

#[test]
fn setters_reach_what_a_rig_file_says() {
    let owner = context();
    let rig = rig(owner);
    let mut n = 0;
    for name in [c"left", c"right"] {
        assert_eq!(unsafe { spivcal_rig_add_camera(rig, name.as_ptr(), &mut n) }, SPIVCAL_OK);
    }
    number(rig, SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM, 0, 0.0065);
    number(rig, SPIVCAL_RIG_CAMERA_FOCAL_LENGTH_MM, 0, 50.0);
    for (key, value) in [
        (SPIVCAL_RIG_CAMERA_DESIGN_OBJECT_DISTANCE_MM, 500.0),
        (SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_DEG, 45.0),
        (SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_VERTICAL_DEG, -3.0),
        (SPIVCAL_RIG_CAMERA_DESIGN_F_SIGMA, 0.01),
        (SPIVCAL_RIG_CAMERA_DESIGN_TILT_SIGMA_DEG, 0.5),
    ] {
        number(rig, key, 0, value);
    }
    assert_eq!(unsafe { spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 0, c"dot-grid".as_ptr()) }, SPIVCAL_OK);
    number(rig, SPIVCAL_RIG_TARGET_SPACING_MM, 0, 4.0);
    number(rig, SPIVCAL_RIG_TARGET_SPACING_SIGMA_MM, 0, 0.002);
    // A new value keeps its standard deviation.
    number(rig, SPIVCAL_RIG_TARGET_SPACING_MM, 0, 5.0);
    number(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, 0, 1.0);
    number(rig, SPIVCAL_RIG_TARGET_COLUMNS, 0, 9.0);
    number(rig, SPIVCAL_RIG_TARGET_ROWS, 0, 7.0);
    for (view, camera, file) in [(0, 0, c"a.png"), (0, 1, c"b.png"), (1, 0, c"c.png"), (2, 0, c"d.png")] {
        if camera == 0 {
            assert_eq!(unsafe { spivcal_rig_add_view(rig, &mut n) }, SPIVCAL_OK);
        }
        assert_eq!(unsafe { spivcal_rig_set_image_file(rig, view, camera, file.as_ptr()) }, SPIVCAL_OK);
    }
    number(rig, SPIVCAL_RIG_VIEW_SHEET, 0, 1.0);
    number(rig, SPIVCAL_RIG_VIEW_PLANE_Z_MM, 1, 2.0);
    number(rig, SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, 1, 0.01);
    number(rig, SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN, 2, 1.0);
    // Of a point and a disc the last one counts.
    (0..3).for_each(|k| number(rig, SPIVCAL_RIG_SHEET_ORIGIN_MM, k, 7.0));
    for (key, value) in [
        (SPIVCAL_RIG_SHEET_ORIGIN_VIEW, 1.0),
        (SPIVCAL_RIG_SHEET_ORIGIN_COLUMN, -1.0),
        (SPIVCAL_RIG_SHEET_ORIGIN_ROW, 2.0),
        (SPIVCAL_RIG_SHEET_ORIGIN_LEVEL, 0.0),
        (SPIVCAL_RIG_SHEET_X_AXIS_VIEW, 0.0),
        (SPIVCAL_RIG_SHEET_FLIP_X, 1.0),
    ] {
        number(rig, key, 0, value);
    }
    assert_eq!(spivcal_rig_check(rig), SPIVCAL_OK, "{}", error_text(rig));
    assert_eq!(described(rig), meaning(WHOLE));

    // And back: a point, a position that was read after all, and no standard deviations.
    (0..3).for_each(|k| number(rig, SPIVCAL_RIG_SHEET_ORIGIN_MM, k, 100.0 * k as f64));
    number(rig, SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN, 2, 0.0);
    number(rig, SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, 1, 0.0);
    number(rig, SPIVCAL_RIG_TARGET_SPACING_SIGMA_MM, 0, 0.0);
    let other = WHOLE
        .replace("{ view = 1, column = -1, row = 2, level = 0 }", "{ point_mm = [0.0, 100.0, 200.0] }")
        .replace("plane_z_mm = \"unknown\"", "")
        .replace("{ value = 2.0, sigma = 0.01 }", "2.0")
        .replace("{ value = 5.0, sigma = 0.002 }", "5.0");
    assert_eq!(described(rig), meaning(&other));
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

/// Every key of [`WHOLE`], and a value that it can have.
const NUMBERS_OF_WHOLE: [(i32, u64, f64); 21] = [
    (SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM, 0, 0.0065),
    (SPIVCAL_RIG_CAMERA_FOCAL_LENGTH_MM, 0, 50.0),
    (SPIVCAL_RIG_CAMERA_DESIGN_OBJECT_DISTANCE_MM, 0, 500.0),
    (SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_DEG, 0, 45.0),
    (SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_VERTICAL_DEG, 0, -3.0),
    (SPIVCAL_RIG_CAMERA_DESIGN_F_SIGMA, 0, 0.01),
    (SPIVCAL_RIG_CAMERA_DESIGN_TILT_SIGMA_DEG, 0, 0.5),
    (SPIVCAL_RIG_TARGET_POINT_SIGMA_MM, 0, 0.1),
    (SPIVCAL_RIG_FOCUS_TILT_SIGMA_DEG, 0, 0.3),
    (SPIVCAL_RIG_FOCUS_DISTANCE_SIGMA, 0, 0.01),
    (SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, 1, 0.5),
    (SPIVCAL_RIG_TARGET_STEP_MM, 0, 2.0),
    (SPIVCAL_RIG_VIEW_SHEET, 2, 1.0),
    (SPIVCAL_RIG_VIEW_PLANE_Z_MM, 0, 3.0),
    (SPIVCAL_RIG_SHEET_ORIGIN_VIEW, 0, 1.0),
    (SPIVCAL_RIG_SHEET_ORIGIN_COLUMN, 0, -1.0),
    (SPIVCAL_RIG_SHEET_ORIGIN_ROW, 0, 2.0),
    (SPIVCAL_RIG_SHEET_ORIGIN_LEVEL, 0, 0.0),
    (SPIVCAL_RIG_SHEET_X_AXIS_VIEW, 0, 0.0),
    (SPIVCAL_RIG_SHEET_FLIP_X, 0, 1.0),
    (SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN, 0, 1.0),
];

fn unset(rig: u64, key: i32, index: u64) {
    assert_eq!(spivcal_rig_unset(rig, key, index), SPIVCAL_OK, "{key}: {}", error_text(rig));
}

#[test]
fn what_is_unset_has_never_been_set() {
    let owner = context();
    let rig = parsed_rig(owner);
    // Nothing was said: the text stays to the letter.
    for (key, index, _) in NUMBERS_OF_WHOLE {
        let index = if index == 2 || key == SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG { 0 } else { index };
        unset(rig, key, index);
    }
    assert_eq!(spivcal_rig_unset_known(rig, 0, SPIVCAL_PARAMETER_K1), SPIVCAL_OK);
    assert_eq!(spivcal_rig_unset_scale(rig), SPIVCAL_OK);
    assert_eq!(spivcal_rig_remove_marks(rig), SPIVCAL_OK);
    assert_eq!(rig_text(rig), RIG);
    let before = described(rig);
    let mut n = 0;
    for file in [c"second.png", c"third.png"] {
        assert_eq!(unsafe { spivcal_rig_add_view(rig, &mut n) }, SPIVCAL_OK);
        assert_eq!(unsafe { spivcal_rig_set_image_file(rig, n, 0, file.as_ptr()) }, SPIVCAL_OK);
    }
    let index_here = |key: i32, index: u64| if key == SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG { 0 } else { index };
    for (key, index, value) in NUMBERS_OF_WHOLE {
        number(rig, key, index_here(key, index), value);
    }
    number(rig, SPIVCAL_RIG_VIEW_PLANE_Z_MM, 1, 2.0);
    number(rig, SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, 1, 0.01);
    let (alpha, distance) = (SPIVCAL_PARAMETER_ALPHA_DEG, SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM);
    assert_eq!(spivcal_rig_set_known(rig, 0, alpha, 0.0, 1.0), SPIVCAL_OK);
    assert_eq!(spivcal_rig_set_known(rig, 0, distance, 300.0, 1.0), SPIVCAL_OK);
    assert_eq!(spivcal_rig_set_scale(rig, SPIVCAL_SCALE_SPACING, 1, 0, 30.0, 0.0), SPIVCAL_OK);
    for (key, word) in [(SPIVCAL_RIG_SOLVE_LOSS, c"none"), (SPIVCAL_RIG_TARGET_POLARITY, c"dark")] {
        assert_eq!(unsafe { spivcal_rig_set_text(rig, key, 0, word.as_ptr()) }, SPIVCAL_OK);
    }
    assert_eq!(unsafe { spivcal_rig_add_mark(rig, c"ring".as_ptr(), 0, 0, 0) }, SPIVCAL_OK);

    // A documented default is as good as nothing, also where nothing else of its table is stated.
    let rest = parsed_rig(owner);
    for (key, default) in DEFAULTS {
        number(rest, key, 0, default);
    }
    assert_eq!(rig_text(rest), RIG);

    unset(rig, SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, 1);
    assert!(rig_text(rig).contains("plane_z_mm = 2.0"), "{}", rig_text(rig));
    unset(rig, SPIVCAL_RIG_VIEW_PLANE_Z_MM, 1);
    for (key, index, _) in NUMBERS_OF_WHOLE {
        unset(rig, key, index_here(key, index));
    }
    unset(rig, SPIVCAL_RIG_SOLVE_LOSS, 0);
    unset(rig, SPIVCAL_RIG_TARGET_POLARITY, 0);
    assert_eq!(spivcal_rig_unset_known(rig, 0, alpha), SPIVCAL_OK);
    assert_eq!(spivcal_rig_unset_known(rig, 0, distance), SPIVCAL_OK);
    assert_eq!(spivcal_rig_remove_view(rig, 1), SPIVCAL_ERROR_ARGUMENT);
    assert!(error_text(rig).contains("spivcal_rig_set_scale"), "{}", error_text(rig));
    assert_eq!(spivcal_rig_unset_scale(rig), SPIVCAL_OK);
    assert_eq!(spivcal_rig_remove_marks(rig), SPIVCAL_OK);
    assert_eq!(spivcal_rig_remove_view(rig, 1), SPIVCAL_OK);
    assert!(rig_text(rig).contains("third.png") && !rig_text(rig).contains("second.png"), "{}", rig_text(rig));
    assert_eq!(spivcal_rig_remove_view(rig, 1), SPIVCAL_OK);
    assert_eq!(described(rig), before, "{}", rig_text(rig));
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn lists_are_unset_from_their_end() {
    let owner = context();
    let rig = rig(owner);
    (0..2).for_each(|disc| number(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, disc, 3.0 + disc as f64));
    (0..3).for_each(|k| number(rig, SPIVCAL_RIG_SHEET_ORIGIN_MM, k, k as f64));
    unset(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, 1);
    unset(rig, SPIVCAL_RIG_SHEET_ORIGIN_MM, 2);
    assert!(rig_text(rig).contains("radii_mm = [3.0]"), "{}", rig_text(rig));
    assert!(
        rig_text(rig).contains("point_mm = [\n    0.0,\n    1.0,\n]")
            || rig_text(rig).contains("point_mm = [0.0, 1.0]")
    );
    unset(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, 0);
    unset(rig, SPIVCAL_RIG_SHEET_ORIGIN_MM, 0);
    assert_eq!(rig_text(rig), "");
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn views_that_go_take_their_images_along() {
    let owner = context();
    let rig = rig(owner);
    let (mut n, mut images) = (0, [0; 3]);
    assert_eq!(unsafe { spivcal_rig_add_camera(rig, c"left".as_ptr(), &mut n) }, SPIVCAL_OK);
    for (view, image) in images.iter_mut().enumerate() {
        let pixels = [view as u8 + 1; 64];
        assert_eq!(unsafe { spivcal_image_create_u8(owner, pixels.as_ptr(), 8, 8, 8, image) }, SPIVCAL_OK);
        assert_eq!(unsafe { spivcal_rig_add_view(rig, &mut n) }, SPIVCAL_OK);
    }
    // The last view has a file besides, whose place the image takes.
    assert_eq!(unsafe { spivcal_rig_set_image_file(rig, 2, 0, c"third.png".as_ptr()) }, SPIVCAL_OK);
    for (view, image) in images.iter().enumerate() {
        assert_eq!(spivcal_rig_set_image(rig, view as u64, 0, *image), SPIVCAL_OK);
    }
    assert_eq!(spivcal_rig_set_scale(rig, SPIVCAL_SCALE_SPACING, 2, 0, 26.0, 0.0), SPIVCAL_OK);
    assert_eq!(spivcal_rig_remove_view(rig, 2), SPIVCAL_ERROR_ARGUMENT);
    assert!(error_text(rig).contains("spivcal_rig_set_scale"), "{}", error_text(rig));
    assert_eq!(spivcal_rig_remove_view(rig, 3), SPIVCAL_ERROR_INDEX);
    assert_eq!(spivcal_rig_remove_view(rig, 0), SPIVCAL_OK);
    let text = rig_text(rig);
    let told = ["view0_camera0", "view1_camera0", "view = 1"].map(|words| text.contains(words));
    assert!(told == [true; 3] && !text.contains("view2_camera0") && !text.contains("third.png"), "{text}");
    assert_eq!(unsafe { spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 0, c"two-discs".as_ptr()) }, SPIVCAL_OK);
    let greys = || {
        let object = table::find_kind(rig, Kind::Rig).unwrap();
        let task = crate::ffi::rig::rig_state(&object).unwrap().task().unwrap();
        let views = task.job.views.len();
        (0..views).map(|v| task.image(v, 0).unwrap().view().get(3, 3)).collect::<Vec<f32>>()
    };
    assert_eq!(greys(), [2.0, 3.0]);
    assert_eq!(spivcal_rig_unset_image(rig, 0, 0), SPIVCAL_OK);
    assert!(!rig_text(rig).contains("view0_camera0"), "{}", rig_text(rig));
    assert_eq!(spivcal_rig_unset_image(rig, 0, 1), SPIVCAL_ERROR_INDEX);
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn what_has_no_value_has_no_standard_deviation() {
    let owner = context();
    let rig = parsed_rig(owner);
    for (key, index, value, status) in [
        (SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, 0, 0.1, SPIVCAL_ERROR_ARGUMENT),
        (SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, 1, 0.1, SPIVCAL_ERROR_INDEX),
        (SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, u64::MAX, 0.1, SPIVCAL_ERROR_INDEX),
        (SPIVCAL_RIG_TARGET_SPACING_SIGMA_MM, 0, -0.1, SPIVCAL_ERROR_ARGUMENT),
        (SPIVCAL_RIG_TARGET_SPACING_SIGMA_MM, 1, 0.1, SPIVCAL_ERROR_INDEX),
        (SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN, 0, 0.5, SPIVCAL_ERROR_ARGUMENT),
        (SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN, 1, 1.0, SPIVCAL_ERROR_INDEX),
        (SPIVCAL_RIG_SHEET_ORIGIN_MM, 1, 1.0, SPIVCAL_ERROR_INDEX),
        (SPIVCAL_RIG_SHEET_X_AXIS_VIEW, 0, 0.5, SPIVCAL_ERROR_ARGUMENT),
        (SPIVCAL_RIG_SHEET_FLIP_X, 1, 1.0, SPIVCAL_ERROR_INDEX),
        (SPIVCAL_RIG_SHEET_FLIP_X, 1, 0.0, SPIVCAL_ERROR_INDEX),
        // What is so anyway.
        (SPIVCAL_RIG_SHEET_FLIP_X, 0, 0.0, SPIVCAL_OK),
        (SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN, 0, 0.0, SPIVCAL_OK),
    ] {
        assert_eq!(spivcal_rig_set_number(rig, key, index, value), status, "{key} {index}: {}", error_text(rig));
        assert_eq!(rig_text(rig), RIG, "{key} {index}");
    }
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}

#[test]
fn what_never_changes_survives_a_panic() {
    let owner = context();
    let (mut image, mut width) = (0, 0);
    let pixels = [7u8; 64 * 64];
    let made = unsafe { spivcal_image_create_u8(owner, pixels.as_ptr(), 64, 64, 64, &mut image) };
    assert_eq!(made, SPIVCAL_OK, "{}", error_text(owner));
    assert_eq!(enter(image, Kind::Image, |_| panic!("seven")), SPIVCAL_ERROR_PANIC);
    assert!(error_text(image).contains("as it was"), "{}", error_text(image));
    let mut height = 0;
    assert_eq!(unsafe { spivcal_image_size(image, &mut width, &mut height) }, SPIVCAL_OK);
    assert_eq!((width, height), (64, 64));
    let rig = parsed_rig(owner);
    assert_eq!(enter(rig, Kind::Rig, |_| panic!("seven")), SPIVCAL_ERROR_PANIC);
    assert_eq!(spivcal_rig_check(rig), SPIVCAL_ERROR_POISONED);
    assert_eq!(spivcal_context_destroy(owner), SPIVCAL_OK);
}
