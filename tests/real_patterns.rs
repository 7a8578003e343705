//! Patterns on real images of others: every dot must get the label that perspective demands.

#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)]

use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};
use spivcal::detect::pattern::{Labelling, label_discs};
use spivcal::detect::{DetectOptions, Detection, find_discs};
use spivcal::image::{GrayImage, Pixels};
use spivcal::target::{DotId, Grid, Mark, MarkKind, Plate, Target};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where the images of others are; `None`, loudly, where they are not.
fn real_images() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let dir = std::env::var_os("SPIVCAL_REAL_IMAGES").map_or(beside, PathBuf::from);
    if dir.is_dir() {
        return Some(dir);
    }
    eprintln!("SKIPPED: no real images in {} (set SPIVCAL_REAL_IMAGES)", dir.display());
    None
}

fn load(path: &Path) -> GrayImage {
    let image = image::open(path).unwrap();
    let (w, h) = (image.width() as usize, image.height() as usize);
    let pixels = match image {
        image::DynamicImage::ImageLuma16(i) => Pixels::U16(i.into_raw()),
        other => Pixels::U8(other.into_luma8().into_raw()),
    };
    GrayImage::new(pixels, w, h).unwrap()
}

struct Seen {
    detection: Detection,
    labelling: Labelling,
    /// Ellipse centre by label, px.
    at: BTreeMap<DotId, Vector2<f64>>,
}

fn see(path: &Path, target: &Target) -> Result<Seen, spivcal::Error> {
    let image = load(path);
    let name = path.file_name().unwrap().to_string_lossy().into_owned();
    let detection = find_discs(&image.view(), &DetectOptions::default())?;
    let labelling = label_discs(&name, &detection, target)?;
    let at = labelling
        .discs
        .iter()
        .map(|d| {
            let c = detection.discs[d.disc].ellipse.center_px;
            (d.id, Vector2::new(c.u_px, c.v_px))
        })
        .collect();
    println!(
        "{name}: {} discs, {} shapes, {} labelled, {} left over, {} alternatives {:?}",
        detection.discs.len(),
        detection.shapes.len(),
        labelling.discs.len(),
        labelling.left_over.len(),
        labelling.alternatives.len(),
        labelling.warnings
    );
    dump(&name, &detection, &labelling);
    Ok(Seen { detection, labelling, at })
}

/// For eyes: writes labels as text where SPIVCAL_DUMP names a folder.
fn dump(name: &str, detection: &Detection, labelling: &Labelling) {
    let Some(dir) = std::env::var_os("SPIVCAL_DUMP") else { return };
    let mut text = String::new();
    for d in &labelling.discs {
        let e = detection.discs[d.disc].ellipse;
        text += &format!("L {} {} {} {} {}\n", e.center_px.u_px, e.center_px.v_px, d.id.column, d.id.row, d.id.level);
    }
    for k in &labelling.left_over {
        let e = detection.discs[*k].ellipse;
        text += &format!("X {} {}\n", e.center_px.u_px, e.center_px.v_px);
    }
    for r in &detection.rejections {
        text += &format!("R {} {} {:?}\n", r.center_px.u_px, r.center_px.v_px, r.reason);
    }
    for s in &detection.shapes {
        text += &format!("S {} {} {:?}\n", s.center_px.u_px, s.center_px.v_px, s.mark);
    }
    std::fs::write(Path::new(&dir).join(format!("{name}.txt")), text).unwrap();
}

/// Normalising map of points: centroid to 0, mean distance to 1.
fn normaliser(p: &[Vector2<f64>]) -> Matrix3<f64> {
    let mean: Vector2<f64> = p.iter().sum::<Vector2<f64>>() / p.len() as f64;
    let s = p.len() as f64 / p.iter().map(|x| (x - mean).norm()).sum::<f64>();
    Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0)
}

/// Homography from pairs of points (DLT, normalised), and the largest and rms distance it leaves, px of the second.
fn homography(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> (Matrix3<f64>, f64, f64) {
    let (a, b) = (normaliser(from), normaliser(to));
    let mut m = DMatrix::<f64>::zeros(2 * from.len(), 9);
    for (k, (p, q)) in from.iter().zip(to).enumerate() {
        let (p, q) = (a * p.push(1.0), b * q.push(1.0));
        for i in 0..3 {
            m[(2 * k, i)] = p[i];
            m[(2 * k, 6 + i)] = -q.x * p[i];
            m[(2 * k + 1, 3 + i)] = p[i];
            m[(2 * k + 1, 6 + i)] = -q.y * p[i];
        }
    }
    let eigen = (m.transpose() * m).symmetric_eigen();
    let v = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let h = b.try_inverse().unwrap() * Matrix3::from_row_slice(v.into_owned().as_slice()) * a;
    let misses: Vec<f64> = from.iter().zip(to).map(|(p, q)| (mapped(&h, p) - q).norm()).collect();
    let rms = (misses.iter().map(|x| x * x).sum::<f64>() / misses.len() as f64).sqrt();
    (h, misses.iter().copied().fold(0.0, f64::max), rms)
}

fn mapped(h: &Matrix3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    let q: Vector3<f64> = h * p.push(1.0);
    q.xy() / q.z
}

fn label_position(id: &DotId) -> Vector2<f64> {
    Vector2::new(f64::from(id.column), f64::from(id.row))
}

/// Largest and rms miss of the dots of one level against one homography of their labels, px.
fn level_misses(seen: &Seen, level: u8) -> (f64, f64) {
    let of_level: Vec<_> = seen.at.iter().filter(|(id, _)| id.level == level).collect();
    let from: Vec<_> = of_level.iter().map(|(id, _)| label_position(id)).collect();
    let to: Vec<_> = of_level.iter().map(|(_, p)| **p).collect();
    let (_, largest, rms) = homography(&from, &to);
    (largest, rms)
}

/// Largest miss between two images of one plane, dots joined by their labels, px of the second.
fn pair_miss(a: &Seen, b: &Seen, level: u8) -> (usize, f64) {
    let common: Vec<_> =
        a.at.iter().filter(|(id, _)| id.level == level).filter_map(|(id, p)| Some((*p, *b.at.get(id)?))).collect();
    let (from, to): (Vec<_>, Vec<_>) = common.iter().copied().unzip();
    (common.len(), homography(&from, &to).1)
}

/// Target x to the right of y as seen from the front: the homography from labels (y up) to the image (v down) flips.
fn is_seen_from_the_front(seen: &Seen) -> bool {
    let level: Vec<_> = seen.at.iter().filter(|(id, _)| id.level == 0).collect();
    let from: Vec<_> = level.iter().map(|(id, _)| label_position(id)).collect();
    let to: Vec<_> = level.iter().map(|(_, p)| **p).collect();
    let (h, _, _) = homography(&from, &to);
    let at = |x: f64, y: f64| mapped(&h, &(from[0] + Vector2::new(x, y)));
    (at(0.1, 0.0) - at(0.0, 0.0)).perp(&(at(0.0, 0.1) - at(0.0, 0.0))) < 0.0
}

fn id(column: i32, row: i32, level: u8) -> DotId {
    DotId { column, row, level }
}

fn rings(x: i32, y: i32) -> Target {
    let ring = |column, row| Mark { kind: MarkKind::Ring, at: id(column, row, 0) };
    Target::DotGrid(Grid {
        spacing_mm: None,
        columns: None,
        rows: None,
        radius_mm: None,
        marks: vec![ring(0, 0), ring(x, 0), ring(0, y)],
    })
}

#[test]
fn printed_plate_with_three_rings() {
    let Some(dir) = real_images() else { return };
    for view in [1, 2, 3, 5, 7] {
        let path = |camera: usize| dir.join(format!("dice_calb/CalB-sys2-{view:04}_{camera}.jpeg"));
        let seen = [0, 1].map(|camera| see(&path(camera), &rings(5, 3)).unwrap());
        for s in &seen {
            let (largest, rms) = level_misses(s, 0);
            println!("   homography: largest {largest:.2} px, rms {rms:.2} px");
            assert!(s.labelling.alternatives.is_empty() && is_seen_from_the_front(s));
            assert!(largest < 5.0, "{largest}");
            assert!(s.labelling.discs.len() >= 70, "{}", s.labelling.discs.len());
            assert!(s.labelling.discs.len() * 10 >= s.detection.discs.len() * 9);
        }
        let (common, miss) = pair_miss(&seen[0], &seen[1], 0);
        println!("   {common} dots in both cameras, largest miss {miss:.2} px");
        assert!(common >= 60 && miss < 5.0, "{common} {miss}");
    }
}

#[test]
fn rendered_plates_dark_and_bright() {
    let Some(dir) = real_images() else { return };
    for pose in ["00", "10", "20"] {
        let seen = [0, 1].map(|c| see(&dir.join(format!("dice_rendered/dot_{pose}_{c}.jpeg")), &rings(9, 5)).unwrap());
        for s in &seen {
            let (largest, rms) = level_misses(s, 0);
            println!("   homography: largest {largest:.2} px, rms {rms:.2} px");
            assert!(largest < 3.0 && s.labelling.discs.len() >= 100 && is_seen_from_the_front(s), "{largest}");
        }
        let (common, miss) = pair_miss(&seen[0], &seen[1], 0);
        assert!(common >= 80 && miss < 3.0, "{common} {miss}");
    }
    for pose in ["00", "03", "06", "09"] {
        let s = see(&dir.join(format!("dice_rendered/white_dot_{pose}.jpeg")), &rings(9, 5)).unwrap();
        let (largest, rms) = level_misses(&s, 0);
        println!("   homography: largest {largest:.2} px, rms {rms:.2} px");
        assert!(largest < 3.0 && s.labelling.discs.len() >= 100 && is_seen_from_the_front(&s), "{largest}");
    }
}

#[test]
fn small_grid_with_a_large_corner_dot() {
    let Some(dir) = real_images() else { return };
    let target = Target::DotGrid(Grid {
        spacing_mm: Some(25.4),
        columns: Some(10),
        rows: Some(10),
        radius_mm: None,
        marks: vec![Mark { kind: MarkKind::Large, at: id(0, 0, 0) }],
    });
    for n in [0, 1, 3, 5, 7, 9, 11, 13] {
        let s = see(&dir.join(format!("industrial_10x10/{n}.png")), &target).unwrap();
        let (largest, rms) = level_misses(&s, 0);
        println!("   homography: largest {largest:.2} px, rms {rms:.2} px");
        assert!(largest < 3.0 && s.labelling.alternatives.is_empty() && is_seen_from_the_front(&s), "{n}: {largest}");
        assert!(s.labelling.discs.len() >= 95, "{n}: {}", s.labelling.discs.len());
        assert!(s.at.keys().all(|i| (0..10).contains(&i.column) && (0..10).contains(&i.row)));
    }
}

#[test]
fn two_level_plate_of_the_piv_challenge() {
    let Some(dir) = real_images() else { return };
    let target = Target::TwoLevelPlate(Plate {
        spacing_mm: 15.0,
        step_mm: 3.0,
        radius_mm: Some(1.6),
        marks: vec![
            Mark { kind: MarkKind::Square, at: id(-4, -1, 0) },
            Mark { kind: MarkKind::Triangle, at: id(-3, -2, 1) },
        ],
    });
    let mut seen = BTreeMap::new();
    for camera in [1, 3] {
        for z in [1, 4, 7] {
            let s = see(&dir.join(format!("pivchallenge4E/E_camera_{camera}_z_{z}.png")), &target).unwrap();
            for level in 0..2 {
                let (largest, rms) = level_misses(&s, level);
                println!("   level {level}: homography: largest {largest:.2} px, rms {rms:.2} px");
                assert!(largest < 6.0, "{largest}");
            }
            assert!(s.labelling.alternatives.is_empty(), "{:?}", s.labelling.warnings);
            assert!(is_seen_from_the_front(&s) && s.labelling.left_over.len() <= 4);
            seen.insert((camera, z), s);
        }
    }
    // A step of 3 mm along the sheet normal moves no dot by half of its way to the next label.
    for (camera, z) in [(1, 1), (1, 4), (3, 1), (3, 4)] {
        let (a, b) = (&seen[&(camera, z)], &seen[&(camera, z + 3)]);
        let (p, q) = (a.at[&id(0, 0, 0)], a.at[&id(2, 0, 0)]);
        let far = a.at.iter().filter_map(|(i, x)| Some((b.at.get(i)? - x).norm())).fold(0.0, f64::max);
        println!(
            "camera {camera}, plane {z} to {}: dots move by up to {far:.1} px, pitch {:.0} px",
            z + 3,
            (q - p).norm()
        );
        assert!(far < 0.25 * (q - p).norm(), "{far}");
    }
    for level in 0..2 {
        for z in [1, 4, 7] {
            let (common, miss) = pair_miss(&seen[&(1, z)], &seen[&(3, z)], level);
            println!("z {z} level {level}: {common} dots in both cameras, largest miss {miss:.2} px");
            assert!(common >= 8 && miss < 6.0, "{common} {miss}");
        }
    }
}

#[test]
fn deep_dot_target_taken_as_one_large_grid() {
    let Some(dir) = real_images() else { return };
    let target = Target::DotGrid(Grid { spacing_mm: None, columns: None, rows: None, radius_mm: None, marks: vec![] });
    for n in 1..=3 {
        // Three depths: the largest plane is a grid, the dots of the others are left over.
        let s = see(&dir.join(format!("myptv/cal{n}.png")), &target).unwrap();
        let (largest, rms) = level_misses(&s, 0);
        println!("   homography: largest {largest:.2} px, rms {rms:.2} px");
        assert!(largest < 1.5 && s.labelling.discs.len() >= 90 && s.labelling.origin_is_arbitrary, "{largest}");
    }
}
