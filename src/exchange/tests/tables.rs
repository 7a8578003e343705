//! What tables say of poses, against steps of the pose itself.

use super::*;
use crate::rigid::STEP_NAMES;
use nalgebra::{SMatrix, SVector};

#[test]
fn poses_have_the_sigmas_that_the_covariance_gives_them() {
    let mut record = record_of(lens(6.34, -0.15), lens(-6.34, 0.1));
    // A covariance of full rank with correlations: A A^T.
    let a = SMatrix::<f64, 6, 6>::from_fn(|i, j| {
        let size = if i < 3 { 1e-4 } else { 2e-2 };
        size * (((7 * i + 3 * j + i * j) % 11) as f64 / 5.0 - 1.0 + f64::from(u8::from(i == j)))
    });
    let c = a * a.transpose();
    let prefixes = ["right, far.cam_from_rig", "sheet.rig_from_sheet"];
    record.covariance.names = prefixes.iter().flat_map(|p| STEP_NAMES.map(|s| format!("{p}.{s}"))).collect();
    record.covariance.matrix =
        (0..12).map(|i| (0..12).map(|j| if i / 6 == j / 6 { c[(i % 6, j % 6)] } else { 0.0 }).collect()).collect();
    record.sheet.as_mut().unwrap().sigma.normal_rad = [1e-3, 2e-3];
    let files = texts(&export(&record, ExportFormat::Csv).unwrap().result);
    let sigma = |file: &str, start: &str| -> Option<f64> {
        let text = &files.iter().find(|f| f.name == file).unwrap().text;
        let line = text.lines().find(|l| l.starts_with(start)).unwrap_or_else(|| panic!("{start}: {text}"));
        line.rsplit(',').nth(1).unwrap().parse().ok()
    };
    let sheet = record.sheet.clone().unwrap();
    for (file, owner, pose) in [
        ("cameras.csv", "\"right, far\",cam_from_rig", record.cameras[1].cam_from_rig.motion::<Cam, Rig>()),
        ("sheet.csv", "sheet,rig_from_sheet", sheet.rig_from_sheet.motion::<Cam, Rig>()),
    ] {
        // Columns of A are independent steps of sigma 1; central differences of the motion they make.
        let h = 1e-3;
        let spread = |of: &dyn Fn(&Motion<Cam, Rig>) -> f64| {
            let by = |k: usize| {
                let step: SVector<f64, 6> = a.column(k) * h;
                (of(&pose.retract(&step)) - of(&pose.retract(&-step))) / (2.0 * h)
            };
            (0..6).map(|k| by(k).powi(2)).sum::<f64>().sqrt()
        };
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            let expected = spread(&|m| m.rotation[(i, j)]);
            let found = sigma(file, &format!("{owner}.r{}{},", i + 1, j + 1)).unwrap();
            assert!((found - expected).abs() < 1e-6 * expected + 1e-12, "{owner} {i} {j}: {found} {expected}");
            if j == 2 && file == "sheet.csv" {
                let found = sigma(file, &format!("sheet,normal_{},", ["x", "y", "z"][i])).unwrap();
                assert!((found - expected).abs() < 1e-6 * expected + 1e-12, "normal {i}: {found} {expected}");
            }
        }
        for (i, axis) in ["tx", "ty", "tz"].iter().enumerate() {
            let expected = spread(&|m| m.translation_mm[i]);
            let found = sigma(file, &format!("{owner}.{axis},")).unwrap();
            assert!(
                (found - expected).abs() < 1e-6 * expected && expected > 1e-3,
                "{owner} {axis}: {found} {expected}"
            );
        }
    }
    assert_eq!(sigma("sheet.csv", "sheet,turn_y,"), Some(2e-3));
    // The first camera is the frame; without a covariance nothing is known.
    assert_eq!(sigma("cameras.csv", "left,cam_from_rig.tx,"), Some(0.0));
    record.covariance = Default::default();
    let files = texts(&export(&record, ExportFormat::Csv).unwrap().result);
    assert!(files[0].text.contains("left,cam_from_rig.tx,0,,mm"), "{}", files[0].text);
}
