//! From the camera space of an image to the unknowns: sparse columns instead of matrices.
//!
//! Every unknown moves few of the numbers of the camera space: a pose six at most, the axis point seven, a distortion one. So
//! `H_unknowns = M^T H M` and `M^T b` are summed over the entries of M that are not zero, about four per column, and the lower triangle
//! alone is formed.

use super::assemble::{ImageNormal, LOCAL, SPACE, SeenImage};
use super::chart;
use super::layout::Places;
use super::model::Model;
use super::state::State;
use super::tie::Tied;
use crate::camera::INTRINSICS;
use crate::frames::Cam;
use crate::rigid::Motion;
use crate::solve::{Gradient, NormalEquations};
use nalgebra::{Matrix4, SMatrix, SVector, Vector3, Vector4};

/// Where an unknown of an image stands.
#[derive(Debug, Clone, Copy)]
pub(super) enum Slot {
    Global(usize),
    Block(usize),
}

/// Most rows of the camera space that one unknown moves: intrinsics, turn, turn of the window.
const MOVED: usize = INTRINSICS + 6;

/// Derivative of the camera space by one unknown.
#[derive(Debug, Clone, Copy)]
pub(super) struct MapColumn {
    slot: Slot,
    rows: [usize; MOVED],
    values: [f64; MOVED],
    len: usize,
}

impl MapColumn {
    fn new(slot: Slot) -> Self {
        Self { slot, rows: [0; MOVED], values: [0.0; MOVED], len: 0 }
    }
    /// Adds what is not zero of consecutive rows.
    fn with<'a>(mut self, first: usize, values: impl IntoIterator<Item = &'a f64>) -> Self {
        for (k, &value) in values.into_iter().enumerate().filter(|(_, v)| **v != 0.0) {
            (self.rows[self.len], self.values[self.len]) = (first + k, value);
            self.len += 1;
        }
        self
    }
    fn entries(&self) -> impl Iterator<Item = (usize, f64)> {
        self.rows.iter().copied().zip(self.values).take(self.len)
    }
    /// Product with a vector of the camera space.
    pub(super) fn dot(&self, b: &[f64]) -> f64 {
        self.entries().map(|(k, v)| v * b[k]).sum()
    }
}

/// Unknowns that an image touches, with the derivative of its camera space by each.
pub(super) fn image_map(model: &Model, places: &Places, state: &State, image: &SeenImage, out: &mut Vec<MapColumn>) {
    out.clear();
    let (c, v) = (image.observations.camera, image.observations.view);
    let behind = image.camera.camera.window().is_some();
    let a = chart::derivative(&model.cameras[c], &image.camera.camera);
    for (k, at) in places.charts[c].iter().enumerate() {
        if let Some(at) = at {
            let column = a.column(k);
            let z = MapColumn::new(Slot::Global(*at)).with(0, column.iter());
            // The frame turns against the window as it does against the scene.
            out.push(if behind { z.with(LOCAL, column.iter().skip(INTRINSICS)) } else { z });
        }
    }
    if let (true, Some(window)) = (behind, state.window(c)) {
        let tangents = window.tangents().map(|t| image.camera.cam_from_solver * t);
        for (k, at) in places.windows[c].iter().enumerate() {
            let Some(at) = *at else { continue };
            let z = MapColumn::new(Slot::Global(at));
            out.push(match tangents.get(k) {
                Some(t) => z.with(LOCAL, t.iter()),
                None => z.with(LOCAL + 3 + k - tangents.len(), &[1.0]),
            });
        }
    }
    let turn: Motion<Cam, Cam> = Motion::new(image.camera.cam_from_solver, Vector3::zeros());
    let mut motion_columns = |first: Slot, m: &SMatrix<f64, 6, 6>, pick: &[usize]| {
        for (n, &k) in pick.iter().enumerate() {
            let slot = match first {
                Slot::Global(i) => Slot::Global(i + n),
                Slot::Block(i) => Slot::Block(i + n),
            };
            out.push(MapColumn::new(slot).with(INTRINSICS, m.column(k).iter()));
        }
    };
    if let Some(at) = places.motions[c] {
        motion_columns(Slot::Global(at), &turn.adjoint(), &[0, 1, 2, 3, 4, 5]);
    }
    let cam_from_first = turn * state.camera_from_first[c];
    match (&state.first_from_plane, &state.views[v].plane_from_target, places.plane) {
        (Some(plane), Some(_), Some(at)) => {
            let ad = (cam_from_first * *plane).adjoint();
            motion_columns(Slot::Global(at), &ad, &[0, 1, 5]);
            motion_columns(Slot::Block(0), &ad, model.views[v].place.planar_steps());
        }
        _ => motion_columns(Slot::Block(0), &cam_from_first.adjoint(), &[0, 1, 2, 3, 4, 5]),
    }
    for k in 0..3 {
        let own = places.view_shape[k].map(|at| Slot::Block(places.pose_sizes[v] + at));
        let shared = places.shape[k].map(Slot::Global);
        if let Some(slot) = if model.target.per_view() { own } else { shared } {
            out.push(MapColumn::new(slot).with(SPACE + k, &[1.0]));
        }
    }
}

/// Normal equations of one image in the unknowns that it touches.
#[derive(Debug, Default)]
pub(super) struct MappedNormal {
    pub(super) slots: Vec<Slot>,
    /// Lower triangle by rows.
    pub(super) h: Vec<f64>,
    pub(super) b: Vec<f64>,
    pub(super) offsets: Vec<MappedOffset>,
    /// Coupling of each of them with each of the slots.
    pub(super) crosses: Vec<Vector4<f64>>,
    /// What it has in common with others.
    pub(super) tied: Vec<Tied<Vec<f64>>>,
    pub(super) cost: f64,
}

/// Equations of one estimated disc.
#[derive(Debug)]
pub(super) struct MappedOffset {
    pub(super) disc: usize,
    pub(super) own: Matrix4<f64>,
    pub(super) b: Vector4<f64>,
}

/// `M^T H M` and `M^T b`.
pub(super) fn mapped<const L: usize>(normal: &ImageNormal<L>, map: &[MapColumn], out: &mut MappedNormal) {
    out.slots.clear();
    out.slots.extend(map.iter().map(|z| z.slot));
    out.b.clear();
    out.b.extend(map.iter().map(|z| z.dot(normal.b.as_slice())));
    out.h.clear();
    out.cost = normal.cost;
    for (i, z) in map.iter().enumerate() {
        let mut moved = [0.0; L];
        for (k, value) in z.entries() {
            let column = &normal.h.as_slice()[k * L..(k + 1) * L];
            moved.iter_mut().zip(column).for_each(|(m, h)| *m += value * h);
        }
        out.h.extend(map[..=i].iter().map(|other| other.dot(&moved)));
    }
    out.tied.clear();
    out.tied.extend(normal.tied.iter().map(|t| t.mapped(map)));
    out.offsets.clear();
    out.offsets.extend(normal.offsets.iter().map(|o| MappedOffset { disc: o.disc, own: o.own, b: o.b }));
    out.crosses.clear();
    for o in &normal.offsets {
        out.crosses
            .extend(map.iter().map(|z| z.entries().map(|(k, v)| o.with_local.column(k) * v).sum::<Vector4<f64>>()));
    }
}

/// Adds one image to the block-arrow equations, of symmetric parts their lower triangles only ([`mirror`]); `first_offset` is the place of the first
/// disc's offsets.
pub(super) fn add_mapped(e: &mut NormalEquations, view: usize, image: &MappedNormal, first_offset: Option<usize>) {
    e.cost += image.cost;
    let (block, n) = (&mut e.blocks[view], e.b_g.len());
    let d = block.b_v.len();
    let (h_gg, h_vv, h_vg) = (e.h_gg.as_mut_slice(), block.h_vv.as_mut_slice(), block.h_vg.as_mut_slice());
    let mut h = image.h.iter();
    for (i, si) in image.slots.iter().enumerate() {
        match *si {
            Slot::Global(g) => e.b_g[g] += image.b[i],
            Slot::Block(v) => block.b_v[v] += image.b[i],
        }
        for (sj, h) in image.slots[..=i].iter().zip(&mut h) {
            match (*si, *sj) {
                (Slot::Global(p), Slot::Global(q)) => h_gg[p.min(q) * n + p.max(q)] += h,
                (Slot::Block(p), Slot::Block(q)) => h_vv[p.min(q) * d + p.max(q)] += h,
                (Slot::Block(p), Slot::Global(q)) | (Slot::Global(q), Slot::Block(p)) => h_vg[q * d + p] += h,
            }
        }
    }
    if let Some(first) = first_offset {
        let wide = image.slots.len().max(1);
        for (o, crosses) in image.offsets.iter().zip(image.crosses.chunks_exact(wide)) {
            add_offset(e, view, &image.slots, first + 4 * o.disc, (o, crosses));
        }
    }
}

/// Copies the lower triangles of the symmetric parts to the upper ones.
pub(super) fn mirror(e: &mut NormalEquations) {
    e.h_gg.fill_upper_triangle_with_lower_triangle();
    e.blocks.iter_mut().for_each(|b| b.h_vv.fill_upper_triangle_with_lower_triangle());
}

fn add_offset(
    e: &mut NormalEquations,
    view: usize,
    slots: &[Slot],
    at: usize,
    (offset, crosses): (&MappedOffset, &[Vector4<f64>]),
) {
    for k in 0..4 {
        e.b_g[at + k] += offset.b[k];
        for m in 0..4 {
            e.h_gg[(at + k, at + m)] += offset.own[(k, m)];
        }
        for (slot, cross) in slots.iter().zip(crosses) {
            match *slot {
                Slot::Global(g) => {
                    e.h_gg[(at + k, g)] += cross[k];
                    e.h_gg[(g, at + k)] += cross[k];
                }
                Slot::Block(v) => e.blocks[view].h_vg[(v, at + k)] += cross[k],
            }
        }
    }
}

/// Adds `M^T local` to a right-hand side.
pub(super) fn add_gradient<const L: usize>(
    out: &mut Gradient,
    view: usize,
    map: &[MapColumn],
    local: &SVector<f64, L>,
) {
    for z in map {
        let x = z.dot(local.as_slice());
        match z.slot {
            Slot::Global(g) => out.global[g] += x,
            Slot::Block(v) => out.blocks[view][v] += x,
        }
    }
}

/// Adds one whitened row, `(unknown, derivative)` and residual, to the block-arrow equations.
pub(super) fn add_row(e: &mut NormalEquations, view: usize, row: &[(Slot, f64)], residual: f64) {
    for (si, di) in row {
        match *si {
            Slot::Global(g) => e.b_g[g] -= di * residual,
            Slot::Block(v) => e.blocks[view].b_v[v] -= di * residual,
        }
        for (sj, dj) in row {
            match (*si, *sj) {
                (Slot::Global(p), Slot::Global(q)) => e.h_gg[(p, q)] += di * dj,
                (Slot::Block(p), Slot::Block(q)) => e.blocks[view].h_vv[(p, q)] += di * dj,
                (Slot::Block(p), Slot::Global(q)) => e.blocks[view].h_vg[(p, q)] += di * dj,
                (Slot::Global(_), Slot::Block(_)) => {}
            }
        }
    }
}
