//! Real images of others, read from `../shared/data` or the folder in `SPIVCAL_REAL_IMAGES`; never copied into the repository.
//!
//! Counts were established by looking at the pictures: every dot that is whole in the image.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod real_sets;

use real_sets::folder;
use spivcal::detect::{DetectOptions, Detection, Disc, find_discs};
use spivcal::image::{GrayImage, Pixels};
use spivcal::target::{MarkKind, Polarity};
use std::path::Path;

fn load(path: &Path) -> GrayImage {
    let decoded = image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (w, h) = (decoded.width() as usize, decoded.height() as usize);
    let pixels = match decoded {
        image::DynamicImage::ImageLuma16(b) => Pixels::U16(b.into_raw()),
        other => Pixels::U8(other.to_luma8().into_raw()),
    };
    GrayImage::new(pixels, w, h).unwrap()
}

fn find(path: &Path) -> Detection {
    find_discs(&load(path).view(), &DetectOptions::default()).unwrap()
}

fn median(mut x: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    x[x.len() / 2]
}

fn size(x: &Disc) -> f64 {
    (x.ellipse.semi_major_px * x.ellipse.semi_minor_px).sqrt()
}

/// One line of the table: what was found in an image.
fn row(name: &str, d: &Detection) {
    let rms = median(d.discs.iter().map(Disc::edge_rms_px).collect());
    let sigma = median(d.discs.iter().map(|x| x.covariance[(0, 0)].sqrt()).collect());
    let blur = median(d.discs.iter().map(|x| x.blur_px).collect());
    println!(
        "{name:42} discs {:4}  edge rms {rms:.3} px  sigma of the centre {sigma:.4} px  blur {blur:.2} px",
        d.discs.len()
    );
}

fn rings(d: &Detection) -> usize {
    d.discs.iter().filter(|x| x.mark == Some(MarkKind::Ring)).count()
}

/// Image and dots in it that do not reach the border (the same by an independent count of thresholded blobs).
const DICE: [(&str, usize); 10] = [
    ("0001_0", 80),
    ("0001_1", 80),
    ("0002_0", 80),
    ("0002_1", 80),
    ("0003_0", 82),
    ("0003_1", 88),
    ("0005_0", 82),
    ("0005_1", 88),
    ("0007_0", 82),
    ("0007_1", 87),
];

/// Image, polarity and dots that do not reach the border, counted on overlays.
const RENDERED: [(&str, Polarity, usize); 10] = [
    ("dot_00_0", Polarity::Dark, 129),
    ("dot_00_1", Polarity::Dark, 131),
    ("dot_10_0", Polarity::Dark, 129),
    ("dot_10_1", Polarity::Dark, 121),
    ("dot_20_0", Polarity::Dark, 126),
    ("dot_20_1", Polarity::Dark, 122),
    ("white_dot_00", Polarity::Bright, 129),
    ("white_dot_03", Polarity::Bright, 127),
    ("white_dot_06", Polarity::Bright, 130),
    ("white_dot_09", Polarity::Bright, 140),
];

/// Camera and plane, dots that do not reach the border, counted on overlays.
const PLATE: [(&str, usize); 6] =
    [("1_z_1", 61), ("1_z_4", 61), ("1_z_7", 61), ("3_z_1", 28), ("3_z_4", 28), ("3_z_7", 24)];

#[test]
fn dice_printed_plate() {
    let Some(folder) = folder("dice_calb") else { return };
    for (name, count) in DICE {
        let d = find(&folder.join(format!("CalB-sys2-{name}.jpeg")));
        row(name, &d);
        assert_eq!((d.discs.len(), rings(&d)), (count, 3), "{name}");
        assert!(d.discs.iter().all(|x| x.polarity == Polarity::Dark));
        assert!(median(d.discs.iter().map(Disc::edge_rms_px).collect()) < 0.4);
    }
}

#[test]
fn dice_rendered_plates() {
    let Some(folder) = folder("dice_rendered") else { return };
    for (name, polarity, count) in RENDERED {
        let d = find(&folder.join(format!("{name}.jpeg")));
        row(name, &d);
        assert_eq!((d.discs.len(), rings(&d)), (count, 3), "{name}");
        assert!(d.discs.iter().all(|x| x.polarity == polarity));
    }
}

#[test]
fn two_level_plate() {
    let Some(folder) = folder("pivchallenge4E") else { return };
    for (name, count) in PLATE {
        let d = find(&folder.join(format!("E_camera_{name}.png")));
        row(name, &d);
        let typical = median(d.discs.iter().map(size).collect());
        let dots = d.discs.iter().filter(|x| size(x) > 0.7 * typical && size(x) < 1.4 * typical).count();
        assert_eq!(dots, count, "{name}");
        // A reflection on the plate is now and then as round as a small disc.
        assert!(d.discs.len() <= count + 1, "{name}: {} discs", d.discs.len());
        let of = |kind| d.shapes.iter().filter(|s| s.mark == kind).count();
        assert_eq!((of(MarkKind::Square), of(MarkKind::Triangle)), (1, 1), "{name}");
        assert!(d.discs.iter().all(|x| x.polarity == Polarity::Bright));
    }
}

#[test]
fn grid_held_by_a_robot() {
    let Some(folder) = folder("industrial_10x10") else { return };
    for name in ["0", "1", "3", "5", "7", "9", "11", "13"] {
        let d = find(&folder.join(format!("{name}.png")));
        row(name, &d);
        let typical = median(d.discs.iter().map(size).collect());
        let dots = d.discs.iter().filter(|x| size(x) > 0.7 * typical && size(x) < 1.4 * typical).count();
        let large = d.discs.iter().filter(|x| size(x) > 1.6 * typical && size(x) < 2.6 * typical).count();
        // 99 dots and the large one; letters beside them may look like a dot, but few do.
        assert!((99..=103).contains(&dots), "{name}: {dots} dots");
        assert_eq!(large, 1, "{name}");
    }
}

#[test]
fn small_weak_dots() {
    let Some(folder) = folder("myptv") else { return };
    for (name, blobs) in [("cal1", "cam1_cal_points"), ("cal2", "cam2_cal_points"), ("cal3", "cam3_cal_points")] {
        let d = find(&folder.join(format!("{name}.png")));
        row(name, &d);
        let text = std::fs::read_to_string(folder.join(blobs)).unwrap();
        let known: Vec<(f64, f64)> = text
            .lines()
            .filter_map(|l| {
                let mut n = l.split_whitespace().map_while(|x| x.parse::<f64>().ok());
                Some((n.next()?, n.next()?))
            })
            .collect();
        let at = |x: &Disc, p: &(f64, f64)| (x.ellipse.center_px.u_px - p.0).hypot(x.ellipse.center_px.v_px - p.1);
        let nearest: Vec<f64> =
            known.iter().map(|p| d.discs.iter().map(|x| at(x, p)).fold(f64::INFINITY, f64::min)).collect();
        let found: Vec<f64> = nearest.into_iter().filter(|x| *x < 2.0).collect();
        println!(
            "{name}: {} of {} published dots, median distance {:.2} px",
            found.len(),
            known.len(),
            median(found.clone())
        );
        assert!(found.len() * 10 > known.len() * 6, "{name}: {} of {}", found.len(), known.len());
        // What is found beside the dots must stay rare.
        assert!(d.discs.len() < found.len() + known.len() / 10, "{name}");
    }
}

#[test]
fn sixteen_bit_tiff() {
    let Some(folder) = folder("format_samples") else { return };
    let options = DetectOptions { min_semi_minor_px: 1.0, ..DetectOptions::default() };
    let image = load(&folder.join("tiff16_fluidimage_tomo_0mm_cam0.tif"));
    let d = find_discs(&image.view(), &options).unwrap();
    // Synthetic blobs of three pixels: seen, but too small to be measured as discs; all are named.
    println!("fluidimage: {} discs, {} turned down", d.discs.len(), d.rejections.len());
    assert_eq!(d.discs.len() + d.rejections.len(), 81);
}
