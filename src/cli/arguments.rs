//! Commands and options.

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
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ToFormat {
    /// OpenCV file storage (YAML), 14 coefficients
    Opencv,
    /// The same as XML
    OpencvXml,
    /// OpenPTV .ori and .addpar
    Openptv,
    /// MATLAB .mat with plain matrices
    Matlab,
    /// Tables of everything
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
