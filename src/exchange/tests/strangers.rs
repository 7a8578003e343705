//! Pixels of world points by the formulas that other packages document, written here anew, against what was converted.

use super::*;
use nalgebra::DMatrix;

/// World points about the middle of what the cameras of [`record_of`] see, on the sheet and far before and behind it.
fn world_points() -> Vec<Vector3<f64>> {
    let mut out = Vec::new();
    for z in [-40.0, -5.0, 0.0, 5.0, 40.0] {
        for (i, j) in (-4..=4).flat_map(|i| (-4..=4).map(move |j| (i, j))) {
            out.push(Vector3::new(f64::from(i) * 4.5, f64::from(j) * 4.0, z));
        }
    }
    out
}

fn inside(q: &Vector2<f64>) -> bool {
    q.x >= 0.0 && q.y >= 0.0 && q.x <= SIZE[0] as f64 - 1.0 && q.y <= SIZE[1] as f64 - 1.0
}

/// Largest distance between a stranger's pixels and those of a camera, where the latter lie in the image.
fn apart(c: &WorldCamera, stranger: impl Fn(&Vector3<f64>) -> Vector2<f64>) -> f64 {
    let seen = |x: &Vector3<f64>| c.camera.project_xyz(&c.cam_from_world.apply(x)).unwrap();
    let pairs: Vec<f64> = world_points()
        .iter()
        .map(|x| (seen(x), x))
        .filter(|(q, _)| inside(q))
        .map(|(q, x)| (stranger(x) - q).norm())
        .collect();
    assert!(pairs.len() > 150, "{}", pairs.len());
    pairs.into_iter().fold(0.0, f64::max)
}

/// OpenCV's documentation of `calib3d`: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty; (0, 0) is the centre of the first pixel.
fn opencv_pixel(k: &[f64; 4], d: &[f64; 14], x: f64, y: f64) -> Vector2<f64> {
    let (r2, r4) = (x * x + y * y, (x * x + y * y).powi(2));
    let r6 = r2 * r4;
    let radial = (1.0 + d[0] * r2 + d[1] * r4 + d[4] * r6) / (1.0 + d[5] * r2 + d[6] * r4 + d[7] * r6);
    let xd = x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x) + d[8] * r2 + d[9] * r4;
    let yd = y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y + d[10] * r2 + d[11] * r4;
    let (s, c, t, e) = (d[12].sin(), d[12].cos(), d[13].sin(), d[13].cos());
    // Ry Rx multiplied out.
    let r = [[e, t * s, -t * c], [0.0, c, s], [t, -e * s, e * c]];
    let at = |row: [f64; 3]| row[0] * xd + row[1] * yd + row[2];
    let (a, b, w) = (at(r[0]), at(r[1]), at(r[2]));
    let (u, v) = ((r[2][2] * a - r[0][2] * w) / w, (r[2][2] * b - r[1][2] * w) / w);
    Vector2::new(k[0] * u + k[2], k[1] * v + k[3])
}

/// Direction (x, y, 1) of a pixel by a fixed point, which stays before the first fold.
fn opencv_direction(k: &[f64; 4], d: &[f64; 14], q: &Vector2<f64>) -> Vector3<f64> {
    let mut xy = Vector2::zeros();
    for _ in 0..5000 {
        let gap = q - opencv_pixel(k, d, xy.x, xy.y);
        xy += Vector2::new(gap.x / k[0], gap.y / k[1]);
        if gap.norm() < 1e-11 {
            break;
        }
    }
    let gap = (opencv_pixel(k, d, xy.x, xy.y) - q).norm();
    assert!(gap < 1e-9, "{gap}");
    xy.push(1.0)
}

fn coefficients(given: &[f64]) -> [f64; 14] {
    let mut out = [0.0; 14];
    out[..given.len()].copy_from_slice(given);
    out
}

/// A lens of OpenCV and its image.
struct Lens {
    k: [f64; 4],
    d: [f64; 14],
    size: [usize; 2],
}

fn lens_of(f: f64, size: [usize; 2], d: &[f64]) -> Lens {
    let middle = size.map(|n| 0.5 * (n as f64 - 1.0));
    Lens { k: [f, f, middle[0], middle[1]], d: coefficients(d), size }
}

/// Pixels over the whole image, corners first.
fn pixels_of(size: [usize; 2]) -> Vec<Vector2<f64>> {
    let last = size.map(|n| n as f64 - 1.0);
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
    let between = (0..=32).flat_map(|i| (0..=24).map(move |j| [f64::from(i) / 32.0, f64::from(j) / 24.0]));
    corners.into_iter().chain(between).map(|[a, b]| Vector2::new(a * last[0], b * last[1])).collect()
}

/// Camera 1 at -angle, camera 2 at +angle, both looking at the world's origin; second from first.
fn poses(angle_deg: f64, far: f64) -> [Motion<Cam, Sheet>; 2] {
    [-angle_deg, angle_deg].map(|a| {
        let c = world_camera("", lens(0.0, 0.0), a);
        Motion::new(c.cam_from_world.rotation, Vector3::new(0.4, -0.7, far))
    })
}

fn opencv_file(lens: &Lens, [first, second]: &[Motion<Cam, Sheet>; 2], with_sheet: bool) -> NamedText {
    let matrix = |key: &str, rows: usize, data: &[f64]| {
        let numbers: Vec<String> = data.iter().map(|x| format!("{x:?}")).collect();
        let columns = data.len() / rows;
        format!(
            "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {} ]\n",
            numbers.join(", ")
        )
    };
    let by_rows = |m: &Matrix3<f64>| m.transpose().as_slice().to_vec();
    let [fx, fy, cx, cy] = lens.k;
    let mut text = format!("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", lens.size[0], lens.size[1]);
    for n in 1..=2 {
        text += &matrix(&format!("M{n}"), 3, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
        text += &matrix(&format!("D{n}"), 1, &lens.d);
    }
    let motion = *second * first.inverse();
    text += &matrix("R", 3, &by_rows(&motion.rotation));
    text += &matrix("T", 3, motion.translation_mm.as_slice());
    if with_sheet {
        text += &matrix("R_sheet", 3, &by_rows(&first.rotation));
        text += &matrix("T_sheet", 3, first.translation_mm.as_slice());
    }
    NamedText { name: "rig.yml".into(), text }
}

fn read_opencv(file: NamedText) -> Conversion<Record> {
    import(&[file], ImportFormat::OpenCv, &ImportOptions::default()).unwrap()
}

/// What is lost of a lens over its whole image, by OpenCV's formula: first camera, at depths from near to far.
fn lost(lens: &Lens) -> (f64, f64, Conversion<Record>) {
    let poses = poses(40.0, 500.0);
    let back = read_opencv(opencv_file(lens, &poses, true));
    let cameras = Cameras::of(&back.result).unwrap().cameras;
    let (mut largest, mut corner): (f64, f64) = (0.0, 0.0);
    for (c, pose) in cameras.iter().zip(&poses) {
        for (n, q) in pixels_of(lens.size).iter().enumerate() {
            let ray = opencv_direction(&lens.k, &lens.d, q);
            for far in [100.0, 500.0, 5000.0] {
                let x = pose.inverse().apply(&(ray * far));
                let seen = c.camera.project_xyz(&c.cam_from_world.apply(&x)).unwrap();
                largest = largest.max((seen - q).norm());
                if n < 4 {
                    corner = corner.max((seen - q).norm());
                }
            }
        }
    }
    (largest, corner, back)
}

/// Lenses of OpenCV with all its coefficients: the loss that is told is the one that pixels to the corners have, at all depths.
#[test]
fn the_loss_of_an_opencv_lens_is_that_of_its_whole_image() {
    let kinect = lens_of(504.5, [640, 576], &[5.25, 3.38, -5e-5, 1e-4, 0.173, 5.58, 4.99, 0.90]);
    let rational = lens_of(2000.0, [1024, 768], &[12.0, 30.0, 0.0, 0.0, 3.0, 12.2, 31.5, 8.0]);
    let colour = lens_of(976.0, [2048, 1536], &[0.513, -2.731, 9e-4, -2e-4, 1.603, 0.391, -2.551, 1.526]);
    let decentred = lens_of(8000.0, [1024, 768], &[-0.15, 0.0, 1e-3, -2e-3]);
    let prism =
        lens_of(8000.0, [1024, 768], &[-0.15, 0.3, 1e-3, 5e-4, 0.0, 0.2, 0.0, 0.0, 1e-3, 0.1, -2e-3, 0.2, 0.03, -0.11]);
    // Least and most of what a polynomial k1 k2 k3 leaves of each, px.
    let all = [
        // A strong barrel: 0.34 px with the polynomial from ideal to distorted.
        ("kinect", kinect, [0.02, 0.17]),
        ("rational", rational, [1e-4, 0.02]),
        ("colour", colour, [0.1, 10.0]),
        ("decentred", decentred, [1e-6, 0.1]),
        ("prism", prism, [1e-6, 0.1]),
    ];
    for (name, lens, [least, most]) in all {
        let (largest, corner, back) = lost(&lens);
        let told = back.losses.iter().map(|l| l.max_px).fold(0.0, f64::max);
        println!("{name}: told {told:.4} px, true {largest:.4}, at the corners {corner:.4}; {:?}", back.losses);
        assert!(largest < 1.05 * told + 1e-6 && largest > told - 1e-6, "{name}: {largest} {:?}", back.losses);
        assert!(told > least && told < most, "{name}: {told}");
        assert_eq!(back.flags().is_empty(), told <= LOSS_LIMIT_PX, "{name}");
        let turned = back.result.cameras[0].model().unwrap().intrinsics().radial == Radial::DistortedToIdeal;
        let noted = back.notes.iter().any(|n| n.contains("from distorted to ideal"));
        assert_eq!((turned, noted), (name == "kinect", name == "kinect"));
    }
}

/// A lens whose image folds before its corners, by the size of the image or by the coefficients.
#[test]
fn a_lens_that_folds_within_its_image_is_refused_with_the_pixel() {
    let folding = lens_of(500.0, [1024, 768], &[-0.5, 0.1, 1e-4, 0.0]);
    let file = opencv_file(&folding, &poses(40.0, 500.0), true);
    let message = import(&[file], ImportFormat::OpenCv, &ImportOptions::default()).unwrap_err().to_string();
    assert!(message.contains("pixel (0, 0) of 1024 x 768") && message.contains("image size"), "{message}");
}

/// Without a sheet nothing says where the points will be: rays of a point meet at all distances as well as the losses say.
#[test]
fn rays_of_cameras_without_a_sheet_meet_at_all_distances() {
    let lens = lens_of(3000.0, [1024, 768], &[-0.1, 0.05, 1e-3, -8e-4]);
    for far in [300.0, 2000.0] {
        let poses = poses(30.0, far);
        let back = read_opencv(opencv_file(&lens, &poses, false));
        assert!(back.result.sheet.is_none() && back.losses[0].max_px > 1e-4, "{:?}", back.losses);
        let second = &back.result.cameras[1];
        let rig_from_cam = second.cam_from_rig.motion::<Cam, Rig>().inverse();
        let base = rig_from_cam.translation_mm;
        let stated = (poses[1] * poses[0].inverse()).inverse().translation_mm.norm();
        assert!((base.norm() - stated).abs() < 1e-9 * stated, "{} {stated}", base.norm());
        let (mut largest, reach): (f64, f64) = (0.0, 0.12 * far);
        for (i, j, k) in (-3..=3).flat_map(|i| (-3..=3).flat_map(move |j| (-1..=1).map(move |k| (i, j, k)))) {
            let x = Vector3::new(f64::from(i) / 3.0, f64::from(j) / 3.0, f64::from(k) / 3.0) * reach;
            let [a, b] = poses.map(|m| {
                let p = m.apply(&x);
                opencv_pixel(&lens.k, &lens.d, p.x / p.z, p.y / p.z)
            });
            let ray = |c: usize, q: &Vector2<f64>| {
                back.result.cameras[c].model().unwrap().ideal_of_pixel(q).unwrap().push(1.0)
            };
            let (a, b) = (ray(0, &a), rig_from_cam.rotation * ray(1, &b));
            // Distance of the second ray from the epipolar plane of the first.
            largest = largest.max(lens.k[0] * b.dot(&base.cross(&a).normalize()).abs());
        }
        let told: f64 = back.losses.iter().map(|l| l.max_px).sum();
        println!("{far} mm: rays miss by {largest:.4} px, told {:?}", back.losses);
        assert!(largest < 1.1 * told, "{far}: {largest} {told}");
    }
}

/// MATLAB's documentation of `cameraIntrinsics` and `rigidtform3d`: p = R X + t, then radial and tangential, then pixels from (1, 1).
#[test]
fn matlab_sees_world_points_where_the_cameras_do() {
    for (k1, exact) in [(0.0, true), (-0.15, false)] {
        let mut left = lens(6.34, k1);
        // k3 alone would be lost in two radial coefficients.
        left.k[2] = 400.0 * k1;
        let record = record_of(left, lens(-6.34, -0.7 * k1));
        let out = export(&record, ExportFormat::Matlab).unwrap();
        let variables = matlab_variables(&out.result[0].1);
        for (n, c) in Cameras::of(&record).unwrap().cameras.iter().enumerate() {
            let of = |name: &str| {
                let found = variables.iter().find(|v| v.0 == format!("{name}{}", n + 1)).unwrap();
                DMatrix::from_column_slice(found.1[0], found.1[1], &found.2)
            };
            let (k, radial, p, r, t) = (of("K"), of("radial"), of("tangential"), of("R"), of("t"));
            assert_eq!((radial.len(), p.len(), of("imageSize")[0], of("imageSize")[1]), (3, 2, 768.0, 1024.0));
            let seen = |x: &Vector3<f64>| {
                let at = |row: usize| r[(row, 0)] * x.x + r[(row, 1)] * x.y + r[(row, 2)] * x.z + t[row];
                let (x, y) = (at(0) / at(2), at(1) / at(2));
                let r2 = x * x + y * y;
                let bent = 1.0 + radial[0] * r2 + radial[1] * r2.powi(2) + radial[2] * r2.powi(3);
                let xd = x * bent + 2.0 * p[0] * x * y + p[1] * (r2 + 2.0 * x * x);
                let yd = y * bent + p[0] * (r2 + 2.0 * y * y) + 2.0 * p[1] * x * y;
                Vector2::new(k[(0, 0)] * xd + k[(0, 2)] - 1.0, k[(1, 1)] * yd + k[(1, 2)] - 1.0)
            };
            let (apart, told) = (apart(c, seen), out.losses[n].max_px);
            println!("matlab {k1}: {apart:.2e} px, told {told:.2e}");
            assert!(apart < 1e-6 + 1.05 * told, "{apart} {told}");
            assert_eq!(told < 1e-6, exact, "{told}");
            assert!(told < 0.2 && (exact || apart > 0.3 * told), "{apart} {told}");
        }
    }
}

/// The `imgcoord` and `trafo` of OpenPTV on the numbers of its two files; pixels less half of one.
fn openptv_pixel(ori: &[f64], addpar: &[f64], size: [usize; 2], pitch: f64, point: &Vector3<f64>) -> Vector2<f64> {
    let d = [point.x - ori[0], point.y - ori[1], point.z - ori[2]];
    let along = |column: usize| (0..3).map(|row| ori[6 + 3 * row + column] * d[row]).sum::<f64>();
    let (xh, yh, cc) = (ori[15], ori[16], ori[17]);
    let (x, y) = (xh - cc * along(0) / along(2), yh - cc * along(1) / along(2));
    let [k1, k2, k3, p1, p2, scale, shear] = addpar[..7] else { panic!("{addpar:?}") };
    let r2 = x * x + y * y;
    let more = k1 * r2 + k2 * r2 * r2 + k3 * r2 * r2 * r2;
    let xd = x + x * more + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y;
    let yd = y + y * more + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y;
    let (xa, ya) = (scale * xd - shear.sin() * yd, shear.cos() * yd);
    Vector2::new(0.5 * size[0] as f64 + xa / pitch - 0.5, 0.5 * size[1] as f64 - ya / pitch - 0.5)
}

fn numbers_of(text: &str) -> Vec<f64> {
    text.split_whitespace().map(|x| x.parse().unwrap()).collect()
}

#[test]
fn openptv_sees_world_points_where_the_cameras_do() {
    for (k1, exact) in [(0.0, true), (-0.15, false)] {
        let record = record_of(lens(6.34, k1), lens(-6.34, -0.7 * k1));
        let out = export(&record, ExportFormat::OpenPtv).unwrap();
        let files = texts(&out.result);
        for (n, c) in Cameras::of(&record).unwrap().cameras.iter().enumerate() {
            let [ori, addpar] = [0, 1].map(|k| numbers_of(&files[2 * n + k].text));
            let (apart, told) = (apart(c, |x| openptv_pixel(&ori, &addpar, SIZE, 0.00625, x)), out.losses[n].max_px);
            println!("openptv {k1}: {apart:.2e} px, told {told:.2e}");
            assert!(apart < 1e-6 + 1.05 * told, "{apart} {told}");
            assert_eq!(told < 1e-6, exact, "{told}");
            assert!(told < 0.2 && (exact || apart > 0.3 * told), "{apart} {told}");
        }
    }
}

/// Every number of the two files takes part; without decentring and shear about the axis the polynomial is the library's own.
#[test]
fn openptv_distortion_is_read_as_its_formula_says() {
    let turn = world_camera("", lens(0.0, 0.0), 20.0).cam_from_world;
    let center = turn.inverse().translation_mm;
    let d = turn.rotation.transpose() * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let rows: Vec<String> = (0..3).map(|r| format!("{} {} {}", d[(r, 0)], d[(r, 1)], d[(r, 2)])).collect();
    let cases = [
        ("0 0", "-2e-3 3e-5 4e-6 0 0 1 0", 1e-6),
        ("0.2 -0.1", "-2e-3 3e-5 4e-6 2e-5 -3e-5 1.01 0", 0.1),
        ("0.05 0.1", "1e-3 1e-5 0 1e-4 5e-5 0.99 1e-5", 0.1),
    ];
    for (axis, addpar, most) in cases {
        let ori =
            format!("{} {} {}\n0 0 0\n\n{}\n\n{axis}\n40\n\n0 0 50\n", center.x, center.y, center.z, rows.join("\n"));
        let file = |name: &str, text: &str| NamedText { name: name.into(), text: text.into() };
        let back = import(&[file("a.ori", &ori), file("a.addpar", addpar)], ImportFormat::OpenPtv, &OPTIONS).unwrap();
        let c = &Cameras::of(&back.result).unwrap().cameras[0];
        let (ori, addpar) = (numbers_of(&ori), numbers_of(addpar));
        let apart = apart(c, |x| openptv_pixel(&ori, &addpar, SIZE, 0.00625, x));
        let told = back.losses[0].max_px;
        println!("openptv {axis} {addpar:?}: {apart:.2e} px, told {told:.2e}");
        assert!(apart < 1e-6 + 1.05 * told && told < most, "{apart} {told}");
        assert!(most == 1e-6 || apart > 0.3 * told, "{apart} {told}");
    }
}
