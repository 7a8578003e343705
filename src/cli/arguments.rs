//! Commands and options.

use crate::detect::Smoke;
use crate::dewarp::Kernel;
use crate::reconstruct::{FieldUnit, OVERLAP, Reference};
use crate::target::Polarity;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Stereo PIV calibration directly in the laser sheet.
#[derive(Debug, Parser)]
#[command(name = "spivcal", version, about, after_help = EXIT_CODES, arg_required_else_help = true)]
pub(super) struct Arguments {
    #[command(subcommand)]
    pub(super) command: Command,
    /// Print nothing but errors and warnings
    #[arg(long, short, global = true)]
    pub(super) quiet: bool,
    /// Print a summary for programs (JSON) instead of one for people
    #[arg(long, global = true)]
    pub(super) json: bool,
    /// Threads to use; results do not depend on it [default: all processors]
    #[arg(long, value_name = "N", global = true)]
    pub(super) threads: Option<NonZeroUsize>,
}

const EXIT_CODES: &str = "Exit codes: 0 done; 1 done, but flagged (see the warnings); 2 bad input; \
                          3 not enough or degenerate data; 4 internal error";

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// The main job: images to calibration, report and overlays
    Calibrate(Calibrate),
    /// Find discs in images: contours, ellipses and features as CSV and JSON, overlay PNG
    Detect(Detect),
    /// Find the laser plane alone from views recorded in it, with the cameras of a calibration held
    Sheet(Sheet),
    /// Check the laser sheet on particle images of both cameras, and correct it
    Check(Check),
    /// Rectify images on a grid of the laser sheet that both cameras see (TIFF with scale and origin)
    Dewarp(Dewarp),
    /// Two planar displacement fields to three components with standard deviations
    Reconstruct(Reconstruct),
    /// Render synthetic images with their truth, and a rig file ready to calibrate
    Simulate(Simulate),
    /// Say a calibration in words
    Show(Show),
    /// Write a calibration for another package, or read one of another package
    Convert(Convert),
}

impl Command {
    /// Commands whose whole purpose is what they print are not silenced by `--quiet`.
    pub(super) fn answers_on_stdout(&self) -> bool {
        matches!(self, Command::Show(_))
    }
}

#[derive(Debug, Args)]
pub(super) struct Calibrate {
    /// Rig file: cameras, target, scale and views
    #[arg(value_name = "RIG.toml")]
    pub(super) rig: PathBuf,
    /// Folder for the results, made where it is missing
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Folder of the images [default: that of the rig file]
    #[arg(long, value_name = "DIR")]
    pub(super) images: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(super) struct Sheet {
    /// Rig file: the cameras, the target, and the views with sheet = true
    #[arg(value_name = "RIG.toml")]
    pub(super) rig: PathBuf,
    /// Calibration of these cameras
    #[arg(long, value_name = "C.json")]
    pub(super) calibration: PathBuf,
    /// Folder for the results, made where it is missing
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Folder of the images [default: that of the rig file]
    #[arg(long, value_name = "DIR")]
    pub(super) images: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(super) struct Detect {
    /// Images (PNG, TIFF, BMP, PGM, JPEG)
    #[arg(required = true, value_name = "IMAGE")]
    pub(super) images: Vec<PathBuf>,
    /// Folder for the results, made where it is missing
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Whether the discs are brighter or darker than what is around them
    #[arg(long, value_enum, default_value_t = PolarityWord::Auto)]
    pub(super) polarity: PolarityWord,
    /// Bright discs are known to be full of smoke (bubbles cut by the sheet, up to 24 in an image): sigmas hold for weak smoke behind a blur and for fast or slow smoke in large discs, too
    #[arg(long, conflicts_with = "printed")]
    pub(super) smoke: bool,
    /// Bright discs are known to be printed, without any smoke: few of them, or one, tell a blur that is no Gaussian's (a lens out of focus)
    #[arg(long)]
    pub(super) printed: bool,
}

impl Detect {
    /// What is known of the light of bright discs.
    pub(super) fn light(&self) -> Smoke {
        match (self.smoke, self.printed) {
            (true, _) => Smoke::Full,
            (_, true) => Smoke::None,
            _ => Smoke::Maybe,
        }
    }
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum PolarityWord {
    Auto,
    Bright,
    Dark,
}

impl From<PolarityWord> for Polarity {
    fn from(word: PolarityWord) -> Self {
        match word {
            PolarityWord::Auto => Polarity::Auto,
            PolarityWord::Bright => Polarity::Bright,
            PolarityWord::Dark => Polarity::Dark,
        }
    }
}

#[derive(Debug, Args)]
pub(super) struct Check {
    /// A calibration.json with two cameras
    #[arg(value_name = "C.json")]
    pub(super) calibration: PathBuf,
    /// Images of the first and of the second camera: two patterns with * and ?, in quotes; sorted by name they are pairs
    #[arg(long, required = true, num_args = 2, value_names = ["L*.tif", "R*.tif"])]
    pub(super) pairs: Vec<String>,
    /// What a shell makes of patterns without quotes
    #[arg(hide = true)]
    pub(super) unquoted: Vec<String>,
    /// Folder for the results, made where it is missing
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Correct the sheet and write the corrected calibration.json
    #[arg(long)]
    pub(super) refine: bool,
    /// Correct the cameras, too, by what no sheet explains, as far as the calibration's covariance allows
    #[arg(long, requires = "refine")]
    pub(super) refine_cameras: bool,
    /// Masks of both cameras, of the size of their images: where a mask is 0 (black), nothing is measured in any image (a model, a wall, reflections)
    #[arg(long, num_args = 2, value_names = ["LEFT", "RIGHT"])]
    pub(super) masks: Option<Vec<PathBuf>>,
    /// Take the mean of all images of a camera off each: walls and reflections stand still, particles do not
    #[arg(long)]
    pub(super) subtract_mean: bool,
    /// Side of a window of the disparity map, px of the dewarped image
    #[arg(long, value_name = "PX", default_value_t = 64)]
    pub(super) window_px: usize,
    /// Largest offset of the light that is looked for, mm [default: a tenth of the field]
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    pub(super) search_mm: Option<f64>,
    /// Start from the plane of the target of this view instead of the calibration's sheet; its frame is that of the target
    #[arg(long, value_name = "N")]
    pub(super) plane_of_view: Option<usize>,
}

#[derive(Debug, Args)]
pub(super) struct Dewarp {
    /// A calibration.json with a laser sheet
    #[arg(value_name = "C.json")]
    pub(super) calibration: PathBuf,
    /// Images (PNG, TIFF, BMP, PGM, JPEG)
    #[arg(required = true, value_name = "IMAGE")]
    pub(super) images: Vec<PathBuf>,
    /// Folder for the results, made where it is missing
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Camera of all these images [default: the one whose name is a word of the file's name]
    #[arg(long, value_name = "NAME")]
    pub(super) camera: Option<String>,
    /// Interpolation between pixels
    #[arg(long, value_enum, default_value_t = KernelWord::BSpline)]
    pub(super) kernel: KernelWord,
    /// Side of a pixel of the result, mm [default: the finest that a camera has in the common field]
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    pub(super) mm_per_px: Option<f64>,
    /// Field in the sheet frame, mm [default: the field that all cameras see]
    #[arg(long, value_name = "XMIN,YMIN,XMAX,YMAX", value_parser = four_numbers, allow_hyphen_values = true)]
    pub(super) extent_mm: Option<[f64; 4]>,
    /// Plane parallel to the sheet; positive towards the first camera
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    pub(super) z_mm: f64,
    /// Write 32-bit floats whatever the depth of the images
    #[arg(long)]
    pub(super) float: bool,
}

/// Four numbers with commas between.
fn four_numbers(text: &str) -> Result<[f64; 4], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse::<f64>()).collect();
    let four = numbers.ok().and_then(|n| <[f64; 4]>::try_from(n).ok());
    four.ok_or_else(|| "expected four numbers with commas between, such as -20,-15,20,15".into())
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum KernelWord {
    Nearest,
    Linear,
    Cubic,
    Lanczos,
    BSpline,
}

impl From<KernelWord> for Kernel {
    fn from(word: KernelWord) -> Self {
        match word {
            KernelWord::Nearest => Kernel::Nearest,
            KernelWord::Linear => Kernel::Linear,
            KernelWord::Cubic => Kernel::Cubic,
            KernelWord::Lanczos => Kernel::Lanczos,
            KernelWord::BSpline => Kernel::BSpline,
        }
    }
}

#[derive(Debug, Args)]
pub(super) struct Reconstruct {
    /// A calibration.json with two cameras and a laser sheet
    #[arg(value_name = "C.json")]
    pub(super) calibration: PathBuf,
    /// Displacements seen by the first camera (CSV, or a text export of OpenPIV or PIVlab)
    #[arg(value_name = "LEFT.csv")]
    pub(super) left: PathBuf,
    /// Displacements seen by the second camera
    #[arg(value_name = "RIGHT.csv")]
    pub(super) right: PathBuf,
    /// CSV file for the result
    #[arg(short, long, value_name = "OUT")]
    pub(super) output: PathBuf,
    /// Unit of both fields [default: what their headers say]
    #[arg(long, value_enum)]
    pub(super) unit: Option<UnitWord>,
    /// The dewarp.json of the images whose fields these are: displacements are then in their pixels
    #[arg(long, value_name = "dewarp.json")]
    pub(super) dewarped: Option<PathBuf>,
    /// Where on its path a planar vector belongs
    #[arg(long, value_enum, default_value_t = ReferenceWord::Center)]
    pub(super) reference: ReferenceWord,
    /// Standard deviation of one component of a planar vector, in the unit of the fields [default: estimated from the residuals]
    #[arg(long, value_name = "S", allow_hyphen_values = true)]
    pub(super) sigma: Option<f64>,
    /// Part of a window that its neighbour shares: errors of vectors go together as far (0.5: windows of 32 px every 16 px)
    #[arg(long, value_name = "PART", default_value_t = OVERLAP, allow_hyphen_values = true)]
    pub(super) overlap: f64,
    /// Distance of the vectors of the result, mm; at least a tenth of that of the fields [default: that of the finer field]
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    pub(super) spacing_mm: Option<f64>,
    /// Leave the calibration's covariance out of the result
    #[arg(long)]
    pub(super) no_calibration_sigma: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum UnitWord {
    /// Pixels of the raw images
    Px,
    /// Pixels of dewarped images (with --dewarped)
    Dewarped,
    /// mm in the sheet
    Mm,
}

impl From<UnitWord> for FieldUnit {
    fn from(word: UnitWord) -> Self {
        match word {
            UnitWord::Px => FieldUnit::RawPixels,
            UnitWord::Dewarped => FieldUnit::DewarpedPixels,
            UnitWord::Mm => FieldUnit::Millimetres,
        }
    }
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum ReferenceWord {
    /// The middle (central differences)
    Center,
    /// The beginning (windows fixed in the first frame)
    Start,
}

impl From<ReferenceWord> for Reference {
    fn from(word: ReferenceWord) -> Self {
        match word {
            ReferenceWord::Center => Reference::Center,
            ReferenceWord::Start => Reference::Start,
        }
    }
}

#[derive(Debug, Args)]
pub(super) struct Simulate {
    /// Scene file
    #[arg(value_name = "SCENE.toml", required_unless_present = "preset", conflicts_with = "preset")]
    pub(super) scene: Option<PathBuf>,
    /// A scene that comes with the program; its scene.toml is written beside the images
    #[arg(long, value_name = "NAME", value_parser = clap::builder::PossibleValuesParser::new(crate::simulate::PRESETS.map(|(n, _)| n)))]
    pub(super) preset: Option<String>,
    /// Folder for the images, made where it is missing
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
}

#[derive(Debug, Args)]
pub(super) struct Show {
    /// A calibration.json
    #[arg(value_name = "C.json")]
    pub(super) calibration: PathBuf,
}

#[derive(Debug, Args)]
pub(super) struct Convert {
    /// A calibration.json (with --to), or the other package's files (with --from)
    #[arg(required = true, value_name = "FILE")]
    pub(super) files: Vec<PathBuf>,
    /// Format to write
    #[arg(long, value_enum, value_name = "FORMAT", required_unless_present = "from", conflicts_with = "from")]
    pub(super) to: Option<ToFormat>,
    /// Format to read; a calibration.json is written
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub(super) from: Option<FromFormat>,
    /// Folder for the results [default: the current one]
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Size of the images, where the files do not say it
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    pub(super) image_size: Option<[usize; 2]>,
    /// Size of a pixel in mm, where the files do not say it
    #[arg(long, value_name = "MM", value_parser = pitch)]
    pub(super) pixel_pitch_mm: Option<f64>,
    /// Place the sheet frame on the target of a view: its origin and x axis, laid into the sheet (with --to)
    #[arg(long, value_name = "N", conflicts_with_all = ["origin_mm", "turn_deg", "from"])]
    pub(super) frame_of_view: Option<usize>,
    /// Place the origin of the sheet frame at this point of the present one (with --to)
    #[arg(long, value_name = "X,Y", value_parser = two_numbers, allow_hyphen_values = true, conflicts_with = "from")]
    pub(super) origin_mm: Option<[f64; 2]>,
    /// Turn the axes of the sheet frame, counter-clockwise as the first camera sees them (with --to)
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, conflicts_with = "from")]
    pub(super) turn_deg: Option<f64>,
    /// Degrees of Soloff's polynomials in x and y (2 or 3) and in z (1 or 2) [default: 3,2]
    #[arg(long, value_name = "XY,Z", value_parser = two_degrees, conflicts_with = "from")]
    pub(super) soloff_degrees: Option<[usize; 2]>,
}

/// Two numbers with a comma between.
fn two_numbers(text: &str) -> Result<[f64; 2], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse::<f64>()).collect();
    let two = numbers.ok().and_then(|n| <[f64; 2]>::try_from(n).ok()).filter(|n| n.iter().all(|x| x.is_finite()));
    two.ok_or_else(|| "expected two numbers in mm with a comma between, such as 12.5,-3".into())
}

/// Two whole numbers with a comma between.
fn two_degrees(text: &str) -> Result<[usize; 2], String> {
    let numbers: Result<Vec<usize>, _> = text.split(',').map(|n| n.trim().parse::<usize>()).collect();
    let two = numbers.ok().and_then(|n| <[usize; 2]>::try_from(n).ok());
    two.ok_or_else(|| "expected the degree in x and y and that in z, such as 3,2".into())
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ToFormat {
    /// A calibration.json of this program, its sheet frame placed anew
    Spivcal,
    /// OpenCV file storage (YAML), 14 coefficients
    Opencv,
    /// The same as XML
    OpencvXml,
    /// OpenPTV .ori and .addpar
    Openptv,
    /// MATLAB .mat with plain matrices
    Matlab,
    /// Coefficients of Soloff's polynomials (text, one file per camera)
    Soloff,
    /// Tables: cameras, sheet, views, covariance
    Csv,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum FromFormat {
    /// OpenCV file storage (YAML or XML)
    Opencv,
    /// OpenPTV .ori, with the .addpar beside it
    Openptv,
    /// DaVis Calibration.xml or MarkPositionTable.xml
    Davis,
    /// UVMAT XML, one per camera
    Uvmat,
}

fn image_size(text: &str) -> Result<[usize; 2], String> {
    let parts: Vec<Option<usize>> =
        text.split('x').map(|p| p.parse().ok().filter(|n| (1..=100_000).contains(n))).collect();
    match parts[..] {
        [Some(w), Some(h)] => Ok([w, h]),
        _ => Err("expected width x height in px, as 1024x768".into()),
    }
}

fn pitch(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x: &f64| *x > 0.0 && *x < 1.0).ok_or_else(|| "expected mm, as 0.00645".into())
}
