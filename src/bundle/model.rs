//! What is adjusted: cameras, target, views, observations; constant during a solve.

use super::facts::Fact;
use super::tie::Tie;
use crate::camera::{INTRINSICS, LAYERS};
use crate::conic::CommonNoise;
use crate::detect::{Disc, EdgePoints};
use nalgebra::{DMatrix, Vector2, Vector3};

/// One camera of the adjustment.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraModel {
    /// Name for messages.
    pub name: String,
    /// Which intrinsics are adjusted, in the order of [`crate::camera::INTRINSIC_NAMES`].
    pub free: [bool; INTRINSICS],
    /// The window before it.
    pub window: Option<WindowModel>,
    /// Adjusted along these intrinsics themselves, even where the pinhole chart could be used: what is held in one is not held in the other.
    pub axis_frame: bool,
}

/// The flat window before a camera (see [`crate::camera::Window`]); its direction is always adjusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowModel {
    /// Which layers are adjusted, in the order of [`crate::camera::LAYER_NAMES`].
    pub free: [bool; LAYERS],
    /// Where they start, or are held.
    pub layers: [f64; LAYERS],
}

impl CameraModel {
    /// True where the pinhole chart is used: f and both tilts are free.
    pub(crate) fn uses_pinhole_frame(&self) -> bool {
        !self.axis_frame && self.free[0] && self.free[4] && self.free[5]
    }

    /// The same camera with further intrinsics free, in the frame that it has.
    pub(crate) fn freed(mut self, parameters: impl IntoIterator<Item = usize>) -> Self {
        self.axis_frame = !self.uses_pinhole_frame();
        parameters.into_iter().for_each(|p| self.free[p] = true);
        self
    }

    /// The intrinsic that a coordinate of the chart stands for, where it does for one that may be held.
    pub(crate) fn intrinsic_of(&self, coordinate: usize) -> usize {
        if self.uses_pinhole_frame() && matches!(coordinate, 4 | 5) { coordinate - 2 } else { coordinate }
    }
}

/// Lattice place of a disc in units of the pitch, and whether it lies on the back level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Along target x, in pitches.
    pub x: f64,
    /// Along target y, in pitches.
    pub y: f64,
    /// 0 front; 1 back, one step behind (target z = -step).
    pub level: f64,
}

/// How the discs of a target follow from its three shape parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum TargetShape {
    /// Disc 0 at the origin, disc 1 at (spacing, 0, 0); shape = (spacing, radius 0, radius 1).
    Pair {
        /// True where every view has a shape of its own (drifting bubbles).
        per_view: bool,
    },
    /// Discs at lattice nodes; shape = (pitch, radius, step).
    Lattice(Vec<Node>),
}

/// The target of the adjustment.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetModel {
    /// Its discs.
    pub shape: TargetShape,
    /// Which of the three shape parameters are adjusted.
    pub free: [bool; 3],
    /// Standard deviations of disc offsets `(dx, dy, dz, dr)`, mm, where every disc is estimated.
    pub offset_sigma_mm: Option<[f64; 4]>,
    /// Standard deviation of the ovality (a, b) of each of two printed discs, mm, where it is estimated; set by the adjustment.
    pub oval_sigma_mm: Option<f64>,
}

impl TargetModel {
    /// Number of discs.
    pub fn disc_count(&self) -> usize {
        match &self.shape {
            TargetShape::Pair { .. } => 2,
            TargetShape::Lattice(nodes) => nodes.len(),
        }
    }
    /// True where the shape belongs to the views.
    pub fn per_view(&self) -> bool {
        matches!(self.shape, TargetShape::Pair { per_view: true })
    }
    /// Shape parameters that are radii and held.
    pub fn held_radii(&self) -> impl Iterator<Item = usize> + '_ {
        let radii = if matches!(self.shape, TargetShape::Pair { .. }) { 1..3 } else { 1..2 };
        radii.filter(|k| !self.free[*k])
    }
    /// Centre and radius of disc `j` without offsets, mm, for shape parameters `tau`.
    pub fn nominal_disc(&self, j: usize, tau: &[f64; 3]) -> (Vector3<f64>, f64) {
        match &self.shape {
            TargetShape::Pair { .. } if j == 0 => (Vector3::zeros(), tau[1]),
            TargetShape::Pair { .. } => (Vector3::new(tau[0], 0.0, 0.0), tau[2]),
            TargetShape::Lattice(nodes) => {
                let n = nodes[j];
                (Vector3::new(n.x * tau[0], n.y * tau[0], -n.level * tau[2]), tau[1])
            }
        }
    }
    /// Nominal places of all discs about their middle, over the largest coordinate, and that, mm.
    pub(super) fn spread(&self, tau: &[f64; 3]) -> (Vec<Vector2<f64>>, f64) {
        let at: Vec<_> = (0..self.disc_count()).map(|j| self.nominal_disc(j, tau).0.xy()).collect();
        let middle = at.iter().sum::<Vector2<f64>>() / at.len() as f64;
        let half_mm = at.iter().map(|p| (p - middle).amax()).fold(1e-9, f64::max);
        (at.iter().map(|p| (p - middle) / half_mm).collect(), half_mm)
    }
    /// Derivative of (X, Y, Z, R) of disc `j` by the shape parameters, one row of three each.
    pub(super) fn disc_derivative(&self, j: usize) -> [[f64; 3]; 4] {
        match &self.shape {
            TargetShape::Pair { .. } if j == 0 => [[0.0; 3], [0.0; 3], [0.0; 3], [0.0, 1.0, 0.0]],
            TargetShape::Pair { .. } => [[1.0, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0, 0.0, 1.0]],
            TargetShape::Lattice(nodes) => {
                let n = nodes[j];
                [[n.x, 0.0, 0.0], [n.y, 0.0, 0.0], [0.0, 0.0, -n.level], [0.0, 1.0, 0.0]]
            }
        }
    }
}

/// Where a view's target is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ViewPlace {
    /// Anywhere.
    Free,
    /// Parallel to the common plane, in front of it (0: in the sheet).
    InPlane {
        /// Position along the plane's normal, mm.
        z_mm: f64,
        /// How well the position is known.
        known: PlanePosition,
    },
}

/// How well a position along the common plane's normal is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlanePosition {
    /// Exactly.
    Exact,
    /// With this standard deviation, mm; it is estimated.
    About {
        /// Standard deviation, mm.
        sigma_mm: f64,
    },
    /// Not at all: it is estimated, and `z_mm` is meaningless.
    Unknown,
}

impl ViewPlace {
    /// Whether the target is parallel to the common plane.
    pub fn in_plane(&self) -> bool {
        matches!(self, ViewPlace::InPlane { .. })
    }
    /// Whether its position along the plane's normal is estimated.
    pub fn moves_along_normal(&self) -> bool {
        matches!(self, ViewPlace::InPlane { known: PlanePosition::About { .. } | PlanePosition::Unknown, .. })
    }
    /// Steps of a pose that are adjusted inside the plane: turn about its normal, shifts along it, and where it is estimated
    /// the position along the normal.
    pub(super) fn planar_steps(&self) -> &'static [usize] {
        if self.moves_along_normal() { &[2, 3, 4, 5] } else { &[2, 3, 4] }
    }
}

/// One view: a moment at which the cameras saw the target at one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewModel {
    /// Where the target is.
    pub place: ViewPlace,
}

/// The contour of one disc in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscObservation {
    /// Index of the disc in the target.
    pub disc: usize,
    /// Its edge points.
    pub edge: EdgePoints,
    /// What these have in common, by what was uncertain of blur and light.
    pub common: CommonNoise,
    /// What they have in common beyond that where the printed disc is not round; set by the adjustment.
    pub outline: CommonNoise,
    /// What it has in common with the disc's contours in other images; set by the adjustment.
    pub(super) tie: Option<Box<Tie>>,
}

impl DiscObservation {
    /// Independent edge points of an outline that is round as far as is known.
    pub fn new(disc: usize, edge: EdgePoints) -> Self {
        Self { disc, edge, common: CommonNoise::default(), outline: CommonNoise::default(), tie: None }
    }

    /// The contour of a disc of an image.
    pub fn of(disc: usize, found: &Disc) -> Self {
        Self { common: found.common_noise(), ..Self::new(disc, found.edge.clone()) }
    }

    /// How many numbers the edge points say.
    pub fn count(&self) -> usize {
        self.edge.u_px.len() - self.common.forgotten()
    }

    /// Whitens a matrix given by its rows over the sigmas of the edge points, for all that these have in common.
    pub(super) fn whiten<const N: usize>(&self, rows: &mut [[f64; N]]) {
        self.common.apply(rows);
        self.outline.apply(rows);
    }

    /// Whether the edge points are independent.
    pub(super) fn independent(&self) -> bool {
        self.common.is_none() && self.outline.is_none() && self.tie.is_none()
    }
}

/// The tangent features of a pair of discs in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct PairObservation {
    /// Indices of the two discs in the target, in the order in which the features were made.
    pub discs: [usize; 2],
    /// Features used, by their index in the order of [`crate::bitangent`].
    pub kept: Vec<usize>,
    /// Their pixels `(u, v, u, v, ...)`.
    pub pixels_px: Vec<f64>,
    /// Whitening matrix, rank x 2 kept.
    pub whitening: DMatrix<f64>,
    /// For features that were found through a lens: how they follow it. `None`: the pixels stay where they are.
    pub lens: Option<LensDependence>,
    /// For features of discs that are not quite round: how they follow what is taken off as ovality. `None`: the contours are what they are of.
    pub ovals: Option<OvalDependence>,
}

/// How features move with the lens through which they were found (see [`super::pair_features`]).
#[derive(Debug, Clone, PartialEq)]
pub struct LensDependence {
    /// Intrinsics at which they were found, in the order of [`crate::camera::INTRINSIC_NAMES`].
    pub intrinsics: [f64; INTRINSICS],
    /// Derivative of the pixels by the intrinsics, 2 kept x 10.
    pub derivative: DMatrix<f64>,
}

/// How features move with the ovality of their discs, which was taken off the contours that they are of.
#[derive(Debug, Clone, PartialEq)]
pub struct OvalDependence {
    /// Ovality (a, b) of either disc at which they were found, mm.
    pub ovals_mm: [[f64; 2]; 2],
    /// Derivative of the pixels by (a, b) of the first disc and of the second, px/mm, 2 kept x 4.
    pub derivative: DMatrix<f64>,
}

/// Points of one image, structure of arrays: the images of the discs' own centres, or of corners that stand in their places. Not the
/// centre of an imaged ellipse, which lies beside the image of the centre.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PointObservations {
    /// Index of the disc in the target; taken fastest where the indices ascend one by one.
    pub disc: Vec<u32>,
    /// Its image, px.
    pub u_px: Vec<f64>,
    /// Its image, px.
    pub v_px: Vec<f64>,
    /// Standard deviation of either coordinate, px.
    pub sigma_px: Vec<f64>,
}

/// Everything observed in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageObservations {
    /// Index of the view.
    pub view: usize,
    /// Index of the camera.
    pub camera: usize,
    /// Contours (observation model `contour`).
    pub discs: Vec<DiscObservation>,
    /// Pairs (observation model `bitangent`).
    pub pairs: Vec<PairObservation>,
    /// Points (observation model `points`).
    pub points: PointObservations,
    /// Factor on all given sigmas: how much larger the real scatter was found to be.
    pub sigma_scale: f64,
}

/// Robust loss on the whitened residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// Least squares.
    None,
    /// Huber: linear beyond this many sigmas.
    Huber(f64),
    /// Cauchy with this scale in sigmas.
    Cauchy(f64),
}

impl Loss {
    /// Weight of a whitened residual, 0 to 1.
    pub fn weight(self, r: f64) -> f64 {
        self.apply(r * r).1
    }
    /// `(rho(s), rho'(s))` for `s = |r|^2`.
    #[inline]
    pub(super) fn apply(self, s: f64) -> (f64, f64) {
        match self {
            Loss::Huber(k) if s > k * k => (2.0 * k * s.sqrt() - k * k, k / s.sqrt()),
            Loss::None | Loss::Huber(_) => (s, 1.0),
            Loss::Cauchy(k) => {
                let c = k * k;
                (c * (s / c).ln_1p(), 1.0 / (1.0 + s / c))
            }
        }
    }
}

/// A least-squares problem of the rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// One or two cameras; the first is the rig frame.
    pub cameras: Vec<CameraModel>,
    /// The target.
    pub target: TargetModel,
    /// The views.
    pub views: Vec<ViewModel>,
    /// What is known beforehand.
    pub facts: Vec<Fact>,
    /// The images.
    pub images: Vec<ImageObservations>,
    /// Robust loss.
    pub loss: Loss,
}

/// Sizes of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Observed {
    /// Scalar observations.
    pub observations: usize,
    /// Rows of what is known beforehand.
    pub facts: usize,
    /// Unknowns.
    pub unknowns: usize,
}

impl Model {
    /// How many scalar observations, facts and unknowns there are.
    pub fn counts(&self) -> Observed {
        let layout = super::layout::Places::of(self).layout();
        let of_image = |i: &ImageObservations| -> usize {
            let edges: usize = i.discs.iter().map(|d| d.count()).sum();
            edges + i.pairs.iter().map(|p| p.whitening.nrows()).sum::<usize>() + 2 * i.points.disc.len()
        };
        Observed {
            observations: self.images.iter().map(of_image).sum(),
            facts: super::facts::count(self),
            unknowns: layout.global + layout.blocks.iter().sum::<usize>(),
        }
    }
}
