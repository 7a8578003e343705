//! From images to the normal equations: each image is summed in its own camera space and then mapped to the unknowns.
//!
//! Camera space of an image: intrinsics (10), turn w and shift v of everything in the camera frame (6), shape of the target
//! (3): 19 numbers, whatever the scene. With `s_c` the solver frame of camera c, E its turn into the lens frame and T the
//! motion from the first camera's solver frame:
//! ```text
//! intrinsics = A dchart        (w, v) = (B dchart, 0) + diag(E, E) dmotion + diag(E, E) Ad(T) dpose
//! dpose      = Ad(plane) dplane_or_planar     for views in the common plane
//! ```

use super::chart::{self, SolverCamera};
use super::contour::{self, EDGE, SeenCircle};
use super::layout::Places;
use super::model::{ImageObservations, Model};
use super::state::State;
use super::tangent;
use crate::camera::INTRINSICS;
use crate::frames::{Cam, Target};
use crate::rigid::Motion;
use crate::solve::{Gradient, NormalEquations};
use nalgebra::{DMatrix, DVector, Matrix4, SMatrix, SVector, Vector3, Vector4};
use rayon::prelude::*;

/// Size of an image's camera space without shape, and with it.
pub(super) const SPACE: usize = INTRINSICS + 6;
pub(super) const LOCAL: usize = SPACE + 3;

pub(super) type LocalMatrix = SMatrix<f64, LOCAL, LOCAL>;
pub(super) type LocalVector = SVector<f64, LOCAL>;

/// Coupling of one estimated disc with its image.
pub(super) struct OffsetNormal {
    pub(super) disc: usize,
    pub(super) own: Matrix4<f64>,
    pub(super) with_local: SMatrix<f64, 4, LOCAL>,
    pub(super) b: Vector4<f64>,
}

/// Normal equations of one image in its camera space.
pub(super) struct ImageNormal {
    pub(super) h: LocalMatrix,
    pub(super) b: LocalVector,
    pub(super) offsets: Vec<OffsetNormal>,
    pub(super) cost: f64,
}

/// One image with everything that its residuals need.
pub(super) struct SeenImage<'a> {
    pub(super) model: &'a Model,
    pub(super) observations: &'a ImageObservations,
    pub(super) camera: SolverCamera,
    pub(super) cam_from_target: Motion<Cam, Target>,
    pub(super) shape_mm: [f64; 3],
    pub(super) offsets_mm: &'a [[f64; 4]],
}

impl<'a> SeenImage<'a> {
    pub(super) fn of(model: &'a Model, state: &'a State, observations: &'a ImageObservations) -> Option<Self> {
        let (c, v) = (observations.camera, observations.view);
        let camera = SolverCamera::of(&model.cameras[c], &state.cameras[c])?;
        let view = &state.views[v];
        let turn: Motion<Cam, Cam> = Motion::new(camera.cam_from_solver, Vector3::zeros());
        let cam_from_target = turn * state.camera_from_first[c] * view.first_from_target;
        let shape_mm = if model.target.per_view() { view.shape_mm } else { state.shape_mm };
        Some(Self { model, observations, camera, cam_from_target, shape_mm, offsets_mm: &state.offsets_mm })
    }

    /// Centre and radius of disc `j`, offsets included, mm.
    pub(super) fn disc(&self, j: usize) -> (Vector3<f64>, f64) {
        let (mut center, mut radius) = self.model.target.nominal_disc(j, &self.shape_mm);
        if let Some(o) = self.offsets_mm.get(j) {
            center += Vector3::new(o[0], o[1], o[2]);
            radius += o[3];
        }
        (center, radius)
    }

    pub(super) fn circle(&self, j: usize) -> SeenCircle<'_> {
        let (center, radius) = self.disc(j);
        SeenCircle { camera: &self.camera.camera, cam_from_target: &self.cam_from_target, center, radius }
    }

    fn cost(&self) -> Option<f64> {
        let (scale, loss) = (self.observations.sigma_scale, self.model.loss);
        let mut sum = 0.0;
        for seen in &self.observations.discs {
            sum += contour::cost(&self.circle(seen.disc), seen, scale, loss)?;
        }
        for pair in &self.observations.pairs {
            sum += tangent::cost(self, pair)?;
        }
        Some(sum)
    }

    fn linearise(&self) -> Option<ImageNormal> {
        let (scale, loss) = (self.observations.sigma_scale, self.model.loss);
        let mut out = ImageNormal { h: LocalMatrix::zeros(), b: LocalVector::zeros(), offsets: vec![], cost: 0.0 };
        for seen in &self.observations.discs {
            let n = contour::linearise(&self.circle(seen.disc), seen, scale, loss)?;
            let map = self.disc_map(seen.disc);
            let hm = n.h * map;
            out.h += map.tr_mul(&hm);
            out.b += map.tr_mul(&n.b);
            out.cost += n.cost;
            if !self.offsets_mm.is_empty() {
                let o = self.offset_map();
                out.offsets.push(OffsetNormal {
                    disc: seen.disc,
                    own: o.tr_mul(&(n.h * o)),
                    with_local: o.tr_mul(&hm),
                    b: o.tr_mul(&n.b),
                });
            }
        }
        for pair in &self.observations.pairs {
            tangent::linearise(self, pair, &mut out)?;
        }
        Some(out)
    }

    /// Edge unknowns (intrinsics, turn, shift, radius) of disc `j` by the image's camera space.
    fn disc_map(&self, j: usize) -> SMatrix<f64, EDGE, LOCAL> {
        let mut m = SMatrix::<f64, EDGE, LOCAL>::zeros();
        m.fixed_view_mut::<SPACE, SPACE>(0, 0).fill_with_identity();
        let d = self.model.target.disc_derivative(j);
        for k in 0..3 {
            let shift = self.cam_from_target.rotation * Vector3::new(d[0][k], d[1][k], d[2][k]);
            m.fixed_view_mut::<3, 1>(INTRINSICS + 3, SPACE + k).copy_from(&shift);
            m[(EDGE - 1, SPACE + k)] = d[3][k];
        }
        m
    }

    /// Edge unknowns by the offsets (dx, dy, dz, dr) of a disc.
    fn offset_map(&self) -> SMatrix<f64, EDGE, 4> {
        let mut m = SMatrix::<f64, EDGE, 4>::zeros();
        m.fixed_view_mut::<3, 3>(INTRINSICS + 3, 0).copy_from(&self.cam_from_target.rotation);
        m[(EDGE - 1, 3)] = 1.0;
        m
    }
}

/// Cost of all images; `None` where one of them has no meaning. Summed in the order of the images.
pub(super) fn cost(model: &Model, state: &State) -> Option<f64> {
    let each: Option<Vec<f64>> = model.images.par_iter().map(|o| SeenImage::of(model, state, o)?.cost()).collect();
    each.map(|c| c.iter().sum())
}

/// Where an unknown of an image stands.
#[derive(Debug, Clone, Copy)]
pub(super) enum Slot {
    Global(usize),
    Block(usize),
}

/// Unknowns that an image touches, with the derivative of its camera space by each.
pub(super) fn image_map(model: &Model, places: &Places, state: &State, image: &SeenImage) -> (Vec<Slot>, DMatrix<f64>) {
    let (c, v) = (image.observations.camera, image.observations.view);
    let mut slots = vec![];
    let mut columns: Vec<LocalVector> = vec![];
    let a = chart::derivative(&model.cameras[c], &image.camera.camera);
    for (k, at) in places.charts[c].iter().enumerate() {
        if let Some(at) = at {
            let mut z = LocalVector::zeros();
            z.fixed_rows_mut::<13>(0).copy_from(&a.column(k));
            slots.push(Slot::Global(*at));
            columns.push(z);
        }
    }
    let turn: Motion<Cam, Cam> = Motion::new(image.camera.cam_from_solver, Vector3::zeros());
    let mut motion_columns = |first: Slot, m: &SMatrix<f64, 6, 6>, pick: &[usize]| {
        for (n, &k) in pick.iter().enumerate() {
            let mut z = LocalVector::zeros();
            z.fixed_rows_mut::<6>(INTRINSICS).copy_from(&m.column(k));
            slots.push(match first {
                Slot::Global(i) => Slot::Global(i + n),
                Slot::Block(i) => Slot::Block(i + n),
            });
            columns.push(z);
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
    let own_shape = places.view_shape.iter().map(|at| at.map(|at| Slot::Block(places.pose_sizes[v] + at)));
    let shared_shape = places.shape.iter().map(|at| at.map(Slot::Global));
    let shape: Vec<_> = if model.target.per_view() { own_shape.collect() } else { shared_shape.collect() };
    for (k, slot) in shape.into_iter().enumerate() {
        if let Some(slot) = slot {
            let mut z = LocalVector::zeros();
            z[SPACE + k] = 1.0;
            slots.push(slot);
            columns.push(z);
        }
    }
    let map = DMatrix::from_fn(LOCAL, columns.len(), |i, j| columns[j][i]);
    (slots, map)
}

/// Normal equations of all images, or of those of one camera, without facts. Summed in the order of the images.
pub(super) fn linearise(
    model: &Model,
    places: &Places,
    state: &State,
    camera: Option<usize>,
) -> Option<NormalEquations> {
    let wanted: Vec<&ImageObservations> =
        model.images.iter().filter(|i| camera.is_none_or(|c| i.camera == c)).collect();
    let each: Option<Vec<(ImageNormal, Vec<Slot>, DMatrix<f64>)>> = wanted
        .par_iter()
        .map(|o| {
            let image = SeenImage::of(model, state, o)?;
            let (slots, map) = image_map(model, places, state, &image);
            Some((image.linearise()?, slots, map))
        })
        .collect();
    let mut equations = NormalEquations::zeros(&places.layout());
    for (o, (normal, slots, map)) in wanted.iter().zip(each?) {
        equations.cost += normal.cost;
        let hm = normal.h * &map;
        add(&mut equations, o.view, &slots, &map.tr_mul(&hm), &map.tr_mul(&normal.b));
        if let Some(first) = places.offsets {
            for offset in &normal.offsets {
                add_offset(&mut equations, o.view, &slots, &map, first + 4 * offset.disc, offset);
            }
        }
    }
    Some(equations)
}

/// Right-hand side of the geodesic acceleration from the states a part `h` of the step before and behind; of the contours
/// only (facts and tangent features bend little).
pub(super) fn bend(model: &Model, places: &Places, states: [&State; 3], h: f64) -> Option<Gradient> {
    let each: Option<Vec<(LocalVector, Vec<(usize, Vector4<f64>)>, Vec<Slot>, DMatrix<f64>)>> = model
        .images
        .par_iter()
        .map(|o| {
            let seen = [
                SeenImage::of(model, states[0], o)?,
                SeenImage::of(model, states[1], o)?,
                SeenImage::of(model, states[2], o)?,
            ];
            let (slots, map) = image_map(model, places, states[1], &seen[1]);
            let (mut local, mut offsets) = (LocalVector::zeros(), vec![]);
            for d in &o.discs {
                let circles = [seen[0].circle(d.disc), seen[1].circle(d.disc), seen[2].circle(d.disc)];
                let b = contour::bend([&circles[0], &circles[1], &circles[2]], d, o.sigma_scale, model.loss, h)?;
                local += seen[1].disc_map(d.disc).tr_mul(&b);
                if places.offsets.is_some() {
                    offsets.push((d.disc, seen[1].offset_map().tr_mul(&b)));
                }
            }
            Some((local, offsets, slots, map))
        })
        .collect();
    let layout = places.layout();
    let blocks = layout.blocks.iter().map(|d| DVector::zeros(*d)).collect();
    let mut out = Gradient { global: DVector::zeros(layout.global), blocks };
    for (o, (local, offsets, slots, map)) in model.images.iter().zip(each?) {
        let b = map.tr_mul(&local);
        for (slot, x) in slots.iter().zip(b.iter()) {
            match *slot {
                Slot::Global(g) => out.global[g] += x,
                Slot::Block(v) => out.blocks[o.view][v] += x,
            }
        }
        if let Some(first) = places.offsets {
            for (disc, x) in offsets {
                (0..4).for_each(|k| out.global[first + 4 * disc + k] += x[k]);
            }
        }
    }
    Some(out)
}

/// Adds a dense symmetric piece to the block-arrow equations.
pub(super) fn add(e: &mut NormalEquations, view: usize, slots: &[Slot], h: &DMatrix<f64>, b: &DVector<f64>) {
    for (i, si) in slots.iter().enumerate() {
        match *si {
            Slot::Global(g) => e.b_g[g] += b[i],
            Slot::Block(v) => e.blocks[view].b_v[v] += b[i],
        }
        for (j, sj) in slots.iter().enumerate() {
            match (*si, *sj) {
                (Slot::Global(p), Slot::Global(q)) => e.h_gg[(p, q)] += h[(i, j)],
                (Slot::Block(p), Slot::Block(q)) => e.blocks[view].h_vv[(p, q)] += h[(i, j)],
                (Slot::Block(p), Slot::Global(q)) => e.blocks[view].h_vg[(p, q)] += h[(i, j)],
                (Slot::Global(_), Slot::Block(_)) => {}
            }
        }
    }
}

fn add_offset(
    e: &mut NormalEquations,
    view: usize,
    slots: &[Slot],
    map: &DMatrix<f64>,
    at: usize,
    offset: &OffsetNormal,
) {
    let cross = offset.with_local * map;
    for k in 0..4 {
        e.b_g[at + k] += offset.b[k];
        for m in 0..4 {
            e.h_gg[(at + k, at + m)] += offset.own[(k, m)];
        }
        for (j, slot) in slots.iter().enumerate() {
            match *slot {
                Slot::Global(g) => {
                    e.h_gg[(at + k, g)] += cross[(k, j)];
                    e.h_gg[(g, at + k)] += cross[(k, j)];
                }
                Slot::Block(v) => e.blocks[view].h_vg[(v, at + k)] += cross[(k, j)],
            }
        }
    }
}
