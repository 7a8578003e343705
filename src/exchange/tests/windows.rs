//! Cameras behind a flat window, written for packages that have none.

use super::*;

/// The rig looking through a pane into water.
fn behind_windows() -> Record {
    let cameras = [-25.0, 0.0].map(|angle_deg| {
        let mut c = world_camera(if angle_deg == 0.0 { "left" } else { "aside" }, lens(1.0, -0.1), angle_deg);
        // The pane is parallel to the sheet.
        let normal = -c.cam_from_world.rotation.column(2).into_owned();
        let window = crate::camera::Window::new(normal, 250.0, 12.0, [1.0, 1.49, 1.333]).unwrap();
        c.camera = c.camera.with_window(Some(window));
        c
    });
    let [aside, left] = cameras;
    let mut record = imported::record(
        Found {
            cameras: vec![left.clone(), aside.clone()],
            has_sheet: true,
            of_marks: false,
            notes: vec![],
            program: "test",
        },
        &[],
    )
    .unwrap()
    .result;
    for (c, from) in record.cameras.iter_mut().zip([left, aside]) {
        let w = from.camera.window().unwrap();
        let [distance_mm, thickness_mm, n_air, n_glass, n_water] = w.layers();
        let sigma = crate::record::WindowSigma {
            normal_rad: [f64::NAN; 3],
            distance_mm: f64::NAN,
            thickness_mm: f64::NAN,
            n_air: f64::NAN,
            n_glass: f64::NAN,
            n_water: f64::NAN,
        };
        let normal_in_cam = (*w.normal()).into();
        c.window =
            Some(crate::record::Window { normal_in_cam, distance_mm, thickness_mm, n_air, n_glass, n_water, sigma });
    }
    record
}

#[test]
fn a_window_is_refitted_with_the_loss_stated_or_carried_within_the_map() {
    let record = behind_windows();
    let truth = Cameras::of(&record).unwrap().cameras;
    for format in [ExportFormat::OpenCv, ExportFormat::OpenPtv, ExportFormat::Matlab] {
        let done = export(&record, format).unwrap();
        let told = done.notes.iter().filter(|n| n.contains("flat window")).count();
        assert_eq!(told, 2, "{:?}", done.notes);
        // Refraction on the normal is an aberration of a hundredth of a pixel or so, obliquely more: known to the user.
        assert!(
            done.losses.iter().all(|l| l.max_px > 1e-4 && l.max_px < 3.0 && l.rms_px < l.max_px),
            "{:?}",
            done.losses
        );
        assert!(done.losses[0].max_px < done.losses[1].max_px, "{:?}", done.losses);
    }
    // What comes back sees the points of the sheet where the stated loss says.
    let done = export(&record, ExportFormat::OpenCv).unwrap();
    let back = import(&texts(&done.result), ImportFormat::OpenCv, &OPTIONS).unwrap().result;
    for ((camera, loss), own) in Cameras::of(&back).unwrap().cameras.iter().zip(&done.losses).zip(&truth) {
        let map = crate::dewarp::SheetMap::new(own.camera, own.cam_from_world, SIZE);
        let mut largest: f64 = 0.0;
        for k in 0..100 {
            let q = Vector2::new(f64::from(k % 10) * 113.0, f64::from(k / 10) * 85.0);
            let p = map.hit(&q, 0.0).unwrap().xy_mm.push(0.0);
            let seen = camera.camera.project_xyz(&camera.cam_from_world.apply(&p)).unwrap();
            largest = largest.max((seen - q).norm());
        }
        assert!(largest < 1.5 * loss.max_px + 1e-6 && largest > 0.05 * loss.max_px, "{largest} {loss:?}");
    }
    let soloff = export(&record, ExportFormat::Soloff).unwrap();
    assert!(soloff.losses.iter().all(|l| l.max_px < 0.05), "{:?}", soloff.losses);
    let tables = texts(&export(&record, ExportFormat::Csv).unwrap().result);
    assert!(
        tables[0].text.contains("aside,window.distance,250,,mm")
            && tables[0].text.contains("left,window.n_glass,1.49,,1")
    );
}
