//! Maps between pixels and the sheet: against the camera itself, their own inverse, and differences; polynomials against
//! the exact map.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod scene;

use nalgebra::Vector3;
use spivcal::camera::Camera;
use spivcal::dewarp::{Placement, SheetMap, Soloff, SoloffDegrees, SoloffVolume};
use spivcal::frames::{Cam, Rig, Sheet};

fn maps() -> [SheetMap; 2] {
    let record = scene::record();
    [0, 1].map(|c| SheetMap::from_record(&record, c).unwrap())
}

/// Pixels all over the sensor, and a z each.
fn pixels(map: &SheetMap) -> [Vec<f64>; 3] {
    let [w, h] = map.size_px().map(|n| n as f64 - 1.0);
    let mut out = [vec![], vec![], vec![]];
    for j in 0..7 {
        for i in 0..9 {
            out[0].push(w * f64::from(i) / 8.0);
            out[1].push(h * f64::from(j) / 6.0);
            out[2].push(0.31 * f64::from((i * 5 + j * 3) % 7) - 0.9);
        }
    }
    out
}

#[test]
fn the_map_is_that_of_the_cameras_and_the_plane() {
    let record = scene::record();
    for (c, map) in maps().iter().enumerate() {
        let [u, v, z] = pixels(map);
        let points = map.sheet_of_pixel(&u, &v, &z).unwrap();
        let camera = Camera::new(record.cameras[c].intrinsics()).unwrap();
        let rig_from_sheet = record.sheet.as_ref().unwrap().rig_from_sheet.motion::<Rig, Sheet>();
        let cam_from_rig = record.cameras[c].cam_from_rig.motion::<Cam, Rig>();
        for i in 0..u.len() {
            let in_sheet = Vector3::new(points.x_mm[i], points.y_mm[i], z[i]);
            let q = camera.project_xyz(&cam_from_rig.apply(&rig_from_sheet.apply(&in_sheet))).unwrap();
            assert!((q.x - u[i]).abs() < 1e-8 && (q.y - v[i]).abs() < 1e-8, "{q} {} {}", u[i], v[i]);
        }
        let back = map.pixel_of_sheet(&points.x_mm, &points.y_mm, &z).unwrap();
        for i in 0..u.len() {
            assert!((back.u_px[i] - u[i]).hypot(back.v_px[i] - v[i]) < 1e-8);
        }
    }
}

#[test]
fn jacobians_are_differences_of_the_maps() {
    for map in maps() {
        let [u, v, z] = pixels(&map);
        let jets = map.sheet_of_pixel_jets(&u, &v, &z).unwrap();
        let shifted = |list: &[f64], h: f64| -> Vec<f64> { list.iter().map(|x| x + h).collect() };
        let near = |name: &str, plus: &[f64], minus: &[f64], h: f64, analytic: &[f64], scale: f64| {
            for i in 0..plus.len() {
                let numeric = (plus[i] - minus[i]) / (2.0 * h);
                assert!((numeric - analytic[i]).abs() < 1e-7 * scale, "{name}: {numeric} {}", analytic[i]);
            }
        };
        let h = 1e-2;
        let by = |du: f64, dv: f64, dz: f64| {
            map.sheet_of_pixel(&shifted(&u, du), &shifted(&v, dv), &shifted(&z, dz)).unwrap()
        };
        let (p, m) = (by(h, 0.0, 0.0), by(-h, 0.0, 0.0));
        near("dx/du", &p.x_mm, &m.x_mm, h, &jets.dx_du, 0.1);
        near("dy/du", &p.y_mm, &m.y_mm, h, &jets.dy_du, 0.1);
        let (p, m) = (by(0.0, h, 0.0), by(0.0, -h, 0.0));
        near("dx/dv", &p.x_mm, &m.x_mm, h, &jets.dx_dv, 0.1);
        near("dy/dv", &p.y_mm, &m.y_mm, h, &jets.dy_dv, 0.1);
        let (p, m) = (by(0.0, 0.0, h), by(0.0, 0.0, -h));
        near("dx/dz", &p.x_mm, &m.x_mm, h, &jets.dx_dz, 1.0);
        near("dy/dz", &p.y_mm, &m.y_mm, h, &jets.dy_dz, 1.0);

        let (x, y) = (jets.x_mm, jets.y_mm);
        let jets = map.pixel_of_sheet_jets(&x, &y, &z).unwrap();
        let by = |dx: f64, dy: f64, dz: f64| {
            map.pixel_of_sheet(&shifted(&x, dx), &shifted(&y, dy), &shifted(&z, dz)).unwrap()
        };
        let h = 1e-4;
        for (k, [du, dv]) in
            [[&jets.du_dx, &jets.dv_dx], [&jets.du_dy, &jets.dv_dy], [&jets.du_dz, &jets.dv_dz]].into_iter().enumerate()
        {
            let step = |s: f64| [0, 1, 2].map(|a| if a == k { s } else { 0.0 });
            let ([a, b, c], [d, e, f]) = (step(h), step(-h));
            let (p, m) = (by(a, b, c), by(d, e, f));
            near("du", &p.u_px, &m.u_px, h, du, 20.0);
            near("dv", &p.v_px, &m.v_px, h, dv, 20.0);
        }
    }
}

#[test]
fn view_slopes_follow_from_the_projection_centre() {
    for map in maps() {
        let [u, v, _] = pixels(&map);
        let points = map.sheet_of_pixel(&u, &v, &vec![0.0; u.len()]).unwrap();
        let angles = map.view_angles(&u, &v).unwrap();
        let eye = map.cam_from_sheet().inverse().translation_mm;
        for i in 0..u.len() {
            let ray = eye - Vector3::new(points.x_mm[i], points.y_mm[i], 0.0);
            assert!((angles.x_rad[i] - (ray.x / ray.z).atan()).abs() < 1e-12);
            assert!((angles.y_rad[i] - (ray.y / ray.z).atan()).abs() < 1e-12);
            let cosine = ray.z.abs() / ray.norm();
            assert!((angles.to_normal_rad[i].cos() - cosine).abs() < 1e-12);
        }
    }
}

#[test]
fn z_is_towards_the_first_camera_unless_the_frame_is_turned_round() {
    let first = &maps()[0];
    assert!(first.cam_from_sheet().inverse().translation_mm.z > 0.0);
    let turned = Placement { turned_round: true, ..Placement::default() }.sheet_from_placed();
    assert!(first.in_frame(&turned).cam_from_sheet().inverse().translation_mm.z < 0.0);
}

#[test]
fn a_placed_frame_moves_points_and_nothing_else() {
    let map = &maps()[1];
    let place = Placement { origin_mm: [4.0, -7.0], angle_rad: 0.3, turned_round: false }.sheet_from_placed();
    let placed = map.in_frame(&place);
    let [u, v, z] = pixels(map);
    let (a, b) = (map.sheet_of_pixel(&u, &v, &z).unwrap(), placed.sheet_of_pixel(&u, &v, &z).unwrap());
    for i in 0..u.len() {
        let moved = place.apply(&Vector3::new(b.x_mm[i], b.y_mm[i], z[i]));
        assert!((moved - Vector3::new(a.x_mm[i], a.y_mm[i], z[i])).norm() < 1e-10);
    }
    let record = scene::record();
    let at = Placement::at_view(&record, 5).unwrap();
    let sheet_from_rig = record.sheet.unwrap().rig_from_sheet.motion::<Rig, Sheet>().inverse();
    let target = record.views[5].rig_from_target.unwrap().motion::<Rig, spivcal::frames::Target>();
    let origin = sheet_from_rig.apply(&target.translation_mm);
    assert!((origin.xy() - nalgebra::Vector2::from(at.origin_mm)).norm() < 1e-12);
    assert!(Placement::at_view(&scene::record(), 99).is_err());
}

#[test]
fn what_no_ray_meets_is_nan_and_unequal_lists_are_refused() {
    let map = &maps()[0];
    let behind = map.pixel_of_sheet(&[0.0], &[0.0], &[1e5]).unwrap();
    assert!(behind.u_px[0].is_nan() && behind.v_px[0].is_nan());
    let beyond = map.sheet_of_pixel_jets(&[500.0], &[300.0], &[1e5]).unwrap();
    assert!(beyond.x_mm[0].is_nan() && beyond.dx_du[0].is_nan());
    let message = map.pixel_of_sheet(&[0.0, 1.0], &[0.0], &[0.0, 0.0]).unwrap_err().to_string();
    assert!(message.contains("number of points = 1") && message.contains('2'), "{message}");
    let mut record = scene::record();
    assert!(SheetMap::from_record(&record, 2).unwrap_err().to_string().contains("0 to 1"));
    record.sheet = None;
    assert!(SheetMap::from_record(&record, 0).unwrap_err().to_string().contains("no laser sheet"));
}

#[test]
fn polynomials_come_close_to_the_map_and_say_how_close() {
    let volume = SoloffVolume { middle_mm: [0.0, 0.0, 0.0], half_mm: [18.0, 14.0, 1.5] };
    for map in maps() {
        let mut last = f64::INFINITY;
        for (xy, z, terms) in [(2, 1, 9), (2, 2, 10), (3, 1, 16), (3, 2, 19)] {
            let fit = Soloff::fit(&map, volume, SoloffDegrees { xy, z }).unwrap();
            assert_eq!(fit.map.terms().count(), terms);
            println!("degrees {xy} {z}: rms {:.2e} px, largest {:.2e} px", fit.rms_px, fit.largest_px);
            assert!(fit.rms_px < last * 1.0001 && fit.rms_px <= fit.largest_px);
            last = fit.rms_px;
            // The stated departure is true at points of neither lattice, and the slopes are those of the map.
            let (x, y, dz) = ([-11.3, 2.1, 15.7, 17.9], [8.8, -13.7, 3.3, 13.9], [0.7, -1.4, 0.1, 1.5]);
            let (exact, poly) =
                (map.pixel_of_sheet_jets(&x, &y, &dz).unwrap(), fit.map.pixel_of_sheet_jets(&x, &y, &dz).unwrap());
            for i in 0..x.len() {
                let apart = (exact.u_px[i] - poly.u_px[i]).hypot(exact.v_px[i] - poly.v_px[i]);
                assert!(apart < 1.05 * fit.largest_px, "{apart} {}", fit.largest_px);
                for (a, b) in [(&exact.du_dx, &poly.du_dx), (&exact.dv_dy, &poly.dv_dy), (&exact.du_dz, &poly.du_dz)] {
                    assert!((a[i] - b[i]).abs() < 5.0 * fit.largest_px + 1e-3 * a[i].abs(), "{} {}", a[i], b[i]);
                }
            }
            let back = fit.map.sheet_of_pixel(&poly.u_px, &poly.v_px, &dz).unwrap();
            for i in 0..x.len() {
                assert!((back.x_mm[i] - x[i]).hypot(back.y_mm[i] - y[i]) < 1e-9);
            }
        }
        assert!(last < 0.1, "{last}");
        assert!(Soloff::fit(&map, volume, SoloffDegrees { xy: 4, z: 1 }).is_err());
        let flat = SoloffVolume { half_mm: [1.0, 1.0, 0.0], ..volume };
        assert!(Soloff::fit(&map, flat, SoloffDegrees::default()).is_err());
        let far = SoloffVolume { half_mm: [1.0, 1.0, 1e5], ..volume };
        assert!(Soloff::fit(&map, far, SoloffDegrees::default()).unwrap_err().to_string().contains("smaller"));
    }
}
