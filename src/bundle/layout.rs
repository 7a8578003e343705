//! Where each unknown stands in the normal equations, and how far it may go in one step.
//!
//! Global unknowns: cameras' charts, motions between cameras, windows, plane, shape, ovals, offsets. Block of a view: pose (6, or 3 in the
//! plane, 4 where its distance from the plane is estimated) and its own shape where it has one.

use super::chart;
use super::model::Model;
use super::state::State;
use crate::camera::{INTRINSICS, LAYERS};
use crate::solve::{self, Step};
use nalgebra::DVector;

/// Index of the first unknown of each part; `None` for one that is not adjusted.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Places {
    /// Per camera and chart coordinate.
    pub(super) charts: Vec<[Option<usize>; INTRINSICS]>,
    /// Per camera: first of six (the first camera has none).
    pub(super) motions: Vec<Option<usize>>,
    /// Per camera: turn of its window about its two tangents, then its layers.
    pub(super) windows: Vec<[Option<usize>; 2 + LAYERS]>,
    /// First of three.
    pub(super) plane: Option<usize>,
    /// Shared shape parameters.
    pub(super) shape: [Option<usize>; 3],
    /// First ovality; two per disc.
    pub(super) ovals: Option<usize>,
    /// First offset; four per disc.
    pub(super) offsets: Option<usize>,
    /// Number of global unknowns.
    pub(super) global: usize,
    /// Per view: number of pose unknowns (6, 3 or 4).
    pub(super) pose_sizes: Vec<usize>,
    /// Shape parameters inside a view's block, counted from the end of the pose.
    pub(super) view_shape: [Option<usize>; 3],
    view_shape_size: usize,
}

impl Places {
    pub(super) fn of(model: &Model) -> Self {
        let mut next = 0;
        let mut take = |n: usize| {
            next += n;
            next - n
        };
        let charts = model.cameras.iter().map(|c| chart::active(c).map(|on| on.then(|| take(1)))).collect();
        let motions = (0..model.cameras.len()).map(|c| (c > 0).then(|| take(6))).collect();
        let window = |c: &super::CameraModel| -> [bool; 2 + LAYERS] {
            std::array::from_fn(|k| c.window.is_some_and(|w| k < 2 || w.free[k - 2]))
        };
        let windows = model.cameras.iter().map(|c| window(c).map(|on| on.then(|| take(1)))).collect();
        let plane = model.views.iter().any(|v| v.place.in_plane()).then(|| take(3));
        let per_view = model.target.per_view();
        let shape = model.target.free.map(|on| (on && !per_view).then(|| take(1)));
        let ovals = model.target.oval_sigma_mm.map(|_| take(2 * model.target.disc_count()));
        let offsets = model.target.offset_sigma_mm.map(|_| take(4 * model.target.disc_count()));
        let mut inside = 0;
        let view_shape = model.target.free.map(|on| {
            (on && per_view).then(|| {
                inside += 1;
                inside - 1
            })
        });
        let pose_size = |v: &super::ViewModel| if v.place.in_plane() { v.place.planar_steps().len() } else { 6 };
        let pose_sizes = model.views.iter().map(pose_size).collect();
        Self {
            charts,
            motions,
            windows,
            plane,
            shape,
            ovals,
            offsets,
            global: next,
            pose_sizes,
            view_shape,
            view_shape_size: inside,
        }
    }

    /// Global unknowns before the offsets of discs.
    pub(super) fn shared(&self) -> usize {
        self.offsets.unwrap_or(self.global)
    }

    /// With so many further global unknowns, the last before the offsets of discs.
    pub(super) fn with_further(&self, count: usize) -> Self {
        Self { offsets: self.offsets.map(|at| at + count), global: self.global + count, ..self.clone() }
    }

    pub(super) fn layout(&self) -> solve::Layout {
        let blocks = self.pose_sizes.iter().map(|d| d + self.view_shape_size).collect();
        solve::Layout { global: self.global, blocks }
    }
}

/// Steps up to which the problem is about linear: a few percent of distances and focal lengths, a hundredth of a radian,
/// distortion that moves the edge of the image by about half a percent.
pub(super) fn scales(model: &Model, places: &Places, state: &State) -> Step {
    let mut global = DVector::from_element(places.global, 1.0);
    for (c, i) in state.cameras.iter().enumerate() {
        // Half of a usual field: the image reaches about to the mirrored axis point.
        let s = (i.cx_px.abs().max(i.cy_px.abs()) / i.f_px).powi(2).clamp(1e-4, 1.0);
        let pixels = 0.02 * i.f_px;
        let tilt = if model.cameras[c].uses_pinhole_frame() { 0.01 * i.f_px } else { 0.02 };
        let all = [pixels, 0.01, pixels, pixels, tilt, tilt, 5e-3 / s, 5e-3 / (s * s), 5e-3 / (s * s * s), 0.05];
        for (at, scale) in places.charts[c].iter().zip(all) {
            at.iter().for_each(|at| global[*at] = scale);
        }
    }
    let distance = state.views.iter().map(|v| v.first_from_target.translation_mm.norm()).fold(1e-3, f64::max);
    let pose = [0.02, 0.02, 0.02, 0.02 * distance, 0.02 * distance, 0.02 * distance];
    for at in places.motions.iter().flatten() {
        (0..6).for_each(|k| global[at + k] = pose[k]);
    }
    for (c, at) in places.windows.iter().enumerate() {
        let Some(window) = state.window(c) else { continue };
        let [distance, thickness, ..] = window.layers();
        let all = [0.02, 0.02, 0.05 * distance, 0.05 * distance.max(thickness), 0.01, 0.01, 0.01];
        at.iter().zip(all).for_each(|(at, scale)| at.iter().for_each(|at| global[*at] = scale));
    }
    if let Some(at) = places.plane {
        (0..3).for_each(|k| global[at + k] = [pose[0], pose[1], pose[5]][k]);
    }
    let length = |view: &super::ViewState| {
        let s = if model.target.per_view() { view.shape_mm } else { state.shape_mm };
        s.map(|s| 0.05 * s.abs().max(1e-3))
    };
    let first = state.views.first().map_or([1.0; 3], length);
    for k in 0..3 {
        places.shape[k].iter().for_each(|at| global[*at] = first[k]);
    }
    if let Some(at) = places.ovals {
        global.rows_mut(at, 2 * state.ovals_mm.len()).fill(first[1]);
    }
    if let Some(at) = places.offsets {
        global.rows_mut(at, 4 * state.offsets_mm.len()).fill(first[1]);
    }
    let blocks = state.views.iter().enumerate().map(|(v, view)| {
        let n = places.pose_sizes[v];
        let own = length(view);
        let mut block = DVector::from_element(n + places.view_shape_size, 1.0);
        (0..n).for_each(|k| block[k] = if n == 6 { pose[k] } else { pose[2 + k] });
        for k in 0..3 {
            places.view_shape[k].iter().for_each(|at| block[n + at] = own[k]);
        }
        block
    });
    Step { blocks: blocks.collect(), global }
}
