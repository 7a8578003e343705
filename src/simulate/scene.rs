//! The scene file: its keys, their limits, and messages that name file and line.
//!
//! What the keys mean is in `docs/simulate.md`. Every record refuses keys it does not know.

use crate::error::{Error, Invalid};
use crate::target::TargetKind as Kind;
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer};

pub(super) fn syntax(file: &str, line: usize, message: impl Into<String>) -> Error {
    Invalid::Syntax { file: file.to_owned(), line, message: message.into() }.into()
}

/// A list of just so many items; without this what is too many would be dropped in silence.
trait Exact: Sized {
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error>;
}

impl<T: DeserializeOwned, const N: usize> Exact for [T; N] {
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let list = Vec::<T>::deserialize(from)?;
        let found = list.len();
        list.try_into().map_err(|_| D::Error::custom(format!("expected a list of {N} items, found {found}")))
    }
}

impl<L: Exact> Exact for Option<L> {
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        L::read(from).map(Some)
    }
}

fn exactly<'de, D: Deserializer<'de>, L: Exact>(from: D) -> Result<L, D::Error> {
    L::read(from)
}

/// A whole scene file as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneFile {
    #[serde(default)]
    pub(super) seed: u64,
    #[serde(rename = "camera")]
    pub(super) cameras: Vec<CameraKeys>,
    #[serde(default)]
    pub(super) sheet: SheetKeys,
    pub(super) target: TargetKeys,
    #[serde(default)]
    pub(super) image: ImageKeys,
    #[serde(default, rename = "view")]
    pub(super) views: Vec<ViewKeys>,
    pub(super) random: Option<RandomKeys>,
    pub(super) particles: Option<ParticleKeys>,
    #[serde(default)]
    pub(super) rig: RigKeys,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraKeys {
    pub(super) name: String,
    #[serde(deserialize_with = "exactly")]
    pub(super) image_size_px: [usize; 2],
    pub(super) pixel_pitch_mm: Option<f64>,
    pub(super) focal_length_mm: Option<f64>,
    pub(super) f_px: Option<f64>,
    #[serde(default = "one")]
    pub(super) aspect: f64,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) axis_point_px: Option<[f64; 2]>,
    #[serde(default)]
    pub(super) scheimpflug: bool,
    pub(super) alpha_deg: Option<f64>,
    pub(super) beta_deg: Option<f64>,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) k: [f64; 3],
    #[serde(default)]
    pub(super) radial: RadialKey,
    #[serde(default = "one")]
    pub(super) pupil_ratio: f64,
    pub(super) aim: Option<AimKeys>,
    pub(super) pose: Option<PoseKeys>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum RadialKey {
    #[default]
    IdealToDistorted,
    DistortedToIdeal,
}

/// Nominal place of a camera: where it looks and from how far.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AimKeys {
    pub(super) distance_mm: f64,
    pub(super) viewing_angle_deg: f64,
    #[serde(default)]
    pub(super) elevation_deg: f64,
    #[serde(default)]
    pub(super) roll_deg: f64,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) look_at_mm: [f64; 3],
}

/// Exact place of a camera: `p_in_cam = exp(rotation_vector) p_in_bench + translation`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PoseKeys {
    #[serde(deserialize_with = "exactly")]
    pub(super) rotation_vector_deg: [f64; 3],
    #[serde(deserialize_with = "exactly")]
    pub(super) translation_mm: [f64; 3],
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SheetKeys {
    #[serde(default)]
    pub(super) offset_mm: f64,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) tilt_deg: [f64; 2],
}

/// A kind of target by its word.
fn kind<'de, D: Deserializer<'de>>(from: D) -> Result<Kind, D::Error> {
    const WORDS: [&str; 4] = [Kind::WORDS[0].0, Kind::WORDS[1].0, Kind::WORDS[2].0, Kind::WORDS[3].0];
    let word = String::deserialize(from)?;
    let known = Kind::WORDS.iter().find(|(w, _)| *w == word);
    known.map(|(_, kind)| *kind).ok_or_else(|| D::Error::unknown_variant(&word, &WORDS))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum PolarityKey {
    Bright,
    Dark,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TargetKeys {
    #[serde(deserialize_with = "kind")]
    pub(super) kind: Kind,
    pub(super) polarity: PolarityKey,
    pub(super) spacing_mm: Option<f64>,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) radii_mm: Option<[f64; 2]>,
    pub(super) radius_mm: Option<f64>,
    pub(super) columns: Option<usize>,
    pub(super) rows: Option<usize>,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) origin: [i32; 2],
    pub(super) step_mm: Option<f64>,
    #[serde(default)]
    pub(super) marks: Vec<MarkKeys>,
    #[serde(default = "default_hole")]
    pub(super) ring_hole: f64,
    #[serde(default = "default_large")]
    pub(super) large_factor: f64,
    #[serde(default)]
    pub(super) print_error_um: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum MarkWord {
    Ring,
    Large,
    Square,
    Triangle,
}

impl MarkWord {
    pub(super) fn word(self) -> &'static str {
        match self {
            MarkWord::Ring => "ring",
            MarkWord::Large => "large",
            MarkWord::Square => "square",
            MarkWord::Triangle => "triangle",
        }
    }
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MarkKeys {
    pub(super) kind: MarkWord,
    pub(super) column: i32,
    pub(super) row: i32,
    #[serde(default)]
    pub(super) level: u8,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct ImageKeys {
    pub(super) blur_sigma_px: f64,
    pub(super) bits: u32,
    pub(super) disc_level: Option<f64>,
    pub(super) ground_level: Option<f64>,
    pub(super) offset_level: f64,
    pub(super) full_well_e: Option<f64>,
    pub(super) read_noise_e: f64,
    pub(super) smoke: f64,
    pub(super) smoke_length_mm: f64,
    pub(super) unevenness: f64,
    pub(super) glare: Option<GlareKeys>,
}

impl Default for ImageKeys {
    fn default() -> Self {
        ImageKeys {
            blur_sigma_px: 0.8,
            bits: 8,
            disc_level: None,
            ground_level: None,
            offset_level: 0.01,
            full_well_e: None,
            read_noise_e: 0.0,
            smoke: 0.0,
            smoke_length_mm: 3.0,
            unevenness: 0.0,
            glare: None,
        }
    }
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GlareKeys {
    pub(super) count: usize,
    pub(super) radius_px: f64,
    pub(super) level: f64,
    #[serde(default)]
    pub(super) on: GlarePlace,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum GlarePlace {
    #[default]
    Anywhere,
    Rim,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ViewKeys {
    #[serde(default)]
    pub(super) sheet: bool,
    pub(super) plane_z_mm: Option<f64>,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) position_mm: [f64; 3],
    #[serde(default, deserialize_with = "exactly")]
    pub(super) rotation_deg: [f64; 3],
    #[serde(default, deserialize_with = "exactly")]
    pub(super) radii_mm: Option<[f64; 2]>,
    pub(super) spacing_mm: Option<f64>,
    #[serde(default)]
    pub(super) printed: bool,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RandomKeys {
    pub(super) count: usize,
    pub(super) seed: Option<u64>,
    #[serde(default)]
    pub(super) sheet_count: usize,
    #[serde(deserialize_with = "exactly")]
    pub(super) tilt_deg: [f64; 2],
    #[serde(default = "default_spin")]
    pub(super) spin_deg: f64,
    #[serde(deserialize_with = "exactly")]
    pub(super) position_mm: [f64; 3],
    #[serde(default, deserialize_with = "exactly")]
    pub(super) radii_mm: Option<[[f64; 2]; 2]>,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) spacing_mm: Option<[f64; 2]>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ParticleKeys {
    pub(super) pairs: usize,
    pub(super) per_mm2: f64,
    pub(super) thickness_mm: f64,
    #[serde(default = "default_level")]
    pub(super) level: f64,
    #[serde(default)]
    pub(super) offset_mm: f64,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) tilt_deg: [f64; 2],
    pub(super) flow: Option<FlowKeys>,
}

/// A vortex with a jet along its axis, carried by a uniform shift; displacements between two exposures.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FlowKeys {
    #[serde(default, deserialize_with = "exactly")]
    pub(super) shift_mm: [f64; 3],
    #[serde(default)]
    pub(super) vortex_mm: f64,
    #[serde(default)]
    pub(super) jet_mm: f64,
    pub(super) radius_mm: f64,
    #[serde(default, deserialize_with = "exactly")]
    pub(super) center_mm: [f64; 2],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum ScaleKey {
    Target,
    Baseline,
    ViewSpacing,
    ViewRadius,
    Traverse,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RigKeys {
    pub(super) scale: Option<ScaleKey>,
    #[serde(default)]
    pub(super) scale_view: usize,
    pub(super) scale_sigma_mm: Option<f64>,
    #[serde(default)]
    pub(super) radii_known: bool,
    pub(super) adjust: Option<String>,
    pub(super) observations: Option<String>,
    pub(super) loss: Option<String>,
    pub(super) estimate: Option<Vec<String>>,
    pub(super) focus: Option<FocusKeys>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FocusKeys {
    pub(super) tilt_sigma_deg: f64,
    pub(super) distance_sigma: f64,
}

fn one() -> f64 {
    1.0
}
fn default_level() -> f64 {
    0.5
}
fn default_hole() -> f64 {
    0.45
}
fn default_large() -> f64 {
    1.6
}
fn default_spin() -> f64 {
    180.0
}
