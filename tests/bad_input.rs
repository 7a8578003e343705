//! Bad input: each kind gets its own clear message and exit code; nothing is half written.
//!
//! The real program runs on changed copies of `examples/printed`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod program;

use program::{example, spivcal};
use spivcal::detect::{DetectOptions, Disc, find_discs};
use spivcal::image::{GrayImage, Pixels};
use spivcal::pipeline::{load_image, png_bytes};
use std::path::{Path, PathBuf};
use std::process::Output;

/// A copy of the example in a folder of its own.
struct Job {
    folder: tempfile::TempDir,
}

impl Job {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for entry in std::fs::read_dir(example("printed")).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "png" || e == "toml") {
                std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
            }
        }
        Self { folder }
    }
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
    fn out(&self) -> PathBuf {
        self.path("out")
    }
    /// Changes the text of the rig file; `from` must be in it.
    fn edit(&self, from: &str, to: &str) {
        let text = std::fs::read_to_string(self.path("rig.toml")).unwrap();
        assert!(text.contains(from), "{from:?} is not in the example's rig file");
        std::fs::write(self.path("rig.toml"), text.replacen(from, to, 1)).unwrap();
    }
    /// Replaces an image by a function of it.
    fn redraw(&self, name: &str, change: impl Fn(&GrayImage) -> GrayImage) {
        let image = load_image(&self.path(name)).unwrap();
        std::fs::write(self.path(name), png_bytes(&change(&image)).unwrap()).unwrap();
    }
    fn calibrate(&self) -> Output {
        spivcal(&["calibrate", self.path("rig.toml").to_str().unwrap(), "-o", self.out().to_str().unwrap()])
    }
    /// Calibrates, and expects a refusal that writes nothing.
    #[track_caller]
    fn refused(&self, code: i32, words: &[&str]) {
        refused(&self.calibrate(), code, words);
        assert!(!self.out().exists(), "something was written");
    }
}

#[track_caller]
fn refused(output: &Output, code: i32, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    println!("{}", text.trim_end());
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stdout));
    assert_eq!(text.lines().filter(|l| l.starts_with("error: ")).count(), 1, "{text}");
    for word in words {
        assert!(text.contains(word), "{word:?} is not in: {text}");
    }
    for word in ["panicked", "RUST_BACKTRACE", "internal error", "unwrap"] {
        assert!(!text.contains(word), "{text}");
    }
}

fn samples(image: &GrayImage) -> &[u8] {
    match image.pixels() {
        Pixels::U8(p) => p,
        _ => panic!("the example has 8 bit"),
    }
}

fn mirrored(image: &GrayImage) -> GrayImage {
    let rows = samples(image).chunks(image.width());
    let pixels = rows.flat_map(|row| row.iter().rev().copied()).collect();
    GrayImage::new(Pixels::U8(pixels), image.width(), image.height()).unwrap()
}

fn cropped(image: &GrayImage, width: usize, height: usize) -> GrayImage {
    let rows = samples(image).chunks(image.width()).take(height);
    GrayImage::new(Pixels::U8(rows.flat_map(|r| &r[..width]).copied().collect()), width, height).unwrap()
}

/// The image with one disc taken away: every row is bridged from left of it to right of it.
fn without_first_disc(image: &GrayImage) -> GrayImage {
    let discs: Vec<Disc> = find_discs(&image.view(), &DetectOptions::default()).unwrap().discs;
    assert_eq!(discs.len(), 2);
    let (width, mut pixels) = (image.width(), samples(image).to_vec());
    let margin_px = 6.0;
    let e = &discs[0].edge;
    for (v, row) in pixels.chunks_mut(width).enumerate() {
        let near = |i: &usize| (e.v_px[*i] - v as f64).abs() < margin_px;
        let columns: Vec<f64> = (0..e.u_px.len()).filter(near).map(|i| e.u_px[i]).collect();
        if columns.is_empty() {
            continue;
        }
        let low = columns.iter().copied().fold(f64::INFINITY, f64::min) - margin_px;
        let high = columns.iter().copied().fold(f64::NEG_INFINITY, f64::max) + margin_px;
        let (a, b) = (low.max(0.0) as usize, (high as usize).min(width - 1));
        let (first, last) = (f64::from(row[a]), f64::from(row[b]));
        for u in a..=b {
            row[u] = (first + (last - first) * (u - a) as f64 / (b - a) as f64).round() as u8;
        }
    }
    GrayImage::new(Pixels::U8(pixels), width, image.height()).unwrap()
}

#[test]
fn missing_image() {
    let job = Job::new();
    std::fs::remove_file(job.path("v03_right.png")).unwrap();
    job.refused(2, &["v03_right.png", "no such file", "folder of the images"]);
}

/// Commands that have no --images do not speak of it.
#[test]
fn missing_image_on_the_command_line() {
    let job = Job::new();
    let image = job.path("none.png");
    let found = spivcal(&["detect", image.to_str().unwrap(), "-o", job.out().to_str().unwrap()]);
    refused(&found, 2, &["none.png", "no such file"]);
    assert!(!String::from_utf8_lossy(&found.stderr).contains("--images"));
}

/// An answer that nobody could get is no success.
#[cfg(target_os = "linux")]
#[test]
fn an_answer_that_cannot_be_written() {
    let truth = example("printed").join("truth.json");
    for more in [&[][..], &["--json"]] {
        let mut program = std::process::Command::new(env!("CARGO_BIN_EXE_spivcal"));
        program.args(["show", truth.to_str().unwrap()]).args(more);
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = program.stdout(full).output().unwrap();
        refused(&output, 2, &["standard output", "cannot be written"]);
    }
}

#[test]
fn only_the_first_page_is_read_and_said_so() {
    let job = Job::new();
    let image = load_image(&job.path("v01_left.png")).unwrap();
    let mut file = std::fs::File::create(job.path("pages.tif")).unwrap();
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
    for _ in 0..2 {
        let size = [image.width() as u32, image.height() as u32];
        encoder.write_image::<tiff::encoder::colortype::Gray8>(size[0], size[1], samples(&image)).unwrap();
    }
    let path = job.path("pages.tif");
    let found = spivcal(&["detect", path.to_str().unwrap(), "-o", job.out().to_str().unwrap()]);
    let said = String::from_utf8_lossy(&found.stderr);
    assert!(found.status.code() == Some(0) && said.contains("pages.tif: it has several pages"), "{said}");
    let found = spivcal(&["detect", path.to_str().unwrap(), "-o", job.out().to_str().unwrap(), "--quiet"]);
    assert_eq!((found.status.code(), String::from_utf8_lossy(&found.stderr).as_ref()), (Some(0), ""));
}

#[test]
fn missing_rig_file() {
    let job = Job::new();
    std::fs::remove_file(job.path("rig.toml")).unwrap();
    job.refused(2, &["rig.toml", "no such file", "rig file"]);
}

#[test]
fn truncated_image() {
    let job = Job::new();
    let bytes = std::fs::read(job.path("v02_left.png")).unwrap();
    std::fs::write(job.path("v02_left.png"), &bytes[..bytes.len() / 2]).unwrap();
    job.refused(2, &["v02_left.png", "cut short"]);
}

#[test]
fn file_without_content_and_file_that_is_no_image() {
    let job = Job::new();
    std::fs::write(job.path("v02_left.png"), b"").unwrap();
    job.refused(2, &["v02_left.png", "empty (0 bytes)"]);
    std::fs::write(job.path("v02_left.png"), b"u,v\n1,2\n").unwrap();
    job.refused(2, &["v02_left.png", "not an image"]);
}

#[test]
fn wrong_size() {
    let job = Job::new();
    job.redraw("v04_right.png", |i| cropped(i, 1000, 760));
    job.refused(2, &["v04_right.png", "1000 x 760", "1024 x 768", "\"right\"", "one size"]);
}

#[test]
fn image_of_one_grey() {
    let job = Job::new();
    job.redraw("v01_left.png", |i| {
        GrayImage::new(Pixels::U8(vec![90; i.width() * i.height()]), i.width(), i.height()).unwrap()
    });
    job.refused(3, &["v01_left.png", "found 0 disc(s)", "needs 2"]);
    let image = job.path("v01_left.png");
    let found = spivcal(&["detect", image.to_str().unwrap(), "-o", job.out().to_str().unwrap()]);
    refused(&found, 3, &["v01_left.png", "found 0 disc(s)", "exposure"]);
    assert!(!job.out().exists());
}

/// Discs that were all turned down are drawn, so that it can be seen why.
#[test]
fn discs_that_are_too_slim() {
    let job = Job::new();
    job.redraw("v01_left.png", squeezed);
    job.refused(3, &["v01_left.png", "found 0 disc(s)", "2 too slim", "turn the target more towards this camera"]);
    let image = job.path("v01_left.png");
    let found = spivcal(&["detect", image.to_str().unwrap(), "-o", job.out().to_str().unwrap()]);
    refused(&found, 3, &["v01_left.png", "found 0 disc(s)", "2 too slim", "turn the target", "shows where"]);
    assert!(job.out().join("v01_left_overlay.png").exists());
}

/// Every sixth column, on a ground as in the first.
fn squeezed(image: &GrayImage) -> GrayImage {
    let (width, height, view) = (image.width(), image.height(), image.view());
    let grey = |i: usize| {
        let (u, v) = (i % width, i / width);
        view.get(if u < width / 6 { 6 * u } else { (u % 6).min(width - 1) }, v) as u8
    };
    GrayImage::new(Pixels::U8((0..width * height).map(grey).collect()), width, height).unwrap()
}

#[test]
fn one_disc_only() {
    let job = Job::new();
    job.redraw("v03_left.png", without_first_disc);
    job.refused(3, &["v03_left.png", "found 1 disc(s)", "needs 2"]);
}

#[test]
fn one_view_only() {
    let job = Job::new();
    let text = std::fs::read_to_string(job.path("rig.toml")).unwrap();
    let second = text.match_indices("[[view]]").nth(1).unwrap().0;
    std::fs::write(job.path("rig.toml"), &text[..second]).unwrap();
    job.refused(3, &["1 usable view(s)", "record the target in more positions"]);
}

#[test]
fn one_position_three_times() {
    let job = Job::new();
    let text = std::fs::read_to_string(job.path("rig.toml")).unwrap();
    let fourth = text.match_indices("[[view]]").nth(3).unwrap().0;
    std::fs::write(job.path("rig.toml"), &text[..fourth]).unwrap();
    for (view, side) in [(2, "left"), (3, "left"), (2, "right"), (3, "right")] {
        std::fs::copy(job.path(&format!("v01_{side}.png")), job.path(&format!("v0{view}_{side}.png"))).unwrap();
    }
    job.refused(3, &["view 0, camera \"left\" (v01_left.png) and view 1, camera \"left\"", "one picture", "own image"]);
}

#[test]
fn one_picture_under_two_names() {
    let job = Job::new();
    std::fs::copy(job.path("v02_right.png"), job.path("v05_right.png")).unwrap();
    job.refused(3, &["view 1, camera \"right\" (v02_right.png)", "view 4, camera \"right\" (v05_right.png)"]);
}

#[test]
fn mirrored_camera() {
    let job = Job::new();
    for view in 1..=6 {
        job.redraw(&format!("v{view:02}_right.png"), mirrored);
    }
    job.refused(3, &["mirror"]);
}

#[test]
fn cameras_exchanged_in_one_view() {
    let job = Job::new();
    job.edit("left = \"v03_left.png\"", "left = \"v03_right.png\"");
    job.edit("right = \"v03_right.png\"", "right = \"v03_left.png\"");
    job.refused(3, &["seem to be exchanged in view(s) 2 (counted from 0)"]);
}

#[test]
fn a_tilted_view_marked_as_in_the_sheet() {
    let job = Job::new();
    job.edit("right = \"v03_right.png\"\nsheet = false", "right = \"v03_right.png\"\nsheet = true");
    job.refused(
        3,
        &["are not in one plane", "against view 2, view 5 is tilted by 28.", "counted from 0", "put there by hand"],
    );
}

#[test]
fn wrong_polarity_is_named() {
    let job = Job::new();
    job.edit("polarity = \"dark\"", "polarity = \"bright\"");
    job.refused(3, &["v01_left.png", "are found with polarity = \"dark\""]);
}

#[test]
fn wrong_polarity_is_named_where_discs_alone_are_looked_for() {
    let job = Job::new();
    let (image, out) = (job.path("v01_left.png"), job.out());
    let arguments = ["detect", image.to_str().unwrap(), "-o", out.to_str().unwrap(), "--polarity", "bright"];
    refused(&spivcal(&arguments), 3, &["v01_left.png", "2 disc(s) are found with --polarity dark"]);
}

/// A camera of 10 bit fills a hundredth of a file of 16.
#[test]
fn ten_bits_in_sixteen_are_not_taken_for_darkness() {
    let deep = |i: &GrayImage, level: &dyn Fn(u16) -> u16| {
        let pixels = samples(i).iter().map(|g| level(u16::from(*g))).collect();
        GrayImage::new(Pixels::U16(pixels), i.width(), i.height()).unwrap()
    };
    let job = Job::new();
    job.edit("polarity = \"dark\"", "polarity = \"bright\"");
    job.redraw("v01_left.png", |i| deep(i, &|g| 88 + 2 * g));
    job.refused(3, &["v01_left.png", "are found with polarity = \"dark\""]);
    // Noise alone, as far as it may reach.
    job.redraw("v01_left.png", |i| {
        let mut at = 1_u64;
        let noise = (0..i.width() * i.height()).map(|_| {
            at = at.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            100 + (0..8).map(|k| (at >> (40 + 2 * k)) as u16 & 7).sum::<u16>()
        });
        GrayImage::new(Pixels::U16(noise.collect()), i.width(), i.height()).unwrap()
    });
    job.refused(3, &["v01_left.png", "all its grey values lie between 1", "nothing is to be seen"]);
}

#[test]
fn a_dark_image_is_named_as_dark() {
    let job = Job::new();
    job.redraw("v03_left.png", |i| {
        let pixels = samples(i).iter().map(|g| g % 3).collect();
        GrayImage::new(Pixels::U8(pixels), i.width(), i.height()).unwrap()
    });
    job.refused(3, &["v03_left.png", "grey values lie between 0 and 2", "shutter"]);
}

/// What a calibration says of itself, and how it ended.
fn told(job: &Job) -> (i32, String) {
    let out = job.calibrate();
    let said = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    (out.status.code().unwrap(), said.split_whitespace().collect::<Vec<_>>().join(" "))
}

#[test]
fn overexposed_images_are_told() {
    let job = Job::new();
    for image in ["v02_left.png", "v05_right.png"] {
        job.redraw(image, |i| {
            let pixels = samples(i).iter().map(|g| (1.7 * f64::from(*g)) as u8).collect();
            GrayImage::new(Pixels::U8(pixels), i.width(), i.height()).unwrap()
        });
    }
    let (_, said) = told(&job);
    assert!(said.contains("2 images have pixels about the discs at the end of the scale"), "{said}");
    assert!(said.contains("reduce the exposure"), "{said}");
}

#[test]
fn an_image_distance_that_no_lens_has_is_told() {
    let job = Job::new();
    job.edit("pixel_pitch_mm = 0.00625", "pixel_pitch_mm = 0.005");
    let (code, said) = told(&job);
    assert!(code == 1 && said.contains("camera left: an image distance of 44."), "{said}");
    assert!(said.contains("binned") && !said.contains("camera right: an image distance"), "{said}");
}

#[test]
fn a_flagged_calibration_stays_flagged_when_it_is_shown() {
    let job = Job::new();
    job.edit("pixel_pitch_mm = 0.00625", "pixel_pitch_mm = 0.005");
    assert_eq!(told(&job).0, 1);
    let shown = spivcal(&["show", job.out().join("calibration.json").to_str().unwrap()]);
    assert_eq!(shown.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&shown.stderr).contains("image distance"));
}

#[test]
fn overlays_of_an_earlier_run_are_told() {
    let job = Job::new();
    assert_eq!(told(&job).0, 0);
    let text = std::fs::read_to_string(job.path("rig.toml")).unwrap();
    let fifth = text.find("[[view]]\nleft = \"v05").unwrap();
    let sixth = text.find("[[view]]\nleft = \"v06").unwrap();
    std::fs::write(job.path("rig.toml"), format!("{}{}", &text[..fifth], &text[sixth..])).unwrap();
    let (_, said) = told(&job);
    assert!(
        said.contains("Of an earlier run, and of other images: overlay_05_left.png, overlay_05_right.png"),
        "{said}"
    );
}

#[test]
fn nan_in_the_rig_file() {
    let job = Job::new();
    job.edit("pixel_pitch_mm = 0.00625", "pixel_pitch_mm = nan");
    job.refused(2, &["rig.toml:3: ", "pixel_pitch_mm", "nan", "expected"]);
}

#[test]
fn unknown_key() {
    let job = Job::new();
    job.edit("focal_length_mm", "focal_lenght_mm");
    job.refused(2, &["rig.toml:4: ", "focal_lenght_mm", "did you mean \"focal_length_mm\"?"]);
}

#[test]
fn contradictory_target() {
    let job = Job::new();
    job.edit("spacing_mm = 26.0", "spacing_mm = 26.0\nradii_mm = [16.0, 12.0]");
    job.refused(2, &["rig.toml:15: ", "overlap"]);
    job.edit("radii_mm = [16.0, 12.0]", "[scale]\nbaseline_mm = 707.0");
    job.refused(2, &["rig.toml:16: ", "[target] spacing_mm", "already"]);
}

#[test]
fn a_place_that_cannot_be_written_to() {
    let job = Job::new();
    std::fs::write(job.out(), "mine").unwrap();
    let image = job.path("v01_left.png");
    let found = spivcal(&["detect", image.to_str().unwrap(), "-o", job.out().to_str().unwrap()]);
    refused(&found, 2, &["out", "cannot be made"]);
    assert_eq!(std::fs::read_to_string(job.out()).unwrap(), "mine");
    // Before the work, and before what else is wrong.
    let out = job.out();
    let out = out.to_str().unwrap();
    let found = spivcal(&["simulate", "--preset", "printed", "-o", out]);
    refused(&found, 2, &["this folder for the results cannot be made", "is a file; name another place with -o"]);
    let found = spivcal(&["convert", "--to", "csv", "none.json", "-o", out]);
    refused(&found, 2, &["this folder for the results cannot be made", "is a file; name another place with -o"]);
}

#[test]
fn results_of_before_stay_when_a_later_run_fails() {
    let job = Job::new();
    let image = job.path("v01_left.png");
    let out = job.out();
    let arguments = ["detect", image.to_str().unwrap(), "-o", out.to_str().unwrap()];
    assert_eq!(spivcal(&arguments).status.code(), Some(0));
    let listing = |folder: &Path| {
        let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let (names, csv) = (listing(&job.out()), std::fs::read(job.out().join("v01_left_discs.csv")).unwrap());
    assert!(names.len() >= 5, "{names:?}");
    std::fs::write(&image, b"broken").unwrap();
    refused(&spivcal(&arguments), 2, &["not an image"]);
    assert_eq!(listing(&job.out()), names);
    assert_eq!(std::fs::read(job.out().join("v01_left_discs.csv")).unwrap(), csv);
}

#[test]
fn arguments_that_are_no_arguments() {
    for (arguments, words) in [
        (&["calibrte"][..], "calibrate"),
        (&["calibrate", "rig.toml"][..], "--output"),
        (&["detect", "-o", "x"][..], "IMAGE"),
        (&["simulate", "--preset", "nonsense", "-o", "x"][..], "printed"),
        (&["show", "--threads", "0", "x"][..], "--threads"),
        (
            &["detect", "a.png", "-o", "x", "--threads", "100000"][..],
            "threads = 100000 is not allowed: expected at most 1024",
        ),
    ] {
        let output = spivcal(arguments);
        refused(&output, 2, &[words]);
    }
    assert_eq!(spivcal(&["--version"]).status.code(), Some(0));
    assert_eq!(spivcal(&["--help"]).status.code(), Some(0));
}

#[test]
fn a_calibration_that_is_none() {
    let job = Job::new();
    std::fs::write(job.path("c.json"), "{ \"format\": \"other\" }").unwrap();
    refused(&spivcal(&["show", job.path("c.json").to_str().unwrap()]), 2, &["c.json:1: ", "spivcal-calibration"]);
    std::fs::write(job.path("s.toml"), "[[camera]]\nname = nan\n").unwrap();
    let found = spivcal(&["simulate", job.path("s.toml").to_str().unwrap(), "-o", job.out().to_str().unwrap()]);
    refused(&found, 2, &["s.toml:"]);
    assert!(!job.out().exists());
    // A scene that can be rendered, but not calibrated: two facts would set its scale.
    let printed = spivcal::simulate::preset_text("printed").unwrap();
    let told = printed.replace("scale = \"target\"", "scale = \"baseline\"\nradii_known = true");
    assert_ne!(told, printed);
    std::fs::write(job.path("s.toml"), told).unwrap();
    let found = spivcal(&["simulate", job.path("s.toml").to_str().unwrap(), "-o", job.out().to_str().unwrap()]);
    refused(
        &found,
        2,
        &["s.toml: ", "a rig.toml would come that is refused", "sets the scale already", "change [rig]"],
    );
    assert!(!job.out().exists());
}

/// A file and an image that do not fit into the memory that the process may have: told as such, and not as a broken file.
#[cfg(unix)]
#[test]
fn images_beyond_the_memory_are_told_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, file_bytes: u64, header: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, header).unwrap();
        std::fs::File::options().write(true).open(&path).unwrap().set_len(file_bytes).unwrap();
        let limited = "ulimit -v 600000 && exec \"$@\"";
        let (program, out) = (env!("CARGO_BIN_EXE_spivcal"), folder.path().join("out"));
        let command = ["-c", limited, "sh", program, "--threads", "1", "detect"];
        std::process::Command::new("sh").args(command).arg(&path).arg("-o").arg(&out).output().unwrap()
    };
    let size = 30_000u32;
    let pgm = format!("P5 {size} {size} 255\n");
    let words = ["there is no memory for reading the image", "large.pgm, 9000000"];
    refused(&run("large.pgm", 900_000_000 + pgm.len() as u64, pgm.as_bytes()), 2, &words);
    // 24 bit, of which the decoder makes 300 MB beside the 300 MB of the file.
    let fields = [300_000_054u32, 0, 54, 40, 10_000, 10_000, 24 << 16 | 1].map(u32::to_le_bytes);
    let bmp = [b"BM".to_vec(), fields.concat(), vec![0; 24]].concat();
    let words = ["there is no memory for decoding the image", "large.bmp of 10000 x 10000 px"];
    refused(&run("large.bmp", 300_000_054, &bmp), 2, &words);
}
