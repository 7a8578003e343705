//! Laser planes of UVMAT, by the formulas of another reader of its files.

use super::*;

const ROTATION: [[f64; 3]; 3] = [[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [0.28, 0.0, -0.96]];
const SHIFT_CM: [f64; 3] = [1.0, 2.0, 50.0];

/// A file whose camera has the rotation with its third row and column times `z`, and these elements besides.
fn file(name: &str, hand: f64, slices: &str) -> NamedText {
    let rows: String = ROTATION.iter().map(|r| format!("<R>{} {} {}</R>", r[0], r[1], r[2] * hand)).collect();
    let [x, y, z] = SHIFT_CM;
    NamedText {
        name: name.into(),
        text: format!(
            "<ImaDoc><GeometryCalib><CalibrationType>3D_extrinsic</CalibrationType><CoordUnit>cm</CoordUnit><fx_fy>5000 5010</fx_fy>\
             <Cx_Cy>512 384</Cx_Cy><kc>-0.3</kc><Tx_Ty_Tz>{x} {y} {z}</Tx_Ty_Tz>{rows}{slices}</GeometryCalib></ImaDoc>"
        ),
    }
}

fn read(slices: &str, hand: f64) -> Result<Conversion<Record>> {
    import(&[file("a.xml", hand, slices)], ImportFormat::Uvmat, &OPTIONS)
}

/// Normal of a slice as the other reader computes it: axis and angle multiplied out for the third column only.
fn normal(angle_deg: [f64; 3]) -> [f64; 3] {
    let degrees = (angle_deg[0].powi(2) + angle_deg[1].powi(2) + angle_deg[2].powi(2)).sqrt();
    if degrees == 0.0 {
        return [0.0, 0.0, 1.0];
    }
    let [a, b, c] = angle_deg.map(|x| x / degrees);
    let (sin, cos) = degrees.to_radians().sin_cos();
    let part = c * (1.0 - cos);
    [a * part + b * sin, b * part - a * sin, c * part + cos]
}

#[test]
fn the_sheet_is_the_slice_that_the_file_states() {
    for hand in [1.0, -1.0] {
        for (place_cm, angle_deg) in
            [([0.0, 0.0, 1.5], [0.0; 3]), ([0.3, -0.4, -2.0], [5.0, -12.0, 3.0]), ([1.0, 0.0, 0.0], [170.0, 0.0, 0.0])]
        {
            let words = |v: [f64; 3]| v.map(|x| x.to_string()).join(" ");
            let text = format!(
                "<NbSlice>1</NbSlice><SliceCoord>{}</SliceCoord><SliceAngle>{}</SliceAngle>",
                words(place_cm),
                words(angle_deg)
            );
            let back = read(&text, hand).unwrap();
            assert!(!back.notes.iter().any(|n| n.contains("do not say")), "{:?}", back.notes);
            let c = &Cameras::of(&back.result).unwrap().cameras[0];
            let map = crate::dewarp::SheetMap::new(c.camera, c.cam_from_world, SIZE);
            let n = normal(angle_deg);
            let mut counted = 0;
            for (i, j) in (-4..=4).flat_map(|i| (-3..=3).map(move |j| (i, j))) {
                // A point of the slice: z follows from x and y.
                let (x, y) = (0.8 * f64::from(i), 0.8 * f64::from(j) - 2.0);
                let z = place_cm[2] - (n[0] * (x - place_cm[0]) + n[1] * (y - place_cm[1])) / n[2];
                let at = |row: usize| {
                    let r = ROTATION[row];
                    r[0] * x + r[1] * y + r[2] * hand * z + SHIFT_CM[row]
                };
                let (p, q, w) = (at(0), at(1), at(2));
                let g = 1.0 - 0.3 * ((p / w).powi(2) + (q / w).powi(2));
                let pixel = Vector2::new(5000.0 * p / w * g + 511.5, 767.5 - (5010.0 * q / w * g + 384.0));
                if pixel.x < 0.0 || pixel.y < 0.0 || pixel.x > 1023.0 || pixel.y > 767.0 {
                    continue;
                }
                counted += 1;
                // In the camera, y down and mm: where the pixel meets the sheet is that point.
                let hit = map.hit(&pixel, 0.0).unwrap().xy_mm.push(0.0);
                let gap = c.cam_from_world.apply(&hit) - Vector3::new(p, -q, w) * 10.0;
                assert!(gap.norm() < 1e-8, "{hand} {place_cm:?} {angle_deg:?}: {gap}");
            }
            assert!(counted > 20, "{counted}");
        }
    }
}

/// A slice parallel to z = 0 keeps x and y of the file.
#[test]
fn a_slice_that_is_not_turned_keeps_the_axes() {
    let at = |slices: &str| {
        let back = read(slices, 1.0).unwrap().result;
        back.sheet.unwrap().rig_from_sheet.motion::<Rig, Sheet>()
    };
    let (plain, lifted) = (at(""), at("<SliceCoord>3 4 1.5</SliceCoord>"));
    assert!((plain.rotation - lifted.rotation).norm() < 1e-12);
    let step = plain.inverse().apply(&lifted.translation_mm);
    assert!((step.norm() - 15.0).abs() < 1e-9 && (step.z.abs() - 15.0).abs() < 1e-9, "{step}");
}

#[test]
fn several_slices_and_different_ones_are_refused_with_the_way_out() {
    let two = "<SliceCoord>0 0 1</SliceCoord><SliceCoord>0 0 2</SliceCoord>";
    for (text, words) in [
        (two, "several slices"),
        ("<SliceCoord_1>0 0 1</SliceCoord_1><SliceCoord_2>0 0 2</SliceCoord_2>", "several slices"),
        ("<NbSlice>5</NbSlice><SliceCoord>0 0 1</SliceCoord>", "several slices"),
        ("<SliceCoord>1</SliceCoord>", "three numbers"),
        ("<SliceAngle>0 5 0</SliceAngle>", "no SliceCoord"),
    ] {
        let message = read(text, 1.0).unwrap_err().to_string();
        assert!(message.contains(words) && message.contains("a.xml"), "{text}: {message}");
    }
    let pair =
        |a: &str, b: &str| import(&[file("a.xml", 1.0, a), file("b.xml", 1.0, b)], ImportFormat::Uvmat, &OPTIONS);
    let (one, other) = ("<SliceCoord>0 0 1</SliceCoord>", "<SliceCoord>0 0 1.1</SliceCoord>");
    let message = pair(one, other).unwrap_err().to_string();
    assert!(message.contains("b.xml") && message.contains("another plane"), "{message}");
    // Another point of the same plane is the same plane.
    assert!(pair(one, "<SliceCoord>5 6 1</SliceCoord>").is_ok());
}
