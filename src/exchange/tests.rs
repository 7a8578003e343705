mod slices;
mod strangers;
mod tables;
mod windows;

use super::refit::{moved, over_image};
use super::*;
use crate::camera::{Intrinsics, Radial};
use nalgebra::{Matrix3, Vector2, Vector3};

const SIZE: [usize; 2] = [1024, 768];

fn lens(tilt_deg: f64, k1: f64) -> Intrinsics {
    let mut i = Intrinsics::pinhole(8889.0, 515.0, 380.0);
    (i.alpha_rad, i.beta_rad, i.aspect) = (0.01, f64::to_radians(tilt_deg), 1.002);
    i.k[0] = k1;
    i
}

fn world_camera(name: &str, intrinsics: Intrinsics, angle_deg: f64) -> WorldCamera {
    // The world's z faces the cameras; each looks at its origin from 500 mm.
    let a = f64::to_radians(angle_deg);
    let turn = Matrix3::new(a.cos(), 0.0, a.sin(), 0.0, 1.0, 0.0, -a.sin(), 0.0, a.cos());
    let rotation = turn * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    WorldCamera {
        name: name.into(),
        image_size_px: SIZE,
        pixel_pitch_mm: Some(0.00625),
        camera: Camera::new(intrinsics).unwrap(),
        cam_from_world: Motion::new(rotation, Vector3::new(0.4, -0.7, 500.0)),
        loss: Loss::NONE,
        points: None,
    }
}

fn record_of(left: Intrinsics, right: Intrinsics) -> Record {
    let cameras = vec![world_camera("left", left, -45.0), world_camera("right, far", right, 45.0)];
    imported::record(Found { cameras, has_sheet: true, of_marks: false, notes: vec![], program: "test" }, &[])
        .unwrap()
        .result
}

fn texts(files: &[(String, Vec<u8>)]) -> Vec<NamedText> {
    let text = |b: &[u8]| String::from_utf8(b.to_vec()).unwrap();
    files.iter().map(|(name, bytes)| NamedText { name: name.clone(), text: text(bytes) }).collect()
}

/// Points that a camera sees on the sheet and 2 % of the distance before and behind it.
fn volume(camera: &Camera, cam_from_world: &Motion<Cam, Sheet>, size_px: [usize; 2]) -> Vec<refit::Seen> {
    let world_from_cam = cam_from_world.inverse();
    let eye = world_from_cam.translation_mm;
    over_image(size_px, |q| {
        let ray = world_from_cam.rotation * camera.ideal_of_pixel(q).unwrap().push(1.0);
        [-0.02, 0.0, 0.02].map(|part| eye + ray * ((part * eye.z.abs() - eye.z) / ray.z))
    })
}

/// Largest distance of the images that two records give of the measured volume, px, per camera.
fn gaps(a: &Record, b: &Record) -> Vec<f64> {
    let (a, b) = (Cameras::of(a).unwrap().cameras, Cameras::of(b).unwrap().cameras);
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().zip(&b);
    pairs
        .map(|(x, y)| {
            let seen = volume(&x.camera, &x.cam_from_world, SIZE);
            assert!(seen.len() > 600);
            let gap =
                |s: &refit::Seen| (y.camera.project_xyz(&y.cam_from_world.apply(&s.xyz_mm)).unwrap() - s.pixel).norm();
            seen.iter().map(gap).fold(0.0, f64::max)
        })
        .collect()
}

const OPTIONS: ImportOptions = ImportOptions { image_size_px: Some(SIZE), pixel_pitch_mm: Some(0.00625) };
/// DaVis tells the pitch, and another size of pixels would contradict it.
const OF_DAVIS: ImportOptions = ImportOptions { pixel_pitch_mm: None, ..OPTIONS };

#[test]
fn opencv_carries_the_tilted_rig_exactly() {
    let record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    for format in [ExportFormat::OpenCv, ExportFormat::OpenCvXml] {
        let out = export(&record, format).unwrap();
        assert_eq!(out.losses, vec![Loss::NONE; 2]);
        let back = import(&texts(&out.result), ImportFormat::OpenCv, &ImportOptions::default()).unwrap();
        assert!(gaps(&record, &back.result).iter().all(|g| *g < 1e-8), "{:?}", gaps(&record, &back.result));
        let names: Vec<_> = back.result.cameras.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["left", "right, far"]);
        for (x, y) in record.cameras.iter().zip(&back.result.cameras) {
            for (a, b) in x.intrinsics().to_array().iter().zip(y.intrinsics().to_array()) {
                assert!((a - b).abs() < 1e-10 * (1.0 + a.abs()), "{a} {b}");
            }
        }
        let (a, b) = (record.sheet.as_ref().unwrap(), back.result.sheet.as_ref().unwrap());
        assert!((a.distance_mm - b.distance_mm).abs() < 1e-9);
    }
}

/// What a format cannot hold is fitted, and the loss that is told is the loss that a user has.
#[test]
fn the_other_polynomial_is_refitted_with_its_loss() {
    let mut left = lens(6.34, 0.15);
    left.radial = Radial::DistortedToIdeal;
    let record = record_of(left, lens(-6.34, -0.1));
    let out = export(&record, ExportFormat::OpenCv).unwrap();
    let back = import(&texts(&out.result), ImportFormat::OpenCv, &OPTIONS).unwrap();
    let real = gaps(&record, &back.result);
    assert!(real[0] > 0.0 && real[0] < 0.01, "{real:?}");
    assert!((out.losses[0].max_px - real[0]).abs() < 1e-6, "{:?} {real:?}", out.losses);
    assert!(out.flags().is_empty());
}

#[test]
fn coefficients_that_this_library_has_not_are_refitted() {
    let record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    let mut file = texts(&export(&record, ExportFormat::OpenCv).unwrap().result).remove(0);
    let d = "rows: 14\n   cols: 1\n   dt: d\n   data: [ -0.15, 0.0, 0.0, 0.0,";
    assert!(file.text.contains(d));
    file.text = file.text.replacen(d, &d.replace("0.0, 0.0, 0.0,", "0.0, 0.002, -0.001,"), 1);
    let back = import(&[file], ImportFormat::OpenCv, &OPTIONS).unwrap();
    // Decentring is nearly a tilt; what is left is told.
    assert!(back.losses[0].max_px > 1e-6 && back.losses[0].max_px < 0.2, "{:?}", back.losses);
    assert_eq!(back.losses[1], Loss::NONE);
    assert!((back.result.cameras[0].rms_px - back.losses[0].rms_px).abs() < 1e-15);
}

#[test]
fn openptv_is_exact_without_distortion_and_honest_with_it() {
    let plain = record_of(lens(6.34, 0.0), lens(-6.34, 0.0));
    let out = export(&plain, ExportFormat::OpenPtv).unwrap();
    assert!(out.losses.iter().all(|l| l.max_px < 1e-7), "{:?}", out.losses);
    let back = import(&texts(&out.result), ImportFormat::OpenPtv, &OPTIONS).unwrap();
    assert!(gaps(&plain, &back.result).iter().all(|g| *g < 1e-6), "{:?}", gaps(&plain, &back.result));
    let bent = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    let out = export(&bent, ExportFormat::OpenPtv).unwrap();
    let back = import(&texts(&out.result), ImportFormat::OpenPtv, &OPTIONS).unwrap();
    for (k, gap) in gaps(&bent, &back.result).into_iter().enumerate() {
        assert!(gap <= out.losses[k].max_px + back.losses[k].max_px + 1e-6, "{gap} {:?} {:?}", out.losses, back.losses);
        assert!(gap < 0.1, "{gap}");
    }
}

/// The formula of OpenPTV's documentation on numbers that can be checked by hand.
#[test]
fn openptv_by_hand() {
    // A camera 100 mm above the origin, looking down (-z): image x to the right is world x, y up is world y.
    let ori = "0 0 100\n0 0 0\n\n1 0 0\n0 1 0\n0 0 1\n\n0 0\n10\n\n0 0 50\n";
    let addpar = "0 0 0 0 0 1 0\n";
    let file = |name: &str, text: &str| NamedText { name: name.into(), text: text.into() };
    let options = ImportOptions { image_size_px: Some([200, 100]), pixel_pitch_mm: Some(0.1) };
    let back = import(&[file("a.ori", ori), file("a.addpar", addpar)], ImportFormat::OpenPtv, &options).unwrap();
    let c = &Cameras::of(&back.result).unwrap().cameras[0];
    // x = 10 * 5 / 100 = 0.5 mm = 5 px right of the centre (100), minus half a pixel; y = 0.2 mm = 2 px up.
    let q = c.camera.project_xyz(&c.cam_from_world.apply(&Vector3::new(5.0, 2.0, 0.0))).unwrap();
    assert!((q - Vector2::new(104.5, 47.5)).norm() < 1e-12, "{q}");
    assert_eq!(c.name, "a");
}

const DAVIS: &str = r#"<?xml version="1.0"?>
<Calibration><CoordinateMapper CameraIdentifier="1" Type="PinholeOpenCV">
<CommonParameters><OriginalImageSize Width="1024" Height="768"/></CommonParameters>
<InternalCameraParameters><SensorPixelSizeMm Value="0.005"/><FocalLengthPixel x="50" y="50"/>
<PrincipalPoint x="500" y="400"/>
<RadialDistortion radialDistortionCoefficient1="K1" radialDistortionCoefficient2="0"/>
<TangentialDistortion tangentialDistortionCoefficient1="P1" tangentialDistortionCoefficient2="0"/></InternalCameraParameters>
<ExternalCameraParameters><TranslationMm Tx="1" Ty="2" Tz="400"/><RotationAngles Rx="3.141592653589793" Ry="0" Rz="0"/>
</ExternalCameraParameters></CoordinateMapper></Calibration>"#;

fn davis(text: &str) -> Result<Conversion<Record>> {
    let file = NamedText { name: "Calibration.xml".into(), text: text.into() };
    import(&[file], ImportFormat::DaVis, &OF_DAVIS)
}

#[test]
fn davis_pinhole_by_hand() {
    let back = davis(&DAVIS.replace("K1", "0.2").replace("P1", "0")).unwrap();
    let c = &Cameras::of(&back.result).unwrap().cameras[0];
    // Half a turn about x: (30, 20, 0) -> (31, -18, 400).
    let (x, y) = (31.0 / 400.0, -18.0 / 400.0);
    let g = 1.0 + 0.2 * (x * x + y * y);
    let q = c.camera.project_xyz(&c.cam_from_world.apply(&Vector3::new(30.0, 20.0, 0.0))).unwrap();
    assert!((q - Vector2::new(500.0 + 10_000.0 * x * g, 400.0 + 10_000.0 * y * g)).norm() < 1e-9, "{q}");
    assert_eq!(back.losses, vec![Loss::NONE]);
    assert_eq!(c.pixel_pitch_mm, Some(0.005));
    let tangential = davis(&DAVIS.replace("K1", "0.2").replace("P1", "0.001")).unwrap();
    let told = tangential.losses[0].max_px;
    assert!(told > 1e-6 && told < 1.0, "{told}");
    let c = &Cameras::of(&tangential.result).unwrap().cameras[0];
    // (10, 8, 0) -> (11, -6, 400).
    let (x, y) = (11.0 / 400.0, -6.0 / 400.0);
    let r2 = x * x + y * y;
    let (xd, yd) = (x * (1.0 + 0.2 * r2) + 0.002 * x * y, y * (1.0 + 0.2 * r2) + 0.001 * (r2 + 2.0 * y * y));
    let q = c.camera.project_xyz(&c.cam_from_world.apply(&Vector3::new(10.0, 8.0, 0.0))).unwrap();
    let gap = (q - Vector2::new(500.0 + 10_000.0 * xd, 400.0 + 10_000.0 * yd)).norm();
    assert!(gap < 1.05 * told + 1e-6, "{gap} {told}");
}

#[test]
fn davis_polynomials_are_refused_with_the_way_out() {
    let text = DAVIS.replace("PinholeOpenCV", "Polynomial3rdOrder").replace("K1", "0").replace("P1", "0");
    let message = davis(&text).unwrap_err().to_string();
    assert!(message.contains("Calibration.xml:2") && message.contains("MarkPositionTable"), "{message}");
}

/// As [`marks_with`], where they are seen.
fn marks_of(c: &WorldCamera, depths: &[f64]) -> String {
    marks_with(c, depths, |_| Vector2::zeros())
}

/// Marks of a camera, each off by what goes with its number, px.
fn marks_with(c: &WorldCamera, depths: &[f64], off: impl Fn(usize) -> Vector2<f64>) -> String {
    let mut count = 0;
    let mut out = String::from("<MarkPositionTable><Camera CameraNumber=\"1\"><View>");
    for z in depths {
        for (i, j) in (-6..=6).flat_map(|i| (-5..=5).map(move |j| (i, j))) {
            let x = Vector3::new(f64::from(i) * 4.0, f64::from(j) * 4.0, *z);
            let q = c.camera.project_xyz(&c.cam_from_world.apply(&x)).unwrap() + off(count);
            count += 1;
            out += &format!(
                "<Mark w=\"1\"><WorldPos x=\"{}\" y=\"{}\" z=\"{}\"/><RawPos x=\"{}\" y=\"{}\"/></Mark>",
                x.x, x.y, x.z, q.x, q.y
            );
        }
    }
    out + "</View></Camera></MarkPositionTable>"
}

#[test]
fn davis_marks_become_the_camera_that_saw_them() {
    let c = world_camera("c", lens(6.34, -0.15), 30.0);
    let back = davis(&marks_of(&c, &[-3.0, 0.0, 3.0])).unwrap();
    assert!(back.marks[0].max_px < 1e-5 && back.losses == [Loss::NONE], "{:?}", back.marks);
    let found = &Cameras::of(&back.result).unwrap().cameras[0];
    let x = Vector3::new(11.0, -7.0, 1.0);
    let q = |c: &WorldCamera| c.camera.project_xyz(&c.cam_from_world.apply(&x)).unwrap();
    assert!((q(&c) - q(found)).norm() < 1e-4);
    let flat = davis(&marks_of(&c, &[0.0])).unwrap_err().to_string();
    assert!(flat.contains("one plane"), "{flat}");
}

/// Measured marks scatter: that is told as what it is, and flagged where it is more than marks do.
#[test]
fn what_marks_scatter_is_no_loss() {
    let c = world_camera("c", lens(6.34, -0.15), 30.0);
    // Evenly spread directions of one length: 0.05 px of scatter is good, 0.5 px is not.
    let scatter = |length: f64| {
        move |k: usize| {
            let angle = 2.4 * k as f64;
            Vector2::new(angle.cos(), angle.sin()) * length
        }
    };
    let read = |off: &dyn Fn(usize) -> Vector2<f64>| davis(&marks_with(&c, &[-3.0, 0.0, 3.0], off)).unwrap();
    let good = read(&scatter(0.05));
    assert!((good.marks[0].rms_px - 0.05).abs() < 0.005, "{:?}", good.marks);
    assert_eq!(good.result.cameras[0].rms_px, good.marks[0].rms_px);
    assert!(good.losses == [Loss::NONE] && good.flags().is_empty(), "{:?}", good.flags());
    assert!(good.notes.iter().any(|n| n.contains("z = 0 of the marks")), "{:?}", good.notes);
    let poor = read(&scatter(0.5)).flags();
    assert!(poor.len() == 1 && poor[0].contains("its marks lie 0.") && poor[0].contains("label"), "{poor:?}");
    let one = read(&|k| Vector2::new(if k == 100 { 4.0 } else { 0.0 }, 0.0));
    assert!(one.marks[0].rms_px < MARKS_LIMIT_PX && one.flags().len() == 1, "{:?}", one.marks);
}

#[test]
fn uvmat_by_hand() {
    let xml = "<ImaDoc><GeometryCalib><CalibrationType>3D_extrinsic</CalibrationType><CoordUnit>cm</CoordUnit>\
               <fx_fy>5000 5010</fx_fy><Cx_Cy>512 384</Cx_Cy><kc>-0.3</kc><Tx_Ty_Tz>1 2 50</Tx_Ty_Tz>\
               <R>1 0 0</R><R>0 1 0</R><R>0 0 -1</R></GeometryCalib></ImaDoc>";
    let file = NamedText { name: "run/left.xml".into(), text: xml.into() };
    let back = import(&[file], ImportFormat::Uvmat, &OPTIONS).unwrap();
    let c = &Cameras::of(&back.result).unwrap().cameras[0];
    // Physical (3, 1, 0) cm -> (4, 3, 50) cm.
    let (x, y) = (4.0 / 50.0, 3.0 / 50.0);
    let g = 1.0 - 0.3 * (x * x + y * y);
    let (left, bottom) = (5000.0 * x * g + 512.0, 5010.0 * y * g + 384.0);
    // The world's z faces away or towards: the sheet's frame may be turned about x, points of y = 0 tell nothing of it.
    let flipped = if back.notes.iter().any(|n| n.contains("half a turn")) { -1.0 } else { 1.0 };
    let q = c.camera.project_xyz(&c.cam_from_world.apply(&Vector3::new(30.0, flipped * 10.0, 0.0))).unwrap();
    assert!((q - Vector2::new(left - 0.5, 767.5 - bottom)).norm() < 1e-9, "{q}");
    assert_eq!(c.name, "left");
    assert!(back.notes.iter().any(|n| n.contains("SliceCoord") && n.contains("z = 0")), "{:?}", back.notes);
}

/// One file of right-handed axes and one of left-handed ones are not of one world.
#[test]
fn uvmat_files_of_two_hands_are_refused() {
    let file = |name: &str, z: f64| NamedText {
        name: name.into(),
        text: format!(
            "<ImaDoc><GeometryCalib><CalibrationType>3D_extrinsic</CalibrationType><CoordUnit>cm</CoordUnit><fx_fy>5000 5010</fx_fy>\
             <Cx_Cy>512 384</Cx_Cy><Tx_Ty_Tz>1 2 50</Tx_Ty_Tz><R>1 0 0</R><R>0 1 0</R><R>0 0 {z}</R></GeometryCalib></ImaDoc>"
        ),
    };
    let read = |z: [f64; 2]| import(&[file("a.xml", z[0]), file("b.xml", z[1])], ImportFormat::Uvmat, &OPTIONS);
    for z in [[-1.0, 1.0], [1.0, -1.0]] {
        let message = read(z).unwrap_err().to_string();
        assert!(message.contains("b.xml") && message.contains("one world"), "{message}");
    }
}

/// The container read back byte by byte, as its specification says.
#[test]
fn matlab_file_holds_the_nearest_untilted_camera() {
    let record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    let out = export(&record, ExportFormat::Matlab).unwrap();
    let variables = matlab_variables(&out.result[0].1);
    let names: Vec<&str> = variables.iter().map(|(name, ..)| name.as_str()).collect();
    let k1 = &variables.iter().find(|(name, ..)| name == "K1").unwrap().2;
    assert_eq!(names[..6], ["imageSize1", "K1", "radial1", "tangential1", "R1", "t1"]);
    let e = record.cameras[0].effective;
    assert!((k1[0] - e.f_px).abs() < 0.02 * e.f_px && k1[8] == 1.0, "{k1:?}");
    // Tilt and distortion together have no exact untilted counterpart: the loss is told, and flagged.
    assert!(out.losses.iter().all(|l| l.max_px > LOSS_LIMIT_PX && l.max_px < 0.2), "{:?}", out.losses);
    assert_eq!(out.flags().len(), 2);
}

/// Names, sizes (rows, columns) and numbers (column by column) of a level 5 file, byte by byte.
fn matlab_variables(bytes: &[u8]) -> Vec<(String, [usize; 2], Vec<f64>)> {
    assert_eq!(&bytes[124..128], &[0, 1, b'I', b'M']);
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let (mut at, mut out) = (128, vec![]);
    while at < bytes.len() {
        assert_eq!(word(at), 14);
        let next = at + 8 + word(at + 4);
        let (rows, columns) = (word(at + 32), word(at + 36));
        let name_length = word(at + 44);
        let name = std::str::from_utf8(&bytes[at + 48..at + 48 + name_length]).unwrap().to_string();
        let data = at + 48 + name_length.div_ceil(8) * 8;
        assert_eq!((word(data), word(data + 4)), (9, 8 * rows * columns), "{name}");
        let numbers = &bytes[data + 8..data + 8 + 8 * rows * columns];
        let numbers = numbers.chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
        out.push((name, [rows, columns], numbers));
        at = next;
    }
    assert_eq!(at, bytes.len());
    out
}

#[test]
fn csv_has_every_number_and_its_sigma() {
    let mut record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    record.cameras[1].sigma.k1 = 0.25;
    record.covariance.names = vec!["left.f_px".into(), "odd,name".into()];
    record.covariance.matrix = vec![vec![4.0, 0.5], vec![0.5, f64::NAN]];
    let files = texts(&export(&record, ExportFormat::Csv).unwrap().result);
    let text = |name: &str| &files.iter().find(|f| f.name == name).unwrap().text;
    assert!(text("cameras.csv").contains("\n\"right, far\",k1,0.1,0.25,1\n"), "{}", text("cameras.csv"));
    assert_eq!(text("covariance.csv"), "name,left.f_px,\"odd,name\"\nleft.f_px,4,0.5\n\"odd,name\",0.5,\n");
    assert!(text("sheet.csv").contains("sheet,distance,"));
}

/// The text is read here as a stranger would, and compared with the exact cameras.
#[test]
fn soloff_text_maps_like_the_cameras_within_its_stated_loss() {
    let record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    let done = export(&record, ExportFormat::Soloff).unwrap();
    let files = texts(&done.result);
    let names: Vec<&str> = files.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["soloff_left.txt", "soloff_right__far.txt"]);
    let rig = Cameras::of(&record).unwrap();
    for ((file, c), loss) in files.iter().zip(&rig.cameras).zip(&done.losses) {
        let numbers = |key: &str| -> Vec<f64> {
            let line = file.text.lines().find_map(|l| l.strip_prefix(key)).unwrap();
            line.split_whitespace().map(|x| x.parse().unwrap()).collect()
        };
        assert_eq!(numbers("image_size_px"), [1024.0, 768.0]);
        let (middle, half) = (numbers("middle_mm"), numbers("half_mm"));
        let terms: Vec<Vec<f64>> = file
            .text
            .lines()
            .filter(|l| l.starts_with(|x: char| x.is_ascii_digit()))
            .map(|l| l.split(' ').map(|x| x.parse().unwrap()).collect())
            .collect();
        assert_eq!(terms.len(), 19);
        let mut largest = 0.0_f64;
        for (i, j, k) in (0..6).flat_map(|i| (0..6).flat_map(move |j| (0..3).map(move |k| (i, j, k)))) {
            let s = [f64::from(i) / 2.5 - 1.0, f64::from(j) / 2.5 - 1.0, f64::from(k) - 1.0];
            let p = Vector3::from_fn(|a, _| middle[a] + half[a] * s[a]);
            let exact = c.camera.project_xyz(&c.cam_from_world.apply(&p)).unwrap();
            let mut q = Vector2::zeros();
            for t in &terms {
                let monomial: f64 = (0..3).map(|a| s[a].powi(t[a] as i32)).product();
                q += Vector2::new(t[3], t[4]) * monomial;
            }
            largest = largest.max((q - exact).norm());
        }
        // The loss was measured at other points of the volume.
        assert!(largest < 1.05 * loss.max_px && largest > 0.3 * loss.max_px, "{largest} {loss:?}");
        assert!(loss.max_px < 0.05, "{loss:?}");
    }
    assert!(done.notes[0].contains("the polynomials hold for x"));
}

#[test]
fn what_makes_no_sense_is_refused_by_name() {
    let file = |text: &str| NamedText { name: "x.yml".into(), text: text.into() };
    let refusal = |text: &str, format| import(&[file(text)], format, &OPTIONS).unwrap_err().to_string();
    let cases = [
        ("", ImportFormat::OpenCv, "expected an OpenCV"),
        ("%YAML:1.0\n---\na: [", ImportFormat::OpenCv, "not YAML"),
        ("%YAML:1.0\n---\na: 1\n", ImportFormat::OpenCv, "M1"),
        (
            "<opencv_storage><M1 type_id=\"opencv-matrix\"><rows>3</rows><cols>3</cols><data>1 2</data></M1></opencv_storage>",
            ImportFormat::OpenCv,
            "9 numbers, found 2",
        ),
        ("%YAML:1.0\n---\na: &a [1, 1]\nb: [*a, *a]\n", ImportFormat::OpenCv, "x.yml:4: a reference"),
        ("<a", ImportFormat::DaVis, "not XML"),
        ("<a/>", ImportFormat::DaVis, "CoordinateMapper"),
        ("<a/>", ImportFormat::Uvmat, "GeometryCalib"),
        ("1 2 3", ImportFormat::OpenPtv, "no .ori file"),
    ];
    for (text, format, expected) in cases {
        let message = refusal(text, format);
        assert!(message.contains(expected), "{text}: {message}");
    }
    let ori = NamedText { name: "a.ori".into(), text: "0 0 0 nan".into() };
    let message = import(&[ori], ImportFormat::OpenPtv, &OPTIONS).unwrap_err().to_string();
    assert!(message.contains("a.ori:1") && message.contains("nan"), "{message}");
    let mut record = record_of(lens(6.34, 0.0), lens(-6.34, 0.0));
    record.cameras[0].pixel_pitch_mm = None;
    assert!(export(&record, ExportFormat::OpenPtv).unwrap_err().to_string().contains("pixel_pitch_mm"));
    record.sheet = None;
    assert!(export(&record, ExportFormat::OpenCv).unwrap_err().to_string().contains("no laser sheet"));
}

/// Marks that a broken export puts into one place, and sizes that are no numbers of pixels.
#[test]
fn marks_in_one_place_and_parts_of_a_pixel_are_refused() {
    let mark =
        |x: f64, u: f64| format!("<Mark><WorldPos x=\"{x}\" y=\"1\" z=\"1\"/><RawPos x=\"{u}\" y=\"1\"/></Mark>");
    for place in [|_| [1.0, 1.0], |k: f64| [k, 1.0], |k: f64| [1.0, k]] {
        let marks: String = (0..20).map(|k| place(f64::from(k))).map(|[x, u]| mark(x, u)).collect();
        let text =
            format!("<MarkPositionTable><Camera CameraNumber=\"1\"><View>{marks}</View></Camera></MarkPositionTable>");
        let message = davis(&text).unwrap_err().to_string();
        assert!(message.contains("in one point"), "{message}");
    }
    for (size, expected) in [(640.0, Some(640)), (640.7, None), (0.0, None), (f64::NAN, None)] {
        assert_eq!(super::storage::pixels(size), expected);
    }
}

/// Cameras called by digits, or by words that read as something else, keep their names.
#[test]
fn names_that_read_as_numbers_come_back() {
    for names in [["1", "2"], ["true", "1e3"], ["a \"b\"", "<&>"], ["007", "nan"]] {
        let mut record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
        record.cameras.iter_mut().zip(names).for_each(|(c, name)| c.name = name.into());
        for format in [ExportFormat::OpenCv, ExportFormat::OpenCvXml] {
            let out = export(&record, format).unwrap();
            let back = import(&texts(&out.result), ImportFormat::OpenCv, &ImportOptions::default()).unwrap().result;
            let found: Vec<&str> = back.cameras.iter().map(|c| c.name.as_str()).collect();
            assert_eq!(found, names, "{}", texts(&out.result)[0].text);
        }
    }
    // As a user may write it, and a size in quotes.
    let out = export(&record_of(lens(6.34, 0.0), lens(-6.34, 0.0)), ExportFormat::OpenCv).unwrap();
    let mut file = texts(&out.result).remove(0);
    file.text =
        file.text.replace("name1: \"left\"", "name1: 1").replace("image_width1: 1024", "image_width1: \"1024\"");
    let back = import(&[file], ImportFormat::OpenCv, &ImportOptions::default()).unwrap().result;
    assert_eq!((back.cameras[0].name.as_str(), back.cameras[0].image_size_px), ("1", SIZE));
}

/// A lens without distortion says so; a name that is not known is no such statement.
#[test]
fn missing_distortion_coefficients_are_refused_with_the_names() {
    let out = export(&record_of(lens(6.34, -0.15), lens(-6.34, 0.1)), ExportFormat::OpenCv).unwrap();
    let mut file = texts(&out.result).remove(0);
    file.text = file.text.replace("D2:", "dist2:");
    let message = import(&[file], ImportFormat::OpenCv, &ImportOptions::default()).unwrap_err().to_string();
    assert!(
        message.contains("no matrix D2") && message.contains("dist2") && message.contains("four zeros"),
        "{message}"
    );
}

#[test]
fn a_record_read_back_is_a_valid_file() {
    let record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    let out = export(&record, ExportFormat::OpenCv).unwrap();
    let back = import(&texts(&out.result), ImportFormat::OpenCv, &OPTIONS).unwrap().result;
    let text = back.to_json().unwrap();
    let read = Record::from_json(&text, "calibration.json").unwrap();
    assert_eq!(read.cameras.len(), 2);
    assert!(crate::report::text(&read).contains("right, far"));
    assert!(moved(&Motion::identity(), &[0.0; 6]).translation_mm.norm() == 0.0);
}

/// What is read must be a calibration that can be read again; the message names the file.
#[test]
fn impossible_calibrations_are_refused_on_import() {
    let file = |name: &str, text: &str| NamedText { name: name.into(), text: text.into() };
    let refused = |files: &[NamedText], format, words: &[&str]| {
        let options = if format == ImportFormat::DaVis { OF_DAVIS } else { OPTIONS };
        let message = import(files, format, &options).unwrap_err().to_string();
        assert!(words.iter().all(|w| message.contains(w)) && !message.contains(":0:"), "{message}");
    };
    let ori = "0 0 100\n0 0 0\n\n1 0 0\n0 1 0\n0 0 1\n\n0 0\n10\n\n0 0 50\n";
    refused(
        &[file("a/cam.ori", ori), file("b/cam.ori", ori)],
        ImportFormat::OpenPtv,
        &["a/cam.ori, b/cam.ori: ", "two cameras are called \"cam\""],
    );
    let uvmat = |t: &str| {
        format!(
            "<A><GeometryCalib><CoordUnit>mm</CoordUnit><fx_fy>1000 1000</fx_fy><Cx_Cy>500 400</Cx_Cy><Tx_Ty_Tz>{t}</Tx_Ty_Tz>\
             <R>1 0 0</R><R>0 -1 0</R><R>0 0 -1</R></GeometryCalib></A>"
        )
    };
    let ours = uvmat("0 0 400");
    assert!(import(&[file("a.xml", &ours)], ImportFormat::Uvmat, &OPTIONS).is_ok());
    refused(&[file("a/c.xml", &ours), file("b/c.xml", &ours)], ImportFormat::Uvmat, &["b/c.xml", "called \"c\""]);
    refused(
        &[file("a.xml", &uvmat("0 0 0"))],
        ImportFormat::Uvmat,
        &["a.xml: ", "sheet.distance_mm", "correct the file"],
    );
    let plain = DAVIS.replace("K1", "0").replace("P1", "0");
    let mapper = &plain[plain.find("<CoordinateMapper").unwrap()..plain.find("</Calibration>").unwrap()];
    let twice = plain.replace("</Calibration>", &format!("{mapper}</Calibration>"));
    refused(&[file("C.xml", &twice)], ImportFormat::DaVis, &["C.xml: ", "two cameras are called \"camera1\""]);
    let other = ImportOptions { image_size_px: Some([640, 480]), ..OF_DAVIS };
    let message = import(&[file("C.xml", &plain)], ImportFormat::DaVis, &other).unwrap_err().to_string();
    assert!(message.contains(" px, --image-size 640x480; leave the option out"), "{message}");
    let other = ImportOptions { pixel_pitch_mm: Some(0.01), ..OF_DAVIS };
    let message = import(&[file("C.xml", &plain)], ImportFormat::DaVis, &other).unwrap_err().to_string();
    assert!(message.contains(" mm, --pixel-pitch-mm 0.01; leave the option out"), "{message}");
    for width in ["-5", "0"] {
        let text = plain.replace("Width=\"1024\"", &format!("Width=\"{width}\""));
        refused(&[file("C.xml", &text)], ImportFormat::DaVis, &["C.xml:3: ", "expected numbers above 0"]);
    }
    let record = record_of(lens(6.34, 0.0), lens(-6.34, 0.0));
    let mut text = texts(&export(&record, ExportFormat::OpenCv).unwrap().result).remove(0);
    let fisheye = NamedText { text: text.text.replace("---\n", "---\nfisheye_model: 1\n"), ..text.clone() };
    refused(&[fisheye], ImportFormat::OpenCv, &["fisheye model"]);
    text.text = text.text.replace("right, far", "left");
    refused(&[text], ImportFormat::OpenCv, &["opencv.yml: ", "two cameras are called \"left\""]);
}
