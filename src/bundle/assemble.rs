//! From images to the normal equations: each image is summed in its own camera space and then mapped to the unknowns.
//!
//! Camera space of an image: intrinsics (10), turn w and shift v of everything in the camera frame (6), shape of the target
//! (3): 19 numbers, whatever the scene. With `s_c` the solver frame of camera c, E its turn into the lens frame and T the
//! motion from the first camera's solver frame:
//! ```text
//! intrinsics = A dchart        (w, v) = (B dchart, 0) + diag(E, E) dmotion + diag(E, E) Ad(T) dpose
//! dpose      = Ad(plane) dplane_or_planar     for views in the common plane
//! ```
//! Behind a window eight more follow, its turn and its layers in the camera frame; the turn is `B dchart + E dturn`, since the
//! window stands in the solver frame.

use super::chart::{self, SolverCamera};
use super::contour::{self, EDGE, EDGE_BEHIND, SeenCircle};
use super::layout::Places;
use super::model::{ImageObservations, Model};
use super::state::State;
use super::tangent;
use crate::camera::{INTRINSICS, WINDOW_STEPS};
use crate::frames::{Cam, Target};
use crate::rigid::Motion;
use crate::solve::{Gradient, NormalEquations};
use nalgebra::{DMatrix, DVector, Dyn, Matrix4, OMatrix, SMatrix, SVector, U4, Vector3, Vector4};
use rayon::prelude::*;

/// Size of an image's camera space without shape, and with it.
pub(super) const SPACE: usize = INTRINSICS + 6;
pub(super) const LOCAL: usize = SPACE + 3;
/// The same behind a window.
pub(super) const LOCAL_BEHIND: usize = LOCAL + WINDOW_STEPS;

/// Coupling of one estimated disc with its image.
pub(super) struct OffsetNormal<const L: usize> {
    pub(super) disc: usize,
    pub(super) own: Matrix4<f64>,
    pub(super) with_local: SMatrix<f64, 4, L>,
    pub(super) b: Vector4<f64>,
}

/// Normal equations of one image in its camera space.
pub(super) struct ImageNormal<const L: usize> {
    pub(super) h: SMatrix<f64, L, L>,
    pub(super) b: SVector<f64, L>,
    pub(super) offsets: Vec<OffsetNormal<L>>,
    pub(super) cost: f64,
}

/// Normal equations of one image in the unknowns that it touches.
struct MappedNormal {
    slots: Vec<Slot>,
    h: DMatrix<f64>,
    b: DVector<f64>,
    offsets: Vec<MappedOffset>,
    cost: f64,
}

/// Coupling of one estimated disc with those unknowns.
struct MappedOffset {
    disc: usize,
    own: Matrix4<f64>,
    cross: DMatrix<f64>,
    b: Vector4<f64>,
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
        let camera = SolverCamera::seen(model, state, c)?;
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

    fn linearise<const E: usize, const L: usize>(&self) -> Option<ImageNormal<L>> {
        let (scale, loss) = (self.observations.sigma_scale, self.model.loss);
        let mut out = ImageNormal { h: SMatrix::zeros(), b: SVector::zeros(), offsets: vec![], cost: 0.0 };
        for seen in &self.observations.discs {
            let n = contour::linearise::<E>(&self.circle(seen.disc), seen, scale, loss)?;
            let map = self.disc_map::<E, L>(seen.disc);
            let hm = n.h * map;
            out.h += map.tr_mul(&hm);
            out.b += map.tr_mul(&n.b);
            out.cost += n.cost;
            if !self.offsets_mm.is_empty() {
                let o = self.offset_map::<E>();
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
    fn disc_map<const E: usize, const L: usize>(&self, j: usize) -> SMatrix<f64, E, L> {
        let mut m = SMatrix::<f64, E, L>::zeros();
        m.fixed_view_mut::<SPACE, SPACE>(0, 0).fill_with_identity();
        let d = self.model.target.disc_derivative(j);
        for k in 0..3 {
            let shift = self.cam_from_target.rotation * Vector3::new(d[0][k], d[1][k], d[2][k]);
            m.fixed_view_mut::<3, 1>(INTRINSICS + 3, SPACE + k).copy_from(&shift);
            m[(EDGE - 1, SPACE + k)] = d[3][k];
        }
        (EDGE..E).for_each(|k| m[(k, LOCAL + k - EDGE)] = 1.0);
        m
    }

    /// Edge unknowns by the offsets (dx, dy, dz, dr) of a disc.
    fn offset_map<const E: usize>(&self) -> SMatrix<f64, E, 4> {
        let mut m = SMatrix::<f64, E, 4>::zeros();
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
fn image_map<const L: usize>(
    model: &Model,
    places: &Places,
    state: &State,
    image: &SeenImage,
) -> (Vec<Slot>, DMatrix<f64>) {
    let (c, v) = (image.observations.camera, image.observations.view);
    let mut slots = vec![];
    let mut columns: Vec<SVector<f64, L>> = vec![];
    let a = chart::derivative(&model.cameras[c], &image.camera.camera);
    for (k, at) in places.charts[c].iter().enumerate() {
        if let Some(at) = at {
            let mut z = SVector::<f64, L>::zeros();
            z.fixed_rows_mut::<13>(0).copy_from(&a.column(k));
            if L > LOCAL {
                // The frame turns against the window as it does against the scene.
                z.fixed_rows_mut::<3>(LOCAL).copy_from(&a.fixed_view::<3, 1>(INTRINSICS, k));
            }
            slots.push(Slot::Global(*at));
            columns.push(z);
        }
    }
    if let (true, Some(window)) = (L > LOCAL, state.window(c)) {
        let tangents = window.tangents().map(|t| image.camera.cam_from_solver * t);
        for (k, at) in places.windows[c].iter().enumerate() {
            let Some(at) = *at else { continue };
            let mut z = SVector::<f64, L>::zeros();
            match tangents.get(k) {
                Some(t) => z.fixed_rows_mut::<3>(LOCAL).copy_from(t),
                None => z[LOCAL + 3 + k - tangents.len()] = 1.0,
            }
            slots.push(Slot::Global(at));
            columns.push(z);
        }
    }
    let turn: Motion<Cam, Cam> = Motion::new(image.camera.cam_from_solver, Vector3::zeros());
    let mut motion_columns = |first: Slot, m: &SMatrix<f64, 6, 6>, pick: &[usize]| {
        for (n, &k) in pick.iter().enumerate() {
            let mut z = SVector::<f64, L>::zeros();
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
            let mut z = SVector::<f64, L>::zeros();
            z[SPACE + k] = 1.0;
            slots.push(slot);
            columns.push(z);
        }
    }
    let map = DMatrix::from_fn(L, columns.len(), |i, j| columns[j][i]);
    (slots, map)
}

/// Normal equations of one image in the unknowns that it touches.
fn mapped(model: &Model, places: &Places, state: &State, o: &ImageObservations) -> Option<MappedNormal> {
    let image = SeenImage::of(model, state, o)?;
    match image.camera.camera.window() {
        None => mapped_in::<EDGE, LOCAL>(model, places, state, &image),
        Some(_) => mapped_in::<EDGE_BEHIND, LOCAL_BEHIND>(model, places, state, &image),
    }
}

fn mapped_in<const E: usize, const L: usize>(
    model: &Model,
    places: &Places,
    state: &State,
    image: &SeenImage,
) -> Option<MappedNormal> {
    let (slots, map) = image_map::<L>(model, places, state, image);
    let normal = image.linearise::<E, L>()?;
    let hm = normal.h * &map;
    let offset =
        |o: OffsetNormal<L>| MappedOffset { disc: o.disc, own: o.own, cross: dense(&(o.with_local * &map)), b: o.b };
    let (h, b) = (map.tr_mul(&hm), map.tr_mul(&normal.b));
    let offsets = if places.offsets.is_some() { normal.offsets.into_iter().map(offset).collect() } else { vec![] };
    Some(MappedNormal { slots, h, b, offsets, cost: normal.cost })
}

fn dense(m: &OMatrix<f64, U4, Dyn>) -> DMatrix<f64> {
    DMatrix::from_column_slice(4, m.ncols(), m.as_slice())
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
    let each: Option<Vec<MappedNormal>> = wanted.par_iter().map(|o| mapped(model, places, state, o)).collect();
    let mut equations = NormalEquations::zeros(&places.layout());
    for (o, normal) in wanted.iter().zip(each?) {
        equations.cost += normal.cost;
        add(&mut equations, o.view, &normal.slots, &normal.h, &normal.b);
        if let Some(first) = places.offsets {
            for offset in &normal.offsets {
                add_offset(&mut equations, o.view, &normal.slots, first + 4 * offset.disc, offset);
            }
        }
    }
    Some(equations)
}

/// Right-hand side of the geodesic acceleration from the states a part `h` of the step before and behind; of the contours
/// only (facts and tangent features bend little).
pub(super) fn bend(model: &Model, places: &Places, states: [&State; 3], h: f64) -> Option<Gradient> {
    let each: Option<Vec<Bend>> = model.images.par_iter().map(|o| bend_of(model, places, states, o, h)).collect();
    let layout = places.layout();
    let blocks = layout.blocks.iter().map(|d| DVector::zeros(*d)).collect();
    let mut out = Gradient { global: DVector::zeros(layout.global), blocks };
    for (o, (slots, b, offsets)) in model.images.iter().zip(each?) {
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

/// Unknowns of an image, their part of the bend, and that of its discs.
type Bend = (Vec<Slot>, DVector<f64>, Vec<(usize, Vector4<f64>)>);

fn bend_of(model: &Model, places: &Places, states: [&State; 3], o: &ImageObservations, h: f64) -> Option<Bend> {
    let seen =
        [SeenImage::of(model, states[0], o)?, SeenImage::of(model, states[1], o)?, SeenImage::of(model, states[2], o)?];
    match seen[1].camera.camera.window() {
        None => bend_in::<EDGE, LOCAL>(model, places, states[1], &seen, h),
        Some(_) => bend_in::<EDGE_BEHIND, LOCAL_BEHIND>(model, places, states[1], &seen, h),
    }
}

fn bend_in<const E: usize, const L: usize>(
    model: &Model,
    places: &Places,
    state: &State,
    seen: &[SeenImage; 3],
    h: f64,
) -> Option<Bend> {
    let o = seen[1].observations;
    let (slots, map) = image_map::<L>(model, places, state, &seen[1]);
    let (mut local, mut offsets) = (SVector::<f64, L>::zeros(), vec![]);
    for d in &o.discs {
        let circles = [seen[0].circle(d.disc), seen[1].circle(d.disc), seen[2].circle(d.disc)];
        let b = contour::bend::<E>([&circles[0], &circles[1], &circles[2]], d, o.sigma_scale, model.loss, h)?;
        local += seen[1].disc_map::<E, L>(d.disc).tr_mul(&b);
        if places.offsets.is_some() {
            offsets.push((d.disc, seen[1].offset_map::<E>().tr_mul(&b)));
        }
    }
    Some((slots, map.tr_mul(&local), offsets))
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

fn add_offset(e: &mut NormalEquations, view: usize, slots: &[Slot], at: usize, offset: &MappedOffset) {
    let cross = &offset.cross;
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
